/* steer: the controller that replans at every step and follows its plan past obstacles. */
#include "steer_path.h"

static const unsigned ndli_steer_cookie = 0x73747231u;

NDL_API ndl_steer_def ndl_default_steer_def(sb_real curvature, sb_real max_length)
{
    ndl_steer_def def;
    memset(&def, 0, sizeof def);
    def.plan = ndl_default_plan_def(curvature, max_length);
    def.reserve = (sb_real)0.2;
    def.step = (sb_real)0.01 / curvature;
    def.max_turn = 1;
    def.turn_gain = (sb_real)0.5;
    def.turn_first = (sb_real)0.3;
    def.max_wait = 40;
    def.reach = (sb_real)0.01 / curvature;
    def.max_updates = 10000;
    def.learn = (sb_real)0.12 / curvature;
    def.cookie = ndli_steer_cookie;
    return def;
}

static int ndli_steer_positive(sb_real x) { return x > 0 && x <= SB_REAL_MAX; }

NDL_API sb_result ndl_steer_begin(const ndl_steer_def *def, ndl_steer *steer, sb_error *error)
{
    sb_result result;
    if (!def || !steer)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def or steer is NULL");
    if (def->cookie != ndli_steer_cookie)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def does not come from ndl_default_steer_def()");
    result = ndli_plan_check(&def->plan, error);
    if (result != SB_OK)
        return result;
    if (!ndli_steer_positive(def->step) || !ndli_steer_positive(def->max_turn) || !ndli_steer_positive(def->reach))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "step, max_turn and reach must be finite and above 0");
    if (!(def->turn_gain > 0) || !(def->turn_gain <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "turn_gain must be above 0 and at most 1");
    if (!(def->turn_first >= 0) || def->max_wait < 0 || def->max_updates < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "turn_first and max_wait must not be negative, max_updates at least 1");
    if (!(def->reserve >= 0) || !(def->reserve < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "reserve must be at least 0 and below 1");
    if (!(def->learn >= 0) || !(def->learn <= sb_sqrt(SB_REAL_MAX) / 8)) /* sums hold its square */
        return sbi_fail(error, SB_ERROR_ARGUMENT, "learn must not be negative, and its square finite");
    memset(steer, 0, sizeof *steer);
    steer->def = *def;
    steer->plan.outcome = NDL_PLAN_SHORT;
    steer->curvature = def->plan.curvature;
    return SB_OK;
}

/* ---- what is learned ----
 * Between two sensed tips the needle was inserted by ds. Across their mean heading the tip has moved by ds times the
 * drift; heading and drift are its way, which has turned along m2 by ds times the curvature. The drift is averaged with
 * the weight ds/(ds + learn); the curvature is a least-squares fit that forgets. What it begins with is forgotten five
 * times as fast as what is measured. It never goes beyond that: to count on more bend than there is ends beside the
 * target, to count on less costs a longer way. */

static const double ndli_steer_memory = 2; /* of the curvature, in lengths of def.learn: noise has more effect on it */
static const double ndli_steer_seen_bend = 0.05; /* rad: more than noise, and less than 1 cm of most needles */
static const double ndli_steer_most_drift = 0.3;

static void ndli_steer_learn_drift(ndl_steer *steer, const ndli_pose *pose, double ds)
{
    double share = ds / (ds + (double)steer->def.learn), size;
    ndli_v3 ahead = ndli_add(pose->t, ndli_from(steer->tip.frame.t)), lean;
    ndli_v3 moved = ndli_sub(pose->p, ndli_from(steer->tip.position));
    ahead = ndli_scale(1 / ndli_norm(ahead), ahead);
    lean = ndli_scale(1 / ds, ndli_madd(moved, -ndli_dot(moved, ahead), ahead));
    size = ndli_norm(lean);
    if (size > ndli_steer_most_drift)
        lean = ndli_scale(ndli_steer_most_drift / size, lean);
    steer->drift = ndli_to(ndli_madd(ndli_scale(1 - share, ndli_from(steer->drift)), share, lean));
}

static void ndli_steer_learn_curvature(ndl_steer *steer, ndli_v3 turned, ndli_v3 m2, double ds)
{
    double given = (double)steer->def.plan.curvature, memory = ndli_steer_memory * (double)steer->def.learn;
    double way = ds * ndli_norm(m2), k = (double)steer->curvature; /* shorter where the tip was rolled between them */
    double weight = steer->weight > 0 ? (double)steer->weight : 0.2 * memory * (double)steer->def.step;
    if (!(way > 0.5 * ds))
        return;
    weight = weight * memory / (memory + ds) + way * way;
    k += way * (ndli_dot(turned, m2) / ndli_norm(m2) - k * way) / weight;
    steer->curvature = (sb_real)(k < 0.5 * given ? 0.5 * given : k > given ? given : k);
    steer->weight = (sb_real)weight;
}

/* The sensed pose, made to look along the tip's way. */
static ndli_pose ndli_steer_on_way(const ndl_steer *steer, const ndli_pose *pose)
{
    ndli_pose on = *pose;
    ndli_v3 t = ndli_add(pose->t, ndli_from(steer->drift));
    on.t = ndli_scale(1 / ndli_norm(t), t);
    on.m2 = ndli_madd(pose->m2, -ndli_dot(pose->m2, on.t), on.t);
    on.m2 = ndli_scale(1 / ndli_norm(on.m2), on.m2);
    on.m1 = ndli_cross(on.m2, on.t);
    return on;
}

/* From another sensed pose; makes it one that looks along the tip's way. */
static void ndli_steer_learn(ndl_steer *steer, ndli_pose *pose)
{
    double ds = (double)steer->advance;
    int moved = steer->updates > 0 && steer->def.learn > 0 && ds > 0.25 * (double)steer->def.step &&
                ndli_dot(pose->t, ndli_from(steer->tip.frame.t)) > 0;
    ndl_tip_pose sensed = ndli_pose_write(pose);
    if (steer->updates == 0)
        steer->first = sensed.frame.t;
    if (moved)
        ndli_steer_learn_drift(steer, pose, ds);
    *pose = ndli_steer_on_way(steer, pose);
    if (moved && steer->bends)
        ndli_steer_learn_curvature(steer, ndli_sub(pose->t, ndli_from(steer->way)),
                                   ndli_scale(0.5, ndli_add(pose->m2, ndli_from(steer->tip.frame.m2))), ds);
    if (moved && !steer->bends)
        steer->bends = ndli_norm(ndli_sub(pose->t, ndli_from(steer->first))) > ndli_steer_seen_bend;
    steer->tip = sensed;
    steer->way = ndli_to(pose->t);
}

/* ---- the plan ---- */

/* Remembers where the pieces of the plan before its last one end. */
static void ndli_steer_mark(ndl_steer *steer, const ndl_plan_def *def, const ndli_pose *pose)
{
    ndl_tip_pose tip = ndli_pose_write(pose);
    sb_real length = 0;
    steer->waypoint_count = 0;
    for (int i = 0; i + 1 < steer->plan.piece_count; i++) {
        length += steer->plan.pieces[i].length;
        steer->waypoints[i] = ndl_plan_pose(&steer->plan, def->curvature, &tip, length).position;
        steer->waypoint_count++;
    }
}

static void ndli_steer_drop_waypoint(ndl_steer *steer)
{
    for (int i = 1; i < steer->waypoint_count; i++)
        steer->waypoints[i - 1] = steer->waypoints[i];
    steer->waypoint_count--;
}

/* Searches the way anew, at half the clearance where the whole one leaves none that gets there. */
static void ndli_steer_search(ndl_steer *steer, const ndl_plan_def *def, const ndli_pose *pose, ndli_v3 target,
                              double sense, ndl_plan *plan)
{
    ndl_plan_def close = *def;
    ndl_plan other;
    close.clearance = (sb_real)0.5 * def->clearance;
    steer->plans++;
    ndli_plan_search(def, pose, target, sense, plan);
    if (plan->outcome != NDL_PLAN_SHORT)
        return;
    ndli_plan_search(&close, pose, target, sense, &other);
    if (other.distance < plan->distance - def->tolerance)
        *plan = other;
}

/* Leaves out first pieces with no length to speak of: with nothing to insert the needle would wait at them for ever. */
static void ndli_steer_skip_empty(ndl_plan *plan, sb_real least)
{
    while (plan->piece_count > 1 && plan->pieces[0].length < least) {
        sb_real turn = plan->pieces[0].turn + plan->pieces[1].turn;
        plan->length -= plan->pieces[0].length;
        plan->piece_count--;
        memmove(plan->pieces, plan->pieces + 1, (size_t)plan->piece_count * sizeof plan->pieces[0]);
        plan->pieces[0].turn = turn > (sb_real)3.14159265358979    ? turn - (sb_real)6.28318530717959
                               : turn < -(sb_real)3.14159265358979 ? turn + (sb_real)6.28318530717959
                                                                   : turn;
    }
}

/* steer->plan from the sensed pose: the present one aimed anew, unless obstacles ask for another one. A way that is
 * clear but does not get there gives place only to one that is better by far: changing from one to another and back, a
 * needle would turn and never go on. */
static void ndli_steer_plan(ndl_steer *steer, const ndli_pose *pose, ndli_v3 target)
{
    ndl_plan_def def = steer->def.plan;
    ndl_plan plan, other;
    double sense = steer->plan.piece_count > 0 ? (double)steer->plan.pieces[0].twist : 0;
    sb_real enough = (sb_real)0.5 * steer->def.reach;
    const int between = 8; /* updates, while there is no hurry */
    int clear;
    def.curvature = steer->curvature * (1 - steer->def.reserve);
    def.max_length = def.max_length > steer->inserted ? def.max_length - steer->inserted : 0;
    for (;;) { /* waypoints that the tip has come to, or can get no nearer to, are done with */
        clear = ndli_plan_aim(&def, 0.5 * (double)def.clearance, pose, steer->waypoints, steer->waypoint_count, target,
                              sense, &plan);
        if (steer->waypoint_count == 0 || !(plan.pieces[0].length < (sb_real)0.5 * steer->def.step))
            break;
        ndli_steer_drop_waypoint(steer);
    }
    if (def.obstacle_count > 0 && (!clear || (plan.distance > enough && steer->updates >= steer->next_search))) {
        steer->next_search = steer->updates + between;
        ndli_steer_search(steer, &def, pose, target, sense, &other);
        if (!clear || other.distance < plan.distance - enough)
            plan = other;
    }
    ndli_steer_skip_empty(&plan, (sb_real)0.25 * steer->def.step);
    steer->plan = plan;
    ndli_steer_mark(steer, &def, pose);
}

/* ---- the command ---- */

static ndl_steer_status ndli_steer_end(const ndl_steer *steer, double distance)
{
    int obstacles = steer->def.plan.obstacle_count > 0;
    sb_real little = 2 * steer->def.plan.tolerance;
    if (distance <= (double)steer->def.reach)
        return NDL_STEER_REACHED;
    if (steer->inserted + (sb_real)0.25 * steer->def.step >= steer->def.plan.max_length)
        return NDL_STEER_LIMIT;
    if (steer->plan.outcome == NDL_PLAN_BLOCKED || (obstacles && steer->plan.distance > steer->plan.bound + little))
        return NDL_STEER_BLOCKED; /* without obstacles there would be a way to get nearer */
    return NDL_STEER_CLOSEST;
}

/* How much of the roll that the plan asks for is worth turning for: little where the point aimed at lies ahead (its
 * azimuth is noise), none where what is left to insert can no longer bend the path by the tolerance. */
static double ndli_steer_worth(const ndl_steer *steer, double aside)
{
    double tolerance = (double)steer->def.plan.tolerance, length = (double)steer->plan.length;
    double bend = 0.5 * (double)steer->def.plan.curvature * length * length;
    if (bend < tolerance)
        return 0;
    return aside < 2 * tolerance ? aside / (2 * tolerance) : 1;
}

static void ndli_steer_move(ndl_steer *steer, const ndli_pose *pose, ndli_v3 target, ndl_steer_command *command)
{
    const ndl_steer_def *def = &steer->def;
    const ndl_plan_piece *piece = steer->plan.pieces;
    ndli_v3 g = ndli_pose_in(pose, steer->waypoint_count > 0 ? ndli_from(steer->waypoints[0]) : target);
    double aside = sqrt(g.x * g.x + g.y * g.y), worth = ndli_steer_worth(steer, aside), most = (double)def->max_turn;
    double turn = worth * (double)piece->turn, insertion = (double)sb_min(piece->length, def->step);
    if (fabs(turn) > (double)def->turn_first && steer->waited < def->max_wait) {
        steer->waited++;
        insertion = 0;
    } else {
        steer->waited = 0;
    }
    turn = (double)def->turn_gain * turn + (worth > 0 ? (double)piece->twist * insertion : 0);
    command->turn = (sb_real)(turn > most ? most : turn < -most ? -most : turn);
    command->insertion = (sb_real)insertion;
    steer->inserted += command->insertion;
}

NDL_API sb_result ndl_steer_update(ndl_steer *steer, const ndl_tip_pose *tip, sb_vec3 target,
                                   ndl_steer_command *command)
{
    ndli_pose pose;
    ndli_v3 goal = ndli_from(target);
    sb_result result;
    double distance;
    if (!steer || !tip || !command || steer->def.cookie != ndli_steer_cookie)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(target))
        return SB_ERROR_NOT_FINITE;
    result = ndli_pose_read(tip, &pose);
    if (result != SB_OK)
        return result;
    distance = ndli_norm(ndli_sub(goal, pose.p));
    memset(command, 0, sizeof *command);
    if (steer->status == NDL_STEER_GOING) {
        ndli_steer_learn(steer, &pose);
        ndli_steer_plan(steer, &pose, goal);
        steer->updates++;
        if (steer->plan.length < (sb_real)0.25 * steer->def.step)
            steer->status = ndli_steer_end(steer, distance);
        else if (steer->updates >= steer->def.max_updates)
            steer->status = distance <= (double)steer->def.reach ? NDL_STEER_REACHED : NDL_STEER_LIMIT;
        else
            ndli_steer_move(steer, &pose, goal, command);
        steer->advance = command->insertion;
    }
    command->status = steer->status;
    command->distance = (sb_real)distance;
    command->expected = steer->plan.distance;
    return SB_OK;
}
