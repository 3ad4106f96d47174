/* soak: random sessions that go on and on, on every element.
 *
 *     soak        SOAK_STEPS=1000000 for each row, or SOAK_SECONDS=20 for all rows together
 *
 * A session is a sequence of phases. In each, tools grip nodes at random, drag them about and let go, forces come and
 * go, the time step and the material change. Then everything is let go, and the body must come back to rest in its
 * own shape. In every eighth phase the tools tear the body inside out; of that it need not recover (elements may be
 * caught inside out by their neighbours: `caught` counts such phases, `restless` those of them that ended in a motion
 * which does not die down), and is then reset. Throughout: no NaN, no allocation by a step, no memory that grows, and
 * a saved state that leads to the same bits as the run it was taken from. Ends with `N passed, N failed, N skipped`,
 * one test per row. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "check.h"
#include "scene.h"

#include <time.h>

check_state check;

/* ---- what is soaked ---- */

typedef struct soak_row {
    const char *name;
    sb_element_type type;
    int nx, ny, nz;
    int single_rotation;
    sb_integrator integrator;
    sb_material (*material)(sb_real young, sb_real poisson, sb_real density);
    sb_integration integration;
    int rich; /* 1: two boxes that are tied, with springs and pressure on the second */
} soak_row;

/* A new element or integrator is one more line. */
static const soak_row rows[] = {
    {"tet4", SB_TET4, 3, 1, 1, 0, SB_EULER, sb_material_corotated, SB_INTEGRATION_AUTO, 0},
    {"tet10", SB_TET10, 1, 1, 1, 0, SB_EULER, sb_material_corotated, SB_INTEGRATION_AUTO, 0},
    {"tet10 single rotation", SB_TET10, 1, 1, 1, 1, SB_EULER, sb_material_corotated, SB_INTEGRATION_AUTO, 0},
    {"hex8", SB_HEX8, 3, 1, 1, 0, SB_EULER, sb_material_corotated, SB_INTEGRATION_AUTO, 0},
    {"hex8 B-bar", SB_HEX8, 2, 1, 1, 0, SB_EULER, sb_material_corotated, SB_INTEGRATION_BBAR, 0},
    {"hex20", SB_HEX20, 1, 1, 1, 0, SB_EULER, sb_material_corotated, SB_INTEGRATION_AUTO, 0},
    {"hex27", SB_HEX27, 1, 1, 1, 0, SB_EULER, sb_material_corotated, SB_INTEGRATION_AUTO, 0},
    {"tet4 stable neo-Hookean", SB_TET4, 2, 1, 1, 0, SB_EULER, sb_material_stable_neo_hookean, SB_INTEGRATION_AUTO, 0},
    {"tet4 springs, pressure, tie", SB_TET4, 1, 1, 1, 0, SB_EULER, sb_material_corotated, SB_INTEGRATION_AUTO, 1},
    {"hex8 springs, pressure, tie", SB_HEX8, 1, 1, 1, 0, SB_EULER, sb_material_corotated, SB_INTEGRATION_AUTO, 1},
};
enum { ROWS = sizeof rows / sizeof rows[0] };

enum {
    TOOLS = 3,
    DRAG_STEPS = 400, /* of a phase */
    REST_STEPS = 200, /* after it, at most, to come back to rest */
    ROUND_TRIP = 25   /* steps after a saved state that are played again */
};

typedef struct soak_tool {
    int node, axes; /* axes 0: lets go */
    sb_vec3 at, goal;
} soak_tool;

typedef struct soak {
    const soak_row *row;
    sb_mesh mesh;
    sb_body *body;
    scene_memory memory;
    unsigned long long seed;
    sb_real size; /* of the body (m) */
    soak_tool tools[TOOLS];
    long steps, failed_steps, phases, round_trips, caught, restless;
    void *state;
    size_t state_size;
    int split;             /* rich: first node of the second box, */
    int springs, pressure; /* and the loads on it */
    sb_vec3 anchors[2];    /* points of the springs at rest (m) */
    int live, calls;       /* allocations held, and made, when the body had been created */
} soak;

static double soak_random(soak *s, double low, double high) { return check_random_in(&s->seed, low, high); }
static int soak_choice(soak *s, int count) { return (int)(check_random(&s->seed) * count) % count; }

static sb_vec3 soak_vector(soak *s, double size)
{
    double x = soak_random(s, -size, size), y = soak_random(s, -size, size), z = soak_random(s, -size, size);
    return sb_v3(REAL(x), REAL(y), REAL(z));
}

/* ---- the second box of a rich row ---- */

static void soak_append_box(soak *s)
{
    const soak_row *row = s->row;
    sb_mesh second = scene_box(row->type, row->nx, row->ny, row->nz, sb_v3(REAL(0.1), REAL(0.05), REAL(0.05)), 0);
    for (int i = 0; i < second.node_count; i++)
        second.nodes[i].x += REAL(0.1);
    s->split = s->mesh.node_count;
    CHECK_OK(sb_mesh_append(&s->mesh, &second, NULL));
    sb_mesh_free(&second);
}

/* Faces of the surface with corners in [from, to) and x at a value. Returns their number. */
static int soak_faces(const soak *s, int from, int to, double x, int *faces, int corners)
{
    sb_boundary boundary;
    int count = 0;
    if (!CHECK_OK(sb_mesh_boundary(&s->mesh, 0, NULL, &boundary, NULL)))
        return 0;
    for (int f = 0; f < boundary.surface.element_count && count < 8; f++) {
        const int *face = boundary.surface.elements + f * sb_element_node_count(boundary.surface.element_type);
        int inside = 1;
        for (int k = 0; k < corners; k++)
            inside &= face[k] >= from && face[k] < to && fabs((double)s->mesh.nodes[face[k]].x - x) < 1e-6;
        for (int k = 0; k < corners && inside; k++)
            faces[count * corners + k] = face[k];
        count += inside;
    }
    sb_boundary_free(&boundary);
    return count;
}

/* Ties the boxes, presses on the far end and holds two of its corners with springs at rest. */
static void soak_enrich(soak *s)
{
    int corners = s->row->type == SB_HEX8 ? 4 : 3, faces[32], slaves[8], ends[2] = {0, 0}, slave_count = 0;
    int face_count = soak_faces(s, 0, s->split, 0.1, faces, corners);
    sb_real stiffness = REAL(20);
    for (int i = s->split; i < s->mesh.node_count; i++) {
        if (s->mesh.nodes[i].x < REAL(0.101))
            slaves[slave_count++] = i;
        else
            ends[i & 1] = i;
    }
    CHECK_OK(sb_body_tie_faces(s->body, faces, face_count, corners, slaves, slave_count, REAL(0.001), SB_TIE_ALL, NULL,
                               NULL));
    face_count = soak_faces(s, s->split, s->mesh.node_count, 0.2, faces, corners);
    CHECK_OK(sb_body_add_pressure(s->body, faces, face_count, corners, 0, &s->pressure, NULL));
    for (int k = 0; k < 2; k++)
        s->anchors[k] = s->mesh.nodes[ends[k]];
    CHECK_OK(sb_body_add_springs(s->body, ends, 2, &stiffness, 1, s->anchors, &s->springs, NULL));
}

/* Springs to other points, another pressure; `size` 0: at rest. */
static void soak_change_loads(soak *s, double size)
{
    sb_vec3 points[2];
    for (int k = 0; k < 2; k++)
        points[k] = sb_v3_add(s->anchors[k], soak_vector(s, size));
    CHECK_OK(sb_body_move_springs(s->body, s->springs, points));
    CHECK_OK(sb_body_set_pressure(s->body, s->pressure, REAL(soak_random(s, -1, 1) * size * 1e4)));
}

static int soak_begin(soak *s, const soak_row *row)
{
    sb_body_def def = sb_default_body_def();
    memset(s, 0, sizeof *s);
    s->row = row;
    s->seed = 12345;
    s->size = REAL(0.1);
    s->mesh = scene_box(row->type, row->nx, row->ny, row->nz, sb_v3(REAL(0.1), REAL(0.05), REAL(0.05)), 0);
    if (row->rich)
        soak_append_box(s);
    def.mesh = &s->mesh;
    def.integration = row->integration;
    def.material = row->material(REAL(2e4), REAL(0.4), REAL(1000));
    def.single_rotation = row->single_rotation;
    def.integrator = row->integrator;
    def.damping_mass = REAL(1);
    def.damping_stiffness = REAL(0.02);
    def.max_iterations = 100;
    def.allocator = scene_allocator(&s->memory);
    s->body = scene_body(&def);
    if (!s->body)
        return 0;
    scene_fix_plane(s->body, &s->mesh, 0, 0, SB_XYZ);
    if (row->rich)
        soak_enrich(s);
    s->live = s->memory.live;
    s->calls = s->memory.calls;
    s->state_size = sb_body_state_size(s->body);
    s->state = malloc(s->state_size);
    return s->state != NULL;
}

static void soak_end(soak *s)
{
    free(s->state);
    sb_body_destroy(s->body);
    sb_mesh_free(&s->mesh);
    CHECK_INT(s->memory.live, 0);
}

/* ---- a step and what must hold after it ---- */

static void soak_step(soak *s, sb_real dt)
{
    int calls = s->memory.calls;
    sb_step_info info;
    if (sb_body_step(s->body, dt, &info) != SB_OK)
        s->failed_steps++;
    s->steps++;
    CHECK_INT(s->memory.calls, calls);
    if (!scene_all_finite(sb_body_displacements(s->body), s->mesh.node_count) ||
        !scene_all_finite(sb_body_velocities(s->body), s->mesh.node_count) ||
        !scene_all_finite(sb_body_reactions(s->body), s->mesh.node_count)) {
        check.failures++;
        printf("  %s, step %ld: the body is not finite\n", s->row->name, s->steps);
    }
}

static sb_real soak_dt(soak *s)
{
    static const double steps[] = {1.0 / 1000, 1.0 / 240, 1.0 / 60, 1.0 / 60, 1.0 / 60, 1.0 / 30};
    return REAL(steps[soak_choice(s, 6)]);
}

/* ---- the hands ---- */

/* Neither held for good nor a slave of the tie. */
static int soak_is_free(const soak *s, int node)
{
    sb_real x = s->mesh.nodes[node].x;
    return x > REAL(1e-6) * s->size && !(s->row->rich && node >= s->split && x < REAL(0.101));
}

static void soak_let_go(soak *s, soak_tool *tool)
{
    if (tool->axes)
        CHECK_OK(sb_body_release_nodes(s->body, &tool->node, 1, SB_XYZ));
    tool->axes = 0;
}

static int soak_is_wild(const soak *s) { return s->phases % 8 == 7; }

/* One of the tools grips another node, or lets go, or goes for another goal. */
static void soak_move_hand(soak *s)
{
    soak_tool *tool = s->tools + soak_choice(s, TOOLS);
    int node = soak_choice(s, s->mesh.node_count);
    if (soak_choice(s, 3) == 0) {
        soak_let_go(s, tool);
    } else if (!tool->axes && soak_is_free(s, node)) {
        for (int k = 0; k < TOOLS; k++)
            if (s->tools[k].axes && s->tools[k].node == node)
                return;
        tool->node = node;
        tool->axes = 1 + soak_choice(s, SB_XYZ);
        tool->at = tool->goal = sb_body_displacements(s->body)[node];
        CHECK_OK(sb_body_fix_nodes(s->body, &node, 1, tool->axes));
    }
    tool->goal = soak_vector(s, (soak_is_wild(s) ? 2.0 : 0.25) * (double)s->size);
}

/* Tools go a twentieth of their way per step; wild ones jump now and then. */
static void soak_drag(soak *s)
{
    for (int k = 0; k < TOOLS; k++) {
        soak_tool *tool = s->tools + k;
        sb_real share = soak_is_wild(s) && soak_choice(s, 100) == 0 ? REAL(1) : REAL(0.05);
        if (!tool->axes)
            continue;
        tool->at = sb_v3_madd(tool->at, share, sb_v3_sub(tool->goal, tool->at));
        CHECK_OK(sb_body_prescribe(s->body, &tool->node, 1, tool->axes, &tool->at, 1));
    }
}

static void soak_set_material(soak *s, double young)
{
    sb_material material = s->row->material(REAL(young), REAL(0.4), REAL(1000));
    CHECK_OK(sb_body_set_material(s->body, &material, NULL));
}

/* Something else that users do. */
static void soak_surprise(soak *s)
{
    int node = soak_choice(s, s->mesh.node_count);
    sb_vec3 force = soak_vector(s, 0.2);
    switch (soak_choice(s, 6)) {
    case 0: CHECK_OK(sb_body_add_forces(s->body, &node, 1, &force, 1)); break;
    case 1: sb_body_clear_loads(s->body); break;
    case 2: soak_set_material(s, soak_random(s, 5e3, 5e4)); break;
    case 3: CHECK_OK(sb_body_set_gravity(s->body, soak_vector(s, 10))); break;
    case 4:
        CHECK_OK(sb_body_set_damping(s->body, REAL(soak_random(s, 0, 2)), REAL(soak_random(s, 0.005, 0.03))));
        break;
    default: CHECK_OK(sb_body_set_solver(s->body, REAL(soak_random(s, 1e-5, 1e-2)), 20 + soak_choice(s, 100))); break;
    }
}

static void soak_act(soak *s)
{
    if (soak_choice(s, 15) == 0)
        soak_move_hand(s);
    if (soak_choice(s, 40) == 0)
        soak_surprise(s);
    if (s->row->rich && soak_choice(s, 25) == 0)
        soak_change_loads(s, 0.02);
    soak_drag(s);
}

/* ---- phases ---- */

/* The same actions from a saved state lead to the same bits. */
static void soak_round_trip(soak *s)
{
    soak before;
    uint64_t hash = 0;
    CHECK(sb_body_state_size(s->body) == s->state_size);
    CHECK_OK(sb_body_state_save(s->body, s->state, s->state_size));
    before = *s;
    for (int again = 0; again < 2; again++) {
        if (again) {
            CHECK_OK(sb_body_state_load(s->body, s->state, s->state_size, NULL));
            s->seed = before.seed;
            memcpy(s->tools, before.tools, sizeof s->tools);
        }
        for (int i = 0; i < ROUND_TRIP; i++) {
            soak_act(s);
            soak_step(s, soak_dt(s));
        }
        if (!again)
            hash = sb_body_state_hash(s->body);
        else if (!CHECK(sb_body_state_hash(s->body) == hash))
            printf("  %s, step %ld: a loaded state goes on differently\n", s->row->name, s->steps);
    }
    s->round_trips++;
}

static double soak_distance_from_rest(const soak *s)
{
    double largest = 0;
    for (int i = 0; i < s->mesh.node_count; i++)
        largest = sb_max(largest, (double)sb_v3_norm(sb_body_displacements(s->body)[i]));
    return largest / (double)s->size;
}

/* Speed of the fastest node, in sizes of the body per second. */
static double soak_speed(const soak *s)
{
    double largest = 0;
    for (int i = 0; i < s->mesh.node_count; i++)
        largest = sb_max(largest, (double)sb_v3_norm(sb_body_velocities(s->body)[i]));
    return largest / (double)s->size;
}

/* All hands off: the body comes back. */
static void soak_rest(soak *s)
{
    for (int k = 0; k < TOOLS; k++)
        soak_let_go(s, s->tools + k);
    sb_body_clear_loads(s->body);
    if (s->row->rich)
        soak_change_loads(s, 0);
    soak_set_material(s, 2e4);
    CHECK_OK(sb_body_set_gravity(s->body, sb_v3(0, 0, 0)));
    CHECK_OK(sb_body_set_damping(s->body, REAL(1), REAL(0.02)));
    CHECK_OK(sb_body_set_solver(s->body, REAL(1e-3), 100));
    for (int i = 0; i < REST_STEPS && soak_distance_from_rest(s) > 1e-3; i++)
        soak_step(s, REAL(1.0 / 30));
    if (soak_is_wild(s) && soak_distance_from_rest(s) > 1e-3) {
        s->caught++;
        s->restless += soak_speed(s) > 1e-3;
        sb_body_reset(s->body);
    } else if (!CHECK(soak_distance_from_rest(s) <= 1e-3))
        printf("  %s, step %ld: %g of its size away from rest\n", s->row->name, s->steps, soak_distance_from_rest(s));
}

static void soak_phase(soak *s)
{
    sb_real dt = soak_dt(s);
    for (int i = 0; i < DRAG_STEPS; i++) {
        soak_act(s);
        soak_step(s, dt);
    }
    soak_round_trip(s);
    soak_rest(s);
    s->phases++;
    CHECK(s->memory.live <= s->live + 1);    /* the supports' blocks, */
    CHECK(s->memory.calls <= s->calls + 20); /* which grow geometrically and have a bound */
}

static int soak_row_run(const soak_row *row, long steps, double seconds)
{
    soak s;
    clock_t start = clock();
    double spent = 0;
    long told = 0;
    check.failures = 0;
    check.test = row->name;
    if (soak_begin(&s, row))
        while (check.failures < 20 && (seconds > 0 ? spent < seconds : s.steps < steps)) {
            soak_phase(&s);
            spent = (double)(clock() - start) / (double)CLOCKS_PER_SEC;
            if (s.steps / 100000 != told) {
                told = s.steps / 100000;
                printf("  %s: %ld steps, %ld refused, %ld phases, %.0f s\n", row->name, s.steps, s.failed_steps,
                       s.phases, spent);
                fflush(stdout);
            }
        }
    soak_end(&s);
    printf("%-28s %9ld steps %6ld refused %6ld phases %4ld caught %4ld restless %6ld round trips %8.1f s %s\n",
           row->name, s.steps, s.failed_steps, s.phases, s.caught, s.restless, s.round_trips, spent,
           check.failures ? "FAILED" : "ok");
    fflush(stdout);
    return check.failures == 0;
}

int main(void)
{
    const char *steps = getenv("SOAK_STEPS"), *seconds = getenv("SOAK_SECONDS");
    int passed = 0;
    for (int i = 0; i < ROWS; i++)
        passed += soak_row_run(rows + i, steps && *steps ? strtol(steps, NULL, 10) : 1000000,
                               seconds && *seconds ? strtod(seconds, NULL) / (double)ROWS : 0);
    printf("%d passed, %d failed, 0 skipped\n", passed, ROWS - passed);
    return passed != ROWS;
}
