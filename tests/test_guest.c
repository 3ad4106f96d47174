/* Tests of guests: what conjugate gradients solve together with a matrix, against dense solutions of the joint system.
 * Guests are internal. */
#define SB_SPLIT_BUILD
#include "../src/softbody/solve/guest.h"
#include "../src/softbody/solve/pcg.h"

#include "check.h"
#include "scene.h"
#include "dense_double.h"
#include "tet_beam.h"

/* ---- guests of dense matrices ---------------------------------------------------------------------------- */

typedef struct dense_guest {
    sbi_guest guest;
    int width, size;
    double *g;     /* [width][width] */
    double *load;  /* [width] */
    double *block; /* [size][size] Cholesky factor of the rows of its own block */
    int *nodes;
    double *unknown;
    void *extra;            /* a test's own */
    int multiplies, nan_at; /* products so far, and the one that answers NaN; < 0: none */
} dense_guest;

static void dense_residual(void *user, const double *x, double *y)
{
    dense_guest *d = (dense_guest *)user;
    for (int i = 0; i < d->width; i++) {
        y[i] = d->load[i];
        for (int k = 0; k < d->width; k++)
            y[i] -= d->g[i * d->width + k] * x[k];
    }
}

static void dense_multiply(void *user, const double *x, double *y)
{
    dense_guest *d = (dense_guest *)user;
    for (int i = 0; i < d->width; i++) {
        y[i] = 0;
        for (int k = 0; k < d->width; k++)
            y[i] += d->g[i * d->width + k] * x[k];
    }
    if (d->multiplies++ == d->nan_at)
        y[d->width / 2] = (double)NAN;
}

static void dense_precondition(void *user, const double *r, double *z)
{
    const dense_guest *d = (const dense_guest *)user;
    dense_solve(d->block, d->size, r, z);
}

static dense_guest *dense_make(int unknowns, int node_count, const int *nodes, int taken)
{
    dense_guest *d = (dense_guest *)calloc(1, sizeof *d);
    d->width = unknowns + 3 * node_count;
    d->size = unknowns + 3 * taken;
    d->g = (double *)calloc((size_t)d->width * (size_t)d->width + 1, sizeof(double));
    d->load = (double *)calloc((size_t)d->width + 1, sizeof(double));
    d->block = (double *)calloc((size_t)d->size * (size_t)d->size + 1, sizeof(double));
    d->nodes = (int *)calloc((size_t)node_count + 1, sizeof(int));
    d->unknown = (double *)calloc((size_t)unknowns + 1, sizeof(double));
    if (node_count)
        memcpy(d->nodes, nodes, sizeof(int) * (size_t)node_count);
    d->nan_at = -1;
    d->guest.user = d;
    d->guest.unknown_count = unknowns;
    d->guest.unknown = d->unknown;
    d->guest.node_count = node_count;
    d->guest.nodes = d->nodes;
    d->guest.taken_count = taken;
    d->guest.residual = dense_residual;
    d->guest.multiply = dense_multiply;
    d->guest.precondition = d->size ? dense_precondition : NULL;
    return d;
}

/* Factors the block of its rows with the blocks of A among the nodes that it takes. */
static int dense_factor_block(dense_guest *d, const sb_matrix *a)
{
    int own = d->guest.unknown_count;
    for (int i = 0; i < d->size; i++)
        for (int k = 0; k < d->size; k++)
            d->block[i * d->size + k] = d->g[i * d->width + k];
    for (int i = 0; i < d->guest.taken_count; i++)
        for (int k = 0; k < d->guest.taken_count; k++) {
            int q = sb_matrix_find(a, d->nodes[i], d->nodes[k]);
            for (int c = 0; q >= 0 && c < 9; c++)
                d->block[(own + 3 * i + c / 3) * d->size + own + 3 * k + c % 3] += (double)a->blocks[q][c];
        }
    for (int i = own; i < d->size; i++) /* prescribed components */
        for (int k = 0; k < d->size && (a->fixed[d->nodes[(i - own) / 3]] >> (i - own) % 3 & 1); k++)
            d->block[i * d->size + k] = d->block[k * d->size + i] = i == k;
    return dense_factor(d->block, d->size);
}

static void dense_free(dense_guest *d)
{
    free(d->g), free(d->load), free(d->block), free(d->nodes), free(d->unknown), free(d);
}

/* A rod of so many nodes between two points, seen through weights: rod node i moves by sum of weight[i][k] times
 * compact component columns[i][k] (x; y and z follow). */
typedef struct rod {
    int count;
    int (*columns)[4];
    double (*weights)[4];
    double stretch, bend; /* N/m of a segment, of a second difference */
} rod;

/* G += s (sum of terms)(sum of terms)^T on each axis. */
static void dense_add(dense_guest *d, int terms, const int *columns, const double *factors, double s)
{
    for (int i = 0; i < terms; i++)
        for (int k = 0; k < terms; k++)
            for (int axis = 0; axis < 3; axis++)
                d->g[(columns[i] + axis) * d->width + columns[k] + axis] += s * factors[i] * factors[k];
}

static void rod_add(dense_guest *d, const rod *r)
{
    static const double difference[2] = {-1, 1}, second[3] = {1, -2, 1};
    for (int i = 0; i + 1 < r->count; i++) {
        int columns[12], order = i + 2 < r->count ? 3 : 2;
        double factors[12];
        for (int bend = 0; bend <= order - 2; bend++) {
            int n = 0;
            for (int k = 0; k < 2 + bend; k++)
                for (int w = 0; w < 4; w++)
                    if (r->weights[i + k][w] != 0) {
                        columns[n] = r->columns[i + k][w];
                        factors[n++] = r->weights[i + k][w] * (bend ? second[k] : difference[k]);
                    }
            dense_add(d, n, columns, factors, bend ? r->bend : r->stretch);
        }
    }
}

/* ---- the rod in the beam -------------------------------------------------------------------------------- */

enum { ROD_NODES = 30 };

/* Where rod nodes are in the beam's grid, from ahead of the clamped end through the other one, and their weights: nodes
 * of cells, or (on_nodes) nodes along one line of edges. */
typedef struct rod_path {
    int count, node_count;
    int nodes[4 * ROD_NODES];
    int columns[ROD_NODES][4]; /* 3 times a place in nodes */
    double weights[ROD_NODES][4];
} rod_path;

static void path_put(rod_path *path, int i, int corner, int node, double weight)
{
    int k = 0;
    path->weights[i][corner] = weight;
    path->columns[i][corner] = 0;
    if (weight == 0)
        return;
    while (k < path->node_count && path->nodes[k] != node)
        k++;
    path->nodes[k] = node;
    path->node_count = k == path->node_count ? k + 1 : path->node_count;
    path->columns[i][corner] = 3 * k;
}

/* Barycentric weights in the tet of the grid's cube: its corners follow the axes by falling coordinate. */
static void path_put_cell(rod_path *path, int i, const double *x, const int *n)
{
    int at[3] = {(int)x[0], (int)x[1], (int)x[2]}, order[3] = {0, 1, 2};
    double f[3] = {x[0] - at[0], x[1] - at[1], x[2] - at[2]}, last = 1;
    for (int a = 0; a < 3; a++)
        for (int b = a + 1; b < 3; b++)
            if (f[order[b]] > f[order[a]]) {
                int swap = order[a];
                order[a] = order[b];
                order[b] = swap;
            }
    for (int v = 0; v < 4; v++) {
        double next = v < 3 ? f[order[v]] : 0;
        path_put(path, i, v, (at[0] * (n[1] + 1) + at[1]) * (n[2] + 1) + at[2], last - next);
        last = next;
        at[v < 3 ? order[v] : 0]++;
    }
}

static rod_path path_make(const int *n, int on_nodes)
{
    rod_path path;
    memset(&path, 0, sizeof path);
    path.count = on_nodes ? n[0] - 1 : ROD_NODES;
    for (int i = 0; i < path.count; i++) {
        double share = (double)i / (ROD_NODES - 1);
        double x[3] = {1.3 + (n[0] - 2.0) * share, n[1] / 2 + 0.3 + 0.3 * share, n[2] / 2 + 0.4 - 0.3 * share};
        if (on_nodes)
            path_put(&path, i, 0, ((i + 2) * (n[1] + 1) + n[1] / 2) * (n[2] + 1) + n[2] / 2, 1);
        else
            path_put_cell(&path, i, x, n);
    }
    return path;
}

/* The rod, its last node drawn by `pull` (m) with a spring as stiff as a segment. spring 0: its nodes are points of the
 * beam; otherwise they are unknowns that hang on those points by springs (N/m). */
static dense_guest *rod_make(const rod_path *path, double stretch, double bend, double spring, double pull)
{
    int own = spring > 0 ? 3 * path->count : 0, columns[ROD_NODES][4];
    double weights[ROD_NODES][4];
    rod r = {path->count, columns, weights, stretch, bend};
    dense_guest *d = dense_make(own, path->node_count, path->nodes, path->node_count);
    for (int i = 0; i < path->count; i++) {
        double factors[5] = {1, 0, 0, 0, 0};
        int terms[5] = {3 * i, 0, 0, 0, 0};
        for (int w = 0; w < 4; w++) {
            terms[w + 1] = own + path->columns[i][w];
            factors[w + 1] = -path->weights[i][w];
            columns[i][w] = own ? 3 * i : path->columns[i][w];
            weights[i][w] = own ? w == 0 : path->weights[i][w];
        }
        if (own)
            dense_add(d, 5, terms, factors, spring);
    }
    rod_add(d, &r);
    dense_add(d, 4, columns[path->count - 1], weights[path->count - 1], stretch);
    for (int w = 0; w < 4; w++)
        for (int axis = 0; axis < 3; axis++)
            d->load[columns[path->count - 1][w] + axis] += weights[path->count - 1][w] * stretch * pull * (axis + 1);
    return d;
}

/* ---- solves --------------------------------------------------------------------------------------------- */

static const sb_precond_kind all_kinds[] = {SB_PRECOND_IC0,  SB_PRECOND_SSOR,     SB_PRECOND_BLOCK_JACOBI,
                                            SB_PRECOND_FSAI, SB_PRECOND_CHOLESKY, SB_PRECOND_MULTIGRID,
                                            SB_PRECOND_NONE};
enum { KINDS = 7 };

typedef struct solver {
    sb_preconditioner *precond;
    sb_pcg_workspace workspace;
    sb_pcg_options options;
    sbi_guests guests;
    sb_pcg_info info;
} solver;

static solver solver_make(beam *b, sb_precond_kind kind, const sbi_guest *const *list, int count, double tolerance)
{
    solver s;
    sb_preconditioner_def def = sb_default_preconditioner_def();
    sb_error error;
    memset(&s, 0, sizeof s);
    def.kind = kind;
    def.positions = b->positions;
    s.options = sb_default_pcg_options();
    s.options.tolerance = tolerance;
    s.options.max_iterations = 3000;
    s.guests.list = list;
    s.guests.count = count;
    CHECK_OK(sb_pcg_workspace_create(b->nodes, NULL, &s.workspace, &error));
    CHECK_OK(sb_preconditioner_create(&def, &b->a, NULL, &s.precond, &error));
    CHECK_OK(sbi_pcg_reserve_guests(&s.workspace, &b->a, &s.guests, &error));
    CHECK_OK(sbi_pcg_update_preconditioner(s.precond, &b->a, b->positions, &s.guests, &s.workspace, &error));
    return s;
}

static sb_result solver_run(solver *s, beam *b)
{
    return sbi_pcg_solve_guests(&b->a, s->precond, b->rhs, b->x, &s->guests, &s->options, &s->workspace, NULL,
                                &s->info);
}

static void solver_free(solver *s)
{
    sb_preconditioner_free(s->precond);
    sb_pcg_workspace_free(&s->workspace);
}

/* The joint system, dense: nodes, then the unknowns of each guest. Prescribed components keep their equation. */
static double *joint_solution(const beam *b, dense_guest *const *guests, int count)
{
    int n = b->n, at = b->n;
    double *m, *rhs, *x;
    for (int g = 0; g < count; g++)
        n += guests[g]->guest.unknown_count;
    m = (double *)calloc((size_t)n * (size_t)n, sizeof(double));
    rhs = (double *)calloc((size_t)n, sizeof(double));
    x = (double *)calloc((size_t)n, sizeof(double));
    for (int i = 0; i < b->nodes; i++)
        for (int q = b->a.row_start[i]; q < b->a.row_end[i]; q++)
            for (int c = 0; c < 9; c++)
                m[(3 * i + c / 3) * n + 3 * b->a.columns[q] + c % 3] = (double)b->a.blocks[q][c];
    for (int i = 0; i < b->n; i++)
        rhs[i] = (double)b->rhs[i];
    for (int g = 0; g < count; g++) {
        const dense_guest *d = guests[g];
        int *place = (int *)malloc(sizeof(int) * (size_t)d->width);
        for (int i = 0; i < d->width; i++) {
            int k = i - d->guest.unknown_count;
            place[i] = k < 0 ? at + i : 3 * d->nodes[k / 3] + k % 3;
        }
        for (int i = 0; i < d->width; i++) {
            if (place[i] < b->n && (b->a.fixed[place[i] / 3] >> place[i] % 3 & 1))
                continue;
            rhs[place[i]] += d->load[i];
            for (int k = 0; k < d->width; k++) {
                if (place[k] < b->n && (b->a.fixed[place[k] / 3] >> place[k] % 3 & 1))
                    rhs[place[i]] -= d->g[i * d->width + k] * (double)b->rhs[place[k]] / m[place[k] * n + place[k]];
                else
                    m[place[i] * n + place[k]] += d->g[i * d->width + k];
            }
        }
        at += d->guest.unknown_count;
        free(place);
    }
    CHECK(dense_factor(m, n));
    dense_solve(m, n, rhs, x);
    free(m);
    free(rhs);
    return x;
}

static void check_joint(const beam *b, dense_guest *const *guests, int count, const double *exact, double tolerance)
{
    double size = 0, off = 0;
    const double *own = exact + b->n;
    for (int i = 0; i < b->n; i++) {
        size = fabs(exact[i]) > size ? fabs(exact[i]) : size;
        off = fabs(exact[i] - (double)b->x[i]) > off ? fabs(exact[i] - (double)b->x[i]) : off;
    }
    for (int g = 0; g < count; g++)
        for (int k = 0; k < guests[g]->guest.unknown_count; k++, own++)
            off = fabs(*own - guests[g]->unknown[k]) > off ? fabs(*own - guests[g]->unknown[k]) : off;
    CHECK_NEAR(off / size, 0, tolerance);
}

/* Two springs between nodes far apart, as contact between organs: no unknowns, no nodes taken. */
static dense_guest *springs_make(int a, int b, int c, double stiffness)
{
    const int nodes[3] = {a, b, c}, first[2] = {0, 3}, second[2] = {3, 6};
    const double factors[2] = {1, -1};
    dense_guest *d = dense_make(0, 3, nodes, 0);
    dense_add(d, 2, first, factors, stiffness);
    dense_add(d, 2, second, factors, stiffness);
    d->load[1] = stiffness * 1e-3;
    d->load[4] = -stiffness * 1e-3;
    return d;
}

/* A rod with unknowns, one without, springs, a prescribed component among a rod's nodes, any start. */
static void test_joint_solution(void)
{
    const int n[3] = {7, 3, 3};
    const double tight = SB_REAL_IS_FLOAT ? 2e-4 : 1e-12;
    for (int k = 0; k < KINDS; k++) {
        beam b = beam_make(n[0], n[1], n[2], 1, 0);
        rod_path path = path_make(n, 0), line = path_make(n, 1);
        double scale = 8e3, *exact;
        unsigned long long seed = 5;
        dense_guest *guests[3];
        const sbi_guest *list[3];
        solver s;
        sb_real *held = (sb_real *)calloc((size_t)b.n, sizeof(sb_real));
        for (int i = 0; i < 16; i++) /* x = 0 clamped, and more */
            b.mask[i] = SB_XYZ;
        b.mask[path.nodes[5]] |= SB_Y;
        held[3 * path.nodes[5] + 1] = (sb_real)1e-4;
        sb_matrix_constrain(&b.a, b.mask, held, b.rhs);
        for (int i = 0; i < line.node_count; i++) /* nodes are taken once */
            line.nodes[i] -= 1;
        for (int i = 0; i < path.node_count; i++)
            for (int j = 0; j < line.node_count; j++)
                if (path.nodes[i] == line.nodes[j])
                    line.nodes[j] = 16 + j;
        guests[0] = rod_make(&path, 1e5 * scale, 100 * scale, 100 * scale, 1e-3);
        guests[1] = rod_make(&line, 10 * scale, scale, 0, -1e-3);
        guests[2] = springs_make(40, 100, 127, 3 * scale);
        guests[1]->guest.taken_count = 0; /* soft enough */
        guests[1]->guest.precondition = NULL;
        guests[1]->size = 0;
        for (int g = 0; g < 3; g++) {
            list[g] = &guests[g]->guest;
            CHECK(dense_factor_block(guests[g], &b.a));
        }
        exact = joint_solution(&b, guests, 3);
        s = solver_make(&b, all_kinds[k], list, 3, tight);
        for (int round = 0; round < 2; round++) { /* from rest, from anywhere */
            for (int i = 0; round && i < b.n; i++)
                b.x[i] = (sb_real)check_random_in(&seed, -1e-3, 1e-3);
            for (int i = 0; i < guests[0]->guest.unknown_count; i++)
                guests[0]->unknown[i] = round ? check_random_in(&seed, -1e-3, 1e-3) : 0;
            CHECK_OK(solver_run(&s, &b));
            check_joint(&b, guests, 3, exact, SB_REAL_IS_FLOAT ? 1e-2 : 1e-8);
        }
        solver_free(&s);
        for (int g = 0; g < 3; g++)
            dense_free(guests[g]);
        free(held);
        free(exact);
        beam_free(&b);
    }
}

/* Takes the coarse space's part out of the residual r, own [d->size] where solves do: r -= (A + G) M r. */
static void deflate(sbi_guest_space *space, sb_preconditioner *precond, const beam *b, const dense_guest *d, sb_real *r,
                    double *own)
{
    sbi_guest_work *work = space->work;
    sb_real *z = (sb_real *)calloc((size_t)b->n, sizeof(sb_real)),
            *q = (sb_real *)calloc((size_t)b->n, sizeof(sb_real));
    memcpy(work->residual, own, sizeof(double) * (size_t)d->size);
    sbi_guest_measure(space);
    sbi_guest_precondition(space, precond, r, z, 10);
    sbi_guest_direct(work, 0, 1);
    sb_matrix_multiply(&b->a, z, q, NULL);
    sbi_guest_multiply(space, z, q);
    for (int i = 0; i < b->n && sbi_guest_is_deflated(space, precond); i++)
        r[i] -= q[i];
    for (int i = 0; i < d->size && sbi_guest_is_deflated(space, precond); i++)
        own[i] -= work->product[i];
    free(z);
    free(q);
}

/* u.Mv = v.Mu and u.Mu > 0 over nodes and unknowns, of what the coarse space leaves. */
static void test_preconditioner_is_symmetric(void)
{
    const int n[3] = {7, 3, 3};
    for (int k = 0; k < KINDS; k++) {
        beam b = beam_make(n[0], n[1], n[2], 1, 1);
        rod_path path = path_make(n, 0);
        dense_guest *d = rod_make(&path, 8e8, 8e5, 8e5, 1e-3);
        const sbi_guest *list[1] = {&d->guest};
        sb_real *z = (sb_real *)calloc((size_t)b.n, sizeof(sb_real)), *r[2];
        double *own[2], mine[2][2] = {{0, 0}, {0, 0}};
        unsigned long long seed = 3;
        sbi_guest_space *space;
        solver s;
        for (int i = 0; i < d->size; i += 7) /* a block that is only near */
            d->g[i * d->width + i] += 8e3;
        CHECK(dense_factor_block(d, &b.a));
        for (int i = 0; i < d->size; i += 7)
            d->g[i * d->width + i] -= 8e3;
        s = solver_make(&b, all_kinds[k], list, 1, 1e-6);
        space = sbi_pcg_guests(&s.workspace);
        space->matrix = &b.a;
        space->scale = 8e3;
        for (int v = 0; v < 2; v++) {
            r[v] = (sb_real *)calloc((size_t)b.n, sizeof(sb_real));
            own[v] = (double *)calloc((size_t)d->size, sizeof(double));
            for (int i = 0; i < b.n; i++)
                r[v][i] = b.mask[i / 3] ? 0 : (sb_real)check_random_in(&seed, -1, 1);
            for (int i = 0; i < d->size; i++)
                own[v][i] = check_random_in(&seed, -1, 1);
            for (int i = 0; i < path.node_count; i++)
                for (int axis = 0; axis < 3; axis++) {
                    r[v][3 * path.nodes[i] + axis] = 0;
                    if (b.mask[path.nodes[i]])
                        own[v][d->guest.unknown_count + 3 * i + axis] = 0;
                }
            deflate(space, s.precond, &b, d, r[v], own[v]);
        }
        for (int v = 0; v < 2; v++) {
            memcpy(space->work->residual, own[v], sizeof(double) * (size_t)d->size);
            sbi_guest_measure(space);
            sbi_guest_precondition(space, s.precond, r[v], z, 10);
            for (int w = 0; w < 2; w++) {
                for (int i = 0; i < b.n; i++)
                    mine[v][w] += (double)(r[w][i] * z[i]);
                for (int i = 0; i < d->size; i++)
                    mine[v][w] += own[w][i] * space->work->correction[i];
            }
        }
        CHECK(mine[0][0] > 0 && mine[1][1] > 0);
        CHECK_NEAR(mine[0][1], mine[1][0], (SB_REAL_IS_FLOAT ? 1e-4 : 2e-6) * sqrt(mine[0][0] * mine[1][1]));
        for (int v = 0; v < 2; v++)
            free(r[v]), free(own[v]);
        free(z);
        solver_free(&s);
        dense_free(d);
        beam_free(&b);
    }
}

/* A rod a million times stiffer than the tissue of 13,200 tets: no more than 1.3 times the iterations of the tissue
 * alone, on nodes of the mesh, through weights, and hanging on springs. */
static void test_iterations(void)
{
    const int n[3] = {22, 10, 10};
    const double scale = 8e3;
    for (int k = check_quick() ? 3 : 0; k < 5; k++) {
        beam b = beam_make(n[0], n[1], n[2], 1, 1);
        solver alone = solver_make(&b, all_kinds[k == 4 ? 5 : k], NULL, 0, SB_REAL_IS_FLOAT ? 1e-3 : 1e-4);
        sb_pcg_info info;
        CHECK_OK(sbi_pcg_solve_current(&b.a, alone.precond, b.rhs, b.x, &alone.options, &alone.workspace, &info));
        for (int form = 0; form < 3; form++) {
            rod_path path = path_make(n, form == 0);
            dense_guest *d = rod_make(&path, 1e6 * scale, 1e3 * scale, form == 2 ? 100 * scale : 0, 1e-3);
            const sbi_guest *list[1] = {&d->guest};
            solver s;
            CHECK(dense_factor_block(d, &b.a));
            memset(b.x, 0, sizeof(sb_real) * (size_t)b.n);
            s = solver_make(&b, all_kinds[k == 4 ? 5 : k], list, 1, alone.options.tolerance);
            CHECK_OK(solver_run(&s, &b));
            CHECK(s.info.iterations <= 1.34 * info.iterations); /* 12 for 9 with multigrid */
            solver_free(&s);
            dense_free(d);
        }
        solver_free(&alone);
        beam_free(&b);
    }
}

/* Same bits for any number of threads. */
static void test_threads(void)
{
    const int n[3] = {15, 5, 5}, workers[3] = {1, 2, 5};
    for (int k = 0; k < KINDS; k++) {
        beam b = beam_make(n[0], n[1], n[2], 1, 1);
        rod_path path = path_make(n, 0);
        dense_guest *guests[2];
        const sbi_guest *list[2];
        sb_real *first = (sb_real *)malloc(sizeof(sb_real) * (size_t)b.n);
        double own[3 * ROD_NODES];
        guests[0] = rod_make(&path, 8e9, 8e6, 8e5, 1e-3);
        guests[1] = springs_make(100, 300, 500, 8e3);
        for (int g = 0; g < 2; g++) {
            list[g] = &guests[g]->guest;
            CHECK(dense_factor_block(guests[g], &b.a));
        }
        for (int w = 0; w < 3; w++) {
            int count = workers[w];
            sb_jobs jobs = scene_jobs(&count);
            solver s = solver_make(&b, all_kinds[k], list, 2, 1e-3);
            s.options.jobs = &jobs;
            memset(b.x, 0, sizeof(sb_real) * (size_t)b.n);
            memset(guests[0]->unknown, 0, sizeof own);
            CHECK_OK(solver_run(&s, &b));
            if (w == 0) {
                memcpy(first, b.x, sizeof(sb_real) * (size_t)b.n);
                memcpy(own, guests[0]->unknown, sizeof own);
            }
            CHECK(memcmp(first, b.x, sizeof(sb_real) * (size_t)b.n) == 0);
            CHECK(memcmp(own, guests[0]->unknown, sizeof own) == 0);
            solver_free(&s);
        }
        dense_free(guests[0]);
        dense_free(guests[1]);
        free(first);
        beam_free(&b);
    }
}

/* ---- parts ---------------------------------------------------------------------------------------------- */

/* Three chains of tets that share no node; rhs of the second and third are a millionth. */
static beam islands_make(void)
{
    static const double corners[5][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 1}};
    int cells[6][4];
    beam b;
    memset(&b, 0, sizeof b);
    b.nodes = 15;
    b.n = 45;
    b.positions = (sb_vec3 *)malloc(sizeof(sb_vec3) * 15);
    b.mask = (unsigned char *)calloc(15, 1);
    b.rhs = (sb_real *)calloc(45, sizeof(sb_real));
    b.x = (sb_real *)calloc(45, sizeof(sb_real));
    for (int i = 0; i < 15; i++)
        b.positions[i] =
            sb_v3((sb_real)(corners[i % 5][0] + 3 * (i / 5)), (sb_real)corners[i % 5][1], (sb_real)corners[i % 5][2]);
    for (int t = 0; t < 6; t++)
        for (int c = 0; c < 4; c++)
            cells[t][c] = 5 * (t / 2) + c + t % 2;
    CHECK_OK(sb_matrix_create(15, 6, 4, NULL, cells[0], NULL, &b.a, NULL));
    for (int t = 0; t < 6; t++)
        beam_add_tet(&b.a, b.positions, cells[t], 1e3, 1e3, 1, 1e3, b.rhs);
    for (int i = 15; i < 45; i++)
        b.rhs[i] *= (sb_real)1e-6;
    sb_matrix_constrain(&b.a, b.mask, NULL, b.rhs);
    return b;
}

/* A guest on two parts couples them; the third is solved to its own tolerance; one without nodes has a part of its
 * own. */
static void test_parts(void)
{
    for (int joined = 0; joined < 2; joined++) {
        beam b = islands_make();
        dense_guest *guests[2];
        const sbi_guest *list[2];
        const int columns[2] = {0, 3};
        const double factors[2] = {1, -1};
        double *exact;
        solver s;
        guests[0] = springs_make(joined ? 2 : 6, joined ? 7 : 8, joined ? 9 : 7, 500);
        guests[1] = dense_make(6, 0, NULL, 0);
        dense_add(guests[1], 2, columns, factors, 1e9);
        dense_add(guests[1], 1, columns, factors, 1e3);
        guests[1]->load[4] = 1e-3;
        for (int g = 0; g < 2; g++) {
            list[g] = &guests[g]->guest;
            CHECK(dense_factor_block(guests[g], &b.a));
        }
        exact = joint_solution(&b, guests, 2);
        s = solver_make(&b, SB_PRECOND_BLOCK_JACOBI, list, 2, 1e-4);
        CHECK_OK(solver_run(&s, &b));
        check_joint(&b, guests, 2, exact, 1e-3);
        for (int i = 30; i < 45; i++) /* a millionth of the others, and as good */
            CHECK_NEAR(b.x[i], exact[i], 1e-3 * fabs(exact[32]));
        for (int i = 0; i < 6; i++)
            CHECK_NEAR(guests[1]->unknown[i], exact[45 + i], 1e-3 * fabs(exact[49]));
        solver_free(&s);
        dense_free(guests[0]);
        dense_free(guests[1]);
        free(exact);
        beam_free(&b);
    }
}

/* ---- friction states ------------------------------------------------------------------------------------- */

/* A spring to the ground that gives way above its limit (N): until then stiffness, afterwards a force. */
typedef struct brake {
    dense_guest *dense;
    double stiffness, limit;
    int slips, calls;
} brake;

static int brake_settle(void *user, const double *x)
{
    brake *k = (brake *)((dense_guest *)user)->extra;
    int wanted = k->slips || fabs(k->stiffness * x[2]) > k->limit, changed = wanted != k->slips;
    k->calls++;
    if (changed) {
        k->slips = 1;
        k->dense->g[2 * 3 + 2] = 0;
        k->dense->load[2] = x[2] > 0 ? -k->limit : k->limit;
    }
    return changed;
}

static void test_settle(void)
{
    for (int slips = 0; slips < 2; slips++) {
        beam b = beam_make(7, 3, 3, 1, 1);
        const int node = 100;
        dense_guest *d = dense_make(0, 1, &node, 0);
        const sbi_guest *list[1] = {&d->guest};
        brake k = {d, 1e4, slips ? 0.01 : 1e3, 0, 0};
        double *exact;
        solver s;
        d->extra = &k;
        d->guest.settle = brake_settle;
        d->g[2 * 3 + 2] = k.stiffness;
        s = solver_make(&b, SB_PRECOND_IC0, list, 1, SB_REAL_IS_FLOAT ? 1e-4 : 1e-10);
        CHECK_OK(solver_run(&s, &b));
        CHECK_INT(k.slips, slips);
        CHECK_INT(k.calls, 1 + slips);
        exact = joint_solution(&b, &d, 1);
        check_joint(&b, &d, 1, exact, SB_REAL_IS_FLOAT ? 1e-2 : 1e-8);
        free(exact);
        solver_free(&s);
        dense_free(d);
        beam_free(&b);
    }
}

/* ---- failures ------------------------------------------------------------------------------------------- */

/* A NaN that a guest answers at the n-th product leaves x and unknowns as they were given. */
static void test_nan_is_undone(void)
{
    check_bad_numbers();
    for (int at = 0; at < 12; at++) {
        const int n[3] = {7, 3, 3};
        beam b = beam_make(n[0], n[1], n[2], 1, 1);
        rod_path path = path_make(n, 0);
        dense_guest *d = rod_make(&path, 8e9, 8e6, 8e5, 1e-3);
        const sbi_guest *list[1] = {&d->guest};
        solver s;
        CHECK(dense_factor_block(d, &b.a));
        s = solver_make(&b, SB_PRECOND_IC0, list, 1, SB_REAL_IS_FLOAT ? 1e-5 : 1e-9);
        for (int i = 0; i < b.n; i++)
            b.x[i] = b.mask[i / 3] ? 0 : (sb_real)1e-4;
        for (int i = 0; i < d->guest.unknown_count; i++)
            d->unknown[i] = 1e-5 * i;
        d->nan_at = at;
        CHECK_RESULT(solver_run(&s, &b), SB_ERROR_DIVERGED);
        for (int i = 0; i < b.n; i++)
            CHECK(b.x[i] == (b.mask[i / 3] ? 0 : (sb_real)1e-4));
        for (int i = 0; i < d->guest.unknown_count; i++)
            CHECK(d->unknown[i] == 1e-5 * i);
        solver_free(&s);
        dense_free(d);
        beam_free(&b);
    }
}

static void test_refused(void)
{
    beam b = beam_make(3, 2, 2, 1, 1);
    const int twice[3] = {5, 7, 5}, outside[1] = {36}, fine[2] = {5, 7};
    dense_guest *d = dense_make(2, 3, twice, 3), *other = dense_make(0, 1, fine, 1);
    const sbi_guest *list[2] = {&d->guest, &other->guest}, *none[1] = {NULL};
    sbi_guests guests = {list, 2}, empty = {none, 1};
    sb_pcg_workspace w;
    sb_error error;
    CHECK_OK(sb_pcg_workspace_create(b.nodes, NULL, &w, NULL));
    CHECK_RESULT(sbi_pcg_reserve_guests(&w, &b.a, &empty, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sbi_pcg_reserve_guests(&w, &b.a, &guests, &error), SB_ERROR_INDEX);
    CHECK_INT(error.node, 5);
    d->guest.node_count = d->guest.taken_count = 2;
    CHECK_RESULT(sbi_pcg_reserve_guests(&w, &b.a, &guests, &error), SB_ERROR_INDEX); /* both take node 5 */
    CHECK_INT(error.node, 5);
    other->guest.nodes = outside;
    CHECK_RESULT(sbi_pcg_reserve_guests(&w, &b.a, &guests, &error), SB_ERROR_INDEX);
    CHECK_INT(error.node, 36);
    other->guest.nodes = fine;
    other->guest.taken_count = 2;
    CHECK_RESULT(sbi_pcg_reserve_guests(&w, &b.a, &guests, &error), SB_ERROR_ARGUMENT);
    other->guest.taken_count = 0;
    d->guest.precondition = NULL;
    CHECK_RESULT(sbi_pcg_reserve_guests(&w, &b.a, &guests, &error), SB_ERROR_ARGUMENT);
    CHECK(w.guests == NULL);
    CHECK_RESULT(sbi_pcg_solve_guests(&b.a, NULL, b.rhs, b.x, &guests, NULL, &w, NULL, NULL), SB_ERROR_ARGUMENT);
    d->guest.precondition = dense_precondition;
    CHECK_OK(sbi_pcg_reserve_guests(&w, &b.a, &guests, &error));
    d->guest.taken_count = 1; /* another size than was reserved */
    CHECK_RESULT(sbi_pcg_solve_guests(&b.a, NULL, b.rhs, b.x, &guests, NULL, &w, NULL, NULL), SB_ERROR_ARGUMENT);
    sb_pcg_workspace_free(&w);
    dense_free(d);
    dense_free(other);
    beam_free(&b);
}

/* Each allocation fails in turn; after the reserve nothing is allocated. The matrix is the same to the bit. */
static void test_failing_memory(void)
{
    const int n[3] = {7, 3, 3};
    beam b = beam_make(n[0], n[1], n[2], 1, 1);
    rod_path path = path_make(n, 0);
    dense_guest *d = rod_make(&path, 8e9, 8e6, 8e5, 1e-3);
    const sbi_guest *list[1] = {&d->guest};
    sbi_guests guests = {list, 1};
    size_t bytes = sizeof *b.a.blocks * (size_t)b.a.block_count;
    void *before = malloc(bytes);
    int done = 0, failures = 0;
    memcpy(before, b.a.blocks, bytes);
    CHECK(dense_factor_block(d, &b.a));
    for (int at = 0; at < 100 && !done; at++) {
        scene_memory memory;
        sb_allocator allocator = scene_allocator(&memory);
        sb_preconditioner_def def = sb_default_preconditioner_def();
        sb_preconditioner *p = NULL;
        sb_pcg_workspace w;
        sb_error error;
        memset(&memory, 0, sizeof memory);
        memset(&w, 0, sizeof w);
        memory.fail_at = at + 1;
        if (sb_pcg_workspace_create(b.nodes, &allocator, &w, &error) == SB_OK &&
            sbi_pcg_reserve_guests(&w, &b.a, &guests, &error) == SB_OK &&
            sb_preconditioner_create(&def, &b.a, &allocator, &p, &error) == SB_OK) {
            int calls = memory.calls;
            CHECK_OK(sbi_pcg_reserve_guests(&w, &b.a, &guests, &error));
            CHECK_OK(sbi_pcg_update_preconditioner(p, &b.a, b.positions, &guests, &w, &error));
            CHECK_OK(sbi_pcg_solve_guests(&b.a, p, b.rhs, b.x, &guests, NULL, &w, NULL, NULL));
            CHECK_INT(memory.calls, calls);
            done = 1;
        } else {
            CHECK_INT(error.result, SB_ERROR_MEMORY);
            failures++;
        }
        sb_preconditioner_free(p);
        sb_pcg_workspace_free(&w);
        CHECK_INT(memory.live, 0);
    }
    CHECK(done && failures > 5);
    CHECK(memcmp(before, b.a.blocks, bytes) == 0);
    free(before);
    dense_free(d);
    beam_free(&b);
}

CHECK_SUITE(guest, {"joint solution", test_joint_solution},
            {"symmetric preconditioner", test_preconditioner_is_symmetric}, {"iterations", test_iterations},
            {"threads", test_threads}, {"parts", test_parts}, {"settle", test_settle},
            {"NaN is undone", test_nan_is_undone}, {"refused", test_refused}, {"failing memory", test_failing_memory});
