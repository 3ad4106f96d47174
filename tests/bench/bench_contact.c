/* bench_contact: what contact costs beside a step.
 *
 *     contact_refit_*    boxes over the faces of a body fitted anew, with velocities, for each kind of face; and boxes
 *                        of a tenth and of a third of the body asked for
 *     contact_follow_13k faces that follow splits of edges among 13,608 tet4, and the update after it
 *     contact_slide_13k  whole steps of 10 ms: a slab of 100 x 100 x 40 mm on a table, 13,608 tet4, corotated, E 5 kPa,
 *                        nu 0.45, beta 0.01 s, and a sphere of 10 mm, mu 0.3, 5 mm deep, that slides to and fro at
 *                        5 cm/s
 *     contact_hold_13k   the same when all has come to rest
 *     contact_narrow     the same slab under 64 spheres of 2.5 mm, twelve of which press on it
 *     contact_grip       the liver of the shared data (else a generated organ), about 3,000 tet10, an end of which two
 *                        jaws hold and draw outward at 1 cm/s; they are as thick as its faces ask for
 *     contact_pairs      two blocks of some 5,000 tet4 each, one of which stands and carries the other, whose round
 *                        underside is pressed 3 mm into it and goes to and fro at 2.5 cm/s; mu 0.2; some 500 samples
 *                        touch
 *     contact_pairs_hold the same when all has come to rest
 *     haptic_publish     a frame for the hand after each step of contact_slide_13k
 *
 * Steps are compared with those of a twin that the same forces deform without contact: the same motion, and the same
 * systems but for contact. Both take turns, each warm, and times are least and median. Then what contact does in a
 * step, as means: boxes, ways and samples (begin), forces at trial increments (evaluate, and how often in a step),
 * blocks put in and taken out, the look at the end (accept), and readings and memory (commit). Asserts nothing. */
#define SB_STATIC
#define SB_IMPLEMENTATION
#include "../../softbody.h"

#include "measure.h"

#include <stdio.h>

#include "../check.h"
#include "../follow_change.h"
#include "../scene.h"

check_state check;

enum { RUNS = 301, QUERIES = 2000 };

static const struct {
    const char *name;
    sb_element_type type;
    int cells; /* along a side of a cube */
} cases[] = {{"contact_refit_5k", SB_TET4, 20},
             {"contact_refit_tri6", SB_TET10, 10},
             {"contact_refit_quad4", SB_HEX8, 20},
             {"contact_refit_quad8", SB_HEX20, 10},
             {"contact_refit_quad9", SB_HEX27, 10}};

static sbi_contact_faces *make_faces(sb_body *body)
{
    sbi_contact_faces *faces;
    if (sbi_contact_faces_create(body, NULL, &faces, NULL) != SB_OK)
        exit(1);
    return faces;
}

static void time_refit(sbi_contact_faces *faces, const sb_body *body, const sb_vec3 *velocities, const char *name)
{
    double times[RUNS];
    for (int i = 0; i < RUNS; i++) {
        times[i] = now();
        sbi_contact_faces_refit(faces, sb_body_positions(body), velocities, REAL(0.01));
        times[i] = now() - times[i];
    }
    median(times, RUNS);
    printf("%-22s %6d faces %8.1f us least %8.1f us median %6.2f ns a face at least\n", name, faces->face_end,
           1e6 * times[0], 1e6 * times[RUNS / 2], 1e9 * times[0] / faces->face_end);
}

/* Boxes with sides of `share` of the body's, at random. */
static void time_queries(sbi_contact_faces *faces, double share)
{
    enum { ROUNDS = 11 };
    unsigned long long seed = 5;
    int *found = (int *)malloc((size_t)faces->face_end * sizeof(int));
    double times[ROUNDS], count = 0;
    sb_vec3 lows[QUERIES];
    for (int i = 0; i < QUERIES; i++) {
        double x = check_random_in(&seed, -share, 1), y = check_random_in(&seed, -share, 1);
        lows[i] = sb_v3(REAL(x), REAL(y), REAL(check_random_in(&seed, -share, 1)));
    }
    for (int r = 0; r < ROUNDS; r++) {
        times[r] = now();
        for (int i = 0; i < QUERIES; i++)
            count += sbi_contact_faces_query(faces, lows[i],
                                             sb_v3_add(lows[i], sb_v3(REAL(share), REAL(share), REAL(share))), found,
                                             faces->face_end);
        times[r] = now() - times[r];
    }
    median(times, ROUNDS);
    printf("    boxes of %.2f of a side: %8.0f ns a query at least, %6.1f faces found\n", share,
           1e9 * times[0] / (double)QUERIES, count / (double)(ROUNDS * QUERIES));
    free(found);
}

/* ---- changes ---- */

typedef struct follower {
    sbi_contact_faces *faces;
    double seconds; /* in the last change */
} follower;

static sb_result follower_reserve(void *user, const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    follower *f = (follower *)user;
    double start = now();
    sb_result result = sbi_contact_faces_reserve(f->faces, body, change, error);
    f->seconds = now() - start;
    return result;
}

static void follower_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    follower *f = (follower *)user;
    double start = now();
    sbi_contact_faces_follow(f->faces, body, change);
    f->seconds += now() - start;
}

static void time_changes(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 18, 18, 7, sb_v3(1, 1, REAL(0.4)), 0.1);
    sb_body_def def = sb_default_body_def();
    double changes[RUNS], updates[RUNS];
    unsigned long long seed = 7;
    sb_body_listener listener;
    follower f;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_corotated(5000, REAL(0.45), 1000);
    def.slack = REAL(0.5);
    body = scene_body(&def);
    f.faces = make_faces(body);
    memset(&listener, 0, sizeof listener);
    listener.user = &f;
    listener.reserve = follower_reserve;
    listener.follow = follower_follow;
    if (sb_body_listen(body, &listener, NULL, NULL) != SB_OK)
        exit(1);
    for (int i = 0; i < RUNS;) {
        follow_op op;
        if (follow_change(body, &op, 0, 4, &seed) != SB_OK)
            continue;
        changes[i] = f.seconds;
        updates[i] = now();
        if (sbi_contact_faces_update(f.faces, body, NULL, NULL) != SB_OK)
            exit(1);
        updates[i] = now() - updates[i];
        i++;
    }
    median(changes, RUNS);
    median(updates, RUNS);
    printf("%-22s %6d faces %8.1f us least %8.1f us median; update %8.1f us least %8.1f us median\n",
           "contact_follow_13k", f.faces->face_end, 1e6 * changes[0], 1e6 * changes[RUNS / 2], 1e6 * updates[0],
           1e6 * updates[RUNS / 2]);
    sbi_contact_faces_destroy(f.faces);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- whole steps ---- */

enum { TURN = 20, TURNS = 10, STEPS = TURN * TURNS, MOST_TOOLS = 64 };

/* Contact as it is, with a clock at each call from the step. */
typedef struct watch {
    sbi_touch real;
    double begin, evaluate, blocks, accept, commit; /* s, sums */
    int evaluations;
} watch;
static watch watched;

static sb_result watch_begin(void *user, const sbi_touch_step *step, sb_error *error)
{
    double start = now();
    sb_result result = watched.real.begin(user, step, error);
    watched.begin += now() - start;
    return result;
}
static void watch_evaluate(void *user, const sb_vec3 *du, int renew)
{
    double start = now();
    watched.real.evaluate(user, du, renew);
    watched.evaluate += now() - start;
    watched.evaluations++;
}
static void watch_multiply(void *user, const unsigned char *masked, const sb_vec3 *x, sb_vec3 *out)
{
    double start = now();
    watched.real.multiply(user, masked, x, out);
    watched.blocks += now() - start;
}
static void watch_add_blocks(void *user, const unsigned char *masked, sb_matrix *matrix)
{
    double start = now();
    watched.real.add_blocks(user, masked, matrix);
    watched.blocks += now() - start;
}
static void watch_restore_blocks(void *user, sb_matrix *matrix)
{
    double start = now();
    watched.real.restore_blocks(user, matrix);
    watched.blocks += now() - start;
}
static int watch_accept(void *user, const sb_vec3 *u)
{
    double start = now();
    int good = watched.real.accept(user, u);
    watched.accept += now() - start;
    return good;
}
static void watch_commit(void *user)
{
    double start = now();
    watched.real.commit(user);
    watched.commit += now() - start;
}

static void watch_contact(sb_contact *contact)
{
    sbi_touch *touch = &contact->touch;
    memset(&watched, 0, sizeof watched);
    watched.real = *touch;
    touch->begin = watch_begin;
    touch->evaluate = watch_evaluate;
    touch->multiply = watch_multiply;
    touch->add_blocks = watch_add_blocks;
    touch->restore_blocks = watch_restore_blocks;
    touch->accept = watch_accept;
    touch->commit = watch_commit;
}

/* A body with tools, and one of the same mesh that feels the same forces. */
typedef struct pair {
    sb_mesh mesh;
    sb_body *body, *twin;
    sb_contact *contact;
    sb_real dt;
    int tools[MOST_TOOLS], tool_count;
    sb_pose poses[MOST_TOOLS]; /* at first */
    sb_vec3 *forces;           /* [TURN][nodes] on the nodes at the end of each step of a turn (N) */
    int *all;                  /* [nodes] */
    int *led, led_count;       /* nodes that go where `lead` says */
    sb_vec3 (*lead)(int step); /* m */
} pair;

/* Where the tool is to be after so many steps. */
typedef sb_pose (*pair_way)(const pair *p, int tool, int step);

static sb_body *make_slab(const sb_mesh *mesh)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    def.mesh = mesh;
    def.material = sb_material_corotated(5000, REAL(0.45), 1000);
    def.damping_stiffness = REAL(0.01);
    def.jobs = jobs_asked_for();
    body = scene_body(&def);
    scene_fix_plane(body, mesh, 2, 0, SB_XYZ);
    return body;
}

static sb_body *make_organ(const sb_mesh *mesh)
{
    sb_body_def def = sb_default_body_def();
    sb_vec3 low, high;
    sb_body *body;
    def.mesh = mesh;
    def.material = sb_material_corotated(5000, REAL(0.45), 1060);
    def.damping_stiffness = REAL(0.02);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.jobs = jobs_asked_for();
    body = scene_body(&def);
    sb_mesh_bounds(mesh, &low, &high);
    for (int i = 0; i < mesh->node_count; i++)
        if (mesh->nodes[i].z > high.z - REAL(0.15) * (high.z - low.z))
            sb_body_fix_nodes(body, &i, 1, SB_XYZ);
    return body;
}

/* The mesh becomes the pair's. */
static pair make_pair_with(sb_mesh mesh, sb_body *(*make)(const sb_mesh *mesh), double dt, sb_contact_def def)
{
    pair p;
    memset(&p, 0, sizeof p);
    p.mesh = mesh;
    p.dt = REAL(dt);
    p.body = make(&p.mesh);
    p.twin = make(&p.mesh);
    p.forces = (sb_vec3 *)malloc((size_t)TURN * (size_t)mesh.node_count * sizeof(sb_vec3));
    p.all = (int *)malloc((size_t)mesh.node_count * sizeof(int));
    def.body = p.body;
    def.max_tools = MOST_TOOLS;
    if (!p.forces || !p.all || sb_contact_create(&def, &p.contact, NULL) != SB_OK)
        exit(1);
    for (int i = 0; i < mesh.node_count; i++)
        p.all[i] = i;
    return p;
}

static pair make_pair(sb_mesh mesh, sb_body *(*make)(const sb_mesh *mesh), double dt)
{
    return make_pair_with(mesh, make, dt, sb_default_contact_def());
}

static void free_pair(pair *p)
{
    sb_contact_destroy(p->contact);
    sb_body_destroy(p->body);
    sb_body_destroy(p->twin);
    sb_mesh_free(&p->mesh);
    free(p->forces);
    free(p->all);
    free(p->led);
}

static void lead_body(const pair *p, sb_body *body, int step)
{
    sb_vec3 way;
    if (!p->lead)
        return;
    way = p->lead(step);
    sb_body_prescribe(body, p->led, p->led_count, SB_XYZ, &way, 1);
}

static void add_tool(pair *p, const sb_tool_def *def)
{
    sb_error error;
    p->poses[p->tool_count] = def->pose;
    if (sb_contact_add_tool(p->contact, def, &p->tools[p->tool_count++], &error) != SB_OK) {
        printf("%s\n", error.message);
        exit(1);
    }
}

/* A step of the body with its tools on their way; its seconds. */
static double step_pair(const pair *p, pair_way way, int step, sb_step_info *info)
{
    double start = now();
    for (int t = 0; t < p->tool_count; t++) {
        sb_pose pose = way(p, t, step);
        sb_contact_move_tool(p->contact, p->tools[t], &pose);
    }
    lead_body(p, p->body, step);
    if (sb_body_step(p->body, p->dt, info) != SB_OK) {
        printf("step %d: %s\n", step, info->error.message);
        exit(1);
    }
    return now() - start;
}

/* A step of the twin with the forces of a step of this turn; its seconds. */
static double step_twin(const pair *p, int step, int place, sb_step_info *info)
{
    double start;
    lead_body(p, p->twin, step);
    sb_body_clear_loads(p->twin);
    sb_body_add_forces(p->twin, p->all, p->mesh.node_count, p->forces + (size_t)place * (size_t)p->mesh.node_count, 0);
    start = now();
    if (sb_body_step(p->twin, p->dt, info) != SB_OK)
        exit(1);
    return now() - start;
}

static void keep_forces(const pair *p, int place)
{
    sb_vec3 *forces = p->forces + (size_t)place * (size_t)p->mesh.node_count;
    memset(forces, 0, (size_t)p->mesh.node_count * sizeof *forces);
    sbi_contact_add_done(p->contact, 1, forces);
}

/* Steps `first` to `last` of both, without a clock. */
static void warm_pair(const pair *p, pair_way way, int first, int last)
{
    sb_step_info info;
    for (int i = first; i < last; i++) {
        step_pair(p, way, i, &info);
        keep_forces(p, 0);
        step_twin(p, i, 0, &info);
    }
}

typedef struct pair_sums {
    double with[STEPS], without[STEPS]; /* s of each step */
    double systems, iterations, twin_iterations, candidates, touching, capped;
} pair_sums;

static void print_pair(const char *name, pair_sums *s)
{
    const double count = STEPS;
    median(s->with, STEPS);
    median(s->without, STEPS);
    printf("%-18s with %6.2f ms least %6.2f median, without %6.2f %6.2f, ratio %.2f %.2f; %.2f systems of %.2f PCG "
           "iterations (without %.2f), %.0f samples near, %.0f touch, capped %.0f %%\n",
           name, 1e3 * s->with[0], 1e3 * s->with[STEPS / 2], 1e3 * s->without[0], 1e3 * s->without[STEPS / 2],
           s->with[0] / s->without[0], s->with[STEPS / 2] / s->without[STEPS / 2], s->systems / count,
           s->iterations / s->systems, s->twin_iterations / count, s->candidates / count, s->touching / count,
           100 * s->capped / count);
    printf("    us a step: begin %.0f, evaluate %.0f (%.1f times), blocks %.0f, accept %.0f, commit %.0f\n",
           1e6 * watched.begin / count, 1e6 * watched.evaluate / count, (double)watched.evaluations / count,
           1e6 * watched.blocks / count, 1e6 * watched.accept / count, 1e6 * watched.commit / count);
    fflush(stdout);
}

/* Steps from `first` on, in turns with those of the twin. */
static void time_pair(const char *name, const pair *p, pair_way way, int first)
{
    static pair_sums s;
    memset(&s, 0, sizeof s);
    watch_contact(p->contact);
    for (int turn = 0; turn < TURNS; turn++) {
        sb_step_info info;
        for (int k = 0; k < TURN; k++) {
            sb_contact_info contact;
            s.with[turn * TURN + k] = step_pair(p, way, first + turn * TURN + k, &info);
            contact = sb_contact_get_info(p->contact);
            s.systems += contact.iterations;
            s.iterations += info.pcg_iterations;
            s.candidates += contact.candidates;
            s.touching += contact.touching;
            s.capped += contact.capped;
            keep_forces(p, k);
        }
        for (int k = 0; k < TURN; k++) {
            s.without[turn * TURN + k] = step_twin(p, first + turn * TURN + k, k, &info);
            s.twin_iterations += info.pcg_iterations;
        }
    }
    print_pair(name, &s);
    p->contact->touch = watched.real;
}

/* ---- a slab ---- */

static sb_mesh slab_mesh(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 18, 18, 7, sb_v3(REAL(0.1), REAL(0.1), REAL(0.04)), 0);
    sb_mesh_reorder(&mesh, NULL, NULL, NULL);
    return mesh;
}

static sb_tool_def sphere_at(double radius, double x, double y, double z)
{
    sb_tool_def def = sb_default_tool_def();
    def.radius = REAL(radius);
    def.friction = REAL(0.3);
    def.pose.position = sb_v3(REAL(x), REAL(y), REAL(z));
    return def;
}

enum { PRESSED = 40 }; /* steps until tools are as deep as they go */

/* Down by 5.5 mm. */
static sb_pose press_down(const pair *p, int tool, int step)
{
    sb_pose pose = p->poses[tool];
    pose.position.z -= REAL(0.0055 * (step < PRESSED ? step : PRESSED) / (double)PRESSED);
    return pose;
}

/* Then to and fro over 50 mm, 0.5 mm in each step. */
static sb_pose press_and_slide(const pair *p, int tool, int step)
{
    sb_pose pose = press_down(p, tool, step);
    int phase = step > PRESSED ? (step - PRESSED) % 200 : 0;
    pose.position.x += REAL(0.0005 * (phase < 100 ? phase : 200 - phase));
    return pose;
}

static pair slab_with_sphere(void)
{
    pair p = make_pair(slab_mesh(), make_slab, 0.01);
    sb_tool_def sphere = sphere_at(0.01, 0.025, 0.05, 0.0505);
    add_tool(&p, &sphere);
    return p;
}

static void time_slide(void)
{
    pair p = slab_with_sphere();
    warm_pair(&p, press_and_slide, 1, PRESSED + 20);
    time_pair("contact_slide_13k", &p, press_and_slide, PRESSED + 20);
    free_pair(&p);
}

static void time_hold(void)
{
    pair p = slab_with_sphere();
    warm_pair(&p, press_down, 1, PRESSED + 200);
    time_pair("contact_hold_13k", &p, press_down, PRESSED + 200);
    free_pair(&p);
}

static void time_narrow(void)
{
    pair p = make_pair(slab_mesh(), make_slab, 0.01);
    for (int i = 0; i < MOST_TOOLS; i++) {
        int x = i % 8, y = i / 8, presses = x >= 2 && x < 6 && y >= 2 && y < 5;
        sb_tool_def sphere = sphere_at(0.0025, 0.015 + 0.01 * x, 0.015 + 0.01 * y, presses ? 0.0475 : 0.07);
        add_tool(&p, &sphere);
    }
    warm_pair(&p, press_down, 1, PRESSED + 100);
    time_pair("contact_narrow", &p, press_down, PRESSED + 100);
    free_pair(&p);
}

/* What a frame for the hand costs after a step, and the step. */
static void time_publish(void)
{
    static double steps[STEPS], frames[STEPS];
    pair p = slab_with_sphere();
    sb_haptic_def def = sb_default_haptic_def();
    sb_haptic *haptic;
    sb_error error;
    double sum = 0;
    def.contact = p.contact;
    def.tool = p.tools[0];
    def.max_force = 8;
    def.max_stiffness = 2000;
    def.max_damping = 3;
    warm_pair(&p, press_and_slide, 1, PRESSED + 20);
    if (sb_haptic_create(&def, &haptic, &error) != SB_OK) {
        printf("%s\n", error.message);
        exit(1);
    }
    for (int i = 0; i < STEPS; i++) {
        sb_step_info info;
        steps[i] = step_pair(&p, press_and_slide, PRESSED + 20 + i, &info);
        frames[i] = now();
        if (sb_haptic_publish(haptic) != SB_OK)
            exit(1);
        frames[i] = now() - frames[i];
        sum += frames[i] / steps[i];
    }
    median(steps, STEPS);
    median(frames, STEPS);
    printf("%-18s %6.0f us least %6.0f median, %.3f of a step in the mean\n", "haptic_publish", 1e6 * frames[0],
           1e6 * frames[STEPS / 2], sum / (double)STEPS);
    sb_haptic_destroy(haptic);
    free_pair(&p);
}

/* ---- an organ ---- */

/* The organ of the shared data, or a generated one of about the same size. */
static sb_mesh organ_mesh(void)
{
    const char *shared = getenv("SHARED");
    char path[1024];
    sb_mesh mesh;
    snprintf(path, sizeof path, "%s/data/volumes/liver_a_tet10_3k.vtk", shared ? shared : "../shared");
    if (sb_mesh_load(&mesh, path, NULL, NULL) != SB_OK && sb_mesh_organ(SB_TET10, 9, NULL, &mesh, NULL) != SB_OK)
        exit(1);
    sb_mesh_reorder(&mesh, NULL, NULL, NULL);
    return mesh;
}

static const double jaw_half = 0.008, jaw_thickness = 0.004, jaw_rounding = 0.003; /* m */

/* Heights between which the organ's faces are around (x, y), as far as a jaw reaches: a large face may have no node
 * there. */
static void organ_heights(const pair *p, double x, double y, double *low, double *high)
{
    const sbi_contact_faces *faces = p->contact->faces;
    *low = HUGE_VAL, *high = -HUGE_VAL;
    for (int face = 0; face < faces->face_end; face++) {
        int parts = faces->kinds[faces->sizes[face]].most;
        for (int s = 0; s < sbi_contact_face_rule(faces, face, parts)->count; s++) {
            sb_vec3 at = sbi_contact_mean(sbi_contact_sample_weights(faces, face, parts, s),
                                          sbi_contact_face_nodes(faces, face), faces->sizes[face], p->mesh.nodes);
            if (fabs((double)at.x - x) < jaw_half && fabs((double)at.y - y) < jaw_half) {
                *low = fmin(*low, (double)at.z);
                *high = fmax(*high, (double)at.z);
            }
        }
    }
}

/* A place where jaws can close: an end of the organ along x or y. */
typedef struct grip_place {
    double x, y, low, high; /* m */
    sb_vec3 out;            /* away from the organ */
} grip_place;
static grip_place grip;

/* The thinnest of the organ's four ends, a jaw's half length inside. Ends that are held do not count. */
static grip_place find_grip(const pair *p)
{
    const sb_mesh *mesh = &p->mesh;
    grip_place best;
    memset(&best, 0, sizeof best);
    best.high = HUGE_VAL;
    for (int end = 0; end < 4; end++) {
        sb_vec3 out = sb_v3(REAL(end == 0 ? -1 : end == 1), REAL(end == 2 ? -1 : end == 3), 0);
        grip_place place;
        int node = -1;
        for (int i = 0; i < mesh->node_count; i++)
            if (node < 0 || sb_v3_dot(out, mesh->nodes[i]) > sb_v3_dot(out, mesh->nodes[node]))
                node = i;
        place.x = (double)mesh->nodes[node].x - jaw_half * (double)out.x;
        place.y = (double)mesh->nodes[node].y - jaw_half * (double)out.y;
        place.out = out;
        organ_heights(p, place.x, place.y, &place.low, &place.high);
        if (!sb_body_supports(p->body)[node] && place.high - place.low < best.high - best.low)
            best = place;
    }
    return best;
}

/* They close, then both draw outward. */
static sb_pose grip_and_drag(const pair *p, int tool, int step)
{
    sb_pose pose = p->poses[tool];
    double closed = 0.2 * (grip.high - grip.low) * (step < PRESSED ? step : PRESSED) / (double)PRESSED;
    pose.position.z += REAL(tool == 0 ? -closed : closed);
    pose.position = sb_v3_madd(pose.position, REAL(0.0001 * (step > PRESSED ? step - PRESSED : 0)), grip.out);
    return pose;
}

static void time_grip(void)
{
    pair p = make_pair(organ_mesh(), make_organ, 0.01);
    double rounding = fmax(jaw_rounding, 1.01 * (double)sbi_contact_faces_thinnest(p.contact->faces, NULL));
    double thickness = fmax(jaw_thickness, rounding);
    grip = find_grip(&p);
    for (int t = 0; t < 2; t++) {
        sb_tool_def jaw = sphere_at(rounding, grip.x, grip.y, t == 0 ? grip.high + thickness : grip.low - thickness);
        jaw.shape = SB_TOOL_BOX;
        jaw.half = sb_v3(REAL(jaw_half), REAL(jaw_half), REAL(thickness));
        add_tool(&p, &jaw);
    }
    warm_pair(&p, grip_and_drag, 1, PRESSED + 20);
    time_pair("contact_grip", &p, grip_and_drag, PRESSED + 20);
    free_pair(&p);
}

/* ---- organ on organ ---- */

static const double blocks_height = 0.04; /* m, of each */

static sb_mesh blocks_mesh(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 12, 12, 6, sb_v3(REAL(0.1), REAL(0.1), REAL(blocks_height)), 0.1);
    sb_mesh other = scene_box(SB_TET4, 11, 11, 7, sb_v3(REAL(0.08), REAL(0.08), REAL(blocks_height)), 0.1);
    for (int i = 0; i < other.node_count; i++) {
        sb_vec3 *x = other.nodes + i, way = sb_v3_sub(*x, sb_v3(REAL(0.04), REAL(0.04), 0));
        x->z += (1 - x->z / REAL(blocks_height)) * (way.x * way.x + way.y * way.y) / REAL(2 * 0.1); /* radius 100 mm */
        *x = sb_v3_add(*x, sb_v3(REAL(0.007), REAL(0.011), REAL(1.01 * blocks_height)));
    }
    if (sb_mesh_append(&mesh, &other, NULL) != SB_OK)
        exit(1);
    sb_mesh_free(&other);
    sb_mesh_reorder(&mesh, NULL, NULL, NULL);
    return mesh;
}

/* 3.4 mm down, the last 3 of them against the other block. */
static sb_vec3 lead_down(int step)
{
    return sb_v3(0, 0, REAL(-0.0034 * (step < PRESSED ? step : PRESSED) / (double)PRESSED));
}

/* Then to and fro over 10 mm, 0.25 mm in each step. */
static sb_vec3 lead_to_and_fro(int step)
{
    sb_vec3 way = lead_down(step);
    int phase = step > PRESSED ? (step - PRESSED) % 80 : 0;
    way.x = REAL(0.00025 * (phase < 40 ? phase : 80 - phase));
    return way;
}

static pair blocks_pressed(sb_vec3 (*lead)(int step))
{
    sb_contact_def def = sb_default_contact_def();
    sb_real top = REAL((2.01 - 1e-3) * blocks_height);
    pair p;
    def.pairs = SB_CONTACT_ORGANS;
    def.pair_friction = REAL(0.2);
    p = make_pair_with(blocks_mesh(), make_slab, 0.01, def);
    p.led = (int *)malloc((size_t)p.mesh.node_count * sizeof(int));
    for (int i = 0; p.led && i < p.mesh.node_count; i++)
        if (p.mesh.nodes[i].z > top)
            p.led[p.led_count++] = i;
    p.lead = lead;
    return p;
}

static void time_blocks(const char *name, sb_vec3 (*lead)(int step), int first)
{
    pair p = blocks_pressed(lead);
    warm_pair(&p, NULL, 1, first);
    time_pair(name, &p, NULL, first);
    free_pair(&p);
}

int main(void)
{
    for (int c = 0; c < (int)(sizeof cases / sizeof cases[0]); c++) {
        sb_mesh mesh = scene_box(cases[c].type, cases[c].cells, cases[c].cells, cases[c].cells, sb_v3(1, 1, 1), 0);
        sb_body_def def = sb_default_body_def();
        sb_vec3 *velocities = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *velocities);
        unsigned long long seed = 3;
        sbi_contact_faces *faces;
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_corotated(5000, REAL(0.45), 1000);
        def.preconditioner = SB_PRECOND_BLOCK_JACOBI;
        body = scene_body(&def);
        for (int i = 0; i < mesh.node_count; i++)
            velocities[i].x = REAL(check_random_in(&seed, -1, 1));
        faces = make_faces(body);
        time_refit(faces, body, velocities, cases[c].name);
        time_queries(faces, 0.1);
        time_queries(faces, 0.33);
        sbi_contact_faces_destroy(faces);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(velocities);
    }
    time_changes();
    time_slide();
    time_hold();
    time_narrow();
    time_grip();
    time_blocks("contact_pairs", lead_to_and_fro, PRESSED + 20);
    time_blocks("contact_pairs_hold", lead_down, PRESSED + 200);
    time_publish();
    return 0;
}
