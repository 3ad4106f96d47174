/* face_tree: building, refitting and asking a tree of boxes over faces. */
#include "face_tree.h"

#include <float.h>
#include <limits.h>
#include <string.h>

#include "../base/four.h"
#include "../base/lanes.h"

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
    tree->paths = NULL;
    if (room->width > 4)
        tree->paths = (sbi_face_path *)sbi_arena_take(arena, (size_t)room->nodes, sizeof(sbi_face_path));
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
    tree->node_count = 0;
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

/* A box while it is made. */
typedef struct sbi_face_span {
    sbi_four low, minus_high;
} sbi_face_span;

SBI_FORCE_INLINE sbi_face_span sbi_face_span_point(sbi_four x)
{
    sbi_face_span span;
    span.low = x;
    span.minus_high = sbi_four_sub(sbi_four_of(0), x);
    return span;
}

SBI_FORCE_INLINE sbi_face_span sbi_face_span_join(sbi_face_span a, sbi_face_span b)
{
    a.low = sbi_four_min(a.low, b.low);
    a.minus_high = sbi_four_min(a.minus_high, b.minus_high);
    return a;
}

/* Box of the control points of a quadratic face with nodes x[size]: its corners; of an edge with ends a, b and middle m
 * the point 2 m - (a + b) / 2; of a quad the same again across. */
SBI_FORCE_INLINE sbi_face_span sbi_face_span_controls(const sbi_four *x, int size)
{
    int corners = size == 6 ? 3 : 4;
    const sbi_four minus_half = sbi_four_of(-0.5f);
    sbi_four ends = x[0], middles = x[corners], centre;
    sbi_face_span span = sbi_face_span_point(x[0]);
    for (int a = 0; a < corners; a++) {
        sbi_four middle = x[corners + a], sum = sbi_four_add(x[a], x[a + 1 < corners ? a + 1 : 0]);
        span = sbi_face_span_join(span, sbi_face_span_point(x[a]));
        span =
            sbi_face_span_join(span, sbi_face_span_point(sbi_four_madd(sbi_four_add(middle, middle), minus_half, sum)));
        ends = a ? sbi_four_add(ends, x[a]) : ends;
        middles = a ? sbi_four_add(middles, middle) : middles;
    }
    if (size == 6)
        return span;
    /* quad8 has no node at its centre: its polynomial is (2 middles - ends) / 4 there */
    if (size == 8)
        centre = sbi_four_madd(middles, sbi_four_of(-0.75f), ends);
    else
        centre = sbi_four_sub(sbi_four_madd(sbi_four_mul(sbi_four_of(4), x[8]), sbi_four_of(0.25f), ends), middles);
    return sbi_face_span_join(span, sbi_face_span_point(centre));
}

/* Box of a quadratic face with these nodes, on its way. */
SBI_FORCE_INLINE sbi_face_span sbi_face_tree_span(const sbi_face_tree *tree, const int *corners, int size)
{
    sbi_four start[SBI_FACE_TREE_WIDEST], end[SBI_FACE_TREE_WIDEST];
    for (int a = 0; a < size; a++) {
        start[a] = sbi_four_load(tree->paths[corners[a]].start);
        end[a] = sbi_four_load(tree->paths[corners[a]].end);
    }
    return sbi_face_span_join(sbi_face_span_controls(start, size), sbi_face_span_controls(end, size));
}

/* Box of the ways of nodes. */
SBI_FORCE_INLINE void sbi_face_tree_join(const sbi_face_tree *tree, const int *corners, int count, sbi_face_box *box)
{
    sbi_eight all = sbi_eight_load(tree->ways[corners[0]].corner);
    for (int a = 1; a < count; a++)
        all = sbi_eight_min(all, sbi_eight_load(tree->ways[corners[a]].corner));
    sbi_eight_store(box->corner, all);
}

/* Box of the face at a place. */
SBI_FORCE_INLINE void sbi_face_tree_fit(const sbi_face_tree *tree, int place, int size, sbi_face_box *box)
{
    const int *corners = tree->corners + (size_t)place * (size_t)tree->room.width;
    sbi_face_span span;
    if (size <= 4) {
        sbi_face_tree_join(tree, corners, size, box);
        return;
    }
    span = sbi_face_tree_span(tree, corners, size);
    sbi_four_store(box->corner, span.low);
    sbi_four_store(box->corner + 4, span.minus_high);
}

static sbi_face_box sbi_face_tree_box(const sbi_face_tree *tree, int place)
{
    sbi_face_box box;
    switch (tree->sizes[place]) { /* loops of known length */
    case 3: sbi_face_tree_fit(tree, place, 3, &box); break;
    case 4: sbi_face_tree_fit(tree, place, 4, &box); break;
    case 6: sbi_face_tree_fit(tree, place, 6, &box); break;
    case 8: sbi_face_tree_fit(tree, place, 8, &box); break;
    default: sbi_face_tree_fit(tree, place, 9, &box); break;
    }
    return box;
}

SBI_API void sbi_face_tree_place_box(const sbi_face_tree *tree, int place, sb_vec3 *low, sb_vec3 *high)
{
    sb_vec3 spacing = sb_v3(tree->spacing, tree->spacing, tree->spacing);
    const sbi_face_box box = sbi_face_tree_box(tree, place);
    const float *c = box.corner;
    *low = sb_v3_sub(sb_v3_add(tree->origin, sb_v3((sb_real)c[0], (sb_real)c[1], (sb_real)c[2])), spacing);
    *high = sb_v3_add(sb_v3_sub(tree->origin, sb_v3((sb_real)c[4], (sb_real)c[5], (sb_real)c[6])), spacing);
}

/* ---- refitting ---- */

SBI_FORCE_INLINE sbi_four sbi_face_tree_four(sb_vec3 x) { return sbi_four_make((float)x.x, (float)x.y, (float)x.z, 0); }

/* Where a node is and will be, about the origin. whole: vectors may be read with the number behind them. */
SBI_FORCE_INLINE void sbi_face_tree_follow(const sb_vec3 *x, const sb_vec3 *v, sb_real dt, const sb_real *origin,
                                           int whole, sbi_four *start, sbi_four *end)
{
    sb_vec3 at;
#if SBI_HAS_LANES && (defined(__clang__) || __GNUC__ >= 9)
    if (whole) {
        sbi_lanes from = SBI_LANES_AT(&x->x) - SBI_LANES_AT(origin);
        *start = __builtin_convertvector(from, sbi_four);
        *end = __builtin_convertvector(from + dt * SBI_LANES_AT(&v->x), sbi_four);
        return;
    }
#endif
    (void)whole;
    at = sb_v3_sub(*x, sb_v3(origin[0], origin[1], origin[2]));
    *start = sbi_face_tree_four(at);
    *end = sbi_face_tree_four(sb_v3_madd(at, dt, *v));
}

static void sbi_face_tree_move(sbi_face_tree *tree, const sb_vec3 *x, const sb_vec3 *v, sb_real dt)
{
    const sb_real origin[4] = {tree->origin.x, tree->origin.y, tree->origin.z, 0};
    for (int i = 0; i < tree->node_count; i++) {
        int node = tree->nodes[i];
        sbi_four start, end;
        sbi_face_tree_follow(x + node, v + node, dt, origin, node < tree->room.node_end - 1, &start, &end);
        sbi_four_store(tree->ways[i].corner, sbi_four_min(start, end));
        sbi_four_store(tree->ways[i].corner + 4, sbi_four_sub(sbi_four_of(0), sbi_four_max(start, end)));
        if (tree->paths) {
            sbi_four_store(tree->paths[i].start, start);
            sbi_four_store(tree->paths[i].end, end);
        }
    }
}

/* Boxes of the leaves when all faces have `size` nodes. */
SBI_FORCE_INLINE void sbi_face_tree_fit_leaves(sbi_face_tree *tree, int size)
{
    const int step = SBI_FACE_TREE_LEAF * size;
    for (int leaf = 0; leaf < tree->leaf_count; leaf++)
        sbi_face_tree_join(tree, tree->corners + (size_t)leaf * (size_t)step, step, &tree->boxes[leaf]);
}

/* The same when they differ or are quadratic. */
static void sbi_face_tree_fit_any_leaves(sbi_face_tree *tree)
{
    for (int leaf = 0; leaf < tree->leaf_count; leaf++) {
        sbi_eight all = sbi_eight_load(sbi_face_tree_box(tree, SBI_FACE_TREE_LEAF * leaf).corner);
        for (int k = 1; k < SBI_FACE_TREE_LEAF; k++)
            all = sbi_eight_min(all, sbi_eight_load(sbi_face_tree_box(tree, SBI_FACE_TREE_LEAF * leaf + k).corner));
        sbi_eight_store(tree->boxes[leaf].corner, all);
    }
}

static void sbi_face_tree_fit_levels(sbi_face_tree *tree)
{
    for (int level = 1; level < tree->level_count; level++) {
        const sbi_face_box *below = tree->boxes + tree->level_start[level - 1];
        sbi_face_box *boxes = tree->boxes + tree->level_start[level];
        int last = tree->level_size[level - 1] - 1;
        for (int i = 0; i < tree->level_size[level]; i++)
            sbi_eight_store(boxes[i].corner, sbi_eight_min(sbi_eight_load(below[2 * i].corner),
                                                           sbi_eight_load(below[sbi_min_int(2 * i + 1, last)].corner)));
    }
}

/* Largest coordinate of the box of all, which no node and no control point exceeds. */
static void sbi_face_tree_measure(sbi_face_tree *tree)
{
    const float *all = tree->boxes[tree->level_start[tree->level_count - 1]].corner;
    float largest = 0;
    for (int k = 0; k < 7; k++)
        largest = k != 3 && -all[k] > largest ? -all[k] : largest;
    tree->spacing = SBI_FACE_TREE_ROUNDING * (sb_real)largest;
}

SBI_API void sbi_face_tree_refit(sbi_face_tree *tree, const sb_vec3 *x, const sb_vec3 *v, sb_real dt)
{
    if (tree->count == 0)
        return;
    tree->origin = x[tree->first_node];
    sbi_face_tree_move(tree, x, v ? v : x, v ? dt : 0);
    if (tree->size == 3)
        sbi_face_tree_fit_leaves(tree, 3);
    else if (tree->size == 4)
        sbi_face_tree_fit_leaves(tree, 4);
    else
        sbi_face_tree_fit_any_leaves(tree);
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

/* A query's box the other way round: upper corner, lower one with the other sign; a box that does not meet it has a
 * corner that exceeds it. */
static void sbi_face_tree_turn(const sbi_face_tree *tree, sb_vec3 low, sb_vec3 high, sbi_face_box *wanted)
{
    const sb_vec3 origin = tree->origin;
    const sb_real spacing = tree->spacing;
    float *c = wanted->corner;
    c[0] = sbi_face_tree_bound(high.x, origin.x, spacing);
    c[1] = sbi_face_tree_bound(high.y, origin.y, spacing);
    c[2] = sbi_face_tree_bound(high.z, origin.z, spacing);
    c[4] = -sbi_face_tree_bound(low.x, origin.x, -spacing);
    c[5] = -sbi_face_tree_bound(low.y, origin.y, -spacing);
    c[6] = -sbi_face_tree_bound(low.z, origin.z, -spacing);
    c[3] = c[7] = FLT_MAX;
}

SBI_FORCE_INLINE int sbi_face_tree_meets(const sbi_face_box *box, const sbi_face_box *wanted)
{
    return !(sbi_four_exceeds(sbi_four_load(box->corner), sbi_four_load(wanted->corner)) |
             sbi_four_exceeds(sbi_four_load(box->corner + 4), sbi_four_load(wanted->corner + 4)));
}

/* Faces that were marked, one bit each, and the range of words with their bits. */
typedef struct sbi_face_marks {
    uint64_t *words;
    int count, low, high;
} sbi_face_marks;

/* Marks what a leaf has that meets the box; size 0: faces differ or are quadratic. No branches: half of them meet it.
 */
SBI_FORCE_INLINE void sbi_face_tree_mark_leaf(const sbi_face_tree *tree, int leaf, int size, const sbi_face_box *wanted,
                                              sbi_face_marks *found)
{
    int place = SBI_FACE_TREE_LEAF * leaf, end = sbi_min_int(place + SBI_FACE_TREE_LEAF, tree->count);
    for (; place < end; place++) {
        sbi_face_box box;
        int face = tree->faces[place], word = face / SBI_FACE_TREE_BITS, meets;
        if (size)
            sbi_face_tree_fit(tree, place, size, &box);
        else
            box = sbi_face_tree_box(tree, place);
        meets = sbi_face_tree_meets(&box, wanted);
        found->words[word] |= (uint64_t)meets << face % SBI_FACE_TREE_BITS;
        found->low = sbi_min_int(found->low, meets ? word : found->low);
        found->high = sbi_max_int(found->high, meets ? word : found->high);
        found->count += meets;
    }
}

SBI_FORCE_INLINE int sbi_face_tree_leaves_out(const sbi_face_tree_groups *groups, int box)
{
    return groups->first[box] == groups->left_out && groups->last[box] == groups->left_out;
}

SBI_FORCE_INLINE void sbi_face_tree_mark(const sbi_face_tree *tree, int size, const sbi_face_box *wanted,
                                         const sbi_face_tree_groups *groups, sbi_face_marks *found)
{
    int levels[SBI_FACE_TREE_LEVELS + 1], nodes[SBI_FACE_TREE_LEVELS + 1], top = 0;
    levels[0] = tree->level_count - 1;
    nodes[0] = 0;
    top = sbi_face_tree_meets(&tree->boxes[tree->level_start[levels[0]]], wanted);
    while (top > 0) {
        int level = levels[--top], child = 2 * nodes[top], last;
        if (level == 0) {
            sbi_face_tree_mark_leaf(tree, nodes[top], size, wanted, found);
            continue;
        }
        last = sbi_min_int(child + 1, tree->level_size[--level] - 1);
        for (; child <= last; child++) {
            int box = tree->level_start[level] + child;
            levels[top] = level;
            nodes[top] = child;
            top += sbi_face_tree_meets(&tree->boxes[box], wanted) && !(groups && sbi_face_tree_leaves_out(groups, box));
        }
    }
}

/* Number of the lowest bit of a word that has one. */
SBI_FORCE_INLINE int sbi_face_tree_lowest(uint64_t word)
{
#if defined(__GNUC__)
    return __builtin_ctzll(word);
#else
    int bit = 0;
    while (!(word >> bit & 1))
        bit++;
    return bit;
#endif
}

SBI_API int sbi_face_tree_query_groups(const sbi_face_tree *tree, sb_vec3 low, sb_vec3 high,
                                       const sbi_face_tree_groups *groups, uint64_t *marks, int *faces, int capacity)
{
    sbi_face_marks found;
    sbi_face_box wanted;
    int written = 0;
    if (tree->count == 0)
        return 0;
    sbi_face_tree_turn(tree, low, high, &wanted);
    found.words = marks;
    found.low = INT_MAX;
    found.high = -1;
    found.count = 0;
    if (tree->size == 3)
        sbi_face_tree_mark(tree, 3, &wanted, groups, &found);
    else
        sbi_face_tree_mark(tree, 0, &wanted, groups, &found);
    for (int word = found.low; word <= found.high; word++) {
        uint64_t bits = marks[word];
        for (; bits && written < capacity; bits &= bits - 1)
            faces[written++] = SBI_FACE_TREE_BITS * word + sbi_face_tree_lowest(bits);
        marks[word] = 0;
    }
    return found.count;
}

SBI_API int sbi_face_tree_query(const sbi_face_tree *tree, sb_vec3 low, sb_vec3 high, uint64_t *marks, int *faces,
                                int capacity)
{
    return sbi_face_tree_query_groups(tree, low, high, NULL, marks, faces, capacity);
}
