/* Tests of loads: a block dragged along its surface, whose shape alone does not show it; samples and supports, caps,
 * refusals, failing allocations; livers of the shared data, whose truth is known. */
#include "check.h"
#include "scene.h"

#include "liver.h"
#include "register.h"

/* A slab held below and dragged by a patch of its upper side, mostly along it; and its shape then. */
typedef struct slab {
    sb_mesh mesh, skin;
    sb_body *body;
    sb_vec3 *truth;
    double patch[2]; /* of x, in shares of the length */
} slab;

static sb_material soft(void) { return sb_material_neo_hookean(5000, REAL(0.45), 1000); }

static int in_patch(const slab *made, int node, double size)
{
    sb_vec3 x = made->mesh.nodes[node];
    return x.z > REAL(0.2999 * size) && x.x > REAL(made->patch[0] * size) && x.x < REAL(made->patch[1] * size) &&
           x.y > REAL(0.2 * size) && x.y < REAL(0.6 * size);
}

/* What moves the slab: a patch that goes one way as a whole; that turns about its middle, with no direction in common;
 * most of the upper side, one way, the middle farthest. */
typedef enum slab_pull { PULL_PATCH, PULL_TURN, PULL_SIDE } slab_pull;

/* 1 and the way of a node that is pulled. */
static int pull_of(const slab *made, int node, double size, slab_pull pull, sb_vec3 *way)
{
    const sb_vec3 drag = sb_v3(REAL(0.06 * size), REAL(0.02 * size), REAL(-0.03 * size));
    sb_vec3 x = made->mesh.nodes[node];
    double right = (double)x.x / size - 0.5, back = (double)x.y / size - 0.4;
    double share = exp(-12 * (right * right + back * back));
    if (pull == PULL_SIDE) {
        *way = sb_v3_scale(REAL(share), drag);
        return x.z > REAL(0.26 * size) && share > 0.25;
    }
    *way = pull == PULL_PATCH ? drag : sb_v3(REAL(-0.2 * size * back), REAL(0.2 * size * right), REAL(-0.02 * size));
    return in_patch(made, node, size);
}

static int make_pulled_slab(slab *made, sb_element_type type, double size, slab_pull pull)
{
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_boundary boundary;
    sb_vec3 way;
    memset(made, 0, sizeof *made);
    made->patch[0] = 0.35;
    made->patch[1] = 0.65;
    made->mesh = scene_box(type, 10, 8, 3, sb_v3(REAL(size), REAL(0.8 * size), REAL(0.3 * size)), 0);
    for (int i = 0; i < made->mesh.node_count; i++) { /* hilly: a flat side would show no motion along it at all */
        sb_vec3 *x = made->mesh.nodes + i;
        double a = 9 * (double)x->x / size, b = 8 * (double)x->y / size;
        x->z += REAL(0.03 * size * sin(a) * cos(b)) * x->z / REAL(0.3 * size);
    }
    def.mesh = &made->mesh;
    def.material = soft();
    made->body = scene_body(&def);
    made->truth = (sb_vec3 *)calloc((size_t)made->mesh.node_count, sizeof(sb_vec3));
    if (!made->body || !CHECK_OK(sb_mesh_boundary(&made->mesh, 1, NULL, &boundary, NULL)))
        return 0;
    scene_fix_plane(made->body, &made->mesh, 2, 0, SB_XYZ);
    for (int i = 0; i < made->mesh.node_count; i++)
        if (pull_of(made, i, size, pull, &way))
            CHECK_OK(sb_body_prescribe(made->body, &i, 1, SB_XYZ, &way, 1));
    options.load_steps = 4;
    CHECK_OK(sb_body_solve_static(made->body, &options, NULL));
    memcpy(made->truth, sb_body_displacements(made->body), (size_t)made->mesh.node_count * sizeof(sb_vec3));
    CHECK_OK(sb_surface_triangulate(&boundary.surface, NULL, &made->skin, NULL));
    for (int i = 0; i < made->skin.node_count; i++)
        made->skin.nodes[i] = sb_v3_add(made->skin.nodes[i], made->truth[boundary.nodes[i]]);
    sb_boundary_free(&boundary);
    sb_body_destroy(made->body);
    made->body = scene_body(&def);
    scene_fix_plane(made->body, &made->mesh, 2, 0, SB_XYZ);
    return made->body != NULL;
}

static int make_slab(slab *made, sb_element_type type, double size)
{
    return make_pulled_slab(made, type, size, PULL_PATCH);
}

static void free_slab(slab *made)
{
    sb_body_destroy(made->body);
    sb_mesh_free(&made->mesh);
    sb_mesh_free(&made->skin);
    free(made->truth);
}

/* Mean distance of the nodes from where they should be, over the mean of how far they had to go. */
static double error_of(const slab *made)
{
    const sb_vec3 *u = sb_body_displacements(made->body);
    double sum = 0, way = 0;
    for (int i = 0; i < made->mesh.node_count; i++) {
        sum += (double)sb_v3_norm(sb_v3_sub(u[i], made->truth[i]));
        way += (double)sb_v3_norm(made->truth[i]);
    }
    return sum / way;
}

static reg_match *matched(const slab *made, const reg_match_def *given)
{
    reg_match_def def = given ? *given : reg_default_match_def();
    reg_match *match = NULL;
    def.body = made->body;
    def.target = &made->skin;
    if (CHECK_OK(reg_match_create(&def, &match, NULL)))
        CHECK_OK(reg_match_run(match, 60, NULL));
    return match;
}

static reg_loads_def def_of(reg_match *match)
{
    reg_loads_def def = reg_default_loads_def();
    def.match = match;
    def.samples = 150;
    return def;
}

/* ---- a slab ---- */

/* What matching leaves open is found, and the forces are those of a body at rest: where they are said to be. */
static void test_drag(void)
{
    const sb_element_type types[3] = {SB_TET4, SB_HEX8, SB_TET4};
    double found[3] = {1, 2, 3};
    for (int k = 0; k < 3; k++) {
        double size = k == 2 ? 100 : 0.2, before, near = 0, all = 0;
        reg_loads_info info;
        slab made;
        if (make_slab(&made, types[k], size)) {
            reg_match *match = matched(&made, NULL);
            reg_loads_def def = def_of(match);
            sb_vec3 *forces = (sb_vec3 *)calloc((size_t)made.mesh.node_count, sizeof(sb_vec3));
            before = error_of(&made);
            CHECK_OK(reg_loads_run(&def, forces, &info));
            found[k] = error_of(&made);
            CHECK(found[k] < 0.5 * before);
            CHECK(info.rounds > 1 && info.rounds <= def.rounds && info.loaded > 0 && info.loaded < REAL(0.3));
            CHECK(info.seconds == 0 && info.mean_distance < REAL(0.01 * size));
            for (int i = 0; i < made.mesh.node_count; i++) {
                double f = (double)sb_v3_norm(forces[i]);
                sb_vec3 x = made.mesh.nodes[i];
                all += f;
                near += x.x > REAL(0.2 * size) && x.x < REAL(0.8 * size) && x.z > REAL(0.2 * size) ? f : 0;
                CHECK(f == 0 || x.z > 0);
            }
            CHECK(near > 0.7 * all);
            reg_match_destroy(match);
            free(forces);
        }
        free_slab(&made);
    }
    CHECK_NEAR(found[2], found[0], sizeof(sb_real) == 8 ? 1e-3 : 0.1); /* the same shares of any size */
}

/* A direction that loads on a few large parts of a small slab do not have in common is not forced on them. */
static void test_no_direction(void)
{
    const slab_pull pulls[3] = {PULL_PATCH, PULL_TURN, PULL_SIDE};
    for (int p = 0; p < 3; p++) {
        double found[2] = {0, 0};
        slab made;
        if (make_pulled_slab(&made, SB_TET4, 0.2, pulls[p]))
            for (int k = 0; k < 2; k++) {
                reg_match *match;
                reg_loads_def def;
                reg_loads_info info;
                sb_body_reset(made.body);
                match = matched(&made, NULL);
                def = def_of(match);
                def.drag = k ? def.drag : 0;
                CHECK_OK(reg_loads_run(&def, NULL, &info));
                found[k] = error_of(&made);
                CHECK(sb_v3_norm(info.drag) == 0);
                reg_match_destroy(match);
            }
        CHECK(found[1] < 1.05 * found[0]);
        free_slab(&made);
    }
}

/* The slab was moved as a whole, too, and nobody says how: the pose is found, its supports go there, and a failure puts
 * them back. */
static void test_pose(void)
{
    slab made;
    if (make_slab(&made, SB_TET4, 0.2)) {
        const sb_vec3 turn = sb_v3(REAL(0.01), REAL(-0.02), REAL(0.015)), way = sb_v3(REAL(0.002), REAL(-0.001), 0);
        reg_rigid motion = reg_rigid_identity();
        double held = 0, sought = 0, way_off = 0;
        motion.rotation = sb_quat_to_mat3(sb_quat_from_rotation_vector(turn));
        motion.translation = way;
        for (int i = 0; i < made.skin.node_count; i++)
            made.skin.nodes[i] = reg_rigid_apply(&motion, made.skin.nodes[i]);
        for (int i = 0; i < made.mesh.node_count; i++) {
            sb_vec3 x = sb_v3_add(made.mesh.nodes[i], made.truth[i]);
            made.truth[i] = sb_v3_sub(reg_rigid_apply(&motion, x), made.mesh.nodes[i]);
        }
        for (int k = 0; k < 2; k++) {
            reg_match *match;
            reg_loads_def def;
            scene_fix_plane(made.body, &made.mesh, 2, 0, SB_XYZ);
            sb_body_reset(made.body);
            match = matched(&made, NULL);
            def = def_of(match);
            def.pose = k ? REAL(0.01) : 0;
            CHECK_OK(reg_loads_run(&def, NULL, NULL));
            *(k ? &sought : &held) = error_of(&made);
            reg_match_destroy(match);
        }
        CHECK(sought < 0.5 * held);
        CHECK_OK(sb_body_step(made.body, REAL(0.01), NULL)); /* supports are where the nodes are */
        for (int i = 0; i < made.mesh.node_count; i++)
            if (!(made.mesh.nodes[i].z > 0))
                way_off =
                    fmax(way_off, (double)sb_v3_norm(sb_v3_sub(sb_body_displacements(made.body)[i], made.truth[i])));
        CHECK(way_off < 0.002);
    }
    free_slab(&made);
}

/* Keeps the triangles that lie above a height. */
static void cut_below(sb_mesh *skin, sb_real height)
{
    int kept = 0;
    for (int e = 0; e < skin->element_count; e++) {
        const int *n = skin->elements + 3 * (size_t)e;
        if (skin->nodes[n[0]].z > height && skin->nodes[n[1]].z > height && skin->nodes[n[2]].z > height)
            memmove(skin->elements + 3 * (size_t)kept++, n, 3 * sizeof *n);
    }
    skin->element_count = kept;
    CHECK_OK(sb_mesh_remove_unreferenced(skin, &kept, NULL));
}

/* The upper side alone is seen: parts elsewhere are no samples. A match that never ran has seen nothing so far. */
static void test_part(void)
{
    slab made;
    if (make_slab(&made, SB_TET4, 0.2)) {
        for (int ran = 0; ran < 2; ran++) {
            reg_match_def given = reg_default_match_def();
            reg_match *match = NULL;
            reg_loads_info info;
            double before;
            if (ran == 0)
                cut_below(&made.skin, REAL(0.04));
            sb_body_reset(made.body);
            given.body = made.body;
            given.target = &made.skin;
            given.partial = 1;
            if (CHECK_OK(reg_match_create(&given, &match, NULL))) {
                reg_loads_def def = def_of(match);
                if (ran)
                    CHECK_OK(reg_match_run(match, 60, NULL));
                before = error_of(&made);
                CHECK_OK(reg_loads_run(&def, NULL, &info));
                CHECK(error_of(&made) < 0.6 * before);
            }
            reg_match_destroy(match);
        }
    }
    free_slab(&made);
}

/* A landmark in the patch, which says where it went. */
static void test_landmark(void)
{
    slab made;
    reg_loads_info info;
    if (make_slab(&made, SB_TET4, 0.2)) {
        reg_match_def given = reg_default_match_def();
        reg_match *match;
        reg_loads_def def;
        sb_vec3 seen, now;
        int node = 0;
        double plain;
        while (!in_patch(&made, node, 0.2))
            node++;
        match = matched(&made, NULL);
        def = def_of(match);
        def.samples = 60; /* so few that the surface leaves something to say */
        CHECK_OK(reg_loads_run(&def, NULL, &info));
        plain = error_of(&made);
        reg_match_destroy(match);
        sb_body_reset(made.body);
        seen = sb_v3_add(made.mesh.nodes[node], made.truth[node]);
        given.landmarks = made.mesh.nodes + node;
        given.landmark_targets = &seen;
        given.landmark_count = 1;
        match = matched(&made, &given);
        def = def_of(match);
        def.samples = 60; /* so few that the surface leaves something to say */
        CHECK_OK(reg_loads_run(&def, NULL, &info));
        CHECK(error_of(&made) < plain);
        reg_match_landmarks(match, &now);
        CHECK(sb_v3_norm(sb_v3_sub(now, seen)) < REAL(0.0005));
        reg_match_destroy(match);
    }
    free_slab(&made);
}

/* ---- failures ---- */

static void refuse(const reg_loads_def *def, sb_result expected)
{
    const sb_body *body = def->match ? reg_match_body(def->match) : NULL;
    sb_vec3 before = body ? sb_body_displacements(body)[0] : sb_v3(0, 0, 0), force = sb_v3(1, 2, 3);
    reg_loads_info info;
    CHECK_RESULT(reg_loads_run(def, &force, &info), expected);
    CHECK(info.error.result == expected && info.error.message[0]);
    CHECK(force.x == 1 && (!body || memcmp(&before, sb_body_displacements(body), sizeof before) == 0));
    CHECK_RESULT(reg_loads_run(def, NULL, NULL), expected);
}

static void test_refusals(void)
{
    slab made;
    check_bad_numbers();
    if (make_slab(&made, SB_TET4, 0.2)) {
        reg_match *match = matched(&made, NULL), *laplace = NULL;
        reg_match_def grid = reg_default_match_def();
        reg_loads_def def = def_of(match), bad;
        sb_vec3 point = sb_v3(0, 0, 0);
        sb_real stiffness = 1;
        int all = 0;
        CHECK_RESULT(reg_loads_run(NULL, NULL, NULL), SB_ERROR_ARGUMENT);
        memset(&bad, 0, sizeof bad);
        refuse(&bad, SB_ERROR_ARGUMENT);
        bad = def;
        bad.samples = 29;
        refuse(&bad, SB_ERROR_ARGUMENT);
        bad = def;
        bad.rounds = 0;
        refuse(&bad, SB_ERROR_ARGUMENT);
        bad = def;
        bad.reweights = 0;
        refuse(&bad, SB_ERROR_ARGUMENT);
        bad = def;
        bad.misfit = REAL(NAN);
        refuse(&bad, SB_ERROR_ARGUMENT);
        bad = def;
        bad.power = REAL(2.5);
        refuse(&bad, SB_ERROR_ARGUMENT);
        bad = def;
        bad.floor = 0;
        refuse(&bad, SB_ERROR_ARGUMENT);
        bad = def;
        bad.landmark = 0;
        refuse(&bad, SB_ERROR_ARGUMENT);
        bad.landmark = REAL(NAN);
        refuse(&bad, SB_ERROR_ARGUMENT);
        bad = def;
        bad.max_seconds = 0;
        refuse(&bad, SB_ERROR_ARGUMENT);
        bad = def;
        bad.pose = -1;
        refuse(&bad, SB_ERROR_ARGUMENT);
        bad = def;
        bad.drag = REAL(NAN);
        refuse(&bad, SB_ERROR_ARGUMENT);
        bad.drag = 1;
        refuse(&bad, SB_ERROR_ARGUMENT);
        grid.body = made.body;
        grid.target = &made.skin;
        grid.method = REG_PBSM_LAPLACE;
        grid.cells = 16;
        if (CHECK_OK(reg_match_create(&grid, &laplace, NULL))) {
            bad = def;
            bad.match = laplace;
            refuse(&bad, SB_ERROR_UNSUPPORTED);
        }
        reg_match_destroy(laplace);
        CHECK_OK(sb_body_add_springs(made.body, &all, 1, &stiffness, 1, &point, NULL, NULL));
        refuse(&def, SB_ERROR_UNSUPPORTED);
        reg_match_destroy(match);
    }
    free_slab(&made);
}

/* Nothing near, and nothing free. */
static void test_nothing(void)
{
    slab made;
    if (make_slab(&made, SB_TET4, 0.2)) {
        reg_match_def far_def = reg_default_match_def();
        reg_match *match = NULL;
        reg_loads_def def;
        for (int i = 0; i < made.skin.node_count; i++)
            made.skin.nodes[i].x += 7;
        far_def.body = made.body;
        far_def.target = &made.skin;
        far_def.partial = 1;
        if (CHECK_OK(reg_match_create(&far_def, &match, NULL))) {
            def = def_of(match);
            refuse(&def, SB_ERROR_NOT_CONVERGED);
            scene_fix_boundary(made.body, &made.mesh);
            refuse(&def, SB_ERROR_ARGUMENT);
        }
        reg_match_destroy(match);
    }
    free_slab(&made);
}

static double fake_time;
static double fake_clock(void) { return fake_time += 1; }

/* The clock ticks at every look at it: before the first round once too often, or after it. */
static void test_time_cap(void)
{
    slab made;
    if (make_slab(&made, SB_TET4, 0.2)) {
        reg_match *match = matched(&made, NULL);
        reg_loads_def def = def_of(match);
        reg_loads_info info;
        sb_vec3 before = sb_body_displacements(made.body)[0];
        def.clock = fake_clock;
        def.max_seconds = 1;
        CHECK_OK(reg_loads_run(&def, NULL, &info));
        CHECK(info.rounds == 0 && memcmp(&before, sb_body_displacements(made.body), sizeof before) == 0);
        def.max_seconds = 4;
        CHECK_OK(reg_loads_run(&def, NULL, &info));
        CHECK_INT(info.rounds, 1);
        reg_match_destroy(match);
    }
    free_slab(&made);
}

static void test_memory(void)
{
    slab made;
    scene_memory memory = {0, 0, 0, 0};
    if (make_slab(&made, SB_TET4, 0.2)) {
        reg_match *match = matched(&made, NULL);
        reg_loads_def def = def_of(match);
        sb_result result = SB_ERROR_MEMORY;
        def.allocator = scene_allocator(&memory);
        def.samples = 30;
        def.rounds = 1;
        def.reweights = 1;
        for (int fail = 1; result == SB_ERROR_MEMORY && fail < 1000; fail++) {
            memory.calls = 0;
            memory.fail_at = fail;
            result = reg_loads_run(&def, NULL, NULL);
            CHECK(result == SB_OK || result == SB_ERROR_MEMORY);
            CHECK_INT(memory.live, 0);
        }
        CHECK_OK(result);
        reg_match_destroy(match);
    }
    free_slab(&made);
}

/* ---- livers of the shared data ---- */

/* Matches the corotated organ up to the charge, then finds the loads of a neo-Hookean one; returns the mean error
 * (mm). Fewer samples than by default, for time's sake. */
static double liver_loads(const liver *made, int held, sb_real charge, int landmark, int rounds, double *matched_error)
{
    sb_body_def body_def = sb_default_body_def();
    reg_match_def def = reg_default_match_def();
    reg_match *match = NULL;
    sb_material tissue = sb_material_neo_hookean(5000, REAL(0.45), 1060);
    double mean = 1e9, most;
    sb_vec3 seen;
    body_def.mesh = &made->mesh;
    body_def.material = sb_material_corotated(5000, REAL(0.45), 1060);
    def.body = scene_body(&body_def);
    for (int i = 0; held && i < made->mesh.node_count; i++)
        if (liver_is_fixed(made, made->mesh.nodes[i]))
            CHECK_OK(sb_body_fix_nodes(def.body, &i, 1, SB_XYZ));
    def.surface = &made->surface;
    def.target = &made->target;
    def.last_charge = charge;
    if (landmark >= 0) {
        seen = sb_v3_add(made->fine.nodes[landmark], made->truth[landmark]);
        def.landmarks = made->fine.nodes + landmark;
        def.landmark_targets = &seen;
        def.landmark_count = 1;
    }
    if (CHECK_OK(reg_match_create(&def, &match, NULL)) && CHECK_OK(reg_match_run(match, 60, NULL))) {
        reg_loads_def loads = reg_default_loads_def();
        reg_loads_info info;
        *matched_error = liver_score(made, def.body, &most);
        loads.match = match;
        loads.samples = 200;
        loads.rounds = rounds;
        CHECK_OK(sb_body_set_material(def.body, &tissue, NULL));
        if (CHECK_OK(reg_loads_run(&loads, NULL, &info)))
            mean = liver_score(made, def.body, &most);
        if (held && charge < 100) /* a patch was dragged, and that is seen */
            CHECK_NEAR(sb_v3_norm(info.drag), 1, 64 * (double)SB_EPSILON);
        CHECK(most < (held && made->target.node_count > 5000 ? 4.5 : 8));
    }
    reg_match_destroy(match);
    sb_body_destroy(def.body);
    return mean;
}

static void test_livers(void)
{
    const char *names[2] = {"liver1", "liver2"}, *meshes[2] = {"coarse_tet4.vtk", "coarse_tet10.vtk"};
    char path[512];
    if (!check_shared_path(path, sizeof path, "data/insilico/README.md")) {
        CHECK_SKIP("no shared livers");
        return;
    }
    for (int k = 0; k < (check_quick() ? 1 : 2); k++)
        for (int m = 0; m < (check_quick() ? 1 : 2); m++) {
            liver made;
            double before = 0, mean;
            if (liver_read(names[k], meshes[m], "deformed_surface.obj", &made)) {
                mean = liver_loads(&made, 1, 2, -1, 10, &before);
                CHECK(mean < 0.5 && before > 1 && before > 2 * mean);
                if (m == 0)
                    CHECK(liver_loads(&made, 0, 100, -1, 4, &before) < 0.8);
            }
            liver_free(&made);
        }
}

static void test_partial_livers(void)
{
    char path[512];
    liver clear, noisy;
    double mean, before = 0;
    if (!check_shared_path(path, sizeof path, "data/insilico/README.md")) {
        CHECK_SKIP("no shared livers");
        return;
    }
    memset(&clear, 0, sizeof clear);
    memset(&noisy, 0, sizeof noisy);
    if (liver_read("liver2", "coarse_tet4.vtk", "partial_deformed_surface.obj", &clear) &&
        liver_read("liver2", "coarse_tet4.vtk", "partial_deformed_surface_noisy.obj", &noisy)) {
        CHECK_OK(reg_cloud_smooth_mesh(&noisy.target, NULL, NULL, NULL));
        mean = liver_loads(&clear, 1, 2, -1, 10, &before);
        CHECK(mean < 1 && before > 2 * mean);
        CHECK(liver_loads(&noisy, 1, 2, -1, 10, &before) < mean + 0.4);
        liver_free(&clear);
        if (liver_read("liver1", "coarse_tet4.vtk", "partial_deformed_surface.obj", &clear))
            CHECK(liver_loads(&clear, 1, 100, liver_farthest(&clear), 6, &before) <
                  liver_loads(&clear, 1, 100, -1, 6, &before));
    }
    liver_free(&clear);
    liver_free(&noisy);
}

CHECK_SUITE(loads, {"a slab that was dragged", test_drag}, {"no direction", test_no_direction}, {"a pose", test_pose},
            {"a part", test_part}, {"a landmark", test_landmark}, {"refusals", test_refusals},
            {"nothing to find", test_nothing}, {"time cap", test_time_cap}, {"failing allocations", test_memory},
            {"livers, whole surfaces", test_livers}, {"livers, partial surfaces", test_partial_livers});
