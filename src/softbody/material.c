/* material: constructors, checks, and the evaluation that chooses the model at run time. */
#include "material.h"

#include <string.h>

/* ---- constants ---- */

SB_API sb_real sb_material_bulk(const sb_material *material)
{
    return material->lambda + 2 * material->mu / 3;
}

SB_API sb_real sb_material_young(const sb_material *material)
{
    sb_real lambda = material->lambda, mu = material->mu;
    return mu * (3 * lambda + 2 * mu) / (lambda + mu);
}

SB_API sb_real sb_material_poisson(const sb_material *material)
{
    return material->lambda / (2 * (material->lambda + material->mu));
}

/* ---- constructors ---- */

static sb_material sbi_material_from_young(sb_material_model model, sb_real young, sb_real poisson,
                                           sb_real density)
{
    sb_material m;
    memset(&m, 0, sizeof m);
    m.model = model;
    m.density = density;
    m.lambda = young * poisson / ((1 + poisson) * (1 - 2 * poisson));
    m.mu = young / (2 * (1 + poisson));
    m.c10 = m.mu / 2;
    m.d1 = 2 / sb_material_bulk(&m);
    return m;
}

SB_API sb_material sb_material_linear(sb_real young, sb_real poisson, sb_real density)
{
    return sbi_material_from_young(SB_LINEAR, young, poisson, density);
}

SB_API sb_material sb_material_corotated(sb_real young, sb_real poisson, sb_real density)
{
    return sbi_material_from_young(SB_COROTATED, young, poisson, density);
}

SB_API sb_material sb_material_corotated_invertible(sb_real young, sb_real poisson, sb_real density)
{
    return sbi_material_from_young(SB_COROTATED_INVERTIBLE, young, poisson, density);
}

SB_API sb_material sb_material_svk(sb_real young, sb_real poisson, sb_real density)
{
    return sbi_material_from_young(SB_SVK, young, poisson, density);
}

SB_API sb_material sb_material_neo_hookean(sb_real young, sb_real poisson, sb_real density)
{
    return sbi_material_from_young(SB_NEO_HOOKEAN, young, poisson, density);
}

SB_API sb_material sb_material_stable_neo_hookean(sb_real young, sb_real poisson, sb_real density)
{
    return sbi_material_from_young(SB_STABLE_NEO_HOOKEAN, young, poisson, density);
}

SB_API sb_material sb_material_neo_hookean_isochoric(sb_real c10, sb_real d1, sb_real density)
{
    sb_material m;
    memset(&m, 0, sizeof m);
    m.model = SB_NEO_HOOKEAN_ISOCHORIC;
    m.density = density;
    m.mu = 2 * c10;
    m.lambda = 2 / d1 - 2 * m.mu / 3;
    m.c10 = c10;
    m.d1 = d1;
    return m;
}

/* ---- check ---- */

static sb_result sbi_material_check_finite(const sb_material *m, sb_error *error)
{
    const char *const names[5] = {"density (kg/m^3)", "lambda (Pa)", "mu (Pa)", "c10 (Pa)", "d1 (1/Pa)"};
    const sb_real values[5] = {m->density, m->lambda, m->mu, m->c10, m->d1};
    int count = m->model == SB_NEO_HOOKEAN_ISOCHORIC ? 5 : 3;
    for (int i = 0; i < count; i++)
        if (!sb_is_finite(values[i]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE,
                            "material %s is %g, not finite (Poisson's ratio must be inside (-1, 0.5))",
                            names[i], (double)values[i]);
    return SB_OK;
}

/* c10, d1 > 0, and the Hooke limit that goes with them (1e-3: hand-written numbers are rounded). */
static sb_result sbi_material_check_isochoric(const sb_material *m, sb_error *error)
{
    sb_real tolerance = (sb_real)1e-3, mu = 2 * m->c10, bulk;
    if (!(m->c10 > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material c10 is %g Pa, must be > 0", (double)m->c10);
    if (!(m->d1 > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material d1 is %g 1/Pa, must be > 0", (double)m->d1);
    bulk = 2 / m->d1;
    if (sb_abs(m->mu - mu) > tolerance * mu)
        return sbi_fail(error, SB_ERROR_MATERIAL, "material mu is %g Pa, but 2 c10 is %g Pa", (double)m->mu,
                        (double)mu);
    if (sb_abs(sb_material_bulk(m) - bulk) > tolerance * bulk)
        return sbi_fail(error, SB_ERROR_MATERIAL, "material lambda + 2 mu/3 is %g Pa, but 2/d1 is %g Pa",
                        (double)sb_material_bulk(m), (double)bulk);
    return SB_OK;
}

/* mu > 0 and bulk > 0 are the same as young > 0 and Poisson's ratio in (-1, 0.5); the message names both
 * views. */
static sb_result sbi_material_check_moduli(const sb_material *m, sb_error *error)
{
    double young = (double)sb_material_young(m), poisson = (double)sb_material_poisson(m);
    if (!(m->mu > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL,
                        "material mu is %g Pa, must be > 0 (Young's modulus %g Pa, Poisson's ratio %g)",
                        (double)m->mu, young, poisson);
    if (!(sb_material_bulk(m) > 0) || !(poisson < 0.5))
        return sbi_fail(
            error, SB_ERROR_MATERIAL,
            "material has Poisson's ratio %g, must be inside (-1, 0.5) (bulk modulus %g Pa, mu %g Pa)",
            poisson, (double)sb_material_bulk(m), (double)m->mu);
    return SB_OK;
}

SB_API sb_result sb_material_check(const sb_material *material, sb_error *error)
{
    sb_result result;
    if (!material)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "material is NULL");
    if ((int)material->model < SB_LINEAR || (int)material->model > SB_STABLE_NEO_HOOKEAN)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "material model %d is unknown", (int)material->model);
    result = sbi_material_check_finite(material, error);
    if (result == SB_OK && !(material->density > 0))
        result = sbi_fail(error, SB_ERROR_MATERIAL, "material density is %g kg/m^3, must be > 0",
                          (double)material->density);
    if (result == SB_OK && material->model == SB_NEO_HOOKEAN_ISOCHORIC)
        result = sbi_material_check_isochoric(material, error);
    if (result == SB_OK)
        result = sbi_material_check_moduli(material, error);
    return result;
}

SB_API int sb_material_allows_inversion(sb_material_model model)
{
    switch (model) {
    case SB_LINEAR:
    case SB_COROTATED:
    case SB_COROTATED_INVERTIBLE:
    case SB_SVK:
    case SB_STABLE_NEO_HOOKEAN: return 1;
    case SB_NEO_HOOKEAN:
    case SB_NEO_HOOKEAN_ISOCHORIC:
    case SB_MOONEY_RIVLIN:
    case SB_REDUCED_POLYNOMIAL: return 0;
    }
    return 0;
}

SB_API int sb_material_is_linear(sb_material_model model) { return model == SB_LINEAR; }

/* ---- evaluation ---- */

static int sbi_material_all_finite(const sb_real *values, int count)
{
    for (int i = 0; i < count; i++)
        if (!sb_is_finite(values[i]))
            return 0;
    return 1;
}

SB_API int sb_material_energy(const sb_material *material, const sb_mat3 *F, sb_quat *rotation, sb_real *W)
{
    sb_quat q = rotation ? *rotation : sb_quat_identity();
    sb_real energy = 0;
    if (!material || !F || !W || !sbi_material_all_finite(F->m[0], 9) ||
        !sbi_material_energy_inline((int)material->model, material, F, &q, &energy) || !sb_is_finite(energy))
        return 0;
    *W = energy;
    if (rotation)
        *rotation = q;
    return 1;
}

SB_API int sb_material_stress(const sb_material *material, const sb_mat3 *F, sb_quat *rotation, sb_mat3 *P)
{
    sb_quat q = rotation ? *rotation : sb_quat_identity();
    sb_mat3 stress;
    if (!material || !F || !P || !sbi_material_all_finite(F->m[0], 9) ||
        !sbi_material_stress_inline((int)material->model, material, F, &q, &stress) ||
        !sbi_material_all_finite(stress.m[0], 9))
        return 0;
    *P = stress;
    if (rotation)
        *rotation = q;
    return 1;
}

SB_API int sb_material_tangent(const sb_material *material, const sb_mat3 *F, sb_quat *rotation,
                               sb_tangent_kind kind, sb_real A[81])
{
    sb_quat q = rotation ? *rotation : sb_quat_identity();
    sb_real tangent[81];
    if (!material || !F || !A || !sbi_material_all_finite(F->m[0], 9) ||
        !sbi_material_tangent_inline((int)material->model, material, F, &q, kind, tangent) ||
        !sbi_material_all_finite(tangent, 81))
        return 0;
    for (int i = 0; i < 81; i++)
        A[i] = tangent[i];
    if (rotation)
        *rotation = q;
    return 1;
}

SB_API sb_mat3 sb_cauchy_stress(sb_mat3 F, sb_mat3 P)
{
    return sb_m3_scale(1 / sb_m3_det(F), sb_m3_mult(P, F));
}

SB_API sb_mat3 sb_material_cauchy_stress(const sb_material *material, sb_mat3 F, sb_mat3 P)
{
    return material->model == SB_LINEAR ? P : sb_cauchy_stress(F, P);
}

SB_API sb_real sb_von_mises(sb_mat3 sigma)
{
    sb_mat3 deviator;
    sb_real largest = 0; /* scaled by, lest squares of large stresses overflow */
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            largest = sb_max(largest, sb_abs(sigma.m[i][j]));
    if (!(largest > 0) || !sb_is_finite(largest))
        return largest;
    sigma = sb_m3_scale(1 / largest, sigma);
    deviator = sbi_material_affine(1, sigma, -sb_m3_trace(sigma) / 3);
    return largest * sb_sqrt((sb_real)1.5 * sb_m3_ddot(deviator, deviator));
}

/* ---- shares ---- */

static void sbi_material_scale_shear(sb_material *m, sb_real factor)
{
    m->mu *= factor;
    m->c10 *= factor;
    m->c01 *= factor;
    m->c20 *= factor;
    m->c30 *= factor;
    m->fibre_stiffness *= factor;
}

SBI_API sb_material sbi_material_share_of(const sb_material *material, sbi_material_share share)
{
    sb_material m = *material;
    if (share == SBI_SHARE_SHEAR) {
        m.lambda = 0;
        m.d1 = SB_REAL_MAX; /* its reciprocal is what counts */
    }
    if (share == SBI_SHARE_VOLUME)
        sbi_material_scale_shear(&m, 0);
    return m;
}

SBI_API sb_material sbi_material_relaxing(const sb_material *material)
{
    sb_material m = *material;
    m.lambda = -2 * m.mu / 3;
    m.d1 = SB_REAL_MAX;
    return m;
}

SBI_API sb_material sbi_material_relaxed(const sb_material *material, sb_real a)
{
    sb_material m = *material;
    sb_real bulk = sb_material_bulk(material);
    sbi_material_scale_shear(&m, a);
    m.lambda = bulk - 2 * m.mu / 3;
    return m;
}

SBI_API sb_real sbi_prony_term(const sb_material *material, int term, sb_real dt, sb_real *decay)
{
    sb_real x = dt / material->prony_tau[term];
    *decay = sb_exp(-x);
    return sbi_material_mean_decay(x);
}

SBI_API sb_real sbi_prony_factor(const sb_material *material, sb_real dt)
{
    sb_real factor = 1, decay;
    for (int i = 0; i < material->prony_count; i++)
        factor -= material->prony_g[i] * (1 - sbi_prony_term(material, i, dt, &decay));
    return factor;
}

SBI_API void sbi_prony_advance(const sb_material *material, sb_real dt, const sb_real s0_old[6],
                               const sb_real s0_new[6], sb_real (*h)[6])
{
    for (int i = 0; i < material->prony_count; i++) {
        sb_real decay, taken = material->prony_g[i] * sbi_prony_term(material, i, dt, &decay);
        for (int k = 0; k < 6; k++)
            h[i][k] = decay * h[i][k] + taken * (s0_new[k] - s0_old[k]);
    }
}

SBI_API void sbi_prony_prestress(const sb_material *material, sb_real dt, const sb_real s0_old[6],
                                 const sb_real (*h)[6], sb_real H[6])
{
    for (int k = 0; k < 6; k++)
        H[k] = 0;
    for (int i = 0; i < material->prony_count; i++) {
        sb_real decay, taken = material->prony_g[i] * sbi_prony_term(material, i, dt, &decay);
        for (int k = 0; k < 6; k++)
            H[k] += decay * h[i][k] - taken * s0_old[k];
    }
}
