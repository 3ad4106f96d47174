/* case_solve: solves what a case file describes and writes what it asks for.
 *
 *     cc -O3 case_solve.c -lm -o case_solve
 *     ./case_solve CASE.case|MODEL.inp|MODEL.feb|MODEL.msml.xml [OUT.vtk] [-p PREFIX] [--mass KIND]
 *     ./case_solve CASE.case --vary TABLE.csv --study ROWS.csv [--shard I/N] [--mass KIND]
 *
 * --help tells the grammar of a case file. case_reader.h reads it; this file solves and writes. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "case_msml.h"
#include "case_vary.h"
#include "case_write.h"
#include "cut_file.h"
#include "shard.h"

static const char help[] =
    "case_solve CASE.case|MODEL.inp|MODEL.feb|MODEL.msml.xml [OUT.vtk] [-p PREFIX] [--mass consistent|reduced|lumped]\n"
    "case_solve CASE.case --vary TABLE.csv --study ROWS.csv [--shard I/N] [--mass KIND]\n"
    "\n"
    "Solves the case and writes its outputs to the current directory, with PREFIX before their names.\n"
    "OUT.vtk (or -o OUT.vtk): the deformed mesh with displacement and von Mises stress for ParaView.\n"
    "\n"
    "A case is plain text: one statement per line, # starts a comment, units are SI, indices count from 0,\n"
    "input files are relative to the case file.\n"
    "\n"
    "  mesh      FILE                        VTK (.vtk, .vtu), gmsh, Medit or TetGen: tet4, tet10, hex8,\n"
    "                                        hex20 or hex27; wedges, pyramids and mixed cells become tets\n"
    "  surface   FILE [scale=S]              instead of mesh, with\n"
    "  stuff     cells=N                     tets in the closed surface, N along its longest side\n"
    "  select    nodes|elements|faces NAME box=X0,Y0,Z0,X1,Y1,Z1\n"
    "  select    nodes|faces NAME plane=PX,PY,PZ,NX,NY,NZ [distance=D]\n"
    "  select    nodes|elements|faces NAME near=FILE distance=D     a surface; elements by their middle\n"
    "                                        then nodes=@NAME, faces=@NAME (outer ones), material ... elements=@NAME\n"
    "  element   tet10sr                     one rotation per element (corotated)\n"
    "            tet10bbar|hex8bbar|hex20bbar|hex27bbar|tet4patch\n"
    "                                        for nearly incompressible material; default: as in the file\n"
    "  material  MODEL E=.. nu=.. density=.. [region=ID]\n"
    "                                        linear corotated corotated_invertible svk neo_hookean\n"
    "                                        stable_neo_hookean\n"
    "  material  neo_hookean C10=.. D1=.. density=.. [region=ID]\n"
    "  material  mooney_rivlin C10=.. C01=.. D1=.. density=.. [region=ID]\n"
    "  material  reduced_polynomial C10=.. C20=.. [C30=..] D1=.. density=.. [region=ID]\n"
    "                                        hyperelastic ones with relaxation: g1=.. tau1=.. g2=.. tau2=.. ...\n"
    "  gravity   GX GY GZ                    m/s^2\n"
    "  fix       AXES nodes=FILE             AXES: xyz, x, yz ...\n"
    "  prescribe AXES nodes=FILE value=UX,UY,UZ [ramp=SECONDS]\n"
    "  prescribe AXES file=FILE [ramp=SECONDS]          lines: NODE UX UY UZ\n"
    "  force     nodes=FILE value=FX,FY,FZ   N per node\n"
    "  force     file=FILE                   lines: NODE FX FY FZ\n"
    "  traction  faces=FILE value=TX,TY,TZ   Pa on the undeformed area; lines: the nodes of a face\n"
    "  pressure  faces=FILE value=P          Pa, follows the faces, positive pushes inwards\n"
    "  spring    file=FILE                   lines: NODE K X Y Z, N/m to a point in space\n"
    "  equation  file=FILE                   lines: VALUE NODE AXIS C [NODE AXIS C] ..., sum of C u = VALUE (m); the\n"
    "                                        first displacement follows from the others\n"
    "  tie       nodes=FILE faces=FILE [distance=D]     nodes go with the faces that they lie on (within D)\n"
    "  cut       plane PX PY PZ NX NY NZ     through a point across a normal, at rest, before the solve; tet4, tet10\n"
    "  cut       polygon file=FILE           lines: X Y Z, corners of a polygon: triangles from the first\n"
    "  cut       surface file=FILE           a surface, e.g. one closed around what is to come loose\n"
    "  ablate    X Y Z RADIUS                what of the mesh lies in a ball is taken out; all of these with\n"
    "                                        [lattice=1|2|4]: places along an element's edge that come apart (2)\n"
    "  solve     static  steps=N tol=T [iterations=N]\n"
    "  solve     euler   dt=S end=S [tol=T] [alpha=A] [beta=B]\n"
    "  solve     newmark dt=S end=S [tol=T] [alpha=A] [beta=B] [newton=N]\n"
    "  solve     central dt=S|auto end=S [alpha=A]      explicit; auto: 0.9 of the stable step\n"
    "  solve     modes   count=N             natural frequencies of the undeformed body\n"
    "  output    displacement|reaction|stress FILE\n"
    "  output    frequencies FILE            lines: MODE F_HZ, ascending, rigid modes included\n"
    "  output    probe NODE FILE             one line per step: time (static: share of the load) and "
    "displacement\n";

static const char help_notes[] =
    "  expect    probe NODE value=UX,UY,UZ tol=T        its displacement at the end (m), else exit status 4\n"
    "\n"
    "Static: load steps grow and shrink with Newton's success, beginning with N equal ones; iterations (30) "
    "is the\n"
    "most per load step; tol is the out-of-balance force relative to the largest of load and reaction.\n"
    "Dynamic: every step is iterated to tol (1e-6) in at most newton (20) iterations. --mass: reduced uses the\n"
    "points of the stiffness, as CalculiX does (default of euler and newmark); consistent is integrated exactly\n"
    "(default of modes); lumped is diagonal (what central needs). central: a dt above the stable step is cut into\n"
    "substeps. Relaxing materials: moduli are those of sudden motion, changes of volume do not relax, and a static\n"
    "solve finds the state after infinite time. -o of modes writes the mode shapes as fields.\n"
    "Cut bodies: supports, tractions and pressures stay with their parts; a part that nothing holds is refused by a\n"
    "static solve, with its volume and place; parts smaller than an element are held. Outputs are of the mesh's "
    "nodes,\n"
    "which keep their material (a reaction is that of a node and its copies), a stress has a line for each piece of "
    "an\n"
    "element, and OUT.vtk has skin and lips (field lip) instead of the mesh.\n"
    "MODEL.inp: an input file of Abaqus or CalculiX, in SI units; what it says that is not known here is refused, "
    "with\n"
    "all lines it stands in. Outputs then are displacement.txt (or frequencies.txt), reaction.txt and stress.txt "
    "where\n"
    "RF and S are printed, probe_NODE.txt where the U of a set of one node is; they have the numbers of the file.\n"
    "*ELASTIC with NLGEOM is St.Venant-Kirchhoff's material, as in CalculiX.\n"
    "MODEL.feb: an input file of FEBio, format 4.0 or 3.0, likewise; reactions and stresses are written where its "
    "log\n"
    "has them.\n"
    "MODEL.msml.xml: a file of MSML, likewise, with its mesh or the surface that its mesher fills beside it.\n"
    "--vary: a study. TABLE.csv has names in its first line and a case in each other one; $NAME or ${NAME} in the "
    "case\n"
    "file is what the case's line has for it. ROWS.csv gets a line for each case: its values, whether it converged,\n"
    "steps, Newton iterations, the largest displacement (m) and those of probes at the end, or its frequencies (Hz),\n"
    "and whether all expect lines of the case hold (expected: yes or no); other outputs are not written, and a case\n"
    "that fails, or is not as expected, is a row like others (exit status 0). --shard I/N does the\n"
    "I-th of N shares; run again it goes on where it was, and examples/study/merge.sh joins the files of the shares.\n"
    "Integration points: tet4 1, tet10 4 (8 when its sides are curved), hex8 8, hex20 and hex27 27.\n"
    "\n"
    "Prints `converged steps=N newton=N pcg=N seconds=S` and exits with 0. A wrong case: 2, and nothing is "
    "written.\n"
    "A solve that fails: 3, and the outputs hold the last converged state. An expectation that fails: 4. Also 2: an\n"
    "output or stdout that cannot be written.\n";

enum { EXIT_CONVERGED = 0, EXIT_WRONG_CASE = 2, EXIT_NOT_SOLVED = 3, EXIT_NOT_EXPECTED = 4 };

/* In the order of sb_mass_kind. */
static const char *const mass_names[] = {"lumped", "consistent", "reduced"};

/* One line of a probe's history. */
typedef struct probe_row {
    double time;
    sb_vec3 displacement;
} probe_row;

typedef struct probe {
    const case_statement *statement;
    probe_row *rows;
    int count, capacity;
} probe;

typedef struct run {
    case_file file;
    sb_body *body;
    const char *case_path, *vtk_path, *prefix, *mass;
    const char *table, *study, *share; /* of a study; or NULL */
    const case_vary *vary;             /* of a study, with the case's row; or NULL */
    int row;
    probe *probes;
    int probe_count;
    sb_vec3 *displacement, *reaction; /* [nodes of the body] of the last converged state */
    sb_real *frequencies;             /* [mode_count] (Hz), or NULL */
    sb_vec3 *shapes;                  /* [mode_count][nodes of the body] */
    int mode_count;
    int steps, newton, pcg;
    int mass_kind;     /* place in mass_names, or -1: what suits the solve */
    char failure[600]; /* what failed and where; empty: nothing */
    int is_amiss;      /* of a study: 1 when it converged, but not to what the case expects */
} run;

/* ---- messages ------------------------------------------------------------------------------------------ */

static int complain(const run *r)
{
    if (r->file.faults.count > 0)
        fputs(r->file.faults.text, stderr);
    else if (r->file.error_line > 0)
        fprintf(stderr, "%s:%d: %s\n", r->case_path, r->file.error_line, r->file.message);
    else
        fprintf(stderr, "%s: %s\n", r->case_path, r->file.message);
    return EXIT_WRONG_CASE;
}

static void show_progress(const run *r, const char *what, double done)
{
    char words[64];
    snprintf(words, sizeof words, "%s %5.1f %%, %d Newton iterations", what, 100 * done, r->newton);
    progress_show(done, words);
}

/* ---- history ------------------------------------------------------------------------------------------- */

static int take_probes(run *r, double time)
{
    for (int i = 0; i < r->probe_count; i++) {
        probe *p = r->probes + i;
        void *rows = p->rows;
        if (!case_reserve(&rows, p->count, &p->capacity, sizeof *p->rows))
            return 0;
        p->rows = (probe_row *)rows;
        p->rows[p->count].time = time;
        p->rows[p->count].displacement = sb_body_displacements(r->body)[p->statement->node];
        p->count++;
    }
    return 1;
}

/* Keeps the state that has just converged. */
static void take_state(run *r)
{
    int nodes = sb_body_node_count(r->body);
    memcpy(r->displacement, sb_body_displacements(r->body), (size_t)nodes * sizeof(sb_vec3));
    memcpy(r->reaction, sb_body_reactions(r->body), (size_t)nodes * sizeof(sb_vec3));
    for (int i = r->file.mesh.node_count; i < nodes; i++) { /* copies that a cut made */
        int origin = sb_cut_node_origin(r->file.cut, i);
        if (origin >= 0)
            r->reaction[origin] = sb_v3_add(r->reaction[origin], r->reaction[i]);
    }
}

static int prepare(run *r)
{
    case_file *c = &r->file;
    size_t nodes = (size_t)sb_body_node_count(r->body);
    r->displacement = (sb_vec3 *)calloc(nodes, sizeof(sb_vec3));
    r->reaction = (sb_vec3 *)calloc(nodes, sizeof(sb_vec3));
    r->probes = (probe *)calloc((size_t)c->statement_count, sizeof(probe));
    if (!r->displacement || !r->reaction || !r->probes)
        return case_fail_memory(c, 0);
    for (int i = 0; i < c->statement_count; i++)
        if (c->statements[i].form->kind == CASE_OUTPUT && c->statements[i].form->code == CASE_OUTPUT_PROBE)
            r->probes[r->probe_count++].statement = c->statements + i;
    return take_probes(r, 0) || case_fail_memory(c, 0);
}

/* ---- solving ------------------------------------------------------------------------------------------- */

static void after_load_step(void *user, const sb_step_info *info)
{
    run *r = (run *)user;
    r->newton = info->newton_iterations;
    show_progress(r, "load", (double)info->load_factor);
    if (!take_probes(r, (double)info->load_factor))
        snprintf(r->failure, sizeof r->failure, "out of memory for a probe");
}

static void solve_static(run *r)
{
    sb_static_options options = case_static_options(&r->file);
    sb_step_info info;
    sb_result result;
    options.progress = after_load_step;
    options.progress_user = r;
    result = sb_body_solve_static(r->body, &options, &info);
    r->steps = info.load_steps;
    r->newton = info.newton_iterations;
    r->pcg = info.pcg_iterations;
    take_state(r);
    if (result != SB_OK)
        snprintf(r->failure, sizeof r->failure, "the static solve stopped at load factor %g: %s",
                 (double)info.load_factor, info.error.message);
}

/* One time step; 0 when it fails or does not reach its tolerance. */
static int solve_step(run *r, double time, double dt)
{
    sb_step_info info;
    sb_result result = case_move_supports(&r->file, r->body, time);
    if (result != SB_OK) {
        snprintf(r->failure, sizeof r->failure, "t = %g s: %s", time, sb_result_string(result));
        return 0;
    }
    result = sb_body_step(r->body, (sb_real)dt, &info);
    r->newton += info.newton_iterations;
    r->pcg += info.pcg_iterations;
    if (result == SB_OK && !info.capped)
        return 1;
    snprintf(r->failure, sizeof r->failure, "time step %d, to t = %g s: %s", r->steps + 1, time,
             result != SB_OK ? info.error.message : "the residual does not get down to tol");
    if (result == SB_OK)
        snprintf(r->failure + strlen(r->failure), sizeof r->failure - strlen(r->failure),
                 ": it is %.3g after %d iterations", (double)info.residual, info.newton_iterations);
    return 0;
}

/* The time step of the case; auto: on the safe side of the stable one. 0 when there is none. */
static double time_step(run *r)
{
    sb_real stable;
    sb_error error;
    double dt = case_dt(&r->file);
    if (dt > 0)
        return dt;
    if (sb_body_stable_step(r->body, &stable, &error) == SB_OK)
        dt = 0.9 * (double)stable;
    if (!(dt > 0) || !(r->file.solve->number[CASE_END] / dt < 1e9)) {
        snprintf(r->failure, sizeof r->failure, "no stable step: %s",
                 dt > 0 ? "end= is more than 1e9 of them away" : error.message);
        return 0;
    }
    return dt;
}

static void solve_dynamic(run *r)
{
    double dt = time_step(r), last = 0;
    int count = dt > 0 ? case_step_count(&r->file, dt) : 0;
    for (int step = 1; step <= count; step++) {
        double time = case_step_time(&r->file, dt, step, count);
        if (!solve_step(r, time, time - last)) {
            sb_body_set_displacements(r->body, r->displacement); /* a capped step has moved it */
            return;
        }
        r->steps++;
        last = time;
        take_state(r);
        show_progress(r, "time", (double)step / (double)count);
        if (!take_probes(r, time)) {
            snprintf(r->failure, sizeof r->failure, "out of memory for a probe");
            return;
        }
    }
}

static void solve_modes(run *r)
{
    sb_modes_options options = sb_default_modes_options();
    sb_modes_info info = {0, 0, 0, 0, 0};
    sb_error error;
    size_t count = (size_t)r->file.solve->number[CASE_COUNT], nodes = (size_t)sb_body_node_count(r->body);
    options.mass = case_mass(&r->file);
    r->frequencies = (sb_real *)calloc(count, sizeof *r->frequencies);
    r->shapes = (sb_vec3 *)calloc(count, nodes * sizeof *r->shapes);
    if (!r->frequencies || !r->shapes)
        snprintf(r->failure, sizeof r->failure, "out of memory for the modes");
    else if (sb_body_modes(r->body, (int)count, &options, r->frequencies, r->shapes, &info, &error) != SB_OK)
        snprintf(r->failure, sizeof r->failure, "%.500s", error.message);
    else
        r->mode_count = (int)count;
    r->steps = info.iterations;
    r->pcg = info.pcg_iterations;
}

/* ---- writing ------------------------------------------------------------------------------------------- */

static void write_vector(FILE *file, sb_vec3 v)
{
    fprintf(file, " %.17g %.17g %.17g\n", (double)v.x, (double)v.y, (double)v.z);
}

/* What a file calls its nodes and elements: places from 0 in a case's mesh, numbers of other files. */
static int node_number(const run *r, int node) { return r->file.node_numbers ? r->file.node_numbers[node] : node; }
static int element_number(const run *r, int element)
{
    return r->file.element_numbers ? r->file.element_numbers[element] : element;
}

static void write_displacement(const run *r, const case_statement *s, FILE *file)
{
    (void)s;
    for (int i = 0; i < r->file.mesh.node_count; i++) {
        fprintf(file, "%d", node_number(r, i));
        write_vector(file, r->displacement[i]);
    }
}

static void write_reaction(const run *r, const case_statement *s, FILE *file)
{
    (void)s;
    for (int i = 0; i < r->file.mesh.node_count; i++)
        if (r->file.supports[i]) {
            fprintf(file, "%d", node_number(r, i));
            write_vector(file, r->reaction[i]);
        }
}

static void write_stress(const run *r, const case_statement *s, FILE *file)
{
    (void)s;
    for (int e = 0; e < sb_body_element_count(r->body); e++)
        for (int p = 0; p < sb_body_point_count(r->body); p++) {
            sb_mat3 t;
            int element = r->file.cut ? sb_cut_cell_element(r->file.cut, e) : e;
            if (element >= 0 && sb_body_stress(r->body, e, p, &t) == SB_OK)
                fprintf(file, "%d %d %.17g %.17g %.17g %.17g %.17g %.17g\n", element_number(r, element), p,
                        (double)t.m[0][0], (double)t.m[1][1], (double)t.m[2][2], (double)t.m[0][1], (double)t.m[1][2],
                        (double)t.m[0][2]);
        }
}

static void write_probe(const run *r, const case_statement *s, FILE *file)
{
    for (int i = 0; i < r->probe_count; i++)
        for (int k = 0; k < r->probes[i].count && r->probes[i].statement == s; k++) {
            fprintf(file, "%.17g", r->probes[i].rows[k].time);
            write_vector(file, r->probes[i].rows[k].displacement);
        }
}

static void write_frequencies(const run *r, const case_statement *s, FILE *file)
{
    (void)s;
    for (int i = 0; i < r->mode_count; i++)
        fprintf(file, "%d %.17g\n", i + 1, (double)r->frequencies[i]);
}

/* In the order of CASE_OUTPUT_... */
static void (*const writers[])(const run *, const case_statement *, FILE *) = {
    write_displacement, write_reaction, write_stress, write_probe, write_frequencies};

/* PREFIX and the name; NULL when memory is short. The caller frees it. */
static char *output_path(const run *r, const char *name)
{
    size_t prefix = strlen(r->prefix), length = strlen(name);
    char *path = (char *)malloc(prefix + length + 1);
    if (path) {
        memcpy(path, r->prefix, prefix);
        memcpy(path + prefix, name, length + 1);
    }
    return path;
}

/* Finds out before a long solve that a file cannot be written, or that it is the same as another output's (which may be
 * NULL); leaves no file where there was none. Returns 1, or 0 with why. */
static int can_write(const char *path, const char *other, const char **why)
{
    FILE *file = fopen(path, "rb");
    int existed = file != NULL, same;
    if (file)
        fclose(file);
    file = fopen(path, "ab");
    *why = "cannot be written";
    if (!file)
        return 0;
    fclose(file);
    same = other && is_same_file(path, other);
    if (!existed)
        remove(path);
    *why = "is written twice";
    return !same;
}

/* 1 when the path can be written without harm: no input, no output of a statement before `end`. */
static int check_output(run *r, int line, const char *path, const case_statement *end)
{
    const char *why;
    if (case_reads(&r->file, path, is_same_file))
        return case_fail(&r->file, line, "%.500s is read by this case: it would be overwritten", path);
    if (!can_write(path, NULL, &why))
        return case_fail(&r->file, line, "%.500s %s", path, why);
    for (const case_statement *s = r->file.statements; s < end; s++) {
        char *other = s->form->kind == CASE_OUTPUT ? output_path(r, s->path) : NULL;
        int ok = !other || can_write(path, other, &why);
        free(other);
        if (!ok)
            return case_fail(&r->file, line, "%.500s %s, the first time by line %d", path, why, s->line);
    }
    return 1;
}

static int check_outputs(run *r)
{
    case_file *c = &r->file;
    for (int i = 0; i < c->statement_count; i++) {
        const case_statement *s = c->statements + i;
        char *path;
        int ok;
        if (s->form->kind != CASE_OUTPUT)
            continue;
        path = output_path(r, s->path);
        ok = path ? check_output(r, s->line, path, s) : case_fail_memory(c, s->line);
        free(path);
        if (!ok)
            return 0;
    }
    return !r->vtk_path || check_output(r, 0, r->vtk_path, c->statements + c->statement_count);
}

static int write_output(run *r, const case_statement *s)
{
    char *path = output_path(r, s->path);
    sb_output out;
    int ok = path && sb_output_open(&out, path, NULL) == SB_OK;
    if (ok) {
        writers[s->form->code](r, s, out.file);
        ok = sb_output_close(&out, NULL) == SB_OK;
    }
    if (!ok)
        case_fail(&r->file, s->line, "cannot write %.500s", path ? path : s->path);
    free(path);
    return ok;
}

/* The mesh with its modes as fields mode_1, mode_2 ... */
static sb_result write_modes(const run *r, sb_error *error)
{
    sb_field *fields = (sb_field *)calloc((size_t)r->mode_count + 1, sizeof *fields);
    char(*names)[24] = (char(*)[24])calloc((size_t)r->mode_count + 1, sizeof *names);
    sb_result result = SB_ERROR_MEMORY;
    for (int i = 0; i < r->mode_count && fields && names; i++) {
        snprintf(names[i], sizeof names[i], "mode_%d", i + 1);
        fields[i].name = names[i];
        fields[i].location = SB_FIELD_NODES;
        fields[i].components = 3;
        fields[i].values = &r->shapes[(size_t)i * (size_t)sb_body_node_count(r->body)].x;
    }
    if (fields && names)
        result = sb_mesh_save_vtk(r->vtk_path, &r->file.mesh, fields, r->mode_count, error);
    free(fields);
    free(names);
    return result;
}

/* Skin and lips of a cut body with displacement, von Mises stress of their cells, and which are lips. */
static sb_result write_cut(const run *r, sb_error *error)
{
    sb_real *cells = (sb_real *)calloc((size_t)sb_body_element_count(r->body), sizeof(sb_real)), *von_mises = NULL;
    sb_field fields[3] = {{"displacement", SB_FIELD_NODES, 3, NULL},
                          {"von_mises", SB_FIELD_ELEMENTS, 1, NULL},
                          {"lip", SB_FIELD_ELEMENTS, 1, NULL}};
    sb_cut_surface *surface = NULL;
    sb_result result = sb_cut_surface_create(r->file.cut, NULL, &surface, error);
    sb_cut_drawing d = sb_cut_surface_get(surface);
    cut_file file;
    memset(&file, 0, sizeof file);
    von_mises = (sb_real *)calloc((size_t)d.triangle_count + 1, sizeof(sb_real));
    if (result == SB_OK && (!cells || !von_mises || !cut_file_make(&file, &d, NULL)))
        result = SB_ERROR_MEMORY;
    if (result == SB_OK) {
        sb_body_von_mises(r->body, cells);
        for (int i = 0; i < file.mesh.element_count; i++)
            von_mises[i] = d.cells[file.triangles[i]] < 0 ? 0 : cells[d.cells[file.triangles[i]]];
        fields[0].values = file.displacement, fields[1].values = von_mises, fields[2].values = file.lip;
        result = sb_mesh_save_vtk(r->vtk_path, &file.mesh, fields, 3, error);
    }
    cut_file_free(&file);
    free(cells);
    free(von_mises);
    sb_cut_surface_destroy(surface);
    return result;
}

/* The deformed mesh with displacement and von Mises stress. */
static sb_result write_deformed(const run *r, sb_error *error)
{
    sb_mesh mesh = r->file.mesh;
    sb_real *von_mises = (sb_real *)calloc((size_t)mesh.element_count, sizeof(sb_real));
    sb_vec3 *positions = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3));
    sb_field fields[2] = {{"displacement", SB_FIELD_NODES, 3, NULL}, {"von_mises", SB_FIELD_ELEMENTS, 1, NULL}};
    sb_result result = SB_ERROR_MEMORY;
    if (von_mises && positions) {
        memcpy(positions, sb_body_positions(r->body), (size_t)mesh.node_count * sizeof *positions);
        sb_body_von_mises(r->body, von_mises);
        mesh.nodes = positions;
        fields[0].values = &r->displacement[0].x;
        fields[1].values = von_mises;
        result = sb_mesh_save_vtk(r->vtk_path, &mesh, fields, 2, error);
    }
    free(von_mises);
    free(positions);
    return result;
}

static int write_vtk(run *r)
{
    sb_error error;
    sb_result result = r->file.solve->form->code == CASE_MODES ? write_modes(r, &error)
                       : r->file.cut                           ? write_cut(r, &error)
                                                               : write_deformed(r, &error);
    if (result == SB_ERROR_MEMORY)
        return case_fail_memory(&r->file, 0);
    return result == SB_OK || case_fail_library(&r->file, 0, &error);
}

static int write_all(run *r)
{
    for (int i = 0; i < r->file.statement_count; i++)
        if (r->file.statements[i].form->kind == CASE_OUTPUT && !write_output(r, r->file.statements + i))
            return 0;
    return !r->vtk_path || write_vtk(r);
}

/* ---- the program --------------------------------------------------------------------------------------- */

/* What was converted in the mesh, or not taken of it. */
static void print_notes(const run *r)
{
    for (int i = 0; i < r->file.mesh_report.note_count; i++)
        fprintf(stderr, "%s:%d: note: %s\n", r->case_path, r->file.mesh_statement->line, r->file.mesh_report.notes[i]);
    if (r->file.notes.text)
        fputs(r->file.notes.text, stderr);
}

/* What became of the cuts. */
static void print_crumbs(const run *r)
{
    for (int i = 0; i < r->file.statement_count && r->file.crumbs; i++)
        if (r->file.statements[i].form->kind == CASE_CUT) {
            fprintf(stderr, "%s:%d: note: the cuts leave parts smaller than an element, which are held: %d\n",
                    r->case_path, r->file.statements[i].line, r->file.crumbs);
            return;
        }
}

static int has_expectations(const case_file *c)
{
    for (int i = 0; i < c->statement_count; i++)
        if (c->statements[i].form->kind == CASE_EXPECT)
            return 1;
    return 0;
}

/* Whether the nodes are where the case expects them; says which are not. */
static int is_expected(const run *r)
{
    char row[40] = "";
    int ok = 1;
    if (r->vary)
        snprintf(row, sizeof row, "case %d of the table: ", r->row);
    for (int i = 0; i < r->file.statement_count; i++) {
        const case_statement *s = r->file.statements + i;
        sb_vec3 u;
        double off;
        if (s->form->kind != CASE_EXPECT)
            continue;
        u = r->displacement[s->node];
        off = (double)sb_v3_norm(sb_v3_sub(u, s->vector));
        if (off <= s->number[CASE_WITHIN])
            continue;
        fprintf(stderr, "%s:%d: %snode %d is displaced by %.9g,%.9g,%.9g m, %.3g m from what is expected\n",
                r->case_path, s->line, row, s->node, (double)u.x, (double)u.y, (double)u.z, off);
        ok = 0;
    }
    return ok;
}

/* Up to what the solve left; 0: the case is wrong, which is said. */
static int solve(run *r)
{
    if (!(r->vary ? case_vary_open(&r->file, r->case_path, r->vary, r->row) : case_open(&r->file, r->case_path)))
        return 0;
    if (!r->vary)
        print_notes(r);
    r->file.mass = r->mass_kind;
    if (!case_create_body(&r->file, &r->body) || !prepare(r) || (!r->vary && !check_outputs(r)))
        return 0;
    if (!r->vary)
        print_crumbs(r);
    if (r->file.solve->form->code == CASE_STATIC)
        solve_static(r);
    else if (r->file.solve->form->code == CASE_MODES)
        solve_modes(r);
    else
        solve_dynamic(r);
    progress_end();
    return 1;
}

static int solve_and_write(run *r)
{
    clock_t begin = clock();
    double seconds;
    if (!solve(r))
        return complain(r);
    seconds = (double)(clock() - begin) / (double)CLOCKS_PER_SEC;
    if (!write_all(r))
        return complain(r);
    if (r->failure[0]) {
        fprintf(stderr, "%s:%d: %s\n", r->case_path, r->file.solve->line, r->failure);
        return EXIT_NOT_SOLVED;
    }
    printf("converged steps=%d newton=%d pcg=%d seconds=%.3f\n", r->steps, r->newton, r->pcg, seconds);
    return is_expected(r) ? EXIT_CONVERGED : EXIT_NOT_EXPECTED;
}

static void release(run *r)
{
    for (int i = 0; i < r->probe_count; i++)
        free(r->probes[i].rows);
    free(r->probes);
    free(r->displacement);
    free(r->reaction);
    free(r->frequencies);
    free(r->shapes);
    case_free(&r->file);
    sb_body_destroy(r->body);
}

/* ---- studies ------------------------------------------------------------------------------------------- */

/* Text that grows. */
typedef struct line {
    char *text;
    size_t used, size;
    int out_of_memory;
} line;

static void add(line *l, const char *words)
{
    size_t length = strlen(words);
    if (l->used + length + 1 > l->size) {
        char *larger = (char *)realloc(l->text, 2 * (l->used + length + 1));
        l->out_of_memory = l->out_of_memory || !larger;
        if (!larger)
            return;
        l->text = larger;
        l->size = 2 * (l->used + length + 1);
    }
    memcpy(l->text + l->used, words, length + 1);
    l->used += length;
}

static void add_number(line *l, double number)
{
    char words[40];
    snprintf(words, sizeof words, ",%.17g", number);
    add(l, words);
}

static void add_count(line *l, const char *before, long long count)
{
    char words[64];
    snprintf(words, sizeof words, "%.30s%lld", before, count);
    add(l, words);
}

/* What all shards of a study have in common: of this case, table and kind of mass. Columns as the first case has them,
 * which is read for it. */
static int make_heading(run *r, line *l)
{
    const case_file *c = &r->file;
    char hash[40];
    int probes = 0;
    if (!case_start(&r->file, r->case_path))
        return 0;
    if (foreign_ends_in(r->case_path, "inp") || foreign_ends_in(r->case_path, "feb") ||
        foreign_ends_in(r->case_path, "msml.xml"))
        return case_fail(&r->file, 0, "a study needs a case file: case_convert makes one");
    snprintf(hash, sizeof hash, " %016llx %016llx", case_vary_hash(c->text), r->vary->hash);
    if (!case_vary_fill(&r->file, r->vary, 0) || !case_read_started(&r->file))
        return 0;
    add_count(l, "# case_solve cases=", r->vary->row_count);
    add(l, hash);
    add(l, r->mass ? " " : "");
    add(l, r->mass ? r->mass : "");
    add(l, "\ncase");
    for (int i = 0; i < r->vary->column_count; i++) {
        add(l, ",");
        add(l, r->vary->words[i]);
    }
    add(l, ",end,steps,newton");
    if (c->solve->form->code == CASE_MODES)
        for (int i = 1; i <= (int)c->solve->number[CASE_COUNT]; i++)
            add_count(l, ",f_hz_", i);
    else
        add(l, ",largest_m");
    for (int i = 0; i < c->statement_count && c->solve->form->code != CASE_MODES; i++)
        if (c->statements[i].form->kind == CASE_OUTPUT && c->statements[i].form->code == CASE_OUTPUT_PROBE)
            for (int axis = 0; axis < 3; axis++) {
                add_count(l, ",probe_", probes + (axis == 0));
                probes += axis == 0;
                add(l, axis == 0 ? "_x_m" : axis == 1 ? "_y_m" : "_z_m");
            }
    if (has_expectations(c))
        add(l, ",expected");
    add(l, "\n");
    return !l->out_of_memory || case_fail_memory(&r->file, 0);
}

static double largest_displacement(const run *r)
{
    double largest = 0;
    for (int i = 0; i < r->file.mesh.node_count; i++)
        largest = fmax(largest, (double)sb_v3_norm(r->displacement[i]));
    return largest;
}

static int make_row(run *r, line *l)
{
    l->used = 0;
    add_count(l, "", r->row);
    for (int i = 0; i < r->vary->column_count; i++) {
        add(l, ",");
        add(l, case_vary_word(r->vary, r->row + 1, i));
    }
    add(l, r->failure[0] ? ",failed" : ",converged");
    add_count(l, ",", r->steps);
    add_count(l, ",", r->newton);
    if (r->file.solve->form->code == CASE_MODES) {
        for (int i = 0; i < (int)r->file.solve->number[CASE_COUNT]; i++)
            if (i < r->mode_count)
                add_number(l, (double)r->frequencies[i]);
            else
                add(l, ",");
    } else {
        add_number(l, largest_displacement(r));
        for (int i = 0; i < r->probe_count; i++) {
            sb_vec3 u = r->displacement[r->probes[i].statement->node];
            add_number(l, (double)u.x);
            add_number(l, (double)u.y);
            add_number(l, (double)u.z);
        }
    }
    if (has_expectations(&r->file)) { /* a case that failed has none */
        r->is_amiss = !r->failure[0] && !is_expected(r);
        add(l, r->failure[0] ? "," : r->is_amiss ? ",no" : ",yes");
    }
    add(l, "\n");
    return !l->out_of_memory || case_fail_memory(&r->file, 0);
}

static run begin_case(const run *all, int row)
{
    run r;
    memset(&r, 0, sizeof r);
    r.case_path = all->case_path;
    r.mass = all->mass;
    r.mass_kind = all->mass_kind;
    r.vary = all->vary;
    r.row = row;
    return r;
}

static int run_case(const run *all, shard *s, int row, line *l)
{
    run r = begin_case(all, row);
    int status = EXIT_WRONG_CASE;
    if (!solve(&r) || !make_row(&r, l)) {
        fprintf(stderr, "%s: case %d of the table:\n", all->table, row);
        complain(&r);
    } else if (shard_write(s, l->text)) {
        status = r.failure[0] ? EXIT_NOT_SOLVED : r.is_amiss ? EXIT_NOT_EXPECTED : EXIT_CONVERGED;
        if (r.failure[0])
            fprintf(stderr, "%s:%d: case %d of the table: %s\n", r.case_path, r.file.solve->line, row, r.failure);
    }
    release(&r);
    return status;
}

static int run_cases(const run *all, shard *s, line *l)
{
    int status = EXIT_CONVERGED, cases = all->vary->row_count, failed = 0, amiss = 0;
    printf("study: %d cases, shard %d of %d, %d to do\n", cases, s->index + 1, s->count, s->left);
    for (int k = 0; k < cases && status != EXIT_WRONG_CASE; k++)
        if (shard_is_mine(s, k)) {
            status = run_case(all, s, k, l);
            failed += status == EXIT_NOT_SOLVED;
            amiss += status == EXIT_NOT_EXPECTED;
        }
    if (failed)
        fprintf(stderr, "study: %d cases failed, and their rows say so\n", failed);
    if (amiss)
        fprintf(stderr, "study: %d cases are not as expected, and their rows say so\n", amiss);
    return status == EXIT_WRONG_CASE ? status : EXIT_CONVERGED;
}

static int run_study(run *all)
{
    case_vary vary;
    shard s;
    line l;
    run first;
    int status = EXIT_WRONG_CASE;
    memset(&l, 0, sizeof l);
    if (!shard_parse("case_solve", all->share ? all->share : "1/1", &s))
        return EXIT_WRONG_CASE;
    if (!case_vary_read(&vary, all->table)) {
        fprintf(stderr, "%s\n", vary.message);
        case_vary_free(&vary);
        return EXIT_WRONG_CASE;
    }
    all->vary = &vary;
    first = begin_case(all, 0); /* for the columns */
    if (!make_heading(&first, &l))
        complain(&first);
    else if (shard_open(&s, all->study, l.text, vary.row_count))
        status = run_cases(all, &s, &l);
    shard_close(&s);
    release(&first);
    case_vary_free(&vary);
    free(l.text);
    return status;
}

/* ---- command line -------------------------------------------------------------------------------------- */

/* Where the value of an option goes; NULL: no such option. */
static const char **find_option(run *r, const char *name)
{
    if (strcmp(name, "-o") == 0)
        return &r->vtk_path;
    if (strcmp(name, "-p") == 0)
        return &r->prefix;
    if (strcmp(name, "--vary") == 0)
        return &r->table;
    if (strcmp(name, "--study") == 0)
        return &r->study;
    if (strcmp(name, "--shard") == 0)
        return &r->share;
    return strcmp(name, "--mass") == 0 ? &r->mass : NULL;
}

/* 1 when the arguments make sense. */
static int take_arguments(run *r, int argc, char **argv)
{
    for (int i = 1; i < argc; i++) {
        const char **option = find_option(r, argv[i]);
        if (option && (i + 1 == argc || *option))
            return 0;
        if (option)
            *option = argv[++i];
        else if (argv[i][0] == '-' || (r->case_path && r->vtk_path))
            return 0;
        else
            *(r->case_path ? &r->vtk_path : &r->case_path) = argv[i];
    }
    if (!r->table != !r->study || (r->share && !r->study) || (r->study && (r->vtk_path || r->prefix)))
        return 0;
    if (!r->prefix)
        r->prefix = "";
    for (r->mass_kind = r->mass ? 0 : -1; r->mass && r->mass_kind < 3; r->mass_kind++)
        if (strcmp(mass_names[r->mass_kind], r->mass) == 0)
            break;
    return r->case_path && r->mass_kind < 3;
}

static int program(int argc, char **argv)
{
    run r;
    int status;
    memset(&r, 0, sizeof r);
    if (argc == 2 && (strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0)) {
        fputs(help, stdout);
        fputs(help_notes, stdout);
        return EXIT_CONVERGED;
    }
    if (!take_arguments(&r, argc, argv)) {
        fputs("usage: case_solve CASE.case|MODEL.inp|MODEL.feb|MODEL.msml.xml [OUT.vtk] [-p PREFIX] [--mass KIND]\n"
              "       case_solve CASE.case --vary TABLE.csv --study ROWS.csv [--shard I/N] [--mass KIND]; see --help\n",
              stderr);
        return EXIT_WRONG_CASE;
    }
    status = r.study ? run_study(&r) : solve_and_write(&r);
    release(&r);
    return status;
}

int main(int argc, char **argv) { return finish("case_solve", program(argc, argv), EXIT_WRONG_CASE); }
