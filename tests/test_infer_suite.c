/* Tests of registration on what instruments give: lines that a probe swabbed, sheets of ultrasound, a scan with a
 * fragment of another organ, normals that point inwards. Random organs of another mesh and law than the model's, drawn
 * by up to 6 % of their size and a little out of place: a rigid start, then an inference. */
#include "check.h"
#include "organ_motion.h"

enum { MOST = 4000, CLASSES = 4, SWABBED = 400 };
typedef enum suite_class { SWAB = 0, SHEETS = 1, FRAGMENT = 2, TURNED = 3 } suite_class;
static const char *const class_names[CLASSES] = {"swab", "sheets", "fragment", "turned normals"};

/* What was seen. */
typedef struct seen {
    sb_vec3 points[MOST], normals[MOST];
    int count, has_normals;
} seen;

static void add_point(seen *s, sb_vec3 at, double noise, unsigned long long *seed)
{
    if (s->count < MOST)
        s->points[s->count++] = sb_v3_add(at, sb_v3(REAL(noise * organ_gauss(seed)), REAL(noise * organ_gauss(seed)),
                                                    REAL(noise * organ_gauss(seed))));
}

/* Where a plane cuts the surface, above a height. */
static void add_cut(const motion *m, seen *s, sb_vec3 normal, double offset, double above, double noise,
                    unsigned long long *seed)
{
    for (int e = 0; e < m->seen.element_count; e++)
        for (int k = 0; k < 3; k++) {
            int a = m->seen.elements[3 * e + k], b = m->seen.elements[3 * e + (k + 1) % 3];
            double from = (double)sb_v3_dot(normal, m->seen_now[a]) - offset;
            double to = (double)sb_v3_dot(normal, m->seen_now[b]) - offset;
            sb_vec3 x;
            if (a > b || from * to >= 0) /* each edge once */
                continue;
            x = sb_v3_madd(m->seen_now[a], REAL(from / (from - to)), sb_v3_sub(m->seen_now[b], m->seen_now[a]));
            if ((double)x.z > above)
                add_point(s, x, noise, seed);
        }
}

/* 400 points of ten lines over the upper half. */
static void see_swab(const motion *m, double middle, seen *s, unsigned long long *seed)
{
    for (int line = 0; line < 10; line++) {
        double d[3];
        organ_direction(seed, d);
        add_cut(m, s, sb_v3(REAL(d[0]), REAL(d[1]), REAL(0.3 * d[2])), check_random_in(seed, -0.03, 0.03), middle,
                0.7e-3, seed);
    }
    for (int i = 0; i < s->count && i < SWABBED; i++) { /* at random */
        int other = i + (int)check_random_in(seed, 0, s->count - i) % (s->count - i);
        sb_vec3 kept = s->points[i];
        s->points[i] = s->points[other];
        s->points[other] = kept;
    }
    s->count = s->count < SWABBED ? s->count : SWABBED;
}

/* Six sheets that a probe was tilted through: outlines of the organ, all but its lowest third. */
static void see_sheets(const motion *m, double middle, double height, seen *s, unsigned long long *seed)
{
    for (int sheet = 0; sheet < 6; sheet++) {
        double tilt = 0.15 * (sheet - 2.5);
        add_cut(m, s, sb_v3(REAL(cos(tilt)), REAL(0.2), REAL(sin(tilt))), 0.03 * (sheet - 2.5), middle - height / 6,
                1.5e-3, seed);
    }
}

/* A view from above, and beside it a piece of another organ, a quarter as many points. */
static void see_fragment(const motion *m, double middle, seen *s, unsigned long long *seed)
{
    unsigned long long other = *seed + 1;
    organ o = organ_make(&other, 0.12, 1, 0);
    int of_organ;
    sb_vec3 top = m->seen_now[0], shift;
    s->count = motion_scan(m, seed, sb_v3(0, 0, 1), 0.5, 0, 1e-3, 800, s->points);
    (void)middle;
    of_organ = s->count;
    for (int i = 0; i < m->seen.node_count; i++)
        top = m->seen_now[i].z > top.z ? m->seen_now[i] : top;
    shift = sb_v3_add(top, sb_v3(REAL(check_random_in(seed, 0.03, 0.06)), REAL(check_random_in(seed, -0.04, 0.04)),
                                 REAL(check_random_in(seed, 0.06, 0.08))));
    while (s->count < of_organ + of_organ / 4) { /* its lower side, which faces the organ */
        double d[3];
        organ_direction(seed, d);
        d[2] = d[2] > 0 ? -d[2] : d[2];
        if (d[2] < -0.5)
            add_point(s, sb_v3_add(shift, organ_point(&o, sb_v3(REAL(d[0]), REAL(d[1]), REAL(d[2])))), 1e-3, seed);
    }
}

/* A view from above whose normals point inwards. */
static void see_turned(const motion *m, double middle, seen *s, unsigned long long *seed)
{
    sb_vec3 *normals = (sb_vec3 *)calloc((size_t)m->seen.node_count, sizeof(sb_vec3));
    for (int e = 0; e < m->seen.element_count; e++) {
        const int *c = m->seen.elements + 3 * e;
        const sb_vec3 *x = m->seen_now;
        sb_vec3 normal = sb_v3_cross(sb_v3_sub(x[c[1]], x[c[0]]), sb_v3_sub(x[c[2]], x[c[0]]));
        for (int k = 0; k < 3; k++)
            normals[c[k]] = sb_v3_add(normals[c[k]], normal);
    }
    for (int i = 0; i < m->seen.node_count; i++)
        if ((double)m->seen_now[i].z > middle && normals[i].z > 0) {
            s->normals[s->count] = sb_v3_scale(-1 / sb_v3_norm(normals[i]), normals[i]);
            add_point(s, m->seen_now[i], 0.7e-3, seed);
        }
    s->has_normals = 1;
    free(normals);
}

static void see(const motion *m, suite_class kind, seen *s, unsigned long long *seed)
{
    double low = 1e30, high = -1e30;
    for (int i = 0; i < m->seen.node_count; i++) {
        low = fmin(low, (double)m->seen_now[i].z);
        high = fmax(high, (double)m->seen_now[i].z);
    }
    s->count = s->has_normals = 0;
    switch (kind) {
    case SWAB: see_swab(m, 0.5 * (low + high), s, seed); break;
    case SHEETS: see_sheets(m, 0.5 * (low + high), high - low, s, seed); break;
    case FRAGMENT: see_fragment(m, 0.5 * (low + high), s, seed); break;
    default: see_turned(m, 0.5 * (low + high), s, seed); break;
    }
}

/* ---- registration ---- */

static sb_result start_of(const motion *m, const seen *s, reg_rigid *start, reg_icp_info *info)
{
    reg_icp_options options = reg_default_icp_options();
    reg_icp_shape shapes[2];
    reg_cloud cloud;
    sb_surface *tree = NULL;
    sb_result result;
    memset(shapes, 0, sizeof shapes);
    memset(&cloud, 0, sizeof cloud);
    memset(info, 0, sizeof *info);
    *start = reg_rigid_identity();
    CHECK_OK(sb_surface_create(&m->outline, NULL, &tree, NULL));
    CHECK_OK(reg_cloud_from_mesh(&cloud, &m->outline, NULL, NULL));
    shapes[0].points = cloud.points;
    shapes[0].normals = cloud.normals;
    shapes[0].count = cloud.count;
    shapes[0].surface = tree;
    shapes[1].points = s->points;
    shapes[1].normals = s->has_normals ? s->normals : NULL;
    shapes[1].count = s->count;
    options.search = 0;
    options.overlap = REG_ICP_TARGET_PART;
    result = reg_icp(shapes, shapes + 1, &options, start, info, NULL);
    reg_cloud_free(&cloud);
    sb_surface_destroy(tree);
    return result;
}

/* Mean error (m) over the fine nodes. */
static double error_of(const motion *m, const sb_vec3 *moved)
{
    double sum = 0;
    for (int i = 0; i < m->fine.node_count; i++)
        sum += (double)sb_v3_norm(sb_v3_sub(moved[i], m->now[i])) / m->fine.node_count;
    return sum;
}

typedef struct outcome {
    double start, error, expected, seen; /* m, share */
    unsigned warnings;                   /* of both */
} outcome;

static int run_case(motion *m, suite_class kind, unsigned long long seed, outcome *out)
{
    static seen s;
    reg_infer_def def = reg_default_infer_def();
    reg_infer *infer = NULL;
    reg_icp_info info;
    reg_quality quality;
    sb_vec3 *moved = (sb_vec3 *)calloc((size_t)m->fine.node_count, sizeof *moved);
    int good;
    see(m, kind, &s, &seed);
    good = CHECK_OK(start_of(m, &s, &def.start, &info));
    for (int i = 0; i < m->fine.node_count; i++)
        moved[i] = reg_rigid_apply(&def.start, m->fine.nodes[i]);
    out->start = error_of(m, moved);
    out->warnings = info.warnings;
    if (kind == TURNED && (info.warnings & REG_WARN_INVERTED)) /* as the start says: so the caller turns them */
        for (int i = 0; i < s.count; i++)
            s.normals[i] = sb_v3_scale(-1, s.normals[i]);
    def.model = m->model;
    def.target.points = s.points;
    def.target.normals = s.has_normals ? s.normals : NULL;
    def.target.count = s.count;
    def.samples = 150;
    if (good && CHECK_OK(reg_infer_run(&def, &infer, NULL)) &&
        CHECK_OK(reg_infer_covariance(infer, m->fine.nodes, m->fine.node_count, moved, NULL, NULL)) &&
        CHECK_OK(reg_infer_get_quality(infer, &quality))) {
        out->error = error_of(m, moved);
        out->expected = (double)quality.expected;
        out->seen = (double)quality.seen;
        out->warnings |= quality.warnings;
    } else {
        good = 0;
    }
    reg_infer_destroy(infer);
    free(moved);
    return good;
}

/* Of all of them: not farther off than the start by more than a tenth, what is to be expected of the size of the error,
 * and what is off by more than 5 mm says that it may be, so that the limit of 5 mm stops it. Normals that point inwards
 * are found to, and no others are. Measured (CHECK_SLOW, five organs; tests/verification.md): 1.00 times the start at
 * most, 0.71 to 1.9 times the error expected. What is gained is little but where there are normals: by motions of 9 to
 * 18 mm, which lines and sheets hardly tell. */
static void test_suite(void)
{
    const double most[CLASSES] = {1, 1, 1, 0.8}; /* of the start's, over five organs: 0.94, 0.99, 0.96, 0.71 */
    int organs = getenv("CHECK_SLOW") ? 5 : 1;
    double sums[CLASSES][2];
    memset(sums, 0, sizeof sums);
    for (int k = 0; k < organs; k++) {
        motion m;
        unsigned long long seed = 900 + (unsigned long long)k;
        double depth = check_random_in(&seed, 0.03, 0.06) * (k % 2 ? 1 : -1), reach = check_random_in(&seed, 0.1, 0.3);
        if (motion_make(&m, 4000 + 19 * (unsigned long long)k, depth, reach, 0.08, NULL, NULL)) {
            motion_move(&m, 1, check_random_in(&seed, -1, 1));
            for (int c = 0; c < CLASSES; c++) {
                outcome out;
                memset(&out, 0, sizeof out);
                if (!run_case(&m, (suite_class)c, seed, &out))
                    continue;
                CHECK(out.error < 1.1 * out.start);
                CHECK(out.expected > 0.5 * out.error && out.expected < 2.5 * out.error);
                CHECK(out.error < 5e-3 || out.expected > 5e-3);
                CHECK(((out.warnings & REG_WARN_INVERTED) != 0) == (c == TURNED));
                CHECK(out.seen > 0.15 && out.seen < 0.75);
                sums[c][0] += out.error;
                sums[c][1] += out.start;
                if (organs > 1)
                    printf("  organ %d, %-14s: start %.2f mm, inference %.2f (%.2f expected), seen %.2f\n", k,
                           class_names[c], 1e3 * out.start, 1e3 * out.error, 1e3 * out.expected, out.seen);
            }
        }
        motion_free(&m);
    }
    for (int c = 0; c < CLASSES; c++)
        CHECK(organs == 1 || sums[c][0] < most[c] * sums[c][1]);
}

CHECK_SUITE(infer_suite, {"classes", test_suite});
