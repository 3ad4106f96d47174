/* Tests of dense: closed forms, random matrices of every kind (inverted, singular, graded, huge, tiny),
 * scalar functions against libm in long double, a hash of results that every compiler must reproduce. */
#include <stdint.h>

#include "softbody.h"

#include "check.h"

enum { CASES = 10000, LARGEST_SYSTEM = 24 };

static const double EPSILON = (double)SB_EPSILON;

/* ---- random inputs ---- */

static sb_real random_real(unsigned long long *seed, double low, double high)
{
    return (sb_real)check_random_in(seed, low, high);
}

static sb_quat random_quat(unsigned long long *seed)
{
    sb_quat q;
    do {
        q = sb_quat_make(random_real(seed, -1, 1), random_real(seed, -1, 1), random_real(seed, -1, 1),
                         random_real(seed, -1, 1));
    } while (sb_quat_dot(q, q) > 1 || sb_quat_dot(q, q) < (sb_real)0.01);
    return sb_quat_normalise(q);
}

static sb_vec3 random_vector(unsigned long long *seed, double low, double high)
{
    return sb_v3(random_real(seed, low, high), random_real(seed, low, high), random_real(seed, low, high));
}

static sb_mat3 random_matrix(unsigned long long *seed)
{
    sb_mat3 a;
    for (int i = 0; i < 9; i++)
        a.m[i / 3][i % 3] = random_real(seed, -1, 1);
    return a;
}

static sb_mat3 diagonal(double a, double b, double c)
{
    sb_mat3 d = sb_m3_zero();
    d.m[0][0] = (sb_real)a;
    d.m[1][1] = (sb_real)b;
    d.m[2][2] = (sb_real)c;
    return d;
}

/* q diag(a, b, c) p^T */
static sb_mat3 composed(sb_quat q, double a, double b, double c, sb_quat p)
{
    return sb_m3_mult(sb_m3_mul(sb_quat_to_mat3(q), diagonal(a, b, c)), sb_quat_to_mat3(p));
}

static sb_quat turned(sb_quat q, sb_vec3 axis, double angle)
{
    return sb_quat_mul(q, sb_quat_from_rotation_vector(sb_v3_scale((sb_real)angle / sb_v3_norm(axis), axis)));
}

static double max_abs(sb_mat3 a)
{
    double largest = 0;
    for (int i = 0; i < 9; i++)
        if (!(fabs((double)a.m[i / 3][i % 3]) <= largest)) /* keeps a NaN */
            largest = fabs((double)a.m[i / 3][i % 3]);
    return largest;
}

static double distance(sb_mat3 a, sb_mat3 b) { return max_abs(sb_m3_sub(a, b)); }

/* How far r is from a rotation. */
static double rotation_error(sb_mat3 r)
{
    double orthogonality = distance(sb_m3_tmul(r, r), sb_m3_identity()), det = fabs((double)sb_m3_det(r) - 1);
    return orthogonality > det ? orthogonality : det;
}

static int same_bits(const void *a, const void *b, size_t size) { return memcmp(a, b, size) == 0; }

/* ---- vectors and matrices ---- */

static void test_products(void)
{
    unsigned long long seed = 1;
    for (int n = 0; n < 100; n++) {
        sb_mat3 a = random_matrix(&seed), b = random_matrix(&seed), at = sb_m3_transpose(a);
        sb_vec3 u = random_vector(&seed, -1, 1), v = random_vector(&seed, -1, 1), w;
        CHECK_NEAR(distance(sb_m3_tmul(a, b), sb_m3_mul(at, b)), 0, 0);
        CHECK_NEAR(distance(sb_m3_mult(a, b), sb_m3_mul(a, sb_m3_transpose(b))), 0, 0);
        w = sb_v3_sub(sb_m3_tapply(a, v), sb_m3_apply(at, v));
        CHECK_NEAR(sb_v3_norm(w), 0, 0);
        w = sb_v3_sub(sb_m3_apply(sb_m3_outer(u, v), v), sb_v3_scale(sb_v3_dot(v, v), u));
        CHECK_NEAR(sb_v3_norm(w), 0, 8 * EPSILON);
        CHECK_NEAR(sb_m3_ddot(a, b), sb_m3_trace(sb_m3_tmul(a, b)), 16 * EPSILON);
        CHECK_NEAR(sb_v3_dot(u, sb_v3_cross(u, v)), 0, 8 * EPSILON);
        CHECK_NEAR(sb_m3_det(sb_m3_mul(a, b)), (double)sb_m3_det(a) * (double)sb_m3_det(b), 64 * EPSILON);
        CHECK_NEAR(distance(sb_m3_tmul(sb_m3_cofactor(a), a), sb_m3_scale(sb_m3_det(a), sb_m3_identity())), 0,
                   32 * EPSILON);
    }
}

static void test_inverse(void)
{
    sb_mat3 a = diagonal(2, -4, 0.5), expected = diagonal(0.5, -0.25, 2);
    CHECK_NEAR(distance(sb_m3_inverse(a), expected), 0, 0);
    a.m[0][1] = 1;
    CHECK_NEAR(distance(sb_m3_mul(a, sb_m3_inverse(a)), sb_m3_identity()), 0, 0);
}

/* ---- scalar functions ---- */

/* |actual - exact| in units in the last place of sb_real. */
static double ulps(sb_real actual, long double exact)
{
    int exponent;
    long double unit;
    if (exact == 0 || actual - actual != 0)
        return (long double)actual == exact ? 0 : HUGE_VAL;
    (void)frexpl(exact, &exponent);
    unit = ldexpl((long double)SB_EPSILON, exponent - 1);
    if (unit < ldexpl(1, SB_REAL_IS_FLOAT ? -149 : -1074))
        unit = ldexpl(1, SB_REAL_IS_FLOAT ? -149 : -1074);
    return (double)(fabsl((long double)actual - exact) / unit);
}

static double largest(double a, double b) { return a > b || a != a ? a : b; }

/* A number whose logarithm is spread evenly over [low, high] decades. */
static sb_real random_magnitude(unsigned long long *seed, double low, double high)
{
    return (sb_real)pow(10.0, check_random_in(seed, low, high));
}

static void test_exp_log(void)
{
    unsigned long long seed = 2;
    double limit = SB_REAL_IS_FLOAT ? 87 : 708, decades = SB_REAL_IS_FLOAT ? 37 : 307, error[3] = {0, 0, 0};
    for (int n = 0; n < CASES; n++) {
        sb_real x = random_real(&seed, -limit, limit), y = random_magnitude(&seed, -decades, decades);
        sb_real near_one = 1 + random_real(&seed, -0.4, 0.6) * random_magnitude(&seed, -9, 0);
        error[0] = largest(error[0], ulps(sb_exp(x), expl((long double)x)));
        error[1] = largest(error[1], ulps(sb_log(y), logl((long double)y)));
        error[2] = largest(error[2], ulps(sb_log(near_one), logl((long double)near_one)));
    }
    CHECK_NEAR(error[0], 0, 1.0);
    CHECK_NEAR(error[1], 0, 1.0);
    CHECK_NEAR(error[2], 0, 1.0);
}

static void test_exp_log_edges(void)
{
    sb_real infinity = (sb_real)INFINITY, nan = (sb_real)NAN;
    sb_real tiny = SB_REAL_IS_FLOAT ? (sb_real)1e-42 : (sb_real)4.94e-322; /* subnormal */
    sb_real low = SB_REAL_IS_FLOAT ? (sb_real)-100 : (sb_real)-740;
    CHECK(sb_exp(0) == 1 && sb_log(1) == 0);
    CHECK(sb_exp(infinity) == infinity && sb_exp(-infinity) == 0 && sb_exp(nan) != sb_exp(nan));
    CHECK(sb_exp(710) == infinity && sb_exp(-746) == 0);
    CHECK_NEAR(ulps(sb_exp(low), expl((long double)low)), 0, 1.0);
    CHECK(sb_exp(low) > 0);
    CHECK(sb_log(0) == -infinity && sb_log(-1) != sb_log(-1) && sb_log(infinity) == infinity);
    check_bad_numbers();
    CHECK(sb_log(nan) != sb_log(nan));
    CHECK_NEAR(ulps(sb_log(tiny), logl((long double)tiny)), 0, 1.0);
    CHECK_NEAR(ulps(sb_log(SB_REAL_MAX), logl((long double)SB_REAL_MAX)), 0, 1.0);
    CHECK(sb_exp((sb_real)1e-30) == 1);
}

static void test_cbrt(void)
{
    unsigned long long seed = 3;
    double decades = SB_REAL_IS_FLOAT ? 37 : 307, error = 0, power_error = 0;
    sb_real tiny = SB_REAL_IS_FLOAT ? (sb_real)1e-42 : (sb_real)4.94e-322, infinity = (sb_real)INFINITY;
    for (int n = 0; n < CASES; n++) {
        sb_real x = random_magnitude(&seed, -decades, decades), J = random_magnitude(&seed, -3, 3);
        long double root = cbrtl((long double)J);
        error = largest(error, ulps(sb_cbrt(n % 2 ? x : -x), cbrtl(n % 2 ? (long double)x : -(long double)x)));
        power_error = largest(power_error, ulps(sb_pow_minus_two_thirds(J), 1 / (root * root)));
    }
    CHECK_NEAR(error, 0, 1.0);
    CHECK_NEAR(power_error, 0, 2.1);
    for (int i = -50; i <= 50; i++)
        CHECK(sb_cbrt((sb_real)(i * i * i)) == (sb_real)i);
    CHECK_NEAR(ulps(sb_cbrt(tiny), cbrtl((long double)tiny)), 0, 1.0);
    CHECK(sb_cbrt(infinity) == infinity && sb_cbrt(-infinity) == -infinity);
    check_bad_numbers();
    CHECK(sb_cbrt((sb_real)NAN) != sb_cbrt((sb_real)NAN));
    CHECK(sb_pow_minus_two_thirds(1) == 1 && sb_pow_minus_two_thirds(8) == (sb_real)0.25);
    CHECK(sb_pow_minus_two_thirds(0) == infinity && sb_pow_minus_two_thirds(infinity) == 0);
    CHECK(sb_pow_minus_two_thirds(-1) != sb_pow_minus_two_thirds(-1));
}

static double sin_cos_error(sb_real x)
{
    sb_real s, c;
    sb_sin_cos(x, &s, &c);
    return largest(ulps(s, sinl((long double)x)), ulps(c, cosl((long double)x)));
}

static void test_sin_cos(void)
{
    unsigned long long seed = 4;
    double error = 0;
    sb_real s, c, pi = (sb_real)3.14159265358979323846;
    for (int n = 0; n < CASES; n++) {
        error = largest(error, sin_cos_error(random_real(&seed, -10, 10)));
        error = largest(error, sin_cos_error(random_real(&seed, -1e6, 1e6)));
        error = largest(error, sin_cos_error(random_magnitude(&seed, -30, 0)));
        error = largest(error, sin_cos_error((sb_real)(n - CASES / 2) * (pi / 2))); /* near the zeros */
    }
#if !defined(_WIN32) /* whose sinl and cosl lose digits at large arguments and near zeros */
    CHECK_NEAR(error, 0, 1.0);
#endif
    sb_sin_cos(0, &s, &c);
    CHECK(s == 0 && c == 1);
    sb_sin_cos((sb_real)INFINITY, &s, &c);
    CHECK(s != s && c != c);
    check_bad_numbers();
    sb_sin_cos((sb_real)NAN, &s, &c);
    CHECK(s != s && c != c);
    for (double x = 2e6; x < 1e15; x *= 3.7) { /* as good as the argument: half a u.l.p. of x */
        sb_sin_cos((sb_real)x, &s, &c);
        CHECK_NEAR(s, sinl((long double)(sb_real)x), 1e-16 * x + EPSILON);
        CHECK_NEAR(c, cosl((long double)(sb_real)x), 1e-16 * x + EPSILON);
    }
}

static void test_atan2(void)
{
    unsigned long long seed = 5;
    double error = 0, acos_error = 0, decades = SB_REAL_IS_FLOAT ? 17 : 140;
    sb_real zero = 0, infinity = (sb_real)INFINITY;
    for (int n = 0; n < CASES; n++) {
        sb_real x = random_real(&seed, -1, 1), y = random_real(&seed, -1, 1);
        sb_real X = x * random_magnitude(&seed, -decades, decades), Y = y * random_magnitude(&seed, -decades, decades);
        error = largest(error, ulps(sb_atan2(y, x), atan2l((long double)y, (long double)x)));
        error = largest(error, ulps(sb_atan2(Y, X), atan2l((long double)Y, (long double)X)));
        acos_error = largest(acos_error, ulps(sb_acos(x), acosl((long double)x)));
    }
    CHECK_NEAR(error, 0, 2.1);
    CHECK_NEAR(acos_error, 0, 2.1);
    CHECK(sb_atan2(zero, 1) == 0 && sb_atan2(zero, zero) == 0 && sb_atan2(0, -1) == (sb_real)3.14159265358979323846);
    CHECK(signbit(sb_atan2(-zero, 1)) && sb_atan2(-zero, -1) == (sb_real)-3.14159265358979323846);
    CHECK(sb_atan2(-infinity, 1) == (sb_real)-1.57079632679489661923);
    CHECK(sb_atan2(infinity, infinity) == (sb_real)0.785398163397448309616 && sb_atan2(1, infinity) == 0);
    check_bad_numbers();
    CHECK(sb_atan2((sb_real)NAN, 1) != 0 && !(sb_atan2(1, (sb_real)NAN) < 10));
    CHECK(sb_acos(1) == 0 && sb_acos(-1) == (sb_real)3.14159265358979323846 && !(sb_acos((sb_real)1.01) < 10));
}

/* ---- quaternions ---- */

static void test_quaternions(void)
{
    unsigned long long seed = 6;
    for (int n = 0; n < 1000; n++) {
        sb_quat p = random_quat(&seed), q = random_quat(&seed), back;
        sb_mat3 r = sb_quat_to_mat3(q), product = sb_m3_mul(sb_quat_to_mat3(p), r);
        sb_vec3 v = random_vector(&seed, -1, 1);
        CHECK_NEAR(rotation_error(r), 0, 8 * EPSILON);
        CHECK_NEAR(distance(sb_quat_to_mat3(sb_quat_mul(p, q)), product), 0, 16 * EPSILON);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_quat_rotate(q, v), sb_m3_apply(r, v))), 0, 16 * EPSILON);
        CHECK_NEAR(distance(sb_quat_to_mat3(sb_quat_conjugate(q)), sb_m3_transpose(r)), 0, 0);
        back = sb_quat_from_mat3(r);
        CHECK_NEAR(fabs((double)sb_quat_dot(back, q)), 1, 8 * EPSILON);
        CHECK_NEAR(distance(sb_quat_to_mat3(back), r), 0, 16 * EPSILON);
        CHECK(back.w >= 0);
    }
}

/* Half turns have w = 0: the cases Shepperd's choice is for. */
static void test_quat_half_turns(void)
{
    static const double axes[7][3] = {{1, 0, 0},      {0, 1, 0},     {0, 0, 1},         {0.6, 0.8, 0},
                                      {0, -0.6, 0.8}, {0.8, 0, 0.6}, {-0.6, 0.64, 0.48}};
    for (int i = 0; i < 7; i++) {
        sb_quat q = sb_quat_make(0, (sb_real)axes[i][0], (sb_real)axes[i][1], (sb_real)axes[i][2]);
        sb_quat back = sb_quat_from_mat3(sb_quat_to_mat3(q));
        CHECK_NEAR(fabs((double)sb_quat_dot(q, back)), 1, 8 * EPSILON);
    }
}

static void test_quat_normalise(void)
{
    sb_real huge = SB_REAL_IS_FLOAT ? (sb_real)1e38 : (sb_real)1e300;
    sb_real tiny = SB_REAL_IS_FLOAT ? (sb_real)1e-38 : (sb_real)1e-300;
    sb_quat q = sb_quat_normalise(sb_quat_make(huge, 0, -huge, 0)), one = sb_quat_identity();
    CHECK_NEAR(q.w, sqrt(0.5), EPSILON);
    CHECK_NEAR(q.y, -sqrt(0.5), EPSILON);
    q = sb_quat_normalise(sb_quat_make(0, 3 * tiny, 0, 4 * tiny));
    CHECK_NEAR(q.x, 0.6, 2 * EPSILON);
    CHECK_NEAR(q.z, 0.8, 2 * EPSILON);
    q = sb_quat_normalise(sb_quat_make(0, 0, 0, 0));
    CHECK(same_bits(&q, &one, sizeof q));
    check_bad_numbers();
    for (int i = 0; i < 4; i++) {
        sb_real bad[4] = {(sb_real)0.5, (sb_real)0.5, (sb_real)0.5, (sb_real)0.5};
        bad[i] = (sb_real)NAN;
        q = sb_quat_normalise(sb_quat_make(bad[0], bad[1], bad[2], bad[3]));
        CHECK(same_bits(&q, &one, sizeof q));
        bad[i] = (sb_real)INFINITY;
        q = sb_quat_normalise(sb_quat_make(bad[0], bad[1], bad[2], bad[3]));
        CHECK(same_bits(&q, &one, sizeof q));
    }
}

static void test_rotation_vector(void)
{
    sb_quat q = sb_quat_from_rotation_vector(sb_v3(0, 0, (sb_real)1.5707963267948966));
    sb_vec3 v = sb_quat_rotate(q, sb_v3(1, 0, 0));
    CHECK_NEAR(v.x, 0, 4 * EPSILON);
    CHECK_NEAR(v.y, 1, 4 * EPSILON);
    q = sb_quat_from_rotation_vector(sb_v3((sb_real)1e-9, 0, 0));
    CHECK_NEAR(q.x, 5e-10, 1e-9 * EPSILON);
    q = sb_quat_from_rotation_vector(sb_v3(0, 0, 0));
    CHECK(q.w == 1 && q.x == 0 && q.y == 0 && q.z == 0);
}

/* ---- singular values ---- */

static void check_svd(sb_mat3 f, double tolerance)
{
    sb_mat3 u, v, rebuilt;
    sb_vec3 s;
    double size = max_abs(f);
    sb_m3_svd(f, &u, &s, &v);
    rebuilt = sb_m3_mult(sb_m3_mul(u, diagonal((double)s.x, (double)s.y, (double)s.z)), v);
    CHECK_NEAR(rotation_error(u), 0, 32 * EPSILON);
    CHECK_NEAR(rotation_error(v), 0, 32 * EPSILON);
    CHECK_NEAR(distance(rebuilt, f), 0, tolerance * EPSILON * size);
    CHECK(s.x >= s.y && s.y >= sb_abs(s.z));
}

static void test_svd_random(void)
{
    unsigned long long seed = 7;
    for (int n = 0; n < CASES; n++) {
        sb_mat3 f = random_matrix(&seed);
        check_svd(f, 32);
        f = composed(random_quat(&seed), check_random(&seed), check_random(&seed), check_random_in(&seed, -1, 1),
                     random_quat(&seed));
        check_svd(f, 32);
    }
}

/* Known values, with repetition, loss of rank, reflection. */
static void test_svd_closed_forms(void)
{
    static const double values[12][3] = {{3, 2, 1},  {3, 2, -1}, {2, 2, 1}, {2, 1, 1}, {1, 1, 1},    {1, 1, -1},
                                         {2, 1, -1}, {2, 1, 0},  {2, 2, 0}, {2, 0, 0}, {1, 1e-5, 0}, {1, 1e-5, -1e-5}};
    unsigned long long seed = 8;
    for (int n = 0; n < 600; n++) {
        const double *expected = values[n % 12];
        sb_mat3 f = composed(random_quat(&seed), expected[0], expected[1], expected[2], random_quat(&seed));
        sb_vec3 s;
        if (n < 12)
            f = diagonal(expected[0], expected[1], expected[2]);
        check_svd(f, 32);
        sb_m3_svd(f, NULL, &s, NULL);
        CHECK_NEAR(s.x, expected[0], 32 * EPSILON);
        CHECK_NEAR(s.y, expected[1], 32 * EPSILON);
        CHECK_NEAR(s.z, expected[2], 32 * EPSILON);
    }
}

static void test_svd_extremes(void)
{
    unsigned long long seed = 9;
    double decades = SB_REAL_IS_FLOAT ? 30 : 300;
    sb_mat3 zero = sb_m3_zero(), f, u, v, one = sb_m3_identity();
    sb_vec3 s;
    for (int n = 0; n < 1000; n++)
        check_svd(sb_m3_scale(random_magnitude(&seed, -decades, decades), random_matrix(&seed)), 32);
    check_svd(zero, 1);
    check_bad_numbers();
    for (int i = 0; i < 9; i++) { /* one entry alone, also subnormal */
        f = zero;
        f.m[i / 3][i % 3] = i % 2 ? SB_REAL_MAX / 2 : -SB_REAL_MAX / 2;
        check_svd(f, 32);
        f.m[i / 3][i % 3] = SB_REAL_IS_FLOAT ? (sb_real)1e-44 : (sb_real)1e-322;
        sb_m3_svd(f, &u, &s, &v);
        CHECK(s.x == f.m[i / 3][i % 3] && s.y == 0 && s.z == 0 && rotation_error(u) < 8 * EPSILON);
        f.m[i / 3][i % 3] = i % 2 ? (sb_real)NAN : (sb_real)INFINITY;
        sb_m3_svd(f, &u, &s, &v);
        CHECK(s.x != s.x && s.y != s.y && s.z != s.z);
        CHECK(same_bits(&u, &one, sizeof u) && same_bits(&v, &one, sizeof v));
    }
}

/* Orthogonal columns of very different lengths: every length is kept to rounding. */
static void test_svd_graded(void)
{
    unsigned long long seed = 10;
    double small = SB_REAL_IS_FLOAT ? 1e-10 : 1e-60, least = SB_REAL_IS_FLOAT ? 1e-18 : 1e-140;
    for (int n = 0; n < 100; n++) {
        sb_mat3 f = sb_m3_mul(sb_quat_to_mat3(random_quat(&seed)), diagonal(least, -1, small));
        sb_vec3 s;
        sb_m3_svd(f, NULL, &s, NULL);
        CHECK_NEAR(s.x, 1, 16 * EPSILON);
        CHECK_NEAR((double)s.y / small, 1, 16 * EPSILON);
        CHECK_NEAR((double)s.z / least, -1, 16 * EPSILON);
    }
}

/* ---- symmetric eigenvalues ---- */

static void check_eigen(sb_mat3 a)
{
    sb_mat3 v, rebuilt;
    sb_vec3 w;
    sb_m3_eigen(a, &w, &v);
    rebuilt = sb_m3_mult(sb_m3_mul(v, diagonal((double)w.x, (double)w.y, (double)w.z)), v);
    CHECK_NEAR(rotation_error(v), 0, 32 * EPSILON);
    CHECK_NEAR(distance(rebuilt, a), 0, 32 * EPSILON * max_abs(a));
    CHECK(w.x >= w.y && w.y >= w.z);
}

static sb_mat3 symmetric(sb_mat3 a)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < i; j++)
            a.m[i][j] = a.m[j][i];
    return a;
}

static void test_eigen(void)
{
    static const double values[6][3] = {{3, 2, 1}, {3, -1, -2}, {2, 2, -1}, {1, 0, 0}, {0, 0, -1}, {1, 1, 1}};
    unsigned long long seed = 11;
    double decades = SB_REAL_IS_FLOAT ? 30 : 300;
    for (int n = 0; n < CASES; n++) {
        sb_real scale = n % 2 ? random_magnitude(&seed, -decades, decades) : 1;
        check_eigen(sb_m3_scale(scale, symmetric(random_matrix(&seed))));
    }
    for (int n = 0; n < 300; n++) {
        const double *expected = values[n % 6];
        sb_quat q = random_quat(&seed);
        sb_mat3 a = symmetric(composed(q, expected[0], expected[1], expected[2], q));
        sb_vec3 w;
        check_eigen(a);
        sb_m3_eigen(a, &w, NULL);
        CHECK_NEAR(w.x, expected[0], 32 * EPSILON);
        CHECK_NEAR(w.y, expected[1], 32 * EPSILON);
        CHECK_NEAR(w.z, expected[2], 32 * EPSILON);
    }
}

static void test_eigen_edges(void)
{
    sb_mat3 a = diagonal(1, 3, 2), v, one = sb_m3_identity();
    sb_vec3 w;
    check_eigen(a);
    check_eigen(sb_m3_zero());
    a.m[2][0] = a.m[1][0] = a.m[2][1] = (sb_real)NAN; /* the lower triangle is not read */
    sb_m3_eigen(a, &w, &v);
    CHECK(w.x == 3 && w.y == 2 && w.z == 1);
    a.m[0][2] = (sb_real)NAN;
    check_bad_numbers();
    sb_m3_eigen(a, &w, &v);
    CHECK(w.x != w.x && w.y != w.y && w.z != w.z && same_bits(&v, &one, sizeof v));
    /* a graded definite matrix keeps its small eigenvalues: [[1, e], [e, 2 e^2]] has nearly 1 and e^2 */
    a = diagonal(1, 2e-12, 1);
    a.m[0][1] = (sb_real)1e-6;
    sb_m3_eigen(a, &w, NULL);
    CHECK_NEAR((double)w.z / 1e-12, 1, 1e-11 + 16 * EPSILON);
}

/* ---- rotation ---- */

/* The rotation of f by its singular vectors, unique where s.y + s.z > 0. */
static sb_mat3 rotation_by_svd(sb_mat3 f, double *condition)
{
    sb_mat3 u, v;
    sb_vec3 s;
    sb_m3_svd(f, &u, &s, &v);
    *condition = (double)s.x / ((double)s.y + (double)s.z);
    return sb_m3_mult(u, v);
}

static void check_polar(sb_mat3 f, sb_quat start)
{
    double condition;
    sb_mat3 expected = rotation_by_svd(f, &condition), r = sb_quat_to_mat3(sb_m3_polar(f, start));
    sb_real best = sb_m3_ddot(expected, f), trace = sb_m3_ddot(r, f);
    CHECK_NEAR(rotation_error(r), 0, 16 * EPSILON);
    CHECK_NEAR(trace, best, 64 * EPSILON * max_abs(f));
    CHECK_NEAR(distance(r, expected), 0, 64 * EPSILON * (1 + condition));
}

static void test_polar_random(void)
{
    unsigned long long seed = 12;
    for (int n = 0; n < CASES; n++) {
        sb_mat3 f = random_matrix(&seed);
        check_polar(f, sb_quat_identity());
        check_polar(f, random_quat(&seed));
    }
}

/* Warm starts at growing angles, for stretched and for inverted matrices. */
static void test_polar_warm(void)
{
    static const double degrees[8] = {0, 1e-6, 0.1, 1, 5, 30, 90, 179.9999};
    unsigned long long seed = 13;
    for (int n = 0; n < 8000; n++) {
        sb_quat q = random_quat(&seed), p = random_quat(&seed), start, found;
        double last = n % 3 ? check_random_in(&seed, 0.2, 1) : check_random_in(&seed, -0.4, 0);
        sb_mat3 stretch = composed(p, check_random_in(&seed, 0.5, 2), check_random_in(&seed, 0.5, 2), last, p);
        double angle = degrees[n % 8] * 3.14159265358979 / 180;
        start = turned(q, random_vector(&seed, 0.1, 1), angle);
        found = sb_m3_polar(sb_m3_mul(sb_quat_to_mat3(q), stretch), start);
        CHECK_NEAR(distance(sb_quat_to_mat3(found), sb_quat_to_mat3(q)), 0, 512 * EPSILON);
        CHECK(degrees[n % 8] > 90 || sb_quat_dot(found, start) > 0); /* no jump to -q */
    }
}

static void test_polar_scales(void)
{
    unsigned long long seed = 14;
    double decades = SB_REAL_IS_FLOAT ? 30 : 300;
    check_bad_numbers();
    for (int n = 0; n < 1000; n++) {
        sb_mat3 f = random_matrix(&seed);
        sb_real scale = random_magnitude(&seed, -decades, decades);
        check_polar(sb_m3_scale(scale, f), random_quat(&seed));
    }
}

/* Starts that are stationary but not best, and matrices whose rotation is not unique. */
static void test_polar_degenerate(void)
{
    static const double values[9][3] = {{-1, -1, 1}, {-2, 1, -1}, {-1, -1, -1}, {1, 1, -1},      {1, 0, 0},
                                        {0, -1, 0},  {2, 1, -1},  {1, 1, 0},    {1, 1e-9, -1e-9}};
    unsigned long long seed = 15;
    for (int n = 0; n < 9; n++)
        for (int k = 0; k < 20; k++) {
            sb_quat q = random_quat(&seed), start = k ? random_quat(&seed) : sb_quat_identity();
            sb_mat3 f = k < 2 ? diagonal(values[n][0], values[n][1], values[n][2])
                              : composed(q, values[n][0], values[n][1], values[n][2], random_quat(&seed));
            sb_mat3 u, v, r = sb_quat_to_mat3(sb_m3_polar(f, start));
            sb_vec3 s;
            sb_m3_svd(f, &u, &s, &v);
            CHECK_NEAR(rotation_error(r), 0, 16 * EPSILON);
            CHECK_NEAR(sb_m3_ddot(r, f), (double)s.x + (double)s.y + (double)s.z, 64 * EPSILON);
        }
}

/* Where the rotation is not unique the result is the one nearest to the start: a start that is best stays. */
static void test_polar_keeps_start(void)
{
    unsigned long long seed = 16;
    for (int n = 0; n < 200; n++) {
        sb_quat q = random_quat(&seed), p = random_quat(&seed), free_turn, start, found;
        sb_mat3 line = composed(q, 1, 0, 0, p), flat = composed(q, 1, 0.5, -0.5, p);
        free_turn = sb_quat_from_rotation_vector(sb_v3(random_real(&seed, -3, 3), 0, 0));
        start = sb_quat_mul(q, sb_quat_mul(free_turn, sb_quat_conjugate(p)));
        found = sb_m3_polar(line, start);
        CHECK_NEAR(sb_quat_dot(found, start), 1, 256 * EPSILON);
        found = sb_m3_polar(flat, start);
        CHECK_NEAR(sb_quat_dot(found, start), 1, 256 * EPSILON);
    }
}

static void test_polar_bad_input(void)
{
    unsigned long long seed = 17;
    sb_quat start = random_quat(&seed), q, zero = sb_quat_make(0, 0, 0, 0), cold;
    sb_mat3 f = random_matrix(&seed);
    q = sb_m3_polar(sb_m3_zero(), start);
    CHECK(same_bits(&q, &start, sizeof q));
    cold = sb_m3_polar_cold(f);
    check_polar(f, zero); /* a start of any length or none */
    check_bad_numbers();
    check_polar(f, sb_quat_make((sb_real)NAN, 0, 0, 1));
    check_polar(f, sb_quat_make(3, -1, 2, 0));
    q = sb_m3_polar(f, sb_quat_identity());
    CHECK(same_bits(&q, &cold, sizeof q));
    for (int i = 0; i < 9; i++) {
        sb_mat3 bad = f;
        bad.m[i / 3][i % 3] = i % 2 ? (sb_real)NAN : (sb_real)INFINITY;
        q = sb_m3_polar(bad, start);
        CHECK(same_bits(&q, &start, sizeof q));
    }
}

typedef struct lanes {
    sb_real f[9][SB_POLAR_LANES], q[4][SB_POLAR_LANES], r[9][SB_POLAR_LANES];
} lanes;

static void set_lane(lanes *a, int l, sb_mat3 f, sb_quat q)
{
    for (int i = 0; i < 9; i++)
        a->f[i][l] = f.m[i / 3][i % 3];
    a->q[0][l] = q.w;
    a->q[1][l] = q.x;
    a->q[2][l] = q.y;
    a->q[3][l] = q.z;
}

static sb_quat lane_quat(const lanes *a, int l) { return sb_quat_make(a->q[0][l], a->q[1][l], a->q[2][l], a->q[3][l]); }

static sb_mat3 lane_rotation(const lanes *a, int l)
{
    sb_mat3 r;
    for (int i = 0; i < 9; i++)
        r.m[i / 3][i % 3] = a->r[i][l];
    return r;
}

/* Easy and hard lanes mixed: each lane is the scalar function's result to rounding. */
static void test_polar_batch(void)
{
    unsigned long long seed = 18;
    for (int n = 0; n < 2000; n++) {
        lanes a;
        sb_mat3 f[SB_POLAR_LANES];
        sb_quat start[SB_POLAR_LANES];
        for (int l = 0; l < SB_POLAR_LANES; l++) {
            sb_quat q = random_quat(&seed), p = random_quat(&seed);
            double last = n % 4 == 3 && l % 3 == 0 ? -0.3 : check_random_in(&seed, 0.5, 1.5);
            f[l] = sb_m3_mul(sb_quat_to_mat3(q), composed(p, check_random_in(&seed, 0.5, 1.5), 1, last, p));
            start[l] = turned(q, random_vector(&seed, 0.1, 1), n % 5 ? check_random_in(&seed, 0, 0.2) : 2.0);
            if (n % 7 == 1 && l == 3)
                f[l] = sb_m3_scale(n % 2 ? (sb_real)1e-30 : (sb_real)1e12, f[l]);
            set_lane(&a, l, f[l], start[l]);
        }
        sb_polar_batch(a.f, a.q, a.r);
        for (int l = 0; l < SB_POLAR_LANES; l++) {
            sb_mat3 expected = sb_quat_to_mat3(sb_m3_polar(f[l], start[l]));
            CHECK_NEAR(distance(lane_rotation(&a, l), expected), 0, 256 * EPSILON);
            CHECK_NEAR(distance(sb_quat_to_mat3(lane_quat(&a, l)), lane_rotation(&a, l)), 0, 8 * EPSILON);
            CHECK_NEAR(sb_quat_dot(lane_quat(&a, l), lane_quat(&a, l)), 1, 8 * EPSILON);
        }
    }
}

/* A lane's bits depend on that lane only, whatever its neighbours are and wherever it stands. */
static void test_polar_batch_lanes(void)
{
    unsigned long long seed = 19;
    check_bad_numbers();
    for (int n = 0; n < 500; n++) {
        lanes a, b;
        for (int l = 0; l < SB_POLAR_LANES; l++) /* neighbours of b's last lanes: hard, and not finite */
            set_lane(&b, l, l % 2 ? random_matrix(&seed) : sb_m3_scale((sb_real)NAN, sb_m3_identity()),
                     random_quat(&seed));
        for (int l = 0; l < SB_POLAR_LANES; l++) {
            sb_quat q = random_quat(&seed);
            sb_mat3 f = composed(q, 1.2, 0.9, n % 3 ? 0.7 : -0.2, sb_quat_identity());
            sb_quat start = turned(q, random_vector(&seed, 0.1, 1), 0.3 * l * check_random(&seed));
            set_lane(&a, l, f, start);
            if (l < SB_POLAR_LANES / 2)
                set_lane(&b, SB_POLAR_LANES - 1 - l, f, start);
        }
        sb_polar_batch(a.f, a.q, a.r);
        sb_polar_batch(b.f, b.q, b.r);
        for (int l = 0; l < SB_POLAR_LANES / 2; l++) {
            sb_mat3 one = lane_rotation(&a, l), other = lane_rotation(&b, SB_POLAR_LANES - 1 - l);
            CHECK(same_bits(&one, &other, sizeof one));
        }
    }
}

static void test_polar_batch_bad_lanes(void)
{
    unsigned long long seed = 20;
    lanes a;
    sb_quat start = random_quat(&seed), q;
    sb_mat3 r;
    for (int l = 0; l < SB_POLAR_LANES; l++)
        set_lane(&a, l, sb_m3_zero(), start);
    set_lane(&a, 1, sb_m3_scale((sb_real)NAN, sb_m3_identity()), start);
    check_bad_numbers();
    set_lane(&a, 2, sb_m3_scale((sb_real)INFINITY, sb_m3_identity()), start);
    set_lane(&a, 5, sb_m3_identity(), sb_quat_make((sb_real)NAN, 0, 0, 0));
    set_lane(&a, 6, sb_m3_identity(), sb_quat_make(0, 0, 0, 0));
    set_lane(&a, 7, sb_m3_identity(), sb_quat_make(3, 0, 0, 0));
    sb_polar_batch(a.f, a.q, a.r);
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        q = lane_quat(&a, l);
        r = lane_rotation(&a, l);
        if (l < 5)
            CHECK(same_bits(&q, &start, sizeof q));
        CHECK_NEAR(rotation_error(r), 0, 16 * EPSILON);
    }
    for (int l = 5; l < 8; l++)
        CHECK_NEAR(distance(lane_rotation(&a, l), sb_m3_identity()), 0, 8 * EPSILON);
}

/* ---- the same bits everywhere ---- */

static void hash_bytes(uint64_t *hash, const void *data, size_t size)
{
    const unsigned char *bytes = (const unsigned char *)data;
    for (size_t i = 0; i < size; i++)
        *hash = (*hash ^ bytes[i]) * 1099511628211ULL;
}

static uint64_t hash_of_scalars(void)
{
    uint64_t hash = 14695981039346656037ULL;
    unsigned long long seed = 21;
    for (int n = 0; n < 2000; n++) {
        sb_real x = random_real(&seed, -30, 30), y = random_real(&seed, 0.001, 100), out[8];
        out[0] = sb_exp(x);
        out[1] = sb_log(y);
        out[2] = sb_cbrt(x);
        out[3] = sb_pow_minus_two_thirds(y);
        sb_sin_cos(x, &out[4], &out[5]);
        out[6] = sb_atan2(x, y);
        out[7] = sb_acos(x / 30);
        hash_bytes(&hash, out, sizeof out);
    }
    return hash;
}

static uint64_t hash_of_decompositions(void)
{
    uint64_t hash = 14695981039346656037ULL;
    unsigned long long seed = 22;
    for (int n = 0; n < 500; n++) {
        lanes a;
        for (int l = 0; l < SB_POLAR_LANES; l++) {
            sb_mat3 f = random_matrix(&seed), u, v;
            sb_vec3 s;
            sb_quat q = sb_m3_polar_cold(f);
            sb_m3_svd(f, &u, &s, &v);
            hash_bytes(&hash, &q, sizeof q);
            hash_bytes(&hash, &u, sizeof u);
            hash_bytes(&hash, &s, sizeof s);
            sb_m3_eigen(symmetric(f), &s, &v);
            hash_bytes(&hash, &s, sizeof s);
            set_lane(&a, l, f, turned(q, sb_v3(1, 2, 3), 0.05 * l));
        }
        sb_polar_batch(a.f, a.q, a.r);
        hash_bytes(&hash, a.r, sizeof a.r);
    }
    return hash;
}

#if SB_REAL_IS_FLOAT
static const uint64_t GOLDEN_SCALARS = 0x88182d00dfd73153ULL, GOLDEN_DECOMPOSITIONS = 0xa156147272898d84ULL;
#else
static const uint64_t GOLDEN_SCALARS = 0x5cf25b9d7808a498ULL, GOLDEN_DECOMPOSITIONS = 0xa6ebb028ed4c476eULL;
#endif

/* Every compiler and optimisation must give these, as long as it does not contract a*b + c. */
static void test_golden(void)
{
    CHECK(hash_of_scalars() == GOLDEN_SCALARS);
    CHECK(hash_of_decompositions() == GOLDEN_DECOMPOSITIONS);
}

/* ---- dense systems ---- */

typedef struct system_case {
    sb_real a[LARGEST_SYSTEM * LARGEST_SYSTEM], copy[LARGEST_SYSTEM * LARGEST_SYSTEM];
    sb_real x[LARGEST_SYSTEM], b[LARGEST_SYSTEM];
    int n;
} system_case;

/* b = copy x */
static void set_right_side(system_case *s)
{
    for (int i = 0; i < s->n; i++) {
        double sum = 0;
        for (int j = 0; j < s->n; j++)
            sum += (double)s->copy[i * s->n + j] * (double)s->x[j];
        s->b[i] = (sb_real)sum;
    }
}

/* A random matrix with its diagonal shifted; symmetric on request. */
static void random_system(system_case *s, int n, double shift, int is_symmetric, unsigned long long *seed)
{
    s->n = n;
    for (int i = 0; i < n * n; i++)
        s->a[i] = random_real(seed, -1, 1);
    for (int i = 0; i < n; i++) {
        s->x[i] = random_real(seed, -1, 1);
        for (int j = 0; j < i && is_symmetric; j++)
            s->a[i * n + j] = s->a[j * n + i];
        s->a[i * n + i] += (sb_real)shift;
    }
    memcpy(s->copy, s->a, sizeof s->a);
    set_right_side(s);
}

static void check_solution(const system_case *s, double tolerance)
{
    for (int i = 0; i < s->n; i++)
        CHECK_NEAR(s->b[i], s->x[i], tolerance);
}

static void test_cholesky(void)
{
    unsigned long long seed = 23;
    for (int n = 1; n <= LARGEST_SYSTEM; n++) {
        system_case s;
        random_system(&s, n, n + 1, 1, &seed);
        for (int i = 0; i < n; i++) /* the upper triangle is neither read nor written */
            for (int j = i + 1; j < n; j++)
                s.a[i * n + j] = (sb_real)NAN;
        CHECK_INT(sb_cholesky_factor(s.a, n), 0);
        CHECK(n == 1 || s.a[1] != s.a[1]);
        sb_cholesky_solve(s.a, n, s.b);
        check_solution(&s, 64 * EPSILON);
    }
}

static void test_ldlt(void)
{
    unsigned long long seed = 24;
    for (int n = 1; n <= LARGEST_SYSTEM; n++) {
        system_case s;
        random_system(&s, n, n + 1, 1, &seed);
        for (int i = n / 2; i < n; i++) /* quasi-definite: the second half is negative */
            s.a[i * n + i] -= (sb_real)(2 * (n + 1));
        memcpy(s.copy, s.a, sizeof s.a);
        set_right_side(&s);
        CHECK_INT(sb_ldlt_factor(s.a, n), 0);
        sb_ldlt_solve(s.a, n, s.b);
        check_solution(&s, 256 * EPSILON);
    }
}

static void test_lu(void)
{
    unsigned long long seed = 25;
    sb_real swap[4] = {0, 2, 3, 0}, right[2] = {4, 9};
    int pivot[LARGEST_SYSTEM];
    for (int n = 1; n <= LARGEST_SYSTEM; n++) {
        system_case s;
        double residual = 0, size = 0;
        random_system(&s, n, 0, 0, &seed);
        CHECK_INT(sb_lu_factor(s.a, n, pivot), 0);
        sb_lu_solve(s.a, n, pivot, s.b);
        for (int i = 0; i < n; i++) { /* the residual, since a random matrix may be ill conditioned */
            double sum = 0;
            for (int j = 0; j < n; j++)
                sum += (double)s.copy[i * n + j] * ((double)s.b[j] - (double)s.x[j]);
            residual = largest(residual, fabs(sum));
            size = largest(size, fabs((double)s.b[i]));
        }
        CHECK_NEAR(residual, 0, 16 * n * EPSILON * (1 + size));
    }
    CHECK_INT(sb_lu_factor(swap, 2, pivot), 0);
    sb_lu_solve(swap, 2, pivot, right);
    CHECK(right[0] == 3 && right[1] == 2);
}

/* Least squares: the residual is at right angles to the columns, and its length is in the tail of b. */
static void test_qr(void)
{
    unsigned long long seed = 26;
    for (int m = 1; m <= LARGEST_SYSTEM; m++) {
        int n = 1 + m / 2;
        sb_real a[LARGEST_SYSTEM * LARGEST_SYSTEM], qr[LARGEST_SYSTEM * LARGEST_SYSTEM], tau[LARGEST_SYSTEM];
        sb_real b[LARGEST_SYSTEM], x[LARGEST_SYSTEM];
        double length2 = 0, tail2 = 0, residual[LARGEST_SYSTEM];
        for (int i = 0; i < m * n; i++)
            a[i] = qr[i] = random_real(&seed, -1, 1);
        for (int i = 0; i < m; i++)
            b[i] = x[i] = random_real(&seed, -1, 1);
        CHECK_INT(sb_qr_factor(qr, m, n, tau), 0);
        sb_qr_solve(qr, m, n, tau, x);
        for (int i = 0; i < m; i++) {
            residual[i] = (double)b[i];
            for (int j = 0; j < n; j++)
                residual[i] -= (double)a[i * n + j] * (double)x[j];
            length2 += residual[i] * residual[i];
            tail2 += i < n ? 0 : (double)x[i] * (double)x[i];
        }
        CHECK_NEAR(tail2, length2, 1000 * EPSILON);
        for (int j = 0; j < n; j++) {
            double sum = 0;
            for (int i = 0; i < m; i++)
                sum += (double)a[i * n + j] * residual[i];
            CHECK_NEAR(sum, 0, 1000 * EPSILON);
        }
    }
}

/* Pivots lost to rounding are found whatever the units, and healthy ones are not taken for lost. */
static void test_singular_systems(void)
{
    static const double singular[9] = {1, 2, 3, 4, 5, 6, 7, 8, 9};
    static const double semidefinite[9] = {4, 2, 2, 2, 1, 1, 2, 1, 5};
    static const double scales[3] = {1, 1e-12, 1e12};
    sb_real a[9], tau[3], rows[4] = {(sb_real)1e20, (sb_real)1e20, 1, 2};
    int pivot[3];
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < 9; i++)
            a[i] = (sb_real)(singular[i] * scales[k]);
        CHECK_INT(sb_lu_factor(a, 3, pivot), 3);
        for (int i = 0; i < 9; i++)
            a[i] = (sb_real)(singular[i] * scales[k]);
        CHECK_INT(sb_qr_factor(a, 3, 3, tau), 3);
        for (int i = 0; i < 9; i++)
            a[i] = (sb_real)(semidefinite[i] * scales[k]);
        CHECK_INT(sb_cholesky_factor(a, 3), 2);
        for (int i = 0; i < 9; i++)
            a[i] = (sb_real)(semidefinite[i] * scales[k]);
        CHECK_INT(sb_ldlt_factor(a, 3), 2);
    }
    CHECK_INT(sb_lu_factor(rows, 2, pivot), 0);
    rows[0] = 1;
    rows[1] = rows[2] = 2;
    rows[3] = 1;
    CHECK_INT(sb_cholesky_factor(rows, 2), 2);   /* indefinite */
    CHECK_INT(sb_qr_factor(rows, 1, 2, tau), 4); /* more columns than rows */
}

/* v v^T + w w^T has rank 2; with these v, w rounding leaves a small positive last pivot, also in float. */
static void test_rank_two_gram(void)
{
    static const double v[3] = {0.7, 0.7, 0.1}, w[3] = {0.8, 0.5, 0.4};
    sb_mat3 a, l;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            sb_real vv = (sb_real)v[i] * (sb_real)v[j], ww = (sb_real)w[i] * (sb_real)w[j];
            a.m[i][j] = vv + ww;
        }
    CHECK_INT(sb_m3_cholesky(a, &l), 3);
    CHECK_INT(sb_ldlt_factor(&a.m[0][0], 3), 3);
}

static void test_bad_systems(void)
{
    int pivot[3];
    sb_real tau[3];
    check_bad_numbers();
    for (int i = 0; i < 9; i++)
        for (int k = 0; k < 2; k++) {
            sb_real bad = k ? (sb_real)INFINITY : (sb_real)NAN, a[9] = {4, 1, 1, 1, 4, 1, 1, 1, 4}, b[9];
            a[i] = bad;
            memcpy(b, a, sizeof b);
            CHECK(sb_lu_factor(b, 3, pivot) != 0);
            memcpy(b, a, sizeof b);
            CHECK(sb_qr_factor(b, 3, 3, tau) != 0);
            if (i / 3 < i % 3)
                continue; /* the symmetric ones do not read the upper triangle */
            memcpy(b, a, sizeof b);
            CHECK(sb_cholesky_factor(b, 3) != 0);
            memcpy(b, a, sizeof b);
            CHECK(sb_ldlt_factor(b, 3) != 0);
        }
    CHECK_INT(sb_cholesky_factor(NULL, 0), 0); /* an empty system is solved */
}

static void test_spd_inverse(void)
{
    unsigned long long seed = 27;
    sb_mat3 inverse = diagonal(7, 7, 7), l = inverse, kept = inverse;
    for (int n = 0; n < 1000; n++) {
        sb_quat q = random_quat(&seed);
        sb_real scale = random_magnitude(&seed, SB_REAL_IS_FLOAT ? -15 : -100, SB_REAL_IS_FLOAT ? 15 : 100);
        sb_mat3 a = sb_m3_scale(scale, symmetric(composed(q, check_random_in(&seed, 0.1, 1), 1, 2, q)));
        CHECK_INT(sb_m3_spd_inverse(a, &inverse), 0);
        CHECK_NEAR(distance(sb_m3_mul(a, inverse), sb_m3_identity()), 0, 256 * EPSILON);
        CHECK(inverse.m[0][1] == inverse.m[1][0] && inverse.m[0][2] == inverse.m[2][0] &&
              inverse.m[1][2] == inverse.m[2][1]);
        CHECK_INT(sb_m3_cholesky(a, &l), 0);
        CHECK_NEAR(distance(sb_m3_mult(l, l), a), 0, 16 * EPSILON * max_abs(a));
        CHECK(l.m[0][1] == 0 && l.m[0][2] == 0 && l.m[1][2] == 0);
    }
    inverse = l = kept;
    CHECK_INT(sb_m3_spd_inverse(diagonal(1, 0, 1), &inverse), 2);
    CHECK_INT(sb_m3_spd_inverse(diagonal(1, 1, -1), &inverse), 3);
    check_bad_numbers();
    CHECK_INT(sb_m3_cholesky(diagonal((double)NAN, 1, 1), &l), 1);
    CHECK(same_bits(&inverse, &kept, sizeof kept) && same_bits(&l, &kept, sizeof kept));
}

CHECK_SUITE(dense, {"products", test_products}, {"inverse", test_inverse}, {"exp and log", test_exp_log},
            {"exp and log at the edges", test_exp_log_edges}, {"cube root", test_cbrt},
            {"sine and cosine", test_sin_cos}, {"atan2 and acos", test_atan2}, {"quaternions", test_quaternions},
            {"quaternions of half turns", test_quat_half_turns}, {"normalising", test_quat_normalise},
            {"rotation vector", test_rotation_vector}, {"svd, random", test_svd_random},
            {"svd, closed forms", test_svd_closed_forms}, {"svd, extremes", test_svd_extremes},
            {"svd, graded", test_svd_graded}, {"eigen", test_eigen}, {"eigen at the edges", test_eigen_edges},
            {"polar, random", test_polar_random}, {"polar, warm", test_polar_warm},
            {"polar, scales", test_polar_scales}, {"polar, degenerate", test_polar_degenerate},
            {"polar keeps its start", test_polar_keeps_start}, {"polar, bad input", test_polar_bad_input},
            {"polar batch", test_polar_batch}, {"polar batch, lanes", test_polar_batch_lanes},
            {"polar batch, bad lanes", test_polar_batch_bad_lanes}, {"golden bits", test_golden},
            {"cholesky", test_cholesky}, {"ldlt", test_ldlt}, {"lu", test_lu}, {"qr", test_qr},
            {"singular systems", test_singular_systems}, {"rank two", test_rank_two_gram},
            {"bad systems", test_bad_systems}, {"spd inverse", test_spd_inverse});
