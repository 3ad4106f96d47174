/* bench_change: what a change of the mesh costs below the body: domain, matrix, assembly and preconditioner of a tet4
 * box follow splits of edges and go back. Prints a line per number of cells: cells changed, median and largest
 * microseconds of each room and of all. Then the same of bodies: the calls that put a change together, its commit, and
 * the first step after it beside the second. Asserts nothing. */
#define SB_STATIC
#define SB_ELEMENT SB_TET4
#define SB_IMPLEMENTATION
#include "../../softbody.h"

#include "measure.h"

#include <stdio.h>

#include "../check.h"
#include "../live_mesh.h"

check_state check;

enum { ROOMS = 4, RUNS = 101 };

typedef struct rooms {
    sb_domain domain;
    sb_matrix matrix;
    sbi_assembly assembly;
    sb_material material;
    int *cell_material;
    void *memory;
} rooms;

static void rooms_make(rooms *r, const live_mesh *m)
{
    sbi_arena arena = {NULL, 0, 0};
    uint64_t *colours = (uint64_t *)malloc((size_t)m->node_end * sizeof *colours);
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    memset(r, 0, sizeof *r);
    mesh.element_type = SB_TET4;
    mesh.node_count = m->node_end;
    mesh.element_count = m->cell_end;
    mesh.nodes = m->X;
    mesh.elements = m->cells[0];
    if (sb_domain_create(&mesh, SB_INTEGRATION_AUTO, 0, NULL, &r->domain, NULL) != SB_OK ||
        sbi_domain_make_live(&r->domain, 2 * m->cell_end, NULL) != SB_OK ||
        sb_matrix_create(m->node_end, m->cell_end, 4, NULL, m->cells[0], NULL, &r->matrix, NULL) != SB_OK ||
        sbi_matrix_make_live(&r->matrix, m->cell_end, 4, m->cells[0], NULL, NULL, 1, NULL) != SB_OK)
        exit(1);
    sbi_assembly_layout(&r->assembly, &r->domain, r->matrix.block_count, 1, &arena);
    r->memory = calloc(arena.used, 1);
    arena.base = (unsigned char *)r->memory;
    arena.used = 0;
    sbi_assembly_layout(&r->assembly, &r->domain, r->matrix.block_count, 1, &arena);
    sbi_assembly_prepare(&r->assembly, &r->matrix, colours);
    sbi_assembly_make_live(&r->assembly, &r->matrix, NULL, NULL);
    r->material = sb_material_corotated(5000, (sb_real)0.4, 1000);
    r->cell_material = (int *)calloc((size_t)m->cell_room, sizeof(int));
    sbi_assembly_set_materials(&r->assembly, &r->material, 1, r->cell_material);
    free(colours);
}

static void rooms_free(rooms *r)
{
    sbi_assembly_free(&r->assembly, NULL);
    sb_matrix_free(&r->matrix);
    sb_domain_free(&r->domain);
    free(r->cell_material);
    free(r->memory);
}

/* times [ROOMS] (s): domain, matrix, assembly, all. */
static void rooms_change(rooms *r, const sbi_mesh_change *change, const sb_vec3 *X, double *times)
{
    double t[4];
    t[0] = now();
    if (sbi_domain_reserve(&r->domain, change, NULL) != SB_OK)
        exit(1);
    sbi_domain_follow(&r->domain, change, X);
    t[1] = now();
    if (sbi_matrix_reserve(&r->matrix, change, NULL, NULL) != SB_OK)
        exit(1);
    sbi_matrix_follow(&r->matrix, change);
    t[2] = now();
    if (sbi_assembly_reserve(&r->assembly, &r->matrix, change, NULL) != SB_OK)
        exit(1);
    sbi_assembly_follow(&r->assembly, &r->matrix, change);
    t[3] = now();
    for (int k = 0; k < 3; k++)
        times[k] = t[k + 1] - t[k];
    times[3] = t[3] - t[0];
}

/* Splits edges about a random place until so many cells have changed. */
static void split_edges(live_mesh *m, int cells, unsigned long long *seed)
{
    int first = (int)check_random_in(seed, 0, (double)m->cell_end - 1), end = m->cell_end;
    for (int e = first; m->cell_end - end < cells / 2; e = e + 1 < end ? e + 1 : 0) {
        int edge[2];
        edge[0] = m->cells[e][0];
        edge[1] = m->cells[e][3];
        live_mesh_split(m, edge, 2);
    }
}

static void bench(int nx, int ny, int nz, int cells)
{
    static const char *const names[ROOMS] = {"domain", "matrix", "assembly", "all"};
    static double samples[ROOMS][2 * RUNS];
    live_mesh m = live_mesh_box(nx, ny, nz, 2), before = live_mesh_make(m.node_room, m.cell_room);
    unsigned long long seed = 1;
    int changed = 0;
    rooms r;
    rooms_make(&r, &m);
    for (int run = 0; run < RUNS; run++) {
        live_change there, back;
        double times[2][ROOMS];
        live_mesh_begin(&m);
        live_mesh_copy(&before, &m);
        split_edges(&m, cells, &seed);
        there = live_mesh_difference(&before, &m, 0);
        back = live_mesh_difference(&m, &before, 1);
        rooms_change(&r, &there.change, m.X, times[0]);
        rooms_change(&r, &back.change, before.X, times[1]);
        changed = there.change.made_cell_count;
        for (int k = 0; k < ROOMS; k++)
            for (int way = 0; way < 2; way++)
                samples[k][2 * run + way] = times[way][k];
        live_change_free(&there);
        live_change_free(&back);
        live_mesh_copy(&m, &before);
    }
    printf("change_%dk cells=%d", 6 * nx * ny * nz / 1000, changed);
    for (int k = 0; k < ROOMS; k++) {
        qsort(samples[k], 2 * RUNS, sizeof(double), ascending);
        printf(" %s_us=%.1f/%.1f", names[k], 1e6 * samples[k][RUNS], 1e6 * samples[k][2 * RUNS - 1]);
    }
    printf("\n");
    rooms_free(&r);
    live_mesh_free(&m);
    live_mesh_free(&before);
}

/* ---- on a body ---- */

enum { MOST_SPLITS = 512, MOST_AROUND = 64, BODY_RUNS = 31 };

/* Edges split in one change, each with all its cells, no cell twice. */
typedef struct splits {
    int count, cells;
    int ends[MOST_SPLITS][2], node[MOST_SPLITS], around[MOST_SPLITS];
    int cell[MOST_SPLITS][MOST_AROUND], more[MOST_SPLITS][MOST_AROUND], corners[MOST_SPLITS][MOST_AROUND][4];
} splits;

static int has_both(const int *n, int a, int b)
{
    return (n[0] == a || n[1] == a || n[2] == a || n[3] == a) && (n[0] == b || n[1] == b || n[2] == b || n[3] == b);
}

/* Chooses edges at random places until some `cells` cells change. */
static void choose_splits(const sb_body *body, int cells, unsigned long long *seed, splits *s)
{
    int end = sb_body_element_count(body);
    char *taken = (char *)calloc((size_t)end, 1);
    s->count = s->cells = 0;
    while (s->cells < cells && s->count < MOST_SPLITS) {
        int e = (int)check_random_in(seed, 0, (double)end - 1), n = 0, free_of = 1;
        const int *edge = sb_body_cell_nodes(body, e);
        if (!edge)
            continue;
        for (int c = 0; c < end && free_of; c++) {
            const int *nodes = sb_body_cell_nodes(body, c);
            if (!nodes || !has_both(nodes, edge[0], edge[3]))
                continue;
            free_of = !taken[c] && n < MOST_AROUND;
            if (free_of) {
                memcpy(s->corners[s->count][n], nodes, 4 * sizeof(int));
                s->cell[s->count][n++] = c;
            }
        }
        if (!free_of)
            continue;
        for (int k = 0; k < n; k++)
            taken[s->cell[s->count][k]] = 1;
        s->ends[s->count][0] = edge[0];
        s->ends[s->count][1] = edge[3];
        s->around[s->count++] = n;
        s->cells += n;
    }
    free(taken);
}

static void must(sb_result result)
{
    if (result != SB_OK) {
        printf("failed: %d\n", (int)result);
        exit(1);
    }
}

static sb_body_change *split_all(sb_body *body, splits *s)
{
    const sb_real half[2] = {(sb_real)0.5, (sb_real)0.5};
    sb_body_change *change;
    must(sb_body_change_begin(body, &change, NULL));
    for (int i = 0; i < s->count; i++) {
        const sb_vec3 *X = sb_body_rest_positions(body);
        sb_vec3 x = sb_v3_scale((sb_real)0.5, sb_v3_add(X[s->ends[i][0]], X[s->ends[i][1]]));
        must(sb_body_change_add_node(change, x, s->ends[i], half, 2, 0, &s->node[i], NULL));
        for (int k = 0; k < s->around[i]; k++)
            for (int end = 0; end < 2; end++) {
                sb_change_cell cell = sb_default_change_cell();
                int nodes[4];
                for (int a = 0; a < 4; a++)
                    nodes[a] = s->corners[i][k][a] == s->ends[i][end] ? s->node[i] : s->corners[i][k][a];
                cell.nodes = nodes;
                cell.parent = s->cell[i][k];
                must(end == 0 ? sb_body_change_replace_cell(change, s->cell[i][k], &cell, NULL)
                              : sb_body_change_add_cell(change, &cell, &s->more[i][k], NULL));
            }
    }
    return change;
}

static sb_body_change *join_all(sb_body *body, const splits *s)
{
    const sb_real half[2] = {(sb_real)0.5, (sb_real)0.5};
    sb_body_change *change;
    must(sb_body_change_begin(body, &change, NULL));
    for (int i = s->count; i-- > 0;) {
        for (int k = s->around[i]; k-- > 0;)
            must(sb_body_change_remove_cell(change, s->more[i][k], NULL));
        for (int k = 0; k < s->around[i]; k++) {
            sb_change_cell cell = sb_default_change_cell();
            cell.nodes = s->corners[i][k];
            cell.parent = s->cell[i][k];
            must(sb_body_change_replace_cell(change, s->cell[i][k], &cell, NULL));
        }
        must(sb_body_change_remove_node(change, s->node[i], s->ends[i], half, 2, NULL));
    }
    return change;
}

/* So many points at random in the mesh's box, which follow the body; NULL for none. */
static sb_embedding *follow_points(const sb_mesh *mesh, sb_body *body, int count, unsigned long long *seed)
{
    sb_vec3 *points = (sb_vec3 *)malloc((size_t)count * sizeof *points), low, high;
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_mesh_bounds(mesh, &low, &high);
    for (int i = 0; i < count; i++)
        points[i] = sb_v3((sb_real)check_random_in(seed, (double)low.x, (double)high.x),
                          (sb_real)check_random_in(seed, (double)low.y, (double)high.y),
                          (sb_real)check_random_in(seed, (double)low.z, (double)high.z));
    def.mesh = mesh;
    def.points = points;
    def.point_count = count;
    if (count > 0) {
        must(sb_embedding_create(&def, &embedding, NULL));
        must(sb_embedding_follow(embedding, body, NULL));
    }
    free(points);
    return embedding;
}

/* Commits there and back, the calls before them, and the first step after a change against the second; with so many
 * points that follow. */
static void bench_body(int nx, int ny, int nz, int cells, sb_precond_kind kind, int points)
{
    static splits s;
    static double commits[2 * BODY_RUNS], calls[2 * BODY_RUNS], first[2 * BODY_RUNS], second[2 * BODY_RUNS];
    live_mesh m = live_mesh_box(nx, ny, nz, 1);
    unsigned long long seed = 3;
    sb_body_def def = sb_default_body_def();
    sb_mesh mesh;
    sb_body *body;
    sb_embedding *embedding;
    int changed = 0, samples = 0;
    double middle;
    memset(&mesh, 0, sizeof mesh);
    mesh.element_type = SB_TET4;
    mesh.node_count = m.node_end;
    mesh.element_count = m.cell_end;
    mesh.nodes = m.X;
    mesh.elements = m.cells[0];
    def.mesh = &mesh;
    def.material = sb_material_corotated(5000, (sb_real)0.4, 1000);
    def.gravity = sb_v3(0, 0, (sb_real)-9.81);
    def.slack = (sb_real)0.5;
    def.preconditioner = kind;
    must(sb_body_create(&def, &body, NULL));
    for (int i = 0; i < m.node_end; i++)
        if (m.X[i].x < (sb_real)1e-6)
            must(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
    must(sb_body_step(body, (sb_real)0.01, NULL));
    embedding = follow_points(&mesh, body, points, &seed);
    for (int run = 0; run < BODY_RUNS; run++)
        for (int way = 0; way < 2; way++, samples++) {
            sb_body_change *change;
            double t[5];
            if (way == 0)
                choose_splits(body, cells, &seed, &s);
            t[0] = now();
            change = way == 0 ? split_all(body, &s) : join_all(body, &s);
            t[1] = now();
            must(sb_body_change_commit(change, NULL));
            t[2] = now();
            must(sb_body_step(body, (sb_real)0.01, NULL));
            t[3] = now();
            must(sb_body_step(body, (sb_real)0.01, NULL));
            t[4] = now();
            calls[samples] = t[1] - t[0];
            commits[samples] = t[2] - t[1];
            first[samples] = t[3] - t[2];
            second[samples] = t[4] - t[3];
            changed = s.cells;
        }
    middle = median(commits, samples);
    printf("commit_%dk cells=%d %s points=%d calls_us=%.1f commit_us=%.1f (least %.1f) first_step_us=%.0f "
           "second_step_us=%.0f\n",
           6 * nx * ny * nz / 1000, changed, sb_precond_string(sb_body_solver(body).kind), points,
           1e6 * median(calls, samples), 1e6 * middle, 1e6 * commits[0], 1e6 * median(first, samples),
           1e6 * median(second, samples));
    sb_embedding_destroy(embedding);
    sb_body_destroy(body);
    live_mesh_free(&m);
}

int main(void)
{
    bench(28, 9, 9, 20);
    bench(28, 9, 9, 200);
    bench(56, 18, 17, 20);
    bench_body(28, 9, 9, 20, SB_PRECOND_AUTO, 0);
    bench_body(28, 9, 9, 200, SB_PRECOND_AUTO, 0);
    bench_body(28, 9, 9, 2000, SB_PRECOND_AUTO, 0);
    bench_body(28, 9, 9, 20, SB_PRECOND_MULTIGRID, 0);
    bench_body(28, 9, 9, 20, SB_PRECOND_AUTO, 10000);
    return 0;
}
