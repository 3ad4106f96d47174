/* couple: the friction states of a step. Friction does not depend on normal forces here (Tresca), so that a step is a
 * strictly convex problem with exactly one solution. States are guessed, the linear system solved, and every state that
 * the solution contradicts is turned over: block pivoting, with the last contradicted node alone (least index, which is
 * finite) while that makes no headway. */
#include "couple_solve.h"

#include "couple_rows.h"

#include <string.h>

/* ---- the lines' parts of the guest's vectors: all unknowns, then three components of each node ---- */

typedef struct ndli_couple_part {
    size_t unknown, nodes; /* where the line's begin */
} ndli_couple_part;

static ndli_couple_part ndli_couple_first(const ndli_couple *c)
{
    ndli_couple_part part;
    part.unknown = 0;
    part.nodes = (size_t)c->guest.unknown_count;
    return part;
}

static ndli_couple_part ndli_couple_next(const ndli_couple *c, ndli_couple_part part, int k)
{
    part.unknown += (size_t)ndli_line_unknown_count(c->lines[k]);
    part.nodes += 3 * (size_t)ndli_line_taken_count(c->lines[k]);
    return part;
}

static void ndli_couple_apply(const ndli_couple *c, int loads, const double *x, double *y)
{
    ndli_couple_part at = ndli_couple_first(c);
    if (c->rows)
        memset(y + at.nodes, 0, 3 * (size_t)c->guest.node_count * sizeof(double));
    for (int k = 0; k < c->count; at = ndli_couple_next(c, at, k), k++) {
        ndli_line_apply(c->lines[k], loads, x + at.unknown, x + at.nodes, y + at.unknown, y + at.nodes);
        if (c->rows)
            ndli_rows_apply(c->lines[k], loads, x + at.nodes, y + at.unknown, y + at.nodes);
    }
}

static void ndli_couple_residual(void *user, const double *x, double *y)
{
    ndli_couple_apply((const ndli_couple *)user, 1, x, y);
}

static void ndli_couple_multiply(void *user, const double *x, double *y)
{
    ndli_couple_apply((const ndli_couple *)user, 0, x, y);
}

static void ndli_couple_precondition(void *user, const double *r, double *z)
{
    const ndli_couple *c = (const ndli_couple *)user;
    ndli_couple_part at = ndli_couple_first(c);
    for (int k = 0; k < c->count; at = ndli_couple_next(c, at, k), k++)
        ndli_line_solve_block(c->lines[k], r + at.unknown, r + at.nodes, z + at.unknown, z + at.nodes);
}

static int ndli_couple_factor(const ndli_couple *c)
{
    for (int k = 0; k < c->count; k++) {
        ndli_line_fill(c->lines[k], c->matrix);
        if (c->rows)
            ndli_rows_add_band(c->lines[k]);
        if (!ndli_line_factor(c->lines[k]))
            return 0;
    }
    return 1;
}

/* The rods at their shape at the start of the step. */
static sb_result ndli_couple_linearise(const ndli_couple *c, const sbi_guest_step *step, sb_error *error)
{
    ndli_couple_part at = ndli_couple_first(c);
    for (int k = 0; k < c->count; at = ndli_couple_next(c, at, k), k++) {
        int bad = ndli_line_linearise(c->lines[k], step);
        if (bad >= 0)
            return sbi_fail_node(error, SB_ERROR_DIVERGED, bad, "needle %d is folded at its node %d", k, bad);
        ndli_line_start(c->lines[k], c->guest.unknown + at.unknown);
    }
    return SB_OK;
}

static sb_result ndli_couple_begin(void *user, const sbi_guest_step *step, sb_error *error)
{
    ndli_couple *c = (ndli_couple *)user;
    sb_result result = step->iteration == 0 ? ndli_couple_linearise(c, step, error) : SB_OK;
    c->trials = 1;
    c->fewest = 0x7fffffff;
    c->stalled = 0;
    if (result != SB_OK)
        return result;
    c->matrix = step->matrix;
    if (!ndli_couple_factor(c))
        return sbi_fail(error, SB_ERROR_INDEFINITE, "the needles' matrix is not positive definite");
    return SB_OK;
}

static void ndli_couple_read(const ndli_couple *c, const double *x)
{
    ndli_couple_part at = ndli_couple_first(c);
    for (int k = 0; k < c->count; at = ndli_couple_next(c, at, k), k++) {
        ndli_line_read(c->lines[k], x + at.unknown, x + at.nodes);
        if (c->rows)
            ndli_rows_read(c->lines[k], x + at.nodes);
    }
}

static void ndli_couple_commit(void *user, const double *x) { ndli_couple_read((const ndli_couple *)user, x); }

/* ---- friction states ---- */

/* The state that the solution asks for at a coupled node. */
static int ndli_couple_wanted(const ndli_line *line, int i)
{
    double along = ndli_dot(line->holds ? line->holds[i].tangent : line->tangent[i], line->contact[i]);
    if (ndli_line_is_slipping(line, i))
        return ndli_line_sign(line, i) * line->slip[i] >= 0 ? (int)line->state[i] : (int)NDL_STATIC;
    if (along < -ndli_line_limit(line, i, 1))
        return NDL_DYNAMIC_FORWARD;
    if (along > ndli_line_limit(line, i, -1))
        return NDL_DYNAMIC_BACKWARD;
    return NDL_STATIC;
}

static int ndli_couple_count_wrong(const ndli_couple *c, const double *x)
{
    int wrong = 0;
    ndli_couple_read(c, x);
    for (int k = 0; k < c->count; k++)
        for (int i = ndli_line_rearmost(c->lines[k]); i <= ndli_line_foremost(c->lines[k]); i++)
            wrong += ndli_couple_wanted(c->lines[k], i) != c->lines[k]->state[i];
    return wrong;
}

/* Turns over what the solution contradicts: all, or the last only. */
static void ndli_couple_flip(const ndli_couple *c, int all)
{
    for (int k = c->count - 1; k >= 0; k--)
        for (int i = ndli_line_foremost(c->lines[k]); i >= ndli_line_rearmost(c->lines[k]); i--) {
            int wanted = ndli_couple_wanted(c->lines[k], i);
            if (wanted == c->lines[k]->state[i])
                continue;
            c->lines[k]->state[i] = (unsigned char)wanted;
            if (!all)
                return;
        }
}

/* Nodes that stick have no slip. */
static void ndli_couple_stop(const ndli_couple *c)
{
    ndli_couple_part at = ndli_couple_first(c);
    for (int k = 0; k < c->count; at = ndli_couple_next(c, at, k), k++)
        for (int i = 0; i < c->lines[k]->rod->node_count; i++)
            if (!ndli_line_is_slipping(c->lines[k], i))
                c->guest.unknown[at.unknown + NDLI_LINE_UNKNOWNS * (size_t)i + 3] = 0;
}

/* 1: states have changed, and the solve goes on. */
static int ndli_couple_settle(void *user, const double *x)
{
    ndli_couple *c = (ndli_couple *)user;
    int wrong = ndli_couple_count_wrong(c, x);
    c->info.consistent = !wrong;
    if (!wrong || c->trials >= c->max_trials)
        return 0;
    c->stalled = wrong < c->fewest ? 0 : c->stalled + 1;
    c->fewest = sbi_min_int(c->fewest, wrong);
    ndli_couple_flip(c, c->stalled < 3);
    ndli_couple_stop(c);
    c->trials++;
    c->info.trials = sbi_max_int(c->info.trials, c->trials);
    c->indefinite = !ndli_couple_factor(c);
    return !c->indefinite;
}

/* ---- the guest ---- */

static void ndli_couple_set_up(ndli_couple *couple, ndli_line *const *lines, int count, int max_trials, double *unknown)
{
    memset(couple, 0, sizeof *couple);
    couple->lines = lines;
    couple->count = count;
    couple->max_trials = max_trials;
    couple->info.trials = 1;
    couple->guest.user = couple;
    couple->guest.unknown = unknown;
    for (int k = 0; k < count; k++) {
        couple->guest.unknown_count += ndli_line_unknown_count(lines[k]);
        ndli_line_keep_contact(lines[k]);
    }
    couple->guest.residual = ndli_couple_residual;
    couple->guest.multiply = ndli_couple_multiply;
    couple->guest.precondition = ndli_couple_precondition;
    couple->guest.begin = ndli_couple_begin;
    couple->guest.settle = ndli_couple_settle;
    couple->guest.commit = ndli_couple_commit;
}

NDLI_API void ndli_couple_prepare(ndli_couple *couple, ndli_line *const *lines, int count, int max_trials,
                                  double *unknown, int *nodes)
{
    ndli_couple_set_up(couple, lines, count, max_trials, unknown);
    for (int k = 0; k < count; k++)
        for (int i = 0; i < lines[k]->count; i++)
            nodes[couple->guest.node_count++] = lines[k]->path[i];
    couple->guest.nodes = nodes;
    couple->guest.taken_count = couple->guest.node_count;
}

NDLI_API void ndli_couple_prepare_rows(ndli_couple *couple, ndli_line *const *lines, int count, int max_trials,
                                       double *unknown, const int *nodes, int node_count)
{
    ndli_couple_set_up(couple, lines, count, max_trials, unknown);
    couple->rows = 1;
    couple->guest.nodes = nodes;
    couple->guest.node_count = node_count;
}

/* More than its law allows (N), summed over a needle's nodes that stick; what slips has its limit. *law: all that
 * friction and tip can hold. */
static double ndli_couple_excess(const ndli_line *line, double *law)
{
    double sum = 0;
    *law = 0;
    for (int i = ndli_line_rearmost(line); i <= ndli_line_foremost(line); i++) {
        double along = ndli_dot(line->holds ? line->holds[i].tangent : line->tangent[i], line->contact[i]);
        double most = ndli_line_limit(line, i, along < 0 ? 1 : -1);
        *law += most;
        if (!ndli_line_is_slipping(line, i))
            sum += fmax(0, fabs(along) - most);
    }
    return sum;
}

/* Of the law: what states that were not found to the end may be beyond it. */
static const double ndli_couple_most_excess = 0.02;

NDLI_API sb_result ndli_couple_check(const ndli_couple *couple, sb_error *error)
{
    for (int k = 0; k < couple->count && !couple->info.consistent; k++) {
        double law, excess = ndli_couple_excess(couple->lines[k], &law);
        if (excess > ndli_couple_most_excess * law)
            return sbi_fail(error, SB_ERROR_DIVERGED,
                            "needle %d: after %d trials its friction is %g N beyond the %g N that the tissue can hold",
                            k, couple->info.trials, excess, law);
    }
    if (couple->indefinite)
        return sbi_fail(error, SB_ERROR_DIVERGED, "the needles' matrix is not positive definite");
    return SB_OK;
}
