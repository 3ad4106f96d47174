/* test_contact_sweep: tools of all shapes and speeds on random ways into bodies: no skeleton ever crosses a deformed
 * face, and steps succeed or leave everything as it was. A sweep is made from its kind and its number alone: 38 of each
 * kind are done, or CHECK_SLOW=n of each from number CHECK_FIRST (0) on (CI does 834 of each), or as many of them as
 * CHECK_SECONDS of the processor allow for all kinds (make soak). One that fails is named, and is done again alone by
 * its number. */
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

typedef struct sweep {
    press p;
    int tools[2], tool_count;
    sb_vec3 from[2], to[2];
    sb_quat turn[2];
    double dt, speed;
    sb_boundary boundary;
    sb_boundary surface; /* of a tool that is a mesh, else empty */
    sb_vec3 *before;     /* [node_count] places before the step or the part of it */
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

static sb_tool_def random_tool(unsigned long long *seed, sb_tool_shape shape, int hangs, sb_vec3 *chain,
                               sb_boundary *surface)
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
    }
    if (shape == SB_TOOL_BOX) {
        double x = random_in(seed, 0.006, 0.02), y = random_in(seed, 0.006, 0.02), z = random_in(seed, 0.006, 0.02);
        def.half = sb_v3(REAL(x), REAL(y), REAL(z));
        def.radius = REAL(random_in(seed, 0.0025, 0.006));
    }
    if (shape == SB_TOOL_MESH) {
        random_surface(seed, surface);
        def.surface = &surface->surface;
        def.cells = SB_TOOL_MIN_CELLS;
    }
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
static press random_body(unsigned long long *seed, int is_free)
{
    double size = is_free ? 0.02 : 0.04;
    sb_body_def def = sb_default_body_def();
    sb_mesh mesh =
        scene_box(SB_TET4, is_free ? 2 : 4, is_free ? 2 : 4, 2, sb_v3(REAL(size), REAL(size), REAL(0.5 * size)), 0.2);
    sb_contact_def contact = sb_default_contact_def();
    press p;
    contact.max_contacts = 4096;
    def.material = sb_material_corotated(REAL(random_in(seed, 2e3, 2e4)), REAL(random_in(seed, 0, 0.45)), 1000);
    def.damping_stiffness = REAL(random_in(seed, 0, 0.02));
    p = press_make(mesh, def, contact);
    if (!is_free)
        scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    return p;
}

/* One tool, or two from both sides, through a point of the body. */
static sweep make_sweep(unsigned long long *seed, sb_tool_shape shape, int tool_count, int is_free, int hangs)
{
    sweep s;
    sb_vec3 way = random_direction(seed), low, high, size, off, target, chain[3];
    memset(&s, 0, sizeof s);
    s.p = random_body(seed, is_free);
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
        sb_tool_def def = random_tool(seed, shape, hangs, chain, &s.surface);
        double start = 0.09, end = tool_count > 1 ? 0.01 : -0.05;
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

/* Does a skeleton cross a face, as they stand or on their way? */
static int crosses(const sweep *s, int tool, const sb_pose *from)
{
    const sbi_contact_tool *t = s->p.contact->tools + s->tools[tool];
    const sb_vec3 *now = sb_body_positions(s->p.body);
    for (int f = 0; f < s->boundary.surface.element_count; f++) {
        sb_vec3 start[3], end[3];
        triangle_at(s, f, s->before, start);
        triangle_at(s, f, now, end);
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
    uint64_t hash;
    int nodes = s->p.mesh.node_count;
    for (int t = 0; t < s->tool_count; t++)
        press_move(&s->p, s->tools[t],
                   sb_v3_madd(s->from[t], REAL(share < 1 ? share : 1), sb_v3_sub(s->to[t], s->from[t])), s->turn[t]);
    keep_places(s);
    s->crossings = 0;
    hash = sb_body_state_hash(s->p.body);
    sum->steps++;
    if (sb_body_step(s->p.body, REAL(s->dt), &info) != SB_OK) {
        sum->refused++;
        sum->not_undone += sb_body_state_hash(s->p.body) != hash || !info.error.message[0];
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

/* What a kind of sweeps is made of. */
typedef struct sweep_kind {
    sb_tool_shape shape;
    int tool_count, is_free, hangs;
    unsigned long long number; /* of the kind, from 1 */
} sweep_kind;

static tally run_sweep(const sweep_kind *kind, long number)
{
    unsigned long long seed = (kind->number << 40) + (unsigned long long)number * 2 + 1;
    double way, done = 0.04;
    tally sum;
    sweep s;
    for (int i = 0; i < 8; i++) /* neighbouring numbers begin alike */
        (void)check_random(&seed);
    s = make_sweep(&seed, kind->shape, kind->tool_count, kind->is_free, kind->hangs);
    way = (double)sb_v3_norm(sb_v3_sub(s.to[0], s.from[0]));
    memset(&sum, 0, sizeof sum);
    sum.sweeps = 1;
    watched = &s;
    s.commit = s.p.contact->touch.commit;
    s.p.contact->touch.commit = watch_commit;
    for (int k = 0; k < 16; k++) {
        done += s.speed * s.dt;
        take_step(&s, done / way, &sum);
    }
    free_sweep(&s);
    if (failures(&sum) > 0)
        printf("  sweep %ld of kind %d: %ld crossings, %ld refused, %ld not finite, %ld not undone\n", number,
               (int)kind->number, sum.crossings, sum.refused, sum.not_finite, sum.not_undone);
    return sum;
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
    for (size_t k = 0; k < sizeof spheres / sizeof spheres[0]; k++) {
        tally sum = run_sweep(&sphere, spheres[k]);
        CHECK_INT((int)failures(&sum), 0);
    }
    for (size_t k = 0; k < sizeof jaws / sizeof jaws[0]; k++) {
        tally sum = run_sweep(&jaw, jaws[k]);
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
