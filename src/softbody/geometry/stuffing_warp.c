/* stuffing_warp: 3. and 4. cuts of edges between labels, points moved onto them, a manifold boundary. */
#include "stuffing_private.h"

/* ---- 3. cuts ---- */

/* The surface point at the other end of an edge of a surface point; own 1: one it owns. -1 when there is none. */
static int sbi_stuffing_neighbour(const sbi_stuffing *s, const sbi_stuffing_point *point, int edge, int own)
{
    int half[3], step[3];
    size_t index;
    sbi_stuffing_step(edge, step);
    for (int axis = 0; axis < 3; axis++)
        half[axis] = point->half[axis] + (own ? step[axis] : -step[axis]);
    if (!sbi_stuffing_is_in(s, half))
        return -1;
    index = sbi_stuffing_index(s, half);
    return sbi_stuffing_set_has(&s->surface, index) ? sbi_stuffing_set_rank(&s->surface, index) : -1;
}

SBI_API void sbi_stuffing_value_task(void *user, int index)
{
    sbi_stuffing *s = (sbi_stuffing *)user;
    int begin = s->first + index * SBI_STUFF_CHUNK, end = sbi_min_int(begin + SBI_STUFF_CHUNK, s->surface.count);
    for (int i = begin; i < end; i++) {
        const sbi_stuffing_point *point = s->points + i;
        uint64_t needed = 0;
        for (int k = 0; k < 2 * SBI_STUFF_EDGES; k++) {
            int j = sbi_stuffing_neighbour(s, point, k >> 1, k & 1);
            if (j >= 0 && s->points[j].label != point->label)
                needed |= (uint64_t)1 << sbi_stuffing_separator(s->points[j].label, point->label);
        }
        for (int shape = 0; shape < s->def->shape_count; shape++)
            if (needed >> shape & 1) {
                sb_vec3 p = sbi_stuffing_position(s, point->half);
                sb_real value = sbi_stuffing_value(s, shape, p);
                if (s->def->shapes[shape].surface) /* the label knows better, see sbi_stuffing_value */
                    value = point->label && point->label >= shape + 1 ? -sb_abs(value) : sb_abs(value);
                s->values[(size_t)i * (size_t)s->def->shape_count + (size_t)shape] = value;
                if (!sb_is_finite(value)) {
                    s->failures[index].shape = shape;
                    s->failures[index].at = p;
                    return;
                }
            }
    }
}

/* Where an edge crosses a shape's surface: its ends, the values there, and what is asked in between. */
typedef struct sbi_stuffing_crossing {
    const sbi_stuffing *s;
    int shape;
    int sure; /* 1: sbi_stuffing_sure_value */
    sb_vec3 from, edge;
    sb_real f0, f1;
} sbi_stuffing_crossing;

/* Fraction of the edge at which the function changes sign: regula falsi after Illinois, with a bisection now and then
 * for functions that are far from straight. *residual: the function there, or not finite at the fraction returned. */
static sb_real sbi_stuffing_root(const sbi_stuffing_crossing *c, sb_real *residual)
{
    const sb_real tolerance = sb_max((sb_real)1.5e-8, 32 * SB_EPSILON);
    sb_real ta = 0, tb = 1, t = 0, fa = c->f0, fb = c->f1, enough = tolerance * (sb_abs(fa) + sb_abs(fb));
    int last = 0;
    *residual = 0;
    if (fa == 0 || fb == 0)
        return fa == 0 ? (sb_real)0 : (sb_real)1;
    for (int i = 0; i < 80 && tb - ta > tolerance; i++) {
        sb_real f;
        sb_vec3 p;
        t = i % 4 == 3 ? (sb_real)0.5 * (ta + tb) : ta + (tb - ta) * (fa / (fa - fb));
        p = sb_v3_madd(c->from, t, c->edge);
        f = c->sure ? sbi_stuffing_sure_value(c->s, c->shape, p) : sbi_stuffing_value(c->s, c->shape, p);
        *residual = f;
        if (!sb_is_finite(f) || sb_abs(f) <= enough)
            return t;
        if ((f < 0) == (fa < 0)) {
            fb *= last == 1 ? (sb_real)0.5 : (sb_real)1;
            ta = t;
            fa = f;
            last = 1;
        } else {
            fa *= last == 2 ? (sb_real)0.5 : (sb_real)1;
            tb = t;
            fb = f;
            last = 2;
        }
    }
    return t;
}

/* The cut between two surface points. The quick sign of surfaces can change where there is none (see
 * sbi_stuffing_value): then the surface is not near, and the sure one looks again. */
static sb_real sbi_stuffing_cut_at(const sbi_stuffing *s, int i, int j, sbi_stuffing_failure *failure)
{
    int shape = sbi_stuffing_separator(s->points[i].label, s->points[j].label);
    size_t shapes = (size_t)s->def->shape_count;
    sbi_stuffing_crossing c;
    sb_real t, residual;
    c.s = s;
    c.shape = shape;
    c.sure = 0;
    c.from = sbi_stuffing_position(s, s->points[i].half);
    c.edge = sb_v3_sub(sbi_stuffing_position(s, s->points[j].half), c.from);
    c.f0 = s->values[(size_t)i * shapes + (size_t)shape];
    c.f1 = s->values[(size_t)j * shapes + (size_t)shape];
    t = sbi_stuffing_root(&c, &residual);
    if (s->def->shapes[shape].surface && sb_abs(residual) > (sb_real)1e-3 * s->half) {
        c.sure = 1;
        t = sbi_stuffing_root(&c, &residual);
    }
    if (!sb_is_finite(residual)) {
        failure->shape = shape;
        failure->at = sb_v3_madd(c.from, t, c.edge);
    }
    return t;
}

SBI_API void sbi_stuffing_cut_task(void *user, int index)
{
    sbi_stuffing *s = (sbi_stuffing *)user;
    int begin = s->first + index * SBI_STUFF_CHUNK, end = sbi_min_int(begin + SBI_STUFF_CHUNK, s->surface.count);
    for (int i = begin; i < end; i++)
        for (int edge = 0; edge < SBI_STUFF_EDGES; edge++) {
            sbi_stuffing_point *point = s->points + i;
            int j = sbi_stuffing_neighbour(s, point, edge, 1);
            point->cut[edge] = -1;
            if (j < 0 || s->points[j].label == point->label)
                continue;
            point->cut[edge] = sbi_stuffing_cut_at(s, i, j, s->failures + index);
            if (s->failures[index].shape >= 0)
                return;
        }
}

SBI_API sb_result sbi_stuffing_over_points(sbi_stuffing *s, sb_task task, double from, double to)
{
    sb_result result = SB_OK;
    for (s->first = 0; s->first < s->surface.count && result == SB_OK;) {
        int chunks = (s->surface.count - s->first - 1) / SBI_STUFF_CHUNK + 1;
        chunks = sbi_min_int(chunks, 64);
        result = sbi_stuffing_progress(s, from + (to - from) * s->first / s->surface.count);
        if (result == SB_OK)
            result = sbi_stuffing_run(s, task, chunks);
        if (chunks * SBI_STUFF_CHUNK >= s->surface.count - s->first)
            break;
        s->first += chunks * SBI_STUFF_CHUNK;
    }
    return result;
}

/* ---- 4. warping ---- */

/* One edge of a surface point, seen from it. */
typedef struct sbi_stuffing_edge {
    int other;                /* surface point */
    sb_real fraction, length; /* of the cut from the point; of the edge in cells */
    sb_real alpha;
    int inner; /* 1: between two regions; 0: to the outside */
} sbi_stuffing_edge;

/* Edge k in [0, 14) of a surface point; 0 when no cut is left on it. A cut to the outside lives while its outer end is
 * strict and its inner end is not on the boundary; one between regions lives while both ends are strict. */
static int sbi_stuffing_live_edge(const sbi_stuffing *s, int i, int k, sbi_stuffing_edge *e)
{
    const sbi_stuffing_point *a = s->points + i, *b;
    int own = k < SBI_STUFF_EDGES, edge = k % SBI_STUFF_EDGES;
    e->other = sbi_stuffing_neighbour(s, a, edge, own);
    if (e->other < 0 || s->points[e->other].label == a->label)
        return 0;
    b = s->points + e->other;
    e->inner = a->label != 0 && b->label != 0;
    if (a->state == SBI_STUFF_OUTER || b->state == SBI_STUFF_OUTER || (e->inner && (a->state || b->state)))
        return 0;
    e->fraction = own ? a->cut[edge] : 1 - b->cut[edge];
    e->length = edge < 3 ? (sb_real)1 : SBI_STUFF_SHORT;
    e->alpha = edge < 3 ? SBI_STUFF_ALPHA_LONG : SBI_STUFF_ALPHA_SHORT;
    return 1;
}

/* Makes a point a zero, and moves it to a cut on the edge when there is one. */
static void sbi_stuffing_make_zero(sbi_stuffing *s, int i, sbi_stuffing_state state, const sbi_stuffing_edge *to)
{
    sbi_stuffing_point *point = s->points + i;
    point->state = (unsigned char)state;
    if (to) {
        sb_vec3 a = sbi_stuffing_position(s, point->half), b = sbi_stuffing_position(s, s->points[to->other].half);
        s->positions[point->active] = sb_v3_madd(a, to->fraction, sb_v3_sub(b, a));
        point->moved = to->fraction * to->length;
    }
}

/* Inside, with an edge to the outside: the tets there take it for a point in its place. */
static int sbi_stuffing_is_pinned(const sbi_stuffing *s, int i)
{
    sbi_stuffing_edge e;
    if (s->points[i].label == 0)
        return 0;
    for (int k = 0; k < 2 * SBI_STUFF_EDGES; k++)
        if (sbi_stuffing_live_edge(s, i, k, &e) && !e.inner)
            return 1;
    return 0;
}

/* The nearest cut of a point towards the outside or between regions, among those within alpha, or any. */
static int sbi_stuffing_nearest_cut(const sbi_stuffing *s, int i, int inner, int any, sbi_stuffing_edge *nearest)
{
    sbi_stuffing_edge e;
    int found = 0;
    for (int k = 0; k < 2 * SBI_STUFF_EDGES; k++) {
        if (!sbi_stuffing_live_edge(s, i, k, &e) || e.inner != inner || (!any && !(e.fraction < e.alpha)))
            continue;
        if (!found || e.fraction * e.length < nearest->fraction * nearest->length)
            *nearest = e;
        found = 1;
    }
    return found;
}

/* Warps the points to their nearest cut within alpha: those to the outside first, then those between regions. */
static void sbi_stuffing_warp(sbi_stuffing *s, int inner)
{
    for (int i = 0; i < s->surface.count; i++) {
        sbi_stuffing_edge to;
        if (s->points[i].state != SBI_STUFF_STRICT || !sbi_stuffing_nearest_cut(s, i, inner, 0, &to))
            continue;
        if (inner)
            sbi_stuffing_make_zero(s, i, SBI_STUFF_INNER, sbi_stuffing_is_pinned(s, i) ? NULL : &to);
        else
            sbi_stuffing_make_zero(s, i, SBI_STUFF_OUTER, &to);
    }
}

SBI_API void sbi_stuffing_look(const sbi_stuffing *s, const int *nodes, sbi_stuffing_view *v)
{
    v->nodes = nodes;
    v->outside = v->zeros = v->inner_zeros = v->more = 0;
    v->a = v->b = -1;
    for (int i = 0; i < 4; i++) {
        int point = s->point_of[nodes[i]], state = point < 0 ? 0 : s->points[point].state;
        v->point[i] = point;
        v->label[i] = state ? -1 : s->active_label[nodes[i]];
        v->zeros += state != SBI_STUFF_STRICT;
        v->inner_zeros += state == SBI_STUFF_INNER;
        v->outside |= v->label[i] == 0;
        if (v->label[i] <= 0 || v->label[i] == v->a || v->label[i] == v->b)
            continue;
        if (v->a < 0)
            v->a = v->label[i];
        else if (v->b < 0)
            v->b = v->label[i];
        else
            v->more = 1;
    }
}

/* Makes zeros of inner points, the nearest to a face between regions first, until the tet sees two labels at most. */
static void sbi_stuffing_settle_tet(sbi_stuffing *s, const int *nodes)
{
    sbi_stuffing_view v;
    for (;;) {
        int chosen = -1;
        sb_real nearest = SB_REAL_MAX;
        sbi_stuffing_look(s, nodes, &v);
        if (!(v.outside ? v.b >= 0 : v.more))
            return;
        for (int i = 0; i < 4; i++) {
            sbi_stuffing_edge e;
            if (v.label[i] > 0 && sbi_stuffing_nearest_cut(s, v.point[i], 1, 1, &e) &&
                e.fraction * e.length < nearest) {
                nearest = e.fraction * e.length;
                chosen = v.point[i];
            }
        }
        sbi_stuffing_make_zero(s, chosen, SBI_STUFF_INNER, NULL);
    }
}

static void sbi_stuffing_settle(sbi_stuffing *s)
{
    for (int t = 0; t < s->tet_count; t++)
        sbi_stuffing_settle_tet(s, s->tets + 4 * (size_t)t);
}

SBI_API int sbi_stuffing_is_well_shaped(const sb_vec3 corners[4])
{
    const sb_real cos_10_7 = (sb_real)0.98260, cos_164_8 = (sb_real)-0.96500;
    sb_real of_smallest, of_largest;
    sbi_mesh_tet_cosines(corners, &of_smallest, &of_largest);
    return of_smallest <= cos_10_7 && of_largest >= cos_164_8;
}

SBI_API sb_vec3 sbi_stuffing_centroid(const sb_vec3 corners[4])
{
    return sb_v3_scale((sb_real)0.25, sb_v3_add(sb_v3_add(corners[0], corners[1]), sb_v3_add(corners[2], corners[3])));
}

SBI_API int sbi_stuffing_label_of_four(const sbi_stuffing *s, const int points[4])
{
    sb_vec3 corners[4];
    int label, inner = 0, highest = 0;
    for (int i = 0; i < 4; i++) {
        const sbi_stuffing_point *point = s->points + points[i];
        corners[i] = sbi_stuffing_position(s, point->half);
        inner |= point->state == SBI_STUFF_INNER;
        highest = sbi_max_int(highest, point->label);
    }
    if (highest == 0) /* not among the tets */
        return 0;
    label = sbi_stuffing_label_at(s, sbi_stuffing_centroid(corners));
    return inner && label == 0 ? highest : label;
}

/* A tet of four zeros can be flat. Where one is needed its most displaced point goes half of the way back to its place
 * in the lattice. Any place on the way is one of the cases that the angles' bounds were found over, so no other tet
 * leaves them; only this point leaves the surface. Returns 1 when it moved one. */
static int sbi_stuffing_relax_tet(sbi_stuffing *s, const int *nodes)
{
    sbi_stuffing_view v;
    sbi_stuffing_point *worst = NULL;
    sb_vec3 place, corners[4], *now;
    sbi_stuffing_look(s, nodes, &v);
    if (v.zeros < 4)
        return 0;
    for (int i = 0; i < 4; i++)
        corners[i] = s->positions[nodes[i]];
    if (sbi_stuffing_is_well_shaped(corners) || sbi_stuffing_label_of_four(s, v.point) == 0)
        return 0;
    for (int i = 0; i < 4; i++)
        if (!worst || s->points[v.point[i]].moved > worst->moved)
            worst = s->points + v.point[i];
    place = sbi_stuffing_position(s, worst->half);
    now = s->positions + worst->active;
    worst->moved *= (sb_real)0.5;
    *now = sb_v3_madd(place, (sb_real)0.5, sb_v3_sub(*now, place));
    return 1;
}

/* ---- 4a. a manifold boundary ----
 * Where the shape is about as thin as a cell, parts of it can come to touch at a zero or along an edge of zeros. A zero
 * sees 14 neighbours, the corners of 24 triangles round it. The boundary is a single sheet there when the triangles
 * that have something inside hang together, and those outside, across edges of the triangles. Where it is not, the zero
 * is freed: it goes back to its place and its side, and cuts nearer to it than alpha are put at alpha (angles keep
 * their bounds, the boundary leaves the surface there by less than a third of a cell). Lattices without zeros have
 * manifold boundaries: this ends. */

typedef struct sbi_stuffing_link {
    int step[14][3]; /* to the neighbours: 6 long edges, 8 short */
    int triangle[24][3];
    int beside[24][3]; /* triangle across the edge opposite corner i */
} sbi_stuffing_link;

static int sbi_stuffing_has_corner(const int triangle[3], int corner)
{
    return triangle[0] == corner || triangle[1] == corner || triangle[2] == corner;
}

static void sbi_stuffing_make_link(sbi_stuffing_link *link)
{
    int count = 0;
    for (int k = 0; k < 14; k++)
        for (int axis = 0; axis < 3; axis++)
            link->step[k][axis] = k < 6 ? (k >> 1 == axis ? (k & 1 ? 2 : -2) : 0) : (k - 6) >> axis & 1 ? 1 : -1;
    for (int l = 0; l < 6; l++) /* a long edge and two short ones that lean its way and differ along one axis */
        for (int a = 6; a < 14; a++)
            for (int b = a + 1; b < 14; b++) {
                int axis = l >> 1, bit = 1 << axis, differ = (a - 6) ^ (b - 6);
                if (((a - 6) >> axis & 1) != (l & 1) || (differ & bit) || (differ & (differ - 1)))
                    continue;
                link->triangle[count][0] = l;
                link->triangle[count][1] = a;
                link->triangle[count++][2] = b;
            }
    for (int t = 0; t < 24; t++)
        for (int i = 0; i < 3; i++)
            for (int u = 0; u < 24; u++)
                if (u != t && sbi_stuffing_has_corner(link->triangle[u], link->triangle[t][(i + 1) % 3]) &&
                    sbi_stuffing_has_corner(link->triangle[u], link->triangle[t][(i + 2) % 3]))
                    link->beside[t][i] = u;
}

/* Sides of the 14 neighbours of a zero: +1 inside, -1 outside, 0 on the boundary; their surface points, -1: none. */
static void sbi_stuffing_link_sides(const sbi_stuffing *s, const sbi_stuffing_link *link, int i, int points[14],
                                    int sides[14])
{
    for (int k = 0; k < 14; k++) {
        int half[3];
        size_t index;
        for (int axis = 0; axis < 3; axis++)
            half[axis] = s->points[i].half[axis] + link->step[k][axis];
        index = sbi_stuffing_index(s, half);
        points[k] = sbi_stuffing_set_has(&s->surface, index) ? sbi_stuffing_set_rank(&s->surface, index) : -1;
        sides[k] = points[k] >= 0 && s->points[points[k]].state == SBI_STUFF_OUTER ? 0 : s->labels[index] ? 1 : -1;
    }
}

/* Parts of one side that hang together round a zero. Corners on that side stand for the triangles they belong to;
 * triangles of zeros (bit 14 + t) stand for themselves. */
static int sbi_stuffing_count_parts(const sbi_stuffing_link *link, const int sides[14], const int side_of_triangle[24],
                                    int side)
{
    uint64_t near_by[38], left = 0;
    int parts = 0;
    memset(near_by, 0, sizeof near_by);
    for (int t = 0; t < 24; t++) {
        const int *corner = link->triangle[t];
        int zeros = sides[corner[0]] == 0 && sides[corner[1]] == 0 && sides[corner[2]] == 0;
        for (int i = 0; i < 3; i++) {
            int a = corner[(i + 1) % 3], b = corner[(i + 2) % 3], u = link->beside[t][i], mine, other = 0;
            if (sides[corner[i]] == side)
                left |= (uint64_t)1 << corner[i];
            if (sides[a] == side && sides[b] == side) {
                near_by[a] |= (uint64_t)1 << b;
                near_by[b] |= (uint64_t)1 << a;
            }
            if (sides[a] != 0 || sides[b] != 0)
                continue;
            while (link->triangle[u][other] == a || link->triangle[u][other] == b)
                other++;
            other = link->triangle[u][other];
            mine = zeros ? 14 + t : corner[i];
            if ((zeros ? side_of_triangle[t] : sides[mine]) != side)
                continue;
            left |= (uint64_t)1 << mine;
            if (sides[other] == side)
                near_by[mine] |= (uint64_t)1 << other;
            else if (sides[other] == 0 && side_of_triangle[u] == side)
                near_by[mine] |= (uint64_t)1 << (14 + u);
        }
    }
    for (; left; parts++) {
        uint64_t reached = left & (~left + 1), before = 0;
        while (reached != before) {
            before = reached;
            for (int k = 0; k < 38; k++)
                reached |= reached >> k & 1 ? near_by[k] : 0;
        }
        left &= ~reached;
    }
    return parts;
}

static int sbi_stuffing_is_sheet(const sbi_stuffing *s, const sbi_stuffing_link *link, int i)
{
    int points[14], sides[14], side_of_triangle[24];
    sbi_stuffing_link_sides(s, link, i, points, sides);
    for (int t = 0; t < 24; t++) {
        const int *corner = link->triangle[t];
        int tet[4];
        side_of_triangle[t] = 0;
        if (sides[corner[0]] || sides[corner[1]] || sides[corner[2]])
            continue;
        tet[0] = i;
        for (int k = 0; k < 3; k++)
            tet[1 + k] = points[corner[k]];
        side_of_triangle[t] = sbi_stuffing_label_of_four(s, tet) ? 1 : -1;
    }
    return sbi_stuffing_count_parts(link, sides, side_of_triangle, 1) <= 1 &&
           sbi_stuffing_count_parts(link, sides, side_of_triangle, -1) <= 1;
}

static void sbi_stuffing_free_pinches(sbi_stuffing *s)
{
    sbi_stuffing_link link;
    int changed = 1;
    sbi_stuffing_make_link(&link);
    while (changed) {
        changed = 0;
        for (int i = 0; i < s->surface.count; i++) {
            sbi_stuffing_point *point = s->points + i;
            if (point->state != SBI_STUFF_OUTER || sbi_stuffing_is_sheet(s, &link, i))
                continue;
            point->state = SBI_STUFF_STRICT;
            point->moved = 0;
            s->positions[point->active] = sbi_stuffing_position(s, point->half);
            changed = 1;
        }
    }
}

SBI_API void sbi_stuffing_place_zeros(sbi_stuffing *s)
{
    int changed = 1;
    sbi_stuffing_warp(s, 0);
    sbi_stuffing_free_pinches(s);
    if (s->def->shape_count > 1) {
        sbi_stuffing_settle(s);
        sbi_stuffing_warp(s, 1);
        sbi_stuffing_settle(s);
    }
    while (changed) {
        changed = 0;
        for (int t = 0; t < s->tet_count; t++)
            changed |= sbi_stuffing_relax_tet(s, s->tets + 4 * (size_t)t);
    }
}
