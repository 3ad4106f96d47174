/* precond_pieces: which nodes move together in the coarse space. Floor 1.
 *
 * A piece never holds nodes that do not hang together: its one motion would be that of things that move apart (parts of
 * a body that lie between each other, the lips of a cut), and glue them. So each connected part is cut by itself, and
 * where a cut by coordinates leaves fragments, each is a piece or joins the one that it touches. Lips that hang
 * together round the front of their cut are told by nodes in the same place, and are pieces of their own, too. */
#include <limits.h>
#include <string.h>

#include "../base/bytes.h"

#include "precond_private.h"
#include "sparse_live.h"

/* ---- along an axis ------------------------------------------------------------------------------------- */

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

/* Brings the first `rank` nodes along an axis before the others (Hoare 1961): what sorting does, in linear time. */
static void sbi_precond_select(const sb_vec3 *positions, int axis, int *nodes, int count, int rank)
{
    int low = 0, high = count - 1;
    for (int round = 0; low < high; round++) {
        int pivot = nodes[low + (high - low) / 2], i = low, j = high;
        if (round == 64) { /* an order that defeats the choice of pivots */
            sbi_precond_sort_nodes(positions, axis, nodes + low, high - low + 1);
            return;
        }
        while (i <= j) {
            int node;
            while (sbi_precond_before(positions, axis, nodes[i], pivot))
                i++;
            while (sbi_precond_before(positions, axis, pivot, nodes[j]))
                j--;
            if (i > j)
                break;
            node = nodes[i];
            nodes[i++] = nodes[j];
            nodes[j--] = node;
        }
        if (rank > j && rank < i)
            return;
        high = rank <= j ? j : high;
        low = rank >= i ? i : low;
    }
}

/* low, high: the box of the nodes. */
static int sbi_precond_longest_axis(const sb_vec3 *positions, const int *nodes, int count, sb_vec3 *low, sb_vec3 *high)
{
    sb_vec3 extent;
    *low = *high = positions[nodes[0]];
    for (int k = 1; k < count; k++) {
        sb_vec3 x = positions[nodes[k]];
        low->x = sb_min(low->x, x.x), low->y = sb_min(low->y, x.y), low->z = sb_min(low->z, x.z);
        high->x = sb_max(high->x, x.x), high->y = sb_max(high->y, x.y), high->z = sb_max(high->z, x.z);
    }
    extent = sb_v3_sub(*high, *low);
    return extent.y > extent.x ? (extent.z > extent.y ? 2 : 1) : (extent.z > extent.x ? 2 : 0);
}

/* ---- pieces of a part ---------------------------------------------------------------------------------- */

typedef struct sbi_piece_maker {
    const sb_matrix *a;
    const sb_vec3 *positions;
    int *nodes;           /* [rows] by piece */
    int *piece_of;        /* [rows] */
    int *fragment_of;     /* [rows] -1: none yet */
    int *list;            /* [rows] nodes by fragment; or a queue */
    int *start;           /* [rows + 1] of fragments in the list */
    int *sizes;           /* [rows] nodes of each fragment and of those that have joined it */
    int *roots;           /* [rows] the fragment that each has joined; itself: none */
    int *touching;        /* [rows] blocks that the fragment at work shares with each other one; otherwise 0 */
    sb_vec3 *centres;     /* [rows] */
    sbi_piece_cuts *cuts; /* notes how it was cut, or NULL */
    const int *place_of;  /* [rows] the first node in the same place */
    int *last_at;         /* [rows] -1; while twins are looked for, by place: the last node met there */
    int has_twins;        /* 1: nodes share a place */
    int most;             /* pieces from which on lips are not parted */
    int piece_count;      /* of the parts before, */
    int own_count;        /* and of the part at work */
} sbi_piece_maker;

/* Notes a cut of nodes[0, count) after the first `left` of them; its number. */
static int sbi_piece_note(const sbi_piece_maker *m, const int *nodes, int count, int left, int axis, int within)
{
    sbi_piece_split *split = m->cuts->splits + m->cuts->split_count;
    split->axis = axis;
    split->within = within;
    split->last = nodes[0];
    split->first = nodes[left];
    for (int k = 1; k < left; k++)
        if (sbi_precond_before(m->positions, axis, split->last, nodes[k]))
            split->last = nodes[k];
    for (int k = left + 1; k < count; k++)
        if (sbi_precond_before(m->positions, axis, nodes[k], split->first))
            split->first = nodes[k];
    return m->cuts->split_count++;
}

/* Cuts nodes[begin, end) into `pieces` sets of equal size by halving across the longest side; returns the number of the
 * next one. within: the split whose half they are, or -1. */
static int sbi_piece_cut(sbi_piece_maker *m, int begin, int end, int pieces, int piece, int within)
{
    int left = pieces / 2, middle = begin + (int)((long long)(end - begin) * left / pieces);
    int *nodes = m->nodes + begin, axis;
    sb_vec3 low, high;
    if (pieces == 1) {
        for (int k = begin; k < end; k++)
            m->piece_of[m->nodes[k]] = piece;
        for (int k = begin; m->cuts && k < end; k++)
            m->cuts->split_of[m->nodes[k]] = within;
        return piece + 1;
    }
    axis = sbi_precond_longest_axis(m->positions, nodes, end - begin, &low, &high);
    sbi_precond_select(m->positions, axis, nodes, end - begin, middle - begin);
    if (m->cuts) {
        within = sbi_piece_note(m, nodes, end - begin, middle - begin, axis, within);
        m->cuts->splits[within].low = low;
        m->cuts->splits[within].high = high;
    }
    piece = sbi_piece_cut(m, begin, middle, left, piece, within);
    return sbi_piece_cut(m, middle, end, pieces - left, piece, within);
}

/* Gives what hangs together with node i within its piece a fragment; returns the number of its nodes. */
static int sbi_piece_spread(sbi_piece_maker *m, int i, int fragment)
{
    const sb_matrix *a = m->a;
    int *queue = m->list, count = 1;
    queue[0] = i;
    m->fragment_of[i] = fragment;
    for (int head = 0; head < count; head++)
        for (int q = a->row_start[queue[head]]; q < a->row_end[queue[head]]; q++) {
            int j = a->columns[q];
            if (m->fragment_of[j] >= 0 || m->piece_of[j] != m->piece_of[i])
                continue;
            m->fragment_of[j] = fragment;
            queue[count++] = j;
        }
    return count;
}

/* Finds the fragments of the part's pieces and lists their nodes; returns their number. */
static int sbi_piece_find_fragments(sbi_piece_maker *m, int begin, int end)
{
    int count = 0;
    for (int k = begin; k < end; k++)
        m->fragment_of[m->nodes[k]] = -1;
    for (int k = begin; k < end; k++)
        if (m->fragment_of[m->nodes[k]] < 0) {
            m->roots[count] = count;
            m->sizes[count] = sbi_piece_spread(m, m->nodes[k], count);
            count++;
        }
    m->start[0] = 0;
    for (int f = 0; f < count; f++)
        m->start[f + 1] = m->start[f] + m->sizes[f];
    for (int k = end; k-- > begin;)
        m->list[--m->start[m->fragment_of[m->nodes[k]] + 1]] = m->nodes[k];
    for (int f = 0; f < count; f++) /* filling moved each end to its beginning */
        m->start[f] = m->start[f + 1];
    m->start[count] = end - begin;
    return count;
}

static int sbi_piece_root(const sbi_piece_maker *m, int fragment)
{
    while (m->roots[fragment] != fragment)
        fragment = m->roots[fragment];
    return fragment;
}

/* What a fragment shares most blocks with; -1: nothing but itself. */
static int sbi_piece_neighbour(const sbi_piece_maker *m, int fragment)
{
    const sb_matrix *a = m->a;
    int best = -1;
    for (int pass = 0; pass < 2; pass++)
        for (int k = m->start[fragment]; k < m->start[fragment + 1]; k++)
            for (int q = a->row_start[m->list[k]]; q < a->row_end[m->list[k]]; q++) {
                int other = sbi_piece_root(m, m->fragment_of[a->columns[q]]);
                m->touching[other] = pass == 0 ? m->touching[other] + 1 : 0;
                if (pass == 0 && other != fragment && (best < 0 || m->touching[other] > m->touching[best]))
                    best = other;
            }
    return best;
}

/* Fragments under a quarter of the mean size join what they touch most: they cost as much as whole pieces. */
static void sbi_piece_join(sbi_piece_maker *m, int rows, int pieces, int fragment_count)
{
    for (int f = 0; f < fragment_count && fragment_count > pieces; f++) {
        int best = 4 * (long long)m->sizes[f] * pieces < rows ? sbi_piece_neighbour(m, f) : -1;
        if (best < 0)
            continue;
        m->roots[f] = best;
        m->sizes[best] += m->sizes[f];
    }
}

/* Numbers what has joined nothing from 0 on and gives all nodes these numbers; returns how many there are. */
static int sbi_piece_number(sbi_piece_maker *m, int begin, int end, int fragment_count)
{
    int *number = m->touching, count = 0;
    for (int f = 0; f < fragment_count; f++)
        if (m->roots[f] == f)
            number[f] = count++;
    for (int k = begin; k < end; k++) {
        int node = m->nodes[k];
        m->fragment_of[node] = number[sbi_piece_root(m, m->fragment_of[node])];
    }
    memset(number, 0, (size_t)fragment_count * sizeof(int));
    return count;
}

/* Lines the part's pieces up along its longest side, so that those that touch have near numbers and the rows of their
 * matrix are short, and lists its nodes by piece, each in the order of the rows: what reads a piece's rows then finds
 * them one after the other. */
static void sbi_piece_line_up(sbi_piece_maker *m, int begin, int end, int count)
{
    int *order = m->roots, *rank = m->sizes, *next = m->start;
    sb_vec3 low, high;
    int axis = sbi_precond_longest_axis(m->positions, m->nodes + begin, end - begin, &low, &high);
    memset(m->centres, 0, (size_t)count * sizeof *m->centres);
    memset(next, 0, ((size_t)count + 1) * sizeof *next);
    memcpy(m->list, m->a->part_rows + begin, (size_t)(end - begin) * sizeof(int));
    for (int k = 0; k < end - begin; k++) { /* in an order that cuts do not change: sums tell who comes first */
        int f = m->fragment_of[m->list[k]];
        m->centres[f] = sb_v3_add(m->centres[f], m->positions[m->list[k]]);
        next[f]++;
    }
    for (int f = 0; f < count; f++) {
        m->centres[f] = sb_v3_scale((sb_real)1 / (sb_real)next[f], m->centres[f]);
        order[f] = f;
    }
    sbi_precond_sort_nodes(m->centres, axis, order, count);
    for (int a = 0; m->cuts && a < count && m->piece_count + a < m->cuts->room; a++)
        m->cuts->axis[m->piece_count + a] = a > 0 ? axis : -1;
    for (int a = 0, at = begin; a < count; a++) {
        int size = next[order[a]];
        rank[order[a]] = m->piece_count + a;
        next[order[a]] = at;
        at += size;
    }
    for (int k = 0; k < end - begin; k++) {
        int f = m->fragment_of[m->list[k]];
        m->nodes[next[f]++] = m->list[k];
        m->piece_of[m->list[k]] = rank[f];
    }
    m->piece_count += count;
}

/* ---- lips ---------------------------------------------------------------------------------------------- */

enum {
    SBI_LIPS_APART =
        3, /* blocks from one lip to the other where they are apart: round the front of a cut two will do */
    SBI_LIPS_LOOKS = 16 /* pairs of nodes in a piece whose ways to each other are looked for */
};

static int sbi_piece_same_place(const sb_vec3 *a, const sb_vec3 *b) { return memcmp(a, b, sizeof *a) == 0; }

/* place_of[i] = the first node where node i is, to the last bit: virtual nodes are made so. Returns 1 when one is not
 * alone in its place. table [4 rows]: scratch. */
static int sbi_piece_find_places(const sb_vec3 *positions, int rows, int *table, int *place_of)
{
    size_t size = 2;
    int shared = 0;
    while (size < 2 * (size_t)rows)
        size *= 2;
    for (size_t k = 0; k < size; k++)
        table[k] = -1;
    for (int i = 0; i < rows; i++) {
        uint64_t hash = sbi_hash_word(sbi_hash_word(0, sbi_real_bits(positions[i].x)), sbi_real_bits(positions[i].y));
        size_t at = (size_t)sbi_hash_word(hash, sbi_real_bits(positions[i].z)) & (size - 1);
        while (table[at] >= 0 && !sbi_piece_same_place(positions + table[at], positions + i))
            at = (at + 1) & (size - 1);
        table[at] = table[at] < 0 ? i : table[at];
        place_of[i] = table[at];
        shared |= table[at] != i;
    }
    return shared;
}

/* Blocks on the way from node `from` to each of the piece's nodes[count]. */
static void sbi_piece_measure_ways(sbi_piece_maker *m, const int *nodes, int count, int from, int *ways)
{
    const sb_matrix *a = m->a;
    int *queue = m->list, met = 1;
    for (int k = 0; k < count; k++)
        ways[nodes[k]] = -1;
    queue[0] = from;
    ways[from] = 0;
    for (int head = 0; head < met; head++) {
        int i = queue[head];
        for (int q = a->row_start[i]; q < a->row_end[i]; q++) {
            int j = a->columns[q];
            if (m->fragment_of[j] != m->fragment_of[i] || ways[j] >= 0)
                continue;
            ways[j] = ways[i] + 1;
            queue[met++] = j;
        }
    }
}

/* Two nodes of a piece in one place. */
typedef struct sbi_piece_twins {
    int first, second; /* -1: there are none */
} sbi_piece_twins;

/* The node halfway along a shortest way to node `to`. */
static int sbi_piece_middle(const sbi_piece_maker *m, int to, const int *ways)
{
    const sb_matrix *a = m->a;
    int left = ways[to] / 2;
    while (ways[to] > left)
        for (int q = a->row_start[to], at = to; to == at; q++)
            if (m->fragment_of[a->columns[q]] == m->fragment_of[at] && ways[a->columns[q]] == ways[at] - 1)
                to = a->columns[q];
    return to;
}

/* The twins among a piece's nodes[count] that are farthest from each other within it, of such the first; or, of many,
 * some of the farthest. None are farther than by way of the node halfway between the first ones, which lies near the
 * front of the cut. ways, others: scratch */
static sbi_piece_twins sbi_piece_find_twins(sbi_piece_maker *m, const int *nodes, int count, int *ways, int *others)
{
    sbi_piece_twins best = {-1, -1};
    int farthest = SBI_LIPS_APART - 1, looks = 0;
    for (int k = 0; k < count; k++) {
        int i = nodes[k], other = m->last_at[m->place_of[i]];
        m->last_at[m->place_of[i]] = i;
        if (other < 0 || looks == SBI_LIPS_LOOKS || (looks > 0 && others[i] + others[other] <= farthest))
            continue;
        sbi_piece_measure_ways(m, nodes, count, other, ways);
        if (looks++ == 0)
            sbi_piece_measure_ways(m, nodes, count, sbi_piece_middle(m, i, ways), others);
        if (ways[i] <= farthest)
            continue;
        farthest = ways[i];
        best.first = other;
        best.second = i;
    }
    for (int k = 0; k < count; k++)
        m->last_at[m->place_of[nodes[k]]] = -1;
    return best;
}

/* Parts the piece nodes[count], in ascending order, where its widest open twins lie on two lips of a cut: each node
 * goes with the one that it is nearer to, so that both halves hang together. And so on with these. */
static void sbi_piece_part_lips(sbi_piece_maker *m, int *nodes, int count)
{
    int *ways = m->roots, *others = m->sizes, *moved = m->list, stay = 0, go = 0;
    sbi_piece_twins twins;
    if (m->piece_count + m->own_count >= m->most)
        return;
    twins = sbi_piece_find_twins(m, nodes, count, ways, others);
    if (twins.first < 0)
        return;
    sbi_piece_measure_ways(m, nodes, count, twins.first, ways);
    sbi_piece_measure_ways(m, nodes, count, twins.second, others);
    for (int k = 0; k < count; k++) {
        int i = nodes[k];
        if (others[i] < ways[i]) {
            moved[go++] = i;
            m->fragment_of[i] = m->own_count;
        } else {
            nodes[stay++] = i;
        }
    }
    memcpy(nodes + stay, moved, (size_t)go * sizeof *nodes);
    m->own_count++;
    sbi_piece_part_lips(m, nodes, stay);
    sbi_piece_part_lips(m, nodes + stay, go);
}

/* The same of all `count` pieces of the part that fragment_of tells; returns how many there are then. */
static int sbi_piece_part_all_lips(sbi_piece_maker *m, int begin, int end, int count)
{
    const int *rows = m->a->part_rows;
    int *start = m->start;
    memset(start, 0, ((size_t)count + 1) * sizeof *start);
    for (int k = begin; k < end; k++)
        start[m->fragment_of[rows[k]] + 1]++;
    for (int f = 0; f < count; f++)
        start[f + 1] += start[f];
    for (int k = end; k-- > begin;) /* from behind: ends become beginnings */
        m->nodes[begin + --start[m->fragment_of[rows[k]] + 1]] = rows[k];
    m->own_count = count;
    for (int f = 0; f < count; f++) {
        int last = f + 1 < count ? start[f + 2] : end - begin;
        sbi_piece_part_lips(m, m->nodes + begin + start[f + 1], last - start[f + 1]);
    }
    return m->own_count;
}

/* nodes[begin, end) are a connected part, or all nodes that are coupled with no other: these need no motions in common,
 * but cost next to nothing as one piece. */
static void sbi_piece_make_part(sbi_piece_maker *m, int begin, int end, int pieces)
{
    int rows = m->a->row_count, alone = m->a->row_end[m->nodes[begin]] - m->a->row_start[m->nodes[begin]] == 1;
    int share = (int)((2 * (long long)pieces * (end - begin) + rows) / (2 * (long long)rows)), count = 1;
    share = alone || share < 1 ? 1 : share;
    sbi_piece_cut(m, begin, end, share, 0, -1);
    if (alone) {
        for (int k = begin; k < end; k++)
            m->fragment_of[m->nodes[k]] = 0;
    } else {
        int fragments = sbi_piece_find_fragments(m, begin, end);
        sbi_piece_join(m, end - begin, share, fragments);
        count = sbi_piece_number(m, begin, end, fragments);
        if (m->has_twins)
            count = sbi_piece_part_all_lips(m, begin, end, count);
    }
    sbi_piece_line_up(m, begin, end, count);
}

SBI_API int sbi_precond_make_pieces(const sb_matrix *a, const sb_vec3 *positions, int pieces, int *scratch,
                                    sb_vec3 *centres, int *nodes, int *piece_of, sbi_piece_cuts *cuts)
{
    size_t rows = (size_t)a->row_count;
    int *places = cuts ? cuts->places : scratch + 7 * rows + 1;
    sbi_piece_maker m;
    memset(&m, 0, sizeof m);
    m.a = a;
    m.positions = positions;
    m.nodes = nodes;
    m.piece_of = piece_of;
    m.fragment_of = scratch;
    m.list = m.fragment_of + rows;
    m.sizes = m.list + rows;
    m.roots = m.sizes + rows;
    m.touching = m.roots + rows;
    m.start = m.touching + rows;
    m.last_at = m.start + rows + 1;
    m.centres = centres;
    m.cuts = cuts;
    m.place_of = places;
    m.has_twins = sbi_piece_find_places(positions, a->row_count, scratch, places);
    m.most = pieces > INT_MAX / 2 ? INT_MAX : 2 * pieces;
    for (size_t i = 0; i < rows; i++)
        m.last_at[i] = -1;
    if (cuts) {
        cuts->split_count = 0;
        memcpy(cuts->positions, positions, rows * sizeof(sb_vec3));
    }
    memset(m.touching, 0, rows * sizeof(int));
    sbi_matrix_list_parts(a);
    memcpy(nodes, a->part_rows, rows * sizeof(int));
    for (int c = 0; c < a->part_count; c++)
        sbi_piece_make_part(&m, a->part_start[c], a->part_start[c + 1], pieces);
    return m.piece_count;
}

/* ---- a cut that stays ---------------------------------------------------------------------------------- */

static int sbi_piece_is_inside(sb_vec3 x, sb_vec3 low, sb_vec3 high)
{
    return x.x > low.x && x.x < high.x && x.y > low.y && x.y < high.y && x.z > low.z && x.z < high.z;
}

/* Whether node i, which has moved, is within each of its boxes as before, and on the same side of each cut without
 * being one of the two nodes that it lies between. */
static int sbi_piece_node_stays(const sbi_piece_cuts *cuts, const sb_vec3 *positions, int i)
{
    for (int s = cuts->split_of[i]; s >= 0; s = cuts->splits[s].within) {
        const sbi_piece_split *split = cuts->splits + s;
        int is_left = sbi_precond_before(cuts->positions, split->axis, i, split->last);
        int stays = is_left ? sbi_precond_before(positions, split->axis, i, split->last)
                            : sbi_precond_before(positions, split->axis, split->first, i);
        if (!stays || i == split->last || i == split->first ||
            !sbi_piece_is_inside(cuts->positions[i], split->low, split->high) ||
            !sbi_piece_is_inside(positions[i], split->low, split->high))
            return 0;
    }
    return 1;
}

/* Whether the pieces, which are what they were, still follow each other along their parts' longest sides. */
static int sbi_piece_order_stays(const sb_matrix *a, const sb_vec3 *positions, const sbi_piece_cuts *cuts,
                                 const int *piece_of, int piece_count, int *sizes, sb_vec3 *centres)
{
    memset(centres, 0, (size_t)piece_count * sizeof *centres);
    memset(sizes, 0, (size_t)piece_count * sizeof *sizes);
    for (int k = 0; k < a->row_count; k++) {
        int i = a->part_rows[k], piece = piece_of[i];
        centres[piece] = sb_v3_add(centres[piece], positions[i]);
        sizes[piece]++;
    }
    for (int p = 0; p < piece_count; p++) {
        int axis = cuts->axis[p];
        centres[p] = sb_v3_scale((sb_real)1 / (sb_real)sizes[p], centres[p]);
        if (axis >= 0 && !(sbi_precond_coordinate(centres, p - 1, axis) < sbi_precond_coordinate(centres, p, axis)))
            return 0;
    }
    return 1;
}

SBI_API int sbi_precond_pieces_stay(const sb_matrix *a, const sb_vec3 *positions, sbi_piece_cuts *cuts,
                                    const int *piece_of, int piece_count, int *scratch, sb_vec3 *centres)
{
    int *places = scratch + 4 * (size_t)a->row_count;
    sbi_matrix_list_parts(a);
    for (int i = 0; i < a->row_count; i++)
        if (!sbi_piece_same_place(positions + i, cuts->positions + i) && !sbi_piece_node_stays(cuts, positions, i))
            return 0;
    (void)sbi_piece_find_places(positions, a->row_count, scratch, places);
    if (memcmp(places, cuts->places, (size_t)a->row_count * sizeof *places) != 0) /* lips would be others */
        return 0;
    if (!sbi_piece_order_stays(a, positions, cuts, piece_of, piece_count, scratch, centres))
        return 0;
    memcpy(cuts->positions, positions, (size_t)a->row_count * sizeof(sb_vec3));
    return 1;
}
