/* mesh: nodes, elements, regions; checks, repairs, boundary, neighbours, quality, reordering. Floor 1. */
#ifndef SB_MESH_H
#define SB_MESH_H

#include "element.h"

/* A mesh of one element type: a volume (tet4, tet10, hex8, hex20, hex27, or custom elements that `table`
 * describes) or a surface (tri3, tri6, quad4, quad8, quad9). Fill the arrays by hand or let sb_mesh_load / a
 * generator do it. Zero-initialise before first use ({0}). Arrays made by this library come from `allocator` and are
 * released with sb_mesh_free; arrays of your own are yours to release. */
typedef struct sb_mesh {
    int node_count;
    sb_vec3 *nodes; /* [node_count] positions (m) */
    sb_element_type element_type;
    int element_count;
    int *elements;                 /* [element_count][nodes per element] node indices */
    int *regions;                  /* [element_count] material region of each element, or NULL: all 0 */
    sb_allocator allocator;        /* what the arrays came from; zeros: malloc */
    const sb_element_table *table; /* of SB_CUSTOM elements; borrowed, also by copies and bodies. Others: not read */
} sb_mesh;

/* Nodes per element: the width of mesh->elements; 0 for an unknown type, or SB_CUSTOM without a table. */
SB_INLINE int sb_mesh_element_width(const sb_mesh *mesh)
{
    if (!mesh)
        return 0;
    if (mesh->element_type == SB_CUSTOM)
        return mesh->table ? mesh->table->node_count : 0;
    return sb_element_node_count(mesh->element_type);
}

/* Common to all calls below: a NULL allocator means malloc and free. `error` may be NULL. Calls that return
 * an sb_result check counts, type and node indices first, so no content of the arrays makes them read
 * outside. An output mesh or table is overwritten, not freed. Nothing depends on addresses or threads. */

/* Releases the arrays through mesh->allocator and zeroes the struct. Safe on {0} and on NULL. */
SB_API void sb_mesh_free(sb_mesh *mesh);

/* Deep copy with memory from `allocator`. */
SB_API sb_result sb_mesh_copy(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *copy, sb_error *error);

/* Appends nodes and elements of `other`, which has the same element type (and table), to the mesh: they get the numbers
 * after its own, and no node is merged. Regions are kept (0 where one of the two has none). New arrays come
 * from mesh->allocator, the old ones go back to it; `other` may be the mesh itself. On failure
 * (SB_ERROR_ARGUMENT also for different types, _MESH for more than 2^31-1 nodes or elements, _INDEX,
 * _NOT_FINITE, _MEMORY) the mesh is as it was. */
SB_API sb_result sb_mesh_append(sb_mesh *mesh, const sb_mesh *other, sb_error *error);

/* ---- checks ------------------------------------------------------------------------------------------ */

/* Checks whether a mesh can be computed with: counts, finite nodes, index range, repeated nodes and, for
 * volumes, a positive Jacobian (at the corners; curved tet10, hex20 and hex27 also at their other nodes, on their faces
 * and inside; custom elements, whose table is checked too, at their points). SB_ERROR_ARGUMENT, _NOT_FINITE
 * (error->node is the first), _INDEX or _MESH (error->element is the first; the message lists up to 8 elements and
 * the total). Allocates nothing; one pass. */
SB_API sb_result sb_mesh_validate(const sb_mesh *mesh, sb_error *error);

/* What can be wrong with an element; an element is listed once, under the first that applies. A bad mid-edge
 * node lies far from its edge, or the whole file has the node order of another program (gmsh). */
typedef enum sb_mesh_defect {
    SB_MESH_SOUND = 0,
    SB_MESH_INDEX_RANGE = 1,     /* refers to a node that does not exist */
    SB_MESH_NODE_NOT_FINITE = 2, /* uses a node with a NaN or infinite coordinate */
    SB_MESH_REPEATED_NODE = 3,   /* uses a node twice */
    SB_MESH_INVERTED = 4,        /* volume: negative Jacobian at a corner of the straight-sided element */
    SB_MESH_FLAT = 5,            /* volume or area zero to rounding */
    SB_MESH_BAD_MIDSIDE = 6,     /* tet10, hex20, hex27 with sound corners, folded by the nodes between them */
    SB_MESH_DUPLICATE = 7,       /* same corners as an element before it */
    SB_MESH_DEFECT_COUNT = 8
} sb_mesh_defect;

typedef struct sb_mesh_bad_element {
    int element;
    sb_mesh_defect defect;
} sb_mesh_bad_element;

/* Everything sb_mesh_check found. Free with sb_mesh_report_free. */
typedef struct sb_mesh_report {
    int bad_count;
    sb_mesh_bad_element *bad;               /* [bad_count] in the order of the elements */
    int defect_count[SB_MESH_DEFECT_COUNT]; /* elements per sb_mesh_defect; [0] the sound ones */
    int not_finite_nodes;                   /* nodes with a NaN or infinite coordinate */
    int first_not_finite_node;              /* or -1 */
    int unreferenced_nodes;                 /* nodes of no element: a stiffness matrix with them is singular */
    int first_unreferenced_node;            /* or -1 */
    int duplicate_nodes;                    /* nodes that sb_mesh_merge_nodes with automatic tolerance would remove */
    int components;                         /* parts that share no node; each needs supports of its own */
    sb_real volume;             /* m^3: volume mesh: sum; closed surface: enclosed, negative when inside out */
    sb_real area;               /* m^2: surfaces; 0 for volumes */
    sb_real min_edge, max_edge; /* m, straight corner to corner */
    sb_real worst_quality;      /* smallest sb_mesh_element_quality of the elements that are not bad; 0: none */
    int worst_element;          /* its element, or -1 */
    int boundary_faces;         /* volumes: faces of one element only */
    int nonmanifold_faces;      /* volumes: faces of more than two elements */
    int open_edges;             /* surfaces: edges of one element only; 0: closed */
    int nonmanifold_edges;      /* surfaces: edges of more than two elements */
    int inconsistent_edges;     /* surfaces: edges whose two elements are oriented against each other */
    int nonmanifold_vertices;   /* surfaces: nodes where parts touch in a point */
    sb_allocator allocator;
} sb_mesh_report;

/* Lists everything suspicious about a mesh in one report, whatever the arrays hold. SB_OK also for a bad
 * mesh; fails with SB_ERROR_ARGUMENT (counts, type, null arrays) or SB_ERROR_MEMORY only. Elements with an
 * index out of range or a repeated node take no part in the topology, bad ones none in volume, area and
 * quality. O(nodes + elements). */
SB_API sb_result sb_mesh_check(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh_report *report,
                               sb_error *error);
SB_API void sb_mesh_report_free(sb_mesh_report *report);

/* ---- geometry ------------------------------------------------------------------------------------------
 * For meshes that sb_mesh_validate accepts. An element out of range gives 0. */

/* Volume of an element (m^3), exact for curved ones too; negative when inverted; 0 for surfaces. */
SB_API sb_real sb_mesh_element_volume(const sb_mesh *mesh, int element);
/* Volume mesh: its volume (m^3). Surface: the signed volume it encloses, meaningful when it is closed. */
SB_API sb_real sb_mesh_volume(const sb_mesh *mesh);
/* Area of a surface mesh (m^2), exact for tri3, by the face quadrature else; 0 for volumes (take the
 * boundary). */
SB_API sb_real sb_mesh_surface_area(const sb_mesh *mesh);
/* Smallest box around all nodes (m); both corners 0 for a mesh without nodes. */
SB_API void sb_mesh_bounds(const sb_mesh *mesh, sb_vec3 *low, sb_vec3 *high);
/* Shape of an element: 1 is best, <= 0 inverted or flat. tet4: mean ratio 12 (3V)^(2/3) / sum of squared
 * edges; tet10: that of its corners times min/max of the Jacobian; hex8 and quads: smallest Jacobian at a
 * corner of edges scaled to length 1; hex20, hex27, custom: the same of the columns dx/dxi at all nodes, face
 * centres and points (custom: points only); triangles: 4 sqrt(3) A / sum of squared edges (of the corners). */
SB_API sb_real sb_mesh_element_quality(const sb_mesh *mesh, int element);
/* Smallest and largest angle (degrees) between two faces of an element, over all elements of a tet4 or tet10 mesh (of
 * its corners); both 0 for other types and without elements. Either place may be NULL. */
SB_API void sb_mesh_dihedral_range(const sb_mesh *mesh, sb_real *smallest, sb_real *largest);

/* ---- repairs, on request only ---------------------------------------------------------------------------
 * They change the mesh in place, take scratch from mesh->allocator and leave the mesh as it was on failure.
 * They work on meshes with bad elements, as long as indices are in range and nodes finite. The counts they
 * return may be NULL: not wanted. */

/* Turns inverted volume elements (corner volume negative) by renumbering them; surfaces:
 * sb_mesh_orient_surface. *flipped: how many. Mid-edge nodes move along. Custom elements are left alone. What cannot
 * be mended that way stays for sb_mesh_validate. */
SB_API sb_result sb_mesh_orient(sb_mesh *mesh, int *flipped, sb_error *error);
/* Orients a surface consistently: floods over the edges of exactly two elements; a closed part is turned
 * outward (its enclosed volume positive), an open one as most of its elements were. SB_ERROR_MESH when it is
 * one-sided. */
SB_API sb_result sb_mesh_orient_surface(sb_mesh *mesh, int *flipped, sb_error *error);
/* Merges nodes that lie within `tolerance` (m) of a node before them; negative: 1e-6 of the longest side of
 * the bounding box; 0: equal coordinates only. *merged: nodes removed. Elements may collapse: validate
 * afterwards. */
SB_API sb_result sb_mesh_merge_nodes(sb_mesh *mesh, sb_real tolerance, int *merged, sb_error *error);
/* Removes nodes of no element; *removed: how many. */
SB_API sb_result sb_mesh_remove_unreferenced(sb_mesh *mesh, int *removed, sb_error *error);
/* Removes elements with the same corners as an element before them; *removed: how many. */
SB_API sb_result sb_mesh_remove_duplicate_elements(sb_mesh *mesh, int *removed, sb_error *error);
/* Multiplies all coordinates by factor > 0 (0.001: millimetres to metres). */
SB_API sb_result sb_mesh_scale(sb_mesh *mesh, sb_real factor, sb_error *error);

/* ---- topology ------------------------------------------------------------------------------------------ */

/* A table of node or element indices. Free with sb_index_table_free. */
typedef struct sb_index_table {
    int rows, columns;
    int *items; /* [rows][columns] */
    sb_allocator allocator;
} sb_index_table;
SB_API void sb_index_table_free(sb_index_table *table);

/* Lists of different length: list i is items[offsets[i]] .. items[offsets[i + 1] - 1]. */
typedef struct sb_index_lists {
    int count;
    int *offsets; /* [count + 1] */
    int *items;   /* [offsets[count]] */
    sb_allocator allocator;
} sb_index_lists;
SB_API void sb_index_lists_free(sb_index_lists *lists);

/* The boundary of a volume mesh. Free with sb_boundary_free. */
typedef struct sb_boundary {
    sb_mesh surface; /* one type of faces, oriented outward; regions are those of the volume elements. Custom elements
                      * with faces of several types: tri3, into which the faces are cut at their nodes */
    int *elements;   /* [surface.element_count] volume element of each face */
    int *faces;      /* [surface.element_count] its local face, as in sb_element_face or the table */
    int *nodes;      /* [surface.node_count] volume node of each surface node; NULL when not compacted */
} sb_boundary;
SB_API void sb_boundary_free(sb_boundary *boundary);

/* Faces that belong to one element only, in the order of elements and faces. compact 0: the surface keeps all
 * nodes and the numbering of the volume; 1: it keeps the nodes it uses, in their order. */
SB_API sb_result sb_mesh_boundary(const sb_mesh *mesh, int compact, const sb_allocator *allocator,
                                  sb_boundary *boundary, sb_error *error);
/* Neighbour of each element across each face (surfaces: across each edge), [elements][faces or edges]; -1
 * where there is none or more than one. */
SB_API sb_result sb_mesh_neighbours(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_table *neighbours,
                                    sb_error *error);
/* Every edge once, corner to corner, [edges][2] with the smaller node first, sorted. */
SB_API sb_result sb_mesh_edges(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_table *edges,
                               sb_error *error);
/* The elements of each node, ascending. */
SB_API sb_result sb_mesh_node_elements(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_lists *lists,
                                       sb_error *error);
/* Part number of each element, [elements][1], from 0 in the order of their first element; elements that share
 * a node belong together. *count (or NULL): number of parts. */
SB_API sb_result sb_mesh_components(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_table *labels,
                                    int *count, sb_error *error);

/* ---- conversions --------------------------------------------------------------------------------------- */

/* The tet10 mesh with straight edges of a tet4 mesh: old nodes first, then one node per edge. Regions are
 * kept. */
SB_API sb_result sb_mesh_to_tet10(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *tet10, sb_error *error);
/* The hex20 or hex27 mesh with straight edges of a hex8 mesh: old nodes first, then one node per edge, and for hex27
 * one per face and one per element, each in the middle. Regions are kept. */
SB_API sb_result sb_mesh_to_hex20(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *hex20, sb_error *error);
SB_API sb_result sb_mesh_to_hex27(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *hex27, sb_error *error);
/* Renumbers nodes by reverse Cuthill-McKee and sorts elements by their lowest node: small bandwidth, good
 * cache use. Worth a call before a body is made of a mesh: a tangent of 9,600 tet10 is assembled in three
 * quarters of the time it takes with nodes as sb_mesh_beam numbers them, and in less than along a
 * space-filling curve; tet4 gain little. node_map [nodes] and element_map [elements] (each may be NULL)
 * receive the new number of each old one. */
SB_API sb_result sb_mesh_reorder(sb_mesh *mesh, int *node_map, int *element_map, sb_error *error);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- internal ------------------------------------------------------------------------------------------ */

/* Counts, type and pointers of a mesh, finite nodes and index range: what every room needs before it walks
 * one. */
SBI_API sb_result sbi_mesh_check_arrays(const sb_mesh *mesh, sb_error *error);
/* What the elements of a mesh are. */
SB_INLINE sbi_element sbi_mesh_element_kind(const sb_mesh *mesh)
{
    return sbi_element_make(mesh->element_type, mesh->table);
}
SB_INLINE int sbi_mesh_is_cloud(const sb_mesh *mesh) { return sbi_element_is_cloud(sbi_mesh_element_kind(mesh)); }
/* Cosines of the smallest and of the largest dihedral angle of a tet, whichever way it is oriented; NaN when flat. */
SBI_API void sbi_mesh_tet_cosines(const sb_vec3 corners[4], sb_real *of_smallest, sb_real *of_largest);
/* Arrays for a mesh, their contents not set; 0 (and nothing allocated) when memory is short. */
SBI_API int sbi_mesh_allocate(sb_mesh *mesh, sb_element_type type, int node_count, int element_count, int with_regions,
                              const sb_allocator *allocator);
/* Faces, edges or whole elements as keys: their corners sorted ascending, with equal keys side by side. */
typedef enum sbi_mesh_part {
    SBI_MESH_SIDES, /* faces of volumes, edges of surfaces */
    SBI_MESH_EDGES,
    SBI_MESH_WHOLE
} sbi_mesh_part;

/* Parts of all elements; part p belongs to element p / per_element. */
typedef struct sbi_mesh_keys {
    int count; /* parts */
    int per_element;
    int width;  /* corners per part; a part with fewer repeats its highest */
    int sorted; /* parts in `order`: those of elements that were not skipped */
    int *keys;  /* [count][width] corner nodes, ascending */
    int *order; /* [sorted] parts sorted by key, equal keys by part */
} sbi_mesh_keys;

/* Sorted keys of all parts of the elements that `skip` (may be NULL) does not mark; their indices are in
 * range. 0 when memory is short or the parts do not fit an int. */
SBI_API int sbi_mesh_keys_make(const sb_mesh *mesh, sbi_mesh_part part, const unsigned char *skip,
                               const sb_allocator *allocator, sbi_mesh_keys *keys);
SBI_API void sbi_mesh_keys_free(const sb_allocator *allocator, sbi_mesh_keys *keys);
/* End of the run of equal keys that begins at position `begin` of the order. */
SBI_API int sbi_mesh_run_end(const sbi_mesh_keys *keys, int begin);
/* representative[v]: the node that node v merges into (the first near it), v itself when it stays. Returns
 * the number of nodes that go, -1 when memory is short. */
SBI_API int sbi_mesh_find_duplicates(const sb_mesh *mesh, sb_real tolerance, const sb_allocator *allocator,
                                     int *representative);
/* How a face is cut into triangles with its nodes as corners; returns how many. */
SBI_API int sbi_mesh_face_triangles(sb_element_type type, const signed char (**triangles)[3]);
#endif

#endif /* SB_MESH_H */
