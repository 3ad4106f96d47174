/* rod_private: what is inside a rod. Floor 6, internal: rod.c keeps it, rod_force.c reads forces from it, rod_step.c
 * moves it; rooms above couple it to tissue and change its nodes.
 *
 * State: x, v, a, director, theta. The directors d_j are a Bishop frame: each is its predecessor carried over by
 * parallel transport, so that the twist at node i is theta_i - theta_i-1. Within a step each edge carries its
 * director with itself instead (that keeps derivatives local); the reference twist that then arises between
 * neighbours is folded into theta when the step is taken (ndli_rod_moved). */
#ifndef NDL_ROD_PRIVATE_H
#define NDL_ROD_PRIVATE_H

#include "real3.h"
#include "rod.h"

/* Geometry of a rod in a shape that is tried: all that energies and their derivatives are made of. */
typedef struct ndli_rod_shape {
    ndli_v3 *tangent;  /* [edges] */
    double *length;    /* [edges] (m) */
    ndli_v3 *director; /* [edges] the state's, carried along with the edge */
    ndli_v3 *m1, *m2;  /* [edges] */
    ndli_v3 *binormal; /* [nodes] kb; inner nodes only */
    double *chi;       /* [nodes] 1 + t.t' */
    double *twist;     /* [nodes] (rad) */
    double *reference; /* [nodes] (rad) of it, what the directors make */
    double *lag;       /* [edges] (rad) how far the surroundings' springs are wound */
} ndli_rod_shape;

/* Second derivatives of the energy, lower half. Blocks of node i with nodes i, i - 1, i - 2. */
typedef struct ndli_rod_matrix {
    ndli_m3 (*node)[3];  /* [nodes] (N/m) */
    ndli_v3 (*cross)[4]; /* [edges] theta_j with nodes j - 1 .. j + 2 (N/rad) */
    double *turn;        /* [edges] theta_j with itself (N m) */
    double *turn_before; /* [edges] theta_j with theta_j-1 */
} ndli_rod_matrix;

struct ndl_rod {
    sb_allocator allocator;
    void *memory; /* the one block behind the arrays */
    int capacity;
    int node_count;
    double stretch, bending[2], torsion, line_density; /* N, N m^2, N m^2, kg/m */
    int plain; /* 1: isotropic and straight at rest, so that bending does not see the material frames */
    ndli_v3 gravity;
    double damping_stretch, damping_bending; /* s */
    int max_newton;
    double tolerance;

    ndli_v3 *x, *v, *a; /* [nodes] */
    ndli_v3 *director;  /* [edges] */
    double *theta;      /* [edges] (rad) material frame from the director, about the tangent; whole turns count */
    ndli_v3 *tangent;   /* [edges] of x */

    double *rest_length;    /* [edges] (m) */
    double (*rest_bend)[2]; /* [nodes] integrated rest curvature (2 tan of half the turn) towards m1 and m2; a density
                             * is this over the cell */
    double *mass;           /* [nodes] (kg) */
    double *cell;           /* [nodes] (m) length that bends at an inner node: half of both edges, of one at a clamp */

    unsigned char *held;         /* [nodes] */
    ndli_v3 *target;             /* [nodes] where held nodes will be, */
    ndli_v3 *target_velocity;    /* [nodes] with this velocity */
    unsigned char *has_velocity; /* [nodes] 1: target_velocity was given */
    unsigned char *turn_held;    /* [edges] */
    double *turn;                /* [edges] (rad) still to turn in the next step */
    int base_director_set;       /* 1: the base shall be turned so that its m1 becomes base_director */
    ndli_v3 base_director;
    ndli_v3 *force;            /* [nodes] dead loads (N) */
    double *torque;            /* [edges] (N m) */
    int grips;                 /* edges with a grip */
    double *grip, *grip_limit; /* [edges] the surroundings' grip: N m/rad; N m */
    double *anchor;            /* [edges] (rad) theta at which that spring is not wound */
    ndli_v3 *reaction;         /* [nodes] */
    double *reaction_torque;   /* [edges] */

    sb_vec3 *public_x, *public_v, *public_reaction; /* [nodes] what readings return */

    int energy_monitored; /* 1: energy_before is the energy (J) when supports or loads last changed */
    double energy_before;

    /* what follows holds nothing between calls */
    double viscous_stretch,
        viscous_bend;      /* within a step: damping time over dt, of strains measured from those below */
    double *old_length;    /* [edges] (m) */
    ndli_v3 *old_binormal; /* [nodes] */
    double (*old_bend)[4]; /* [nodes] curvature in the frame of the edge before, of the edge after */
    ndli_rod_shape shape;
    ndli_rod_matrix matrix;
    ndli_v3 *gradient;                           /* [nodes] */
    double *turn_gradient;                       /* [edges] */
    ndli_v3 *try_x, *best_x, *step_x;            /* [nodes] */
    double *try_theta, *best_theta, *step_theta; /* [edges] */
    ndli_v3 *predicted; /* [nodes] where inertia alone takes free nodes; targets of held ones */
    ndli_m3 *damping_before, *damping_after,
        *damping_weight;      /* [nodes] d kb/d e_i-1, d kb/d e_i, tau times stiffness */
    ndli_v3 *damping_tangent; /* [edges] */
    double *band;             /* [4 nodes][NDLI_ROD_WIDTH + 1] */
    double *unknown;          /* [4 nodes] */
    ndli_v3 *saved_nodes;     /* [NDLI_ROD_SAVED_NODES nodes] copies for undo */
    double *saved_reals;      /* [NDLI_ROD_SAVED_REALS nodes] */
    double *saved_turns;      /* [edges] */
};

/* Unknowns of node i: x_i, theta_i. A bend couples the first of x_i-1 (4 i - 4) to the last of x_i+1 (4 i + 6). */
enum { NDLI_ROD_WIDTH = 10, NDLI_ROD_SAVED_NODES = 6, NDLI_ROD_SAVED_REALS = 3 };

/* What of the second derivatives is wanted. */
enum {
    NDLI_ROD_EXACT = 1,   /* all; otherwise Gauss-Newton bending and twist, safe stretch: positive semidefinite */
    NDLI_ROD_NO_TWIST = 2 /* twist left out: for those who keep frames out of their unknowns and eliminate them, where
                           * a free tip makes it vanish */
};

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- rod_force ---- */

SB_INLINE int ndli_rod_edges(const ndl_rod *rod) { return rod->node_count - 1; }
SB_INLINE int ndli_rod_has_edge(const ndl_rod *rod, int edge) { return rod && edge >= 0 && edge < ndli_rod_edges(rod); }
/* Nodes between two edges, which have a curvature. */
SB_INLINE int ndli_rod_is_inner(const ndl_rod *rod, int node) { return node > 0 && ndli_rod_has_edge(rod, node); }
/* Largest distance of a node from the origin (m): what positions are rounded by. */
NDLI_API double ndli_rod_reach(const ndl_rod *rod);
/* Parallel transport of v from the unit tangent p to the unit tangent q, not opposite to it. */
NDLI_API ndli_v3 ndli_rod_transport(ndli_v3 p, ndli_v3 q, ndli_v3 v);
/* Whether an edge may turn from the unit tangent p to the unit tangent q: not (nearly) back. */
NDLI_API int ndli_rod_may_turn(ndli_v3 p, ndli_v3 q);
/* v with its part along the unit vector t taken out, of length 1; any such vector where nothing is left of v. */
NDLI_API ndli_v3 ndli_rod_across(ndli_v3 v, ndli_v3 t);
/* shape = geometry at x and theta, directors carried from the state's. Returns -1, or the first node at which an edge
 * has no length, has turned back on its neighbour, or turned over since the state: no energy there. */
NDLI_API int ndli_rod_set_shape(const ndl_rod *rod, const ndli_v3 *x, const double *theta);
/* The same at other angles, tangents and directors of rod->shape as they are; frames (m1, m2): not only twists. */
NDLI_API void ndli_rod_set_angles(const ndl_rod *rod, const double *theta, int frames);
typedef struct ndli_rod_sums {
    double stretch, bend, twist; /* J */
    double grip;                 /* J: of the surroundings' springs, with what slips since the state */
    double viscous;              /* J: what damping adds within a step */
    double noise;                /* J: what rounding of positions leaves unknown of their sum */
    double turn_noise;           /* J: what rounding of angles does, where there is a grip; it is in noise, too */
} ndli_rod_sums;
/* Elastic energies of rod->shape. */
NDLI_API ndli_rod_sums ndli_rod_shape_energy(const ndl_rod *rod);
/* gradient[nodes] and turn_gradient[edges] (not NULL) of the elastic energy of rod->shape; matrix, when not NULL, its
 * second derivatives by the flags above. */
NDLI_API void ndli_rod_derivatives(const ndl_rod *rod, int flags, ndli_v3 *gradient, double *turn_gradient,
                                   ndli_rod_matrix *matrix);
/* turn_gradient, matrix->turn and matrix->turn_before of these alone. */
NDLI_API void ndli_rod_turn_derivatives(const ndl_rod *rod, int flags, double *turn_gradient, ndli_rod_matrix *matrix);
/* From here on every energy k/2 (w - w_rest)^2 has viscous k/2 (w - w_old)^2 beside it: damping as a potential,
 * which does not see how edges turn. w_old is the state's strain a time `ahead` on at its present rate. With strain
 * rates w_rate' = (2/dt)(w' - w) - w_rate, as Newmark has velocities, viscous is 2 damping/dt and ahead dt/2; with
 * implicit Euler's (w' - w)/dt they are damping/dt and 0. stretch = bend = 0: no more. */
NDLI_API void ndli_rod_set_viscous(ndl_rod *rod, double stretch, double bend, double ahead);
/* Takes what damping is at rod->shape: damping_before ... damping_tangent. For those who take v as unknown. */
NDLI_API void ndli_rod_set_damping_shape(ndl_rod *rod);
/* gradient += C v for that damping; returns v.C v (W). */
NDLI_API double ndli_rod_add_damping_force(const ndl_rod *rod, const ndli_v3 *v, ndli_v3 *gradient);
/* matrix->node += factor C */
NDLI_API void ndli_rod_add_damping_matrix(const ndl_rod *rod, double factor, ndli_rod_matrix *matrix);

/* ---- rod ---- */

/* After x or theta changed: tangents, frames (carried from where the edges were) and quasi-static theta follow, and
 * the surroundings' grip slips where it must. Returns -1, or the node that ndli_rod_set_shape names; nothing has
 * changed then, x and theta aside. */
NDLI_API int ndli_rod_moved(ndl_rod *rod);
/* The same, but nothing slips for good yet: the motion goes on. */
NDLI_API int ndli_rod_follow(ndl_rod *rod);
/* After rest_length or held changed: masses, and cells. Rest curvature stays integrated at each node. */
NDLI_API void ndli_rod_rest_changed(ndl_rod *rod);
/* rest_bend of the inner node i from its curvature (1/m) and cell. */
NDLI_API void ndli_rod_bend_to(ndl_rod *rod, int i, double curvature1, double curvature2);
NDLI_API int ndli_rod_static_options_valid(const ndl_rod_static_options *options);
/* Copies the state to what readings return. */
NDLI_API void ndli_rod_publish(ndl_rod *rod);
/* Copies of the state for undo, one deep: positions, motion, frames, what grips are wound by; not nodes and rests. */
NDLI_API void ndli_rod_save(ndl_rod *rod);
NDLI_API void ndli_rod_restore(ndl_rod *rod);

/* ---- rod_turn ---- */

/* Minimises the energy over the angles that are not held, nodes where they are and directors as they are. */
NDLI_API void ndli_rod_relax(ndl_rod *rod);
NDLI_API int ndli_rod_any_turn_held(const ndl_rod *rod);
/* Whether theta_j is no unknown. Nothing determines how a plain rod is turned that is held and gripped nowhere: its
 * first edge stays. */
NDLI_API int ndli_rod_turn_known(const ndl_rod *rod, int j, int any_held);
/* Torque per radian that is little beside twist, and keeps turns determined that no energy sees. */
NDLI_API double ndli_rod_turn_floor(const ndl_rod *rod, int j);

/* ---- rod_step ---- */

/* One step of implicit Euler by Newton's method, to the targets of held nodes; reactions are those of its end. 0:
 * Newton found none, and the state is as before. */
NDLI_API int ndli_rod_step_euler(ndl_rod *rod, double dt);

/* ---- rod_grip ---- */

/* Torque (N m) with which the grip of edge j, wound by `lag`, is against more of it. */
NDLI_API double ndli_rod_grip_moment(const ndl_rod *rod, int j, double lag);
/* Of rod->shape. */
NDLI_API void ndli_rod_add_grip_energy(const ndl_rod *rod, ndli_rod_sums *sums);
NDLI_API void ndli_rod_add_grip_derivatives(const ndl_rod *rod, double *turn_gradient, ndli_rod_matrix *matrix);
/* Anchors follow where springs are wound beyond their limit. */
NDLI_API void ndli_rod_slip(ndl_rod *rod);
/* ndl_rod_set_grip with valid arguments. */
NDLI_API void ndli_rod_set_grip(ndl_rod *rod, int edge, double stiffness, double limit);
/* Turns the frame of edge 0, which must be held against turning, by `angle` (rad) about its tangent, for those who move
 * nodes themselves; ndli_rod_moved, which must follow, turns the rest. */
NDLI_API void ndli_rod_turn_base(ndl_rod *rod, double angle);
/* Edge and edge + 1 are now the halves of what was edge. */
NDLI_API void ndli_rod_split_grip(ndl_rod *rod, int edge);
/* Edge `from` goes into edge `to`, whose theta is that of both; their lags were these. */
NDLI_API void ndli_rod_merge_grip(ndl_rod *rod, int from, int to, const double lags[2]);
typedef struct ndli_rod_spread {
    double *grip, *limit, *lag; /* [edges] */
} ndli_rod_spread;
/* Grip and lag of `count` - 1 new edges between the stations `at`, when the old nodes are at old_at (m). */
NDLI_API void ndli_rod_spread_grip(const ndl_rod *rod, const double *old_at, const double *at, int count,
                                   ndli_rod_spread *spread);

/* ---- rod_reshape ---- */

/* ndl_rod_reparameterise; x is `positions` to the bit. 2 <= count <= capacity; positions may be rod->x or rod->try_x,
 * but no other array of the rod. Does not publish. Returns -1, or the node at which `positions` make no rod: nothing
 * has changed then. */
NDLI_API int ndli_rod_reparameterise(ndl_rod *rod, const ndli_v3 *positions, int count);
#endif

#endif /* NDL_ROD_PRIVATE_H */
