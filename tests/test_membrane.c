/* Membranes: what one does is compared with its energy by differences, at random, and with closed forms; balance, undo,
 * states, recordings and changes of the mesh with what holds for every load. */
#define SB_SPLIT_BUILD
#include "../src/softbody/body/body_private.h"
#include "../src/softbody/body/load.h"
#include "../src/softbody/body/membrane.h"
#include "../src/softbody/body/membrane_law.h"
#include "../src/softbody/body/record.h"
#include "../src/softbody/body/state.h"

#include "check.h"
#include "random_case.h"

static sb_membrane_def sheet_def(const sb_mesh *mesh, double thickness, double shear, int wrinkles)
{
    sb_membrane_def def = sb_default_membrane_def();
    def.corners = mesh->element_type == SB_TET4 || mesh->element_type == SB_TET10 ? 3 : 4;
    def.thickness = REAL(thickness), def.shear = REAL(shear), def.wrinkles = wrinkles;
    return def;
}

static sb_vec3 random_vector(unsigned long long *seed, double size)
{
    return sb_v3(REAL(check_random_in(seed, -size, size)), REAL(check_random_in(seed, -size, size)),
                 REAL(check_random_in(seed, -size, size)));
}

static sb_body *plain_body(const sb_mesh *mesh)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = sb_material_corotated(REAL(1e4), REAL(0.3), 1000);
    return scene_body(&def);
}

/* Force = - slope of the energy and stiffness = - slope of the force along random d, to 1e-8 of their size by
 * five-point differences; the product is that of the matrix, which is positive semidefinite unless exact. */
static void test_law(void)
{
    static const sb_element_type types[4] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20};
    static const double at[4] = {-2, -1, 1, 2}, weight[4] = {1.0 / 12, -8.0 / 12, 8.0 / 12, -1.0 / 12};
    unsigned long long seed = 61;
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("differences need double");
        return;
    }
    for (int round = 0; round < check_rounds(96); round++) {
        int wrinkles = round / 12 % 2; /* at kinks of the relaxed law differences see both sides: small ones then */
        double size = pow(10, 3 * (round % 3) - 3), step = (wrinkles ? 1e-7 : 3e-5) * size;
        double stretch = round % 2 ? 0.02 : 0.2, tolerance = wrinkles ? 1e-6 : 1e-8;
        sb_mesh mesh = scene_box(types[round % 4], 2, 2, 1, sb_v3(REAL(size), REAL(size), REAL(size / 2)), 0.2);
        sb_body *body = plain_body(&mesh);
        int n = mesh.node_count, id = 0;
        sb_vec3 *u = (sb_vec3 *)calloc(4 * (size_t)n, sizeof *u), *d = u + n, *moved = d + n, *product = moved + n;
        sb_membrane_def def = sheet_def(&mesh, 0.01 * size, random_scale(&seed, 1, 1e3), wrinkles);
        double slope = 0, work = 0, largest = 0, stiffness = 0, positive = 0, error = 0;
        def.prestretch = REAL(check_random_in(&seed, 0.95, 1.2));
        if (!CHECK(u) || !CHECK_OK(sb_body_add_membrane(body, &def, &id, NULL)))
            continue;
        for (int i = 0; i < n; i++) {
            u[i] = random_vector(&seed, stretch * size / 4);
            d[i] = random_vector(&seed, 1);
        }
        for (int k = 0; k < 4; k++) {
            for (int i = 0; i < n; i++)
                moved[i] = sb_v3_madd(u[i], REAL(at[k] * step), d[i]);
            slope += weight[k] / step * sbi_loads_curved_energy(body, moved, 1);
            sbi_loads_force(body, moved, 1);
            for (int i = 0; i < n; i++)
                product[i] = sb_v3_madd(product[i], REAL(-weight[k] / step), body->follower[i]);
        }
        sbi_loads_force(body, u, 1);
        for (int i = 0; i < n; i++) {
            work += (double)sb_v3_dot(body->follower[i], d[i]);
            largest += (double)sb_v3_norm(body->follower[i]);
        }
        CHECK_NEAR(sb_v3_norm(scene_sum(body->follower, n)), 0, 1e-13 * largest);
        CHECK_NEAR(work, -slope, tolerance * largest);
        sb_matrix_clear(&body->matrix);
        sbi_loads_add_tangent(body, u, SB_TANGENT_EXACT, 1, &body->matrix);
        sb_matrix_multiply(&body->matrix, &d[0].x, &moved[0].x, NULL);
        for (int i = 0; i < n; i++) {
            stiffness += (double)sb_v3_norm(moved[i]);
            error = fmax(error, (double)sb_v3_norm(sb_v3_sub(moved[i], product[i])));
        }
        CHECK_NEAR(error, 0, tolerance * stiffness);
        sb_matrix_clear(&body->matrix);
        sbi_loads_add_tangent(body, u, SB_TANGENT_SPD, 1, &body->matrix);
        sb_matrix_multiply(&body->matrix, &d[0].x, &moved[0].x, NULL);
        for (int i = 0; i < n; i++)
            positive += (double)sb_v3_dot(moved[i], d[i]);
        CHECK(positive > 0);
        memcpy(body->displacement, u, (size_t)n * sizeof *u);
        for (int i = 0; i < n; i++)
            largest = fmax(largest, (double)sb_v3_norm(moved[i]));
        sbi_loads_subtract_product(body, d, 1, moved); /* K d - K d */
        for (int i = 0; i < n; i++)
            CHECK_NEAR(sb_v3_norm(moved[i]), 0, 1e-11 * largest);
        free(u);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* ---- closed forms ---- */

/* Moves a body by the homogeneous x -> f x. */
static void deform(sb_body *body, const sb_mesh *mesh, const double f[9])
{
    sb_vec3 *u = (sb_vec3 *)malloc((size_t)mesh->node_count * sizeof *u);
    for (int i = 0; i < mesh->node_count && CHECK(u); i++) {
        const double x[3] = {(double)mesh->nodes[i].x, (double)mesh->nodes[i].y, (double)mesh->nodes[i].z};
        double y[3];
        for (int k = 0; k < 3; k++)
            y[k] = f[3 * k] * x[0] + f[3 * k + 1] * x[1] + f[3 * k + 2] * x[2] - x[k];
        u[i] = sb_v3(REAL(y[0]), REAL(y[1]), REAL(y[2]));
    }
    CHECK_OK(sb_body_set_displacements(body, u));
    free(u);
}

/* The faces of a box whose nodes lie on z = 0, as corners[][3]; returns how many. */
static int bottom_faces(const sb_mesh *mesh, int *corners, int most)
{
    sb_boundary boundary;
    int count = 0;
    if (!CHECK_OK(sb_mesh_boundary(mesh, 0, NULL, &boundary, NULL)))
        return 0;
    for (int f = 0; f < boundary.surface.element_count; f++) {
        const int *face = boundary.surface.elements + f * sb_element_node_count(boundary.surface.element_type);
        if (fabs((double)(mesh->nodes[face[0]].z + mesh->nodes[face[1]].z + mesh->nodes[face[2]].z)) < 1e-9 &&
            CHECK(count < most))
            memcpy(corners + 3 * count++, face, 3 * sizeof(int));
    }
    sb_boundary_free(&boundary);
    return count;
}

enum { MOST_FACES = 256 };

/* A square slab 1 x 1 m with a sheet below, of mu H = 2 N/m; its faces. */
static sb_body *make_square(sb_element_type type, int wrinkles, sb_real prestretch, sb_mesh *mesh, int *id, int *count)
{
    static int corners[3 * MOST_FACES];
    sb_membrane_def def;
    sb_body *body;
    *mesh = scene_box(type, 3, 3, 1, sb_v3(1, 1, REAL(0.1)), 0);
    for (int i = 0; i < mesh->node_count; i++) /* uneven */
        mesh->nodes[i].x += REAL(0.2) * mesh->nodes[i].x * (1 - mesh->nodes[i].x);
    body = plain_body(mesh);
    def = sheet_def(mesh, 0.002, 1000, wrinkles);
    def.faces = corners;
    *count = def.face_count = bottom_faces(mesh, corners, MOST_FACES);
    def.prestretch = prestretch;
    CHECK_OK(sb_body_add_membrane(body, &def, id, NULL));
    return body;
}

/* Stretches and tensions: pulled along one axis with the sides free to fold, along both, less than its prestretch gave,
 * sheared; taut ones have T_1 = mu H a / b (1 - a^-4 b^-2) and the energy of the sheet. */
static void test_homogeneous(void)
{
    for (int k = 0; k < 2; k++) {
        const double scale = 2, tolerance = scene_tolerance(1e-12, 200);
        sb_membrane_state states[MOST_FACES];
        sb_mesh mesh;
        int id = 0, count = 0, faces = 0;
        sb_energy energy = {0, 0, 0};
        sb_body *body = make_square(k ? SB_TET10 : SB_TET4, 1, 1, &mesh, &id, &count);
        const double a = 1.3, b = 1.1, gamma = 0.4;
        const double biaxial[9] = {a, 0, 0, 0, b, 0, 0, 0, 1}, uniaxial[9] = {0.7, 0, 0, 0, a, 0, 0, 0, 1};
        const double sheared[9] = {1, gamma, 0, 0, 1, 0, 0, 0, 1}, pressed[9] = {0.9, 0, 0, 0, 0.8, 0, 0, 0, 1};
        CHECK_OK(sb_body_membrane_faces(body, id, &faces, NULL));
        CHECK_INT(faces, count);
        deform(body, &mesh, biaxial);
        CHECK_OK(sb_body_membrane_states(body, id, states));
        for (int f = 0; f < count; f++) {
            CHECK_NEAR(states[f].stretch[0], a, tolerance);
            CHECK_NEAR(states[f].stretch[1], b, tolerance);
            CHECK_NEAR(states[f].tension[0], scale * a / b * (1 - pow(a, -4) * pow(b, -2)), tolerance);
            CHECK_NEAR(states[f].tension[1], scale * b / a * (1 - pow(b, -4) * pow(a, -2)), tolerance);
            CHECK_NEAR(fabs((double)states[f].direction.x), 1, tolerance);
            CHECK(states[f].form == SB_MEMBRANE_TAUT);
        }
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_NEAR(energy.springs, scale / 2 * (a * a + b * b + 1 / (a * a * b * b) - 3), tolerance);
        deform(body, &mesh, uniaxial);
        CHECK_OK(sb_body_membrane_states(body, id, states));
        for (int f = 0; f < count; f++) {
            CHECK(states[f].form == SB_MEMBRANE_WRINKLED);
            CHECK_NEAR(states[f].tension[0], scale * (pow(a, 1.5) - pow(a, -1.5)), tolerance);
            CHECK_NEAR(states[f].tension[1], 0, tolerance);
            CHECK_NEAR(fabs((double)states[f].direction.y), 1, tolerance);
        }
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_NEAR(energy.springs, scale / 2 * (a * a + 2 / a - 3), tolerance);
        deform(body, &mesh, sheared); /* one diagonal pulls: a = gamma/2 + sqrt(1 + gamma^2/4), along (a, 1) */
        CHECK_OK(sb_body_membrane_states(body, id, states));
        for (int f = 0; f < count; f++) {
            double along = gamma / 2 + sqrt(1 + gamma * gamma / 4);
            CHECK(states[f].form == SB_MEMBRANE_WRINKLED);
            CHECK_NEAR(states[f].stretch[0], along, tolerance);
            CHECK_NEAR(fabs((double)states[f].direction.x), along / sqrt(1 + along * along), tolerance);
            CHECK_NEAR(states[f].tension[0], scale * (pow(along, 1.5) - pow(along, -1.5)), tolerance);
            CHECK_NEAR(states[f].tension[1], 0, tolerance);
        }
        deform(body, &mesh, pressed);
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK(energy.springs == 0);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        body = make_square(k ? SB_TET10 : SB_TET4, 0, REAL(1.2), &mesh, &id, &count);
        deform(body, &mesh, pressed); /* 1.08 and 0.96 of the sheet's own size, which is 1/1.44 m^2 */
        CHECK_OK(sb_body_membrane_states(body, id, states));
        CHECK_NEAR(states[0].stretch[0], 1.08, tolerance);
        CHECK_NEAR(states[0].stretch[1], 0.96, tolerance);
        CHECK_NEAR(states[0].tension[1], scale * 0.96 / 1.08 * (1 - pow(0.96, -4) * pow(1.08, -2)), tolerance);
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_NEAR(energy.springs, scale / 2 / 1.44 * (1.08 * 1.08 + 0.96 * 0.96 + pow(1.08 * 0.96, -2) - 3),
                   tolerance);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* A soft bar in four sheets, pulled: force of the bar plus mu H (a - a^-2) for each metre of sheet where it is free to
 * narrow; the sheets fold when they are pressed. Small strain of the bar is linear, so the sum has a closed form only
 * where the bar's part is small: 1e-6 of it here. */
static void test_strip(void)
{
    const double a = 1.25, shear = 1e4, thickness = 0.001;
    for (int wrinkles = 0; wrinkles < 2; wrinkles++)
        for (int k = 0; k < 2; k++) {
            sb_mesh mesh = scene_box(k ? SB_TET10 : SB_TET4, 4, 2, 1, sb_v3(REAL(0.2), REAL(0.1), REAL(0.02)), 0.1);
            sb_body_def def = sb_default_body_def();
            sb_static_options options = sb_default_static_options();
            sb_membrane_def sheet = sheet_def(&mesh, thickness, shear, wrinkles);
            sb_step_info info;
            int corners[3 * MOST_FACES], id = 0;
            double force = 0;
            sb_body *body;
            def.mesh = &mesh;
            def.material = sb_material_neo_hookean(REAL(1e-6 * shear), 0, 1000);
            body = scene_body(&def);
            sheet.faces = corners;
            sheet.face_count = bottom_faces(&mesh, corners, MOST_FACES);
            CHECK_OK(sb_body_add_membrane(body, &sheet, &id, NULL));
            scene_fix_plane(body, &mesh, 0, 0, SB_X);
            scene_fix_plane(body, &mesh, 2, 0, SB_Z);
            scene_fix_plane(body, &mesh, 1, 0, SB_Y);
            for (int i = 0; i < mesh.node_count; i++)
                if (fabs((double)mesh.nodes[i].x - 0.2) < 1e-6) {
                    sb_vec3 to = sb_v3(REAL(0.2 * (a - 1)), 0, 0);
                    CHECK_OK(sb_body_prescribe(body, &i, 1, SB_X, &to, 1));
                }
            options.max_newton = 200;
            options.load_steps = 4;
            options.tolerance = REAL(scene_tolerance(1e-9, 64));
            if (!CHECK_OK(sb_body_solve_static(body, &options, &info)))
                printf("%s\n", info.error.message);
            for (int i = 0; i < mesh.node_count; i++)
                if (fabs((double)mesh.nodes[i].x - 0.2) < 1e-6)
                    force += (double)sb_body_reactions(body)[i].x;
            CHECK_NEAR(force, shear * thickness * 0.1 * (a - 1 / (a * a)), 1e-3 * force);
            sb_body_destroy(body);
            sb_mesh_free(&mesh);
        }
}

/* ---- motion ---- */

static sb_body *skinned_body(const sb_mesh *mesh, sb_integrator integrator, int max_newton, double prestretch, int *id)
{
    sb_body_def def = sb_default_body_def();
    sb_membrane_def sheet = sheet_def(mesh, 0.002, 1e5, 1);
    sb_body *body;
    def.mesh = mesh;
    def.material = sb_material_corotated(REAL(2e4), REAL(0.3), 1000);
    def.integrator = integrator;
    def.max_newton = max_newton;
    def.tolerance = REAL(scene_tolerance(1e-10, 16));
    body = scene_body(&def);
    sheet.prestretch = REAL(prestretch);
    CHECK_OK(sb_body_add_membrane(body, &sheet, id, NULL));
    return body;
}

/* Momenta of a free body stay when its skin pulls itself together, and what moves comes from the skin's energy. */
static void test_momentum(void)
{
    static const sb_integrator integrators[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA, SB_CENTRAL_DIFFERENCE};
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(1, REAL(0.6), REAL(0.5)), 0.2);
    for (int k = 0; k < 8; k++) {
        int id = 0;
        sb_body *body = skinned_body(&mesh, integrators[k / 2], k % 2 ? 1 : 20, 1.15, &id);
        sb_energy energy = {0, 0, 0};
        sb_vec3 force, torque;
        for (int step = 0; step < 20; step++)
            CHECK_OK(sb_body_step(body, REAL(0.005), NULL));
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK(energy.kinetic > REAL(1e-3));
        CHECK_NEAR(sb_v3_norm(sb_body_momentum(body)), 0,
                   scene_tolerance(1e-7, 1e5) * sqrt(2 * (double)energy.kinetic * (double)sb_body_mass(body)));
        CHECK_OK(sb_body_load_force(body, id, sb_v3(0, 0, 0), &force, &torque));
        CHECK_NEAR(sb_v3_norm(force), 0, scene_tolerance(1e-10, 1e4) * 100);
        if (k % 2 == 0)
            CHECK_NEAR(sb_v3_norm(torque), 0, scene_tolerance(1e-10, 1e4) * 100);
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
}

/* Newmark, iterated, over many swings of a free body in a skin that folds and pulls: energy stays. */
static void test_energy(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 3, 2, 2, sb_v3(1, REAL(0.6), REAL(0.5)), 0);
    int id = 0;
    sb_body *body = skinned_body(&mesh, SB_NEWMARK, 30, 1.1, &id);
    double first, low = 1e30, high = 0;
    sb_energy energy;
    CHECK_OK(sb_body_energy(body, &energy));
    first = (double)(energy.springs + energy.kinetic + energy.elastic);
    CHECK(energy.springs > 0);
    for (int step = 0; step < 100; step++) {
        CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
        CHECK_OK(sb_body_energy(body, &energy));
        low = fmin(low, (double)(energy.springs + energy.kinetic + energy.elastic));
        high = fmax(high, (double)(energy.springs + energy.kinetic + energy.elastic));
    }
    CHECK(high < 1.02 * first && low > 0.98 * first);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Central differences count a stiff skin while it is slack: a body that is let go in a skin which folds and then
 * catches it gains no energy. */
static void test_explicit(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(1, REAL(0.6), REAL(0.5)), 0.2);
    int id = 0;
    sb_body *body = skinned_body(&mesh, SB_CENTRAL_DIFFERENCE, 1, 1, &id);
    sb_energy energy;
    const double pressed[9] = {0.85, 0, 0, 0, 0.9, 0, 0, 0, 0.9};
    double first, high = 0;
    CHECK_OK(sb_body_set_membrane(body, id, REAL(0.01), REAL(1e6), 1));
    deform(body, &mesh, pressed);
    CHECK_OK(sb_body_energy(body, &energy));
    CHECK(energy.springs == 0);
    first = (double)energy.elastic;
    for (int step = 0; step < 40; step++) {
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK_OK(sb_body_energy(body, &energy));
        high = fmax(high, (double)(energy.springs + energy.kinetic + energy.elastic));
    }
    CHECK(high < 1.04 * first);
    {
        sb_membrane_def firm = sheet_def(&mesh, 0.002, 1e5, 0); /* would gain energy */
        CHECK_RESULT(sb_body_add_membrane(body, &firm, &id, NULL), SB_ERROR_UNSUPPORTED);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- undo, state, recording ---- */

static void swing(sb_body *body, int id, int steps)
{
    for (int step = 0; step < steps; step++) {
        if (step == 3)
            CHECK_OK(sb_body_set_membrane(body, id, REAL(0.003), REAL(1e5), REAL(1.05)));
        CHECK_OK(sb_body_step(body, REAL(0.005), NULL));
    }
}

static void test_state(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 3, 2, 2, sb_v3(1, REAL(0.6), REAL(0.5)), 0);
    int id = 0, other_id = 0;
    sb_body *body = plain_body(&mesh), *other = plain_body(&mesh);
    sb_membrane_def def = sheet_def(&mesh, 0.002, 1e5, 1);
    size_t size;
    void *state, *ends[3];
    sb_recording *recording = NULL;
    sb_error error;
    sb_recording_report report;
    def.prestretch = REAL(1.1);
    CHECK_OK(sb_recording_start(body, 1, NULL, &recording, &error));
    CHECK_OK(sb_body_add_membrane(body, &def, &id, &error));
    swing(body, id, 4);
    size = sb_body_state_size(body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(body, state, size));
    swing(body, id, 6);
    ends[0] = malloc(size), ends[1] = malloc(size), ends[2] = malloc(size);
    CHECK_OK(sb_body_state_save(body, ends[0], size));
    if (!CHECK_OK(sb_body_state_load(other, state, size, &error)))
        printf("%s\n", error.message);
    swing(other, id, 6);
    CHECK_OK(sb_body_state_save(other, ends[1], size));
    CHECK(memcmp(ends[0], ends[1], size) == 0);
    check_bad_numbers();
    CHECK(sb_body_step(body, REAL(NAN), NULL) != SB_OK);
    CHECK_OK(sb_body_state_save(body, ends[2], size));
    CHECK(memcmp(ends[0], ends[2], size) == 0);
    CHECK_OK(sb_body_remove_load(body, id));
    CHECK_OK(sb_body_step(body, REAL(0.005), NULL));
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, other, &report)))
        printf("step %d: %s\n", report.step, report.error.message);
    CHECK_INT(report.steps, 11);
    CHECK_RESULT(sb_body_membrane_faces(other, other_id + 1, NULL, NULL), SB_ERROR_INDEX);
    sb_recording_destroy(recording);
    free(state), free(ends[0]), free(ends[1]), free(ends[2]);
    sb_body_destroy(body);
    sb_body_destroy(other);
    sb_mesh_free(&mesh);
}

/* A membrane that is taken away lets its force fade in the next static solve, which ends where a body without it is. */
static void test_removal(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(1, REAL(0.6), REAL(0.5)), 0.2);
    int id = 0;
    sb_body *body = skinned_body(&mesh, SB_NEWMARK, 20, 1.1, &id);
    sb_static_options options = sb_default_static_options();
    double moved = 0, left = 0;
    options.tolerance = REAL(scene_tolerance(1e-9, 64));
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int i = 0; i < mesh.node_count; i++)
        moved = fmax(moved, (double)sb_v3_norm(sb_body_displacements(body)[i]));
    CHECK(moved > 1e-3);
    CHECK_OK(sb_body_remove_load(body, id));
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int i = 0; i < mesh.node_count; i++)
        left = fmax(left, (double)sb_v3_norm(sb_body_displacements(body)[i]));
    CHECK_NEAR(left, 0, scene_tolerance(1e-7, 1e4) * moved);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- changes of the mesh ---- */

/* Cells go: the membrane keeps to the faces that stay. */
static void test_change(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 5, 4, 4, sb_v3(1, 1, 1), 0.2);
    sb_body *body = scene_changing_body(&mesh, sb_material_corotated(REAL(1e4), REAL(0.3), 1000));
    sb_membrane_def def = sheet_def(&mesh, 0.001, 1e5, 1);
    sb_energy energy[2];
    int id = 0, before = 0, after = 0;
    def.prestretch = REAL(1.05);
    CHECK_OK(sb_body_add_membrane(body, &def, &id, NULL));
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    CHECK_OK(sb_body_membrane_faces(body, id, &before, NULL));
    CHECK_OK(sb_body_energy(body, energy));
    scene_remove_cells(body);
    CHECK_OK(sb_body_membrane_faces(body, id, &after, NULL));
    CHECK_OK(sb_body_energy(body, energy + 1));
    CHECK(after > 0 && after <= before);
    CHECK_NEAR(energy[1].springs, energy[0].springs * REAL(after) / REAL(before), 0.1 * (double)energy[0].springs);
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- memory ---- */

/* Each allocation of an adder fails in turn: nothing leaks or changes; steps and solves allocate nothing. */
static void test_memory(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(1, REAL(0.6), REAL(0.5)), 0);
    sb_body_def def = sb_default_body_def();
    sb_membrane_def sheet = sheet_def(&mesh, 0.002, 1e5, 1);
    scene_memory memory = {0, 0, 0, 0};
    sb_result result = SB_ERROR_MEMORY;
    int id = 0, failures = 0;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    def.allocator = scene_allocator(&memory);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int n = 1; result != SB_OK && n < 100; n++) {
        int live = memory.live;
        uint64_t hash = sb_body_state_hash(body);
        memory.calls = 0;
        memory.fail_at = n;
        result = sb_body_add_membrane(body, &sheet, &id, NULL);
        memory.fail_at = 0;
        failures += result == SB_ERROR_MEMORY;
        if (result != SB_OK) {
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK(memory.live <= live + 1); /* a longer list of loads may stay */
            CHECK(sb_body_state_hash(body) == hash);
        }
    }
    CHECK_OK(result);
    CHECK(failures == 3); /* the faces, the load, the list of loads */
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    memory.calls = 0;
    CHECK_OK(sb_body_set_membrane(body, id, REAL(0.001), REAL(1e5), REAL(1.1)));
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    CHECK_INT(memory.calls, 0);
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&mesh);
}

/* ---- random bodies ---- */

/* In any body in any skin what supports and loads do sums to 0; and Newton's iterations are few. */
static void test_random(void)
{
    int solved = 0, made = 0;
    for (int number = 1; number <= check_rounds(40); number++) {
        unsigned long long seed = 577ull * (unsigned long long)number;
        random_case c;
        sb_body *body;
        sb_body_def def = sb_default_body_def();
        sb_static_options options = sb_default_static_options();
        sb_membrane_def sheet;
        sb_vec3 sum, low, high;
        double size = 0;
        if (!random_case_make(&c, (unsigned long long)number, 0))
            continue;
        sb_mesh_bounds(&c.mesh, &low, &high);
        def.mesh = &c.mesh;
        def.material = c.material;
        def.gravity = c.gravity;
        def.integration = c.integration;
        body = scene_body(&def);
        if (!body)
            continue;
        CHECK_OK(sb_body_fix_nodes(body, c.held, c.held_count, SB_XYZ));
        sheet = sheet_def(&c.mesh, 0.01 * (double)sb_v3_norm(sb_v3_sub(high, low)),
                          (double)sbi_body_young(body) * random_scale(&seed, 0.1, 100), random_below(&seed, 2));
        sheet.prestretch = REAL(check_random_in(&seed, 0.98, 1.03));
        made += CHECK_OK(sb_body_add_membrane(body, &sheet, NULL, NULL));
        options.tolerance = REAL(scene_tolerance(1e-9, 64));
        options.max_newton = 60;
        if (sb_body_solve_static(body, &options, NULL) == SB_OK) {
            solved++;
            sum = sb_v3_add(scene_sum(sb_body_reactions(body), c.mesh.node_count),
                            scene_sum(sb_body_external_forces(body), c.mesh.node_count));
            for (int i = 0; i < c.mesh.node_count; i++)
                size += (double)sb_v3_norm(sb_body_reactions(body)[i]) +
                        (double)sb_v3_norm(sb_body_external_forces(body)[i]);
            CHECK_NEAR(sb_v3_norm(sum), 0, scene_tolerance(1e-8, 3e4) * size);
        }
        sb_body_destroy(body);
        random_case_free(&c);
    }
    CHECK(solved >= made * 9 / 10);
}

/* ---- errors ---- */

static void test_errors(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0);
    sb_body *body = plain_body(&mesh);
    sb_boundary boundary;
    sb_membrane_def def = sheet_def(&mesh, 0.001, 10, 1), bad;
    int id = -7, face[3], outside[3] = {0, 1, 1 << 20}, apart[3] = {0, 1, 26};
    uint64_t hash = sb_body_state_hash(body);
    sb_error error;
    sb_membrane_state state;
    if (!CHECK_OK(sb_mesh_boundary(&mesh, 0, NULL, &boundary, NULL)))
        return;
    memcpy(face, boundary.surface.elements, sizeof face);
    sb_boundary_free(&boundary);
    CHECK_RESULT(sb_body_add_membrane(NULL, &def, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_membrane(body, NULL, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.corners = 4;
    CHECK_RESULT(sb_body_add_membrane(body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.faces = face, bad.face_count = 0;
    CHECK_RESULT(sb_body_add_membrane(body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.faces = outside, bad.face_count = 1;
    CHECK_RESULT(sb_body_add_membrane(body, &bad, &id, &error), SB_ERROR_INDEX);
    CHECK_INT(error.node, 1 << 20);
    bad = def, bad.faces = apart, bad.face_count = 1;
    CHECK_RESULT(sb_body_add_membrane(body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(error.node, 0);
    bad = def, bad.thickness = 0;
    CHECK_RESULT(sb_body_add_membrane(body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.shear = -1;
    CHECK_RESULT(sb_body_add_membrane(body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.prestretch = 0;
    CHECK_RESULT(sb_body_add_membrane(body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    bad = def, bad.shear = REAL(NAN);
    CHECK_RESULT(sb_body_add_membrane(body, &bad, &id, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(id, -7);
    CHECK(sb_body_state_hash(body) == hash);
    CHECK_OK(sb_body_add_membrane(body, &def, &id, &error));
    CHECK_RESULT(sb_body_set_membrane(body, id + 1, 1, 1, 1), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_set_membrane(body, id, -1, 1, 1), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_set_membrane(body, id, 1, REAL(INFINITY), 1), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_membrane_states(body, id + 1, &state), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_set_pressure(body, id, 1), SB_ERROR_INDEX);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(membrane, {"one membrane against its energy", test_law}, {"homogeneous strains", test_homogeneous},
            {"a strip that is pulled", test_strip}, {"momentum", test_momentum}, {"energy", test_energy},
            {"explicit", test_explicit}, {"state and undo", test_state}, {"removal", test_removal},
            {"change", test_change}, {"memory", test_memory}, {"random bodies", test_random}, {"errors", test_errors});
