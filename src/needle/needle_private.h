/* needle_private: what is inside a needle, and what the needles of a body share. Floor 6, internal: needle_site.c is
 * what they share, needle_read.c reads them, needle_sleeve.c feeds and turns them, needle_bevel.c bends their ways,
 * needle_membrane.c is membranes, needle_resist.c the tissue's resistance, needle_tip.c leads the remesher after the
 * tip, needle_nodes.c renews the rod's nodes, needle_undo.c takes a step back, needle_state.c saves and records them,
 * needle_step.c makes a step, needle.c makes and ends needles. */
#ifndef NDL_NEEDLE_PRIVATE_H
#define NDL_NEEDLE_PRIVATE_H

#include "bed.h"
#include "couple_rows.h"
#include "needle.h"
#include "rod_private.h"
#include "rod_state.h"
#include "steer_path.h"
#include "track.h"
#include "../softbody/body/state_part.h"

enum { NDLI_TRACK_POINTS = 16 }; /* of a needle's track for each of its nodes */

/* How a needle is in tissue that does not hold it. */
typedef enum ndli_lost {
    NDLI_LOST_NOT = 0,
    NDLI_LOST_MESH = 1, /* the mesh has changed about it, and it is not out of that yet */
    NDLI_LOST_TORN = 2  /* of needles held by rows: it has torn out, and is not out of the tissue yet */
} ndli_lost;

typedef struct ndli_capsule {
    ndl_membrane def;
    sb_surface *surface; /* the faces between its regions in the undeformed tissue */
} ndli_capsule;

struct ndl_needle {
    sb_allocator allocator;
    struct ndli_site *site; /* what it shares with the other needles of its body */
    int index;              /* number at the remesher */
    ndl_rod *rod;
    ndli_line line;
    ndl_bevel bevel;
    ndl_friction *frictions;
    int friction_count;
    ndli_capsule *capsules;
    int capsule_count;
    ndl_cutting cutting_at;
    void *cutting_user;
    int max_trials;
    sb_real entry_slip;
    double edge_length; /* m, of nodes outside */

    ndli_v3 outlet, axis;                             /* the sleeve: rod node 1, and where edge 0 looks */
    int base_given;                                   /* 1: the sleeve shall be at given_... at the end of the step */
    ndli_v3 given_outlet, given_axis, given_director; /* director 0: not asked for */

    double fed, advance; /* m */
    ndli_v3 heading;     /* unit vector in the material: where the path cut so far looks at the tip. The last edge is a
                          * chord of it, which lags behind by an angle that remeshing changes */
    ndli_v3 aside;       /* m in the material: of a shallow tip, how far its way has bent from the straight one */
    double wave;         /* m: length of the bends that the tissue makes of the shaft */
    ndli_v3 base_force, base_torque; /* N, N m about the outlet */
    int shallow;      /* 1: the tip is in the tissue, but less than about half an edge: only its entry has a node
                       * there. Tets between such a tip and the skin would be flat */
    int *path;        /* [capacity] tissue nodes of rod nodes line.first .. */
    ndli_v3 *gap;     /* [capacity] m: how far rod nodes are from these, with which they move: the mesh may not be
                       * able to have a node where the needle is, and a shaft that were drawn to it would make
                       * forces that no tissue makes */
    int enters;       /* in the present substep 1: its entry is new */
    int sinks;        /* and 1: its nodes below it are */
    int reaches;      /* and 1: its tip's node has come to where the tip is */
    ndli_v3 landing;  /* m: where the tip of one that sinks is in space */
    double radius;    /* m */
    ndli_track track; /* of a needle that is held by rows, as what follows */
    int lost;         /* an ndli_lost */
    double entering;  /* m of the edge before its first node in the tissue that are in it */
    double *arc;      /* [capacity] m at rest: where on it nodes in the tissue are */
    struct ndli_hold *holds; /* [capacity] the line's */
    double *stretch;         /* [capacity] of the tissue along it there, in the present substep */
    int pushed;              /* 1: the present substep's command takes the needle forward */
    int blocked, limited;    /* in the present step */
    int hold_steps;          /* substeps for which the tip is held because the remesher could not follow it */

    /* holds nothing between calls */
    ndli_v3 side;                     /* in which the bevel looked at the start of the substep */
    ndli_v3 *places, *place_tangents; /* [capacity] new nodes of the rod */
    ndli_v3 *old_contact;             /* [capacity] */
    int *old_path;                    /* [capacity] */
    ndli_v3 *old_gap;                 /* [capacity] */
    sb_vec3 *old_X;           /* [capacity] m: of the path's nodes before the mesh followed the tip, once it has */
    int follows;              /* 1: it has */
    unsigned char *old_state; /* [capacity] */
    void *memory;
};

/* Whose start a state is kept of. */
typedef enum ndli_keeping {
    NDLI_KEPT_STEP = 0,
    NDLI_KEPT_SUBSTEP = 1, /* one before which the mesh has changed in its step */
    NDLI_KEPT_COUNT = 2
} ndli_keeping;

/* A state of a body, its remesher and its needles in one block, which holds nothing between steps. */
typedef struct ndli_kept {
    unsigned char *bytes;
    size_t room, body;      /* bytes; those of the body's state at its begin */
    sbi_snapshot_held held; /* what that has from the step before */
} ndli_kept;

/* What the needles of one body share; made for the first, gone with the last. */
struct ndli_site {
    sb_body *body;
    sb_allocator allocator;
    int listener; /* its number at the body */
    int embeds;   /* 1: it has a bed, its needles are held by rows; 0: it has a remesher */
    ndli_bed bed;
    ndli_bed next_bed; /* of a state that is being loaded, where it is another */
    ndl_remesh *remesh;
    const ndli_topology *mesh;            /* the remesher's */
    ndl_needle *needles[NDL_MAX_NEEDLES]; /* by index; NULL: free */
    int count;
    double mean_edge; /* of the undeformed mesh (m) */
    int *coupled;     /* [coupled_room] nodes of the body that needles are on, of a solve */
    size_t coupled_room;
    int coupled_count; /* with a bed, as what follows */
    int *node_place;   /* [slots of nodes] their numbers in `coupled`, -1 between solves */
    size_t place_room;
    double *unknown; /* [NDLI_LINE_UNKNOWNS node_room] of a solve */
    size_t node_room;
    ndli_kept kept[NDLI_KEPT_COUNT]; /* states to go back to; see needle_undo.c */
    int undo_waits;                  /* 1: a failed step is still to be taken back, which wants memory */
};

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- needle_site ---- */

/* Listens to changes of the body's mesh, if that can change. */
NDLI_API sb_result ndli_site_listen(struct ndli_site *site, sb_error *error);
NDLI_API void ndli_site_free(struct ndli_site *site);
NDLI_API double ndli_site_mean_edge(const ndli_topology *mesh); /* m */
/* Others have changed the mesh: needles are outside of it; and what is known of it is made anew. */
NDLI_API int ndli_site_is_stale(const struct ndli_site *site);
NDLI_API sb_result ndli_site_create_bed(const struct ndli_site *site, ndli_bed *bed, sb_error *error);
NDLI_API sb_result ndli_site_look(struct ndli_site *site, sb_error *error);
/* Once the body may have more nodes. 0: there is no memory. */
NDLI_API int ndli_site_reserve_places(struct ndli_site *site);
NDLI_API int ndli_site_free_index(const struct ndli_site *site);
/* Room for the nodes of all needles and so many more; 0: there is no memory. */
NDLI_API int ndli_site_reserve(struct ndli_site *site, int more);

/* ---- needle_read ---- */

/* What a region does to a needle, or NULL. */
NDLI_API const ndl_friction *ndli_needle_friction(const ndl_needle *needle, int region);

/* ---- needle_sleeve ---- */

/* Targets of the nodes in the sleeve, turn and feed of a substep of dt, which is `share` of what is left of the step.
 */
NDLI_API void ndli_needle_aim(ndl_needle *needle, const ndl_command *command, double dt, double share);
/* How far the base's m1, carried with its edge to `axis`, is from the given director (rad). */
NDLI_API double ndli_needle_given_turn(const ndl_needle *needle, ndli_v3 axis);

/* ---- needle_bevel ---- */

NDLI_API double ndli_bevel_curvature(const ndl_bevel *bevel); /* 1/m, of a way in rigid tissue */
/* Before a substep: from where its bevel turns. */
NDLI_API void ndli_bevel_begin(ndl_needle *needle);
/* 1: a needle that its mesh follows is bent by more than soft tissue holds; how far depends on the mesh. */
NDLI_API int ndli_bevel_is_coarse(const ndl_needle *needle);
NDLI_API double ndli_bevel_lag(const ndl_bevel *bevel); /* rad: how far a way may be from the shaft's direction */
/* Direction of the shaft at its tip (unit). heading: of the way; chord: of what is cut along the shaft's last edge. */
NDLI_API ndli_v3 ndli_bevel_shaft(const ndl_needle *needle, ndli_v3 heading, ndli_v3 chord);
/* After a substep: *heading (unit, in space) turns as the tip advances (m, > 0), but stays within `lag` (rad) of the
 * shaft; returns the tip's way. */
NDLI_API ndli_v3 ndli_bevel_go(const ndl_needle *needle, double advance, ndli_v3 shaft, double lag, ndli_v3 *heading);

/* ---- needle_held: of needles that are held by rows ---- */

/* Makes the holds, and what the tissue does at them; their nodes are listed at the site. */
NDLI_API void ndli_held_resist(ndl_needle *needle);
/* The list is empty again: before a step's needles are made ready. */
NDLI_API void ndli_held_forget(struct ndli_site *site);
/* After a substep: the tip enters, goes on, or back. What cannot be done holds it. */
NDLI_API void ndli_held_follow_tip(ndl_needle *needle);
/* It is outside. */
NDLI_API void ndli_held_leave(ndl_needle *needle);
/* Length (m) of the bends that a side load makes of a needle of that stiffness (N m^2) and radius (m) in tissue of such
 * a modulus (Pa): (4 EI / k)^(1/4). */
NDLI_API double ndli_held_wave(double bending, double radius, double young, double guess);

/* ---- needle_membrane ---- */

/* 0: a membrane between regions that do not meet (*bad is its number), or no memory (*bad -1). */
NDLI_API int ndli_needle_make_capsules(ndl_needle *needle, const ndl_membrane *membranes, int count, int *bad);
/* What cutting at X takes (N), where the tissue takes `tissue`. */
NDLI_API double ndli_needle_cut_membranes(const ndl_needle *needle, sb_vec3 X, double tissue);
/* Share of a substep of dt (s) at which the tip comes to where what they add changes, or a little more; 1: nowhere but
 * at its very end. Of one that is solved, with the rod moved, before the tip is followed: there the body's mesh is
 * still what it was. */
NDLI_API double ndli_needle_share_to_edge(const ndl_needle *needle, double dt);

/* ---- needle_resist ---- */

/* Force (N) to cut at X of a region, `table` its friction's. */
NDLI_API double ndli_needle_cutting_at(const ndl_needle *needle, sb_vec3 X, int region, double table);

/* Friction of the line's nodes and edges, and what the tip has to cut, where they are now. */
NDLI_API void ndli_needle_resist(ndl_needle *needle);

/* ---- needle_tip ---- */

/* Where a tip looks in space: where its path goes on, where that is known better than by the last edge. */
NDLI_API ndli_v3 ndli_needle_heading(const ndl_needle *needle);
/* After a substep: the tip enters, goes on, or back; needle->advance says how far. What could not be done holds the tip
 * and is no failure, but for SB_ERROR_UNSUPPORTED: another needle's element is in the way. */
NDLI_API sb_result ndli_needle_follow_tip(ndl_needle *needle, ndl_remesh_info *done, sb_error *error);

/* ---- needle_nodes ---- */

/* 1 when the rod's nodes are at those of its path. */
NDLI_API int ndli_needle_is_threaded(const ndl_needle *needle);

/* Once the remesher has followed the tip: the rod's nodes on those of its path, and about as many outside as should be.
 * Friction states go with them. Returns -1, the node at which the rod is folded, or the rod's capacity when that is too
 * little: then it has its old nodes. */
NDLI_API int ndli_needle_renew_nodes(ndl_needle *needle);

/* ---- needle_state ---- */

/* What the ints of a command in a recording begin with. */
typedef enum ndli_needle_command {
    NDLI_COMMAND_STEP = 1,        /* and the number of needles and their indices; dt, then each needle's ndl_command */
    NDLI_COMMAND_BASE = 2,        /* and the needle; base, direction, director */
    NDLI_COMMAND_NEEDLE_MADE = 3, /* and the needle */
    NDLI_COMMAND_NEEDLE_GONE = 4
} ndli_needle_command;
enum { NDLI_COMMAND_REALS = 8 }; /* of an ndl_command */

/* The part of the body's state that the site is, but for its replay. */
NDLI_API sbi_state_part ndli_site_part(struct ndli_site *site);
/* What the needles of a body share, by the part's name; NULL: it has none. */
NDLI_API struct ndli_site *ndli_needle_site(const sb_body *body);
NDLI_API void ndli_site_leave(const struct ndli_site *site);
/* For the recording of the body. */
NDLI_API void ndli_needle_tell_life(const ndl_needle *needle, ndli_needle_command command);
NDLI_API void ndli_needle_tell_base(const ndl_needle *needle, sb_vec3 base, sb_vec3 direction, sb_vec3 director);
NDLI_API void ndli_needle_tell_step(const struct ndli_site *site, ndl_needle *const *needles, int count, sb_real dt,
                                    const ndl_command *commands, sb_result result);

/* ---- needle_step ---- */

/* Does a recorded command again; user: the site. */
NDLI_API sb_result ndli_needle_replay(void *user, const int *ints, size_t int_count, const sb_real *reals,
                                      size_t real_count, sb_error *error);

/* ---- needle_undo ---- */

/* Memory for all that steps keep, with one more needle than there are unless NULL, while the mesh keeps to its slack;
 * 0: there is none. */
NDLI_API int ndli_needle_reserve_undo(struct ndli_site *site, const ndl_needle *more);
/* Keeps what a step changes of a body and its needles. Takes memory where the mesh has outgrown its slack; 0: there is
 * none. */
NDLI_API int ndli_needle_keep(struct ndli_site *site, ndli_keeping which);
/* Brings it back. SB_ERROR_MEMORY, where the mesh has changed since: nothing has changed, and undo_waits is set. */
NDLI_API sb_result ndli_needle_undo(struct ndli_site *site, ndli_keeping which, sb_error *error);
/* The same where it waits; else does nothing. */
NDLI_API sb_result ndli_needle_finish_undo(struct ndli_site *site, sb_error *error);
/* Where the body has got another mesh since the last step: needles are outside, whatever they were in.
 * SB_ERROR_MEMORY. */
NDLI_API sb_result ndli_needle_look(struct ndli_site *site, sb_error *error);
#endif

#endif /* NDL_NEEDLE_PRIVATE_H */
