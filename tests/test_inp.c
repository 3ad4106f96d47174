/* Input files of Abaqus and CalculiX as cases: examples/case_inp.h. */
#include "softbody.h"

#include "check.h"
#include "foreign_cases.h"
#include "same_body.h"

#include "../examples/case_inp_write.h"
#include "../examples/case_write.h"

#include <time.h>

/* ---- models in memory -------------------------------------------------------------------------------------- */

/* 1 when the text is a case. */
static int read_text(case_file *c, const char *text)
{
    return read_foreign_text(c, inp_read, "build/test_inp.inp", text);
}

/* A cube with its nodes 1 to 8 and its element 1, all of it but the step; lines 1 to 19. */
#define CUBE_MESH                                                                                                      \
    "*NODE, NSET=ALL\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,0,0,1\n6,1,0,1\n7,1,1,1\n8,0,1,1\n"                        \
    "*ELEMENT, TYPE=C3D8, ELSET=ALL\n1,1,2,3,4,5,6,7,8\n*NSET, NSET=TOP, GENERATE\n5,8\n"
#define CUBE CUBE_MESH "*MATERIAL, NAME=M\n*ELASTIC\n1000,0\n*DENSITY\n2\n*SOLID SECTION, ELSET=ALL, MATERIAL=M\n"
#define CLAMP "*BOUNDARY\n1,1,3\n2,1,3\n3,1,3\n4,1,3\n"
enum { AFTER_CUBE = 19, AFTER_CLAMP = 24 };

/* Solves a static model, which lacks the last *END STEP, and gives the displacement of a node by its number. */
static sb_vec3 solve_text(const char *steps, int number)
{
    char text[4200];
    case_file c;
    snprintf(text, sizeof text, "%s*END STEP\n", steps);
    return solve_foreign(&c, read_text(&c, text), number);
}

/* The model is refused with one fault, in this line, whose words hold `words`. */
static void check_refused(const char *text, int line, const char *words)
{
    case_file c;
    check_foreign_refused(&c, read_text(&c, text), line, words);
}

/* ---- tests ------------------------------------------------------------------------------------------------- */

/* Forms of lines: columns, continuation, upper and lower case, sets of sets, an included file. */
static void test_column(void)
{
    case_file c;
    sb_body *body = NULL;
    int ok = inp_read(&c, "tests/data/column.inp");
    if (!CHECK(ok)) {
        printf("%s%s\n", c.faults.text ? c.faults.text : "", c.message);
        case_free(&c);
        return;
    }
    CHECK_INT(c.mesh.node_count, 12);
    CHECK_INT(c.mesh.element_count, 2);
    CHECK_INT(c.element_numbers[0], 7);
    CHECK_INT(c.node_numbers[11], 33);
    CHECK_INT(c.solve->number[CASE_STEPS], 2);
    CHECK_INT(c.material.model, SB_LINEAR);
    CHECK(c.notes.count == 0);
    if (CHECK(case_create_body(&c, &body))) {
        sb_static_options options = case_static_options(&c);
        if (SB_REAL_IS_FLOAT)
            options.tolerance = (sb_real)1e-5;
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
        for (int i = 8; i < 12; i++) /* 10 N on 1 m^2, 2 m long, E = 1000 Pa: 20 mm, and 3 mm thinner */
            CHECK_NEAR(sb_body_displacements(body)[i].z, 0.02, SB_REAL_IS_FLOAT ? 1e-6 : 1e-10);
        CHECK_NEAR(sb_body_displacements(body)[10].x, -0.003, SB_REAL_IS_FLOAT ? 1e-6 : 1e-10);
    }
    sb_body_destroy(body);
    case_free(&c);
}

/* A file with ten mistakes gets a list of ten lines. */
static void test_mistakes(void)
{
    static const foreign_mistake expected[10] = {{3, "'zero' is no finite number"},
                                                 {8, "elements C3D8R are not read"},
                                                 {10, "*INITIALCONDITIONS is not understood"},
                                                 {13, "TYPE=ORTHO is not understood"},
                                                 {15, "*HYPERELASTIC, OGDEN is not understood"},
                                                 {18, "there is no set OTHERS before this line"},
                                                 {20, "must be within a *STEP"},
                                                 {21, "outside the folder of the model"},
                                                 {22, "parameter PERTURBATION of *STEP is not understood"},
                                                 {25, "axis 7 of a force must be 1, 2 or 3"}};
    check_foreign_mistakes(inp_read, "tests/data/mistakes.inp", expected);
}

/* Steps that are not whole, or do not say what holds at their end. */
static void check_refused_steps(void)
{
    check_refused(CUBE CLAMP "*STEP\n*STATIC\n*CLOAD\nTOP,3,1", AFTER_CLAMP + 1, "no *END STEP");
    check_refused(CUBE CLAMP "*STEP\n*STATIC\n*CLOAD\nTOP,3,1\n*END STEP\n*STEP\n*CLOAD\nTOP,3,2\n*END STEP\n",
                  AFTER_CLAMP + 9, "the step has no *STATIC");
    check_refused(CUBE CLAMP "*STEP\n*DYNAMIC, ALPHA=0, DIRECT\n.1,1\n*END STEP\n*STEP\n*CLOAD\nTOP,3,2\n*END STEP\n",
                  AFTER_CLAMP + 8, "the step has no *STATIC");
    check_refused(CUBE CLAMP "*STEP\n*STATIC\n-1,1\n*END STEP\n", AFTER_CLAMP + 3, "must be >= 0");
    /* the first step ends at half of what its amplitude rises to, however long the second one is */
    check_refused(CUBE CLAMP "*AMPLITUDE, NAME=A\n0,0,2,1\n*STEP\n*STATIC\n1,1\n*CLOAD, AMPLITUDE=A\nTOP,3,1\n"
                             "*END STEP\n*STEP\n*STATIC\n1,2\n*END STEP\n",
                  AFTER_CLAMP + 7, "beyond the step's end at 1 s");
}

/* Names that two things have. */
static void check_refused_repeats(void)
{
    check_refused(CUBE CLAMP "*AMPLITUDE, NAME=A\n0,0,1,1\n*AMPLITUDE, NAME=A\n0,0,1,5\n*STEP\n*STATIC\n*END STEP\n",
                  AFTER_CLAMP + 3, "amplitude A is there already");
    check_refused(CUBE CLAMP "*SURFACE, NAME=A\nALL,S1\n*SURFACE, NAME=A\nALL,S2\n*STEP\n*STATIC\n*END STEP\n",
                  AFTER_CLAMP + 3, "surface A is there already");
}

/* Few words that say more labels than a machine has memory for. */
static void check_refused_bombs(void)
{
    char text[4000];
    int length = snprintf(text, sizeof text, "%s", CUBE "*NSET, NSET=B0\n1\n");
    check_refused(CUBE "*NSET, NSET=A, GENERATE\n1,2147483647\n", AFTER_CUBE + 2, "more than 50000000 labels");
    for (int i = 1; i < 20; i++) /* 10^19 labels */
        length += snprintf(text + length, sizeof text - (size_t)length,
                           "*NSET, NSET=B%d\nB%d,B%d,B%d,B%d,B%d,B%d,B%d,B%d,B%d,B%d\n", i, i - 1, i - 1, i - 1, i - 1,
                           i - 1, i - 1, i - 1, i - 1, i - 1, i - 1);
    check_refused(text, AFTER_CUBE + 18, "more than 50000000 labels");
}

/* One mistake at a time. */
static void test_refused(void)
{
    check_bad_numbers();
    check_refused("*INCLUDE, INPUT=test_inp.inp\n", 1, "includes itself");
    check_refused("*INCLUDE, INPUT=/etc/hostname\n", 1, "outside the folder");
    check_refused("*INCLUDE, INPUT=no/../../x.inp\n", 1, "outside the folder");
    check_refused("*INCLUDE, INPUT=no-such.inp\n", 1, "no-such.inp: ");
    check_refused("", 0, "there are no elements");
    check_refused("1, 2\n", 1, "a data line without a keyword");
    check_refused("*WOBBLE\n1, 2\n", 1, "*WOBBLE is not understood");
    check_refused("*CLOAD\n1, 1, 1\n", 1, "*CLOAD has no place outside a *STEP");
    check_refused("*ELASTIC\n1, 0\n", 1, "before a *MATERIAL");
    check_refused("*NODE\n1, 0, 0, 0\n1, 0, 0, 1\n*ELEMENT, TYPE=C3D4\n1, 1, 1, 1, 1\n", 3, "node 1 is there already");
    check_refused("*NODE\n0, 0, 0, 0\n", 2, "node 0 must be > 0");
    check_refused("*NODE\n1, 0, 0, 1e999\n", 2, "no finite number");
    check_refused("*NODE\n1, 0, 0, 0, 0\n", 2, "a number and three coordinates");
    check_refused("*ELEMENT\n", 1, "needs TYPE=");
    check_refused("*ELEMENT, TYPE=C3D4\n1, 1, 2, 3\n*NODE\n1, 0\n", 2, "ends in the middle");
    check_refused("*ELEMENT, TYPE=C3D4\n1, 1, 2, 3, 4, 5\n", 2, "more nodes than a C3D4");
    check_refused("*ELEMENT, TYPE=C3D4\n1, 1, 2, 3, 4\n*ELEMENT, TYPE=C3D8\n", 3, "C3D8 beside C3D4 in");
    check_refused("*NODE, NSET=A\n1, 0\n2, 1\n3, 0, 1\n*ELEMENT, TYPE=C3D4\n1, 1, 2, 3, 4\n", 6,
                  "node 4 of the element is not");
    check_refused("*NSET, NSET=A, GENERATE\n5, 1\n", 2, "no ascending row");
    check_refused("*NSET, NSET=A, INSTANCE=B\n", 1, "there is no instance B");
    check_refused(CUBE "*STEP\n", AFTER_CUBE + 1, "there is no *STEP with");
    check_refused(CUBE "*STEP\n*END STEP\n", AFTER_CUBE + 2, "the step has no *STATIC");
    check_refused(CUBE "*STEP\n*STATIC\n*CLOAD\n9,1,1\n", AFTER_CUBE + 4, "node 9 is not there");
    check_refused(CUBE "*STEP\n*STATIC\n*CLOAD\nSIDE,1,1\n", AFTER_CUBE + 4, "there is no set of nodes SIDE");
    check_refused(CUBE "*STEP\n*STATIC\n*CLOAD, AMPLITUDE=A\n1,1,1\n", AFTER_CUBE + 4, "there is no amplitude A");
    check_refused(CUBE "*AMPLITUDE, NAME=A\n0,0,.5,1,1,0\n*STEP\n*STATIC\n*CLOAD, AMPLITUDE=A\n1,1,1\n", AFTER_CUBE + 6,
                  "is no ramp");
    check_refused(CUBE "*STEP, NLGEOM\n*STATIC\n*DLOAD\n1,P7,1\n", AFTER_CUBE + 4, "load P7 is not understood");
    check_refused(CUBE "*STEP\n*STATIC\n*DLOAD\n1,P2,1\n", AFTER_CUBE + 1, "the step needs NLGEOM");
    check_refused(CUBE "*STEP\n*STATIC\n*DLOAD\n1,GRAV,9.81,0,0,0\n", AFTER_CUBE + 4, "no length");
    check_refused(CUBE "*STEP\n*DYNAMIC, DIRECT\n.1,1\n", AFTER_CUBE + 2, "ALPHA=0");
    check_refused(CUBE "*STEP\n*FREQUENCY\n0\n", AFTER_CUBE + 2, "number of modes");
    check_refused(CUBE "*STEP\n*STATIC\n*END STEP\n*STEP\n*FREQUENCY\n3\n", AFTER_CUBE + 5, "a case has one solve");
    check_refused(CUBE "*EQUATION\n2\n1,1,1\n", AFTER_CUBE + 3, "ends in the middle");
    check_refused(CUBE "*EQUATION\n2\nALL,1,1,1,2,1\n*STEP\n*STATIC\n", AFTER_CUBE + 3, "has 8 nodes");
    check_refused(CUBE "*BOUNDARY, OP=NEW\n1,1\n", AFTER_CUBE + 1, "before the first step");
    check_refused_steps();
    check_refused_repeats();
    check_refused_bombs();
    check_refused(CUBE_MESH "*STEP\n*STATIC\n", 15, "there is no *SOLID SECTION");
    check_refused(CUBE_MESH "*MATERIAL, NAME=M\n*SOLID SECTION, ELSET=ALL, MATERIAL=M\n*STEP\n*STATIC\n", 14,
                  "has no *ELASTIC or *HYPERELASTIC");
    check_refused(CUBE_MESH
                  "*MATERIAL, NAME=M\n*ELASTIC\n1000,.5\n*SOLID SECTION, ELSET=ALL, MATERIAL=M\n*STEP\n*STATIC\n",
                  15, "nu between -1 and 0.5");
    check_refused(CUBE_MESH "*MATERIAL, NAME=M\n*HYPERELASTIC, NEO HOOKE\n1,0\n*SOLID SECTION, ELSET=ALL, MATERIAL=M\n"
                            "*STEP, NLGEOM\n*STATIC\n",
                  15, "D1 of M must be > 0");
    check_refused(CUBE_MESH
                  "*MATERIAL, NAME=M\n*HYPERELASTIC, YEOH\n1,0,0,1,1,0\n*SOLID SECTION, ELSET=ALL, MATERIAL=M\n"
                  "*STEP, NLGEOM\n*STATIC\n",
                  15, "D2 of M must be 0");
    check_refused(CUBE_MESH
                  "*MATERIAL, NAME=M\n*ELASTIC\n1000,0\n*SOLID SECTION, ELSET=ALL, MATERIAL=M\n*STEP\n*STATIC\n"
                  "*DLOAD\nALL,GRAV,1,0,0,1\n",
                  14, "has no *DENSITY");
}

/* Loads and supports over lines and steps, as CalculiX 2.20 takes them: tried there with the same files. */
static void test_steps(void)
{
    double tolerance = SB_REAL_IS_FLOAT ? 1e-7 : 1e-12;
    /* forces of one step add up, those of the next replace them, but for OP=NEW and other nodes */
    CHECK_NEAR(solve_text(CUBE CLAMP "*STEP\n*STATIC\n*CLOAD\nTOP,3,1\n*CLOAD\nTOP,3,1\n", 5).z, 0.008, tolerance);
    CHECK_NEAR(
        solve_text(CUBE CLAMP "*STEP\n*STATIC\n*CLOAD\nTOP,3,1\n*END STEP\n*STEP\n*STATIC\n*CLOAD\nTOP,3,2\n", 5).z,
        0.008, tolerance);
    CHECK_NEAR(
        solve_text(CUBE CLAMP "*STEP\n*STATIC\n*CLOAD\nTOP,3,1\n*END STEP\n*STEP\n*STATIC\n*CLOAD\nTOP,2,0\n", 5).z,
        0.004, tolerance);
    CHECK_NEAR(
        solve_text(CUBE CLAMP "*STEP\n*STATIC\n*CLOAD\nTOP,3,1\n*END STEP\n*STEP\n*STATIC\n*CLOAD,OP=NEW\n", 5).z, 0,
        tolerance);
    /* two directions of gravity add up, and are normalised; 2 kg, half of it at the top of a bar of 1 m and 1000 Pa */
    sb_vec3 u = solve_text(CUBE CLAMP "*STEP\n*STATIC\n*DLOAD\nALL,GRAV,8,0,0,-1\n,GRAV,8,0,0,-2\n", 5);
    CHECK_NEAR(u.z, -0.016, tolerance);
    /* supports: the last one counts; OP=NEW takes away those before the first step, too */
    CHECK_NEAR(solve_text(CUBE CLAMP "*STEP\n*STATIC\n*BOUNDARY\nTOP,3,3,.1\nTOP,3,3,.3\n", 5).z, 0.3, tolerance);
    CHECK_NEAR(solve_text(CUBE CLAMP "*STEP\n*STATIC\n*BOUNDARY\nTOP,3,3,.1\n*END STEP\n*STEP\n*STATIC\n"
                                     "*BOUNDARY\nTOP,1,1,.5\n",
                          5)
                   .z,
               0.1, tolerance);
    case_file c;
    CHECK(read_text(&c, CUBE CLAMP "*STEP\n*STATIC\n*BOUNDARY,OP=NEW\n1,1,3\n2,2,3\nTOP,3,3,.1\n*END STEP\n"));
    CHECK(c.supports && memcmp(c.supports, "\7\6\0\0\4\4\4\4", 8) == 0);
    case_free(&c);
    /* an amplitude's end counts */
    CHECK_NEAR(
        solve_text(CUBE CLAMP "*AMPLITUDE, NAME=A\n0,0,1,.5\n*STEP\n*STATIC\n*BOUNDARY,AMPLITUDE=A\nTOP,3,3,.1\n", 5).z,
        0.05, tolerance);
}

/* The largest label that there is, before a smaller one. */
static void test_labels(void)
{
    sb_vec3 u = solve_text("*NODE\n1,0\n2147483647,1\n3,0,1\n4,0,0,1\n*ELEMENT, TYPE=C3D4, ELSET=ALL\n"
                           "2147483647,1,2147483647,3,4\n*MATERIAL, NAME=M\n*ELASTIC\n1000,0\n"
                           "*SOLID SECTION, ELSET=ALL, MATERIAL=M\n*BOUNDARY\n1,1,3\n3,1,3\n4,1,3\n"
                           "*STEP\n*STATIC\n*BOUNDARY\n2147483647,1,3,.25\n",
                           2147483647);
    CHECK_NEAR(u.x, 0.25, 1e-12);
}

/* CRLF, and an equation that joins the corners of the top to one. */
static void test_equation(void)
{
    sb_vec3 u = solve_text(CUBE CLAMP "*EQUATION\r\n2\r\n6,3,1,5,3,-2.\r\n3\r\n7,3,-1.,5,3,1.,\r\n6,3,.5\r\n"
                                      "*STEP\r\n*STATIC\r\n*BOUNDARY\r\n5,3,3,.1\r\n",
                           6);
    CHECK_NEAR(u.z, 0.2, SB_REAL_IS_FLOAT ? 1e-6 : 1e-12);
    u = solve_text(
        CUBE CLAMP "*EQUATION\n2\n6,3,1,5,3,-2.\n3\n7,3,-1.,5,3,1.,\n6,3,.5\n*STEP\n*STATIC\n*BOUNDARY\n5,3,3,.1\n", 7);
    CHECK_NEAR(u.z, 0.2, SB_REAL_IS_FLOAT ? 1e-6 : 1e-12);
}

/* Pressure by the faces' names: each pushes its own side inwards, of all element types. */
static void test_faces(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_HEX8};
    for (int k = 0; k < 2; k++)
        for (int face = 0; face < foreign_face_count(types[k]); face++) {
            sb_element_type face_type;
            int local[SB_MAX_FACE_NODES], own = foreign_face(types[k], face);
            if (!CHECK(own >= 0))
                continue;
            CHECK_INT(foreign_face_of(types[k], own), face);
            sb_element_face(types[k], own, local, &face_type);
            for (int other = 0; other < face; other++)
                CHECK(foreign_face(types[k], other) != own);
        }
    /* the cube's P2 is its top, P4 its side x = 1, by element or by a surface */
    case_file c;
    sb_vec3 forces[8];
    static const char *const loads[] = {"*DLOAD\nALL,P2,3\n1,P4,5\n*END STEP\n",
                                        "*DSLOAD\nUP,P,3\nRIGHT,P,5\n*END STEP\n"};
    for (int k = 0; k < 2; k++) {
        char text[1024];
        snprintf(text, sizeof text, "%s%s%s",
                 CUBE CLAMP "*SURFACE, NAME=UP\nALL, S2\n*SURFACE, NAME=RIGHT, TYPE=ELEMENT\n1, S4\n*STEP, NLGEOM\n",
                 "*STATIC\n", loads[k]);
        int ok = read_text(&c, text) && case_nodal_loads(&c, CASE_LOADS, forces);
        if (!CHECK(ok))
            printf("%s\n", c.message);
        else
            for (int i = 0; i < 8; i++) {
                CHECK_NEAR(forces[i].z, i >= 4 ? -0.75 : 0, 1e-6);
                CHECK_NEAR(forces[i].x, i == 1 || i == 2 || i == 5 || i == 6 ? -1.25 : 0, 1e-6);
                CHECK_NEAR(forces[i].y, 0, 1e-6);
            }
        case_free(&c);
    }
}

/* Two bars of bricks whose meshes do not match are tied by surfaces, and stretch as one. */
static void test_tie(void)
{
    static const char *const mesh =
        "*NODE\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,0,0,1\n6,1,0,1\n7,1,1,1\n8,0,1,1\n"
        "11,0,0,1\n12,.5,0,1\n13,1,0,1\n14,0,1,1\n15,.5,1,1\n16,1,1,1\n"
        "21,0,0,2\n22,.5,0,2\n23,1,0,2\n24,0,1,2\n25,.5,1,2\n26,1,1,2\n"
        "*ELEMENT, TYPE=C3D8, ELSET=LOW\n1,1,2,3,4,5,6,7,8\n*ELEMENT, TYPE=C3D8, ELSET=HIGH\n"
        "2,11,12,15,14,21,22,25,24\n3,12,13,16,15,22,23,26,25\n*ELSET, ELSET=ALL\nLOW,HIGH\n"
        "*MATERIAL, NAME=M\n*ELASTIC\n1000,0\n*DENSITY\n1\n*SOLID SECTION, ELSET=ALL, MATERIAL=M\n"
        "*NSET, NSET=SEAM, GENERATE\n11,16\n*SURFACE, NAME=MASTER\nLOW, S2\n*SURFACE, NAME=SLAVE\nHIGH, S1\n"
        "*SURFACE, NAME=NODES, TYPE=NODE\nSEAM\n";
    static const char *const step = "*BOUNDARY\n1,1,3\n2,1,3\n3,1,3\n4,1,3\n*STEP\n*STATIC\n*BOUNDARY\n21,3,3,.2\n"
                                    "22,3,3,.2\n23,3,3,.2\n24,3,3,.2\n25,3,3,.2\n26,3,3,.2\n";
    static const char *const ties[] = {"*TIE, NAME=T, ADJUST=NO\nSLAVE, MASTER\n",
                                       "*TIE, ADJUST=NO, POSITION TOLERANCE=.01\nNODES, MASTER\n"};
    static const struct {
        const char *tie, *words;
    } wrong[] = {{"*TIE, ADJUST=NO\nSLAVE, NODES\n", "must be a surface of elements"},
                 {"*TIE, ADJUST=NO\nSLAVE, NOWHERE\n", "there is no surface NOWHERE"},
                 {"*TIE, ADJUST=NO\nSLAVE\n", "SLAVE SURFACE, MASTER SURFACE"},
                 {"*TIE, ADJUST=NO, POSITION TOLERANCE=0\nSLAVE, MASTER\n", "must be > 0"}};
    char text[4096];
    for (int k = 0; k < 2; k++) {
        snprintf(text, sizeof text, "%s%s%s", mesh, ties[k], step);
        CHECK_NEAR(solve_text(text, 12).z, 0.1, SB_REAL_IS_FLOAT ? 1e-5 : 1e-10);
        CHECK_NEAR(solve_text(text, 6).z, 0.1, SB_REAL_IS_FLOAT ? 1e-5 : 1e-10);
    }
    for (int k = 0; k < 4; k++) {
        case_file c;
        snprintf(text, sizeof text, "%s%s%s", mesh, wrong[k].tie, step);
        CHECK(!read_text(&c, text));
        CHECK(strstr(c.message, wrong[k].words) != NULL);
        case_free(&c);
    }
    case_file a, b, d; /* as a case file, with its two lists, and as an input file again */
    snprintf(text, sizeof text, "%s%s%s*END STEP\n", mesh, ties[1], step);
    CHECK(read_text(&a, text) && case_write(&a, "build/test_inp_tie.case", NULL));
    CHECK(case_read(&b, "build/test_inp_tie.case"));
    CHECK(inp_write(&b, "build/test_inp_tie.inp", 0) && inp_read(&d, "build/test_inp_tie.inp"));
    CHECK(d.statement_count == a.statement_count && d.notes.count == 0);
    for (int i = 0; i < a.statement_count && i < b.statement_count; i++) {
        const case_statement *s = a.statements + i, *t = b.statements + i;
        CHECK(s->form == t->form);
        if (s->form->kind != CASE_TIE)
            continue;
        CHECK_INT(s->tied_count, 6);
        CHECK(t->tied_count == 6 && memcmp(s->nodes, t->nodes, 6 * sizeof(int)) == 0);
        CHECK(t->count == 1 && memcmp(s->faces, t->faces, 4 * sizeof(int)) == 0);
        CHECK(t->number[CASE_DISTANCE] == 0.01);
        t = d.statements + i;
        CHECK(t->form == s->form && t->tied_count == 6 && memcmp(s->nodes, t->nodes, 6 * sizeof(int)) == 0);
        CHECK(t->count == 1 && memcmp(s->faces, t->faces, 4 * sizeof(int)) == 0);
        CHECK(t->number[CASE_DISTANCE] == 0.01);
    }
    case_free(&a);
    case_free(&b);
    case_free(&d);
}

/* The springs of a case, or NULL. */
static const case_statement *find_springs(const case_file *c)
{
    for (int i = 0; i < c->statement_count; i++)
        if (c->statements[i].form->kind == CASE_SPRING)
            return c->statements + i;
    return NULL;
}

/* Springs of 250 N/m at the corners of the cube's top, to points of a set before it; lines 1 to 18 beyond the cube's.
 */
#define POINTS "*NODE, NSET=POINTS\n11,0,0,1.02\n12,1,0,1.02\n13,1,1,1.02\n14,0,1,1.02\n"
#define HUNG(type, ends)                                                                                               \
    "*ELEMENT, TYPE=SPRING" type ", ELSET=SX\n21,5" ends "\n*ELEMENT, TYPE=SPRING" type ", ELSET=SY\n31,5" ends        \
    "\n*ELEMENT, TYPE=SPRING" type ", ELSET=SZ\n41,5" ends "\n"
#define THREE "*ELEMENT, TYPE=SPRING2, ELSET="
#define AXES "*SPRING, ELSET=SX\n1,1\n250\n*SPRING, ELSET=SY\n2,2\n250\n*SPRING, ELSET=SZ\n3,3\n250\n"
#define HELD "*BOUNDARY\nPOINTS,1,3\n"
#define STEP "*STEP\n*STATIC\n*END STEP\n"
enum { AFTER_HUNG = AFTER_CLAMP + 5 + 6 };

static void test_springs(void)
{
    static const char ends[] = "5,11\n%d,6,12\n%d,13,7\n%d,8,14\n";
    static const char *const grounded[] = {"*SPRING, ELSET=%c\n%d\n250.\n",
                                           "*spring, elset=%c, nonlinear\n%d\n-250, -1\n0, 0\n125., .5\n"};
    double tolerance = SB_REAL_IS_FLOAT ? 1e-6 : 1e-10;
    char text[4000];
    int at = snprintf(text, sizeof text, "%s", POINTS CUBE CLAMP); /* points come first, and are no part of the mesh */
    for (int axis = 0; axis < 3; axis++) {
        at += snprintf(text + at, sizeof text - (size_t)at, "%sS%c\n%d,", THREE, "XYZ"[axis], 10 * axis + 11);
        at += snprintf(text + at, sizeof text - (size_t)at, ends, 10 * axis + 12, 10 * axis + 13, 10 * axis + 14);
    }
    snprintf(text + at, sizeof text - (size_t)at, "%s", AXES "*STEP\n*STATIC\n*BOUNDARY\nPOINTS,1,2\nPOINTS,3,3,.02\n");
    CHECK_NEAR(solve_text(text, 5).z, 0.01, tolerance); /* as stiff as the cube */
    CHECK_NEAR(solve_text(text, 7).z, 0.01, tolerance);
    /* by a force of 5 N in place of that; the same where it is the spring's own, and the point is where it stands */
    for (int k = 0; k < 2; k++) {
        case_file c;
        int end = at;
        end += snprintf(text + end, sizeof text - (size_t)end, "%s%s", AXES HELD, "*STEP\n*STATIC\n*CLOAD\n");
        for (int i = 5; i < 9; i++)
            end += snprintf(text + end, sizeof text - (size_t)end, "%d,3,%s\n", i, k ? "5" : "5.0001");
        CHECK_NEAR(solve_text(text, 5).z, k ? 0.01 : 0.0100002, SB_REAL_IS_FLOAT ? 1e-6 : 1e-9);
        snprintf(text + end, sizeof text - (size_t)end, "*END STEP\n");
        if (CHECK(read_text(&c, text)) && CHECK(find_springs(&c) != NULL)) {
            int forces = 0;
            for (int i = 0; i < c.statement_count; i++)
                forces += c.statements[i].form->kind == CASE_FORCE;
            CHECK_INT(forces, k ? 0 : 1);
            CHECK(find_springs(&c)->count == 4 && find_springs(&c)->vectors[0].z == (sb_real)(k ? 1.02 : 1));
        }
        case_free(&c);
    }
    for (int k = 0; k < 2; k++) { /* to the ground, in parallel with the cube */
        at = snprintf(text, sizeof text, "%s", CUBE CLAMP);
        for (int axis = 0; axis < 3; axis++) {
            at += snprintf(text + at, sizeof text - (size_t)at,
                           "*ELEMENT, TYPE=SPRING1, ELSET=%c\n%d,5\n%d,6\n%d,7\n%d,8\n", "XYZ"[axis], 10 * axis + 11,
                           10 * axis + 12, 10 * axis + 13, 10 * axis + 14);
            at += snprintf(text + at, sizeof text - (size_t)at, grounded[k], "XYZ"[axis], axis + 1);
        }
        snprintf(text + at, sizeof text - (size_t)at, "*STEP\n*STATIC\n*CLOAD\nTOP,3,5\n");
        CHECK_NEAR(solve_text(text, 6).z, 0.01, tolerance);
    }
}

static void test_springs_refused(void)
{
    const int line = AFTER_HUNG; /* the last of the springs, which POINTS, CUBE and CLAMP are before */
    check_bad_numbers();
    check_refused(POINTS CUBE CLAMP HUNG("2", ",11") AXES STEP, line - 4, "must be held along x, y and z");
    check_refused(POINTS CUBE CLAMP HUNG("2", ",11") "*SPRING, ELSET=SX\n1,1\n250\n*SPRING, ELSET=SY\n2,2\n251\n"
                                                     "*SPRING, ELSET=SZ\n3,3\n250\n" HELD STEP,
                  line - 4, "node 5 has springs of 250, 251 and 250 N/m");
    check_refused(POINTS CUBE CLAMP THREE "S\n21,5,11\n*SPRING, ELSET=S\n3,3\n250\n" HELD STEP, line - 4,
                  "springs of 0, 0 and 250 N/m");
    check_refused(POINTS CUBE CLAMP HUNG("2", ",6") AXES STEP, line - 4, "between two nodes of the body");
    check_refused(POINTS CUBE CLAMP THREE "S\n21,12,11\n*SPRING, ELSET=S\n3,3\n1\n" HELD STEP, line - 4,
                  "hangs on no node of the body");
    check_refused(POINTS CUBE CLAMP "*ELEMENT, TYPE=SPRINGA, ELSET=S\n21,5,11\n*SPRING, ELSET=S\n\n250\n" STEP,
                  line - 5, "elements SPRINGA are not read, only SPRING1 and SPRING2: their length at rest");
    check_refused(POINTS CUBE CLAMP THREE "S\n21,5\n", line - 4, "a SPRING2 has a number and 2 nodes");
    check_refused(POINTS CUBE CLAMP THREE "S\n21,5,11\n" STEP, line - 4, "spring 21 is in no *SPRING");
    check_refused(POINTS CUBE CLAMP THREE "S\n1,5,11\n*SPRING, ELSET=S\n1,1\n1\n" STEP, line - 4,
                  "element 1 is there already");
    check_refused(POINTS CUBE CLAMP THREE "S\n21,5,99\n*SPRING, ELSET=S\n1,1\n1\n" STEP, line - 4,
                  "node 99 is not there");
#define ONE POINTS CUBE CLAMP THREE "S\n21,5,11\n"
    check_refused(ONE "*SPRING, ELSET=T\n1,1\n1\n" STEP, line - 3, "there is no set of springs T");
    check_refused(ONE "*SPRING, ELSET=S\n1,2\n1\n" STEP, line - 3, "here they must be the same");
    check_refused(ONE "*SPRING, ELSET=S\n4,4\n1\n" STEP, line - 2, "axis 4 of a spring");
    check_refused(ONE "*SPRING, ELSET=S\n1,1\n0\n" STEP, line - 1, "must be > 0");
    check_refused(ONE "*SPRING, ELSET=S\n1,1\nnan\n" STEP, line - 1, "no finite number");
    check_refused(ONE "*SPRING, ELSET=S\n1,1\n1,,20\n" STEP, line - 1, "frequency or temperature");
    check_refused(ONE "*SPRING, ELSET=S\n1,1\n" STEP, line - 3, "has too few data lines");
    check_refused(ONE "*SPRING, ELSET=S, ORIENTATION=O\n1,1\n1\n" STEP, line - 3, "ORIENTATION of *SPRING");
    check_refused(ONE "*SPRING, ELSET=S, NONLINEAR\n1,1\n-1,-1\n0,0\n2,1\n" STEP, line + 1, "no straight line");
    check_refused(ONE "*SPRING, ELSET=S, NONLINEAR\n1,1\n-1,-1\n1,0\n" STEP, line, "no straight line");
    /* a rope */
    check_refused(ONE "*SPRING, ELSET=S, NONLINEAR\n1,1\n0,0\n2,1\n" STEP, line - 3, "must pull and push");
    check_refused(POINTS CUBE CLAMP HUNG("2", ",11") AXES HELD "*STEP\n*STATIC\n*CLOAD\nPOINTS,1,1\n*END STEP\n",
                  line + 9 + 3, "node 11 is of no element");
    check_refused(POINTS CUBE CLAMP HUNG("2", ",11") AXES HELD "*EQUATION\n2\n5,1,1,11,1,1\n" STEP, line + 9 + 5,
                  "node 11 is of no element");
    check_refused(POINTS CUBE CLAMP HUNG("2", ",11") AXES "*AMPLITUDE, NAME=A\n0,0,1,1\n*STEP\n*DYNAMIC, DIRECT, "
                                                          "ALPHA=0\n.1,1\n*BOUNDARY, AMPLITUDE=A\nPOINTS,1,3,.1\n",
                  line - 4, "moves by a ramp");
}

/* Each instance is the part anew, moved, then turned; names and labels in it are its own. 10 N on 1 m^2, 2 m long,
 * E = 1000 Pa: 20 mm. */
static void test_assembly(void)
{
    static const double corner[4][2] = {{1, 0}, {1, 1}, {0, 1}, {0, 0}}; /* of the second brick, turned by 90 degrees */
    case_file c;
    int ok = inp_read(&c, "tests/data/assembly.inp");
    sb_vec3 u;
    if (CHECK(ok)) {
        CHECK_INT(c.mesh.node_count, 17);
        CHECK_INT(c.mesh.element_count, 2);
        CHECK_INT(c.element_numbers[0], 3); /* labels of the first instance stay, the second's are counted on */
        CHECK_INT(c.element_numbers[1], 6);
        for (int i = 0; i < 17; i++)
            CHECK_INT(c.node_numbers[i], i + 1);
        for (int i = 0; i < 8; i++) {
            CHECK_NEAR(c.mesh.nodes[8 + i].x, corner[i % 4][0], 1e-6);
            CHECK_NEAR(c.mesh.nodes[8 + i].y, corner[i % 4][1], 1e-6);
            CHECK_NEAR(c.mesh.nodes[8 + i].z, i < 4 ? 1 : 2, 1e-6);
        }
        CHECK_INT(c.mesh.regions[0], 1);
        CHECK_INT(c.mesh.regions[1], 2);
    }
    u = solve_foreign(&c, ok, 16);
    CHECK_NEAR(u.z, 0.02, SB_REAL_IS_FLOAT ? 1e-5 : 1e-9);
}

/* An assembly of two bricks of one part up to its end, a line for each card. */
#define PART "*PART, NAME=P\n" CUBE_MESH "*SURFACE, NAME=S\n1, S2\n*END PART\n"
enum { AFTER_PART = 1 + 13 + 3 };
#define PLACED                                                                                                         \
    PART "*ASSEMBLY\n*INSTANCE, NAME=A, PART=P\n*END INSTANCE\n*INSTANCE, NAME=B, PART=P\n0,0,2\n*END INSTANCE\n"
enum { AFTER_PLACED = AFTER_PART + 6 };

static void test_assembly_refused(void)
{
    static const struct {
        const char *text;
        int line;
        const char *words;
    } wrong[] = {
        {"*PART, NAME=P\n*NODE\n1,0,0,0\n", 1, "no *END PART"},
        {"*PART, NAME=P,", 1, "ends in a comma"},
        {"*PART, NAME=P,\n*NODE\n1,0,0,0\n", 1, "ends in a comma"},
        {PART PART, AFTER_PART + 1, "part P is there already"},
        {PART "*INSTANCE, NAME=A, PART=P\n", AFTER_PART + 1, "outside an *ASSEMBLY"},
        {PART "*ASSEMBLY\n*INSTANCE, NAME=A, PART=Q\n", AFTER_PART + 2, "there is no part Q"},
        {PART "*ASSEMBLY\n*PART, NAME=Q\n*END PART\n*END ASSEMBLY\n", AFTER_PART + 2, "*PART within"},
        {PART "*ASSEMBLY\n*INSTANCE, NAME=A, PART=P\n1,2,3,4\n*END INSTANCE\n*END ASSEMBLY\n", AFTER_PART + 3,
         "is placed by"},
        {PART "*ASSEMBLY\n*INSTANCE, NAME=A, PART=P\n0,0,0\n1,1,1,1,1,1,90\n*END INSTANCE\n*END ASSEMBLY\n",
         AFTER_PART + 4, "axis of an instance"},
        {PART "*ASSEMBLY\n*INSTANCE, NAME=A, PART=P\n0,nan,0\n*END INSTANCE\n*END ASSEMBLY\n", AFTER_PART + 3,
         "no finite number"},
        {PART "*ASSEMBLY\n*INSTANCE, NAME=A, PART=P\n", AFTER_PART + 2, "has no end"},
        {PLACED "*INSTANCE, NAME=B, PART=P\n*NSET, NSET=N\n1\n*END ASSEMBLY\n", AFTER_PLACED + 1,
         "instance B is there already"},
        {PLACED "*ASSEMBLY\n*END ASSEMBLY\n", AFTER_PLACED + 1, "an *ASSEMBLY already"},
        {PLACED "*NSET, NSET=N\nC.1\n*END ASSEMBLY\n", AFTER_PLACED + 2, "there is no set C.1"},
        {PLACED "*NSET, NSET=N, INSTANCE=B\n2147483640\n*END ASSEMBLY\n", AFTER_PLACED + 2, "too large"},
        {PLACED "*END ASSEMBLY\n*END ASSEMBLY\n", AFTER_PLACED + 2, "*END ASSEMBLY without"},
        {"*END INSTANCE\n", 1, "*END INSTANCE without"},
        {"*PART, NAME=P\n*INSTANCE, NAME=I, PART=P\n*END PART\n*ASSEMBLY\n*INSTANCE, NAME=A, PART=P\n*END INSTANCE\n"
         "*END ASSEMBLY\n",
         2, "or within another"},
    };
    /* what only a whole model shows */
    static const struct {
        const char *load;
        const char *words;
    } loads[] = {{"*CLOAD\n1, 1, 1\n", "the assembly has no nodes of its own"},
                 {"*CLOAD\nB.9, 1, 1\n", "node 17 is not there"},
                 {"*CLOAD\nTOP, 1, 1\n", "there is no set of nodes TOP"},
                 {"*DSLOAD\nS, P, 1\n", "there is no surface S of elements"}};
    for (int i = 0; i < (int)(sizeof wrong / sizeof wrong[0]); i++)
        check_refused(wrong[i].text, wrong[i].line, wrong[i].words);
    for (int i = 0; i < (int)(sizeof loads / sizeof loads[0]); i++) {
        char text[2000];
        snprintf(text, sizeof text,
                 "%s*ELSET, ELSET=E\nA.ALL, B.ALL\n*END ASSEMBLY\n*MATERIAL, NAME=M\n*ELASTIC\n1000,0\n*DENSITY\n2\n"
                 "*SOLID SECTION, ELSET=E, MATERIAL=M\n*STEP, NLGEOM\n*STATIC\n%s*END STEP\n",
                 PLACED, loads[i].load);
        check_refused(text, AFTER_PLACED + 12 + 1, loads[i].words);
    }
}

/* Numbers: written and read again, shifted, they are the same; and CalculiX sees them in 20 characters. */
static void test_numbers(void)
{
    unsigned long long state = 7;
    double value = 0;
    for (int i = 0; i < check_rounds(100000); i++) {
        char text[48], seen[21];
        double number = check_random_in(&state, -1, 1) * pow(10, (int)check_random_in(&state, -30, 30));
        int shift = 4 * ((int)(3 * check_random(&state)) - 1), constant = check_random(&state) < 0.5;
        if (SB_REAL_IS_FLOAT)
            number = (double)(float)number;
        if (constant)
            number = fabs(number);
        foreign_print_number(text, number, shift, constant ? FOREIGN_CONSTANT : FOREIGN_PLACE);
        int is_exact = number > 0 || (fabs(number) > 1e-17 && fabs(number) < 1e12);
        if (!CHECK(foreign_scan_number(text, -shift, &value) && (!is_exact || value == number))) {
            printf("%.17g as %s\n", number, text);
            break;
        }
        snprintf(seen, sizeof seen, "%.20s", text);
        CHECK(foreign_scan_number(seen, -shift, &value));
        if (!CHECK(fabs(value - number) <= (constant ? 1e-9 * fabs(number) : 1e-9 * fabs(number) + 1e-13)))
            printf("%.17g as %s\n", number, seen);
    }
    static const char *const good[] = {"1", "-1.", ".5", "1.5E-3", "1D3", "15-1", "+2e+2"};
    static const double values[] = {1, -1, 0.5, 1.5e-3, 1000, 1.5, 200};
    for (int i = 0; i < 7; i++) {
        CHECK(foreign_scan_number(good[i], 0, &value));
        CHECK_NEAR(value, values[i], 0);
    }
    static const char *const bad[] = {"",    "-",       ".",   "1e",    "1x",    "nan",
                                      "inf", "1e99999", "1 2", "0x1p3", "1.2.3", "--1"};
    for (int i = 0; i < 12; i++)
        CHECK(!foreign_scan_number(bad[i], 0, &value));
}

/* The reference cases were solved by CalculiX from their case.inp; their case.case says the same. Nodal forces are
 * compared for the smaller ones, of all with CHECK_SLOW=1. */
static void test_reference(void)
{
    /* what the printed digits of the two files leave: 10 of coordinates (and areas) in mesh.vtk, 12 in case.inp */
    const double rounding = SB_REAL_IS_FLOAT ? 1e-6 : 0;
    const double digits[] = {2e-10 + rounding, 2e-12 + rounding, 5e-12 + rounding, 2e-9 + rounding};
    double worst = 0;
    for (int i = 0; i < REFERENCE_COUNT; i++) {
        char path[512];
        case_file a, b;
        if (!reference_path(path, sizeof path, i, "case.inp")) {
            CHECK_SKIP("no ../shared/reference");
            return;
        }
        int ok = inp_read(&a, path);
        if (!CHECK(ok))
            printf("%s%s\n", a.faults.text ? a.faults.text : "", a.message);
        strcpy(strstr(path, "case.inp"), "case.case");
        ok = case_read(&b, path) && ok;
        if (CHECK(ok)) {
            int loads = b.mesh.node_count < (getenv("CHECK_SLOW") ? 30000 : 700);
            body_difference d = bodies_differ(&b, &a, loads);
            double most = fmax(fmax(d.nodes, d.materials), fmax(d.supports, d.loads));
            if (!CHECK(d.nodes <= digits[0] && d.materials <= digits[1] && d.supports <= digits[2] &&
                       d.loads <= digits[3]) ||
                !CHECK(d.same_elements && d.same_axes && d.same_solve))
                printf("%s: nodes %.1e, materials %.1e, supports %.1e, loads %.1e, %d %d %d\n", reference_names[i],
                       d.nodes, d.materials, d.supports, d.loads, d.same_elements, d.same_axes, d.same_solve);
            worst = fmax(worst, most);
        }
        case_free(&a);
        case_free(&b);
    }
    printf("  reference cases: %.1e apart\n", worst);
}

static int same_springs(const case_statement *a, const case_statement *b)
{
    if (!a || !b || a->count != b->count)
        return a == b;
    for (int i = 0; i < a->count; i++)
        if (a->nodes[i] != b->nodes[i] || a->stiffness[i] != b->stiffness[i] || a->vectors[i].x != b->vectors[i].x ||
            a->vectors[i].y != b->vectors[i].y || a->vectors[i].z != b->vectors[i].z)
            return 0;
    return 1;
}

/* Digits of a stiffness: it has a point, and its exponent is within the 20 characters that CalculiX reads. */
static void test_stiffness(void)
{
    static const double values[] = {250, 2.5, 1e4, 1e-3, 1.2345678901234567e-9, 1e-15, 1.7e19, 1.2345678901234567e16};
    for (int i = 0; i < (int)(sizeof values / sizeof values[0]); i++)
        for (int shift = 0; shift <= FOREIGN_UNIT; shift += FOREIGN_UNIT) {
            char text[80], seen[21];
            double whole = 0, value = 0;
            inp_writer w = {NULL, NULL, shift, 1, 0, 0};
            w.file = fopen("build/test_inp_stiffness.txt", "w+");
            if (!CHECK(w.file != NULL))
                return;
            inp_print_stiffness(&w, values[i]);
            rewind(w.file);
            CHECK(fscanf(w.file, "%79s", text) == 1 && fclose(w.file) == 0);
            snprintf(seen, sizeof seen, "%.20s", text);
            if (!CHECK(strchr(seen, '.') && foreign_scan_number(text, -shift, &whole) &&
                       foreign_scan_number(seen, -shift, &value)))
                printf("%.17g as %s\n", values[i], text);
            CHECK(fabs(whole - values[i]) <= 1e-14 * values[i] && fabs(value - values[i]) <= 1e-9 * values[i]);
        }
    CHECK(remove("build/test_inp_stiffness.txt") == 0);
}

/* Adds springs to a case of write_random_case: as stiff as each other or not, two on a node, to points far and near. */
static void add_random_springs(const char *path, unsigned long long *state)
{
    FILE *file = fopen(path, "a"), *list = fopen("build/test_inp_random_springs", "w");
    double stiffness = 1;
    CHECK(file && fprintf(file, "spring file=test_inp_random_springs\n") > 0 && fclose(file) == 0);
    for (int i = 0; i < 40 && list; i++) {
        double size = i % 4 ? pow(10, (int)check_random_in(state, -6, 6)) : 0;
        if (check_random(state) < 0.5)
            stiffness = pow(10, (int)check_random_in(state, -4, 8)) * check_random_in(state, 1, 9);
        fprintf(list, "%d %.17g %.17g %.17g %.17g\n", 7 * i % 33, stiffness, size * check_random_in(state, -1, 1),
                size * check_random_in(state, -1, 1), size * check_random_in(state, -1, 1));
    }
    CHECK(list && fclose(list) == 0);
}

/* Reads a case, writes it as an input file, reads and writes that as a case again, and reads it: the bodies of all
 * three are the same, to the last bit. */
static void check_round(const char *path, int loads)
{
    static const char inp[] = "build/test_inp_round.inp", again[] = "build/test_inp_round.case";
    case_file a, b, c;
    int ok = case_read(&a, path) && inp_write(&a, inp, 0);
    if (!CHECK(ok))
        printf("%s:%d: %s\n", path, a.error_line, a.message);
    ok = inp_read(&b, inp) && case_write(&b, again, NULL);
    if (!CHECK(ok))
        printf("%s: %s%s\n", path, b.faults.text ? b.faults.text : "", b.message);
    ok = case_read(&c, again) && ok;
    if (!CHECK(ok)) {
        printf("%s: %d: %s\n", path, c.error_line, c.message);
    } else {
        body_difference d = bodies_differ(&a, &b, loads), e = bodies_differ(&a, &c, loads);
        double most = fmax(fmax(d.nodes, d.materials), fmax(d.supports, d.loads));
        most = fmax(most, fmax(fmax(e.nodes, e.materials), fmax(e.supports, e.loads)));
        CHECK(d.same_elements && d.same_axes && d.same_solve && e.same_elements && e.same_axes && e.same_solve);
        CHECK_INT(b.notes.count, 0);
        CHECK(same_springs(find_springs(&a), find_springs(&b)) && same_springs(find_springs(&a), find_springs(&c)));
        CHECK(a.material.density == c.material.density);
        CHECK(a.solve->number[CASE_STEPS] == c.solve->number[CASE_STEPS]);
        CHECK(a.solve->number[CASE_TOL] == c.solve->number[CASE_TOL]);
        if (!CHECK(most == 0))
            printf("%s: nodes %.1e, materials %.1e, supports %.1e, loads %.1e\n", path, e.nodes, e.materials,
                   e.supports, e.loads);
    }
    case_free(&a);
    case_free(&b);
    case_free(&c);
}

static void test_round(void)
{
    for (int i = 0; i < REFERENCE_COUNT; i++) {
        char path[512];
        if (!reference_path(path, sizeof path, i, "case.case")) {
            CHECK_SKIP("no ../shared/reference");
            return;
        }
        if (strstr(path, "fine") && !getenv("CHECK_SLOW"))
            continue;
        check_round(path, strstr(path, "uniaxial") || strstr(path, "lin_") || getenv("CHECK_SLOW"));
    }
}

static void test_random_round(void)
{
    static const char *const laws[] = {"svk E=%.17g nu=.3", "neo_hookean C10=%.17g D1=1e-5",
                                       "mooney_rivlin C10=%.17g C01=-1.5 D1=3.3333333333333333e-4",
                                       "reduced_polynomial C10=%.17g C20=7 C30=.1 D1=.002"};
    unsigned long long state = 2026;
    for (int i = 0; i < check_rounds(25); i++) {
        write_random_case("build/test_inp_random", laws, 0, &state);
        if (i % 2)
            add_random_springs("build/test_inp_random.case", &state);
        check_round("build/test_inp_random.case", 1);
    }
}

/* Allocations, sets and continuation at the size of an organ: 100,000 elements. */
static void test_size(void)
{
    static const char path[] = "build/test_inp_size.inp";
    int n = check_quick() ? 8 : 26, at = 0; /* 26^3 cells of 6 tets: 105,456 */
    sb_mesh mesh;
    case_file c;
    sb_error error;
    clock_t begin;
    memset(&mesh, 0, sizeof mesh);
    CHECK_OK(sb_mesh_beam(SB_TET4, n, n, n, sb_v3(1, 1, 1), NULL, &mesh, &error));
    FILE *file = fopen(path, "wb");
    if (!CHECK(file != NULL)) {
        sb_mesh_free(&mesh);
        return;
    }
    fprintf(file, "*NODE, NSET=ALL\n");
    for (int i = 0; i < mesh.node_count; i++)
        fprintf(file, "%d, %.9g, %.9g, %.9g\n", i + 1, (double)mesh.nodes[i].x, (double)mesh.nodes[i].y,
                (double)mesh.nodes[i].z);
    fprintf(file, "*ELEMENT, TYPE=C3D4, ELSET=ALL\n");
    for (int e = 0; e < mesh.element_count; e++, at += 4)
        fprintf(file, "%d, %d, %d, %d, %d\n", e + 1, mesh.elements[at] + 1, mesh.elements[at + 1] + 1,
                mesh.elements[at + 2] + 1, mesh.elements[at + 3] + 1);
    fprintf(file, "*NSET, NSET=END\n1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16,\n17\n"
                  "*MATERIAL, NAME=M\n*ELASTIC\n1000, .3\n*SOLID SECTION, ELSET=ALL, MATERIAL=M\n"
                  "*BOUNDARY\nEND, 1, 3\n*STEP\n*STATIC\n*END STEP\n");
    CHECK(fclose(file) == 0);
    begin = clock();
    int ok = inp_read(&c, path);
    printf("  %d elements read in %.2f s\n", mesh.element_count, (double)(clock() - begin) / (double)CLOCKS_PER_SEC);
    if (!CHECK(ok))
        printf("%s%s\n", c.faults.text ? c.faults.text : "", c.message);
    CHECK_INT(c.mesh.element_count, mesh.element_count);
    CHECK(c.mesh.elements && memcmp(c.mesh.elements, mesh.elements, (size_t)at * sizeof(int)) == 0);
    case_free(&c);
    sb_mesh_free(&mesh);
    remove(path);
}

CHECK_SUITE(inp, {"a column in all forms of lines", test_column}, {"ten mistakes", test_mistakes},
            {"labels", test_labels}, {"mistakes, one at a time", test_refused},
            {"loads and supports over steps", test_steps}, {"equations, CRLF", test_equation},
            {"faces by number and surface", test_faces}, {"tied surfaces", test_tie}, {"springs", test_springs},
            {"stiffness of springs", test_stiffness}, {"springs that are none", test_springs_refused},
            {"parts and instances", test_assembly}, {"assemblies that are none", test_assembly_refused},
            {"numbers", test_numbers}, {"reference cases", test_reference},
            {"reference cases there and back", test_round}, {"random cases there and back", test_random_round},
            {"100,000 elements", test_size});
