/* meshio_split: volume cells of several kinds, or of kinds that are no elements of ours, cut into tets.
 *
 *        3-----2          A cell is cut by pulling its corner v of the lowest number: the faces without v are cut into
 *       /|    /|          triangles, a quadrilateral along the diagonal from its lowest corner, and each triangle makes
 *      7-----6 |          a tet with v. The faces with v are cut by v's diagonals, so every quadrilateral is cut from
 *      | v---|-1          its lowest corner whichever cell looks at it: the tets of neighbours fit. A pyramid gives 2
 *      |/    |/           tets, a wedge 3, a hexahedron 6. (Dompierre, Labbe, Vallet, Camarero: How to subdivide
 *      4-----5            pyramids, prisms and hexahedra into tetrahedra, 1999, with the pulling of De Loera et al.)
 *
 * Quadratic cells become tet10: their mid-edge nodes stay, diagonals get the node in the middle of the face or cell
 * where there is one, and else a new one on the cell's own (serendipity) surface, shared by both sides. */
#include "meshio_reader.h"

#include <limits.h>
#include <string.h>

/* Corners, faces and edges in VTK's order. The node in the middle of edge i is number corners + i, and that of face i,
 * when the cell has it, number corners + edges + i; only the first `quads` faces have four corners. */
typedef struct sbi_split_shape {
    int corners, edges, faces, quads;
    signed char face[6][4];
    signed char edge[12][2];
} sbi_split_shape;

static const sbi_split_shape *sbi_split_shape_of(sbi_cell_shape shape)
{
    static const sbi_split_shape shapes[5] = {
        {0, 0, 0, 0, {{0}}, {{0}}},
        {4,
         6,
         4,
         0,
         {{0, 2, 1, -1}, {0, 1, 3, -1}, {1, 2, 3, -1}, {2, 0, 3, -1}},
         {{0, 1}, {1, 2}, {2, 0}, {0, 3}, {1, 3}, {2, 3}}},
        {5,
         8,
         5,
         1,
         {{0, 3, 2, 1}, {0, 1, 4, -1}, {1, 2, 4, -1}, {2, 3, 4, -1}, {3, 0, 4, -1}},
         {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {0, 4}, {1, 4}, {2, 4}, {3, 4}}},
        {6,
         9,
         5,
         3,
         {{0, 1, 4, 3}, {1, 2, 5, 4}, {2, 0, 3, 5}, {0, 2, 1, -1}, {3, 4, 5, -1}},
         {{0, 1}, {1, 2}, {2, 0}, {3, 4}, {4, 5}, {5, 3}, {0, 3}, {1, 4}, {2, 5}}},
        {8,
         12,
         6,
         6,
         {{0, 4, 7, 3}, {1, 2, 6, 5}, {0, 1, 5, 4}, {2, 3, 7, 6}, {0, 3, 2, 1}, {4, 5, 6, 7}},
         {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {4, 5}, {5, 6}, {6, 7}, {7, 4}, {0, 4}, {1, 5}, {2, 6}, {3, 7}}}};
    return &shapes[shape];
}

/* An edge that no cell has: a diagonal of a face or of a hexahedron, in one place of one tet. */
typedef struct sbi_split_diagonal {
    int low, high; /* corner nodes */
    int node;      /* in its middle; -1: to be made, at: */
    sb_vec3 middle;
    size_t place; /* in mesh->elements */
} sbi_split_diagonal;

typedef struct sbi_split {
    sbi_loader *loader;
    int *elements; /* of the mesh */
    int width;     /* 4 or 10 */
    size_t tet_count;
    unsigned char mirrored[SBI_CELL_KINDS]; /* all cells of the kind are inside out: a convention of the file */
    sbi_split_diagonal *diagonals;
    size_t diagonal_count, diagonal_capacity;
} sbi_split;

SBI_API int sbi_split_first_corner(const int *corners, int count)
{
    int first = 0;
    for (int i = 1; i < count; i++)
        if (corners[i] < corners[first])
            first = i;
    return first;
}

SBI_API int sbi_split_wanted(const sbi_loader *loader, sb_element_type *type)
{
    int linear = 0, quadratic = 0, mixed = 0;
    sb_element_type only = SB_NO_ELEMENT;
    for (int kind = 0; kind < SBI_CELL_KINDS; kind++) {
        const sbi_cell_kind *about = sbi_cell_kind_at(kind);
        if (!loader->kind_count[kind] || about->dimension != 3)
            continue;
        if (about->shape == SBI_SHAPE_NONE)
            return 0;
        if (about->nodes == sbi_split_shape_of(about->shape)->corners)
            linear = 1;
        else
            quadratic = 1;
        mixed |= about->type == SB_NO_ELEMENT || (only != SB_NO_ELEMENT && only != about->type);
        only = about->type;
    }
    if (!mixed || (linear && quadratic))
        return 0;
    *type = linear ? SB_TET4 : SB_TET10;
    return 1;
}

/* ---- one cell ---- */

/* The tets of a cell as its corners 0, 1, ..., positive when the cell is; returns how many. */
static int sbi_split_tets(const sbi_split_shape *shape, const int *nodes, signed char tets[6][4])
{
    int apex = sbi_split_first_corner(nodes, shape->corners), count = 0;
    for (int f = 0; f < shape->faces; f++) {
        const signed char *face = shape->face[f];
        int corners = f < shape->quads ? 4 : 3, touches = 0, numbers[4], first;
        for (int i = 0; i < corners; i++) {
            touches |= face[i] == apex;
            numbers[i] = nodes[face[i]];
        }
        if (touches)
            continue;
        first = corners == 4 ? sbi_split_first_corner(numbers, 4) : 0;
        for (int part = 0; part < corners - 2; part++) {
            signed char *tet = tets[count++]; /* seen from the apex, the face goes round the other way */
            tet[0] = face[first];
            tet[1] = face[(first + part + 2) % corners];
            tet[2] = face[(first + part + 1) % corners];
            tet[3] = (signed char)apex;
        }
    }
    return count;
}

/* Six times the volume of a cell with straight edges, by its tets. */
static double sbi_split_volume(const sb_vec3 *x, const int *nodes, signed char tets[6][4], int count)
{
    double volume = 0;
    for (int t = 0; t < count; t++) {
        sb_vec3 a = x[nodes[tets[t][0]]], b = x[nodes[tets[t][1]]], c = x[nodes[tets[t][2]]], d = x[nodes[tets[t][3]]];
        volume += (double)sb_v3_dot(sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(c, a)), sb_v3_sub(d, a));
    }
    return volume;
}

/* Local number of the node in the middle of the edge between two corners, or -1. */
static int sbi_split_edge_node(const sbi_split_shape *shape, int a, int b)
{
    for (int i = 0; i < shape->edges; i++)
        if ((shape->edge[i][0] == a && shape->edge[i][1] == b) || (shape->edge[i][0] == b && shape->edge[i][1] == a))
            return shape->corners + i;
    return -1;
}

/* The face of four corners across which a and b lie; -1: they lie across the cell. */
static int sbi_split_face_of(const sbi_split_shape *shape, int a, int b)
{
    for (int f = 0; f < shape->quads; f++) {
        const signed char *face = shape->face[f];
        for (int i = 0; i < 2; i++)
            if ((face[i] == a && face[i + 2] == b) || (face[i] == b && face[i + 2] == a))
                return f;
    }
    return -1;
}

/* The middle of the serendipity face (half the sum of its mid-edge nodes less a quarter of that of its corners) or
 * hexahedron (a quarter of each sum). */
static sb_vec3 sbi_split_middle(const sbi_split_shape *shape, const int *nodes, const sb_vec3 *x, int face)
{
    sb_vec3 corners = sb_v3(0, 0, 0), edges = corners;
    if (face < 0) {
        for (int i = 0; i < shape->corners; i++)
            corners = sb_v3_add(corners, x[nodes[i]]);
        for (int i = 0; i < shape->edges; i++)
            edges = sb_v3_add(edges, x[nodes[shape->corners + i]]);
        return sb_v3_sub(sb_v3_scale((sb_real)0.25, edges), sb_v3_scale((sb_real)0.25, corners));
    }
    for (int i = 0; i < 4; i++) {
        int a = shape->face[face][i], b = shape->face[face][(i + 1) % 4];
        corners = sb_v3_add(corners, x[nodes[a]]);
        edges = sb_v3_add(edges, x[nodes[sbi_split_edge_node(shape, a, b)]]);
    }
    return sb_v3_sub(sb_v3_scale((sb_real)0.5, edges), sb_v3_scale((sb_real)0.25, corners));
}

static sb_result sbi_split_add_diagonal(sbi_split *split, const sbi_cell_kind *about, const int *nodes, int a, int b,
                                        size_t place)
{
    const sbi_split_shape *shape = sbi_split_shape_of(about->shape);
    sbi_loader *loader = split->loader;
    int face = sbi_split_face_of(shape, a, b),
        middle = shape->corners + shape->edges + (face < 0 ? shape->faces : face);
    sbi_split_diagonal *diagonal;
    if (split->diagonal_count >= split->diagonal_capacity) {
        void *grown = sbi_loader_grow(loader, split->diagonals, split->diagonal_count, &split->diagonal_capacity,
                                      split->diagonal_count + 1, sizeof split->diagonals[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        split->diagonals = (sbi_split_diagonal *)grown;
    }
    diagonal = &split->diagonals[split->diagonal_count++];
    diagonal->low = nodes[a] < nodes[b] ? nodes[a] : nodes[b];
    diagonal->high = nodes[a] < nodes[b] ? nodes[b] : nodes[a];
    diagonal->node = middle < about->nodes ? nodes[middle] : -1;
    diagonal->middle = diagonal->node < 0 ? sbi_split_middle(shape, nodes, loader->nodes, face) : sb_v3(0, 0, 0);
    diagonal->place = place;
    return SB_OK;
}

/* Writes the tets of a cell; where the node of a diagonal is to be, that is noted. */
static sb_result sbi_split_cell(sbi_split *split, const sbi_cell *cell, const int *nodes)
{
    const sbi_cell_kind *about = sbi_cell_kind_at(cell->kind);
    const sbi_split_shape *shape = sbi_split_shape_of(about->shape), *tet = sbi_split_shape_of(SBI_SHAPE_TET);
    signed char tets[6][4];
    int count = about->shape == SBI_SHAPE_TET ? 1 : sbi_split_tets(shape, nodes, tets);
    sb_result result = SB_OK;
    for (int k = 0; k < 4 && about->shape == SBI_SHAPE_TET; k++)
        tets[0][k] = (signed char)k;
    for (int t = 0; t < count && !result; t++) {
        int *to = split->elements + split->tet_count++ * (size_t)split->width;
        signed char *own = tets[t], hold = own[0];
        if (split->mirrored[cell->kind]) {
            own[0] = own[1];
            own[1] = hold;
            split->loader->flipped_tets++;
        }
        for (int k = 0; k < 4; k++)
            to[k] = nodes[own[k]];
        for (int k = 0; k < 6 && split->width == 10 && !result; k++) {
            int a = own[tet->edge[k][0]], b = own[tet->edge[k][1]], middle = sbi_split_edge_node(shape, a, b);
            to[4 + k] = middle < 0 ? 0 : nodes[middle];
            if (middle < 0)
                result = sbi_split_add_diagonal(split, about, nodes, a, b, (size_t)(to + 4 + k - split->elements));
        }
    }
    if (about->shape != SBI_SHAPE_TET) {
        split->loader->split_cells++;
        split->loader->split_tets += count;
    }
    return result;
}

/* ---- all cells ---- */

/* Kinds whose cells are all inside out: VTK's own wedge is the mirror image of everybody else's. */
static void sbi_split_find_mirrored(sbi_split *split)
{
    const sbi_loader *loader = split->loader;
    const int *nodes = loader->indices;
    memset(split->mirrored, 1, sizeof split->mirrored);
    for (size_t i = 0; i < loader->cell_count; i++) {
        const sbi_cell_kind *about = sbi_cell_kind_at(loader->cells[i].kind);
        if (about->dimension == 3 && split->mirrored[loader->cells[i].kind]) {
            signed char tets[6][4];
            int count = sbi_split_tets(sbi_split_shape_of(about->shape), nodes, tets);
            if (!(sbi_split_volume(loader->nodes, nodes, tets, count) < 0))
                split->mirrored[loader->cells[i].kind] = 0;
        }
        nodes += about->nodes;
    }
}

static int sbi_split_diagonal_before(const void *context, int a, int b)
{
    const sbi_split_diagonal *d = (const sbi_split_diagonal *)context;
    return d[a].low != d[b].low ? d[a].low < d[b].low : d[a].high < d[b].high;
}

/* One node for all diagonals between the same corners: one that is there, else a new one. */
static sb_result sbi_split_place_run(sbi_split *split, const int *order, int begin, int end)
{
    sbi_loader *loader = split->loader;
    sbi_diagonal_node *kept;
    int node = -1;
    for (int i = begin; i < end; i++) {
        int own = split->diagonals[order[i]].node;
        if (own >= 0 && (node < 0 || own < node))
            node = own;
    }
    if (node < 0) {
        sb_result result = loader->node_count >= INT_MAX
                               ? sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 nodes")
                               : sbi_loader_reserve_nodes(loader, 1);
        if (result)
            return result;
        node = (int)loader->node_count++;
        loader->nodes[node] = split->diagonals[order[begin]].middle;
        loader->diagonal_nodes++;
    }
    for (int i = begin; i < end; i++)
        split->elements[split->diagonals[order[i]].place] = node;
    kept = &loader->diagonals[loader->diagonal_count++];
    kept->low = split->diagonals[order[begin]].low;
    kept->high = split->diagonals[order[begin]].high;
    kept->node = node;
    return SB_OK;
}

static sb_result sbi_split_place_diagonals(sbi_split *split)
{
    const sb_allocator *allocator = &split->loader->allocator;
    int count = (int)split->diagonal_count, *order, *scratch;
    sb_result result = SB_OK;
    if (split->diagonal_count > INT_MAX)
        return sbi_reader_fail(&split->loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 diagonals");
    order = (int *)sbi_alloc(allocator, split->diagonal_count, sizeof(int));
    scratch = (int *)sbi_alloc(allocator, split->diagonal_count, sizeof(int));
    split->loader->diagonals =
        (sbi_diagonal_node *)sbi_alloc(allocator, split->diagonal_count, sizeof split->loader->diagonals[0]);
    if (!order || !scratch || !split->loader->diagonals)
        result = sbi_loader_no_memory(split->loader);
    for (int i = 0; i < count && !result; i++)
        order[i] = i;
    if (!result)
        sbi_merge_sort(order, scratch, count, sbi_split_diagonal_before, split->diagonals);
    for (int begin = 0, end; begin < count && !result; begin = end) {
        end = begin + 1;
        while (end < count && !sbi_split_diagonal_before(split->diagonals, order[begin], order[end]))
            end++;
        result = sbi_split_place_run(split, order, begin, end);
    }
    sbi_free(allocator, order);
    sbi_free(allocator, scratch);
    return result;
}

SBI_API int sbi_split_diagonal_node(const sbi_loader *loader, int a, int b)
{
    int low = a < b ? a : b, high = a < b ? b : a, begin = 0, end = loader->diagonal_count;
    while (begin < end) {
        int middle = begin + (end - begin) / 2;
        const sbi_diagonal_node *d = &loader->diagonals[middle];
        if (d->low == low && d->high == high)
            return d->node;
        if (d->low < low || (d->low == low && d->high < high))
            begin = middle + 1;
        else
            end = middle;
    }
    return -1;
}

/* ---- triangles of the file against the diagonals ---- */

/* A triangle that the file's own cells have as a face, or that a quadrilateral would have if it were cut along its
 * other diagonal. */
typedef struct sbi_split_triangle {
    int corner[3]; /* ascending */
    int cell, other;
} sbi_split_triangle;

static int sbi_split_compare_triangles(const sbi_split_triangle *a, const sbi_split_triangle *b)
{
    for (int i = 0; i < 3; i++)
        if (a->corner[i] != b->corner[i])
            return a->corner[i] < b->corner[i] ? -1 : 1;
    return 0;
}

static int sbi_split_triangle_before(const void *context, int a, int b)
{
    const sbi_split_triangle *t = (const sbi_split_triangle *)context;
    return sbi_split_compare_triangles(&t[a], &t[b]) < 0;
}

static void sbi_split_set_triangle(sbi_split_triangle *to, int a, int b, int c, int cell, int other)
{
    int low = a < b ? a : b, high = a < b ? b : a;
    to->corner[0] = c < low ? c : low;
    to->corner[1] = c < low ? low : c < high ? c : high;
    to->corner[2] = c < high ? high : c;
    to->cell = cell;
    to->other = other;
}

/* Triangles of all faces: see sbi_split_triangle; to NULL: only counts. */
static size_t sbi_split_list_triangles(const sbi_loader *loader, sbi_split_triangle *to)
{
    const int *nodes = loader->indices;
    size_t count = 0;
    for (size_t i = 0; i < loader->cell_count; i++) {
        const sbi_cell_kind *about = sbi_cell_kind_at(loader->cells[i].kind);
        const sbi_split_shape *shape = sbi_split_shape_of(about->shape);
        for (int f = 0; f < shape->faces; f++) {
            int parts = f < shape->quads ? 2 : 1, corner[4], first = 0;
            for (int k = 0; k < parts + 2 && to; k++)
                corner[k] = nodes[shape->face[f][k]];
            if (to && parts == 2)
                first = sbi_split_first_corner(corner, 4) + 1; /* the other diagonal begins at the next corner */
            for (int part = 0; part < parts && to; part++)
                sbi_split_set_triangle(&to[count + (size_t)part], corner[first % (parts + 2)],
                                       corner[(first + part + 1) % (parts + 2)],
                                       corner[(first + part + 2) % (parts + 2)], loader->cells[i].source, parts == 2);
            count += (size_t)parts;
        }
        nodes += about->nodes;
    }
    return count;
}

/* Where a quadrilateral lies against two triangles that are cut the other way, tets would not fit. */
static sb_result sbi_split_check_triangles(sbi_split *split)
{
    sbi_loader *loader = split->loader;
    const sb_allocator *allocator = &loader->allocator;
    size_t count = sbi_split_list_triangles(loader, NULL);
    sbi_split_triangle *triangles;
    int *order, *scratch;
    sb_result result = SB_OK;
    if (count > INT_MAX)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 faces");
    triangles = (sbi_split_triangle *)sbi_alloc(allocator, count, sizeof *triangles);
    order = (int *)sbi_alloc(allocator, count, sizeof(int));
    scratch = (int *)sbi_alloc(allocator, count, sizeof(int));
    if (!triangles || !order || !scratch) {
        result = sbi_loader_no_memory(loader);
    } else {
        sbi_split_list_triangles(loader, triangles);
        for (int i = 0; i < (int)count; i++)
            order[i] = i;
        sbi_merge_sort(order, scratch, (int)count, sbi_split_triangle_before, triangles);
    }
    for (int i = 1; i < (int)count && !result; i++) {
        const sbi_split_triangle *a = &triangles[order[i - 1]], *b = &triangles[order[i]];
        if (a->other != b->other && sbi_split_compare_triangles(a, b) == 0) {
            sbi_reader place = loader->reader; /* behind the cells: its line means nothing */
            place.binary = place.line = 0;
            place.element = a->other ? a->cell : b->cell;
            result = sbi_reader_fail(&place, SB_ERROR_UNSUPPORTED,
                                     "a quadrilateral of cell %d lies against triangles of cell %d that are cut along "
                                     "its other diagonal: the cells cannot be split into tets that fit",
                                     place.element, a->other ? b->cell : a->cell);
        }
    }
    sbi_free(allocator, triangles);
    sbi_free(allocator, order);
    sbi_free(allocator, scratch);
    return result;
}

SBI_API sb_result sbi_split_cells(sbi_loader *loader, sb_mesh *mesh)
{
    sbi_split split;
    const int *nodes = loader->indices;
    sb_result result;
    memset(&split, 0, sizeof split);
    split.loader = loader;
    split.elements = mesh->elements;
    split.width = sb_element_node_count(mesh->element_type);
    sbi_split_find_mirrored(&split);
    result = sbi_split_check_triangles(&split);
    for (size_t i = 0; i < loader->cell_count && !result; i++) {
        const sbi_cell_kind *about = sbi_cell_kind_at(loader->cells[i].kind);
        if (about->dimension == 3)
            result = sbi_split_cell(&split, &loader->cells[i], nodes);
        nodes += about->nodes;
    }
    if (!result)
        result = sbi_split_place_diagonals(&split);
    sbi_free(&loader->allocator, split.diagonals);
    return result;
}
