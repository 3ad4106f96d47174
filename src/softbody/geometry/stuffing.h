/* stuffing: a tetrahedral mesh from any closed surface or signed distance, with bounded dihedral angles. Floor 2.
 * Isosurface stuffing (Labelle and Shewchuk 2007): a body-centred cubic lattice is laid over the shape, lattice points
 * near the surface are moved onto it, and the tets that it still crosses are cut by stencils. No size of the input
 * triangles, their quality or their number enters the mesh. */
#ifndef SB_STUFFING_H
#define SB_STUFFING_H

#include "../mesh/mesh.h"
#include "surface.h"

/* Shapes of one mesh, at most. */
#define SB_STUFF_MAX_SHAPES 64

/* What to mesh and how finely. Start from sb_default_stuff_def(), set shapes and cell, change what you like.
 *
 * The first shape is the body; what follows lies inside it, nested or side by side: skin, prostate, bone. Where shapes
 * overlap the later one wins; what sticks out of the first is cut off. Regions share the nodes of the faces between
 * them. Shapes closer together than a cell keep their labels at lattice points, but the face between them gives way by
 * up to a cell; the outer boundary never does. */
typedef struct sb_stuff_def {
    const sb_shape *shapes; /* [shape_count] borrowed. Surfaces: closed, but they may cross themselves (inside is
                             * where the winding number says so) */
    int shape_count;        /* 1 to SB_STUFF_MAX_SHAPES */
    sb_vec3 low, high;      /* box (m) that the first shape is sampled in and cut off at; not read where that is a
                             * surface, which brings its own */
    sb_real cell;           /* edge of the cubic lattice's cells (m) at the surfaces; > 0. 12 tets per cell */
    int levels;             /* 0: one cell size; k: cells inside grow to up to 2^k cells, in [0, 8] */
    sb_element_type type;   /* SB_TET4 (default) or SB_TET10 with straight edges */
    int max_elements;       /* more than that are refused; default 20 million */
    sb_real least_share;    /* a mesh that keeps less of the first shape, by volume or by surface, or of another one
                             * by both, is refused with the cell that would do, in [0, 1]; default 0.5. 0:
                             * whatever comes out is taken */
    int (*progress)(void *user, double fraction); /* called now and then by the caller's thread, fraction in [0, 1];
                                                   * a result other than 0 cancels. Default NULL */
    void *progress_user;
    sb_allocator allocator; /* of the mesh and of all scratch; default malloc */
    sb_jobs jobs;           /* of sampling; default inline */
    unsigned cookie;        /* set by sb_default_stuff_def; a def made without it is refused */
} sb_stuff_def;

/* What came out. */
typedef struct sb_stuff_report {
    int cells[3]; /* of the lattice, along x, y, z */
    int node_count, element_count;
    sb_real min_dihedral, max_dihedral; /* degrees */
    sb_real distance; /* largest distance (m) of the mesh's boundary to the first shape, at 16 points of each of
                       * its triangles; functions: to where a few Newton steps end */
    sb_real volume;   /* m^3 */
    /* Of each shape, what of it lies in the first one: share of its volume that the mesh has (closed surfaces: exact
     * but where they overlap themselves, which counts twice; functions: of a sample of points), and share of its
     * surface within half a cell of the boundary of its part of the mesh. -1: unknown (open surfaces; nothing lies
     * inside). */
    sb_real volume_share[SB_STUFF_MAX_SHAPES], surface_share[SB_STUFF_MAX_SHAPES];
} sb_stuff_report;

SB_API sb_stuff_def sb_default_stuff_def(void);

/* Makes the mesh: positively oriented tets with regions, all nodes used, ready for sb_body_create.
 *
 * Every dihedral angle lies in 10.7 to 164.8 degrees, for one shape or several, with levels or without: what is cut or
 * moved belongs to cells of the finest size only, and the tets between sizes have 45 to 120 degrees.
 *
 * The boundary is closed and manifold. Its nodes lie on the surface, but for a few (by less than a third of a cell)
 * where the shape is about as thin as a cell or angles would suffer. Where its triangles cut a corner by more than 0.3
 * cells, nodes slide along the surface and edges are split as long as the angles allow it; when that does not bring the
 * boundary within a third of a cell (a thin part ends between lattice points), up to twelve places of the lattice are
 * tried and the nearest mesh is kept. Look at report->distance where it matters: it is larger still for some shapes
 * with sharp thin parts. What is thinner than a cell may be missing, in part or as a whole, or join across a gap; parts
 * that come loose stay (sb_mesh_components finds them). report->volume_share and surface_share report how much is
 * missing; where it is more than def->least_share allows, there is no mesh but an error that names a cell for the
 * thickness of what is missing.
 *
 * mesh: overwritten, not freed. report: or NULL. Nodes and elements are numbered as by sb_mesh_reorder; the same bits
 * for any number of threads. Failures leave mesh and report untouched: SB_ERROR_ARGUMENT (field named; more cells or
 * elements than allowed, the message has their number), SB_ERROR_NOT_FINITE (field, or a point where the distance is
 * not), SB_ERROR_MESH (less than least_share is kept, or nothing: the cell is too large; a surface, or a part of it, is
 * inside out: error->element is one of its faces),
 * SB_ERROR_CANCELLED, SB_ERROR_MEMORY. Cost: distances are taken near the surfaces only, O(surface); two bytes per
 * cell of the box, the rest O(mesh). */
SB_API sb_result sb_mesh_stuff(const sb_stuff_def *def, sb_mesh *mesh, sb_stuff_report *report, sb_error *error);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Fills in the shares that a tet4 mesh (empty: none) keeps of the shapes; SB_ERROR_MESH where one is below
 * least_share. */
SBI_API sb_result sbi_stuffing_measure_shares(const sb_stuff_def *def, const sb_mesh *mesh, sb_stuff_report *report,
                                              sb_error *error);
#endif

#endif /* SB_STUFFING_H */
