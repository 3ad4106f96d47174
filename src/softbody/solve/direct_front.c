/* direct_front: see direct_front.h. Products go through packed pieces that fit the caches, in tiles that fit the
 * registers (Goto and van de Geijn 2008). */
#include <string.h>

#include "direct_front.h"

enum {
    SBI_FRONT_TILE = 4,    /* columns of a tile */
    SBI_FRONT_BLOCK = 32,  /* columns factored at once, */
    SBI_FRONT_SOLVED = 48, /* and solved for many groups: those of whole nodes */
    SBI_FRONT_CHUNK = 64   /* rows that a triangular solve takes at once */
};

/* ---- products ---- */

/* tile[4][group] = a b^T of packed a[depth][group] and four values of b[depth][stride] */
#if SBI_FRONT_BYTES
static void sbi_front_tile(const sb_real *a, const sb_real *b, size_t stride, int depth, sb_real *tile)
{
    sbi_front_lanes c00 = SBI_FRONT_AT(a) - SBI_FRONT_AT(a), c01 = c00, c10 = c00, c11 = c00, c20 = c00, c21 = c00;
    sbi_front_lanes c30 = c00, c31 = c00;
    for (int k = 0; k < depth; k++, a += SBI_FRONT_GROUP, b += stride) {
        sbi_front_lanes a0 = SBI_FRONT_AT(a), a1 = SBI_FRONT_AT(a + SBI_FRONT_WIDTH);
        c00 += a0 * b[0], c01 += a1 * b[0];
        c10 += a0 * b[1], c11 += a1 * b[1];
        c20 += a0 * b[2], c21 += a1 * b[2];
        c30 += a0 * b[3], c31 += a1 * b[3];
    }
    SBI_FRONT_PUT(tile, c00), SBI_FRONT_PUT(tile + SBI_FRONT_WIDTH, c01);
    SBI_FRONT_PUT(tile + 2 * SBI_FRONT_WIDTH, c10), SBI_FRONT_PUT(tile + 3 * SBI_FRONT_WIDTH, c11);
    SBI_FRONT_PUT(tile + 4 * SBI_FRONT_WIDTH, c20), SBI_FRONT_PUT(tile + 5 * SBI_FRONT_WIDTH, c21);
    SBI_FRONT_PUT(tile + 6 * SBI_FRONT_WIDTH, c30), SBI_FRONT_PUT(tile + 7 * SBI_FRONT_WIDTH, c31);
}
#else
static void sbi_front_tile(const sb_real *a, const sb_real *b, size_t stride, int depth, sb_real *tile)
{
    for (int i = 0; i < SBI_FRONT_GROUP; i++) {
        sb_real c0 = 0, c1 = 0, c2 = 0, c3 = 0;
        for (int k = 0; k < depth; k++) {
            sb_real value = a[k * SBI_FRONT_GROUP + i];
            const sb_real *right = b + (size_t)k * stride;
            c0 += value * right[0];
            c1 += value * right[1];
            c2 += value * right[2];
            c3 += value * right[3];
        }
        tile[i] = c0;
        tile[SBI_FRONT_GROUP + i] = c1;
        tile[2 * SBI_FRONT_GROUP + i] = c2;
        tile[3 * SBI_FRONT_GROUP + i] = c3;
    }
}
#endif

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
} sbi_front_product;

/* The tiles of packed rows first_row.. and columns first_column.. */
static void sbi_front_tiles(const sbi_front_product *p, int first_row, int rows, int first_column, int columns,
                            int depth)
{
    const sb_real *left = p->pack, *right = p->pack + SBI_FRONT_DEPTH * SBI_FRONT_ROWS;
    sb_real tile[(int)SBI_FRONT_TILE * (int)SBI_FRONT_GROUP];
    for (int j = 0; j < columns; j += SBI_FRONT_TILE)
        for (int i = 0; i < rows; i += SBI_FRONT_GROUP) {
            int have = sbi_min_int(SBI_FRONT_GROUP, rows - i), wide = sbi_min_int(SBI_FRONT_TILE, columns - j);
            if (first_row + i + have <= first_column + j)
                continue; /* above the diagonal */
            sbi_front_tile(left + i * depth, right + j * depth, SBI_FRONT_TILE, depth, tile);
            for (int c = 0; c < wide; c++) {
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
                sbi_front_tiles(p, i, rows, j, columns, depth);
            }
        }
    }
}

/* ---- factoring ---- */

/* to[count] -= f x[count] */
static void sbi_front_subtract(sb_real *to, sb_real f, const sb_real *x, size_t count)
{
    size_t r = 0;
#if SBI_FRONT_BYTES
    for (; r + SBI_FRONT_WIDTH <= count; r += SBI_FRONT_WIDTH)
        SBI_FRONT_PUT(to + r, SBI_FRONT_AT(to + r) - SBI_FRONT_AT(x + r) * f);
#endif
    for (; r < count; r++)
        to[r] -= x[r] * f;
}

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
            sbi_front_subtract(a + (size_t)j * height + j, signs[k] * column[j], column + j, (size_t)(count - j));
    }
    return -1;
}

/* The rows below a factored corner of `count` columns. */
static void sbi_front_below(const sb_real *corner, sb_real *below, size_t height, size_t rows, int count,
                            const sb_real *signs)
{
    for (size_t first = 0; first < rows; first += SBI_FRONT_CHUNK) {
        size_t have = rows - first < SBI_FRONT_CHUNK ? rows - first : (size_t)SBI_FRONT_CHUNK;
        for (int k = 0; k < count; k++) {
            sb_real *column = below + (size_t)k * height + first;
            sb_real scale = signs[k] / corner[(size_t)k * height + (size_t)k];
            for (int p = 0; p < k; p++)
                sbi_front_subtract(column, signs[p] * corner[(size_t)p * height + (size_t)k],
                                   below + (size_t)p * height + first, have);
            for (size_t r = 0; r < have; r++)
                column[r] *= scale;
        }
    }
}

SBI_API int sbi_front_factor(sb_real *panel, size_t height, size_t width, int indefinite, sb_real *signs,
                             const sb_real *sizes, sb_real *pack, sb_direct_info *info)
{
    for (size_t first = 0; first < width; first += SBI_FRONT_BLOCK) {
        int count = (int)(width - first < SBI_FRONT_BLOCK ? width - first : (size_t)SBI_FRONT_BLOCK);
        size_t next = first + (size_t)count;
        sb_real *corner = panel + first * height + first;
        sbi_front_product product;
        int bad = sbi_front_corner(corner, height, count, indefinite, signs + first, sizes + first, info);
        if (bad >= 0)
            return (int)first + bad;
        sbi_front_below(corner, corner + count, height, height - next, count, signs + first);
        product.c = panel + next * height + next;
        product.c_stride = product.stride = height;
        product.rows = corner + count;
        product.row_count = (int)(height - next);
        product.column_count = (int)(width - next);
        product.depth = count;
        product.signs = indefinite ? signs + first : NULL;
        product.pack = pack;
        sbi_front_multiply(&product);
    }
    return -1;
}

SBI_API void sbi_front_square(const sb_real *panel, size_t height, size_t width, int indefinite, const sb_real *signs,
                              sb_real *square, sb_real *pack)
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

#if SBI_FRONT_BYTES
static void sbi_front_solve_head(const sb_real *l, size_t height, sb_real *x)
{
    const size_t row = SBI_FRONT_GROUP;
    for (size_t half = 0; half < row; half += SBI_FRONT_WIDTH, x += SBI_FRONT_WIDTH) {
        sbi_front_lanes a = SBI_FRONT_AT(x) / l[0], b = (SBI_FRONT_AT(x + row) - a * l[1]) / l[height + 1];
        SBI_FRONT_PUT(x, a);
        SBI_FRONT_PUT(x + row, b);
        SBI_FRONT_PUT(x + 2 * row, (SBI_FRONT_AT(x + 2 * row) - a * l[2] - b * l[height + 2]) / l[2 * height + 2]);
    }
}

static void sbi_front_solve_head_transposed(const sb_real *l, size_t height, sb_real *x)
{
    const size_t row = SBI_FRONT_GROUP;
    for (size_t half = 0; half < row; half += SBI_FRONT_WIDTH, x += SBI_FRONT_WIDTH) {
        sbi_front_lanes c = SBI_FRONT_AT(x + 2 * row) / l[2 * height + 2];
        sbi_front_lanes b = (SBI_FRONT_AT(x + row) - c * l[height + 2]) / l[height + 1];
        SBI_FRONT_PUT(x + 2 * row, c);
        SBI_FRONT_PUT(x + row, b);
        SBI_FRONT_PUT(x, (SBI_FRONT_AT(x) - b * l[1] - c * l[2]) / l[0]);
    }
}

static void sbi_front_forward_group(const sb_real *l, size_t height, size_t rows, sb_real *x)
{
    const size_t second = SBI_FRONT_WIDTH, row = SBI_FRONT_GROUP;
    sbi_front_lanes x0 = SBI_FRONT_AT(x), x1 = SBI_FRONT_AT(x + row), x2 = SBI_FRONT_AT(x + 2 * row);
    sbi_front_lanes y0 = SBI_FRONT_AT(x + second), y1 = SBI_FRONT_AT(x + row + second);
    sbi_front_lanes y2 = SBI_FRONT_AT(x + 2 * row + second);
    const sb_real *l1 = l + height, *l2 = l1 + height;
    for (size_t r = 3; r < rows; r++) {
        sb_real *at = x + r * row, a = l[r], b = l1[r], c = l2[r];
        SBI_FRONT_PUT(at, SBI_FRONT_AT(at) - x0 * a - x1 * b - x2 * c);
        SBI_FRONT_PUT(at + second, SBI_FRONT_AT(at + second) - y0 * a - y1 * b - y2 * c);
    }
}

static void sbi_front_backward_group(const sb_real *l, size_t height, size_t rows, sb_real *x)
{
    const size_t second = SBI_FRONT_WIDTH, row = SBI_FRONT_GROUP;
    sbi_front_lanes s0 = SBI_FRONT_AT(x) - SBI_FRONT_AT(x), s1 = s0, s2 = s0, t0 = s0, t1 = s0, t2 = s0;
    const sb_real *l1 = l + height, *l2 = l1 + height;
    for (size_t r = 3; r < rows; r++) {
        sbi_front_lanes value = SBI_FRONT_AT(x + r * row), other = SBI_FRONT_AT(x + r * row + second);
        sb_real a = l[r], b = l1[r], c = l2[r];
        s0 += value * a, t0 += other * a;
        s1 += value * b, t1 += other * b;
        s2 += value * c, t2 += other * c;
    }
    SBI_FRONT_PUT(x, SBI_FRONT_AT(x) - s0), SBI_FRONT_PUT(x + second, SBI_FRONT_AT(x + second) - t0);
    SBI_FRONT_PUT(x + row, SBI_FRONT_AT(x + row) - s1);
    SBI_FRONT_PUT(x + row + second, SBI_FRONT_AT(x + row + second) - t1);
    SBI_FRONT_PUT(x + 2 * row, SBI_FRONT_AT(x + 2 * row) - s2);
    SBI_FRONT_PUT(x + 2 * row + second, SBI_FRONT_AT(x + 2 * row + second) - t2);
}
#else
static void sbi_front_solve_head(const sb_real *l, size_t height, sb_real *x)
{
    for (int g = 0; g < SBI_FRONT_GROUP; g++) {
        sb_real *y = x + g, *z = y + SBI_FRONT_GROUP, *w = z + SBI_FRONT_GROUP;
        *y = *y / l[0];
        *z = (*z - l[1] * *y) / l[height + 1];
        *w = (*w - l[2] * *y - l[height + 2] * *z) / l[2 * height + 2];
    }
}

static void sbi_front_solve_head_transposed(const sb_real *l, size_t height, sb_real *x)
{
    for (int g = 0; g < SBI_FRONT_GROUP; g++) {
        sb_real *y = x + g, *z = y + SBI_FRONT_GROUP, *w = z + SBI_FRONT_GROUP;
        *w = *w / l[2 * height + 2];
        *z = (*z - l[height + 2] * *w) / l[height + 1];
        *y = (*y - l[1] * *z - l[2] * *w) / l[0];
    }
}

static void sbi_front_forward_group(const sb_real *l, size_t height, size_t rows, sb_real *x)
{
    for (size_t r = 3; r < rows; r++)
        for (int g = 0; g < SBI_FRONT_GROUP; g++) {
            sb_real *at = x + r * SBI_FRONT_GROUP + g;
            *at = *at - l[r] * x[g] - l[height + r] * x[SBI_FRONT_GROUP + g] -
                  l[2 * height + r] * x[2 * SBI_FRONT_GROUP + g];
        }
}

static void sbi_front_backward_group(const sb_real *l, size_t height, size_t rows, sb_real *x)
{
    sb_real sums[3 * SBI_FRONT_GROUP];
    memset(sums, 0, sizeof sums);
    for (size_t r = 3; r < rows; r++)
        for (int k = 0; k < 3 * SBI_FRONT_GROUP; k++)
            sums[k] +=
                l[(size_t)(k / SBI_FRONT_GROUP) * height + r] * x[r * SBI_FRONT_GROUP + (size_t)(k % SBI_FRONT_GROUP)];
    for (int k = 0; k < 3 * SBI_FRONT_GROUP; k++)
        x[k] -= sums[k];
}
#endif

SBI_API void sbi_front_forward(const sb_real *panel, size_t height, size_t width, sb_real *x, int group)
{
    for (size_t k = 0; k < width; k += 3) {
        const sb_real *l = panel + k * height + k;
        if (group == 1) {
            sbi_front_solve_head_one(l, height, x + k);
            sbi_front_forward_one(l, height, height - k, x + k);
        } else {
            sbi_front_solve_head(l, height, x + k * SBI_FRONT_GROUP);
            sbi_front_forward_group(l, height, height - k, x + k * SBI_FRONT_GROUP);
        }
    }
}

SBI_API void sbi_front_backward(const sb_real *panel, size_t height, size_t width, sb_real *x, int group)
{
    for (size_t k = width; k > 0;) {
        const sb_real *l;
        k -= 3;
        l = panel + k * height + k;
        if (group == 1) {
            sbi_front_backward_one(l, height, height - k, x + k);
            sbi_front_solve_head_transposed_one(l, height, x + k);
        } else {
            sbi_front_backward_group(l, height, height - k, x + k * SBI_FRONT_GROUP);
            sbi_front_solve_head_transposed(l, height, x + k * SBI_FRONT_GROUP);
        }
    }
}

/* ---- many groups ---- */

/* Rows first_row.. of all groups less what a block of solved rows `solved` does to them. */
static void sbi_front_reduce_rows(const sb_real *l, size_t height, int rows, int depth, sb_real *x, size_t solved,
                                  size_t first_row, int count, sb_real *pack)
{
    sb_real tile[(int)SBI_FRONT_TILE * (int)SBI_FRONT_GROUP];
    sbi_front_pack(l, height, rows, depth, SBI_FRONT_TILE, NULL, pack);
    for (int g = 0; g < count; g++) {
        const sb_real *known = x + ((size_t)g * height + solved) * SBI_FRONT_GROUP;
        sb_real *to = x + ((size_t)g * height + first_row) * SBI_FRONT_GROUP;
        for (int r = 0; r < rows; r += SBI_FRONT_TILE, to += (int)SBI_FRONT_TILE * (int)SBI_FRONT_GROUP) {
            int values = sbi_min_int(SBI_FRONT_TILE, rows - r) * SBI_FRONT_GROUP;
            sbi_front_tile(known, pack + r * depth, SBI_FRONT_TILE, depth, tile);
            for (int i = 0; i < values; i++)
                to[i] -= tile[i];
        }
    }
}

SBI_API void sbi_front_forward_many(const sb_real *panel, size_t height, size_t width, sb_real *x, int count,
                                    sb_real *pack)
{
    for (size_t first = 0; first < width; first += SBI_FRONT_SOLVED) {
        size_t depth = width - first < SBI_FRONT_SOLVED ? width - first : (size_t)SBI_FRONT_SOLVED,
               next = first + depth;
        for (int g = 0; g < count; g++)
            for (size_t k = 0; k < depth; k += 3) {
                const sb_real *l = panel + (first + k) * height + first + k;
                sb_real *at = x + ((size_t)g * height + first + k) * SBI_FRONT_GROUP;
                sbi_front_solve_head(l, height, at);
                sbi_front_forward_group(l, height, depth - k, at);
            }
        for (size_t row = next; row < height; row += SBI_FRONT_COLUMNS) {
            int rows = (int)(height - row < SBI_FRONT_COLUMNS ? height - row : (size_t)SBI_FRONT_COLUMNS);
            sbi_front_reduce_rows(panel + first * height + row, height, rows, (int)depth, x, first, row, count, pack);
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

/* Own columns first..first + depth of all groups less what rows row..row + height of the front, which are known, do to
 * them: from l. */
static void sbi_front_reduce_columns(const sb_real *l, size_t height, const int *known, int rows, int depth, sb_real *x,
                                     size_t stride, int first, int count, sb_real *pack)
{
    sb_real *gathered = pack + (size_t)SBI_FRONT_COLUMNS * SBI_FRONT_SOLVED;
    sb_real tile[(int)SBI_FRONT_TILE * (int)SBI_FRONT_GROUP];
    sbi_front_pack_columns(l, height, rows, depth, pack);
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
            sbi_front_tile(gathered, pack + c * rows, SBI_FRONT_TILE, rows, tile);
            for (int i = 0; i < values; i++)
                to[i] -= tile[i];
        }
    }
}

SBI_API void sbi_front_backward_many(const sb_real *panel, size_t height, size_t width, const int *rows, sb_real *x,
                                     size_t stride, int count, sb_real *pack)
{
    for (size_t end = width; end > 0;) {
        size_t depth = end < SBI_FRONT_SOLVED ? end : (size_t)SBI_FRONT_SOLVED, first = end - depth;
        const sb_real *columns = panel + first * height;
        for (size_t row = end; row < height; row += SBI_FRONT_COLUMNS) {
            int have = (int)(height - row < SBI_FRONT_COLUMNS ? height - row : (size_t)SBI_FRONT_COLUMNS);
            sbi_front_reduce_columns(columns + row, height, rows + row, have, (int)depth, x, stride, rows[first], count,
                                     pack);
        }
        for (int g = 0; g < count; g++)
            for (size_t k = depth; k > 0;) {
                sb_real *at;
                k -= 3;
                at = x + ((size_t)g * stride + (size_t)rows[first] + k) * SBI_FRONT_GROUP;
                sbi_front_backward_group(columns + k * height + first + k, height, depth - k, at);
                sbi_front_solve_head_transposed(columns + k * height + first + k, height, at);
            }
        end = first;
    }
}
