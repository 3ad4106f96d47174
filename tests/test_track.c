/* Tests of tracking: random organs that breathe and drift, of another mesh and law than the model's, seen in part, with
 * noise and drop-outs, beside the tracker of a rigid organ; landmarks and curves; the filter's closed forms; jumps,
 * losses, restarts; frames, threads, memory; saved states: the same bits afterwards, and what is refused. */
#define SB_SPLIT_BUILD
#include "../src/register/track_private.h"
#include "../src/softbody/base/bytes.h"

#include "check.h"
#include "organ_motion.h"

enum { SCAN = 600 };

/* ---- organs ---- */

/* A point of the fine mesh in the model's: rows of the fine nodes. */
static sb_embedding_rows rows_of(const motion *m)
{
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_embedding_rows rows;
    memset(&rows, 0, sizeof rows);
    def.mesh = &m->coarse;
    def.points = m->fine.nodes;
    def.point_count = m->fine.node_count;
    def.kind = SB_EMBED_PLAIN;
    def.max_distance = REAL(0.25 * m->size);
    if (CHECK_OK(sb_embedding_create(&def, &embedding, NULL)))
        CHECK_OK(sb_embedding_mapping(embedding, NULL, &rows, NULL));
    sb_embedding_destroy(embedding);
    return rows;
}

/* Mean distance (m) of the fine nodes from where the tracker has them. */
static double error_of(const motion *m, const sb_embedding_rows *rows, const reg_track *track)
{
    sb_vec3 *displacements = (sb_vec3 *)calloc((size_t)m->coarse.node_count, sizeof(sb_vec3));
    sb_vec3 *there = (sb_vec3 *)calloc((size_t)m->fine.node_count, sizeof(sb_vec3));
    double sum = 0;
    CHECK_OK(reg_track_displacements(track, displacements));
    sb_mapping_apply(&rows->mapping, displacements, there);
    for (int i = 0; i < m->fine.node_count; i++)
        sum += (double)sb_v3_norm(sb_v3_sub(sb_v3_add(m->fine.nodes[i], there[i]), m->now[i]));
    free(displacements);
    free(there);
    return sum / m->fine.node_count;
}

/* Half a breath and back in 3 s at 10 Hz, with a drop-out of 0.3 s; returns the mean error (m), and of what is to be
 * expected, over the frames with a scan. */
static double follow(motion *m, const sb_embedding_rows *rows, double motion_sd, double *expected)
{
    reg_track_def def = reg_default_track_def();
    reg_track *track = NULL;
    reg_track_info info;
    sb_vec3 points[SCAN];
    unsigned long long seed = 5;
    double sum = 0;
    int counted = 0;
    def.model = m->model;
    def.motion = REAL(motion_sd);
    *expected = 0;
    if (!CHECK_OK(reg_track_create(&def, &track, NULL)))
        return 0;
    for (int frame = 0; frame < 30; frame++) {
        reg_points target;
        memset(&target, 0, sizeof target);
        target.points = points;
        motion_move(m, 0.5 - 0.5 * cos(6.283 * frame / 30), sin(6.283 * frame / 50));
        target.count = motion_scan(m, &seed, sb_v3(0, 0, 1), 0.4, 0, 0.7e-3, SCAN, points);
        if (frame < 18 || frame > 20)
            CHECK_OK(reg_track_set_target(track, &target, NULL));
        CHECK_OK(reg_track_step(track, 0.1, &info));
        if (motion_sd == 0) /* to a rigid organ this looks like a jump */
            CHECK_INT(info.state, frame < 18 || frame > 20 ? REG_TRACK_FOLLOWS : REG_TRACK_PREDICTS);
        CHECK(info.expected > 0 && info.seen < REAL(0.8));
        if (frame < 3 || (frame >= 18 && frame < 23))
            continue;
        CHECK(info.seen > REAL(0.2) && info.used > REAL(0.7));
        sum += error_of(m, rows, track);
        *expected += (double)info.expected;
        counted++;
    }
    reg_track_destroy(track);
    *expected /= counted;
    return sum / counted;
}

/* An organ that is drawn by 3 % of its size over a wide part of it is followed, on the mean more closely than by a
 * tracker that knows of poses only, and never much worse. What is to be expected is of the size of what is. */
static void test_organs(void)
{
    int organs = check_quick() ? 1 : 2;
    double sums[2] = {0, 0};
    for (int k = 0; k < organs; k++) {
        motion m;
        if (motion_make(&m, 71 + (unsigned long long)k, k ? 0.03 : -0.03, 0.3, 0.08, NULL, NULL)) {
            sb_embedding_rows rows = rows_of(&m);
            double expected, none, elastic = follow(&m, &rows, 0, &expected);
            double rigid = follow(&m, &rows, 1e-6 * m.size, &none);
            CHECK(elastic < 1.1 * rigid && elastic < 0.012 * m.size);
            CHECK(expected > 0.5 * elastic && expected < 4 * elastic);
            sums[0] += elastic;
            sums[1] += rigid;
            sb_embedding_rows_free(&rows);
        }
        motion_free(&m);
    }
    CHECK(organs == 1 || sums[0] < sums[1]);
}

/* ---- landmarks and curves ---- */

enum { RIDGE = 12 };

/* What is known of an organ beside its surface: two vertices of its flanks, and a line of them below it, none of which
 * a view from above shows. */
typedef struct features {
    int marks[2], ridge[RIDGE]; /* vertices of what is seen */
    reg_landmark landmarks[2];
    sb_vec3 model[RIDGE], seen[RIDGE];
    reg_curve curve;
} features;

/* The vertex at rest that lies nearest to a direction from the middle. */
static int vertex_towards(const motion *m, sb_vec3 direction)
{
    int best = 0;
    double most = -2;
    for (int i = 0; i < m->seen.node_count; i++) {
        sb_vec3 x = m->seen.nodes[i];
        double along = (double)(sb_v3_dot(x, direction) / (sb_v3_norm(x) * sb_v3_norm(direction)));
        if (along > most) {
            most = along;
            best = i;
        }
    }
    return best;
}

static features make_features(const motion *m)
{
    features f;
    memset(&f, 0, sizeof f);
    for (int k = 0; k < 2; k++) {
        f.marks[k] = vertex_towards(m, sb_v3(k ? REAL(1) : REAL(-1), k ? REAL(0.5) : REAL(-0.3), REAL(-0.2)));
        f.landmarks[k].model = m->seen.nodes[f.marks[k]];
    }
    for (int k = 0; k < RIDGE; k++) {
        double angle = 3.14159265 * (0.15 + 0.7 * k / (RIDGE - 1));
        f.ridge[k] = vertex_towards(m, sb_v3(REAL(0.2), REAL(cos(angle)), REAL(-0.3 - sin(angle))));
        f.model[k] = m->seen.nodes[f.ridge[k]];
    }
    f.curve.model_count = RIDGE;
    return f;
}

/* Where they are now, to 0.7 mm; the ridge from the other end, and not all of it. which: 1 landmarks, 2 the curve, 3
 * both; the others count nothing. */
static void see_features(const motion *m, features *f, int which, unsigned long long *seed)
{
    f->curve.model = f->model;
    f->curve.seen = f->seen;
    f->curve.seen_count = RIDGE - 3;
    f->curve.sd = which & 2 ? REAL(0.7e-3) : (sb_real)INFINITY;
    for (int k = 0; k < 2 + RIDGE - 3; k++) {
        int vertex = k < 2 ? f->marks[k] : f->ridge[RIDGE - 1 - k];
        sb_vec3 *to = k < 2 ? &f->landmarks[k].seen : f->seen + k - 2;
        *to = sb_v3_add(m->seen_now[vertex], sb_v3(REAL(0.7e-3 * organ_gauss(seed)), REAL(0.7e-3 * organ_gauss(seed)),
                                                   REAL(0.7e-3 * organ_gauss(seed))));
    }
    for (int k = 0; k < 2; k++)
        f->landmarks[k].sd = which & 1 ? REAL(0.7e-3) : (sb_real)INFINITY;
}

/* How an organ is followed whose upper third is seen. */
typedef struct course {
    int which;      /* features seen, see_features */
    int hidden;     /* 1: the first landmark is not seen in every third frame, and the curve in every fourth */
    int wrong;      /* 1: the second landmark is seen 30 mm off in frames 10 to 14 */
    double error;   /* m: mean over frames and nodes */
    double late;    /* in frames 10 to 14 */
    double trusted; /* mean of frames 10 to 14 */
    double expected;
} course;

static void follow_features(motion *m, const sb_embedding_rows *rows, course *c)
{
    reg_track_def def = reg_default_track_def();
    reg_track *track = NULL;
    reg_track_info info;
    features f = make_features(m);
    sb_vec3 points[SCAN];
    unsigned long long seed = 5, other = 9;
    int counted = 0;
    c->error = c->late = c->trusted = c->expected = 0;
    def.model = m->model;
    def.landmarks = f.landmarks;
    def.landmark_count = 2;
    f.curve.model = f.model;
    def.curves = &f.curve;
    def.curve_count = 1;
    if (!CHECK_OK(reg_track_create(&def, &track, NULL)))
        return;
    for (int frame = 0; frame < 30; frame++) {
        reg_points target;
        double error;
        memset(&target, 0, sizeof target);
        target.points = points;
        motion_move(m, 0.5 - 0.5 * cos(6.283 * frame / 30), sin(6.283 * frame / 50));
        target.count = motion_scan(m, &seed, sb_v3(0, 0, 1), 0.55, 0, 0.7e-3, SCAN, points);
        CHECK_OK(reg_track_set_target(track, &target, NULL));
        see_features(m, &f, c->which, &other);
        if (c->hidden && frame % 3 == 1)
            f.landmarks[0].sd = (sb_real)INFINITY;
        if (c->hidden && frame % 4 == 2)
            f.curve.sd = (sb_real)INFINITY;
        if (c->wrong && frame >= 10 && frame < 15)
            f.landmarks[1].seen.y += REAL(0.03);
        CHECK_OK(reg_track_set_features(track, f.landmarks, &f.curve, NULL));
        CHECK_OK(reg_track_step(track, 0.1, &info));
        CHECK(c->which ? info.trusted > 0 && info.trusted <= 1 : info.trusted == 0);
        error = error_of(m, rows, track);
        if (frame >= 10 && frame < 15) {
            c->late += error / 5;
            c->trusted += (double)info.trusted / 5;
        }
        if (frame < 3)
            continue;
        c->error += error;
        c->expected += (double)info.expected;
        counted++;
    }
    reg_track_destroy(track);
    c->error /= counted;
    c->expected /= counted;
}

/* Two points of the flanks and a ridge below take a part of the error that a view of the upper third leaves: over ten
 * organs (CHECK_SLOW) from 2.30 to 1.77 mm on the mean, and none is worse for it; the landmarks alone to 1.87, the
 * ridge alone to 2.17. Features that are not seen in every frame do as well (1.82). One landmark of the two that is
 * taken for another place for half a second (30 mm off: what had drawn the organ along to 9 mm while it was believed)
 * costs 0.5 mm in these frames, 0.1 over all. Bounds leave a tenth to what the ten took. */
static void test_features(void)
{
    int organs = getenv("CHECK_SLOW") ? 10 : check_quick() ? 1 : 2;
    double sums[4] = {0, 0, 0, 0}, late[4] = {0, 0, 0, 0}, trusted = 0;
    for (int k = 0; k < organs; k++) {
        motion m;
        if (motion_make(&m, 171 + 7 * (unsigned long long)k, k % 2 ? 0.03 : -0.03, 0.3, 0.08, NULL, NULL)) {
            sb_embedding_rows rows = rows_of(&m);
            for (int i = 0; i < 4; i++) {
                course c;
                memset(&c, 0, sizeof c);
                c.which = i > 0 ? 3 : 0;
                c.hidden = i == 2;
                c.wrong = i == 3;
                follow_features(&m, &rows, &c);
                sums[i] += c.error;
                late[i] += c.late;
                CHECK(c.expected > 0.5 * c.error && c.expected < 4 * c.error);
                CHECK(i != 3 || c.trusted < trusted - 0.03);
                trusted = i == 1 ? c.trusted : trusted;
                if (getenv("CHECK_SLOW"))
                    printf("  organ %d, %s: %.2f mm (%.2f expected), %.2f in frames 10 to 14\n", k,
                           i == 0   ? "surface alone"
                           : i == 1 ? "features"
                           : i == 2 ? "now and then"
                                    : "a wrong one",
                           1e3 * c.error, 1e3 * c.expected, 1e3 * c.late);
            }
            sb_embedding_rows_free(&rows);
        }
        motion_free(&m);
    }
    CHECK(sums[1] < 0.85 * sums[0]);
    CHECK(sums[2] < 0.9 * sums[0] && sums[2] < 1.1 * sums[1]);
    CHECK(sums[3] < 1.15 * sums[1] && late[3] < 1.4 * late[1]);
}

/* ---- a box ---- */

typedef struct box {
    sb_mesh mesh;
    sb_boundary skin;
    reg_model *model;
    reg_track *track;
    sb_vec3 points[SCAN];
} box;

static int make_box(box *b, const sb_allocator *allocator, const sb_jobs *jobs)
{
    reg_model_def model = reg_default_model_def();
    reg_track_def def = reg_default_track_def();
    memset(b, 0, sizeof *b);
    b->mesh = scene_box(SB_TET4, 5, 4, 3, sb_v3(REAL(0.2), REAL(0.14), REAL(0.08)), 0);
    CHECK_OK(sb_mesh_boundary(&b->mesh, 1, NULL, &b->skin, NULL));
    model.mesh = &b->mesh;
    if (allocator)
        model.allocator = *allocator;
    if (jobs)
        model.jobs = *jobs;
    if (!CHECK_OK(reg_model_create(&model, &b->model, NULL)))
        return 0;
    def.model = b->model;
    def.modes = 12;
    def.patches = 60;
    def.misfit = REAL(1e-4);
    return CHECK_OK(reg_track_create(&def, &b->track, NULL));
}

static void free_box(box *b)
{
    reg_track_destroy(b->track);
    reg_model_destroy(b->model);
    sb_boundary_free(&b->skin);
    sb_mesh_free(&b->mesh);
}

/* Where the middles of the surface's triangles are: bent by `bend` (1/m) and moved. */
static reg_points scan_box(box *b, double bend, sb_vec3 way)
{
    const sb_mesh *skin = &b->skin.surface;
    reg_points target;
    memset(&target, 0, sizeof target);
    target.points = b->points;
    target.count = skin->element_count;
    CHECK(target.count <= SCAN);
    for (int e = 0; e < target.count; e++) {
        const int *c = skin->elements + 3 * e;
        sb_vec3 sum = sb_v3_add(skin->nodes[c[0]], sb_v3_add(skin->nodes[c[1]], skin->nodes[c[2]]));
        sb_vec3 x = sb_v3_scale(REAL(1.0 / 3), sum);
        double away = (double)x.x - 0.1;
        b->points[e] = sb_v3_add(way, sb_v3(x.x, x.y, x.z + REAL(bend * away * away)));
    }
    return target;
}

static void step_box(box *b, double bend, sb_vec3 way, reg_track_info *info)
{
    reg_points target = scan_box(b, bend, way);
    CHECK_OK(reg_track_set_target(b->track, &target, NULL));
    CHECK_OK(reg_track_step(b->track, 1.0 / 30, info));
}

/* Mean distance (m) of the nodes from the surface's shape. */
static double box_error(const box *b, double bend, sb_vec3 way)
{
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)b->mesh.node_count, sizeof *u);
    double sum = 0;
    CHECK_OK(reg_track_displacements(b->track, u));
    for (int i = 0; i < b->mesh.node_count; i++) {
        double away = (double)b->mesh.nodes[i].x - 0.1;
        sb_vec3 there = sb_v3_add(way, sb_v3(0, 0, REAL(bend * away * away)));
        sum += (double)sb_v3_norm(sb_v3_sub(u[i], there));
    }
    free(u);
    return sum / b->mesh.node_count;
}

/* A target that stays: the organ stays, and gaps that its few shapes cannot close are no jump, however often they are
 * larger than expected. */
static void test_still(void)
{
    box b;
    if (make_box(&b, NULL, NULL)) {
        sb_vec3 way = sb_v3(REAL(0.004), REAL(-0.003), REAL(0.002));
        reg_track_info info;
        double before = 0;
        for (int frame = 0; frame < 40; frame++) {
            step_box(&b, 0.4, way, &info);
            CHECK_INT(info.state, REG_TRACK_FOLLOWS);
            CHECK(info.innovation > REAL(1.5) && info.innovation < 6 && info.seen > REAL(0.95));
            before = frame == 19 ? box_error(&b, 0.4, way) : before;
        }
        CHECK(before < 1.2e-3);
        CHECK_NEAR(box_error(&b, 0.4, way), before, 2e-4);
    }
    free_box(&b);
}

/* The posterior of a Gaussian model: its covariance is the inverse of what the rows tell and what was known before, of
 * the pose by the covariance that time left, of the amounts by their scale. */
static void test_posterior(void)
{
    box b;
    if (make_box(&b, NULL, NULL)) {
        reg_track *t = b.track;
        reg_track_info info;
        int n = t->unknowns, q = t->def.modes;
        double worst = 0;
        for (int frame = 0; frame < 2; frame++)
            step_box(&b, 0.3, sb_v3(REAL(0.002), 0, 0), &info);
        for (int k = 0; k < n; k++)
            for (int l = 0; l < n; l++) {
                double sum = 0;
                for (int j = 0; j < n; j++) {
                    double told = j < k ? t->information[j * n + k] : t->information[k * n + j];
                    if (k >= q && j >= q)
                        told += t->pose_precision[(k - q) * REGI_TRACK_POSE + j - q];
                    else if (k == j)
                        told += 1 / (t->known.scale * t->known.scale);
                    sum += told * t->known.covariance[j * n + l];
                }
                worst = fmax(worst, fabs(sum - (k == l)));
            }
        CHECK(worst < 1e-6);
    }
    free_box(&b);
}

/* Without a target the amounts go back to the prior of their scale as a process of Ornstein and Uhlenbeck does, and the
 * pose wanders: covariances are those of the closed form, also in two steps for one. */
static void test_forgets(void)
{
    box b[2];
    if (make_box(b, NULL, NULL) && make_box(b + 1, NULL, NULL)) {
        reg_track *t = b[0].track;
        reg_track_info info;
        int n = t->unknowns, q = t->def.modes;
        double *before = (double *)malloc((size_t)(n * n) * sizeof *before), kept = exp(-0.2), mean;
        for (int k = 0; k < 2; k++)
            step_box(b + k, 0.3, sb_v3(0, 0, 0), &info);
        memcpy(before, t->known.covariance, (size_t)(n * n) * sizeof *before);
        mean = t->known.mean[0];
        CHECK_OK(reg_track_step(t, 0.2, &info));
        CHECK_INT(info.state, REG_TRACK_PREDICTS);
        CHECK_NEAR(t->known.mean[0], kept * mean, 1e-12 * fabs(mean));
        for (int k = 0; k < n; k++)
            for (int l = 0; l < n; l++) {
                double rate = (double)(k < q + 3 ? t->def.wander : t->def.turn);
                double square = t->known.scale * t->known.scale,
                       grown = k < q ? (1 - kept * kept) * square : 0.2 * rate * rate;
                double exact = (k < q ? kept : 1) * (l < q ? kept : 1) * before[k * n + l] + (k == l ? grown : 0);
                CHECK_NEAR(t->known.covariance[k * n + l], exact, 1e-9 * (square + fabs(exact)));
            }
        CHECK_OK(reg_track_step(b[1].track, 0.1, NULL));
        CHECK_OK(reg_track_step(b[1].track, 0.1, NULL));
        for (int k = 0; k < n * n; k++)
            CHECK_NEAR(t->known.covariance[k], b[1].track->known.covariance[k], 1e-9);
        free(before);
    }
    free_box(b);
    free_box(b + 1);
}

/* Covariances are symmetric, positive, and their mean trace is the square of the error to expect. */
static void test_covariances(void)
{
    box b;
    if (make_box(&b, NULL, NULL)) {
        reg_track_info info;
        sb_mat3 *c = (sb_mat3 *)calloc((size_t)b.mesh.node_count, sizeof *c), inverse;
        double sum = 0;
        for (int frame = 0; frame < 3; frame++)
            step_box(&b, 0.5, sb_v3(0, 0, REAL(0.002)), &info);
        CHECK_OK(reg_track_covariances(b.track, c));
        for (int i = 0; i < b.mesh.node_count; i++) {
            sum += (double)sb_m3_trace(c[i]) / b.mesh.node_count;
            CHECK(sb_m3_spd_inverse(c[i], &inverse) == 0);
            CHECK(sb_abs(c[i].m[0][1] - c[i].m[1][0]) <= 100 * SB_EPSILON * sb_m3_trace(c[i]));
        }
        CHECK_NEAR(sqrt(sum), info.expected, 1e-4 * (double)info.expected);
        free(c);
    }
    free_box(&b);
}

/* ---- jumps, losses, restarts ---- */

/* Jumps: of a fifth of the thickness, of more than a third and sideways, and of most of it, where points look like
 * another surface's: each is followed, or known for a jump, within three frames, and caught up with in the next six. */
static void test_jump(void)
{
    const double ways[3][3] = {{0.003, 0.002, 0.016}, {0.03, 0.02, 0.03}, {0.05, 0.03, 0.07}};
    int jumps = 0;
    for (int k = 0; k < 3; k++) {
        sb_vec3 way = sb_v3(REAL(ways[k][0]), REAL(ways[k][1]), REAL(ways[k][2]));
        box b;
        if (make_box(&b, NULL, NULL)) {
            reg_track_info info;
            int caught = -1, found = -1;
            for (int frame = 0; frame < 10; frame++) {
                step_box(&b, 0, sb_v3(0, 0, 0), &info);
                CHECK_INT(info.state, REG_TRACK_FOLLOWS);
            }
            for (int frame = 0; frame < 9; frame++) {
                step_box(&b, 0, way, &info);
                found = found < 0 && info.state == REG_TRACK_JUMPED ? frame : found;
                caught = caught < 0 && box_error(&b, 0, way) < 1e-3 ? frame : caught;
            }
            jumps += found >= 0;
            CHECK((caught >= 0 && caught < 3) || (found >= 0 && found < 3));
            CHECK(box_error(&b, 0, way) < 1e-3);
        }
        free_box(&b);
    }
    CHECK(jumps > 0);
}

/* Gone for longer than half a second it is lost; a start from an inference finds it again. */
static void test_lost(void)
{
    box b;
    if (make_box(&b, NULL, NULL)) {
        sb_vec3 away = sb_v3(REAL(0.1), REAL(-0.05), REAL(0.05));
        reg_track_info info;
        reg_infer_def def = reg_default_infer_def();
        reg_infer *infer = NULL;
        sb_real before;
        step_box(&b, 0, sb_v3(0, 0, 0), &info);
        before = info.expected;
        for (int frame = 0; frame < 14; frame++)
            CHECK_OK(reg_track_step(b.track, 1.0 / 30, &info));
        CHECK_INT(info.state, REG_TRACK_PREDICTS);
        CHECK_OK(reg_track_step(b.track, 0.1, &info));
        CHECK_INT(info.state, REG_TRACK_LOST);
        CHECK_NEAR(info.blind, 14.0 / 30 + 0.1, 1e-9);
        CHECK(info.expected > 2 * before);
        def.model = b.model;
        def.target = scan_box(&b, 0.3, away);
        def.start.translation = away;
        def.samples = 60;
        if (CHECK_OK(reg_infer_run(&def, &infer, NULL)) && CHECK_OK(reg_track_restart(b.track, infer, NULL))) {
            for (int frame = 0; frame < 3; frame++)
                step_box(&b, 0.3, away, &info);
            CHECK_INT(info.state, REG_TRACK_FOLLOWS);
            CHECK(box_error(&b, 0.3, away) < 1.5e-3);
        }
        reg_infer_destroy(infer);
        before = REAL(box_error(&b, 0.3, away));
        CHECK_OK(reg_track_restart(b.track, NULL, NULL)); /* about where it is */
        CHECK_NEAR(box_error(&b, 0.3, away), before, 1e-5);
    }
    free_box(&b);
}

/* ---- what must not matter ---- */

/* In another frame everything is the same there. */
static void test_frames(void)
{
    sb_vec3 *u[2];
    box b;
    reg_rigid pose = reg_rigid_identity();
    pose.rotation = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(1, REAL(-0.5), REAL(0.7))));
    pose.translation = sb_v3(REAL(0.3), REAL(-0.2), REAL(0.1));
    for (int k = 0; k < 2; k++) {
        reg_track_def def = reg_default_track_def();
        reg_track *track = NULL;
        if (!make_box(&b, NULL, NULL))
            return;
        u[k] = (sb_vec3 *)calloc((size_t)b.mesh.node_count, sizeof(sb_vec3));
        def.model = b.model;
        def.modes = 12;
        def.pose = k ? pose : reg_rigid_identity();
        if (CHECK_OK(reg_track_create(&def, &track, NULL))) {
            for (int frame = 0; frame < 5; frame++) {
                reg_points target = scan_box(&b, 0.1 * frame, sb_v3(REAL(0.001 * frame), 0, 0));
                for (int i = 0; k && i < target.count; i++)
                    b.points[i] = reg_rigid_apply(&pose, b.points[i]);
                CHECK_OK(reg_track_set_target(track, &target, NULL));
                CHECK_OK(reg_track_step(track, 1.0 / 30, NULL));
            }
            CHECK_OK(reg_track_displacements(track, u[k]));
        }
        reg_track_destroy(track);
        if (k == 1)
            for (int i = 0; i < b.mesh.node_count; i++) {
                sb_vec3 here = reg_rigid_apply(&pose, sb_v3_add(b.mesh.nodes[i], u[0][i]));
                sb_vec3 off = sb_v3_sub(here, sb_v3_add(b.mesh.nodes[i], u[1][i]));
                CHECK((double)sb_v3_norm(off) < (sizeof(sb_real) == 8 ? 1e-9 : 1e-3));
            }
        free_box(&b);
    }
    free(u[0]);
    free(u[1]);
}

/* A target replaced by itself, refused targets and steps, and any number of threads: the same bits. */
static void test_bits(void)
{
    unsigned long long hash[3] = {0, 1, 2};
    for (int k = 0; k < 3; k++) {
        int workers = k == 2 ? 3 : 1;
        sb_jobs jobs = scene_jobs(&workers);
        box b;
        if (make_box(&b, NULL, &jobs)) {
            size_t bytes = (size_t)b.mesh.node_count * sizeof(sb_vec3);
            sb_vec3 *u = (sb_vec3 *)calloc(1, bytes);
            reg_track_info info;
            for (int frame = 0; frame < 4; frame++) {
                if (k == 1) {
                    reg_points bad, target = scan_box(&b, 0.1 * frame, sb_v3(0, 0, 0));
                    CHECK_OK(reg_track_set_target(b.track, &target, NULL));
                    bad = target;
                    bad.count = 2001;
                    CHECK_INT(reg_track_set_target(b.track, NULL, NULL), SB_ERROR_ARGUMENT);
                    bad.count = 0;
                    CHECK_INT(reg_track_set_target(b.track, &bad, NULL), SB_ERROR_ARGUMENT);
                    CHECK_INT(reg_track_step(b.track, 0, &info), SB_ERROR_ARGUMENT);
                    CHECK(info.error.message[0] != 0);
                }
                step_box(&b, 0.1 * frame, sb_v3(0, 0, 0), &info);
            }
            CHECK_OK(reg_track_displacements(b.track, u));
            hash[k] = scene_hash(u, bytes);
            free(u);
        }
        free_box(&b);
    }
    CHECK(hash[0] == hash[1] && hash[0] == hash[2]);
}

/* ---- saved states ---- */

static unsigned char *save(const reg_track *track, size_t *size)
{
    unsigned char *bytes;
    *size = reg_track_save_size(track);
    bytes = (unsigned char *)malloc(*size);
    CHECK_OK(reg_track_save(track, bytes, *size));
    return bytes;
}

/* Takes in what waits, goes on for some frames, one of them without a target, and tells of all that came out. */
static unsigned long long go_on(box *b, int restarts)
{
    size_t nodes = (size_t)b->mesh.node_count;
    sb_vec3 *u = (sb_vec3 *)calloc(nodes, sizeof *u);
    sb_mat3 *covariances = (sb_mat3 *)calloc(nodes, sizeof *covariances);
    reg_track_info info;
    unsigned long long hash = 0;
    CHECK_OK(reg_track_step(b->track, 1.0 / 30, &info));
    for (int frame = 0; frame < 4; frame++) {
        if (frame == 2)
            CHECK_OK(reg_track_step(b->track, 1.0 / 30, &info));
        else
            step_box(b, 0.3 + 0.1 * frame, sb_v3(0, REAL(1e-3) * (sb_real)frame, 0), &info);
        if (frame == 1 && restarts)
            CHECK_OK(reg_track_restart(b->track, NULL, NULL));
        CHECK_OK(reg_track_displacements(b->track, u));
        hash = 31 * hash + scene_hash(u, nodes * sizeof *u) + scene_hash(&info.expected, sizeof info.expected);
    }
    CHECK_OK(reg_track_covariances(b->track, covariances));
    hash = 31 * hash + scene_hash(covariances, nodes * sizeof *covariances);
    free(covariances);
    free(u);
    return hash;
}

/* Brings the box to a state in the middle: a few frames, perhaps a restart, and a target that waits. */
static void begin(box *b, int restart)
{
    reg_track_info info;
    reg_points target;
    for (int frame = 0; frame < 3; frame++)
        step_box(b, 0.1 * frame, sb_v3(0, 0, 0), &info);
    if (restart)
        CHECK_OK(reg_track_restart(b->track, NULL, NULL));
    target = scan_box(b, 0.3, sb_v3(0, 0, 0));
    target.has_camera = 1;
    target.camera = sb_v3(REAL(0.1), REAL(0.07), 1);
    CHECK_OK(reg_track_set_target(b->track, &target, NULL));
}

/* What follows a load follows it bit for bit: in the same tracker, after a restart that changed its shapes, and in
 * another one; nothing is allocated. */
static void test_state(void)
{
    for (int restart = 0; restart < 2; restart++) {
        scene_memory memory = {0, 0, 0, 0};
        sb_allocator allocator = scene_allocator(&memory);
        box b, other;
        int made = make_box(&b, &allocator, NULL), both = make_box(&other, NULL, NULL) && made;
        if (both) {
            size_t size, again;
            unsigned char *bytes, *back;
            unsigned long long first, second;
            begin(&b, restart);
            memory.calls = 0;
            memory.fail_at = 1;
            bytes = save(b.track, &size);
            first = go_on(&b, 1);
            CHECK_OK(reg_track_load(b.track, bytes, size, NULL));
            back = save(b.track, &again);
            CHECK(size == again && memcmp(back, bytes, size) == 0);
            second = go_on(&b, 1);
            CHECK_INT(memory.calls, 0);
            CHECK(first == second);
            CHECK_OK(reg_track_load(other.track, bytes, size, NULL));
            CHECK(go_on(&other, 1) == first);
            free(back);
            free(bytes);
        }
        free_box(&other);
        free_box(&b);
        CHECK_INT(memory.live, 0);
    }
}

/* What is refused changes nothing. */
static void refuse(const box *b, const unsigned char *bytes, size_t size, sb_result wanted)
{
    size_t own, after;
    unsigned char *before = save(b->track, &own), *now;
    sb_error error;
    CHECK_RESULT(reg_track_load(b->track, bytes, size, &error), wanted);
    CHECK(error.message[0] != 0);
    now = save(b->track, &after);
    CHECK(own == after && memcmp(before, now, own) == 0);
    free(now);
    free(before);
}

/* One byte or number of a state changed at a place of the content, checksum and all. */
static void forge(const box *b, unsigned char *bytes, size_t size, size_t at, uint64_t value, int width,
                  sb_result wanted)
{
    unsigned char kept[8];
    memcpy(kept, bytes + SBI_IMAGE_HEAD + at, sizeof kept);
    sbi_put_bytes(bytes + SBI_IMAGE_HEAD + at, value, width);
    sbi_image_seal(bytes, size, "REGTRACK", 2);
    refuse(b, bytes, size, wanted);
    memcpy(bytes + SBI_IMAGE_HEAD + at, kept, sizeof kept);
    sbi_image_seal(bytes, size, "REGTRACK", 2);
}

static void test_forged(void)
{
    box b;
    if (make_box(&b, NULL, NULL)) {
        size_t size, real = sizeof(sb_real), content, target, make = 8 + 3 * 4 + 8 + 7 * sizeof(sb_real);
        unsigned char *bytes;
        begin(&b, 0);
        bytes = save(b.track, &size);
        content = size - SBI_IMAGE_HEAD - SBI_IMAGE_TAIL;
        target = content - (size_t)b.track->incoming_count * 8 * real - 3 * 4 - 3 * real;
        for (size_t cut = 0; cut < size; cut += cut < 200 ? 1 : size / 50)
            refuse(&b, bytes, cut, SB_ERROR_FORMAT);
        for (size_t at = SBI_IMAGE_HEAD; at < size; at += 1 + size / 60) {
            bytes[at] ^= 0x10;
            refuse(&b, bytes, size, SB_ERROR_FORMAT);
            bytes[at] ^= 0x10;
        }
        forge(&b, bytes, size, 0, 1, 8, SB_ERROR_STATE);                           /* another model */
        forge(&b, bytes, size, 8 + 4, 13, 4, SB_ERROR_STATE);                      /* other modes */
        forge(&b, bytes, size, make, 0x7FF8000000000000u, 8, SB_ERROR_NOT_FINITE); /* a mean */
        forge(&b, bytes, size, make, 0x7FF0000000000000u, 8, SB_ERROR_NOT_FINITE);
        forge(&b, bytes, size, target, 2, 4, SB_ERROR_FORMAT);                          /* waiting */
        forge(&b, bytes, size, target, 0, 4, SB_ERROR_FORMAT);                          /* and more behind it */
        forge(&b, bytes, size, target + 4, 2, 4, SB_ERROR_FORMAT);                      /* a camera */
        forge(&b, bytes, size, target + 8 + 3 * real, 0xFFFFFFFFu, 4, SB_ERROR_FORMAT); /* points */
        forge(&b, bytes, size, target + 8 + 3 * real, 1999, 4, SB_ERROR_FORMAT);
        for (size_t back = 1; back < 3; back++) /* surprises, frames that search wide: before arms and modes */
            forge(&b, bytes, size, target - (size_t)b.mesh.node_count * 13 * 3 * real - 4 * back, 99, 4,
                  SB_ERROR_FORMAT);
        CHECK_RESULT(reg_track_load(NULL, bytes, size, NULL), SB_ERROR_ARGUMENT);
        CHECK_RESULT(reg_track_load(b.track, NULL, size, NULL), SB_ERROR_ARGUMENT);
        CHECK_RESULT(reg_track_save(b.track, bytes, size - 1), SB_ERROR_ARGUMENT);
        CHECK_RESULT(reg_track_save(NULL, bytes, size), SB_ERROR_ARGUMENT);
        CHECK(reg_track_save_size(NULL) == 0);
        CHECK_OK(reg_track_load(b.track, bytes, size, NULL));
        free(bytes);
    }
    free_box(&b);
}

/* ---- landmarks and curves of a box ---- */

/* Features alone, without a target, are followed as well: three landmarks and more hold the pose. What is seen in other
 * units, or no number, is refused by its index and changes nothing; what is not seen is not looked at. */
static void test_landmarks(void)
{
    box b;
    if (make_box(&b, NULL, NULL)) {
        reg_landmark marks[4];
        reg_curve curve;
        reg_track_def def = reg_default_track_def();
        reg_track *track = NULL;
        reg_track_info info;
        sb_error error;
        sb_vec3 way = sb_v3(REAL(0.004), REAL(-0.003), REAL(0.002)), line[2], seen[2];
        memset(marks, 0, sizeof marks);
        memset(&curve, 0, sizeof curve);
        for (int k = 0; k < 4; k++)
            marks[k].model = sb_v3(k & 1 ? REAL(0.2) : 0, k & 2 ? REAL(0.14) : 0, k == 3 ? REAL(0.08) : REAL(0.01));
        line[0] = sb_v3(0, REAL(0.07), REAL(0.04));
        line[1] = sb_v3(REAL(0.2), REAL(0.07), REAL(0.04));
        curve.model = line;
        curve.model_count = 2;
        def.model = b.model;
        def.modes = 12;
        def.misfit = REAL(1e-4);
        def.landmarks = marks;
        def.landmark_count = 4;
        def.curves = &curve;
        def.curve_count = 1;
        if (CHECK_OK(reg_track_create(&def, &track, &error))) {
            for (int frame = 0; frame < 6; frame++) {
                for (int k = 0; k < 4; k++) {
                    marks[k].seen = sb_v3_add(marks[k].model, way);
                    marks[k].sd = frame == 3 && k == 2 ? (sb_real)INFINITY : REAL(1e-4);
                }
                for (int k = 0; k < 2; k++)
                    seen[k] = sb_v3_add(line[1 - k], sb_v3_add(way, sb_v3(REAL(0.01), 0, 0)));
                curve.seen = seen;
                curve.seen_count = 2;
                curve.sd = REAL(1e-4);
                if (frame == 4)
                    curve.seen = NULL, curve.sd = (sb_real)INFINITY;
                CHECK_OK(reg_track_set_features(track, marks, &curve, &error));
                CHECK_OK(reg_track_step(track, 1.0 / 30, &info));
                CHECK_INT(info.state, REG_TRACK_FOLLOWS);
                CHECK(info.blind == 0 && info.seen == 0 && info.used == 0);
            }
            b.track = (reg_track_destroy(b.track), track);
            CHECK(box_error(&b, 0, way) < 2e-4);
            marks[2].seen.y = (sb_real)NAN;
            CHECK_INT(reg_track_set_features(track, marks, &curve, &error), SB_ERROR_NOT_FINITE);
            CHECK_INT(error.node, 2);
            marks[2].sd = (sb_real)INFINITY;
            CHECK_OK(reg_track_set_features(track, marks, &curve, &error));
            marks[3].sd = -1;
            CHECK_INT(reg_track_set_features(track, marks, &curve, &error), SB_ERROR_ARGUMENT);
            CHECK_INT(error.node, 3);
            marks[3].sd = REAL(0.1);
            marks[3].seen = sb_v3(200, 140, 80); /* millimetres */
            CHECK_INT(reg_track_set_features(track, marks, &curve, &error), SB_ERROR_ARGUMENT);
            CHECK(error.node == 3 && strstr(error.message, "landmark 3") != NULL);
            marks[3].seen = marks[3].model;
            curve.seen = seen;
            curve.sd = 0;
            CHECK_INT(reg_track_set_features(track, marks, &curve, &error), SB_ERROR_ARGUMENT);
            CHECK(strstr(error.message, "curve 0") != NULL);
            CHECK_INT(reg_track_set_features(track, NULL, &curve, &error), SB_ERROR_ARGUMENT);
            CHECK_INT(reg_track_set_features(track, marks, NULL, &error), SB_ERROR_ARGUMENT);
            CHECK_OK(reg_track_step(track, 1.0 / 30, &info)); /* what had been accepted before is still there */
            CHECK_INT(info.state, REG_TRACK_FOLLOWS);
            CHECK_OK(reg_track_step(track, 1.0 / 30, &info));
            CHECK(info.state == REG_TRACK_PREDICTS && info.trusted == 0);
            track = NULL;
            marks[1].model = sb_v3(REAL(0.5), 0, 0); /* off the organ */
            CHECK(reg_track_create(&def, &track, &error) != SB_OK && track == NULL);
        }
    }
    free_box(&b);
}

/* Where the organ's box is when a tracker with marks has seen a frame with some of them, as bits. */
static unsigned long long see_and_go(reg_track *track, const box *b)
{
    size_t bytes = (size_t)b->mesh.node_count * sizeof(sb_vec3);
    sb_vec3 *u = (sb_vec3 *)calloc(1, bytes);
    unsigned long long hash;
    CHECK_OK(reg_track_step(track, 1.0 / 30, NULL));
    CHECK_OK(reg_track_step(track, 1.0 / 30, NULL));
    CHECK_OK(reg_track_displacements(track, u));
    hash = scene_hash(u, bytes);
    free(u);
    return hash;
}

/* Features that wait are part of a saved tracker, for one that has the same; nothing is allocated. */
static void test_marked_state(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    box b;
    if (make_box(&b, &allocator, NULL)) {
        reg_landmark marks[2];
        sb_vec3 line[3];
        reg_curve curve = {line, 3, line, 3, REAL(1e-3)};
        reg_track_def def = reg_default_track_def();
        reg_track *tracks[3] = {NULL, NULL, NULL};
        memset(marks, 0, sizeof marks);
        for (int k = 0; k < 3; k++)
            line[k] = sb_v3(REAL(0.1 * k), REAL(0.14), REAL(0.08));
        marks[1].model = sb_v3(REAL(0.2), 0, REAL(0.04));
        def.model = b.model;
        def.modes = 12;
        def.landmarks = marks;
        def.landmark_count = 2;
        def.curves = &curve;
        def.curve_count = 1;
        for (int k = 0; k < 3; k++) {
            marks[0].model.x = k == 2 ? REAL(0.05) : 0;
            CHECK_OK(reg_track_create(&def, tracks + k, NULL));
        }
        for (int k = 0; k < 2; k++) {
            marks[k].seen = sb_v3_add(marks[k].model, sb_v3(REAL(0.003), 0, REAL(0.005)));
            marks[k].sd = k ? REAL(2e-3) : (sb_real)INFINITY;
        }
        if (tracks[0] && tracks[1] && tracks[2]) {
            size_t size;
            unsigned char *bytes;
            unsigned long long hash, plain = see_and_go(tracks[1], &b);
            memory.calls = 0;
            CHECK_OK(reg_track_set_features(tracks[0], marks, &curve, NULL));
            CHECK_OK(reg_track_set_features(tracks[1], marks, &curve, NULL));
            bytes = save(tracks[0], &size);
            hash = see_and_go(tracks[0], &b);
            CHECK(hash != plain);
            CHECK_OK(reg_track_load(tracks[1], bytes, size, NULL));
            CHECK(see_and_go(tracks[1], &b) == hash);
            CHECK_OK(reg_track_load(tracks[0], bytes, size, NULL));
            CHECK(see_and_go(tracks[0], &b) == hash);
            CHECK_INT(memory.calls, 0);
            CHECK_RESULT(reg_track_load(tracks[2], bytes, size, NULL), SB_ERROR_STATE); /* another landmark */
            CHECK_RESULT(reg_track_load(b.track, bytes, size, NULL), SB_ERROR_STATE);   /* none */
            for (size_t cut = 1; cut < 300; cut += 7)
                CHECK_RESULT(reg_track_load(tracks[0], bytes, size - cut, NULL), SB_ERROR_FORMAT);
            check_bad_numbers();
            for (size_t at = size - SBI_IMAGE_TAIL - 4 * 200; at < size - SBI_IMAGE_TAIL; at += 4) { /* no crash */
                unsigned char kept[4];
                memcpy(kept, bytes + at, 4);
                sbi_put_bytes(bytes + at, 0x7FFFFFFF, 4);
                sbi_image_seal(bytes, size, "REGTRACK", 2);
                (void)reg_track_load(tracks[1], bytes, size, NULL);
                memcpy(bytes + at, kept, 4);
            }
            free(bytes);
        }
        for (int k = 0; k < 3; k++)
            reg_track_destroy(tracks[k]);
    }
    free_box(&b);
    CHECK_INT(memory.live, 0);
}

/* ---- refusals, memory ---- */

static void test_refusals(void)
{
    box b;
    if (make_box(&b, NULL, NULL)) {
        reg_track_def def = reg_default_track_def();
        reg_track *track = NULL;
        reg_points target = scan_box(&b, 0, sb_v3(0, 0, 0));
        sb_error error;
        CHECK_INT(reg_track_create(&def, &track, &error), SB_ERROR_ARGUMENT); /* no model */
        def.model = b.model;
        def.modes = 97;
        CHECK_INT(reg_track_create(&def, &track, &error), SB_ERROR_ARGUMENT);
        def.modes = 4;
        def.memory = 0;
        CHECK_INT(reg_track_create(&def, &track, &error), SB_ERROR_ARGUMENT);
        def.memory = 1;
        def.pose.rotation.m[0][0] = 2;
        CHECK_INT(reg_track_create(&def, &track, &error), SB_ERROR_ARGUMENT);
        def.pose = reg_rigid_identity();
        def.most_points = 10;
        CHECK_INT(reg_track_create(&def, NULL, &error), SB_ERROR_ARGUMENT);
        CHECK(track == NULL);
        CHECK_OK(reg_track_create(&def, &track, &error));
        CHECK_INT(reg_track_set_target(track, &target, &error), SB_ERROR_ARGUMENT); /* too many */
        target.count = 10;
        b.points[7].y = (sb_real)NAN;
        CHECK_INT(reg_track_set_target(track, &target, &error), SB_ERROR_NOT_FINITE);
        CHECK_INT(error.node, 7);
        target.points = NULL;
        target.surface = &b.skin.surface;
        CHECK_INT(reg_track_set_target(track, &target, &error), SB_ERROR_ARGUMENT);
        CHECK(strcmp(reg_track_state_string(REG_TRACK_JUMPED), "jumped") == 0);
        check_bad_numbers();
        for (int k = 0; k < 3; k++) { /* a step that fails does not say that it follows */
            reg_track_info info;
            CHECK_INT(reg_track_step(track, k ? -1 : (double)NAN, k < 2 ? &info : NULL), SB_ERROR_ARGUMENT);
            CHECK(k == 2 || (info.state == REG_TRACK_PREDICTS && info.error.message[0]));
        }
        reg_track_destroy(track);
    }
    free_box(&b);
}

static void test_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    sb_result result = SB_ERROR_MEMORY;
    box b;
    if (make_box(&b, &allocator, NULL)) {
        reg_track_def def = reg_default_track_def();
        reg_track_info info;
        int frames = getenv("CHECK_SLOW") ? 10000 : 300;
        const sb_vec3 line[2] = {{0, 0, 0}, {REAL(0.2), 0, 0}};
        const reg_landmark mark = {{REAL(0.2), 0, 0}, {0, 0, 0}, 1};
        const reg_curve curve = {line, 2, NULL, 0, 1};
        def.model = b.model;
        def.modes = 4;
        def.landmarks = &mark;
        def.landmark_count = 1;
        def.curves = &curve;
        def.curve_count = 1;
        for (int fail = 1, before = (int)memory.live; result == SB_ERROR_MEMORY && fail < 100; fail++) {
            reg_track *track = NULL;
            memory.calls = 0;
            memory.fail_at = fail;
            result = reg_track_create(&def, &track, NULL);
            CHECK(result == SB_OK || result == SB_ERROR_MEMORY);
            CHECK((track != NULL) == (result == SB_OK));
            memory.fail_at = 0;
            reg_track_destroy(track);
            CHECK_INT(memory.live, before);
        }
        CHECK_OK(result);
        memory.calls = 0;
        for (int frame = 0; frame < frames; frame++)
            step_box(&b, 0.3 * sin(0.2 * frame), sb_v3(0, 0, 0), &info);
        CHECK_INT(memory.calls, 0);
        CHECK_OK(reg_track_restart(b.track, NULL, NULL));
        CHECK_INT(memory.calls, 0);
    }
    free_box(&b);
    CHECK_INT(memory.live, 0);
}

CHECK_SUITE(track, {"organs", test_organs}, {"features", test_features}, {"landmarks", test_landmarks},
            {"marked state", test_marked_state}, {"still", test_still}, {"posterior", test_posterior},
            {"forgets", test_forgets}, {"covariances", test_covariances}, {"jump", test_jump}, {"lost", test_lost},
            {"frames", test_frames}, {"bits", test_bits}, {"state", test_state}, {"forged states", test_forged},
            {"refusals", test_refusals}, {"memory", test_memory});
