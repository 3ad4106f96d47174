/* pose: the search for poses, and how they are weighed. */
#include "icp_private.h"

enum {
    REGI_POSE_ROTATIONS = 160, /* of the search, the turns of principal axes onto each other included */
    REGI_POSE_STAGES = 4,
    REGI_POSE_PROBES = 24 /* points that tell how far apart two poses are */
};

/* ==== candidates ================================================================================================== */

/* The i-th of n evenly spread rotations: super-Fibonacci spiral (Alexa 2022). */
static sb_mat3 regi_pose_spiral(int i, int n)
{
    const double pi2 = 6.283185307179586;
    double s = i + 0.5, r = sqrt(s / n), q = sqrt(1 - s / n);
    sb_real sa, ca, sb, cb;
    sb_sin_cos((sb_real)fmod(pi2 * s / 1.4142135623730951, pi2), &sa, &ca);
    sb_sin_cos((sb_real)fmod(pi2 * s / 1.533751168755204288, pi2), &sb, &cb);
    return sb_quat_to_mat3(
        sb_quat_normalise(sb_quat_make((sb_real)q * cb, (sb_real)r * sa, (sb_real)r * ca, (sb_real)q * sb)));
}

/* The i-th of the 24 turns of a cube onto itself; the first four keep the axes. */
static sb_mat3 regi_pose_cube(int i)
{
    static const unsigned char order[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    sb_mat3 turn = sb_m3_zero();
    int permutation = i / 4;
    for (int row = 0; row < 3; row++)
        turn.m[row][order[permutation][row]] = row < 2 ? (i >> row & 1 ? (sb_real)-1 : 1) : 1;
    if (sb_m3_det(turn) < 0)
        for (int column = 0; column < 3; column++)
            turn.m[2][column] = -turn.m[2][column];
    return turn;
}

/* A rotation with the translation that puts a's centre onto that of the part of b that looks a's way. */
static reg_rigid regi_pose_place(const regi_icp *icp, sb_mat3 rotation, sb_vec3 facing)
{
    const regi_icp_set *set = &icp->b.spread;
    sb_vec3 direction = sb_m3_apply(rotation, facing), seen = sb_v3(0, 0, 0);
    sb_real least = (sb_real)0.1 * sb_v3_norm(direction);
    reg_rigid motion;
    int count = 0;
    for (int i = 0; i < set->count && least > 0; i++)
        if (sb_v3_dot(set->normals[i], direction) > least)
            seen = sb_v3_madd(seen, 1 / (sb_real)++count, sb_v3_sub(set->points[i], seen));
    if (count == 0)
        seen = icp->b.centre;
    motion.rotation = rotation;
    motion.translation = sb_v3_sub(seen, sb_m3_apply(rotation, icp->a.centre));
    return motion;
}

static void regi_pose_add(regi_pose *poses, int *count, reg_rigid motion, int flip)
{
    memset(poses + *count, 0, sizeof poses[0]);
    poses[*count].motion = motion;
    poses[(*count)++].flip = flip;
}

/* All poses to try, after the caller's own and that of the landmarks; not those that the caller rules out by more than
 * three deviations. */
static int regi_pose_candidates(const regi_icp *icp, const reg_rigid *start, regi_pose *poses)
{
    const sb_real between_rotations = (sb_real)0.6; /* rad: the next of the spiral's is not farther off */
    const reg_icp_options *options = icp->options;
    int count = 0, spirals = REGI_POSE_ROTATIONS - 24, flips = icp->a.unsure || icp->b.unsure ? 2 : 1;
    sb_vec3 facing = icp->both ? sb_v3(0, 0, 0) : regi_icp_facing(&icp->a.spread);
    reg_rigid motion;
    for (int f = 0; f < flips; f++) {
        int flip = f ? -1 : 1;
        sb_vec3 way = sb_v3_scale((sb_real)flip, facing);
        regi_pose_add(poses, &count, *start, flip);
        if (options->landmark_count >= 3 &&
            reg_rigid_fit(icp->landmarks_a, icp->landmarks_b, NULL, options->landmark_count, &motion, NULL) == SB_OK)
            regi_pose_add(poses, &count, motion, flip);
        for (int i = 0; i < 24 + spirals; i++) {
            sb_mat3 turn = i < 24 ? regi_pose_cube(i) : regi_pose_spiral(i - 24, spirals);
            turn = sb_m3_mult(sb_m3_mul(icp->b.axes, turn), icp->a.axes);
            regi_pose_add(poses, &count, regi_pose_place(icp, turn, way), flip);
            if (regi_pose_prior(icp, poses + count - 1, between_rotations) < (sb_real)-4.5)
                count--;
        }
    }
    return count;
}

/* ==== distinct poses ============================================================================================== */

/* Best scores first; of equal ones the earlier. */
static void regi_pose_sort(regi_pose *poses, int count, int kept)
{
    for (int i = 0; i < kept && i < count; i++) {
        int best = i;
        regi_pose found;
        for (int j = i + 1; j < count; j++)
            best = poses[j].score < poses[best].score ? j : best;
        found = poses[best];
        for (int j = best; j > i; j--)
            poses[j] = poses[j - 1];
        poses[i] = found;
    }
}

/* 1 when two poses are 8 degrees or, in the mean over the shape, 5 % of its size apart. */
static int regi_pose_differ(const regi_icp *icp, const regi_pose *p, const regi_pose *q)
{
    const regi_icp_side *model = icp->swapped ? &icp->b : &icp->a;
    reg_rigid first = regi_icp_of_model(icp, &p->motion), second = regi_icp_of_model(icp, &q->motion);
    reg_rigid back = reg_rigid_inverse(&first), between = reg_rigid_compose(&second, &back);
    int probes = sbi_min_int(model->spread.count, REGI_POSE_PROBES);
    sb_real sum = 0;
    if (reg_rigid_angle(&between) > (sb_real)0.14)
        return 1;
    for (int i = 0; i < probes; i++)
        sum += sb_v3_norm(sb_v3_sub(reg_rigid_apply(&first, model->spread.points[i]),
                                    reg_rigid_apply(&second, model->spread.points[i])));
    return sum > (sb_real)0.05 * model->extent * (sb_real)probes;
}

REGI_API int regi_pose_distinct(const regi_icp *icp, regi_pose *poses, int count, int kept)
{
    int found = 0;
    for (int i = 0; i < count && found < kept; i++) {
        int fresh = 1;
        for (int j = 0; j < found && fresh; j++)
            fresh = regi_pose_differ(icp, poses + i, poses + j);
        if (fresh)
            poses[found++] = poses[i];
    }
    return found;
}

/* ==== likelihood ================================================================================================== */

/* Gaps between the shapes for some poses: [poses][room], filled up to count. */
typedef struct regi_pose_gaps {
    sb_real *gap, *weight, *scratch;
    int room, count[REG_ICP_POSES];
} regi_pose_gaps;

/* How far pair n is from the other shape: from the surface, or from the plane through the closest point and, beyond
 * what lies between points, from that. */
static sb_real regi_pose_gap(const regi_icp *icp, const reg_rigid *motion, int n, const regi_icp_side *other)
{
    const regi_icp_pairs *pairs = &icp->pairs;
    sb_vec3 way;
    sb_real plane, beside;
    if (other->surface || !(pairs->weight[n] > 0))
        return pairs->weight[n] > 0 ? pairs->distance[n] : (sb_real)INFINITY;
    way = sb_v3_sub(reg_rigid_apply(motion, pairs->from[n]), pairs->to[n]);
    plane = sb_v3_dot(way, pairs->normal[n]);
    beside = sb_v3_dot(way, way) - plane * plane - other->spacing * other->spacing;
    return sb_sqrt(plane * plane + sb_max(beside, 0));
}

/* Share of neighbouring points' signed gaps that is common to them, in [0, 1]: noise has none, deformation and wrong
 * poses much. gap: of the pose; residual[count]: scratch. */
static sb_real regi_pose_correlation(const regi_icp *icp, const regi_pose *pose, const sb_real *gap, sb_real *residual)
{
    const regi_icp_side *side = &icp->a;
    sb_real products = 0, squares = 0, limit = 3 * pose->noise;
    for (int i = 0; i < side->spread.count; i++) {
        sb_vec3 way = sb_v3_sub(reg_rigid_apply(&pose->motion, icp->pairs.from[i]), icp->pairs.to[i]);
        residual[i] = gap[i] <= limit ? sb_v3_dot(way, icp->pairs.normal[i]) : 0;
    }
    for (int i = 0; i < side->spread.count; i++) {
        int pair[2];
        sb_real squared[2];
        if (reg_kdtree_k_nearest(side->spread_tree, side->spread.points[i], 2, pair, squared) < 2)
            continue;
        squares += residual[i] * residual[i] + residual[pair[1]] * residual[pair[1]];
        products += 2 * residual[i] * residual[pair[1]];
    }
    return squares > 0 ? sb_max(products / squares, 0) : 1;
}

/* The gaps of one pose, and its noise: 1.48 times their median. */
static void regi_pose_look(regi_icp *icp, const regi_icp_stage *last, regi_pose *pose, regi_pose_gaps *gaps, int which)
{
    regi_icp_stage stage = *last;
    sb_real *gap = gaps->gap + (size_t)which * (size_t)gaps->room;
    sb_real *weight = gaps->weight + (size_t)which * (size_t)gaps->room, median;
    int first = icp->a.spread.count;
    stage.spread = 1;
    stage.coarse = 0;
    stage.points = REGI_ICP_FINE;
    stage.outliers = REG_OUTLIERS_NONE;
    stage.reach = SB_REAL_MAX;
    stage.flip = pose->flip;
    regi_icp_pair(icp, &stage, &pose->motion);
    gaps->count[which] = icp->pairs.count;
    for (int i = 0; i < icp->pairs.count; i++) {
        gap[i] = regi_pose_gap(icp, &pose->motion, i, i < first ? &icp->b : &icp->a);
        weight[i] = i < first ? icp->a.spread.weights[i] : icp->b.spread.weights[i - first];
        gaps->scratch[gaps->room + i] = sb_is_finite(gap[i]) ? gap[i] : icp->a.extent + icp->b.extent;
    }
    median =
        reg_outlier_limit(gaps->scratch + gaps->room, icp->pairs.count, REG_OUTLIERS_TRIM, (sb_real)0.5, gaps->scratch);
    pose->noise = (sb_real)1.4826 * sb_max(median, 0);
    pose->lost = 0;
    for (int i = 0; i < icp->pairs.count; i++)
        pose->lost += gap[i] > 6 * pose->noise ? 1 / (sb_real)icp->pairs.count : 0;
    pose->correlation = regi_pose_correlation(icp, pose, gap, gaps->scratch);
}

/* Student's distribution with three degrees of freedom, as log against that of gap 0. */
static sb_real regi_pose_student(sb_real gap, sb_real noise)
{
    sb_real x = gap / noise;
    return -2 * sb_log(1 + x * x / 3);
}

/* Mean log-likelihood of a point for a common noise; what finds no partner counts as a tenth of the size. */
static sb_real regi_pose_mean(const regi_icp *icp, const regi_pose *pose, const regi_pose_gaps *gaps, int which,
                              sb_real noise)
{
    const reg_icp_options *o = icp->options;
    const sb_real *gap = gaps->gap + (size_t)which * (size_t)gaps->room;
    const sb_real *weight = gaps->weight + (size_t)which * (size_t)gaps->room;
    sb_real most = (sb_real)0.1 * (icp->swapped ? icp->b.extent : icp->a.extent), sum = 0, total = 0, share = 1;
    for (int i = 0; i < gaps->count[which]; i++) {
        total += weight[i];
        sum += weight[i] * regi_pose_student(sb_min(gap[i], most), noise);
    }
    sum = total > 0 ? sum / total : 0;
    for (int i = 0; i < o->landmark_count; i++) {
        sb_vec3 way = sb_v3_sub(reg_rigid_apply(&pose->motion, icp->landmarks_a[i]), icp->landmarks_b[i]);
        sum += o->landmarks[i].weight * regi_pose_student(sb_v3_norm(way), noise);
        share += o->landmarks[i].weight;
    }
    return sum / share;
}

/* Patches of a tenth of the model's size in radius, of what looks. */
static sb_real regi_pose_patches(const regi_icp *icp)
{
    const double pi = 3.141592653589793;
    double radius = 0.1 * (double)(icp->swapped ? icp->b.extent : icp->a.extent);
    double patches = radius > 0 ? (double)icp->a.area / (pi * radius * radius) : 1;
    return (sb_real)fmin(fmax(patches, 1), (double)icp->a.spread.count);
}

REGI_API sb_real regi_pose_points(const regi_icp *icp, sb_real correlation)
{
    sb_real n = (sb_real)icp->a.spread.count;
    return n / (1 + correlation * (n / regi_pose_patches(icp) - 1));
}

/* Their likelihoods, by a common noise: the least of all. */
static void regi_pose_weigh(regi_icp *icp, const regi_icp_stage *last, regi_pose *poses, int count,
                            regi_pose_gaps *gaps)
{
    sb_real noise = SB_REAL_MAX, patches = regi_pose_patches(icp), points;
    for (int i = 0; i < count; i++) {
        regi_pose_look(icp, last, poses + i, gaps, i);
        noise = sb_min(noise, poses[i].noise);
    }
    noise = sb_max(noise, 64 * SB_EPSILON * (icp->a.extent + icp->b.extent));
    if (!(noise > 0))
        noise = 1; /* the shapes are points: any unit does */
    for (int i = 0; i < count; i++)
        poses[i].score = -regi_pose_mean(icp, poses + i, gaps, i, noise);
    regi_pose_sort(poses, count, count);
    points = regi_pose_points(icp, poses[0].correlation);
    for (int i = 0; i < count; i++) {
        poses[i].in_front = regi_pose_in_front(icp, &poses[i].motion);
        poses[i].likelihood =
            regi_pose_prior(icp, poses + i, 0) - points * poses[i].score - 10 * patches * poses[i].in_front;
        poses[i].score = -poses[i].likelihood;
    }
    regi_pose_sort(poses, count, count);
}

REGI_API sb_result regi_pose_rank(regi_icp *icp, const regi_icp_stage *last, regi_pose *poses, int count)
{
    regi_pose_gaps gaps;
    size_t room = (size_t)icp->a.spread.count + (size_t)icp->b.spread.count;
    memset(&gaps, 0, sizeof gaps);
    gaps.room = (int)room;
    gaps.gap = (sb_real *)sbi_alloc(icp->allocator, room, (2 * (size_t)count + 2) * sizeof(sb_real));
    if (!gaps.gap)
        return regi_icp_no_memory(icp);
    gaps.weight = gaps.gap + (size_t)count * room;
    gaps.scratch = gaps.weight + (size_t)count * room;
    regi_pose_weigh(icp, last, poses, count, &gaps);
    sbi_free(icp->allocator, gaps.gap);
    return SB_OK;
}

/* ==== search ====================================================================================================== */

/* How the search thins out its candidates. */
typedef struct regi_pose_plan {
    int coarse, points, rounds, kept, distinct;
} regi_pose_plan;

static int regi_pose_stage(regi_icp *icp, const regi_pose_plan *plan, regi_icp_stage *stage, regi_pose *poses,
                           int count, int *begun)
{
    int converged;
    stage->coarse = plan->coarse;
    stage->points = plan->points;
    for (int i = 0; i < count; i++) {
        stage->flip = poses[i].flip;
        regi_icp_iterate(icp, stage, plan->rounds, (sb_real)1e-3, &poses[i].motion, &poses[i].score, &converged);
        if (icp->out_of_time)
            count = i + 1;
    }
    *begun = count;
    regi_pose_sort(poses, count, count);
    count = plan->distinct ? regi_pose_distinct(icp, poses, count, plan->kept) : sbi_min_int(count, plan->kept);
    while (count > 3 && plan->distinct && poses[count - 1].score > 2 * poses[0].score)
        count--; /* far off; some stay to compare with */
    return count;
}

REGI_API sb_result regi_pose_search(regi_icp *icp, const reg_rigid *start, const regi_icp_stage *last, regi_pose *poses,
                                    int *count, int *tried)
{
    static const regi_pose_plan plan[REGI_POSE_STAGES] = {
        {1, 60, 4, 60, 0}, {1, 150, 6, 12, 1}, {1, 300, 8, REG_ICP_POSES, 1}, {0, 300, 5, REG_ICP_POSES, 1}};
    size_t most = 2 * (2 + REGI_POSE_ROTATIONS);
    regi_pose *all = (regi_pose *)sbi_alloc(icp->allocator, most, sizeof(regi_pose));
    regi_icp_stage stage = *last;
    sb_result result;
    int left, begun;
    if (!all)
        return regi_icp_no_memory(icp);
    left = regi_pose_candidates(icp, start, all);
    stage.spread = 1;
    stage.metric = REG_ICP_PLANE;
    stage.outliers = REG_OUTLIERS_TRIM;
    stage.parameter = (sb_real)0.7;
    stage.reach = SB_REAL_MAX;
    stage.lost = (sb_real)0.03 * (icp->swapped ? icp->b.extent : icp->a.extent);
    for (int s = 0; s < REGI_POSE_STAGES; s++) {
        left = regi_pose_stage(icp, plan + s, &stage, all, left, &begun);
        *tried = s == 0 ? begun : *tried;
    }
    result = regi_pose_rank(icp, last, all, left);
    memcpy(poses, all, (size_t)left * sizeof poses[0]);
    *count = left;
    sbi_free(icp->allocator, all);
    return result;
}
