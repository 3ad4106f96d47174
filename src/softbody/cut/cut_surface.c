/* cut_surface: skin and lips of a body that is cut.
 *
 * What was taken out is drawn as a side that nobody sees: its skin and lips are left out, and those across are walls.
 *
 * Vertices stand for points of the lattices: lattice points on the skin, points of cut links, of faces of micro-tets,
 * and centres of micro-tets. Each has one vertex for each side of the cut that it is on. A link has two sides, unless
 * its ends are of one piece in some element around it: there the cut ends. A face has a side for each set of its
 * corners that are of one piece in an element on either side of it. So the sides agree in all elements around, and
 * edges close.
 *
 * A call redraws elements whose links or cells are others than when they were drawn, and those beside them whose sides
 * that changes; triangles of others are taken as they were. Vertices belong to the first element that draws them: one
 * that is now the first is redrawn. So numbers and places are those of drawing all anew. */
#include "cut_surface.h"

#include <math.h>
#include <string.h>

#include "../base/bytes.h"
#include "../body/skin_private.h"
#include "cut_private.h"

enum { SBI_DRAW_WHOLE = 0, SBI_DRAW_SPLIT = 1, SBI_DRAW_FAN = 2 }; /* faces of the skin */
enum { SBI_DRAW_POINT = 0, SBI_DRAW_LINK = 1, SBI_DRAW_FACE = 2, SBI_DRAW_CENTRE = 3, SBI_DRAW_MIDDLE = 4 };
enum { SBI_DRAW_KEY = 7 };
enum { SBI_DRAW_LISTED = 1, SBI_DRAW_CHANGED = 2, SBI_DRAW_BESIDE = 4 }; /* marks of elements */
enum { SBI_DRAW_OUTER = 64 }; /* faces of micro-tets on faces of an element, at most */

/* Of a corner of a micro-tet the face without it, in the order of sbi_micro_points. */
static const signed char sbi_draw_opposite[4] = {2, 3, 1, 0};

/* Name of a vertex, or of what is looked up by nodes: kind and side, then where. */
typedef struct sbi_draw_key {
    int at[SBI_DRAW_KEY];
} sbi_draw_key;

/* A table of open addresses over keys. */
typedef struct sbi_draw_table {
    sbi_draw_key *keys;
    int *values;
    int count, capacity; /* of keys and values */
    int *slots;          /* [slot_count] 1 + item, or 0 */
    int slot_count;
} sbi_draw_table;

typedef struct sbi_draw_vertex {
    sb_cut_origin origin;
    int cell;                      /* of the body, that it moves with */
    int is_carried;                /* 1: that is not of its own piece */
    int cell_nodes[SBI_CUT_NODES]; /* of its own piece */
    int stamp;                     /* of the last rebuild that used it */
} sbi_draw_vertex;

/* A cut link as it was when it was drawn. */
typedef struct sbi_draw_kept {
    sbi_link_key key;
    sb_real t;
    int state, charred;
} sbi_draw_kept;

/* What an element was drawn as: its triangles, and hashes of its cells and of what its sides were. */
typedef struct sbi_draw_drawn {
    int first, count;
    uint64_t cells, sides;
} sbi_draw_drawn;

typedef struct sbi_draw_axes {
    sb_vec3 normal, u, v;
} sbi_draw_axes;

struct sb_cut_surface {
    struct sb_skin skin;
    int pending; /* 1: a skin was brought up to date since the last update, which has not named yet what that made */
    sb_cut *cut;
    sb_allocator allocator;
    int version; /* of the body's mesh that triangles are of; -1: to be made */
    int stamp;
    int failed; /* 1: no memory since the update began */

    int face_count;                /* of the skin */
    int *faces;                    /* [face_count] 4 tet + face */
    int *face_of;                  /* [4 tet_count] number of the skin's face, or -1 */
    unsigned char *face_states;    /* [face_count] */
    unsigned char *tet_marks;      /* [tet_count] */
    sbi_draw_drawn *drawn;         /* [tet_count] of those that are listed */
    sbi_cut_list tets;             /* that are drawn by pieces, ascending */
    sbi_draw_kept *kept;           /* links that the triangles are of */
    int kept_count, kept_capacity; /* count -1: there are no triangles to be kept */
    int fanned;                    /* edges whose faces have been found */
    unsigned char *merged;         /* [link] 1: the cut ends there */
    int merged_capacity;
    sbi_draw_table joins; /* of faces between elements: which corners are of one piece, as bits of pairs */
    sbi_draw_table edges; /* of the skin that faces meet at by links */
    signed char edge_of[4][4];
    signed char beside[4][3]; /* local corners of a tet's face without each, counter-clockwise from outside */

    sbi_draw_table names; /* of vertices */
    sbi_draw_vertex *vertices;
    sb_cut_origin *origins;
    sb_vec3 *positions, *normals, *rest;
    sb_real (*texture)[2];
    int *points;
    int vertex_capacity;
    int *stand_ins; /* [nodes] where a node is drawn: without material at another's place, else at its own */
    int stand_in_capacity;
    int (*triangles)[3];
    unsigned char *tags;
    int *cells;
    int triangle_count, triangle_capacity, triangles_before;
    int (*old_triangles)[3]; /* [triangles_before] as they were before the rebuild at work */
    unsigned char *old_tags;
    int *old_cells;
    int old_capacity[3];
    int first_triangle, triangle_end, first_vertex;
    sbi_draw_axes *axes;
    int axes_count, axes_capacity;
};

/* An element at work. */
typedef struct sbi_draw_tet {
    int tet;
    sbi_parted parted;
    int cells[SBI_LATTICE_POINTS];             /* of the pieces */
    int carriers[SBI_LATTICE_POINTS];          /* cells that have them where they would be left behind */
    signed char places[4][SBI_LATTICE_POINTS]; /* of points of a face in it, the same from both its elements */
} sbi_draw_tet;

/* ---- tables ---- */

/* Memory that the system does not only promise: it is written to at once. NULL: there is none. */
static void *sbi_draw_take(const sb_allocator *allocator, int count, size_t size)
{
    void *memory = sbi_alloc(allocator, (size_t)count, size);
    return memory ? memset(memory, 0, (size_t)count * size) : NULL;
}

static int sbi_draw_slot(const sbi_draw_table *table, const sbi_draw_key *key)
{
    unsigned mask = (unsigned)table->slot_count - 1;
    uint64_t mixed = 0;
    for (int i = 0; i < SBI_DRAW_KEY; i++) {
        mixed = (mixed ^ (unsigned)key->at[i]) * UINT64_C(0x9e3779b97f4a7c15);
        mixed ^= mixed >> 32;
    }
    for (unsigned slot = (unsigned)mixed & mask;; slot = (slot + 1) & mask) {
        int item = table->slots[slot] - 1;
        if (item < 0 || memcmp(table->keys[item].at, key->at, sizeof key->at) == 0)
            return (int)slot;
    }
}

/* Item of a key, or -1. */
static int sbi_draw_find(const sbi_draw_table *table, const sbi_draw_key *key)
{
    return table->count ? table->slots[sbi_draw_slot(table, key)] - 1 : -1;
}

static void sbi_draw_free_table(const sb_allocator *allocator, sbi_draw_table *table)
{
    sbi_free(allocator, table->keys);
    sbi_free(allocator, table->values);
    sbi_free(allocator, table->slots);
}

/* Room for so many keys, a power of two; 0: no memory. */
static int sbi_draw_size_table(const sb_allocator *allocator, sbi_draw_table *table, int capacity)
{
    sbi_draw_table next = *table;
    next.capacity = capacity;
    if (capacity > INT32_MAX / 8)
        return 0;
    next.slot_count = 4 * capacity;
    next.keys = (sbi_draw_key *)sbi_draw_take(allocator, next.capacity, sizeof *next.keys);
    next.values = (int *)sbi_draw_take(allocator, next.capacity, sizeof(int));
    next.slots = (int *)sbi_draw_take(allocator, next.slot_count, sizeof(int));
    if (!next.keys || !next.values || !next.slots) {
        sbi_draw_free_table(allocator, &next);
        return 0;
    }
    if (table->count) {
        memcpy(next.keys, table->keys, (size_t)table->count * sizeof *next.keys);
        memcpy(next.values, table->values, (size_t)table->count * sizeof(int));
    }
    for (int i = 0; i < next.count; i++)
        next.slots[sbi_draw_slot(&next, &next.keys[i])] = i + 1;
    sbi_draw_free_table(allocator, table);
    *table = next;
    return 1;
}

/* Room for one more; 0: no memory. */
static int sbi_draw_grow_table(const sb_allocator *allocator, sbi_draw_table *table)
{
    if (table->count < table->capacity)
        return 1;
    return table->capacity <= INT32_MAX / 16 &&
           sbi_draw_size_table(allocator, table, table->capacity ? 2 * table->capacity : 256);
}

/* Item of a key, which is added with value 0 where it is not there; -1: no memory. */
static int sbi_draw_put(const sb_allocator *allocator, sbi_draw_table *table, const sbi_draw_key *key)
{
    int item = sbi_draw_find(table, key);
    if (item >= 0)
        return item;
    if (!sbi_draw_grow_table(allocator, table))
        return -1;
    table->keys[table->count] = *key;
    table->values[table->count] = 0;
    table->slots[sbi_draw_slot(table, key)] = table->count + 1;
    return table->count++;
}

static void sbi_draw_clear_table(sbi_draw_table *table)
{
    if (table->count)
        memset(table->slots, 0, (size_t)table->slot_count * sizeof(int));
    table->count = 0;
}

static sbi_draw_key sbi_draw_key_make(int kind, int a, int b, int c, int d, int node)
{
    sbi_draw_key key;
    key.at[0] = kind;
    key.at[1] = a;
    key.at[2] = b;
    key.at[3] = c;
    key.at[4] = d;
    key.at[5] = node;
    key.at[6] = 0;
    return key;
}

static sbi_draw_key sbi_draw_edge_key(int a, int b)
{
    return sbi_draw_key_make(SBI_DRAW_POINT, sbi_min_int(a, b), sbi_max_int(a, b), -1, 0, 0);
}

/* ---- arrays ---- */

/* Room for so many vertices in all arrays; 0: no memory. */
static int sbi_draw_size_vertices(sb_cut_surface *s, int capacity)
{
    size_t used = (size_t)s->names.count;
    sbi_draw_vertex *vertices;
    sb_cut_origin *origins;
    sb_vec3 *vectors[3], **old[3];
    sb_real(*texture)[2];
    int *points;
    old[0] = &s->positions, old[1] = &s->normals, old[2] = &s->rest;
    vertices = (sbi_draw_vertex *)sbi_draw_take(&s->allocator, capacity, sizeof *vertices);
    origins = (sb_cut_origin *)sbi_draw_take(&s->allocator, capacity, sizeof *origins);
    texture = (sb_real(*)[2])sbi_draw_take(&s->allocator, capacity, sizeof *texture);
    points = (int *)sbi_draw_take(&s->allocator, capacity, sizeof *points);
    for (int k = 0; k < 3; k++)
        vectors[k] = (sb_vec3 *)sbi_draw_take(&s->allocator, capacity, sizeof(sb_vec3));
    if (!vertices || !origins || !texture || !points || !vectors[0] || !vectors[1] || !vectors[2]) {
        sbi_free(&s->allocator, vertices);
        sbi_free(&s->allocator, origins);
        sbi_free(&s->allocator, texture);
        sbi_free(&s->allocator, points);
        for (int k = 0; k < 3; k++)
            sbi_free(&s->allocator, vectors[k]);
        return 0;
    }
    if (used) {
        memcpy(vertices, s->vertices, used * sizeof *vertices);
        memcpy(origins, s->origins, used * sizeof *origins);
        memcpy(texture, s->texture, used * sizeof *texture);
        memcpy(points, s->points, used * sizeof *points);
    }
    sbi_free(&s->allocator, s->vertices);
    sbi_free(&s->allocator, s->origins);
    sbi_free(&s->allocator, s->texture);
    sbi_free(&s->allocator, s->points);
    for (int k = 0; k < 3; k++) {
        if (used)
            memcpy(vectors[k], *old[k], used * sizeof(sb_vec3));
        sbi_free(&s->allocator, *old[k]);
        *old[k] = vectors[k];
    }
    s->vertices = vertices;
    s->origins = origins;
    s->texture = texture;
    s->points = points;
    s->vertex_capacity = capacity;
    return 1;
}

/* Room for one vertex more; 0: no memory. */
static int sbi_draw_grow_vertices(sb_cut_surface *s)
{
    if (s->names.count < s->vertex_capacity)
        return 1;
    return s->vertex_capacity <= INT32_MAX / 16 &&
           sbi_draw_size_vertices(s, s->vertex_capacity ? 2 * s->vertex_capacity : 1024);
}

/* Room for one triangle more; 0: no memory. */
static int sbi_draw_grow_triangles(sb_cut_surface *s)
{
    void *triangles = s->triangles, *tags = s->tags, *cells = s->cells;
    int capacity[3], grown;
    if (s->triangle_count < s->triangle_capacity)
        return 1;
    capacity[0] = capacity[1] = capacity[2] = s->triangle_capacity;
    grown = sbi_cut_grow(&s->allocator, &triangles, capacity, s->triangle_count, 1, sizeof *s->triangles) &&
            sbi_cut_grow(&s->allocator, &tags, capacity + 1, s->triangle_count, 1, 1) &&
            sbi_cut_grow(&s->allocator, &cells, capacity + 2, s->triangle_count, 1, sizeof(int));
    s->triangles = (int(*)[3])triangles;
    s->tags = (unsigned char *)tags;
    s->cells = (int *)cells;
    if (grown)
        s->triangle_capacity = capacity[0];
    return grown;
}

/* ---- vertices and triangles ---- */

/* Where a vertex of a lip is along the cut, whose triangle at rest has this normal. */
static void sbi_draw_put_texture(sb_cut_surface *s, int vertex, sb_vec3 normal)
{
    const sb_real near = (sb_real)0.7;
    int at = 0;
    void *axes = s->axes;
    sb_real size = sb_v3_norm(normal);
    s->texture[vertex][0] = s->texture[vertex][1] = 0;
    if (!(size > 0))
        return;
    normal = sb_v3_scale(1 / size, normal);
    while (at < s->axes_count && !(sb_abs(sb_v3_dot(s->axes[at].normal, normal)) > near))
        at++;
    if (at == s->axes_count) {
        int grown = sbi_cut_grow(&s->allocator, &axes, &s->axes_capacity, at, 1, sizeof *s->axes);
        s->axes = (sbi_draw_axes *)axes;
        s->failed |= !grown;
        if (!grown)
            return;
        s->axes[at].normal = normal;
        s->axes[at].u = sb_v3_perpendicular(normal);
        s->axes[at].u = sb_v3_scale(1 / sb_v3_norm(s->axes[at].u), s->axes[at].u);
        s->axes[at].v = sb_v3_cross(normal, s->axes[at].u);
        s->axes_count++;
    }
    s->texture[vertex][0] = sb_v3_dot(s->rest[vertex], s->axes[at].u);
    s->texture[vertex][1] = sb_v3_dot(s->rest[vertex], s->axes[at].v);
}

/* 1: a place of a cell depends on nodes without material, which stand still. */
static int sbi_draw_stands_still(const sb_cut_surface *s, int cell, const sb_real at[4])
{
    const int *nodes = sb_body_cell_nodes(s->cut->body, cell), *part_of = s->cut->body->node_component;
    int still = 0;
    for (int a = 0; a < 4; a++) {
        still |= at[a] > 0 && part_of[nodes[a]] < 0;
        for (int b = a + 1; b < 4 && s->cut->nodes_per_tet > 4; b++)
            still |= at[a] > 0 && at[b] > 0 && part_of[nodes[4 + s->edge_of[a][b]]] < 0;
    }
    return still;
}

/* The vertex with this name, on a piece of the element, at these barycentrics. The lowest bit of at[6] of the
 * name is its tag; normal: of a lip, at rest. */
static int sbi_draw_vertex_of(sb_cut_surface *s, const sbi_draw_tet *t, int piece, sbi_draw_key key,
                              const sb_real at[4], sb_vec3 normal)
{
    const int *tet = s->cut->tets + 4 * (size_t)t->tet;
    int before = s->names.count, vertex, other;
    sbi_draw_vertex *made;
    if (!sbi_draw_grow_vertices(s) || (vertex = sbi_draw_put(&s->allocator, &s->names, &key)) < 0) {
        s->failed = 1;
        return 0;
    }
    made = s->vertices + vertex;
    if (vertex == before) {
        sb_vec3 x[4];
        made->stamp = -1;
        for (int a = 0; a < 4; a++)
            x[a] = s->cut->body->reference[tet[a]];
        s->rest[vertex] = sbi_lattice_place(&t->parted.order, at, x);
        key.at[6] ^= 1;
        other = sbi_draw_find(&s->names, &key);
        s->points[vertex] = other >= 0 ? s->points[other] : vertex;
        s->normals[vertex] = sb_v3(0, 0, 0);
        sbi_draw_put_texture(s, vertex, normal);
    }
    if (made->stamp != s->stamp) {
        made->stamp = s->stamp;
        made->origin.element = t->tet;
        memcpy(made->origin.nodes, tet, sizeof made->origin.nodes);
        memcpy(made->origin.weights, at, sizeof made->origin.weights);
        made->is_carried = t->carriers[piece] != t->cells[piece] && sbi_draw_stands_still(s, t->cells[piece], at);
        made->cell = made->is_carried ? t->carriers[piece] : t->cells[piece];
        memcpy(made->cell_nodes, sb_body_cell_nodes(s->cut->body, t->cells[piece]),
               (size_t)s->cut->nodes_per_tet * sizeof(int));
        s->origins[vertex] = made->origin;
    }
    return vertex;
}

static void sbi_draw_set_triangle(sb_cut_surface *s, int at, int a, int b, int c, int tag, int cell)
{
    int *triangle = s->triangles[at];
    if (at < s->triangles_before && triangle[0] == a && triangle[1] == b && triangle[2] == c && s->tags[at] == tag &&
        s->cells[at] == cell)
        return;
    s->first_triangle = sbi_min_int(s->first_triangle, at);
    s->triangle_end = sbi_max_int(s->triangle_end, at + 1);
    triangle[0] = a;
    triangle[1] = b;
    triangle[2] = c;
    s->tags[at] = (unsigned char)tag;
    s->cells[at] = cell;
}

static void sbi_draw_add_triangle(sb_cut_surface *s, int a, int b, int c, int tag, int cell)
{
    if (!sbi_draw_grow_triangles(s)) {
        s->failed = 1;
        return;
    }
    sbi_draw_set_triangle(s, s->triangle_count, a, b, c, tag, cell);
    s->triangle_count++;
}

/* The cell that a triangle of a piece moves with. */
static int sbi_draw_cell_of(const sb_cut_surface *s, const sbi_draw_tet *t, int piece, const int v[3])
{
    int is_carried =
        s->failed ? 0 : s->vertices[v[0]].is_carried || s->vertices[v[1]].is_carried || s->vertices[v[2]].is_carried;
    return is_carried ? t->carriers[piece] : t->cells[piece];
}

/* Adds a triangle of a piece. */
static void sbi_draw_add_of(sb_cut_surface *s, const sbi_draw_tet *t, int piece, int a, int b, int c, int tag)
{
    int v[3];
    v[0] = a, v[1] = b, v[2] = c;
    sbi_draw_add_triangle(s, a, b, c, tag, sbi_draw_cell_of(s, t, piece, v));
}

/* ---- names ---- */

/* A number for a place, from its bits: points of faces and centres are others once more of their links are cut. */
static int sbi_draw_place(const sbi_draw_tet *t, const sb_real at[4])
{
    uint64_t mixed = 0;
    for (int k = 0; k < 4; k++) {
        uint64_t bits = 0;
        memcpy(&bits, &at[t->parted.order.corners[k]], sizeof *at);
        if (bits) { /* the corner that the other element of a face does not have counts for nothing */
            mixed = (mixed ^ bits) * UINT64_C(0x9e3779b97f4a7c15);
            mixed ^= mixed >> 32;
        }
    }
    return (int)(mixed & 0x3fffffff);
}

/* Node of a piece's cell that tells apart the sides of a cut at a place: the first corner, in ascending order, that it
 * depends on, or the middle of its edge where that has a node. */
static int sbi_draw_node(const sb_cut_surface *s, const sbi_draw_tet *t, int piece, const sb_real at[4])
{
    const int *nodes = sb_body_cell_nodes(s->cut->body, t->cells[piece]);
    int corners[4], count = 0;
    for (int k = 0; k < 4; k++)
        if (at[t->parted.order.corners[k]] != 0)
            corners[count++] = t->parted.order.corners[k];
    if (count == 2 && s->cut->nodes_per_tet > 4)
        return nodes[4 + s->edge_of[corners[0]][corners[1]]];
    return count ? nodes[corners[0]] : -1;
}

/* A lattice point on the skin: its element's nodes with their weights, ascending. */
static int sbi_draw_point(sb_cut_surface *s, const sbi_draw_tet *t, int point)
{
    const sbi_lattice *lattice = t->parted.lattice;
    const sbi_corner_order *order = &t->parted.order;
    int names[3] = {-1, -1, -1}, count = 0, code = 0, piece = t->parted.piece_of[point];
    sb_real at[4];
    sbi_lattice_point(lattice, point, at);
    for (int k = 0; k < 4; k++) {
        int corner = order->corners[k], weight = lattice->points[point][corner];
        if (weight == 0 || count == 3)
            continue;
        names[count++] = order->nodes[corner];
        code = 8 * code + weight;
    }
    return sbi_draw_vertex_of(
        s, t, piece,
        sbi_draw_key_make(SBI_DRAW_POINT, names[0], names[1], names[2], code, sbi_draw_node(s, t, piece, at)), at,
        sb_v3(0, 0, 0));
}

/* The point of a cut link, on the side of the lattice point `end`. */
static int sbi_draw_link(sb_cut_surface *s, const sbi_draw_tet *t, int link, int end, int tag, sb_vec3 normal)
{
    const sbi_parted *parted = &t->parted;
    int item = parted->rank[link], ends[2], piece = parted->piece_of[end], side;
    const sbi_link_key *name = &s->cut->links.items[item].key;
    sb_real first[4], last[4], at[4];
    sbi_draw_key key;
    sbi_lattice_ends(parted->lattice, &parted->order, link, ends);
    sbi_lattice_point(parted->lattice, ends[0], first);
    sbi_lattice_point(parted->lattice, ends[1], last);
    for (int a = 0; a < 4; a++)
        at[a] = (1 - parted->t[link]) * first[a] + parted->t[link] * last[a];
    side = s->merged[item] ? 0 : end == ends[1];
    for (int a = 0; a < 4; a++) /* crossings at an end still depend on all of the link's corners */
        first[a] += last[a];
    key = sbi_draw_key_make(SBI_DRAW_LINK | side << 3, name->at[0], name->at[1], name->at[2], name->at[3],
                            sbi_draw_node(s, t, piece, first));
    key.at[6] = tag | sbi_draw_place(t, at) << 1; /* ablation moves crossings */
    return sbi_draw_vertex_of(s, t, piece, key, at, normal);
}

/* Name of a face of a micro-tet, and the ranks of its three corners (ascending in `ranked`): of a face of the element
 * by its nodes, and then *shared is 1. */
static sbi_draw_key sbi_draw_face_key(const sbi_draw_tet *t, int micro, const int local[3], int ranked[3], int *shared)
{
    const sbi_lattice *lattice = t->parted.lattice;
    const unsigned char *corners = lattice->micros[micro];
    int rank[3], code = 0, outer = -1;
    for (int face = 0; face < 4; face++) {
        uint64_t all = lattice->face_points[face];
        if ((all >> corners[local[0]] & 1) && (all >> corners[local[1]] & 1) && (all >> corners[local[2]] & 1))
            outer = face;
    }
    for (int k = 0; k < 3; k++) {
        rank[k] = corners[local[k]];
        ranked[k] = k;
        if (outer >= 0)
            rank[k] = t->places[outer][corners[local[k]]];
    }
    for (int i = 1; i < 3; i++)
        for (int k = i; k > 0 && rank[ranked[k - 1]] > rank[ranked[k]]; k--) {
            int swap = ranked[k];
            ranked[k] = ranked[k - 1];
            ranked[k - 1] = swap;
        }
    for (int k = 0; k < 3; k++)
        code = 64 * code + rank[ranked[k]];
    *shared = outer >= 0;
    if (outer >= 0) {
        int names[3], count = 0;
        for (int k = 0; k < 4; k++) {
            int corner = t->parted.order.corners[k];
            if (lattice->face_points[outer] >> corner & 1)
                names[count++] = t->parted.order.nodes[corner];
        }
        return sbi_draw_key_make(SBI_DRAW_FACE, names[0], names[1], names[2], code, 0);
    }
    return sbi_draw_key_make(SBI_DRAW_FACE, t->tet, -1, -1, code, 0);
}

/* Which pairs (01, 02, 12) of the ranked corners of a face are of one piece, as bits. */
static int sbi_draw_pairs(const sbi_draw_tet *t, int micro, const int local[3], const int ranked[3])
{
    const unsigned char *corners = t->parted.lattice->micros[micro], *piece_of = t->parted.piece_of;
    int a = piece_of[corners[local[ranked[0]]]], b = piece_of[corners[local[ranked[1]]]];
    int c = piece_of[corners[local[ranked[2]]]];
    return (a == b) | (a == c) << 1 | (b == c) << 2;
}

/* The point of a face of a micro-tet on the side of corner `local[k]`. */
static int sbi_draw_face(sb_cut_surface *s, const sbi_draw_tet *t, int micro, const int local[3], int k,
                         const sb_real at[4], int tag, sb_vec3 normal)
{
    int ranked[3], shared, pairs, mine = 0, side, piece;
    sbi_draw_key key = sbi_draw_face_key(t, micro, local, ranked, &shared);
    pairs = sbi_draw_pairs(t, micro, local, ranked);
    if (shared) {
        int item = sbi_draw_find(&s->joins, &key);
        pairs |= item >= 0 ? s->joins.values[item] : 0;
    }
    if ((pairs & 3) == 3 || (pairs & 5) == 5 || (pairs & 6) == 6)
        pairs = 7; /* two pairs join all */
    while (ranked[mine] != k)
        mine++;
    side = mine == 0 ? 0 : mine == 1 ? (pairs & 1 ? 0 : 1) : pairs & 2 ? 0 : pairs & 4 ? 1 : 2;
    piece = t->parted.piece_of[t->parted.lattice->micros[micro][local[k]]];
    key.at[0] |= side << 3;
    key.at[5] = sbi_draw_node(s, t, piece, at);
    key.at[6] = tag | sbi_draw_place(t, at) << 1;
    return sbi_draw_vertex_of(s, t, piece, key, at, normal);
}

static int sbi_draw_centre(sb_cut_surface *s, const sbi_draw_tet *t, int micro, int piece, const sb_real at[4],
                           sb_vec3 normal)
{
    int cell_node = sb_body_cell_nodes(s->cut->body, t->cells[piece])[t->parted.order.corners[0]], lowest = 0;
    sbi_draw_key key;
    while (!(t->parted.pieces[piece] >> lowest & 1))
        lowest++;
    key = sbi_draw_key_make(SBI_DRAW_CENTRE, t->tet, micro, lowest, 0, cell_node);
    key.at[6] = SB_CUT_LIP | sbi_draw_place(t, at) << 1;
    return sbi_draw_vertex_of(s, t, piece, key, at, normal);
}

/* ---- what is to be drawn by pieces ---- */

/* Of a film, a piece without volume, the cell of the piece that it lies on, or on which the film lies that it lies
 * on. */
static void sbi_draw_find_carriers(const sb_cut *cut, sbi_draw_tet *t)
{
    const sbi_parted *parted = &t->parted;
    int is_carried[SBI_LATTICE_POINTS], changed = 0;
    for (int piece = 0; piece < parted->piece_count; piece++) {
        t->carriers[piece] = t->cells[piece];
        is_carried[piece] = sb_body_cell_share(cut->body, t->cells[piece]) > 0;
        changed |= !is_carried[piece];
    }
    while (changed) {
        changed = 0;
        for (int end = 0; end < 2 * parted->lattice->link_count; end++) {
            const unsigned char *ends = parted->lattice->links[end / 2];
            int film = parted->piece_of[ends[end % 2]], under = parted->piece_of[ends[1 - end % 2]];
            if (film == SBI_PARTED_LOST || under == SBI_PARTED_LOST || is_carried[film] || !is_carried[under])
                continue;
            t->carriers[film] = t->carriers[under];
            is_carried[film] = changed = 1;
        }
    }
}

static void sbi_draw_load_tet(const sb_cut_surface *s, int tet, sbi_draw_tet *t)
{
    const sb_cut *cut = s->cut;
    int count = 0;
    t->tet = tet;
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, &t->parted);
    for (int face = 0; face < 4; face++)
        sbi_lattice_face_places(&cut->lattice, &t->parted.order, face, t->places[face]);
    for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next)
        t->cells[count++] = cut->pieces[piece].cell;
    sbi_draw_find_carriers(cut, t);
}

/* Lists an element; changed: it is not as it was drawn. */
static void sbi_draw_mark_tet(sb_cut_surface *s, int tet, int changed)
{
    if (changed || !s->tet_marks[tet])
        s->tet_marks[tet] |= SBI_DRAW_LISTED | SBI_DRAW_CHANGED;
}

static int sbi_draw_has_node(const sb_cut *cut, int tet, int node)
{
    const int *nodes = cut->tets + 4 * (size_t)tet;
    return nodes[0] == node || nodes[1] == node || nodes[2] == node || nodes[3] == node;
}

/* Marks the elements around a link as changed. */
static void sbi_draw_mark_around(sb_cut_surface *s, const sbi_link_key *key)
{
    const sb_cut *cut = s->cut;
    const int *at = key->at;
    if (at[1] < 0) {
        sbi_draw_mark_tet(s, at[0], 1);
        return;
    }
    for (int k = cut->node_tets.offsets[at[0]]; k < cut->node_tets.offsets[at[0] + 1]; k++) {
        int tet = cut->node_tets.items[k];
        if (sbi_draw_has_node(cut, tet, at[1]) && (at[2] < 0 || sbi_draw_has_node(cut, tet, at[2])))
            sbi_draw_mark_tet(s, tet, 1);
    }
}

/* Marks the elements around links that are new, or others than they were. */
static void sbi_draw_mark_links(sb_cut_surface *s)
{
    for (int i = 0; i < s->cut->links.count; i++) {
        const sbi_cut_link *link = s->cut->links.items + i;
        sbi_draw_kept *kept = s->kept + i;
        if (i < s->kept_count && kept->t == link->t && kept->state == link->state && kept->charred == link->charred)
            continue;
        if (i >= s->kept_count)
            s->merged[i] = 0;
        kept->key = link->key;
        kept->t = link->t;
        kept->state = link->state;
        kept->charred = link->charred;
        sbi_draw_mark_around(s, &link->key);
    }
    s->kept_count = s->cut->links.count;
}

/* Of an element: cells of its pieces, their nodes, and what was taken out. */
static uint64_t sbi_draw_hash_cells(const sb_cut_surface *s, int tet)
{
    const sb_cut *cut = s->cut;
    uint64_t hash = cut->links.lost[tet];
    for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next) {
        const int *nodes = sbi_cut_piece_nodes(cut, piece);
        hash = sbi_hash_word(hash, cut->pieces[piece].points);
        hash = sbi_hash_word(hash, (uint64_t)cut->pieces[piece].cell);
        for (int a = 0; a < cut->nodes_per_tet; a++)
            hash = sbi_hash_word(hash, 2 * (uint64_t)nodes[a] + (cut->body->node_component[nodes[a]] < 0));
    }
    return hash;
}

static void sbi_draw_mark_cells(sb_cut_surface *s)
{
    for (int i = 0; i < s->tets.count; i++) {
        int tet = s->tets.items[i];
        if (s->drawn[tet].cells != sbi_draw_hash_cells(s, tet))
            sbi_draw_mark_tet(s, tet, 1);
    }
}

static int sbi_draw_shares_edge(const sb_cut *cut, int tet, int other)
{
    int shared = 0;
    for (int a = 0; a < 4; a++)
        shared += sbi_draw_has_node(cut, other, cut->tets[4 * (size_t)tet + (size_t)a]);
    return shared > 1;
}

/* Marks the listed elements that share an edge with one that has changed. */
static void sbi_draw_mark_beside(sb_cut_surface *s)
{
    const sb_cut *cut = s->cut;
    for (int i = 0; i < s->tets.count; i++) {
        int tet = s->tets.items[i];
        for (int a = 0; a < 4 && (s->tet_marks[tet] & SBI_DRAW_CHANGED); a++) {
            int node = cut->tets[4 * (size_t)tet + (size_t)a];
            for (int k = cut->node_tets.offsets[node]; k < cut->node_tets.offsets[node + 1]; k++) {
                int other = cut->node_tets.items[k];
                if (s->tet_marks[other] == SBI_DRAW_LISTED && sbi_draw_shares_edge(cut, tet, other))
                    s->tet_marks[other] |= SBI_DRAW_BESIDE;
            }
        }
    }
}

static void sbi_draw_list_tets(sb_cut_surface *s)
{
    s->tets.count = 0;
    for (int tet = 0; tet < s->cut->tet_count; tet++)
        if (s->tet_marks[tet])
            s->tets.items[s->tets.count++] = tet;
}

/* Local corners of a face of a micro-tet without corner x, counter-clockwise from outside. */
static void sbi_draw_micro_face(const sb_cut_surface *s, int x, int local[3])
{
    for (int k = 0; k < 3; k++)
        local[k] = s->beside[x][k];
}

/* A face of a micro-tet on a face of the element that has a cut link. */
typedef struct sbi_draw_outer {
    sbi_draw_key key;
    int pairs;
} sbi_draw_outer;

static int sbi_draw_list_outer(const sb_cut_surface *s, const sbi_draw_tet *t, sbi_draw_outer outer[SBI_DRAW_OUTER])
{
    const sbi_parted *parted = &t->parted;
    const sbi_lattice *lattice = parted->lattice;
    int count = 0;
    for (int micro = 0; micro < lattice->micro_count; micro++)
        for (int x = 0; x < 4; x++) {
            int local[3], ranked[3], shared, cut = 0;
            sbi_draw_key key;
            sbi_draw_micro_face(s, x, local);
            for (int k = 0; k < 3; k++)
                cut |= parted->cut[lattice->micro_links[micro][s->edge_of[local[k]][local[(k + 1) % 3]]]];
            if (!cut)
                continue;
            key = sbi_draw_face_key(t, micro, local, ranked, &shared);
            if (!shared)
                continue;
            outer[count].key = key;
            outer[count++].pairs = sbi_draw_pairs(t, micro, local, ranked);
        }
    return count;
}

/* Forgets what an element has said of its sides, and all others around: they are to say it again. */
static void sbi_draw_clear_sides(sb_cut_surface *s, const sbi_draw_tet *t)
{
    sbi_draw_outer outer[SBI_DRAW_OUTER];
    int count = sbi_draw_list_outer(s, t, outer);
    for (int l = 0; l < t->parted.lattice->link_count; l++)
        if (t->parted.cut[l])
            s->merged[t->parted.rank[l]] = 0;
    for (int i = 0; i < count; i++) {
        int item = sbi_draw_find(&s->joins, &outer[i].key);
        if (item >= 0)
            s->joins.values[item] = 0;
    }
}

/* Where cuts end, and which corners of faces between elements are of one piece in one of them. */
static void sbi_draw_find_sides(sb_cut_surface *s, const sbi_draw_tet *t)
{
    const sbi_parted *parted = &t->parted;
    const sbi_lattice *lattice = parted->lattice;
    sbi_draw_outer outer[SBI_DRAW_OUTER];
    int count = sbi_draw_list_outer(s, t, outer);
    for (int l = 0; l < lattice->link_count; l++) {
        if (parted->cut[l] && parted->piece_of[lattice->links[l][0]] == parted->piece_of[lattice->links[l][1]])
            s->merged[parted->rank[l]] = 1;
    }
    for (int i = 0; i < count; i++) {
        int item = sbi_draw_put(&s->allocator, &s->joins, &outer[i].key);
        s->failed |= item < 0;
        if (item >= 0)
            s->joins.values[item] |= outer[i].pairs;
    }
}

/* Of all that an element is drawn by and that others around have a say in. */
static uint64_t sbi_draw_hash_sides(const sb_cut_surface *s, const sbi_draw_tet *t)
{
    const int *nodes = s->cut->tets + 4 * (size_t)t->tet;
    sbi_draw_outer outer[SBI_DRAW_OUTER];
    int count = sbi_draw_list_outer(s, t, outer);
    uint64_t hash = 0;
    for (int l = 0; l < t->parted.lattice->link_count; l++)
        if (t->parted.cut[l])
            hash = sbi_hash_word(hash, s->merged[t->parted.rank[l]]);
    for (int i = 0; i < count; i++) {
        int item = sbi_draw_find(&s->joins, &outer[i].key);
        hash = sbi_hash_word(hash, item >= 0 ? (uint64_t)s->joins.values[item] : 0);
    }
    for (int face = 0; face < 4; face++) {
        int number = s->face_of[4 * (size_t)t->tet + (size_t)face], local[SB_MAX_FACE_NODES];
        hash = number < 0 ? hash : sbi_hash_word(hash, s->face_states[number]);
        if (number < 0 || s->face_states[number] != SBI_DRAW_FAN)
            continue;
        sb_element_face(SB_TET4, face, local, NULL);
        for (int k = 0; k < 3; k++) {
            sbi_draw_key edge = sbi_draw_edge_key(nodes[local[k]], nodes[local[(k + 1) % 3]]);
            hash = sbi_hash_word(hash, sbi_draw_find(&s->edges, &edge) >= 0);
        }
    }
    return hash;
}

/* Whether a face of the skin has a cut link. */
static int sbi_draw_face_is_cut(const sbi_draw_tet *t, int face)
{
    const sbi_lattice *lattice = t->parted.lattice;
    uint64_t on = lattice->face_points[face];
    int cut = 0;
    for (int l = 0; l < lattice->link_count && !cut; l++)
        cut = t->parted.cut[l] && (on >> lattice->links[l][0] & 1) && (on >> lattice->links[l][1] & 1);
    return cut;
}

/* Splits the faces of the skin that are cut, and lists their edges. */
static void sbi_draw_split_faces(sb_cut_surface *s, const sbi_draw_tet *t)
{
    const int *nodes = s->cut->tets + 4 * (size_t)t->tet;
    for (int face = 0; face < 4; face++) {
        int number = s->face_of[4 * (size_t)t->tet + (size_t)face], local[SB_MAX_FACE_NODES];
        if (number < 0 || !sbi_draw_face_is_cut(t, face))
            continue;
        s->face_states[number] = SBI_DRAW_SPLIT;
        sb_element_face(SB_TET4, face, local, NULL);
        for (int k = 0; k < 3 && t->parted.lattice->intervals > 1; k++) {
            sbi_draw_key key = sbi_draw_edge_key(nodes[local[k]], nodes[local[(k + 1) % 3]]);
            s->failed |= sbi_draw_put(&s->allocator, &s->edges, &key) < 0;
        }
    }
}

/* Faces beside those that were split have their edges in links, too. */
static void sbi_draw_find_fans(sb_cut_surface *s)
{
    const sb_cut *cut = s->cut;
    for (int i = s->fanned; i < s->edges.count; i++) {
        int a = s->edges.keys[i].at[1], b = s->edges.keys[i].at[2];
        for (int k = cut->node_tets.offsets[a]; k < cut->node_tets.offsets[a + 1]; k++) {
            int tet = cut->node_tets.items[k];
            if (!sbi_draw_has_node(cut, tet, b))
                continue;
            for (int face = 0; face < 4; face++) {
                int number = s->face_of[4 * (size_t)tet + (size_t)face], local[SB_MAX_FACE_NODES], found = 0;
                sb_element_face(SB_TET4, face, local, NULL);
                for (int c = 0; c < 3; c++)
                    found += cut->tets[4 * (size_t)tet + (size_t)local[c]] == a ||
                             cut->tets[4 * (size_t)tet + (size_t)local[c]] == b;
                if (found < 2 || number < 0 || s->face_states[number] != SBI_DRAW_WHOLE)
                    continue;
                s->face_states[number] = SBI_DRAW_FAN;
                sbi_draw_mark_tet(s, tet, 0);
            }
        }
    }
    s->fanned = s->edges.count;
}

/* ---- drawing an element ---- */

static int sbi_draw_is_lost(const sbi_draw_tet *t, int point) { return t->parted.piece_of[point] == SBI_PARTED_LOST; }

/* What one end of a cut link on the skin has of the edge from corner `edge` to the next one: end is the corner. */
static void sbi_draw_skin_half(sb_cut_surface *s, const sbi_draw_tet *t, int micro, const int local[3], int edge,
                               int end, int link, const sb_real middle[4])
{
    const sb_vec3 none = {0, 0, 0};
    int point = t->parted.lattice->micros[micro][local[end]], at, crossing, hub;
    if (sbi_draw_is_lost(t, point))
        return;
    at = sbi_draw_point(s, t, point);
    crossing = sbi_draw_link(s, t, link, point, SB_CUT_SKIN, none);
    hub = sbi_draw_face(s, t, micro, local, end, middle, SB_CUT_SKIN, none);
    if (end == edge)
        sbi_draw_add_of(s, t, t->parted.piece_of[point], at, crossing, hub, SB_CUT_SKIN);
    else
        sbi_draw_add_of(s, t, t->parted.piece_of[point], crossing, at, hub, SB_CUT_SKIN);
}

/* A triangle of the lattice on the skin: whole where no link of it is cut, else as its flags about the face's point. */
static void sbi_draw_skin_micro(sb_cut_surface *s, const sbi_draw_tet *t, int micro, int x)
{
    const sbi_lattice *lattice = t->parted.lattice;
    const unsigned char *corners = lattice->micros[micro];
    const sb_vec3 none = {0, 0, 0};
    sbi_micro_points points;
    sb_real middle[4];
    int local[3], cut = 0;
    sbi_draw_micro_face(s, x, local);
    for (int k = 0; k < 3; k++)
        cut |= t->parted.cut[lattice->micro_links[micro][s->edge_of[local[k]][local[(k + 1) % 3]]]];
    if (!cut) {
        if (sbi_draw_is_lost(t, corners[local[0]]))
            return;
        sbi_draw_add_of(s, t, t->parted.piece_of[corners[local[0]]], sbi_draw_point(s, t, corners[local[0]]),
                        sbi_draw_point(s, t, corners[local[1]]), sbi_draw_point(s, t, corners[local[2]]), SB_CUT_SKIN);
        return;
    }
    for (int a = 0; a < 4; a++)
        middle[a] = (sb_real)(lattice->points[corners[local[0]]][a] + lattice->points[corners[local[1]]][a] +
                              lattice->points[corners[local[2]]][a]) /
                    (sb_real)(3 * lattice->intervals);
    if (sbi_parted_is_split(&t->parted, micro)) {
        sbi_parted_points(&t->parted, micro, 0, &points);
        memcpy(middle, points.tet[SBI_MICRO_FACES + sbi_draw_opposite[x]], sizeof middle);
    }
    for (int k = 0; k < 3; k++) {
        int v = local[k], w = local[(k + 1) % 3], link = lattice->micro_links[micro][s->edge_of[v][w]];
        if (t->parted.cut[link]) {
            sbi_draw_skin_half(s, t, micro, local, k, k, link, middle);
            sbi_draw_skin_half(s, t, micro, local, k, (k + 1) % 3, link, middle);
        } else if (!sbi_draw_is_lost(t, corners[v])) {
            int hub = sbi_draw_face(s, t, micro, local, k, middle, SB_CUT_SKIN, none);
            sbi_draw_add_of(s, t, t->parted.piece_of[corners[v]], sbi_draw_point(s, t, corners[v]),
                            sbi_draw_point(s, t, corners[w]), hub, SB_CUT_SKIN);
        }
    }
}

/* A face of the skin whose edges are drawn in links where it meets faces that are cut: triangles about its middle. */
static void sbi_draw_skin_fan(sb_cut_surface *s, const sbi_draw_tet *t, int face)
{
    const sbi_lattice *lattice = t->parted.lattice;
    const int *nodes = s->cut->tets + 4 * (size_t)t->tet;
    int local[SB_MAX_FACE_NODES], m = lattice->intervals, hub, piece;
    sb_real middle[4] = {0, 0, 0, 0};
    sbi_draw_key key;
    sb_element_face(SB_TET4, face, local, NULL);
    for (int k = 0; k < 3; k++)
        middle[local[k]] = (sb_real)1 / 3;
    if (sbi_draw_is_lost(t, local[0]))
        return;
    piece = t->parted.piece_of[local[0]];
    key = sbi_draw_key_make(SBI_DRAW_MIDDLE, t->tet, face, 0, 0, sbi_draw_node(s, t, piece, middle));
    hub = sbi_draw_vertex_of(s, t, piece, key, middle, sb_v3(0, 0, 0));
    for (int k = 0; k < 3; k++) {
        int v = local[k], w = local[(k + 1) % 3], from = sbi_draw_point(s, t, v);
        sbi_draw_key edge = sbi_draw_edge_key(nodes[v], nodes[w]);
        int parts = sbi_draw_find(&s->edges, &edge) >= 0 ? m : 1;
        for (int i = 1; i <= parts; i++) {
            int weights[4] = {0, 0, 0, 0}, to;
            weights[w] = i * m / parts;
            weights[v] = m - weights[w];
            to = sbi_draw_point(s, t, lattice->lookup[weights[1]][weights[2]][weights[3]]);
            sbi_draw_add_of(s, t, piece, from, to, hub, SB_CUT_SKIN);
            from = to;
        }
    }
}

static void sbi_draw_skin(sb_cut_surface *s, const sbi_draw_tet *t)
{
    const sbi_lattice *lattice = t->parted.lattice;
    for (int face = 0; face < 4; face++) {
        int number = s->face_of[4 * (size_t)t->tet + (size_t)face];
        if (number < 0 || s->face_states[number] == SBI_DRAW_WHOLE)
            continue;
        if (s->face_states[number] == SBI_DRAW_FAN)
            sbi_draw_skin_fan(s, t, face);
        for (int micro = 0; micro < lattice->micro_count && s->face_states[number] == SBI_DRAW_SPLIT; micro++)
            for (int x = 0; x < 4; x++) {
                int on = 0;
                for (int v = 0; v < 4; v++)
                    on += v != x && (lattice->face_points[face] >> lattice->micros[micro][v] & 1);
                if (on == 3)
                    sbi_draw_skin_micro(s, t, micro, x);
            }
    }
}

/* Points of a micro-tet and the vertices of its lips that have been found, -1: not yet: several triangles have each. */
typedef struct sbi_draw_micro {
    int micro;
    sbi_micro_points points;
    int links[6][2]; /* on the side of the first corner and the last */
    int faces[4][4]; /* of the face without a corner, on the side of another */
    int centres[4];  /* on the side of a corner */
} sbi_draw_micro;

/* The corners of a lip's triangle on the side of corner v, from w, beside the face without corner x; its normal at
 * rest. */
static void sbi_draw_lip_side(sb_cut_surface *s, const sbi_draw_tet *t, sbi_draw_micro *m, int v, int w, int x,
                              sb_vec3 normal, int vertices[3])
{
    const sbi_lattice *lattice = t->parted.lattice;
    const unsigned char *corners = lattice->micros[m->micro];
    int edge = s->edge_of[v][w], local[3], k = 0;
    int *link = &m->links[edge][v > w], *face = &m->faces[x][v], *centre = &m->centres[v];
    sbi_draw_micro_face(s, x, local);
    while (local[k] != v)
        k++;
    if (*link < 0)
        *link = sbi_draw_link(s, t, lattice->micro_links[m->micro][edge], corners[v], SB_CUT_LIP, normal);
    if (*face < 0)
        *face = sbi_draw_face(s, t, m->micro, local, k, m->points.tet[SBI_MICRO_FACES + sbi_draw_opposite[x]],
                              SB_CUT_LIP, normal);
    if (*centre < 0)
        *centre =
            sbi_draw_centre(s, t, m->micro, t->parted.piece_of[corners[v]], m->points.tet[SBI_MICRO_CENTRE], normal);
    vertices[0] = *link;
    vertices[1] = *face;
    vertices[2] = *centre;
}

/* The triangle between v and w of a micro-tet beside the face without corner x, on the side of each. turned: link, face
 * and centre go round v the other way than out of it. */
static void sbi_draw_lip(sb_cut_surface *s, const sbi_draw_tet *t, sbi_draw_micro *m, int v, int w, int x, int turned)
{
    const sbi_lattice *lattice = t->parted.lattice;
    const unsigned char *corners = lattice->micros[m->micro];
    int link = lattice->micro_links[m->micro][s->edge_of[v][w]], tag;
    sb_vec3 rest[3], nodes[4], normal;
    for (int a = 0; a < 4; a++)
        nodes[a] = s->cut->body->reference[s->cut->tets[4 * (size_t)t->tet + (size_t)a]];
    rest[0] = sbi_lattice_place(&t->parted.order, m->points.tet[s->edge_of[v][w]], nodes);
    rest[1] = sbi_lattice_place(&t->parted.order, m->points.tet[SBI_MICRO_FACES + sbi_draw_opposite[x]], nodes);
    rest[2] = sbi_lattice_place(&t->parted.order, m->points.tet[SBI_MICRO_CENTRE], nodes);
    normal = sb_v3_cross(sb_v3_sub(rest[1], rest[0]), sb_v3_sub(rest[2], rest[0]));
    tag = s->cut->links.items[t->parted.rank[link]].charred ? SB_CUT_CHAR : SB_CUT_LIP;
    for (int side = 0; side < 2; side++) {
        int corner = side ? w : v, piece, at[3];
        if (sbi_draw_is_lost(t, corners[corner]))
            continue;
        sbi_draw_lip_side(s, t, m, corner, side ? v : w, x, normal, at);
        piece = t->parted.piece_of[corners[corner]];
        if (side == turned)
            sbi_draw_add_of(s, t, piece, at[0], at[1], at[2], tag);
        else
            sbi_draw_add_of(s, t, piece, at[0], at[2], at[1], tag);
    }
}

static void sbi_draw_lips(sb_cut_surface *s, const sbi_draw_tet *t)
{
    const sbi_lattice *lattice = t->parted.lattice;
    int has_lips = t->parted.piece_count > 1 || t->parted.lost;
    for (int micro = 0; micro < lattice->micro_count && has_lips; micro++) {
        const unsigned char *corners = lattice->micros[micro];
        sbi_draw_micro m;
        if (!sbi_parted_is_split(&t->parted, micro))
            continue;
        m.micro = micro;
        memset(m.links, -1, sizeof m.links);
        memset(m.faces, -1, sizeof m.faces);
        memset(m.centres, -1, sizeof m.centres);
        sbi_parted_points(&t->parted, micro, 0, &m.points);
        for (int v = 0; v < 4; v++)
            for (int w = v + 1; w < 4; w++) {
                int u = v == 0 ? (w == 1 ? 2 : 1) : 0, x = 6 - v - w - u;
                int odd = (v > u) + (w > u) + (v > x) + (w > x) + (u > x); /* of the order v, w, u, x */
                if (t->parted.piece_of[corners[v]] == t->parted.piece_of[corners[w]])
                    continue;
                sbi_draw_lip(s, t, &m, v, w, x, odd & 1);
                sbi_draw_lip(s, t, &m, v, w, u, !(odd & 1));
            }
    }
}

/* ---- all of it ---- */

/* Room for what is known of all links, and of what is known of those that were drawn. */
static int sbi_draw_reserve_links(sb_cut_surface *s)
{
    int had = sbi_max_int(s->kept_count, 0), more = sbi_max_int(s->cut->links.count - had, 0);
    void *merged = s->merged, *kept = s->kept;
    int grown = sbi_cut_grow(&s->allocator, &merged, &s->merged_capacity, had, more, 1) &&
                sbi_cut_grow(&s->allocator, &kept, &s->kept_capacity, had, more, sizeof *s->kept);
    s->merged = (unsigned char *)merged;
    s->kept = (sbi_draw_kept *)kept;
    return grown;
}

/* Room for so many triangles to be kept; 0: no memory. */
static int sbi_draw_size_old(sb_cut_surface *s, int count)
{
    void *triangles = s->old_triangles, *tags = s->old_tags, *cells = s->old_cells;
    int *capacity = s->old_capacity;
    int grown = sbi_cut_grow(&s->allocator, &triangles, capacity, 0, count, sizeof *s->old_triangles) &&
                sbi_cut_grow(&s->allocator, &tags, capacity + 1, 0, count, 1) &&
                sbi_cut_grow(&s->allocator, &cells, capacity + 2, 0, count, sizeof(int));
    s->old_triangles = (int(*)[3])triangles;
    s->old_tags = (unsigned char *)tags;
    s->old_cells = (int *)cells;
    return grown;
}

/* Keeps the triangles as they are while others are written over them; 0: no memory. */
static int sbi_draw_keep_triangles(sb_cut_surface *s)
{
    size_t n = (size_t)s->triangles_before;
    if (!sbi_draw_size_old(s, s->triangles_before))
        return 0;
    if (n == 0)
        return 1;
    memcpy(s->old_triangles, s->triangles, n * sizeof *s->triangles);
    memcpy(s->old_tags, s->tags, n);
    memcpy(s->old_cells, s->cells, n * sizeof *s->cells);
    return 1;
}

/* Whether the links that were drawn are still there, whatever has become of them and of others. */
static int sbi_draw_links_stay(const sb_cut_surface *s)
{
    if (s->kept_count < 0 || s->kept_count > s->cut->links.count)
        return 0;
    for (int i = 0; i < s->kept_count; i++)
        if (memcmp(s->kept[i].key.at, s->cut->links.items[i].key.at, sizeof s->kept[i].key.at) != 0)
            return 0;
    return 1;
}

/* All is to be drawn anew. */
static void sbi_draw_forget(sb_cut_surface *s)
{
    sbi_draw_clear_table(&s->joins);
    sbi_draw_clear_table(&s->edges);
    memset(s->face_states, 0, (size_t)s->face_count);
    memset(s->tet_marks, 0, (size_t)s->cut->tet_count);
    s->kept_count = s->fanned = 0;
}

/* 1 when triangles [first, end) of an element that has not changed can stay: the vertices that nobody has drawn yet are
 * its own. They are drawn then. */
static int sbi_draw_claim(sb_cut_surface *s, int (*triangles)[3], int first, int end, int tet)
{
    for (int f = first; f < end; f++)
        for (int k = 0; k < 3; k++) {
            const sbi_draw_vertex *vertex = s->vertices + triangles[f][k];
            if (vertex->stamp != s->stamp && vertex->origin.element != tet)
                return 0;
        }
    for (int f = first; f < end; f++)
        for (int k = 0; k < 3; k++)
            s->vertices[triangles[f][k]].stamp = s->stamp;
    return 1;
}

/* Takes an element's triangles as they were, if they can stay. */
static int sbi_draw_replay(sb_cut_surface *s, int tet)
{
    sbi_draw_drawn *drawn = s->drawn + tet;
    int first = drawn->first, end = first + drawn->count;
    if (!sbi_draw_claim(s, s->old_triangles, first, end, tet))
        return 0;
    drawn->first = s->triangle_count;
    for (int f = first; f < end; f++) {
        const int *v = s->old_triangles[f];
        sbi_draw_add_triangle(s, v[0], v[1], v[2], s->old_tags[f], s->old_cells[f]);
    }
    return 1;
}

static void sbi_draw_tet_anew(sb_cut_surface *s, const sbi_draw_tet *t, uint64_t sides)
{
    sbi_draw_drawn *drawn = s->drawn + t->tet;
    drawn->first = s->triangle_count;
    sbi_draw_skin(s, t);
    sbi_draw_lips(s, t);
    drawn->count = s->triangle_count - drawn->first;
    drawn->cells = sbi_draw_hash_cells(s, t->tet);
    drawn->sides = sides;
}

/* Draws a listed element, or takes it as it was drawn. */
static void sbi_draw_listed(sb_cut_surface *s, int tet)
{
    int marks = s->tet_marks[tet];
    uint64_t sides;
    sbi_draw_tet t;
    s->tet_marks[tet] = SBI_DRAW_LISTED;
    if (marks == SBI_DRAW_LISTED && sbi_draw_replay(s, tet))
        return;
    sbi_draw_load_tet(s, tet, &t);
    sides = sbi_draw_hash_sides(s, &t);
    if ((marks & SBI_DRAW_CHANGED) || s->drawn[tet].sides != sides || !sbi_draw_replay(s, tet))
        sbi_draw_tet_anew(s, &t, sides);
}

/* 1 when a whole face of an element without cuts is drawn as it is now. */
static int sbi_draw_is_same(const sb_cut_surface *s, int f, int tet, const int *local)
{
    int cell = s->cut->pieces[tet].cell, same = s->cut->pieces[tet].points != 0 && cell >= 0 && s->cells[f] == cell;
    for (int k = 0; k < 3 && same; k++)
        same = sb_body_cell_nodes(s->cut->body, cell)[local[k]] == s->names.keys[s->triangles[f][k]].at[5];
    return same;
}

/* The faces of the skin that are one triangle each; others have none there. */
static void sbi_draw_whole_faces(sb_cut_surface *s)
{
    sbi_draw_tet t;
    for (int f = 0; f < s->face_count; f++) {
        int tet = s->faces[f] / 4, face = s->faces[f] % 4, local[SB_MAX_FACE_NODES], v[3];
        if (s->face_states[f] != SBI_DRAW_WHOLE) {
            sbi_draw_set_triangle(s, f, 0, 0, 0, SB_CUT_SKIN, -1);
            continue;
        }
        sb_element_face(SB_TET4, face, local, NULL);
        if (s->triangles_before > f && !s->tet_marks[tet] && sbi_draw_is_same(s, f, tet, local))
            continue;
        if (s->tet_marks[tet] && !(s->tet_marks[tet] & SBI_DRAW_CHANGED) && s->cells[f] >= 0 &&
            sbi_draw_claim(s, s->triangles, f, f + 1, tet))
            continue;
        sbi_draw_load_tet(s, tet, &t);
        if (sbi_draw_is_lost(&t, local[0])) {
            sbi_draw_set_triangle(s, f, 0, 0, 0, SB_CUT_SKIN, -1);
            continue;
        }
        for (int k = 0; k < 3; k++)
            v[k] = sbi_draw_point(s, &t, local[k]);
        sbi_draw_set_triangle(s, f, v[0], v[1], v[2], SB_CUT_SKIN,
                              sbi_draw_cell_of(s, &t, t.parted.piece_of[local[0]], v));
    }
}

/* Lists the elements that are drawn by pieces, and marks those that have changed, and those beside them. */
static void sbi_draw_mark(sb_cut_surface *s)
{
    if (!sbi_draw_links_stay(s))
        sbi_draw_forget(s);
    sbi_draw_mark_links(s);
    sbi_draw_list_tets(s);
    sbi_draw_mark_cells(s);
    sbi_draw_mark_beside(s);
}

/* Sides, faces and edges of what is marked. */
static void sbi_draw_find_all(sb_cut_surface *s)
{
    sbi_draw_tet t;
    for (int i = 0; i < s->tets.count; i++)
        if (s->tet_marks[s->tets.items[i]] & SBI_DRAW_CHANGED) {
            sbi_draw_load_tet(s, s->tets.items[i], &t);
            sbi_draw_clear_sides(s, &t);
        }
    for (int i = 0; i < s->tets.count; i++)
        if (s->tet_marks[s->tets.items[i]] != SBI_DRAW_LISTED) {
            sbi_draw_load_tet(s, s->tets.items[i], &t);
            sbi_draw_find_sides(s, &t);
            sbi_draw_split_faces(s, &t);
        }
    sbi_draw_find_fans(s);
}

static int sbi_draw_reserve_stand_ins(sb_cut_surface *s)
{
    void *stand_ins = s->stand_ins;
    int grown = sbi_cut_grow(&s->allocator, &stand_ins, &s->stand_in_capacity, 0, sb_body_node_count(s->cut->body),
                             sizeof *s->stand_ins);
    s->stand_ins = (int *)stand_ins;
    return grown;
}

/* Nodes of a film that have no material stand in the nodes of what it lies on. */
static void sbi_draw_stand_in(sb_cut_surface *s, const sbi_draw_tet *t, int piece)
{
    const sb_body *body = s->cut->body;
    const int *film = sb_body_cell_nodes(body, t->cells[piece]), *under = sb_body_cell_nodes(body, t->carriers[piece]);
    for (int a = 0; a < s->cut->nodes_per_tet; a++)
        if (body->node_component[film[a]] < 0 && s->stand_ins[film[a]] == film[a])
            s->stand_ins[film[a]] = under[a];
}

/* One place for each node, of the first element that has one: so both sides of a film are drawn at the same, with no
 * volume between them, across a gap as well. */
static void sbi_draw_find_stand_ins(sb_cut_surface *s)
{
    const sb_cut *cut = s->cut;
    for (int i = 0; i < sb_body_node_count(cut->body); i++)
        s->stand_ins[i] = i;
    for (int i = 0; i < s->tets.count; i++) {
        int tet = s->tets.items[i], films = 0;
        sbi_draw_tet t;
        for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next)
            films += !(sb_body_cell_share(cut->body, cut->pieces[piece].cell) > 0);
        if (!films)
            continue;
        sbi_draw_load_tet(s, tet, &t);
        for (int piece = 0; piece < t.parted.piece_count; piece++)
            if (t.carriers[piece] != t.cells[piece])
                sbi_draw_stand_in(s, &t, piece);
    }
}

/* Brings the triangles up to date; 0: no memory. */
static int sbi_draw_rebuild(sb_cut_surface *s)
{
    s->failed = 0;
    s->stamp++;
    if (!sbi_draw_keep_triangles(s) || !sbi_draw_reserve_links(s) || !sbi_draw_reserve_stand_ins(s))
        return 0;
    sbi_draw_mark(s);
    sbi_draw_find_all(s);
    sbi_draw_list_tets(s);
    sbi_draw_find_stand_ins(s);
    sbi_draw_whole_faces(s);
    s->triangle_count = s->face_count;
    for (int i = 0; i < s->tets.count && !s->failed; i++)
        sbi_draw_listed(s, s->tets.items[i]);
    if (s->names.count == 0) /* nothing is left, nor was drawn before: no vertex that unused triangles could name */
        s->triangle_count = 0;
    if (s->triangle_count < s->triangles_before) {
        s->first_triangle = sbi_min_int(s->first_triangle, s->triangle_count);
        s->triangle_end = sbi_max_int(s->triangle_end, s->triangle_count);
    }
    return !s->failed;
}

/* Vertices that are not used any more; those of whole faces far from cuts are, though nobody asked for them. */
static void sbi_draw_find_unused(sb_cut_surface *s)
{
    for (int f = 0; f < s->face_count; f++)
        for (int k = 0; k < 3 && s->face_states[f] == SBI_DRAW_WHOLE && s->cells[f] >= 0; k++)
            s->vertices[s->triangles[f][k]].stamp = s->stamp;
    for (int i = 0; i < s->names.count; i++)
        s->origins[i].element = s->vertices[i].stamp == s->stamp ? s->vertices[i].origin.element : -1;
}

static void sbi_draw_move(sb_cut_surface *s)
{
    const sb_vec3 *x = sb_body_positions(s->cut->body);
    int n = s->cut->nodes_per_tet;
    for (int i = 0; i < s->names.count; i++) {
        const sbi_draw_vertex *vertex = s->vertices + i;
        sb_real shape[SBI_CUT_NODES];
        const sb_real *weights = n == 4 ? vertex->origin.weights : shape;
        sb_vec3 sum = sb_v3(0, 0, 0);
        s->normals[i] = sum;
        if (s->origins[i].element < 0)
            continue;
        if (n > 4)
            sb_element_shape(SB_TET10, vertex->origin.weights + 1, shape, NULL);
        for (int a = 0; a < n; a++)
            if (weights[a] != 0)
                sum = sb_v3_madd(sum, weights[a], x[s->stand_ins[vertex->cell_nodes[a]]]);
        s->positions[i] = sum;
    }
    for (int f = 0; f < s->triangle_count; f++) {
        const int *v = s->triangles[f];
        sb_vec3 normal = sb_v3_cross(sb_v3_sub(s->positions[v[1]], s->positions[v[0]]),
                                     sb_v3_sub(s->positions[v[2]], s->positions[v[0]]));
        for (int k = 0; k < 3; k++)
            s->normals[v[k]] = sb_v3_add(s->normals[v[k]], normal);
    }
    for (int i = 0; i < s->names.count; i++) {
        sb_real size = sb_v3_norm(s->normals[i]);
        if (size > 0)
            s->normals[i] = sb_v3_scale(1 / size, s->normals[i]);
    }
}

static sb_result sbi_draw_check(const sb_cut *cut, sb_error *error)
{
    if (!cut->body)
        return sbi_fail(error, SB_ERROR_STATE, "the body is gone");
    if (cut->stale)
        return sbi_fail(error, SB_ERROR_STATE, "the body's mesh was changed by others: make a new sb_cut");
    return SB_OK;
}

/* Triangles as the body is cut now. Adds to what was made since the last update where that has not been named yet. */
static sb_result sbi_draw_refresh(sb_cut_surface *s, sb_error *error)
{
    sb_result result = sbi_draw_check(s->cut, error);
    if (result != SB_OK)
        return result;
    if (!s->pending) {
        s->first_vertex = s->names.count;
        s->first_triangle = s->triangle_count;
        s->triangle_end = 0;
    }
    if (s->version != sb_body_mesh_version(s->cut->body)) {
        int made = sbi_draw_rebuild(s);
        s->version = made ? sb_body_mesh_version(s->cut->body) : -1;
        sbi_draw_find_unused(s);
        s->triangles_before = made ? s->triangle_count : 0;
        s->kept_count = made ? s->kept_count : -1;
        result = made ? SB_OK : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the surface of a cut");
    }
    s->triangle_end = sbi_max_int(s->triangle_end, s->first_triangle);
    sbi_draw_move(s);
    return result;
}

SB_API sb_result sb_cut_surface_update(sb_cut_surface *s, sb_error *error)
{
    sb_result result;
    if (!s)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_cut_surface_update needs a surface");
    result = sbi_draw_refresh(s, error);
    s->pending = s->pending && result == SB_ERROR_STATE; /* else it has been named */
    return result;
}

/* ---- as a skin ---- */

static sb_result sbi_draw_update_skin(struct sb_skin *skin, const sb_body *body, sb_error *error)
{
    sb_cut_surface *s = (sb_cut_surface *)skin->user;
    sb_result result;
    if (s->cut->body && s->cut->body != body)
        return sbi_fail(error, SB_ERROR_STATE, "the skin is the surface of a cut of another body");
    result = sbi_draw_refresh(s, error);
    s->pending |= result != SB_ERROR_STATE;
    skin->point_count = s->names.count;
    skin->face_count = s->triangle_count;
    skin->triangles = (const int(*)[3])s->triangles;
    return result;
}

static void sbi_draw_get_point(const struct sb_skin *skin, int point, sbi_skin_point *at)
{
    const sb_cut_surface *s = (const sb_cut_surface *)skin->user;
    const sbi_draw_vertex *vertex = s->vertices + point;
    memset(at, 0, sizeof *at);
    at->cell = s->origins[point].element < 0 ? -1 : vertex->cell;
    for (int k = 0; k < 3; k++)
        at->xi[k] = vertex->origin.weights[k + 1];
}

/* Numbers are in the order in which cuts came; what vertices are named by is saved with the cut. */
static uint64_t sbi_draw_get_name(const struct sb_skin *skin, int point)
{
    const sb_cut_surface *s = (const sb_cut_surface *)skin->user;
    uint64_t name = 0;
    for (int i = 0; i < SBI_DRAW_KEY; i++)
        name = sbi_hash_word(name, (uint64_t)(uint32_t)s->names.keys[point].at[i]);
    return name;
}

SBI_API struct sb_skin *sbi_cut_surface_get_skin(sb_cut_surface *s) { return &s->skin; }

SBI_API void sbi_cut_surface_forget(sb_cut_surface *s) { s->kept_count = -1; }

/* ---- creation ---- */

/* Triangles of the lips of a cut half through a body as thick as it is wide: the beam of bench_cut has 0.9 times as
 * many with 2 intervals. */
static int sbi_draw_lips_of_a_cut(const sb_cut *cut)
{
    const double across = cbrt((double)cut->tet_count), m = cut->lattice.intervals;
    const double lips = 4 * m * m * across * across;
    return lips < INT32_MAX / 64 ? (int)lips : 0;
}

/* Room for what such a cut draws, so that frames do not wait for it; 0: no memory. */
static int sbi_draw_reserve(sb_cut_surface *s)
{
    int vertices = 1024;
    while (vertices < s->triangle_capacity / 2)
        vertices *= 2;
    if (!sbi_draw_size_table(&s->allocator, &s->names, vertices) || !sbi_draw_size_vertices(s, vertices) ||
        !sbi_draw_size_old(s, s->triangle_capacity))
        return 0;
    memset(s->triangles, 0, (size_t)s->triangle_capacity * sizeof *s->triangles);
    memset(s->old_triangles, 0, (size_t)s->triangle_capacity * sizeof *s->triangles);
    return 1;
}

/* The faces of the skin, and tables of local numbers. */
static int sbi_draw_take_skin(sb_cut_surface *s)
{
    const sb_cut *cut = s->cut;
    size_t sides = 4 * (size_t)cut->tet_count;
    void *triangles = NULL, *tags = NULL, *cells = NULL;
    int capacity[3] = {0, 0, 0}, taken, room;
    for (int face = 0; face < 4; face++) {
        int local[SB_MAX_FACE_NODES], missing = 6;
        sb_element_face(SB_TET4, face, local, NULL);
        for (int k = 0; k < 3; k++)
            missing -= local[k];
        for (int k = 0; k < 3; k++)
            s->beside[missing][k] = (signed char)local[k];
    }
    for (int edge = 0; edge < 6; edge++) {
        int ends[3];
        sb_element_edge(SB_TET4, edge, ends);
        s->edge_of[ends[0]][ends[1]] = s->edge_of[ends[1]][ends[0]] = (signed char)edge;
    }
    for (size_t i = 0; i < sides; i++)
        s->face_count += cut->neighbours.items[i] < 0;
    room = s->face_count + sbi_draw_lips_of_a_cut(cut);
    s->faces = (int *)sbi_alloc(&s->allocator, (size_t)s->face_count, sizeof(int));
    s->face_of = (int *)sbi_alloc(&s->allocator, sides, sizeof(int));
    s->face_states = (unsigned char *)sbi_alloc_zeroed(&s->allocator, (size_t)s->face_count, 1);
    s->tet_marks = (unsigned char *)sbi_alloc_zeroed(&s->allocator, (size_t)cut->tet_count, 1);
    s->drawn = (sbi_draw_drawn *)sbi_alloc_zeroed(&s->allocator, (size_t)cut->tet_count, sizeof *s->drawn);
    s->tets.items = (int *)sbi_alloc(&s->allocator, (size_t)cut->tet_count, sizeof(int));
    taken = s->faces && s->face_of && s->face_states && s->tet_marks && s->drawn && s->tets.items &&
            sbi_cut_grow(&s->allocator, &triangles, capacity, 0, room, sizeof *s->triangles) &&
            sbi_cut_grow(&s->allocator, &tags, capacity + 1, 0, room, 1) &&
            sbi_cut_grow(&s->allocator, &cells, capacity + 2, 0, room, sizeof(int));
    s->triangles = (int(*)[3])triangles;
    s->tags = (unsigned char *)tags;
    s->cells = (int *)cells;
    if (!taken)
        return 0;
    s->triangle_capacity = capacity[0];
    s->face_count = 0;
    for (size_t i = 0; i < sides; i++) {
        s->face_of[i] = cut->neighbours.items[i] < 0 ? s->face_count : -1;
        if (cut->neighbours.items[i] < 0)
            s->faces[s->face_count++] = (int)i;
    }
    return 1;
}

SB_API sb_result sb_cut_surface_create(sb_cut *cut, const sb_allocator *allocator, sb_cut_surface **surface,
                                       sb_error *error)
{
    sb_cut_surface *made;
    sb_result result;
    if (!cut || !surface)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_cut_surface_create needs a cut and a place for the surface");
    result = sbi_draw_check(cut, error);
    if (result != SB_OK)
        return result;
    made = (sb_cut_surface *)sbi_alloc_zeroed(allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the surface of a cut");
    made->cut = cut;
    if (allocator)
        made->allocator = *allocator;
    made->version = -1;
    made->skin.user = made;
    made->skin.is_late = 1;
    made->skin.update = sbi_draw_update_skin;
    made->skin.get_point = sbi_draw_get_point;
    made->skin.get_name = sbi_draw_get_name;
    result = sbi_draw_take_skin(made) && sbi_draw_reserve(made)
                 ? sb_cut_surface_update(made, error)
                 : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the surface of a cut");
    if (result != SB_OK) {
        sb_cut_surface_destroy(made);
        return result;
    }
    *surface = made;
    return SB_OK;
}

SB_API void sb_cut_surface_destroy(sb_cut_surface *s)
{
    sb_allocator allocator;
    if (!s)
        return;
    allocator = s->allocator;
    sbi_draw_free_table(&allocator, &s->joins);
    sbi_draw_free_table(&allocator, &s->edges);
    sbi_draw_free_table(&allocator, &s->names);
    sbi_free(&allocator, s->faces);
    sbi_free(&allocator, s->face_of);
    sbi_free(&allocator, s->face_states);
    sbi_free(&allocator, s->tet_marks);
    sbi_free(&allocator, s->tets.items);
    sbi_free(&allocator, s->merged);
    sbi_free(&allocator, s->drawn);
    sbi_free(&allocator, s->kept);
    sbi_free(&allocator, s->old_triangles);
    sbi_free(&allocator, s->old_tags);
    sbi_free(&allocator, s->old_cells);
    sbi_free(&allocator, s->vertices);
    sbi_free(&allocator, s->origins);
    sbi_free(&allocator, s->positions);
    sbi_free(&allocator, s->normals);
    sbi_free(&allocator, s->rest);
    sbi_free(&allocator, s->texture);
    sbi_free(&allocator, s->points);
    sbi_free(&allocator, s->stand_ins);
    sbi_free(&allocator, s->triangles);
    sbi_free(&allocator, s->tags);
    sbi_free(&allocator, s->cells);
    sbi_free(&allocator, s->axes);
    sbi_free(&allocator, s);
}

SB_API sb_cut_drawing sb_cut_surface_get(const sb_cut_surface *s)
{
    sb_cut_drawing drawing;
    memset(&drawing, 0, sizeof drawing);
    if (!s)
        return drawing;
    drawing.vertex_count = s->names.count;
    drawing.triangle_count = s->triangle_count;
    drawing.positions = s->positions;
    drawing.normals = s->normals;
    drawing.rest = s->rest;
    drawing.texture = (const sb_real(*)[2])s->texture;
    drawing.origins = s->origins;
    drawing.points = s->points;
    drawing.triangles = (const int(*)[3])s->triangles;
    drawing.tags = s->tags;
    drawing.cells = s->cells;
    drawing.first_triangle = s->first_triangle;
    drawing.triangle_end = s->triangle_end;
    drawing.first_vertex = s->first_vertex;
    return drawing;
}
