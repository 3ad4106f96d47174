/* blade_tree: a tree of boxes over blades. */
#include "blade_tree.h"

#include "../base/sort.h"

static int sbi_blade_boxes_meet(const sbi_blade_box *a, const sbi_int3 *low, const sbi_int3 *high)
{
    return a->low.x <= high->x && a->low.y <= high->y && a->low.z <= high->z && a->high.x >= low->x &&
           a->high.y >= low->y && a->high.z >= low->z;
}

static void sbi_blade_box_add(sbi_blade_box *box, const sbi_int3 *low, const sbi_int3 *high)
{
    box->low.x = sbi_min_int(box->low.x, low->x);
    box->low.y = sbi_min_int(box->low.y, low->y);
    box->low.z = sbi_min_int(box->low.z, low->z);
    box->high.x = sbi_max_int(box->high.x, high->x);
    box->high.y = sbi_max_int(box->high.y, high->y);
    box->high.z = sbi_max_int(box->high.z, high->z);
}

/* The upper 21 bits of a coordinate in the frame, three apart. */
static uint64_t sbi_blade_spread(int coordinate)
{
    uint64_t bits = ((uint64_t)(coordinate + (int64_t)SBI_CROSSING_BLADE)) >> 9, code = 0;
    for (int i = 0; i < 21; i++)
        code |= (bits >> i & 1) << (3 * i);
    return code;
}

/* Place of a blade's middle along the curve. */
static uint64_t sbi_blade_code(const sbi_blade *blade)
{
    int x = blade->low.x / 2 + blade->high.x / 2, y = blade->low.y / 2 + blade->high.y / 2;
    return sbi_blade_spread(x) | sbi_blade_spread(y) << 1 | sbi_blade_spread(blade->low.z / 2 + blade->high.z / 2) << 2;
}

static int sbi_blade_is_before(const void *context, int a, int b)
{
    const uint64_t *codes = (const uint64_t *)context;
    return codes[a] < codes[b];
}

static sbi_blade_box sbi_blade_leaf_box(const sbi_blade_tree *tree, int leaf)
{
    sbi_blade_box box;
    int end = sbi_min_int(SBI_BLADE_LEAF * (leaf + 1), tree->count);
    box.low = tree->blades[tree->order[SBI_BLADE_LEAF * leaf]].low;
    box.high = tree->blades[tree->order[SBI_BLADE_LEAF * leaf]].high;
    for (int k = SBI_BLADE_LEAF * leaf + 1; k < end; k++)
        sbi_blade_box_add(&box, &tree->blades[tree->order[k]].low, &tree->blades[tree->order[k]].high);
    return box;
}

SBI_API void sbi_blade_tree_make(sbi_blade_tree *tree, const sbi_blade *blades, int count, uint64_t *codes,
                                 int *scratch)
{
    int size = (count + SBI_BLADE_LEAF - 1) / SBI_BLADE_LEAF, first = 0;
    tree->blades = blades;
    tree->count = count;
    tree->level_count = 0;
    for (int k = 0; k < count; k++) {
        tree->order[k] = k;
        codes[k] = sbi_blade_code(blades + k);
    }
    sbi_merge_sort(tree->order, scratch, count, sbi_blade_is_before, codes);
    for (int leaf = 0; leaf < size; leaf++)
        tree->boxes[leaf] = sbi_blade_leaf_box(tree, leaf);
    while (size > 0) {
        const sbi_blade_box *below = tree->boxes + first;
        int next = first + size;
        tree->level_first[tree->level_count] = first;
        tree->level_size[tree->level_count++] = size;
        for (int k = 0; k < size && size > 1; k += 2) {
            sbi_blade_box *box = tree->boxes + next + k / 2;
            *box = below[k];
            if (k + 1 < size)
                sbi_blade_box_add(box, &below[k + 1].low, &below[k + 1].high);
        }
        first = next;
        size = size > 1 ? (size + 1) / 2 : 0;
    }
}

/* Remembers a box to be looked into, where it meets the walk's. */
static void sbi_blade_walk_put(const sbi_blade_tree *tree, sbi_blade_walk *walk, int level, int place)
{
    if (place >= tree->level_size[level] ||
        !sbi_blade_boxes_meet(tree->boxes + tree->level_first[level] + place, &walk->box.low, &walk->box.high))
        return;
    walk->levels[walk->waiting] = level;
    walk->places[walk->waiting++] = place;
}

SBI_API void sbi_blade_walk_begin(const sbi_blade_tree *tree, const sbi_blade_box *box, sbi_blade_walk *walk)
{
    walk->box = *box;
    walk->waiting = walk->at = walk->end = 0;
    if (tree->level_count > 0)
        sbi_blade_walk_put(tree, walk, tree->level_count - 1, 0);
}

SBI_API int sbi_blade_walk_next(const sbi_blade_tree *tree, sbi_blade_walk *walk)
{
    for (;;) {
        int level, place;
        while (walk->at < walk->end) {
            int blade = tree->order[walk->at++];
            if (sbi_blade_boxes_meet(&walk->box, &tree->blades[blade].low, &tree->blades[blade].high))
                return blade;
        }
        if (walk->waiting == 0)
            return -1;
        walk->waiting--;
        level = walk->levels[walk->waiting];
        place = walk->places[walk->waiting];
        if (level == 0) {
            walk->at = SBI_BLADE_LEAF * place;
            walk->end = sbi_min_int(walk->at + SBI_BLADE_LEAF, tree->count);
        } else {
            sbi_blade_walk_put(tree, walk, level - 1, 2 * place);
            sbi_blade_walk_put(tree, walk, level - 1, 2 * place + 1);
        }
    }
}
