/* cut_sweep: which links the triangles of a call cut, where the body is now. */
#include "cut_private.h"

#include <string.h>

/* ---- lists ---- */

SBI_API int sbi_cut_grow(const sb_allocator *allocator, void **items, int *capacity, int count, int more, size_t size)
{
    int64_t needed = (int64_t)count + more, roomy = needed + needed / 2 + 16;
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

/* ---- which tets a cut link belongs to ---- */

static int sbi_cut_has_corner(const sb_cut *cut, int tet, int node)
{
    const int *nodes = cut->tets + 4 * (size_t)tet;
    return nodes[0] == node || nodes[1] == node || nodes[2] == node || nodes[3] == node;
}

static void sbi_cut_touch(sb_cut *cut, int tet)
{
    if (!(cut->tet_marks[tet] & SBI_CUT_TOUCHED))
        cut->touched.items[cut->touched.count++] = tet;
    cut->tet_marks[tet] |= SBI_CUT_TOUCHED;
}

/* Lists the tets around a link. */
static void sbi_cut_touch_link(sb_cut *cut, const sbi_link_key *key)
{
    if (key->at[1] < 0) {
        sbi_cut_touch(cut, key->at[0]);
        return;
    }
    for (int k = cut->node_tets.offsets[key->at[0]]; k < cut->node_tets.offsets[key->at[0] + 1]; k++) {
        int tet = cut->node_tets.items[k];
        if (sbi_cut_has_corner(cut, tet, key->at[1]) && (key->at[2] < 0 || sbi_cut_has_corner(cut, tet, key->at[2])))
            sbi_cut_touch(cut, tet);
    }
}

/* ---- one piece ---- */

/* A piece in the present shape. */
typedef struct sbi_cut_shape {
    sbi_corner_order order;
    sb_vec3 corners[4];
    sbi_int3 places[SBI_LATTICE_POINTS];
    sbi_int3 low, high; /* of the places */
} sbi_cut_shape;

static void sbi_cut_shape_make(const sb_cut *cut, int tet, const sbi_crossing_frame *frame, sbi_cut_shape *shape)
{
    const sbi_lattice *lattice = &cut->lattice;
    shape->order = sbi_corner_order_make(cut->tets + 4 * (size_t)tet);
    for (int p = 0; p < lattice->point_count; p++) {
        sb_real barycentrics[4];
        sbi_int3 *at = shape->places + p;
        sbi_lattice_point(lattice, p, barycentrics);
        *at = sbi_crossing_round(frame, sbi_lattice_place(&shape->order, barycentrics, shape->corners));
        if (p == 0)
            shape->low = shape->high = *at;
        shape->low.x = sbi_min_int(shape->low.x, at->x);
        shape->low.y = sbi_min_int(shape->low.y, at->y);
        shape->low.z = sbi_min_int(shape->low.z, at->z);
        shape->high.x = sbi_max_int(shape->high.x, at->x);
        shape->high.y = sbi_max_int(shape->high.y, at->y);
        shape->high.z = sbi_max_int(shape->high.z, at->z);
    }
}

static int sbi_cut_is_near(const sbi_cut_shape *shape, const sbi_blade *blade)
{
    return shape->low.x <= blade->high.x && shape->low.y <= blade->high.y && shape->low.z <= blade->high.z &&
           shape->high.x >= blade->low.x && shape->high.y >= blade->low.y && shape->high.z >= blade->low.z;
}

/* Cuts what links of a piece the blade crosses; 0: no memory. */
static int sbi_cut_links_of(sb_cut *cut, int tet, uint64_t points, const sbi_cut_shape *shape, const sbi_blade *blade)
{
    const sbi_lattice *lattice = &cut->lattice;
    int64_t heights[SBI_LATTICE_POINTS];
    uint64_t above = 0;
    for (int p = 0; p < lattice->point_count; p++) {
        heights[p] = sbi_blade_height(blade, shape->places[p]);
        if (sbi_blade_side(blade, heights[p]) > 0)
            above |= (uint64_t)1 << p;
    }
    if (!(above & points) || !(~above & points))
        return 1;
    for (int l = 0; l < lattice->link_count; l++) {
        sbi_link_key key;
        int ends[2];
        sb_real t;
        sbi_lattice_ends(lattice, &shape->order, l, ends);
        if (!(points >> ends[0] & 1) || !(points >> ends[1] & 1) || (above >> ends[0] & 1) == (above >> ends[1] & 1) ||
            !sbi_blade_crosses(blade, shape->places[ends[0]], shape->places[ends[1]], &t))
            continue;
        key = sbi_lattice_key(lattice, &shape->order, tet, l);
        if (sbi_cut_links_find(&cut->links, &key) >= 0)
            continue;
        if (!sbi_cut_reserve_links(cut, 1))
            return 0;
        sbi_cut_links_add(&cut->links, &key, t, SBI_LINK_CUT);
        sbi_cut_touch_link(cut, &key);
    }
    return 1;
}

/* ---- all pieces ---- */

/* Box of all blades in space, a little wider (m). */
static void sbi_cut_reach(const sb_cut *cut, const sbi_crossing_frame *frame, double low[3], double high[3])
{
    const double slack = 2; /* units of the frame: more than rounding to whole ones */
    for (int i = 0; i < 3; i++) {
        low[i] = (double)SBI_CROSSING_BLADE;
        high[i] = -low[i];
    }
    for (int k = 0; k < cut->blade_count; k++) {
        const sbi_blade *blade = cut->blades + k;
        const int from[3] = {blade->low.x, blade->low.y, blade->low.z};
        const int to[3] = {blade->high.x, blade->high.y, blade->high.z};
        for (int i = 0; i < 3; i++) {
            low[i] = low[i] < from[i] ? low[i] : from[i];
            high[i] = high[i] > to[i] ? high[i] : to[i];
        }
    }
    for (int i = 0; i < 3; i++) {
        low[i] = frame->centre[i] + (low[i] - slack) / frame->scale;
        high[i] = frame->centre[i] + (high[i] + slack) / frame->scale;
    }
}

static int sbi_cut_is_within(const sb_vec3 x[4], const double low[3], const double high[3])
{
    sb_vec3 from = x[0], to = x[0];
    for (int a = 1; a < 4; a++) {
        from = sb_v3(sb_min(from.x, x[a].x), sb_min(from.y, x[a].y), sb_min(from.z, x[a].z));
        to = sb_v3(sb_max(to.x, x[a].x), sb_max(to.y, x[a].y), sb_max(to.z, x[a].z));
    }
    return (double)from.x <= high[0] && (double)from.y <= high[1] && (double)from.z <= high[2] &&
           (double)to.x >= low[0] && (double)to.y >= low[1] && (double)to.z >= low[2];
}

SBI_API int sbi_cut_sweep(sb_cut *cut, const sbi_crossing_frame *frame, int part)
{
    const sb_vec3 *x = sb_body_positions(cut->body);
    double low[3], high[3];
    sbi_cut_reach(cut, frame, low, high);
    for (int tet = 0; tet < cut->tet_count && cut->blade_count > 0; tet++)
        for (int piece = tet; piece >= 0; piece = cut->pieces[piece].next) {
            const int *nodes = sb_body_cell_nodes(cut->body, cut->pieces[piece].cell);
            sbi_cut_shape shape;
            if (!sbi_cut_is_of(cut, nodes[0], part))
                continue;
            for (int a = 0; a < 4; a++)
                shape.corners[a] = x[nodes[a]];
            if (!sbi_cut_is_within(shape.corners, low, high))
                continue;
            sbi_cut_shape_make(cut, tet, frame, &shape);
            for (int k = 0; k < cut->blade_count; k++)
                if (sbi_cut_is_near(&shape, cut->blades + k) &&
                    !sbi_cut_links_of(cut, tet, cut->pieces[piece].points, &shape, cut->blades + k))
                    return 0;
        }
    return 1;
}
