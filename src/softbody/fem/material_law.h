/* material_law: a law of the caller's own, evaluated and checked. Internal: material.c calls it. Floor 2. */
#ifndef SBI_MATERIAL_LAW_H
#define SBI_MATERIAL_LAW_H

#include "material.h"

/* law_scale times the law, and the bulk term; 0 where the law has no value, or lacks a call. The law is not called
 * where its scale is 0. */
SBI_API int sbi_law_energy(const sb_material *material, const sb_mat3 *F, sb_real *W);
SBI_API int sbi_law_stress(const sb_material *material, const sb_mat3 *F, sb_mat3 *P);
SBI_API int sbi_law_tangent(const sb_material *material, const sb_mat3 *F, sb_tangent_kind kind, sb_real *A);

/* A[81] without its negative eigenvalues; 0 where they are not found. */
SBI_API int sbi_law_project(sb_real *A);

/* Bulk and shear modulus (Pa) of the law's tangent at F = I, averaged over directions (Voigt); untouched where it has
 * none. */
SBI_API void sbi_law_moduli(const sb_material_law *law, sb_real *bulk, sb_real *mu);

/* SB_ERROR_MATERIAL: no law, or one whose moduli at F = I are not finite or > 0; SB_ERROR_ARGUMENT: a name or call is
 * missing. */
SBI_API sb_result sbi_law_check_calls(const sb_material *material, sb_error *error);
/* SB_ERROR_MATERIAL: the scale, d1, or no resistance to changes of volume. */
SBI_API sb_result sbi_law_check_constants(const sb_material *material, sb_error *error);
/* SB_ERROR_MATERIAL where the law is not what its energy says, see sb_material_law. */
SBI_API sb_result sbi_law_check(const sb_material *material, sb_error *error);

/* What states and recordings know a law by: 24 bits of its name, which every sb_real holds. 0: no law. */
SBI_API sb_real sbi_law_mark(const sb_material_law *law);

#endif /* SBI_MATERIAL_LAW_H */
