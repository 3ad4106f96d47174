/* cut_ring: links that strips have passed all around.
 *
 * Between two calls the tissue moves, and the edge that one strip ended in and the next begins with is straight between
 * other points than before: slits are left, as wide as strains times the distance of samples, and a single link in one
 * holds the body like a thread. So a whole link is cut when every micro-triangle around it has exactly one cut link,
 * one of them cut by this call: nothing holds there but itself. Cuts at rest leave no such links. */
#include "cut_private.h"

/* What the rule sees of one tet. */
typedef struct sbi_cut_ring {
    sbi_parted parted;
    unsigned char cut[SBI_LATTICE_LINKS]; /* 1: not just predicted, which would run ahead of blades by itself */
    unsigned char ringed[SBI_LATTICE_LINKS];
} sbi_cut_ring;

static void sbi_cut_ring_make(const sb_cut *cut, int tet, sbi_cut_ring *ring)
{
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, &ring->parted);
    for (int l = 0; l < cut->lattice.link_count; l++)
        ring->cut[l] = ring->parted.cut[l] == SBI_LINK_CUT;
    sbi_lattice_find_ringed(&cut->lattice, ring->cut, ring->ringed);
}

static int sbi_cut_ring_find(const sb_cut *cut, const sbi_cut_ring *ring, int tet, const sbi_link_key *key)
{
    for (int l = 0; l < cut->lattice.link_count; l++) {
        sbi_link_key of = sbi_lattice_key(&cut->lattice, &ring->parted.order, tet, l);
        if (of.at[0] == key->at[0] && of.at[1] == key->at[1] && of.at[2] == key->at[2] && of.at[3] == key->at[3])
            return l;
    }
    return -1;
}

/* 1 when a link was cut by this call, whose first new one is `first`, or crossed where it had been predicted. */
static int sbi_cut_is_new(const sb_cut *cut, int item, int first)
{
    int is_new = item >= first;
    for (int i = 0; i < cut->crossed.count && !is_new; i++)
        is_new = cut->crossed.items[i] == item;
    return is_new;
}

/* 1 when a cut link of the micro-tets around a link was cut by this call. */
static int sbi_cut_ring_is_new(const sb_cut *cut, const sbi_cut_ring *ring, int link, int first)
{
    for (int micro = 0; micro < cut->lattice.micro_count; micro++) {
        const unsigned char *links = cut->lattice.micro_links[micro];
        int around = 0, is_new = 0;
        for (int e = 0; e < 6; e++) {
            around |= links[e] == link;
            is_new |= ring->cut[links[e]] && sbi_cut_is_new(cut, ring->parted.rank[links[e]], first);
        }
        if (around && is_new)
            return 1;
    }
    return 0;
}

/* Whether all tets around a link find it ringed, and one of them by a link cut from `first` on. */
static int sbi_cut_is_ringed(sb_cut *cut, const sbi_link_key *key, int first)
{
    int is_new = 0;
    sbi_cut_list_around(cut, key);
    for (int i = 0; i < cut->around.count; i++) {
        int tet = cut->around.items[i], link;
        sbi_cut_ring ring;
        sbi_cut_ring_make(cut, tet, &ring);
        link = sbi_cut_ring_find(cut, &ring, tet, key);
        if (link < 0 || !ring.ringed[link])
            return 0;
        is_new |= sbi_cut_ring_is_new(cut, &ring, link, first);
    }
    return is_new;
}

SBI_API int sbi_cut_close_rings(sb_cut *cut, int first)
{
    const sb_real middle = (sb_real)0.5;
    int touched =
        cut->touched.count; /* links cut here make no other one ringed: each of their triangles has two then */
    for (int i = 0; i < touched; i++) {
        int tet = cut->touched.items[i];
        sbi_cut_ring ring;
        sbi_cut_ring_make(cut, tet, &ring);
        for (int l = 0; l < cut->lattice.link_count; l++) {
            sbi_link_key key;
            int item;
            if (!ring.ringed[l] || ring.cut[l])
                continue;
            key = sbi_lattice_key(&cut->lattice, &ring.parted.order, tet, l);
            item = sbi_cut_links_find(&cut->links, &key);
            if ((item >= 0 && cut->links.items[item].state == SBI_LINK_CUT) || !sbi_cut_is_ringed(cut, &key, first))
                continue;
            if (item >= 0 ? !sbi_cut_cross_link(cut, item, -1) : !sbi_cut_add_link(cut, &key, middle, SBI_LINK_CUT, -1))
                return 0;
        }
    }
    return 1;
}
