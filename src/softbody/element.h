/* element: node orders, shape functions, quadrature, faces and edges of every element type. Floor 1. */
#ifndef SB_ELEMENT_H
#define SB_ELEMENT_H

#include "dense.h"

/* Element types; the node orders are VTK's. tri6: edges 01 12 20. tet10: edges 01 12 02 03 13 23. */
typedef enum sb_element_type {
    SB_NO_ELEMENT = 0,
    SB_TRI3 = 1, /* surfaces */
    SB_TRI6 = 2,
    SB_QUAD4 = 3,
    SB_TET4 = 10, /* volumes */
    SB_TET10 = 11,
    SB_HEX8 = 12
} sb_element_type;

enum { SB_MAX_ELEMENT_NODES = 27, SB_MAX_FACE_NODES = 9, SB_MAX_QUADRATURE_POINTS = 27 };

/* ---- the compiled element types -----------------------------------------------------------------------
 * `#define SB_ELEMENT SB_TET10` before including compiles the loops over one volume type only. The
 * preprocessor cannot compare enum names, so each name has a code to paste. */
#define SBI_ELEMENT_CODE_SB_TET4 10
#define SBI_ELEMENT_CODE_SB_TET10 11
#define SBI_ELEMENT_CODE_SB_HEX8 12
#ifdef SB_ELEMENT
#define SBI_ELEMENT_PINNED SBI_PASTE(SBI_ELEMENT_CODE_, SB_ELEMENT)
#if SBI_ELEMENT_PINNED != 10 && SBI_ELEMENT_PINNED != 11 && SBI_ELEMENT_PINNED != 12
#error "softbody.h: SB_ELEMENT must be SB_TET4, SB_TET10 or SB_HEX8"
#endif
#else
#define SBI_ELEMENT_PINNED 0
#endif
/* 1 when loops over the volume type (a literal name: SB_TET4, SB_TET10, SB_HEX8) are compiled; works in
 * #if. */
#define SBI_ELEMENT_ENABLED(type) (SBI_ELEMENT_PINNED == 0 || SBI_ELEMENT_PINNED == SBI_ELEMENT_CODE_##type)

/* The volume type to dispatch on: a constant when SB_ELEMENT pins one. The caller has refused other types. */
SB_INLINE sb_element_type sbi_element_type_or_pinned(sb_element_type type)
{
#ifdef SB_ELEMENT
    (void)type;
    return SB_ELEMENT;
#else
    return type;
#endif
}
/* 1 for a volume type that this build simulates, else 0. */
SB_INLINE int sbi_element_is_enabled(sb_element_type type)
{
    return (SBI_ELEMENT_ENABLED(SB_TET4) && type == SB_TET4) ||
           (SBI_ELEMENT_ENABLED(SB_TET10) && type == SB_TET10) ||
           (SBI_ELEMENT_ENABLED(SB_HEX8) && type == SB_HEX8);
}

/* ---- counts ----------------------------------------------------------------------------------------------
 * All return 0 for a type that is none of the above. */

/* Nodes per element. */
SB_INLINE int sb_element_node_count(sb_element_type type)
{
    switch (type) {
    case SB_TRI3: return 3;
    case SB_TRI6: return 6;
    case SB_QUAD4: return 4;
    case SB_TET4: return 4;
    case SB_TET10: return 10;
    case SB_HEX8: return 8;
    case SB_NO_ELEMENT: break;
    }
    return 0;
}
/* Corners per element; they are the first nodes. */
SB_INLINE int sb_element_corner_count(sb_element_type type)
{
    switch (type) {
    case SB_TRI3:
    case SB_TRI6: return 3;
    case SB_QUAD4:
    case SB_TET4:
    case SB_TET10: return 4;
    case SB_HEX8: return 8;
    case SB_NO_ELEMENT: break;
    }
    return 0;
}
/* 2 for a surface, 3 for a volume. */
SB_INLINE int sb_element_dimension(sb_element_type type)
{
    int corners = sb_element_corner_count(type);
    return corners == 0 ? 0 : (type < SB_TET4 ? 2 : 3);
}
/* Faces per volume element; 0 for surfaces. */
SB_INLINE int sb_element_face_count(sb_element_type type)
{
    return sb_element_dimension(type) != 3 ? 0 : (type == SB_HEX8 ? 6 : 4);
}
/* Edges per element. */
SB_INLINE int sb_element_edge_count(sb_element_type type)
{
    int corners = sb_element_corner_count(type);
    return sb_element_dimension(type) == 3 ? (corners == 4 ? 6 : 12) : corners;
}

/* ---- names, faces, edges ------------------------------------------------------------------------------- */

/* Name of a type, e.g. "tet4"; "unknown" for none of them. Static storage. */
SB_API const char *sb_element_name(sb_element_type type);

/* Local node numbers of face `face` in [0, face_count), counter-clockwise seen from outside, and the face's
 * type (tri3, tri6, quad4; face_type may be NULL). Returns the number of nodes, 0 (nothing written) for no
 * such face. */
SB_API int sb_element_face(sb_element_type type, int face, int nodes[SB_MAX_FACE_NODES],
                           sb_element_type *face_type);

/* Local node numbers of edge `edge` in [0, edge_count): both ends, then the node between them or -1. Returns
 * the number of nodes on the edge (2 or 3), 0 (nothing written) for no such edge. */
SB_API int sb_element_edge(sb_element_type type, int edge, int nodes[3]);

/* ---- shape functions ----------------------------------------------------------------------------------
 * Parameters xi: triangles and tets r, s, t >= 0 with r + s + t <= 1 (corner 0 at the origin); quad and hex
 * [-1, 1] each. The third parameter of a surface is ignored. */

/* Parameters of local node `node`; returns 1, or 0 (nothing written) for no such node. */
SB_API int sb_element_node_point(sb_element_type type, int node, sb_real xi[3]);

/* Shape functions N and their gradients dN/dxi at xi. shape: [nodes] or NULL; gradient: [nodes][3] or NULL,
 * the third component 0 for surfaces. Nothing is written for an unknown type. */
SB_API void sb_element_shape(sb_element_type type, const sb_real xi[3], sb_real *shape,
                             sb_real (*gradient)[3]);

/* ---- quadrature -----------------------------------------------------------------------------------------*/

/* What a rule must integrate. Surfaces have one rule, good for all four; volumes have no
 * SB_QUADRATURE_FACE. */
typedef enum sb_quadrature_kind {
    SB_QUADRATURE_STIFFNESS = 0,        /* straight sides: tet4 1 point, tet10 4, hex8 8 */
    SB_QUADRATURE_STIFFNESS_CURVED = 1, /* curved sides: tet10 8 (4 fail the patch test), others as above */
    SB_QUADRATURE_MASS = 2,             /* exact consistent mass: tet4 4, tet10 14, hex8 8 */
    SB_QUADRATURE_FACE = 3              /* surface loads: tri3 3, tri6 6, quad4 4 */
} sb_quadrature_kind;

/* Points (parameters xi) and weights of a rule; the weights sum to the parameter domain's measure (tet 1/6,
 * triangle 1/2, hex 8, quad 4). Returns the number of points, 0 (nothing written) when there is no such rule.
 * Point order: tets by the corner a point is nearest to, hexes with xi fastest, as in Abaqus and CalculiX. */
SB_API int sb_element_quadrature(sb_element_type type, sb_quadrature_kind kind,
                                 sb_real points[SB_MAX_QUADRATURE_POINTS][3],
                                 sb_real weights[SB_MAX_QUADRATURE_POINTS]);

#endif /* SB_ELEMENT_H */
