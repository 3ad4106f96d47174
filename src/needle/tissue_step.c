/* tissue_step: one linear system for the accelerations at the end of the step. */
#include "tissue_private.h"

#include <string.h>

static double ndli_solid_now(const ndl_tissue *t) { return t->clock ? t->clock() : 0.0; }

/* ---- the step's terms ---- */

/* With gamma 1/2 a node that a needle leads keeps an acceleration that turns over in each step, and needles would shake
 * for ever. With 0.6 a fifth of it is gone after a step; motion at the angular frequency w loses a share of
 * 0.05 (w dt)^2. */
static void ndli_solid_set_scheme(ndl_tissue *t, sb_real dt)
{
    ndli_solid_scheme *s = &t->scheme;
    sb_real mass = s->mass, stiffness = s->stiffness;
    int newmark = t->integrator == NDL_NEWMARK && !t->calm;
    sb_real gamma = t->led ? (sb_real)0.6 : (sb_real)0.5, root = (sb_real)0.5 * ((sb_real)0.5 + gamma);
    s->dt = dt;
    s->beta = newmark ? root * root : (sb_real)1;
    s->c0 = newmark ? (sb_real)0.5 - s->beta : (sb_real)0;
    s->gamma = newmark ? gamma : (sb_real)1;
    s->mass = 1 + s->gamma * dt * t->damping_mass;
    s->stiffness = s->beta * dt * dt + s->gamma * dt * t->damping_stiffness;
    if (s->mass != mass || s->stiffness != stiffness)
        t->inverse_valid = 0;
}

/* Velocity without the part that the unknown acceleration brings. */
static sb_vec3 ndli_solid_coast(const ndl_tissue *t, int i)
{
    return sb_v3_madd(t->mesh.v[i], t->scheme.dt * (1 - t->scheme.gamma), t->before[i]);
}

/* Velocity of a held node at the end of the step. */
static sb_vec3 ndli_solid_held_velocity(const ndl_tissue *t, int i)
{
    if (t->has_velocity[i])
        return t->target_velocity[i];
    return sb_v3_scale(1 / t->scheme.dt, sb_v3_sub(t->target[i], t->mesh.x[i]));
}

/* Elastic force, weight and load. */
static sb_vec3 ndli_solid_load(const ndl_tissue *t, int i)
{
    return sb_v3_madd(sb_v3_add(t->internal[i], t->force[i]), t->mesh.mass[i], t->gravity);
}

/* way = what K acts on at the end of the step, displacement and beta_s times velocity, but for the unknown's part. */
static void ndli_solid_set_way(ndl_tissue *t)
{
    const ndli_solid_scheme *s = &t->scheme;
    for (int i = 0; i < t->mesh.node_end; i++) {
        sb_vec3 way = sb_v3(0, 0, 0);
        if (t->role[i] == NDLI_ROW_HELD) {
            way = sb_v3_sub(t->target[i], t->mesh.x[i]);
            way = sb_v3_madd(way, t->damping_stiffness, ndli_solid_held_velocity(t, i));
        } else if (t->role[i] != NDLI_ROW_ABSENT) {
            way = sb_v3_madd(sb_v3_scale(s->dt, t->mesh.v[i]), s->dt * s->dt * s->c0, t->before[i]);
            way = sb_v3_madd(way, t->damping_stiffness, ndli_solid_coast(t, i));
        }
        t->way[i] = way;
    }
}

static void ndli_solid_set_rhs(ndl_tissue *t)
{
    ndli_solid_set_way(t);
    ndli_solid_multiply(t, 0, 1, t->way, t->product);
    for (int i = 0; i < t->mesh.node_end; i++) {
        sb_vec3 b;
        t->rhs[i] = sb_v3(0, 0, 0);
        if (t->role[i] == NDLI_ROW_HELD || t->role[i] == NDLI_ROW_ABSENT)
            continue;
        b = sb_v3_sub(ndli_solid_load(t, i), t->product[i]);
        t->rhs[i] = sb_v3_madd(b, -t->damping_mass * t->mesh.mass[i], ndli_solid_coast(t, i));
    }
}

/* before = accelerations, those of M a = f - C v where there are none yet. */
static void ndli_solid_set_before(ndl_tissue *t)
{
    int n = t->mesh.node_end;
    if (t->acceleration_known || t->integrator == NDL_EULER) {
        memcpy(t->before, t->mesh.a, (size_t)n * sizeof(sb_vec3));
        return;
    }
    for (int i = 0; i < n; i++)
        t->way[i] = t->role[i] == NDLI_ROW_ABSENT ? sb_v3(0, 0, 0) : t->mesh.v[i];
    ndli_solid_multiply(t, t->damping_mass, t->damping_stiffness, t->way, t->product);
    for (int i = 0; i < n; i++) {
        t->before[i] = sb_v3(0, 0, 0);
        if (t->role[i] != NDLI_ROW_HELD && t->role[i] != NDLI_ROW_ABSENT)
            t->before[i] = sb_v3_scale(1 / t->mesh.mass[i], sb_v3_sub(ndli_solid_load(t, i), t->product[i]));
    }
}

/* Forces and K at the present positions, unless they are there: a step that failed leaves them for the next. */
static void ndli_solid_evaluate(ndl_tissue *t, ndl_tissue_info *info)
{
    size_t bytes = (size_t)t->mesh.node_end * sizeof(sb_vec3);
    double begin = ndli_solid_now(t), middle;
    if (!t->changed && t->seen_end == t->mesh.node_end && memcmp(t->seen_x, t->mesh.x, bytes) == 0)
        return;
    ndli_solid_forces(t);
    middle = ndli_solid_now(t);
    info->seconds_force = middle - begin;
    info->refreshed = ndli_solid_stiffness(t);
    memcpy(t->seen_x, t->mesh.x, bytes);
    t->seen_end = t->mesh.node_end;
    t->changed = 0;
}

/* ---- the ledger ---- */

static double ndli_solid_kinetic(const ndl_tissue *t)
{
    double sum = 0;
    for (int i = 0; i < t->mesh.node_end; i++)
        if (t->role[i] != NDLI_ROW_ABSENT)
            sum += 0.5 * (double)t->mesh.mass[i] * (double)sb_v3_dot(t->mesh.v[i], t->mesh.v[i]);
    return sum;
}

static double ndli_solid_whereabouts(const ndl_tissue *t)
{
    double sum = 0;
    for (int i = 0; i < t->mesh.node_end; i++)
        if (t->role[i] != NDLI_ROW_ABSENT)
            sum += (double)t->mesh.x[i].x + (double)t->mesh.x[i].y + (double)t->mesh.x[i].z + (double)t->mesh.v[i].x +
                   (double)t->mesh.v[i].y + (double)t->mesh.v[i].z;
    return sum;
}

/* 1 when there is a tenth more energy than came in. The ledger follows what is lost, a twentieth of it per step (the
 * energy of a sound Newmark step goes up and down a little), and slowly what changes of the mesh bring. Where others
 * have set the state it is opened anew. */
static int ndli_solid_has_gained(ndl_tissue *t, int changed)
{
    double energy = t->elastic + ndli_solid_kinetic(t), allowed = t->ledger + t->work;
    double noise = 64 * (double)SB_EPSILON * t->work_unit;
    int gained;
    if (!t->ledger_open || (!changed && ndli_solid_whereabouts(t) != t->left_at))
        allowed = energy;
    gained = energy > 1.1 * allowed + noise;
    t->next_ledger = allowed + (gained ? 0.01 : energy < allowed ? 0.05 : 0) * (energy - allowed);
    return gained;
}

NDLI_API sb_result ndli_solid_begin(ndl_tissue *t, sb_real dt, ndl_tissue_info *info, sb_error *error)
{
    double begin;
    int changed = t->changed;
    if (t->broken && !ndli_solid_rebuild(t))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the matrix of the changed tissue");
    begin = ndli_solid_now(t);
    ndli_solid_evaluate(t, info);
    t->calm = t->watched && ndli_solid_has_gained(t, changed);
    info->calmed = t->calm;
    ndli_solid_set_scheme(t, dt);
    ndli_solid_set_before(t);
    ndli_solid_set_rhs(t);
    info->coarse_refreshed = ndli_solid_precond_update(t);
    info->seconds_matrix = ndli_solid_now(t) - begin - info->seconds_force;
    return SB_OK;
}

NDLI_API sb_mat3 ndli_solid_node_block(const ndl_tissue *t, int node)
{
    sb_mat3 a;
    for (int c = 0; c < 9; c++)
        a.m[c / 3][c % 3] = t->scheme.stiffness * t->diagonal[node][c];
    for (int c = 0; c < 3; c++)
        a.m[c][c] += t->scheme.mass * t->mesh.mass[node];
    return a;
}

NDLI_API int ndli_solid_edge_block(const ndl_tissue *t, int i, int j, sb_mat3 *block)
{
    int place = ndli_solid_find(t, i, j);
    *block = sb_m3_zero();
    for (int c = 0; place >= 0 && c < 9; c++)
        block->m[c / 3][c % 3] = t->scheme.stiffness * t->blocks[place][c];
    return place >= 0;
}

/* ---- conjugate gradients ---- */

static int ndli_solid_end(const ndl_tissue *t, int chunk)
{
    return sbi_min_int(t->mesh.node_end, (chunk + 1) * NDLI_SOLID_CHUNK);
}

/* p = z + factor p */
static void ndli_solid_direction_task(void *user, int chunk)
{
    const ndli_solid_cg *cg = (const ndli_solid_cg *)user;
    ndl_tissue *t = cg->t;
    for (int i = chunk * NDLI_SOLID_CHUNK; i < ndli_solid_end(t, chunk); i++)
        t->search[i] = sb_v3_madd(t->correction[i], cg->factor, t->search[i]);
}

/* q = A p, p.q; p is 0 on rows without an unknown. */
static void ndli_solid_cg_product_task(void *user, int chunk)
{
    ndl_tissue *t = ((const ndli_solid_cg *)user)->t;
    int first = chunk * NDLI_SOLID_CHUNK, last = ndli_solid_end(t, chunk);
    double sum = 0;
    ndli_solid_multiply_rows(t, t->scheme.mass, t->scheme.stiffness, t->search, t->product, first, last);
    for (int i = first; i < last; i++)
        sum += (double)t->search[i].x * (double)t->product[i].x + (double)t->search[i].y * (double)t->product[i].y +
               (double)t->search[i].z * (double)t->product[i].z;
    t->partial[2 * chunk] = sum;
}

/* a += factor p, r -= factor q; r stays as it is where there is no unknown: nothing reads it. */
static void ndli_solid_advance_task(void *user, int chunk)
{
    const ndli_solid_cg *cg = (const ndli_solid_cg *)user;
    ndl_tissue *t = cg->t;
    for (int i = chunk * NDLI_SOLID_CHUNK; i < ndli_solid_end(t, chunk); i++) {
        t->unknown[i] = sb_v3_madd(t->unknown[i], cg->factor, t->search[i]);
        t->residual[i] = sb_v3_madd(t->residual[i], -cg->factor, t->product[i]);
    }
}

/* q = A p; returns p.q. */
static double ndli_solid_curvature(ndli_solid_cg *cg)
{
    int chunks = ndli_solid_chunks(cg->t->mesh.node_end);
    double sum = 0;
    sbi_run(&cg->t->jobs, ndli_solid_cg_product_task, cg, chunks);
    for (int k = 0; k < chunks; k++)
        sum += cg->t->partial[2 * k];
    return cg->guest ? sum + cg->guest->multiply(cg->guest->user) : sum;
}

static void ndli_solid_direct(ndli_solid_cg *cg, sb_real factor)
{
    cg->factor = factor;
    sbi_run(&cg->t->jobs, ndli_solid_direction_task, cg, ndli_solid_chunks(cg->t->mesh.node_end));
    if (cg->guest)
        cg->guest->direct(cg->guest->user, factor);
}

static void ndli_solid_advance(ndli_solid_cg *cg, sb_real factor)
{
    cg->factor = factor;
    sbi_run(&cg->t->jobs, ndli_solid_advance_task, cg, ndli_solid_chunks(cg->t->mesh.node_end));
    if (cg->guest)
        cg->guest->advance(cg->guest->user, factor);
}

static void ndli_solid_correct(ndli_solid_cg *cg)
{
    cg->rz = ndli_solid_precondition(cg->t, cg->t->residual, cg->t->correction);
    if (cg->guest)
        cg->rz += cg->guest->precondition(cg->guest->user);
}

static int ndli_solid_is_finite(double x) { return x - x == 0; }

/* Names a node whose equation is not finite, if one is. */
static sb_result ndli_solid_lost(const ndl_tissue *t, sb_error *error)
{
    for (int i = 0; i < t->mesh.node_end; i++)
        if (!sb_v3_is_finite(t->rhs[i]))
            return sbi_fail_node(error, SB_ERROR_DIVERGED, i, "the force on node %d is not finite", i);
    return sbi_fail(error, SB_ERROR_DIVERGED, "the accelerations are too large for the matrix");
}

NDLI_API void ndli_solid_cg_residual(ndli_solid_cg *cg)
{
    ndl_tissue *t = cg->t;
    size_t bytes = (size_t)t->mesh.node_end * sizeof(sb_vec3);
    memcpy(t->residual, t->rhs, bytes);
    if (cg->guest)
        cg->guest->begin(cg->guest->user);
    memcpy(t->search, t->unknown, bytes);
    ndli_solid_curvature(cg);
    for (int i = 0; i < t->mesh.node_end; i++)
        t->residual[i] = sb_v3_sub(t->residual[i], t->product[i]);
    if (cg->guest)
        cg->guest->settle(cg->guest->user);
}

NDLI_API void ndli_solid_cg_begin(ndli_solid_cg *cg)
{
    ndli_solid_cg_residual(cg);
    ndli_solid_correct(cg);
}

NDLI_API sb_result ndli_solid_cg_run(ndli_solid_cg *cg, double target, sb_error *error)
{
    ndl_tissue *t = cg->t;
    sb_real factor = 0;
    while (cg->rz > target && ndli_solid_is_finite(cg->rz) && cg->iterations < t->max_iterations) {
        double curvature, last = cg->rz;
        ndli_solid_direct(cg, factor);
        curvature = ndli_solid_curvature(cg);
        if (!(curvature > 0) || !ndli_solid_is_finite(curvature))
            return ndli_solid_lost(t, error);
        ndli_solid_advance(cg, (sb_real)(cg->rz / curvature));
        ndli_solid_correct(cg);
        factor = (sb_real)(cg->rz / last);
        cg->iterations++;
    }
    return ndli_solid_is_finite(cg->rz) ? SB_OK : ndli_solid_lost(t, error);
}

NDLI_API sb_result ndli_solid_solve(ndl_tissue *t, ndl_tissue_info *info, sb_error *error)
{
    size_t bytes = (size_t)t->mesh.node_end * sizeof(sb_vec3);
    ndli_solid_cg cg = {t, NULL, 0, 0, 0};
    double first, target;
    sb_result result;
    memset(t->unknown, 0, bytes);
    memset(t->search, 0, bytes);
    memcpy(t->residual, t->rhs, bytes);
    ndli_solid_correct(&cg);
    first = cg.rz;
    target = (double)t->tolerance * (double)t->tolerance * first;
    result = ndli_solid_cg_run(&cg, target, error);
    info->iterations = cg.iterations;
    info->capped = cg.iterations >= t->max_iterations && cg.rz > target;
    info->residual = first > 0 && cg.rz > 0 ? (sb_real)sqrt(cg.rz / first) : 0;
    return result;
}

/* ---- the end of the step ---- */

/* Where a node in use will be. */
static void ndli_solid_arrive(const ndl_tissue *t, int i, sb_vec3 *x, sb_vec3 *v, sb_vec3 *a)
{
    const ndli_solid_scheme *s = &t->scheme;
    if (t->role[i] == NDLI_ROW_HELD) {
        *x = t->target[i];
        *v = ndli_solid_held_velocity(t, i);
        *a = sb_v3_scale(1 / s->dt, sb_v3_sub(*v, t->mesh.v[i]));
        return;
    }
    *a = t->unknown[i];
    *v = sb_v3_madd(ndli_solid_coast(t, i), s->dt * s->gamma, *a);
    *x = sb_v3_madd(t->mesh.x[i], s->dt, t->mesh.v[i]);
    *x = sb_v3_madd(*x, s->dt * s->dt * s->c0, t->before[i]);
    *x = sb_v3_madd(*x, s->dt * s->dt * s->beta, *a);
}

/* Forces of the supports: the balance of their rows. */
static void ndli_solid_react(ndl_tissue *t)
{
    int n = t->mesh.node_end;
    for (int i = 0; i < n; i++)
        if (t->role[i] != NDLI_ROW_HELD && t->role[i] != NDLI_ROW_ABSENT)
            t->way[i] = sb_v3_madd(t->way[i], t->scheme.stiffness, t->unknown[i]);
    for (int i = 0; i < n; i++) {
        sb_vec3 x, v, a, inertia;
        t->reaction[i] = sb_v3(0, 0, 0);
        if (t->role[i] != NDLI_ROW_HELD)
            continue;
        ndli_solid_arrive(t, i, &x, &v, &a);
        ndli_solid_multiply_rows(t, 0, 1, t->way, t->product, i, i + 1);
        inertia = sb_v3_scale(t->mesh.mass[i], sb_v3_madd(a, t->damping_mass, v));
        t->reaction[i] = sb_v3_sub(sb_v3_add(inertia, t->product[i]), ndli_solid_load(t, i));
    }
}

/* Work of gravity, forces and supports on the way to the end of the step; where a support's force has changed, the
 * larger. Called with the reactions of the last step, and after with the present ones. */
static void ndli_solid_note_work(ndl_tissue *t, int after)
{
    double sum = 0, size = 0;
    for (int i = 0; i < t->mesh.node_end; i++) {
        sb_vec3 x, v, a, load;
        double support, dead;
        if (t->role[i] == NDLI_ROW_ABSENT)
            continue;
        ndli_solid_arrive(t, i, &x, &v, &a);
        x = sb_v3_sub(x, t->mesh.x[i]);
        load = sb_v3_madd(t->force[i], t->mesh.mass[i], t->gravity);
        support = t->role[i] == NDLI_ROW_HELD ? (double)sb_v3_dot(t->reaction[i], x) : 0;
        dead = (double)sb_v3_dot(load, x);
        sum += support + dead;
        size += fabs(support) + fabs(dead);
    }
    t->work = after && t->work > sum ? t->work : sum;
    t->work_unit = size + t->elastic;
}

NDLI_API sb_result ndli_solid_commit(ndl_tissue *t, sb_error *error)
{
    sb_vec3 x, v, a;
    for (int i = 0; i < t->mesh.node_end; i++) {
        if (t->role[i] == NDLI_ROW_ABSENT)
            continue;
        ndli_solid_arrive(t, i, &x, &v, &a);
        if (!sb_v3_is_finite(x) || !sb_v3_is_finite(v) || !sb_v3_is_finite(a))
            return sbi_fail_node(error, SB_ERROR_DIVERGED, i, "the motion of node %d is not finite", i);
    }
    ndli_solid_note_work(t, 0);
    ndli_solid_react(t);
    ndli_solid_note_work(t, 1);
    for (int i = 0; i < t->mesh.node_end; i++) {
        if (t->role[i] == NDLI_ROW_ABSENT)
            continue;
        ndli_solid_arrive(t, i, &x, &v, &a);
        t->mesh.x[i] = x;
        t->mesh.v[i] = v;
        t->mesh.a[i] = a;
        t->has_velocity[i] = 0;
    }
    t->acceleration_known = 1;
    t->ledger = t->next_ledger;
    t->ledger_open = t->watched;
    t->left_at = ndli_solid_whereabouts(t);
    return SB_OK;
}

NDLI_API void ndli_solid_wear(ndl_tissue *t, int iterations)
{
    if (t->coarse.age++ == 0)
        t->coarse.fresh_iterations = iterations;
    t->coarse.wasted += sbi_max_int(0, iterations - t->coarse.fresh_iterations);
}

NDL_API sb_result ndl_tissue_step(ndl_tissue *tissue, sb_real dt, ndl_tissue_info *info, sb_error *error)
{
    ndl_tissue_info own;
    sb_result result;
    double begin, middle;
    info = info ? info : &own;
    memset(info, 0, sizeof *info);
    if (!tissue || !(dt > 0) || !sb_is_finite(dt))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a step needs a tissue and dt > 0, not %g", (double)dt);
    begin = ndli_solid_now(tissue);
    tissue->watched = tissue->integrator == NDL_NEWMARK;
    result = ndli_solid_begin(tissue, dt, info, error);
    tissue->calm = tissue->calm && result == SB_OK;
    middle = ndli_solid_now(tissue);
    if (result == SB_OK)
        result = ndli_solid_solve(tissue, info, error);
    info->seconds_solve = ndli_solid_now(tissue) - middle;
    if (result == SB_OK)
        result = ndli_solid_commit(tissue, error);
    if (result == SB_OK)
        ndli_solid_wear(tissue, info->iterations);
    tissue->watched = tissue->calm = 0;
    info->seconds_total = ndli_solid_now(tissue) - begin;
    return result;
}
