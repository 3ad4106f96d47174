/* cavity_law: volume of one cavity, its law, and the rank-one stiffness of all. Floor 3, internal.
 *
 * g_a = int N_a n da = dV/dx_a comes by entries: shares of the nodes of each face, and of rim edges. A lid from c, the
 * mean of a rim's corners, over its edges e(s): x = (1 - t) c + t e, n da = t (e - c) x e' ds dt, so that c has
 * 1/6 int (e - c) x e' ds and node k of the edge 1/3 int N_k (e - c) x e' ds. V = 1/3 sum g_a.x_a. */
#ifndef SB_CAVITY_LAW_H
#define SB_CAVITY_LAW_H

#include "cavity.h"

#include "body_private.h"

/* SB_ERROR_NOT_FINITE and SB_ERROR_ARGUMENT. */
SBI_API sb_result sbi_cavity_check_law(const sbi_cavity *cavity, const sbi_cavity_law *law, sb_error *error);
/* Finds the rims of its faces: load->rim. SB_ERROR_MEMORY; SB_ERROR_ARGUMENT: rims touch (error->node). */
SBI_API sb_result sbi_cavity_find_rims(const sb_body *body, sbi_load *load, sb_error *error);
/* Shares, volume, pressure and stiffness at u. */
SBI_API void sbi_cavity_lay(const sb_body *body, sbi_load *load, const sb_vec3 *u, sb_real factor);
/* All below where it was laid last. -int p dV (J); p g, added; its stiffness -dp/dV (Pa/m^3). */
SBI_API double sbi_cavity_energy(const sbi_load *load, sb_real factor);
SBI_API void sbi_cavity_add_force(const sbi_load *load, sb_real pressure, sb_vec3 *out);
/* Entry k of g: those of faces, then three of each edge of a rim; 0: there is none. */
SBI_API int sbi_cavity_entries(const sbi_load *load);
SBI_API int sbi_cavity_entry(const sbi_load *load, int k, int *node, sb_vec3 *share);
/* g.x */
SBI_API double sbi_cavity_growth(const sb_body *body, const sbi_load *load, const sb_vec3 *x);
/* |g_k|^2 summed over entries */
SBI_API double sbi_cavity_square(const sbi_load *load);
/* Adds a diagonal that is no less than its stiffness. */
SBI_API void sbi_cavity_add_bound(const sbi_load *load, sb_matrix *matrix);
/* What a static solve of a new cavity starts from, laid there; what the next one starts from. */
SBI_API void sbi_cavity_relax(sbi_load *load);
SBI_API void sbi_cavity_settle(sbi_load *load, sb_real factor);
/* The pressure of the law that contents have at `held`, see sbi_cavity_hold; 1: the law is one of those. */
SBI_API int sbi_cavity_is_stiff(const sbi_load *load);
/* How far V is from that of the law at its present pressure, over V; that pressure is then held. */
SBI_API double sbi_cavity_hold_pressure(sbi_load *load, sb_real factor);
/* 1: steps hold volumes to more than a stiffness, by pressures that they correct. Such a pressure swings without end in
 * schemes that keep energy: theirs is that of the body's own stiffness. */
SBI_API int sbi_cavity_corrects(const sb_body *body);
/* stiff = what the law asks, at most 100 times the stiffness of the matrix to growing, of which `mass` (1/s^2) is the
 * mass' factor. Uses body->work and work2. */
SBI_API void sbi_cavity_stiffen(sb_body *body, sbi_load *load, sb_real factor, sb_real mass);

/* ---- all cavities of a body, as they were laid last ---- */
/* 1: there is one whose stiffness is not 0. */
SBI_API int sbi_cavities_resist(const sb_body *body);
/* y += C x, C the sum of their -dp/dV g g^T, and x.Cx. condensed 0: as they are; 1: of the system that is solved. */
SBI_API double sbi_cavities_multiply(const sb_body *body, const sb_vec3 *x, int condensed, sb_vec3 *y);
/* What is held: kept for sbi_cavities_restore, of steps; and of load increments. */
SBI_API void sbi_cavities_save(sb_body *body);
SBI_API void sbi_cavities_restore(sb_body *body);
SBI_API void sbi_cavities_keep(sb_body *body);
SBI_API void sbi_cavities_go_back(sb_body *body);

#endif /* SB_CAVITY_LAW_H */
