/* cut_links: a table of the links that have been cut. */
#include "cut_links.h"

#include <string.h>

SBI_API int sbi_cut_links_table(int capacity)
{
    int size = 16;
    while (size / 2 < capacity && size < INT32_MAX / 2)
        size *= 2;
    return size;
}

/* Place of a key in the table, or the free one where it belongs. */
static int sbi_cut_links_slot(const sbi_cut_links *links, const sbi_link_key *key)
{
    unsigned mask = (unsigned)links->table_size - 1;
    uint64_t mixed = 0;
    for (int i = 0; i < 4; i++) {
        mixed = (mixed ^ (unsigned)key->at[i]) * UINT64_C(0x9e3779b97f4a7c15);
        mixed ^= mixed >> 32;
    }
    for (unsigned slot = (unsigned)mixed & mask;; slot = (slot + 1) & mask) {
        int item = links->table[slot] - 1;
        if (item < 0 || memcmp(&links->items[item].key, key, sizeof *key) == 0)
            return (int)slot;
    }
}

SBI_API void sbi_cut_links_move(sbi_cut_links *links, sbi_cut_link *items, int *table, int capacity)
{
    if (links->count)
        memcpy(items, links->items, (size_t)links->count * sizeof *items);
    links->table_size = sbi_cut_links_table(capacity);
    memset(table, 0, (size_t)links->table_size * sizeof *table);
    links->items = items;
    links->table = table;
    links->capacity = capacity;
    for (int i = 0; i < links->count; i++)
        table[sbi_cut_links_slot(links, &items[i].key)] = i + 1;
}

SBI_API int sbi_cut_links_find(const sbi_cut_links *links, const sbi_link_key *key)
{
    return links->count ? links->table[sbi_cut_links_slot(links, key)] - 1 : -1;
}

SBI_API void sbi_cut_links_add(sbi_cut_links *links, const sbi_link_key *key, sb_real t, int state)
{
    sbi_cut_link *item = links->items + links->count;
    SB_ASSERT(links->count < links->capacity && sbi_cut_links_find(links, key) < 0);
    links->table[sbi_cut_links_slot(links, key)] = ++links->count;
    item->key = *key;
    item->t = t;
    item->state = (short)state;
    item->charred = 0;
    item->struck = -1;
}

SBI_API void sbi_cut_links_truncate(sbi_cut_links *links, int count)
{
    while (links->count > count) { /* the last one added is in nobody's way */
        links->table[sbi_cut_links_slot(links, &links->items[links->count - 1].key)] = 0;
        links->count--;
    }
}
