/* contact_skin: contact on a skin that the body carries (body/skin.h) in place of its mesh's boundary. Internal.
 *
 * All of contact is then in terms of the skin's points: they are the nodes of its faces, where places, motions, forces
 * and stiffness are. A point's place is x = W x_body, a row W of weights over the nodes of its cell; so forces go to
 * the body by W^T, and stiffness K by W^T K W. Torque balances as it does for the points, since these are where the
 * forces act. The body knows nothing of it: nodes that it is asked about are those of the rows.
 *
 * A face of which all nodes lie in one cell has its blocks in the matrix. Points in different cells have none for their
 * nodes' pairs. Of the stiffness K of such a face each point's own row has
 *     B = diag(sum_b K_ab),    x.K x = sum dA k |sum N_a x_a|^2 <= sum dA k sum N_a |x_a|^2 = x.B x,
 * in the matrix, since weights N of samples are positive and sum to 1; and K - B is multiplied beside it, as links are
 * (step_touch.h). So what the preconditioner is made of is positive definite and no softer than what is solved.
 *
 * What contact remembers of pressures (contact_memory.c) belongs to the corners of the cells, not to points: a skin may
 * have many in a cell, and one number for each would be more than the cell can follow. */
#ifndef SB_CONTACT_SKIN_H
#define SB_CONTACT_SKIN_H

#include "../body/skin.h"
#include "../body/skin_private.h"
#include "contact_faces.h"

/* What of a face between points of different cells is beside the matrix: K - B. */
typedef struct sbi_contact_cross {
    int face;
    sb_real blocks[9][9];
} sbi_contact_cross;

typedef struct sbi_contact_skin {
    sb_skin *source;                /* NULL: faces are the mesh's boundary, and all else is zeros */
    int point_count;                /* at the last update */
    int point_room, width, corners; /* points; nodes and corners of a cell */
    int *cells;                     /* [point_room] -1: unused */
    unsigned char *counts;          /* [point_room] nodes of a row */
    int *nodes;                     /* [point_room][width] that have a weight */
    sb_real *weights;
    int *corner_nodes; /* [point_room][corners] */
    sb_real *shares;   /* likewise: linear weights of the corners, >= 0, at the point's place in its cell */
    sb_vec3 *rest;     /* [point_room] m */
    sb_vec3 *at, *velocity, *moved; /* [point_room] places and motions of points while they are looked at */
    sb_vec3 *du, *force;            /* [point_room] by place, in a step */
    void *memory;

    /* of the body; arrays in sb_contact.room_memory */
    int node_room;
    sb_real *node_areas;   /* [node_room] m^2: what of the skin is a node's, sum W_pa A_p */
    int *place;            /* [node_room] of a node in `list`, -1 outside of steps */
    int *list, list_count; /* [node_room] nodes in touch: sbi_touch.nodes */
    sb_real *loads;        /* [node_room] by place: tr A_aa / 3 (N/m), or in explicit substeps what loads the node */

    /* Entries of a state that was loaded, in sb_contact.entries, whose triangles are known at the next update; then
     * entry_count is 0. */
    int waiting;
    int *found, *next; /* [max_contacts] scratch for entries that follow their faces */
    int cross_count;
    sbi_contact_cross *cross; /* [patch_room, and slot_room of pairs] of the system that is solved */
    int most_saved;           /* blocks of the matrix that there is room to save */
} sbi_contact_skin;

/* ---- contact_skin.c ---- */
/* Name of a triangle with these corners. */
SBI_API uint64_t sbi_contact_skin_name(const struct sb_contact *contact, int face, const int *corners);
/* Names the triangles of all entries, unless these wait for them. */
SBI_API void sbi_contact_skin_name_entries(struct sb_contact *contact);
/* Entries that wait become those of the triangles that there are. */
SBI_API void sbi_contact_skin_take_waiting(struct sb_contact *contact);
/* Brings skin and faces up to the body's mesh, entries too; takes memory where there are more points or triangles than
 * there was room for: always when `faces` are made. SB_ERROR_MEMORY, SB_ERROR_STATE, SB_ERROR_MESH: nothing of it is to
 * be used before it succeeds. */
struct sb_contact;
SBI_API sb_result sbi_contact_skin_update(struct sb_contact *contact, sb_error *error);
/* 1: after a change of the mesh (or is_load: a state) the skin is not to be asked before the call that made it has
 * returned; also of an embedding in a body that is cut, whose cuts are loaded later. */
SBI_API int sbi_contact_skin_is_late(const struct sb_contact *contact, int is_load);
SBI_API void sbi_contact_skin_free(struct sb_contact *contact);
/* Areas of the body's nodes, from those of points. */
SBI_API void sbi_contact_skin_measure(struct sb_contact *contact);
/* A field over the body's nodes [rows] at the points of the faces: in `room`, [points], or the field itself where nodes
 * are the points. */
SBI_API const sb_vec3 *sbi_contact_at_points(const struct sb_contact *contact, const sb_vec3 *field, sb_vec3 *room);
/* Places of points where the body is, and at rest. */
SBI_API const sb_vec3 *sbi_contact_points_now(const struct sb_contact *contact);
SBI_API const sb_vec3 *sbi_contact_points_at_rest(const struct sb_contact *contact);
SBI_API int sbi_contact_point_count(const struct sb_contact *contact);

/* Lists the nodes of a point that has been placed. */
SBI_API void sbi_contact_skin_place(struct sb_contact *contact, int point);
SBI_API void sbi_contact_skin_forget(struct sb_contact *contact);
/* du of the points in touch from that of nodes, both by place; force of nodes from that of points. */
SBI_API void sbi_contact_skin_take(const struct sb_contact *contact, const unsigned char *masked,
                                   const sb_vec3 *of_nodes, sb_vec3 *of_points);
SBI_API void sbi_contact_skin_give(const struct sb_contact *contact, const unsigned char *masked,
                                   const sb_vec3 *of_points, sb_vec3 *of_nodes);

/* ---- contact_skin_blocks.c ---- */
/* matrix += what blocks k [3][3] of a face are of its nodes, as far as those have blocks; the rest is multiplied
 * beside. cross_count is 0 before the first. */
SBI_API void sbi_contact_skin_add_face(struct sb_contact *contact, const unsigned char *masked, sb_matrix *matrix,
                                       int face, const sb_real (*k)[9]);
/* out [rows] += C x, as sbi_touch.multiply_links. */
SBI_API double sbi_contact_skin_multiply_links(const struct sb_contact *contact, const unsigned char *masked,
                                               const sb_vec3 *x, sb_vec3 *out);

/* A row of a point: its nodes and their weights. */
typedef struct sbi_contact_row {
    int count;
    const int *nodes;
    const sb_real *weights;
} sbi_contact_row;
SB_INLINE sbi_contact_row sbi_contact_skin_row(const sbi_contact_skin *skin, int point)
{
    sbi_contact_row row;
    row.count = skin->counts[point];
    row.nodes = skin->nodes + (size_t)point * (size_t)skin->width;
    row.weights = skin->weights + (size_t)point * (size_t)skin->width;
    return row;
}

#endif /* SB_CONTACT_SKIN_H */
