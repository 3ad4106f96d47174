/* couple_line: see couple_line.h. */
#include "couple_line.h"

#include "band.h"

#include <string.h>

/* ---- memory ---- */

static void ndli_line_layout(ndli_line *line, sbi_arena *arena)
{
    size_t n = (size_t)line->capacity;
    ndli_v3 **vectors[] = {&line->move, &line->contact, &line->reaction, &line->tangent,
                           &line->known, &line->load, &line->motion, &line->force};
    double **reals[] = {&line->friction, &line->viscous, &line->slip};
    ndli_line_unknown **unknowns[] = {&line->unknown, &line->residual, &line->search, &line->product,
                                      &line->correction};
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++)
        *vectors[i] = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++)
        *reals[i] = (double *)sbi_arena_take(arena, n, sizeof(double));
    for (size_t i = 0; i < sizeof unknowns / sizeof *unknowns; i++)
        *unknowns[i] = (ndli_line_unknown *)sbi_arena_take(arena, n, sizeof(ndli_line_unknown));
    line->band = (double *)sbi_arena_take(arena, n, NDLI_LINE_UNKNOWNS * (NDLI_LINE_WIDTH + 1) * sizeof(double));
    line->right = (double *)sbi_arena_take(arena, n, NDLI_LINE_UNKNOWNS * sizeof(double));
    line->state = (unsigned char *)sbi_arena_take(arena, n, 1);
}

NDLI_API int ndli_line_create(ndli_line *line, ndl_rod *rod, ndl_tissue *tissue, const sb_allocator *allocator)
{
    sbi_arena arena = {NULL, 0, 0};
    memset(line, 0, sizeof *line);
    line->rod = rod;
    line->tissue = tissue;
    line->capacity = rod->capacity;
    line->first = rod->node_count;
    line->allocator = *allocator;
    ndli_line_layout(line, &arena);
    line->memory = arena.overflow ? NULL : sbi_alloc_zeroed(allocator, 1, arena.used);
    if (!line->memory)
        return 0;
    arena.base = (unsigned char *)line->memory;
    arena.used = 0;
    ndli_line_layout(line, &arena);
    return 1;
}

NDLI_API void ndli_line_free(ndli_line *line)
{
    if (line->memory)
        sbi_free(&line->allocator, line->memory);
    memset(line, 0, sizeof *line);
}

/* ---- the rod's rows ---- */

static int ndli_line_is_coupled(const ndli_line *line, int i)
{
    return i >= line->first && i < line->first + line->count;
}

/* Tissue node of a coupled rod node when its accelerations are unknowns, else -1. */
static int ndli_line_partner(const ndli_line *line, int i)
{
    int node = ndli_line_is_coupled(line, i) ? line->path[i - line->first] : -1;
    return node >= 0 && line->tissue->role[node] == NDLI_ROW_COUPLED ? node : -1;
}

/* Along which a node may slip: between its edges, at the tip the last one. */
static void ndli_line_set_tangents(ndli_line *line)
{
    const ndl_rod *rod = line->rod;
    int last = rod->node_count - 1;
    for (int i = 0; i <= last; i++) {
        ndli_v3 t = rod->shape.tangent[sbi_min_int(i, last - 1)];
        if (i > 0 && i < last)
            t = ndli_add(t, rod->shape.tangent[i - 1]);
        line->tangent[i] = ndli_scale(1 / ndli_norm(t), t);
    }
}

/* Where nodes go without their unknowns. */
static void ndli_line_set_known(ndli_line *line)
{
    const ndl_rod *rod = line->rod;
    const ndl_tissue *t = line->tissue;
    const ndli_solid_scheme *s = &t->scheme;
    for (int i = 0; i < rod->node_count; i++) {
        line->known[i] = ndli_scale(line->dt, rod->v[i]);
        if (rod->held[i]) {
            line->known[i] = ndli_sub(rod->target[i], rod->x[i]);
        } else if (ndli_line_is_coupled(line, i)) {
            int node = line->path[i - line->first];
            sb_vec3 way = sb_v3_scale(s->dt, sb_v3_madd(t->mesh.v[node], s->dt * s->c0, t->before[node]));
            if (t->role[node] == NDLI_ROW_HELD)
                way = sb_v3_sub(t->target[node], t->mesh.x[node]);
            line->known[i] = ndli_from(way);
        }
    }
}

/* force = kappa H motion, by the lower half of H. */
static void ndli_line_apply(const ndli_line *line, const ndli_v3 *motion, ndli_v3 *force)
{
    for (int i = 0; i < line->rod->node_count; i++) {
        const ndli_m3 *row = line->rod->matrix.node[i];
        force[i] = ndli_m_apply(&row[0], motion[i]);
        for (int k = 1; k <= 2 && k <= i; k++) {
            force[i] = ndli_add(force[i], ndli_m_apply(&row[k], motion[i - k]));
            force[i - k] = ndli_add(force[i - k], ndli_m_tapply(&row[k], motion[i]));
        }
    }
}

/* H = M/dt^2 + C/dt + K with its elastic part safe: positive definite. It is scaled by kappa, so that it acts on
 * accelerations as the tissue's matrix does. */
static void ndli_line_set_matrix(ndli_line *line)
{
    ndl_rod *rod = line->rod;
    ndli_rod_derivatives(rod, NDLI_ROD_NO_TWIST, rod->gradient, rod->turn_gradient, &rod->matrix);
    ndli_rod_set_damping_shape(rod);
    ndli_rod_add_damping_matrix(rod, 1 / line->dt, &rod->matrix);
    for (int i = 0; i < rod->node_count; i++) {
        ndli_m_add_identity(&rod->matrix.node[i][0], rod->mass[i] / (line->dt * line->dt));
        for (int k = 0; k <= 2; k++)
            for (int c = 0; c < 9; c++)
                rod->matrix.node[i][k].m[c / 3][c % 3] *= line->kappa;
    }
}

NDLI_API int ndli_line_linearise(ndli_line *line, double dt)
{
    ndl_rod *rod = line->rod;
    const ndli_solid_scheme *s = &line->tissue->scheme;
    size_t n = (size_t)rod->node_count;
    int bad = ndli_rod_set_shape(rod, rod->x, rod->theta);
    if (bad >= 0)
        return bad;
    line->dt = dt;
    line->kappa = (double)s->dt * (double)s->dt * (double)s->beta;
    ndli_line_set_tangents(line);
    ndli_line_set_known(line);
    ndli_line_set_matrix(line);
    ndli_line_apply(line, line->known, line->force);
    for (size_t i = 0; i < n; i++) {
        ndli_v3 load = ndli_madd(rod->force[i], rod->mass[i], ndli_madd(rod->gravity, 1 / dt, rod->v[i]));
        load = ndli_sub(load, rod->gradient[i]);
        line->load[i] = ndli_madd(load, -1 / line->kappa, line->force[i]);
    }
    memset(line->unknown, 0, n * sizeof *line->unknown);
    memset(line->search, 0, n * sizeof *line->search);
    return -1;
}

/* Force (N) on node i along its tangent that is known beforehand: friction while it slips. */
static double ndli_line_drag(const ndli_line *line, int i)
{
    int sign = ndli_line_sign(line, i);
    return -sign * ndli_line_limit(line, i, sign);
}

/* Viscous friction per unit of alpha (N). */
static double ndli_line_viscosity(const ndli_line *line, int i) { return line->viscous[i] * line->kappa / line->dt; }

/* ---- the guest ---- */

/* motion = what `unknown` moves, before kappa; on coupled rows with the tissue's vector. */
static void ndli_line_expand(ndli_line *line, const ndli_line_unknown *unknown, const sb_vec3 *tissue)
{
    for (int i = 0; i < line->rod->node_count; i++) {
        int partner = ndli_line_partner(line, i);
        if (line->rod->held[i])
            line->motion[i] = ndli_v(0, 0, 0);
        else if (!ndli_line_is_coupled(line, i))
            line->motion[i] = ndli_v(unknown[i][0], unknown[i][1], unknown[i][2]);
        else
            line->motion[i] = ndli_madd(partner < 0 ? ndli_v(0, 0, 0) : ndli_from(tissue[partner]), unknown[i][3],
                                        line->tangent[i]);
    }
}

NDLI_API void ndli_line_begin(ndli_line *line)
{
    const ndl_rod *rod = line->rod;
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 load = line->load[i];
        int partner = ndli_line_partner(line, i), slips = ndli_line_is_slipping(line, i);
        double *r = line->residual[i];
        r[0] = r[1] = r[2] = r[3] = 0;
        if (!slips)
            line->unknown[i][3] = 0;
        if (partner >= 0)
            line->tissue->residual[partner] = sb_v3_add(line->tissue->residual[partner], ndli_to(load));
        if (ndli_line_is_coupled(line, i))
            r[3] = slips ? ndli_dot(line->tangent[i], load) + ndli_line_drag(line, i) : 0;
        else if (!rod->held[i])
            r[0] = load.x, r[1] = load.y, r[2] = load.z;
    }
    memcpy(line->search, line->unknown, (size_t)rod->node_count * sizeof *line->search);
}

/* y += s x */
static void ndli_line_add(const ndli_line *line, ndli_line_unknown *y, double s, const ndli_line_unknown *x)
{
    for (int i = 0; i < line->rod->node_count; i++)
        for (int c = 0; c < NDLI_LINE_UNKNOWNS; c++)
            y[i][c] += s * x[i][c];
}

NDLI_API void ndli_line_settle(ndli_line *line)
{
    ndli_line_add(line, line->residual, -1, (const ndli_line_unknown *)line->product);
}

NDLI_API void ndli_line_direct(ndli_line *line, double factor)
{
    for (int i = 0; i < line->rod->node_count; i++)
        for (int c = 0; c < NDLI_LINE_UNKNOWNS; c++)
            line->search[i][c] = line->correction[i][c] + factor * line->search[i][c];
}

NDLI_API void ndli_line_advance(ndli_line *line, double factor)
{
    ndli_line_add(line, line->unknown, factor, (const ndli_line_unknown *)line->search);
    ndli_line_add(line, line->residual, -factor, (const ndli_line_unknown *)line->product);
}

NDLI_API double ndli_line_multiply(ndli_line *line)
{
    ndl_tissue *t = line->tissue;
    double sum = 0;
    ndli_line_expand(line, (const ndli_line_unknown *)line->search, t->search);
    ndli_line_apply(line, line->motion, line->force);
    for (int i = 0; i < line->rod->node_count; i++) {
        int partner = ndli_line_partner(line, i);
        double *q = line->product[i];
        q[0] = q[1] = q[2] = q[3] = 0;
        if (partner >= 0)
            t->product[partner] = sb_v3_add(t->product[partner], ndli_to(line->force[i]));
        if (!ndli_line_is_coupled(line, i)) {
            if (!line->rod->held[i])
                q[0] = line->force[i].x, q[1] = line->force[i].y, q[2] = line->force[i].z;
        } else if (ndli_line_is_slipping(line, i)) {
            double along = ndli_line_viscosity(line, i) * line->search[i][3];
            q[3] = ndli_dot(line->tangent[i], line->force[i]) + along;
            sum += along * line->search[i][3];
        }
        sum += ndli_dot(line->motion[i], line->force[i]);
    }
    return sum;
}

/* ---- the rod's block ---- */

/* Displacements of node i by its unknowns: u = [first, along] (a or z, alpha). */
typedef struct ndli_line_map {
    int moves;     /* 1: the first three are unknowns, */
    int slips;     /* 1: the fourth is */
    int partner;   /* the tissue's node of the first three, or -1 */
    ndli_v3 along;
} ndli_line_map;

static ndli_line_map ndli_line_get_map(const ndli_line *line, int i)
{
    ndli_line_map map;
    int coupled = ndli_line_is_coupled(line, i);
    map.partner = ndli_line_partner(line, i);
    map.moves = coupled ? map.partner >= 0 : !line->rod->held[i];
    map.slips = coupled && ndli_line_is_slipping(line, i);
    map.along = line->tangent[i];
    return map;
}

static ndli_m3 ndli_line_from_mat3(const sb_mat3 *a)
{
    ndli_m3 out;
    for (int c = 0; c < 9; c++)
        out.m[c / 3][c % 3] = (double)a->m[c / 3][c % 3];
    return out;
}

/* A block of the tissue's matrix between the partners of two nodes. */
static ndli_m3 ndli_line_tissue_block(const ndli_line *line, const ndli_line_map *a, const ndli_line_map *b)
{
    sb_mat3 block = sb_m3_zero();
    if (a->partner >= 0 && a->partner == b->partner)
        block = ndli_solid_node_block(line->tissue, a->partner);
    else if (a->partner >= 0 && b->partner >= 0)
        ndli_solid_edge_block(line->tissue, a->partner, b->partner, &block);
    return ndli_line_from_mat3(&block);
}

/* Rows of node i against columns of node i - k: the rod's block seen through the maps, and the tissue's. */
static void ndli_line_block(const ndli_line *line, int i, int k, double out[NDLI_LINE_UNKNOWNS][NDLI_LINE_UNKNOWNS])
{
    ndli_line_map a = ndli_line_get_map(line, i), b = ndli_line_get_map(line, i - k);
    const ndli_m3 *h = &line->rod->matrix.node[i][k];
    ndli_m3 tissue = ndli_line_tissue_block(line, &a, &b);
    ndli_v3 right = ndli_m_apply(h, b.along), left = ndli_m_tapply(h, a.along);
    memset(out, 0, NDLI_LINE_UNKNOWNS * sizeof *out);
    for (int r = 0; r < 3; r++) {
        for (int c = 0; c < 3 && a.moves && b.moves; c++)
            out[r][c] = h->m[r][c] + tissue.m[r][c];
        out[r][3] = a.moves && b.slips ? ndli_component(right, r) : 0;
        out[3][r] = a.slips && b.moves ? ndli_component(left, r) : 0;
    }
    out[3][3] = a.slips && b.slips ? ndli_dot(a.along, right) : 0;
    if (k == 0) {
        out[3][3] += a.slips ? ndli_line_viscosity(line, i) : 1;
        for (int r = 0; r < 3 && !a.moves; r++)
            out[r][r] = 1;
    }
}

NDLI_API int ndli_line_factor(ndli_line *line)
{
    enum { N = NDLI_LINE_UNKNOWNS, STRIDE = NDLI_LINE_WIDTH + 1 };
    int n = N * line->rod->node_count;
    memset(line->band, 0, (size_t)n * STRIDE * sizeof(double));
    for (int i = 0; i < line->rod->node_count; i++)
        for (int k = 0; k <= 2 && k <= i; k++) {
            double block[N][N];
            ndli_line_block(line, i, k, block);
            for (int r = 0; r < N; r++)
                for (int c = 0; c < N && (k > 0 || c <= r); c++)
                    line->band[(size_t)(N * i + r) * STRIDE + (size_t)(N * (i - k) + c - (N * i + r) + NDLI_LINE_WIDTH)] =
                        block[r][c];
        }
    return ndli_band_factor(line->band, n, NDLI_LINE_WIDTH, 1e-14) < 0;
}

/* right = the block's inverse times the residuals of its rows. */
static void ndli_line_solve_block(ndli_line *line)
{
    for (int i = 0; i < line->rod->node_count; i++) {
        int partner = ndli_line_partner(line, i);
        double *b = line->right + NDLI_LINE_UNKNOWNS * i;
        memcpy(b, line->residual[i], sizeof line->residual[i]);
        if (partner >= 0) {
            ndli_v3 r = ndli_from(line->tissue->residual[partner]);
            b[0] = r.x, b[1] = r.y, b[2] = r.z;
        }
    }
    ndli_band_solve(line->band, NDLI_LINE_UNKNOWNS * line->rod->node_count, NDLI_LINE_WIDTH, line->right);
}

NDLI_API double ndli_line_precondition(ndli_line *line)
{
    double sum = 0;
    ndli_line_solve_block(line);
    for (int i = 0; i < line->rod->node_count; i++) {
        int partner = ndli_line_partner(line, i);
        const double *z = line->right + NDLI_LINE_UNKNOWNS * i;
        memcpy(line->correction[i], z, sizeof line->correction[i]);
        if (partner >= 0) {
            ndli_v3 a = ndli_v(z[0], z[1], z[2]);
            line->tissue->correction[partner] = ndli_to(a);
            sum += ndli_dot(a, ndli_from(line->tissue->residual[partner]));
            memset(line->correction[i], 0, 3 * sizeof(double));
        }
        for (int c = 0; c < NDLI_LINE_UNKNOWNS; c++)
            sum += line->correction[i][c] * line->residual[i][c];
    }
    return sum;
}

NDLI_API void ndli_line_guess(ndli_line *line)
{
    for (int i = 0; i < line->rod->node_count; i++) {
        int partner = ndli_line_partner(line, i);
        for (int c = 0; c < NDLI_LINE_UNKNOWNS; c++)
            line->unknown[i][c] += line->correction[i][c];
        if (partner >= 0)
            line->tissue->unknown[partner] =
                sb_v3_add(line->tissue->unknown[partner], line->tissue->correction[partner]);
    }
}

/* ---- results ---- */

NDLI_API void ndli_line_read(ndli_line *line)
{
    const ndl_rod *rod = line->rod;
    ndli_line_expand(line, (const ndli_line_unknown *)line->unknown, line->tissue->unknown);
    ndli_line_apply(line, line->motion, line->force);
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 balance = ndli_sub(line->force[i], line->load[i]), none = ndli_v(0, 0, 0);
        int coupled = ndli_line_is_coupled(line, i);
        if (coupled && ndli_line_is_slipping(line, i)) { /* its friction is known better than the rows' residual */
            double along = ndli_line_drag(line, i) - ndli_line_viscosity(line, i) * line->unknown[i][3];
            balance = ndli_madd(balance, along - ndli_dot(line->tangent[i], balance), line->tangent[i]);
        }
        line->move[i] = ndli_madd(line->known[i], line->kappa, line->motion[i]);
        line->slip[i] = coupled ? line->kappa * line->unknown[i][3] : 0;
        line->contact[i] = coupled ? balance : none;
        line->reaction[i] = rod->held[i] ? balance : none;
    }
}
