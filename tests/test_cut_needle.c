/* Needles and the lips of cuts: a needle waits in a block, or goes in later; planes and strokes cross its way at any
 * angle, before it goes in, while it is in, or both; then it is drawn out. Nothing is lost, what is drawn is closed,
 * forces on block and needle balance at rest, and the needle comes out of all that it went through.
 *
 * CHECK_SLOW=n: n times as many. CUT_NEEDLE=n runs scene n alone. */
#include "cut_drawing.h"
#include "needle_scene.h"
#include "random_case.h"

static const double dt = 0.02, speed = 0.01;

typedef struct lips_scene {
    needle_scene n;
    block b; /* borrows body and mesh of n */
    sb_cut_surface *surface;
    double volume, mass; /* mass: without what was taken out */
    int number;
    char name[160];
} lips_scene;

static int lips_make(lips_scene *s, int number, unsigned long long *seed)
{
    sb_cut_def cut = sb_default_cut_def();
    needle_scene *n = &s->n;
    memset(s, 0, sizeof *s);
    s->number = number;
    *n = needle_scene_default();
    n->turned = random_below(seed, 2);
    n->shake = check_random_in(seed, 0, 0.2);
    n->materials[0].young = REAL(random_scale(seed, 1e4, 8e4));
    n->materials[0].poisson = REAL(check_random_in(seed, 0, 0.45));
    n->body_def.slack = 4;
    n->body_def.integrator = random_below(seed, 2) ? SB_EULER : SB_GENERALISED_ALPHA;
    n->body_def.gravity = sb_v3(0, 0, REAL(-2));
    n->body_def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-4 : 1e-8); /* forces are to balance */
    n->needle_def.follow = NDL_EMBED;
    n->needle_def.bevel.curvature = REAL(random_below(seed, 2) ? 0 : check_random_in(seed, 0, 10));
    if (!needle_scene_make(n))
        return 0;
    s->b.mesh = n->mesh;
    s->b.body = n->body;
    cut.body = n->body;
    cut.lattice = intervals_of[random_below(seed, 3)];
    cut.front = random_below(seed, 2) ? SB_CUT_GLUE : SB_CUT_LAG;
    CHECK_OK(sb_cut_create(&cut, &s->b.cut, NULL));
    CHECK_OK(sb_cut_surface_create(s->b.cut, NULL, &s->surface, NULL));
    for (int e = 0; e < n->mesh.element_count; e++)
        s->volume += (double)sb_mesh_element_volume(&n->mesh, e);
    s->mass = (double)sb_body_mass(n->body);
    snprintf(s->name, sizeof s->name, "scene %d: lattice %d, %s, E %.3g, nu %.2f, integrator %d", number, cut.lattice,
             cut.front ? "glue" : "lag", (double)n->materials[0].young, (double)n->materials[0].poisson,
             (int)n->body_def.integrator);
    return s->b.cut && s->surface;
}

static void lips_free(lips_scene *s)
{
    sb_cut_surface_destroy(s->surface);
    sb_cut_destroy(s->b.cut);
    needle_scene_free(&s->n);
}

static sb_vec3 in_block(const lips_scene *s, double x, double y, double z)
{
    sb_vec3 at = sb_v3(REAL(x), REAL(y), REAL(z));
    return s->n.turned ? needle_scene_placed(at) : at;
}

/* A square across the needle's way, which holds on to the sides of the block or reaches through all of it. */
static void cut_across(lips_scene *s, unsigned long long *seed)
{
    sb_vec3 middle = in_block(s, 0.0213, 0.0191, check_random_in(seed, 0.015, 0.037)), triangles[6];
    double half = random_below(seed, 3) ? check_random_in(seed, 0.004, 0.018) : 0.06;
    sb_cut_info info;
    sb_error error;
    square_make(middle, random_direction(seed), half, triangles);
    if (CHECK_OK(sb_cut_triangles(s->b.cut, triangles, 2, &info, &error)))
        s->mass -= (double)info.removed_mass;
    else
        printf("%s: %s\n", s->name, error.message);
}

static void check_drawn(lips_scene *s)
{
    double close = scene_tolerance(1e-11, 1e4);
    int more;
    sb_cut_drawing d;
    sb_error error;
    if (!CHECK_OK(sb_cut_surface_update(s->surface, &error)))
        printf("%s\n", error.message);
    d = sb_cut_surface_get(s->surface);
    CHECK_INT(holes_of(&d, &more), 0);
    CHECK_NEAR(volumes_error(&s->b, &d), 0, close);
    CHECK_NEAR(sb_body_mass(s->n.body), s->mass, close * s->mass);
    CHECK(scene_all_finite(d.positions, d.vertex_count) && scene_all_finite(d.normals, d.vertex_count));
    CHECK(scene_all_finite(sb_body_positions(s->n.body), sb_body_node_count(s->n.body)));
    CHECK(isfinite(needle_push(&s->n)));
    check_pieces(&s->b);
}

/* Parts that no side of the block holds: they fall, or hang on the needle. */
static int loose_parts(const lips_scene *s)
{
    const sb_body *body = s->n.body;
    int loose = body->component_count;
    char *held = (char *)calloc((size_t)loose + 1, 1);
    for (int i = 0; i < sb_body_node_count(body); i++)
        if (body->node_component[i] >= 0 && body->fixed[i] && !held[body->node_component[i]]) {
            held[body->node_component[i]] = 1;
            loose--;
        }
    free(held);
    return loose;
}

/* Of block and needle: a flap that hangs on the needle swings it, too. */
typedef struct lips_motion {
    sb_vec3 tissue, needle; /* momentum (N s) */
    sb_vec3 inertia;        /* the block's mass times its acceleration (N), of generalised alpha */
} lips_motion;

static lips_motion motion_of(const lips_scene *s)
{
    const sb_body *body = s->n.body;
    const ndl_rod *rod = ndl_needle_rod(s->n.needles[0]);
    lips_motion m = {sb_body_momentum(body), {0, 0, 0}, {0, 0, 0}};
    for (int i = 0; i < ndl_rod_node_count(rod); i++)
        m.needle = sb_v3_madd(m.needle, ndl_rod_mass(rod, i), ndl_rod_velocities(rod)[i]);
    for (int i = 0; i < sb_body_node_count(body) && s->n.body_def.integrator == SB_GENERALISED_ALPHA; i++)
        m.inertia = sb_v3_madd(m.inertia, body->lumped_mass[i], body->acceleration[i]);
    return m;
}

/* What moves block and needle in a step, in the balance of the forces at its end (N): needles go by Euler; generalised
 * alpha of spectral radius 0 takes twice the acceleration there less that of the beginning. */
static sb_vec3 force_of_motion(const lips_scene *s, const lips_motion *before)
{
    lips_motion now = motion_of(s);
    sb_vec3 tissue = sb_v3_scale(REAL(1 / dt), sb_v3_sub(now.tissue, before->tissue));
    if (s->n.body_def.integrator == SB_GENERALISED_ALPHA)
        tissue = sb_v3_sub(sb_v3_scale(2, now.inertia), before->inertia);
    return sb_v3_madd(tissue, REAL(1 / dt), sb_v3_sub(now.needle, before->needle));
}

/* After a step, before which all moved so: what sides and sleeve push with, and the block's weight (needles have none),
 * but for what moves block and needle (N). */
static double unbalanced(const lips_scene *s, const lips_motion *before)
{
    sb_vec3 sum = {0, 0, 0}, push;
    const sb_vec3 *reactions = sb_body_reactions(s->n.body);
    for (int i = 0; i < sb_body_node_count(s->n.body); i++)
        sum = sb_v3_add(sum, reactions[i]);
    ndl_needle_base_wrench(s->n.needles[0], &push, NULL);
    sum = sb_v3_madd(sb_v3_add(sum, push), REAL(s->mass), s->n.body_def.gravity);
    return (double)sb_v3_norm(sb_v3_sub(sum, force_of_motion(s, before)));
}

static int run(lips_scene *s, int steps, double along)
{
    int fine = needle_scene_run(&s->n, dt, steps, needle_command(along, 0));
    if (!fine)
        printf("%s\n", s->name);
    return fine;
}

/* Returns the force that moves block and needle when both should have come to rest, of the push. */
static double check_needle(int number)
{
    unsigned long long seed = 0x9E3779B97F4A7C15ULL * (unsigned long long)(number + 1);
    lips_scene s;
    int before, fine, failures = check.failures, loose;
    lips_motion motion;
    double deep, moved = 0;
    for (int i = 0; i < 8; i++)
        check_random(&seed);
    if (!CHECK(lips_make(&s, number, &seed)))
        return 0;
    before = random_below(&seed, 3);
    for (int k = 0; k < before; k++)
        cut_across(&s, &seed);
    fine = run(&s, 1 + (int)(check_random_in(&seed, 0.01, 0.03) / (speed * dt)), speed);
    check_drawn(&s);
    deep = (double)ndl_needle_depth(s.n.needles[0]);
    for (int k = 0; k < 1 + (before < 2) && fine; k++) {
        cut_across(&s, &seed);
        check_drawn(&s);
        fine = run(&s, 3, random_below(&seed, 2) ? 0 : speed);
        check_drawn(&s);
    }
    fine = fine && run(&s, 60, 0);
    motion = motion_of(&s);
    fine = fine && run(&s, 1, 0);
    loose = loose_parts(&s);
    moved = (double)sb_v3_norm(force_of_motion(&s, &motion)) / needle_push(&s.n);
    if (fine && !loose)
        CHECK_NEAR(unbalanced(&s, &motion), 0, scene_tolerance(1e-5, 8000) * needle_push(&s.n));
    for (int k = 0; k < 12 && fine && ndl_needle_depth(s.n.needles[0]) > 0; k++)
        fine = run(&s, 20, -speed);
    check_drawn(&s);
    if (fine && !loose) /* else they may hang on it */
        CHECK(ndl_needle_depth(s.n.needles[0]) == 0);
    if (check.failures > failures)
        printf("%s: before %d, deep %.4f\n", s.name, before, deep);
    lips_free(&s);
    return moved;
}

/* Needles with a node between lips that stand open: they were pushed from one to the other and back, for ever. */
static void test_between(void)
{
    static const int scenes[3] = {84, 192, 260};
    for (int i = 0; i < 3; i++)
        CHECK_NEAR(check_needle(scenes[i]), 0, scene_tolerance(1e-5, 8000));
}

/* Level planes over and under each other: lips that touch let a needle through, at any depth and on its way out. */
static void test_touching(void)
{
    unsigned long long seed = 3;
    for (int round = 0; round < 2; round++) {
        lips_scene s;
        if (!CHECK(lips_make(&s, 3 + round, &seed)))
            return;
        for (int k = 0; k < 2; k++) {
            sb_vec3 up = sb_v3_sub(in_block(&s, 0, 0, 1), in_block(&s, 0, 0, 0)), triangles[6];
            square_make(in_block(&s, 0.02, 0.02, 0.0331 - 0.0124 * k), up, 0.06, triangles);
            CHECK_OK(sb_cut_triangles(s.b.cut, triangles, 2, NULL, NULL));
        }
        CHECK(run(&s, (int)(0.027 / (speed * dt)), speed));
        CHECK(ndl_needle_depth(s.n.needles[0]) > REAL(0.022));
        check_drawn(&s);
        CHECK(run(&s, (int)(0.035 / (speed * dt)), -speed));
        CHECK(ndl_needle_depth(s.n.needles[0]) == 0);
        check_drawn(&s);
        lips_free(&s);
    }
}

static void test_lips(void)
{
    static const int swinging[2] = {30, 191};
    const char *one = getenv("CUT_NEEDLE"), *more = getenv("CHECK_SLOW");
    int count = check_quick() ? 2 : check_rounds(4) * (more && atoi(more) > 0 ? atoi(more) : 1);
    int first = one ? atoi(one) : 0;
    for (int i = first; i < (one ? first + 1 : count); i++)
        (void)check_needle(i);
    for (int i = 0; i < 2 && !one && !check_quick(); i++) /* tissue and needle still swing at the end */
        (void)check_needle(swinging[i]);
}

CHECK_SUITE(cut_needle, {"through lips", test_lips}, {"lips that touch", test_touching},
            {"between lips", test_between});
