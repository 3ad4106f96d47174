/* test_contact_cut: tools on the true surface of a body that is cut: its skin and the lips of the cuts. */
#define SB_SPLIT_BUILD
#include "../src/softbody/contact/contact_private.h"
#include "../src/softbody/cut/cut_skin.h"

#include "contact_scene.h"
#include "cut_block.h"

typedef struct scene {
    block b;
    sb_cut_surface *surface;
    press p; /* body and contact of it */
    int workers;
} scene;

/* with: contact on the cut's surface; 0: on the mesh's boundary. */
static void scene_make_of(scene *s, sb_element_type element, int lattice, int with, int workers,
                          const sb_allocator *allocator)
{
    block_options options = block_default(lattice);
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    sb_error error;
    memset(s, 0, sizeof *s);
    s->workers = workers;
    s->b.mesh = scene_box(element, options.nx, options.ny, options.nz, block_size, options.shake);
    def.mesh = &s->b.mesh;
    def.material = sb_material_corotated(REAL(5000), REAL(0.4), 1000);
    def.damping_stiffness = REAL(0.02);
    def.slack = REAL(options.slack);
    def.tolerance = sb_max(REAL(1e-10), 100 * SB_EPSILON);
    def.jobs = scene_jobs(&s->workers);
    s->b.body = scene_body(&def);
    block_cut_create(&s->b, lattice);
    CHECK_OK(sb_cut_surface_create(s->b.cut, allocator, &s->surface, NULL));
    contact.body = s->b.body;
    contact.max_iterations = 20;
    contact.allocator = allocator;
    contact.skin = with ? sb_cut_surface_skin(s->surface) : NULL;
    if (!CHECK_OK(sb_contact_create(&contact, &s->p.contact, &error)))
        printf("%s\n", error.message);
    s->p.body = s->b.body;
}

static void scene_make(scene *s, int lattice, int with, int workers, const sb_allocator *allocator)
{
    scene_make_of(s, SB_TET4, lattice, with, workers, allocator);
}

static void scene_free(scene *s)
{
    sb_contact_destroy(s->p.contact);
    sb_cut_surface_destroy(s->surface);
    block_free(&s->b);
}

/* The part that has the node nearest to a place at rest. */
static int part_at(const scene *s, sb_vec3 place)
{
    int nearest = 0;
    for (int i = 0; i < s->b.mesh.node_count; i++)
        if (sb_v3_norm(sb_v3_sub(s->b.mesh.nodes[i], place)) < sb_v3_norm(sb_v3_sub(s->b.mesh.nodes[nearest], place)))
            nearest = i;
    return s->b.body->node_component[nearest];
}

static sb_vec3 part_momentum(const scene *s, int part)
{
    const sb_vec3 *v = sb_body_velocities(s->b.body);
    sb_vec3 sum = {0, 0, 0};
    for (int i = 0; i < sb_body_node_count(s->b.body); i++)
        if (sb_body_node_in_use(s->b.body, i) && s->b.body->node_component[i] == part)
            sum = sb_v3_madd(sum, s->b.body->lumped_mass[i], v[i]);
    return sum;
}

static void move_part(scene *s, int part, sb_vec3 way)
{
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)sb_body_node_count(s->b.body), sizeof *u);
    for (int i = 0; i < sb_body_node_count(s->b.body); i++)
        if (sb_body_node_in_use(s->b.body, i) && s->b.body->node_component[i] == part)
            u[i] = way;
    CHECK_OK(sb_body_set_displacements(s->b.body, u));
    free(u);
}

static void take_step(const scene *s, double dt)
{
    sb_step_info info;
    if (!CHECK_OK(sb_body_step(s->b.body, REAL(dt), &info)))
        printf("%s\n", info.error.message);
}

/* ---- where the lips are ---- */

static const double cut_at = 0.0337; /* m, within elements of 10 mm */

/* Where a sphere that comes from the right touches first what is left of a block whose right part was taken away. */
static double first_touch(sb_element_type element, int lattice, int with)
{
    const double radius = 0.008;
    scene s;
    sb_tool_def sphere;
    double x = 0.06, force = 0;
    int tool, lips = 0, count;
    static sb_contact_point points[4096];
    scene_make_of(&s, element, lattice, with, 1, NULL);
    scene_fix_plane(s.b.body, &s.b.mesh, 0, 0, SB_XYZ);
    CHECK_INT(block_cut_plane(&s.b, sb_v3(REAL(cut_at), 0, 0), sb_v3(1, 0, 0)).parts, 2);
    move_part(&s, part_at(&s, sb_v3(1, 0, 0)), sb_v3(1, 0, 0));
    sphere = press_sphere(radius, 0.3, sb_v3(REAL(x), REAL(0.0213), REAL(0.0257)));
    tool = press_add(&s.p, &sphere);
    for (int i = 0; i < 100 && sb_contact_get_info(s.p.contact).touching == 0; i++) {
        x -= 0.0004;
        press_move(&s.p, tool, sb_v3(REAL(x), REAL(0.0213), REAL(0.0257)), sb_quat_make(1, 0, 0, 0));
        take_step(&s, 0.01);
    }
    for (int i = 0; i < 10; i++) {
        x -= 0.0002;
        press_move(&s.p, tool, sb_v3(REAL(x), REAL(0.0213), REAL(0.0257)), sb_quat_make(1, 0, 0, 0));
        take_step(&s, 0.01);
    }
    x += 0.002;
    force = (double)press_wrench(&s.p, tool).force.x;
    CHECK(force > 1e-3);
    count = sb_contact_points(s.p.contact, points, 4096);
    for (int i = 0; with && i < count && i < 4096; i++)
        lips += sb_cut_surface_get(s.surface).tags[points[i].face] == SB_CUT_LIP;
    CHECK(!with || lips == count);
    scene_free(&s);
    return x - radius;
}

static void test_place(void)
{
    for (int k = 0; k < 4; k++) {
        sb_element_type element = k < 3 ? SB_TET4 : SB_TET10;
        int lattice = intervals_of[k % 3];
        double with = first_touch(element, lattice, 1), without = first_touch(element, lattice, 0);
        printf("%s, lattice %d: a lip at %.2f mm is touched at %.2f mm, the elements' boundary at %.2f mm\n",
               sb_element_name(element), lattice, 1e3 * cut_at, 1e3 * with, 1e3 * without);
        CHECK(with > cut_at - 0.0009 && with < cut_at + 0.0003);
        CHECK(without > cut_at + 0.001);
    }
}

/* A tool beside the cut moves the one side only, which has all that it gives. */
static void test_beyond(void)
{
    scene s;
    sb_tool_def sphere = press_sphere(0.005, 0.3, sb_v3(REAL(0.026), REAL(0.02), REAL(0.05 + 0.0052)));
    sb_vec3 before, after;
    double dt = 0.005, worst = 0, largest = 0;
    int left, right, tool;
    scene_make(&s, 2, 1, 1, NULL);
    CHECK_INT(block_cut_plane(&s.b, sb_v3(REAL(cut_at), 0, 0), sb_v3(1, 0, 0)).parts, 2);
    left = part_at(&s, sb_v3(0, 0, 0));
    right = part_at(&s, sb_v3(1, 0, 0));
    move_part(&s, right, sb_v3(REAL(0.0015), 0, 0));
    tool = press_add(&s.p, &sphere);
    for (int i = 0; i < 30; i++) {
        sb_vec3 at = sb_v3_add(sphere.pose.position, sb_v3(0, 0, REAL(-0.0002 * i)));
        before = part_momentum(&s, left);
        press_move(&s.p, tool, at, sb_quat_make(1, 0, 0, 0));
        take_step(&s, dt);
        after = part_momentum(&s, left);
        worst = fmax(worst, (double)sb_v3_norm(sb_v3_add(sb_v3_sub(after, before),
                                                         sb_v3_scale(REAL(dt), press_wrench(&s.p, tool).force))));
        largest = fmax(largest, dt * (double)sb_v3_norm(press_wrench(&s.p, tool).force));
    }
    printf("beside a cut: the one side has its momentum to %.1e, the other has %.1e of it\n", worst / largest,
           (double)sb_v3_norm(part_momentum(&s, right)) / (double)sb_v3_norm(after));
    CHECK(largest > 1e-5);
    CHECK_NEAR(worst / largest, 0, scene_tolerance(1e-8, 1e6));
    CHECK_NEAR(sb_v3_norm(part_momentum(&s, right)) / sb_v3_norm(after), 0, scene_tolerance(1e-9, 1e5));
    scene_free(&s);
}

/* ---- a flap ---- */

static double highest_tip(const scene *s)
{
    double highest = 0;
    for (int i = 0; i < s->b.mesh.node_count; i++)
        if (s->b.mesh.nodes[i].x > REAL(0.059) && s->b.mesh.nodes[i].z > REAL(0.049))
            highest = fmax(highest, (double)sb_body_positions(s->b.body)[i].z);
    return highest;
}

/* A flap is bent open; a bar comes in below it, takes it over, and lifts it by its lip. */
static void test_flap(void)
{
    const sb_vec3 chain[2] = {{0, REAL(-0.03), 0}, {0, REAL(0.03), 0}};
    scene s;
    sb_tool_def bar = press_sphere(0.004, 0.3, sb_v3(REAL(0.1), REAL(0.02), REAL(0.046)));
    sb_vec3 square[6];
    static sb_contact_point points[4096];
    int held[64], count = 0, tool, touching, lips = 0, up = 0;
    double opened, rests, lifted;
    scene_make(&s, 2, 1, 1, NULL);
    scene_fix_plane(s.b.body, &s.b.mesh, 2, 0, SB_XYZ);
    square_make(sb_v3(REAL(0.072), REAL(0.02), REAL(0.0362)), sb_v3(0, 0, 1), 0.05, square);
    CHECK(block_cut(&s.b, square, 2).links > 0);
    for (int i = 0; i < s.b.mesh.node_count; i++)
        if (s.b.mesh.nodes[i].x > REAL(0.059) && s.b.mesh.nodes[i].z > REAL(0.049) && count < 64)
            held[count++] = i;
    for (int i = 1; i <= 20; i++) {
        sb_vec3 way[64];
        for (int k = 0; k < count; k++)
            way[k] = sb_v3(0, 0, REAL(0.001 * i));
        CHECK_OK(sb_body_prescribe(s.b.body, held, count, SB_XYZ, way, 0));
        take_step(&s, 0.02);
    }
    bar.shape = SB_TOOL_CAPSULES;
    bar.points = chain;
    bar.point_count = 2;
    tool = press_add(&s.p, &bar);
    for (int i = 1; i <= 40; i++) { /* in below the flap, which does not touch it yet */
        press_move(&s.p, tool, sb_v3(REAL(0.1 - 0.0012 * i), REAL(0.02), REAL(0.046)), sb_quat_make(1, 0, 0, 0));
        take_step(&s, 0.02);
    }
    opened = highest_tip(&s);
    CHECK_OK(sb_body_release_nodes(s.b.body, held, count, SB_XYZ));
    for (int i = 0; i < 60; i++)
        take_step(&s, 0.02);
    rests = highest_tip(&s);
    touching = sb_contact_points(s.p.contact, points, 4096);
    for (int i = 0; i < touching && i < 4096; i++) {
        lips += sb_cut_surface_get(s.surface).tags[points[i].face] == SB_CUT_LIP;
        up += points[i].normal.z > 0;
    }
    printf("%d touch, %d of lips, %d look up\n", touching, lips, up);
    CHECK(lips > touching / 2 && up == touching);          /* beside the lip's edges also the flanks do */
    CHECK(press_wrench(&s.p, tool).force.z < REAL(-1e-3)); /* it bears it */
    for (int i = 1; i <= 30; i++) {
        press_move(&s.p, tool, sb_v3(REAL(0.052), REAL(0.02), REAL(0.046 + 0.0003 * i)), sb_quat_make(1, 0, 0, 0));
        take_step(&s, 0.02);
    }
    lifted = highest_tip(&s);
    printf("a flap is opened to %.1f mm, rests on a bar at %.1f mm with %.4f N, and is lifted to %.1f mm\n",
           1e3 * opened, 1e3 * rests, -(double)press_wrench(&s.p, tool).force.z, 1e3 * lifted);
    CHECK(rests < opened && rests > 0.051);
    CHECK(lifted > rests + 0.005);
    scene_free(&s);
}

/* ---- following ---- */

/* Pressed and dragged with friction, then cut. */
static void play(scene *s, int tool, int from, int to)
{
    for (int i = from; i < to; i++) {
        press_move(&s->p, tool,
                   sb_v3(REAL(0.012 + 0.0004 * (i > 10 ? i - 10 : 0)), REAL(0.019),
                         REAL(0.05 + 0.006 - 0.0003 * (i < 10 ? i : 10))),
                   sb_quat_make(1, 0, 0, 0));
        take_step(s, 0.01);
        if (i == 14)
            block_cut_plane(&s->b, sb_v3(REAL(cut_at), 0, 0), sb_v3(1, REAL(0.2), 0));
        if (i == 20) {
            sb_vec3 square[6];
            square_make(sb_v3(REAL(0.012), REAL(0.02), REAL(0.06)), sb_v3(0, 1, REAL(0.1)), 0.02, square);
            block_cut(&s->b, square, 2);
        }
    }
}

static int play_begin(scene *s)
{
    sb_tool_def sphere = press_sphere(0.006, 0.4, sb_v3(REAL(0.012), REAL(0.019), REAL(0.0561)));
    scene_fix_plane(s->b.body, &s->b.mesh, 2, 0, SB_XYZ);
    return press_add(&s->p, &sphere);
}

/* A cut far from a tool leaves what is remembered there, and its force. */
static void test_kept(void)
{
    scene s;
    int tool, entries, pressures;
    double before, after;
    scene_make(&s, 2, 1, 1, NULL);
    tool = play_begin(&s);
    play(&s, tool, 0, 10);
    for (int i = 0; i < 30; i++)
        take_step(&s, 0.01);
    before = (double)press_wrench(&s.p, tool).force.z;
    entries = s.p.contact->entry_count;
    pressures = s.p.contact->pressure_count;
    printf("%d entries, %d pressures\n", entries, pressures);
    CHECK(entries > 4 && pressures > 1);
    CHECK_INT(block_cut_plane(&s.b, sb_v3(REAL(0.045), 0, 0), sb_v3(1, 0, 0)).parts, 2);
    CHECK_INT(sb_contact_points(s.p.contact, NULL, 0), entries);
    CHECK_OK(sbi_contact_update_faces(s.p.contact, NULL));
    CHECK_INT(s.p.contact->entry_count, entries);
    CHECK_INT(s.p.contact->pressure_count, pressures);
    take_step(&s, 0.01);
    after = (double)press_wrench(&s.p, tool).force.z;
    CHECK_NEAR(after, before, 0.01 * before);
    /* through what it presses: what is cut is forgotten, no more */
    CHECK(block_cut_plane(&s.b, sb_v3(REAL(0.012), 0, 0), sb_v3(1, 0, 0)).links > 0);
    CHECK_OK(sbi_contact_update_faces(s.p.contact, NULL));
    CHECK(s.p.contact->entry_count < entries);
    for (int i = 0; i < 30; i++)
        take_step(&s, 0.01);
    CHECK(press_wrench(&s.p, tool).force.z > REAL(0.3 * before) && press_wrench(&s.p, tool).force.z < REAL(before));
    scene_free(&s);
}

static void test_state(void)
{
    scene s, other;
    int tool, same;
    sb_recording *recording = NULL;
    sb_recording_report report;
    uint64_t end, kept;
    size_t size, first;
    void *image, *begin;
    scene_make(&s, 2, 1, 1, NULL);
    scene_make(&other, 2, 1, 3, NULL);
    tool = play_begin(&s);
    same = play_begin(&other);
    CHECK_INT(tool, same);
    first = sb_body_state_size(s.b.body);
    begin = malloc(first);
    CHECK_OK(sb_body_state_save(s.b.body, begin, first));
    CHECK_OK(sb_recording_start(s.b.body, 1, NULL, &recording, NULL));
    play(&s, tool, 0, 18);
    size = sb_body_state_size(s.b.body);
    image = malloc(size);
    CHECK_OK(sb_body_state_save(s.b.body, image, size));
    kept = sb_body_state_hash(s.b.body);
    play(&s, tool, 18, 26);
    sb_recording_stop(recording);
    end = sb_body_state_hash(s.b.body);
    play(&other, tool, 0, 26);
    CHECK(sb_body_state_hash(other.b.body) == end);                /* whatever the threads */
    CHECK_OK(sb_body_state_load(other.b.body, image, size, NULL)); /* takes a cut back */
    CHECK(sb_body_state_hash(other.b.body) == kept);
    CHECK_OK(sb_contact_set_friction(other.p.contact, tool, REAL(0.4)));
    play(&other, tool, 18, 26);
    CHECK(sb_body_state_hash(other.b.body) == end);
    CHECK_OK(sb_body_state_load(other.b.body, begin, first, NULL));
    if (!CHECK_OK(sb_recording_replay(recording, other.b.body, &report)))
        printf("step %d: %s\n", report.step, report.error.message);
    CHECK(sb_body_state_hash(other.b.body) == end);
    sb_recording_destroy(recording);
    free(image);
    free(begin);
    scene_free(&s);
    scene_free(&other);
}

/* A state that is saved when a cut was made, before the step in which contact follows, goes on with the same bits: in
 * touch are triangles of faces that were cut before, whose numbers the cut changes. */
static void test_state_in_between(void)
{
    scene s, other;
    uint64_t end, kept;
    size_t size;
    void *image, *again;
    int tool;
    scene_make(&s, 2, 1, 1, NULL);
    scene_make(&other, 2, 1, 1, NULL);
    tool = play_begin(&s);
    CHECK_INT(play_begin(&other), tool);
    play(&s, tool, 0, 26);
    CHECK(block_cut_plane(&s.b, sb_v3(0, REAL(0.004), 0), sb_v3(0, 1, 0)).links > 0);
    CHECK(s.p.contact->faces_old && s.p.contact->entry_count > 4);
    size = sb_body_state_size(s.b.body);
    image = malloc(size);
    again = malloc(size);
    CHECK_OK(sb_body_state_save(s.b.body, image, size));
    kept = sb_body_state_hash(s.b.body);
    play(&s, tool, 26, 32);
    end = sb_body_state_hash(s.b.body);
    play(&other, tool, 0, 6);
    CHECK_OK(sb_body_state_load(other.b.body, image, size, NULL));
    CHECK(sb_body_state_hash(other.b.body) == kept);
    CHECK_OK(sb_body_state_save(other.b.body, again, size));
    CHECK(memcmp(image, again, size) == 0);
    play(&other, tool, 26, 32);
    CHECK(sb_body_state_hash(other.b.body) == end);
    free(image);
    free(again);
    scene_free(&s);
    scene_free(&other);
}

/* The step after a cut without memory says so, and changes nothing; the next one succeeds. */
static void test_no_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    int fails = 0;
    sb_result result = SB_ERROR_MEMORY;
    scene s;
    int tool;
    scene_make(&s, 2, 1, 1, &allocator);
    tool = play_begin(&s);
    play(&s, tool, 0, 10);
    for (int k = 0; k < 4; k++)
        block_cut_plane(&s.b, sb_v3(REAL(cut_at + 0.006 * k), 0, 0), sb_v3(1, 0, 0));
    for (; result != SB_OK && fails < 200; fails++) {
        uint64_t hash = sb_body_state_hash(s.b.body);
        memory.calls = 0;
        memory.fail_from = fails + 1;
        result = sb_body_step(s.b.body, REAL(0.01), NULL);
        CHECK(result == SB_OK || (result == SB_ERROR_MEMORY && sb_body_state_hash(s.b.body) == hash));
    }
    CHECK(fails > 2 && result == SB_OK);
    memory.fail_from = 0;
    memory.calls = 0;
    play(&s, tool, 11, 14);
    CHECK_INT(memory.calls, 0);
    CHECK(sb_contact_get_info(s.p.contact).touching > 0);
    scene_free(&s);
    CHECK_INT(memory.live, 0);
}

/* What the next update of the drawing names is all that was made since the last, also by the contact. */
static void test_drawing(void)
{
    scene s;
    int tool, vertices;
    sb_cut_drawing d;
    scene_make(&s, 2, 1, 1, NULL);
    tool = play_begin(&s);
    CHECK_OK(sb_cut_surface_update(s.surface, NULL));
    vertices = sb_cut_surface_get(s.surface).vertex_count;
    play(&s, tool, 0, 3);
    block_cut_plane(&s.b, sb_v3(REAL(cut_at), 0, 0), sb_v3(1, 0, 0));
    play(&s, tool, 3, 5);
    CHECK_OK(sb_cut_surface_update(s.surface, NULL));
    d = sb_cut_surface_get(s.surface);
    CHECK(d.vertex_count > vertices && d.first_triangle < d.triangle_end);
    CHECK_INT(d.first_vertex, vertices);
    CHECK_INT(d.triangle_end, d.triangle_count);
    CHECK_OK(sb_cut_surface_update(s.surface, NULL));
    d = sb_cut_surface_get(s.surface);
    CHECK(d.first_triangle == d.triangle_end && d.first_vertex == d.vertex_count);
    scene_free(&s);
}

/* A ball is burnt out below a tool that presses, until nothing is left to touch: contact follows each time. */
static void test_burnt(void)
{
    for (int k = 0; k < 6; k++) {
        scene s;
        sb_tool_def sphere = press_sphere(0.008, 0.3, sb_v3(REAL(0.03), REAL(0.02), REAL(0.0575)));
        sb_cut_info info;
        int tool, touched = 0;
        scene_make(&s, intervals_of[k % 3], k < 3, 1, NULL);
        scene_fix_plane(s.b.body, &s.b.mesh, 2, 0, SB_XYZ);
        tool = press_add(&s.p, &sphere);
        for (int i = 0; i < 24; i++) {
            press_move(&s.p, tool, sb_v3(REAL(0.03), REAL(0.02), REAL(0.0572 - 0.0015 * (i > 12 ? 12 : i))),
                       sb_quat_make(1, 0, 0, 0));
            if (i % 3 == 2)
                CHECK_OK(sb_cut_ablate(s.b.cut, sb_v3(REAL(0.03), REAL(0.02), REAL(0.049 - 0.002 * i)),
                                       REAL(0.006 + 0.0002 * i), &info, NULL));
            if (i == 22)
                CHECK_OK(sb_cut_ablate(s.b.cut, sb_v3(REAL(0.03), REAL(0.02), 0), 1, &info, NULL));
            take_step(&s, 0.01);
            touched += sb_contact_get_info(s.p.contact).touching > 0;
            CHECK(scene_all_finite(sb_body_positions(s.b.body), sb_body_node_count(s.b.body)));
        }
        CHECK(touched > 3);
        CHECK_INT(sb_contact_get_info(s.p.contact).touching, 0);
        CHECK_NEAR(sb_v3_norm(press_wrench(&s.p, tool).force), 0, 1e-12);
        scene_free(&s);
    }
}

CHECK_SUITE(contact_cut, {"where the lips are", test_place}, {"beyond the cut", test_beyond}, {"a flap", test_flap},
            {"what is remembered", test_kept}, {"state", test_state},
            {"state between cut and step", test_state_in_between}, {"no memory", test_no_memory},
            {"drawing", test_drawing}, {"a hole below a tool", test_burnt});
