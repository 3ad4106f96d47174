/* test_contact_sweep: tools of all shapes and speeds on random ways into bodies: no skeleton ever crosses a deformed
 * face, and steps succeed or leave everything as it was. A sweep is made from its kind and its number alone: 38 of each
 * kind are done, or CHECK_SLOW=n of each from number CHECK_FIRST (0) on (CI does 834 of each), or as many of them as
 * CHECK_SECONDS of the processor allow for all kinds (make soak). One that fails is named, and is done again alone by
 * its number.
 *
 * Most bodies are lumps of few elements, which tools press flat within 6 or 7 steps. Each 16th sweep, and most of
 * spheres on springs, is 16 steps in a larger block: they cost four times as much, and what is wrong with the look
 * after a step shows there where lumps do not show it. */
#define SB_SPLIT_BUILD
#include "../src/softbody/contact/contact_private.h"

#include "contact_scene.h"
#include "skeleton.h"

#include <time.h>

enum { SWEEP_KINDS = 13 }; /* the Makefile leaves the last out, of which fewer are done */

/* What sweeps have found. */
typedef struct tally {
    long sweeps, steps, touching, crossings, refused, retries, divided, parts, not_finite, not_undone;
} tally;

static tally all; /* of all kinds */

/* What a kind of sweeps is made of. */
typedef struct sweep_kind {
    sb_tool_shape shape;
    int tool_count, is_free, hangs;
    unsigned long long number; /* of the kind, from 1 */
} sweep_kind;

/* How large a body and its tools are: a block, in which long runs have found what they have found, or a lump. */
typedef struct sweep_size {
    int is_large, steps;
    int slides;              /* without friction: a third of the work where tools hang on springs */
    double scale;            /* of tools' lengths and ways: 1 of a large one */
    unsigned long long seed; /* of a lump */
} sweep_size;

typedef struct sweep {
    press p;
    int tools[2], tool_count;
    sb_vec3 from[2], to[2];
    sb_quat turn[2];
    double dt, speed;
    sb_boundary boundary;
    sb_boundary surface; /* of a tool that is a mesh, else empty */
    sb_vec3 *before;     /* [node_count] places before the step or the part of it */
    uint64_t hash;       /* of the state before the step, when `hashes` */
    int hashes;
    sb_pose before_tool[2];
    int crossings; /* in the parts of the step */
    void (*commit)(void *contact);
} sweep;

static double random_in(unsigned long long *seed, double low, double high) { return check_random_in(seed, low, high); }

static sb_vec3 random_vector(unsigned long long *seed, double size)
{
    double x = random_in(seed, -size, size), y = random_in(seed, -size, size), z = random_in(seed, -size, size);
    return sb_v3(REAL(x), REAL(y), REAL(z));
}

static sb_vec3 random_direction(unsigned long long *seed)
{
    for (;;) {
        sb_vec3 v = random_vector(seed, 1);
        sb_real length = sb_v3_norm(v);
        if (length > REAL(0.1) && length < 1)
            return sb_v3_scale(1 / length, v);
    }
}

/* ---- scenes ---- */

/* Spheres on springs are mostly large: they are what goes through faces first when the look after a step is weaker. */
static sweep_size random_size(const sweep_kind *kind, long number)
{
    const int mostly = kind->hangs && kind->shape == SB_TOOL_SPHERE;
    sweep_size size;
    size.is_large = mostly ? number % 3 != 0 : number % 16 == 0;
    size.steps = size.is_large ? 16 : kind->hangs ? 7 : 6;
    size.seed = (kind->number << 44) + (unsigned long long)number * 2 + 1;
    for (int i = 0; i < 8; i++)
        (void)check_random(&size.seed);
    size.slides = kind->hangs && check_random(&size.seed) < 0.6;
    size.scale = size.is_large ? 1 : random_in(&size.seed, 0.35, 0.65);
    return size;
}

/* The surface of an ellipsoid that is thick enough for the faces. */
static void random_surface(unsigned long long *seed, sb_boundary *surface)
{
    double x = random_in(seed, 0.006, 0.02), y = random_in(seed, 0.006, 0.02), z = random_in(seed, 0.006, 0.02);
    sb_mesh solid;
    memset(&solid, 0, sizeof solid);
    memset(surface, 0, sizeof *surface);
    CHECK_OK(sb_mesh_ellipsoid(SB_TET4, sb_v3(REAL(x), REAL(y), REAL(z)), 4, NULL, &solid, NULL));
    CHECK_OK(sb_mesh_boundary(&solid, 1, NULL, surface, NULL));
    sb_mesh_free(&solid);
}

static sb_vec3 random_half(unsigned long long *seed)
{
    double x = random_in(seed, 0.006, 0.02), y = random_in(seed, 0.006, 0.02), z = random_in(seed, 0.006, 0.02);
    return sb_v3(REAL(x), REAL(y), REAL(z));
}

static sb_tool_def random_tool(unsigned long long *seed, sb_tool_shape shape, int hangs, sweep_size *size,
                               sb_vec3 *chain, sb_boundary *surface)
{
    sb_tool_def def = sb_default_tool_def();
    def.shape = shape;
    def.friction = REAL(random_in(seed, 0, 0.6));
    def.radius = REAL(random_in(seed, 0.0025, 0.006));
    if (shape == SB_TOOL_CAPSULES) {
        def.points = chain;
        def.point_count = 3;
        chain[0] = sb_v3(REAL(-0.03), 0, 0);
        chain[1] = sb_v3(0, REAL(random_in(seed, -0.005, 0.005)), 0);
        chain[2] = sb_v3(REAL(0.03), 0, REAL(random_in(seed, -0.005, 0.005)));
        for (int i = 0; i < 3; i++)
            chain[i] = sb_v3_scale(REAL(size->scale), chain[i]);
    }
    if (shape == SB_TOOL_BOX) {
        sb_vec3 half = sb_v3_scale(REAL(size->scale), random_half(seed));
        def.radius = REAL(random_in(seed, 0.0025, 0.006));
        def.half = sb_v3(sb_max(half.x, def.radius), sb_max(half.y, def.radius), sb_max(half.z, def.radius));
    }
    if (shape == SB_TOOL_MESH) {
        random_surface(seed, surface);
        def.surface = &surface->surface;
        def.cells = SB_TOOL_MIN_CELLS;
    }
    if (size->slides)
        def.friction = 0;
    if (hangs) {
        def.coupling_stiffness = REAL(pow(10, random_in(seed, 0, 4)));
        if (check_random(seed) < 0.5)
            def.coupling_turning = REAL(random_in(seed, 1e-5, 1e-3)) * def.coupling_stiffness;
        if (check_random(seed) < 0.5)
            def.max_force = REAL(random_in(seed, 0.1, 5));
    }
    return def;
}

/* A block of 40 x 40 x 20 mm on the floor, or half as large and free. */
static sb_mesh large_block(int is_free)
{
    double size = is_free ? 0.02 : 0.04;
    return scene_box(SB_TET4, is_free ? 2 : 4, is_free ? 2 : 4, 2, sb_v3(REAL(size), REAL(size), REAL(0.5 * size)),
                     0.2);
}

/* As many cells along a side as the thinnest tools need, sometimes one more. */
static int random_cells(unsigned long long *seed, double side)
{
    return (int)ceil(side / 0.0115) + (check_random(seed) < 0.15);
}

/* A block of few cells with all of its nodes off their places, on the floor if it is not free. */
static sb_mesh random_lump(unsigned long long *seed, double scale, int is_free)
{
    double x = (is_free ? 0.02 : 0.04) * scale;
    double y = random_in(seed, 0.8, 1) * x, z = random_in(seed, 0.4, 0.6) * x;
    int nx = random_cells(seed, x), ny = random_cells(seed, y), nz = random_cells(seed, z);
    sb_mesh mesh = scene_box(SB_TET4, nx, ny, nz, sb_v3(REAL(x), REAL(y), REAL(z)), 0);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 *at = mesh.nodes + i, off = random_vector(seed, 0.1);
        if (!is_free && !(at->z > 0))
            off.z = 0;
        *at = sb_v3_add(*at, sb_v3(off.x * REAL(x / nx), off.y * REAL(y / ny), off.z * REAL(z / nz)));
    }
    return mesh;
}

static press random_body(unsigned long long *seed, sweep_size *size, int is_free)
{
    sb_body_def def = sb_default_body_def();
    sb_mesh mesh = size->is_large ? large_block(is_free) : random_lump(&size->seed, size->scale, is_free);
    sb_contact_def contact = sb_default_contact_def();
    press p;
    contact.max_contacts = size->is_large ? 4096 : 1024; /* memory is zeroed for each body */
    contact.max_tools = 2;
    def.material = sb_material_corotated(REAL(random_in(seed, 2e3, 2e4)), REAL(random_in(seed, 0, 0.45)), 1000);
    def.damping_stiffness = REAL(random_in(seed, 0, 0.02));
    p = press_make(mesh, def, contact);
    if (!is_free)
        scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    return p;
}

/* How far (m) tools begin from the point that they are sent through, clear of the body. */
static double far_off(const sweep_size *size) { return 0.09 * size->scale + (size->is_large ? 0 : 0.01); }

/* One tool, or two from both sides, through a point of the body. */
static sweep make_sweep(unsigned long long *seed, sweep_size *of, sb_tool_shape shape, int tool_count, int is_free,
                        int hangs)
{
    sweep s;
    sb_vec3 way = random_direction(seed), low, high, size, off, target, chain[3];
    memset(&s, 0, sizeof s);
    s.p = random_body(seed, of, is_free);
    s.tool_count = tool_count;
    s.speed = 0.1 * pow(100, check_random(seed));
    s.dt = random_in(seed, 0.005, 0.017);
    CHECK_OK(sb_mesh_boundary(&s.p.mesh, 0, NULL, &s.boundary, NULL));
    s.before = (sb_vec3 *)malloc((size_t)s.p.mesh.node_count * sizeof *s.before);
    sb_mesh_bounds(&s.p.mesh, &low, &high);
    size = sb_v3_sub(high, low);
    off = random_vector(seed, 0.4);
    target = sb_v3_madd(low, REAL(0.5), size);
    target = sb_v3_add(target, sb_v3(off.x * size.x, off.y * size.y, off.z * size.z));
    if (!is_free && way.z < 0)
        way.z = -way.z;
    for (int t = 0; t < tool_count; t++) {
        sb_tool_def def = random_tool(seed, shape, hangs, of, chain, &s.surface);
        double start = far_off(of), end = (tool_count > 1 ? 0.01 : -0.05) * of->scale;
        s.turn[t] = sb_quat_from_rotation_vector(random_vector(seed, 2));
        s.from[t] = sb_v3_madd(target, REAL(t == 0 ? start : -start), way);
        s.to[t] = sb_v3_madd(target, REAL(t == 0 ? end : -end), way);
        def.pose = press_pose(s.from[t], s.turn[t]);
        s.tools[t] = press_add(&s.p, &def);
    }
    sb_boundary_free(&s.surface);
    return s;
}

static void free_sweep(sweep *s)
{
    sb_boundary_free(&s->boundary);
    free(s->before);
    press_free(&s->p);
}

/* ---- looking ---- */

static void triangle_at(const sweep *s, int face, const sb_vec3 *x, sb_vec3 triangle[3])
{
    for (int a = 0; a < 3; a++)
        triangle[a] = x[s->boundary.surface.elements[3 * face + a]];
}

/* All that points go through on straight ways. */
typedef struct sweep_box {
    sb_vec3 low, high;
} sweep_box;

static sweep_box no_box(void)
{
    const sweep_box none = {{SB_REAL_MAX, SB_REAL_MAX, SB_REAL_MAX}, {-SB_REAL_MAX, -SB_REAL_MAX, -SB_REAL_MAX}};
    return none;
}

static void box_add(sweep_box *box, sb_vec3 x)
{
    box->low = sb_v3(sb_min(box->low.x, x.x), sb_min(box->low.y, x.y), sb_min(box->low.z, x.z));
    box->high = sb_v3(sb_max(box->high.x, x.x), sb_max(box->high.y, x.y), sb_max(box->high.z, x.z));
}

/* 1 also where they are apart by rounding only, or places are no numbers. */
static int boxes_meet(const sweep_box *a, const sweep_box *b)
{
    const sb_real near = REAL(1e-6);
    return !(a->low.x > b->high.x + near || a->low.y > b->high.y + near || a->low.z > b->high.z + near ||
             b->low.x > a->high.x + near || b->low.y > a->high.y + near || b->low.z > a->high.z + near);
}

/* Of the skeleton of a tool, which is within its points, at both poses. */
static sweep_box skeleton_box(const sbi_contact_tool *tool, const sb_pose *from)
{
    sb_vec3 points[SBI_TOOL_MAX_SKELETON];
    int count = sbi_tool_skeleton(tool->shape, tool->chain_reached, points, SBI_TOOL_MAX_SKELETON);
    sweep_box box = no_box();
    for (int i = 0; i < count; i++) {
        box_add(&box, sbi_pose_to_space(from, points[i]));
        box_add(&box, sbi_pose_to_space(&tool->reached, points[i]));
    }
    return box;
}

/* Does a skeleton cross a face, as they stand or on their way? */
static int crosses(const sweep *s, int tool, const sb_pose *from)
{
    const sbi_contact_tool *t = s->p.contact->tools + s->tools[tool];
    const sb_vec3 *now = sb_body_positions(s->p.body);
    const sweep_box all_of_tool = skeleton_box(t, from);
    for (int f = 0; f < s->boundary.surface.element_count; f++) {
        sb_vec3 start[3], end[3];
        sweep_box of_face = no_box();
        triangle_at(s, f, s->before, start);
        triangle_at(s, f, now, end);
        for (int a = 0; a < 3; a++) {
            box_add(&of_face, start[a]);
            box_add(&of_face, end[a]);
        }
        if (!boxes_meet(&all_of_tool, &of_face))
            continue;
        if (sbi_tool_get_shape(t->shape) != SB_TOOL_SPHERE &&
            skeleton_meets(t->shape, t->chain_reached, &t->reached, end))
            return 1;
        if (skeleton_passes(t->shape, t->chain_reached, from, start, t->chain_reached, &t->reached, end))
            return 1;
    }
    return 0;
}

static void keep_places(sweep *s)
{
    memcpy(s->before, sb_body_positions(s->p.body), (size_t)s->p.mesh.node_count * sizeof *s->before);
    for (int t = 0; t < s->tool_count; t++)
        CHECK_OK(sb_contact_reached(s->p.contact, s->tools[t], &s->before_tool[t], NULL));
}

static sweep *watched; /* the one whose steps are looked at */

/* In place of the contact's own: looks at each part of a step that is divided. */
static void watch_commit(void *contact)
{
    watched->commit(contact);
    for (int t = 0; t < watched->tool_count; t++)
        watched->crossings += crosses(watched, t, &watched->before_tool[t]);
    keep_places(watched);
}

static void take_step(sweep *s, double share, tally *sum)
{
    sb_step_info info;
    sb_contact_info contact;
    int nodes = s->p.mesh.node_count;
    for (int t = 0; t < s->tool_count; t++)
        press_move(&s->p, s->tools[t],
                   sb_v3_madd(s->from[t], REAL(share < 1 ? share : 1), sb_v3_sub(s->to[t], s->from[t])), s->turn[t]);
    keep_places(s);
    s->crossings = 0;
    s->hash = s->hashes ? sb_body_state_hash(s->p.body) : 0;
    sum->steps++;
    if (sb_body_step(s->p.body, REAL(s->dt), &info) != SB_OK) {
        sum->refused++;
        sum->not_undone += (s->hashes && sb_body_state_hash(s->p.body) != s->hash) || !info.error.message[0];
        return;
    }
    sum->divided += info.substeps > 0;
    sum->parts += info.substeps;
    contact = sb_contact_get_info(s->p.contact);
    sum->touching += contact.touching > 0;
    sum->retries += contact.retries;
    sum->not_finite += !scene_all_finite(sb_body_positions(s->p.body), nodes) ||
                       !scene_all_finite(sb_body_velocities(s->p.body), nodes);
    sum->crossings += s->crossings;
}

static long failures(const tally *t) { return t->crossings + t->not_finite + t->not_undone + t->refused; }

static void add_tally(tally *sum, const tally *t)
{
    sum->sweeps += t->sweeps, sum->steps += t->steps, sum->touching += t->touching, sum->crossings += t->crossings;
    sum->refused += t->refused, sum->retries += t->retries, sum->divided += t->divided, sum->parts += t->parts;
    sum->not_finite += t->not_finite, sum->not_undone += t->not_undone;
}

/* hashes: compares states before and after steps that were refused. */
static tally do_sweep(const sweep_kind *kind, long number, sweep_size size, int hashes)
{
    unsigned long long seed = (kind->number << 40) + (unsigned long long)number * 2 + 1;
    double way, done;
    tally sum;
    sweep s;
    for (int i = 0; i < 8; i++) /* neighbouring numbers begin alike */
        (void)check_random(&seed);
    s = make_sweep(&seed, &size, kind->shape, kind->tool_count, kind->is_free, kind->hangs);
    s.hashes = hashes;
    way = (double)sb_v3_norm(sb_v3_sub(s.to[0], s.from[0]));
    done = size.is_large ? 0.04 : far_off(&size) - random_in(&size.seed, 0, 0.05) * size.scale;
    memset(&sum, 0, sizeof sum);
    sum.sweeps = 1;
    watched = &s;
    s.commit = s.p.contact->touch.commit;
    s.p.contact->touch.commit = watch_commit;
    for (int k = 0; k < size.steps; k++) {
        done += s.speed * s.dt;
        take_step(&s, done / way, &sum);
    }
    free_sweep(&s);
    return sum;
}

static tally run_sweep_of(const sweep_kind *kind, long number, sweep_size size)
{
    tally sum = do_sweep(kind, number, size, 0);
    if (sum.refused > 0)
        sum = do_sweep(kind, number, size, 1);
    if (failures(&sum) > 0)
        printf("  sweep %ld of kind %d: %ld crossings, %ld refused, %ld not finite, %ld not undone\n", number,
               (int)kind->number, sum.crossings, sum.refused, sum.not_finite, sum.not_undone);
    return sum;
}

static tally run_sweep(const sweep_kind *kind, long number)
{
    return run_sweep_of(kind, number, random_size(kind, number));
}

static void tell_tally(const char *name, const tally *t)
{
    printf("%s: %ld sweeps, %ld steps, %ld touch, %ld crossings, %ld not finite, %ld refused, %ld not undone, %ld "
           "retries, "
           "%ld divided into %ld\n",
           name, t->sweeps, t->steps, t->touching, t->crossings, t->not_finite, t->refused, t->not_undone, t->retries,
           t->divided, t->parts);
}

static long number_in(const char *variable, long otherwise)
{
    const char *text = getenv(variable);
    return text && *text ? strtol(text, NULL, 10) : otherwise;
}

static void run_sweeps_of(sb_tool_shape shape, int tool_count, int is_free, int hangs, int number)
{
    const long dear = shape == SB_TOOL_MESH ? 8 : 1; /* a grid of distances is made for each */
    long rounds = (number_in("CHECK_SLOW", check_rounds(38)) + dear - 1) / dear, first = number_in("CHECK_FIRST", 0);
    const char *seconds = getenv("CHECK_SECONDS");
    double most = seconds && *seconds ? strtod(seconds, NULL) / (double)SWEEP_KINDS : 0;
    clock_t begun = clock();
    sweep_kind kind;
    tally sum;
    kind.shape = shape;
    kind.tool_count = tool_count;
    kind.is_free = is_free;
    kind.hangs = hangs;
    kind.number = (unsigned long long)number;
    memset(&sum, 0, sizeof sum);
    for (long i = 0; i < rounds; i++) {
        tally one;
        if (most > 0 && i > 0 && (double)(clock() - begun) > most * (double)CLOCKS_PER_SEC)
            break;
        one = run_sweep(&kind, first + i);
        add_tally(&sum, &one);
    }
    CHECK_INT((int)failures(&sum), 0);
    CHECK(sum.touching > sum.steps / 10 || sum.steps < 500);
    add_tally(&all, &sum);
    if (getenv("CHECK_SLOW")) {
        char name[64];
        snprintf(name, sizeof name, "kind %d", number);
        tell_tally(name, &sum);
        fflush(stdout);
    }
}

static void run_sweeps(sb_tool_shape shape, int tool_count, int is_free, int number)
{
    run_sweeps_of(shape, tool_count, is_free, 0, number);
}

static void test_sphere(void)
{
    run_sweeps(SB_TOOL_SPHERE, 1, 0, 1);
    run_sweeps(SB_TOOL_SPHERE, 1, 1, 2);
}

static void test_capsules(void)
{
    run_sweeps(SB_TOOL_CAPSULES, 1, 0, 3);
    run_sweeps(SB_TOOL_CAPSULES, 1, 1, 4);
}

static void test_box(void)
{
    run_sweeps(SB_TOOL_BOX, 1, 0, 5);
    run_sweeps(SB_TOOL_BOX, 1, 1, 6);
}

static void test_mesh(void) { run_sweeps(SB_TOOL_MESH, 1, 0, 13); }

static void test_jaws(void)
{
    run_sweeps(SB_TOOL_BOX, 2, 1, 7);
    run_sweeps(SB_TOOL_CAPSULES, 2, 1, 8);
}

/* What long runs have found: spheres that went through a face from 0.4 of their radius before it to as far behind; one
 * (79699) through a face that was stretched so far that it had no sample near enough; and a body that flew between jaws
 * so fast that steps were refused. */
static void test_found(void)
{
    static const long spheres[] = {52188, 53577, 79067, 79699}, jaws[] = {4181338, 4300339, 4900752};
    const sweep_kind sphere = {SB_TOOL_SPHERE, 1, 0, 1, 9}, jaw = {SB_TOOL_BOX, 2, 1, 0, 7};
    const sweep_size large = {1, 16, 0, 1, 0};
    for (size_t k = 0; k < sizeof spheres / sizeof spheres[0]; k++) {
        tally sum = run_sweep_of(&sphere, spheres[k], large);
        CHECK_INT((int)failures(&sum), 0);
    }
    for (size_t k = 0; k < sizeof jaws / sizeof jaws[0]; k++) {
        tally sum = run_sweep_of(&jaw, jaws[k], large);
        CHECK_INT((int)failures(&sum), 0);
    }
}

static void test_hung(void)
{
    run_sweeps_of(SB_TOOL_SPHERE, 1, 0, 1, 9);
    run_sweeps_of(SB_TOOL_CAPSULES, 1, 0, 1, 10);
    run_sweeps_of(SB_TOOL_BOX, 1, 1, 1, 11);
    run_sweeps_of(SB_TOOL_CAPSULES, 2, 1, 1, 12);
}

/* What a process of a soak has to say, on one line. */
static void test_sum(void)
{
    CHECK_INT((int)failures(&all), 0);
    if (getenv("CHECK_SLOW"))
        tell_tally("all", &all);
}

CHECK_SUITE(contact_sweep, {"sphere", test_sphere}, {"capsules", test_capsules}, {"box", test_box}, {"mesh", test_mesh},
            {"jaws", test_jaws}, {"on springs", test_hung}, {"found", test_found}, {"sum", test_sum});
