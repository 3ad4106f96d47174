/* Random programs on one body: needles go in, turn and are drawn out, blades cut, tools press, points and cables
 * follow, supports, loads and materials change, tangents are kept, memory runs out, absurd calls come between. Whatever
 * the order: states go on bit for bit in a second body, recordings play again, a call that fails changes nothing, any
 * number of threads gives the same bits, nothing becomes NaN, and steps allocate nothing.
 * CHECK_SLOW=n: n times as many; WHOLE_SCENE=n: scene n alone, with its calls. */
#include "needle.h"
#include "random_case.h"

enum { ACTS = 26, NEEDLES = 2, MARKS = 6 };

typedef enum deed {
    STEP, /* more often than others */
    FEED,
    TURN,
    DRAW,
    CUT_BEGIN,
    CUT_MOVE,
    CUT_END,
    CUT_TRIANGLES,
    ABLATE,
    TOOL,
    TOOL_AWAY,
    HOLD,
    PLACE,
    FREE,
    CABLE,
    FORCE,
    GRAVITY,
    MATERIAL,
    KEEP,
    SPRINGS,
    REMOVE_LOAD,
    STATIC,
    BAD_CALL,
    RESET,
    DEEDS
} deed;
static const char *const deed_names[DEEDS] = {
    "step",    "feed",     "turn",      "draw",    "cut begin",   "cut move", "cut end",  "cut triangles",
    "ablate",  "tool",     "tool away", "hold",    "place",       "free",     "cable",    "force",
    "gravity", "material", "keep",      "springs", "remove load", "static",   "bad call", "reset"};

typedef struct scene_plan {
    unsigned long long seed;
    sb_mesh mesh;
    sb_body_def def;
    double unit; /* of length, in metres: 1e-3, 1 or 1e3 of the same scene */
    double dt;
    int needles, cuts, remesh, contact, front, lattice, toughness;
} scene_plan;

typedef struct whole {
    const scene_plan *plan;
    scene_memory memory;
    sb_body *body;
    ndl_needle *needle[NEEDLES];
    ndl_command command[NEEDLES];
    sb_cut *cut;
    sb_contact *contact;
    sb_embedding *marks;
    int tool, stroke, load, workers;
} whole;

static double length_of(const scene_plan *p, double metres) { return metres / p->unit; }
static sb_vec3 place_of(const scene_plan *p, double x, double y, double z)
{
    return sb_v3(REAL(length_of(p, x)), REAL(length_of(p, y)), REAL(length_of(p, z)));
}

static sb_material plan_material(const scene_plan *p, int which, double young, double poisson)
{
    sb_real e = REAL(young * p->unit), density = REAL(1000 * pow(p->unit, 3));
    return which == 0   ? sb_material_corotated(e, REAL(poisson), density)
           : which == 1 ? sb_material_stable_neo_hookean(e, REAL(poisson), density)
                        : sb_material_linear(e, REAL(poisson), density);
}

static void plan_make(scene_plan *p, unsigned long long number)
{
    static const double units[] = {1, 1e-3, 1e3};
    static const sb_integrator integrators[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
    unsigned long long *seed = &p->seed;
    memset(p, 0, sizeof *p);
    p->seed = 0x9E3779B97F4A7C15ULL * (number + 1);
    for (int i = 0; i < 8; i++)
        check_random(seed);
    p->unit = units[random_below(seed, 3)];
    p->def = sb_default_body_def();
    p->mesh = scene_box(SB_TET4, 3 + random_below(seed, 2), 3 + random_below(seed, 2), 3, sb_v3(1, 1, 1), 0.15);
    if (random_below(seed, 3) == 0)
        random_grade(seed, &p->mesh);
    for (int i = 0; i < p->mesh.node_count; i++) {
        sb_vec3 x = p->mesh.nodes[i];
        p->mesh.nodes[i] = place_of(p, 0.04 * (double)x.x, 0.04 * (double)x.y, 0.04 * (double)x.z);
    }
    p->def.material =
        plan_material(p, random_below(seed, 3), random_scale(seed, 5e3, 1e5), check_random_in(seed, 0.2, 0.47));
    p->def.integrator = integrators[random_below(seed, 3)];
    p->def.max_newton = random_below(seed, 2) ? 1 : 10;
    p->def.damping_stiffness = REAL(random_below(seed, 3) ? 0.005 : 0);
    p->def.gravity = place_of(p, 0, 0, random_below(seed, 2) ? -3 : 0);
    p->def.slack = 4;
    p->def.tolerance = REAL(1e-5);
    p->def.max_iterations = 400;
    p->dt = random_scale(seed, 1e-3, 0.02);
    p->needles = random_below(seed, NEEDLES + 1);
    p->cuts = random_below(seed, 4) != 0;
    p->remesh = !p->cuts && random_below(seed, 2);
    p->contact = random_below(seed, 3) != 0;
    p->front = random_below(seed, 2);
    p->lattice = 1 + random_below(seed, 2);
    p->toughness = random_below(seed, 2);
}

static int make_needle(whole *w, int k)
{
    const scene_plan *p = w->plan;
    ndl_friction friction = {REAL(20), REAL(0.5), 0, 0, 0};
    ndl_needle_def def = ndl_default_needle_def();
    friction.cutting = REAL(length_of(p, 0.5));
    def.body = w->body;
    def.base = place_of(p, 0.012 + 0.0153 * k, 0.0191, 0.081);
    def.direction = sb_v3(REAL(0.1), REAL(0.05 * k), -1);
    def.length = REAL(length_of(p, 0.038));
    def.follow = p->remesh ? NDL_REMESH : NDL_EMBED;
    def.frictions = &friction;
    def.friction_count = 1;
    def.allocator = scene_allocator(&w->memory);
    if (p->unit != 1)
        return 1; /* sections are of metres */
    return CHECK_OK(ndl_needle_create(&def, &w->needle[k], NULL));
}

static int whole_make(whole *w, const scene_plan *p, int workers)
{
    sb_body_def def = p->def;
    sb_error error;
    int fine = 1;
    memset(w, 0, sizeof *w);
    w->plan = p;
    w->tool = w->stroke = w->load = -1;
    w->workers = workers;
    def.mesh = &p->mesh;
    def.allocator = scene_allocator(&w->memory);
    if (workers)
        def.jobs = scene_jobs(&w->workers);
    if (!CHECK_OK(sb_body_create(&def, &w->body, &error)))
        return 0;
    for (int i = 0; i < p->mesh.node_count; i++)
        if (p->mesh.nodes[i].z < REAL(length_of(p, 1e-6)))
            fine &= sb_body_fix_nodes(w->body, &i, 1, SB_XYZ) == SB_OK;
    {
        sb_embedding_def marks = sb_default_embedding_def();
        sb_vec3 points[MARKS];
        for (int i = 0; i < MARKS; i++)
            points[i] = place_of(p, 0.005 + 0.006 * i, 0.0207, 0.0311);
        marks.mesh = &p->mesh;
        marks.points = points;
        marks.point_count = MARKS;
        fine &= CHECK_OK(sb_embedding_create(&marks, &w->marks, NULL)) &&
                CHECK_OK(sb_embedding_follow(w->marks, w->body, NULL));
    }
    for (int k = 0; k < p->needles; k++)
        fine &= make_needle(w, k);
    if (p->cuts) {
        sb_cut_def cut = sb_default_cut_def();
        cut.body = w->body;
        cut.front = p->front ? SB_CUT_GLUE : SB_CUT_LAG;
        cut.lattice = p->lattice;
        cut.toughness = REAL(p->toughness ? 50 : 0);
        cut.allocator = def.allocator;
        fine &= CHECK_OK(sb_cut_create(&cut, &w->cut, NULL));
    }
    if (p->contact) {
        sb_contact_def contact = sb_default_contact_def();
        sb_tool_def tool = sb_default_tool_def();
        contact.body = w->body;
        tool.radius = REAL(length_of(p, 0.008));
        tool.friction = REAL(0.3);
        tool.pose.position = place_of(p, 0.03, 0.02, 0.06);
        fine &= CHECK_OK(sb_contact_create(&contact, &w->contact, NULL)) &&
                CHECK_OK(sb_contact_add_tool(w->contact, &tool, &w->tool, NULL));
    }
    return fine;
}

static void whole_free(whole *w)
{
    sb_contact_destroy(w->contact);
    for (int k = 0; k < NEEDLES; k++)
        ndl_needle_destroy(w->needle[k]);
    sb_cut_destroy(w->cut);
    sb_embedding_destroy(w->marks);
    sb_body_destroy(w->body);
    CHECK_INT(w->memory.live, 0);
}

/* ---- deeds ---- */

static sb_result take_step(whole *w, sb_error *error)
{
    int count = 0;
    sb_step_info info;
    sb_result result;
    while (count < NEEDLES && w->needle[count])
        count++;
    if (count)
        return ndl_step(w->body, w->needle, count, REAL(w->plan->dt), w->command, NULL, error);
    result = sb_body_step(w->body, REAL(w->plan->dt), &info);
    *error = info.error;
    return result;
}

static void blade_edge(const scene_plan *p, unsigned long long *seed, sb_vec3 edge[2])
{
    double x = 0.02 + 0.002 * check_random(seed), z = check_random_in(seed, 0.012, 0.05);
    edge[0] = place_of(p, x, -0.01, z);
    edge[1] = place_of(p, x + 0.001, check_random_in(seed, 0.02, 0.05), z);
}

static int a_node(const whole *w, unsigned long long *seed) { return random_below(seed, w->plan->mesh.node_count); }

static sb_result bad_call(whole *w, unsigned long long *seed, sb_error *error)
{
    int node = 1 << 28, cable[2] = {0, 0};
    sb_vec3 edge[2] = {{REAL(1e30), 0, 0}, {0, 0, REAL(-1e30)}};
    sb_cable_def def = sb_default_cable_def();
    sb_material none = w->plan->def.material;
    switch (random_below(seed, 7)) {
    case 0: return sb_body_fix_nodes(w->body, &node, 1, SB_XYZ);
    case 1: return w->cut ? sb_cut_move(w->cut, 77, edge, NULL, error) : SB_ERROR_ARGUMENT;
    case 2:
        def.count = 2;
        def.nodes = cable;
        return sb_body_add_cable(w->body, &def, &node, error);
    case 3: return sb_body_step(w->body, REAL(-1), NULL);
    case 4: none.mu = -1; return sb_body_set_material(w->body, &none, error);
    case 5: return sb_body_state_load(w->body, "no state", 8, error);
    default: return sb_body_keep_tangent(w->body, REAL(-1), error);
    }
}

static sb_result do_deed(whole *w, deed what, unsigned long long seed, sb_error *error)
{
    const scene_plan *p = w->plan;
    int node = a_node(w, &seed), k = random_below(&seed, NEEDLES);
    sb_vec3 v = sb_v3_scale(REAL(length_of(p, 1)), random_direction(&seed)), edge[2], triangle[3];
    switch (what) {
    case FEED:
    case DRAW:
    case TURN:
        w->command[k].insertion = REAL((what == DRAW ? -1 : 1) * check_random_in(&seed, 0.02, 0.15));
        w->command[k].twist = REAL(what == TURN ? check_random_in(&seed, -5, 5) : 0);
        return SB_OK;
    case CUT_BEGIN:
        blade_edge(p, &seed, edge);
        edge[0].z = edge[1].z = REAL(length_of(p, 0.06));
        return w->cut && w->stroke < 0 ? sb_cut_begin(w->cut, edge, 2, &w->stroke, error) : SB_OK;
    case CUT_MOVE:
        blade_edge(p, &seed, edge);
        return w->cut && w->stroke >= 0 ? sb_cut_move(w->cut, w->stroke, edge, NULL, error) : SB_OK;
    case CUT_END:
        if (w->cut && w->stroke >= 0)
            sb_cut_end(w->cut, w->stroke);
        w->stroke = -1;
        return SB_OK;
    case CUT_TRIANGLES:
        for (int i = 0; i < 3; i++)
            triangle[i] = sb_v3_madd(place_of(p, 0.02, 0.02, 0.03), REAL(length_of(p, 0.03)), random_direction(&seed));
        return w->cut ? sb_cut_triangles(w->cut, triangle, 1, NULL, error) : SB_OK;
    case ABLATE:
        return w->cut && random_below(&seed, 3) == 0
                   ? sb_cut_ablate(w->cut, place_of(p, 0.04, 0.035, 0.035), REAL(length_of(p, 0.009)), NULL, error)
                   : SB_OK;
    case TOOL:
    case TOOL_AWAY: {
        sb_pose pose;
        if (!w->contact)
            return SB_OK;
        pose.position = place_of(p, check_random_in(&seed, 0.01, 0.03), check_random_in(&seed, 0.01, 0.03),
                                 what == TOOL ? check_random_in(&seed, 0.044, 0.049) : 0.07);
        pose.rotation = sb_quat_identity();
        return sb_contact_move_tool(w->contact, w->tool, &pose);
    }
    case HOLD: return sb_body_hold(w->body, &node, 1, SB_XYZ, error);
    case PLACE: {
        sb_vec3 to = sb_v3_madd(sb_body_positions(w->body)[node], REAL(3e-4), v);
        return sb_body_place(w->body, &node, 1, SB_XYZ, &to, error);
    }
    case FREE: return sb_body_release(w->body, &node, 1, SB_XYZ, error);
    case CABLE: {
        int nodes[3] = {node, -1, 0};
        sb_vec3 places[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
        sb_cable_def def = sb_default_cable_def();
        places[1] = place_of(p, 0.02, 0.02, 0.09);
        nodes[2] = (node + 5) % p->mesh.node_count;
        def.count = 3;
        def.nodes = nodes;
        def.places = places;
        def.stiffness = 5;
        return w->load < 0 ? sb_body_add_cable(w->body, &def, &w->load, error) : SB_OK;
    }
    case SPRINGS: {
        sb_vec3 to = sb_v3_madd(sb_body_positions(w->body)[node], REAL(1e-3), v);
        sb_real stiffness = 20;
        return w->load < 0 ? sb_body_add_springs(w->body, &node, 1, &stiffness, 1, &to, &w->load, error) : SB_OK;
    }
    case REMOVE_LOAD: {
        sb_result result = w->load >= 0 ? sb_body_remove_load(w->body, w->load) : SB_OK;
        w->load = -1;
        return result;
    }
    case FORCE: {
        sb_vec3 force = sb_v3_scale(REAL(0.05), v);
        return sb_body_apply_forces(w->body, &node, 1, &force, 1, error);
    }
    case GRAVITY: return sb_body_set_gravity(w->body, sb_v3_scale(3, v));
    case MATERIAL: {
        sb_material material = plan_material(p, random_below(&seed, 3), random_scale(&seed, 5e3, 1e5), 0.4);
        return sb_body_set_material(w->body, &material, error);
    }
    case KEEP: return sb_body_keep_tangent(w->body, REAL(random_below(&seed, 2) ? 0.1 : 0), error);
    case STATIC: {
        sb_static_options options = sb_default_static_options();
        sb_step_info info;
        sb_result result;
        if (random_below(&seed, 3))
            return SB_OK;
        options.tolerance = REAL(scene_tolerance(1e-4, 10));
        result = sb_body_solve_static(w->body, &options, &info);
        *error = info.error;
        return result;
    }
    case BAD_CALL: CHECK(bad_call(w, &seed, error) != SB_OK); return SB_OK;
    case RESET:
        if (random_below(&seed, 4) == 0)
            sb_body_reset(w->body);
        return SB_OK;
    default: return take_step(w, error);
    }
}

/* ---- programs ---- */

/* A needle whose mesh follows it makes nodes as it goes on; room for them comes by halves. */
static int may_allocate(const scene_plan *p, deed what) { return what != STEP || (p->remesh && p->needles); }

static int is_finite(const whole *w)
{
    int n = sb_body_node_count(w->body);
    return scene_all_finite(sb_body_positions(w->body), n) && scene_all_finite(sb_body_velocities(w->body), n) &&
           scene_all_finite(sb_body_reactions(w->body), n);
}

/* Points that follow are in the same places of both bodies. */
static void check_marks(const whole *a, const whole *b)
{
    sb_vec3 places[2][MARKS];
    CHECK_OK(sb_embedding_update(a->marks, sb_body_positions(a->body), places[0], NULL, NULL));
    CHECK_OK(sb_embedding_update(b->marks, sb_body_positions(b->body), places[1], NULL, NULL));
    CHECK(scene_all_finite(places[0], MARKS) && memcmp(places[0], places[1], sizeof places[0]) == 0);
}

typedef struct program {
    deed deeds[2 * ACTS];
    unsigned long long seeds[2 * ACTS];
    int count;
} program;

static program program_make(unsigned long long *seed)
{
    program made;
    made.count = 0;
    for (int i = 0; i < ACTS; i++) {
        made.deeds[made.count] = (deed)random_below(seed, DEEDS);
        made.seeds[made.count++] = (unsigned long long)(1e9 * check_random(seed)) + 1;
        made.deeds[made.count] = STEP;
        made.seeds[made.count++] = 1;
    }
    return made;
}

/* One call where memory may run out: then nothing has changed, and it is made again. */
static sb_result deed_under_pressure(whole *w, deed what, unsigned long long seed, int at, sb_error *error)
{
    uint64_t before = sb_body_state_hash(w->body);
    whole kept = *w;
    sb_result result;
    w->memory.fail_at = w->memory.calls + 1 + at;
    result = do_deed(w, what, seed, error);
    w->memory.fail_at = 0;
    if (result != SB_ERROR_MEMORY)
        return result;
    CHECK(sb_body_state_hash(w->body) == before);
    kept.memory = w->memory;
    *w = kept;
    return do_deed(w, what, seed, error);
}

static void check_scene(int number, int aloud)
{
    scene_plan plan;
    whole first, second, third, fourth;
    program all;
    sb_recording *recording = NULL;
    sb_recording_report report;
    int failures = check.failures, from, fine, loaded = 0;
    unsigned long long seed;
    plan_make(&plan, (unsigned long long)number);
    seed = plan.seed;
    all = program_make(&seed);
    from = random_below(&seed, all.count);
    fine = whole_make(&first, &plan, 0);
    fine &= whole_make(&second, &plan, 2);
    fine &= whole_make(&third, &plan, 7);
    fine &= whole_make(&fourth, &plan, 0);
    fine = fine && CHECK_OK(sb_recording_start(first.body, 1, NULL, &recording, NULL));
    for (int i = 0; i < all.count && fine && check.failures == failures; i++) {
        deed what = all.deeds[i];
        uint64_t before = sb_body_state_hash(first.body);
        int calls = first.memory.calls, pressed = random_below(&seed, 3) == 0;
        sb_error error, other;
        sb_result result;
        memset(&error, 0, sizeof error);
        result = pressed && may_allocate(&plan, what)
                     ? deed_under_pressure(&first, what, all.seeds[i], random_below(&seed, 8), &error)
                     : do_deed(&first, what, all.seeds[i], &error);
        if (aloud)
            printf("%2d %s: %d %s\n", i, deed_names[what], (int)result, result == SB_OK ? "" : error.message);
        if (!may_allocate(&plan, what))
            CHECK_INT(first.memory.calls, calls);
        if (result != SB_OK)
            CHECK(sb_body_state_hash(first.body) == before);
        CHECK(is_finite(&first));
        CHECK_RESULT(do_deed(&second, what, all.seeds[i], &other), result);
        CHECK(sb_body_state_hash(second.body) == sb_body_state_hash(first.body));
        check_marks(&first, &second);
        if (loaded) {
            CHECK_RESULT(do_deed(&third, what, all.seeds[i], &other), result);
            CHECK(sb_body_state_hash(third.body) == sb_body_state_hash(first.body));
        }
        if (i == from) {
            size_t size = sb_body_state_size(first.body);
            void *state = malloc(size);
            loaded = CHECK_OK(sb_body_state_save(first.body, state, size)) &&
                     CHECK_OK(sb_body_state_load(third.body, state, size, &error));
            CHECK(sb_body_state_hash(third.body) == sb_body_state_hash(first.body));
            memcpy(third.command, first.command, sizeof third.command);
            third.stroke = first.stroke;
            third.load = first.load;
            free(state);
        }
        if (check.failures != failures)
            printf("scene %d, call %d, %s: %s\n", number, i, deed_names[what], error.message);
    }
    sb_recording_stop(recording);
    if (fine && check.failures == failures) {
        memset(&report, 0, sizeof report);
        if (!CHECK_OK(sb_recording_replay(recording, fourth.body, &report)))
            printf("step %d, command %d: %s\n", report.step, report.commands, report.error.message);
        CHECK(sb_body_state_hash(fourth.body) == sb_body_state_hash(first.body));
    }
    sb_recording_destroy(recording);
    if (check.failures != failures)
        printf(
            "scene %d: unit %g, integrator %d, newton %d, dt %g, needles %d, cuts %d front %d lattice %d, contact %d\n",
            number, plan.unit, (int)plan.def.integrator, plan.def.max_newton, plan.dt, plan.needles, plan.cuts,
            plan.front, plan.lattice, plan.contact);
    whole_free(&first);
    whole_free(&second);
    whole_free(&third);
    whole_free(&fourth);
    sb_mesh_free(&plan.mesh);
}

static void test_programs(void)
{
    const char *one = getenv("WHOLE_SCENE"), *more = getenv("CHECK_SLOW");
    int count = check_quick() ? 3 : 12 * (more && atoi(more) > 0 ? atoi(more) : 1);
    int from = one ? atoi(one) : 0;
    for (int i = from; i < (one ? from + 1 : count); i++)
        check_scene(i, one != NULL);
}

CHECK_SUITE(whole_scene, {"random programs", test_programs});
