/* mesh: checks, geometry, repairs, topology, reordering.
 *
 * Faces, edges and whole elements are compared through their corner nodes sorted ascending ("keys"). Sorting
 * the keys column by column with counting sort takes linear time whatever the numbering, needs no hashing,
 * and leaves equal keys side by side in the order of the elements, so every result is unique. */
#include "mesh.h"

#include <limits.h>
#include <stdio.h>
#include <string.h>

#define SBI_MESH_LISTED 8 /* elements that an error message names */

static sb_result sbi_mesh_no_memory(sb_error *error)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the tables of a mesh");
}

static const int *sbi_mesh_element(const sb_mesh *mesh, int element)
{
    return mesh->elements + (size_t)element * (size_t)sb_mesh_element_width(mesh);
}

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

static void sbi_mesh_set_allocator(sb_allocator *target, const sb_allocator *allocator)
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

SBI_API int sbi_mesh_allocate(sb_mesh *mesh, sb_element_type type, int node_count, int element_count,
                              int with_regions, const sb_allocator *allocator)
{
    return sbi_mesh_allocate_kind(mesh, sbi_element_make(type, NULL), node_count, element_count, with_regions,
                                  allocator);
}

/* Counts, type and pointers; what the arrays hold is not looked at. */
static sb_result sbi_mesh_check_shape(const sb_mesh *mesh, sb_error *error)
{
    if (!mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh is NULL");
    if (mesh->element_type == SB_CUSTOM) {
        sb_result result = sb_element_table_check(mesh->table, error);
        if (result != SB_OK)
            return result;
    }
    if (sb_mesh_element_width(mesh) == 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh has unknown element type %d",
                        (int)mesh->element_type);
    if (mesh->node_count < 0 || mesh->element_count < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh has %d nodes and %d elements", mesh->node_count,
                        mesh->element_count);
    if (mesh->node_count == 0 || mesh->element_count == 0)
        return sbi_fail(error, SB_ERROR_MESH, "mesh is empty: %d nodes, %d elements", mesh->node_count,
                        mesh->element_count);
    if (!mesh->nodes || !mesh->elements)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh has no array of %s",
                        mesh->nodes ? "elements" : "nodes");
    return SB_OK;
}

static sb_result sbi_mesh_check_nodes(const sb_mesh *mesh, sb_error *error)
{
    for (int i = 0; i < mesh->node_count; i++)
        if (!sb_v3_is_finite(mesh->nodes[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d has a coordinate that is not finite",
                                 i);
    return SB_OK;
}

/* An index of the element that names no node, through *index; 0 when there is none. */
static int sbi_mesh_index_out_of_range(const sb_mesh *mesh, int element, int *index)
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
            result = sbi_fail_element(error, SB_ERROR_INDEX, e, "element %d refers to node %d of %d", e,
                                      index, mesh->node_count);
    return result;
}

SB_API sb_result sb_mesh_copy(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *copy,
                              sb_error *error)
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

/* ---- Jacobians ---- */

/* hex27 has the most: its nodes and its 27 points. */
enum { SBI_MESH_SAMPLES = SB_MAX_ELEMENT_NODES + SB_MAX_QUADRATURE_POINTS, SBI_MESH_NODES = SB_MAX_ELEMENT_NODES };

/* Shape functions at a set of points, made once for all elements. */
typedef struct sbi_mesh_table {
    int count;
    sb_real weight[SBI_MESH_SAMPLES];
    sb_real shape[SBI_MESH_SAMPLES][SBI_MESH_NODES];
    sb_real gradient[SBI_MESH_SAMPLES][SBI_MESH_NODES][3];
} sbi_mesh_table;

static void sbi_mesh_table_add(sbi_mesh_table *table, sbi_element element, const sb_real xi[3], sb_real weight)
{
    sbi_element_shape(element, xi, table->shape[table->count], table->gradient[table->count]);
    table->weight[table->count++] = weight;
}

static void sbi_mesh_table_add_rule(sbi_mesh_table *table, sbi_element element, sb_quadrature_kind kind)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    int count = sbi_element_quadrature(element, kind, points, weights);
    for (int i = 0; i < count; i++)
        sbi_mesh_table_add(table, element, points[i], weights[i]);
}

/* The points to integrate volumes and areas with: exact for all volumes (tet10: degree 3; custom: the mass points). */
static void sbi_mesh_table_for_volume(sbi_mesh_table *table, sbi_element element)
{
    table->count = 0;
    sbi_mesh_table_add_rule(table, element,
                            element.table ? SB_QUADRATURE_MASS : SB_QUADRATURE_STIFFNESS_CURVED);
}

/* The points where a Jacobian must be positive: all nodes first; tet10: also the face centroids (the last
 * four of its 8-point rule) and the 14 points of its mass rule; hexes: also Gauss points, hex20 at the nodes of hex27.
 * Custom elements: their points only, since gradients may have no value at nodes. Quads: the corners alone. */
static void sbi_mesh_table_for_checks(sbi_mesh_table *table, sbi_element element)
{
    sb_real xi[3] = {0, 0, 0}, points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_element_type type = element.type, sampled = type == SB_HEX20 ? SB_HEX27 : type;
    table->count = 0;
    if (sb_element_straight(type) == SB_QUAD4)
        element = sbi_element_make(SB_QUAD4, NULL), sampled = SB_QUAD4;
    for (int a = 0; sb_element_node_point(sampled, a, xi); a++)
        sbi_mesh_table_add(table, element, xi, 0);
    if (type == SB_TET10) {
        sb_element_quadrature(type, SB_QUADRATURE_STIFFNESS_CURVED, points, weights);
        for (int i = 4; i < 8; i++)
            sbi_mesh_table_add(table, element, points[i], 0);
    }
    if (type == SB_CUSTOM)
        sbi_mesh_table_add_rule(table, element, SB_QUADRATURE_STIFFNESS);
    if (sb_element_dimension(type) == 3 && type != SB_TET4)
        sbi_mesh_table_add_rule(table, element, SB_QUADRATURE_MASS);
}

/* An element's nodes relative to its first and divided by its largest extent `size` (m), so that no product
 * over- or underflows at any scale of the mesh; `rounding`: bound of the relative error of a Jacobian made
 * from them. */
typedef struct sbi_mesh_local {
    sb_vec3 x[SBI_MESH_NODES];
    sb_real size, rounding;
} sbi_mesh_local;

static sb_real sbi_mesh_max_abs(sb_vec3 v) { return sb_max(sb_abs(v.x), sb_max(sb_abs(v.y), sb_abs(v.z))); }

static void sbi_mesh_local_make(const sb_mesh *mesh, int element, sbi_mesh_local *local)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_mesh_element_width(mesh);
    sb_vec3 origin = mesh->nodes[nodes[0]];
    sb_real magnitude = 0;
    local->size = 0;
    for (int a = 0; a < n; a++) {
        local->x[a] = sb_v3_sub(mesh->nodes[nodes[a]], origin);
        local->size = sb_max(local->size, sbi_mesh_max_abs(local->x[a]));
        magnitude = sb_max(magnitude, sbi_mesh_max_abs(mesh->nodes[nodes[a]]));
    }
    local->rounding = 8 * SB_EPSILON; /* coordinates carry an absolute error of eps * magnitude */
    if (local->size > 0) {
        local->rounding *= 1 + magnitude / local->size;
        for (int a = 0; a < n; a++)
            local->x[a] =
                sb_v3(local->x[a].x / local->size, local->x[a].y / local->size, local->x[a].z / local->size);
    }
}

/* Columns dx/dxi at sample `point` of the table. */
static sb_mat3 sbi_mesh_jacobian(const sbi_mesh_table *table, int point, int node_count, const sb_vec3 *x)
{
    sb_vec3 column[3];
    for (int k = 0; k < 3; k++) {
        column[k] = sb_v3(0, 0, 0);
        for (int a = 0; a < node_count; a++)
            column[k] = sb_v3_madd(column[k], table->gradient[point][a][k], x[a]);
    }
    return sb_m3_columns(column[0], column[1], column[2]);
}

static sb_real sbi_mesh_corner_det(const sb_vec3 *x)
{
    return sb_m3_det(sb_m3_columns(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0]), sb_v3_sub(x[3], x[0])));
}

/* ---- defects of one element ---- */

/* Smallest Jacobian at a corner of the hex8 with these corners: an eighth of the triple product of its edges there. */
static sb_real sbi_mesh_hex_corner_det(const sb_vec3 *x)
{
    static const signed char beside[8][3] = {{1, 3, 4}, {2, 0, 5}, {3, 1, 6}, {0, 2, 7},
                                             {7, 5, 0}, {4, 6, 1}, {5, 7, 2}, {6, 4, 3}};
    sb_real least = SB_REAL_MAX;
    for (int a = 0; a < 8; a++) {
        sb_mat3 edges = sb_m3_columns(sb_v3_sub(x[beside[a][0]], x[a]), sb_v3_sub(x[beside[a][1]], x[a]),
                                      sb_v3_sub(x[beside[a][2]], x[a]));
        sb_real det = sb_m3_det(edges) / 8;
        if (!(det >= least))
            least = det;
    }
    return least;
}

static sb_mesh_defect sbi_mesh_defect_of_sign(sb_real det, sb_real rounding)
{
    if (det > rounding)
        return SB_MESH_SOUND;
    return det < -rounding ? SB_MESH_INVERTED
                           : SB_MESH_FLAT; /* flat: also NaN from coordinates near the largest */
}

/* Worst sign of the Jacobian over the table's points, inverted before flat. */
static sb_mesh_defect sbi_mesh_sampled_defect(const sbi_mesh_table *table, int node_count,
                                              const sbi_mesh_local *local)
{
    sb_mesh_defect worst = SB_MESH_SOUND;
    for (int i = 0; i < table->count; i++) {
        sb_real det = sb_m3_det(sbi_mesh_jacobian(table, i, node_count, local->x));
        sb_mesh_defect defect = sbi_mesh_defect_of_sign(det, local->rounding);
        if (defect == SB_MESH_INVERTED)
            return defect;
        if (defect != SB_MESH_SOUND)
            worst = defect;
    }
    return worst;
}

static sb_mesh_defect sbi_mesh_shape_defect(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    int n = sb_mesh_element_width(mesh);
    sb_mesh_defect defect;
    sbi_mesh_local local;
    sbi_mesh_local_make(mesh, element, &local);
    if (sb_element_dimension(mesh->element_type) == 2) {
        int is_quad = sb_element_straight(mesh->element_type) == SB_QUAD4;
        sb_vec3 across = is_quad ? sb_v3_sub(local.x[3], local.x[1]) : local.x[1];
        return sb_v3_norm(sb_v3_cross(local.x[2], across)) > local.rounding ? SB_MESH_SOUND : SB_MESH_FLAT;
    }
    if (mesh->element_type == SB_HEX8 || mesh->element_type == SB_CUSTOM)
        return sbi_mesh_sampled_defect(table, n, &local);
    defect = sbi_mesh_defect_of_sign(sb_element_straight(mesh->element_type) == SB_HEX8
                                         ? sbi_mesh_hex_corner_det(local.x)
                                         : sbi_mesh_corner_det(local.x),
                                     local.rounding);
    if (defect != SB_MESH_SOUND || mesh->element_type == SB_TET4)
        return defect;
    return sbi_mesh_sampled_defect(table, n, &local) == SB_MESH_SOUND ? SB_MESH_SOUND : SB_MESH_BAD_MIDSIDE;
}

static int sbi_mesh_has_repeated_node(const int *nodes, int count)
{
    for (int a = 1; a < count; a++)
        for (int b = 0; b < a; b++)
            if (nodes[a] == nodes[b])
                return 1;
    return 0;
}

/* First defect that an element has by itself (so not SB_MESH_DUPLICATE). */
static sb_mesh_defect sbi_mesh_element_defect(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_mesh_element_width(mesh), index;
    if (sbi_mesh_index_out_of_range(mesh, element, &index))
        return SB_MESH_INDEX_RANGE;
    for (int a = 0; a < n; a++)
        if (!sb_v3_is_finite(mesh->nodes[nodes[a]]))
            return SB_MESH_NODE_NOT_FINITE;
    if (sbi_mesh_has_repeated_node(nodes, n))
        return SB_MESH_REPEATED_NODE;
    return sbi_mesh_shape_defect(mesh, table, element);
}

/* ---- validation ---- */

/* The elements with one kind of defect: how many, and the first few. */
typedef struct sbi_mesh_offenders {
    int count;
    int first[SBI_MESH_LISTED];
} sbi_mesh_offenders;

static const char *sbi_mesh_defect_text(sb_mesh_defect defect)
{
    switch (defect) {
    case SB_MESH_INDEX_RANGE: return "with a node index out of range";
    case SB_MESH_NODE_NOT_FINITE: return "with a node that is not finite";
    case SB_MESH_REPEATED_NODE: return "with a node used twice";
    case SB_MESH_INVERTED: return "inverted (negative volume)";
    case SB_MESH_FLAT: return "flat (zero volume)";
    case SB_MESH_BAD_MIDSIDE: return "folded by a misplaced mid-edge node";
    case SB_MESH_DUPLICATE: return "with the corners of an element before it";
    case SB_MESH_SOUND:
    case SB_MESH_DEFECT_COUNT: break;
    }
    return "sound";
}

/* "3 elements inverted (negative volume): 3, 17, 40" */
static sb_result sbi_mesh_fail_elements(const sb_mesh *mesh, const sbi_mesh_offenders *offenders,
                                        sb_mesh_defect defect, sb_error *error)
{
    char list[16 * SBI_MESH_LISTED], index_text[64];
    size_t used = 0;
    int listed = offenders->count < SBI_MESH_LISTED ? offenders->count : SBI_MESH_LISTED, index = 0;
    list[0] = index_text[0] = 0;
    for (int i = 0; i < listed; i++)
        used += (size_t)snprintf(list + used, sizeof list - used, "%s%d", i ? ", " : "", offenders->first[i]);
    if (defect == SB_MESH_INDEX_RANGE && sbi_mesh_index_out_of_range(mesh, offenders->first[0], &index))
        snprintf(index_text, sizeof index_text, " (the first: %d of %d nodes)", index, mesh->node_count);
    return sbi_fail_element(error, defect == SB_MESH_INDEX_RANGE ? SB_ERROR_INDEX : SB_ERROR_MESH,
                            offenders->first[0], "%d element%s %s%s: %s%s", offenders->count,
                            offenders->count == 1 ? "" : "s", sbi_mesh_defect_text(defect), index_text, list,
                            offenders->count > listed ? ", ..." : "");
}

SB_API sb_result sb_mesh_validate(const sb_mesh *mesh, sb_error *error)
{
    static const sb_mesh_defect order[] = {SB_MESH_INDEX_RANGE, SB_MESH_REPEATED_NODE, SB_MESH_INVERTED,
                                           SB_MESH_FLAT, SB_MESH_BAD_MIDSIDE};
    sbi_mesh_offenders found[SB_MESH_DEFECT_COUNT];
    sbi_mesh_table table;
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result == SB_OK)
        result = sbi_mesh_check_nodes(mesh, error);
    if (result != SB_OK)
        return result;
    memset(found, 0, sizeof found);
    sbi_mesh_table_for_checks(&table, sbi_mesh_element_kind(mesh));
    for (int e = 0; e < mesh->element_count; e++) {
        sb_mesh_defect defect = sbi_mesh_element_defect(mesh, &table, e);
        if (found[defect].count < SBI_MESH_LISTED)
            found[defect].first[found[defect].count] = e;
        found[defect].count++;
    }
    if (sb_element_dimension(mesh->element_type) == 2)
        found[SB_MESH_FLAT].count = 0; /* a sliver triangle harms no target or visual surface */
    for (size_t i = 0; i < sizeof order / sizeof order[0]; i++)
        if (found[order[i]].count)
            return sbi_mesh_fail_elements(mesh, &found[order[i]], order[i], error);
    return SB_OK;
}

/* ---- keys: faces, edges and elements by their sorted corners ---- */

SBI_API void sbi_mesh_keys_free(const sb_allocator *allocator, sbi_mesh_keys *keys)
{
    sbi_free(allocator, keys->keys);
    sbi_free(allocator, keys->order);
    memset(keys, 0, sizeof *keys);
}

/* Local corner numbers of a part of an element; returns how many. */
static int sbi_mesh_part_corners(sbi_element element, sbi_mesh_part part, int index,
                                 int corners[SB_MAX_ELEMENT_NODES])
{
    sb_element_type face_type = SB_NO_ELEMENT;
    if (part == SBI_MESH_WHOLE) {
        int count = sbi_element_corner_count(element);
        for (int a = 0; a < count; a++)
            corners[a] = a;
        return count;
    }
    if (part == SBI_MESH_EDGES || sb_element_dimension(element.type) == 2) {
        sbi_element_edge(element, index, corners);
        return 2;
    }
    sbi_element_face(element, index, corners, &face_type);
    return sb_element_corner_count(face_type);
}

static int sbi_mesh_parts_per_element(sbi_element element, sbi_mesh_part part)
{
    if (part == SBI_MESH_WHOLE)
        return 1;
    return part == SBI_MESH_EDGES || sb_element_dimension(element.type) == 2 ? sbi_element_edge_count(element)
                                                                             : sbi_element_face_count(element);
}

static void sbi_mesh_insertion_sort(int *values, int count)
{
    for (int i = 1; i < count; i++) {
        int value = values[i], j = i;
        for (; j > 0 && values[j - 1] > value; j--)
            values[j] = values[j - 1];
        values[j] = value;
    }
}

static void sbi_mesh_keys_fill(const sb_mesh *mesh, sbi_mesh_part part, const unsigned char *skip,
                               sbi_mesh_keys *keys)
{
    int corners[SB_MAX_ELEMENT_EDGES][SB_MAX_ELEMENT_NODES], count[SB_MAX_ELEMENT_EDGES];
    for (int i = 0; i < keys->per_element; i++)
        count[i] = sbi_mesh_part_corners(sbi_mesh_element_kind(mesh), part, i, corners[i]);
    keys->sorted = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        for (int i = 0; i < keys->per_element && !(skip && skip[e]); i++) {
            int p = e * keys->per_element + i;
            int *key = keys->keys + (size_t)p * (size_t)keys->width;
            for (int k = 0; k < count[i]; k++)
                key[k] = nodes[corners[i][k]];
            sbi_mesh_insertion_sort(key, count[i]);
            for (int k = count[i]; k < keys->width; k++)
                key[k] = key[k - 1];
            keys->order[keys->sorted++] = p;
        }
    }
}

/* One stable counting sort of the order by a column of the keys; start has node_count + 1 entries. */
static void sbi_mesh_sort_column(const sbi_mesh_keys *keys, int column, int node_count, const int *from,
                                 int *to, int *start)
{
    const int *value = keys->keys + column;
    memset(start, 0, sizeof(int) * ((size_t)node_count + 1));
    for (int i = 0; i < keys->sorted; i++)
        start[value[(size_t)from[i] * (size_t)keys->width] + 1]++;
    for (int v = 0; v < node_count; v++)
        start[v + 1] += start[v];
    for (int i = 0; i < keys->sorted; i++)
        to[start[value[(size_t)from[i] * (size_t)keys->width]]++] = from[i];
}

static int sbi_mesh_keys_sort(const sb_allocator *allocator, sbi_mesh_keys *keys, int node_count)
{
    int *other = (int *)sbi_alloc(allocator, (size_t)keys->sorted, sizeof(int));
    int *start = (int *)sbi_alloc(allocator, (size_t)node_count + 1, sizeof(int));
    int ok = other && start;
    for (int column = keys->width - 1; ok && column >= 0; column--) {
        int *swap = keys->order;
        sbi_mesh_sort_column(keys, column, node_count, keys->order, other, start);
        keys->order = other;
        other = swap;
    }
    sbi_free(allocator, other);
    sbi_free(allocator, start);
    return ok;
}

SBI_API int sbi_mesh_keys_make(const sb_mesh *mesh, sbi_mesh_part part, const unsigned char *skip,
                               const sb_allocator *allocator, sbi_mesh_keys *keys)
{
    int corners[SB_MAX_ELEMENT_NODES];
    sbi_element element = sbi_mesh_element_kind(mesh);
    memset(keys, 0, sizeof *keys);
    keys->per_element = sbi_mesh_parts_per_element(element, part);
    for (int i = 0; i < keys->per_element; i++)
        keys->width = sbi_max_int(keys->width, sbi_mesh_part_corners(element, part, i, corners));
    if (mesh->element_count > INT_MAX / keys->per_element)
        return 0;
    keys->count = mesh->element_count * keys->per_element;
    keys->keys = (int *)sbi_alloc(allocator, (size_t)keys->count, sizeof(int) * (size_t)keys->width);
    keys->order = (int *)sbi_alloc(allocator, (size_t)keys->count, sizeof(int));
    if (keys->keys && keys->order) {
        sbi_mesh_keys_fill(mesh, part, skip, keys);
        if (sbi_mesh_keys_sort(allocator, keys, mesh->node_count))
            return 1;
    }
    sbi_mesh_keys_free(allocator, keys);
    return 0;
}

SBI_API int sbi_mesh_run_end(const sbi_mesh_keys *keys, int begin)
{
    size_t width = (size_t)keys->width;
    const int *key = keys->keys + (size_t)keys->order[begin] * width;
    int end = begin + 1;
    while (end < keys->sorted &&
           memcmp(key, keys->keys + (size_t)keys->order[end] * width, sizeof(int) * width) == 0)
        end++;
    return end;
}

enum { SBI_MESH_ALONE = -1, SBI_MESH_CROWDED = -2 };

/* mate[part]: the one other part with the same key, or ALONE, or CROWDED (two others or more, or skipped). */
static int *sbi_mesh_mates(const sbi_mesh_keys *keys, const sb_allocator *allocator)
{
    int *mate = (int *)sbi_alloc(allocator, (size_t)keys->count, sizeof(int));
    for (int p = 0; mate && p < keys->count; p++)
        mate[p] = SBI_MESH_CROWDED;
    for (int begin = 0, end; mate && begin < keys->sorted; begin = end) {
        end = sbi_mesh_run_end(keys, begin);
        if (end == begin + 1)
            mate[keys->order[begin]] = SBI_MESH_ALONE;
        if (end == begin + 2) {
            mate[keys->order[begin]] = keys->order[begin + 1];
            mate[keys->order[begin + 1]] = keys->order[begin];
        }
    }
    return mate;
}

/* ---- disjoint sets ---- */

static int sbi_mesh_find(int *parent, int i)
{
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}

/* The smaller root becomes the root of both, so roots come first in every numbering. */
static void sbi_mesh_unite(int *parent, int a, int b)
{
    int root_a = sbi_mesh_find(parent, a), root_b = sbi_mesh_find(parent, b);
    if (root_a < root_b)
        parent[root_b] = root_a;
    else
        parent[root_a] = root_b;
}

/* Labels of the parts that share nodes, in the order of their first elements; skipped elements get -1.
 * scratch: [node_count]. Returns the number of parts. */
static int sbi_mesh_label_components(const sb_mesh *mesh, const unsigned char *skip, int *label, int *scratch)
{
    int n = sb_mesh_element_width(mesh), count = 0;
    for (int v = 0; v < mesh->node_count; v++)
        scratch[v] = -1;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        label[e] = e;
        for (int a = 0; a < n && !(skip && skip[e]); a++) {
            if (scratch[nodes[a]] < 0)
                scratch[nodes[a]] = e;
            else
                sbi_mesh_unite(label, e, scratch[nodes[a]]);
        }
    }
    /* Roots precede their members: flatten in order, numbering roots as -2 - number until all are reached. */
    for (int e = 0; e < mesh->element_count; e++)
        label[e] = sbi_mesh_find(label, e);
    for (int e = 0; e < mesh->element_count; e++) {
        if (skip && skip[e])
            label[e] = -1;
        else
            label[e] = label[e] == e ? -2 - count++ : label[label[e]];
    }
    for (int e = 0; e < mesh->element_count; e++)
        label[e] = label[e] == -1 ? -1 : -2 - label[e];
    return count;
}

/* ---- nodes that coincide ---- */

typedef struct sbi_mesh_grid {
    sb_vec3 low;
    sb_real cell, tolerance; /* m */
    uint64_t mask;           /* buckets - 1 */
    int *head;               /* [buckets] last node of each bucket, or -1 */
    int *next;               /* [nodes] */
} sbi_mesh_grid;

static int64_t sbi_mesh_grid_cell(sb_real position)
{
    int64_t cell = (int64_t)position;
    return (sb_real)cell > position ? cell - 1 : cell;
}

static size_t sbi_mesh_grid_bucket(const sbi_mesh_grid *grid, int64_t i, int64_t j, int64_t k)
{
    uint64_t hash = (uint64_t)i * 0x9E3779B97F4A7C15u;
    hash = (hash ^ (hash >> 29) ^ (uint64_t)j) * 0xBF58476D1CE4E5B9u;
    hash = (hash ^ (hash >> 32) ^ (uint64_t)k) * 0x94D049BB133111EBu;
    return (size_t)((hash ^ (hash >> 31)) & grid->mask);
}

static int sbi_mesh_is_near(sb_vec3 a, sb_vec3 b, sb_real tolerance)
{
    sb_vec3 d = sb_v3_sub(a, b);
    if (tolerance <= 0)
        return d.x == 0 && d.y == 0 && d.z == 0;
    d = sb_v3(d.x / tolerance, d.y / tolerance, d.z / tolerance);
    return sb_v3_dot(d, d) <= 1;
}

/* Smallest node of the grid within tolerance of node `node`, or -1. */
static int sbi_mesh_grid_find(const sbi_mesh_grid *grid, const sb_vec3 *nodes, int node)
{
    const sb_real reach = grid->tolerance;
    sb_vec3 d = sb_v3_sub(nodes[node], grid->low);
    int64_t i1 = sbi_mesh_grid_cell((d.x + reach) / grid->cell),
            j1 = sbi_mesh_grid_cell((d.y + reach) / grid->cell),
            k1 = sbi_mesh_grid_cell((d.z + reach) / grid->cell);
    int best = -1;
    for (int64_t i = sbi_mesh_grid_cell((d.x - reach) / grid->cell); i <= i1; i++)
        for (int64_t j = sbi_mesh_grid_cell((d.y - reach) / grid->cell); j <= j1; j++)
            for (int64_t k = sbi_mesh_grid_cell((d.z - reach) / grid->cell); k <= k1; k++)
                for (int v = grid->head[sbi_mesh_grid_bucket(grid, i, j, k)]; v >= 0; v = grid->next[v])
                    if ((best < 0 || v < best) && sbi_mesh_is_near(nodes[v], nodes[node], reach))
                        best = v;
    return best;
}

static void sbi_mesh_grid_add(const sbi_mesh_grid *grid, const sb_vec3 *nodes, int node)
{
    sb_vec3 d = sb_v3_sub(nodes[node], grid->low);
    size_t bucket =
        sbi_mesh_grid_bucket(grid, sbi_mesh_grid_cell(d.x / grid->cell), sbi_mesh_grid_cell(d.y / grid->cell),
                             sbi_mesh_grid_cell(d.z / grid->cell));
    grid->next[node] = grid->head[bucket];
    grid->head[bucket] = node;
}

/* Box around the finite nodes; 0 when there are none. */
static int sbi_mesh_finite_bounds(const sb_mesh *mesh, sb_vec3 *low, sb_vec3 *high)
{
    int found = 0;
    for (int v = 0; v < mesh->node_count; v++) {
        sb_vec3 x = mesh->nodes[v];
        if (!sb_v3_is_finite(x))
            continue;
        *low = found ? sb_v3(sb_min(low->x, x.x), sb_min(low->y, x.y), sb_min(low->z, x.z)) : x;
        *high = found ? sb_v3(sb_max(high->x, x.x), sb_max(high->y, x.y), sb_max(high->z, x.z)) : x;
        found = 1;
    }
    return found;
}

/* Cells of four tolerances keep the nodes per cell few and mostly spare a look at the neighbours; never below
 * the spacing of numbers, so that cell indices fit. 0: the box is too large for its size to be a number. */
static int sbi_mesh_grid_setup(const sb_mesh *mesh, sb_real tolerance, sbi_mesh_grid *grid)
{
    sb_vec3 high = sb_v3(0, 0, 0);
    sb_real extent;
    grid->low = high;
    sbi_mesh_finite_bounds(mesh, &grid->low, &high);
    extent = sbi_mesh_max_abs(sb_v3_sub(high, grid->low));
    if (!sb_is_finite(2 * extent))
        return 0;
    grid->tolerance = tolerance < 0 ? (sb_real)1e-6 * extent : sb_min(tolerance, 2 * extent);
    grid->cell = sb_max(4 * (grid->tolerance < extent ? grid->tolerance : extent), 4 * SB_EPSILON * extent);
    if (!(grid->cell > 0))
        grid->cell = 1; /* all nodes in one point */
    return 1;
}

SBI_API int sbi_mesh_find_duplicates(const sb_mesh *mesh, sb_real tolerance, const sb_allocator *allocator,
                                     int *representative)
{
    sbi_mesh_grid grid;
    size_t buckets = 1;
    int removed = 0;
    for (int v = 0; v < mesh->node_count; v++)
        representative[v] = v;
    if (!sbi_mesh_grid_setup(mesh, tolerance, &grid))
        return 0;
    while (buckets < (size_t)mesh->node_count)
        buckets *= 2;
    grid.mask = buckets - 1;
    grid.head = (int *)sbi_alloc(allocator, buckets, sizeof(int));
    grid.next = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    for (size_t i = 0; grid.head && i < buckets; i++)
        grid.head[i] = -1;
    for (int v = 0; grid.head && grid.next && v < mesh->node_count; v++) {
        int near = sb_v3_is_finite(mesh->nodes[v]) ? sbi_mesh_grid_find(&grid, mesh->nodes, v) : v;
        if (near < 0)
            sbi_mesh_grid_add(&grid, mesh->nodes, v);
        else if (near != v)
            representative[v] = near, removed++;
    }
    if (!grid.head || !grid.next)
        removed = -1;
    sbi_free(allocator, grid.head);
    sbi_free(allocator, grid.next);
    return removed;
}

/* ---- geometry ---- */

static sb_real sbi_mesh_volume_of(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_mesh_element_width(mesh);
    sb_vec3 x[SBI_MESH_NODES];
    sb_real volume = 0;
    for (int a = 0; a < n; a++)
        x[a] = sb_v3_sub(mesh->nodes[nodes[a]], mesh->nodes[nodes[0]]);
    if (mesh->element_type == SB_TET4)
        return sb_v3_dot(x[1], sb_v3_cross(x[2], x[3])) / 6;
    for (int i = 0; i < table->count; i++)
        volume += table->weight[i] * sb_m3_det(sbi_mesh_jacobian(table, i, n, x));
    return volume;
}

/* Area of a surface element and its share of the enclosed volume, the flux of (x - origin) / 3 through it. */
static void sbi_mesh_area_and_flux(const sb_mesh *mesh, const sbi_mesh_table *table, int element,
                                   sb_vec3 origin, double *area, double *flux)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_mesh_element_width(mesh);
    sb_vec3 x[SBI_MESH_NODES], offset = sb_v3_sub(mesh->nodes[nodes[0]], origin);
    *area = *flux = 0;
    for (int a = 0; a < n; a++)
        x[a] = sb_v3_sub(mesh->nodes[nodes[a]], mesh->nodes[nodes[0]]);
    for (int i = 0; i < table->count; i++) {
        sb_mat3 jacobian = sbi_mesh_jacobian(table, i, n, x);
        sb_vec3 normal = sb_v3_cross(sb_m3_column(jacobian, 0), sb_m3_column(jacobian, 1)), point = offset;
        for (int a = 0; a < n; a++)
            point = sb_v3_madd(point, table->shape[i][a], x[a]);
        *area += (double)(table->weight[i] * sb_v3_norm(normal));
        *flux += (double)(table->weight[i] * sb_v3_dot(point, normal)) / 3;
    }
}

static int sbi_mesh_has_element(const sb_mesh *mesh, int element)
{
    return mesh && mesh->nodes && mesh->elements && element >= 0 && element < mesh->element_count &&
           sb_mesh_element_width(mesh) > 0;
}

SB_API sb_real sb_mesh_element_volume(const sb_mesh *mesh, int element)
{
    sbi_mesh_table table;
    if (!sbi_mesh_has_element(mesh, element) || sb_element_dimension(mesh->element_type) != 3)
        return 0;
    sbi_mesh_table_for_volume(&table, sbi_mesh_element_kind(mesh));
    return sbi_mesh_volume_of(mesh, &table, element);
}

/* Sums in double, so that a float build's total is as good as its elements. bad (or NULL) marks elements to
 * leave out. */
static void sbi_mesh_measure(const sb_mesh *mesh, const unsigned char *bad, double *area, double *volume)
{
    sbi_mesh_table table;
    sb_vec3 origin = sb_v3(0, 0, 0);
    int has_origin = 0;
    *area = *volume = 0;
    sbi_mesh_table_for_volume(&table, sbi_mesh_element_kind(mesh));
    for (int e = 0; e < mesh->element_count; e++) {
        double element_area = 0, element_volume = 0;
        if (bad && bad[e])
            continue;
        if (!has_origin)
            origin = mesh->nodes[sbi_mesh_element(mesh, e)[0]], has_origin = 1;
        if (sb_element_dimension(mesh->element_type) == 3)
            element_volume = (double)sbi_mesh_volume_of(mesh, &table, e);
        else
            sbi_mesh_area_and_flux(mesh, &table, e, origin, &element_area, &element_volume);
        *area += element_area;
        *volume += element_volume;
    }
}

SB_API sb_real sb_mesh_volume(const sb_mesh *mesh)
{
    double area = 0, volume = 0;
    if (sbi_mesh_has_element(mesh, 0))
        sbi_mesh_measure(mesh, NULL, &area, &volume);
    return (sb_real)volume;
}

SB_API sb_real sb_mesh_surface_area(const sb_mesh *mesh)
{
    double area = 0, volume = 0;
    if (sbi_mesh_has_element(mesh, 0) && sb_element_dimension(mesh->element_type) == 2)
        sbi_mesh_measure(mesh, NULL, &area, &volume);
    return (sb_real)area;
}

SB_API void sb_mesh_bounds(const sb_mesh *mesh, sb_vec3 *low, sb_vec3 *high)
{
    if (!low || !high)
        return;
    *low = *high = sb_v3(0, 0, 0);
    if (mesh && mesh->nodes)
        sbi_mesh_finite_bounds(mesh, low, high);
}

static sb_real sbi_mesh_edge_squares(sb_element_type type, const sb_vec3 *x)
{
    sb_real sum = 0;
    int ends[3];
    for (int i = 0; i < sb_element_edge_count(type); i++) {
        sb_vec3 edge;
        sb_element_edge(type, i, ends);
        edge = sb_v3_sub(x[ends[1]], x[ends[0]]);
        sum += sb_v3_dot(edge, edge);
    }
    return sum;
}

/* 12 (3V)^(2/3) / sum of squared edges, with the sign of V. */
static sb_real sbi_mesh_tet_quality(const sb_vec3 *x)
{
    sb_real det = sbi_mesh_corner_det(x), root;
    if (det == 0)
        return 0;
    root = sb_cbrt(sb_abs(det) / 2); /* 3V = det / 2 */
    return (det < 0 ? -12 : 12) * root * root / sbi_mesh_edge_squares(SB_TET4, x);
}

/* Smallest triple product of the columns dx/dxi at `count` points of the table, scaled to length 1; the third column of
 * a quad is its mean normal. */
static sb_real sbi_mesh_scaled_jacobian(const sbi_mesh_table *table, int count, int nodes, int is_quad,
                                        const sb_vec3 *x)
{
    sb_vec3 mean = is_quad ? sb_v3_cross(sb_v3_sub(x[2], x[0]), sb_v3_sub(x[3], x[1])) : sb_v3(0, 0, 0);
    sb_real worst = 1;
    for (int i = 0; i < count; i++) {
        sb_mat3 jacobian = sbi_mesh_jacobian(table, i, nodes, x);
        sb_vec3 a = sb_m3_column(jacobian, 0), b = sb_m3_column(jacobian, 1),
                c = is_quad ? mean : sb_m3_column(jacobian, 2);
        sb_real lengths = sb_v3_norm(a) * sb_v3_norm(b) * sb_v3_norm(c);
        sb_real quality = lengths > 0 ? sb_v3_dot(c, sb_v3_cross(a, b)) / lengths : (sb_real)0;
        worst = sb_min(worst, quality);
    }
    return worst;
}

static sb_real sbi_mesh_triangle_quality(const sb_vec3 *x)
{
    sb_real doubled = sb_v3_norm(sb_v3_cross(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0])));
    return (sb_real)3.46410161513775458705 * doubled / sbi_mesh_edge_squares(SB_TRI3, x);
}

/* Smallest over largest Jacobian: 1 for straight edges. */
static sb_real sbi_mesh_jacobian_ratio(const sbi_mesh_table *table, const sb_vec3 *x)
{
    sb_real low = SB_REAL_MAX, high = 0;
    for (int i = 0; i < table->count; i++) {
        sb_real det = sb_m3_det(sbi_mesh_jacobian(table, i, 10, x));
        low = sb_min(low, det);
        high = sb_max(high, det);
    }
    return high > 0 ? low / high : (sb_real)0;
}

/* table: sbi_mesh_table_for_checks, whose first points are the nodes (custom: the integration points). */
static sb_real sbi_mesh_quality_of(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    sb_real quality;
    sbi_mesh_local local;
    sbi_mesh_local_make(mesh, element, &local);
    if (!(local.size > 0))
        return 0;
    switch (mesh->element_type) {
    case SB_TET4: return sbi_mesh_tet_quality(local.x);
    case SB_TET10:
        quality = sbi_mesh_tet_quality(local.x);
        return quality > 0 ? quality * sbi_mesh_jacobian_ratio(table, local.x) : quality;
    case SB_HEX8: return sbi_mesh_scaled_jacobian(table, 8, 8, 0, local.x);
    case SB_HEX20:
    case SB_HEX27:
    case SB_CUSTOM:
        return sbi_mesh_scaled_jacobian(table, table->count, sb_mesh_element_width(mesh), 0, local.x);
    case SB_QUAD4:
    case SB_QUAD8:
    case SB_QUAD9: return sbi_mesh_scaled_jacobian(table, 4, 4, 1, local.x);
    case SB_TRI3:
    case SB_TRI6: return sbi_mesh_triangle_quality(local.x);
    case SB_NO_ELEMENT: break;
    }
    return 0;
}

SB_API sb_real sb_mesh_element_quality(const sb_mesh *mesh, int element)
{
    sbi_mesh_table table;
    if (!sbi_mesh_has_element(mesh, element))
        return 0;
    sbi_mesh_table_for_checks(&table, sbi_mesh_element_kind(mesh));
    return sbi_mesh_quality_of(mesh, &table, element);
}

SBI_API void sbi_mesh_tet_cosines(const sb_vec3 corners[4], sb_real *of_smallest, sb_real *of_largest)
{
    sb_vec3 a = sb_v3_sub(corners[1], corners[0]), b = sb_v3_sub(corners[2], corners[0]);
    sb_vec3 c = sb_v3_sub(corners[3], corners[0]), normals[4];
    sb_real size[4];
    normals[1] = sb_v3_cross(b, c);
    normals[2] = sb_v3_cross(c, a);
    normals[3] = sb_v3_cross(a, b);
    normals[0] = sb_v3_scale(-1, sb_v3_add(normals[1], sb_v3_add(normals[2], normals[3])));
    *of_smallest = -1;
    *of_largest = 1;
    for (int i = 0; i < 4; i++)
        size[i] = sb_v3_norm(normals[i]);
    for (int i = 0; i < 4; i++)
        for (int j = i + 1; j < 4; j++) {
            sb_real cosine = -sb_v3_dot(normals[i], normals[j]) / (size[i] * size[j]);
            *of_smallest = cosine <= *of_smallest ? *of_smallest : cosine;
            *of_largest = cosine >= *of_largest ? *of_largest : cosine;
        }
}

SB_API void sb_mesh_dihedral_range(const sb_mesh *mesh, sb_real *smallest, sb_real *largest)
{
    const sb_real degrees = (sb_real)57.295779513082321;
    sb_real sharp = -1, blunt = 1;
    int is_tet = mesh && mesh->nodes && mesh->elements &&
                 (mesh->element_type == SB_TET4 || mesh->element_type == SB_TET10);
    for (int e = 0; is_tet && e < mesh->element_count; e++) {
        const int *nodes = mesh->elements + (size_t)e * (size_t)sb_mesh_element_width(mesh);
        sb_vec3 corners[4];
        sb_real of_smallest, of_largest;
        for (int a = 0; a < 4; a++)
            corners[a] = mesh->nodes[nodes[a]];
        sbi_mesh_tet_cosines(corners, &of_smallest, &of_largest);
        sharp = of_smallest <= sharp ? sharp : of_smallest;
        blunt = of_largest >= blunt ? blunt : of_largest;
    }
    if (smallest)
        *smallest = is_tet ? degrees * sb_acos(sb_min(sharp, 1)) : 0;
    if (largest)
        *largest = is_tet ? degrees * sb_acos(sb_max(blunt, -1)) : 0;
}

/* ---- the report ---- */

SB_API void sb_mesh_report_free(sb_mesh_report *report)
{
    if (!report)
        return;
    sbi_free(&report->allocator, report->bad);
    memset(report, 0, sizeof *report);
}

/* Scratch of a check, released in one place. */
typedef struct sbi_mesh_check_scratch {
    unsigned char *defect; /* [elements] sb_mesh_defect */
    unsigned char *skip;   /* [elements] 1: no part in the topology */
    int *per_node;         /* [nodes] */
    int *per_element;      /* [elements] */
    sbi_mesh_keys sides, whole;
} sbi_mesh_check_scratch;

static void sbi_mesh_check_release(const sb_allocator *allocator, sbi_mesh_check_scratch *scratch)
{
    sbi_free(allocator, scratch->defect);
    sbi_free(allocator, scratch->skip);
    sbi_free(allocator, scratch->per_node);
    sbi_free(allocator, scratch->per_element);
    sbi_mesh_keys_free(allocator, &scratch->sides);
    sbi_mesh_keys_free(allocator, &scratch->whole);
}

static int sbi_mesh_check_allocate(const sb_mesh *mesh, const sb_allocator *allocator,
                                   sbi_mesh_check_scratch *scratch)
{
    memset(scratch, 0, sizeof *scratch);
    scratch->defect = (unsigned char *)sbi_alloc(allocator, (size_t)mesh->element_count, 1);
    scratch->skip = (unsigned char *)sbi_alloc(allocator, (size_t)mesh->element_count, 1);
    scratch->per_node = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    scratch->per_element = (int *)sbi_alloc(allocator, (size_t)mesh->element_count, sizeof(int));
    return scratch->defect && scratch->skip && scratch->per_node && scratch->per_element;
}

/* Sorts out the elements: what each has by itself, then the repetitions of earlier ones. */
static int sbi_mesh_check_elements(const sb_mesh *mesh, const sb_allocator *allocator,
                                   sbi_mesh_check_scratch *scratch)
{
    sbi_mesh_table table;
    sbi_mesh_keys *whole = &scratch->whole;
    sbi_mesh_table_for_checks(&table, sbi_mesh_element_kind(mesh));
    for (int e = 0; e < mesh->element_count; e++) {
        sb_mesh_defect defect = sbi_mesh_element_defect(mesh, &table, e);
        scratch->defect[e] = (unsigned char)defect;
        scratch->skip[e] = defect == SB_MESH_INDEX_RANGE || defect == SB_MESH_REPEATED_NODE;
    }
    if (!sbi_mesh_keys_make(mesh, SBI_MESH_WHOLE, scratch->skip, allocator, whole))
        return 0;
    for (int begin = 0, end; begin < whole->sorted; begin = end) {
        end = sbi_mesh_run_end(whole, begin);
        for (int i = begin + 1; i < end; i++)
            if (scratch->defect[whole->order[i]] == SB_MESH_SOUND)
                scratch->defect[whole->order[i]] = SB_MESH_DUPLICATE;
    }
    return 1;
}

static int sbi_mesh_check_list_bad(const sb_mesh *mesh, const unsigned char *defect, sb_mesh_report *report)
{
    for (int e = 0; e < mesh->element_count; e++)
        report->defect_count[defect[e]]++;
    report->bad_count = mesh->element_count - report->defect_count[SB_MESH_SOUND];
    report->bad = (sb_mesh_bad_element *)sbi_alloc(&report->allocator, (size_t)report->bad_count,
                                                   sizeof(sb_mesh_bad_element));
    if (!report->bad)
        return 0;
    for (int e = 0, i = 0; e < mesh->element_count; e++) {
        if (defect[e] != SB_MESH_SOUND) {
            report->bad[i].element = e;
            report->bad[i++].defect = (sb_mesh_defect)defect[e];
        }
    }
    return 1;
}

static int sbi_mesh_check_nodes_of_report(const sb_mesh *mesh, const sb_allocator *allocator,
                                          sbi_mesh_check_scratch *scratch, sb_mesh_report *report)
{
    int n = sb_mesh_element_width(mesh), *used = scratch->per_node;
    report->first_not_finite_node = report->first_unreferenced_node = -1;
    memset(used, 0, sizeof(int) * (size_t)mesh->node_count);
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        for (int a = 0; a < n; a++)
            if (nodes[a] >= 0 && nodes[a] < mesh->node_count)
                used[nodes[a]] = 1;
    }
    for (int v = mesh->node_count - 1; v >= 0; v--) {
        if (!used[v])
            report->unreferenced_nodes++, report->first_unreferenced_node = v;
        if (!sb_v3_is_finite(mesh->nodes[v]))
            report->not_finite_nodes++, report->first_not_finite_node = v;
    }
    report->duplicate_nodes = sbi_mesh_find_duplicates(mesh, -1, allocator, scratch->per_node);
    return report->duplicate_nodes >= 0;
}

/* 1 when the element runs through its edge `side` from the smaller node to the larger. */
static int sbi_mesh_edge_ascends(const sb_mesh *mesh, int element, int side)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int ends[3] = {0, 0, 0};
    sb_element_edge(mesh->element_type, side, ends); /* of a surface: never custom */
    return nodes[ends[0]] < nodes[ends[1]];
}

static void sbi_mesh_check_sides(const sb_mesh *mesh, const sbi_mesh_keys *sides, sb_mesh_report *report)
{
    int surface = sb_element_dimension(mesh->element_type) == 2;
    for (int begin = 0, end; begin < sides->sorted; begin = end) {
        end = sbi_mesh_run_end(sides, begin);
        if (end == begin + 1)
            (*(surface ? &report->open_edges : &report->boundary_faces))++;
        if (end > begin + 2)
            (*(surface ? &report->nonmanifold_edges : &report->nonmanifold_faces))++;
        if (surface && end == begin + 2) {
            int p = sides->order[begin], q = sides->order[begin + 1], per = sides->per_element;
            report->inconsistent_edges += sbi_mesh_edge_ascends(mesh, p / per, p % per) ==
                                          sbi_mesh_edge_ascends(mesh, q / per, q % per);
        }
    }
}

/* Corners of surface elements that share an edge form fans around its ends; a node with two fans is where
 * parts touch in a point only. Corner c of element e is number e * corners + c; edge i joins corners i and i
 * + 1. */
static int sbi_mesh_count_pinched(const sb_mesh *mesh, const sbi_mesh_keys *sides, const unsigned char *skip,
                                  const sb_allocator *allocator, int *fans)
{
    int corners = sides->per_element, pinched = 0;
    int *parent = (int *)sbi_alloc(allocator, (size_t)sides->count, sizeof(int));
    if (!parent)
        return -1;
    for (int i = 0; i < sides->count; i++)
        parent[i] = i;
    for (int begin = 0, end; begin < sides->sorted; begin = end) {
        int p = sides->order[begin], p_up = sbi_mesh_edge_ascends(mesh, p / corners, p % corners);
        end = sbi_mesh_run_end(sides, begin);
        for (int i = begin + 1; i < end; i++) {
            int q = sides->order[i], q_up = sbi_mesh_edge_ascends(mesh, q / corners, q % corners);
            int p_next = p - p % corners + (p % corners + 1) % corners;
            int q_next = q - q % corners + (q % corners + 1) % corners;
            sbi_mesh_unite(parent, p, p_up == q_up ? q : q_next);
            sbi_mesh_unite(parent, p_next, p_up == q_up ? q_next : q);
        }
    }
    memset(fans, 0, sizeof(int) * (size_t)mesh->node_count);
    for (int i = 0; i < sides->count; i++)
        if (!skip[i / corners] && parent[i] == i)
            pinched += ++fans[sbi_mesh_element(mesh, i / corners)[i % corners]] == 2;
    sbi_free(allocator, parent);
    return pinched;
}

static void sbi_mesh_check_edge_lengths(const sb_mesh *mesh, const unsigned char *defect,
                                        sb_mesh_report *report)
{
    int ends[3] = {0, 0, 0}, found = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        if (defect[e] >= SB_MESH_INDEX_RANGE && defect[e] <= SB_MESH_REPEATED_NODE)
            continue;
        for (int i = 0; sbi_element_edge(sbi_mesh_element_kind(mesh), i, ends); i++) {
            sb_real length = sb_v3_norm(sb_v3_sub(mesh->nodes[nodes[ends[1]]], mesh->nodes[nodes[ends[0]]]));
            report->min_edge = found ? sb_min(report->min_edge, length) : length;
            report->max_edge = found ? sb_max(report->max_edge, length) : length;
            found = 1;
        }
    }
}

static void sbi_mesh_check_quality(const sb_mesh *mesh, const unsigned char *defect, sb_mesh_report *report)
{
    sbi_mesh_table table;
    report->worst_element = -1;
    sbi_mesh_table_for_checks(&table, sbi_mesh_element_kind(mesh));
    for (int e = 0; e < mesh->element_count; e++) {
        sb_real quality = defect[e] == SB_MESH_SOUND ? sbi_mesh_quality_of(mesh, &table, e) : (sb_real)0;
        if (defect[e] == SB_MESH_SOUND && (report->worst_element < 0 || quality < report->worst_quality)) {
            report->worst_element = e;
            report->worst_quality = quality;
        }
    }
}

/* One after the other: the tables of both at once would take most of the stack that the header promises to do with. */
static void sbi_mesh_check_geometry(const sb_mesh *mesh, const unsigned char *defect, sb_mesh_report *report)
{
    double area, volume;
    sbi_mesh_check_quality(mesh, defect, report);
    sbi_mesh_measure(mesh, defect, &area, &volume);
    report->area = (sb_real)area;
    report->volume = (sb_real)volume;
    sbi_mesh_check_edge_lengths(mesh, defect, report);
}

/* Fills the report; 0 when memory is short. */
static int sbi_mesh_check_all(const sb_mesh *mesh, const sb_allocator *allocator,
                              sbi_mesh_check_scratch *scratch, sb_mesh_report *report)
{
    if (!sbi_mesh_check_allocate(mesh, allocator, scratch) ||
        !sbi_mesh_check_elements(mesh, allocator, scratch) ||
        !sbi_mesh_check_nodes_of_report(mesh, allocator, scratch, report) ||
        !sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, scratch->skip, allocator, &scratch->sides))
        return 0;
    sbi_mesh_check_geometry(mesh, scratch->defect, report);
    sbi_mesh_check_sides(mesh, &scratch->sides, report);
    report->components =
        sbi_mesh_label_components(mesh, scratch->skip, scratch->per_element, scratch->per_node);
    if (sb_element_dimension(mesh->element_type) == 2)
        report->nonmanifold_vertices =
            sbi_mesh_count_pinched(mesh, &scratch->sides, scratch->skip, allocator, scratch->per_node);
    return report->nonmanifold_vertices >= 0 && sbi_mesh_check_list_bad(mesh, scratch->defect, report);
}

SB_API sb_result sb_mesh_check(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh_report *report,
                               sb_error *error)
{
    sb_mesh_report made;
    sbi_mesh_check_scratch scratch;
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result == SB_ERROR_MESH)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "nothing to check: the mesh is empty");
    if (result == SB_OK && !report)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "report is NULL");
    if (result != SB_OK)
        return result;
    memset(&made, 0, sizeof made);
    sbi_mesh_set_allocator(&made.allocator, allocator);
    if (sbi_mesh_check_all(mesh, allocator, &scratch, &made))
        *report = made;
    else
        result = sbi_mesh_no_memory(error);
    sbi_mesh_check_release(allocator, &scratch);
    return result;
}

/* ---- repairs: orientation ---- */

static void sbi_mesh_swap(int *nodes, int a, int b)
{
    int keep = nodes[a];
    nodes[a] = nodes[b];
    nodes[b] = keep;
}

/* Mirrors an element's numbering; mid-edge nodes stay on their edges. */
static void sbi_mesh_mirror(sb_element_type type, int *nodes)
{
    switch (type) {
    case SB_TRI6:
        sbi_mesh_swap(nodes, 1, 2);
        sbi_mesh_swap(nodes, 3, 5); /* edges 01 and 20 */
        break;
    case SB_QUAD4: sbi_mesh_swap(nodes, 1, 3); break;
    case SB_QUAD8:
    case SB_QUAD9:
        sbi_mesh_swap(nodes, 1, 3);
        sbi_mesh_swap(nodes, 4, 7); /* edges 01 and 30 */
        sbi_mesh_swap(nodes, 5, 6);
        break;
    case SB_TET10:
        sbi_mesh_swap(nodes, 1, 2);
        sbi_mesh_swap(nodes, 4, 6); /* edges 01 and 02 */
        sbi_mesh_swap(nodes, 8, 9); /* edges 13 and 23 */
        break;
    case SB_TRI3:
    case SB_TET4: sbi_mesh_swap(nodes, 1, 2); break;
    case SB_HEX27: sbi_mesh_swap(nodes, 24, 25); /* faces z- and z+ */
    /* fall through */
    case SB_HEX20:
        for (int a = 8; a < 12; a++)
            sbi_mesh_swap(nodes, a, a + 4); /* edges of z- and z+ */
    /* fall through */
    case SB_HEX8:
        for (int a = 0; a < 4; a++)
            sbi_mesh_swap(nodes, a, a + 4);
        break;
    case SB_CUSTOM: /* its numbering is nobody's business */
    case SB_NO_ELEMENT: break;
    }
}

static int *sbi_mesh_element_to_edit(sb_mesh *mesh, int element)
{
    return mesh->elements + (size_t)element * (size_t)sb_mesh_element_width(mesh);
}

/* Sign of the straight-sided volume without over- or underflow; table: that of its straight element. */
static int sbi_mesh_is_inverted(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    sbi_mesh_local local;
    sb_real volume = 0;
    sbi_mesh_local_make(mesh, element, &local);
    if (sb_element_straight(mesh->element_type) != SB_HEX8)
        return sbi_mesh_corner_det(local.x) < 0;
    for (int i = 0; i < table->count; i++)
        volume += sb_m3_det(sbi_mesh_jacobian(table, i, 8, local.x));
    return volume < 0;
}

/* Returns the number of elements that it mirrored. */
static int sbi_mesh_orient_solids(sb_mesh *mesh)
{
    sbi_mesh_table table;
    int count = 0;
    sbi_mesh_table_for_volume(&table, sbi_element_make(sb_element_straight(mesh->element_type), mesh->table));
    for (int e = 0; e < mesh->element_count && mesh->element_type != SB_CUSTOM; e++) {
        if (sbi_mesh_is_inverted(mesh, &table, e)) {
            sbi_mesh_mirror(mesh->element_type, sbi_mesh_element_to_edit(mesh, e));
            count++;
        }
    }
    return count;
}

SB_API sb_result sb_mesh_orient(sb_mesh *mesh, int *flipped, sb_error *error)
{
    int count;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (sb_element_dimension(mesh->element_type) == 2)
        return sb_mesh_orient_surface(mesh, flipped, error);
    count = sbi_mesh_orient_solids(mesh);
    if (flipped)
        *flipped = count;
    return SB_OK;
}

/* Flooding of a surface: flip[e] is -1 before element e is reached. */
typedef struct sbi_mesh_flood {
    sbi_mesh_keys sides;
    int *mate;         /* [sides] */
    int *queue;        /* [elements] reached elements, part by part */
    signed char *flip; /* [elements] 1: to be mirrored */
} sbi_mesh_flood;

/* Reaches everything connected to element queue[begin] over edges of two elements. Returns the end of the
 * part in the queue, or -1 when the part is one-sided. */
static int sbi_mesh_flood_part(const sb_mesh *mesh, sbi_mesh_flood *flood, int begin)
{
    int end = begin + 1, per = flood->sides.per_element;
    flood->flip[flood->queue[begin]] = 0;
    for (int i = begin; i < end; i++) {
        int e = flood->queue[i];
        for (int side = 0; side < per; side++) {
            int mate = flood->mate[e * per + side], other = mate / per, clash, flip;
            if (mate < 0)
                continue;
            clash = sbi_mesh_edge_ascends(mesh, e, side) == sbi_mesh_edge_ascends(mesh, other, mate % per);
            flip = flood->flip[e] ^ clash;
            if (flood->flip[other] < 0) {
                flood->flip[other] = (signed char)flip;
                flood->queue[end++] = other;
            } else if (flood->flip[other] != flip) {
                return -1;
            }
        }
    }
    return end;
}

/* Decides whether the whole part queue[begin..end) must be mirrored on top, and returns its number of
 * flips. */
static int sbi_mesh_flood_turn(const sb_mesh *mesh, const sbi_mesh_table *table, sbi_mesh_flood *flood,
                               int begin, int end)
{
    int per = flood->sides.per_element, closed = 1, flips = 0, turn;
    double volume = 0, scale = 0, area, flux;
    sb_vec3 origin = mesh->nodes[sbi_mesh_element(mesh, flood->queue[begin])[0]];
    for (int i = begin; i < end; i++) {
        int e = flood->queue[i];
        flips += flood->flip[e];
        for (int side = 0; side < per; side++)
            closed = closed && flood->mate[e * per + side] >= 0;
        sbi_mesh_area_and_flux(mesh, table, e, origin, &area, &flux);
        volume += flood->flip[e] ? -flux : flux;
        scale += flux < 0 ? -flux : flux;
    }
    if (closed && (volume > 64 * (double)SB_EPSILON * scale || volume < -64 * (double)SB_EPSILON * scale))
        turn = volume < 0;
    else
        turn = flips > (end - begin) / 2;
    for (int i = begin; turn && i < end; i++)
        flood->flip[flood->queue[i]] ^= 1;
    return turn ? end - begin - flips : flips;
}

/* Returns the number of elements to mirror, or -1 for a one-sided surface. */
static int sbi_mesh_flood_all(const sb_mesh *mesh, sbi_mesh_flood *flood)
{
    sbi_mesh_table table;
    int count = 0, end = 0;
    sbi_mesh_table_for_volume(&table, sbi_mesh_element_kind(mesh));
    memset(flood->flip, -1, (size_t)mesh->element_count);
    for (int e = 0; e < mesh->element_count; e++) {
        int begin = end;
        if (flood->flip[e] >= 0)
            continue;
        flood->queue[begin] = e;
        end = sbi_mesh_flood_part(mesh, flood, begin);
        if (end < 0)
            return -1;
        count += sbi_mesh_flood_turn(mesh, &table, flood, begin, end);
    }
    return count;
}

SB_API sb_result sb_mesh_orient_surface(sb_mesh *mesh, int *flipped, sb_error *error)
{
    sbi_mesh_flood flood;
    int count = -1;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (sb_element_dimension(mesh->element_type) != 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a mesh of %s is not a surface",
                        sb_element_name(mesh->element_type));
    memset(&flood, 0, sizeof flood);
    flood.queue = (int *)sbi_alloc(&mesh->allocator, (size_t)mesh->element_count, sizeof(int));
    flood.flip = (signed char *)sbi_alloc(&mesh->allocator, (size_t)mesh->element_count, 1);
    if (sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, NULL, &mesh->allocator, &flood.sides))
        flood.mate = sbi_mesh_mates(&flood.sides, &mesh->allocator);
    if (!flood.queue || !flood.flip || !flood.mate) {
        result = sbi_mesh_no_memory(error);
    } else {
        count = sbi_mesh_flood_all(mesh, &flood);
        if (count < 0)
            result = sbi_fail(error, SB_ERROR_MESH, "the surface is one-sided: it cannot be oriented");
    }
    for (int e = 0; result == SB_OK && e < mesh->element_count; e++)
        if (flood.flip[e])
            sbi_mesh_mirror(mesh->element_type, sbi_mesh_element_to_edit(mesh, e));
    if (result == SB_OK && flipped)
        *flipped = count;
    sbi_free(&mesh->allocator, flood.queue);
    sbi_free(&mesh->allocator, flood.flip);
    sbi_free(&mesh->allocator, flood.mate);
    sbi_mesh_keys_free(&mesh->allocator, &flood.sides);
    return result;
}

/* ---- repairs: removing nodes and elements ---- */

/* Keeps the nodes with keep[v] == v in their order and points every index i at node keep[i]; keep is
 * overwritten. keep[v] <= v. Returns the number of nodes removed. */
static int sbi_mesh_compact_nodes(sb_mesh *mesh, int *keep)
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

SB_API sb_result sb_mesh_merge_nodes(sb_mesh *mesh, sb_real tolerance, int *merged, sb_error *error)
{
    int *keep, count;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (!sb_is_finite(tolerance))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the merge tolerance is not finite");
    keep = (int *)sbi_alloc(&mesh->allocator, (size_t)mesh->node_count, sizeof(int));
    count = keep ? sbi_mesh_find_duplicates(mesh, tolerance, &mesh->allocator, keep) : -1;
    if (count < 0)
        result = sbi_mesh_no_memory(error);
    else if (count > 0)
        sbi_mesh_compact_nodes(mesh, keep);
    if (result == SB_OK && merged)
        *merged = count;
    sbi_free(&mesh->allocator, keep);
    return result;
}

SB_API sb_result sb_mesh_remove_unreferenced(sb_mesh *mesh, int *removed, sb_error *error)
{
    int *keep, count;
    size_t indices;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    keep = (int *)sbi_alloc(&mesh->allocator, (size_t)mesh->node_count, sizeof(int));
    if (!keep)
        return sbi_mesh_no_memory(error);
    indices = (size_t)mesh->element_count * (size_t)sb_mesh_element_width(mesh);
    for (int v = 0; v < mesh->node_count; v++)
        keep[v] = -1;
    for (size_t i = 0; i < indices; i++)
        keep[mesh->elements[i]] = mesh->elements[i];
    count = sbi_mesh_compact_nodes(mesh, keep);
    if (removed)
        *removed = count;
    sbi_free(&mesh->allocator, keep);
    return SB_OK;
}

/* Keeps the elements that `drop` does not mark, with their regions. */
static void sbi_mesh_compact_elements(sb_mesh *mesh, const unsigned char *drop)
{
    size_t n = (size_t)sb_mesh_element_width(mesh);
    int kept = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        if (drop[e])
            continue;
        memmove(mesh->elements + (size_t)kept * n, mesh->elements + (size_t)e * n, sizeof(int) * n);
        if (mesh->regions)
            mesh->regions[kept] = mesh->regions[e];
        kept++;
    }
    mesh->element_count = kept;
}

SB_API sb_result sb_mesh_remove_duplicate_elements(sb_mesh *mesh, int *removed, sb_error *error)
{
    sbi_mesh_keys whole;
    unsigned char *drop;
    int count = 0;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    drop = (unsigned char *)sbi_alloc_zeroed(&mesh->allocator, (size_t)mesh->element_count, 1);
    if (!drop || !sbi_mesh_keys_make(mesh, SBI_MESH_WHOLE, NULL, &mesh->allocator, &whole)) {
        sbi_free(&mesh->allocator, drop);
        return sbi_mesh_no_memory(error);
    }
    for (int begin = 0, end; begin < whole.sorted; begin = end) {
        end = sbi_mesh_run_end(&whole, begin);
        for (int i = begin + 1; i < end; i++)
            drop[whole.order[i]] = 1;
        count += end - begin - 1;
    }
    sbi_mesh_compact_elements(mesh, drop);
    if (removed)
        *removed = count;
    sbi_mesh_keys_free(&mesh->allocator, &whole);
    sbi_free(&mesh->allocator, drop);
    return SB_OK;
}

SB_API sb_result sb_mesh_scale(sb_mesh *mesh, sb_real factor, sb_error *error)
{
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result == SB_OK)
        result = sbi_mesh_check_nodes(mesh, error);
    if (result != SB_OK)
        return result;
    if (!(factor > 0) || !sb_is_finite(factor))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the scale factor must be positive and finite");
    for (int v = 0; v < mesh->node_count; v++)
        if (!sb_is_finite(factor * sbi_mesh_max_abs(mesh->nodes[v])))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, v, "node %d would not be finite after scaling",
                                 v);
    for (int v = 0; v < mesh->node_count; v++)
        mesh->nodes[v] = sb_v3_scale(factor, mesh->nodes[v]);
    return SB_OK;
}

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

static int sbi_mesh_table_allocate(sb_index_table *table, int rows, int columns,
                                   const sb_allocator *allocator)
{
    sbi_mesh_set_allocator(&table->allocator, allocator);
    table->rows = rows;
    table->columns = columns;
    table->items = (int *)sbi_alloc(allocator, (size_t)rows, sizeof(int) * (size_t)columns);
    return table->items != NULL;
}

static sb_result sbi_mesh_check_output(const sb_mesh *mesh, const void *output, sb_error *error)
{
    if (!output)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the output is NULL");
    return sbi_mesh_check_arrays(mesh, error);
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
static int sbi_mesh_boundary_make(const sb_mesh *mesh, const int *mate, int with_map,
                                  const sb_allocator *allocator, sb_boundary *boundary)
{
    sbi_element element = sbi_mesh_element_kind(mesh);
    sb_element_type type = sbi_mesh_boundary_type(element);
    int per = sbi_element_face_count(element), sides = mesh->element_count * per;
    int rows = sbi_mesh_count_rows(mesh, mate, type), row = 0;
    if (rows < 0 || !sbi_mesh_allocate(&boundary->surface, type, mesh->node_count, rows, mesh->regions != NULL,
                                       allocator))
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

SB_API sb_result sb_mesh_neighbours(const sb_mesh *mesh, const sb_allocator *allocator,
                                    sb_index_table *neighbours, sb_error *error)
{
    sb_index_table made;
    sbi_mesh_keys sides;
    int per;
    sb_result result = sbi_mesh_check_output(mesh, neighbours, error);
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

static int sbi_mesh_count_runs(const sbi_mesh_keys *keys)
{
    int runs = 0;
    for (int begin = 0; begin < keys->sorted; begin = sbi_mesh_run_end(keys, begin))
        runs++;
    return runs;
}

SB_API sb_result sb_mesh_edges(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_table *edges,
                               sb_error *error)
{
    sb_index_table made;
    sbi_mesh_keys keys;
    int row = 0;
    sb_result result = sbi_mesh_check_output(mesh, edges, error);
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

/* Node to element lists; 0 when memory is short or the entries do not fit an int. */
static int sbi_mesh_lists_make(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_lists *lists)
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
        memmove(lists->offsets + 1, lists->offsets,
                sizeof(int) * (size_t)count); /* filling moved each to its end */
        lists->offsets[0] = 0;
    } else {
        sb_index_lists_free(lists);
    }
    sbi_free(allocator, last);
    return lists->items != NULL;
}

SB_API sb_result sb_mesh_node_elements(const sb_mesh *mesh, const sb_allocator *allocator,
                                       sb_index_lists *lists, sb_error *error)
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

SB_API sb_result sb_mesh_components(const sb_mesh *mesh, const sb_allocator *allocator,
                                    sb_index_table *labels, int *count, sb_error *error)
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

/* ---- tet4 to tet10, hex8 to hex20 and hex27 ---- */

/* number[part]: node of each edge or face, numbered from `first` in the order they appear. Returns the end. A
 * run of equal keys starts with its smallest part, so that one is met first. */
static int sbi_mesh_number_parts(const sbi_mesh_keys *parts, int first, int *number)
{
    int next = first;
    for (int begin = 0, end; begin < parts->sorted; begin = end) {
        end = sbi_mesh_run_end(parts, begin);
        for (int i = begin; i < end; i++)
            number[parts->order[i]] = parts->order[begin];
    }
    for (int p = 0; p < parts->count; p++)
        number[p] = number[p] == p ? next++ : number[number[p]];
    return next;
}

/* The nodes a conversion adds. */
typedef struct sbi_mesh_raising {
    sbi_mesh_keys edges, faces;
    int *edge_number, *face_number; /* [parts]; face_number NULL: no nodes on faces and in centres */
    int nodes;                      /* together with the old ones, without centres */
} sbi_mesh_raising;

static void sbi_mesh_raising_free(const sb_allocator *allocator, sbi_mesh_raising *raising)
{
    sbi_free(allocator, raising->edge_number);
    sbi_free(allocator, raising->face_number);
    sbi_mesh_keys_free(allocator, &raising->edges);
    sbi_mesh_keys_free(allocator, &raising->faces);
}

/* Numbers the nodes on edges, and with_faces those on faces; 0 when memory is short or they do not fit an int. */
static int sbi_mesh_raising_make(const sb_mesh *mesh, int with_faces, const sb_allocator *allocator,
                                 sbi_mesh_raising *raising)
{
    memset(raising, 0, sizeof *raising);
    if (!sbi_mesh_keys_make(mesh, SBI_MESH_EDGES, NULL, allocator, &raising->edges) ||
        sbi_mesh_count_runs(&raising->edges) > INT_MAX - mesh->node_count)
        return 0;
    raising->edge_number = (int *)sbi_alloc(allocator, (size_t)raising->edges.count, sizeof(int));
    if (!raising->edge_number)
        return 0;
    raising->nodes = sbi_mesh_number_parts(&raising->edges, mesh->node_count, raising->edge_number);
    if (!with_faces)
        return 1;
    if (!sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, NULL, allocator, &raising->faces) ||
        sbi_mesh_count_runs(&raising->faces) > INT_MAX - raising->nodes)
        return 0;
    raising->face_number = (int *)sbi_alloc(allocator, (size_t)raising->faces.count, sizeof(int));
    if (!raising->face_number)
        return 0;
    raising->nodes = sbi_mesh_number_parts(&raising->faces, raising->nodes, raising->face_number);
    return raising->nodes <= INT_MAX - mesh->element_count;
}

/* Mean of some of an element's nodes; each takes its share first, so that no sum overflows. */
static sb_vec3 sbi_mesh_middle(const sb_mesh *mesh, const int *element, const int *local, int count)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    sb_real share = 1 / (sb_real)count;
    for (int i = 0; i < count; i++) {
        sb_vec3 x = mesh->nodes[element[local[i]]];
        sum = sb_v3(sum.x + share * x.x, sum.y + share * x.y, sum.z + share * x.z);
    }
    return sum;
}

/* Element e of the raised mesh: corners, nodes on edges, on faces, and the centre. */
static void sbi_mesh_raise_element(const sb_mesh *mesh, const sbi_mesh_raising *raising, int e, sb_mesh *raised)
{
    static const int all[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    sb_element_type type = mesh->element_type;
    int corners = sb_element_corner_count(type), edges = sb_element_edge_count(type), local[SB_MAX_FACE_NODES];
    const int *from = sbi_mesh_element(mesh, e);
    int *to = sbi_mesh_element_to_edit(raised, e), next = corners;
    memcpy(to, from, (size_t)corners * sizeof(int));
    for (int i = 0; sb_element_edge(type, i, local); i++) {
        to[next] = raising->edge_number[e * edges + i];
        raised->nodes[to[next++]] = sbi_mesh_middle(mesh, from, local, 2);
    }
    if (!raising->face_number)
        return;
    for (int i = 0, count; (count = sb_element_face(type, i, local, NULL)) > 0; i++) {
        to[next] = raising->face_number[e * raising->faces.per_element + i];
        raised->nodes[to[next++]] = sbi_mesh_middle(mesh, from, local, count);
    }
    to[next] = raising->nodes + e;
    raised->nodes[to[next]] = sbi_mesh_middle(mesh, from, all, corners);
}

/* The mesh of the straight type `from` with the nodes that `type` has besides. */
static sb_result sbi_mesh_raise(const sb_mesh *mesh, sb_element_type from, sb_element_type type,
                                const sb_allocator *allocator, sb_mesh *raised, sb_error *error)
{
    sb_mesh made;
    sbi_mesh_raising raising;
    int with_faces = type == SB_HEX27;
    sb_result result = sbi_mesh_check_output(mesh, raised, error);
    if (result != SB_OK)
        return result;
    if (mesh->element_type != from)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a mesh of %s cannot become %s: %s is needed",
                        sbi_element_name(sbi_mesh_element_kind(mesh)), sb_element_name(type), sb_element_name(from));
    if (sbi_mesh_raising_make(mesh, with_faces, allocator, &raising) &&
        sbi_mesh_allocate(&made, type, raising.nodes + (with_faces ? mesh->element_count : 0), mesh->element_count,
                          mesh->regions != NULL, allocator)) {
        memcpy(made.nodes, mesh->nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
        if (mesh->regions)
            memcpy(made.regions, mesh->regions, sizeof(int) * (size_t)mesh->element_count);
        for (int e = 0; e < mesh->element_count; e++)
            sbi_mesh_raise_element(mesh, &raising, e, &made);
        *raised = made;
    } else {
        result = sbi_mesh_no_memory(error);
    }
    sbi_mesh_raising_free(allocator, &raising);
    return result;
}

SB_API sb_result sb_mesh_to_tet10(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *tet10,
                                  sb_error *error)
{
    return sbi_mesh_raise(mesh, SB_TET4, SB_TET10, allocator, tet10, error);
}

SB_API sb_result sb_mesh_to_hex20(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *hex20,
                                  sb_error *error)
{
    return sbi_mesh_raise(mesh, SB_HEX8, SB_HEX20, allocator, hex20, error);
}

SB_API sb_result sb_mesh_to_hex27(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *hex27,
                                  sb_error *error)
{
    return sbi_mesh_raise(mesh, SB_HEX8, SB_HEX27, allocator, hex27, error);
}

/* ---- reverse Cuthill-McKee ----
 * George & Liu: number nodes breadth first from a node at an end of the graph, neighbours by ascending
 * degree, and reverse the order. Two nodes are neighbours when they share an element. */

typedef struct sbi_mesh_graph {
    const sb_mesh *mesh;
    sb_index_lists elements; /* of each node */
    int *degree; /* [nodes] elements of the node: cheap, and ordered much like the number of neighbours */
    int *mark;   /* [nodes] search that saw the node last */
    int search;
    int *order; /* [nodes] */
} sbi_mesh_graph;

static int sbi_mesh_graph_less(const sbi_mesh_graph *graph, int a, int b)
{
    return graph->degree[a] != graph->degree[b] ? graph->degree[a] < graph->degree[b] : a < b;
}

static void sbi_mesh_sift_down(const sbi_mesh_graph *graph, int *nodes, int root, int count)
{
    for (int child = 2 * root + 1; child < count; root = child, child = 2 * root + 1) {
        if (child + 1 < count && sbi_mesh_graph_less(graph, nodes[child], nodes[child + 1]))
            child++;
        if (!sbi_mesh_graph_less(graph, nodes[root], nodes[child]))
            return;
        sbi_mesh_swap(nodes, root, child);
    }
}

/* Heap sort by degree, then number: no worst case, no recursion. */
static void sbi_mesh_sort_by_degree(const sbi_mesh_graph *graph, int *nodes, int count)
{
    for (int i = count / 2 - 1; i >= 0; i--)
        sbi_mesh_sift_down(graph, nodes, i, count);
    for (int i = count - 1; i > 0; i--) {
        sbi_mesh_swap(nodes, 0, i);
        sbi_mesh_sift_down(graph, nodes, 0, i);
    }
}

/* Appends the unseen neighbours of a node to the order at `end`; returns the new end. */
static int sbi_mesh_graph_visit(sbi_mesh_graph *graph, int node, int end)
{
    int n = sb_mesh_element_width(graph->mesh), begin = end;
    for (int i = graph->elements.offsets[node]; i < graph->elements.offsets[node + 1]; i++) {
        const int *nodes = sbi_mesh_element(graph->mesh, graph->elements.items[i]);
        for (int a = 0; a < n; a++) {
            if (graph->mark[nodes[a]] != graph->search) {
                graph->mark[nodes[a]] = graph->search;
                graph->order[end++] = nodes[a];
            }
        }
    }
    sbi_mesh_sort_by_degree(graph, graph->order + begin, end - begin);
    return end;
}

/* Breadth-first order from `start`, written from position `begin`; *depth: levels; *last: begin of the last
 * level. Returns the end. */
static int sbi_mesh_graph_search(sbi_mesh_graph *graph, int start, int begin, int *depth, int *last)
{
    int end = begin + 1, level = begin;
    graph->search++;
    graph->mark[start] = graph->search;
    graph->order[begin] = start;
    *depth = 0;
    while (level < end) {
        int level_end = end;
        *last = level;
        ++*depth;
        for (; level < level_end; level++)
            end = sbi_mesh_graph_visit(graph, graph->order[level], end);
    }
    return end;
}

/* Numbers the part around `start` from position `begin`: from a far end, found by searching again from the
 * least connected node of the last level as long as that goes deeper (a few times: each search costs the
 * whole part). */
static int sbi_mesh_graph_number(sbi_mesh_graph *graph, int start, int begin)
{
    int depth, last, end = sbi_mesh_graph_search(graph, start, begin, &depth, &last);
    for (int attempt = 0; attempt < 6; attempt++) {
        int candidate = graph->order[last], deeper, before = start;
        for (int i = last + 1; i < end; i++)
            if (sbi_mesh_graph_less(graph, graph->order[i], candidate))
                candidate = graph->order[i];
        start = candidate;
        sbi_mesh_graph_search(graph, start, begin, &deeper, &last);
        if (deeper < depth) {
            sbi_mesh_graph_search(graph, before, begin, &deeper, &last);
            break;
        }
        if (deeper == depth)
            break;
        depth = deeper;
    }
    return end;
}

/* Parts are taken from their least connected node on, by ascending degree. */
static void sbi_mesh_graph_order(sbi_mesh_graph *graph, int *by_degree, int *done)
{
    int count = graph->mesh->node_count, end = 0;
    for (int v = 0; v < count; v++) {
        by_degree[v] = v;
        done[v] = 0;
        graph->mark[v] = 0;
        graph->degree[v] = graph->elements.offsets[v + 1] - graph->elements.offsets[v];
    }
    sbi_mesh_sort_by_degree(graph, by_degree, count);
    for (int i = 0; i < count; i++) {
        int begin = end;
        if (done[by_degree[i]])
            continue;
        end = sbi_mesh_graph_number(graph, by_degree[i], begin);
        for (int k = begin; k < end; k++)
            done[graph->order[k]] = 1;
    }
}

/* Scratch of a reordering. */
typedef struct sbi_mesh_renumbering {
    sbi_mesh_graph graph;
    int *node_map, *element_map, *start; /* [nodes], [elements], [nodes + 1] */
    sb_vec3 *nodes;
    int *elements;
    int *regions;
} sbi_mesh_renumbering;

static void sbi_mesh_renumbering_free(const sb_allocator *allocator, sbi_mesh_renumbering *r)
{
    sb_index_lists_free(&r->graph.elements);
    sbi_free(allocator, r->graph.degree);
    sbi_free(allocator, r->graph.mark);
    sbi_free(allocator, r->graph.order);
    sbi_free(allocator, r->node_map);
    sbi_free(allocator, r->element_map);
    sbi_free(allocator, r->start);
    sbi_free(allocator, r->nodes);
    sbi_free(allocator, r->elements);
    sbi_free(allocator, r->regions);
}

static int sbi_mesh_renumbering_allocate(const sb_mesh *mesh, sbi_mesh_renumbering *r)
{
    const sb_allocator *allocator = &mesh->allocator;
    size_t nodes = (size_t)mesh->node_count, elements = (size_t)mesh->element_count;
    memset(r, 0, sizeof *r);
    r->graph.mesh = mesh;
    r->graph.degree = (int *)sbi_alloc(allocator, nodes, sizeof(int));
    r->graph.mark = (int *)sbi_alloc(allocator, nodes, sizeof(int));
    r->graph.order = (int *)sbi_alloc(allocator, nodes, sizeof(int));
    r->node_map = (int *)sbi_alloc(allocator, nodes, sizeof(int));
    r->element_map = (int *)sbi_alloc(allocator, elements, sizeof(int));
    r->start = (int *)sbi_alloc(allocator, nodes + 1, sizeof(int));
    r->nodes = (sb_vec3 *)sbi_alloc(allocator, nodes, sizeof(sb_vec3));
    r->elements = (int *)sbi_alloc(allocator, elements,
                                   sizeof(int) * (size_t)sb_mesh_element_width(mesh));
    if (mesh->regions)
        r->regions = (int *)sbi_alloc(allocator, elements, sizeof(int));
    return r->graph.degree && r->graph.mark && r->graph.order && r->node_map && r->element_map && r->start &&
           r->nodes && r->elements && (r->regions || !mesh->regions) &&
           sbi_mesh_lists_make(mesh, allocator, &r->graph.elements);
}

/* New element numbers by lowest new node, ties by old number: a counting sort. */
static void sbi_mesh_renumber_elements(const sb_mesh *mesh, sbi_mesh_renumbering *r)
{
    int n = sb_mesh_element_width(mesh);
    memset(r->start, 0, sizeof(int) * ((size_t)mesh->node_count + 1));
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        int lowest = r->node_map[nodes[0]];
        for (int a = 1; a < n; a++)
            lowest = r->node_map[nodes[a]] < lowest ? r->node_map[nodes[a]] : lowest;
        r->element_map[e] = lowest;
        r->start[lowest + 1]++;
    }
    for (int v = 0; v < mesh->node_count; v++)
        r->start[v + 1] += r->start[v];
    for (int e = 0; e < mesh->element_count; e++)
        r->element_map[e] = r->start[r->element_map[e]]++;
}

static void sbi_mesh_renumbering_apply(sb_mesh *mesh, sbi_mesh_renumbering *r)
{
    size_t n = (size_t)sb_mesh_element_width(mesh);
    for (int v = 0; v < mesh->node_count; v++)
        r->nodes[r->node_map[v]] = mesh->nodes[v];
    for (int e = 0; e < mesh->element_count; e++) {
        for (size_t a = 0; a < n; a++)
            r->elements[(size_t)r->element_map[e] * n + a] = r->node_map[mesh->elements[(size_t)e * n + a]];
        if (mesh->regions)
            r->regions[r->element_map[e]] = mesh->regions[e];
    }
    memcpy(mesh->nodes, r->nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
    memcpy(mesh->elements, r->elements, sizeof(int) * n * (size_t)mesh->element_count);
    if (mesh->regions)
        memcpy(mesh->regions, r->regions, sizeof(int) * (size_t)mesh->element_count);
}

SB_API sb_result sb_mesh_reorder(sb_mesh *mesh, int *node_map, int *element_map, sb_error *error)
{
    sbi_mesh_renumbering r;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (sbi_mesh_renumbering_allocate(mesh, &r)) {
        sbi_mesh_graph_order(&r.graph, r.node_map, r.start);
        for (int v = 0; v < mesh->node_count; v++)
            r.node_map[r.graph.order[v]] = mesh->node_count - 1 - v;
        sbi_mesh_renumber_elements(mesh, &r);
        sbi_mesh_renumbering_apply(mesh, &r);
        if (node_map)
            memcpy(node_map, r.node_map, sizeof(int) * (size_t)mesh->node_count);
        if (element_map)
            memcpy(element_map, r.element_map, sizeof(int) * (size_t)mesh->element_count);
    } else {
        result = sbi_mesh_no_memory(error);
    }
    sbi_mesh_renumbering_free(&mesh->allocator, &r);
    return result;
}
