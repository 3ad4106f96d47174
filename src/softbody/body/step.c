/* step: one Newton driver for time steps and static solves.
 *
 * Both solve r(u) = M a + D v + f_int(u) - f_ext = 0 with a = ca (u - start) + a0 and v = cv (u - start) + v0;
 * a static solve has ca = cv = 0. So A = dr/du = (ca + alpha cv) M + (1 + beta cv) K, and one iteration is
 * A du = -r. */
#include "step.h"

#include <string.h>

#include "body_private.h"
#include "load.h"
#include "constraint.h"
#include "step_explicit.h"

typedef struct sbi_newton {
    sb_body *body;
    sb_step_info *info;
    int dynamic;
    sb_real cv, ca;           /* dv/du (1/s) and da/du (1/s^2) */
    sb_real dt;
    sb_real load_factor;      /* share of the way from start to target the supports go */
    sb_real loads_factor;     /* share of the way from the values of the last static solve to the present ones that
                               * pressures, springs and mappings have: 1 in a time step */
    sb_real level;            /* share of the step after which u, v and the forces balance: 1, or 1 - alpha_f */
    sb_real inertia_level;    /* the same for a: 1, or 1 - alpha_m */
    sb_real radius;           /* spectral radius of generalised alpha */
    sb_real tolerance;        /* of the residual; a linearised step has none */
    sb_real linear_tolerance; /* of the linear solves; adaptive when 0 */
    int max_newton, max_iterations;
    int line_search;
    int linearised;           /* one iteration, taken as it is */
    int lagged_damping;       /* D's K is the one at the start of the step, in body->damping_blocks; a linearised step
                               * has it in A already */
    int has_velocity;         /* v may differ from 0 at the current u */
    int moves_supports;       /* the present increment moves supported nodes or closes gaps of constraints */
    sb_real scale;            /* largest force (N), to compare residuals with */
    sb_real load_size;        /* times epsilon: rounding of the forces of springs (N) */
    sb_real norm, last_norm;  /* residual on free axes (N), now and one iteration ago */
    sb_real energy;           /* elastic, at the current u; valid when energy_known */
    int energy_known;
    int cautious;             /* 1: the last increment had to be cut short, so project the next tangent */
    int quasi;                /* 1: the quasi tangent, as long as each iteration halves the residual */
} sbi_newton;

/* ---- small vector loops ---- */

static double sbi_step_now(const sb_body *body) { return body->clock ? body->clock() : 0.0; }

static sb_real sbi_step_dot(const sb_vec3 *a, const sb_vec3 *b, int count)
{
    double sum = 0;
    for (int i = 0; i < count; i++)
        sum += (double)a[i].x * (double)b[i].x + (double)a[i].y * (double)b[i].y + (double)a[i].z * (double)b[i].z;
    return (sb_real)sum;
}

/* Axes that a norm counts: all; the free ones; the supported ones and those of slaves. */
typedef enum sbi_step_axes { SBI_STEP_ALL, SBI_STEP_FREE, SBI_STEP_HELD } sbi_step_axes;

static double sbi_step_square(const sb_body *body, int i, sb_vec3 v, sbi_step_axes axes)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    if (axes == SBI_STEP_FREE)
        v = sbi_body_pick_axes(sbi_body_held(body, i), zero, v);
    if (axes == SBI_STEP_HELD)
        v = sbi_body_pick_axes(sbi_body_held(body, i), v, zero);
    return (double)v.x * (double)v.x + (double)v.y * (double)v.y + (double)v.z * (double)v.z;
}

static sb_real sbi_step_norm(const sb_body *body, const sb_vec3 *a, sbi_step_axes axes)
{
    double sum = 0;
    for (int i = 0; i < body->domain.node_count; i++)
        sum += sbi_step_square(body, i, a[i], axes);
    return sb_sqrt((sb_real)sum);
}

/* Connected parts: those of the matrix that is solved, where ties join what they tie. */
static const sb_matrix *sbi_step_parts(const sb_body *body)
{
    return body->elimination ? &body->elimination->matrix : &body->matrix;
}

/* The same of one part's nodes. */
static sb_real sbi_step_part_norm(const sb_body *body, int part, const sb_vec3 *a, sbi_step_axes axes)
{
    const sb_matrix *parts = sbi_step_parts(body);
    double sum = 0;
    for (int k = parts->part_start[part]; k < parts->part_start[part + 1]; k++)
        sum += sbi_step_square(body, parts->part_rows[k], a[parts->part_rows[k]], axes);
    return sb_sqrt((sb_real)sum);
}

static sb_vec3 sbi_step_velocity(const sbi_newton *newton, int i)
{
    const sb_body *b = newton->body;
    return sb_v3_madd(b->velocity0[i], newton->cv, sb_v3_sub(b->displacement[i], b->start[i]));
}

static sb_vec3 sbi_step_acceleration(const sbi_newton *newton, int i)
{
    const sb_body *b = newton->body;
    return sb_v3_madd(b->acceleration0[i], newton->ca, sb_v3_sub(b->displacement[i], b->start[i]));
}

/* ---- one Newton iteration: residual ---- */

static sb_result sbi_newton_force(sbi_newton *newton)
{
    sb_body *b = newton->body;
    double begin = sbi_step_now(b);
    int bad = -1;
    if (!b->force_current) {
        bad = sbi_assembly_force(&b->assembly, b->displacement, b->internal);
        b->force_current = bad < 0;
    }
    newton->info->seconds_force += sbi_step_now(b) - begin;
    if (bad >= 0)
        return sbi_fail_element(&newton->info->error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    return SB_OK;
}

static sb_real sbi_newton_mass_factor(const sbi_newton *newton)
{
    return newton->dynamic ? newton->ca + newton->body->damping_mass * newton->cv : 0;
}

/* Share of the assembled stiffness in A: damping is part of it in a linearised step. */
static sb_real sbi_newton_stiffness_factor(const sbi_newton *newton)
{
    return newton->dynamic && !newton->lagged_damping ? 1 + newton->body->damping_stiffness * newton->cv : 1;
}

/* The body's matrix with the damping stiffness in place of the tangent; borrowed. */
static sb_matrix sbi_newton_damping_matrix(const sb_body *b)
{
    sb_matrix matrix = b->matrix;
    matrix.blocks = b->damping_blocks;
    return matrix;
}

/* matrix = A at the present displacement, whose forces are current. */
static void sbi_newton_tangent(sbi_newton *newton, sb_tangent_kind kind)
{
    sb_body *b = newton->body;
    double begin = sbi_step_now(b);
    sbi_assembly_tangent(&b->assembly, b->displacement, kind, sbi_newton_stiffness_factor(newton), &b->matrix);
    if (newton->dynamic)
        sbi_body_add_mass(b, sbi_newton_mass_factor(newton));
    if (newton->lagged_damping) {
        sb_real factor = b->damping_stiffness * newton->cv;
        for (int k = 0; k < b->matrix.block_count; k++)
            for (int c = 0; c < 9; c++)
                b->matrix.blocks[k][c] += factor * b->damping_blocks[k][c];
    }
    if (b->load_count)
        sbi_loads_add_tangent(b, b->displacement, kind, newton->loads_factor, &b->matrix);
    newton->info->seconds_tangent += sbi_step_now(b) - begin;
}

/* Keeps the stiffness at the start of the step for D. Were it to follow the iterations, the step would have no
 * potential to go down, and an indefinite or suddenly larger K would feed energy in. */
static sb_result sbi_newton_keep_damping(sbi_newton *newton)
{
    sb_body *b = newton->body;
    double begin;
    sb_result result = sbi_newton_force(newton);
    if (result != SB_OK)
        return result;
    begin = sbi_step_now(b);
    sbi_assembly_tangent(&b->assembly, b->displacement, SB_TANGENT_SPD, 1, &b->matrix);
    memcpy(b->damping_blocks, b->matrix.blocks, (size_t)b->matrix.block_count * sizeof b->matrix.blocks[0]);
    newton->info->seconds_tangent += sbi_step_now(b) - begin;
    newton->lagged_damping = 1;
    return SB_OK;
}

/* out = K x with the K of D. In a linearised step it comes from A = cm M + ck K + (springs), which is assembled by
 * then. */
static void sbi_newton_damping_product(const sbi_newton *newton, const sb_vec3 *x, sb_vec3 *out)
{
    sb_body *b = newton->body;
    sb_matrix damping = sbi_newton_damping_matrix(b);
    sb_real mass = sbi_newton_mass_factor(newton), stiffness = (sb_real)1 / sbi_newton_stiffness_factor(newton);
    if (newton->lagged_damping) {
        sb_matrix_multiply(&damping, &x[0].x, &out[0].x, &b->jobs);
        return;
    }
    sb_matrix_multiply(&b->matrix, &x[0].x, &out[0].x, &b->jobs);
    if (b->load_count)
        sbi_loads_subtract_product(b, x, newton->loads_factor, out);
    sbi_body_mass_multiply(b, x, b->work2);
    for (int i = 0; i < b->domain.node_count; i++)
        out[i] = sb_v3_scale(stiffness, sb_v3_madd(out[i], -mass, b->work2[i]));
}

/* Compares residuals with these forces, too: those of each part with its own, for what is little beside the forces of
 * one part may be all that another feels. */
static void sbi_newton_raise_scale(sbi_newton *newton, const sb_vec3 *force, sbi_step_axes axes)
{
    const sb_body *b = newton->body;
    int parts = sbi_step_parts(b)->part_count;
    newton->scale = sb_max(newton->scale, sbi_step_norm(b, force, axes));
    for (int c = 0; parts > 1 && c < parts; c++)
        b->part_scale[c] = sb_max(b->part_scale[c], sbi_step_part_norm(b, c, force, axes));
}

/* residual += M (a + alpha v) + beta K v. */
static void sbi_newton_add_dynamics(sbi_newton *newton)
{
    sb_body *b = newton->body;
    int n = b->domain.node_count;
    for (int i = 0; i < n; i++)
        b->work[i] = sb_v3_madd(sbi_step_acceleration(newton, i), b->damping_mass, sbi_step_velocity(newton, i));
    sbi_body_mass_multiply(b, b->work, b->work2);
    for (int i = 0; i < n; i++)
        b->residual[i] = sb_v3_add(b->residual[i], b->work2[i]);
    sbi_newton_raise_scale(newton, b->work2, SBI_STEP_ALL);
    if (!(b->damping_stiffness > 0) || !newton->has_velocity)
        return;
    for (int i = 0; i < n; i++)
        b->work[i] = sbi_step_velocity(newton, i);
    sbi_newton_damping_product(newton, b->work, b->rhs);
    for (int i = 0; i < n; i++)
        b->residual[i] = sb_v3_madd(b->residual[i], b->damping_stiffness, b->rhs[i]);
}

/* residual -= forces of the loads that follow the body. `external` holds the dead ones only until a solve ends. */
static void sbi_newton_add_loads(sbi_newton *newton)
{
    sb_body *b = newton->body;
    int n = b->domain.node_count;
    newton->load_size = sbi_loads_force(b, b->displacement, newton->loads_factor);
    for (int i = 0; i < n; i++)
        b->residual[i] = sb_v3_sub(b->residual[i], b->follower[i]);
    sbi_newton_raise_scale(newton, b->follower, SBI_STEP_ALL);
}

/* The residual that has to vanish on the free axes: slaves have handed theirs to their masters. */
static const sb_vec3 *sbi_newton_unbalanced(const sb_body *b)
{
    return b->elimination ? b->elimination->reduced : b->residual;
}

/* residual = r(u), its norm on the free axes, and the force to compare it with. */
static void sbi_newton_residual(sbi_newton *newton)
{
    sb_body *b = newton->body;
    int n = b->domain.node_count;
    for (int i = 0; i < n; i++)
        b->residual[i] = sb_v3_sub(b->internal[i], b->external[i]);
    newton->scale = 0;
    memset(b->part_scale, 0, (size_t)sbi_step_parts(b)->part_count * sizeof *b->part_scale);
    sbi_newton_raise_scale(newton, b->external, SBI_STEP_ALL);
    sbi_newton_raise_scale(newton, b->internal, SBI_STEP_HELD);
    if (b->load_count)
        sbi_newton_add_loads(newton);
    if (newton->dynamic) {
        sbi_newton_raise_scale(newton, b->internal, SBI_STEP_ALL);
        sbi_newton_add_dynamics(newton);
    }
    newton->last_norm = newton->norm;
    if (b->elimination)
        sbi_elimination_reduce(b->elimination, b->residual, b->elimination->reduced, NULL);
    newton->norm = sbi_step_norm(b, sbi_newton_unbalanced(b), SBI_STEP_FREE);
}

/* ---- one Newton iteration: linear solve ---- */

/* Where the supports of node i should be at the present load factor; exact at the end of the way. */
static sb_vec3 sbi_newton_goal(const sbi_newton *newton, int i)
{
    const sb_body *b = newton->body;
    if (newton->load_factor == 1)
        return b->target[i];
    return sb_v3_madd(b->start[i], newton->load_factor, sb_v3_sub(b->target[i], b->start[i]));
}

/* What supported axes of node i still have to go. */
static sb_vec3 sbi_newton_way_to_go(const sbi_newton *newton, int i)
{
    const sb_body *b = newton->body;
    return sbi_body_pick_axes(b->fixed[i], sb_v3_sub(sbi_newton_goal(newton, i), b->displacement[i]), sb_v3(0, 0, 0));
}

static int sbi_newton_supports_move(const sbi_newton *newton)
{
    const sb_body *b = newton->body;
    if (b->elimination && sbi_elimination_open(b->elimination, b->displacement, newton->load_factor))
        return 1;
    for (int i = 0; i < b->domain.node_count; i++)
        if (b->fixed[i]) {
            sb_vec3 go = sbi_newton_way_to_go(newton, i);
            if (go.x != 0 || go.y != 0 || go.z != 0)
                return 1;
        }
    return 0;
}

/* Start of the linear solve: what the motion predicts on free axes, the way still to go on supported ones. */
static void sbi_newton_predict(sbi_newton *newton, int first)
{
    sb_body *b = newton->body;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 coast = sb_v3(0, 0, 0);
        if (first && newton->dynamic)
            coast = sb_v3_scale(newton->level * newton->dt, b->velocity[i]);
        b->increment[i] = sbi_body_pick_axes(b->fixed[i], sbi_newton_way_to_go(newton, i), coast);
    }
}

/* Keeps the rows of supported nodes, which the reactions need, before they are masked. */
static void sbi_newton_keep_support_rows(sb_body *b)
{
    const sb_matrix *matrix = &b->matrix;
    sb_real(*out)[9] = b->support_blocks;
    for (int i = 0; i < matrix->row_count; i++)
        if (b->fixed[i] && b->node_component[i] >= 0) {
            int count = matrix->row_end[i] - matrix->row_start[i];
            memcpy(out, matrix->blocks + matrix->row_start[i], (size_t)count * sizeof *out);
            out += count;
        }
}

/* Reactions of a constrained body, whose matrix has not been masked: r, or r + A du, condensed. */
static void sbi_newton_constrained_reactions(const sbi_newton *newton)
{
    sb_body *b = newton->body;
    memcpy(b->work, b->residual, (size_t)b->domain.node_count * sizeof(sb_vec3));
    if (newton->linearised) {
        sb_matrix_multiply(&b->matrix, &b->increment[0].x, &b->work2[0].x, &b->jobs);
        for (int i = 0; i < b->domain.node_count; i++)
            b->work[i] = sb_v3_add(b->work[i], b->work2[i]);
    }
    sbi_constraint_reactions(b, b->work);
}

/* Reactions: r on supported axes. Of a linearised step r + A du, since its r is the one before du. */
static void sbi_newton_reactions(const sbi_newton *newton)
{
    sb_body *b = newton->body;
    const sb_matrix *matrix = &b->matrix;
    const sb_real(*row)[9] = (const sb_real(*)[9])b->support_blocks;
    const sb_vec3 zero = sb_v3(0, 0, 0);
    if (b->elimination) {
        sbi_newton_constrained_reactions(newton);
        return;
    }
    for (int i = 0; i < matrix->row_count; i++) {
        sb_vec3 sum = b->residual[i];
        b->reaction[i] = zero;
        if (!b->fixed[i] || b->node_component[i] < 0)
            continue;
        for (int k = matrix->row_start[i]; newton->linearised && k < matrix->row_end[i]; k++, row++) {
            sb_vec3 d = b->increment[matrix->columns[k]];
            const sb_real *m = *row;
            sum = sb_v3_add(sum, sb_v3(m[0] * d.x + m[1] * d.y + m[2] * d.z, m[3] * d.x + m[4] * d.y + m[5] * d.z,
                                       m[6] * d.x + m[7] * d.y + m[8] * d.z));
        }
        b->reaction[i] = sbi_body_pick_axes(b->fixed[i], sum, zero);
    }
}

/* Tolerance of this iteration's linear solve. A linearised step has its own; otherwise it tightens with Newton's
 * progress (Eisenstat and Walker 1996, choice 2), never beyond what the residual's tolerance can notice. */
static sb_real sbi_newton_linear_tolerance(const sbi_newton *newton, int iteration)
{
    const sb_body *b = newton->body;
    sb_real least = 10 * SB_EPSILON, enough = least, forcing = (sb_real)1e-2;
    int linear = 1;
    if (newton->linear_tolerance > 0)
        return newton->linear_tolerance;
    for (int i = 0; i < b->material_count; i++)
        linear = linear && sb_material_is_linear(b->materials[i].model);
    if (newton->norm > 0)
        enough = (sb_real)0.1 * newton->tolerance * newton->scale / newton->norm;
    if (linear)
        return sb_max(sb_min((sb_real)0.1 * newton->tolerance, enough), least);
    if (iteration > 0 && newton->last_norm > 0) {
        sb_real ratio = newton->norm / newton->last_norm;
        forcing = sb_min(forcing, (sb_real)0.5 * ratio * ratio);
    }
    return sb_max(sb_max(forcing, sb_min(enough, (sb_real)1e-2)), least);
}

/* T^T A T du' = T^T (-r - A g) in place of A du = -r, g being the jump that closes the constraints' gaps while their
 * masters rest. Returns 1 when there is one. */
static int sbi_newton_condense(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sbi_elimination *e = b->elimination;
    int n = b->domain.node_count, open = sbi_elimination_open(e, b->displacement, newton->load_factor);
    if (open) {
        memset(b->work, 0, (size_t)n * sizeof(sb_vec3));
        sbi_elimination_expand(e, b->work, 1);
        sb_matrix_multiply(&b->matrix, &b->work[0].x, &b->work2[0].x, &b->jobs);
        for (int i = 0; i < n; i++)
            b->rhs[i] = sb_v3_sub(b->rhs[i], b->work2[i]);
    }
    sbi_elimination_reduce(e, b->rhs, b->rhs, NULL);
    sbi_elimination_clear_slaves(e, b->increment);
    sbi_elimination_condense(e, &b->matrix);
    for (int i = 0; i < n; i++)
        e->held[i] = (unsigned char)sbi_body_held(b, i);
    return open;
}

/* Solves A du = -r with the supports' increments prescribed. */
static sb_result sbi_newton_solve(sbi_newton *newton, int iteration)
{
    sb_body *b = newton->body;
    sb_step_info *info = newton->info;
    sb_pcg_options options = sb_default_pcg_options();
    sb_pcg_info pcg = {0, 0, 0, 0, 0};
    sbi_elimination *e = b->elimination;
    sb_matrix *matrix = e ? &e->matrix : &b->matrix;
    sb_preconditioner *precond = e ? e->precond : b->precond;
    sb_result result;
    int open = 0;
    double begin = sbi_step_now(b), middle;
    sbi_newton_predict(newton, iteration == 0);
    for (int i = 0; i < b->domain.node_count; i++)
        b->rhs[i] = sb_v3_scale(-1, b->residual[i]);
    if (e)
        open = sbi_newton_condense(newton);
    else
        sbi_newton_keep_support_rows(b);
    sbi_matrix_constrain(matrix, e ? e->held : b->fixed, &b->increment[0].x, &b->rhs[0].x, &b->jobs);
    result = sbi_body_update_precond(b, precond, matrix, &info->error);
    middle = sbi_step_now(b);
    info->seconds_precond += middle - begin;
    if (result != SB_OK)
        return result;
    options.tolerance = (double)sbi_newton_linear_tolerance(newton, iteration);
    options.max_iterations = newton->max_iterations;
    options.jobs = &b->jobs;
    result = sbi_pcg_solve_current(matrix, precond, &b->rhs[0].x, &b->increment[0].x, &options, &b->pcg, &pcg);
    info->seconds_solve += sbi_step_now(b) - middle;
    info->pcg_iterations += pcg.iterations;
    info->newton_iterations++;
    if (newton->linearised)
        info->residual = (sb_real)pcg.residual;
    if (result == SB_ERROR_NOT_CONVERGED) { /* still the best increment so far: use it */
        info->capped |= pcg.capped;
        result = SB_OK;
    }
    if (e)
        sbi_elimination_expand(e, b->increment, open);
    return result;
}

/* ---- one Newton iteration: line search ---- */

/* Potential along du without the elastic energy: t * linear + t^2 * quadratic + t^3 * cubic, from inertia, damping and
 * loads. Pressures may have no potential; the work they do along the line serves in its place. */
typedef struct sbi_newton_line {
    sb_real slope;      /* r . du, what Armijo asks a share of */
    sb_real linear, quadratic, cubic;
    sb_real load_size;  /* sum of what the loads that follow the body add: for rounding */
} sbi_newton_line;

static sbi_newton_line sbi_newton_make_line(sbi_newton *newton)
{
    sb_body *b = newton->body;
    int n = b->domain.node_count;
    sbi_newton_line line = {0, 0, 0, 0, 0};
    line.slope = sbi_step_dot(b->residual, b->increment, n);
    line.linear = line.slope - sbi_step_dot(b->internal, b->increment, n);
    if (newton->dynamic) {
        sbi_body_mass_multiply(b, b->increment, b->work);
        line.quadratic = sbi_newton_mass_factor(newton) * sbi_step_dot(b->increment, b->work, n);
        if (newton->lagged_damping) {
            sbi_newton_damping_product(newton, b->increment, b->work);
            line.quadratic += b->damping_stiffness * newton->cv * sbi_step_dot(b->increment, b->work, n);
        }
        line.quadratic *= (sb_real)0.5;
    }
    if (b->load_count) { /* the residual has their linear part */
        sbi_loads_work work = sbi_loads_line(b, b->displacement, b->increment, newton->loads_factor);
        line.quadratic -= work.quadratic;
        line.cubic -= work.cubic;
        line.load_size = sb_abs(work.linear) + sb_abs(work.quadratic) + sb_abs(work.cubic);
    }
    return line;
}

/* Displacement for a share t of the increment, in work2. A whole increment puts the supports where they belong to
 * the last bit, so that no rounding error keeps them on the way; and slaves where they belong, unless they are still
 * on theirs. */
static void sbi_newton_trial(const sbi_newton *newton, sb_real t)
{
    const sb_body *b = newton->body;
    for (int i = 0; i < b->domain.node_count; i++) {
        b->work2[i] = sb_v3_madd(b->displacement[i], t, b->increment[i]);
        if (t == 1 && b->fixed[i])
            b->work2[i] = sbi_body_pick_axes(b->fixed[i], sbi_newton_goal(newton, i), b->work2[i]);
    }
    if (b->elimination && (t == 1 || !newton->moves_supports))
        sbi_elimination_follow(b->elimination, b->work2, newton->load_factor);
}

/* Elastic energy of a trial displacement; 0 when it is inadmissible, with *bad the element that is. */
static int sbi_newton_try(sbi_newton *newton, const sb_vec3 *trial, sb_real *energy, int *bad)
{
    *bad = sbi_assembly_energy(&newton->body->assembly, trial, energy);
    return *bad < 0 && sb_is_finite(*energy);
}

static void sbi_newton_take(sbi_newton *newton, const sb_vec3 *trial, sb_real energy)
{
    sb_body *b = newton->body;
    memcpy(b->displacement, trial, (size_t)b->domain.node_count * sizeof(sb_vec3));
    newton->energy = energy;
    newton->energy_known = 1;
}

static sb_result sbi_newton_no_step(sbi_newton *newton, int bad)
{
    if (bad >= 0)
        return sbi_fail_element(&newton->info->error, SB_ERROR_INVERTED, bad,
                                "element %d would turn inside out however short the step", bad);
    return sbi_fail(&newton->info->error, SB_ERROR_DIVERGED, "no step along the search direction lowers the energy");
}

/* While supports move, work comes in through them and no energy has to fall: the longest admissible share of the
 * increment is taken. In a time step the increment may be far off, when a tool jumps by more than an element; then
 * the supports alone move if that costs less, and the next iterations bring the rest along. */
static sb_result sbi_newton_move_supports(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_real least = newton->linearised ? (sb_real)0.75 : (sb_real)1e-6; /* no iteration would bring them the rest */
    sb_real energy = 0, alone = 0, t;
    int bad = -1;
    for (t = 1; t > least; t *= (sb_real)0.5) {
        sbi_newton_trial(newton, t);
        if (sbi_newton_try(newton, b->work2, &energy, &bad))
            break;
    }
    if (newton->dynamic && (t < 1 || energy > 0)) {
        for (int i = 0; i < b->domain.node_count; i++)
            b->work[i] = sbi_body_pick_axes(b->fixed[i], sbi_newton_goal(newton, i), b->displacement[i]);
        if (b->elimination)
            sbi_elimination_follow(b->elimination, b->work, newton->load_factor);
        if (sbi_newton_try(newton, b->work, &alone, &bad) && (t < 1 || alone < energy)) {
            sbi_newton_take(newton, b->work, alone);
            return SB_OK;
        }
    }
    if (!(t > least))
        return sbi_newton_no_step(newton, bad);
    sbi_newton_take(newton, b->work2, energy);
    return SB_OK;
}

/* Takes the first share t = 1, 1/2, 1/4 ... of the increment whose shape is admissible and whose potential fell
 * enough (Armijo). */
static sb_result sbi_newton_search(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sbi_newton_line line;
    int bad = -1;
    if (!newton->energy_known && !sbi_newton_try(newton, b->displacement, &newton->energy, &bad))
        return sbi_newton_no_step(newton, bad);
    newton->energy_known = 1;
    line = sbi_newton_make_line(newton);
    if (!(line.slope < 0) && !newton->linearised)
        return SB_ERROR_INDEFINITE;
    line.slope = sb_min(line.slope, 0);
    for (sb_real t = 1; t > (sb_real)1e-6; t *= (sb_real)0.5) {
        sb_real energy, change, noise;
        sbi_newton_trial(newton, t);
        if (!sbi_newton_try(newton, b->work2, &energy, &bad))
            continue;
        change = energy - newton->energy + t * line.linear + t * t * line.quadratic + t * t * t * line.cubic;
        noise = 32 * SB_EPSILON * (sb_abs(energy) + sb_abs(newton->energy) + sb_abs(t * line.linear) +
                                   t * line.load_size) +
                4 * SB_EPSILON * b->assembly.energy_unit;
        if (change <= (sb_real)1e-4 * t * line.slope + noise) {
            sbi_newton_take(newton, b->work2, energy);
            newton->cautious = t < 1;
            return SB_OK;
        }
    }
    return sbi_newton_no_step(newton, bad);
}

static sb_result sbi_newton_accept(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_result result = SB_OK;
    if (newton->line_search) {
        result = newton->moves_supports ? sbi_newton_move_supports(newton) : sbi_newton_search(newton);
    } else {
        sbi_newton_trial(newton, 1);
        memcpy(b->displacement, b->work2, (size_t)b->domain.node_count * sizeof(sb_vec3));
    }
    if (result != SB_OK)
        return result;
    for (int i = 0; i < b->domain.node_count; i++)
        if (!sb_v3_is_finite(b->displacement[i]))
            return sbi_fail_node(&newton->info->error, SB_ERROR_DIVERGED, i, "the displacement of node %d is not finite",
                                 i);
    b->force_current = 0;
    newton->has_velocity = 1;
    return SB_OK;
}

/* 1 when the increment is below what the displacement's digits can show: nothing is left to gain. */
static int sbi_newton_is_exhausted(const sb_body *b)
{
    sb_real largest = 0, size = 0;
    for (int i = 0; i < b->domain.node_count; i++) {
        largest = sb_max(largest, sb_v3_dot(b->increment[i], b->increment[i]));
        size = sb_max(size, sb_v3_dot(b->displacement[i], b->displacement[i]));
    }
    return largest <= 16 * SB_EPSILON * SB_EPSILON * size;
}

/* ---- the Newton loop ---- */

/* One iteration with the given tangent; SB_ERROR_INDEFINITE asks for a projected one. */
static sb_result sbi_newton_iterate(sbi_newton *newton, int iteration, sb_tangent_kind kind)
{
    sb_result result = sbi_newton_solve(newton, iteration);
    if (result == SB_OK)
        result = sbi_newton_accept(newton);
    if (result == SB_ERROR_INDEFINITE && kind != SB_TANGENT_EXACT)
        return sbi_fail(&newton->info->error, result, "the projected tangent is not positive definite: %s",
                        newton->moves_supports ? "supports move too far in one step"
                                               : "the body is not supported, or torn beyond what can be solved");
    return result;
}

/* The exact tangent where its convergence pays. Far from the solution its directions are poor, which shows in short
 * increments; and while a time step still moves supports, no line search watches the increment, so that the tangent
 * must be safe by itself. */
static sb_tangent_kind sbi_newton_first_kind(sbi_newton *newton)
{
    newton->quasi = newton->quasi && !(newton->last_norm > 0 && newton->norm > (sb_real)0.5 * newton->last_norm);
    if (newton->quasi)
        return SB_TANGENT_QUASI;
    return newton->cautious || (newton->dynamic && newton->moves_supports) ? SB_TANGENT_SPD : SB_TANGENT_EXACT;
}

/* Forces, residual, and the tangent of a linearised step. */
static sb_result sbi_newton_evaluate(sbi_newton *newton)
{
    sb_result result = sbi_newton_force(newton);
    if (result != SB_OK)
        return result;
    newton->moves_supports = sbi_newton_supports_move(newton);
    if (newton->linearised) /* its residual may need K v */
        sbi_newton_tangent(newton, SB_TANGENT_QUASI);
    sbi_newton_residual(newton);
    if (!sb_is_finite(newton->norm))
        return sbi_fail(&newton->info->error, SB_ERROR_DIVERGED, "the forces are not finite");
    return SB_OK;
}

/* Largest residual of a part over the part's forces, into info. Returns 1 when each meets the tolerance, or is no more than
 * `rounding` (N). */
static int sbi_newton_parts_meet(sbi_newton *newton, sb_real rounding)
{
    const sb_body *b = newton->body;
    int parts = sbi_step_parts(b)->part_count, meet = 1;
    newton->info->residual = 0;
    for (int c = 0; c < parts; c++) {
        sb_real norm = parts > 1 ? sbi_step_part_norm(b, c, sbi_newton_unbalanced(b), SBI_STEP_FREE) : newton->norm;
        sb_real scale = parts > 1 ? b->part_scale[c] : newton->scale;
        if (scale > 0)
            newton->info->residual = sb_max(newton->info->residual, norm / scale);
        meet &= norm <= newton->tolerance * scale || norm <= rounding;
    }
    return meet;
}

/* 1 when the residual is small enough, or as small as rounding lets it become. */
static int sbi_newton_is_converged(sbi_newton *newton, int iteration)
{
    sb_real rounding = 16 * SB_EPSILON * (newton->body->force_unit + newton->load_size);
    int meet = sbi_newton_parts_meet(newton, iteration > 0 ? rounding : 0);
    return !newton->moves_supports && (meet || (iteration > 0 && sbi_newton_is_exhausted(newton->body)));
}

static int sbi_newton_allows_inversion(const sb_body *b)
{
    for (int i = 0; i < b->material_count; i++)
        if (!sb_material_allows_inversion(b->materials[i].model))
            return 0;
    return 1;
}

/* The one iteration of a linearised step. Where the material forbids inverted elements the new shape is tried at once
 * (the next step finds its forces done): the body must stay steppable. */
static sb_result sbi_newton_linearised(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_result result = sbi_newton_iterate(newton, 0, SB_TANGENT_QUASI);
    for (int i = 0; newton->line_search && result == SB_OK && i < b->domain.node_count; i++)
        b->increment[i] = sb_v3_sub(b->displacement[i], b->start[i]); /* a share of it: what the reactions go by */
    if (result == SB_OK && !sbi_newton_allows_inversion(b))
        result = sbi_newton_force(newton);
    return result;
}

/* 1 when a linearised step may be taken as it is: forces that grow no faster than displacements. Those of hyperelastic
 * materials do, so that an increment that went too far would feed the next: there the line search watches it. */
static int sbi_newton_is_tame(const sb_body *b)
{
    for (int i = 0; i < b->material_count; i++)
        if (sb_material_is_hyperelastic(b->materials[i].model))
            return 0;
    return 1;
}

/* Iterates to r(u) = 0 (or once, for a linearised step). The displacement is moved; the caller undoes failures. */
static sb_result sbi_newton_run(sbi_newton *newton)
{
    for (int iteration = 0;; iteration++) {
        sb_tangent_kind kind;
        sb_result result = sbi_newton_evaluate(newton);
        if (result != SB_OK)
            return result;
        if (newton->linearised)
            return sbi_newton_linearised(newton);
        if (sbi_newton_is_converged(newton, iteration))
            return SB_OK;
        if (iteration == newton->max_newton)
            return SB_ERROR_NOT_CONVERGED;
        kind = sbi_newton_first_kind(newton);
        sbi_newton_tangent(newton, kind);
        result = sbi_newton_iterate(newton, iteration, kind);
        if (result == SB_ERROR_INDEFINITE && kind == SB_TANGENT_EXACT) {
            sbi_newton_tangent(newton, SB_TANGENT_SPD);
            result = sbi_newton_iterate(newton, iteration, SB_TANGENT_SPD);
        }
        if (result != SB_OK)
            return result;
    }
}

/* ---- time steps ---- */

static void sbi_step_loads(sb_body *b)
{
    for (int i = 0; i < b->domain.node_count; i++)
        b->work[i] = b->gravity;
    sbi_body_mass_multiply(b, b->work, b->external);
    for (int i = 0; i < b->domain.node_count; i++)
        b->external[i] = sb_v3_add(b->external[i], b->dead_load[i]);
}

/* The same of a constrained body with its lumped mass: slaves hand forces and masses to their masters. */
static sb_result sbi_step_lumped_acceleration(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_result result = sbi_constraint_explicit_check(b, &newton->info->error);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < b->domain.node_count; i++) {
        b->work[i] = sb_v3_scale(-1, b->residual[i]);
        b->acceleration[i] = sb_v3(0, 0, 0);
    }
    sbi_constraint_explicit(b, b->work, b->acceleration, 0);
    return SB_OK;
}

/* M a = f_ext - f_int - D v: what Newmark starts from. Supported nodes start without acceleration. */
static sb_result sbi_step_initial_acceleration(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_result result = sbi_newton_force(newton);
    sbi_newton start = *newton;
    int n = b->domain.node_count;
    if (result != SB_OK)
        return result;
    start.cv = start.ca = 0;
    start.linear_tolerance = 100 * SB_EPSILON;
    start.max_iterations = sbi_max_int(newton->max_iterations, 1000);
    memcpy(b->velocity0, b->velocity, (size_t)n * sizeof(sb_vec3));
    memset(b->acceleration0, 0, (size_t)n * sizeof(sb_vec3));
    start.has_velocity = 1;
    if (!start.lagged_damping)
        sbi_newton_tangent(&start, SB_TANGENT_QUASI);
    sbi_newton_residual(&start);
    sb_matrix_clear(&b->matrix);
    sbi_body_add_mass(b, 1);
    start.dynamic = 0;
    start.load_factor = 0;
    result = sbi_newton_solve(&start, 0);
    if (result == SB_OK)
        memcpy(b->acceleration, b->increment, (size_t)n * sizeof(sb_vec3));
    if (result != SB_ERROR_INDEFINITE || b->mass_kind != SB_MASS_REDUCED)
        return result;
    if (b->elimination)
        return sbi_step_lumped_acceleration(newton);
    for (int i = 0; i < n; i++) /* a reduced mass may be singular: its lumped sister is not */
        b->acceleration[i] = sbi_body_pick_axes(b->fixed[i], sb_v3(0, 0, 0),
                                                sb_v3_scale(-1 / b->lumped_mass[i], b->residual[i]));
    return SB_OK;
}

/* Generalised alpha (Chung and Hulbert 1993) in the unknown u at the level 1 - alpha_f of the step: with
 * d = (u - start) / level the Newmark rules give a' and v' at its end, and
 *     v = level v' + (1 - level) v_n,  a = inertia_level a' + (1 - inertia_level) a_n. */
static void sbi_step_scheme_alpha(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_real dt = newton->dt, r = newton->radius, level = 1 / (1 + r), inertia = (2 - r) / (1 + r);
    sb_real gamma = inertia - level + (sb_real)0.5, beta = (1 + inertia - level) * (1 + inertia - level) / 4;
    newton->level = newton->load_factor = level;
    newton->inertia_level = inertia;
    newton->cv = gamma / (beta * dt);
    newton->ca = inertia / (beta * dt * dt * level);
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 v = b->velocity[i], a = b->acceleration[i];
        sb_vec3 v0 = sb_v3_madd(sb_v3_scale(1 - level * gamma / beta, v), level * dt * (1 - gamma / (2 * beta)), a);
        sb_vec3 a0 = sb_v3_madd(sb_v3_scale(1 - inertia / (2 * beta), a), -inertia / (beta * dt), v);
        if (b->fixed[i]) {
            sb_vec3 go = sb_v3_sub(b->target[i], b->start[i]), rate = sb_v3_scale(1 / dt, go);
            sb_vec3 change = sb_v3_scale(1 / dt, sb_v3_sub(rate, v));
            sb_vec3 rate_now = sb_v3_madd(sb_v3_scale(1 - level, v), level, rate);
            sb_vec3 change_now = sb_v3_madd(sb_v3_scale(1 - inertia, a), inertia, change);
            v0 = sbi_body_pick_axes(b->fixed[i], sb_v3_madd(rate_now, -newton->cv * level, go), v0);
            a0 = sbi_body_pick_axes(b->fixed[i], sb_v3_madd(change_now, -newton->ca * level, go), a0);
        }
        b->velocity0[i] = v0;
        b->acceleration0[i] = a0;
    }
    if (b->elimination)
        sbi_constraint_scheme(b, newton->cv, newton->ca, dt, level, inertia);
    newton->has_velocity = 1;
}

/* Coefficients and predictors of the integrator. Supported axes move evenly to their targets. */
static void sbi_step_scheme(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_real dt = newton->dt;
    int newmark = b->integrator == SB_NEWMARK;
    newton->cv = (newmark ? 2 : 1) / dt;
    newton->ca = (newmark ? 4 : 1) / (dt * dt);
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 v = b->velocity[i], v0 = sb_v3(0, 0, 0), a0 = sb_v3_scale(-1 / dt, v);
        if (newmark) {
            v0 = sb_v3_scale(-1, v);
            a0 = sb_v3_sub(sb_v3_scale(-4 / dt, v), b->acceleration[i]);
        }
        if (b->fixed[i]) {
            sb_vec3 go = sb_v3_sub(b->target[i], b->start[i]), rate = sb_v3_scale(1 / dt, go);
            sb_vec3 change = sb_v3_scale(1 / dt, sb_v3_sub(rate, v));
            v0 = sbi_body_pick_axes(b->fixed[i], sb_v3_madd(rate, -newton->cv, go), v0);
            a0 = sbi_body_pick_axes(b->fixed[i], sb_v3_madd(change, -newton->ca, go), a0);
        }
        b->velocity0[i] = v0;
        b->acceleration0[i] = a0;
    }
    if (b->elimination)
        sbi_constraint_scheme(b, newton->cv, newton->ca, dt, 1, 1);
    newton->has_velocity = newmark;
}

/* What a failing step gives back, and where it is kept meanwhile. */
typedef struct sbi_step_pair {
    sb_vec3 *state, *saved;
} sbi_step_pair;

enum { SBI_STEP_PAIRS = 6 };

static void sbi_step_pairs(sb_body *b, sbi_step_pair pairs[SBI_STEP_PAIRS])
{
    sb_vec3 *const state[SBI_STEP_PAIRS] = {b->displacement, b->velocity, b->acceleration,
                                            b->reaction,     b->external, b->internal};
    sb_vec3 *const saved[SBI_STEP_PAIRS] = {b->start,          b->saved_velocity, b->saved_acceleration,
                                            b->saved_reaction, b->saved_external, b->saved_internal};
    for (int i = 0; i < SBI_STEP_PAIRS; i++) {
        pairs[i].state = state[i];
        pairs[i].saved = saved[i];
    }
}

static void sbi_step_save(sb_body *b)
{
    sbi_step_pair pairs[SBI_STEP_PAIRS];
    sbi_step_pairs(b, pairs);
    for (int i = 0; i < SBI_STEP_PAIRS; i++)
        memcpy(pairs[i].saved, pairs[i].state, (size_t)b->domain.node_count * sizeof(sb_vec3));
    if (b->elimination)
        sbi_elimination_save(b->elimination, b->start);
    b->saved_force_current = b->force_current;
    b->saved_unknots = b->assembly.unknots;
    b->saved_precond = sbi_precond_get_memory(b->precond);
    if (b->integrator == SB_CENTRAL_DIFFERENCE) /* its substeps move the memory on */
        sbi_assembly_save_memory(&b->assembly);
    sbi_assembly_save_rotations(&b->assembly);
}

static void sbi_step_undo(sb_body *b)
{
    sbi_step_pair pairs[SBI_STEP_PAIRS];
    sbi_step_pairs(b, pairs);
    for (int i = 0; i < SBI_STEP_PAIRS; i++)
        memcpy(pairs[i].state, pairs[i].saved, (size_t)b->domain.node_count * sizeof(sb_vec3));
    if (b->elimination)
        sbi_elimination_restore(b->elimination);
    b->force_current = b->saved_force_current;
    b->assembly.unknots = b->saved_unknots;
    sbi_precond_set_memory(b->precond, b->saved_precond);
    if (b->integrator == SB_CENTRAL_DIFFERENCE)
        sbi_assembly_restore_memory(&b->assembly);
    sbi_assembly_restore_rotations(&b->assembly);
    sbi_body_update_positions(b);
}

/* The value at the end of the step of what was `before` at its start and is `now` at the level of balance. */
static sb_vec3 sbi_step_extrapolate(sb_vec3 before, sb_vec3 now, sb_real level)
{
    return sb_v3_madd(before, 1 / level, sb_v3_sub(now, before));
}

/* Moves the displacement on to the end of the step, supports to their targets and slaves to where their masters have
 * them; `converged` keeps the shape of the balance. No line search has seen the new shape, so that it is tried where
 * the material forbids some (the next step finds its forces done). */
static sb_result sbi_step_finish_alpha(sbi_newton *newton)
{
    sb_body *b = newton->body;
    memcpy(b->converged, b->displacement, (size_t)b->domain.node_count * sizeof(sb_vec3));
    for (int i = 0; i < b->domain.node_count; i++)
        b->displacement[i] =
            sbi_body_pick_axes(b->fixed[i], b->target[i],
                               sbi_step_extrapolate(b->start[i], b->displacement[i], newton->level));
    if (b->elimination)
        sbi_elimination_follow(b->elimination, b->displacement, 1);
    b->force_current = 0;
    return sbi_newton_allows_inversion(b) ? SB_OK : sbi_newton_force(newton);
}

/* Velocity and acceleration at the new displacement; SB_ERROR_DIVERGED before anything overflows. */
static sb_result sbi_step_commit(sbi_newton *newton)
{
    sb_body *b = newton->body;
    int alpha = b->integrator == SB_GENERALISED_ALPHA;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 v = sbi_step_velocity(newton, i), a = sbi_step_acceleration(newton, i);
        if (alpha) {
            v = sbi_step_extrapolate(b->velocity[i], v, newton->level);
            a = sbi_step_extrapolate(b->acceleration[i], a, newton->inertia_level);
        }
        if (!sb_v3_is_finite(v) || !sb_v3_is_finite(a))
            return sbi_fail_node(&newton->info->error, SB_ERROR_DIVERGED, i, "the velocity of node %d is not finite",
                                 i);
        b->velocity[i] = v;
        b->acceleration[i] = a;
    }
    if (alpha) {
        sb_result result = sbi_step_finish_alpha(newton);
        if (result != SB_OK)
            return result;
    }
    sbi_body_update_positions(b);
    b->acceleration_known = 1;
    return SB_OK;
}

static void sbi_step_begin_info(sb_step_info *info)
{
    memset(info, 0, sizeof *info);
    info->error.element = -1;
    info->error.node = -1;
}

/* Whether knotted cells get one rotation; forces that were made under the other rule are made anew. */
static void sbi_step_watch_knots(sb_body *b, int unknots)
{
    if (b->assembly.unknots != unknots)
        b->force_current = 0;
    b->assembly.unknots = unknots;
}

static void sbi_step_forget_error(sb_step_info *info)
{
    memset(&info->error, 0, sizeof info->error);
    info->error.element = info->error.node = -1;
}

/* Sees to it that a failing call says why, whatever failed. */
static sb_result sbi_step_report(sb_step_info *info, sb_result result)
{
    if (result != SB_OK && info->error.result != result) {
        if (result == SB_ERROR_NOT_CONVERGED)
            sbi_fail(&info->error, result, "the residual is %g after %d linear solves", (double)info->residual,
                     info->newton_iterations);
        else
            sbi_fail(&info->error, result, "the linear solve failed (%s)", sb_result_string(result));
    }
    return result;
}

/* Materials with Prony terms respond as over a step of dt from now on. */
static void sbi_step_enter(sb_body *b, sb_real dt)
{
    if (sbi_assembly_begin_step(&b->assembly, dt))
        b->force_current = 0;
}

/* The step of dt is done: their memory moves on. */
static void sbi_step_leave(sb_body *b, sb_real dt)
{
    if (sbi_assembly_end_step(&b->assembly, b->displacement, dt))
        b->force_current = 0;
}

static sb_result sbi_step_run(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_result result = SB_OK;
    sbi_step_loads(b);
    if (!newton->linearised && b->damping_stiffness > 0)
        result = sbi_newton_keep_damping(newton);
    if (result == SB_OK && b->integrator != SB_EULER && !b->acceleration_known)
        result = sbi_step_initial_acceleration(newton);
    if (result != SB_OK)
        return result;
    if (b->integrator == SB_GENERALISED_ALPHA)
        sbi_step_scheme_alpha(newton);
    else
        sbi_step_scheme(newton);
    sbi_step_enter(b, newton->level * newton->dt);
    newton->info->newton_iterations = newton->info->pcg_iterations = 0;
    result = sbi_newton_run(newton);
    if (result == SB_ERROR_NOT_CONVERGED && !newton->moves_supports) { /* each iteration lowered the potential */
        newton->info->capped = 1;
        result = SB_OK;
    }
    if (result != SB_OK)
        return result;
    sbi_newton_reactions(newton);
    return sbi_step_commit(newton);
}

/* Substeps of central differences; what goes bad is done again with more caution, which stays for a while. */
static sb_result sbi_step_run_explicit(sb_body *body, sb_real dt, sb_step_info *info)
{
    sbi_step_guard guard = body->guard;
    for (int caution = guard.caution;; caution++) {
        sb_result result;
        sbi_step_loads(body);
        result = sbi_explicit_run(body, dt, caution, info);
        if (result == SB_OK) {
            sbi_explicit_calm(body, caution);
            return result;
        }
        sbi_step_undo(body);
        sbi_step_watch_knots(body, 0);
        body->guard = guard;
        if (caution == SBI_EXPLICIT_CAUTION || (result != SB_ERROR_INVERTED && result != SB_ERROR_DIVERGED))
            return result;
    }
}

/* An implicit step. Generalised alpha extrapolates: if the material does not admit the end, it tries once more with the
 * balance at the end, where the line search watches. */
static sb_result sbi_step_run_implicit(const sbi_newton *start)
{
    sbi_newton newton = *start;
    sb_result result = sbi_step_run(&newton);
    if (result != SB_ERROR_INVERTED || newton.body->integrator != SB_GENERALISED_ALPHA || !(newton.level < 1))
        return result;
    sbi_step_undo(newton.body);
    sbi_step_watch_knots(newton.body, start->linearised);
    newton = *start;
    newton.radius = 0;
    return sbi_step_run(&newton);
}

SB_API sb_result sb_body_step(sb_body *body, sb_real dt, sb_step_info *info)
{
    sb_step_info own;
    sbi_newton newton;
    sb_result result;
    double begin;
    int is_explicit;
    info = info ? info : &own;
    sbi_step_begin_info(info);
    if (!body || !(dt > 0) || !sb_is_finite(dt))
        return sbi_fail(&info->error, SB_ERROR_ARGUMENT, "a step needs a body and dt > 0, not %g", (double)dt);
    begin = sbi_step_now(body);
    memset(&newton, 0, sizeof newton);
    newton.body = body;
    newton.info = info;
    newton.dynamic = 1;
    newton.dt = dt;
    newton.load_factor = newton.loads_factor = newton.level = newton.inertia_level = 1;
    newton.radius = body->spectral_radius;
    newton.max_newton = sbi_body_max_newton(body);
    is_explicit = body->integrator == SB_CENTRAL_DIFFERENCE;
    newton.linearised = newton.max_newton == 1 && !is_explicit;
    newton.max_iterations = body->max_iterations;
    newton.tolerance = sb_max(body->newton_tolerance, 64 * SB_EPSILON);
    newton.linear_tolerance = newton.linearised ? body->tolerance : 0;
    newton.line_search = !(newton.linearised && sbi_newton_is_tame(body));
    sbi_step_save(body);
    sbi_step_watch_knots(body, newton.linearised);
    result = is_explicit ? sbi_step_run_explicit(body, dt, info) : sbi_step_run_implicit(&newton);
    if (result != SB_OK) {
        sbi_step_undo(body);
    } else {
        const sb_vec3 *balance = body->integrator == SB_GENERALISED_ALPHA ? body->converged : body->displacement;
        if (!is_explicit)
            sbi_step_leave(body, dt);
        sbi_loads_commit(body, balance, newton.linearised ? body->start : balance, 1);
        sbi_step_forget_error(info); /* of a tangent that was projected after all */
        info->load_steps = 1;
    }
    info->load_factor = result == SB_OK ? (sb_real)1 : (sb_real)0;
    info->seconds_total = sbi_step_now(body) - begin;
    sbi_body_tell(body, SBI_COMMAND_STEP, (int)result, 0, NULL, 0, &dt, 1);
    return sbi_step_report(info, result);
}

/* ---- static solves ---- */

#define SBI_STATIC_COOKIE 0x57a71cu
enum { SBI_STATIC_NEWTON = 30 };

SB_API sb_static_options sb_default_static_options(void)
{
    sb_static_options options;
    memset(&options, 0, sizeof options);
    options.load_steps = 1;
    options.tolerance = (sb_real)1e-6;
    options.max_newton = SBI_STATIC_NEWTON;
    options.max_iterations = 20000;
    options.cookie = SBI_STATIC_COOKIE;
    return options;
}

static sb_result sbi_static_check(sb_body *body, const sb_static_options *options, sb_error *error)
{
    int node;
    if (!body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a static solve needs a body");
    if (options->cookie != SBI_STATIC_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the options were not made by sb_default_static_options");
    if (options->load_steps < 1 || options->max_newton < 1 || options->max_iterations < 1 ||
        !(options->tolerance > 0) || !(options->tolerance < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "load_steps, max_newton, max_iterations must be >= 1 and tolerance in (0, 1)");
    node = sbi_body_unsupported_node(body);
    if (node >= 0)
        return sbi_fail_node(error, SB_ERROR_UNCONSTRAINED, node,
                             "the part of the mesh with node %d can move freely: support it", node);
    return SB_OK;
}

/* external = equilibrated + factor (present loads - equilibrated); gravity pulls at int rho N dV. */
static void sbi_static_loads(sb_body *b, sb_real factor)
{
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 full = sb_v3_madd(b->dead_load[i], b->load_mass[i], b->gravity);
        b->external[i] = sb_v3_madd(b->equilibrated[i], factor, sb_v3_sub(full, b->equilibrated[i]));
    }
}

/* Raises the load factor to 1. An increment that fails goes back to the last converged one and is halved. */
static sb_result sbi_static_run(sbi_newton *newton, const sb_static_options *options)
{
    sb_body *b = newton->body;
    size_t bytes = (size_t)b->domain.node_count * sizeof(sb_vec3);
    sb_real reached = 0, stride = (sb_real)1 / (sb_real)options->load_steps, least = stride / 64;
    memcpy(b->converged, b->displacement, bytes);
    sbi_loads_begin_static(b);
    while (reached < 1) {
        int before = newton->info->newton_iterations, spent;
        sb_result result;
        newton->load_factor = sb_min((sb_real)1, reached + stride);
        if (newton->load_factor > 1 - (sb_real)1e-3 * stride)
            newton->load_factor = 1;
        newton->loads_factor = newton->load_factor;
        newton->norm = newton->last_norm = 0;
        newton->energy_known = newton->cautious = 0;
        newton->quasi = options->quasi_newton != 0;
        sbi_static_loads(b, newton->load_factor);
        result = sbi_newton_run(newton);
        spent = newton->info->newton_iterations - before;
        if (result != SB_OK) {
            memcpy(b->displacement, b->converged, bytes);
            b->force_current = 0;
            stride *= (sb_real)0.5;
            if (stride < least)
                return result;
            continue;
        }
        memcpy(b->converged, b->displacement, bytes);
        reached = newton->load_factor;
        newton->info->load_factor = reached;
        newton->info->load_steps++;
        if (spent <= 5)
            stride *= (sb_real)1.5;
        if (options->progress)
            options->progress(options->progress_user, newton->info);
    }
    return SB_OK;
}

/* Takes the last converged increment as the body's state: at rest, with exact reactions. */
static void sbi_static_commit(sbi_newton *newton)
{
    sb_body *b = newton->body;
    const sb_vec3 zero = sb_v3(0, 0, 0);
    size_t bytes = (size_t)b->domain.node_count * sizeof(sb_vec3);
    memset(b->velocity, 0, bytes);
    memset(b->acceleration, 0, bytes);
    sbi_body_update_positions(b);
    sbi_static_loads(b, newton->info->load_factor);
    memcpy(b->equilibrated, b->external, bytes);
    sbi_loads_commit(b, b->displacement, b->displacement, newton->info->load_factor);
    sbi_loads_end_static(b, newton->info->load_factor);
    if (sbi_newton_force(newton) == SB_OK && b->elimination) {
        for (int i = 0; i < b->domain.node_count; i++)
            b->work[i] = sb_v3_sub(b->internal[i], b->external[i]);
        sbi_constraint_reactions(b, b->work);
    } else if (b->force_current)
        for (int i = 0; i < b->domain.node_count; i++)
            b->reaction[i] = sbi_body_pick_axes(b->node_component[i] < 0 ? 0 : b->fixed[i],
                                           sb_v3_sub(b->internal[i], b->external[i]), zero);
    b->acceleration_known = 0;
}

static void sbi_static_tell(sb_body *body, const sb_static_options *options, sb_result result)
{
    const int ints[5] = {options->load_steps, options->max_newton, options->max_iterations, options->keep_progress,
                         (options->instantaneous != 0) + 2 * (options->quasi_newton != 0)};
    sbi_body_tell(body, SBI_COMMAND_STATIC, (int)result, 0, ints, 5, &options->tolerance, 1);
}

SB_API sb_result sb_body_solve_static(sb_body *body, const sb_static_options *options, sb_step_info *info)
{
    sb_static_options defaults = sb_default_static_options();
    sb_step_info own;
    sbi_newton newton;
    sb_result result;
    sb_real duration;
    double begin;
    info = info ? info : &own;
    options = options ? options : &defaults;
    sbi_step_begin_info(info);
    result = sbi_static_check(body, options, &info->error);
    if (result != SB_OK)
        return result;
    begin = sbi_step_now(body);
    duration = options->instantaneous ? 0 : (sb_real)INFINITY;
    memset(&newton, 0, sizeof newton);
    newton.body = body;
    newton.info = info;
    newton.tolerance = sb_max(options->tolerance, 64 * SB_EPSILON);
    newton.max_newton = sbi_max_int(options->max_newton, 2);
    newton.max_iterations = options->max_iterations;
    newton.line_search = 1;
    sbi_step_save(body);
    sbi_step_watch_knots(body, 0);
    sbi_step_enter(body, duration);
    result = sbi_static_run(&newton, options);
    if (result == SB_OK || (options->keep_progress && info->load_steps > 0)) {
        sb_error error = info->error;
        sbi_static_commit(&newton);
        sbi_step_leave(body, duration);
        info->error = error;
    } else {
        sbi_step_undo(body);
    }
    if (result == SB_OK)
        sbi_step_forget_error(info); /* of attempts with longer increments */
    info->seconds_total = sbi_step_now(body) - begin;
    sbi_static_tell(body, options, result);
    return sbi_step_report(info, result);
}
