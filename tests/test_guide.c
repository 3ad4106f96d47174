/* Straight paths past tissue that is pushed aside: tissue whose displacements are known in closed form, scenes that
 * nobody chose, and plans that are carried out. */
#include "check.h"
#include "needle.h"
#include "scene.h"

static const double pi = 3.14159265358979;

enum { PLACES = 8, MOST_OBSTACLES = 3 };

/* Kelvin: a force in an infinite medium. */
typedef struct tissue {
    double shear, poisson;
    sb_vec3 at[PLACES]; /* m, where forces act */
    int calls, refuses; /* refuses: this place cannot be told of, or -1 */
    double wrong;       /* factor */
} tissue;

static int follow(void *user, sb_vec3 point, int place, sb_mat3 *compliance)
{
    tissue *t = (tissue *)user;
    sb_vec3 d = sb_v3_sub(point, t->at[place]);
    double r = (double)sb_v3_norm(d) + 1e-4, k = t->wrong / (16 * pi * t->shear * (1 - t->poisson) * r);
    double x[3] = {(double)d.x, (double)d.y, (double)d.z};
    t->calls++;
    if (place == t->refuses)
        return 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            compliance->m[i][j] = REAL(k * ((i == j ? 3 - 4 * t->poisson : 0) + x[i] * x[j] / (r * r)));
    return 1;
}

typedef struct setting {
    tissue soft;
    ndl_push_place places[PLACES];
    ndl_obstacle obstacles[MOST_OBSTACLES];
    ndl_guide_def def;
} setting;

/* A target 8 cm below an entry at the origin; fingers round about that push inwards. */
static void setting_begin(setting *s)
{
    memset(s, 0, sizeof *s);
    s->soft.shear = 1500, s->soft.poisson = 0.45, s->soft.refuses = -1, s->soft.wrong = 1;
    for (int k = 0; k < PLACES; k++) {
        double angle = 2 * pi * k / (int)PLACES;
        s->soft.at[k] = sb_v3(REAL(0.05 * cos(angle)), REAL(0.05 * sin(angle)), REAL(k % 2 ? -0.04 : -0.07));
        s->places[k].direction = sb_v3(REAL(-cos(angle)), REAL(-sin(angle)), 0);
        s->places[k].cone = REAL(0.6);
        s->places[k].max_force = 8;
        s->places[k].weight = 1;
    }
    s->def = ndl_default_guide_def(sb_v3(0, 0, REAL(-0.08)), sb_v3(0, 0, 0), sb_v3(0, 0, -1));
    s->def.obstacles = s->obstacles;
    s->def.places = s->places;
    s->def.place_count = PLACES;
    s->def.model = follow;
    s->def.user = &s->soft;
    s->def.clearance = REAL(0.002);
    s->def.tolerance = REAL(0.0005);
    s->def.samples = 60, s->def.climbs = 40;
}

static void add_sphere(setting *s, double x, double y, double z, double radius)
{
    ndl_obstacle *o = s->obstacles + s->def.obstacle_count++;
    o->kind = NDL_OBSTACLE_SPHERE;
    o->a = sb_v3(REAL(x), REAL(y), REAL(z));
    o->radius = REAL(radius);
}

/* A vessel across the whole entry. */
static void add_vessel(setting *s, double aside, double z, double radius)
{
    ndl_obstacle *o = s->obstacles + s->def.obstacle_count++;
    o->kind = NDL_OBSTACLE_CAPSULE;
    o->a = sb_v3(REAL(-0.03), REAL(aside), REAL(z));
    o->b = sb_v3(REAL(0.03), REAL(aside), REAL(z));
    o->radius = REAL(radius);
}

/* Displacement of a point by forces at all places. */
static sb_vec3 moved(const setting *s, sb_vec3 point, const sb_vec3 *forces)
{
    tissue soft = s->soft;
    sb_vec3 sum = sb_v3(0, 0, 0);
    sb_mat3 c;
    soft.refuses = -1;
    for (int k = 0; k < PLACES; k++)
        if (follow(&soft, point, k, &c))
            sum = sb_v3_add(sum, sb_m3_apply(c, forces[k]));
    return sum;
}

static double from_line(const ndl_guide *g, sb_vec3 x, double *along)
{
    sb_vec3 d = sb_v3_sub(x, g->entry);
    *along = (double)sb_v3_dot(d, g->direction);
    return (double)sb_v3_norm(sb_v3_madd(d, REAL(-*along), g->direction));
}

/* Nearest that the displaced skin of an obstacle comes to the needle. */
static double nearest(const setting *s, const ndl_guide *g, const ndl_obstacle *o, const sb_vec3 *forces)
{
    double least = 1e9;
    int steps = o->kind == NDL_OBSTACLE_CAPSULE ? 120 : 0;
    for (int k = 0; k <= steps; k++)
        for (int i = 0; i < 400; i++) {
            double z = (2 * i + 1) / 400.0 - 1, turn = 2.399963 * i, flat = sqrt(1 - z * z), along, off;
            sb_vec3 x = o->a, n = sb_v3(REAL(flat * cos(turn)), REAL(flat * sin(turn)), REAL(z));
            if (steps)
                x = sb_v3_madd(o->a, REAL((double)k / steps), sb_v3_sub(o->b, o->a));
            x = sb_v3_madd(x, o->radius, n);
            off = from_line(g, sb_v3_add(x, moved(s, x, forces)), &along);
            if (along > 0 && along < (double)g->length)
                least = fmin(least, off);
        }
    return least;
}

static void forces_of(const ndl_guide *g, sb_vec3 *forces)
{
    for (int k = 0; k < PLACES; k++)
        forces[k] = sb_v3(0, 0, 0);
    for (int k = 0; k < g->phase_count; k++)
        if (g->phases[k].place >= 0)
            forces[g->phases[k].place] = g->phases[k].force;
}

/* What a plan says is so, by other means; slack: m of obstacles' distance. */
static void check_plan(const setting *s, const ndl_guide *g, const sb_vec3 *forces, double slack)
{
    const ndl_guide_phase *last = g->phases + g->phase_count - 1;
    double along, off = from_line(g, sb_v3_add(s->def.target, moved(s, s->def.target, forces)), &along);
    CHECK(last->obstacle < 0);
    CHECK_NEAR(sb_v3_norm(g->direction), 1, 1e-5);
    if (!g->reaches)
        return;
    CHECK(off < (double)s->def.tolerance + slack);
    CHECK_NEAR(along, (double)g->length, 1e-4);
    for (int i = 0; i < s->def.obstacle_count; i++)
        if (!CHECK(nearest(s, g, s->obstacles + i, forces) > (double)(s->def.clearance - s->def.tolerance) - slack))
            printf("obstacle %d is %.2f mm from the needle\n", i, 1e3 * nearest(s, g, s->obstacles + i, forces));
}

static void check_forces(const setting *s, const ndl_guide *g)
{
    int used[PLACES] = {0};
    double cost = 0;
    for (int k = 0; k < g->phase_count; k++) {
        const ndl_guide_phase *phase = g->phases + k;
        double force = (double)sb_v3_norm(phase->force), along;
        if (phase->place < 0) {
            CHECK(force == 0);
            continue;
        }
        along = (double)sb_v3_dot(phase->force, s->places[phase->place].direction);
        CHECK(force <= (double)s->places[phase->place].max_force * (1 + 1e-5));
        CHECK(along >= force * (cos((double)s->places[phase->place].cone) - 1e-5));
        CHECK(!used[phase->place]);
        used[phase->place] = 1;
        cost += force * (double)s->places[phase->place].weight;
    }
    CHECK_NEAR((double)g->cost, cost, 1e-5 * (1 + cost));
}

static void test_free(void)
{
    setting s;
    ndl_guide g;
    setting_begin(&s);
    add_sphere(&s, 0.01, 0, -0.04, 0.005);
    CHECK_OK(ndl_guide_make(&s.def, &g, NULL));
    CHECK_INT(g.reaches, 1);
    CHECK_INT(g.phase_count, 1);
    CHECK(g.cost == 0 && g.phases[0].place < 0);
    CHECK_NEAR(g.direction.z, -1, 1e-6);
    CHECK_NEAR(g.length, 0.08, 1e-6);
    CHECK_NEAR(g.clearance, 0.005, 1e-4);
    add_sphere(&s, 0, 0, -0.02, 0.0025); /* now on the straight path, but not on others */
    CHECK_OK(ndl_guide_make(&s.def, &g, NULL));
    CHECK_INT(g.reaches, 1);
    CHECK(g.cost < 2);
}

/* No straight path avoids a vessel across the entry; one that is pushed aside lets the needle pass. */
static void test_vessel(void)
{
    setting s;
    ndl_guide g, none, again;
    sb_vec3 forces[PLACES];
    setting_begin(&s);
    s.def.entry_radius = REAL(0.002), s.def.shift = REAL(0.001);
    add_vessel(&s, 0.0018, -0.05, 0.002);
    s.def.place_count = 0;
    CHECK_OK(ndl_guide_make(&s.def, &none, NULL));
    CHECK_INT(none.reaches, 0);
    CHECK(none.clearance < s.def.clearance - s.def.tolerance);
    s.def.place_count = PLACES;
    CHECK_OK(ndl_guide_make(&s.def, &g, NULL));
    CHECK_OK(ndl_guide_make(&s.def, &again, NULL));
    CHECK(memcmp(&g, &again, sizeof g) == 0);
    CHECK_INT(g.reaches, 1);
    CHECK((double)g.cost > 0.1);
    CHECK_INT(g.phase_count, 2);
    CHECK_INT(g.phases[0].obstacle, 0);
    CHECK(g.phases[0].place >= 0);
    check_forces(&s, &g);
    forces_of(&g, forces);
    check_plan(&s, &g, forces, 2e-4);
    printf("a vessel: %.2f N in %d phases, %.2f mm clear, the target %.2f mm off\n", (double)g.cost, g.phase_count,
           1e3 * (double)g.clearance, 1e3 * (double)g.phases[1].left);
}

static void make_random(setting *s, unsigned long long *seed)
{
    int count = 1 + (int)(check_random(seed) * (int)MOST_OBSTACLES);
    setting_begin(s);
    s->def.entry_radius = REAL(check_random_in(seed, 0.001, 0.006));
    s->def.shift = REAL(check_random_in(seed, 0, 0.004));
    s->def.seed = (unsigned)(1e6 * check_random(seed));
    for (int i = 0; i < count; i++) {
        double z = check_random_in(seed, -0.065, -0.02), radius = check_random_in(seed, 0.0015, 0.005);
        if (check_random(seed) < 0.5)
            add_vessel(s, check_random_in(seed, -0.006, 0.006), z, 0.6 * radius);
        else
            add_sphere(s, check_random_in(seed, -0.006, 0.006), check_random_in(seed, -0.006, 0.006), z, radius);
    }
}

/* More paths never make it worse, and what a plan says holds. */
static void test_random(void)
{
    unsigned long long seed = 12122;
    int reached = 0, pushed = 0, bare = 0, count = check_quick() ? 6 : 40;
    for (int i = 0; i < count; i++) {
        setting s;
        ndl_guide few, more, g;
        sb_vec3 forces[PLACES];
        make_random(&s, &seed);
        s.def.samples = 8, s.def.climbs = 0;
        CHECK_OK(ndl_guide_make(&s.def, &few, NULL));
        s.def.samples = 60;
        CHECK_OK(ndl_guide_make(&s.def, &more, NULL));
        s.def.climbs = 40;
        CHECK_OK(ndl_guide_make(&s.def, &g, NULL));
        CHECK(g.reaches >= more.reaches && more.reaches >= few.reaches);
        CHECK(!few.reaches || more.cost <= few.cost);
        CHECK(!more.reaches || g.cost <= more.cost);
        check_forces(&s, &g);
        forces_of(&g, forces);
        check_plan(&s, &g, forces, 3e-4);
        reached += g.reaches;
        pushed += g.reaches && g.cost > 0;
        s.def.place_count = 0;
        CHECK_OK(ndl_guide_make(&s.def, &g, NULL));
        bare += g.reaches;
    }
    printf("%d of %d random targets reached, %d with pushes; without a manipulator %d\n", reached, count, pushed, bare);
    CHECK(reached > bare && reached >= (count * 8) / 10);
}

/* All phases carried out by the controller in tissue that gives way 1.4 times as much as the model says: the needle
 * still passes, with other forces. */
static void test_carried_out(void)
{
    unsigned long long seed = 771;
    int done = 0, clear = 0, count = check_quick() ? 4 : 20;
    for (int i = 0; i < count; i++) {
        setting s;
        ndl_guide g;
        sb_vec3 forces[PLACES];
        ndl_push push[NDL_GUIDE_PHASES];
        double least = 1;
        make_random(&s, &seed);
        CHECK_OK(ndl_guide_make(&s.def, &g, NULL));
        if (!g.reaches || g.cost == 0)
            continue;
        s.soft.wrong = 1.4;
        for (int k = 0; k < PLACES; k++)
            forces[k] = sb_v3(0, 0, 0);
        for (int k = 0; k < g.phase_count; k++)
            if (g.phases[k].place >= 0)
                CHECK_OK(ndl_push_begin(&g.phases[k].push, push + k, NULL));
        for (int last = 0; last < g.phase_count; last++) /* those before go on */
            for (int n = 0; n < 400 && g.phases[last].place >= 0; n++)
                for (int k = 0; k <= last; k++) {
                    const ndl_guide_phase *phase = g.phases + k;
                    if (phase->place >= 0)
                        CHECK_OK(ndl_push_update(push + k, sb_v3_add(phase->point, moved(&s, phase->point, forces)),
                                                 REAL(0.05), forces + phase->place));
                }
        for (int k = 0; k < g.phase_count; k++)
            if (g.phases[k].place >= 0)
                least = push[k].arrived ? least : -1;
        for (int o = 0; o < s.def.obstacle_count; o++)
            least = fmin(least, nearest(&s, &g, s.obstacles + o, forces));
        clear += least > (double)(s.def.clearance - s.def.tolerance) - 3e-4;
        done++;
    }
    printf("%d plans carried out, in %d all arrived and all was clear\n", done, clear);
    CHECK(done > count / 4);
    CHECK(clear >= done / 4); /* a push that goes on past what the plan had of it takes others beyond their limits */
}

static int not_a_number(void *user, sb_vec3 point, int place, sb_mat3 *compliance)
{
    int result = follow(user, point, place, compliance);
    compliance->m[1][1] = REAL(HUGE_VAL) - REAL(HUGE_VAL);
    return result;
}

static sb_real no_distance(void *user, sb_vec3 point)
{
    (void)user;
    return point.z > REAL(-0.03) ? (sb_real)1 : (sb_real)NAN;
}

static void test_refusals(void)
{
    setting s;
    ndl_guide g, kept;
    sb_error error;
    check_bad_numbers();
    memset(&g, 7, sizeof g);
    kept = g;
    setting_begin(&s);
    s.def.entry_radius = REAL(0.002), s.def.shift = 0;
    add_vessel(&s, 0, -0.05, 0.002);
    s.def.model = not_a_number;
    CHECK_RESULT(ndl_guide_make(&s.def, &g, &error), SB_ERROR_NOT_FINITE);
    s.def.model = NULL;
    CHECK_RESULT(ndl_guide_make(&s.def, &g, &error), SB_ERROR_ARGUMENT);
    s.def.model = follow;
    s.places[3].max_force = 0;
    CHECK_RESULT(ndl_guide_make(&s.def, &g, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "place 3") != NULL);
    s.places[3].max_force = SB_REAL_MAX;
    CHECK_RESULT(ndl_guide_make(&s.def, &g, &error), SB_ERROR_ARGUMENT);
    s.places[3].max_force = 8;
    s.obstacles[0].radius = -1;
    CHECK_RESULT(ndl_guide_make(&s.def, &g, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "obstacle 0") != NULL);
    s.obstacles[0].radius = REAL(0.002);
    s.def.direction = sb_v3(0, 0, 1); /* away from the target */
    CHECK_RESULT(ndl_guide_make(&s.def, &g, &error), SB_ERROR_ARGUMENT);
    s.def.direction = sb_v3(1, 0, REAL(-0.2));
    CHECK_RESULT(ndl_guide_make(&s.def, &g, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "max_lean") != NULL);
    s.def.direction = sb_v3(0, 0, -1);
    s.def.samples = 0;
    CHECK_RESULT(ndl_guide_make(&s.def, &g, &error), SB_ERROR_ARGUMENT);
    s.def.samples = 20;
    s.def.cookie = 0;
    CHECK_RESULT(ndl_guide_make(&s.def, &g, &error), SB_ERROR_ARGUMENT);
    CHECK(memcmp(&g, &kept, sizeof g) == 0);
}

/* Where an obstacle's distance is no number it is in the way. */
static void test_no_distance(void)
{
    setting s;
    ndl_guide g;
    sb_shape shape;
    check_bad_numbers();
    memset(&shape, 0, sizeof shape);
    shape.distance = no_distance;
    shape.max_slope = 1;
    setting_begin(&s);
    s.def.entry_radius = REAL(0.002), s.def.shift = 0;
    add_vessel(&s, 0, -0.05, 0.002);
    s.obstacles[0].kind = NDL_OBSTACLE_SHAPE;
    s.obstacles[0].shape = &shape;
    CHECK_OK(ndl_guide_make(&s.def, &g, NULL));
    CHECK(!g.reaches && g.clearance < 0);
}

/* A place that the model cannot tell of is not used. */
static void test_unknown(void)
{
    setting s;
    ndl_guide g;
    setting_begin(&s);
    s.def.entry_radius = REAL(0.002), s.def.shift = 0;
    add_vessel(&s, 0, -0.05, 0.002);
    CHECK_OK(ndl_guide_make(&s.def, &g, NULL));
    s.soft.refuses = g.phases[0].place;
    CHECK_OK(ndl_guide_make(&s.def, &g, NULL));
    for (int k = 0; k < g.phase_count; k++)
        CHECK(g.phases[k].place != s.soft.refuses);
}

CHECK_SUITE(guide, {"a free path", test_free}, {"a vessel in the way", test_vessel}, {"random scenes", test_random},
            {"plans carried out", test_carried_out}, {"refusals", test_refusals}, {"no distance", test_no_distance},
            {"unknown places", test_unknown});
