/* sensitivity: derivatives of an equilibrium, directly and by its adjoint. */
#include "sensitivity.h"

#include <string.h>

#include "equilibrium.h"

/* ---- arguments ---- */

static sb_result sbi_sensitivity_check(const sb_body *body, const sb_parameter *parameters, int count, sb_error *error)
{
    if (!body || count < 0 || (count > 0 && !parameters))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "derivatives need a body and parameters");
    for (int k = 0; k < count; k++) {
        sb_result result = sbi_parameter_check(body, parameters + k, k, error);
        if (result != SB_OK)
            return result;
    }
    return SB_OK;
}

static sb_result sbi_sensitivity_check_vectors(const sb_body *body, const sb_vec3 *vectors, int count, const char *what,
                                               sb_error *error)
{
    int nodes = body->domain.node_count;
    for (int k = 0; k < count; k++)
        for (int i = 0; i < nodes; i++)
            if (!sb_v3_is_finite(vectors[(size_t)k * (size_t)nodes + (size_t)i]))
                return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "%s of node %d is not finite", what, i);
    return SB_OK;
}

/* [count][node_count], or NULL with the error. */
static sb_vec3 *sbi_sensitivity_vectors(const sb_body *body, int count, sb_error *error)
{
    sb_vec3 *vectors = NULL;
    size_t one = (size_t)body->domain.node_count * sizeof(sb_vec3);
    if (count > 0)
        vectors = (sb_vec3 *)sbi_alloc(&body->allocator, (size_t)count, one);
    if (!vectors)
        sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d vectors of %d nodes", count, body->domain.node_count);
    return vectors;
}

/* SB_ERROR_NOT_FINITE where a derivative has overflown. */
static sb_result sbi_sensitivity_check_results(const sb_body *body, const sb_vec3 *vectors, int count, sb_error *error)
{
    return sbi_sensitivity_check_vectors(body, vectors, count, "the derivative", error);
}

/* ---- solves ---- */

SB_API sb_result sb_body_solve_tangent(sb_body *body, const sb_vec3 *rhs, sb_vec3 *x, int count, sb_real tolerance,
                                       sb_error *error)
{
    sbi_equilibrium eq;
    sb_vec3 *work;
    sb_result result;
    size_t bytes;
    if (!body || !rhs || !x || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a solve needs a body, right-hand sides and a place for solutions");
    result = sbi_sensitivity_check_vectors(body, rhs, count, "the right-hand side", error);
    if (result != SB_OK)
        return result;
    work = sbi_sensitivity_vectors(body, count, error);
    if (!work)
        return SB_ERROR_MEMORY;
    bytes = (size_t)count * (size_t)body->domain.node_count * sizeof *work;
    memcpy(work, rhs, bytes);
    result = sbi_equilibrium_begin(body, tolerance, 0, &eq, error);
    if (result == SB_OK) {
        result = sbi_equilibrium_solve(&eq, count, 0, work);
        if (result == SB_OK)
            result = sbi_sensitivity_check_results(body, work, count, error);
        sbi_equilibrium_end(&eq);
    }
    if (result == SB_OK)
        memcpy(x, work, bytes);
    sbi_free(&body->allocator, work);
    return result;
}

/* ---- direct ---- */

/* Of systems beyond those that are factored: derivatives are as good as that. */
static sb_real sbi_sensitivity_tolerance(void) { return sb_max((sb_real)1e-10, 100 * SB_EPSILON); }

/* du = -(dr/dp + K T e), e the motion of supports: what is to be solved for; dreaction = dr/dp (NULL: not wanted). */
static void sbi_sensitivity_ask(sbi_equilibrium *eq, const sb_parameter *p, sb_vec3 *du, sb_vec3 *dreaction)
{
    sbi_parameter_residual(eq, p, du);
    if (dreaction)
        memcpy(dreaction, du, (size_t)eq->node_count * sizeof *du);
    if (p->kind == SB_PARAMETER_SUPPORT) {
        sbi_parameter_motion(p, eq->node_count, eq->sum);
        sbi_equilibrium_expand(eq, eq->sum);
        sbi_equilibrium_multiply(eq, eq->sum, 0, du);
    }
    for (int i = 0; i < eq->node_count; i++)
        du[i] = sb_v3_scale(-1, du[i]);
}

/* du += T e; dreaction = T^T (dr/dp + K du) on supports. */
static void sbi_sensitivity_answer(sbi_equilibrium *eq, const sb_parameter *p, sb_vec3 *du, sb_vec3 *dreaction)
{
    sbi_parameter_motion(p, eq->node_count, eq->sum);
    sbi_equilibrium_expand(eq, eq->sum);
    for (int i = 0; i < eq->node_count; i++)
        du[i] = sb_v3_add(du[i], eq->sum[i]);
    if (!dreaction)
        return;
    sbi_equilibrium_multiply(eq, du, 0, eq->product);
    for (int i = 0; i < eq->node_count; i++)
        dreaction[i] = eq->body->node_component[i] < 0 ? sb_v3(0, 0, 0) : sb_v3_add(dreaction[i], eq->product[i]);
    sbi_equilibrium_reduce(eq, dreaction);
    sbi_equilibrium_keep_supports(eq, dreaction);
}

static sb_result sbi_sensitivity_run(sbi_equilibrium *eq, const sb_parameter *parameters, int count, sb_vec3 *du,
                                     sb_vec3 *dreaction)
{
    size_t n = (size_t)eq->node_count;
    sb_result result;
    for (int k = 0; k < count; k++)
        sbi_sensitivity_ask(eq, parameters + k, du + (size_t)k * n, dreaction ? dreaction + (size_t)k * n : NULL);
    result = sbi_equilibrium_solve(eq, count, 0, du);
    for (int k = 0; result == SB_OK && k < count; k++)
        sbi_sensitivity_answer(eq, parameters + k, du + (size_t)k * n, dreaction ? dreaction + (size_t)k * n : NULL);
    if (result == SB_OK)
        result = sbi_sensitivity_check_results(eq->body, du, count, eq->error);
    if (result == SB_OK && dreaction)
        result = sbi_sensitivity_check_results(eq->body, dreaction, count, eq->error);
    return result;
}

static sb_result sbi_sensitivities(sb_body *body, const sb_parameter *parameters, int parameter_count, int few,
                                   sb_vec3 *du, sb_vec3 *dreaction, sb_error *error)
{
    sbi_equilibrium eq;
    sb_vec3 *work;
    size_t vectors, bytes;
    sb_result result = sbi_sensitivity_check(body, parameters, parameter_count, error);
    if (result != SB_OK)
        return result;
    if (!du || parameter_count < 1 || parameter_count > 1 << 29)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "derivatives need parameters and a place for what they are");
    work = sbi_sensitivity_vectors(body, dreaction ? 2 * parameter_count : parameter_count, error);
    if (!work)
        return SB_ERROR_MEMORY;
    vectors = (size_t)parameter_count * (size_t)body->domain.node_count;
    bytes = vectors * sizeof *work;
    result = sbi_equilibrium_begin(body, (few ? 100 : 1) * sbi_sensitivity_tolerance(), few, &eq, error);
    if (result == SB_OK) {
        result = sbi_sensitivity_run(&eq, parameters, parameter_count, work, dreaction ? work + vectors : NULL);
        sbi_equilibrium_end(&eq);
    }
    if (result == SB_OK) {
        memcpy(du, work, bytes);
        if (dreaction)
            memcpy(dreaction, work + vectors, bytes);
    }
    sbi_free(&body->allocator, work);
    return result;
}

SB_API sb_result sb_body_sensitivities(sb_body *body, const sb_parameter *parameters, int parameter_count, sb_vec3 *du,
                                       sb_vec3 *dreaction, sb_error *error)
{
    return sbi_sensitivities(body, parameters, parameter_count, 0, du, dreaction, error);
}

SBI_API sb_result sbi_sensitivities_quick(sb_body *body, const sb_parameter *parameters, int parameter_count,
                                          sb_vec3 *du, sb_vec3 *dreaction, sb_error *error)
{
    return sbi_sensitivities(body, parameters, parameter_count, parameter_count, du, dreaction, error);
}

/* ---- adjoint ---- */

static double sbi_sensitivity_dot(const sb_vec3 *a, const sb_vec3 *b, int count)
{
    double sum = 0;
    for (int i = 0; i < count; i++)
        sum += (double)a[i].x * (double)b[i].x + (double)a[i].y * (double)b[i].y + (double)a[i].z * (double)b[i].z;
    return sum;
}

/* What an adjoint has, [node_count] each. */
typedef struct sbi_adjoint {
    sb_vec3 *multiplier; /* l, then m = l - w */
    sb_vec3 *held;       /* w = T dJ/dR on supports; 0 at nodes of no element, which have no reaction */
    sb_vec3 *residual;   /* dr/dp; dJ/du - K^T m */
} sbi_adjoint;

/* multiplier = dJ/du + K^T w, solved, less w */
static sb_result sbi_adjoint_solve(sbi_equilibrium *eq, const sb_vec3 *dj_du, const sb_vec3 *dj_dreaction,
                                   sbi_adjoint *a)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    sb_result result;
    for (int i = 0; i < eq->node_count; i++)
        a->held[i] = dj_dreaction && eq->body->node_component[i] >= 0 ? dj_dreaction[i] : zero;
    sbi_equilibrium_keep_supports(eq, a->held);
    sbi_equilibrium_expand(eq, a->held);
    sbi_equilibrium_multiply(eq, a->held, 1, a->multiplier);
    for (int i = 0; dj_du && i < eq->node_count; i++)
        a->multiplier[i] = sb_v3_add(a->multiplier[i], dj_du[i]);
    result = sbi_equilibrium_solve(eq, 1, 1, a->multiplier);
    for (int i = 0; result == SB_OK && i < eq->node_count; i++)
        a->multiplier[i] = sb_v3_sub(a->multiplier[i], a->held[i]);
    return result;
}

/* dJ/d(support) along all axes: T^T (dJ/du - K^T m). */
static void sbi_adjoint_supports(sbi_equilibrium *eq, const sb_vec3 *dj_du, sbi_adjoint *a)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    sbi_equilibrium_multiply(eq, a->multiplier, 1, a->residual);
    for (int i = 0; i < eq->node_count; i++)
        a->residual[i] = sb_v3_sub(dj_du ? dj_du[i] : zero, a->residual[i]);
    sbi_equilibrium_reduce(eq, a->residual);
}

static sb_real sbi_adjoint_derivative(sbi_equilibrium *eq, const sb_vec3 *dj_du, const sb_parameter *p, sbi_adjoint *a)
{
    if (p->kind == SB_PARAMETER_SUPPORT) {
        sbi_adjoint_supports(eq, dj_du, a);
        sbi_parameter_motion(p, eq->node_count, eq->sum);
        return (sb_real)sbi_sensitivity_dot(eq->sum, a->residual, eq->node_count);
    }
    sbi_parameter_residual(eq, p, a->residual);
    return (sb_real)-sbi_sensitivity_dot(a->multiplier, a->residual, eq->node_count);
}

/* Into work and multiplier only. */
static sb_result sbi_adjoint_run(sbi_equilibrium *eq, const sb_vec3 *dj_du, const sb_vec3 *dj_dreaction,
                                 const sb_parameter *parameters, int count, sbi_adjoint *a, sb_real *work)
{
    sb_result result = sbi_adjoint_solve(eq, dj_du, dj_dreaction, a);
    if (result == SB_OK)
        result = sbi_sensitivity_check_results(eq->body, a->multiplier, 1, eq->error);
    for (int k = 0; result == SB_OK && k < count; k++) {
        work[k] = sbi_adjoint_derivative(eq, dj_du, parameters + k, a);
        if (!sb_is_finite(work[k]))
            result = sbi_fail(eq->error, SB_ERROR_NOT_FINITE, "the derivative by parameter %d is not finite", k);
    }
    return result;
}

static sb_result sbi_gradient_with(sb_body *body, const sb_vec3 *dj_du, const sb_vec3 *dj_dreaction,
                                   const sb_parameter *parameters, int count, sb_real *work, sb_real *gradient,
                                   sb_vec3 *vectors, sb_vec3 *dj_dforce, sb_error *error)
{
    size_t n = (size_t)body->domain.node_count;
    sbi_equilibrium eq;
    sbi_adjoint a;
    sb_result result = sbi_equilibrium_begin(body, sbi_sensitivity_tolerance(), 0, &eq, error);
    if (result != SB_OK)
        return result;
    a.multiplier = vectors;
    a.held = vectors + n;
    a.residual = a.held + n;
    result = sbi_adjoint_run(&eq, dj_du, dj_dreaction, parameters, count, &a, work);
    sbi_equilibrium_end(&eq);
    if (result != SB_OK)
        return result;
    for (int k = 0; k < count; k++)
        gradient[k] = work[k];
    if (dj_dforce)
        memcpy(dj_dforce, a.multiplier, n * sizeof *dj_dforce);
    return SB_OK;
}

SB_API sb_result sb_body_gradient(sb_body *body, const sb_vec3 *dj_du, const sb_vec3 *dj_dreaction,
                                  const sb_parameter *parameters, int parameter_count, sb_real *gradient,
                                  sb_vec3 *dj_dforce, sb_error *error)
{
    sb_vec3 *vectors;
    sb_real *work;
    sb_result result = sbi_sensitivity_check(body, parameters, parameter_count, error);
    if (result != SB_OK)
        return result;
    if (parameter_count > 0 && !gradient)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a gradient of %d parameters needs a place", parameter_count);
    if (dj_du)
        result = sbi_sensitivity_check_vectors(body, dj_du, 1, "dj_du", error);
    if (result == SB_OK && dj_dreaction)
        result = sbi_sensitivity_check_vectors(body, dj_dreaction, 1, "dj_dreaction", error);
    if (result != SB_OK)
        return result;
    vectors = sbi_sensitivity_vectors(body, 3, error);
    work = (sb_real *)sbi_alloc(&body->allocator, (size_t)parameter_count + 1, sizeof *work);
    result = vectors && work ? sbi_gradient_with(body, dj_du, dj_dreaction, parameters, parameter_count, work, gradient,
                                                 vectors, dj_dforce, error)
                             : sbi_fail(error, SB_ERROR_MEMORY, "no memory for an adjoint");
    sbi_free(&body->allocator, vectors);
    sbi_free(&body->allocator, work);
    return result;
}
