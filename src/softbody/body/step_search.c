/* step_search: how much of a Newton increment is taken. */
#include <math.h>
#include <string.h>

#include "live_private.h"
#include "load.h"
#include "step_private.h"

static sb_real sbi_step_dot(const sb_vec3 *a, const sb_vec3 *b, int count)
{
    double sum = 0;
    for (int i = 0; i < count; i++)
        sum += (double)a[i].x * (double)b[i].x + (double)a[i].y * (double)b[i].y + (double)a[i].z * (double)b[i].z;
    return (sb_real)sum;
}

/* Potential along du without the elastic energy: t * linear + t^2 * quadratic + t^3 * cubic, from inertia, damping and
 * loads. Pressures may have no potential; the work they do along the line serves in its place. */
typedef struct sbi_step_line {
    sb_real slope; /* r . du, what Armijo asks a share of */
    sb_real linear, quadratic, cubic;
    sb_real load_size; /* sum of what the loads that follow the body add: for rounding */
    sb_real touch;     /* work of contact's forces at the start along the whole increment */
} sbi_step_line;

static void sbi_step_add_guest_line(const sbi_step *step, sbi_step_line *line)
{
    double linear, quadratic;
    if (step->guests.count == 0)
        return;
    sbi_guest_line(sbi_pcg_guests(&step->body->pcg), &step->body->increment[0].x, &linear, &quadratic);
    if (!step->dynamic) /* what is of second order is of the ways that their nodes go: see sbi_step_bend_change */
        quadratic = 0;
    line->slope += (sb_real)linear;
    line->linear += (sb_real)linear;
    line->quadratic += (sb_real)quadratic;
    line->load_size += sb_abs((sb_real)linear) + sb_abs((sb_real)quadratic);
}

/* The residual of a step of several iterations has contact's forces already, that of a linearised one has not. */
static void sbi_step_add_touch_line(sbi_step *step, sbi_step_line *line)
{
    sbi_step_evaluate_touch(step, NULL, 1, 0);
    line->touch = sbi_step_touch_work(step, step->body->increment);
    if (step->linearised)
        line->slope -= line->touch;
    else
        line->linear += line->touch;
    line->load_size += sb_abs(line->touch);
}

/* Of a static solve: work of the loads on nodes that guests place, a share t along the increment, whose ways bend; less
 * that along it, which the line has. In a time step the next iterations have it, and the inertia beside it. The trial
 * is in work2. */
static sb_real sbi_step_bend_change(const sbi_step *step, sb_real t)
{
    const sb_body *b = step->body;
    double work = 0;
    for (int g = 0; !step->dynamic && g < step->guests.count; g++) {
        const sbi_guest *guest = step->guests.list[g];
        for (int k = 0; guest->place && k < guest->taken_count; k++) {
            int i = guest->nodes[k];
            sb_vec3 load = sb_v3_sub(b->internal[i], b->residual[i]);
            sb_vec3 bend = sb_v3_sub(sb_v3_sub(b->work2[i], b->displacement[i]), sb_v3_scale(t, b->increment[i]));
            work += (double)sb_v3_dot(load, bend);
        }
    }
    return (sb_real)work;
}

/* What contact adds to the potential over a share t of the increment: the work against its forces, as if they rose
 * evenly. They do but where contact closes on the way, which this counts too high. Its potential would not do: its
 * friction turns with the tool's normal, so that the forces are not quite the slope of it. */
static sb_real sbi_step_touch_change(sbi_step *step, const sbi_step_line *line, sb_real t)
{
    sbi_step_evaluate_touch(step, step->body->increment, t, 0);
    return -t * (line->touch + sbi_step_touch_work(step, step->body->increment)) / 2;
}

static sbi_step_line sbi_step_make_line(sbi_step *step)
{
    sb_body *b = step->body;
    int n = b->domain.node_count;
    sbi_step_line line = {0, 0, 0, 0, 0, 0};
    line.slope = sbi_step_dot(b->residual, b->increment, n);
    line.linear = line.slope - sbi_step_dot(b->internal, b->increment, n);
    if (step->dynamic) {
        sbi_body_mass_multiply(b, b->increment, b->work);
        line.quadratic = sbi_step_mass_factor(step) * sbi_step_dot(b->increment, b->work, n);
        for (int i = 0; i < n && b->regional_damping; i++)
            line.quadratic += step->cv * b->node_damping[i] * sb_v3_dot(b->increment[i], b->increment[i]);
        if (step->lagged_damping) {
            sbi_step_damping_product(step, b->increment, b->work);
            line.quadratic += sbi_step_beta(b) * step->cv * sbi_step_dot(b->increment, b->work, n);
        }
        line.quadratic *= (sb_real)0.5;
    }
    if (step->push > 0) { /* the residual has its linear part */
        memset(b->work, 0, (size_t)n * sizeof(sb_vec3));
        sbi_live_add_push_product(b, step->push, b->increment, b->work);
        line.quadratic += (sb_real)0.5 * sbi_step_dot(b->increment, b->work, n);
    }
    if (b->load_count) { /* the residual has their linear part */
        sbi_loads_work work = sbi_loads_line(b, b->displacement, b->increment, step->loads_factor);
        line.quadratic -= work.quadratic;
        line.cubic -= work.cubic;
        line.linear += work.curved; /* it is in the energies */
        line.load_size = sb_abs(work.linear) + sb_abs(work.quadratic) + sb_abs(work.cubic);
    }
    sbi_step_add_guest_line(step, &line);
    if (step->touch)
        sbi_step_add_touch_line(step, &line);
    return line;
}

/* Displacement for a share t of the increment, in work2. A whole increment puts the supports where they belong to
 * the last bit, so that no rounding error keeps them on the way; and slaves where they belong, unless they are still
 * on theirs. */
SBI_API void sbi_step_trial(const sbi_step *step, sb_real t)
{
    const sb_body *b = step->body;
    for (int i = 0; i < b->domain.node_count; i++) {
        b->work2[i] = sb_v3_madd(b->displacement[i], t, b->increment[i]);
        if (t == 1 && b->fixed[i])
            b->work2[i] = sbi_body_pick_axes(b->fixed[i], sbi_step_goal(step, i), b->work2[i]);
    }
    sbi_step_place_nodes(step, (double)t, b->work2);
    if (b->elimination && (t == 1 || !step->moves_supports))
        sbi_elimination_follow(b->elimination, b->work2, step->load_factor);
}

/* Elastic energy of a trial displacement, of the body and its cables; 0 when it is inadmissible, with *bad the element
 * that is. */
static int sbi_step_try(sbi_step *step, const sb_vec3 *trial, sb_real *energy, int *bad)
{
    sb_body *b = step->body;
    *bad = sbi_assembly_energy(&b->assembly, trial, energy);
    if (*bad < 0 && b->load_count)
        *energy += (sb_real)sbi_loads_curved_energy(b, trial, step->loads_factor);
    return *bad < 0 && sb_is_finite(*energy);
}

/* Takes a trial displacement, which is this share of the increment, and on supported axes `held` of it. */
static void sbi_step_take(sbi_step *step, const sb_vec3 *trial, sb_real energy, sb_real share, sb_real held)
{
    sb_body *b = step->body;
    memcpy(b->displacement, trial, (size_t)b->domain.node_count * sizeof(sb_vec3));
    sbi_step_move_guests(step, share, held);
    step->energy = energy;
    step->energy_known = 1;
}

static sb_result sbi_step_no_step(sbi_step *step, int bad)
{
    if (bad >= 0)
        return sbi_fail_element(&step->info->error, SB_ERROR_INVERTED, bad,
                                "element %d would turn inside out however short the step", bad);
    return sbi_fail(&step->info->error, SB_ERROR_DIVERGED, "no step along the search direction lowers the energy");
}

/* Takes the longest admissible share of the increment. */
static sb_result sbi_step_take_longest(sbi_step *step)
{
    sb_real energy = 0, t;
    int bad = -1;
    for (t = 1; t > (sb_real)1e-6; t *= (sb_real)0.5) {
        sbi_step_trial(step, t);
        if (sbi_step_try(step, step->body->work2, &energy, &bad))
            break;
    }
    if (!(t > (sb_real)1e-6))
        return sbi_step_no_step(step, bad);
    sbi_step_take(step, step->body->work2, energy, t, t);
    return SB_OK;
}

/* Mixed points: energies may rise on the way, r.K^-1 r not for long. */
static sb_result sbi_step_take_mixed(sbi_step *step)
{
    enum { RISES = 3 };
    sb_body *b = step->body;
    int n = b->domain.node_count;
    sb_real expected = 0;
    sb_result result;
    if (!step->moves_supports) {
        sbi_step_line line = {0, 0, 0, 0, 0, 0};
        line.slope = sbi_step_dot(b->residual, b->increment, n);
        sbi_step_add_guest_line(step, &line);
        expected = -line.slope;
    }
    step->rises = step->expected > 0 && !(expected <= step->expected) ? step->rises + 1 : 0;
    step->expected = expected;
    if (step->rises >= RISES)
        return sbi_fail(&step->info->error, SB_ERROR_NOT_CONVERGED, "mixed points do not converge");
    memcpy(b->previous, b->displacement, (size_t)n * sizeof(sb_vec3));
    result = sbi_step_take_longest(step);
    b->assembly.came_from = b->previous;
    return result;
}

/* While supports move, work comes in through them and no energy has to fall: the longest admissible share of the
 * increment is taken. In a time step the increment may be far off, when a tool jumps by more than an element; then
 * the supports alone move if that costs less, and the next iterations bring the rest along. */
static sb_result sbi_step_move_supports(sbi_step *step)
{
    sb_body *b = step->body;
    sb_real least = step->linearised ? (sb_real)0.75 : (sb_real)1e-6; /* no iteration would bring them the rest */
    sb_real energy = 0, alone = 0, t;
    int bad = -1;
    for (t = 1; t > least; t *= (sb_real)0.5) {
        sbi_step_trial(step, t);
        if (sbi_step_try(step, b->work2, &energy, &bad))
            break;
    }
    if (step->dynamic && (t < 1 || energy > 0)) {
        for (int i = 0; i < b->domain.node_count; i++)
            b->work[i] = sbi_body_pick_axes(b->fixed[i], sbi_step_goal(step, i), b->displacement[i]);
        if (b->elimination)
            sbi_elimination_follow(b->elimination, b->work, step->load_factor);
        if (sbi_step_try(step, b->work, &alone, &bad) && (t < 1 || alone < energy)) {
            sbi_step_take(step, b->work, alone, 0, 1);
            return SB_OK;
        }
    }
    if (!(t > least))
        return sbi_step_no_step(step, bad);
    sbi_step_take(step, b->work2, energy, t, t);
    return SB_OK;
}

/* What the potential of the line is above that at the present displacement, a share t along it, where the elastic
 * energy is the one given; and what may be rounding in it. */
static sb_real sbi_step_line_change(const sbi_step *step, const sbi_step_line *line, sb_real t, sb_real energy)
{
    return energy - step->energy + t * line->linear + t * t * line->quadratic + t * t * t * line->cubic -
           sbi_step_bend_change(step, t);
}

static sb_real sbi_step_line_noise(const sbi_step *step, const sbi_step_line *line, sb_real t, sb_real energy)
{
    return 32 * SB_EPSILON * (sb_abs(energy) + sb_abs(step->energy) + sb_abs(t * line->linear) + t * line->load_size) +
           4 * SB_EPSILON * step->body->assembly.energy_unit;
}

/* Guests that place nodes, which hold each other: that no work is done by these forces is so but for rounding, which
 * may be all that is left of the slope. */
static int sbi_step_slope_is_rounding(const sbi_step *step, const sbi_step_line *line)
{
    int places = 0;
    for (int g = 0; g < step->guests.count; g++)
        places |= step->guests.list[g]->place != NULL;
    return places && line->slope <= sbi_step_line_noise(step, line, 1, step->energy);
}

/* Takes the first share t = 1, 1/2, 1/4 ... of the increment whose shape is admissible and whose potential fell
 * enough (Armijo). */
static sb_result sbi_step_search(sbi_step *step)
{
    sb_body *b = step->body;
    sbi_step_line line;
    int bad = -1;
    if (!step->energy_known && !sbi_step_try(step, b->displacement, &step->energy, &bad))
        return sbi_step_no_step(step, bad);
    step->energy_known = 1;
    line = sbi_step_make_line(step);
    if (!(line.slope < 0) && !step->linearised && !sbi_step_slope_is_rounding(step, &line))
        return SB_ERROR_INDEFINITE;
    line.slope = sb_min(line.slope, 0);
    for (sb_real t = 1; t > (sb_real)1e-6; t *= (sb_real)0.5) {
        sb_real energy, change;
        sbi_step_trial(step, t);
        if (!sbi_step_try(step, b->work2, &energy, &bad))
            continue;
        change = sbi_step_line_change(step, &line, t, energy);
        if (step->touch)
            change += sbi_step_touch_change(step, &line, t);
        if (change <= (sb_real)1e-4 * t * line.slope + sbi_step_line_noise(step, &line, t, energy)) {
            sbi_step_take(step, b->work2, energy, t, t);
            step->cautious = t < 1;
            return SB_OK;
        }
    }
    return sbi_step_no_step(step, bad);
}

/* The end of the whole increment, in work2: 1 where it is admissible and its potential has fallen enough (Armijo),
 * which it need not while supports move. */
static int sbi_step_weigh_end(sbi_step *step, sb_real *energy, sb_real *change)
{
    sbi_step_line line = sbi_step_make_line(step);
    int bad = -1;
    sbi_step_trial(step, 1);
    *change = (sb_real)INFINITY;
    if (!sbi_step_try(step, step->body->work2, energy, &bad))
        return 0;
    *change = sbi_step_line_change(step, &line, 1, *energy);
    return step->moves_supports || (line.slope < 0 && *change <= (sb_real)1e-4 * line.slope);
}

SBI_API int sbi_step_take_lower(sbi_step *step, sb_vec3 *end)
{
    sb_body *b = step->body;
    sb_real energy = 0, change = 0, least = 0;
    int bad = -1;
    if (!step->energy_known && !sbi_step_try(step, b->displacement, &step->energy, &bad))
        return 0;
    step->energy_known = 1;
    (void)sbi_step_weigh_end(step, &energy, &least);
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 increment = b->increment[i];
        b->increment[i] = sb_v3_sub(end[i], b->displacement[i]);
        end[i] = increment;
    }
    if (sbi_step_weigh_end(step, &energy, &change) && change < least) {
        sbi_step_take(step, b->work2, energy, 1, 1);
        b->force_current = 0;
        return 1;
    }
    memcpy(b->increment, end, (size_t)b->domain.node_count * sizeof(sb_vec3));
    return 0;
}

SBI_API sb_real sbi_step_change(sbi_step *step)
{
    sb_real energy = 0, change = 0;
    int bad = -1;
    if (!sbi_step_try(step, step->body->displacement, &step->energy, &bad))
        return (sb_real)INFINITY;
    step->energy_known = 1;
    (void)sbi_step_weigh_end(step, &energy, &change);
    return change;
}

SBI_API sb_result sbi_step_accept(sbi_step *step)
{
    sb_body *b = step->body;
    sb_result result = SB_OK;
    if (step->mixed) {
        result = sbi_step_take_mixed(step);
    } else if (step->line_search) {
        result = step->moves_supports ? sbi_step_move_supports(step) : sbi_step_search(step);
    } else {
        sbi_step_trial(step, 1);
        memcpy(b->displacement, b->work2, (size_t)b->domain.node_count * sizeof(sb_vec3));
        sbi_step_move_guests(step, 1, 1);
    }
    if (result != SB_OK)
        return result;
    for (int i = 0; i < b->domain.node_count; i++)
        if (!sb_v3_is_finite(b->displacement[i]))
            return sbi_fail_node(&step->info->error, SB_ERROR_DIVERGED, i, "the displacement of node %d is not finite",
                                 i);
    if (step->touch && step->line_search && step->linearised) /* a share was taken: what is read is of there */
        sbi_step_evaluate_touch(step, NULL, 1, 1);
    b->force_current = 0;
    step->has_velocity = 1;
    return SB_OK;
}
