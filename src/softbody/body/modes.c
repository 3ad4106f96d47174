/* modes: block Davidson on A x = mu M x, A = K + shift M, mu = lambda + shift.
 *
 * The basis V is orthonormal in M; H = V^T A V is kept in double. Vectors are 0 on supported axes, where A has rows of
 * its own. All solves are rough: they only have to point the right way, since Ritz values and residuals are made from
 * A and M themselves. Random vectors at the start, as many as modes are wanted, and a second handful before the end
 * see to it that no copy of a multiple frequency is missed.
 *
 * Free rigid bodies have their six unknowns behind the nodes, and of nodes that hang on them nothing is left.
 *
 * With constraints u = T u' all of this is about u' and T^T A T, T^T M T: slaves are 0 in the vectors, but in the
 * shapes that are handed out. */
#include "modes.h"

#include <math.h>
#include <string.h>

#include "../base/eigen.h"
#include "body_private.h"
#include "constraint.h"
#include "load.h"
#include "rigid_private.h"
#include "step_explicit.h"

#define SBI_MODES_COOKIE 0x3d0deu
enum {
    SBI_MODES_GUARD = 4,  /* Ritz vectors beyond the wanted ones that are improved along with them */
    SBI_MODES_BLOCK = 12, /* most vectors by which the space grows at a time */
    SBI_MODES_PROBES = 4  /* random vectors of the last look */
};

typedef struct sbi_modes {
    sb_body *body;
    const sb_modes_options *options;
    sb_modes_info *info;
    sb_error *error;
    sb_preconditioner *precond;
    sb_matrix *matrix; /* A: the body's matrix, or the one its elimination condenses */
    int nodes, count;
    int length; /* of a vector: nodes, and two more for each free rigid body (rigid_modes.c) */
    sbi_rigids_small rigids;
    int freedom;        /* degrees of freedom */
    int capacity, size; /* of the basis */
    int block;          /* residuals per round */
    double shift;       /* 1/s^2 */
    double rounding;    /* of a residual (1/s^2) */
    uint64_t random;
    sb_real *mass;        /* [block_count] (kg) of the full matrix */
    sb_vec3 *weight;      /* [nodes] (kg) diagonal of T^T (lumped mass) T, to measure residuals with; 0 on slaves */
    sb_vec3 *spread;      /* [nodes] a vector with its slaves */
    sb_vec3 *basis;       /* [capacity][nodes] */
    sb_vec3 *fresh;       /* [block][nodes] directions to grow by */
    sb_vec3 *x, *ax, *mx; /* [nodes] */
    double *projected;    /* [capacity][capacity] H */
    double *vectors;      /* [capacity][capacity] row i: eigenvector i of H */
    double *values;       /* [capacity] ascending */
    double *scratch;      /* [3 capacity] */
    void *memory;
} sbi_modes;

SB_API sb_modes_options sb_default_modes_options(void)
{
    sb_modes_options options;
    memset(&options, 0, sizeof options);
    options.mass = SB_MASS_CONSISTENT;
    options.tolerance = (sb_real)1e-8;
    options.max_iterations = 100;
    options.cookie = SBI_MODES_COOKIE;
    return options;
}

/* ---- vectors ---- */

static sb_vec3 *sbi_modes_basis(const sbi_modes *m, int i) { return m->basis + (size_t)i * (size_t)m->length; }

static double sbi_modes_dot(const sbi_modes *m, const sb_vec3 *a, const sb_vec3 *b)
{
    double sum = 0;
    for (int i = 0; i < m->length; i++)
        sum += (double)a[i].x * (double)b[i].x + (double)a[i].y * (double)b[i].y + (double)a[i].z * (double)b[i].z;
    return sum;
}

/* a += s b */
static void sbi_modes_add(const sbi_modes *m, sb_vec3 *a, double s, const sb_vec3 *b)
{
    for (int i = 0; i < m->length; i++)
        a[i] = sb_v3_madd(a[i], (sb_real)s, b[i]);
}

static void sbi_modes_mask(const sbi_modes *m, sb_vec3 *a)
{
    for (int i = 0; i < m->nodes; i++)
        a[i] = sbi_body_pick_axes(sbi_body_held(m->body, i), sb_v3(0, 0, 0), a[i]);
}

/* x with what hangs on rigid bodies, which may be m->spread. */
static const sb_vec3 *sbi_modes_spread(const sbi_modes *m, const sb_vec3 *x)
{
    if (m->rigids.count == 0)
        return x;
    memcpy(m->spread, x, (size_t)m->nodes * sizeof *x);
    sbi_rigids_spread(m->body, x, m->spread);
    return m->spread;
}

/* out = M x on free axes */
static void sbi_modes_mass_times(const sbi_modes *m, const sb_vec3 *own, sb_vec3 *out)
{
    const sb_matrix *matrix = &m->body->matrix;
    const sbi_elimination *e = m->body->elimination;
    const sb_vec3 *x = sbi_modes_spread(m, own);
    if (e) {
        if (x != m->spread)
            memcpy(m->spread, x, (size_t)m->nodes * sizeof *x);
        sbi_elimination_expand(e, m->spread, 0);
        x = m->spread;
    }
    for (int i = 0; i < m->nodes; i++) {
        sb_vec3 sum = sb_v3(0, 0, 0);
        for (int k = matrix->row_start[i]; k < matrix->row_end[i]; k++)
            sum = sb_v3_madd(sum, m->mass[k], x[matrix->columns[k]]);
        out[i] = sum;
    }
    if (e)
        sbi_elimination_reduce(e, out, out, NULL);
    sbi_modes_mask(m, out);
    if (m->rigids.count > 0) {
        sbi_rigids_gather(m->body, out);
        sbi_rigids_add_mass(m->body, own, 1, 0, out);
    }
}

static void sbi_modes_stiffness_times(const sbi_modes *m, const sb_vec3 *x, sb_vec3 *out)
{
    const sb_vec3 *all = sbi_modes_spread(m, x);
    sb_matrix_multiply(m->matrix, &all[0].x, &out[0].x, &m->body->jobs);
    if (m->rigids.count > 0) {
        sbi_rigids_gather(m->body, out);
        sbi_rigids_add_mass(m->body, x, m->shift, 1, out);
    }
}

/* Number in (-1, 1) (xorshift64*). */
static sb_real sbi_modes_random(sbi_modes *m)
{
    m->random ^= m->random >> 12;
    m->random ^= m->random << 25;
    m->random ^= m->random >> 27;
    return (sb_real)((double)((m->random * 2685821657736338717ULL) >> 12) / 2251799813685248.0 - 1);
}

/* Turns (rad) of rigid bodies like ways (m) of what they carry; nodes that hang have nothing of their own. */
static void sbi_modes_scale_turns(const sbi_modes *m, sb_vec3 *a)
{
    for (int i = 0; i < m->nodes; i++)
        if (sbi_body_hung_on(m->body, i))
            a[i] = sb_v3(0, 0, 0);
    for (int i = m->nodes; i < m->length; i += 2) {
        const sb_vec3 *mass = m->weight + i, *turn = m->weight + i + 1;
        a[i + 1].x *= sb_sqrt(mass->x / turn->x);
        a[i + 1].y *= sb_sqrt(mass->x / turn->y);
        a[i + 1].z *= sb_sqrt(mass->x / turn->z);
    }
}

static void sbi_modes_fill_random(sbi_modes *m, sb_vec3 *a)
{
    for (int i = 0; i < m->length; i++) {
        a[i].x = sbi_modes_random(m);
        a[i].y = sbi_modes_random(m);
        a[i].z = sbi_modes_random(m);
    }
    sbi_modes_mask(m, a);
    if (m->rigids.count > 0)
        sbi_modes_scale_turns(m, a);
}

/* out = A^-1 rhs, roughly; rhs is 0 on supported axes. */
static sb_result sbi_modes_solve(sbi_modes *m, const sb_vec3 *rhs, sb_vec3 *out, double tolerance)
{
    sb_body *b = m->body;
    sb_pcg_options options = sb_default_pcg_options();
    sb_pcg_info pcg = {0, 0, 0, 0, 0};
    sb_result result;
    options.tolerance = tolerance;
    options.max_iterations = 500;
    options.jobs = &b->jobs;
    memset(out, 0, (size_t)m->length * sizeof *out);
    if (m->rigids.count > 0) {
        sbi_rigids_take_load(b, rhs);
        result = sbi_pcg_solve_guests(m->matrix, m->precond, &rhs[0].x, &out[0].x, &m->rigids.guests, &options, &b->pcg,
                                      NULL, &pcg);
        sbi_rigids_give_way(b, out);
    } else {
        result = sb_pcg_solve(m->matrix, m->precond, &rhs[0].x, &out[0].x, &options, &b->pcg, &pcg);
    }
    m->info->solves++;
    m->info->pcg_iterations += pcg.iterations;
    if (result == SB_ERROR_INDEFINITE && pcg.negative_curvature)
        return sbi_fail(m->error, result, "the stiffness is not positive definite: the shape is not stable");
    if (result == SB_ERROR_DIVERGED)
        return sbi_fail(m->error, result, "a linear solve met numbers that are not finite");
    sbi_modes_mask(m, out);
    return SB_OK;
}

/* ---- the space ---- */

/* Makes t orthonormal to the basis in M (Gram-Schmidt, twice), puts it in and extends H. A t that adds nothing but
 * rounding is left out. */
static void sbi_modes_append(sbi_modes *m, sb_vec3 *t)
{
    double *h = m->projected, before, norm;
    sb_vec3 *place;
    if (m->size == m->capacity)
        return;
    sbi_modes_mass_times(m, t, m->mx);
    before = norm = sbi_modes_dot(m, t, m->mx);
    for (int pass = 0; pass < 2; pass++) {
        for (int j = 0; j < m->size; j++)
            m->scratch[j] = sbi_modes_dot(m, sbi_modes_basis(m, j), m->mx);
        for (int j = 0; j < m->size; j++)
            sbi_modes_add(m, t, -m->scratch[j], sbi_modes_basis(m, j));
        sbi_modes_mass_times(m, t, m->mx);
        norm = sbi_modes_dot(m, t, m->mx);
        if (!(norm > 1e4 * (double)SB_EPSILON * (double)SB_EPSILON * before))
            return;
        norm = 1 / sqrt(norm);
        for (int i = 0; i < m->length; i++) {
            t[i] = sb_v3_scale((sb_real)norm, t[i]);
            m->mx[i] = sb_v3_scale((sb_real)norm, m->mx[i]);
        }
        before = 1;
    }
    place = sbi_modes_basis(m, m->size);
    memcpy(place, t, (size_t)m->length * sizeof *t);
    sbi_modes_stiffness_times(m, place, m->ax);
    for (int j = 0; j <= m->size; j++)
        h[(size_t)m->size * (size_t)m->capacity + (size_t)j] = h[(size_t)j * (size_t)m->capacity + (size_t)m->size] =
            sbi_modes_dot(m, sbi_modes_basis(m, j), m->ax);
    m->size++;
}

/* Adds `count` random vectors with their fast motions taken out; first what the basis has already, lest nearly rigid
 * motions drown the rest. In the smallest of problems nothing else is left: then the random vector itself. */
static sb_result sbi_modes_append_random(sbi_modes *m, int count)
{
    sb_result result = SB_OK;
    for (int k = 0; k < count && result == SB_OK; k++) {
        int before = m->size;
        sbi_modes_fill_random(m, m->x);
        sbi_modes_mass_times(m, m->x, m->ax);
        for (int j = 0; j < m->size; j++)
            m->scratch[j] = sbi_modes_dot(m, sbi_modes_basis(m, j), m->ax);
        for (int j = 0; j < m->size; j++)
            sbi_modes_add(m, m->x, -m->scratch[j], sbi_modes_basis(m, j));
        sbi_modes_mass_times(m, m->x, m->ax);
        result = sbi_modes_solve(m, m->ax, m->fresh, 0.1);
        if (result == SB_OK)
            sbi_modes_append(m, m->fresh);
        if (result == SB_OK && m->size == before)
            sbi_modes_append(m, m->x);
    }
    return result;
}

/* The rigid motions of all parts together, which supports may leave: six good vectors to begin with. */
static void sbi_modes_append_rigid(sbi_modes *m)
{
    for (int k = 0; k < 6; k++) {
        for (int i = 0; i < m->nodes; i++) {
            sb_vec3 x = sb_v3_sub(m->body->reference[i], m->body->reference[0]);
            if (m->options->at_present)
                x = sb_v3_sub(m->body->position[i], m->body->position[0]);
            sb_vec3 axis = sb_v3(k % 3 == 0, k % 3 == 1, k % 3 == 2);
            m->x[i] = k < 3 ? axis : sb_v3_cross(axis, x);
        }
        sbi_modes_mask(m, m->x);
        if (m->rigids.count > 0) {
            const sb_vec3 *places = m->options->at_present ? m->body->position : m->body->reference;
            sb_vec3 axis = sb_v3(k % 3 == 0, k % 3 == 1, k % 3 == 2), none = sb_v3(0, 0, 0);
            sbi_rigids_fill_motion(m->body, m->options->at_present, k < 3 ? axis : none, k < 3 ? none : axis, places[0],
                                   m->x);
        }
        sbi_modes_append(m, m->x);
    }
}

/* Ritz values and vectors of the basis. */
static sb_result sbi_modes_project(sbi_modes *m)
{
    int n = m->size;
    double *a = m->vectors + (size_t)m->capacity * (size_t)m->capacity;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            a[i * n + j] = m->projected[(size_t)i * (size_t)m->capacity + (size_t)j];
    if (!sbi_symmetric_eigen(a, n, m->values, m->vectors, m->scratch))
        return sbi_fail(m->error, SB_ERROR_DIVERGED, "the projected stiffness is not finite");
    return SB_OK;
}

/* x = Ritz vector i */
static void sbi_modes_ritz(sbi_modes *m, int i, sb_vec3 *x)
{
    memset(x, 0, (size_t)m->length * sizeof *x);
    for (int j = 0; j < m->size; j++)
        sbi_modes_add(m, x, m->vectors[(size_t)i * (size_t)m->size + (size_t)j], sbi_modes_basis(m, j));
}

/* value^2 / weight, 0 where there is no weight. */
static double sbi_modes_square(sb_real value, sb_real weight)
{
    return weight > 0 ? (double)value * (double)value / (double)weight : 0;
}

/* ax = A x - mu M x of Ritz vector i; returns its norm in (lumped M)^-1 over lambda, 0 when it is rounding. */
static double sbi_modes_residual(sbi_modes *m, int i)
{
    double square = 0, lambda = m->values[i] - m->shift, norm;
    sbi_modes_ritz(m, i, m->x);
    sbi_modes_stiffness_times(m, m->x, m->ax);
    sbi_modes_mass_times(m, m->x, m->mx);
    sbi_modes_add(m, m->ax, -m->values[i], m->mx);
    sbi_modes_mask(m, m->ax);
    for (int k = 0; k < m->length; k++)
        square += sbi_modes_square(m->ax[k].x, m->weight[k].x) + sbi_modes_square(m->ax[k].y, m->weight[k].y) +
                  sbi_modes_square(m->ax[k].z, m->weight[k].z);
    norm = sqrt(square);
    if (norm <= m->rounding)
        return 0;
    return norm / (lambda > m->shift ? lambda : m->shift > 0 ? m->shift : fabs(lambda));
}

/* Keeps the lowest Ritz vectors as the basis. */
static void sbi_modes_restart(sbi_modes *m, int keep)
{
    sb_real *row = (sb_real *)(void *)m->scratch;
    for (int i = 0; i < m->length; i++)
        for (int axis = 0; axis < 3; axis++) {
            for (int k = 0; k < keep; k++) {
                double sum = 0;
                for (int j = 0; j < m->size; j++)
                    sum += m->vectors[(size_t)k * (size_t)m->size + (size_t)j] *
                           (double)(&sbi_modes_basis(m, j)[i].x)[axis];
                row[k] = (sb_real)sum;
            }
            for (int k = 0; k < keep; k++)
                (&sbi_modes_basis(m, k)[i].x)[axis] = row[k];
        }
    for (int i = 0; i < keep; i++)
        for (int j = 0; j < keep; j++)
            m->projected[(size_t)i * (size_t)m->capacity + (size_t)j] = i == j ? m->values[i] : 0;
    m->size = keep;
}

/* Collects directions that improve the lowest vectors not yet good enough; returns how many of the wanted ones are
 * not, and in *grown how many directions there are. */
static sb_result sbi_modes_improve(sbi_modes *m, int *missing, int *grown)
{
    int tried = sbi_min_int(m->count + SBI_MODES_GUARD, m->size);
    sb_result result = SB_OK;
    double worst = 0;
    *missing = *grown = 0;
    for (int i = 0; i < tried && *grown < m->block && result == SB_OK; i++) {
        double residual = sbi_modes_residual(m, i);
        if (i < m->count)
            worst = residual > worst ? residual : worst;
        if (residual <= (double)m->options->tolerance)
            continue;
        if (i < m->count && !(*missing)++)
            sbi_fail(m->error, SB_ERROR_NOT_CONVERGED, "mode %d has a residual of %g after %d iterations", i + 1,
                     residual, m->info->iterations);
        if (i < m->count || *missing) {
            result = sbi_modes_solve(m, m->ax, m->fresh + (size_t)*grown * (size_t)m->length, 0.01);
            ++*grown;
        }
    }
    m->info->residual = (sb_real)worst;
    return result;
}

/* Rounds of projection and growth until every wanted mode is good enough, also after a last look for missed ones. */
static sb_result sbi_modes_iterate(sbi_modes *m)
{
    int checked = 0;
    for (;;) {
        int missing, grown, keep;
        sb_result result = sbi_modes_project(m);
        if (result == SB_OK && m->size < m->count)
            result =
                sbi_fail(m->error, SB_ERROR_NOT_CONVERGED, "mode %d does not show in %d vectors", m->size + 1, m->size);
        if (result == SB_OK)
            result = sbi_modes_improve(m, &missing, &grown);
        if (result != SB_OK)
            return result;
        if (missing == 0 && (checked || m->size >= m->freedom))
            return SB_OK;
        if (m->size >= m->freedom) /* the space is everything: what is left is rounding */
            return SB_OK;
        if (m->info->iterations == m->options->max_iterations)
            return SB_ERROR_NOT_CONVERGED;
        m->info->iterations++;
        keep = sbi_min_int(m->count + SBI_MODES_GUARD + SBI_MODES_BLOCK, m->size);
        if (m->size + grown + SBI_MODES_PROBES > m->capacity && m->capacity < m->freedom)
            sbi_modes_restart(m, keep);
        for (int k = 0; k < grown; k++)
            sbi_modes_append(m, m->fresh + (size_t)k * (size_t)m->length);
        if (missing == 0) {
            checked = 1;
            result = sbi_modes_append_random(m, SBI_MODES_PROBES);
            if (result != SB_OK)
                return result;
        }
    }
}

/* ---- set-up ---- */

static int sbi_modes_count_freedom(const sb_body *b)
{
    int free_axes = 0;
    for (int i = 0; i < b->domain.node_count; i++)
        for (int axis = 0; axis < 3; axis++)
            free_axes += !(sbi_body_held(b, i) >> axis & 1);
    return free_axes + sbi_rigids_count_freedom(b);
}

static sb_result sbi_modes_check(const sb_body *body, int count, const sb_modes_options *options,
                                 const sb_real *frequencies, sb_error *error)
{
    if (!body || !frequencies)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_modes needs a body and a place for frequencies");
    if (options->cookie != SBI_MODES_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the options were not made by sb_default_modes_options");
    if (options->mass != SB_MASS_LUMPED && options->mass != SB_MASS_CONSISTENT && options->mass != SB_MASS_REDUCED)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "options.mass %d is unknown", (int)options->mass);
    if (!(options->tolerance > 0) || !(options->tolerance < 1) || options->max_iterations < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "options.tolerance %g must be in (0, 1), max_iterations %d >= 1",
                        (double)options->tolerance, options->max_iterations);
    if (count < 1 || count > sbi_modes_count_freedom(body))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d modes of a body with %d free degrees of freedom", count,
                        sbi_modes_count_freedom(body));
    return SB_OK;
}

static void sbi_modes_layout(sbi_modes *m, sbi_arena *arena)
{
    size_t vector = (size_t)m->length * sizeof(sb_vec3), c = (size_t)m->capacity;
    m->mass = (sb_real *)sbi_arena_take(arena, (size_t)m->body->matrix.block_count, sizeof(sb_real));
    m->weight = (sb_vec3 *)sbi_arena_take(arena, 1, vector);
    m->spread = (sb_vec3 *)sbi_arena_take(arena, 1, vector);
    m->basis = (sb_vec3 *)sbi_arena_take(arena, c, vector);
    m->fresh = (sb_vec3 *)sbi_arena_take(arena, (size_t)m->block, vector);
    m->x = (sb_vec3 *)sbi_arena_take(arena, 1, vector);
    m->ax = (sb_vec3 *)sbi_arena_take(arena, 1, vector);
    m->mx = (sb_vec3 *)sbi_arena_take(arena, 1, vector);
    m->projected = (double *)sbi_arena_take(arena, c, c * sizeof(double));
    m->vectors = (double *)sbi_arena_take(arena, 2 * c, c * sizeof(double)); /* and what the eigensolver overwrites */
    m->values = (double *)sbi_arena_take(arena, c, sizeof(double));
    m->scratch = (double *)sbi_arena_take(arena, c, 3 * sizeof(double));
}

static sb_result sbi_modes_take_memory(sbi_modes *m)
{
    sbi_arena arena = {NULL, 0, 0};
    unsigned char *base;
    sbi_modes_layout(m, &arena);
    if (!arena.overflow && arena.used <= (size_t)-1 - 64)
        m->memory = sbi_alloc(&m->body->allocator, arena.used + 64, 1);
    if (!m->memory)
        return sbi_fail(m->error, SB_ERROR_MEMORY, "no memory for %d vectors of %d nodes", m->capacity, m->nodes);
    base = (unsigned char *)m->memory;
    arena.base = base + (64 - (size_t)((uintptr_t)base & 63));
    arena.used = 0;
    sbi_modes_layout(m, &arena);
    return SB_OK;
}

/* Rigid bodies about the shape that is asked for; at_present what their arms' turning makes of forces at nodes counts,
 * which are current in the body or in m->mx. */
static void sbi_modes_turn_rigids(sbi_modes *m)
{
    const sb_body *b = m->body;
    const sb_vec3 *force = b->force_current ? b->internal : m->mx;
    if (m->rigids.count == 0)
        return;
    for (int i = 0; i < m->nodes && m->options->at_present; i++)
        m->x[i] = sb_v3_sub(force[i], b->external[i]);
    if (m->options->at_present && b->elimination)
        sbi_elimination_reduce(b->elimination, m->x, m->x, NULL);
    sbi_rigids_turn_small(m->body, m->options->at_present, m->options->at_present ? m->x : NULL);
}

/* matrix = K of the shape that is asked for. The warm starts of rotations are put back by the caller. */
static sb_result sbi_modes_assemble(sbi_modes *m)
{
    sb_body *b = m->body;
    sbi_assembly *assembly = &b->assembly;
    size_t points = (size_t)b->domain.cell_count * (size_t)b->domain.points_per_cell;
    const sb_vec3 *u = b->displacement;
    int bad = -1;
    if (!m->options->at_present) {
        memset(m->x, 0, (size_t)m->length * sizeof *m->x);
        u = m->x;
        for (size_t i = 0; i < points && !assembly->batched; i++)
            assembly->rotations[i] = sb_quat_identity();
        sbi_assembly_drop_prestress(assembly);
    } else if (!b->force_current) {
        bad = sbi_assembly_force(assembly, u, m->mx);
    }
    if (bad < 0)
        bad = sbi_assembly_tangent(assembly, u, SB_TANGENT_EXACT, 1, &b->matrix);
    if (bad >= 0)
        return sbi_fail_element(m->error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    sbi_modes_turn_rigids(m);
    return SB_OK;
}

/* Speed of shear waves over the size of the body, squared (1/s^2): slender bodies have lower frequencies, none much
 * lower than a share of it. */
static double sbi_modes_unit(const sb_body *b)
{
    double stiffness = 0, mass = 0, size = 0;
    for (int e = 0; e < b->domain.cell_count; e++) {
        const sb_material *material = b->materials + b->cell_material[e];
        for (int p = 0; p < b->domain.points_per_cell; p++) {
            double w = (double)b->domain.weights[(size_t)e * (size_t)b->domain.points_per_cell + (size_t)p];
            stiffness += w * (double)material->mu;
            mass += w * (double)material->density;
        }
    }
    for (int c = 0; c < b->component_count; c++) {
        double s = (double)sb_v3_norm(sb_v3_sub(b->component_high[c], b->component_low[c]));
        size = s > size ? s : size;
    }
    return stiffness / (mass * size * size);
}

/* The masses that residuals are measured with. */
static void sbi_modes_weigh(sbi_modes *m)
{
    const sb_body *b = m->body;
    for (int i = 0; i < m->nodes; i++) {
        sb_real lumped = b->lumped_mass[i];
        m->weight[i] = sb_v3(lumped, lumped, lumped);
    }
    if (b->elimination)
        sbi_elimination_condense_diagonal(b->elimination, m->weight);
}

/* A = K + shift M with supports, and its preconditioner. Supported bodies need no shift. */
static sb_result sbi_modes_prepare(sbi_modes *m)
{
    sb_body *b = m->body;
    sb_preconditioner_def settings = sb_default_preconditioner_def();
    sb_matrix *matrix = &b->matrix;
    double step;
    sbi_loose loose;
    sb_real *moduli = NULL;
    sb_result result = sbi_modes_assemble(m);
    if (result != SB_OK)
        return result;
    sbi_kept_spoil(b);
    if (b->load_count)
        sbi_loads_add_tangent(b, b->displacement, m->options->at_present ? SB_TANGENT_EXACT : SB_TANGENT_SPD, 1,
                              matrix);
    sbi_body_mass_blocks(b, m->options->mass, m->mass);
    sbi_modes_weigh(m);
    if (b->elimination)
        sbi_elimination_condense(b->elimination, matrix);
    step = (double)sbi_explicit_bound(b, m->matrix, m->weight);
    m->rounding = 4 * (double)SB_EPSILON * 4 / (step * step);
    sbi_rigids_weigh(b, m->weight);
    result = sbi_body_find_loose(b, &loose, m->error);
    if (result != SB_OK)
        return result;
    if (loose.node >= 0 || loose.rigid > 0) {
        m->shift = 1e-4 * sbi_modes_unit(b);
        m->shift = m->shift > 16 * m->rounding ? m->shift : 16 * m->rounding;
    }
    for (int k = 0; k < matrix->block_count; k++)
        for (int axis = 0; axis < 3; axis++)
            matrix->blocks[k][4 * axis] += (sb_real)m->shift * m->mass[k];
    if (b->elimination) {
        sbi_elimination_condense(b->elimination, matrix);
        for (int i = 0; i < m->nodes; i++)
            b->elimination->held[i] = (unsigned char)sbi_body_held(b, i);
    }
    sb_matrix_constrain(m->matrix, b->elimination ? b->elimination->held : b->fixed, NULL, NULL);
    settings.positions = m->options->at_present ? b->position : b->reference;
    settings.jobs = b->jobs;
    /* as the body itself, whatever constraints and loads have added to the matrix since it was made */
    settings.kind = sb_body_solver(b).kind == SB_PRECOND_MULTIGRID ? SB_PRECOND_MULTIGRID : SB_PRECOND_IC0;
    if (!b->elimination && settings.kind == SB_PRECOND_MULTIGRID)
        result = sbi_body_make_moduli(b, NULL, m->matrix, &moduli, m->error);
    settings.moduli = moduli;
    settings.poisson = sbi_body_poisson(b);
    if (result == SB_OK)
        result = sb_preconditioner_create(&settings, m->matrix, &b->allocator, &m->precond, m->error);
    sbi_free(&b->allocator, moduli);
    if (result == SB_OK && m->rigids.count > 0)
        result = sbi_pcg_update_preconditioner(m->precond, m->matrix, settings.positions, &m->rigids.guests, &b->pcg,
                                               m->error);
    else if (result == SB_OK)
        result = sb_preconditioner_update(m->precond, m->matrix, NULL, m->error);
    return result == SB_OK ? sbi_rigids_factor_small(b, m->matrix, m->shift, m->error) : result;
}

static void sbi_modes_write(sbi_modes *m, sb_real *frequencies, sb_vec3 *shapes)
{
    for (int i = 0; i < m->count; i++) {
        double lambda = m->values[i] - m->shift;
        sb_vec3 *shape = shapes ? shapes + (size_t)i * (size_t)m->nodes : NULL;
        frequencies[i] = (sb_real)(sqrt(lambda > 0 ? lambda : 0) / 6.283185307179586);
        if (!shape)
            continue;
        sbi_modes_ritz(m, i, m->x);
        memcpy(shape, m->x, (size_t)m->nodes * sizeof *shape);
        sbi_rigids_spread(m->body, m->x, shape);
        if (m->body->elimination)
            sbi_elimination_expand(m->body->elimination, shape, 0);
    }
}

static sb_result sbi_modes_run(sbi_modes *m, sb_real *frequencies, sb_vec3 *shapes)
{
    sb_result result = sbi_modes_take_memory(m);
    if (result == SB_OK)
        result = sbi_rigids_begin_small(m->body, m->matrix, &m->rigids, m->error);
    if (result == SB_OK)
        result = sbi_modes_prepare(m);
    if (result == SB_OK && m->shift > 0)
        sbi_modes_append_rigid(m);
    if (result == SB_OK)
        result = sbi_modes_append_random(m, sbi_min_int(m->count + SBI_MODES_GUARD, m->freedom));
    if (result == SB_OK)
        result = sbi_modes_iterate(m);
    if (result == SB_OK)
        sbi_modes_write(m, frequencies, shapes);
    return result;
}

SB_API sb_result sb_body_modes(sb_body *body, int count, const sb_modes_options *options, sb_real *frequencies,
                               sb_vec3 *shapes, sb_modes_info *info, sb_error *error)
{
    sb_modes_options defaults = sb_default_modes_options();
    sb_modes_info report;
    sb_error own;
    sbi_modes m;
    double begin;
    sb_result result;
    options = options ? options : &defaults;
    result = sbi_modes_check(body, count, options, frequencies, error);
    if (result != SB_OK)
        return result;
    begin = body->clock ? body->clock() : 0;
    memset(&report, 0, sizeof report);
    memset(&m, 0, sizeof m);
    m.body = body;
    m.options = options;
    m.info = &report;
    m.error = &own;
    m.matrix = body->elimination ? &body->elimination->matrix : &body->matrix;
    m.nodes = body->domain.node_count;
    m.length = m.nodes + 2 * sb_body_rigid_count(body);
    m.count = count;
    m.freedom = sbi_modes_count_freedom(body);
    m.block = SBI_MODES_BLOCK;
    m.capacity = count > m.freedom / 3 ? m.freedom : sbi_min_int(m.freedom, count + count / 2 + 8 + 3 * m.block);
    m.random = 88172645463325252ULL;
    sbi_assembly_save_rotations(&body->assembly);
    result = sbi_modes_run(&m, frequencies, shapes);
    sbi_assembly_restore_rotations(&body->assembly);
    sb_preconditioner_free(m.precond);
    sbi_free(&body->allocator, m.memory);
    report.seconds = body->clock ? body->clock() - begin : 0;
    if (info && (result == SB_OK || result == SB_ERROR_NOT_CONVERGED))
        *info = report;
    if (error && result != SB_OK)
        *error = own;
    return result;
}
