/* cut_cap: what rims leave open of the borders of lips, as loops, and caps over these. */
#include "cut_rim_private.h"

/* ---- the chain ---- */

static int *sbi_rim_slot(const sbi_rim_chain *chain, int low, int high)
{
    unsigned mask = (unsigned)chain->size - 1;
    uint64_t mixed = (((uint64_t)(unsigned)low << 32) ^ (unsigned)high) * UINT64_C(0x9e3779b97f4a7c15);
    unsigned slot = (unsigned)(mixed >> 32) & mask;
    while (chain->slots[slot][0] && (chain->slots[slot][0] != low + 1 || chain->slots[slot][1] != high))
        slot = (slot + 1) & mask;
    return chain->slots[slot];
}

SBI_API void sbi_rim_chain_add(sbi_rim_chain *chain, int from, int to)
{
    int low = sbi_min_int(from, to), high = sbi_max_int(from, to), *slot = sbi_rim_slot(chain, low, high);
    slot[0] = low + 1;
    slot[1] = high;
    slot[2] += from < to ? 1 : -1;
    slot[3] = slot[2];
}

SBI_API int sbi_rim_chain_list(sbi_rim_chain *chain, int from, int to)
{
    int *slot = sbi_rim_slot(chain, sbi_min_int(from, to), sbi_max_int(from, to)), way = from < to ? 1 : -1;
    if (slot[3] * way <= 0)
        return 0;
    slot[3] -= way;
    slot[4] = 1;
    return 1;
}

static int sbi_rim_place(const sb_cut_fine *fine, const sbi_rim *rim, int point)
{
    return fine->next.points[rim->vertex_of[point]];
}

SBI_API void sbi_rim_chain_step(const sb_cut_fine *fine, sbi_rim *rim, int from, int to)
{
    int first = sbi_rim_place(fine, rim, from), last = sbi_rim_place(fine, rim, to), *slot;
    sbi_rim_chain_add(&rim->chain, first, last);
    slot = sbi_rim_slot(&rim->chain, sbi_min_int(first, last), sbi_max_int(first, last));
    if (slot[4])
        return;
    slot[4] = 1;
    rim->jumps[2 * rim->jump_count] = from;
    rim->jumps[2 * rim->jump_count++ + 1] = to;
}

/* ---- caps ---- */

static sb_real sbi_rim_diagonal(const sb_cut_fine *fine, const int *corners, const int *ring, int i)
{
    const sb_vec3 *rest = fine->next.rest;
    return sb_v3_norm(sb_v3_sub(rest[corners[i]], rest[corners[ring[ring[i]]]]));
}

/* Cuts the corner off that leaves the shortest edge, again and again. */
SBI_API void sbi_rim_cap(sb_cut_fine *fine, const int *corners, int count, int cell, int *ring)
{
    int at = 0;
    for (int i = 0; i < count; i++)
        ring[i] = (i + 1) % count;
    for (int left = count; left > 2; left--) {
        int best = at;
        sb_real least = sbi_rim_diagonal(fine, corners, ring, at);
        for (int k = 1; k < left && left > 3; k++) {
            sb_real diagonal;
            at = ring[at];
            diagonal = sbi_rim_diagonal(fine, corners, ring, at);
            if (diagonal < least) {
                least = diagonal;
                best = at;
            }
        }
        sbi_fine_add_triangle(fine, corners[best], corners[ring[best]], corners[ring[ring[best]]], SB_CUT_RIM, cell);
        ring[best] = ring[ring[best]];
        at = best;
    }
}

/* ---- what is left ---- */

/* Lists the line between two points as often as the chain has it too often, the other way. */
static void sbi_rim_list_rest(const sb_cut_fine *fine, sbi_rim *rim, int a, int b)
{
    int first = sbi_rim_place(fine, rim, a), last = sbi_rim_place(fine, rim, b);
    int *slot = sbi_rim_slot(&rim->chain, sbi_min_int(first, last), sbi_max_int(first, last));
    int is_up = first < last;
    while (slot[2] != 0) {
        int from = (slot[2] < 0) == is_up ? a : b, e = rim->rest_count++;
        rim->rest_to[e] = from == a ? b : a;
        rim->rest_next[e] = rim->rest_from[from];
        rim->rest_from[from] = e;
        slot[2] += slot[2] < 0 ? 1 : -1;
    }
}

/* Caps the loop that ends the stack, from place `first` of it on. */
static void sbi_rim_cap_loop(sb_cut_fine *fine, sbi_rim *rim, int first, int count)
{
    int cell = rim->cell_of[rim->stack[first]];
    for (int i = first; i < count; i++) {
        rim->stacked[rim->stack[i]] = 0;
        rim->stack[i] = rim->vertex_of[rim->stack[i]];
    }
    sbi_rim_cap(fine, rim->stack + first, count - first, cell, rim->ring);
}

/* Follows lines from a point on, and caps each loop as soon as it closes. What does not come back stays open. */
static void sbi_rim_cap_from(sb_cut_fine *fine, sbi_rim *rim, int point)
{
    int count = 1;
    rim->stack[0] = point;
    rim->stacked[point] = 1;
    while (rim->rest_from[rim->stack[count - 1]] >= 0) {
        int from = rim->stack[count - 1], e = rim->rest_from[from], to = rim->rest_to[e], at = rim->stacked[to] - 1;
        rim->rest_from[from] = rim->rest_next[e];
        if (at >= 0) {
            sbi_rim_cap_loop(fine, rim, at, count);
            count = at;
        }
        rim->stack[count++] = to;
        rim->stacked[to] = count;
    }
    rim->open_edges += count - 1;
    for (int i = 0; i < count; i++)
        rim->stacked[rim->stack[i]] = 0;
}

SBI_API int sbi_rim_cap_rest(sb_cut_fine *fine, sbi_rim *rim)
{
    rim->rest_count = 0;
    for (int i = 0; i < rim->point_count; i++) {
        rim->rest_from[i] = -1;
        rim->stacked[i] = 0;
    }
    for (int e = fine->lip_edge_count; e-- > 0;)
        sbi_rim_list_rest(fine, rim, fine->lip_edges[e].from, fine->lip_edges[e].to);
    for (int i = rim->jump_count; i-- > 0;)
        sbi_rim_list_rest(fine, rim, rim->jumps[2 * i], rim->jumps[2 * i + 1]);
    if (!sbi_fine_reserve_triangles(fine, rim->rest_count))
        return 0;
    for (int i = 0; i < rim->point_count; i++)
        while (rim->rest_from[i] >= 0)
            sbi_rim_cap_from(fine, rim, i);
    return 1;
}
