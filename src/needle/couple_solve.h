/* couple_solve: all needles of a body as one guest of its solve. Floor 6, internal. */
#ifndef NDL_COUPLE_SOLVE_H
#define NDL_COUPLE_SOLVE_H

#include "couple_line.h"

/* What the guest works on. The lines' states are the first guess; afterwards they hold those found, with the forces and
 * motions that go with them. Nothing of a rod's state changes. */
typedef struct ndli_couple {
    ndli_line *const *lines; /* [count] */
    int count;
    int rows; /* 1: rods are held by rows of the guest's nodes, else each has nodes of its own */
    int max_trials;
    ndl_couple_info info; /* trials, consistent: of the solve that has ended */
    sbi_guest guest;
    const sb_matrix *matrix; /* the body's, of the present system */
    int indefinite;          /* 1: the block of a set of friction states could not be factored */
    int trials;              /* of the present system */
    int fewest, stalled; /* how many states were contradicted at best, and for how many trials it has not been fewer */
} ndli_couple;

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Makes the guest. unknown: [sum of ndli_line_unknown_count], nodes: [sum of the lines' counts], both borrowed until
 * the solve has ended. */
NDLI_API void ndli_couple_prepare(ndli_couple *couple, ndli_line *const *lines, int count, int max_trials,
                                  double *unknown, int *nodes);
/* The same of rods that rows of nodes [node_count] of the body hold, which their holds count by. */
NDLI_API void ndli_couple_prepare_rows(ndli_couple *couple, ndli_line *const *lines, int count, int max_trials,
                                       double *unknown, const int *nodes, int node_count);
/* After the solve: SB_ERROR_DIVERGED when its last friction states have no positive definite matrix, or when they were
 * not found in max_trials and what sticks is held by more than can hold it. */
NDLI_API sb_result ndli_couple_check(const ndli_couple *couple, sb_error *error);
#endif

#endif /* NDL_COUPLE_SOLVE_H */
