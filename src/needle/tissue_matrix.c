/* tissue_matrix: rest data, rotations, forces, and the stiffness matrix that follows a mesh whose topology changes. */
#include "../softbody/base/lanes.h"
#include "tissue_private.h"

#include "../softbody/solve/sparse.h"

#include <limits.h>
#include <string.h>

enum { NDLI_LANES = SB_POLAR_LANES };

/* Corners of the six edges of a tet. */
static const int ndli_solid_pair[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};

/* ---- memory ---- */

static void ndli_solid_layout_nodes(ndl_tissue *t, sbi_arena *arena, size_t nodes)
{
    size_t chunks = nodes / NDLI_SOLID_CHUNK + 1;
    sb_vec3 **vectors[15];
    int **ints[6];
    vectors[0] = &t->force, vectors[1] = &t->target, vectors[2] = &t->target_velocity, vectors[3] = &t->reaction;
    vectors[4] = &t->arm, vectors[5] = &t->seen_x, vectors[6] = &t->internal, vectors[7] = &t->way;
    vectors[8] = &t->rhs, vectors[9] = &t->unknown, vectors[10] = &t->residual, vectors[11] = &t->search;
    vectors[12] = &t->product, vectors[13] = &t->correction, vectors[14] = &t->before;
    ints[0] = &t->row_start, ints[1] = &t->row_count, ints[2] = &t->row_class, ints[3] = &t->aggregate;
    ints[4] = &t->coarse_nodes, ints[5] = &t->scratch;
    for (int i = 0; i < 15; i++)
        *vectors[i] = (sb_vec3 *)sbi_arena_take(arena, nodes + 1, sizeof(sb_vec3));
    for (int i = 0; i < 6; i++)
        *ints[i] = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->diagonal = (sb_real(*)[9])sbi_arena_take(arena, nodes, sizeof t->diagonal[0]);
    t->inverse = (sb_real(*)[9])sbi_arena_take(arena, nodes, sizeof t->inverse[0]);
    t->partial = (double *)sbi_arena_take(arena, chunks, 2 * sizeof(double));
    t->role = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    t->has_velocity = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    t->node_dirty = (unsigned char *)sbi_arena_take(arena, nodes, 1);
}

static void ndli_solid_layout_tets(ndl_tissue *t, sbi_arena *arena, size_t tets)
{
    size_t lanes = (tets + NDLI_LANES - 1) / NDLI_LANES * NDLI_LANES;
    t->gradients = (sb_real *)sbi_arena_take(arena, lanes, 9 * sizeof(sb_real));
    t->moduli = (sb_real *)sbi_arena_take(arena, lanes, 2 * sizeof(sb_real));
    t->quats = (sb_real *)sbi_arena_take(arena, lanes, 4 * sizeof(sb_real));
    t->old_quats = (sb_real *)sbi_arena_take(arena, lanes, 4 * sizeof(sb_real));
    t->rotated = (sb_real *)sbi_arena_take(arena, lanes, 16 * sizeof(sb_real));
    t->corner_force = (sb_vec3 *)sbi_arena_take(arena, lanes, 4 * sizeof(sb_vec3));
    t->batch_energy = (double *)sbi_arena_take(arena, lanes / NDLI_LANES, sizeof(double));
    t->tet_edges = (int *)sbi_arena_take(arena, lanes, 6 * sizeof(int));
    t->ring_next = (int *)sbi_arena_take(arena, lanes, 6 * sizeof(int));
    t->stale_tet = (unsigned char *)sbi_arena_take(arena, lanes, 1);
    t->turned = (unsigned char *)sbi_arena_take(arena, lanes, 1);
}

static void ndli_solid_layout_edges(ndl_tissue *t, sbi_arena *arena, size_t edges)
{
    t->edge_nodes = (int *)sbi_arena_take(arena, edges, 2 * sizeof(int));
    t->edge_slots = (int *)sbi_arena_take(arena, edges, 2 * sizeof(int));
    t->edge_ring = (int *)sbi_arena_take(arena, edges, sizeof(int));
    t->edge_dirty = (unsigned char *)sbi_arena_take(arena, edges, 1);
}

static void ndli_solid_layout_slots(ndl_tissue *t, sbi_arena *arena, size_t slots)
{
    t->blocks = (sb_real(*)[9])sbi_arena_take(arena, slots + 1, sizeof t->blocks[0]);
    t->columns = (int *)sbi_arena_take(arena, slots, sizeof(int));
    t->slot_edge = (int *)sbi_arena_take(arena, slots, sizeof(int));
}

typedef void (*ndli_solid_layout)(ndl_tissue *t, sbi_arena *arena, size_t count);

/* Points the layout's arrays of *t into a fresh block of zeros; NULL: no memory, *t as it was. */
static void *ndli_solid_allocate(ndl_tissue *t, ndli_solid_layout layout, int count)
{
    ndl_tissue made = *t;
    sbi_arena arena;
    memset(&arena, 0, sizeof arena);
    layout(&made, &arena, (size_t)count);
    if (arena.overflow)
        return NULL;
    arena.base = (unsigned char *)sbi_alloc_zeroed(&t->allocator, arena.used, 1);
    if (!arena.base)
        return NULL;
    arena.used = 0;
    layout(t, &arena, (size_t)count);
    return arena.base;
}

/* Room for half as many again. The callers keep count below INT_MAX / 2. */
static int ndli_solid_more(int count)
{
    int64_t roomy = (int64_t)count + count / 2 + 64;
    return roomy < INT_MAX / 2 ? (int)roomy : INT_MAX / 2;
}

static int ndli_solid_grow_nodes(ndl_tissue *t, int room)
{
    ndl_tissue old = *t;
    size_t n = (size_t)old.node_room;
    void *block = ndli_solid_allocate(t, ndli_solid_layout_nodes, room);
    if (!block)
        return 0;
    if (n > 0) {
        memcpy(t->force, old.force, n * sizeof(sb_vec3));
        memcpy(t->target, old.target, n * sizeof(sb_vec3));
        memcpy(t->target_velocity, old.target_velocity, n * sizeof(sb_vec3));
        memcpy(t->reaction, old.reaction, n * sizeof(sb_vec3));
        memcpy(t->arm, old.arm, n * sizeof(sb_vec3));
        memcpy(t->seen_x, old.seen_x, n * sizeof(sb_vec3));
        memcpy(t->internal, old.internal, n * sizeof(sb_vec3));
        memcpy(t->row_start, old.row_start, n * sizeof(int));
        memcpy(t->row_count, old.row_count, n * sizeof(int));
        memcpy(t->row_class, old.row_class, n * sizeof(int));
        memcpy(t->aggregate, old.aggregate, n * sizeof(int));
        memcpy(t->coarse_nodes, old.coarse_nodes, n * sizeof(int));
        memcpy(t->diagonal, old.diagonal, n * sizeof t->diagonal[0]);
        memcpy(t->inverse, old.inverse, n * sizeof t->inverse[0]);
        memcpy(t->role, old.role, n);
        memcpy(t->has_velocity, old.has_velocity, n);
        memcpy(t->node_dirty, old.node_dirty, n);
    }
    for (int i = old.node_room; i < room; i++) {
        t->role[i] = NDLI_ROW_ABSENT;
        t->row_class[i] = -1;
    }
    sbi_free(&t->allocator, old.node_block);
    t->node_block = block;
    t->node_room = room;
    return 1;
}

static int ndli_solid_grow_tets(ndl_tissue *t, int room)
{
    ndl_tissue old = *t;
    size_t n = (size_t)old.tet_room, lanes = (n + NDLI_LANES - 1) / NDLI_LANES * NDLI_LANES;
    size_t all = ((size_t)room + NDLI_LANES - 1) / NDLI_LANES * NDLI_LANES;
    int fits = room < INT_MAX / 12 - NDLI_LANES; /* the codes of rings are ints */
    void *block = fits ? ndli_solid_allocate(t, ndli_solid_layout_tets, room) : NULL;
    if (!block)
        return 0;
    for (size_t k = 0; k < 6 * all; k++)
        t->tet_edges[k] = t->ring_next[k] = -1;
    for (size_t k = 0; k < 4 * all; k++)
        t->quats[k] = t->old_quats[k] = (k / NDLI_LANES) % 4 == 0 ? (sb_real)1 : (sb_real)0;
    if (n > 0) {
        memcpy(t->gradients, old.gradients, lanes * 9 * sizeof(sb_real));
        memcpy(t->moduli, old.moduli, lanes * 2 * sizeof(sb_real));
        memcpy(t->quats, old.quats, lanes * 4 * sizeof(sb_real));
        memcpy(t->old_quats, old.old_quats, lanes * 4 * sizeof(sb_real));
        memcpy(t->rotated, old.rotated, lanes * 16 * sizeof(sb_real));
        memcpy(t->tet_edges, old.tet_edges, lanes * 6 * sizeof(int));
        memcpy(t->ring_next, old.ring_next, lanes * 6 * sizeof(int));
        memcpy(t->stale_tet, old.stale_tet, lanes);
    }
    sbi_free(&t->allocator, old.tet_block);
    t->tet_block = block;
    t->tet_room = room;
    return 1;
}

static int ndli_solid_grow_edges(ndl_tissue *t, int room)
{
    ndl_tissue old = *t;
    size_t n = (size_t)old.edge_end;
    void *block = ndli_solid_allocate(t, ndli_solid_layout_edges, room);
    if (!block)
        return 0;
    if (n > 0) {
        memcpy(t->edge_nodes, old.edge_nodes, 2 * n * sizeof(int));
        memcpy(t->edge_slots, old.edge_slots, 2 * n * sizeof(int));
        memcpy(t->edge_ring, old.edge_ring, n * sizeof(int));
        memcpy(t->edge_dirty, old.edge_dirty, n);
    }
    sbi_free(&t->allocator, old.edge_block);
    t->edge_block = block;
    t->edge_room = room;
    return 1;
}

static int ndli_solid_grow_slots(ndl_tissue *t, int room)
{
    ndl_tissue old = *t;
    size_t n = (size_t)old.slot_end;
    void *block = ndli_solid_allocate(t, ndli_solid_layout_slots, room);
    if (!block)
        return 0;
    if (n > 0) {
        memcpy(t->blocks, old.blocks, n * sizeof t->blocks[0]);
        memcpy(t->columns, old.columns, n * sizeof(int));
        memcpy(t->slot_edge, old.slot_edge, n * sizeof(int));
    }
    sbi_free(&t->allocator, old.slot_block);
    t->slot_block = block;
    t->slot_room = room;
    return 1;
}

NDLI_API int ndli_solid_reserve(ndl_tissue *t, int slots, int edges)
{
    return (t->mesh.node_capacity <= t->node_room || ndli_solid_grow_nodes(t, t->mesh.node_capacity)) &&
           (t->mesh.tet_capacity <= t->tet_room || ndli_solid_grow_tets(t, t->mesh.tet_capacity)) &&
           (slots <= t->slot_room || ndli_solid_grow_slots(t, ndli_solid_more(slots))) &&
           (edges <= t->edge_room || ndli_solid_grow_edges(t, ndli_solid_more(edges)));
}

NDLI_API void ndli_solid_free(ndl_tissue *t)
{
    sbi_free(&t->allocator, t->node_block);
    sbi_free(&t->allocator, t->tet_block);
    sbi_free(&t->allocator, t->edge_block);
    sbi_free(&t->allocator, t->slot_block);
    sbi_free(&t->allocator, t->coarse.block);
}

/* ---- rest data ---- */

NDLI_API void ndli_solid_measure(ndl_tissue *t, int tet)
{
    const ndl_tissue_mesh *mesh = &t->mesh;
    const int *n = mesh->tets + 4 * (size_t)tet;
    size_t lane = (size_t)(tet % NDLI_LANES), batch = (size_t)(tet / NDLI_LANES);
    sb_real *g = t->gradients + batch * 9 * NDLI_LANES + lane, *m = t->moduli + batch * 2 * NDLI_LANES + lane;
    const sb_real *lame = t->lame + 2 * (size_t)(t->material_count == 1 ? 0 : mesh->regions[tet]);
    sb_vec3 a = sb_v3_sub(mesh->X[n[1]], mesh->X[n[0]]), b = sb_v3_sub(mesh->X[n[2]], mesh->X[n[0]]);
    sb_vec3 c = sb_v3_sub(mesh->X[n[3]], mesh->X[n[0]]), rows[3];
    sb_real inverse = 1 / sb_v3_dot(a, sb_v3_cross(b, c));
    rows[0] = sb_v3_scale(inverse, sb_v3_cross(b, c));
    rows[1] = sb_v3_scale(inverse, sb_v3_cross(c, a));
    rows[2] = sb_v3_scale(inverse, sb_v3_cross(a, b));
    for (int k = 0; k < 3; k++) {
        g[(3 * k) * NDLI_LANES] = rows[k].x;
        g[(3 * k + 1) * NDLI_LANES] = rows[k].y;
        g[(3 * k + 2) * NDLI_LANES] = rows[k].z;
    }
    m[0] = mesh->volumes[tet] * lame[0];
    m[NDLI_LANES] = mesh->volumes[tet] * lame[1];
    t->stale_tet[tet] = 1;
}

NDLI_API void ndli_solid_blank(ndl_tissue *t, int tet)
{
    size_t lane = (size_t)(tet % NDLI_LANES), batch = (size_t)(tet / NDLI_LANES);
    for (size_t k = 0; k < 9; k++)
        t->gradients[(batch * 9 + k) * NDLI_LANES + lane] = 0;
    for (size_t k = 0; k < 2; k++)
        t->moduli[(batch * 2 + k) * NDLI_LANES + lane] = 0;
    for (size_t k = 0; k < 4; k++)
        t->quats[(batch * 4 + k) * NDLI_LANES + lane] = k == 0 ? (sb_real)1 : (sb_real)0;
    t->stale_tet[tet] = 0;
}

/* ---- rows ---- */

/* First place of a piece; -1: no memory. */
static int ndli_solid_take_piece(ndl_tissue *t, int size_class)
{
    int places = (size_class + 1) * NDLI_SOLID_PIECE, start;
    if (size_class < NDLI_SOLID_CLASSES && t->free_pieces[size_class] >= 0) {
        start = t->free_pieces[size_class];
        t->free_pieces[size_class] = t->columns[start];
        return start;
    }
    if (places > t->slot_room - t->slot_end) {
        if (t->slot_end > INT_MAX / 4 - places ||
            !ndli_solid_grow_slots(t, ndli_solid_more(t->slot_end + places)))
            return -1;
    }
    start = t->slot_end;
    t->slot_end += places;
    return start;
}

/* Pieces too large for a list are lost until the next rebuild: a node with hundreds of neighbours is a rare thing. */
static void ndli_solid_give_piece(ndl_tissue *t, int start, int size_class)
{
    if (size_class < 0 || size_class >= NDLI_SOLID_CLASSES)
        return;
    t->columns[start] = t->free_pieces[size_class];
    t->free_pieces[size_class] = start;
}

static int ndli_solid_class_of(int count) { return (count + NDLI_SOLID_PIECE - 1) / NDLI_SOLID_PIECE - 1; }

/* Tells the edges of the places [from, end) of row i where their blocks are now. */
static void ndli_solid_renumber(ndl_tissue *t, int i, int from)
{
    int end = t->row_start[i] + t->row_count[i];
    for (int s = from; s < end; s++) {
        int e = t->slot_edge[s];
        t->edge_slots[2 * (size_t)e + (t->edge_nodes[2 * (size_t)e] == i ? 0 : 1)] = s;
    }
}

/* A larger piece for row i. */
static int ndli_solid_widen(ndl_tissue *t, int i)
{
    int old = t->row_start[i], size_class = t->row_class[i] + 1, start = ndli_solid_take_piece(t, size_class);
    size_t count = (size_t)t->row_count[i];
    if (start < 0)
        return 0;
    if (count > 0) {
        memcpy(t->columns + start, t->columns + old, count * sizeof(int));
        memcpy(t->slot_edge + start, t->slot_edge + old, count * sizeof(int));
        memcpy(t->blocks + start, t->blocks + old, count * sizeof t->blocks[0]);
    }
    ndli_solid_give_piece(t, old, t->row_class[i]);
    t->row_start[i] = start;
    t->row_class[i] = size_class;
    ndli_solid_renumber(t, i, start);
    return 1;
}

/* First place in row i whose column is not below j. */
static int ndli_solid_place(const ndl_tissue *t, int i, int j)
{
    int low = t->row_start[i], high = low + t->row_count[i];
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (t->columns[middle] < j)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

NDLI_API int ndli_solid_find(const ndl_tissue *t, int i, int j)
{
    int place = ndli_solid_place(t, i, j);
    return place < t->row_start[i] + t->row_count[i] && t->columns[place] == j ? place : -1;
}

/* A zero block for `edge` in row i; 0: no memory. */
static int ndli_solid_put_block(ndl_tissue *t, int i, int j, int edge)
{
    int place, end;
    if (t->row_count[i] == (t->row_class[i] + 1) * NDLI_SOLID_PIECE && !ndli_solid_widen(t, i))
        return 0;
    place = ndli_solid_place(t, i, j);
    end = t->row_start[i] + t->row_count[i];
    memmove(t->columns + place + 1, t->columns + place, (size_t)(end - place) * sizeof(int));
    memmove(t->slot_edge + place + 1, t->slot_edge + place, (size_t)(end - place) * sizeof(int));
    memmove(t->blocks + place + 1, t->blocks + place, (size_t)(end - place) * sizeof t->blocks[0]);
    t->columns[place] = j;
    t->slot_edge[place] = edge;
    memset(t->blocks[place], 0, sizeof t->blocks[0]);
    t->row_count[i]++;
    ndli_solid_renumber(t, i, place);
    return 1;
}

static void ndli_solid_drop_block(ndl_tissue *t, int i, int place)
{
    int end = t->row_start[i] + t->row_count[i], rest = end - place - 1;
    memmove(t->columns + place, t->columns + place + 1, (size_t)rest * sizeof(int));
    memmove(t->slot_edge + place, t->slot_edge + place + 1, (size_t)rest * sizeof(int));
    memmove(t->blocks + place, t->blocks + place + 1, (size_t)rest * sizeof t->blocks[0]);
    t->row_count[i]--;
    t->node_dirty[i] = 1;
    ndli_solid_renumber(t, i, place);
    if (t->row_count[i] == 0) {
        ndli_solid_give_piece(t, t->row_start[i], t->row_class[i]);
        t->row_class[i] = -1;
    }
}

/* ---- edges ---- */

static int ndli_solid_take_edge(ndl_tissue *t)
{
    int edge = t->free_edge;
    if (edge >= 0) {
        t->free_edge = t->edge_slots[2 * (size_t)edge];
        return edge;
    }
    if (t->edge_end == t->edge_room &&
        (t->edge_end > INT_MAX / 16 || !ndli_solid_grow_edges(t, ndli_solid_more(t->edge_end))))
        return -1;
    return t->edge_end++;
}

/* A new edge i < j without tets; -1: no memory. */
static int ndli_solid_make_edge(ndl_tissue *t, int i, int j)
{
    int edge = ndli_solid_take_edge(t);
    if (edge < 0)
        return -1;
    t->edge_nodes[2 * (size_t)edge] = i;
    t->edge_nodes[2 * (size_t)edge + 1] = j;
    t->edge_ring[edge] = -1;
    if (!ndli_solid_put_block(t, i, j, edge) || !ndli_solid_put_block(t, j, i, edge))
        return -1; /* the caller gives up: all is made anew */
    return edge;
}

static void ndli_solid_drop_edge(ndl_tissue *t, int edge)
{
    int *nodes = t->edge_nodes + 2 * (size_t)edge, *slots = t->edge_slots + 2 * (size_t)edge;
    ndli_solid_drop_block(t, nodes[0], slots[0]);
    ndli_solid_drop_block(t, nodes[1], slots[1]);
    nodes[0] = nodes[1] = -1;
    slots[0] = t->free_edge;
    t->free_edge = edge;
    t->edge_dirty[edge] = 0;
}

NDLI_API void ndli_solid_leave(ndl_tissue *t, int tet)
{
    for (int p = 0; p < 6; p++) {
        int at = 6 * tet + p, edge = t->tet_edges[at], *link;
        if (edge < 0)
            continue;
        for (link = t->edge_ring + edge; *link >> 1 != at; link = t->ring_next + (*link >> 1))
            continue;
        *link = t->ring_next[at];
        t->tet_edges[at] = -1;
        t->edge_dirty[edge] = 1;
        if (t->edge_ring[edge] < 0)
            ndli_solid_drop_edge(t, edge);
    }
}

NDLI_API int ndli_solid_join(ndl_tissue *t, int tet)
{
    const int *n = t->mesh.tets + 4 * (size_t)tet;
    for (int p = 0; p < 6; p++) {
        int a = n[ndli_solid_pair[p][0]], b = n[ndli_solid_pair[p][1]], flip = a > b, at = 6 * tet + p, *link;
        int i = flip ? b : a, j = flip ? a : b;
        int place = t->row_count[i] > 0 ? ndli_solid_find(t, i, j) : -1;
        int edge = place >= 0 ? t->slot_edge[place] : ndli_solid_make_edge(t, i, j);
        if (edge < 0)
            return 0;
        for (link = t->edge_ring + edge; *link >= 0 && *link >> 1 < at; link = t->ring_next + (*link >> 1))
            continue;
        t->ring_next[at] = *link;
        *link = 2 * at + flip;
        t->tet_edges[at] = edge;
        t->edge_dirty[edge] = 1;
    }
    return 1;
}

/* 1 when the tet's edges are those of its nodes. */
static int ndli_solid_is_joined(const ndl_tissue *t, int tet)
{
    const int *n = t->mesh.tets + 4 * (size_t)tet;
    for (int p = 0; p < 6; p++) {
        int edge = t->tet_edges[6 * tet + p], a = n[ndli_solid_pair[p][0]], b = n[ndli_solid_pair[p][1]];
        if (edge < 0 || t->edge_nodes[2 * (size_t)edge] != sbi_min_int(a, b) ||
            t->edge_nodes[2 * (size_t)edge + 1] != sbi_max_int(a, b))
            return 0;
    }
    return 1;
}

/* ---- all anew ---- */

/* Rows laid out one after the other with room for `spare` more blocks each, so that a new mesh lies in memory in the
 * order it is read; without, only in the memory that there is. Columns come later. Uses scratch. */
static int ndli_solid_lay_rows(ndl_tissue *t, int spare)
{
    const ndl_tissue_mesh *mesh = &t->mesh;
    int64_t slots = 0, edges = 0;
    for (int i = 0; i < mesh->node_end; i++) {
        int count = 0;
        t->scratch[i] = i + 1; /* a node's mark is the last row that has met it: no clearing between rows */
        for (int k = mesh->node_flags[i] ? mesh->node_star[i] : -1; k >= 0; k = mesh->corner_next[k])
            for (int c = 0; c < 4; c++) {
                int j = mesh->tets[4 * (size_t)(k / 4) + (size_t)c];
                count += t->scratch[j] != i + 1;
                t->scratch[j] = i + 1;
            }
        t->row_class[i] = count > 0 ? ndli_solid_class_of(count + spare) : -1;
        t->row_start[i] = (int)slots;
        t->row_count[i] = 0;
        t->node_dirty[i] = 1;
        slots += (int64_t)(t->row_class[i] + 1) * NDLI_SOLID_PIECE;
        edges += count;
        if (slots > INT_MAX / 8)
            break;
    }
    memset(t->scratch, 0, (size_t)mesh->node_end * sizeof(int));
    if (slots > INT_MAX / 8)
        return 0;
    t->slot_end = 0; /* nothing worth copying */
    t->edge_end = 0;
    if (slots > t->slot_room && (!spare || !ndli_solid_grow_slots(t, ndli_solid_more((int)slots))))
        return 0;
    if (edges / 2 > t->edge_room && (!spare || !ndli_solid_grow_edges(t, ndli_solid_more((int)(edges / 2)))))
        return 0;
    t->slot_end = (int)slots;
    return 1;
}

NDLI_API int ndli_solid_rebuild(ndl_tissue *t)
{
    const ndl_tissue_mesh *mesh = &t->mesh;
    t->broken = 1;
    t->changed = 1;
    if (mesh->node_capacity > t->node_room && !ndli_solid_grow_nodes(t, mesh->node_capacity) &&
        mesh->node_end > t->node_room)
        return 0;
    if (mesh->tet_capacity > t->tet_room && !ndli_solid_grow_tets(t, mesh->tet_capacity) && mesh->tet_end > t->tet_room)
        return 0;
    t->free_edge = -1;
    for (int k = 0; k < NDLI_SOLID_CLASSES; k++)
        t->free_pieces[k] = -1;
    if (!ndli_solid_lay_rows(t, 2) && !ndli_solid_lay_rows(t, 0)) /* what has fitted once fits again */
        return 0;
    for (int i = mesh->node_end; i < t->node_room; i++) {
        t->role[i] = NDLI_ROW_ABSENT;
        t->row_count[i] = 0;
        t->row_class[i] = -1;
    }
    for (int i = 0; i < mesh->node_end; i++) {
        if (!mesh->node_flags[i])
            t->role[i] = NDLI_ROW_ABSENT;
        else if (t->role[i] == NDLI_ROW_ABSENT)
            t->role[i] = NDLI_ROW_FREE;
    }
    for (int e = 0; e < t->tet_room; e++)
        for (int p = 0; p < 6; p++)
            t->tet_edges[6 * e + p] = -1;
    for (int e = 0; e < t->tet_room; e++) {
        if (e >= mesh->tet_end || mesh->tets[4 * (size_t)e] < 0) {
            ndli_solid_blank(t, e);
            continue;
        }
        ndli_solid_measure(t, e);
        if (!ndli_solid_join(t, e))
            return 0;
    }
    t->broken = 0;
    t->inverse_valid = 0;
    return 1;
}

/* ---- changes of the mesh ---- */

static void ndli_solid_forget_node(ndl_tissue *t, int node, int role)
{
    t->role[node] = (unsigned char)role;
    t->force[node] = t->reaction[node] = sb_v3(0, 0, 0);
    t->has_velocity[node] = 0;
    t->node_dirty[node] = 1;
}

static int ndli_solid_change_tets(ndl_tissue *t, const ndl_mesh_change *change)
{
    for (int i = 0; i < change->removed_count; i++) {
        ndli_solid_leave(t, change->removed[i]);
        ndli_solid_blank(t, change->removed[i]);
    }
    for (int i = 0; i < change->changed_count; i++)
        if (!ndli_solid_is_joined(t, change->changed[i]))
            ndli_solid_leave(t, change->changed[i]);
    for (int i = 0; i < change->changed_count; i++) {
        ndli_solid_measure(t, change->changed[i]);
        if (t->tet_edges[6 * change->changed[i]] < 0 && !ndli_solid_join(t, change->changed[i]))
            return 0;
    }
    for (int i = 0; i < change->created_count; i++) {
        ndli_solid_measure(t, change->created[i]);
        if (!ndli_solid_join(t, change->created[i]))
            return 0;
    }
    return 1;
}

NDLI_API void ndli_solid_changed(void *user, const ndl_mesh_change *change)
{
    ndl_tissue *t = (ndl_tissue *)user;
    t->changed = 1;
    if (change->node_count == 0) /* the densities: all masses are others */
        t->inverse_valid = 0;
    if ((t->mesh.node_capacity > t->node_room && !ndli_solid_grow_nodes(t, t->mesh.node_capacity)) ||
        (t->mesh.tet_capacity > t->tet_room && !ndli_solid_grow_tets(t, t->mesh.tet_capacity)))
        t->broken = 1;
    for (int i = 0; i < change->removed_node_count; i++)
        if (change->removed_nodes[i] < t->node_room)
            ndli_solid_forget_node(t, change->removed_nodes[i], NDLI_ROW_ABSENT);
    for (int i = 0; i < change->node_count; i++) {
        int node = change->nodes[i].node;
        if (change->nodes[i].created && node < t->node_room)
            ndli_solid_forget_node(t, node, t->mesh.node_flags[node] ? NDLI_ROW_FREE : NDLI_ROW_ABSENT);
    }
    ndli_solid_coarse_changed(t, change);
    if (!t->broken && !ndli_solid_change_tets(t, change))
        t->broken = 1;
}

/* ---- rotations and forces: a batch of tets at a time ---- */

/* Displacements of nodes 1..3 relative to node 0: of them, not of positions, so that rest is exact wherever it is. */
static void ndli_solid_gather(const ndl_tissue *t, int batch, sb_real (*d)[NDLI_LANES])
{
    const ndl_tissue_mesh *mesh = &t->mesh;
    for (int l = 0; l < NDLI_LANES; l++) {
        int tet = batch * NDLI_LANES + l;
        const int *n = mesh->tets + 4 * (size_t)tet;
        sb_vec3 u0;
        if (tet >= mesh->tet_end || n[0] < 0) {
            for (int k = 0; k < 9; k++)
                d[k][l] = 0;
            continue;
        }
        u0 = t->way[n[0]];
        for (int a = 0; a < 3; a++) {
            sb_vec3 u = sb_v3_sub(t->way[n[a + 1]], u0);
            d[3 * a][l] = u.x;
            d[3 * a + 1][l] = u.y;
            d[3 * a + 2][l] = u.z;
        }
    }
}

/* out[3 a + i] = sum_j m[3 i + j] g[3 a + j], lane by lane. */
SBI_FORCE_INLINE void ndli_solid_apply(const sb_real (*m)[NDLI_LANES], const sb_real (*g)[NDLI_LANES],
                                       sb_real (*out)[NDLI_LANES])
{
    for (int a = 0; a < 3; a++)
        for (int i = 0; i < 3; i++)
            for (int l = 0; l < NDLI_LANES; l++)
                out[3 * a + i][l] = m[3 * i][l] * g[3 * a][l] + m[3 * i + 1][l] * g[3 * a + 1][l] +
                                    m[3 * i + 2][l] * g[3 * a + 2][l];
}

/* -V P = -2 V mu (F - R) - V lambda (tr(R^T F) - 3) R, in place of F; returns the energy, V P:(F - R) / 2. */
SBI_FORCE_INLINE double ndli_solid_stress(const sb_real (*r)[NDLI_LANES], const sb_real (*moduli)[NDLI_LANES],
                                          sb_real (*f)[NDLI_LANES])
{
    sb_real trace[NDLI_LANES], energy[NDLI_LANES];
    double sum = 0;
    for (int l = 0; l < NDLI_LANES; l++) {
        trace[l] = -3;
        energy[l] = 0;
    }
    for (int k = 0; k < 9; k++)
        for (int l = 0; l < NDLI_LANES; l++)
            trace[l] += r[k][l] * f[k][l];
    for (int k = 0; k < 9; k++)
        for (int l = 0; l < NDLI_LANES; l++) {
            sb_real strain = f[k][l] - r[k][l];
            f[k][l] = -2 * moduli[1][l] * strain - moduli[0][l] * trace[l] * r[k][l];
            energy[l] -= f[k][l] * strain;
        }
    for (int l = 0; l < NDLI_LANES; l++)
        sum += (double)energy[l];
    return 0.5 * sum;
}

/* far = |R - R_old|^2 of each lane: with e = q - (+-)q_old, |R - R_old| = |e| sqrt(4 - |e|^2). */
SBI_FORCE_INLINE void ndli_solid_measure_turns(const sb_real (*q)[NDLI_LANES], const sb_real (*old)[NDLI_LANES],
                                               sb_real *far)
{
    for (int l = 0; l < NDLI_LANES; l++) {
        sb_real dot = q[0][l] * old[0][l] + q[1][l] * old[1][l] + q[2][l] * old[2][l] + q[3][l] * old[3][l];
        sb_real sign = dot < 0 ? (sb_real)-1 : (sb_real)1, square;
        sb_real e0 = q[0][l] - sign * old[0][l], e1 = q[1][l] - sign * old[1][l];
        sb_real e2 = q[2][l] - sign * old[2][l], e3 = q[3][l] - sign * old[3][l];
        square = e0 * e0 + e1 * e1 + e2 * e2 + e3 * e3;
        far[l] = square * (4 - square);
    }
}

NDLI_API void ndli_solid_rotate(ndl_tissue *t, int batch)
{
    const sb_real(*g)[NDLI_LANES] = (const sb_real(*)[NDLI_LANES])(t->gradients + (size_t)batch * 9 * NDLI_LANES);
    const sb_real(*moduli)[NDLI_LANES] = (const sb_real(*)[NDLI_LANES])(t->moduli + (size_t)batch * 2 * NDLI_LANES);
    const sb_real(*q)[NDLI_LANES] = (const sb_real(*)[NDLI_LANES])(t->old_quats + (size_t)batch * 4 * NDLI_LANES);
    sb_real r[9][NDLI_LANES], h[9][NDLI_LANES];
    int count = sbi_min_int(NDLI_LANES, t->mesh.tet_end - batch * NDLI_LANES);
    for (int l = 0; l < NDLI_LANES; l++) {
        sb_mat3 m = sb_quat_to_mat3(sb_quat_make(q[0][l], q[1][l], q[2][l], q[3][l]));
        for (int k = 0; k < 9; k++)
            r[k][l] = m.m[k / 3][k % 3];
    }
    ndli_solid_apply((const sb_real(*)[NDLI_LANES])r, g, h);
    for (int l = 0; l < count; l++) {
        sb_real *out = t->rotated + 16 * (size_t)(batch * NDLI_LANES + l);
        if (!t->turned[batch * NDLI_LANES + l])
            continue;
        for (int i = 0; i < 3; i++)
            out[i] = -(h[i][l] + h[3 + i][l] + h[6 + i][l]);
        for (int k = 0; k < 9; k++)
            out[3 + k] = h[k][l];
        out[12] = moduli[0][l];
        out[13] = moduli[1][l];
    }
}

/* Where a tet has turned or is new: the rotation of its stiffness, and its rotated gradients. */
static void ndli_solid_turn(ndl_tissue *t, int batch, const sb_real (*q)[NDLI_LANES])
{
    sb_real(*old)[NDLI_LANES] = (sb_real(*)[NDLI_LANES])(t->old_quats + (size_t)batch * 4 * NDLI_LANES);
    int count = sbi_min_int(NDLI_LANES, t->mesh.tet_end - batch * NDLI_LANES), any = 0;
    sb_real far[NDLI_LANES], limit = t->lazy_angle * t->lazy_angle;
    ndli_solid_measure_turns(q, (const sb_real(*)[NDLI_LANES])old, far);
    for (int l = 0; l < count; l++) {
        int tet = batch * NDLI_LANES + l;
        t->turned[tet] = (t->stale_tet[tet] | (far[l] > limit)) && t->mesh.tets[4 * (size_t)tet] >= 0;
        if (!t->turned[tet])
            continue;
        any = 1;
        t->stale_tet[tet] = 0;
        for (int k = 0; k < 4; k++)
            old[k][l] = q[k][l];
    }
    if (any)
        ndli_solid_rotate(t, batch);
}

static void ndli_solid_batch(ndl_tissue *t, int batch)
{
    const sb_real(*g)[NDLI_LANES] = (const sb_real(*)[NDLI_LANES])(t->gradients + (size_t)batch * 9 * NDLI_LANES);
    const sb_real(*moduli)[NDLI_LANES] = (const sb_real(*)[NDLI_LANES])(t->moduli + (size_t)batch * 2 * NDLI_LANES);
    sb_real(*quats)[NDLI_LANES] = (sb_real(*)[NDLI_LANES])(t->quats + (size_t)batch * 4 * NDLI_LANES);
    sb_real d[9][NDLI_LANES], f[9][NDLI_LANES], r[9][NDLI_LANES];
    ndli_solid_gather(t, batch, d);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int l = 0; l < NDLI_LANES; l++)
                f[3 * i + j][l] = (i == j ? (sb_real)1 : (sb_real)0) + d[i][l] * g[j][l] + d[3 + i][l] * g[3 + j][l] +
                                  d[6 + i][l] * g[6 + j][l];
    sb_polar_batch(f, quats, r);
    ndli_solid_turn(t, batch, (const sb_real(*)[NDLI_LANES])quats);
    t->batch_energy[batch] = ndli_solid_stress((const sb_real(*)[NDLI_LANES])r, moduli, f);
    ndli_solid_apply((const sb_real(*)[NDLI_LANES])f, g, d);
    for (int l = 0; l < NDLI_LANES; l++) {
        sb_vec3 *out = t->corner_force + 4 * ((size_t)batch * NDLI_LANES + (size_t)l);
        for (int a = 0; a < 3; a++)
            out[a + 1] = sb_v3(d[3 * a][l], d[3 * a + 1][l], d[3 * a + 2][l]);
        out[0] = sb_v3(-(d[0][l] + d[3][l] + d[6][l]), -(d[1][l] + d[4][l] + d[7][l]), -(d[2][l] + d[5][l] + d[8][l]));
    }
}

static void ndli_solid_batch_task(void *user, int index)
{
    ndl_tissue *t = (ndl_tissue *)user;
    int end = (t->mesh.tet_end + NDLI_LANES - 1) / NDLI_LANES;
    int last = sbi_min_int(end, (index + 1) * NDLI_SOLID_BATCHES);
    for (int batch = index * NDLI_SOLID_BATCHES; batch < last; batch++)
        ndli_solid_batch(t, batch);
}

/* Forces of the tets about each node, in the order of its ring. */
static void ndli_solid_sum_task(void *user, int chunk)
{
    ndl_tissue *t = (ndl_tissue *)user;
    const ndl_tissue_mesh *mesh = &t->mesh;
    int last = sbi_min_int(mesh->node_end, (chunk + 1) * NDLI_SOLID_CHUNK);
    for (int i = chunk * NDLI_SOLID_CHUNK; i < last; i++) {
        sb_vec3 sum = sb_v3(0, 0, 0);
        for (int k = mesh->node_flags[i] ? mesh->node_star[i] : -1; k >= 0; k = mesh->corner_next[k])
            sum = sb_v3_add(sum, t->corner_force[k]);
        t->internal[i] = sum;
    }
}

NDLI_API void ndli_solid_forces(ndl_tissue *t)
{
    int batches = (t->mesh.tet_end + NDLI_LANES - 1) / NDLI_LANES;
    for (int i = 0; i < t->mesh.node_end; i++) /* displacements, until the right-hand side needs the place */
        t->way[i] = sb_v3_sub(t->mesh.x[i], t->mesh.X[i]);
    sbi_run(&t->jobs, ndli_solid_batch_task, t, (batches + NDLI_SOLID_BATCHES - 1) / NDLI_SOLID_BATCHES);
    sbi_run(&t->jobs, ndli_solid_sum_task, t, ndli_solid_chunks(t->mesh.node_end));
    t->elastic = 0;
    for (int k = 0; k < batches; k++)
        t->elastic += t->batch_energy[k];
}

/* ---- stiffness ---- */

/* K_ij = sum over the tets of the edge of V (lambda h_a h_b^T + mu h_b h_a^T + mu h_a.h_b I), h = R g. */
static void ndli_solid_edge(ndl_tissue *t, int edge)
{
    sb_real l[9] = {0}, m[9] = {0}; /* sums of V lambda h_a h_b^T and V mu h_a h_b^T */
    const int *slots = t->edge_slots + 2 * (size_t)edge;
    sb_real *upper = t->blocks[slots[0]], *lower = t->blocks[slots[1]];
    for (int code = t->edge_ring[edge]; code >= 0; code = t->ring_next[code >> 1]) {
        int at = code >> 1, tet = at / 6, flip = code & 1;
        const int *pair = ndli_solid_pair[at % 6];
        const sb_real *h = t->rotated + 16 * (size_t)tet, *a = h + 3 * pair[flip], *b = h + 3 * pair[1 - flip];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                sb_real product = a[i] * b[j];
                l[3 * i + j] += h[12] * product;
                m[3 * i + j] += h[13] * product;
            }
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            upper[3 * i + j] = lower[3 * j + i] =
                l[3 * i + j] + m[3 * j + i] + (i == j ? m[0] + m[4] + m[8] : (sb_real)0);
}

static void ndli_solid_edge_task(void *user, int chunk)
{
    ndl_tissue *t = (ndl_tissue *)user;
    int last = sbi_min_int(t->edge_end, (chunk + 1) * NDLI_SOLID_CHUNK);
    for (int e = chunk * NDLI_SOLID_CHUNK; e < last; e++)
        if (t->edge_dirty[e])
            ndli_solid_edge(t, e);
}

/* Diagonal blocks: a rigid translation costs nothing, so K_ii = - sum over j of K_ij. */
static void ndli_solid_diagonal_task(void *user, int chunk)
{
    ndl_tissue *t = (ndl_tissue *)user;
    int last = sbi_min_int(t->mesh.node_end, (chunk + 1) * NDLI_SOLID_CHUNK);
    for (int i = chunk * NDLI_SOLID_CHUNK; i < last; i++) {
        sb_real sum[9] = {0}, *out = t->diagonal[i];
        if (!t->node_dirty[i])
            continue;
        for (int k = t->row_start[i]; k < t->row_start[i] + t->row_count[i]; k++)
            for (int c = 0; c < 9; c++)
                sum[c] -= t->blocks[k][c];
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++)
                out[3 * a + b] = (sb_real)0.5 * (sum[3 * a + b] + sum[3 * b + a]);
    }
}

NDLI_API int ndli_solid_stiffness(ndl_tissue *t)
{
    int count = 0;
    for (int e = 0; e < t->mesh.tet_end; e++)
        if (t->turned[e]) {
            count++;
            for (int p = 0; p < 6; p++)
                t->edge_dirty[t->tet_edges[6 * e + p]] = 1;
        }
    sbi_run(&t->jobs, ndli_solid_edge_task, t, ndli_solid_chunks(t->edge_end));
    for (int e = 0; e < t->edge_end; e++)
        if (t->edge_dirty[e]) {
            t->node_dirty[t->edge_nodes[2 * (size_t)e]] = t->node_dirty[t->edge_nodes[2 * (size_t)e + 1]] = 1;
            t->edge_dirty[e] = 0;
        }
    sbi_run(&t->jobs, ndli_solid_diagonal_task, t, ndli_solid_chunks(t->mesh.node_end));
    return count;
}

/* ---- products ---- */

#if SBI_HAS_LANES
/* As in sparse.c: rows of blocks and vectors are read four at a time; the fourth lane is never summed, and both
 * arrays have one number to spare at their ends. */
SBI_FORCE_INLINE sb_vec3 ndli_solid_row(const ndl_tissue *t, const sb_vec3 *x, int i)
{
    const sb_real *block = t->diagonal[i];
    const int *column = t->columns + t->row_start[i], *end = column + t->row_count[i];
    sbi_lanes v = SBI_LANES_AT(&x[i].x), s0 = {0, 0, 0, 0}, s1 = s0, s2 = s0;
    sbi_lanes d = {block[6], block[7], block[8], 0};
    s0 += SBI_LANES_AT(block) * v;
    s1 += SBI_LANES_AT(block + 3) * v;
    s2 += d * v;
    block = t->blocks[t->row_start[i]];
    for (; column < end; column++, block += 9) {
        v = SBI_LANES_AT(&x[*column].x);
        s0 += SBI_LANES_AT(block) * v;
        s1 += SBI_LANES_AT(block + 3) * v;
        s2 += SBI_LANES_AT(block + 6) * v;
    }
    return sb_v3(s0[0] + s0[1] + s0[2], s1[0] + s1[1] + s1[2], s2[0] + s2[1] + s2[2]);
}
#elif defined(__GNUC__) && !defined(SB_NO_VECTORS)
/* Doubles without AVX: the nine products of a block as four pairs and one, which compilers do not find. The same nine
 * sums, the same bits. */
typedef sb_real ndli_solid_two __attribute__((vector_size(2 * sizeof(sb_real)), aligned(sizeof(sb_real)), may_alias));
#define NDLI_TWO_AT(pointer) (*(const ndli_solid_two *)(const void *)(pointer))
SBI_FORCE_INLINE sb_vec3 ndli_solid_row(const ndl_tissue *t, const sb_vec3 *x, int i)
{
    const sb_real *block = t->diagonal[i], *from = &x[i].x;
    const int *column = t->columns + t->row_start[i], *end = column + t->row_count[i];
    ndli_solid_two v20 = {from[2], from[0]};
    ndli_solid_two s0 = NDLI_TWO_AT(block) * NDLI_TWO_AT(from), s1 = NDLI_TWO_AT(block + 2) * v20;
    ndli_solid_two s2 = NDLI_TWO_AT(block + 4) * NDLI_TWO_AT(from + 1);
    ndli_solid_two s3 = NDLI_TWO_AT(block + 6) * NDLI_TWO_AT(from);
    sb_real s4 = block[8] * from[2];
    block = t->blocks[t->row_start[i]];
    for (; column < end; column++, block += 9) {
        const sb_real *w = &x[*column].x;
        ndli_solid_two w01 = NDLI_TWO_AT(w), w20 = {w[2], w[0]};
        s0 += NDLI_TWO_AT(block) * w01;
        s1 += NDLI_TWO_AT(block + 2) * w20;
        s2 += NDLI_TWO_AT(block + 4) * NDLI_TWO_AT(w + 1);
        s3 += NDLI_TWO_AT(block + 6) * w01;
        s4 += block[8] * w[2];
    }
    return sb_v3(s0[0] + s0[1] + s1[0], s1[1] + s2[0] + s2[1], s3[0] + s3[1] + s4);
}
#undef NDLI_TWO_AT
#else
SBI_FORCE_INLINE sb_vec3 ndli_solid_row(const ndl_tissue *t, const sb_vec3 *x, int i)
{
    const sb_real *block = t->diagonal[i];
    const int *column = t->columns + t->row_start[i], *end = column + t->row_count[i];
    sb_real v0 = x[i].x, v1 = x[i].y, v2 = x[i].z;
    sb_real s00 = block[0] * v0, s01 = block[1] * v1, s02 = block[2] * v2, s10 = block[3] * v0, s11 = block[4] * v1;
    sb_real s12 = block[5] * v2, s20 = block[6] * v0, s21 = block[7] * v1, s22 = block[8] * v2;
    block = t->blocks[t->row_start[i]];
    for (; column < end; column++, block += 9) {
        v0 = x[*column].x, v1 = x[*column].y, v2 = x[*column].z;
        s00 += block[0] * v0, s01 += block[1] * v1, s02 += block[2] * v2;
        s10 += block[3] * v0, s11 += block[4] * v1, s12 += block[5] * v2;
        s20 += block[6] * v0, s21 += block[7] * v1, s22 += block[8] * v2;
    }
    return sb_v3(s00 + s01 + s02, s10 + s11 + s12, s20 + s21 + s22);
}
#endif

NDLI_API void ndli_solid_multiply_rows(const ndl_tissue *t, sb_real mass, sb_real stiffness, const sb_vec3 *x,
                                       sb_vec3 *y, int first, int last)
{
    for (int i = first; i < last; i++)
        y[i] = sb_v3_madd(sb_v3_scale(mass * t->mesh.mass[i], x[i]), stiffness, ndli_solid_row(t, x, i));
}

typedef struct ndli_solid_product {
    const ndl_tissue *t;
    sb_real mass, stiffness;
    const sb_vec3 *x;
    sb_vec3 *y;
} ndli_solid_product;

static void ndli_solid_product_task(void *user, int chunk)
{
    const ndli_solid_product *p = (const ndli_solid_product *)user;
    int last = sbi_min_int(p->t->mesh.node_end, (chunk + 1) * NDLI_SOLID_CHUNK);
    ndli_solid_multiply_rows(p->t, p->mass, p->stiffness, p->x, p->y, chunk * NDLI_SOLID_CHUNK, last);
}

NDLI_API void ndli_solid_multiply(const ndl_tissue *t, sb_real mass, sb_real stiffness, const sb_vec3 *x, sb_vec3 *y)
{
    ndli_solid_product p;
    p.t = t;
    p.mass = mass;
    p.stiffness = stiffness;
    p.x = x;
    p.y = y;
    sbi_run(&t->jobs, ndli_solid_product_task, &p, ndli_solid_chunks(t->mesh.node_end));
}
