/* block: see block.h. */
#include "block.h"

#include <string.h>

#if defined(__GNUC__) && !defined(SB_NO_VECTORS)
typedef double regi_block_pair_lanes __attribute__((vector_size(16), aligned(sizeof(double)), may_alias));
typedef double regi_block_quad_lanes __attribute__((vector_size(32), aligned(sizeof(double)), may_alias));
#define REGI_BLOCK_AT(lanes, pointer) (*(const lanes *)(const void *)(pointer))
#define REGI_BLOCK_PUT(lanes, pointer, value) (*(lanes *)(void *)(pointer) = (value))

/* tile[4][8]: the sums of i and j on, for a type of vectors: two of them at a time, as many as the registers hold. */
#define REGI_BLOCK_TILE(kind, lanes)                                                                                   \
    SBI_FORCE_INLINE void regi_block_tile_##kind(const regi_block *b, int i, int j, double *tile)                      \
    {                                                                                                                  \
        enum { WIDTH = (int)(sizeof(lanes) / sizeof(double)) };                                                        \
        for (int part = 0; part < REGI_BLOCK_WIDTH; part += 2 * WIDTH) {                                               \
            const double *left = b->left + i + part, *r0 = b->right + (size_t)j * b->right_stride;                     \
            const double *r1 = r0 + b->right_stride, *r2 = r1 + b->right_stride, *r3 = r2 + b->right_stride;           \
            double *to = tile + part;                                                                                  \
            lanes c00 = {0}, c01 = c00, c10 = c00, c11 = c00, c20 = c00, c21 = c00, c30 = c00, c31 = c00;              \
            size_t step = b->right_step;                                                                               \
            for (int k = 0; k < b->depth; k++, left += b->left_stride) {                                               \
                lanes x = REGI_BLOCK_AT(lanes, left), y = REGI_BLOCK_AT(lanes, left + WIDTH);                          \
                c00 += x * *r0, c01 += y * *r0, r0 += step;                                                            \
                c10 += x * *r1, c11 += y * *r1, r1 += step;                                                            \
                c20 += x * *r2, c21 += y * *r2, r2 += step;                                                            \
                c30 += x * *r3, c31 += y * *r3, r3 += step;                                                            \
            }                                                                                                          \
            REGI_BLOCK_PUT(lanes, to, c00), REGI_BLOCK_PUT(lanes, to + WIDTH, c01), to += REGI_BLOCK_WIDTH;            \
            REGI_BLOCK_PUT(lanes, to, c10), REGI_BLOCK_PUT(lanes, to + WIDTH, c11), to += REGI_BLOCK_WIDTH;            \
            REGI_BLOCK_PUT(lanes, to, c20), REGI_BLOCK_PUT(lanes, to + WIDTH, c21), to += REGI_BLOCK_WIDTH;            \
            REGI_BLOCK_PUT(lanes, to, c30), REGI_BLOCK_PUT(lanes, to + WIDTH, c31);                                    \
        }                                                                                                              \
    }

#if defined(__AVX__) || SBI_IS_WIDENED
REGI_BLOCK_TILE(quads, regi_block_quad_lanes)
#endif
#if !defined(__AVX__)
REGI_BLOCK_TILE(pairs, regi_block_pair_lanes)
#endif

SBI_FORCE_INLINE void regi_block_tile(int wide, const regi_block *b, int i, int j, double *tile)
{
#if defined(__AVX__)
    (void)wide;
    regi_block_tile_quads(b, i, j, tile);
#elif SBI_IS_WIDENED
    if (wide)
        regi_block_tile_quads(b, i, j, tile);
    else
        regi_block_tile_pairs(b, i, j, tile);
#else
    (void)wide;
    regi_block_tile_pairs(b, i, j, tile);
#endif
}
#else
SBI_FORCE_INLINE void regi_block_tile(int wide, const regi_block *b, int i, int j, double *tile)
{
    (void)wide;
    memset(tile, 0, REGI_BLOCK_ROWS * REGI_BLOCK_WIDTH * sizeof *tile);
    for (int k = 0; k < b->depth; k++)
        for (int r = 0; r < REGI_BLOCK_ROWS; r++) {
            double right = b->right[(size_t)k * b->right_step + (size_t)(j + r) * b->right_stride];
            const double *left = b->left + (size_t)k * b->left_stride + i;
            for (int c = 0; c < REGI_BLOCK_WIDTH; c++)
                tile[r * REGI_BLOCK_WIDTH + c] += left[c] * right;
        }
}
#endif

/* tile[8][8], two tiles: as vectors of eight they are one to a row, and eight sums hide how long an addition takes. */
#if defined(__GNUC__) && !defined(SB_NO_VECTORS) && defined(__AVX512F__)
typedef double regi_block_row __attribute__((vector_size(64), aligned(sizeof(double)), may_alias));

SBI_FORCE_INLINE void regi_block_pair(int wide, const regi_block *b, int i, int j, double *tile)
{
    const double *left = b->left + i, *r0 = b->right + (size_t)j * b->right_stride, *r4 = r0 + 4 * b->right_stride;
    size_t one = b->right_stride, two = 2 * one, three = 3 * one;
    regi_block_row c0 = {0}, c1 = c0, c2 = c0, c3 = c0, c4 = c0, c5 = c0, c6 = c0, c7 = c0, *to;
    for (int k = 0; k < b->depth; k++, left += b->left_stride, r0 += b->right_step, r4 += b->right_step) {
        regi_block_row x = *(const regi_block_row *)(const void *)left;
        c0 += x * r0[0], c1 += x * r0[one], c2 += x * r0[two], c3 += x * r0[three];
        c4 += x * r4[0], c5 += x * r4[one], c6 += x * r4[two], c7 += x * r4[three];
    }
    (void)wide;
    to = (regi_block_row *)(void *)tile;
    to[0] = c0, to[1] = c1, to[2] = c2, to[3] = c3, to[4] = c4, to[5] = c5, to[6] = c6, to[7] = c7;
}
#else
SBI_FORCE_INLINE void regi_block_pair(int wide, const regi_block *b, int i, int j, double *tile)
{
    regi_block_tile(wide, b, i, j, tile);
    regi_block_tile(wide, b, i, j + REGI_BLOCK_ROWS, tile + REGI_BLOCK_ROWS * REGI_BLOCK_WIDTH);
}
#endif

/* The sums of i, j on that do not fill a tile. */
SBI_FORCE_INLINE void regi_block_rest(const regi_block *b, int i, int width, int j, int rows, double *tile)
{
    memset(tile, 0, (size_t)(rows * REGI_BLOCK_WIDTH) * sizeof *tile);
    for (int k = 0; k < b->depth; k++)
        for (int r = 0; r < rows; r++) {
            double right = b->right[(size_t)k * b->right_step + (size_t)(j + r) * b->right_stride];
            const double *left = b->left + (size_t)k * b->left_stride + i;
            for (int c = 0; c < width; c++)
                tile[r * REGI_BLOCK_WIDTH + c] += left[c] * right;
        }
}

SBI_FORCE_INLINE void regi_block_add_any_lanes(int wide, const regi_block *b, int width, int rows, double factor,
                                               double *to, size_t stride)
{
    double tile[2 * (int)REGI_BLOCK_ROWS * (int)REGI_BLOCK_WIDTH];
    for (int j = 0, high; j < rows; j += high) {
        high = rows - j < 2 * REGI_BLOCK_ROWS ? sbi_min_int(REGI_BLOCK_ROWS, rows - j) : 2 * REGI_BLOCK_ROWS;
        for (int i = 0; i < width; i += REGI_BLOCK_WIDTH) {
            int have = sbi_min_int(REGI_BLOCK_WIDTH, width - i);
            if (high > REGI_BLOCK_ROWS && have == REGI_BLOCK_WIDTH)
                regi_block_pair(wide, b, i, j, tile);
            else if (high == REGI_BLOCK_ROWS && have == REGI_BLOCK_WIDTH)
                regi_block_tile(wide, b, i, j, tile);
            else
                regi_block_rest(b, i, have, j, high, tile);
            for (int r = 0; r < high; r++)
                for (int c = 0; c < have; c++)
                    to[(size_t)(j + r) * stride + (size_t)(i + c)] += factor * tile[r * REGI_BLOCK_WIDTH + c];
        }
    }
}

SBI_WIDEN_IF(regi_block_add_any, (const regi_block *b, int width, int rows, double factor, double *to, size_t stride),
             (b, width, rows, factor, to, stride))

REGI_API void regi_block_add(const regi_block *b, int width, int rows, double factor, double *to, size_t stride)
{
    regi_block_add_any(b->wide, b, width, rows, factor, to, stride);
}

REGI_API void regi_block_forward(int wide, const double *u, int n, size_t stride, double *x)
{
    for (int first = 0; first < n; first += REGI_BLOCK_ROWS) {
        int rows = sbi_min_int(REGI_BLOCK_ROWS, n - first);
        regi_block before = {x, u + first, REGI_BLOCK_WIDTH, 0, 1, 0, 0};
        before.wide = wide;
        before.right_step = stride;
        before.depth = first;
        regi_block_add(&before, REGI_BLOCK_WIDTH, rows, -1, x + (size_t)first * REGI_BLOCK_WIDTH, REGI_BLOCK_WIDTH);
        for (int k = first; k < first + rows; k++)
            for (int c = 0; c < REGI_BLOCK_WIDTH; c++) {
                double *at = x + (size_t)k * REGI_BLOCK_WIDTH + c;
                *at /= u[(size_t)k * stride + (size_t)k];
                for (int r = k + 1; r < first + rows; r++)
                    x[(size_t)r * REGI_BLOCK_WIDTH + (size_t)c] -= u[(size_t)k * stride + (size_t)r] * *at;
            }
    }
}

REGI_API void regi_block_backward(int wide, const double *u, int n, size_t stride, double *x)
{
    for (int first = (n - 1) / REGI_BLOCK_ROWS * REGI_BLOCK_ROWS; first >= 0; first -= REGI_BLOCK_ROWS) {
        int next = sbi_min_int(first + REGI_BLOCK_ROWS, n);
        regi_block after = {x + (size_t)next * REGI_BLOCK_WIDTH, NULL, REGI_BLOCK_WIDTH, 1, 0, 0, 0};
        after.wide = wide;
        after.right = u + (size_t)first * stride + (size_t)next;
        after.right_stride = stride;
        after.depth = n - next;
        regi_block_add(&after, REGI_BLOCK_WIDTH, next - first, -1, x + (size_t)first * REGI_BLOCK_WIDTH,
                       REGI_BLOCK_WIDTH);
        for (int k = next - 1; k >= first; k--)
            for (int c = 0; c < REGI_BLOCK_WIDTH; c++) {
                double *at = x + (size_t)k * REGI_BLOCK_WIDTH + c;
                for (int r = k + 1; r < next; r++)
                    *at -= u[(size_t)k * stride + (size_t)r] * x[(size_t)r * REGI_BLOCK_WIDTH + (size_t)c];
                *at /= u[(size_t)k * stride + (size_t)k];
            }
    }
}
