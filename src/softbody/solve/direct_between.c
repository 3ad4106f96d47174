/* direct_between: see direct_between.h. Lefts are taken in groups as wide as the fronts' arithmetic, neighbours in the
 * elimination together. Forward, a front has the rows of all groups that come by, keeps those of its own columns in the
 * solution, and leaves those below on a stack, as the factorisation leaves its squares. Backward all groups pass. */
#include <stdlib.h>
#include <string.h>

#include "direct_between.h"
#include "direct_private.h"

typedef struct sbi_between_entry {
    int left, position; /* where its node is eliminated */
    sb_vec3 value;
} sbi_between_entry;

/* A left's place in the elimination. */
typedef struct sbi_between_key {
    int first, last, left; /* positions of its entries */
} sbi_between_key;

struct sbi_between {
    sb_allocator allocator;
    void *memory; /* the one block behind all arrays */
    const sb_direct *direct;
    int lefts, rights;
    int groups; /* of lefts */
    size_t entry_count, most_entries;
    size_t deepest;             /* rows on the stack at most, of all groups */
    int most_waiting;           /* fronts on it at most */
    int highest;                /* nodes of the highest front */
    sbi_between_entry *entries; /* [most_entries] as they came */
    int *sorted;                /* [most_entries] by position */
    int *start;                 /* [nodes + 1] of positions into sorted */
    sbi_between_key *keys;      /* [lefts] */
    int *slot;                  /* [lefts] group times GROUP and lane */
    int *place;                 /* [nodes] of a column among the rows of the present front */
    int *index;                 /* [groups] of a group among those that come by, or -1 */
    int *lists;                 /* [most_waiting + 1][groups] groups that the waiting fronts have left rows of */
    int *list_count;            /* [most_waiting + 1] */
    int *waiting;               /* [most_waiting + 1] fronts */
    int *rows;                  /* [3 highest] of the present front, in the solution */
    sb_real *stack;             /* [deepest][groups][GROUP] */
    sb_real *pack;              /* [SBI_FRONT_PACK] */
    sb_real *solution;          /* [groups][3 nodes][GROUP] */
    sb_real *product;           /* [groups][rights][3][GROUP] */
};

/* ---- life ---- */

/* How deep the stack gets. */
static void sbi_between_measure(sbi_between *b)
{
    const sb_direct *d = b->direct;
    size_t rows = 0;
    int depth = 0;
    for (int s = 0; s < d->piece_count; s++) {
        const sbi_direct_piece *piece = d->pieces + s;
        size_t freed = 0;
        b->highest = sbi_max_int(b->highest, piece->row_count);
        if (rows + 3 * (size_t)piece->row_count > b->deepest)
            b->deepest = rows + 3 * (size_t)piece->row_count;
        for (int c = 0; c < piece->child_count; c++) {
            const sbi_direct_piece *child = d->pieces + b->waiting[--depth];
            freed += 3 * (size_t)(child->row_count - (child->last - child->first));
        }
        rows += 3 * (size_t)(piece->row_count - (piece->last - piece->first));
        rows -= freed;
        b->waiting[depth++] = s;
        b->most_waiting = sbi_max_int(b->most_waiting, depth);
    }
}

static void sbi_between_layout(sbi_between *b, sbi_arena *arena)
{
    size_t n = (size_t)b->direct->node_count, lefts = (size_t)b->lefts, groups = (size_t)b->groups;
    size_t waiting = (size_t)b->most_waiting + 1, real = SBI_FRONT_GROUP * sizeof(sb_real);
    b->entries = (sbi_between_entry *)sbi_arena_take(arena, b->most_entries, sizeof(sbi_between_entry));
    b->sorted = (int *)sbi_arena_take(arena, b->most_entries, sizeof(int));
    b->start = (int *)sbi_arena_take(arena, n + 1, sizeof(int));
    b->keys = (sbi_between_key *)sbi_arena_take(arena, lefts, sizeof(sbi_between_key));
    b->slot = (int *)sbi_arena_take(arena, lefts, sizeof(int));
    b->place = (int *)sbi_arena_take(arena, n, sizeof(int));
    b->index = (int *)sbi_arena_take(arena, groups, sizeof(int));
    b->lists = (int *)sbi_arena_take(arena, waiting, groups * sizeof(int));
    b->list_count = (int *)sbi_arena_take(arena, waiting, sizeof(int));
    b->rows = (int *)sbi_arena_take(arena, (size_t)b->highest, 3 * sizeof(int));
    b->stack = (sb_real *)sbi_arena_take(arena, b->deepest, groups * real);
    b->pack = (sb_real *)sbi_arena_take(arena, SBI_FRONT_PACK, sizeof(sb_real));
    b->solution = (sb_real *)sbi_arena_take(arena, groups, 3 * n * real);
    b->product = (sb_real *)sbi_arena_take(arena, groups, (size_t)b->rights * 3 * real);
}

SBI_API sb_result sbi_between_create(const sb_direct *direct, int lefts, int rights, size_t entries,
                                     const sb_allocator *allocator, sbi_between **between, sb_error *error)
{
    sbi_between *b = (sbi_between *)sbi_alloc_zeroed(allocator, 1, sizeof *b);
    sbi_arena arena;
    memset(&arena, 0, sizeof arena);
    if (b && allocator)
        b->allocator = *allocator;
    if (b)
        b->waiting = (int *)sbi_alloc(&b->allocator, (size_t)direct->piece_count, sizeof(int));
    if (b && b->waiting) {
        b->direct = direct;
        b->lefts = lefts;
        b->rights = rights;
        b->groups = (lefts + SBI_FRONT_GROUP - 1) / SBI_FRONT_GROUP;
        b->most_entries = entries;
        sbi_between_measure(b);
        sbi_between_layout(b, &arena);
        b->memory = arena.overflow || entries > 0x7fffffff ? NULL : sbi_alloc(&b->allocator, 1, arena.used + 63);
    }
    if (!b || !b->memory) {
        sbi_between_free(b);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d by %d products of %.0f entries", lefts, rights,
                        (double)entries);
    }
    arena.base = (unsigned char *)b->memory + ((64 - ((uintptr_t)b->memory & 63)) & 63);
    arena.used = 0;
    sbi_between_layout(b, &arena);
    *between = b;
    return SB_OK;
}

SBI_API void sbi_between_free(sbi_between *b)
{
    sb_allocator allocator;
    if (!b)
        return;
    allocator = b->allocator;
    sbi_free(&allocator, b->waiting);
    sbi_free(&allocator, b->memory);
    sbi_free(&allocator, b);
}

/* ---- lefts ---- */

SBI_API void sbi_between_clear(sbi_between *b) { b->entry_count = 0; }

SBI_API void sbi_between_add(sbi_between *b, int left, int node, sb_vec3 value)
{
    SB_ASSERT(b->entry_count < b->most_entries && left >= 0 && left < b->lefts);
    b->entries[b->entry_count].left = left;
    b->entries[b->entry_count].position = b->direct->position[node];
    b->entries[b->entry_count++].value = value;
}

static int sbi_between_compare(const void *a, const void *b)
{
    const sbi_between_key *p = (const sbi_between_key *)a, *q = (const sbi_between_key *)b;
    if (p->first != q->first)
        return p->first < q->first ? -1 : 1;
    if (p->last != q->last)
        return p->last < q->last ? -1 : 1;
    return p->left < q->left ? -1 : p->left > q->left;
}

/* slot: neighbours in the elimination go together, so that few fronts have a group come by for one of its vectors. */
static void sbi_between_arrange(sbi_between *b)
{
    for (int k = 0; k < b->lefts; k++) {
        b->keys[k].first = b->direct->node_count;
        b->keys[k].last = -1;
        b->keys[k].left = k;
    }
    for (size_t e = 0; e < b->entry_count; e++) {
        sbi_between_key *key = b->keys + b->entries[e].left;
        key->first = sbi_min_int(key->first, b->entries[e].position);
        key->last = sbi_max_int(key->last, b->entries[e].position);
    }
    qsort(b->keys, (size_t)b->lefts, sizeof *b->keys, sbi_between_compare);
    for (int k = 0; k < b->lefts; k++)
        b->slot[b->keys[k].left] = k;
}

static void sbi_between_sort(sbi_between *b)
{
    int nodes = b->direct->node_count;
    memset(b->start, 0, (size_t)(nodes + 1) * sizeof *b->start);
    for (size_t e = 0; e < b->entry_count; e++)
        b->start[b->entries[e].position + 1]++;
    for (int k = 0; k < nodes; k++)
        b->start[k + 1] += b->start[k];
    for (size_t e = 0; e < b->entry_count; e++)
        b->sorted[b->start[b->entries[e].position]++] = (int)e;
    memmove(b->start + 1, b->start, (size_t)nodes * sizeof *b->start);
    b->start[0] = 0;
}

/* ---- forward ---- */

/* index and list of the groups that come by a front, in order; returns how many. */
static int sbi_between_list(sbi_between *b, const sbi_direct_piece *piece, int depth, int *list)
{
    int count = 0;
    for (int g = 0; g < b->groups; g++)
        b->index[g] = -1;
    for (int c = depth - piece->child_count; c < depth; c++)
        for (int k = 0; k < b->list_count[c]; k++)
            b->index[b->lists[(size_t)c * (size_t)b->groups + (size_t)k]] = 0;
    for (int k = b->start[piece->first]; k < b->start[piece->last]; k++)
        b->index[b->slot[b->entries[b->sorted[k]].left] / SBI_FRONT_GROUP] = 0;
    for (int g = 0; g < b->groups; g++)
        if (b->index[g] == 0) {
            b->index[g] = count;
            list[count++] = g;
        }
    return count;
}

/* Adds what a front below has left. */
static void sbi_between_extend(const sbi_between *b, int child, const int *list, int count, const sb_real *from,
                               size_t height, sb_real *x)
{
    const sbi_direct_piece *piece = b->direct->pieces + child;
    int own = piece->last - piece->first, below = piece->row_count - own;
    const int *rows = b->direct->rows + piece->row_start + own;
    for (int k = 0; k < count; k++) {
        sb_real *to = x + (size_t)b->index[list[k]] * height * SBI_FRONT_GROUP;
        for (int r = 0; r < below; r++, from += 3 * SBI_FRONT_GROUP) {
            sb_real *at = to + 3 * (size_t)b->place[rows[r]] * SBI_FRONT_GROUP;
            for (int i = 0; i < 3 * SBI_FRONT_GROUP; i++)
                at[i] += from[i];
        }
    }
}

static void sbi_between_scatter(const sbi_between *b, const sbi_direct_piece *piece, size_t height, sb_real *x)
{
    for (int k = b->start[piece->first]; k < b->start[piece->last]; k++) {
        const sbi_between_entry *e = b->entries + b->sorted[k];
        size_t group = (size_t)b->index[b->slot[e->left] / SBI_FRONT_GROUP];
        size_t row = 3 * (size_t)(e->position - piece->first);
        sb_real *at = x + (group * height + row) * SBI_FRONT_GROUP + b->slot[e->left] % SBI_FRONT_GROUP;
        at[0] += e->value.x;
        at[SBI_FRONT_GROUP] += e->value.y;
        at[2 * SBI_FRONT_GROUP] += e->value.z;
    }
}

/* A front's own rows of all groups go into the solution, by D of an indefinite factor; 0 of those that do not come by.
 */
static void sbi_between_keep(sbi_between *b, const sbi_direct_piece *piece, const sb_real *x)
{
    const sb_direct *d = b->direct;
    size_t height = 3 * (size_t)piece->row_count, values = 3 * (size_t)(piece->last - piece->first) * SBI_FRONT_GROUP;
    const sb_real *signs = d->signs + 3 * (size_t)piece->first;
    for (int g = 0; g < b->groups; g++) {
        sb_real *to = b->solution + 3 * ((size_t)g * (size_t)d->node_count + (size_t)piece->first) * SBI_FRONT_GROUP;
        if (b->index[g] < 0)
            memset(to, 0, values * sizeof *to);
        else
            memcpy(to, x + (size_t)b->index[g] * height * SBI_FRONT_GROUP, values * sizeof *to);
        for (size_t k = 0; k < values && d->kind == SB_DIRECT_LDLT; k++)
            to[k] *= signs[k / SBI_FRONT_GROUP];
    }
}

/* One front; what it leaves takes the place of what its children left. */
static void sbi_between_pass(sbi_between *b, int index, int *depth, size_t *used)
{
    const sb_direct *d = b->direct;
    const sbi_direct_piece *piece = d->pieces + index;
    int count;
    size_t height = 3 * (size_t)piece->row_count, width = 3 * (size_t)(piece->last - piece->first), base = *used;
    size_t left = (height - width) * SBI_FRONT_GROUP;
    sb_real *x = b->stack + *used;
    int *list = b->lists + (size_t)*depth * (size_t)b->groups;
    for (int r = 0; r < piece->row_count; r++)
        b->place[d->rows[piece->row_start + r]] = r;
    count = sbi_between_list(b, piece, *depth, list);
    memset(x, 0, (size_t)count * height * SBI_FRONT_GROUP * sizeof *x);
    for (int c = 0; c < piece->child_count; c++) {
        const sbi_direct_piece *child;
        --*depth;
        child = d->pieces + b->waiting[*depth];
        base -= (size_t)b->list_count[*depth] * 3 * (size_t)(child->row_count - (child->last - child->first)) *
                SBI_FRONT_GROUP;
        sbi_between_extend(b, b->waiting[*depth], b->lists + (size_t)*depth * (size_t)b->groups, b->list_count[*depth],
                           b->stack + base, height, x);
    }
    sbi_between_scatter(b, piece, height, x);
    sbi_front_forward_many(d->factor + piece->panel, height, width, x, count, b->pack, d->wide);
    sbi_between_keep(b, piece, x);
    for (int k = 0; k < count; k++)
        memmove(b->stack + base + (size_t)k * left, x + ((size_t)k * height + width) * SBI_FRONT_GROUP,
                left * sizeof *x);
    *used = base + (size_t)count * left;
    memmove(b->lists + (size_t)*depth * (size_t)b->groups, list, (size_t)count * sizeof *list);
    b->list_count[*depth] = count;
    b->waiting[(*depth)++] = index;
}

/* ---- backward, and the products ---- */

static void sbi_between_return(sbi_between *b, int index)
{
    const sb_direct *d = b->direct;
    const sbi_direct_piece *piece = d->pieces + index;
    for (int r = 0; r < 3 * piece->row_count; r++)
        b->rows[r] = 3 * d->rows[piece->row_start + r / 3] + r % 3;
    sbi_front_backward_many(d->factor + piece->panel, 3 * (size_t)piece->row_count,
                            3 * (size_t)(piece->last - piece->first), b->rows, b->solution, 3 * (size_t)d->node_count,
                            b->groups, b->pack, d->wide);
}

/* product[rights][3][GROUP] of one group's solution. */
static void sbi_between_multiply(const sbi_between *b, const sbi_between_rights *rights, const sb_real *solution,
                                 sb_real *product)
{
    enum { AXES = 3 * SBI_FRONT_GROUP, AHEAD = 8 }; /* nodes that are asked for before they are needed */
    const sb_direct *d = b->direct;
    memset(product, 0, (size_t)b->rights * AXES * sizeof *product);
    for (int i = 0; i < d->node_count; i++) {
        const sb_real *SB_RESTRICT from = solution + (size_t)d->position[i] * AXES;
        if (i + AHEAD < d->node_count && rights->start[i + AHEAD] < rights->start[i + AHEAD + 1])
            for (size_t axis = 0; axis < 3; axis++)
                SBI_PREFETCH(solution + (size_t)d->position[i + AHEAD] * AXES + axis * SBI_FRONT_GROUP, 0);
        for (int k = rights->start[i]; k < rights->start[i + 1]; k++) {
            sb_real *SB_RESTRICT to = product + (size_t)rights->columns[k] * AXES, weight = rights->weights[k];
            for (int a = 0; a < AXES; a++)
                to[a] += weight * from[a];
        }
    }
}

SBI_API sb_result sbi_between_run(sbi_between *b, const sbi_between_rights *rights)
{
    size_t used = 0, values = 3 * (size_t)b->direct->node_count * SBI_FRONT_GROUP;
    int depth = 0;
    if (!b->direct->ready)
        return SB_ERROR_ARGUMENT;
    sbi_between_arrange(b);
    sbi_between_sort(b);
    for (int s = 0; s < b->direct->piece_count; s++)
        sbi_between_pass(b, s, &depth, &used);
    for (int s = b->direct->piece_count - 1; s >= 0; s--)
        sbi_between_return(b, s);
    for (int g = 0; g < b->groups; g++)
        sbi_between_multiply(b, rights, b->solution + (size_t)g * values,
                             b->product + 3 * (size_t)g * (size_t)b->rights * SBI_FRONT_GROUP);
    return SB_OK;
}

SBI_API sb_vec3 sbi_between_get(const sbi_between *b, int left, int right)
{
    size_t group = (size_t)(b->slot[left] / SBI_FRONT_GROUP), lane = (size_t)(b->slot[left] % SBI_FRONT_GROUP);
    const sb_real *at = b->product + 3 * (group * (size_t)b->rights + (size_t)right) * SBI_FRONT_GROUP + lane;
    return sb_v3(at[0], at[SBI_FRONT_GROUP], at[2 * SBI_FRONT_GROUP]);
}
