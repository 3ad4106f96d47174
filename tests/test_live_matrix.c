/* What lies below a body whose mesh changes, by itself: a matrix that follows against one made anew, couplings of others,
 * parts, and changes taken back. */
#define SB_STATIC
#define SB_ELEMENT SB_TET4
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "check.h"
#include "live_mesh.h"

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
                int turned = 3 * (k % 3) + k / 3, at = i < a->columns[q] ? k : i > a->columns[q] ? turned : sbi_min_int(k, turned);
                unsigned long long seed = (unsigned long long)low * 1000003u + (unsigned long long)high * 17u +
                                          (unsigned long long)at + 1;
                a->blocks[q][k] = (sb_real)check_random_in(&seed, -1, 1);
            }
}

/* ---- tests ---- */

static void change_matrix(sb_matrix *a, const live_change *c)
{
    CHECK_OK(sbi_matrix_reserve(a, &c->change, NULL, NULL));
    sbi_matrix_follow(a, &c->change, NULL);
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

/* Changes one after the other, then all of them back: the last matrix multiplies as the first did, and while slack lasts
 * no memory is taken. */
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
    sbi_matrix_follow(&a, NULL, &others);
    fresh = fresh_matrix(&m, pairs, 3);
    check_same_pattern(&a, &fresh, &m);
    sb_matrix_free(&fresh);
    others.made_count = 0;
    others.gone_count = 1;
    others.gone = pairs;
    CHECK_OK(sbi_matrix_reserve(&a, NULL, &others, NULL));
    sbi_matrix_follow(&a, NULL, &others);
    CHECK(sb_matrix_find(&a, 0, 50) >= 0);
    others.gone = pairs + 2;
    others.gone_count = 2;
    CHECK_OK(sbi_matrix_reserve(&a, NULL, &others, NULL));
    sbi_matrix_follow(&a, NULL, &others);
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
    CHECK_INT(failed, 3);
    sbi_matrix_follow(&a, &c.change, NULL);
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

CHECK_SUITE(live_matrix, {"random changes against a matrix made anew", test_random_changes},
            {"changes taken back", test_undo}, {"couplings of others", test_other_couplings},
            {"no memory", test_no_memory}, {"parts come apart and meet", test_parts});
