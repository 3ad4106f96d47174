/* direct: see direct.h. Analysis of the pattern, and the factor's walk over its fronts; their dense arithmetic is in
 * direct_front.c.
 *
 * Columns are renumbered nodes. A front is a run of columns with the same rows below them (nearly: runs are joined when
 * that stores few zeros). Its panel holds those columns of L; what they take from the rest of the matrix goes, as a
 * dense square over the rows below, to the front's parent, that of the first of these rows. Fronts come in postorder,
 * so these squares live on a stack. */
#include <stdlib.h>

#include "direct_private.h"
#include "sparse_live.h"

/* What the analysis needs for a while. */
typedef struct sbi_direct_plan {
    int *parent; /* of a column in the elimination tree, or -1 */
    int *count;  /* of rows of a column, its own included */
    int *first_child, *next_sibling, *scratch;
    size_t row_total;
} sbi_direct_plan;

SB_API sb_direct_def sb_default_direct_def(void)
{
    sb_direct_def def;
    def.kind = SB_DIRECT_CHOLESKY;
    def.positions = NULL;
    return def;
}

/* ---- the elimination tree ---- */

/* Liu 1990: the parent of a column is the first row below the diagonal in its column of L. */
static void sbi_direct_tree(const sb_direct *d, const sb_matrix *a, sbi_direct_plan *plan)
{
    int *ancestor = plan->scratch;
    for (int k = 0; k < d->node_count; k++) {
        int node = d->node[k];
        plan->parent[k] = ancestor[k] = -1;
        for (int q = a->row_start[node]; q < a->row_end[node]; q++) {
            int i = d->position[a->columns[q]];
            while (i >= 0 && i < k) {
                int next = ancestor[i];
                ancestor[i] = k;
                if (next < 0)
                    plan->parent[i] = k;
                i = next;
            }
        }
    }
}

/* Rows of each column: row k of L has an entry in each column on the way from its entries in A up to k. */
static void sbi_direct_count(const sb_direct *d, const sb_matrix *a, sbi_direct_plan *plan)
{
    int *mark = plan->scratch;
    for (int k = 0; k < d->node_count; k++) {
        int node = d->node[k];
        plan->count[k] = 1;
        mark[k] = k;
        for (int q = a->row_start[node]; q < a->row_end[node]; q++)
            for (int i = d->position[a->columns[q]]; i >= 0 && i < k && mark[i] != k; i = plan->parent[i]) {
                plan->count[i]++;
                mark[i] = k;
            }
    }
}

/* Children of each column as a list, the one with the most rows last: only with that one a parent can be joined. */
static void sbi_direct_children(const sb_direct *d, sbi_direct_plan *plan)
{
    for (int k = 0; k < d->node_count; k++)
        plan->first_child[k] = plan->next_sibling[k] = -1;
    for (int k = d->node_count - 1; k >= 0; k--) {
        int *link = plan->parent[k] < 0 ? NULL : plan->first_child + plan->parent[k];
        while (link && *link >= 0 && plan->count[*link] < plan->count[k])
            link = plan->next_sibling + *link;
        if (!link)
            continue;
        plan->next_sibling[k] = *link;
        *link = k;
    }
}

/* Renumbers the columns so that each subtree is a run that ends with its root. */
static void sbi_direct_postorder(sb_direct *d, sbi_direct_plan *plan)
{
    int *order = plan->scratch, count = 0;
    for (int root = 0; root < d->node_count; root++) {
        int k = root;
        if (plan->parent[root] >= 0)
            continue;
        for (;;) {
            while (plan->first_child[k] >= 0) {
                int child = plan->first_child[k];
                plan->first_child[k] = -1; /* been there */
                k = child;
            }
            order[count++] = d->node[k];
            if (plan->next_sibling[k] >= 0)
                k = plan->next_sibling[k];
            else if (plan->parent[k] >= 0)
                k = plan->parent[k];
            else
                break;
        }
    }
    memcpy(d->node, order, (size_t)d->node_count * sizeof(int));
    for (int k = 0; k < d->node_count; k++)
        d->position[d->node[k]] = k;
}

/* ---- fronts ---- */

/* Whether two runs of columns, in nodes, with `zeros` blocks of zeros between them should be one. */
static int sbi_direct_joins(int columns, int below, double zeros)
{
    double entries = (double)columns * (columns + 1) / 2 + (double)columns * below;
    return columns <= 4 || zeros < (columns <= 8 ? 0.4 : columns <= 16 ? 0.15 : 0.05) * entries;
}

/* Joins runs of columns to pieces; zeros: of each piece, scratch. */
static void sbi_direct_join(sb_direct *d, sbi_direct_plan *plan, double *zeros)
{
    sbi_direct_piece *pieces = d->pieces;
    int top = -1;
    for (int k = 0; k < d->node_count; k++) {
        sbi_direct_piece *piece = pieces + ++top;
        piece->first = k;
        piece->last = k + 1;
        piece->row_count = plan->count[k];
        zeros[top] = 0;
        while (top > 0 && plan->parent[pieces[top - 1].last - 1] == pieces[top].first) {
            sbi_direct_piece *below = pieces + top - 1;
            int own = below->last - below->first, rest = below->row_count - own;
            int columns = pieces[top].last - below->first;
            double more = zeros[top - 1] + zeros[top] + (double)own * (pieces[top].row_count - rest);
            if (!sbi_direct_joins(columns, pieces[top].row_count - (columns - own), more))
                break;
            below->last = pieces[top].last;
            below->row_count = own + pieces[top].row_count;
            zeros[--top] = more;
        }
    }
    d->piece_count = top + 1;
}

static int sbi_direct_compare(const void *a, const void *b)
{
    int p = *(const int *)a, q = *(const int *)b;
    return p < q ? -1 : p > q;
}

/* Rows below a piece's own columns: those of A, and those that its children's squares have. */
static void sbi_direct_rows(sb_direct *d, const sb_matrix *a, int index, const int *children, int *mark)
{
    sbi_direct_piece *piece = d->pieces + index;
    int *rows = d->rows + piece->row_start, count = 0;
    for (int k = piece->first; k < piece->last; k++)
        rows[count++] = k;
    for (int k = piece->first; k < piece->last; k++) {
        int node = d->node[k];
        for (int q = a->row_start[node]; q < a->row_end[node]; q++) {
            int i = d->position[a->columns[q]];
            if (i < piece->last || mark[i] == index)
                continue;
            mark[i] = index;
            rows[count++] = i;
        }
    }
    for (int c = 0; c < piece->child_count; c++) {
        const sbi_direct_piece *child = d->pieces + children[c];
        const int *from = d->rows + child->row_start + (child->last - child->first);
        for (int r = 0; r < child->row_count - (child->last - child->first); r++)
            if (from[r] >= piece->last && mark[from[r]] != index) {
                mark[from[r]] = index;
                rows[count++] = from[r];
            }
    }
    SB_ASSERT(count == piece->row_count);
    qsort(rows + (piece->last - piece->first), (size_t)(count - (piece->last - piece->first)), sizeof(int),
          sbi_direct_compare);
}

/* Parents by postorder: the pieces waiting for theirs are a stack, and a piece takes those whose first row below is
 * one of its columns. */
static void sbi_direct_fill_rows(sb_direct *d, const sb_matrix *a, sbi_direct_plan *plan)
{
    int *waiting = plan->first_child, *mark = plan->next_sibling, depth = 0;
    for (int k = 0; k < d->node_count; k++)
        mark[k] = -1;
    for (int s = 0; s < d->piece_count; s++) {
        sbi_direct_piece *piece = d->pieces + s;
        while (depth > 0) {
            int parent = plan->parent[d->pieces[waiting[depth - 1]].last - 1];
            if (parent < piece->first || parent >= piece->last)
                break;
            depth--;
            piece->child_count++;
        }
        sbi_direct_rows(d, a, s, waiting + depth, mark);
        waiting[depth++] = s;
    }
}

/* Reals of the square that a piece leaves to its parent. */
static size_t sbi_direct_square(const sbi_direct_piece *piece)
{
    size_t below = 3 * (size_t)(piece->row_count - (piece->last - piece->first));
    return below * below;
}

/* Where each panel lies, the deepest stack, and the counts of the info. 0 when a size does not fit. */
static int sbi_direct_measure(sb_direct *d, sbi_direct_plan *plan)
{
    int *waiting = plan->first_child, depth = 0;
    size_t used = 0, rows = 0;
    double entries = 0, work = 0;
    for (int s = 0; s < d->piece_count; s++) {
        sbi_direct_piece *piece = d->pieces + s;
        double w = 3 * (double)(piece->last - piece->first), m = 3 * (double)piece->row_count;
        size_t freed = 0;
        piece->row_start = (int)rows;
        piece->panel = d->factor_count;
        piece->child_count = 0;
        entries += w * m;
        work += w * (m * m - m * w + w * w / 3) / 2;
        if (entries > 0.1 * (double)(size_t)-1 || rows + (size_t)piece->row_count > 0x7fffffff)
            return 0;
        rows += (size_t)piece->row_count;
        d->factor_count += 9 * (size_t)(piece->last - piece->first) * (size_t)piece->row_count;
        d->info.largest_front = sbi_max_int(d->info.largest_front, 3 * piece->row_count);
        while (depth > 0 && plan->parent[d->pieces[waiting[depth - 1]].last - 1] >= piece->first &&
               plan->parent[d->pieces[waiting[depth - 1]].last - 1] < piece->last)
            freed += sbi_direct_square(d->pieces + waiting[--depth]);
        waiting[depth++] = s;
        used += sbi_direct_square(piece);
        d->stack_count = used > d->stack_count ? used : d->stack_count;
        used -= freed;
    }
    plan->row_total = rows;
    d->info.fronts = d->piece_count;
    d->info.factor_entries = entries;
    d->info.multiply_adds = work;
    return 1;
}

/* ---- life ---- */

/* The arrays whose size the number of nodes tells, those of the plan among them. */
static void sbi_direct_layout_plan(sb_direct *d, sbi_direct_plan *plan, double **zeros, sbi_arena *arena)
{
    size_t n = (size_t)d->node_count;
    d->position = (int *)sbi_arena_take(arena, n, sizeof(int));
    d->node = (int *)sbi_arena_take(arena, n, sizeof(int));
    d->place = (int *)sbi_arena_take(arena, n, sizeof(int));
    d->pieces = (sbi_direct_piece *)sbi_arena_take(arena, n, sizeof(sbi_direct_piece));
    plan->parent = (int *)sbi_arena_take(arena, n, sizeof(int));
    plan->count = (int *)sbi_arena_take(arena, n, sizeof(int));
    plan->first_child = (int *)sbi_arena_take(arena, n, sizeof(int));
    plan->next_sibling = (int *)sbi_arena_take(arena, n, sizeof(int));
    plan->scratch = (int *)sbi_arena_take(arena, n, sizeof(int));
    *zeros = (double *)sbi_arena_take(arena, n, sizeof(double));
}

static void sbi_direct_layout(sb_direct *d, const sbi_direct_plan *plan, sbi_arena *arena)
{
    size_t n = (size_t)d->node_count, pieces = (size_t)d->piece_count;
    d->position = (int *)sbi_arena_take(arena, n, sizeof(int));
    d->node = (int *)sbi_arena_take(arena, n, sizeof(int));
    d->place = (int *)sbi_arena_take(arena, n, sizeof(int));
    d->run_end = (int *)sbi_arena_take(arena, n, sizeof(int));
    d->pieces = (sbi_direct_piece *)sbi_arena_take(arena, pieces, sizeof(sbi_direct_piece));
    d->rows = (int *)sbi_arena_take(arena, plan->row_total, sizeof(int));
    d->waiting = (int *)sbi_arena_take(arena, pieces, sizeof(int));
    d->factor = (sb_real *)sbi_arena_take(arena, d->factor_count, sizeof(sb_real));
    d->squares = (sb_real *)sbi_arena_take(arena, d->stack_count, sizeof(sb_real));
    d->signs = (sb_real *)sbi_arena_take(arena, n, 3 * sizeof(sb_real));
    d->sizes = (sb_real *)sbi_arena_take(arena, n, 3 * sizeof(sb_real));
    d->pack = (sb_real *)sbi_arena_take(arena, SBI_FRONT_PACK, sizeof(sb_real));
    d->solution = (sb_real *)sbi_arena_take(arena, n, SBI_DIRECT_GROUPS * 3 * SBI_FRONT_GROUP * sizeof(sb_real));
    d->gathered = (sb_real *)sbi_arena_take(arena, (size_t)d->info.largest_front, SBI_FRONT_GROUP * sizeof(sb_real));
}

/* Memory of an arena's measured size, its first piece aligned to a cache line. */
static void *sbi_direct_take(const sb_allocator *allocator, sbi_arena *arena)
{
    void *memory = arena->overflow || arena->used > (size_t)-1 - 64 ? NULL : sbi_alloc(allocator, 1, arena->used + 63);
    arena->base = (unsigned char *)memory + (memory ? (64 - ((uintptr_t)memory & 63)) & 63 : 0);
    arena->used = 0;
    return memory;
}

/* Takes the lasting memory and moves there what the plan's has. */
static sb_result sbi_direct_settle(sb_direct *d, sbi_direct_plan *plan, const sb_matrix *pattern, sb_error *error)
{
    sb_direct planned = *d;
    sbi_arena arena;
    memset(&arena, 0, sizeof arena);
    sbi_direct_layout(d, plan, &arena);
    d->info.bytes = arena.used + sizeof *d;
    d->memory = sbi_direct_take(&d->allocator, &arena);
    if (!d->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a factor with %.0f entries", d->info.factor_entries);
    sbi_direct_layout(d, plan, &arena);
    memset(d->place, 0, (size_t)d->node_count * sizeof(int));
    memcpy(d->position, planned.position, (size_t)d->node_count * sizeof(int));
    memcpy(d->node, planned.node, (size_t)d->node_count * sizeof(int));
    memcpy(d->pieces, planned.pieces, (size_t)d->piece_count * sizeof(sbi_direct_piece));
    sbi_direct_fill_rows(d, pattern, plan);
    return SB_OK;
}

static sb_result sbi_direct_analyse(sb_direct *d, const sb_matrix *pattern, const sb_vec3 *positions, sb_error *error)
{
    sbi_direct_plan plan;
    sbi_arena arena;
    double *zeros;
    void *memory;
    sb_result result;
    memset(&plan, 0, sizeof plan);
    memset(&arena, 0, sizeof arena);
    sbi_direct_layout_plan(d, &plan, &zeros, &arena);
    memory = sbi_direct_take(&d->allocator, &arena);
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to analyse a matrix of %d nodes", d->node_count);
    sbi_direct_layout_plan(d, &plan, &zeros, &arena);
    result = sbi_direct_order(pattern, positions, &d->allocator, d->node, error);
    if (result == SB_OK) {
        for (int k = 0; k < d->node_count; k++)
            d->position[d->node[k]] = k;
        sbi_direct_tree(d, pattern, &plan);
        sbi_direct_count(d, pattern, &plan);
        sbi_direct_children(d, &plan);
        sbi_direct_postorder(d, &plan);
        sbi_direct_tree(d, pattern, &plan);
        sbi_direct_count(d, pattern, &plan);
        sbi_direct_join(d, &plan, zeros);
        result = sbi_direct_measure(d, &plan)
                     ? sbi_direct_settle(d, &plan, pattern, error)
                     : sbi_fail(error, SB_ERROR_MEMORY, "the factor of %d nodes is too large", d->node_count);
    }
    sbi_free(&d->allocator, memory);
    return result;
}

static sb_result sbi_direct_check(const sb_direct_def *def, const sb_matrix *pattern, sb_direct **direct,
                                  sb_error *error)
{
    if (!pattern || !pattern->columns || pattern->row_count < 1 || !direct)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a direct solver needs a matrix and a place to go");
    if (def->kind != SB_DIRECT_CHOLESKY && def->kind != SB_DIRECT_LDLT)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no factorisation %d", (int)def->kind);
    if (pattern->row_count > 0x7fffffff / 3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d nodes are too many to factor", pattern->row_count);
    for (int i = 0; def->positions && i < pattern->row_count; i++)
        if (!sb_v3_is_finite(def->positions[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d has a position that is not finite", i);
    return SB_OK;
}

SB_API sb_result sb_direct_create(const sb_direct_def *def, const sb_matrix *pattern, const sb_allocator *allocator,
                                  sb_direct **direct, sb_error *error)
{
    sb_direct_def ordinary = sb_default_direct_def();
    sb_direct *made;
    sb_result result = sbi_direct_check(def ? def : &ordinary, pattern, direct, error);
    if (result != SB_OK)
        return result;
    made = (sb_direct *)sbi_alloc_zeroed(allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a direct solver");
    if (allocator)
        made->allocator = *allocator;
    made->kind = def ? (int)def->kind : (int)ordinary.kind;
    made->node_count = pattern->row_count;
    made->wide = sbi_lanes_are_wide();
    made->block_count = sbi_matrix_used_blocks(pattern);
    made->pattern_version = sbi_matrix_version(pattern);
    made->info.unknowns = 3 * pattern->row_count;
    result = sbi_direct_analyse(made, pattern, def ? def->positions : NULL, error);
    if (result != SB_OK) {
        sb_direct_free(made);
        return result;
    }
    *direct = made;
    return SB_OK;
}

SB_API void sb_direct_free(sb_direct *direct)
{
    sb_allocator allocator;
    if (!direct)
        return;
    allocator = direct->allocator;
    sbi_free(&allocator, direct->memory);
    sbi_free(&allocator, direct);
}

SB_API sb_direct_info sb_direct_get_info(const sb_direct *direct)
{
    sb_direct_info none;
    if (!direct) {
        memset(&none, 0, sizeof none);
        return none;
    }
    return direct->info;
}

/* ---- factoring ---- */

/* The part of the matrix that a piece's columns hold, by the rows of A (of two transposed blocks, the one in the row
 * eliminated first). Returns the node whose row does not fit the pattern, or -1. */
static int sbi_direct_scatter(sb_direct *d, const sb_matrix *a, const sbi_direct_piece *piece)
{
    size_t height = 3 * (size_t)piece->row_count;
    const int *rows = d->rows + piece->row_start;
    for (int k = piece->first; k < piece->last; k++) {
        int node = d->node[k];
        sb_real *columns = d->factor + piece->panel + 3 * (size_t)(k - piece->first) * height;
        sb_real *size = d->sizes + 3 * (size_t)k;
        size[0] = size[1] = size[2] = 0;
        for (int q = a->row_start[node]; q < a->row_end[node]; q++) {
            int i = d->position[a->columns[q]], place;
            const sb_real *block = a->blocks[q];
            for (int c = 0; c < 3; c++)
                for (int r = 0; r < 3; r++)
                    size[c] = sb_max(size[c], sb_abs(block[3 * c + r]));
            if (i < k)
                continue;
            place = d->place[i];
            if (place >= piece->row_count || rows[place] != i)
                return node;
            for (int c = 0; c < 3; c++)
                for (int r = 0; r < 3; r++)
                    columns[(size_t)c * height + 3 * (size_t)place + (size_t)r] = block[3 * c + r];
        }
    }
    return -1;
}

/* run_end of a child's `count` rows below its own. */
static void sbi_direct_find_runs(sb_direct *d, const int *rows, int count)
{
    for (int r = count - 1; r >= 0; r--)
        d->run_end[r] = r + 1 < count && d->place[rows[r + 1]] == d->place[rows[r]] + 1 ? d->run_end[r + 1] : r + 1;
}

/* Adds a child's square to the piece's panel and square. */
static void sbi_direct_extend(sb_direct *d, const sbi_direct_piece *piece, sb_real *square,
                              const sbi_direct_piece *child, const sb_real *from)
{
    int own = child->last - child->first, below = child->row_count - own, width = piece->last - piece->first;
    const int *rows = d->rows + child->row_start + own;
    size_t height = 3 * (size_t)piece->row_count, rest = height - 3 * (size_t)width, side = 3 * (size_t)below;
    sbi_direct_find_runs(d, rows, below);
    for (int c = 0; c < below; c++) {
        int column = d->place[rows[c]];
        for (size_t j = 0; j < 3; j++, from += side) {
            sb_real *to = column < width ? d->factor + piece->panel + (3 * (size_t)column + j) * height
                                         : square + (3 * (size_t)(column - width) + j) * rest - 3 * (size_t)width;
            for (int r = c; r < below; r = d->run_end[r]) {
                sb_real *SB_RESTRICT at = to + 3 * (size_t)d->place[rows[r]];
                const sb_real *SB_RESTRICT value = from + 3 * (size_t)r;
                int values = 3 * (d->run_end[r] - r);
                for (int k = 0; k < values; k++)
                    at[k] += value[k];
            }
        }
    }
}

/* Why a pivot was lost: a matrix that is not finite, or not definite. */
static sb_result sbi_direct_fail(const sb_matrix *a, int node, sb_error *error)
{
    for (int i = 0; i < a->row_count; i++)
        for (int q = a->row_start[i]; q < a->row_end[i]; q++)
            for (int k = 0; k < 9; k++)
                if (!sb_is_finite(a->blocks[q][k]))
                    return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "row %d has an entry that is not finite", i);
    return sbi_fail_node(error, SB_ERROR_INDEFINITE, node,
                         "the matrix has no stable factor: the pivot of node %d is "
                         "negative or lost in rounding",
                         node);
}

/* Where a square's column begins to be used: tiles that cross the diagonal reach above it. */
static size_t sbi_direct_top(size_t column)
{
    const size_t reach = SBI_FRONT_REACH;
    return column > reach ? column - reach : 0;
}

static void sbi_direct_clear_square(sb_real *square, size_t side)
{
    for (size_t c = 0; c < side; c++) {
        size_t top = sbi_direct_top(c);
        memset(square + c * side + top, 0, (side - top) * sizeof *square);
    }
}

/* Moves a square down the stack, column by column. */
static void sbi_direct_lower_square(sb_real *square, size_t side, size_t by)
{
    for (size_t c = 0; c < side && by > 0; c++) {
        sb_real *column = square + c * side + sbi_direct_top(c);
        memmove(column - by, column, (side - sbi_direct_top(c)) * sizeof *square);
    }
}

/* One front: assembled, factored, and its square left on the stack in place of its children's. */
static sb_result sbi_direct_factor_piece(sb_direct *d, const sb_matrix *a, int index, int *depth, size_t *used,
                                         sb_error *error)
{
    const sbi_direct_piece *piece = d->pieces + index;
    size_t height = 3 * (size_t)piece->row_count, width = 3 * (size_t)(piece->last - piece->first);
    size_t size = sbi_direct_square(piece), freed = 0;
    sb_real *panel = d->factor + piece->panel, *square = d->squares + *used;
    const int *rows = d->rows + piece->row_start;
    int bad;
    memset(panel, 0, height * width * sizeof(sb_real));
    sbi_direct_clear_square(square, height - width);
    for (int r = 0; r < piece->row_count; r++)
        d->place[rows[r]] = r;
    bad = sbi_direct_scatter(d, a, piece);
    if (bad >= 0)
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, bad, "row %d is not of the pattern that the solver was made for",
                             bad);
    for (int c = 0; c < piece->child_count; c++) {
        const sbi_direct_piece *child = d->pieces + d->waiting[--*depth];
        freed += sbi_direct_square(child);
        sbi_direct_extend(d, piece, square, child, d->squares + (*used - freed));
    }
    bad = sbi_front_factor(panel, height, width, d->kind == SB_DIRECT_LDLT, d->signs + 3 * (size_t)piece->first,
                           d->sizes + 3 * (size_t)piece->first, d->pack, d->wide, &d->info);
    if (bad >= 0)
        return sbi_direct_fail(a, d->node[piece->first + bad / 3], error);
    sbi_front_square(panel, height, width, d->kind == SB_DIRECT_LDLT, d->signs + 3 * (size_t)piece->first, square,
                     d->pack, d->wide);
    sbi_direct_lower_square(square, height - width, freed);
    *used += size - freed;
    d->waiting[(*depth)++] = index;
    return SB_OK;
}

SB_API sb_result sb_direct_update(sb_direct *direct, const sb_matrix *matrix, sb_error *error)
{
    sb_result result = SB_OK;
    size_t used = 0;
    int depth = 0;
    if (!direct || !matrix || matrix->row_count != direct->node_count ||
        sbi_matrix_used_blocks(matrix) != direct->block_count || sbi_matrix_version(matrix) != direct->pattern_version)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the matrix is not of the pattern the solver was made for");
    direct->ready = 0;
    direct->info.least_pivot = 0;
    direct->info.negative_pivots = 0;
    for (int s = 0; result == SB_OK && s < direct->piece_count; s++)
        result = sbi_direct_factor_piece(direct, matrix, s, &depth, &used, error);
    direct->ready = result == SB_OK;
    return result;
}

SBI_API sb_real *sbi_direct_values(sb_direct *direct, size_t *count)
{
    *count = direct->factor_count;
    return direct->factor;
}

SBI_API void sbi_direct_take_values(sb_direct *direct) { direct->ready = 1; }

/* ---- solving ---- */

/* Copies the rows of a piece between a solution and the dense scratch. */
static void sbi_direct_move(const sb_direct *d, const sbi_direct_piece *piece, sb_real *solution, int count, int group,
                            int back)
{
    size_t bytes = 3 * (size_t)group * sizeof(sb_real);
    const int *rows = d->rows + piece->row_start;
    for (int r = 0; r < count; r++) {
        sb_real *whole = solution + 3 * (size_t)rows[r] * (size_t)group;
        sb_real *part = d->gathered + 3 * (size_t)r * (size_t)group;
        if (back)
            memcpy(whole, part, bytes);
        else
            memcpy(part, whole, bytes);
    }
}

/* Solves for `groups` times `group` right-hand sides in the solution: a panel that has come from memory serves all
 * groups before the next one comes. */
static void sbi_direct_substitute(sb_direct *d, int groups, int group)
{
    size_t stride = 3 * (size_t)d->node_count * (size_t)group;
    for (int s = 0; s < d->piece_count; s++) {
        const sbi_direct_piece *piece = d->pieces + s;
        size_t width = 3 * (size_t)(piece->last - piece->first);
        for (int k = 0; k < groups; k++) {
            sb_real *solution = d->solution + (size_t)k * stride;
            sbi_direct_move(d, piece, solution, piece->row_count, group, 0);
            sbi_front_forward(d->factor + piece->panel, 3 * (size_t)piece->row_count, width, d->gathered, group,
                              d->wide);
            sbi_direct_move(d, piece, solution, piece->row_count, group, 1);
        }
    }
    for (size_t k = 0; d->kind == SB_DIRECT_LDLT && k < (size_t)groups * stride; k++)
        d->solution[k] *= d->signs[k % stride / (size_t)group];
    for (int s = d->piece_count - 1; s >= 0; s--) {
        const sbi_direct_piece *piece = d->pieces + s;
        size_t width = 3 * (size_t)(piece->last - piece->first);
        for (int k = 0; k < groups; k++) {
            sb_real *solution = d->solution + (size_t)k * stride;
            sbi_direct_move(d, piece, solution, piece->row_count, group, 0);
            sbi_front_backward(d->factor + piece->panel, 3 * (size_t)piece->row_count, width, d->gathered, group,
                               d->wide);
            sbi_direct_move(d, piece, solution, piece->last - piece->first, group, 1);
        }
    }
}

/* Copies unknowns[3 node_count] to those of right-hand side g in the solution, or back. */
static void sbi_direct_carry(sb_direct *d, int g, int group, const sb_real *from, sb_real *back)
{
    size_t n = 3 * (size_t)d->node_count;
    sb_real *solution = d->solution + (size_t)(g / group) * n * (size_t)group + (size_t)(g % group);
    for (size_t k = 0; k < n; k++) {
        sb_real *at = solution + (3 * (size_t)d->position[k / 3] + k % 3) * (size_t)group;
        if (back)
            back[k] = *at;
        else
            *at = from[k];
    }
}

SB_API sb_result sb_direct_solve(sb_direct *direct, const sb_real *rhs, sb_real *x, int count)
{
    size_t n = direct ? 3 * (size_t)direct->node_count : 0;
    if (!direct || !direct->ready || !rhs || !x || count < 0)
        return SB_ERROR_ARGUMENT;
    for (int first = 0; first < count;) {
        int group = count - first > 1 ? SBI_FRONT_GROUP : 1;
        int groups = sbi_min_int((count - first + group - 1) / group, SBI_DIRECT_GROUPS);
        int have = sbi_min_int(count - first, groups * group);
        if (have < groups * group) /* the last group is not full */
            memset(direct->solution + (size_t)(groups - 1) * n * (size_t)group, 0, n * (size_t)group * sizeof(sb_real));
        for (int g = 0; g < have; g++)
            sbi_direct_carry(direct, g, group, rhs + (size_t)(first + g) * n, NULL);
        sbi_direct_substitute(direct, groups, group);
        for (int g = 0; g < have; g++)
            sbi_direct_carry(direct, g, group, NULL, x + (size_t)(first + g) * n);
        first += have;
    }
    return SB_OK;
}
