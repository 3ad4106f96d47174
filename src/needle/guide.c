/* guide: straight paths past tissue that is pushed aside, by chance and climbing. */
#include "guide.h"
#include "steer_path.h"
#include "steer_push.h"

enum {
    NDLI_GUIDE_SCAN = 64,     /* points of a path at which obstacles are looked for */
    NDLI_GUIDE_MOST = 1000000 /* paths of either kind */
};

static const unsigned ndli_guide_cookie = 0x67756931u;

NDL_API ndl_guide_def ndl_default_guide_def(sb_vec3 target, sb_vec3 entry, sb_vec3 direction)
{
    sb_real distance = sb_v3_norm(sb_v3_sub(target, entry));
    ndl_guide_def def;
    memset(&def, 0, sizeof def);
    def.target = target;
    def.entry = entry;
    def.direction = direction;
    def.entry_radius = def.shift = distance / 10;
    def.max_lean = (sb_real)0.6;
    def.clearance = distance / 50;
    def.tolerance = distance / 200;
    def.samples = 200;
    def.climbs = 100;
    def.cookie = ndli_guide_cookie;
    return def;
}

/* ---- arguments ---- */

static int ndli_guide_positive(sb_real x) { return x > 0 && x <= SB_REAL_MAX; }
static int ndli_guide_not_negative(sb_real x) { return x >= 0 && x <= SB_REAL_MAX; }

static sb_result ndli_guide_check_place(const ndl_push_place *place, int i, sb_error *error)
{
    if (!sb_v3_is_finite(place->direction))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the direction of place %d is not finite", i);
    if (!(place->cone >= 0) || !(place->cone <= (sb_real)1.5707964))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the cone of place %d must be between 0 and pi/2", i);
    if (!ndli_guide_positive(place->max_force) || !ndli_guide_positive(place->weight))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_force and weight of place %d must be finite and above 0", i);
    return SB_OK;
}

static sb_result ndli_guide_check_lists(const ndl_guide_def *def, sb_error *error)
{
    sb_result result = SB_OK;
    if (def->obstacle_count < 0 || (def->obstacle_count > 0 && !def->obstacles))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle_count is negative, or there are no obstacles to count");
    if (def->place_count < 0 || def->place_count > NDL_GUIDE_PLACES ||
        (def->place_count > 0 && (!def->places || !def->model)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "place_count is not in 0 ... %d, or places or model are missing",
                        NDL_GUIDE_PLACES);
    for (int i = 0; i < def->obstacle_count && result == SB_OK; i++)
        result = ndli_obstacle_check(def->obstacles + i, i, error);
    for (int i = 0; i < def->place_count && result == SB_OK; i++)
        result = ndli_guide_check_place(def->places + i, i, error);
    return result;
}

static sb_result ndli_guide_check(const ndl_guide_def *def, sb_error *error)
{
    ndli_v3 way;
    if (def->cookie != ndli_guide_cookie)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def does not come from ndl_default_guide_def()");
    if (!sb_v3_is_finite(def->target) || !sb_v3_is_finite(def->entry) || !sb_v3_is_finite(def->direction))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "target, entry or direction is not finite");
    way = ndli_sub(ndli_from(def->target), ndli_from(def->entry));
    if (!(ndli_norm(ndli_from(def->direction)) > 0) || !(ndli_dot(way, ndli_from(def->direction)) > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the target does not lie before the entry, in its direction");
    if (!ndli_guide_not_negative(def->entry_radius) || !ndli_guide_not_negative(def->shift) || !(def->max_lean >= 0) ||
        !(def->max_lean <= (sb_real)1.5))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "entry_radius and shift must not be negative, max_lean between 0 and 1.5");
    if (!ndli_guide_positive(def->clearance) || !ndli_guide_positive(def->tolerance))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "clearance and tolerance must be finite and above 0");
    if (def->samples < 1 || def->samples > NDLI_GUIDE_MOST || def->climbs < 0 || def->climbs > NDLI_GUIDE_MOST)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "samples must be 1 ... %d, climbs 0 ... %d", NDLI_GUIDE_MOST,
                        NDLI_GUIDE_MOST);
    return ndli_guide_check_lists(def, error);
}

/* ---- one path ---- */

/* A path by four numbers: where it goes through the entry's disc and past the target, in radii. */
typedef struct ndli_guide_path {
    double z[4];
    ndli_v3 entry, t;
    double length; /* to beside the target at rest */
} ndli_guide_path;

/* A place where an obstacle is deepest in the cylinder about a path. */
typedef struct ndli_guide_point {
    ndli_v3 at, out; /* on the path; the way that the path would have to go, unit */
    double distance; /* of the obstacle from the path, negative: the path goes through it */
    int obstacle;
} ndli_guide_point;

typedef struct ndli_guide_work {
    const ndl_guide_def *def;
    sb_error *error;
    double penalty;   /* N/m of what is left: half a tolerance's worth costs as much as all forces together */
    sb_result result; /* of the model */
} ndli_guide_work;

/* Two directions across another. */
static void ndli_guide_across(ndli_v3 t, ndli_v3 *a, ndli_v3 *b)
{
    *a = ndli_from(sb_v3_perpendicular(ndli_to(t)));
    *a = ndli_madd(*a, -ndli_dot(*a, t), t);
    *a = ndli_scale(1 / ndli_norm(*a), *a);
    *b = ndli_cross(t, *a);
}

/* 0: it leans too much. */
static int ndli_guide_path_of(const ndl_guide_def *def, const double z[4], ndli_guide_path *path)
{
    ndli_v3 middle = ndli_from(def->direction), target = ndli_from(def->target), a, b, aim;
    double sine, cosine;
    middle = ndli_scale(1 / ndli_norm(middle), middle);
    memcpy(path->z, z, sizeof path->z);
    ndli_guide_across(middle, &a, &b);
    path->entry = ndli_madd(ndli_from(def->entry), (double)def->entry_radius * z[0], a);
    path->entry = ndli_madd(path->entry, (double)def->entry_radius * z[1], b);
    aim = ndli_sub(target, path->entry);
    if (!(ndli_dot(aim, middle) > 0))
        return 0;
    aim = ndli_scale(1 / ndli_norm(aim), aim);
    ndli_guide_across(aim, &a, &b);
    aim = ndli_madd(target, (double)def->shift * z[2], a);
    aim = ndli_sub(ndli_madd(aim, (double)def->shift * z[3], b), path->entry);
    path->t = ndli_scale(1 / ndli_norm(aim), aim);
    path->length = ndli_dot(ndli_sub(target, path->entry), path->t);
    sbi_dense_sin_cos((double)def->max_lean, &sine, &cosine);
    return path->length > 0 && ndli_dot(path->t, middle) >= cosine - 1e-9;
}

/* One that is no number is as far within the obstacle as the target is away. */
static double ndli_guide_distance(const ndl_guide_def *def, int obstacle, ndli_v3 p)
{
    double distance = (double)ndl_obstacle_distance(def->obstacles + obstacle, ndli_to(p));
    return distance == distance ? distance : -ndli_norm(ndli_sub(ndli_from(def->target), ndli_from(def->entry)));
}

/* The way out of an obstacle at a point, across the path; any where it has none. */
static ndli_v3 ndli_guide_way_out(const ndl_guide_def *def, int obstacle, ndli_v3 p, ndli_v3 t)
{
    double h = 0.1 * (double)def->clearance, slope[2], size;
    ndli_v3 axes[2];
    ndli_guide_across(t, axes, axes + 1);
    for (int k = 0; k < 2; k++)
        slope[k] = ndli_guide_distance(def, obstacle, ndli_madd(p, h, axes[k])) -
                   ndli_guide_distance(def, obstacle, ndli_madd(p, -h, axes[k]));
    size = sqrt(slope[0] * slope[0] + slope[1] * slope[1]);
    if (!(size > 1e-6 * h)) /* straight at its middle */
        return axes[0];
    return ndli_add(ndli_scale(slope[0] / size, axes[0]), ndli_scale(slope[1] / size, axes[1]));
}

/* Puts a point among the deepest, which are first. */
static int ndli_guide_insert(ndli_guide_point *points, int count, const ndli_guide_point *point)
{
    int at = count < NDL_GUIDE_PHASES - 1 ? count : count - 1;
    if (count == NDL_GUIDE_PHASES - 1 && point->distance >= points[at].distance)
        return count;
    while (at > 0 && points[at - 1].distance > point->distance) {
        points[at] = points[at - 1];
        at--;
    }
    points[at] = *point;
    return count < NDL_GUIDE_PHASES - 1 ? count + 1 : count;
}

/* Points of interest of a path at rest, deepest first; returns how many. */
static int ndli_guide_find(const ndl_guide_def *def, const ndli_guide_path *path, ndli_guide_point *points)
{
    int count = 0;
    for (int o = 0; o < def->obstacle_count; o++) {
        double d[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL};
        for (int i = 0; i <= NDLI_GUIDE_SCAN; i++) {
            ndli_guide_point point;
            d[0] = d[1], d[1] = d[2];
            d[2] = i < NDLI_GUIDE_SCAN
                       ? ndli_guide_distance(def, o,
                                             ndli_madd(path->entry, path->length * i / (NDLI_GUIDE_SCAN - 1), path->t))
                       : HUGE_VAL;
            if (!(d[1] < (double)def->clearance) || d[0] < d[1] || d[2] <= d[1])
                continue;
            point.at = ndli_madd(path->entry, path->length * (i - 1) / (NDLI_GUIDE_SCAN - 1), path->t);
            point.out = ndli_guide_way_out(def, o, point.at, path->t);
            point.distance = d[1];
            point.obstacle = o;
            count = ndli_guide_insert(points, count, &point);
        }
    }
    return count;
}

/* ---- pushes ---- */

/* How the forces of all phases but one (-1: of all) displace a point, by the model. */
static ndli_v3 ndli_guide_moved(ndli_guide_work *w, const ndl_guide *guide, int but, ndli_v3 point)
{
    ndli_v3 moved = ndli_v(0, 0, 0);
    for (int k = 0; k < guide->phase_count; k++) {
        const ndl_guide_phase *phase = guide->phases + k;
        sb_mat3 c;
        if (k == but || phase->place < 0 || !w->def->model(w->def->user, ndli_to(point), phase->place, &c))
            continue;
        moved = ndli_add(moved, ndli_from(sb_m3_apply(c, phase->force)));
    }
    if (!sb_v3_is_finite(ndli_to(moved)))
        w->result = sbi_fail(w->error, SB_ERROR_NOT_FINITE, "the model's compliance is not finite");
    return moved;
}

static void ndli_guide_begin(const ndl_guide_def *def, const ndli_guide_path *path, int obstacle,
                             ndl_guide_phase *phase)
{
    memset(phase, 0, sizeof *phase);
    phase->push = ndl_default_push_def();
    phase->push.tolerance = def->tolerance;
    phase->push.line_direction = ndli_to(path->t);
    phase->push.line_point = ndli_to(path->entry);
    phase->point = def->target;
    phase->obstacle = obstacle;
    phase->place = -1;
}

/* A point of interest lies on the obstacle's side that is farthest out and has to go beyond a plane beside the path,
 * which is as far from it as the clearance and `more` (m). A wide cylinder is as good as a plane, and lets the point
 * slide along it. */
static void ndli_guide_ask(const ndl_guide_def *def, const ndli_guide_point *point, double more, ndl_guide_phase *phase)
{
    double clear = (double)def->clearance + more, depth = clear - point->distance, radius = 10 * depth + clear;
    phase->point = ndli_to(ndli_madd(point->at, -point->distance, point->out));
    phase->push.clear_radius = (sb_real)radius;
    phase->push.line_point = ndli_to(ndli_madd(point->at, radius - clear, point->out));
}

/* The way that the point of a phase has still to go, the others pushing. */
static ndli_v3 ndli_guide_wanted(ndli_guide_work *w, const ndl_guide *guide, int k)
{
    const ndl_guide_phase *phase = guide->phases + k;
    ndli_v3 X = ndli_from(phase->point);
    return ndli_push_error(&phase->push, ndli_add(X, ndli_guide_moved(w, guide, k, X)));
}

static int ndli_guide_used(const ndl_guide *guide, int place)
{
    for (int k = 0; k < guide->phase_count; k++)
        if (guide->phases[k].place == place)
            return 1;
    return 0;
}

/* The place that does it with least force, or that leaves least. */
static void ndli_guide_choose(ndli_guide_work *w, const ndl_guide *guide, ndli_v3 wanted, ndl_guide_phase *phase)
{
    const ndl_guide_def *def = w->def;
    double best = HUGE_VAL;
    for (int i = 0; i < def->place_count; i++) {
        const ndl_push_place *place = def->places + i;
        ndl_push_def push = phase->push;
        ndli_v3 force;
        double left, cost;
        if (ndli_guide_used(guide, i) || !def->model(def->user, phase->point, i, &push.compliance))
            continue;
        push.direction = place->direction;
        push.cone = place->cone;
        push.max_force = place->max_force;
        push = ndli_push_unit(&push);
        left = ndli_push_try(&push, &push.compliance, wanted, &force);
        if (!ndli_is_finite(left)) {
            w->result = sbi_fail(w->error, SB_ERROR_NOT_FINITE, "the model's compliance for place %d is not finite", i);
            return;
        }
        cost = (double)place->weight * ndli_norm(force) + w->penalty * fmax(0, left - 0.5 * (double)def->tolerance);
        if (!(cost < best) || !(ndli_norm(force) > 0))
            continue;
        best = cost;
        phase->push = push;
        phase->place = i;
        phase->force = ndli_to(force);
    }
}

/* The force of a phase, the others' being as they are; first of all its place. */
static void ndli_guide_relax(ndli_guide_work *w, ndl_guide *guide, int k)
{
    ndl_guide_phase *phase = guide->phases + k;
    ndli_v3 wanted = ndli_guide_wanted(w, guide, k), force;
    if (phase->place < 0 && ndli_norm(wanted) > 0.25 * (double)w->def->tolerance) {
        ndli_guide_choose(w, guide, wanted, phase);
    } else if (phase->place >= 0) {
        ndli_push_try(&phase->push, &phase->push.compliance, wanted, &force);
        phase->force = ndli_to(force);
    }
}

/* Distance of an obstacle (-1: of the nearest) from the path, as all forces have moved it: from the material points
 * that now lie on the path. */
static double ndli_guide_clearance(ndli_guide_work *w, const ndl_guide *guide, const ndli_guide_path *path,
                                   double least[NDL_GUIDE_PHASES])
{
    double nearest = (double)SB_REAL_MAX;
    for (int k = 0; k < NDL_GUIDE_PHASES; k++)
        least[k] = (double)SB_REAL_MAX;
    for (int i = 0; i < NDLI_GUIDE_SCAN && w->def->obstacle_count > 0; i++) {
        ndli_v3 x = ndli_madd(path->entry, path->length * i / (NDLI_GUIDE_SCAN - 1), path->t);
        ndli_v3 X = ndli_sub(x, ndli_guide_moved(w, guide, -1, x)); /* X + u(X) = x by two steps */
        X = ndli_sub(x, ndli_guide_moved(w, guide, -1, X));
        for (int o = 0; o < w->def->obstacle_count; o++) {
            double d = ndli_guide_distance(w->def, o, X);
            nearest = fmin(nearest, d);
            for (int k = 0; k < guide->phase_count; k++)
                if (guide->phases[k].obstacle == o)
                    least[k] = fmin(least[k], d);
        }
    }
    return nearest;
}

/* The phases of a path, nothing being pushed yet. */
static void ndli_guide_list(const ndl_guide_def *def, const ndli_guide_path *path, const ndli_guide_point *points,
                            int count, ndl_guide *guide)
{
    memset(guide, 0, sizeof *guide);
    guide->entry = ndli_to(path->entry);
    guide->direction = ndli_to(path->t);
    guide->phase_count = count + 1;
    for (int k = 0; k <= count; k++) {
        ndl_guide_phase *phase = guide->phases + k;
        ndli_guide_begin(def, path, k < count ? points[k].obstacle : -1, phase);
        if (k < count)
            ndli_guide_ask(def, points + k, 0, phase);
        phase->depth = (sb_real)ndli_norm(ndli_push_error(&phase->push, ndli_from(phase->point)));
    }
}

/* What all forces leave, and what they cost; returns both as one cost (N): a path that does not reach costs more than
 * all forces together. */
static double ndli_guide_judge(ndli_guide_work *w, ndli_guide_path *path, ndl_guide *guide,
                               double least[NDL_GUIDE_PHASES])
{
    const ndl_guide_def *def = w->def;
    double tolerance = (double)def->tolerance, late = 0, close;
    guide->cost = 0;
    for (int k = 0; k < guide->phase_count; k++) {
        ndl_guide_phase *phase = guide->phases + k;
        ndli_v3 X = ndli_from(phase->point), x = ndli_add(X, ndli_guide_moved(w, guide, -1, X));
        phase->left = (sb_real)ndli_norm(ndli_push_error(&phase->push, x));
        if (phase->place >= 0)
            guide->cost += def->places[phase->place].weight * sb_v3_norm(phase->force);
        if (phase->obstacle < 0) {
            late = fmax(0, (double)phase->left - tolerance);
            path->length = ndli_dot(ndli_sub(x, path->entry), path->t);
        }
    }
    guide->length = (sb_real)path->length;
    guide->clearance = (sb_real)ndli_guide_clearance(w, guide, path, least);
    close = fmax(0, (double)def->clearance - tolerance - (double)guide->clearance);
    guide->reaches = late == 0 && close == 0 && path->length > 0;
    return (double)guide->cost + w->penalty * (late + close + (guide->reaches ? 0 : 0.5 * tolerance));
}

/* The plan of a path: forces are taken one after another, each as the others ask for, until they agree; obstacles are
 * asked to go farther where that leaves them too near. Returns its cost. */
static double ndli_guide_plan(ndli_guide_work *w, const double z[4], ndl_guide *guide)
{
    const int rounds = 4, sweeps = 4;
    ndli_guide_path path;
    ndli_guide_point points[NDL_GUIDE_PHASES];
    double more[NDL_GUIDE_PHASES] = {0}, least[NDL_GUIDE_PHASES], best = HUGE_VAL, lacks = HUGE_VAL;
    ndl_guide tried;
    int count;
    if (!ndli_guide_path_of(w->def, z, &path))
        return HUGE_VAL;
    count = ndli_guide_find(w->def, &path, points);
    ndli_guide_list(w->def, &path, points, count, &tried);
    for (int r = 0; r < rounds && lacks > 0.5 * (double)w->def->tolerance; r++) {
        double cost;
        for (int n = 0; n < sweeps * (count + 1) && w->result == SB_OK; n++)
            ndli_guide_relax(w, &tried, n % (count + 1));
        cost = ndli_guide_judge(w, &path, &tried, least);
        if (cost < best) {
            best = cost;
            *guide = tried;
        }
        lacks = (double)tried.phases[count].left - 0.5 * (double)w->def->tolerance;
        for (int k = 0; k < count; k++) {
            double lack = (double)w->def->clearance - least[k];
            more[k] += fmax(0, lack);
            lacks = fmax(lacks, lack);
            ndli_guide_ask(w->def, points + k, more[k], tried.phases + k);
        }
    }
    return best;
}

/* ---- the search ---- */

/* Evenly spread in [-1, 1], the same on every machine (splitmix64). */
static double ndli_guide_random(uint64_t *seed)
{
    uint64_t z = *seed += UINT64_C(0x9e3779b97f4a7c15);
    z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
    return 2 * ((double)((z ^ z >> 31) >> 11) / 9007199254740992.0) - 1;
}

/* Into the unit discs of entry and target. */
static void ndli_guide_bound(double z[4])
{
    for (int k = 0; k < 4; k += 2) {
        double size = sqrt(z[k] * z[k] + z[k + 1] * z[k + 1]);
        if (size > 1)
            z[k] /= size, z[k + 1] /= size;
    }
}

static void ndli_guide_search(ndli_guide_work *w, ndl_guide *guide)
{
    uint64_t seed = w->def->seed;
    double best = HUGE_VAL, now[4] = {0, 0, 0, 0}, reach = 0.5;
    for (int i = 0; i < w->def->samples + w->def->climbs && w->result == SB_OK; i++) {
        ndl_guide tried;
        double z[4], cost;
        int climbs = i >= w->def->samples;
        for (int k = 0; k < 4; k++)
            z[k] = i == 0 ? 0 : climbs ? now[k] + reach * ndli_guide_random(&seed) : ndli_guide_random(&seed);
        ndli_guide_bound(z);
        cost = ndli_guide_plan(w, z, &tried);
        if (cost < best) {
            best = cost;
            memcpy(now, z, sizeof now);
            *guide = tried;
        } else if (climbs) {
            reach *= 0.95;
        }
    }
}

NDL_API sb_result ndl_guide_make(const ndl_guide_def *def, ndl_guide *guide, sb_error *error)
{
    ndli_guide_work w;
    ndl_guide found;
    sb_result result;
    double most = 0;
    if (!def || !guide)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def or guide is NULL");
    result = ndli_guide_check(def, error);
    if (result != SB_OK)
        return result;
    memset(&w, 0, sizeof w);
    memset(&found, 0, sizeof found);
    w.def = def;
    w.error = error;
    for (int i = 0; i < def->place_count; i++)
        most += (double)def->places[i].weight * (double)def->places[i].max_force;
    w.penalty = (most > 0 ? 2 * most : 1) / (double)def->tolerance;
    if (!(w.penalty <= (double)SB_REAL_MAX))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "weights and max_force of the places come to %g N over a tolerance "
                        "of %g m: too much",
                        most, (double)def->tolerance);
    ndli_guide_search(&w, &found);
    if (w.result != SB_OK)
        return w.result;
    if (found.phase_count == 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "no path leans less than max_lean");
    *guide = found;
    return SB_OK;
}
