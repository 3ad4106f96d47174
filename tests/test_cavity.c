/* Cavities: volumes, laws and stiffness against closed forms and differences; what is injected is there; balance, undo,
 * states, recordings and changes of the mesh with what holds for every load. */
#define SB_SPLIT_BUILD
#include "../src/softbody/body/body_private.h"
#include "../src/softbody/body/cavity.h"
#include "../src/softbody/body/cavity_law.h"
#include "../src/softbody/body/load.h"
#include "../src/softbody/body/record.h"
#include "../src/softbody/body/state.h"

#include "check.h"
#include "random_case.h"

/* ---- hollow bodies ---- */

static double largest(sb_vec3 x) { return fmax(fmax(fabs((double)x.x), fabs((double)x.y)), fabs((double)x.z)); }

/* A cube of half edge 1 m about the origin of n^3 cells without those nearer than `hollow`; round: each |x|_max is a
 * sphere of this radius. */
static sb_mesh hollow_mesh(sb_element_type type, int n, double hollow, int round)
{
    sb_mesh mesh = scene_box(type, n, n, n, sb_v3(2, 2, 2), 0);
    int width = sb_element_node_count(mesh.element_type), kept = 0;
    for (int i = 0; i < mesh.node_count; i++)
        mesh.nodes[i] = sb_v3_sub(mesh.nodes[i], sb_v3(1, 1, 1));
    for (int e = 0; e < mesh.element_count; e++) {
        sb_vec3 middle = sb_v3(0, 0, 0);
        for (int a = 0; a < sb_element_corner_count(mesh.element_type); a++)
            middle = sb_v3_madd(middle, 1 / REAL(sb_element_corner_count(mesh.element_type)),
                                mesh.nodes[mesh.elements[e * width + a]]);
        if (largest(middle) > hollow)
            memmove(mesh.elements + width * kept++, mesh.elements + width * e, (size_t)width * sizeof(int));
    }
    mesh.element_count = kept;
    for (int i = 0; round && i < mesh.node_count; i++) {
        double length = (double)sb_v3_norm(mesh.nodes[i]);
        if (length > 0)
            mesh.nodes[i] = sb_v3_scale(REAL(largest(mesh.nodes[i]) / length), mesh.nodes[i]);
    }
    return mesh;
}

/* Faces of the cavity, but for those all of whose nodes have x > open (1e9: all are there); to be freed. */
static int *inner_faces(const sb_mesh *mesh, double hollow, int round, double open, int *count, int *corners)
{
    sb_boundary boundary;
    int *faces, width;
    *count = 0;
    if (!CHECK_OK(sb_mesh_boundary(mesh, 0, NULL, &boundary, NULL)))
        return NULL;
    width = sb_element_node_count(boundary.surface.element_type);
    *corners = sb_element_corner_count(boundary.surface.element_type);
    faces = (int *)malloc((size_t)boundary.surface.element_count * 4 * sizeof(int));
    for (int f = 0; f < boundary.surface.element_count && CHECK(faces); f++) {
        const int *face = boundary.surface.elements + f * width;
        int inside = 1, beyond = 1;
        for (int a = 0; a < *corners; a++) {
            sb_vec3 x = mesh->nodes[face[a]];
            inside &= (round ? (double)sb_v3_norm(x) : largest(x)) < hollow * (1 + 1e-5);
            beyond &= (double)x.x > open;
        }
        if (inside && !beyond)
            memcpy(faces + *corners * (*count)++, face, (size_t)*corners * sizeof(int));
    }
    sb_boundary_free(&boundary);
    return faces;
}

typedef struct hollow {
    sb_mesh mesh;
    sb_body *body;
    int id, count, corners;
    int *faces;
} hollow;

static sb_body_def hollow_def(const sb_mesh *mesh, double young)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = sb_material_neo_hookean(REAL(young), REAL(0.3), 1000);
    def.max_newton = 20;
    def.tolerance = REAL(scene_tolerance(1e-10, 16));
    return def;
}

static int hollow_make(hollow *h, sb_element_type type, int n, double inner, int round, double open,
                       const sb_body_def *like, sb_cavity_def def)
{
    sb_body_def body_def;
    memset(h, 0, sizeof *h);
    h->mesh = hollow_mesh(type, n, inner, round);
    body_def = like ? *like : hollow_def(&h->mesh, 1e4);
    body_def.mesh = &h->mesh;
    h->body = scene_body(&body_def);
    h->faces = inner_faces(&h->mesh, inner, round, open, &h->count, &h->corners);
    def.faces = h->faces, def.face_count = h->count, def.corners = h->corners;
    return CHECK(h->count > 0) && CHECK_OK(sb_body_add_cavity(h->body, &def, &h->id, NULL));
}

static void hollow_free(hollow *h)
{
    sb_body_destroy(h->body);
    sb_mesh_free(&h->mesh);
    free(h->faces);
}

static sb_cavity_def filled_with(sb_cavity_kind kind, double pressure)
{
    sb_cavity_def def = sb_default_cavity_def();
    def.kind = kind;
    def.pressure = REAL(pressure);
    return def;
}

static double volume_of(const hollow *h)
{
    sb_real volume = 0;
    CHECK_OK(sb_body_cavity_volume(h->body, h->id, &volume));
    return (double)volume;
}

static double pressure_of(const hollow *h)
{
    sb_real pressure = 0;
    CHECK_OK(sb_body_cavity_pressure(h->body, h->id, &pressure));
    return (double)pressure;
}

/* Holds a plane so that nothing can move freely. */
static void hold_end(const hollow *h) { scene_fix_plane(h->body, &h->mesh, 0, -1, SB_XYZ); }

static sb_static_options exact_options(void)
{
    sb_static_options options = sb_default_static_options();
    options.tolerance = REAL(scene_tolerance(1e-11, 64));
    options.max_newton = 60;
    return options;
}

static int solve(sb_body *body)
{
    sb_static_options options = exact_options();
    sb_step_info info;
    int ok = CHECK_OK(sb_body_solve_static(body, &options, &info));
    if (!ok)
        printf("%s (factor %g)\n", info.error.message, (double)info.load_factor);
    return ok;
}

/* ---- volume ---- */

/* A cube's, also with a side that a lid closes, and spheres'. */
static void test_volume(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    for (int k = 0; k < 5; k++)
        for (int open = 0; open < 2; open++) {
            hollow h;
            const double half = 0.5;
            if (hollow_make(&h, types[k], 4, half, 0, open ? 0.49 : 1e9, NULL, filled_with(SB_CAVITY_PRESSURE, 0)))
                CHECK_NEAR(volume_of(&h), 8 * half * half * half, scene_tolerance(1e-13, 100));
            hollow_free(&h);
            if (k != 2 || open)
                continue;
            if (hollow_make(&h, SB_HEX8, 16, half, 1, 1e9, NULL, filled_with(SB_CAVITY_PRESSURE, 0)))
                CHECK_NEAR(volume_of(&h), 4.0 / 3 * 3.14159265358979 * half * half * half, 0.1 * half * half * half);
            hollow_free(&h);
        }
}

/* ---- one cavity against its energy ---- */

static sb_cavity_def random_def(unsigned long long *seed, sb_cavity_kind kind)
{
    sb_cavity_def def = filled_with(kind, check_random_in(seed, -500, 500));
    def.ambient = REAL(check_random_in(seed, 600, 1e5));
    def.exponent = random_below(seed, 2) ? 1 : REAL(1.4);
    def.bulk = REAL(random_scale(seed, 1e2, 1e6));
    def.point_count = 4;
    for (int k = 0; k < 4; k++) {
        def.table_volume[k] = REAL(0.3 + 0.3 * k);
        def.table_pressure[k] = REAL(700 - 150 * k - 40 * k * k);
    }
    return def;
}

/* Force = - slope of the energy, stiffness with the rank-one part = - slope of the force, closed or with lids; where
 * these are, all but what they add to the turning. */
static void test_law(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    static const double at[4] = {-2, -1, 1, 2}, weight[4] = {1.0 / 12, -8.0 / 12, 8.0 / 12, -1.0 / 12};
    unsigned long long seed = 67;
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("differences need double");
        return;
    }
    for (int round = 0; round < check_rounds(50); round++) {
        const double step = 1e-4;
        hollow h;
        int n, open = round % 2;
        sb_vec3 *u, *d, *moved, *product;
        double slope = 0, work = 0, most = 0, stiffness = 0, error = 0;
        sbi_load *load;
        if (!hollow_make(&h, types[round % 5], 4, 0.5, 0, open ? 0.49 : 1e9, NULL,
                         random_def(&seed, (sb_cavity_kind)(round / 2 % 5))))
            return;
        n = h.mesh.node_count;
        u = (sb_vec3 *)calloc(4 * (size_t)n, sizeof *u), d = u + n, moved = d + n, product = moved + n;
        load = sbi_load_find(h.body, h.id, 0);
        load->cavity.hold.stiff = 3000, load->cavity.hold.pressure = 70;
        for (int i = 0; i < n && CHECK(u); i++) {
            u[i] = sb_v3_scale(REAL(0.02), random_direction(&seed));
            d[i] = random_direction(&seed);
        }
        for (int k = 0; k < 4; k++) {
            for (int i = 0; i < n; i++)
                moved[i] = sb_v3_madd(u[i], REAL(at[k] * step), d[i]);
            slope += weight[k] / step * sbi_loads_curved_energy(h.body, moved, 1);
            sbi_loads_force(h.body, moved, 1);
            for (int i = 0; i < n; i++)
                product[i] = sb_v3_madd(product[i], REAL(-weight[k] / step), h.body->follower[i]);
        }
        sbi_loads_force(h.body, u, 1);
        for (int i = 0; i < n; i++) {
            work += (double)sb_v3_dot(h.body->follower[i], d[i]);
            most += (double)sb_v3_norm(h.body->follower[i]);
        }
        CHECK_NEAR(sb_v3_norm(scene_sum(h.body->follower, n)), 0, 1e-12 * most);
        CHECK_NEAR(work, -slope, 1e-8 * most);
        sb_matrix_clear(&h.body->matrix);
        sbi_loads_add_tangent(h.body, u, SB_TANGENT_EXACT, 1, &h.body->matrix);
        sb_matrix_multiply(&h.body->matrix, &d[0].x, &moved[0].x, NULL);
        CHECK(sbi_cavities_multiply(h.body, d, 0, moved) >= 0);
        for (int i = 0; i < n; i++) {
            stiffness += (double)sb_v3_norm(moved[i]);
            error = fmax(error, (double)sb_v3_norm(sb_v3_sub(moved[i], product[i])));
        }
        if (!open)
            CHECK_NEAR(error, 0, 1e-8 * stiffness);
        free(u);
        hollow_free(&h);
    }
}

/* ---- laws at work ---- */

/* A gas pressed together by a piston, all of whose cylinder's nodes are moved: p V^k, and the force on the piston. */
static void test_piston(void)
{
    for (int k = 0; k < 2; k++) {
        const double ambient = 1e5, first = 2e4, exponent = k ? 1.4 : 1, shorter = 0.75;
        sb_cavity_def def = filled_with(SB_CAVITY_GAS, first);
        double expected = (ambient + first) * pow(shorter, -exponent) - ambient, force = 0;
        sb_body_def body_def;
        hollow h;
        sb_mesh none;
        memset(&none, 0, sizeof none);
        body_def = hollow_def(&none, 1e-3);
        def.ambient = REAL(ambient), def.exponent = REAL(exponent);
        if (!hollow_make(&h, SB_HEX8, 4, 0.5, 0, 1e9, &body_def, def))
            return;
        for (int i = 0; i < h.mesh.node_count; i++) {
            sb_vec3 to = sb_v3(REAL((shorter - 1) * (double)h.mesh.nodes[i].x), 0, 0);
            if (sb_body_node_in_use(h.body, i))
                CHECK_OK(sb_body_prescribe(h.body, &i, 1, SB_XYZ, &to, 1));
        }
        solve(h.body);
        CHECK_NEAR(volume_of(&h), shorter, scene_tolerance(1e-12, 100));
        CHECK_NEAR(pressure_of(&h), expected, scene_tolerance(1e-12, 100) * ambient);
        for (int i = 0; i < h.mesh.node_count; i++)
            if (h.mesh.nodes[i].x > REAL(0.4))
                force -= (double)sb_body_reactions(h.body)[i].x;
        CHECK_NEAR(force, expected, 1e-6 * expected);
        hollow_free(&h);
    }
}

/* A volume that is injected is there, pressed by what a pressure load of that size does, too; and it is gone again once
 * it was taken away. */
static void test_injection(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20};
    for (int k = 0; k < 4; k++) {
        sb_cavity_def def = filled_with(k % 2 ? SB_CAVITY_LIQUID : SB_CAVITY_VOLUME, 0);
        hollow h, other;
        double before, injected, left = 0;
        int id = 0;
        if (!hollow_make(&h, types[k], 4, 0.5, 0, 1e9, NULL, def))
            return;
        if (!hollow_make(&other, types[k], 4, 0.5, 0, 1e9, NULL, filled_with(SB_CAVITY_PRESSURE, 0)))
            return;
        hold_end(&h), hold_end(&other);
        before = volume_of(&h), injected = 0.2 * before;
        CHECK_OK(sb_body_inject_cavity(h.body, h.id, REAL(injected)));
        if (!solve(h.body))
            return;
        CHECK(pressure_of(&h) > 100);
        CHECK_NEAR(volume_of(&h), (before + injected) * (1 - (k % 2 ? pressure_of(&h) / 2.2e9 : 0)),
                   scene_tolerance(1e-10, 300) * before);
        CHECK_OK(sb_body_add_pressure(other.body, other.faces, other.count, other.corners, REAL(pressure_of(&h)), &id,
                                      NULL));
        if (solve(other.body))
            CHECK_NEAR(volume_of(&other), volume_of(&h), scene_tolerance(1e-8, 1e4) * before);
        CHECK_OK(sb_body_inject_cavity(h.body, h.id, REAL(-injected)));
        if (solve(h.body))
            CHECK_NEAR(volume_of(&h), before, scene_tolerance(1e-10, 300) * before);
        for (int i = 0; i < h.mesh.node_count; i++)
            left = fmax(left, (double)sb_v3_norm(sb_body_displacements(h.body)[i]));
        CHECK_NEAR(left, 0, scene_tolerance(1e-8, 1e4));
        hollow_free(&h), hollow_free(&other);
    }
}

/* In time a liquid is there after a few steps, iterated or not; and constraints make no difference to the law. */
static void test_injection_in_time(void)
{
    static const sb_integrator integrators[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
    for (int k = 0; k < 6; k++) {
        sb_mesh none;
        sb_body_def body_def;
        hollow h;
        double before, injected, bulk;
        memset(&none, 0, sizeof none);
        body_def = hollow_def(&none, 1e4);
        body_def.integrator = integrators[k / 2];
        body_def.max_newton = k % 2 ? 1 : 20;
        body_def.damping_stiffness = REAL(0.02);
        if (!hollow_make(&h, SB_TET4, 4, 0.5, 0, 1e9, &body_def, filled_with(SB_CAVITY_LIQUID, 0)))
            return;
        hold_end(&h);
        if (k % 3 == 1) {
            const sb_constraint_term terms[2] = {{h.mesh.node_count - 1, 0, 1}, {h.mesh.node_count - 2, 0, -1}};
            CHECK_OK(sb_body_add_constraint(h.body, terms, 2, 0, NULL, NULL));
        }
        before = volume_of(&h), injected = 0.1 * before, bulk = 2.2e9;
        for (int step = 0; step < 60; step++) {
            if (step < 20)
                CHECK_OK(sb_body_inject_cavity(h.body, h.id, REAL(injected / 20)));
            CHECK_OK(sb_body_step(h.body, REAL(0.01), NULL));
        }
        CHECK(pressure_of(&h) > 50);
        CHECK_NEAR(volume_of(&h), (before + injected) * (1 - pressure_of(&h) / bulk),
                   (integrators[k / 2] == SB_NEWMARK ? 2e-3 : 1e-5) * before);
        hollow_free(&h);
    }
}

/* ---- motion ---- */

/* Momenta of a free body stay when its contents swell it. */
static void test_momentum(void)
{
    static const sb_integrator integrators[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA, SB_CENTRAL_DIFFERENCE};
    for (int k = 0; k < 16; k++) {
        sb_mesh none;
        sb_body_def body_def;
        hollow h;
        sb_vec3 force, torque;
        sb_energy energy = {0, 0, 0};
        double push = 0; /* N s, of one side */
        memset(&none, 0, sizeof none);
        body_def = hollow_def(&none, 1e4);
        body_def.integrator = integrators[k / 4];
        body_def.max_newton = k % 2 ? 1 : 20;
        if (!hollow_make(&h, SB_TET4, 4, 0.5, 0, k % 4 < 2 ? 1e9 : 0.49, &body_def,
                         filled_with(k % 4 < 2 ? SB_CAVITY_GAS : SB_CAVITY_LIQUID, 1000)))
            return;
        if (k % 4 >= 2)
            CHECK_OK(sb_body_inject_cavity(h.body, h.id, REAL(0.05)));
        for (int step = 0; step < 10; step++) {
            CHECK_OK(sb_body_step(h.body, REAL(0.01), NULL));
            push += fabs(pressure_of(&h)) * 0.01;
        }
        CHECK_OK(sb_body_energy(h.body, &energy));
        CHECK(energy.kinetic > REAL(1e-6));
        CHECK_NEAR(sb_v3_norm(sb_body_momentum(h.body)), 0, scene_tolerance(1e-6, 1e5) * push);
        CHECK_OK(sb_body_load_force(h.body, h.id, sb_v3(0, 0, 0), &force, &torque));
        CHECK_NEAR(sb_v3_norm(force), 0, scene_tolerance(1e-10, 1e4) * 1e4);
        hollow_free(&h);
    }
}

/* A shell on gas that swings keeps its energy, Newmark and central differences. */
static void test_energy(void)
{
    for (int k = 0; k < 2; k++) {
        sb_mesh none;
        sb_body_def body_def;
        hollow h;
        double first, low = 1e30, high = -1e30, moved = 0;
        sb_energy energy = {0, 0, 0};
        memset(&none, 0, sizeof none);
        body_def = hollow_def(&none, 1e5);
        body_def.integrator = k ? SB_CENTRAL_DIFFERENCE : SB_NEWMARK;
        body_def.max_newton = 30;
        if (!hollow_make(&h, SB_TET4, 4, 0.5, 0, 1e9, &body_def, filled_with(SB_CAVITY_GAS, 2e4)))
            return;
        CHECK_OK(sb_body_energy(h.body, &energy));
        first = (double)(energy.springs + energy.kinetic + energy.elastic);
        for (int step = 0; step < 40; step++) {
            CHECK_OK(sb_body_step(h.body, REAL(0.004), NULL));
            CHECK_OK(sb_body_energy(h.body, &energy));
            low = fmin(low, (double)(energy.springs + energy.kinetic + energy.elastic));
            high = fmax(high, (double)(energy.springs + energy.kinetic + energy.elastic));
            moved = fmax(moved, (double)energy.elastic);
        }
        CHECK(moved > 0);
        CHECK_NEAR(high - first, 0, 0.05 * moved);
        CHECK_NEAR(low - first, 0, 0.05 * moved);
        hollow_free(&h);
    }
}

/* ---- undo, state, recording ---- */

static void breathe(const hollow *h, int steps)
{
    for (int step = 0; step < steps; step++) {
        if (step == 2)
            CHECK_OK(sb_body_inject_cavity(h->body, h->id, REAL(0.02)));
        CHECK_OK(sb_body_step(h->body, REAL(0.01), NULL));
    }
    CHECK_OK(sb_body_solve_static(h->body, NULL, NULL));
}

static void test_state(void)
{
    hollow h, other;
    size_t size;
    void *state, *ends[3];
    sb_recording *recording = NULL;
    sb_recording_report report;
    sb_error error;
    sb_cavity_def gas = filled_with(SB_CAVITY_GAS, 100);
    int gas_id = 0;
    if (!hollow_make(&h, SB_TET4, 4, 0.5, 0, 0.49, NULL, filled_with(SB_CAVITY_LIQUID, 100)) ||
        !hollow_make(&other, SB_TET4, 4, 0.5, 0, 1e9, NULL, filled_with(SB_CAVITY_PRESSURE, 5)))
        return;
    hold_end(&h), hold_end(&other);
    CHECK_OK(sb_recording_start(h.body, 1, NULL, &recording, &error));
    gas.faces = h.faces, gas.face_count = h.count, gas.corners = h.corners;
    CHECK_OK(sb_body_add_cavity(h.body, &gas, &gas_id, &error));
    breathe(&h, 4);
    size = sb_body_state_size(h.body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(h.body, state, size));
    breathe(&h, 6);
    ends[0] = malloc(size), ends[1] = malloc(size), ends[2] = malloc(size);
    CHECK_OK(sb_body_state_save(h.body, ends[0], size));
    if (!CHECK_OK(sb_body_state_load(other.body, state, size, &error)))
        printf("%s\n", error.message);
    other.id = h.id;
    breathe(&other, 6);
    CHECK_OK(sb_body_state_save(other.body, ends[1], size));
    CHECK(memcmp(ends[0], ends[1], size) == 0);
    check_bad_numbers();
    CHECK(sb_body_step(h.body, REAL(NAN), NULL) != SB_OK);
    CHECK_OK(sb_body_state_save(h.body, ends[2], size));
    CHECK(memcmp(ends[0], ends[2], size) == 0);
    CHECK_OK(sb_body_remove_load(h.body, gas_id));
    CHECK_OK(sb_body_step(h.body, REAL(0.01), NULL));
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, other.body, &report)))
        printf("step %d: %s\n", report.step, report.error.message);
    sb_recording_destroy(recording);
    free(state), free(ends[0]), free(ends[1]), free(ends[2]);
    hollow_free(&h), hollow_free(&other);
}

/* A static solve that fails leaves no trace: the next one ends as if it had not been, to the last bit. */
static void test_undo(void)
{
    hollow h, twin;
    sb_static_options options = exact_options();
    sb_cavity_def def = filled_with(SB_CAVITY_VOLUME, 0);
    if (!hollow_make(&h, SB_TET4, 4, 0.5, 0, 1e9, NULL, def) || !hollow_make(&twin, SB_TET4, 4, 0.5, 0, 1e9, NULL, def))
        return;
    hold_end(&h), hold_end(&twin);
    CHECK_OK(sb_body_inject_cavity(h.body, h.id, REAL(0.3)));
    CHECK_OK(sb_body_inject_cavity(twin.body, twin.id, REAL(0.3)));
    options.max_newton = 2;
    CHECK(sb_body_solve_static(h.body, &options, NULL) != SB_OK);
    CHECK_NEAR(volume_of(&h), 1, scene_tolerance(1e-13, 100));
    CHECK_NEAR(pressure_of(&h), 0, 0);
    solve(h.body), solve(twin.body);
    CHECK_NEAR(scene_distance(sb_body_displacements(h.body), sb_body_displacements(twin.body), h.mesh.node_count), 0,
               0);
    CHECK_NEAR(pressure_of(&h), pressure_of(&twin), 0);
    hollow_free(&h), hollow_free(&twin);
}

/* ---- changes of the mesh ---- */

/* Cells of the outside go: the cavity stays. One at its wall goes: a lid is in its place, or more wall is its own. */
static void test_change(void)
{
    hollow h;
    sb_body_def body_def;
    sb_mesh none;
    double before;
    sb_body_change *change;
    sb_error error;
    int cell = -1;
    memset(&none, 0, sizeof none);
    body_def = hollow_def(&none, 1e4);
    body_def.material = sb_material_corotated(REAL(1e4), REAL(0.3), 1000);
    body_def.slack = REAL(0.1);
    if (!hollow_make(&h, SB_TET4, 4, 0.5, 0, 1e9, &body_def, filled_with(SB_CAVITY_GAS, 300)))
        return;
    hold_end(&h);
    CHECK_OK(sb_body_solve_static(h.body, NULL, NULL));
    before = volume_of(&h);
    for (int e = 0; e < h.mesh.element_count && cell < 0; e++) {
        int far_off = 1;
        for (int a = 0; a < 4; a++)
            far_off &= largest(h.mesh.nodes[h.mesh.elements[4 * e + a]]) > 0.6 ||
                       (double)h.mesh.nodes[h.mesh.elements[4 * e + a]].x > 0.9;
        if (far_off && (double)h.mesh.nodes[h.mesh.elements[4 * e]].x > 0)
            cell = e;
    }
    for (int round = 0; round < 2; round++) {
        if (round == 1) /* a cell at the wall */
            for (int e = 0; e < h.mesh.element_count; e++) {
                int near_by = 0;
                for (int a = 0; a < 4; a++)
                    near_by += largest(h.mesh.nodes[h.mesh.elements[4 * e + a]]) < 0.51;
                if (near_by == 3 && e != cell && (double)h.mesh.nodes[h.mesh.elements[4 * e]].x > 0) {
                    cell = e;
                    break;
                }
            }
        if (cell < 0 || !CHECK_OK(sb_body_change_begin(h.body, &change, &error)))
            break;
        CHECK_OK(sb_body_change_remove_cell(change, cell, &error));
        if (!CHECK_OK(sb_body_change_commit(change, &error))) {
            printf("%s\n", error.message);
            sb_body_change_cancel(change);
        }
        CHECK_NEAR(volume_of(&h), before, (round ? 0.2 : 1e-12) * before);
        CHECK_OK(sb_body_solve_static(h.body, NULL, NULL));
        before = volume_of(&h);
    }
    hollow_free(&h);
}

/* ---- memory ---- */

static void test_memory(void)
{
    sb_mesh mesh = hollow_mesh(SB_TET4, 4, 0.5, 0);
    sb_body_def def = hollow_def(&mesh, 1e4);
    scene_memory memory = {0, 0, 0, 0};
    sb_result result = SB_ERROR_MEMORY;
    sb_cavity_def cavity = filled_with(SB_CAVITY_LIQUID, 0);
    int failures = 0, id = 0;
    sb_body *body;
    int *faces = inner_faces(&mesh, 0.5, 0, 0.49, &cavity.face_count, &cavity.corners);
    cavity.faces = faces;
    def.allocator = scene_allocator(&memory);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, -1, SB_XYZ);
    for (int n = 1; result != SB_OK && n < 100; n++) {
        int live = memory.live;
        uint64_t hash = sb_body_state_hash(body);
        memory.calls = 0;
        memory.fail_at = n;
        result = sb_body_add_cavity(body, &cavity, &id, NULL);
        memory.fail_at = 0;
        failures += result == SB_ERROR_MEMORY;
        if (result == SB_OK)
            break;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK(memory.live <= live + 1); /* a longer list of loads may stay */
        CHECK(sb_body_state_hash(body) == hash);
    }
    CHECK_OK(result);
    CHECK(failures > 2);
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    memory.calls = 0;
    CHECK_OK(sb_body_inject_cavity(body, id, REAL(0.01)));
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    CHECK_INT(memory.calls, 0);
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&mesh);
    free(faces);
}

/* ---- iterations ---- */

/* What the rank-one part costs: iterations of a step with a liquid over those of one with its pressure. */
static void test_iterations(void)
{
    int iterations[2] = {0, 0};
    for (int k = 0; k < 2; k++) {
        sb_mesh none;
        sb_body_def body_def;
        hollow h;
        sb_step_info info;
        memset(&none, 0, sizeof none);
        body_def = hollow_def(&none, 1e4);
        body_def.material = sb_material_corotated(REAL(1e4), REAL(0.45), 1000);
        body_def.max_newton = 1;
        body_def.tolerance = REAL(1e-4);
        if (!hollow_make(&h, SB_TET4, 12, 0.5, 1, 1e9, &body_def,
                         filled_with(k ? SB_CAVITY_LIQUID : SB_CAVITY_PRESSURE, k ? 0 : 300)))
            return;
        hold_end(&h);
        if (k)
            CHECK_OK(sb_body_inject_cavity(h.body, h.id, REAL(0.03 * volume_of(&h))));
        for (int step = 0; step < 20; step++) {
            CHECK_OK(sb_body_step(h.body, REAL(1.0 / 60), &info));
            iterations[k] += info.pcg_iterations;
        }
        hollow_free(&h);
    }
    printf("  cavity: 20 steps take %d iterations with a pressure, %d with a liquid\n", iterations[0], iterations[1]);
    CHECK(iterations[1] < 2.5 * iterations[0]);
}

/* ---- errors ---- */

static void test_errors(void)
{
    hollow h;
    sb_cavity_def def, bad;
    sb_real read = 5;
    sb_error error;
    uint64_t hash;
    int id = -7, outside[3] = {0, 1, 1 << 20};
    if (!hollow_make(&h, SB_TET4, 4, 0.5, 0, 1e9, NULL, filled_with(SB_CAVITY_GAS, 10)))
        return;
    def = filled_with(SB_CAVITY_LIQUID, 0);
    def.faces = h.faces, def.face_count = h.count, def.corners = 3;
    hash = sb_body_state_hash(h.body);
    CHECK_RESULT(sb_body_add_cavity(NULL, &def, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_cavity(h.body, NULL, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.faces = NULL;
    CHECK_RESULT(sb_body_add_cavity(h.body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.faces = outside, bad.face_count = 1;
    CHECK_RESULT(sb_body_add_cavity(h.body, &bad, &id, &error), SB_ERROR_INDEX);
    CHECK_INT(error.node, 1 << 20);
    bad = def, bad.bulk = 0;
    CHECK_RESULT(sb_body_add_cavity(h.body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.kind = SB_CAVITY_GAS, bad.ambient = -1;
    CHECK_RESULT(sb_body_add_cavity(h.body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.kind = (sb_cavity_kind)9;
    CHECK_RESULT(sb_body_add_cavity(h.body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.kind = SB_CAVITY_TABLE, bad.point_count = 2;
    CHECK_RESULT(sb_body_add_cavity(h.body, &bad, &id, &error), SB_ERROR_ARGUMENT); /* volumes do not rise */
    bad.table_volume[1] = 1, bad.table_pressure[1] = 2;
    CHECK_RESULT(sb_body_add_cavity(h.body, &bad, &id, &error), SB_ERROR_ARGUMENT); /* the pressure does */
    bad = def, bad.face_count = 1; /* the lid of one face has no volume below it */
    CHECK_RESULT(sb_body_add_cavity(h.body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    bad = def, bad.pressure = REAL(NAN);
    CHECK_RESULT(sb_body_add_cavity(h.body, &bad, &id, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(id, -7);
    CHECK(sb_body_state_hash(h.body) == hash);
    CHECK_RESULT(sb_body_inject_cavity(h.body, h.id + 1, 1), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_inject_cavity(h.body, h.id, -100), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_inject_cavity(h.body, h.id, REAL(NAN)), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_set_cavity_pressure(h.body, h.id, 1), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_cavity_volume(h.body, h.id + 1, &read), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_cavity_pressure(h.body, h.id + 1, &read), SB_ERROR_INDEX);
    CHECK(read == 5);
    CHECK(sb_body_state_hash(h.body) == hash);
    hollow_free(&h);
}

/* Derivatives know no cavity that resists growing. */
static void test_derivatives(void)
{
    for (int kind = SB_CAVITY_PRESSURE; kind <= SB_CAVITY_LIQUID; kind++) {
        sb_static_options options = exact_options();
        sb_parameter p;
        sb_real gradient = 0;
        hollow h;
        memset(&p, 0, sizeof p);
        p.kind = SB_PARAMETER_YOUNG;
        if (hollow_make(&h, SB_HEX8, 4, 0.5, 0, 1e9, NULL, filled_with((sb_cavity_kind)kind, 100))) {
            sb_vec3 *loss = (sb_vec3 *)calloc((size_t)h.mesh.node_count, sizeof *loss);
            hold_end(&h);
            loss[0].x = 1;
            (void)sb_body_solve_static(h.body, &options, NULL);
            CHECK_RESULT(sb_body_gradient(h.body, loss, NULL, &p, 1, &gradient, NULL, NULL),
                         kind == SB_CAVITY_PRESSURE ? SB_OK : SB_ERROR_UNSUPPORTED);
            free(loss);
        }
        hollow_free(&h);
    }
}

CHECK_SUITE(cavity, {"volume", test_volume}, {"derivatives", test_derivatives},
            {"one cavity against its energy", test_law}, {"gas piston", test_piston}, {"injection", test_injection},
            {"injection in time", test_injection_in_time}, {"momentum", test_momentum}, {"energy", test_energy},
            {"state and recording", test_state}, {"undo", test_undo}, {"change", test_change}, {"memory", test_memory},
            {"iterations", test_iterations}, {"errors", test_errors});
