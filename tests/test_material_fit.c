/* Tests of material_fit: constants come back from data made with them, exact and noisy, at constant volume and
 * compressible; stability, what the data do not determine, Prony series, refused arguments. */
#include "softbody.h"

#include "check.h"

#define REAL(x) ((sb_real)(x))

enum { MOST_POINTS = 1600 };

typedef struct fit_data {
    sb_test_point points[MOST_POINTS];
    int count;
} fit_data;

static double tolerance(double in_double, double epsilons)
{
    double rounding = epsilons * (double)SB_EPSILON;
    return rounding > in_double ? rounding : in_double;
}

/* ---- data, by the material room alone ---- */

static sb_mat3 deformation(sb_test_kind kind, double x, double b)
{
    sb_mat3 f = sb_m3_identity();
    if (kind == SB_TEST_SIMPLE_SHEAR) {
        f.m[0][1] = (sb_real)x;
        return f;
    }
    f.m[0][0] = (sb_real)x;
    f.m[1][1] = (sb_real)(kind == SB_TEST_UNIAXIAL ? b : kind == SB_TEST_EQUIBIAXIAL ? x : 1);
    f.m[2][2] = (sb_real)b;
    return f;
}

static sb_mat3 stress_at(const sb_material *m, sb_test_kind kind, double x, double b)
{
    sb_mat3 f = deformation(kind, x, b), p = f;
    CHECK(sb_material_stress(m, &f, NULL, &p));
    return p;
}

/* Constant volume: the pressure that frees the side is subtracted by hand. */
static double stress_isochoric(const sb_material *m, sb_test_kind kind, double x, int cauchy)
{
    double b = kind == SB_TEST_UNIAXIAL ? 1 / sqrt(x) : kind == SB_TEST_EQUIBIAXIAL ? 1 / (x * x) : 1 / x, nominal;
    sb_mat3 p = stress_at(m, kind, x, b);
    if (kind == SB_TEST_SIMPLE_SHEAR)
        return (double)p.m[0][1];
    nominal = (double)p.m[0][0] - (double)p.m[2][2] * b / x;
    return cauchy ? x * nominal : nominal;
}

/* Compressible: the free side by bisection. */
static double stress_compressible(const sb_material *m, sb_test_kind kind, double x, int cauchy)
{
    double low = 0.2, high = 2, b = 1;
    sb_mat3 p, f;
    if (kind == SB_TEST_SIMPLE_SHEAR)
        return (double)stress_at(m, kind, x, 1).m[0][1];
    for (int i = 0; i < 60; i++) {
        b = (low + high) / 2;
        p = stress_at(m, kind, x, b);
        if (p.m[2][2] < 0)
            low = b;
        else
            high = b;
    }
    p = stress_at(m, kind, x, b);
    f = deformation(kind, x, b);
    return cauchy ? (double)sb_material_cauchy_stress(m, f, p).m[0][0] : (double)p.m[0][0];
}

/* count readings of one test, strains from low to high, each off by up to noise of itself. */
static void add_test(fit_data *data, const sb_material *m, sb_test_kind kind, double low, double high, int count,
                     int compressible, double noise)
{
    unsigned long long seed = 77 + (unsigned long long)kind;
    for (int i = 0; i < count; i++) {
        sb_test_point *point = data->points + data->count++;
        int cauchy = i % 2;
        double x;
        point->kind = kind;
        point->measure = cauchy ? SB_STRESS_CAUCHY : SB_STRESS_NOMINAL;
        point->strain = (sb_real)(low + (high - low) * i / (count > 1 ? count - 1 : 1));
        x = (double)point->strain;
        point->stress = (sb_real)((compressible ? stress_compressible : stress_isochoric)(m, kind, x, cauchy) *
                                  (1 + check_random_in(&seed, -noise, noise)));
    }
}

static fit_data all_tests(const sb_material *m, double reach, int count, int compressible, double noise)
{
    fit_data data;
    data.count = 0;
    add_test(&data, m, SB_TEST_UNIAXIAL, 1 / (1 + reach), 1 + reach, count, compressible, noise);
    add_test(&data, m, SB_TEST_EQUIBIAXIAL, 1 + reach / 40, 1 + 0.6 * reach, count, compressible, noise);
    add_test(&data, m, SB_TEST_PLANAR, 1 + reach / 40, 1 + reach, count, compressible, noise);
    add_test(&data, m, SB_TEST_SIMPLE_SHEAR, -reach, 1.1 * reach, count, compressible, noise);
    return data;
}

/* ---- recovery ---- */

static void check_constants(const sb_material *actual, const sb_material *expected, double error)
{
    double size = fabs((double)expected->c10) + fabs((double)expected->c01);
    CHECK_INT(actual->model, expected->model);
    CHECK_NEAR(((double)actual->mu - (double)expected->mu) / (double)expected->mu, 0, error);
    CHECK_NEAR(((double)actual->c10 - (double)expected->c10) / size, 0, error);
    CHECK_NEAR(((double)actual->c01 - (double)expected->c01) / size, 0, error);
    CHECK_NEAR(((double)actual->c20 - (double)expected->c20) / size, 0, error);
    CHECK_NEAR(((double)actual->c30 - (double)expected->c30) / size, 0, error);
    CHECK_NEAR((double)sb_material_bulk(actual) / (double)sb_material_bulk(expected), 1, error);
    CHECK_NEAR(actual->density, expected->density, 0);
}

static sb_material example(int which)
{
    const sb_real d1 = (sb_real)1e-5;
    switch (which) {
    case 0: return sb_material_neo_hookean_isochoric(365, d1, 1060);
    case 1: return sb_material_mooney_rivlin(323, 161, d1, 1060);
    case 2: return sb_material_mooney_rivlin(400, -60, d1, 1060);
    case 3: return sb_material_reduced_polynomial(398, 209, 0, d1, 1060);
    case 4: return sb_material_reduced_polynomial(398, -30, 12, d1, 1060);
    case 5: return sb_material_neo_hookean(1200, (sb_real)0.45, 1060);
    default: return sb_material_stable_neo_hookean(1200, (sb_real)0.45, 1060);
    }
}
enum { EXAMPLES = 7 };

static sb_fit_options options_for(const sb_material *m)
{
    sb_fit_options options = sb_default_fit_options();
    options.order = m->c30 > 0 || m->c30 < 0 ? 3 : 2;
    options.d1 = m->d1;
    options.density = m->density;
    return options;
}

static void test_exact_data(void)
{
    for (int which = 0; which < EXAMPLES; which++)
        for (int relative = 0; relative < 2; relative++) {
            sb_material m = example(which), fitted;
            fit_data data = all_tests(&m, 1, 12, 0, 0);
            sb_fit_options options = options_for(&m);
            sb_fit_info info;
            options.relative = relative;
            if (!CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, NULL)))
                continue;
            check_constants(&fitted, &m, tolerance(1e-10, 2e4));
            CHECK_OK(sb_material_check(&fitted, NULL));
            CHECK_INT(info.points, data.count);
            CHECK_INT(info.constants, which == 0 || which > 4 ? 1 : which == 4 ? 3 : 2);
            CHECK_INT(info.iterations, 1);
            CHECK(info.weakest > (sb_real)0.01 && info.weakest <= 1);
            CHECK_NEAR((double)info.rms / (relative ? 1 : (double)m.mu), 0, tolerance(1e-10, 2e4));
            CHECK_NEAR(info.r_squared, 1, tolerance(1e-12, 1e3));
        }
}

static void test_noisy_data(void)
{
    check_bad_numbers();
    for (int which = 0; which < EXAMPLES; which++) {
        sb_material m = example(which), fitted;
        fit_data data = all_tests(&m, 1, 400, 0, 0.01);
        sb_fit_options options = options_for(&m);
        sb_fit_info info;
        if (!CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, NULL)))
            continue;
        check_constants(&fitted, &m, 0.01);
        CHECK_NEAR(info.rms, 0.01 / sqrt(3.0), 3e-4);
        CHECK_NEAR(info.r_squared, 1, 1e-3);
        CHECK(info.r_squared < (sb_real)0.99999);
    }
}

/* One kind of test alone: enough for mu, and for both Mooney-Rivlin constants where I1 and I2 differ. */
static void test_single_tests(void)
{
    for (int kind = SB_TEST_UNIAXIAL; kind <= SB_TEST_SIMPLE_SHEAR; kind++)
        for (int which = 0; which < 2; which++) {
            sb_material m = example(which), fitted;
            sb_fit_options options = options_for(&m);
            sb_error error;
            fit_data data;
            sb_result expected = which && kind > SB_TEST_EQUIBIAXIAL ? SB_ERROR_INDEFINITE : SB_OK;
            data.count = 0;
            add_test(&data, &m, (sb_test_kind)kind, kind == SB_TEST_SIMPLE_SHEAR ? 0.1 : 1.1, 2, 20, 0, 0);
            CHECK_RESULT(sb_material_fit(m.model, data.points, data.count, &options, &fitted, NULL, &error), expected);
            if (expected == SB_OK)
                check_constants(&fitted, &m, tolerance(1e-10, 1e4));
            else
                CHECK(strstr(error.message, "c01") != NULL);
        }
}

/* Soft volumes, where the free side's stretch matters, with the bulk modulus or its ratio given. */
static void test_compressible_data(void)
{
    sb_material materials[9];
    materials[0] = sb_material_preset(SB_LIVER_NEO_HOOKEAN, 1060);
    materials[1] = sb_material_mooney_rivlin(323, 161, (sb_real)8e-4, 1060);
    materials[2] = sb_material_reduced_polynomial(398, 209, 20, (sb_real)8e-4, 1060);
    materials[3] = sb_material_neo_hookean(1200, (sb_real)0.35, 1060);
    materials[4] = sb_material_stable_neo_hookean(1200, (sb_real)0.35, 1060);
    materials[5] = sb_material_svk(1200, (sb_real)0.3, 1060);
    materials[6] = sb_material_linear(1987, (sb_real)0.36, 1060);
    materials[7] = sb_material_corotated(1987, (sb_real)0.36, 1060);
    materials[8] = sb_material_corotated_invertible(1987, (sb_real)0.36, 1060);
    for (int which = 0; which < 9; which++)
        for (int fixed = 0; fixed < 2; fixed++) {
            sb_material m = materials[which], fitted;
            fit_data data = all_tests(&m, 0.3, 10, 1, 0);
            sb_fit_options options = options_for(&m);
            sb_fit_info info;
            sb_error error;
            options.compressible = which < 5;
            options.poisson = sb_material_poisson(&m);
            options.d1 = fixed ? m.d1 : 0;
            if (sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, &error) != SB_OK) {
                CHECK(0);
                printf("  model %d: %s\n", (int)m.model, error.message);
                continue;
            }
            check_constants(&fitted, &m, tolerance(1e-8, 2e4));
            CHECK(info.iterations > 1 && info.iterations < 30);
            CHECK_NEAR(info.rms, 0, tolerance(1e-8, 2e4));
            CHECK_INT(info.stable, 1);
        }
}

/* The same data taken at constant volume are off by the compressibility, and say so. */
static void test_kinematics_matter(void)
{
    sb_material m = sb_material_preset(SB_LIVER_NEO_HOOKEAN, 1060), fitted;
    fit_data data = all_tests(&m, 0.3, 10, 1, 0);
    sb_fit_options options = options_for(&m);
    sb_fit_info info;
    CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, NULL));
    CHECK(fabs((double)fitted.c10 - 365) > 5);
    CHECK(info.rms > (sb_real)0.02);
}

/* E of a bar, whose readings of the small strains weigh as much as any; stress E (stretch - 1). */
static void test_linear_young(void)
{
    sb_test_point points[6];
    sb_fit_options options = sb_default_fit_options();
    sb_material m;
    sb_fit_info info;
    for (int i = 0; i < 6; i++) {
        points[i].kind = SB_TEST_UNIAXIAL;
        points[i].measure = i % 2 ? SB_STRESS_CAUCHY : SB_STRESS_NOMINAL;
        points[i].strain = (sb_real)(0.95 + 0.02 * i);
        points[i].stress = 3000 * (points[i].strain - 1);
    }
    options.poisson = (sb_real)0.45;
    CHECK_OK(sb_material_fit(SB_LINEAR, points, 6, &options, &m, &info, NULL));
    CHECK_NEAR((double)sb_material_young(&m) / 3000, 1, tolerance(1e-10, 1e3));
    CHECK_NEAR(sb_material_poisson(&m), 0.45, tolerance(1e-12, 10));
    CHECK_INT(info.points, 6);
}

/* ---- options ---- */

/* A point at rest does not count in relative errors, and does no harm in absolute ones. */
static void test_points_at_rest(void)
{
    sb_material m = example(1), fitted;
    fit_data data = all_tests(&m, 1, 12, 0, 0);
    sb_fit_options options = options_for(&m);
    sb_fit_info info;
    sb_test_point *rest = data.points + data.count++;
    *rest = data.points[0];
    rest->strain = 1;
    rest->stress = 0;
    CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, NULL));
    CHECK_INT(info.points, data.count - 1);
    check_constants(&fitted, &m, tolerance(1e-10, 2e4));
    options.relative = 0;
    CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, NULL));
    CHECK_INT(info.points, data.count);
    check_constants(&fitted, &m, tolerance(1e-10, 2e4));
}

/* Data of a negative c01: 0 is the best that is not negative, with the c10 of the neo-Hookean fit. */
static void test_nonnegative(void)
{
    sb_material m = example(2), fitted, neo;
    fit_data data = all_tests(&m, 1, 12, 0, 0);
    sb_fit_options options = options_for(&m);
    sb_fit_info free_info, info;
    CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &free_info, NULL));
    CHECK(fitted.c01 < -50);
    options.nonnegative = 1;
    CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, NULL));
    CHECK_OK(sb_material_fit(SB_NEO_HOOKEAN_ISOCHORIC, data.points, data.count, &options, &neo, NULL, NULL));
    CHECK(fitted.c01 == 0);
    CHECK_NEAR((double)fitted.c10 / (double)neo.c10, 1, tolerance(1e-12, 10));
    CHECK(info.rms > free_info.rms && info.stable == 1);
    m = example(1); /* and leaves positive ones alone */
    data = all_tests(&m, 1, 12, 0, 0);
    CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, NULL));
    check_constants(&fitted, &m, tolerance(1e-10, 2e4));
}

/* Both weightings minimise what they say: moving the constants either way makes their own error larger. */
static void test_weighting(void)
{
    sb_material m = example(3), fitted;
    fit_data data = all_tests(&m, 1, 12, 0, 0.1);
    sb_fit_options options = options_for(&m);
    sb_fit_info info;
    for (int relative = 0; relative < 2; relative++) {
        options.relative = relative;
        CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, NULL));
        for (int c = 0; c <= 4; c++) {
            sb_real factor = c == 4 ? (sb_real)1 : (sb_real)(c % 2 ? 1.02 : 0.98);
            sb_material moved = sb_material_reduced_polynomial(
                c < 2 ? factor * fitted.c10 : fitted.c10, c < 2 ? fitted.c20 : factor * fitted.c20, 0, fitted.d1, 1060);
            double sum = 0, rms;
            for (int k = 0; k < data.count; k++) {
                const sb_test_point *p = data.points + k;
                double error = stress_isochoric(&moved, p->kind, (double)p->strain, p->measure == SB_STRESS_CAUCHY) -
                               (double)p->stress;
                error /= relative ? (double)p->stress : 1;
                sum += error * error;
            }
            rms = sqrt(sum / data.count);
            if (c == 4)
                CHECK_NEAR(rms / (double)info.rms, 1, tolerance(1e-10, 1e3));
            else
                CHECK(rms > 1.00001 * (double)info.rms);
        }
    }
}

/* ---- stability ---- */

/* Smallest eigenvalue's sign of d tau/d log strain in a bar of I1's function, at constant volume. */
static int bar_is_stable(const sb_material *m, double x)
{
    double i = (x - 1) * (x - 1) * (x + 2) / x, a = x * x, b = 1 / x;
    double w1 = (double)m->c10 + 2 * (double)m->c20 * i, w11 = 2 * (double)m->c20;
    double h00 = 4 * a * w1 + 4 * a * a * w11, h11 = 4 * b * w1 + 4 * b * b * w11, h01 = 4 * a * b * w11,
           h12 = 4 * b * b * w11;
    double d00 = h00 - 2 * h01 + h11, d01 = h01 - h01 - h12 + h11, d11 = h11 - 2 * h12 + h11;
    return d00 > 0 && d00 * d11 - d01 * d01 > 0;
}

static void test_stability(void)
{
    sb_material m = sb_material_reduced_polynomial(400, -25, 0, (sb_real)1e-5, 1060), fitted;
    sb_fit_options options = options_for(&m);
    sb_fit_info info;
    fit_data data;
    double limit = 1, reach = 3;
    while (bar_is_stable(&m, limit))
        limit += 1e-4;
    CHECK(limit > 1.2 && limit < reach - 0.3);
    data.count = 0;
    add_test(&data, &m, SB_TEST_SIMPLE_SHEAR, 0.05, 0.3, 5, 0, 0);
    add_test(&data, &m, SB_TEST_UNIAXIAL, 0.9, limit - 0.05, 20, 0, 0);
    CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, NULL));
    CHECK_INT(info.stable, 1);
    add_test(&data, &m, SB_TEST_UNIAXIAL, limit, reach, 20, 0, 0);
    CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, NULL));
    CHECK_INT(info.stable, 0);
    CHECK_INT(info.unstable_kind, SB_TEST_UNIAXIAL);
    CHECK(info.unstable_strain >= (sb_real)(limit - 1e-3) &&
          info.unstable_strain <= (sb_real)(limit + (reach - 1) / 64 + 1e-3));
    /* Compressible, in compression: St.Venant-Kirchhoff softens and gives way. */
    m = sb_material_svk(1200, (sb_real)0.2, 1060);
    options = options_for(&m);
    data.count = 0;
    add_test(&data, &m, SB_TEST_UNIAXIAL, 0.8, 1.1, 10, 1, 0);
    CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, NULL));
    CHECK_INT(info.stable, 1);
    add_test(&data, &m, SB_TEST_UNIAXIAL, 0.45, 0.5, 3, 1, 0);
    CHECK_OK(sb_material_fit(m.model, data.points, data.count, &options, &fitted, &info, NULL));
    CHECK_INT(info.stable, 0);
    CHECK(info.unstable_strain > (sb_real)0.5 && info.unstable_strain < (sb_real)0.75);
}

/* ---- refusals ---- */

typedef struct refusal {
    sb_material_model model;
    fit_data data;
    sb_fit_options options;
} refusal;

static void check_refused(const refusal *r, sb_result expected, const char *fragment)
{
    sb_material material, untouched;
    sb_fit_info info, untouched_info;
    sb_error error;
    memset(&material, 0x5a, sizeof material);
    memset(&info, 0x5a, sizeof info);
    untouched = material;
    untouched_info = info;
    memset(&error, 0, sizeof error);
    CHECK_RESULT(sb_material_fit(r->model, r->data.points, r->data.count, &r->options, &material, &info, NULL),
                 expected);
    CHECK_RESULT(sb_material_fit(r->model, r->data.points, r->data.count, &r->options, &material, &info, &error),
                 expected);
    CHECK_INT(error.result, expected);
    if (!CHECK(strstr(error.message, fragment) != NULL))
        printf("  message: %s\n", error.message);
    CHECK(memcmp(&material, &untouched, sizeof material) == 0);
    CHECK(memcmp(&info, &untouched_info, sizeof info) == 0);
}

static refusal good_case(void)
{
    sb_material m = example(1);
    refusal r;
    r.model = m.model;
    r.data = all_tests(&m, 1, 3, 0, 0);
    r.options = options_for(&m);
    return r;
}

static void test_refused_readings(void)
{
    const sb_real zero = 0;
    const int unknown = 9; /* copied in: no enumerator has it */
    refusal r = good_case();
    r.data.points[4].strain = (sb_real)-0.25;
    check_refused(&r, SB_ERROR_ARGUMENT, "reading 4 has stretch -0.25");
    r.data.points[4].strain = 0;
    check_refused(&r, SB_ERROR_ARGUMENT, "reading 4 has stretch 0");
    check_bad_numbers();
    r.data.points[4].strain = zero / zero;
    check_refused(&r, SB_ERROR_NOT_FINITE, "reading 4 has strain");
    r = good_case();
    r.data.points[2].stress = 1 / zero;
    check_refused(&r, SB_ERROR_NOT_FINITE, "reading 2 has strain");
    r = good_case();
    memcpy(&r.data.points[2].kind, &unknown, sizeof unknown);
    check_refused(&r, SB_ERROR_ARGUMENT, "reading 2 has a test of unknown kind 9");
    r = good_case();
    memcpy(&r.data.points[2].measure, &unknown, sizeof unknown);
    check_refused(&r, SB_ERROR_ARGUMENT, "unknown measure 9");
    r = good_case();
    r.data.count = 1;
    check_refused(&r, SB_ERROR_ARGUMENT, "1 readings that count are too few for 2 constants");
    r.data.count = -1;
    check_refused(&r, SB_ERROR_ARGUMENT, "count -1");
    r = good_case(); /* all at rest */
    r.options.relative = 0;
    for (int k = 0; k < r.data.count; k++) {
        r.data.points[k].strain = r.data.points[k].kind == SB_TEST_SIMPLE_SHEAR ? 0 : 1;
        r.data.points[k].stress = 5;
    }
    check_refused(&r, SB_ERROR_INDEFINITE, "do not determine c10");
    r.options.relative = 1;
    for (int k = 0; k < r.data.count; k++)
        r.data.points[k].stress = 0;
    check_refused(&r, SB_ERROR_ARGUMENT, "0 readings that count");
    r = good_case(); /* one strain only, three constants */
    r.model = SB_REDUCED_POLYNOMIAL;
    r.options.order = 3;
    for (int k = 0; k < r.data.count; k++)
        r.data.points[k] = r.data.points[0];
    check_refused(&r, SB_ERROR_INDEFINITE, "do not determine c20");
    r = good_case(); /* stress against the strain */
    for (int k = 0; k < r.data.count; k++)
        r.data.points[k].stress = -r.data.points[k].stress;
    check_refused(&r, SB_ERROR_MATERIAL, "ask for mu = -");
    r.options.nonnegative = 1;
    check_refused(&r, SB_ERROR_MATERIAL, "ask for mu = 0 Pa");
}

static void test_refused_options(void)
{
    const sb_real zero = 0;
    refusal r = good_case();
    sb_material m;
    r.options.d1 = 0;
    r.options.poisson = (sb_real)0.5;
    check_bad_numbers();
    check_refused(&r, SB_ERROR_ARGUMENT, "poisson is 0.5");
    r.options.poisson = -1;
    check_refused(&r, SB_ERROR_ARGUMENT, "poisson is -1");
    r.options.poisson = zero / zero;
    check_refused(&r, SB_ERROR_NOT_FINITE, "poisson");
    r = good_case();
    r.options.d1 = -1;
    check_refused(&r, SB_ERROR_ARGUMENT, "d1 is -1");
    r = good_case();
    r.options.density = 0;
    check_refused(&r, SB_ERROR_ARGUMENT, "density is 0");
    r = good_case();
    r.model = (sb_material_model)0;
    check_refused(&r, SB_ERROR_ARGUMENT, "model 0");
    r.model = SB_REDUCED_POLYNOMIAL;
    r.options.order = 4;
    check_refused(&r, SB_ERROR_ARGUMENT, "order is 4");
    r.options.order = 0;
    check_refused(&r, SB_ERROR_ARGUMENT, "order is 0");
    r = good_case();
    CHECK_RESULT(sb_material_fit(r.model, NULL, 3, NULL, &m, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_material_fit(r.model, r.data.points, 3, NULL, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_OK(sb_material_fit(r.model, r.data.points, r.data.count, NULL, &m, NULL, NULL));
    CHECK_NEAR(sb_material_poisson(&m), 0.49, tolerance(1e-12, 100));
    CHECK_NEAR(m.density, 1000, 0);
    for (int model = SB_OGDEN; model <= SB_FUNG; model++) {
        const sb_test_point point = {SB_TEST_UNIAXIAL, SB_STRESS_NOMINAL, REAL(1.1), 100};
        CHECK_RESULT(sb_material_fit((sb_material_model)model, &point, 1, NULL, &m, NULL, NULL), SB_ERROR_ARGUMENT);
    }
}

/* A strain that the material cannot reach with a free side. */
static void test_out_of_reach(void)
{
    sb_material svk = sb_material_svk(1200, (sb_real)0.4, 1060);
    refusal r;
    r.model = svk.model;
    r.options = options_for(&svk);
    r.data.count = 0;
    add_test(&r.data, &svk, SB_TEST_UNIAXIAL, 0.9, 1.1, 4, 1, 0);
    r.data.points[4] = r.data.points[3];
    r.data.points[4].kind = SB_TEST_EQUIBIAXIAL;
    r.data.points[4].strain = (sb_real)1.8;
    r.data.points[4].stress = 9000;
    r.data.count = 5;
    check_refused(&r, SB_ERROR_DIVERGED, "equibiaxial test at strain 1.8 (reading 4)");
}

/* ---- Prony series ---- */

static sb_material liver(void) { return sb_material_preset(SB_LIVER_RAGHUNATHAN, 1060); }

/* count readings from first to last, evenly in log time. */
static void relax(const sb_material *m, double first, double last, int count, double noise, sb_real *time, sb_real *g)
{
    unsigned long long seed = 91;
    for (int k = 0; k < count; k++) {
        time[k] = (sb_real)(first * pow(last / first, (double)k / (count - 1)));
        g[k] = (sb_real)((double)sb_material_relaxation(m, time[k]) * (1 + check_random_in(&seed, -noise, noise)));
    }
}

static void test_prony_exact(void)
{
    sb_real time[60], g[60];
    sb_material m = liver(), fitted = sb_material_neo_hookean(1000, (sb_real)0.4, 1000);
    sb_fit_info info;
    relax(&m, 0.1, 2000, 60, 0, time, g);
    CHECK_OK(sb_material_fit_prony(time, g, 60, m.prony_tau, 3, &fitted, &info, NULL));
    CHECK_INT(fitted.prony_count, 3);
    for (int i = 0; i < 3; i++) {
        CHECK_NEAR(fitted.prony_g[i], m.prony_g[i], tolerance(1e-10, 1e3));
        CHECK_NEAR(fitted.prony_tau[i], m.prony_tau[i], 0);
    }
    CHECK_INT(fitted.model, SB_NEO_HOOKEAN);
    CHECK_OK(sb_material_check(&fitted, NULL));
    CHECK(info.points == 60 && info.constants == 3 && info.stable == 1);
    CHECK_NEAR(info.rms, 0, tolerance(1e-12, 100));
    CHECK_NEAR(info.r_squared, 1, tolerance(1e-12, 100));
    CHECK(info.weakest > (sb_real)0.1);
}

/* A relaxation time that takes no part is left out, at either end of the list or between. */
static void test_prony_leaves_out(void)
{
    const sb_real tau[5] = {(sb_real)0.3, (sb_real)2.1, 10, (sb_real)47.1, 380};
    sb_real time[60], g[60];
    sb_material m = liver(), fitted = m;
    sb_fit_info info;
    relax(&m, 0.1, 2000, 60, 0, time, g);
    if (SB_REAL_IS_FLOAT) /* whose rounding asks for a little of each */
        return;
    CHECK_OK(sb_material_fit_prony(time, g, 60, tau, 5, &fitted, &info, NULL));
    CHECK_INT(fitted.prony_count, 3);
    for (int i = 0; i < 3; i++)
        CHECK_NEAR(fitted.prony_g[i], m.prony_g[i], 1e-8);
    CHECK_INT(info.constants, 3);
}

static void test_prony_noisy(void)
{
    static sb_real time[2000], g[2000];
    sb_material m = liver(), fitted = m;
    sb_fit_info info;
    relax(&m, 0.05, 4000, 2000, 0.01, time, g);
    CHECK_OK(sb_material_fit_prony(time, g, 2000, m.prony_tau, 3, &fitted, &info, NULL));
    for (int i = 0; i < 3; i++)
        CHECK_NEAR((double)fitted.prony_g[i] / (double)m.prony_g[i], 1, 0.01);
    CHECK(info.rms > (sb_real)1e-3 && info.rms < (sb_real)6e-3);
}

/* Without times: one in every factor 4 follows the curve, nothing negative comes back. */
static void test_prony_spread(void)
{
    sb_real time[80], g[80];
    sb_material m = liver(), fitted = m;
    sb_fit_info info;
    double worst = 0;
    relax(&m, 0.1, 2000, 80, 0, time, g);
    CHECK_OK(sb_material_fit_prony(time, g, 80, NULL, SB_MAX_PRONY_TERMS, &fitted, &info, NULL));
    CHECK_OK(sb_material_check(&fitted, NULL));
    CHECK(fitted.prony_count >= 4 && info.constants == fitted.prony_count);
    for (int k = 0; k < 80; k++)
        worst = fmax(worst, fabs((double)sb_material_relaxation(&fitted, time[k]) - (double)g[k]));
    CHECK(worst < 0.02); /* true times lie up to a factor 2 from the nearest */
    CHECK(info.r_squared > (sb_real)0.999);
    CHECK_OK(sb_material_fit_prony(time, g, 80, NULL, 1, &fitted, &info, NULL));
    CHECK_INT(fitted.prony_count, 1);
    CHECK_NEAR(fitted.prony_tau[0], sqrt(0.1 * 2000), 1e-3);
}

/* An elastic material needs no terms. */
static void test_prony_of_elastic(void)
{
    sb_real time[10], g[10];
    sb_material m = sb_material_svk(1000, (sb_real)0.4, 1000), fitted = liver();
    sb_fit_info info;
    relax(&m, 0.1, 100, 10, 0, time, g);
    CHECK_OK(sb_material_fit_prony(time, g, 10, NULL, 3, &fitted, &info, NULL));
    CHECK(fitted.prony_count == 0 && info.constants == 0);
    CHECK_NEAR(info.r_squared, 0, 0);
}

static void check_prony_refused(const sb_real *time, const sb_real *g, int count, const sb_real *tau, int terms,
                                sb_material material, sb_result expected, const char *fragment)
{
    sb_material untouched = material;
    sb_fit_info info, untouched_info;
    sb_error error;
    memset(&info, 0x5a, sizeof info);
    untouched_info = info;
    memset(&error, 0, sizeof error);
    CHECK_RESULT(sb_material_fit_prony(time, g, count, tau, terms, &material, &info, &error), expected);
    if (!CHECK(strstr(error.message, fragment) != NULL))
        printf("  message: %s\n", error.message);
    CHECK(memcmp(&material, &untouched, sizeof material) == 0);
    CHECK(memcmp(&info, &untouched_info, sizeof info) == 0);
}

static void test_prony_refused(void)
{
    const sb_real zero = 0;
    sb_real time[20], g[20], tau[3] = {1, 10, 100};
    sb_material m = liver();
    relax(&m, 0.1, 2000, 20, 0, time, g);
    check_prony_refused(NULL, g, 20, tau, 3, m, SB_ERROR_ARGUMENT, "NULL");
    check_prony_refused(time, NULL, 20, tau, 3, m, SB_ERROR_ARGUMENT, "NULL");
    CHECK_RESULT(sb_material_fit_prony(time, g, 20, tau, 3, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    check_prony_refused(time, g, 20, tau, 0, m, SB_ERROR_ARGUMENT, "0 Prony terms");
    check_prony_refused(time, g, 20, tau, SB_MAX_PRONY_TERMS + 1, m, SB_ERROR_ARGUMENT, "9 Prony terms");
    check_prony_refused(time, g, 2, tau, 3, m, SB_ERROR_ARGUMENT, "2 readings are too few");
    check_prony_refused(time, g, -5, tau, 3, m, SB_ERROR_ARGUMENT, "-5 readings are too few");
    tau[1] = 0;
    check_prony_refused(time, g, 20, tau, 3, m, SB_ERROR_ARGUMENT, "tau 1 is 0 s");
    check_bad_numbers();
    tau[1] = 1 / zero;
    check_prony_refused(time, g, 20, tau, 3, m, SB_ERROR_NOT_FINITE, "tau 1 is inf");
    tau[1] = tau[0];
    check_prony_refused(time, g, 20, tau, 3, m, SB_ERROR_INDEFINITE, "g of tau 1, 1 s");
    tau[1] = 10;
    time[3] = 0;
    check_prony_refused(time, g, 20, tau, 3, m, SB_ERROR_ARGUMENT, "reading 3 has time 0 s");
    time[3] = zero / zero;
    check_prony_refused(time, g, 20, tau, 3, m, SB_ERROR_NOT_FINITE, "reading 3 has time");
    time[3] = 1;
    g[5] = 1 / zero;
    check_prony_refused(time, g, 20, tau, 3, m, SB_ERROR_NOT_FINITE, "reading 5 has time");
    for (int k = 0; k < 20; k++)
        g[k] = (sb_real)-0.5;
    check_prony_refused(time, g, 20, tau, 3, m, SB_ERROR_MATERIAL, "must be");
    relax(&m, 0.1, 2000, 20, 0, time, g);
    check_prony_refused(time, g, 20, tau, 3, sb_material_corotated(1000, (sb_real)0.4, 1000), SB_ERROR_MATERIAL,
                        "not hyperelastic");
}

/* ---- moduli of oscillations ---- */

enum { SWEEP = 31 };

/* G' and G'' (Pa) of m over frequencies from low to high (rad/s), each off by up to the share `noise`. */
static void oscillate(const sb_material *m, double low, double high, double noise, sb_real *omega, sb_real *storage,
                      sb_real *loss)
{
    unsigned long long seed = 77;
    for (int k = 0; k < SWEEP; k++) {
        omega[k] = (sb_real)(low * pow(high / low, k / (double)(SWEEP - 1)));
        sb_material_shear_moduli(m, omega[k], storage + k, loss + k);
        storage[k] *= (sb_real)(1 + check_random_in(&seed, -noise, noise));
        loss[k] *= (sb_real)(1 + check_random_in(&seed, -noise, noise));
    }
}

/* The constants that the data were made with come back, whatever the material came in with. */
static void test_moduli_exact(void)
{
    const sb_real g[3] = {REAL(0.4), REAL(0.2), REAL(0.1)}, tau[3] = {REAL(0.01), REAL(0.3), REAL(9)};
    sb_material made = sb_material_with_prony(sb_material_fung(500, 1, REAL(1e-4), 1000), g, tau, 3);
    sb_material fitted = sb_material_mooney_rivlin(7, 3, REAL(1e-2), 1000);
    sb_real omega[SWEEP], storage[SWEEP], loss[SWEEP], poisson = sb_material_poisson(&fitted);
    sb_fit_info info;
    oscillate(&made, 0.01, 1000, 0, omega, storage, loss);
    CHECK_OK(sb_material_fit_moduli(omega, storage, loss, SWEEP, tau, 3, &fitted, &info, NULL));
    CHECK_INT(fitted.prony_count, 3);
    for (int i = 0; i < 3; i++)
        CHECK_NEAR(fitted.prony_g[i] / g[i], 1, tolerance(1e-9, 1e3));
    CHECK_NEAR(fitted.mu / made.mu, 1, tolerance(1e-9, 1e3));
    CHECK_NEAR(2 * (fitted.c10 + fitted.c01) / made.mu, 1, tolerance(1e-9, 1e3));
    CHECK_NEAR(fitted.c10 / fitted.c01, 7.0 / 3, tolerance(1e-9, 1e3));
    CHECK_NEAR(sb_material_poisson(&fitted), poisson, tolerance(1e-12, 100));
    CHECK_NEAR(info.rms, 0, tolerance(1e-9, 100));
    CHECK_INT(info.points, 2 * SWEEP);
    CHECK_INT(info.constants, 4);
    oscillate(&made, 0.01, 1000, 0.03, omega, storage, loss);
    CHECK_OK(sb_material_fit_moduli(omega, storage, loss, SWEEP, tau, 3, &fitted, &info, NULL));
    CHECK_NEAR(fitted.mu / made.mu, 1, 0.02);
    CHECK(info.rms > REAL(0.005) && info.rms < REAL(0.03));
}

/* Tissue has no single times: a spring beside a power law, G* = G (1 + (i omega tau)^a), as brain and liver are
 * measured (Kiss et al. 2004: a about 0.2), over five decades with terms that spread themselves. */
static void test_moduli_power_law(void)
{
    const double a = 0.2, stiffness = 1000, half_pi = 1.57079632679489661923;
    sb_real omega[SWEEP], storage[SWEEP], loss[SWEEP];
    sb_material fitted = sb_material_neo_hookean(3000, REAL(0.45), 1000);
    sb_fit_info info;
    for (int k = 0; k < SWEEP; k++) {
        double x = pow(10, -2 + 5.0 * k / (SWEEP - 1)), power = pow(x, a);
        omega[k] = REAL(x);
        storage[k] = REAL(stiffness * (1 + power * cos(a * half_pi)));
        loss[k] = REAL(stiffness * power * sin(a * half_pi));
    }
    CHECK_OK(sb_material_fit_moduli(omega, storage, loss, SWEEP, NULL, SB_MAX_PRONY_TERMS, &fitted, &info, NULL));
    CHECK(info.rms < REAL(0.02));
    CHECK(info.r_squared > REAL(0.995));
    CHECK_OK(sb_material_check(&fitted, NULL));
}

/* A point that is sheared back and forth answers with these moduli: in phase and a quarter period ahead. */
static void test_moduli_in_time(void)
{
    const sb_real g[2] = {REAL(0.5), REAL(0.2)}, tau[2] = {REAL(0.05), REAL(1)};
    sb_material m = sb_material_with_prony(sb_material_neo_hookean(3000, REAL(0.45), 1000), g, tau, 2);
    const int steps = 400, periods = 8;
    const double period = 0.4, omega = 2 * 3.14159265358979323846 / period, size = 1e-3;
    double in_phase = 0, ahead = 0;
    sb_material_history history;
    sb_real storage, loss;
    memset(&history, 0, sizeof history);
    for (int i = 1; i <= periods * steps; i++) {
        sb_mat3 f = sb_m3_identity(), p;
        double angle = omega * period * i / steps;
        f.m[0][1] = REAL(size * sin(angle));
        CHECK(sb_material_history_stress(&m, &history, &f, REAL(period / steps), NULL, &p));
        if (i > (periods - 1) * steps) {
            in_phase += 2.0 / steps * (double)p.m[0][1] / size * sin(angle);
            ahead += 2.0 / steps * (double)p.m[0][1] / size * cos(angle);
        }
    }
    sb_material_shear_moduli(&m, REAL(omega), &storage, &loss);
    CHECK_NEAR(in_phase / (double)storage, 1, SB_REAL_IS_FLOAT ? 1e-2 : 1e-3);
    CHECK_NEAR(ahead / (double)loss, 1, SB_REAL_IS_FLOAT ? 1e-2 : 2e-3);
    sb_material_shear_moduli(&m, 0, &storage, &loss);
    CHECK_NEAR(storage / m.mu, 0.3, tolerance(1e-12, 10));
    CHECK_NEAR(loss, 0, 0);
    sb_material_shear_moduli(NULL, 1, &storage, &loss);
    CHECK_NEAR(storage, 0, 0);
    sb_material_shear_moduli(&m, 1, NULL, NULL);
    check_bad_numbers();
    sb_material_shear_moduli(&m, SB_REAL_MAX * 2, &storage, &loss);
    CHECK_NEAR(storage / m.mu, 1, tolerance(1e-12, 10));
    CHECK_NEAR(loss, 0, 0);
}

static void check_moduli_refused(const sb_real *omega, const sb_real *storage, const sb_real *loss, int count,
                                 const sb_real *tau, int terms, sb_material material, sb_result expected,
                                 const char *fragment)
{
    sb_material before = material;
    sb_fit_info info;
    sb_error error;
    memset(&info, 7, sizeof info);
    memset(&error, 0, sizeof error);
    CHECK_RESULT(sb_material_fit_moduli(omega, storage, loss, count, tau, terms, &material, &info, &error), expected);
    CHECK(memcmp(&material, &before, sizeof material) == 0);
    CHECK(((unsigned char *)&info)[0] == 7);
    if (!CHECK(strstr(error.message, fragment) != NULL))
        printf("  message: %s\n", error.message);
}

static void test_moduli_refused(void)
{
    const sb_real zero = 0, g[2] = {REAL(0.5), REAL(0.2)};
    sb_real omega[SWEEP], storage[SWEEP], loss[SWEEP], tau[2] = {REAL(0.05), REAL(1)};
    sb_material m = sb_material_with_prony(sb_material_neo_hookean(3000, REAL(0.45), 1000), g, tau, 2);
    oscillate(&m, 0.1, 100, 0, omega, storage, loss);
    check_moduli_refused(NULL, storage, loss, SWEEP, tau, 2, m, SB_ERROR_ARGUMENT, "NULL");
    check_moduli_refused(omega, NULL, loss, SWEEP, tau, 2, m, SB_ERROR_ARGUMENT, "NULL");
    check_moduli_refused(omega, storage, NULL, SWEEP, tau, 2, m, SB_ERROR_ARGUMENT, "NULL");
    check_moduli_refused(omega, storage, loss, SWEEP, tau, 0, m, SB_ERROR_ARGUMENT, "0 Prony terms");
    check_moduli_refused(omega, storage, loss, 1, tau, 2, m, SB_ERROR_ARGUMENT, "1 readings are too few");
    check_moduli_refused(omega, storage, loss, -1, NULL, 1, m, SB_ERROR_ARGUMENT, "too few");
    check_moduli_refused(omega, storage, loss, SWEEP, tau, 2, sb_material_corotated(1000, REAL(0.4), 1000),
                         SB_ERROR_MATERIAL, "not hyperelastic");
    tau[1] = tau[0];
    check_moduli_refused(omega, storage, loss, SWEEP, tau, 2, m, SB_ERROR_INDEFINITE, "g of tau");
    tau[1] = 1;
    for (int k = 0; k < SWEEP; k++) /* a fluid of Maxwell's */
        storage[k] = omega[k] * omega[k] / (1 + omega[k] * omega[k]), loss[k] = omega[k] / (1 + omega[k] * omega[k]);
    check_moduli_refused(omega, storage, loss, SWEEP, tau, 2, m, SB_ERROR_MATERIAL, "no modulus left");
    storage[3] = -1;
    check_moduli_refused(omega, storage, loss, SWEEP, tau, 2, m, SB_ERROR_ARGUMENT, "reading 3 has G' -1");
    storage[3] = loss[3] = 0;
    check_moduli_refused(omega, storage, loss, SWEEP, tau, 2, m, SB_ERROR_ARGUMENT, "not both 0");
    omega[2] = 0;
    check_moduli_refused(omega, storage, loss, SWEEP, tau, 2, m, SB_ERROR_ARGUMENT, "reading 2 has omega 0");
    check_bad_numbers();
    loss[1] = 1 / zero;
    check_moduli_refused(omega, storage, loss, SWEEP, tau, 2, m, SB_ERROR_NOT_FINITE, "reading 1 has");
}

CHECK_SUITE(material_fit, {"exact data", test_exact_data}, {"noisy data", test_noisy_data},
            {"single tests", test_single_tests}, {"compressible data", test_compressible_data},
            {"kinematics matter", test_kinematics_matter}, {"linear Young's modulus", test_linear_young},
            {"points at rest", test_points_at_rest}, {"nonnegative constants", test_nonnegative},
            {"weighting", test_weighting}, {"stability", test_stability}, {"refused readings", test_refused_readings},
            {"refused options", test_refused_options}, {"out of reach", test_out_of_reach},
            {"Prony exact", test_prony_exact}, {"Prony leaves out", test_prony_leaves_out},
            {"Prony noisy", test_prony_noisy}, {"Prony spread", test_prony_spread},
            {"Prony of an elastic material", test_prony_of_elastic}, {"Prony refused", test_prony_refused},
            {"moduli exact and noisy", test_moduli_exact}, {"moduli of a power law", test_moduli_power_law},
            {"moduli in time", test_moduli_in_time}, {"moduli refused", test_moduli_refused});
