/* What lies below a body whose mesh changes, by itself: a matrix that follows against one made anew, couplings of
 * others, parts, and changes taken back. */
#define SB_SPLIT_BUILD
#include "../src/softbody/body/body_private.h"
#include "../src/softbody/body/live_private.h"
#include "../src/softbody/fem/assembly_batch.h"
#include "../src/softbody/fem/assembly_live.h"
#include "../src/softbody/geometry/embed_follow.h"
#include "../src/softbody/geometry/embed_private.h"
#include "../src/softbody/solve/sparse_live.h"

#include "check.h"
#include "live_mesh.h"
#include "scene.h"

/* ---- helpers ---- */

/* A compact matrix of the cells in use. */
static sb_matrix fresh_matrix(const live_mesh *m, const int *pairs, int pair_count)
{
    int *start = (int *)malloc((size_t)(m->cell_end + pair_count + 1) * sizeof(int)), count = 0, entries = 0;
    int *nodes = (int *)malloc((size_t)(4 * m->cell_end + 2 * pair_count + 1) * sizeof(int));
    sb_matrix matrix;
    start[0] = 0;
    for (int e = 0; e < m->cell_end; e++) {
        if (m->cells[e][0] < 0)
            continue;
        memcpy(nodes + entries, m->cells[e], sizeof m->cells[e]);
        start[++count] = entries += 4;
    }
    for (int k = 0; k < pair_count; k++) {
        memcpy(nodes + entries, pairs + 2 * k, 2 * sizeof(int));
        start[++count] = entries += 2;
    }
    memset(&matrix, 0, sizeof matrix);
    CHECK_OK(sb_matrix_create(m->node_end, count, 0, start, nodes, NULL, &matrix, NULL));
    free(start);
    free(nodes);
    return matrix;
}

static sb_matrix live_matrix(const live_mesh *m, double slack, const sb_allocator *allocator)
{
    sb_matrix matrix = fresh_matrix(m, NULL, 0);
    unsigned char *in_use = (unsigned char *)malloc((size_t)m->node_end);
    for (int i = 0; i < m->node_end; i++)
        in_use[i] = m->births[i] != 0;
    if (allocator)
        matrix.allocator = *allocator;
    CHECK_OK(sbi_matrix_make_live(&matrix, m->cell_end, 4, m->cells[0], NULL, in_use, slack, NULL));
    free(in_use);
    return matrix;
}

/* Same rows, columns, parts; every row in use as the mesh says. */
static void check_same_pattern(const sb_matrix *live, const sb_matrix *fresh, const live_mesh *m)
{
    int wrong = live->row_count != fresh->row_count || live->part_count != fresh->part_count;
    sbi_matrix_list_parts(live);
    for (int i = 0; i < fresh->row_count && !wrong; i++) {
        int length = fresh->row_end[i] - fresh->row_start[i];
        wrong = live->row_end[i] - live->row_start[i] != length || live->part_rows[i] != fresh->part_rows[i] ||
                live->live->in_use[i] != (m->births[i] != 0) ||
                memcmp(live->columns + live->row_start[i], fresh->columns + fresh->row_start[i],
                       (size_t)length * sizeof(int)) != 0;
    }
    for (int c = 0; c <= fresh->part_count && !wrong; c++)
        wrong = live->part_start[c] != fresh->part_start[c];
    CHECK(!wrong);
    CHECK_OK(sbi_matrix_check_live(live, NULL));
}

/* A value that depends on row and column only, symmetric. */
static void fill_by_index(sb_matrix *a)
{
    for (int i = 0; i < a->row_count; i++)
        for (int q = a->row_start[i]; q < a->row_end[i]; q++)
            for (int k = 0; k < 9; k++) {
                int low = sbi_min_int(i, a->columns[q]), high = sbi_max_int(i, a->columns[q]);
                int turned = 3 * (k % 3) + k / 3, at = i < a->columns[q]   ? k
                                                       : i > a->columns[q] ? turned
                                                                           : sbi_min_int(k, turned);
                unsigned long long seed =
                    (unsigned long long)low * 1000003u + (unsigned long long)high * 17u + (unsigned long long)at + 1;
                a->blocks[q][k] = (sb_real)check_random_in(&seed, -1, 1);
            }
}

/* ---- tests ---- */

static void change_matrix(sb_matrix *a, const live_change *c)
{
    CHECK_OK(sbi_matrix_reserve(a, &c->change, NULL, NULL));
    sbi_matrix_follow(a, &c->change);
}

/* x . A x by the upper half of A, whoever adds it up; y = A x. */
static void check_matrix_work(const sb_matrix *a, const sb_real *x, const sb_real *y)
{
    int workers = 3;
    sb_jobs jobs = scene_jobs(&workers);
    double work = sbi_matrix_work(a, x, NULL), shared = sbi_matrix_work(a, x, &jobs), sum = 0, size = 0;
    for (size_t k = 0; k < 3 * (size_t)a->row_count; k++) {
        sum += (double)x[k] * (double)y[k];
        size += fabs((double)x[k] * (double)y[k]);
    }
    CHECK_NEAR(work, sum, 32 * (double)SB_EPSILON * size);
    CHECK(memcmp(&work, &shared, sizeof work) == 0);
}

static void check_product(sb_matrix *live, sb_matrix *fresh)
{
    size_t count = 3 * (size_t)live->row_count;
    sb_real *x = (sb_real *)calloc(3 * count, sizeof(sb_real));
    unsigned long long seed = 7;
    for (size_t k = 0; k < count; k++)
        x[k] = (sb_real)check_random_in(&seed, -1, 1);
    fill_by_index(live);
    fill_by_index(fresh);
    sb_matrix_multiply(live, x, x + count, NULL);
    sb_matrix_multiply(fresh, x, x + 2 * count, NULL);
    CHECK(memcmp(x + count, x + 2 * count, count * sizeof(sb_real)) == 0);
    CHECK(sb_matrix_asymmetry(live) <= 0);
    check_matrix_work(live, x, x + count);
    free(x);
}

/* Random changes of one to five operations, some taken back at once; the pattern is that of a matrix made anew. */
static void test_random_changes(void)
{
    live_mesh m = live_mesh_box(3, 4, 5, 6), before = live_mesh_make(m.node_room, m.cell_room);
    sb_matrix a = live_matrix(&m, 0.1, NULL);
    unsigned long long seed = 11;
    int changes = check_quick() ? 200 : 2000;
    for (int k = 0; k < changes; k++) {
        int operations = 1 + (int)check_random_in(&seed, 0, 4.999);
        live_change c;
        sb_matrix fresh;
        live_mesh_begin(&m);
        live_mesh_copy(&before, &m);
        for (int op = 0; op < operations; op++)
            live_mesh_operate(&m, &seed);
        c = live_mesh_difference(&before, &m, 0);
        change_matrix(&a, &c);
        live_change_free(&c);
        if (k % 3 == 0) {
            c = live_mesh_difference(&m, &before, 1);
            change_matrix(&a, &c);
            live_change_free(&c);
            live_mesh_copy(&m, &before);
        }
        fresh = fresh_matrix(&m, NULL, 0);
        check_same_pattern(&a, &fresh, &m);
        if (k % 50 == 0)
            check_product(&a, &fresh);
        sb_matrix_free(&fresh);
        if (check.failures)
            break;
    }
    sb_matrix_free(&a);
    live_mesh_free(&m);
    live_mesh_free(&before);
}

/* Changes one after the other, then all of them back: the last matrix multiplies as the first did, and while slack
 * lasts no memory is taken. */
static void test_undo(void)
{
    enum { CHANGES = 60 };
    live_mesh m[CHANGES + 1];
    unsigned long long seed = 5;
    sb_matrix a, fresh;
    const void *rows, *pool;
    m[0] = live_mesh_box(4, 4, 4, 8);
    a = live_matrix(&m[0], 3.0, NULL);
    rows = a.live->row_memory;
    pool = a.live->pool_memory;
    for (int k = 0; k < CHANGES; k++) {
        live_change c;
        m[k + 1] = live_mesh_make(m[0].node_room, m[0].cell_room);
        live_mesh_begin(&m[k]);
        live_mesh_copy(&m[k + 1], &m[k]);
        for (int op = 0; op < 4; op++)
            live_mesh_operate(&m[k + 1], &seed);
        c = live_mesh_difference(&m[k], &m[k + 1], 0);
        change_matrix(&a, &c);
        live_change_free(&c);
    }
    for (int k = CHANGES; k-- > 0;) {
        live_change c = live_mesh_difference(&m[k + 1], &m[k], 1);
        change_matrix(&a, &c);
        live_change_free(&c);
    }
    fresh = fresh_matrix(&m[0], NULL, 0);
    check_same_pattern(&a, &fresh, &m[0]);
    check_product(&a, &fresh);
    CHECK(a.live->row_memory == rows && a.live->pool_memory == pool);
    sb_matrix_free(&fresh);
    sb_matrix_free(&a);
    for (int k = 0; k <= CHANGES; k++)
        live_mesh_free(&m[k]);
}

/* What lists hang on a coupling: here a number of its own. */
static int head_of(const sb_matrix *a, int i, int q) { return 1000 * i + a->columns[q]; }

static void set_heads(sb_matrix *a)
{
    for (int i = 0; i < a->row_count; i++)
        for (int q = a->row_start[i]; q < a->row_end[i]; q++)
            a->live->heads[q] = head_of(a, i, q);
}

/* 1 when all places in no row are as they should be. */
static int has_clear_places(const sb_matrix *a)
{
    unsigned char *taken = (unsigned char *)calloc((size_t)a->block_count, 1);
    int clear = 1;
    for (int i = 0; i < a->row_count; i++)
        memset(taken + a->row_start[i], 1, (size_t)(a->row_end[i] - a->row_start[i]));
    for (int q = 0; q < a->block_count; q++)
        clear &= taken[q] || (a->columns[q] == 0 && a->transpose[q] == q && a->live->heads[q] == -1);
    free(taken);
    return clear;
}

/* Rows that have left their places are pushed together before many have; they then lie in order, and couplings that
 * stay keep what hangs on them. */
static void test_scattered(void)
{
    live_mesh m = live_mesh_box(5, 5, 5, 6), before = live_mesh_make(m.node_room, m.cell_room);
    sb_matrix a = live_matrix(&m, 4, NULL);
    unsigned long long seed = 21;
    int packed = 0, most = 0;
    for (int k = 0; k < 60; k++) {
        sb_matrix old = fresh_matrix(&m, NULL, 0), fresh;
        live_change c;
        int lost = 0;
        live_mesh_begin(&m);
        live_mesh_copy(&before, &m);
        for (int op = 0; op < 4; op++)
            live_mesh_operate(&m, &seed);
        set_heads(&a);
        fill_by_index(&a);
        c = live_mesh_difference(&before, &m, 0);
        change_matrix(&a, &c);
        live_change_free(&c);
        fresh = fresh_matrix(&m, NULL, 0);
        check_same_pattern(&a, &fresh, &m);
        for (int i = 0; i < a.row_count; i++)
            for (int q = a.row_start[i]; q < a.row_end[i]; q++) {
                int j = a.columns[q], stays = i < before.node_end && j < before.node_end && m.births[i] &&
                                              m.births[i] == before.births[i] && m.births[j] == before.births[j] &&
                                              sb_matrix_find(&old, i, j) >= 0;
                if (i != j)
                    lost += a.live->heads[q] != (stays ? head_of(&a, i, q) : -1);
            }
        CHECK_INT(lost, 0);
        CHECK(has_clear_places(&a));
        check_product(&a, &fresh);
        most = sbi_max_int(most, a.live->moved_count);
        packed += a.live->repacked;
        for (int i = 1; a.live->repacked && i < a.row_count; i++)
            CHECK_INT(a.row_start[i], a.row_end[i - 1]);
        sb_matrix_free(&fresh);
        sb_matrix_free(&old);
    }
    CHECK(packed > 0 && packed < 20);
    CHECK(most <= a.row_count / 4);
    sb_matrix_free(&a);
    live_mesh_free(&m);
    live_mesh_free(&before);
}

/* Couplings of loads and mappings stay while cells come and go, count each of their own, and go when told. */
static void test_other_couplings(void)
{
    int pairs[6] = {0, 50, 0, 50, 3, 0};
    live_mesh m = live_mesh_box(3, 3, 3, 3);
    sb_matrix a = live_matrix(&m, 0.2, NULL), fresh;
    sbi_matrix_couplings others = {0, NULL, 3, NULL};
    int blocks = sbi_matrix_used_blocks(&a);
    others.made = pairs;
    CHECK_OK(sbi_matrix_reserve(&a, NULL, &others, NULL));
    sbi_matrix_follow(&a, NULL);
    fresh = fresh_matrix(&m, pairs, 3);
    check_same_pattern(&a, &fresh, &m);
    sb_matrix_free(&fresh);
    others.made_count = 0;
    others.gone_count = 1;
    others.gone = pairs;
    CHECK_OK(sbi_matrix_reserve(&a, NULL, &others, NULL));
    sbi_matrix_follow(&a, NULL);
    CHECK(sb_matrix_find(&a, 0, 50) >= 0);
    others.gone = pairs + 2;
    others.gone_count = 2;
    CHECK_OK(sbi_matrix_reserve(&a, NULL, &others, NULL));
    sbi_matrix_follow(&a, NULL);
    CHECK_INT(sb_matrix_find(&a, 0, 50), -1);
    CHECK_INT(sbi_matrix_used_blocks(&a), blocks);
    CHECK_OK(sbi_matrix_check_live(&a, NULL));
    sb_matrix_free(&a);
    live_mesh_free(&m);
}

/* An allocator that fails from a given call on. */
typedef struct failing {
    int calls, limit;
} failing;
static void *failing_alloc(void *user, size_t bytes)
{
    failing *f = (failing *)user;
    return f->calls++ < f->limit ? malloc(bytes) : NULL;
}
static void failing_release(void *user, void *pointer)
{
    (void)user;
    free(pointer);
}

/* Each allocation of a reservation fails in turn: the matrix multiplies as before, and follows once there is memory. */
static void test_no_memory(void)
{
    failing f = {0, 1000};
    sb_allocator allocator;
    live_mesh m = live_mesh_box(2, 2, 2, 6), before = live_mesh_make(m.node_room, m.cell_room);
    unsigned long long seed = 3;
    sb_matrix a, fresh;
    live_change c;
    sb_result result = SB_ERROR_MEMORY;
    int failed = 0;
    allocator.alloc = failing_alloc;
    allocator.release = failing_release;
    allocator.user = &f;
    a = live_matrix(&m, 0, &allocator);
    live_mesh_begin(&m);
    live_mesh_copy(&before, &m);
    for (int op = 0; op < 20; op++)
        live_mesh_operate(&m, &seed);
    c = live_mesh_difference(&before, &m, 0);
    for (int limit = 0; result != SB_OK && limit < 100; limit++) {
        f.calls = 0;
        f.limit = limit > 0; /* what was taken before stays */
        result = sbi_matrix_reserve(&a, &c.change, NULL, NULL);
        if (result == SB_OK)
            break;
        CHECK_INT(result, SB_ERROR_MEMORY);
        failed++;
        fresh = fresh_matrix(&before, NULL, 0);
        check_same_pattern(&a, &fresh, &before);
        check_product(&a, &fresh);
        sb_matrix_free(&fresh);
    }
    CHECK_INT(failed, 4); /* rows, keys, pairs, blocks */
    sbi_matrix_follow(&a, &c.change);
    fresh = fresh_matrix(&m, NULL, 0);
    check_same_pattern(&a, &fresh, &m);
    sb_matrix_free(&fresh);
    live_change_free(&c);
    sb_matrix_free(&a);
    live_mesh_free(&m);
    live_mesh_free(&before);
}

/* A chain of cells is cut in the middle and joined again: parts come apart and meet. */
static void test_parts(void)
{
    live_mesh m = live_mesh_box(1, 1, 6, 2), before = live_mesh_make(m.node_room, m.cell_room);
    sb_matrix a = live_matrix(&m, 0.5, NULL), fresh;
    live_change c;
    CHECK_INT(a.part_count, 1);
    live_mesh_begin(&m);
    live_mesh_copy(&before, &m);
    for (int e = 18; e < 24; e++)
        live_mesh_remove(&m, e);
    for (int back = 0; back < 2; back++) {
        c = back ? live_mesh_difference(&m, &before, 1) : live_mesh_difference(&before, &m, 0);
        change_matrix(&a, &c);
        fresh = fresh_matrix(back ? &before : &m, NULL, 0);
        check_same_pattern(&a, &fresh, back ? &before : &m);
        CHECK_INT(a.part_count, back ? 1 : 2);
        sb_matrix_free(&fresh);
        live_change_free(&c);
    }
    sb_matrix_free(&a);
    live_mesh_free(&m);
    live_mesh_free(&before);
}

/* ---- assemblies ---- */

/* What a body has below it. */
typedef struct rooms {
    sb_domain domain;
    sb_matrix matrix;
    sbi_assembly assembly;
    sb_material materials[2];
    int *cell_material;
    void *memory;
} rooms;

static void rooms_free(rooms *r)
{
    sbi_assembly_free(&r->assembly, NULL);
    sb_matrix_free(&r->matrix);
    sb_domain_free(&r->domain);
    free(r->cell_material);
    free(r->memory);
}

/* The cells in use as a mesh of its own; node_of [node_end] the number that each node has there, or -1. */
static sb_mesh compact_mesh(const live_mesh *m, int *node_of)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    mesh.element_type = SB_TET4;
    mesh.nodes = (sb_vec3 *)malloc((size_t)m->node_end * sizeof *mesh.nodes);
    mesh.elements = (int *)malloc((size_t)m->cell_end * 4 * sizeof(int));
    for (int i = 0; i < m->node_end; i++) {
        node_of[i] = m->births[i] ? mesh.node_count : -1;
        if (m->births[i])
            mesh.nodes[mesh.node_count++] = m->X[i];
    }
    for (int e = 0; e < m->cell_end; e++)
        if (m->cells[e][0] >= 0)
            for (int v = 0; v < 4; v++)
                mesh.elements[4 * mesh.element_count + v] = node_of[m->cells[e][v]], mesh.element_count += v == 3;
    return mesh;
}

static void prepare(rooms *r, int viscous, int model)
{
    sbi_arena arena = {NULL, 0, 0};
    uint64_t *colours = (uint64_t *)malloc((size_t)r->domain.node_count * sizeof *colours);
    r->materials[0] = sb_material_corotated(REAL(5e3), REAL(0.4), 1000);
    r->materials[1] = sb_material_corotated(REAL(2e4), REAL(0.45), 1000);
    if (model == 2)
        r->materials[1] = sb_material_neo_hookean(REAL(2e4), REAL(0.45), 1000);
    if (viscous)
        for (int k = 0; k < 2; k++) {
            r->materials[k].prony_count = 1;
            r->materials[k].prony_g[0] = REAL(0.5);
            r->materials[k].prony_tau[0] = REAL(0.1);
        }
    sbi_assembly_layout(&r->assembly, &r->domain, r->matrix.block_count, 2, &arena);
    r->memory = calloc(arena.used, 1);
    arena.base = (unsigned char *)r->memory;
    arena.used = 0;
    sbi_assembly_layout(&r->assembly, &r->domain, r->matrix.block_count, 2, &arena);
    sbi_assembly_prepare(&r->assembly, &r->matrix, colours);
    if (r->domain.cell_capacity)
        CHECK_OK(sbi_assembly_make_live(&r->assembly, &r->matrix, NULL, NULL));
    if (viscous)
        CHECK_OK(sbi_assembly_reserve_memory(&r->assembly, 1, NULL, NULL));
    sbi_assembly_set_materials(&r->assembly, r->materials, 1 + (model > 0), r->cell_material);
    free(colours);
}

/* Cells are of the first material or, where their slots say so and model is not 0, of the second. */
static int material_of(int slot, int model) { return model > 0 && slot % 3 == 0; }

/* A compact assembly of the cells in use. */
static void rooms_compact(rooms *r, const live_mesh *m, int model)
{
    int *node_of = (int *)malloc((size_t)m->node_end * sizeof(int)), count = 0;
    sb_mesh mesh = compact_mesh(m, node_of);
    memset(r, 0, sizeof *r);
    CHECK_OK(sb_domain_create(&mesh, SB_INTEGRATION_AUTO, 0, NULL, &r->domain, NULL));
    CHECK_OK(sb_matrix_create(mesh.node_count, mesh.element_count, 4, NULL, mesh.elements, NULL, &r->matrix, NULL));
    r->cell_material = (int *)malloc((size_t)m->cell_end * sizeof(int));
    for (int e = 0; e < m->cell_end; e++)
        if (m->cells[e][0] >= 0)
            r->cell_material[count++] = material_of(e, model);
    prepare(r, 0, model);
    free(mesh.nodes);
    free(mesh.elements);
    free(node_of);
}

/* A live assembly of the mesh with its free slots, made at once. */
static void rooms_live(rooms *r, const live_mesh *m, double slack, int viscous, int model)
{
    int *node_of = (int *)malloc((size_t)m->node_end * sizeof(int)), count = 0;
    sb_mesh mesh = compact_mesh(m, node_of);
    memset(r, 0, sizeof *r);
    CHECK_OK(sb_domain_create(&mesh, SB_INTEGRATION_AUTO, 0, NULL, &r->domain, NULL));
    CHECK_OK(sbi_domain_make_live(&r->domain, (int)((1 + slack) * m->cell_end), NULL));
    r->domain.node_count = m->node_end;
    r->domain.cell_count = m->cell_end;
    for (int e = 0; e < m->cell_end; e++)
        count += m->cells[e][0] >= 0;
    for (int e = m->cell_end; e-- > 0;) { /* from the last on: slots are behind the cells that they take */
        sb_real *gradients = r->domain.gradients + 12 * e;
        if (m->cells[e][0] >= 0) {
            memmove(gradients, r->domain.gradients + 12 * --count, 12 * sizeof(sb_real));
            r->domain.weights[e] = r->domain.weights[count];
            memcpy(r->domain.cells + 4 * e, m->cells[e], sizeof m->cells[e]);
        } else {
            memset(gradients, 0, 12 * sizeof(sb_real));
            r->domain.weights[e] = 0;
            memset(r->domain.cells + 4 * e, 0, sizeof m->cells[e]);
        }
    }
    r->matrix = live_matrix(m, slack, NULL);
    r->cell_material = (int *)malloc((size_t)m->cell_room * sizeof(int));
    for (int e = 0; e < m->cell_room; e++)
        r->cell_material[e] = material_of(e, model);
    prepare(r, viscous, model);
    free(mesh.nodes);
    free(mesh.elements);
    free(node_of);
}

static void rooms_change(rooms *r, const live_change *c, const sb_vec3 *X)
{
    CHECK_OK(sbi_domain_reserve(&r->domain, &c->change, NULL));
    CHECK_OK(sbi_matrix_reserve(&r->matrix, &c->change, NULL, NULL));
    CHECK_OK(sbi_assembly_reserve(&r->assembly, &r->matrix, &c->change, NULL));
    sbi_domain_follow(&r->domain, &c->change, X);
    sbi_matrix_follow(&r->matrix, &c->change);
    sbi_assembly_follow(&r->assembly, &r->matrix, &c->change);
}

/* A displacement that depends on place only: a bend with some twist. */
static sb_vec3 displacement(sb_vec3 X)
{
    return sb_v3(X.y * X.z * 4, X.x * X.x * 6 - X.z / 5, X.x * X.y * 3 + X.y / 9);
}

static sb_vec3 *displacements(const live_mesh *m)
{
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)m->node_end, sizeof *u);
    for (int i = 0; i < m->node_end; i++)
        if (m->births[i])
            u[i] = displacement(m->X[i]);
    return u;
}

/* Blocks of the tangent to the last bit, forces nearly: the order of their sums depends on slots. */
static void check_same_as_compact(rooms *live, const live_mesh *m, int model)
{
    rooms compact;
    int *node_of = (int *)malloc((size_t)m->node_end * sizeof(int)), wrong = 0;
    sb_mesh mesh = compact_mesh(m, node_of);
    sb_vec3 *u = displacements(m), *v = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *v);
    sb_vec3 *f = (sb_vec3 *)malloc((size_t)m->node_end * sizeof *f),
            *g = (sb_vec3 *)malloc((size_t)m->node_end * sizeof *g);
    sb_real largest = 0, error = 0, energies[2];
    sb_tangent_kind kind = model == 2 ? SB_TANGENT_EXACT : SB_TANGENT_QUASI;
    rooms_compact(&compact, m, model);
    for (int i = 0; i < mesh.node_count; i++)
        v[i] = displacement(mesh.nodes[i]);
    sbi_assembly_reset_rotations(&live->assembly);
    CHECK_INT(sbi_assembly_force(&live->assembly, u, f), -1);
    CHECK_INT(sbi_assembly_force(&compact.assembly, v, g), -1);
    CHECK_INT(sbi_assembly_tangent(&live->assembly, u, kind, 1, &live->matrix), -1);
    CHECK_INT(sbi_assembly_tangent(&compact.assembly, v, kind, 1, &compact.matrix), -1);
    sbi_assembly_energy(&live->assembly, u, energies);
    sbi_assembly_energy(&compact.assembly, v, energies + 1);
    CHECK_NEAR(energies[0], energies[1], 100 * SB_EPSILON * energies[1]);
    CHECK_NEAR(live->assembly.energy_unit, compact.assembly.energy_unit,
               100 * SB_EPSILON * compact.assembly.energy_unit);
    for (int i = 0; i < m->node_end; i++) {
        int j = node_of[i], q = live->matrix.row_start[i], p = j < 0 ? 0 : compact.matrix.row_start[j];
        if (j < 0) {
            wrong += f[i].x != 0 || f[i].y != 0 || f[i].z != 0;
            continue;
        }
        largest = sb_max(largest, sb_v3_norm(g[j]));
        error = sb_max(error, sb_v3_norm(sb_v3_sub(f[i], g[j])));
        for (; q < live->matrix.row_end[i]; q++, p++) {
            if (model == 2) /* colours decide the order */
                for (int k = 0; k < 9; k++)
                    wrong += sb_abs(live->matrix.blocks[q][k] - compact.matrix.blocks[p][k]) >
                             1000 * SB_EPSILON * (sb_abs(compact.matrix.blocks[p][k]) + compact.materials[1].mu / 100);
            else
                wrong += memcmp(live->matrix.blocks[q], compact.matrix.blocks[p], sizeof live->matrix.blocks[q]) != 0;
        }
    }
    CHECK_INT(wrong, 0);
    CHECK(error <= 200 * SB_EPSILON * largest);
    free(mesh.nodes);
    free(mesh.elements);
    free(node_of);
    free(u);
    free(v);
    free(f);
    free(g);
    rooms_free(&compact);
}

/* x . K x is what x does in the product's forces f = K x. */
static void check_work_along(sbi_assembly *assembly, int count, const sb_vec3 *x, const sb_vec3 *f)
{
    double work = 0;
    for (int i = 0; i < count; i++)
        work += (double)sb_v3_dot(x[i], f[i]);
    CHECK(work > 0);
    CHECK_NEAR(sbi_assembly_work_along(assembly, x), work, 1000 * (double)SB_EPSILON * work);
}

/* Forces and a product at once are the sum of both, and forces at rotations that are there have all bits of those that
 * made them. force: of u; product: of x */
static void check_force_along(sbi_assembly *assembly, int count, const sb_vec3 *u, const sb_vec3 *x,
                              const sb_vec3 *force, const sb_vec3 *product)
{
    size_t size = (size_t)count * sizeof(sb_vec3);
    sb_vec3 *at_once = (sb_vec3 *)malloc(2 * size), *again = at_once + count;
    double most = 0, off = 0;
    sbi_assembly_force_along(assembly, u, NULL, 1, at_once);
    CHECK(memcmp(at_once, force, size) == 0);
    sbi_assembly_force_along(assembly, u, x, 1, at_once);
    sbi_assembly_reset_rotations(assembly);
    sbi_assembly_force_along(assembly, u, x, 0, again);
    CHECK(memcmp(at_once, again, size) == 0);
    for (int i = 0; i < count; i++) {
        most = fmax(most, (double)(sb_v3_norm(force[i]) + sb_v3_norm(product[i])));
        off = fmax(off, (double)sb_v3_norm(sb_v3_sub(sb_v3_sub(at_once[i], force[i]), product[i])));
    }
    CHECK(off <= 1000 * (double)SB_EPSILON * most);
    free(at_once);
}

/* All bits of forces, tangent, colours are those of an assembly made at once with the same slots. */
static void check_same_as_fresh(rooms *live, const live_mesh *m, int model)
{
    rooms fresh;
    sb_vec3 *u = displacements(m), *f = (sb_vec3 *)malloc(2 * (size_t)m->node_end * sizeof *f);
    size_t count = (size_t)m->node_end;
    rooms_live(&fresh, m, 0, 0, model);
    sbi_assembly_reset_rotations(&live->assembly);
    sbi_assembly_force(&live->assembly, u, f);
    sbi_assembly_force(&fresh.assembly, u, f + count);
    CHECK(memcmp(f, f + count, count * sizeof *f) == 0);
    CHECK(memcmp(&live->assembly.energy_unit, &fresh.assembly.energy_unit, sizeof(sb_real)) == 0);
    if (live->assembly.batched) {
        CHECK_INT(sbi_assembly_multiply(&live->assembly, u, f), 1);
        check_work_along(&live->assembly, m->node_end, u, f);
        sbi_assembly_multiply(&fresh.assembly, u, f + count);
        CHECK(memcmp(f, f + count, count * sizeof *f) == 0);
        sbi_assembly_reset_rotations(&fresh.assembly);
        sbi_assembly_force(&fresh.assembly, u, f);
        check_force_along(&fresh.assembly, m->node_end, u, u, f, f + count);
    }
    sbi_assembly_tangent(&live->assembly, u, SB_TANGENT_QUASI, 1, &live->matrix);
    sbi_assembly_tangent(&fresh.assembly, u, SB_TANGENT_QUASI, 1, &fresh.matrix);
    sb_matrix_multiply(&live->matrix, &u->x, &f->x, NULL);
    sb_matrix_multiply(&fresh.matrix, &u->x, &f[count].x, NULL);
    CHECK(memcmp(f, f + count, count * sizeof *f) == 0);
    free(u);
    free(f);
    rooms_free(&fresh);
}

/* Random changes, some taken back; model 0: one corotated material, 1: two, 2: one corotated, one neo-Hookean. */
static void check_assembly(int model)
{
    live_mesh m = live_mesh_box(3, 3, 4, 3), before = live_mesh_make(m.node_room, m.cell_room);
    rooms r;
    unsigned long long seed = 21 + (unsigned long long)model;
    rooms_live(&r, &m, 0.05, 0, model);
    for (int k = 0; k < (check_quick() ? 30 : 150) && !check.failures; k++) {
        live_change c;
        live_mesh_begin(&m);
        live_mesh_copy(&before, &m);
        for (int op = 0; op < 3; op++)
            live_mesh_operate(&m, &seed);
        c = live_mesh_difference(&before, &m, 0);
        rooms_change(&r, &c, m.X);
        live_change_free(&c);
        if (k % 3 == 0) {
            c = live_mesh_difference(&m, &before, 1);
            rooms_change(&r, &c, before.X);
            live_change_free(&c);
            live_mesh_copy(&m, &before);
        }
        check_same_as_compact(&r, &m, model);
        check_same_as_fresh(&r, &m, model);
    }
    rooms_free(&r);
    live_mesh_free(&m);
    live_mesh_free(&before);
}

static void test_assembly(void) { check_assembly(0); }
static void test_assembly_of_two(void) { check_assembly(1); }
static void test_assembly_of_any(void) { check_assembly(2); }

/* ---- preconditioners ---- */

/* Values that depend on row and column only, positive definite. */
static void fill_definite(sb_matrix *a)
{
    fill_by_index(a);
    for (int i = 0; i < a->row_count; i++)
        for (int k = 0; k < 9; k += 4)
            a->blocks[a->diagonal[i]][k] += 40;
}

/* A preconditioner of each kind, made of a matrix that has followed changes, gives the bits of one made of a compact
 * matrix, and refuses the matrix once it has changed again. */
static void test_preconditioners(void)
{
    live_mesh m = live_mesh_box(6, 6, 12, 2), before = live_mesh_make(m.node_room, m.cell_room);
    sb_matrix a = live_matrix(&m, 0.1, NULL), fresh;
    unsigned long long seed = 9;
    sbi_matrix_couplings one = {0, NULL, 1, NULL};
    int pair[2];
    sb_preconditioner *of[8][2];
    sb_real *r;
    live_change c;
    live_mesh_begin(&m);
    live_mesh_copy(&before, &m);
    for (int op = 0; op < 20; op++) /* few enough for rows to stay where they are */
        live_mesh_operate(&m, &seed);
    c = live_mesh_difference(&before, &m, 0);
    change_matrix(&a, &c);
    live_change_free(&c);
    fresh = fresh_matrix(&m, NULL, 0);
    CHECK(a.block_count > fresh.block_count);
    fill_definite(&a);
    fill_definite(&fresh);
    memset(a.fixed, 0, (size_t)a.row_count); /* as in the compact one */
    r = (sb_real *)calloc(9 * (size_t)a.row_count, sizeof(sb_real));
    for (int k = 0; k < 3 * a.row_count; k++)
        r[k] = (sb_real)check_random_in(&seed, -1, 1);
    for (int kind = SB_PRECOND_BLOCK_JACOBI; kind <= SB_PRECOND_MULTIGRID; kind++) {
        sb_preconditioner_def def = sb_default_preconditioner_def();
        def.kind = (sb_precond_kind)kind;
        def.positions = m.X;
        for (int k = 0; k < 2; k++) {
            sb_real *z = r + (1 + k) * 3 * a.row_count;
            CHECK_OK(sb_preconditioner_create(&def, k ? &fresh : &a, NULL, &of[kind][k], NULL));
            CHECK_OK(sb_preconditioner_update(of[kind][k], k ? &fresh : &a, m.X, NULL));
            sb_preconditioner_apply(of[kind][k], r, z);
        }
        CHECK(memcmp(r + 3 * a.row_count, r + 6 * a.row_count, 3 * (size_t)a.row_count * sizeof(sb_real)) == 0);
    }
    CHECK_OK(sbi_matrix_reserve(&a, NULL, NULL, NULL));
    sbi_matrix_follow(&a, NULL); /* as where nodes move: the same pattern */
    for (int kind = SB_PRECOND_BLOCK_JACOBI; kind <= SB_PRECOND_MULTIGRID; kind++)
        CHECK_OK(sb_preconditioner_update(of[kind][0], &a, NULL, NULL));
    for (pair[0] = 0; a.row_end[pair[0]] - a.row_start[pair[0]] == 1; pair[0]++)
        continue;
    pair[1] = a.columns[a.row_end[pair[0]] - 1];
    one.made = pair; /* there already: nothing moves, but it is another pattern all the same */
    CHECK_OK(sbi_matrix_reserve(&a, NULL, &one, NULL));
    sbi_matrix_follow(&a, NULL);
    for (int kind = SB_PRECOND_BLOCK_JACOBI; kind <= SB_PRECOND_MULTIGRID; kind++)
        for (int k = 0; k < 2; k++) {
            CHECK_RESULT(sb_preconditioner_update(of[kind][k], k ? &fresh : &a, NULL, NULL),
                         k ? SB_OK : SB_ERROR_ARGUMENT);
            sb_preconditioner_free(of[kind][k]);
        }
    free(r);
    sb_matrix_free(&a);
    sb_matrix_free(&fresh);
    live_mesh_free(&m);
    live_mesh_free(&before);
}

/* A node a dozen couplings away at most from node i. */
static int near_node(const sb_matrix *a, int i, unsigned long long *seed)
{
    for (int step = 0; step < 12; step++)
        i = a->columns[a->row_start[i] + (int)check_random_in(seed, 0, a->row_end[i] - a->row_start[i] - 0.5)];
    return i;
}

/* Moves some nodes, a little or far, one or many. */
static void move_nodes(sb_vec3 *X, int rows, int round, unsigned long long *seed)
{
    int moved = round % 3 == 0 ? 1 : round % 3 == 1 ? 8 : 60;
    double far = round % 5 == 4 ? 0.5 : round % 2 ? 0.1 : 0.002;
    for (int k = 0; k < moved; k++) {
        sb_vec3 *x = X + (int)check_random_in(seed, 0, rows - 0.5);
        x->x += (sb_real)check_random_in(seed, -far, far);
        x->y += (sb_real)check_random_in(seed, -far, far);
        x->z += (sb_real)check_random_in(seed, -far, far);
    }
}

/* Pieces are a function of mesh and rest shape alone: after nodes have moved in the material a preconditioner that
 * follows gives the bits of one made anew, whether it cut its pieces again or saw that they stay. twins: a node goes
 * into the place of another one, as nodes in the lips of a cut are, and the next time on from there. */
static void check_pieces_that_stay(int pieces, int twins)
{
    live_mesh m = live_mesh_box(8, 8, 16, 2);
    sb_matrix a = live_matrix(&m, 0.1, NULL);
    sb_preconditioner_def def = sb_default_preconditioner_def();
    sb_preconditioner *follows, *anew;
    size_t rows = (size_t)a.row_count;
    sb_real *r = (sb_real *)calloc(9 * rows, sizeof(sb_real));
    unsigned long long seed = 4;
    int rounds = check_quick() ? 10 : 60, node = 0;
    fill_definite(&a);
    for (size_t k = 0; k < 3 * rows; k++)
        r[k] = (sb_real)check_random_in(&seed, -1, 1);
    def.kind = SB_PRECOND_BLOCK_JACOBI;
    def.positions = m.X;
    def.piece_count = pieces;
    CHECK_OK(sb_preconditioner_create(&def, &a, NULL, &follows, NULL));
    for (int round = 0; round < rounds; round++) {
        if (!twins) {
            move_nodes(m.X, a.row_count, round, &seed);
        } else if (round % 2 == 0) {
            node = (int)check_random_in(&seed, 0, (double)rows - 0.5);
            m.X[node] = m.X[near_node(&a, node, &seed)];
        } else {
            m.X[node].x += (sb_real)check_random_in(&seed, -0.002, 0.002);
        }
        sbi_precond_follow(follows, &a, m.X);
        CHECK_OK(sb_preconditioner_create(&def, &a, NULL, &anew, NULL));
        CHECK_OK(sb_preconditioner_update(follows, &a, NULL, NULL));
        CHECK_OK(sb_preconditioner_update(anew, &a, NULL, NULL));
        sb_preconditioner_apply(follows, r, r + 3 * rows);
        sb_preconditioner_apply(anew, r, r + 6 * rows);
        CHECK(memcmp(r + 3 * rows, r + 6 * rows, 3 * rows * sizeof(sb_real)) == 0);
        sb_preconditioner_free(anew);
    }
    sb_preconditioner_free(follows);
    free(r);
    sb_matrix_free(&a);
    live_mesh_free(&m);
}

static void test_pieces_that_stay(void)
{
    check_pieces_that_stay(24, 0);
    check_pieces_that_stay(4, 1);
}

/* ---- bodies are not made anew where they need not be ---- */

typedef struct cut {
    int ends[2], node, cells, cell[64], more[64], corners[64][4];
} cut;

static int has_node(const int *cell, int node)
{
    return cell[0] == node || cell[1] == node || cell[2] == node || cell[3] == node;
}

/* Splits the edge of the first and last node of a cell. */
static sb_result cut_edge(sb_body *body, int e, cut *c, sb_error *error)
{
    const sb_real half[2] = {REAL(0.5), REAL(0.5)};
    const sb_vec3 *X = sb_body_rest_positions(body);
    sb_body_change *change;
    sb_result result = sb_body_change_begin(body, &change, error);
    c->ends[0] = sb_body_cell_nodes(body, e)[0];
    c->ends[1] = sb_body_cell_nodes(body, e)[3];
    c->cells = 0;
    for (int k = 0; k < sb_body_element_count(body); k++) {
        const int *cell = sb_body_cell_nodes(body, k);
        if (!cell || !has_node(cell, c->ends[0]) || !has_node(cell, c->ends[1]) || c->cells == 64)
            continue;
        memcpy(c->corners[c->cells], cell, 4 * sizeof(int));
        c->cell[c->cells++] = k;
    }
    if (result == SB_OK)
        result = sb_body_change_add_node(change, sb_v3_scale(REAL(0.5), sb_v3_add(X[c->ends[0]], X[c->ends[1]])),
                                         c->ends, half, 2, 0, &c->node, error);
    for (int k = 0; k < 2 * c->cells && result == SB_OK; k++) {
        sb_change_cell cell = sb_default_change_cell();
        int nodes[4];
        for (int a = 0; a < 4; a++)
            nodes[a] = c->corners[k / 2][a] == c->ends[k % 2] ? c->node : c->corners[k / 2][a];
        cell.nodes = nodes;
        cell.parent = c->cell[k / 2];
        result = k % 2 ? sb_body_change_add_cell(change, &cell, &c->more[k / 2], error)
                       : sb_body_change_replace_cell(change, c->cell[k / 2], &cell, error);
    }
    if (result == SB_OK)
        result = sb_body_change_commit(change, error);
    if (result != SB_OK)
        sb_body_change_cancel(change);
    return result;
}

static sb_result join_edge(sb_body *body, const cut *c, sb_error *error)
{
    const sb_real half[2] = {REAL(0.5), REAL(0.5)};
    sb_body_change *change;
    sb_result result = sb_body_change_begin(body, &change, error);
    for (int k = c->cells; k-- > 0 && result == SB_OK;)
        result = sb_body_change_remove_cell(change, c->more[k], error);
    for (int k = 0; k < c->cells && result == SB_OK; k++) {
        sb_change_cell cell = sb_default_change_cell();
        cell.nodes = c->corners[k];
        cell.parent = c->cell[k];
        result = sb_body_change_replace_cell(change, c->cell[k], &cell, error);
    }
    if (result == SB_OK)
        result = sb_body_change_remove_node(change, c->node, c->ends, half, 2, error);
    if (result == SB_OK)
        result = sb_body_change_commit(change, error);
    if (result != SB_OK)
        sb_body_change_cancel(change);
    return result;
}

/* The cell in use whose first node is nearest to a place. */
static int cell_at(const sb_body *body, sb_vec3 place)
{
    sb_real least = SB_REAL_MAX;
    int best = -1;
    for (int e = 0; e < sb_body_element_count(body); e++) {
        const int *cell = sb_body_cell_nodes(body, e);
        sb_real away = cell ? sb_v3_norm(sb_v3_sub(sb_body_rest_positions(body)[cell[0]], place)) : SB_REAL_MAX;
        if (away < least)
            least = away, best = e;
    }
    return best;
}

static sb_body *plain_body(sb_mesh *mesh, sb_precond_kind kind)
{
    sb_body_def def = sb_default_body_def();
    *mesh = scene_box(SB_TET4, 6, 4, 4, sb_v3(REAL(0.3), REAL(0.2), REAL(0.2)), 0.1);
    def.mesh = mesh;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    def.slack = REAL(0.3);
    def.preconditioner = kind;
    return scene_body(&def);
}

/* 200 changes as of a needle that goes in and comes out five times, with steps between. */
static void test_in_place(void)
{
    const sb_precond_kind kinds[] = {SB_PRECOND_IC0,       SB_PRECOND_SSOR, SB_PRECOND_BLOCK_JACOBI,
                                     SB_PRECOND_MULTIGRID, SB_PRECOND_FSAI, SB_PRECOND_CHOLESKY};
    cut *cuts = (cut *)malloc(20 * sizeof *cuts);
    for (int k = 0; k < 6; k++) {
        sb_mesh mesh;
        sb_body *body = plain_body(&mesh, kinds[k]);
        unsigned long long seed = 17;
        sb_error error;
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_step(body, REAL(0.005), NULL));
        for (int i = 0; i < 200; i++) {
            int depth = i % 40 < 20 ? i % 40 : 39 - i % 40;
            sb_vec3 tip =
                sb_v3(REAL(0.3) - REAL(0.01) * (sb_real)depth, REAL(check_random_in(&seed, 0.08, 0.12)), REAL(0.1));
            CHECK_OK(i % 40 < 20 ? cut_edge(body, cell_at(body, tip), cuts + depth, &error)
                                 : join_edge(body, cuts + depth, &error));
            CHECK_INT(body->live->rebuilds, 0);
            if (i % 8 == 0)
                CHECK_OK(sb_body_step(body, REAL(0.005), NULL));
        }
        CHECK_OK(sb_body_live_check(body, &error));
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
    free(cuts);
}

/* What is refused is named without a body being made for it. */
static void test_refused_in_place(void)
{
    sb_mesh mesh;
    sb_body *body = plain_body(&mesh, SB_PRECOND_IC0);
    sb_body_change *change;
    sb_change_cell cell = sb_default_change_cell();
    const sb_real half[2] = {REAL(0.5), REAL(0.5)};
    int nodes[4], turned[4], node;
    sb_error error;
    memcpy(nodes, sb_body_cell_nodes(body, 7), sizeof nodes);
    memcpy(turned, nodes, sizeof nodes);
    turned[0] = nodes[1], turned[1] = nodes[0];
    cell.nodes = turned;
    CHECK_OK(sb_body_change_begin(body, &change, &error));
    CHECK_OK(sb_body_change_replace_cell(change, 7, &cell, &error));
    CHECK_RESULT(sb_body_change_commit(change, &error), SB_ERROR_MESH);
    CHECK_INT(error.element, 7);
    CHECK(strstr(error.message, "inverted") != NULL);
    sb_body_change_cancel(change);
    CHECK_OK(sb_body_change_begin(body, &change, &error));
    CHECK_OK(sb_body_change_add_node(change, sb_v3(0, 0, 0), nodes, half, 2, 0, &node, &error));
    CHECK_RESULT(sb_body_change_commit(change, &error), SB_ERROR_MESH);
    CHECK_INT(error.node, node);
    sb_body_change_cancel(change);
    CHECK_OK(sb_body_change_begin(body, &change, &error)); /* all cells of a node, but not the node */
    for (int e = 0; e < sb_body_element_count(body); e++)
        if (has_node(sb_body_cell_nodes(body, e), nodes[0]))
            CHECK_OK(sb_body_change_remove_cell(change, e, &error));
    CHECK_RESULT(sb_body_change_commit(change, &error), SB_ERROR_MESH);
    CHECK_INT(error.node, nodes[0]);
    sb_body_change_cancel(change);
    CHECK_INT(body->live->rebuilds, 0);
    CHECK_OK(sb_body_live_check(body, &error));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- points that follow ---- */

enum { POINTS = 600 };

/* Points in and around a box, or all of them in its first cells, so that their groups are full. */
static sb_embedding *points_in(const live_mesh *m, sb_embedding_kind kind, double share, unsigned long long *seed)
{
    sb_vec3 points[POINTS], end = m->X[m->node_end - 1];
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *e = NULL;
    sbi_embed_slots slots;
    sb_mesh mesh;
    unsigned char *used = (unsigned char *)malloc((size_t)m->cell_end);
    memset(used, 1, (size_t)m->cell_end);
    memset(&mesh, 0, sizeof mesh);
    memset(&slots, 0, sizeof slots);
    mesh.element_type = SB_TET4;
    mesh.node_count = m->node_end;
    mesh.element_count = m->cell_end;
    mesh.nodes = m->X;
    mesh.elements = m->cells[0];
    for (int i = 0; i < POINTS; i++) {
        double low = -0.1 * share, high = 1.1 * share, x[3];
        for (int k = 0; k < 3; k++)
            x[k] = check_random_in(seed, low, high);
        points[i] = sb_v3((sb_real)x[0] * end.x, (sb_real)x[1] * end.y, (sb_real)x[2] * end.z);
    }
    def.mesh = &mesh;
    def.points = points;
    def.point_count = POINTS;
    def.kind = kind;
    CHECK_OK(sb_embedding_create(&def, &e, NULL));
    slots.node_end = m->node_end;
    slots.cell_end = m->cell_end;
    slots.nodes = m->X;
    slots.cells = m->cells[0];
    slots.used = used;
    CHECK_OK(sbi_embed_follower_load(e, &slots, NULL));
    free(used);
    return e;
}

/* Points, and forces at the nodes, in a bent shape. */
static void read_points(sb_embedding *e, const live_mesh *m, sb_vec3 *points, sb_vec3 *forces)
{
    sb_vec3 *x = (sb_vec3 *)calloc((size_t)m->node_end, sizeof *x);
    for (int i = 0; i < m->node_end; i++)
        x[i] = sb_v3(m->X[i].x + 3 * m->X[i].y * m->X[i].z, m->X[i].y - m->X[i].x * m->X[i].x, 2 * m->X[i].z);
    memset(forces, 0, (size_t)m->node_end * sizeof *forces);
    CHECK_OK(sb_embedding_update(e, x, points, NULL, NULL));
    CHECK_OK(sb_embedding_forces(e, x, e->rest, forces, NULL));
    free(x);
}

/* The arrays that followed give the same bits as arrays made of the same places in the same mesh. */
static void check_points(sb_embedding *e, const live_mesh *m)
{
    static sb_vec3 points[2][POINTS];
    size_t size = (size_t)m->node_end * sizeof(sb_vec3);
    sb_vec3 *forces = (sb_vec3 *)malloc(2 * size);
    sbi_embed_arrays followed = e->arrays, made;
    sb_embedding_report report;
    sbi_embed_parts parts;
    memset(&made, 0, sizeof made);
    sbi_embed_fill_report(e, e->follower, &report);
    CHECK(!memcmp(&report, &e->report, sizeof report));
    sbi_embed_fill_parts(e, e->follower, &parts);
    CHECK(sbi_embed_arrays_fill(&e->allocator, &made, &parts, e->order, POINTS));
    read_points(e, m, points[0], forces);
    e->arrays = made;
    read_points(e, m, points[1], forces + m->node_end);
    e->arrays = followed;
    CHECK(!memcmp(points[0], points[1], sizeof points[0]));
    CHECK(!memcmp(forces, forces + m->node_end, size));
    CHECK_INT(followed.touched_used, made.touched_used);
    CHECK_INT(followed.block_used, made.block_used);
    for (int kind = 0; kind < SBI_EMBED_KINDS; kind++)
        CHECK_INT(followed.rows[kind].used, made.rows[kind].used);
    sbi_embed_arrays_free(&e->allocator, &made);
    free(forces);
}

/* Changes at random, some refused and some taken back. */
static void test_points(void)
{
    for (int round = 0; round < 4; round++) {
        unsigned long long seed = 40 + (unsigned long long)round;
        live_mesh m = live_mesh_box(5, 4, 4, 8), before = live_mesh_make(m.node_room, m.cell_room);
        sb_embedding *e = points_in(&m, round % 2 ? SB_EMBED_PLAIN : SB_EMBED_SMOOTH, round == 3 ? 0.1 : 1, &seed);
        for (int k = 0; k < 100 && !check.failures; k++) {
            live_change c;
            sb_vec3 *made;
            live_mesh_begin(&m);
            live_mesh_copy(&before, &m);
            for (int op = 0; op < 1 + k % 4; op++)
                live_mesh_operate(&m, &seed);
            c = live_mesh_difference(&before, &m, 0);
            made = (sb_vec3 *)malloc((size_t)m.node_end * sizeof *made);
            for (int i = 0; i < c.change.made_node_count; i++)
                made[i] = m.X[c.change.made_nodes[i]];
            c.change.made_positions = made;
            CHECK_OK(sbi_embed_follower_reserve(e, &c.change, NULL));
            if (k % 3 == 0) {
                sbi_embed_follower_give_up(e);
                live_mesh_copy(&m, &before);
            } else {
                sbi_embed_follower_follow(e);
            }
            live_change_free(&c);
            free(made);
            check_points(e, &m);
        }
        sb_embedding_destroy(e);
        live_mesh_free(&m);
        live_mesh_free(&before);
    }
}

/* A volume without neighbours finds what one with them does, wherever searches start: which points are inside and how
 * far the others are. Of elements that have a point in common any may be found. */
static void test_bare_search(void)
{
    static const sb_element_type types[3] = {SB_TET4, SB_TET10, SB_HEX8};
    unsigned long long seed = 29;
    for (int t = 0; t < 3; t++) {
        sbi_embed_volume bare, whole;
        sb_vec3 low, high;
        sb_mesh mesh;
        int inside = 0;
        CHECK_OK(sb_mesh_organ(types[t], 6, NULL, &mesh, NULL));
        sb_mesh_bounds(&mesh, &low, &high);
        CHECK_OK(sbi_embed_volume_create(&mesh, SBI_EMBED_BARE, NULL, &bare, NULL));
        CHECK_OK(sbi_embed_volume_create(&mesh, SBI_EMBED_SKIN, NULL, &whole, NULL));
        for (int i = 0; i < 300; i++) {
            double size = (double)sb_v3_norm(sb_v3_sub(high, low)), distance[2];
            int hint = (int)check_random_in(&seed, 0, (double)mesh.element_count - 1);
            sbi_embed_hit hits[2];
            sb_vec3 at = sb_v3((sb_real)check_random_in(&seed, (double)low.x, (double)high.x),
                               (sb_real)check_random_in(&seed, (double)low.y, (double)high.y),
                               (sb_real)check_random_in(&seed, (double)low.z, (double)high.z));
            if (i % 4 == 0) /* in several elements at once */
                at = mesh.nodes[i % mesh.node_count];
            sbi_embed_closest(&bare, at, hint, &hits[0]);
            sbi_embed_closest(&whole, at, hint, &hits[1]);
            for (int k = 0; k < 2; k++) {
                sb_vec3 found = sbi_embed_map(&mesh, hits[k].element, hits[k].xi, NULL);
                distance[k] = (double)sb_v3_norm(sb_v3_sub(found, at));
            }
            CHECK((hits[0].distance2 > 0) == (hits[1].distance2 > 0));
            CHECK_NEAR(distance[0], distance[1], 1e3 * (double)SB_EPSILON * size);
            inside += !(hits[0].distance2 > 0);
        }
        CHECK(inside > 75 && inside < 300);
        sbi_embed_volume_free(&bare);
        sbi_embed_volume_free(&whole);
        sb_mesh_free(&mesh);
    }
}

CHECK_SUITE(live_matrix, {"random changes against a matrix made anew", test_random_changes},
            {"changes taken back", test_undo}, {"scattered rows", test_scattered},
            {"couplings of others", test_other_couplings}, {"changes in place", test_in_place},
            {"refused in place", test_refused_in_place}, {"no memory", test_no_memory},
            {"parts come apart and meet", test_parts}, {"assembly", test_assembly},
            {"assembly of two materials", test_assembly_of_two}, {"assembly of any material", test_assembly_of_any},
            {"preconditioners", test_preconditioners}, {"pieces that stay", test_pieces_that_stay},
            {"points that follow", test_points}, {"searches without neighbours", test_bare_search});
