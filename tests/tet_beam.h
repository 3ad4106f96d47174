/* tet_beam.h: the linear system of a cantilever of tetrahedra, put together here and not by the library's assembly.
 * The includer has softbody.h already, with or without its implementation. */
#ifndef TET_BEAM_H
#define TET_BEAM_H

#include "check.h"

/* A cantilever of structured tetrahedra: M / dt^2 + (1 + beta / dt) K of linear elasticity, clamped at x = 0. */
typedef struct beam {
    int nodes, n; /* n = 3 nodes */
    sb_matrix a;
    sb_vec3 *positions;
    unsigned char *mask;
    sb_real *rhs, *x;
} beam;

/* K_ij += V (lambda g_i g_j^T + mu g_j g_i^T + mu g_i.g_j I) for a tetrahedron, times `factor`. */
static inline void beam_add_tet(sb_matrix *a, const sb_vec3 *positions, const int *tet, double lambda, double mu,
                                double factor, double mass, sb_real *rhs)
{
    double d[3][3], g[4][3], det, volume;
    for (int c = 0; c < 3; c++) {
        sb_vec3 edge = sb_v3_sub(positions[tet[c + 1]], positions[tet[0]]);
        d[0][c] = (double)edge.x, d[1][c] = (double)edge.y, d[2][c] = (double)edge.z;
    }
    for (int c = 0; c < 3; c++)
        for (int r = 0; r < 3; r++)
            g[c + 1][r] = d[(r + 1) % 3][(c + 1) % 3] * d[(r + 2) % 3][(c + 2) % 3] -
                          d[(r + 1) % 3][(c + 2) % 3] * d[(r + 2) % 3][(c + 1) % 3];
    det = d[0][0] * g[1][0] + d[1][0] * g[1][1] + d[2][0] * g[1][2];
    volume = fabs(det) / 6;
    for (int r = 0; r < 3; r++) {
        for (int k = 1; k < 4; k++)
            g[k][r] /= det;
        g[0][r] = -g[1][r] - g[2][r] - g[3][r];
    }
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            sb_real *block = a->blocks[sb_matrix_find(a, tet[i], tet[j])];
            double dot = g[i][0] * g[j][0] + g[i][1] * g[j][1] + g[i][2] * g[j][2];
            for (int r = 0; r < 3; r++)
                for (int c = 0; c < 3; c++)
                    block[3 * r + c] +=
                        (sb_real)(factor * volume *
                                  (lambda * g[i][r] * g[j][c] + mu * g[j][r] * g[i][c] + (r == c ? mu * dot : 0)));
        }
        for (int r = 0; r < 3; r++)
            a->blocks[a->diagonal[tet[i]]][4 * r] += (sb_real)(mass * volume / 4);
        rhs[3 * tet[i] + 2] -= (sb_real)(9810 * volume / 4);
    }
}

/* mass_factor 1: dt = 0.01 s; 0: static. */
static inline beam beam_make(int nx, int ny, int nz, double mass_factor, int clamped)
{
    static const int paths[6][3] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
    const double young = 50e3, poisson = 0.45;
    int tets = 6 * nx * ny * nz, *cells = (int *)malloc(sizeof(int) * 4 * (size_t)tets), *out = cells;
    beam b;
    memset(&b, 0, sizeof b);
    b.nodes = (nx + 1) * (ny + 1) * (nz + 1);
    b.n = 3 * b.nodes;
    b.positions = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)b.nodes);
    b.mask = (unsigned char *)calloc((size_t)b.nodes, 1);
    b.rhs = (sb_real *)calloc((size_t)b.n, sizeof(sb_real));
    b.x = (sb_real *)calloc((size_t)b.n, sizeof(sb_real));
    for (int i = 0; i < b.nodes; i++) {
        int at = i / ((ny + 1) * (nz + 1));
        b.positions[i] = sb_v3((sb_real)(0.2 * at / nx), (sb_real)(0.06 * (i / (nz + 1) % (ny + 1)) / ny),
                               (sb_real)(0.06 * (i % (nz + 1)) / nz));
        b.mask[i] = clamped && at == 0 ? SB_XYZ : 0;
    }
    for (int cube = 0; cube < tets / 6; cube++)
        for (int path = 0; path < 6; path++) {
            int at[3] = {cube / (ny * nz), cube / nz % ny, cube % nz};
            for (int v = 0; v < 4; v++) {
                *out++ = (at[0] * (ny + 1) + at[1]) * (nz + 1) + at[2];
                at[v < 3 ? paths[path][v] : 0]++;
            }
        }
    CHECK_OK(sb_matrix_create(b.nodes, tets, 4, NULL, cells, NULL, &b.a, NULL));
    for (int t = 0; t < tets; t++)
        beam_add_tet(&b.a, b.positions, cells + 4 * t, young * poisson / ((1 + poisson) * (1 - 2 * poisson)),
                     young / (2 * (1 + poisson)), mass_factor > 0 ? 3 : 1, mass_factor * 1000 / 1e-4, b.rhs);
    sb_matrix_constrain(&b.a, b.mask, NULL, b.rhs);
    free(cells);
    return b;
}

static inline void beam_free(beam *b)
{
    sb_matrix_free(&b->a);
    free(b->positions);
    free(b->mask);
    free(b->rhs);
    free(b->x);
}

#endif /* TET_BEAM_H */
