/* meshio_build: from the cells of a file to a mesh of one element type. */
#include "meshio_reader.h"

#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* ---- from cells to one element type ---- */

/* The highest dimension in the file; counts the cells below it. */
static int sbi_loader_find_dimension(sbi_loader *loader)
{
    int dimension = 0;
    for (int kind = 0; kind < SBI_CELL_KINDS; kind++)
        if (loader->kind_count[kind] && sbi_cell_kind_at(kind)->dimension > dimension)
            dimension = sbi_cell_kind_at(kind)->dimension;
    loader->skipped_cells = 0;
    for (int kind = 0; kind < SBI_CELL_KINDS; kind++)
        if (sbi_cell_kind_at(kind)->dimension < dimension)
            loader->skipped_cells += loader->kind_count[kind];
    return dimension;
}

static int sbi_loader_is_flat_pair(sb_element_type a, sb_element_type b)
{
    return (a == SB_TRI3 && b == SB_QUAD4) || (a == SB_QUAD4 && b == SB_TRI3);
}

/* The one element type of the cells of the dimension; tri3 where triangles are mixed with quadrilaterals. */
static sb_result sbi_loader_find_type(const sbi_loader *loader, int dimension, sb_element_type *type)
{
    int first = -1;
    for (int kind = 0; kind < SBI_CELL_KINDS; kind++) {
        const sbi_cell_kind *about = sbi_cell_kind_at(kind);
        if (!loader->kind_count[kind] || about->dimension != dimension)
            continue;
        if (about->type == SB_NO_ELEMENT && about->shape == SBI_SHAPE_NONE)
            return sbi_loader_fail_kind(loader, kind, " elements are not supported", about->name, "");
        if (first < 0) {
            first = kind;
            *type = about->type;
        } else if (sbi_loader_is_flat_pair(*type, about->type)) {
            *type = SB_TRI3;
        } else if (*type != about->type || *type == SB_NO_ELEMENT) {
            return sbi_loader_fail_kind(loader, kind, " and ", sbi_cell_kind_at(first)->name, about->name);
        }
    }
    return SB_OK;
}

/* Quadrilaterals among triangles are two; volume cells that are cut are 1, 2, 3 or 6 tets. */
SBI_API int sbi_cell_elements(const sbi_cell *cell, sb_element_type type)
{
    static const int tets[5] = {0, 1, 2, 3, 6};
    const sbi_cell_kind *about = sbi_cell_kind_at(cell->kind);
    if (about->type == type)
        return 1;
    return about->dimension == 3 ? tets[about->shape] : 2;
}

SBI_API int sbi_cell_region(const sbi_loader *loader, const sbi_cell *cell)
{
    return loader->source_regions ? loader->source_regions[cell->source] : cell->region;
}

/* Number of elements the cells make. */
static int64_t sbi_loader_count_elements(const sbi_loader *loader, int dimension, sb_element_type type)
{
    int64_t count = 0;
    for (size_t i = 0; i < loader->cell_count; i++)
        if (sbi_cell_kind_at(loader->cells[i].kind)->dimension == dimension)
            count += sbi_cell_elements(&loader->cells[i], type);
    return count;
}

/* Regions of all elements. */
static void sbi_loader_copy_regions(const sbi_loader *loader, int dimension, sb_mesh *mesh)
{
    int element = 0;
    for (size_t i = 0; i < loader->cell_count; i++) {
        const sbi_cell *cell = &loader->cells[i];
        if (sbi_cell_kind_at(cell->kind)->dimension != dimension)
            continue;
        for (int part = sbi_cell_elements(cell, mesh->element_type); part > 0; part--)
            mesh->regions[element++] = sbi_cell_region(loader, cell);
    }
}

/* Copies the cells of the dimension; a quadrilateral among triangles becomes 0 1 2 and 0 2 3. */
static void sbi_loader_copy_cells(sbi_loader *loader, int dimension, sb_mesh *mesh)
{
    int nodes = sb_element_node_count(mesh->element_type);
    const int *from = loader->indices;
    int *to = mesh->elements;
    for (size_t i = 0; i < loader->cell_count; i++) {
        const sbi_cell_kind *about = sbi_cell_kind_at(loader->cells[i].kind);
        int parts = about->type == mesh->element_type ? 1 : 2;
        for (int part = 0; part < parts && about->dimension == dimension; part++, to += nodes)
            for (int a = 0; a < nodes; a++)
                to[a] = from[a == 0 ? 0 : a + part];
        if (parts == 2 && about->dimension == dimension)
            loader->split_polygons++;
        from += about->nodes;
    }
}

static int sbi_loader_any_region(const int *regions, int count)
{
    for (int i = 0; i < count; i++)
        if (regions[i])
            return 1;
    return 0;
}

SBI_API sb_result sbi_loader_build(sbi_loader *loader, sb_mesh *mesh)
{
    int dimension = sbi_loader_find_dimension(loader), nodes;
    int split = dimension == 3;
    sb_element_type type = SB_NO_ELEMENT;
    int64_t count;
    sb_result result = SB_OK;
    loader->reader.element = loader->reader.node = -1;
    if (dimension < 2)
        return sbi_reader_fail(&loader->reader, SB_ERROR_MESH, "the file has no faces and no volume elements");
    split = split && sbi_split_wanted(loader, &type);
    if (!split)
        result = sbi_loader_find_type(loader, dimension, &type);
    if (result)
        return result;
    count = sbi_loader_count_elements(loader, dimension, type);
    if (count > INT_MAX)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 elements");
    nodes = sb_element_node_count(type);
    mesh->allocator = loader->allocator;
    mesh->element_type = type;
    mesh->element_count = (int)count;
    mesh->elements = (int *)sbi_alloc(&loader->allocator, (size_t)count, (size_t)nodes * sizeof(int));
    mesh->regions = (int *)sbi_alloc(&loader->allocator, (size_t)count, sizeof(int));
    if (!mesh->elements || !mesh->regions)
        return sbi_loader_no_memory(loader);
    if (split)
        result = sbi_split_cells(loader, mesh);
    else
        sbi_loader_copy_cells(loader, dimension, mesh);
    if (result)
        return result;
    sbi_loader_copy_regions(loader, dimension, mesh);
    if (!sbi_loader_any_region(mesh->regions, mesh->element_count)) {
        sbi_free(&loader->allocator, mesh->regions);
        mesh->regions = NULL;
    }
    mesh->node_count = (int)loader->node_count;
    mesh->nodes = loader->nodes;
    loader->nodes = NULL;
    loader->node_count = loader->node_capacity = 0;
    return SB_OK;
}
