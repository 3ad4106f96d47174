/* Pressures, tractions and mappings of faces and elements that are cut: nothing is lost, and each part has its own. */
#define SB_SPLIT_BUILD
#include "../src/softbody/body/load.h"
#include "../src/softbody/body/state.h"

#include "cut_block.h"

/* ---- loaded faces ------------------------------------------------------------------------------------------------ */

enum { LOADS = 2 };
static const sb_real pressures[LOADS] = {REAL(130), REAL(-45)};
static const sb_vec3 stress = {REAL(20), REAL(-310), REAL(55)};

typedef struct loaded {
    block b;
    int ids[LOADS];
    sb_vec3 *rest[LOADS + 1]; /* nodal forces on the uncut block at rest: of each pressure, of the traction */
    double size[LOADS + 1];
} loaded;

static const sb_element_type elements[2] = {SB_TET4, SB_TET10};

/* The block of case i of six: each lattice with each element. */
static block_options loaded_options(int i)
{
    block_options options = block_default(intervals_of[i % 3]);
    options.element = elements[i / 3];
    if (options.element == SB_TET10)
        options.nx = 4, options.ny = 3, options.nz = 3;
    return options;
}

/* Nodal forces of a pressure at displacements u. */
static sb_vec3 *pressure_forces(sb_body *body, int load, const sb_vec3 *u)
{
    int nodes = sb_body_node_count(body);
    sb_vec3 *forces = (sb_vec3 *)malloc((size_t)nodes * sizeof *forces);
    sb_real was[LOADS];
    for (int l = 0; l < LOADS; l++) {
        was[l] = body->loads[l].pressure;
        body->loads[l].pressure = l == load ? was[l] : 0;
    }
    sbi_loads_force(body, u, 1);
    memcpy(forces, body->follower, (size_t)nodes * sizeof *forces);
    for (int l = 0; l < LOADS; l++)
        body->loads[l].pressure = was[l];
    return forces;
}

static sb_vec3 *forces_at_rest(sb_body *body, int load)
{
    int nodes = sb_body_node_count(body);
    sb_vec3 *zeros = (sb_vec3 *)calloc((size_t)nodes, sizeof *zeros), *forces;
    if (load == LOADS) {
        memcpy(zeros, body->dead_load, (size_t)nodes * sizeof *zeros);
        return zeros;
    }
    forces = pressure_forces(body, load, zeros);
    free(zeros);
    return forces;
}

/* A block with a pressure on its skin, one on its end, and a traction on its skin. */
static loaded loaded_make(const block_options *options)
{
    loaded l;
    l.b = block_make(options);
    for (int k = 0; k <= LOADS; k++) {
        int count, *faces = skin_faces(&l.b, k == 1, &count);
        CHECK(count > 0);
        if (k < LOADS)
            CHECK_OK(sb_body_add_pressure(l.b.body, faces, count, 3, pressures[k], &l.ids[k], NULL));
        else
            CHECK_OK(sb_body_add_traction(l.b.body, faces, count, 3, stress, NULL));
        free(faces);
        l.rest[k] = forces_at_rest(l.b.body, k);
        l.size[k] = 0;
        for (int n = 0; n < l.b.mesh.node_count; n++)
            l.size[k] = fmax(l.size[k], (double)sb_v3_norm(l.rest[k][n]));
    }
    return l;
}

static void loaded_free(loaded *l)
{
    for (int k = 0; k <= LOADS; k++)
        free(l->rest[k]);
    block_free(&l->b);
}

/* At rest, what the copies of a node have sums to what it had: so do forces and moments. */
static double loads_fault(const loaded *l)
{
    const block *b = &l->b;
    int nodes = sb_body_node_count(b->body);
    double worst = 0;
    for (int k = 0; k <= LOADS; k++) {
        sb_vec3 *sums = (sb_vec3 *)calloc((size_t)b->mesh.node_count, sizeof *sums), *forces;
        forces = forces_at_rest(b->body, k);
        for (int n = 0; n < nodes; n++) {
            int origin = sb_cut_node_origin(b->cut, n);
            if (origin >= 0)
                sums[origin] = sb_v3_add(sums[origin], forces[n]);
        }
        for (int n = 0; n < b->mesh.node_count; n++)
            worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(sums[n], l->rest[k][n])) / l->size[k]);
        free(sums);
        free(forces);
    }
    return worst;
}

/* Force and moment of the pressures where the body is. */
static void pressures_now(const loaded *l, sb_vec3 *force, sb_vec3 *moment)
{
    sb_body *body = l->b.body;
    *force = *moment = sb_v3(0, 0, 0);
    for (int k = 0; k < LOADS; k++) {
        sb_vec3 *forces = pressure_forces(body, k, body->displacement);
        for (int n = 0; n < sb_body_node_count(body); n++) {
            *force = sb_v3_add(*force, forces[n]);
            *moment = sb_v3_add(*moment, sb_v3_cross(sb_body_positions(body)[n], forces[n]));
        }
        free(forces);
    }
}

/* ---- nothing is lost --------------------------------------------------------------------------------------------- */

static void test_sums(void)
{
    unsigned long long seed = 71;
    double worst = 0, jump = 0, bend = 0;
    for (int i = 0; i < 6; i++) {
        block_options options = loaded_options(i);
        loaded l = loaded_make(&options);
        size_t size = sb_body_state_size(l.b.body);
        void *state = malloc(size);
        uint64_t hash = sb_body_state_hash(l.b.body);
        double scale = (double)pressures[0] * (double)(block_size.x * block_size.y);
        CHECK_OK(sb_body_state_save(l.b.body, state, size));
        block_shake(&l.b);
        for (int stroke = 0; stroke < (check_quick() ? 4 : 8); stroke++) {
            sb_vec3 triangles[18], before[2], after[2];
            int count = strip_random(triangles, &seed);
            pressures_now(&l, &before[0], &before[1]);
            block_cut(&l.b, triangles, count);
            pressures_now(&l, &after[0], &after[1]);
            check_pieces(&l.b);
            jump = fmax(jump, (double)sb_v3_norm(sb_v3_sub(after[0], before[0])) / scale);
            *(options.element == SB_TET4 ? &jump : &bend) =
                fmax(options.element == SB_TET4 ? jump : bend,
                     (double)sb_v3_norm(sb_v3_sub(after[1], before[1])) / scale / (double)block_size.x);
            worst = fmax(worst, loads_fault(&l));
            block_step(&l.b, 1);
        }
        CHECK_OK(sb_body_state_load(l.b.body, state, size, NULL));
        CHECK(sb_body_state_hash(l.b.body) == hash);
        CHECK(l.b.body->loads[0].has_parts == 0);
        free(state);
        loaded_free(&l);
    }
    printf(
        "   loads at rest over the uncut ones off by %.1e of the largest, pressures at a cut by %.1e, their moments on "
        "bent faces by %.1e\n",
        worst, jump, bend);
    CHECK_NEAR(worst, 0, scene_tolerance(1e-13, 100));
    CHECK_NEAR(jump, 0, scene_tolerance(1e-13, 500));
    CHECK_NEAR(bend, 0, 3e-5);
}

/* Each part of a block that a plane cuts has what acts on its own faces. */
static void test_parts(void)
{
    for (int i = 0; i < 6; i++) {
        block_options options = loaded_options(i);
        loaded l = loaded_make(&options);
        const double y = (double)block_size.y, z = (double)block_size.z, at = 0.0173;
        double close = scene_tolerance(5e-6, 200);
        sb_vec3 *end, *dead, sums[2][2];
        memset(sums, 0, sizeof sums);
        CHECK_INT(block_cut_plane(&l.b, sb_v3(REAL(0.03), REAL(at), REAL(0.02)), sb_v3(0, 1, 0)).parts, 2);
        end = forces_at_rest(l.b.body, 1);
        dead = forces_at_rest(l.b.body, LOADS);
        for (int n = 0; n < sb_body_node_count(l.b.body); n++) {
            int part = l.b.body->node_component[n];
            if (part < 0)
                continue;
            sums[part][0] = sb_v3_add(sums[part][0], end[n]);
            sums[part][1] = sb_v3_add(sums[part][1], dead[n]);
        }
        for (int part = 0; part < 2; part++) { /* the first has node 0, below the plane */
            double high = part ? y - at : at, x = (double)block_size.x;
            double skin = 2 * x * high + 2 * z * high + x * z, whole = 2 * (x * y + y * z + z * x);
            CHECK_NEAR(sums[part][0].x, -(double)pressures[1] * high * z, close * fabs((double)pressures[1]) * y * z);
            CHECK_NEAR(sums[part][0].y, 0, close * fabs((double)pressures[1]) * y * z);
            CHECK_NEAR(sums[part][1].y, (double)stress.y * skin, close * fabs((double)stress.y) * whole);
        }
        free(end);
        free(dead);
        loaded_free(&l);
    }
}

/* Faces that are the parts of the skin now, each once. */
static int *part_faces(const block *b, int *count)
{
    const sb_cut *cut = b->cut;
    int *faces = (int *)malloc((size_t)sb_body_element_count(b->body) * 12 * sizeof(int));
    *count = 0;
    for (int tet = 0; tet < cut->tet_count; tet++)
        for (int face = 0; face < 4; face++)
            for (int piece = tet; piece >= 0 && cut->neighbours.items[4 * tet + face] < 0;
                 piece = cut->pieces[piece].next) {
                int local[SB_MAX_FACE_NODES], *at = faces + 3 * *count, fresh = 1;
                sb_element_face(SB_TET4, face, local, NULL);
                for (int k = 0; k < 3; k++)
                    at[k] = sb_body_cell_nodes(b->body, cut->pieces[piece].cell)[local[k]];
                for (int f = 0; f < *count; f++)
                    fresh &= memcmp(faces + 3 * f, at, 3 * sizeof(int)) != 0;
                *count += fresh;
            }
    return faces;
}

/* A traction on parts of faces is the same as one on the faces before they were cut. */
static void test_later(void)
{
    unsigned long long seed = 13;
    for (int i = 0; i < 6; i++) {
        block_options options = loaded_options(i);
        loaded l = loaded_make(&options);
        sb_body *body = l.b.body;
        sb_vec3 *once;
        int count, *faces;
        for (int stroke = 0; stroke < 6; stroke++) {
            sb_vec3 triangles[18];
            int of_strip = strip_random(triangles, &seed);
            block_cut(&l.b, triangles, of_strip);
        }
        once = forces_at_rest(body, LOADS);
        faces = part_faces(&l.b, &count);
        CHECK_OK(sb_body_add_traction(body, faces, count, 3, stress, NULL));
        for (int n = 0; n < sb_body_node_count(body); n++)
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_v3_scale(2, once[n]), body->dead_load[n])), 0,
                       scene_tolerance(1e-13, 500) * l.size[LOADS]);
        sb_body_clear_loads(body);
        CHECK_OK(sb_body_add_traction(body, faces, count, 3, stress, NULL));
        for (int frame = 0; frame < 3; frame++) { /* calls that are made again do not add up in memory */
            int kept = body->traction_count;
            sb_body_clear_loads(body);
            CHECK_OK(sb_body_add_traction(body, faces, count, 3, stress, NULL));
            CHECK_OK(sb_body_add_traction(body, faces, count, 3, stress, NULL));
            CHECK_INT(body->traction_count, kept);
        }
        free(once);
        free(faces);
        loaded_free(&l);
    }
}

/* ---- pressures that follow --------------------------------------------------------------------------------------- */

/* The work along a line is the integral of the force, and the tangent its derivative. */
static void check_work(const block_options *options)
{
    unsigned long long seed = 5;
    loaded l = loaded_make(options);
    sb_body *body = l.b.body;
    int nodes;
    sb_vec3 *u, *du, *at;
    sbi_loads_work work;
    block_cut_plane(&l.b, sb_v3(REAL(0.03), REAL(0.0173), REAL(0.02)), sb_v3(1, 1, REAL(0.3)));
    block_cut_plane(&l.b, sb_v3(REAL(0.05), REAL(0.0173), REAL(0.02)), sb_v3(REAL(0.2), 1, REAL(0.2)));
    CHECK(body->loads[0].has_parts && body->loads[1].has_parts);
    nodes = sb_body_node_count(body);
    u = (sb_vec3 *)malloc((size_t)nodes * sizeof *u);
    du = (sb_vec3 *)malloc((size_t)nodes * sizeof *du);
    at = (sb_vec3 *)malloc((size_t)nodes * sizeof *at);
    for (int n = 0; n < nodes; n++) {
        u[n] = vector_in(-0.004, 0.004, &seed);
        du[n] = vector_in(-0.004, 0.004, &seed);
    }
    work = sbi_loads_line(body, u, du, 1);
    for (int k = 0; k < 3; k++) {
        double t = 0.4 * k, power = 0, slope, size = 0;
        for (int n = 0; n < nodes; n++)
            at[n] = sb_v3_madd(u[n], REAL(t), du[n]);
        sbi_loads_force(body, at, 1);
        for (int n = 0; n < nodes; n++) {
            power += (double)sb_v3_dot(body->follower[n], du[n]);
            size += fabs((double)sb_v3_dot(body->follower[n], du[n]));
        }
        slope = (double)work.linear + 2 * t * (double)work.quadratic + 3 * t * t * (double)work.cubic;
        CHECK_NEAR(slope, power, scene_tolerance(1e-12, 5000) * size);
    }
    free(u);
    free(du);
    free(at);
    loaded_free(&l);
}

static void test_work(void)
{
    for (int i = 1; i < 6; i += 3) {
        block_options options = loaded_options(i);
        check_work(&options);
    }
}

/* Without Poisson's ratio both parts of a bar that is pulled stretch as the whole one does. */
static void test_static(void)
{
    const double young = 5000, pull = 50;
    for (int i = 0; i < 4; i++) {
        block_options options = loaded_options(i < 2 ? 1 : 4);
        sb_static_options solve = sb_default_static_options();
        sb_material material = sb_material_linear(REAL(young), 0, 1000);
        block b = block_make(&options);
        int count, *faces = skin_faces(&b, 1, &count), id;
        solve.tolerance = REAL(scene_tolerance(1e-11, 1000));
        CHECK_OK(sb_body_set_material(b.body, &material, NULL));
        scene_fix_plane(b.body, &b.mesh, 0, 0, SB_X);
        scene_fix_plane(b.body, &b.mesh, 2, 0, SB_Z);
        scene_fix_plane(b.body, &b.mesh, 1, 0, SB_Y);
        scene_fix_plane(b.body, &b.mesh, 1, (double)block_size.y, SB_Y);
        CHECK_OK(sb_body_add_pressure(b.body, faces, count, 3, REAL(-pull), &id, NULL));
        if (i % 2)
            CHECK_INT(block_cut_plane(&b, sb_v3(REAL(0.03), REAL(0.0231), REAL(0.02)), sb_v3(0, 1, REAL(0.3))).parts,
                      2);
        CHECK_OK(sb_body_solve_static(b.body, &solve, NULL));
        for (int n = 0; n < b.mesh.node_count; n++) {
            double stretch = pull / young * (double)b.mesh.nodes[n].x;
            CHECK_NEAR((double)sb_body_displacements(b.body)[n].x, stretch,
                       scene_tolerance(5e-6, 1e5) * pull / young * (double)block_size.x);
        }
        free(faces);
        block_free(&b);
    }
}

/* ---- membranes --------------------------------------------------------------------------------------------------- */

/* Displacements of a stretch and shear of the whole block, and how fast a random field changes the energy there. */
static double membrane_rate(sb_body *body, const sb_vec3 *u, const sb_vec3 *du, double *energy)
{
    const double step = sizeof(sb_real) == sizeof(double) ? 1e-5 : 1e-2;
    int nodes = sb_body_node_count(body);
    sb_vec3 *at = (sb_vec3 *)malloc((size_t)nodes * sizeof *at);
    double ends[2];
    for (int side = 0; side < 2; side++) {
        for (int n = 0; n < nodes; n++)
            at[n] = sb_v3_madd(u[n], REAL(side ? step : -step), du[n]);
        ends[side] = sbi_loads_curved_energy(body, at, 1);
    }
    *energy = sbi_loads_curved_energy(body, u, 1);
    free(at);
    return (ends[1] - ends[0]) / (2 * step);
}

/* Energy of one more sheet on all outer faces as they are now. */
static double energy_of_another(sb_body *body, const sb_membrane_def *def, const sb_vec3 *u)
{
    const double before = sbi_loads_curved_energy(body, u, 1);
    double energy;
    int id;
    CHECK_OK(sb_body_add_membrane(body, def, &id, NULL));
    energy = sbi_loads_curved_energy(body, u, 1) - before;
    CHECK_OK(sb_body_remove_load(body, id));
    return energy;
}

/* A sheet on a block that is stretched evenly has the same energy however it is cut, and pulls as that changes. */
static void check_membrane(const block_options *options)
{
    unsigned long long seed = 23;
    block b = block_make(options);
    sb_membrane_def def = sb_default_membrane_def();
    sb_body *body = b.body;
    double whole = 0, energy, rate, power, size;
    def.thickness = REAL(0.0004);
    def.shear = 30000;
    CHECK_OK(sb_body_add_membrane(body, &def, NULL, NULL));
    for (int stroke = 0; stroke < 5; stroke++) {
        int nodes = sb_body_node_count(body);
        sb_vec3 *u = (sb_vec3 *)malloc((size_t)nodes * sizeof *u), *du = (sb_vec3 *)malloc((size_t)nodes * sizeof *du);
        sb_vec3 triangles[18];
        for (int n = 0; n < nodes; n++) {
            sb_vec3 x = body->reference[n];
            u[n] = sb_v3(REAL(0.15) * x.x + REAL(0.04) * x.y, REAL(0.2) * x.y, REAL(0.18) * x.z - REAL(0.05) * x.x);
            du[n] = vector_in(-0.001, 0.001, &seed);
        }
        rate = membrane_rate(body, u, du, &energy);
        whole = stroke == 0 ? energy : whole;
        CHECK_NEAR(energy / whole, 1, scene_tolerance(1e-12, 500));
        CHECK_NEAR(energy_of_another(body, &def, u) / whole, 1, scene_tolerance(1e-12, 500));
        sbi_loads_force(body, u, 1);
        power = size = 0;
        for (int n = 0; n < nodes; n++) {
            power += (double)sb_v3_dot(body->follower[n], du[n]);
            size += fabs((double)sb_v3_dot(body->follower[n], du[n]));
        }
        CHECK_NEAR(power, -rate, scene_tolerance(1e-6, 1e5) * size);
        free(u);
        free(du);
        block_cut(&b, triangles, strip_random(triangles, &seed));
    }
    CHECK(body->loads[0].has_parts);
    block_step(&b, 5);
    block_free(&b);
}

static void test_membrane(void)
{
    for (int i = 0; i < 6; i++) {
        block_options options = loaded_options(i);
        check_membrane(&options);
    }
}

/* ---- the same again ---------------------------------------------------------------------------------------------- */

static uint64_t run_loaded(loaded *l)
{
    unsigned long long seed = 19;
    for (int i = 0; i < 16; i++) {
        sb_vec3 triangles[18];
        int count = strip_random(triangles, &seed);
        block_cut(&l->b, triangles, count);
        block_step(&l->b, 1);
    }
    return sb_body_state_hash(l->b.body);
}

static void check_same_bits(const block_options *options)
{
    loaded l = loaded_make(options), again = loaded_make(options);
    sb_recording *recording = NULL;
    sb_recording_report report;
    size_t size, early_size;
    void *state, *early;
    uint64_t hash, later;
    early_size = sb_body_state_size(l.b.body);
    early = malloc(early_size);
    CHECK_OK(sb_body_state_save(l.b.body, early, early_size));
    CHECK_OK(sb_recording_start(l.b.body, 0, NULL, &recording, NULL));
    hash = run_loaded(&l);
    CHECK(l.b.body->loads[0].has_parts);
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, again.b.body, &report)))
        printf("%s, step %d\n", report.error.message, report.step);
    CHECK(sb_body_state_hash(again.b.body) == hash);
    size = sb_body_state_size(l.b.body); /* into a body with the uncut mesh */
    state = malloc(size);
    CHECK_OK(sb_body_state_save(l.b.body, state, size));
    block_step(&l.b, 3);
    later = sb_body_state_hash(l.b.body);
    CHECK_OK(sb_body_state_load(again.b.body, early, early_size, NULL));
    CHECK_OK(sb_body_state_load(again.b.body, state, size, NULL));
    CHECK(sb_body_state_hash(again.b.body) == hash);
    CHECK(again.b.body->loads[0].has_parts);
    block_step(&again.b, 3);
    CHECK(sb_body_state_hash(again.b.body) == later);
    ((unsigned char *)state)[SBI_IMAGE_HEAD] = options->element == SB_TET4 ? 16 : 17; /* as earlier versions */
    sbi_image_seal((unsigned char *)state, size, "SBSTATE\x1A", 2);
    CHECK_RESULT(sb_body_state_load(again.b.body, state, size, NULL), SB_ERROR_UNSUPPORTED);
    CHECK(sb_body_state_hash(again.b.body) == later);
    sb_recording_destroy(recording);
    free(state);
    free(early);
    loaded_free(&l);
    loaded_free(&again);
}

static void test_same_bits(void)
{
    for (int i = 1; i < 6; i += 3) {
        block_options options = loaded_options(i);
        check_same_bits(&options);
    }
}

/* ---- undo -------------------------------------------------------------------------------------------------------- */

/* A cut is taken back also where a cable couples nodes that no element does, and so what hangs together for the
 * preconditioner. Returns how many pieces more or less there were for it than were wanted, over all. */
static int undo_with_cable(unsigned long long seed)
{
    sb_mesh mesh = scene_box(SB_TET4, 10, 3, 3, sb_v3(REAL(0.1), REAL(0.02), REAL(0.02)), 0);
    sb_body_def def = sb_default_body_def();
    sb_cut_def cutting = sb_default_cut_def();
    sb_cable_def cable = sb_default_cable_def();
    int ends[2] = {(int)vector_in(0, mesh.node_count / 2, &seed).x, 0}, others = 0;
    sb_cut *cut = NULL;
    def.mesh = &mesh;
    def.material = sb_material_corotated(REAL(1e5), REAL(0.4), 1000);
    def.slack = 2;
    cutting.body = scene_body(&def);
    ends[1] = ends[0] + mesh.node_count / 3;
    cable.count = 2;
    cable.nodes = ends;
    cable.stiffness = REAL(0.5);
    CHECK_OK(sb_body_add_cable(cutting.body, &cable, NULL, NULL));
    CHECK_OK(sb_cut_create(&cutting, &cut, NULL));
    for (int k = 0; k < 6; k++) {
        sb_body *body = cutting.body;
        size_t size = sb_body_state_size(body);
        unsigned char *state = (unsigned char *)malloc(size);
        uint64_t before = sb_body_state_hash(body);
        sb_vec3 middle = vector_in(0, 0.02, &seed), triangle[3];
        sb_error error;
        middle.x *= 5;
        for (int i = 0; i < 3; i++)
            triangle[i] = sb_v3_add(middle, vector_in(-0.1, 0.1, &seed));
        CHECK_OK(sb_body_state_save(body, state, size));
        others += sb_preconditioner_get_info(body->precond).piece_count != sbi_precond_wanted_pieces(body->precond);
        CHECK_OK(sb_cut_triangles(cut, triangle, 1, NULL, NULL));
        if (!CHECK_OK(sb_body_state_load(body, state, size, &error)))
            printf("cut %d: %s\n", k, error.message);
        CHECK(sb_body_state_hash(body) == before);
        CHECK_OK(sb_cut_triangles(cut, triangle, 1, NULL, NULL));
        free(state);
    }
    sb_cut_destroy(cut);
    sb_body_destroy(cutting.body);
    sb_mesh_free(&mesh);
    return others;
}

static void test_undo_with_cable(void)
{
    int others = 0;
    for (unsigned long long seed = 1; seed <= 60; seed++)
        others += undo_with_cable(seed);
    CHECK(others > 20);
}

CHECK_SUITE(cut_loads, {"undo of cuts of a body with a cable", test_undo_with_cable},
            {"loads of cut faces sum to those of whole ones", test_sums}, {"each part has what acts on it", test_parts},
            {"tractions on parts", test_later}, {"work is what forces do", test_work},
            {"two parts stretch as one", test_static}, {"membranes that are cut", test_membrane},
            {"states and recordings", test_same_bits});
