/* topology: what a remesher knows of a body's tet4 mesh: rings, neighbours, qualities, and how it changes. Floor 6,
 * internal.
 *
 * Slots of nodes and tets are the body's. A change is made here first, while candidates are compared and undone; the
 * remesher then hands it to the body as one change of its mesh. */
#ifndef NDL_TOPOLOGY_H
#define NDL_TOPOLOGY_H

#include "../softbody/body/live_mesh.h"
#include "api.h"

/* Where a segment enters a body. */
typedef struct ndl_surface_hit {
    int tet, face; /* face opposite node `face` of the tet (a cell of the body) */
    sb_real along; /* 0 at `from`, 1 at `to` */
    sb_vec3 X;     /* material position of the point (m) */
} ndl_surface_hit;

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
struct ndli_image;

/* What a node is; flags of ndli_topology.node_flags. */
enum {
    NDLI_NODE_ALIVE = 1,     /* the slot holds a node */
    NDLI_NODE_BOUNDARY = 2,  /* on the body's surface */
    NDLI_NODE_INTERFACE = 4, /* between regions */
    NDLI_NODE_FIXED = 8,     /* supported: stays where it is in the material */
    NDLI_NODE_CREATED = 16,  /* made by a split: has no place of its own in the undivided mesh */
    NDLI_NODE_NEEDLE = 32    /* on a needle now */
};

/* A node that a change made or moved: the old fields at four old nodes, times the weights, give its new ones. */
typedef struct ndli_node_change {
    int node;
    int created; /* 1: a new node (its slot may have held another); 0: moved */
    int sources[4];
    sb_real weights[4];
    sb_vec3 X; /* its material position (m) */
} ndli_node_change;

/* A slot of a node that came into use, or (~node) went out of it, and what was known of the node before. */
typedef struct ndli_node_event {
    int node, owner;
    unsigned char flags;
    sb_vec3 X0;
} ndli_node_event;

/* What one change did, in the order in which it was done: slots are given and taken in that order. Valid until the next
 * change. */
typedef struct ndli_topology_change {
    const ndli_node_event *node_events;
    const int *tet_events; /* a slot that came into use, or ~slot of one that went */
    int node_event_count, tet_event_count;
    const int *changed; /* tets that stay in their slots with other nodes or, where a node moved, another shape */
    int changed_count;
    const ndli_node_change *nodes; /* in the order of the nodes that came, moved ones between them */
    int node_count;
} ndli_topology_change;

/* Arrays are for reading, but for the flag of fixed nodes. All lie in one block with slack; it grows by half when a
 * change needs more, which moves them. Slots of removed nodes and tets are used again, last removed first.
 *
 * The tets of a node are a ring of corners: corner 4 t + c is node c of tet t.
 *
 *     for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k])
 *         visit(k / 4);
 */
typedef struct ndli_topology {
    int node_count, tet_count; /* in use */
    int node_end, tet_end;     /* one past the last slot ever used: loops run to here, and skip some */
    int node_capacity, tet_capacity;
    int original_nodes, original_tets; /* of the mesh it was made from: slots below these */

    /* nodes [node_end] */
    sb_vec3 *X;                /* material position (m) */
    sb_vec3 *X0;               /* material position in the undivided mesh; created nodes: where they were made */
    const sb_vec3 *x;          /* position (m): the body's, borrowed anew after each change and before each step */
    int *owner;                /* needle that the node is on or was made by, or -1 */
    int *node_star;            /* first corner, or -1 */
    unsigned char *node_flags; /* NDLI_NODE_...; 0: not in use */

    /* tets [tet_end] */
    int *tets;        /* [4] nodes, positively oriented in the material; tets[4 t] < 0: not in use */
    int *neighbours;  /* [4] tet across the face opposite node c, or -1 */
    int *corner_next; /* [4] */
    int *corner_prev; /* [4] */
    int *regions;
    int *parents;       /* tet that it was cut from last, for a tet made by a change; else itself */
    sb_real *volumes;   /* in the material (m^3) */
    sb_real *qualities; /* 6 sqrt(2) V / l_rms^3: 1 for the regular tet, <= 0 flat or inverted */

    sb_allocator allocator;

    /* free slots, displaced nodes and the change under way */
    int free_node, free_tet;
    int *displaced, *displaced_at, displaced_count;
    int *node_index; /* a remesher's scratch, zeros between its calls */
    unsigned char *tet_mark, *node_mark;
    int *touched, touched_count, *affected, affected_count;
    int *displaced_before, displaced_before_count; /* at the begin of the change */
    ndli_node_event *node_events;                  /* [2 node_capacity] */
    int node_event_count;
    int *tet_events, tet_event_count; /* [2 tet_capacity] */
    int *changed;                     /* [tet_capacity] */
    ndli_node_change *changes;
    int change_count;
    void *block;
} ndli_topology;

/* Becomes the body's mesh, with nothing known of needles: all nodes are at their own places. Its allocator must be set.
 * 0: no memory, nothing changed. O(nodes + tets). */
NDLI_API int ndli_topology_read(ndli_topology *mesh, const sb_body *body);
/* The same where the body's mesh is one that it has known: keeps X0, owners and flags; there is room. */
NDLI_API void ndli_topology_read_again(ndli_topology *mesh, const sb_body *body);
/* To be called once the body has moved: borrows its positions, and sees which nodes are supported. */
NDLI_API void ndli_topology_look(ndli_topology *mesh, const sb_body *body);
/* Safe on {0} and on NULL. */
NDLI_API void ndli_topology_free(ndli_topology *mesh);

/* Tet that holds a point: a walk from `start` (any tet in use) through the faces the point lies behind, in the material
 * (positions = mesh->X) or in space (the body's). Returns the tet and its barycentric weights, all >= 0 but for
 * rounding; or -1 when the walk ends at the surface: then *weights are of the last tet, stretched beyond it. weights:
 * [4], may be NULL. -1 also for a start that is no tet, without weights. */
NDLI_API int ndli_topology_find(const ndli_topology *mesh, const sb_vec3 *positions, sb_vec3 point, int start,
                                sb_real weights[4]);
/* Tet that holds a point in space, or -1. A walk may end at tets that are inverted: skin that is pushed in before it
 * breaks folds the tissue below it. Then all are looked at, and of those that hold the point the one counts that has
 * kept its shape best. O(tets) there, and for points outside. */
NDLI_API int ndli_topology_find_in_space(const ndli_topology *mesh, sb_vec3 x, int start);
/* Deformation gradient in a tet. */
NDLI_API sb_mat3 ndli_topology_gradient(const ndli_topology *mesh, int tet);
/* First surface face that the segment crosses from outside in space; 0 and *hit untouched when
 * there is none. O(tets): for a needle that is not in yet. */
NDLI_API int ndli_topology_hit(const ndli_topology *mesh, sb_vec3 from, sb_vec3 to, ndl_surface_hit *hit);

/* How good the material mesh is; any place may be NULL. Angles in degrees. O(tets). */
NDLI_API void ndli_topology_quality(const ndli_topology *mesh, sb_real *worst_quality, sb_real *min_dihedral,
                                    sb_real *max_dihedral);
/* Whether every index, ring, neighbour and mark is consistent. SB_ERROR_MESH names the first fault. */
NDLI_API sb_result ndli_topology_check(const ndli_topology *mesh, sb_error *error);
/* 1 when all nodes, tets and positions are those of the mesh it was made from, number by number. */
NDLI_API int ndli_topology_is_original(const ndli_topology *mesh);

/* Quality of a tet by its corners. Inline: thousands of them decide one operation. */
SB_INLINE sb_real ndli_tet_quality(sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d)
{
    sb_vec3 ab = sb_v3_sub(b, a), ac = sb_v3_sub(c, a), ad = sb_v3_sub(d, a);
    sb_vec3 bc = sb_v3_sub(c, b), bd = sb_v3_sub(d, b), cd = sb_v3_sub(d, c);
    sb_real det = sb_v3_dot(ab, sb_v3_cross(ac, ad));
    sb_real mean = (sb_v3_dot(ab, ab) + sb_v3_dot(ac, ac) + sb_v3_dot(ad, ad) + sb_v3_dot(bc, bc) + sb_v3_dot(bd, bd) +
                    sb_v3_dot(cd, cd)) /
                   6;
    return mean > 0 ? (sb_real)1.4142135623730951 * det / (mean * sb_sqrt(mean)) : 0;
}
NDLI_API void ndli_tet_weights(sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d, sb_vec3 p, sb_real weights[4]);
/* Tet of a point that lies in the material, by a walk from `start`, and its weights, all >= 0. Just outside by
 * rounding: the best tet about the start, its weights cut off. */
NDLI_API int ndli_topology_source(const ndli_topology *mesh, sb_vec3 X, int start, sb_real weights[4]);
/* 0 when memory for so many more nodes and tets is short: then nothing has changed. */
NDLI_API int ndli_topology_reserve(ndli_topology *mesh, int nodes, int tets);

/* A change: begin; plan every node to be made or moved, while the old mesh still stands; cut, mend, move; end. What it
 * needs must have been reserved: none of this can fail. */
NDLI_API void ndli_topology_begin(ndli_topology *mesh);
/* node -1: to be made. Returns the number of the plan. */
NDLI_API int ndli_topology_plan(ndli_topology *mesh, int node, sb_vec3 X, int start);
/* Replaces every tet that holds the simplex by `size` ones with the planned node in place of one corner each. groups
 * receives the tets' slots, `size` per tet cut. Returns the number of tets cut. */
NDLI_API int ndli_topology_cut(ndli_topology *mesh, const int *simplex, int size, int plan, int *groups);
/* The way back: takes the node out. */
NDLI_API void ndli_topology_mend(ndli_topology *mesh, int node, const int *simplex, int size, const int *groups,
                                 int count);
NDLI_API void ndli_topology_move(ndli_topology *mesh, int plan);
NDLI_API void ndli_topology_end(ndli_topology *mesh, ndli_topology_change *change);
/* After the end: the body has refused the change, and all is as it was at the begin. O(nodes + tets). */
NDLI_API void ndli_topology_take_back(ndli_topology *mesh, const sb_body *body);

/* What the body's mesh does not say, for undo and saved states: measures, writes or reads. counts: NDLI_TOPOLOGY_COUNTS
 * ints that ndli_topology_counts gives; when reading, the image's. */
enum { NDLI_TOPOLOGY_COUNTS = 4 };
NDLI_API void ndli_topology_counts(const ndli_topology *mesh, int *counts);
NDLI_API void ndli_topology_walk(ndli_topology *mesh, const int *counts, struct ndli_image *image);
/* After reading, and once the body has the mesh that goes with it. */
NDLI_API void ndli_topology_recall(ndli_topology *mesh, const int *counts, const sb_body *body);
/* Whether what ndli_topology_walk wrote to `in` for these counts (counts[0] <= node_end, counts[1] <= counts[0]) goes
 * with this mesh; owners below max_owner. SB_ERROR_FORMAT, SB_ERROR_NOT_FINITE. */
NDLI_API sb_result ndli_topology_check_memory(const ndli_topology *mesh, const int *counts, const unsigned char *in,
                                              int max_owner, sb_error *error);
/* The tet with the lowest slot that has both nodes, or -1. */
NDLI_API int ndli_topology_first_tet(const ndli_topology *mesh, int i, int j);
#endif

#endif /* NDL_TOPOLOGY_H */
