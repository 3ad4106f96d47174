/* cable_law: what one cable does at a shape of the body: length, tension, stiffness. Floor 3, internal.
 *
 * Of length l = sum |p_k+1 - p_k| over its points p_k = H_k x, and strain e = l / rest - 1, it has the energy
 *     W = stiffness rest (e^2 / 2 - toe e / 2 + toe^2 / 6) past its toe, stiffness rest e^3 / (6 toe) within it,
 * and none when it is slack. Tension N = dW/dl, forces -N dl/dp, stiffness
 *     N' (dl)(dl)^T + N sum_k (1 / l_k) D_k^T (I - t_k t_k^T) D_k, D_k p = p_k+1 - p_k,
 * positive semidefinite as N >= 0. */
#ifndef SB_CABLE_LAW_H
#define SB_CABLE_LAW_H

#include "body_private.h"

/* Takes the arrays of a cable of so many points and entries of their rows. */
SBI_API void sbi_cable_layout(sbi_cable_lie *lie, size_t points, size_t entries, sbi_arena *arena);
/* SB_ERROR_NOT_FINITE and SB_ERROR_ARGUMENT name the load. */
SBI_API sb_result sbi_cable_check_law(const sbi_cable_law *law, int load_id, sb_error *error);
SBI_API int sbi_cable_point_is_in_space(const sbi_load *load, int point);
/* Where a point is at u; factor: see sbi_loads_force. */
SBI_API sb_vec3 sbi_cable_point(const sb_body *body, const sbi_load *load, int point, const sb_vec3 *u, sb_real factor);
/* Fills load->lie but for dofs and shares. All below is of where it was laid last. */
SBI_API void sbi_cable_lay(const sb_body *body, sbi_load *load, const sb_vec3 *u, sb_real factor);
/* The same, and dofs and shares: sum shares u[dofs] is what the length changes by. */
SBI_API void sbi_cable_list_shares(const sb_body *body, sbi_load *load, const sb_vec3 *u);
SBI_API void sbi_cable_add_force(const sbi_load *load, sb_vec3 *out);
/* Square of the forces (N) that places would make whose rounding is theirs. */
SBI_API double sbi_cable_square_size(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_real factor);
/* matrix += its stiffness; of one that pushes without what is negative in it, unless kind is SB_TANGENT_EXACT. */
SBI_API void sbi_cable_add_tangent(sbi_load *load, sb_tangent_kind kind, sb_matrix *matrix);
/* matrix += what a cable that is slack or in its toe would add if it were taut. */
SBI_API void sbi_cable_add_slack(const sbi_load *load, sb_matrix *matrix);
/* out += factor K x, K as sbi_cable_add_tangent had it for other kinds than SB_TANGENT_EXACT. */
SBI_API void sbi_cable_add_product(const sbi_load *load, const sb_vec3 *x, sb_real factor, sb_vec3 *out);
/* Work of its forces along du (J). */
SBI_API sb_real sbi_cable_work(const sbi_load *load, const sb_vec3 *du);
/* What a static solve of a new cable starts from: no force. */
SBI_API void sbi_cable_relax(const sb_body *body, sbi_load *load);
/* What the next one starts from, after one ended at this factor. */
SBI_API void sbi_cable_settle(sbi_load *load, sb_real factor);
/* Keeps force, tension and energy of a solve that balances at u; where `linear` is another displacement, with what the
 * cable is near that one. */
SBI_API void sbi_cable_read(const sb_body *body, sbi_load *load, const sb_vec3 *u, const sb_vec3 *linear,
                            sb_real factor);

#endif /* SB_CABLE_LAW_H */
