/* Needles in the saved states and recordings of their bodies: what follows a load is what followed the save, bit for
 * bit, in mid-insertion, in another body, after anything in between; recordings of whole scenes replay. Generated
 * programs. */
#include "image.h"
#include "needle_scene.h"

/* ---- generated scenes ---- */

typedef struct draw {
    unsigned long long seed;
} draw;

static double draw_in(draw *d, double low, double high) { return check_random_in(&d->seed, low, high); }
static int draw_one(draw *d, int count) { return (int)(check_random(&d->seed) * count); }

/* A body of random layers, materials and integrator, with one or two needles over it; equal seeds make equal scenes. */
static int make_scene(needle_scene *s, int seed)
{
    draw d;
    ndl_membrane membrane;
    sb_material other;
    int needles;
    d.seed = 77 + (unsigned long long)seed;
    *s = needle_scene_default();
    s->layered = draw_one(&d, 2);
    s->turned = draw_one(&d, 2);
    s->shake = draw_in(&d, 0, 0.2);
    for (int i = 0; i < 2; i++)
        s->materials[i].young = REAL(draw_in(&d, 2e4, 9e4));
    if (draw_one(&d, 3) == 0) {
        sb_real share = REAL(0.3), time = REAL(0.2);
        other = sb_material_with_prony(sb_material_stable_neo_hookean(REAL(4e4), REAL(0.4), 1000), &share, &time, 1);
        s->other = &other;
    }
    if (draw_one(&d, 3) == 0)
        s->body_def.integrator = SB_EULER;
    s->body_def.max_newton = draw_one(&d, 4) ? 1 : 3;
    s->body_def.preconditioner = draw_one(&d, 2) ? SB_PRECOND_IC0 : SB_PRECOND_BLOCK_JACOBI;
    s->needle_def.bevel.curvature = REAL(draw_one(&d, 2) * draw_in(&d, 2, 15));
    s->frictions[0].twist_stiffness = REAL(draw_one(&d, 2) * 0.01);
    s->frictions[0].twist_friction = REAL(0.0005);
    s->needle_def.entry_slip = REAL(draw_in(&d, 0, 0.25));
    if (s->layered && draw_one(&d, 2)) {
        membrane.regions[0] = 0, membrane.regions[1] = 1;
        membrane.strength = REAL(0.4), membrane.thickness = REAL(0.004);
        s->needle_def.membranes = &membrane;
        s->needle_def.membrane_count = 1;
    }
    needles = 1 + draw_one(&d, 2);
    s->needle_def.follow = seed % 2 ? NDL_EMBED : NDL_REMESH;
    if (s->needle_def.follow == NDL_EMBED && !s->other && draw_one(&d, 2))
        s->type = draw_one(&d, 2) ? SB_TET10 : SB_HEX8;
    if (!needle_scene_make_body(s))
        return 0;
    for (int k = 0; k < needles; k++)
        if (!needle_scene_add(s, sb_v3(REAL(-0.009 * k), REAL(0.008 * k), REAL(0.002 * k))))
            return 0;
    if (s->type == SB_TET4 && seed % 3 == 0)
        CHECK_OK(sb_body_keep_tangent(s->body, REAL(0.05), &s->error));
    s->other = NULL;
    s->needle_def.membranes = NULL;
    s->needle_def.membrane_count = 0;
    return 1;
}

/* One random step of all needles: what happens depends on seed and number alone. Failed steps are part of programs. */
static sb_result random_step(needle_scene *s, int seed, int number)
{
    draw d;
    ndl_command commands[NDL_MAX_NEEDLES];
    d.seed = 1000003ull * (unsigned long long)seed + (unsigned long long)number;
    memset(commands, 0, sizeof commands);
    for (int k = 0; k < s->count; k++) {
        int phase = number / 12 % 3; /* in, about, out */
        double speed = phase == 0   ? draw_in(&d, 0.02, 0.09)
                       : phase == 1 ? draw_in(&d, -0.02, 0.02)
                                    : -draw_in(&d, 0.01, 0.1);
        commands[k].insertion = REAL(speed);
        commands[k].twist = REAL(draw_one(&d, 3) == 0 ? draw_in(&d, -3, 3) : 0);
        if (draw_one(&d, 4) == 0)
            commands[k].velocity = sb_v3(REAL(draw_in(&d, -0.005, 0.005)), REAL(draw_in(&d, -0.005, 0.005)), 0);
    }
    if (draw_one(&d, 9) == 0) { /* a tracked sleeve */
        sb_vec3 base = ndl_rod_positions(ndl_needle_rod(s->needles[0]))[1], along;
        ndl_frame frame = ndl_rod_frame(ndl_needle_rod(s->needles[0]), 0);
        along = sb_v3_madd(frame.t, REAL(0.01), frame.m1);
        base = sb_v3_madd(base, REAL(0.0003), frame.m2);
        CHECK_OK(ndl_needle_move_base(s->needles[0], base, along, sb_v3(0, 0, 0)));
    }
    if (draw_one(&d, 9) == 0) {
        int node = draw_one(&d, s->mesh.node_count);
        sb_vec3 force = sb_v3(0, 0, REAL(draw_in(&d, -0.02, 0.02)));
        sb_body_clear_loads(s->body);
        if (sb_body_node_in_use(s->body, node))
            CHECK_OK(sb_body_apply_forces(s->body, &node, 1, &force, 1, NULL));
    }
    return ndl_step(s->body, s->needles, s->count, REAL(0.02), commands, &s->info, &s->error);
}

static void random_steps(needle_scene *s, int seed, int from, int to)
{
    for (int i = from; i < to; i++)
        (void)random_step(s, seed, i);
}

typedef struct image {
    unsigned char *bytes;
    size_t size;
} image;

static image image_of(const needle_scene *s)
{
    image made;
    made.size = sb_body_state_size(s->body);
    made.bytes = (unsigned char *)malloc(made.size);
    CHECK_OK(sb_body_state_save(s->body, made.bytes, made.size));
    return made;
}

/* The bytes of a save are a function of the state. */
static int is_at(const needle_scene *s, const image *expected)
{
    image now = image_of(s);
    int same = now.size == expected->size && memcmp(now.bytes, expected->bytes, now.size) == 0;
    free(now.bytes);
    return same;
}

static int load(needle_scene *s, const image *from)
{
    sb_error error;
    if (CHECK_OK(sb_body_state_load(s->body, from->bytes, from->size, &error)))
        return CHECK(needle_scene_is_sound(s)) && CHECK(is_at(s, from));
    printf("%s\n", error.message);
    return 0;
}

static int is_inside(const needle_scene *s) { return ndl_needle_depth(s->needles[0]) > 0; }

/* ---- continuation ---- */

static void test_continuation(void)
{
    int inside = 0, scenes = check_quick() ? 4 : getenv("CHECK_SLOW") ? 100 : 12;
    for (int seed = 0; seed < scenes; seed++) {
        needle_scene a, b;
        if (!make_scene(&a, seed) || !make_scene(&b, seed))
            return;
        for (int cut = 5 + seed % 7; cut < 36; cut += 11) {
            image start, end;
            unsigned long long bits;
            int stop = cut + 7;
            random_steps(&a, seed, cut > 11 ? cut - 4 : 0, cut);
            inside += is_inside(&a);
            start = image_of(&a);
            CHECK(is_at(&a, &start)); /* saving changes nothing */
            random_steps(&a, seed, cut, stop);
            end = image_of(&a);
            bits = needle_scene_bits(&a);
            if (load(&b, &start)) { /* another body, wherever its needles are */
                random_steps(&b, seed, cut, stop);
                CHECK(is_at(&b, &end) && needle_scene_bits(&b) == bits);
                random_steps(&b, seed + 1, 0, 9); /* and elsewhere from there */
            }
            if (load(&a, &start)) { /* back in its own */
                random_steps(&a, seed, cut, stop);
                CHECK(is_at(&a, &end) && needle_scene_bits(&a) == bits);
            }
            free(start.bytes);
            free(end.bytes);
        }
        needle_scene_free(&a);
        needle_scene_free(&b);
    }
    CHECK(inside >= scenes); /* of three saves of each scene */
}

/* A needle that is drawn out after a load leaves the mesh that the body was made with. */
static void test_withdrawal(void)
{
    needle_scene a = needle_scene_default(), b = needle_scene_default();
    image start, end;
    a.needle_def.bevel.curvature = b.needle_def.bevel.curvature = 8;
    if (!needle_scene_make(&a) || !needle_scene_make(&b))
        return;
    needle_scene_run(&a, 0.02, 20, needle_command(0.05, 1));
    CHECK(!needle_scene_is_original(&a));
    start = image_of(&a);
    needle_scene_run(&a, 0.02, 40, needle_command(-0.05, 0));
    CHECK(needle_scene_is_original(&a));
    end = image_of(&a);
    if (load(&b, &start)) {
        needle_scene_run(&b, 0.02, 40, needle_command(-0.05, 0));
        CHECK(needle_scene_is_original(&b) && is_at(&b, &end));
    }
    free(start.bytes);
    free(end.bytes);
    needle_scene_free(&a);
    needle_scene_free(&b);
}

/* ---- refusals ---- */

static void test_foreign(void)
{
    needle_scene a = needle_scene_default(), b;
    image start, before;
    sb_error error;
    if (!needle_scene_make(&a))
        return;
    needle_scene_run(&a, 0.02, 15, needle_command(0.05, 0));
    start = image_of(&a);
    for (int other = 0; other < 6; other++) {
        b = needle_scene_default();
        b.frictions[0].friction = REAL(other == 0 ? 21 : 20);
        b.needle_def.bevel.curvature = REAL(other == 1 ? 3 : 0);
        b.needle_def.length = REAL(other == 2 ? 0.045 : 0.05); /* another shape of the same rod may be loaded, */
        b.needle_def.capacity = other == 3 ? 24 : 128;         /* and where there is room */
        if (other == 5 ? !needle_scene_make_body(&b) : !needle_scene_make(&b))
            break;
        if (other == 4)
            needle_scene_add(&b, sb_v3(REAL(-0.009), 0, 0));
        if (other < 4)
            needle_scene_run(&b, 0.02, 13, needle_command(0.05, 0));
        before = image_of(&b);
        if (other == 2 || other == 3) {
            (void)load(&b, &start);
        } else {
            CHECK_RESULT(sb_body_state_load(b.body, start.bytes, start.size, &error), SB_ERROR_STATE);
            CHECK(error.message[0] && is_at(&b, &before));
            CHECK(other == 5 || needle_scene_is_sound(&b));
        }
        free(before.bytes);
        needle_scene_free(&b);
    }
    free(start.bytes);
    needle_scene_free(&a);
}

/* Sealed images whose part of needles has other words: refused with a word and nothing changed, or what is taken
 * steps. */
static void forge(ndl_follow follow)
{
    const uint32_t values[6] = {0xFFFFFFFFu, 0x7FFFFFFFu, 0, 1, 0x7FF00000u, 0x40000000u};
    needle_scene s = needle_scene_default();
    image start;
    unsigned char *copy;
    size_t part, stride = getenv("CHECK_SLOW") ? 4 : check_quick() ? 116 : 28;
    int refused = 0, taken = 0;
    check_bad_numbers();
    s.cells[0] = s.cells[1] = s.cells[2] = 2;
    s.needle_def.follow = follow;
    if (!needle_scene_make(&s))
        return;
    needle_scene_run(&s, 0.02, 18, needle_command(0.05, 0.5));
    start = image_of(&s);
    copy = (unsigned char *)malloc(start.size);
    for (part = start.size - 8; part > 0 && memcmp(start.bytes + part, "needles", 8) != 0;)
        part--;
    CHECK(part > 0);
    for (size_t at = part; at + 12 <= start.size; at += at < part + 420 ? 4 : stride)
        for (int k = 0; k < 6; k++) {
            sb_error error;
            memcpy(copy, start.bytes, start.size);
            image_put(copy + at, values[k], 4);
            if (memcmp(copy, start.bytes, start.size) == 0)
                continue;
            image_seal(copy, start.size);
            error.message[0] = 0;
            if (sb_body_state_load(s.body, copy, start.size, &error) != SB_OK) {
                refused++;
                CHECK(error.message[0]);
                if (k == 0)
                    CHECK(is_at(&s, &start));
                continue;
            }
            taken++;
            for (int i = 0; i < 2; i++) {
                ndl_command command = needle_command(0.03, 0);
                (void)ndl_step(s.body, s.needles, 1, REAL(0.02), &command, NULL, NULL); /* numbers may be anything */
            }
            CHECK_OK(sb_body_state_load(s.body, start.bytes, start.size, NULL));
        }
    CHECK(refused > 100);
    printf("needles: %d refused, %d taken\n", refused, taken);
    CHECK(is_at(&s, &start) && needle_scene_is_sound(&s));
    free(copy);
    free(start.bytes);
    needle_scene_free(&s);
}

static void test_forgeries(void)
{
    forge(NDL_REMESH);
    forge(NDL_EMBED);
}

static void test_memory(void)
{
    needle_scene a = needle_scene_default();
    image start;
    int done = 0, fail;
    a.body_def.slack = REAL(0.01);
    a.cells[0] = a.cells[1] = a.cells[2] = 2;
    if (!needle_scene_make(&a))
        return;
    needle_scene_run(&a, 0.02, 18, needle_command(0.05, 0));
    start = image_of(&a);
    for (fail = 1; !done && fail < 400; fail++) {
        needle_scene b = needle_scene_default();
        scene_memory memory;
        image before;
        memset(&memory, 0, sizeof memory);
        b.body_def.slack = REAL(0.01);
        b.cells[0] = b.cells[1] = b.cells[2] = 2;
        b.body_def.allocator = b.needle_def.allocator = scene_allocator(&memory);
        if (!needle_scene_make(&b))
            break;
        before = image_of(&b);
        memory.fail_at = memory.calls + fail;
        done = sb_body_state_load(b.body, start.bytes, start.size, NULL) == SB_OK;
        memory.fail_at = 0;
        if (!done) {
            CHECK(is_at(&b, &before) && needle_scene_is_sound(&b));
            done = !load(&b, &start);
        }
        CHECK(is_at(&b, &start));
        free(before.bytes);
        needle_scene_free(&b);
        CHECK_INT(memory.live, 0);
    }
    CHECK(fail > 8 && fail < 400);
    free(start.bytes);
    needle_scene_free(&a);
}

/* ---- recordings ---- */

static void test_recordings(void)
{
    int scenes = check_quick() ? 3 : getenv("CHECK_SLOW") ? 60 : 8;
    for (int seed = 20; seed < 20 + scenes; seed++) {
        needle_scene a, b;
        sb_recording *recording = NULL;
        sb_recording_report report;
        image end;
        int begin = seed % 2 ? 8 : 0;
        if (!make_scene(&a, seed) || !make_scene(&b, seed))
            return;
        random_steps(&a, seed, 0, begin);
        CHECK_OK(sb_recording_start(a.body, 5, NULL, &recording, NULL));
        random_steps(&a, seed, begin, 34);
        sb_recording_stop(recording);
        end = image_of(&a);
        CHECK_INT(sb_recording_get_info(recording).steps, 34 - begin);
        random_steps(&b, seed + 1, 0, seed % 5); /* it may have been used */
        if (!CHECK_OK(sb_recording_replay(recording, b.body, &report)))
            printf("scene %d, step %d: %s\n", seed, report.step, report.error.message);
        CHECK(is_at(&b, &end) && needle_scene_is_sound(&b));
        CHECK_OK(sb_recording_replay(recording, a.body, &report));
        CHECK(is_at(&a, &end));
        free(end.bytes);
        sb_recording_destroy(recording);
        needle_scene_free(&a);
        needle_scene_free(&b);
    }
}

/* Needles that come or go while the body is recorded are named when it is played. */
static void test_lives(void)
{
    for (int gone = 0; gone < 2; gone++) {
        needle_scene a = needle_scene_default(), b = needle_scene_default();
        sb_recording *recording = NULL;
        sb_recording_report report;
        if (!needle_scene_make(&a) || !needle_scene_make(&b))
            return;
        needle_scene_run(&a, 0.02, 12, needle_command(0.05, 0));
        CHECK_OK(sb_recording_start(a.body, 0, NULL, &recording, NULL));
        needle_scene_run(&a, 0.02, 2, needle_command(0.05, 0));
        if (gone) {
            ndl_needle_destroy(a.needles[0]);
            a.count = 0;
            CHECK_OK(sb_body_step(a.body, REAL(0.02), NULL));
        } else {
            needle_scene_add(&a, sb_v3(REAL(-0.01), REAL(0.008), 0));
            needle_scene_run(&a, 0.02, 2, needle_command(0.05, 0));
        }
        sb_recording_stop(recording);
        CHECK_RESULT(sb_recording_replay(recording, b.body, &report), SB_ERROR_UNSUPPORTED);
        CHECK(strstr(report.error.message, gone ? "destroyed" : "made") != NULL);
        CHECK_INT(report.steps, 2);
        CHECK(needle_scene_is_sound(&b));
        sb_recording_destroy(recording);
        needle_scene_free(&a);
        needle_scene_free(&b);
    }
}

CHECK_SUITE(needle_state, {"continuation", test_continuation}, {"withdrawal", test_withdrawal},
            {"another's state", test_foreign}, {"forgeries", test_forgeries}, {"every allocation failing", test_memory},
            {"recordings", test_recordings}, {"needles that come and go", test_lives});
