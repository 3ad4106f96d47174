/* meshio_loader: kinds of cells and the loader that collects the nodes, cells and names of a file. */
#include "meshio_reader.h"

#include <limits.h>
#include <string.h>

/* ==== cells ======================================================================================== */

SBI_API const sbi_cell_kind *sbi_cell_kind_at(int kind)
{
    static const sbi_cell_kind kinds[SBI_CELL_KINDS] = {
        {"tri3", SB_TRI3, 2, 3, 5, 2, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"quad4", SB_QUAD4, 2, 4, 9, 3, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tet4", SB_TET4, 3, 4, 10, 4, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_TET},
        {"tet10", SB_TET10, 3, 10, 24, 11, SBI_ORDER_SAME, SBI_ORDER_GMSH_TET10, SBI_SHAPE_TET},
        {"hex8", SB_HEX8, 3, 8, 12, 5, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_HEX},
        {"tri6", SB_TRI6, 2, 6, 22, 9, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"pixel", SB_QUAD4, 2, 4, 8, -1, SBI_ORDER_PIXEL, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"voxel", SB_HEX8, 3, 8, 11, -1, SBI_ORDER_VOXEL, SBI_ORDER_SAME, SBI_SHAPE_HEX},
        {"empty cell", SB_NO_ELEMENT, 0, 0, 0, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"vertex", SB_NO_ELEMENT, 0, 1, 1, 15, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"polyvertex", SB_NO_ELEMENT, 0, 0, 2, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"line2", SB_NO_ELEMENT, 1, 2, 3, 1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"polyline", SB_NO_ELEMENT, 1, 0, 4, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"line3", SB_NO_ELEMENT, 1, 3, 21, 8, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"line4", SB_NO_ELEMENT, 1, 4, 35, 26, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"line5", SB_NO_ELEMENT, 1, 5, -1, 27, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"line6", SB_NO_ELEMENT, 1, 6, -1, 28, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"Lagrange curve", SB_NO_ELEMENT, 1, 0, 68, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"triangle strip", SB_NO_ELEMENT, 2, 0, 6, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"polygon", SB_NO_ELEMENT, 2, 0, 7, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri7", SB_NO_ELEMENT, 2, 7, 34, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri9", SB_NO_ELEMENT, 2, 9, -1, 20, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri10", SB_NO_ELEMENT, 2, 10, -1, 21, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri12", SB_NO_ELEMENT, 2, 12, -1, 22, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri15", SB_NO_ELEMENT, 2, 15, -1, 23, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri15 (order 5)", SB_NO_ELEMENT, 2, 15, -1, 24, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri21", SB_NO_ELEMENT, 2, 21, -1, 25, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"quad6", SB_NO_ELEMENT, 2, 6, 30, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"quad8", SB_QUAD8, 2, 8, 23, 16, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"quad9", SB_QUAD9, 2, 9, 28, 10, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"quadratic polygon", SB_NO_ELEMENT, 2, 0, 36, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"Lagrange triangle", SB_NO_ELEMENT, 2, 0, 69, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"Lagrange quadrilateral", SB_NO_ELEMENT, 2, 0, 70, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tet20", SB_NO_ELEMENT, 3, 20, -1, 29, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tet35", SB_NO_ELEMENT, 3, 35, -1, 30, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tet56", SB_NO_ELEMENT, 3, 56, -1, 31, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"hex20", SB_HEX20, 3, 20, 25, 17, SBI_ORDER_SAME, SBI_ORDER_GMSH_HEX, SBI_SHAPE_HEX},
        {"hex24", SB_NO_ELEMENT, 3, 24, 33, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"hex27", SB_HEX27, 3, 27, 29, 12, SBI_ORDER_SAME, SBI_ORDER_GMSH_HEX, SBI_SHAPE_HEX},
        {"hex64", SB_NO_ELEMENT, 3, 64, -1, 92, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"hex125", SB_NO_ELEMENT, 3, 125, -1, 93, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"wedge6", SB_NO_ELEMENT, 3, 6, 13, 6, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_WEDGE},
        {"wedge12", SB_NO_ELEMENT, 3, 12, 31, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"wedge15", SB_NO_ELEMENT, 3, 15, 26, 18, SBI_ORDER_SAME, SBI_ORDER_GMSH_WEDGE, SBI_SHAPE_WEDGE},
        {"wedge18", SB_NO_ELEMENT, 3, 18, 32, 13, SBI_ORDER_SAME, SBI_ORDER_GMSH_WEDGE, SBI_SHAPE_WEDGE},
        {"pyramid5", SB_NO_ELEMENT, 3, 5, 14, 7, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_PYRAMID},
        {"pyramid13", SB_NO_ELEMENT, 3, 13, 27, 19, SBI_ORDER_SAME, SBI_ORDER_GMSH_PYRAMID, SBI_SHAPE_PYRAMID},
        {"pyramid14", SB_NO_ELEMENT, 3, 14, -1, 14, SBI_ORDER_SAME, SBI_ORDER_GMSH_PYRAMID, SBI_SHAPE_PYRAMID},
        {"pentagonal prism", SB_NO_ELEMENT, 3, 10, 15, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"hexagonal prism", SB_NO_ELEMENT, 3, 12, 16, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"convex point set", SB_NO_ELEMENT, 3, 0, 41, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"polyhedron", SB_NO_ELEMENT, 3, 0, 42, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"Lagrange tetrahedron", SB_NO_ELEMENT, 3, 0, 71, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"Lagrange hexahedron", SB_NO_ELEMENT, 3, 0, 72, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"Lagrange wedge", SB_NO_ELEMENT, 3, 0, 73, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
    };
    return &kinds[kind];
}

SBI_API int sbi_cell_kind_of_vtk(int64_t number)
{
    for (int kind = 0; number >= 0 && kind < SBI_CELL_KINDS; kind++)
        if (sbi_cell_kind_at(kind)->vtk == number)
            return kind;
    return -1;
}

SBI_API int sbi_cell_kind_of_gmsh(int64_t number)
{
    for (int kind = 0; number >= 0 && kind < SBI_CELL_KINDS; kind++)
        if (sbi_cell_kind_at(kind)->gmsh == number)
            return kind;
    return -1;
}

/* Position in the file's list of our node i. */
static int sbi_node_order_at(sbi_node_order order, int i)
{
    static const unsigned char voxel[8] = {0, 1, 3, 2, 4, 5, 7, 6}; /* its first four are a pixel's */
    static const unsigned char gmsh_tet10[10] = {0, 1, 2, 3, 4, 5, 6, 7, 9, 8};
    static const unsigned char gmsh_hex[27] = {0,  1,  2,  3,  4,  5,  6,  7,  8,  11, 13, 9,  16, 18,
                                               19, 17, 10, 12, 14, 15, 22, 23, 21, 24, 20, 25, 26};
    static const unsigned char gmsh_wedge[18] = {0, 1, 2, 3, 4, 5, 6, 9, 7, 12, 14, 13, 8, 10, 11, 15, 17, 16};
    static const unsigned char gmsh_pyramid[14] = {0, 1, 2, 3, 4, 5, 8, 10, 6, 7, 9, 11, 12, 13};
    switch (order) {
    case SBI_ORDER_PIXEL:
    case SBI_ORDER_VOXEL: return voxel[i];
    case SBI_ORDER_GMSH_TET10: return gmsh_tet10[i];
    case SBI_ORDER_GMSH_HEX: return gmsh_hex[i];
    case SBI_ORDER_GMSH_WEDGE: return gmsh_wedge[i];
    case SBI_ORDER_GMSH_PYRAMID: return gmsh_pyramid[i];
    case SBI_ORDER_SAME: break;
    }
    return i;
}

/* ==== loader ======================================================================================= */

SBI_API void sbi_loader_init(sbi_loader *loader, const sb_load_options *options, sb_error *error)
{
    memset(loader, 0, sizeof *loader);
    sbi_reader_init(&loader->reader, "", 0, "", error);
    loader->allocator = options->allocator;
    loader->scale = (double)options->scale;
    loader->keep_low = options->sets != NULL;
}

SBI_API void sbi_loader_free(sbi_loader *loader)
{
    sbi_free(&loader->allocator, loader->nodes);
    sbi_free(&loader->allocator, loader->normals);
    sbi_free(&loader->allocator, loader->indices);
    sbi_free(&loader->allocator, loader->cells);
    sbi_free(&loader->allocator, loader->scratch);
    sbi_free(&loader->allocator, loader->source_regions);
    sbi_free(&loader->allocator, loader->groups);
    sbi_free(&loader->allocator, loader->names);
    sbi_free(&loader->allocator, loader->diagonals);
}

SBI_API sb_result sbi_loader_no_memory(const sbi_loader *loader)
{
    sbi_fail(loader->reader.error, SB_ERROR_MEMORY, "out of memory while loading a mesh");
    if (loader->reader.error)
        sbi_error_set_file(loader->reader.error, loader->reader.name);
    return SB_ERROR_MEMORY;
}

SBI_API void *sbi_loader_grow(const sbi_loader *loader, void *old, size_t used, size_t *capacity, size_t needed,
                              size_t item)
{
    size_t target = *capacity < ((size_t)-1) / 2 ? 2 * *capacity : needed;
    void *grown;
    if (target < needed)
        target = needed;
    if (target < 16)
        target = 16;
    grown = sbi_alloc(&loader->allocator, target, item);
    if (!grown)
        return NULL;
    if (used)
        memcpy(grown, old, used * item);
    sbi_free(&loader->allocator, old);
    *capacity = target;
    return grown;
}

static int sbi_loader_room_for_nodes(sbi_loader *loader, size_t needed)
{
    void *grown = loader->nodes;
    if (needed > loader->node_capacity)
        grown = sbi_loader_grow(loader, loader->nodes, loader->node_count, &loader->node_capacity, needed,
                                sizeof loader->nodes[0]);
    if (grown)
        loader->nodes = (sb_vec3 *)grown;
    return grown != NULL;
}

SBI_API sb_result sbi_loader_reserve_nodes(sbi_loader *loader, int count)
{
    size_t needed = loader->node_count + (size_t)count;
    return count == 0 || sbi_loader_room_for_nodes(loader, needed) ? SB_OK : sbi_loader_no_memory(loader);
}

SBI_API sb_result sbi_loader_add_node(sbi_loader *loader, const double x[3])
{
    sb_real scaled[3];
    sbi_reader *reader = &loader->reader;
    reader->node = (int)loader->node_count;
    for (int i = 0; i < 3; i++) {
        double value = x[i] * loader->scale;
        if (x[i] - x[i] != 0)
            return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "a coordinate of node %d is not finite", reader->node);
        if (fabs(value) > (double)SB_REAL_MAX)
            return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "a coordinate of node %d is too large: %g",
                                   reader->node, value);
        scaled[i] = (sb_real)value;
    }
    if (loader->node_count >= INT_MAX)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 nodes");
    if (loader->node_count >= loader->node_capacity && !sbi_loader_room_for_nodes(loader, loader->node_count + 1))
        return sbi_loader_no_memory(loader);
    loader->nodes[loader->node_count++] = sb_v3(scaled[0], scaled[1], scaled[2]);
    reader->node = -1;
    return SB_OK;
}

SBI_API sb_result sbi_loader_add_normal(sbi_loader *loader, const double n[3])
{
    sb_vec3 normal = sb_v3((sb_real)n[0], (sb_real)n[1], (sb_real)n[2]);
    if (!sb_v3_is_finite(normal))
        return sbi_reader_fail(&loader->reader, SB_ERROR_NOT_FINITE, "normal %llu is not finite",
                               (unsigned long long)loader->normal_count);
    if (loader->normal_count >= loader->normal_capacity) {
        size_t needed = loader->normal_count + 1;
        void *grown =
            sbi_loader_grow(loader, loader->normals, loader->normal_count, &loader->normal_capacity,
                            needed > loader->node_capacity ? needed : loader->node_capacity, sizeof loader->normals[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->normals = (sb_vec3 *)grown;
    }
    loader->normals[loader->normal_count++] = normal;
    return SB_OK;
}

SBI_API sb_result sbi_loader_read_node(sbi_loader *loader)
{
    double x[3] = {0, 0, 0};
    loader->reader.node = (int)loader->node_count;
    for (int i = 0; i < 3; i++) {
        sb_result result = sbi_reader_real(&loader->reader, "coordinate", &x[i]);
        if (result)
            return result;
    }
    return sbi_loader_add_node(loader, x);
}

SBI_API void sbi_loader_begin_cell(sbi_loader *loader)
{
    loader->scratch_count = 0;
    loader->reader.element = loader->source_count;
}

SBI_API sb_result sbi_loader_cell_node(sbi_loader *loader, int64_t number, int64_t base)
{
    int64_t last = base + (int64_t)loader->node_count - 1;
    if (loader->node_count == 0)
        return sbi_reader_fail(&loader->reader, SB_ERROR_INDEX, "a cell before the first node");
    if (number < base || number > last)
        return sbi_reader_fail(&loader->reader, SB_ERROR_INDEX, "node %lld does not exist: nodes are %lld to %lld",
                               (long long)number, (long long)base, (long long)last);
    if (loader->scratch_count >= loader->scratch_capacity) {
        void *grown = sbi_loader_grow(loader, loader->scratch, loader->scratch_count, &loader->scratch_capacity,
                                      loader->scratch_count + 1, sizeof loader->scratch[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->scratch = (int *)grown;
    }
    loader->scratch[loader->scratch_count++] = (int)(number - base);
    return SB_OK;
}

/* Room for one more cell of `nodes` nodes. */
static sb_result sbi_loader_reserve_cell(sbi_loader *loader, size_t nodes)
{
    void *grown;
    if (loader->cell_count >= INT_MAX)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 elements");
    if (loader->cell_count >= loader->cell_capacity) {
        grown = sbi_loader_grow(loader, loader->cells, loader->cell_count, &loader->cell_capacity,
                                loader->cell_count + 1, sizeof loader->cells[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->cells = (sbi_cell *)grown;
    }
    if (nodes > loader->index_capacity - loader->index_count) {
        grown = sbi_loader_grow(loader, loader->indices, loader->index_count, &loader->index_capacity,
                                loader->index_count + nodes, sizeof loader->indices[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->indices = (int *)grown;
    }
    return SB_OK;
}

/* Appends a cell with the nodes scratch[a], scratch[b], ... or, with corners NULL, all of them in `order`. */
static sb_result sbi_loader_push_cell(sbi_loader *loader, int kind, const size_t corners[3], sbi_node_order order,
                                      int region)
{
    int nodes = sbi_cell_kind_at(kind)->nodes;
    sb_result result = sbi_loader_reserve_cell(loader, (size_t)nodes);
    sbi_cell *cell;
    if (result)
        return result;
    cell = &loader->cells[loader->cell_count++];
    cell->kind = kind;
    cell->source = loader->source_count;
    cell->region = region;
    cell->groups = loader->cell_groups;
    for (int i = 0; i < nodes; i++) {
        size_t from = corners ? corners[i] : (size_t)sbi_node_order_at(order, i);
        loader->indices[loader->index_count++] = loader->scratch[from];
    }
    return SB_OK;
}

/* Counts a finished cell of the file. */
static sb_result sbi_loader_count_cell(sbi_loader *loader, int kind)
{
    if (loader->source_count == INT_MAX)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 cells");
    if (loader->kind_count[kind]++ == 0) {
        loader->kind_line[kind] = loader->reader.binary ? 0 : loader->reader.line;
        loader->kind_first[kind] = loader->source_count;
    }
    loader->source_count++;
    loader->reader.element = -1;
    return SB_OK;
}

/* Cells that may become elements, or for the sake of sets points and lines. */
static int sbi_loader_keeps(const sbi_loader *loader, const sbi_cell_kind *about)
{
    if (about->dimension < 2)
        return loader->keep_low && about->nodes > 0;
    return about->type != SB_NO_ELEMENT || about->shape != SBI_SHAPE_NONE;
}

SBI_API sb_result sbi_loader_end_cell(sbi_loader *loader, int kind, sbi_node_order order, int region)
{
    const sbi_cell_kind *about = sbi_cell_kind_at(kind);
    sb_result result = SB_OK;
    if (about->nodes && loader->scratch_count != (size_t)about->nodes)
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "cell %d has %llu nodes, but a %s has %d",
                               loader->source_count, (unsigned long long)loader->scratch_count, about->name,
                               about->nodes);
    if (sbi_loader_keeps(loader, about))
        result = sbi_loader_push_cell(loader, kind, NULL, order, region);
    return result ? result : sbi_loader_count_cell(loader, kind);
}

static sb_result sbi_loader_end_triangles(sbi_loader *loader, int region, int strip)
{
    sb_result result = SB_OK;
    size_t count = loader->scratch_count;
    if (count < 3)
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "face %d has %llu corners", loader->source_count,
                               (unsigned long long)count);
    for (size_t i = 0; i + 2 < count && !result; i++) {
        size_t fan[3], odd = strip ? i % 2 : 0;
        fan[0] = strip ? i : 0;
        fan[1] = i + 1 + odd; /* every other triangle of a strip turns round */
        fan[2] = i + 2 - odd;
        result = sbi_loader_push_cell(loader, SBI_CELL_TRI3, fan, SBI_ORDER_SAME, region);
    }
    if (!result && count > 3)
        loader->split_polygons++;
    return result ? result : sbi_loader_count_cell(loader, SBI_CELL_TRI3);
}

SBI_API sb_result sbi_loader_end_polygon(sbi_loader *loader, int region)
{
    return sbi_loader_end_triangles(loader, region, 0);
}

SBI_API sb_result sbi_loader_end_strip(sbi_loader *loader, int region)
{
    return sbi_loader_end_triangles(loader, region, 1);
}

SBI_API sb_result sbi_loader_end_vtk_cell(sbi_loader *loader, int kind)
{
    const sbi_cell_kind *about = sbi_cell_kind_at(kind);
    if (about->vtk == 7)
        return sbi_loader_end_polygon(loader, 0);
    if (about->vtk == 6)
        return sbi_loader_end_strip(loader, 0);
    return sbi_loader_end_cell(loader, kind, about->vtk_order, 0);
}

/* ---- groups, regions and what is left out ---- */

SBI_API sb_result sbi_loader_add_groups(sbi_loader *loader, const int *numbers, int count, int *list)
{
    size_t used = loader->group_count ? loader->group_count : 1, needed = used + (size_t)count + 1;
    const int *before = loader->cell_groups ? loader->groups + loader->cell_groups : NULL;
    *list = 0;
    if (count == 0)
        return SB_OK;
    if (before && before[0] == count && memcmp(before + 1, numbers, (size_t)count * sizeof(int)) == 0) {
        *list = loader->cell_groups;
        return SB_OK;
    }
    if (needed > INT_MAX)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 groups");
    if (needed > loader->group_capacity) {
        void *grown = sbi_loader_grow(loader, loader->groups, loader->group_count, &loader->group_capacity, needed,
                                      sizeof loader->groups[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->groups = (int *)grown;
    }
    loader->groups[0] = 0;
    loader->groups[used] = count;
    memcpy(loader->groups + used + 1, numbers, (size_t)count * sizeof(int));
    loader->group_count = needed;
    *list = (int)used;
    return SB_OK;
}

/* Copies a name, cut where it is too long, never within a character of UTF-8. */
static void sbi_name_copy(char *to, size_t room, sbi_word text)
{
    size_t length = text.length < room ? text.length : room - 1;
    if (length < text.length)
        while (length > 0 && ((unsigned char)text.text[length] & 0xC0) == 0x80)
            length--;
    for (size_t i = 0; i < length; i++)
        to[i] = (unsigned char)text.text[i] < ' ' || text.text[i] == 127 ? '?' : text.text[i];
    to[length] = 0;
}

SBI_API sb_result sbi_loader_add_name(sbi_loader *loader, int dimension, int number, sbi_word text)
{
    sbi_group_name *name;
    if (loader->name_count >= loader->name_capacity) {
        void *grown = sbi_loader_grow(loader, loader->names, loader->name_count, &loader->name_capacity,
                                      loader->name_count + 1, sizeof loader->names[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->names = (sbi_group_name *)grown;
    }
    name = &loader->names[loader->name_count++];
    name->dimension = dimension;
    name->number = number;
    sbi_name_copy(name->text, sizeof name->text, text);
    return SB_OK;
}

SBI_API void sbi_loader_ignore(sbi_loader *loader, sbi_word name)
{
    char text[40];
    size_t used = strlen(loader->ignored), length;
    sbi_name_copy(text, sizeof text, name);
    length = strlen(text);
    if (loader->ignored_count < INT_MAX)
        loader->ignored_count++;
    if (used + length + 6 >= sizeof loader->ignored) { /* room for the dots is kept */
        if (used < 3 || strcmp(loader->ignored + used - 3, "...") != 0)
            memcpy(loader->ignored + used, used ? ", ..." : "...", used ? 6 : 4);
        return;
    }
    if (used) {
        memcpy(loader->ignored + used, ", ", 2);
        used += 2;
    }
    memcpy(loader->ignored + used, text, length + 1);
}

/* The names that programs give to the material of a cell; ours is best. */
SBI_API int sbi_region_field_rank(sbi_word name)
{
    static const char names[][20] = {"region",        "regions",     "region_id",    "RegionId",    "material",
                                     "materials",     "material_id", "MaterialId",   "MaterialIds", "mat_id",
                                     "gmsh:physical", "medit:ref",   "CellEntityIds"};
    const int count = (int)(sizeof names / sizeof names[0]);
    for (int i = 0; i < count; i++)
        if (sbi_word_is(name, names[i]))
            return count - i;
    return 0;
}

SBI_API int sbi_loader_choose_regions(sbi_loader *loader, sbi_word name, int usable)
{
    int rank = usable ? sbi_region_field_rank(name) : 0;
    sbi_word before;
    if (rank <= loader->region_rank) {
        sbi_loader_ignore(loader, name);
        return 0;
    }
    before.text = loader->region_field;
    before.length = strlen(loader->region_field);
    if (loader->region_rank)
        sbi_loader_ignore(loader, before);
    loader->region_rank = rank;
    sbi_name_copy(loader->region_field, sizeof loader->region_field, name);
    return 1;
}

SBI_API sb_result sbi_loader_begin_regions(sbi_loader *loader)
{
    size_t count = (size_t)loader->source_count, before = (size_t)loader->region_cells;
    int *grown;
    if (loader->source_regions && count == before)
        return SB_OK;
    grown = (int *)sbi_alloc_zeroed(&loader->allocator, count, sizeof(int));
    if (!grown)
        return sbi_loader_no_memory(loader);
    if (loader->source_regions && before)
        memcpy(grown, loader->source_regions, before * sizeof(int));
    sbi_free(&loader->allocator, loader->source_regions);
    loader->source_regions = grown;
    loader->region_cells = loader->source_count;
    return SB_OK;
}

SBI_API sb_result sbi_loader_set_region(sbi_loader *loader, sbi_word name, int cell, double value)
{
    if (loader->region_rank == 0)
        return SB_OK;
    if (value >= INT_MIN && value <= INT_MAX && value == (double)(int)value) {
        loader->source_regions[cell] = (int)value;
        return SB_OK;
    }
    if (sbi_word_is(name, "region"))
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "the region of cell %d is not an integer: %g", cell,
                               value);
    loader->region_rank = 0;
    memset(loader->source_regions, 0, (size_t)loader->region_cells * sizeof(int));
    sbi_loader_ignore(loader, name);
    return SB_OK;
}

SBI_API sb_result sbi_loader_fail_kind(const sbi_loader *loader, int kind, const char *format, const char *first,
                                       const char *second)
{
    sbi_reader place = loader->reader;
    char message[160];
    place.line = loader->kind_line[kind];
    place.binary = 0;
    place.element = loader->kind_first[kind];
    snprintf(message, sizeof message, "%s%s%s", first, format, second);
    return sbi_reader_fail(&place, SB_ERROR_UNSUPPORTED, "%s", message);
}
