/* Tests of material: derivatives by differences, projections against a 9x9 eigen-decomposition, closed forms,
 * objectivity, fibres, relaxation, parameter checks, inadmissible deformations. */
#include "softbody.h"

#include "check.h"

#define YOUNG ((sb_real)5e3)
#define POISSON ((sb_real)0.4)
#define DENSITY ((sb_real)1060)

/* Cases are the models and, for derivatives, more of the isochoric family: negative constants, high powers. */
enum { MODEL_COUNT = 11, CASE_COUNT = 15, SAMPLES = 100 };

/* A tolerance for double, or `epsilons` roundings in a float build where those are more. */
static double tolerance(double in_double, double epsilons)
{
    double rounding = epsilons * (double)SB_EPSILON;
    return rounding > in_double ? rounding : in_double;
}

static sb_material material_of(int model)
{
    switch (model) {
    case SB_LINEAR: return sb_material_linear(YOUNG, POISSON, DENSITY);
    case SB_COROTATED: return sb_material_corotated(YOUNG, POISSON, DENSITY);
    case SB_COROTATED_INVERTIBLE: return sb_material_corotated_invertible(YOUNG, POISSON, DENSITY);
    case SB_SVK: return sb_material_svk(YOUNG, POISSON, DENSITY);
    case SB_NEO_HOOKEAN: return sb_material_neo_hookean(YOUNG, POISSON, DENSITY);
    case SB_STABLE_NEO_HOOKEAN: return sb_material_stable_neo_hookean(YOUNG, POISSON, DENSITY);
    default: break;
    }
    sb_material equivalent = sb_material_svk(YOUNG, POISSON, DENSITY);
    sb_real c = equivalent.c10, d1 = equivalent.d1;
    const sb_real mu[2] = {c, -c / 2}, alpha[2] = {(sb_real)2.5, -3};                 /* 2.5 c + 1.5 c = 4 c = 2 mu */
    const sb_real steep_mu[3] = {c / 2, c / 3, -c / 2}, steep_alpha[3] = {-1, 9, -3}; /* (-0.5 + 3 + 1.5) c = 4 c */
    switch (model) {
    case SB_OGDEN: return sb_material_ogden(mu, alpha, 2, d1, DENSITY);
    case SB_FUNG: return sb_material_fung(c, (sb_real)0.7, d1, DENSITY);
    case MODEL_COUNT + 3: return sb_material_ogden(steep_mu, steep_alpha, 3, d1, DENSITY);
    case MODEL_COUNT + 4: return sb_material_fung(c, (sb_real)1.5, d1, DENSITY);
    case SB_MOONEY_RIVLIN: return sb_material_mooney_rivlin((sb_real)0.75 * c, (sb_real)0.25 * c, d1, DENSITY);
    case SB_REDUCED_POLYNOMIAL: return sb_material_reduced_polynomial(c, c / 2, c / 8, d1, DENSITY);
    case MODEL_COUNT + 1: return sb_material_mooney_rivlin((sb_real)1.5 * c, -c / 2, d1, DENSITY);
    case MODEL_COUNT + 2: return sb_material_reduced_polynomial(c, -c / 2, c / 8, d1, DENSITY);
    default: return sb_material_neo_hookean_isochoric(c, d1, DENSITY);
    }
}

static int is_corotated(int model) { return model == SB_COROTATED || model == SB_COROTATED_INVERTIBLE; }

static sb_mat3 diagonal(double a, double b, double c)
{
    sb_mat3 d = sb_m3_zero();
    d.m[0][0] = (sb_real)a;
    d.m[1][1] = (sb_real)b;
    d.m[2][2] = (sb_real)c;
    return d;
}

static sb_mat3 random_rotation(unsigned long long *seed)
{
    sb_vec3 a, b, c;
    double length;
    do {
        a = sb_v3((sb_real)check_random_in(seed, -1, 1), (sb_real)check_random_in(seed, -1, 1),
                  (sb_real)check_random_in(seed, -1, 1));
        b = sb_v3((sb_real)check_random_in(seed, -1, 1), (sb_real)check_random_in(seed, -1, 1),
                  (sb_real)check_random_in(seed, -1, 1));
        length = (double)sb_v3_norm(sb_v3_cross(a, b));
    } while (length < 0.2);
    a = sb_v3_scale(1 / sb_v3_norm(a), a);
    c = sb_v3_cross(a, b);
    c = sb_v3_scale(1 / sb_v3_norm(c), c);
    return sb_m3_columns(a, sb_v3_cross(c, a), c);
}

/* A random rotation times I + entries in [-spread, spread]; away from J = 0 and from the corotated kink.
 * Every third one is turned inside out for models that admit it. */
static sb_mat3 random_deformation(int model, int sample, double spread, unsigned long long *seed)
{
    for (;;) {
        sb_mat3 f = sb_m3_identity(), u, v;
        sb_vec3 s;
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                f.m[i][j] += (sb_real)check_random_in(seed, -spread, spread);
        if (sample % 3 == 0 && sb_material_allows_inversion((sb_material_model)model))
            for (int j = 0; j < 3; j++)
                f.m[2][j] = -f.m[2][j];
        f = sb_m3_mul(random_rotation(seed), f);
        sb_m3_svd(f, &u, &s, &v);
        if (s.y + s.z > (sb_real)0.15 && sb_abs(sb_m3_det(f)) > (sb_real)0.1 &&
            (sb_m3_det(f) > 0 || sb_material_allows_inversion((sb_material_model)model)))
            return f;
    }
}

static double largest_of(const sb_real *a, int count)
{
    double largest = 0;
    for (int i = 0; i < count; i++)
        if (!(fabs((double)a[i]) <= largest)) /* NaN is the largest of all */
            largest = fabs((double)a[i]);
    return largest;
}

static double difference(const sb_real *a, const sb_real *b, int count)
{
    double largest = 0;
    for (int i = 0; i < count; i++) {
        double d = fabs((double)a[i] - (double)b[i]);
        if (!(d <= largest))
            largest = d;
    }
    return largest;
}

static const sb_real *flat(const sb_mat3 *a) { return &a->m[0][0]; }

/* ---- derivatives ---- */

/* Step and tolerance of central differences: errors are O(step^2) and O(epsilon / step). */
static sb_real difference_step(void) { return (sb_real)cbrt((double)SB_EPSILON); }
static double difference_tolerance(void) { return fmax(1e-6, 1e3 * pow((double)SB_EPSILON, 2.0 / 3)); }

static sb_mat3 stress_by_differences(const sb_material *m, sb_mat3 f)
{
    sb_mat3 p;
    for (int i = 0; i < 9; i++) {
        sb_mat3 low = f, high = f;
        sb_real below = 0, above = 0;
        high.m[i / 3][i % 3] += difference_step();
        low.m[i / 3][i % 3] -= difference_step();
        CHECK(sb_material_energy(m, &high, NULL, &above));
        CHECK(sb_material_energy(m, &low, NULL, &below));
        p.m[i / 3][i % 3] = (above - below) / (high.m[i / 3][i % 3] - low.m[i / 3][i % 3]);
    }
    return p;
}

static void test_stress_is_energy_gradient(void)
{
    for (int model = 1; model <= CASE_COUNT; model++) {
        sb_material m = material_of(model);
        unsigned long long seed = 11;
        int inverted = 0;
        double worst = 0;
        for (int sample = 0; sample < SAMPLES; sample++) {
            sb_mat3 f = random_deformation(model, sample, 0.5, &seed), p, expected = stress_by_differences(&m, f);
            inverted += sb_m3_det(f) < 0;
            CHECK(sb_material_stress(&m, &f, NULL, &p));
            worst = fmax(worst, difference(flat(&p), flat(&expected), 9) / largest_of(flat(&p), 9));
        }
        CHECK_NEAR(worst, 0, difference_tolerance());
        CHECK(inverted >= 20 || !sb_material_allows_inversion((sb_material_model)model));
    }
}

static void tangent_by_differences(const sb_material *m, sb_mat3 f, sb_real *A)
{
    for (int q = 0; q < 9; q++) {
        sb_mat3 low = f, high = f, below = f, above = f;
        high.m[q / 3][q % 3] += difference_step();
        low.m[q / 3][q % 3] -= difference_step();
        CHECK(sb_material_stress(m, &high, NULL, &above));
        CHECK(sb_material_stress(m, &low, NULL, &below));
        for (int p = 0; p < 9; p++)
            A[9 * p + q] = (flat(&above)[p] - flat(&below)[p]) / (high.m[q / 3][q % 3] - low.m[q / 3][q % 3]);
    }
}

static void test_tangent_is_stress_derivative(void)
{
    for (int model = 1; model <= CASE_COUNT; model++) {
        sb_material m = material_of(model);
        unsigned long long seed = 12;
        double worst = 0;
        for (int sample = 0; sample < SAMPLES; sample++) {
            sb_mat3 f = random_deformation(model, sample, 0.5, &seed);
            sb_real A[81], expected[81];
            tangent_by_differences(&m, f, expected);
            CHECK(sb_material_tangent(&m, &f, NULL, SB_TANGENT_EXACT, A));
            worst = fmax(worst, difference(A, expected, 81) / largest_of(A, 81));
        }
        CHECK_NEAR(worst, 0, difference_tolerance());
    }
}

static void test_tangents_are_symmetric(void)
{
    for (int model = 1; model <= CASE_COUNT; model++) {
        sb_material m = material_of(model);
        unsigned long long seed = 13;
        int asymmetric = 0;
        for (int sample = 0; sample < SAMPLES; sample++) {
            sb_mat3 f = random_deformation(model, sample, 0.6, &seed);
            sb_real A[81];
            CHECK(sb_material_tangent(&m, &f, NULL, (sb_tangent_kind)(sample % 3), A));
            for (int p = 0; p < 9; p++)
                for (int q = 0; q < p; q++)
                    asymmetric += A[9 * p + q] != A[9 * q + p];
        }
        CHECK_INT(asymmetric, 0);
    }
}

/* ---- projection ---- */

/* Eigenvalues and eigenvectors (columns of v) of a symmetric 9x9 matrix, by Jacobi rotations. */
static void eigen9(double a[9][9], double values[9], double v[9][9])
{
    for (int i = 0; i < 9; i++)
        for (int j = 0; j < 9; j++)
            v[i][j] = i == j;
    for (int sweep = 0; sweep < 12; sweep++)
        for (int p = 0; p < 9; p++)
            for (int q = p + 1; q < 9; q++) {
                double theta, t, c, s;
                if (fabs(a[p][q]) <= 1e-18 * (fabs(a[p][p]) + fabs(a[q][q])))
                    continue;
                theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
                t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1));
                c = 1 / sqrt(t * t + 1);
                s = t * c;
                for (int k = 0; k < 9; k++) {
                    double x = a[k][p], y = a[k][q], vx = v[k][p], vy = v[k][q];
                    a[k][p] = c * x - s * y;
                    a[k][q] = s * x + c * y;
                    v[k][p] = c * vx - s * vy;
                    v[k][q] = s * vx + c * vy;
                }
                for (int k = 0; k < 9; k++) {
                    double x = a[p][k], y = a[q][k];
                    a[p][k] = c * x - s * y;
                    a[q][k] = s * x + c * y;
                }
            }
    for (int i = 0; i < 9; i++)
        values[i] = a[i][i];
}

static void eigen_of_tangent(const sb_real *A, double values[9], double vectors[9][9])
{
    double a[9][9];
    for (int p = 0; p < 9; p++)
        for (int q = 0; q < 9; q++)
            a[p][q] = (double)A[9 * p + q];
    eigen9(a, values, vectors);
}

/* Nearest positive semidefinite matrix, the plain way; returns the lowest eigenvalue of A. */
static double project_by_eigenvalues(const sb_real *A, sb_real *projected)
{
    double values[9], vectors[9][9], lowest = HUGE_VAL;
    eigen_of_tangent(A, values, vectors);
    for (int k = 0; k < 9; k++)
        lowest = fmin(lowest, values[k]);
    for (int p = 0; p < 9; p++)
        for (int q = 0; q < 9; q++) {
            double sum = 0;
            for (int k = 0; k < 9; k++)
                sum += fmax(values[k], 0) * vectors[p][k] * vectors[q][k];
            projected[9 * p + q] = (sb_real)sum;
        }
    return lowest;
}

static double lowest_eigenvalue(const sb_real *A)
{
    double values[9], vectors[9][9], lowest = HUGE_VAL;
    eigen_of_tangent(A, values, vectors);
    for (int k = 0; k < 9; k++)
        lowest = fmin(lowest, values[k]);
    return lowest;
}

static void test_spd_tangent_is_the_projection(void)
{
    for (int model = 1; model <= CASE_COUNT; model++) {
        sb_material m = material_of(model);
        unsigned long long seed = 14;
        double worst = 0, lowest = 0;
        int definite = 0, indefinite = 0;
        for (int sample = 0; sample < 3 * SAMPLES; sample++) {
            sb_mat3 f = random_deformation(model, sample, 0.1 + 0.002 * sample, &seed);
            sb_real exact[81], spd[81], expected[81];
            double least, norm;
            CHECK(sb_material_tangent(&m, &f, NULL, SB_TANGENT_EXACT, exact));
            CHECK(sb_material_tangent(&m, &f, NULL, SB_TANGENT_SPD, spd));
            norm = largest_of(exact, 81);
            least = project_by_eigenvalues(exact, expected);
            worst = fmax(worst, difference(spd, expected, 81) / norm);
            lowest = fmin(lowest, lowest_eigenvalue(spd) / norm);
            if (least > 1e-4 * norm) {
                definite++;
                CHECK_NEAR(difference(spd, exact, 81), 0, 0);
            }
            indefinite += least < -1e-4 * norm;
        }
        CHECK_NEAR(worst, 0, tolerance(1e-11, 200));
        CHECK_NEAR(lowest, 0, tolerance(1e-13, 200));
        CHECK(model == SB_LINEAR || (indefinite >= 20 && definite >= 3));
    }
}

/* StVK compressed so that A_0101 vanishes while A_0110 does not: indefinite, though no pivot is below 0. */
static void test_projection_at_zero_pivot(void)
{
    sb_material m = material_of(SB_SVK);
    double a = sqrt((1.5 * (double)m.lambda + (double)m.mu) / (1.5 * (double)m.lambda + 2 * (double)m.mu));
    sb_mat3 f = diagonal(a, a, a);
    sb_real exact[81], spd[81], expected[81];
    CHECK(sb_material_tangent(&m, &f, NULL, SB_TANGENT_EXACT, exact));
    CHECK(sb_material_tangent(&m, &f, NULL, SB_TANGENT_SPD, spd));
    CHECK_NEAR(exact[10], 0, 20 * (double)(SB_EPSILON * m.lambda));
    CHECK(project_by_eigenvalues(exact, expected) < -0.1 * (double)m.mu);
    CHECK_NEAR(difference(spd, expected, 81), 0, 100 * (double)(SB_EPSILON * m.lambda));
}

/* exact = quasi + sum over pairs of tau_ij t_ij t_ij^T, with the twist vectors of the signed SVD. */
static void test_quasi_tangent_relation(void)
{
    for (int model = SB_COROTATED; model <= SB_COROTATED_INVERTIBLE; model++) {
        sb_material m = material_of(model);
        unsigned long long seed = 15;
        double worst = 0, lowest = 0;
        for (int sample = 0; sample < SAMPLES; sample++) {
            sb_mat3 f = random_deformation(model, sample, 0.5, &seed), u, v;
            sb_vec3 stretch;
            sb_real exact[81], quasi[81], s[3];
            CHECK(sb_material_tangent(&m, &f, NULL, SB_TANGENT_EXACT, exact));
            CHECK(sb_material_tangent(&m, &f, NULL, SB_TANGENT_QUASI, quasi));
            lowest = fmin(lowest, lowest_eigenvalue(quasi) / largest_of(quasi, 81));
            sb_m3_svd(f, &u, &stretch, &v);
            s[0] = stretch.x, s[1] = stretch.y, s[2] = stretch.z;
            for (int i = 0; i < 3; i++)
                for (int j = i + 1; j < 3; j++) {
                    sb_real tau =
                        (2 * m.mu * (s[i] + s[j] - 2) + 2 * m.lambda * (s[0] + s[1] + s[2] - 3)) / (s[i] + s[j]);
                    sb_mat3 twist = sb_m3_sub(sb_m3_outer(sb_m3_column(u, j), sb_m3_column(v, i)),
                                              sb_m3_outer(sb_m3_column(u, i), sb_m3_column(v, j)));
                    for (int p = 0; p < 9; p++)
                        for (int q = 0; q < 9; q++)
                            quasi[9 * p + q] += tau / 2 * flat(&twist)[p] * flat(&twist)[q];
                }
            worst = fmax(worst, difference(quasi, exact, 81) / largest_of(exact, 81));
        }
        CHECK_NEAR(worst, 0, tolerance(1e-12, 400));
        CHECK_NEAR(lowest, 0, tolerance(1e-14, 50));
    }
}

/* SB_TANGENT_QUASI of the models without a rotation is SB_TANGENT_SPD. */
static void test_quasi_of_other_models(void)
{
    for (int model = 1; model <= MODEL_COUNT; model++) {
        sb_material m = material_of(model);
        unsigned long long seed = 16;
        for (int sample = 0; sample < 10 && !is_corotated(model); sample++) {
            sb_mat3 f = random_deformation(model, sample, 0.6, &seed);
            sb_real spd[81], quasi[81];
            CHECK(sb_material_tangent(&m, &f, NULL, SB_TANGENT_SPD, spd));
            CHECK(sb_material_tangent(&m, &f, NULL, SB_TANGENT_QUASI, quasi));
            CHECK_NEAR(difference(spd, quasi, 81), 0, 0);
        }
    }
}

/* ---- rest state, objectivity, closed forms ---- */

static void test_hooke_tangent_at_rest(void)
{
    sb_mat3 rest = sb_m3_identity();
    for (int model = 1; model <= MODEL_COUNT; model++)
        for (int kind = 0; kind < 3; kind++) {
            sb_material m = material_of(model);
            sb_real A[81];
            CHECK(sb_material_tangent(&m, &rest, NULL, (sb_tangent_kind)kind, A));
            for (int p = 0; p < 81; p++) {
                int i = p / 27, j = p / 9 % 3, k = p / 3 % 3, l = p % 3;
                double expected =
                    (double)m.lambda * (i == j && k == l) + (double)m.mu * ((i == k && j == l) + (i == l && j == k));
                CHECK_NEAR(A[p], expected, 1e3 * (double)SB_EPSILON * (double)m.lambda);
            }
        }
}

static void test_rest_state(void)
{
    unsigned long long seed = 17;
    for (int model = 1; model <= MODEL_COUNT; model++) {
        sb_material m = material_of(model);
        for (int sample = 0; sample < 10; sample++) {
            sb_mat3 f = model == SB_LINEAR ? sb_m3_identity() : random_rotation(&seed), p;
            sb_real energy;
            CHECK(sb_material_stress(&m, &f, NULL, &p));
            CHECK(sb_material_energy(&m, &f, NULL, &energy));
            CHECK_NEAR(largest_of(flat(&p), 9), 0, 50 * (double)(SB_EPSILON * m.lambda));
            CHECK_NEAR(energy, 0, 50 * (double)(SB_EPSILON * m.lambda));
        }
    }
}

static void test_objectivity(void)
{
    for (int model = SB_COROTATED; model <= MODEL_COUNT; model++) {
        sb_material m = material_of(model);
        unsigned long long seed = 18;
        for (int sample = 0; sample < 30; sample++) {
            sb_mat3 f = random_deformation(model, sample, 0.5, &seed), q = random_rotation(&seed), p, turned_p;
            sb_mat3 turned = sb_m3_mul(q, f), expected;
            sb_real energy, turned_energy;
            CHECK(sb_material_stress(&m, &f, NULL, &p));
            CHECK(sb_material_stress(&m, &turned, NULL, &turned_p));
            CHECK(sb_material_energy(&m, &f, NULL, &energy));
            CHECK(sb_material_energy(&m, &turned, NULL, &turned_energy));
            expected = sb_m3_mul(q, p);
            CHECK_NEAR(difference(flat(&turned_p), flat(&expected), 9) / largest_of(flat(&p), 9), 0,
                       tolerance(1e-11, 1000));
            CHECK_NEAR(turned_energy / energy, 1, tolerance(1e-11, 1000));
        }
    }
}

/* Principal first Piola-Kirchhoff stresses under F = diag(s), written out by hand. */
static void closed_form(const sb_material *m, const double s[3], double g[3])
{
    double mu = (double)m->mu, lambda = (double)m->lambda, J = s[0] * s[1] * s[2];
    double I1 = s[0] * s[0] + s[1] * s[1] + s[2] * s[2], i = I1 * pow(J, -2.0 / 3) - 3;
    double I2 = J * J * (1 / (s[0] * s[0]) + 1 / (s[1] * s[1]) + 1 / (s[2] * s[2]));
    double q = 2 / (double)m->d1 * (J - 1) * J, p1 = (double)m->c10, p2 = 0;
    if (m->model == SB_REDUCED_POLYNOMIAL)
        p1 += 2 * (double)m->c20 * i + 3 * (double)m->c30 * i * i;
    if (m->model == SB_MOONEY_RIVLIN)
        p2 = (double)m->c01;
    if (m->model == SB_FUNG)
        p1 *= exp((double)m->fung_exponent * i);
    for (int k = 0; k < 3; k++) {
        double a = s[k];
        switch (m->model) {
        case SB_LINEAR:
        case SB_COROTATED:
        case SB_COROTATED_INVERTIBLE: g[k] = lambda * (s[0] + s[1] + s[2] - 3) + 2 * mu * (a - 1); break;
        case SB_SVK: g[k] = a * (lambda * (I1 - 3) / 2 + mu * (a * a - 1)); break;
        case SB_NEO_HOOKEAN: g[k] = mu * (a - 1 / a) + lambda * log(J) / a; break;
        case SB_STABLE_NEO_HOOKEAN: g[k] = mu * a + ((lambda + mu) * (J - 1) - mu) * J / a; break;
        case SB_OGDEN:
            g[k] = q / a;
            for (int t = 0; t < SB_MAX_OGDEN_TERMS; t++) {
                double alpha = (double)m->ogden_alpha[t], scale = pow(J, -alpha / 3);
                double mean = scale * (pow(s[0], alpha) + pow(s[1], alpha) + pow(s[2], alpha)) / 3;
                g[k] += (double)m->ogden_mu[t] * (scale * pow(a, alpha) - mean) / a;
            }
            break;
        default: /* isochoric: dI1b/da, dI2b/da */
            g[k] = p1 * 2 * pow(J, -2.0 / 3) * (a - I1 / (3 * a)) +
                   p2 * 2 * pow(J, -4.0 / 3) * (a * (I1 - a * a) - 2 * I2 / (3 * a)) + q / a;
        }
    }
}

static void test_closed_forms(void)
{
    const double stretches[7][3] = {{1.3, 1.3, 1.3}, {0.7, 0.7, 0.7}, {1.5, 1, 1},    {0.6, 1.1, 1.1},
                                    {2, 0.8, 0.8},   {1.4, 1.4, 0.6}, {1.7, 0.9, 0.5}};
    for (int model = 1; model <= CASE_COUNT; model++) {
        sb_material m = material_of(model);
        for (int c = 0; c < 7; c++) {
            double s[3], g[3];
            sb_mat3 f = diagonal(stretches[c][0], stretches[c][1], stretches[c][2]), p, expected;
            for (int k = 0; k < 3; k++)
                s[k] = (double)f.m[k][k];
            CHECK(sb_material_stress(&m, &f, NULL, &p));
            closed_form(&m, s, g);
            expected = diagonal(g[0], g[1], g[2]);
            CHECK_NEAR(difference(flat(&p), flat(&expected), 9) / largest_of(flat(&p), 9), 0, tolerance(1e-13, 60));
        }
    }
}

/* The free stretch b of a bar (a, b, b) or a sheet (a, a, b): where its stress vanishes, by bisection. */
static double free_stretch(const sb_material *m, double a, int sheet)
{
    double low = 0.2, high = 1.5;
    for (int step = 0; step < 60; step++) {
        double b = (low + high) / 2, g[3];
        const double s[3] = {a, sheet ? a : b, b};
        closed_form(m, s, g);
        if (g[2] < 0)
            low = b;
        else
            high = b;
    }
    return (low + high) / 2;
}

/* Bars and sheets with free sides, turned any way. */
static void test_uniaxial_and_biaxial(void)
{
    unsigned long long seed = 23;
    for (int model = SB_COROTATED; model <= MODEL_COUNT; model++)
        for (int c = 0; c < 6; c++) {
            sb_material m = material_of(model);
            int sheet = c % 2;
            double a = c < 2 ? 0.85 : c < 4 ? 1.1 : 1.25, b = free_stretch(&m, a, sheet), g[3];
            const double s[3] = {a, sheet ? a : b, b};
            sb_mat3 turn = random_rotation(&seed), f = sb_m3_mul(turn, diagonal(s[0], s[1], s[2])), p;
            CHECK(sb_material_stress(&m, &f, NULL, &p));
            p = sb_m3_tmul(turn, p);
            closed_form(&m, s, g);
            CHECK(fabs(g[0]) > 0.1 * (double)m.mu);
            CHECK_NEAR((double)p.m[0][0] / g[0], 1, tolerance(1e-8, 400));
            CHECK_NEAR((double)p.m[1][1] / g[0], sheet, tolerance(1e-8, 400));
            CHECK_NEAR((double)p.m[2][2] / g[0], 0, tolerance(1e-8, 400));
        }
}

/* Shear stress P_01 of F = I + gamma e_0 e_1^T. */
static void test_simple_shear(void)
{
    for (int model = 1; model <= CASE_COUNT; model++)
        for (int c = 1; c <= 4; c++) {
            sb_material m = material_of(model);
            double mu = (double)m.mu, gamma = 0.25 * c, square = gamma * gamma, expected = mu * gamma;
            sb_mat3 f = sb_m3_identity(), p;
            f.m[0][1] = (sb_real)gamma;
            if (is_corotated(model))
                continue;
            if (model == SB_SVK)
                expected += gamma * square * ((double)m.lambda / 2 + mu);
            if (m.model == SB_REDUCED_POLYNOMIAL)
                expected += gamma * square * (4 * (double)m.c20 + 6 * (double)m.c30 * square);
            if (m.model == SB_FUNG)
                expected *= exp((double)m.fung_exponent * square);
            if (m.model == SB_OGDEN) { /* dW/dgamma, stretches l, 1/l, 1: gamma = l - 1/l */
                double l = gamma / 2 + sqrt(1 + square / 4);
                expected = 0;
                for (int t = 0; t < SB_MAX_OGDEN_TERMS; t++)
                    expected += (double)m.ogden_mu[t] *
                                (pow(l, (double)m.ogden_alpha[t]) - pow(l, -(double)m.ogden_alpha[t])) / (l + 1 / l);
            }
            CHECK(sb_material_stress(&m, &f, NULL, &p));
            CHECK_NEAR((double)p.m[0][1] / expected, 1, tolerance(1e-8, 100));
        }
}

/* Corotated uniaxial stress with free sides: lateral stretch 1 - nu (a - 1), stress E (a - 1). */
static void test_uniaxial_young(void)
{
    const double a = 1.25, b = 1 - (double)POISSON * 0.25;
    for (int model = SB_LINEAR; model <= SB_COROTATED_INVERTIBLE; model++) {
        sb_material m = material_of(model);
        sb_mat3 f = diagonal(a, b, b), p, expected = diagonal((double)YOUNG * 0.25, 0, 0);
        CHECK(sb_material_stress(&m, &f, NULL, &p));
        CHECK_NEAR(difference(flat(&p), flat(&expected), 9), 0, 60 * (double)(SB_EPSILON * m.lambda));
    }
}

/* 30 degrees about z from a cold and a warm start: same stress, and the rotation comes back. */
static void test_warm_start(void)
{
    sb_material m = material_of(SB_COROTATED);
    sb_real c = sb_sqrt((sb_real)0.75), s = (sb_real)0.5;
    sb_mat3 r = sb_m3_columns(sb_v3(c, s, 0), sb_v3(-s, c, 0), sb_v3(0, 0, 1));
    sb_mat3 f = sb_m3_mul(r, diagonal(1.2, 0.9, 1.1)), cold, warm, back;
    sb_quat q = sb_quat_identity(), invertible_q;
    sb_real energy;
    CHECK(sb_material_stress(&m, &f, NULL, &cold));
    CHECK(sb_material_energy(&m, &f, &q, &energy));
    back = sb_quat_to_mat3(q);
    CHECK_NEAR(difference(flat(&back), flat(&r), 9), 0, tolerance(1e-9, 100));
    CHECK(sb_material_stress(&m, &f, &q, &warm));
    CHECK_NEAR(difference(flat(&warm), flat(&cold), 9), 0, 100 * (double)(SB_EPSILON * m.lambda));
    /* The history-free model leaves the quaternion alone. */
    m.model = SB_COROTATED_INVERTIBLE;
    q.w = invertible_q.w = (sb_real)0.6;
    q.x = (sb_real)0.8;
    q.y = q.z = 0;
    CHECK(sb_material_stress(&m, &f, &q, &warm));
    CHECK(q.w == invertible_q.w);
    CHECK_NEAR(difference(flat(&warm), flat(&cold), 9), 0, 100 * (double)(SB_EPSILON * m.lambda));
}

static void test_cauchy_and_von_mises(void)
{
    sb_mat3 f = diagonal(2, 0.5, 0.5), p = diagonal(3, 1, 1), sigma = sb_cauchy_stress(f, p);
    sb_material linear = material_of(SB_LINEAR), svk = material_of(SB_SVK);
    sb_mat3 expected = diagonal(12, 1, 1), shear = sb_m3_zero();
    CHECK_NEAR(difference(flat(&sigma), flat(&expected), 9), 0, 0);
    sigma = sb_material_cauchy_stress(&linear, f, p);
    CHECK_NEAR(difference(flat(&sigma), flat(&p), 9), 0, 0);
    sigma = sb_material_cauchy_stress(&svk, f, p);
    CHECK_NEAR(difference(flat(&sigma), flat(&expected), 9), 0, 0);
    CHECK_NEAR(sb_von_mises(expected), 11, 40 * (double)SB_EPSILON);
    shear.m[0][1] = shear.m[1][0] = 2;
    CHECK_NEAR(sb_von_mises(shear), 2 * sqrt(3.0), 10 * (double)SB_EPSILON);
    CHECK_NEAR(sb_von_mises(diagonal(5, 5, 5)), 0, 20 * (double)SB_EPSILON);
}

/* Stiffness scaled by 2^20 scales every result by 2^20: no threshold has a unit. */
static void test_stiffness_scale(void)
{
    const sb_real scale = 1048576;
    for (int model = 1; model <= MODEL_COUNT; model++) {
        sb_material soft = material_of(model), stiff = soft;
        unsigned long long seed = 19;
        stiff.lambda *= scale;
        stiff.mu *= scale;
        stiff.c10 *= scale;
        stiff.c01 *= scale;
        stiff.c20 *= scale;
        stiff.c30 *= scale;
        stiff.d1 /= scale;
        for (int t = 0; t < SB_MAX_OGDEN_TERMS; t++)
            stiff.ogden_mu[t] *= scale;
        for (int sample = 0; sample < 30; sample++) {
            sb_mat3 f = random_deformation(model, sample, 0.6, &seed);
            sb_real a[81], b[81];
            CHECK(sb_material_tangent(&soft, &f, NULL, SB_TANGENT_SPD, a));
            CHECK(sb_material_tangent(&stiff, &f, NULL, SB_TANGENT_SPD, b));
            for (int p = 0; p < 81; p++)
                a[p] *= scale;
            CHECK_NEAR(difference(a, b, 81) / largest_of(b, 81), 0, 100 * (double)SB_EPSILON);
        }
    }
}

/* ---- constants ---- */

static void test_constants(void)
{
    sb_material m = sb_material_neo_hookean_isochoric((sb_real)365, (sb_real)8.38e-4, 1000);
    CHECK_NEAR(sb_material_young(&m), 1987.4, 0.05);
    CHECK_NEAR(sb_material_poisson(&m), 0.3612, 5e-5);
    CHECK_NEAR(sb_material_bulk(&m), 2 / 8.38e-4, tolerance(1e-9, 1e4));
    CHECK_OK(sb_material_check(&m, NULL));
    for (int model = 1; model <= MODEL_COUNT; model++) {
        m = material_of(model);
        CHECK_INT(m.model, model);
        CHECK_NEAR(sb_material_young(&m), YOUNG, 20 * (double)(SB_EPSILON * YOUNG));
        CHECK_NEAR(sb_material_poisson(&m), POISSON, 20 * (double)SB_EPSILON);
        CHECK_NEAR(sb_material_bulk(&m), (double)YOUNG / (3 * (1 - 2 * (double)POISSON)),
                   40 * (double)(SB_EPSILON * YOUNG));
        CHECK_NEAR(2 * (m.c10 + m.c01), m.mu, 10 * (double)(SB_EPSILON * m.mu));
        CHECK_NEAR(2 / m.d1, sb_material_bulk(&m), 10 * (double)(SB_EPSILON * m.lambda));
        CHECK_NEAR(m.density, DENSITY, 0);
        CHECK_OK(sb_material_check(&m, NULL));
        CHECK_INT(sb_material_is_linear(m.model), model == SB_LINEAR);
        CHECK_INT(sb_material_is_hyperelastic(m.model), model != SB_LINEAR && !is_corotated(model));
        CHECK_INT(sb_material_allows_inversion(m.model),
                  model != SB_NEO_HOOKEAN && model != SB_NEO_HOOKEAN_ISOCHORIC && model < SB_MOONEY_RIVLIN);
    }
}

/* Tables 4.1 to 4.3 of the source, and the small-strain constants printed there. */
static void test_presets(void)
{
    const sb_material_model models[5] = {SB_REDUCED_POLYNOMIAL, SB_REDUCED_POLYNOMIAL, SB_MOONEY_RIVLIN,
                                         SB_NEO_HOOKEAN_ISOCHORIC, SB_LINEAR};
    const double mu[5] = {158.4, 795.4, 968.86, 730, 1987 / 2.72}, late[5] = {0.168, 0.17, 0.5112, 1, 1};
    const int terms[5] = {1, 3, 2, 0, 0};
    sb_material m;
    for (int preset = SB_LIVER_JORDAN; preset <= SB_LIVER_LINEAR; preset++) {
        int at = preset - 1;
        m = sb_material_preset((sb_preset)preset, DENSITY);
        CHECK_OK(sb_material_check(&m, NULL));
        CHECK_INT(m.model, models[at]);
        CHECK_INT(m.prony_count, terms[at]);
        CHECK_NEAR((double)m.mu / mu[at], 1, tolerance(1e-12, 10));
        CHECK_NEAR(m.density, DENSITY, 0);
        CHECK_NEAR(sb_material_relaxation(&m, 0), 1, 0);
        CHECK_NEAR(sb_material_relaxation(&m, (sb_real)1e9), late[at], tolerance(1e-12, 10));
    }
    m = sb_material_preset(SB_LIVER_KIM, DENSITY);
    CHECK_NEAR(sb_material_poisson(&m), 0.4976, 5e-5);
    m = sb_material_preset(SB_LIVER_NEO_HOOKEAN, DENSITY);
    CHECK_NEAR(sb_material_young(&m), 1987.4, 0.05);
    m = sb_material_preset((sb_preset)0, DENSITY);
    CHECK_RESULT(sb_material_check(&m, NULL), SB_ERROR_ARGUMENT);
}

static void check_refused(const sb_material *m, sb_result expected, const char *fragment)
{
    sb_error error;
    memset(&error, 0, sizeof error);
    CHECK_RESULT(sb_material_check(m, NULL), expected);
    CHECK_RESULT(sb_material_check(m, &error), expected);
    CHECK_INT(error.result, expected);
    if (!CHECK(strstr(error.message, fragment) != NULL))
        printf("  message: %s\n", error.message);
}

static void test_refused_parameters(void)
{
    const sb_real zero = 0;
    sb_material m;
    check_refused(NULL, SB_ERROR_ARGUMENT, "NULL");
    m = material_of(SB_SVK);
    m.model = (sb_material_model)0;
    check_refused(&m, SB_ERROR_ARGUMENT, "model 0");
    m = sb_material_svk(1000, (sb_real)0.6, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "ratio 0.6");
    m = sb_material_svk(1000, (sb_real)-1.5, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "ratio -1.5");
    check_bad_numbers();
    m = sb_material_svk(1000, (sb_real)0.5, 1000);
    check_refused(&m, SB_ERROR_NOT_FINITE, "lambda (Pa) is inf");
    m = sb_material_svk(-1000, (sb_real)0.3, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "modulus -1000 Pa");
    m = sb_material_svk(0, (sb_real)0.3, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "mu is 0 Pa");
    m = sb_material_svk(zero / zero, (sb_real)0.3, 1000);
    check_refused(&m, SB_ERROR_NOT_FINITE, "nan");
    m = sb_material_svk(1000, (sb_real)0.3, -7);
    check_refused(&m, SB_ERROR_MATERIAL, "density is -7");
    m = sb_material_svk(1000, (sb_real)0.3, 1 / zero);
    check_refused(&m, SB_ERROR_NOT_FINITE, "density (kg/m^3) is inf");
    m = material_of(SB_SVK); /* by hand: mu > 0, bulk < 0 */
    m.lambda = m.mu * (sb_real)-0.8;
    check_refused(&m, SB_ERROR_MATERIAL, "ratio -2");
    m = material_of(SB_SVK); /* lambda so large that mu is lost beside it */
    m.lambda = m.mu * 4 / SB_EPSILON;
    check_refused(&m, SB_ERROR_MATERIAL, "ratio 0.5");
}

static void test_refused_exponents(void)
{
    const sb_real zero = 0, mu[2] = {500, -100}, alpha[2] = {2, -2}, against[2] = {2, 12};
    const sb_real d1 = (sb_real)1e-4;
    sb_material m = sb_material_ogden(mu, against, 2, d1, 1000); /* 1000 - 1200 */
    check_refused(&m, SB_ERROR_MATERIAL, "(sum of mu_i alpha_i)/4 is -50 Pa");
    for (int terms = 0; terms <= SB_MAX_OGDEN_TERMS + 1; terms += SB_MAX_OGDEN_TERMS + 1) {
        m = sb_material_ogden(mu, alpha, terms, d1, 1000);
        check_refused(&m, SB_ERROR_MATERIAL, "(sum of mu_i alpha_i)/4 is 0 Pa");
    }
    m = sb_material_ogden(NULL, alpha, 2, d1, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "is 0 Pa");
    m = sb_material_ogden(mu, alpha, 2, d1, 1000);
    CHECK_OK(sb_material_check(&m, NULL));
    m.ogden_mu[3] = 7;
    check_refused(&m, SB_ERROR_MATERIAL, "term 3 has mu 7 Pa, but alpha 0");
    m = sb_material_ogden(mu, alpha, 2, d1, 1000);
    m.ogden_mu[0] = 600;
    check_refused(&m, SB_ERROR_MATERIAL, "mu is 600 Pa, but 2 (sum of mu_i alpha_i)/4 is 700 Pa");
    m = sb_material_fung(500, -1, d1, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "exponent is -1");
    m = sb_material_fung(0, 1, d1, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "c10 is 0 Pa");
    check_bad_numbers();
    m = sb_material_fung(500, zero / zero, d1, 1000);
    check_refused(&m, SB_ERROR_NOT_FINITE, "exponent is");
    m = sb_material_ogden(mu, alpha, 2, d1, 1000);
    m.ogden_alpha[2] = 1 / zero;
    check_refused(&m, SB_ERROR_NOT_FINITE, "term 2 has");
}

/* Ogden with exponents 2 and -2 is Mooney-Rivlin, Fung with exponent 0 neo-Hookean, to rounding; a deformation with
 * equal stretches, or nearly, is nothing special; Treloar's rubber at stretches 2 and 7 (Ogden 1972: mu 6.3e5, 1.2e3,
 * -1e4 Pa, alpha 1.3, 5, -2): f = sum mu_i (l^(alpha_i - 1) - l^(-alpha_i/2 - 1)) at constant volume. */
static void test_ogden_limits(void)
{
    const sb_real d1 = (sb_real)1e-4, mu[2] = {600, -200}, alpha[2] = {2, -2};
    const sb_real rubber_mu[3] = {630000, 1200, -10000}, rubber_alpha[3] = {(sb_real)1.3, 5, -2};
    sb_material ogden = sb_material_ogden(mu, alpha, 2, d1, 1000);
    sb_material mooney = sb_material_mooney_rivlin(300, 100, d1, 1000);
    sb_material fung = sb_material_fung(300, 0, d1, 1000);
    sb_material neo = sb_material_neo_hookean_isochoric(300, d1, 1000);
    sb_material rubber = sb_material_ogden(rubber_mu, rubber_alpha, 3, (sb_real)1e-9, 1000);
    unsigned long long seed = 31;
    for (int sample = 0; sample < SAMPLES; sample++) {
        double near_by = sample % 4 == 3 ? 1e-9 : sample % 4 == 2 ? 0 : 0.3;
        sb_mat3 f = sb_m3_mul(random_rotation(&seed), random_deformation(SB_OGDEN, sample, near_by, &seed)), p, q;
        sb_real A[81], B[81], a = 0, b = 0;
        CHECK(sb_material_energy(&ogden, &f, NULL, &a) && sb_material_energy(&mooney, &f, NULL, &b));
        CHECK_NEAR(a, b, 1e3 * (double)(SB_EPSILON * mooney.lambda));
        CHECK(sb_material_stress(&ogden, &f, NULL, &p) && sb_material_stress(&mooney, &f, NULL, &q));
        CHECK_NEAR(difference(flat(&p), flat(&q), 9), 0, 1e3 * (double)(SB_EPSILON * mooney.lambda));
        for (int kind = SB_TANGENT_EXACT; kind <= SB_TANGENT_SPD; kind++) {
            CHECK(sb_material_tangent(&ogden, &f, NULL, (sb_tangent_kind)kind, A));
            CHECK(sb_material_tangent(&mooney, &f, NULL, (sb_tangent_kind)kind, B));
            CHECK_NEAR(difference(A, B, 81), 0, 1e4 * (double)(SB_EPSILON * mooney.lambda));
        }
        CHECK(sb_material_tangent(&fung, &f, NULL, SB_TANGENT_EXACT, A));
        CHECK(sb_material_tangent(&neo, &f, NULL, SB_TANGENT_EXACT, B));
        CHECK_NEAR(difference(A, B, 81), 0, 1e4 * (double)(SB_EPSILON * mooney.lambda));
    }
    for (int c = 0; c < 2; c++) {
        double l = c ? 7 : 2, side = 1 / sqrt(l), expected = 0;
        sb_mat3 f = diagonal(l, side, side), p;
        CHECK(sb_material_stress(&rubber, &f, NULL, &p));
        for (int t = 0; t < 3; t++)
            expected +=
                (double)rubber_mu[t] * (pow(l, (double)rubber_alpha[t] - 1) - pow(l, -(double)rubber_alpha[t] / 2 - 1));
        /* the pressure that the free sides ask for is no deformation here */
        CHECK_NEAR(((double)p.m[0][0] - (double)p.m[1][1] * side / l) / expected, 1, tolerance(1e-6, 1e5));
    }
}

static void test_refused_isochoric(void)
{
    sb_material m = sb_material_neo_hookean_isochoric(-3, (sb_real)1e-3, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "c10 is -3");
    m = sb_material_neo_hookean_isochoric(300, (sb_real)-1e-3, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "d1 is -0.001");
    check_bad_numbers();
    m = sb_material_neo_hookean_isochoric(300, 0, 1000);
    check_refused(&m, SB_ERROR_NOT_FINITE, "lambda (Pa) is inf");
    m = sb_material_neo_hookean_isochoric(300, (sb_real)1e-3, 1000);
    m.mu = 700;
    check_refused(&m, SB_ERROR_MATERIAL, "2 c10 is 600");
    m = sb_material_neo_hookean_isochoric(300, (sb_real)1e-3, 1000);
    m.lambda *= 2;
    check_refused(&m, SB_ERROR_MATERIAL, "2/d1 is 2000");
    m = sb_material_neo_hookean_isochoric(300, (sb_real)0.1, 1000); /* bulk 20 Pa, mu 600 Pa: auxetic, valid */
    CHECK_OK(sb_material_check(&m, NULL));
    CHECK(sb_material_poisson(&m) < 0);
    m = sb_material_mooney_rivlin(300, -400, (sb_real)1e-3, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "c10 + c01 is -100");
    m = sb_material_mooney_rivlin(-300, 500, (sb_real)1e-3, 1000);
    CHECK_OK(sb_material_check(&m, NULL));
    m.mu = 401;
    check_refused(&m, SB_ERROR_MATERIAL, "2 (c10 + c01) is 400");
    m.c01 = m.c01 * 1 / (m.c01 - 500);
    check_refused(&m, SB_ERROR_NOT_FINITE, "c01 (Pa) is inf");
    m = sb_material_reduced_polynomial(300, -20, 5, (sb_real)1e-3, 1000);
    CHECK_OK(sb_material_check(&m, NULL));
    m.c30 = SB_REAL_MAX * 2;
    check_refused(&m, SB_ERROR_NOT_FINITE, "c30 (Pa) is inf");
    m = sb_material_reduced_polynomial(-300, 20, 5, (sb_real)1e-3, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "c10 is -300");
    m = material_of(SB_SVK); /* others do not read c10, d1 */
    m.c10 = m.d1 = 0;
    CHECK_OK(sb_material_check(&m, NULL));
}

static void test_refused_fibres(void)
{
    sb_material svk = material_of(SB_SVK), m = sb_material_with_fibres(svk, -1, 2);
    check_refused(&m, SB_ERROR_MATERIAL, "k1 -1 Pa");
    m = sb_material_with_fibres(svk, 1, -2);
    check_refused(&m, SB_ERROR_MATERIAL, "k2 -2");
    check_bad_numbers();
    m = sb_material_with_fibres(svk, 1, SB_REAL_MAX * 2);
    check_refused(&m, SB_ERROR_NOT_FINITE, "k2 inf");
    m = sb_material_with_fibres(svk, 100, 0);
    CHECK_OK(sb_material_check(&m, NULL));
    for (int model = SB_LINEAR; model <= SB_COROTATED_INVERTIBLE; model++) {
        m = sb_material_with_fibres(material_of(model), 100, 1);
        check_refused(&m, SB_ERROR_MATERIAL, "not hyperelastic");
    }
}

static void test_refused_prony(void)
{
    sb_real g[SB_MAX_PRONY_TERMS + 1], tau[SB_MAX_PRONY_TERMS + 1];
    sb_material svk = material_of(SB_SVK), m;
    for (int i = 0; i <= SB_MAX_PRONY_TERMS; i++) {
        g[i] = (sb_real)0.1;
        tau[i] = (sb_real)(1 + i);
    }
    m = sb_material_with_prony(svk, g, tau, SB_MAX_PRONY_TERMS);
    CHECK_OK(sb_material_check(&m, NULL));
    m = sb_material_with_prony(m, g, tau, 0);
    CHECK(m.prony_count == 0 && m.prony_g[0] == 0);
    CHECK_OK(sb_material_check(&m, NULL));
    m = sb_material_with_prony(svk, g, tau, SB_MAX_PRONY_TERMS + 1);
    check_refused(&m, SB_ERROR_ARGUMENT, "9 Prony terms");
    m = sb_material_with_prony(svk, NULL, tau, 2);
    check_refused(&m, SB_ERROR_ARGUMENT, "-1 Prony terms");
    m = sb_material_with_prony(svk, g, tau, -3);
    check_refused(&m, SB_ERROR_ARGUMENT, "-3 Prony terms");
    m = sb_material_with_prony(material_of(SB_COROTATED), g, tau, 2);
    check_refused(&m, SB_ERROR_MATERIAL, "not hyperelastic");
    tau[1] = 0;
    m = sb_material_with_prony(svk, g, tau, 2);
    check_refused(&m, SB_ERROR_MATERIAL, "term 1 has tau 0 s");
    check_bad_numbers();
    tau[1] = SB_REAL_MAX * 2;
    m = sb_material_with_prony(svk, g, tau, 2);
    check_refused(&m, SB_ERROR_NOT_FINITE, "term 1 has g 0.1 and tau inf");
    tau[1] = 1;
    g[1] = 1;
    m = sb_material_with_prony(svk, g, tau, 2);
    check_refused(&m, SB_ERROR_MATERIAL, "term 1 has g 1,");
    g[1] = 0;
    m = sb_material_with_prony(svk, g, tau, 2);
    check_refused(&m, SB_ERROR_MATERIAL, "term 1 has g 0,");
    g[1] = (sb_real)0.9375;
    m = sb_material_with_prony(svk, g, tau, 2);
    check_refused(&m, SB_ERROR_MATERIAL, "sum of g of 1.0375");
}

/* ---- fibres ---- */

static sb_material fibrous(int model, double k1, double k2)
{
    return sb_material_with_fibres(material_of(model), (sb_real)k1, (sb_real)k2);
}

static sb_vec3 random_direction(unsigned long long *seed) { return sb_m3_column(random_rotation(seed), 0); }

/* Matrix and fibres together: derivatives by differences, and by how much the fibres take part. */
static void test_fibre_derivatives(void)
{
    const double exponents[3] = {0, 0.7, 3};
    unsigned long long seed = 31;
    double stress_error = 0, tangent_error = 0, lowest = 0;
    int taut = 0, slack = 0;
    for (int sample = 0; sample < SAMPLES; sample++) {
        sb_material m = fibrous(SB_NEO_HOOKEAN, 2000, exponents[sample % 3]);
        sb_mat3 f = random_deformation(SB_NEO_HOOKEAN, sample, 0.3, &seed), p = sb_m3_zero(), expected_p;
        sb_vec3 a = random_direction(&seed);
        sb_real A[81] = {0}, expected[81], energy = 0, h = difference_step();
        for (int i = 0; i < 9; i++) {
            sb_mat3 low = f, high = f, below = sb_m3_zero(), above = sb_m3_zero();
            sb_real least = 0, most = 0, step;
            high.m[i / 3][i % 3] += h;
            low.m[i / 3][i % 3] -= h;
            step = high.m[i / 3][i % 3] - low.m[i / 3][i % 3];
            CHECK(sb_fibre_energy(&m, &low, a, &least) && sb_fibre_energy(&m, &high, a, &most));
            CHECK(sb_fibre_stress(&m, &low, a, &below) && sb_fibre_stress(&m, &high, a, &above));
            expected_p.m[i / 3][i % 3] = (most - least) / step;
            for (int q = 0; q < 9; q++)
                expected[9 * q + i] = (flat(&above)[q] - flat(&below)[q]) / step;
        }
        CHECK(sb_fibre_energy(&m, &f, a, &energy));
        CHECK(sb_fibre_stress(&m, &f, a, &p));
        CHECK(sb_fibre_tangent(&m, &f, a, A));
        taut += energy > 0;
        slack += energy == 0 && largest_of(flat(&p), 9) == 0 && largest_of(A, 81) == 0;
        if (sb_abs(sb_v3_norm(sb_m3_apply(f, a)) - 1) < 2 * h) /* across the kink */
            continue;
        stress_error = fmax(stress_error, difference(flat(&p), flat(&expected_p), 9) /
                                              fmax(largest_of(flat(&p), 9), (double)m.fibre_stiffness));
        tangent_error =
            fmax(tangent_error, difference(A, expected, 81) / fmax(largest_of(A, 81), (double)m.fibre_stiffness));
        if (energy > 0)
            lowest = fmin(lowest, lowest_eigenvalue(A) / largest_of(A, 81));
        for (int q = 0; q < 81; q++)
            CHECK(A[q] == A[9 * (q % 9) + q / 9]);
    }
    CHECK_NEAR(stress_error, 0, difference_tolerance());
    CHECK_NEAR(tangent_error, 0, difference_tolerance());
    CHECK_NEAR(lowest, 0, tolerance(1e-14, 20));
    CHECK(taut >= 20 && slack >= 20 && taut + slack == SAMPLES);
}

/* Pulled by 1.2 along the fibres: e = 0.44, P = 2 k1 e exp(k2 e^2) 1.2; the length of the direction is nothing. */
static void test_fibre_closed_form(void)
{
    const double k1 = 300, exponents[5] = {0, 1e-7, 0.1, 1, 5}, e = 1.2 * 1.2 - 1;
    sb_vec3 along = sb_v3(0, 7, 0);
    sb_mat3 f = diagonal(0.9, 1.2, 0.9);
    for (int c = 0; c < 5; c++) {
        double k2 = exponents[c], q = k2 * e * e;
        sb_material m = fibrous(SB_STABLE_NEO_HOOKEAN, k1, k2);
        sb_mat3 p = diagonal(1, 2, 3);
        sb_real energy = 5, A[81] = {0};
        CHECK_OK(sb_material_check(&m, NULL));
        CHECK(sb_fibre_energy(&m, &f, along, &energy));
        CHECK_NEAR((double)energy - 5, k2 > 0 ? k1 / (2 * k2) * expm1(q) : k1 / 2 * e * e, tolerance(1e-11, 200));
        CHECK(sb_fibre_stress(&m, &f, along, &p));
        CHECK_NEAR((double)p.m[1][1] - 2, 2.4 * k1 * e * exp(q), tolerance(1e-10, 1e4));
        CHECK(p.m[0][0] == 1 && p.m[2][2] == 3 && p.m[0][1] == 0);
        CHECK(sb_fibre_tangent(&m, &f, along, A));
        CHECK_NEAR((double)A[4 * 9 + 4] / (4 * 1.44 * k1 * exp(q) * (1 + 2 * q) + 2 * k1 * e * exp(q)), 1,
                   tolerance(1e-13, 50));
        CHECK_NEAR((double)A[1 * 9 + 1] / (2 * k1 * e * exp(q)), 1, tolerance(1e-13, 50));
        CHECK(A[0] == 0 && A[4] == 0);
    }
}

static void check_fibre_refused(const sb_material *m, const sb_mat3 *f, sb_vec3 direction)
{
    sb_real energy = 7, A[81];
    sb_mat3 p = diagonal(7, 7, 7), untouched = p;
    for (int i = 0; i < 81; i++)
        A[i] = 7;
    CHECK_INT(sb_fibre_energy(m, f, direction, &energy), 0);
    CHECK_INT(sb_fibre_stress(m, f, direction, &p), 0);
    CHECK_INT(sb_fibre_tangent(m, f, direction, A), 0);
    CHECK(energy == 7 && difference(flat(&p), flat(&untouched), 9) == 0);
    for (int i = 0; i < 81; i++)
        CHECK(A[i] == 7);
}

static void test_fibre_refused(void)
{
    sb_material m = fibrous(SB_SVK, 100, 2), none = material_of(SB_SVK);
    sb_mat3 rest = sb_m3_identity(), f = rest, p = sb_m3_zero();
    sb_vec3 x = sb_v3(1, 0, 0), bad = x;
    sb_real energy = 0, A[81] = {0};
    check_fibre_refused(NULL, &f, x);
    check_fibre_refused(&m, NULL, x);
    check_fibre_refused(&m, &f, sb_v3(0, 0, 0));
    check_bad_numbers();
    bad.y = SB_REAL_MAX * 2;
    check_fibre_refused(&m, &f, bad);
    f.m[2][1] = bad.y;
    check_fibre_refused(&m, &f, x);
    f = diagonal(1e3, 1, 1); /* exp(2e12) */
    check_fibre_refused(&m, &f, x);
    CHECK_INT(sb_fibre_energy(&m, &rest, x, NULL), 0);
    CHECK_INT(sb_fibre_stress(&m, &rest, x, NULL), 0);
    CHECK_INT(sb_fibre_tangent(&m, &rest, x, NULL), 0);
    /* No fibres and a wild exponent, a huge direction: nothing to overflow. */
    none.fibre_exponent = SB_REAL_MAX;
    CHECK(sb_fibre_energy(&none, &f, x, &energy) && energy == 0);
    CHECK(sb_fibre_stress(&none, &f, x, &p) && largest_of(flat(&p), 9) == 0);
    CHECK(sb_fibre_tangent(&none, &f, x, A) && largest_of(A, 81) == 0);
    f = diagonal(1.1, 1, 1);
    CHECK(sb_fibre_energy(&m, &f, sb_v3(SB_REAL_MAX, 0, 0), &energy));
    CHECK_NEAR((double)energy / (25 * expm1(2 * 0.21 * 0.21)), 1, tolerance(1e-13, 30));
}

/* ---- relaxation ---- */

static sb_material relaxing(sb_material m)
{
    const sb_real g[3] = {(sb_real)0.3, (sb_real)0.2, (sb_real)0.1}, tau[3] = {(sb_real)0.1, 1, 20};
    return sb_material_with_prony(m, g, tau, 3);
}

static double relaxation_of(double t)
{
    return 1 - 0.3 * (1 - exp(-t / 0.1)) - 0.2 * (1 - exp(-t)) - 0.1 * (1 - exp(-t / 20));
}

/* Integral of the relaxation from 0 to t. */
static double ramp_of(double t)
{
    return t - 0.3 * (t - 0.1 * (1 - exp(-t / 0.1))) - 0.2 * (t - (1 - exp(-t))) - 0.1 * (t - 20 * (1 - exp(-t / 20)));
}

static void test_relaxation_function(void)
{
    sb_material m = relaxing(material_of(SB_SVK)), elastic = material_of(SB_SVK);
    const double times[6] = {0, 1e-6, 0.05, 1, 30, 1e4};
    for (int c = 0; c < 6; c++) {
        CHECK_NEAR(sb_material_relaxation(&m, (sb_real)times[c]), relaxation_of(times[c]), tolerance(1e-14, 10));
        CHECK_NEAR(sb_material_relaxation(&elastic, (sb_real)times[c]), 1, 0);
    }
    CHECK_NEAR(sb_material_relaxation(&m, -1), 1, 0);
    check_bad_numbers();
    CHECK_NEAR(sb_material_relaxation(&m, SB_REAL_MAX * 2), 0.4, tolerance(1e-14, 10));
}

/* Stress at constant volume change and what is left of the rest, of a jump to F held for a time; models in which
 * the two are told apart by the trace of S C or by their own energies. Any division of the time is exact. */
static void test_jump_and_hold(void)
{
    const int steps[3] = {1, 7, 200};
    for (int model = SB_SVK; model <= MODEL_COUNT; model++) {
        sb_material elastic = material_of(model), m = relaxing(elastic), volume = elastic;
        sb_mat3 f = diagonal(1.3, 0.85, 0.95), whole, bulk = sb_m3_zero(), p, expected;
        f.m[0][1] = (sb_real)0.2;
        CHECK(sb_material_stress(&elastic, &f, NULL, &whole));
        if (model < SB_NEO_HOOKEAN_ISOCHORIC || model == SB_STABLE_NEO_HOOKEAN) {
            /* linear in lambda, mu: the bulk modulus' share is P(lambda = bulk, mu = 0) */
            volume.lambda = sb_material_bulk(&elastic);
            volume.mu = 0;
        } else {
            volume.c10 = volume.c01 = volume.c20 = volume.c30 = 0;
            memset(volume.ogden_mu, 0, sizeof volume.ogden_mu);
        }
        CHECK(sb_material_stress(&volume, &f, NULL, &bulk));
        for (int c = 0; c < 3; c++)
            for (int t = 0; t < 3; t++) {
                sb_material_history history;
                double time = t == 0 ? 0.02 : t == 1 ? 1.5 : 40;
                memset(&history, 0, sizeof history);
                CHECK(sb_material_history_stress(&m, &history, &f, 0, NULL, &p));
                CHECK_NEAR(difference(flat(&p), flat(&whole), 9) / largest_of(flat(&whole), 9), 0,
                           tolerance(1e-13, 50));
                for (int i = 0; i < steps[c]; i++)
                    CHECK(sb_material_history_stress(&m, &history, &f, (sb_real)(time / steps[c]), NULL, &p));
                expected = sb_m3_add(bulk, sb_m3_scale((sb_real)relaxation_of(time), sb_m3_sub(whole, bulk)));
                CHECK_NEAR(difference(flat(&p), flat(&expected), 9) / largest_of(flat(&whole), 9), 0,
                           tolerance(1e-12, 300));
            }
    }
}

/* A strain that grows evenly: StVK's stress is linear in it, so the ramp's closed form is met at any step. */
static void test_ramp(void)
{
    const int steps[3] = {1, 4, 300};
    sb_material m = relaxing(material_of(SB_SVK));
    double mu = (double)m.mu, bulk = (double)sb_material_bulk(&m), rate = 0.1, time = 2;
    for (int c = 0; c < 3; c++) {
        sb_material_history history;
        sb_mat3 f = sb_m3_identity(), p = f;
        double e, relaxed;
        memset(&history, 0, sizeof history);
        for (int i = 1; i <= steps[c]; i++) {
            f.m[0][0] = (sb_real)sqrt(1 + 2 * rate * time * i / steps[c]);
            CHECK(sb_material_history_stress(&m, &history, &f, (sb_real)(time / steps[c]), NULL, &p));
        }
        e = rate * time;
        relaxed = 2 * mu * rate * ramp_of(time);
        CHECK_NEAR((double)p.m[0][0] / ((double)f.m[0][0] * (bulk * e + relaxed * 2 / 3)), 1, tolerance(1e-12, 2000));
        CHECK_NEAR((double)p.m[1][1] / (bulk * e - relaxed / 3), 1, tolerance(1e-12, 2000));
    }
}

/* sin t in the strain: the error of halved steps falls by four. */
static double swing_error(int steps)
{
    const sb_real g = (sb_real)0.6, tau = (sb_real)0.5;
    sb_material m = sb_material_with_prony(material_of(SB_SVK), &g, &tau, 1);
    sb_material_history history;
    sb_mat3 f = sb_m3_identity(), p = f;
    double t = 3, x = 0.5, left, exact;
    memset(&history, 0, sizeof history);
    for (int i = 1; i <= steps; i++) {
        f.m[0][1] = (sb_real)(0.1 * sin(t * i / steps));
        CHECK(sb_material_history_stress(&m, &history, &f, (sb_real)(t / steps), NULL, &p));
    }
    /* S01 = mu 0.1 (0.4 sin t + 0.6 int exp(-(t-s)/x) cos s ds); P01 = S01 + f S11, f S11 being of third order */
    left = x / (1 + x * x) * (cos(t) + x * sin(t) - exp(-t / x));
    exact = (double)m.mu * 0.1 * (0.4 * sin(t) + 0.6 * left);
    return fabs((double)(p.m[1][0]) - exact); /* P10 = S10 alone */
}

static void test_swing(void)
{
    double coarse = swing_error(10), middle = swing_error(20), fine = swing_error(40);
    CHECK(coarse > 1e-3);
    CHECK_NEAR(coarse / middle, 4, 0.2);
    CHECK_NEAR(middle / fine, 4, 0.2);
}

/* Fibres relax with the rest; a fully relaxing step; the elastic material has no memory. */
static void test_relaxing_fibres(void)
{
    sb_material elastic = fibrous(SB_NEO_HOOKEAN, 900, 1), m = relaxing(elastic);
    sb_material_history history;
    const sb_vec3 direction = sb_v3(0, 2, 0);
    sb_mat3 f = diagonal(0.9, 1.3, 0.9), matrix, fibres = sb_m3_zero(), both, p;
    memset(&history, 0, sizeof history);
    CHECK(sb_fibre_stress(&elastic, &f, direction, &fibres));
    CHECK(sb_material_history_stress(&m, &history, &f, 0, &direction, &both));
    CHECK(sb_material_stress(&elastic, &f, NULL, &p));
    p = sb_m3_add(p, fibres);
    CHECK_NEAR(difference(flat(&p), flat(&both), 9) / largest_of(flat(&p), 9), 0, tolerance(1e-13, 50));
    check_bad_numbers();
    CHECK(sb_material_history_stress(&m, &history, &f, SB_REAL_MAX * 2, &direction, &both));
    memset(&history, 0, sizeof history);
    CHECK(sb_material_history_stress(&m, &history, &f, SB_REAL_MAX * 2, NULL, &matrix));
    CHECK_NEAR((double)(both.m[1][1] - matrix.m[1][1]) / (0.4 * (double)fibres.m[1][1]), 1, tolerance(1e-12, 100));
    memset(&history, 0, sizeof history);
    CHECK(sb_material_history_stress(&elastic, &history, &f, 1, &direction, &both));
    CHECK_NEAR(difference(flat(&p), flat(&both), 9), 0, 0);
    CHECK(largest_of(history.stress, 6) == 0);
}

static void check_history_refused(const sb_material *m, const sb_mat3 *f, double dt)
{
    sb_material_history history, before;
    sb_mat3 p = diagonal(7, 7, 7), untouched = p;
    memset(&history, 0, sizeof history);
    history.stress[2] = 3;
    history.memory[1][4] = 5;
    before = history;
    CHECK_INT(sb_material_history_stress(m, &history, f, (sb_real)dt, NULL, &p), 0);
    CHECK(memcmp(&history, &before, sizeof history) == 0);
    CHECK_NEAR(difference(flat(&p), flat(&untouched), 9), 0, 0);
}

static void test_history_refused(void)
{
    sb_material m = relaxing(material_of(SB_NEO_HOOKEAN)), bad = m;
    sb_mat3 f = diagonal(1.1, 1, 1), flat_one = diagonal(1, 1, 0), inverted = diagonal(1, 1, -1), p;
    sb_material_history history;
    memset(&history, 0, sizeof history);
    check_history_refused(NULL, &f, 1);
    check_history_refused(&m, NULL, 1);
    check_history_refused(&m, &f, -1);
    check_bad_numbers();
    check_history_refused(&m, &f, sqrt(-1.0));
    check_history_refused(&m, &inverted, 1);
    check_history_refused(&m, &flat_one, 1);
    bad.prony_count = SB_MAX_PRONY_TERMS + 1;
    check_history_refused(&bad, &f, 1);
    bad.prony_count = -1;
    check_history_refused(&bad, &f, 1);
    bad = relaxing(material_of(SB_COROTATED));
    check_history_refused(&bad, &f, 1);
    bad = relaxing(material_of(SB_STABLE_NEO_HOOKEAN));
    check_history_refused(&bad, &flat_one, 1);
    CHECK(sb_material_history_stress(&bad, &history, &inverted, 1, NULL, &p));
    CHECK_INT(sb_material_history_stress(&m, NULL, &f, 1, NULL, &p), 0);
    CHECK_INT(sb_material_history_stress(&m, &history, &f, 1, NULL, NULL), 0);
}

/* ---- inadmissible and degenerate deformations ---- */

/* Calls all three; each must return `admissible` and, when 0, leave its output and the rotation untouched. */
static void check_admissible(const sb_material *m, const sb_mat3 *f, int admissible)
{
    sb_real energy = 7, A[81];
    sb_mat3 p = diagonal(7, 7, 7);
    const sb_mat3 untouched = p;
    sb_quat q = sb_quat_identity();
    CHECK_INT(sb_material_energy(m, f, &q, &energy), admissible);
    CHECK_INT(sb_material_stress(m, f, &q, &p), admissible);
    if (!admissible)
        CHECK(energy == 7 && difference(flat(&p), flat(&untouched), 9) == 0);
    for (int kind = 0; kind < 3; kind++) {
        for (int i = 0; i < 81; i++)
            A[i] = 7;
        CHECK_INT(sb_material_tangent(m, f, &q, (sb_tangent_kind)kind, A), admissible);
        if (!admissible)
            for (int i = 0; i < 81; i++)
                CHECK(A[i] == 7);
    }
    if (!admissible)
        CHECK(q.w == 1 && q.x == 0 && q.y == 0 && q.z == 0);
}

static void test_inverted_and_flat(void)
{
    const sb_mat3 shapes[6] = {diagonal(1, 1, -1), diagonal(1, 1, 0),      diagonal(1.2, 0, 0),
                               sb_m3_zero(),       diagonal(1, 0.5, -0.5), diagonal(-1, -1, -1)};
    for (int model = 1; model <= MODEL_COUNT; model++) {
        sb_material m = material_of(model);
        for (int c = 0; c < 6; c++)
            check_admissible(&m, &shapes[c], sb_material_allows_inversion(m.model));
    }
}

/* Squeezed almost flat, J > 0: admissible for every model, with a semidefinite projection. */
static void test_nearly_flat(void)
{
    unsigned long long seed = 22;
    for (int model = 1; model <= MODEL_COUNT; model++)
        for (int c = 2; c < 12; c++) {
            sb_material m = material_of(model);
            sb_mat3 f = sb_m3_mul(diagonal(1.1, 0.9, pow((double)SB_EPSILON, c / 12.0)), random_rotation(&seed));
            sb_real A[81];
            if (!(sb_m3_det(f) > 0) || (model == SB_FUNG && c > 2)) /* whose exponential overflows, see below */
                continue;
            check_admissible(&m, &f, 1);
            CHECK(sb_material_tangent(&m, &f, NULL, SB_TANGENT_SPD, A));
            CHECK(lowest_eigenvalue(A) >= -1e3 * (double)SB_EPSILON * largest_of(A, 81));
        }
}

static void test_refused_input(void)
{
    const sb_real zero = 0;
    sb_mat3 f = sb_m3_identity(), p;
    sb_material m = material_of(SB_SVK);
    sb_real value = 7, A[81];
    check_bad_numbers();
    for (int model = 1; model <= MODEL_COUNT; model++) {
        sb_mat3 bad = sb_m3_identity();
        sb_material each = material_of(model);
        bad.m[1][2] = zero / zero;
        check_admissible(&each, &bad, 0);
        bad.m[1][2] = 1 / zero;
        check_admissible(&each, &bad, 0);
        check_admissible(&each, NULL, 0);
    }
    check_admissible(NULL, &f, 0);
    m.model = (sb_material_model)0;
    check_admissible(&m, &f, 0);
    m = material_of(SB_SVK);
    CHECK_INT(sb_material_energy(&m, &f, NULL, NULL), 0);
    CHECK_INT(sb_material_stress(&m, &f, NULL, NULL), 0);
    CHECK_INT(sb_material_tangent(&m, &f, NULL, SB_TANGENT_SPD, NULL), 0);
    f = diagonal((double)SB_REAL_MAX / 4, 1, 1); /* the square overflows */
    CHECK_INT(sb_material_energy(&m, &f, NULL, &value), 0);
    CHECK_INT(sb_material_stress(&m, &f, NULL, &p), 0);
    CHECK_INT(sb_material_tangent(&m, &f, NULL, SB_TANGENT_EXACT, A), 0);
    CHECK(value == 7);
}

/* Around s_2 + s_3 = 0 the corotated tangents stay finite and within the documented bound, and the
 * projected ones semidefinite. */
static void test_corotated_kink(void)
{
    const double gaps[6] = {0, 1e-14, 1e-9, 1e-7, 1e-5, 1e-2}, longest[3] = {0.4, 1, 5};
    unsigned long long seed = 20;
    for (int model = SB_COROTATED; model <= SB_COROTATED_INVERTIBLE; model++)
        for (int c = 0; c < 18; c++) {
            sb_material m = material_of(model);
            double s = 0.3, lowest;
            sb_mat3 f = diagonal(longest[c / 6], s + gaps[c % 6], -s);
            sb_real A[81];
            f = sb_m3_mul(sb_m3_mul(random_rotation(&seed), f), random_rotation(&seed));
            for (int kind = 0; kind < 3; kind++) {
                double norm, bound = 1e7 * (double)(m.lambda + m.mu);
                CHECK(sb_material_tangent(&m, &f, NULL, (sb_tangent_kind)kind, A));
                norm = largest_of(A, 81);
                CHECK(norm <= bound);
                lowest = lowest_eigenvalue(A);
                CHECK(kind == SB_TANGENT_EXACT || lowest >= -100 * (double)SB_EPSILON * norm);
            }
        }
}

/* Deformations of wild magnitude: a call either refuses or gives finite numbers, projected ones
 * semidefinite. */
static void test_extreme_deformations(void)
{
    unsigned long long seed = 21;
    int given = 0;
    check_bad_numbers();
    for (int sample = 0; sample < 2000; sample++) {
        int model = 1 + sample % MODEL_COUNT;
        sb_material m = material_of(model);
        double decades = (double)SB_REAL_MAX > 1e100 ? 60 : 8;
        sb_mat3 f, p;
        sb_real energy, A[81];
        for (int i = 0; i < 9; i++)
            f.m[i / 3][i % 3] =
                (sb_real)(check_random_in(&seed, -1, 1) * pow(10, sample % 2 ? check_random_in(&seed, -decades, decades)
                                                                             : check_random_in(&seed, -2, 2)));
        if (sb_material_energy(&m, &f, NULL, &energy))
            CHECK(sb_is_finite(energy));
        if (sb_material_stress(&m, &f, NULL, &p))
            CHECK(largest_of(flat(&p), 9) <= (double)SB_REAL_MAX);
        if (sb_material_tangent(&m, &f, NULL, SB_TANGENT_SPD, A)) {
            double norm = largest_of(A, 81);
            given++;
            CHECK(norm <= (double)SB_REAL_MAX);
            if (sample % 2 == 0)
                CHECK(lowest_eigenvalue(A) >= -1e4 * (double)SB_EPSILON * norm);
        }
    }
    CHECK(given > 1000);
}

CHECK_SUITE(material, {"stress is the energy's gradient", test_stress_is_energy_gradient},
            {"tangent is the stress's derivative", test_tangent_is_stress_derivative},
            {"tangents are symmetric", test_tangents_are_symmetric},
            {"SPD tangent is the nearest semidefinite matrix", test_spd_tangent_is_the_projection},
            {"projection at a zero pivot", test_projection_at_zero_pivot},
            {"quasi tangent relation", test_quasi_tangent_relation},
            {"quasi tangent of other models", test_quasi_of_other_models},
            {"Hooke's tangent at rest", test_hooke_tangent_at_rest}, {"rest state", test_rest_state},
            {"objectivity", test_objectivity}, {"closed forms", test_closed_forms},
            {"uniaxial and biaxial states", test_uniaxial_and_biaxial}, {"simple shear", test_simple_shear},
            {"uniaxial Young's modulus", test_uniaxial_young}, {"warm start", test_warm_start},
            {"Cauchy and von Mises stress", test_cauchy_and_von_mises}, {"no stiffness scale", test_stiffness_scale},
            {"constants", test_constants}, {"presets", test_presets}, {"refused parameters", test_refused_parameters},
            {"refused exponents", test_refused_exponents}, {"limits of Ogden and Fung", test_ogden_limits},
            {"refused isochoric parameters", test_refused_isochoric}, {"refused fibres", test_refused_fibres},
            {"refused Prony terms", test_refused_prony}, {"fibre derivatives", test_fibre_derivatives},
            {"fibre closed form", test_fibre_closed_form}, {"fibre calls refused", test_fibre_refused},
            {"relaxation function", test_relaxation_function}, {"jump and hold", test_jump_and_hold},
            {"ramp", test_ramp}, {"swing", test_swing}, {"relaxing fibres", test_relaxing_fibres},
            {"histories refused", test_history_refused}, {"inverted and flat deformations", test_inverted_and_flat},
            {"nearly flat deformations", test_nearly_flat}, {"refused input", test_refused_input},
            {"corotated kink", test_corotated_kink}, {"extreme deformations", test_extreme_deformations});
