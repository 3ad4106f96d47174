/* contact_private: what is inside an sb_contact. Internal: the files contact*.c share it.
 *
 * Data of a step flow one way: sweep (how far each tool goes) -> patches (faces near a tool, one for each tool that
 * they are near) -> samples of patches, with what the step before remembers of them -> law -> forces and blocks by
 * patch -> entries (samples in touch), which are what is read, saved and remembered. */
#ifndef SB_CONTACT_PRIVATE_H
#define SB_CONTACT_PRIVATE_H

#include "../body/body_guest.h"
#include "../body/state_part.h"
#include "../body/step_touch.h"
#include "contact.h"
#include "contact_faces.h"
#include "contact_law.h"
#include "contact_pairs.h"
#include "contact_skin.h"

/* The sample nearest to a tool that nothing presses on. */
typedef struct sbi_contact_nearest {
    int known; /* 0: none is near */
    int face, parts, sample;
    sb_real gap;           /* m */
    sb_vec3 point, normal; /* m; out of the tool */
} sbi_contact_nearest;

/* What a tool hangs on. Its torque is 0 where it turns as it is sent to. */
typedef struct sbi_contact_spring {
    sb_real stiffness, turning, most; /* N/m, N m/rad, N; stiffness 0: the tool is rigid */
    sb_pose hand;                     /* its other end, after the last step */
    sb_vec3 force, torque;            /* N, N m about the tool's position: on the tool, where the last step balances */
    sb_pose hand_next, hand_balance;  /* of the step: at its end, and where forces balance */
    sb_vec3 pull, twist;              /* force and torque at the last evaluation */
    sb_pose hand_done;                /* of the last increment that was done */
    sb_vec3 pull_done, twist_done;
    sb_real level;  /* of the step */
    sb_pose centre; /* of the step: where it begins, and how far (m) it may go from there */
    sb_real limit;
    int held;           /* 1: at the last evaluation it went no farther because of that */
    int first, last;    /* patches */
    int size;           /* 3 or 6 unknowns; 0: it does not give way, as far as is known */
    sb_real factor[36]; /* Cholesky's, of stiffness of contact and spring against its motion */
} sbi_contact_spring;

/* A tool's place in the list. Chains are of capsules, [point count]. */
typedef struct sbi_contact_tool {
    sbi_tool *shape; /* NULL: the place is free */
    sb_real friction;
    sb_pose reached, wanted; /* at the end of the last step; where it is sent */
    sb_pose next, balance;   /* of the step: at its end, and where its forces balance */
    sb_vec3 *chain_reached, *chain_wanted, *chain_next, *chain_balance;
    sb_vec3 *chain_stage;        /* chain_next of the last increment of a static solve that was done */
    int face_count;              /* of its faces in sb_contact.near */
    sb_pose from;                /* at the start of the step, or of the increment of a static solve */
    sb_pose stage;               /* at the end of the last increment that was done */
    sb_pose seen;                /* at the last evaluation */
    sb_real shift;               /* m, its motion since the evaluation before that */
    sb_vec3 force, torque;       /* N, N m about its position: on the body, at the end of the last step */
    sb_real pushed, pushes;      /* N: sum of its pressures' forces, there and at the first guess of this step */
    sb_real way;                 /* m, of its skeleton in the step */
    sb_real lag;                 /* m */
    sbi_contact_nearest nearest; /* at the end of the last step, unless something touches; not saved */
    sbi_contact_spring spring;
} sbi_contact_tool;

/* A sample in touch at the end of the last step: what is read of it, and what the next step remembers of friction. */
typedef struct sbi_contact_entry {
    int tool, face, parts, sample, sticks;
    sb_real gap, area;            /* m, m^2 at rest */
    sb_vec3 traction;             /* t (Pa) on the body */
    sb_vec3 point, normal, force; /* m, out of the tool, N on the body */
    sbi_contact_answer answer;    /* of the law, for its stiffness; not saved: 0 where it was loaded */
    uint64_t name;                /* of the triangle of a skin, while it waits for that (sbi_contact_skin) */
} sbi_contact_entry;

enum { SBI_CONTACT_MOST_CORNERS = 4 }; /* of any face */

/* What a corner of faces remembers of a tool's pressure. */
typedef struct sbi_contact_pressure {
    int tool, node;
    sb_real value; /* l_a (Pa), > 0 */
} sbi_contact_pressure;

/* Sums at a corner over the samples in touch, see contact_memory.c. */
typedef struct sbi_contact_sum {
    sb_real old;               /* l_a before (Pa) */
    sb_real force, rise, kept; /* sum w p, sum w p (p - l), sum w p f */
    sb_real doubt;             /* share that is not remembered: the matrix is too stiff here for it to be stable */
} sbi_contact_sum;

/* A face near a tool. */
typedef struct sbi_contact_patch {
    int tool, face, parts;
    int first, count;                /* its samples */
    int touching;                    /* of them at the last evaluation */
    int nodes[SB_MAX_FACE_NODES];    /* places in the list of nodes */
    sb_vec3 seen[SB_MAX_FACE_NODES]; /* du of these at the last evaluation (m) */
} sbi_contact_patch;

typedef struct sbi_contact_sample {
    int patch, sample;
    const sb_real *weights;   /* [nodes of the face] */
    sb_real area;             /* m^2 at rest */
    sb_real k;                /* Pa/m */
    sb_real memory;           /* l (Pa), remembered */
    sb_vec3 remembered;       /* t (Pa) */
    sb_vec3 carried;          /* where the tool's own motion takes it over the step (m) */
    sb_vec3 normal;           /* of the last evaluation, out of the tool in space */
    sb_vec3 point;            /* m */
    sb_real gap, slip, bound; /* m, m, Pa */
    sb_vec3 start;            /* m, at the start of the step */
    sb_real clear;            /* m: the gap is no less now, see sbi_contact_clear */
    sbi_contact_answer answer;
} sbi_contact_sample;

/* A block of the matrix before contact was added. */
typedef struct sbi_contact_saved {
    int block;
    sb_real values[9];
} sbi_contact_saved;

struct sb_contact {
    sb_allocator allocator;
    sb_body *body;
    sb_real stiffness;
    int max_tools, max_contacts;
    sbi_contact_faces *faces;
    sbi_contact_tool *tools; /* [max_tools] */
    sbi_touch touch;
    sb_contact_info info, step_info; /* of the last step; of the one under way */

    /* of the step */
    int is_static, is_explicit;
    int stopped;      /* 1: nodes have been stopped at its end, see sbi_contact_stop */
    int foresees;     /* 1: nothing has been evaluated yet, and bounds of friction are to be foreseen */
    sb_real level;    /* share of the step after which forces balance */
    const sb_vec3 *x; /* [rows] places at its start (m): the body's own, or: */
    sb_vec3 *places;  /* [node_room] in a static solve, whose increments do not move the body before its end */
    int *near;        /* [max_tools][face_room] faces by tool */
    int *scratch;     /* [face_room] outside of steps */
    int patch_count;
    sbi_contact_patch *patches;
    int patch_room;
    sbi_contact_sample *samples; /* [max_contacts] */
    int sample_count;
    int *node_place;     /* [node_room] place in the list of nodes, -1 outside of steps */
    int node_count;      /* in touch: of faces, and so points of a skin */
    int *nodes;          /* [node_room] */
    sb_vec3 *moved;      /* [node_room] how far nodes go in the step (m), for a look at its end */
    sb_vec3 *positions;  /* by place in the list: at the start of the step (m) */
    sb_real *region_sum; /* [max_tools][regions] of k while it is summed, then k (Pa/m) */
    int *region_count;
    int region_room;
    sb_real *stiffness_by_node; /* by place: tr A_aa / 3 over its area (Pa/m); 0: it has none */
    sb_real (*blocks)[9];       /* [patch_room][width^2] sums of K by patch */
    int blocks_current;
    sbi_contact_sum *sums;    /* [node_room] by place; with a skin [skin.node_room] of the body's nodes */
    sbi_contact_saved *saved; /* [patch_room width^2] */
    int saved_count;
    sb_vec3 *hung_in, *hung_out; /* [node_room], and of the body's nodes, for products */

    /* of the last step */
    sbi_contact_entry *entries, *spare; /* [max_contacts] by tool, face, sample */
    int entry_count;
    int is_solved;                                     /* 1: entries are of the system that the body has solved last */
    sbi_contact_pressure *pressures, *spare_pressures; /* [corner_room max_contacts] of a tool together */
    int pressure_count, corner_room;                   /* corners that may remember of a contact */
    unsigned char *own_block; /* where a static solve, or a step that is divided, keeps what it gives back */
    size_t own_room;          /* its bytes */
    int kept;                 /* 1: a static solve is under way, and that is what it began with */
    void *memory;

    sbi_pairs pairs;
    sbi_contact_skin skin;

    /* of a body whose mesh may change, see contact_live.c */
    int listener;               /* -1: none */
    int faces_old;              /* 1: the mesh has changed since the faces were brought up to date */
    int room_faces, room_nodes; /* what there are arrays for */
    int room_body;              /* nodes of the body, of a skin */
    void *room_memory;          /* behind the arrays by face and node */
    void *next_room;            /* for the change that is under way, or NULL */
};

/* Room of arrays by node of the body. */
SB_INLINE int sbi_contact_body_room(const sb_contact *contact)
{
    return contact->skin.source ? contact->skin.node_room : contact->faces->node_room;
}
/* Room of arrays by node of the body and by point of a skin. */
SB_INLINE int sbi_contact_any_room(const sb_contact *contact)
{
    int body = sbi_contact_body_room(contact);
    return contact->faces->node_room > body ? contact->faces->node_room : body;
}

/* ---- contact_tool.c ---- */
/* Gives a tool back; a free place is fine. */
SBI_API void sbi_contact_free_tool(sb_contact *contact, int tool);

/* ---- contact_sweep.c ---- */
/* How far each tool goes in this step: `next`, `balance` and what else follows from it. SB_ERROR_NOT_CONVERGED: farther
 * in one increment of a static solve than what could not pass through. */
SBI_API sb_result sbi_contact_sweep(sb_contact *contact, const sbi_touch_step *step, sb_error *error);
/* 1: neither has a sample gone deeper, nor has one moved farther against its tool, than a skeleton might need to cross
 * a face. of_nodes [rows]: displacements at the end. */
SBI_API int sbi_contact_is_safe(sb_contact *contact, const sb_vec3 *of_nodes);
/* A last resort, for tools that stay where they are: organs with faces that would not be safe stay, too. of_nodes
 * [rows]: displacements. */
SBI_API void sbi_contact_stop(sb_contact *contact, sb_vec3 *of_nodes);
/* Nodes that it stopped have no speed, v [rows]. */
SBI_API void sbi_contact_brake_stopped(const sb_contact *contact, const sb_vec3 *of_nodes, sb_vec3 *v);
/* Depth (m) of the deepest sample of the body as it is in a tool at a pose, and its cell; 0: none touches. */
SBI_API sb_real sbi_contact_depth(sb_contact *contact, const sbi_tool *shape, const sb_vec3 *chain, const sb_pose *pose,
                                  int *element);

/* ---- contact_memory.c ---- */
/* places of what remembers the pressures on a face become `mark`. */
SBI_API void sbi_contact_mark_corners(sb_contact *contact, int face, int mark);
/* Puts an entry where the order of entries wants it. */
SBI_API void sbi_pairs_insert_entry(sbi_pairs *pairs, const sbi_pair_entry *entry);
/* What remembers: the nodes in touch, or with a skin the nodes of its cells. */
typedef struct sbi_contact_keepers {
    int count;
    const int *nodes, *place; /* by place; places by node */
} sbi_contact_keepers;
SBI_API sbi_contact_keepers sbi_contact_get_keepers(const sb_contact *contact);
/* What sums[].old says is remembered at a node of a face, by place. */
SBI_API sb_real sbi_contact_remembered(const sb_contact *contact, int place);
/* Those that remember for a node of a face, by place: itself, or of a skin corners of its cell. Returns how many. */
enum { SBI_CONTACT_MOST_KEEPERS = 8 };
SBI_API int sbi_contact_keepers_of(const sb_contact *contact, int place, int keepers[SBI_CONTACT_MOST_KEEPERS],
                                   sb_real shares[SBI_CONTACT_MOST_KEEPERS]);
/* Stiffness (Pa/m) of one; 0: it has none. */
SBI_API sb_real sbi_contact_keeper_stiffness(const sb_contact *contact, int keeper);
/* L of a corner at a sample: quadratic shape functions take linear ones from the middles. */
SBI_API sb_real sbi_contact_corner_share(const sbi_contact_kind *kind, const sb_real *weights, int corner);
/* memory of all samples, by what corners remember. */
SBI_API void sbi_contact_remember_pressures(sb_contact *contact);
/* What corners remember is that of the samples as they were evaluated last; fades: less where they slip. */
SBI_API void sbi_contact_keep_pressures(sb_contact *contact, int fades);

/* Puts an entry where the order of entries wants it. */
SBI_API void sbi_contact_insert_entry(sb_contact *contact, const sbi_contact_entry *entry);

/* ---- contact_lips.c: of contacts with pairs, as all below up to contact_step.c ---- */
/* Finds the lips of a skin that touches itself; boxes of faces and rest normals are those of its shape at rest. */
SBI_API void sbi_pairs_find_lips(sb_contact *contact);
/* 1: the two faces are of the two lips of one cut in one organ, not near its end. */
SBI_API int sbi_pairs_are_lips(const sb_contact *contact, int face, int other);

/* ---- contact_near.c ---- */
/* What is known of the organs at rest; a refit of the faces has to follow. Does nothing without pairs. */
SBI_API void sbi_pairs_measure(sb_contact *contact);
/* Where faces look, with nodes at x [rows]. */
SBI_API void sbi_pairs_look(sb_contact *contact, const sb_vec3 *x);
/* Ways of faces whose nodes go by dt v; v NULL: they stay. */
SBI_API void sbi_pairs_follow(sb_contact *contact, const sb_vec3 *v, sb_real dt);
/* How far two faces' points may come nearer to each other over the step (m). */
SBI_API sb_real sbi_pairs_closing(const sb_contact *contact, int face, int other);
/* 1: the two faces may touch, as far as organs and distances at rest go; and they look at each other, too. */
SBI_API int sbi_pairs_are_apart(const sb_contact *contact, int face, int other);
SBI_API int sbi_pairs_may_touch(const sb_contact *contact, int face, int other);
/* 1: their normals do. Of faces of two organs which may touch one may be a flank of an edge that comes into the other.
 */
SBI_API int sbi_pairs_face(const sb_contact *contact, int face, int other);
/* Unit normals out of the body where faces were looked at: of a face, and of the smooth surface at a point of it. */
SBI_API sb_vec3 sbi_pairs_face_normal(const sb_contact *contact, int face);
SBI_API sb_vec3 sbi_pairs_normal(const sb_contact *contact, int face, const sb_real *shares);
/* How high (m) above a face a sample may be that is paired with it, in any step; and a face's where this one begins:
 * only so high that it may touch at its end. */
SBI_API sb_real sbi_pairs_highest_ever(const sb_contact *contact, int other);
SBI_API sb_real sbi_pairs_highest(const sb_contact *contact, int face, int other);
/* 1: where the step begins the middle of the cell behind a face is not behind it. */
SBI_API int sbi_pairs_is_inside_out(const sb_contact *contact, int face);
/* 1 when a point is higher than that above a face, wherever beside it. */
SBI_API int sbi_pairs_is_above(const sb_contact *contact, int other, sb_vec3 at, sb_real most);
/* Marks faces that have others within `grow` (m) of their boxes, as those were refitted last. */
SBI_API void sbi_pairs_find_near(sb_contact *contact, sb_real grow, sbi_near_kind kind);
/* The first of them from `face` on, or -1. */
SBI_API int sbi_pairs_next_near(const sb_contact *contact, int face);
/* What a face may touch on its way from x to x + dt v (v NULL: at x), in pairs.found, ascending; returns how many. */
SBI_API int sbi_pairs_find_others(sb_contact *contact, int face, const sb_vec3 *x, const sb_vec3 *v, sb_real dt,
                                  sb_real grow);

/* Faces whose boxes meet [low, high] (m), in found [faces], but most of those of an organ (-1: of none); returns how
 * many. */
SBI_API int sbi_pairs_query_but(sb_contact *contact, int organ, sb_vec3 low, sb_vec3 high, int *found);
/* Faces whose boxes a face's way may meet, as it coasts, and more: all those within `grow` (m); in pairs.found. */
SBI_API int sbi_pairs_query(sb_contact *contact, int face, sb_real grow);
/* Notes the boxes of all that is marked in pairs.near. */
SBI_API void sbi_pairs_box_near(sb_contact *contact);
/* What holds a face's way in this step, as it coasts; and of one face, with that box of it, whether another may come
 * within pairs.reach of it. */
SBI_API sbi_pair_box sbi_pairs_way_box(const sb_contact *contact, int face);
SBI_API int sbi_pairs_comes(const sb_contact *contact, int face, const sbi_pair_box *own, int other);
/* All that does and may touch the face is in *list, with other faces; returns how many. The list may be pairs.found. */
SBI_API int sbi_pairs_find_coming(sb_contact *contact, int face, const int **list);
/* What is within `most` (m) of a face, and more, in pairs.found; returns how many. */
SBI_API int sbi_pairs_find_around(sb_contact *contact, int face, sb_real most);
/* 1 when no point of a face is within `most` (m) of a point where the step begins: by its ball and its plane. */
SBI_API int sbi_pairs_is_beyond(const sb_contact *contact, int face, sb_vec3 at, sb_real most);
/* Distance (m) that two faces surely keep, as do their middles; lower than 0: they may touch. */
SBI_API sb_real sbi_pairs_between(const sb_contact *contact, int face, int other);
/* Deepest overlap with a face at which a point is surely on this side of it (m). */
SBI_API sb_real sbi_pairs_deepest(const sb_contact *contact, int face);
/* Of a list of faces those that samples of a face have to do with, where the step begins and on their ways, in
 * pairs.related; returns how many. way: the face's box, which they come near as sbi_pairs_comes says, or NULL. */
SBI_API int sbi_pairs_find_related(sb_contact *contact, int face, const sbi_pair_box *way, const int *others,
                                   int count);

/* ---- contact_still.c ---- */
/* Faces near those of other organs where the step begins, or on its way, marked in pairs.near. */
SBI_API void sbi_pairs_renew_near(sb_contact *contact, const sbi_touch_step *step);
/* At the end of the step: 0 where points may have come near each other that were not looked at. */
SBI_API int sbi_pairs_foresaw(sb_contact *contact);
/* 1: no sample of a face has a partner in this step. */
SBI_API int sbi_pairs_is_still(const sb_contact *contact, int face);
/* None has one now: for how long is noted. Writes pairs.found and contact->scratch. */
SBI_API void sbi_pairs_let_be(sb_contact *contact, int face);

/* ---- contact_partner.c ---- */
/* Looks for partners of a face's samples: what is near it. Writes pairs.found and pairs.balls. */
SBI_API void sbi_pairs_begin_search(sb_contact *contact, const sbi_touch_step *step, int face, sbi_pair_search *search);
/* The partner of a sample of it at a place, on a way over the step (m): in search->best and closest. Writes
 * contact->scratch. */
SBI_API void sbi_pairs_find_partner(sbi_pair_search *search, sb_vec3 at, sb_vec3 way);

/* ---- contact_pairs.c ---- */
/* Pairs of the step; after those of tools are known. SB_ERROR_MEMORY: max_contacts are too few however thin. */
SBI_API sb_result sbi_pairs_begin(sb_contact *contact, const sbi_touch_step *step, sb_error *error);
SBI_API void sbi_pairs_forget(sb_contact *contact);
SBI_API void sbi_pairs_stiffen(sb_contact *contact);
/* Square of the norm of forces (N) that rounding makes of places this large (m). */
SBI_API double sbi_pairs_noise_square(const sb_contact *contact, double place);
/* As the calls of sbi_touch; forces and products are added. */
SBI_API void sbi_pairs_evaluate(sb_contact *contact, const sb_vec3 *du, int renew);
SBI_API void sbi_pairs_add_forces(sb_contact *contact, sb_vec3 *force);
SBI_API void sbi_pairs_multiply(const sb_contact *contact, const unsigned char *masked, const sb_vec3 *x, sb_vec3 *out);
SBI_API void sbi_pairs_add_blocks(sb_contact *contact, const unsigned char *masked, sb_matrix *matrix);
SBI_API void sbi_pairs_restore_blocks(sb_contact *contact, sb_matrix *matrix);
SBI_API double sbi_pairs_multiply_links(void *user, const unsigned char *masked, const sb_vec3 *x, sb_vec3 *out);
/* Parts a side: for the finest organ that it may touch, but no finer than half of its own, whose samples are there too.
 * thin: half as many, so many times. */
SBI_API int sbi_pairs_parts(const sb_contact *contact, int face, int thin);

/* ---- contact_within.c ---- */
/* 1 when a point is within an organ. Nodes are at x + way (way NULL: at x), and the faces' boxes hold them there.
 * Writes contact->scratch. */
SBI_API int sbi_pairs_is_within(sb_contact *contact, int organ, sb_vec3 at, const sb_vec3 *x, const sb_vec3 *way);
/* 1 when it is within any organ but this one, with nodes at x. */
SBI_API int sbi_pairs_is_within_others(sb_contact *contact, int organ, sb_vec3 at, const sb_vec3 *x);
/* A face near a point that the surface surrounds, and how far off it is along an axis (m); -1: it does not. Of a skin
 * that is open: where lines along all axes leave it. Nodes are at contact->x, and the faces' boxes hold them there.
 * Writes contact->scratch. Of a tool: its skeleton is surrounded. */
SBI_API int sbi_contact_surrounds(sb_contact *contact, sb_vec3 at, sb_real *distance);
SBI_API int sbi_contact_surrounds_tool(sb_contact *contact, const sbi_tool *shape, const sb_vec3 *chain,
                                       const sb_pose *pose, sb_real *distance);

/* ---- contact_apart.c ---- */
/* How deep (m) a point may lie behind a face at the end of a step. */
SBI_API sb_real sbi_pairs_safe_depth(const sb_contact *contact, int face);
/* 1 when a point of `face` that lies behind another is in the other's organ all around: no face of that, wherever it
 * looks, is nearer than `most` (m). Nodes are at x + way (way NULL: at x). */
SBI_API int sbi_pairs_is_inside(sb_contact *contact, int face, int other, sb_vec3 at, sb_real most, const sb_vec3 *x,
                                const sb_vec3 *way);
/* contact->moved and the faces' boxes, which are those of displacements u, become those of the step's end. */
SBI_API void sbi_pairs_set_ways(sb_contact *contact, const sb_vec3 *u);
/* 1: nothing has passed through on these ways. */
SBI_API int sbi_pairs_are_safe(sb_contact *contact);
/* As sbi_touch.mend. */
SBI_API int sbi_pairs_mend(sb_contact *contact, sb_vec3 *u, int whole);
/* As sbi_touch.brake, of what the last call of that has made one. */
SBI_API void sbi_pairs_brake_mended(sb_contact *contact, sb_vec3 *v);

/* ---- contact_hold.c ---- */
/* As sbi_touch.hold. */
SBI_API int sbi_pairs_hold(sb_contact *contact, sb_vec3 *u);
/* As sbi_touch.brake. */
SBI_API void sbi_pairs_brake_held(sb_contact *contact, const sb_vec3 *u, sb_vec3 *v);

/* ---- contact_pairs_keep.c ---- */
SBI_API void sbi_pairs_remember(sb_contact *contact);
SBI_API void sbi_pairs_remember_pressures(sb_contact *contact);
SBI_API void sbi_pairs_keep_pressures(sb_contact *contact, int fades);
SBI_API void sbi_pairs_keep_entries(sb_contact *contact);
/* Raises the two by those of pairs, see contact_step.c. */
SBI_API void sbi_pairs_measure_overlap(const sb_contact *contact, sb_real *overlap, sb_real *pushed);
SBI_API void sbi_pairs_add_done(const sb_contact *contact, sb_real factor, sb_vec3 *out);
/* The faces have other numbers: what goes is forgotten. */
SBI_API void sbi_pairs_follow_faces(sb_contact *contact);
SBI_API void sbi_pairs_read_point(const sb_contact *contact, int number, sb_contact_point *point);
SBI_API void sbi_pairs_add_pushes(const sb_contact *contact, sb_real *pushes); /* N, [nodes] */
#define SBI_PAIRS_PART "pairs"                                                 /* its name in its body's state */
SBI_API sb_result sbi_pairs_join_state(sb_contact *contact, sb_error *error);

/* ---- contact_keep.c ---- */
/* As the calls of sbi_touch. */
SBI_API size_t sbi_contact_kept_size(const void *user);
SBI_API int sbi_contact_keep(void *user, void *memory);
SBI_API int sbi_contact_rewind(void *user, const void *memory);
/* Room for a block of its own with the tools that there are. 0: no memory. */
SBI_API int sbi_contact_reserve_kept(sb_contact *contact);

/* ---- contact_step.c ---- */
/* What the body calls in its steps. */
SBI_API void sbi_contact_join(sb_contact *contact);

/* ---- contact_sample.c ---- */
/* Place of a node in the list of those in touch; of a skin, where its nodes in the body are listed, too. */
SBI_API int sbi_contact_place_node(sb_contact *contact, int node);
enum { SBI_CONTACT_CHUNK = 16 }; /* patches that one thread takes at a time */

/* An evaluation. renew: bounds of friction become those of here. */
typedef struct sbi_contact_work {
    sb_contact *contact;
    const sb_vec3 *du; /* by place (m) */
    int renew;
    int first, last; /* patches */
} sbi_contact_work;
/* Patches from work->first to work->last. Samples that cannot touch are left as they were. */
SBI_API void sbi_contact_evaluate_patches(sbi_contact_work *work);
/* The patches of a tool, at its pose of balance. */
SBI_API void sbi_contact_evaluate_tool(const sbi_contact_work *work, const sbi_contact_tool *tool);
/* What of a gap (m) is left for a sample to come nearer by: 0 where that says nothing, since distances to a tool rise
 * faster than ways, or a plane turns. */
SBI_API sb_real sbi_contact_clear(const sbi_contact_tool *tool, sb_real gap);
/* A sample as it was at the last evaluation, which may have left it out. */
SBI_API void sbi_contact_evaluate_again(sb_contact *contact, sbi_contact_sample *sample);
/* Gap (m) that no sample of a face has less of, to a tool at a pose; x: places of the face's nodes. */
SBI_API sb_real sbi_contact_clearance(const sbi_contact_faces *faces, int face, const sb_vec3 *x, const sbi_tool *shape,
                                      const sb_vec3 *chain, const sb_pose *pose);
/* The same with nodes at x [rows]. */
SBI_API sb_real sbi_contact_clearance_at(const sbi_contact_faces *faces, int face, const sb_vec3 *x,
                                         const sbi_tool *shape, const sb_vec3 *chain, const sb_pose *pose);

/* Stress (Pa) of a sample on the body. */
SB_INLINE sb_vec3 sbi_contact_stress(const sbi_contact_sample *s)
{
    return sb_v3_madd(s->answer.traction, s->answer.pressure, s->normal);
}

/* ---- contact_hung.c: tools on springs ---- */
SB_INLINE int sbi_contact_is_hung(const sbi_contact_tool *tool) { return tool->spring.stiffness > 0; }
/* The patches of the step are there. */
SBI_API void sbi_contact_begin_hung(sb_contact *contact);
/* All has been evaluated: tools on springs go to where they balance, and are evaluated there. */
SBI_API void sbi_contact_settle_hung(sb_contact *contact, const sbi_contact_work *work);
/* out -= what the stiffness loses since these tools give way, times x; both by place. */
SBI_API void sbi_contact_subtract_hung(const sb_contact *contact, const sb_vec3 *x, sb_vec3 *out);
/* 1: one of them went as far as it may at the last evaluation. */
SBI_API int sbi_contact_is_held(const sb_contact *contact);
/* Springs as they are now are those of a step or increment that is done; and these of all that is done. */
SBI_API void sbi_contact_keep_springs(sb_contact *contact);
SBI_API void sbi_contact_commit_springs(sb_contact *contact);

/* ---- contact_live.c ---- */
/* Arrays by face and node for the rooms that the faces have, in place of those there were. 0: no memory. */
SBI_API int sbi_contact_take_room(sb_contact *contact);
/* Follows its body's changes from now on; and no longer. */
SBI_API sb_result sbi_contact_listen(sb_contact *contact, sb_error *error);
SBI_API void sbi_contact_unlisten(sb_contact *contact);
/* Faces as the mesh is now, and entries of those that are still there. Allocates only where the whole mesh was another.
 * SB_ERROR_MEMORY, SB_ERROR_MESH: it is to be called again. */
SBI_API sb_result sbi_contact_update_faces(sb_contact *contact, sb_error *error);

/* ---- contact_tell.c ---- */
#define SBI_CONTACT_PART "contact" /* its name in its body's state */
enum { SBI_CONTACT_POSE_REALS = 7 };
SB_INLINE void sbi_contact_pack_vector(sb_vec3 v, sb_real *out) { out[0] = v.x, out[1] = v.y, out[2] = v.z; }
SB_INLINE void sbi_contact_pack_pose(const sb_pose *pose, sb_real *out)
{
    sbi_contact_pack_vector(pose->position, out);
    out[3] = pose->rotation.w, out[4] = pose->rotation.x, out[5] = pose->rotation.y, out[6] = pose->rotation.z;
}

/* What a recording keeps of calls: codes stand in files. */
typedef enum sbi_contact_command {
    SBI_CONTACT_ADD = 1,     /* cannot be played */
    SBI_CONTACT_REMOVE = 2,  /* likewise */
    SBI_CONTACT_MOVE = 3,    /* reals: pose */
    SBI_CONTACT_PLACE = 4,   /* reals: pose */
    SBI_CONTACT_BEND = 5,    /* reals: chain */
    SBI_CONTACT_FRICTION = 6 /* reals: mu */
} sbi_contact_command;
SBI_API void sbi_contact_tell(const sb_contact *contact, sbi_contact_command command, int tool, const sb_real *reals,
                              int count);
SBI_API void sbi_contact_tell_pose(const sb_contact *contact, sbi_contact_command command, int tool,
                                   const sb_pose *pose);

/* ---- contact_state.c ---- */
/* The face of a cell's side, or -1: keys ascend. */
SBI_API int sbi_contact_find_face(const sbi_contact_faces *faces, int element, int side);
/* The contact becomes a part of its body's state. SB_ERROR_MEMORY. And no longer; never having joined is fine. */
SBI_API sb_result sbi_contact_join_state(sb_contact *contact, sb_error *error);
SBI_API void sbi_contact_leave_state(const sb_contact *contact);

/* v without masked axes. */
SB_INLINE sb_vec3 sbi_contact_unmasked(unsigned axes, sb_vec3 v)
{
    return sb_v3(axes & SB_X ? 0 : v.x, axes & SB_Y ? 0 : v.y, axes & SB_Z ? 0 : v.z);
}

/* values += block without masked rows and columns. */
SB_INLINE void sbi_contact_add_block(sb_real *values, const sb_real *block, unsigned rows, unsigned columns)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            if (!(rows >> i & 1u) && !(columns >> j & 1u))
                values[3 * i + j] += block[3 * i + j];
}

/* out [rows] += factor times what a force is on the nodes of the body that acts on a face with weights of its nodes. */
SBI_API void sbi_contact_load_face(const sb_contact *contact, int face, const sb_real *weights, sb_real factor,
                                   sb_vec3 force, sb_vec3 *out);
/* The same of a sample. */
SBI_API void sbi_contact_load_sample(const sb_contact *contact, int face, int parts, int sample, sb_real factor,
                                     sb_vec3 force, sb_vec3 *out);
/* Where a sample of a face goes when the body's nodes go by x [rows]. */
SBI_API sb_vec3 sbi_contact_sample_motion(const sb_contact *contact, int face, int parts, int sample, const sb_vec3 *x);

/* Place of a sample with these weights. */
SBI_FORCE_INLINE sb_vec3 sbi_contact_mean_of(const sb_real *weights, const int *nodes, int count, const sb_vec3 *values)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int a = 0; a < count; a++)
        sum = sb_v3_madd(sum, weights[a], values[nodes[a]]);
    return sum;
}
/* The same; of triangles without a loop. */
SB_INLINE sb_vec3 sbi_contact_mean(const sb_real *weights, const int *nodes, int count, const sb_vec3 *values)
{
    return count == 3 ? sbi_contact_mean_of(weights, nodes, 3, values)
                      : sbi_contact_mean_of(weights, nodes, count, values);
}

#endif /* SB_CONTACT_PRIVATE_H */
