/* test_contact_skin: tools in contact with a skin that is embedded in a body. */
#define SB_SPLIT_BUILD
#include "../src/softbody/contact/contact_private.h"

#include "skeleton.h"
#include "skin_scene.h"

/* ---- the mesh's boundary as a skin ---- */

static sb_mesh skin_boundary(const sb_mesh *mesh)
{
    sb_boundary boundary;
    sb_mesh surface;
    CHECK_OK(sb_mesh_boundary(mesh, 1, NULL, &boundary, NULL));
    CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &surface, NULL));
    sb_boundary_free(&boundary);
    return surface;
}

/* The same press with it and without: all that is read is the same. spring: 0, or what the tool hangs on (N/m). */
static void boundary_of(sb_integrator integrator, double spring)
{
    const int steps = 30;
    double worst = 0, largest = 0, stiff = 0, stiffest = 0;
    sb_vec3 size = sb_v3(REAL(0.06), REAL(0.05), REAL(0.03));
    sb_tool_def sphere = press_sphere(0.012, 0.4, sb_v3(REAL(0.028), REAL(0.024), REAL(0.0425)));
    sb_mesh mesh = scene_box(SB_TET4, 6, 5, 3, size, 0.15), surface = skin_boundary(&mesh);
    sb_body_def def = skin_tissue(5e3, 0.4);
    sb_real with[6][6], without[6][6];
    skinned s;
    press plain;
    int tool, other;
    def.integrator = integrator;
    if (integrator == SB_CENTRAL_DIFFERENCE)
        def.damping_mass = 20, def.damping_stiffness = 0;
    sphere.coupling_stiffness = REAL(spring);
    s = skin_make(mesh, surface, def, press_exact());
    plain = press_make(scene_box(SB_TET4, 6, 5, 3, size, 0.15), def, press_exact());
    scene_fix_plane(s.p.body, &s.p.mesh, 2, 0, SB_XYZ);
    scene_fix_plane(plain.body, &plain.mesh, 2, 0, SB_XYZ);
    tool = press_add(&s.p, &sphere);
    other = press_add(&plain, &sphere);
    for (int i = 0; i < steps; i++) {
        sb_vec3 at = sphere.pose.position;
        sb_wrench a, b;
        at.z -= REAL(0.0003 * (i < 15 ? i : 15));
        at.x += REAL(0.0002 * (i < 15 ? 0 : i - 15));
        press_move(&s.p, tool, at, sb_quat_make(1, 0, 0, 0));
        press_move(&plain, other, at, sb_quat_make(1, 0, 0, 0));
        CHECK_OK(sb_body_step(s.p.body, REAL(0.01), NULL));
        CHECK_OK(sb_body_step(plain.body, REAL(0.01), NULL));
        a = press_wrench(&s.p, tool);
        b = press_wrench(&plain, other);
        CHECK_INT(sb_contact_points(s.p.contact, NULL, 0), sb_contact_points(plain.contact, NULL, 0));
        largest = fmax(largest, (double)sb_v3_norm(b.force));
        worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(a.force, b.force)));
        worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(a.torque, b.torque)) / 0.012);
    }
    if (integrator != SB_CENTRAL_DIFFERENCE) {
        CHECK_OK(sb_contact_stiffness(s.p.contact, tool, with));
        CHECK_OK(sb_contact_stiffness(plain.contact, other, without));
        for (int i = 0; i < 36; i++) {
            stiffest = fmax(stiffest, fabs((double)without[i / 6][i % 6]));
            stiff = fmax(stiff, fabs((double)(with[i / 6][i % 6] - without[i / 6][i % 6])));
        }
        CHECK(stiffest > 1 && stiff < 1e-3 * stiffest); /* each is solved to that */
    }
    printf("a skin that is the boundary: forces off by %.1e of %.3f N, stiffness by %.1e of %.0f N/m\n",
           worst / largest, largest, stiff, stiffest);
    CHECK(largest > 0.01);
    CHECK_NEAR(worst / largest, 0, scene_tolerance(1e-8, 1e5));
    skin_free(&s);
    press_free(&plain);
}

static void test_boundary(void)
{
    boundary_of(SB_EULER, 0);
    boundary_of(SB_EULER, 200);
    boundary_of(SB_CENTRAL_DIFFERENCE, 0);
}

/* ---- balances ---- */

/* A free body that is hit by a tool and dragged: what the tool does is what its momentum, linear and angular, becomes.
 */
static void free_body(sb_element_type type, double share)
{
    const double dt = 0.005;
    sb_vec3 size = sb_v3(REAL(0.06), REAL(0.06), REAL(0.06)), centre = sb_v3(REAL(0.03), REAL(0.03), REAL(0.03));
    sb_tool_def sphere = press_sphere(0.01, 0.5, sb_v3(REAL(0.033), REAL(0.027), REAL(0.03 + 0.02 + 0.0105)));
    skinned s = skin_make(scene_box(type, 3, 3, 3, size, 0.1), skin_sphere(centre, share * 0.02, 3),
                          skin_tissue(5e3, 0.4), press_exact());
    sb_vec3 impulse = {0, 0, 0};
    double worst = 0, sum = 0, turn = 0;
    int tool = press_add(&s.p, &sphere);
    for (int i = 0; i < 20; i++) {
        sb_vec3 at = sphere.pose.position, before, after, torque;
        sb_wrench on_tool;
        sb_contact_point points[256];
        int count;
        before = sb_body_momentum(s.p.body);
        at.z -= REAL(0.0005 * i);
        at.x += REAL(0.0003 * i);
        press_move(&s.p, tool, at, sb_quat_make(1, 0, 0, 0));
        CHECK_OK(sb_body_step(s.p.body, REAL(dt), NULL));
        after = sb_body_momentum(s.p.body);
        on_tool = press_wrench(&s.p, tool);
        impulse = sb_v3_sub(sb_v3_sub(after, before), sb_v3_scale(REAL(-dt), on_tool.force));
        worst = fmax(worst, (double)sb_v3_norm(impulse));
        sum = fmax(sum, dt * (double)sb_v3_norm(on_tool.force));
        /* the list is the wrench */
        count = sb_contact_points(s.p.contact, points, 256);
        torque = on_tool.torque;
        for (int k = 0; k < count && k < 256; k++) {
            sb_pose pose;
            CHECK_OK(sb_contact_reached(s.p.contact, tool, &pose, NULL));
            on_tool.force = sb_v3_add(on_tool.force, points[k].force);
            torque = sb_v3_add(torque, sb_v3_cross(sb_v3_sub(points[k].point, pose.position), points[k].force));
        }
        turn = fmax(turn, (double)sb_v3_norm(on_tool.force) + (double)sb_v3_norm(torque) / 0.01);
    }
    printf("%s: momentum off by %.1e of %.1e N s, list by %.1e N\n", sb_element_name(type), worst / sum, sum, turn);
    CHECK(sum > 1e-6);
    CHECK_NEAR(worst / sum, 0, scene_tolerance(1e-8, 1e5));
    CHECK_NEAR(turn / (sum / dt), 0, scene_tolerance(1e-12, 1e3));
    skin_free(&s);
}

static void test_momentum(void)
{
    free_body(SB_TET4, 1);
    free_body(SB_TET10, 1);
    free_body(SB_HEX8, 1);
    free_body(SB_HEX20, 1);
    free_body(SB_HEX27, 1);
}

/* At rest: reactions hold the tool's force and torque. */
static void test_equilibrium(void)
{
    const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8};
    for (int k = 0; k < 3; k++) {
        sb_vec3 size = sb_v3(REAL(0.06), REAL(0.06), REAL(0.06)), centre = sb_v3(REAL(0.03), REAL(0.03), REAL(0.035));
        sb_tool_def sphere = press_sphere(0.01, 0.5, sb_v3(REAL(0.031), REAL(0.029), REAL(0.035 + 0.02 + 0.0102)));
        skinned s = skin_make(scene_box(types[k], 4, 4, 4, size, 0.1), skin_sphere(centre, 0.02, 3),
                              skin_tissue(5e3, 0.4), press_exact());
        sb_static_options options = sb_default_static_options();
        sb_vec3 force = {0, 0, 0}, torque = force;
        sb_wrench on_tool;
        sb_pose pose;
        int tool = press_add(&s.p, &sphere);
        scene_fix_plane(s.p.body, &s.p.mesh, 2, 0, SB_XYZ);
        options.tolerance = sb_max(REAL(1e-11), 1000 * SB_EPSILON);
        options.load_steps = 2;
        press_move(&s.p, tool, sb_v3_add(sphere.pose.position, sb_v3(REAL(0.001), 0, REAL(-0.0025))),
                   sb_quat_make(1, 0, 0, 0));
        CHECK_OK(sb_body_solve_static(s.p.body, &options, NULL));
        on_tool = press_wrench(&s.p, tool);
        CHECK_OK(sb_contact_reached(s.p.contact, tool, &pose, NULL));
        for (int i = 0; i < s.p.mesh.node_count; i++) {
            sb_vec3 r = sb_body_reactions(s.p.body)[i], x = sb_body_positions(s.p.body)[i];
            force = sb_v3_add(force, r);
            torque = sb_v3_add(torque, sb_v3_cross(sb_v3_sub(x, pose.position), r));
        }
        force = sb_v3_sub(force, on_tool.force);
        torque = sb_v3_sub(torque, on_tool.torque);
        printf("%s: %.4f N, force off by %.1e, torque by %.1e\n", sb_element_name(types[k]), (double)on_tool.force.z,
               (double)sb_v3_norm(force) / (double)on_tool.force.z,
               (double)sb_v3_norm(torque) / (double)on_tool.force.z / 0.01);
        CHECK(on_tool.force.z > REAL(0.01));
        CHECK_NEAR(sb_v3_norm(force) / on_tool.force.z, 0, scene_tolerance(1e-8, 1e6));
        CHECK_NEAR(sb_v3_norm(torque) / on_tool.force.z / REAL(0.01), 0, scene_tolerance(1e-8, 1e6));
        skin_free(&s);
    }
}

/* ---- Hertz: a ball in a coarse grid, whose cells it cuts, between two plates ---- */

/* Force (N) on the upper plate of two that press a body by a depth (m) each. */
static double squeeze_body(sb_body *body, sb_skin *skin, double depth)
{
    sb_contact_def contact = sb_default_contact_def();
    sb_tool_def plates[2];
    double force;
    int tools[2];
    press p;
    memset(&p, 0, sizeof p);
    contact.body = body;
    contact.skin = skin;
    CHECK_OK(sb_contact_create(&contact, &p.contact, NULL));
    plates[0] = press_plane(0, sb_v3(0, 0, REAL(0.02)), 1);
    plates[1] = press_plane(0, sb_v3(0, 0, REAL(-0.02)), 0);
    for (int k = 0; k < 2; k++)
        tools[k] = press_add(&p, plates + k);
    for (int i = 1; i <= 40; i++) {
        double share = i < 10 ? 0.1 * i : 1;
        for (int k = 0; k < 2; k++)
            press_move(&p, tools[k], sb_v3(0, 0, REAL((k ? -1 : 1) * (0.02 - depth * share))),
                       k ? sb_quat_make(1, 0, 0, 0) : press_upside_down());
        CHECK_OK(sb_body_step(body, REAL(0.1), NULL));
    }
    force = (double)press_wrench(&p, tools[0]).force.z;
    CHECK_NEAR(force, -(double)press_wrench(&p, tools[1]).force.z, 1e-3 * force);
    sb_contact_destroy(p.contact);
    return force;
}

static sb_body_def squeezed_tissue(void)
{
    sb_body_def def = sb_default_body_def();
    def.material = sb_material_linear(REAL(5e3), REAL(0.3), 1000);
    def.damping_stiffness = REAL(0.05);
    return def;
}

/* The ball as a skin in a grid with so many cells along it. */
static double squeeze_grid(const sb_mesh *ball, sb_surface *surface, int cells, double depth)
{
    sb_grid_def settings = sb_default_grid_def();
    sb_embedding_def embed = sb_default_embedding_def();
    sb_body_def def = squeezed_tissue();
    sb_skin *skin = NULL;
    sb_embedding *embedding = NULL;
    sb_body *body;
    sb_grid grid;
    double force;
    memset(&grid, 0, sizeof grid);
    settings.outer.surface = surface;
    settings.cells = cells;
    CHECK_OK(sb_grid_create(&settings, &grid, NULL));
    def.mesh = &grid.body_mesh;
    def.domain = &grid.domain;
    body = scene_body(&def);
    embed.mesh = &grid.mesh;
    embed.surface = ball;
    CHECK_OK(sb_embedding_create(&embed, &embedding, NULL));
    CHECK_OK(sb_skin_create(embedding, ball, NULL, &skin, NULL));
    force = squeeze_body(body, skin, depth);
    sb_skin_destroy(skin);
    sb_embedding_destroy(embedding);
    sb_body_destroy(body);
    sb_grid_free(&grid);
    return force;
}

/* As a mesh that follows its surface. */
static double squeeze_fitted(sb_surface *surface, double cell, double depth)
{
    sb_stuff_def settings = sb_default_stuff_def();
    sb_body_def def = squeezed_tissue();
    sb_shape shape;
    sb_mesh mesh;
    sb_body *body;
    double force;
    memset(&shape, 0, sizeof shape);
    memset(&mesh, 0, sizeof mesh);
    shape.surface = surface;
    settings.shapes = &shape;
    settings.shape_count = 1;
    settings.cell = REAL(cell);
    CHECK_OK(sb_mesh_stuff(&settings, &mesh, NULL, NULL));
    def.mesh = &mesh;
    body = scene_body(&def);
    force = squeeze_body(body, NULL, depth);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return force;
}

static void test_hertz(void)
{
    const double radius = 0.02, depth = 0.0015;
    const int cells[2] = {10, 14};
    double exact = 4.0 / 3 * 5e3 / (1 - 0.09) * sqrt(radius) * pow(depth, 1.5), grid[2], fitted[2];
    sb_mesh ball = skin_sphere(sb_v3(0, 0, 0), radius, 4);
    sb_surface *surface = NULL;
    CHECK_OK(sb_surface_create(&ball, NULL, &surface, NULL));
    for (int k = 0; k < 2; k++) {
        grid[k] = squeeze_grid(&ball, surface, cells[k], depth) / exact - 1;
        fitted[k] = squeeze_fitted(surface, 2 * radius / cells[k], depth) / exact - 1;
        printf("a ball between plates, cells of %.1f mm: in a grid %+.1f %% of Hertz's force, fitted %+.1f %%\n",
               2000 * radius / cells[k], 100 * grid[k], 100 * fitted[k]);
    }
    CHECK(grid[1] < grid[0]);
    CHECK_NEAR(grid[1], fitted[1],
               0.1); /* both are that much too stiff: cells are half as long as the contact is wide */
    sb_surface_destroy(surface);
    sb_mesh_free(&ball);
}

/* ---- never through ---- */

static struct watch {
    skinned *s;
    sb_vec3 *before, *now;
    sb_pose from;
    int tool, crossings;
    void (*commit)(void *contact);
} watch;

static void watch_keep(void)
{
    CHECK_OK(sb_embedding_update(watch.s->embedding, sb_body_positions(watch.s->p.body), watch.before, NULL, NULL));
    CHECK_OK(sb_contact_reached(watch.s->p.contact, watch.tool, &watch.from, NULL));
}

/* In place of the contact's own: looks at each part of a step. */
static void watch_commit(void *user)
{
    const sbi_contact_tool *t = ((const sb_contact *)user)->tools + watch.tool;
    const sb_mesh *surface = &watch.s->surface;
    watch.commit(user);
    CHECK_OK(sb_embedding_update(watch.s->embedding, sb_body_positions(watch.s->p.body), watch.now, NULL, NULL));
    for (int f = 0; f < surface->element_count; f++) {
        sb_vec3 start[3], end[3];
        for (int a = 0; a < 3; a++) {
            start[a] = watch.before[surface->elements[3 * f + a]];
            end[a] = watch.now[surface->elements[3 * f + a]];
        }
        watch.crossings +=
            skeleton_passes(t->shape, t->chain_reached, &watch.from, start, t->chain_reached, &t->reached, end);
    }
    watch_keep();
}

static sb_vec3 random_vector(unsigned long long *seed, double size)
{
    double x = check_random_in(seed, -size, size), y = check_random_in(seed, -size, size);
    return sb_v3(REAL(x), REAL(y), REAL(check_random_in(seed, -size, size)));
}

/* A ball of skin somewhere in a random box, and a tool that goes through its middle, or tries to. */
static void sweep_once(unsigned long long seed, int *touching, int *refused)
{
    const sb_vec3 chain[3] = {{REAL(-0.02), 0, 0}, {0, 0, 0}, {REAL(0.02), 0, REAL(0.003)}};
    double edge = 0.04, radius = check_random_in(&seed, 0.009, 0.016), dt = check_random_in(&seed, 0.005, 0.017);
    double speed = 0.1 * pow(50, check_random(&seed));
    sb_vec3 centre = sb_v3_add(sb_v3(REAL(edge / 2), REAL(edge / 2), REAL(edge / 2)), random_vector(&seed, 0.003));
    sb_vec3 way = random_vector(&seed, 1), spin = random_vector(&seed, 2);
    sb_body_def def = skin_tissue(check_random_in(&seed, 2e3, 2e4), check_random_in(&seed, 0, 0.45));
    sb_contact_def contact = sb_default_contact_def();
    sb_tool_def tool = press_sphere(check_random_in(&seed, 0.003, 0.006), check_random_in(&seed, 0, 0.6), centre);
    skinned s;
    def.tolerance = sb_default_body_def().tolerance;
    way = sb_v3_scale(1 / sb_v3_norm(way), way);
    s = skin_make(scene_box(check_random(&seed) < 0.7 ? SB_TET4 : SB_HEX8, 3, 3, 3,
                            sb_v3(REAL(edge), REAL(edge), REAL(edge)), 0.2),
                  skin_sphere(centre, radius, 2), def, contact);
    if (check_random(&seed) < 0.5)
        scene_fix_plane(s.p.body, &s.p.mesh, 2, 0, SB_XYZ);
    if (check_random(&seed) < 0.5) {
        tool.shape = SB_TOOL_CAPSULES;
        tool.points = chain;
        tool.point_count = 3;
    }
    tool.pose = press_pose(sb_v3_madd(centre, REAL(-0.045), way), sb_quat_from_rotation_vector(spin));
    watch.s = &s;
    watch.tool = press_add(&s.p, &tool);
    watch.before = (sb_vec3 *)calloc((size_t)s.surface.node_count, sizeof(sb_vec3));
    watch.now = (sb_vec3 *)calloc((size_t)s.surface.node_count, sizeof(sb_vec3));
    watch.commit = s.p.contact->touch.commit;
    s.p.contact->touch.commit = watch_commit;
    for (int i = 1; i <= 16; i++) {
        double at = -0.045 + 0.012 + speed * dt * i;
        uint64_t hash = sb_body_state_hash(s.p.body);
        press_move(&s.p, watch.tool, sb_v3_madd(centre, REAL(at < 0.05 ? at : 0.05), way), tool.pose.rotation);
        hash = sb_body_state_hash(s.p.body);
        watch_keep();
        if (sb_body_step(s.p.body, REAL(dt), NULL) != SB_OK) {
            ++*refused;
            CHECK(sb_body_state_hash(s.p.body) == hash);
        }
        *touching += sb_contact_get_info(s.p.contact).touching > 0;
    }
    free(watch.before);
    free(watch.now);
    skin_free(&s);
}

static void test_sweeps(void)
{
    int rounds = check_rounds(40), touching = 0, refused = 0;
    watch.crossings = 0;
    for (int i = 0; i < rounds; i++)
        sweep_once(1000003ull * (unsigned long long)i + 17, &touching, &refused);
    printf("%d sweeps: %d steps touch, %d refused, %d crossings\n", rounds, touching, refused, watch.crossings);
    CHECK_INT(watch.crossings, 0);
    CHECK_INT(refused, 0);
    CHECK(touching > 3 * rounds);
}

/* ---- states, recordings, threads ---- */

typedef struct play {
    skinned s;
    int tool, workers;
} play;

static void play_make(play *p, int workers, const sb_allocator *allocator)
{
    sb_vec3 size = sb_v3(REAL(0.05), REAL(0.05), REAL(0.05)), centre = sb_v3(REAL(0.025), REAL(0.025), REAL(0.027));
    sb_tool_def sphere = press_sphere(0.008, 0.4, sb_v3(REAL(0.026), REAL(0.024), REAL(0.027 + 0.02 + 0.0085)));
    sb_body_def def = sb_default_body_def();
    def.material = sb_material_corotated(REAL(5e3), REAL(0.4), 1000);
    def.damping_stiffness = REAL(0.01);
    def.slack = REAL(0.2);
    p->workers = workers;
    def.jobs = scene_jobs(&p->workers);
    if (allocator)
        def.allocator = *allocator;
    p->s =
        skin_make(scene_box(SB_TET4, 5, 5, 5, size, 0.1), skin_sphere(centre, 0.02, 4), def, sb_default_contact_def());
    scene_fix_plane(p->s.p.body, &p->s.p.mesh, 2, 0, SB_XYZ);
    p->tool = press_add(&p->s.p, &sphere);
}

static void play_steps(play *p, int from, int to)
{
    for (int i = from; i < to; i++) {
        press_move(&p->s.p, p->tool,
                   sb_v3(REAL(0.026 + 0.0003 * i), REAL(0.024), REAL(0.0555 - 0.0005 * (i < 10 ? i : 10))),
                   sb_quat_make(1, 0, 0, 0));
        CHECK_OK(sb_body_step(p->s.p.body, REAL(0.01), NULL));
    }
}

static void test_state(void)
{
    play p, other;
    sb_recording *recording = NULL;
    sb_recording_report report;
    uint64_t end;
    size_t size;
    void *image;
    press plain = press_make(scene_box(SB_TET4, 5, 5, 5, sb_v3(REAL(0.05), REAL(0.05), REAL(0.05)), 0.1),
                             skin_tissue(5e3, 0.4), sb_default_contact_def());
    play_make(&p, 1, NULL);
    play_make(&other, 3, NULL);
    play_steps(&p, 0, 12);
    play_steps(&other, 0, 12);
    CHECK(sb_contact_get_info(p.s.p.contact).touching > 5);
    CHECK(sb_body_state_hash(p.s.p.body) == sb_body_state_hash(other.s.p.body)); /* whatever the threads */
    size = sb_body_state_size(p.s.p.body);
    image = malloc(size);
    CHECK_OK(sb_body_state_save(p.s.p.body, image, size));
    CHECK_OK(sb_recording_start(p.s.p.body, 1, NULL, &recording, NULL));
    play_steps(&p, 12, 24);
    sb_recording_stop(recording);
    end = sb_body_state_hash(p.s.p.body);
    play_steps(&other, 12, 15); /* anything */
    CHECK_OK(sb_body_state_load(other.s.p.body, image, size, NULL));
    play_steps(&other, 12, 24);
    CHECK(sb_body_state_hash(other.s.p.body) == end);
    if (!CHECK_OK(sb_recording_replay(recording, other.s.p.body, &report)))
        printf("step %d: %s\n", report.step, report.error.message);
    CHECK(sb_body_state_hash(other.s.p.body) == end);
    CHECK(sb_body_state_load(plain.body, image, size, NULL) != SB_OK); /* its contact has no skin */
    sb_recording_destroy(recording);
    free(image);
    skin_free(&p.s);
    skin_free(&other.s);
    press_free(&plain);
}

/* A step that is refused leaves all as it was. */
static void test_undo(void)
{
    play p;
    uint64_t hash;
    sb_static_options options = sb_default_static_options();
    play_make(&p, 1, NULL);
    play_steps(&p, 0, 12);
    press_move(&p.s.p, p.tool, sb_v3(REAL(0.03), REAL(0.024), REAL(0.049)), sb_quat_make(1, 0, 0, 0));
    hash = sb_body_state_hash(p.s.p.body);
    options.max_newton = 1;
    options.tolerance = sb_max(REAL(1e-14), SB_EPSILON);
    CHECK(sb_body_solve_static(p.s.p.body, &options, NULL) != SB_OK);
    CHECK(sb_body_state_hash(p.s.p.body) == hash);
    skin_free(&p.s);
}

/* ---- a mesh that changes below it ---- */

static void test_change(void)
{
    play p;
    sb_wrench before, after;
    play_make(&p, 1, NULL);
    play_steps(&p, 0, 20);
    before = press_wrench(&p.s.p, p.tool);
    scene_remove_cells(p.s.p.body);
    for (int i = 0; i < 10; i++)
        CHECK_OK(sb_body_step(p.s.p.body, REAL(0.01), NULL));
    after = press_wrench(&p.s.p, p.tool);
    CHECK(sb_contact_get_info(p.s.p.contact).touching > 5);
    CHECK(after.force.z > 0 && after.force.z != before.force.z);
    CHECK_NEAR(after.force.z, before.force.z, 0.3 * (double)before.force.z);
    skin_free(&p.s);
}

/* Points are in the cells that the embedding has them in at once, also where it was let go and followed the body anew
 * after the contact. */
static void test_followed_anew(void)
{
    play p;
    const sbi_contact_skin *skin;
    play_make(&p, 1, NULL);
    play_steps(&p, 0, 15);
    CHECK_OK(sb_embedding_unfollow(p.s.embedding));
    CHECK_OK(sb_embedding_follow(p.s.embedding, p.s.p.body, NULL));
    scene_remove_cells(p.s.p.body);
    skin = &p.s.p.contact->skin;
    for (int i = 0; i < skin->point_count; i++) {
        sbi_skin_point at;
        skin->source->get_point(skin->source, i, &at);
        CHECK_INT(skin->cells[i], at.cell);
        CHECK(sb_body_cell_in_use(p.s.p.body, skin->cells[i]));
    }
    play_steps(&p, 15, 20);
    CHECK(sb_contact_get_info(p.s.p.contact).touching > 5);
    skin_free(&p.s);
}

/* ---- memory and refusals ---- */

static void test_no_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    sb_vec3 centre = sb_v3(REAL(0.01), REAL(0.01), REAL(0.01));
    skinned s = skin_make(scene_box(SB_TET4, 2, 2, 2, sb_v3(REAL(0.02), REAL(0.02), REAL(0.02)), 0),
                          skin_sphere(centre, 0.008, 2), skin_tissue(5e3, 0.3), sb_default_contact_def());
    sb_contact_def def = sb_default_contact_def();
    sb_tool_def tool = press_sphere(0.004, 0, sb_v3(REAL(0.01), REAL(0.01), REAL(0.0221)));
    sb_skin *skin = NULL;
    sb_contact *contact = NULL;
    sb_result result = SB_ERROR_MEMORY;
    int fails = 0, live, number, calls;
    sb_contact_destroy(s.p.contact);
    s.p.contact = NULL;
    scene_fix_plane(s.p.body, &s.p.mesh, 2, 0, SB_XYZ);
    for (; result != SB_OK && fails < 100; fails++) {
        memory.calls = 0;
        memory.fail_at = fails + 1;
        result = sb_skin_create(s.embedding, &s.surface, &allocator, &skin, NULL);
        CHECK(result == SB_OK || (result == SB_ERROR_MEMORY && memory.live == 0 && !skin));
    }
    CHECK(fails == 4 && result == SB_OK);
    def.body = s.p.body;
    def.skin = skin;
    def.allocator = &allocator;
    live = memory.live;
    for (result = SB_ERROR_MEMORY, fails = 0; result != SB_OK && fails < 100; fails++) {
        memory.calls = 0;
        memory.fail_at = fails + 1;
        result = sb_contact_create(&def, &contact, NULL);
        CHECK(result == SB_OK || (result == SB_ERROR_MEMORY && memory.live == live && !contact));
    }
    CHECK(fails > 5 && result == SB_OK);
    memory.fail_at = 0;
    CHECK_OK(sb_contact_add_tool(contact, &tool, &number, NULL));
    calls = memory.calls;
    for (int i = 0; i < 10; i++) {
        tool.pose.position.z -= REAL(0.0003);
        CHECK_OK(sb_contact_move_tool(contact, number, &tool.pose));
        CHECK_OK(sb_body_step(s.p.body, REAL(0.01), NULL));
    }
    CHECK(sb_contact_get_info(contact).touching > 0);
    CHECK_INT(memory.calls, calls); /* nothing in a step */
    sb_contact_destroy(contact);
    sb_skin_destroy(skin);
    CHECK_INT(memory.live, 0);
    skin_free(&s);
}

static void test_refused(void)
{
    sb_vec3 centre = sb_v3(REAL(0.01), REAL(0.01), REAL(0.01)), size = sb_v3(REAL(0.02), REAL(0.02), REAL(0.02));
    skinned s = skin_make(scene_box(SB_TET4, 2, 2, 2, size, 0), skin_sphere(centre, 0.008, 2), skin_tissue(5e3, 0.3),
                          sb_default_contact_def());
    sb_mesh other_mesh = scene_box(SB_TET4, 2, 1, 2, size, 0), hexes = scene_box(SB_HEX8, 2, 2, 2, size, 0);
    sb_contact_def def = sb_default_contact_def();
    sb_contact *contact = NULL;
    sb_skin *skin = NULL;
    sb_body_def body_def = sb_default_body_def();
    sb_body *other, *changing;
    sb_error error;
    body_def.mesh = &other_mesh;
    body_def.material = sb_material_corotated(REAL(5e3), REAL(0.3), 1000);
    other = scene_body(&body_def);
    changing = scene_changing_body(&s.p.mesh, sb_material_corotated(REAL(5e3), REAL(0.3), 1000));
    def.skin = s.skin;
    def.body = other;
    CHECK_RESULT(sb_contact_create(&def, &contact, &error), SB_ERROR_STATE); /* another mesh */
    def.body = changing;
    CHECK_RESULT(sb_contact_create(&def, &contact, &error), SB_ERROR_STATE); /* which the embedding does not follow */
    CHECK_RESULT(sb_skin_create(NULL, &s.surface, NULL, &skin, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_skin_create(s.embedding, NULL, NULL, &skin, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_skin_create(s.embedding, &hexes, NULL, &skin, &error), SB_ERROR_UNSUPPORTED);
    CHECK(!contact && !skin);
    sb_body_destroy(other);
    sb_body_destroy(changing);
    sb_mesh_free(&other_mesh);
    sb_mesh_free(&hexes);
    skin_free(&s);
}

CHECK_SUITE(contact_skin, {"the boundary", test_boundary}, {"momentum", test_momentum},
            {"equilibrium", test_equilibrium}, {"Hertz", test_hertz}, {"sweeps", test_sweeps}, {"state", test_state},
            {"undo", test_undo}, {"changes of the mesh", test_change}, {"followed anew", test_followed_anew},
            {"no memory", test_no_memory}, {"refused", test_refused});
