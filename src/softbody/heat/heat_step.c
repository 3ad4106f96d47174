/* heat_step: implicit Euler, and steady temperatures. Both find the rise of temperature whose balance of power at every
 * node that is not held is 0: by one linear system, or where heat is latent by Newton's method on its convex potential.
 */
#include "heat_private.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "../body/step.h"

enum { SBI_HEAT_MOST_SYSTEMS = 50, SBI_HEAT_HALVINGS = 40 };

/* ---- the balance of each node ---- */

/* Share of its latent heat that a node takes up by its rise: from the rise itself, since the difference of what two
 * temperatures have would be their rounding where the step is short. */
static double sbi_heat_melted(const sb_heat *heat, int i)
{
    double width = (double)heat->def.latent_high - (double)heat->def.latent_low, rise = heat->rise[i];
    double from = (double)heat->temperature[i] - (double)heat->def.latent_low;
    double start = from < 0 ? 0 : from > width ? width : from;
    rise += from - start;
    return (rise < -start ? -start : rise > width - start ? width - start : rise) / width;
}

static double sbi_heat_after(const sb_heat *heat, int i) { return (double)heat->temperature[i] + heat->rise[i]; }

/* Heat that a node stores by its rise (J). */
static double sbi_heat_stored(const sb_heat *heat, int i)
{
    double sum = heat->capacity[i] * heat->rise[i];
    if (heat->latent[i] > 0)
        sum += heat->latent[i] * sbi_heat_melted(heat, i);
    return sum;
}

/* residual += what sources and convection give. */
static void sbi_heat_add_sources(sb_heat *heat, sb_heat_flows *flows)
{
    for (int k = 0; k < heat->source_count; k++) {
        const sbi_heat_source *source = heat->sources + k;
        double value = (double)*source->value, sum = 0;
        for (int j = 0; j < source->count; j++) {
            double power = value * (double)source->shares[j];
            if (source->kind == SBI_HEAT_CONVECTION)
                power *= (double)*source->surroundings - sbi_heat_after(heat, source->columns[j]);
            heat->residual[source->rows[j]] += power;
            sum += power;
        }
        flows->source += source->kind == SBI_HEAT_SOURCE ? sum : 0;
        flows->convected -= source->kind == SBI_HEAT_CONVECTION ? sum : 0;
    }
}

/* residual: power (W) that comes to each node and is neither stored nor goes elsewhere; where it is held it goes out
 * there. rate: 1/dt, 0 for steady. Temperatures count from the blood's: where all have that, nothing is rounded. */
static sb_heat_flows sbi_heat_weigh(sb_heat *heat, double rate)
{
    sb_heat_flows flows = {0, 0, 0, 0, 0, 0, 0};
    for (int i = 0; i < heat->node_count; i++)
        heat->smooth[i] = ((double)heat->temperature[i] - (double)heat->def.blood) + heat->rise[i];
    sbi_heat_conduct(heat, heat->smooth, heat->residual);
    for (int i = 0; i < heat->node_count; i++) {
        double perfused = heat->blood[i] * heat->smooth[i], stored = rate > 0 ? rate * sbi_heat_stored(heat, i) : 0;
        heat->residual[i] = heat->metabolic[i] - heat->residual[i] - perfused - stored;
        flows.metabolic += heat->metabolic[i];
        flows.perfused += perfused;
        flows.stored += stored;
    }
    sbi_heat_add_sources(heat, &flows);
    for (int i = 0; i < heat->node_count; i++)
        flows.held += heat->held[i] ? heat->residual[i] : 0;
    flows.error = flows.source + flows.metabolic - flows.perfused - flows.convected - flows.held - flows.stored;
    return flows;
}

/* ---- the system ---- */

/* matrix = K + convection + blood + rate d(stored) / d(rise) */
static void sbi_heat_assemble(sb_heat *heat, double rate)
{
    double width = (double)heat->def.latent_high - (double)heat->def.latent_low;
    memcpy(heat->matrix, heat->conduction, (size_t)heat->entry_count * sizeof *heat->matrix);
    for (int i = 0; i < heat->node_count; i++) {
        double after = sbi_heat_after(heat, i), slope = heat->capacity[i];
        if (heat->latent[i] > 0 && after >= (double)heat->def.latent_low && after < (double)heat->def.latent_high)
            slope += heat->latent[i] / width;
        heat->matrix[heat->diagonal[i]] += heat->blood[i] + rate * slope;
    }
    for (int k = 0; k < heat->source_count; k++) {
        const sbi_heat_source *source = heat->sources + k;
        for (int j = 0; source->kind == SBI_HEAT_CONVECTION && j < source->count; j++)
            heat->matrix[source->at[j]] += (double)*source->value * (double)source->shares[j];
    }
}

/* rise += t change; t is 1, or where the potential would rise again on the way there, where it hardly does: its slope
 * along the change only grows with t, so that halves of what has it between them find that. */
static sb_heat_flows sbi_heat_go(sb_heat *heat, double rate, double slope)
{
    const double enough = 0.1; /* of the slope at the start */
    sb_heat_flows flows;
    double t = 1, low = 0, high = 1;
    for (int i = 0; i < heat->node_count; i++)
        heat->rise[i] += heat->change[i];
    flows = sbi_heat_weigh(heat, rate);
    for (int k = 0; k < SBI_HEAT_HALVINGS && heat->has_latent; k++) {
        double falls = sbi_heat_dot(heat, heat->residual, heat->change), next;
        if (falls >= -enough * slope && (falls <= enough * slope || t == 1))
            break;
        if (falls < 0)
            high = t;
        else
            low = t;
        next = 0.5 * (low + high);
        for (int i = 0; i < heat->node_count; i++)
            heat->rise[i] += (next - t) * heat->change[i];
        t = next;
        flows = sbi_heat_weigh(heat, rate);
    }
    return flows;
}

static double sbi_heat_norm(const sb_heat *heat) { return sqrt(sbi_heat_dot(heat, heat->residual, heat->residual)); }

/* What perfusion is left, and the rises of nodes that are held. */
static void sbi_heat_begin(sb_heat *heat)
{
    for (int i = 0; i < heat->node_count; i++) {
        heat->rise[i] = heat->held[i] ? (double)heat->target[i] - (double)heat->temperature[i] : 0;
        heat->blood[i] = heat->perfusion[i] * (heat->def.keeps_perfusion ? 1 : 1 - sbi_heat_dead(heat, i));
    }
}

/* Finds the rise; info has what it took. */
static sb_result sbi_heat_balance_out(sb_heat *heat, double rate, sb_heat_info *info, sb_error *error)
{
    const double tolerance = (double)heat->def.tolerance;
    double begun, left;
    sbi_heat_begin(heat);
    info->flows = sbi_heat_weigh(heat, rate);
    begun = left = sbi_heat_norm(heat);
    if (!(begun <= (double)SB_REAL_MAX))
        return sbi_fail(error, SB_ERROR_DIVERGED, "the power of heat is not finite");
    while (left > 0) {
        double work = 0;
        sb_result result;
        if (info->systems == SBI_HEAT_MOST_SYSTEMS)
            return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "latent heat left %g of the residual after %d systems",
                            left / begun, info->systems);
        sbi_heat_assemble(heat, rate);
        result = sbi_heat_solve(heat, tolerance, &info->iterations, &work, error);
        if (result != SB_OK)
            return result;
        info->systems++;
        info->flows = sbi_heat_go(heat, rate, work);
        left = sbi_heat_norm(heat);
        if (!heat->has_latent || rate <= 0 || left <= tolerance * begun)
            break;
    }
    info->residual = begun > 0 ? left / begun : 0;
    return SB_OK;
}

/* ---- steps ---- */

/* Refuses temperatures that are none. */
static sb_result sbi_heat_check_rise(const sb_heat *heat, sb_error *error)
{
    for (int i = 0; i < heat->node_count; i++) {
        double after = sbi_heat_after(heat, i);
        if (!(after > 0 && after <= (double)SB_REAL_MAX))
            return sbi_fail_node(error, SB_ERROR_DIVERGED, i, "node %d would have a temperature of %g K", i, after);
    }
    return SB_OK;
}

static void sbi_heat_take_rise(sb_heat *heat)
{
    for (int i = 0; i < heat->node_count; i++)
        heat->temperature[i] = heat->held[i] ? heat->target[i] : (sb_real)sbi_heat_after(heat, i);
}

/* 0: some sum is beyond what numbers hold. */
static int sbi_heat_add_flows(sb_heat_flows *sum, const sb_heat_flows *flows, double dt)
{
    sum->source += dt * flows->source;
    sum->metabolic += dt * flows->metabolic;
    sum->perfused += dt * flows->perfused;
    sum->convected += dt * flows->convected;
    sum->held += dt * flows->held;
    sum->stored += dt * flows->stored;
    sum->error += dt * flows->error;
    return isfinite(sum->source) && isfinite(sum->metabolic) && isfinite(sum->perfused) && isfinite(sum->convected) &&
           isfinite(sum->held) && isfinite(sum->stored) && isfinite(sum->error);
}

/* What the temperatures are by now. */
static void sbi_heat_report(const sb_heat *heat, sb_heat_info *info)
{
    info->highest_node = -1;
    for (int i = 0; i < heat->node_count; i++)
        if (heat->volume[i] > 0 && (info->highest_node < 0 || heat->temperature[i] > info->highest)) {
            info->highest = heat->temperature[i];
            info->highest_node = i;
        }
    info->dead_volume = sb_heat_dead_volume(heat);
}

static sb_result sbi_heat_advance_by(sb_heat *heat, sb_real dt, sb_heat_info *info, sb_error *error)
{
    sb_heat_flows sums = heat->balance;
    sb_result result = sbi_heat_balance_out(heat, 1 / (double)dt, info, error);
    if (result == SB_OK)
        result = sbi_heat_check_rise(heat, error);
    if (result == SB_OK && !sbi_heat_add_flows(&sums, &info->flows, (double)dt))
        result = sbi_fail(error, SB_ERROR_DIVERGED, "the heat of %g s is not finite", (double)dt);
    if (result != SB_OK)
        return result;
    sbi_heat_harm(heat, (double)dt);
    sbi_heat_take_rise(heat);
    memcpy(heat->damage, heat->new_damage, (size_t)heat->node_count * sizeof *heat->damage);
    heat->balance = sums;
    if (sbi_heat_stiffen(heat))
        sbi_body_cells_stiffened(heat->body);
    return SB_OK;
}

SB_API sb_result sb_heat_step(sb_heat *heat, sb_real dt, sb_heat_info *info, sb_error *error)
{
    sb_heat_info own;
    sb_result result;
    memset(&own, 0, sizeof own);
    if (!heat || !(dt > 0) || !sb_is_finite(dt))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_heat_step needs heat and a dt > 0 that is finite");
    result = sbi_heat_advance_by(heat, dt, &own, error);
    sbi_heat_tell_step(heat, SBI_HEAT_STEP, result, dt);
    if (result != SB_OK)
        return result;
    sbi_heat_report(heat, &own);
    if (info)
        *info = own;
    return SB_OK;
}

/* ---- steady ---- */

/* answers[part] and conducts[part]: W/K that a part gives away as all of it gets warmer, and that it conducts inside.
 */
static void sbi_heat_sum_parts(const sb_heat *heat, double *answers, double *conducts)
{
    const int *part = heat->body->node_component;
    for (int k = 0; k < heat->body->component_count; k++)
        answers[k] = conducts[k] = 0;
    for (int i = 0; i < heat->node_count; i++)
        if (part[i] >= 0) {
            conducts[part[i]] += heat->conduction[heat->diagonal[i]];
            answers[part[i]] += heat->held[i] ? heat->conduction[heat->diagonal[i]] : heat->blood[i];
        }
    for (int k = 0; k < heat->source_count; k++)
        for (int j = 0; heat->sources[k].kind == SBI_HEAT_CONVECTION && j < heat->sources[k].count; j++)
            answers[part[heat->sources[k].rows[j]]] +=
                (double)*heat->sources[k].value * (double)heat->sources[k].shares[j];
}

/* SB_ERROR_UNCONSTRAINED where temperatures of a part may rise together and nothing answers, or so little beside what
 * it conducts that rounding leaves no four digits of that. */
static sb_result sbi_heat_check_parts(sb_heat *heat, sb_error *error)
{
    const double least = 1e4 * DBL_EPSILON;
    double *answers = heat->product, *conducts = heat->smooth;
    const int *part = heat->body->node_component;
    sbi_heat_sum_parts(heat, answers, conducts);
    for (int i = 0; i < heat->node_count; i++)
        if (part[i] >= 0 && !(answers[part[i]] > least * conducts[part[i]]))
            return sbi_fail_node(error, SB_ERROR_UNCONSTRAINED, i,
                                 "nothing holds, cools or perfuses the part with node %d: %g W/K of %g", i,
                                 answers[part[i]], conducts[part[i]]);
    return SB_OK;
}

SB_API sb_result sb_heat_solve_steady(sb_heat *heat, sb_heat_info *info, sb_error *error)
{
    sb_heat_info own;
    sb_result result;
    memset(&own, 0, sizeof own);
    if (!heat)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_heat_solve_steady needs heat");
    sbi_heat_begin(heat);
    result = sbi_heat_check_parts(heat, error);
    if (result == SB_OK)
        result = sbi_heat_balance_out(heat, 0, &own, error);
    if (result == SB_OK)
        result = sbi_heat_check_rise(heat, error);
    if (result == SB_OK)
        sbi_heat_take_rise(heat);
    sbi_heat_tell_step(heat, SBI_HEAT_STEADY, result, 0);
    if (result != SB_OK)
        return result;
    sbi_heat_report(heat, &own);
    if (info)
        *info = own;
    return SB_OK;
}
