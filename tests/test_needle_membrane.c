/* Membranes that needles puncture: what a hand feels of them depends on neither the time step nor the speed, although a
 * step may be longer than a membrane is thick. */
#include "needle_scene.h"

/* A block in two layers with a skin and a membrane between the layers, drawn by the seed. */
typedef struct membrane_case {
    ndl_membrane membranes[2];
    double speed;
} membrane_case;

static needle_scene membrane_scene(membrane_case *c, ndl_follow follow, unsigned long long *seed)
{
    needle_scene s = needle_scene_default();
    for (int i = 0; i < 2; i++) {
        c->membranes[i].regions[0] = i - 1, c->membranes[i].regions[1] = i;
        c->membranes[i].strength = REAL(0.5 + 2 * check_random(seed));
        c->membranes[i].thickness = REAL(0.0001 * pow(20, check_random(seed)));
        s.materials[i].young = REAL(45000 + 40000 * check_random(seed));
        s.frictions[i].friction = 20;
        s.frictions[i].cutting = REAL(0.5);
    }
    c->speed = 0.005 * pow(20, check_random(seed));
    s.layered = 1;
    s.needle_def.follow = follow;
    s.body_def.slack = follow == NDL_EMBED ? 0 : REAL(0.5);
    s.needle_def.membranes = follow == NDL_EMBED ? c->membranes : c->membranes + 1; /* remeshing at a skin that is */
    s.needle_def.membrane_count = follow == NDL_EMBED ? 2 : 1; /* hard to enter adds forces of its own */
    s.needle_def.length = REAL(0.07);
    s.needle_def.base.z = REAL(0.111);
    s.needle_def.base.x += REAL(0.004 * check_random(seed));
    return s;
}

/* The needle comes at an angle of up to 40 degrees, 1 mm before the skin. */
static void tilt_needle(needle_scene *s, unsigned long long *seed)
{
    double tilt = 0.7 * check_random(seed), turn = 6.28 * check_random(seed);
    double across = sin(tilt), along = cos(tilt), to_skin = 0.071 + 0.01 / along;
    s->needle_def.direction = sb_v3(REAL(across * cos(turn)), REAL(across * sin(turn)), REAL(-along));
    s->needle_def.director = sb_v3(REAL(along * cos(turn)), REAL(along * sin(turn)), REAL(across));
    s->needle_def.base = sb_v3_madd(sb_v3(REAL(0.02), REAL(0.02), REAL(0.03)), REAL(-to_skin), s->needle_def.direction);
}

/* Largest force beside friction about the skin and about the membrane below (N), as the needle goes on. */
static void find_peaks(needle_scene *s, double speed, double dt, double peaks[2])
{
    double depth = 0, gone = 0;
    sb_vec3 X = sb_v3(0, 0, 1);
    peaks[0] = peaks[1] = 0;
    for (; gone < 0.036; gone += speed * dt) {
        int lower = X.z < REAL(0.03);
        double push;
        if (!needle_scene_run(s, dt, 1, needle_command(speed, 0)))
            return;
        if (depth == 0 && s->needle_def.membrane_count == 1) /* there is no skin to come to */
            CHECK(s->info.substeps <= 1 + (int)(speed * dt / 0.0025));
        CHECK(s->info.substeps < 10); /* up to two edges for each membrane, and a try or two before each */
        push = (double)s->info.peak_base - 20 * depth;
        peaks[lower] = fmax(peaks[lower], push);
        (void)ndl_needle_tip_material(s->needles[0], &X);
        depth = (double)ndl_needle_depth(s->needles[0]);
        if (X.z < REAL(0.012)) /* the skin below is near */
            return;
        CHECK(s->info.peak_base >= REAL(0.999) * REAL(fabs(needle_push(s))));
    }
}

/* The peaks are what the law asks for, with steps in which the needle would run through. */
static void check_peaks(ndl_follow follow, int tilted, unsigned long long seed, double dt)
{
    membrane_case c;
    needle_scene s = membrane_scene(&c, follow, &seed);
    double peaks[2];
    if (tilted)
        tilt_needle(&s, &seed);
    if (needle_scene_make(&s)) {
        find_peaks(&s, c.speed, dt, peaks);
        for (int i = follow == NDL_EMBED ? 0 : 1; i < 2; i++) {
            double law = 0.5 + (double)c.membranes[i].strength;
            if (!CHECK_NEAR(peaks[i], law, 0.1 * law))
                printf("    membrane %d of %g mm, %g mm/s, dt %g ms\n", i, 1e3 * (double)c.membranes[i].thickness,
                       1e3 * c.speed, 1e3 * dt);
        }
    }
    needle_scene_free(&s);
}

static void test_embedded(void)
{
    static const double dts[] = {0.05, 0.02, 0.01, 0.005};
    for (int k = 0; k < check_rounds(12); k++)
        check_peaks(NDL_EMBED, 0, 700 + (unsigned)k, dts[k % 4]);
}

static void test_oblique(void)
{
    static const double dts[] = {0.05, 0.02, 0.01, 0.005};
    for (int k = 0; k < check_rounds(12); k++)
        check_peaks(NDL_EMBED, 1, 9000 + (unsigned)k, dts[k % 4]);
}

/* Layers that take different forces to cut meet within the membrane: its peak is that of the harder one, whichever
 * that is, however long the steps are. */
static void test_between_layers(void)
{
    static const double dts[] = {0.05, 0.02, 0.005, 0.01};
    for (int k = 0; k < check_rounds(16); k++) {
        unsigned long long seed = 600 + (unsigned)(k / 2);
        membrane_case c;
        needle_scene s = membrane_scene(&c, NDL_EMBED, &seed);
        double peaks[2], law;
        s.frictions[0].cutting = REAL(check_random_in(&seed, 0.2, 1.5));
        s.frictions[1].cutting = REAL(check_random_in(&seed, 0.2, 1.5));
        c.membranes[1].thickness = REAL(check_random_in(&seed, 0.0002, 0.003));
        if (k % 2)
            tilt_needle(&s, &seed);
        if (needle_scene_make(&s)) {
            find_peaks(&s, c.speed, dts[k / 2 % 4], peaks);
            law = fmax((double)s.frictions[0].cutting, (double)s.frictions[1].cutting);
            law += (double)c.membranes[1].strength;
            if (!CHECK_NEAR(peaks[1], law, 0.1 * law))
                printf("    %g and %g N, %g mm, %g mm/s, dt %g ms\n", (double)s.frictions[0].cutting,
                       (double)s.frictions[1].cutting, 1e3 * (double)c.membranes[1].thickness, 1e3 * c.speed,
                       1e3 * dts[k / 2 % 4]);
        }
        needle_scene_free(&s);
    }
}

static void test_remeshed(void)
{
    static const double dts[] = {0.05, 0.02, 0.01};
    for (int k = 0; k < check_rounds(6); k++)
        check_peaks(NDL_REMESH, 0, 800 + (unsigned)k, dts[k % 3]);
}

/* One scene at four steps: the same peaks. */
static void test_steps(void)
{
    static const double dts[] = {0.05, 0.02, 0.005, 0.002};
    double least[2] = {1e9, 1e9}, most[2] = {0, 0};
    for (int k = 0; k < 4; k++) {
        unsigned long long seed = 41;
        membrane_case c;
        needle_scene s = membrane_scene(&c, NDL_EMBED, &seed);
        double peaks[2];
        if (!needle_scene_make(&s))
            return;
        find_peaks(&s, 0.05, dts[k], peaks);
        for (int i = 0; i < 2; i++) {
            least[i] = fmin(least[i], peaks[i]);
            most[i] = fmax(most[i], peaks[i]);
        }
        needle_scene_free(&s);
    }
    CHECK(most[0] < 1.06 * least[0] && most[1] < 1.06 * least[1]);
}

/* Divided are only steps that take a tip past an edge of a membrane by more than a quarter of its thickness, as where
 * one gives way and the tip jumps; and membranes are felt as much. */
static void test_whole_steps(void)
{
    unsigned long long seed = 43;
    membrane_case c;
    needle_scene s = membrane_scene(&c, NDL_EMBED, &seed);
    const double thickness = 0.002;
    sb_vec3 X = sb_v3(0, 0, s.size.z);
    double peak = 0;
    int divided = 0;
    c.membranes[0].thickness = c.membranes[1].thickness = REAL(thickness);
    if (needle_scene_make(&s))
        while (X.z > REAL(0.014) && needle_scene_run(&s, 0.02, 1, needle_command(0.01, 0))) {
            sb_vec3 before = X;
            peak = fmax(peak, (double)s.info.peak_base - 20 * (double)ndl_needle_depth(s.needles[0]));
            if (ndl_needle_depth(s.needles[0]) > 0)
                (void)ndl_needle_tip_material(s.needles[0], &X);
            divided += s.info.substeps > 1;
            CHECK(s.info.substeps == 1 || (double)(before.z - X.z) > 0.25 * thickness);
        }
    needle_scene_free(&s);
    CHECK(divided <= 1);
    CHECK_NEAR(peak, 0.5 + fmax((double)c.membranes[0].strength, (double)c.membranes[1].strength), 0.1 * peak);
}

/* Steps that are divided at a membrane after the mesh has followed the tip in them are taken back so far, and no
 * further: that takes no memory while the mesh keeps to its slack. Counts the divided ones in which the mesh changed.
 */
static int check_no_memory(unsigned long long seed, double dt)
{
    membrane_case c;
    needle_scene s = membrane_scene(&c, NDL_REMESH, &seed);
    scene_memory memory = {0, 0, 0, 0};
    sb_vec3 X = sb_v3(0, 0, 1);
    int divided = 0;
    s.cells[0] = s.cells[1] = 6;
    s.body_def.allocator = s.needle_def.allocator = scene_allocator(&memory);
    if (needle_scene_make(&s)) {
        memory.calls = 0;
        for (double gone = 0; gone < 0.036 && X.z > REAL(0.012); gone += 0.05 * dt) {
            if (!needle_scene_run(&s, dt, 1, needle_command(0.05, 0)))
                break;
            CHECK_INT(memory.calls, 0);
            memory.calls = 0;
            divided += s.info.substeps > 2 && s.info.operations > 0;
            (void)ndl_needle_tip_material(s.needles[0], &X);
        }
    }
    needle_scene_free(&s);
    CHECK_INT(memory.live, 0);
    return divided;
}

static void test_memory(void)
{
    int divided = 0;
    for (int k = 0; k < check_rounds(4); k++)
        divided += check_no_memory(800 + (unsigned)k, k % 2 ? 0.05 : 0.02);
    CHECK(divided > 0);
}

/* Two needles that come to membranes in the same step, at different times; and a base that is moved there. */
static void test_two_needles(void)
{
    unsigned long long seed = 42;
    membrane_case c;
    needle_scene s = membrane_scene(&c, NDL_EMBED, &seed);
    double most[2] = {0, 0};
    if (!needle_scene_make(&s) || !needle_scene_add(&s, sb_v3(REAL(0.006), REAL(-0.005), REAL(0.0007))))
        return;
    for (int i = 0; i < 30; i++) {
        int limited = s.info.limited;
        sb_vec3 force;
        if (!needle_scene_run(&s, 0.02, 1, needle_command(0.04, 0)))
            break;
        CHECK(!limited);
        most[0] = fmax(most[0], (double)s.info.peak_base);
        for (int k = 0; k < 2; k++) {
            ndl_needle_base_wrench(s.needles[k], &force, NULL);
            most[1] = fmax(most[1], (double)sb_v3_norm(force));
            CHECK_NEAR(ndl_needle_fed(s.needles[k]), 0.04 * 0.02 * (i + 1), scene_tolerance(1e-12, 1e7));
        }
    }
    CHECK(most[0] >= most[1] * 0.999);
    CHECK(ndl_needle_depth(s.needles[0]) > REAL(0.015) && ndl_needle_depth(s.needles[1]) > REAL(0.015));
    needle_scene_free(&s);
}

CHECK_SUITE(needle_membrane, {"embedded", test_embedded}, {"oblique", test_oblique},
            {"between layers", test_between_layers}, {"remeshed", test_remeshed}, {"steps", test_steps},
            {"whole steps", test_whole_steps}, {"no memory", test_memory}, {"two needles", test_two_needles});
