/* test_contact_organ: tools and organs that nobody chose: a sphere, a bent chain, a box or a closed mesh presses on a
 * random organ, slides, lifts off and leaves it to come to rest, in any unit of length, of any material and step.
 * Nothing becomes NaN, forces are in balance with supports and momentum in each step, what is refused is named and
 * leaves all as it was, the organ comes back to its rest shape, and threads do not change a bit. CHECK_SLOW=n: n
 * organs; ORGAN=k: organ k alone, told step by step. */
#include "contact_scene.h"
#include "random_case.h"

enum { SLIDING = 20, LIFTING = 20, RESTING = 40, MOST_STEPS_DOWN = 120, MOST_POINTS = 1 << 15 };

typedef struct trial {
    unsigned long long number;
    char name[200]; /* in words */
    sb_mesh mesh;
    sb_material material;
    sb_real damping, dt, size; /* s, s, m */
    sb_tool_def tool;
    sb_mesh tool_mesh; /* of a mesh tool */
    sb_vec3 chain[4];
    sb_vec3 top, up, aside; /* where the tool comes from, and where it slides to */
    double reach;           /* m, of the tool from its origin at most */
    double depth;           /* m, that it presses */
    int pace;               /* steps in which it does */
    int *held, held_count;
} trial;

/* What playing a trial has found. */
typedef struct outcome {
    unsigned long long hash;
    int steps, touching, refused;
    double largest;   /* N, force of the tool */
    double unbalance; /* N, worst */
    double unsummed;  /* N, wrench against the list of points, worst */
    double left;      /* of the size: how far off its rest shape the organ is at the end */
} outcome;

/* ---- trials ---------------------------------------------------------------------------------------------------- */

static sb_material random_tissue(unsigned long long *seed, sb_real density, const char **name)
{
    sb_real young = REAL(random_scale(seed, 1e3, 1e5)), poisson = REAL(check_random_in(seed, 0, 0.47));
    switch (random_below(seed, 4)) {
    case 0: *name = "linear"; return sb_material_linear(young, poisson, density);
    case 1: *name = "stable neo-Hookean"; return sb_material_stable_neo_hookean(young, poisson, density);
    case 2: *name = "invertible corotated"; return sb_material_corotated_invertible(young, poisson, density);
    default: *name = "corotated"; return sb_material_corotated(young, poisson, density);
    }
}

/* The surface of an ellipsoid, as a mesh of tri3. */
static void random_tool_mesh(trial *t, unsigned long long *seed, double radius)
{
    sb_mesh solid;
    sb_boundary boundary;
    sb_vec3 axes = sb_v3(REAL(radius), REAL(radius * check_random_in(seed, 0.7, 1)), REAL(radius * 0.8));
    memset(&solid, 0, sizeof solid);
    CHECK_OK(sb_mesh_ellipsoid(SB_TET4, axes, 6, NULL, &solid, NULL));
    if (CHECK_OK(sb_mesh_boundary(&solid, 1, NULL, &boundary, NULL))) {
        CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &t->tool_mesh, NULL));
        sb_boundary_free(&boundary);
    }
    sb_mesh_free(&solid);
    t->tool.surface = &t->tool_mesh;
    t->tool.cells = SB_TOOL_MIN_CELLS;
}

/* A chain of up to four points, bent anyhow, around the origin. */
static void random_chain(trial *t, unsigned long long *seed, double length)
{
    t->tool.points = t->chain;
    t->tool.point_count = 2 + random_below(seed, 3);
    for (int i = 0; i < t->tool.point_count; i++) {
        double along = length * (2.0 * i / (t->tool.point_count - 1) - 1);
        double y = check_random_in(seed, -0.3, 0.3) * length, z = check_random_in(seed, -0.3, 0.3) * length;
        t->chain[i] = sb_v3(REAL(along), REAL(y), REAL(z));
        t->reach = fmax(t->reach, (double)sb_v3_norm(t->chain[i]) + (double)t->tool.radius);
    }
}

/* Longest edge (m) between corners of the organ's elements. */
static double longest_edge(const sb_mesh *mesh)
{
    int width = sb_mesh_element_width(mesh), corners = sb_element_corner_count(mesh->element_type);
    double longest = 0;
    for (int e = 0; e < mesh->element_count; e++)
        for (int i = 0; i < corners * corners; i++) {
            const int *n = mesh->elements + (size_t)e * (size_t)width;
            longest =
                fmax(longest, (double)sb_v3_norm(sb_v3_sub(mesh->nodes[n[i / corners]], mesh->nodes[n[i % corners]])));
        }
    return longest;
}

/* As thin as the faces allow, or thicker. */
static const char *random_tool_of(trial *t, unsigned long long *seed)
{
    static const char *const names[] = {"sphere", "chain", "box", "mesh"};
    int kind = random_below(seed, 4);
    double radius = (double)t->size * check_random_in(seed, 0.1, 0.2), thinnest = 0.2 * longest_edge(&t->mesh);
    radius = fmax(radius, (kind == 3 ? 4 : kind == 2 ? 2.5 : 1) * thinnest);
    t->tool = sb_default_tool_def();
    t->tool.radius = REAL(radius);
    t->tool.friction = REAL(random_below(seed, 3) ? check_random_in(seed, 0, 1) : 0);
    t->reach = radius;
    t->depth = fmin(radius, (double)t->size) * check_random_in(seed, 0.1, 0.3);
    t->pace = 4 + random_below(seed, 20);
    if (kind == 1) {
        t->tool.shape = SB_TOOL_CAPSULES;
        random_chain(t, seed, (double)t->size * check_random_in(seed, 0.2, 0.5));
    } else if (kind == 2) {
        double x = check_random_in(seed, 1, 2), y = check_random_in(seed, 1, 2), z = check_random_in(seed, 1, 2);
        t->tool.shape = SB_TOOL_BOX;
        t->tool.half = sb_v3(REAL(radius * x), REAL(radius * y), REAL(radius * z));
        t->tool.radius = REAL(radius * check_random_in(seed, 0.4, 1));
        t->reach = (double)sb_v3_norm(t->tool.half);
    } else if (kind == 3) {
        t->tool.shape = SB_TOOL_MESH;
        random_tool_mesh(t, seed, radius);
    }
    return names[kind];
}

/* Elements that reach below a level are held whole, or one that hangs on an edge could turn. */
static void hold_below(trial *t, sb_real level)
{
    int width = sb_mesh_element_width(&t->mesh);
    unsigned char *is_held = (unsigned char *)calloc((size_t)t->mesh.node_count, 1);
    t->held = (int *)malloc((size_t)t->mesh.node_count * sizeof(int));
    if (!CHECK(is_held && t->held))
        return;
    for (int e = 0; e < t->mesh.element_count; e++) {
        const int *n = t->mesh.elements + (size_t)e * (size_t)width;
        int below = 0;
        for (int a = 0; a < width; a++)
            below = below || sb_v3_dot(t->up, t->mesh.nodes[n[a]]) <= level;
        for (int a = 0; below && a < width; a++)
            is_held[n[a]] = 1;
    }
    for (int i = 0; i < t->mesh.node_count; i++)
        if (is_held[i])
            t->held[t->held_count++] = i;
    free(is_held);
}

/* The organ's size and its highest point along `up`; what is lowest is held. */
static void hold_and_aim(trial *t, unsigned long long *seed)
{
    sb_real low = SB_REAL_MAX, high = -SB_REAL_MAX;
    for (int i = 0; i < t->mesh.node_count; i++) {
        sb_real at = sb_v3_dot(t->up, t->mesh.nodes[i]);
        low = sb_min(low, at);
        if (at > high) {
            high = at;
            t->top = t->mesh.nodes[i];
        }
    }
    t->size = high - low;
    hold_below(t, low + REAL(check_random_in(seed, 0.05, 0.3)) * t->size);
}

static int trial_make(trial *t, unsigned long long number)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    unsigned long long seed = 0x9E3779B97F4A7C15ULL * (number + 1);
    const char *shape, *tissue, *tool;
    sb_quat turn;
    double unit;
    memset(t, 0, sizeof *t);
    t->number = number;
    for (int i = 0; i < 8; i++)
        check_random(&seed);
    shape = random_shape(&seed, types[random_below(&seed, 6)], &t->mesh);
    unit = 0.1 * random_scale(&seed, 1e-3, 1e3); /* 0.1 m in units from mm to km */
    turn = random_turn(&seed);
    for (int i = 0; i < t->mesh.node_count; i++)
        t->mesh.nodes[i] = sb_v3_scale(REAL(unit), sb_quat_rotate(turn, t->mesh.nodes[i]));
    t->up = random_direction(&seed);
    t->aside = random_direction(&seed);
    hold_and_aim(t, &seed);
    t->aside = sb_v3_madd(t->aside, -sb_v3_dot(t->aside, t->up), t->up);
    t->material = random_tissue(&seed, REAL(10 / (unit * unit)), &tissue); /* 1000 kg/m^3 at 0.1 m */
    t->damping = REAL(random_scale(&seed, 2e-3, 2e-2));
    t->dt = REAL(check_random_in(&seed, 0.005, 0.02));
    tool = random_tool_of(t, &seed);
    t->tool.pose.rotation = random_turn(&seed);
    t->tool.pose.position = sb_v3_madd(t->top, REAL(1.02 * t->reach), t->up);
    snprintf(t->name, sizeof t->name,
             "organ %llu: %s of %s, %.3g m, %s, dt %.3g ms, %s, mu %.2g, %.3g deep in %d steps", number, shape,
             sb_element_name(t->mesh.element_type), (double)t->size, tissue, 1e3 * (double)t->dt, tool,
             (double)t->tool.friction, t->depth / (double)t->size, t->pace);
    return CHECK(t->mesh.node_count > 0 && t->held_count > 0) && t->held_count < t->mesh.node_count;
}

static void trial_free(trial *t)
{
    sb_mesh_free(&t->mesh);
    sb_mesh_free(&t->tool_mesh);
    free(t->held);
}

/* ---- playing --------------------------------------------------------------------------------------------------- */

typedef struct stage {
    const trial *t;
    sb_body *body;
    sb_contact *contact;
    int tool;
    sb_pose pose;
    sb_contact_point *points;
    outcome *sum;
} stage;

static int stage_make(stage *s, const trial *t, sb_jobs jobs, outcome *sum)
{
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = press_exact();
    sb_error error;
    memset(s, 0, sizeof *s);
    memset(sum, 0, sizeof *sum);
    s->t = t;
    s->sum = sum;
    s->pose = t->tool.pose;
    s->points = (sb_contact_point *)malloc(MOST_POINTS * sizeof *s->points);
    def.mesh = &t->mesh;
    def.material = t->material;
    def.damping_stiffness = t->damping;
    def.tolerance = REAL(scene_tolerance(1e-10, 100));
    def.max_iterations = 3000;
    def.newton_tolerance = REAL(scene_tolerance(1e-9, 1e3));
    def.jobs = jobs;
    s->body = scene_body(&def);
    if (!s->body || !CHECK(s->points != NULL))
        return 0;
    CHECK_OK(sb_body_fix_nodes(s->body, t->held, t->held_count, SB_XYZ));
    contact.body = s->body;
    contact.max_contacts = MOST_POINTS;
    if (!CHECK_OK(sb_contact_create(&contact, &s->contact, &error)))
        return 0;
    if (sb_contact_add_tool(s->contact, &t->tool, &s->tool, &error) == SB_OK)
        return 1;
    CHECK_RESULT(error.result, SB_ERROR_UNSUPPORTED); /* too thin for such large faces, which is said */
    CHECK(strstr(error.message, "thin") != NULL);
    return 0;
}

static void stage_free(stage *s)
{
    sb_contact_destroy(s->contact);
    sb_body_destroy(s->body);
    free(s->points);
}

/* Forces in this step: the supports', the tool's, and what they did to momentum, unless iterations were cut short. */
static void read_balance(stage *s, sb_vec3 before, sb_real dt, int is_whole)
{
    int nodes = s->t->mesh.node_count, count = sb_contact_points(s->contact, s->points, MOST_POINTS);
    sb_vec3 rate = sb_v3_scale(1 / dt, sb_v3_sub(sb_body_momentum(s->body), before)), sum = {0, 0, 0}, off;
    sb_wrench wrench = {{0, 0, 0}, {0, 0, 0}};
    CHECK_OK(sb_contact_wrench(s->contact, s->tool, &wrench));
    for (int i = 0; i < count && i < MOST_POINTS; i++)
        sum = sb_v3_add(sum, s->points[i].force);
    off = sb_v3_sub(sb_v3_sub(scene_sum(sb_body_reactions(s->body), nodes), wrench.force), rate);
    s->sum->largest = fmax(s->sum->largest, (double)sb_v3_norm(wrench.force));
    s->sum->unsummed = fmax(s->sum->unsummed, (double)sb_v3_norm(sb_v3_add(sum, wrench.force)));
    if (is_whole)
        s->sum->unbalance = fmax(s->sum->unbalance, (double)sb_v3_norm(off));
    s->sum->touching += count > 0;
    s->sum->hash = 31 * s->sum->hash ^ scene_hash(&wrench, sizeof wrench);
}

/* One step on the way to s->pose. */
static void stage_step(stage *s, sb_real dt)
{
    int nodes = s->t->mesh.node_count;
    sb_vec3 before = sb_body_momentum(s->body);
    sb_step_info info;
    uint64_t hash;
    CHECK_OK(sb_contact_move_tool(s->contact, s->tool, &s->pose));
    hash = sb_body_state_hash(s->body);
    s->sum->steps++;
    if (sb_body_step(s->body, dt, &info) != SB_OK) {
        s->sum->refused++;
        CHECK(info.error.message[0] && sb_body_state_hash(s->body) == hash);
        if (getenv("ORGAN"))
            printf("%d: %s\n", s->sum->steps, info.error.message);
        return;
    }
    CHECK(scene_all_finite(sb_body_positions(s->body), nodes) && scene_all_finite(sb_body_velocities(s->body), nodes));
    read_balance(s, before, dt, !info.capped && !sb_contact_get_info(s->contact).capped);
    s->sum->hash = 31 * s->sum->hash ^ scene_hash(sb_body_positions(s->body), (size_t)nodes * sizeof(sb_vec3));
    if (getenv("ORGAN")) {
        sb_contact_info contact = sb_contact_get_info(s->contact);
        printf("%d: %d touch, %d stick, %d systems, %d retries, capped %d, lag %.3g, overlap %.3g, off %.3g of %.3g\n",
               s->sum->steps, contact.touching, contact.sticking, contact.iterations, contact.retries, contact.capped,
               (double)contact.lag, (double)contact.deepest, s->sum->unbalance, s->sum->largest);
    }
}

/* The pose goes along a way (m) in so many steps. */
static void stage_go(stage *s, sb_vec3 direction, double way, int steps)
{
    sb_vec3 from = s->pose.position;
    for (int i = 1; i <= steps; i++) {
        s->pose.position = sb_v3_madd(from, REAL(way * i / steps), direction);
        stage_step(s, s->t->dt);
    }
}

/* Down until it touches, into the organ, aside, and far off. Then the organ comes to rest in long steps. 0: the tool
 * was refused. */
static int play(const trial *t, sb_jobs jobs, outcome *sum)
{
    stage s;
    int good = stage_make(&s, t, jobs, sum);
    for (int i = 0; good && i < MOST_STEPS_DOWN && sb_contact_points(s.contact, NULL, 0) == 0; i++)
        stage_go(&s, t->up, -0.05 * t->reach, 1);
    if (good) {
        stage_go(&s, t->up, -t->depth, t->pace);
        stage_go(&s, t->aside, t->depth, SLIDING);
        stage_go(&s, t->up, 2 * t->reach + 2 * t->depth, LIFTING);
        stage_go(&s, t->up, 4 * (double)t->size, LIFTING);
        for (int i = 0; i < RESTING; i++)
            stage_step(&s, 20 * t->dt);
        CHECK_INT(sb_contact_points(s.contact, NULL, 0), 0);
        sum->left = scene_distance(sb_body_positions(s.body), t->mesh.nodes, t->mesh.node_count) / (double)t->size;
    }
    stage_free(&s);
    return good;
}

static void check_trial(const trial *t)
{
    sb_jobs none = {NULL, NULL};
    outcome alone, shared;
    int three = 3;
    if (!play(t, none, &alone))
        return;
    CHECK(alone.touching > t->pace);
    CHECK(alone.unsummed <= scene_tolerance(1e-12, 1e4) * alone.largest);
    CHECK(alone.unbalance <= scene_tolerance(1e-7, 1e5) * alone.largest);
    CHECK(alone.left < scene_tolerance(1e-6, 1e5));
    CHECK_INT(alone.refused, 0);
    play(t, scene_jobs(&three), &shared);
    CHECK(alone.hash == shared.hash);
    if (getenv("ORGAN") || getenv("CHECK_SLOW"))
        printf("%s: %d steps, %d touch, %d refused, %.3g N, off by %.2g, list by %.2g, left %.2g\n", t->name,
               alone.steps, alone.touching, alone.refused, alone.largest, alone.unbalance / alone.largest,
               alone.unsummed / alone.largest, alone.left);
}

static void test_random(void)
{
    const char *one = getenv("ORGAN"), *slow = getenv("CHECK_SLOW");
    int count = one ? 1 : slow ? atoi(slow) : check_quick() ? 4 : check_rounds(20);
    for (int i = 0; i < count; i++) {
        trial t;
        int failures = check.failures;
        if (trial_make(&t, (unsigned long long)(one ? atoi(one) : i)))
            check_trial(&t);
        if (check.failures != failures)
            printf("%s\n", t.name);
        trial_free(&t);
    }
}

CHECK_SUITE(contact_organ, {"tools and organs at random", test_random});
