/* precond: factors and the coarse space of rigid pieces. */
#include "precond.h"

#include <float.h>
#include <limits.h>
#include <math.h>
#include <string.h>

/* ---- four floats ------------------------------------------------------------------------------------------
 * Blocks are stored as three rows of four floats, the fourth unused (0), so that a row is one vector. The
 * compiler's own vectors where it has them, else plain code with the same roundings. */

#if defined(__GNUC__) && !defined(SB_NO_VECTORS)
#define SBI_HAS_FLOAT4 1
typedef float sbi_float4 __attribute__((vector_size(16), may_alias));
#define SBI_F4(v, k) ((v)[k])
#else
#define SBI_HAS_FLOAT4 0
typedef struct sbi_float4 {
    float lane[4];
} sbi_float4;
#define SBI_F4(v, k) ((v).lane[k])
#endif

SBI_FORCE_INLINE sbi_float4 sbi_f4_make(float a, float b, float c)
{
#if SBI_HAS_FLOAT4
    sbi_float4 v = {a, b, c, 0};
#else
    sbi_float4 v = {{a, b, c, 0}};
#endif
    return v;
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_load(const float *from) { return *(const sbi_float4 *)(const void *)from; }
SBI_FORCE_INLINE void sbi_f4_store(float *to, sbi_float4 v) { *(sbi_float4 *)(void *)to = v; }

SBI_FORCE_INLINE sbi_float4 sbi_f4_add(sbi_float4 a, sbi_float4 b)
{
#if SBI_HAS_FLOAT4
    return a + b;
#else
    for (int k = 0; k < 4; k++)
        a.lane[k] += b.lane[k];
    return a;
#endif
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_sub(sbi_float4 a, sbi_float4 b)
{
#if SBI_HAS_FLOAT4
    return a - b;
#else
    for (int k = 0; k < 4; k++)
        a.lane[k] -= b.lane[k];
    return a;
#endif
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_mul(sbi_float4 a, sbi_float4 b)
{
#if SBI_HAS_FLOAT4
    return a * b;
#else
    for (int k = 0; k < 4; k++)
        a.lane[k] *= b.lane[k];
    return a;
#endif
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_scale(float s, sbi_float4 a)
{
#if SBI_HAS_FLOAT4
    return a * s;
#else
    for (int k = 0; k < 4; k++)
        a.lane[k] *= s;
    return a;
#endif
}

/* a[0] m.row0 + a[1] m.row1 + a[2] m.row2 = m^T a */
SBI_FORCE_INLINE sbi_float4 sbi_f4_rows(sbi_float4 a, const float *m)
{
    return sbi_f4_add(sbi_f4_add(sbi_f4_scale(SBI_F4(a, 0), sbi_f4_load(m)),
                                 sbi_f4_scale(SBI_F4(a, 1), sbi_f4_load(m + 4))),
                      sbi_f4_scale(SBI_F4(a, 2), sbi_f4_load(m + 8)));
}

SBI_FORCE_INLINE float sbi_f4_sum(sbi_float4 a) { return SBI_F4(a, 0) + SBI_F4(a, 1) + SBI_F4(a, 2); }

/* Row of three reals, rounded after scaling. sbi_f4_round_row may read a fourth and leave anything in that
 * lane: for rows of matrix blocks, whose fourth lane never reaches a result. */
SBI_FORCE_INLINE sbi_float4 sbi_f4_round(const sb_real *from, sb_real scale)
{
    return sbi_f4_make((float)(from[0] * scale), (float)(from[1] * scale), (float)(from[2] * scale));
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_round_row(const sb_real *from, sb_real scale)
{
#if SBI_HAS_LANES && SB_REAL_IS_FLOAT
    return SBI_LANES_AT(from) * scale;
#elif SBI_HAS_LANES && (defined(__clang__) || __GNUC__ >= 9)
    return __builtin_convertvector(SBI_LANES_AT(from) * scale, sbi_float4);
#else
    return sbi_f4_round(from, scale);
#endif
}

/* ---- the object ---------------------------------------------------------------------------------------- */

enum {
    SBI_PRECOND_MAX_ARRAYS = 32,
    SBI_PRECOND_MAX_ATTEMPTS = 18,
    SBI_PRECOND_MAX_SHIFT = 64, /* beyond a row's length the shifted matrix is dominated by its diagonal, so that the
                                 * factor of any positive definite one exists */
    SBI_PRECOND_RELAX_FIRST = 16,  /* successful updates before a shift is halved on trial */
    SBI_PRECOND_RELAX_LAST = 1024, /* the wait doubles with every failed trial up to this */
    SBI_PRECOND_NODES_PER_PIECE = 85,
    SBI_PRECOND_MAX_PIECES = 64,
    SBI_PRECOND_MULTIGRID_ROWS = 5000
};

/* The pieces' motions. Piece a has the 6 coarse unknowns 6a .. 6a+5: a translation and a rotation about its
 * centre, in units of its radius, so that both have the size of a displacement. (A Z) is stored by piece:
 * entry e couples piece a (piece_entry[a] <= e < piece_entry[a + 1]) with node entry_node[e], one of its own
 * or next to it. */
typedef struct sbi_precond_coarse {
    int piece_count, size; /* size = 6 piece_count */
    int *piece_start;      /* [piece_count + 1] into piece_nodes */
    int *piece_nodes;      /* [row_count] nodes by piece */
    int *piece_of;         /* [row_count] */
    int *piece_entry;      /* [piece_count + 1] */
    int *entry_node;       /* [entries] */
    int *entry_start;      /* [entries + 1] into entry_blocks */
    int *entry_blocks;     /* [block_count] matrix blocks (node, j) with j in the piece */
    sb_real *places;       /* [row_count][4] position relative to the piece's centre over its radius */
    float *arms;           /* [row_count][4] the same, rounded */
    float *free;           /* [row_count][4] 1 for free components, 0 for prescribed ones */
    float *coupling;       /* [entries][6][4] rows x, y, z of A Z: translations, then rotations */
    double *matrix;        /* [size][size] upper triangle: Z^T A Z, then its Cholesky factor */
    double *inverse;       /* [size] inverse pivots, 0 for motions that the pieces do not have */
    double *solution;      /* [size] */
    sb_vec3 *positions;    /* [row_count] as last given */
} sbi_precond_coarse;

struct sb_preconditioner {
    sb_allocator allocator;
    sb_jobs jobs;
    sb_precond_kind kind;
    int row_count, block_count, lower_count;
    double matrix_scale; /* power of two that brings the mean diagonal near 1 */
    /* lower triangle by rows */
    int *start;     /* [row_count + 1] */
    int *columns;   /* [lower_count] node j < i */
    int *source;    /* [lower_count] matrix block (j, i) */
    float *lower;   /* [lower_count][12] L of M = (I + L) D (I + L)^T */
    float *inverse; /* [row_count][12] D^-1 */
    float *middle;  /* [row_count][4] (I + L)^-1 r */
    float *result;  /* [row_count][4] z, scaled */
    /* IC0: for each block (i, j) the pairs (i, m), (j, m) with m < j: place in row i, index of the block (j,
     * m) */
    size_t *pair_start; /* [lower_count + 1] */
    int *pairs;         /* [pairs][2] */
    float *row;         /* [longest row][12] transposed blocks of the row at work */
    int attempts, successes, wait;
    double shift;
    sbi_precond_coarse coarse;
    sbi_multigrid *multigrid;
    size_t bytes;
    int array_count;
    void *arrays[SBI_PRECOND_MAX_ARRAYS];
};

/* An array of the object on a cache line boundary; NULL when there is no memory. */
static void *sbi_precond_take(sb_preconditioner *p, size_t count, size_t size)
{
    size_t bytes = 64;
    void *raw;
    if (!sbi_size_add(&bytes, count, size))
        return NULL;
    raw = sbi_alloc(&p->allocator, bytes, 1);
    if (!raw)
        return NULL;
    p->arrays[p->array_count++] = raw;
    p->bytes += bytes;
    return (char *)raw + (64 - (uintptr_t)raw % 64) % 64;
}

static int *sbi_precond_take_ints(sb_preconditioner *p, size_t count)
{
    return (int *)sbi_precond_take(p, count, sizeof(int));
}

static float *sbi_precond_take_floats(sb_preconditioner *p, size_t count, size_t width)
{
    return (float *)sbi_precond_take(p, count, width * sizeof(float));
}

SB_API void sb_preconditioner_free(sb_preconditioner *preconditioner)
{
    sb_allocator allocator;
    if (!preconditioner)
        return;
    allocator = preconditioner->allocator;
    sbi_multigrid_free(preconditioner->multigrid);
    for (int k = 0; k < preconditioner->array_count; k++)
        sbi_free(&allocator, preconditioner->arrays[k]);
    sbi_free(&allocator, preconditioner);
}

/* ---- the lower triangle -------------------------------------------------------------------------------- */

static int sbi_precond_make_lower(sb_preconditioner *p, const sb_matrix *a)
{
    size_t rows = (size_t)p->row_count, lower = (size_t)p->lower_count;
    p->start = sbi_precond_take_ints(p, rows + 1);
    p->columns = sbi_precond_take_ints(p, lower);
    p->source = sbi_precond_take_ints(p, lower);
    p->lower = sbi_precond_take_floats(p, lower, 12);
    if (!p->start || !p->columns || !p->source || !p->lower)
        return 0;
    p->start[0] = 0;
    for (int i = 0, e = 0; i < p->row_count; i++) {
        for (int q = a->row_start[i]; q < a->diagonal[i]; q++, e++) {
            p->columns[e] = a->columns[q];
            p->source[e] = a->transpose[q];
        }
        p->start[i + 1] = e;
    }
    return 1;
}

/* Walks all pairs of the factorisation; counts them, and writes them when `pairs` is not NULL. place
 * [row_count] is scratch of -1. */
static size_t sbi_precond_list_pairs(const sb_preconditioner *p, int *place, size_t *pair_start, int *pairs)
{
    size_t total = 0;
    for (int i = 0; i < p->row_count; i++) {
        for (int e = p->start[i]; e < p->start[i + 1]; e++) {
            int j = p->columns[e];
            if (pairs)
                pair_start[e] = total;
            /* columns ascend, so place[] holds the m < j of row i when (i, j) is met */
            for (int b = p->start[j]; b < p->start[j + 1]; b++) {
                if (place[p->columns[b]] < 0)
                    continue;
                if (pairs) {
                    pairs[2 * total] = place[p->columns[b]];
                    pairs[2 * total + 1] = b;
                }
                total++;
            }
            place[j] = e - p->start[i];
        }
        for (int e = p->start[i]; e < p->start[i + 1]; e++)
            place[p->columns[e]] = -1;
    }
    if (pairs)
        pair_start[p->lower_count] = total;
    return total;
}

static int sbi_precond_make_pairs(sb_preconditioner *p)
{
    int *place = (int *)sbi_alloc(&p->allocator, (size_t)p->row_count, sizeof(int)), longest = 0;
    size_t total;
    if (!place)
        return 0;
    for (int i = 0; i < p->row_count; i++) {
        place[i] = -1;
        longest = p->start[i + 1] - p->start[i] > longest ? p->start[i + 1] - p->start[i] : longest;
    }
    total = sbi_precond_list_pairs(p, place, NULL, NULL);
    p->pair_start = (size_t *)sbi_precond_take(p, (size_t)p->lower_count + 1, sizeof(size_t));
    p->pairs = (int *)sbi_precond_take(p, total, 2 * sizeof(int));
    p->row = sbi_precond_take_floats(p, (size_t)longest, 12);
    if (p->pair_start && p->pairs && p->row)
        sbi_precond_list_pairs(p, place, p->pair_start, p->pairs);
    sbi_free(&p->allocator, place);
    return p->pair_start && p->pairs && p->row;
}

/* ---- factorisations ------------------------------------------------------------------------------------ */

/* Inverse of a symmetric 3x3 matrix (row-major with rows of 4) when its pivots exceed `least`[k]; else 0. */
static int sbi_precond_invert(const sbi_float4 *d, const float *least, float *inverse)
{
    double a00 = (double)SBI_F4(d[0], 0), a01 = (double)SBI_F4(d[0], 1), a02 = (double)SBI_F4(d[0], 2);
    double a11 = (double)SBI_F4(d[1], 1), a12 = (double)SBI_F4(d[1], 2), a22 = (double)SBI_F4(d[2], 2);
    double c00 = a11 * a22 - a12 * a12, c01 = a02 * a12 - a01 * a22, c02 = a01 * a12 - a02 * a11;
    double minor = a00 * a11 - a01 * a01, det = a00 * c00 + a01 * c01 + a02 * c02, f;
    /* pivots of the elimination: a00, minor / a00, det / minor; comparisons are false for NaN */
    if (!(a00 > (double)least[0] && minor > (double)least[1] * a00 && det > (double)least[2] * minor))
        return 0;
    f = 1 / det;
    sbi_f4_store(inverse, sbi_f4_make((float)(c00 * f), (float)(c01 * f), (float)(c02 * f)));
    sbi_f4_store(inverse + 4, sbi_f4_make((float)(c01 * f), (float)((a00 * a22 - a02 * a02) * f),
                                          (float)((a01 * a02 - a00 * a12) * f)));
    sbi_f4_store(inverse + 8,
                 sbi_f4_make((float)(c02 * f), (float)((a01 * a02 - a00 * a12) * f), (float)(minor * f)));
    return 1;
}

/* Diagonal block i times `factor` in d; smallest pivots that still mean something in `least`. */
SBI_FORCE_INLINE void sbi_precond_diagonal(const sb_preconditioner *p, const sb_matrix *a, int i,
                                           double factor, sbi_float4 *d, float *least)
{
    const sb_real *block = a->blocks[a->diagonal[i]];
    for (int r = 0; r < 3; r++) {
        float diagonal = (float)((double)block[4 * r] * p->matrix_scale * factor);
        d[r] = sbi_f4_round_row(block + 3 * r, (sb_real)p->matrix_scale);
        SBI_F4(d[r], r) = diagonal;
        least[r] = diagonal > 0 ? 64 * FLT_EPSILON * diagonal : 0;
    }
}

/* Node whose diagonal block is not positive definite, or -1. */
static int sbi_precond_invert_diagonals(sb_preconditioner *p, const sb_matrix *a)
{
    for (int i = 0; i < p->row_count; i++) {
        sbi_float4 d[3];
        float least[3];
        sbi_precond_diagonal(p, a, i, 1, d, least);
        if (!sbi_precond_invert(d, least, p->inverse + 12 * (size_t)i))
            return i;
    }
    return -1;
}

/* SSOR: M = (D + w L_A) D^-1 (D + w L_A)^T up to a factor, hence L = w L_A D^-1. */
static void sbi_precond_fill_ssor(sb_preconditioner *p, const sb_matrix *a)
{
    const sb_real relaxation = (sb_real)1.3; /* flat optimum: 1.0 to 1.6 differ by a few iterations */
    sb_real scale = (sb_real)p->matrix_scale * relaxation;
    for (int e = 0; e < p->lower_count; e++) {
        const sb_real *upper = a->blocks[p->source[e]]; /* (j, i): its columns are the rows of (i, j) */
        const float *inverse = p->inverse + 12 * (size_t)p->columns[e];
        sbi_float4 u0 = sbi_f4_round_row(upper, scale), u1 = sbi_f4_round_row(upper + 3, scale);
        sbi_float4 u2 = sbi_f4_round_row(upper + 6, scale);
        float *out = p->lower + 12 * (size_t)e;
        for (int r = 0; r < 3; r++)
            sbi_f4_store(out + 4 * r,
                         sbi_f4_rows(sbi_f4_make(SBI_F4(u0, r), SBI_F4(u1, r), SBI_F4(u2, r)), inverse));
    }
}

/* Block e = (i, j) of row i, whose transposed unscaled blocks are in `row` as U_im = L_im D_m:
 * U_ij = A_ij - sum_m U_im L_jm^T, L_ij = U_ij D_j^-1, D_i -= L_ij U_ij^T. */
SBI_FORCE_INLINE void sbi_precond_eliminate(sb_preconditioner *p, const sb_matrix *a, int e, float *out_row,
                                            sbi_float4 *d)
{
    const sb_real *upper = a->blocks[p->source[e]];
    sb_real scale = (sb_real)p->matrix_scale;
    sbi_float4 u0 = sbi_f4_round_row(upper, scale), u1 = sbi_f4_round_row(upper + 3, scale);
    sbi_float4 u2 = sbi_f4_round_row(upper + 6, scale);
    const float *inverse = p->inverse + 12 * (size_t)p->columns[e];
    float *l = p->lower + 12 * (size_t)e;
    for (size_t k = p->pair_start[e]; k < p->pair_start[e + 1]; k++) {
        const float *ut = p->row + 12 * (size_t)p->pairs[2 * k],
                    *b = p->lower + 12 * (size_t)p->pairs[2 * k + 1];
        u0 = sbi_f4_sub(u0, sbi_f4_rows(sbi_f4_load(b), ut));
        u1 = sbi_f4_sub(u1, sbi_f4_rows(sbi_f4_load(b + 4), ut));
        u2 = sbi_f4_sub(u2, sbi_f4_rows(sbi_f4_load(b + 8), ut));
    }
    sbi_f4_store(out_row, u0);
    sbi_f4_store(out_row + 4, u1);
    sbi_f4_store(out_row + 8, u2);
    for (int r = 0; r < 3; r++) {
        sbi_float4 row = sbi_f4_rows(sbi_f4_make(SBI_F4(u0, r), SBI_F4(u1, r), SBI_F4(u2, r)), inverse);
        sbi_f4_store(l + 4 * r, row);
        d[r] = sbi_f4_sub(d[r], sbi_f4_rows(row, out_row));
    }
}

/* Block IC(0) of A with its diagonal times 1 + shift: node of the first bad pivot, or -1. */
static int sbi_precond_factor(sb_preconditioner *p, const sb_matrix *a, double shift)
{
    for (int i = 0; i < p->row_count; i++) {
        sbi_float4 d[3];
        float least[3];
        sbi_precond_diagonal(p, a, i, 1 + shift, d, least);
        for (int e = p->start[i]; e < p->start[i + 1]; e++)
            sbi_precond_eliminate(p, a, e, p->row + 12 * (size_t)(e - p->start[i]), d);
        if (!sbi_precond_invert(d, least, p->inverse + 12 * (size_t)i))
            return i;
    }
    return -1;
}

/* Shifts: 0, 0.001, 0.002 ... */
static double sbi_precond_lower_shift(double shift) { return shift > 1.5e-3 ? shift / 2 : 0; }

static sb_result sbi_precond_update_ic0(sb_preconditioner *p, const sb_matrix *a, sb_error *error)
{
    int relaxing = p->shift > 0 && p->successes >= p->wait, bad = 0;
    double shift = relaxing ? sbi_precond_lower_shift(p->shift) : p->shift;
    for (p->attempts = 1; p->attempts <= SBI_PRECOND_MAX_ATTEMPTS; p->attempts++) {
        bad = sbi_precond_factor(p, a, shift);
        if (bad < 0 || shift > (double)SBI_PRECOND_MAX_SHIFT)
            break;
        shift = shift * 2 > 1e-3 ? shift * 2 : 1e-3;
    }
    if (bad >= 0) {
        p->shift = 0; /* the next matrix may be a tamer one */
        return sbi_fail_node(error, SB_ERROR_INDEFINITE, bad, "node %d: no incomplete factor up to a shift of %g", bad,
                             shift);
    }
    if (p->attempts > 1) {
        p->wait = relaxing && p->wait < SBI_PRECOND_RELAX_LAST ? 2 * p->wait : p->wait;
        p->successes = 0;
    } else {
        p->successes = relaxing ? 0 : p->successes + (p->successes < INT_MAX);
    }
    p->shift = shift;
    return SB_OK;
}

/* ---- pieces -------------------------------------------------------------------------------------------- */

SBI_FORCE_INLINE sb_real sbi_precond_coordinate(const sb_vec3 *positions, int node, int axis)
{
    return axis == 0 ? positions[node].x : axis == 1 ? positions[node].y : positions[node].z;
}

/* Order along an axis; ties by index, so that the cut is the same everywhere. */
static int sbi_precond_before(const sb_vec3 *positions, int axis, int a, int b)
{
    sb_real xa = sbi_precond_coordinate(positions, a, axis), xb = sbi_precond_coordinate(positions, b, axis);
    return xa < xb || (xa == xb && a < b);
}

static void sbi_precond_sift(const sb_vec3 *positions, int axis, int *nodes, int root, int count)
{
    int node = nodes[root];
    for (int child = 2 * root + 1; child < count; child = 2 * root + 1) {
        if (child + 1 < count && sbi_precond_before(positions, axis, nodes[child], nodes[child + 1]))
            child++;
        if (!sbi_precond_before(positions, axis, node, nodes[child]))
            break;
        nodes[root] = nodes[child];
        root = child;
    }
    nodes[root] = node;
}

static void sbi_precond_sort_nodes(const sb_vec3 *positions, int axis, int *nodes, int count)
{
    for (int root = count / 2; root-- > 0;)
        sbi_precond_sift(positions, axis, nodes, root, count);
    for (int last = count - 1; last > 0; last--) {
        int top = nodes[0];
        nodes[0] = nodes[last];
        nodes[last] = top;
        sbi_precond_sift(positions, axis, nodes, 0, last);
    }
}

static int sbi_precond_longest_axis(const sb_vec3 *positions, const int *nodes, int count)
{
    sb_real extent[3];
    for (int axis = 0; axis < 3; axis++) {
        sb_real low = sbi_precond_coordinate(positions, nodes[0], axis), high = low;
        for (int k = 1; k < count; k++) {
            sb_real x = sbi_precond_coordinate(positions, nodes[k], axis);
            low = x < low ? x : low;
            high = x > high ? x : high;
        }
        extent[axis] = high - low;
    }
    return extent[1] > extent[0] ? (extent[2] > extent[1] ? 2 : 1) : (extent[2] > extent[0] ? 2 : 0);
}

/* Cuts nodes[begin, end) into `pieces` parts of equal size by halving across the longest side; returns the
 * number of the next piece. */
static int sbi_precond_cut(sbi_precond_coarse *c, int begin, int end, int pieces, int piece)
{
    int left = pieces / 2, middle = begin + (int)((long long)(end - begin) * left / pieces);
    int *nodes = c->piece_nodes + begin;
    if (pieces == 1) {
        c->piece_start[piece] = begin;
        for (int k = begin; k < end; k++)
            c->piece_of[c->piece_nodes[k]] = piece;
        return piece + 1;
    }
    sbi_precond_sort_nodes(c->positions, sbi_precond_longest_axis(c->positions, nodes, end - begin), nodes,
                           end - begin);
    piece = sbi_precond_cut(c, begin, middle, left, piece);
    return sbi_precond_cut(c, middle, end, pieces - left, piece);
}

/* Numbers the (piece, node) entries that A Z has: entry_of[q] is that of matrix block q. Returns their count;
 * fills the coarse arrays when they are there. marker [row_count] is scratch. */
static int sbi_precond_list_entries(sbi_precond_coarse *c, const sb_matrix *a, int *marker, int *entry_of)
{
    int entries = 0;
    for (int i = 0; i < a->row_count; i++)
        marker[i] = -1;
    for (int piece = 0; piece < c->piece_count; piece++) {
        int first = entries;
        c->piece_entry[piece] = entries;
        for (int k = c->piece_start[piece]; k < c->piece_start[piece + 1]; k++) {
            int j = c->piece_nodes[k];
            for (int q = a->row_start[j]; q < a->row_start[j + 1]; q++) {
                int i = a->columns[q];
                if (marker[i] < first) {
                    marker[i] = entries;
                    if (c->entry_node)
                        c->entry_node[entries] = i;
                    entries++;
                }
                entry_of[a->transpose[q]] = marker[i];
            }
        }
    }
    c->piece_entry[c->piece_count] = entries;
    return entries;
}

static int sbi_precond_make_entries(sb_preconditioner *p, const sb_matrix *a)
{
    sbi_precond_coarse *c = &p->coarse;
    size_t rows = (size_t)a->row_count, blocks = (size_t)a->block_count;
    int *scratch = (int *)sbi_alloc(&p->allocator, rows + blocks, sizeof(int)), *entry_of, entries;
    if (!scratch)
        return 0;
    entry_of = scratch + rows;
    entries = sbi_precond_list_entries(c, a, scratch, entry_of);
    c->entry_node = sbi_precond_take_ints(p, (size_t)entries);
    c->entry_start = sbi_precond_take_ints(p, (size_t)entries + 2);
    c->entry_blocks = sbi_precond_take_ints(p, blocks);
    c->coupling = sbi_precond_take_floats(p, (size_t)entries, 24);
    if (c->entry_node && c->entry_start && c->entry_blocks && c->coupling) {
        sbi_precond_list_entries(c, a, scratch, entry_of);
        memset(c->entry_start, 0, ((size_t)entries + 2) * sizeof(int));
        for (int q = 0; q < a->block_count; q++)
            c->entry_start[entry_of[q] + 2]++;
        for (int e = 0; e < entries; e++)
            c->entry_start[e + 2] += c->entry_start[e + 1];
        for (int q = 0; q < a->block_count; q++)
            c->entry_blocks[c->entry_start[entry_of[q] + 1]++] = q;
    }
    sbi_free(&p->allocator, scratch);
    return c->entry_node && c->entry_start && c->entry_blocks && c->coupling;
}

static int sbi_precond_make_coarse(sb_preconditioner *p, const sb_matrix *a, const sb_vec3 *positions,
                                   int pieces)
{
    sbi_precond_coarse *c = &p->coarse;
    size_t rows = (size_t)a->row_count, size = 6 * (size_t)pieces;
    if (size > INT_MAX)
        return 0;
    c->piece_start = sbi_precond_take_ints(p, (size_t)pieces + 1);
    c->piece_entry = sbi_precond_take_ints(p, (size_t)pieces + 1);
    c->piece_nodes = sbi_precond_take_ints(p, rows);
    c->piece_of = sbi_precond_take_ints(p, rows);
    c->arms = sbi_precond_take_floats(p, rows, 4);
    c->free = sbi_precond_take_floats(p, rows, 4);
    c->places = (sb_real *)sbi_precond_take(p, rows, 4 * sizeof(sb_real));
    c->matrix = (double *)sbi_precond_take(p, size, size * sizeof(double));
    c->inverse = (double *)sbi_precond_take(p, size, sizeof(double));
    c->solution = (double *)sbi_precond_take(p, size, sizeof(double));
    c->positions = (sb_vec3 *)sbi_precond_take(p, rows, sizeof(sb_vec3));
    if (!c->piece_start || !c->piece_entry || !c->piece_nodes || !c->piece_of || !c->arms || !c->free ||
        !c->places || !c->matrix || !c->inverse || !c->solution || !c->positions)
        return 0;
    memcpy(c->positions, positions, rows * sizeof(sb_vec3));
    for (int i = 0; i < a->row_count; i++)
        c->piece_nodes[i] = i;
    c->piece_count = sbi_precond_cut(c, 0, a->row_count, pieces, 0);
    c->piece_start[pieces] = a->row_count;
    c->size = (int)size;
    return sbi_precond_make_entries(p, a);
}

/* Positions of the nodes relative to their piece's centre, in units of its root mean square radius. */
static void sbi_precond_place_piece(sbi_precond_coarse *c, int piece)
{
    int begin = c->piece_start[piece], end = c->piece_start[piece + 1];
    double centre[3] = {0, 0, 0}, square = 0, scale;
    for (int k = begin; k < end; k++)
        for (int axis = 0; axis < 3; axis++)
            centre[axis] += (double)sbi_precond_coordinate(c->positions, c->piece_nodes[k], axis);
    for (int axis = 0; axis < 3; axis++)
        centre[axis] /= end - begin;
    for (int k = begin; k < end; k++)
        for (int axis = 0; axis < 3; axis++) {
            double arm = (double)sbi_precond_coordinate(c->positions, c->piece_nodes[k], axis) - centre[axis];
            square += arm * arm;
        }
    scale = square > 0 ? 1 / sqrt(square / (end - begin)) : 0;
    for (int k = begin; k < end; k++) {
        size_t at = 4 * (size_t)c->piece_nodes[k];
        for (int axis = 0; axis < 3; axis++) {
            double x = (double)sbi_precond_coordinate(c->positions, c->piece_nodes[k], axis) - centre[axis];
            c->places[at + (size_t)axis] = (sb_real)(x * scale);
            c->arms[at + (size_t)axis] = (float)(x * scale);
        }
        c->places[at + 3] = 0;
        c->arms[at + 3] = 0;
    }
}

/* Sums over the blocks of entry e: sum[0] of the blocks, sum[1..3] of the blocks times the x, y, z of their
 * node's arm; rows padded to four. */
#if SBI_HAS_LANES
static void sbi_precond_moments(const sbi_precond_coarse *c, const sb_matrix *a, int e, sb_real sum[4][12])
{
    sbi_lanes p0 = {0, 0, 0, 0}, p1 = p0, p2 = p0, x0 = p0, x1 = p0, x2 = p0, y0 = p0, y1 = p0, y2 = p0,
              z0 = p0;
    sbi_lanes z1 = p0, z2 = p0;
    for (int s = c->entry_start[e]; s < c->entry_start[e + 1]; s++) {
        const sb_real *block = a->blocks[c->entry_blocks[s]];
        const sb_real *arm = c->places + 4 * (size_t)a->columns[c->entry_blocks[s]];
        sbi_lanes r0 = SBI_LANES_AT(block), r1 = SBI_LANES_AT(block + 3), r2 = SBI_LANES_AT(block + 6);
        p0 += r0, x0 += r0 * arm[0], y0 += r0 * arm[1], z0 += r0 * arm[2];
        p1 += r1, x1 += r1 * arm[0], y1 += r1 * arm[1], z1 += r1 * arm[2];
        p2 += r2, x2 += r2 * arm[0], y2 += r2 * arm[1], z2 += r2 * arm[2];
    }
    SBI_LANES_PUT(sum[0], p0), SBI_LANES_PUT(sum[0] + 4, p1), SBI_LANES_PUT(sum[0] + 8, p2);
    SBI_LANES_PUT(sum[1], x0), SBI_LANES_PUT(sum[1] + 4, x1), SBI_LANES_PUT(sum[1] + 8, x2);
    SBI_LANES_PUT(sum[2], y0), SBI_LANES_PUT(sum[2] + 4, y1), SBI_LANES_PUT(sum[2] + 8, y2);
    SBI_LANES_PUT(sum[3], z0), SBI_LANES_PUT(sum[3] + 4, z1), SBI_LANES_PUT(sum[3] + 8, z2);
}
#else
static void sbi_precond_moments(const sbi_precond_coarse *c, const sb_matrix *a, int e, sb_real sum[4][12])
{
    memset(sum, 0, 4 * sizeof *sum);
    for (int s = c->entry_start[e]; s < c->entry_start[e + 1]; s++) {
        const sb_real *block = a->blocks[c->entry_blocks[s]];
        const sb_real *arm = c->places + 4 * (size_t)a->columns[c->entry_blocks[s]];
        for (int r = 0; r < 3; r++)
            for (int k = 0; k < 3; k++) {
                sb_real value = block[3 * r + k];
                sum[0][4 * r + k] += value;
                sum[1][4 * r + k] += value * arm[0];
                sum[2][4 * r + k] += value * arm[1];
                sum[3][4 * r + k] += value * arm[2];
            }
    }
}
#endif

/* Rows of (A Z) of one entry: sums over the piece's nodes j of A_ij and A_ij d_j,k give the translations and,
 * by a . (w x d) = w . (d x a), the rotations. */
static void sbi_precond_couple(const sb_preconditioner *p, const sb_matrix *a, int e, double rows[3][6])
{
    const sbi_precond_coarse *c = &p->coarse;
    sb_real sum[4][12];
    sbi_precond_moments(c, a, e, sum);
    for (int r = 0; r < 3; r++) {
        double factor = p->matrix_scale * (double)c->free[4 * (size_t)c->entry_node[e] + (size_t)r];
        for (int k = 0; k < 3; k++)
            rows[r][k] = (double)sum[0][4 * r + k] * factor;
        rows[r][3] = (double)(sum[2][4 * r + 2] - sum[3][4 * r + 1]) * factor;
        rows[r][4] = (double)(sum[3][4 * r] - sum[1][4 * r + 2]) * factor;
        rows[r][5] = (double)(sum[1][4 * r + 1] - sum[2][4 * r]) * factor;
    }
}

/* (Z^T A Z) += Z_i^T (A Z)_i, the rows of node i's piece. */
static void sbi_precond_add_coarse(sbi_precond_coarse *c, int node, int piece, double rows[3][6])
{
    double *out = c->matrix + 6 * (size_t)c->piece_of[node] * (size_t)c->size + 6 * (size_t)piece;
    const float *arm = c->arms + 4 * (size_t)node;
    double x = (double)arm[0], y = (double)arm[1], z = (double)arm[2];
    size_t next = (size_t)c->size;
    for (int k = 0; k < 6; k++) {
        out[k] += rows[0][k];
        out[next + (size_t)k] += rows[1][k];
        out[2 * next + (size_t)k] += rows[2][k];
        out[3 * next + (size_t)k] += y * rows[2][k] - z * rows[1][k];
        out[4 * next + (size_t)k] += z * rows[0][k] - x * rows[2][k];
        out[5 * next + (size_t)k] += x * rows[1][k] - y * rows[0][k];
    }
}

/* The six rows of a piece: each is scaled by its pivot and taken from the following ones. */
static void sbi_precond_factor_rows(sbi_precond_coarse *c, int first)
{
    int size = c->size;
    for (int k = first; k < first + 6; k++) {
        double *row = c->matrix + (size_t)k * (size_t)size, pivot = row[k];
        c->inverse[k] = pivot > 0 && pivot > c->solution[k] ? 1 / sqrt(pivot) : 0;
        for (int j = k; j < size; j++)
            row[j] *= c->inverse[k];
        for (int i = k + 1; i < first + 6; i++) {
            double *other = c->matrix + (size_t)i * (size_t)size, factor = row[i];
            for (int j = i; j < size; j++)
                other[j] -= factor * row[j];
        }
    }
}

/* to[i..] -= sum over six rows of row[i] row[i..]; six at a time, since it is memory that limits the
 * factorisation. */
static void sbi_precond_eliminate_rows(const double *rows, int size, int i, double *SB_RESTRICT to)
{
    const double *r0 = rows, *r1 = r0 + size, *r2 = r1 + size, *r3 = r2 + size, *r4 = r3 + size,
                 *r5 = r4 + size;
    double f0 = r0[i], f1 = r1[i], f2 = r2[i], f3 = r3[i], f4 = r4[i], f5 = r5[i];
    if (f0 == 0 && f1 == 0 && f2 == 0 && f3 == 0 && f4 == 0 && f5 == 0)
        return; /* pieces that do not touch */
    for (int j = i; j < size; j++)
        to[j] -= ((f0 * r0[j] + f1 * r1[j]) + (f2 * r2[j] + f3 * r3[j])) + (f4 * r4[j] + f5 * r5[j]);
}

/* Cholesky factor R of the coarse matrix, R^T R, in its upper triangle. Motions that a piece does not have
 * (all its nodes fixed, or on a line) leave a zero pivot and are left out. */
static void sbi_precond_factor_coarse(sbi_precond_coarse *c)
{
    const double tiny = 256 * (double)SB_EPSILON;
    int size = c->size;
    for (int k = 0; k < size; k++)
        c->solution[k] = tiny * c->matrix[(size_t)k * (size_t)size + (size_t)k];
    for (int first = 0; first < size; first += 6) {
        double *rows = c->matrix + (size_t)first * (size_t)size;
        sbi_precond_factor_rows(c, first);
        for (int i = first + 6; i < size; i++)
            sbi_precond_eliminate_rows(rows, size, i, c->matrix + (size_t)i * (size_t)size);
    }
}

static void sbi_precond_update_coarse(sb_preconditioner *p, const sb_matrix *a)
{
    sbi_precond_coarse *c = &p->coarse;
    for (int piece = 0; piece < c->piece_count; piece++)
        sbi_precond_place_piece(c, piece);
    for (int i = 0; i < a->row_count; i++)
        for (int k = 0; k < 4; k++)
            c->free[4 * (size_t)i + (size_t)k] = (a->fixed[i] >> k & 1) || k == 3 ? 0.0f : 1.0f;
    memset(c->matrix, 0, (size_t)c->size * (size_t)c->size * sizeof(double));
    for (int piece = 0; piece < c->piece_count; piece++)
        for (int e = c->piece_entry[piece]; e < c->piece_entry[piece + 1]; e++) {
            double rows[3][6];
            float *out = c->coupling + 24 * (size_t)e;
            sbi_precond_couple(p, a, e, rows);
            for (int r = 0; r < 3; r++) {
                sbi_f4_store(out + 4 * r,
                             sbi_f4_make((float)rows[r][0], (float)rows[r][1], (float)rows[r][2]));
                sbi_f4_store(out + 12 + 4 * r,
                             sbi_f4_make((float)rows[r][3], (float)rows[r][4], (float)rows[r][5]));
            }
            if (c->piece_of[c->entry_node[e]] <= piece)
                sbi_precond_add_coarse(c, c->entry_node[e], piece, rows);
        }
    sbi_precond_factor_coarse(c);
}

/* solution = (R^T R)^-1 solution. */
static void sbi_precond_solve_coarse(sbi_precond_coarse *c)
{
    double *v = c->solution;
    int size = c->size;
    for (int k = 0; k < size; k++) {
        const double *row = c->matrix + (size_t)k * (size_t)size;
        double value = v[k] *= c->inverse[k];
        for (int j = k + 1; j < size; j++)
            v[j] -= value * row[j];
    }
    for (int k = size; k-- > 0;) {
        const double *row = c->matrix + (size_t)k * (size_t)size;
        double sums[4] = {0, 0, 0, 0}, value = v[k];
        int j = k + 1;
        for (; j + 4 <= size; j += 4)
            for (int lane = 0; lane < 4; lane++)
                sums[lane] += row[j + lane] * v[j + lane];
        for (; j < size; j++)
            sums[0] += row[j] * v[j];
        value -= (sums[0] + sums[1]) + (sums[2] + sums[3]);
        v[k] = value * c->inverse[k];
    }
}

/* ---- application --------------------------------------------------------------------------------------- */

/* middle = (I + L)^-1 r, result = D^-1 middle. */
static void sbi_precond_forward(sb_preconditioner *p, const sb_real *r, sb_real scale)
{
    const float *l = p->lower;
    for (size_t i = 0; i < (size_t)p->row_count; i++) {
        sbi_float4 s0 = sbi_f4_make(0, 0, 0), s1 = s0, s2 = s0, y;
        for (int e = p->start[i]; e < p->start[i + 1]; e++, l += 12) {
            sbi_float4 v = sbi_f4_load(p->middle + 4 * (size_t)p->columns[e]);
            s0 = sbi_f4_add(s0, sbi_f4_mul(sbi_f4_load(l), v));
            s1 = sbi_f4_add(s1, sbi_f4_mul(sbi_f4_load(l + 4), v));
            s2 = sbi_f4_add(s2, sbi_f4_mul(sbi_f4_load(l + 8), v));
        }
        y = sbi_f4_sub(sbi_f4_round(r + 3 * i, scale),
                       sbi_f4_make(sbi_f4_sum(s0), sbi_f4_sum(s1), sbi_f4_sum(s2)));
        sbi_f4_store(p->middle + 4 * i, y);
        sbi_f4_store(p->result + 4 * i, sbi_f4_rows(y, p->inverse + 12 * i));
    }
}

/* result = (I + L)^-T result, by columns of L^T: each row is final when it is met. */
static void sbi_precond_backward(sb_preconditioner *p)
{
    for (int i = p->row_count; i-- > 0;) {
        sbi_float4 z = sbi_f4_load(p->result + 4 * (size_t)i);
        const float *l = p->lower + 12 * (size_t)p->start[i];
        for (int e = p->start[i]; e < p->start[i + 1]; e++, l += 12) {
            float *to = p->result + 4 * (size_t)p->columns[e];
            sbi_f4_store(to, sbi_f4_sub(sbi_f4_load(to), sbi_f4_rows(z, l)));
        }
    }
}

static void sbi_precond_scale_blocks(sb_preconditioner *p, const sb_real *r, sb_real scale)
{
    for (size_t i = 0; i < (size_t)p->row_count; i++)
        sbi_f4_store(p->result + 4 * i, sbi_f4_rows(sbi_f4_round(r + 3 * i, scale), p->inverse + 12 * i));
}

/* Z^T r of one piece, minus (A Z)^T result if asked: a force, and a torque from the sums of arm components
 * times force (no cross products in the loop). */
static void sbi_precond_restrict_piece(const sb_preconditioner *p, const sb_real *r, sb_real scale,
                                       int with_result, int piece, double *out)
{
    const sbi_precond_coarse *c = &p->coarse;
    sbi_float4 force = sbi_f4_make(0, 0, 0), by_x = force, by_y = force, by_z = force, torque;
    for (int k = c->piece_start[piece]; k < c->piece_start[piece + 1]; k++) {
        size_t i = (size_t)c->piece_nodes[k];
        const float *arm = c->arms + 4 * i;
        sbi_float4 f = sbi_f4_mul(sbi_f4_round(r + 3 * i, scale), sbi_f4_load(c->free + 4 * i));
        force = sbi_f4_add(force, f);
        by_x = sbi_f4_add(by_x, sbi_f4_scale(arm[0], f));
        by_y = sbi_f4_add(by_y, sbi_f4_scale(arm[1], f));
        by_z = sbi_f4_add(by_z, sbi_f4_scale(arm[2], f));
    }
    torque = sbi_f4_make(SBI_F4(by_y, 2) - SBI_F4(by_z, 1), SBI_F4(by_z, 0) - SBI_F4(by_x, 2),
                         SBI_F4(by_x, 1) - SBI_F4(by_y, 0));
    for (int e = c->piece_entry[piece]; with_result && e < c->piece_entry[piece + 1]; e++) {
        sbi_float4 z = sbi_f4_load(p->result + 4 * (size_t)c->entry_node[e]);
        force = sbi_f4_sub(force, sbi_f4_rows(z, c->coupling + 24 * (size_t)e));
        torque = sbi_f4_sub(torque, sbi_f4_rows(z, c->coupling + 24 * (size_t)e + 12));
    }
    for (int k = 0; k < 3; k++) {
        out[k] = (double)SBI_F4(force, k);
        out[3 + k] = (double)SBI_F4(torque, k);
    }
}

/* solution = Z^T r - (A Z)^T result, or Z^T r */
static void sbi_precond_restrict(sb_preconditioner *p, const sb_real *r, sb_real scale, int with_result)
{
    for (int piece = 0; piece < p->coarse.piece_count; piece++)
        sbi_precond_restrict_piece(p, r, scale, with_result, piece, p->coarse.solution + 6 * piece);
}

/* result += Z solution: shift + w x d = shift + (w x e_x) d_x + (w x e_y) d_y + (w x e_z) d_z */
static void sbi_precond_prolong(sb_preconditioner *p)
{
    sbi_precond_coarse *c = &p->coarse;
    for (int piece = 0; piece < c->piece_count; piece++) {
        const double *s = c->solution + 6 * piece;
        float wx = (float)s[3], wy = (float)s[4], wz = (float)s[5];
        sbi_float4 shift = sbi_f4_make((float)s[0], (float)s[1], (float)s[2]);
        sbi_float4 by_x = sbi_f4_make(0, wz, -wy), by_y = sbi_f4_make(-wz, 0, wx),
                   by_z = sbi_f4_make(wy, -wx, 0);
        for (int k = c->piece_start[piece]; k < c->piece_start[piece + 1]; k++) {
            size_t i = (size_t)c->piece_nodes[k];
            const float *arm = c->arms + 4 * i;
            sbi_float4 move = sbi_f4_add(shift, sbi_f4_scale(arm[0], by_x));
            move = sbi_f4_add(move, sbi_f4_scale(arm[1], by_y));
            move = sbi_f4_mul(sbi_f4_add(move, sbi_f4_scale(arm[2], by_z)), sbi_f4_load(c->free + 4 * i));
            sbi_f4_store(p->result + 4 * i, sbi_f4_add(sbi_f4_load(p->result + 4 * i), move));
        }
    }
}

/* The power of two that brings `size` near 1. */
static double sbi_precond_power(double size)
{
    int exponent = 0;
    frexp(size, &exponent);
    return ldexp(1, exponent > 1000 ? -1000 : exponent < -1000 ? 1000 : -exponent);
}

static void sbi_precond_write(const sb_preconditioner *p, sb_real *z, double scale)
{
    sb_real back = (sb_real)(p->matrix_scale / scale);
    for (size_t i = 0; i < (size_t)p->row_count; i++)
        for (size_t k = 0; k < 3; k++)
            z[3 * i + k] = (sb_real)p->result[4 * i + k] * back;
}

SBI_API void sbi_precond_apply(sb_preconditioner *p, const sb_real *r, sb_real *z, double size)
{
    double scale = sbi_precond_power(size);
    if (p->kind == SB_PRECOND_NONE) {
        memcpy(z, r, 3 * (size_t)p->row_count * sizeof(sb_real));
        return;
    }
    if (p->kind == SB_PRECOND_MULTIGRID) {
        sbi_multigrid_apply(p->multigrid, r, (sb_real)scale, z, (sb_real)(p->matrix_scale / scale));
        return;
    }
    if (p->kind == SB_PRECOND_BLOCK_JACOBI) {
        sbi_precond_scale_blocks(p, r, (sb_real)scale);
    } else {
        sbi_precond_forward(p, r, (sb_real)scale);
        sbi_precond_backward(p);
    }
    if (p->coarse.piece_count) {
        sbi_precond_restrict(p, r, (sb_real)scale, 1);
        sbi_precond_solve_coarse(&p->coarse);
        sbi_precond_prolong(p);
    }
    sbi_precond_write(p, z, scale);
}

SBI_API int sbi_precond_coarse_solve(sb_preconditioner *p, const sb_real *r, sb_real *z, double size)
{
    double scale = sbi_precond_power(size);
    if (!p->coarse.piece_count)
        return 0;
    sbi_precond_restrict(p, r, (sb_real)scale, 0);
    sbi_precond_solve_coarse(&p->coarse);
    memset(p->result, 0, (size_t)p->row_count * 4 * sizeof(float));
    sbi_precond_prolong(p);
    sbi_precond_write(p, z, scale);
    return 1;
}

SB_API void sb_preconditioner_apply(sb_preconditioner *preconditioner, const sb_real *r, sb_real *z)
{
    sb_real largest = 0;
    for (size_t k = 0; k < 3 * (size_t)preconditioner->row_count; k++) {
        sb_real size = r[k] < 0 ? -r[k] : r[k];
        largest = size > largest ? size : largest;
    }
    sbi_precond_apply(preconditioner, r, z, (double)largest);
}

/* ---- life ---------------------------------------------------------------------------------------------- */

SB_API sb_preconditioner_def sb_default_preconditioner_def(void)
{
    sb_preconditioner_def def;
    def.kind = SB_PRECOND_AUTO;
    def.positions = NULL;
    def.piece_count = SB_PRECOND_PIECES_AUTO;
    memset(&def.jobs, 0, sizeof def.jobs);
    def.levels = NULL;
    def.level_count = 0;
    return def;
}

SB_API sb_precond_kind sb_solver_auto(const sb_matrix *pattern)
{
    return pattern && pattern->row_count >= SBI_PRECOND_MULTIGRID_ROWS ? SB_PRECOND_MULTIGRID : SB_PRECOND_IC0;
}

SB_API const char *sb_precond_string(sb_precond_kind kind)
{
    switch (kind) {
    case SB_PRECOND_NONE: return "none";
    case SB_PRECOND_BLOCK_JACOBI: return "block Jacobi";
    case SB_PRECOND_SSOR: return "SSOR";
    case SB_PRECOND_IC0: return "incomplete Cholesky";
    case SB_PRECOND_AUTO: return "automatic";
    case SB_PRECOND_MULTIGRID: return "multigrid";
    default: return "unknown";
    }
}

static int sbi_precond_pieces(const sb_preconditioner_def *def, int rows)
{
    int pieces = rows / SBI_PRECOND_NODES_PER_PIECE;
    if (!def->positions || def->kind == SB_PRECOND_NONE || def->kind == SB_PRECOND_MULTIGRID)
        return 0;
    if (def->piece_count != SB_PRECOND_PIECES_AUTO)
        return def->piece_count;
    return pieces < SBI_PRECOND_MAX_PIECES ? pieces : SBI_PRECOND_MAX_PIECES;
}

static sb_result sbi_precond_check(const sb_preconditioner_def *def, const sb_matrix *pattern,
                                   sb_error *error)
{
    if (!def || !pattern || pattern->row_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a preconditioner needs a def and a matrix");
    if (((int)def->kind < SB_PRECOND_NONE || (int)def->kind > SB_PRECOND_AUTO) && def->kind != SB_PRECOND_MULTIGRID)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "unknown preconditioner kind %d", (int)def->kind);
    if (def->piece_count < SB_PRECOND_PIECES_AUTO || def->piece_count > pattern->row_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "piece_count %d is outside 0 to %d", def->piece_count,
                        pattern->row_count);
    if (def->kind == SB_PRECOND_MULTIGRID && !def->positions)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "multigrid needs the positions of the nodes");
    if (def->level_count < 0 || (def->level_count > 0 && !def->levels))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "level_count %d does not fit levels", def->level_count);
    for (int i = 0; def->positions && i < pattern->row_count; i++)
        if (!sb_v3_is_finite(def->positions[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d: position is not finite", i);
    return SB_OK;
}

static int sbi_precond_make(sb_preconditioner *p, const sb_preconditioner_def *def, const sb_matrix *a)
{
    size_t rows = (size_t)a->row_count;
    int pieces = sbi_precond_pieces(def, a->row_count);
    if (p->kind == SB_PRECOND_NONE || p->kind == SB_PRECOND_MULTIGRID)
        return 1;
    p->inverse = sbi_precond_take_floats(p, rows, 12);
    p->middle = sbi_precond_take_floats(p, rows, 4);
    p->result = sbi_precond_take_floats(p, rows, 4);
    if (!p->inverse || !p->middle || !p->result)
        return 0;
    if (p->kind != SB_PRECOND_BLOCK_JACOBI && !sbi_precond_make_lower(p, a))
        return 0;
    if (p->kind == SB_PRECOND_IC0 && !sbi_precond_make_pairs(p))
        return 0;
    return pieces == 0 || sbi_precond_make_coarse(p, a, def->positions, pieces);
}

static sb_result sbi_precond_make_multigrid(sb_preconditioner *p, const sb_preconditioner_def *def,
                                            const sb_matrix *pattern, const sb_preconditioner *like, sb_error *error)
{
    sbi_multigrid_setup setup;
    sb_result result;
    setup.positions = def->positions;
    setup.levels = def->levels;
    setup.level_count = def->level_count;
    setup.like = like ? like->multigrid : NULL;
    setup.jobs = def->jobs;
    result = sbi_multigrid_create(&setup, pattern, &p->allocator, &p->multigrid, error);
    if (result == SB_OK)
        p->bytes += sbi_multigrid_bytes(p->multigrid);
    return result;
}

static sb_precond_kind sbi_precond_resolve(const sb_preconditioner_def *def, const sb_matrix *pattern)
{
    if (def->kind != SB_PRECOND_AUTO)
        return def->kind;
    return def->positions ? sb_solver_auto(pattern) : SB_PRECOND_IC0;
}

static sb_result sbi_precond_create(const sb_preconditioner_def *def, const sb_matrix *pattern,
                                    const sb_preconditioner *like, const sb_allocator *allocator,
                                    sb_preconditioner **out, sb_error *error)
{
    sb_preconditioner *p;
    sb_result result = sbi_precond_check(def, pattern, error);
    if (result != SB_OK)
        return result;
    if (!out)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_preconditioner_create needs a place for its result");
    p = (sb_preconditioner *)sbi_alloc_zeroed(allocator, 1, sizeof *p);
    if (!p)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a preconditioner");
    if (allocator)
        p->allocator = *allocator;
    p->bytes = sizeof *p;
    p->kind = sbi_precond_resolve(def, pattern);
    p->jobs = def->jobs;
    p->row_count = pattern->row_count;
    p->block_count = pattern->block_count;
    p->lower_count = (pattern->block_count - pattern->row_count) / 2;
    p->wait = SBI_PRECOND_RELAX_FIRST;
    p->matrix_scale = 1;
    if (!sbi_precond_make(p, def, pattern)) {
        sb_preconditioner_free(p);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a preconditioner of %d rows",
                        pattern->row_count);
    }
    if (p->kind == SB_PRECOND_MULTIGRID) {
        result = sbi_precond_make_multigrid(p, def, pattern, like, error);
        if (result != SB_OK) {
            sb_preconditioner_free(p);
            return result;
        }
    }
    *out = p;
    return SB_OK;
}

SB_API sb_result sb_preconditioner_create(const sb_preconditioner_def *def, const sb_matrix *pattern,
                                          const sb_allocator *allocator, sb_preconditioner **out,
                                          sb_error *error)
{
    return sbi_precond_create(def, pattern, NULL, allocator, out, error);
}

SBI_API sb_result sbi_precond_remake(const sb_preconditioner *like, const sb_matrix *pattern, const sb_vec3 *positions,
                                     const sb_allocator *allocator, sb_preconditioner **out, sb_error *error)
{
    sb_preconditioner_def def = sb_default_preconditioner_def();
    def.kind = like->kind;
    def.positions = positions;
    def.jobs = like->jobs;
    return sbi_precond_create(&def, pattern, like, allocator, out, error);
}

SB_API sb_result sb_preconditioner_update(sb_preconditioner *p, const sb_matrix *matrix,
                                          const sb_vec3 *positions, sb_error *error)
{
    double scale;
    int bad = -1;
    if (!p || !matrix || matrix->row_count != p->row_count || matrix->block_count != p->block_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the matrix does not have the preconditioner's pattern");
    scale = (double)sb_matrix_diagonal_scale(matrix, NULL);
    if (!(scale - scale == 0))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the matrix has a diagonal entry that is not finite");
    for (int i = 0; positions && p->coarse.piece_count && i < p->row_count; i++)
        if (!sb_v3_is_finite(positions[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d: position is not finite", i);
    p->matrix_scale = sbi_precond_power(scale);
    p->attempts = 0;
    if (p->kind == SB_PRECOND_BLOCK_JACOBI || p->kind == SB_PRECOND_SSOR)
        bad = sbi_precond_invert_diagonals(p, matrix);
    if (p->kind == SB_PRECOND_MULTIGRID)
        bad = sbi_multigrid_update(p->multigrid, matrix, p->matrix_scale);
    if (bad >= 0)
        return sbi_fail_node(error, SB_ERROR_INDEFINITE, bad,
                             "node %d: diagonal block is not positive definite", bad);
    if (p->kind == SB_PRECOND_SSOR)
        sbi_precond_fill_ssor(p, matrix);
    if (p->kind == SB_PRECOND_IC0) {
        sb_result result = sbi_precond_update_ic0(p, matrix, error);
        if (result != SB_OK)
            return result;
    }
    if (p->coarse.piece_count) {
        if (positions)
            memcpy(p->coarse.positions, positions, (size_t)p->row_count * sizeof(sb_vec3));
        sbi_precond_update_coarse(p, matrix);
    }
    return SB_OK;
}

SBI_API int sbi_precond_soften(sb_preconditioner *preconditioner)
{
    return preconditioner->multigrid && sbi_multigrid_soften(preconditioner->multigrid);
}

SBI_API int sbi_precond_rows(const sb_preconditioner *preconditioner) { return preconditioner->row_count; }

SBI_API sbi_precond_memory sbi_precond_get_memory(const sb_preconditioner *preconditioner)
{
    sbi_precond_memory memory;
    memory.shift = preconditioner->shift;
    memory.successes = preconditioner->successes;
    memory.wait = preconditioner->wait;
    return memory;
}

SBI_API void sbi_precond_set_memory(sb_preconditioner *preconditioner, sbi_precond_memory memory)
{
    preconditioner->shift = memory.shift;
    preconditioner->successes = memory.successes;
    preconditioner->wait = memory.wait;
}

SBI_API int sbi_precond_is_memory(sbi_precond_memory memory)
{
    return memory.shift >= 0 && memory.shift <= 2 * (double)SBI_PRECOND_MAX_SHIFT && memory.successes >= 0 &&
           memory.wait >= SBI_PRECOND_RELAX_FIRST && memory.wait <= SBI_PRECOND_RELAX_LAST;
}

SB_API sb_preconditioner_info sb_preconditioner_get_info(const sb_preconditioner *preconditioner)
{
    sb_preconditioner_info info;
    info.kind = preconditioner->kind;
    info.piece_count = preconditioner->coarse.piece_count;
    info.attempts = preconditioner->attempts;
    info.shift = preconditioner->shift;
    info.level_count = preconditioner->multigrid ? sbi_multigrid_levels(preconditioner->multigrid) : 0;
    info.bytes = preconditioner->bytes;
    return info;
}

#undef SBI_F4
#undef SBI_HAS_FLOAT4
