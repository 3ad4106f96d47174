/* surface_query: closest points, signed distances; batches of all queries. */
#include "surface_tree.h"

/* ---- the closest point of a triangle ------------------------------------------------------------------------- */

/* Square of p - v ab - w ac: the offset of the point from its place on the triangle. */
static sb_real sbi_surface_spot_square(const sbi_surface_spot *spot, sb_vec3 p, sb_vec3 ab, sb_vec3 ac)
{
    sb_vec3 d = sb_v3_madd(sb_v3_madd(p, -spot->v, ab), -spot->w, ac);
    return sb_v3_dot(d, d);
}

/* Voronoi regions of corners, edges and face in turn (Ericson 2005, 5.1.5); p: relative to corner 0. */
static sbi_surface_spot sbi_surface_spot_sound(sb_vec3 p, sb_vec3 ab, sb_vec3 ac)
{
    sb_real d1 = sb_v3_dot(ab, p), d2 = sb_v3_dot(ac, p), d3, d4, d5, d6, va, vb, vc, t;
    sb_vec3 b, c;
    if (d1 <= 0 && d2 <= 0)
        return sbi_surface_spot_make(0, 0, SB_SURFACE_VERTEX, 0);
    b = sb_v3_sub(p, ab);
    d3 = sb_v3_dot(ab, b);
    d4 = sb_v3_dot(ac, b);
    if (d3 >= 0 && d4 <= d3)
        return sbi_surface_spot_make(1, 0, SB_SURFACE_VERTEX, 1);
    vc = d1 * d4 - d3 * d2;
    if (vc <= 0 && d1 >= 0 && d3 <= 0)
        return sbi_surface_spot_make(d1 / (d1 - d3), 0, SB_SURFACE_EDGE, 0);
    c = sb_v3_sub(p, ac);
    d5 = sb_v3_dot(ab, c);
    d6 = sb_v3_dot(ac, c);
    if (d6 >= 0 && d5 <= d6)
        return sbi_surface_spot_make(0, 1, SB_SURFACE_VERTEX, 2);
    vb = d5 * d2 - d1 * d6;
    if (vb <= 0 && d2 >= 0 && d6 <= 0)
        return sbi_surface_spot_make(0, d2 / (d2 - d6), SB_SURFACE_EDGE, 2);
    va = d3 * d6 - d5 * d4;
    if (va <= 0 && d4 >= d3 && d5 >= d6) {
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return sbi_surface_spot_make(1 - t, t, SB_SURFACE_EDGE, 1);
    }
    t = (sb_real)1 / (va + vb + vc);
    return sbi_surface_spot_make(vb * t, vc * t, SB_SURFACE_FACE, 0); /* thin or far: weights may be noise, see below */
}

/* Place on the edge from corner i with offset `from` to the next along `edge`, seen from p relative to the corner. */
static sbi_surface_spot sbi_surface_spot_edge(sb_vec3 p, sb_vec3 edge, int i)
{
    sb_real along = sb_v3_dot(p, edge), length = sb_v3_dot(edge, edge), t[3] = {0, 0, 0};
    int next = (i + 1) % 3;
    if (along <= 0 || !(length > 0))
        t[i] = 1, next = -1;
    else if (along >= length)
        t[next] = 1, i = next, next = -1;
    else
        t[next] = along / length, t[i] = 1 - t[next];
    return sbi_surface_spot_make(t[1], t[2], next < 0 ? SB_SURFACE_VERTEX : SB_SURFACE_EDGE, i);
}

static int sbi_surface_spot_is_outside(const sbi_surface_spot *spot)
{
    return !(spot->v >= 0 && spot->w >= 0 && spot->v + spot->w <= 1);
}

/* The nearest of what the face, if it has one, and the three edges give: cancellation in the weights, or a face that is
 * none, then do no harm. */
static sbi_surface_spot sbi_surface_spot_thin(sb_vec3 p, sb_vec3 ab, sb_vec3 ac, int flat)
{
    sb_vec3 corner[3], edge;
    sbi_surface_spot best = sbi_surface_spot_make(0, 0, SB_SURFACE_VERTEX, 0), spot;
    corner[0] = sb_v3(0, 0, 0), corner[1] = ab, corner[2] = ac;
    if (!flat) {
        spot = sbi_surface_spot_sound(p, ab, ac);
        if (!sbi_surface_spot_is_outside(&spot))
            best = spot;
    }
    best.square = sbi_surface_spot_square(&best, p, ab, ac);
    for (int i = 0; i < 3; i++) {
        edge = sb_v3_sub(corner[(i + 1) % 3], corner[i]);
        spot = sbi_surface_spot_edge(sb_v3_sub(p, corner[i]), edge, i);
        spot.square = sbi_surface_spot_square(&spot, p, ab, ac);
        if (spot.square < best.square)
            best = spot;
    }
    return best;
}

static sbi_surface_spot sbi_surface_spot_on(const sb_vec3 x[3], int shape, sb_vec3 point)
{
    sb_vec3 ab = sb_v3_sub(x[1], x[0]), ac = sb_v3_sub(x[2], x[0]), p = sb_v3_sub(point, x[0]);
    sbi_surface_spot spot;
    if (shape != SBI_SURFACE_SOUND)
        return sbi_surface_spot_thin(p, ab, ac, shape == SBI_SURFACE_FLAT);
    spot = sbi_surface_spot_sound(p, ab, ac);
    if (spot.feature == SB_SURFACE_FACE && sbi_surface_spot_is_outside(&spot))
        return sbi_surface_spot_thin(p, ab, ac, 0);
    spot.square = sbi_surface_spot_square(&spot, p, ab, ac);
    return spot;
}

/* ---- closest point ------------------------------------------------------------------------------------------- */

/* A triangle that may be the closest, its place (4 leaf + number in it), and the square of its distance from there. */
typedef struct sbi_surface_candidate {
    float square;
    int triangle, place;
} sbi_surface_candidate;

/* The state of a search: everything scaled. Distances from leaves are good to `slack`, so they narrow the search down,
 * and few candidates are left to be computed in sb_real at its end. */
typedef struct sbi_surface_search {
    sb_vec3 point;
    float p[3]; /* local */
    sb_real slack;
    float nearest; /* square: smallest distance from a leaf */
    float limit;   /* square: what is above cannot win */
    int triangle;  /* best so far, or -1 */
    sbi_surface_spot best;
    int kept;
    sbi_surface_candidate candidate[SBI_SURFACE_KEPT];
} sbi_surface_search;

/* Nothing wins beyond `distance`, a true one, or beyond one from a leaf plus its slack. */
static void sbi_surface_narrow(sbi_surface_search *q, sb_real distance)
{
    sb_real reach = sb_min(distance + q->slack, sb_sqrt((sb_real)SBI_SURFACE_NO_LIMIT));
    sb_real limit = reach * reach * (sb_real)1.00001;
    if (limit < (sb_real)q->limit)
        q->limit = (float)limit;
}

/* Computes the triangle and keeps it when it is nearer, or as near with a lower number. */
static void sbi_surface_try(sbi_surface_search *q, int triangle, const sb_vec3 x[3], int shape)
{
    sbi_surface_spot spot = sbi_surface_spot_on(x, shape, q->point);
    if (spot.square > q->best.square || !(spot.square >= 0) ||
        (spot.square == q->best.square && q->triangle >= 0 && q->triangle <= triangle))
        return;
    q->best = spot;
    q->triangle = triangle;
    sbi_surface_narrow(q, sb_sqrt(spot.square));
}

static void sbi_surface_try_number(const sb_surface *s, sbi_surface_search *q, int triangle)
{
    sb_vec3 x[3];
    sbi_surface_corners(s, triangle, x);
    sbi_surface_try(q, triangle, x, s->shape[triangle]);
}

/* Computes the candidates that may still win; they are no slivers, so they are sound. */
static void sbi_surface_try_kept(const sb_surface *s, sbi_surface_search *q)
{
    for (int i = 0; i < q->kept; i++)
        if (q->candidate[i].square <= q->limit)
            sbi_surface_try(q, q->candidate[i].triangle, s->exact[q->candidate[i].place], SBI_SURFACE_SOUND);
    q->kept = 0;
}

/* Squares of the distances to the four boxes of a node. */
SBI_FORCE_INLINE sbi_four sbi_surface_box_squares(const sbi_surface_node *node, const float p[3])
{
    sbi_four square = sbi_four_of(0.0f), zero = square;
    for (int axis = 0; axis < 3; axis++) {
        sbi_four x = sbi_four_of(p[axis]);
        sbi_four below = sbi_four_sub(sbi_four_load(node->low[axis]), x);
        sbi_four above = sbi_four_sub(x, sbi_four_load(node->high[axis]));
        x = sbi_four_max(sbi_four_max(below, above), zero);
        square = sbi_four_madd(square, x, x);
    }
    return square;
}

SBI_FORCE_INLINE sbi_four sbi_four_dot(const sbi_four a[3], const sbi_four b[3])
{
    return sbi_four_madd(sbi_four_madd(sbi_four_mul(a[0], b[0]), a[1], b[1]), a[2], b[2]);
}

/* Squares of the distances to the four coins of a node. The square of the way aside is a difference: its rounding is
 * taken off. */
SBI_FORCE_INLINE sbi_four sbi_surface_coin_squares(const sbi_surface_node *node, const float p[3])
{
    sbi_four d[3], normal[3], all, height, aside;
    const sbi_four zero = sbi_four_of(0.0f);
    for (int axis = 0; axis < 3; axis++) {
        d[axis] = sbi_four_sub(sbi_four_of(p[axis]), sbi_four_load(node->coin[SBI_COIN_CENTRE + axis]));
        normal[axis] = sbi_four_load(node->coin[SBI_COIN_NORMAL + axis]);
    }
    all = sbi_four_dot(d, d);
    height = sbi_four_dot(d, normal);
    aside = sbi_four_sub(sbi_four_mul(all, sbi_four_of(1.0f - 1.0e-6f)), sbi_four_mul(height, height));
    aside = sbi_four_sub(sbi_four_sqrt(sbi_four_max(aside, zero)), sbi_four_load(node->coin[SBI_COIN_RADIUS]));
    height = sbi_four_max(height, sbi_four_sub(zero, height));
    height = sbi_four_sub(height, sbi_four_load(node->coin[SBI_COIN_THICKNESS]));
    aside = sbi_four_max(aside, zero);
    height = sbi_four_max(height, zero);
    return sbi_four_madd(sbi_four_mul(aside, aside), height, height);
}

/* Three rows of a leaf from row i on. */
SBI_FORCE_INLINE void sbi_surface_leaf_vector(const sbi_surface_leaf *leaf, int i, sbi_four v[3])
{
    for (int axis = 0; axis < 3; axis++)
        v[axis] = sbi_four_load(leaf->f[i + axis]);
}

/* a b - c d */
SBI_FORCE_INLINE sbi_four sbi_four_det(sbi_four a, sbi_four b, sbi_four c, sbi_four d)
{
    return sbi_four_sub(sbi_four_mul(a, b), sbi_four_mul(c, d));
}

/* Square of the distance of (x, y) to the segment from the origin to (ex, ey); inverse: 1 / its length^2. */
SBI_FORCE_INLINE sbi_four sbi_surface_segment_square(sbi_four x, sbi_four y, sbi_four ex, sbi_four ey, sbi_four inverse)
{
    sbi_four t = sbi_four_mul(sbi_four_madd(sbi_four_mul(x, ex), y, ey), inverse);
    t = sbi_four_max(sbi_four_min(t, sbi_four_of(1.0f)), sbi_four_of(0.0f));
    x = sbi_four_sub(x, sbi_four_mul(t, ex));
    y = sbi_four_sub(y, sbi_four_mul(t, ey));
    return sbi_four_madd(sbi_four_mul(x, x), y, y);
}

/* Squares of the distances to the four triangles of a leaf: in each one's plane the point is inside, where only the
 * height counts, or nearest to one of the edges. */
SBI_FORCE_INLINE sbi_four sbi_surface_leaf_squares(const sbi_surface_leaf *leaf, const float p[3])
{
    sbi_four d[3], along[3], across[3], normal[3], x, y, z, u, v, length, c, height, plane, outside;
    const sbi_four zero = sbi_four_of(0.0f);
    sbi_surface_leaf_vector(leaf, SBI_LEAF_ORIGIN, d);
    sbi_surface_leaf_vector(leaf, SBI_LEAF_ALONG, along);
    sbi_surface_leaf_vector(leaf, SBI_LEAF_ACROSS, across);
    for (int axis = 0; axis < 3; axis++) {
        int next = (axis + 1) % 3, last = (axis + 2) % 3;
        d[axis] = sbi_four_sub(sbi_four_of(p[axis]), d[axis]);
        normal[axis] = sbi_four_det(along[next], across[last], along[last], across[next]);
    }
    x = sbi_four_dot(d, along);
    y = sbi_four_dot(d, across);
    z = sbi_four_dot(d, normal);
    length = sbi_four_load(leaf->f[SBI_LEAF_AB]);
    c = sbi_four_load(leaf->f[SBI_LEAF_C]);
    height = sbi_four_load(leaf->f[SBI_LEAF_C + 1]);
    u = sbi_four_sub(x, sbi_four_max(sbi_four_min(x, length), zero));
    plane = sbi_four_madd(sbi_four_mul(u, u), y, y);
    plane = sbi_four_min(plane, sbi_surface_segment_square(x, y, c, height, sbi_four_load(leaf->f[SBI_LEAF_AC])));
    outside = sbi_four_max(sbi_four_sub(zero, y), sbi_four_det(c, y, height, x));
    u = sbi_four_sub(x, length);
    v = sbi_four_sub(c, length);
    plane = sbi_four_min(plane, sbi_surface_segment_square(u, y, v, height, sbi_four_load(leaf->f[SBI_LEAF_BC])));
    outside = sbi_four_max(outside, sbi_four_det(height, u, v, y));
    /* 0 inside; just outside, where the factor is too small, a bound that is too low does no harm */
    outside = sbi_four_mul(sbi_four_max(outside, zero), sbi_four_of(1.0e20f));
    return sbi_four_madd(sbi_four_min(plane, outside), z, z);
}

static void sbi_surface_search_leaf(const sb_surface *s, const sbi_surface_leaf *leaf, sbi_surface_search *q)
{
    float square[SBI_SURFACE_WIDTH];
    sbi_four_store(square, sbi_surface_leaf_squares(leaf, q->p));
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++) {
        if (square[k] > q->limit || leaf->triangle[k] == SBI_SURFACE_NO_TRIANGLE)
            continue;
        if (leaf->triangle[k] < 0) {
            sbi_surface_try_number(s, q, ~leaf->triangle[k]);
            continue;
        }
        if (square[k] < q->nearest) {
            q->nearest = square[k];
            sbi_surface_narrow(q, sb_sqrt((sb_real)square[k]) + q->slack);
        }
        if (q->kept == SBI_SURFACE_KEPT)
            sbi_surface_try_kept(s, q);
        q->candidate[q->kept].square = square[k];
        q->candidate[q->kept].place = (int)(leaf - s->leaf) * SBI_SURFACE_WIDTH + k;
        q->candidate[q->kept++].triangle = leaf->triangle[k];
    }
}

SBI_FORCE_INLINE void sbi_surface_order(uint64_t *far, uint64_t *near)
{
    uint64_t a = *far, b = *near;
    *far = a > b ? a : b;
    *near = a > b ? b : a;
}

/* Asks for the memory of a child that will be looked at soon: for as much as a leaf takes, to spare a branch. */
SBI_FORCE_INLINE void sbi_surface_prefetch(const sb_surface *s, int child)
{
    const void *at = child < 0 ? (const void *)(s->leaf + ~child) : (const void *)(s->tree + child);
    for (size_t i = 0; i < sizeof *s->leaf; i += SBI_SURFACE_LINE)
        SBI_PREFETCH(at, i);
}

/* Pushes the children of a node that may win, the nearest last; returns the new top. */
static int sbi_surface_push(const sb_surface *s, const sbi_surface_node *node, const sbi_surface_search *q,
                            uint64_t *stack, int top)
{
    float square[SBI_SURFACE_WIDTH];
    uint64_t visit[SBI_SURFACE_WIDTH];
    sbi_four_store(square, sbi_four_max(sbi_surface_box_squares(node, q->p), sbi_surface_coin_squares(node, q->p)));
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++)
        visit[k] = sbi_surface_visit(square[k], node->child[k]);
    sbi_surface_order(visit, visit + 1);
    sbi_surface_order(visit + 2, visit + 3);
    sbi_surface_order(visit, visit + 2);
    sbi_surface_order(visit + 1, visit + 3);
    sbi_surface_order(visit + 1, visit + 2);
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++) {
        stack[top] = visit[k];
        top += sbi_surface_visit_square(visit[k]) <= q->limit;
    }
    sbi_surface_prefetch(s, sbi_surface_visit_child(visit[3]));
    sbi_surface_prefetch(s, sbi_surface_visit_child(visit[2]));
    return top;
}

static void sbi_surface_search_tree(const sb_surface *s, sbi_surface_search *q)
{
    uint64_t stack[SBI_SURFACE_STACK + SBI_SURFACE_WIDTH];
    int top = 0;
    stack[top++] = sbi_surface_visit(0.0f, 0);
    while (top > 0) {
        uint64_t visit = stack[--top];
        int child = sbi_surface_visit_child(visit);
        if (sbi_surface_visit_square(visit) > q->limit)
            continue;
        if (child < 0)
            sbi_surface_search_leaf(s, s->leaf + ~child, q);
        else
            top = sbi_surface_push(s, s->tree + child, q, stack, top);
    }
    sbi_surface_try_kept(s, q);
}

/* Finds the closest triangle within the square distance q->best.square, which the caller has set. */
static void sbi_surface_find(const sb_surface *s, sb_vec3 point, int hint, sbi_surface_search *q)
{
    sb_real far;
    q->triangle = -1;
    q->point = sb_v3_scale(s->scale, point);
    far = sbi_surface_far(s, q->point);
    if (!(far <= sbi_surface_horizon()))
        return;
    q->slack = (sb_real)SBI_SURFACE_SLACK * (far + 1);
    q->nearest = q->limit = SBI_SURFACE_NO_LIMIT;
    q->kept = 0;
    sbi_surface_narrow(q, sb_sqrt(q->best.square));
    if (hint >= 0 && hint < s->triangle_count)
        sbi_surface_try_number(s, q, hint);
    if (far > (sb_real)SBI_SURFACE_FAR) {
        for (int t = 0; t < s->triangle_count; t++)
            sbi_surface_try_number(s, q, t);
        return;
    }
    sbi_surface_to_local(s, q->point, q->p);
    sbi_surface_search_tree(s, q);
}

static sb_real sbi_surface_infinity(void) { return (sb_real)INFINITY; }

SBI_API void sbi_surface_miss(sb_surface_hit *hit)
{
    memset(hit, 0, sizeof *hit);
    hit->triangle = hit->element = -1;
    hit->distance = sbi_surface_infinity();
}

SBI_API void sbi_surface_report(const sb_surface *s, int triangle, const sbi_surface_spot *spot, sb_surface_hit *hit)
{
    sb_vec3 x[3], point;
    sbi_surface_corners(s, triangle, x);
    hit->triangle = triangle;
    hit->element = s->element[triangle];
    hit->feature = spot->feature == SB_SURFACE_FACE   ? SB_SURFACE_FACE
                   : spot->feature == SB_SURFACE_EDGE ? SB_SURFACE_EDGE
                                                      : SB_SURFACE_VERTEX;
    hit->index = spot->index;
    hit->weights[0] = 1 - spot->v - spot->w;
    hit->weights[1] = spot->v;
    hit->weights[2] = spot->w;
    if (spot->feature == SB_SURFACE_VERTEX)
        point = x[spot->index];
    else
        point = sb_v3_madd(sb_v3_madd(x[0], spot->v, sb_v3_sub(x[1], x[0])), spot->w, sb_v3_sub(x[2], x[0]));
    hit->point = sb_v3_scale(s->inverse, point);
    hit->distance = s->inverse * sb_sqrt(spot->square);
}

SB_API int sb_surface_closest_from(const sb_surface *surface, sb_vec3 point, sb_real max_distance, int triangle,
                                   sb_surface_hit *hit)
{
    sbi_surface_search q;
    if (hit)
        sbi_surface_miss(hit);
    if (!surface || !(max_distance >= 0))
        return 0;
    max_distance = sbi_capped_product(max_distance, surface->scale);
    q.best.square = sbi_capped_product(max_distance, max_distance);
    sbi_surface_find(surface, point, triangle, &q);
    if (q.triangle < 0)
        return 0;
    if (hit)
        sbi_surface_report(surface, q.triangle, &q.best, hit);
    return 1;
}

SB_API int sb_surface_closest(const sb_surface *surface, sb_vec3 point, sb_real max_distance, sb_surface_hit *hit)
{
    return sb_surface_closest_from(surface, point, max_distance, -1, hit);
}

/* ---- normals and signs --------------------------------------------------------------------------------------- */

/* Pseudonormal at a place; its length says how much the faces there agree, 0 that it means nothing. */
static sb_vec3 sbi_surface_pseudonormal(const sb_surface *s, int triangle, int feature, int index)
{
    sb_vec3 n;
    int mate;
    if (feature == SB_SURFACE_VERTEX)
        return s->normal[s->corners[triangle][index]];
    n = sbi_surface_unit_normal(s, triangle);
    if (feature == SB_SURFACE_FACE)
        return n;
    mate = s->mate[triangle][index];
    if (mate == SBI_SURFACE_OPEN)
        return n;
    if (mate == SBI_SURFACE_NONMANIFOLD || s->shape[triangle] == SBI_SURFACE_FLAT || s->shape[mate] == SBI_SURFACE_FLAT)
        return sb_v3(0, 0, 0);
    return sb_v3_scale((sb_real)0.5, sb_v3_add(n, sbi_surface_unit_normal(s, mate)));
}

SB_API sb_vec3 sb_surface_normal(const sb_surface *surface, const sb_surface_hit *hit)
{
    sb_vec3 n = sb_v3(0, 0, 0);
    sb_real length;
    if (!surface || !hit || hit->triangle < 0 || hit->triangle >= surface->triangle_count || hit->index < 0 ||
        hit->index > 2)
        return n;
    n = sbi_surface_pseudonormal(surface, hit->triangle, (int)hit->feature, hit->index);
    length = sb_v3_norm(n);
    return length > 0 ? sb_v3_scale((sb_real)1 / length, n) : n;
}

/* 1 inside, 0 outside, -1: the pseudonormal cannot decide. */
static int sbi_surface_side(const sb_surface *s, const sbi_surface_search *q)
{
    sb_vec3 x[3], n = sbi_surface_pseudonormal(s, q->triangle, q->best.feature, q->best.index), d;
    sb_real along;
    sbi_surface_corners(s, q->triangle, x);
    d = sb_v3_sub(q->point, x[0]);
    if (q->best.feature == SB_SURFACE_FACE) {
        along = sb_v3_dot(d, n);
        return along < 0;
    }
    d = sb_v3_madd(sb_v3_madd(d, -q->best.v, sb_v3_sub(x[1], x[0])), -q->best.w, sb_v3_sub(x[2], x[0]));
    along = sb_v3_dot(d, n);
    if (along * along > SB_EPSILON * q->best.square)
        return along < 0;
    return -1;
}

/* Closest point and unsigned distance, from the hint; returns 0 and writes *distance where there is none. */
static int sbi_surface_nearest(const sb_surface *s, sb_vec3 point, int hint, sbi_surface_search *q, sb_surface_hit *hit,
                               sb_real *distance)
{
    if (hit)
        sbi_surface_miss(hit);
    q->triangle = -1;
    q->best.square = sbi_surface_infinity();
    *distance = sb_v3_is_finite(point) ? sbi_surface_infinity() : (sb_real)NAN;
    if (!s)
        return 0;
    sbi_surface_find(s, point, hint, q);
    if (q->triangle < 0)
        return 0;
    *distance = s->inverse * sb_sqrt(q->best.square);
    if (hit)
        sbi_surface_report(s, q->triangle, &q->best, hit);
    return 1;
}

/* Gives the distance its sign, also in the hit. 0 has none. */
static sb_real sbi_surface_signed(sb_real distance, int inside, sb_surface_hit *hit)
{
    if (inside && distance > 0)
        distance = -distance;
    if (hit)
        hit->distance = distance;
    return distance;
}

/* Signed distance by one of the two rules; *triangle: hint, then the one found (or -1). */
static sb_real sbi_surface_distance(const sb_surface *s, sb_vec3 point, int by_winding, int *triangle,
                                    sb_surface_hit *hit)
{
    sbi_surface_search q;
    sb_real distance;
    int inside;
    if (!sbi_surface_nearest(s, point, *triangle, &q, hit, &distance))
        return distance;
    *triangle = q.triangle;
    inside = by_winding ? -1 : sbi_surface_side(s, &q);
    if (inside < 0)
        inside = sb_surface_inside(s, point);
    return sbi_surface_signed(distance, inside, hit);
}

SB_API sb_real sb_surface_signed_distance(const sb_surface *surface, sb_vec3 point, sb_surface_hit *hit)
{
    int triangle = -1;
    return sbi_surface_distance(surface, point, 0, &triangle, hit);
}

SB_API sb_real sb_surface_signed_distance_winding(const sb_surface *surface, sb_vec3 point, sb_surface_hit *hit)
{
    int triangle = -1;
    return sbi_surface_distance(surface, point, 1, &triangle, hit);
}

/* ---- batches ------------------------------------------------------------------------------------------------- */

typedef struct sbi_surface_batch {
    const sb_surface *surface;
    const sb_vec3 *points;
    int count, by_winding;
    sb_real max_distance;
    sb_real *numbers;
    sb_surface_hit *hits;
    unsigned char *inside;
} sbi_surface_batch;

/* Points come in blocks; within one, the last triangle found is the first guess for the next point. */
static void sbi_surface_closest_task(void *user, int block)
{
    const sbi_surface_batch *batch = (const sbi_surface_batch *)user;
    int begin = block * SBI_SURFACE_BLOCK, end = begin + sbi_min_int(SBI_SURFACE_BLOCK, batch->count - begin);
    int triangle = -1;
    for (int i = begin; i < end; i++) {
        sb_surface_hit *hit = batch->hits + i;
        if (sb_surface_closest_from(batch->surface, batch->points[i], batch->max_distance, triangle, hit))
            triangle = hit->triangle;
    }
}

static void sbi_surface_distance_task(void *user, int block)
{
    const sbi_surface_batch *batch = (const sbi_surface_batch *)user;
    int begin = block * SBI_SURFACE_BLOCK, end = begin + sbi_min_int(SBI_SURFACE_BLOCK, batch->count - begin);
    int triangle = -1;
    for (int i = begin; i < end; i++)
        batch->numbers[i] = sbi_surface_distance(batch->surface, batch->points[i], batch->by_winding, &triangle,
                                                 batch->hits ? batch->hits + i : NULL);
}

static void sbi_surface_winding_task(void *user, int block)
{
    const sbi_surface_batch *batch = (const sbi_surface_batch *)user;
    int begin = block * SBI_SURFACE_BLOCK, end = begin + sbi_min_int(SBI_SURFACE_BLOCK, batch->count - begin);
    for (int i = begin; i < end; i++) {
        sb_real number = sb_surface_winding_number(batch->surface, batch->points[i]);
        if (batch->numbers)
            batch->numbers[i] = number;
        else
            batch->inside[i] = number >= (sb_real)0.5;
    }
}

static void sbi_surface_run_batch(sbi_surface_batch *batch, sb_task task, const sb_jobs *jobs)
{
    if (batch->surface && batch->points && batch->count > 0)
        sbi_run(jobs, task, batch, sbi_surface_blocks(batch->count));
}

static sbi_surface_batch sbi_surface_batch_make(const sb_surface *surface, const sb_vec3 *points, int count)
{
    sbi_surface_batch batch;
    memset(&batch, 0, sizeof batch);
    batch.surface = surface;
    batch.points = points;
    batch.count = count;
    return batch;
}

SB_API void sb_surface_closest_batch(const sb_surface *surface, const sb_vec3 *points, int count, sb_real max_distance,
                                     sb_surface_hit *hits, const sb_jobs *jobs)
{
    sbi_surface_batch batch = sbi_surface_batch_make(surface, points, count);
    batch.max_distance = max_distance;
    batch.hits = hits;
    if (hits)
        sbi_surface_run_batch(&batch, sbi_surface_closest_task, jobs);
}

static void sbi_surface_distance_batch(const sb_surface *surface, const sb_vec3 *points, int count, int by_winding,
                                       sb_real *distances, sb_surface_hit *hits, const sb_jobs *jobs)
{
    sbi_surface_batch batch = sbi_surface_batch_make(surface, points, count);
    batch.by_winding = by_winding;
    batch.numbers = distances;
    batch.hits = hits;
    if (distances)
        sbi_surface_run_batch(&batch, sbi_surface_distance_task, jobs);
}

SB_API void sb_surface_signed_distance_batch(const sb_surface *surface, const sb_vec3 *points, int count,
                                             sb_real *distances, sb_surface_hit *hits, const sb_jobs *jobs)
{
    sbi_surface_distance_batch(surface, points, count, 0, distances, hits, jobs);
}

SB_API void sb_surface_signed_distance_winding_batch(const sb_surface *surface, const sb_vec3 *points, int count,
                                                     sb_real *distances, sb_surface_hit *hits, const sb_jobs *jobs)
{
    sbi_surface_distance_batch(surface, points, count, 1, distances, hits, jobs);
}

SB_API void sb_surface_winding_number_batch(const sb_surface *surface, const sb_vec3 *points, int count,
                                            sb_real *numbers, const sb_jobs *jobs)
{
    sbi_surface_batch batch = sbi_surface_batch_make(surface, points, count);
    batch.numbers = numbers;
    if (numbers)
        sbi_surface_run_batch(&batch, sbi_surface_winding_task, jobs);
}

SB_API void sb_surface_inside_batch(const sb_surface *surface, const sb_vec3 *points, int count, unsigned char *inside,
                                    const sb_jobs *jobs)
{
    sbi_surface_batch batch = sbi_surface_batch_make(surface, points, count);
    batch.inside = inside;
    if (inside)
        sbi_surface_run_batch(&batch, sbi_surface_winding_task, jobs);
}
