/* mesh_change: one change of a live mesh, as whoever keeps data by node or cell learns of it. */
#ifndef SB_MESH_CHANGE_H
#define SB_MESH_CHANGE_H

#include "../base/dense.h"

/* Nodes and cells live in slots: they keep their numbers while they exist, and slots that were removed last are used
 * first. A slot that is removed and used again within one change stands in both lists: rooms take out all that goes
 * before they bring in what comes. A source may be a slot that this change removes or makes: rooms read all sources
 * before they write any node.
 *
 * A change is checked before it gets here: indices are in range, lists have no entry twice, cells that came name nodes
 * that are in use after it, and nodes that went have no cell left. Arrays are valid during the call only; those of
 * count 0 may be NULL.
 *
 * A free slot of a cell has weights and gradients 0 and names node 0 at every corner, so that most loops need no test.
 * A free node has no cell.
 *
 * A room has two calls. sbi_ROOM_reserve takes all memory that following needs: it may fail, and changes nothing that
 * can be seen. sbi_ROOM_follow then cannot fail. */
typedef struct sb_mesh_change {
    int node_end,
        cell_end;       /* slots in use or free lie below these, after the change; they fall when the last ones go */
    int nodes_per_cell; /* n below */

    int made_node_count;
    const int *made_nodes;         /* [made_node_count] */
    const sb_vec3 *made_positions; /* [made_node_count] at rest (m) */
    const int *source_start;       /* [made_node_count + 1] into sources: at least one each */
    const int *sources;            /* nodes as numbered before the change: where displacement, velocity ... come from */
    const sb_real *source_weights; /* >= 0, they sum to 1 */

    const unsigned char *made_copies; /* [made_node_count] options of the nodes: copies where material parts, see
                                       * SB_NODE_COPY */

    int removed_node_count;
    const int *removed_nodes;    /* [removed_node_count] */
    const int *heir_start;       /* [removed_node_count + 1] into heirs; none: nothing may refer to the node */
    const int *heirs;            /* nodes in use after the change that loads, mappings and constraints go over to */
    const sb_real *heir_weights; /* they sum to 1 */

    int moved_node_count;
    const int *moved_nodes;    /* [moved_node_count] in use before and after, with another rest position now */
    const sb_vec3 *moved_from; /* [moved_node_count] rest positions before (m) */
    const sb_vec3 *moved_to;   /* [moved_node_count] and after */
    const int
        *moved_start; /* [moved_node_count + 1] into moved_sources; none: the node's motion stays; NULL: no list */
    const int *moved_sources; /* as sources */
    const sb_real *moved_weights;

    int removed_cell_count;
    const int *removed_cells;      /* [removed_cell_count] */
    const int *removed_cell_nodes; /* [removed_cell_count][n] the nodes they had */

    int made_cell_count;
    const int *made_cells;      /* [made_cell_count] */
    const int *made_cell_nodes; /* [made_cell_count][n] */
    const int *made_parents;    /* [made_cell_count] cell as numbered before the change whose rotation and memory the
                                 * made one inherits, or -1: rest */
    const sb_real *made_shares; /* [made_cell_count] volume of material over volume of the element, 0 to 1; NULL: 1 */

    int reshaped_cell_count;
    const int *reshaped_cells; /* [reshaped_cell_count] that stay with their nodes, some of which moved: cells of moved
                                * nodes that are not made by this change */
    const sb_real *reshaped_shares; /* [reshaped_cell_count] as made_shares, of the new shape; NULL: 1 */

    /* Where cells are pieces of elements, which all have the whole element's shape: the cell, as numbered after the
     * change, with the material at xi of the element that `cell`, also as after it, is a piece of. NULL: nobody knows
     */
    int (*find_cell)(void *user, int cell, const sb_real xi[3]);
    void *find_user;
} sb_mesh_change;

typedef sb_mesh_change sbi_mesh_change; /* as the library's rooms call it */

#endif /* SB_MESH_CHANGE_H */
