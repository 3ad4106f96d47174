/* particles_body: bodies of particles: patch test, rotation, momentum, zero motions, beams, sag, cuts, states. What
 * takes long runs with CHECK_SLOW=1. */
#include "softbody.h"

#include "check.h"
#include "particle_scene.h"

static double largest(const sb_vec3 *a, int count)
{
    double most = 0;
    for (int i = 0; i < count; i++)
        most = fmax(most, (double)sb_v3_norm(a[i]));
    return most;
}

/* u = A x of a small matrix that no symmetry favours. */
static sb_vec3 sheared(sb_vec3 x, double by)
{
    return sb_v3(REAL(by) * (REAL(0.7) * x.x - REAL(0.4) * x.y + REAL(0.2) * x.z),
                 REAL(by) * (REAL(0.3) * x.x + REAL(0.5) * x.y - REAL(0.6) * x.z),
                 REAL(by) * (REAL(-0.1) * x.x + REAL(0.9) * x.y - REAL(0.8) * x.z));
}

/* Particles on and near the surface follow a linear field; those inside find it, in a cloud without order, at any size.
 * Gradients that were left as they are find something else. */
static void test_patch(void)
{
    for (int round = 0; round < 8; round++) {
        unsigned long long seed = 60 + (unsigned long long)round;
        sb_particles_def def = sb_default_particles_def();
        double size = round % 4 == 0 ? 1e-3 : round % 4 == 1 ? 1e3 : 1, worst = 0;
        particle_cloud cloud = random_cloud(&seed, 7, 7, 8, size, 0.2);
        sb_static_options options = sb_default_static_options();
        int inner = 0, corrected = round < 6;
        sb_particles p;
        sb_body *body;
        def.method = round % 2 ? SB_PARTICLES_GRID : SB_PARTICLES_MLS;
        def.points_per_cell = round % 4 == 1 ? 1 : 8;
        def.consistent = corrected;
        cloud_use(&cloud, &def);
        p = make_particles(&def);
        sb_body_def body_def = cloud_body_def(&p, sb_material_linear(1000, REAL(0.3), 1000));
        body = scene_body(&body_def);
        for (int i = 0; i < p.mesh.node_count; i++) {
            sb_vec3 u = sheared(p.mesh.nodes[i], 0.01);
            inner += p.inner[i];
            if (!p.inner[i])
                CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
        }
        CHECK(inner >= 20);
        if (def.method == SB_PARTICLES_MLS || def.points_per_cell == 1) /* or they may do as they like */
            CHECK_OK(sb_particles_stabilise(&p, body, REAL(0.02), NULL, NULL));
        options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-4 : 1e-12);
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
        for (int i = 0; i < p.mesh.node_count; i++)
            worst = fmax(worst,
                         (double)sb_v3_norm(sb_v3_sub(sb_body_displacements(body)[i], sheared(p.mesh.nodes[i], 0.01))) /
                             (0.01 * size));
        if (corrected)
            CHECK_NEAR(worst, 0, SB_REAL_IS_FLOAT ? 1e-3 : 1e-9);
        else
            CHECK(worst > 1e-4);
        sb_body_destroy(body);
        sb_particles_free(&p);
        cloud_free(&cloud);
    }
}

/* A quarter turn costs nothing and pulls at nothing. */
static void test_rotation(void)
{
    static const int models = 3;
    for (int method = 1; method <= 3; method++)
        for (int model = 0; model < models; model++) {
            unsigned long long seed = 9;
            sb_particles_def def = sb_default_particles_def();
            particle_cloud cloud = random_cloud(&seed, 5, 4, 4, 1, 0.2);
            sb_material materials[3] = {sb_material_corotated(1000, REAL(0.3), 1000),
                                        sb_material_svk(1000, REAL(0.3), 1000),
                                        sb_material_neo_hookean(1000, REAL(0.3), 1000)};
            sb_vec3 *u = (sb_vec3 *)calloc((size_t)cloud.count, sizeof(sb_vec3)), reaction;
            int nodes = cloud.count;
            sb_particles p;
            sb_body *body;
            sb_energy energy;
            def.method = (sb_particle_method)method;
            cloud_use(&cloud, &def);
            p = make_particles(&def);
            sb_body_def body_def = cloud_body_def(&p, materials[model]);
            body = scene_body(&body_def);
            if (method > 1)
                CHECK_OK(sb_particles_stabilise(&p, body, REAL(0.02), NULL, NULL));
            for (int i = 0; i < nodes; i++) {
                sb_vec3 x = p.mesh.nodes[i];
                u[i] = sb_v3_sub(sb_v3(1 - x.y, x.x + 2, x.z - 3), x);
            }
            CHECK_OK(sb_body_set_displacements(body, u));
            CHECK_OK(sb_body_energy(body, &energy));
            if (method > 1) {
                CHECK_NEAR(energy.elastic, 0, 1000 * (SB_REAL_IS_FLOAT ? 1e-4 : 1e-12));
                CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
                CHECK_NEAR(largest(sb_body_velocities(body), nodes), 0, SB_REAL_IS_FLOAT ? 2e-2 : 1e-9);
            }
            reaction = scene_sum(sb_body_reactions(body), nodes);
            CHECK_NEAR(sb_v3_norm(reaction), 0, 0);
            free(u);
            sb_body_destroy(body);
            sb_particles_free(&p);
            cloud_free(&cloud);
        }
}

/* Moment of momentum about the origin with the lumped masses, whose scaling is worked out here again. */
static sb_vec3 moment_of(const sb_particles *p, sb_real density, const sb_body *body)
{
    int n = p->domain.nodes_per_cell;
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int e = 0; e < p->mesh.element_count; e++) {
        const sb_real *mass = p->domain.cell_mass + (size_t)e * (size_t)(n * (n + 1) / 2);
        sb_real trace = 0;
        for (int a = 0, at = 0; a < n; at += n - a, a++)
            trace += mass[at];
        for (int a = 0, at = 0; a < n; at += n - a, a++) {
            int node = p->domain.cells[e * n + a];
            sum = sb_v3_madd(sum, density * p->domain.weights[e] * mass[at] / trace,
                             sb_v3_cross(sb_body_positions(body)[node], sb_body_velocities(body)[node]));
        }
    }
    return sum;
}

/* Free in space, all methods keep momentum and its moment over many steps. */
static void test_momentum(void)
{
    for (int method = 1; method <= 3; method++) {
        unsigned long long seed = 10;
        sb_particles_def def = sb_default_particles_def();
        particle_cloud cloud = random_cloud(&seed, 3, 3, 4, 1, 0.15);
        sb_vec3 *v = (sb_vec3 *)calloc((size_t)cloud.count, sizeof(sb_vec3)), moment[2], sum[2];
        double scale = 0;
        sb_particles p;
        sb_body *body;
        def.method = (sb_particle_method)method;
        cloud_use(&cloud, &def);
        p = make_particles(&def);
        sb_body_def body_def = cloud_body_def(&p, sb_material_corotated(1000, REAL(0.3), 1000));
        body_def.integrator = SB_CENTRAL_DIFFERENCE;
        body = scene_body(&body_def);
        for (int i = 0; i < cloud.count; i++)
            v[i] = sb_v3(REAL(check_random_in(&seed, -0.1, 0.1)), REAL(check_random_in(&seed, -0.1, 0.1)),
                         REAL(check_random_in(&seed, -0.1, 0.1)));
        CHECK_OK(sb_body_set_velocities(body, v));
        scale = (double)sb_body_mass(body) * 0.1;
        for (int when = 0; when < 2; when++) {
            sum[when] = sb_body_momentum(body);
            moment[when] = moment_of(&p, 1000, body);
            for (int step = 0; step < check_rounds(1000) && when == 0; step++)
                CHECK_OK(sb_body_step(body, REAL(0.005), NULL));
        }
        CHECK(sb_v3_norm(moment[0]) > REAL(0.005 * scale));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sum[1], sum[0])) / REAL(scale), 0, SB_REAL_IS_FLOAT ? 1e-2 : 1e-10);
        /* SPH sees a turning body strained: its forces are central in no sense */
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(moment[1], moment[0])) / REAL(scale), 0,
                   method == 1        ? HUGE_VAL
                   : SB_REAL_IS_FLOAT ? 1e-2
                                      : 1e-10);
        free(v);
        sb_body_destroy(body);
        sb_particles_free(&p);
        cloud_free(&cloud);
    }
}

/* Square root of the quotient of the seventh and the largest eigenvalue of K over M, and the sixth over it. */
static void test_zero_modes(void)
{
    for (int k = 0; k < 6; k++) {
        static const int neighbours[3] = {10, 18, 26};
        unsigned long long seed = 4;
        sb_particles_def def = sb_default_particles_def();
        particle_cloud cloud = random_cloud(&seed, 4, 4, 4, 1, 0);
        sb_real frequencies[7];
        sb_vec3 *x = (sb_vec3 *)calloc(2 * (size_t)cloud.count, sizeof(sb_vec3)), *y = x + cloud.count;
        sb_modes_options options = sb_default_modes_options();
        double top = 0, low, pi = 3.14159265358979323846, mass;
        sb_particles p;
        sb_body *body;
        def.method = SB_PARTICLES_MLS;
        def.neighbours = neighbours[k % 3];
        def.consistent = 0;
        def.points = cloud.points;
        def.point_count = cloud.count;
        def.volume = 1;
        p = make_particles(&def);
        sb_body_def body_def = cloud_body_def(&p, sb_material_linear(1000, REAL(0.3), 1000));
        body = scene_body(&body_def);
        if (k >= 3)
            CHECK_OK(sb_particles_stabilise(&p, body, REAL(0.02), NULL, NULL));
        for (int i = 0; i < cloud.count; i++)
            x[i] = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)), 0);
        for (int turn = 0; turn < 60; turn++) { /* of K alone: volumes differ little */
            double size = 0;
            CHECK_OK(sb_body_multiply_stiffness(body, x, y, NULL));
            for (int i = 0; i < cloud.count; i++)
                size += (double)sb_v3_dot(y[i], y[i]);
            top = sqrt(size);
            for (int i = 0; i < cloud.count; i++)
                x[i] = sb_v3_scale(REAL(1 / top), y[i]);
        }
        if (k >= 3) { /* its rows hold no rigid motion */
            CHECK_RESULT(sb_body_solve_static(body, NULL, NULL), SB_ERROR_UNCONSTRAINED);
        }
        options.tolerance = REAL(1e-4);
        mass = (double)sb_body_mass(body) / cloud.count;
        if (CHECK_OK(sb_body_modes(body, 7, &options, frequencies, NULL, NULL, NULL))) {
            low = pow(2 * pi * (double)frequencies[6], 2) * mass / top;
            printf("    %d neighbours%s: lowest elastic eigenvalue / largest %.1e\n", def.neighbours,
                   k >= 3 ? ", stabilised" : "", low);
            CHECK(k < 3 ? low < 2e-2 : low > 5e-3);
            CHECK((double)frequencies[5] < 0.05 * (double)frequencies[6]);
        }
        free(x);
        sb_body_destroy(body);
        sb_particles_free(&p);
        cloud_free(&cloud);
    }
}

/* ---- symmetry, cuts, states ---- */

/* A beam that hangs straight down from its end keeps to its axis, whatever the method and the number of neighbours. */
static void test_drift(void)
{
    for (int method = 1; method <= 3; method++)
        for (int neighbours = 10; neighbours <= 30; neighbours += 5) {
            unsigned long long seed = 1;
            particle_cloud cloud = random_cloud(&seed, 4, 12, 4, 12, 0);
            sb_particles_def def = sb_default_particles_def();
            sb_vec3 sum;
            double aside = 0;
            sb_particles p;
            sb_body *body;
            cloud_use(&cloud, &def);
            def.method = (sb_particle_method)method;
            def.neighbours = neighbours;
            def.points_per_cell = neighbours % 2 ? 1 : 8;
            p = make_particles(&def);
            sb_body_def body_def = cloud_body_def(&p, sb_material_corotated(2000, REAL(0.3), REAL(6.23)));
            body_def.gravity = sb_v3(0, REAL(9.81), 0);
            body_def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-8);
            body = scene_body(&body_def);
            scene_fix_plane(body, &p.mesh, 1, 0, SB_XYZ);
            for (int step = 0; step < 6; step++)
                CHECK_OK(sb_body_step(body, REAL(0.02), NULL));
            sum = scene_sum(sb_body_displacements(body), p.mesh.node_count);
            aside = hypot((double)sum.x, (double)sum.z) / (double)sum.y;
            CHECK((double)sum.y > 0);
            CHECK_NEAR(aside, 0, SB_REAL_IS_FLOAT ? 1e-3 : 1e-6);
            sb_body_destroy(body);
            sb_particles_free(&p);
            cloud_free(&cloud);
        }
}

/* Of a block that was cut one half falls, and the other feels nothing. */
static void test_halves(void)
{
    for (int method = 1; method <= 3; method++) {
        unsigned long long seed = 14;
        particle_cloud cloud = random_cloud(&seed, 6, 4, 4, 1, 0.15);
        sb_particles_def def = sb_default_particles_def();
        sb_mesh sheet = make_sheet(REAL(0.5), -1, 2);
        double still = 0, moved = 0;
        sb_particles p;
        sb_body *body;
        cloud_use(&cloud, &def);
        def.method = (sb_particle_method)method;
        p = make_particles(&def);
        CHECK_OK(sb_particles_cut(&p, &sheet, NULL));
        sb_body_def body_def = cloud_body_def(&p, sb_material_corotated(1000, REAL(0.3), 1000));
        body = scene_body(&body_def);
        for (int i = 0; i < p.mesh.node_count; i++) {
            sb_vec3 force = sb_v3(REAL(0.3), 0, REAL(0.1));
            if (p.mesh.nodes[i].x > REAL(0.5))
                CHECK_OK(sb_body_add_forces(body, &i, 1, &force, 1));
        }
        for (int step = 0; step < 10; step++)
            CHECK_OK(sb_body_step(body, REAL(0.02), NULL));
        for (int i = 0; i < p.mesh.node_count; i++) {
            double u = (double)sb_v3_norm(sb_body_displacements(body)[i]);
            if (p.mesh.nodes[i].x > REAL(0.5))
                moved = fmax(moved, u);
            else
                still = fmax(still, u);
        }
        CHECK(moved > 1e-3);
        CHECK_NEAR(still, 0, moved * 1e-12);
        sb_body_destroy(body);
        sb_particles_free(&p);
        sb_mesh_free(&sheet);
        cloud_free(&cloud);
    }
}

/* A body outlives cuts of what it was made of: it steps, and its state can be saved. It is none of the cut cloud. */
static void test_outlives_cuts(void)
{
    unsigned long long seed = 15;
    particle_cloud cloud = random_cloud(&seed, 5, 4, 4, 1, 0.15);
    sb_particles_def def = sb_default_particles_def();
    sb_mesh sheets[2] = {make_sheet(REAL(0.4), -1, 2), make_sheet(REAL(0.7), -1, 2)};
    sb_particles p;
    sb_body *body;
    size_t size;
    unsigned char *before, *after;
    cloud_use(&cloud, &def);
    p = make_particles(&def);
    sb_body_def body_def = cloud_body_def(&p, sb_material_corotated(1000, REAL(0.3), 1000));
    body_def.gravity = sb_v3(0, 0, REAL(-9.81));
    body = scene_body(&body_def);
    size = sb_body_state_size(body);
    before = (unsigned char *)malloc(size);
    after = (unsigned char *)malloc(size);
    CHECK_OK(sb_body_step(body, REAL(0.02), NULL));
    CHECK_OK(sb_body_state_save(body, before, size));
    for (int i = 0; i < 2; i++)
        CHECK_OK(sb_particles_cut(&p, &sheets[i], NULL));
    CHECK_OK(sb_body_state_save(body, after, size));
    CHECK(memcmp(before, after, size) == 0);
    CHECK_OK(sb_body_step(body, REAL(0.02), NULL));
    CHECK_RESULT(sb_particles_stabilise(&p, body, REAL(0.02), NULL, NULL), SB_ERROR_ARGUMENT);
    sb_body_destroy(body);
    sb_particles_free(&p);
    for (int i = 0; i < 2; i++)
        sb_mesh_free(&sheets[i]);
    free(before);
    free(after);
    cloud_free(&cloud);
}

/* Steps on with these threads, and by way of a saved state; both must give one hash. */
static unsigned long long play(const sb_particles *p, sb_material material, sb_integrator integrator, int *workers,
                               int by_state)
{
    sb_body_def def = cloud_body_def(p, material);
    unsigned long long hash;
    sb_body *body;
    void *state = NULL;
    def.gravity = sb_v3(0, REAL(1.5), REAL(-9.81));
    def.integrator = integrator;
    def.jobs = scene_jobs(workers);
    body = scene_body(&def);
    if (!body)
        return 0;
    scene_fix_plane(body, &p->mesh, 1, 0, SB_XYZ);
    CHECK_OK(sb_particles_stabilise(p, body, REAL(0.02), NULL, NULL));
    for (int step = 0; step < 6; step++) {
        if (step == 3 && by_state) {
            size_t size = sb_body_state_size(body);
            state = malloc(size);
            CHECK_OK(sb_body_state_save(body, state, size));
            CHECK_OK(sb_body_step(body, REAL(0.03), NULL));
            CHECK_OK(sb_body_state_load(body, state, size, NULL));
        }
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    }
    hash = scene_hash(sb_body_displacements(body), (size_t)p->mesh.node_count * sizeof(sb_vec3)) * 31 +
           scene_hash(sb_body_velocities(body), (size_t)p->mesh.node_count * sizeof(sb_vec3));
    free(state);
    sb_body_destroy(body);
    return hash;
}

/* What a recording of particles holds, their stabilisation too, makes another body of them move alike, to the bit. */
static void test_recorded(void)
{
    for (int method = 2; method <= 3; method++) {
        unsigned long long seed = 22;
        particle_cloud cloud = random_cloud(&seed, 4, 5, 4, 1, 0.15);
        sb_particles_def def = sb_default_particles_def();
        sb_material material = sb_material_corotated(4000, REAL(0.3), 1000);
        sb_recording *recording = NULL;
        sb_body_def body_def;
        sb_body *body, *again;
        sb_particles p;
        cloud_use(&cloud, &def);
        def.method = (sb_particle_method)method;
        p = make_particles(&def);
        body_def = cloud_body_def(&p, material);
        body_def.gravity = sb_v3(0, REAL(1.5), REAL(-9.81));
        body = scene_body(&body_def);
        again = scene_body(&body_def);
        if (CHECK(body && again) && CHECK_OK(sb_recording_start(body, 1, NULL, &recording, NULL))) {
            scene_fix_plane(body, &p.mesh, 1, 0, SB_XYZ);
            CHECK_OK(sb_particles_stabilise(&p, body, REAL(0.02), NULL, NULL));
            for (int step = 0; step < 4; step++)
                CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            sb_recording_stop(recording);
            CHECK_OK(sb_recording_replay(recording, again, NULL));
            CHECK(sb_body_state_hash(again) == sb_body_state_hash(body));
        }
        sb_recording_destroy(recording);
        sb_body_destroy(body);
        sb_body_destroy(again);
        sb_particles_free(&p);
        cloud_free(&cloud);
    }
}

static void test_same_bits(void)
{
    for (int method = 2; method <= 3; method++)
        for (int round = 0; round < 4; round++) {
            unsigned long long seed = 20, first;
            particle_cloud cloud = random_cloud(&seed, 4, 7, 4, 1, 0.15);
            sb_particles_def def = sb_default_particles_def();
            sb_material material =
                round == 1 ? sb_material_svk(4000, REAL(0.3), 1000) : sb_material_corotated(4000, REAL(0.3), 1000);
            sb_integrator integrator = round == 2 ? SB_CENTRAL_DIFFERENCE : round == 3 ? SB_NEWMARK : SB_EULER;
            sb_particles p;
            int workers = 1;
            cloud_use(&cloud, &def);
            def.method = (sb_particle_method)method;
            def.points_per_cell = 1;
            p = make_particles(&def);
            first = play(&p, material, integrator, &workers, 0);
            CHECK(play(&p, material, integrator, &workers, 1) == first);
            for (workers = 2; workers <= 16; workers += 7)
                CHECK(play(&p, material, integrator, &workers, 0) == first);
            sb_particles_free(&p);
            cloud_free(&cloud);
        }
}

/* The loops that take several points at a time do what those for one do: corotated, against its invertible sister,
 * which has no batches; also with more nodes than 16 in a cell, and materials of two ratios. */
static void test_batches(void)
{
    for (int round = 0; round < 4; round++) {
        unsigned long long seed = 21;
        particle_cloud cloud = random_cloud(&seed, 4, 5, 4, 1, 0.2);
        sb_particles_def def = sb_default_particles_def();
        sb_vec3 *x = (sb_vec3 *)calloc(4 * (size_t)cloud.count, sizeof(sb_vec3)), *y[2];
        double worst = 0;
        sb_particles p;
        cloud_use(&cloud, &def);
        def.neighbours = round % 2 ? 18 : 10;
        def.method = round < 2 ? SB_PARTICLES_MLS : SB_PARTICLES_GRID;
        p = make_particles(&def);
        for (int i = 0; i < cloud.count; i++) {
            x[i] = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)), 1);
            x[i + cloud.count] = sheared(p.mesh.nodes[i], 0.3);
        }
        for (int e = 0; e < p.mesh.element_count; e++)
            p.mesh.regions[e] = p.points[e].x > REAL(0.4);
        for (int k = 0; k < 2; k++) {
            sb_material soft = sb_material_corotated(1000, REAL(0.3), 1000);
            sb_material stiff = sb_material_corotated(3000, REAL(0.45), 1000);
            sb_body_def body_def;
            sb_body *body;
            y[k] = x + (size_t)(2 + k) * (size_t)cloud.count;
            if (k) {
                soft.model = SB_COROTATED_INVERTIBLE;
                stiff.model = SB_COROTATED_INVERTIBLE;
            }
            body_def = cloud_body_def(&p, soft);
            body = scene_body(&body_def);
            CHECK_OK(sb_body_set_region_material(body, 1, &stiff, NULL));
            CHECK_OK(sb_body_set_displacements(body, x + cloud.count));
            CHECK_OK(sb_body_multiply_tangent(body, SB_TANGENT_QUASI, x, y[k], NULL));
            sb_body_destroy(body);
        }
        for (int i = 0; i < cloud.count; i++)
            worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(y[0][i], y[1][i])));
        CHECK(largest(y[1], cloud.count) > 1);
        CHECK_NEAR(worst / largest(y[1], cloud.count), 0, SB_REAL_IS_FLOAT ? 1e-4 : 1e-11);
        free(x);
        sb_particles_free(&p);
        cloud_free(&cloud);
    }
}

/* A step that cannot be done is undone. */
static void test_undo(void)
{
    unsigned long long seed = 22, before;
    particle_cloud cloud = random_cloud(&seed, 4, 5, 4, 1, 0.1);
    sb_particles_def def = sb_default_particles_def();
    sb_particles p;
    sb_body *body;
    cloud_use(&cloud, &def);
    p = make_particles(&def);
    sb_body_def body_def = cloud_body_def(&p, sb_material_neo_hookean(1000, REAL(0.3), 1000));
    body = scene_body(&body_def);
    scene_fix_plane(body, &p.mesh, 1, 0, SB_XYZ);
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    for (int i = 0; i < cloud.count; i++) { /* the far side through the near one */
        sb_vec3 u = sb_v3(0, REAL(-4), 0);
        if (p.mesh.nodes[i].y > REAL(0.999))
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
    }
    before = sb_body_state_hash(body);
    check_bad_numbers();
    CHECK(sb_body_step(body, REAL(0.01), NULL) != SB_OK);
    CHECK(sb_body_state_hash(body) == before);
    for (int i = 0; i < cloud.count; i++)
        if (p.mesh.nodes[i].y > REAL(0.999))
            CHECK_OK(sb_body_release_nodes(body, &i, 1, SB_XYZ));
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    sb_body_destroy(body);
    sb_particles_free(&p);
    cloud_free(&cloud);
}

static void test_stabilise_arguments(void)
{
    unsigned long long seed = 22;
    particle_cloud cloud = random_cloud(&seed, 3, 3, 3, 1, 0.1);
    sb_particles_def def = sb_default_particles_def();
    sb_particles p, q;
    sb_body *body;
    sb_error error;
    int id = 77;
    cloud_use(&cloud, &def);
    p = make_particles(&def);
    def.method = SB_PARTICLES_SPH;
    q = make_particles(&def);
    sb_body_def body_def = cloud_body_def(&p, sb_material_neo_hookean(1000, REAL(0.3), 1000));
    body = scene_body(&body_def);
    check_bad_numbers();
    CHECK_RESULT(sb_particles_stabilise(&p, body, 0, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_particles_stabilise(&p, body, REAL(NAN), &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_particles_stabilise(&p, body, 11, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_particles_stabilise(NULL, body, 1, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_particles_stabilise(&q, body, 1, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(id, 77);
    CHECK_OK(sb_particles_stabilise(&p, body, 1, &id, &error));
    CHECK_OK(sb_body_remove_load(body, id));
    sb_body_destroy(body);
    body_def = cloud_body_def(&q, sb_material_corotated(1000, REAL(0.3), 1000));
    body = scene_body(&body_def);
    CHECK_RESULT(sb_particles_stabilise(&q, body, 1, &id, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "linear") != NULL);
    sb_body_destroy(body);
    sb_particles_free(&p);
    sb_particles_free(&q);
    cloud_free(&cloud);
}

CHECK_SUITE(particles_body, {"patch", test_patch}, {"rotation", test_rotation}, {"momentum", test_momentum},
            {"zero modes", test_zero_modes}, {"drift", test_drift}, {"halves", test_halves},
            {"outlives cuts", test_outlives_cuts}, {"same bits", test_same_bits},
            {"recorded and played again", test_recorded}, {"batches", test_batches}, {"undo", test_undo},
            {"arguments of stabilisation", test_stabilise_arguments});
