/* Loads and constraints: pressure that follows, springs, penalty mappings, equations among displacements,
 * tied meshes. */
#include "verification_scene.h"

static const double young = 1e4, exact = 1e-8;

/* ---- pressure ---- */

typedef struct mesh_choice {
    const char *element;
    int across, around;
    double cylinder_bound, sphere_bound, even_cylinder_bound, even_sphere_bound; /* of graded meshes, and even ones */
} mesh_choice;

static void lame_case(const mesh_choice *choice, int sphere, int even)
{
    static const double inner = 1, outer = 2, poisson = 0.3, pressure = 1e-3;
    static const verify_ring ring = {1, 2, VERIFY_PI / 2, 0.1};
    double a2 = inner * inner, b2 = outer * outer, a3 = a2 * inner, b3 = b2 * outer;
    double unit = pressure * inner / young, bound = sphere ? choice->sphere_bound : choice->cylinder_bound;
    double even_bound = sphere ? choice->even_sphere_bound : choice->even_cylinder_bound;
    const verify_element *element = verify_element_named(choice->element);
    verify_where where = sphere ? verify_on_sphere : verify_on_cylinder;
    double expected = sphere ? unit * ((1 - 2 * poisson) * a3 + (1 + poisson) * b3 / 2) / (b3 - a3)
                             : unit * (1 + poisson) * ((1 - 2 * poisson) * a2 + b2) / (b2 - a2);
    sb_mesh mesh = sphere ? verify_octant(element->type, inner, outer, choice->across, choice->around, even)
                          : verify_block(element->type, choice->across, 2 * choice->around, 1,
                                         even ? verify_map_even_ring : verify_map_ring, &ring, 0);
    sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), 1000));
    char name[80];
    verify_hold_symmetry(body, &mesh, sphere ? 3 : 2);
    for (int k = 0; k < mesh.node_count && !sphere; k++)
        CHECK_OK(sb_body_fix_nodes(body, &k, 1, SB_Z));
    verify_press(body, &mesh, where, &inner, pressure);
    verify_solve(body);
    snprintf(name, sizeof name, "%s b/a = 2 under pressure that follows, %dx%d%s",
             sphere ? "thick sphere" : "thick cylinder", choice->across, (sphere ? 1 : 2) * choice->around,
             verify_gradings[even]);
    verify(name, choice->element, sphere ? "Lame 1852" : "Lame 1852, plane strain", "u(a) (m)", expected,
           verify_outward(body, &mesh, where, inner), even ? even_bound : bound);
    verify_free(body, &mesh);
}

/* As the dead pressures of verification_solids, so small that following makes no difference of note. */
static void test_lame(void)
{
    static const mesh_choice choices[] = {
        {"tet4", 8, 8, 0.016, 0.03, 0.014, 0.029},    {"tet10", 3, 3, 4e-6, 8e-4, 0.00072, 0.004},
        {"hex8", 8, 8, 0.006, 0.015, 0.0048, 0.014},  {"hex8, B-bar", 8, 8, 0.004, 0.009, 0.0032, 0.0084},
        {"hex20", 3, 3, 3e-5, 3e-4, 0.00024, 0.0017}, {"hex27", 3, 3, 4e-6, 9e-5, 0.00028, 0.0016}};
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("small pressures need double");
        return;
    }
    for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++)
        for (int k = 0; k < 4; k++)
            lame_case(choices + i, k / 2, k % 2);
}

/* A thick sphere whose inner radius the pressure of its differential equation should take to 1.1 times
 * itself. */
static void balloon_case(const verify_element *element, int cells, const verify_material *material, int even,
                         double bound)
{
    static const double inner = 1, outer = 2, stretch = 1.1, poisson = 0.3;
    sb_mesh mesh = verify_octant(element->type, inner, outer, cells, cells, even);
    sb_body *body = verify_body(&mesh, element, material->make(REAL(young), REAL(poisson), 1000));
    char name[96], what[80];
    verify_hold_symmetry(body, &mesh, 3);
    verify_press(body, &mesh, verify_on_sphere, &inner, verify_inflation_pressure(material, young, poisson, stretch));
    verify_solve(body);
    snprintf(name, sizeof name, "thick sphere b/a = 2 blown up to 1.1 a, nu 0.3, octant, 3 of %dx%dx%d%s", cells, cells,
             cells, verify_gradings[even]);
    snprintf(what, sizeof what, "%s, %s", element->name, material->name);
    verify(name, what, "d(R^2 P_r)/dR = 2 R P_t (Ogden 1997), integrated in the test", "u(a) (m)", stretch - 1,
           verify_outward(body, &mesh, verify_on_sphere, inner), bound);
    verify_free(body, &mesh);
}

static void test_balloon(void)
{
    static const mesh_choice choices[] = {{"hex8", 6, 6, 0, 0.027, 0, 0.025},
                                          {"hex8, B-bar", 6, 6, 0, 0.018, 0, 0.016},
                                          {"hex20", 3, 3, 0, 2.2e-4, 0, 0.0011},
                                          {"hex27", 3, 3, 0, 2e-5, 0, 0.00096}};
    static const double bounds[2][2] = {{1e-3, 0.005}, {0.0045, 0.015}};
    for (int m = 0; m < VERIFY_MATERIALS; m++)
        for (int even = 0; even < 2; even++)
            balloon_case(verify_element_named("tet10"), 3, verify_materials + m, even,
                         bounds[even][verify_materials[m].principal == verify_svk]);
    for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++)
        for (int even = 0; even < 2; even++)
            balloon_case(verify_element_named(choices[i].element), choices[i].across, verify_materials + 4, even,
                         even ? choices[i].even_sphere_bound : choices[i].sphere_bound);
}

/* Pressure on all of a closed surface, however deformed, has no resultant and no torque; along the motion u =
 * x its work is -p dV = -3 p V. */
static void test_closed(void)
{
    static const double amplitude = 0.05, pressure = 1000;
    for (int e = 0; e < VERIFY_ELEMENTS; e++) {
        const verify_element *element = verify_elements + e;
        sb_mesh mesh;
        sb_body *body;
        sb_vec3 force, torque, *u;
        double work = 0;
        int id;
        if (!verify_suits(element, SB_LINEAR))
            continue;
        mesh = verify_block(element->type, 2, 2, 2, verify_map_distorted, &amplitude, 0);
        body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(0.3), 1000));
        u = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
        for (int i = 0; i < mesh.node_count; i++) {
            sb_vec3 x = mesh.nodes[i]; /* shears, which keep the volume */
            u[i] = sb_v3(REAL(0.2) * (x.y - x.z), REAL(0.3) * x.z, 0);
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, u + i, 1));
        }
        id = verify_press(body, &mesh, verify_anywhere, NULL, pressure);
        verify_solve(body);
        CHECK_OK(sb_body_load_force(body, id, sb_v3(1, 2, 3), &force, &torque));
        for (int i = 0; i < mesh.node_count; i++)
            work += (double)sb_v3_dot(sb_body_external_forces(body)[i], sb_body_positions(body)[i]);
        verify("pressure on a closed surface, sheared 2x2x2", element->name, "int n dA = 0, int x x n dA = 0",
               "force and torque/(p m^2)", 0, ((double)sb_v3_norm(force) + (double)sb_v3_norm(torque)) / pressure,
               exact);
        verify("pressure on a closed surface, sheared 2x2x2", element->name, "int x . n dA = 3 V", "f . x/(p m^3)", -3,
               work / pressure, exact);
        free(u);
        verify_free(body, &mesh);
    }
}

/* ---- springs and mappings: a bar in series with them ---- */

static const verify_plane left = {0, 0}, right = {0, 1};

static sb_body *bar(sb_mesh *mesh, const verify_element *element)
{
    sb_body *body;
    *mesh = verify_box(element->type, 2, 1, 1, 1, 0.5, 0.4);
    body = verify_body(mesh, element, sb_material_linear(REAL(young), 0, 1000));
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    return body;
}

/* Shares of the nodes at x = 1 in a uniform traction there; returns how many nodes there are. */
static int traction_shares(const verify_element *element, int *nodes, sb_real *shares)
{
    const sb_vec3 pull = sb_v3(REAL(1 / (0.5 * 0.4)), 0, 0);
    sb_mesh mesh;
    sb_body *body = bar(&mesh, element);
    int count = 0;
    verify_load(body, &mesh, verify_on_plane, &right, verify_uniform, &pull);
    verify_solve(body);
    for (int i = 0; i < mesh.node_count; i++)
        if (verify_on_plane(&right, mesh.nodes[i])) {
            nodes[count] = i;
            shares[count++] = sb_body_external_forces(body)[i].x;
        }
    verify_free(body, &mesh);
    return count;
}

enum { MOST_SHARES = 32 };

/* Ends of the bar drawn out by 0.3 m: with K = E A/L and k the end moves 0.3 k/(k + K), and the bar stays
 * uniform. */
static void series_case(const verify_element *element, int mapped)
{
    static const double k = 3e3, far = 0.3, stiffness = 1e4 * 0.5 * 0.4;
    int nodes[MOST_SHARES], count, id = 0, row[2] = {0, 0};
    sb_real shares[MOST_SHARES], each[MOST_SHARES], all = REAL(k);
    sb_vec3 points[MOST_SHARES], force, torque, mean = sb_v3(0, 0, 0);
    double worst = 0, expected = far * k / (k + stiffness);
    sb_mesh mesh;
    sb_body *body = bar(&mesh, element);
    count = traction_shares(element, nodes, shares);
    for (int i = 0; i < count; i++) {
        each[i] = shares[i] > 0 ? REAL(k) * shares[i] : 0; /* tet10 has corners without a share, up to rounding */
        points[i] = sb_v3_add(mesh.nodes[nodes[i]], sb_v3(REAL(far), 0, 0));
        mean = sb_v3_add(mean, sb_v3_scale(shares[i], points[i]));
    }
    if (mapped) {
        sb_mapping mapping;
        row[1] = count;
        mapping.row_count = 1;
        mapping.row_start = row;
        mapping.nodes = nodes;
        mapping.weights = shares;
        CHECK_OK(sb_body_add_mapping(body, &mapping, &all, 1, &mean, &id, NULL));
    } else {
        CHECK_OK(sb_body_add_springs(body, nodes, count, each, 0, points, &id, NULL));
    }
    verify_solve(body);
    CHECK_OK(sb_body_load_force(body, id, sb_v3(0, 0, 0), &force, &torque));
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 u = sb_v3(REAL(expected) * mesh.nodes[i].x, 0, 0);
        worst = verify_worse(worst, (double)sb_v3_norm(sb_v3_sub(sb_body_displacements(body)[i], u)) / expected);
    }
    const char *name = mapped ? "bar drawn by a mapping of its end's mean" : "bar drawn by springs at its end";
    verify(name, element->name, "0.3 k/(k + EA/L) EA/L", "force (N)", expected * stiffness, (double)force.x, exact);
    verify(name, element->name, "u = x 0.3 k/(k + EA/L)", "largest error of u/u(L)", 0, worst, exact);
    verify_free(body, &mesh);
}

static void test_series(void)
{
    for (int e = 0; e < VERIFY_ELEMENTS; e++) {
        if (!verify_suits(verify_elements + e, SB_LINEAR))
            continue;
        if (verify_elements[e].type != SB_HEX20) /* the corners' share of a traction is negative */
            series_case(verify_elements + e, 0);
        series_case(verify_elements + e, 1);
    }
}

static sb_body *spring_cube(sb_mesh *mesh, double k, sb_integrator integrator)
{
    sb_body_def def;
    sb_body *body;
    sb_real each = REAL(k / 8);
    int nodes[8], id = 0;
    *mesh = verify_box(SB_HEX8, 1, 1, 1, 0.1, 0.1, 0.1);
    def = verify_def(mesh, verify_element_named("hex8"), sb_material_corotated(REAL(young), REAL(0.3), 1000));
    def.integrator = integrator;
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-6 : 1e-13);
    def.newton_tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-13);
    body = scene_body(&def);
    for (int i = 0; i < 8; i++)
        nodes[i] = i;
    CHECK_OK(sb_body_add_springs(body, nodes, 8, &each, 1, mesh->nodes, &id, NULL));
    return body;
}

/* A cube of 1 kg on springs of the same stiffness at its 8 nodes moves as a point: it sags m g/k, and swings
 * with w^2 = k/m as Newmark's rule does. */
static void test_oscillator(void)
{
    static const double k = 50, gravity = 2, speed = 0.3, dt = 0.02;
    static const int steps = 100;
    double w = sqrt(k / 1.0), turn = 2 * atan(w * dt / 2);
    sb_vec3 v[8];
    sb_mesh mesh;
    sb_body *body = spring_cube(&mesh, k, SB_NEWMARK);
    CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, REAL(-gravity))));
    verify_solve(body);
    verify("cube on springs under its weight", "hex8", "m g/k", "sag (m)", -gravity / k,
           (double)sb_body_displacements(body)[0].z, exact);
    verify_free(body, &mesh);
    body = spring_cube(&mesh, k, SB_NEWMARK);
    for (int i = 0; i < 8; i++)
        v[i] = sb_v3(REAL(speed), 0, 0);
    CHECK_OK(sb_body_set_velocities(body, v));
    for (int s = 0; s < steps; s++)
        CHECK_OK(sb_body_step(body, REAL(dt), NULL));
    verify("cube swinging on springs, 100 Newmark steps", "hex8", "w^2 = k/m, w_h = 2/dt atan(w dt/2)",
           "displacement after 2 s (m)", speed / w * sin(steps * turn), (double)sb_body_displacements(body)[0].x,
           exact);
    verify_free(body, &mesh);
}

/* ---- equations ---- */

static sb_constraint_term term(int node, int axis, double coefficient)
{
    sb_constraint_term t;
    t.node = node;
    t.axis = axis;
    t.coefficient = REAL(coefficient);
    return t;
}

static int node_at(const sb_mesh *mesh, sb_vec3 x)
{
    for (int i = 0; i < mesh->node_count; i++)
        if (sb_v3_norm(sb_v3_sub(mesh->nodes[i], x)) < REAL(1e-5))
            return i;
    return -1;
}

/* Opposite faces of the unit cube differ by the mean gradient g e_along (x) e_across; the origin is held. */
static void make_periodic(sb_body *body, const sb_mesh *mesh, int along, int across, double g)
{
    sb_constraint_term *terms = (sb_constraint_term *)malloc((size_t)mesh->node_count * 6 * sizeof *terms);
    int *counts = (int *)malloc((size_t)mesh->node_count * 3 * sizeof *counts), count = 0, first = 0;
    int origin = node_at(mesh, sb_v3(0, 0, 0));
    sb_real *values = (sb_real *)malloc((size_t)mesh->node_count * 3 * sizeof *values);
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 x = mesh->nodes[i];
        int face = x.x > REAL(0.9999) ? 0 : x.y > REAL(0.9999) ? 1 : x.z > REAL(0.9999) ? 2 : -1, opposite;
        if (face < 0)
            continue;
        opposite = node_at(mesh, sb_v3(face == 0 ? 0 : x.x, face == 1 ? 0 : x.y, face == 2 ? 0 : x.z));
        for (int axis = 0; axis < 3 && CHECK(opposite >= 0); axis++) {
            terms[2 * count] = term(i, axis, 1);
            terms[2 * count + 1] = term(opposite, axis, -1);
            values[count] = REAL(axis == along && face == across ? g : 0);
            counts[count++] = 2;
        }
    }
    CHECK_OK(sb_body_add_constraints(body, terms, counts, values, count, &first, NULL));
    CHECK_OK(sb_body_fix_nodes(body, &origin, 1, SB_XYZ));
    free(terms);
    free(counts);
    free(values);
}

/* A laminate of two halves along z: across the layers moduli add as compliances, along them as stiffnesses.
 */
static void laminate_case(const verify_element *element, int along, int across, const char *name, const char *source,
                          double expected)
{
    static const double g = 0.01;
    sb_mesh mesh = verify_box(element->type, 2, 2, 4, 1, 1, 1);
    sb_region_material soft;
    sb_body_def def = verify_def(&mesh, element, sb_material_linear(REAL(young), REAL(0.3), 1000));
    sb_energy energy = {0, 0, 0};
    sb_body *body;
    int nodes = sb_element_node_count(element->type), corners = sb_element_corner_count(element->type);
    mesh.regions = (int *)calloc((size_t)mesh.element_count, sizeof(int));
    for (int e = 0; e < mesh.element_count; e++) {
        double height = 0;
        for (int a = 0; a < corners; a++)
            height += (double)mesh.nodes[mesh.elements[e * nodes + a]].z / corners;
        mesh.regions[e] = height > 0.5;
    }
    soft.region = 1;
    soft.material = sb_material_linear(REAL(young / 10), REAL(0.3), 1000);
    def.region_materials = &soft;
    def.region_material_count = 1;
    body = scene_body(&def);
    make_periodic(body, &mesh, along, across, g);
    verify_solve(body);
    CHECK_OK(sb_body_energy(body, &energy));
    verify(name, element->name, source, "2 W/(g^2 m^3) (Pa)", expected, 2 * (double)energy.elastic / (g * g), exact);
    verify_free(body, &mesh);
}

static void test_periodic(void)
{
    verify_constants c = verify_constants_of(young, 0.3);
    double m = c.lambda + 2 * c.mu;
    for (int e = 0; e < VERIFY_ELEMENTS; e++) {
        if (!verify_suits(verify_elements + e, SB_LINEAR))
            continue;
        laminate_case(verify_elements + e, 0, 2, "periodic laminate 1:10, sheared across its layers, 2x2x4",
                      "Reuss 1929: 1/G = (1/G1 + 1/G2)/2", 2 / (1 / c.mu + 10 / c.mu));
        laminate_case(verify_elements + e, 0, 1, "periodic laminate 1:10, sheared along its layers, 2x2x4",
                      "Voigt 1889: G = (G1 + G2)/2", (c.mu + c.mu / 10) / 2);
        laminate_case(verify_elements + e, 2, 2, "periodic laminate 1:10, stretched across its layers, 2x2x4",
                      "Backus 1962: 1/M = (1/M1 + 1/M2)/2, M = lambda + 2 mu", 2 / (1 / m + 10 / m));
    }
}

/* A beam whose end is a rigid plate, by equations: a couple F h on it bends the beam by M L/(E I) and lifts
 * its end by M L^2/(2 E I). nu = 0. */
static void test_plate(void)
{
    static const char *elements[] = {"tet10", "hex20", "hex27"};
    static const double h = 0.2, force = 0.5;
    for (int e = 0; e < 3; e++) {
        const verify_element *element = verify_element_named(elements[e]);
        sb_mesh mesh = verify_box(element->type, 4, 2, 2, 1, h, h);
        sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), 0, 1000));
        int bottom = node_at(&mesh, sb_v3(1, 0, 0)), top = node_at(&mesh, sb_v3(1, 0, REAL(h)));
        int side = node_at(&mesh, sb_v3(1, REAL(h), 0));
        double bending = force * h / (young * pow(h, 4) / 12);
        sb_vec3 pull = sb_v3(REAL(force), 0, 0), push = sb_v3(REAL(-force), 0, 0);
        for (int i = 0; i < mesh.node_count; i++) {
            sb_constraint_term terms[4];
            double y = (double)mesh.nodes[i].y / h, z = (double)mesh.nodes[i].z / h;
            if (!verify_on_plane(&right, mesh.nodes[i]) || i == bottom || i == top || i == side)
                continue;
            terms[0] = term(i, 0, 1);
            terms[1] = term(bottom, 0, y + z - 1);
            terms[2] = term(side, 0, -y);
            terms[3] = term(top, 0, -z);
            CHECK_OK(sb_body_add_constraint(body, terms, 4, 0, NULL, NULL));
        }
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_add_forces(body, &top, 1, &pull, 1));
        CHECK_OK(sb_body_add_forces(body, &bottom, 1, &push, 1));
        verify_solve(body);
        verify("couple on a rigid end plate, 4x2x2", elements[e], "Euler-Bernoulli: M L/EI",
               "rotation of the plate (rad)", bending,
               (double)(sb_body_displacements(body)[top].x - sb_body_displacements(body)[bottom].x) / h, exact);
        verify("couple on a rigid end plate, 4x2x2", elements[e], "Euler-Bernoulli: M L^2/2EI", "deflection (m)",
               -bending / 2, (double)sb_body_displacements(body)[bottom].z, exact);
        verify_free(body, &mesh);
    }
}

/* ---- ties ---- */

/* A bar of two halves, 2x2 and 4x4 cells across, tied and pulled by tractions: uniform stress as of one
 * piece. */
static void tie_case(const verify_element *element)
{
    static const double stress = 100, poisson = 0.3;
    static const verify_plane middle = {0, 0.5};
    sb_mesh mesh = verify_box(element->type, 2, 2, 2, 0.5, 0.4, 0.3);
    sb_mesh fine = verify_box(element->type, 3, 4, 4, 0.5, 0.4, 0.3);
    int split = mesh.node_count, corners = verify_face_corners(&mesh), face_count, slave_count = 0;
    int *faces, *slaves = (int *)malloc((size_t)fine.node_count * sizeof(int));
    sb_vec3 pull = sb_v3(REAL(stress), 0, 0);
    sb_body *body;
    double worst = 0;
    for (int i = 0; i < fine.node_count; i++)
        fine.nodes[i].x += REAL(0.5);
    face_count = verify_faces(&mesh, verify_on_plane, &middle, corners, &faces);
    CHECK_OK(sb_mesh_append(&mesh, &fine, NULL));
    body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), 1000));
    for (int i = split; i < mesh.node_count; i++)
        if (verify_on_plane(&middle, mesh.nodes[i]))
            slaves[slave_count++] = i;
    CHECK_OK(sb_body_tie_faces(body, faces, face_count, corners, slaves, slave_count, -1, SB_TIE_ALL, NULL, NULL));
    for (int i = 0; i < split; i++) { /* the coarse half is held on rollers */
        sb_vec3 x = mesh.nodes[i];
        int axes = (verify_on_plane(&left, x) ? SB_X : 0) | (x.y == 0 ? SB_Y : 0) | (x.z == 0 ? SB_Z : 0);
        if (axes)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, axes));
    }
    verify_load(body, &mesh, verify_on_plane, &right, verify_uniform, &pull);
    verify_solve(body);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 x = mesh.nodes[i], u = sb_v3(x.x, REAL(-poisson) * x.y, REAL(-poisson) * x.z);
        u = sb_v3_sub(sb_v3_scale(REAL(young / stress), sb_body_displacements(body)[i]), u);
        worst = verify_worse(worst, (double)sb_v3_norm(u));
    }
    verify("bar of two tied halves, 2x2 and 4x4 cells across", element->name, "Hooke: u = s/E (x, -nu y, -nu z)",
           "largest error of u E/s", 0, worst, exact);
    free(faces);
    free(slaves);
    sb_mesh_free(&fine);
    verify_free(body, &mesh);
}

static void test_ties(void)
{
    for (int e = 0; e < VERIFY_ELEMENTS; e++)
        if (verify_suits(verify_elements + e, SB_LINEAR))
            tie_case(verify_elements + e);
}

static void test_table(void) { verify_table("verification_loads"); }

CHECK_SUITE(verification_loads, {"Lame", test_lame}, {"balloon", test_balloon}, {"closed surface", test_closed},
            {"springs and mappings in series", test_series}, {"oscillator", test_oscillator},
            {"periodic laminate", test_periodic}, {"rigid plate", test_plate}, {"ties", test_ties},
            {"table", test_table});
