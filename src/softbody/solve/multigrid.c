/* multigrid: levels. */
#include "multigrid_level.h"
#include "sparse_live.h"

#include <limits.h>
#include <math.h>
#include <string.h>

/* Edges of a level over those of the one above, and of thin stiff regions. */
#define SBI_MG_RATIO 2.0
#define SBI_MG_THIN_RATIO 1.4
/* Poisson's ratio from which smoothers take a step more: below, that costs more than the iterations it saves. */
#define SBI_MG_WIDE 0.4799 /* 0.48, however it was rounded */

enum {
    SBI_MG_DEGREE = 3,      /* of smoothers: 2 takes half as many iterations again, 1 over twice as many at nu 0.49 */
    SBI_MG_DEGREE_ONCE = 4, /* and of coarser levels that are visited once: */
    SBI_MG_ONCE = 1000,     /* level 1 from so many rows on. Smaller bodies at rest take 9 iterations for 7 by it */
    SBI_MG_REGIONS = 16,    /* that a level can have, */
    SBI_MG_ROWS_OF_REGION = 16 /* and one more for so many of its rows: they take four coarse nodes each at least */
};

/* ---- memory -------------------------------------------------------------------------------------------- */

SBI_API void sbi_multigrid_free(sbi_multigrid *multigrid)
{
    sb_allocator allocator;
    if (!multigrid)
        return;
    allocator = multigrid->owned.allocator;
    sbi_mg_regions_free(&allocator, &multigrid->regions);
    sbi_mg_free_islands(&multigrid->islands);
    sb_direct_free(multigrid->direct);
    sb_matrix_free(&multigrid->coarsest);
    sbi_owned_free(&multigrid->owned);
    sbi_free(&allocator, multigrid);
}

SBI_API void sbi_multigrid_set_poisson(sbi_multigrid *multigrid, double poisson)
{
    multigrid->wide = poisson >= SBI_MG_WIDE;
}

SBI_API int sbi_multigrid_couples_parts(const sbi_multigrid *multigrid) { return multigrid->couples_parts; }
SBI_API int sbi_multigrid_levels(const sbi_multigrid *multigrid) { return multigrid->level_count; }
SBI_API size_t sbi_multigrid_bytes(const sbi_multigrid *multigrid) { return multigrid->owned.bytes; }

/* ---- one level ----------------------------------------------------------------------------------------- */

static int sbi_mg_copy_pattern(sbi_multigrid *m, const sb_matrix *pattern, sbi_mg_level *level)
{
    size_t rows = (size_t)pattern->row_count, blocks = (size_t)sbi_matrix_used_blocks(pattern);
    int end = 0;
    level->row_count = pattern->row_count;
    level->block_count = (int)blocks;
    level->row_start = sbi_owned_take_ints(&m->owned, rows + 1);
    level->columns = sbi_owned_take_ints(&m->owned, blocks);
    level->diagonal = sbi_owned_take_ints(&m->owned, rows);
    if (!level->row_start || !level->columns || !level->diagonal)
        return 0;
    level->row_start[0] = 0;
    for (int i = 0; i < level->row_count; i++) { /* without the gaps that rows of a live matrix have between them */
        int length = pattern->row_end[i] - pattern->row_start[i];
        memcpy(level->columns + end, pattern->columns + pattern->row_start[i], (size_t)length * sizeof(int));
        level->diagonal[i] = end + pattern->diagonal[i] - pattern->row_start[i];
        level->row_start[i + 1] = end += length;
        m->longest_row = sbi_max_int(m->longest_row, length);
    }
    return sbi_mg_take_values(m, level);
}

/* ---- levels of the user -------------------------------------------------------------------------------- */

static sb_result sbi_mg_check_level(const sb_multigrid_level *own, int index, int rows, sb_error *error)
{
    const sb_mapping *mapping = &own->mapping;
    int entries;
    if (own->node_count < 1 || !own->positions || !mapping->row_start || !mapping->nodes || !mapping->weights ||
        mapping->row_count != rows)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "level %d: needs nodes, positions and a mapping of %d rows", index,
                        rows);
    if (mapping->row_start[0] != 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "level %d: rows start at %d, not at 0", index, mapping->row_start[0]);
    for (int i = 0; i < rows; i++)
        if (mapping->row_start[i + 1] < mapping->row_start[i])
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "level %d: row %d ends before it starts", index, i);
    entries = mapping->row_start[rows];
    for (int e = 0; e < entries; e++) {
        if (mapping->nodes[e] < 0 || mapping->nodes[e] >= own->node_count)
            return sbi_fail_node(error, SB_ERROR_INDEX, mapping->nodes[e], "level %d: node %d is outside 0 to %d",
                                 index, mapping->nodes[e], own->node_count - 1);
        if (!sb_is_finite(mapping->weights[e]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, mapping->nodes[e],
                                 "level %d: a weight of node %d is not finite", index, mapping->nodes[e]);
    }
    for (int a = 0; a < own->node_count; a++)
        if (!sb_v3_is_finite(own->positions[a]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, a, "level %d: node %d: position is not finite", index, a);
    return SB_OK;
}

/* Takes over a row of a mapping but for weights below a hundred-thousandth of its largest: a coarse node that hangs on
 * such weights only has a stiffness that single precision may not hold. Returns the number of entries. */
static int sbi_mg_copy_row(const sb_mapping *mapping, int row, int *nodes, float *weights)
{
    double largest = 0;
    int count = 0;
    for (int e = mapping->row_start[row]; e < mapping->row_start[row + 1]; e++)
        largest = fabs((double)mapping->weights[e]) > largest ? fabs((double)mapping->weights[e]) : largest;
    for (int e = mapping->row_start[row]; e < mapping->row_start[row + 1]; e++)
        if (fabs((double)mapping->weights[e]) >= 1e-5 * largest) {
            nodes[count] = mapping->nodes[e];
            weights[count++] = (float)mapping->weights[e];
        }
    return count;
}

static int sbi_mg_copy_level(const sb_multigrid_level *own, const sb_allocator *allocator, sbi_mg_rows *rows)
{
    const sb_mapping *mapping = &own->mapping;
    size_t n = (size_t)mapping->row_count, entries = (size_t)mapping->row_start[n];
    memset(rows, 0, sizeof *rows);
    rows->coarse_count = own->node_count;
    rows->start = (int *)sbi_alloc(allocator, n + 1, sizeof(int));
    rows->nodes = (int *)sbi_alloc(allocator, entries, sizeof(int));
    rows->weights = (float *)sbi_alloc(allocator, entries, sizeof(float));
    rows->positions = (sb_vec3 *)sbi_alloc(allocator, (size_t)own->node_count, sizeof(sb_vec3));
    if (!rows->start || !rows->nodes || !rows->weights || !rows->positions) {
        sbi_mg_rows_free(allocator, rows);
        return 0;
    }
    rows->start[0] = 0;
    for (int i = 0; i < mapping->row_count; i++)
        rows->start[i + 1] =
            rows->start[i] + sbi_mg_copy_row(mapping, i, rows->nodes + rows->start[i], rows->weights + rows->start[i]);
    memcpy(rows->positions, own->positions, (size_t)own->node_count * sizeof(sb_vec3));
    return 1;
}

/* The rows of a level of the user's that is in use. */
static int sbi_mg_copy_used(const sbi_mg_level *level, const sb_allocator *allocator, sbi_mg_rows *rows)
{
    const sbi_mg_level *coarse = level + 1;
    sb_multigrid_level own;
    size_t entries = (size_t)level->parent_start[level->row_count];
    sb_real *weights = (sb_real *)sbi_alloc(allocator, entries, sizeof(sb_real));
    int made;
    for (size_t e = 0; e < entries && weights; e++)
        weights[e] = (sb_real)level->shares[e];
    own.mapping.row_count = level->row_count;
    own.mapping.row_start = level->parent_start;
    own.mapping.nodes = level->parents;
    own.mapping.weights = weights;
    own.node_count = coarse->row_count;
    own.positions = coarse->positions;
    made = weights && sbi_mg_copy_level(&own, allocator, rows);
    sbi_free(allocator, weights);
    return made;
}

/* ---- creation ------------------------------------------------------------------------------------------ */

static sb_result sbi_mg_no_memory(const sbi_multigrid *m, sb_error *error)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the multigrid levels of %d rows", m->levels[0].row_count);
}

/* Finds the regions where moduli are given, or takes those of `like`. The user's levels stay as they are. */
static int sbi_mg_make_regions(sbi_multigrid *m, const sbi_multigrid_setup *setup, const sb_matrix *pattern)
{
    const sbi_multigrid *like = setup->like;
    int own = setup->level_count > 0 || (like && like->level_count > 1 && like->levels[1].positions), made = 1;
    if (setup->moduli && !own)
        made = sbi_mg_find_regions(pattern, setup->moduli, setup->positions, &m->owned.allocator, &m->regions);
    else if (like && like->regions.row_count == pattern->row_count)
        made = sbi_mg_copy_regions(&like->regions, &m->owned.allocator, &m->regions);
    m->owned.bytes +=
        (size_t)m->regions.row_count * sizeof(int) + (size_t)m->regions.count * (sizeof(sb_real) + sizeof(int));
    return made;
}

/* What lattices of later levels like this one want to know of its nodes. 0: no memory. */
static int sbi_mg_take_places(sbi_multigrid *m, sbi_mg_level *level, const sb_vec3 *positions)
{
    size_t rows = (size_t)level->row_count;
    level->places = (sb_vec3 *)sbi_owned_take(&m->owned, rows, sizeof(sb_vec3));
    level->spacings = (double *)sbi_owned_take(&m->owned, rows, sizeof(double));
    level->lattice = (sbi_cubes *)sbi_owned_take(&m->owned, 1, sizeof(sbi_cubes));
    if (!level->places || !level->spacings || !level->lattice)
        return 0;
    memcpy(level->places, positions, rows * sizeof(sb_vec3));
    return 1;
}

/* Rows from a lattice; none when that would not be much smaller. Regions reduce a level less, and are given up where
 * they hardly do: they must not keep the coarsest level from being small. */
static int sbi_mg_lay_lattice(sbi_multigrid *m, const sb_vec3 *positions, const sbi_mg_match *match, int *labels,
                              sbi_mg_rows *rows)
{
    sbi_mg_level *level = m->levels + m->level_count - 1;
    sbi_mg_nodes nodes;
    int made = 1, count = level->row_count;
    nodes.level = level;
    nodes.match = match;
    nodes.spacings = NULL;
    nodes.lattice = NULL;
    nodes.positions = positions;
    nodes.regions = &m->regions;
    nodes.labels = labels;
    if (labels) {
        made = sbi_mg_limit_regions(level, &m->regions, SBI_MG_REGIONS + count / SBI_MG_ROWS_OF_REGION,
                                    &m->owned.allocator, labels) &&
               sbi_mg_lattice(&nodes, SBI_MG_RATIO, SBI_MG_THIN_RATIO, &m->owned.allocator, rows);
        if (!made || rows->coarse_count <= count - count / 8)
            return made;
        sbi_mg_rows_free(&m->owned.allocator, rows);
        if (count <= 2 * m->small)
            return 1;
        nodes.labels = NULL;
    }
    if (!sbi_mg_take_places(m, level, positions))
        return 0;
    nodes.spacings = level->spacings;
    nodes.lattice = level->lattice;
    made = sbi_mg_lattice(&nodes, SBI_MG_RATIO, SBI_MG_RATIO, &m->owned.allocator, rows);
    if (made && rows->coarse_count > count / 2)
        sbi_mg_rows_free(&m->owned.allocator, rows);
    return made;
}

/* Rows from the last level to the next: the user's, or from a lattice; none (rows->start NULL) when that would not be
 * much smaller. `last` are those that made the last level, or zero. */
static sb_result sbi_mg_make_rows(sbi_multigrid *m, const sbi_multigrid_setup *setup, const sbi_mg_rows *last,
                                  const sbi_mg_match *match, sbi_mg_rows *rows, sb_error *error)
{
    const sbi_mg_level *level = m->levels + m->level_count - 1;
    int own = m->level_count - 1, made;
    memset(rows, 0, sizeof *rows);
    if (own < setup->level_count) {
        sb_result result = sbi_mg_check_level(setup->levels + own, own, level->row_count, error);
        if (result != SB_OK)
            return result;
        made = sbi_mg_copy_level(setup->levels + own, &m->owned.allocator, rows);
    } else if (setup->like && own + 1 < setup->like->level_count && setup->like->levels[own + 1].positions) {
        made = sbi_mg_copy_used(setup->like->levels + own, &m->owned.allocator, rows);
    } else {
        if (own > 0 && level->row_count <= m->small)
            return SB_OK;
        made = sbi_mg_lay_lattice(m, last->positions ? last->positions : setup->positions, match, last->labels, rows);
    }
    return made ? SB_OK : sbi_mg_no_memory(m, error);
}

/* What later levels like the one just made want to know of its nodes. 0: no memory. */
static int sbi_mg_keep_points(sbi_multigrid *m, const sbi_mg_rows *rows)
{
    sbi_mg_level *level = m->levels + m->level_count - 1;
    if (!rows->points)
        return 1;
    level->points = (int64_t *)sbi_owned_take(&m->owned, (size_t)level->row_count, sizeof(int64_t));
    if (level->points)
        memcpy(level->points, rows->points, (size_t)level->row_count * sizeof(int64_t));
    return level->points != NULL;
}

/* 1: the level just made is one of the user's; its positions are kept, so that it can be used again. */
static int sbi_mg_keep_positions(sbi_multigrid *m, const sbi_multigrid_setup *setup, const sbi_mg_rows *rows)
{
    int index = m->level_count - 1;
    sbi_mg_level *level = m->levels + index;
    if (index > setup->level_count &&
        !(setup->like && index < setup->like->level_count && setup->like->levels[index].positions))
        return 1;
    level->positions = (sb_vec3 *)sbi_owned_take(&m->owned, (size_t)level->row_count, sizeof(sb_vec3));
    if (level->positions)
        memcpy(level->positions, rows->positions, (size_t)level->row_count * sizeof(sb_vec3));
    return level->positions != NULL;
}

/* Coarser levels until one is small enough, or does not get smaller. */
static sb_result sbi_mg_coarsen(sbi_multigrid *m, const sbi_multigrid_setup *setup, sb_error *error)
{
    sbi_mg_rows rows, last;
    sbi_mg_match match;
    sb_result result = SB_OK;
    memset(&last, 0, sizeof last);
    if (m->regions.count) {
        last.labels = (int *)sbi_alloc(&m->owned.allocator, (size_t)m->regions.row_count, sizeof(int));
        if (!last.labels)
            return sbi_mg_no_memory(m, error);
        memcpy(last.labels, m->regions.of, (size_t)m->regions.row_count * sizeof(int));
    }
    if (!sbi_mg_match_finest(m, setup->like, &match))
        result = sbi_mg_no_memory(m, error);
    while (result == SB_OK && m->level_count < SBI_MG_MAX_LEVELS) {
        int dear = 0;
        result = sbi_mg_make_rows(m, setup, &last, &match, &rows, error);
        if (result == SB_OK && !rows.start && !sbi_mg_weigh_coarsest(m, &dear))
            result = sbi_mg_no_memory(m, error);
        if (dear)
            continue;
        if (!rows.start)
            break;
        sbi_mg_rows_free(&m->owned.allocator, &last);
        last = rows;
        if (!sbi_mg_add_level(m, &rows, &match) || !sbi_mg_keep_positions(m, setup, &rows) ||
            !sbi_mg_keep_points(m, &rows))
            result = sbi_mg_no_memory(m, error);
    }
    sbi_mg_rows_free(&m->owned.allocator, &last);
    sbi_mg_free_match(&m->owned.allocator, &match);
    return result;
}

/* 1 when all children of each node of the next level are of one part; turns the parts of rows into those of its
 * nodes. */
static int sbi_mg_lower_parts(const sbi_mg_level *level, int coarse_count, int *part_of, int *next)
{
    for (int a = 0; a < coarse_count; a++) {
        next[a] = -1;
        for (int c = level->child_start[a]; c < level->child_start[a + 1]; c++) {
            int part = part_of[level->children[c]];
            if (next[a] >= 0 && next[a] != part)
                return 0;
            next[a] = part;
        }
    }
    memcpy(part_of, next, (size_t)coarse_count * sizeof(int));
    return 1;
}

/* Whether the user's levels couple parts. 0: no memory. */
static int sbi_mg_watch_parts(sbi_multigrid *m, const sb_matrix *pattern)
{
    size_t most = 0;
    int *part_of, made;
    for (int l = 0; l < m->level_count; l++)
        most += (size_t)m->levels[l].row_count;
    if (pattern->part_count < 2 || m->level_count < 2 || !m->levels[1].positions)
        return 1;
    part_of = (int *)sbi_alloc(&m->owned.allocator, 2 * most, sizeof(int));
    sbi_matrix_list_parts(pattern);
    for (int c = 0; part_of && c < pattern->part_count; c++)
        for (int k = pattern->part_start[c]; k < pattern->part_start[c + 1]; k++)
            part_of[pattern->part_rows[k]] = c;
    for (int l = 0; part_of && l + 1 < m->level_count && m->levels[l + 1].positions && !m->couples_parts; l++)
        m->couples_parts = !sbi_mg_lower_parts(m->levels + l, m->levels[l + 1].row_count, part_of, part_of + most);
    made = part_of != NULL;
    sbi_free(&m->owned.allocator, part_of);
    return made;
}

/* Coarser levels go through their cycle twice, as long as all visits to a level take no more rows than the finest has,
 * else levels that hardly shrink cost 2^levels: visited once, all of them take 40 % more iterations at 300,000 unknowns
 * than at 5,000. Level 1 of a large body would take a third of all time by that, and one step more of its smoother does
 * nearly as much (6 and 15 iterations for 6 and 14 to 1e-2 and 1e-6, a tenth less time; plates and rods 15 to 24 % more
 * to 1e-6), but not where moduli jump (11 for 9) or no factor ends the levels. */
static void sbi_mg_plan_cycle(sbi_multigrid *m)
{
    double visits = 1;
    for (int l = 1; l < m->level_count; l++) {
        sbi_mg_level *level = m->levels + l;
        int large = l == 1 && m->factor && level->row_count >= SBI_MG_ONCE;
        level->twice = !large && 2 * visits * level->row_count <= m->levels[0].row_count;
        level->degree = level->twice ? SBI_MG_DEGREE : SBI_MG_DEGREE_ONCE;
        visits *= 1 + level->twice;
    }
    m->levels[0].degree = SBI_MG_DEGREE;
}

SBI_API sb_result sbi_multigrid_create(const sbi_multigrid_setup *setup, const sb_matrix *pattern,
                                       const sb_allocator *allocator, sbi_multigrid **out, sb_error *error)
{
    sbi_multigrid *m = (sbi_multigrid *)sbi_alloc_zeroed(allocator, 1, sizeof *m);
    sb_result result = SB_OK;
    if (!m)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a multigrid");
    if (allocator)
        m->owned.allocator = *allocator;
    m->jobs = setup->jobs;
    m->owned.bytes = sizeof *m;
    m->level_count = 1;
    m->levels[0].row_count = pattern->row_count;
    m->wide = setup->like && setup->like->wide;
    if (!sbi_mg_make_regions(m, setup, pattern) || !sbi_mg_copy_pattern(m, pattern, m->levels) ||
        !sbi_mg_take_islands(m))
        result = sbi_mg_no_memory(m, error);
    m->small = m->regions.count ? SBI_MG_SPARSE : SBI_MG_DENSE;
    if (result == SB_OK)
        result = sbi_mg_coarsen(m, setup, error);
    if (result == SB_OK && (!sbi_mg_take_coarsest(m) || !sbi_mg_watch_parts(m, pattern)))
        result = sbi_mg_no_memory(m, error);
    if (result != SB_OK) {
        sbi_multigrid_free(m);
        return result;
    }
    sbi_mg_plan_cycle(m);
    *out = m;
    return SB_OK;
}
