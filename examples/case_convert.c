/* case_convert: turns a case file into an input file of CalculiX, Abaqus or FEBio, and back.
 *
 *     cc -O3 case_convert.c -lm -o case_convert
 *     ./case_convert IN OUT [--as-svk]
 *
 * IN ends in .case, .inp, .feb or .msml.xml, OUT in one of the first three or .scn. Of a case CASE.case its mesh and
 * lists are written beside it.
 */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "case_feb_write.h"
#include "case_inp_write.h"
#include "case_msml.h"
#include "case_scn_write.h"
#include "case_write.h"

static const char help[] =
    "case_convert IN OUT [--as-svk]\n"
    "\n"
    "IN, OUT   CASE.case (case_solve --help tells its grammar), MODEL.inp, of Abaqus or CalculiX, or MODEL.feb, of\n"
    "          FEBio (formats 4.0 and 3.0 are read, 4.0 is written)\n"
    "IN        also MODEL.msml.xml, of MSML\n"
    "OUT       also SCENE.scn, of SOFA: tet4, and hex8 of one material\n"
    "--as-svk  writes corotated material, which no .inp and no .feb can say, and linear material, which no .feb can,\n"
    "          as St.Venant-Kirchhoff's\n"
    "\n"
    "What OUT cannot say is refused, with the line of IN where it stands. A .case comes with its mesh, OUT_mesh.vtk, "
    "and\n"
    "its lists, OUT_1_fix.txt and so on. A .inp counts forces in 1e-4 N and masses in 1e-4 kg where the material is "
    "not\n"
    "linear, and says so: CalculiX takes forces out of balance below 1e-6 of its unit for 0. A .feb has SI units.\n"
    "Tractions become nodal forces, since CalculiX' *DLOAD follows the faces; pressures stay pressures.\n"
    "\n"
    "Exits with 0, or with 2 and what is wrong.\n";

static const char *const read_endings[] = {"case", "inp", "feb", "msml.xml"};
static const char *const written_endings[] = {"case", "inp", "feb", "scn"};
enum { ENDING_COUNT = 4 }; /* of either */

enum { EXIT_CONVERTED = 0, EXIT_WRONG = 2 };

static int complain(const case_file *c, const char *path)
{
    if (c->faults.count > 0)
        fputs(c->faults.text, stderr);
    else if (c->error_line > 0)
        fprintf(stderr, "%s:%d: %s\n", path, c->error_line, c->message);
    else
        fprintf(stderr, "%s: %s\n", path, c->message);
    return EXIT_WRONG;
}

/* Says what was read otherwise than it stands in the file, or not at all. */
static void print_notes(const case_file *c, const char *path)
{
    for (int i = 0; i < c->mesh_report.note_count; i++)
        fprintf(stderr, "%s:%d: note: %s\n", path, c->mesh_statement->line, c->mesh_report.notes[i]);
    if (c->notes.text)
        fputs(c->notes.text, stderr);
}

static int write_as(case_file *c, const char *path, int as_svk)
{
    if (foreign_ends_in(path, "case"))
        return case_write(c, path, is_same_file);
    if (case_reads(c, path, is_same_file))
        return case_fail(c, 0, "%.500s is read by this case: it would be overwritten", path);
    return foreign_ends_in(path, "feb")   ? feb_write(c, path, as_svk)
           : foreign_ends_in(path, "scn") ? scn_write(c, path)
                                          : inp_write(c, path, as_svk);
}

static int convert(const char *in, const char *out, int as_svk)
{
    case_file c;
    int status = EXIT_CONVERTED;
    if (!case_open(&c, in) || !write_as(&c, out, as_svk)) {
        status = complain(&c, in);
    } else {
        print_notes(&c, in);
        printf("%s: %d nodes, %d %s\n", out, c.mesh.node_count, c.mesh.element_count,
               sb_element_name(c.mesh.element_type));
    }
    case_free(&c);
    return status;
}

/* Whether the name ends in one of them; says so when it does not. */
static int has_ending(const char *path, const char *const endings[ENDING_COUNT])
{
    for (int i = 0; i < ENDING_COUNT; i++)
        if (foreign_ends_in(path, endings[i]))
            return 1;
    fprintf(stderr, "case_convert: %s must end in", path);
    for (int i = 0; i < ENDING_COUNT; i++)
        fprintf(stderr, "%s.%s", i == 0 ? " " : i + 1 == ENDING_COUNT ? " or " : ", ", endings[i]);
    fprintf(stderr, "\n");
    return 0;
}

static int program(int argc, char **argv)
{
    const char *paths[2] = {NULL, NULL};
    int count = 0, as_svk = 0, wrong = 0;
    if (argc == 2 && (strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0)) {
        fputs(help, stdout);
        return EXIT_CONVERTED;
    }
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--as-svk") == 0)
            as_svk = 1;
        else if (argv[i][0] == '-' || count == 2)
            wrong = 1;
        else
            paths[count++] = argv[i];
    }
    if (wrong || count < 2) {
        fputs("usage: case_convert IN OUT [--as-svk]; see --help\n", stderr);
        return EXIT_WRONG;
    }
    if (!has_ending(paths[0], read_endings) || !has_ending(paths[1], written_endings))
        return EXIT_WRONG;
    return convert(paths[0], paths[1], as_svk);
}

int main(int argc, char **argv) { return finish("case_convert", program(argc, argv), EXIT_WRONG); }
