/* multigrid_region: where the stiffness of a matrix jumps. */
#include "multigrid_level.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Pieces in the making. */
typedef struct sbi_region_maker {
    const sb_matrix *matrix;
    const sb_real *moduli;
    double *most;  /* [rows] largest coupling of a node with another */
    int *region;   /* [rows] -1: none yet */
    int *queue;    /* [rows] */
    int *hits;     /* [rows] neighbours in the piece at work, */
    int *stamp;    /* [rows] when this is its number */
    int *member, *first;
    int work;
    const sb_vec3 *positions;
    int count;
} sbi_region_maker;

static double cutv(void) { return getenv("CUT") ? atof(getenv("CUT")) : 0.2; }

static int sbi_region_is_strong(const sbi_region_maker *m, int i, int q)
{
    int j = m->matrix->columns[q];
    return j != i && (double)m->moduli[q] > cutv() * fmax(m->most[i], m->most[j]);
}

/* member[i] == work: node i is in the piece at work. */
static void sbi_region_add(sbi_region_maker *m, int node, int *count)
{
    m->member[node] = m->work;
    m->queue[(*count)++] = node;
}

static int sbi_region_in_line(const sb_vec3 *x, int a, int b, int c)
{
    sb_vec3 u = sb_v3_sub(x[b], x[a]), v = sb_v3_sub(x[c], x[a]), w = sb_v3_sub(x[c], x[b]), n = sb_v3_cross(u, v);
    double uu = sb_v3_dot(u, u), vv = sb_v3_dot(v, v), ww = sb_v3_dot(w, w);
    double longest = fmax(uu, fmax(vv, ww));
    return sb_v3_dot(n, n) < 0.01 * longest * longest;
}

static int sbi_region_grow(sbi_region_maker *m, int count)
{
    for (int head = 0; head < count; head++) {
        int i = m->queue[head];
        for (int q = m->matrix->row_start[i]; q < m->matrix->row_start[i + 1]; q++) {
            int j = m->matrix->columns[q];
            if (m->member[j] == m->work || !sbi_region_is_strong(m, i, q))
                continue;
            if (m->stamp[j] != m->work) {
                m->stamp[j] = m->work;
                m->hits[j] = 1;
                m->first[2 * j] = i;
            } else if (m->hits[j] == 1) {
                m->hits[j] = 2;
                m->first[2 * j + 1] = i;
            } else if (!sbi_region_in_line(m->positions, m->first[2 * j], m->first[2 * j + 1], i)) {
                sbi_region_add(m, j, &count);
            }
        }
    }
    return count;
}

/* Seeds: a triangle of strong couplings. */
static int sbi_region_seed(sbi_region_maker *m, int i, int skip)
{
    const sb_matrix *a = m->matrix;
    int count = 0;
    for (int q = a->row_start[i]; q < a->row_start[i + 1]; q++) {
        int j = a->columns[q];
        if (!sbi_region_is_strong(m, i, q))
            continue;
        for (int p = q + 1; p < a->row_start[i + 1]; p++) {
            int k = a->columns[p], side;
            if (!sbi_region_is_strong(m, i, p))
                continue;
            side = sb_matrix_find(a, j, k);
            if (side < 0 || !sbi_region_is_strong(m, j, side) || skip-- > 0)
                continue;
            m->work++;
            sbi_region_add(m, i, &count);
            sbi_region_add(m, j, &count);
            sbi_region_add(m, k, &count);
            return count;
        }
    }
    return 0;
}

SBI_API int sbi_mg_find_regions(const sb_matrix *matrix, const sb_real *moduli, const sb_vec3 *positions, const sb_allocator *allocator, int **regions)
{
    int n = matrix->row_count, leftover = 0;
    sbi_region_maker m;
    *regions = NULL;
    if (!moduli)
        return 1;
    m.moduli = moduli;
    m.matrix = matrix;
    m.count = 0;
    m.most = (double *)sbi_alloc(allocator, (size_t)n, sizeof(double));
    m.region = (int *)sbi_alloc(allocator, (size_t)n, sizeof(int));
    m.queue = (int *)sbi_alloc(allocator, (size_t)n, sizeof(int));
    m.hits = (int *)sbi_alloc(allocator, (size_t)n, sizeof(int));
    m.stamp = (int *)sbi_alloc(allocator, (size_t)n, sizeof(int));
    for (int i = 0; i < n; i++) {
        m.most[i] = 0;
        m.region[i] = m.stamp[i] = -1;
        for (int q = matrix->row_start[i]; q < matrix->row_start[i + 1]; q++)
            if (matrix->columns[q] != i)
                m.most[i] = fmax(m.most[i], (double)m.moduli[q]);
    }
    m.member = (int *)sbi_alloc(allocator, (size_t)n, sizeof(int));
    m.first = (int *)sbi_alloc(allocator, 2*(size_t)n, sizeof(int));
    m.positions = positions;
    m.work = 0;
    memset(m.member, 0, (size_t)n * sizeof(int));
    memset(m.stamp, 0, (size_t)n * sizeof(int));
    for (int i = 0; i < n; i++) {
        for (int skip = 0; skip < 8 && m.region[i] < 0; skip++) {
            int count = sbi_region_seed(&m, i, skip), merge = -1, own = 0;
            if (!count)
                break;
            count = sbi_region_grow(&m, count);
            if (count < 4)
                continue;
            /* merge when three nodes, not in line, belong to one region */
            for (int k = 0; k < count && merge < 0; k++) {
                int r = m.region[m.queue[k]], a = m.queue[k], b = -1;
                own += r < 0;
                for (int l = k + 1; l < count && r >= 0 && merge < 0; l++)
                    if (m.region[m.queue[l]] == r) {
                        if (b < 0)
                            b = m.queue[l];
                        else if (!sbi_region_in_line(positions, a, b, m.queue[l]))
                            merge = r;
                    }
                if (k > 4096 && r < 0) break;
            }
            for (int k = 0; k < count; k++)
                if (m.region[m.queue[k]] < 0)
                    m.region[m.queue[k]] = merge >= 0 ? merge : m.count;
            m.count += merge < 0;
        }
    }
    /* leftovers: to the piece they are coupled with most */
    for (int pass = 0; pass < 8; pass++) {
        int open = 0;
        for (int i = 0; i < n; i++) {
            double best = 0;
            int to = -1;
            if (m.region[i] >= 0)
                continue;
            leftover += pass == 0;
            for (int q = matrix->row_start[i]; q < matrix->row_start[i + 1]; q++) {
                int j = matrix->columns[q];
                double c = (double)m.moduli[q];
                if (j != i && m.region[j] >= 0 && c >= best)
                    best = c, to = m.region[j];
            }
            m.region[i] = to;
            open += to < 0;
        }
        if (!open)
            break;
    }
    for (int i = 0; i < n; i++)
        m.region[i] = m.region[i] < 0 ? 0 : m.region[i];
    if (getenv("MGV")) {
        int *sizes = (int *)calloc((size_t)n, sizeof(int));
        for (int i = 0; i < n; i++)
            sizes[m.region[i]]++;
        printf("regions %d leftover %d:", m.count, leftover);
        for (int k = 0; k < m.count && k < 60; k++)
            printf(" %d", sizes[k]);
        printf("\n");
    }
    sbi_free(allocator, m.most);
    sbi_free(allocator, m.queue);
    sbi_free(allocator, m.hits);
    sbi_free(allocator, m.stamp);
    if (getenv("NOREG") || m.count < 2) {
        sbi_free(allocator, m.region);
        return 1;
    }
    *regions = m.region;
    return 1;
}
