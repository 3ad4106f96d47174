/* bench_change: what a change of the mesh costs below the body: domain, matrix, assembly and preconditioner of a tet4 box
 * follow splits of edges and go back. Prints a line per number of cells: cells changed, median and largest microseconds of
 * each room and of all. Asserts nothing. */
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
    sbi_assembly_free_memory(&r->assembly, NULL);
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
    sbi_matrix_follow(&r->matrix, change, NULL);
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

int main(void)
{
    bench(28, 9, 9, 20);
    bench(28, 9, 9, 200);
    bench(56, 18, 17, 20);
    return 0;
}
