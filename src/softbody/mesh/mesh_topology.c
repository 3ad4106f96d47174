/* mesh_topology: boundary, neighbours, edges, elements of a node, connected parts. */
#include "mesh_private.h"

/* ---- topology ---- */

SB_API void sb_index_table_free(sb_index_table *table)
{
    if (!table)
        return;
    sbi_free(&table->allocator, table->items);
    memset(table, 0, sizeof *table);
}

SB_API void sb_index_lists_free(sb_index_lists *lists)
{
    if (!lists)
        return;
    sbi_free(&lists->allocator, lists->offsets);
    sbi_free(&lists->allocator, lists->items);
    memset(lists, 0, sizeof *lists);
}

SB_API void sb_boundary_free(sb_boundary *boundary)
{
    sb_allocator allocator;
    if (!boundary)
        return;
    allocator = boundary->surface.allocator;
    sbi_free(&allocator, boundary->elements);
    sbi_free(&allocator, boundary->faces);
    sbi_free(&allocator, boundary->nodes);
    sb_mesh_free(&boundary->surface);
    memset(boundary, 0, sizeof *boundary);
}

static int sbi_mesh_table_allocate(sb_index_table *table, int rows, int columns, const sb_allocator *allocator)
{
    sbi_mesh_set_allocator(&table->allocator, allocator);
    table->rows = rows;
    table->columns = columns;
    table->items = (int *)sbi_alloc(allocator, (size_t)rows, sizeof(int) * (size_t)columns);
    return table->items != NULL;
}

SBI_API int sbi_mesh_face_triangles(sb_element_type type, const signed char (**triangles)[3])
{
    static const signed char tri6[4][3] = {{0, 3, 5}, {3, 1, 4}, {5, 4, 2}, {3, 4, 5}};
    static const signed char quad4[2][3] = {{0, 1, 2}, {0, 2, 3}};
    static const signed char quad8[6][3] = {{0, 4, 7}, {4, 1, 5}, {5, 2, 6}, {6, 3, 7}, {4, 5, 6}, {4, 6, 7}};
    static const signed char quad9[8][3] = {{0, 4, 8}, {4, 1, 8}, {1, 5, 8}, {5, 2, 8},
                                            {2, 6, 8}, {6, 3, 8}, {3, 7, 8}, {7, 0, 8}};
    switch (type) {
    case SB_TRI6: *triangles = tri6; return 4;
    case SB_QUAD4: *triangles = quad4; return 2;
    case SB_QUAD8: *triangles = quad8; return 6;
    case SB_QUAD9: *triangles = quad9; return 8;
    default: *triangles = quad4; return 1; /* tri3: 0 1 2 */
    }
}

/* Type of the boundary's elements: that of the faces, or tri3 when they are of several. */
static sb_element_type sbi_mesh_boundary_type(sbi_element element)
{
    int local[SB_MAX_FACE_NODES];
    sb_element_type first = SB_NO_ELEMENT, type = SB_NO_ELEMENT;
    sbi_element_face(element, 0, local, &first);
    for (int face = 1; sbi_element_face(element, face, local, &type); face++)
        if (type != first)
            return SB_TRI3;
    return first;
}

/* Rows that face `face` takes in a boundary of `type`. */
static int sbi_mesh_boundary_parts(sbi_element element, int face, sb_element_type type)
{
    const signed char(*triangles)[3];
    int local[SB_MAX_FACE_NODES];
    sb_element_type of_face = SB_NO_ELEMENT;
    sbi_element_face(element, face, local, &of_face);
    return of_face == type ? 1 : sbi_mesh_face_triangles(of_face, &triangles);
}

/* Rows of the boundary; -1 when they do not fit an int. */
static int sbi_mesh_count_rows(const sb_mesh *mesh, const int *mate, sb_element_type type)
{
    sbi_element element = sbi_mesh_element_kind(mesh);
    int per = sbi_element_face_count(element), parts[SB_MAX_ELEMENT_FACES];
    int64_t rows = 0;
    for (int face = 0; face < per; face++)
        parts[face] = sbi_mesh_boundary_parts(element, face, type);
    for (int p = 0; p < mesh->element_count * per; p++)
        if (mate[p] == SBI_MESH_ALONE)
            rows += parts[p % per];
    return rows <= INT_MAX ? (int)rows : -1;
}

/* Copies face `face` of element e to the boundary from row `row` on; returns the row after. */
static int sbi_mesh_boundary_row(const sb_mesh *mesh, int e, int face, int row, sb_boundary *boundary)
{
    const signed char(*triangles)[3] = NULL;
    int local[SB_MAX_FACE_NODES], parts = 1;
    sb_element_type type = SB_NO_ELEMENT, of_row = boundary->surface.element_type;
    sbi_element_face(sbi_mesh_element_kind(mesh), face, local, &type);
    if (type != of_row)
        parts = sbi_mesh_face_triangles(type, &triangles);
    for (int part = 0; part < parts; part++, row++) {
        int *nodes = sbi_mesh_element_to_edit(&boundary->surface, row);
        for (int a = 0; a < sb_element_node_count(of_row); a++)
            nodes[a] = sbi_mesh_element(mesh, e)[local[triangles ? triangles[part][a] : a]];
        boundary->elements[row] = e;
        boundary->faces[row] = face;
        if (mesh->regions)
            boundary->surface.regions[row] = mesh->regions[e];
    }
    return row;
}

/* The surface with all nodes of the volume; 0 when memory is short. */
static int sbi_mesh_boundary_make(const sb_mesh *mesh, const int *mate, int with_map, const sb_allocator *allocator,
                                  sb_boundary *boundary)
{
    sbi_element element = sbi_mesh_element_kind(mesh);
    sb_element_type type = sbi_mesh_boundary_type(element);
    int per = sbi_element_face_count(element), sides = mesh->element_count * per;
    int rows = sbi_mesh_count_rows(mesh, mate, type), row = 0;
    if (rows < 0 ||
        !sbi_mesh_allocate(&boundary->surface, type, mesh->node_count, rows, mesh->regions != NULL, allocator))
        return 0;
    boundary->elements = (int *)sbi_alloc(allocator, (size_t)rows, sizeof(int));
    boundary->faces = (int *)sbi_alloc(allocator, (size_t)rows, sizeof(int));
    if (with_map)
        boundary->nodes = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    if (!boundary->elements || !boundary->faces || (with_map && !boundary->nodes))
        return 0;
    memcpy(boundary->surface.nodes, mesh->nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
    for (int p = 0; p < sides; p++)
        if (mate[p] == SBI_MESH_ALONE)
            row = sbi_mesh_boundary_row(mesh, p / per, p % per, row, boundary);
    return 1;
}

/* Drops the nodes that the surface does not use; keep: [node_count] scratch. */
static void sbi_mesh_boundary_compact(sb_boundary *boundary, int *keep)
{
    sb_mesh *surface = &boundary->surface;
    size_t indices = (size_t)surface->element_count * (size_t)sb_element_node_count(surface->element_type);
    int kept = 0;
    for (int v = 0; v < surface->node_count; v++)
        keep[v] = -1;
    for (size_t i = 0; i < indices; i++)
        keep[surface->elements[i]] = surface->elements[i];
    for (int v = 0; v < surface->node_count; v++)
        if (keep[v] == v)
            boundary->nodes[kept++] = v;
    sbi_mesh_compact_nodes(surface, keep);
}

SB_API sb_result sb_mesh_boundary(const sb_mesh *mesh, int compact, const sb_allocator *allocator,
                                  sb_boundary *boundary, sb_error *error)
{
    sb_boundary made;
    sbi_mesh_keys sides;
    int *mate = NULL, *keep = NULL, ok;
    sb_result result = sbi_mesh_check_output(mesh, boundary, error);
    if (result == SB_OK)
        result = sbi_mesh_check_has_shape(mesh, error);
    if (result != SB_OK)
        return result;
    if (sb_element_dimension(mesh->element_type) != 3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a mesh of %s has no boundary faces",
                        sb_element_name(mesh->element_type));
    memset(&made, 0, sizeof made);
    if (sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, NULL, allocator, &sides))
        mate = sbi_mesh_mates(&sides, allocator);
    sbi_mesh_keys_free(allocator, &sides);
    if (compact)
        keep = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    ok = mate && (keep || !compact) && sbi_mesh_boundary_make(mesh, mate, compact, allocator, &made);
    if (ok && compact)
        sbi_mesh_boundary_compact(&made, keep);
    if (ok) {
        *boundary = made;
    } else {
        sbi_mesh_set_allocator(&made.surface.allocator, allocator);
        sb_boundary_free(&made);
        result = sbi_mesh_no_memory(error);
    }
    sbi_free(allocator, mate);
    sbi_free(allocator, keep);
    return result;
}

SB_API sb_result sb_mesh_neighbours(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_table *neighbours,
                                    sb_error *error)
{
    sb_index_table made;
    sbi_mesh_keys sides;
    int per;
    sb_result result = sbi_mesh_check_output(mesh, neighbours, error);
    if (result == SB_OK)
        result = sbi_mesh_check_has_shape(mesh, error);
    if (result != SB_OK)
        return result;
    if (!sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, NULL, allocator, &sides))
        return sbi_mesh_no_memory(error);
    per = sides.per_element;
    sbi_mesh_set_allocator(&made.allocator, allocator);
    made.rows = mesh->element_count;
    made.columns = per;
    made.items = sbi_mesh_mates(&sides, allocator);
    for (int p = 0; made.items && p < sides.count; p++)
        made.items[p] = made.items[p] >= 0 ? made.items[p] / per : -1;
    if (made.items)
        *neighbours = made;
    else
        result = sbi_mesh_no_memory(error);
    sbi_mesh_keys_free(allocator, &sides);
    return result;
}

SB_API sb_result sb_mesh_edges(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_table *edges,
                               sb_error *error)
{
    sb_index_table made;
    sbi_mesh_keys keys;
    int row = 0;
    sb_result result = sbi_mesh_check_output(mesh, edges, error);
    if (result == SB_OK)
        result = sbi_mesh_check_has_shape(mesh, error);
    if (result != SB_OK)
        return result;
    if (!sbi_mesh_keys_make(mesh, SBI_MESH_EDGES, NULL, allocator, &keys))
        return sbi_mesh_no_memory(error);
    if (sbi_mesh_table_allocate(&made, sbi_mesh_count_runs(&keys), 2, allocator)) {
        for (int begin = 0; begin < keys.sorted; begin = sbi_mesh_run_end(&keys, begin), row++)
            memcpy(made.items + 2 * (size_t)row, keys.keys + 2 * (size_t)keys.order[begin], 2 * sizeof(int));
        *edges = made;
    } else {
        result = sbi_mesh_no_memory(error);
    }
    sbi_mesh_keys_free(allocator, &keys);
    return result;
}

/* Fills offsets and items; an element that repeats a node is listed once for it. last: [nodes] scratch of
 * -1. */
static void sbi_mesh_lists_fill(const sb_mesh *mesh, sb_index_lists *lists, int *last, int counting)
{
    int n = sb_mesh_element_width(mesh);
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        for (int a = 0; a < n; a++) {
            if (last[nodes[a]] == e)
                continue;
            last[nodes[a]] = e;
            if (counting)
                lists->offsets[nodes[a] + 1]++;
            else
                lists->items[lists->offsets[nodes[a]]++] = e;
        }
    }
}

static void sbi_mesh_fill_int(int *values, int count, int value)
{
    for (int i = 0; i < count; i++)
        values[i] = value;
}

SBI_API int sbi_mesh_lists_make(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_lists *lists)
{
    int count = mesh->node_count, *last;
    memset(lists, 0, sizeof *lists);
    sbi_mesh_set_allocator(&lists->allocator, allocator);
    if (mesh->element_count > INT_MAX / sb_mesh_element_width(mesh))
        return 0;
    lists->count = count;
    last = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    lists->offsets = (int *)sbi_alloc_zeroed(allocator, (size_t)count + 1, sizeof(int));
    if (last && lists->offsets) {
        sbi_mesh_fill_int(last, count, -1);
        sbi_mesh_lists_fill(mesh, lists, last, 1);
        for (int v = 0; v < count; v++)
            lists->offsets[v + 1] += lists->offsets[v];
        lists->items = (int *)sbi_alloc(allocator, (size_t)lists->offsets[count], sizeof(int));
    }
    if (lists->items) {
        sbi_mesh_fill_int(last, count, -1);
        sbi_mesh_lists_fill(mesh, lists, last, 0);
        memmove(lists->offsets + 1, lists->offsets, sizeof(int) * (size_t)count); /* filling moved each to its end */
        lists->offsets[0] = 0;
    } else {
        sb_index_lists_free(lists);
    }
    sbi_free(allocator, last);
    return lists->items != NULL;
}

SB_API sb_result sb_mesh_node_elements(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_lists *lists,
                                       sb_error *error)
{
    sb_index_lists made;
    sb_result result = sbi_mesh_check_output(mesh, lists, error);
    if (result != SB_OK)
        return result;
    if (!sbi_mesh_lists_make(mesh, allocator, &made))
        return sbi_mesh_no_memory(error);
    *lists = made;
    return SB_OK;
}

SB_API sb_result sb_mesh_components(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_table *labels,
                                    int *count, sb_error *error)
{
    sb_index_table made;
    int *scratch, parts;
    sb_result result = sbi_mesh_check_output(mesh, labels, error);
    if (result != SB_OK)
        return result;
    scratch = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    if (scratch && sbi_mesh_table_allocate(&made, mesh->element_count, 1, allocator)) {
        parts = sbi_mesh_label_components(mesh, NULL, made.items, scratch);
        *labels = made;
        if (count)
            *count = parts;
    } else {
        result = sbi_mesh_no_memory(error);
    }
    sbi_free(allocator, scratch);
    return result;
}
