/* Rigid bodies in static solves: beams with rigid parts against Timoshenko and Euler, wrenches, dynamics that have come
 * to rest, solvers, increments, states, undo, memory and what is refused. */
#include "check.h"
#include "random_case.h"

enum { BAR_RIGIDS = 2 };

/* A bar along x, clamped at x = 0, with what is between from[k] and to[k] (shares of its length) rigid. */
typedef struct bar {
    sb_mesh mesh;
    sb_body *body;
    int *nodes[BAR_RIGIDS], count[BAR_RIGIDS], id[BAR_RIGIDS], rigids;
    double length, side, young;
} bar;

typedef struct bar_options {
    sb_element_type type;
    int cells, across, rigids;
    double shake, from[BAR_RIGIDS], to[BAR_RIGIDS], mass;
    sb_body_def def;
} bar_options;

static bar_options bar_default(sb_material material)
{
    bar_options o;
    memset(&o, 0, sizeof o);
    o.type = SB_HEX20;
    o.cells = 10;
    o.across = 2;
    o.rigids = 1;
    o.from[0] = 0.8;
    o.to[0] = 1;
    o.mass = 0.5;
    o.def = sb_default_body_def();
    o.def.material = material;
    return o;
}

/* Those that a mesh without shake has there. */
static int *nodes_between(const sb_mesh *mesh, double from, double to, int *count)
{
    int *nodes = (int *)malloc((size_t)mesh->node_count * sizeof(int));
    *count = 0;
    for (int i = 0; i < mesh->node_count && nodes; i++)
        if ((double)mesh->nodes[i].x > from - 1e-6 && (double)mesh->nodes[i].x < to + 1e-6)
            nodes[(*count)++] = i;
    return nodes;
}

static sb_rigid_def bar_rigid(const bar *t, const bar_options *o, int k)
{
    sb_rigid_def def = sb_default_rigid_def();
    def.mass = REAL(o->mass);
    def.inertia = sb_m3_scale(REAL(o->mass * t->side * t->side), sb_m3_identity());
    def.inertia.m[1][1] *= REAL(1.4);
    def.centre = sb_v3(REAL((o->from[k] + o->to[k]) / 2 * t->length), REAL(t->side / 2), REAL(t->side / 2));
    def.turn = sb_quat_make(2, 1, 0, REAL(0.5));
    def.nodes = t->nodes[k];
    def.node_count = t->count[k];
    return def;
}

static int bar_make(bar *t, bar_options *o)
{
    sb_mesh even;
    memset(t, 0, sizeof *t);
    t->length = 1;
    t->side = 0.1;
    t->rigids = o->rigids;
    t->young = (double)sb_material_young(&o->def.material);
    even = scene_box(o->type, o->cells, o->across, o->across, sb_v3(1, REAL(0.1), REAL(0.1)), 0);
    t->mesh = scene_box(o->type, o->cells, o->across, o->across, sb_v3(1, REAL(0.1), REAL(0.1)), o->shake);
    o->def.mesh = &t->mesh;
    t->body = scene_body(&o->def);
    for (int k = 0; k < o->rigids; k++)
        t->nodes[k] = nodes_between(&even, o->from[k], o->to[k], &t->count[k]);
    sb_mesh_free(&even);
    if (!CHECK(t->body != NULL))
        return 0;
    scene_fix_plane(t->body, &t->mesh, 0, 0, SB_XYZ);
    for (int k = 0; k < o->rigids; k++) {
        sb_rigid_def def = bar_rigid(t, o, k);
        if (!CHECK_OK(sb_body_add_rigid(t->body, &def, &t->id[k], NULL)))
            return 0;
    }
    return 1;
}

static void bar_free(bar *t)
{
    sb_body_destroy(t->body);
    sb_mesh_free(&t->mesh);
    for (int k = 0; k < BAR_RIGIDS; k++)
        free(t->nodes[k]);
}

static sb_rigid_motion motion_of(const sb_body *body, int id)
{
    sb_rigid_motion motion;
    memset(&motion, 0, sizeof motion);
    CHECK_OK(sb_body_rigid_motion(body, id, &motion));
    return motion;
}

static sb_static_options precise(double tolerance)
{
    sb_static_options options = sb_default_static_options();
    options.tolerance = REAL(scene_tolerance(tolerance, 1e4));
    return options;
}

static int solve(sb_body *body, const sb_static_options *options, sb_step_info *info)
{
    sb_step_info own;
    sb_result result = sb_body_solve_static(body, options, info ? info : &own);
    if (result != SB_OK)
        printf("  %s\n", (info ? info : &own)->error.message);
    return CHECK_OK(result);
}

/* What the tissue does to a rigid body is the opposite of its load, to a share of `size` (N) and what that is at 0.1 m;
 * and it rests. */
static void check_balance(const sb_body *body, int id, sb_vec3 load, sb_vec3 torque, double size, double share)
{
    sb_rigid_motion m = motion_of(body, id);
    CHECK_NEAR(sb_v3_norm(sb_v3_add(m.force, load)), 0, share * size);
    CHECK_NEAR(sb_v3_norm(sb_v3_add(m.torque, torque)), 0, share * 0.1 * size);
    CHECK(sb_v3_norm(m.velocity) == 0 && sb_v3_norm(m.spin) == 0);
}

/* ---- closed forms ---- */

/* Beams of linear material whose outer fifth, or middle three tenths, are rigid, under a force and a torque on that
 * part: Timoshenko with the shear factor 5/6, meshes even and shaken. */
static void test_timoshenko(void)
{
    static const sb_element_type types[] = {SB_HEX20, SB_HEX27, SB_TET10};
    double off[2] = {0, 0}; /* of even meshes and of shaken ones */
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("forces far smaller than their parts need double");
        return;
    }
    for (int k = 0; k < 12; k++) {
        bar_options o = bar_default(sb_material_linear(REAL(1e5), 0, 1000));
        sb_static_options options = precise(1e-10);
        const double force = 1e-4, torque = 3e-5, inertia = 1e-4 / 12, shear = 5.0 / 6 * 0.5 * 1e-2;
        double free_end, way, turn, at, moment;
        sb_rigid_motion m;
        bar t;
        o.type = types[k % 3];
        o.shake = k / 3 % 2 ? 0.15 : 0;
        o.from[0] = k < 6 ? 0.8 : 0.4;
        o.to[0] = k < 6 ? 1 : 0.7;
        if (!bar_make(&t, &o))
            return;
        free_end = o.from[0];
        at = (o.to[0] - o.from[0]) / 2;
        moment = torque + force * at;
        way = (force * pow(free_end, 3) / 3 + moment * free_end * free_end / 2) / (1e5 * inertia) +
              force * free_end / (1e5 * shear);
        turn = (force * free_end * free_end / 2 + moment * free_end) / (1e5 * inertia);
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], sb_v3(0, 0, REAL(force)), sb_v3(0, REAL(-torque), 0)));
        if (!solve(t.body, &options, NULL))
            return;
        m = motion_of(t.body, t.id[0]);
        CHECK_NEAR((double)m.centre.z - 0.05, way + turn * at, 0.01 * way);
        m.turn = sb_quat_mul(m.turn, sb_quat_conjugate(sb_quat_normalise(sb_quat_make(2, 1, 0, REAL(0.5)))));
        CHECK_NEAR(-2 * (double)m.turn.y, turn, 0.01 * turn);
        off[k / 3 % 2] = fmax(off[k / 3 % 2], fabs(((double)m.centre.z - 0.05) / (way + turn * at) - 1));
        check_balance(t.body, t.id[0], sb_v3(0, 0, REAL(force)), sb_v3(0, REAL(-torque), 0), 4 * force,
                      scene_tolerance(1e-9, 1e4));
        bar_free(&t);
    }
    printf("  Timoshenko: %.2g off on even meshes, %.2g on shaken ones\n", off[0], off[1]);
}

/* A torque bends the beam into an arc of a circle: x = sin(a) l / a, z = (1 - cos(a)) l / a, a = M l / EI, and the
 * rigid end goes on straight. */
static void test_circle(void)
{
    static const sb_precond_kind kinds[] = {SB_PRECOND_AUTO, SB_PRECOND_CHOLESKY, SB_PRECOND_MULTIGRID};
    for (int k = 0; k < 6; k++) {
        bar_options o =
            bar_default(k % 2 ? sb_material_svk(REAL(1e5), 0, 1000) : sb_material_corotated(REAL(1e5), 0, 1000));
        sb_static_options options = precise(1e-9);
        const double angle = 1.25, length = 0.8, torque = angle * 1e5 * 1e-4 / 12 / length;
        sb_rigid_motion m;
        bar t;
        o.def.preconditioner = kinds[k / 2];
        if (!bar_make(&t, &o))
            return;
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], sb_v3(0, 0, 0), sb_v3(0, REAL(-torque), 0)));
        if (!solve(t.body, &options, NULL))
            return;
        m = motion_of(t.body, t.id[0]);
        CHECK_NEAR(m.centre.x, length * sin(angle) / angle + 0.1 * cos(angle), 0.01);
        CHECK_NEAR((double)m.centre.z - 0.05, length * (1 - cos(angle)) / angle + 0.1 * sin(angle), 0.01);
        CHECK_NEAR(m.centre.y, 0.05, scene_tolerance(1e-7, 1e4));
        check_balance(t.body, t.id[0], sb_v3(0, 0, 0), sb_v3(0, REAL(-torque), 0), 10 * torque,
                      scene_tolerance(1e-9, 1e5));
        bar_free(&t);
    }
}

/* A torque along a short bar twists it by more than half a turn, which takes several increments: a = M l / GJ, J =
 * 0.1406 side^4 but for warping, which both ends prevent. Its nodes hang where they should. */
static void test_twist(void)
{
    bar_options o = bar_default(sb_material_corotated(REAL(1e5), 0, 1000));
    sb_static_options options = precise(1e-8);
    const double angle = 3.6, length = 0.8, torque = angle * 0.5e5 * 0.1406e-4 / length;
    double turn;
    sb_rigid_motion m;
    sb_step_info info;
    bar t;
    o.cells = 20;
    options.load_steps = 4;
    if (!bar_make(&t, &o))
        return;
    CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], sb_v3(REAL(1), 0, 0), sb_v3(REAL(torque), 0, 0)));
    if (!solve(t.body, &options, &info))
        return;
    m = motion_of(t.body, t.id[0]);
    m.turn = sb_quat_mul(m.turn, sb_quat_conjugate(sb_quat_normalise(sb_quat_make(2, 1, 0, REAL(0.5)))));
    turn = 2 * atan2((double)m.turn.x, (double)m.turn.w);
    turn += turn < 0 ? 6.283185307179586 : 0;
    printf("  twist: %.4f rad, %.4f by Saint-Venant, in %d increments of %d iterations\n", turn, angle, info.load_steps,
           info.newton_iterations);
    CHECK(turn > 3.15);
    CHECK_NEAR(turn, angle, 0.06 * angle);
    check_balance(t.body, t.id[0], sb_v3(1, 0, 0), sb_v3(REAL(torque), 0, 0), 1, scene_tolerance(1e-7, 1e5));
    bar_free(&t);
}

/* ---- the same as dynamics that have come to rest ---- */

static void test_rest(void)
{
    for (int k = 0; k < 4; k++) {
        bar_options o = bar_default(k % 2 ? sb_material_neo_hookean(REAL(1e5), REAL(0.3), 1000)
                                          : sb_material_corotated(REAL(1e5), REAL(0.3), 1000));
        sb_static_options options = precise(1e-13);
        const sb_vec3 force = sb_v3(REAL(0.2), REAL(0.3), REAL(-0.4)), torque = sb_v3(REAL(0.05), REAL(0.1), 0);
        sb_rigid_motion rest, found;
        bar t, moving;
        o.type = k < 2 ? SB_TET4 : SB_HEX8;
        o.shake = 0.1;
        o.rigids = 2;
        o.from[0] = 0.3, o.to[0] = 0.5, o.from[1] = 0.9, o.to[1] = 1;
        o.def.gravity =
            sb_v3(0, 0, k < 2 ? REAL(-0.3) : 0); /* masses of shaken hexahedra pull a little elsewhere in steps */
        o.def.newton_tolerance = REAL(scene_tolerance(1e-11, 1e4));
        o.def.max_newton = 40;
        if (!bar_make(&t, &o) || !bar_make(&moving, &o))
            return;
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id[1], force, torque));
        CHECK_OK(sb_body_set_rigid_load(moving.body, moving.id[1], force, torque));
        if (!solve(t.body, &options, NULL))
            return;
        for (int i = 0; i < 60; i++)
            if (!CHECK_OK(sb_body_step(moving.body, REAL(0.3 * pow(2, i < 30 ? i : 30)), NULL)))
                return;
        for (int r = 0; r < 2; r++) {
            rest = motion_of(moving.body, moving.id[r]);
            found = motion_of(t.body, t.id[r]);
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(rest.centre, found.centre)), 0, scene_tolerance(1e-8, 1e4));
            CHECK_NEAR(sb_abs(sb_quat_dot(rest.turn, found.turn)), 1, scene_tolerance(1e-12, 1e3));
            check_balance(t.body, t.id[r],
                          sb_v3_add(r ? force : sb_v3(0, 0, 0), sb_v3_scale(REAL(o.mass), o.def.gravity)),
                          r ? torque : sb_v3(0, 0, 0), 1, scene_tolerance(1e-9, 1e5));
        }
        CHECK_NEAR(scene_distance(sb_body_positions(t.body), sb_body_positions(moving.body), t.mesh.node_count), 0,
                   scene_tolerance(1e-8, 1e4));
        CHECK_OK(sb_body_step(t.body, REAL(0.01), NULL)); /* and it stays */
        CHECK_NEAR(sb_v3_norm(motion_of(t.body, t.id[1]).velocity), 0, scene_tolerance(1e-6, 1e6));
        bar_free(&t);
        bar_free(&moving);
    }
}

/* ---- parts, supports, changes ---- */

/* Two bars that only a rigid plate joins, as one piece: the second hangs on the first. And a clamp that a pose moves
 * beside one that is free. */
static void test_parts(void)
{
    const int gone_from = 4, gone_to = 6; /* of ten cells along, which are left out */
    sb_mesh whole = scene_box(SB_HEX8, 10, 2, 2, sb_v3(1, REAL(0.1), REAL(0.1)), 0), mesh = whole;
    sb_body_def def = sb_default_body_def();
    sb_rigid_def rigid = sb_default_rigid_def();
    sb_static_options options = precise(1e-10);
    sb_vec3 pull = sb_v3(0, REAL(0.02), REAL(0.05)), sum = sb_v3(0, 0, 0);
    int *cells = (int *)malloc((size_t)whole.element_count * 8 * sizeof(int)), *nodes, count, id, used = 0, tip = 0;
    sb_body *body;
    for (int e = 0; e < whole.element_count; e++) {
        double x = 0;
        for (int k = 0; k < 8; k++)
            x += (double)whole.nodes[whole.elements[8 * e + k]].x / 8;
        if (x > gone_from / 10.0 && x < gone_to / 10.0)
            continue;
        memcpy(cells + 8 * (size_t)used++, whole.elements + 8 * (size_t)e, 8 * sizeof(int));
    }
    mesh.elements = cells;
    mesh.element_count = used;
    def.mesh = &mesh;
    def.material = sb_material_corotated(REAL(1e5), REAL(0.3), 1000);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    nodes = nodes_between(&mesh, 0.4, 0.4, &count);
    rigid.mass = 1;
    rigid.inertia = sb_m3_identity();
    rigid.centre = sb_v3(REAL(0.5), 0, 0);
    rigid.nodes = nodes;
    rigid.node_count = count;
    CHECK_OK(sb_body_add_rigid(body, &rigid, &id, NULL));
    for (int i = 0; i < mesh.node_count; i++)
        tip = (double)mesh.nodes[i].x > 0.999 ? i : tip;
    CHECK_OK(sb_body_apply_forces(body, &tip, 1, &pull, 1, NULL));
    CHECK_RESULT(sb_body_solve_static(body, &options, NULL), SB_ERROR_UNCONSTRAINED); /* the second bar is loose */
    CHECK_OK(sb_body_remove_rigid(body, id));
    free(nodes);
    nodes = nodes_between(&mesh, 0.4, 0.6, &count);
    used = 0;
    for (int i = 0; i < count; i++) /* but for nodes of no element */
        if (fabs((double)mesh.nodes[nodes[i]].x - 0.5) > 0.05)
            nodes[used++] = nodes[i];
    count = used;
    for (int bound = 0; bound < 3; bound++) { /* with a node, two, or all of the second bar's end */
        int near = 0, list[64], all = 0;
        sb_result result;
        for (int i = 0; i < count; i++) {
            int far = (double)mesh.nodes[nodes[i]].x > 0.5;
            if (!far || bound == 2 || near < 1 + bound)
                list[all++] = nodes[i];
            near += far;
        }
        rigid.nodes = list;
        rigid.node_count = all;
        CHECK_OK(sb_body_add_rigid(body, &rigid, &id, NULL));
        result = sb_body_solve_static(body, &options, NULL);
        CHECK_RESULT(result, bound < 2 ? SB_ERROR_UNCONSTRAINED : SB_OK);
        if (bound < 2)
            CHECK_OK(sb_body_remove_rigid(body, id));
    }
    for (int i = 0; i < mesh.node_count; i++)
        sum = sb_v3_add(sum, sb_body_reactions(body)[i]);
    CHECK_NEAR(sb_v3_norm(sb_v3_add(sum, pull)), 0, scene_tolerance(1e-9, 1e5) * (double)sb_v3_norm(pull));
    CHECK_NEAR(sb_v3_norm(motion_of(body, id).force), 0, scene_tolerance(1e-9, 1e5) * (double)sb_v3_norm(pull));
    CHECK(motion_of(body, id).centre.z > REAL(1e-3));
    rigid.nodes = NULL;
    rigid.node_count = 0;
    CHECK_OK(sb_body_add_rigid(body, &rigid, &id, NULL));
    check_bad_numbers();
    CHECK_RESULT(sb_body_solve_static(body, &options, NULL), SB_ERROR_UNCONSTRAINED); /* one without nodes */
    sb_body_destroy(body);
    sb_mesh_free(&whole);
    free(cells);
    free(nodes);
}

/* A rigid body beside a clamp that a pose turns: what the pose's nodes feel and the load are in balance. */
static void test_clamp(void)
{
    for (int k = 0; k < 3; k++) {
        bar_options o = bar_default(sb_material_neo_hookean(REAL(1e5), REAL(0.4), 1000));
        sb_static_options options = precise(1e-9);
        const sb_vec3 force = sb_v3(0, REAL(0.3), 0), torque = sb_v3(0, 0, REAL(0.02));
        sb_vec3 pulled, turned, about = sb_v3(0, REAL(0.05), REAL(0.05)), arm;
        sb_rigid_motion m;
        int *held, count;
        double size;
        bar t;
        o.type = k == 0 ? SB_TET10 : k == 1 ? SB_HEX8 : SB_TET4;
        o.shake = 0.1;
        o.from[0] = 0.5, o.to[0] = 0.7;
        if (!bar_make(&t, &o))
            return;
        held = nodes_between(&t.mesh, 0, 0, &count);
        CHECK_OK(sb_body_place_rigid(t.body, held, count, about, about,
                                     sb_quat_from_rotation_vector(sb_v3(REAL(0.6), REAL(0.3), 0)), NULL));
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], force, torque));
        if (!solve(t.body, &options, NULL))
            return;
        m = motion_of(t.body, t.id[0]);
        check_balance(t.body, t.id[0], force, torque, 1, scene_tolerance(1e-8, 1e5));
        CHECK_OK(sb_body_wrench(t.body, held, count, about, &pulled, &turned, NULL));
        arm = sb_v3_sub(m.centre, about);
        size = (double)sb_v3_norm(force);
        CHECK_NEAR(sb_v3_norm(sb_v3_add(pulled, force)), 0, scene_tolerance(1e-7, 1e5) * size);
        CHECK_NEAR(sb_v3_norm(sb_v3_add(turned, sb_v3_add(torque, sb_v3_cross(arm, force)))), 0,
                   scene_tolerance(1e-7, 1e5) * size);
        free(held);
        bar_free(&t);
    }
}

/* ---- increments, solvers, states ---- */

/* The same end in one solve or several, whatever solves the systems, and with loads that fade from those before. */
static void test_ways(void)
{
    static const sb_precond_kind kinds[] = {SB_PRECOND_AUTO, SB_PRECOND_CHOLESKY, SB_PRECOND_MULTIGRID, SB_PRECOND_FSAI,
                                            SB_PRECOND_BLOCK_JACOBI};
    const sb_vec3 force = sb_v3(REAL(0.1), REAL(0.4), REAL(-0.6)), torque = sb_v3(REAL(0.02), 0, REAL(0.05));
    sb_vec3 *first = NULL, centre = sb_v3(0, 0, 0);
    for (int k = 0; k < 10; k++) {
        bar_options o = bar_default(sb_material_stable_neo_hookean(REAL(1e5), REAL(0.4), 1000));
        sb_static_options options = precise(1e-9);
        sb_vec3 other = sb_v3(REAL(0.3), REAL(-0.2), 0);
        bar t;
        o.type = SB_TET10;
        o.cells = 8;
        o.from[0] = 0.5, o.to[0] = 0.75;
        o.shake = 0.1;
        o.def.gravity = sb_v3(0, 0, REAL(-0.2));
        o.def.preconditioner = kinds[k % 5];
        options.load_steps = k < 5 ? 1 : 3;
        options.quasi_newton = k == 7;
        options.newton = k == 8 ? SB_NEWTON_MIXED_POINTS : SB_NEWTON_AUTO;
        if (!bar_make(&t, &o))
            return;
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], other, sb_v3(0, 0, 0)));
        if (k > 5 && !solve(t.body, &options, NULL))
            return;
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], force, torque));
        if (!solve(t.body, &options, NULL))
            return;
        if (!first) {
            first = (sb_vec3 *)malloc((size_t)t.mesh.node_count * sizeof *first);
            memcpy(first, sb_body_positions(t.body), (size_t)t.mesh.node_count * sizeof *first);
            centre = motion_of(t.body, t.id[0]).centre;
        }
        CHECK_NEAR(scene_distance(first, sb_body_positions(t.body), t.mesh.node_count), 0, scene_tolerance(1e-7, 3e4));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(centre, motion_of(t.body, t.id[0]).centre)), 0, scene_tolerance(1e-7, 3e4));
        bar_free(&t);
    }
    free(first);
}

static void test_state(void)
{
    for (int k = 0; k < 2; k++) {
        bar_options o = bar_default(sb_material_corotated(REAL(1e5), REAL(0.3), 1000));
        sb_static_options options = precise(1e-8);
        sb_recording_report report;
        sb_recording *recording = NULL;
        uint64_t hash, after;
        size_t size;
        void *state;
        bar t, other;
        o.type = SB_TET4;
        options.load_steps = 2;
        if (!bar_make(&t, &o) || !bar_make(&other, &o))
            return;
        CHECK_OK(sb_recording_start(t.body, 1, NULL, &recording, NULL));
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], sb_v3(0, 0, REAL(0.2)), sb_v3(0, 0, 0)));
        if (!solve(t.body, &options, NULL))
            return;
        size = sb_body_state_size(t.body);
        state = malloc(size);
        CHECK_OK(sb_body_state_save(t.body, state, size));
        hash = sb_body_state_hash(t.body);
        for (int round = 0; round < 2; round++) {
            sb_body *body = round ? other.body : t.body;
            if (round)
                CHECK_OK(sb_body_state_load(body, state, size, NULL));
            CHECK(sb_body_state_hash(body) == hash);
            CHECK_OK(sb_body_set_rigid_load(body, t.id[0], sb_v3(0, REAL(0.3), 0), sb_v3(0, 0, 0)));
            if (k) /* an increment's loads are between those of before and of now */
                options.load_steps = 3;
            if (!solve(body, &options, NULL))
                return;
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            after = round ? after : sb_body_state_hash(body);
            CHECK(sb_body_state_hash(body) == after);
        }
        sb_recording_stop(recording);
        CHECK_OK(sb_recording_replay(recording, other.body, &report));
        CHECK(sb_body_state_hash(other.body) == sb_body_state_hash(t.body));
        sb_recording_destroy(recording);
        free(state);
        bar_free(&t);
        bar_free(&other);
    }
}

/* ---- what fails, and threads ---- */

/* A solve that fails leaves all as it was, to the last bit; one that keeps its progress has the last balance. */
static void test_undo(void)
{
    for (int k = 0; k < 4; k++) {
        bar_options o = bar_default(k < 2 ? sb_material_neo_hookean(REAL(1e5), REAL(0.3), 1000)
                                          : sb_material_corotated(REAL(1e5), REAL(0.3), 1000));
        sb_static_options options = sb_default_static_options();
        sb_rigid_motion m;
        sb_step_info info;
        uint64_t hash;
        bar t;
        o.type = SB_TET4;
        if (!bar_make(&t, &o))
            return;
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], sb_v3(0, 0, REAL(0.2)), sb_v3(REAL(0.01), 0, 0)));
        if (!solve(t.body, &options, NULL))
            return;
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], sb_v3(0, 0, REAL(0.3)), sb_v3(0, REAL(1e7), 0)));
        hash = sb_body_state_hash(t.body);
        check_bad_numbers();
        options.max_newton = 6;
        CHECK(sb_body_solve_static(t.body, &options, &info) != SB_OK);
        CHECK(info.error.result != SB_OK && info.error.message[0] != 0);
        CHECK(sb_body_state_hash(t.body) == hash);
        options.keep_progress = 1;
        options.max_newton = 30;
        options.load_steps = k % 2 ? 40 : 4;
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], sb_v3(0, 0, REAL(4)), sb_v3(0, REAL(30), 0)));
        if (sb_body_solve_static(t.body, &options, &info) != SB_OK && info.load_steps > 0) {
            double share = (double)info.load_factor;
            m = motion_of(t.body, t.id[0]);
            CHECK(share > 0 && share < 1);
            CHECK_NEAR(-m.force.z, 0.2 + share * (4 - 0.2), scene_tolerance(1e-4, 1e5));
            CHECK_NEAR(-m.torque.y, share * 30, scene_tolerance(1e-4, 1e5));
        }
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], sb_v3(0, 0, 0), sb_v3(0, 0, 0)));
        CHECK_OK(sb_body_step(t.body, REAL(0.001), NULL));
        bar_free(&t);
    }
}

static void test_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    bar_options o = bar_default(sb_material_corotated(REAL(1e5), REAL(0.3), 1000));
    sb_static_options options = sb_default_static_options();
    sb_result result = SB_ERROR_MEMORY;
    int failures = 0;
    bar t;
    o.type = SB_TET4;
    o.def.allocator = scene_allocator(&memory);
    if (!bar_make(&t, &o))
        return;
    CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], sb_v3(0, 0, REAL(0.2)), sb_v3(0, REAL(0.01), 0)));
    for (int n = 1; result != SB_OK && n < 100; n++) {
        uint64_t hash = sb_body_state_hash(t.body);
        int live = memory.live;
        sb_step_info info;
        memory.calls = 0;
        memory.fail_at = n;
        result = sb_body_solve_static(t.body, &options, &info);
        memory.fail_at = 0;
        CHECK_INT(memory.live, live);
        if (result == SB_OK)
            break;
        failures++;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK_RESULT(info.error.result, SB_ERROR_MEMORY);
        CHECK(sb_body_state_hash(t.body) == hash);
    }
    CHECK_OK(result);
    CHECK(failures >= 2);
    sb_body_destroy(t.body);
    CHECK_INT(memory.live, 0);
    t.body = NULL;
    bar_free(&t);
}

static void test_threads(void)
{
    uint64_t hash[3];
    for (int w = 0; w < 3; w++) {
        static const int counts[] = {1, 2, 3};
        int workers = counts[w];
        bar_options o = bar_default(sb_material_neo_hookean(REAL(1e5), REAL(0.4), 1000));
        bar t;
        o.type = SB_TET10;
        o.cells = 16;
        o.shake = 0.1;
        if (w > 0)
            o.def.jobs = scene_jobs(&workers);
        if (!bar_make(&t, &o))
            return;
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id[0], sb_v3(REAL(0.2), 0, REAL(0.5)), sb_v3(REAL(0.02), 0, 0)));
        if (!solve(t.body, NULL, NULL))
            return;
        hash[w] = sb_body_state_hash(t.body);
        bar_free(&t);
    }
    CHECK(hash[0] == hash[1] && hash[0] == hash[2]);
}

/* Blocks of random elements, materials and sizes with a rigid body on three nodes or many, loads in all directions that
 * bend and turn: nodes are where it has them, supports and loads are in balance, sizes of a millimetre and a kilometre
 * give what a metre does, and what fails changes nothing. */
static void test_random(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_HEX8, SB_TET10, SB_HEX20};
    int failed = 0, rounds = check_rounds(40);
    for (int round = 0; round < rounds; round++) {
        unsigned long long seed = 7000 + (unsigned long long)round;
        double size = pow(10, 3 * (round % 3) - 3), force, worst = 0, moment = 0;
        const char *name;
        sb_mesh mesh = scene_box(types[random_below(&seed, 4)], 4, 2, 2,
                                 sb_v3(REAL(2 * size), REAL(0.6 * size), REAL(0.5 * size)), 0.1);
        sb_body_def def = sb_default_body_def();
        sb_rigid_def rigid = sb_default_rigid_def();
        sb_static_options options = precise(1e-9);
        sb_vec3 load, torque, sum = sb_v3(0, 0, 0), about = sb_v3(0, 0, 0), *arms;
        sb_rigid_motion m;
        sb_step_info info;
        uint64_t hash;
        int *nodes = (int *)malloc((size_t)mesh.node_count * sizeof(int)), count = 0, id = 0;
        int wanted = 4 + random_below(&seed, mesh.node_count / 3);
        sb_body *body;
        def.mesh = &mesh;
        def.material = random_material(&seed, &name);
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        for (int i = 0; i < 50 * wanted && count < wanted; i++) {
            int node = random_below(&seed, mesh.node_count), again = sb_body_supports(body)[node] != 0;
            for (int j = 0; j < count; j++)
                again |= nodes[j] == node;
            if (!again)
                nodes[count++] = node;
        }
        rigid.mass = 1;
        rigid.inertia = sb_m3_identity();
        rigid.centre = sb_v3(REAL(check_random_in(&seed, 0, 2 * size)), REAL(check_random_in(&seed, 0, size)), 0);
        rigid.turn = random_turn(&seed);
        rigid.nodes = nodes;
        rigid.node_count = count;
        CHECK_OK(sb_body_add_rigid(body, &rigid, &id, NULL));
        m = motion_of(body, id);
        arms = (sb_vec3 *)malloc((size_t)count * sizeof *arms);
        for (int i = 0; i < count; i++)
            arms[i] = sb_quat_rotate(sb_quat_conjugate(m.turn), sb_v3_sub(mesh.nodes[nodes[i]], m.centre));
        force = (double)sb_material_young(&def.material) * size * size * random_scale(&seed, 1e-4, 1e-2);
        load = sb_v3_scale(REAL(force), random_direction(&seed));
        torque = sb_v3_scale(REAL(force * size * 0.3), random_direction(&seed));
        CHECK_OK(sb_body_set_rigid_load(body, id, load, torque));
        hash = sb_body_state_hash(body);
        if (sb_body_solve_static(body, &options, &info) != SB_OK) {
            CHECK(sb_body_state_hash(body) == hash);
            if (failed++ < 5)
                printf("  round %d, %s, %d nodes, element %d: %s\n", round, name, count, (int)mesh.element_type,
                       info.error.message);
        } else {
            m = motion_of(body, id);
            for (int j = 0; j < count; j++) {
                sb_vec3 at = sb_v3_add(m.centre, sb_quat_rotate(m.turn, arms[j]));
                worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(at, sb_body_positions(body)[nodes[j]])) / size);
            }
            CHECK_NEAR(worst, 0, scene_tolerance(1e-12, 64));
            for (int i = 0; i < mesh.node_count; i++) {
                sum = sb_v3_add(sum, sb_body_reactions(body)[i]);
                about = sb_v3_add(about, sb_v3_cross(sb_body_positions(body)[i], sb_body_reactions(body)[i]));
            }
            about = sb_v3_add(about, sb_v3_add(torque, sb_v3_cross(m.centre, load)));
            moment = (double)sb_v3_norm(about);
            CHECK_NEAR(sb_v3_norm(sb_v3_add(sum, load)), 0, scene_tolerance(1e-7, 1e6) * force);
            if (!sb_material_is_linear(def.material.model)) /* whose forces do not turn with it */
                CHECK_NEAR(moment, 0, scene_tolerance(1e-7, 1e6) * force * size);
            CHECK(sb_v3_norm(m.velocity) == 0 && sb_v3_norm(m.spin) == 0);
            CHECK_NEAR(sb_v3_norm(sb_v3_add(m.force, load)), 0, scene_tolerance(1e-7, 1e6) * force);
            CHECK_NEAR(sb_v3_norm(sb_v3_add(m.torque, torque)), 0, scene_tolerance(1e-7, 1e6) * force * size);
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(nodes), free(arms);
    }
    printf("  random: %d of %d static solves failed\n", failed, rounds);
    CHECK(failed <= rounds / 10);
}

CHECK_SUITE(rigid_static, {"Timoshenko's beam", test_timoshenko}, {"an arc of a circle", test_circle},
            {"a twist by more than half a turn", test_twist}, {"dynamics at rest", test_rest},
            {"parts that it joins", test_parts}, {"a clamp that turns", test_clamp},
            {"solvers and increments", test_ways}, {"states and recordings", test_state},
            {"a failed solve is undone", test_undo}, {"memory", test_memory}, {"threads", test_threads},
            {"random cases", test_random});
