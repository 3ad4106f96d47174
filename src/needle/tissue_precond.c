/* tissue_precond: blocks on the diagonal, plus six rigid modes of each aggregate of some 64 nodes.
 *
 * The blocks smooth, the modes carry what is long: without them iterations grow with the number of elements along the
 * body. Added, not multiplied: one product with A per iteration. Any coarse matrix that is positive definite keeps the
 * whole so, which is why one of some steps ago will do. */
#include "tissue_private.h"

#include <limits.h>
#include <string.h>

enum {
    NDLI_COARSE_NODES = 64,     /* nodes of an aggregate */
    NDLI_COARSE_MOST = 96,      /* aggregates: the factor is n^2 m^2 of their unknowns and band */
    NDLI_COARSE_LEAST_NODES = 8, /* smaller ones join a neighbour */
    NDLI_COARSE_AGE = 10,       /* steps, or */
    NDLI_COARSE_WASTE = 12      /* iterations too many, which take as long as a new coarse matrix does */
};

/* ---- aggregates ---- */

static int ndli_coarse_axis_cells(sb_real extent, sb_real cell)
{
    sb_real count = extent / cell + (sb_real)0.5;
    return count < 1 ? 1 : count > 64 ? 64 : (int)count;
}

/* Cells along each axis for boxes of a given edge. */
static int ndli_coarse_cells(sb_vec3 size, sb_real edge, int cells[3])
{
    cells[0] = ndli_coarse_axis_cells(size.x, edge);
    cells[1] = ndli_coarse_axis_cells(size.y, edge);
    cells[2] = ndli_coarse_axis_cells(size.z, edge);
    return cells[0] * cells[1] * cells[2];
}

static void ndli_coarse_bounds(const ndl_tissue_mesh *mesh, sb_vec3 *low, sb_vec3 *size)
{
    sb_vec3 high = mesh->X[0];
    *low = high;
    for (int i = 1; i < mesh->node_end; i++) {
        *low = sb_v3(sb_min(low->x, mesh->X[i].x), sb_min(low->y, mesh->X[i].y), sb_min(low->z, mesh->X[i].z));
        high = sb_v3(sb_max(high.x, mesh->X[i].x), sb_max(high.y, mesh->X[i].y), sb_max(high.z, mesh->X[i].z));
    }
    *size = sb_v3_sub(high, *low);
}

static int ndli_coarse_index(sb_real at, sb_real extent, int cells)
{
    sb_real scaled = extent > 0 ? at / extent * (sb_real)cells : 0;
    int index = scaled > 0 ? (int)sb_min(scaled, (sb_real)(cells - 1)) : 0;
    return index;
}

/* aggregate[node] = number of its box, the longest axis slowest: neighbours have near numbers and the band is small. */
static void ndli_coarse_box(ndl_tissue *t, sb_vec3 low, sb_vec3 size, const int cells[3])
{
    int order[3] = {0, 1, 2};
    sb_real extent[3];
    extent[0] = size.x, extent[1] = size.y, extent[2] = size.z;
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2 - a; b++)
            if (cells[order[b]] < cells[order[b + 1]]) {
                int swap = order[b];
                order[b] = order[b + 1];
                order[b + 1] = swap;
            }
    for (int i = 0; i < t->mesh.node_end; i++) {
        sb_vec3 from = sb_v3_sub(t->mesh.X[i], low);
        sb_real at[3];
        int number = 0;
        at[0] = from.x, at[1] = from.y, at[2] = from.z;
        for (int k = 0; k < 3; k++)
            number = number * cells[order[k]] + ndli_coarse_index(at[order[k]], extent[order[k]], cells[order[k]]);
        t->aggregate[i] = number;
    }
}

/* Nodes of boxes with few go to the box of a neighbour with enough, from the outside in. scratch: sizes of boxes. */
static void ndli_coarse_merge(ndl_tissue *t, int *sizes)
{
    int moved = 1;
    while (moved) {
        moved = 0;
        for (int i = 0; i < t->mesh.node_end; i++) {
            if (sizes[t->aggregate[i]] >= NDLI_COARSE_LEAST_NODES)
                continue;
            for (int k = t->row_start[i]; k < t->row_start[i] + t->row_count[i]; k++) {
                int other = t->aggregate[t->columns[k]];
                if (sizes[other] < NDLI_COARSE_LEAST_NODES)
                    continue;
                sizes[t->aggregate[i]]--; /* stays small: all its nodes leave, as far as they have where to */
                sizes[other]++;
                t->aggregate[i] = other;
                moved = 1;
                break;
            }
        }
    }
}

static void ndli_coarse_count(const ndl_tissue *t, int *sizes, int cells)
{
    memset(sizes, 0, (size_t)cells * sizeof(int));
    for (int i = 0; i < t->mesh.node_end; i++)
        sizes[t->aggregate[i]]++;
}

/* Aggregates of all nodes, numbered without gaps; their number. sizes: scratch for all boxes there may be. */
static int ndli_coarse_aggregate(ndl_tissue *t, int *sizes)
{
    int nodes = t->mesh.node_count, cells[3], all, used, number = 0;
    int goal = sbi_max_int(1, sbi_min_int(NDLI_COARSE_MOST, nodes / NDLI_COARSE_NODES));
    sb_vec3 low, size;
    sb_real edge;
    ndli_coarse_bounds(&t->mesh, &low, &size);
    edge = sb_max(sb_max(size.x, size.y), size.z);
    /* smaller boxes until enough of them hold nodes */
    do {
        all = ndli_coarse_cells(size, edge, cells);
        ndli_coarse_box(t, low, size, cells);
        ndli_coarse_count(t, sizes, all);
        used = 0;
        for (int k = 0; k < all; k++)
            used += sizes[k] >= NDLI_COARSE_LEAST_NODES;
        edge *= (sb_real)0.92;
    } while (used < goal && all < 8 * NDLI_COARSE_MOST);
    ndli_coarse_merge(t, sizes);
    for (int k = 0; k < all; k++)
        sizes[k] = sizes[k] > 0 ? number++ : -1;
    for (int i = 0; i < t->mesh.node_end; i++)
        t->aggregate[i] = sizes[t->aggregate[i]];
    return number;
}

static void ndli_coarse_layout(ndli_solid_coarse *coarse, sbi_arena *arena, size_t count)
{
    coarse->start = (int *)sbi_arena_take(arena, count + 1, sizeof(int));
    coarse->centre = (sb_vec3 *)sbi_arena_take(arena, count, sizeof(sb_vec3));
    coarse->inverse_radius = (sb_real *)sbi_arena_take(arena, count, sizeof(sb_real));
    coarse->factor = (double *)sbi_arena_take(arena, 36 * count * count, sizeof(double));
    coarse->unknown = (double *)sbi_arena_take(arena, 6 * count, sizeof(double));
}

NDLI_API int ndli_solid_coarse_create(ndl_tissue *t)
{
    size_t boxes = 64 * 64 * 64;
    int *sizes = (int *)sbi_alloc(&t->allocator, boxes, sizeof(int));
    ndli_solid_coarse coarse;
    sbi_arena arena;
    memset(&coarse, 0, sizeof coarse);
    memset(&arena, 0, sizeof arena);
    if (!sizes)
        return 0;
    coarse.count = ndli_coarse_aggregate(t, sizes);
    sbi_free(&t->allocator, sizes);
    ndli_coarse_layout(&coarse, &arena, (size_t)coarse.count);
    arena.base = (unsigned char *)sbi_alloc_zeroed(&t->allocator, arena.used, 1);
    if (!arena.base)
        return 0;
    arena.used = 0;
    ndli_coarse_layout(&coarse, &arena, (size_t)coarse.count);
    coarse.block = arena.base;
    t->coarse = coarse;
    return 1;
}

NDLI_API void ndli_solid_coarse_changed(ndl_tissue *t, const ndl_mesh_change *change)
{
    /* a source may be one of the new nodes' slots: read all first */
    for (int i = 0; i < change->node_count; i++) {
        const ndl_node_change *node = change->nodes + i;
        int best = 0;
        for (int c = 1; c < 4; c++)
            if (node->weights[c] > node->weights[best])
                best = c;
        if (node->sources[best] < t->node_room && node->node < t->node_room)
            t->scratch[node->node] = t->aggregate[node->sources[best]];
    }
    for (int i = 0; i < change->node_count; i++) {
        const ndl_node_change *node = change->nodes + i;
        int aggregate;
        if (node->node >= t->node_room)
            continue;
        aggregate = node->created ? t->scratch[node->node] : t->aggregate[node->node];
        t->scratch[node->node] = 0;
        t->aggregate[node->node] = aggregate;
        t->arm[node->node] = sb_v3_scale(t->coarse.inverse_radius[aggregate],
                                         sb_v3_sub(t->mesh.x[node->node], t->coarse.centre[aggregate]));
    }
    t->coarse.listed = 0;
}

/* Nodes by aggregate, ascending. */
static void ndli_coarse_list(ndl_tissue *t)
{
    ndli_solid_coarse *coarse = &t->coarse;
    int *start = coarse->start;
    memset(start, 0, ((size_t)coarse->count + 1) * sizeof(int));
    for (int i = 0; i < t->mesh.node_end; i++)
        if (t->mesh.node_flags[i])
            start[t->aggregate[i] + 1]++;
    for (int k = 0; k < coarse->count; k++)
        start[k + 1] += start[k];
    for (int i = 0; i < t->mesh.node_end; i++)
        if (t->mesh.node_flags[i])
            t->coarse_nodes[start[t->aggregate[i]]++] = i;
    memmove(start + 1, start, (size_t)coarse->count * sizeof(int));
    start[0] = 0;
    coarse->listed = 1;
}

/* ---- the coarse matrix P^T A P ---- */

/* Centres and arms at the nodes' present places. */
static void ndli_coarse_measure(ndl_tissue *t)
{
    ndli_solid_coarse *coarse = &t->coarse;
    for (int k = 0; k < coarse->count; k++) {
        int first = coarse->start[k], end = coarse->start[k + 1];
        sb_vec3 centre = sb_v3(0, 0, 0);
        sb_real square = 0;
        for (int n = first; n < end; n++)
            centre = sb_v3_add(centre, t->mesh.x[t->coarse_nodes[n]]);
        centre = sb_v3_scale(1 / (sb_real)sbi_max_int(1, end - first), centre);
        for (int n = first; n < end; n++) {
            sb_vec3 arm = sb_v3_sub(t->mesh.x[t->coarse_nodes[n]], centre);
            square += sb_v3_dot(arm, arm);
        }
        coarse->centre[k] = centre;
        coarse->inverse_radius[k] = square > 0 ? sb_sqrt((sb_real)(end - first) / square) : 0;
        for (int n = first; n < end; n++)
            t->arm[t->coarse_nodes[n]] =
                sb_v3_scale(coarse->inverse_radius[k], sb_v3_sub(t->mesh.x[t->coarse_nodes[n]], centre));
    }
}

/* s += B M_j with M = (I, -[arm]). */
SBI_FORCE_INLINE void ndli_coarse_gather(const sb_real *block, sb_real factor, sb_vec3 arm_j, double s[3][6])
{
    for (int r = 0; r < 3; r++) {
        sb_vec3 row = sb_v3(factor * block[3 * r], factor * block[3 * r + 1], factor * block[3 * r + 2]);
        sb_vec3 turn = sb_v3_cross(arm_j, row);
        s[r][0] += (double)row.x, s[r][1] += (double)row.y, s[r][2] += (double)row.z;
        s[r][3] += (double)turn.x, s[r][4] += (double)turn.y, s[r][5] += (double)turn.z;
    }
}

/* w = M_i^T s: what blocks B of node i add to a block of aggregates, s being the sum of their B M_j. */
SBI_FORCE_INLINE void ndli_coarse_project(const double s[3][6], sb_vec3 arm_i, double w[6][6])
{
    double x = (double)arm_i.x, y = (double)arm_i.y, z = (double)arm_i.z;
    for (int c = 0; c < 6; c++) {
        w[0][c] = s[0][c];
        w[1][c] = s[1][c];
        w[2][c] = s[2][c];
        w[3][c] = y * s[2][c] - z * s[1][c];
        w[4][c] = z * s[0][c] - x * s[2][c];
        w[5][c] = x * s[1][c] - y * s[0][c];
    }
}

/* Adds w to block (I, J) of the lower half, or w^T to (J, I); on the diagonal w, or w + w^T, in the lower half. */
static void ndli_coarse_add(ndli_solid_coarse *coarse, int I, int J, const double w[6][6], int twice)
{
    size_t stride = (size_t)coarse->width + 1;
    double *corner = coarse->factor + (size_t)(6 * sbi_max_int(I, J)) * stride +
                     (size_t)(coarse->width - 6 * (I > J ? I - J : J - I));
    for (int r = 0; r < 6; r++) {
        double *to = corner + (size_t)r * (stride - 1); /* row r of the block */
        if (I > J)
            for (int c = 0; c < 6; c++)
                to[c] += w[r][c];
        else if (I < J)
            for (int c = 0; c < 6; c++)
                to[c] += w[c][r];
        else
            for (int c = 0; c <= r; c++)
                to[c] += twice ? w[r][c] + w[c][r] : w[r][c];
    }
}

/* Blocks (i, i) and (i, j), i < j; those of one aggregate together. */
static void ndli_coarse_add_row(ndl_tissue *t, int i)
{
    int I = t->aggregate[i], end = t->row_start[i] + t->row_count[i];
    double own[3][6] = {{0}}, s[3][6] = {{0}}, w[6][6];
    sb_real block[9];
    for (int c = 0; c < 9; c++)
        block[c] = t->scheme.stiffness * t->diagonal[i][c];
    for (int c = 0; c < 9; c += 4)
        block[c] += t->scheme.mass * t->mesh.mass[i];
    ndli_coarse_gather(block, 1, t->arm[i], s);
    ndli_coarse_project((const double(*)[6])s, t->arm[i], w);
    ndli_coarse_add(&t->coarse, I, I, (const double(*)[6])w, 0);
    for (int k = t->row_start[i]; k < end; k++) {
        int j = t->columns[k], J = t->aggregate[j];
        if (j < i || t->role[j] != NDLI_ROW_FREE)
            continue;
        if (J == I) {
            ndli_coarse_gather(t->blocks[k], t->scheme.stiffness, t->arm[j], own);
            continue;
        }
        memset(s, 0, sizeof s);
        ndli_coarse_gather(t->blocks[k], t->scheme.stiffness, t->arm[j], s);
        ndli_coarse_project((const double(*)[6])s, t->arm[i], w);
        ndli_coarse_add(&t->coarse, I, J, (const double(*)[6])w, 0);
    }
    ndli_coarse_project((const double(*)[6])own, t->arm[i], w);
    ndli_coarse_add(&t->coarse, I, I, (const double(*)[6])w, 1);
}

/* In the order of rows, not of edges, whose numbers depend on the way the mesh has come. */
static void ndli_coarse_assemble(ndl_tissue *t)
{
    ndli_solid_coarse *coarse = &t->coarse;
    int reach = 0;
    for (int i = 0; i < t->mesh.node_end; i++)
        for (int k = t->row_start[i]; k < t->row_start[i] + t->row_count[i]; k++)
            reach = sbi_max_int(reach, t->aggregate[i] - t->aggregate[t->columns[k]]);
    coarse->width = 6 * reach + 5;
    memset(coarse->factor, 0, (size_t)(6 * coarse->count) * ((size_t)coarse->width + 1) * sizeof(double));
    for (int i = 0; i < t->mesh.node_end; i++)
        if (t->role[i] == NDLI_ROW_FREE)
            ndli_coarse_add_row(t, i);
}

/* Sum of a_k b_k, in eight parts: compilers make vectors of them, and all the same bits. */
SBI_FORCE_INLINE double ndli_coarse_dot(const double *a, const double *b, int count)
{
    double s[8] = {0, 0, 0, 0, 0, 0, 0, 0};
    int k = 0;
    for (; k + 8 <= count; k += 8)
        for (int c = 0; c < 8; c++)
            s[c] += a[k + c] * b[k + c];
    for (int c = 0; k < count; k++, c++)
        s[c] += a[k] * b[k];
    return ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7]));
}

/* A = L D L^T by rows of the band, 1/D on the diagonal; 0: not positive definite. A mode that nothing resists (all its
 * nodes held, or in line) has no residual either: any pivot will do. */
static int ndli_coarse_factor(ndli_solid_coarse *coarse)
{
    int n = 6 * coarse->count, width = coarse->width;
    size_t stride = (size_t)width + 1;
    double largest = 0;
    for (int i = 0; i < n; i++) {
        double d = coarse->factor[(size_t)i * stride + (size_t)width];
        largest = d > largest ? d : largest;
    }
    if (!(largest > 0) || !(largest <= (double)SB_REAL_MAX))
        return 0;
    for (int i = 0; i < n; i++) {
        double *row = coarse->factor + (size_t)i * stride + width - i, pivot;
        int first = sbi_max_int(0, i - width);
        row[i] = pivot = row[i] + 1e-9 * largest;
        for (int j = first; j < i; j++) {
            const double *other = coarse->factor + (size_t)j * stride + width - j;
            int k = sbi_max_int(first, j - width);
            row[j] -= ndli_coarse_dot(row + k, other + k, j - k);
        }
        for (int j = first; j < i; j++) {
            double scaled = row[j] * coarse->factor[(size_t)j * stride + (size_t)width];
            pivot -= row[j] * scaled;
            row[j] = scaled;
        }
        if (!(pivot > 0))
            return 0;
        row[i] = 1 / pivot;
    }
    return 1;
}

static void ndli_coarse_solve(const ndli_solid_coarse *coarse, double *b)
{
    int n = 6 * coarse->count, width = coarse->width;
    size_t stride = (size_t)width + 1;
    for (int i = 0; i < n; i++) {
        const double *row = coarse->factor + (size_t)i * stride + width - i;
        int first = sbi_max_int(0, i - width);
        b[i] -= ndli_coarse_dot(row + first, b + first, i - first);
    }
    for (int i = 0; i < n; i++)
        b[i] *= coarse->factor[(size_t)i * stride + (size_t)width];
    for (int i = n - 1; i > 0; i--) {
        const double *SB_RESTRICT row = coarse->factor + (size_t)i * stride + width - i;
        double known = b[i];
        int j = sbi_max_int(0, i - width);
        for (; j + 8 <= i; j += 8)
            for (int c = 0; c < 8; c++)
                b[j + c] -= row[j + c] * known;
        for (; j < i; j++)
            b[j] -= row[j] * known;
    }
}

/* ---- blocks ---- */

static void ndli_precond_block_task(void *user, int chunk)
{
    ndl_tissue *t = (ndl_tissue *)user;
    int last = sbi_min_int(t->mesh.node_end, (chunk + 1) * NDLI_SOLID_CHUNK);
    for (int i = chunk * NDLI_SOLID_CHUNK; i < last; i++) {
        sb_mat3 inverse;
        if (t->inverse_valid && !t->node_dirty[i])
            continue;
        t->node_dirty[i] = 0;
        if (t->role[i] != NDLI_ROW_FREE || sb_m3_spd_inverse(ndli_solid_node_block(t, i), &inverse) != 0)
            inverse = sb_m3_zero();
        memcpy(t->inverse[i], inverse.m, sizeof t->inverse[i]);
    }
}

static int ndli_precond_coarse_is_due(const ndl_tissue *t)
{
    const ndli_solid_coarse *coarse = &t->coarse;
    sb_real mass = t->scheme.mass - coarse->made_mass, stiffness = t->scheme.stiffness - coarse->made_stiffness;
    return coarse->age <= 0 || coarse->age >= NDLI_COARSE_AGE || coarse->wasted >= NDLI_COARSE_WASTE ||
           sb_abs(mass) > (sb_real)0.1 * coarse->made_mass ||
           sb_abs(stiffness) > (sb_real)0.1 * coarse->made_stiffness;
}

NDLI_API int ndli_solid_precond_update(ndl_tissue *t)
{
    ndli_solid_coarse *coarse = &t->coarse;
    sbi_run(&t->jobs, ndli_precond_block_task, t, ndli_solid_chunks(t->mesh.node_end));
    t->inverse_valid = 1;
    if (!coarse->listed)
        ndli_coarse_list(t);
    if (!ndli_precond_coarse_is_due(t))
        return 0;
    ndli_coarse_measure(t);
    ndli_coarse_assemble(t);
    coarse->usable = ndli_coarse_factor(coarse);
    coarse->age = coarse->wasted = 0;
    coarse->made_mass = t->scheme.mass;
    coarse->made_stiffness = t->scheme.stiffness;
    return 1;
}

/* ---- applying it ---- */

typedef struct ndli_precond_job {
    ndl_tissue *t;
    const sb_vec3 *r;
    sb_vec3 *z;
} ndli_precond_job;

/* unknown = P^T r, an aggregate at a time. */
static void ndli_precond_restrict_task(void *user, int k)
{
    const ndli_precond_job *job = (const ndli_precond_job *)user;
    ndl_tissue *t = job->t;
    double *out = t->coarse.unknown + 6 * (size_t)k;
    double s[6] = {0, 0, 0, 0, 0, 0};
    for (int n = t->coarse.start[k]; n < t->coarse.start[k + 1]; n++) {
        int i = t->coarse_nodes[n];
        sb_vec3 r, turn;
        if (t->role[i] != NDLI_ROW_FREE)
            continue;
        r = job->r[i];
        turn = sb_v3_cross(t->arm[i], r);
        s[0] += (double)r.x, s[1] += (double)r.y, s[2] += (double)r.z;
        s[3] += (double)turn.x, s[4] += (double)turn.y, s[5] += (double)turn.z;
    }
    memcpy(out, s, sizeof s);
}

/* z = D^-1 r + P unknown, and the chunk's r.z. */
static void ndli_precond_apply_task(void *user, int chunk)
{
    const ndli_precond_job *job = (const ndli_precond_job *)user;
    ndl_tissue *t = job->t;
    int last = sbi_min_int(t->mesh.node_end, (chunk + 1) * NDLI_SOLID_CHUNK);
    double sum = 0;
    for (int i = chunk * NDLI_SOLID_CHUNK; i < last; i++) {
        const sb_real *m = t->inverse[i];
        sb_vec3 r = job->r[i], z;
        if (t->role[i] != NDLI_ROW_FREE) {
            job->z[i] = sb_v3(0, 0, 0);
            continue;
        }
        z = sb_v3(m[0] * r.x + m[1] * r.y + m[2] * r.z, m[3] * r.x + m[4] * r.y + m[5] * r.z,
                  m[6] * r.x + m[7] * r.y + m[8] * r.z);
        if (t->coarse.usable) {
            const double *u = t->coarse.unknown + 6 * (size_t)t->aggregate[i];
            sb_vec3 turn = sb_v3((sb_real)u[3], (sb_real)u[4], (sb_real)u[5]);
            z = sb_v3_add(sb_v3_add(z, sb_v3((sb_real)u[0], (sb_real)u[1], (sb_real)u[2])),
                          sb_v3_cross(turn, t->arm[i]));
        }
        job->z[i] = z;
        sum += (double)r.x * (double)z.x + (double)r.y * (double)z.y + (double)r.z * (double)z.z;
    }
    t->partial[2 * chunk] = sum;
}

NDLI_API double ndli_solid_precondition(ndl_tissue *t, const sb_vec3 *r, sb_vec3 *z)
{
    int chunks = ndli_solid_chunks(t->mesh.node_end);
    double sum = 0;
    ndli_precond_job job;
    job.t = t;
    job.r = r;
    job.z = z;
    if (t->coarse.usable) {
        sbi_run(&t->jobs, ndli_precond_restrict_task, &job, t->coarse.count);
        ndli_coarse_solve(&t->coarse, t->coarse.unknown);
    }
    sbi_run(&t->jobs, ndli_precond_apply_task, &job, chunks);
    for (int k = 0; k < chunks; k++)
        sum += t->partial[2 * k];
    return sum;
}
