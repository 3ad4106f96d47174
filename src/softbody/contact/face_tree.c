/* face_tree: building, refitting and asking a tree of boxes over faces. */
#include "face_tree.h"

#include <float.h>
#include <string.h>

#include "../base/four.h"

/* Roundings of a box, each of half an epsilon of the largest coordinate: of a place's conversion, twice over, and
 * twelve of a control point, whose terms sum up to nine times that coordinate. */
#define SBI_FACE_TREE_ROUNDING ((sb_real)64 * (sb_real)FLT_EPSILON)

/* ---- memory ---- */

static int sbi_face_tree_leaves(int faces) { return faces / SBI_FACE_TREE_LEAF + (faces % SBI_FACE_TREE_LEAF != 0); }

static void sbi_face_tree_layout(sbi_face_tree *tree, sbi_arena *arena)
{
    const sbi_face_tree_room *room = &tree->room;
    size_t leaves = (size_t)sbi_face_tree_leaves(room->faces), places = leaves * SBI_FACE_TREE_LEAF;
    /* levels shrink by half, rounded up: one more each at most */
    tree->boxes = (sbi_face_box *)sbi_arena_take(arena, 2 * leaves + SBI_FACE_TREE_LEVELS, sizeof(sbi_face_box));
    tree->ways = (sbi_face_box *)sbi_arena_take(arena, (size_t)room->nodes, sizeof(sbi_face_box));
    tree->corners = (int *)sbi_arena_take(arena, places, (size_t)room->width * sizeof(int));
    tree->faces = (int *)sbi_arena_take(arena, places, sizeof(int));
    tree->nodes = (int *)sbi_arena_take(arena, (size_t)room->nodes, sizeof(int));
    tree->numbers = (int *)sbi_arena_take(arena, (size_t)room->node_end, sizeof(int));
    tree->sizes = (unsigned char *)sbi_arena_take(arena, places, 1);
}

SBI_API int sbi_face_tree_create(const sbi_face_tree_room *room, const sb_allocator *allocator, sbi_face_tree *tree)
{
    sbi_arena arena = {NULL, 0, 0};
    memset(tree, 0, sizeof *tree);
    tree->room = *room;
    sbi_face_tree_layout(tree, &arena);
    tree->memory = arena.overflow ? NULL : sbi_alloc(allocator, arena.used, 1);
    if (!tree->memory)
        return 0;
    arena.base = (unsigned char *)tree->memory;
    arena.used = 0;
    sbi_face_tree_layout(tree, &arena);
    for (int i = 0; i < room->node_end; i++)
        tree->numbers[i] = -1;
    return 1;
}

SBI_API void sbi_face_tree_free(sbi_face_tree *tree, const sb_allocator *allocator)
{
    sbi_free(allocator, tree->memory);
    memset(tree, 0, sizeof *tree);
}

/* ---- building ---- */

static void sbi_face_tree_stack_levels(sbi_face_tree *tree)
{
    int start = 0, size = tree->leaf_count;
    tree->level_count = 0;
    while (size > 0) {
        tree->level_start[tree->level_count] = start;
        tree->level_size[tree->level_count++] = size;
        start += size;
        size = size > 1 ? size / 2 + size % 2 : 0;
    }
}

static void sbi_face_tree_put(sbi_face_tree *tree, int place, const sbi_face_tree_source *source, int face)
{
    int width = tree->room.width, size = source->sizes[face];
    const int *nodes = source->nodes + (size_t)face * (size_t)width;
    int *corners = tree->corners + (size_t)place * (size_t)width;
    tree->faces[place] = face;
    tree->sizes[place] = (unsigned char)size;
    if (size != width)
        tree->size = 0;
    tree->quadratic |= size > 4;
    for (int a = 0; a < size; a++) {
        int *number = tree->numbers + nodes[a];
        if (*number < 0) {
            *number = tree->node_count++;
            tree->nodes[*number] = nodes[a];
        }
        corners[a] = *number;
    }
}

SBI_API void sbi_face_tree_build(sbi_face_tree *tree, const sbi_face_tree_source *source)
{
    tree->count = source->count;
    tree->leaf_count = sbi_face_tree_leaves(source->count);
    tree->node_count = tree->quadratic = 0;
    tree->size = tree->room.width;
    for (int p = 0; p < SBI_FACE_TREE_LEAF * tree->leaf_count; p++)
        sbi_face_tree_put(tree, p, source, source->faces[sbi_min_int(p, source->count - 1)]);
    for (int i = 0; i < tree->node_count; i++) {
        tree->first_node = i ? sbi_min_int(tree->first_node, tree->nodes[i]) : tree->nodes[i];
        tree->numbers[tree->nodes[i]] = -1;
    }
    sbi_face_tree_stack_levels(tree);
}

/* ---- boxes of faces ---- */

typedef struct sbi_face_span {
    sbi_four low, high;
} sbi_face_span;

SBI_FORCE_INLINE sbi_face_span sbi_face_span_load(const sbi_face_box *box)
{
    sbi_face_span span;
    span.low = sbi_four_load(box->low);
    span.high = sbi_four_load(box->high);
    return span;
}

SBI_FORCE_INLINE void sbi_face_span_join(sbi_face_span *span, const sbi_face_box *box)
{
    span->low = sbi_four_min(span->low, sbi_four_load(box->low));
    span->high = sbi_four_max(span->high, sbi_four_load(box->high));
}

SBI_FORCE_INLINE void sbi_face_span_grow(sbi_face_span *span, sbi_four x)
{
    span->low = sbi_four_min(span->low, x);
    span->high = sbi_four_max(span->high, x);
}

SBI_FORCE_INLINE void sbi_face_span_store(sbi_face_box *box, const sbi_face_span *span)
{
    sbi_four_store(box->low, span->low);
    sbi_four_store(box->high, span->high);
}

/* Grows the span by the control points of a quadratic face with nodes x[size]: its corners; of an edge with ends a, b
 * and middle m the point 2 m - (a + b) / 2; of a quad the same again across. */
SBI_FORCE_INLINE void sbi_face_tree_add_controls(const sbi_four *x, int size, sbi_face_span *span)
{
    int corners = size == 6 ? 3 : 4;
    sbi_four half = sbi_four_of(-0.5f), ends = x[0], middles = x[corners], centre;
    for (int a = 0; a < corners; a++) {
        sbi_four middle = x[corners + a];
        sbi_face_span_grow(span, x[a]);
        sbi_face_span_grow(span, sbi_four_madd(sbi_four_add(middle, middle), half,
                                               sbi_four_add(x[a], x[a + 1 < corners ? a + 1 : 0])));
        ends = a ? sbi_four_add(ends, x[a]) : ends;
        middles = a ? sbi_four_add(middles, middle) : middles;
    }
    if (size == 6)
        return;
    /* quad8 has no node at its centre: its polynomial is (2 middles - ends) / 4 there */
    if (size == 8)
        centre = sbi_four_madd(middles, sbi_four_of(-0.75f), ends);
    else
        centre = sbi_four_madd(sbi_four_madd(sbi_four_mul(sbi_four_of(4), x[8]), sbi_four_of(0.25f), ends),
                               sbi_four_of(-1), middles);
    sbi_face_span_grow(span, centre);
}

/* Box of the face at a place. */
SBI_FORCE_INLINE sbi_face_span sbi_face_tree_span(const sbi_face_tree *tree, int place, int size)
{
    const int *corners = tree->corners + (size_t)place * (size_t)tree->room.width;
    sbi_face_span span = sbi_face_span_load(&tree->ways[corners[0]]);
    sbi_four x[SBI_FACE_TREE_WIDEST];
    if (tree->quadratic) { /* starts and ends lie on either side of each other */
        sbi_four start = span.low;
        span.low = sbi_four_min(start, span.high);
        span.high = sbi_four_max(start, span.high);
    }
    for (int a = 1; a < size && size <= 4; a++) {
        sbi_face_span_grow(&span, sbi_four_load(tree->ways[corners[a]].low));
        sbi_face_span_grow(&span, sbi_four_load(tree->ways[corners[a]].high));
    }
    if (size <= 4)
        return span;
    for (int a = 0; a < size; a++)
        x[a] = sbi_four_load(tree->ways[corners[a]].low);
    sbi_face_tree_add_controls(x, size, &span);
    for (int a = 0; a < size; a++)
        x[a] = sbi_four_load(tree->ways[corners[a]].high);
    sbi_face_tree_add_controls(x, size, &span);
    return span;
}

SBI_API void sbi_face_tree_place_box(const sbi_face_tree *tree, int place, sb_vec3 *low, sb_vec3 *high)
{
    sbi_face_span span = sbi_face_tree_span(tree, place, tree->sizes[place]);
    sbi_face_box box;
    sb_vec3 spacing = sb_v3(tree->spacing, tree->spacing, tree->spacing);
    sbi_face_span_store(&box, &span);
    *low = sb_v3_sub(sb_v3_add(tree->origin, sb_v3(box.low[0], box.low[1], box.low[2])), spacing);
    *high = sb_v3_add(sb_v3_add(tree->origin, sb_v3(box.high[0], box.high[1], box.high[2])), spacing);
}

/* ---- refitting ---- */

SBI_FORCE_INLINE sbi_four sbi_face_tree_place(sb_vec3 x)
{
    return sbi_four_make((float)x.x, (float)x.y, (float)x.z, 0);
}

SBI_FORCE_INLINE void sbi_face_tree_move(sbi_face_tree *tree, const sb_vec3 *x, const sb_vec3 *v, sb_real dt,
                                         int quadratic)
{
    const sb_vec3 origin = tree->origin;
    for (int i = 0; i < tree->node_count; i++) {
        sb_vec3 at = sb_v3_sub(x[tree->nodes[i]], origin);
        sbi_four start = sbi_face_tree_place(at), end = start;
        if (v)
            end = sbi_face_tree_place(sb_v3_madd(at, dt, v[tree->nodes[i]]));
        sbi_four_store(tree->ways[i].low, quadratic ? start : sbi_four_min(start, end));
        sbi_four_store(tree->ways[i].high, quadratic ? end : sbi_four_max(start, end));
    }
}

/* Boxes of the leaves whose faces have `size` nodes, all of them linear: the boxes of their corners together. */
SBI_FORCE_INLINE void sbi_face_tree_fit_linear(sbi_face_tree *tree, int size)
{
    for (int leaf = 0; leaf < tree->leaf_count; leaf++) {
        const int *corners = tree->corners + (size_t)leaf * (size_t)(SBI_FACE_TREE_LEAF * size);
        sbi_face_span span = sbi_face_span_load(&tree->ways[corners[0]]);
        for (int a = 1; a < SBI_FACE_TREE_LEAF * size; a++)
            sbi_face_span_join(&span, &tree->ways[corners[a]]);
        sbi_face_span_store(&tree->boxes[leaf], &span);
    }
}

/* Boxes of the leaves; size 0: faces differ. */
SBI_FORCE_INLINE void sbi_face_tree_fit_leaves(sbi_face_tree *tree, int size)
{
    for (int leaf = 0; leaf < tree->leaf_count; leaf++) {
        int place = SBI_FACE_TREE_LEAF * leaf;
        sbi_face_span span = sbi_face_tree_span(tree, place, size ? size : tree->sizes[place]);
        for (int k = 1; k < SBI_FACE_TREE_LEAF; k++) {
            sbi_face_span other = sbi_face_tree_span(tree, place + k, size ? size : tree->sizes[place + k]);
            span.low = sbi_four_min(span.low, other.low);
            span.high = sbi_four_max(span.high, other.high);
        }
        sbi_face_span_store(&tree->boxes[leaf], &span);
    }
}

static void sbi_face_tree_fit_levels(sbi_face_tree *tree)
{
    for (int level = 1; level < tree->level_count; level++) {
        const sbi_face_box *below = tree->boxes + tree->level_start[level - 1];
        int last = tree->level_size[level - 1] - 1;
        for (int i = 0; i < tree->level_size[level]; i++) {
            sbi_face_span span = sbi_face_span_load(&below[2 * i]);
            sbi_face_span_join(&span, &below[sbi_min_int(2 * i + 1, last)]);
            sbi_face_span_store(&tree->boxes[tree->level_start[level] + i], &span);
        }
    }
}

/* Largest coordinate of the box of all, which no node and no control point exceeds. */
static void sbi_face_tree_measure(sbi_face_tree *tree)
{
    const sbi_face_box *all = &tree->boxes[tree->level_start[tree->level_count - 1]];
    float largest = 0;
    for (int k = 0; k < 3; k++) {
        largest = -all->low[k] > largest ? -all->low[k] : largest;
        largest = all->high[k] > largest ? all->high[k] : largest;
    }
    tree->spacing = SBI_FACE_TREE_ROUNDING * (sb_real)largest;
}

SBI_API void sbi_face_tree_refit(sbi_face_tree *tree, const sb_vec3 *x, const sb_vec3 *v, sb_real dt)
{
    if (tree->count == 0)
        return;
    tree->origin = x[tree->first_node];
    if (tree->quadratic)
        sbi_face_tree_move(tree, x, v, dt, 1);
    else
        sbi_face_tree_move(tree, x, v, dt, 0);
    switch (tree->size) { /* loops of known length */
    case 3: sbi_face_tree_fit_linear(tree, 3); break;
    case 4: sbi_face_tree_fit_linear(tree, 4); break;
    case 6: sbi_face_tree_fit_leaves(tree, 6); break;
    case 8: sbi_face_tree_fit_leaves(tree, 8); break;
    case 9: sbi_face_tree_fit_leaves(tree, 9); break;
    default: sbi_face_tree_fit_leaves(tree, 0); break;
    }
    sbi_face_tree_fit_levels(tree);
    sbi_face_tree_measure(tree);
}

/* ---- asking ---- */

/* A coordinate of a query's box about the origin; beyond all floats is as good as at their end. */
static float sbi_face_tree_bound(sb_real x, sb_real origin, sb_real spacing)
{
    const sb_real most = (sb_real)FLT_MAX / 4;
    return (float)(sb_max(sb_min(x, most), -most) - origin + spacing);
}

SBI_FORCE_INLINE int sbi_face_tree_meets(const sbi_face_box *a, const sbi_face_box *b)
{
    return !((a->low[0] > b->high[0]) | (a->low[1] > b->high[1]) | (a->low[2] > b->high[2]) | (a->high[0] < b->low[0]) |
             (a->high[1] < b->low[1]) | (a->high[2] < b->low[2]));
}

/* Faces that were marked, and the range of their numbers. */
typedef struct sbi_face_marks {
    unsigned char *marks;
    int count, low, high;
} sbi_face_marks;

static void sbi_face_tree_mark_leaf(const sbi_face_tree *tree, int leaf, const sbi_face_box *wanted,
                                    sbi_face_marks *found)
{
    int place = SBI_FACE_TREE_LEAF * leaf, end = sbi_min_int(place + SBI_FACE_TREE_LEAF, tree->count);
    for (; place < end; place++) {
        sbi_face_span span = sbi_face_tree_span(tree, place, tree->sizes[place]);
        sbi_face_box box;
        int face = tree->faces[place];
        sbi_face_span_store(&box, &span);
        if (!sbi_face_tree_meets(&box, wanted))
            continue;
        found->marks[face] = 1;
        found->low = found->count ? sbi_min_int(found->low, face) : face;
        found->high = found->count ? sbi_max_int(found->high, face) : face;
        found->count++;
    }
}

static void sbi_face_tree_mark(const sbi_face_tree *tree, const sbi_face_box *wanted, sbi_face_marks *found)
{
    int levels[SBI_FACE_TREE_LEVELS + 1], nodes[SBI_FACE_TREE_LEVELS + 1], top = 0;
    levels[top] = tree->level_count - 1;
    nodes[top++] = 0;
    while (top > 0) {
        int level = levels[--top], node = nodes[top];
        if (!sbi_face_tree_meets(&tree->boxes[tree->level_start[level] + node], wanted))
            continue;
        if (level == 0) {
            sbi_face_tree_mark_leaf(tree, node, wanted, found);
            continue;
        }
        for (int child = sbi_min_int(2 * node + 1, tree->level_size[level - 1] - 1); child >= 2 * node; child--) {
            levels[top] = level - 1;
            nodes[top++] = child;
        }
    }
}

SBI_API int sbi_face_tree_query(const sbi_face_tree *tree, sb_vec3 low, sb_vec3 high, unsigned char *marks, int *faces,
                                int capacity)
{
    const sb_vec3 origin = tree->origin;
    const sb_real spacing = tree->spacing;
    sbi_face_marks found;
    sbi_face_box wanted;
    unsigned char *at, *end;
    if (tree->count == 0)
        return 0;
    memset(&wanted, 0, sizeof wanted);
    wanted.low[0] = sbi_face_tree_bound(low.x, origin.x, -spacing);
    wanted.low[1] = sbi_face_tree_bound(low.y, origin.y, -spacing);
    wanted.low[2] = sbi_face_tree_bound(low.z, origin.z, -spacing);
    wanted.high[0] = sbi_face_tree_bound(high.x, origin.x, spacing);
    wanted.high[1] = sbi_face_tree_bound(high.y, origin.y, spacing);
    wanted.high[2] = sbi_face_tree_bound(high.z, origin.z, spacing);
    memset(&found, 0, sizeof found);
    found.marks = marks;
    sbi_face_tree_mark(tree, &wanted, &found);
    at = marks + found.low;
    end = marks + found.high + 1;
    for (int i = 0; i < found.count; i++, at++) {
        at = (unsigned char *)memchr(at, 1, (size_t)(end - at));
        *at = 0;
        if (i < capacity)
            faces[i] = (int)(at - marks);
    }
    return found.count;
}
