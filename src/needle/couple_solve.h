/* couple_solve: friction states and motion of a step. Floor 6, internal. */
#ifndef NDL_COUPLE_SOLVE_H
#define NDL_COUPLE_SOLVE_H

#include "couple_line.h"

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* After ndli_solid_begin: the accelerations of the tissue (tissue->unknown) and what each line finds, with the friction
 * states that go with it; lines' states are the first guess. Nothing of the tissue's or a rod's state changes.
 * SB_ERROR_DIVERGED: a folded rod (node named), or something is not finite. */
NDLI_API sb_result ndli_couple_solve(ndl_tissue *tissue, ndli_line *const *lines, int count, double dt, int max_trials,
                                     ndl_couple_info *info, sb_error *error);
#endif

#endif /* NDL_COUPLE_SOLVE_H */
