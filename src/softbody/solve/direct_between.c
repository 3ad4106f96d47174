/* direct_between: see direct_between.h. Vectors are taken in groups as wide as the fronts' arithmetic, neighbours in
 * the elimination together; a front has the rows of all groups that come by, and leaves those below its own columns on
 * a stack, as the factorisation leaves its squares. */
#include <stdlib.h>
#include <string.h>

#include "direct_between.h"
#include "direct_private.h"

typedef struct sbi_between_entry {
    int column, position; /* of the vector; where its node is eliminated */
    sb_vec3 value;
} sbi_between_entry;

/* A vector's place in the elimination. */
typedef struct sbi_between_key {
    int first, last, column; /* positions of its entries */
} sbi_between_key;

struct sbi_between {
    sb_allocator allocator;
    void *memory; /* the one block behind all arrays */
    const sb_direct *direct;
    int sides[2];  /* lefts, rights */
    int groups[2]; /* of either */
    size_t entry_count, most_entries;
    size_t deepest;             /* rows on the stack at most, of all groups */
    int most_waiting;           /* fronts on it at most */
    sbi_between_entry *entries; /* [most_entries] as they came */
    int *sorted;                /* [most_entries] by position */
    int *start;                 /* [nodes + 1] into sorted */
    sbi_between_key *keys;      /* [vectors] */
    int *slot;                  /* [vectors] group times GROUP and lane */
    int *place;                 /* [nodes] of a column among the rows of the present front */
    int *index;                 /* [groups] of a group among those that come by, or -1 */
    int *lists;                 /* [most_waiting + 1][groups] groups that the waiting fronts have left rows of */
    int *list_count;            /* [most_waiting + 1] */
    int *waiting;               /* [most_waiting + 1] fronts */
    sb_real *stack;             /* [deepest][groups][GROUP] */
    sb_real *pack;              /* [SBI_FRONT_PACK] */
    sb_real *product;           /* [rights' groups][GROUP][lefts' groups][GROUP] */
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
    size_t n = (size_t)b->direct->node_count, vectors = (size_t)(b->sides[0] + b->sides[1]);
    size_t groups = (size_t)(b->groups[0] + b->groups[1]), waiting = (size_t)b->most_waiting + 1;
    size_t real = SBI_FRONT_GROUP * sizeof(sb_real);
    b->entries = (sbi_between_entry *)sbi_arena_take(arena, b->most_entries, sizeof(sbi_between_entry));
    b->sorted = (int *)sbi_arena_take(arena, b->most_entries, sizeof(int));
    b->start = (int *)sbi_arena_take(arena, n + 1, sizeof(int));
    b->keys = (sbi_between_key *)sbi_arena_take(arena, vectors, sizeof(sbi_between_key));
    b->slot = (int *)sbi_arena_take(arena, vectors, sizeof(int));
    b->place = (int *)sbi_arena_take(arena, n, sizeof(int));
    b->index = (int *)sbi_arena_take(arena, groups, sizeof(int));
    b->lists = (int *)sbi_arena_take(arena, waiting, groups * sizeof(int));
    b->list_count = (int *)sbi_arena_take(arena, waiting, sizeof(int));
    b->stack = (sb_real *)sbi_arena_take(arena, b->deepest, groups * real);
    b->pack = (sb_real *)sbi_arena_take(arena, SBI_FRONT_PACK, sizeof(sb_real));
    b->product = (sb_real *)sbi_arena_take(arena, (size_t)b->groups[1] * SBI_FRONT_GROUP, (size_t)b->groups[0] * real);
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
        b->sides[0] = lefts;
        b->sides[1] = rights;
        for (int side = 0; side < 2; side++)
            b->groups[side] = (b->sides[side] + SBI_FRONT_GROUP - 1) / SBI_FRONT_GROUP;
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

/* ---- vectors ---- */

SBI_API void sbi_between_clear(sbi_between *b) { b->entry_count = 0; }

SBI_API void sbi_between_add(sbi_between *b, int column, int node, sb_vec3 value)
{
    SB_ASSERT(b->entry_count < b->most_entries && column >= 0 && column < b->sides[0] + b->sides[1]);
    b->entries[b->entry_count].column = column;
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
    return p->column < q->column ? -1 : p->column > q->column;
}

/* slot: neighbours in the elimination go together, so that few fronts have a group come by for one of its vectors. */
static void sbi_between_arrange(sbi_between *b)
{
    int nodes = b->direct->node_count, vectors = b->sides[0] + b->sides[1];
    for (int k = 0; k < vectors; k++) {
        b->keys[k].first = nodes;
        b->keys[k].last = -1;
        b->keys[k].column = k;
    }
    for (size_t e = 0; e < b->entry_count; e++) {
        sbi_between_key *key = b->keys + b->entries[e].column;
        key->first = sbi_min_int(key->first, b->entries[e].position);
        key->last = sbi_max_int(key->last, b->entries[e].position);
    }
    for (int side = 0, from = 0; side < 2; from += b->sides[side++]) {
        qsort(b->keys + from, (size_t)b->sides[side], sizeof *b->keys, sbi_between_compare);
        for (int k = 0; k < b->sides[side]; k++)
            b->slot[b->keys[from + k].column] = (side ? b->groups[0] * SBI_FRONT_GROUP : 0) + k;
    }
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

/* ---- fronts ---- */

/* index and list of the groups that come by a front, in order; returns how many. */
static int sbi_between_list(sbi_between *b, const sbi_direct_piece *piece, int depth, int *list)
{
    int groups = b->groups[0] + b->groups[1], count = 0;
    for (int g = 0; g < groups; g++)
        b->index[g] = -1;
    for (int c = depth - piece->child_count; c < depth; c++)
        for (int k = 0; k < b->list_count[c]; k++)
            b->index[b->lists[(size_t)c * (size_t)groups + (size_t)k]] = 0;
    for (int k = b->start[piece->first]; k < b->start[piece->last]; k++)
        b->index[b->slot[b->entries[b->sorted[k]].column] / SBI_FRONT_GROUP] = 0;
    for (int g = 0; g < groups; g++)
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
        size_t group = (size_t)b->index[b->slot[e->column] / SBI_FRONT_GROUP];
        size_t row = 3 * (size_t)(e->position - piece->first);
        sb_real *at = x + (group * height + row) * SBI_FRONT_GROUP + b->slot[e->column] % SBI_FRONT_GROUP;
        at[0] += e->value.x;
        at[SBI_FRONT_GROUP] += e->value.y;
        at[2 * SBI_FRONT_GROUP] += e->value.z;
    }
}

/* Adds a front's own rows to the products of the groups that come by: list[lefts] are left ones, then right ones. */
static void sbi_between_multiply(sbi_between *b, const sbi_direct_piece *piece, const int *list, int lefts, int count,
                                 const sb_real *x)
{
    size_t size = 3 * (size_t)piece->row_count * SBI_FRONT_GROUP, stride = (size_t)b->groups[0] * SBI_FRONT_GROUP;
    int width = 3 * (piece->last - piece->first);
    for (int r = lefts; r < count; r++) {
        sb_real *to = b->product + (size_t)(list[r] - b->groups[0]) * SBI_FRONT_GROUP * stride;
        for (int l = 0; l < lefts; l++)
            sbi_front_add_products(x + (size_t)l * size, x + (size_t)r * size, width,
                                   to + (size_t)list[l] * SBI_FRONT_GROUP, stride);
    }
}

/* D of an indefinite factor. */
static void sbi_between_sign(const sb_direct *d, const sbi_direct_piece *piece, int lefts, sb_real *x)
{
    size_t height = 3 * (size_t)piece->row_count, width = 3 * (size_t)(piece->last - piece->first);
    for (int l = 0; l < lefts; l++)
        for (size_t k = 0; k < width * SBI_FRONT_GROUP; k++)
            x[(size_t)l * height * SBI_FRONT_GROUP + k] *= d->signs[3 * (size_t)piece->first + k / SBI_FRONT_GROUP];
}

/* One front; what it leaves takes the place of what its children left. */
static void sbi_between_pass(sbi_between *b, int index, int *depth, size_t *used)
{
    const sb_direct *d = b->direct;
    const sbi_direct_piece *piece = d->pieces + index;
    int groups = b->groups[0] + b->groups[1], lefts = 0, count;
    size_t height = 3 * (size_t)piece->row_count, width = 3 * (size_t)(piece->last - piece->first), base = *used;
    size_t left = (height - width) * SBI_FRONT_GROUP;
    sb_real *x = b->stack + *used;
    int *list = b->lists + (size_t)*depth * (size_t)groups;
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
        sbi_between_extend(b, b->waiting[*depth], b->lists + (size_t)*depth * (size_t)groups, b->list_count[*depth],
                           b->stack + base, height, x);
    }
    sbi_between_scatter(b, piece, height, x);
    sbi_front_forward_many(d->factor + piece->panel, height, width, x, count, b->pack);
    while (lefts < count && list[lefts] < b->groups[0])
        lefts++;
    if (d->kind == SB_DIRECT_LDLT)
        sbi_between_sign(d, piece, lefts, x);
    sbi_between_multiply(b, piece, list, lefts, count, x);
    for (int k = 0; k < count; k++)
        memmove(b->stack + base + (size_t)k * left, x + ((size_t)k * height + width) * SBI_FRONT_GROUP,
                left * sizeof *x);
    *used = base + (size_t)count * left;
    memmove(b->lists + (size_t)*depth * (size_t)groups, list, (size_t)count * sizeof *list);
    b->list_count[*depth] = count;
    b->waiting[(*depth)++] = index;
}

SBI_API sb_result sbi_between_run(sbi_between *b)
{
    size_t used = 0;
    int depth = 0;
    if (!b->direct->ready)
        return SB_ERROR_ARGUMENT;
    sbi_between_arrange(b);
    sbi_between_sort(b);
    memset(b->product, 0,
           (size_t)b->groups[0] * (size_t)b->groups[1] * SBI_FRONT_GROUP * SBI_FRONT_GROUP * sizeof *b->product);
    for (int s = 0; s < b->direct->piece_count; s++)
        sbi_between_pass(b, s, &depth, &used);
    return SB_OK;
}

SBI_API sb_real sbi_between_get(const sbi_between *b, int left, int right)
{
    size_t row = (size_t)(b->slot[b->sides[0] + right] - b->groups[0] * SBI_FRONT_GROUP);
    return b->product[row * (size_t)b->groups[0] * SBI_FRONT_GROUP + (size_t)b->slot[left]];
}
