/* live_mesh: a body whose mesh changes while it lives: split, cut, eroded, remeshed. Floor 3.
 *
 *     sb_body_change *change;
 *     sb_body_change_begin(body, &change, &error);
 *     sb_body_change_add_node(change, x, ends, halves, 2, 0, &middle, &error);
 *     ... remove the cells of the edge, add their halves ...
 *     if (sb_body_change_commit(change, &error)) sb_body_change_cancel(change);
 *
 * Needs def.slack > 0. Nodes and cells live in slots: they keep their numbers while they exist, and the slot removed
 * last is used first, so that a change and its inverse give back the same numbers. sb_body_node_count and
 * sb_body_element_count count slots, free ones among them (sb_body_node_in_use, sb_body_cell_in_use): arrays by node
 * and cell have an entry for each. A free node is held, shows no motion and has no mass; a free cell has no volume and
 * no stress.
 *
 * What a change does to what is there:
 * - Motion: a node made has the weighted displacement, velocity and acceleration of its sources, and so has a node that
 *   was moved with sources (along axes that it is supported along only where all of them are). Where the cells made
 *   weigh what those they replace did, the nodes of the cells that changed then get a common rigid velocity, so that
 *   linear and angular momentum are what they were, to rounding. Nodes with supports get none of it; momentum that the
 *   others cannot take (fewer than three, or in one line) goes to the supports.
 *   Cells removed for good take their mass and its momentum along: velocities stay.
 * - Cells: one made with a parent has its region, fibre, rotation and what its Prony terms remember.
 * - Pieces: where a cut parts a cell, each piece of it becomes a cell with the parent's shape functions and its own
 *   volume and moments (sb_cell_moments), on copies of the nodes that it is parted from. Stiffness, loads and lumped
 *   masses are integrals over the piece and sum to those of the whole cell, so that at the instant of the cut nothing
 *   jumps: not mass, momentum or energy (of tet10 elastic energy by up to 0.5 % in blocks that hang under their weight,
 *   where bodies do not step explicitly: the mid nodes of small pieces are held to the middle of their edges, or
 *   solvers would need many more iterations, and points are others where the material is not linear). A piece may
 *   have a share of 0; nodes with no other cells are held where they are, and feel nothing. Steps of a cut beam take
 *   at most 1.3 times the iterations of the uncut one, slivers included; with SB_PRECOND_MULTIGRID and tet10 1.5
 *   times.
 * - Supports: a node made is supported along the axes that all its sources are, at their weighted targets; a copy
 *   (SB_NODE_COPY) only along those that it is asked to keep (SB_NODE_KEEP_X ...). A node moved keeps its supports,
 *   with weighted targets where all its sources have them. A supported node without heirs cannot be removed
 *   (SB_ERROR_ARGUMENT): release it first.
 * - Dead loads stay with their nodes; a removed node's go to its heirs, or with it. Tractions on faces of tet4 and
 *   tet10 are kept by face besides, and go to its parts where it is cut.
 * - Pressures: a face that was split passes its pressure on to its parts; one whose cell went is no longer loaded.
 *   Where a tet falls into pieces, each has what acts on its part of the face (face_loads): force and moment are what
 *   they were, to rounding; on faces of tet10 that are bent the moment is, but for what bends (see cut.h). What a cut
 *   lays open is not loaded. A load cannot lose its last face (SB_ERROR_ARGUMENT).
 * - Springs and mappings: a removed node's weight goes to its heirs (a spring needs one heir); a row that is a point in
 *   a removed cell becomes the same material point of the cell made there, of an element that is cut of the piece that
 *   has it. Points in space stay.
 * - Constraints and ties: a removed master's coefficient goes to its heirs; a slave cannot be removed
 *   (SB_ERROR_ARGUMENT).
 * - Glue of a cut (cut.h) goes with a cell that is replaced or removed, and with a node that moves, and its energy too.
 * - Embeddings follow where they are asked to (sb_embedding_follow); others do not know of the change, and their points
 *   are wrong.
 * - Others may follow (sb_body_listen). Registrations do not: their next step says so (SB_ERROR_STATE), and they are
 *   made anew.
 *
 * Cost: a body of tet4 makes a change in place, in time proportional to what changed (tests/bench/RESULTS.md) but for a
 * copy of the lists of slots, a sum over groups of eight cells, and a pass over the nodes where parts come apart, meet
 * or get another first node, or a box loses a side; without an allocation while def.slack lasts. Lists for 1000 cells
 * in one change are there from the start. The first step after it colours chunks, lists the rows of IC(0) or SSOR and
 * cuts the coarse space's pieces again; all depend on the mesh alone (multigrid's levels also on the materials that the
 * body was made from), so iterations, states and changes taken back are those of a body made with that mesh.
 * SB_PRECOND_MULTIGRID (the choice of SB_PRECOND_AUTO from some 10,000 nodes on), FSAI and CHOLESKY are made anew with
 * the change, which allocates and takes time by the mesh (of 86,000 cells 35 ms); where there is no memory for them the
 * change holds, and steps say SB_ERROR_MEMORY until there is. Everything is made anew instead, at the cost of creation
 * (19 ms for 13,000 cells), where arrays have to grow, elements are not tet4 or have patches, there are constraints or
 * mappings that couple beyond cells, or a load is on what changes. The bits are the same either way. Consistent masses
 * cost a pass over all cells, Prony terms one over their memory.
 *
 * Pointers to arrays by node (sb_body_positions ...) stay valid while def.slack lasts; a change beyond it allocates
 * half as much again, and they have to be asked for anew. */
#ifndef SB_LIVE_MESH_H
#define SB_LIVE_MESH_H

#include "../mesh/mesh_change.h"
#include "body.h"

typedef struct sb_body_change sb_body_change;

/* Options of a node, to be added. */
enum {
    SB_NODE_COPY = 1,   /* a copy where material parts: supports do not go over to it, unless along */
    SB_NODE_KEEP_X = 2, /* axes that it is to be supported along as its sources are: its pieces keep a supported face */
    SB_NODE_KEEP_Y = 4,
    SB_NODE_KEEP_Z = 8
};

/* Where in a tet its material is, in the tet's coordinates xi (sb_element_shape), which are barycentrics 1, 2 and 3; of
 * the whole tet c = (1, 1, 1)/4, and S has 3/80 on the diagonal and -1/80 beside it. */
typedef struct sb_cell_moments {
    sb_vec3 centroid;   /* c = 1/V int xi dV, V the volume of the material */
    sb_mat3 covariance; /* S = 1/V int (xi - c)(xi - c)^T dV, symmetric */
} sb_cell_moments;

/* A cell to be made. Start from sb_default_change_cell(). */
typedef struct sb_change_cell {
    const int *nodes; /* as many as the body's elements have, in their order; read during the call */
    int parent; /* cell, as numbered before the change, that it inherits from; -1 (default): none, it is at rest */
    int region; /* one that the mesh had at creation; SB_AUTO (default): the parent's, or the first */
    const sb_vec3 *fibre; /* direction, or NULL (default): the parent's, or none */
    sb_real share; /* of the cell's volume that is material, (0, 1], with moments also 0; default 1. Less where a cut
                    * leaves part of a cell: stiffness and mass are its share of the whole cell's */
    const sb_cell_moments *moments; /* of the material of a piece of tet4 or straight tet10: mass and points are where
                                     * it is. NULL (default): spread over all of the cell */
    const sb_real *face_loads; /* [4][3] of a piece of tet4, [4][6] of tet10: int N_a dA over its part of each face, by
                                * the face's nodes (sb_element_face), over the area of the face: they sum to its share
                                * of the face. NULL (default): all of each face */
} sb_change_cell;
SB_API sb_change_cell sb_default_change_cell(void);

/* Begins a change; one at a time. Nothing happens to the body before the commit. Errors of the calls below leave the
 * change as it was before them: it can go on. SB_ERROR_UNSUPPORTED: def.slack was 0. SB_ERROR_STATE: another change is
 * open. SB_ERROR_MEMORY. */
SB_API sb_result sb_body_change_begin(sb_body *body, sb_body_change **change, sb_error *error);

/* Makes a node at a place of the reference shape (m); *node is its number.
 * sources, weights  [count] nodes in use before the change or made by it, >= 1; weights >= 0 that sum to 1
 * flags             0 or SB_NODE_COPY with SB_NODE_KEEP_X ...
 * SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE, SB_ERROR_INDEX (error->node), SB_ERROR_MEMORY. */
SB_API sb_result sb_body_change_add_node(sb_body_change *change, sb_vec3 position, const int *sources,
                                         const sb_real *weights, int count, int flags, int *node, sb_error *error);
/* Moves a node in the reference shape (m). Its cells change shape, also those not named here. The last move of a node
 * counts.
 * sources, weights  [count] as of sb_body_change_add_node: those of the new place in the mesh before the change, so
 *                   that the body's motion stays where it was while the node slides through it. count 0: the node keeps
 *                   the motion it has, a made one that of its sources
 * Errors as of sb_body_change_add_node. */
SB_API sb_result sb_body_change_move_node(sb_body_change *change, int node, sb_vec3 position, const int *sources,
                                          const sb_real *weights, int count, sb_error *error);
/* Removes a node in use before the change.
 * heirs, weights  [count] nodes, >= 0, that what refers to the node goes over to; weights sum to 1. 0: nobody */
SB_API sb_result sb_body_change_remove_node(sb_body_change *change, int node, const int *heirs, const sb_real *weights,
                                            int count, sb_error *error);
/* Makes a cell; *number (may be NULL) is its number. Nodes may still be to come until the commit.
 * SB_ERROR_ARGUMENT, SB_ERROR_INDEX, SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY; SB_ERROR_UNSUPPORTED: moments in a body of
 * other cells than tet4 or tet10, with more than 4 points to a cell, or with consistent masses of tet10. */
SB_API sb_result sb_body_change_add_cell(sb_body_change *change, const sb_change_cell *cell, int *number,
                                         sb_error *error);
/* Removes a cell and makes another in its slot. */
SB_API sb_result sb_body_change_replace_cell(sb_body_change *change, int number, const sb_change_cell *cell,
                                             sb_error *error);
SB_API sb_result sb_body_change_remove_cell(sb_body_change *change, int number, sb_error *error);

/* Checks the change as a whole, takes all memory that following needs, and makes it. On SB_OK the change is gone; on
 * failure the body is as it was to the last bit, the change is still open, and the error names node or cell:
 * SB_ERROR_INDEX (a cell with a node that is not in use, or twice the same; a removed node that still has a cell),
 * SB_ERROR_MESH (a cell inside out or flat; a node left without a cell; no cell left), SB_ERROR_UNSUPPORTED (a piece of
 * a tet10 with curved sides), SB_ERROR_ARGUMENT (what would lose its node, see above), SB_ERROR_STATE (a state with
 * another mesh was loaded meanwhile, or a needle is in the tissue, whose mesh is the needle's alone then),
 * SB_ERROR_MEMORY, or what a listener says. */
SB_API sb_result sb_body_change_commit(sb_body_change *change, sb_error *error);
SB_API void sb_body_change_cancel(sb_body_change *change); /* NULL is fine */

/* ---- readings ---- */
SB_API int sb_body_node_in_use(const sb_body *body, int node);
SB_API int sb_body_cell_in_use(const sb_body *body, int cell);
/* Nodes of a cell in use, or NULL; valid until the next change. */
SB_API const int *sb_body_cell_nodes(const sb_body *body, int cell);
/* Share of a cell's volume that is material; 0 for a free one and an empty piece. */
SB_API sb_real sb_body_cell_share(const sb_body *body, int cell);
/* [node_count] the reference shape (m). */
SB_API const sb_vec3 *sb_body_rest_positions(const sb_body *body);
/* Rises with every change, and with every state loaded whose mesh is another; 0: none yet. */
SB_API int sb_body_mesh_version(const sb_body *body);
/* Where cells are pieces of elements, which all have the whole element's shape: the cell with the material at xi of the
 * element that `cell` is a piece of (largest least barycentric coordinate, then the lowest piece), as the sb_cut that
 * cut the body knows. The cell itself where it is none, or where nobody knows. -1: no such cell, or NULL. */
SB_API int sb_body_find_cell(const sb_body *body, int cell, const sb_real xi[3]);
/* The mesh without free slots, in the order of the slots, with regions. nodes [sb_body_node_count] and cells
 * [sb_body_element_count] become their numbers in it, -1 of free ones; may be NULL. Release with sb_mesh_free.
 * SB_ERROR_ARGUMENT, SB_ERROR_MEMORY leave all untouched. */
SB_API sb_result sb_body_get_mesh(const sb_body *body, const sb_allocator *allocator, sb_mesh *mesh, int *nodes,
                                  int *cells, sb_error *error);
/* Whether slots, masses, volumes, lists and matrix are what the mesh says: for tests. SB_ERROR_STATE names the first
 * fault. Allocates scratch (SB_ERROR_MEMORY). */
SB_API sb_result sb_body_live_check(const sb_body *body, sb_error *error);

/* ---- those that follow ---- */
/* Calls that learn of changes. All members but follow may be NULL. */
typedef struct sb_body_listener {
    void *user;
    /* Before anything changes: takes the memory that following needs, or refuses with an error. */
    sb_result (*reserve)(void *user, const sb_body *body, const sb_mesh_change *change, sb_error *error);
    /* The change happened. change NULL: the whole mesh is another (a state was loaded). */
    void (*follow)(void *user, const sb_body *body, const sb_mesh_change *change);
    /* Another refused after reserve. */
    void (*give_up)(void *user);
    /* The body is being destroyed, and is not to be read; the listener is gone. */
    void (*end)(void *user);
} sb_body_listener;
/* Called in the order of registration, after the body's own loads and constraints and the embeddings that follow it.
 * *id serves to end it; listeners end with the body, too. SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (def.slack was 0),
 * SB_ERROR_MEMORY. */
SB_API sb_result sb_body_listen(sb_body *body, const sb_body_listener *listener, int *id, sb_error *error);
SB_API sb_result sb_body_unlisten(sb_body *body, int id);

#endif /* SB_LIVE_MESH_H */
