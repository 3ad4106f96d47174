/* precond_coarse: the coarse space of rigid pieces. Floor 1. */
#include <limits.h>
#include <math.h>
#include <string.h>

#include "precond_private.h"

/* ---- the matrix of the pieces ------------------------------------------------------------------------- */

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
            for (int q = a->row_start[j]; q < a->row_end[j]; q++) {
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

/* Lists the matrix blocks of each entry. */
static void sbi_precond_list_blocks(sbi_precond_coarse *c, const sb_matrix *a, int entries, const int *entry_of)
{
    memset(c->entry_start, 0, ((size_t)entries + 2) * sizeof(int));
    for (int i = 0; i < a->row_count; i++)
        for (int q = a->row_start[i]; q < a->row_end[i]; q++)
            c->entry_start[entry_of[q] + 2]++;
    for (int e = 0; e < entries; e++)
        c->entry_start[e + 2] += c->entry_start[e + 1];
    for (int i = 0; i < a->row_count; i++)
        for (int q = a->row_start[i]; q < a->row_end[i]; q++)
            c->entry_blocks[c->entry_start[entry_of[q] + 1]++] = q;
}

static int sbi_precond_take_entries(sb_preconditioner *p, size_t entries, size_t blocks)
{
    sbi_precond_coarse *c = &p->coarse;
    c->entry_node = sbi_owned_take_ints(&p->owned, entries);
    c->entry_start = sbi_owned_take_ints(&p->owned, entries + 2);
    c->entry_blocks = sbi_owned_take_ints(&p->owned, blocks);
    c->coupling = sbi_owned_take_floats(&p->owned, entries, 24);
    return c->entry_node && c->entry_start && c->entry_blocks && c->coupling;
}

static int sbi_precond_make_entries(sb_preconditioner *p, const sb_matrix *a)
{
    sbi_precond_coarse *c = &p->coarse;
    size_t rows = (size_t)a->row_count, blocks = (size_t)a->block_count;
    int *scratch = (int *)sbi_alloc(&p->owned.allocator, rows + blocks, sizeof(int)), *entry_of, entries, made;
    if (!scratch)
        return 0;
    entry_of = scratch + rows;
    entries = sbi_precond_list_entries(c, a, scratch, entry_of);
    made = sbi_precond_take_entries(p, (size_t)entries, blocks);
    if (made) {
        sbi_precond_list_entries(c, a, scratch, entry_of);
        sbi_precond_list_blocks(c, a, entries, entry_of);
    }
    sbi_free(&p->owned.allocator, scratch);
    return made;
}

/* reach[a]: the first unknown that the rows of piece a in Z^T A Z and in its factor have no more. Elimination gives
 * what a row has to the rows that it touches. */
static void sbi_precond_make_reach(sbi_precond_coarse *c)
{
    for (int a = 0; a < c->piece_count; a++)
        c->reach[a] = 6 * a + 6;
    for (int b = 0; b < c->piece_count; b++)
        for (int e = c->piece_entry[b]; e < c->piece_entry[b + 1]; e++) {
            int a = c->piece_of[c->entry_node[e]];
            if (a < b)
                c->reach[a] = 6 * b + 6;
        }
    for (int a = 0; a < c->piece_count; a++)
        for (int i = a + 1; 6 * i < c->reach[a]; i++)
            c->reach[i] = sbi_max_int(c->reach[i], c->reach[a]);
}

/* Where the rows of the matrix begin: those of a piece are as long as they reach. Returns their end. */
static size_t sbi_precond_line_rows(sbi_precond_coarse *c)
{
    size_t entries = 0;
    for (int a = 0; a < c->piece_count; a++) {
        c->row_at[a] = entries;
        entries += 6 * (size_t)(c->reach[a] - 6 * a);
    }
    return entries;
}

/* Where each piece starts in the list of nodes. */
static void sbi_precond_start_pieces(sbi_precond_coarse *c, int rows)
{
    c->size = 6 * c->piece_count;
    for (int k = 0; k < rows; k++)
        if (k == 0 || c->piece_of[c->piece_nodes[k]] != c->piece_of[c->piece_nodes[k - 1]])
            c->piece_start[c->piece_of[c->piece_nodes[k]]] = k;
    c->piece_start[c->piece_count] = rows;
}

/* Finds the pieces, and where each of them starts in the list of nodes. */
static int sbi_precond_find_pieces(sb_preconditioner *p, const sb_matrix *a, const sb_vec3 *positions, int pieces)
{
    sbi_precond_coarse *c = &p->coarse;
    size_t rows = (size_t)a->row_count;
    int *scratch = (int *)sbi_alloc(&p->owned.allocator, 8 * rows + 1, sizeof(int));
    sb_vec3 *centres = (sb_vec3 *)sbi_alloc(&p->owned.allocator, rows, sizeof(sb_vec3));
    c->piece_nodes = sbi_owned_take_ints(&p->owned, rows);
    c->piece_of = sbi_owned_take_ints(&p->owned, rows);
    if (c->piece_nodes && c->piece_of && scratch && centres)
        c->piece_count =
            sbi_precond_make_pieces(a, positions, pieces, scratch, centres, c->piece_nodes, c->piece_of, NULL);
    sbi_free(&p->owned.allocator, scratch);
    sbi_free(&p->owned.allocator, centres);
    if (c->piece_count == 0 || c->piece_count > INT_MAX / 6)
        return 0;
    c->piece_start = sbi_owned_take_ints(&p->owned, (size_t)c->piece_count + 1);
    if (c->piece_start)
        sbi_precond_start_pieces(c, a->row_count);
    return c->piece_start != NULL;
}

/* Arrays by node and piece. */
static int sbi_precond_take_motions(sb_preconditioner *p, size_t rows, size_t pieces)
{
    sbi_precond_coarse *c = &p->coarse;
    c->piece_entry = sbi_owned_take_ints(&p->owned, pieces + 1);
    c->reach = sbi_owned_take_ints(&p->owned, pieces);
    c->row_at = (size_t *)sbi_owned_take(&p->owned, pieces, sizeof(size_t));
    c->arms = sbi_owned_take_floats(&p->owned, rows, 4);
    c->free = sbi_owned_take_floats(&p->owned, rows, 4);
    c->places = (sb_real *)sbi_owned_take(&p->owned, rows, 4 * sizeof(sb_real));
    c->inverse = (double *)sbi_owned_take(&p->owned, 6 * pieces, sizeof(double));
    c->solution = (double *)sbi_owned_take(&p->owned, 6 * pieces, sizeof(double));
    c->positions = (sb_vec3 *)sbi_owned_take(&p->owned, rows, sizeof(sb_vec3));
    return c->piece_entry && c->reach && c->row_at && c->arms && c->free && c->places && c->inverse && c->solution &&
           c->positions;
}

SBI_API int sbi_precond_make_coarse(sb_preconditioner *p, const sb_matrix *a, const sb_vec3 *positions, int pieces)
{
    sbi_precond_coarse *c = &p->coarse;
    size_t rows = (size_t)a->row_count;
    if (!sbi_precond_find_pieces(p, a, positions, pieces) || !sbi_precond_take_motions(p, rows, (size_t)c->piece_count))
        return 0;
    memcpy(c->positions, positions, rows * sizeof(sb_vec3));
    if (!sbi_precond_make_entries(p, a))
        return 0;
    sbi_precond_make_reach(c);
    c->matrix = (double *)sbi_owned_take(&p->owned, sbi_precond_line_rows(c), sizeof(double));
    return c->matrix != NULL;
}

/* ---- of a matrix that follows --------------------------------------------------------------------------- */

/* The most pieces that the nodes of a matrix that follows are cut into when some `pieces` are asked for: beyond, the
 * last are one. Crumbs that a cut leaves are pieces of their own. */
static int sbi_precond_most_pieces(int pieces) { return 2 * pieces + 32; }

SBI_API int sbi_precond_take_coarse(sb_preconditioner *p, int pieces)
{
    sbi_precond_coarse *c = &p->coarse;
    size_t rows = (size_t)p->row_room, most = (size_t)sbi_precond_most_pieces(pieces), blocks = (size_t)p->block_room;
    c->piece_room = c->cuts.room = (int)most;
    c->cuts.splits = (sbi_piece_split *)sbi_owned_take(&p->owned, most, sizeof(sbi_piece_split));
    c->cuts.split_of = sbi_owned_take_ints(&p->owned, rows);
    c->cuts.axis = sbi_owned_take_ints(&p->owned, most);
    c->cuts.positions = (sb_vec3 *)sbi_owned_take(&p->owned, rows, sizeof(sb_vec3));
    c->cuts.places = sbi_owned_take_ints(&p->owned, rows);
    if (!c->cuts.splits || !c->cuts.split_of || !c->cuts.axis || !c->cuts.positions || !c->cuts.places)
        return 0;
    c->piece_nodes = sbi_owned_take_ints(&p->owned, rows);
    c->piece_of = sbi_owned_take_ints(&p->owned, rows);
    c->piece_start = sbi_owned_take_ints(&p->owned, most + 1);
    c->matrix = (double *)sbi_owned_take(&p->owned, 18 * most * (most + 1), sizeof(double));
    return c->piece_nodes && c->piece_of && c->piece_start && c->matrix && sbi_precond_take_motions(p, rows, most) &&
           sbi_precond_take_entries(p, blocks, blocks);
}

/* Cuts the nodes into pieces. */
static void sbi_precond_cut_pieces(sb_preconditioner *p, const sb_matrix *a, int pieces)
{
    sbi_precond_coarse *c = &p->coarse;
    int most = sbi_min_int(sbi_precond_most_pieces(pieces), c->piece_room);
    c->piece_count =
        sbi_precond_make_pieces(a, p->rest, pieces, p->scratch, p->centres, c->piece_nodes, c->piece_of, &c->cuts);
    c->cuts_tell = c->piece_count <= most;
    for (int i = 0; i < a->row_count && c->piece_count > most; i++)
        c->piece_of[i] = sbi_min_int(c->piece_of[i], most - 1);
    c->piece_count = sbi_min_int(c->piece_count, most);
}

/* The same of a pattern that was cut before; returns 1 when pieces are others than then. */
static int sbi_precond_recut_pieces(sb_preconditioner *p, const sb_matrix *a, int pieces)
{
    sbi_precond_coarse *c = &p->coarse;
    size_t rows = (size_t)a->row_count;
    int *before = p->scratch + 8 * rows + 1, count = c->piece_count; /* beyond what the cut uses */
    if (c->cuts_tell &&
        sbi_precond_pieces_stay(a, p->rest, &c->cuts, c->piece_of, c->piece_count, p->scratch, p->centres))
        return 0;
    memcpy(before, c->piece_of, rows * sizeof(int));
    sbi_precond_cut_pieces(p, a, pieces);
    return c->piece_count != count || memcmp(before, c->piece_of, rows * sizeof(int)) != 0;
}

SBI_API void sbi_precond_shape_coarse(sb_preconditioner *p, const sb_matrix *a, int pieces, int stale)
{
    sbi_precond_coarse *c = &p->coarse;
    int rows = a->row_count, differs = 1, entries;
    int *marker = p->scratch, *entry_of = p->scratch + rows;
    c->ready = 0;
    if (pieces == 0) {
        c->piece_count = c->size = 0;
        return;
    }
    if (stale || c->piece_count == 0)
        sbi_precond_cut_pieces(p, a, pieces);
    else
        differs = sbi_precond_recut_pieces(p, a, pieces);
    memcpy(c->positions, p->rest, (size_t)rows * sizeof(sb_vec3));
    if (!differs)
        return;
    sbi_precond_start_pieces(c, rows);
    entries = sbi_precond_list_entries(c, a, marker, entry_of);
    sbi_precond_list_blocks(c, a, entries, entry_of);
    sbi_precond_make_reach(c);
    sbi_precond_line_rows(c);
}

/* Row k of the matrix: entries from the first of k's piece to its reach, to be read at [column]. */
SBI_FORCE_INLINE double *sbi_precond_row(const sbi_precond_coarse *c, int k)
{
    int piece = k / 6, first = 6 * piece;
    return c->matrix + (c->row_at[piece] + (size_t)(k - first) * (size_t)(c->reach[piece] - first) - (size_t)first);
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
    sbi_lanes p0 = {0, 0, 0, 0}, p1 = p0, p2 = p0, x0 = p0, x1 = p0, x2 = p0, y0 = p0, y1 = p0, y2 = p0, z0 = p0;
    sbi_lanes z1 = p0, z2 = p0;
    int last = c->entry_start[c->piece_entry[c->piece_count]] - 1; /* of all blocks */
    for (int s = c->entry_start[e]; s < c->entry_start[e + 1]; s++) {
        const sb_real *block = a->blocks[c->entry_blocks[s]];
        const sb_real *arm = c->places + 4 * (size_t)a->columns[c->entry_blocks[s]];
        int later = c->entry_blocks[sbi_min_int(s + SBI_PRECOND_AHEAD, last)];
        sbi_lanes r0 = SBI_LANES_AT(block), r1 = SBI_LANES_AT(block + 3), r2 = SBI_LANES_AT(block + 6);
        SBI_PREFETCH(a->blocks[later], 0); /* blocks of a piece lie in many places */
        SBI_PREFETCH(a->blocks[later], 64);
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
/* One or two rows of the blocks at a time: what they sum stays in registers. Of the moments only those that torques
 * have. */
#if SBI_HAS_PAIRS
/* Sums of a row of the blocks: its entries, and those of them times arms that torques have. */
typedef struct sbi_precond_sums {
    sbi_pair p01, p12, yz, zx, xy;
} sbi_precond_sums;

SBI_FORCE_INLINE sbi_precond_sums sbi_precond_add_row(sbi_precond_sums s, const sb_real *row, const sb_real *arm)
{
    sbi_pair v01 = SBI_PAIR_AT(row), v12 = SBI_PAIR_AT(row + 1);
    s.p01 += v01;
    s.p12 += v12;
    s.yz += SBI_PAIR_AT(arm + 1) * sbi_pair_make(v12[1], v01[0]);
    s.zx += sbi_pair_make(arm[2], arm[0]) * v12;
    s.xy += sbi_pair_make(arm[1], arm[0]) * v01;
    return s;
}

static void sbi_precond_put_sums(sbi_precond_sums s, int r, sb_real sum[4][12])
{
    sum[0][4 * r] = s.p01[0], sum[0][4 * r + 1] = s.p01[1], sum[0][4 * r + 2] = s.p12[1];
    sum[1][4 * r + 1] = s.xy[1], sum[1][4 * r + 2] = s.zx[1];
    sum[2][4 * r] = s.xy[0], sum[2][4 * r + 2] = s.yz[0];
    sum[3][4 * r] = s.yz[1], sum[3][4 * r + 1] = s.zx[0];
}

static void sbi_precond_row_moments(const sbi_precond_coarse *c, const sb_matrix *a, int begin, int end,
                                    sb_real sum[4][12])
{
    const sbi_pair zero = {0, 0};
    sbi_precond_sums s0 = {zero, zero, zero, zero, zero}, s1 = s0, s2 = s0;
    for (int s = begin; s < end; s++) { /* two rows: as many sums as there are registers for */
        const sb_real *block = a->blocks[c->entry_blocks[s]];
        const sb_real *arm = c->places + 4 * (size_t)a->columns[c->entry_blocks[s]];
        s0 = sbi_precond_add_row(s0, block, arm);
        s1 = sbi_precond_add_row(s1, block + 3, arm);
    }
    for (int s = begin; s < end; s++)
        s2 = sbi_precond_add_row(s2, a->blocks[c->entry_blocks[s]] + 6,
                                 c->places + 4 * (size_t)a->columns[c->entry_blocks[s]]);
    sbi_precond_put_sums(s0, 0, sum);
    sbi_precond_put_sums(s1, 1, sum);
    sbi_precond_put_sums(s2, 2, sum);
}
#else
static void sbi_precond_one_row(const sbi_precond_coarse *c, const sb_matrix *a, int begin, int end, int r,
                                sb_real sum[4][12])
{
    sb_vec3 p = sb_v3(0, 0, 0), x = p, y = p, z = p;
    for (int s = begin; s < end; s++) {
        const sb_real *row = a->blocks[c->entry_blocks[s]] + 3 * r;
        const sb_real *arm = c->places + 4 * (size_t)a->columns[c->entry_blocks[s]];
        p = sb_v3_add(p, sb_v3(row[0], row[1], row[2]));
        x.y += arm[0] * row[1], x.z += arm[0] * row[2];
        y.x += arm[1] * row[0], y.z += arm[1] * row[2];
        z.x += arm[2] * row[0], z.y += arm[2] * row[1];
    }
    sum[0][4 * r] = p.x, sum[0][4 * r + 1] = p.y, sum[0][4 * r + 2] = p.z;
    sum[1][4 * r + 1] = x.y, sum[1][4 * r + 2] = x.z;
    sum[2][4 * r] = y.x, sum[2][4 * r + 2] = y.z;
    sum[3][4 * r] = z.x, sum[3][4 * r + 1] = z.y;
}

static void sbi_precond_row_moments(const sbi_precond_coarse *c, const sb_matrix *a, int begin, int end,
                                    sb_real sum[4][12])
{
    for (int r = 0; r < 3; r++)
        sbi_precond_one_row(c, a, begin, end, r, sum);
}
#endif

static void sbi_precond_moments(const sbi_precond_coarse *c, const sb_matrix *a, int e, sb_real sum[4][12])
{
    int begin = c->entry_start[e], end = c->entry_start[e + 1];
    int last = c->entry_start[c->piece_entry[c->piece_count]] - 1; /* of all blocks */
    for (int s = begin; s < end; s++) {
        int later = c->entry_blocks[sbi_min_int(s + SBI_PRECOND_AHEAD, last)];
        SBI_PREFETCH(a->blocks[later], 0); /* blocks of a piece lie in many places */
        SBI_PREFETCH(a->blocks[later], 64);
    }
    sbi_precond_row_moments(c, a, begin, end, sum);
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

/* out += a, and out += f a - g b, of six. */
SBI_FORCE_INLINE void sbi_precond_add_six(double *SB_RESTRICT out, const double *SB_RESTRICT a)
{
    for (int k = 0; k < 6; k++)
        out[k] += a[k];
}

SBI_FORCE_INLINE void sbi_precond_add_cross(double *SB_RESTRICT out, double f, const double *SB_RESTRICT a, double g,
                                            const double *SB_RESTRICT b)
{
    for (int k = 0; k < 6; k++)
        out[k] += f * a[k] - g * b[k];
}

/* (Z^T A Z) += Z_i^T (A Z)_i, the rows of node i's piece. */
static void sbi_precond_add_coarse(sbi_precond_coarse *c, int node, int piece, double rows[3][6])
{
    int own = c->piece_of[node];
    double *out = sbi_precond_row(c, 6 * own) + 6 * (size_t)piece;
    const float *arm = c->arms + 4 * (size_t)node;
    double x = (double)arm[0], y = (double)arm[1], z = (double)arm[2];
    size_t next = (size_t)(c->reach[own] - 6 * own);
    for (int r = 0; r < 3; r++)
        sbi_precond_add_six(out + (size_t)r * next, rows[r]);
    sbi_precond_add_cross(out + 3 * next, y, rows[2], z, rows[1]);
    sbi_precond_add_cross(out + 4 * next, z, rows[0], x, rows[2]);
    sbi_precond_add_cross(out + 5 * next, x, rows[1], y, rows[0]);
}

/* The six rows of a piece, which end at `end`: each is scaled by its pivot and taken from the following ones. */
static void sbi_precond_factor_rows(sbi_precond_coarse *c, int first, int end)
{
    for (int k = first; k < first + 6; k++) {
        double *row = sbi_precond_row(c, k), pivot = row[k];
        c->inverse[k] = pivot > 0 && pivot > c->solution[k] ? 1 / sqrt(pivot) : 0;
        for (int j = k; j < end; j++)
            row[j] *= c->inverse[k];
        for (int i = k + 1; i < first + 6; i++) {
            double *other = sbi_precond_row(c, i), factor = row[i];
            for (int j = i; j < end; j++)
                other[j] -= factor * row[j];
        }
    }
}

/* to[i..end] -= sum over six rows of row[i] row[i..end]; six at a time, since it is memory that limits the
 * factorisation. */
static void sbi_precond_eliminate_rows(const double *rows, int width, int i, int end, double *SB_RESTRICT to)
{
    const double *r0 = rows, *r1 = r0 + width, *r2 = r1 + width, *r3 = r2 + width, *r4 = r3 + width, *r5 = r4 + width;
    double f0 = r0[i], f1 = r1[i], f2 = r2[i], f3 = r3[i], f4 = r4[i], f5 = r5[i];
    if (f0 == 0 && f1 == 0 && f2 == 0 && f3 == 0 && f4 == 0 && f5 == 0)
        return; /* pieces that do not touch */
    for (int j = i; j < end; j++)
        to[j] -= ((f0 * r0[j] + f1 * r1[j]) + (f2 * r2[j] + f3 * r3[j])) + (f4 * r4[j] + f5 * r5[j]);
}

/* Cholesky factor R of the coarse matrix, R^T R, in its upper triangle. Motions that a piece does not have
 * (all its nodes fixed, or on a line) leave a zero pivot and are left out. */
static void sbi_precond_factor_coarse(sbi_precond_coarse *c)
{
    const double tiny = 256 * (double)SB_EPSILON;
    int size = c->size;
    for (int k = 0; k < size; k++)
        c->solution[k] = tiny * sbi_precond_row(c, k)[k];
    for (int first = 0; first < size; first += 6) {
        double *rows = sbi_precond_row(c, first);
        int end = c->reach[first / 6];
        sbi_precond_factor_rows(c, first, end);
        for (int i = first + 6; i < end; i++)
            sbi_precond_eliminate_rows(rows, end - first, i, end, sbi_precond_row(c, i));
    }
}

/* Where a piece's nodes are, and which of their components are free; its rows of the coarse matrix: 0. */
static void sbi_precond_place_task(void *user, int piece)
{
    const sbi_precond_job *job = (const sbi_precond_job *)user;
    sbi_precond_coarse *c = &job->p->coarse;
    size_t width = (size_t)(c->reach[piece] - 6 * piece);
    memset(c->matrix + c->row_at[piece], 0, 6 * width * sizeof(double));
    for (int s = c->piece_start[piece]; job->positions && s < c->piece_start[piece + 1]; s++)
        c->positions[c->piece_nodes[s]] = job->positions[c->piece_nodes[s]];
    sbi_precond_place_piece(c, piece);
    for (int s = c->piece_start[piece]; s < c->piece_start[piece + 1]; s++) {
        size_t i = (size_t)c->piece_nodes[s];
        for (size_t k = 0; k < 4; k++)
            c->free[4 * i + k] = (job->a->fixed[i] >> k & 1) || k == 3 ? 0.0f : 1.0f;
    }
}

/* Columns of one piece: of A Z, and of Z^T A Z from its diagonal up. */
static void sbi_precond_couple_task(void *user, int piece)
{
    const sbi_precond_job *job = (const sbi_precond_job *)user;
    sbi_precond_coarse *c = &job->p->coarse;
    for (int e = c->piece_entry[piece]; e < c->piece_entry[piece + 1]; e++) {
        double rows[3][6];
        float *out = c->coupling + 24 * (size_t)e;
        sbi_precond_couple(job->p, job->a, e, rows);
        for (int r = 0; r < 3; r++) {
            sbi_f4_store(out + 4 * r, sbi_f4_make((float)rows[r][0], (float)rows[r][1], (float)rows[r][2]));
            sbi_f4_store(out + 12 + 4 * r, sbi_f4_make((float)rows[r][3], (float)rows[r][4], (float)rows[r][5]));
        }
        if (c->piece_of[c->entry_node[e]] <= piece)
            sbi_precond_add_coarse(c, c->entry_node[e], piece, rows);
    }
}

/* What is done beside the columns of the pieces takes longest, so its tasks come first where threads begin: two threads
 * with half of all tasks each, as sb_jobs_openmp gives them, keep to the halves of the factor that they sweep later. */
static void sbi_precond_update_task(void *user, int index)
{
    const sbi_precond_job *job = (const sbi_precond_job *)user;
    int beside = job->beside ? job->beside->count : 0, total = job->p->coarse.piece_count + beside, before = 0;
    for (int k = 0; k < beside; k++) {
        int first = (int)((int64_t)total * k / beside);
        if (index == first) {
            job->beside->task(job->beside->user, k);
            return;
        }
        before += index > first;
    }
    sbi_precond_couple_task(user, index - before);
}

static void sbi_precond_last_task(void *user, int index)
{
    const sbi_precond_job *job = (const sbi_precond_job *)user;
    if (index == 0)
        sbi_precond_factor_coarse(&job->p->coarse);
    else
        job->beside->last(job->beside->user, 0);
}

SBI_API void sbi_precond_update_coarse(sb_preconditioner *p, const sb_matrix *a, const sb_vec3 *positions,
                                       const sbi_precond_beside *beside)
{
    sbi_precond_coarse *c = &p->coarse;
    sbi_precond_job job;
    memset(&job, 0, sizeof job);
    job.p = p;
    job.a = a;
    job.beside = beside;
    job.positions = positions;
    sbi_run(&p->jobs, sbi_precond_place_task, &job, c->piece_count);
    sbi_run(&p->jobs, sbi_precond_update_task, &job, c->piece_count + (beside ? beside->count : 0));
    sbi_run(&p->jobs, sbi_precond_last_task, &job, beside && beside->last ? 2 : 1);
    c->ready = 1;
}

/* solution = (R^T R)^-1 solution. */
static void sbi_precond_solve_coarse(sbi_precond_coarse *c)
{
    double *v = c->solution;
    int size = c->size;
    for (int k = 0; k < size; k++) {
        const double *row = sbi_precond_row(c, k);
        double value = v[k] *= c->inverse[k];
        for (int j = k + 1, end = c->reach[k / 6]; j < end; j++)
            v[j] -= value * row[j];
    }
    for (int k = size; k-- > 0;) {
        const double *row = sbi_precond_row(c, k);
        double sums[4] = {0, 0, 0, 0}, value = v[k];
        int j = k + 1, end = c->reach[k / 6];
        for (; j + 4 <= end; j += 4)
            for (int lane = 0; lane < 4; lane++)
                sums[lane] += row[j + lane] * v[j + lane];
        for (; j < end; j++)
            sums[0] += row[j] * v[j];
        value -= (sums[0] + sums[1]) + (sums[2] + sums[3]);
        v[k] = value * c->inverse[k];
    }
}

/* Z^T r of one piece, minus (A Z)^T result if asked: a force, and a torque from the sums of arm components
 * times force (no cross products in the loop). */
static void sbi_precond_restrict_piece(const sb_preconditioner *p, const sb_real *r, sb_real scale, int with_result,
                                       int piece, double *out)
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

/* solution = Z^T r - (A Z)^T result, or Z^T r, of one piece */
static void sbi_precond_restrict_task(void *user, int piece)
{
    const sbi_precond_job *job = (const sbi_precond_job *)user;
    sbi_precond_restrict_piece(job->p, job->r, (sb_real)job->scale, job->with_result, piece,
                               job->p->coarse.solution + 6 * piece);
}

/* z = result + Z solution: shift + w x d = shift + (w x e_x) d_x + (w x e_y) d_y + (w x e_z) d_z */
static void sbi_precond_prolong_task(void *user, int piece)
{
    const sbi_precond_job *job = (const sbi_precond_job *)user;
    const sbi_precond_coarse *c = &job->p->coarse;
    const double *s = c->solution + 6 * piece;
    sb_real back = (sb_real)(job->p->matrix_scale / job->scale);
    float wx = (float)s[3], wy = (float)s[4], wz = (float)s[5];
    sbi_float4 shift = sbi_f4_make((float)s[0], (float)s[1], (float)s[2]);
    sbi_float4 by_x = sbi_f4_make(0, wz, -wy), by_y = sbi_f4_make(-wz, 0, wx), by_z = sbi_f4_make(wy, -wx, 0);
    for (int k = c->piece_start[piece]; k < c->piece_start[piece + 1]; k++) {
        size_t i = (size_t)c->piece_nodes[k];
        const float *arm = c->arms + 4 * i;
        sbi_float4 move = sbi_f4_add(shift, sbi_f4_scale(arm[0], by_x));
        move = sbi_f4_add(move, sbi_f4_scale(arm[1], by_y));
        move = sbi_f4_mul(sbi_f4_add(move, sbi_f4_scale(arm[2], by_z)), sbi_f4_load(c->free + 4 * i));
        move = sbi_f4_add(sbi_f4_load(job->p->result + 4 * i), move);
        for (int axis = 0; axis < 3; axis++)
            job->z[3 * i + (size_t)axis] = (sb_real)SBI_F4(move, axis) * back;
    }
}

SBI_API void sbi_precond_correct(const sbi_precond_job *job)
{
    sbi_precond_job mine = *job;
    sbi_run(&job->p->jobs, sbi_precond_restrict_task, &mine, job->p->coarse.piece_count);
    sbi_precond_solve_coarse(&job->p->coarse);
    sbi_run(&job->p->jobs, sbi_precond_prolong_task, &mine, job->p->coarse.piece_count);
}

/* to -= A Z solution, which is rounded as all else that the smoother gets. Pieces share nodes, so that this is one
 * thread's; it reads what one task of the restriction does. */
static void sbi_precond_subtract_coupling(const sbi_precond_job *job, sb_real *to)
{
    const sbi_precond_coarse *c = &job->p->coarse;
    const float *rows = c->coupling;
    sb_real back = (sb_real)(1 / job->scale);
    for (int piece = 0; piece < c->piece_count; piece++) {
        const double *s = c->solution + 6 * piece;
        sbi_float4 shift = sbi_f4_make((float)s[0], (float)s[1], (float)s[2]);
        sbi_float4 turn = sbi_f4_make((float)s[3], (float)s[4], (float)s[5]);
        for (int e = c->piece_entry[piece]; e < c->piece_entry[piece + 1]; e++, rows += 24) {
            sb_real *out = to + 3 * (size_t)c->entry_node[e];
            sbi_float4 x = sbi_f4_mul(sbi_f4_load(rows), shift), y = sbi_f4_mul(sbi_f4_load(rows + 4), shift);
            sbi_float4 z = sbi_f4_mul(sbi_f4_load(rows + 8), shift), sum;
            x = sbi_f4_add(x, sbi_f4_mul(sbi_f4_load(rows + 12), turn));
            y = sbi_f4_add(y, sbi_f4_mul(sbi_f4_load(rows + 16), turn));
            z = sbi_f4_add(z, sbi_f4_mul(sbi_f4_load(rows + 20), turn));
            sum = sbi_f4_sums(x, y, z);
            out[0] -= (sb_real)SBI_F4(sum, 0) * back;
            out[1] -= (sb_real)SBI_F4(sum, 1) * back;
            out[2] -= (sb_real)SBI_F4(sum, 2) * back;
        }
    }
}

SBI_API void sbi_precond_project(const sbi_precond_job *job, sb_real *to)
{
    sbi_precond_job mine = *job;
    sbi_run(&job->p->jobs, sbi_precond_restrict_task, &mine, job->p->coarse.piece_count);
    sbi_precond_solve_coarse(&job->p->coarse);
    memcpy(to, job->r, 3 * (size_t)job->p->row_count * sizeof(sb_real));
    sbi_precond_subtract_coupling(job, to);
}

#undef SBI_F4
#undef SBI_HAS_FLOAT4
#undef SBI_HAS_SHUFFLE
