/* Glue between pieces with next to no material: blades that go along nodes, faces and the boundary of the mesh, or a
 * hair beside them, and stop within elements. CHECK_SLOW=n: n times as many. CUT_FLAT=n runs scene n alone. */
#include "cut_blade.h"

enum { FRAMES = 6, STEPS = 3 };

typedef struct flat_scene {
    block b;
    sb_real dt, speed; /* speed: bound of what a sane motion reaches (m/s) */
    blade of;
    char name[160];
    int number;
} flat_scene;

static double random_log(unsigned long long *seed, double low, double high)
{
    return exp(check_random_in(seed, log(low), log(high)));
}

static int pick(unsigned long long *seed, int count) { return (int)(check_random(seed) * count); }

/* A plane along the mesh: a face of an element, nodes across an axis, or a side of the block, moved by nothing or a
 * hair. */
static blade blade_along(const sb_mesh *mesh, unsigned long long *seed, double *offset)
{
    static const double offsets[] = {0, 0, 0, 1e-16, 1e-13, 1e-10, 1e-9, 1e-8, 1e-7, 1e-5, 1e-3};
    int kind = pick(seed, 3), axis = pick(seed, 3);
    sb_vec3 node = mesh->nodes[pick(seed, mesh->node_count)], middle = sb_v3_scale(REAL(0.5), block_size), normal;
    *offset = offsets[pick(seed, 11)] * (check_random(seed) < 0.5 ? -1 : 1);
    if (kind == 0) {
        const int *cell =
            mesh->elements + (size_t)sb_mesh_element_width(mesh) * (size_t)pick(seed, mesh->element_count);
        sb_vec3 a = mesh->nodes[cell[0]], b = mesh->nodes[cell[1 + pick(seed, 2)]], c = mesh->nodes[cell[3]];
        normal = sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(c, a));
        middle = a;
    } else {
        normal = sb_v3(REAL(axis == 0), REAL(axis == 1), REAL(axis == 2));
        if (kind == 2)
            node = pick(seed, 2) ? block_size : sb_v3(0, 0, 0);
        middle = sb_v3_madd(middle, sb_v3_dot(sb_v3_sub(node, middle), normal), normal);
    }
    normal = sb_v3_scale((check_random(seed) < 0.5 ? -1 : 1) / sb_v3_norm(normal), normal);
    middle = sb_v3_madd(middle, REAL(*offset) * block_size.x, normal);
    return blade_make(middle, normal, check_random(seed) < 0.3 ? 0 : check_random_in(seed, 0, 6.28));
}

static int flat_make(flat_scene *s, int number)
{
    static const sb_integrator integrators[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
    unsigned long long seed = 0x9E3779B97F4A7C15ULL * (unsigned long long)(number + 1);
    sb_body_def def = sb_default_body_def();
    int lattice, model, element, cells[3];
    double offset;
    for (int i = 0; i < 8; i++)
        check_random(&seed);
    memset(s, 0, sizeof *s);
    s->number = number;
    element = pick(&seed, 4) == 0;
    for (int k = 0; k < 3; k++)
        cells[k] = (element ? 1 : 2) + pick(&seed, 2);
    s->b.mesh = scene_box(element ? SB_TET10 : SB_TET4, cells[0] + 1, cells[1], cells[2], block_size,
                          element == 0 && pick(&seed, 3) == 0 ? 0.2 : 0);
    def.mesh = &s->b.mesh;
    model = pick(&seed, 3);
    def.material = model == 0   ? sb_material_corotated(REAL(5000), REAL(0.4), 1000)
                   : model == 1 ? sb_material_stable_neo_hookean(REAL(5000), REAL(0.4), 1000)
                                : sb_material_linear(REAL(5000), REAL(0.4), 1000);
    def.slack = 4;
    def.integrator = integrators[pick(&seed, 3)];
    def.max_newton = pick(&seed, 2) ? 1 : 10;
    def.damping_stiffness = REAL(pick(&seed, 2) ? 0 : 0.002);
    def.gravity = sb_v3(REAL(0.7), REAL(-0.5), REAL(-2));
    def.tolerance = REAL(scene_tolerance(1e-8, 1e3));
    s->dt = REAL(0.004);
    s->b.body = scene_body(&def);
    if (s->b.body && !element && pick(&seed, 3) == 0)
        CHECK_OK(sb_body_keep_tangent(s->b.body, REAL(0.1), NULL));
    lattice = intervals_of[pick(&seed, element ? 2 : 3)];
    block_cut_create_with(&s->b, lattice, SB_CUT_GLUE);
    s->of = blade_along(&s->b.mesh, &seed, &offset);
    snprintf(s->name, sizeof s->name,
             "scene %d: %s, lattice %d, model %d, integrator %d, newton %d, damping %g, offset %g", number,
             element ? "tet10" : "tet4", lattice, model, (int)def.integrator, def.max_newton,
             (double)def.damping_stiffness, offset);
    return s->b.body && s->b.cut;
}

static int idle_ties(const sb_body *body)
{
    int count = 0;
    const sbi_glue *glue = &body->live->glue;
    for (int k = 0; k < glue->count; k++) {
        int idle = 0;
        for (int i = 0; i < 2 * glue->nodes; i++)
            idle |= body->node_component[glue->ties[k].nodes[i % 2][i / 2]] < 0;
        count += idle;
    }
    return count;
}

static const sb_vec3 pull = {REAL(0.7), REAL(-0.5), REAL(-2)}; /* m/s^2 */

/* What a step may not do: lose momentum but for what gravity gives it, throw anything, or make energy. */
typedef struct flat_watch {
    double drift, fastest, made, farthest; /* of gravity; m/s; of the energy that there is; of the size */
} flat_watch;

static double energy_of(sb_body *body)
{
    sb_energy energy;
    double sum = 0;
    CHECK_OK(sb_body_energy(body, &energy));
    for (int i = 0; i < sb_body_node_count(body); i++)
        sum -= (double)body->lumped_mass[i] * (double)sb_v3_dot(pull, body->position[i]);
    return (double)energy.elastic + (double)energy.kinetic + sum;
}

static int step_watched(flat_scene *s, flat_watch *watch)
{
    sb_body *body = s->b.body;
    sb_vec3 before = sb_body_momentum(body), gain;
    double mass = (double)sb_body_mass(body), energy = energy_of(body);
    sb_step_info info;
    if (!CHECK_OK(sb_body_step(body, s->dt, &info))) {
        printf("%s: %s\n", s->name, info.error.message);
        return 0;
    }
    gain = sb_v3_sub(sb_v3_sub(sb_body_momentum(body), before), sb_v3_scale(s->dt * REAL(mass), pull));
    watch->drift = fmax(watch->drift, (double)(sb_v3_norm(gain) / (s->dt * sb_v3_norm(pull))) / mass);
    for (int k = 0; k < sb_body_node_count(body); k++) {
        sb_vec3 way = sb_body_displacements(body)[k];
        watch->fastest = fmax(watch->fastest, (double)sb_v3_norm(sb_body_velocities(body)[k]));
        watch->farthest = fmax(watch->farthest, (double)(sb_v3_norm(way) / block_size.x));
    }
    watch->made = fmax(watch->made, (energy_of(body) - energy) / (mass * (double)s->speed * (double)s->speed));
    return 1;
}

/* A stroke to somewhere within the block, with steps between its frames. */
static void stroke_along(flat_scene *s, const blade *of, double end, flat_watch *watch)
{
    sb_vec3 edge[CORNERS];
    sb_error error;
    int stroke = begin(&s->b, of), fine = 1;
    for (int frame = 1; frame <= FRAMES && fine; frame++) {
        blade_at(of, -1 + (end + 1) * frame / (int)FRAMES, edge);
        fine = CHECK_OK(sb_cut_move(s->b.cut, stroke, edge, NULL, &error));
        if (!fine)
            printf("%s: %s\n", s->name, error.message);
        for (int i = 0; i < STEPS && fine; i++)
            fine = step_watched(s, watch);
    }
    sb_cut_end(s->b.cut, stroke);
}

/* A state goes on in another body as in this one. */
static void check_saved(const flat_scene *s)
{
    flat_scene other;
    size_t size;
    void *state = state_of(&s->b, &size);
    if (flat_make(&other, s->number) && state) {
        load(&other.b, state, size);
        for (int i = 0; i < STEPS; i++) {
            sb_result result = sb_body_step(s->b.body, s->dt, NULL);
            CHECK_RESULT(sb_body_step(other.b.body, s->dt, NULL), result);
        }
        CHECK(sb_body_state_hash(other.b.body) == sb_body_state_hash(s->b.body));
    }
    block_free(&other.b);
    free(state);
}

/* Whether cells alone hold a body together, and its glued parts do not swing on a tie or two. */
static int holds_without_glue(const sb_body *body)
{
    int n = sb_body_node_count(body), width = body->domain.nodes_per_cell, parts = 0, changed = 1;
    int *part = (int *)malloc((size_t)n * sizeof *part);
    for (int i = 0; i < n; i++)
        part[i] = i;
    while (changed) {
        changed = 0;
        for (int e = 0; e < sb_body_element_count(body); e++)
            for (int a = 0; sb_body_cell_in_use(body, e) && a < width; a++) {
                int *left = part + sb_body_cell_nodes(body, e)[0], *right = part + sb_body_cell_nodes(body, e)[a];
                changed |= *left != *right;
                *left = *right = *left < *right ? *left : *right;
            }
    }
    for (int i = 0; i < n; i++)
        parts += part[i] == i && body->node_component[i] >= 0;
    free(part);
    return parts == 1;
}

/* Clamped on one side, what hangs together finds its rest under gravity. */
static void check_static(const flat_scene *s)
{
    sb_body *body = s->b.body;
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    sb_vec3 *rest = (sb_vec3 *)calloc((size_t)sb_body_node_count(body), sizeof *rest);
    double most = 0;
    CHECK_OK(sb_body_set_displacements(body, rest));
    CHECK_OK(sb_body_set_gravity(body, sb_v3_scale(REAL(0.05), pull)));
    for (int i = 0; i < sb_body_node_count(body); i++)
        if (body->node_component[i] >= 0 && body->reference[i].z < REAL(1e-6))
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
    options.tolerance = REAL(scene_tolerance(1e-6, 1e2));
    if (body->component_count == 1 && holds_without_glue(body)) {
        if (!CHECK_OK(sb_body_solve_static(body, &options, &info)))
            printf("%s: static: %s\n", s->name, info.error.message);
        for (int i = 0; i < sb_body_node_count(body); i++)
            most = fmax(most, (double)(sb_v3_norm(sb_body_displacements(body)[i]) / block_size.x));
        if (!CHECK(most < 0.5))
            printf("%s: static way %g\n", s->name, most);
    }
    free(rest);
}

/* A block that falls freely, and shakes, is cut twice. */
static void check_fall(int number)
{
    unsigned long long seed = (unsigned long long)number * 31 + 77;
    flat_scene s;
    flat_watch watch = {0, 0, 0, 0};
    double offset;
    blade second;
    int failures = check.failures;
    if (!flat_make(&s, number))
        return;
    s.speed = REAL(check_random(&seed) < 0.3 ? 0 : random_log(&seed, 0.01, 0.2));
    if (s.speed > 0)
        block_shake_at(&s.b, (double)s.speed);
    s.speed += REAL(0.05);
    stroke_along(&s, &s.of, check_random_in(&seed, -0.6, 0.6), &watch);
    second = s.of;
    switch (pick(&seed, 4)) {
    case 0: /* back to front */ second.along = sb_v3_scale(-1, second.along); break;
    case 1: /* a hair beside it */
        second.middle = sb_v3_madd(second.middle, REAL(1e-9 * (pick(&seed, 2) ? 1 : -1)),
                                   sb_v3_scale(1 / sb_v3_norm(second.along), sb_v3_perpendicular(second.along)));
        break;
    case 2: /* from the other end */ second.ahead = sb_v3_scale(-1, second.ahead); break;
    default: second = blade_along(&s.b.mesh, &seed, &offset);
    }
    stroke_along(&s, &second, check_random_in(&seed, -0.6, 1), &watch);
    check_pieces(&s.b);
    CHECK_NEAR(watch.drift, 0, 1e-3);
    if (s.b.body->integrator == SB_EULER) /* without damping light nodes ring */
        CHECK(watch.fastest < 0.5 + 5 * (double)s.speed);
    CHECK(watch.farthest < 1);
    CHECK(watch.made < 0.02);
    check_saved(&s);
    check_static(&s);
    if (check.failures != failures || getenv("CUT_FLAT") || idle_ties(s.b.body))
        printf("%s: %d parts, %d idle ties, glue %d, drift %g, fastest %g, made %g speed %g\n", s.name,
               s.b.body->component_count, idle_ties(s.b.body), s.b.body->live->glue.count, watch.drift, watch.fastest,
               watch.made, (double)s.speed);
    block_free(&s.b);
}

static void test_fall(void)
{
    const char *one = getenv("CUT_FLAT"), *more = getenv("CHECK_SLOW");
    int count = check_quick() ? 8 : 24 * (more && atoi(more) > 0 ? atoi(more) : 1);
    int first = one ? atoi(one) : 0;
    for (int i = first; i < (one ? first + 1 : count); i++)
        check_fall(i);
}

CHECK_SUITE(cut_flat, {"falls", test_fall});
