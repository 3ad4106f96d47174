/* Cases as scenes of SOFA: examples/case_scn_write.h. */
#include "softbody.h"

#include "check.h"

#include "../examples/case_feb.h"
#include "../examples/case_scn_write.h"

static const char path[] = "build/test_scn.scn", case_path[] = "build/test_scn.case";

static void write_file(const char *name, const char *text)
{
    FILE *file = fopen(name, "wb");
    int ok = file && fwrite(text, 1, strlen(text), file) == strlen(text);
    if (file)
        ok &= fclose(file) == 0;
    CHECK(ok);
}

/* A bar of tets and its lists. */
static void write_bar(sb_element_type type)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    CHECK_OK(sb_mesh_beam(type, 2, 1, 1, sb_v3((sb_real)0.3, (sb_real)0.1, (sb_real)0.1), NULL, &mesh, NULL));
    CHECK_OK(sb_mesh_save_vtk("build/test_scn.vtk", &mesh, NULL, 0, NULL));
    write_file("build/test_scn_fix", "0\n3\n6\n");
    write_file("build/test_scn_move", "2\n5\n");
    sb_mesh_free(&mesh);
}

/* A bar of two regions, by turns. */
static void write_regions(sb_element_type type)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    write_bar(type);
    CHECK_OK(sb_mesh_load(&mesh, "build/test_scn.vtk", NULL, NULL));
    free(mesh.regions);
    mesh.regions = (int *)malloc((size_t)mesh.element_count * sizeof(int));
    for (int e = 0; e < mesh.element_count && mesh.regions; e++)
        mesh.regions[e] = e % 2;
    CHECK_OK(sb_mesh_save_vtk("build/test_scn.vtk", &mesh, NULL, 0, NULL));
    sb_mesh_free(&mesh);
}

/* Writes the case of a few lines as a scene; 1 when it can be said. */
static int write_scene(case_file *c, const char *lines)
{
    char text[1024];
    int ok;
    snprintf(text, sizeof text, "mesh test_scn.vtk\n%s", lines);
    write_file(case_path, text);
    ok = case_read(c, case_path);
    if (!CHECK(ok))
        printf("%s\n", c->message);
    return ok && scn_write(c, path);
}

/* An attribute of a component of the scene, copied; "" when it is not there, or the scene is no XML. */
static const char *attribute(const char *component, const char *name, char *value, size_t size)
{
    const char *reason;
    char *text = case_read_text(path, &reason);
    xml_reader xml;
    xml_piece piece = XML_DONE;
    value[0] = 0;
    if (!CHECK(text != NULL))
        return value;
    xml = xml_open(text);
    while ((piece = xml_next(&xml)) > XML_DONE)
        if (piece == XML_OPEN && strcmp(xml.name, component) == 0 && xml_attribute_of(&xml, name))
            snprintf(value, size, "%s", xml_attribute_of(&xml, name));
    if (!CHECK(piece == XML_DONE))
        printf("%d: %s\n", xml.line, xml.message);
    free(text);
    return value;
}

static void check_attribute(const char *component, const char *name, const char *expected)
{
    char value[4096];
    attribute(component, name, value, sizeof value);
    if (!CHECK(strcmp(value, expected) == 0))
        printf("  %s %s: expected %s, got %s\n", component, name, expected, value);
}

/* Numbers of the mesh come back as they were. */
static void check_mesh(const case_file *c)
{
    char value[4096], *at = value;
    attribute("TetrahedronSetTopologyContainer", "position", value, sizeof value);
    for (int i = 0; i < 3 * c->mesh.node_count; i++)
        CHECK((sb_real)strtod(at, &at) == case_component(c->mesh.nodes[i / 3], i % 3));
    CHECK(*at == 0);
    attribute("TetrahedronSetTopologyContainer", "tetrahedra", at = value, sizeof value);
    for (int k = 0; k < 4 * c->mesh.element_count; k++)
        CHECK(strtol(at, &at, 10) == c->mesh.elements[k]);
    CHECK(*at == 0);
}

static void test_said(void)
{
    case_file c;
    write_bar(SB_TET4);
    CHECK(write_scene(&c, "material corotated E=1000 nu=0.25 density=900\nfix xyz nodes=test_scn_fix\n"
                          "prescribe xz nodes=test_scn_move value=0.5,0,-0.25 ramp=2\ngravity 0 0 -8\n"
                          "solve newmark dt=0.5 end=4 alpha=0.5 beta=0.125\n"));
    check_mesh(&c);
    check_attribute("Node", "gravity", "0 0 -8");
    check_attribute("Node", "dt", "0.5");
    check_attribute("NewmarkImplicitSolver", "rayleighMass", "0.5");
    check_attribute("NewmarkImplicitSolver", "rayleighStiffness", "0.125");
    check_attribute("MeshMatrixMass", "massDensity", "900");
    check_attribute("TetrahedronFEMForceField", "method", "polar");
    check_attribute("TetrahedronFEMForceField", "youngModulus", "1000");
    check_attribute("TetrahedronFEMForceField", "poissonRatio", "0.25");
    check_attribute("FixedProjectiveConstraint", "indices", "0 3 6");
    check_attribute("PartialLinearMovementProjectiveConstraint", "indices", "2 5");
    check_attribute("PartialLinearMovementProjectiveConstraint", "movedDirections", "1 0 1");
    check_attribute("PartialLinearMovementProjectiveConstraint", "keyTimes", "0 2 5");
    check_attribute("PartialLinearMovementProjectiveConstraint", "movements", "0 0 0 0.5 0 -0.25 0.5 0 -0.25");
    CHECK_INT(c.notes.count, 1);
    case_free(&c);
    CHECK(write_scene(&c, "material neo_hookean E=1000 nu=0.25 density=900\nfix xy nodes=test_scn_fix\n"
                          "fix z nodes=test_scn_fix\nforce nodes=test_scn_move value=0.5,0,2\n"
                          "solve static steps=1 tol=1e-6\n"));
    check_attribute("TetrahedronHyperelasticityFEMForceField", "materialName", "NeoHookean");
    check_attribute("TetrahedronHyperelasticityFEMForceField", "ParameterSet", "400 400");
    check_attribute("PartialFixedProjectiveConstraint", "fixedDirections", "0 0 1");
    check_attribute("ConstantForceField", "indices", "2 5");
    check_attribute("ConstantForceField", "forces", "0.5 0 2\n0.5 0 2");
    case_free(&c);
}

/* Faces of a scene's pressure: their area vectors sum to what the case's do, outward. */
static void check_faces(const case_file *c, const char *container, const char *name, int corners, sb_vec3 expected)
{
    char value[4096], *at = value;
    sb_vec3 sum = sb_v3(0, 0, 0);
    int count = 0, node[4];
    attribute(container, name, value, sizeof value);
    for (; *at; count++) {
        for (int k = 0; k < corners; k++)
            node[k] = (int)strtol(at, &at, 10);
        for (int k = 2; k < corners; k++) {
            const sb_vec3 *x = c->mesh.nodes;
            sb_vec3 a = sb_v3_sub(x[node[k - 1]], x[node[0]]), b = sb_v3_sub(x[node[k]], x[node[0]]);
            sum = sb_v3_madd(sum, (sb_real)0.5, sb_v3_cross(a, b));
        }
    }
    CHECK(count > 0);
    CHECK_NEAR(sb_v3_norm(sb_v3_sub(sum, expected)), 0, SB_REAL_IS_FLOAT ? 1e-6 : 1e-14);
}

static void test_bricks(void)
{
    static const char far_end[] = "select faces end box=.29,-1,-1,.31,1,1\npressure faces=@end value=25\n";
    char lines[512];
    case_file c;
    write_bar(SB_HEX8);
    snprintf(lines, sizeof lines,
             "material corotated E=1000 nu=0.25 density=900\nfix xyz nodes=test_scn_fix\n%s"
             "solve euler dt=0.5 end=4\n",
             far_end);
    CHECK(write_scene(&c, lines));
    check_attribute("HexahedronFEMForceField", "method", "polar");
    check_attribute("HexahedronFEMForceField", "youngModulus", "1000");
    check_attribute("HexahedronFEMForceField", "poissonRatio", "0.25");
    check_attribute("SurfacePressureForceField", "pressure", "-25");
    check_attribute("SurfacePressureForceField", "topology", "@faces");
    check_attribute("IdentityMapping", "input", "@../nodes");
    check_faces(&c, "QuadSetTopologyContainer", "quads", 4, sb_v3((sb_real)0.01, 0, 0));
    CHECK_INT(c.notes.count, 3); /* of the quads, of the rotations, of Euler's scheme */
    case_free(&c);
    CHECK(write_scene(&c, "material linear E=1000 nu=0.25 density=900\nfix xyz nodes=test_scn_fix\n"
                          "solve static steps=1 tol=1e-6\n"));
    check_attribute("HexahedronFEMForceField", "method", "small");
    check_attribute("HexahedronSetTopologyContainer", "hexahedra", "0 1 4 3 6 7 10 9\n1 2 5 4 7 8 11 10");
    CHECK_INT(c.notes.count, 1);
    case_free(&c);
    write_bar(SB_TET4);
    CHECK(write_scene(&c, lines));
    check_faces(&c, "TriangleSetTopologyContainer", "triangles", 3, sb_v3((sb_real)0.01, 0, 0));
    CHECK_INT(c.notes.count, 1);
    case_free(&c);
}

static void test_regions(void)
{
    char value[4096], *at = value;
    case_file c;
    write_regions(SB_TET4);
    CHECK(write_scene(&c, "material linear E=10 nu=0.25 density=900 region=0\n"
                          "material linear E=30 nu=0.25 density=1100 region=1\nfix xyz nodes=test_scn_fix\n"
                          "solve static steps=1 tol=1e-6\n"));
    attribute("TetrahedronFEMForceField", "youngModulus", value, sizeof value);
    for (int e = 0; e < c.mesh.element_count; e++)
        CHECK_NEAR(strtod(at, &at), c.mesh.regions[e] ? 30 : 10, 0);
    CHECK(*at == 0);
    attribute("MeshMatrixMass", "massDensity", at = value, sizeof value);
    for (int e = 0; e < c.mesh.element_count; e++)
        CHECK_NEAR(strtod(at, &at), c.mesh.regions[e] ? 1100 : 900, 0);
    CHECK(*at == 0);
    check_attribute("TetrahedronFEMForceField", "poissonRatio", "0.25");
    case_free(&c);
}

static void check_refused(const char *lines, int line, const char *words)
{
    case_file c;
    int ok = write_scene(&c, lines);
    CHECK(!ok);
    if (!CHECK_INT(c.error_line, line) || !CHECK(strstr(c.message, words) != NULL))
        printf("  expected line %d: %s\n  got  line %d: %s\n", line, words, c.error_line, c.message);
    case_free(&c);
}

static void test_refused(void)
{
#define STATIC "solve static steps=1 tol=1e-6\n"
#define GEL "material corotated E=1000 nu=.25 density=900\n"
    write_bar(SB_TET4);
    check_refused("material mooney_rivlin C10=1 C01=1 D1=1 density=1\n" STATIC, 2, "SOFA has no such law");
    check_refused("material neo_hookean C10=1 D1=1 density=1\n" STATIC, 2, "with D1");
    check_refused("material svk E=1 nu=0 density=1 g1=.5 tau1=1\n" STATIC, 2, "relaxation");
    check_refused(GEL "prescribe x nodes=test_scn_move value=1,0,0\n" STATIC, 3, "without ramp=");
    write_file("build/test_scn_spring", "2 5 0 0 0\n");
    check_refused(GEL "spring file=test_scn_spring\n" STATIC, 3, "spring cannot be said");
    check_refused(GEL "solve modes count=2\n", 3, "solve modes");
    write_bar(SB_HEX8);
    check_refused("material svk E=1 nu=0 density=1\n" STATIC, 2, "svk of hex8 cannot be said");
    check_refused("element hex8bbar\n" GEL STATIC, 2, "element hex8bbar cannot be said");
    write_regions(SB_HEX8);
    check_refused(
        "material corotated E=1 nu=0 density=1 region=0\nmaterial corotated E=2 nu=0 density=1 region=1\n" STATIC, 3,
        "a second material of hex8");
    write_bar(SB_TET10);
    check_refused(GEL STATIC, 1, "elements of type tet10");
    write_regions(SB_TET4);
    check_refused("material svk E=1 nu=0 density=1 region=0\nmaterial svk E=2 nu=0 density=1 region=1\n" STATIC, 3,
                  "regions of material svk");
    check_refused(
        "material linear E=1 nu=0 density=1 region=0\nmaterial corotated E=2 nu=0 density=1 region=1\n" STATIC, 3,
        "corotated beside linear of line 2");
    check_refused("material linear E=1 nu=0 density=1 region=0\nmaterial linear E=1 nu=.25 density=1 region=1\n" STATIC,
                  3, "nu=0.25 beside 0 of line 2");
}

CHECK_SUITE(scn, {"what is said", test_said}, {"bricks and pressures", test_bricks}, {"regions", test_regions},
            {"what is refused", test_refused});
