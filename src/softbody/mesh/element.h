/* element: node orders, shape functions, quadrature, faces and edges of every element type. Floor 1. */
#ifndef SB_ELEMENT_H
#define SB_ELEMENT_H

#include "../base/dense.h"

/* Element types; the node orders are VTK's. Corners come first, then the middles of the edges, then those of the
 * faces, then the centre.
 *   tri6: edges 01 12 20; quad8: 01 12 23 30; quad9: also the centre
 *   tet10: edges 01 12 02 03 13 23
 *   hex20: edges 01 12 23 30, 45 56 67 74, 04 15 26 37; hex27: also the faces x- x+ y- y+ z- z+ and the centre
 * A custom element is a volume described by an sb_element_table, see below. */
typedef enum sb_element_type {
    SB_NO_ELEMENT = 0,
    SB_TRI3 = 1, /* surfaces */
    SB_TRI6 = 2,
    SB_QUAD4 = 3,
    SB_QUAD8 = 4,
    SB_QUAD9 = 5,
    SB_TET4 = 10, /* volumes */
    SB_TET10 = 11,
    SB_HEX8 = 12,
    SB_HEX20 = 13,
    SB_HEX27 = 14,
    SB_CUSTOM = 15
} sb_element_type;

enum {
    SB_MAX_ELEMENT_NODES = 32,
    SB_MAX_FACE_NODES = 9,
    SB_MAX_ELEMENT_FACES = 12,
    SB_MAX_ELEMENT_EDGES = 24,
    SB_MAX_QUADRATURE_POINTS = 27
};

/* ---- the compiled element types -----------------------------------------------------------------------
 * `#define SB_ELEMENT SB_TET10` before including compiles the loops over one volume type only. The
 * preprocessor cannot compare enum names, so each name has a code to paste. */
#define SBI_ELEMENT_CODE_SB_TET4 10
#define SBI_ELEMENT_CODE_SB_TET10 11
#define SBI_ELEMENT_CODE_SB_HEX8 12
#define SBI_ELEMENT_CODE_SB_HEX20 13
#define SBI_ELEMENT_CODE_SB_HEX27 14
#define SBI_ELEMENT_CODE_SB_CUSTOM 15
#ifdef SB_ELEMENT
#define SBI_ELEMENT_PINNED SBI_PASTE(SBI_ELEMENT_CODE_, SB_ELEMENT)
#if SBI_ELEMENT_PINNED < 10 || SBI_ELEMENT_PINNED > 15
#error "softbody.h: SB_ELEMENT must be SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27 or SB_CUSTOM"
#endif
#else
#define SBI_ELEMENT_PINNED 0
#endif
/* 1 when loops over the volume type (a literal name, such as SB_TET4) are compiled; works in #if. */
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
    return (SBI_ELEMENT_ENABLED(SB_TET4) && type == SB_TET4) || (SBI_ELEMENT_ENABLED(SB_TET10) && type == SB_TET10) ||
           (SBI_ELEMENT_ENABLED(SB_HEX8) && type == SB_HEX8) || (SBI_ELEMENT_ENABLED(SB_HEX20) && type == SB_HEX20) ||
           (SBI_ELEMENT_ENABLED(SB_HEX27) && type == SB_HEX27) || (SBI_ELEMENT_ENABLED(SB_CUSTOM) && type == SB_CUSTOM);
}

/* ---- counts ----------------------------------------------------------------------------------------------
 * All return 0 for a type that is none of the above, and but for the dimension also for SB_CUSTOM, whose counts are
 * in its table. */

/* Nodes per element. */
SB_INLINE int sb_element_node_count(sb_element_type type)
{
    switch (type) {
    case SB_TRI3: return 3;
    case SB_TRI6: return 6;
    case SB_QUAD4: return 4;
    case SB_QUAD8: return 8;
    case SB_QUAD9: return 9;
    case SB_TET4: return 4;
    case SB_TET10: return 10;
    case SB_HEX8: return 8;
    case SB_HEX20: return 20;
    case SB_HEX27: return 27;
    case SB_CUSTOM:
    case SB_NO_ELEMENT: break;
    }
    return 0;
}
/* The element of the corners alone: tri3, quad4, tet4 or hex8; SB_CUSTOM and SB_NO_ELEMENT are their own. */
SB_INLINE sb_element_type sb_element_straight(sb_element_type type)
{
    switch (type) {
    case SB_TRI3:
    case SB_TRI6: return SB_TRI3;
    case SB_QUAD4:
    case SB_QUAD8:
    case SB_QUAD9: return SB_QUAD4;
    case SB_TET4:
    case SB_TET10: return SB_TET4;
    case SB_HEX8:
    case SB_HEX20:
    case SB_HEX27: return SB_HEX8;
    case SB_CUSTOM: return SB_CUSTOM;
    case SB_NO_ELEMENT: break;
    }
    return SB_NO_ELEMENT;
}
/* Corners per element; they are the first nodes. */
SB_INLINE int sb_element_corner_count(sb_element_type type) { return sb_element_node_count(sb_element_straight(type)); }
/* 2 for a surface, 3 for a volume. */
SB_INLINE int sb_element_dimension(sb_element_type type)
{
    sb_element_type straight = sb_element_straight(type);
    return straight == SB_NO_ELEMENT ? 0 : (straight < SB_TET4 ? 2 : 3);
}
/* Faces per volume element; 0 for surfaces. */
SB_INLINE int sb_element_face_count(sb_element_type type)
{
    sb_element_type straight = sb_element_straight(type);
    return straight == SB_HEX8 ? 6 : (straight == SB_TET4 ? 4 : 0);
}
/* Edges per element. */
SB_INLINE int sb_element_edge_count(sb_element_type type)
{
    int corners = sb_element_corner_count(type);
    return sb_element_dimension(type) == 3 ? (corners == 4 ? 6 : (corners == 8 ? 12 : 0)) : corners;
}

/* ---- names, faces, edges ------------------------------------------------------------------------------- */

/* Name of a type, e.g. "tet4"; "custom" for SB_CUSTOM, "unknown" for none of them. Static storage. */
SB_API const char *sb_element_name(sb_element_type type);

/* Local node numbers of face `face` in [0, face_count), counter-clockwise seen from outside, and the face's
 * type (tri3, tri6, quad4, quad8, quad9; face_type may be NULL). Returns the number of nodes, 0 (nothing written)
 * for no such face. */
SB_API int sb_element_face(sb_element_type type, int face, int nodes[SB_MAX_FACE_NODES], sb_element_type *face_type);

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
SB_API void sb_element_shape(sb_element_type type, const sb_real xi[3], sb_real *shape, sb_real (*gradient)[3]);

/* ---- quadrature -----------------------------------------------------------------------------------------*/

/* What a rule must integrate. Surfaces have one rule, good for all four; volumes have no
 * SB_QUADRATURE_FACE. hex20 and hex27 have 27 points for all (2 x 2 x 2 leave hex20 six motions without force). */
typedef enum sb_quadrature_kind {
    SB_QUADRATURE_STIFFNESS = 0,        /* straight sides: tet4 1 point, tet10 4, hex8 8 */
    SB_QUADRATURE_STIFFNESS_CURVED = 1, /* curved sides: tet10 8 (4 fail the patch test), others as above */
    SB_QUADRATURE_MASS = 2,             /* exact consistent mass: tet4 4, tet10 14, hex8 8 */
    SB_QUADRATURE_FACE = 3              /* surface loads: tri3 3, tri6 6, quad4 4, quad8 and quad9 9 */
} sb_quadrature_kind;

/* Points (parameters xi) and weights of a rule; the weights sum to the parameter domain's measure (tet 1/6,
 * triangle 1/2, hex 8, quad 4). Returns the number of points, 0 (nothing written) when there is no such rule.
 * Point order: tets by the corner a point is nearest to, hexes with xi fastest, as in Abaqus and CalculiX. */
SB_API int sb_element_quadrature(sb_element_type type, sb_quadrature_kind kind,
                                 sb_real points[SB_MAX_QUADRATURE_POINTS][3],
                                 sb_real weights[SB_MAX_QUADRATURE_POINTS]);

/* ---- elements of your own -----------------------------------------------------------------------------------
 * A mesh of SB_CUSTOM refers to a table that says what its elements are. From there on they are like any others:
 * bodies, steps, static solves, tractions, boundary, quality and VTK output take them. A table and what it points at
 * is plain data of yours, only read, and must live as long as the meshes and bodies made with it.
 * examples/custom_element.c fills one in.
 *
 * A table with nothing but name, node_count, corner_count = node_count and perhaps vtk_type 2 describes a cloud: nodes
 * that share one integration point and have no shape between them, as the neighbours of a particle. A mesh of clouds
 * may name a node several times in an element. Its bodies need a domain with masses (sb_body_def.domain, see
 * particles.h), which alone says what a cloud weighs and resists; whatever asks for faces, edges or a shape is refused
 * with SB_ERROR_UNSUPPORTED. */

/* A face: its nodes counter-clockwise seen from outside, in the order of its type (tri3, tri6, quad4, quad8, quad9). */
typedef struct sb_element_table_face {
    sb_element_type type;
    int nodes[SB_MAX_FACE_NODES]; /* local node numbers; those after the type's count are not read */
} sb_element_table_face;

typedef struct sb_element_table {
    const char *name;                /* for messages */
    int node_count;                  /* in [4, SB_MAX_ELEMENT_NODES] */
    int corner_count;                /* in [4, node_count]; the corners are the first nodes */
    const sb_real (*node_points)[3]; /* [node_count] parameters xi of the nodes */
    /* Shape functions and gradients dN/dxi at xi, as sb_element_shape: shape[node_count] or NULL, gradient
     * [node_count][3] or NULL. Called from one thread, while meshes are checked, bodies are made, and in linearised
     * steps from the job's threads; same xi, same numbers. Gradients at nodes may be anything where they have no
     * value (the tip of a pyramid). */
    void (*shape)(const void *user, const sb_real xi[3], sb_real *shape, sb_real (*gradient)[3]);
    const void *user;           /* handed to shape */
    int point_count;            /* points of the stiffness, in [1, SB_MAX_QUADRATURE_POINTS]; with too few of them an
                                 * element has motions that cost nothing (hex8 needs 8, not 1) */
    const sb_real (*points)[3]; /* [point_count] parameters */
    const sb_real *weights;     /* [point_count] > 0; their sum is the volume of the parameter domain */
    int mass_point_count;       /* points of the mass; a rule that is exact for products of shape functions */
    const sb_real (*mass_points)[3];    /* [mass_point_count] */
    const sb_real *mass_weights;        /* [mass_point_count] */
    int face_count;                     /* in [4, SB_MAX_ELEMENT_FACES] */
    const sb_element_table_face *faces; /* [face_count]; together they close around the element. Edges follow from
                                         * them */
    int vtk_type;                       /* cell type of VTK files whose node order this is (13 wedge, 14 pyramid), or 0:
                                         * meshes cannot be written */
} sb_element_table;

/* Checks whether a table describes an element that can be computed with, or a cloud. SB_ERROR_ARGUMENT (null pointer, a
 * count out of range, weights not positive or with another sum than the volume inside the faces, faces that do not
 * close or look inward, functions that are not 1 at their node and 0 at others, do not sum to 1 or do not reproduce xi,
 * gradients that are not their slopes, a node without mass), SB_ERROR_INDEX (a face's node), SB_ERROR_NOT_FINITE; the
 * message names what, and error->node the local node where there is one. error may be NULL. */
SB_API sb_result sb_element_table_check(const sb_element_table *table, sb_error *error);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- internal: any element ---------------------------------------------------------------------------------- */

/* A type, and for SB_CUSTOM its checked table. Each function below is the one of the same name above. */
typedef struct sbi_element {
    sb_element_type type;
    const sb_element_table *table;
} sbi_element;

SB_INLINE sbi_element sbi_element_make(sb_element_type type, const sb_element_table *table)
{
    sbi_element element;
    element.type = type;
    element.table = type == SB_CUSTOM ? table : NULL;
    return element;
}
/* 1 when the table is that of a cloud. */
SB_INLINE int sbi_element_table_is_cloud(const sb_element_table *table)
{
    return table && !table->shape && !table->node_points && !table->points && !table->weights && !table->mass_points &&
           !table->mass_weights && !table->faces && table->point_count == 0 && table->mass_point_count == 0 &&
           table->face_count == 0;
}
SB_INLINE int sbi_element_is_cloud(sbi_element element) { return sbi_element_table_is_cloud(element.table); }
SB_INLINE int sbi_element_node_count(sbi_element element)
{
    return element.table ? element.table->node_count : sb_element_node_count(element.type);
}
SB_INLINE int sbi_element_corner_count(sbi_element element)
{
    return element.table ? element.table->corner_count : sb_element_corner_count(element.type);
}
SB_INLINE int sbi_element_face_count(sbi_element element)
{
    return element.table ? element.table->face_count : sb_element_face_count(element.type);
}
SBI_API int sbi_element_edge_count(sbi_element element);
SBI_API const char *sbi_element_name(sbi_element element);
SBI_API int sbi_element_face(sbi_element element, int face, int nodes[SB_MAX_FACE_NODES], sb_element_type *face_type);
SBI_API int sbi_element_edge(sbi_element element, int edge, int nodes[3]);
SBI_API int sbi_element_node_point(sbi_element element, int node, sb_real xi[3]);
SBI_API void sbi_element_shape(sbi_element element, const sb_real xi[3], sb_real *shape, sb_real (*gradient)[3]);
SBI_API int sbi_element_quadrature(sbi_element element, sb_quadrature_kind kind,
                                   sb_real points[SB_MAX_QUADRATURE_POINTS][3],
                                   sb_real weights[SB_MAX_QUADRATURE_POINTS]);
#endif

#endif /* SB_ELEMENT_H */
