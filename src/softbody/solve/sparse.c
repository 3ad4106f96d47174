/* sparse: pattern from cells, block products, constraints. */
#include "sparse_live.h"
#include "../base/lanes.h"

#include <limits.h>
#include <math.h>
#include <string.h>

/* ---- pattern ------------------------------------------------------------------------------------------- */

/* The cells as the caller gave them, fixed size or lists. */
typedef struct sbi_sparse_cells {
    int node_count, cell_count, nodes_per_cell;
    const int *start, *nodes;
} sbi_sparse_cells;

/* Scratch: the cells of each node as lists, and the node that last marked a node as its neighbour. */
typedef struct sbi_sparse_scratch {
    size_t *node_start; /* [node_count + 1] */
    int *node_cells;
    int *marker; /* [node_count] */
} sbi_sparse_scratch;

static size_t sbi_sparse_cell_begin(const sbi_sparse_cells *cells, int cell)
{
    return cells->start ? (size_t)cells->start[cell] : (size_t)cell * (size_t)cells->nodes_per_cell;
}

static sb_result sbi_sparse_check(const sbi_sparse_cells *cells, sb_error *error)
{
    if (cells->node_count < 1 || cells->cell_count < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a matrix needs node_count >= 1 and cell_count >= 0, not %d and %d",
                        cells->node_count, cells->cell_count);
    if (cells->cell_count && (!cells->nodes || (!cells->start && cells->nodes_per_cell < 1)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cells need node indices and a size");
    if (cells->start && cells->start[0] != 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cell_start begins with %d, not 0", cells->start[0]);
    for (int c = 0; cells->start && c < cells->cell_count; c++)
        if (cells->start[c + 1] < cells->start[c])
            return sbi_fail_element(error, SB_ERROR_ARGUMENT, c, "cell_start descends after cell %d", c);
    for (int c = 0; c < cells->cell_count; c++)
        for (size_t k = sbi_sparse_cell_begin(cells, c); k < sbi_sparse_cell_begin(cells, c + 1); k++)
            if (cells->nodes[k] < 0 || cells->nodes[k] >= cells->node_count)
                return sbi_fail_element(error, SB_ERROR_INDEX, c, "cell %d names node %d of %d", c, cells->nodes[k],
                                        cells->node_count);
    return SB_OK;
}

/* One allocation: node_start, node_cells, marker. */
static void *sbi_sparse_scratch_create(const sbi_sparse_cells *cells, const sb_allocator *allocator,
                                       sbi_sparse_scratch *scratch)
{
    size_t nodes = (size_t)cells->node_count, entries = sbi_sparse_cell_begin(cells, cells->cell_count), bytes = 0;
    char *memory;
    if (!sbi_size_add(&bytes, nodes + 1, sizeof(size_t)) || !sbi_size_add(&bytes, entries, sizeof(int)) ||
        !sbi_size_add(&bytes, nodes, sizeof(int)))
        return NULL;
    memory = (char *)sbi_alloc(allocator, bytes, 1);
    if (!memory)
        return NULL;
    scratch->node_start = (size_t *)(void *)memory;
    scratch->node_cells = (int *)(void *)(memory + (nodes + 1) * sizeof(size_t));
    scratch->marker = scratch->node_cells + entries;
    return memory;
}

/* Counting sort of the (node, cell) pairs by node. */
static void sbi_sparse_list_cells(const sbi_sparse_cells *cells, sbi_sparse_scratch *scratch)
{
    size_t entries = sbi_sparse_cell_begin(cells, cells->cell_count);
    memset(scratch->node_start, 0, ((size_t)cells->node_count + 1) * sizeof(size_t));
    for (size_t k = 0; k < entries; k++)
        scratch->node_start[cells->nodes[k] + 1]++;
    for (int i = 0; i < cells->node_count; i++)
        scratch->node_start[i + 1] += scratch->node_start[i];
    for (int c = cells->cell_count; c-- > 0;)
        for (size_t k = sbi_sparse_cell_begin(cells, c); k < sbi_sparse_cell_begin(cells, c + 1); k++)
            scratch->node_cells[--scratch->node_start[cells->nodes[k] + 1]] = c;
    /* filling moved each end to its beginning: entry i + 1 now holds the start of node i */
    for (int i = 0; i < cells->node_count; i++)
        scratch->node_start[i] = scratch->node_start[i + 1];
    scratch->node_start[cells->node_count] = entries;
}

/* Visits each neighbour of each node once (the node itself too). Without columns: counts into fill[node].
 * With columns: appends i to the row of every neighbour of i; i ascends, so the rows come out sorted, and
 * because the pattern is symmetric they are the rows wanted. */
static size_t sbi_sparse_visit(const sbi_sparse_cells *cells, const sbi_sparse_scratch *scratch, int *fill,
                               int *columns)
{
    size_t total = 0;
    for (int i = 0; i < cells->node_count; i++)
        scratch->marker[i] = -1;
    for (int i = 0; i < cells->node_count; i++) {
        size_t before = total;
        scratch->marker[i] = i;
        if (columns)
            columns[fill[i]++] = i;
        total++;
        for (size_t s = scratch->node_start[i]; s < scratch->node_start[i + 1]; s++) {
            int cell = scratch->node_cells[s];
            for (size_t k = sbi_sparse_cell_begin(cells, cell); k < sbi_sparse_cell_begin(cells, cell + 1); k++) {
                int j = cells->nodes[k];
                if (scratch->marker[j] == i)
                    continue;
                scratch->marker[j] = i;
                if (columns)
                    columns[fill[j]++] = i;
                total++;
            }
        }
        if (!columns && fill)
            fill[i] = (int)(total - before);
    }
    return total;
}

/* Carves the matrix's arrays out of one allocation; blocks first for their alignment. */
static int sbi_sparse_layout(sb_matrix *matrix, size_t rows, size_t blocks)
{
    size_t values = 0, bytes = 64;
    char *base;
    int *ints;
    if (!sbi_size_add(&values, blocks, 9 * sizeof(sb_real)) || !sbi_size_add(&values, 8, sizeof(sb_real)) ||
        !sbi_size_add(&bytes, values, 1) || !sbi_size_add(&bytes, 2 * blocks, sizeof(int)) ||
        !sbi_size_add(&bytes, 3 * rows + 1, sizeof(int)) ||
        !sbi_size_add(&bytes, (size_t)sbi_matrix_most_parts((int)rows) + 1, sizeof(int)) ||
        !sbi_size_add(&bytes, rows, 1))
        return 0;
    matrix->memory = sbi_alloc(&matrix->allocator, bytes, 1);
    if (!matrix->memory)
        return 0;
    base = (char *)matrix->memory;
    base += (64 - (uintptr_t)base % 64) % 64;
    matrix->blocks = (sb_real(*)[9])(void *)base;
    ints = (int *)(void *)(base + values);
    matrix->columns = ints;
    matrix->transpose = ints + blocks;
    matrix->row_start = ints + 2 * blocks;
    matrix->row_end = matrix->row_start + 1;
    matrix->diagonal = matrix->row_start + rows + 1;
    matrix->part_rows = matrix->diagonal + rows;
    matrix->part_start = matrix->part_rows + rows;
    matrix->fixed = (unsigned char *)(matrix->part_start + sbi_matrix_most_parts((int)rows) + 1);
    memset(matrix->blocks, 0, values);
    memset(matrix->fixed, 0, rows);
    return 1;
}

/* Positions of the diagonal and of the transposed blocks; `next` is scratch [row_count]. Rows ascend, so the
 * entries of row j are met in their own order. */
static void sbi_sparse_link(sb_matrix *matrix, int *next)
{
    memcpy(next, matrix->row_start, (size_t)matrix->row_count * sizeof(int));
    for (int i = 0; i < matrix->row_count; i++)
        for (int q = matrix->row_start[i]; q < matrix->row_end[i]; q++) {
            int j = matrix->columns[q];
            matrix->transpose[q] = next[j]++;
            if (j == i)
                matrix->diagonal[i] = q;
        }
}

/* Gives all rows that hang together with row i its part; part_rows is the queue. */
static void sbi_sparse_spread_part(const sb_matrix *matrix, int i, int part, int *part_of)
{
    int *queue = matrix->part_rows, count = 1;
    part_of[i] = part;
    queue[0] = i;
    for (int head = 0; head < count; head++)
        for (int q = matrix->row_start[queue[head]]; q < matrix->row_end[queue[head]]; q++) {
            int j = matrix->columns[q];
            if (part_of[j] >= 0)
                continue;
            part_of[j] = part;
            queue[count++] = j;
        }
}

SBI_API void sbi_sparse_find_parts(sb_matrix *matrix, int *part_of)
{
    int rows = matrix->row_count, alone = -1;
    for (int i = 0; i < rows; i++)
        part_of[i] = -1;
    matrix->part_count = 0;
    for (int i = 0; i < rows; i++) {
        int is_alone = matrix->row_end[i] - matrix->row_start[i] == 1;
        if (part_of[i] >= 0)
            continue;
        if (is_alone && alone >= 0) {
            part_of[i] = alone;
            continue;
        }
        alone = is_alone ? matrix->part_count : alone;
        sbi_sparse_spread_part(matrix, i, matrix->part_count++, part_of);
    }
    sbi_sparse_list_parts(matrix, part_of);
}

SBI_API void sbi_sparse_list_parts(const sb_matrix *matrix, const int *part_of)
{
    int rows = matrix->row_count;
    memset(matrix->part_start, 0, ((size_t)matrix->part_count + 1) * sizeof(int));
    for (int i = 0; i < rows; i++)
        matrix->part_start[part_of[i] + 1]++;
    for (int c = 0; c < matrix->part_count; c++)
        matrix->part_start[c + 1] += matrix->part_start[c];
    for (int i = 0; i < rows; i++)
        matrix->part_rows[matrix->part_start[part_of[i]]++] = i;
    for (int c = matrix->part_count; c > 0; c--)
        matrix->part_start[c] = matrix->part_start[c - 1];
    matrix->part_start[0] = 0;
}

static sb_result sbi_sparse_fill(const sbi_sparse_cells *cells, sbi_sparse_scratch *scratch, sb_matrix *matrix,
                                 sb_error *error)
{
    size_t total;
    sbi_sparse_list_cells(cells, scratch);
    total = sbi_sparse_visit(cells, scratch, NULL, NULL);
    if (total > INT_MAX || !sbi_sparse_layout(matrix, (size_t)cells->node_count, total))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a matrix of %d rows", cells->node_count);
    matrix->row_count = cells->node_count;
    matrix->block_count = (int)total;
    matrix->row_start[0] = 0;
    sbi_sparse_visit(cells, scratch, matrix->row_start + 1, NULL);
    for (int i = 0; i < matrix->row_count; i++)
        matrix->row_start[i + 1] += matrix->row_start[i];
    memcpy(matrix->diagonal, matrix->row_start, (size_t)matrix->row_count * sizeof(int));
    sbi_sparse_visit(cells, scratch, matrix->diagonal, matrix->columns);
    sbi_sparse_link(matrix, scratch->marker);
    sbi_sparse_find_parts(matrix, scratch->marker);
    return SB_OK;
}

SB_API sb_result sb_matrix_create(int node_count, int cell_count, int nodes_per_cell, const int *cell_start,
                                  const int *cells, const sb_allocator *allocator, sb_matrix *matrix, sb_error *error)
{
    sbi_sparse_cells input;
    sbi_sparse_scratch scratch;
    sb_matrix made;
    void *memory;
    sb_result result;
    if (!matrix)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_matrix_create needs a matrix");
    input.node_count = node_count;
    input.cell_count = cell_count;
    input.nodes_per_cell = nodes_per_cell;
    input.start = cell_start;
    input.nodes = cells;
    result = sbi_sparse_check(&input, error);
    if (result != SB_OK)
        return result;
    memory = sbi_sparse_scratch_create(&input, allocator, &scratch);
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the pattern of %d rows", node_count);
    memset(&made, 0, sizeof made);
    if (allocator)
        made.allocator = *allocator;
    result = sbi_sparse_fill(&input, &scratch, &made, error);
    sbi_free(allocator, memory);
    if (result == SB_OK)
        *matrix = made;
    return result;
}

static void sbi_matrix_free_live(sb_matrix *matrix)
{
    if (!matrix->live)
        return;
    sbi_free(&matrix->allocator, matrix->live->row_memory);
    sbi_free(&matrix->allocator, matrix->live->pool_memory);
    sbi_free(&matrix->allocator, matrix->live->keys);
    sbi_free(&matrix->allocator, matrix->live->pairs);
    sbi_free(&matrix->allocator, matrix->live);
    matrix->live = NULL;
}

SB_API void sb_matrix_free(sb_matrix *matrix)
{
    if (!matrix)
        return;
    sbi_matrix_free_live(matrix);
    sbi_free(&matrix->allocator, matrix->memory);
    memset(matrix, 0, sizeof *matrix);
}

SBI_API void sbi_matrix_set_free_row(sb_matrix *matrix, int i)
{
    sb_real *block = matrix->blocks[matrix->diagonal[i]];
    for (int k = 0; k < 9; k++)
        block[k] = (sb_real)(k % 4 == 0);
    matrix->fixed[i] = SB_XYZ;
}

SBI_API void sbi_matrix_set_free_rows(sb_matrix *matrix)
{
    for (int i = 0; matrix->live && i < matrix->row_count; i++)
        if (!matrix->live->in_use[i])
            sbi_matrix_set_free_row(matrix, i);
}

SB_API void sb_matrix_clear(sb_matrix *matrix)
{
    if (!matrix)
        return;
    memset(matrix->blocks, 0, (size_t)matrix->block_count * sizeof matrix->blocks[0]);
    memset(matrix->fixed, 0, (size_t)matrix->row_count);
    sbi_matrix_set_free_rows(matrix);
}

SB_API int sb_matrix_find(const sb_matrix *matrix, int i, int j)
{
    int place, length;
    if (!matrix)
        return 0;
    if (i < 0 || j < 0 || i >= matrix->row_count || j >= matrix->row_count)
        return -1;
    place = matrix->row_start[i];
    length = matrix->row_end[i] - place;
    while (length > 1) { /* halves without branches, which would be guessed wrong every other time */
        int half = length / 2;
        place += half & -(matrix->columns[place + half - 1] < j);
        length -= half;
    }
    place += length > 0 && matrix->columns[place] < j;
    return place < matrix->row_end[i] && matrix->columns[place] == j ? place : -1;
}

/* ---- products ------------------------------------------------------------------------------------------ */

enum {
    SBI_SPARSE_AHEAD = 1024,   /* bytes of blocks, */
    SBI_SPARSE_ROWS_AHEAD = 16 /* and diagonal blocks, asked for before they are read */
};

/* Blocks first <= q < last of a row of A times x: nine sums, one per place of the 3x3 blocks, added up at the end. They
 * are independent, so no sum waits for another, and all forms below give the same bits. */
#if SBI_HAS_LANES
/* A block's rows and the vector are read as 4-vectors. The fourth lane belongs to what comes next in memory
 * and is never summed; only the last node has nothing after it (`guard`). Three vector products instead of
 * nine, which compilers do not find by themselves. */
SBI_FORCE_INLINE void sbi_sparse_multiply_blocks(const sb_matrix *matrix, const sb_real *x, sb_real *y, int first,
                                                 int last, int guard)
{
    const int *column = matrix->columns + first, *end = matrix->columns + last;
    const sb_real *block = matrix->blocks[first];
    sbi_lanes s0 = {0, 0, 0, 0}, s1 = s0, s2 = s0;
    for (; column < end; column++, block += 9) {
        const sb_real *from = x + 3 * (size_t)*column;
        sbi_lanes v;
        if (guard) {
            sbi_lanes three = {from[0], from[1], from[2], 0};
            v = three;
        } else {
            v = SBI_LANES_AT(from);
        }
        SBI_PREFETCH(block, SBI_SPARSE_AHEAD);
        s0 += SBI_LANES_AT(block) * v;
        s1 += SBI_LANES_AT(block + 3) * v;
        s2 += SBI_LANES_AT(block + 6) * v;
    }
    y[0] = s0[0] + s0[1] + s0[2];
    y[1] = s1[0] + s1[1] + s1[2];
    y[2] = s2[0] + s2[1] + s2[2];
}
#elif SBI_HAS_PAIRS
/* The nine entries two by two, as they lie in memory. */
typedef struct sbi_sparse_sums {
    sbi_pair s00, s02, s11, s20;
    sb_real s22;
} sbi_sparse_sums;

SBI_FORCE_INLINE sbi_sparse_sums sbi_sparse_add_block(sbi_sparse_sums s, const sb_real *block, const sb_real *from)
{
    sbi_pair v01 = SBI_PAIR_AT(from), v12 = SBI_PAIR_AT(from + 1);
    s.s00 += SBI_PAIR_AT(block) * v01;
    s.s02 += SBI_PAIR_AT(block + 2) * sbi_pair_make(v12[1], v01[0]);
    s.s11 += SBI_PAIR_AT(block + 4) * v12;
    s.s20 += SBI_PAIR_AT(block + 6) * v01;
    s.s22 += block[8] * v12[1];
    return s;
}

/* Two blocks a turn: with one, gcc moves all sums to other registers and back. */
SBI_FORCE_INLINE void sbi_sparse_multiply_blocks(const sb_matrix *matrix, const sb_real *x, sb_real *y, int first,
                                                 int last, int guard)
{
    const sbi_pair zero = {0, 0};
    const int *column = matrix->columns + first, *end = matrix->columns + last;
    const sb_real *block = matrix->blocks[first];
    sbi_sparse_sums s = {zero, zero, zero, zero, 0};
    (void)guard;
    for (; column + 1 < end; column += 2, block += 18) {
        s = sbi_sparse_add_block(s, block, x + 3 * (size_t)column[0]);
        s = sbi_sparse_add_block(s, block + 9, x + 3 * (size_t)column[1]);
    }
    if (column < end)
        s = sbi_sparse_add_block(s, block, x + 3 * (size_t)column[0]);
    y[0] = s.s00[0] + s.s00[1] + s.s02[0];
    y[1] = s.s02[1] + s.s11[0] + s.s11[1];
    y[2] = s.s20[0] + s.s20[1] + s.s22;
}
#else
SBI_FORCE_INLINE void sbi_sparse_multiply_blocks(const sb_matrix *matrix, const sb_real *x, sb_real *y, int first,
                                                 int last, int guard)
{
    const sb_real *block = matrix->blocks[first];
    sb_real s00 = 0, s01 = 0, s02 = 0, s10 = 0, s11 = 0, s12 = 0, s20 = 0, s21 = 0, s22 = 0;
    (void)guard;
    for (int q = first; q < last; q++, block += 9) {
        const sb_real *from = x + 3 * (size_t)matrix->columns[q];
        sb_real v0 = from[0], v1 = from[1], v2 = from[2];
        s00 += block[0] * v0, s01 += block[1] * v1, s02 += block[2] * v2;
        s10 += block[3] * v0, s11 += block[4] * v1, s12 += block[5] * v2;
        s20 += block[6] * v0, s21 += block[7] * v1, s22 += block[8] * v2;
    }
    y[0] = s00 + s01 + s02;
    y[1] = s10 + s11 + s12;
    y[2] = s20 + s21 + s22;
}
#endif

/* The same of row i from block `first` on. */
SBI_FORCE_INLINE void sbi_sparse_multiply_row(const sb_matrix *matrix, const sb_real *x, sb_real *y, int i, int first)
{
    int last = matrix->row_end[i];
    if (matrix->columns[last - 1] != matrix->row_count - 1)
        sbi_sparse_multiply_blocks(matrix, x, y, first, last, 0);
    else
        sbi_sparse_multiply_blocks(matrix, x, y, first, last, 1);
}

SBI_API void sbi_matrix_multiply_rows(const sb_matrix *matrix, const sb_real *x, sb_real *y, int first, int last)
{
    for (int i = first; i < last; i++)
        sbi_sparse_multiply_row(matrix, x, y + 3 * (size_t)i, i, matrix->row_start[i]);
}

typedef struct sbi_sparse_product {
    const sb_matrix *matrix;
    const sb_real *x;
    sb_real *y;
} sbi_sparse_product;

static void sbi_sparse_multiply_task(void *user, int chunk)
{
    const sbi_sparse_product *product = (const sbi_sparse_product *)user;
    int first = chunk * SBI_ROW_CHUNK, rows = product->matrix->row_count;
    int last = rows - first < SBI_ROW_CHUNK ? rows : first + SBI_ROW_CHUNK;
    sbi_matrix_multiply_rows(product->matrix, product->x, product->y, first, last);
}

SB_API void sb_matrix_multiply(const sb_matrix *matrix, const sb_real *x, sb_real *y, const sb_jobs *jobs)
{
    sbi_sparse_product product;
    if (!matrix || !x || !y)
        return;
    product.matrix = matrix;
    product.x = x;
    product.y = y;
    sbi_run(jobs, sbi_sparse_multiply_task, &product, sbi_row_chunks(matrix->row_count));
}

/* Sums over rows are those of parts of them, which do not depend on who adds them up. */
enum { SBI_SPARSE_PARTS = 64 };
static int sbi_sparse_parts(int rows) { return sbi_min_int(sbi_row_chunks(rows), SBI_SPARSE_PARTS); }
static int sbi_sparse_part_begin(int rows, int part, int parts) { return (int)((int64_t)rows * part / parts); }

typedef struct sbi_sparse_work {
    const sb_matrix *matrix;
    const sb_real *x;
    int parts;
    double sums[SBI_SPARSE_PARTS];
} sbi_sparse_work;

/* x_i . (A_ii x_i + 2 sum over j > i of A_ij x_j) */
static void sbi_sparse_work_task(void *user, int part)
{
    sbi_sparse_work *work = (sbi_sparse_work *)user;
    const sb_matrix *matrix = work->matrix;
    int end = sbi_sparse_part_begin(matrix->row_count, part + 1, work->parts);
    double sum = 0;
    for (int i = sbi_sparse_part_begin(matrix->row_count, part, work->parts); i < end; i++) {
        const sb_real *own = work->x + 3 * (size_t)i, *block = matrix->blocks[matrix->diagonal[i]];
        sb_real above[3];
        sbi_sparse_multiply_row(matrix, work->x, above, i, matrix->diagonal[i] + 1);
        for (int r = 0; r < 3; r++) {
            sb_real diagonal = block[3 * r] * own[0] + block[3 * r + 1] * own[1] + block[3 * r + 2] * own[2];
            sum += (double)own[r] * (double)(diagonal + 2 * above[r]);
        }
    }
    work->sums[part] = sum;
}

SBI_API double sbi_matrix_work(const sb_matrix *matrix, const sb_real *x, const sb_jobs *jobs)
{
    sbi_sparse_work work;
    double sum = 0;
    work.matrix = matrix;
    work.x = x;
    work.parts = sbi_sparse_parts(matrix->row_count);
    sbi_run(jobs, sbi_sparse_work_task, &work, work.parts);
    for (int part = 0; part < work.parts; part++)
        sum += work.sums[part];
    return sum;
}

SB_API sb_real sb_matrix_asymmetry(const sb_matrix *matrix)
{
    sb_real largest = 0, difference = 0;
    if (!matrix)
        return 0;
    for (int i = 0; i < matrix->row_count; i++)
        for (int q = matrix->row_start[i]; q < matrix->row_end[i]; q++) {
            const sb_real *a = matrix->blocks[q], *b = matrix->blocks[matrix->transpose[q]];
            for (int k = 0; k < 9; k++) {
                sb_real gap = sb_abs(a[k] - b[3 * (k % 3) + k / 3]), size = sb_abs(a[k]);
                if (!sb_is_finite(size))
                    return size - size;
                largest = sb_max(size, largest);
                difference = sb_max(gap, difference);
            }
        }
    return largest > 0 ? difference / largest : 0;
}

/* ---- constraints --------------------------------------------------------------------------------------- */

/* The mean of a diagonal. */
typedef struct sbi_sparse_mean {
    const sb_matrix *matrix;
    const unsigned char *mask;
    int parts;
    double sums[SBI_SPARSE_PARTS];
    int counts[SBI_SPARSE_PARTS];
} sbi_sparse_mean;

static void sbi_sparse_mean_task(void *user, int part)
{
    sbi_sparse_mean *mean = (sbi_sparse_mean *)user;
    const sb_matrix *matrix = mean->matrix;
    int rows = matrix->row_count, count = 0;
    int first = sbi_sparse_part_begin(rows, part, mean->parts),
        end = sbi_sparse_part_begin(rows, part + 1, mean->parts);
    double sums[3] = {0, 0, 0}; /* three that do not wait for each other */
    for (int i = first; i < end; i++) {
        const sb_real *block = matrix->blocks[matrix->diagonal[i]];
        int later = matrix->diagonal[sbi_min_int(i + SBI_SPARSE_ROWS_AHEAD, rows - 1)];
        int held = mean->mask ? mean->mask[i] : 0;
        SBI_PREFETCH(matrix->blocks[later], 0);
        SBI_PREFETCH(matrix->blocks[later], 64); /* where the last of its diagonal is */
        if ((held & SB_XYZ) == 0) {
            sums[0] += fabs((double)block[0]), sums[1] += fabs((double)block[4]), sums[2] += fabs((double)block[8]);
            count += 3;
        }
        for (int k = 0; (held & SB_XYZ) != 0 && k < 3; k++) {
            int counts = !(held >> k & 1);
            sums[k] += counts ? fabs((double)block[4 * k]) : 0;
            count += counts;
        }
    }
    mean->sums[part] = sums[0] + sums[1] + sums[2];
    mean->counts[part] = count;
}

SBI_API sb_real sbi_matrix_diagonal_scale(const sb_matrix *matrix, const unsigned char *mask, const sb_jobs *jobs)
{
    sbi_sparse_mean mean;
    double sum = 0, count = 0;
    mean.matrix = matrix;
    mean.mask = mask;
    mean.parts = sbi_sparse_parts(matrix->row_count);
    sbi_run(jobs, sbi_sparse_mean_task, &mean, mean.parts);
    for (int part = 0; part < mean.parts; part++) {
        sum += mean.sums[part];
        count += mean.counts[part];
    }
    return sum == 0 ? (sb_real)1 : (sb_real)(sum / count);
}

SB_API sb_real sb_matrix_diagonal_scale(const sb_matrix *matrix, const unsigned char *mask)
{
    if (!matrix)
        return 0;
    return sbi_matrix_diagonal_scale(matrix, mask, NULL);
}

/* Moves the known terms of node i's prescribed components to the other rows' right-hand sides. The column of
 * component c in block (j, i) is row c of block (i, j). Most supports stand still and have none. */
static void sbi_sparse_move_known(const sb_matrix *matrix, int i, int mask, const sb_real *value, sb_real *rhs)
{
    if (!((mask & SB_X && value[0] != 0) || (mask & SB_Y && value[1] != 0) || (mask & SB_Z && value[2] != 0)))
        return;
    for (int q = matrix->row_start[i]; q < matrix->row_end[i]; q++) {
        const sb_real *block = matrix->blocks[q];
        sb_real *to = rhs + 3 * (size_t)matrix->columns[q];
        for (int c = 0; c < 3; c++)
            if (mask >> c & 1)
                for (int r = 0; r < 3; r++)
                    to[r] -= block[3 * c + r] * value[c];
    }
}

/* Zeroes node i's prescribed rows and columns. */
static void sbi_sparse_zero(sb_matrix *matrix, int i, int mask)
{
    int all = (mask & SB_XYZ) == SB_XYZ;
    for (int q = matrix->row_start[i]; q < matrix->row_end[i]; q++) {
        sb_real *block = matrix->blocks[q];
        sb_real *transposed = matrix->blocks[matrix->transpose[q]];
        int later = matrix->transpose[sbi_min_int(q + SBI_SPARSE_ROWS_AHEAD, matrix->block_count - 1)];
        SBI_PREFETCH(matrix->blocks[later], 0);
        SBI_PREFETCH(matrix->blocks[later], 64);
        for (int k = 0; all && k < 9; k++)
            block[k] = transposed[k] = 0;
        for (int c = 0; !all && c < 3; c++)
            if (mask >> c & 1)
                for (int r = 0; r < 3; r++) {
                    block[3 * c + r] = 0;
                    transposed[3 * r + c] = 0;
                }
    }
}

SBI_API void sbi_matrix_constrain(sb_matrix *matrix, const unsigned char *mask, const sb_real *values, sb_real *rhs,
                                  const sb_jobs *jobs)
{
    sb_real scale = sbi_matrix_diagonal_scale(matrix, mask, jobs);
    if (values && rhs)
        for (int i = 0; i < matrix->row_count; i++)
            if (mask[i] & SB_XYZ)
                sbi_sparse_move_known(matrix, i, mask[i], values + 3 * (size_t)i, rhs);
    for (int i = 0; i < matrix->row_count; i++) {
        matrix->fixed[i] = (unsigned char)(mask[i] & SB_XYZ);
        if (!matrix->fixed[i])
            continue;
        sbi_sparse_zero(matrix, i, mask[i]);
        for (int k = 0; k < 3; k++)
            if (mask[i] >> k & 1) {
                matrix->blocks[matrix->diagonal[i]][4 * k] = scale;
                if (rhs)
                    rhs[3 * (size_t)i + (size_t)k] = values ? scale * values[3 * (size_t)i + (size_t)k] : 0;
            }
    }
}

SB_API void sb_matrix_constrain(sb_matrix *matrix, const unsigned char *mask, const sb_real *values, sb_real *rhs)
{
    if (!matrix || !mask)
        return;
    sbi_matrix_constrain(matrix, mask, values, rhs, NULL);
}
