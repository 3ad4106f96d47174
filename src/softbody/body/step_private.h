/* step_private: what the files of the step share: the Newton iteration, its line search, the integrators. Floor 3. */
#ifndef SB_STEP_PRIVATE_H
#define SB_STEP_PRIVATE_H

#include "body_private.h"
#include "step_parts.h"
#include "step_touch.h"

/* ---- step_way.c ---- */
/* Connected parts: those of the matrix that is solved, where ties join what they tie. */
SBI_API const sb_matrix *sbi_step_parts(const sb_body *body);
/* Nodes of a part of the matrix; -1: all. rows NULL: 0, 1, ... */
typedef struct sbi_static_nodes {
    const int *rows;
    int count;
} sbi_static_nodes;
SBI_API sbi_static_nodes sbi_static_part(const sb_body *body, int part);
SB_INLINE int sbi_static_node(const sbi_static_nodes *nodes, int k) { return nodes->rows ? nodes->rows[k] : k; }
/* |a_k b_k| summed over the axes k of a mask, and the largest |a_k|. */
SBI_API double sbi_static_work(unsigned axes, sb_vec3 a, sb_vec3 b);
SBI_API double sbi_static_largest(unsigned axes, sb_vec3 a);
/* What a node has gone since the solve began (m). */
SBI_API sb_vec3 sbi_static_way(const sb_body *body, int node);
/* Work (J) of supports that move since the solve began, over the longest way that one of their axes has gone: what
 * their motion is held up by (N). part: of the matrix; -1: of all. */
SBI_API sb_real sbi_static_support_force(const sb_body *body, int part);

/* ---- what A and D are made of ---- */
/* v and a at the present displacement. */
SB_INLINE sb_vec3 sbi_step_velocity(const sbi_step *step, int i)
{
    const sb_body *b = step->body;
    return sb_v3_madd(b->velocity0[i], step->cv, sb_v3_sub(b->displacement[i], b->start[i]));
}

SB_INLINE sb_vec3 sbi_step_acceleration(const sbi_step *step, int i)
{
    const sb_body *b = step->body;
    return sb_v3_madd(b->acceleration0[i], step->ca, sb_v3_sub(b->displacement[i], b->start[i]));
}

/* Of all the body's mass; 0 where nodes have theirs. */
SB_INLINE sb_real sbi_step_alpha(const sb_body *b) { return b->regional_damping ? 0 : b->damping_mass; }

/* Of the K of D: 1 where regions have theirs in it. */
SB_INLINE sb_real sbi_step_beta(const sb_body *b) { return b->regional_damping ? 1 : b->damping_stiffness; }

/* Factor of the mass in A. */
SB_INLINE sb_real sbi_step_mass_factor(const sbi_step *step)
{
    return step->dynamic ? step->ca + sbi_step_alpha(step->body) * step->cv : step->hold;
}

/* Share of the assembled stiffness in A: damping is part of it in a linearised step. */
SB_INLINE sb_real sbi_step_stiffness_factor(const sbi_step *step)
{
    return step->dynamic && !step->lagged_damping ? 1 + step->body->damping_stiffness * step->cv : 1;
}

/* ---- step_residual.c ---- */
/* Internal forces at the present displacement, unless they are current. SB_ERROR_INVERTED. */
SBI_API sb_result sbi_step_force(sbi_step *step);
/* matrix = A at the present displacement, whose forces are current. */
SBI_API void sbi_step_tangent(sbi_step *step, sb_tangent_kind kind);
/* Keeps the stiffness at the start of the step for D. */
SBI_API sb_result sbi_step_keep_damping(sbi_step *step);
/* out = K x with the K of D. */
SBI_API void sbi_step_damping_product(const sbi_step *step, const sb_vec3 *x, sb_vec3 *out);
/* residual = r(u), its norm on the free axes, and the force to compare it with. */
SBI_API void sbi_step_residual(sbi_step *step);
/* The residual that has to vanish on the free axes: slaves have handed theirs to their masters, and guests have
 * theirs. */
SBI_API const sb_vec3 *sbi_step_unbalanced(const sbi_step *step);
/* Largest residual of a part over the part's forces, into info. Returns 1 when each meets the tolerance, or is no more
 * than `rounding` (N). */
SBI_API int sbi_step_parts_meet(sbi_step *step, sb_real rounding);
/* 1 when guests have still a part of their way to go that the tolerance shows: what they are held by tells forces of
 * that gap, not of a balance. */
SBI_API int sbi_step_guests_lag(const sbi_step *step);
/* What rounding may leave of the residual (N), as far as moduli and springs tell. */
SBI_API sb_real sbi_step_rounding(const sbi_step *step);
/* Forces, residual, and the tangent of a linearised step. */
SBI_API sb_result sbi_step_evaluate(sbi_step *step);
/* 1 when the residual is small enough, or as small as rounding lets it become. */
SBI_API int sbi_step_is_converged(sbi_step *step);
/* 1 when all of the body's materials have an energy inside out. */
SBI_API int sbi_step_allows_inversion(const sb_body *body);

/* ---- step_kept.c ---- */
/* Before forces and a tangent are made. step->keeps: none is to be made, and the forces have K x0 and beta K v0 in
 * them; step->notes: the one to be made may be kept. 0: forces are left to the caller. */
SBI_API int sbi_kept_force(sbi_step *step);
/* It cannot keep its tangent after all: forces alone, at the rotations that are there. */
SBI_API void sbi_kept_give_up(sbi_step *step);
/* The system of step->keeps is there then. What the solver refuses. */
SBI_API sb_result sbi_kept_begin(sbi_step *step);
/* residual += M x0 - A' x0 of step->keeps, K and M with their factors in A; body->work2 = A' x0. */
SBI_API void sbi_kept_add_coasting(sbi_step *step);
/* Of step->keeps, once it is solved: 1 when A' does nearly the work that A does on what the motion changes by. */
SBI_API int sbi_kept_was_near(const sbi_step *step);

/* ---- step_unassembled.c ---- */
/* Sets step->unassembled, the forces being those of the present displacement. */
SBI_API void sbi_unassembled_begin(sbi_step *step);
/* Of step->unassembled, once the increment's supported axes have the way that they go: the right-hand side, with what
 * supports that move add to it, and the matrix's mask. */
SBI_API void sbi_unassembled_fill(sbi_step *step);
/* What conjugate gradients take in place of the matrix and its preconditioner. Uses work and work2 while it solves. */
SBI_API const sbi_pcg_operator *sbi_unassembled_operator(sbi_step *step, sbi_pcg_operator *out);
/* Reactions, r + A du on supported axes. */
SBI_API void sbi_unassembled_reactions(const sbi_step *step);

/* ---- step_done.c: of static solves ---- */
/* An increment begins. */
SBI_API void sbi_static_begin_report(sbi_step *step);
/* 1 when the increment is done, by the residual, or as good as rounding lets it become. */
SBI_API int sbi_static_is_done(sbi_step *step);
/* 1 when a failing iteration has come as near as rounding, or as the reactions, can tell: it ends with success. */
SBI_API int sbi_static_settles(sbi_step *step);

/* Rounding (N) in the residual of a static solve whose tangent is in the body's matrix, not yet masked or masked. */
SBI_API sb_real sbi_static_floor(const sbi_step *step);

/* ---- step_direct.c: of static solves ---- */
/* A complete factor takes the preconditioner's place, where the body leaves the choice to the library and it fits. */
SBI_API void sbi_static_take_direct(sbi_step *step);
SBI_API void sbi_static_give_back_direct(sbi_step *step);

/* ---- step_static.c ---- */
/* external = equilibrated + factor (present loads - equilibrated); gravity pulls at int rho N dV. */
SBI_API void sbi_static_loads(sb_body *body, sb_real factor);

/* ---- step_start.c: of static solves ---- */
/* The assembly goes by corotated twins of all materials from here on, with the rotations' warm starts that follow from
 * no history. */
SBI_API void sbi_start_use_twins(sb_body *body, sb_real duration);
/* And by its own again. */
SBI_API void sbi_start_use_own(sb_body *body, sb_real duration);
/* From the displacement, whose forces are current, to the least potential of corotated materials with the rotations of
 * there held, which one system finds: into work2. */
SBI_API sb_result sbi_start_hold(sbi_step *step);
/* 1 when the solve may start from rotations. */
SBI_API int sbi_static_may_start(const sbi_step *step, sb_start start);
/* In place of the first iteration, whose system is made: to where rotations lead, or where the line search does.
 * duration: that materials with Prony terms relax for (s). */
SBI_API sb_result sbi_static_start(sbi_step *step, sb_real duration);

/* ---- step_guest.c ---- */
/* Takes the memory for these guests; all or nothing. */
SBI_API sb_result sbi_step_take_guests(sbi_step *step, const sbi_guest *const *list, int count);
/* The system is made, but for its preconditioner: guests begin. */
SBI_API sb_result sbi_step_begin_guests(sbi_step *step, sb_matrix *matrix);
/* The residual with guests on free axes, 0 where guests have taken the equation, in their space's `rest`, until the
 * next system is made. Guests count with the part of the matrix that they lie in; with the one of the largest scale
 * where they lie in several. Only when guests have begun, as the next two. */
SBI_API void sbi_step_guest_residual(sbi_step *step, const sb_matrix *parts);
/* The guests' part of the norm's square in this part (N^2); -1: of all that lie in one. */
SBI_API double sbi_step_guest_square(const sbi_step *step, int part);
/* Of static solves: the loads of guests in this part, or of all (-1), as forces on the mean node (N). */
SBI_API sb_real sbi_step_guest_load(const sbi_step *step, int part);
/* Of static solves: r.K^-1 r (J) of guests' own rows in this part, or of all (-1); out = K^-1 r of the nodes', both by
 * the last system's preconditioner, which this uses. */
SBI_API void sbi_step_precondition_guests(const sbi_step *step, sb_preconditioner *precond, const sb_vec3 *r,
                                          sb_vec3 *out);
SBI_API double sbi_step_guest_energy(const sbi_step *step, int part);
/* 1 when the rows of guests that lie in no part meet the tolerance, too, or are no more than `rounding` (N). */
SBI_API int sbi_step_lone_guests_meet(const sbi_step *step, sb_real rounding);
/* Taken nodes of guests that place them, a share of the way that the last solve found; `displacement` has the others.
 */
SBI_API void sbi_step_place_nodes(const sbi_step *step, double share, sb_vec3 *displacement);
/* Of the increment `share` was taken, and `held` of it on supported axes. */
SBI_API void sbi_step_move_guests(sbi_step *step, sb_real share, sb_real held);
/* Reactions less guests' forces on supported axes. */
SBI_API void sbi_step_guest_reactions(const sbi_step *step);
/* left [nodes] (N), what is left over without guests, less the forces of those that place no nodes. */
SBI_API void sbi_step_subtract_guests(const sbi_step *step, sb_vec3 *left);
SBI_API void sbi_step_commit_guests(sbi_step *step);
SBI_API void sbi_step_undo_guests(sbi_step *step);
/* way.G way of the way that the last solve has added to nodes (way [rows]) and unknowns. */
SBI_API double sbi_step_guest_rise(const sbi_step *step, const sb_vec3 *way);
/* Unknowns go back to a share of what the last solve added to them. */
SBI_API void sbi_step_shorten_guests(const sbi_step *step, double share);

/* ---- step_touch.c: of steps with step->touch ---- */
/* Axes that its blocks in the matrix leave out: none where constraints condense whole ones (NULL), else those of
 * supports. */
SBI_API const unsigned char *sbi_step_touch_mask(const sb_body *body);
/* The tangent at the start is there: contact begins. */
SBI_API sb_result sbi_step_begin_touch(sbi_step *step);
/* Its forces where share increment is still to be added to the displacement (increment NULL: nothing is). */
SBI_API void sbi_step_evaluate_touch(sbi_step *step, const sb_vec3 *increment, sb_real share, int renew);
/* Work (J) of the forces of the last evaluation along increment [rows]. */
SBI_API sb_real sbi_step_touch_work(const sbi_step *step, const sb_vec3 *increment);
/* out [rows] += factor times the forces of the last evaluation. */
SBI_API void sbi_step_add_touch_force(const sbi_step *step, sb_real factor, sb_vec3 *out);
/* Adds to the system what was evaluated last: before constraints are condensed, after supports are masked. */
SBI_API void sbi_step_add_touch(sbi_step *step);
/* y += C x, of the system that is solved (see sbi_touch.multiply_links) and of cavities, and x.Cx, for conjugate
 * gradients. */
SBI_API double sbi_body_multiply_links(void *body, const sb_real *x, sb_real *y);
/* 1: there is such a C. */
SBI_API int sbi_body_has_links(const sb_body *body);
/* The same as what a solve takes; and it has it while `extra` is there. */
SBI_API void sbi_body_lend_touch(sb_body *body, sbi_pcg_extra *extra);
/* Reactions less its forces on supported axes. */
SBI_API void sbi_step_touch_reactions(const sbi_step *step);
/* 1: an increment of a static solve has converged, but contact's loads do not balance yet: iterate again. */
SBI_API int sbi_step_balance_touch(sbi_step *step, int round);
SBI_API void sbi_step_commit_touch(sbi_step *step);
SBI_API void sbi_step_undo_touch(sbi_step *step);

/* ---- step_system.c ---- */
/* Where the supports of node i should be at the end of the step, which may be a part of its caller's. */
SBI_API sb_vec3 sbi_step_target(const sbi_step *step, int i);
/* And at the present load factor; exact at the end of the way. */
SBI_API sb_vec3 sbi_step_goal(const sbi_step *step, int i);
SBI_API int sbi_step_supports_move(const sbi_step *step);
/* A du = -r with the supports' increments prescribed, constraints condensed and the preconditioner up to date. */
SBI_API sb_result sbi_step_make_system(sbi_step *step);
/* A block of the matrix times a vector. */
SB_INLINE sb_vec3 sbi_step_block_product(const sb_real *m, sb_vec3 d)
{
    return sb_v3(m[0] * d.x + m[1] * d.y + m[2] * d.z, m[3] * d.x + m[4] * d.y + m[5] * d.z,
                 m[6] * d.x + m[7] * d.y + m[8] * d.z);
}
/* What nodes coast in the step along free axes (m). */
SBI_API sb_vec3 sbi_step_coast(const sbi_step *step, int i);
/* A du = -r without constraints is made: the rows of supported nodes, which the reactions need, are put aside, and
 * supports masked. x, rhs: [rows] as sb_matrix_constrain has them. */
SBI_API void sbi_step_mask(sb_body *body, sb_vec3 *x, sb_vec3 *rhs);
/* The same without a new first guess, guests and preconditioner: matrix and right-hand side. */
SBI_API void sbi_step_fill_system(sbi_step *step);
/* 1 when all materials are linear. */
SBI_API int sbi_step_is_linear(const sb_body *body);
/* Tolerance of this iteration's linear solve. */
SBI_API sb_real sbi_step_linear_tolerance(const sbi_step *step);
/* Once, as the matrix is; demand NULL: as a step's only system. */
SBI_API sb_result sbi_step_solve_once(sbi_step *step, sb_real tolerance, const sbi_pcg_demand *demand);
/* Reactions: r on supported axes. Of a linearised step r + A du, since its r is the one before du. Less guests'
 * forces. */
SBI_API void sbi_step_reactions(const sbi_step *step);

/* ---- step_solve.c ---- */
/* Solves the system for the body's increment, with guests and contact. */
SBI_API sb_result sbi_step_solve_system(sbi_step *step);

/* ---- step_search.c ---- */
/* work2 = the displacement a share t of the increment on; at its end with supports and slaves where they belong. */
SBI_API void sbi_step_trial(const sbi_step *step, sb_real t);
/* Takes the displacement `end` where its potential is lower than at the end of the whole increment and, unless supports
 * move, as much lower than the present one as a line search asks for: 1. Otherwise 0, and nothing but `end`
 * (overwritten) has changed. Of static solves without tools. */
SBI_API int sbi_step_take_lower(sbi_step *step, sb_vec3 *end);
/* The potential at the end of the whole increment above that here (J), whose forces are current; INFINITY where the
 * material does not admit that end. Of static solves without tools. */
SBI_API sb_real sbi_step_change(sbi_step *step);
/* Moves the displacement by the increment, or the share of it that the line search admits. */
SBI_API sb_result sbi_step_accept(sbi_step *step);

/* ---- step_scheme.c ---- */
/* external = dead loads and gravity. */
SBI_API void sbi_step_dead_loads(sb_body *body);
/* M a = f_ext - f_int - D v: what Newmark starts from. */
SBI_API sb_result sbi_step_initial_acceleration(sbi_step *step);
/* Coefficients and predictors of the integrator. */
SBI_API void sbi_step_scheme(sbi_step *step);
/* Velocity, acceleration and displacement at the end of the step; SB_ERROR_DIVERGED before anything overflows. */
SBI_API sb_result sbi_step_finish(sbi_step *step);

/* ---- step.c: begin and end of steps and of static solves ---- */
SBI_API void sbi_step_begin_info(sb_step_info *info);
/* Keeps the state that sbi_step_restore gives back. */
SBI_API void sbi_step_save(sb_body *body);
SBI_API void sbi_step_restore(sb_body *body);
/* Whether folded-over cells get one rotation; forces that were made under the other rule are made anew. */
SBI_API void sbi_step_watch_folds(sb_body *body, int fold_fallback);
/* Materials with Prony terms respond as over a step of dt from now on. */
SBI_API void sbi_step_enter(sb_body *body, sb_real dt);
/* The step of dt is done: their memory moves on. */
SBI_API void sbi_step_leave(sb_body *body, sb_real dt);
/* Residual at the present displacement and, unless it is small enough, the next linear system. */
SBI_API sb_result sbi_step_linearise(sbi_step *step);
/* Iterates to r(u) = 0 from what sbi_step_linearise made, without guests. The displacement is moved. */
SBI_API sb_result sbi_step_iterate(sbi_step *step, sb_result begun);
/* A time step from begin to end, undone where it fails. part: share of what is left of a divided step; else 1.
 * patience: see sbi_step_part. */
SBI_API sb_result sbi_step_whole(sb_body *body, sb_real dt, const sbi_guest *const *guests, int guest_count,
                                 sb_real part, int patience, sb_step_info *info);
/* SB_ERROR_ARGUMENT where options of a static solve are out of range. */
SBI_API sb_result sbi_static_check_options(const sb_static_options *options, sb_error *error);
/* What Prony terms relax for in a static solve (s). */
SBI_API sb_real sbi_static_duration(const sb_static_options *options);
SBI_API void sbi_step_forget_error(sb_step_info *info);
/* Sees to it that a failing call says why, whatever failed. */
SBI_API sb_result sbi_step_report(sb_step_info *info, sb_result result);

#endif /* SB_STEP_PRIVATE_H */
