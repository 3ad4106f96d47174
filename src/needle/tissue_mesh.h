/* tissue_mesh: the tissue around a needle, a tet4 mesh whose nodes move and whose topology changes. Floor 6. */
#ifndef NDL_TISSUE_MESH_H
#define NDL_TISSUE_MESH_H

#include "../softbody/mesh/mesh.h"
#include "api.h"

/* What a node is; flags of ndl_tissue_mesh.node_flags. */
typedef enum ndl_node_flag {
    NDL_NODE_ALIVE = 1,     /* the slot holds a node */
    NDL_NODE_BOUNDARY = 2,  /* on the tissue's surface */
    NDL_NODE_INTERFACE = 4, /* between regions */
    NDL_NODE_FIXED = 8,     /* set by the caller: stays where it is in the material */
    NDL_NODE_CREATED = 16,  /* made by a split: has no place of its own in the undivided mesh */
    NDL_NODE_NEEDLE = 32    /* on a needle now */
} ndl_node_flag;

/* A node that a change of the mesh made or moved: the old fields at four old nodes, times the weights, give its new
 * ones. A source may be gone by now, or its slot in use again: read all sources before writing any node. */
typedef struct ndl_node_change {
    int node;
    int created; /* 1: a new node (its slot may have held another); 0: moved */
    int sources[4];
    sb_real weights[4];
    sb_vec3 X; /* its material position (m) */
} ndl_node_change;

/* What one change did, for whoever keeps data by node or tet (a matrix, internal variables). A slot that was in use
 * before and is now is `changed`, whether its nodes differ or only its shape. Valid during the call only. */
typedef struct ndl_mesh_change {
    const int *removed, *created, *changed; /* tet slots */
    int removed_count, created_count, changed_count;
    const int *removed_nodes; /* slots not in use any more */
    int removed_node_count;
    const ndl_node_change *nodes;
    int node_count;
} ndl_mesh_change;

/* Must not call back into the mesh. Runs after the change, with everything in place. A change of nothing at all says
 * that masses have changed. */
typedef void (*ndl_mesh_listener)(void *user, const ndl_mesh_change *change);

/* The mesh. Arrays are for reading: x, v, a, fixed flags and the listener are the caller's to set, all else changes
 * through the remesher. All arrays lie in one block with slack; it grows by half when a change needs more, which
 * moves the arrays. Slots of removed nodes and tets are used again, last removed first.
 *
 * The tets of a node are a ring of corners: corner 4 t + c is node c of tet t.
 *
 *     for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k])
 *         visit(k / 4);
 */
typedef struct ndl_tissue_mesh {
    int node_count, tet_count;       /* in use */
    int node_end, tet_end;           /* one past the last slot ever used: loops run to here, and skip some */
    int node_capacity, tet_capacity;
    int original_nodes, original_tets; /* of the mesh it was made from: slots below these */

    /* nodes [node_end] */
    sb_vec3 *X;                /* material position (m) */
    sb_vec3 *X0;               /* material position in the undivided mesh; created nodes: where they were made */
    sb_vec3 *x, *v, *a;        /* position (m), velocity (m/s), acceleration (m/s^2) */
    sb_real *mass;             /* lumped: a quarter of the mass of each of its tets (kg) */
    int *owner;                /* needle that the node is on or was made by, or -1 */
    int *node_star;            /* first corner, or -1 */
    unsigned char *node_flags; /* of ndl_node_flag; 0: not in use */

    /* tets [tet_end] */
    int *tets;        /* [4] nodes, positively oriented in the material; tets[4 t] < 0: not in use */
    int *neighbours;  /* [4] tet across the face opposite node c, or -1 */
    int *corner_next; /* [4] */
    int *corner_prev; /* [4] */
    int *regions;
    sb_real *tet_density; /* kg/m^3: that of the region, but where a face between regions was moved: there, so that
                           * the mass stays */
    sb_real *volumes; /* in the material (m^3) */
    sb_real *qualities; /* 6 sqrt(2) V / l_rms^3: 1 for the regular tet, <= 0 flat or inverted */

    sb_real *densities; /* [density_count] kg/m^3 */
    int density_count;

    ndl_mesh_listener listener; /* or NULL */
    void *listener_user;
    sb_allocator allocator;

    /* internal: free slots, displaced nodes and the change under way */
    int free_node, free_tet;
    int *displaced, *displaced_at, displaced_count;
    int *node_index; /* a remesher's scratch, zeros between its calls */
    unsigned char *tet_mark, *node_mark;
    int *touched, touched_count, *affected, affected_count;
    int *report; /* [2 tet_capacity + node_capacity] lists of the change */
    ndl_node_change *changes;
    sb_vec3 *change_state; /* [3] x, v, a of each */
    int change_count;
    sb_vec3 momentum, net_force; /* sums of m v and m a over the nodes of the change, before it */
    sb_real change_mass; /* of the tets before the change */
    void *block;
} ndl_tissue_mesh;

/* Makes the tissue from a tet4 mesh: numbering and orientation are kept, x = X, v = a = 0.
 * mesh: copied; sb_mesh_validate must accept it, and every node must belong to a tet; regions as they are
 * densities: [density_count] kg/m^3 > 0 by region, or one for all
 * slack: share of nodes and tets to have in reserve, >= 0
 * *tissue is overwritten. SB_ERROR_ARGUMENT (also for regions without a density), _NOT_FINITE, _INDEX, _MESH, _MEMORY
 * leave it untouched. Release with ndl_tissue_mesh_free. O(nodes + tets). */
NDL_API sb_result ndl_tissue_mesh_create(const sb_mesh *mesh, const sb_real *densities, int density_count,
                                         sb_real slack, const sb_allocator *allocator,
                                         ndl_tissue_mesh *tissue, sb_error *error);
/* Safe on {0} and on NULL. */
NDL_API void ndl_tissue_mesh_free(ndl_tissue_mesh *tissue);

/* Tet that holds a point: a walk from `start` (any tet in use) through the faces the point lies behind, in the
 * material (positions = tissue->X) or in space (tissue->x). Returns the tet and its barycentric weights, all >= 0 but
 * for rounding; or -1 when the walk ends at the tissue's surface: then *weights are of the last tet, stretched beyond
 * it. weights: [4], may be NULL. -1 also for a start that is no tet, without weights. */
NDL_API int ndl_tissue_mesh_find(const ndl_tissue_mesh *tissue, const sb_vec3 *positions, sb_vec3 point, int start,
                                 sb_real weights[4]);

/* Where a segment enters the tissue. */
typedef struct ndl_surface_hit {
    int tet, face;  /* face opposite node `face` of the tet */
    sb_real along;  /* 0 at `from`, 1 at `to` */
    sb_vec3 X;      /* material position of the point (m) */
} ndl_surface_hit;
/* First surface face that the segment crosses from outside in space; 0 and *hit untouched when there is none.
 * O(tets): for a needle that is not in the tissue yet. */
NDL_API int ndl_tissue_mesh_hit(const ndl_tissue_mesh *tissue, sb_vec3 from, sb_vec3 to, ndl_surface_hit *hit);

/* How good the material mesh is; any place may be NULL. Angles in degrees. O(tets). */
NDL_API void ndl_tissue_mesh_quality(const ndl_tissue_mesh *tissue, sb_real *worst_quality, sb_real *min_dihedral,
                                     sb_real *max_dihedral);
/* Sums over all tets and nodes (m^3, kg). O(tets). */
NDL_API sb_real ndl_tissue_mesh_volume(const ndl_tissue_mesh *tissue);
NDL_API sb_real ndl_tissue_mesh_mass(const ndl_tissue_mesh *tissue);
/* Whether every index, ring, neighbour and mark is consistent: for tests. SB_ERROR_MESH names the first fault. */
NDL_API sb_result ndl_tissue_mesh_check(const ndl_tissue_mesh *tissue, sb_error *error);
/* 1 when all nodes, tets and positions are those of the mesh it was made from, number by number. */
NDL_API int ndl_tissue_mesh_is_original(const ndl_tissue_mesh *tissue);

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Quality of a tet by its corners. Inline: thousands of them decide one operation. */
SB_INLINE sb_real ndli_tissue_quality(sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d)
{
    sb_vec3 ab = sb_v3_sub(b, a), ac = sb_v3_sub(c, a), ad = sb_v3_sub(d, a);
    sb_vec3 bc = sb_v3_sub(c, b), bd = sb_v3_sub(d, b), cd = sb_v3_sub(d, c);
    sb_real det = sb_v3_dot(ab, sb_v3_cross(ac, ad));
    sb_real mean = (sb_v3_dot(ab, ab) + sb_v3_dot(ac, ac) + sb_v3_dot(ad, ad) + sb_v3_dot(bc, bc) +
                    sb_v3_dot(bd, bd) + sb_v3_dot(cd, cd)) / 6;
    return mean > 0 ? (sb_real)1.4142135623730951 * det / (mean * sb_sqrt(mean)) : 0;
}
NDLI_API void ndli_tissue_weights(sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d, sb_vec3 p, sb_real weights[4]);
/* Tet of a point that lies in the material, by a walk from `start`, and its weights, all >= 0. Just outside by rounding:
 * the best tet about the start, its weights cut off. */
NDLI_API int ndli_tissue_source(const ndl_tissue_mesh *tissue, sb_vec3 X, int start, sb_real weights[4]);
/* 0 when memory for so many more nodes and tets is short: then nothing has changed. */
NDLI_API int ndli_tissue_reserve(ndl_tissue_mesh *tissue, int nodes, int tets);

/* A change: begin; plan every node to be made or moved, while the old mesh still stands; cut, mend, move; end. What it
 * needs must have been reserved: none of this can fail. */
NDLI_API void ndli_tissue_begin(ndl_tissue_mesh *tissue);
/* node -1: to be made. Returns the number of the plan. */
NDLI_API int ndli_tissue_plan(ndl_tissue_mesh *tissue, int node, sb_vec3 X, int start);
/* Replaces every tet that holds the simplex by `size` ones with the planned node in place of one corner each. groups
 * receives the tets' slots, `size` per tet cut. Returns the number of tets cut. */
NDLI_API int ndli_tissue_cut(ndl_tissue_mesh *tissue, const int *simplex, int size, int plan, int *groups);
/* The way back: takes the node out. */
NDLI_API void ndli_tissue_mend(ndl_tissue_mesh *tissue, int node, const int *simplex, int size, const int *groups,
                               int count);
NDLI_API void ndli_tissue_move(ndl_tissue_mesh *tissue, int plan);
NDLI_API void ndli_tissue_end(ndl_tissue_mesh *tissue);
/* All densities those of the regions again, once all is in its place. */
NDLI_API void ndli_tissue_reset_densities(ndl_tissue_mesh *tissue);
#endif

#endif /* NDL_TISSUE_MESH_H */
