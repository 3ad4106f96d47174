/* material_law: the caller's energy, stress and tangent, their derivatives by differences, and what is refused. */
#include "material_law.h"

#include "../base/eigen.h"
#include "material_models.h"

#include <string.h>

/* ---- evaluation ---- */

/* U = (J - 1)^2/d1 is lambda/2 (J - 1)^2 of the stable neo-Hookean model without shear. */
static sb_material sbi_law_volume(const sb_material *material)
{
    sb_material volume = *material;
    volume.mu = 0;
    volume.lambda = 2 / material->d1;
    return volume;
}

static int sbi_law_has_calls(const sb_material_law *law) { return law && law->energy && law->stress; }

SBI_API int sbi_law_energy(const sb_material *material, const sb_mat3 *F, sb_real *W)
{
    const sb_material_law *law = material->law;
    sb_material volume = sbi_law_volume(material);
    sb_real own = 0;
    if (material->law_scale > 0 && (!sbi_law_has_calls(law) || !law->energy(law->user, F, &own)))
        return 0;
    *W = material->law_scale * own + sbi_stable_energy(&volume, F);
    return 1;
}

SBI_API int sbi_law_stress(const sb_material *material, const sb_mat3 *F, sb_mat3 *P)
{
    const sb_material_law *law = material->law;
    sb_material volume = sbi_law_volume(material);
    sb_mat3 own = sb_m3_zero();
    if (material->law_scale > 0 && (!sbi_law_has_calls(law) || !law->stress(law->user, F, &own)))
        return 0;
    *P = sb_m3_add(sb_m3_scale(material->law_scale, own), sbi_stable_stress(&volume, F));
    return 1;
}

/* A step of differences at F: the cube root of rounding balances it against the third derivative. */
static sb_real sbi_law_step(const sb_mat3 *F)
{
    sb_real largest = 1;
    for (int i = 0; i < 9; i++)
        largest = sb_max(largest, sb_abs(F->m[i / 3][i % 3]));
    return sb_cbrt(SB_EPSILON) * largest;
}

/* Column of A: the stress's difference over +-h of entry k of F, over one side of it where the law has no other. */
static int sbi_law_difference(const sb_material_law *law, const sb_mat3 *F, int k, sb_real h, sb_real *column)
{
    sb_mat3 low = *F, high = *F, before, after;
    sb_real width;
    low.m[k / 3][k % 3] -= h;
    high.m[k / 3][k % 3] += h;
    if (!law->stress(law->user, &low, &before)) {
        low = *F;
        if (!law->stress(law->user, &low, &before))
            return 0;
    }
    if (!law->stress(law->user, &high, &after)) {
        high = *F;
        if (!law->stress(law->user, &high, &after))
            return 0;
    }
    width = high.m[k / 3][k % 3] - low.m[k / 3][k % 3];
    if (!(width > 0))
        return 0;
    for (int i = 0; i < 9; i++)
        column[i] = (after.m[i / 3][i % 3] - before.m[i / 3][i % 3]) / width;
    return 1;
}

/* The law's tangent, by differences where it has none, as it comes. */
static int sbi_law_own_tangent(const sb_material_law *law, const sb_mat3 *F, sb_real *A)
{
    sb_real column[9], h = sbi_law_step(F);
    if (!sbi_law_has_calls(law))
        return 0;
    if (law->tangent)
        return law->tangent(law->user, F, A);
    for (int k = 0; k < 9; k++) {
        if (!sbi_law_difference(law, F, k, h, column))
            return 0;
        for (int i = 0; i < 9; i++)
            A[9 * i + k] = column[i];
    }
    return 1;
}

SBI_API int sbi_law_project(sb_real *A)
{
    double a[81], values[9], vectors[81], scratch[18];
    if (sbi_tangent_is_semidefinite(A))
        return 1;
    for (int i = 0; i < 81; i++)
        a[i] = (double)A[i];
    if (!sbi_symmetric_eigen(a, 9, values, vectors, scratch))
        return 0;
    for (int k = 0; k < 9 && values[k] < 0; k++) {
        sb_mat3 mode;
        for (int i = 0; i < 9; i++)
            mode.m[i / 3][i % 3] = (sb_real)vectors[9 * k + i];
        sbi_tangent_add_dyad(A, (sb_real)-values[k], mode);
    }
    return 1;
}

SBI_API int sbi_law_tangent(const sb_material *material, const sb_mat3 *F, sb_tangent_kind kind, sb_real *A)
{
    sb_material volume = sbi_law_volume(material);
    sb_real own[81];
    memset(own, 0, sizeof own);
    if (material->law_scale > 0 && !sbi_law_own_tangent(material->law, F, own))
        return 0;
    sbi_stable_tangent(&volume, F, A);
    for (int p = 0; p < 9; p++)
        for (int q = p; q < 9; q++)
            A[9 * p + q] = A[9 * q + p] =
                A[9 * p + q] + (sb_real)0.5 * material->law_scale * (own[9 * p + q] + own[9 * q + p]);
    return kind == SB_TANGENT_EXACT || sbi_law_project(A);
}

SBI_API void sbi_law_moduli(const sb_material_law *law, sb_real *bulk, sb_real *mu)
{
    sb_mat3 identity = sb_m3_identity();
    sb_real A[81], trace = 0, own = 0;
    if (!sbi_law_own_tangent(law, &identity, A))
        return;
    for (int i = 0; i < 9; i++)
        own += A[10 * i];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            trace += A[9 * (4 * i) + 4 * j];
    *bulk = trace / 9;
    *mu = (3 * own - trace) / 30;
}

SBI_API sb_real sbi_law_mark(const sb_material_law *law)
{
    unsigned hash = 2166136261u; /* FNV-1a */
    if (!law || !law->name)
        return 0;
    for (const char *c = law->name; *c; c++)
        hash = (hash ^ (unsigned char)*c) * 16777619u;
    return (sb_real)((hash >> 8 & 0xffffffu) | 1u);
}

/* ---- check ---- */

/* Half the digits, and some. */
static sb_real sbi_law_tolerance(void) { return 16 * sb_sqrt(SB_EPSILON); }

/* Moduli of the law alone (Pa). */
static sb_result sbi_law_check_moduli(const sb_material_law *law, sb_error *error)
{
    sb_real bulk = (sb_real)INFINITY, mu = (sb_real)INFINITY;
    sbi_law_moduli(law, &bulk, &mu);
    if (!sb_is_finite(mu) || !sb_is_finite(bulk))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material law %s has no finite stress and tangent at rest (F = I)",
                        law->name);
    if (!(mu > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL,
                        "material law %s: its shear modulus at rest (F = I) is %g Pa, must be > 0", law->name,
                        (double)mu);
    return SB_OK;
}

SBI_API sb_result sbi_law_check_calls(const sb_material *material, sb_error *error)
{
    const sb_material_law *law = material->law;
    if (!law)
        return sbi_fail(error, SB_ERROR_MATERIAL,
                        "material has no law: states and recordings hold its name alone, so a material that the body "
                        "is given before must have it (sb_material.law)");
    if (!law->name || !law->name[0])
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a material law needs a name");
    if (!sbi_law_has_calls(law))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "material law %s has no %s", law->name,
                        law->energy ? "stress" : "energy");
    return sbi_law_check_moduli(law, error);
}

SBI_API sb_result sbi_law_check_constants(const sb_material *material, sb_error *error)
{
    sb_real bulk = material->lambda + 2 * material->mu / 3;
    if (!(material->law_scale > 0) || !sb_is_finite(material->law_scale))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material law_scale is %g, must be > 0", (double)material->law_scale);
    if (!(material->d1 > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material d1 is %g 1/Pa, must be > 0", (double)material->d1);
    if (sb_abs(bulk) <= sbi_law_tolerance() * sb_abs(material->mu)) /* or rounding would decide */
        return sbi_fail(error, SB_ERROR_MATERIAL,
                        "material law %s has a bulk modulus of %g Pa beside mu of %g Pa: a law that nothing of the "
                        "volume is in needs that of sb_material_custom",
                        material->law->name, (double)bulk, (double)material->mu);
    return SB_OK;
}

/* What a law is tried with. */
typedef struct sbi_law_trial {
    const sb_material_law *law;
    sb_mat3 F, P;
    sb_real A[81];
    sb_real stress, stiffness; /* largest entries of P and A (Pa) */
    sb_real tolerance;         /* of differences, relative */
} sbi_law_trial;

/* Entries in [-1, 1] that are the same everywhere. */
static sb_real sbi_law_random(unsigned *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return (sb_real)(*seed >> 9) / (sb_real)(1u << 22) - 1;
}

static sb_real sbi_law_largest(const sb_real *values, int count)
{
    sb_real largest = 0;
    for (int i = 0; i < count; i++)
        largest = sb_max(largest, sb_abs(values[i]));
    return largest;
}

/* How far two stresses may be apart (Pa). */
static sb_real sbi_law_allowed(const sbi_law_trial *t)
{
    return t->tolerance * sb_max(t->stress, sb_sqrt(t->tolerance) * t->stiffness);
}

/* The energy's difference over +-h of entry k of F. */
static int sbi_law_slope(const sbi_law_trial *t, int k, sb_real h, sb_real *slope)
{
    sb_mat3 low = t->F, high = t->F;
    sb_real before = 0, after = 0;
    low.m[k / 3][k % 3] -= h;
    high.m[k / 3][k % 3] += h;
    if (!t->law->energy(t->law->user, &low, &before) || !t->law->energy(t->law->user, &high, &after))
        return 0;
    *slope = (after - before) / (high.m[k / 3][k % 3] - low.m[k / 3][k % 3]);
    return sb_is_finite(*slope);
}

/* Entry k of the stress against the energy's difference, whose own error is what a step twice as wide tells: it is
 * large where a law is steep. */
static sb_result sbi_law_try_energy(const sbi_law_trial *t, int k, sb_error *error)
{
    sb_real h = sbi_law_step(&t->F), given = t->P.m[k / 3][k % 3], found, wide;
    if (!sbi_law_slope(t, k, h, &found) || !sbi_law_slope(t, k, 2 * h, &wide))
        return SB_OK; /* at the edge of what it admits */
    if (sb_abs(found - given) <= sbi_law_allowed(t) + sb_abs(wide - found))
        return SB_OK;
    return sbi_fail(error, SB_ERROR_MATERIAL,
                    "material law %s: its stress P[%d][%d] is %g Pa where differences of its energy give %g Pa",
                    t->law->name, k / 3, k % 3, (double)given, (double)found);
}

/* Column k of the tangent against the stress's difference, the same way. */
static sb_result sbi_law_try_tangent(const sbi_law_trial *t, int k, sb_error *error)
{
    sb_real column[9], wide[9], h = sbi_law_step(&t->F);
    if (!t->law->tangent || !sbi_law_difference(t->law, &t->F, k, h, column) ||
        !sbi_law_difference(t->law, &t->F, k, 2 * h, wide))
        return SB_OK;
    for (int i = 0; i < 9; i++)
        if (!(sb_abs(column[i] - t->A[9 * i + k]) <= t->tolerance * t->stiffness + sb_abs(wide[i] - column[i])))
            return sbi_fail(error, SB_ERROR_MATERIAL,
                            "material law %s: its tangent dP[%d][%d]/dF[%d][%d] is %g Pa where differences of its "
                            "stress give %g Pa",
                            t->law->name, i / 3, i % 3, k / 3, k % 3, (double)t->A[9 * i + k], (double)column[i]);
    return SB_OK;
}

/* P(QF) = Q P(F) */
static sb_result sbi_law_try_observer(const sbi_law_trial *t, unsigned *seed, sb_error *error)
{
    sb_quat q;
    sb_mat3 turn, turned, stress, expected;
    q.x = sbi_law_random(seed), q.y = sbi_law_random(seed), q.z = sbi_law_random(seed), q.w = (sb_real)0.5;
    turn = sb_quat_to_mat3(sb_quat_normalise(q));
    turned = sb_m3_mul(turn, t->F);
    expected = sb_m3_mul(turn, t->P);
    if (!t->law->stress(t->law->user, &turned, &stress))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material law %s has a stress at F, but none where F is turned",
                        t->law->name);
    stress = sb_m3_sub(stress, expected);
    if (sbi_law_largest(stress.m[0], 9) <= sbi_law_allowed(t))
        return SB_OK;
    return sbi_fail(error, SB_ERROR_MATERIAL,
                    "material law %s depends on the observer: P(QF) is off Q P(F) by %g Pa of %g Pa", t->law->name,
                    (double)sbi_law_largest(stress.m[0], 9), (double)t->stress);
}

/* Everything at one F; *admitted counts those where the law has a value. */
static sb_result sbi_law_try(sbi_law_trial *t, unsigned *seed, int *admitted, sb_error *error)
{
    sb_result result = SB_OK;
    sb_real energy = 0;
    memset(t->A, 0, sizeof t->A);
    t->P = sb_m3_zero();
    if (!t->law->energy(t->law->user, &t->F, &energy) || !t->law->stress(t->law->user, &t->F, &t->P) ||
        !sbi_law_own_tangent(t->law, &t->F, t->A))
        return SB_OK;
    t->stress = sbi_law_largest(t->P.m[0], 9);
    t->stiffness = sbi_law_largest(t->A, 81);
    for (int i = 0; i < 81; i++)
        if (!sb_is_finite(t->A[i]) || !sb_is_finite(t->P.m[i / 9 % 3][i % 3]) || !sb_is_finite(energy))
            return SB_OK;
    *admitted += 1;
    for (int k = 0; k < 9 && result == SB_OK; k++)
        result = sbi_law_try_energy(t, k, error);
    for (int k = 0; k < 9 && result == SB_OK; k++)
        result = sbi_law_try_tangent(t, k, error);
    return result == SB_OK ? sbi_law_try_observer(t, seed, error) : result;
}

/* The moduli at rest are those of the material, and nothing is stored or strained there. */
static sb_result sbi_law_check_rest(const sb_material *material, sb_error *error)
{
    const sb_real tolerance = sbi_law_tolerance(), rounded = sb_max((sb_real)1e-3, tolerance);
    const sb_material_law *law = material->law;
    sb_mat3 identity = sb_m3_identity(), stress = sb_m3_zero();
    sb_real given = material->lambda + 2 * material->mu / 3; /* bulk modulus */
    sb_real energy = 0, bulk = 0, mu = 0, most = tolerance * material->mu / material->law_scale;
    if (!law->energy(law->user, &identity, &energy) || !law->stress(law->user, &identity, &stress))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material law %s has no value at rest (F = I)", law->name);
    if (!(sb_abs(energy) <= most))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material law %s: its energy at rest (F = I) is %g J/m^3, must be 0",
                        law->name, (double)energy);
    for (int i = 0; i < 9; i++)
        if (!(sb_abs(stress.m[i / 3][i % 3]) <= most))
            return sbi_fail(error, SB_ERROR_MATERIAL,
                            "material law %s: its stress P[%d][%d] at rest (F = I) is %g Pa, must be 0", law->name,
                            i / 3, i % 3, (double)stress.m[i / 3][i % 3]);
    sbi_law_moduli(law, &bulk, &mu);
    mu *= material->law_scale;
    bulk = material->law_scale * bulk + 2 / material->d1;
    if (!(sb_abs(material->mu - mu) <= rounded * mu) || !(sb_abs(given - bulk) <= rounded * sb_max(bulk, mu)))
        return sbi_fail(error, SB_ERROR_MATERIAL,
                        "material mu is %g Pa and its bulk modulus %g Pa, but those of the law %s are %g and %g Pa",
                        (double)material->mu, (double)given, law->name, (double)mu, (double)bulk);
    return SB_OK;
}

SBI_API sb_result sbi_law_check(const sb_material *material, sb_error *error)
{
    enum { TRIALS = 12 };
    const sb_real spread[3] = {(sb_real)0.05, (sb_real)0.1, (sb_real)0.25};
    unsigned seed = 1;
    int admitted = 0;
    sbi_law_trial trial;
    sb_result result = sbi_law_check_rest(material, error);
    memset(&trial, 0, sizeof trial);
    trial.law = material->law;
    trial.tolerance = sbi_law_tolerance();
    for (int n = 0; n < TRIALS && result == SB_OK; n++) {
        trial.F = sb_m3_identity();
        for (int i = 0; i < 9; i++)
            trial.F.m[i / 3][i % 3] += spread[n % 3] * sbi_law_random(&seed);
        result = sbi_law_try(&trial, &seed, &admitted, error);
    }
    if (result == SB_OK && admitted < 2 * TRIALS / 3)
        return sbi_fail(error, SB_ERROR_MATERIAL,
                        "material law %s has no finite value at %d of %d strains of up to 25 %%", trial.law->name,
                        TRIALS - admitted, (int)TRIALS);
    return result;
}
