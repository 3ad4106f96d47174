/* elimination: order of the equations, T, the condensed matrix, gaps. */
#include "elimination.h"

#include <limits.h>
#include <string.h>

/* ---- equations ---- */

static void sbi_equations_layout(sbi_equations *equations, int count, size_t terms, sbi_arena *arena)
{
    size_t n = (size_t)count;
    equations->value = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    equations->coefficient = (sb_real *)sbi_arena_take(arena, terms, sizeof(sb_real));
    equations->id = (int *)sbi_arena_take(arena, n, sizeof(int));
    equations->start = (int *)sbi_arena_take(arena, n + 1, sizeof(int));
    equations->dof = (int *)sbi_arena_take(arena, terms, sizeof(int));
}

/* Zeroed memory for what an arena measured, aligned to a cache line through *base; NULL when it is short. */
static void *sbi_elimination_take(const sb_allocator *allocator, sbi_arena *arena)
{
    unsigned char *memory = NULL;
    if (!arena->overflow && arena->used <= (size_t)-1 - 64)
        memory = (unsigned char *)sbi_alloc_zeroed(allocator, arena->used + 64, 1);
    if (memory)
        arena->base = memory + (64 - (size_t)((uintptr_t)memory & 63));
    arena->used = 0;
    return memory;
}

SBI_API int sbi_equations_allocate(const sb_allocator *allocator, int count, size_t terms, sbi_equations *equations)
{
    sbi_arena arena = {NULL, 0, 0};
    memset(equations, 0, sizeof *equations);
    if (terms > INT_MAX)
        return 0;
    sbi_equations_layout(equations, count, terms, &arena);
    equations->memory = sbi_elimination_take(allocator, &arena);
    if (!equations->memory)
        return 0;
    sbi_equations_layout(equations, count, terms, &arena);
    equations->count = count;
    equations->allocator = *allocator;
    return 1;
}

SBI_API void sbi_equations_free(sbi_equations *equations)
{
    sbi_free(&equations->allocator, equations->memory);
    memset(equations, 0, sizeof *equations);
}

SBI_API int sbi_equations_find(const sbi_equations *equations, int id)
{
    int low = 0, high = equations->count;
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (equations->id[middle] < id)
            low = middle + 1;
        else
            high = middle;
    }
    return low < equations->count && equations->id[low] == id ? low : -1;
}

static int sbi_elimination_slave_dof(const sbi_elimination *e, int c)
{
    return e->equations.dof[e->equations.start[c]];
}

/* ---- creation: order ---- */

/* Scratch of a creation. Rows of T, one per equation: entries begin[c] .. end[c] - 1 of dof and weight. */
typedef struct sbi_elimination_maker {
    const sbi_elimination_setup *setup;
    int *owner;           /* [3 node_count] equation whose slave the unknown is, or -1 */
    int *slot;            /* [3 node_count] where the row at work has the unknown, or -1 */
    int *next, *stack;    /* [count] */
    unsigned char *state; /* [count] 0: not met, 1: being followed, 2: done */
    int *begin, *end;     /* [count] */
    int *dof;             /* [capacity] */
    double *weight;       /* [capacity] */
    int used, capacity;
    void *memory, *rows;
} sbi_elimination_maker;

static sb_result sbi_elimination_no_memory(sb_error *error)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the system condensed by constraints");
}

static char sbi_elimination_axis(int dof) { return (char)('x' + dof % 3); }

/* Who eliminates what; each unknown at most once, and not by an equation that names it again. */
static sb_result sbi_elimination_claim(sbi_elimination *e, sbi_elimination_maker *maker, sb_error *error)
{
    const sbi_equations *q = &e->equations;
    for (int i = 0; i < 3 * e->node_count; i++)
        maker->owner[i] = maker->slot[i] = -1;
    for (int c = 0; c < q->count; c++) {
        int dof = q->dof[q->start[c]];
        if (maker->owner[dof] >= 0)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, dof / 3, "node %d is the slave of two constraints along %c",
                                 dof / 3, sbi_elimination_axis(dof));
        for (int k = q->start[c] + 1; k < q->start[c + 1]; k++)
            if (q->dof[k] == dof)
                return sbi_fail_node(error, SB_ERROR_ARGUMENT, dof / 3,
                                     "node %d is slave and master of the same constraint along %c", dof / 3,
                                     sbi_elimination_axis(dof));
        maker->owner[dof] = c;
        e->slave[dof / 3] |= (unsigned char)(1 << dof % 3);
    }
    return SB_OK;
}

/* Depth-first order from one equation; those it follows come first. */
static sb_result sbi_elimination_sort_from(sbi_elimination *e, sbi_elimination_maker *maker, int root, int *done,
                                           sb_error *error)
{
    const sbi_equations *q = &e->equations;
    int depth = 1;
    maker->stack[0] = root;
    maker->state[root] = 1;
    maker->next[root] = q->start[root] + 1;
    while (depth > 0) {
        int c = maker->stack[depth - 1], master;
        if (maker->next[c] == q->start[c + 1]) {
            maker->state[c] = 2;
            e->order[(*done)++] = c;
            depth--;
            continue;
        }
        master = maker->owner[q->dof[maker->next[c]++]];
        if (master < 0 || maker->state[master] == 2)
            continue;
        if (maker->state[master] == 1)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, sbi_elimination_slave_dof(e, master) / 3,
                                 "constraints run in a circle through node %d along %c",
                                 sbi_elimination_slave_dof(e, master) / 3,
                                 sbi_elimination_axis(sbi_elimination_slave_dof(e, master)));
        maker->state[master] = 1;
        maker->next[master] = q->start[master] + 1;
        maker->stack[depth++] = master;
    }
    return SB_OK;
}

static sb_result sbi_elimination_sort(sbi_elimination *e, sbi_elimination_maker *maker, sb_error *error)
{
    int done = 0;
    for (int c = 0; c < e->equations.count; c++) {
        sb_result result = maker->state[c] ? SB_OK : sbi_elimination_sort_from(e, maker, c, &done, error);
        if (result != SB_OK)
            return result;
    }
    return SB_OK;
}

/* ---- creation: rows of T ---- */

/* Room for one more entry. */
static int sbi_elimination_grow(sbi_elimination_maker *maker)
{
    const sb_allocator *allocator = maker->setup->allocator;
    size_t capacity = maker->capacity ? 2 * (size_t)maker->capacity : 64;
    double *rows;
    if (maker->used < maker->capacity)
        return 1;
    if (capacity > INT_MAX)
        return 0;
    rows = (double *)sbi_alloc(allocator, capacity, sizeof(double) + sizeof(int));
    if (!rows)
        return 0;
    if (maker->used > 0) {
        memcpy(rows, maker->weight, (size_t)maker->used * sizeof(double));
        memcpy(rows + capacity, maker->dof, (size_t)maker->used * sizeof(int));
    }
    sbi_free(allocator, maker->rows);
    maker->rows = rows;
    maker->weight = rows;
    maker->dof = (int *)(void *)(rows + capacity);
    maker->capacity = (int)capacity;
    return 1;
}

/* Adds weight * u[dof] to the row at work. */
static int sbi_elimination_add_entry(sbi_elimination_maker *maker, int dof, double weight)
{
    if (maker->slot[dof] < 0) {
        if (!sbi_elimination_grow(maker))
            return 0;
        maker->slot[dof] = maker->used++;
        maker->dof[maker->slot[dof]] = dof;
        maker->weight[maker->slot[dof]] = 0;
    }
    maker->weight[maker->slot[dof]] += weight;
    return 1;
}

/* The row of equation c in unknowns that nobody eliminates; its masters' rows are there already. */
static int sbi_elimination_resolve(const sbi_elimination *e, sbi_elimination_maker *maker, int c)
{
    const sbi_equations *q = &e->equations;
    double pivot = (double)q->coefficient[q->start[c]];
    maker->begin[c] = maker->used;
    for (int k = q->start[c] + 1; k < q->start[c + 1]; k++) {
        double weight = -(double)q->coefficient[k] / pivot;
        int master = maker->owner[q->dof[k]];
        if (master < 0 && !sbi_elimination_add_entry(maker, q->dof[k], weight))
            return 0;
        for (int m = master < 0 ? 0 : maker->begin[master]; m < (master < 0 ? 0 : maker->end[master]); m++)
            if (!sbi_elimination_add_entry(maker, maker->dof[m], weight * maker->weight[m]))
                return 0;
    }
    maker->end[c] = maker->used;
    for (int k = maker->begin[c]; k < maker->end[c]; k++)
        maker->slot[maker->dof[k]] = -1;
    return 1;
}

/* Block of T for a master node in the row of the node at work, zero when it is new; slot is used per node here. */
static sb_real *sbi_elimination_weight(sbi_elimination *e, sbi_elimination_maker *maker, int master, int *end)
{
    if (maker->slot[master] < 0) {
        maker->slot[master] = (*end)++;
        e->master[maker->slot[master]] = master;
        memset(e->weight[maker->slot[master]], 0, sizeof e->weight[0]);
    }
    return e->weight[maker->slot[master]];
}

/* Gathers the rows of each node's axes into 3x3 blocks. */
static int sbi_elimination_gather(sbi_elimination *e, sbi_elimination_maker *maker)
{
    size_t most = (size_t)maker->used;
    int end = 0;
    for (int i = 0; i < e->node_count; i++)
        most += e->slave[i] != 0;
    if (most > INT_MAX)
        return 0;
    e->master = (int *)sbi_alloc(&e->allocator, most, sizeof(int));
    e->weight = (sb_real(*)[9])sbi_alloc(&e->allocator, most, 9 * sizeof(sb_real));
    if (!e->master || !e->weight)
        return 0;
    for (int i = 0; i < e->node_count; i++) {
        e->first[i] = end;
        for (int axis = 0; axis < 3 && e->slave[i]; axis++) {
            int c = maker->owner[3 * i + axis];
            if (c < 0)
                sbi_elimination_weight(e, maker, i, &end)[4 * axis] = 1;
            for (int k = c < 0 ? 0 : maker->begin[c]; k < (c < 0 ? 0 : maker->end[c]); k++)
                sbi_elimination_weight(e, maker, maker->dof[k] / 3, &end)[3 * axis + maker->dof[k] % 3] =
                    (sb_real)maker->weight[k];
        }
        for (int k = e->first[i]; k < end; k++)
            maker->slot[e->master[k]] = -1;
    }
    e->first[e->node_count] = end;
    return 1;
}

/* ---- creation: the condensed matrix ---- */

/* A row of T: nodes and blocks. */
typedef struct sbi_elimination_row {
    int count;
    const int *node;
    const sb_real (*weight)[9];
} sbi_elimination_row;

static const sb_real sbi_elimination_identity[1][9] = {{1, 0, 0, 0, 1, 0, 0, 0, 1}};

/* The row of node *i; it refers to *i. */
static sbi_elimination_row sbi_elimination_row_of(const sbi_elimination *e, const int *i)
{
    sbi_elimination_row row;
    int first = e->first[*i];
    row.count = e->slave[*i] ? e->first[*i + 1] - first : 1;
    row.node = e->slave[*i] ? e->master + first : i;
    row.weight = e->slave[*i] ? (const sb_real(*)[9])(e->weight + first) : sbi_elimination_identity;
    return row;
}

/* Walks the cells of the condensed pattern: for every block (i, j) the masters of i and of j. Counts, or fills. */
static void sbi_elimination_cells(const sbi_elimination *e, const sb_matrix *matrix, int *start, int *cells,
                                  size_t *cell_count, size_t *entry_count)
{
    size_t made = 0, entries = 0;
    for (int i = 0; i < matrix->row_count; i++)
        for (int k = matrix->diagonal[i]; k < matrix->row_end[i]; k++) {
            int j = matrix->columns[k];
            sbi_elimination_row a = sbi_elimination_row_of(e, &i), b = sbi_elimination_row_of(e, &j);
            if (j == i)
                b.count = 0;
            if (cells) {
                memcpy(cells + entries, a.node, (size_t)a.count * sizeof(int));
                memcpy(cells + entries + a.count, b.node, (size_t)b.count * sizeof(int));
                start[made] = (int)entries;
            }
            made++;
            entries += (size_t)a.count + (size_t)b.count;
        }
    if (cells)
        start[made] = (int)entries;
    *cell_count = made;
    *entry_count = entries;
}

static sb_result sbi_elimination_make_matrix(sbi_elimination *e, const sb_matrix *full, sb_error *error)
{
    size_t cell_count, entry_count;
    int *memory;
    sb_result result;
    sbi_elimination_cells(e, full, NULL, NULL, &cell_count, &entry_count);
    if (cell_count > INT_MAX - 1 || entry_count > INT_MAX)
        return sbi_elimination_no_memory(error);
    memory = (int *)sbi_alloc(&e->allocator, cell_count + 1 + entry_count, sizeof(int));
    if (!memory)
        return sbi_elimination_no_memory(error);
    sbi_elimination_cells(e, full, memory, memory + cell_count + 1, &cell_count, &entry_count);
    result = sb_matrix_create(e->node_count, (int)cell_count, 0, memory, memory + cell_count + 1, &e->allocator,
                              &e->matrix, error);
    sbi_free(&e->allocator, memory);
    return result;
}

/* Where every product T_i^T A_ij T_j goes. */
static sb_result sbi_elimination_make_positions(sbi_elimination *e, const sb_matrix *full, sb_error *error)
{
    size_t total = 0;
    int *at;
    for (int pass = 0; pass < 2; pass++) {
        if (pass == 1)
            e->positions = (int *)sbi_alloc(&e->allocator, total, sizeof(int));
        if (pass == 1 && !e->positions)
            return sbi_elimination_no_memory(error);
        at = e->positions;
        for (int i = 0; i < full->row_count; i++)
            for (int k = full->row_start[i]; k < full->row_end[i]; k++) {
                int j = full->columns[k];
                sbi_elimination_row a = sbi_elimination_row_of(e, &i), b = sbi_elimination_row_of(e, &j);
                total += (size_t)a.count * (size_t)b.count;
                for (int p = 0; pass == 1 && p < a.count; p++)
                    for (int r = 0; r < b.count; r++)
                        *at++ = sb_matrix_find(&e->matrix, a.node[p], b.node[r]);
            }
    }
    return SB_OK;
}

/* ---- creation: memory ---- */

static void sbi_elimination_layout(sbi_elimination *e, int count, sbi_arena *arena)
{
    size_t n = (size_t)e->node_count, c = (size_t)count;
    e->order = (int *)sbi_arena_take(arena, c, sizeof(int));
    e->first = (int *)sbi_arena_take(arena, n + 1, sizeof(int));
    e->slave = (unsigned char *)sbi_arena_take(arena, n, 1);
    e->held = (unsigned char *)sbi_arena_take(arena, n, 1);
    e->force = (sb_real *)sbi_arena_take(arena, c, sizeof(sb_real));
    e->saved_force = (sb_real *)sbi_arena_take(arena, c, sizeof(sb_real));
    e->start_gap = (sb_real *)sbi_arena_take(arena, c, sizeof(sb_real));
    e->gap = (sb_real *)sbi_arena_take(arena, c, sizeof(sb_real));
    e->reduced = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    e->work = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
}

static void sbi_elimination_maker_layout(sbi_elimination_maker *maker, int node_count, int count, sbi_arena *arena)
{
    size_t n = (size_t)node_count, c = (size_t)count;
    maker->owner = (int *)sbi_arena_take(arena, n, 3 * sizeof(int));
    maker->slot = (int *)sbi_arena_take(arena, n, 3 * sizeof(int));
    maker->next = (int *)sbi_arena_take(arena, c, sizeof(int));
    maker->stack = (int *)sbi_arena_take(arena, c, sizeof(int));
    maker->begin = (int *)sbi_arena_take(arena, c, sizeof(int));
    maker->end = (int *)sbi_arena_take(arena, c, sizeof(int));
    maker->state = (unsigned char *)sbi_arena_take(arena, c, 1);
}

/* ---- creation ---- */

static sb_result sbi_elimination_take_memory(sbi_elimination *e, sbi_elimination_maker *maker, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0}, scratch = {NULL, 0, 0};
    int count = e->equations.count;
    sbi_elimination_layout(e, count, &arena);
    sbi_elimination_maker_layout(maker, e->node_count, count, &scratch);
    e->memory = sbi_elimination_take(&e->allocator, &arena);
    maker->memory = sbi_elimination_take(&e->allocator, &scratch);
    if (!e->memory || !maker->memory)
        return sbi_elimination_no_memory(error);
    sbi_elimination_layout(e, count, &arena);
    sbi_elimination_maker_layout(maker, e->node_count, count, &scratch);
    return SB_OK;
}

/* T and all that follows from it. */
static sb_result sbi_elimination_make_rows(sbi_elimination *e, sbi_elimination_maker *maker, sb_error *error)
{
    sb_result result = sbi_elimination_take_memory(e, maker, error);
    if (result == SB_OK)
        result = sbi_elimination_claim(e, maker, error);
    if (result == SB_OK)
        result = sbi_elimination_sort(e, maker, error);
    if (result != SB_OK)
        return result;
    for (int k = 0; k < e->equations.count; k++)
        if (!sbi_elimination_resolve(e, maker, e->order[k]))
            return sbi_elimination_no_memory(error);
    return sbi_elimination_gather(e, maker) ? SB_OK : sbi_elimination_no_memory(error);
}

static sb_result sbi_elimination_build(sbi_elimination *e, const sbi_elimination_setup *setup, sb_error *error)
{
    sbi_elimination_maker maker;
    sb_result result;
    memset(&maker, 0, sizeof maker);
    maker.setup = setup;
    result = sbi_elimination_make_rows(e, &maker, error);
    sbi_free(&e->allocator, maker.rows);
    sbi_free(&e->allocator, maker.memory);
    if (result == SB_OK)
        result = sbi_elimination_make_matrix(e, setup->matrix, error);
    if (result == SB_OK)
        result = sbi_elimination_make_positions(e, setup->matrix, error);
    if (result == SB_OK)
        result =
            sbi_precond_remake(setup->precond, &e->matrix, setup->positions, NULL, &e->allocator, &e->precond, error);
    return result;
}

SBI_API sb_result sbi_elimination_create(const sbi_elimination_setup *setup, sbi_equations *equations,
                                         sbi_elimination **out, sb_error *error)
{
    sbi_elimination *e = (sbi_elimination *)sbi_alloc_zeroed(setup->allocator, 1, sizeof *e);
    sb_result result;
    if (!e)
        return sbi_elimination_no_memory(error);
    e->allocator = *setup->allocator;
    e->node_count = setup->matrix->row_count;
    e->equations = *equations;
    result = sbi_elimination_build(e, setup, error);
    if (result != SB_OK) {
        memset(&e->equations, 0, sizeof e->equations);
        sbi_elimination_free(e);
        return result;
    }
    memset(equations, 0, sizeof *equations);
    *out = e;
    return SB_OK;
}

SBI_API sb_result sbi_elimination_remake(const sbi_elimination *e, const sbi_elimination_setup *setup,
                                         sbi_elimination **out, sb_error *error)
{
    const sbi_equations *old = &e->equations;
    size_t count = (size_t)old->count, terms = (size_t)old->start[old->count];
    sbi_equations equations;
    sb_result result;
    if (!sbi_equations_allocate(setup->allocator, old->count, terms, &equations))
        return sbi_elimination_no_memory(error);
    memcpy(equations.id, old->id, count * sizeof(int));
    memcpy(equations.value, old->value, count * sizeof(sb_real));
    memcpy(equations.start, old->start, (count + 1) * sizeof(int));
    memcpy(equations.dof, old->dof, terms * sizeof(int));
    memcpy(equations.coefficient, old->coefficient, terms * sizeof(sb_real));
    result = sbi_elimination_create(setup, &equations, out, error);
    sbi_equations_free(&equations);
    if (result == SB_OK)
        memcpy((*out)->force, e->force, count * sizeof(sb_real));
    return result;
}

SBI_API void sbi_elimination_free(sbi_elimination *e)
{
    sb_allocator allocator;
    if (!e)
        return;
    allocator = e->allocator;
    sbi_equations_free(&e->equations);
    sb_preconditioner_free(e->precond);
    sb_matrix_free(&e->matrix);
    sbi_free(&allocator, e->positions);
    sbi_free(&allocator, e->weight);
    sbi_free(&allocator, e->master);
    sbi_free(&allocator, e->memory);
    sbi_free(&allocator, e);
}

/* ---- the matrix ---- */

/* out += a^T b c, 3x3 row-major. */
static void sbi_elimination_add_product(const sb_real *a, const sb_real *b, const sb_real *c, sb_real *out)
{
    for (int i = 0; i < 3; i++) {
        sb_real t[3];
        for (int k = 0; k < 3; k++)
            t[k] = a[i] * b[k] + a[3 + i] * b[3 + k] + a[6 + i] * b[6 + k];
        for (int j = 0; j < 3; j++)
            out[3 * i + j] += t[0] * c[j] + t[1] * c[3 + j] + t[2] * c[6 + j];
    }
}

SBI_API void sbi_elimination_condense(sbi_elimination *e, const sb_matrix *matrix)
{
    const int *at = e->positions;
    sb_matrix_clear(&e->matrix);
    for (int i = 0; i < matrix->row_count; i++)
        for (int k = matrix->row_start[i]; k < matrix->row_end[i]; k++) {
            int j = matrix->columns[k];
            const sb_real *block = matrix->blocks[k];
            sbi_elimination_row a, b;
            if (!e->slave[i] && !e->slave[j]) {
                sb_real *out = e->matrix.blocks[*at++];
                for (int c = 0; c < 9; c++)
                    out[c] += block[c];
                continue;
            }
            a = sbi_elimination_row_of(e, &i);
            b = sbi_elimination_row_of(e, &j);
            for (int p = 0; p < a.count; p++)
                for (int r = 0; r < b.count; r++)
                    sbi_elimination_add_product(a.weight[p], block, b.weight[r], e->matrix.blocks[*at++]);
        }
}

SBI_API void sbi_elimination_condense_diagonal(const sbi_elimination *e, sb_vec3 *diagonal)
{
    for (int i = 0; i < e->node_count; i++)
        for (int axis = 0; axis < 3; axis++) {
            sb_real d = sbi_elimination_get(diagonal, 3 * i + axis);
            if (!(e->slave[i] >> axis & 1)) /* only slaves hand theirs on, and to no slave */
                continue;
            for (int k = 3 * e->first[i]; k < 3 * e->first[i + 1]; k++) {
                sb_real w = e->weight[k / 3][3 * axis + k % 3];
                *sbi_elimination_at(diagonal, 3 * e->master[k / 3] + k % 3) += w * w * d;
            }
            *sbi_elimination_at(diagonal, 3 * i + axis) = 0;
        }
}

/* ---- vectors ---- */

SBI_API void sbi_elimination_reduce(const sbi_elimination *e, const sb_vec3 *in, sb_vec3 *out, sb_real *multipliers)
{
    const sbi_equations *q = &e->equations;
    if (out != in)
        memcpy(out, in, (size_t)e->node_count * sizeof(sb_vec3));
    for (int k = q->count; k-- > 0;) {
        int c = e->order[k], first = q->start[c];
        sb_real *slave = sbi_elimination_at(out, q->dof[first]), multiplier = *slave / q->coefficient[first];
        for (int t = first + 1; t < q->start[c + 1]; t++)
            *sbi_elimination_at(out, q->dof[t]) -= q->coefficient[t] * multiplier;
        *slave = 0;
        if (multipliers)
            multipliers[c] = multiplier;
    }
}

/* (value - sum over the masters of a_k u_k) / a_0 */
static sb_real sbi_elimination_slave_value(const sbi_equations *q, int c, const sb_vec3 *u, sb_real value)
{
    double sum = (double)value;
    for (int t = q->start[c] + 1; t < q->start[c + 1]; t++)
        sum -= (double)q->coefficient[t] * (double)sbi_elimination_get(u, q->dof[t]);
    return (sb_real)(sum / (double)q->coefficient[q->start[c]]);
}

SBI_API void sbi_elimination_expand(const sbi_elimination *e, sb_vec3 *increment, int with_gaps)
{
    for (int k = 0; k < e->equations.count; k++) {
        int c = e->order[k];
        sb_real way = sbi_elimination_slave_value(&e->equations, c, increment, 0);
        *sbi_elimination_at(increment, sbi_elimination_slave_dof(e, c)) = with_gaps ? way + e->gap[c] : way;
    }
}

SBI_API void sbi_elimination_clear_slaves(const sbi_elimination *e, sb_vec3 *vector)
{
    for (int c = 0; c < e->equations.count; c++)
        *sbi_elimination_at(vector, sbi_elimination_slave_dof(e, c)) = 0;
}

/* ---- gaps ---- */

/* Where the slave belongs at a share of the way: a gap of the start closes evenly, none stays exactly none. */
static sb_real sbi_elimination_goal(const sbi_elimination *e, int c, const sb_vec3 *u, sb_real load_factor)
{
    sb_real goal = sbi_elimination_slave_value(&e->equations, c, u, e->equations.value[c]);
    return load_factor == 1 ? goal : goal - (1 - load_factor) * e->start_gap[c];
}

SBI_API void sbi_elimination_restore(sbi_elimination *e)
{
    memcpy(e->force, e->saved_force, (size_t)e->equations.count * sizeof(sb_real));
    sbi_precond_set_memory(e->precond, e->saved_precond);
}

SBI_API void sbi_elimination_save(sbi_elimination *e, const sb_vec3 *u)
{
    memcpy(e->saved_force, e->force, (size_t)e->equations.count * sizeof(sb_real));
    e->saved_precond = sbi_precond_get_memory(e->precond);
    for (int c = 0; c < e->equations.count; c++)
        e->start_gap[c] = sbi_elimination_goal(e, c, u, 1) - sbi_elimination_get(u, sbi_elimination_slave_dof(e, c));
}

SBI_API int sbi_elimination_open(sbi_elimination *e, const sb_vec3 *u, sb_real load_factor)
{
    int open = 0;
    for (int c = 0; c < e->equations.count; c++) {
        e->gap[c] = 0;
        if (load_factor != 0) /* at 0 the start itself is the goal, and rounding must not tell otherwise */
            e->gap[c] =
                sbi_elimination_goal(e, c, u, load_factor) - sbi_elimination_get(u, sbi_elimination_slave_dof(e, c));
        open |= e->gap[c] != 0;
    }
    return open;
}

SBI_API void sbi_elimination_follow(const sbi_elimination *e, sb_vec3 *u, sb_real load_factor)
{
    for (int k = 0; k < e->equations.count; k++) {
        int c = e->order[k];
        *sbi_elimination_at(u, sbi_elimination_slave_dof(e, c)) = sbi_elimination_goal(e, c, u, load_factor);
    }
}
