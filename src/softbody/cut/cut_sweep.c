/* cut_sweep: which links the triangles of a call cut, where the body is now.
 *
 * Tets near the triangles are listed once; each of their pieces asks a tree which blades come near, and finds the first
 * of them, in the order that they were given in, that crosses each of its links. Links are then cut in the order of
 * blades, tets and links: whoever looks for crossings on how many threads, names, ranks and places are the same. */
#include "cut_private.h"

#include <string.h>

/* ---- which tets a cut link belongs to ---- */

static int sbi_cut_has_corner(const sb_cut *cut, int tet, int node)
{
    const int *nodes = cut->tets + 4 * (size_t)tet;
    return nodes[0] == node || nodes[1] == node || nodes[2] == node || nodes[3] == node;
}

SBI_API void sbi_cut_list_around(sb_cut *cut, const sbi_link_key *key)
{
    cut->around.count = 0;
    if (key->at[1] < 0) {
        cut->around.items[cut->around.count++] = key->at[0];
        return;
    }
    for (int k = cut->node_tets.offsets[key->at[0]]; k < cut->node_tets.offsets[key->at[0] + 1]; k++) {
        int tet = cut->node_tets.items[k];
        if (sbi_cut_has_corner(cut, tet, key->at[1]) && (key->at[2] < 0 || sbi_cut_has_corner(cut, tet, key->at[2])))
            cut->around.items[cut->around.count++] = tet;
    }
}

SBI_API void sbi_cut_touch(sb_cut *cut, int tet)
{
    if (!(cut->tet_marks[tet] & SBI_CUT_TOUCHED))
        cut->touched.items[cut->touched.count++] = tet;
    cut->tet_marks[tet] |= SBI_CUT_TOUCHED;
}

/* A blade has struck a link; 0: no memory. */
static int sbi_cut_strike(sb_cut *cut, int item, int blade)
{
    if (!sbi_cut_list_grow(cut, &cut->struck, 1))
        return 0;
    cut->links.items[item].struck = blade;
    cut->struck.items[cut->struck.count++] = item;
    sbi_cut_list_around(cut, &cut->links.items[item].key);
    for (int i = 0; i < cut->around.count; i++)
        sbi_cut_touch(cut, cut->around.items[i]);
    return 1;
}

SBI_API int sbi_cut_add_link(sb_cut *cut, const sbi_link_key *key, sb_real t, int state, int blade)
{
    if (!sbi_cut_reserve_links(cut, 1))
        return 0;
    sbi_cut_links_add(&cut->links, key, t, state);
    return sbi_cut_strike(cut, cut->links.count - 1, blade);
}

SBI_API int sbi_cut_cross_link(sb_cut *cut, int item, int blade)
{
    if (!sbi_cut_list_grow(cut, &cut->crossed, 1))
        return 0;
    cut->crossed.items[cut->crossed.count++] = item;
    cut->links.items[item].state = SBI_LINK_CUT;
    return sbi_cut_strike(cut, item, blade);
}

SBI_API void sbi_cut_forget_struck(sb_cut *cut)
{
    for (int i = 0; i < cut->struck.count; i++)
        cut->links.items[cut->struck.items[i]].struck = -1;
    cut->struck.count = 0;
}

SBI_API void sbi_cut_take_back(sb_cut *cut, int count)
{
    sbi_cut_forget_struck(cut);
    for (int i = 0; i < cut->crossed.count; i++)
        cut->links.items[cut->crossed.items[i]].state = SBI_LINK_PREDICTED;
    cut->crossed.count = 0;
    while (cut->receded_count > 0) {
        const sbi_cut_receded *was = cut->receded + --cut->receded_count;
        cut->links.items[was->item].t = was->t;
        cut->links.items[was->item].charred = (short)was->charred;
    }
    sbi_cut_links_truncate(&cut->links, count);
}

/* ---- near tets ---- */

enum { SBI_CUT_TETS = 1024, SBI_CUT_NEARS = 32 }; /* for one task */

typedef struct sbi_cut_near_work {
    sb_cut *cut;
    sbi_cut_box reach;
    const unsigned char *beyond; /* of the nodes; NULL: boxes of cells are to be asked */
} sbi_cut_near_work;

static int sbi_cut_boxes_meet(const sbi_cut_box *a, const sbi_cut_box *b)
{
    return a->low.x <= b->high.x && a->low.y <= b->high.y && a->low.z <= b->high.z && a->high.x >= b->low.x &&
           a->high.y >= b->low.y && a->high.z >= b->low.z;
}

SBI_API void sbi_cut_box_widen(sbi_cut_box *box, sb_real by)
{
    box->low = sb_v3_sub(box->low, sb_v3(by, by, by));
    box->high = sb_v3_add(box->high, sb_v3(by, by, by));
}

SBI_API sbi_cut_box sbi_cut_box_around(const sb_vec3 *points, int count)
{
    sbi_cut_box box = {{0, 0, 0}, {0, 0, 0}};
    if (count > 0)
        box.low = box.high = points[0];
    for (int i = 1; i < count; i++)
        sbi_cut_box_add(&box, points[i]);
    return box;
}

SBI_API void sbi_cut_get_nodes(const sb_cut *cut, int piece, sb_vec3 x[SBI_CUT_NODES])
{
    const int *nodes = sbi_cut_piece_nodes(cut, piece);
    for (int a = 0; a < cut->nodes_per_tet; a++)
        x[a] = cut->body->position[nodes[a]];
}

SBI_API sb_vec3 sbi_cut_place(const sb_cut *cut, const sbi_corner_order *order, const sb_real barycentrics[4],
                              const sb_vec3 x[SBI_CUT_NODES])
{
    return cut->nodes_per_tet == 4 ? sbi_lattice_place(order, barycentrics, x)
                                   : sbi_lattice_place_quadratic(order, barycentrics, x);
}

SBI_API void sbi_cut_get_shape(const sb_cut *cut, const sb_real barycentrics[4], sb_real shape[SBI_CUT_NODES])
{
    if (cut->nodes_per_tet == 4)
        memcpy(shape, barycentrics, 4 * sizeof *shape);
    else
        sb_element_shape(SB_TET10, barycentrics + 1, shape, NULL);
}

/* An element with curved edges lies in the box of its Bezier points: corners, and of each edge twice the middle less
 * the mean of the ends. */
SBI_API sbi_cut_box sbi_cut_box_of_piece(const sb_cut *cut, int piece)
{
    const sb_vec3 *x = cut->body->position;
    const int *nodes = sbi_cut_piece_nodes(cut, piece);
    sbi_cut_box box;
    box.low = box.high = x[nodes[0]];
    for (int a = 1; a < 4; a++)
        sbi_cut_box_add(&box, x[nodes[a]]);
    for (int e = 0; e < 6 && cut->nodes_per_tet > 4; e++) {
        int edge[3];
        sb_vec3 ends;
        sb_element_edge(SB_TET10, e, edge);
        ends = sb_v3_add(x[nodes[edge[0]]], x[nodes[edge[1]]]);
        sbi_cut_box_add(&box, sb_v3_madd(sb_v3_scale(2, x[nodes[edge[2]]]), (sb_real)-0.5, ends));
    }
    return box;
}

/* Whether boxes of pieces meet another is asked thousands of times a frame: mostly one axis and corner tell. */
static int sbi_cut_meets_piece(const sb_cut *cut, int piece, const sbi_cut_box *box)
{
    const sb_vec3 *x = cut->body->position;
    const int *nodes = sbi_cut_piece_nodes(cut, piece);
    const sb_vec3 *a = x + nodes[0], *b = x + nodes[1], *c = x + nodes[2], *d = x + nodes[3];
    sb_vec3 low = box->low, high = box->high;
    if (cut->nodes_per_tet > 4) {
        sbi_cut_box of = sbi_cut_box_of_piece(cut, piece);
        return sbi_cut_boxes_meet(&of, box);
    }
    return !((a->x > high.x && b->x > high.x && c->x > high.x && d->x > high.x) ||
             (a->x < low.x && b->x < low.x && c->x < low.x && d->x < low.x) ||
             (a->y > high.y && b->y > high.y && c->y > high.y && d->y > high.y) ||
             (a->y < low.y && b->y < low.y && c->y < low.y && d->y < low.y) ||
             (a->z > high.z && b->z > high.z && c->z > high.z && d->z > high.z) ||
             (a->z < low.z && b->z < low.z && c->z < low.z && d->z < low.z));
}

SBI_API int sbi_cut_meets_tet(const sb_cut *cut, int tet, const sbi_cut_box *box)
{
    int meets = 0;
    for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0 && !meets; piece = cut->pieces[piece].next)
        meets = sbi_cut_meets_piece(cut, piece, box);
    return meets;
}

/* Sides of a box that a point is beyond, as bits. */
static int sbi_cut_beyond(const sbi_cut_box *box, sb_vec3 p)
{
    return (p.x < box->low.x) | (p.x > box->high.x) << 1 | (p.y < box->low.y) << 2 | (p.y > box->high.y) << 3 |
           (p.z < box->low.z) << 4 | (p.z > box->high.z) << 5;
}

static void sbi_cut_beyond_task(void *user, int task)
{
    const sbi_cut_near_work *work = (const sbi_cut_near_work *)user;
    const sb_vec3 *x = work->cut->body->position;
    const sbi_cut_box reach = work->reach; /* a byte that is written may be of anything that is pointed to */
    unsigned char *beyond = work->cut->beyond;
    int end = sbi_min_int(SBI_CUT_TETS * (task + 1), work->cut->body->live->nodes.end);
    for (int node = SBI_CUT_TETS * task; node < end; node++)
        beyond[node] = (unsigned char)sbi_cut_beyond(&reach, x[node]);
}

/* Finds on which sides of the box nodes are: a tet4 with all corners beyond one of them is not near. Without memory for
 * that, and where elements are curved, all boxes are asked, which finds the same. */
static void sbi_cut_find_beyond(sbi_cut_near_work *work)
{
    sb_cut *cut = work->cut;
    void *beyond = cut->beyond;
    int nodes = cut->body->live->nodes.end;
    if (cut->nodes_per_tet > 4)
        return;
    if (sbi_cut_grow(&cut->allocator, &beyond, &cut->beyond_capacity, 0, nodes, 1)) {
        cut->beyond = (unsigned char *)beyond;
        sbi_run(&cut->body->jobs, sbi_cut_beyond_task, work, (nodes + SBI_CUT_TETS - 1) / SBI_CUT_TETS);
        work->beyond = cut->beyond;
    }
}

/* Which of some tet4 have a piece that is near: of the first piece a tet has the number. */
static void sbi_cut_find_near(const sb_cut *cut, const unsigned char *beyond, int first, int end)
{
    const sbi_cut_piece *pieces = cut->pieces;
    const int *cells = cut->body->domain.cells;
    unsigned char *is_near = cut->is_near;
    for (int tet = first; tet < end; tet++) {
        const sbi_cut_piece *piece = pieces + tet;
        int is_beyond = 1;
        while (is_beyond && piece->cell >= 0) {
            const int *nodes = cells + 4 * (size_t)piece->cell;
            is_beyond = beyond[nodes[0]] & beyond[nodes[1]] & beyond[nodes[2]] & beyond[nodes[3]];
            if (piece->next < 0)
                break;
            piece = pieces + piece->next;
        }
        is_near[tet] = !is_beyond;
    }
}

static void sbi_cut_near_task(void *user, int task)
{
    const sbi_cut_near_work *work = (const sbi_cut_near_work *)user;
    const sb_cut *cut = work->cut;
    int first = SBI_CUT_TETS * task, end = sbi_min_int(SBI_CUT_TETS * (task + 1), cut->tet_count);
    if (work->beyond)
        sbi_cut_find_near(cut, work->beyond, first, end);
    for (int tet = first; tet < end && !work->beyond; tet++)
        cut->is_near[tet] = (unsigned char)sbi_cut_meets_tet(cut, tet, &work->reach);
}

SBI_API void sbi_cut_list_near(sb_cut *cut, const sbi_cut_box *now, const sbi_cut_box *reach)
{
    sbi_cut_near_work work;
    cut->near.count = 0;
    if (!sbi_cut_boxes_meet(now, reach))
        return;
    work.cut = cut;
    work.reach = *reach;
    work.beyond = NULL;
    sbi_cut_find_beyond(&work);
    sbi_run(&cut->body->jobs, sbi_cut_near_task, &work, (cut->tet_count + SBI_CUT_TETS - 1) / SBI_CUT_TETS);
    for (int tet = 0; tet < cut->tet_count; tet++)
        if (cut->is_near[tet])
            cut->near.items[cut->near.count++] = tet;
}

/* ---- one piece ---- */

/* The first blade that crosses each link of a piece, and where. Asked are links of the piece that meet the box of all
 * blades: a strip is thin, and most of a piece's links are beside it. */
typedef struct sbi_cut_crossings {
    int blades[SBI_LATTICE_LINKS]; /* of links that were asked; -1: none */
    sb_real t[SBI_LATTICE_LINKS];
    int asked_count;
    unsigned char asked[SBI_LATTICE_LINKS], ends[SBI_LATTICE_LINKS][2]; /* links, ascending, and their ends */
    uint64_t points;                                                    /* at their ends */
} sbi_cut_crossings;

/* Box of a piece, rounded; lattice points lie in it but for their own rounding. */
static sbi_blade_box sbi_cut_shape_box(const sb_cut *cut, const sbi_crossing_frame *frame, int piece)
{
    const int rounding = 1;
    sbi_cut_box of = sbi_cut_box_of_piece(cut, piece);
    sbi_blade_box box;
    box.low = sbi_crossing_round(frame, of.low);
    box.high = sbi_crossing_round(frame, of.high);
    box.low.x -= rounding, box.low.y -= rounding, box.low.z -= rounding;
    box.high.x += rounding, box.high.y += rounding, box.high.z += rounding;
    return box;
}

SBI_API void sbi_cut_shape_make(const sb_cut *cut, int tet, int piece, const sbi_crossing_frame *frame,
                                sbi_cut_shape *shape)
{
    const sbi_lattice *lattice = &cut->lattice;
    sb_vec3 x[SBI_CUT_NODES];
    sbi_cut_get_nodes(cut, piece, x);
    shape->order = sbi_corner_order_make(cut->tets + 4 * (size_t)tet);
    for (int p = 0; p < lattice->point_count; p++) {
        sb_real barycentrics[4];
        sbi_lattice_point(lattice, p, barycentrics);
        shape->places[p] = sbi_crossing_round(frame, sbi_cut_place(cut, &shape->order, barycentrics, x));
    }
}

/* Sides of the box of all blades that a point is beyond, as bits. */
static int sbi_cut_beyond_blades(const sbi_blade_box *box, sbi_int3 p)
{
    return (p.x < box->low.x) | (p.x > box->high.x) << 1 | (p.y < box->low.y) << 2 | (p.y > box->high.y) << 3 |
           (p.z < box->low.z) << 4 | (p.z > box->high.z) << 5;
}

/* Lists the links of a piece with these points that blades are to be asked for. */
static void sbi_cut_list_asked(const sb_cut *cut, uint64_t points, const sbi_cut_shape *shape, sbi_cut_crossings *found)
{
    const sbi_lattice *lattice = &cut->lattice;
    const sbi_blade_box *all = sbi_blade_tree_box(&cut->tree);
    unsigned char beyond[SBI_LATTICE_POINTS];
    for (int p = 0; p < lattice->point_count; p++)
        beyond[p] = (unsigned char)sbi_cut_beyond_blades(all, shape->places[p]);
    found->asked_count = 0;
    found->points = 0;
    for (int l = 0; l < lattice->link_count; l++) {
        const unsigned char *link = lattice->links[l];
        int ends[2];
        if (!(points >> link[0] & points >> link[1] & 1) || (beyond[link[0]] & beyond[link[1]]))
            continue;
        sbi_lattice_ends(lattice, &shape->order, l, ends);
        found->blades[l] = -1;
        found->ends[found->asked_count][0] = (unsigned char)ends[0];
        found->ends[found->asked_count][1] = (unsigned char)ends[1];
        found->asked[found->asked_count++] = (unsigned char)l;
        found->points |= (uint64_t)1 << link[0] | (uint64_t)1 << link[1];
    }
}

/* Takes the links that a blade crosses before those that have crossed them so far. */
static void sbi_cut_cross(const sb_cut *cut, const sbi_cut_shape *shape, int number, sbi_cut_crossings *found)
{
    const sbi_blade *blade = cut->blades + number;
    uint64_t above = 0;
    for (int p = 0; p < cut->lattice.point_count; p++)
        if ((found->points >> p & 1) && sbi_blade_side(blade, sbi_blade_height(blade, shape->places[p])) > 0)
            above |= (uint64_t)1 << p;
    if (!above || above == found->points)
        return;
    for (int k = 0; k < found->asked_count; k++) {
        const unsigned char *ends = found->ends[k];
        int l = found->asked[k];
        sb_real t;
        if ((above >> ends[0] & 1) == (above >> ends[1] & 1) || (found->blades[l] >= 0 && found->blades[l] < number) ||
            !sbi_blade_crosses(blade, shape->places[ends[0]], shape->places[ends[1]], &t))
            continue;
        found->blades[l] = number;
        found->t[l] = t;
    }
}

/* Crossings of a piece; 0: there are none. */
static int sbi_cut_find_crossings(const sb_cut *cut, const sbi_crossing_frame *frame, int tet, int piece,
                                  sbi_cut_crossings *found)
{
    sbi_cut_shape shape;
    sbi_blade_box box = sbi_cut_shape_box(cut, frame, piece);
    sbi_blade_walk walk;
    int blade;
    sbi_blade_walk_begin(&cut->tree, &box, &walk);
    blade = sbi_blade_walk_next(&cut->tree, &walk);
    if (blade < 0)
        return 0;
    sbi_cut_shape_make(cut, tet, piece, frame, &shape);
    sbi_cut_list_asked(cut, cut->pieces[piece].points, &shape, found);
    if (!found->asked_count)
        return 0;
    for (; blade >= 0; blade = sbi_blade_walk_next(&cut->tree, &walk))
        sbi_cut_cross(cut, &shape, blade, found);
    return 1;
}

/* ---- predicted links between pieces ---- */

/* A lattice point as the piece that has it says. */
static sbi_int3 sbi_cut_point(const sb_cut *cut, const sbi_crossing_frame *frame, int tet, int point)
{
    sbi_corner_order order = sbi_corner_order_make(cut->tets + 4 * (size_t)tet);
    sb_vec3 x[SBI_CUT_NODES];
    sb_real at[4];
    sbi_cut_get_nodes(cut, sbi_cut_piece_with(cut, tet, point), x);
    sbi_lattice_point(&cut->lattice, point, at);
    return sbi_crossing_round(frame, sbi_cut_place(cut, &order, at, x));
}

SBI_API int sbi_cut_first_crossing(const sb_cut *cut, sbi_int3 from, sbi_int3 to)
{
    sbi_blade_box box;
    sbi_blade_walk walk;
    int first = -1;
    box.low.x = sbi_min_int(from.x, to.x), box.high.x = sbi_max_int(from.x, to.x);
    box.low.y = sbi_min_int(from.y, to.y), box.high.y = sbi_max_int(from.y, to.y);
    box.low.z = sbi_min_int(from.z, to.z), box.high.z = sbi_max_int(from.z, to.z);
    sbi_blade_walk_begin(&cut->tree, &box, &walk);
    for (int blade = sbi_blade_walk_next(&cut->tree, &walk); blade >= 0;
         blade = sbi_blade_walk_next(&cut->tree, &walk)) {
        sb_real t;
        if ((first < 0 || blade < first) && sbi_blade_crosses(cut->blades + blade, from, to, &t))
            first = blade;
    }
    return first;
}

/* The blade that crosses a predicted link whose ends are in two pieces by now, or -1. */
static int sbi_cut_cross_predicted(const sb_cut *cut, const sbi_crossing_frame *frame, int tet, int link, int part)
{
    const unsigned char *ends = cut->lattice.links[link];
    int piece = sbi_cut_piece_with(cut, tet, ends[0]), item;
    sbi_corner_order order;
    sbi_link_key key;
    if (((cut->links.lost[tet] >> ends[0] | cut->links.lost[tet] >> ends[1]) & 1) ||
        (cut->pieces[piece].points >> ends[1] & 1) || !sbi_cut_is_of(cut, sbi_cut_piece_nodes(cut, piece)[0], part))
        return -1;
    order = sbi_corner_order_make(cut->tets + 4 * (size_t)tet);
    key = sbi_lattice_key(&cut->lattice, &order, tet, link);
    item = sbi_cut_links_find(&cut->links, &key);
    if (item < 0 || cut->links.items[item].state != SBI_LINK_PREDICTED)
        return -1;
    return sbi_cut_first_crossing(cut, sbi_cut_point(cut, frame, tet, ends[0]),
                                  sbi_cut_point(cut, frame, tet, ends[1]));
}

/* ---- all pieces ---- */

typedef struct sbi_cut_sweep_work {
    sb_cut *cut;
    const sbi_crossing_frame *frame;
    int part;
    int fills; /* 0: hits are counted */
} sbi_cut_sweep_work;

static int sbi_cut_put_hit(const sbi_cut_sweep_work *work, sbi_cut_hit *hits, int count, int blade, int tet, int link,
                           sb_real t)
{
    if (work->fills) {
        hits[count].blade = blade;
        hits[count].tet = tet;
        hits[count].link = link;
        hits[count].t = t;
    }
    return count + 1;
}

/* Counts the hits of a near tet, or writes them; returns how many. */
static int sbi_cut_sweep_tet(const sbi_cut_sweep_work *work, int tet, sbi_cut_hit *hits)
{
    const sb_cut *cut = work->cut;
    int count = 0;
    if (!sbi_cut_meets_tet(cut, tet, &cut->reach))
        return 0;
    for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next) {
        sbi_cut_crossings found;
        if (!sbi_cut_is_of(cut, sbi_cut_piece_nodes(cut, piece)[0], work->part) ||
            !sbi_cut_find_crossings(cut, work->frame, tet, piece, &found))
            continue;
        for (int k = 0; k < found.asked_count; k++) {
            int l = found.asked[k];
            if (found.blades[l] >= 0)
                count = sbi_cut_put_hit(work, hits, count, found.blades[l], tet, l, found.t[l]);
        }
    }
    for (int l = 0; l < cut->lattice.link_count && cut->glues && cut->pieces[tet].next >= 0; l++) {
        int blade = sbi_cut_cross_predicted(cut, work->frame, tet, l, work->part);
        if (blade >= 0)
            count = sbi_cut_put_hit(work, hits, count, blade, tet, l, 0);
    }
    return count;
}

/* listed: number of hits of each near tet, then where they begin. */
static void sbi_cut_sweep_task(void *user, int task)
{
    const sbi_cut_sweep_work *work = (const sbi_cut_sweep_work *)user;
    sb_cut *cut = work->cut;
    int *hits = cut->listed.items;
    int end = sbi_min_int(SBI_CUT_NEARS * (task + 1), cut->near.count);
    for (int i = SBI_CUT_NEARS * task; i < end; i++) {
        if (!work->fills)
            hits[i] = sbi_cut_sweep_tet(work, cut->near.items[i], NULL);
        else if (hits[i] < hits[i + 1])
            (void)sbi_cut_sweep_tet(work, cut->near.items[i], cut->hits + hits[i]);
    }
}

/* Turns numbers of hits into where they begin, the last one where all end; returns how many there are. */
static int sbi_cut_sum(int *counts, int count)
{
    int sum = 0;
    for (int i = 0; i < count; i++) {
        int more = counts[i];
        counts[i] = sum;
        sum += more;
    }
    counts[count] = sum;
    return sum;
}

/* Cuts the links of all hits, in the order of their blades. 0: no memory. */
static int sbi_cut_take_hits(sb_cut *cut, int count)
{
    sbi_cut_list *starts = &cut->blade_hits;
    starts->count = 0;
    if (!sbi_cut_list_grow(cut, starts, cut->blade_count + 1))
        return 0;
    memset(starts->items, 0, ((size_t)cut->blade_count + 1) * sizeof(int));
    for (int i = 0; i < count; i++)
        starts->items[cut->hits[i].blade]++;
    sbi_cut_sum(starts->items, cut->blade_count);
    for (int i = 0; i < count; i++)
        cut->sorted_hits[starts->items[cut->hits[i].blade]++] = cut->hits[i];
    for (int i = 0; i < count; i++) {
        const sbi_cut_hit *hit = cut->sorted_hits + i;
        sbi_corner_order order = sbi_corner_order_make(cut->tets + 4 * (size_t)hit->tet);
        sbi_link_key key = sbi_lattice_key(&cut->lattice, &order, hit->tet, hit->link);
        int item = sbi_cut_links_find(&cut->links, &key);
        if (item < 0 ? !sbi_cut_add_link(cut, &key, hit->t, SBI_LINK_CUT, hit->blade)
                     : cut->links.items[item].state == SBI_LINK_PREDICTED && !sbi_cut_cross_link(cut, item, hit->blade))
            return 0;
    }
    return 1;
}

SBI_API int sbi_cut_reserve_hits(sb_cut *cut, int count)
{
    void *hits = cut->hits, *sorted = cut->sorted_hits;
    int grown = sbi_cut_grow(&cut->allocator, &hits, &cut->hit_capacity, 0, count, sizeof *cut->hits);
    grown = grown && sbi_cut_grow(&cut->allocator, &sorted, &cut->sorted_capacity, 0, count, sizeof *cut->sorted_hits);
    cut->hits = (sbi_cut_hit *)hits;
    cut->sorted_hits = (sbi_cut_hit *)sorted;
    return grown;
}

SBI_API int sbi_cut_sweep(sb_cut *cut, const sbi_crossing_frame *frame, int part)
{
    sbi_cut_sweep_work work;
    int tasks = (cut->near.count + SBI_CUT_NEARS - 1) / SBI_CUT_NEARS, count;
    if (!cut->near.count || !cut->blade_count)
        return 1;
    work.cut = cut;
    work.frame = frame;
    work.part = part;
    work.fills = 0;
    sbi_run(&cut->body->jobs, sbi_cut_sweep_task, &work, tasks);
    count = sbi_cut_sum(cut->listed.items, cut->near.count);
    if (!count)
        return 1;
    if (!sbi_cut_reserve_hits(cut, count))
        return 0;
    work.fills = 1;
    sbi_run(&cut->body->jobs, sbi_cut_sweep_task, &work, tasks);
    return sbi_cut_take_hits(cut, count);
}
