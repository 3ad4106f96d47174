/* test_contact_lips: organs on skins touch each other: the two parts of a body that is cut through, and the lips of a
 * cut that ends in it. */
#define SB_SPLIT_BUILD
#include "../src/softbody/contact/contact_private.h"
#include "../src/softbody/cut/cut_skin.h"

#include "cut_block.h"
#include "skin_scene.h"

typedef struct scene {
    block b;
    sb_cut_surface *surface;
    press p; /* body and contact of it */
    int workers;
    int (*twins)[2], twin_count; /* triangles of two lips at one place at rest */
} scene;

typedef struct scene_options {
    sb_element_type element;
    int lattice, pairs, workers, max_contacts;
    double friction, tolerance;
    const sb_allocator *allocator;
} scene_options;

static scene_options scene_default(int lattice, int pairs)
{
    scene_options options;
    memset(&options, 0, sizeof options);
    options.element = SB_TET4;
    options.lattice = lattice;
    options.pairs = pairs;
    options.workers = 1;
    options.max_contacts = sb_default_contact_def().max_contacts;
    options.tolerance = 1e-10;
    return options;
}

static void scene_make(scene *s, const scene_options *options)
{
    block_options cuts = block_default(options->lattice);
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    sb_error error;
    memset(s, 0, sizeof *s);
    s->workers = options->workers;
    s->b.mesh = scene_box(options->element, 4, 2, 3, block_size, cuts.shake);
    def.mesh = &s->b.mesh;
    def.material = sb_material_corotated(REAL(5000), REAL(0.4), 1000);
    def.damping_stiffness = REAL(0.02);
    def.slack = REAL(cuts.slack);
    def.tolerance = sb_max(REAL(options->tolerance), 100 * SB_EPSILON);
    def.jobs = scene_jobs(&s->workers);
    s->b.body = scene_body(&def);
    block_cut_create(&s->b, options->lattice);
    CHECK_OK(sb_cut_surface_create(s->b.cut, options->allocator, &s->surface, NULL));
    contact.body = s->b.body;
    contact.max_iterations = 20;
    contact.allocator = options->allocator;
    contact.skin = sb_cut_surface_skin(s->surface);
    contact.pairs = options->pairs;
    contact.max_contacts = options->max_contacts;
    contact.pair_friction = REAL(options->friction);
    if (!CHECK_OK(sb_contact_create(&contact, &s->p.contact, &error)))
        printf("%s\n", error.message);
    s->p.body = s->b.body;
}

static void scene_free(scene *s)
{
    free(s->twins);
    sb_contact_destroy(s->p.contact);
    sb_cut_surface_destroy(s->surface);
    block_free(&s->b);
}

static void take_step(const scene *s, double dt)
{
    sb_step_info info;
    if (!CHECK_OK(sb_body_step(s->b.body, REAL(dt), &info)))
        printf("%s\n", info.error.message);
}

/* Nodes of the mesh before cuts at x, or at the far end of it. */
static int list_end(const scene *s, double x, int *nodes, int room)
{
    int count = 0;
    for (int i = 0; i < s->b.mesh.node_count && count < room; i++)
        if (fabs((double)s->b.mesh.nodes[i].x - x) < 1e-6)
            nodes[count++] = i;
    return count;
}

/* Force of supports on the nodes (N). */
static sb_vec3 reaction_of(const scene *s, const int *nodes, int count)
{
    sb_vec3 sum = {0, 0, 0};
    for (int k = 0; k < count; k++)
        sum = sb_v3_add(sum, sb_body_reactions(s->b.body)[nodes[k]]);
    return sum;
}

/* Of pairs, on the part of the body that a node of the mesh belongs to, and their torque about the origin. */
static sb_wrench pairs_on(const scene *s, int node)
{
    const sbi_pairs *pairs = &s->p.contact->pairs;
    const int part = s->b.body->node_component[node];
    sb_wrench sum = {{0, 0, 0}, {0, 0, 0}};
    for (int e = 0; e < pairs->entry_count; e++) {
        const sbi_pair_entry *entry = pairs->entries + e;
        sb_real sign = pairs->organs[entry->face] == part ? 1 : -1;
        CHECK((pairs->organs[entry->other] == part) != (pairs->organs[entry->face] == part));
        sum.force = sb_v3_madd(sum.force, sign, entry->force);
        sum.torque = sb_v3_madd(sum.torque, sign, sb_v3_cross(entry->point, entry->force));
    }
    return sum;
}

/* Middle of a triangle of the drawing. */
static sb_vec3 middle_of(const sb_cut_drawing *d, const sb_vec3 *x, int triangle)
{
    const int *t = d->triangles[triangle];
    return sb_v3_scale(REAL(1.0 / 3), sb_v3_add(sb_v3_add(x[t[0]], x[t[1]]), x[t[2]]));
}

/* After a cut. */
static void find_twins(scene *s)
{
    sb_cut_drawing d;
    CHECK_OK(sb_cut_surface_update(s->surface, NULL));
    d = sb_cut_surface_get(s->surface);
    free(s->twins);
    s->twins = (int(*)[2])calloc((size_t)d.triangle_count, sizeof *s->twins);
    s->twin_count = 0;
    for (int f = 0; f < d.triangle_count; f++)
        for (int g = 0; g < f && d.tags[f] == SB_CUT_LIP; g++)
            if (d.tags[g] == SB_CUT_LIP &&
                sb_v3_norm(sb_v3_sub(middle_of(&d, d.rest, f), middle_of(&d, d.rest, g))) < REAL(1e-6)) {
                s->twins[s->twin_count][0] = f;
                s->twins[s->twin_count++][1] = g;
                break;
            }
    CHECK(s->twin_count > 10);
}

/* How far the two lips of a cut lie apart in the mean, along their normals at rest, and the least (m). */
static double opening(const scene *s, double *least)
{
    sb_cut_drawing d;
    double sum = 0;
    CHECK_OK(sb_cut_surface_update(s->surface, NULL));
    d = sb_cut_surface_get(s->surface);
    *least = 1;
    for (int i = 0; i < s->twin_count; i++) {
        const int *t = d.triangles[s->twins[i][0]];
        sb_vec3 n = sb_v3_cross(sb_v3_sub(d.rest[t[1]], d.rest[t[0]]), sb_v3_sub(d.rest[t[2]], d.rest[t[0]]));
        sb_vec3 across =
            sb_v3_sub(middle_of(&d, d.positions, s->twins[i][1]), middle_of(&d, d.positions, s->twins[i][0]));
        double way = (double)(sb_v3_dot(n, across) / sb_v3_norm(n));
        sum += way;
        *least = fmin(*least, way);
    }
    return s->twin_count ? sum / s->twin_count : 0;
}

/* ---- pressed shut ---- */

enum { END_NODES = 64 };

/* A block that is held at one end; the other end is moved along it. */
typedef struct ends {
    int held[END_NODES], moved[END_NODES], held_count, moved_count;
} ends;

static ends take_ends(const scene *s)
{
    ends e;
    scene_fix_plane(s->b.body, &s->b.mesh, 0, 0, SB_XYZ);
    e.held_count = list_end(s, 0, e.held, END_NODES);
    e.moved_count = list_end(s, (double)block_size.x, e.moved, END_NODES);
    return e;
}

static void move_end(const scene *s, const ends *e, double way)
{
    sb_vec3 ways[END_NODES];
    for (int k = 0; k < e->moved_count; k++)
        ways[k] = sb_v3(REAL(way), 0, 0);
    CHECK_OK(sb_body_prescribe(s->b.body, e->moved, e->moved_count, SB_XYZ, ways, 0));
}

/* A tilted cut through the block, or into it from above. */
static sb_cut_info cut_through(scene *s)
{
    return block_cut_plane(&s->b, sb_v3(REAL(0.0337), 0, 0), sb_v3(1, 0, REAL(0.2)));
}

static sb_cut_info cut_into(scene *s)
{
    sb_vec3 square[6];
    square_make(sb_v3(REAL(0.0337), REAL(0.02), REAL(0.05)), sb_v3(1, 0, REAL(0.2)), 0.03, square);
    return block_cut(&s->b, square, 2);
}

typedef enum cut_kind { CUT_NONE, CUT_THROUGH, CUT_INTO } cut_kind;

/* Force of supports on both ends (N). */
static sb_vec3 supports_of(const scene *s, const ends *e)
{
    return sb_v3_add(reaction_of(s, e->moved, e->moved_count), reaction_of(s, e->held, e->held_count));
}

/* A step, in which momentum changes by what supports give, whatever lips do. Returns how far it does not (N). */
static double step_in_balance(const scene *s, const ends *e, double dt)
{
    sb_vec3 before = sb_body_momentum(s->b.body), after;
    take_step(s, dt);
    after = sb_v3_scale(REAL(1 / dt), sb_v3_sub(sb_body_momentum(s->b.body), before));
    return (double)sb_v3_norm(sb_v3_sub(supports_of(s, e), after));
}

/* Pulled open by 2 mm, then pressed by 2 mm until it rests. Returns the force on the end (N). */
static double press_cut(const scene_options *options, cut_kind kind, double *least)
{
    scene s;
    ends e;
    double force, open, balance, worst = 0, tolerance = scene_tolerance(1e-8, 1e5);
    scene_make(&s, options);
    e = take_ends(&s);
    if (kind != CUT_NONE)
        CHECK_INT((kind == CUT_THROUGH ? cut_through(&s) : cut_into(&s)).parts, kind == CUT_THROUGH ? 2 : 1);
    if (kind != CUT_NONE)
        find_twins(&s);
    for (int i = 1; i <= 20; i++) {
        move_end(&s, &e, i <= 6 ? 0.002 * i / 6 : 0.002 - 0.004 * (i - 6) / 14);
        worst = fmax(worst, step_in_balance(&s, &e, 0.02));
        if (i == 6) {
            open = opening(&s, least);
            CHECK(kind == CUT_NONE || open > (kind == CUT_THROUGH ? 0.0015 : 0.0004));
        }
    }
    for (int i = 0; i < 25; i++)
        worst = fmax(worst, step_in_balance(&s, &e, 0.02));
    force = (double)reaction_of(&s, e.moved, e.moved_count).x;
    CHECK_NEAR(worst, 0, tolerance * fabs(force));
    balance = (double)sb_v3_norm(supports_of(&s, &e));
    CHECK_NEAR(balance, 0, 100 * tolerance * fabs(force)); /* it still settles */
    open = opening(&s, least);
    printf("  cut %d, lattice %d, pairs %d: %.6f N, balance %.1e in steps, %.1e at rest, open %.2e m, least %.2e m\n",
           (int)kind, options->lattice, options->pairs, force, worst / fabs(force), balance / fabs(force), open,
           *least);
    if (kind == CUT_THROUGH && options->pairs) {
        sb_wrench on = pairs_on(&s, e.moved[0]);
        CHECK_INT(sb_contact_get_info(s.p.contact).thinned, options->max_contacts < 1000);
        CHECK_NEAR(sb_v3_norm(sb_v3_add(on.force, reaction_of(&s, e.moved, e.moved_count))), 0,
                   100 * tolerance * fabs(force));
    }
    scene_free(&s);
    return force;
}

/* What is cut and pressed shut bears as what is not cut; without pairs its lips go through each other. */
static void check_pressed(sb_element_type element, int lattice, cut_kind kind)
{
    scene_options options = scene_default(lattice, SB_CONTACT_SELF | SB_CONTACT_ORGANS);
    double whole, pressed, least;
    options.friction = 2;
    options.element = element;
    whole = press_cut(&options, CUT_NONE, &least);
    pressed = press_cut(&options, kind, &least);
    CHECK_NEAR(pressed, whole, 0.01 * fabs(whole));
    CHECK(least > -1e-4);
    if (lattice != 1 || element != SB_TET4)
        return;
    if (kind == CUT_THROUGH) { /* with fewer samples than triangles */
        options.max_contacts = 300;
        pressed = press_cut(&options, kind, &least);
        CHECK_NEAR(pressed, whole, 0.01 * fabs(whole));
        CHECK(least > -1e-4);
        return;
    }
    options.pairs = SB_CONTACT_ORGANS; /* which are not one organ's lips */
    pressed = press_cut(&options, kind, &least);
    CHECK(fabs(pressed) < 0.95 * fabs(whole) && least < -3e-4);
}

static void test_pressed(void)
{
    check_pressed(SB_TET4, 1, CUT_THROUGH);
    check_pressed(SB_TET4, 1, CUT_INTO);
    if (check_quick())
        return;
    check_pressed(SB_TET4, 2, CUT_INTO);
    check_pressed(SB_TET10, 1, CUT_INTO);
}

/* ---- apart and together ---- */

static sb_vec3 momentum_of(const scene *s)
{
    sb_vec3 sum = {0, 0, 0};
    for (int i = 0; i < sb_body_node_count(s->b.body); i++)
        if (sb_body_node_in_use(s->b.body, i))
            sum = sb_v3_madd(sum, s->b.body->lumped_mass[i], sb_body_velocities(s->b.body)[i]);
    return sum;
}

static double energy_of(const scene *s)
{
    sb_energy energy = {0, 0, 0};
    CHECK_OK(sb_body_energy(s->b.body, &energy));
    return (double)energy.elastic + (double)energy.kinetic;
}

/* The part that was cut off is moved away and thrown back: it does not pass, and momentum stays. */
static void test_thrown(void)
{
    for (int k = 0; k < 2; k++) {
        scene s;
        scene_options options = scene_default(1, SB_CONTACT_ORGANS);
        const double speed = k ? 2 : 0.5;
        double start, worst = 0, least = 1, size, most = 0;
        sb_vec3 *u, *v, before;
        int part, touched = 0, count;
        options.tolerance = 1e-12;
        options.friction = 0.3;
        scene_make(&s, &options);
        CHECK_INT(cut_through(&s).parts, 2);
        find_twins(&s);
        count = sb_body_node_count(s.b.body);
        u = (sb_vec3 *)calloc((size_t)count, sizeof *u);
        v = (sb_vec3 *)calloc((size_t)count, sizeof *v);
        list_end(&s, (double)block_size.x, &part, 1);
        part = s.b.body->node_component[part];
        for (int i = 0; i < count; i++)
            if (sb_body_node_in_use(s.b.body, i) && s.b.body->node_component[i] == part) {
                u[i] = sb_v3(REAL(0.004), REAL(0.003), 0);
                v[i] = sb_v3(REAL(-speed), 0, 0);
            }
        CHECK_OK(sb_body_set_displacements(s.b.body, u));
        CHECK_OK(sb_body_set_velocities(s.b.body, v));
        before = momentum_of(&s);
        size = (double)sb_v3_norm(before);
        start = energy_of(&s);
        for (int i = 0; i < 12; i++) {
            double one;
            take_step(&s, 0.15 / speed / 60);
            touched |= sb_contact_get_info(s.p.contact).touching > 0;
            worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(momentum_of(&s), before)) / size);
            most = fmax(most, energy_of(&s) / start);
            (void)opening(&s, &one);
            least = fmin(least, one);
        }
        printf("thrown at %g m/s: momentum to %.1e, least opening %.2e m, energy %.3f\n", speed, worst, least, most);
        CHECK(touched);
        CHECK_NEAR(worst, 0, scene_tolerance(1e-9, 1e5));
        CHECK(least > -0.004 && most < 1.01);
        free(u);
        free(v);
        scene_free(&s);
    }
}

/* ---- cut while pressed: threads, states, recordings ---- */

/* A sphere above the cut. */
static int add_sphere(scene *s)
{
    sb_tool_def sphere = press_sphere(0.006, 0.3, sb_v3(REAL(0.03), REAL(0.02), REAL(0.0562)));
    return press_add(&s->p, &sphere);
}

/* Pressed, then cut into, then through, with a sphere (tool 0, or -1) that presses beside the cut. */
static void play(scene *s, const ends *e, int tool, int from, int to)
{
    for (int i = from; i < to; i++) {
        move_end(s, e, -0.0004 * (i < 6 ? i : 6));
        if (tool >= 0)
            press_move(&s->p, tool, sb_v3(REAL(0.03), REAL(0.02), REAL(0.0562 - 0.0003 * i)), sb_quat_make(1, 0, 0, 0));
        if (i == 3)
            CHECK_INT(cut_into(s).parts, 1);
        if (i == 8)
            CHECK(cut_through(s).parts > 1); /* and a crumb between the two */
        take_step(s, 0.01);
    }
}

static void test_state(void)
{
    scene_options options = scene_default(1, SB_CONTACT_SELF | SB_CONTACT_ORGANS);
    scene s, other;
    ends e, same;
    sb_recording *recording = NULL;
    sb_recording_report report;
    uint64_t end, kept;
    size_t size, first;
    void *image, *begin, *again;
    options.friction = 0.5;
    scene_make(&s, &options);
    options.workers = 3;
    scene_make(&other, &options);
    e = take_ends(&s);
    same = take_ends(&other);
    CHECK_INT(add_sphere(&s), 0);
    CHECK_INT(add_sphere(&other), 0);
    first = sb_body_state_size(s.b.body);
    begin = malloc(first);
    CHECK_OK(sb_body_state_save(s.b.body, begin, first));
    CHECK_OK(sb_recording_start(s.b.body, 1, NULL, &recording, NULL));
    play(&s, &e, 0, 0, 7);
    CHECK(s.p.contact->pairs.entry_count > 10 && s.p.contact->pairs.pressure_count > 4);
    CHECK(s.p.contact->entry_count > 2);
    size = sb_body_state_size(s.b.body);
    image = malloc(size);
    again = malloc(size);
    CHECK_OK(sb_body_state_save(s.b.body, image, size));
    kept = sb_body_state_hash(s.b.body);
    play(&s, &e, 0, 7, 11);
    sb_recording_stop(recording);
    end = sb_body_state_hash(s.b.body);
    play(&other, &same, 0, 0, 11);
    CHECK(sb_body_state_hash(other.b.body) == end);                /* whatever the threads */
    CHECK_OK(sb_body_state_load(other.b.body, image, size, NULL)); /* takes a cut back */
    CHECK(sb_body_state_hash(other.b.body) == kept);
    CHECK_OK(sb_body_state_save(other.b.body, again, size)); /* before contact has followed */
    CHECK(memcmp(image, again, size) == 0);
    play(&other, &same, 0, 7, 11);
    CHECK(sb_body_state_hash(other.b.body) == end);
    CHECK_OK(sb_body_state_load(other.b.body, begin, first, NULL));
    if (!CHECK_OK(sb_recording_replay(recording, other.b.body, &report)))
        printf("step %d: %s\n", report.step, report.error.message);
    CHECK(sb_body_state_hash(other.b.body) == end);
    sb_recording_destroy(recording);
    free(image);
    free(begin);
    free(again);
    scene_free(&s);
    scene_free(&other);
}

/* The step after a cut without memory says so, and changes nothing; the next one succeeds, and steps take none. */
static void test_no_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    scene_options options = scene_default(1, SB_CONTACT_SELF);
    sb_result result = SB_ERROR_MEMORY;
    int fails = 0;
    scene s;
    ends e;
    options.allocator = &allocator;
    scene_make(&s, &options);
    e = take_ends(&s);
    play(&s, &e, -1, 0, 3);
    CHECK_INT(cut_into(&s).parts, 1);
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
    play(&s, &e, -1, 4, 8);
    CHECK_INT(memory.calls, 0);
    CHECK(s.p.contact->pairs.entry_count > 10);
    scene_free(&s);
    CHECK_INT(memory.live, 0);
}

/* ---- skins that are embedded ---- */

/* A ball rests on another; each is a skin in a cube of its own that it comes out of. */
static void test_balls(void)
{
    const double side = 0.04, radius = 0.0203, g = 9.81, weight = 1000 * side * side * side * g;
    sb_vec3 size = sb_v3(REAL(side), REAL(side), REAL(side)), middle = sb_v3_scale(REAL(0.5), size);
    sb_vec3 up = sb_v3(REAL(0.0002), REAL(0.0001), REAL(2 * radius + 0.0003)), force = {0, 0, 0}, balance;
    sb_mesh mesh = scene_box(SB_HEX8, 3, 3, 3, size, 0), other = scene_box(SB_HEX8, 3, 3, 3, size, 0);
    sb_mesh skin = skin_sphere(middle, radius, 2), upper = skin_sphere(sb_v3_add(middle, up), radius, 2);
    sb_body_def def = skin_tissue(1e5, 0.4);
    sb_contact_def contact = press_exact();
    sb_contact_point points[256];
    double tolerance = scene_tolerance(1e-8, 1e6);
    int nodes = mesh.node_count, count, tops[16], top_count = 0;
    skinned s;
    for (int i = 0; i < other.node_count; i++)
        other.nodes[i] = sb_v3_add(other.nodes[i], up);
    CHECK_OK(sb_mesh_append(&mesh, &other, NULL));
    CHECK_OK(sb_mesh_append(&skin, &upper, NULL));
    sb_mesh_free(&other);
    sb_mesh_free(&upper);
    def.gravity = sb_v3(0, 0, REAL(-g));
    def.damping_stiffness = REAL(0.05);
    contact.pairs = SB_CONTACT_ORGANS;
    s = skin_make(mesh, skin, def, contact);
    for (int i = 0; i < s.p.mesh.node_count; i++) {
        int axes = i < nodes ? SB_XYZ : SB_X | SB_Y;
        if (s.p.mesh.nodes[i].z < REAL(1e-6) || (i >= nodes && s.p.mesh.nodes[i].z > up.z + REAL(side - 1e-6))) {
            CHECK_OK(sb_body_fix_nodes(s.p.body, &i, 1, axes));
            if (i >= nodes && top_count < 16)
                tops[top_count++] = i;
        }
    }
    for (int i = 0; i < 250; i++)
        if (!CHECK_OK(sb_body_step(s.p.body, REAL(0.02), NULL)))
            break;
    count = sb_contact_points(s.p.contact, points, 256);
    CHECK(count > 3 && count <= 256);
    for (int i = 0; i < count && i < 256; i++) {
        CHECK_INT(points[i].tool, -1);
        CHECK((points[i].element >= 27) != (points[i].other_element >= 27));
        force = sb_v3_madd(force, points[i].element >= 27 ? 1 : -1, points[i].force);
    }
    balance = force;
    for (int k = 0; k < top_count; k++)
        balance = sb_v3_add(balance, sb_body_reactions(s.p.body)[tops[k]]);
    printf("balls: %.3e of the weight, beside it %.1e\n", (double)force.z / weight - 1,
           hypot((double)balance.x, (double)balance.y) / weight);
    CHECK_NEAR(force.z, weight, tolerance * weight);
    CHECK_NEAR(hypot((double)balance.x, (double)balance.y), 0, tolerance * weight);
    CHECK(sb_contact_get_info(s.p.contact).deepest < REAL(1e-4));
    skin_free(&s);
}

static void turn(sb_mesh *surface, int face)
{
    int *corners = surface->elements + 3 * face, first = corners[0];
    corners[0] = corners[1];
    corners[1] = first;
}

/* Skins whose inside is not known touch tools, but not each other: refused, with the triangle. */
static void test_open_skins(void)
{
    enum { CLOSED, OPEN, ONE_TURNED, INSIDE_OUT, KINDS };
    sb_vec3 size = sb_v3(REAL(0.04), REAL(0.04), REAL(0.04)), middle = sb_v3_scale(REAL(0.5), size);
    for (int kind = 0; kind < (int)KINDS; kind++) {
        sb_contact_def contact = press_exact();
        sb_mesh skin = skin_sphere(middle, 0.019, 2);
        int faces = skin.element_count;
        sb_contact *paired = NULL;
        sb_error error;
        skinned s;
        skin.element_count -= kind == OPEN;
        for (int f = 0; f < faces; f++)
            if (kind == INSIDE_OUT || (kind == ONE_TURNED && f == 5))
                turn(&skin, f);
        s = skin_make(scene_box(SB_HEX8, 3, 3, 3, size, 0), skin, skin_tissue(1e5, 0.4), contact);
        sb_contact_destroy(s.p.contact);
        contact.body = s.p.body;
        contact.skin = s.skin;
        contact.pairs = SB_CONTACT_ORGANS | SB_CONTACT_SELF;
        CHECK_RESULT(sb_contact_create(&contact, &paired, &error), kind == CLOSED ? SB_OK : SB_ERROR_MESH);
        CHECK((paired != NULL) == (kind == CLOSED));
        CHECK(kind == CLOSED || (error.element >= 0 && error.element < faces && error.message[0]));
        s.p.contact = paired;
        skin_free(&s);
    }
}

CHECK_SUITE(contact_lips, {"pressed", test_pressed}, {"thrown", test_thrown}, {"state", test_state},
            {"no memory", test_no_memory}, {"balls", test_balls}, {"open skins", test_open_skins});
