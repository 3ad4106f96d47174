/* mesh: arrays of a mesh: checked, allocated, copied, appended, freed. */
#include "mesh_private.h"

/* ---- life ---- */

SB_API void sb_mesh_free(sb_mesh *mesh)
{
    if (!mesh)
        return;
    sbi_free(&mesh->allocator, mesh->nodes);
    sbi_free(&mesh->allocator, mesh->elements);
    sbi_free(&mesh->allocator, mesh->regions);
    memset(mesh, 0, sizeof *mesh);
}

SBI_API void sbi_mesh_set_allocator(sb_allocator *target, const sb_allocator *allocator)
{
    memset(target, 0, sizeof *target);
    if (allocator)
        *target = *allocator;
}

/* sbi_mesh_allocate for any element. */
static int sbi_mesh_allocate_kind(sb_mesh *mesh, sbi_element element, int node_count, int element_count,
                                  int with_regions, const sb_allocator *allocator)
{
    size_t per_element = sizeof(int) * (size_t)sbi_element_node_count(element);
    memset(mesh, 0, sizeof *mesh);
    sbi_mesh_set_allocator(&mesh->allocator, allocator);
    mesh->nodes = (sb_vec3 *)sbi_alloc(allocator, (size_t)node_count, sizeof(sb_vec3));
    mesh->elements = (int *)sbi_alloc(allocator, (size_t)element_count, per_element);
    if (with_regions)
        mesh->regions = (int *)sbi_alloc(allocator, (size_t)element_count, sizeof(int));
    mesh->element_type = element.type;
    mesh->table = element.table;
    mesh->node_count = node_count;
    mesh->element_count = element_count;
    if (mesh->nodes && mesh->elements && (mesh->regions || !with_regions))
        return 1;
    sb_mesh_free(mesh);
    return 0;
}

SBI_API int sbi_mesh_allocate(sb_mesh *mesh, sb_element_type type, int node_count, int element_count, int with_regions,
                              const sb_allocator *allocator)
{
    return sbi_mesh_allocate_kind(mesh, sbi_element_make(type, NULL), node_count, element_count, with_regions,
                                  allocator);
}

SBI_API sb_result sbi_mesh_check_shape(const sb_mesh *mesh, sb_error *error)
{
    if (!mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh is NULL");
    if (mesh->element_type == SB_CUSTOM) {
        sb_result result = sb_element_table_check(mesh->table, error);
        if (result != SB_OK)
            return result;
    }
    if (sb_mesh_element_width(mesh) == 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh has unknown element type %d", (int)mesh->element_type);
    if (mesh->node_count < 0 || mesh->element_count < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh has %d nodes and %d elements", mesh->node_count,
                        mesh->element_count);
    if (mesh->node_count == 0 || mesh->element_count == 0)
        return sbi_fail(error, SB_ERROR_MESH, "mesh is empty: %d nodes, %d elements", mesh->node_count,
                        mesh->element_count);
    if (!mesh->nodes || !mesh->elements)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh has no array of %s", mesh->nodes ? "elements" : "nodes");
    return SB_OK;
}

SBI_API sb_result sbi_mesh_check_has_shape(const sb_mesh *mesh, sb_error *error)
{
    if (!sbi_mesh_is_cloud(mesh))
        return SB_OK;
    return sbi_fail(error, SB_ERROR_UNSUPPORTED, "%s is a cloud of nodes: it has no faces, edges or quality",
                    mesh->table->name);
}

SBI_API sb_result sbi_mesh_check_nodes(const sb_mesh *mesh, sb_error *error)
{
    for (int i = 0; i < mesh->node_count; i++)
        if (!sb_v3_is_finite(mesh->nodes[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d has a coordinate that is not finite", i);
    return SB_OK;
}

SBI_API int sbi_mesh_index_out_of_range(const sb_mesh *mesh, int element, int *index)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_mesh_element_width(mesh);
    for (int a = 0; a < n; a++) {
        if (nodes[a] < 0 || nodes[a] >= mesh->node_count) {
            *index = nodes[a];
            return 1;
        }
    }
    return 0;
}

SBI_API sb_result sbi_mesh_check_arrays(const sb_mesh *mesh, sb_error *error)
{
    int index = 0;
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result == SB_OK)
        result = sbi_mesh_check_nodes(mesh, error);
    for (int e = 0; result == SB_OK && e < mesh->element_count; e++)
        if (sbi_mesh_index_out_of_range(mesh, e, &index))
            result = sbi_fail_element(error, SB_ERROR_INDEX, e, "element %d refers to node %d of %d", e, index,
                                      mesh->node_count);
    return result;
}

SB_API sb_result sb_mesh_copy(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *copy, sb_error *error)
{
    sb_mesh made;
    size_t nodes_per_element;
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result != SB_OK)
        return result;
    if (!copy)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "copy is NULL");
    if (!sbi_mesh_allocate_kind(&made, sbi_mesh_element_kind(mesh), mesh->node_count, mesh->element_count,
                                mesh->regions != NULL, allocator))
        return sbi_mesh_no_memory(error);
    nodes_per_element = (size_t)sb_mesh_element_width(mesh);
    memcpy(made.nodes, mesh->nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
    memcpy(made.elements, mesh->elements, sizeof(int) * nodes_per_element * (size_t)mesh->element_count);
    if (mesh->regions)
        memcpy(made.regions, mesh->regions, sizeof(int) * (size_t)mesh->element_count);
    *copy = made;
    return SB_OK;
}

static void sbi_mesh_append_part(sb_mesh *to, const sb_mesh *part, int first_node, int first_element)
{
    size_t per_element = (size_t)sb_mesh_element_width(part);
    size_t count = per_element * (size_t)part->element_count;
    int *elements = to->elements + per_element * (size_t)first_element;
    memcpy(to->nodes + first_node, part->nodes, sizeof(sb_vec3) * (size_t)part->node_count);
    for (size_t k = 0; k < count; k++)
        elements[k] = part->elements[k] + first_node;
    for (int e = 0; to->regions && e < part->element_count; e++)
        to->regions[first_element + e] = part->regions ? part->regions[e] : 0;
}

SB_API sb_result sb_mesh_append(sb_mesh *mesh, const sb_mesh *other, sb_error *error)
{
    sb_mesh made;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result == SB_OK)
        result = sbi_mesh_check_arrays(other, error);
    if (result != SB_OK)
        return result;
    if (other->element_type != mesh->element_type)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a mesh of %s cannot be appended to one of %s",
                        sb_element_name(other->element_type), sb_element_name(mesh->element_type));
    if (mesh->element_type == SB_CUSTOM && other->table != mesh->table)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the two meshes have tables of different custom elements");
    if (other->node_count > INT_MAX - mesh->node_count || other->element_count > INT_MAX - mesh->element_count)
        return sbi_fail(error, SB_ERROR_MESH, "the two meshes have more than %d nodes or elements", INT_MAX);
    if (!sbi_mesh_allocate_kind(&made, sbi_mesh_element_kind(mesh), mesh->node_count + other->node_count,
                                mesh->element_count + other->element_count, mesh->regions || other->regions,
                                &mesh->allocator))
        return sbi_mesh_no_memory(error);
    sbi_mesh_append_part(&made, mesh, 0, 0);
    sbi_mesh_append_part(&made, other, mesh->node_count, mesh->element_count);
    sb_mesh_free(mesh);
    *mesh = made;
    return SB_OK;
}

SBI_API int sbi_mesh_compact_nodes(sb_mesh *mesh, int *keep)
{
    size_t indices = (size_t)mesh->element_count * (size_t)sb_mesh_element_width(mesh);
    int kept = 0, removed;
    for (int v = 0; v < mesh->node_count; v++) {
        if (keep[v] == v) {
            mesh->nodes[kept] = mesh->nodes[v];
            keep[v] = kept++;
        } else if (keep[v] >= 0) {
            keep[v] = keep[keep[v]]; /* its representative comes before it and has its new number */
        }
    }
    for (size_t i = 0; i < indices; i++)
        mesh->elements[i] = keep[mesh->elements[i]];
    removed = mesh->node_count - kept;
    mesh->node_count = kept;
    return removed;
}

SBI_API sb_result sbi_mesh_check_output(const sb_mesh *mesh, const void *output, sb_error *error)
{
    if (!output)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the output is NULL");
    return sbi_mesh_check_arrays(mesh, error);
}
