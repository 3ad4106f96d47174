/* Tests of material: derivatives by differences, projections against a 9x9 eigen-decomposition, closed forms,
 * objectivity, parameter checks, inadmissible deformations. */
#include "softbody.h"

#include "check.h"

#define YOUNG ((sb_real)5e3)
#define POISSON ((sb_real)0.4)
#define DENSITY ((sb_real)1060)

enum { MODEL_COUNT = 7, SAMPLES = 100 };

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
    return sb_material_neo_hookean_isochoric(equivalent.c10, equivalent.d1, DENSITY);
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
    for (int model = 1; model <= MODEL_COUNT; model++) {
        sb_material m = material_of(model);
        unsigned long long seed = 11;
        int inverted = 0;
        double worst = 0;
        for (int sample = 0; sample < SAMPLES; sample++) {
            sb_mat3 f = random_deformation(model, sample, 0.5, &seed), p,
                    expected = stress_by_differences(&m, f);
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
    for (int model = 1; model <= MODEL_COUNT; model++) {
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
    for (int model = 1; model <= MODEL_COUNT; model++) {
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
    for (int model = 1; model <= MODEL_COUNT; model++) {
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
                    sb_real tau = (2 * m.mu * (s[i] + s[j] - 2) + 2 * m.lambda * (s[0] + s[1] + s[2] - 3)) /
                                  (s[i] + s[j]);
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
                double expected = (double)m.lambda * (i == j && k == l) +
                                  (double)m.mu * ((i == k && j == l) + (i == l && j == k));
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
            sb_mat3 f = random_deformation(model, sample, 0.5, &seed), q = random_rotation(&seed), p,
                    turned_p;
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

/* P_00 and P_11 under F = diag(a, b, b), written out by hand. */
static void closed_form(const sb_material *m, double a, double b, double *axial, double *lateral)
{
    double mu = (double)m->mu, lambda = (double)m->lambda, J = a * b * b, I1 = a * a + 2 * b * b;
    double e, q;
    switch (m->model) {
    case SB_LINEAR:
    case SB_COROTATED:
    case SB_COROTATED_INVERTIBLE:
        e = lambda * (a + 2 * b - 3);
        *axial = e + 2 * mu * (a - 1);
        *lateral = e + 2 * mu * (b - 1);
        break;
    case SB_SVK:
        e = lambda * (I1 - 3) / 2;
        *axial = a * (e + mu * (a * a - 1));
        *lateral = b * (e + mu * (b * b - 1));
        break;
    case SB_NEO_HOOKEAN:
        *axial = mu * (a - 1 / a) + lambda * log(J) / a;
        *lateral = mu * (b - 1 / b) + lambda * log(J) / b;
        break;
    case SB_NEO_HOOKEAN_ISOCHORIC:
        e = 2 * (double)m->c10 * pow(J, -2.0 / 3);
        q = 2 / (double)m->d1 * (J - 1) * J;
        *axial = e * (a - I1 / (3 * a)) + q / a;
        *lateral = e * (b - I1 / (3 * b)) + q / b;
        break;
    default:
        q = (lambda + mu) * (J - 1) - mu;
        *axial = mu * a + q * b * b;
        *lateral = mu * b + q * a * b;
    }
}

static void test_closed_forms(void)
{
    const double stretches[5][2] = {{1.3, 1.3}, {0.7, 0.7}, {1.5, 1}, {0.6, 1.1}, {2, 0.8}};
    for (int model = 1; model <= MODEL_COUNT; model++) {
        sb_material m = material_of(model);
        for (int c = 0; c < 5; c++) {
            double a = (double)(sb_real)stretches[c][0], b = (double)(sb_real)stretches[c][1], axial, lateral;
            sb_mat3 f = diagonal(a, b, b), p, expected;
            CHECK(sb_material_stress(&m, &f, NULL, &p));
            closed_form(&m, a, b, &axial, &lateral);
            expected = diagonal(axial, lateral, lateral);
            CHECK_NEAR(difference(flat(&p), flat(&expected), 9) / largest_of(flat(&p), 9), 0,
                       tolerance(1e-13, 60));
        }
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
        stiff.d1 /= scale;
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
        CHECK_NEAR(2 * m.c10, m.mu, 10 * (double)(SB_EPSILON * m.mu));
        CHECK_NEAR(2 / m.d1, sb_material_bulk(&m), 10 * (double)(SB_EPSILON * m.lambda));
        CHECK_NEAR(m.density, DENSITY, 0);
        CHECK_OK(sb_material_check(&m, NULL));
        CHECK_INT(sb_material_is_linear(m.model), model == SB_LINEAR);
        CHECK_INT(sb_material_allows_inversion(m.model),
                  model != SB_NEO_HOOKEAN && model != SB_NEO_HOOKEAN_ISOCHORIC);
    }
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

static void test_refused_isochoric(void)
{
    sb_material m = sb_material_neo_hookean_isochoric(-3, (sb_real)1e-3, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "c10 is -3");
    m = sb_material_neo_hookean_isochoric(300, (sb_real)-1e-3, 1000);
    check_refused(&m, SB_ERROR_MATERIAL, "d1 is -0.001");
    m = sb_material_neo_hookean_isochoric(300, 0, 1000);
    check_refused(&m, SB_ERROR_NOT_FINITE, "lambda (Pa) is inf");
    m = sb_material_neo_hookean_isochoric(300, (sb_real)1e-3, 1000);
    m.mu = 700;
    check_refused(&m, SB_ERROR_MATERIAL, "2 c10 is 600");
    m = sb_material_neo_hookean_isochoric(300, (sb_real)1e-3, 1000);
    m.lambda *= 2;
    check_refused(&m, SB_ERROR_MATERIAL, "2/d1 is 2000");
    m = sb_material_neo_hookean_isochoric(300, (sb_real)0.1,
                                          1000); /* bulk 20 Pa, mu 600 Pa: auxetic, valid */
    CHECK_OK(sb_material_check(&m, NULL));
    CHECK(sb_material_poisson(&m) < 0);
    m = material_of(SB_SVK); /* others do not read c10, d1 */
    m.c10 = m.d1 = 0;
    CHECK_OK(sb_material_check(&m, NULL));
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
            sb_mat3 f =
                sb_m3_mul(diagonal(1.1, 0.9, pow((double)SB_EPSILON, c / 12.0)), random_rotation(&seed));
            sb_real A[81];
            if (!(sb_m3_det(f) > 0))
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
    for (int sample = 0; sample < 2000; sample++) {
        int model = 1 + sample % MODEL_COUNT;
        sb_material m = material_of(model);
        double decades = (double)SB_REAL_MAX > 1e100 ? 60 : 8;
        sb_mat3 f, p;
        sb_real energy, A[81];
        for (int i = 0; i < 9; i++)
            f.m[i / 3][i % 3] = (sb_real)(check_random_in(&seed, -1, 1) *
                                          pow(10, sample % 2 ? check_random_in(&seed, -decades, decades)
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
            {"uniaxial Young's modulus", test_uniaxial_young}, {"warm start", test_warm_start},
            {"Cauchy and von Mises stress", test_cauchy_and_von_mises},
            {"no stiffness scale", test_stiffness_scale}, {"constants", test_constants},
            {"refused parameters", test_refused_parameters},
            {"refused isochoric parameters", test_refused_isochoric},
            {"inverted and flat deformations", test_inverted_and_flat},
            {"nearly flat deformations", test_nearly_flat}, {"refused input", test_refused_input},
            {"corotated kink", test_corotated_kink}, {"extreme deformations", test_extreme_deformations});
