/* Input files of FEBio as cases: examples/case_feb.h. */
#include "softbody.h"

#include "check.h"
#include "foreign_cases.h"
#include "same_body.h"

#include "../examples/case_feb.h"
#include "../examples/case_feb_write.h"
#include "../examples/case_write.h"

/* ---- models in memory -------------------------------------------------------------------------------------- */

/* 1 when the text is a case. */
static int read_text(case_file *c, const char *text)
{
    return read_foreign_text(c, feb_read, "build/test_feb.feb", text);
}

/* A file in parts, so that one can be another. */
typedef struct model {
    const char *head, *control, *material, *mesh, *domains, *data, *boundary, *loads, *courses, *end;
} model;

#define HEAD "<?xml version=\"1.0\"?>\n<febio_spec version=\"4.0\">\n<Module type=\"solid\"/>\n"
#define CONTROL                                                                                                        \
    "<Control><analysis>STATIC</analysis><time_steps>2</time_steps><step_size>.5</step_size>"                          \
    "<solver type=\"solid\"><rtol>1e-20</rtol></solver></Control>\n"
#define MATERIAL                                                                                                       \
    "<Material><material id=\"1\" name=\"Gel\" type=\"isotropic elastic\"><density>2</density><E>1000</E><v>0</v>"     \
    "</material></Material>\n"
/* A cube whose nodes and element have other numbers than places. */
#define MESH                                                                                                           \
    "<Mesh><Nodes name=\"All\"><node id=\"11\">0,0,0</node><node id=\"12\">1,0,0</node><node id=\"13\">1,1,0</node>"   \
    "<node id=\"14\">0,1,0</node><node id=\"15\">0,0,1</node><node id=\"16\">1,0,1</node><node id=\"17\">1,1,1</node>" \
    "<node id=\"18\">0,1,1</node></Nodes><Elements type=\"hex8\" name=\"Cube\">"                                       \
    "<elem id=\"5\">11,12,13,14,15,16,17,18</elem></Elements><NodeSet name=\"Base\">11:14</NodeSet>"                   \
    "<NodeSet name=\"Top\"><n id=\"15\"/><n id=\"16\"/><n id=\"17\"/><n id=\"18\"/></NodeSet>"                         \
    "<Surface name=\"Up\"><quad4 id=\"1\">15,16,17,18</quad4></Surface>"                                               \
    "<Surface name=\"Down\"><quad4 id=\"1\">18,17,16,15</quad4></Surface></Mesh>\n"
#define DOMAINS "<MeshDomains><SolidDomain name=\"Cube\" mat=\"Gel\"/></MeshDomains>\n"
#define CLAMP                                                                                                          \
    "<Boundary><bc type=\"zero displacement\" node_set=\"Base\"><x_dof>1</x_dof><y_dof>1</y_dof><z_dof>1</z_dof>"      \
    "</bc></Boundary>\n"
#define COURSES                                                                                                        \
    "<LoadData><load_controller id=\"1\" type=\"loadcurve\"><interpolate>LINEAR</interpolate>"                         \
    "<extend>CONSTANT</extend><points><pt>0,0</pt><pt>1,1</pt></points></load_controller></LoadData>\n"

static const model cube = {HEAD, CONTROL, MATERIAL, MESH, DOMAINS, "", CLAMP, "", COURSES, "</febio_spec>\n"};
enum { CONTROL_LINE = 4, MATERIAL_LINE, MESH_LINE, DOMAINS_LINE, BOUNDARY_LINE };

static const char *join(const model *m)
{
    static char text[8192];
    snprintf(text, sizeof text, "%s%s%s%s%s%s%s%s%s%s", m->head, m->control, m->material, m->mesh, m->domains, m->data,
             m->boundary, m->loads, m->courses, m->end);
    return text;
}

/* The displacement of a node by its number when the model is solved. */
static sb_vec3 solve_model(const model *m, int number)
{
    case_file c;
    return solve_foreign(&c, read_text(&c, join(m)), number);
}

/* The model is refused with one fault, in this line, whose words hold `words`. */
static void check_refused(const char *text, int line, const char *words)
{
    case_file c;
    check_foreign_refused(&c, read_text(&c, text), line, words);
}

/* ---- tests ------------------------------------------------------------------------------------------------- */

/* St.Venant-Kirchhoff's bar without a lateral strain: force E (l^3 - l)/2 at the stretch l. */
static double force_of(double stretch) { return 1000 * (stretch * stretch * stretch - stretch) / 2; }

static void test_loads(void)
{
    double tolerance = SB_REAL_IS_FLOAT ? 1e-5 : 1e-9;
    char loads[512];
    model m = cube;
    m.boundary = "<Boundary><bc type=\"zero displacement\" node_set=\"Base\"><x_dof>1</x_dof><y_dof>1</y_dof>"
                 "<z_dof>1</z_dof></bc><bc type=\"fix\" node_set=\"Top\"><dofs>x,y</dofs></bc></Boundary>\n";
    m.loads = loads;
    snprintf(loads, sizeof loads,
             "<Loads><nodal_load type=\"nodal_force\" node_set=\"Top\"><value lc=\"1\">0,0,%.17g</value></nodal_load>"
             "</Loads>\n",
             force_of(1.2) / 4);
    CHECK_NEAR(solve_model(&m, 15).z, 0.2, tolerance);
    snprintf(loads, sizeof loads,
             "<Loads><nodal_load type=\"nodal_load\" node_set=\"Top\"><dof>z</dof><scale lc=\"1\">%.17g</scale>"
             "</nodal_load></Loads>\n",
             force_of(0.9) / 4);
    CHECK_NEAR(solve_model(&m, 16).z, -0.1, tolerance);
    /* pressures push against the side that sees the nodes counter-clockwise; the area stays 1 */
    snprintf(loads, sizeof loads,
             "<Loads><surface_load type=\"pressure\" surface=\"Up\"><pressure lc=\"1\">%.17g</pressure>"
             "<linear>0</linear></surface_load></Loads>\n",
             -force_of(1.1));
    CHECK_NEAR(solve_model(&m, 17).z, 0.1, tolerance);
    snprintf(loads, sizeof loads,
             "<Loads><surface_load type=\"pressure\" surface=\"Down\"><pressure>%.17g</pressure></surface_load>"
             "</Loads>\n",
             force_of(1.1));
    CHECK_NEAR(solve_model(&m, 17).z, 0.1, tolerance);
    /* tractions are dead and of undeformed area, whichever side is named; both numbers may have a course */
    snprintf(loads, sizeof loads,
             "<Loads><surface_load type=\"traction\" surface=\"Down\"><scale lc=\"1\">%.17g</scale>"
             "<traction>0,0,2</traction><linear>1</linear></surface_load></Loads>\n",
             force_of(1.15) / 2);
    CHECK_NEAR(solve_model(&m, 17).z, 0.15, tolerance);
    snprintf(loads, sizeof loads,
             "<Loads><surface_load type=\"traction\" surface=\"Up\"><traction lc=\"1\">0,0,%.17g</traction>"
             "</surface_load></Loads>\n",
             force_of(0.95));
    CHECK_NEAR(solve_model(&m, 16).z, -0.05, tolerance);
    /* 2 kg, half of it at the top; a body force has the other sign than gravity, in either form */
    snprintf(loads, sizeof loads,
             "<Loads><body_load type=\"body force\"><force lc=\"1\">0,0,%.17g</force></body_load></Loads>\n",
             force_of(1.05) * -1);
    CHECK_NEAR(solve_model(&m, 18).z, 0.05, tolerance);
    snprintf(loads, sizeof loads, "<Loads><body_load type=\"const\"><z lc=\"1\">%.17g</z></body_load></Loads>\n",
             -force_of(1.05));
    CHECK_NEAR(solve_model(&m, 18).z, 0.05, tolerance);
}

static void test_supports(void)
{
    double tolerance = SB_REAL_IS_FLOAT ? 1e-6 : 1e-12;
    model m = cube;
    m.boundary = "<Boundary><bc type=\"fix\" node_set=\"Base\"><dofs>x,y,z</dofs></bc>"
                 "<bc type=\"prescribed displacement\" node_set=\"@surface:Up\"><dof>z</dof><value lc=\"1\">.25</value>"
                 "<relative>0</relative></bc></Boundary>\n";
    CHECK_NEAR(solve_model(&m, 15).z, 0.25, tolerance);
    m.boundary = "<Boundary><bc type=\"fix\" node_set=\"Base\"><dofs>x,y,z</dofs></bc>"
                 "<bc type=\"prescribe\" node_set=\"Top\"><dof>z</dof><scale lc=\"1\" type=\"map\">Way</scale></bc>"
                 "</Boundary>\n";
    m.data = "<MeshData><NodeData name=\"Way\" node_set=\"Top\"><node lid=\"1\">.1</node><node lid=\"2\">.2</node>"
             "<node lid=\"3\">.3</node><node lid=\"4\">.4</node></NodeData></MeshData>\n";
    for (int i = 0; i < 4; i++)
        CHECK_NEAR(solve_model(&m, 15 + i).z, 0.1 * (i + 1), tolerance);
    m.data = "";
    m.boundary = "<Boundary><bc type=\"fix\" node_set=\"Base\"><dofs>x,y,z</dofs></bc>"
                 "<bc type=\"prescribe\" node_set=\"@surface:Up\"><dof>x</dof><scale>.1</scale></bc>"
                 "<bc type=\"linear constraint\"><node>16</node><dof>z</dof><offset lc=\"2\">.05</offset>"
                 "<child_dof><node>16</node><dof>x</dof><value>2</value></child_dof></bc></Boundary>\n";
    m.courses = "<LoadData><load_controller id=\"2\"><points><pt>0,0</pt><pt>1,2</pt></points></load_controller>"
                "</LoadData>\n";
    CHECK_NEAR(solve_model(&m, 16).z, 0.3, tolerance);
}

/* Format 3.0 as FEBio's editor writes it, in a step, with CRLF and what changes nothing. */
static void test_step(void)
{
    model m = cube;
    case_file c;
    m.head = "<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>\r\n<febio_spec version=\"3.0\">\r\n"
             "<Module type=\"solid\"/>\r\n<Globals><Constants><T>0</T></Constants></Globals>\r\n";
    m.control = "<Contact></Contact>\r\n";
    m.material = "<Material><material id=\"1\" name=\"Gel\" type=\"neo-Hookean\"><density>1000</density><E>1e3</E>"
                 "<v>.45</v></material></Material>\r\n";
    m.boundary = "<Step><step id=\"1\" name=\"Step1\"><Control><analysis>DYNAMIC</analysis><time_steps>8</time_steps>"
                 "<step_size>.25</step_size><solver><max_refs>15</max_refs><rhoi>-2</rhoi></solver></Control>"
                 "<Boundary><bc type=\"fix\" node_set=\"Base\"><dofs>x,y,z</dofs></bc>"
                 "<bc type=\"prescribe\" node_set=\"Top\"><dof>z</dof><scale lc=\"1\">.1</scale></bc></Boundary>"
                 "</step></Step>\r\n";
    m.courses = "<LoadData><load_controller id=\"1\" type=\"loadcurve\"><interpolate>LINEAR</interpolate>"
                "<points><point>0,0</point><point>.5,1</point></points></load_controller></LoadData>\r\n";
    int ok = read_text(&c, join(&m));
    /* the controller comes after the step that is dynamic: LINEAR is what it must be */
    if (!CHECK(ok)) {
        printf("%s%s\n", c.faults.text ? c.faults.text : "", c.message);
    } else {
        CHECK_INT(c.solve->form->code, SB_NEWMARK);
        CHECK(c.solve->number[CASE_DT] == 0.25 && c.solve->number[CASE_END] == 2);
        CHECK_INT(c.material.model, SB_NEO_HOOKEAN);
        CHECK_INT(c.notes.count, 0);
        for (int i = 0; i < c.statement_count; i++)
            if (c.statements[i].form->kind == CASE_PRESCRIBE)
                CHECK(c.statements[i].number[CASE_RAMP] == 0.5 && c.statements[i].count == 4);
    }
    case_free(&c);
}

static int check_round(const char *path, double rounding);

/* Two steps: what stands in the first is gone in the second, courses go on. */
#define STEP_CONTROL(steps)                                                                                            \
    "<Control><analysis>STATIC</analysis><time_steps>" steps "</time_steps><step_size>.25</step_size>"                 \
    "<solver><rtol>1e-20</rtol></solver></Control>\n"
static void test_steps(void)
{
    double tolerance = SB_REAL_IS_FLOAT ? 1e-5 : 1e-9;
    char loads[2048];
    model m = cube;
    case_file c;
    m.control = "";
    m.boundary = "<Boundary><bc type=\"zero displacement\" node_set=\"Base\"><x_dof>1</x_dof><y_dof>1</y_dof>"
                 "<z_dof>1</z_dof></bc><bc type=\"fix\" node_set=\"Top\"><dofs>x,y</dofs></bc></Boundary>\n";
    m.loads = loads;
    /* the second load has come half of its way at the end, 1 s; the first and the support of step 1 are gone */
    snprintf(loads, sizeof loads,
             "<Step><step id=\"1\">" STEP_CONTROL("2") //
             "<Boundary><bc type=\"prescribe\" node_set=\"Top\"><dof>z</dof><scale>.4</scale></bc></Boundary>"
             "<Loads><nodal_load type=\"nodal_force\" node_set=\"Top\"><value>0,0,7</value></nodal_load>"
             "<surface_load type=\"pressure\" surface=\"Up\"><pressure>9</pressure></surface_load></Loads></step>"
             "<step id=\"2\">" STEP_CONTROL("2") //
             "<Loads><surface_load type=\"traction\" surface=\"Up\"><traction lc=\"1\">0,0,%.17g</traction>"
             "</surface_load></Loads></step></Step>\n",
             force_of(1.2));
    m.courses = "<LoadData><load_controller id=\"1\"><interpolate>LINEAR</interpolate><points><pt>0,0</pt><pt>.5,0</pt>"
                "<pt>1.5,2</pt></points></load_controller></LoadData>\n";
    CHECK_NEAR(solve_model(&m, 15).z, 0.2, tolerance);
    CHECK(read_text(&c, join(&m)));
    CHECK_INT(c.notes.count, 1);
    CHECK_NEAR(c.solve->number[CASE_STEPS], 4, 0);
    case_free(&c);
    check_refused((snprintf(loads, sizeof loads,
                            "<Step><step id=\"1\"><Control><analysis>DYNAMIC</analysis></Control></step>"
                            "<step id=\"2\">" STEP_CONTROL("2") "</step></Step>\n"),
                   join(&m)),
                  8, "several steps are read when all of them are STATIC");
    check_refused((snprintf(loads, sizeof loads,
                            "<Step><step id=\"1\"></step><step id=\"2\">" STEP_CONTROL("2") "</step></Step>\n"),
                   join(&m)),
                  8, "the step before has no Control");
    check_refused(
        (snprintf(loads, sizeof loads, "<Step><step id=\"1\">" STEP_CONTROL("2") "</step></Step><Step></Step>\n"),
         join(&m)),
        9, "a second Step");
    m.courses =
        "<LoadData><load_controller id=\"1\"><points><pt>0,0</pt><pt>0,1</pt></points></load_controller></LoadData>\n";
    check_refused(
        (snprintf(loads, sizeof loads,
                  "<Step><step id=\"1\">" STEP_CONTROL("2") "</step><step id=\"2\">" STEP_CONTROL("2") //
                  "<Loads><nodal_load type=\"nodal_load\" node_set=\"Top\"><dof>z</dof><scale lc=\"1\">7</scale>"
                  "</nodal_load></Loads></step></Step>\n"),
         join(&m)),
        10, "no ascending times");
}

/* The nodes of hex27: FEBio's products of R, S and T, by which it numbers them. */
static void test_hex27(void)
{
    static const int febio[27][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}, {1, 1, 1},
                                     {0, 1, 1}, {2, 0, 0}, {1, 2, 0}, {2, 1, 0}, {0, 2, 0}, {2, 0, 1}, {1, 2, 1},
                                     {2, 1, 1}, {0, 2, 1}, {0, 0, 2}, {1, 0, 2}, {1, 1, 2}, {0, 1, 2}, {2, 0, 2},
                                     {1, 2, 2}, {2, 1, 2}, {0, 2, 2}, {2, 2, 0}, {2, 2, 1}, {2, 2, 2}};
    static const char path[] = "build/test_feb_round.case";
    const double at[3] = {0, 1, 0.5};
    char text[8192];
    int length = 0, width = 27;
    sb_mesh mesh;
    model m = cube;
    case_file c;
    length += snprintf(text + length, sizeof text - (size_t)length, "<Mesh><Nodes name=\"All\">");
    for (int i = 0; i < width; i++)
        length += snprintf(text + length, sizeof text - (size_t)length, "<node id=\"%d\">%g,%g,%g</node>", i + 1,
                           at[febio[i][0]], at[febio[i][1]], at[febio[i][2]]);
    length += snprintf(text + length, sizeof text - (size_t)length,
                       "</Nodes><Elements type=\"hex27\" name=\"Cube\"><elem id=\"1\">");
    for (int i = 0; i < width; i++)
        length += snprintf(text + length, sizeof text - (size_t)length, "%s%d", i ? "," : "", i + 1);
    snprintf(text + length, sizeof text - (size_t)length,
             "</elem></Elements><NodeSet name=\"Base\">1:4</NodeSet><Surface name=\"Up\"><quad9 id=\"1\">"
             "5,6,7,8,13,14,15,16,26</quad9></Surface></Mesh>\n");
    m.mesh = text;
    m.loads =
        "<Loads><surface_load type=\"traction\" surface=\"Up\"><traction>0,0,2</traction></surface_load></Loads>\n";
    if (!CHECK(read_text(&c, join(&m))))
        printf("%s%s\n", c.faults.text ? c.faults.text : "", c.message);
    CHECK_OK(sb_mesh_beam(SB_HEX27, 1, 1, 1, sb_v3(1, 1, 1), NULL, &mesh, NULL));
    for (int a = 0; a < width && c.mesh.element_count == 1; a++)
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(c.mesh.nodes[c.mesh.elements[a]], mesh.nodes[mesh.elements[a]])), 0, 1e-15);
    sb_mesh_free(&mesh);
    CHECK(case_write(&c, path, NULL));
    case_free(&c);
    CHECK_INT(check_round(path, 0), 1);
}

/* Laws, and what is said of them. */
static void test_materials(void)
{
    static const struct {
        const char *text;
        sb_material_model model;
        double c10, c01, d1;
        int notes;
    } laws[] = {{"type=\"Mooney-Rivlin\"><c1>5</c1><c2>3</c2><k>100</k><pressure_model>Abaqus</"
                 "pressure_model><density>1</density>",
                 SB_MOONEY_RIVLIN, 5, 3, 0.02, 1},
                {"type=\"Mooney-Rivlin\"><c1>5</c1><c2>0</c2><k>100</k><density>1</density>", SB_NEO_HOOKEAN_ISOCHORIC,
                 5, 0, 0.02, 2},
                {"type=\"incomp neo-Hookean\"><G>10</G><k>100</k>", SB_NEO_HOOKEAN_ISOCHORIC, 5, 0, 0.02, 3},
                {"type=\"Yeoh\"><c1>5</c1><c2>-2</c2><c3>3</c3><c4>0</c4><k>100</k><pressure_model>2</pressure_model>"
                 "<density>1</density>",
                 SB_REDUCED_POLYNOMIAL, 5, 0, 0.02, 1}};
    for (int i = 0; i < 4; i++) {
        char material[512];
        model m = cube;
        case_file c;
        snprintf(material, sizeof material, "<Material><material id=\"1\" name=\"Gel\" %s</material></Material>\n",
                 laws[i].text);
        m.material = material;
        CHECK(read_text(&c, join(&m)));
        CHECK_INT(c.material.model, laws[i].model);
        CHECK_NEAR(c.material.c10, laws[i].c10, 0);
        CHECK_NEAR(c.material.c01, laws[i].c01, 0);
        CHECK_NEAR(c.material.d1, (sb_real)laws[i].d1, 1e-17);
        if (i == 3)
            CHECK(c.material.c20 == -2 && c.material.c30 == 3);
        if (!CHECK_INT(c.notes.count, laws[i].notes)) /* mixed elements, the term of volume, the density */
            printf("%s", c.notes.text ? c.notes.text : "");
        case_free(&c);
    }
}

/* A file with ten mistakes gets a list of ten lines. */
static void test_mistakes(void)
{
    static const foreign_mistake expected[10] = {{3, "Module biphasic is not read"},
                                                 {6, "'none' is no finite number"},
                                                 {9, "material type Ogden is not read"},
                                                 {13, "'zero' is no finite number"},
                                                 {14, "id 0 must be > 0"},
                                                 {16, "elements penta6 are not read"},
                                                 {21, "there are no Elements Other"},
                                                 {24, "there is no node set Base"},
                                                 {25, "bc rigid is not read"},
                                                 {28, "<contact> is not understood in <Contact>"}};
    check_foreign_mistakes(feb_read, "tests/data/mistakes.feb", expected);
}

/* A model with one part exchanged is refused. */
static void refuse_part(const char **part, model *m, const char *text, int line, const char *words)
{
    *part = text;
    check_refused(join(m), line, words);
    *m = cube;
}

static void test_refused(void)
{
    model m = cube;
    check_refused("", 1, "the file has no element");
    check_refused("<a/>", 1, "<a> is no <febio_spec>");
    check_refused("<febio_spec version=\"2.5\"></febio_spec>", 1, "format 2.5 is not read");
    check_refused(HEAD "</febio_spec>\n<b/>", 5, "after the file's one element");
    refuse_part(&m.control, &m, "", BOUNDARY_LINE + 1, "there is no Control");
    refuse_part(&m.control, &m, "<Control><time_steps>1.5</time_steps></Control>\n", CONTROL_LINE,
                "must be an integer");
    refuse_part(&m.control, &m, "<Control><step_size>0</step_size></Control>\n", CONTROL_LINE, "must be > 0");
    refuse_part(&m.control, &m, "<Control><analysis>MODAL</analysis></Control>\n", CONTROL_LINE, "analysis MODAL");
    refuse_part(&m.control, &m, "<Control><analysis>DYNAMIC</analysis><solver><rhoi>.5</rhoi></solver></Control>\n",
                CONTROL_LINE, "Newmark's scheme");
    refuse_part(&m.control, &m, "<Control><solver type=\"explicit-solid\"/></Control>\n", CONTROL_LINE,
                "solver explicit-solid");
    refuse_part(&m.material, &m, "", DOMAINS_LINE - 1, "there is no material Gel");
    refuse_part(&m.material, &m,
                "<Material><material id=\"1\" name=\"Gel\" type=\"neo-Hookean\"><density>1</density><E lc=\"1\">1</E>"
                "<v>0</v></material></Material>\n",
                MATERIAL_LINE, "depends on place or time");
    refuse_part(&m.material, &m,
                "<Material><material id=\"1\" name=\"Gel\" type=\"Mooney-Rivlin\"><density>1</density><c1>1</c1>"
                "</material></Material>\n",
                MATERIAL_LINE, "k > 0");
    refuse_part(&m.domains, &m, "", MESH_LINE, "have no SolidDomain");
    refuse_part(&m.domains, &m, "<MeshDomains><ShellDomain name=\"Cube\" mat=\"Gel\"/></MeshDomains>\n", DOMAINS_LINE,
                "<ShellDomain> is not understood");
    refuse_part(&m.boundary, &m, "<Boundary><bc node_set=\"Base\"/></Boundary>\n", BOUNDARY_LINE, "needs type=");
    refuse_part(&m.boundary, &m, "<Boundary><bc type=\"fix\" node_set=\"@edge:Up\"><dofs>x</dofs></bc></Boundary>\n",
                BOUNDARY_LINE, "@edge:Up is not understood");
    refuse_part(&m.boundary, &m,
                "<Boundary><bc type=\"fix\" node_set=\"@surface:Left\"><dofs>x</dofs></bc></Boundary>\n", BOUNDARY_LINE,
                "no surface Left");
    refuse_part(&m.boundary, &m, "<Boundary><bc type=\"fix\" node_set=\"Base\"><dofs>w</dofs></bc></Boundary>\n",
                BOUNDARY_LINE, "'w' is no axis");
    refuse_part(
        &m.boundary, &m,
        "<Boundary><bc type=\"prescribe\" node_set=\"Top\"><dof>z</dof><scale lc=\"7\">1</scale></bc></Boundary>\n",
        BOUNDARY_LINE, "no amplitude 7");
    refuse_part(&m.boundary, &m,
                "<Boundary><bc type=\"prescribe\" node_set=\"Top\"><dof>z</dof><scale type=\"map\">Way</scale></bc>"
                "</Boundary>\n",
                BOUNDARY_LINE, "there is no NodeData Way");
    refuse_part(&m.boundary, &m,
                "<Boundary><bc type=\"linear constraint\"><node>16</node><dof>z</dof></bc></Boundary>\n", BOUNDARY_LINE,
                "without <child_dof>");
    refuse_part(&m.loads, &m,
                "<Loads><surface_load type=\"fluidnormal\" surface=\"Up\"><traction>0,0,1</traction></surface_load>"
                "</Loads>\n",
                BOUNDARY_LINE + 1, "surface_load fluidnormal is not read");
    refuse_part(&m.loads, &m,
                "<Loads><surface_load type=\"traction\" surface=\"Up\"><scale>1</scale></surface_load></Loads>\n",
                BOUNDARY_LINE + 1, "a traction needs <traction>");
    refuse_part(
        &m.loads, &m,
        "<Loads><surface_load type=\"traction\" surface=\"Up\"><traction>0,0</traction></surface_load></Loads>\n",
        BOUNDARY_LINE + 1, "2 numbers where 3 are expected");
    refuse_part(&m.loads, &m,
                "<Loads><surface_load type=\"traction\" surface=\"Up\"><traction>0,0,1</traction>"
                "<shell_bottom>1</shell_bottom></surface_load></Loads>\n",
                BOUNDARY_LINE + 1, "<shell_bottom> is not understood");
    refuse_part(&m.loads, &m,
                "<Loads><surface_load type=\"traction\" surface=\"Left\"><traction>0,0,1</traction></surface_load>"
                "</Loads>\n",
                BOUNDARY_LINE + 1, "there is no surface Left");
    refuse_part(&m.material, &m,
                "<Material><material id=\"1\" name=\"Gel\" type=\"Yeoh\"><density>1</density><c1>1</c1><c2>1</c2>"
                "<c4>1</c4><k>9</k></material></Material>\n",
                MATERIAL_LINE, "has a c4");
    refuse_part(
        &m.material, &m,
        "<Material><material id=\"1\" name=\"Gel\" type=\"Mooney-Rivlin\"><density>1</density><c1>1</c1><c2>1</c2>"
        "<c3>1</c3><k>9</k></material></Material>\n",
        MATERIAL_LINE, "has a c3");
    refuse_part(&m.loads, &m,
                "<Loads><surface_load type=\"pressure\" surface=\"Up\"><pressure>1</pressure><linear>1</linear>"
                "</surface_load></Loads>\n",
                BOUNDARY_LINE + 1, "pressures follow the faces");
    refuse_part(
        &m.loads, &m,
        "<Loads><surface_load type=\"pressure\" surface=\"Left\"><pressure>1</pressure></surface_load></Loads>\n",
        BOUNDARY_LINE + 1, "there is no surface Left");
    refuse_part(&m.loads, &m, "<Loads><body_load type=\"centrifugal\"/></Loads>\n", BOUNDARY_LINE + 1,
                "body_load centrifugal is not read");
    refuse_part(&m.courses, &m,
                "<LoadData><load_controller id=\"1\" type=\"math\"><math>t</math></load_controller></LoadData>\n",
                BOUNDARY_LINE + 1, "load_controller math is not read");
}

/* What a dynamic analysis cannot have is refused wherever its Control stands. */
static void test_order(void)
{
    static const char control[] =
        "<Step><step id=\"1\"><Control><analysis>DYNAMIC</analysis></Control></step></Step>\n";
    model m = cube;
    m.control = "";
    m.loads = control;
    m.boundary = "<Boundary><bc type=\"linear constraint\"><node>16</node><dof>z</dof><offset>.1</offset>"
                 "<child_dof><node>15</node><dof>z</dof><value>1</value></child_dof></bc></Boundary>\n";
    check_refused(join(&m), BOUNDARY_LINE - 1, "an offset in a dynamic analysis");
    m.boundary = "<LoadData><load_controller id=\"1\"><interpolate>SMOOTH</interpolate><points><pt>0,0</pt><pt>1,1</pt>"
                 "</points></load_controller></LoadData>\n";
    m.courses = "";
    check_refused(join(&m), BOUNDARY_LINE - 1, "interpolate LINEAR only");
}

/* Whether FEBio can say a case: all laws but this. */
static int is_sayable(const case_file *c)
{
    for (int i = 0; i < c->statement_count; i++)
        if (c->statements[i].form->kind == CASE_MATERIAL && c->statements[i].form->code == SB_LINEAR)
            return 0;
    return 1;
}

/* Reads a case, writes it as a file of FEBio, reads and writes that as a case again, and reads it: the bodies of all
 * three are the same; how far D1 may be off (k = 2/D1 has not all of them): `rounding`. 0: FEBio cannot say it. */
static int check_round(const char *path, double rounding)
{
    static const char feb[] = "build/test_feb_round.feb", again[] = "build/test_feb_round.case";
    case_file a, b, c;
    int ok = case_read(&a, path), sayable = ok && is_sayable(&a);
    CHECK(ok);
    ok = feb_write(&a, feb, 0);
    if (!CHECK_INT(ok, sayable))
        printf("%s:%d: %s\n", path, a.error_line, a.message);
    if (!ok) {
        case_free(&a);
        return 0;
    }
    ok = feb_read(&b, feb) && case_write(&b, again, NULL);
    if (!CHECK(ok))
        printf("%s: %s%s\n", path, b.faults.text ? b.faults.text : "", b.message);
    ok = case_read(&c, again) && ok;
    if (!CHECK(ok)) {
        printf("%s: %d: %s\n", path, c.error_line, c.message);
    } else {
        body_difference d = bodies_differ(&a, &b, a.mesh.node_count < 1500), e = bodies_differ(&a, &c, 0);
        double most = fmax(fmax(d.nodes, d.supports), fmax(e.nodes, e.supports));
        CHECK(d.same_elements && d.same_axes && d.same_solve && e.same_elements && e.same_axes && e.same_solve);
        CHECK_INT(b.notes.count, 0);
        CHECK(a.material.density == c.material.density);
        CHECK(a.solve->number[CASE_STEPS] == c.solve->number[CASE_STEPS]);
        CHECK(a.solve->number[CASE_TOL] == c.solve->number[CASE_TOL]);
        if (!CHECK(most == 0 && d.loads == 0 && d.materials <= rounding && e.materials <= rounding))
            printf("%s: nodes %.1e, materials %.1e, supports %.1e, loads %.1e\n", path, d.nodes, d.materials,
                   d.supports, d.loads);
    }
    case_free(&a);
    case_free(&b);
    case_free(&c);
    return 1;
}

static void test_reference(void)
{
    int sayable = 0, count = 0;
    for (int i = 0; i < REFERENCE_COUNT; i++) {
        char path[512];
        if (!reference_path(path, sizeof path, i, "case.case")) {
            CHECK_SKIP("no ../shared/reference");
            return;
        }
        if (strstr(path, "fine") && !getenv("CHECK_SLOW"))
            continue;
        sayable += check_round(path, strstr(path, "rp2_") ? 3e-16 : 0); /* its D1 */
        count++;
    }
    printf("  %d of %d reference cases are said in FEBio's words\n", sayable, count);
    CHECK(sayable >= 20);
}

static void test_random(void)
{
    static const char *const laws[] = {"svk E=%.17g nu=.3", "neo_hookean C10=%.17g D1=1e-5",
                                       "mooney_rivlin C10=%.17g C01=-1.5 D1=3.3333333333333333e-4",
                                       "neo_hookean E=%.17g nu=.45"};
    static const char *const others[] = {"reduced_polynomial C10=%.17g C20=12.5 D1=1e-5", "svk E=%.17g nu=.3",
                                         "reduced_polynomial C10=%.17g C20=-1 C30=.3 D1=3.3333333333333333e-4",
                                         "neo_hookean E=%.17g nu=.45"};
    unsigned long long state = 2027;
    for (int i = 0; i < check_rounds(50); i++) {
        write_random_case("build/test_feb_random", i % 2 ? others : laws, 1, &state);
        CHECK_INT(check_round("build/test_feb_random.case", 3e-16), 1);
    }
}

CHECK_SUITE(feb, {"loads", test_loads}, {"supports", test_supports}, {"a step of format 3.0", test_step},
            {"two steps", test_steps}, {"hex27", test_hex27}, {"materials", test_materials},
            {"ten mistakes", test_mistakes}, {"mistakes, one at a time", test_refused},
            {"sections in any order", test_order}, {"reference cases there and back", test_reference},
            {"random cases there and back", test_random});
