/* cut_links: the links that have been cut, by their names. Internal. Floor 4, calls base and mesh only.
 *
 * Only cut links are kept, in the order in which they were cut, and found by a table of open addresses: an uncut mesh
 * costs nothing, whatever its lattice. The caller owns the arrays. */
#ifndef SB_CUT_LINKS_H
#define SB_CUT_LINKS_H

#include "lattice.h"

typedef struct sbi_cut_link {
    sbi_link_key key;
    sb_real t;     /* of the crossing, 0 at the link's first end (sbi_lattice_ends), 1 at the other */
    int struck;    /* blade that has cut it, or that it is predicted by, in the frame at work; else -1 */
    short state;   /* SBI_LINK_... , not 0 */
    short charred; /* 1: material at one of its ends was taken out, and parted it */
} sbi_cut_link;

/* Predicted: it parts pieces like a cut one, but no blade has crossed it yet. */
enum { SBI_LINK_WHOLE = 0, SBI_LINK_CUT = 1, SBI_LINK_PREDICTED = 2 };

typedef struct sbi_cut_links {
    int count, capacity;
    sbi_cut_link *items; /* [capacity] in the order they were cut */
    int *table;          /* [table_size] 1 + item, or 0 */
    int table_size;      /* sbi_cut_links_table(capacity) */
    uint64_t *lost;      /* [tets] points of each tet's lattice whose material was taken out; NULL: none. Links from
                          * them to others are cut */
} sbi_cut_links;

/* Entries of the table for so many links: a power of two. */
SBI_API int sbi_cut_links_table(int capacity);
/* Takes new arrays with room for `capacity` links, at least as many as there are; the old ones are the caller's to
 * free. */
SBI_API void sbi_cut_links_move(sbi_cut_links *links, sbi_cut_link *items, int *table, int capacity);
/* Item of a link, or -1: it is whole. */
SBI_API int sbi_cut_links_find(const sbi_cut_links *links, const sbi_link_key *key);
/* Adds a link that is not there yet, within capacity. */
SBI_API void sbi_cut_links_add(sbi_cut_links *links, const sbi_link_key *key, sb_real t, int state);
/* Takes back all but the first `count` that were added. */
SBI_API void sbi_cut_links_truncate(sbi_cut_links *links, int count);

#endif /* SB_CUT_LINKS_H */
