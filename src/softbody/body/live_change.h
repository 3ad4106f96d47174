/* live_change: a change of the mesh as it is put together. Internal. */
#ifndef SB_LIVE_CHANGE_H
#define SB_LIVE_CHANGE_H

#include "live_private.h"

/* In the log: a cell that a row of a mapping went over to. A commit has room for one of each row. */
enum { SBI_CHANGE_FOUND = 12 };

/* A node made, removed or moved. */
typedef struct sbi_changed_node {
    int node;
    int first, count; /* sources (numbers before the change; a moved one may have none) or heirs among the entries */
    int flags;
    int dropped; /* 1: made and removed again */
    sb_vec3 position;
} sbi_changed_node;

typedef struct sbi_changed_cell {
    int cell, parent; /* parent: number before the change, or -1 */
    int material;     /* index of its region */
    int first;        /* its corners */
    int dropped, has_fibre;
    sb_real share;
    sb_vec3 fibre;
    sbi_piece piece; /* zeros of a cell that is none */
} sbi_changed_cell;

typedef struct sbi_change_entry {
    int node;
    sb_real weight;
} sbi_change_entry;

struct sb_body_change {
    sb_body *body;
    sbi_slots nodes, cells; /* as they are at this point */
    struct {
        sbi_changed_node *items;
        int count, capacity;
    } made_nodes, removed_nodes, moved_nodes;
    struct {
        sbi_changed_cell *items;
        int count, capacity;
    } made_cells;
    struct {
        int *items;
        int count, capacity;
    } removed_cells, corners, log_ints, found; /* found: of a replay, see SBI_CHANGE_FOUND */
    struct {
        sbi_change_entry *items;
        int count, capacity;
    } entries;
    struct {
        sb_real *items;
        int count, capacity;
    } log_reals;
    int *node_at, *cell_at;   /* [capacity of the slots] 1 + the last record that made the slot, or 0 */
    const sbi_glue_tie *glue; /* see sbi_change_set_glue; NULL: none was given */
    int glue_count;
    int reshaped_most; /* upper bound of the cells reshaped */
    int version;       /* of the body's mesh at the beginning */
    int found_next;
};

/* The arrays behind an sb_mesh_change. */
typedef struct sbi_change_lists {
    void *memory;
    int *made_nodes, *source_start, *sources, *removed_nodes, *heir_start, *heirs, *moved_nodes;
    int *moved_start, *moved_sources;
    int *removed_cells, *removed_cell_nodes, *made_cells, *made_cell_nodes, *made_parents, *reshaped_cells;
    unsigned char *made_copies;
    sb_real *source_weights, *heir_weights, *moved_weights, *made_shares, *reshaped_shares;
    sb_vec3 *made_positions, *moved_from, *moved_to;
    sbi_live_motion *motions; /* [made and moved nodes] */
    sb_vec3 *forces;          /* [removed nodes] dead loads that go to their heirs */
    int *nodes, *gone,
        *come; /* [node_room] nodes that the change is about, each once; cells of each that go, and come */
    size_t node_room;
} sbi_change_lists;

/* Makes the change on the body in place, where it can: tet4, room in all arrays, no constraints, no loads on what
 * changes, a preconditioner that follows. 0: it cannot, or something about the change is wrong, and nothing has
 * happened; 1: *result says how it went. */
SBI_API int sbi_live_follow(sb_body_change *change, const sbi_change_lists *lists, const sb_mesh_change *out,
                            sb_result *result, sb_error *error);
SB_INLINE int sbi_change_makes_pieces(const sb_body_change *change)
{
    int makes = 0;
    for (int i = 0; i < change->made_cells.count; i++)
        makes |= change->made_cells.items[i].piece.is != 0 && !change->made_cells.items[i].dropped;
    return makes;
}
/* Asks all listeners; on failure those asked before give up. */
SBI_API sb_result sbi_live_ask_listeners(const sb_body *body, const sb_mesh_change *change, sb_error *error);
/* Whether all that refers to nodes by themselves can go on: heirs and supports. */
SBI_API sb_result sbi_live_check_removed(const sb_body *body, const sbi_slots *nodes, const sb_mesh_change *change,
                                         sb_error *error);

#endif /* SB_LIVE_CHANGE_H */
