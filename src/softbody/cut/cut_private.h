/* cut_private: what is inside an sb_cut. Internal.
 *
 * Tets are those of the uncut mesh, in the order of the body's cells at creation; each has a chain of pieces, the first
 * of which has the tet's number (sbi_cut_first_piece). Nodes of the uncut mesh keep their numbers. */
#ifndef SB_CUT_PRIVATE_H
#define SB_CUT_PRIVATE_H

#include "../body/body_private.h"
#include "../body/live_private.h"
#include "../body/state_part.h"
#include "blade_tree.h"
#include "crossing.h"
#include "cut.h"
#include "parted.h"

typedef struct sbi_cut_piece {
    uint64_t points; /* of the lattice; 0: what a body without material has left */
    int cell;        /* of the body; -1: all of the tet was taken out, and it has no piece */
    int next;        /* piece of the same tet with the next lowest point, or -1; of a free one the next free one */
    int crumb;       /* of a call: the search for crumbs that has found it last */
} sbi_cut_piece;

enum { SBI_CUT_NODES = 10 }; /* of an element, at most */

/* A piece near what a call has parted, as it is to be. */
typedef struct sbi_cut_cell {
    uint64_t points;
    int tet;
    int piece;     /* that it is of now */
    int is_new;    /* 1: another piece has that one's cell */
    int is_cut;    /* 1: its tet falls into other pieces now */
    int is_gone;   /* 1: it is taken out, or nothing is left of it */
    int crumb;     /* as of a piece */
    int cell;      /* -1: it has none */
    sb_real share; /* of its tet's volume, where crumbs are looked for */
    int old_nodes[SBI_CUT_NODES], nodes[SBI_CUT_NODES];
    unsigned short marks[4]; /* on the faces */
} sbi_cut_cell;

/* A class of the cells' nodes at a node: one node from now on. */
typedef struct sbi_cut_class {
    int root;
    int old;  /* its number so far */
    int has;  /* 1: the material at the node's place */
    int held; /* axes that a copy is supported along */
    int number;
} sbi_cut_class;

/* A blade that crosses a link. */
typedef struct sbi_cut_hit {
    int blade, tet, link;
    sb_real t;
} sbi_cut_hit;

/* A triangle of a lip that is glued: SBI_LIPS times the micro-tet plus its place there. */
typedef struct sbi_cut_glued {
    int tet, place;
} sbi_cut_glued;

/* One that is to be glued, or may stay so, in the call at work. */
typedef struct sbi_cut_seam {
    int tet, place;
    int link;
    sb_real at[4];        /* barycentrics of its centroid */
    int part;             /* connected part of the body */
    int is_new, is_swept; /* of this call */
    sb_real area, energy; /* at rest (m^2); that its glue holds now (J) */
    sb_vec3 needle[2];    /* through it, from side to side (m, in space) */
} sbi_cut_seam;

/* What a call has done to lips. */
typedef struct sbi_cut_released {
    sb_real area, glued_area, energy;
} sbi_cut_released;

/* What a call has taken out. */
typedef struct sbi_cut_removed {
    int crumbs;
    double volume, mass, momentum[3]; /* at rest (m^3), kg, kg m/s */
} sbi_cut_removed;

/* A triangle of a lip that has been freed and that the blade is still to pay for, see cut_force.c. */
typedef struct sbi_cut_debt {
    int tet;
    int sides[2];  /* lattice points on either side */
    sb_real at[4]; /* barycentrics of its centroid */
    sb_real area;  /* at rest, that has not been paid for (m^2) */
    sb_real way;   /* of the blade past it until it has (m) */
    sb_vec3 place; /* of its lips at the last move of the blade (m) */
} sbi_cut_debt;

typedef struct sbi_cut_debts {
    sbi_cut_debt *items;
    int count, capacity;
} sbi_cut_debts;

/* A cut link whose crossing ablation has moved, and where it was. */
typedef struct sbi_cut_receded {
    int item, charred;
    sb_real t;
} sbi_cut_receded;

/* A tet that loses points, and what it had lost before. */
typedef struct sbi_cut_loss {
    uint64_t points;
    int tet;
} sbi_cut_loss;

typedef struct sbi_cut_list {
    int *items;
    int count, capacity;
} sbi_cut_list;

typedef struct sbi_cut_box {
    sb_vec3 low, high;
} sbi_cut_box;

/* A point of a stroke's front: material that it moves with, or a place in space. */
typedef struct sbi_cut_sample {
    int side;      /* of the blade's edge */
    sb_real along; /* from its first corner, 0, to its last, 1 */
    int tet;       /* -1: outside of the body */
    sb_real at[4]; /* barycentrics in the tet */
    sb_vec3 place; /* when it was put there (m) */
} sbi_cut_sample;

/* A stretch of a side of an edge. */
typedef struct sbi_cut_span {
    sb_real first, last;
} sbi_cut_span;

typedef struct sbi_cut_stroke {
    int edge_count;          /* corners of the blade's edge; 0: no stroke */
    sbi_cut_sample *samples; /* the front, from the first corner to the last, all corners among them */
    int sample_count, sample_capacity;
    sbi_cut_debts debts; /* none without toughness */
    sb_vec3 about;       /* of the call at work: what its torque is about (m) */
} sbi_cut_stroke;

struct sb_cut {
    sb_body *body; /* NULL: it is gone */
    sb_allocator allocator;
    int listener;
    int joined;        /* 1: a part of the body's state */
    int changing;      /* 1: the change under way is our own */
    int stale;         /* 1: the body's mesh is not what we know */
    int keeps_rings;   /* 1: links in rings stay whole: for tests */
    sbi_uncut uncut;   /* what the body knows of the mesh below */
    uint64_t mesh_was; /* of what a destroyed cut has left: hash of the mesh that it knows */
    int glues;         /* 1: SB_CUT_GLUE */
    sb_real beta;      /* of the glue */
    sb_real toughness; /* J_c (J/m^2) */
    sbi_lattice lattice;

    int tet_count, node_end;
    int *tets;                 /* [tet_count][4] corners */
    int nodes_per_tet;         /* 4, or 10 */
    int *nodes;                /* [tet_count][nodes_per_tet] of tet10; of tet4 these are `tets` */
    sb_index_table neighbours; /* [tet_count][4] across faces, -1: none */
    sb_index_lists node_tets;  /* tets of each node, ascending */

    int *cells_at_first;   /* [tet_count] of the body, before any cut */
    sbi_cut_piece *pieces; /* [piece_capacity] */
    int piece_count, piece_capacity;
    int free_piece; /* or -1 */
    sbi_cut_links links;
    sbi_cut_glued *glue, *next_glue; /* by tet and place; those of the call at work */
    int glue_count, glue_capacity, next_glue_count, next_glue_capacity;
    sbi_cut_list origins;  /* [node] of the uncut mesh that it is a copy of, or itself */
    sbi_cut_list elements; /* [cell] tet */

    double rest_size;        /* of the body's box at rest (m) */
    sb_real element_size;    /* mean edge of elements at rest (m) */
    sb_real least_volume;    /* of a free part at rest (m^3) */
    sb_real least_piece;     /* of the def */
    sbi_cut_stroke *strokes; /* [max_strokes] */
    int max_strokes;

    /* of a state that is being loaded */
    sbi_cut_links loaded_links;
    int loaded_glue_count;                      /* in next_glue */
    sbi_cut_list loaded_cells, loaded_elements; /* pieces' cells, tet after tet; like elements */

    /* of a call; marks are 0 between calls */
    sbi_blade *blades;
    int blade_count, blade_capacity;
    sbi_blade_tree tree;
    int tree_capacity;
    uint64_t *blade_codes; /* [tree_capacity] */
    int *blade_scratch;
    unsigned char *is_near; /* [tet_count] */
    unsigned char *beyond;  /* [beyond_capacity] of a body's nodes: sides of a box that each is beyond, as bits */
    int beyond_capacity;
    sbi_cut_list near, blade_hits;
    sbi_cut_list listed; /* [tet_count + 1] of the part of a call at work, one after another: near tets whose boxes meet
                          * that of a blade's edge; hits of near tets; tets that have parted */
    sbi_cut_box now;     /* of the body */
    sbi_cut_box reach;   /* of the triangles */
    sbi_cut_hit *hits, *sorted_hits;
    int hit_capacity, sorted_capacity;
    sbi_cut_list around;          /* tets around a link */
    sbi_cut_list struck, crossed; /* links that blades of the frame have; predicted ones that blades have crossed */
    sbi_cut_seam *seams;
    int seam_count, seam_capacity;
    sbi_cut_released released;
    sbi_cut_debts freed; /* where there is toughness */
    sbi_glue_tie *ties;
    int tie_count, tie_capacity;
    sb_vec3 *strip; /* triangles of a move */
    int strip_capacity;
    sbi_cut_sample *front, *sorted_front; /* a stroke's next one */
    int front_capacity, sorted_front_capacity;
    sbi_cut_list front_order, front_scratch;
    sbi_cut_span *spans; /* of a side of the edge, in cells */
    int span_count, span_capacity;
    unsigned char *tet_marks, *node_marks; /* [tet_count], [node_end] */
    int *cell_of;                          /* [tet_count] 1 + first of its records, or 0 */
    sbi_cut_list touched;                  /* tets */
    sbi_cut_cell *cells;
    int cell_count, cell_capacity;
    sbi_cut_list roots;     /* [cell_count][nodes_per_tet] union-find over nodes of the records */
    sbi_cut_class *classes; /* of one node */
    int class_count, class_capacity;
    int made_nodes, made_cells;
    sbi_cut_receded *receded; /* in the order in which they were moved */
    int receded_count, receded_capacity;
    sbi_cut_loss *losses; /* of tets that lose points in this call */
    int loss_count, loss_capacity;
    sbi_cut_list flooded; /* pieces of a part: a record, or ~ a piece of a tet without records */
    int floods;           /* searches for crumbs so far */
    sbi_cut_removed removed;
    sb_real *tear_loads;                   /* [tet_count] stress over what it bears; NULL: no call yet */
    sbi_cut_list tearing, tearing_scratch; /* tets that may tear */
};

/* The first piece of a tet, or -1. */
SB_INLINE int sbi_cut_first_piece(const sb_cut *cut, int tet) { return cut->pieces[tet].cell < 0 ? -1 : tet; }

/* 1 when a tet is one whole piece, with the cell that it had at first. */
SB_INLINE int sbi_cut_is_whole(const sb_cut *cut, int tet)
{
    return cut->pieces[tet].next < 0 && cut->links.lost[tet] == 0;
}

enum { SBI_CUT_ALL_PARTS = -1 };
SB_INLINE int sbi_cut_is_of(const sb_cut *cut, int node, int part)
{
    return part == SBI_CUT_ALL_PARTS || cut->body->node_component[node] == part;
}

enum { SBI_CUT_TOUCHED = 1, SBI_CUT_PARTED = 2, SBI_CUT_NEAR = 4, SBI_CUT_LOSES = 8 };

/* ---- cut_lists.c ---- */

/* Room for `more` items behind those that are there: for just these at first, then for more than are asked for. 0: no
 * memory. */
SBI_API int sbi_cut_grow(const sb_allocator *allocator, void **items, int *capacity, int count, int more, size_t size);
SBI_API int sbi_cut_list_grow(const sb_cut *cut, sbi_cut_list *list, int more);
/* Sets an item that there is room for; those between it and the last one are -1 then. */
SBI_API void sbi_cut_list_set(sbi_cut_list *list, int at, int value);
/* Room for so many more links; 0: no memory. */
SBI_API int sbi_cut_reserve_links(sb_cut *cut, int more);
/* Room for so many more blades, and a tree over them. */
SBI_API int sbi_cut_reserve_blades(sb_cut *cut, int more);

/* ---- cut_sweep.c, cut_ring.c ---- */

SB_INLINE void sbi_cut_box_add(sbi_cut_box *box, sb_vec3 x)
{
    box->low = sb_v3(sb_min(box->low.x, x.x), sb_min(box->low.y, x.y), sb_min(box->low.z, x.z));
    box->high = sb_v3(sb_max(box->high.x, x.x), sb_max(box->high.y, x.y), sb_max(box->high.z, x.z));
}
SBI_API void sbi_cut_box_widen(sbi_cut_box *box, sb_real by);
SBI_API sbi_cut_box sbi_cut_box_around(const sb_vec3 *points, int count);
/* Lists the tets around a link in cut->around. */
SBI_API void sbi_cut_list_around(sb_cut *cut, const sbi_link_key *key);
/* Lists a tet as touched. */
SBI_API void sbi_cut_touch(sb_cut *cut, int tet);
/* Cuts or predicts (state) a link that is whole, and lists the tets around it as touched. blade: that did, or -1. 0: no
 * memory. */
SBI_API int sbi_cut_add_link(sb_cut *cut, const sbi_link_key *key, sb_real t, int state, int blade);
/* Cuts a predicted link, and lists the tets around it as touched; it stays where it is. 0: no memory. */
SBI_API int sbi_cut_cross_link(sb_cut *cut, int item, int blade);
/* No link has been struck any more. */
SBI_API void sbi_cut_forget_struck(sb_cut *cut);
/* Takes back all links but the first `count`, crossings of predicted ones, and what crossings have moved by. */
SBI_API void sbi_cut_take_back(sb_cut *cut, int count);
/* The piece of a tet that has a lattice point, as it is before the call. */
SB_INLINE int sbi_cut_piece_with(const sb_cut *cut, int tet, int point)
{
    int piece = tet;
    while (!(cut->pieces[piece].points >> point & 1) && cut->pieces[piece].next >= 0)
        piece = cut->pieces[piece].next;
    return piece;
}
/* Nodes of a tet of the uncut mesh, and of the cell of a piece. */
SB_INLINE const int *sbi_cut_tet_nodes(const sb_cut *cut, int tet)
{
    return cut->nodes + (size_t)cut->nodes_per_tet * (size_t)tet;
}
SB_INLINE const int *sbi_cut_piece_nodes(const sb_cut *cut, int piece)
{
    return cut->body->domain.cells + (size_t)cut->nodes_per_tet * (size_t)cut->pieces[piece].cell;
}
/* Where the nodes of a piece are (m, in space). */
SBI_API void sbi_cut_get_nodes(const sb_cut *cut, int piece, sb_vec3 x[SBI_CUT_NODES]);
/* Where a point with these barycentrics is in an element with nodes at x: the same bits from all tets around. */
SBI_API sb_vec3 sbi_cut_place(const sb_cut *cut, const sbi_corner_order *order, const sb_real barycentrics[4],
                              const sb_vec3 x[SBI_CUT_NODES]);
/* Shape functions of an element there: [nodes_per_tet]. */
SBI_API void sbi_cut_get_shape(const sb_cut *cut, const sb_real barycentrics[4], sb_real shape[SBI_CUT_NODES]);
/* Box of a piece (m, in space). */
SBI_API sbi_cut_box sbi_cut_box_of_piece(const sb_cut *cut, int piece);
/* A piece in the present shape: places of all lattice points. */
typedef struct sbi_cut_shape {
    sbi_corner_order order;
    sbi_int3 places[SBI_LATTICE_POINTS];
} sbi_cut_shape;
SBI_API void sbi_cut_shape_make(const sb_cut *cut, int tet, int piece, const sbi_crossing_frame *frame,
                                sbi_cut_shape *shape);
/* Lists the tets with a piece whose box meets this one (m, in space) in cut->near. now: the body's box. */
SBI_API void sbi_cut_list_near(sb_cut *cut, const sbi_cut_box *now, const sbi_cut_box *reach);
/* 1 when the box of a piece of a tet meets this one. */
SBI_API int sbi_cut_meets_tet(const sb_cut *cut, int tet, const sbi_cut_box *box);
/* Room for so many hits; 0: no memory. */
SBI_API int sbi_cut_reserve_hits(sb_cut *cut, int count);
/* Cuts the links of near tets of a connected part, or of all, that the blades cross in the body's present shape. 0: no
 * memory, and links are to be taken back. */
SBI_API int sbi_cut_sweep(sb_cut *cut, const sbi_crossing_frame *frame, int part);
/* The first of the frame's blades that crosses the link between two points, or -1. */
SBI_API int sbi_cut_first_crossing(const sb_cut *cut, sbi_int3 from, sbi_int3 to);
/* Cuts links of touched tets that are ringed by cut ones, among them one cut from number `first` on. 0: no memory. */
SBI_API int sbi_cut_close_rings(sb_cut *cut, int first);

/* ---- cut_predict.c ---- */

/* Predicts links of tets of a part, or of all, that blades of this frame have come into but not through; 0: no memory,
 * and links are to be taken back. */
SBI_API int sbi_cut_predict(sb_cut *cut, const sbi_crossing_frame *frame, int part);

/* ---- cut_glue.c ---- */

/* Room for what comes first; 0: no memory. */
SBI_API int sbi_cut_take_glue(sb_cut *cut);
SBI_API int sbi_cut_reserve_glue(sb_cut *cut, int count);
/* Lists what may be glued after this call: what is, and new lips of tets that have parted where a link beside them is
 * predicted only. Counts what is released by that. 0: no memory. */
SBI_API int sbi_cut_list_seams(sb_cut *cut);
/* Marks those of a part, or of all, that blades of the frame pass through. */
SBI_API int sbi_cut_sweep_seams(sb_cut *cut, const sbi_crossing_frame *frame, int part);
/* next_glue = what was not swept of it. 0: no memory. */
SBI_API int sbi_cut_keep_seams(sb_cut *cut);
/* The body's ties for next_glue, with the cells that records have, in cut->ties; 0: no memory. */
SBI_API int sbi_cut_make_ties(sb_cut *cut);
/* glue = next_glue */
SBI_API void sbi_cut_take_next_glue(sb_cut *cut);
SBI_API void sbi_cut_free_glue(sb_cut *cut);

/* ---- cut_force.c ---- */

/* Room for what comes first; 0: no memory. */
SBI_API int sbi_cut_take_force(sb_cut *cut);
/* Room for so many more in cut->freed, and for so many debts in a stroke; 0: no memory. */
SBI_API int sbi_cut_reserve_freed(sb_cut *cut, int more);
SBI_API int sbi_cut_reserve_debts(const sb_cut *cut, sbi_cut_stroke *stroke, int count);
/* This call has freed the triangle of a seam. */
SBI_API void sbi_cut_add_freed(sb_cut *cut, const sbi_cut_seam *seam);
/* The blade of a stroke pays for what the call has freed, and for what it owes, along the strip it has come: adds what
 * it feels to info, and pushes the tissue. */
SBI_API void sbi_cut_pay(const sb_cut *cut, sbi_cut_stroke *stroke, const sb_vec3 *strip, sb_cut_info *info);
SBI_API void sbi_cut_free_force(sb_cut *cut);

/* ---- cut_tell.c ---- */

#define SBI_CUT_PART "cut" /* of the body's state */
/* What a recording holds of a cut. Calls of strokes: the stroke, and the edge. */
enum {
    SBI_CUT_TRIANGLES = 1,
    SBI_CUT_BEGIN = 2,
    SBI_CUT_MOVE = 3,
    SBI_CUT_END = 4,
    SBI_CUT_SCISSORS = 5,
    SBI_CUT_ABLATE = 6,
    SBI_CUT_TEAR = 7
};
SBI_API void sbi_cut_tell(const sb_cut *cut, int command, int stroke, const sb_vec3 *points, int count);
/* A tear has its options instead. */
SBI_API void sbi_cut_tell_tear(const sb_cut *cut, const sb_tear_options *options);

/* ---- cut_tear.c ---- */

SBI_API void sbi_cut_free_tears(sb_cut *cut);

/* ---- cut_along.c ---- */

/* The box at x of the nodes in use of a part, or of all parts, and its diagonal (m). */
SBI_API sbi_cut_box sbi_cut_box_of(const sb_cut *cut, const sb_vec3 *x, int part);
SBI_API double sbi_cut_size_of(const sbi_cut_box *box);

/* Lists the tets near the box of points in space, or no farther from it than that (m), in cut->near. */
SBI_API void sbi_cut_list_reached(sb_cut *cut, const sb_vec3 *points, int count, sb_real margin);
/* Cuts near tets along triangles, which are the strip of a stroke's move or, stroke NULL, anything, and says what that
 * did (info may be NULL). On failure nothing has happened. */
SBI_API sb_result sbi_cut_along(sb_cut *cut, const sb_vec3 *triangles, int count, sbi_cut_stroke *stroke,
                                sb_cut_info *info, sb_error *error);
/* Finds tets that have parted, and what of the lips is glued after the call; 0: no memory. */
SBI_API int sbi_cut_settle_seams(sb_cut *cut, const sb_vec3 *triangles, int count);
/* Makes the pieces that links cut in this call, whose first new one is `first`, and points lost in it leave, and says
 * what that did (info may be NULL). ringed: links cut by rule. Without memory so far (done 0) or on failure links and
 * points are as they were, and all else. */
SBI_API sb_result sbi_cut_finish(sb_cut *cut, int first, int ringed, int done, sb_cut_info *info, sb_error *error);
/* Whether a call may go on: SB_ERROR_STATE. */
SBI_API sb_result sbi_cut_check_use(const sb_cut *cut, sb_error *error);

/* ---- cut_record.c ---- */

/* Volume of an element at rest (m^3). */
SBI_API sb_real sbi_cut_tet_volume(const sb_cut *cut, int tet);
/* What links and losses leave of a tet now. */
SBI_API void sbi_cut_parted(const sb_cut *cut, int tet, sbi_parted *parted);
/* Lists touched tets that fall into more pieces than before, or lose points, and marks their nodes. */
SBI_API void sbi_cut_find_parted(sb_cut *cut);
/* Takes back what points touched tets have lost in this call. */
SBI_API void sbi_cut_take_back_lost(sb_cut *cut);
/* Place among the nodes of a record of this node of the uncut mesh; -1: none. */
SBI_API int sbi_cut_local_of(const sb_cut *cut, const sbi_cut_cell *cell, int node);
/* 1 when a record has the material at one of its nodes. */
SBI_API int sbi_cut_has_material(const sb_cut *cut, const sbi_cut_cell *cell, int local);
/* Where the records of a tet end, one of which is `first`. */
SBI_API int sbi_cut_end_of(const sb_cut *cut, int first);
/* The root of node a of record i, for nodes_per_tet i + a. */
SBI_API int sbi_cut_root(const sb_cut *cut, int i);
/* Axes along which all nodes of a boundary face of a record are held: those that a copy at it is held along. */
SBI_API int sbi_cut_held_axes(const sb_cut *cut, const sbi_cut_cell *cell, int node);
/* Records of the pieces of a tet as they are to be, and of all tets near what has parted; 0: no memory. */
SBI_API int sbi_cut_add_tet(sb_cut *cut, int tet);
SBI_API int sbi_cut_add_tets(sb_cut *cut);
/* Joins corners of records over all faces between their tets. */
SBI_API void sbi_cut_join_all(sb_cut *cut);
/* How near an end of its link a crossing may be, of the link, for masses and stiffness. */
SBI_API sb_real sbi_cut_least(const sb_cut *cut);

/* ---- cut_crumb.c ---- */

/* Marks the records of free parts that are too small as gone; of tets that had none, records come behind the others.
 * Corners of records have been joined. 0: no memory. */
SBI_API int sbi_cut_find_crumbs(sb_cut *cut);

/* ---- topology.c ---- */

/* Makes pieces, copies and cells of what they have become, and glue of next_glue, by a change of the body's mesh. On
 * failure nothing has happened. */
SBI_API sb_result sbi_cut_part(sb_cut *cut, sb_error *error);
/* The cell of the body whose material is at xi of the tet that `cell` is of, see sb_body_find_cell: user is the cut.
 * Within a change of its own it is as after it. */
SBI_API int sbi_cut_find_cell(void *user, int cell, const sb_real xi[3]);
/* The body asks this cut which piece has what material, or, where it does not know the mesh any more, nobody. */
SBI_API void sbi_cut_lend_finder(sb_cut *cut);
/* As a cut is destroyed: what finds the pieces of its body stays with that, if there are any, in the body's memory;
 * where there is none, nobody knows them any more. */
SBI_API void sbi_cut_leave_finder(const sb_cut *cut);
/* Takes what a destroyed cut has left out of a body, before another one is made. */
SBI_API void sbi_cut_drop_finder(sb_body *body);
/* Forgets what tets have been touched. */
SBI_API void sbi_cut_clear(sb_cut *cut);

/* ---- cut_stroke.c ---- */

/* Room for the strokes; 0: no memory. */
SBI_API int sbi_cut_take_strokes(sb_cut *cut, int max_strokes);
SBI_API void sbi_cut_free_strokes(sb_cut *cut);
/* Room for so many samples in a stroke, which keeps those that it has; 0: no memory. */
SBI_API int sbi_cut_stroke_reserve(const sb_cut *cut, sbi_cut_stroke *stroke, int samples);

/* ---- cut_state.c ---- */

/* The cut becomes a part of its body's state and recordings, or is no longer one. */
SBI_API sb_result sbi_cut_join_state(sb_cut *cut, sb_error *error);
SBI_API void sbi_cut_leave_state(const sb_cut *cut);

/* ---- cut_surface.c ---- */
struct sb_cut_surface;
SBI_API struct sb_skin *sbi_cut_surface_get_skin(struct sb_cut_surface *surface);
/* The next update draws all anew, with the same result: for tests. */
SBI_API void sbi_cut_surface_forget(struct sb_cut_surface *surface);

#endif /* SB_CUT_PRIVATE_H */
