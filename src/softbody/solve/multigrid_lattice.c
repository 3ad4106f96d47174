/* multigrid_lattice: coarse nodes on a lattice laid over the nodes of a level. */
#include "multigrid_level.h"

#include <limits.h>
#include <math.h>
#include <string.h>

/* Where a node lies: the corners of its tet that have a share. */
typedef struct sbi_cubes_place {
    int count;
    int64_t points[4];
    double weights[4];
} sbi_cubes_place;

static double sbi_cubes_coordinate(sb_vec3 x, int axis) { return (double)(axis == 0 ? x.x : axis == 1 ? x.y : x.z); }

/* Lays the boxes around the nodes of their regions; returns the largest extent. */
static double sbi_cubes_bound(const sbi_mg_nodes *nodes, sbi_cubes *lattices, int lattice_count)
{
    double largest = 0;
    for (int l = 0; l < lattice_count; l++)
        lattices[l].edge = -1; /* empty so far */
    for (int i = 0; i < nodes->level->row_count; i++) {
        sbi_cubes *lattice = lattices + (nodes->labels ? nodes->labels[i] : 0);
        for (int axis = 0; axis < 3; axis++) {
            double x = sbi_cubes_coordinate(nodes->positions[i], axis), low = lattice->low[axis];
            double high = lattice->extent[axis];
            lattice->low[axis] = lattice->edge < 0 || x < low ? x : low;
            lattice->extent[axis] = lattice->edge < 0 || x > high ? x : high; /* the upper end */
        }
        lattice->edge = 0;
    }
    for (int l = 0; l < lattice_count; l++)
        for (int axis = 0; axis < 3 && lattices[l].edge >= 0; axis++) {
            lattices[l].extent[axis] -= lattices[l].low[axis];
            largest = lattices[l].extent[axis] > largest ? lattices[l].extent[axis] : largest;
        }
    return largest;
}

/* Cells of about the edges that are set, which fill the boxes. */
static void sbi_cubes_cut(sbi_cubes *lattices, int lattice_count)
{
    int64_t first = 0;
    for (int l = 0; l < lattice_count; l++) {
        sbi_cubes *lattice = lattices + l;
        int64_t points = 1;
        int small = lattice_count > 1;
        for (int axis = 0; axis < 3; axis++)
            small = small && lattice->extent[axis] <= 0.6 * lattice->edge;
        lattice->tet = small;
        lattice->first = first;
        for (int axis = 0; axis < 3; axis++) {
            double cells = lattice->extent[axis] / lattice->edge + 0.5; /* not a number where there is no extent */
            lattice->cells[axis] = cells >= 1 && cells < 1e6 ? (int)cells : lattice->extent[axis] > 0;
            points *= lattice->cells[axis] + 1;
        }
        first += points;
    }
}

static int64_t sbi_cubes_point(const sbi_cubes *lattice, const int at[3])
{
    return lattice->first + ((int64_t)at[2] * (lattice->cells[1] + 1) + at[1]) * (lattice->cells[0] + 1) + at[0];
}

/* Shares below a ten-thousandth are left out, lest a coarse node hang on nothing else. */
static void sbi_cubes_add(const sbi_cubes *lattice, const int at[3], double weight, sbi_cubes_place *place)
{
    if (weight < 1e-4)
        return;
    place->points[place->count] = sbi_cubes_point(lattice, at);
    place->weights[place->count++] = weight;
}

/* Shares of the corners of the one tet, whose edges are three times as long as the box, or of the cell's tet. */
static void sbi_cubes_share_out(const sbi_cubes *lattice, int at[3], const double share[3], sbi_cubes_place *place)
{
    int order[3] = {0, 1, 2};
    if (lattice->tet) {
        sbi_cubes_add(lattice, at, 1 - (share[0] + share[1] + share[2]) / 3, place);
        for (int axis = 0; axis < 3; axis++) {
            int corner[3] = {0, 0, 0};
            corner[axis] = lattice->cells[axis];
            sbi_cubes_add(lattice, corner, share[axis] / 3, place);
        }
        return;
    }
    for (int a = 1; a < 3; a++) /* by falling share */
        for (int b = a; b > 0 && share[order[b]] > share[order[b - 1]]; b--) {
            int swap = order[b];
            order[b] = order[b - 1];
            order[b - 1] = swap;
        }
    sbi_cubes_add(lattice, at, 1 - share[order[0]], place);
    for (int k = 0; k < 3; k++) {
        at[order[k]]++;
        sbi_cubes_add(lattice, at, share[order[k]] - (k < 2 ? share[order[k + 1]] : 0), place);
    }
}

static sbi_cubes_place sbi_cubes_find(const sbi_cubes *lattice, sb_vec3 position)
{
    sbi_cubes_place place;
    int at[3];
    double share[3], sum = 0;
    place.count = 0;
    for (int axis = 0; axis < 3; axis++) {
        int cells = lattice->cells[axis];
        double way = sbi_cubes_coordinate(position, axis) - lattice->low[axis];
        double t = cells ? way / lattice->extent[axis] * cells : 0;
        at[axis] = (int)t;
        if (cells && at[axis] >= cells)
            at[axis] = cells - 1;
        share[axis] = t - at[axis];
    }
    sbi_cubes_share_out(lattice, at, share, &place);
    for (int k = 0; k < place.count; k++)
        sum += place.weights[k];
    for (int k = 0; k < place.count; k++)
        place.weights[k] /= sum;
    return place;
}

static sb_vec3 sbi_cubes_position(const sbi_cubes *lattice, int64_t point)
{
    double x[3];
    point -= lattice->first;
    for (int axis = 0; axis < 3; axis++) {
        int64_t points = lattice->cells[axis] + 1;
        double share = lattice->cells[axis] ? (double)(point % points) / lattice->cells[axis] : 0;
        x[axis] = lattice->low[axis] + (lattice->tet ? 3 : 1) * share * lattice->extent[axis];
        point /= points;
    }
    return sb_v3((sb_real)x[0], (sb_real)x[1], (sb_real)x[2]);
}

/* ---- points in use ------------------------------------------------------------------------------------- */

/* Numbers points in the order they come: open addressing, a power of two of places. */
typedef struct sbi_cubes_table {
    size_t mask;
    int64_t *points; /* [mask + 1] -1: free */
    int *numbers;    /* [mask + 1] */
    int count;
} sbi_cubes_table;

static int sbi_cubes_number(sbi_cubes_table *table, int64_t point)
{
    uint64_t hash = (uint64_t)point * UINT64_C(0x9E3779B97F4A7C15);
    size_t at = (size_t)(hash >> 20) & table->mask;
    while (table->points[at] >= 0 && table->points[at] != point)
        at = (at + 1) & table->mask;
    if (table->points[at] < 0) {
        table->points[at] = point;
        table->numbers[at] = table->count++;
    }
    return table->numbers[at];
}

static void sbi_cubes_forget(sbi_cubes_table *table)
{
    for (size_t k = 0; k <= table->mask; k++)
        table->points[k] = -1;
    table->count = 0;
}

/* 1: no more than `most` points are in use by the places. */
static int sbi_cubes_fits(const sbi_cubes_place *places, int row_count, int most, sbi_cubes_table *table)
{
    sbi_cubes_forget(table);
    for (int i = 0; i < row_count && table->count <= most; i++)
        for (int k = 0; k < places[i].count; k++)
            sbi_cubes_number(table, places[i].points[k]);
    return table->count <= most;
}

/* 1: the lattice is the one of the level before. */
static int sbi_cubes_stays(const sbi_cubes *lattice, const sbi_mg_nodes *nodes)
{
    const sbi_cubes *old = nodes->match->old && !nodes->labels ? nodes->match->old->lattice : NULL;
    return old && nodes->match->old->parents && !lattice->tet && memcmp(lattice->low, old->low, sizeof old->low) == 0 &&
           memcmp(lattice->extent, old->extent, sizeof old->extent) == 0 &&
           memcmp(lattice->cells, old->cells, sizeof old->cells) == 0;
}

/* 1: the node is where it was, had parents, and so lies between the points that these were. */
static int sbi_cubes_keep_place(const sbi_mg_nodes *nodes, int row, sbi_cubes_place *place)
{
    const sbi_mg_level *old = nodes->match->old;
    int was = nodes->match->was[row], first;
    if (was < 0 || memcmp(nodes->positions + row, old->places + was, sizeof *old->places) != 0)
        return 0;
    first = old->parent_start[was];
    place->count = old->parent_start[was + 1] - first;
    for (int k = 0; k < place->count; k++) {
        place->points[k] = old[1].points[old->parents[first + k]];
        place->weights[k] = (double)old->shares[first + k];
    }
    return place->count > 0;
}

/* Cells of the edges that are set, and where the nodes lie in them. */
static void sbi_cubes_lay(sbi_cubes *lattices, int lattice_count, const sbi_mg_nodes *nodes, sbi_cubes_place *places)
{
    int stays;
    sbi_cubes_cut(lattices, lattice_count);
    stays = sbi_cubes_stays(lattices, nodes);
    for (int i = 0; i < nodes->level->row_count; i++)
        if (!stays || !sbi_cubes_keep_place(nodes, i, places + i))
            places[i] = sbi_cubes_find(lattices + (nodes->labels ? nodes->labels[i] : 0), nodes->positions[i]);
}

/* Keeps the `limit` smallest of the numbers given, ascending; returns their count. */
static int sbi_cubes_keep_least(double *least, int count, int limit, double value)
{
    int place;
    if (count == limit && value >= least[limit - 1])
        return count;
    place = count == limit ? limit - 1 : count;
    for (; place > 0 && least[place - 1] > value; place--)
        least[place] = least[place - 1];
    least[place] = value;
    return count == limit ? limit : count + 1;
}

/* Mean distance of a node to the nearest of those of its region that it is coupled with (m), up to six: that many are
 * next to it in a regular solid, so that the long ways within quadratic elements do not count. 0: coupled with none. */
static double sbi_cubes_node_spacing(const sbi_mg_nodes *nodes, int row)
{
    enum { NEAREST = 6 };
    const sbi_mg_level *level = nodes->level;
    const sb_vec3 *positions = nodes->positions;
    double squares[NEAREST], sum = 0;
    int count = 0;
    for (int q = level->row_start[row]; q < level->row_start[row + 1]; q++) {
        sb_vec3 way = sb_v3_sub(positions[level->columns[q]], positions[row]);
        if (level->columns[q] != row && (!nodes->labels || nodes->labels[level->columns[q]] == nodes->labels[row]))
            count = sbi_cubes_keep_least(squares, count, NEAREST, (double)sb_v3_dot(way, way));
    }
    for (int k = 0; k < count; k++)
        sum += sqrt(squares[k]);
    return count ? sum / count : 0;
}

/* Marks nodes whose spacing is the one before: the row has the columns it had, and these lie where they lay. */
static void sbi_cubes_mark_kept(const sbi_mg_nodes *nodes, unsigned char *kept)
{
    const sbi_mg_level *level = nodes->level, *old = nodes->match->old;
    memset(kept, 0, (size_t)level->row_count);
    if (!old || !old->spacings)
        return;
    memcpy(kept, nodes->match->same, (size_t)level->row_count);
    for (int i = 0; i < level->row_count; i++) {
        int was = nodes->match->was[i];
        if (was >= 0 && memcmp(nodes->positions + i, old->places + was, sizeof *old->places) == 0)
            continue;
        for (int q = level->row_start[i]; q < level->row_start[i + 1]; q++)
            kept[level->columns[q]] = 0; /* the pattern is symmetric */
    }
}

static void sbi_cubes_list_spacings(const sbi_mg_nodes *nodes, unsigned char *kept, double *spacings)
{
    sbi_cubes_mark_kept(nodes, kept);
    for (int i = 0; i < nodes->level->row_count; i++)
        spacings[i] = kept[i] ? nodes->match->old->spacings[nodes->match->was[i]] : sbi_cubes_node_spacing(nodes, i);
}

/* 1: the node is coupled with a softer region. */
static int sbi_cubes_is_on_jump(const sbi_mg_nodes *nodes, int row)
{
    const sbi_mg_level *level = nodes->level;
    const sb_real *moduli = nodes->regions->moduli;
    for (int q = level->row_start[row]; q < level->row_start[row + 1]; q++)
        if (moduli[nodes->labels[level->columns[q]]] < moduli[nodes->labels[row]])
            return 1;
    return 0;
}

/* What decides about a region's cells. */
typedef struct sbi_cubes_measure {
    double spacing; /* of its nodes, summed up */
    int count;      /* of its nodes */
    int on_jump;    /* those that are coupled with a softer region */
} sbi_cubes_measure;

/* Edges of about `ratio` times the mean spacing of a region's nodes. Cells larger than the thickness of a stiff sheet
 * or rod resist its bending far too much, the more so the larger they are: such regions take smaller steps. */
static void sbi_cubes_set_edges(const sbi_mg_nodes *nodes, const double *spacings, double ratio, double thin_ratio,
                                sbi_cubes_measure *measures, sbi_cubes *lattices, int lattice_count)
{
    memset(measures, 0, (size_t)lattice_count * sizeof *measures);
    for (int i = 0; i < nodes->level->row_count; i++) {
        sbi_cubes_measure *measure = measures + (nodes->labels ? nodes->labels[i] : 0);
        measure->spacing += spacings[i];
        measure->count++;
        measure->on_jump += nodes->labels && sbi_cubes_is_on_jump(nodes, i);
    }
    for (int l = 0; l < lattice_count; l++) {
        const sbi_cubes_measure *measure = measures + l;
        int thin = measure->count < 2 * measure->on_jump;
        lattices[l].edge = (thin ? thin_ratio : ratio) * measure->spacing / (measure->count ? measure->count : 1);
    }
}

/* Cells of the edges that are set, or larger ones as long as more than `most` points were in use; one cell at least.
 * Writes where the nodes lie in them. */
static void sbi_cubes_choose(sbi_cubes *lattices, int lattice_count, double largest, const sbi_mg_nodes *nodes,
                             int most, sbi_cubes_table *table, sbi_cubes_place *places)
{
    double least = largest;
    for (int l = 0; l < lattice_count; l++) {
        lattices[l].edge = lattices[l].edge > 1e-5 * largest ? lattices[l].edge : 1e-5 * largest;
        least = lattices[l].edge < least ? lattices[l].edge : least;
    }
    for (; least < largest; least *= 1.25) {
        sbi_cubes_lay(lattices, lattice_count, nodes, places);
        if (sbi_cubes_fits(places, nodes->level->row_count, most, table))
            return;
        for (int l = 0; l < lattice_count; l++)
            lattices[l].edge *= 1.25;
    }
    for (int l = 0; l < lattice_count; l++)
        lattices[l].edge = largest;
    sbi_cubes_lay(lattices, lattice_count, nodes, places);
}

/* ---- rows ---------------------------------------------------------------------------------------------- */

typedef struct sbi_cubes_maker {
    const sbi_mg_nodes *nodes;
    const sbi_mg_level *level;
    sbi_cubes *lattices; /* [lattice_count] by region */
    int lattice_count;
    sbi_cubes_table table;
    sbi_cubes_place *places; /* [rows] */
    double *spacings;        /* [rows] mean distances to the nearest nodes (m) */
    unsigned char *kept;     /* [rows] scratch */
    int point_count;
    int64_t *points; /* [point_count] */
    int *list_start; /* [point_count + 1] into list: the entries of the rows by point */
    int *list;
    int *owner;    /* [entries] row of each entry */
    int *number;   /* [entries] coarse node of each entry, -1: not yet */
    int *entry_of; /* [rows] entry of a row in the list at work */
    int *queue;    /* [rows] */
} sbi_cubes_maker;

/* 1: nothing but itself is coupled to the node; it needs no coarse level. */
static int sbi_cubes_is_alone(const sbi_mg_level *level, int row)
{
    return level->row_start[row + 1] - level->row_start[row] == 1;
}

static const sbi_cubes *sbi_cubes_of(const sbi_cubes_maker *m, int row)
{
    return m->lattices + (m->nodes->labels ? m->nodes->labels[row] : 0);
}

static void sbi_cubes_fill(sbi_cubes_maker *m, sbi_mg_rows *rows)
{
    int entries = 0;
    sbi_cubes_forget(&m->table);
    for (int i = 0; i < m->level->row_count; i++) {
        const sbi_cubes_place *place = m->places + i;
        rows->start[i] = entries;
        for (int k = 0; k < place->count && !sbi_cubes_is_alone(m->level, i); k++, entries++) {
            rows->nodes[entries] = sbi_cubes_number(&m->table, place->points[k]);
            rows->weights[entries] = (float)place->weights[k];
            m->points[rows->nodes[entries]] = place->points[k];
            m->owner[entries] = i;
            m->number[entries] = -1;
        }
    }
    rows->start[m->level->row_count] = entries;
    m->point_count = m->table.count;
}

/* Counting sort of the entries by point. */
static void sbi_cubes_sort(sbi_cubes_maker *m, const sbi_mg_rows *rows, int entries)
{
    memset(m->list_start, 0, ((size_t)m->point_count + 1) * sizeof(int));
    for (int e = 0; e < entries; e++)
        m->list_start[rows->nodes[e] + 1]++;
    for (int p = 0; p < m->point_count; p++)
        m->list_start[p + 1] += m->list_start[p];
    for (int e = 0; e < entries; e++)
        m->list[m->list_start[rows->nodes[e]]++] = e;
    for (int p = m->point_count; p > 0; p--)
        m->list_start[p] = m->list_start[p - 1];
    m->list_start[0] = 0;
}

/* Gives the entries of a point that can be reached from entry e, node by node of the point's own, one number. `left`
 * entries have none yet; returns how many have none then. */
static int sbi_cubes_spread(sbi_cubes_maker *m, int point, int e, int number, int left)
{
    const sbi_mg_level *level = m->level;
    int count = 0;
    m->number[e] = number;
    m->queue[count++] = m->owner[e];
    for (int head = 0; head < count && count < left; head++) {
        int i = m->queue[head];
        for (int q = level->row_start[i]; q < level->row_start[i + 1]; q++) {
            int j = level->columns[q], other = m->entry_of[j];
            if (other < m->list_start[point] || other >= m->list_start[point + 1] || m->owner[m->list[other]] != j ||
                m->number[m->list[other]] >= 0)
                continue;
            m->number[m->list[other]] = number;
            m->queue[count++] = j;
        }
    }
    return left - count;
}

/* 1: the point's nodes were all the children of one coarse node before, and are coupled as they were. So they still
 * hang together, and no others lie there. */
static int sbi_cubes_was_one(const sbi_cubes_maker *m, const sbi_mg_rows *rows, int point)
{
    const sbi_mg_match *match = m->nodes->match;
    const sbi_mg_level *old = match->old;
    int first = m->list_start[point], last = m->list_start[point + 1], node = -1;
    if (!old || !old->parents)
        return 0;
    for (int s = first; s < last; s++) {
        int e = m->list[s], i = m->owner[e], parent;
        if (!match->same[i])
            return 0;
        parent = old->parent_start[match->was[i]] + e - rows->start[i];
        if (parent >= old->parent_start[match->was[i] + 1] || (node >= 0 && old->parents[parent] != node))
            return 0;
        node = old->parents[parent];
    }
    return old->child_start[node + 1] - old->child_start[node] == last - first;
}

/* Numbers the entries of a point; returns the number after the last. */
static int sbi_cubes_split_point(sbi_cubes_maker *m, int point, int number)
{
    int first = m->list_start[point], last = m->list_start[point + 1], left = last - first;
    for (int s = first; s < last; s++)
        m->entry_of[m->owner[m->list[s]]] = s;
    for (int s = first; s < last && left > 0; s++)
        if (m->number[m->list[s]] < 0)
            left = sbi_cubes_spread(m, point, m->list[s], number++, left);
    return number;
}

/* Points whose nodes do not hang together (of parts, or of two lobes with a gap between them) become several coarse
 * nodes in the same place: a coarse motion never reaches across a gap. Returns the number of coarse nodes. */
static int sbi_cubes_split(sbi_cubes_maker *m, const sbi_mg_rows *rows)
{
    int count = 0;
    for (int i = 0; i < m->level->row_count; i++)
        m->entry_of[i] = -1;
    for (int p = 0; p < m->point_count; p++) {
        if (!sbi_cubes_was_one(m, rows, p)) {
            count = sbi_cubes_split_point(m, p, count);
            continue;
        }
        for (int s = m->list_start[p]; s < m->list_start[p + 1]; s++)
            m->number[m->list[s]] = count;
        count++;
    }
    return count;
}

static int sbi_cubes_take_rows(sbi_cubes_maker *m, const sb_allocator *allocator, int entries, sbi_mg_rows *rows)
{
    size_t n = (size_t)m->level->row_count, count = (size_t)entries;
    rows->start = (int *)sbi_alloc(allocator, n + 1, sizeof(int));
    rows->nodes = (int *)sbi_alloc(allocator, count, sizeof(int));
    rows->weights = (float *)sbi_alloc(allocator, count, sizeof(float));
    m->points = (int64_t *)sbi_alloc(allocator, count, sizeof(int64_t));
    m->list_start = (int *)sbi_alloc(allocator, 4 * count + 2 * n + 1, sizeof(int));
    if (!rows->start || !rows->nodes || !rows->weights || !m->points || !m->list_start)
        return 0;
    m->list = m->list_start + count + 1;
    m->owner = m->list + count;
    m->number = m->owner + count;
    m->entry_of = m->number + count;
    m->queue = m->entry_of + n;
    return 1;
}

/* Positions and regions of the coarse nodes, which were numbered in the order of the lists. */
static void sbi_cubes_place_nodes(const sbi_cubes_maker *m, sbi_mg_rows *rows)
{
    int next = 0;
    for (int p = 0; p < m->point_count; p++)
        for (int s = m->list_start[p]; s < m->list_start[p + 1]; s++) {
            int e = m->list[s];
            if (m->number[e] < next)
                continue;
            rows->positions[next] = sbi_cubes_position(sbi_cubes_of(m, m->owner[e]), m->points[p]);
            rows->points[next] = m->points[p];
            if (rows->labels)
                rows->labels[next] = m->nodes->labels[m->owner[e]];
            next++;
        }
}

static int sbi_cubes_make_rows(sbi_cubes_maker *m, const sb_allocator *allocator, sbi_mg_rows *rows)
{
    int entries;
    if (m->level->row_count > INT_MAX / 4 || !sbi_cubes_take_rows(m, allocator, 4 * m->level->row_count, rows))
        return 0; /* a node lies in a tet */
    sbi_cubes_fill(m, rows);
    entries = rows->start[m->level->row_count];
    sbi_cubes_sort(m, rows, entries);
    rows->coarse_count = sbi_cubes_split(m, rows);
    rows->positions = (sb_vec3 *)sbi_alloc(allocator, (size_t)rows->coarse_count, sizeof(sb_vec3));
    rows->points = (int64_t *)sbi_alloc(allocator, (size_t)rows->coarse_count, sizeof(int64_t));
    if (m->nodes->labels)
        rows->labels = (int *)sbi_alloc(allocator, (size_t)rows->coarse_count, sizeof(int));
    if (!rows->positions || !rows->points || (!rows->labels && m->nodes->labels))
        return 0;
    sbi_cubes_place_nodes(m, rows);
    for (int e = 0; e < entries; e++)
        rows->nodes[e] = m->number[e];
    return 1;
}

SBI_API void sbi_mg_rows_free(const sb_allocator *allocator, sbi_mg_rows *rows)
{
    sbi_free(allocator, rows->start);
    sbi_free(allocator, rows->nodes);
    sbi_free(allocator, rows->weights);
    sbi_free(allocator, rows->positions);
    sbi_free(allocator, rows->points);
    sbi_free(allocator, rows->labels);
    memset(rows, 0, sizeof *rows);
}

static int sbi_cubes_take_scratch(sbi_cubes_maker *m, const sb_allocator *allocator, sbi_cubes_measure **measures)
{
    size_t places = 64, lattices, rows = (size_t)m->level->row_count;
    m->lattice_count = m->nodes->labels ? m->nodes->regions->count : 1;
    lattices = (size_t)m->lattice_count;
    /* twice the points that can come: half of the rows and some, or the corners of one cell of each region */
    while (places < rows + 16 * lattices + 64)
        places *= 2;
    m->table.mask = places - 1;
    m->places = (sbi_cubes_place *)sbi_alloc(allocator, rows, sizeof *m->places);
    m->kept = (unsigned char *)sbi_alloc(allocator, rows, 1);
    m->spacings = m->nodes->spacings;
    if (!m->spacings)
        m->spacings = (double *)sbi_alloc(allocator, rows, sizeof(double));
    m->table.points = (int64_t *)sbi_alloc(allocator, places, sizeof(int64_t));
    m->table.numbers = (int *)sbi_alloc(allocator, places, sizeof(int));
    m->lattices = (sbi_cubes *)sbi_alloc_zeroed(allocator, lattices, sizeof(sbi_cubes));
    *measures = (sbi_cubes_measure *)sbi_alloc(allocator, lattices, sizeof **measures);
    return m->places && m->kept && m->spacings && m->table.points && m->table.numbers && m->lattices && *measures;
}

SBI_API int sbi_mg_lattice(const sbi_mg_nodes *nodes, double ratio, double thin_ratio, const sb_allocator *allocator,
                           sbi_mg_rows *rows)
{
    sbi_cubes_maker m;
    sbi_cubes_measure *measures;
    double largest;
    int made, count = nodes->level->row_count;
    memset(&m, 0, sizeof m);
    memset(rows, 0, sizeof *rows);
    m.nodes = nodes;
    m.level = nodes->level;
    made = sbi_cubes_take_scratch(&m, allocator, &measures);
    if (made) {
        largest = sbi_cubes_bound(nodes, m.lattices, m.lattice_count);
        sbi_cubes_list_spacings(nodes, m.kept, m.spacings);
        sbi_cubes_set_edges(nodes, m.spacings, ratio, thin_ratio, measures, m.lattices, m.lattice_count);
        sbi_cubes_choose(m.lattices, m.lattice_count, largest, nodes, nodes->labels ? count / 2 : count / 4, &m.table,
                         m.places);
        made = sbi_cubes_make_rows(&m, allocator, rows);
        if (nodes->lattice)
            *nodes->lattice = m.lattices[0];
    }
    if (!nodes->spacings)
        sbi_free(allocator, m.spacings);
    sbi_free(allocator, m.places);
    sbi_free(allocator, m.kept);
    sbi_free(allocator, m.table.points);
    sbi_free(allocator, m.table.numbers);
    sbi_free(allocator, m.lattices);
    sbi_free(allocator, measures);
    sbi_free(allocator, m.points);
    sbi_free(allocator, m.list_start);
    if (!made)
        sbi_mg_rows_free(allocator, rows);
    return made;
}
