/* Tests of the search for poses and of what reg_icp says of its result: random organs and views that nobody chose. */
#include "organ_views.h"

/* ---- random organs, all classes of views ----------------------------------------------------------------------- */

typedef struct pose_class {
    const char *name;
    organ_view_def view;
    double bumps, odd, deformed;
    int as_mesh, camera;
    int misses; /* of a hundred, beside one */
} pose_class;

static const pose_class classes[] = {
    {"whole", {0, 0, 0, 0, ORGAN_NORMALS_RIGHT, 0, 0.2}, 0.15, 1, 0.004, 1, 0, 0},
    {"whole, inside out", {0, 0, 0, 0, ORGAN_NORMALS_TURNED, 0, 0.2}, 0.15, 1, 0.004, 1, 0, 0},
    {"whole, points, noise", {0, 0.003, 0, 0, ORGAN_NORMALS_RIGHT, 0, 0.2}, 0.15, 1, 0.004, 0, 0, 0},
    {"half", {0.5, 0.001, 0, 0, ORGAN_NORMALS_RIGHT, 0, 0.2}, 0.15, 1, 0.004, 1, 0, 0},
    {"30 %", {0.3, 0.001, 0, 0, ORGAN_NORMALS_RIGHT, 0, 0.2}, 0.15, 1, 0.004, 0, 0, 0},
    {"30 %, noise", {0.3, 0.003, 0, 0, ORGAN_NORMALS_RIGHT, 0, 0.2}, 0.15, 1, 0.004, 0, 0, 0},
    {"30 %, outliers", {0.3, 0.001, 0.3, 0, ORGAN_NORMALS_RIGHT, 0, 0.2}, 0.15, 1, 0.004, 0, 0, 0},
    {"30 %, a neighbour", {0.3, 0.001, 0, 0.3, ORGAN_NORMALS_RIGHT, 0, 0.2}, 0.15, 1, 0.004, 0, 0, 0},
    {"30 %, bare", {0.3, 0.001, 0, 0, ORGAN_NORMALS_NONE, 0, 0.2}, 0.15, 1, 0.004, 0, 0, 0},
    {"30 %, bare, camera", {0.3, 0.001, 0, 0, ORGAN_NORMALS_NONE, 0, 0.2}, 0.15, 1, 0.004, 0, 1, 0},
    {"30 %, turned", {0.3, 0.001, 0, 0, ORGAN_NORMALS_TURNED, 0, 0.2}, 0.15, 1, 0.004, 0, 0, 0},
    {"10 %", {0.1, 0.0005, 0, 0, ORGAN_NORMALS_RIGHT, 40, 0.2}, 0.15, 1, 0.002, 0, 0, 14},
    {"nearly symmetric, half", {0.5, 0.0005, 0, 0, ORGAN_NORMALS_RIGHT, 0, 0.2}, 0.12, 0.12, 0.004, 0, 0, 0},
    {"nearly symmetric, 30 %", {0.3, 0.0005, 0, 0, ORGAN_NORMALS_RIGHT, 0, 0.2}, 0.12, 0.12, 0.004, 0, 0, 0},
};

/* An organ's model and a view of it, as reg_icp takes them. */
typedef struct pose_case {
    organ body;
    sb_mesh model;
    reg_cloud cloud;
    sb_surface *skin, *seen;
    organ_view view;
    reg_icp_shape from, to;
    reg_icp_options options;
} pose_case;

static void free_case(pose_case *made)
{
    organ_view_free(&made->view);
    sb_surface_destroy(made->skin);
    sb_surface_destroy(made->seen);
    reg_cloud_free(&made->cloud);
    sb_mesh_free(&made->model);
}

static int make_case(unsigned long long seed, const pose_class *kind, pose_case *made)
{
    reg_rigid turned;
    memset(made, 0, sizeof *made);
    made->body = organ_make(&seed, kind->bumps, kind->odd, kind->deformed);
    turned = organ_pose(&seed, 1);
    if (!organ_surface(&made->body, kind->view.cells == 14 ? 9 : 20, &turned.rotation, 0, &made->model) ||
        !organ_view_make(&seed, &made->body, &kind->view, &made->view) ||
        !CHECK_OK(reg_cloud_from_mesh(&made->cloud, &made->model, NULL, NULL)) ||
        !CHECK_OK(sb_surface_create(&made->model, NULL, &made->skin, NULL)))
        return 0;
    if (kind->as_mesh && !CHECK_OK(sb_surface_create(&made->view.mesh, NULL, &made->seen, NULL)))
        return 0;
    made->from.points = made->cloud.points;
    made->from.normals = made->cloud.normals;
    made->from.count = made->cloud.count;
    made->from.surface = made->skin;
    made->to.points = made->view.points;
    made->to.normals = made->view.normals;
    made->to.count = made->view.count;
    made->to.surface = made->seen;
    made->to.has_camera = kind->camera;
    made->to.camera = made->view.camera;
    made->options = reg_default_icp_options();
    made->options.overlap = kind->view.share > 0 ? REG_ICP_TARGET_PART : REG_ICP_WHOLE;
    return 1;
}

/* Mean distance (m) of the model's nodes from where they really are. */
static double case_error(const pose_case *made, const reg_rigid *found)
{
    double sum = 0;
    for (int i = 0; i < made->model.node_count; i++) {
        sb_vec3 truth = reg_rigid_apply(&made->view.pose, organ_deform(&made->body, made->model.nodes[i]));
        sum += (double)sb_v3_norm(sb_v3_sub(truth, reg_rigid_apply(found, made->model.nodes[i])));
    }
    return sum / made->model.node_count;
}

/* The error from in place, which deformation leaves: -1 where that fails. */
static double error_in_place(const pose_case *made)
{
    reg_icp_options options = made->options;
    reg_rigid found;
    options.search = 0;
    options.start = made->view.pose;
    return CHECK_OK(reg_icp(&made->from, &made->to, &options, &found, NULL, NULL)) ? case_error(made, &found) : -1;
}

/* From any pose the error of in place, within 1 mm, or a pose with that among those of an ambiguous result. */
static int is_right(const pose_case *made, const reg_rigid *found, const reg_icp_info *info)
{
    double most = error_in_place(made) + 1e-3;
    if (case_error(made, found) < most)
        return 1;
    for (int i = 1; i < info->pose_count && info->warnings & REG_WARN_AMBIGUOUS; i++)
        if (case_error(made, info->poses + i) < most)
            return 1;
    return 0;
}

/* One organ a class; with CHECK_SLOW in the environment a hundred, of which 99 have to be right: 85 where a tenth is
 * seen. */
static void test_organs(void)
{
    int rounds = getenv("CHECK_SLOW") ? 100 : 1;
    for (int c = 0; c < (int)(sizeof classes / sizeof classes[0]); c++) {
        int right = 0, flagged = 0;
        for (int k = 0; k < rounds; k++) {
            pose_case made;
            reg_rigid found;
            reg_icp_info info;
            if (make_case(1000 * (unsigned long long)c + (unsigned long long)k + 17, classes + c, &made) &&
                CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &found, &info, NULL))) {
                right += is_right(&made, &found, &info);
                flagged += info.warnings & REG_WARN_AMBIGUOUS ? 1 : 0;
                CHECK(info.pose_count >= 1 && memcmp(&found, info.poses, sizeof found) == 0);
                CHECK(classes[c].view.normals != ORGAN_NORMALS_TURNED || info.warnings & REG_WARN_INVERTED);
            }
            free_case(&made);
        }
        if (rounds > 1)
            printf("%s: %d of %d right, %d flagged ambiguous\n", classes[c].name, right, rounds, flagged);
        CHECK(right >= rounds - rounds / 100 - classes[c].misses * rounds / 100);
    }
}

/* ---- what decides between equals ------------------------------------------------------------------------------- */

/* Half a turn repeats the organ: two poses, neither better. Where it was seen from tells, and so does a rough start,
 * though either is 20 degrees off. */
static void test_symmetric(void)
{
    static const pose_class twin = {"", {0.3, 0.0003, 0, 0, ORGAN_NORMALS_RIGHT, 0, 0.2}, 0.12, 0, 0, 0, 0, 0};
    static const double off[3] = {0.2, -0.2, 0.2};
    sb_mat3 wrong = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(REAL(off[0]), REAL(off[1]), REAL(off[2]))));
    for (int k = 0; k < 3; k++) {
        pose_case made;
        reg_rigid found;
        reg_icp_info info;
        if (make_case(40 + (unsigned long long)k, &twin, &made)) {
            CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &found, &info, NULL));
            CHECK(info.warnings & REG_WARN_AMBIGUOUS && info.margin < 3 && info.pose_count >= 2);
            CHECK(case_error(&made, info.poses) < 1e-3 || case_error(&made, info.poses + 1) < 1e-3);
            CHECK(case_error(&made, info.poses) > 0.05 || case_error(&made, info.poses + 1) > 0.05);
            made.options.seen_from = sb_m3_apply(wrong, made.view.seen_from);
            made.options.seen_from_sd = REAL(0.2);
            CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &found, &info, NULL));
            if ((double)sb_abs(made.view.seen_from.z) < 0.85) { /* from nearly along the axis both look alike */
                CHECK(case_error(&made, &found) < 1e-3);
                CHECK(!(info.warnings & REG_WARN_AMBIGUOUS) && info.margin >= 3);
            }
            made.options.seen_from_sd = 0;
            made.options.start = made.view.pose;
            made.options.start.rotation = sb_m3_mul(wrong, made.view.pose.rotation);
            made.options.start.translation.x += REAL(0.02);
            made.options.start_turn_sd = REAL(0.3);
            made.options.start_shift_sd = REAL(0.05);
            CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &found, &info, NULL));
            CHECK(case_error(&made, &found) < 1e-3);
            CHECK(!(info.warnings & REG_WARN_AMBIGUOUS));
        }
        free_case(&made);
    }
}

/* ---- warnings -------------------------------------------------------------------------------------------------- */

/* Normals towards the camera on one half of the points, away from it on the other: they are made anew. */
static void test_mixed_normals(void)
{
    static const pose_class view = {"", {0.4, 0.0005, 0, 0, ORGAN_NORMALS_RIGHT, 0, 0.2}, 0.15, 1, 0.003, 0, 1, 0};
    pose_case made;
    reg_rigid found;
    reg_icp_info info;
    if (make_case(7, &view, &made)) {
        double most = error_in_place(&made) + 1e-3;
        CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &found, &info, NULL));
        CHECK(info.warnings == 0);
        for (int i = 0; i < made.view.count; i += 2)
            made.view.normals[i] = sb_v3_scale(-1, made.view.normals[i]);
        CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &found, &info, NULL));
        CHECK(case_error(&made, &found) < most);
        CHECK(info.warnings == REG_WARN_MIXED_NORMALS);
        for (int i = 1; i < made.view.count; i += 2)
            made.view.normals[i] = sb_v3_scale(-1, made.view.normals[i]);
        CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &found, &info, NULL));
        CHECK(case_error(&made, &found) < most);
        CHECK(info.warnings == REG_WARN_INVERTED);
    }
    free_case(&made);
}

/* Files in millimetres, inches and metres: the factor is named, whichever side it is on, of a view, too. */
static void test_units(void)
{
    static const double units[3] = {1000, 1e-3, 39.37};
    for (int k = 0; k < 6; k++) {
        pose_class kind = classes[k < 3 ? 0 : 3];
        pose_case made;
        reg_rigid found;
        reg_icp_info info;
        kind.as_mesh = 0;
        kind.view.cells = 14;
        if (make_case(3, &kind, &made)) {
            CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &found, &info, NULL));
            CHECK(!(info.warnings & REG_WARN_SCALE) && info.scale_guess == 1);
            for (int i = 0; i < made.view.count; i++)
                made.view.points[i] = sb_v3_scale(REAL(units[k % 3]), made.view.points[i]);
            CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &found, &info, NULL));
            CHECK(info.warnings & REG_WARN_SCALE);
            if (k < 5) /* how large a view is to be nobody knows: inches and millimetres of it are too near */
                CHECK_NEAR((double)info.scale_guess * units[k % 3], 1, 1e-3);
        }
        free_case(&made);
    }
    CHECK(strcmp(reg_warning_string(REG_WARN_SCALE), "scale") == 0);
}

/* A plate with a tower towards the camera, which saw the plate alone, the tower's foot included. */
static void test_free_space(void)
{
    enum { SIDE = 25, TOWER = 400 };
    static sb_vec3 model[SIDE * SIDE + TOWER], normals[SIDE * SIDE + TOWER];
    reg_icp_options options = reg_default_icp_options();
    reg_icp_shape from, to;
    reg_icp_info info;
    reg_rigid found;
    int count = SIDE * SIDE;
    for (int i = 0; i < count; i++) {
        double x = 0.008 * (i % SIDE - SIDE / 2), y = 0.008 * (i / SIDE - SIDE / 2);
        model[i] = sb_v3(REAL(x), REAL(y), REAL(2 * x * y + x * x));
        normals[i] = sb_v3(0, 0, 1);
    }
    for (int i = 0; i < TOWER; i++) {
        double a = 2.4 * i;
        model[count + i] = sb_v3(REAL(0.02 * cos(a)), REAL(0.02 * sin(a)), REAL(0.02 + 0.0002 * i));
        normals[count + i] = sb_v3(REAL(cos(a)), REAL(sin(a)), 0);
    }
    memset(&from, 0, sizeof from);
    from.points = model;
    from.normals = normals;
    from.count = count + TOWER;
    to = from;
    to.count = count;
    to.camera = sb_v3(0, 0, REAL(0.4));
    options.overlap = REG_ICP_TARGET_PART;
    options.search = 0;
    for (int camera = 0; camera < 2; camera++) {
        to.has_camera = camera;
        CHECK_OK(reg_icp(&from, &to, &options, &found, &info, NULL));
        CHECK_INT(info.warnings & REG_WARN_FREE_SPACE, camera ? REG_WARN_FREE_SPACE : 0);
        CHECK(!(info.warnings & REG_WARN_INVERTED));
    }
}

/* ---- covariance ------------------------------------------------------------------------------------------------ */

/* The turn about the centre and the shift that lead from the truth to a pose. */
static void pose_deviation(const reg_rigid *found, const reg_rigid *truth, sb_vec3 centre, double deviation[6])
{
    reg_rigid back = reg_rigid_inverse(truth), off = reg_rigid_compose(found, &back);
    sb_vec3 shift = sb_v3_sub(reg_rigid_apply(&off, centre), centre);
    deviation[0] = ((double)off.rotation.m[2][1] - (double)off.rotation.m[1][2]) / 2;
    deviation[1] = ((double)off.rotation.m[0][2] - (double)off.rotation.m[2][0]) / 2;
    deviation[2] = ((double)off.rotation.m[1][0] - (double)off.rotation.m[0][1]) / 2;
    deviation[3] = (double)shift.x;
    deviation[4] = (double)shift.y;
    deviation[5] = (double)shift.z;
}

/* Independent noise, 400 draws: along the six principal directions of the predicted covariance the poses scatter as it
 * says: within 10 % in the mean of the six, each within three deviations of what 400 draws tell. */
static void test_covariance(void)
{
    static const pose_class view = {"", {0.4, 0, 0, 0, ORGAN_NORMALS_RIGHT, 14, 0.2}, 0.15, 1, 0, 0, 0, 0};
    enum { DRAWS = 400 };
    unsigned long long seed = 99;
    double square[6] = {0, 0, 0, 0, 0, 0}, predicted[6] = {0, 0, 0, 0, 0, 0}, mean = 0;
    pose_case made;
    sb_vec3 *clean;
    if (!make_case(12, &view, &made))
        return;
    clean = (sb_vec3 *)malloc((size_t)made.view.count * sizeof *clean);
    for (int i = 0; clean && i < made.view.count;
         i++) { /* onto the model's own facets, so that noise is all there is */
        sb_surface_hit hit;
        reg_rigid back = reg_rigid_inverse(&made.view.pose);
        CHECK(sb_surface_closest(made.skin, reg_rigid_apply(&back, made.view.points[i]), SB_REAL_MAX, &hit));
        clean[i] = reg_rigid_apply(&made.view.pose, hit.point);
    }
    made.options.search = 0;
    made.options.start = made.view.pose;
    made.options.tolerance = REAL(1e-4);
    made.options.outliers = REG_OUTLIERS_NONE;
    for (int k = 0; clean && k < DRAWS; k++) {
        reg_rigid found;
        reg_icp_info info;
        double off[6];
        for (int i = 0; i < made.view.count; i++)
            made.view.points[i] =
                sb_v3_add(clean[i], sb_v3(REAL(5e-4 * organ_gauss(&seed)), REAL(5e-4 * organ_gauss(&seed)),
                                          REAL(5e-4 * organ_gauss(&seed))));
        if (!CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &found, &info, NULL)))
            break;
        pose_deviation(&found, &made.view.pose, info.centre, off);
        for (int i = 0; i < 6; i++) {
            square[i] += off[i] * off[i] / (int)DRAWS;
            predicted[i] += (double)info.covariance[7 * i] / (int)DRAWS;
        }
        CHECK(!(info.warnings & REG_WARN_LOW_CONTRAST));
    }
    for (int i = 0; i < 6; i++) {
        mean += square[i] / predicted[i] / 6;
        CHECK_NEAR(square[i] / predicted[i], 1, 3 * sqrt(2.0 / (int)DRAWS));
    }
    CHECK_NEAR(mean, 1, 0.1);
    free(clean);
    free_case(&made);
}

/* A sphere turns freely: all three turns are as unknown as before, all three shifts well known. A plate: one turn and
 * two shifts. */
static void test_low_contrast(void)
{
    enum { COUNT = 1500 };
    static sb_vec3 points[COUNT], noisy[COUNT], normals[COUNT];
    unsigned long long seed = 6;
    for (int plate = 0; plate < 2; plate++) {
        reg_icp_options options = reg_default_icp_options();
        reg_icp_shape from, to;
        reg_icp_info info;
        reg_rigid found;
        memset(&from, 0, sizeof from);
        for (int i = 0; i < COUNT; i++) {
            double z = 1 - (2 * i + 1.0) / (int)COUNT, a = 2.399963229728653 * i,
                   r = plate ? sqrt((i + 0.5) / (int)COUNT) : 0;
            r = plate ? r : sqrt(1 - z * z);
            normals[i] = plate ? sb_v3(0, 0, 1) : sb_v3(REAL(r * cos(a)), REAL(r * sin(a)), REAL(z));
            points[i] = sb_v3(REAL(0.1 * r * cos(a)), REAL(0.1 * r * sin(a)), plate ? 0 : REAL(0.1 * z));
            noisy[i] = sb_v3_madd(points[i], REAL(1e-3 * organ_gauss(&seed)), normals[i]);
        }
        from.points = points;
        from.normals = normals;
        from.count = COUNT;
        to = from;
        to.points = noisy;
        options.search = 0;
        options.overlap = REG_ICP_TARGET_PART;
        CHECK_OK(reg_icp(&from, &to, &options, &found, &info, NULL));
        CHECK(info.warnings & REG_WARN_LOW_CONTRAST);
        for (int i = 0; i < 6; i++) {
            double sd = sqrt((double)info.covariance[7 * i]);
            int known = plate ? i == 0 || i == 1 || i == 5 : i >= 3;
            CHECK_NEAR(log10(sd), known ? -4 : 0, 1.2);
        }
        CHECK_NEAR((double)info.noise, 1e-3, 1e-4);
    }
}

/* ---- weights --------------------------------------------------------------------------------------------------- */

/* A patch that moved by itself, ten times over or ten times as unsure: as if it were there once, or hardly. */
static void test_duplicates(void)
{
    static const pose_class view = {"", {0, 0, 0, 0, ORGAN_NORMALS_RIGHT, 12, 0}, 0.15, 1, 0, 0, 0, 0};
    pose_case made;
    reg_rigid once, often, unsure;
    sb_vec3 *points;
    sb_real *sd;
    int n, patch = 0;
    if (!make_case(5, &view, &made))
        return;
    n = made.view.count;
    points = (sb_vec3 *)malloc((size_t)n * 10 * sizeof *points);
    sd = (sb_real *)malloc((size_t)n * sizeof *sd);
    made.options.search = 0;
    made.options.outliers = REG_OUTLIERS_NONE;
    made.options.overlap = REG_ICP_TARGET_PART;
    made.options.sample = 0;
    made.to.normals = NULL;
    made.to.surface = NULL;
    if (CHECK(points && sd)) {
        memcpy(points, made.view.points, (size_t)n * sizeof *points);
        for (int i = 0; i < n; i++) {
            int moved = points[i].x > REAL(0.05);
            sd[i] = moved ? REAL(0.1) : REAL(0.001);
            points[i].z += moved ? REAL(0.004) : 0;
            patch += moved;
        }
        for (int i = 0, at = n; i < n; i++)
            for (int k = 0; k < 9 && sd[i] > REAL(0.01); k++)
                points[at++] = points[i];
        made.to.points = points;
        CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &once, NULL, NULL));
        made.to.count = n + 9 * patch;
        CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &often, NULL, NULL));
        made.to.count = n;
        made.to.sd = sd;
        CHECK_OK(reg_icp(&made.from, &made.to, &made.options, &unsure, NULL, NULL));
        CHECK(case_error(&made, &once) > 2e-4);
        CHECK_NEAR(case_error(&made, &often), case_error(&made, &once), 0.05 * case_error(&made, &once));
        CHECK(case_error(&made, &unsure) < 0.3 * case_error(&made, &once));
    }
    free(points);
    free(sd);
    free_case(&made);
}

CHECK_SUITE(pose, {"organs", test_organs}, {"symmetric", test_symmetric}, {"mixed normals", test_mixed_normals},
            {"units", test_units}, {"free space", test_free_space}, {"covariance", test_covariance},
            {"low contrast", test_low_contrast}, {"duplicates", test_duplicates});
