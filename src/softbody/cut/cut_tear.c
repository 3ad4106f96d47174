/* cut_tear: elements that are stretched beyond what their material bears come apart.
 *
 * A tet tears where its largest principal stress (Cauchy) is over
 *
 *     s_c = sqrt((lambda + 2 mu) J_c / (4 h)), h = V / A with its volume and the area of its section at rest
 *
 * (crack band: the energy that a crack takes does not depend on the size of elements; Bazant and Cedolin 1979: what
 * comes apart at once does so at an equivalent strength, whose factor belongs to the element). With the factor 1/4
 * strips of tet4 with Poisson's ratios of 0.1 to 0.3 take J_c within 20 %; where tet4 lock, at 0.45 and more, stresses
 * go up and down from tet to tet, and it may be half or twice that.
 * A tear goes through the tet's centroid, or on from the cut that has come to it, across the direction of that stress:
 * in the present shape that is the plane with the normal n, and its normal at rest is F^T n / |F^T n|. It takes sides
 * with what has been cut of the tet's edges and faces, so that it leaves no crumbs, and each side has a corner.
 * A tear is a cut of the links that it crosses; what is glued there is released. */
#include "cut_private.h"

#include <string.h>

#include "../base/sort.h"

enum { SBI_CUT_MOST_TEARS = 4096, SBI_CUT_TEAR_TASK = 256 };

#define SBI_CUT_TEAR_COOKIE 0x7ea21ab1u

SB_API sb_tear_options sb_default_tear_options(void)
{
    sb_tear_options options;
    memset(&options, 0, sizeof options);
    options.max_tears = 8;
    options.cookie = SBI_CUT_TEAR_COOKIE;
    return options;
}

/* ---- how much tets bear ---- */

/* A plane in the present shape. */
typedef struct sbi_cut_plane {
    sb_vec3 point, normal;
} sbi_cut_plane;

static void sbi_cut_piece_corners(const sb_cut *cut, int piece, sb_vec3 x[4])
{
    const int *nodes = sbi_cut_piece_nodes(cut, piece);
    for (int a = 0; a < 4; a++)
        x[a] = cut->body->position[nodes[a]];
}

/* Stress of a cell (Pa), mean over its points; 0: it has none. */
static int sbi_cut_mean_stress(const sb_body *body, int cell, sb_mat3 *mean)
{
    int points = sb_body_point_count(body);
    *mean = sb_m3_zero();
    for (int p = 0; p < points; p++) {
        sb_mat3 stress;
        if (sb_body_stress(body, cell, p, &stress) != SB_OK)
            return 0;
        *mean = sb_m3_add(*mean, sb_m3_scale(1 / (sb_real)points, stress));
    }
    return 1;
}

/* Area at rest of a tet's section by a plane: corners at rest X have heights h over it. */
static sb_real sbi_cut_section(const sb_vec3 X[4], const sb_real h[4])
{
    sb_vec3 points[4];
    int above[4], below[4], over = 0, under = 0, count = 0;
    for (int a = 0; a < 4; a++) {
        if (h[a] > 0)
            above[over++] = a;
        else
            below[under++] = a;
    }
    for (int i = 0; i < over; i++)
        for (int k = 0; k < under; k++) {
            int p = above[i], q = below[i % 2 ? under - 1 - k : k]; /* around the section */
            points[count++] = sb_v3_madd(sb_v3_scale(-h[q] / (h[p] - h[q]), X[p]), h[p] / (h[p] - h[q]), X[q]);
        }
    if (count < 3)
        return 0;
    return sb_v3_norm(sb_v3_cross(sb_v3_sub(points[2], points[0]),
                                  sb_v3_sub(points[count == 4 ? 3 : 1], points[count == 4 ? 1 : 0]))) /
           2;
}

/* The plane that a piece tears along if it does, and its stress over what it bears; 0: it has none. */
static sb_real sbi_cut_piece_load(const sb_cut *cut, int tet, int piece, sbi_cut_plane *plane)
{
    const sb_real least = (sb_real)0.5; /* small pieces hang on, and are stretched by that: they do not tear again */
    const sb_body *body = cut->body;
    const int *nodes = sbi_cut_tet_nodes(cut, tet);
    const sb_material *material = body->materials + body->cell_material[cut->pieces[piece].cell];
    sb_vec3 x[4], X[4], values;
    sb_mat3 stress, vectors;
    sb_real h[4], volume, section, bears;
    if (!(sb_body_cell_share(body, cut->pieces[piece].cell) > least) ||
        !sbi_cut_mean_stress(body, cut->pieces[piece].cell, &stress))
        return 0;
    sb_m3_eigen(stress, &values, &vectors);
    if (!(values.x > 0))
        return 0;
    sbi_cut_piece_corners(cut, piece, x);
    plane->normal = sb_m3_column(vectors, 0);
    plane->point = sb_v3_scale((sb_real)0.25, sb_v3_add(sb_v3_add(x[0], x[1]), sb_v3_add(x[2], x[3])));
    for (int a = 0; a < 4; a++) {
        X[a] = body->reference[nodes[a]];
        h[a] = sb_v3_dot(plane->normal, sb_v3_sub(x[a], plane->point));
    }
    section = sbi_cut_section(X, h);
    volume = sb_v3_dot(sb_v3_cross(sb_v3_sub(X[1], X[0]), sb_v3_sub(X[2], X[0])), sb_v3_sub(X[3], X[0])) / 6;
    bears = sb_sqrt((material->lambda + 2 * material->mu) * cut->toughness * section / (4 * volume));
    return bears > 0 ? values.x / bears : 0;
}

/* The piece of a tet that bears least, and its load. */
static sb_real sbi_cut_tet_load(const sb_cut *cut, int tet, int *worst, sbi_cut_plane *plane)
{
    sb_real most = 0;
    *worst = tet;
    for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next) {
        sbi_cut_plane of;
        sb_real load = sbi_cut_piece_load(cut, tet, piece, &of);
        if (load > most) {
            most = load;
            *worst = piece;
            *plane = of;
        }
    }
    return most;
}

static void sbi_cut_load_task(void *user, int task)
{
    sb_cut *cut = (sb_cut *)user;
    int end = sbi_min_int(SBI_CUT_TEAR_TASK * (task + 1), cut->tet_count), piece;
    sbi_cut_plane plane;
    for (int tet = SBI_CUT_TEAR_TASK * task; tet < end; tet++)
        cut->tear_loads[tet] = sbi_cut_tet_load(cut, tet, &piece, &plane);
}

/* ---- which of them tear ---- */

/* 1 when a cut has come into a piece but not through it, or the tet is held together by glue. */
static int sbi_cut_is_front(const sb_cut *cut, int tet)
{
    sbi_parted parted;
    int is_front = 0;
    sbi_parted_make(&cut->lattice, &cut->links, sbi_cut_tet_nodes(cut, tet), tet, &parted);
    for (int l = 0; l < cut->lattice.link_count && !is_front; l++) {
        const unsigned char *ends = cut->lattice.links[l];
        is_front = parted.cut[l] == SBI_LINK_PREDICTED ||
                   (parted.cut[l] && parted.piece_of[ends[0]] == parted.piece_of[ends[1]] &&
                    parted.piece_of[ends[0]] != SBI_PARTED_LOST);
    }
    return is_front;
}

static int sbi_cut_bears_less(const void *context, int a, int b)
{
    const sb_real *loads = (const sb_real *)context;
    return loads[a] > loads[b];
}

/* Lists tets that bear no more in cut->tearing, the worst first: those that a cut has come to, or, where there is none
 * of these, all. Returns how many may tear. */
static int sbi_cut_list_tearing(sb_cut *cut, const sb_tear_options *options)
{
    sbi_cut_list *list = &cut->tearing;
    int fronts = 0;
    list->count = 0;
    sbi_run(&cut->body->jobs, sbi_cut_load_task, cut, (cut->tet_count + SBI_CUT_TEAR_TASK - 1) / SBI_CUT_TEAR_TASK);
    for (int tet = 0; tet < cut->tet_count; tet++)
        if (cut->tear_loads[tet] > 1 && sbi_cut_is_front(cut, tet))
            list->items[fronts++] = tet;
    for (int tet = 0; tet < cut->tet_count && options->nucleate && !fronts; tet++)
        if (cut->tear_loads[tet] > 1)
            list->items[list->count++] = tet;
    list->count = sbi_max_int(list->count, fronts);
    sbi_merge_sort(list->items, cut->tearing_scratch.items, list->count, sbi_cut_bears_less, cut->tear_loads);
    return sbi_min_int(options->max_tears, fronts ? fronts : 1);
}

/* ---- a tear ---- */

/* Has a plane go on from the middle of the crossings that have come into a piece. */
static void sbi_cut_join_front(const sb_cut *cut, const sbi_parted *parted, uint64_t points, const sb_vec3 x[4],
                               sbi_cut_plane *plane)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    int count = 0;
    for (int l = 0; l < cut->lattice.link_count; l++) {
        const unsigned char *link = cut->lattice.links[l];
        sb_real first[4], last[4];
        int ends[2];
        if (!parted->cut[l] || !(points >> link[0] & points >> link[1] & 1))
            continue;
        sbi_lattice_ends(&cut->lattice, &parted->order, l, ends);
        sbi_lattice_point(&cut->lattice, ends[0], first);
        sbi_lattice_point(&cut->lattice, ends[1], last);
        for (int a = 0; a < 4; a++)
            first[a] += parted->t[l] * (last[a] - first[a]);
        sum = sb_v3_add(sum, sbi_lattice_place(&parted->order, first, x));
        count++;
    }
    if (count)
        plane->point = sb_v3_scale(1 / (sb_real)count, sum);
}

/* Which corners of a piece, as bits, go to one side of a tear: cuts that have come to edges go on, and else sides are
 * as by the heights of corners over its plane as may be. 0: a piece with one corner does not tear. */
static int sbi_cut_choose_side(const sb_cut *cut, const sbi_parted *parted, uint64_t points, const sb_real heights[4])
{
    int present = (int)(points & 15), cut_edges[6], edges = 0, best = 0, most = -1;
    sb_real highest = 0;
    for (int l = 0; l < cut->lattice.link_count; l++) {
        int corners = sbi_lattice_link_corners(&cut->lattice, l), listed = 0;
        for (int k = 0; k < edges; k++)
            listed |= cut_edges[k] == corners;
        if (parted->cut[l] && (corners & present) == corners && !listed &&
            (corners == 3 || corners == 5 || corners == 6 || corners == 9 || corners == 10 || corners == 12))
            cut_edges[edges++] = corners;
    }
    for (int side = 1; side < present; side++) {
        int kept = 0;
        sb_real height = 0;
        if ((side & present) != side)
            continue;
        for (int k = 0; k < edges; k++)
            kept += (cut_edges[k] & side) != 0 && (cut_edges[k] & side) != cut_edges[k];
        for (int a = 0; a < 4; a++)
            height += (present >> a & 1) ? (side >> a & 1 ? heights[a] : -heights[a]) : 0;
        if (kept > most || (kept == most && height > highest)) {
            most = kept;
            highest = height;
            best = side;
        }
    }
    return best;
}

/* Sides of lattice points: 1 or -1, 0 where it is open. */
typedef struct sbi_cut_sides {
    signed char of[SBI_LATTICE_POINTS];
} sbi_cut_sides;

/* Takes sides over whole links within an edge or a face (corners, as bits) that has been cut, unless both meet there.
 */
static void sbi_cut_spread_sides(const sb_cut *cut, const sbi_parted *parted, uint64_t points, int corners,
                                 sbi_cut_sides *sides)
{
    sbi_cut_sides spread = *sides;
    int is_cut = 0, changed = 1, meet = 0;
    while (changed) {
        changed = 0;
        for (int l = 0; l < cut->lattice.link_count; l++) {
            const unsigned char *ends = cut->lattice.links[l];
            signed char *a = spread.of + ends[0], *b = spread.of + ends[1];
            if ((sbi_lattice_link_corners(&cut->lattice, l) & ~corners) || !(points >> ends[0] & points >> ends[1] & 1))
                continue;
            is_cut |= parted->cut[l];
            if (parted->cut[l] || *a == *b)
                continue;
            meet |= *a && *b;
            changed |= !*a || !*b;
            *a = *a ? *a : *b;
            *b = *b ? *b : *a;
        }
    }
    if (is_cut && !meet)
        *sides = spread;
}

/* Sides of all lattice points of a piece, and their heights over the tear. */
static int sbi_cut_take_sides(const sb_cut *cut, const sbi_parted *parted, uint64_t points, sb_real corners[4],
                              sb_real heights[SBI_LATTICE_POINTS], sbi_cut_sides *sides)
{
    static const int parts[10] = {3, 5, 6, 9, 10, 12, 7, 11, 13, 14}; /* edges, then faces */
    int side = sbi_cut_choose_side(cut, parted, points, corners);
    sb_real most = 0;
    memset(sides, 0, sizeof *sides);
    for (int a = 0; a < 4; a++)
        most = sb_max(most, sb_abs(corners[a]));
    for (int a = 0; a < 4; a++) {
        sb_real sign = side >> a & 1 ? 1 : -1;
        if (!(points >> a & 1))
            continue;
        sides->of[a] = (signed char)sign;
        corners[a] = sign * sb_max(sign * corners[a], most / 8);
    }
    for (int k = 0; k < 10; k++)
        sbi_cut_spread_sides(cut, parted, points, parts[k], sides);
    for (int p = 0; p < cut->lattice.point_count; p++) {
        heights[p] = 0;
        for (int a = 0; a < 4; a++)
            heights[p] += (sb_real)cut->lattice.points[p][a] * corners[a];
        if (!sides->of[p])
            sides->of[p] = heights[p] > 0 ? 1 : -1;
    }
    return side;
}

/* Cuts what lies between both sides of a tear of a piece, if that parts it; -1: no memory, else whether it does. */
static int sbi_cut_tear_piece(sb_cut *cut, int tet, int piece, const sbi_parted *parted, const sbi_cut_plane *plane)
{
    uint64_t points = cut->pieces[piece].points;
    sb_real corners[4], heights[SBI_LATTICE_POINTS];
    sbi_parted torn = *parted;
    sbi_cut_sides sides;
    sb_vec3 x[4];
    sbi_cut_piece_corners(cut, piece, x);
    for (int a = 0; a < 4; a++)
        corners[a] = sb_v3_dot(plane->normal, sb_v3_sub(x[a], plane->point));
    if (!sbi_cut_take_sides(cut, parted, points, corners, heights, &sides))
        return 0;
    for (int l = 0; l < cut->lattice.link_count; l++) {
        const unsigned char *ends = cut->lattice.links[l];
        if (!torn.cut[l] && (points >> ends[0] & points >> ends[1] & 1) && sides.of[ends[0]] != sides.of[ends[1]])
            torn.cut[l] = SBI_LINK_CUT;
    }
    sbi_parted_find(&torn);
    if (torn.piece_count <= parted->piece_count)
        return 0;
    for (int l = 0; l < cut->lattice.link_count; l++) {
        sbi_link_key key = sbi_lattice_key(&cut->lattice, &parted->order, tet, l);
        sb_real from, to;
        int ends[2];
        if (torn.cut[l] == parted->cut[l])
            continue;
        sbi_lattice_ends(&cut->lattice, &parted->order, l, ends);
        from = heights[ends[0]], to = heights[ends[1]];
        if (!sbi_cut_add_link(cut, &key, from * to < 0 ? from / (from - to) : (sb_real)0.5, SBI_LINK_CUT, -1))
            return -1;
    }
    return 1;
}

/* Crosses the predicted links of a tet, so that its glue lets go; -1: no memory, else whether there were any. */
static int sbi_cut_tear_glue(sb_cut *cut, const sbi_parted *parted)
{
    int torn = 0;
    for (int l = 0; l < cut->lattice.link_count; l++) {
        if (parted->cut[l] != SBI_LINK_PREDICTED)
            continue;
        if (!sbi_cut_cross_link(cut, parted->rank[l], -1))
            return -1;
        torn = 1;
    }
    return torn;
}

static int sbi_cut_tear_tet(sb_cut *cut, int tet)
{
    sbi_parted parted;
    sbi_cut_plane plane;
    sb_vec3 x[4];
    int piece, torn;
    sbi_parted_make(&cut->lattice, &cut->links, sbi_cut_tet_nodes(cut, tet), tet, &parted);
    torn = sbi_cut_tear_glue(cut, &parted);
    if (torn || !(sbi_cut_tet_load(cut, tet, &piece, &plane) > 1))
        return torn;
    sbi_cut_piece_corners(cut, piece, x);
    sbi_cut_join_front(cut, &parted, cut->pieces[piece].points, x, &plane);
    return sbi_cut_tear_piece(cut, tet, piece, &parted, &plane);
}

/* ---- the call ---- */

static sb_result sbi_cut_check_tear(const sb_cut *cut, const sb_tear_options *options, sb_error *error)
{
    if (!cut)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_cut_tear needs a cut");
    if (options && options->cookie != SBI_CUT_TEAR_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the options were not made by sb_default_tear_options");
    if (options && (options->max_tears < 1 || options->max_tears > SBI_CUT_MOST_TEARS))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "options.max_tears is %d, it must be in [1, %d]", options->max_tears,
                        (int)SBI_CUT_MOST_TEARS);
    if (!(cut->toughness > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.toughness is 0: what a tear takes is unknown");
    return sbi_cut_check_use(cut, error);
}

/* Lists of the first call; 0: no memory. */
static int sbi_cut_take_tears(sb_cut *cut)
{
    if (!cut->tear_loads)
        cut->tear_loads = (sb_real *)sbi_alloc(&cut->allocator, (size_t)cut->tet_count, sizeof(sb_real));
    cut->tearing.count = cut->tearing_scratch.count = 0;
    return cut->tear_loads && sbi_cut_list_grow(cut, &cut->tearing, cut->tet_count) &&
           sbi_cut_list_grow(cut, &cut->tearing_scratch, cut->tet_count);
}

SBI_API void sbi_cut_free_tears(sb_cut *cut)
{
    sbi_free(&cut->allocator, cut->tear_loads);
    sbi_free(&cut->allocator, cut->tearing.items);
    sbi_free(&cut->allocator, cut->tearing_scratch.items);
}

SB_API sb_result sb_cut_tear(sb_cut *cut, const sb_tear_options *options, sb_cut_info *info, sb_error *error)
{
    sb_tear_options defaults = sb_default_tear_options();
    int links, most, done, tears = 0, torn = 1;
    sb_result result = sbi_cut_check_tear(cut, options, error);
    if (result != SB_OK)
        return result;
    options = options ? options : &defaults;
    if (!sbi_cut_take_tears(cut))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for tears of %d cells", cut->tet_count);
    links = cut->links.count;
    most = sbi_cut_list_tearing(cut, options);
    for (int i = 0; i < cut->tearing.count && tears < most && torn >= 0; i++) {
        torn = sbi_cut_tear_tet(cut, cut->tearing.items[i]);
        tears += torn > 0;
    }
    done = torn >= 0 && (cut->keeps_rings || sbi_cut_close_rings(cut, links)) && sbi_cut_settle_seams(cut, NULL, 0);
    result = sbi_cut_finish(cut, links, 0, done, info, error);
    if (result != SB_OK)
        return result;
    if (info)
        info->torn = tears;
    sbi_cut_tell_tear(cut, options);
    return SB_OK;
}
