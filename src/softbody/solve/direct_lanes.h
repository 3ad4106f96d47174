/* direct_lanes: the inner loops of a front's arithmetic, on vectors. Floor 1, internal: direct_front.c alone calls
 * them.
 *
 * Where a program is compiled for every x86-64 they are there twice, on vectors of 32 bytes for processors with AVX2
 * and on those of 16: `wide`, which is a constant where they are called, tells which. All have the same bits, and those
 * of plain code. */
#ifndef SB_DIRECT_LANES_H
#define SB_DIRECT_LANES_H

#include "direct_front.h"

enum { SBI_FRONT_TILE = 4 }; /* columns of a tile */

/* tile[4][group] = a b^T of packed a[depth][group] and four values of b[depth][stride]
 * subtract: to[count] -= f x[count]
 * solve_head, solve_head_transposed: x[3][group] <- L^-1 x, L^-T x of the 3x3 lower triangle at l
 * forward_group: rows 3.. of x[rows][group] less what three columns of L do to them; backward_group: its first three
 * less what the rows below do. */
#if SBI_FRONT_BYTES
typedef sb_real sbi_front_lanes __attribute__((vector_size(SBI_FRONT_BYTES), aligned(sizeof(sb_real)), may_alias));
typedef sb_real sbi_front_pair __attribute__((vector_size(16), aligned(sizeof(sb_real)), may_alias));
#define SBI_FRONT_AT(lanes, pointer) (*(const lanes *)(const void *)(pointer))
#define SBI_FRONT_PUT(lanes, pointer, value) (*(lanes *)(void *)(pointer) = (value))

/* For a type of vectors: two of them of each row at a time, as many as the registers hold. */
#define SBI_FRONT_KERNELS(kind, lanes)                                                                                 \
    enum { sbi_front_width_##kind = (int)(sizeof(lanes) / sizeof(sb_real)) };                                          \
    SBI_FORCE_INLINE void sbi_front_tile_##kind(const sb_real *left, const sb_real *right, size_t stride, int depth,   \
                                                sb_real *tile)                                                         \
    {                                                                                                                  \
        const int width = sbi_front_width_##kind;                                                                      \
        for (int part = 0; part < SBI_FRONT_GROUP; part += 2 * width, left += 2 * width, tile += 2 * width) {          \
            const sb_real *a = left, *b = right;                                                                       \
            sb_real *to = tile;                                                                                        \
            lanes c00 = SBI_FRONT_AT(lanes, a) - SBI_FRONT_AT(lanes, a), c01 = c00, c10 = c00, c11 = c00;              \
            lanes c20 = c00, c21 = c00, c30 = c00, c31 = c00;                                                          \
            for (int k = 0; k < depth; k++, a += SBI_FRONT_GROUP, b += stride) {                                       \
                lanes a0 = SBI_FRONT_AT(lanes, a), a1 = SBI_FRONT_AT(lanes, a + width);                                \
                c00 += a0 * b[0], c01 += a1 * b[0];                                                                    \
                c10 += a0 * b[1], c11 += a1 * b[1];                                                                    \
                c20 += a0 * b[2], c21 += a1 * b[2];                                                                    \
                c30 += a0 * b[3], c31 += a1 * b[3];                                                                    \
            }                                                                                                          \
            SBI_FRONT_PUT(lanes, to, c00), SBI_FRONT_PUT(lanes, to + width, c01), to += SBI_FRONT_GROUP;               \
            SBI_FRONT_PUT(lanes, to, c10), SBI_FRONT_PUT(lanes, to + width, c11), to += SBI_FRONT_GROUP;               \
            SBI_FRONT_PUT(lanes, to, c20), SBI_FRONT_PUT(lanes, to + width, c21), to += SBI_FRONT_GROUP;               \
            SBI_FRONT_PUT(lanes, to, c30), SBI_FRONT_PUT(lanes, to + width, c31);                                      \
        }                                                                                                              \
    }                                                                                                                  \
    SBI_FORCE_INLINE void sbi_front_subtract_##kind(sb_real *to, sb_real f, const sb_real *x, size_t count)            \
    {                                                                                                                  \
        const size_t width = sbi_front_width_##kind;                                                                   \
        size_t r = 0;                                                                                                  \
        for (; r + width <= count; r += width)                                                                         \
            SBI_FRONT_PUT(lanes, to + r, SBI_FRONT_AT(lanes, to + r) - SBI_FRONT_AT(lanes, x + r) * f);                \
        for (; r < count; r++)                                                                                         \
            to[r] -= x[r] * f;                                                                                         \
    }                                                                                                                  \
    SBI_FORCE_INLINE void sbi_front_solve_head_##kind(const sb_real *l, size_t height, sb_real *x)                     \
    {                                                                                                                  \
        const size_t row = SBI_FRONT_GROUP, width = sbi_front_width_##kind;                                            \
        for (size_t part = 0; part < row; part += width, x += width) {                                                 \
            lanes a = SBI_FRONT_AT(lanes, x) / l[0];                                                                   \
            lanes b = (SBI_FRONT_AT(lanes, x + row) - a * l[1]) / l[height + 1];                                       \
            SBI_FRONT_PUT(lanes, x, a);                                                                                \
            SBI_FRONT_PUT(lanes, x + row, b);                                                                          \
            SBI_FRONT_PUT(lanes, x + 2 * row,                                                                          \
                          (SBI_FRONT_AT(lanes, x + 2 * row) - a * l[2] - b * l[height + 2]) / l[2 * height + 2]);      \
        }                                                                                                              \
    }                                                                                                                  \
    SBI_FORCE_INLINE void sbi_front_solve_head_transposed_##kind(const sb_real *l, size_t height, sb_real *x)          \
    {                                                                                                                  \
        const size_t row = SBI_FRONT_GROUP, width = sbi_front_width_##kind;                                            \
        for (size_t part = 0; part < row; part += width, x += width) {                                                 \
            lanes c = SBI_FRONT_AT(lanes, x + 2 * row) / l[2 * height + 2];                                            \
            lanes b = (SBI_FRONT_AT(lanes, x + row) - c * l[height + 2]) / l[height + 1];                              \
            SBI_FRONT_PUT(lanes, x + 2 * row, c);                                                                      \
            SBI_FRONT_PUT(lanes, x + row, b);                                                                          \
            SBI_FRONT_PUT(lanes, x, (SBI_FRONT_AT(lanes, x) - b * l[1] - c * l[2]) / l[0]);                            \
        }                                                                                                              \
    }                                                                                                                  \
    SBI_FORCE_INLINE void sbi_front_forward_group_##kind(const sb_real *l, size_t height, size_t rows, sb_real *x)     \
    {                                                                                                                  \
        const size_t row = SBI_FRONT_GROUP, width = sbi_front_width_##kind;                                            \
        const sb_real *l1 = l + height, *l2 = l1 + height;                                                             \
        for (size_t part = 0; part < row; part += 2 * width, x += 2 * width) {                                         \
            lanes x0 = SBI_FRONT_AT(lanes, x), x1 = SBI_FRONT_AT(lanes, x + row);                                      \
            lanes x2 = SBI_FRONT_AT(lanes, x + 2 * row), y0 = SBI_FRONT_AT(lanes, x + width);                          \
            lanes y1 = SBI_FRONT_AT(lanes, x + row + width), y2 = SBI_FRONT_AT(lanes, x + 2 * row + width);            \
            for (size_t r = 3; r < rows; r++) {                                                                        \
                sb_real *at = x + r * row, a = l[r], b = l1[r], c = l2[r];                                             \
                SBI_FRONT_PUT(lanes, at, SBI_FRONT_AT(lanes, at) - x0 * a - x1 * b - x2 * c);                          \
                SBI_FRONT_PUT(lanes, at + width, SBI_FRONT_AT(lanes, at + width) - y0 * a - y1 * b - y2 * c);          \
            }                                                                                                          \
        }                                                                                                              \
    }                                                                                                                  \
    SBI_FORCE_INLINE void sbi_front_backward_group_##kind(const sb_real *l, size_t height, size_t rows, sb_real *x)    \
    {                                                                                                                  \
        const size_t row = SBI_FRONT_GROUP, width = sbi_front_width_##kind;                                            \
        const sb_real *l1 = l + height, *l2 = l1 + height;                                                             \
        for (size_t part = 0; part < row; part += 2 * width, x += 2 * width) {                                         \
            lanes s0 = SBI_FRONT_AT(lanes, x) - SBI_FRONT_AT(lanes, x), s1 = s0, s2 = s0, t0 = s0, t1 = s0, t2 = s0;   \
            for (size_t r = 3; r < rows; r++) {                                                                        \
                lanes value = SBI_FRONT_AT(lanes, x + r * row), other = SBI_FRONT_AT(lanes, x + r * row + width);      \
                sb_real a = l[r], b = l1[r], c = l2[r];                                                                \
                s0 += value * a, t0 += other * a;                                                                      \
                s1 += value * b, t1 += other * b;                                                                      \
                s2 += value * c, t2 += other * c;                                                                      \
            }                                                                                                          \
            SBI_FRONT_PUT(lanes, x, SBI_FRONT_AT(lanes, x) - s0);                                                      \
            SBI_FRONT_PUT(lanes, x + width, SBI_FRONT_AT(lanes, x + width) - t0);                                      \
            SBI_FRONT_PUT(lanes, x + row, SBI_FRONT_AT(lanes, x + row) - s1);                                          \
            SBI_FRONT_PUT(lanes, x + row + width, SBI_FRONT_AT(lanes, x + row + width) - t1);                          \
            SBI_FRONT_PUT(lanes, x + 2 * row, SBI_FRONT_AT(lanes, x + 2 * row) - s2);                                  \
            SBI_FRONT_PUT(lanes, x + 2 * row + width, SBI_FRONT_AT(lanes, x + 2 * row + width) - t2);                  \
        }                                                                                                              \
    }

SBI_FRONT_KERNELS(wide, sbi_front_lanes)
#if SBI_IS_WIDENED
SBI_FRONT_KERNELS(narrow, sbi_front_pair)
#endif
#else
SBI_FORCE_INLINE void sbi_front_tile_wide(const sb_real *a, const sb_real *b, size_t stride, int depth, sb_real *tile)
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

SBI_FORCE_INLINE void sbi_front_subtract_wide(sb_real *to, sb_real f, const sb_real *x, size_t count)
{
    for (size_t r = 0; r < count; r++)
        to[r] -= x[r] * f;
}

SBI_FORCE_INLINE void sbi_front_solve_head_wide(const sb_real *l, size_t height, sb_real *x)
{
    for (int g = 0; g < SBI_FRONT_GROUP; g++) {
        sb_real *y = x + g, *z = y + SBI_FRONT_GROUP, *w = z + SBI_FRONT_GROUP;
        *y = *y / l[0];
        *z = (*z - l[1] * *y) / l[height + 1];
        *w = (*w - l[2] * *y - l[height + 2] * *z) / l[2 * height + 2];
    }
}

SBI_FORCE_INLINE void sbi_front_solve_head_transposed_wide(const sb_real *l, size_t height, sb_real *x)
{
    for (int g = 0; g < SBI_FRONT_GROUP; g++) {
        sb_real *y = x + g, *z = y + SBI_FRONT_GROUP, *w = z + SBI_FRONT_GROUP;
        *w = *w / l[2 * height + 2];
        *z = (*z - l[height + 2] * *w) / l[height + 1];
        *y = (*y - l[1] * *z - l[2] * *w) / l[0];
    }
}

SBI_FORCE_INLINE void sbi_front_forward_group_wide(const sb_real *l, size_t height, size_t rows, sb_real *x)
{
    for (size_t r = 3; r < rows; r++)
        for (int g = 0; g < SBI_FRONT_GROUP; g++) {
            sb_real *at = x + r * SBI_FRONT_GROUP + g;
            *at = *at - l[r] * x[g] - l[height + r] * x[SBI_FRONT_GROUP + g] -
                  l[2 * height + r] * x[2 * SBI_FRONT_GROUP + g];
        }
}

SBI_FORCE_INLINE void sbi_front_backward_group_wide(const sb_real *l, size_t height, size_t rows, sb_real *x)
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

/* The one of the two. */
#if SBI_IS_WIDENED && SBI_FRONT_BYTES
#define SBI_FRONT_SELECT(wide, name, arguments)                                                                        \
    if (wide)                                                                                                          \
        sbi_front_##name##_wide arguments;                                                                             \
    else                                                                                                               \
        sbi_front_##name##_narrow arguments
#else
#define SBI_FRONT_SELECT(wide, name, arguments) ((void)(wide), sbi_front_##name##_wide arguments)
#endif

SBI_FORCE_INLINE void sbi_front_tile(int wide, const sb_real *a, const sb_real *b, size_t stride, int depth,
                                     sb_real *tile)
{
    SBI_FRONT_SELECT(wide, tile, (a, b, stride, depth, tile));
}

SBI_FORCE_INLINE void sbi_front_subtract(int wide, sb_real *to, sb_real f, const sb_real *x, size_t count)
{
    SBI_FRONT_SELECT(wide, subtract, (to, f, x, count));
}

SBI_FORCE_INLINE void sbi_front_solve_head(int wide, const sb_real *l, size_t height, sb_real *x)
{
    SBI_FRONT_SELECT(wide, solve_head, (l, height, x));
}

SBI_FORCE_INLINE void sbi_front_solve_head_transposed(int wide, const sb_real *l, size_t height, sb_real *x)
{
    SBI_FRONT_SELECT(wide, solve_head_transposed, (l, height, x));
}

SBI_FORCE_INLINE void sbi_front_forward_group(int wide, const sb_real *l, size_t height, size_t rows, sb_real *x)
{
    SBI_FRONT_SELECT(wide, forward_group, (l, height, rows, x));
}

SBI_FORCE_INLINE void sbi_front_backward_group(int wide, const sb_real *l, size_t height, size_t rows, sb_real *x)
{
    SBI_FRONT_SELECT(wide, backward_group, (l, height, rows, x));
}

#endif /* SB_DIRECT_LANES_H */
