/* direct_front: see direct_front.h. Products go through packed pieces that fit the caches, in tiles that fit the
 * registers (Goto and van de Geijn 2008). */
#include <string.h>

#include "direct_front.h"
#include "direct_lanes.h"

enum {
    SBI_FRONT_BLOCK = 32,  /* columns factored at once, */
    SBI_FRONT_SOLVED = 48, /* and solved for many groups: those of whole nodes */
    SBI_FRONT_CHUNK = 64   /* rows that a triangular solve takes at once */
};

/* ---- products ---- */

/* Packs rows of a column-major matrix in strips of `strip` rows, filled up with zeros; signs, unless NULL, multiply the
 * columns. */
static void sbi_front_pack(const sb_real *from, size_t stride, int rows, int depth, int strip, const sb_real *signs,
                           sb_real *to)
{
    for (int i = 0; i < rows; i += strip) {
        int have = sbi_min_int(strip, rows - i);
        for (int k = 0; k < depth; k++, to += strip) {
            const sb_real *column = from + (size_t)k * stride + i;
            sb_real sign = signs ? signs[k] : 1;
            for (int r = 0; r < have; r++)
                to[r] = sign * column[r];
            for (int r = have; r < strip; r++)
                to[r] = 0;
        }
    }
}

/* What a product is of: C -= A S B^T for the entries on and below the diagonal, A and B being rows of one panel. */
typedef struct sbi_front_product {
    sb_real *c;
    size_t c_stride;
    const sb_real *rows; /* first entry of the rows; A and B begin with the same one */
    size_t stride;
    int row_count, column_count, depth;
    const sb_real *signs; /* [depth] or NULL */
    sb_real *pack;
    int wide;
} sbi_front_product;

/* The tiles of packed rows first_row.. and columns first_column.. */
SBI_FORCE_INLINE void sbi_front_tiles_lanes(int wide, const sbi_front_product *p, int first_row, int rows,
                                            int first_column, int columns, int depth)
{
    const sb_real *left = p->pack, *right = p->pack + SBI_FRONT_DEPTH * SBI_FRONT_ROWS;
    sb_real tile[(int)SBI_FRONT_TILE * (int)SBI_FRONT_GROUP];
    for (int j = 0; j < columns; j += SBI_FRONT_TILE)
        for (int i = 0; i < rows; i += SBI_FRONT_GROUP) {
            int have = sbi_min_int(SBI_FRONT_GROUP, rows - i), across = sbi_min_int(SBI_FRONT_TILE, columns - j);
            if (first_row + i + have <= first_column + j)
                continue; /* above the diagonal */
            sbi_front_tile(wide, left + i * depth, right + j * depth, SBI_FRONT_TILE, depth, tile);
            for (int c = 0; c < across; c++) {
                sb_real *to = p->c + (size_t)(first_column + j + c) * p->c_stride + (size_t)(first_row + i);
                const sb_real *from = tile + c * SBI_FRONT_GROUP;
                if (have == SBI_FRONT_GROUP)
                    for (int r = 0; r < SBI_FRONT_GROUP; r++)
                        to[r] -= from[r];
                else
                    for (int r = 0; r < have; r++)
                        to[r] -= from[r];
            }
        }
}
SBI_WIDEN_IF(sbi_front_tiles,
             (const sbi_front_product *p, int first_row, int rows, int first_column, int columns, int depth),
             (p, first_row, rows, first_column, columns, depth))

static void sbi_front_multiply(const sbi_front_product *p)
{
    for (int k = 0; k < p->depth; k += SBI_FRONT_DEPTH) {
        int depth = sbi_min_int(SBI_FRONT_DEPTH, p->depth - k);
        const sb_real *from = p->rows + (size_t)k * p->stride, *signs = p->signs ? p->signs + k : NULL;
        for (int j = 0; j < p->column_count; j += SBI_FRONT_COLUMNS) {
            int columns = sbi_min_int(SBI_FRONT_COLUMNS, p->column_count - j);
            sbi_front_pack(from + j, p->stride, columns, depth, SBI_FRONT_TILE, signs,
                           p->pack + SBI_FRONT_DEPTH * SBI_FRONT_ROWS);
            for (int i = j; i < p->row_count; i += SBI_FRONT_ROWS) {
                int rows = sbi_min_int(SBI_FRONT_ROWS, p->row_count - i);
                sbi_front_pack(from + i, p->stride, rows, depth, SBI_FRONT_GROUP, NULL, p->pack);
                sbi_front_tiles(p->wide, p, i, rows, j, columns, depth);
            }
        }
    }
}

/* ---- factoring ---- */

/* The square on the diagonal. Returns -1 or the column whose pivot is lost. 32: how many rounding errors a pivot is
 * granted; more would refuse stiff matrices in single precision. */
static int sbi_front_corner(sb_real *a, size_t height, int count, int indefinite, sb_real *signs, const sb_real *sizes,
                            sb_direct_info *info)
{
    for (int k = 0; k < count; k++) {
        sb_real *column = a + (size_t)k * height, pivot = column[k], share = sb_abs(pivot) / sizes[k];
        if (sbi_dense_is_lost(pivot, 8, sizes[k]) || (!indefinite && pivot < 0))
            return k;
        if (info->least_pivot == 0 || share < info->least_pivot)
            info->least_pivot = share;
        info->negative_pivots += pivot < 0;
        signs[k] = (sb_real)(pivot < 0 ? -1 : 1);
        column[k] = sb_sqrt(sb_abs(pivot));
        for (int r = k + 1; r < count; r++)
            column[r] *= signs[k] / column[k];
        for (int j = k + 1; j < count; j++)
            sbi_front_subtract(0, a + (size_t)j * height + j, signs[k] * column[j], column + j, (size_t)(count - j));
    }
    return -1;
}

/* The rows below a factored corner of `count` columns. */
SBI_FORCE_INLINE void sbi_front_below_lanes(int wide, const sb_real *corner, sb_real *below, size_t height, size_t rows,
                                            int count, const sb_real *signs)
{
    for (size_t first = 0; first < rows; first += SBI_FRONT_CHUNK) {
        size_t have = rows - first < SBI_FRONT_CHUNK ? rows - first : (size_t)SBI_FRONT_CHUNK;
        for (int k = 0; k < count; k++) {
            sb_real *column = below + (size_t)k * height + first;
            sb_real scale = signs[k] / corner[(size_t)k * height + (size_t)k];
            for (int p = 0; p < k; p++)
                sbi_front_subtract(wide, column, signs[p] * corner[(size_t)p * height + (size_t)k],
                                   below + (size_t)p * height + first, have);
            for (size_t r = 0; r < have; r++)
                column[r] *= scale;
        }
    }
}
SBI_WIDEN_IF(sbi_front_below,
             (const sb_real *corner, sb_real *below, size_t height, size_t rows, int count, const sb_real *signs),
             (corner, below, height, rows, count, signs))

SBI_API int sbi_front_factor(sb_real *panel, size_t height, size_t width, int indefinite, sb_real *signs,
                             const sb_real *sizes, sb_real *pack, int wide, sb_direct_info *info)
{
    for (size_t first = 0; first < width; first += SBI_FRONT_BLOCK) {
        int count = (int)(width - first < SBI_FRONT_BLOCK ? width - first : (size_t)SBI_FRONT_BLOCK);
        size_t next = first + (size_t)count;
        sb_real *corner = panel + first * height + first;
        sbi_front_product product;
        int bad = sbi_front_corner(corner, height, count, indefinite, signs + first, sizes + first, info);
        if (bad >= 0)
            return (int)first + bad;
        sbi_front_below(wide, corner, corner + count, height, height - next, count, signs + first);
        product.c = panel + next * height + next;
        product.c_stride = product.stride = height;
        product.rows = corner + count;
        product.row_count = (int)(height - next);
        product.column_count = (int)(width - next);
        product.depth = count;
        product.signs = indefinite ? signs + first : NULL;
        product.pack = pack;
        product.wide = wide;
        sbi_front_multiply(&product);
    }
    return -1;
}

SBI_API void sbi_front_square(const sb_real *panel, size_t height, size_t width, int indefinite, const sb_real *signs,
                              sb_real *square, sb_real *pack, int wide)
{
    sbi_front_product product;
    product.c = square;
    product.c_stride = height - width;
    product.rows = panel + width;
    product.stride = height;
    product.row_count = product.column_count = (int)(height - width);
    product.depth = (int)width;
    product.signs = indefinite ? signs : NULL;
    product.pack = pack;
    product.wide = wide;
    sbi_front_multiply(&product);
}

/* ---- substitution, three columns at a time: a front's are nodes' ---- */

/* The 3x3 lower triangle at the columns' head: x <- L^-1 x, then x <- L^-T x. */
static void sbi_front_solve_head_one(const sb_real *l, size_t height, sb_real *x)
{
    x[0] = x[0] / l[0];
    x[1] = (x[1] - l[1] * x[0]) / l[height + 1];
    x[2] = (x[2] - l[2] * x[0] - l[height + 2] * x[1]) / l[2 * height + 2];
}

static void sbi_front_solve_head_transposed_one(const sb_real *l, size_t height, sb_real *x)
{
    x[2] = x[2] / l[2 * height + 2];
    x[1] = (x[1] - l[height + 2] * x[2]) / l[height + 1];
    x[0] = (x[0] - l[1] * x[1] - l[2] * x[2]) / l[0];
}

static void sbi_front_forward_one(const sb_real *l, size_t height, size_t rows, sb_real *x)
{
    sb_real x0 = x[0], x1 = x[1], x2 = x[2];
    for (size_t r = 3; r < rows; r++)
        x[r] = x[r] - l[r] * x0 - l[height + r] * x1 - l[2 * height + r] * x2;
}

static void sbi_front_backward_one(const sb_real *l, size_t height, size_t rows, sb_real *x)
{
    sb_real s0 = 0, s1 = 0, s2 = 0;
    for (size_t r = 3; r < rows; r++) {
        s0 += l[r] * x[r];
        s1 += l[height + r] * x[r];
        s2 += l[2 * height + r] * x[r];
    }
    x[0] -= s0;
    x[1] -= s1;
    x[2] -= s2;
}

/* x <- L^-1 x of one group, for `width` columns of L and what they do to its rows. */
SBI_FORCE_INLINE void sbi_front_forward_columns_lanes(int wide, const sb_real *l, size_t height, size_t width,
                                                      size_t rows, sb_real *x)
{
    for (size_t k = 0; k < width; k += 3) {
        sbi_front_solve_head(wide, l + k * height + k, height, x + k * SBI_FRONT_GROUP);
        sbi_front_forward_group(wide, l + k * height + k, height, rows - k, x + k * SBI_FRONT_GROUP);
    }
}
SBI_WIDEN_IF(sbi_front_forward_columns, (const sb_real *l, size_t height, size_t width, size_t rows, sb_real *x),
             (l, height, width, rows, x))

/* x <- L^-T x likewise. */
SBI_FORCE_INLINE void sbi_front_backward_columns_lanes(int wide, const sb_real *l, size_t height, size_t width,
                                                       size_t rows, sb_real *x)
{
    for (size_t k = width; k > 0;) {
        k -= 3;
        sbi_front_backward_group(wide, l + k * height + k, height, rows - k, x + k * SBI_FRONT_GROUP);
        sbi_front_solve_head_transposed(wide, l + k * height + k, height, x + k * SBI_FRONT_GROUP);
    }
}
SBI_WIDEN_IF(sbi_front_backward_columns, (const sb_real *l, size_t height, size_t width, size_t rows, sb_real *x),
             (l, height, width, rows, x))

SBI_API void sbi_front_forward(const sb_real *panel, size_t height, size_t width, sb_real *x, int group, int wide)
{
    if (group > 1) {
        sbi_front_forward_columns(wide, panel, height, width, height, x);
        return;
    }
    for (size_t k = 0; k < width; k += 3) {
        const sb_real *l = panel + k * height + k;
        sbi_front_solve_head_one(l, height, x + k);
        sbi_front_forward_one(l, height, height - k, x + k);
    }
}

SBI_API void sbi_front_backward(const sb_real *panel, size_t height, size_t width, sb_real *x, int group, int wide)
{
    if (group > 1) {
        sbi_front_backward_columns(wide, panel, height, width, height, x);
        return;
    }
    for (size_t k = width; k > 0;) {
        const sb_real *l;
        k -= 3;
        l = panel + k * height + k;
        sbi_front_backward_one(l, height, height - k, x + k);
        sbi_front_solve_head_transposed_one(l, height, x + k);
    }
}

/* ---- many groups ---- */

/* Rows first_row.. of all groups less what a block of solved rows `solved` does to them; pack: the columns there. */
SBI_FORCE_INLINE void sbi_front_reduce_rows_lanes(int wide, const sb_real *pack, size_t height, int rows, int depth,
                                                  sb_real *x, size_t solved, size_t first_row, int count)
{
    sb_real tile[(int)SBI_FRONT_TILE * (int)SBI_FRONT_GROUP];
    for (int g = 0; g < count; g++) {
        const sb_real *known = x + ((size_t)g * height + solved) * SBI_FRONT_GROUP;
        sb_real *to = x + ((size_t)g * height + first_row) * SBI_FRONT_GROUP;
        for (int r = 0; r < rows; r += SBI_FRONT_TILE, to += (int)SBI_FRONT_TILE * (int)SBI_FRONT_GROUP) {
            int values = sbi_min_int(SBI_FRONT_TILE, rows - r) * SBI_FRONT_GROUP;
            sbi_front_tile(wide, known, pack + r * depth, SBI_FRONT_TILE, depth, tile);
            for (int i = 0; i < values; i++)
                to[i] -= tile[i];
        }
    }
}
SBI_WIDEN_IF(sbi_front_reduce_rows,
             (const sb_real *pack, size_t height, int rows, int depth, sb_real *x, size_t solved, size_t first_row,
              int count),
             (pack, height, rows, depth, x, solved, first_row, count))

SBI_API void sbi_front_forward_many(const sb_real *panel, size_t height, size_t width, sb_real *x, int count,
                                    sb_real *pack, int wide)
{
    for (size_t first = 0; first < width; first += SBI_FRONT_SOLVED) {
        size_t depth = width - first < SBI_FRONT_SOLVED ? width - first : (size_t)SBI_FRONT_SOLVED,
               next = first + depth;
        for (int g = 0; g < count; g++)
            sbi_front_forward_columns(wide, panel + first * height + first, height, depth, depth,
                                      x + ((size_t)g * height + first) * SBI_FRONT_GROUP);
        for (size_t row = next; row < height; row += SBI_FRONT_COLUMNS) {
            int rows = (int)(height - row < SBI_FRONT_COLUMNS ? height - row : (size_t)SBI_FRONT_COLUMNS);
            sbi_front_pack(panel + first * height + row, height, rows, (int)depth, SBI_FRONT_TILE, NULL, pack);
            sbi_front_reduce_rows(wide, pack, height, rows, (int)depth, x, first, row, count);
        }
    }
}

/* Packs columns of a column-major matrix in strips of a tile's width, filled up with zeros. */
static void sbi_front_pack_columns(const sb_real *from, size_t stride, int rows, int columns, sb_real *to)
{
    for (int j = 0; j < columns; j += SBI_FRONT_TILE)
        for (int r = 0; r < rows; r++)
            for (int c = 0; c < SBI_FRONT_TILE; c++)
                *to++ = j + c < columns ? from[(size_t)(j + c) * stride + (size_t)r] : 0;
}

/* Own columns first..first + depth of all groups less what known[rows] of the front do to them; pack: the columns
 * there, and room. */
SBI_FORCE_INLINE void sbi_front_reduce_columns_lanes(int wide, sb_real *pack, const int *known, int rows, int depth,
                                                     sb_real *x, size_t stride, int first, int count)
{
    sb_real *gathered = pack + (size_t)SBI_FRONT_COLUMNS * SBI_FRONT_SOLVED;
    sb_real tile[(int)SBI_FRONT_TILE * (int)SBI_FRONT_GROUP];
    for (int g = 0; g < count; g++) {
        sb_real *group = x + (size_t)g * stride * SBI_FRONT_GROUP;
        sb_real *to = group + (size_t)first * SBI_FRONT_GROUP;
        for (int r = 0; r < rows; r++) {
            const sb_real *from = group + (size_t)known[r] * SBI_FRONT_GROUP;
            SBI_PREFETCH(from, stride * SBI_FRONT_GROUP * sizeof *x); /* the next group's */
            memcpy(gathered + (size_t)r * SBI_FRONT_GROUP, from, SBI_FRONT_GROUP * sizeof *x);
        }
        for (int c = 0; c < depth; c += SBI_FRONT_TILE, to += (int)SBI_FRONT_TILE * (int)SBI_FRONT_GROUP) {
            int values = sbi_min_int(SBI_FRONT_TILE, depth - c) * SBI_FRONT_GROUP;
            sbi_front_tile(wide, gathered, pack + c * rows, SBI_FRONT_TILE, rows, tile);
            for (int i = 0; i < values; i++)
                to[i] -= tile[i];
        }
    }
}
SBI_WIDEN_IF(sbi_front_reduce_columns,
             (sb_real * pack, const int *known, int rows, int depth, sb_real *x, size_t stride, int first, int count),
             (pack, known, rows, depth, x, stride, first, count))

SBI_API void sbi_front_backward_many(const sb_real *panel, size_t height, size_t width, const int *rows, sb_real *x,
                                     size_t stride, int count, sb_real *pack, int wide)
{
    for (size_t end = width; end > 0;) {
        size_t depth = end < SBI_FRONT_SOLVED ? end : (size_t)SBI_FRONT_SOLVED, first = end - depth;
        const sb_real *columns = panel + first * height;
        for (size_t row = end; row < height; row += SBI_FRONT_COLUMNS) {
            int have = (int)(height - row < SBI_FRONT_COLUMNS ? height - row : (size_t)SBI_FRONT_COLUMNS);
            sbi_front_pack_columns(columns + row, height, have, (int)depth, pack);
            sbi_front_reduce_columns(wide, pack, rows + row, have, (int)depth, x, stride, rows[first], count);
        }
        for (int g = 0; g < count; g++)
            sbi_front_backward_columns(wide, columns + first, height, depth, depth,
                                       x + ((size_t)g * stride + (size_t)rows[first]) * SBI_FRONT_GROUP);
        end = first;
    }
}
