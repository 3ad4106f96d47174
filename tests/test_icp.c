/* Tests of icp: recovery of known motions, partial views, weights, landmarks, caps, degenerate and bad input, and the
 * automatic start on the in silico livers. */
#include "scene.h"

#include "register.h"

/* A lopsided body without symmetry, evenly spread points and outward normals. */
enum { BODY = 1500 };
static sb_vec3 body_points[BODY], body_normals[BODY];

static sb_vec3 body_at(double z, double a)
{
    double r = sqrt(z < 1 && z > -1 ? 1 - z * z : 0), bump = 1 + 0.25 * cos(a) * r + 0.15 * z * sin(2 * a) * r;
    return sb_v3(REAL(0.11 * bump * r * cos(a)), REAL(0.07 * bump * r * sin(a)), REAL(0.05 * bump * z + 0.01 * r * r));
}

static void make_body(void)
{
    const double h = 1e-3;
    for (int i = 0; i < BODY; i++) {
        double z = 1 - (2 * i + 1.0) / (double)BODY, a = 2.399963229728653 * i;
        sb_vec3 p = body_at(z, a), du, dv, n;
        du = sb_v3_sub(body_at(z * (1 - h), a), p);
        du = z < 0 ? du : sb_v3_scale(-1, du);
        dv = sb_v3_sub(body_at(z, a + h), p);
        n = sb_v3_cross(dv, du);
        n = sb_v3_dot(n, p) < 0 ? sb_v3_scale(-1, n) : n;
        body_points[i] = p;
        body_normals[i] = sb_v3_scale(1 / sb_v3_norm(n), n);
    }
}

static reg_rigid random_pose(unsigned long long *seed, double far)
{
    reg_rigid pose;
    sb_real q[4];
    for (int i = 0; i < 4; i++)
        q[i] = REAL(check_random_in(seed, -1, 1) + check_random_in(seed, -1, 1) + check_random_in(seed, -1, 1));
    pose.rotation = sb_quat_to_mat3(sb_quat_normalise(sb_quat_make(q[0], q[1], q[2], q[3])));
    pose.translation = sb_v3(REAL(check_random_in(seed, -far, far)), REAL(check_random_in(seed, -far, far)),
                             REAL(check_random_in(seed, -far, far)));
    return pose;
}

static reg_rigid turn(double x, double y, double z)
{
    reg_rigid pose = reg_rigid_identity();
    pose.rotation = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(REAL(x), REAL(y), REAL(z))));
    return pose;
}

static void move(const reg_rigid *pose, const sb_vec3 *points, const sb_vec3 *normals, int count, sb_vec3 *to,
                 sb_vec3 *normals_to)
{
    for (int i = 0; i < count; i++) {
        to[i] = reg_rigid_apply(pose, points[i]);
        if (normals_to)
            normals_to[i] = sb_m3_apply(pose->rotation, normals[i]);
    }
}

/* Mean distance between where two motions put the points. */
static double gap(const reg_rigid *a, const reg_rigid *b, const sb_vec3 *points, int count)
{
    double sum = 0;
    for (int i = 0; i < count; i++)
        sum += (double)sb_v3_norm(sb_v3_sub(reg_rigid_apply(a, points[i]), reg_rigid_apply(b, points[i])));
    return sum / count;
}

static reg_icp_shape shape_of(const sb_vec3 *points, const sb_vec3 *normals, int count)
{
    reg_icp_shape shape;
    memset(&shape, 0, sizeof shape);
    shape.points = points;
    shape.normals = normals;
    shape.count = count;
    return shape;
}

/* The body's own points, moved: the motion comes back to rounding, from any pose, with either metric, with normals
 * given and fitted. */
static void test_exact(void)
{
    static sb_vec3 points[BODY], normals[BODY];
    unsigned long long seed = 21;
    make_body();
    for (int k = 0; k < 4; k++) {
        reg_rigid pose = random_pose(&seed, 0.2), found;
        reg_icp_options options = reg_default_icp_options();
        reg_icp_shape model = shape_of(body_points, k & 1 ? body_normals : NULL, BODY), target;
        reg_icp_info info;
        move(&pose, body_points, body_normals, BODY, points, normals);
        target = shape_of(points, k & 1 ? normals : NULL, BODY);
        options.metric = k & 2 ? REG_ICP_POINT : REG_ICP_PLANE;
        if (!CHECK_OK(reg_icp(&model, &target, &options, &found, &info, NULL)))
            return;
        CHECK(gap(&pose, &found, body_points, BODY) < 64 * (double)SB_EPSILON);
        CHECK_INT(info.stop, REG_ICP_CONVERGED);
        CHECK(info.candidates > 24 && info.pairs > BODY && info.mean < 64 * SB_EPSILON);
    }
}

/* Without search, from a small turn: the nearest minimum. And the pose given as a start is one to begin with. */
static void test_no_search(void)
{
    static sb_vec3 points[BODY], normals[BODY];
    reg_rigid pose = turn(0.1, -0.15, 0.1), far = turn(0, 3, 0.5), found;
    reg_icp_options options = reg_default_icp_options();
    reg_icp_shape model, target;
    reg_icp_info info;
    make_body();
    move(&pose, body_points, body_normals, BODY, points, normals);
    model = shape_of(body_points, body_normals, BODY);
    target = shape_of(points, normals, BODY);
    options.search = 0;
    CHECK_OK(reg_icp(&model, &target, &options, &found, &info, NULL));
    CHECK(gap(&pose, &found, body_points, BODY) < 64 * (double)SB_EPSILON);
    CHECK_INT(info.candidates, 0);
    options.start = far;
    CHECK_OK(reg_icp(&model, &target, &options, &found, &info, NULL));
    CHECK(gap(&pose, &found, body_points, BODY) > 0.02);
    options.start = pose;
    options.max_iterations = 1;
    CHECK_OK(reg_icp(&model, &target, &options, &found, &info, NULL));
    CHECK(gap(&pose, &found, body_points, BODY) < 64 * (double)SB_EPSILON && info.iterations == 1);
}

/* A view of the upper side, of other points than the model's; either may be the part. */
static void test_part(void)
{
    static sb_vec3 points[BODY], normals[BODY], part[BODY], part_normals[BODY];
    unsigned long long seed = 5;
    int seen = 0;
    make_body();
    for (int i = 0; i < BODY; i += 2)
        if (body_normals[i].z + body_normals[i].x / 2 > REAL(0.2)) {
            part[seen] = body_points[i];
            part_normals[seen++] = body_normals[i];
        }
    CHECK(seen > BODY / 8);
    for (int k = 0; k < 3; k++) {
        reg_rigid pose = random_pose(&seed, 0.2), found, back;
        reg_icp_options options = reg_default_icp_options();
        reg_icp_shape model = shape_of(body_points, body_normals, BODY), target;
        reg_icp_info info;
        move(&pose, part, part_normals, seen, points, normals);
        target = shape_of(points, k == 0 ? NULL : normals, seen);
        options.overlap = REG_ICP_TARGET_PART;
        options.metric = k & 1 ? REG_ICP_POINT : REG_ICP_PLANE;
        if (!CHECK_OK(reg_icp(&model, &target, &options, &found, &info, NULL)))
            return;
        CHECK(gap(&pose, &found, body_points, BODY) < 64 * (double)SB_EPSILON);
        CHECK(info.overlap > REAL(0.8)); /* what rounding moves beyond the median rule may be left out */
        options.overlap = REG_ICP_MODEL_PART;
        CHECK_OK(reg_icp(&target, &model, &options, &back, &info, NULL));
        found = reg_rigid_inverse(&found);
        CHECK(gap(&back, &found, points, seen) < 64 * (double)SB_EPSILON);
    }
}

/* Half of the target's points are elsewhere: each rule that may leave them out finds the motion, none does not. */
static void test_outliers(void)
{
    static sb_vec3 points[BODY];
    static const reg_outliers rules[3] = {REG_OUTLIERS_MEDIAN, REG_OUTLIERS_TRIM, REG_OUTLIERS_NONE};
    static const double parameters[3] = {3, 0.7, 0};
    reg_rigid pose = turn(0.05, 0.05, -0.05);
    unsigned long long seed = 2;
    make_body();
    move(&pose, body_points, body_normals, BODY, points, NULL);
    for (int i = 0; i < BODY; i += 5)
        points[i] = sb_v3_add(points[i], sb_v3(REAL(check_random_in(&seed, 0.02, 0.05)), 0, REAL(0.03)));
    for (int rule = 0; rule < 3; rule++) {
        reg_icp_options options = reg_default_icp_options();
        reg_icp_shape model = shape_of(body_points, body_normals, BODY), target = shape_of(points, NULL, BODY);
        reg_icp_info info;
        reg_rigid found;
        double off;
        options.search = 0;
        options.metric = REG_ICP_POINT;
        options.overlap = REG_ICP_TARGET_PART;
        options.outliers = rules[rule];
        options.outlier_parameter = REAL(parameters[rule]);
        if (!CHECK_OK(reg_icp(&model, &target, &options, &found, &info, NULL)))
            return;
        off = gap(&pose, &found, body_points, BODY);
        CHECK(rule < 2 ? off < 64 * (double)SB_EPSILON : off > 1e-4);
        CHECK(rule == 2 || (info.overlap > REAL(0.6) && info.overlap < REAL(0.85)));
    }
}

/* A patch that moved by itself is heeded as its weights say. */
static void test_weights(void)
{
    static sb_vec3 points[BODY];
    static sb_real weights[BODY];
    reg_rigid found[2];
    sb_vec3 shift = sb_v3(0, 0, REAL(0.004));
    make_body();
    for (int i = 0; i < BODY; i++) {
        int patch = body_points[i].x > REAL(0.02);
        points[i] = patch ? sb_v3_add(body_points[i], shift) : body_points[i];
        weights[i] = patch ? 0 : 1;
    }
    for (int weighted = 0; weighted < 2; weighted++) {
        reg_icp_options options = reg_default_icp_options();
        reg_icp_shape model = shape_of(body_points, body_normals, BODY), target = shape_of(points, body_normals, BODY);
        options.search = 0;
        options.outliers = REG_OUTLIERS_NONE;
        options.metric = REG_ICP_POINT;
        model.weights = weighted ? weights : NULL;
        target.weights = weighted ? weights : NULL;
        if (!CHECK_OK(reg_icp(&model, &target, &options, &found[weighted], NULL, NULL)))
            return;
    }
    CHECK(sb_v3_norm(found[0].translation) > REAL(1e-4));
    CHECK(sb_v3_norm(found[1].translation) < REAL(1e-4) && reg_rigid_angle(&found[1]) < REAL(1e-3));
}

/* A sphere turns freely; landmarks hold it, in either metric. They also give the start. */
static void test_landmarks(void)
{
    static sb_vec3 sphere[BODY], points[BODY];
    reg_rigid pose = turn(1, 2, -0.5), found;
    reg_icp_landmark landmarks[3];
    pose.translation = sb_v3(REAL(0.1), 0, REAL(0.2));
    for (int i = 0; i < BODY; i++) {
        double z = 1 - (2 * i + 1.0) / (double)BODY, a = 2.399963229728653 * i, r = sqrt(1 - z * z);
        sphere[i] = sb_v3(REAL(0.1 * r * cos(a)), REAL(0.1 * r * sin(a)), REAL(0.1 * z));
    }
    move(&pose, sphere, NULL, BODY, points, NULL);
    for (int i = 0; i < 3; i++) {
        landmarks[i].model = sphere[100 + 400 * i];
        landmarks[i].target = points[100 + 400 * i];
        landmarks[i].weight = REAL(0.1);
    }
    for (int metric = 0; metric < 4; metric++) {
        reg_icp_options options = reg_default_icp_options();
        reg_icp_shape model = shape_of(sphere, NULL, BODY), target = shape_of(points, NULL, BODY);
        reg_icp_info info;
        options.metric = metric & 1 ? REG_ICP_PLANE : REG_ICP_POINT;
        options.overlap = metric & 2 ? REG_ICP_TARGET_PART : REG_ICP_WHOLE;
        options.landmarks = landmarks;
        options.landmark_count = 3;
        if (!CHECK_OK(reg_icp(&model, &target, &options, &found, &info, NULL)))
            return;
        CHECK(gap(&pose, &found, sphere, BODY) < 1e-6 + 64 * (double)SB_EPSILON);
        CHECK(info.landmark_rms < REAL(1e-6) + 64 * SB_EPSILON);
    }
}

/* A surface as the target: points of it, moved, come to lie on it, though they are none of its nodes. */
static void test_surface(void)
{
    sb_mesh box = scene_box(SB_HEX8, 8, 5, 3, sb_v3(REAL(0.16), REAL(0.1), REAL(0.06)), 0);
    reg_rigid pose = turn(0.1, 0.1, -0.1), found;
    static sb_vec3 points[400], moved[400];
    sb_boundary boundary;
    sb_surface *skin = NULL;
    if (CHECK_OK(sb_mesh_boundary(&box, 1, NULL, &boundary, NULL)) &&
        CHECK_OK(sb_surface_create(&boundary.surface, NULL, &skin, NULL))) {
        for (int metric = 0; metric < 2; metric++) {
            int count = 0;
            reg_icp_options options = reg_default_icp_options();
            reg_icp_shape model, target = shape_of(boundary.surface.nodes, NULL, boundary.surface.node_count);
            reg_icp_info info;
            unsigned long long seed = 4;
            while (count < 400) { /* on the surface, by the closest point of anything */
                sb_surface_hit hit;
                sb_surface_closest(skin,
                                   sb_v3(REAL(check_random_in(&seed, -0.1, 0.3)),
                                         REAL(check_random_in(&seed, -0.1, 0.2)),
                                         REAL(check_random_in(&seed, -0.1, 0.2))),
                                   SB_REAL_MAX, &hit);
                points[count++] = hit.point;
            }
            move(&pose, points, NULL, count, moved, NULL);
            model = shape_of(moved, NULL, count);
            target.surface = skin;
            options.search = 0;
            options.overlap = REG_ICP_MODEL_PART;
            options.metric = metric ? REG_ICP_PLANE : REG_ICP_POINT;
            options.outliers = REG_OUTLIERS_NONE;
            options.max_iterations = 400;
            options.tolerance = 0;
            if (!CHECK_OK(reg_icp(&model, &target, &options, &found, &info, NULL)))
                break;
            CHECK(info.rms < REAL(1e-4));
            found = reg_rigid_compose(&found, &pose);
            CHECK(reg_rigid_angle(&found) < REAL(2e-3));
        }
        sb_surface_destroy(skin);
        sb_boundary_free(&boundary);
    }
    sb_mesh_free(&box);
}

static double clock_now;
static double slow_clock(void) { return clock_now += 0.01; }

static void test_caps(void)
{
    static sb_vec3 points[BODY];
    reg_rigid pose = turn(0.3, 0.2, 0.4), found;
    reg_icp_options options = reg_default_icp_options();
    reg_icp_shape model, target;
    reg_icp_info info;
    make_body();
    move(&pose, body_points, NULL, BODY, points, NULL);
    for (int i = 0; i < BODY; i++)
        points[i].x += REAL(0.01) * points[i].y; /* no exact fit */
    model = shape_of(body_points, NULL, BODY);
    target = shape_of(points, NULL, BODY);
    options.search = 0;
    options.tolerance = 0;
    options.max_iterations = 3;
    options.metric = REG_ICP_POINT;
    CHECK_OK(reg_icp(&model, &target, &options, &found, &info, NULL));
    CHECK(info.stop == REG_ICP_ITERATIONS && info.iterations == 3);
    for (int search = 0; search < 2; search++) {
        options.search = search;
        options.max_iterations = 100000;
        options.clock = slow_clock;
        options.max_seconds = 0.25;
        CHECK_OK(reg_icp(&model, &target, &options, &found, &info, NULL));
        CHECK_INT(info.stop, REG_ICP_TIME);
        CHECK(info.seconds > 0.2 && info.seconds < 0.4);
    }
    CHECK(strcmp(reg_icp_stop_string(REG_ICP_TIME), "time") == 0);
}

/* One point, two, points in a line or a plane, all in one place: some best motion, never a crash. */
static void test_degenerate(void)
{
    sb_vec3 points[40], moved[40];
    reg_rigid pose = turn(0.4, 0.3, 0.2), found;
    pose.translation = sb_v3(REAL(0.3), 0, REAL(0.1));
    for (int kind = 0; kind < 5; kind++)
        for (int way = 0; way < 12; way++) {
            int count = kind == 0 ? 1 : kind == 1 ? 2 : 40;
            reg_icp_options options = reg_default_icp_options();
            reg_icp_shape model, target;
            reg_icp_info info;
            unsigned long long seed = 8;
            for (int i = 0; i < count; i++) {
                sb_real x = REAL(check_random_in(&seed, 0, 0.2)), y = REAL(check_random_in(&seed, 0, 0.1));
                points[i] = kind == 4 ? sb_v3(1, 1, 1) : kind == 2 ? sb_v3(x, x, 0) : sb_v3(x, y, 0);
            }
            move(&pose, points, NULL, count, moved, NULL);
            model = shape_of(points, NULL, count);
            target = shape_of(moved, NULL, count);
            options.metric = way & 1 ? REG_ICP_PLANE : REG_ICP_POINT;
            options.search = way / 2 % 2;
            options.overlap = (reg_icp_overlap)(way / 4);
            if (!CHECK_OK(reg_icp(&model, &target, &options, &found, &info, NULL)))
                return;
            CHECK(sb_v3_is_finite(found.translation));
            CHECK_NEAR(sb_m3_det(found.rotation), 1, 64 * (double)SB_EPSILON);
            if (kind != 3 || options.search) /* a plane slides: only the search gets it right */
                CHECK(way & 1 || info.rms < REAL(0.02));
        }
}

/* The lower side only: the normals fitted to its rim look up, and with them all others inward. Both ways are tried. */
static void test_turned_normals(void)
{
    static sb_vec3 points[BODY], part[BODY];
    reg_rigid pose = turn(0.05, -0.1, 0.05), found;
    reg_icp_options options = reg_default_icp_options();
    reg_icp_shape model, target;
    int seen = 0;
    make_body();
    for (int i = 0; i < BODY; i++)
        if (body_normals[i].z < REAL(-0.1))
            part[seen++] = body_points[i];
    move(&pose, part, NULL, seen, points, NULL);
    model = shape_of(body_points, body_normals, BODY);
    target = shape_of(points, NULL, seen);
    options.search = 0;
    options.overlap = REG_ICP_TARGET_PART;
    if (CHECK_OK(reg_icp(&model, &target, &options, &found, NULL, NULL)))
        CHECK(gap(&pose, &found, body_points, BODY) < 64 * (double)SB_EPSILON);
}

static void test_bad_input(void)
{
    sb_vec3 points[4] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, far[4];
    check_bad_numbers();
    sb_real weights[4] = {0, 0, 0, 0}, infinite = SB_REAL_MAX * 2;
    reg_icp_landmark landmark = {{0, 0, 0}, {0, 0, 0}, 0};
    reg_icp_options options = reg_default_icp_options();
    reg_icp_shape model = shape_of(points, NULL, 4), target = shape_of(far, NULL, 4), bad = model;
    reg_rigid found = turn(9, 9, 9), before = found;
    reg_kdtree *small = NULL;
    sb_error error;
    int wrong = 5;
    for (int i = 0; i < 4; i++)
        far[i] = sb_v3_add(points[i], sb_v3(100, 0, 0));
    CHECK_RESULT(reg_icp(NULL, &target, NULL, &found, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_icp(&model, NULL, NULL, &found, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_icp(&model, &target, NULL, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    bad.count = 0;
    CHECK_RESULT(reg_icp(&bad, &target, NULL, &found, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_icp(&model, &bad, NULL, &found, NULL, &error), SB_ERROR_ARGUMENT);
    bad = model;
    bad.weights = weights;
    CHECK_RESULT(reg_icp(&bad, &target, NULL, &found, NULL, &error), SB_ERROR_ARGUMENT);
    weights[2] = -1;
    CHECK_RESULT(reg_icp(&model, &bad, NULL, &found, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(error.node, 2);
    CHECK_OK(reg_kdtree_create(points, 3, NULL, &small, NULL));
    bad = model;
    bad.tree = small;
    CHECK_RESULT(reg_icp(&bad, &target, NULL, &found, NULL, &error), SB_ERROR_ARGUMENT);
    reg_kdtree_destroy(small);
    far[3].y = infinite - infinite;
    CHECK_RESULT(reg_icp(&model, &target, NULL, &found, NULL, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 3);
    far[3].y = 0;
    options.search = 0;
    options.max_distance = 1; /* they are 100 apart */
    CHECK_RESULT(reg_icp(&model, &target, &options, &found, NULL, &error), SB_ERROR_NOT_CONVERGED);
    CHECK(strstr(error.message, "within 1 m") != NULL);
    for (int k = 0; k < 11; k++) {
        options = reg_default_icp_options();
        switch (k) {
        case 0: options.cookie = 0; break;
        case 1: options.max_iterations = 0; break;
        case 2: options.tolerance = -1; break;
        case 3: options.max_distance = 0; break;
        case 4: options.sample = -1; break;
        case 5: options.outlier_parameter = -1; break;
        case 6: options.metric = (reg_icp_metric)wrong; break;
        case 7: options.overlap = (reg_icp_overlap)wrong; break;
        case 8: options.landmark_count = 1; break;
        case 9:
            options.landmarks = &landmark;
            options.landmark_count = 1;
            break;
        default: options.clock = slow_clock; options.max_seconds = 0;
        }
        CHECK_RESULT(reg_icp(&model, &target, &options, &found, NULL, &error), SB_ERROR_ARGUMENT);
    }
    options = reg_default_icp_options();
    options.start.translation.x = infinite;
    CHECK_RESULT(reg_icp(&model, &target, &options, &found, NULL, &error), SB_ERROR_NOT_FINITE);
    CHECK(memcmp(&found, &before, sizeof found) == 0);
}

static void test_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    reg_icp_options options = reg_default_icp_options();
    sb_vec3 points[30], moved[30];
    reg_rigid pose = turn(0.2, 0.1, 0.3), found;
    reg_icp_shape model, target;
    sb_error error;
    int needed;
    make_body();
    for (int i = 0; i < 30; i++)
        points[i] = body_points[50 * i];
    move(&pose, points, NULL, 30, moved, NULL);
    model = shape_of(points, NULL, 30);
    target = shape_of(moved, NULL, 30);
    options.allocator = scene_allocator(&memory);
    options.sample = 20;
    CHECK_OK(reg_icp(&model, &target, &options, &found, NULL, NULL));
    CHECK_INT(memory.live, 0);
    needed = memory.calls;
    for (int fail = 1; fail <= needed; fail++) {
        memory.calls = 0;
        memory.fail_at = fail;
        CHECK_RESULT(reg_icp(&model, &target, &options, &found, NULL, &error), SB_ERROR_MEMORY);
        CHECK_INT(memory.live, 0);
    }
}

/* ---- livers ---- */

static int load_liver(const char *name, reg_cloud *cloud)
{
    char path[512];
    sb_mesh mesh;
    int loaded;
    memset(&mesh, 0, sizeof mesh);
    if (!check_shared_path(path, sizeof path, name)) {
        CHECK_SKIP("no in silico data");
        return 0;
    }
    loaded = CHECK_OK(sb_mesh_load(&mesh, path, NULL, NULL)) && CHECK_OK(reg_cloud_from_mesh(cloud, &mesh, NULL, NULL));
    sb_mesh_free(&mesh);
    return loaded;
}

/* From any pose the same alignment as from where the organ was: mean distance below 2 mm, of a shape of 20 cm that has
 * deformed by 38 mm. */
static void liver_from_poses(const char *model_name, const char *target_name, reg_icp_overlap overlap, int poses)
{
    reg_cloud model, target, moved;
    reg_icp_options options = reg_default_icp_options();
    reg_rigid reference, found;
    reg_icp_info info;
    unsigned long long seed = 77;
    int good = 0;
    if (!load_liver(model_name, &model) || !load_liver(target_name, &target))
        return;
    options.overlap = overlap;
    if (CHECK_OK(reg_cloud_from_points(&moved, model.points, model.normals, model.count, NULL, NULL))) {
        reg_icp_shape from = shape_of(model.points, model.normals, model.count);
        reg_icp_shape to = shape_of(target.points, target.normals, target.count);
        options.search = 0;
        CHECK_OK(reg_icp(&from, &to, &options, &reference, &info, NULL));
        options.search = 1;
        from.points = moved.points;
        from.normals = moved.normals;
        for (int k = 0; k < poses; k++) {
            reg_rigid pose = random_pose(&seed, 0.115);
            move(&pose, model.points, model.normals, model.count, moved.points, moved.normals);
            if (!CHECK_OK(reg_icp(&from, &to, &options, &found, &info, NULL)))
                break;
            found = reg_rigid_compose(&found, &pose);
            good += gap(&reference, &found, model.points, model.count) < 2e-3;
        }
        CHECK_INT(good, poses);
        reg_cloud_free(&moved);
    }
    reg_cloud_free(&model);
    reg_cloud_free(&target);
}

static void test_livers(void)
{
    liver_from_poses("data/insilico/liver1/undeformed_surface.obj", "data/insilico/liver1/deformed_surface.obj",
                     REG_ICP_WHOLE, 1);
    liver_from_poses("data/insilico/liver2/undeformed_surface.obj", "data/insilico/liver2/deformed_surface.obj",
                     REG_ICP_WHOLE, 1);
    liver_from_poses("data/insilico/liver1/undeformed_surface.obj", "data/insilico/liver1/partial_deformed_surface.obj",
                     REG_ICP_TARGET_PART, 1);
    liver_from_poses("data/insilico/liver2/undeformed_surface.obj",
                     "data/insilico/liver2/partial_deformed_surface_noisy.obj", REG_ICP_TARGET_PART, 1);
}

CHECK_SUITE(icp, {"exact", test_exact}, {"no search", test_no_search}, {"part", test_part}, {"outliers", test_outliers},
            {"weights", test_weights}, {"landmarks", test_landmarks}, {"surface", test_surface}, {"caps", test_caps},
            {"degenerate", test_degenerate}, {"turned normals", test_turned_normals}, {"bad input", test_bad_input},
            {"memory", test_memory}, {"livers", test_livers});
