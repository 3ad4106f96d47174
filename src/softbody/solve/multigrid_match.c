/* multigrid_match: what a level in the making has in common with one of a multigrid made before. */
#include "multigrid_level.h"

#include <string.h>

SBI_API int sbi_mg_begin_match(const sbi_mg_level *old, int row_count, const sb_allocator *allocator,
                               sbi_mg_match *match)
{
    match->old = old;
    match->was = (int *)sbi_alloc(allocator, (size_t)row_count, sizeof(int));
    match->same = (unsigned char *)sbi_alloc(allocator, (size_t)row_count, 1);
    for (int i = 0; match->was && i < row_count; i++)
        match->was[i] = -1;
    if (match->was && match->same)
        return 1;
    sbi_mg_free_match(allocator, match);
    return 0;
}

SBI_API void sbi_mg_free_match(const sb_allocator *allocator, sbi_mg_match *match)
{
    sbi_free(allocator, match->was);
    sbi_free(allocator, match->same);
    memset(match, 0, sizeof *match);
}

static int sbi_mg_has_columns(const sbi_mg_level *level, const sbi_mg_match *match, int i)
{
    const sbi_mg_level *old = match->old;
    int was = match->was[i], first = level->row_start[i], count = level->row_start[i + 1] - first, same;
    same = was >= 0 && count == old->row_start[was + 1] - old->row_start[was];
    for (int k = 0; k < count && same; k++)
        same = match->was[level->columns[first + k]] == old->columns[old->row_start[was] + k];
    return same;
}

SBI_API void sbi_mg_match_columns(const sbi_mg_level *level, sbi_mg_match *match)
{
    for (int i = 0; i < level->row_count && match->old; i++)
        match->same[i] = (unsigned char)sbi_mg_has_columns(level, match, i);
}

/* 1: row i has the same columns in both, number for number. */
static int sbi_mg_is_row(const sbi_mg_level *level, const sbi_mg_level *old, int i)
{
    int first = level->row_start[i], count = level->row_start[i + 1] - first;
    return count == old->row_start[i + 1] - old->row_start[i] &&
           memcmp(level->columns + first, old->columns + old->row_start[i], (size_t)count * sizeof(int)) == 0;
}

SBI_API int sbi_mg_match_finest(const sbi_multigrid *m, const sbi_multigrid *like, sbi_mg_match *match)
{
    const sbi_mg_level *level = m->levels, *old;
    memset(match, 0, sizeof *match);
    if (!like)
        return 1;
    old = like->levels;
    if (!sbi_mg_begin_match(old, level->row_count, &m->owned.allocator, match))
        return 0;
    for (int i = 0; i < sbi_min_int(level->row_count, old->row_count); i++)
        match->was[i] = i;
    for (int i = 0; i < level->row_count; i++) /* columns that there were have their numbers, others are greater */
        match->same[i] = match->was[i] >= 0 && sbi_mg_is_row(level, old, i);
    return 1;
}
