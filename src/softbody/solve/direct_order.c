/* direct_order: an elimination order with little fill, by nested dissection. Floor 1, internal.
 *
 * A set of nodes is cut in two by a separator, which is eliminated last; the halves are cut in turn. Candidates for a
 * cut come from sweeps: the nodes in the order of x, y, z, or of their distance from a far node in the graph, join the
 * first half one by one, and those outside next to it are the separator. The place where it is smallest for the
 * balance is taken, and the separator is thinned. */
#include <stdlib.h>

#include "direct.h"

enum {
    SBI_ORDER_LEAF = 12, /* nodes: smaller sets are not cut */
    SBI_ORDER_LISTS = 3, /* lists of a set's nodes, by x, y, z */
    SBI_ORDER_DEPTH = 80 /* sets waiting to be cut: each cut leaves at most 4/5 on either side */
};

typedef struct sbi_order_set {
    int first, last; /* the same range in every list */
} sbi_order_set;

typedef struct sbi_order {
    const sb_matrix *pattern;
    int list_count;              /* 3 with positions, else 1 */
    int *lists[SBI_ORDER_LISTS]; /* [node_count] */
    int *set;                    /* [node_count] number of the set that holds the node; -1: it is in a separator */
    int *side;                   /* [node_count] 0, 1: half; 2: separator */
    int *best;                   /* [node_count] side in the best cut so far */
    int *walk;                   /* [node_count] a set in the order of the graph's distances */
    int *mark;                   /* [node_count] stamps of the walks and sweeps */
    int *moved;                  /* [node_count] scratch of the partition */
    int stamp;
} sbi_order;

/* ---- sorting by coordinates ---- */

typedef struct sbi_order_key {
    sb_real value;
    int node;
} sbi_order_key;

static int sbi_order_compare(const void *a, const void *b)
{
    const sbi_order_key *p = (const sbi_order_key *)a, *q = (const sbi_order_key *)b;
    if (p->value != q->value)
        return p->value < q->value ? -1 : 1;
    return p->node < q->node ? -1 : p->node > q->node;
}

static void sbi_order_sort(const sb_vec3 *positions, int axis, int count, sbi_order_key *keys, int *list)
{
    for (int i = 0; i < count; i++) {
        sb_vec3 x = positions[i];
        keys[i].value = axis == 0 ? x.x : axis == 1 ? x.y : x.z;
        keys[i].node = i;
    }
    qsort(keys, (size_t)count, sizeof *keys, sbi_order_compare);
    for (int i = 0; i < count; i++)
        list[i] = keys[i].node;
}

/* ---- walking the graph ---- */

/* Breadth-first from `start` over the nodes of its set that are not marked yet; appends them to walk. */
static int sbi_order_walk(sbi_order *o, int start, int count)
{
    const sb_matrix *a = o->pattern;
    int read = count;
    o->mark[start] = o->stamp;
    o->walk[count++] = start;
    for (; read < count; read++) {
        int i = o->walk[read];
        for (int q = a->row_start[i]; q < a->row_end[i]; q++) {
            int j = a->columns[q];
            if (o->set[j] != o->set[i] || o->mark[j] == o->stamp)
                continue;
            o->mark[j] = o->stamp;
            o->walk[count++] = j;
        }
    }
    return count;
}

/* The nodes of a set from one end of the graph to the other, one connected piece after the other. */
static void sbi_order_walk_set(sbi_order *o, sbi_order_set range)
{
    int count = 0;
    for (int i = range.first; i < range.last; i++) {
        int start = o->lists[0][i], end = count;
        if (o->mark[start] != 0)
            continue;
        for (int look = 0; look < 3; look++) { /* to a far end, from there to the farther one, and back */
            if (end > count)
                start = o->walk[end - 1];
            o->stamp++;
            end = sbi_order_walk(o, start, count);
        }
        count = end;
    }
}

/* ---- cuts ---- */

/* A separator of s between halves of a and b: small is good, and so is balance. */
static double sbi_order_cost(int a, int b, int s) { return ((double)s + 0.1) / ((double)a * (double)b); }

/* Sweeps over the set in the order of `list` and leaves the best cut in side. */
static double sbi_order_sweep(sbi_order *o, const int *list, int count)
{
    const sb_matrix *a = o->pattern;
    int set = o->set[list[0]], border = 0, best = -1, least = count / 5;
    double cost = 1e300;
    for (int i = 0; i < count; i++)
        o->side[list[i]] = 1;
    for (int i = 0; i < count - 1; i++) {
        int node = list[i];
        border -= o->side[node] == 2;
        o->side[node] = 0;
        for (int q = a->row_start[node]; q < a->row_end[node]; q++) {
            int j = a->columns[q];
            if (o->set[j] != set || o->side[j] != 1)
                continue;
            o->side[j] = 2;
            border++;
        }
        if (i + 1 >= least && count - i - 1 - border >= least &&
            sbi_order_cost(i + 1, count - i - 1 - border, border) < cost) {
            cost = sbi_order_cost(i + 1, count - i - 1 - border, border);
            best = i;
        }
    }
    for (int i = 0; i < count; i++)
        o->side[list[i]] = i > best;
    for (int i = 0; i <= best; i++)
        for (int q = a->row_start[list[i]]; q < a->row_end[list[i]]; q++)
            if (o->set[a->columns[q]] == set && o->side[a->columns[q]] == 1)
                o->side[a->columns[q]] = 2;
    return cost;
}

/* Neighbours of a separator's node in each half. */
static void sbi_order_neighbours(const sbi_order *o, int node, int beside[3])
{
    const sb_matrix *a = o->pattern;
    beside[0] = beside[1] = beside[2] = 0;
    for (int q = a->row_start[node]; q < a->row_end[node]; q++)
        if (o->set[a->columns[q]] == o->set[node])
            beside[o->side[a->columns[q]]]++;
}

/* Moves a separator's node into a half; its neighbours in the other half take its place. */
static void sbi_order_move(sbi_order *o, int node, int half, int sizes[3])
{
    const sb_matrix *a = o->pattern;
    o->side[node] = half;
    sizes[2]--;
    sizes[half]++;
    for (int q = a->row_start[node]; q < a->row_end[node]; q++) {
        int j = a->columns[q];
        if (o->set[j] != o->set[node] || o->side[j] != 1 - half)
            continue;
        o->side[j] = 2;
        sizes[1 - half]--;
        sizes[2]++;
    }
}

/* Thins the separator: nodes move out of it while that makes the cut cheaper. */
static double sbi_order_thin(sbi_order *o, const int *list, int count)
{
    int sizes[3] = {0, 0, 0}, changed = 1, least = count / 5;
    for (int i = 0; i < count; i++)
        sizes[o->side[list[i]]]++;
    for (int pass = 0; changed && pass < 10; pass++) {
        changed = 0;
        for (int i = 0; i < count; i++) {
            int node = list[i], beside[3];
            double now = sbi_order_cost(sizes[0], sizes[1], sizes[2]);
            if (o->side[node] != 2)
                continue;
            sbi_order_neighbours(o, node, beside);
            for (int half = 0; half < 2 && o->side[node] == 2; half++) {
                int pulled = beside[1 - half];
                int own = sizes[half] + 1, other = sizes[1 - half] - pulled;
                if (other < least || other < 1 || sbi_order_cost(own, other, sizes[2] - 1 + pulled) >= now)
                    continue;
                sbi_order_move(o, node, half, sizes);
                changed = 1;
            }
        }
    }
    return sbi_order_cost(sizes[0], sizes[1], sizes[2]);
}

/* Tries a cut along a list and keeps it when it is better than the best so far. */
static double sbi_order_try(sbi_order *o, const int *list, sbi_order_set range, double cost)
{
    int count = range.last - range.first;
    double found = sbi_order_sweep(o, list, count);
    if (found >= 1e300)
        return cost;
    found = sbi_order_thin(o, list, count);
    if (found >= cost)
        return cost;
    for (int i = 0; i < count; i++)
        o->best[list[i]] = o->side[list[i]];
    return found;
}

/* ---- dissection ---- */

/* Sorts a range of a list by side: first half, second half, separator; keeps the order within each. */
static void sbi_order_part(sbi_order *o, int *list, sbi_order_set range, int sizes[3])
{
    int at[3], count = range.last - range.first;
    sizes[0] = sizes[1] = sizes[2] = 0;
    for (int i = range.first; i < range.last; i++)
        sizes[o->best[list[i]]]++;
    at[0] = 0;
    at[1] = sizes[0];
    at[2] = sizes[0] + sizes[1];
    for (int i = range.first; i < range.last; i++)
        o->moved[at[o->best[list[i]]]++] = list[i];
    memcpy(list + range.first, o->moved, (size_t)count * sizeof(int));
}

/* Cuts a set; 0 when no cut is worth it (a clique). halves: where the two are. */
static int sbi_order_cut(sbi_order *o, sbi_order_set range, int next_set, sbi_order_set halves[2])
{
    double cost = 1e300;
    int sizes[3];
    for (int k = 0; k < o->list_count; k++)
        if (o->list_count > 1)
            cost = sbi_order_try(o, o->lists[k] + range.first, range, cost);
    for (int i = range.first; i < range.last; i++)
        o->mark[o->lists[0][i]] = 0;
    o->stamp = 0;
    sbi_order_walk_set(o, range);
    cost = sbi_order_try(o, o->walk, range, cost);
    if (cost >= 1e300)
        return 0;
    for (int k = 0; k < o->list_count; k++)
        sbi_order_part(o, o->lists[k], range, sizes);
    halves[0].first = range.first;
    halves[0].last = halves[1].first = range.first + sizes[0];
    halves[1].last = halves[1].first + sizes[1];
    for (int i = range.first; i < range.last; i++) {
        int node = o->lists[0][i];
        o->set[node] = o->best[node] == 2 ? -1 : next_set + o->best[node];
    }
    return 1;
}

/* Nodes coupled with far more nodes than others would hinder every cut: they go last (Amestoy, Davis, Duff 1996). The
 * rest is the first set. */
static sbi_order_set sbi_order_set_apart(sbi_order *o, int node_count)
{
    sbi_order_set whole;
    int sizes[3];
    double most = (double)sb_max(16, 10 * sb_sqrt((sb_real)node_count));
    whole.first = 0;
    whole.last = node_count;
    for (int i = 0; i < node_count; i++) {
        int far = (double)(o->pattern->row_end[i] - o->pattern->row_start[i]) > most;
        o->set[i] = far ? -1 : 0;
        o->best[i] = far ? 2 : 0;
    }
    for (int k = 0; k < o->list_count; k++)
        sbi_order_part(o, o->lists[k], whole, sizes);
    whole.last = sizes[0];
    return whole;
}

static void sbi_order_dissect(sbi_order *o, int node_count)
{
    sbi_order_set stack[SBI_ORDER_DEPTH];
    int depth = 1, sets = 1;
    stack[0] = sbi_order_set_apart(o, node_count);
    while (depth > 0) {
        sbi_order_set range = stack[--depth], halves[2];
        int small;
        if (range.last - range.first <= SBI_ORDER_LEAF || depth + 2 > SBI_ORDER_DEPTH ||
            !sbi_order_cut(o, range, sets, halves))
            continue;
        sets += 2;
        small = halves[1].last - halves[1].first < halves[0].last - halves[0].first;
        stack[depth++] = halves[1 - small]; /* the smaller half first keeps the stack low */
        stack[depth++] = halves[small];
    }
}

static void sbi_order_layout(sbi_order *o, size_t count, sbi_order_key **keys, sbi_arena *arena)
{
    for (int k = 0; k < o->list_count; k++)
        o->lists[k] = (int *)sbi_arena_take(arena, count, sizeof(int));
    o->set = (int *)sbi_arena_take(arena, count, sizeof(int));
    o->side = (int *)sbi_arena_take(arena, count, sizeof(int));
    o->best = (int *)sbi_arena_take(arena, count, sizeof(int));
    o->walk = (int *)sbi_arena_take(arena, count, sizeof(int));
    o->mark = (int *)sbi_arena_take(arena, count, sizeof(int));
    o->moved = (int *)sbi_arena_take(arena, count, sizeof(int));
    *keys = (sbi_order_key *)sbi_arena_take(arena, count, sizeof(sbi_order_key));
}

SBI_API sb_result sbi_direct_order(const sb_matrix *pattern, const sb_vec3 *positions, const sb_allocator *allocator,
                                   int *order, sb_error *error)
{
    sbi_order o;
    sbi_arena arena;
    sbi_order_key *keys;
    void *memory;
    int n = pattern->row_count;
    memset(&o, 0, sizeof o);
    memset(&arena, 0, sizeof arena);
    o.pattern = pattern;
    o.list_count = positions ? SBI_ORDER_LISTS : 1;
    sbi_order_layout(&o, (size_t)n, &keys, &arena);
    memory = arena.overflow ? NULL : sbi_alloc(allocator, 1, arena.used);
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to order %d nodes", n);
    arena.base = (unsigned char *)memory;
    arena.used = 0;
    sbi_order_layout(&o, (size_t)n, &keys, &arena);
    for (int i = 0; i < n; i++)
        o.lists[0][i] = i;
    for (int axis = 0; positions && axis < 3; axis++)
        sbi_order_sort(positions, axis, n, keys, o.lists[axis]);
    sbi_order_dissect(&o, n);
    memcpy(order, o.lists[0], (size_t)n * sizeof(int));
    sbi_free(allocator, memory);
    return SB_OK;
}
