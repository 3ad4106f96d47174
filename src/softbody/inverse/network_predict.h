/* network_predict: a network's guess of a static solve on a grid, never without its residual. Floor 4. */
#ifndef SB_NETWORK_PREDICT_H
#define SB_NETWORK_PREDICT_H

#include "../geometry/grid.h"
#include "network.h"

/* A network that knows where some nodes have gone (the part of an organ that a camera sees, or all nodes of a linear
 * solution) says where all go. Its input has at each node of the lattice the channels
 *     0 to 2   the node's displacement over the largest one that is known; 0 where it is not known
 *     3        1 where it is known
 *     4        that largest one over the network's length: answers are not quite proportional to it
 *     5        the node's place along the longest side of the lattice, 0 to 1: convolutions do not know where they are
 *     6        1
 * and 0 in all of them where the grid has no node: the lattice may be larger than the grid, which lies at its low
 * corner; sides that are pooled three times are multiples of 8. Its output is the displacement over the largest known
 * one. Source: Brunet 2020, section 5.6; scaling, size and place are not there: without them the loss (5.5) is ruled by
 * the largest deformations.
 *
 * Such an answer is a guess, and is treated as one:
 * ```c fragment
 * sb_network_input seen = sb_default_network_input();
 * sb_vec3 displacements[9] = {{0, 0, 0}}; // of nodes[9], which are seen (m)
 * sb_network *network = NULL;
 * sb_network_info info;
 * sb_grid grid; // that the body was made from
 * memset(&grid, 0, sizeof grid);
 * seen.nodes = nodes;
 * seen.displacements = displacements;
 * seen.count = 9;
 * if (sb_network_load("liver.sbnet", NULL, &network, &error) == SB_OK &&
 *     sb_network_predict(network, &grid, body, &seen, &info, &error) == SB_OK)
 *     printf("%s: it is out of balance by %g of the loads\n", info.taken ? "taken" : "refused",
 *            (double)info.residual);
 * sb_network_destroy(network);
 * ``` */
enum { SB_NETWORK_CHANNELS = 7 };

/* What becomes of the guess. A guess passes when its potential is below that of rest and that of the present state,
 * both with supports where they belong. */
typedef enum sb_network_policy {
    SB_NETWORK_TAKE = 1,  /* the body takes it when it passes and its residual is at most `limit`; else it stays */
    SB_NETWORK_START = 2, /* static solve; it starts from the guess, or what the guess's rotations lead to, when that
                           * passes, and from the present state where it does not or where the solve then fails */
    SB_NETWORK_KEEP = 3   /* the body stays as it is: the guess is only weighed */
} sb_network_policy;

/* Start from sb_default_network_input(). */
typedef struct sb_network_input {
    const int *nodes;                 /* [count] of the grid, or NULL: nodes 0, 1, ... */
    const sb_vec3 *displacements;     /* [count] (m) */
    int count;                        /* >= 1 */
    sb_network_policy policy;         /* default SB_NETWORK_TAKE */
    sb_real limit;                    /* of the residual, >= 0; default 0.05 */
    const sb_static_options *statics; /* of SB_NETWORK_START; NULL (default): defaults */
    unsigned cookie;                  /* set by sb_default_network_input */
} sb_network_input;
SB_API sb_network_input sb_default_network_input(void);

/* How good the guess is: of SB_NETWORK_START the one with its rotations held. */
typedef struct sb_network_info {
    int taken;          /* 1: the body has it, or the solve that succeeded started from it */
    sb_real size;       /* largest known displacement (m) */
    sb_real force;      /* |out-of-balance force| on free axes (N) */
    sb_real residual;   /* the same over the loads, as sb_static_report.force */
    sb_real from_rest;  /* its potential above that of rest (J), below 0 when it passes; INFINITY: the material does not
                         * admit it, -INFINITY: nor the body at rest with supports that have moved */
    sb_real from_last;  /* and above that of the state before the call */
    sb_step_info solve; /* of SB_NETWORK_START, else 0 */
} sb_network_info;

/* Guesses the equilibrium of a body of this grid (made from grid->body_mesh, with nodes as they were made) under its
 * present loads and supports. Supports and slaves of constraints are put where they belong. info and error may be NULL.
 * SB_NETWORK_TAKE allocates nothing. On failure the body is as it was: SB_ERROR_ARGUMENT (a field, or a grid that is
 * not the body's or does not fit the network's lattice, spacing within 1e-3), SB_ERROR_MATERIAL (a material whose
 * Poisson's ratio is off the network's by more than 0.005), SB_ERROR_INDEX and SB_ERROR_NOT_FINITE naming the node,
 * SB_ERROR_UNSUPPORTED (a network with other channels; tools in the body's contact; def.slack), what the network
 * refuses, what sb_body_solve_static refuses. A guess that is inside out is no failure: it does not pass. */
SB_API sb_result sb_network_predict(sb_network *network, const sb_grid *grid, sb_body *body,
                                    const sb_network_input *input, sb_network_info *info, sb_error *error);

#endif /* SB_NETWORK_PREDICT_H */
