/* cut_lists: arrays that grow. */
#include "cut_private.h"

#include <string.h>

SBI_API int sbi_cut_grow(const sb_allocator *allocator, void **items, int *capacity, int count, int more, size_t size)
{
    int64_t needed = (int64_t)count + more, roomy = *capacity ? needed + needed / 2 + 16 : needed;
    void *grown;
    if (needed <= *capacity)
        return 1;
    grown = roomy < INT32_MAX ? sbi_alloc(allocator, (size_t)roomy, size) : NULL;
    if (!grown)
        return 0;
    if (count)
        memcpy(grown, *items, (size_t)count * size);
    sbi_free(allocator, *items);
    *items = grown;
    *capacity = (int)roomy;
    return 1;
}

SBI_API int sbi_cut_list_grow(const sb_cut *cut, sbi_cut_list *list, int more)
{
    void *items = list->items;
    int grown = sbi_cut_grow(&cut->allocator, &items, &list->capacity, list->count, more, sizeof(int));
    list->items = (int *)items;
    return grown;
}

SBI_API void sbi_cut_list_set(sbi_cut_list *list, int at, int value)
{
    while (list->count <= at)
        list->items[list->count++] = -1;
    list->items[at] = value;
}

SBI_API int sbi_cut_reserve_links(sb_cut *cut, int more)
{
    sbi_cut_links *links = &cut->links, old = *links;
    int64_t capacity = 2 * (int64_t)links->count + more;
    sbi_cut_link *items;
    int *table;
    if (links->count + (int64_t)more <= links->capacity)
        return 1;
    if (capacity > INT32_MAX / 8)
        return 0;
    items = (sbi_cut_link *)sbi_alloc(&cut->allocator, (size_t)capacity, sizeof *items);
    table = (int *)sbi_alloc(&cut->allocator, (size_t)sbi_cut_links_table((int)capacity), sizeof *table);
    if (!items || !table) {
        sbi_free(&cut->allocator, items);
        sbi_free(&cut->allocator, table);
        return 0;
    }
    sbi_cut_links_move(links, items, table, (int)capacity);
    sbi_free(&cut->allocator, old.items);
    sbi_free(&cut->allocator, old.table);
    return 1;
}

static int sbi_cut_grow_tree(sb_cut *cut, int count)
{
    const sb_allocator *allocator = &cut->allocator;
    int capacity = cut->blade_capacity;
    int *order, *scratch;
    sbi_blade_box *boxes;
    uint64_t *codes;
    if (count <= cut->tree_capacity)
        return 1;
    order = (int *)sbi_alloc(allocator, (size_t)capacity, sizeof *order);
    scratch = (int *)sbi_alloc(allocator, (size_t)capacity, sizeof *scratch);
    codes = (uint64_t *)sbi_alloc(allocator, (size_t)capacity, sizeof *codes);
    boxes = (sbi_blade_box *)sbi_alloc(allocator, (size_t)sbi_blade_tree_boxes(capacity), sizeof *boxes);
    if (!order || !scratch || !codes || !boxes) {
        sbi_free(allocator, order);
        sbi_free(allocator, scratch);
        sbi_free(allocator, codes);
        sbi_free(allocator, boxes);
        return 0;
    }
    sbi_free(allocator, cut->tree.order);
    sbi_free(allocator, cut->tree.boxes);
    sbi_free(allocator, cut->blade_scratch);
    sbi_free(allocator, cut->blade_codes);
    cut->tree.order = order;
    cut->tree.boxes = boxes;
    cut->blade_scratch = scratch;
    cut->blade_codes = codes;
    cut->tree_capacity = capacity;
    return 1;
}

SBI_API int sbi_cut_reserve_blades(sb_cut *cut, int more)
{
    void *blades = cut->blades;
    int grown =
        sbi_cut_grow(&cut->allocator, &blades, &cut->blade_capacity, cut->blade_count, more, sizeof *cut->blades);
    cut->blades = (sbi_blade *)blades;
    return grown && sbi_cut_grow_tree(cut, cut->blade_count + more);
}
