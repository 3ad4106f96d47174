/* contact_pairs: organs that touch each other, or themselves. Internal: a part of sb_contact, without memory and at
 * rest where def.pairs is 0.
 *
 * An organ is a connected part of the mesh. Faces that look at each other and are near (contact_near.c) have samples as
 * they have for tools; each is paired for the step with the nearest point of the faces that it looks at, y = sum v_b
 * x_b, whose normal is smooth over the surface (contact_closest.c). Between the two acts the law of tools, with weights
 * (w, -v), so that forces balance to the last bit. Both sides have samples, with half of their areas each. Where a cell
 * behind a face is inside out there is no friction: organs that a blow has crumpled would hold each other so.
 *
 * Blocks of one side, w w^T K and v v^T K, have places in the matrix. Those across, -w v^T K, have none: conjugate
 * gradients multiply by them beside it. Pairs, weights and normals stay over a step.
 *
 * On a skin (contact_skin.h) faces are its triangles and nodes its points; organs are those of the cells that these lie
 * in. The two lips of a cut in one organ touch from the start (contact_lips.c). What takes motion out of a step does so
 * of the body's nodes. */
#ifndef SB_CONTACT_PAIRS_H
#define SB_CONTACT_PAIRS_H

#include "../base/lanes.h"
#include "../body/step_touch.h"
#include "contact_faces.h"
#include "contact_law.h"

/* A face near others, with its samples. */
typedef struct sbi_pair_patch {
    int face, parts, first, count, touching;
    int nodes[SB_MAX_FACE_NODES]; /* places in the contact's list of nodes */
} sbi_pair_patch;

/* A sample x of a face, and the point y of another that it is paired with. */
typedef struct sbi_pair_sample {
    int patch, face, sample;
    int other;                          /* face of y */
    int other_nodes[SB_MAX_FACE_NODES]; /* places */
    const sb_real *weights;             /* w */
    sb_real shares[SB_MAX_FACE_NODES];  /* v */
    sb_real area, spacing;              /* m^2 at rest: half of what the sample stands for; m, its own */
    sb_real k, memory;                  /* Pa/m; l (Pa) */
    sb_vec3 remembered;                 /* t (Pa) */
    sb_real friction;                   /* mu */
    sb_vec3 normal, start;              /* out of the other face; x - y at the start of the step (m) */
    sb_vec3 point;                      /* x (m) */
    sb_real left;                       /* gap (m, <= 0) up to which overlap of the start is not pushed out */
    sb_real gap, slip, bound;           /* m, m, Pa */
    sbi_contact_answer answer;
} sbi_pair_sample;

/* K of a sample across its two faces, as the system has it: factor (normal n n^T + tangent (I - n n^T - d d^T)). */
typedef struct sbi_pair_link {
    int sample;
    sb_real normal, tangent; /* N/m */
    sb_vec3 n, d;
} sbi_pair_link;

/* Vectors of nodes in products with links: as lanes where there are any. */
#if SBI_HAS_LANES
typedef sbi_lanes sbi_pair_vector;
#else
typedef sb_vec3 sbi_pair_vector;
#endif

/* What was in touch at the end of the last step. */
typedef struct sbi_pair_entry {
    int face, parts, sample, other, sticks;
    sb_real gap, area; /* m, m^2 at rest: half of the sample's */
    sb_real left;      /* m: see sbi_pair_sample */
    sb_real shares[SB_MAX_FACE_NODES];
    sb_vec3 traction, point, normal, force;
    uint64_t names[2]; /* of the triangles of a skin, while they wait for those (sbi_contact_skin) */
} sbi_pair_entry;

/* What a corner of faces remembers, see contact_memory.c. */
typedef struct sbi_pair_pressure {
    int node;
    sb_real value; /* l_a (Pa), > 0 */
} sbi_pair_pressure;

enum { SBI_PAIR_CORNERS = 4 }; /* of a face at most */

/* In lengths of a face: how far a sample may lie beside the point it is paired with. */
#define SBI_PAIR_BESIDE ((sb_real)1e-3)
/* The way from y to x may lean against the normal so far, as faces of a coarse curved surface make it; and where it
 * goes into the other organ, whose nearest point then lies within a face, or is none of this way at all. */
#define SBI_PAIR_LEAN ((sb_real)0.7)
#define SBI_PAIR_LEAN_INSIDE ((sb_real)0.02)
/* Of a face's length: overlap deeper than this is looked at from all sides. */
#define SBI_PAIR_DEEP ((sb_real)0.1)
/* Faces whose normals have a product below this do not look the same way. */
#define SBI_PAIR_TURNED ((sb_real)0.5)
/* What lies so far behind a face lies no farther beside it, in these, than what leans by that: sqrt(1 / 0.5^2 - 1). */
#define SBI_PAIR_SLANTED ((sb_real)1.7330)

/* Faces found near one whose samples are to be paired: that may hold one where the step begins; that one may be behind;
 * that one may come to on its way. */
enum { SBI_PAIR_HOLDERS = 0, SBI_PAIR_BACKS = 1, SBI_PAIR_COMERS = 2, SBI_PAIR_LISTS = 3 };

/* A face where the step begins: no point of it is farther from the middle than the radius, nor higher above or below
 * the plane through that than the bulge (m; 0: flat). What is asked of a face lies side by side, since faces are asked
 * for in no order. */
typedef struct sbi_pair_plate {
    sb_vec3 middle, normal; /* m; unit, or 0 where the face has no area */
    sb_real radius, bulge;
} sbi_pair_plate;

/* Faces that are asked side by side, in loops of known length without branches, which compilers make vectors of. */
enum { SBI_PAIR_SIDE = 8 };
#define SBI_PAIR_EACH_SIDE(l) SBI_EACH_LANE(l, SBI_PAIR_SIDE)

/* Faces in such lists: a sample farther from one than `most` has nothing to do with it, nor has one higher above it
 * than `highest` or lower than `deepest`, both with what rounding makes of it; in a step it goes as far as `goes` at
 * most (m). */
typedef struct sbi_pair_balls {
    sb_real middle[3][SBI_PAIR_SIDE], normal[3][SBI_PAIR_SIDE], radius[SBI_PAIR_SIDE], bulge[SBI_PAIR_SIDE];
    sb_real most[SBI_PAIR_SIDE], highest[SBI_PAIR_SIDE], deepest[SBI_PAIR_SIDE], goes[SBI_PAIR_SIDE];
    sb_real rounded[SBI_PAIR_SIDE];
    sb_real out_of[SBI_PAIR_LISTS][SBI_PAIR_SIDE]; /* 0 of a face in a list, else 1 */
    int face[SBI_PAIR_SIDE];
} sbi_pair_balls;

/* The sample at hand to each of them: how high it is above the plane (lower than 0: behind), and the squares of how far
 * it is from the middle, and beside that across the normal (m, m^2). */
typedef struct sbi_pair_picks {
    sb_real height[SBI_PAIR_SIDE], square[SBI_PAIR_SIDE], beside[SBI_PAIR_SIDE];
    sb_real off[SBI_PAIR_SIDE]; /* > 0: it has nothing to do with the face */
} sbi_pair_picks;

/* A face that samples of another have to do with: the lists that it is in, as bits, and how high above it one may be
 * that is in that of holders (m). */
typedef struct sbi_pair_related {
    int other, lists;
    sb_real highest;
} sbi_pair_related;

/* Smallest and largest, of the unit normals below a box of the tree. */
typedef struct sbi_pair_cone {
    float low[3], high[3];
} sbi_pair_cone;

/* What a face's way lies in (m). */
typedef struct sbi_pair_box {
    sb_vec3 low, high;
} sbi_pair_box;

/* Which faces near each other count: those of two organs; that look at each other, too; whose samples can be paired. */
typedef enum sbi_near_kind { SBI_NEAR_ANY, SBI_NEAR_LOOKING, SBI_NEAR_PAIRED } sbi_near_kind;

typedef enum sbi_zones { SBI_ZONES_NONE, SBI_ZONES_NODES, SBI_ZONES_ORGANS } sbi_zones;

enum { SBI_STILL_LISTED = 24 }; /* faces near a face, in the mean of all that there are */

/* What need not be looked for anew while nodes have gone little since it was, see contact_still.c. What it leaves out
 * has no partner: results are those without it. */
typedef struct sbi_pairs_still {
    int known;               /* 0: nothing is */
    sb_vec3 *seen;           /* [nodes] where the last step began */
    sb_real gone;            /* m: as far as faces may have gone in all since `near` was made */
    sb_real last;            /* m: in the last step alone */
    sb_real ahead;           /* m: in this step, as it coasts: */
    sb_real *closed;         /* [organs] m: by how much its points and others' may have come nearer since then in all */
    sb_real *closing;        /* [organs + 1] m: in the last step alone */
    sb_real *coasting;       /* [organs + 1] m: in this step, as they coast */
    sb_real dt;              /* s, with: */
    const sb_vec3 *velocity; /* [rows] */
    sb_real farthest;        /* m: nothing that is farther from a face is paired with it in this step */
    uint64_t *near;          /* faces which were then near others */
    uint64_t *boxed;         /* faces with a box: */
    sbi_pair_box *boxes;     /* [faces] their ways in this step, as they coast */
    sb_real *until;          /* [faces] closed + farthest (m) up to which no sample has a partner, of those that are not
                              * thinned */
    signed char *tired;      /* [faces] times that it is not asked for */
    int *listed;             /* [faces] what is near one as long as `near` is, in `list` from here on; -1: not listed */
    int *listed_count;       /* [faces] */
    int *list;               /* [SBI_STILL_LISTED faces] */
    int list_count;
} sbi_pairs_still;

/* Which faces of a skin are lips, see contact_lips.c. */
typedef struct sbi_pair_lips {
    int *twins;          /* [faces] the face on the other lip at the same place; -1: it is no lip */
    int *sheets, *cuts;  /* [faces] least face of the sheet and of the cut that a face belongs to; -1: likewise */
    unsigned char *rims; /* [faces] 1: so near the end of a cut that the other lip is none of its own */
    unsigned char *ends; /* [nodes] of points near one */
} sbi_pair_lips;

typedef struct sbi_pairs {
    int kinds; /* SB_CONTACT_SELF | SB_CONTACT_ORGANS; 0: none of all this is there */
    sb_real friction, distance;

    /* of the mesh at rest, by face and by node: arrays for the rooms of the faces */
    int *organs;            /* of each face */
    sb_real *thickness;     /* m behind the face's middle, no more than it matters */
    sb_vec3 *centres;       /* m */
    sb_vec3 *rest_normals;  /* out of the body */
    sb_real *organ_lengths; /* [nodes] mean length of an organ's faces (m) */
    int *organ_counts;      /* [nodes] */
    int *node_organs;       /* [nodes] of a face's; organ_count: of none, or of faces of several */
    int organ_count;
    sbi_pair_lips lips;            /* of a skin that touches itself */
    int *first_face, *around;      /* [nodes + 1], faces of each node */
    sb_real longest, shortest;     /* of organ_lengths */
    sb_real longest_face;          /* m */
    sb_real longest_curved;        /* m: of those that are, else 0 */
    sb_real farthest;              /* m: nothing in front of any face that is farther from it is paired with it */
    sb_real reach;                 /* m: boxes this near are looked at */
    sb_real leeway;                /* m: how much nearer than by coasting two points may come in this step unseen */
    sbi_pair_cone *cones;          /* by the tree's boxes; of this step: */
    int cones_known;               /* 1: a walk has asked for them */
    int *first_organ, *last_organ; /* likewise */
    sb_vec3 *box_low, *box_high;   /* m, by the tree's places: of the walk at hand */

    /* of the step, likewise by face */
    sb_vec3 *vectors;             /* across each face, twice its area long (m^2), where the step begins */
    sbi_pair_plate *plates;       /* there */
    sb_vec3 *corner_normals;      /* [faces][SBI_PAIR_CORNERS] of the smooth surface, where corners_known has a bit */
    unsigned char *corners_known; /* bits of corners */
    sb_vec3 *ways;                /* m, over the step: no point of the face goes otherwise by more than: */
    sb_real *spreads;             /* m */
    uint64_t *near;               /* a bit for each face that is near one that it looks at */
    sbi_pairs_still still;        /* what is known of steps before */
    int *found;
    sbi_pair_related *related; /* [faces] of those that a face may come near */
    sbi_pair_balls *balls;     /* [sbi_pairs_sides] what samples of the face at hand need to look at */
    sbi_pair_picks *picks;     /* [sbi_pairs_sides] of these, for the sample at hand */
    int *slot_of;              /* -1 between steps */
    int *zones;         /* [nodes] what moves as one, see contact_apart.c: a node of it, -1: this one moves by itself */
    sb_vec3 *node_ways; /* [nodes] ways of the body's nodes over the step (m), while they are mended */
    sbi_zones zones_made;                         /* by what was mended in this step */
    sb_vec3 *zone_ways, *zone_masses, *zone_held; /* [nodes] sums of a zone */

    sbi_pair_patch *patches;
    int patch_count, patch_room;
    sbi_pair_sample *samples; /* [max_contacts] */
    int sample_count;
    sb_real foreseen; /* overlap at the end of the step without contact, of what is safe: the largest */
    sb_real straying; /* m: how far from coasting a node went at most, at the last look at the step's end */
    int *active;      /* [max_contacts] those that touch */
    int active_count;
    sb_real *region_sum; /* [regions] */
    int *region_count;
    int *slots; /* [slot_room] faces with blocks */
    int slot_count, slot_room;
    sb_real (*blocks)[9];     /* [slot_room][width^2] */
    unsigned char *slot_used; /* [slot_room] 1: something touches there, the blocks are not 0 */
    struct sbi_contact_saved *saved;
    int saved_count;
    sbi_pair_link *links; /* [max_contacts] of the system */
    int link_count;
    int *link_nodes, link_node_count;    /* [nodes] those of the system by place */
    sbi_pair_vector *link_in, *link_out; /* [nodes] by place, of a product */

    /* of the last step */
    sb_real strayed; /* m: straying in it */
    sbi_pair_entry *entries, *spare;
    int entry_count;
    int waiting;                                    /* of a skin: as sbi_contact_skin.waiting */
    sbi_pair_pressure *pressures, *spare_pressures; /* [corners max_contacts] */
    int pressure_count;
} sbi_pairs;

/* A point of a face. */
typedef struct sbi_closest {
    sb_real shares[SB_MAX_FACE_NODES]; /* of the face's nodes */
    sb_vec3 point;
} sbi_closest;

/* Blocks of faces side by side that hold so many. */
SB_INLINE int sbi_pairs_sides(int faces) { return faces / SBI_PAIR_SIDE + (faces % SBI_PAIR_SIDE != 0); }

/* A face whose samples are to be paired, and the one at hand while its partner is looked for. */
typedef struct sbi_pair_search {
    struct sb_contact *contact;
    const sbi_touch_step *step;
    int face;
    sbi_pair_box box;  /* of its way in this step */
    const int *coming; /* faces among which are all that it may come near */
    int coming_count;
    int listed;      /* how many of them are in pairs->balls */
    int first;       /* a face: is likely to be the nearest; -1: nothing is known */
    int first_place; /* its place in pairs->balls; -1: it is not there */
    int slips;       /* 1: the face has no friction in this step */
    sb_vec3 at, way; /* m: at the start; over the step, as it coasts */
    int best;        /* -1: none */
    sb_real measure;
    int nearest; /* face whose point is nearest, whether or not it may be paired with; -1: none */
    sb_real nearest_away, nearest_height;
    int within_organ, within; /* whether the sample lies in this organ; -1: none was asked for */
    sbi_closest closest;
} sbi_pair_search;

/* ---- contact_closest.c ---- */
/* The point of a face with its nodes at x that is nearest to p. */
SBI_API void sbi_closest_on_face(const sbi_contact_kind *kind, const sb_vec3 *x, sb_vec3 p, sbi_closest *closest);
/* Triangles that stand for a face, and corner k of one as a node of the face. */
SBI_API int sbi_closest_part_count(const sbi_contact_kind *kind);
SBI_API int sbi_closest_part_node(const sbi_contact_kind *kind, int part, int k);
/* When (a share of the step) p, on its way to p + q, comes to the back of a triangle x whose corners go on ways v, from
 * its front; < 0: it does not. *depth: how far it is behind the triangle's plane at the end (m). */
SBI_API sb_real sbi_closest_meeting(const sb_vec3 *x, const sb_vec3 *v, sb_vec3 p, sb_vec3 q, sb_real *depth);
/* Distance of p in front of a triangle's plane; 0 for one without area. */
SBI_API sb_real sbi_closest_height(const sb_vec3 *x, sb_vec3 p);

#endif /* SB_CONTACT_PAIRS_H */
