/* membrane_law: what one membrane does at a shape of the body. Floor 3, internal.
 *
 * In the plane of the rest shape with orthonormal axes, prestretch in the gradients g_a: F = sum x_a g_a^T (3 x 2),
 * C = F^T F, e = C - 1 from displacements, so that small strains keep their digits. With V = thickness times area:
 *     W = mu/2 V (tr C + 1/det C - 3), S = mu (1 - C^-1 / det C), f_a = -V F S g_a,
 *     K_ab = V [(g_a . S g_b) 1 + B_a^T D B_b], D = 2 mu/det C [sym(C^-1 (x) C^-1) + C^-1 (x) C^-1].
 * Wrinkled, n along the larger C1, m across, S1 = mu (1 - C1^-3/2):
 *     W = mu/2 V (C1 + 2 C1^-1/2 - 3), S = S1 n n, D = 2 S1' (nn)(nn) + S1/(C1 - C2) (nm + mn)(nm + mn). */
#ifndef SB_MEMBRANE_LAW_H
#define SB_MEMBRANE_LAW_H

#include "membrane.h"

#include "body_private.h"

/* SB_ERROR_NOT_FINITE and SB_ERROR_ARGUMENT. */
SBI_API sb_result sbi_membrane_check_law(const sbi_membrane_law *law, sb_error *error);
/* SB_ERROR_ARGUMENT names a face without area. */
SBI_API sb_result sbi_membrane_check_faces(const sb_body *body, const sbi_load *load, sb_error *error);
/* In all of these, factor: see sbi_loads_force; wrong numbers come from faces that are folded to nothing. */
SBI_API double sbi_membrane_energy(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_real factor);
/* out += the forces; returns the square of what they are differences of (N^2). */
SBI_API double sbi_membrane_add_force(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_real factor,
                                      sb_vec3 *out);
/* matrix += stiffness; load->blocks are current. Kinds other than SB_TANGENT_EXACT: without pressure, positive
 * semidefinite. */
SBI_API void sbi_membrane_add_tangent(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_tangent_kind kind,
                                      sb_real factor, sb_matrix *matrix);
/* matrix += at least what a sheet that wrinkles adds once it is taut. */
SBI_API void sbi_membrane_add_slack(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_matrix *matrix);
/* out += share K x, K as sbi_membrane_add_tangent has it for other kinds than SB_TANGENT_EXACT. */
SBI_API void sbi_membrane_add_product(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_real factor,
                                      const sb_vec3 *x, sb_real share, sb_vec3 *out);
/* Work of its forces at u along du (J). */
SBI_API sb_real sbi_membrane_work(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_real factor,
                                  const sb_vec3 *du);
/* Forces on the nodes of a face in the last solve, which balances at u and was made linear near `linear`. */
SBI_API void sbi_membrane_face_force(const sb_body *body, const sbi_load *load, int face, const sb_vec3 *u,
                                     const sb_vec3 *linear, sb_real factor, sb_vec3 *force);
/* What a static solve of a new membrane starts from, and what the next one starts from. */
SBI_API void sbi_membrane_relax(sbi_load *load);
SBI_API void sbi_membrane_settle(sbi_load *load, sb_real factor);
SBI_API sb_membrane_state sbi_membrane_state_of(const sb_body *body, const sbi_load *load, int face);

#endif /* SB_MEMBRANE_LAW_H */
