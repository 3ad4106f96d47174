/* Strokes of a blade over many calls: what they part while the tissue moves, what they leave as it was, and the same
 * again from states and recordings. */
#define SB_SPLIT_BUILD
#include "../src/softbody/base/bytes.h"

#include "cut_blade.h"

/* ---- through a shaking block ------------------------------------------------------------------------------------- */

/* A block that shakes by some percent between frames, cut through; returns the number of its parts that are larger than
 * an element, and counts the others. */
static int cut_shaking(int lattice, unsigned long long seed, double speed, int keeps_rings, int *crumbs)
{
    double volumes[64], element = (double)(block_size.x * block_size.y * block_size.z) / 720;
    block_options options = block_default(lattice);
    block b = block_make(&options);
    blade of = blade_random(&seed);
    int stroke, parts, large = 0;
    b.cut->keeps_rings = keeps_rings;
    block_shake_at(&b, speed);
    block_step(&b, 2);
    stroke = begin(&b, &of);
    sweep(&b, &of, stroke, -1, 1, 24);
    sb_cut_end(b.cut, stroke);
    check_pieces(&b);
    parts = part_volumes(&b, volumes, 64);
    for (int k = 0; k < parts; k++)
        large += volumes[k] > element;
    *crumbs += parts - large;
    block_free(&b);
    return large;
}

static void test_shaking(void)
{
    static const double speeds[3] = {0.02, 0.04, 0.2}; /* 1, 2 and 9 percent between frames */
    int rounds = check_quick() ? 6 : 45, crumbs = 0;
    for (int round = 0; round < rounds; round++) {
        int lattice = round % 3 < 2 ? 1 : 2;
        if (!CHECK_INT(cut_shaking(lattice, 100 + (unsigned long long)round, speeds[round / 3 % 3], 0, &crumbs), 2))
            printf("round %d, lattice %d\n", round, lattice);
    }
    CHECK(crumbs <= rounds / 10); /* at edges of the block */
}

/* Strips that join where the edge was in the tissue leave few threads: one of 40 blocks that shake by 9 percent between
 * frames hangs on such a link where the rule of rings is off. */
static void test_thread(void)
{
    const unsigned long long seed = 123;
    int crumbs = 0;
    if (SB_REAL_IS_FLOAT)
        return; /* another motion */
    for (int lattice = 1; lattice <= 2; lattice++)
        for (int keeps_rings = 0; keeps_rings < 2; keeps_rings++)
            CHECK_INT(cut_shaking(lattice, seed, 0.2, keeps_rings, &crumbs), keeps_rings ? 1 : 2);
}

/* Cuts at rest leave no link in a ring, but on edges of the block that the border of a cut passes just inside of. */
static void test_rest(void)
{
    unsigned long long seed = 7;
    int rounds = check_quick() ? 6 : 60;
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < rounds; round++) {
            block_options options = block_default(intervals_of[i]);
            sb_vec3 triangles[6];
            block b = block_make(&options);
            int ringed;
            square_make(vector_in(0.01, 0.04, &seed), vector_in(-1, 1, &seed), 0.02, triangles);
            ringed = block_cut(&b, triangles, 2).ringed;
            for (int k = b.cut->links.count - ringed; k < b.cut->links.count; k++) {
                const int *at = b.cut->links.items[k].key.at;
                sb_vec3 p, q;
                if (!CHECK(at[1] >= 0 && at[2] < 0)) /* along an edge */
                    continue;
                p = b.mesh.nodes[at[0]], q = b.mesh.nodes[at[1]];
                CHECK_INT((p.x == q.x) + (p.y == q.y) + (p.z == q.z), 2);
                CHECK_INT((p.x == 0 || p.x == block_size.x) + (p.y == 0 || p.y == block_size.y) +
                                  (p.z == 0 || p.z == block_size.z) >=
                              2,
                          1);
            }
            block_free(&b);
        }
}

/* A plane with a hole about one link. */
static int plane_with_hole(sb_vec3 middle, double hole, sb_vec3 *triangles)
{
    int count = 0;
    for (int side = 0; side < 4; side++) { /* from the hole's edge to that of the plane */
        double angle = 1.5707963267948966 * side, next = angle + 1.5707963267948966;
        double c = cos(angle), s = sin(angle), d = cos(next), t = sin(next), far = 0.2;
        sb_vec3 inner = sb_v3(middle.x, middle.y + REAL(hole * c), middle.z + REAL(hole * s));
        sb_vec3 inner_next = sb_v3(middle.x, middle.y + REAL(hole * d), middle.z + REAL(hole * t));
        sb_vec3 outer = sb_v3(middle.x, middle.y + REAL(far * c), middle.z + REAL(far * s));
        sb_vec3 outer_next = sb_v3(middle.x, middle.y + REAL(far * d), middle.z + REAL(far * t));
        triangles[count++] = inner, triangles[count++] = outer, triangles[count++] = outer_next;
        triangles[count++] = inner, triangles[count++] = outer_next, triangles[count++] = inner_next;
    }
    return count / 3;
}

/* A link that is left in a hole of a cut holds nothing, inside and on the skin; without the rule it does. */
static void test_ring(void)
{
    static const double places[4][2] = {{0.02, 0.02}, {0.01, 0.03}, {0, 0.02}, {0.04, 0.05}};
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 4; k++)
            for (int keeps_rings = 0; keeps_rings < 2; keeps_rings++) {
                block_options options = block_default(intervals_of[i]);
                sb_vec3 triangles[24];
                int count =
                    plane_with_hole(sb_v3(REAL(0.0313), REAL(places[k][0]), REAL(places[k][1])), 1e-3, triangles);
                sb_cut_info info;
                block b;
                options.shake = 0;
                b = block_make(&options);
                b.cut->keeps_rings = keeps_rings;
                info = block_cut(&b, triangles, count);
                CHECK_INT(info.ringed, keeps_rings ? 0 : 1);
                CHECK_INT(info.parts, keeps_rings ? 1 : 2);
                check_pieces(&b);
                block_free(&b);
            }
}

/* A blade that rests cuts what moves through it. */
static void test_resting_blade(void)
{
    block_options options = block_default(2);
    block b = block_make(&options);
    sb_vec3 *v = (sb_vec3 *)calloc((size_t)sb_body_node_count(b.body), sizeof *v), edge[2];
    int stroke, parts = 1;
    for (int n = 0; n < sb_body_node_count(b.body); n++)
        v[n] = sb_v3(0, 0, 1);
    CHECK_OK(sb_body_set_velocities(b.body, v));
    edge[0] = sb_v3(REAL(0.0319), REAL(-0.01), REAL(0.06));
    edge[1] = sb_v3(REAL(0.0287), REAL(0.05), REAL(0.06));
    CHECK_OK(sb_cut_begin(b.cut, edge, 2, &stroke, NULL));
    for (int i = 0; i < 16; i++) {
        sb_cut_info info;
        block_step(&b, 1);
        CHECK_OK(sb_cut_move(b.cut, stroke, edge, &info, NULL));
        parts = info.parts;
    }
    CHECK_INT(parts, 2);
    check_pieces(&b);
    free(v);
    block_free(&b);
}

/* In one call or in many, a block at rest is cut alike; the totals of a moving one stay as they are. */
static void test_frames(void)
{
    for (int i = 0; i < 3; i++) {
        block_options options = block_default(intervals_of[i]);
        unsigned long long seed = 12;
        blade of = blade_random(&seed);
        block one = block_make(&options), many = block_make(&options), moving = block_make(&options);
        int stroke = begin(&one, &of), other = begin(&many, &of);
        totals before, after;
        CHECK_INT(move(&one, &of, stroke, 0.17).parts, 1);
        for (int k = 1; k <= 9; k++)
            move(&many, &of, other, -1 + 1.17 * k / 9);
        CHECK_NEAR(many.cut->links.count, one.cut->links.count, 1 + 0.01 * one.cut->links.count);
        CHECK_NEAR(many.cut->piece_count, one.cut->piece_count, 1 + 0.01 * one.cut->piece_count);
        CHECK_INT(move(&one, &of, stroke, 1).parts, 2);
        CHECK_INT(move(&many, &of, other, 1).parts, 2);
        block_shake(&moving);
        stroke = begin(&moving, &of);
        for (int k = 1; k <= 12; k++) {
            block_step(&moving, 1);
            before = totals_of(&moving);
            move(&moving, &of, stroke, -1 + k / 6.0);
            after = totals_of(&moving);
            check_totals(&before, &after);
        }
        check_pieces(&moving);
        block_free(&one);
        block_free(&many);
        block_free(&moving);
    }
}

/* Beside the body nothing is cut, and its mesh is the same one. */
static void test_beside(void)
{
    block_options options = block_default(2);
    block b = block_make(&options);
    blade of = blade_make(sb_v3(REAL(0.2), 0, 0), sb_v3(1, 0, 0), 0.3);
    int stroke = begin(&b, &of), version = sb_body_mesh_version(b.body);
    for (int i = 1; i <= 10; i++)
        CHECK_INT(move(&b, &of, stroke, -1 + i / 5.0).links, 0);
    CHECK_INT(sb_body_mesh_version(b.body), version);
    block_free(&b);
}

/* ---- the same again ---------------------------------------------------------------------------------------------- */

/* A stroke goes on from a state, in this body and in another. */
static void test_states(void)
{
    for (int i = 0; i < 3; i++) {
        block_options options = block_default(intervals_of[i]);
        unsigned long long seed = 5;
        block b = block_make(&options), other = block_make(&options);
        blade of = blade_random(&seed);
        size_t first_size, size;
        void *first, *middle;
        uint64_t start, at_middle, end;
        int stroke;
        block_shake(&b);
        block_step(&b, 2);
        first = state_of(&b, &first_size);
        start = sb_body_state_hash(b.body);
        stroke = begin(&b, &of);
        at_middle = run_frames(&b, &of, stroke, 0, 8);
        middle = state_of(&b, &size);
        end = run_frames(&b, &of, stroke, 8, 16);
        CHECK_INT(b.body->component_count, 2);
        load(&b, middle, size);
        CHECK(sb_body_state_hash(b.body) == at_middle);
        check_pieces(&b);
        CHECK(run_frames(&b, &of, stroke, 8, 16) == end);
        load(&b, first, first_size);
        CHECK(sb_body_state_hash(b.body) == start);
        CHECK_INT(b.cut->links.count, 0);
        CHECK_INT(begin(&b, &of), stroke);
        CHECK(run_frames(&b, &of, stroke, 0, 16) == end);
        load(&other, middle, size);
        check_pieces(&other);
        CHECK(run_frames(&other, &of, stroke, 8, 16) == end);
        free(first);
        free(middle);
        block_free(&b);
        block_free(&other);
    }
}

/* A cut that parts nothing yet is in the state, and is taken back with it. */
static void test_unparted(void)
{
    block_options options = block_default(1);
    block b = block_make(&options);
    sb_vec3 small[3] = {{REAL(0.03), REAL(0.02), REAL(0.02)}, {REAL(0.03), REAL(0.025), REAL(0.02)}, {0, 0, 0}};
    size_t size, cut_size;
    void *state = state_of(&b, &size), *cut;
    uint64_t hash = sb_body_state_hash(b.body);
    sb_cut_info info;
    memset(&info, 0, sizeof info);
    small[2] = sb_v3(REAL(0.0303), REAL(0.02), REAL(0.03));
    for (int k = 0; k < 40 && !b.cut->links.count; k++) { /* small enough to part nothing, large enough for a link */
        for (int a = 0; a < 3; a++)
            small[a].x += REAL(0.0003);
        info = block_cut(&b, small, 1);
    }
    CHECK(info.links > 0 && info.cells == 0);
    CHECK(sb_body_state_hash(b.body) != hash);
    cut = state_of(&b, &cut_size);
    load(&b, state, size);
    CHECK(sb_body_state_hash(b.body) == hash);
    CHECK_INT(b.cut->links.count, 0);
    load(&b, cut, cut_size);
    CHECK_INT(b.cut->links.count, info.links);
    free(state);
    free(cut);
    block_free(&b);
}

/* States that do not fit are refused, and nothing has happened then. */
static void test_bad_states(void)
{
    block_options options = block_default(2);
    block b = block_make(&options), other;
    unsigned long long seed = 5;
    blade of = blade_random(&seed);
    int stroke = begin(&b, &of);
    size_t size, at = 0;
    unsigned char *state;
    sb_error error;
    uint64_t hash = run_frames(&b, &of, stroke, 0, 8);
    state = (unsigned char *)state_of(&b, &size);
    options.lattice = 1;
    other = block_make(&options);
    CHECK_RESULT(sb_body_state_load(other.body, state, size, &error), SB_ERROR_STATE);
    sb_cut_destroy(other.cut);
    other.cut = NULL;
    CHECK_RESULT(sb_body_state_load(other.body, state, size, &error), SB_ERROR_STATE);
    for (size_t i = 0; i + 8 < size; i++)
        if (memcmp(state + i, "cut\0\0\0\0\0", 8) == 0)
            at = i + 20;
    CHECK(at > 0);
    for (int round = 0; round < (check_quick() ? 60 : 300); round++) {
        size_t place = at + (size_t)(check_random(&seed) * (double)(size - 8 - at));
        unsigned char was = state[place];
        state[place] = (unsigned char)(check_random(&seed) * 256);
        sbi_image_seal(state, size, "SBSTATE\x1a", (uint32_t)sbi_get_bytes(state + 8, 4));
        if (state[place] != was && sb_body_state_load(b.body, state, size, NULL) == SB_OK)
            check_pieces(&b);
        else
            CHECK(sb_body_state_hash(b.body) == hash);
        state[place] = was;
        sbi_image_seal(state, size, "SBSTATE\x1a", (uint32_t)sbi_get_bytes(state + 8, 4));
        CHECK_OK(sb_body_state_load(b.body, state, size, NULL));
    }
    CHECK(sb_body_state_hash(b.body) == hash);
    free(state);
    block_free(&other);
    block_free(&b);
}

static void test_recording(void)
{
    block_options options = block_default(2);
    unsigned long long seed = 5;
    block b = block_make(&options), again = block_make(&options);
    blade of = blade_random(&seed), next = blade_random(&seed);
    sb_recording *recording = NULL;
    sb_recording_report report;
    uint64_t hash;
    int stroke;
    block_shake(&b);
    CHECK_OK(sb_recording_start(b.body, 0, NULL, &recording, NULL));
    stroke = begin(&b, &of);
    run_frames(&b, &of, stroke, 0, 16);
    sb_cut_end(b.cut, stroke);
    block_cut_plane(&b, sb_v3(REAL(0.03), REAL(0.0213), REAL(0.025)), sb_v3(0, 1, 0));
    block_step(&b, 1);
    CHECK_INT(begin(&b, &next), stroke);
    hash = run_frames(&b, &next, stroke, 0, 12);
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, again.body, &report)))
        printf("%s, step %d\n", report.error.message, report.step);
    CHECK(sb_body_state_hash(again.body) == hash);
    check_pieces(&again);
    CHECK(run_frames(&again, &next, stroke, 12, 16) == run_frames(&b, &next, stroke, 12, 16));
    sb_recording_destroy(recording);
    block_free(&b);
    block_free(&again);
}

static void test_threads(void)
{
    static const int workers_of[4] = {1, 2, 3, 16};
    uint64_t first = 0;
    for (int k = 0; k < 4; k++) {
        int workers = workers_of[k], stroke;
        sb_body_def def = sb_default_body_def();
        unsigned long long seed = 5;
        blade of = blade_random(&seed);
        block b;
        uint64_t hash;
        memset(&b, 0, sizeof b);
        b.mesh = scene_box(SB_TET4, 12, 8, 10, block_size, 0.2);
        def.mesh = &b.mesh;
        def.material = sb_material_corotated(REAL(5000), REAL(0.4), 1000);
        def.slack = 1;
        def.jobs = scene_jobs(&workers);
        b.body = scene_body(&def);
        block_cut_create(&b, 2);
        block_shake_at(&b, 0.3);
        stroke = begin(&b, &of);
        hash = run_frames(&b, &of, stroke, 0, check_quick() ? 3 : 10);
        first = k ? first : hash;
        CHECK(hash == first);
        block_free(&b);
    }
}

/* ---- what fails, and what it costs ------------------------------------------------------------------------------- */

/* Every allocation of a stroke fails in turn: body, cut and front are as before, and the same call does it then. */
static void test_no_memory(void)
{
    uint64_t expected = 0;
    for (int fail = 0, done = 0; !done && fail < 600; fail++) {
        scene_memory memory = {0, 0, 0, 0};
        block b = counted_block(&memory, 3, 0.01);
        blade of = blade_make(sb_v3(REAL(0.031), REAL(0.02), REAL(0.025)), sb_v3(1, REAL(0.2), REAL(0.1)), 0.4);
        sb_vec3 edge[40];
        sb_result result;
        uint64_t before;
        int stroke = -1;
        for (int k = 0; k < 40; k++) /* more corners and samples than there is room for */
            edge[k] = sb_v3_madd(sb_v3_sub(of.middle, of.ahead), REAL(k / 20.0 - 1), of.along);
        memory.fail_at = fail ? memory.calls + fail : 0;
        before = sb_body_state_hash(b.body);
        result = sb_cut_begin(b.cut, edge, 40, &stroke, NULL);
        if (result == SB_OK) {
            before = sb_body_state_hash(b.body);
            for (int k = 0; k < 40; k++)
                edge[k] = sb_v3_madd(edge[k], 2, of.ahead);
            result = sb_cut_move(b.cut, stroke, edge, NULL, NULL);
        }
        memory.fail_at = 0;
        done = fail && result == SB_OK;
        if (result != SB_OK) {
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK(sb_body_state_hash(b.body) == before);
            check_pieces(&b);
            if (stroke < 0) {
                CHECK_OK(sb_cut_begin(b.cut, edge, 40, &stroke, NULL));
                for (int k = 0; k < 40; k++)
                    edge[k] = sb_v3_madd(edge[k], 2, of.ahead);
            }
            CHECK_OK(sb_cut_move(b.cut, stroke, edge, NULL, NULL));
        }
        expected = fail ? expected : sb_body_state_hash(b.body);
        CHECK(sb_body_state_hash(b.body) == expected);
        CHECK_INT(b.body->component_count, 2);
        check_pieces(&b);
        block_free(&b);
        CHECK_INT(memory.live, 0);
        CHECK(done || fail < 599);
    }
}

static void test_no_allocation(void)
{
    scene_memory memory = {0, 0, 0, 0};
    block b = counted_block(&memory, 8, 20);
    unsigned long long seed = 3;
    int strokes = check_quick() ? 2 : 20, calls, rebuilds = b.body->live->rebuilds;
    scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
    block_step(&b, 1);
    calls = memory.calls;
    for (int k = 0; k < strokes; k++) {
        blade of = blade_random(&seed);
        int stroke;
        of.along = sb_v3_scale(REAL(0.2), of.along);
        stroke = begin(&b, &of);
        run_frames(&b, &of, stroke, 0, 15);
        sb_cut_end(b.cut, stroke);
    }
    CHECK_INT(b.body->live->rebuilds, rebuilds);
    CHECK_INT(memory.calls, calls);
    check_pieces(&b);
    block_free(&b);
}

static void test_mistakes(void)
{
    block_options options = block_default(2);
    block b = block_make(&options);
    sb_cut_def def = sb_default_cut_def();
    sb_vec3 edge[2] = {{0, 0, 0}, {REAL(0.01), 0, 0}};
    sb_error error;
    int stroke = -1, strokes[4];
    CHECK_RESULT(sb_cut_begin(NULL, edge, 2, &stroke, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_cut_begin(b.cut, edge, 1, &stroke, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_cut_begin(b.cut, NULL, 2, &stroke, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_cut_begin(b.cut, edge, 2, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_cut_move(b.cut, 0, edge, NULL, &error), SB_ERROR_INDEX);
    CHECK_RESULT(sb_cut_move(b.cut, -1, edge, NULL, &error), SB_ERROR_INDEX);
    for (int k = 0; k < 4; k++)
        CHECK_OK(sb_cut_begin(b.cut, edge, 2, strokes + k, &error));
    CHECK_RESULT(sb_cut_begin(b.cut, edge, 2, &stroke, &error), SB_ERROR_STATE);
    CHECK_INT(stroke, -1);
    sb_cut_end(b.cut, strokes[2]);
    CHECK_OK(sb_cut_begin(b.cut, edge, 2, &stroke, &error));
    CHECK_INT(stroke, strokes[2]);
    CHECK_RESULT(sb_cut_move(b.cut, stroke, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    edge[1].y = REAL(NAN);
    CHECK_RESULT(sb_cut_move(b.cut, stroke, edge, NULL, &error), SB_ERROR_NOT_FINITE);
    edge[1].y = REAL(1e30); /* as far as it gets */
    edge[0].y = REAL(-1e30);
    CHECK_OK(sb_cut_move(b.cut, stroke, edge, NULL, &error));
    sb_cut_end(b.cut, 99);
    sb_cut_end(NULL, 0);
    def.body = b.body;
    def.max_strokes = -1;
    CHECK_RESULT(sb_cut_create(&def, &b.cut, &error), SB_ERROR_ARGUMENT);
    scene_remove_cells(b.body); /* somebody else */
    edge[0] = edge[1] = sb_v3(0, 0, 0);
    CHECK_RESULT(sb_cut_move(b.cut, stroke, edge, NULL, &error), SB_ERROR_STATE);
    block_free(&b);
}

/* ---- places and trees -------------------------------------------------------------------------------------------- */

/* The middle of a flag is in the flag's piece. */
static void test_piece_at(void)
{
    static const int nodes[4] = {7, 3, 12, 5};
    unsigned long long seed = 4;
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < 20; round++) {
            sbi_lattice lattice;
            sbi_parted parted;
            sbi_lattice_make(intervals_of[i], &lattice);
            memset(&parted, 0, sizeof parted);
            parted.lattice = &lattice;
            parted.order = sbi_corner_order_make(nodes);
            for (int l = 0; l < lattice.link_count; l++) {
                parted.cut[l] = (unsigned char)(check_random(&seed) < 0.8);
                parted.rank[l] = l;
                parted.t[l] = REAL(check_random_in(&seed, 0.05, 0.95));
            }
            sbi_parted_find(&parted);
            for (int micro = 0; micro < lattice.micro_count; micro++) {
                sbi_flag flags[SBI_FLAGS];
                int count = sbi_parted_flags(&parted, micro, 0, flags);
                for (int k = 0; k < count; k++) {
                    sb_vec3 xi = {0, 0, 0};
                    sb_real at[4];
                    for (int v = 0; v < 4; v++)
                        xi = sb_v3_madd(xi, REAL(0.25), flags[k].corners[v]);
                    at[0] = 1 - xi.x - xi.y - xi.z;
                    at[1] = xi.x, at[2] = xi.y, at[3] = xi.z;
                    CHECK_INT(sbi_parted_piece_at(&parted, at), flags[k].piece);
                }
            }
        }
}

static sbi_int3 int3_in(int size, unsigned long long *seed)
{
    sbi_int3 p;
    p.x = (int)check_random_in(seed, -size, size);
    p.y = (int)check_random_in(seed, -size, size);
    p.z = (int)check_random_in(seed, -size, size);
    return p;
}

/* A tree finds the blades that meet a box, each once. */
static void test_tree(void)
{
    enum { MOST = 300 };
    static sbi_blade blades[MOST];
    static int order[MOST], scratch[MOST];
    static uint64_t codes[MOST];
    static sbi_blade_box boxes[2 * (MOST / SBI_BLADE_LEAF + 1) + SBI_BLADE_LEVELS];
    unsigned long long seed = 6;
    for (int count = 0; count < MOST; count += 1 + count / 3) {
        sbi_blade_tree tree;
        memset(&tree, 0, sizeof tree);
        tree.order = order;
        tree.boxes = boxes;
        for (int k = 0; k < count; k++) {
            sbi_int3 corners[3], at = int3_in(SBI_CROSSING_BLADE - 3000, &seed);
            for (int a = 0; a < 3; a++) {
                corners[a] = int3_in(3000, &seed);
                corners[a].x += at.x, corners[a].y += at.y, corners[a].z += at.z;
            }
            (void)sbi_blade_make(corners, blades + k);
        }
        sbi_blade_tree_make(&tree, blades, count, codes, scratch);
        for (int round = 0; round < 50; round++) {
            unsigned char found[MOST] = {0};
            sbi_blade_box box;
            sbi_blade_walk walk;
            int wide = round % 5 ? 60000 : 600000;
            box.low = box.high = int3_in(SBI_CROSSING_BLADE, &seed);
            box.high.x += wide, box.high.y += wide, box.high.z += wide;
            sbi_blade_walk_begin(&tree, &box, &walk);
            for (int k = sbi_blade_walk_next(&tree, &walk); k >= 0; k = sbi_blade_walk_next(&tree, &walk))
                found[k]++;
            for (int k = 0; k < count; k++) {
                const sbi_blade *b = blades + k;
                int meets = b->low.x <= box.high.x && b->high.x >= box.low.x && b->low.y <= box.high.y &&
                            b->high.y >= box.low.y && b->low.z <= box.high.z && b->high.z >= box.low.z;
                CHECK_INT(found[k], meets);
            }
        }
    }
}

/* Links that several triangles cross are cut where the first one does, and in that order. */
static void test_first_triangle(void)
{
    block_options options = block_default(2);
    block one = block_make(&options), both = block_make(&options);
    sb_vec3 triangles[12];
    square_make(sb_v3(REAL(0.0305), REAL(0.02), REAL(0.025)), sb_v3(1, 0, 0), 0.2, triangles);
    square_make(sb_v3(REAL(0.03), REAL(0.02), REAL(0.025)), sb_v3(1, REAL(0.1), 0), 0.2, triangles + 6);
    block_cut(&one, triangles, 2);
    block_cut(&both, triangles, 4);
    CHECK(one.cut->links.count > 100 && both.cut->links.count > one.cut->links.count);
    for (int l = 0; l < one.cut->links.count; l++) {
        const sbi_cut_link *a = one.cut->links.items + l, *c = both.cut->links.items + l;
        CHECK(memcmp(&a->key, &c->key, sizeof a->key) == 0 && a->t == c->t);
    }
    check_pieces(&both);
    block_free(&one);
    block_free(&both);
}

CHECK_SUITE(cut_stroke, {"shaking blocks part in two", test_shaking}, {"a thread", test_thread},
            {"cuts at rest close no rings", test_rest}, {"a link in a ring", test_ring},
            {"a blade at rest cuts what moves", test_resting_blade}, {"one call or many", test_frames},
            {"beside the body", test_beside}, {"states", test_states}, {"cuts that part nothing", test_unparted},
            {"damaged states", test_bad_states}, {"recordings", test_recording}, {"threads", test_threads},
            {"every allocation fails in turn", test_no_memory}, {"no allocation", test_no_allocation},
            {"mistakes are named", test_mistakes}, {"places in pieces", test_piece_at}, {"blade trees", test_tree},
            {"the first triangle decides", test_first_triangle});
