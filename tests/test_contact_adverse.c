/* test_contact_adverse: what no scene should have, on organs that nobody chose, of any element, material, size and
 * unit of length: tools that are made inside, are too thin, have no place, jump, squeeze to a tenth, and press what is
 * inside out. Errors are named and change nothing, all stays finite, and organs come back to their rest shape.
 * CHECK_SLOW=n: n organs; ORGAN=k: organ k alone. */
#include "contact_scene.h"
#include "random_case.h"

typedef struct organ {
    char name[160]; /* in words */
    press p;
    sb_vec3 up, low, high; /* the organ lies between these two along up (m) */
    sb_real size, dt;      /* m, s */
    sb_real longest;       /* m: edge between corners */
    double unit;           /* m that stand for 1 m */
    unsigned long long seed;
} organ;

static sb_material random_tissue(unsigned long long *seed, sb_real density, const char **name)
{
    sb_real young = REAL(random_scale(seed, 1e3, 1e5)), poisson = REAL(check_random_in(seed, 0, 0.47));
    switch (random_below(seed, 3)) {
    case 0: *name = "stable neo-Hookean"; return sb_material_stable_neo_hookean(young, poisson, density);
    case 1: *name = "invertible corotated"; return sb_material_corotated_invertible(young, poisson, density);
    default: *name = "corotated"; return sb_material_corotated(young, poisson, density);
    }
}

/* Lowest and highest point along `up`, and the longest edge. */
static void measure(organ *o, const sb_mesh *mesh)
{
    int width = sb_mesh_element_width(mesh), corners = sb_element_corner_count(mesh->element_type);
    o->low = o->high = mesh->nodes[0];
    for (int i = 0; i < mesh->node_count; i++) {
        if (sb_v3_dot(o->up, mesh->nodes[i]) < sb_v3_dot(o->up, o->low))
            o->low = mesh->nodes[i];
        if (sb_v3_dot(o->up, mesh->nodes[i]) > sb_v3_dot(o->up, o->high))
            o->high = mesh->nodes[i];
    }
    o->size = sb_v3_dot(o->up, sb_v3_sub(o->high, o->low));
    for (int e = 0; e < mesh->element_count; e++)
        for (int i = 0; i < corners * corners; i++) {
            const int *n = mesh->elements + (size_t)e * (size_t)width;
            o->longest =
                sb_max(o->longest, sb_v3_norm(sb_v3_sub(mesh->nodes[n[i / corners]], mesh->nodes[n[i % corners]])));
        }
}

/* Elements that reach below a height (m) are held whole, or one that hangs on an edge could turn. */
static void hold_below(const organ *o, sb_real height)
{
    int width = sb_mesh_element_width(&o->p.mesh);
    for (int e = 0; e < o->p.mesh.element_count; e++) {
        const int *n = o->p.mesh.elements + (size_t)e * (size_t)width;
        int below = 0;
        for (int a = 0; a < width; a++)
            below |= sb_v3_dot(o->up, sb_v3_sub(o->p.mesh.nodes[n[a]], o->low)) < height;
        if (below)
            CHECK_OK(sb_body_fix_nodes(o->p.body, n, width, SB_XYZ));
    }
}

/* Held: the lowest elements stay where they are. */
static void organ_make(organ *o, unsigned long long number, int held)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    const char *shape, *tissue;
    sb_mesh mesh;
    sb_quat turn;
    memset(o, 0, sizeof *o);
    o->seed = 0x9E3779B97F4A7C15ULL * (number + 77);
    for (int i = 0; i < 8; i++)
        check_random(&o->seed);
    shape = random_shape(&o->seed, types[random_below(&o->seed, 6)], &mesh);
    o->unit = random_scale(&o->seed, 1e-3, 1e3);
    turn = random_turn(&o->seed);
    for (int i = 0; i < mesh.node_count; i++) /* 0.1 m large */
        mesh.nodes[i] = sb_v3_scale(REAL(0.1 * o->unit), sb_quat_rotate(turn, mesh.nodes[i]));
    o->up = random_direction(&o->seed);
    measure(o, &mesh);
    o->dt = REAL(check_random_in(&o->seed, 0.005, 0.02));
    def.material = random_tissue(&o->seed, REAL(1000 / (o->unit * o->unit)), &tissue);
    def.damping_stiffness = REAL(random_scale(&o->seed, 5e-3, 3e-2));
    contact.max_contacts = 1 << 14;
    snprintf(o->name, sizeof o->name, "organ %llu: %s of %s, %.3g m, %s, dt %.3g ms", number, shape,
             sb_element_name(mesh.element_type), (double)o->size, tissue, 1e3 * (double)o->dt);
    o->p = press_make(mesh, def, contact);
    if (held)
        hold_below(o, o->size / 5);
}

/* The middle of an element. */
static sb_vec3 inside(organ *o)
{
    int width = sb_mesh_element_width(&o->p.mesh), element = random_below(&o->seed, o->p.mesh.element_count);
    sb_vec3 sum = {0, 0, 0};
    for (int a = 0; a < width; a++)
        sum = sb_v3_add(sum, o->p.mesh.nodes[o->p.mesh.elements[element * width + a]]);
    return sb_v3_scale(1 / (sb_real)width, sum);
}

/* A ball, a straight chain, or a box of that radius, at a place. */
static sb_tool_def make_tool(organ *o, int kind, sb_real radius, sb_vec3 chain[2], sb_vec3 at)
{
    sb_tool_def def = press_sphere((double)radius, check_random_in(&o->seed, 0, 0.8), at);
    def.pose.rotation = random_turn(&o->seed);
    if (kind == 1) {
        chain[0] = sb_v3(-3 * radius, 0, 0);
        chain[1] = sb_v3(3 * radius, 0, 0);
        def.shape = SB_TOOL_CAPSULES;
        def.points = chain;
        def.point_count = 2;
    } else if (kind == 2) {
        def.shape = SB_TOOL_BOX;
        def.half = sb_v3(2 * radius, radius, radius);
        def.radius = radius / 2;
    }
    return def;
}

/* The organ is at its rest shape again, as near as long steps bring it. */
static void check_recovers(organ *o)
{
    for (int i = 0; i < 40; i++)
        CHECK(press_try_step(&o->p, 20 * (double)o->dt));
    CHECK_INT(sb_contact_points(o->p.contact, NULL, 0), 0);
    CHECK_NEAR(scene_distance(sb_body_positions(o->p.body), o->p.mesh.nodes, o->p.mesh.node_count), 0,
               1e-3 * (double)o->size);
}

/* Far from all, at once. */
static void take_away(organ *o, int tool)
{
    sb_pose pose = press_pose(sb_v3_madd(o->high, 20 * o->size, o->up), sb_quat_identity());
    CHECK_OK(sb_contact_place_tool(o->p.contact, tool, &pose, NULL));
}

/* ---- made inside, too thin, nowhere ---- */

static void adverse_inside(unsigned long long number)
{
    organ o;
    sb_error error;
    sb_vec3 chain[2];
    organ_make(&o, number, 1);
    for (int kind = 0; kind < 3; kind++) {
        sb_tool_def def = make_tool(&o, kind, sb_max(o.size / 3, o.longest), chain, o.high), small; /* half inside */
        uint64_t hash = sb_body_state_hash(o.p.body);
        int tool = -1;
        CHECK_RESULT(sb_contact_add_tool(o.p.contact, &def, &tool, &error), SB_ERROR_ARGUMENT);
        CHECK(tool == -1 && error.message[0] && error.element >= 0 && error.element < o.p.mesh.element_count);
        CHECK(sb_body_state_hash(o.p.body) == hash);
        small = make_tool(&o, kind, o.longest / 7, chain, inside(&o)); /* where it may touch no face */
        CHECK(sb_contact_add_tool(o.p.contact, &small, &tool, &error) != SB_OK);
        CHECK(error.message[0] && (error.result == SB_ERROR_ARGUMENT || error.result == SB_ERROR_UNSUPPORTED));
        CHECK(tool == -1 && sb_body_state_hash(o.p.body) == hash);
    }
    press_free(&o.p);
}

/* Ever thinner chains, until one is refused; the last that is not presses. */
static void adverse_thin(unsigned long long number)
{
    organ o;
    sb_error error;
    sb_vec3 chain[2], from;
    sb_tool_def def;
    sb_real radius;
    int tool = -1, taken = 0;
    organ_make(&o, number, 1);
    from = sb_v3_madd(o.high, o.longest, o.up);
    for (radius = o.longest / 2; radius > o.longest / 200; radius /= 2) {
        sb_result result;
        def = make_tool(&o, 1, radius, chain, from);
        chain[0] = sb_v3(-o.size / 3, 0, 0), chain[1] = sb_v3(o.size / 3, 0, 0);
        def.pose.position = sb_v3_madd(from, o.size, o.up);
        result = sb_contact_add_tool(o.p.contact, &def, &tool, &error);
        if (result != SB_OK) {
            CHECK_RESULT(result, SB_ERROR_UNSUPPORTED);
            CHECK(strstr(error.message, "needle.h") != NULL);
            break;
        }
        taken++;
        CHECK_OK(sb_contact_remove_tool(o.p.contact, tool));
    }
    CHECK(taken > 0 && radius > o.longest / 200);
    radius *= 2;
    def = make_tool(&o, 1, radius, chain, sb_v3_madd(o.high, 2 * radius + o.size, o.up));
    chain[0] = sb_v3(-o.size / 3, 0, 0), chain[1] = sb_v3(o.size / 3, 0, 0);
    tool = press_add(&o.p, &def);
    for (int i = 0; i < 60; i++) { /* through the organ's place, faster than it may */
        press_move(&o.p, tool, sb_v3_madd(def.pose.position, -2 * o.size * REAL(i) / 60, o.up), def.pose.rotation);
        CHECK(press_try_step(&o.p, (double)o.dt));
    }
    take_away(&o, tool);
    check_recovers(&o);
    press_free(&o.p);
}

static void adverse_nowhere(unsigned long long number)
{
    organ o;
    sb_vec3 chain[2];
    sb_tool_def def;
    int tool;
    organ_make(&o, number, 1);
    def = make_tool(&o, (int)(number % 3), sb_max(o.size / 6, o.longest / 2), chain,
                    sb_v3_madd(o.high, 4 * sb_max(o.size, o.longest), o.up));
    tool = press_add(&o.p, &def);
    for (int k = 0; k < 14; k++) {
        sb_pose pose = def.pose;
        sb_real bad = k % 2 ? REAL(INFINITY) : REAL(NAN), *numbers[7];
        uint64_t hash = sb_body_state_hash(o.p.body);
        numbers[0] = &pose.position.x, numbers[1] = &pose.position.y, numbers[2] = &pose.position.z;
        numbers[3] = &pose.rotation.x, numbers[4] = &pose.rotation.y, numbers[5] = &pose.rotation.z;
        numbers[6] = &pose.rotation.w;
        *numbers[k / 2] = bad;
        CHECK_RESULT(sb_contact_move_tool(o.p.contact, tool, &pose), SB_ERROR_NOT_FINITE);
        CHECK_RESULT(sb_contact_place_tool(o.p.contact, tool, &pose, NULL), SB_ERROR_NOT_FINITE);
        CHECK(sb_body_state_hash(o.p.body) == hash);
    }
    CHECK(press_try_step(&o.p, (double)o.dt));
    press_free(&o.p);
}

/* Sent so far that its place is no longer known to its radius, and back into the organ: it is refused, or stops at the
 * surface as one that comes from near by. */
static void adverse_far(unsigned long long number)
{
    organ o;
    sb_vec3 chain[2], middle;
    sb_tool_def def;
    int tool, kind = (int)(number % 3), refused = 0, taken = 0;
    organ_make(&o, number, 1);
    middle = sb_v3_scale(REAL(0.5), sb_v3_add(o.low, o.high));
    def = make_tool(&o, kind, sb_max(o.size / 6, o.longest / 2), chain,
                    sb_v3_madd(o.high, 4 * sb_max(o.size, o.longest), o.up));
    tool = press_add(&o.p, &def);
    for (int i = 0; i < 12; i++) {
        const double sizes = pow(10, i == 0 ? 3 : check_random_in(&o.seed, 3, SB_REAL_IS_FLOAT ? 30 : 90));
        const sb_vec3 at = sb_v3_scale(REAL(sizes * (double)o.size), random_direction(&o.seed));
        const sb_pose pose = press_pose(at, random_turn(&o.seed));
        const uint64_t hash = sb_body_state_hash(o.p.body);
        sb_tool_def other = def;
        int made = -1;
        sb_result result = sb_contact_move_tool(o.p.contact, tool, &pose);
        other.pose = pose;
        CHECK(result == SB_OK ? sizes * (double)(o.size / def.radius) < 0.02 / (double)SB_EPSILON : sizes > 1e3);
        if (result != SB_OK) {
            sb_error error;
            refused++;
            CHECK_RESULT(result, SB_ERROR_ARGUMENT);
            CHECK_RESULT(sb_contact_place_tool(o.p.contact, tool, &pose, &error), SB_ERROR_ARGUMENT);
            CHECK(strstr(error.message, "far") != NULL);
            CHECK_RESULT(sb_contact_add_tool(o.p.contact, &other, &made, &error), SB_ERROR_ARGUMENT);
            CHECK(made == -1 && sb_body_state_hash(o.p.body) == hash);
            continue;
        }
        taken++;
        for (int k = 0; k < 3; k++)
            CHECK(press_try_step(&o.p, (double)o.dt));
        press_move(&o.p, tool, middle, pose.rotation);
        for (int k = 0; k < 3; k++) {
            sb_contact_info info;
            CHECK(press_try_step(&o.p, (double)o.dt));
            info = sb_contact_get_info(o.p.contact);
            CHECK(info.inside == 0 && info.deepest < def.radius);
        }
    }
    CHECK(taken > 0 && refused > 0);
    if (kind == 1) { /* the same of a point of its chain */
        const sb_vec3 way = sb_v3(REAL(1e30), 0, 0), points[2] = {chain[0], sb_v3_scale(o.size, way)};
        const uint64_t hash = sb_body_state_hash(o.p.body);
        CHECK_RESULT(sb_contact_bend_tool(o.p.contact, tool, points), SB_ERROR_ARGUMENT);
        CHECK(sb_body_state_hash(o.p.body) == hash);
    }
    take_away(&o, tool);
    check_recovers(&o);
    press_free(&o.p);
}

/* ---- tools that jump and squeeze ---- */

/* 0.3 m a frame of an organ of 0.1 m. */
static void adverse_jumps(unsigned long long number)
{
    organ o;
    sb_vec3 chain[2], middle;
    sb_tool_def def;
    int tool, good = 0, steps = 40;
    organ_make(&o, number, 1);
    middle = sb_v3_scale(REAL(0.5), sb_v3_add(o.low, o.high));
    def = make_tool(&o, (int)(number % 3), sb_max(o.size / 6, o.longest / 2), chain,
                    sb_v3_madd(o.high, 4 * sb_max(o.size, o.longest), o.up));
    tool = press_add(&o.p, &def);
    for (int i = 0; i < steps; i++) {
        sb_vec3 way = random_direction(&o.seed);
        double far = i % 3 ? 0.15 * o.unit : 0;
        press_move(&o.p, tool, sb_v3_madd(middle, REAL(far), way), random_turn(&o.seed));
        good += press_try_step(&o.p, (double)o.dt);
    }
    CHECK_INT(good, steps);
    take_away(&o, tool);
    check_recovers(&o);
    press_free(&o.p);
}

/* Two jaws close on a free organ to a tenth of its width, and open. */
static void adverse_squeeze(unsigned long long number)
{
    organ o;
    sb_real wide = 0, half, gap = 0;
    int jaws[2], good = 0, steps = 60;
    sb_quat turn;
    sb_vec3 middle, from = sb_v3(0, 0, 1), axis;
    sb_pose reached[2];
    organ_make(&o, number, 0);
    for (int i = 0; i < o.p.mesh.node_count; i++)
        wide = sb_max(wide, sb_v3_norm(sb_v3_sub(o.p.mesh.nodes[i], o.low)));
    half = sb_max(o.longest, o.size / 2);
    axis = sb_v3_cross(from, o.up);
    turn = sb_quat_from_rotation_vector(sb_v3_scale(
        sb_acos(sb_max((sb_real)-1, sb_min((sb_real)1, o.up.z))) / sb_max(sb_v3_norm(axis), REAL(1e-9)), axis));
    middle = sb_v3_madd(o.low, o.size / 2, o.up);
    for (int j = 0; j < 2; j++) {
        sb_tool_def def = press_box(sb_v3(3 * wide, 3 * wide, half), (double)(half / 2), 0.3,
                                    sb_v3_madd(middle, (j ? -1 : 1) * (REAL(0.51) * o.size + half), o.up));
        def.pose.rotation = turn;
        jaws[j] = press_add(&o.p, &def);
    }
    for (int i = 1; i <= steps; i++) {
        gap = o.size * REAL(1 - 0.9 * (i < 40 ? i : 40) / 40);
        for (int j = 0; j < 2; j++)
            press_move(&o.p, jaws[j], sb_v3_madd(middle, (j ? -1 : 1) * (gap / 2 + half), o.up), turn);
        good += press_try_step(&o.p, (double)o.dt);
    }
    CHECK_INT(good, steps);
    for (int j = 0; j < 2; j++)
        CHECK_OK(sb_contact_reached(o.p.contact, jaws[j], &reached[j], NULL));
    gap = sb_v3_dot(o.up, sb_v3_sub(reached[0].position, reached[1].position)) - 2 * half;
    if (getenv("CHECK_SLOW") || getenv("ORGAN"))
        printf("%s: %d of %d steps, jaws closed to %.3f of the width, %.3g N\n", o.name, good, steps,
               (double)(gap / o.size), (double)sb_v3_norm(press_wrench(&o.p, jaws[0]).force));
    CHECK(gap > 0 && gap < REAL(0.2) * o.size);
    for (int j = 0; j < 2; j++)
        take_away(&o, jaws[j]);
    for (int i = 0; i < 20; i++)
        CHECK(press_try_step(&o.p, (double)o.dt));
    press_free(&o.p);
}

/* ---- inside out ---- */

/* A fifth of the nodes are thrown through the organ while a tool presses; at last it is put in its place again. */
static void adverse_inverted(unsigned long long number)
{
    organ o;
    sb_vec3 chain[2], *u, *still;
    sb_real radius;
    sb_tool_def def;
    int tool, refused = 0, nodes;
    organ_make(&o, number, 1);
    nodes = o.p.mesh.node_count;
    radius = sb_max(o.size / 6, o.longest / 2);
    def = make_tool(&o, 0, radius, chain, sb_v3_madd(o.high, REAL(1.05) * radius, o.up));
    tool = press_add(&o.p, &def);
    for (int i = 1; i <= 10; i++) {
        press_move(&o.p, tool, sb_v3_madd(def.pose.position, -radius * REAL(0.04 * i), o.up), def.pose.rotation);
        CHECK(press_try_step(&o.p, (double)o.dt));
    }
    u = (sb_vec3 *)calloc((size_t)nodes, sizeof *u);
    still = (sb_vec3 *)calloc((size_t)nodes, sizeof *still);
    for (int i = 0; i < nodes; i++) {
        u[i] = sb_body_displacements(o.p.body)[i];
        if (!sb_body_supports(o.p.body)[i] && check_random(&o.seed) < 0.2)
            u[i] = sb_v3_madd(u[i], o.size * REAL(check_random_in(&o.seed, -0.7, 0.7)), random_direction(&o.seed));
    }
    CHECK_OK(sb_body_set_displacements(o.p.body, u));
    for (int i = 0; i < 30; i++)
        refused += !press_try_step(&o.p, (double)o.dt);
    if (getenv("CHECK_SLOW") || getenv("ORGAN"))
        printf("%s: inside out, %d of 30 steps refused\n", o.name, refused);
    take_away(&o, tool);
    CHECK_OK(sb_body_set_displacements(o.p.body, still));
    CHECK_OK(sb_body_set_velocities(o.p.body, still));
    check_recovers(&o);
    free(u);
    free(still);
    press_free(&o.p);
}

static void for_organs(void (*adverse)(unsigned long long number), int few)
{
    const char *one = getenv("ORGAN"), *slow = getenv("CHECK_SLOW");
    int count = one ? 1 : slow ? atoi(slow) : check_quick() ? (few + 1) / 2 : few;
    check_bad_numbers();
    for (int i = 0; i < count; i++) {
        int failures = check.failures;
        adverse((unsigned long long)(one ? atoi(one) : i));
        if (check.failures != failures)
            printf("organ %d\n", one ? atoi(one) : i);
    }
}

static void test_inside(void) { for_organs(adverse_inside, 3); }
static void test_thin(void) { for_organs(adverse_thin, 3); }
static void test_nowhere(void) { for_organs(adverse_nowhere, 3); }
static void test_far(void) { for_organs(adverse_far, 3); }
static void test_jumps(void) { for_organs(adverse_jumps, 3); }
static void test_squeeze(void) { for_organs(adverse_squeeze, 3); }
static void test_inverted(void) { for_organs(adverse_inverted, 3); }

CHECK_SUITE(contact_adverse, {"made inside", test_inside}, {"too thin", test_thin}, {"nowhere", test_nowhere},
            {"far", test_far}, {"jumps", test_jumps}, {"squeezed", test_squeeze}, {"inside out", test_inverted});
