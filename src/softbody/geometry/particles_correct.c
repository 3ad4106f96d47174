/* particles_correct: gradients that integrate to nothing about inner particles. */
#include "particles_private.h"

/* With b_a = int phi_a n dA, 0 for inner particles, constant stress is in balance where sum_p w_p g_pa = b_a. Shape
 * functions are rational and points do not integrate them, so
 *     g_pa += (P_p mu)_a,  P_p = I - Q (Q^T Q)^-1 Q^T,  Q the rows (1, X_a) of the point's nodes,
 *     A mu = -sum_p w_p g_p,  A = sum_p w_p P_p,
 * for inner particles, with mu = 0 for others: sums of corrections against 1 and X are 0, so that linear fields stay
 * exact. A is positive definite; one solve for each axis, by conjugate gradients. */

typedef struct sbi_correction {
    const sb_particles *particles;
    double (*rows)[4];                         /* [cells][nodes of a cell] of Z = Q L^-T, Q^T Q = L L^T, so that P_p is
                                                * I - Z Z^T; the first of a cell 0 where that is singular */
    double *diagonal;                          /* [particles] of A */
    double (*x)[3], (*r)[3], (*d)[3], (*y)[3]; /* [particles] */
} sbi_correction;

/* Row (1, (X_a - X_p) / h) of a node. */
static void sbi_correction_row(const sb_particles *particles, int cell, int node, double q[4])
{
    sb_vec3 from = particles->points[cell], x = particles->mesh.nodes[node];
    double h = (double)particles->radii[cell];
    q[0] = 1;
    q[1] = ((double)x.x - (double)from.x) / h;
    q[2] = ((double)x.y - (double)from.y) / h;
    q[3] = ((double)x.z - (double)from.z) / h;
}

/* Cholesky of a 4 x 4 matrix; 0 where a pivot is next to nothing. */
static int sbi_correction_factor(double *a)
{
    for (int j = 0; j < 4; j++)
        for (int i = j; i < 4; i++) {
            double sum = a[4 * i + j], whole = a[4 * j + j];
            for (int k = 0; k < j; k++)
                sum -= a[4 * i + k] * a[4 * j + k];
            if (i == j && !(sum > SBI_LEAST_RANK * whole))
                return 0;
            a[4 * i + j] = i == j ? sqrt(sum) : sum / a[4 * j + j];
        }
    return 1;
}

static double (*sbi_correction_rows(const sbi_correction *c, int e))[4]
{
    return c->rows + (size_t)e * (size_t)c->particles->domain.nodes_per_cell;
}

static int sbi_correction_has(const sbi_correction *c, int e) { return sbi_correction_rows(c, e)[0][0] != 0; }

/* z = L^-1 q in place of q */
static void sbi_correction_solve(const double *l, double *q)
{
    for (int i = 0; i < 4; i++) {
        for (int k = 0; k < i; k++)
            q[i] -= l[4 * i + k] * q[k];
        q[i] /= l[4 * i + i];
    }
}

static void sbi_correction_prepare(sbi_correction *c)
{
    const sb_particles *particles = c->particles;
    int n = particles->domain.nodes_per_cell;
    memset(c->diagonal, 0, (size_t)particles->mesh.node_count * sizeof *c->diagonal);
    for (int e = 0; e < particles->mesh.element_count; e++) {
        const int *nodes = particles->domain.cells + (size_t)e * (size_t)n;
        int count = sbi_particle_cell_count(particles, e);
        double(*z)[4] = sbi_correction_rows(c, e), gram[16];
        memset(gram, 0, sizeof gram);
        for (int a = 0; a < count; a++) {
            sbi_correction_row(particles, e, nodes[a], z[a]);
            for (int i = 0; i < 16; i++)
                gram[i] += z[a][i / 4] * z[a][i % 4];
        }
        if (!sbi_correction_factor(gram)) {
            z[0][0] = 0;
            continue;
        }
        for (int a = 0; a < count; a++) {
            double own = 1;
            sbi_correction_solve(gram, z[a]);
            for (int i = 0; i < 4; i++)
                own -= z[a][i] * z[a][i];
            c->diagonal[nodes[a]] += (double)particles->domain.weights[e] * own;
        }
    }
}

/* (P_p x)_a of a point's nodes, out[count][3]. */
static void sbi_correction_project(const sbi_correction *c, int e, int count, const double (*x)[3], double (*out)[3])
{
    const int *nodes = c->particles->domain.cells + (size_t)e * (size_t)c->particles->domain.nodes_per_cell;
    const double(*z)[4] = (const double(*)[4])sbi_correction_rows(c, e);
    double s0[4] = {0, 0, 0, 0}, s1[4] = {0, 0, 0, 0}, s2[4] = {0, 0, 0, 0};
    for (int a = 0; a < count; a++) {
        const double *at = x[nodes[a]];
        for (int i = 0; i < 4; i++) {
            s0[i] += z[a][i] * at[0];
            s1[i] += z[a][i] * at[1];
            s2[i] += z[a][i] * at[2];
        }
    }
    for (int a = 0; a < count; a++) {
        const double *at = x[nodes[a]], *row = z[a];
        out[a][0] = at[0] - ((row[0] * s0[0] + row[1] * s0[1]) + (row[2] * s0[2] + row[3] * s0[3]));
        out[a][1] = at[1] - ((row[0] * s1[0] + row[1] * s1[1]) + (row[2] * s1[2] + row[3] * s1[3]));
        out[a][2] = at[2] - ((row[0] * s2[0] + row[1] * s2[1]) + (row[2] * s2[2] + row[3] * s2[3]));
    }
}

/* y = A x on inner particles. */
static void sbi_correction_multiply(const sbi_correction *c, const double (*x)[3], double (*y)[3])
{
    const sb_particles *particles = c->particles;
    int n = particles->domain.nodes_per_cell;
    memset(y, 0, (size_t)particles->mesh.node_count * sizeof *y);
    for (int e = 0; e < particles->mesh.element_count; e++) {
        const int *nodes = particles->domain.cells + (size_t)e * (size_t)n;
        int count = sbi_particle_cell_count(particles, e), any = 0;
        double out[SBI_PARTICLE_NODES][3];
        for (int a = 0; a < count; a++)
            any |= particles->inner[nodes[a]];
        if (!any || !sbi_correction_has(c, e))
            continue;
        sbi_correction_project(c, e, count, x, out);
        for (int a = 0; a < count; a++)
            for (int k = 0; k < 3 && particles->inner[nodes[a]]; k++)
                y[nodes[a]][k] += (double)particles->domain.weights[e] * out[a][k];
    }
}

/* r = -sum_p w_p g_p on inner particles; returns the largest imbalance. */
static double sbi_correction_residual(const sbi_correction *c)
{
    const sb_domain *domain = &c->particles->domain;
    int n = domain->nodes_per_cell;
    double worst = 0;
    memset(c->r, 0, (size_t)domain->node_count * sizeof *c->r);
    memset(c->y, 0, (size_t)domain->node_count * sizeof *c->y);
    for (int e = 0; e < domain->cell_count; e++)
        for (int a = 0; a < n; a++) {
            size_t at = (size_t)e * (size_t)n + (size_t)a;
            const sb_real *g = domain->gradients + 3 * at;
            double w = (double)domain->weights[e], square = 0;
            for (int k = 0; k < 3; k++) {
                c->r[domain->cells[at]][k] -= w * (double)g[k];
                square += (double)g[k] * (double)g[k];
            }
            c->y[domain->cells[at]][0] += w * sqrt(square);
        }
    for (int i = 0; i < domain->node_count; i++) {
        double *r = c->r[i], size = sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]);
        if (!c->particles->inner[i])
            r[0] = r[1] = r[2] = 0;
        else if (c->y[i][0] > 0)
            worst = fmax(worst, size / c->y[i][0]);
    }
    return worst;
}

/* Conjugate gradients for the three axes at once; the residual is in r. */
static void sbi_correction_iterate(sbi_correction *c)
{
    enum { MOST = 500 };
    const double least = SB_REAL_IS_FLOAT ? 1e-8 : 1e-14;
    int n = c->particles->mesh.node_count;
    double rho[3] = {0, 0, 0}, first[3] = {0, 0, 0};
    memset(c->x, 0, (size_t)n * sizeof *c->x);
    memset(c->d, 0, (size_t)n * sizeof *c->d);
    for (int turn = 0; turn < MOST; turn++) {
        double next[3] = {0, 0, 0}, curve[3] = {0, 0, 0};
        int done = 1;
        for (int i = 0; i < n; i++)
            for (int k = 0; k < 3 && c->diagonal[i] > 0; k++)
                next[k] += c->r[i][k] * c->r[i][k] / c->diagonal[i];
        for (int k = 0; k < 3; k++) {
            first[k] = turn == 0 ? next[k] : first[k];
            done &= !(next[k] > least * least * first[k]);
        }
        if (done)
            return;
        for (int i = 0; i < n; i++)
            for (int k = 0; k < 3; k++)
                c->d[i][k] = (c->diagonal[i] > 0 ? c->r[i][k] / c->diagonal[i] : 0) +
                             (rho[k] > 0 ? next[k] / rho[k] * c->d[i][k] : 0);
        memcpy(rho, next, sizeof rho);
        sbi_correction_multiply(c, (const double(*)[3])c->d, c->y);
        for (int i = 0; i < n; i++)
            for (int k = 0; k < 3; k++)
                curve[k] += c->d[i][k] * c->y[i][k];
        for (int i = 0; i < n; i++)
            for (int k = 0; k < 3 && c->particles->inner[i]; k++) {
                double step = curve[k] > 0 ? rho[k] / curve[k] : 0;
                c->x[i][k] += step * c->d[i][k];
                c->r[i][k] -= step * c->y[i][k];
            }
    }
}

static void sbi_correction_apply(const sbi_correction *c, sb_domain *domain)
{
    int n = domain->nodes_per_cell;
    for (int e = 0; e < domain->cell_count; e++) {
        sb_real *g = domain->gradients + 3 * (size_t)e * (size_t)n;
        int count = sbi_particle_cell_count(c->particles, e);
        double out[SBI_PARTICLE_NODES][3];
        if (!sbi_correction_has(c, e))
            continue;
        sbi_correction_project(c, e, count, (const double(*)[3])c->x, out);
        for (int k = 0; k < 3; k++) {
            sb_real sum = 0;
            for (int a = 1; a < count; a++) {
                g[3 * a + k] = (sb_real)((double)g[3 * a + k] + out[a][k]);
                sum += g[3 * a + k];
            }
            g[k] = -sum; /* a translation is no deformation, to rounding */
        }
    }
}

SBI_API void sbi_particles_mark_inner(const sbi_near *near, const sb_vec3 *samples, int sample_count,
                                      sb_particles *particles)
{
    sbi_neighbours found;
    double h;
    memset(particles->inner, sample_count > 0, (size_t)particles->mesh.node_count);
    for (int i = 0; i < sample_count; i++) {
        if (!sbi_near_gather(near, &particles->def, samples[i], -1, 0, &found, &h))
            continue;
        for (int j = 0; j < found.count; j++)
            particles->inner[found.nodes[j]] = 0;
    }
}

SBI_API sb_result sbi_particles_correct(sb_particles *particles, sb_error *error)
{
    const sb_allocator *allocator = &particles->def.allocator;
    size_t n = (size_t)particles->mesh.node_count, cells = (size_t)particles->mesh.element_count, bytes = 0, rows = 0;
    int wanted = particles->def.consistent && particles->def.method != SB_PARTICLES_SPH &&
                 !(particles->def.method == SB_PARTICLES_GRID && particles->def.basis < 4);
    sbi_correction c;
    double *memory = NULL;
    if (sbi_size_add(&rows, cells, (size_t)particles->domain.nodes_per_cell) &&
        sbi_size_add(&bytes, rows, 4 * sizeof(double)) && sbi_size_add(&bytes, 13 * n, sizeof(double)))
        memory = (double *)sbi_alloc(allocator, bytes, 1);
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for consistent gradients of %d points", (int)cells);
    c.particles = particles;
    c.rows = (double(*)[4])memory;
    c.x = (double(*)[3])(memory + 4 * rows);
    c.r = c.x + n;
    c.d = c.r + n;
    c.y = c.d + n;
    c.diagonal = memory + 4 * rows + 12 * n;
    particles->imbalance = (sb_real)sbi_correction_residual(&c);
    if (wanted && particles->imbalance > 64 * SB_EPSILON) { /* else what there is is rounding: of a lattice in order */
        sbi_correction_prepare(&c);
        sbi_correction_iterate(&c);
        sbi_correction_apply(&c, &particles->domain);
    }
    sbi_free(allocator, memory);
    return SB_OK;
}
