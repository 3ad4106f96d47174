/* material: constructors, checks, and the evaluation that chooses the model at run time. */
#include "material_models.h"

#include <string.h>

/* ---- constants ---- */

SB_API sb_real sb_material_bulk(const sb_material *material)
{
    if (!material)
        return 0;
    return material->lambda + 2 * material->mu / 3;
}

SB_API sb_real sb_material_young(const sb_material *material)
{
    sb_real lambda, mu;
    if (!material)
        return 0;
    lambda = material->lambda, mu = material->mu;
    return mu * (3 * lambda + 2 * mu) / (lambda + mu);
}

SB_API sb_real sb_material_poisson(const sb_material *material)
{
    if (!material)
        return 0;
    return material->lambda / (2 * (material->lambda + material->mu));
}

/* ---- constructors ---- */

static sb_material sbi_material_from_young(sb_material_model model, sb_real young, sb_real poisson, sb_real density)
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

static sb_material sbi_material_isochoric(sb_material_model model, sb_real c10, sb_real c01, sb_real d1,
                                          sb_real density)
{
    sb_material m;
    memset(&m, 0, sizeof m);
    m.model = model;
    m.density = density;
    m.mu = 2 * (c10 + c01);
    m.lambda = 2 / d1 - 2 * m.mu / 3;
    m.c10 = c10;
    m.c01 = c01;
    m.d1 = d1;
    return m;
}

SB_API sb_material sb_material_neo_hookean_isochoric(sb_real c10, sb_real d1, sb_real density)
{
    return sbi_material_isochoric(SB_NEO_HOOKEAN_ISOCHORIC, c10, 0, d1, density);
}

SB_API sb_material sb_material_mooney_rivlin(sb_real c10, sb_real c01, sb_real d1, sb_real density)
{
    return sbi_material_isochoric(SB_MOONEY_RIVLIN, c10, c01, d1, density);
}

SB_API sb_material sb_material_reduced_polynomial(sb_real c10, sb_real c20, sb_real c30, sb_real d1, sb_real density)
{
    sb_material m = sbi_material_isochoric(SB_REDUCED_POLYNOMIAL, c10, 0, d1, density);
    m.c20 = c20;
    m.c30 = c30;
    return m;
}

SB_API sb_material sb_material_ogden(const sb_real *mu, const sb_real *alpha, int terms, sb_real d1, sb_real density)
{
    sb_real sum = 0;
    int given = mu && alpha && terms >= 1 && terms <= SB_MAX_OGDEN_TERMS ? terms : 0;
    sb_material m;
    for (int i = 0; i < given; i++)
        sum += mu[i] * alpha[i];
    m = sbi_material_isochoric(SB_OGDEN, sum / 4, 0, d1, density);
    for (int i = 0; i < given; i++) {
        m.ogden_mu[i] = mu[i];
        m.ogden_alpha[i] = alpha[i];
    }
    return m;
}

SB_API sb_material sb_material_fung(sb_real c10, sb_real exponent, sb_real d1, sb_real density)
{
    sb_material m = sbi_material_isochoric(SB_FUNG, c10, 0, d1, density);
    m.fung_exponent = exponent;
    return m;
}

SB_API sb_material sb_material_custom(const sb_material_law *law, sb_real bulk, sb_real density)
{
    sb_real law_bulk = 0, mu = 0;
    sb_material m;
    memset(&m, 0, sizeof m);
    sbi_law_moduli(law, &law_bulk, &mu);
    m.model = SB_CUSTOM_LAW;
    m.density = density;
    m.law = law;
    m.law_scale = 1;
    m.mu = mu;
    m.c10 = mu / 2;
    m.lambda = law_bulk + bulk - 2 * mu / 3;
    m.d1 = bulk == 0 ? SB_REAL_MAX : 2 / bulk;
    return m;
}

SB_API sb_material sb_material_with_fibres(sb_material material, sb_real k1, sb_real k2)
{
    material.fibre_stiffness = k1;
    material.fibre_exponent = k2;
    return material;
}

SB_API sb_material sb_material_with_dispersion(sb_material material, sb_real kappa)
{
    material.fibre_dispersion = kappa;
    return material;
}

SB_API sb_material sb_material_with_contraction(sb_material material, sb_real tension, sb_real optimum, sb_real width)
{
    material.fibre_tension = tension;
    material.fibre_optimum = optimum;
    material.fibre_width = width;
    return material;
}

SB_API sb_material sb_material_with_prestretch(sb_material material, sb_mat3 G)
{
    const sb_mat3 one = sb_m3_identity(), none = sb_m3_zero();
    material.prestretch = memcmp(&G, &one, sizeof G) == 0 ? none : G;
    if (memcmp(&G, &none, sizeof G) == 0) /* which stands for none: kept apart, to be refused for its determinant */
        material.prestretch.m[0][0] = SB_EPSILON;
    return material;
}

/* A count out of range is kept for sb_material_check to refuse; NULL counts as one. */
SB_API sb_material sb_material_with_prony(sb_material material, const sb_real *g, const sb_real *tau, int count)
{
    material.prony_count = count > 0 && (!g || !tau) ? -1 : count;
    for (int i = 0; i < SB_MAX_PRONY_TERMS; i++) {
        int given = i < material.prony_count;
        material.prony_g[i] = given ? g[i] : 0;
        material.prony_tau[i] = given ? tau[i] : 0;
    }
    return material;
}

/* ---- presets ---- */

SB_API sb_material sb_material_preset(sb_preset preset, sb_real density)
{
    const sb_real jordan[2] = {(sb_real)0.832, (sb_real)0.15};
    const sb_real raghunathan[2][3] = {{(sb_real)0.503, (sb_real)0.185, (sb_real)0.142},
                                       {(sb_real)2.1, (sb_real)47.1, (sb_real)380}};
    const sb_real kim[2][2] = {{(sb_real)0.2866, (sb_real)0.2022}, {(sb_real)1.537, (sb_real)6.09}};
    const sb_real d1 = (sb_real)8.38e-4;
    sb_material m;
    memset(&m, 0, sizeof m);
    switch (preset) {
    case SB_LIVER_JORDAN:
        m = sb_material_reduced_polynomial((sb_real)79.2, 257, 0, (sb_real)4.38e-4, density);
        return sb_material_with_prony(m, &jordan[0], &jordan[1], 1);
    case SB_LIVER_RAGHUNATHAN:
        m = sb_material_reduced_polynomial((sb_real)397.7, (sb_real)208.6, 0, d1, density);
        return sb_material_with_prony(m, raghunathan[0], raghunathan[1], 3);
    case SB_LIVER_KIM:
        m = sb_material_mooney_rivlin((sb_real)322.96, (sb_real)161.47, (sb_real)1e-5, density);
        return sb_material_with_prony(m, kim[0], kim[1], 2);
    case SB_LIVER_NEO_HOOKEAN: return sb_material_neo_hookean_isochoric(365, d1, density);
    case SB_LIVER_LINEAR: return sb_material_linear(1987, (sb_real)0.36, density);
    }
    return m;
}

/* ---- check ---- */

static int sbi_material_is_isochoric(sb_material_model model)
{
    return model == SB_NEO_HOOKEAN_ISOCHORIC || ((int)model >= (int)SB_MOONEY_RIVLIN && model != SB_CUSTOM_LAW);
}

static sb_result sbi_material_check_finite(const sb_material *m, sb_error *error)
{
    const char *const names[8] = {"density (kg/m^3)", "lambda (Pa)", "mu (Pa)",  "c10 (Pa)",
                                  "d1 (1/Pa)",        "c01 (Pa)",    "c20 (Pa)", "c30 (Pa)"};
    const sb_real values[8] = {m->density, m->lambda, m->mu, m->c10, m->d1, m->c01, m->c20, m->c30};
    for (int i = 0; i < 8; i++) {
        int read = i < 3 || (i < 5 && sbi_material_is_isochoric(m->model)) || (i == 4 && m->model == SB_CUSTOM_LAW) ||
                   (i == 5 && m->model == SB_MOONEY_RIVLIN) || (i > 5 && m->model == SB_REDUCED_POLYNOMIAL);
        if (read && !sb_is_finite(values[i]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE,
                            "material %s is %g, not finite (Poisson's ratio must be inside (-1, 0.5))", names[i],
                            (double)values[i]);
    }
    if (m->model == SB_FUNG && !sb_is_finite(m->fung_exponent))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "material Fung exponent is %g, not finite",
                        (double)m->fung_exponent);
    for (int i = 0; m->model == SB_OGDEN && i < SB_MAX_OGDEN_TERMS; i++)
        if (!sb_is_finite(m->ogden_mu[i]) || !sb_is_finite(m->ogden_alpha[i]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "material Ogden term %d has mu %g Pa and alpha %g, not finite",
                            i, (double)m->ogden_mu[i], (double)m->ogden_alpha[i]);
    return SB_OK;
}

/* The exponents of Fung's and Ogden's models. */
static sb_result sbi_material_check_exponents(const sb_material *m, sb_error *error)
{
    if (m->model == SB_FUNG && m->fung_exponent < 0)
        return sbi_fail(error, SB_ERROR_MATERIAL, "material Fung exponent is %g, must be >= 0",
                        (double)m->fung_exponent);
    for (int i = 0; m->model == SB_OGDEN && i < SB_MAX_OGDEN_TERMS; i++)
        if (sb_abs(m->ogden_mu[i]) > 0 && !(sb_abs(m->ogden_alpha[i]) > 0))
            return sbi_fail(error, SB_ERROR_MATERIAL, "material Ogden term %d has mu %g Pa, but alpha 0", i,
                            (double)m->ogden_mu[i]);
    return SB_OK;
}

/* Half of the shear modulus that an isochoric model's constants give, and what to call it. */
static sb_real sbi_material_half_mu(const sb_material *m, const char **name)
{
    sb_real sum = 0;
    *name = m->model == SB_OGDEN ? "(sum of mu_i alpha_i)/4" : m->model == SB_MOONEY_RIVLIN ? "c10 + c01" : "c10";
    if (m->model != SB_OGDEN)
        return m->model == SB_MOONEY_RIVLIN ? m->c10 + m->c01 : m->c10;
    for (int i = 0; i < SB_MAX_OGDEN_TERMS; i++)
        sum += m->ogden_mu[i] * m->ogden_alpha[i];
    return sum / 4;
}

/* 2 (c10 + c01) > 0 and d1 > 0, and the Hooke limit that goes with them (1e-3: hand-written numbers are rounded). */
static sb_result sbi_material_check_isochoric(const sb_material *m, sb_error *error)
{
    const sb_real tolerance = (sb_real)1e-3;
    int mooney = m->model == SB_MOONEY_RIVLIN;
    const char *name;
    sb_real sum = sbi_material_half_mu(m, &name), mu = 2 * sum, bulk;
    if (!(sum > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material %s is %g Pa, must be > 0", name, (double)sum);
    if (!(m->d1 > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material d1 is %g 1/Pa, must be > 0", (double)m->d1);
    bulk = 2 / m->d1;
    if (sb_abs(m->mu - mu) > tolerance * mu)
        return sbi_fail(error, SB_ERROR_MATERIAL, "material mu is %g Pa, but 2 %s%s%s is %g Pa", (double)m->mu,
                        mooney ? "(" : "", name, mooney ? ")" : "", (double)mu);
    if (sb_abs(sb_material_bulk(m) - bulk) > tolerance * bulk)
        return sbi_fail(error, SB_ERROR_MATERIAL, "material lambda + 2 mu/3 is %g Pa, but 2/d1 is %g Pa",
                        (double)sb_material_bulk(m), (double)bulk);
    return SB_OK;
}

static sb_result sbi_material_check_fibres(const sb_material *m, sb_error *error)
{
    if (!sb_is_finite(m->fibre_stiffness) || !sb_is_finite(m->fibre_exponent))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "material fibres have k1 %g Pa and k2 %g, not finite",
                        (double)m->fibre_stiffness, (double)m->fibre_exponent);
    if (m->fibre_stiffness < 0 || m->fibre_exponent < 0)
        return sbi_fail(error, SB_ERROR_MATERIAL, "material fibres have k1 %g Pa and k2 %g, must be >= 0",
                        (double)m->fibre_stiffness, (double)m->fibre_exponent);
    if (!sb_is_finite(m->fibre_dispersion) || !sb_is_finite(m->fibre_tension) || !sb_is_finite(m->fibre_optimum) ||
        !sb_is_finite(m->fibre_width))
        return sbi_fail(error, SB_ERROR_NOT_FINITE,
                        "material fibres have dispersion %g, tension %g Pa, optimum %g and width %g, not finite",
                        (double)m->fibre_dispersion, (double)m->fibre_tension, (double)m->fibre_optimum,
                        (double)m->fibre_width);
    if (m->fibre_dispersion < 0 || 3 * m->fibre_dispersion > 1 + 4 * SB_EPSILON)
        return sbi_fail(error, SB_ERROR_MATERIAL, "material fibres have dispersion %g, must be in [0, 1/3]",
                        (double)m->fibre_dispersion);
    if (m->fibre_tension < 0 || m->fibre_width < 0 || (m->fibre_width > 0 && !(m->fibre_optimum > 0)))
        return sbi_fail(error, SB_ERROR_MATERIAL,
                        "material fibres have tension %g Pa, width %g and optimum %g, must be >= 0 (the optimum > 0)",
                        (double)m->fibre_tension, (double)m->fibre_width, (double)m->fibre_optimum);
    if (sbi_material_has_fibres(m) && !sb_material_is_hyperelastic(m->model))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material has fibres, but the %s model is not hyperelastic",
                        m->model == SB_LINEAR ? "linear" : "corotated");
    return SB_OK;
}

SBI_API sb_result sbi_material_check_prestretch(const sb_material *m, int any_model, sb_error *error)
{
    const sb_real *g = m->prestretch.m[0];
    sb_real det = sb_m3_det(m->prestretch);
    int zero = 1, finite = 1;
    for (int i = 0; i < 9; i++) {
        zero = zero && g[i] == 0;
        finite = finite && sb_is_finite(g[i]);
    }
    if (zero)
        return SB_OK;
    if (!finite || !sb_is_finite(det) || (det > 0 && !sb_is_finite(1 / det)))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "material prestretch has the determinant %g", (double)det);
    if (!(det > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material prestretch has the determinant %g, must be > 0",
                        (double)det);
    if (!any_model && !sb_material_is_hyperelastic(m->model))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material has a prestretch, but the %s model is not hyperelastic",
                        m->model == SB_LINEAR ? "linear" : "corotated");
    return SB_OK;
}

static sb_result sbi_material_check_prony(const sb_material *m, sb_error *error)
{
    sb_real sum = 0;
    if (m->prony_count < 0 || m->prony_count > SB_MAX_PRONY_TERMS)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "material has %d Prony terms, must be 0 to %d", m->prony_count,
                        (int)SB_MAX_PRONY_TERMS);
    if (m->prony_count > 0 && !sb_material_is_hyperelastic(m->model))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material has Prony terms, but the %s model is not hyperelastic",
                        m->model == SB_LINEAR ? "linear" : "corotated");
    for (int i = 0; i < m->prony_count; i++) {
        sb_real g = m->prony_g[i], tau = m->prony_tau[i];
        if (!sb_is_finite(g) || !sb_is_finite(tau))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "material Prony term %d has g %g and tau %g s, not finite", i,
                            (double)g, (double)tau);
        if (!(g > 0 && g < 1))
            return sbi_fail(error, SB_ERROR_MATERIAL, "material Prony term %d has g %g, must be inside (0, 1)", i,
                            (double)g);
        if (!(tau > 0))
            return sbi_fail(error, SB_ERROR_MATERIAL, "material Prony term %d has tau %g s, must be > 0", i,
                            (double)tau);
        sum += g;
    }
    if (!(sum < 1))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material Prony terms have a sum of g of %g, must be < 1",
                        (double)sum);
    return SB_OK;
}

/* mu > 0 and bulk > 0 are the same as young > 0 and Poisson's ratio in (-1, 0.5); the message names both
 * views. */
static sb_result sbi_material_check_moduli(const sb_material *m, sb_error *error)
{
    double young = (double)sb_material_young(m), poisson = (double)sb_material_poisson(m);
    if (!(m->mu > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL,
                        "material mu is %g Pa, must be > 0 (Young's modulus %g Pa, Poisson's ratio %g)", (double)m->mu,
                        young, poisson);
    if (!(sb_material_bulk(m) > 0) || !(poisson < 0.5))
        return sbi_fail(error, SB_ERROR_MATERIAL,
                        "material has Poisson's ratio %g, must be inside (-1, 0.5) (bulk modulus %g Pa, mu %g Pa)",
                        poisson, (double)sb_material_bulk(m), (double)m->mu);
    return SB_OK;
}

SB_API sb_result sb_material_check(const sb_material *material, sb_error *error)
{
    sb_result result;
    if (!material)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "material is NULL");
    if ((int)material->model < SB_LINEAR || (int)material->model > SBI_LAST_MODEL)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "material model %d is unknown", (int)material->model);
    result = material->model == SB_CUSTOM_LAW ? sbi_law_check_calls(material, error) : SB_OK;
    if (result == SB_OK)
        result = sbi_material_check_finite(material, error);
    if (result == SB_OK && !(material->density > 0))
        result =
            sbi_fail(error, SB_ERROR_MATERIAL, "material density is %g kg/m^3, must be > 0", (double)material->density);
    if (result == SB_OK && sbi_material_is_isochoric(material->model))
        result = sbi_material_check_isochoric(material, error);
    if (result == SB_OK)
        result = sbi_material_check_exponents(material, error);
    if (result == SB_OK && material->model == SB_CUSTOM_LAW)
        result = sbi_law_check_constants(material, error);
    if (result == SB_OK)
        result = sbi_material_check_moduli(material, error);
    if (result == SB_OK)
        result = sbi_material_check_fibres(material, error);
    if (result == SB_OK)
        result = sbi_material_check_prestretch(material, 0, error);
    if (result == SB_OK)
        result = sbi_material_check_prony(material, error);
    if (result == SB_OK && material->model == SB_CUSTOM_LAW)
        result = sbi_law_check(material, error);
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
    case SB_REDUCED_POLYNOMIAL:
    case SB_OGDEN:
    case SB_FUNG:
    case SB_CUSTOM_LAW: return 0;
    }
    return 0;
}

SB_API int sb_material_is_linear(sb_material_model model) { return model == SB_LINEAR; }

SB_API int sb_material_is_hyperelastic(sb_material_model model)
{
    return (int)model >= SB_SVK && (int)model <= SBI_LAST_MODEL;
}

/* ---- evaluation ---- */

/* What a model is evaluated at: F, or F G of a material that is strained at rest. */
static sb_mat3 sbi_material_strain(const sb_material *material, const sb_mat3 *F)
{
    return sbi_material_is_prestretched(material) ? sbi_prestretch_before(material, F) : *F;
}

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
    sb_mat3 f;
    if (!material || !F || !W || !sbi_material_all_finite(F->m[0], 9))
        return 0;
    f = sbi_material_strain(material, F);
    if (!sbi_model_energy((int)material->model, material, &f, &q, &energy))
        return 0;
    if (sbi_material_is_prestretched(material))
        energy /= sb_m3_det(material->prestretch);
    if (!sb_is_finite(energy))
        return 0;
    *W = energy;
    if (rotation)
        *rotation = q;
    return 1;
}

SB_API int sb_material_stress(const sb_material *material, const sb_mat3 *F, sb_quat *rotation, sb_mat3 *P)
{
    sb_quat q = rotation ? *rotation : sb_quat_identity();
    sb_mat3 stress, f;
    if (!material || !F || !P || !sbi_material_all_finite(F->m[0], 9))
        return 0;
    f = sbi_material_strain(material, F);
    if (!sbi_model_stress((int)material->model, material, &f, &q, &stress))
        return 0;
    if (sbi_material_is_prestretched(material))
        stress = sbi_prestretch_stress(material, stress);
    if (!sbi_material_all_finite(stress.m[0], 9))
        return 0;
    *P = stress;
    if (rotation)
        *rotation = q;
    return 1;
}

SB_API int sb_material_tangent(const sb_material *material, const sb_mat3 *F, sb_quat *rotation, sb_tangent_kind kind,
                               sb_real A[81])
{
    sb_quat q = rotation ? *rotation : sb_quat_identity();
    sb_real tangent[81], turned[81] = {0}, *found = tangent;
    sb_mat3 f;
    if (!material || !F || !A || !sbi_material_all_finite(F->m[0], 9))
        return 0;
    f = sbi_material_strain(material, F);
    if (!sbi_model_tangent((int)material->model, material, &f, &q, kind, tangent))
        return 0;
    if (sbi_material_is_prestretched(material)) {
        sbi_prestretch_add_tangent(material, tangent, turned);
        found = turned;
    }
    if (!sbi_material_all_finite(found, 81))
        return 0;
    for (int i = 0; i < 81; i++)
        A[i] = found[i];
    if (rotation)
        *rotation = q;
    return 1;
}

/* ---- fibres ---- */

/* 1 when the arguments of a fibre call are in order; *unit = the direction at length 1. */
static int sbi_fibre_admits(const sb_material *material, const sb_mat3 *F, sb_vec3 direction, sb_vec3 *unit)
{
    sb_real largest = sb_max(sb_max(sb_abs(direction.x), sb_abs(direction.y)), sb_abs(direction.z));
    if (!material || !F || !sbi_material_all_finite(F->m[0], 9) || !sb_v3_is_finite(direction) || !(largest > 0))
        return 0;
    /* By the largest component first, lest squares overflow. */
    direction = sb_v3(direction.x / largest, direction.y / largest, direction.z / largest);
    *unit = sb_v3_scale(1 / sb_v3_norm(direction), direction);
    return 1;
}

SB_API int sb_fibre_energy(const sb_material *material, const sb_mat3 *F, sb_vec3 direction, sb_real *W)
{
    sb_vec3 unit;
    sb_real energy = 0;
    if (!W || !sbi_fibre_admits(material, F, direction, &unit) || !sbi_fibre_energy(material, F, unit, &energy))
        return 0;
    *W += energy;
    return 1;
}

SB_API int sb_fibre_stress(const sb_material *material, const sb_mat3 *F, sb_vec3 direction, sb_mat3 *P)
{
    sb_vec3 unit;
    sb_mat3 stress = sb_m3_zero();
    if (!P || !sbi_fibre_admits(material, F, direction, &unit) || !sbi_fibre_stress(material, F, unit, &stress) ||
        !sbi_material_all_finite(stress.m[0], 9))
        return 0;
    *P = sb_m3_add(*P, stress);
    return 1;
}

SB_API int sb_fibre_tangent(const sb_material *material, const sb_mat3 *F, sb_vec3 direction, sb_real A[81])
{
    sb_vec3 unit;
    sb_real tangent[81] = {0};
    if (!A || !sbi_fibre_admits(material, F, direction, &unit) ||
        !sbi_fibre_tangent(material, F, unit, SB_TANGENT_EXACT, tangent) || !sbi_material_all_finite(tangent, 81))
        return 0;
    for (int i = 0; i < 81; i++)
        A[i] += tangent[i];
    return 1;
}

/* ---- stress measures ---- */

SB_API sb_mat3 sb_cauchy_stress(sb_mat3 F, sb_mat3 P) { return sb_m3_scale(1 / sb_m3_det(F), sb_m3_mult(P, F)); }

SB_API sb_mat3 sb_material_cauchy_stress(const sb_material *material, sb_mat3 F, sb_mat3 P)
{
    if (!material)
        return sb_m3_zero();
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
    for (int i = 0; i < SB_MAX_OGDEN_TERMS; i++)
        m->ogden_mu[i] *= factor;
    m->law_scale *= factor;
    m->fibre_stiffness *= factor;
}

SBI_API sb_material sbi_material_scaled(const sb_material *material, sb_real factor)
{
    sb_material m = *material;
    sbi_material_scale_shear(&m, factor);
    m.lambda *= factor;
    m.d1 = m.d1 / SB_REAL_MAX < factor ? m.d1 / factor : SB_REAL_MAX; /* which a law without a bulk term has */
    return m;
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
    m.fibre_tension = 0;
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

/* Rows and columns of the six components. */
static const int sbi_voigt_row[6] = {0, 1, 2, 0, 1, 0}, sbi_voigt_column[6] = {0, 1, 2, 1, 2, 2};

/* S0 = F^-1 P, symmetric but for rounding. */
SBI_API int sbi_prony_instant(const sb_material *relaxing, const sb_mat3 *F, const sb_vec3 *fibre, sb_real s0[6])
{
    sb_mat3 p;
    sb_real J = sb_m3_det(*F), stress[6];
    if (!(sb_abs(J) > 0) || !sb_material_stress(relaxing, F, NULL, &p) ||
        (fibre && !sb_fibre_stress(relaxing, F, *fibre, &p)))
        return 0;
    p = sb_m3_mul(sb_m3_inverse(*F), p);
    for (int k = 0; k < 6; k++) {
        int i = sbi_voigt_row[k], j = sbi_voigt_column[k];
        stress[k] = (sb_real)0.5 * (p.m[i][j] + p.m[j][i]);
    }
    if (!sbi_material_all_finite(stress, 6))
        return 0;
    for (int k = 0; k < 6; k++)
        s0[k] = stress[k];
    return 1;
}

/* ---- relaxation of one point ---- */

SB_API sb_real sb_material_relaxation(const sb_material *material, sb_real time)
{
    sb_real left = 1;
    if (!material)
        return 0;
    for (int i = 0; i < sbi_min_int(material->prony_count, SB_MAX_PRONY_TERMS) && time > 0; i++)
        left -= material->prony_g[i] * (1 - sb_exp(-time / material->prony_tau[i]));
    return left;
}

SB_API void sb_material_shear_moduli(const sb_material *material, sb_real omega, sb_real *storage, sb_real *loss)
{
    sb_real held = 1, lost = 0, mu = material ? material->mu : 0;
    for (int i = 0; material && i < sbi_min_int(material->prony_count, SB_MAX_PRONY_TERMS); i++) {
        sb_real x = omega * material->prony_tau[i];
        held -= material->prony_g[i] / (1 + x * x);
        if (x > 0)
            lost += material->prony_g[i] / (x + 1 / x); /* right for infinite x, too */
    }
    if (storage)
        *storage = mu * held;
    if (loss)
        *loss = mu * lost;
}

/* Stress at the end of a step: of the elastic material that is left of it, and of what it remembers. */
static int sbi_material_history_total(const sb_material *material, const sb_material_history *history, const sb_mat3 *F,
                                      sb_real dt, const sb_vec3 *fibre, sb_mat3 *P)
{
    sb_material left = sbi_material_relaxed(material, sbi_prony_factor(material, dt));
    sb_real prestress[6];
    sb_mat3 remembered, stress;
    if (!sb_material_stress(&left, F, NULL, &stress) || (fibre && !sb_fibre_stress(&left, F, *fibre, &stress)))
        return 0;
    sbi_prony_prestress(material, dt, history->stress, (const sb_real(*)[6])history->memory, prestress);
    for (int k = 0; k < 6; k++) {
        int i = sbi_voigt_row[k], j = sbi_voigt_column[k];
        remembered.m[i][j] = remembered.m[j][i] = prestress[k];
    }
    *P = sb_m3_add(stress, sb_m3_mul(*F, remembered));
    return sbi_material_all_finite(P->m[0], 9);
}

SB_API int sb_material_history_stress(const sb_material *material, sb_material_history *history, const sb_mat3 *F,
                                      sb_real dt, const sb_vec3 *fibre, sb_mat3 *P)
{
    sb_material relaxing;
    sb_real s0[6];
    sb_mat3 stress;
    if (!material || !history || !F || !P || !(dt >= 0) || material->prony_count < 0 ||
        material->prony_count > SB_MAX_PRONY_TERMS ||
        (material->prony_count > 0 && !sb_material_is_hyperelastic(material->model)))
        return 0;
    if (material->prony_count == 0) {
        if (!sb_material_stress(material, F, NULL, &stress) ||
            (fibre && !sb_fibre_stress(material, F, *fibre, &stress)))
            return 0;
        *P = stress;
        return 1;
    }
    relaxing = sbi_material_relaxing(material);
    if (!sbi_prony_instant(&relaxing, F, fibre, s0) ||
        !sbi_material_history_total(material, history, F, dt, fibre, &stress))
        return 0;
    sbi_prony_advance(material, dt, history->stress, s0, history->memory);
    for (int k = 0; k < 6; k++)
        history->stress[k] = s0[k];
    *P = stress;
    return 1;
}
