/* particles_kernel: kernels, and what moving least squares make of them at a point. */
#include "particles_private.h"

#include "../base/eigen.h"

/* ---- kernels ---- */

static const double sbi_kernel_pi = 3.14159265358979323846;

SBI_API double sbi_kernel_shape(sb_kernel kernel, double q)
{
    const double pi = sbi_kernel_pi, r = 1 - q;
    if (!(q >= 0) || q >= 1)
        return 0;
    switch (kernel) {
    case SB_KERNEL_SPIKY: return 15 / pi * r * r * r;
    case SB_KERNEL_POLY6: return 315 / (64 * pi) * (1 - q * q) * (1 - q * q) * (1 - q * q);
    case SB_KERNEL_COSINE: return (cos(pi * (1 + q) / 2) + 1) / (4 * (pi / 3 - 8 / pi + 16 / (pi * pi)));
    case SB_KERNEL_CUBIC: return q <= 0.5 ? 8 / pi * (1 - 6 * q * q * r) : 16 / pi * r * r * r;
    case SB_KERNEL_QUARTIC: return 105 / (16 * pi) * r * r * r * (1 + 3 * q);
    }
    return 0;
}

SBI_API double sbi_kernel_shape_slope(sb_kernel kernel, double q)
{
    const double pi = sbi_kernel_pi, r = 1 - q;
    if (!(q >= 0) || q >= 1)
        return 0;
    switch (kernel) {
    case SB_KERNEL_SPIKY: return -45 / pi * r * r;
    case SB_KERNEL_POLY6: return -945 / (32 * pi) * q * (1 - q * q) * (1 - q * q);
    case SB_KERNEL_COSINE: return -pi / 2 * sin(pi * (1 + q) / 2) / (4 * (pi / 3 - 8 / pi + 16 / (pi * pi)));
    case SB_KERNEL_CUBIC: return q <= 0.5 ? 8 / pi * q * (18 * q - 12) : -48 / pi * r * r;
    case SB_KERNEL_QUARTIC: return -105 / (16 * pi) * 12 * q * r * r;
    }
    return 0;
}

SB_API sb_real sb_kernel_value(sb_kernel kernel, sb_real r, sb_real h)
{
    double radius = (double)h;
    return r >= 0 && r < h ? (sb_real)(sbi_kernel_shape(kernel, (double)r / radius) / (radius * radius * radius)) : 0;
}

SB_API sb_real sb_kernel_slope(sb_kernel kernel, sb_real r, sb_real h)
{
    double radius = (double)h, square = radius * radius;
    return r >= 0 && r < h ? (sb_real)(sbi_kernel_shape_slope(kernel, (double)r / radius) / (square * square)) : 0;
}

/* ---- moment matrices ---- */

/* A moment matrix, made ready to be solved with: scaled to a diagonal of ones and factored, or inverted on what it
 * spans. */
typedef struct sbi_moments {
    int n, pseudo;
    double a[SBI_PARTICLE_BASIS * SBI_PARTICLE_BASIS]; /* L of a[n][n], or its pseudo-inverse */
    double scale[SBI_PARTICLE_BASIS];
} sbi_moments;

/* L L^T of the scaled matrix; returns the least pivot, which is 1 at best and 0 where the matrix is singular. */
static double sbi_moments_factor(double *a, int n)
{
    double least = 1;
    for (int j = 0; j < n; j++)
        for (int i = j; i < n; i++) {
            double sum = a[i * n + j];
            for (int k = 0; k < j; k++)
                sum -= a[i * n + k] * a[j * n + k];
            if (i == j) {
                if (!(sum > 0))
                    return 0;
                least = sum < least ? sum : least;
                a[i * n + j] = sqrt(sum);
            } else {
                a[i * n + j] = sum / a[j * n + j];
            }
        }
    return least;
}

/* The pseudo-inverse in place of the scaled matrix. */
static void sbi_moments_invert(double *a, int n)
{
    double values[SBI_PARTICLE_BASIS], vectors[SBI_PARTICLE_BASIS * SBI_PARTICLE_BASIS];
    double scratch[2 * SBI_PARTICLE_BASIS], largest;
    int found = sbi_symmetric_eigen(a, n, values, vectors, scratch);
    largest = found ? values[n - 1] : 0;
    memset(a, 0, (size_t)(n * n) * sizeof *a);
    for (int k = 0; k < n && found; k++)
        for (int i = 0; i < n && values[k] > 1e-6 * largest; i++)
            for (int j = 0; j < n; j++)
                a[i * n + j] += vectors[k * n + i] * vectors[k * n + j] / values[k];
}

/* Takes the matrix in moments->a[n][n]; 0 when it is singular and pseudo 0. */
static int sbi_moments_prepare(sbi_moments *moments, int n, int pseudo, double *rank)
{
    double kept[SBI_PARTICLE_BASIS * SBI_PARTICLE_BASIS], *a = moments->a;
    moments->n = n;
    for (int i = 0; i < n; i++)
        moments->scale[i] = a[i * n + i] > 0 ? 1 / sqrt(a[i * n + i]) : 0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            a[i * n + j] *= moments->scale[i] * moments->scale[j];
    memcpy(kept, a, (size_t)(n * n) * sizeof *a);
    *rank = sbi_moments_factor(a, n);
    moments->pseudo = !(*rank >= SBI_LEAST_RANK);
    if (moments->pseudo && pseudo) {
        memcpy(a, kept, (size_t)(n * n) * sizeof *a);
        sbi_moments_invert(a, n);
    }
    return pseudo || !moments->pseudo;
}

/* x <- A^-1 x */
static void sbi_moments_solve(const sbi_moments *moments, double *x)
{
    const double *a = moments->a;
    double y[SBI_PARTICLE_BASIS];
    int n = moments->n;
    for (int i = 0; i < n; i++)
        y[i] = x[i] * moments->scale[i];
    if (moments->pseudo) {
        for (int i = 0; i < n; i++) {
            x[i] = 0;
            for (int j = 0; j < n; j++)
                x[i] += a[i * n + j] * y[j];
            x[i] *= moments->scale[i];
        }
        return;
    }
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++)
            y[i] -= a[i * n + k] * y[k];
        y[i] /= a[i * n + i];
    }
    for (int i = n; i-- > 0;) {
        for (int k = i + 1; k < n; k++)
            y[i] -= a[k * n + i] * y[k];
        y[i] /= a[i * n + i];
        x[i] = y[i] * moments->scale[i];
    }
}

/* ---- shape functions ---- */

/* Monomials of an offset over h: centred and scaled, so that their matrix keeps its condition anywhere (eq. 3.22). */
static void sbi_moving_basis(const double *offset, double h, int basis, double *p)
{
    double x = offset[0] / h, y = offset[1] / h, z = offset[2] / h;
    const double all[SBI_PARTICLE_BASIS] = {1, x, y, z, x * y, x * z, y * z, x * x, y * y, z * z};
    memcpy(p, all, (size_t)basis * sizeof *p);
}

static void sbi_moments_add(double *a, int n, double weight, const double *p)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            a[i * n + j] += weight * p[i] * p[j];
}

static double sbi_moving_dot(const double *a, const double *b, int n)
{
    double sum = 0;
    for (int i = 0; i < n; i++)
        sum += a[i] * b[i];
    return sum;
}

/* dW_j/dX_k of a neighbour's weight as the point moves: away from the neighbour it falls. */
static double sbi_moving_weight_slope(sb_kernel kernel, double h, const sbi_neighbours *near, int j, int k)
{
    double r = near->distance[j];
    return r > 0 ? -sbi_kernel_shape_slope(kernel, r / h) / h * near->offset[j][k] / r : 0;
}

/* phi_j = c . p_j W_j with c = A^-1 p(0), and along axis k, where p(0) has the derivative e_k / h and A that of its
 * weights, dphi_j = (A^-1 (e_k / h - dA c)) . p_j W_j + c . p_j dW_j (eq. 3.25 with its sign put right). */
SBI_API int sbi_moving_shapes(sb_kernel kernel, int basis, double h, const sbi_neighbours *near, int pseudo,
                              double *shapes, double (*gradients)[3], double *rank)
{
    double p[SBI_PARTICLE_NODES][SBI_PARTICLE_BASIS], w[SBI_PARTICLE_NODES], c[SBI_PARTICLE_BASIS] = {1};
    sbi_moments moments;
    memset(moments.a, 0, (size_t)(basis * basis) * sizeof moments.a[0]);
    for (int j = 0; j < near->count; j++) {
        w[j] = sbi_kernel_shape(kernel, near->distance[j] / h);
        sbi_moving_basis(near->offset[j], h, basis, p[j]);
        sbi_moments_add(moments.a, basis, w[j], p[j]);
    }
    if (!sbi_moments_prepare(&moments, basis, pseudo, rank))
        return 0;
    sbi_moments_solve(&moments, c);
    for (int j = 0; j < near->count; j++)
        shapes[j] = sbi_moving_dot(c, p[j], basis) * w[j];
    for (int k = 0; k < 3 && gradients; k++) {
        double d[SBI_PARTICLE_BASIS] = {0}, slope[SBI_PARTICLE_NODES];
        if (basis > 1)
            d[1 + k] = 1 / h;
        for (int j = 0; j < near->count; j++) {
            slope[j] = sbi_moving_weight_slope(kernel, h, near, j, k) * sbi_moving_dot(c, p[j], basis);
            for (int i = 0; i < basis; i++)
                d[i] -= slope[j] * p[j][i];
        }
        sbi_moments_solve(&moments, d);
        for (int j = 0; j < near->count; j++)
            gradients[j][k] = sbi_moving_dot(d, p[j], basis) * w[j] + slope[j];
    }
    return 1;
}

SBI_API int sbi_moving_slopes(sb_kernel kernel, double h, const sbi_neighbours *near, int pseudo,
                              double (*gradients)[3], double *rank)
{
    sbi_moments moments;
    memset(moments.a, 0, 9 * sizeof moments.a[0]);
    for (int j = 0; j < near->count; j++)
        for (int k = 0; k < 3; k++)
            gradients[j][k] = near->offset[j][k] / h;
    for (int j = 0; j < near->count; j++)
        sbi_moments_add(moments.a, 3, sbi_kernel_shape(kernel, near->distance[j] / h), gradients[j]);
    if (!sbi_moments_prepare(&moments, 3, pseudo, rank))
        return 0;
    for (int j = 0; j < near->count; j++) {
        double w = sbi_kernel_shape(kernel, near->distance[j] / h) / h;
        sbi_moments_solve(&moments, gradients[j]);
        for (int k = 0; k < 3; k++)
            gradients[j][k] *= w;
    }
    return 1;
}

SBI_API void sbi_sph_slopes(sb_kernel kernel, double h, const sbi_neighbours *near, const sb_real *volumes,
                            double (*gradients)[3])
{
    for (int j = 0; j < near->count; j++)
        for (int k = 0; k < 3; k++)
            gradients[j][k] =
                (double)volumes[near->nodes[j]] / (h * h * h) * sbi_moving_weight_slope(kernel, h, near, j, k);
}
