/* bench_assembly: force, tangent and products of bench_step's beams, bent, with node orders of three kinds.
 *
 * One line per mesh and order, least and median times over 40 rounds of force, tangent, product with the assembled
 * matrix, product without a matrix, one after the other so that none finds the caches as it left them:
 *     name order cells blocks | force tangent product matrix-free (least ms) | the same, median | differ K free
 * differ: largest difference of forces and blocks from the loops that take any material, of the products from each
 * other, each relative to the largest. Times are those of the clock; with one thread, of the thread. Asserts
 * nothing. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "measure.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { ROUNDS = 40, KINDS = 4 };

static int threads = 1;

/* Wall time, or with one thread its processor time, in which other work on the machine counts less (s). */
static double loop_seconds(void)
{
#if defined(CLOCK_THREAD_CPUTIME_ID)
    struct timespec t;
    if (threads == 1) {
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
        return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
    }
#endif
    return now();
}

/* A bend with some twist, another one in each round, so that rotations have something to follow. */
static void bend(const sb_mesh *mesh, int round, sb_vec3 *u)
{
    double angle = 0.3 * sin(0.05 * round) + 0.01 * round;
    for (int i = 0; i < mesh->node_count; i++) {
        double x = (double)mesh->nodes[i].x, y = (double)mesh->nodes[i].y, z = (double)mesh->nodes[i].z;
        double turn = angle * x / 0.2;
        u[i] = sb_v3((sb_real)(-turn * z + 0.01 * turn * y), (sb_real)(0.3 * turn * z + 0.02 * turn * x),
                     (sb_real)(0.05 * turn * turn + 0.1 * turn * y));
    }
}

/* Largest |a - b| over the largest |a|. */
static double difference(const sb_real *a, const sb_real *b, size_t count)
{
    double most = 0, gap = 0;
    for (size_t i = 0; i < count; i++) {
        most = fmax(most, fabs((double)a[i]));
        gap = fmax(gap, fabs((double)a[i] - (double)b[i]));
    }
    return most > 0 ? gap / most : 0;
}

/* Numbers of nodes by the Z-order of their places, elements by their lowest node. */
typedef struct key {
    unsigned long long code;
    int index;
} key;

static int compare_keys(const void *a, const void *b)
{
    const key *x = (const key *)a, *y = (const key *)b;
    return x->code < y->code ? -1 : x->code > y->code ? 1 : x->index - y->index;
}

static unsigned long long interleave(double x, double y, double z)
{
    unsigned long long at[3] = {(unsigned long long)x, (unsigned long long)y, (unsigned long long)z}, code = 0;
    for (int bit = 0; bit < 20; bit++)
        for (int axis = 0; axis < 3; axis++)
            code |= (at[axis] >> bit & 1) << (3 * bit + axis);
    return code;
}

static void order_by_place(sb_mesh *mesh)
{
    int n = sb_element_node_count(mesh->element_type), nodes = mesh->node_count, elements = mesh->element_count;
    key *keys = (key *)malloc((size_t)(nodes > elements ? nodes : elements) * sizeof *keys);
    int *number = (int *)malloc((size_t)nodes * sizeof *number);
    sb_vec3 *old_nodes = (sb_vec3 *)malloc((size_t)nodes * sizeof *old_nodes);
    int *old_elements = (int *)malloc((size_t)elements * (size_t)n * sizeof *old_elements);
    memcpy(old_nodes, mesh->nodes, (size_t)nodes * sizeof *old_nodes);
    for (int i = 0; i < nodes; i++) {
        keys[i].code =
            interleave(2e4 * (double)old_nodes[i].x, 2e4 * (double)old_nodes[i].y, 2e4 * (double)old_nodes[i].z);
        keys[i].index = i;
    }
    qsort(keys, (size_t)nodes, sizeof *keys, compare_keys);
    for (int i = 0; i < nodes; i++) {
        number[keys[i].index] = i;
        mesh->nodes[i] = old_nodes[keys[i].index];
    }
    for (int e = 0; e < elements; e++) {
        keys[e].index = e;
        keys[e].code = (unsigned long long)nodes;
        for (int a = 0; a < n; a++) {
            int node = number[mesh->elements[n * e + a]];
            old_elements[n * e + a] = node;
            keys[e].code = (unsigned long long)node < keys[e].code ? (unsigned long long)node : keys[e].code;
        }
    }
    qsort(keys, (size_t)elements, sizeof *keys, compare_keys);
    for (int e = 0; e < elements; e++)
        memcpy(mesh->elements + n * e, old_elements + n * keys[e].index, (size_t)n * sizeof *old_elements);
    free(keys);
    free(number);
    free(old_nodes);
    free(old_elements);
}

static void print_times(double times[KINDS][ROUNDS], int rank)
{
    for (int k = 0; k < KINDS; k++)
        printf(" %6.2f", 1e3 * times[k][rank]);
}

static void run(const char *name, const char *order, const sb_mesh *mesh)
{
    double times[KINDS][ROUNDS];
    size_t unknowns = 3 * (size_t)mesh->node_count, entries;
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_vec3 *force = (sb_vec3 *)malloc(unknowns * sizeof(sb_real));
    sb_real *blocks;
    def.mesh = mesh;
    def.material = sb_material_corotated(50000, (sb_real)0.45, 1000);
#if defined(SB_USE_OPENMP)
    if (threads > 1)
        def.jobs = sb_jobs_openmp();
#endif
    if (sb_body_create(&def, &body, NULL) != SB_OK)
        return;
    for (int round = 0; round < ROUNDS; round++) {
        double t[KINDS + 1];
        bend(mesh, round, body->displacement);
        t[0] = loop_seconds();
        sbi_assembly_force(&body->assembly, body->displacement, body->internal);
        t[1] = loop_seconds();
        sbi_assembly_tangent(&body->assembly, body->displacement, SB_TANGENT_QUASI, 1, &body->matrix);
        t[2] = loop_seconds();
        sb_matrix_multiply(&body->matrix, &body->displacement[0].x, &body->work[0].x, &body->jobs);
        t[3] = loop_seconds();
        sbi_assembly_multiply(&body->assembly, body->displacement, body->work2);
        t[4] = loop_seconds();
        for (int k = 0; k < KINDS; k++)
            times[k][round] = t[k + 1] - t[k];
    }
    for (int k = 0; k < KINDS; k++)
        qsort(times[k], ROUNDS, sizeof times[k][0], ascending);
    printf("%-15s %-8s %6d %7d |", name, order, mesh->element_count, body->matrix.block_count);
    print_times(times, 0);
    printf(" |");
    print_times(times, ROUNDS / 2);
    entries = 9 * (size_t)body->matrix.block_count;
    blocks = (sb_real *)malloc(entries * sizeof *blocks);
    memcpy(force, body->internal, unknowns * sizeof(sb_real));
    memcpy(blocks, body->matrix.blocks, entries * sizeof *blocks);
    body->assembly.batched = 0;
    sbi_assembly_force(&body->assembly, body->displacement, body->internal);
    sbi_assembly_tangent(&body->assembly, body->displacement, SB_TANGENT_QUASI, 1, &body->matrix);
    printf(" | %.1e %.1e %.1e\n", difference(&force[0].x, &body->internal[0].x, unknowns),
           difference(blocks, body->matrix.blocks[0], entries),
           difference(&body->work[0].x, &body->work2[0].x, unknowns));
    fflush(stdout);
    free(force);
    free(blocks);
    sb_body_destroy(body);
}

static void run_beam(const char *name, sb_element_type type, int nx, int ny, int nz)
{
    static const char *const orders[] = {"as made", "rcm", "place"};
    for (int k = 0; k < 3; k++) {
        sb_mesh mesh;
        memset(&mesh, 0, sizeof mesh);
        if (sb_mesh_beam(type, nx, ny, nz, sb_v3((sb_real)0.2, (sb_real)0.06, (sb_real)0.06), NULL, &mesh, NULL) !=
            SB_OK)
            return;
        if (k == 1)
            sb_mesh_reorder(&mesh, NULL, NULL, NULL);
        if (k == 2)
            order_by_place(&mesh);
        run(name, orders[k], &mesh);
        sb_mesh_free(&mesh);
    }
}

int main(void)
{
    const char *wanted = getenv("OMP_NUM_THREADS");
    threads = wanted && atoi(wanted) > 1 ? atoi(wanted) : 1;
    printf("# name order cells blocks | force tangent product matrix-free (least ms) | median | differ K free\n");
    run_beam("beam_tet4_13k", SB_TET4, 28, 9, 9);
    run_beam("beam_tet4_100k", SB_TET4, 57, 17, 17);
    run_beam("tet10_3k", SB_TET10, 15, 6, 6);
    run_beam("beam_tet10_9k", SB_TET10, 25, 8, 8);
    return 0;
}
