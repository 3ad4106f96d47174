/* multigrid_plan: how a coarser level's matrix is made. Of a multigrid made before, plans are taken over for all rows
 * that are made as they were: after a cut these are nearly all of them. */
#include "multigrid_level.h"

#include <limits.h>
#include <string.h>

/* ---- values -------------------------------------------------------------------------------------------- */

/* What only the finest level has beside its values. */
static int sbi_mg_take_finest(sbi_multigrid *m, sbi_mg_level *level)
{
    size_t rows = (size_t)level->row_count, blocks = (size_t)level->block_count;
    if (m->regions.count > 0) {
        level->mend = sbi_owned_take_floats(&m->owned, rows, 12);
        return level->mend != NULL;
    }
#if SB_REAL_IS_FLOAT
    (void)blocks;
    return 1;
#else
    level->rest = (uint16_t *)sbi_owned_take(&m->owned, blocks, 9 * sizeof(uint16_t));
    m->spread = (double *)sbi_owned_take(&m->owned, rows, 4 * sizeof(double));
    return level->rest && m->spread;
#endif
}

SBI_API int sbi_mg_take_values(sbi_multigrid *m, sbi_mg_level *level)
{
    size_t rows = (size_t)level->row_count;
    int finest = level == m->levels, packed = finest || (m->regions.count == 0 && level->block_count >= SBI_MG_PACKED);
    if (packed) {
        level->packed = (int16_t *)sbi_owned_take(&m->owned, (size_t)level->block_count, 9 * sizeof(int16_t));
        level->scale = sbi_owned_take_floats(&m->owned, rows, 4);
    }
    if (!finest)
        level->blocks = sbi_owned_take_floats(&m->owned, (size_t)level->block_count, 9);
    level->inverse = sbi_owned_take_floats(&m->owned, rows, 12);
    level->x = sbi_owned_take_floats(&m->owned, rows, 4);
    level->r = sbi_owned_take_floats(&m->owned, rows, 4);
    level->d = sbi_owned_take_floats(&m->owned, rows, 4);
    level->e = sbi_owned_take_floats(&m->owned, rows, 4);
    level->partial = (double *)sbi_owned_take(&m->owned, rows / SBI_MG_ROWS + 1, sizeof(double));
    if ((packed && (!level->packed || !level->scale)) || (!finest && !level->blocks) ||
        (finest && !sbi_mg_take_finest(m, level)))
        return 0;
    return level->inverse && level->x && level->r && level->d && level->e && level->partial;
}

/* ---- parents ------------------------------------------------------------------------------------------- */

/* Takes over interpolation rows, and lists them from the coarser side, children ascending. */
static int sbi_mg_take_parents(sbi_multigrid *m, const sbi_mg_rows *rows, sbi_mg_level *level)
{
    size_t n = (size_t)level->row_count, coarse = (size_t)rows->coarse_count, entries = (size_t)rows->start[n];
    level->parent_start = sbi_owned_take_ints(&m->owned, n + 1);
    level->parents = sbi_owned_take_ints(&m->owned, entries);
    level->shares = sbi_owned_take_unset_floats(&m->owned, entries, 1);
    level->child_start = sbi_owned_take_ints(&m->owned, coarse + 2);
    level->children = sbi_owned_take_ints(&m->owned, entries);
    level->child_shares = sbi_owned_take_unset_floats(&m->owned, entries, 1);
    if (!level->parent_start || !level->parents || !level->shares || !level->child_start || !level->children ||
        !level->child_shares)
        return 0;
    memcpy(level->parent_start, rows->start, (n + 1) * sizeof(int));
    memcpy(level->parents, rows->nodes, entries * sizeof(int));
    memcpy(level->shares, rows->weights, entries * sizeof(float));
    memset(level->child_start, 0, (coarse + 2) * sizeof(int));
    for (size_t e = 0; e < entries; e++)
        level->child_start[rows->nodes[e] + 2]++;
    for (size_t a = 0; a < coarse; a++)
        level->child_start[a + 2] += level->child_start[a + 1];
    for (int i = 0; i < level->row_count; i++)
        for (int e = rows->start[i]; e < rows->start[i + 1]; e++) {
            int place = level->child_start[rows->nodes[e] + 1]++;
            level->children[place] = i;
            level->child_shares[place] = rows->weights[e];
        }
    return 1;
}

/* ---- what stays as it was ------------------------------------------------------------------------------ */

/* Scratch of the plans. */
typedef struct sbi_mg_planner {
    const sb_allocator *allocator;
    int coarse_count;
    int *place;         /* [coarse_count] of a coarse node in the row at work */
    int *mixed_columns; /* [mixed_count] coarse node of each block of A P */
    /* where the finer level has something in common with one before, otherwise NULL */
    const sbi_mg_level *old;
    const sbi_mg_match *match;
    sbi_mg_match next;      /* of the coarser level */
    int *now;               /* [coarser rows before] which coarse node that one is, or -1 */
    int *moved;             /* [mixed_count before] where a block of A P is, of rows that are as they were */
    unsigned char *follows; /* [rows] 1: moves with the parents it had, by the same shares */
    unsigned char *mixes;   /* [rows] 1: the row of A P is made as it was, */
    unsigned char *gathers; /* [coarse_count] 1: and so is that of P^T (A P), but for the order of its columns */
} sbi_mg_planner;

static int sbi_mg_take_old(sbi_mg_planner *planner, const sbi_mg_level *fine, sbi_mg_match *match)
{
    const sbi_mg_level *old = match->old;
    size_t rows = (size_t)fine->row_count, coarse = (size_t)planner->coarse_count;
    if (!old || !old->parents)
        return 1;
    planner->old = old;
    planner->match = match;
    planner->now = (int *)sbi_alloc(planner->allocator, (size_t)old[1].row_count, sizeof(int));
    planner->moved = (int *)sbi_alloc(planner->allocator, (size_t)old->mixed_start[old->row_count], sizeof(int));
    planner->follows = (unsigned char *)sbi_alloc(planner->allocator, rows, 2);
    planner->gathers = (unsigned char *)sbi_alloc(planner->allocator, coarse, 1);
    if (!planner->now || !planner->moved || !planner->follows || !planner->gathers)
        return 0;
    planner->mixes = planner->follows + rows;
    return sbi_mg_begin_match(old + 1, planner->coarse_count, planner->allocator, &planner->next);
}

static void sbi_mg_free_planner(sbi_mg_planner *planner)
{
    sbi_mg_free_match(planner->allocator, &planner->next);
    sbi_free(planner->allocator, planner->place);
    sbi_free(planner->allocator, planner->mixed_columns);
    sbi_free(planner->allocator, planner->now);
    sbi_free(planner->allocator, planner->moved);
    sbi_free(planner->allocator, planner->follows);
    sbi_free(planner->allocator, planner->gathers);
}

/* 1: row i has as many parents as it had, and the same shares of them. */
static int sbi_mg_has_shares(const sbi_mg_planner *planner, const sbi_mg_level *fine, int i)
{
    const sbi_mg_level *old = planner->old;
    int was = planner->match->was[i], count = fine->parent_start[i + 1] - fine->parent_start[i];
    return was >= 0 && count == old->parent_start[was + 1] - old->parent_start[was] &&
           memcmp(fine->shares + fine->parent_start[i], old->shares + old->parent_start[was],
                  (size_t)count * sizeof(float)) == 0;
}

/* Which coarse nodes were which: what the first of a node's children says. */
static void sbi_mg_match_parents(sbi_mg_planner *planner, const sbi_mg_level *fine)
{
    const sbi_mg_level *old = planner->old;
    int *was = planner->next.was, *now = planner->now;
    for (int b = 0; b < old[1].row_count; b++)
        now[b] = -1;
    for (int i = 0; i < fine->row_count; i++) {
        const int *parents = fine->parents + fine->parent_start[i], *before;
        int count = fine->parent_start[i + 1] - fine->parent_start[i];
        planner->follows[i] = (unsigned char)sbi_mg_has_shares(planner, fine, i);
        if (!planner->follows[i])
            continue;
        before = old->parents + old->parent_start[planner->match->was[i]];
        for (int k = 0; k < count; k++)
            if (was[parents[k]] < 0 && now[before[k]] < 0) {
                was[parents[k]] = before[k];
                now[before[k]] = parents[k];
            }
    }
    for (int i = 0; i < fine->row_count; i++)
        for (int k = fine->parent_start[i]; k < fine->parent_start[i + 1] && planner->follows[i]; k++) {
            int shift = k - fine->parent_start[i];
            planner->follows[i] =
                was[fine->parents[k]] == old->parents[old->parent_start[planner->match->was[i]] + shift];
        }
}

/* A row of A P is as it was when the row of A has the columns it had, itself among them, and all these their parents.
 */
static void sbi_mg_match_mixed(sbi_mg_planner *planner, const sbi_mg_level *fine)
{
    memcpy(planner->mixes, planner->match->same, (size_t)fine->row_count);
    for (int i = 0; i < fine->row_count; i++)
        for (int q = fine->row_start[i]; q < fine->row_start[i + 1] && !planner->follows[i]; q++)
            planner->mixes[fine->columns[q]] = 0; /* the pattern is symmetric */
}

static int sbi_mg_has_children(const sbi_mg_planner *planner, const sbi_mg_level *fine, int a)
{
    const sbi_mg_level *old = planner->old;
    int was = planner->next.was[a], first = fine->child_start[a], count = fine->child_start[a + 1] - first, alike;
    alike = was >= 0 && count == old->child_start[was + 1] - old->child_start[was];
    for (int k = 0; k < count && alike; k++) {
        int i = fine->children[first + k];
        alike = planner->mixes[i] && planner->match->was[i] == old->children[old->child_start[was] + k];
    }
    return alike;
}

static void sbi_mg_match_plans(sbi_mg_planner *planner, const sbi_mg_level *fine)
{
    if (!planner->old)
        return;
    sbi_mg_match_parents(planner, fine);
    sbi_mg_match_mixed(planner, fine);
    for (int a = 0; a < planner->coarse_count; a++)
        planner->gathers[a] = (unsigned char)sbi_mg_has_children(planner, fine, a);
}

/* ---- rows of A P --------------------------------------------------------------------------------------- */

/* Where the next row of A P goes. */
typedef struct sbi_mg_mixed_end {
    int block, slot;
} sbi_mg_mixed_end;

/* A row of A P that is as it was. */
static void sbi_mg_copy_mixed(const sbi_mg_planner *planner, const sbi_mg_level *level, int i, sbi_mg_mixed_end *end)
{
    const sbi_mg_level *old = planner->old;
    int was = planner->match->was[i], slots = old->slot_start[was + 1] - old->slot_start[was];
    memcpy(level->slots + end->slot, old->slots + old->slot_start[was], (size_t)slots * sizeof(int));
    for (int s = old->mixed_start[was]; s < old->mixed_start[was + 1]; s++) {
        planner->mixed_columns[end->block] = planner->now[old->mixed_columns[s]];
        planner->moved[s] = end->block++;
    }
    end->slot += slots;
}

/* Every block of A has a place in its row of A P for each parent of its column. */
static void sbi_mg_walk_mixed_row(const sbi_mg_planner *planner, const sbi_mg_level *level, int i,
                                  sbi_mg_mixed_end *end)
{
    int first = end->block, total = first, slot = end->slot, *place = planner->place, *slots = level->slots;
    for (int q = level->row_start[i]; q < level->row_start[i + 1]; q++) {
        int j = level->columns[q];
        for (int k = level->parent_start[j]; k < level->parent_start[j + 1]; k++) {
            int a = level->parents[k];
            if (place[a] < first) {
                planner->mixed_columns[total] = a;
                place[a] = total++;
            }
            slots[slot++] = place[a] - first;
        }
    }
    end->block = total;
    end->slot = slot;
}

/* Writes the slots and the columns; returns the number of blocks. */
static int sbi_mg_walk_mixed(const sbi_mg_planner *planner, sbi_mg_level *level)
{
    sbi_mg_mixed_end end = {0, 0};
    for (int a = 0; a < planner->coarse_count; a++)
        planner->place[a] = -1;
    for (int i = 0; i < level->row_count; i++) {
        level->mixed_start[i] = end.block;
        level->slot_start[i] = end.slot;
        if (planner->mixes && planner->mixes[i])
            sbi_mg_copy_mixed(planner, level, i, &end);
        else
            sbi_mg_walk_mixed_row(planner, level, i, &end);
    }
    level->mixed_start[level->row_count] = end.block;
    level->slot_start[level->row_count] = end.slot;
    return end.block;
}

static size_t sbi_mg_count_slots(const sbi_mg_planner *planner, const sbi_mg_level *level)
{
    size_t slots = 0;
    for (int i = 0; i < level->row_count; i++) {
        int was = planner->mixes && planner->mixes[i] ? planner->match->was[i] : -1;
        if (was >= 0)
            slots += (size_t)(planner->old->slot_start[was + 1] - planner->old->slot_start[was]);
        for (int q = level->row_start[i]; q < level->row_start[i + 1] && was < 0; q++)
            slots += (size_t)(level->parent_start[level->columns[q] + 1] - level->parent_start[level->columns[q]]);
    }
    return slots;
}

static int sbi_mg_plan_mixed(sbi_multigrid *m, sbi_mg_planner *planner, sbi_mg_level *level)
{
    size_t rows = (size_t)level->row_count, slots = sbi_mg_count_slots(planner, level), mixed;
    if (slots >= INT_MAX)
        return 0;
    level->mixed_start = sbi_owned_take_ints(&m->owned, rows + 1);
    level->slot_start = sbi_owned_take_ints(&m->owned, rows + 1);
    level->slots = sbi_owned_take_ints(&m->owned, slots);
    planner->mixed_columns = (int *)sbi_alloc(planner->allocator, slots, sizeof(int)); /* blocks are slots at most */
    if (!level->mixed_start || !level->slot_start || !level->slots || !planner->mixed_columns)
        return 0;
    mixed = (size_t)sbi_mg_walk_mixed(planner, level);
    level->mixed = sbi_owned_take_unset_floats(&m->owned, mixed, 9);
    level->mixed_columns = sbi_owned_take_ints(&m->owned, mixed);
    if (!level->mixed || !level->mixed_columns)
        return 0;
    memcpy(level->mixed_columns, planner->mixed_columns, mixed * sizeof(int));
    return 1;
}

/* ---- rows of P^T (A P) --------------------------------------------------------------------------------- */

/* A row of P^T A P in the making: its columns in any order. Without a list: they are only counted. */
static int sbi_mg_walk_coarse_row(const sbi_mg_planner *planner, const sbi_mg_level *fine, int a, int *fill,
                                  int *columns)
{
    int count = 1, *seen = planner->place;
    seen[a] = a;
    if (columns)
        columns[fill[a]++] = a;
    for (int c = fine->child_start[a]; c < fine->child_start[a + 1]; c++) {
        int i = fine->children[c];
        for (int s = fine->mixed_start[i]; s < fine->mixed_start[i + 1]; s++) {
            int b = planner->mixed_columns[s];
            if (seen[b] == a)
                continue;
            seen[b] = a;
            count++;
            if (columns)
                columns[fill[b]++] = a;
        }
    }
    return count;
}

/* The same of a row that has the columns it had. */
static int sbi_mg_copy_coarse_row(const sbi_mg_planner *planner, int a, int *fill, int *columns)
{
    const sbi_mg_level *old = planner->old + 1;
    int was = planner->next.was[a], first = old->row_start[was], last = old->row_start[was + 1];
    for (int q = first; q < last && columns; q++)
        columns[fill[planner->now[old->columns[q]]]++] = a;
    return last - first;
}

/* Visits the columns of each row of P^T A P once, the row itself included. Without columns: counts them in fill[row].
 * With columns: appends the row's number to the rows of its columns; the pattern is symmetric, so that these are the
 * rows wanted, ascending. Returns the number of blocks. */
static size_t sbi_mg_walk_coarse(const sbi_mg_planner *planner, const sbi_mg_level *fine, int *fill, int *columns)
{
    size_t total = 0;
    for (int a = 0; a < planner->coarse_count; a++)
        planner->place[a] = -1;
    for (int a = 0; a < planner->coarse_count; a++) {
        int count;
        if (planner->gathers && planner->gathers[a])
            count = sbi_mg_copy_coarse_row(planner, a, fill, columns);
        else
            count = sbi_mg_walk_coarse_row(planner, fine, a, fill, columns);
        if (!columns)
            fill[a] = count;
        total += (size_t)count;
    }
    return total;
}

static int sbi_mg_plan_coarse(sbi_multigrid *m, const sbi_mg_planner *planner, const sbi_mg_level *fine,
                              sbi_mg_level *coarse)
{
    size_t rows = (size_t)planner->coarse_count, blocks;
    coarse->row_count = planner->coarse_count;
    coarse->row_start = sbi_owned_take_ints(&m->owned, rows + 1);
    coarse->diagonal = sbi_owned_take_ints(&m->owned, rows);
    if (!coarse->row_start || !coarse->diagonal)
        return 0;
    coarse->row_start[0] = 0;
    blocks = sbi_mg_walk_coarse(planner, fine, coarse->row_start + 1, NULL);
    if (blocks > INT_MAX)
        return 0;
    coarse->block_count = (int)blocks;
    coarse->columns = sbi_owned_take_ints(&m->owned, blocks);
    if (!coarse->columns)
        return 0;
    for (size_t a = 0; a < rows; a++)
        coarse->row_start[a + 1] += coarse->row_start[a];
    memcpy(coarse->diagonal, coarse->row_start, rows * sizeof(int));
    sbi_mg_walk_coarse(planner, fine, coarse->diagonal, coarse->columns);
    for (int a = 0; a < coarse->row_count; a++)
        for (int q = coarse->row_start[a]; q < coarse->row_start[a + 1]; q++)
            if (coarse->columns[q] == a)
                coarse->diagonal[a] = q;
    return sbi_mg_take_values(m, coarse);
}

/* Visits what is summed up in the blocks of row a from its diagonal on: counts it in next[block], or lists it there. */
static void sbi_mg_walk_sums_row(const sbi_mg_planner *planner, const sbi_mg_level *fine, const sbi_mg_level *coarse,
                                 int a, size_t *next, int lists)
{
    int *place = planner->place;
    for (int q = coarse->row_start[a]; q < coarse->row_start[a + 1]; q++)
        place[coarse->columns[q]] = q < coarse->diagonal[a] ? -1 : q;
    for (int c = fine->child_start[a]; c < fine->child_start[a + 1]; c++) {
        int i = fine->children[c];
        for (int s = fine->mixed_start[i]; s < fine->mixed_start[i + 1]; s++) {
            int q = place[planner->mixed_columns[s]];
            if (q < 0)
                continue;
            if (lists) {
                fine->sum_blocks[next[q]] = s;
                fine->sum_shares[next[q]] = fine->child_shares[c];
            }
            next[q]++;
        }
    }
}

/* The same of a row whose sums are those it had. */
static void sbi_mg_copy_sums_row(const sbi_mg_planner *planner, const sbi_mg_level *fine, const sbi_mg_level *coarse,
                                 int a, size_t *next, int lists)
{
    const sbi_mg_level *old = planner->old;
    int was = planner->next.was[a], before = old[1].diagonal[was];
    size_t first = old->sum_start[before], count = old->sum_start[old[1].row_start[was + 1]] - first;
    if (lists) {
        size_t to = next[coarse->diagonal[a]];
        memcpy(fine->sum_shares + to, old->sum_shares + first, count * sizeof(float));
        for (size_t e = 0; e < count; e++)
            fine->sum_blocks[to + e] = planner->moved[old->sum_blocks[first + e]];
    }
    for (int q = coarse->diagonal[a]; q < coarse->row_start[a + 1]; q++, before++)
        next[q] += old->sum_start[before + 1] - old->sum_start[before];
}

/* Visits what is summed up in blocks on and above the diagonal of P^T (A P), row by row. */
static void sbi_mg_walk_sums(const sbi_mg_planner *planner, const sbi_mg_level *fine, const sbi_mg_level *coarse,
                             size_t *next, int lists)
{
    for (int a = 0; a < coarse->row_count; a++)
        if (planner->gathers && planner->gathers[a] && planner->next.same[a])
            sbi_mg_copy_sums_row(planner, fine, coarse, a, next, lists);
        else
            sbi_mg_walk_sums_row(planner, fine, coarse, a, next, lists);
}

/* twins of the blocks below the diagonal: rows are visited in order, and so are the columns of each row's twins. */
static void sbi_mg_find_twins(const sbi_mg_planner *planner, const sbi_mg_level *coarse, int *twins)
{
    int *next = planner->place;
    memcpy(next, coarse->diagonal, (size_t)coarse->row_count * sizeof(int));
    for (int a = 0; a < coarse->row_count; a++)
        for (int q = coarse->row_start[a]; q < coarse->diagonal[a]; q++)
            twins[q] = ++next[coarse->columns[q]];
}

/* How P^T (A P) is made of A P. */
static int sbi_mg_plan_sums(sbi_multigrid *m, const sbi_mg_planner *planner, sbi_mg_level *fine,
                            const sbi_mg_level *coarse)
{
    size_t blocks = (size_t)coarse->block_count,
           *start = (size_t *)sbi_owned_take(&m->owned, blocks + 2, sizeof(size_t)), total;
    fine->twins = sbi_owned_take_ints(&m->owned, blocks);
    if (!start || !fine->twins)
        return 0;
    memset(start, 0, (blocks + 2) * sizeof *start);
    sbi_mg_walk_sums(planner, fine, coarse, start + 2, 0);
    for (size_t q = 2; q < blocks + 2; q++)
        start[q] += start[q - 1];
    total = start[blocks + 1];
    fine->sum_start = start;
    fine->sum_blocks = sbi_owned_take_ints(&m->owned, total + SBI_MG_BLOCKS_AHEAD);
    fine->sum_shares = sbi_owned_take_unset_floats(&m->owned, total, 1);
    if (!fine->sum_blocks || !fine->sum_shares)
        return 0;
    memset(fine->sum_blocks + total, 0, SBI_MG_BLOCKS_AHEAD * sizeof(int));
    sbi_mg_walk_sums(planner, fine, coarse, start + 1, 1); /* start[q + 1] ends as the end of block q */
    sbi_mg_find_twins(planner, coarse, fine->twins);
    return 1;
}

/* ---- a level ------------------------------------------------------------------------------------------- */

SBI_API int sbi_mg_add_level(sbi_multigrid *m, const sbi_mg_rows *rows, sbi_mg_match *match)
{
    sbi_mg_level *fine = m->levels + m->level_count - 1, *coarse = fine + 1;
    sbi_mg_planner planner;
    int made;
    memset(&planner, 0, sizeof planner);
    planner.allocator = &m->owned.allocator;
    planner.coarse_count = rows->coarse_count;
    planner.place = (int *)sbi_alloc(&m->owned.allocator, (size_t)rows->coarse_count, sizeof(int));
    made = planner.place && sbi_mg_take_parents(m, rows, fine) && sbi_mg_take_old(&planner, fine, match);
    if (made)
        sbi_mg_match_plans(&planner, fine);
    made = made && sbi_mg_plan_mixed(m, &planner, fine) && sbi_mg_plan_coarse(m, &planner, fine, coarse);
    if (made)
        sbi_mg_match_columns(coarse, &planner.next);
    made = made && sbi_mg_plan_sums(m, &planner, fine, coarse);
    if (made) { /* on to the coarser level */
        sbi_mg_match before = *match;
        *match = planner.next;
        planner.next = before;
    }
    sbi_mg_free_planner(&planner);
    m->level_count += made;
    return made;
}
