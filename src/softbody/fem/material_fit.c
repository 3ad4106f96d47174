/* material_fit: least squares for the constants of hyperelastic models and Prony series. */
#include "material_fit.h"

#include <string.h>

/* ---- least squares of a few unknowns ---- */

enum { SBI_FIT_UNKNOWNS = SB_MAX_PRONY_TERMS + 1 };

/* |A c - b|^2 in triangular form: R c = Q^T b in r[k][0..n-1] and r[k][n], and what no c can remove in rest. */
typedef struct sbi_fit_system {
    int n;
    double r[SBI_FIT_UNKNOWNS][SBI_FIT_UNKNOWNS + 1];
    double rest, total; /* total = |b|^2 */
} sbi_fit_system;

/* Constants that share all but this part of their influence with others are not distinguished: measured data never
 * reach it, rounding does. */
static const double sbi_fit_least_own = 1e-6;

static void sbi_fit_begin(sbi_fit_system *system, int n)
{
    memset(system, 0, sizeof *system);
    system->n = n;
}

/* Takes in one equation row.c = value by Givens rotations: no squares of the condition, no memory for rows. */
static void sbi_fit_add(sbi_fit_system *system, const double *row, double value)
{
    int n = system->n;
    double v[SBI_FIT_UNKNOWNS + 1];
    for (int k = 0; k < n; k++)
        v[k] = row[k];
    v[n] = value;
    system->total += value * value;
    for (int k = 0; k < n; k++) {
        double *r = system->r[k], length = sqrt(r[k] * r[k] + v[k] * v[k]), c, s;
        if (!(length > 0))
            continue;
        c = r[k] / length;
        s = v[k] / length;
        for (int j = k; j <= n; j++) {
            double old = r[j];
            r[j] = c * old + s * v[j];
            v[j] = c * v[j] - s * old;
        }
    }
    system->rest += v[n] * v[n];
}

/* The part of column k's length that the columns before it cannot make up; 0 for a column of zeros. */
static double sbi_fit_own(const sbi_fit_system *system, int k)
{
    double sum = 0;
    for (int i = 0; i <= k; i++)
        sum += system->r[i][k] * system->r[i][k];
    return sum > 0 ? fabs(system->r[k][k]) / sqrt(sum) : 0;
}

/* The unknown with the least part of its own, or the first that is not distinguished; and that part. */
static int sbi_fit_weakest(const sbi_fit_system *system, double *own)
{
    int weakest = 0;
    *own = 1;
    for (int k = 0; k < system->n; k++) {
        double part = sbi_fit_own(system, k);
        if (part < *own && *own >= sbi_fit_least_own) {
            *own = part;
            weakest = k;
        }
    }
    return weakest;
}

static void sbi_fit_back_substitute(const sbi_fit_system *system, double *c)
{
    for (int k = system->n - 1; k >= 0; k--) {
        double sum = system->r[k][system->n];
        for (int j = k + 1; j < system->n; j++)
            sum -= system->r[k][j] * c[j];
        c[k] = sum / system->r[k][k];
    }
}

/* Solves with the unknowns of `mask` alone, the others 0. Returns |A c - b|^2, or a negative number when they are not
 * distinguished or one would not be positive. */
static double sbi_fit_solve_subset(const sbi_fit_system *system, int mask, double *c)
{
    sbi_fit_system part;
    double solution[SBI_FIT_UNKNOWNS], own;
    int n = 0, at[SBI_FIT_UNKNOWNS];
    for (int k = 0; k < system->n; k++)
        if (mask >> k & 1)
            at[n++] = k;
    sbi_fit_begin(&part, n);
    for (int i = 0; i < system->n; i++) {
        double row[SBI_FIT_UNKNOWNS];
        for (int k = 0; k < n; k++)
            row[k] = system->r[i][at[k]];
        sbi_fit_add(&part, row, system->r[i][system->n]);
    }
    sbi_fit_weakest(&part, &own);
    if (own < sbi_fit_least_own)
        return -1;
    sbi_fit_back_substitute(&part, solution);
    memset(c, 0, (size_t)system->n * sizeof *c);
    for (int k = 0; k < n; k++) {
        if (!(solution[k] > 0))
            return -1;
        c[at[k]] = solution[k];
    }
    return system->rest + part.rest;
}

static int sbi_fit_count_bits(int mask)
{
    int count = 0;
    for (; mask; mask &= mask - 1)
        count++;
    return count;
}

/* Nonnegative least squares by looking at every set of unknowns, small sets first (there are 512 at most): a larger
 * set must remove an error that is more than rounding. */
static void sbi_fit_solve_nonnegative(const sbi_fit_system *system, double *c)
{
    double best = system->total, rounding = 1e-26 * system->total;
    memset(c, 0, (size_t)system->n * sizeof *c);
    for (int size = 1; size <= system->n; size++)
        for (int mask = 1; mask < 1 << system->n; mask++) {
            double candidate[SBI_FIT_UNKNOWNS], error;
            if (sbi_fit_count_bits(mask) != size)
                continue;
            error = sbi_fit_solve_subset(system, mask, candidate);
            if (error < 0 || !(error < best - rounding))
                continue;
            best = error;
            memcpy(c, candidate, (size_t)system->n * sizeof *c);
        }
}

/* ---- what a model predicts of a test ---- */

typedef struct sbi_fit {
    sb_material_model model;
    sb_fit_options options;
    const sb_test_point *data;
    int count;
    int n;        /* constants: c10 = mu/2, then c01, or c20 and c30 */
    double bulk;  /* fixed bulk modulus, else 0 */
    double ratio; /* else bulk over mu */
    int compressible;
    double c[3];
} sbi_fit;

/* The material with constants c and a bulk modulus; 0 leaves out the volume's share. */
static sb_material sbi_fit_material(const sbi_fit *fit, const double *c, double bulk)
{
    sb_material m;
    double c01 = fit->model == SB_MOONEY_RIVLIN ? c[1] : 0, mu = 2 * (c[0] + c01);
    memset(&m, 0, sizeof m);
    m.model = fit->model;
    m.density = fit->options.density;
    m.mu = (sb_real)mu;
    m.lambda = (sb_real)(bulk - 2 * mu / 3);
    m.c10 = (sb_real)c[0];
    m.c01 = (sb_real)c01;
    m.d1 = bulk > 0 ? (sb_real)(2 / bulk) : SB_REAL_MAX;
    if (fit->model == SB_REDUCED_POLYNOMIAL) {
        m.c20 = fit->n > 1 ? (sb_real)c[1] : 0;
        m.c30 = fit->n > 2 ? (sb_real)c[2] : 0;
    }
    return m;
}

static double sbi_fit_mu(const sbi_fit *fit, const double *c)
{
    return 2 * (c[0] + (fit->model == SB_MOONEY_RIVLIN ? c[1] : 0));
}

static double sbi_fit_bulk(const sbi_fit *fit, const double *c)
{
    return fit->bulk > 0 ? fit->bulk : fit->ratio * sbi_fit_mu(fit, c);
}

/* Nominal stress at constant volume is k1 dW/dI1 + k2 dW/dI2; *i = I1 - 3, in forms that do not cancel. */
static void sbi_fit_invariants(sb_test_kind kind, double x, double *k1, double *k2, double *i)
{
    double u = kind == SB_TEST_SIMPLE_SHEAR ? 1 : 1 / x, gap = x - 1;
    switch (kind) {
    case SB_TEST_UNIAXIAL: /* dW/d stretch with sides x^(-1/2) */
        *k1 = 2 * (x - u * u);
        *k2 = *k1 * u;
        *i = gap * gap * (x + 2) * u;
        break;
    case SB_TEST_EQUIBIAXIAL: /* half of it: two stresses do work */
        *k1 = 2 * (x - u * u * u * u * u);
        *k2 = *k1 * x * x;
        *i = gap * gap * (x + 1) * (x + 1) * (2 * x * x + 1) * u * u * u * u;
        break;
    case SB_TEST_PLANAR:
        *k1 = *k2 = 2 * (x - u * u * u);
        *i = (x - u) * (x - u);
        break;
    case SB_TEST_SIMPLE_SHEAR:
        *k1 = *k2 = 2 * x;
        *i = x * x;
        break;
    }
}

/* Stress per unit of each constant at constant volume. */
static void sbi_fit_basis(const sbi_fit *fit, const sb_test_point *point, double *row)
{
    double x = (double)point->strain, k1 = 0, k2 = 0, i = 0;
    double area = point->measure == SB_STRESS_CAUCHY && point->kind != SB_TEST_SIMPLE_SHEAR ? 1 / x : 1;
    sbi_fit_invariants(point->kind, x, &k1, &k2, &i);
    row[0] = k1 / area;
    if (fit->model == SB_MOONEY_RIVLIN)
        row[1] = k2 / area;
    else
        for (int k = 1; k < fit->n; k++)
            row[k] = (k + 1) * (k == 1 ? i : i * i) * k1 / area;
}

/* F of a test, its free stretch being b; without one in simple shear. */
static sb_mat3 sbi_fit_deformation(sb_test_kind kind, double x, double b)
{
    sb_mat3 f = sb_m3_identity();
    if (kind == SB_TEST_SIMPLE_SHEAR) {
        f.m[0][1] = (sb_real)x;
        return f;
    }
    f.m[0][0] = (sb_real)x;
    if (kind != SB_TEST_PLANAR)
        f.m[1][1] = (sb_real)(kind == SB_TEST_EQUIBIAXIAL ? x : b);
    f.m[2][2] = (sb_real)b;
    return f;
}

/* dP_ii/db for the free stretch b. */
static double sbi_fit_by_side(sb_test_kind kind, const sb_real *A, int i)
{
    double rate = (double)A[36 * i + 8];
    return kind == SB_TEST_UNIAXIAL ? rate + (double)A[36 * i + 4] : rate;
}

/* *b = the free stretch at which the free side bears no stress, by Newton steps between bounds. */
static int sbi_fit_free_side(const sb_material *m, sb_test_kind kind, double x, double *b)
{
    double low = 0, high = 0; /* high = 0: not known yet */
    double at = kind == SB_TEST_UNIAXIAL ? 1 / sqrt(x) : kind == SB_TEST_EQUIBIAXIAL ? 1 / (x * x) : 1 / x;
    for (int iteration = 0; iteration < 100; iteration++) {
        sb_mat3 f = sbi_fit_deformation(kind, x, at), p;
        sb_real A[81];
        double next, slope;
        if (!sb_material_stress(m, &f, NULL, &p) || !sb_material_tangent(m, &f, NULL, SB_TANGENT_EXACT, A))
            return 0;
        if (at < (double)SB_EPSILON) /* squeezed to nothing, where some models have no stress either */
            return 0;
        if (p.m[2][2] < 0)
            low = at;
        else
            high = at;
        slope = sbi_fit_by_side(kind, A, 2);
        next = at - (double)p.m[2][2] / slope;
        if (!(slope > 0) || !(next > low) || (high > 0 && !(next < high)))
            next = fabs(next - at) <= 4 * (double)SB_EPSILON * at ? at : high > 0 ? (low + high) / 2 : 2 * at;
        if (fabs(next - at) <= 4 * (double)SB_EPSILON * at) {
            *b = next;
            return 1;
        }
        at = next;
    }
    return 0;
}

/* Stress of a compressible material in a test, and its derivatives by the constants when row is given. */
static int sbi_fit_predict_compressible(const sbi_fit *fit, const double *c, const sb_test_point *point, double *stress,
                                        double *row)
{
    const sb_test_kind kind = point->kind;
    sb_material m = sbi_fit_material(fit, c, sbi_fit_bulk(fit, c));
    double x = (double)point->strain, b = 1, area = 1;
    int sheared = kind == SB_TEST_SIMPLE_SHEAR, column = sheared ? 1 : 0;
    int current = !sheared && point->measure == SB_STRESS_CAUCHY && fit->model != SB_LINEAR;
    sb_mat3 f, p;
    sb_real A[81];
    if (!sheared && !sbi_fit_free_side(&m, kind, x, &b))
        return 0;
    f = sbi_fit_deformation(kind, x, b);
    if (!sb_material_stress(&m, &f, NULL, &p) || !sb_material_tangent(&m, &f, NULL, SB_TANGENT_EXACT, A))
        return 0;
    if (current)
        area = kind == SB_TEST_UNIAXIAL ? b * b : kind == SB_TEST_EQUIBIAXIAL ? x * b : b;
    *stress = (double)p.m[0][column] / area;
    for (int k = 0; row && k < fit->n; k++) {
        double unit[3] = {0, 0, 0}, side = 0;
        sb_material share;
        unit[k] = 1;
        share = sbi_fit_material(fit, unit, fit->bulk > 0 ? 0 : sbi_fit_bulk(fit, unit));
        if (!sb_material_stress(&share, &f, NULL, &p))
            return 0;
        if (!sheared) /* the side stays free of stress */
            side = -(double)p.m[2][2] / sbi_fit_by_side(kind, A, 2);
        row[k] = ((double)p.m[0][column] + (sheared ? 0 : sbi_fit_by_side(kind, A, 0) * side)) / area;
        if (current)
            row[k] -= *stress * side * (kind == SB_TEST_UNIAXIAL ? 2 : 1) / b;
    }
    return 1;
}

static int sbi_fit_predict(const sbi_fit *fit, const double *c, const sb_test_point *point, double *stress, double *row)
{
    double basis[3] = {0, 0, 0};
    if (fit->compressible)
        return sbi_fit_predict_compressible(fit, c, point, stress, row);
    sbi_fit_basis(fit, point, basis);
    *stress = 0;
    for (int k = 0; k < fit->n; k++) {
        *stress += basis[k] * c[k];
        if (row)
            row[k] = basis[k];
    }
    return 1;
}

/* ---- the fit ---- */

/* 0: the reading does not count. */
static double sbi_fit_weight(const sbi_fit *fit, const sb_test_point *point)
{
    double stress = fabs((double)point->stress);
    return !fit->options.relative ? 1 : stress > 0 ? 1 / stress : 0;
}

static const char *sbi_fit_name(const sbi_fit *fit, int k)
{
    if (k == 0)
        return fit->model >= SB_MOONEY_RIVLIN || fit->model == SB_NEO_HOOKEAN_ISOCHORIC ? "c10" : "mu";
    return fit->model == SB_MOONEY_RIVLIN ? "c01" : k == 1 ? "c20" : "c30";
}

static const char *sbi_fit_test_name(sb_test_kind kind)
{
    switch (kind) {
    case SB_TEST_UNIAXIAL: return "uniaxial";
    case SB_TEST_EQUIBIAXIAL: return "equibiaxial";
    case SB_TEST_PLANAR: return "planar";
    case SB_TEST_SIMPLE_SHEAR: return "simple shear";
    }
    return "unknown";
}

/* Sum of squared weighted errors, or -1 where the material does not get to a reading; *worst is that reading. */
static double sbi_fit_cost(const sbi_fit *fit, const double *c, int *worst)
{
    double sum = 0;
    for (int k = 0; k < fit->count; k++) {
        double stress = 0, weight = sbi_fit_weight(fit, fit->data + k), error;
        if (weight > 0 && (!(sbi_fit_mu(fit, c) > 0) || !sbi_fit_predict(fit, c, fit->data + k, &stress, NULL))) {
            *worst = k;
            return -1;
        }
        if (!(weight > 0))
            continue;
        error = weight * (stress - (double)fit->data[k].stress);
        sum += error * error;
    }
    return sum;
}

/* The linearised equations about c, for the constants themselves, not their change. */
static int sbi_fit_linearise(const sbi_fit *fit, const double *c, sbi_fit_system *system)
{
    sbi_fit_begin(system, fit->n);
    for (int k = 0; k < fit->count; k++) {
        const sb_test_point *point = fit->data + k;
        double weight = sbi_fit_weight(fit, point), row[3] = {0, 0, 0}, stress, value = (double)point->stress;
        if (!(weight > 0))
            continue;
        if (!sbi_fit_predict(fit, c, point, &stress, row))
            return 0;
        value -= stress;
        for (int i = 0; i < fit->n; i++) {
            value += row[i] * c[i];
            row[i] *= weight;
        }
        sbi_fit_add(system, row, weight * value);
    }
    return 1;
}

static sb_result sbi_fit_solve(const sbi_fit *fit, const sbi_fit_system *system, double *c, sb_fit_info *info,
                               sb_error *error)
{
    double own;
    int weakest = sbi_fit_weakest(system, &own);
    info->iterations++;
    info->weakest = (sb_real)own;
    if (own < sbi_fit_least_own)
        return sbi_fail(error, SB_ERROR_INDEFINITE,
                        "the data do not determine %s: %g of its influence on the stresses is its own",
                        sbi_fit_name(fit, weakest), own);
    if (fit->options.nonnegative)
        sbi_fit_solve_nonnegative(system, c);
    else
        sbi_fit_back_substitute(system, c);
    return SB_OK;
}

static sb_result sbi_fit_check_mu(const sbi_fit *fit, const double *c, sb_error *error)
{
    double mu = sbi_fit_mu(fit, c);
    if (!(mu > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "the data ask for mu = %g Pa, must be > 0", mu);
    return SB_OK;
}

/* Shortens the step from fit->c to target until the errors do not grow; the step's share, or 0. */
static double sbi_fit_search(const sbi_fit *fit, const double *target, double cost, double *c, double *new_cost)
{
    int worst;
    for (double t = 1; t > 1e-4; t /= 2) {
        for (int k = 0; k < fit->n; k++)
            c[k] = fit->c[k] + t * (target[k] - fit->c[k]);
        *new_cost = sbi_fit_cost(fit, c, &worst);
        if (*new_cost >= 0 && *new_cost <= cost)
            return t;
    }
    return 0;
}

/* Largest change of a constant, relative to the largest constant. */
static double sbi_fit_change(const sbi_fit *fit, const double *target)
{
    double change = 0, size = 0;
    for (int k = 0; k < fit->n; k++) {
        change = fmax(change, fabs(target[k] - fit->c[k]));
        size = fmax(size, fabs(target[k]));
    }
    return change / size;
}

/* Gauss-Newton from the constants of constant volume. */
static sb_result sbi_fit_iterate(sbi_fit *fit, sb_fit_info *info, sb_error *error)
{
    const int most = 100;
    int worst = 0;
    double cost = sbi_fit_cost(fit, fit->c, &worst);
    if (cost < 0)
        return sbi_fail(error, SB_ERROR_DIVERGED,
                        "no free side bears no stress in the %s test at strain %g (reading %d)",
                        sbi_fit_test_name(fit->data[worst].kind), (double)fit->data[worst].strain, worst);
    for (int iteration = 0; iteration < most; iteration++) {
        sbi_fit_system system;
        double target[3], c[3], new_cost = cost, change;
        sb_result result;
        if (!sbi_fit_linearise(fit, fit->c, &system))
            return sbi_fail(error, SB_ERROR_DIVERGED, "the stresses' derivatives overflow");
        result = sbi_fit_solve(fit, &system, target, info, error);
        if (result != SB_OK)
            return result;
        change = sbi_fit_change(fit, target);
        if (!(sbi_fit_search(fit, target, cost, c, &new_cost) > 0)) {
            /* Rounding hides any gain of the last steps. */
            if (change <= 16 * sqrt((double)SB_EPSILON))
                return SB_OK;
            break;
        }
        memcpy(fit->c, c, sizeof c);
        cost = new_cost;
        if (change <= 16 * (double)SB_EPSILON)
            return SB_OK;
    }
    return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "the fit has not settled after %d iterations", info->iterations);
}

/* ---- how good it is ---- */

/* Root mean square and explained variance of the readings that count. */
static void sbi_fit_judge(const sbi_fit *fit, sb_fit_info *info)
{
    const double first = (double)fit->data[0].stress; /* what is summed from: exact when all are equal */
    double mean = first, squares = 0, weighted = 0, variance = 0, stress = 0;
    for (int k = 0; k < fit->count; k++)
        if (sbi_fit_weight(fit, fit->data + k) > 0)
            mean += ((double)fit->data[k].stress - first) / info->points;
    for (int k = 0; k < fit->count; k++) {
        double weight = sbi_fit_weight(fit, fit->data + k), given = (double)fit->data[k].stress, error;
        if (!(weight > 0) || !sbi_fit_predict(fit, fit->c, fit->data + k, &stress, NULL))
            continue;
        error = stress - given;
        squares += error * error;
        weighted += weight * error * weight * error;
        variance += (given - mean) * (given - mean);
    }
    info->rms = (sb_real)sqrt(weighted / info->points);
    info->r_squared = variance > 0 ? (sb_real)(1 - squares / variance) : 0;
}

/* d2W/(d log s_i d log s_j) of the principal stretches s. */
static int sbi_fit_log_tangent(const sb_material *m, const sb_mat3 *f, double h[3][3])
{
    sb_mat3 p;
    sb_real A[81];
    if (!sb_material_stress(m, f, NULL, &p) || !sb_material_tangent(m, f, NULL, SB_TANGENT_EXACT, A))
        return 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double stretch = (double)f->m[i][i];
            h[i][j] = stretch * (double)f->m[j][j] * (double)A[36 * i + 4 * j];
            if (i == j)
                h[i][j] += stretch * (double)p.m[i][i];
        }
    return 1;
}

/* 1 when h is positive definite, on strains of constant volume only when `deviatoric`. */
static int sbi_fit_is_positive(double h[3][3], int deviatoric)
{
    double a = h[0][0], b = h[0][1], d = h[1][1];
    if (deviatoric) { /* along (1,0,-1) and (0,1,-1) */
        a += h[2][2] - 2 * h[0][2];
        b += h[2][2] - h[0][2] - h[1][2];
        d += h[2][2] - 2 * h[1][2];
    }
    if (!(a > 0) || !(a * d - b * b > 0))
        return 0;
    return deviatoric || h[0][0] * (h[1][1] * h[2][2] - h[1][2] * h[2][1]) -
                                 h[0][1] * (h[1][0] * h[2][2] - h[1][2] * h[2][0]) +
                                 h[0][2] * (h[1][0] * h[2][1] - h[1][1] * h[2][0]) >
                             0;
}

/* Drucker stability in a test at one strain: of the shear share when the volume cannot change. */
static int sbi_fit_is_stable_at(const sbi_fit *fit, sb_test_kind kind, double x)
{
    sb_material m = sbi_fit_material(fit, fit->c, fit->compressible ? sbi_fit_bulk(fit, fit->c) : 0);
    double b, h[3][3];
    sb_mat3 f;
    if (kind == SB_TEST_SIMPLE_SHEAR) { /* its principal stretches are those of a planar test */
        x = x / 2 + sqrt(1 + x * x / 4);
        b = 1 / x;
        kind = SB_TEST_PLANAR;
    } else if (!fit->compressible) {
        b = kind == SB_TEST_UNIAXIAL ? 1 / sqrt(x) : kind == SB_TEST_EQUIBIAXIAL ? 1 / (x * x) : 1 / x;
    } else if (!sbi_fit_free_side(&m, kind, x, &b)) {
        return 0;
    }
    f = sbi_fit_deformation(kind, x, b);
    return sbi_fit_log_tangent(&m, &f, h) && sbi_fit_is_positive(h, !fit->compressible);
}

/* Walks from rest to the strain `end`; 1 when stable all the way, else *strain is the first that is not. */
static int sbi_fit_is_stable_to(const sbi_fit *fit, sb_test_kind kind, double rest, double end, double *strain)
{
    const int steps = 64;
    for (int k = 0; k <= steps; k++) {
        *strain = rest + (end - rest) * k / steps;
        if (!sbi_fit_is_stable_at(fit, kind, *strain))
            return 0;
        if (!(fabs(end - rest) > 0))
            break;
    }
    return 1;
}

static void sbi_fit_find_stability(const sbi_fit *fit, sb_fit_info *info)
{
    info->stable = 1;
    for (int kind = SB_TEST_UNIAXIAL; kind <= SB_TEST_SIMPLE_SHEAR && fit->model != SB_LINEAR; kind++) {
        double rest = kind == SB_TEST_SIMPLE_SHEAR ? 0 : 1, least = rest, most = rest, low, high;
        int low_stable, high_stable;
        for (int k = 0; k < fit->count; k++)
            if ((int)fit->data[k].kind == kind) {
                least = fmin(least, (double)fit->data[k].strain);
                most = fmax(most, (double)fit->data[k].strain);
            }
        low_stable = sbi_fit_is_stable_to(fit, (sb_test_kind)kind, rest, least, &low);
        high_stable = sbi_fit_is_stable_to(fit, (sb_test_kind)kind, rest, most, &high);
        if (low_stable && high_stable)
            continue;
        info->stable = 0;
        info->unstable_kind = (sb_test_kind)kind;
        info->unstable_strain = (sb_real)(high_stable || (!low_stable && rest - low < high - rest) ? low : high);
        return;
    }
}

/* ---- arguments ---- */

SB_API sb_fit_options sb_default_fit_options(void)
{
    sb_fit_options options;
    memset(&options, 0, sizeof options);
    options.order = 2;
    options.relative = 1;
    options.poisson = (sb_real)0.49;
    options.density = 1000;
    return options;
}

static sb_result sbi_fit_check_options(const sbi_fit *fit, sb_error *error)
{
    const sb_fit_options *o = &fit->options;
    if ((int)fit->model < SB_LINEAR || (int)fit->model > SB_REDUCED_POLYNOMIAL)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "material model %d is unknown, or not linear in its constants",
                        (int)fit->model);
    if (!sb_is_finite(o->poisson) || !sb_is_finite(o->d1) || !sb_is_finite(o->density))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "fit options have poisson %g, d1 %g, density %g, not finite",
                        (double)o->poisson, (double)o->d1, (double)o->density);
    if (fit->model == SB_REDUCED_POLYNOMIAL && (o->order < 1 || o->order > 3))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "fit option order is %d, must be 1 to 3", o->order);
    if (o->d1 < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "fit option d1 is %g 1/Pa, must be >= 0", (double)o->d1);
    if (!(o->d1 > 0) && !(o->poisson > -1 && o->poisson < (sb_real)0.5))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "fit option poisson is %g, must be inside (-1, 0.5)",
                        (double)o->poisson);
    if (!(o->density > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "fit option density is %g kg/m^3, must be > 0", (double)o->density);
    return SB_OK;
}

static sb_result sbi_fit_check_point(const sb_test_point *point, int k, sb_error *error)
{
    if ((int)point->kind < SB_TEST_UNIAXIAL || (int)point->kind > SB_TEST_SIMPLE_SHEAR)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "reading %d has a test of unknown kind %d", k, (int)point->kind);
    if (point->measure != SB_STRESS_NOMINAL && point->measure != SB_STRESS_CAUCHY)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "reading %d has a stress of unknown measure %d", k,
                        (int)point->measure);
    if (!sb_is_finite(point->strain) || !sb_is_finite(point->stress))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "reading %d has strain %g and stress %g Pa, not finite", k,
                        (double)point->strain, (double)point->stress);
    if (point->kind != SB_TEST_SIMPLE_SHEAR && !(point->strain > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "reading %d has stretch %g, must be > 0", k, (double)point->strain);
    return SB_OK;
}

/* Checks all arguments and counts the readings that count. */
static sb_result sbi_fit_check(const sbi_fit *fit, sb_fit_info *info, sb_error *error)
{
    sb_result result = sbi_fit_check_options(fit, error);
    for (int k = 0; result == SB_OK && k < fit->count; k++) {
        result = sbi_fit_check_point(fit->data + k, k, error);
        info->points += result == SB_OK && sbi_fit_weight(fit, fit->data + k) > 0;
    }
    if (result == SB_OK && info->points < fit->n)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "%d readings that count are too few for %d constants", info->points,
                          fit->n);
    return result;
}

static int sbi_fit_constant_count(sb_material_model model, int order)
{
    return model == SB_MOONEY_RIVLIN ? 2 : model == SB_REDUCED_POLYNOMIAL ? order : 1;
}

static sbi_fit sbi_fit_make(sb_material_model model, const sb_test_point *data, int count,
                            const sb_fit_options *options)
{
    sbi_fit fit;
    double poisson;
    memset(&fit, 0, sizeof fit);
    fit.model = model;
    fit.options = options ? *options : sb_default_fit_options();
    fit.data = data;
    fit.count = count;
    fit.n = sbi_fit_constant_count(model, fit.options.order);
    poisson = (double)fit.options.poisson;
    fit.ratio = 2 * (1 + poisson) / (3 * (1 - 2 * poisson));
    fit.bulk = fit.options.d1 > 0 ? 2 / (double)fit.options.d1 : 0;
    return fit;
}

SB_API sb_result sb_material_fit(sb_material_model model, const sb_test_point *data, int count,
                                 const sb_fit_options *options, sb_material *material, sb_fit_info *info,
                                 sb_error *error)
{
    sbi_fit fit = sbi_fit_make(model, data, count, options);
    sbi_fit_system system;
    sb_fit_info found;
    sb_material fitted;
    sb_result result;
    memset(&found, 0, sizeof found);
    if (!data || !material || count < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "data or material is NULL, or count %d is negative", count);
    result = sbi_fit_check(&fit, &found, error);
    if (result != SB_OK)
        return result;
    found.constants = fit.n;
    sbi_fit_linearise(&fit, fit.c, &system); /* at constant volume: linear, so that no start matters */
    result = sbi_fit_solve(&fit, &system, fit.c, &found, error);
    if (result == SB_OK)
        result = sbi_fit_check_mu(&fit, fit.c, error);
    fit.compressible = fit.options.compressible || (int)model <= SB_SVK;
    if (result == SB_OK && fit.compressible)
        result = sbi_fit_iterate(&fit, &found, error);
    if (result != SB_OK)
        return result;
    fitted = sbi_fit_material(&fit, fit.c, sbi_fit_bulk(&fit, fit.c));
    result = sb_material_check(&fitted, error);
    if (result != SB_OK)
        return result;
    sbi_fit_judge(&fit, &found);
    sbi_fit_find_stability(&fit, &found);
    *material = fitted;
    if (info)
        *info = found;
    return SB_OK;
}

/* ---- Prony series ---- */

/* Times to fit with: the given ones, or evenly spread in log time from first to last. */
static void sbi_fit_spread(double first, double last, const sb_real *given, int terms, double *tau)
{
    for (int i = 0; i < terms; i++) {
        double along = terms > 1 ? (double)i / (terms - 1) : 0.5;
        tau[i] = given ? (double)given[i] : first * sbi_dense_exp(along * sbi_dense_log(last / first));
    }
}

static void sbi_fit_range(const sb_real *values, int count, double *least, double *most)
{
    *least = *most = (double)values[0];
    for (int k = 1; k < count; k++) {
        *least = fmin(*least, (double)values[k]);
        *most = fmax(*most, (double)values[k]);
    }
}

/* The terms' number and times. */
static sb_result sbi_fit_check_terms(const sb_real *tau, int terms, sb_error *error)
{
    if (terms < 1 || terms > SB_MAX_PRONY_TERMS)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d Prony terms asked for, must be 1 to %d", terms,
                        (int)SB_MAX_PRONY_TERMS);
    for (int i = 0; tau && i < terms; i++)
        if (!sb_is_finite(tau[i]) || !(tau[i] > 0))
            return sbi_fail(error, sb_is_finite(tau[i]) ? SB_ERROR_ARGUMENT : SB_ERROR_NOT_FINITE,
                            "tau %d is %g s, must be > 0 and finite", i, (double)tau[i]);
    return SB_OK;
}

static sb_result sbi_fit_check_prony(const sb_real *time, const sb_real *g, int count, const sb_real *tau, int terms,
                                     sb_error *error)
{
    sb_result result = sbi_fit_check_terms(tau, terms, error);
    if (result != SB_OK)
        return result;
    if (count < terms)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d readings are too few for %d Prony terms", count, terms);
    for (int k = 0; k < count; k++) {
        if (!sb_is_finite(time[k]) || !sb_is_finite(g[k]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "reading %d has time %g s and g %g, not finite", k,
                            (double)time[k], (double)g[k]);
        if (!(time[k] > 0))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "reading %d has time %g s, must be > 0", k, (double)time[k]);
    }
    return SB_OK;
}

/* 1 - g(t) = sum of g_i (1 - exp(-t/tau_i)) at every reading. */
static void sbi_fit_prony_system(const sb_real *time, const sb_real *g, int count, const double *tau, int terms,
                                 sbi_fit_system *system)
{
    sbi_fit_begin(system, terms);
    for (int k = 0; k < count; k++) {
        double row[SBI_FIT_UNKNOWNS];
        for (int i = 0; i < terms; i++)
            row[i] = 1 - sbi_dense_exp(-(double)time[k] / tau[i]);
        sbi_fit_add(system, row, 1 - (double)g[k]);
    }
}

static void sbi_fit_judge_prony(const sb_material *m, const sb_real *time, const sb_real *g, int count,
                                sb_fit_info *info)
{
    double mean = (double)g[0], squares = 0, variance = 0; /* from g[0]: exact when all are equal */
    for (int k = 1; k < count; k++)
        mean += ((double)g[k] - (double)g[0]) / count;
    for (int k = 0; k < count; k++) {
        double error = (double)sb_material_relaxation(m, time[k]) - (double)g[k], away = (double)g[k] - mean;
        squares += error * error;
        variance += away * away;
    }
    info->points = count;
    info->constants = m->prony_count;
    info->iterations = 1;
    info->rms = (sb_real)sqrt(squares / count);
    info->r_squared = variance > 0 ? (sb_real)(1 - squares / variance) : 0;
    info->stable = 1; /* every g_i > 0: what relaxes only ever loses energy */
}

SB_API sb_result sb_material_fit_prony(const sb_real *time, const sb_real *g, int count, const sb_real *tau, int terms,
                                       sb_material *material, sb_fit_info *info, sb_error *error)
{
    double times[SBI_FIT_UNKNOWNS], c[SBI_FIT_UNKNOWNS], own;
    sb_real kept_g[SB_MAX_PRONY_TERMS], kept_tau[SB_MAX_PRONY_TERMS];
    sbi_fit_system system;
    sb_fit_info found;
    sb_material fitted;
    sb_result result;
    double first, last;
    int kept = 0, weakest;
    memset(&found, 0, sizeof found);
    if (!time || !g || !material)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "time, g or material is NULL");
    result = sbi_fit_check_prony(time, g, count, tau, terms, error);
    if (result != SB_OK)
        return result;
    sbi_fit_range(time, count, &first, &last);
    sbi_fit_spread(first, last, tau, terms, times);
    sbi_fit_prony_system(time, g, count, times, terms, &system);
    weakest = sbi_fit_weakest(&system, &own);
    if (tau && own < sbi_fit_least_own)
        return sbi_fail(error, SB_ERROR_INDEFINITE,
                        "the data do not determine g of tau %d, %g s: %g of its influence is its own", weakest,
                        times[weakest], own);
    sbi_fit_solve_nonnegative(&system, c);
    for (int i = 0; i < terms; i++)
        if (c[i] > 0) {
            kept_g[kept] = (sb_real)c[i];
            kept_tau[kept++] = (sb_real)times[i];
        }
    fitted = sb_material_with_prony(*material, kept_g, kept_tau, kept);
    result = sb_material_check(&fitted, error);
    if (result != SB_OK)
        return result;
    found.weakest = (sb_real)own;
    sbi_fit_judge_prony(&fitted, time, g, count, &found);
    *material = fitted;
    if (info)
        *info = found;
    return SB_OK;
}

/* ---- moduli of oscillations ---- */

static sb_result sbi_fit_check_moduli(const sb_real *omega, const sb_real *storage, const sb_real *loss, int count,
                                      int terms, sb_error *error)
{
    if (count < 1 || count < (terms + 2) / 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d readings are too few for %d Prony terms and a modulus", count,
                        terms);
    for (int k = 0; k < count; k++) {
        if (!sb_is_finite(omega[k]) || !sb_is_finite(storage[k]) || !sb_is_finite(loss[k]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "reading %d has omega %g rad/s, G' %g and G'' %g Pa", k,
                            (double)omega[k], (double)storage[k], (double)loss[k]);
        if (!(omega[k] > 0))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "reading %d has omega %g rad/s, must be > 0", k,
                            (double)omega[k]);
        if (storage[k] < 0 || loss[k] < 0 || !(storage[k] + loss[k] > 0))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "reading %d has G' %g and G'' %g Pa, must be >= 0 and not both 0",
                            k, (double)storage[k], (double)loss[k]);
    }
    return SB_OK;
}

/* G' = c_0 + sum c_i x^2/(1 + x^2) and G'' = sum c_i x/(1 + x^2), x = omega tau_i, over |G*| of each reading. */
static void sbi_fit_moduli_system(const sb_real *omega, const sb_real *storage, const sb_real *loss, int count,
                                  const double *tau, int terms, sbi_fit_system *system)
{
    sbi_fit_begin(system, terms + 1);
    for (int k = 0; k < count; k++) {
        double held[SBI_FIT_UNKNOWNS], lost[SBI_FIT_UNKNOWNS], first = (double)storage[k], second = (double)loss[k];
        double weight = 1 / sqrt(first * first + second * second);
        held[0] = weight;
        lost[0] = 0;
        for (int i = 0; i < terms; i++) {
            double x = (double)omega[k] * tau[i];
            lost[i + 1] = weight / (x + 1 / x);
            held[i + 1] = x * lost[i + 1];
        }
        sbi_fit_add(system, held, weight * first);
        sbi_fit_add(system, lost, weight * second);
    }
}

static void sbi_fit_judge_moduli(const sb_material *m, const sb_real *omega, const sb_real *storage,
                                 const sb_real *loss, int count, sb_fit_info *info)
{
    double mean[2] = {(double)storage[0], (double)loss[0]}, relative = 0, squares = 0, variance = 0;
    for (int k = 1; k < count; k++) {
        mean[0] += ((double)storage[k] - (double)storage[0]) / count;
        mean[1] += ((double)loss[k] - (double)loss[0]) / count;
    }
    for (int k = 0; k < count; k++) {
        double first = (double)storage[k], second = (double)loss[k], error;
        sb_real held, lost;
        sb_material_shear_moduli(m, omega[k], &held, &lost);
        error = pow((double)held - first, 2) + pow((double)lost - second, 2);
        relative += error / (first * first + second * second);
        squares += error;
        variance += pow(first - mean[0], 2) + pow(second - mean[1], 2);
    }
    info->points = 2 * count;
    info->constants = m->prony_count + 1;
    info->iterations = 1;
    info->rms = (sb_real)sqrt(relative / count);
    info->r_squared = variance > 0 ? (sb_real)(1 - squares / variance) : 0;
    info->stable = 1;
}

/* The material with the modulus and the terms of c, c[0] what is left of the modulus in the end. */
static sb_result sbi_fit_moduli_material(const sb_material *material, const double *c, const double *tau, int terms,
                                         sb_material *fitted, sb_error *error)
{
    sb_real g[SB_MAX_PRONY_TERMS], kept_tau[SB_MAX_PRONY_TERMS];
    double whole = c[0];
    int kept = 0;
    for (int i = 1; i <= terms; i++)
        whole += c[i];
    if (!(c[0] > 64 * (double)SB_EPSILON * whole)) /* what rounded readings leave is nothing, too */
        return sbi_fail(error, SB_ERROR_MATERIAL,
                        "the data have no modulus left at low frequencies: a fluid's, or they end too early");
    for (int i = 1; i <= terms; i++)
        if (c[i] > 0) {
            g[kept] = (sb_real)(c[i] / whole);
            kept_tau[kept++] = (sb_real)tau[i - 1];
        }
    *fitted = sbi_material_scaled(material, (sb_real)(whole / (double)material->mu));
    *fitted = sb_material_with_prony(*fitted, g, kept_tau, kept);
    return sb_material_check(fitted, error);
}

SB_API sb_result sb_material_fit_moduli(const sb_real *omega, const sb_real *storage, const sb_real *loss, int count,
                                        const sb_real *tau, int terms, sb_material *material, sb_fit_info *info,
                                        sb_error *error)
{
    double times[SBI_FIT_UNKNOWNS], c[SBI_FIT_UNKNOWNS], own, slowest, fastest;
    sbi_fit_system system;
    sb_fit_info found;
    sb_material fitted;
    sb_result result;
    int weakest;
    memset(&found, 0, sizeof found);
    if (!omega || !storage || !loss || !material)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "omega, storage, loss or material is NULL");
    result = sb_material_check(material, error);
    if (result == SB_OK)
        result = sbi_fit_check_terms(tau, terms, error);
    if (result == SB_OK)
        result = sbi_fit_check_moduli(omega, storage, loss, count, terms, error);
    if (result != SB_OK)
        return result;
    sbi_fit_range(omega, count, &slowest, &fastest);
    sbi_fit_spread(1 / fastest, 1 / slowest, tau, terms, times);
    sbi_fit_moduli_system(omega, storage, loss, count, times, terms, &system);
    weakest = sbi_fit_weakest(&system, &own);
    if (tau && own < sbi_fit_least_own)
        return sbi_fail(error, SB_ERROR_INDEFINITE, "the data do not determine %s %d: %g of its influence is its own",
                        weakest > 0 ? "g of tau" : "the long-term modulus, unknown", weakest > 0 ? weakest - 1 : 0,
                        own);
    sbi_fit_solve_nonnegative(&system, c);
    result = sbi_fit_moduli_material(material, c, times, terms, &fitted, error);
    if (result != SB_OK)
        return result;
    found.weakest = (sb_real)own;
    sbi_fit_judge_moduli(&fitted, omega, storage, loss, count, &found);
    *material = fitted;
    if (info)
        *info = found;
    return SB_OK;
}
