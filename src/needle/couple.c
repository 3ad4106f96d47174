/* couple: the friction states of a step. Friction does not depend on normal forces here (Tresca), so that a step is a
 * strictly convex problem with exactly one solution. States are guessed, the linear system solved, and every state that
 * the solution contradicts is turned over: block pivoting, with the last contradicted node alone (least index, which is
 * finite) while that makes no headway. */
#include "couple_solve.h"

#include <string.h>

typedef struct ndli_couple {
    ndl_tissue *tissue;
    ndli_line *const *lines;
    int count;
} ndli_couple;

/* ---- the lines as one guest ---- */

static void ndli_couple_begin(void *user)
{
    ndli_couple *c = (ndli_couple *)user;
    for (int k = 0; k < c->count; k++)
        ndli_line_begin(c->lines[k]);
}

static void ndli_couple_settle(void *user)
{
    ndli_couple *c = (ndli_couple *)user;
    for (int k = 0; k < c->count; k++)
        ndli_line_settle(c->lines[k]);
}

static void ndli_couple_direct(void *user, sb_real factor)
{
    ndli_couple *c = (ndli_couple *)user;
    for (int k = 0; k < c->count; k++)
        ndli_line_direct(c->lines[k], (double)factor);
}

static double ndli_couple_multiply(void *user)
{
    ndli_couple *c = (ndli_couple *)user;
    double sum = 0;
    for (int k = 0; k < c->count; k++)
        sum += ndli_line_multiply(c->lines[k]);
    return sum;
}

static void ndli_couple_advance(void *user, sb_real factor)
{
    ndli_couple *c = (ndli_couple *)user;
    for (int k = 0; k < c->count; k++)
        ndli_line_advance(c->lines[k], (double)factor);
}

static double ndli_couple_precondition(void *user)
{
    ndli_couple *c = (ndli_couple *)user;
    double sum = 0;
    for (int k = 0; k < c->count; k++)
        sum += ndli_line_precondition(c->lines[k]);
    return sum;
}

static int ndli_couple_factor(const ndli_couple *c)
{
    for (int k = 0; k < c->count; k++)
        if (!ndli_line_factor(c->lines[k]))
            return 0;
    return 1;
}

/* ---- friction states ---- */

/* The state that the solution asks for at a coupled node. */
static int ndli_couple_wanted(const ndli_line *line, int i)
{
    double along = ndli_dot(line->tangent[i], line->contact[i]);
    if (ndli_line_is_slipping(line, i))
        return ndli_line_sign(line, i) * line->slip[i] >= 0 ? (int)line->state[i] : (int)NDL_STATIC;
    if (along < -ndli_line_limit(line, i, 1))
        return NDL_DYNAMIC_FORWARD;
    if (along > ndli_line_limit(line, i, -1))
        return NDL_DYNAMIC_BACKWARD;
    return NDL_STATIC;
}

static int ndli_couple_count_wrong(const ndli_couple *c)
{
    int wrong = 0;
    for (int k = 0; k < c->count; k++) {
        ndli_line_read(c->lines[k]);
        for (int i = c->lines[k]->first; i <= ndli_line_foremost(c->lines[k]); i++)
            wrong += ndli_couple_wanted(c->lines[k], i) != c->lines[k]->state[i];
    }
    return wrong;
}

/* Turns over what the solution contradicts: all, or the last only. */
static void ndli_couple_flip(const ndli_couple *c, int all)
{
    for (int k = c->count - 1; k >= 0; k--)
        for (int i = ndli_line_foremost(c->lines[k]); i >= c->lines[k]->first; i--) {
            int wanted = ndli_couple_wanted(c->lines[k], i);
            if (wanted == c->lines[k]->state[i])
                continue;
            c->lines[k]->state[i] = (unsigned char)wanted;
            if (!all)
                return;
        }
}

/* ---- solve ---- */

/* The first guess: accelerations of the tissue `factor` times the last ones, and rods moved in what that makes of it:
 * their stiffness, a million times the tissue's, is then no part of the residual. */
static void ndli_couple_guess(const ndli_couple *c, ndli_solid_cg *cg, sb_real factor)
{
    ndl_tissue *t = c->tissue;
    for (int i = 0; i < t->mesh.node_end; i++)
        t->unknown[i] = t->role[i] == NDLI_ROW_FREE ? sb_v3_scale(factor, t->before[i]) : sb_v3(0, 0, 0);
    for (int k = 0; k < c->count; k++)
        memset(c->lines[k]->unknown, 0, (size_t)c->lines[k]->rod->node_count * sizeof *c->lines[k]->unknown);
    ndli_solid_cg_residual(cg);
    for (int k = 0; k < c->count; k++) {
        ndli_line_precondition(c->lines[k]);
        ndli_line_guess(c->lines[k]);
    }
    ndli_solid_cg_begin(cg);
}

/* 1 when the residual pulls against the last accelerations. */
static int ndli_couple_turns_back(const ndl_tissue *t)
{
    double sum = 0;
    for (int i = 0; i < t->mesh.node_end; i++)
        if (t->role[i] == NDLI_ROW_FREE)
            sum += (double)sb_v3_dot(t->before[i], t->residual[i]);
    return sum < 0;
}

/* Starts from the better guess; returns the size of the residual from rest, which tolerances are relative to.
 * Newmark's average acceleration turns accelerations of what is too stiff for the step round from step to step, and
 * nothing moves by them. A needle that cuts and slips always leaves some, far more than what is new in a step. */
static double ndli_couple_start(const ndli_couple *c, ndli_solid_cg *cg)
{
    double first;
    ndli_couple_guess(c, cg, 0);
    first = cg->rz;
    if (!ndli_couple_turns_back(c->tissue))
        return first;
    ndli_couple_guess(c, cg, -1);
    if (!(cg->rz < first))
        ndli_couple_guess(c, cg, 0);
    return first;
}

/* Headway of the pivoting: how many were contradicted at best, and for how many trials it has not been fewer. */
typedef struct ndli_couple_progress {
    int fewest, stalled;
} ndli_couple_progress;

static sb_result ndli_couple_try(const ndli_couple *c, ndli_solid_cg *cg, double first, int max_trials,
                                 ndl_couple_info *info, sb_error *error)
{
    double enough = (double)c->tissue->tolerance * (double)c->tissue->tolerance * first;
    ndli_couple_progress progress = {0x7fffffff, 0};
    for (;;) {
        /* where states hang on little (a needle at rest), what a solve leaves open would turn them over and back */
        double target = info->trials > 2 ? 0.01 * enough : enough;
        sb_result result = ndli_solid_cg_run(cg, target, error);
        int wrong = result == SB_OK ? ndli_couple_count_wrong(c) : 0;
        info->consistent = !wrong;
        if (result != SB_OK || !wrong || info->trials >= max_trials)
            return result;
        progress.stalled = wrong < progress.fewest ? 0 : progress.stalled + 1;
        progress.fewest = sbi_min_int(progress.fewest, wrong);
        ndli_couple_flip(c, progress.stalled < 3);
        info->trials++;
        if (!ndli_couple_factor(c))
            return sbi_fail(error, SB_ERROR_DIVERGED, "the needles' matrix is not positive definite");
        ndli_solid_cg_begin(cg);
    }
}

NDLI_API sb_result ndli_couple_solve(ndl_tissue *tissue, ndli_line *const *lines, int count, double dt, int max_trials,
                                     ndl_couple_info *info, sb_error *error)
{
    ndli_couple c;
    ndli_solid_guest guest = {&c, ndli_couple_begin, ndli_couple_settle, ndli_couple_direct, ndli_couple_multiply,
                              ndli_couple_advance, ndli_couple_precondition};
    ndli_solid_cg cg = {tissue, &guest, 0, 0, 0};
    sb_result result;
    double first;
    c.tissue = tissue;
    c.lines = lines;
    c.count = count;
    memset(info, 0, sizeof *info);
    for (int k = 0; k < count; k++) {
        int bad = ndli_line_linearise(lines[k], dt);
        if (bad >= 0)
            return sbi_fail_node(error, SB_ERROR_DIVERGED, bad, "needle %d is folded at its node %d", k, bad);
    }
    if (!ndli_couple_factor(&c))
        return sbi_fail(error, SB_ERROR_DIVERGED, "the needles' matrix is not positive definite");
    first = ndli_couple_start(&c, &cg);
    info->trials = 1;
    result = ndli_couple_try(&c, &cg, first, max_trials, info, error);
    if (result != SB_OK)
        return result;
    for (int k = 0; k < count; k++)
        ndli_line_read(lines[k]);
    info->iterations = cg.iterations;
    info->capped = cg.iterations >= tissue->max_iterations;
    info->residual = first > 0 && cg.rz > 0 ? (sb_real)sqrt(cg.rz / first) : 0;
    return SB_OK;
}
