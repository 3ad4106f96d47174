/* step_solve: the linear system of an iteration is solved: once, or again and again with what touches the body. */
#include <math.h>
#include <string.h>

#include "step_private.h"

enum { SBI_TOUCH_CUTS = 8 }; /* evaluations of a line search */

static double sbi_touch_dot(const sbi_touch *touch, const sb_vec3 *a, const sb_vec3 *b)
{
    double sum = 0;
    for (int k = 0; k < touch->node_count; k++)
        sum += (double)a[k].x * (double)b[k].x + (double)a[k].y * (double)b[k].y + (double)a[k].z * (double)b[k].z;
    return sum;
}

/* Norm on axes without supports (N). */
static double sbi_touch_norm(const sb_body *b, const sb_vec3 *a)
{
    double sum = 0;
    for (int k = 0; k < b->touch->node_count; k++) {
        sb_vec3 v = sbi_body_pick_axes(b->fixed[b->touch->nodes[k]], sb_v3(0, 0, 0), a[k]);
        sum += (double)v.x * (double)v.x + (double)v.y * (double)v.y + (double)v.z * (double)v.z;
    }
    return sqrt(sum);
}

/* The system without contact again, and then with it as it was evaluated last. */
static void sbi_step_renew_touch(sbi_step *step)
{
    sb_body *b = step->body;
    sbi_touch *touch = step->touch;
    touch->restore_blocks(touch->user, &b->matrix);
    if (b->elimination) {
        sbi_step_fill_system(step);
        return;
    }
    for (int k = 0; k < touch->node_count; k++)
        b->rhs[touch->nodes[k]] = touch->kept[k];
    sbi_step_add_touch(step);
}

/* ---- how much of a new increment is taken ---- */

/* The force (N) that what is left over is compared with: contact's, or what was out of balance where motion went on as
 * it was. Not M v / dt, beside which contact of a body that flies fast would be nothing. */
static double sbi_step_touch_scale(const sbi_step *step)
{
    return fmax(step->body->pcg.record->begun, sbi_touch_norm(step->body, step->touch->force));
}

/* What contact's forces differ by from those that the solve had. */
typedef struct sbi_touch_change {
    double norm; /* N */
    sb_vec3 sum; /* N */
} sbi_touch_change;

static sbi_touch_change sbi_step_touch_change_of(const sbi_step *step)
{
    const sbi_touch *touch = step->touch;
    sbi_touch_change change = {0, {0, 0, 0}};
    for (int k = 0; k < touch->node_count; k++) {
        unsigned char fixed = step->body->fixed[touch->nodes[k]];
        sb_vec3 v = sbi_body_pick_axes(fixed, sb_v3(0, 0, 0), sb_v3_sub(touch->left[k], touch->force[k]));
        change.norm += (double)v.x * (double)v.x + (double)v.y * (double)v.y + (double)v.z * (double)v.z;
        change.sum = sb_v3_add(change.sum, v);
    }
    change.norm = sqrt(change.norm);
    return change;
}

/* Forces from outside, in magnitude (N): what a body that nothing holds keeps its momentum to a share of. */
static double sbi_step_touch_outside(const sbi_step *step)
{
    const sb_body *b = step->body;
    double sum = 0;
    for (int k = 0; k < step->touch->node_count; k++)
        sum += (double)sb_v3_norm(step->touch->force[k]);
    for (int i = 0; i < b->domain.node_count; i++)
        sum += (double)sb_v3_norm(b->external[i]);
    return sum;
}

/* What a change of their sum is a share of: at least of some of what was out of balance within. */
static double sbi_step_touch_sum_scale(const sbi_step *step)
{
    const sb_body *b = step->body;
    double within = SBI_PCG_WITHIN * sqrt((double)b->domain.node_count) * b->pcg.record->begun;
    return fmax(sbi_step_touch_outside(step), within);
}

static double sbi_step_touch_share_of(double change, double scale)
{
    return scale > (double)SB_EPSILON * change ? change / scale
                                               : 1 / (double)SB_EPSILON; /* forces may be next to none */
}

/* The same of the largest force, or where nothing holds the body 2.5 times their sum of forces from outside, since what
 * the solve leaves is beside it; 0 where it is rounding. */
static double sbi_step_touch_residual(const sbi_step *step)
{
    sbi_touch_change change = sbi_step_touch_change_of(step);
    int held = SB_XYZ & ~step->body->pcg.record->loose;
    double share;
    if (!(change.norm > step->touch->noise))
        return 0;
    share = sbi_step_touch_share_of(change.norm, sbi_step_touch_scale(step));
    if (held == SB_XYZ)
        return share;
    change.sum = sbi_body_pick_axes((unsigned char)held, sb_v3(0, 0, 0), change.sum);
    return fmax(share, 2.5 * sbi_step_touch_share_of((double)sb_v3_norm(change.sum), sbi_step_touch_sum_scale(step)));
}

/* Slope of the potential at a share of the way from the increment before: that of its linear part is `end` at the way's
 * end, and rises evenly by `rise` to there. */
static double sbi_step_touch_slope(sbi_step *step, double end, double rise, double share)
{
    const sb_body *b = step->body;
    sbi_touch *touch = step->touch;
    for (int k = 0; k < touch->node_count; k++)
        touch->du[k] = sb_v3_madd(b->previous[touch->nodes[k]], (sb_real)share, touch->way[k]);
    touch->evaluate(touch->user, touch->du, 0);
    return end - (1 - share) * rise - sbi_touch_dot(touch, touch->force, touch->way);
}

/* Where the slope vanishes, to a tenth of what it was at 0: false position, in which an end that stays counts half. */
static double sbi_step_touch_root(sbi_step *step, double end, double rise, double at0, double at1)
{
    double low = 0, high = 1, slope_low = at0, slope_high = at1, share = 1;
    int side = 0;
    for (int i = 0; i < SBI_TOUCH_CUTS; i++) {
        double slope;
        share = (low * slope_high - high * slope_low) / (slope_high - slope_low);
        slope = sbi_step_touch_slope(step, end, rise, share);
        if (fabs(slope) <= -0.1 * at0)
            break;
        if (slope > 0) {
            slope_low *= side > 0 ? 0.5 : 1;
            high = share, slope_high = slope, side = 1;
        } else {
            slope_high *= side < 0 ? 0.5 : 1;
            low = share, slope_low = slope, side = -1;
        }
    }
    return share;
}

/* way.(A + K + G) way, of the whole system that was solved; way [rows] is in body->work. */
static double sbi_step_touch_rise(const sbi_step *step)
{
    sb_body *b = step->body;
    const sb_matrix *matrix = b->elimination ? &b->elimination->matrix : &b->matrix;
    double sum = 0;
    sb_matrix_multiply(matrix, &b->work[0].x, &b->work2[0].x, &b->jobs);
    if (sbi_body_has_links(b))
        (void)sbi_body_multiply_links(b, &b->work[0].x, &b->work2[0].x);
    for (int i = 0; i < b->domain.node_count; i++)
        sum += (double)b->work[i].x * (double)b->work2[i].x + (double)b->work[i].y * (double)b->work2[i].y +
               (double)b->work[i].z * (double)b->work2[i].z;
    return sum + sbi_step_guest_rise(step, b->work);
}

/* touch->way, and body->work without slaves, = what the solve added to the increment; touch->left = F + K x of the
 * system less K x' */
static void sbi_step_measure_way(sbi_step *step)
{
    sb_body *b = step->body;
    sbi_touch *touch = step->touch;
    for (int k = 0; k < touch->node_count; k++)
        touch->du[k] = b->increment[touch->nodes[k]];
    touch->multiply(touch->user, sbi_step_touch_mask(b), touch->du, touch->left);
    for (int k = 0; k < touch->node_count; k++) {
        touch->left[k] = sb_v3_sub(touch->linear[k], touch->left[k]);
        touch->way[k] = sb_v3_sub(touch->du[k], b->previous[touch->nodes[k]]);
    }
    for (int i = 0; i < b->domain.node_count; i++)
        b->work[i] = sb_v3_sub(b->increment[i], b->previous[i]);
    if (b->elimination)
        sbi_elimination_clear_slaves(b->elimination, b->work);
}

/* Takes so much of the way that the potential does not rise at its end: contact that closes on the way makes a whole
 * increment overshoot, and a free block is thrown away by it. An end whose forces are those that were solved for needs
 * no search: slopes are rounding there. Returns the share. */
static double sbi_step_search_touch(sbi_step *step, sb_real tolerance)
{
    sb_body *b = step->body;
    sbi_touch *touch = step->touch;
    double own, end, at1, whole, share;
    sbi_step_measure_way(step);
    touch->multiply(touch->user, sbi_step_touch_mask(b), touch->way, touch->du);
    own = sbi_touch_dot(touch, touch->way, touch->du);
    end = sbi_touch_dot(touch, touch->way, touch->left);
    at1 = sbi_step_touch_slope(step, end, 0, 1);
    if (!(at1 > 0.1 * own) || sbi_step_touch_residual(step) <= (double)tolerance)
        return 1;
    whole = sbi_step_touch_rise(step);
    if (!(at1 > 0.1 * whole))
        return 1;
    share = sbi_step_touch_root(step, end, whole - own, -whole, at1);
    for (int i = 0; i < b->domain.node_count; i++)
        b->increment[i] = sb_v3_madd(b->previous[i], (sb_real)share, b->work[i]);
    if (b->elimination)
        sbi_elimination_expand(b->elimination, b->increment, step->opens_gaps);
    sbi_step_shorten_guests(step, share);
    return share;
}

/* ---- the iteration ---- */

/* Forces at the new increment, with friction's bounds of there. */
static void sbi_step_end_way(sbi_step *step)
{
    sbi_step_evaluate_touch(step, step->body->increment, 1, 1);
    step->touch->residual = (sb_real)sbi_step_touch_residual(step);
}

/* How much of contact's forces at the first guess is new since the step before: 0 at rest, 1 where they are others. */
static sb_real sbi_step_touch_news(const sbi_step *step)
{
    sb_body *b = step->body;
    const sbi_touch *touch = step->touch;
    double sum = 0, size = sbi_touch_norm(b, touch->force);
    for (int k = 0; k < touch->node_count; k++)
        b->work[touch->nodes[k]] = sb_v3(0, 0, 0);
    touch->add_done(touch->user, 1, b->work);
    for (int k = 0; k < touch->node_count; k++) {
        sb_vec3 v = sb_v3_sub(touch->force[k], b->work[touch->nodes[k]]);
        v = sbi_body_pick_axes(b->fixed[touch->nodes[k]], sb_v3(0, 0, 0), v);
        sum += (double)v.x * (double)v.x + (double)v.y * (double)v.y + (double)v.z * (double)v.z;
    }
    return size > 0 ? (sb_real)fmin(1, sqrt(sum) / size) : 0;
}

/* What this system is solved to: a share of what its forces will yet change by, the last as well as the step asks. Of
 * forces that are new the first system leaves some tenth. Where bounds were foreseen each leaves some seventh of what
 * the one before left: one that may be the last is solved as such. */
static sb_real sbi_step_touch_aim(const sbi_step *step)
{
    const sbi_touch *touch = step->touch;
    const sb_real share = (sb_real)0.3, last = touch->foresees ? (sb_real)3 : 1;
    sb_real tolerance = step->linear_tolerance, expected;
    if (touch->touching == 0 || touch->iterations == touch->max_iterations)
        return tolerance;
    expected = touch->iterations > 1 ? touch->residual : (sb_real)0.1 * sbi_step_touch_news(step);
    return share * expected > last * tolerance ? share * expected : tolerance;
}

/* The last systems are asked for momentum, unless nothing has touched. */
static double sbi_step_demand_outside(const sbi_step *step, sb_real aim)
{
    const sbi_touch *touch = step->touch;
    int opened = touch->touching == 0 && touch->iterations > 1;
    if (aim > step->linear_tolerance || (touch->touching == 0 && !opened))
        return -1;
    return sbi_step_touch_outside(step) + (opened ? step->body->pcg.record->met : 0);
}

/* What a system may leave is a share of what the step's tolerance admits: contact's forces are to have theirs. */
static sb_result sbi_step_solve_next(sbi_step *step, sb_real aim, int goes_on)
{
    const sb_real share = (sb_real)0.3;
    const sbi_touch *touch = step->touch;
    sbi_pcg_demand demand;
    demand.current = touch->iterations == 1;
    demand.later = touch->iterations > 1;
    demand.goes_on = goes_on;
    demand.is_touched = touch->touching > 0;
    demand.node_count = step->body->elimination ? 0 : touch->node_count; /* slaves' forces are their masters' */
    demand.nodes = touch->nodes;
    demand.force = touch->force;
    demand.outside = sbi_step_demand_outside(step, aim);
    demand.bend = NULL;
    return sbi_step_solve_once(step, demand.is_touched || demand.later ? share * aim : aim, &demand);
}

/* The residual of the system that was solved becomes that of the next one, at the whole of its increment: K x cancels
 * there, which leaves what contact's forces have changed by, and saves a product. 0: it is not known. */
static int sbi_step_change_residual(sbi_step *step, double share)
{
    sb_body *b = step->body;
    const sbi_touch *touch = step->touch;
    sb_vec3 *residual = (sb_vec3 *)(void *)b->pcg.residual;
    if (share != 1 || b->elimination || !b->pcg.record->is_left)
        return 0;
    for (int k = 0; k < touch->node_count; k++) {
        int node = touch->nodes[k];
        sb_vec3 change = sb_v3_sub(touch->force[k], touch->left[k]);
        change = sbi_body_pick_axes(b->fixed[node], sb_v3(0, 0, 0), change);
        residual[node] = sb_v3_add(residual[node], change);
    }
    return 1;
}

static sb_result sbi_step_solve_touch(sbi_step *step)
{
    sb_body *b = step->body;
    sbi_touch *touch = step->touch;
    sb_real tolerance = step->linear_tolerance;
    int goes_on = 0;
    for (touch->iterations = 1;; touch->iterations++) {
        sb_result result;
        sb_real aim = sbi_step_touch_aim(step);
        double share;
        memcpy(b->previous, b->increment, (size_t)b->domain.node_count * sizeof(sb_vec3));
        result = sbi_step_solve_next(step, aim, goes_on);
        if (result != SB_OK)
            return result;
        share = sbi_step_search_touch(step, tolerance);
        sbi_step_end_way(step);
        touch->capped = !(share == 1 && touch->residual <= tolerance && aim <= tolerance);
        if (!touch->capped || touch->iterations >= touch->max_iterations)
            break;
        goes_on = sbi_step_change_residual(step, share);
        sbi_step_renew_touch(step);
    }
    if (b->elimination)
        touch->restore_blocks(touch->user, &b->matrix);
    return SB_OK;
}

SBI_API sb_result sbi_step_solve_system(sbi_step *step)
{
    sb_result result;
    double begin = sbi_body_now(step->body);
    if (step->touch && step->linearised)
        result = sbi_step_solve_touch(step);
    else
        result = sbi_step_solve_once(step, sbi_step_linear_tolerance(step), NULL);
    step->info->seconds_solve += sbi_body_now(step->body) - begin;
    step->info->newton_iterations++;
    return result;
}
