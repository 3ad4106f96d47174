/* elastic.h: the linear system of one implicit step of an elastic body of straight tetrahedra, for benchmarks:
 * assembled from first principles, so that what is timed does not depend on a body's loops. */
#ifndef ELASTIC_H
#define ELASTIC_H

#include "softbody.h"

#include "measure.h"

static const int elastic_edges[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}};

/* Gradients of the barycentric coordinates; returns the volume. */
static inline double elastic_gradients(const sb_vec3 *positions, const int *tet, double g[4][3])
{
    double d[3][3], det;
    for (int c = 0; c < 3; c++) {
        sb_vec3 edge = sb_v3_sub(positions[tet[c + 1]], positions[tet[0]]);
        d[0][c] = (double)edge.x, d[1][c] = (double)edge.y, d[2][c] = (double)edge.z;
    }
    for (int c = 0; c < 3; c++)
        for (int r = 0; r < 3; r++)
            g[c + 1][r] = d[(r + 1) % 3][(c + 1) % 3] * d[(r + 2) % 3][(c + 2) % 3] -
                          d[(r + 1) % 3][(c + 2) % 3] * d[(r + 2) % 3][(c + 1) % 3];
    det = d[0][0] * g[1][0] + d[1][0] * g[1][1] + d[2][0] * g[1][2];
    for (int r = 0; r < 3; r++) {
        for (int a = 1; a < 4; a++)
            g[a][r] /= det;
        g[0][r] = -g[1][r] - g[2][r] - g[3][r];
    }
    return (det < 0 ? -det : det) / 6;
}

/* Shape gradients at quadrature point q of 4 (linear elements: the same everywhere). */
static inline void elastic_shapes(int corners, double g[4][3], int q, double out[10][3])
{
    double at[4];
    for (int k = 0; k < 4; k++)
        at[k] = k == q ? 0.5854101966249685 : 0.1381966011250105;
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 4; k++)
            out[k][r] = corners == 4 ? g[k][r] : (4 * at[k] - 1) * g[k][r];
        for (int e = 0; e < corners - 4; e++)
            out[4 + e][r] = 4 * (at[elastic_edges[e][0]] * g[elastic_edges[e][1]][r] +
                                 at[elastic_edges[e][1]] * g[elastic_edges[e][0]][r]);
    }
}

/* block += factor (lambda a b^T + mu b a^T + mu a.b I) */
static inline void elastic_add(sb_real *block, const double *a, const double *b, double factor, double lambda,
                               double mu)
{
    double dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++)
            block[3 * r + c] += (sb_real)(factor * (lambda * a[r] * b[c] + mu * b[r] * a[c] + (r == c ? mu * dot : 0)));
}

typedef struct elastic_system {
    double young, poisson;  /* Pa, 1 */
    const sb_real *factors; /* [tets] of Young's modulus, or NULL: 1 */
    int at_rest;            /* K alone, without masses and damping */
} elastic_system;

/* M / dt^2 + (1 + beta / dt) K, or K at rest, of a material with 1000 kg/m^3, dt = 0.01 s and beta = 0.02 s, lumped
 * masses, and gravity on the right. cells [tets][corners], corners 4 or 10; the matrix has their pattern. */
static inline void elastic_assemble(const sb_vec3 *positions, const int *cells, int tets, int corners,
                                    const elastic_system *system, sb_matrix *matrix, sb_real *rhs)
{
    const double density = 1000, dt = 0.01, beta = 0.02, nu = system->poisson;
    const double inertia = system->at_rest ? 0 : density / (dt * dt), damped = system->at_rest ? 1 : 1 + beta / dt;
    for (int t = 0; t < tets; t++) {
        const int *tet = cells + (size_t)corners * (size_t)t;
        double young = system->young * (system->factors ? (double)system->factors[t] : 1);
        double lambda = young * nu / ((1 + nu) * (1 - 2 * nu)), mu = young / (2 * (1 + nu));
        double g[4][3], shape[10][3], volume = elastic_gradients(positions, tet, g);
        for (int q = 0; q < 4; q++) {
            elastic_shapes(corners, g, q, shape);
            for (int i = 0; i < corners; i++)
                for (int j = 0; j < corners; j++)
                    elastic_add(matrix->blocks[sb_matrix_find(matrix, tet[i], tet[j])], shape[i], shape[j],
                                damped * volume / 4, lambda, mu);
        }
        for (int i = 0; i < corners; i++) {
            double share = volume * (corners == 4 ? 1.0 / 4 : i < 4 ? 1.0 / 36 : 4.0 / 27);
            for (int r = 0; r < 3; r++)
                matrix->blocks[matrix->diagonal[tet[i]]][4 * r] += (sb_real)(inertia * share);
            rhs[3 * (size_t)tet[i] + 2] -= (sb_real)(9.81 * density * share);
        }
    }
}

#endif /* ELASTIC_H */
