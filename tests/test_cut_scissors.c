/* Scissors: what their blades pass as they close is cut, and nothing else. */
#include "cut_block.h"

/* A pair of scissors in a plane. */
typedef struct scissors {
    sb_vec3 hinge, ahead, aside; /* unit vectors */
    double length;
} scissors;

/* Those that come from the side y < 0 in a plane of about x = const. */
static scissors scissors_make(unsigned long long *seed)
{
    scissors s;
    sb_vec3 normal = sb_v3_add(sb_v3(1, 0, 0), vector_in(-0.1, 0.1, seed));
    s.hinge = sb_v3_add(sb_v3(REAL(0.0303), REAL(-0.02), REAL(0.0255)), vector_in(-0.002, 0.002, seed));
    s.aside = sb_v3_cross(normal, sb_v3(0, 1, 0));
    s.aside = sb_v3_scale(1 / sb_v3_norm(s.aside), s.aside);
    s.ahead = sb_v3_cross(s.aside, normal);
    s.ahead = sb_v3_scale(1 / sb_v3_norm(s.ahead), s.ahead);
    s.length = 0.1;
    return s;
}

/* Tip, hinge, tip with each blade at this angle (rad) to the middle. */
static void scissors_at(const scissors *s, double angle, sb_vec3 edge[3])
{
    double c = s->length * cos(angle), a = s->length * sin(angle);
    edge[1] = s->hinge;
    edge[0] = sb_v3_madd(sb_v3_madd(s->hinge, REAL(c), s->ahead), REAL(a), s->aside);
    edge[2] = sb_v3_madd(sb_v3_madd(s->hinge, REAL(c), s->ahead), REAL(-a), s->aside);
}

static const double wide = 1; /* open, at both sides of the block */

static int snip_begin(block *b, const scissors *s, double angle)
{
    sb_vec3 edge[3];
    int stroke = -1;
    scissors_at(s, angle, edge);
    CHECK_OK(sb_cut_begin(b->cut, edge, 3, &stroke, NULL));
    return stroke;
}

static sb_cut_info snip(block *b, const scissors *s, int stroke, double angle)
{
    sb_vec3 edge[3], tips[2];
    sb_cut_info info;
    sb_error error;
    memset(&info, 0, sizeof info);
    scissors_at(s, angle, edge);
    tips[0] = edge[0], tips[1] = edge[2];
    if (!CHECK_OK(sb_cut_scissors(b->cut, stroke, edge[1], tips, &info, &error)))
        printf("%s\n", error.message);
    return info;
}

/* ---- what is cut ------------------------------------------------------------------------------------------------- */

static block snipped_block(int lattice, sb_cut_front front)
{
    block_options options = block_default(lattice);
    options.front = front;
    return block_make(&options);
}

/* Closing across a block parts it, in one call and in many, and with blades that pass each other at the end. */
static void test_parts(void)
{
    static const int frames[3] = {1, 6, 25};
    unsigned long long seed = 3;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 6; k++) {
            block b = snipped_block(intervals_of[i], (sb_cut_front)(k & 1));
            scissors s = scissors_make(&seed);
            int stroke = snip_begin(&b, &s, wide), n = frames[k / 2];
            double end = k % 3 ? 0 : -0.01, volumes[64], area = 0;
            for (int f = 1; f <= n; f++)
                area += (double)snip(&b, &s, stroke, wide + (end - wide) * f / n).released_area;
            CHECK_INT(b.body->component_count, 2);
            CHECK_INT(part_volumes(&b, volumes, 64), 2);
            CHECK_NEAR(area, 0.04 * 0.05, 0.03 * 0.04 * 0.05);
            check_pieces(&b);
            block_free(&b);
        }
}

/* Half closed, a flap between the blades is left; it goes once they meet. What one blade passes alone is cut alone. */
static void test_flap(void)
{
    block b = snipped_block(2, SB_CUT_GLUE);
    unsigned long long seed = 5;
    scissors s = scissors_make(&seed);
    int stroke = snip_begin(&b, &s, wide);
    sb_vec3 edge[3], tips[2];
    sb_cut_info info = snip(&b, &s, stroke, 0.2);
    double area = (double)info.released_area;
    CHECK_INT(info.parts, 1);
    CHECK(area > 0);
    info = snip(&b, &s, stroke, 0.1);
    CHECK_INT(info.parts, 1);
    CHECK(info.released_area > 0);
    area += (double)info.released_area;
    scissors_at(&s, 0.1, edge); /* one blade goes to the other */
    tips[0] = edge[0], tips[1] = edge[0];
    CHECK_OK(sb_cut_scissors(b.cut, stroke, edge[1], tips, &info, NULL));
    CHECK_INT(info.parts, 2);
    CHECK_NEAR(area + (double)info.released_area, 0.04 * 0.05, 0.03 * 0.04 * 0.05);
    check_pieces(&b);
    block_free(&b);
}

/* Opening, moving open and moving shut cut nothing, and closing after that only what is passed then. */
static void test_idle(void)
{
    block b = snipped_block(2, SB_CUT_LAG);
    unsigned long long seed = 8;
    scissors s = scissors_make(&seed);
    int stroke = snip_begin(&b, &s, 0), version = sb_body_mesh_version(b.body);
    CHECK_INT(snip(&b, &s, stroke, 0).links, 0);
    s.hinge.x -= REAL(0.015);
    CHECK_INT(snip(&b, &s, stroke, 0).links, 0);
    for (int k = 1; k <= 10; k++)
        CHECK_INT(snip(&b, &s, stroke, 0.03 * k).links, 0);
    for (int k = 0; k < 5; k++) {
        s.hinge = sb_v3_add(s.hinge, vector_in(-0.004, 0.004, &seed));
        CHECK_INT(snip(&b, &s, stroke, 0.3).links, 0);
    }
    s.hinge.y += REAL(0.03);
    CHECK_INT(snip(&b, &s, stroke, 0.3).links, 0);
    CHECK_INT(sb_body_mesh_version(b.body), version);
    CHECK(snip(&b, &s, stroke, 0.05).links > 0);
    CHECK_INT(b.body->component_count, 1);
    check_pieces(&b);
    block_free(&b);
}

/* Through a block that shakes: in two parts, but for crumbs. */
static void test_shaking(void)
{
    double element = (double)(block_size.x * block_size.y * block_size.z) / 720;
    for (int round = 0; round < (check_quick() ? 4 : 20); round++) {
        unsigned long long seed = 40 + (unsigned long long)round;
        block b = snipped_block(intervals_of[round % 2], (sb_cut_front)(round / 2 % 2));
        scissors s = scissors_make(&seed);
        double volumes[64];
        int stroke, parts, large = 0;
        block_shake_at(&b, round % 3 ? 0.03 : 0.1);
        block_step(&b, 1);
        stroke = snip_begin(&b, &s, 1.2);
        for (int k = 1; k <= 16; k++) {
            totals before = totals_of(&b), after;
            sb_cut_info info = snip(&b, &s, stroke, 1.2 * (1 - k / 16.0));
            after = totals_of(&b);
            after.elastic += (double)info.released_energy;
            check_totals(&before, &after);
            block_step(&b, 1);
        }
        check_pieces(&b);
        parts = part_volumes(&b, volumes, 64);
        for (int k = 0; k < parts; k++)
            large += volumes[k] > element;
        if (!CHECK_INT(large, 2))
            printf("round %d\n", round);
        block_free(&b);
    }
}

/* Closing takes the work of what it frees. */
static void test_work(void)
{
    block_options options = block_default(2);
    unsigned long long seed = 3;
    scissors s = scissors_make(&seed);
    sb_material stiff = sb_material_corotated(REAL(1e6), REAL(0.4), 1000); /* soft tissue is paid for later */
    double work = 0, area = 0;
    sb_cut_info info;
    block b;
    int stroke;
    options.front = SB_CUT_GLUE;
    options.toughness = 150;
    b = block_make(&options);
    CHECK_OK(sb_body_set_material(b.body, &stiff, NULL));
    stroke = snip_begin(&b, &s, wide);
    for (int k = 1; k <= 20; k++) {
        info = snip(&b, &s, stroke, wide * (1 - k / 20.0));
        work += (double)info.work;
        area += (double)info.released_area;
        CHECK(sb_v3_is_finite(info.force) && sb_v3_is_finite(info.torque));
    }
    CHECK_NEAR(area, 0.04 * 0.05, 0.03 * 0.04 * 0.05);
    CHECK(work > 0.9 * 150 * area); /* but for what is freed last: shut blades do not go on */
    for (int i = 0; i < b.cut->strokes[stroke].debts.count; i++)
        work += 150 * (double)b.cut->strokes[stroke].debts.items[i].area;
    CHECK_NEAR(work, 150 * area, scene_tolerance(1e-12, 1e4) * work);
    info = snip(&b, &s, stroke, 0.1); /* opening takes none */
    CHECK(info.work == 0 && sb_v3_norm(info.force) == 0);
    block_free(&b);
}

/* ---- the same again ---------------------------------------------------------------------------------------------- */

static uint64_t snip_frames(block *b, const scissors *s, int stroke, int first, int end)
{
    for (int k = first; k < end; k++) {
        snip(b, s, stroke, wide * (1 - (k + 1) / 12.0));
        block_step(b, 1);
    }
    return sb_body_state_hash(b->body);
}

static void test_again(void)
{
    unsigned long long seed = 6;
    scissors s = scissors_make(&seed);
    block b = snipped_block(2, SB_CUT_GLUE), again = snipped_block(2, SB_CUT_GLUE);
    sb_recording *recording = NULL;
    sb_recording_report report;
    size_t size = sb_body_state_size(b.body), middle_size;
    void *first = malloc(size), *middle;
    uint64_t start, at_middle, end;
    int stroke;
    block_shake_at(&b, 0.05);
    size = sb_body_state_size(b.body);
    CHECK_OK(sb_body_state_save(b.body, first, size));
    start = sb_body_state_hash(b.body);
    CHECK_OK(sb_recording_start(b.body, 0, NULL, &recording, NULL));
    stroke = snip_begin(&b, &s, wide);
    snip(&b, &s, stroke, 1.05 * wide); /* opens first */
    at_middle = snip_frames(&b, &s, stroke, 0, 7);
    middle_size = sb_body_state_size(b.body);
    middle = malloc(middle_size);
    CHECK_OK(sb_body_state_save(b.body, middle, middle_size));
    end = snip_frames(&b, &s, stroke, 7, 12);
    CHECK(b.body->component_count >= 2);
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, again.body, &report)))
        printf("%s, step %d\n", report.error.message, report.step);
    CHECK(sb_body_state_hash(again.body) == end);
    CHECK_OK(sb_body_state_load(b.body, middle, middle_size, NULL));
    CHECK(sb_body_state_hash(b.body) == at_middle);
    CHECK(snip_frames(&b, &s, stroke, 7, 12) == end);
    CHECK_OK(sb_body_state_load(b.body, first, size, NULL));
    CHECK(sb_body_state_hash(b.body) == start);
    CHECK_INT(b.cut->links.count, 0);
    sb_recording_destroy(recording);
    free(first);
    free(middle);
    block_free(&b);
    block_free(&again);
}

/* ---- what fails -------------------------------------------------------------------------------------------------- */

static void test_no_memory(void)
{
    uint64_t expected = 0;
    for (int fail = 0, done = 0; !done && fail < 600; fail++) {
        scene_memory memory = {0, 0, 0, 0};
        block b = counted_block_with(&memory, 3, 0.01, SB_CUT_GLUE);
        unsigned long long seed = 2;
        scissors s = scissors_make(&seed);
        sb_vec3 edge[3], tips[2];
        sb_result result;
        uint64_t before;
        int stroke = snip_begin(&b, &s, wide);
        scissors_at(&s, 0, edge);
        tips[0] = edge[0], tips[1] = edge[2];
        before = sb_body_state_hash(b.body);
        memory.fail_at = fail ? memory.calls + fail : 0;
        result = sb_cut_scissors(b.cut, stroke, edge[1], tips, NULL, NULL);
        memory.fail_at = 0;
        done = fail && result == SB_OK;
        if (result != SB_OK) {
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK(sb_body_state_hash(b.body) == before);
            CHECK_OK(sb_cut_scissors(b.cut, stroke, edge[1], tips, NULL, NULL));
        }
        expected = fail ? expected : sb_body_state_hash(b.body);
        CHECK(sb_body_state_hash(b.body) == expected);
        CHECK_INT(b.body->component_count, 2);
        block_free(&b);
        CHECK_INT(memory.live, 0);
        CHECK(done || fail < 599);
    }
}

/* Blades without length cut nothing; what cannot be is refused. */
static void test_mistakes(void)
{
    block b = snipped_block(2, SB_CUT_LAG);
    unsigned long long seed = 2;
    scissors s = scissors_make(&seed);
    sb_vec3 edge[3], tips[2];
    sb_cut_info info;
    sb_error error;
    int stroke, other;
    scissors_at(&s, wide, edge);
    tips[0] = edge[0], tips[1] = edge[2];
    CHECK_RESULT(sb_cut_scissors(b.cut, 0, s.hinge, tips, &info, &error), SB_ERROR_INDEX);
    stroke = snip_begin(&b, &s, wide);
    CHECK_OK(sb_cut_begin(b.cut, edge, 2, &other, &error));
    CHECK_RESULT(sb_cut_scissors(b.cut, other, s.hinge, tips, &info, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_cut_scissors(NULL, stroke, s.hinge, tips, &info, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_cut_scissors(b.cut, stroke, s.hinge, NULL, &info, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_cut_scissors(b.cut, -1, s.hinge, tips, &info, &error), SB_ERROR_INDEX);
    CHECK_RESULT(sb_cut_scissors(b.cut, 99, s.hinge, tips, &info, &error), SB_ERROR_INDEX);
    check_bad_numbers();
    tips[1].z = REAL(NAN);
    CHECK_RESULT(sb_cut_scissors(b.cut, stroke, s.hinge, tips, &info, &error), SB_ERROR_NOT_FINITE);
    tips[0] = tips[1] = s.hinge;
    CHECK_OK(sb_cut_scissors(b.cut, stroke, s.hinge, tips, &info, &error));
    CHECK_INT(info.links, 0);
    CHECK_INT(snip(&b, &s, stroke, 0.5).links, 0); /* had no length before */
    tips[0] = tips[1] = sb_v3(REAL(1e30), 0, REAL(-1e30));
    CHECK_OK(sb_cut_scissors(b.cut, stroke, s.hinge, tips, &info, &error));
    check_pieces(&b);
    sb_cut_end(b.cut, stroke);
    CHECK_RESULT(sb_cut_scissors(b.cut, stroke, s.hinge, tips, &info, &error), SB_ERROR_INDEX);
    block_free(&b);
}

CHECK_SUITE(cut_scissors, {"closing parts", test_parts}, {"a flap between the blades", test_flap},
            {"open or shut they cut nothing", test_idle}, {"through a shaking block", test_shaking},
            {"work", test_work}, {"again", test_again}, {"every allocation fails in turn", test_no_memory},
            {"mistakes are named", test_mistakes});
