/* Files of MSML as cases: examples/case_msml.h. */
#include "softbody.h"

#include "check.h"
#include "foreign_cases.h"
#include "same_body.h"

#include "../examples/case_msml.h"
#include "../examples/case_write.h"

/* ---- models in memory -------------------------------------------------------------------------------------- */

static int read_text(case_file *c, const char *text)
{
    return read_foreign_text(c, msml_read, "build/test_msml.msml.xml", text);
}

/* A file in parts, so that one can be another. */
typedef struct model {
    const char *variables, *mesh, *material, *constraints, *workflow, *environment;
} model;

#define SPACE "<msml:msml xmlns:msml=\"http://sfb125.de/msml\">\n"
#define VARIABLES                                                                                                      \
    "<variables><var name=\"vol\" value=\"test_msml.vtk\"/><var name=\"E\" value=\"3000\"/>"                           \
    "<var name=\"up\" value=\"0 0.01 -0.02\"/><var name=\"also_E\" value=\"${E}\"/></variables>\n"
#define MESH "<mesh><linearTet id=\"m\" mesh=\"${vol}\"/></mesh>\n"
#define MATERIAL                                                                                                       \
    "<material><region id=\"r\" indices=\"${body}\"><linearElasticMaterial youngModulus=\"${also_E}\" "                \
    "poissonRatio=\"0.3\"/><mass name=\"a\" massDensity=\"100\"/></region></material>\n"
#define FIXED "<fixedConstraint forStep=\"${initial}\" indices=\"${leftGroup}\"/>"
#define GROUPS                                                                                                         \
    "<ComputeIndicesFromBoxROI id=\"body\" box=\"-1 -1 -1 9 9 9\" mesh=\"${vol}\" select=\"elements\"/>"               \
    "<boxROIToIndexOperator id=\"left\" box=\"0 0 0 0 1 1\" mesh=\"${vol}\" select=\"points\"/>"                       \
    "<ComputeIndicesFromBoxROI id=\"right\" box=\"2 0 0 2 1 1\" mesh=\"${vol}\" select=\"points\"/>"                   \
    "<ComputeIndicesFromBoxROI id=\"end\" box=\"2 0 0 2 1 1\" mesh=\"${vol}\" select=\"surfaceElements\"/>"
#define SOLVER "<environment><solver linearSolver=\"direct\" timeIntegration=\"dynamicImplicitEuler\"/>"
#define STEP(gravity)                                                                                                  \
    "<simulation><step name=\"initial\" dt=\"0.25\" iterations=\"8\"" gravity "/></simulation></environment>\n"

static const model beam = {VARIABLES, MESH, MATERIAL, FIXED, GROUPS, SOLVER STEP("")};
enum { VARIABLES_LINE = 2, MESH_LINE = 4, MATERIAL_LINE = 6, CONSTRAINTS_LINE, WORKFLOW_LINE, ENVIRONMENT_LINE };

static const char *join(const model *m)
{
    static char text[8192];
    snprintf(text, sizeof text,
             SPACE "%s<scene><object id=\"o\">\n%s"
                   "<sets><nodes><indexgroup id=\"leftGroup\" indices=\"${left}\"/></nodes></sets>\n%s"
                   "<constraints><constraint>%s</constraint></constraints></object></scene>\n"
                   "<workflow>%s</workflow>\n%s</msml:msml>\n",
             m->variables, m->mesh, m->material, m->constraints, m->workflow, m->environment);
    return text;
}

/* The mesh of the models: a beam of 2 m. */
static void save_beam(sb_element_type type, sb_real length)
{
    sb_mesh mesh;
    sb_error error;
    memset(&mesh, 0, sizeof mesh);
    CHECK_OK(sb_mesh_beam(type, 4, 2, 2, sb_v3(length, 1, 1), NULL, &mesh, &error));
    CHECK_OK(sb_mesh_save_vtk("build/test_msml.vtk", &mesh, NULL, 0, &error));
    sb_mesh_free(&mesh);
}

/* The text is the same body as the case with these statements about it. */
static void check_same(const char *text, const char *statements)
{
    static const char path[] = "build/test_msml.case", again[] = "build/test_msml_again.case";
    char whole[2048];
    case_file a, b, c;
    int ok = read_text(&a, text);
    if (!CHECK(ok))
        printf("  %s%s\n", a.faults.text ? a.faults.text : "", a.message);
    snprintf(whole, sizeof whole, "mesh test_msml.vtk\n%s", statements);
    ok = read_foreign_text(&b, case_read, path, whole) && ok;
    if (CHECK(ok)) {
        body_difference d = bodies_differ(&a, &b, 1);
        CHECK(d.same_elements && d.same_axes && d.same_solve);
        CHECK(d.nodes == 0 && d.materials == 0 && d.supports == 0 && d.loads == 0);
        CHECK(a.material.density == b.material.density);
        CHECK(a.solve->number[CASE_ALPHA] == b.solve->number[CASE_ALPHA]);
        CHECK(a.solve->number[CASE_BETA] == b.solve->number[CASE_BETA]);
        ok = case_write(&a, again, NULL) && case_read(&c, again);
        if (CHECK(ok)) {
            d = bodies_differ(&c, &b, 1);
            CHECK(d.same_elements && d.same_axes && d.same_solve && d.nodes == 0 && d.supports == 0 && d.loads == 0);
            case_free(&c);
        }
    } else {
        printf("  %s\n", b.message);
    }
    case_free(&a);
    case_free(&b);
}

static void check_refused(const char *text, int line, const char *words)
{
    case_file c;
    check_foreign_refused(&c, read_text(&c, text), line, words);
}

/* A model with one part exchanged is refused. */
static void refuse_part(const char **part, model *m, const char *text, int line, const char *words)
{
    *part = text;
    check_refused(join(m), line, words);
    *m = beam;
}

/* The notes on a model hold the words. */
static void check_note(const model *m, int line, const char *words)
{
    char place[64];
    case_file c;
    int ok = read_text(&c, join(m));
    snprintf(place, sizeof place, "msml.xml:%d: ", line);
    if (!CHECK(ok) || !CHECK(c.notes.text && strstr(c.notes.text, words) && strstr(c.notes.text, place)))
        printf("  %s%s\n", c.message, c.notes.text ? c.notes.text : "");
    case_free(&c);
}

/* ---- tests ------------------------------------------------------------------------------------------------- */

#define LAW "material linear E=3000 nu=0.3 density=100\n"
#define SOLVE "solve euler dt=0.25 end=2\n"
#define HOLD "select nodes l box=0,0,0,0,1,1\nfix xyz nodes=@l\n"
#define RIGHT "select nodes r box=2,0,0,2,1,1\n"

static void test_beams(void)
{
    model m = beam;
    save_beam(SB_TET4, 2);
    m.environment = SOLVER STEP(" gravity=\"-9.81 0 0.5 \"");
    check_same(join(&m), LAW SOLVE HOLD "gravity -9.81 0 0.5\n");
    m = beam;
    m.constraints = FIXED "<displacementConstraint name=\"d\" indices=\"${right}\" displacement=\"${up}\"/>";
    check_same(join(&m), LAW SOLVE HOLD RIGHT "prescribe xyz nodes=@r value=0,0.01,-0.02 ramp=2\n");
    m.constraints = FIXED "<forceConstraint indices=\"${right}\" force=\"0, 1 .5\"/>";
    check_same(join(&m), LAW SOLVE HOLD RIGHT "force nodes=@r value=0,1,.5\n");
    m.constraints = FIXED "<surfacePressure indices=\"${end}\" pressure=\"50\"/>";
    check_same(join(&m), LAW SOLVE HOLD "select faces r box=2,0,0,2,1,1\npressure faces=@r value=50\n");
    m = beam;
    m.environment = "<environment><solver timeIntegration=\"Newmark\" dampingRayleighRatioMass=\"0.2\" "
                    "dampingRayleighRatioStiffness=\"0.4\"/>" STEP("");
    check_same(join(&m), LAW "solve newmark dt=0.25 end=2 alpha=.2 beta=.4\n" HOLD);
}

static void test_materials(void)
{
    model m = beam;
    m.material = "<material><region id=\"r\" indices=\"${one}\"><corotatedElasticMaterial youngModulus=\"3000\" "
                 "poissonRatio=\"0.3\"/><mass massDensity=\"100\"/></region>"
                 "<region id=\"s\" indices=\"${two}\"><mass massDensity=\"100\"/><corotatedElasticMaterial "
                 "youngModulus=\"5e3\" poissonRatio=\"0.4\"/></region></material>\n";
    m.workflow =
        GROUPS "<ComputeIndicesFromBoxROI id=\"one\" box=\"0 0 0 1 1 1\" mesh=\"${vol}\" select=\"elements\"/>"
               "<ComputeIndicesFromBoxROI id=\"two\" box=\"1.01 0 0 2 1 1\" mesh=\"${vol}\" select=\"points\"/>";
    m.mesh = "<mesh><quadraticTet id=\"m\" mesh=\"${vol}\"/></mesh>\n";
    save_beam(SB_TET10, 2);
    check_same(join(&m), "material corotated E=3000 nu=0.3 density=100 elements=@a\nselect elements a box=0,0,0,1,1,1\n"
                         "material corotated E=5e3 nu=0.4 density=100 elements=@b\n"
                         "select elements b box=1.01,0,0,2,1,1\n" SOLVE HOLD);
    check_note(&m, WORKFLOW_LINE, "the elements whose middle is in the box");
    save_beam(SB_TET4, 2);
    check_refused(join(&m), MESH_LINE, "element tet10 does not fit the mesh");
}

/* Springs from the nodes of a group, in their order, to points. */
static void test_springs(void)
{
    model m = beam;
    case_file a, b;
    int ok;
    FILE *list = fopen("build/test_msml_springs", "w");
    save_beam(SB_TET4, 2);
    m.constraints = FIXED "<springMeshToFixed movingPoints=\"${at}\" fixedPoints=\"${to}\" stiffness=\"7\"/>";
    m.workflow = GROUPS "<ComputeIndicesFromBoxROI id=\"edge\" box=\"2 0 0 2 0 1\" mesh=\"${vol}\" select=\"points\"/>"
                        "<ExtractPointPositions id=\"at\" mesh=\"${vol}\" indices=\"${edge}\"/>";
    m.variables = "<variables><var name=\"vol\" value=\"test_msml.vtk\"/><var name=\"also_E\" value=\"3000\"/>"
                  "<var name=\"to\" value=\"2 0 .1 2 0 .2 2 0 .3\"/></variables>\n";
    ok = read_text(&a, join(&m));
    if (!CHECK(ok))
        printf("  %s%s\n", a.faults.text ? a.faults.text : "", a.message);
    for (int i = 0, k = 0; ok && list && i < a.mesh.node_count; i++)
        if (a.mesh.nodes[i].x == 2 && a.mesh.nodes[i].y == 0)
            fprintf(list, "%d 7 2 0 .%d\n", i, ++k);
    CHECK(list && fclose(list) == 0);
    ok = ok && read_foreign_text(&b, case_read, "build/test_msml.case",
                                 "mesh test_msml.vtk\n" LAW SOLVE HOLD "spring file=test_msml_springs\n");
    if (CHECK(ok)) {
        CHECK(bodies_differ(&a, &b, 1).loads == 0);
        case_free(&b);
    }
    case_free(&a);
    m.variables = VARIABLES;
    m.constraints = FIXED "<springMeshToFixed movingPoints=\"${at}\" fixedPoints=\"1 2 3\" stiffness=\"7\"/>";
    check_refused(join(&m), CONSTRAINTS_LINE, "has 3 numbers where 9 are expected");
}

/* A mesher's surface is stuffed, and its surface's faces are the mesh's. */
static void test_meshers(void)
{
    sb_mesh cube;
    sb_boundary skin;
    sb_error error;
    model m = beam;
    case_file a, b;
    int ok;
    memset(&cube, 0, sizeof cube);
    memset(&skin, 0, sizeof skin);
    CHECK_OK(sb_mesh_beam(SB_HEX8, 2, 2, 2, sb_v3(1, 1, 1), NULL, &cube, &error));
    CHECK_OK(sb_mesh_boundary(&cube, 1, NULL, &skin, &error));
    CHECK_OK(sb_mesh_save_vtk("build/test_msml_cube.vtk", &skin.surface, NULL, 0, &error));
    sb_mesh_free(&cube);
    sb_boundary_free(&skin);
    m.mesh = "<mesh><linearTet mesh=\"${tets}\"/></mesh>\n";
    m.constraints = "<fixedConstraint indices=\"${low}\"/><surfacePressure indices=\"${high}\" pressure=\"-2\"/>";
    m.workflow =
        "<mesherTetgen id=\"tets\" surfaceMesh=\"test_msml_cube.vtk\" meshFilename=\"out.vtk\" preserveBoundary=\"0\"/>"
        "<ExtractSurfaceMesh id=\"skin\" mesh=\"${tets}\"/>"
        "<boxROIToIndexOperator id=\"body\" box=\"-1 -1 -1 2 2 2\" mesh=\"${tets}\" select=\"elements\"/>"
        "<boxROIToIndexOperator id=\"low\" box=\"-1 -1 -1 2 2 .2\" mesh=\"${tets}\" select=\"points\"/>"
        "<boxROIToIndexOperator id=\"high\" box=\"-1 -1 .8 2 2 2\" mesh=\"${skin}\" select=\"elements\"/>";
    ok = read_text(&a, join(&m));
    CHECK(a.notes.text && strstr(a.notes.text, ":8: mesherTetgen: the surface is stuffed here, with 20 tets"));
    ok = read_foreign_text(&b, case_read, "build/test_msml.case",
                           "surface test_msml_cube.vtk\nstuff cells=20\n" LAW SOLVE
                           "select nodes l box=-1,-1,-1,2,2,.2\nfix xyz nodes=@l\n"
                           "select faces h box=-1,-1,.8,2,2,2\npressure faces=@h value=-2\n") &&
         ok;
    if (CHECK(ok)) {
        body_difference d = bodies_differ(&a, &b, 1);
        CHECK(d.same_elements && d.same_axes && d.nodes == 0 && d.loads == 0);
    }
    case_free(&a);
    case_free(&b);
}

static void test_notes(void)
{
    model m = beam;
    save_beam(SB_TET4, 2);
    m.workflow = GROUPS "<copyFile id=\"copy\" filename_in=\"${disp}\"/>";
    check_note(&m, WORKFLOW_LINE, "operator <copyFile> is left out");
    m = beam;
    m.material = "<material><region indices=\"${body}\"><linearElasticMaterial youngModulus=\"1\" poissonRatio=\"0\"/>"
                 "<mass massDensity=\"0.6\"/></region></material>\n";
    check_note(&m, MATERIAL_LINE, "a density of 0.6 kg/m^3: are the file's units SI's?");
    save_beam(SB_TET4, 200);
    m = beam;
    m.workflow = "<ComputeIndicesFromBoxROI id=\"body\" box=\"0 0 0 200 1 1\" mesh=\"${vol}\" select=\"elements\"/>"
                 "<ComputeIndicesFromBoxROI id=\"left\" box=\"0 0 0 0 1 1\" mesh=\"${vol}\" select=\"points\"/>";
    check_note(&m, MESH_LINE, "the mesh is 200 m long: are its lengths millimetres?");
}

/* Lines that end in CR LF, as editors of Windows have them. */
static void test_crlf(void)
{
    static char text[16384];
    const char *from = join(&beam);
    char *to = text;
    case_file c;
    save_beam(SB_TET4, 2);
    for (; *from; from++) {
        if (*from == '\n')
            *to++ = '\r';
        *to++ = *from;
        if (*from == ' ' && from[-1] == '0' && to < text + sizeof text - 1024)
            *to++ = '\r', *to++ = '\n'; /* between the numbers of a value, too */
    }
    *to = 0;
    if (!CHECK(read_text(&c, text)))
        printf("  %s\n", c.faults.text ? c.faults.text : c.message);
    case_free(&c);
}

static void test_mistakes(void)
{
    static const foreign_mistake expected[10] = {{11, "<contact> is not understood in <object>"},
                                                 {23, "duration= is not understood in <surfacePressure>"},
                                                 {9, "../beam.vtk is outside the folder"},
                                                 {34, "timeIntegration dynamicExplicit is not read"},
                                                 {14, "E=-3000 must be a number > 0"},
                                                 {20, "indices=\"${nothing}\""},
                                                 {30, "'zero' is no finite number"},
                                                 {21, "has 2 numbers where 3 are expected"},
                                                 {22, "is about points, but the box in line 29 selects elements"},
                                                 {31, "operator <closestPoint> is not read"}};
    check_foreign_mistakes(msml_read, "tests/data/mistakes.msml.xml", expected);
}

static void test_refused(void)
{
    model m = beam;
    save_beam(SB_TET4, 2);
    check_refused("", 1, "the file has no element");
    check_refused("<a/>", 1, "<a> is no <msml>");
    check_refused(SPACE "</msml:msml>\n<b/>", 3, "after the file's one element");
    refuse_part(&m.variables, &m, VARIABLES "<variables><var name=\"vol\" value=\"a\"/></variables>\n",
                VARIABLES_LINE + 1, "vol is there already");
    refuse_part(&m.variables, &m,
                "<variables><var name=\"vol\" value=\"test_msml.vtk\"/><var name=\"also_E\" value=\"${also_E}\"/>"
                "</variables>\n",
                MATERIAL_LINE, "names nothing that is there");
    refuse_part(
        &m.variables, &m,
        "<variables><var name=\"vol\" value=\"not_there.vtk\"/><var name=\"also_E\" value=\"1\"/></variables>\n",
        MESH_LINE, "not_there.vtk");
    refuse_part(&m.mesh, &m, "", ENVIRONMENT_LINE, "there is no <...> in a <mesh>");
    refuse_part(&m.mesh, &m, "<mesh><linearHex mesh=\"${vol}\"/><linearTet mesh=\"${vol}\"/></mesh>\n", MESH_LINE,
                "<linearHex> is not understood in <mesh>");
    refuse_part(&m.material, &m,
                "<material><region indices=\"${body}\"><linearElasticMaterial youngModulus=\"1\" poissonRatio=\"0\"/>"
                "</region></material>\n",
                MATERIAL_LINE, "a region needs a material and a <mass>");
    refuse_part(&m.material, &m,
                "<material><region indices=\"1 2 3\"><linearElasticMaterial youngModulus=\"1\" poissonRatio=\"0\"/>"
                "<mass massDensity=\"1e3\"/></region></material>\n",
                MATERIAL_LINE, "only groups by a box are read");
    refuse_part(&m.material, &m,
                "<material><region indices=\"${body}\"><linearElasticMaterial youngModulus=\"1\" poissonRatio=\"0.5\"/>"
                "<mass massDensity=\"1e3\"/></region></material>\n",
                MATERIAL_LINE, "nu=0.5 must be a number between -1 and 0.5");
    refuse_part(&m.constraints, &m, FIXED "<supportingMesh/>", CONSTRAINTS_LINE, "<supportingMesh> is not understood");
    refuse_part(&m.constraints, &m, FIXED "<fixedConstraint time=\"1\" indices=\"${left}\"/>", CONSTRAINTS_LINE,
                "time= of <fixedConstraint> is not read");
    refuse_part(&m.constraints, &m, FIXED "<fixedConstraint forStep=\"${second}\" indices=\"${left}\"/>",
                CONSTRAINTS_LINE, "is not the file's step, initial");
    refuse_part(&m.constraints, &m, FIXED "<forceConstraint indices=\"${right}\"/>", CONSTRAINTS_LINE, "needs force=");
    refuse_part(&m.constraints, &m,
                FIXED "<springMeshToFixed movingPoints=\"1 2 3\" fixedPoints=\"1 2 3\" stiffness=\"1\"/>",
                CONSTRAINTS_LINE, "ExtractPointPositions only");
    refuse_part(&m.workflow, &m,
                "<ComputeIndicesFromBoxROI id=\"body\" box=\"-1 -1 -1 9 9 9\" mesh=\"${vol}\" select=\"elements\"/>"
                "<ComputeIndicesFromBoxROI id=\"left\" box=\"0 0 0 0 1 1\" mesh=\"other.vtk\" select=\"points\"/>",
                WORKFLOW_LINE, "about another mesh");
    refuse_part(&m.workflow, &m,
                "<ComputeIndicesFromBoxROI id=\"body\" box=\"-1 -1 -1 9 9 9\" mesh=\"${vol}\" select=\"elements\"/>"
                "<ComputeIndicesFromBoxROI id=\"left\" box=\"5 0 0 0 1 1\" mesh=\"${vol}\" select=\"points\"/>",
                WORKFLOW_LINE, "the box is from 5 to 0");
    refuse_part(&m.workflow, &m,
                "<ComputeIndicesFromBoxROI id=\"body\" box=\"-1 -1 -1 9 9 9\" mesh=\"${vol}\" select=\"elements\"/>"
                "<ComputeIndicesFromBoxROI id=\"left\" box=\"5 0 0 6 1 1\" mesh=\"${vol}\" select=\"points\"/>",
                WORKFLOW_LINE, "the selection is empty");
    refuse_part(&m.workflow, &m,
                "<ComputeIndicesFromBoxROI id=\"body\" box=\"-1 -1 -1 9 9 9\" mesh=\"${vol}\" select=\"cells\"/>"
                "<ComputeIndicesFromBoxROI id=\"left\" box=\"0 0 0 0 1 1\" mesh=\"${vol}\" select=\"points\"/>",
                WORKFLOW_LINE, "select=\"cells\" is not read");
    refuse_part(&m.environment, &m, SOLVER "</environment>\n", ENVIRONMENT_LINE + 1, "there is no <step>");
    refuse_part(&m.environment, &m,
                SOLVER "<simulation><step dt=\"0.1\" iterations=\"1.5\"/></simulation></environment>", ENVIRONMENT_LINE,
                "must be an integer");
    refuse_part(&m.environment, &m, SOLVER "<simulation><step dt=\"0\" iterations=\"1\"/></simulation></environment>",
                ENVIRONMENT_LINE, "dt=0 must be a number > 0");
    refuse_part(&m.environment, &m,
                SOLVER "<simulation><step name=\"initial\" dt=\"1\" iterations=\"1\"/>\n<step dt=\"1\" "
                       "iterations=\"1\"/></simulation></environment>",
                ENVIRONMENT_LINE + 1, "a second <step>");
}

CHECK_SUITE(msml, {"beams as cases by hand", test_beams}, {"materials", test_materials}, {"springs", test_springs},
            {"meshers", test_meshers}, {"notes", test_notes}, {"lines that end in CR LF", test_crlf},
            {"ten mistakes", test_mistakes}, {"mistakes, one at a time", test_refused});
