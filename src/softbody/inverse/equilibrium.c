/* equilibrium: the exact tangent of a shape in balance, factored or solved by conjugate gradients. */
#include "equilibrium.h"

#include <math.h>
#include <string.h>

#include "../body/cavity_law.h"
#include "../body/load.h"
#include "../body/rigid_private.h"

enum {
    SBI_EQUILIBRIUM_DIRECT = 10000, /* nodes up to which K is factored, */
    SBI_EQUILIBRIUM_SMALL = 2000,   /* and up to which also for SBI_EQUILIBRIUM_FEW right-hand sides */
    SBI_EQUILIBRIUM_FEW = 4,
    SBI_EQUILIBRIUM_PATIENCE = 300, /* iterations, then those are factored for after all */
    SBI_EQUILIBRIUM_ITERATIONS = 20000,
    SBI_EQUILIBRIUM_ROUNDS = 40 /* for what is not symmetric */
};

/* ---- vectors ---- */

SBI_API void sbi_equilibrium_reduce(const sbi_equilibrium *eq, sb_vec3 *v)
{
    if (eq->body->elimination)
        sbi_elimination_reduce(eq->body->elimination, v, v, NULL);
}

SBI_API void sbi_equilibrium_expand(const sbi_equilibrium *eq, sb_vec3 *v)
{
    if (eq->body->elimination)
        sbi_elimination_expand(eq->body->elimination, v, 0);
}

SBI_API void sbi_equilibrium_keep_supports(const sbi_equilibrium *eq, sb_vec3 *v)
{
    for (int i = 0; i < eq->node_count; i++)
        v[i] = sbi_body_pick_axes(eq->body->fixed[i], v[i], sb_v3(0, 0, 0));
}

SBI_API void sbi_equilibrium_keep_free(const sbi_equilibrium *eq, sb_vec3 *v)
{
    for (int i = 0; i < eq->node_count; i++)
        v[i] = sbi_body_pick_axes(sbi_body_held(eq->body, i), sb_v3(0, 0, 0), v[i]);
}

SBI_API void sbi_equilibrium_multiply(const sbi_equilibrium *eq, const sb_vec3 *x, int transposed, sb_vec3 *out)
{
    sb_matrix_multiply(&eq->full, &x[0].x, &out[0].x, &eq->body->jobs);
    if (eq->skew)
        sbi_loads_add_skew(eq->body, eq->body->displacement, x, transposed ? (sb_real)-1 : (sb_real)1, out);
}

static double sbi_equilibrium_norm(const sbi_equilibrium *eq, const sb_vec3 *v)
{
    double sum = 0;
    for (int i = 0; i < eq->node_count; i++)
        sum += (double)v[i].x * (double)v[i].x + (double)v[i].y * (double)v[i].y + (double)v[i].z * (double)v[i].z;
    return sqrt(sum);
}

/* ---- is it one ---- */

static void sbi_equilibrium_loads(sb_body *b)
{
    for (int i = 0; i < b->domain.node_count; i++)
        b->external[i] = sb_v3_madd(b->dead_load[i], b->load_mass[i], b->gravity);
}

static void sbi_equilibrium_set_up(sbi_equilibrium *eq)
{
    sbi_step *step = &eq->step;
    step->body = eq->body;
    step->info = &step->own_info;
    sbi_step_begin_info(step->info);
    step->part = step->load_factor = step->loads_factor = step->level = step->inertia_level = 1;
    step->tolerance = sb_max((sb_real)1e-6, 64 * SB_EPSILON);
}

static sb_result sbi_equilibrium_tangent(sbi_equilibrium *eq, sb_result result)
{
    if (result == SB_OK)
        sbi_step_tangent(&eq->step, SB_TANGENT_EXACT);
    else if (eq->error)
        *eq->error = eq->step.info->error;
    return result;
}

/* The residual at the present loads, all of them, and K there. */
static sb_result sbi_equilibrium_evaluate(sbi_equilibrium *eq)
{
    sbi_equilibrium_set_up(eq);
    eq->step.forces_only = 1;
    sbi_equilibrium_loads(eq->body);
    return sbi_equilibrium_tangent(eq, sbi_step_evaluate(&eq->step));
}

/* The same at the end of a step, with inertia and damping. */
static sb_result sbi_equilibrium_evaluate_step(sbi_equilibrium *eq, sb_real dt, const sb_vec3 *end)
{
    sb_body *b = eq->body;
    sbi_step *step = &eq->step;
    sb_result result = SB_OK;
    sbi_equilibrium_set_up(eq);
    step->dynamic = step->line_search = 1;
    step->dt = dt;
    step->max_newton = sbi_body_max_newton(b);
    sbi_step_dead_loads(b);
    if (sbi_body_has_beta(b))
        result = sbi_step_keep_damping(step);
    sbi_step_scheme(step);
    step->has_velocity = 1;
    memcpy(b->displacement, end, (size_t)eq->node_count * sizeof *end);
    b->force_current = 0;
    if (result == SB_OK)
        result = sbi_step_evaluate(step);
    return sbi_equilibrium_tangent(eq, result);
}

/* rounding: of the residual (N). */
static sb_result sbi_equilibrium_is_balanced(sbi_equilibrium *eq, sb_real rounding)
{
    if (eq->step.moves_supports)
        return sbi_fail(eq->error, SB_ERROR_NOT_CONVERGED,
                        "supports or constraints have yet to move: the body is not at an equilibrium");
    if (!sbi_step_parts_meet(&eq->step, rounding))
        return sbi_fail(eq->error, SB_ERROR_NOT_CONVERGED,
                        "forces are out of balance by %g of the loads: the body is not at an equilibrium",
                        (double)eq->step.info->residual);
    return SB_OK;
}

static sb_result sbi_equilibrium_check(const sb_body *body, sb_real tolerance, sb_error *error)
{
    if (!body || !(tolerance > 0) || !(tolerance < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "derivatives need a body and a tolerance in (0, 1)");
    if (body->touch && body->touch->touching > 0)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "tools press on the body: forces of contact have no derivative here");
    if (body->domain.single_rotation)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "with a single rotation per element there is no exact tangent to derive by");
    if (sbi_cavities_resist(body))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "a cavity resists growing: derivatives know cavities of given pressure only");
    return sbi_body_refuse_rigids(body, "derivatives", error);
}

static sb_result sbi_equilibrium_check_held(const sb_body *body, sb_error *error)
{
    int node = sbi_body_unsupported_node(body);
    if (node < 0)
        return SB_OK;
    return sbi_fail_node(error, SB_ERROR_UNCONSTRAINED, node,
                         "the part of the mesh with node %d can move freely: support it", node);
}

static sb_result sbi_equilibrium_check_step(const sb_body *body, sb_error *error)
{
    const char *what = NULL;
    if (body->integrator != SB_EULER || sbi_body_max_newton(body) == 1)
        what = "steps are to be of implicit Euler, of several Newton iterations (max_newton > 1)";
    else if (body->regional_damping)
        what = "damping by regions has no derivative here";
    else if (sbi_body_has_beta(body) && !sbi_step_is_linear(body))
        what = "damping in proportion to stiffness has a derivative with linear materials only";
    else if (body->live)
        what = "the mesh of the body may change (def.slack): its steps have no derivatives";
    for (int i = 0; i < body->material_count && !what; i++)
        if (body->materials[i].prony_count > 0)
            what = "materials that relax (Prony terms) have no derivatives of steps";
    return what ? sbi_fail(error, SB_ERROR_UNSUPPORTED, "%s", what) : SB_OK;
}

/* ---- the system ---- */

static sb_result sbi_equilibrium_take_memory(sbi_equilibrium *eq)
{
    const sb_allocator *allocator = &eq->body->allocator;
    size_t nodes = (size_t)eq->node_count;
    eq->full.blocks = (sb_real(*)[9])sbi_alloc(allocator, (size_t)eq->full.block_count, sizeof eq->full.blocks[0]);
    eq->right = (sb_vec3 *)sbi_alloc(allocator, nodes, 4 * sizeof(sb_vec3));
    if (!eq->full.blocks || !eq->right)
        return sbi_fail(eq->error, SB_ERROR_MEMORY, "no memory for a copy of the tangent");
    eq->solution = eq->right + nodes;
    eq->product = eq->solution + nodes;
    eq->sum = eq->product + nodes;
    return SB_OK;
}

static void sbi_equilibrium_free(sbi_equilibrium *eq)
{
    const sb_allocator *allocator = &eq->body->allocator;
    sb_direct_free(eq->direct);
    sb_preconditioner_free(eq->precond);
    sbi_free(allocator, eq->full.blocks);
    sbi_free(allocator, eq->right);
}

/* Keeps K, then condenses and masks the body's. */
static void sbi_equilibrium_mask(sbi_equilibrium *eq)
{
    sb_body *b = eq->body;
    sbi_elimination *e = b->elimination;
    sbi_kept_spoil(b);
    memcpy(eq->full.blocks, b->matrix.blocks, (size_t)b->matrix.block_count * sizeof b->matrix.blocks[0]);
    eq->matrix = e ? &e->matrix : &b->matrix;
    if (e) {
        sbi_elimination_condense(e, &b->matrix);
        for (int i = 0; i < eq->node_count; i++)
            e->held[i] = (unsigned char)sbi_body_held(b, i);
    }
    sb_matrix_constrain(eq->matrix, e ? e->held : b->fixed, NULL, NULL);
}

static sb_result sbi_equilibrium_unstable(sbi_equilibrium *eq, sb_result result)
{
    if (result == SB_ERROR_INDEFINITE)
        return sbi_fail(eq->error, result, "the tangent is not positive definite: the shape is not stable");
    return result == SB_OK ? result
                           : sbi_fail(eq->error, result, "a system with the tangent cannot be solved (%s)",
                                      sb_result_string(result));
}

static sb_result sbi_equilibrium_precondition(sbi_equilibrium *eq)
{
    sb_body *b = eq->body;
    sb_preconditioner_def def = sb_default_preconditioner_def();
    sb_result result;
    def.positions = b->reference;
    def.jobs = b->jobs;
    def.kind = SB_PRECOND_IC0;
    sb_preconditioner_free(eq->precond);
    eq->precond = NULL;
    def.poisson = sbi_body_poisson(b);
    result = sb_preconditioner_create(&def, eq->matrix, &b->allocator, &eq->precond, eq->error);
    if (result == SB_OK)
        result = sbi_equilibrium_unstable(eq, sb_preconditioner_update(eq->precond, eq->matrix, NULL, NULL));
    return result;
}

/* 1, with the result, where there is a factor or the matrix has none; 0: too large. */
static int sbi_equilibrium_try_factor(sbi_equilibrium *eq, sb_result *result)
{
    sb_body *b = eq->body;
    sb_direct_def def = sb_default_direct_def();
    def.positions = b->reference;
    eq->few = 0;
    if (eq->node_count > SBI_EQUILIBRIUM_DIRECT ||
        sb_direct_create(&def, eq->matrix, &b->allocator, &eq->direct, NULL) != SB_OK)
        return 0;
    *result = sbi_equilibrium_unstable(eq, sb_direct_update(eq->direct, eq->matrix, NULL));
    return 1;
}

static sb_result sbi_equilibrium_factor(sbi_equilibrium *eq)
{
    sb_result result = SB_OK;
    if (eq->node_count <= SBI_EQUILIBRIUM_SMALL || eq->few > SBI_EQUILIBRIUM_FEW || eq->skew)
        eq->few = 0;
    if (eq->few && sbi_equilibrium_precondition(eq) == SB_OK)
        return SB_OK;
    return sbi_equilibrium_try_factor(eq, &result) ? result : sbi_equilibrium_precondition(eq);
}

/* Memory, and what is given back at the end; nothing is evaluated. */
static sb_result sbi_equilibrium_open(sb_body *body, sb_real tolerance, int few, sbi_equilibrium *eq, sb_error *error)
{
    sb_result result;
    memset(eq, 0, sizeof *eq);
    eq->few = few;
    eq->body = body;
    eq->error = error;
    eq->tolerance = (double)tolerance;
    eq->node_count = body->domain.node_count;
    eq->strain = body->displacement;
    eq->full = body->matrix;
    eq->skew = sbi_loads_press(body);
    result = sbi_equilibrium_take_memory(eq);
    if (result != SB_OK) {
        sbi_equilibrium_free(eq);
        return result;
    }
    sbi_step_save(body);
    sbi_step_watch_folds(body, 0);
    return SB_OK;
}

/* The tangent has been made, if all went well: it is factored. */
static sb_result sbi_equilibrium_take(sbi_equilibrium *eq, sb_result result)
{
    if (result == SB_OK) {
        sbi_equilibrium_mask(eq);
        result = sbi_equilibrium_factor(eq);
    }
    if (result != SB_OK)
        sbi_equilibrium_end(eq);
    return result;
}

SBI_API sb_result sbi_equilibrium_begin(sb_body *body, sb_real tolerance, int few, sbi_equilibrium *eq, sb_error *error)
{
    sb_result result = sbi_equilibrium_check(body, tolerance, error);
    if (result == SB_OK)
        result = sbi_equilibrium_check_held(body, error);
    if (result == SB_OK)
        result = sbi_equilibrium_open(body, tolerance, few, eq, error);
    if (result != SB_OK)
        return result;
    sbi_step_enter(body, (sb_real)INFINITY);
    result = sbi_equilibrium_evaluate(eq);
    if (result == SB_OK)
        result = sbi_equilibrium_is_balanced(eq, 2 * sbi_static_floor(&eq->step));
    return sbi_equilibrium_take(eq, result);
}

SBI_API sb_result sbi_equilibrium_begin_step(sb_body *body, sb_real dt, const sb_vec3 *end, sb_real tolerance,
                                             sbi_equilibrium *eq, sb_error *error)
{
    sb_result result = sbi_equilibrium_check(body, tolerance, error);
    if (result == SB_OK)
        result = sbi_equilibrium_check_step(body, error);
    if (result == SB_OK)
        result = sbi_equilibrium_open(body, tolerance, 0, eq, error);
    if (result != SB_OK)
        return result;
    result = sbi_equilibrium_evaluate_step(eq, dt, end);
    if (result == SB_OK)
        result = sbi_equilibrium_is_balanced(eq, sbi_step_rounding(&eq->step));
    return sbi_equilibrium_take(eq, result);
}

SBI_API void sbi_equilibrium_end(sbi_equilibrium *eq)
{
    sbi_step_restore(eq->body);
    sbi_equilibrium_free(eq);
}

/* ---- solves ---- */

/* Of a right-hand side, what rounding may leave. */
static double sbi_equilibrium_rounding(void) { return 1e4 * (double)SB_EPSILON; }

/* x = (T^T K T)^-1 rhs, both condensed and 0 on held axes. */
static sb_result sbi_equilibrium_solve_once(sbi_equilibrium *eq, const sb_vec3 *rhs, sb_vec3 *x)
{
    sb_pcg_options options = sb_default_pcg_options();
    sb_pcg_info info;
    sb_result result;
    if (eq->direct)
        return sb_direct_solve(eq->direct, &rhs[0].x, &x[0].x, 1);
    options.tolerance = eq->tolerance;
    options.max_iterations = eq->few ? SBI_EQUILIBRIUM_PATIENCE : SBI_EQUILIBRIUM_ITERATIONS;
    options.jobs = &eq->body->jobs;
    memset(x, 0, (size_t)eq->node_count * sizeof *x);
    result = sb_pcg_solve(eq->matrix, eq->precond, &rhs[0].x, &x[0].x, &options, &eq->body->pcg, &info);
    if (result == SB_ERROR_NOT_CONVERGED && !info.capped && info.residual <= sbi_equilibrium_rounding())
        return SB_OK;
    if (result != SB_OK && eq->few && sbi_equilibrium_try_factor(eq, &result))
        return result == SB_OK ? sb_direct_solve(eq->direct, &rhs[0].x, &x[0].x, 1) : result;
    return sbi_equilibrium_unstable(eq, result);
}

/* right = T^T (rhs - K x) on free axes; its norm. */
static double sbi_equilibrium_miss(sbi_equilibrium *eq, const sb_vec3 *rhs, int transposed, const sb_vec3 *x)
{
    sbi_equilibrium_multiply(eq, x, transposed, eq->product);
    for (int i = 0; i < eq->node_count; i++)
        eq->right[i] = sb_v3_sub(rhs[i], eq->product[i]);
    sbi_equilibrium_reduce(eq, eq->right);
    sbi_equilibrium_keep_free(eq, eq->right);
    return sbi_equilibrium_norm(eq, eq->right);
}

/* The factor is that of the symmetric part: what is left with the whole is solved for again, as long as that helps. */
static sb_result sbi_equilibrium_refine(sbi_equilibrium *eq, sb_vec3 *v, int transposed)
{
    const double rounding = sbi_equilibrium_rounding();
    sb_vec3 *x = eq->sum;
    double first, left, before = (double)INFINITY;
    memset(x, 0, (size_t)eq->node_count * sizeof *x);
    first = left = sbi_equilibrium_miss(eq, v, transposed, x);
    for (int k = 0; k < SBI_EQUILIBRIUM_ROUNDS && left > 0 && (left < before / 2 || left > rounding * first); k++) {
        sb_result result = sbi_equilibrium_solve_once(eq, eq->right, eq->solution);
        if (result != SB_OK)
            return result;
        sbi_equilibrium_expand(eq, eq->solution);
        for (int i = 0; i < eq->node_count; i++)
            x[i] = sb_v3_add(x[i], eq->solution[i]);
        before = left;
        left = sbi_equilibrium_miss(eq, v, transposed, x);
    }
    if (!(left <= rounding * first) && left > eq->tolerance * first)
        return sbi_fail(eq->error, SB_ERROR_NOT_CONVERGED,
                        "the open rim of a pressure pushes too hard: its part of the tangent leaves %g of a load",
                        left / first);
    memcpy(v, x, (size_t)eq->node_count * sizeof *x);
    return SB_OK;
}

static sb_result sbi_equilibrium_solve_one(sbi_equilibrium *eq, sb_vec3 *v)
{
    size_t bytes = (size_t)eq->node_count * sizeof *v;
    sb_result result;
    sbi_equilibrium_reduce(eq, v);
    sbi_equilibrium_keep_free(eq, v);
    memcpy(eq->right, v, bytes);
    result = sbi_equilibrium_solve_once(eq, eq->right, v);
    if (result == SB_OK)
        sbi_equilibrium_expand(eq, v);
    return result;
}

static sb_result sbi_equilibrium_solve_together(sbi_equilibrium *eq, sb_vec3 *v, int count)
{
    sb_result result;
    for (int k = 0; k < count; k++) {
        sbi_equilibrium_reduce(eq, v + (size_t)k * (size_t)eq->node_count);
        sbi_equilibrium_keep_free(eq, v + (size_t)k * (size_t)eq->node_count);
    }
    result = sb_direct_solve(eq->direct, &v[0].x, &v[0].x, count);
    for (int k = 0; k < count; k++)
        sbi_equilibrium_expand(eq, v + (size_t)k * (size_t)eq->node_count);
    return result;
}

SBI_API sb_result sbi_equilibrium_solve(sbi_equilibrium *eq, int count, int transposed, sb_vec3 *v)
{
    sb_result result = SB_OK;
    if (eq->direct && !eq->skew)
        return sbi_equilibrium_solve_together(eq, v, count);
    for (int k = 0; k < count && result == SB_OK; k++) {
        sb_vec3 *one = v + (size_t)k * (size_t)eq->node_count;
        result = eq->skew ? sbi_equilibrium_refine(eq, one, transposed) : sbi_equilibrium_solve_one(eq, one);
    }
    return result;
}
