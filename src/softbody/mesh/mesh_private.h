/* mesh_private: what the sources of a mesh share: samples of an element, keys, connected parts. */
#ifndef SBI_MESH_PRIVATE_H
#define SBI_MESH_PRIVATE_H

#include "mesh.h"

#include <limits.h>
#include <string.h>

/* ---- mesh.c ---- */

SB_INLINE sb_result sbi_mesh_no_memory(sb_error *error)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the tables of a mesh");
}

SB_INLINE const int *sbi_mesh_element(const sb_mesh *mesh, int element)
{
    return mesh->elements + (size_t)element * (size_t)sb_mesh_element_width(mesh);
}

SB_INLINE void sbi_mesh_swap(int *nodes, int a, int b)
{
    int keep = nodes[a];
    nodes[a] = nodes[b];
    nodes[b] = keep;
}

SB_INLINE int *sbi_mesh_element_to_edit(sb_mesh *mesh, int element)
{
    return mesh->elements + (size_t)element * (size_t)sb_mesh_element_width(mesh);
}

SBI_API void sbi_mesh_set_allocator(sb_allocator *target, const sb_allocator *allocator);
/* Counts, type and pointers; what the arrays hold is not looked at. */
SBI_API sb_result sbi_mesh_check_shape(const sb_mesh *mesh, sb_error *error);
SBI_API sb_result sbi_mesh_check_nodes(const sb_mesh *mesh, sb_error *error);
/* SB_ERROR_UNSUPPORTED names a cloud. */
SBI_API sb_result sbi_mesh_check_has_shape(const sb_mesh *mesh, sb_error *error);
/* An index of the element that names no node, through *index; 0 when there is none. */
SBI_API int sbi_mesh_index_out_of_range(const sb_mesh *mesh, int element, int *index);
/* Keeps the nodes with keep[v] == v in their order and points every index i at node keep[i]; keep is
 * overwritten. keep[v] <= v. Returns the number of nodes removed. */
SBI_API int sbi_mesh_compact_nodes(sb_mesh *mesh, int *keep);
SBI_API sb_result sbi_mesh_check_output(const sb_mesh *mesh, const void *output, sb_error *error);

/* ---- mesh_shape.c ---- */

/* hex27 has the most: its nodes and its 27 points. */
enum { SBI_MESH_SAMPLES = SB_MAX_ELEMENT_NODES + SB_MAX_QUADRATURE_POINTS, SBI_MESH_NODES = SB_MAX_ELEMENT_NODES };

/* Shape functions at a set of points, made once for all elements. */
typedef struct sbi_mesh_table {
    int count;
    sb_real weight[SBI_MESH_SAMPLES];
    sb_real shape[SBI_MESH_SAMPLES][SBI_MESH_NODES];
    sb_real gradient[SBI_MESH_SAMPLES][SBI_MESH_NODES][3];
} sbi_mesh_table;

/* An element's nodes relative to its first and divided by its largest extent `size` (m), so that no product
 * over- or underflows at any scale of the mesh; `rounding`: bound of the relative error of a Jacobian made
 * from them. */
typedef struct sbi_mesh_local {
    sb_vec3 x[SBI_MESH_NODES];
    sb_real size, rounding;
} sbi_mesh_local;

SB_INLINE sb_real sbi_mesh_max_abs(sb_vec3 v) { return sb_max(sb_abs(v.x), sb_max(sb_abs(v.y), sb_abs(v.z))); }

SB_INLINE sb_real sbi_mesh_corner_det(const sb_vec3 *x)
{
    return sb_m3_det(sb_m3_columns(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0]), sb_v3_sub(x[3], x[0])));
}

/* The points to integrate volumes and areas with: exact for all volumes (tet10: degree 3; custom: the mass points). */
SBI_API void sbi_mesh_table_for_volume(sbi_mesh_table *table, sbi_element element);
/* The points where a Jacobian must be positive: all nodes first; tet10: also the face centroids (the last
 * four of its 8-point rule) and the 14 points of its mass rule; hexes: also Gauss points, hex20 at the nodes of hex27.
 * Custom elements: their points only, since gradients may have no value at nodes. Quads: the corners alone. */
SBI_API void sbi_mesh_table_for_checks(sbi_mesh_table *table, sbi_element element);
SBI_API void sbi_mesh_local_make(const sb_mesh *mesh, int element, sbi_mesh_local *local);
/* Columns dx/dxi at sample `point` of the table. */
SBI_API sb_mat3 sbi_mesh_jacobian(const sbi_mesh_table *table, int point, int node_count, const sb_vec3 *x);
/* First defect that an element has by itself (so not SB_MESH_DUPLICATE). */
SBI_API sb_mesh_defect sbi_mesh_element_defect(const sb_mesh *mesh, const sbi_mesh_table *table, int element);
/* Box around the finite nodes; 0 when there are none. */
SBI_API int sbi_mesh_finite_bounds(const sb_mesh *mesh, sb_vec3 *low, sb_vec3 *high);
/* Area of a surface element and its share of the enclosed volume, the flux of (x - origin) / 3 through it. */
SBI_API void sbi_mesh_area_and_flux(const sb_mesh *mesh, const sbi_mesh_table *table, int element, sb_vec3 origin,
                                    double *area, double *flux);
/* Sums in double, so that a float build's total is as good as its elements. bad (or NULL) marks elements to
 * leave out. */
SBI_API void sbi_mesh_measure(const sb_mesh *mesh, const unsigned char *bad, double *area, double *volume);
/* table: sbi_mesh_table_for_checks, whose first points are the nodes (custom: the integration points). */
SBI_API sb_real sbi_mesh_quality_of(const sb_mesh *mesh, const sbi_mesh_table *table, int element);

/* ---- mesh_keys.c ---- */

enum { SBI_MESH_ALONE = -1, SBI_MESH_CROWDED = -2 };

/* mate[part]: the one other part with the same key, or ALONE, or CROWDED (two others or more, or skipped). */
SBI_API int *sbi_mesh_mates(const sbi_mesh_keys *keys, const sb_allocator *allocator);
/* The smaller root becomes the root of both, so roots come first in every numbering. */
SBI_API void sbi_mesh_unite(int *parent, int a, int b);
/* Labels of the parts that share nodes, in the order of their first elements; skipped elements get -1.
 * scratch: [node_count]. Returns the number of parts. */
SBI_API int sbi_mesh_label_components(const sb_mesh *mesh, const unsigned char *skip, int *label, int *scratch);
/* 1 when the element runs through its edge `side` from the smaller node to the larger. */
SBI_API int sbi_mesh_edge_ascends(const sb_mesh *mesh, int element, int side);
SBI_API int sbi_mesh_count_runs(const sbi_mesh_keys *keys);

/* ---- mesh_topology.c ---- */

/* Node to element lists; 0 when memory is short or the entries do not fit an int. */
SBI_API int sbi_mesh_lists_make(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_lists *lists);

#endif /* SBI_MESH_PRIVATE_H */
