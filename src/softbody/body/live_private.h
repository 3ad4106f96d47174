/* live_private: slots of a mesh that changes, a change under way, and the body with its next mesh. Internal. */
#ifndef SB_LIVE_PRIVATE_H
#define SB_LIVE_PRIVATE_H

#include "../fem/assembly_live.h"
#include "body_private.h"
#include "live_mesh.h"

/* Slots of nodes or of cells. The next ones to be used are stack[count - 1] .. stack[0], then fresh, fresh + 1 ...; a
 * slot that was given back and is the one before fresh at the bottom of the stack counts as fresh again, so that a
 * change and its inverse leave no trace. */
typedef struct sbi_slots {
    int end; /* slots in use or free lie below */
    int fresh;
    int count;           /* of the stack */
    int *stack;          /* [capacity] */
    unsigned char *used; /* [capacity] */
    int capacity;
} sbi_slots;

SBI_API int sbi_slots_create(sbi_slots *slots, int capacity, int used,
                             const sb_allocator *allocator); /* 0: no memory */
SBI_API int sbi_slots_copy(sbi_slots *to, const sbi_slots *from, int capacity, const sb_allocator *allocator);
/* The same slots, in arrays with room for them. */
SBI_API void sbi_slots_assign(sbi_slots *to, const sbi_slots *from);
SBI_API void sbi_slots_free(sbi_slots *slots, const sb_allocator *allocator);
/* The next slot, which is used then; -1: full. */
SBI_API int sbi_slots_take(sbi_slots *slots);
SBI_API void sbi_slots_give(sbi_slots *slots, int slot);
SBI_API int sbi_slots_is_used(const sbi_slots *slots, int slot);

typedef int sbi_cell_find(void *user, int cell, const sb_real xi[3]);

/* The mesh before any cut, as what knows the pieces has it. */
typedef struct sbi_uncut {
    int cell_count, node_end;
    const int *nodes; /* [cell_count][nodes of a cell] */
    const int *cells; /* [cell_count] numbers that they had */
} sbi_uncut;

typedef struct sbi_listener {
    int id;
    int leads; /* 1: comes before those that do not, whenever it was registered: these may read it */
    sb_body_listener calls;
} sbi_listener;

/* A force on a node in the next step, see live_push.c. */
typedef struct sbi_push {
    int node;
    sb_vec3 force;     /* N */
    sb_real stiffness; /* N/m, >= 0: the force over the way of what pushes */
    sb_real held;      /* that part of it which the step under way needs */
} sbi_push;

typedef struct sbi_live {
    sbi_slots nodes, cells;
    sb_real *shares;        /* [cells.capacity] volume of material over that of the cell; 0: free, or an empty piece */
    sbi_piece *pieces;      /* [cells.capacity] zeros of cells that are none; NULL: there has been none */
    int piece_count;        /* cells that are pieces */
    sbi_inner_rows slivers; /* what holds mid nodes of small pieces, see live_sliver.c; lent to the assembly */
    sbi_glue glue;          /* what ties pieces to each other, see live_glue.c; lent to the assembly */
    sbi_glue next_glue;     /* of the change under way */
    int (*couplings)[2];    /* [32 glue.capacity] scratch of a body that follows */
    sbi_push *pushes;       /* [push_capacity] */
    int push_count, push_capacity;
    sb_quadrature_kind rule; /* of the domain's points */
    sbi_cell_find *find;     /* see sb_body_find_cell; NULL: nobody knows, or not this mesh */
    sbi_cell_find *holder;   /* as find, but -1 where the material was taken out; there as it is */
    void *find_user;         /* also while it does not know this mesh */
    const sbi_uncut *uncut;  /* of find_user; NULL: none */
    int find_knows;          /* 1: it knows the mesh that the change under way leads to, too */
    int follows;             /* 1: domain, matrix and assembly follow changes: tet4 */
    double slack;            /* of the def */
    sb_real (*masses)[2]; /* [4 cells.capacity] of a body that follows: lumped mass and int rho N dV of each corner (kg)
                           */
    int *node_marks;      /* [nodes.capacity] zeros between calls */
    unsigned char *cell_marks; /* [cells.capacity] zeros between calls */
    sb_body_change *spare;     /* a change with its lists, for the next one; NULL while it is open */
    void *lists;               /* behind the lists of a change while it is made */
    size_t list_bytes;
    int version;
    int rebuilds;         /* times that a change made a body anew, or tried to: for tests */
    sb_body_change *open; /* the change under way, or NULL */
    int erodes;           /* 1: it is as sbi_change_erode says */
    sbi_listener *listeners;
    int listener_count, listener_capacity, last_listener;
} sbi_live;

/* A mesh in slots, as a body is to have it. */
typedef struct sbi_live_mesh {
    sbi_slots nodes, cells;
    sb_vec3 *positions;  /* [nodes.end] */
    int *corners;        /* [cells.end][n]; 0 in free slots */
    int *material;       /* [cells.end] index of the region */
    sb_real *shares;     /* [cells.end] 0: free, or an empty piece */
    int has_pieces;      /* 1: there is room for pieces */
    sbi_piece *pieces;   /* [cells.end] or NULL */
    int *inherit;        /* [cells.end] cell of the body that it inherits from, or -1: none */
    unsigned char *kept; /* [cells.end] 1: it is that cell */
    sb_vec3 *fibres;     /* [cells.end] unit directions or 0; NULL: the body has none */
    int *patches;        /* [cells.end] as domain.cell_patch, -1 in free slots; NULL: the body has none */
    int glue_count;
    sbi_glue_tie *glue; /* [glue_count] cells and Gram matrices are read */
    void *memory;
} sbi_live_mesh;

/* Patches of a changed mesh, where there are any: cells that were made are in those of their parents by now. */
SBI_API sb_result sbi_live_settle_patches(const sb_body *body, sbi_live_mesh *mesh, sb_error *error);

/* The error of a node that a change leaves without a cell; made: by this change. */
SBI_API sb_result sbi_live_refuse_lonely(int node, int made, sb_error *error);
/* Makes and frees what a body with slack has besides. */
SBI_API sb_result sbi_live_create(sb_body *body, const sb_body_def *def, sb_error *error);
SBI_API void sbi_live_free(sb_body *body);
/* sb_body_listen for one that leads or does not. */
SBI_API sb_result sbi_live_listen(sb_body *body, const sb_body_listener *listener, int leads, int *id, sb_error *error);
/* Tells all who listen that the body ends, and ends the change under way. */
SBI_API void sbi_live_end(sb_body *body);
SBI_API void sbi_change_destroy(sb_body_change *change); /* NULL is fine */
/* A change with lists for so many cells, for the first to begin. */
SBI_API sb_result sbi_change_take_spare(sb_body *body, int cells, sb_error *error);
/* Lists for the changes to come of a body that is made. */
SBI_API sb_result sbi_live_prepare(sb_body *body, sb_error *error);

/* Room for a mesh with copies of these slots, and for pieces where has_pieces is 1. */
SBI_API sb_result sbi_live_mesh_allocate(const sb_body *body, const sbi_slots *nodes, const sbi_slots *cells,
                                         int has_pieces, sbi_live_mesh *mesh, sb_error *error);
/* Room for a mesh with so many slots (end, fresh, count) and ties, not filled; no less than the body has room for. */
SBI_API sb_result sbi_live_mesh_room(const sb_body *body, const sbi_slots *nodes, const sbi_slots *cells,
                                     int has_pieces, int glue_count, sbi_live_mesh *mesh, sb_error *error);
SBI_API void sbi_live_mesh_free(const sb_body *body, sbi_live_mesh *mesh);
/* Lists what the body's mesh has in these slots. */
SBI_API void sbi_live_mesh_fill(const sb_body *body, sbi_live_mesh *mesh);

/* *next = a body like this one with another mesh, at rest, without supports, loads and constraints. SB_ERROR_MESH: a
 * cell inside out; SB_ERROR_MEMORY. */
SBI_API sb_result sbi_live_build(const sb_body *body, const sbi_live_mesh *mesh, sb_body **next, sb_error *error);
/* Brings motion, supports, loads and constraints over to it. On failure it is good for sbi_body_release only. */
SBI_API sb_result sbi_live_carry(const sb_body *body, const sbi_mesh_change *change, const sbi_live_mesh *mesh,
                                 sb_body *next, sb_error *error);
/* The same of loads and constraints. */
SBI_API sb_result sbi_live_carry_rows(const sb_body *body, const sbi_mesh_change *change, sb_body *next,
                                      sb_error *error);
/* The body becomes `next`, which is gone then; it keeps its observer, its listeners and, where they have room, its
 * arrays by node. */
SBI_API void sbi_live_replace(sb_body *body, sb_body *next);
/* Matrix, and the body's cells of each node, as ones that follow; others stay as they are. */
SBI_API sb_result sbi_live_make_matrix(const sb_body *body, sb_matrix *matrix, sb_error *error);
SBI_API sb_result sbi_live_make_assembly(sb_body *body, sb_error *error);
/* Parts of the nodes in the order of their first nodes, from a matrix that follows and couples by cells only. */
SBI_API void sbi_live_label_nodes(sb_body *body);
/* The rest of those who follow. */
SBI_API sb_result sbi_live_take_marks(sb_body *body, sb_error *error);

/* ---- live_momentum.c ---- */

/* Mass (kg), and sums of m v and (x - about) x m v of some cells; size: sums of the magnitudes. */
typedef struct sbi_live_moment {
    double mass, linear[3], angular[3], linear_size, angular_size;
} sbi_live_moment;
enum { SBI_LIVE_MOTIONS = 2 }; /* velocity and acceleration */
/* What the cells that a change takes or reshapes have, before it: all of them, and those reshaped or with children. */
typedef struct sbi_live_balance {
    sb_vec3 about;
    int motions;  /* 1: velocity only */
    int is_eaten; /* 1: momentum goes with what is removed, see sbi_change_erode */
    sbi_live_moment all[SBI_LIVE_MOTIONS], parents[SBI_LIVE_MOTIONS];
} sbi_live_balance;
/* Adds what the lumped mass of a cell has of so many motions; also: other sums that get the same, or NULL. */
SBI_API void sbi_live_add_cell(const sb_body *body, int e, sb_vec3 about, int motions, sbi_live_moment *sums,
                               sbi_live_moment *also);
/* The cell made or reshaped that momentum is summed about (the place of its first node after the change), or -1: there
 * is none, and nothing to keep. */
SBI_API int sbi_live_first_changed(const sbi_mesh_change *change);
SBI_API sbi_live_balance sbi_live_weigh(const sb_body *body, const sbi_mesh_change *change, sb_vec3 about);
/* Gives the nodes of the cells that changed what is missing of it. */
SBI_API void sbi_live_keep_momentum(sb_body *next, const sbi_mesh_change *change, const sbi_live_balance *before);
/* Both, for a body with the next mesh. */
SBI_API void sbi_live_carry_momentum(const sb_body *body, const sbi_mesh_change *change, sb_body *next);

/* What has a value for each node that goes on from step to step. */
enum { SBI_LIVE_CARRIED = 8 };
SBI_API void sbi_live_list_carried(const sb_body *body, sb_vec3 *vectors[SBI_LIVE_CARRIED]);
/* Motion of a node made (or moved with sources), from the body before the change. */
typedef struct sbi_live_motion {
    int node; /* -1: it keeps what it has */
    unsigned char fixed;
    sb_vec3 displacement, velocity, acceleration, target;
} sbi_live_motion;
SBI_API sbi_live_motion sbi_live_made_motion(const sb_body *body, const sbi_mesh_change *change, int index);
SBI_API sbi_live_motion sbi_live_moved_motion(const sb_body *body, const sbi_mesh_change *change, int index);

/* Makes a recorded change again. */
SBI_API sb_result sbi_change_replay(sb_body *body, const sbi_command *command, sb_error *error);

/* Whether cells of the body can be pieces; SB_ERROR_UNSUPPORTED says why not. */
SBI_API sb_result sbi_live_check_pieces(const sb_body *body, sb_error *error);
/* Room for pieces; 0: no memory. Dropped again where there are none. */
SBI_API int sbi_live_take_pieces(sb_body *body);
SBI_API void sbi_live_drop_pieces(sb_body *body);
/* Makes the rows that hold mid nodes of small pieces of tet10, of a body that has its cells and matrix; their stiffness
 * follows with the materials. */
SBI_API sb_result sbi_live_make_slivers(sb_body *body, sb_error *error);
SBI_API void sbi_live_stiffen_slivers(sb_body *body);
/* ---- live_glue.c: ties between pieces ---- */

/* Room for just so many ties, now and in the next change. SB_ERROR_MEMORY. */
SBI_API sb_result sbi_live_take_glue_room(sb_body *body, int count, sb_error *error);
/* The same with more to come. */
SBI_API sb_result sbi_live_reserve_glue(sb_body *body, int count, sb_error *error);
/* Takes cells and Gram matrices of ties that there is room for; their nodes are those that the cells have in `corners`,
 * [cells][nodes of a cell]. */
SBI_API void sbi_live_copy_glue(sbi_glue *glue, const sbi_glue_tie *ties, int count, const int *corners);
/* next_glue = what a change leads to: the ties that it was given, or else those of cells that stay. Needs room. */
SBI_API sb_result sbi_live_make_next_glue(const sb_body_change *change, sb_error *error);
/* Parts that glue ties are one, in the order of their first cells. joined: [component_count] scratch. */
SBI_API void sbi_live_join_glued(sb_body *body, int *joined);
/* Nodes that all ties of a list couple besides the cells, appended to pairs; returns how many there are then. Of a body
 * that follows changes. */
SBI_API int sbi_live_list_couplings(const sbi_glue *glue, int (*pairs)[2], int count);
/* The couplings that go and come with next_glue. */
SBI_API sbi_matrix_couplings sbi_live_glue_couplings(sb_body *body, const sbi_mesh_change *out);
/* glue = next_glue */
SBI_API void sbi_live_take_glue(sb_body *body);
/* The stiffness of each tie, of the material and by which nodes have any. */
SBI_API void sbi_live_stiffen_glue(sb_body *body);
SBI_API sb_result sbi_live_check_glue(const sb_body *body, sb_error *error);
/* The change leads to these ties, of which it reads cells and Gram matrices; the list is borrowed until it is committed
 * or cancelled. */
SBI_API void sbi_change_set_glue(sb_body_change *change, const sbi_glue_tie *ties, int count);
/* What the change removes is gone for good, with its motion: nodes may be left without a cell, and stand still then
 * without mass; loads may lose their last face, the body its last material (an empty piece is all that is left then);
 * and velocities stay as they are. */
SBI_API void sbi_change_erode(sb_body_change *change);
/* Between changes: the ties that there are, in the order that the last change gave them in, have these Gram matrices.
 */
SBI_API void sbi_body_set_glue(sb_body *body, const sbi_glue_tie *ties, int count);

/* ---- live_push.c: forces in the next time step alone ---- */

/* Room for so many more; 0: no memory. */
SBI_API int sbi_live_reserve_pushes(sb_body *body, int more);
/* Adds one that there is room for. */
SBI_API void sbi_live_push(sb_body *body, int node, sb_vec3 force, sb_real stiffness);
/* forces [nodes] += all of them, at nodes that go on as they did; of any body. */
SBI_API void sbi_live_add_pushes(const sb_body *body, sb_vec3 *forces);
/* The same in an explicit step of dt (s), where light nodes feel less. Uses body->work. */
SBI_API void sbi_live_add_light_pushes(sb_body *body, sb_real dt, sb_vec3 *forces);
/* An implicit step of dt (s) begins: what is held of the stiffness in it; 0: nothing. Uses body->work. */
SBI_API int sbi_live_hold_pushes(sb_body *body, sb_real dt);
/* forces [nodes] += factor times what is held of the stiffness times vectors [nodes]. */
SBI_API void sbi_live_add_push_product(const sb_body *body, sb_real factor, const sb_vec3 *vectors, sb_vec3 *forces);
/* Adds factor times that to the body's matrix. */
SBI_API void sbi_live_add_push_stiffness(sb_body *body, sb_real factor);
/* The step is done; of any body. */
SBI_API void sbi_live_forget_pushes(sb_body *body);

/* Holds a node that has no material where it is, if all of its cells are empty or its last one went (had: it was of a
 * part before): nothing moves it. Others are left alone. */
SBI_API void sbi_live_park_node(sb_body *body, int node, int had);

SB_INLINE int sbi_live_is_piece(const sb_body *body, int cell)
{
    return body->live && body->live->pieces && body->live->pieces[cell].is != 0;
}
/* Density times share of material; 0 of a free cell. */
SB_INLINE sb_real sbi_live_density(const sb_body *body, int cell)
{
    sb_real density = body->materials[body->cell_material[cell]].density;
    return body->live ? density * body->live->shares[cell] : density;
}
SB_INLINE int sbi_live_has_cell(const sb_body *body, int cell) { return !body->live || body->live->cells.used[cell]; }
SB_INLINE int sbi_live_follows(const sb_body *body) { return body->live && body->live->follows; }
/* Cells and parts that arrays have room for. */
SB_INLINE int sbi_live_cell_room(const sb_body *body)
{
    return body->live ? body->live->cells.capacity : body->domain.cell_count;
}
SB_INLINE int sbi_live_part_room(const sb_body *body) /* a part has a cell */
{
    return sbi_live_follows(body) ? body->node_capacity / body->domain.nodes_per_cell + 1 : body->component_count;
}

/* Walks the cells of a node in ascending order: `at` from sbi_live_first_cell on by sbi_live_next_cell until it is < 0;
 * sbi_live_cell_of(body, at) is the cell. */
SB_INLINE int sbi_live_first_cell(const sb_body *body, int node)
{
    const sb_index_lists *lists = &body->node_elements;
    if (body->assembly.live)
        return body->assembly.live->corner_first[node];
    return lists->offsets[node] < lists->offsets[node + 1] ? lists->offsets[node] : -1;
}
SB_INLINE int sbi_live_next_cell(const sb_body *body, int node, int at)
{
    if (body->assembly.live)
        return body->assembly.live->corner_next[at];
    return at + 1 < body->node_elements.offsets[node + 1] ? at + 1 : -1;
}
SB_INLINE int sbi_live_cell_of(const sb_body *body, int at)
{
    return body->assembly.live ? at / 4 : body->node_elements.items[at];
}
/* 1 when a node has material: a cell that is not an empty piece. */
SB_INLINE int sbi_live_has_material(const sb_body *body, int node)
{
    int at = sbi_live_first_cell(body, node);
    while (at >= 0 && body->live && !(body->live->shares[sbi_live_cell_of(body, at)] > 0))
        at = sbi_live_next_cell(body, node, at);
    return at >= 0;
}

#endif /* SB_LIVE_PRIVATE_H */
