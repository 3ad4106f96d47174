/* steer_plan: the helix that ends nearest to a target, and sequences of helices past obstacles. */
#include "steer_path.h"

static const unsigned ndli_plan_cookie = 0x706c6e31u;

/* ---- the search for one helix ----
 * f(s, w) = |p(s, w) - g| over lengths and twists. With turning the helix may be turned about the tip's axis: f is
 * then the distance in the half plane (distance from the axis, way along it), and w >= 0 is enough: -w is the mirror
 * image. p moves by at most ds/2 and slope dw/2 within a box, so f(middle) less that bounds f from below. */

enum { NDLI_SEARCH_STACK = 128, NDLI_SEARCH_STARTS = 4, NDLI_SEARCH_SEEDS = 256 };

typedef struct ndli_search {
    double k, s_max, w_low, w_high;
    ndli_v3 g;  /* target in the tip's frame */
    double rho; /* its distance from the tip's axis */
    int turn;
    double tolerance;
    int max_boxes;
    const ndli_field *field; /* or NULL: only what is clear of it counts, from this pose */
    const ndli_pose *pose;
    double s, w, distance; /* the best so far */
    double bound;
    int boxes;
} ndli_search;

typedef struct ndli_box {
    double s0, s1, w0, w1, bound;
} ndli_box;

static double ndli_search_value(const ndli_search *q, double s, double w)
{
    ndli_v3 p = ndli_helix_point(q->k, w, s);
    double r;
    if (!q->turn)
        return ndli_norm(ndli_sub(p, q->g));
    r = sqrt(p.x * p.x + p.y * p.y) - q->rho;
    return sqrt(r * r + (p.z - q->g.z) * (p.z - q->g.z));
}

static void ndli_search_keep(ndli_search *q, double s, double w, double value)
{
    if (value < q->distance) {
        q->s = s;
        q->w = w;
        q->distance = value;
    }
}

/* Takes (s, w) as the best when it is; a path that meets an obstacle is cut off before it. */
static void ndli_search_offer(ndli_search *q, double s, double w, double value)
{
    double unused = 0, free_length;
    if (!(value < q->distance))
        return;
    if (q->field) {
        free_length = ndli_field_march(q->field, q->pose, q->k, w, s, 0, &unused);
        if (free_length < s) {
            s = free_length;
            value = ndli_search_value(q, s, w);
        }
    }
    ndli_search_keep(q, s, w, value);
}

/* Residual of f at (s, w), its derivatives, and f^2. */
static double ndli_search_linear(const ndli_search *q, double s, double w, ndli_v3 *r, ndli_v3 *ds, ndli_v3 *dw)
{
    ndli_helix_end e = ndli_helix_derive(q->k, w, s);
    double out;
    *r = ndli_sub(e.p, q->g);
    *ds = e.ds;
    *dw = e.dw;
    if (q->turn) {
        out = sqrt(e.p.x * e.p.x + e.p.y * e.p.y);
        *r = ndli_v(out - q->rho, 0, e.p.z - q->g.z);
        *ds = ndli_v(out > 0 ? (e.p.x * e.ds.x + e.p.y * e.ds.y) / out : 0, 0, e.ds.z);
        *dw = ndli_v(out > 0 ? (e.p.x * e.dw.x + e.p.y * e.dw.y) / out : 0, 0, e.dw.z);
    }
    return ndli_dot(*r, *r);
}

static int ndli_search_leaves(double x, double low, double high, double gradient)
{
    return (x <= low && gradient > 0) || (x >= high && gradient < 0);
}

static double ndli_search_into(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

/* Levenberg-Marquardt within the limits, from (*s, *w); a variable at a limit that the descent would leave stays. */
static void ndli_search_descend(const ndli_search *q, double *s, double *w)
{
    ndli_v3 r, ds, dw;
    double damping = 1e-3, enough = q->tolerance / 64 * (q->tolerance / 64);
    double now = ndli_search_linear(q, *s, *w, &r, &ds, &dw);
    for (int i = 0; i < 24 && now > enough && damping < 1e8; i++) {
        double gs = ndli_dot(r, ds), gw = ndli_dot(r, dw), a = ndli_dot(ds, ds), b = ndli_dot(ds, dw),
               c = ndli_dot(dw, dw), det, try_s, try_w, value;
        if (ndli_search_leaves(*s, 0, q->s_max, gs))
            gs = 0, a = 1, b = 0;
        if (!(c > 0) || ndli_search_leaves(*w, q->w_low, q->w_high, gw))
            gw = 0, c = 1, b = 0;
        a *= 1 + damping;
        c *= 1 + damping;
        det = a * c - b * b;
        try_s = ndli_search_into(*s - (c * gs - b * gw) / det, 0, q->s_max);
        try_w = ndli_search_into(*w - (a * gw - b * gs) / det, q->w_low, q->w_high);
        value = ndli_search_value(q, try_s, try_w);
        if (value * value < now) {
            double gain = now - value * value;
            *s = try_s;
            *w = try_w;
            now = ndli_search_linear(q, *s, *w, &r, &ds, &dw);
            damping *= 0.1;
            if (gain < 1e-6 * now)
                break;
        } else {
            damping *= 10;
        }
    }
}

/* Descends from the best of a row of twists, about four to each turn of the helix (f changes as fast as that), all at
 * the length of the chord. */
static void ndli_search_start(ndli_search *q)
{
    double at[NDLI_SEARCH_STARTS], value[NDLI_SEARCH_STARTS], range = q->w_high - q->w_low;
    double chord = ndli_norm(q->g), s = chord < q->s_max ? chord : q->s_max, turns = range * s * (2 / 3.14159265358979);
    int seeds = turns < NDLI_SEARCH_SEEDS - 4 ? (int)turns + 4 : NDLI_SEARCH_SEEDS, count = 0;
    for (int i = 0; i < seeds; i++) {
        double w = q->w_low + range * i / (seeds - 1), f = ndli_search_value(q, s, w);
        int k = count < NDLI_SEARCH_STARTS ? count++ : NDLI_SEARCH_STARTS;
        for (; k > 0 && f < value[k - 1]; k--)
            if (k < NDLI_SEARCH_STARTS)
                value[k] = value[k - 1], at[k] = at[k - 1];
        if (k < NDLI_SEARCH_STARTS)
            value[k] = f, at[k] = w;
    }
    for (int i = 0; i < count && q->distance > q->tolerance; i++) {
        double length = s, w = at[i];
        ndli_search_descend(q, &length, &w);
        ndli_search_offer(q, length, w, ndli_search_value(q, length, w));
    }
}

/* Upper bound of |dp/dw| over a box: k s^3/6, and for tight helices k s/W^2 |(2 + 2/a, 1 + 4/a, (3 + 3/a) k/W)| with
 * W^2 = k^2 + w^2, a = s W. The first is the limit of small k s, measured to hold everywhere (0.99991 of it at most);
 * the second follows from 0 <= c2 <= (1 + 1/a)/a^2, |c1'| <= (1 + 4/a)/a^2, |c2'| <= 3 (1 + 1/a)/a^3. */
static double ndli_search_slope(const ndli_search *q, const ndli_box *b)
{
    double w = b->w0 > 0 ? b->w0 : b->w1 < 0 ? b->w1 : 0, square = q->k * q->k + w * w, rate = sqrt(square);
    double slope = q->k * b->s1 * b->s1 * b->s1 / 6, a = b->s0 * rate, x, y, z, tail;
    if (!(a > 1))
        return slope;
    x = 2 + 2 / a;
    y = 1 + 4 / a;
    z = (3 + 3 / a) * q->k / rate;
    tail = q->k * b->s1 / square * sqrt(x * x + y * y + z * z);
    return tail < slope ? tail : slope;
}

/* Looks at a box: offers its middle, sets its bound; `longer`: whether it is to be split along s. */
static void ndli_search_look(ndli_search *q, ndli_box *b, int *longer)
{
    double s = 0.5 * (b->s0 + b->s1), w = 0.5 * (b->w0 + b->w1), value = ndli_search_value(q, s, w);
    double along = 0.5 * (b->s1 - b->s0), across = 0.5 * (b->w1 - b->w0) * ndli_search_slope(q, b), least;
    q->boxes++;
    *longer = along > across;
    least = value - along - across;
    b->bound = b->bound > least ? b->bound : least;
    if (q->field && value < q->distance && b->bound < q->distance - q->tolerance) {
        /* all paths of the box are within slack s^3 of its middle one */
        double unused = 0, slack = 0.5 * (b->w1 - b->w0) * q->k / 6;
        if (ndli_field_march(q->field, q->pose, q->k, w, b->s0, slack, &unused) < b->s0)
            b->bound = q->distance; /* all are blocked before they get there */
    }
    ndli_search_offer(q, s, w, value);
}

static void ndli_search_branch(ndli_search *q)
{
    ndli_box stack[NDLI_SEARCH_STACK];
    int split[NDLI_SEARCH_STACK], top = 1;
    memset(stack, 0, sizeof stack[0]);
    stack[0].s1 = q->s_max;
    stack[0].w0 = q->w_low;
    stack[0].w1 = q->w_high;
    ndli_search_look(q, stack, split);
    q->bound = q->distance;
    while (top > 0) {
        ndli_box b = stack[--top], half[2];
        int longer[2], first;
        if (b.bound >= q->distance - q->tolerance || q->boxes >= q->max_boxes || top + 2 > NDLI_SEARCH_STACK) {
            q->bound = b.bound < q->bound ? b.bound : q->bound;
            continue;
        }
        half[0] = half[1] = b;
        if (split[top])
            half[0].s1 = half[1].s0 = 0.5 * (b.s0 + b.s1);
        else
            half[0].w1 = half[1].w0 = 0.5 * (b.w0 + b.w1);
        ndli_search_look(q, half, longer);
        ndli_search_look(q, half + 1, longer + 1);
        first = half[1].bound < half[0].bound; /* the more promising half is taken next */
        stack[top] = half[!first];
        split[top++] = longer[!first];
        stack[top] = half[first];
        split[top++] = longer[first];
    }
    q->bound = q->bound < q->distance ? q->bound : q->distance;
}

static void ndli_search_run(ndli_search *q)
{
    q->boxes = 0;
    q->s = 0;
    q->w = 0;
    q->distance = ndli_norm(q->g);
    q->bound = 0;
    if (q->distance > q->tolerance)
        ndli_search_start(q);
    if (q->distance > q->tolerance)
        ndli_search_branch(q);
}

static ndli_search ndli_search_of(const ndl_plan_def *def, const ndli_pose *pose, ndli_v3 target, double max_length)
{
    ndli_search q;
    memset(&q, 0, sizeof q);
    q.k = (double)def->curvature;
    q.s_max = max_length;
    q.w_high = (double)def->max_twist;
    q.w_low = def->turn ? 0 : -q.w_high;
    q.g = ndli_pose_in(pose, target);
    q.rho = sqrt(q.g.x * q.g.x + q.g.y * q.g.y);
    q.turn = def->turn;
    q.tolerance = (double)def->tolerance;
    q.max_boxes = def->max_boxes;
    q.pose = pose;
    return q;
}

static double ndli_plan_wrap(double angle)
{
    const double pi = 3.141592653589793;
    return angle > pi ? angle - 2 * pi : angle < -pi ? angle + 2 * pi : angle;
}

/* The piece that a search found. With turning both w and -w do; the smaller turn is taken, unless it is no more than a
 * little smaller and against `sense`: a choice that flips with the noise of sensing would never be carried out. */
static ndl_plan_piece ndli_search_piece(const ndli_search *q, double sense)
{
    const double little = 0.5;
    ndl_plan_piece piece;
    double turn = 0, w = q->w;
    if (q->turn && q->rho > 0 && q->s > 0) {
        ndli_v3 p = ndli_helix_point(q->k, w, q->s);
        double azimuth = sbi_dense_atan2(q->g.y, q->g.x);
        double one = ndli_plan_wrap(azimuth - sbi_dense_atan2(p.y, p.x));
        double two = ndli_plan_wrap(azimuth - sbi_dense_atan2(p.y, -p.x));
        int mirrored = fabs(two) + (sense > 0 ? little : sense < 0 ? -little : 0) < fabs(one);
        turn = mirrored ? two : one;
        w = mirrored ? -w : w;
    }
    piece.turn = (sb_real)turn;
    piece.twist = (sb_real)w;
    piece.length = (sb_real)q->s;
    return piece;
}

/* ---- plans ---- */

static void ndli_plan_clear(ndl_plan *plan)
{
    memset(plan, 0, sizeof *plan);
    plan->outcome = NDL_PLAN_SHORT;
    plan->clearance = SB_REAL_MAX;
}

static ndli_pose ndli_plan_follow(const ndli_pose *pose, double k, const ndl_plan_piece *piece, double length)
{
    ndli_pose r = ndli_pose_turn(pose, (double)piece->turn);
    return ndli_pose_helix(&r, k, (double)piece->twist, length);
}

/* Appends a piece as far as it is clear; returns whether all of it is. *pose moves to its end. */
static int ndli_plan_append(const ndl_plan_def *def, const ndli_field *field, const ndl_plan_piece *piece,
                            ndli_pose *pose, ndl_plan *plan)
{
    double k = (double)def->curvature, wanted = (double)piece->length, nearest = (double)plan->clearance, length;
    ndli_pose from = ndli_pose_turn(pose, (double)piece->turn);
    ndl_plan_piece *to = plan->pieces + plan->piece_count++;
    length = ndli_field_march(field, &from, k, (double)piece->twist, wanted, 0, &nearest);
    *to = *piece;
    if (length < wanted)
        to->length = (sb_real)length;
    plan->length += to->length;
    plan->clearance = (sb_real)nearest;
    *pose = ndli_pose_helix(&from, k, (double)piece->twist, length);
    return length >= wanted;
}

static void ndli_plan_finish(const ndl_plan_def *def, const ndli_pose *end, ndli_v3 target, ndl_plan *plan)
{
    plan->distance = (sb_real)ndli_norm(ndli_sub(end->p, target));
    plan->outcome = plan->distance <= def->tolerance ? NDL_PLAN_REACHES : NDL_PLAN_SHORT;
}

/* Obstacles at `clearance`, or at nine tenths of the tip's distance where that is less. */
static ndli_field ndli_plan_field(const ndl_plan_def *def, double clearance, const ndli_pose *pose)
{
    ndli_field field;
    double room;
    field.obstacles = def->obstacles;
    field.count = def->obstacle_count;
    field.clearance = clearance;
    field.resolution = (double)def->tolerance;
    room = 0.9 * ndli_field_distance(&field, pose->p);
    if (room < clearance)
        field.clearance = room;
    return field;
}

NDLI_API int ndli_plan_aim(const ndl_plan_def *def, double clearance, const ndli_pose *pose, const sb_vec3 *waypoints,
                           int waypoint_count, ndli_v3 target, double sense, ndl_plan *plan)
{
    ndli_field field = ndli_plan_field(def, clearance, pose);
    ndli_pose at = *pose;
    int clear = !(field.clearance < 0);
    ndli_plan_clear(plan);
    for (int i = 0; i <= waypoint_count && clear; i++) {
        ndli_v3 goal = i < waypoint_count ? ndli_from(waypoints[i]) : target;
        ndli_search q = ndli_search_of(def, &at, goal, (double)def->max_length - (double)plan->length);
        ndl_plan_piece piece;
        ndli_search_run(&q);
        piece = ndli_search_piece(&q, i == 0 ? sense : 0);
        plan->boxes += q.boxes;
        if (waypoint_count == 0)
            plan->bound = (sb_real)q.bound;
        clear = ndli_plan_append(def, &field, &piece, &at, plan);
    }
    ndli_plan_finish(def, &at, target, plan);
    if (field.clearance < 0)
        plan->outcome = NDL_PLAN_BLOCKED;
    return clear;
}

/* ---- sequences past obstacles ---- */

/* A sequence is its pieces but the last, which aims: for each three numbers in [0, 1], of turn, twist and length. */
enum { NDLI_ROUTE_NUMBERS = 3 * (NDL_PLAN_PIECES - 1) };

typedef struct ndli_route {
    double number[NDLI_ROUTE_NUMBERS];
    double cost;
    ndl_plan plan;
} ndli_route;

typedef struct ndli_router {
    const ndl_plan_def *def; /* with few boxes for each aim */
    ndli_field field;
    ndli_pose pose;
    ndli_v3 target;
    double reach; /* m: pieces before the last are shorter than this in all */
    int pieces;
} ndli_router;

/* Three tenths of the twists tried are 0: arcs, which turn the needle most. The rest grows as a square: a helix gets
 * straighter fast. */
static double ndli_route_twist(double number, double most)
{
    double x = 2 * number - 1, size = fabs(x) < 0.3 ? 0 : (fabs(x) - 0.3) / 0.7;
    return (x < 0 ? -1 : 1) * most * size * size;
}

static int ndli_route_better(const ndli_route *a, const ndli_route *b)
{
    int reaches_a = a->plan.outcome == NDL_PLAN_REACHES, reaches_b = b->plan.outcome == NDL_PLAN_REACHES;
    if (reaches_a != reaches_b)
        return reaches_a;
    return reaches_a ? a->cost < b->cost : a->plan.distance < b->plan.distance;
}

/* Cost (m) of a path that reaches: its length, what lacks to twice the clearance, and what lacks to a margin by which
 * the last piece could still be bent (a needle that bends less than planned would miss). */
static double ndli_route_cost(const ndli_router *router, const ndl_plan *plan, ndli_v3 last)
{
    double radius = 1 / (double)router->def->curvature, cost = (double)plan->length;
    double room = 2 * router->field.clearance - (double)plan->clearance;
    double out = sqrt(last.x * last.x + last.y * last.y) - radius;
    double margin = 0.05 * radius - (sqrt(out * out + last.z * last.z) - radius);
    return cost + (room > 0 ? 4 * room : 0) + (margin > 0 ? 4 * margin : 0);
}

static void ndli_route_try(const ndli_router *router, ndli_route *route)
{
    const ndl_plan_def *def = router->def;
    ndl_plan *plan = &route->plan;
    ndli_pose at = router->pose;
    ndli_v3 last = ndli_v(0, 0, 0);
    int clear = 1;
    ndli_plan_clear(plan);
    for (int i = 0; i < router->pieces && clear; i++) {
        double left = (double)def->max_length - (double)plan->length;
        ndl_plan_piece piece;
        if (i + 1 < router->pieces) {
            const double *x = route->number + 3 * i;
            double length = x[2] * router->reach / (router->pieces - 1);
            piece.turn = (sb_real)(def->turn ? 6.283185307179586 * (x[0] - 0.5) : 0);
            piece.twist = (sb_real)ndli_route_twist(x[1], (double)def->max_twist);
            piece.length = (sb_real)(length < left ? length : left);
        } else {
            ndli_search q = ndli_search_of(def, &at, router->target, left);
            ndli_search_run(&q);
            piece = ndli_search_piece(&q, 0);
            plan->boxes += q.boxes;
            last = q.g;
        }
        clear = ndli_plan_append(def, &router->field, &piece, &at, plan);
    }
    ndli_plan_finish(def, &at, router->target, plan);
    route->cost = ndli_route_cost(router, plan, last);
}

static void ndli_route_consider(const ndli_router *router, ndli_route *route, ndli_route *best, int *boxes)
{
    ndli_route_try(router, route);
    *boxes += route->plan.boxes;
    if (ndli_route_better(route, best))
        *best = *route;
}

/* Points of a Kronecker sequence: they fill the unit cube evenly, in any number of dimensions, with no random numbers.
 * */
static void ndli_route_sample(const ndli_router *router, ndli_route *best, int *boxes)
{
    double golden = router->pieces == 2 ? 1.2207440846057596 : 1.1127756842787055; /* x^(n + 1) = x + 1 */
    for (int i = 1; i <= router->def->samples; i++) {
        ndli_route route;
        double alpha = 1;
        memset(&route, 0, sizeof route);
        for (int j = 0; j < 3 * (router->pieces - 1); j++) {
            double x;
            alpha /= golden;
            x = 0.5 + alpha * i;
            route.number[j] = x - (int)x;
        }
        ndli_route_consider(router, &route, best, boxes);
    }
}

/* Goes to better neighbours, along one number at a time, in ever smaller steps. */
static void ndli_route_improve(const ndli_router *router, ndli_route *best, int *boxes)
{
    double step = 0.08;
    for (int round = 0; round < 6; round++, step *= 0.5)
        for (int j = 0; j < 3 * (router->pieces - 1); j++)
            for (int side = -1; side <= 1; side += 2) {
                ndli_route route = *best;
                double x = route.number[j] + side * step;
                route.number[j] = j % 3 == 0 ? x - (x >= 1) + (x < 0) : ndli_search_into(x, 0, 1);
                ndli_route_consider(router, &route, best, boxes);
            }
}

/* Better plans than *plan of two and, if need be, more pieces. */
static void ndli_plan_route(const ndl_plan_def *def, const ndli_field *field, const ndli_pose *pose, ndli_v3 target,
                            ndl_plan *plan)
{
    ndl_plan_def quick = *def;
    ndli_router router;
    ndli_route best;
    double most = (double)def->max_length, chord = ndli_norm(ndli_sub(target, pose->p));
    int boxes = plan->boxes;
    quick.max_boxes = def->max_boxes < 40 ? def->max_boxes : 40; /* for its rank among others a rough end will do */
    router.def = &quick;
    router.field = *field;
    router.pose = *pose;
    router.target = target;
    router.reach = chord < most ? chord : most;
    memset(&best, 0, sizeof best);
    best.plan = *plan;
    for (int n = 2; n <= def->max_pieces && best.plan.outcome != NDL_PLAN_REACHES; n++) {
        ndli_route found = best; /* its numbers mean something for n pieces only */
        router.pieces = n;
        ndli_route_sample(&router, &found, &boxes);
        if (found.plan.piece_count == n)
            ndli_route_improve(&router, &found, &boxes);
        best = found;
    }
    best.plan.boxes = boxes;
    best.plan.bound = plan->bound;
    *plan = best.plan;
}

/* One steady twist past obstacles, without turning. */
static void ndli_plan_thread(const ndl_plan_def *def, const ndli_field *field, const ndli_pose *pose, ndli_v3 target,
                             ndl_plan *plan)
{
    ndli_search q = ndli_search_of(def, pose, target, (double)def->max_length);
    ndl_plan found;
    ndl_plan_piece piece;
    ndli_pose at = *pose;
    q.field = field;
    ndli_search_run(&q);
    piece = ndli_search_piece(&q, 0);
    ndli_plan_clear(&found);
    ndli_plan_append(def, field, &piece, &at, &found);
    ndli_plan_finish(def, &at, target, &found);
    found.boxes = plan->boxes + q.boxes;
    found.bound = plan->bound;
    if (found.distance < plan->distance)
        *plan = found;
    else
        plan->boxes = found.boxes;
}

NDLI_API void ndli_plan_search(const ndl_plan_def *def, const ndli_pose *pose, ndli_v3 target, double sense,
                               ndl_plan *plan)
{
    ndli_field field = ndli_plan_field(def, (double)def->clearance, pose);
    if (ndli_plan_aim(def, (double)def->clearance, pose, NULL, 0, target, sense, plan) ||
        plan->outcome == NDL_PLAN_BLOCKED)
        return;
    if (!def->turn)
        ndli_plan_thread(def, &field, pose, target, plan);
    if (plan->outcome != NDL_PLAN_REACHES)
        ndli_plan_route(def, &field, pose, target, plan);
}

/* ---- the public side ---- */

NDL_API ndl_plan_def ndl_default_plan_def(sb_real curvature, sb_real max_length)
{
    ndl_plan_def def;
    memset(&def, 0, sizeof def);
    def.curvature = curvature;
    def.max_length = max_length;
    def.max_twist = 50 * curvature;
    def.turn = 1;
    def.tolerance = (sb_real)1e-3 / curvature;
    def.max_boxes = 5000;
    def.clearance = (sb_real)5e-3 / curvature;
    def.max_pieces = NDL_PLAN_PIECES;
    def.samples = 400;
    def.cookie = ndli_plan_cookie;
    return def;
}

static int ndli_plan_positive(sb_real x) { return x > 0 && x <= SB_REAL_MAX; }
static int ndli_plan_not_negative(sb_real x) { return x >= 0 && x <= SB_REAL_MAX; }

NDLI_API sb_result ndli_obstacle_check(const ndl_obstacle *o, int i, sb_error *error)
{
    if (o->kind < NDL_OBSTACLE_SPHERE || o->kind > NDL_OBSTACLE_SHAPE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle %d is of no such kind", i);
    if (o->kind == NDL_OBSTACLE_SHAPE) {
        if (!o->shape || (!o->shape->surface && !o->shape->distance))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle %d has no shape", i);
        if (!o->shape->surface && !ndli_plan_positive(o->shape->max_slope))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle %d: the function needs a max_slope above 0", i);
        return SB_OK;
    }
    if (!sb_v3_is_finite(o->a) || (o->kind != NDL_OBSTACLE_SPHERE && !sb_v3_is_finite(o->b)))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "obstacle %d is not finite", i);
    if (!ndli_plan_positive(o->radius))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle %d: radius must be finite and above 0", i);
    if (o->kind == NDL_OBSTACLE_CYLINDER && !(ndli_norm(ndli_sub(ndli_from(o->b), ndli_from(o->a))) > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle %d: the ends of the cylinder coincide", i);
    return SB_OK;
}

NDLI_API sb_result ndli_plan_check(const ndl_plan_def *def, sb_error *error)
{
    if (def->cookie != ndli_plan_cookie)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the plan def does not come from ndl_default_plan_def()");
    if (!ndli_plan_positive(def->curvature) || !ndli_plan_positive(def->max_length))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "curvature and max_length must be finite and above 0");
    if (!ndli_plan_not_negative(def->max_twist) || !ndli_plan_not_negative(def->clearance))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_twist and clearance must be finite and not negative");
    if (!(def->tolerance >= (sb_real)1e-6 * def->max_length) || !(def->tolerance <= def->max_length))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "tolerance must be between 1e-6 of max_length and max_length");
    if (def->turn != 0 && def->turn != 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "turn must be 0 or 1");
    if (def->max_boxes < 1 || def->samples < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_boxes and samples must be at least 1");
    if (def->max_pieces < 1 || def->max_pieces > NDL_PLAN_PIECES)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_pieces must be between 1 and %d", NDL_PLAN_PIECES);
    if (def->obstacle_count < 0 || (def->obstacle_count > 0 && !def->obstacles))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle_count is negative, or there are no obstacles to count");
    for (int i = 0; i < def->obstacle_count; i++) {
        sb_result result = ndli_obstacle_check(def->obstacles + i, i, error);
        if (result != SB_OK)
            return result;
    }
    return SB_OK;
}

NDL_API sb_result ndl_plan_make(const ndl_plan_def *def, const ndl_tip_pose *tip, sb_vec3 target, ndl_plan *plan,
                                sb_error *error)
{
    ndli_pose pose;
    sb_result result;
    if (!def || !tip || !plan)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def, tip or plan is NULL");
    result = ndli_plan_check(def, error);
    if (result != SB_OK)
        return result;
    result = ndli_pose_read(tip, &pose);
    if (result != SB_OK)
        return sbi_fail(error, result,
                        result == SB_ERROR_NOT_FINITE ? "the tip is not finite" : "the tip's frame is not orthonormal");
    if (!sb_v3_is_finite(target))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the target is not finite");
    ndli_plan_search(def, &pose, ndli_from(target), 0, plan);
    return SB_OK;
}

NDL_API ndl_tip_pose ndl_plan_pose(const ndl_plan *plan, sb_real curvature, const ndl_tip_pose *tip, sb_real length)
{
    ndl_tip_pose none;
    ndli_pose pose;
    double left = (double)length;
    if (!plan || !tip) {
        memset(&none, 0, sizeof none);
        return none;
    }
    pose.p = ndli_from(tip->position);
    pose.m1 = ndli_from(tip->frame.m1);
    pose.m2 = ndli_from(tip->frame.m2);
    pose.t = ndli_from(tip->frame.t);
    for (int i = 0; i < plan->piece_count && (i == 0 || left > 0); i++) {
        double whole = (double)plan->pieces[i].length;
        pose = ndli_plan_follow(&pose, (double)curvature, plan->pieces + i, ndli_search_into(left, 0, whole));
        left -= whole;
    }
    return ndli_pose_write(&pose);
}
