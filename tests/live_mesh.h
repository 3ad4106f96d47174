/* live_mesh.h: a tet4 mesh in slots that tests and benchmarks change at random, and what each change was. Needs the
 * internals of softbody.h: define SB_STATIC and SB_IMPLEMENTATION before including it. */
#ifndef LIVE_MESH_H
#define LIVE_MESH_H

#include <stdlib.h>
#include <string.h>

/* Slots of nodes and cells; those removed last are used first. */
typedef struct live_mesh {
    int node_end, cell_end, node_room, cell_room;
    sb_vec3 *X;
    int *births; /* 0: not in use; otherwise the number of the operation that made the node */
    int *origin; /* node before the change that it comes from */
    int (*cells)[4];
    int *parents; /* cell before the change that it comes from, or -1 */
    int *free_nodes, free_node_count, *free_cells, free_cell_count;
    int births_so_far;
} live_mesh;

/* Arrays for so many slots; node_end and cell_end stay 0. */
static inline live_mesh live_mesh_make(int nodes, int cells)
{
    live_mesh m;
    memset(&m, 0, sizeof m);
    m.node_room = nodes;
    m.cell_room = cells;
    m.X = (sb_vec3 *)calloc((size_t)nodes, sizeof *m.X);
    m.births = (int *)calloc((size_t)nodes, sizeof(int));
    m.origin = (int *)calloc((size_t)nodes, sizeof(int));
    m.free_nodes = (int *)calloc((size_t)nodes, sizeof(int));
    m.cells = (int(*)[4])calloc((size_t)cells, sizeof *m.cells);
    m.parents = (int *)calloc((size_t)cells, sizeof(int));
    m.free_cells = (int *)calloc((size_t)cells, sizeof(int));
    return m;
}

static inline void live_mesh_free(live_mesh *m)
{
    free(m->X);
    free(m->births);
    free(m->origin);
    free(m->free_nodes);
    free(m->cells);
    free(m->parents);
    free(m->free_cells);
}

static inline void live_mesh_copy(live_mesh *to, const live_mesh *from)
{
    size_t nodes = (size_t)from->node_end, cells = (size_t)from->cell_end;
    memcpy(to->X, from->X, nodes * sizeof *to->X);
    memcpy(to->births, from->births, nodes * sizeof(int));
    memcpy(to->origin, from->origin, nodes * sizeof(int));
    memcpy(to->free_nodes, from->free_nodes, (size_t)from->free_node_count * sizeof(int));
    memcpy(to->cells, from->cells, cells * sizeof *to->cells);
    memcpy(to->parents, from->parents, cells * sizeof(int));
    memcpy(to->free_cells, from->free_cells, (size_t)from->free_cell_count * sizeof(int));
    to->node_end = from->node_end;
    to->cell_end = from->cell_end;
    to->free_node_count = from->free_node_count;
    to->free_cell_count = from->free_cell_count;
    to->births_so_far = from->births_so_far;
}

/* A box of nx x ny x nz cubes of six tets, edges of 1 cm, with room for `times` as many slots. */
static inline live_mesh live_mesh_box(int nx, int ny, int nz, int times)
{
    static const int paths[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {1, 0, 2}, {2, 1, 0}};
    int nodes = (nx + 1) * (ny + 1) * (nz + 1), cells = 6 * nx * ny * nz;
    live_mesh m = live_mesh_make(times * nodes, times * cells);
    for (int i = 0; i < nodes; i++) {
        int x = i / ((ny + 1) * (nz + 1)), y = i / (nz + 1) % (ny + 1), z = i % (nz + 1);
        m.X[i] = sb_v3((sb_real)x / 100, (sb_real)y / 100, (sb_real)z / 100);
        m.births[i] = 1;
        m.origin[i] = i;
    }
    for (int e = 0; e < cells; e++) {
        int cube = e / 6, at[3], swap;
        at[0] = cube / (ny * nz), at[1] = cube / nz % ny, at[2] = cube % nz;
        for (int v = 0; v < 4; v++) {
            m.cells[e][v] = (at[0] * (ny + 1) + at[1]) * (nz + 1) + at[2];
            at[v < 3 ? paths[e % 6][v] : 0]++;
        }
        swap = m.cells[e][3];
        if (e % 6 >= 3) { /* odd paths are turned inside out */
            m.cells[e][3] = m.cells[e][2];
            m.cells[e][2] = swap;
        }
        m.parents[e] = e;
    }
    m.node_end = nodes;
    m.cell_end = cells;
    m.births_so_far = 1;
    return m;
}

static inline int live_mesh_take_node(live_mesh *m, sb_vec3 X, int origin)
{
    int i = m->free_node_count ? m->free_nodes[--m->free_node_count] : m->node_end++;
    m->X[i] = X;
    m->births[i] = ++m->births_so_far;
    m->origin[i] = origin;
    return i;
}

static inline int live_mesh_take_cell(live_mesh *m)
{
    return m->free_cell_count ? m->free_cells[--m->free_cell_count] : m->cell_end++;
}

static inline int live_mesh_has(const live_mesh *m, int e, int node)
{
    const int *c = m->cells[e];
    return c[0] == node || c[1] == node || c[2] == node || c[3] == node;
}

/* Splits the edge (2), face (3) or tet (4 nodes) at its centre. */
static inline void live_mesh_split(live_mesh *m, const int *simplex, int size)
{
    sb_vec3 X = sb_v3(0, 0, 0);
    int node, end = m->cell_end, s[4];
    memcpy(s, simplex, (size_t)size * sizeof(int));
    for (int a = 0; a < size; a++)
        X = sb_v3_madd(X, 1 / (sb_real)size, m->X[s[a]]);
    node = live_mesh_take_node(m, X, m->origin[s[0]]);
    for (int e = 0; e < end; e++) {
        int old[4], has = m->cells[e][0] >= 0, parent = m->parents[e];
        for (int a = 0; a < size; a++)
            has = has && live_mesh_has(m, e, s[a]);
        if (!has)
            continue;
        memcpy(old, m->cells[e], sizeof old);
        for (int a = 0; a < size; a++) {
            int slot = a ? live_mesh_take_cell(m) : e;
            for (int v = 0; v < 4; v++)
                m->cells[slot][v] = old[v] == s[a] ? node : old[v];
            m->parents[slot] = parent;
        }
    }
}

/* Gives a random half of a node's cells a copy of it. */
static inline void live_mesh_duplicate(live_mesh *m, int node, unsigned long long *seed)
{
    int copy = -1, stays = 0;
    for (int e = 0; e < m->cell_end; e++) {
        if (m->cells[e][0] < 0 || !live_mesh_has(m, e, node))
            continue;
        if (!stays || check_random_in(seed, 0, 1) < 0.5) {
            stays = 1;
            continue;
        }
        copy = copy < 0 ? live_mesh_take_node(m, m->X[node], m->origin[node]) : copy;
        for (int v = 0; v < 4; v++)
            m->cells[e][v] = m->cells[e][v] == node ? copy : m->cells[e][v];
    }
}

/* Removes a cell and nodes that have none left. */
static inline void live_mesh_remove(live_mesh *m, int cell)
{
    int old[4];
    memcpy(old, m->cells[cell], sizeof old);
    m->cells[cell][0] = -1;
    m->free_cells[m->free_cell_count++] = cell;
    for (int v = 0; v < 4; v++) {
        int used = 0;
        for (int e = 0; e < m->cell_end && !used; e++)
            used = m->cells[e][0] >= 0 && live_mesh_has(m, e, old[v]);
        if (used)
            continue;
        m->births[old[v]] = 0;
        m->free_nodes[m->free_node_count++] = old[v];
    }
}

/* 1: an operation may need more slots than there are. */
static inline int live_mesh_is_full(const live_mesh *m)
{
    return m->node_room - m->node_end + m->free_node_count < 1 || m->cell_room - m->cell_end + m->free_cell_count < 64;
}

/* One operation at random, as far as there is room. */
static inline void live_mesh_operate(live_mesh *m, unsigned long long *seed)
{
    double kind = check_random_in(seed, 0, 1);
    int cell, nodes[4], first;
    do
        cell = (int)check_random_in(seed, 0, (double)m->cell_end);
    while (cell >= m->cell_end || m->cells[cell][0] < 0);
    memcpy(nodes, m->cells[cell], sizeof nodes);
    first = (int)check_random_in(seed, 0, 3.999);
    nodes[0] = m->cells[cell][first];
    nodes[first] = m->cells[cell][0];
    if (live_mesh_is_full(m) || kind < 0.3)
        live_mesh_remove(m, cell);
    else if (kind < 0.8)
        live_mesh_split(m, nodes, kind < 0.5 ? 2 : kind < 0.65 ? 3 : 4);
    else
        live_mesh_duplicate(m, nodes[0], seed);
}

/* Before a change: nodes and cells come from themselves. */
static inline void live_mesh_begin(live_mesh *m)
{
    for (int i = 0; i < m->node_end; i++)
        m->origin[i] = i;
    for (int e = 0; e < m->cell_end; e++)
        m->parents[e] = e;
}

/* What a change was, with arrays of its own. */
typedef struct live_change {
    sbi_mesh_change change;
    int *ints;
    sb_real *weights;
} live_change;

static inline void live_change_free(live_change *c)
{
    free(c->ints);
    free(c->weights);
}

/* The change from one mesh to another; `back`: the other way round, for which nodes that come have any source and cells
 * their own slot as parent. */
static inline live_change live_mesh_difference(const live_mesh *before, const live_mesh *after, int back)
{
    live_change made;
    sbi_mesh_change *c = &made.change;
    int nodes = before->node_end > after->node_end ? before->node_end : after->node_end, source = 0;
    int cells = before->cell_end > after->cell_end ? before->cell_end : after->cell_end, *ints;
    memset(&made, 0, sizeof made);
    made.ints = ints = (int *)calloc((size_t)(4 * nodes + 11 * cells) + 1, sizeof(int));
    made.weights = (sb_real *)calloc((size_t)nodes, sizeof(sb_real));
    while (source < before->node_end - 1 && before->births[source] == 0)
        source++;
    c->made_nodes = ints, c->source_start = ints + nodes, c->sources = ints + 2 * nodes + 1;
    c->removed_nodes = ints + 3 * nodes + 1;
    ints += 4 * nodes + 1;
    c->removed_cells = ints, c->made_cells = ints + cells, c->made_parents = ints + 2 * cells;
    c->removed_cell_nodes = ints + 3 * cells, c->made_cell_nodes = ints + 7 * cells;
    c->source_weights = made.weights;
    c->node_end = after->node_end;
    c->cell_end = after->cell_end;
    c->nodes_per_cell = 4;
    for (int i = 0; i < nodes; i++) {
        int was = i < before->node_end ? before->births[i] : 0, is = i < after->node_end ? after->births[i] : 0;
        if (was && was != is)
            made.ints[3 * nodes + 1 + c->removed_node_count++] = i;
        if (is && was != is) {
            made.ints[nodes + c->made_node_count + 1] = c->made_node_count + 1;
            made.ints[2 * nodes + 1 + c->made_node_count] = back ? source : after->origin[i];
            made.weights[c->made_node_count] = 1;
            made.ints[c->made_node_count++] = i;
        }
    }
    for (int e = 0; e < cells; e++) {
        int was = e < before->cell_end && before->cells[e][0] >= 0, is = e < after->cell_end && after->cells[e][0] >= 0;
        int same = was && is && !memcmp(before->cells[e], after->cells[e], sizeof before->cells[e]);
        for (int v = 0; v < 4 && same; v++)
            same = before->births[before->cells[e][v]] == after->births[after->cells[e][v]];
        if (was && !same) {
            memcpy(ints + 3 * cells + 4 * c->removed_cell_count, before->cells[e], sizeof before->cells[e]);
            ints[c->removed_cell_count++] = e;
        }
        if (is && !same) {
            memcpy(ints + 7 * cells + 4 * c->made_cell_count, after->cells[e], sizeof after->cells[e]);
            ints[2 * cells + c->made_cell_count] = back ? (was ? e : -1) : after->parents[e];
            ints[cells + c->made_cell_count++] = e;
        }
    }
    return made;
}

#endif /* LIVE_MESH_H */
