/* couple_line: see couple_line.h. */
#include "couple_line.h"

#include "band.h"

#include <string.h>

/* ---- memory ---- */

static void ndli_line_layout(ndli_line *line, sbi_arena *arena)
{
    size_t n = (size_t)line->capacity;
    ndli_v3 **vectors[] = {&line->move, &line->contact, &line->reaction, &line->tangent,
                           &line->load, &line->before,  &line->motion,   &line->force};
    double **reals[] = {&line->friction, &line->viscous, &line->slip};
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++)
        *vectors[i] = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++)
        *reals[i] = (double *)sbi_arena_take(arena, n, sizeof(double));
    line->band = (double *)sbi_arena_take(arena, n, NDLI_LINE_UNKNOWNS * (NDLI_LINE_WIDTH + 1) * sizeof(double));
    line->right = (double *)sbi_arena_take(arena, n, NDLI_LINE_UNKNOWNS * sizeof(double));
    line->state = (unsigned char *)sbi_arena_take(arena, n, 1);
}

NDLI_API int ndli_line_create(ndli_line *line, ndl_rod *rod, const sb_allocator *allocator)
{
    sbi_arena arena = {NULL, 0, 0};
    memset(line, 0, sizeof *line);
    line->rod = rod;
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
    return i >= line->first && i < line->first + ndli_line_taken_count(line);
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

/* force = H motion, by the lower half of H. */
static void ndli_line_press(const ndli_line *line, const ndli_v3 *motion, ndli_v3 *force)
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

/* H = M/dt^2 + C/dt + K with its elastic part safe: positive definite. */
static void ndli_line_set_matrix(ndli_line *line)
{
    ndl_rod *rod = line->rod;
    ndli_rod_derivatives(rod, NDLI_ROD_NO_TWIST, rod->gradient, rod->turn_gradient, &rod->matrix);
    ndli_rod_set_damping_shape(rod);
    ndli_rod_add_damping_matrix(rod, 1 / line->dt, &rod->matrix);
    for (int i = 0; i < rod->node_count; i++)
        ndli_m_add_identity(&rod->matrix.node[i][0], rod->mass[i] / (line->dt * line->dt));
}

NDLI_API int ndli_line_linearise(ndli_line *line, const sbi_guest_step *step)
{
    ndl_rod *rod = line->rod;
    int bad = ndli_rod_set_shape(rod, rod->x, rod->theta);
    if (bad >= 0)
        return bad;
    line->dt = step->dt;
    line->level = step->level;
    ndli_line_set_tangents(line);
    ndli_line_set_matrix(line);
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 load = ndli_madd(rod->force[i], rod->mass[i], ndli_madd(rod->gravity, 1 / line->dt, rod->v[i]));
        line->load[i] = ndli_sub(load, rod->gradient[i]);
    }
    return -1;
}

NDLI_API void ndli_line_keep_contact(ndli_line *line)
{
    memcpy(line->before, line->contact, (size_t)line->rod->node_count * sizeof *line->before);
}

NDLI_API void ndli_line_start(const ndli_line *line, double *unknown)
{
    const ndl_rod *rod = line->rod;
    for (int i = 0; i < rod->node_count; i++, unknown += NDLI_LINE_UNKNOWNS) {
        int moves = !rod->held[i] && !ndli_line_is_coupled(line, i);
        ndli_v3 way = moves ? ndli_scale(line->level * line->dt, rod->v[i]) : ndli_v(0, 0, 0);
        unknown[0] = way.x, unknown[1] = way.y, unknown[2] = way.z, unknown[3] = 0;
    }
}

static ndli_v3 ndli_line_at(const double *vectors, int stride, int i)
{
    const double *v = vectors + (size_t)stride * (size_t)i;
    return ndli_v(v[0], v[1], v[2]);
}

static void ndli_line_put(double *vectors, int stride, int i, ndli_v3 v)
{
    double *out = vectors + (size_t)stride * (size_t)i;
    out[0] = v.x, out[1] = v.y, out[2] = v.z;
}

/* How the rod's nodes move over the whole step by the unknowns, which are those at its level; held ones by `held` times
 * their way. */
static void ndli_line_expand(ndli_line *line, double held, const double *unknown, const double *nodes)
{
    const ndl_rod *rod = line->rod;
    for (int i = 0; i < rod->node_count; i++) {
        int coupled = ndli_line_is_coupled(line, i);
        ndli_v3 way = coupled ? ndli_line_at(nodes, 3, i - line->first) : ndli_line_at(unknown, NDLI_LINE_UNKNOWNS, i);
        if (coupled && ndli_line_is_slipping(line, i))
            way = ndli_madd(way, unknown[NDLI_LINE_UNKNOWNS * i + 3], line->tangent[i]);
        line->motion[i] =
            rod->held[i] ? ndli_scale(held, ndli_sub(rod->target[i], rod->x[i])) : ndli_scale(1 / line->level, way);
    }
}

NDLI_API void ndli_line_apply(ndli_line *line, int loads, const double *unknown, const double *nodes,
                              double *out_unknown, double *out_nodes)
{
    const ndl_rod *rod = line->rod;
    memset(out_unknown, 0, (size_t)ndli_line_unknown_count(line) * sizeof *out_unknown);
    ndli_line_expand(line, loads, unknown, nodes);
    ndli_line_press(line, line->motion, line->force);
    for (int i = 0; i < rod->node_count; i++) {
        int coupled = ndli_line_is_coupled(line, i), slips = coupled && ndli_line_is_slipping(line, i);
        ndli_v3 row = loads ? ndli_sub(line->load[i], line->force[i]) : line->force[i];
        double along = ndli_dot(line->tangent[i], row);
        if (slips) {
            double viscous = ndli_line_viscosity(line, i) * unknown[NDLI_LINE_UNKNOWNS * i + 3] / line->level;
            along += loads ? ndli_line_drag(line, i) - viscous : viscous;
            out_unknown[NDLI_LINE_UNKNOWNS * i + 3] = line->level * along;
        }
        row = ndli_scale(line->level, row);
        if (coupled)
            ndli_line_put(out_nodes, 3, i - line->first,
                          loads ? ndli_madd(row, line->level - 1, line->before[i]) : row);
        else if (!rod->held[i])
            ndli_line_put(out_unknown, NDLI_LINE_UNKNOWNS, i, row);
    }
}

/* ---- the rod's block ---- */

/* Displacements of node i by its unknowns: [first, along] (u or z, alpha). */
typedef struct ndli_line_map {
    int moves[3]; /* 1: the component is an unknown, */
    int slips;    /* 1: the fourth is */
    int node;     /* the body's node of the first three, or -1 */
    ndli_v3 along;
} ndli_line_map;

static ndli_line_map ndli_line_get_map(const ndli_line *line, int i)
{
    ndli_line_map map;
    int coupled = ndli_line_is_coupled(line, i);
    map.node = coupled ? line->path[i - line->first] : -1;
    for (int c = 0; c < 3; c++)
        map.moves[c] = coupled ? !(line->matrix->fixed[map.node] >> c & 1) : !line->rod->held[i];
    map.slips = coupled && ndli_line_is_slipping(line, i);
    map.along = line->tangent[i];
    return map;
}

/* out += the block of the body's matrix between the nodes of two rod nodes. */
static void ndli_line_add_body_block(const ndli_line *line, const ndli_line_map *a, const ndli_line_map *b,
                                     ndli_m3 *out)
{
    int place = a->node >= 0 && b->node >= 0 ? sb_matrix_find(line->matrix, a->node, b->node) : -1;
    for (int c = 0; place >= 0 && c < 9; c++)
        out->m[c / 3][c % 3] += (double)line->matrix->blocks[place][c];
}

/* Rows of node i against columns of node i - k: the rod's block seen through the maps, and the body's. */
static void ndli_line_block(const ndli_line *line, int i, int k, double out[NDLI_LINE_UNKNOWNS][NDLI_LINE_UNKNOWNS])
{
    ndli_line_map a = ndli_line_get_map(line, i), b = ndli_line_get_map(line, i - k);
    ndli_m3 h = ndli_m_zero(), both;
    ndli_v3 right, left;
    ndli_m_add(&h, 1, &line->rod->matrix.node[i][k]); /* forces count with the level, ways with its inverse */
    both = h;
    ndli_line_add_body_block(line, &a, &b, &both);
    right = ndli_m_apply(&h, b.along);
    left = ndli_m_tapply(&h, a.along);
    memset(out, 0, NDLI_LINE_UNKNOWNS * sizeof *out);
    for (int r = 0; r < 3; r++) {
        for (int c = 0; c < 3; c++)
            out[r][c] = a.moves[r] && b.moves[c] ? both.m[r][c] : 0;
        out[r][3] = a.moves[r] && b.slips ? ndli_component(right, r) : 0;
        out[3][r] = a.slips && b.moves[r] ? ndli_component(left, r) : 0;
    }
    out[3][3] = a.slips && b.slips ? ndli_dot(a.along, right) : 0;
    if (k == 0) {
        out[3][3] += a.slips ? ndli_line_viscosity(line, i) : 1;
        for (int r = 0; r < 3; r++)
            out[r][r] += a.moves[r] ? 0 : 1;
    }
}

enum { NDLI_LINE_STRIDE = NDLI_LINE_WIDTH + 1 };

/* Where row r of node a and column c of node b are in the band. */
static size_t ndli_line_band_at(int a, int r, int b, int c)
{
    int row = NDLI_LINE_UNKNOWNS * a + r, column = NDLI_LINE_UNKNOWNS * b + c;
    return (size_t)row * NDLI_LINE_STRIDE + (size_t)(column - row + NDLI_LINE_WIDTH);
}

NDLI_API void ndli_line_add_to_band(ndli_line *line, int a, int b, double factor, const ndli_m3 *k)
{
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3 && (a > b || c <= r); c++)
            line->band[ndli_line_band_at(a, r, b, c)] += factor * k->m[r][c];
}

NDLI_API void ndli_line_fill(ndli_line *line, const sb_matrix *matrix)
{
    enum { N = NDLI_LINE_UNKNOWNS };
    int n = N * line->rod->node_count;
    line->matrix = matrix;
    memset(line->band, 0, (size_t)n * NDLI_LINE_STRIDE * sizeof(double));
    for (int i = 0; i < line->rod->node_count; i++)
        for (int k = 0; k <= 2 && k <= i; k++) {
            double block[N][N];
            ndli_line_block(line, i, k, block);
            for (int r = 0; r < N; r++)
                for (int c = 0; c < N && (k > 0 || c <= r); c++)
                    line->band[ndli_line_band_at(i, r, i - k, c)] = block[r][c];
        }
}

NDLI_API int ndli_line_factor(ndli_line *line)
{
    return ndli_band_factor(line->band, ndli_line_unknown_count(line), NDLI_LINE_WIDTH, 1e-14) < 0;
}

NDLI_API void ndli_line_solve_block(ndli_line *line, const double *unknown, const double *nodes, double *out_unknown,
                                    double *out_nodes)
{
    double *right = line->right;
    size_t bytes = (size_t)ndli_line_unknown_count(line) * sizeof(double);
    memcpy(right, unknown, bytes);
    for (int k = 0; k < ndli_line_taken_count(line); k++)
        ndli_line_put(right, NDLI_LINE_UNKNOWNS, line->first + k, ndli_line_at(nodes, 3, k));
    ndli_band_solve(line->band, ndli_line_unknown_count(line), NDLI_LINE_WIDTH, right);
    memcpy(out_unknown, right, bytes);
    for (int k = 0; k < ndli_line_taken_count(line); k++) {
        ndli_line_put(out_nodes, 3, k, ndli_line_at(right, NDLI_LINE_UNKNOWNS, line->first + k));
        ndli_line_put(out_unknown, NDLI_LINE_UNKNOWNS, line->first + k, ndli_v(0, 0, 0));
    }
}

/* ---- results ---- */

NDLI_API void ndli_line_read(ndli_line *line, const double *unknown, const double *nodes)
{
    const ndl_rod *rod = line->rod;
    ndli_line_expand(line, 1, unknown, nodes);
    ndli_line_press(line, line->motion, line->force);
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 balance = ndli_sub(line->force[i], line->load[i]), none = ndli_v(0, 0, 0);
        int coupled = ndli_line_is_coupled(line, i), slips = coupled && ndli_line_is_slipping(line, i);
        double slip = slips ? unknown[NDLI_LINE_UNKNOWNS * i + 3] / line->level : 0;
        if (slips) { /* its friction is known better than the rows' residual */
            double along = ndli_line_drag(line, i) - ndli_line_viscosity(line, i) * slip;
            balance = ndli_madd(balance, along - ndli_dot(line->tangent[i], balance), line->tangent[i]);
        }
        line->move[i] = line->motion[i];
        line->slip[i] = slip;
        line->contact[i] = coupled ? balance : none;
        line->reaction[i] = rod->held[i] ? balance : none;
    }
}
