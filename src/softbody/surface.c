/* surface: a tree of boxes over triangles, and what is asked of it.
 *
 * Nodes of the tree have four children; a leaf holds up to four triangles. Boxes and leaves are kept as float, four side
 * by side, so that compilers turn the loops over them into vector code. They only ever say "too far": they work in
 * local coordinates (centred, scaled by a power of two so that half the surface's size is in [1, 2)), and a slack covers
 * their rounding. What is left, a few triangles per query, is computed in sb_real from the nodes. So the answer is the
 * smallest of all triangles' own distances whatever the tree looks like, and its bits depend on nothing else.
 *
 * sb_real positions are scaled by the same power of two (which is exact): no square under- or overflows at any size. */
#include "surface.h"

#include <limits.h>
#include <string.h>

enum {
    SBI_SURFACE_WIDTH = 4,  /* children of a node, triangles of a leaf */
    SBI_SURFACE_BINS = 16,  /* places a range of triangles may be cut at, per axis */
    SBI_SURFACE_DEEP = 48,  /* cuts by cost up to this depth, then into halves */
    SBI_SURFACE_STACK = 288, /* 3 per level, and at most DEEP + 31 levels below the root */
    SBI_SURFACE_BLOCK = 256, /* points, triangles or nodes per task */
    SBI_SURFACE_OPEN = -1,  /* mate of an edge of one triangle */
    SBI_SURFACE_KNOT = -2   /* mate of an edge of several triangles, or of two that disagree on its direction */
};

/* What a triangle is good for. */
enum {
    SBI_SURFACE_SOUND = 0,
    SBI_SURFACE_THIN = 1, /* so thin that the usual formulas lose half their digits */
    SBI_SURFACE_FLAT = 2  /* a segment or a point, to rounding: it has no normal */
};

#define SBI_SURFACE_FAR 1.0e5f       /* local: beyond it boxes tell nothing apart */
#define SBI_SURFACE_NOWHERE 1.0e17f  /* local: where the empty children lie */
#define SBI_SURFACE_NO_LIMIT 1.0e30f /* between the squares of the two */
#define SBI_SURFACE_PAD 2.0e-6f      /* local: more than the rounding of boxes and of nearby points */
#define SBI_SURFACE_SLACK 4.0e-6f    /* rounding of a distance from a leaf, per unit of |point| + 1 */

/* Children that are not there lie nowhere, so no query gets to them. */
typedef struct sbi_surface_node {
    float low[3][SBI_SURFACE_WIDTH], high[3][SBI_SURFACE_WIDTH];
    int child[SBI_SURFACE_WIDTH]; /* node, or ~leaf */
    int slot;                     /* of this node in its parent: 4 parent + child */
    int unused[3];                /* two cache lines in all */
} sbi_surface_node;

/* A triangle ABC, AB its longest edge, in a frame of its own: origin A, axes along AB, to C's side, along the normal. */
enum {
    SBI_LEAF_ORIGIN = 0,
    SBI_LEAF_ALONG = 3,
    SBI_LEAF_ACROSS = 6,
    SBI_LEAF_NORMAL = 9,
    SBI_LEAF_AB = 12, /* length */
    SBI_LEAF_AC = 13, /* direction in the plane, length */
    SBI_LEAF_BC = 16, /* direction in the plane, length */
    SBI_LEAF_SIZE = 19
};
typedef struct sbi_surface_leaf {
    float f[SBI_LEAF_SIZE][SBI_SURFACE_WIDTH];
    int triangle[SBI_SURFACE_WIDTH]; /* -1: none, a copy of another */
} sbi_surface_leaf;

/* The far field of a node's children: area vectors and their first moments around the centres of area. */
enum {
    SBI_CLUSTER_CENTRE = 0,
    SBI_CLUSTER_RADIUS = 3,
    SBI_CLUSTER_AREA = 4,
    SBI_CLUSTER_DIPOLE = 5,
    SBI_CLUSTER_MOMENT = 8, /* symmetric part: xx yy zz yz xz xy */
    SBI_CLUSTER_SIZE = 14
};
typedef struct sbi_surface_cluster {
    float f[SBI_CLUSTER_SIZE][SBI_SURFACE_WIDTH];
} sbi_surface_cluster;

struct sb_surface {
    sb_allocator allocator;
    size_t bytes;
    int node_count, triangle_count, tree_count, leaf_count;
    int unbalanced; /* edges not run through as often one way as the other */
    sb_vec3 *nodes;        /* [node_count] scaled */
    int (*corners)[3];     /* [triangle_count] */
    int (*mate)[3];        /* [triangle_count] triangle across each edge, OPEN or KNOT */
    int *element;          /* [triangle_count] */
    unsigned char *shape;  /* [triangle_count] sound, thin or flat */
    unsigned char *pinched;/* [node_count] 1: parts touch in this node */
    int *fan_start;        /* [node_count + 1] */
    int *fan;              /* [3 triangle_count] 3 triangle + corner, by node */
    sb_vec3 *normal;       /* [node_count] sum of angle_i n_i / sum of angle_i; 0: means nothing */
    sbi_surface_node *tree;
    sbi_surface_cluster *cluster; /* [tree_count] */
    sbi_surface_leaf *leaf;
    int *leaf_slot;        /* [leaf_count] 4 parent + child */
    sb_vec3 low, high;     /* m */
    sb_vec3 centre;        /* scaled */
    sb_real scale, inverse;
};

/* ---- triangles -------------------------------------------------------------------------------------------------- */

static void sbi_surface_corners(const sb_surface *s, int triangle, sb_vec3 x[3])
{
    for (int i = 0; i < 3; i++)
        x[i] = s->nodes[s->corners[triangle][i]];
}

static sb_vec3 sbi_surface_area_vector(const sb_vec3 x[3])
{
    return sb_v3_cross(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0])); /* twice the area */
}

static unsigned char sbi_surface_shape_of(const sb_vec3 x[3])
{
    sb_real longest = 0, area;
    for (int i = 0; i < 3; i++) {
        sb_vec3 edge = sb_v3_sub(x[(i + 1) % 3], x[i]);
        longest = sb_max(longest, sb_v3_dot(edge, edge));
    }
    area = sb_v3_norm(sbi_surface_area_vector(x));
    if (!(area > 8 * SB_EPSILON * longest))
        return SBI_SURFACE_FLAT;
    return area * area < sb_sqrt(SB_EPSILON) * longest * longest ? SBI_SURFACE_THIN : SBI_SURFACE_SOUND;
}

/* Unit normal; 0 for a flat triangle. */
static sb_vec3 sbi_surface_unit_normal(const sb_surface *s, int triangle)
{
    sb_vec3 x[3], n;
    if (s->shape[triangle] == SBI_SURFACE_FLAT)
        return sb_v3(0, 0, 0);
    sbi_surface_corners(s, triangle, x);
    n = sbi_surface_area_vector(x);
    return sb_v3_scale((sb_real)1 / sb_v3_norm(n), n);
}

/* The point of a triangle closest to a given one: its weights for corners 1 and 2, its place, its distance squared. */
typedef struct sbi_surface_spot {
    sb_real square, v, w;
    int feature, index;
} sbi_surface_spot;

static sbi_surface_spot sbi_surface_spot_make(sb_real v, sb_real w, int feature, int index)
{
    sbi_surface_spot spot;
    spot.square = 0;
    spot.v = v;
    spot.w = w;
    spot.feature = feature;
    spot.index = index;
    return spot;
}

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

static sbi_surface_spot sbi_surface_spot_on(const sb_surface *s, int triangle, sb_vec3 point)
{
    const int *nodes = s->corners[triangle];
    sb_vec3 a = s->nodes[nodes[0]], ab = sb_v3_sub(s->nodes[nodes[1]], a), ac = sb_v3_sub(s->nodes[nodes[2]], a);
    sb_vec3 p = sb_v3_sub(point, a);
    sbi_surface_spot spot;
    if (s->shape[triangle] != SBI_SURFACE_SOUND)
        return sbi_surface_spot_thin(p, ab, ac, s->shape[triangle] == SBI_SURFACE_FLAT);
    spot = sbi_surface_spot_sound(p, ab, ac);
    if (spot.feature == SB_SURFACE_FACE && sbi_surface_spot_is_outside(&spot))
        return sbi_surface_spot_thin(p, ab, ac, 0);
    spot.square = sbi_surface_spot_square(&spot, p, ab, ac);
    return spot;
}

/* ---- refitting --------------------------------------------------------------------------------------------------- */

static void sbi_surface_to_local(const sb_surface *s, sb_vec3 x, float p[3])
{
    p[0] = (float)(x.x - s->centre.x);
    p[1] = (float)(x.y - s->centre.y);
    p[2] = (float)(x.z - s->centre.z);
}

static void sbi_surface_put(float (*f)[SBI_SURFACE_WIDTH], int lane, sb_vec3 v)
{
    f[0][lane] = (float)v.x;
    f[1][lane] = (float)v.y;
    f[2][lane] = (float)v.z;
}

/* Direction and length of the edge (x, y) in a triangle's plane. */
static void sbi_surface_put_edge(float (*f)[SBI_SURFACE_WIDTH], int lane, sb_real x, sb_real y)
{
    sb_real length = sb_sqrt(x * x + y * y);
    f[0][lane] = length > 0 ? (float)(x / length) : 1.0f;
    f[1][lane] = length > 0 ? (float)(y / length) : 0.0f;
    f[2][lane] = (float)length;
}

static int sbi_surface_longest_edge(const sb_vec3 x[3])
{
    sb_real longest = -1;
    int first = 0;
    for (int i = 0; i < 3; i++) {
        sb_vec3 edge = sb_v3_sub(x[(i + 1) % 3], x[i]);
        sb_real square = sb_v3_dot(edge, edge);
        if (square > longest)
            longest = square, first = i;
    }
    return first;
}

/* Writes a triangle (scaled corners) into a leaf. The frame is orthonormal also for flat triangles, whose height is
 * noise: a bound must hold for them too. */
static void sbi_surface_leaf_set(const sb_surface *s, sbi_surface_leaf *leaf, int lane, const sb_vec3 x[3])
{
    int first = sbi_surface_longest_edge(x);
    sb_vec3 a = x[first], ab = sb_v3_sub(x[(first + 1) % 3], a), ac = sb_v3_sub(x[(first + 2) % 3], a);
    sb_real length = sb_v3_norm(ab), along, height;
    sb_vec3 ex = length > 0 ? sb_v3_scale((sb_real)1 / length, ab) : sb_v3(1, 0, 0), ey;
    along = sb_v3_dot(ac, ex);
    ey = sb_v3_madd(ac, -along, ex);
    height = sb_v3_norm(ey);
    if (height > 8 * SB_EPSILON * length) {
        ey = sb_v3_scale((sb_real)1 / height, ey);
        ey = sb_v3_madd(ey, -sb_v3_dot(ey, ex), ex);
        ey = sb_v3_scale((sb_real)1 / sb_v3_norm(ey), ey);
    } else {
        ey = sb_v3_perpendicular(ex);
    }
    sbi_surface_put(leaf->f + SBI_LEAF_ORIGIN, lane, sb_v3_sub(a, s->centre));
    sbi_surface_put(leaf->f + SBI_LEAF_ALONG, lane, ex);
    sbi_surface_put(leaf->f + SBI_LEAF_ACROSS, lane, ey);
    sbi_surface_put(leaf->f + SBI_LEAF_NORMAL, lane, sb_v3_cross(ex, ey));
    leaf->f[SBI_LEAF_AB][lane] = (float)length;
    sbi_surface_put_edge(leaf->f + SBI_LEAF_AC, lane, along, height);
    sbi_surface_put_edge(leaf->f + SBI_LEAF_BC, lane, along - length, height);
}

/* Box of the triangle in local coordinates, widened by PAD. */
static void sbi_surface_box_of(const sb_surface *s, const sb_vec3 x[3], float low[3], float high[3])
{
    float p[3];
    for (int i = 0; i < 3; i++) {
        sbi_surface_to_local(s, x[i], p);
        for (int axis = 0; axis < 3; axis++) {
            if (i == 0 || p[axis] < low[axis])
                low[axis] = p[axis];
            if (i == 0 || p[axis] > high[axis])
                high[axis] = p[axis];
        }
    }
    for (int axis = 0; axis < 3; axis++) {
        low[axis] -= SBI_SURFACE_PAD;
        high[axis] += SBI_SURFACE_PAD;
    }
}

static void sbi_surface_box_add(float low[3], float high[3], const float other_low[3], const float other_high[3])
{
    for (int axis = 0; axis < 3; axis++) {
        low[axis] = other_low[axis] < low[axis] ? other_low[axis] : low[axis];
        high[axis] = other_high[axis] > high[axis] ? other_high[axis] : high[axis];
    }
}

/* A far field in the making, in local coordinates. */
typedef struct sbi_surface_field {
    sb_vec3 centre, dipole;
    sb_real radius, area, moment[6];
} sbi_surface_field;

/* Adds the moment of an area vector n at offset d from the centre. */
static void sbi_surface_add_moment(sb_real moment[6], sb_vec3 d, sb_vec3 n)
{
    moment[0] += d.x * n.x;
    moment[1] += d.y * n.y;
    moment[2] += d.z * n.z;
    moment[3] += (sb_real)0.5 * (d.y * n.z + d.z * n.y);
    moment[4] += (sb_real)0.5 * (d.x * n.z + d.z * n.x);
    moment[5] += (sb_real)0.5 * (d.x * n.y + d.y * n.x);
}

/* Joins far fields into one around their common centre of area; parts without area count as points for the radius. */
static void sbi_surface_field_join(const sbi_surface_field *part, int count, sbi_surface_field *field)
{
    sb_vec3 sum = sb_v3(0, 0, 0), mean = sum;
    memset(field, 0, sizeof *field);
    for (int i = 0; i < count; i++) {
        field->area += part[i].area;
        sum = sb_v3_madd(sum, part[i].area, part[i].centre);
        mean = sb_v3_madd(mean, (sb_real)1 / (sb_real)count, part[i].centre);
    }
    field->centre = field->area > 0 ? sb_v3_scale((sb_real)1 / field->area, sum) : mean;
    for (int i = 0; i < count; i++) {
        sb_vec3 d = sb_v3_sub(part[i].centre, field->centre);
        field->radius = sb_max(field->radius, sb_v3_norm(d) + part[i].radius);
        field->dipole = sb_v3_add(field->dipole, part[i].dipole);
        for (int k = 0; k < 6; k++)
            field->moment[k] += part[i].moment[k];
        sbi_surface_add_moment(field->moment, d, part[i].dipole);
    }
}

/* The far field of one triangle is that of its centre: the first moment around it is 0. */
static void sbi_surface_field_of(const sb_surface *s, int triangle, const sb_vec3 x[3], sbi_surface_field *field)
{
    memset(field, 0, sizeof *field);
    field->centre = sb_v3_scale((sb_real)1 / 3, sb_v3_add(x[0], sb_v3_add(x[1], x[2])));
    for (int i = 0; i < 3; i++)
        field->radius = sb_max(field->radius, sb_v3_norm(sb_v3_sub(x[i], field->centre)));
    field->centre = sb_v3_sub(field->centre, s->centre);
    if (s->shape[triangle] == SBI_SURFACE_FLAT)
        return;
    field->dipole = sb_v3_scale((sb_real)0.5, sbi_surface_area_vector(x));
    field->area = sb_v3_norm(field->dipole);
}

static void sbi_surface_field_store(const sbi_surface_field *field, sbi_surface_cluster *cluster, int lane)
{
    sbi_surface_put(cluster->f + SBI_CLUSTER_CENTRE, lane, field->centre);
    cluster->f[SBI_CLUSTER_RADIUS][lane] = (float)field->radius;
    cluster->f[SBI_CLUSTER_AREA][lane] = (float)field->area;
    sbi_surface_put(cluster->f + SBI_CLUSTER_DIPOLE, lane, field->dipole);
    for (int k = 0; k < 6; k++)
        cluster->f[SBI_CLUSTER_MOMENT + k][lane] = (float)field->moment[k];
}

static void sbi_surface_field_load(const sbi_surface_cluster *cluster, int lane, sbi_surface_field *field)
{
    const float(*f)[SBI_SURFACE_WIDTH] = cluster->f;
    field->centre = sb_v3((sb_real)f[0][lane], (sb_real)f[1][lane], (sb_real)f[2][lane]);
    field->radius = (sb_real)f[SBI_CLUSTER_RADIUS][lane];
    field->area = (sb_real)f[SBI_CLUSTER_AREA][lane];
    field->dipole = sb_v3((sb_real)f[SBI_CLUSTER_DIPOLE][lane], (sb_real)f[SBI_CLUSTER_DIPOLE + 1][lane],
                          (sb_real)f[SBI_CLUSTER_DIPOLE + 2][lane]);
    for (int k = 0; k < 6; k++)
        field->moment[k] = (sb_real)f[SBI_CLUSTER_MOMENT + k][lane];
}

static void sbi_surface_set_child_box(sbi_surface_node *node, int lane, const float low[3], const float high[3])
{
    for (int axis = 0; axis < 3; axis++) {
        node->low[axis][lane] = low[axis];
        node->high[axis][lane] = high[axis];
    }
}

/* Recomputes a leaf from the nodes, and its box and far field in its parent. */
static void sbi_surface_refit_leaf(sb_surface *s, int index)
{
    sbi_surface_leaf *leaf = s->leaf + index;
    sbi_surface_field part[SBI_SURFACE_WIDTH], field;
    float low[3], high[3], box_low[3], box_high[3];
    int parent = s->leaf_slot[index] / SBI_SURFACE_WIDTH, lane = s->leaf_slot[index] % SBI_SURFACE_WIDTH, count = 0;
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++) {
        int triangle = leaf->triangle[k];
        sb_vec3 x[3];
        sbi_surface_corners(s, triangle < 0 ? leaf->triangle[0] : triangle, x);
        sbi_surface_leaf_set(s, leaf, k, x);
        if (triangle < 0)
            continue;
        s->shape[triangle] = sbi_surface_shape_of(x);
        sbi_surface_box_of(s, x, low, high);
        if (count == 0)
            memcpy(box_low, low, sizeof low), memcpy(box_high, high, sizeof high);
        sbi_surface_box_add(box_low, box_high, low, high);
        sbi_surface_field_of(s, triangle, x, part + count++);
    }
    sbi_surface_set_child_box(s->tree + parent, lane, box_low, box_high);
    sbi_surface_field_join(part, count, &field);
    sbi_surface_field_store(&field, s->cluster + parent, lane);
}

static int sbi_surface_child_count(const sbi_surface_node *node)
{
    int count = 0;
    while (count < SBI_SURFACE_WIDTH && node->low[0][count] < SBI_SURFACE_FAR)
        count++;
    return count;
}

/* Passes the boxes and far fields of a node's children on to its own parent. */
static void sbi_surface_refit_node(sb_surface *s, int index)
{
    const sbi_surface_node *node = s->tree + index;
    sbi_surface_field part[SBI_SURFACE_WIDTH], field;
    float low[3], high[3];
    int parent = node->slot / SBI_SURFACE_WIDTH, lane = node->slot % SBI_SURFACE_WIDTH;
    int count = sbi_surface_child_count(node);
    for (int axis = 0; axis < 3; axis++) {
        low[axis] = node->low[axis][0];
        high[axis] = node->high[axis][0];
        for (int k = 1; k < count; k++) {
            low[axis] = node->low[axis][k] < low[axis] ? node->low[axis][k] : low[axis];
            high[axis] = node->high[axis][k] > high[axis] ? node->high[axis][k] : high[axis];
        }
    }
    for (int k = 0; k < count; k++)
        sbi_surface_field_load(s->cluster + index, k, part + k);
    sbi_surface_set_child_box(s->tree + parent, lane, low, high);
    sbi_surface_field_join(part, count, &field);
    sbi_surface_field_store(&field, s->cluster + parent, lane);
}

/* Angle-weighted normal of a node (Baerentzen, Aanaes 2005), over the sum of the angles, so that its length says how
 * much the faces agree. 0 where it means nothing: flat triangles, knots and pinched nodes. */
static void sbi_surface_refit_normal(sb_surface *s, int node)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    sb_real angles = 0;
    int sound = !s->pinched[node];
    for (int i = s->fan_start[node]; sound && i < s->fan_start[node + 1]; i++) {
        int triangle = s->fan[i] / 3, corner = s->fan[i] % 3;
        const int *nodes = s->corners[triangle];
        sb_vec3 x = s->nodes[node], n;
        sb_vec3 a = sb_v3_sub(s->nodes[nodes[(corner + 1) % 3]], x), b = sb_v3_sub(s->nodes[nodes[(corner + 2) % 3]], x);
        sb_real area, angle;
        n = sb_v3_cross(a, b);
        area = sb_v3_norm(n);
        sound = s->shape[triangle] != SBI_SURFACE_FLAT && area > 0;
        if (sound) {
            angle = sb_atan2(area, sb_v3_dot(a, b));
            sum = sb_v3_madd(sum, angle / area, n);
            angles += angle;
        }
    }
    s->normal[node] = sound && angles > 0 ? sb_v3_scale((sb_real)1 / angles, sum) : sb_v3(0, 0, 0);
}

static void sbi_surface_leaf_task(void *user, int block)
{
    sb_surface *s = (sb_surface *)user;
    int begin = block * SBI_SURFACE_BLOCK, end = sbi_min_int(begin + SBI_SURFACE_BLOCK, s->leaf_count);
    for (int i = begin; i < end; i++)
        sbi_surface_refit_leaf(s, i);
}

static void sbi_surface_normal_task(void *user, int block)
{
    sb_surface *s = (sb_surface *)user;
    int begin = block * SBI_SURFACE_BLOCK, end = sbi_min_int(begin + SBI_SURFACE_BLOCK, s->node_count);
    for (int i = begin; i < end; i++)
        sbi_surface_refit_normal(s, i);
}

static int sbi_surface_blocks(int count) { return (count - 1) / SBI_SURFACE_BLOCK + 1; }

/* Box around the nodes that triangles use. */
static void sbi_surface_measure(const sb_surface *s, const sb_vec3 *nodes, sb_vec3 *low, sb_vec3 *high)
{
    *low = *high = nodes[s->corners[0][0]];
    for (int v = 0; v < s->node_count; v++) {
        if (s->fan_start[v] == s->fan_start[v + 1])
            continue;
        *low = sb_v3(sb_min(low->x, nodes[v].x), sb_min(low->y, nodes[v].y), sb_min(low->z, nodes[v].z));
        *high = sb_v3(sb_max(high->x, nodes[v].x), sb_max(high->y, nodes[v].y), sb_max(high->z, nodes[v].z));
    }
}

/* The scale brings half the longest side into [1, 2); never so large that coordinates far from the origin overflow. */
static void sbi_surface_set_frame(sb_surface *s, sb_vec3 low, sb_vec3 high)
{
    sb_real side[3], corner[6], size, coordinate;
    side[0] = high.x - low.x, side[1] = high.y - low.y, side[2] = high.z - low.z;
    corner[0] = low.x, corner[1] = low.y, corner[2] = low.z;
    corner[3] = high.x, corner[4] = high.y, corner[5] = high.z;
    size = (sb_real)0.5 * sbi_dense_max_abs(side, 3);
    coordinate = sbi_dense_max_abs(corner, 6);
    size = sb_max(size, SB_EPSILON * coordinate);
    s->scale = s->inverse = 1;
    if (size > 0)
        sbi_dense_scale(size, &s->scale, &s->inverse);
    s->low = low;
    s->high = high;
    low = sb_v3_scale(s->scale, low);
    high = sb_v3_scale(s->scale, high);
    s->centre = sb_v3_madd(low, (sb_real)0.5, sb_v3_sub(high, low));
}

static sb_result sbi_surface_check_extent(const sb_surface *s, const sb_vec3 *nodes, sb_error *error)
{
    sb_vec3 low, high;
    for (int v = 0; v < s->node_count; v++)
        if (!sb_v3_is_finite(nodes[v]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, v, "node %d has a coordinate that is not finite", v);
    sbi_surface_measure(s, nodes, &low, &high);
    if (!sb_v3_is_finite(sb_v3_sub(high, low)))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the surface is too large: its size is not finite");
    return SB_OK;
}

/* Takes over checked node positions. */
static void sbi_surface_refit(sb_surface *s, const sb_vec3 *nodes, const sb_jobs *jobs)
{
    sb_vec3 low, high;
    sbi_surface_measure(s, nodes, &low, &high);
    sbi_surface_set_frame(s, low, high);
    for (int v = 0; v < s->node_count; v++)
        s->nodes[v] = sb_v3_scale(s->scale, nodes[v]);
    sbi_run(jobs, sbi_surface_leaf_task, s, sbi_surface_blocks(s->leaf_count));
    for (int i = s->tree_count - 1; i > 0; i--) /* children come after their parents */
        sbi_surface_refit_node(s, i);
    sbi_run(jobs, sbi_surface_normal_task, s, sbi_surface_blocks(s->node_count));
}

SB_API sb_result sb_surface_move(sb_surface *surface, const sb_vec3 *nodes, const sb_jobs *jobs, sb_error *error)
{
    sb_result result;
    if (!surface || !nodes)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", surface ? "nodes" : "surface");
    result = sbi_surface_check_extent(surface, nodes, error);
    if (result == SB_OK)
        sbi_surface_refit(surface, nodes, jobs);
    return result;
}

/* ---- the shape of the tree ------------------------------------------------------------------------------------- */

/* Scratch of building: triangles in an order that puts those of a leaf side by side. */
typedef struct sbi_surface_build {
    int count;
    float (*box)[6];  /* [count] low and high, in any units */
    int *order;       /* [count] */
    int (*child)[SBI_SURFACE_WIDTH]; /* [count] nodes: child node, ~leaf or INT_MAX: none */
    int *slot;        /* [count] of each node in its parent */
    int (*leaf)[2];   /* [count] places in the order: from, to */
    int tree_count, leaf_count;
} sbi_surface_build;

typedef struct sbi_surface_bins {
    float low[SBI_SURFACE_BINS][3], high[SBI_SURFACE_BINS][3];
    int count[SBI_SURFACE_BINS];
} sbi_surface_bins;

static float sbi_surface_half_area(const float low[3], const float high[3])
{
    float x = high[0] - low[0], y = high[1] - low[1], z = high[2] - low[2];
    return x * y + y * z + z * x;
}

/* Twice the centre of a triangle's box along an axis. */
static float sbi_surface_middle(const sbi_surface_build *b, int triangle, int axis)
{
    return b->box[triangle][axis] + b->box[triangle][axis + 3];
}

/* Box of the middles of a range. */
static void sbi_surface_middles(const sbi_surface_build *b, int begin, int end, float low[3], float high[3])
{
    for (int i = begin; i < end; i++) {
        for (int axis = 0; axis < 3; axis++) {
            float m = sbi_surface_middle(b, b->order[i], axis);
            if (i == begin || m < low[axis])
                low[axis] = m;
            if (i == begin || m > high[axis])
                high[axis] = m;
        }
    }
}

static int sbi_surface_bin(float middle, float low, float per_unit)
{
    return sbi_min_int((int)((middle - low) * per_unit), SBI_SURFACE_BINS - 1);
}

static void sbi_surface_fill_bins(const sbi_surface_build *b, int begin, int end, int axis, float low, float per_unit,
                                  sbi_surface_bins *bins)
{
    for (int k = 0; k < SBI_SURFACE_BINS; k++) {
        bins->count[k] = 0;
        for (int i = 0; i < 3; i++) {
            bins->low[k][i] = SBI_SURFACE_NOWHERE;
            bins->high[k][i] = -SBI_SURFACE_NOWHERE;
        }
    }
    for (int i = begin; i < end; i++) {
        const float *box = b->box[b->order[i]];
        int k = sbi_surface_bin(box[axis] + box[axis + 3], low, per_unit);
        bins->count[k]++;
        sbi_surface_box_add(bins->low[k], bins->high[k], box, box + 3);
    }
}

/* Leaves that `count` triangles need. */
static float sbi_surface_leaves(int count) { return (float)((count + SBI_SURFACE_WIDTH - 1) / SBI_SURFACE_WIDTH); }

/* Surface area heuristic over the cuts after each bin: returns the cost of the best one and its bin, or a negative
 * number when the bins cannot be cut. */
static float sbi_surface_best_cut(const sbi_surface_bins *bins, int count, int *cut)
{
    float right[SBI_SURFACE_BINS], low[3], high[3], best = -1.0f;
    int left = 0;
    memcpy(low, bins->low[SBI_SURFACE_BINS - 1], sizeof low);
    memcpy(high, bins->high[SBI_SURFACE_BINS - 1], sizeof high);
    for (int k = SBI_SURFACE_BINS - 1; k > 0; k--) {
        sbi_surface_box_add(low, high, bins->low[k], bins->high[k]);
        right[k] = sbi_surface_half_area(low, high);
    }
    memcpy(low, bins->low[0], sizeof low);
    memcpy(high, bins->high[0], sizeof high);
    for (int k = 0; k + 1 < SBI_SURFACE_BINS; k++) {
        float cost;
        left += bins->count[k];
        sbi_surface_box_add(low, high, bins->low[k], bins->high[k]);
        if (left == 0 || left == count)
            continue;
        cost = sbi_surface_half_area(low, high) * sbi_surface_leaves(left) +
               right[k + 1] * sbi_surface_leaves(count - left);
        if (best < 0 || cost < best)
            best = cost, *cut = k;
    }
    return best;
}

/* Brings the triangles of bins up to `cut` to the front of the range; returns where the others begin. */
static int sbi_surface_partition(sbi_surface_build *b, int begin, int end, int axis, float low, float per_unit, int cut)
{
    int front = begin, back = end;
    while (front < back) {
        int triangle = b->order[front];
        if (sbi_surface_bin(sbi_surface_middle(b, triangle, axis), low, per_unit) <= cut) {
            front++;
        } else {
            b->order[front] = b->order[--back];
            b->order[back] = triangle;
        }
    }
    return front;
}

/* Cuts a range of two triangles or more in two; returns where the second begins. */
static int sbi_surface_split(sbi_surface_build *b, int begin, int end, int depth)
{
    float low[3], high[3], best = -1.0f, best_per_unit = 0.0f;
    int best_axis = 0, best_cut = 0;
    sbi_surface_bins bins;
    if (depth > SBI_SURFACE_DEEP)
        return begin + (end - begin) / 2;
    sbi_surface_middles(b, begin, end, low, high);
    for (int axis = 0; axis < 3; axis++) {
        float size = high[axis] - low[axis], per_unit, cost;
        int cut = 0;
        per_unit = (float)SBI_SURFACE_BINS / size;
        if (!(size > 0) || !(per_unit < SBI_SURFACE_NO_LIMIT))
            continue;
        sbi_surface_fill_bins(b, begin, end, axis, low[axis], per_unit, &bins);
        cost = sbi_surface_best_cut(&bins, end - begin, &cut);
        if (cost >= 0 && (best < 0 || cost < best))
            best = cost, best_axis = axis, best_cut = cut, best_per_unit = per_unit;
    }
    if (best < 0)
        return begin + (end - begin) / 2;
    return sbi_surface_partition(b, begin, end, best_axis, low[best_axis], best_per_unit, best_cut);
}

/* A range of triangles that becomes a node. */
typedef struct sbi_surface_range {
    int begin, end, slot, depth;
} sbi_surface_range;

/* Cuts the range into up to four, always the longest one; returns how many. bound: [5] their ends. */
static int sbi_surface_cut_in_four(sbi_surface_build *b, const sbi_surface_range *range, int bound[5])
{
    int count = 1;
    bound[0] = range->begin;
    bound[1] = range->end;
    while (count < SBI_SURFACE_WIDTH) {
        int longest = 0, middle;
        for (int k = 1; k < count; k++)
            if (bound[k + 1] - bound[k] > bound[longest + 1] - bound[longest])
                longest = k;
        if (bound[longest + 1] - bound[longest] <= SBI_SURFACE_WIDTH)
            break;
        middle = sbi_surface_split(b, bound[longest], bound[longest + 1], range->depth);
        for (int k = count; k > longest; k--)
            bound[k + 1] = bound[k];
        bound[longest + 1] = middle;
        count++;
    }
    return count;
}

/* Fills child, slot and leaf, parents before their children. */
static void sbi_surface_build_tree(sbi_surface_build *b)
{
    sbi_surface_range stack[SBI_SURFACE_STACK], range;
    int top = 0, bound[5];
    range.begin = 0, range.end = b->count, range.slot = 0, range.depth = 0;
    stack[top++] = range;
    while (top > 0) {
        int node = b->tree_count++, count;
        range = stack[--top];
        if (node > 0)
            b->child[range.slot / SBI_SURFACE_WIDTH][range.slot % SBI_SURFACE_WIDTH] = node;
        b->slot[node] = range.slot;
        count = sbi_surface_cut_in_four(b, &range, bound);
        for (int k = SBI_SURFACE_WIDTH - 1; k >= 0; k--) {
            b->child[node][k] = INT_MAX;
            if (k < count && bound[k + 1] - bound[k] <= SBI_SURFACE_WIDTH) {
                b->child[node][k] = ~b->leaf_count;
                b->leaf[b->leaf_count][0] = bound[k];
                b->leaf[b->leaf_count++][1] = bound[k + 1];
            } else if (k < count) {
                stack[top].begin = bound[k];
                stack[top].end = bound[k + 1];
                stack[top].slot = node * SBI_SURFACE_WIDTH + k;
                stack[top++].depth = range.depth + 1;
            }
        }
    }
}

static void sbi_surface_build_free(const sb_allocator *allocator, sbi_surface_build *b)
{
    sbi_free(allocator, b->box);
    sbi_free(allocator, b->order);
    sbi_free(allocator, b->child);
    sbi_free(allocator, b->slot);
    sbi_free(allocator, b->leaf);
}

static int sbi_surface_build_allocate(const sb_allocator *allocator, int count, sbi_surface_build *b)
{
    size_t n = (size_t)count;
    memset(b, 0, sizeof *b);
    b->count = count;
    b->box = (float(*)[6])sbi_alloc(allocator, n, sizeof *b->box);
    b->order = (int *)sbi_alloc(allocator, n, sizeof(int));
    b->child = (int(*)[SBI_SURFACE_WIDTH])sbi_alloc(allocator, n, sizeof *b->child);
    b->slot = (int *)sbi_alloc(allocator, n, sizeof(int));
    b->leaf = (int(*)[2])sbi_alloc(allocator, n, sizeof *b->leaf);
    return b->box && b->order && b->child && b->slot && b->leaf;
}

/* Boxes in units of about the surface's size, which float can hold. */
static void sbi_surface_build_boxes(const sb_mesh *triangles, sbi_surface_build *b)
{
    sb_vec3 low = triangles->nodes[triangles->elements[0]], high = low;
    sb_real side[3], scale = 1, inverse = 1, size;
    for (size_t i = 0; i < 3 * (size_t)b->count; i++) {
        sb_vec3 x = triangles->nodes[triangles->elements[i]];
        low = sb_v3(sb_min(low.x, x.x), sb_min(low.y, x.y), sb_min(low.z, x.z));
        high = sb_v3(sb_max(high.x, x.x), sb_max(high.y, x.y), sb_max(high.z, x.z));
    }
    side[0] = high.x - low.x, side[1] = high.y - low.y, side[2] = high.z - low.z;
    size = sbi_dense_max_abs(side, 3);
    if (size > 0)
        sbi_dense_scale(size, &scale, &inverse);
    for (int t = 0; t < b->count; t++) {
        const int *nodes = triangles->elements + 3 * (size_t)t;
        float *box = b->box[t];
        for (int i = 0; i < 3; i++) {
            sb_vec3 x = sb_v3_scale(scale, sb_v3_sub(triangles->nodes[nodes[i]], low));
            float p[3];
            p[0] = (float)x.x, p[1] = (float)x.y, p[2] = (float)x.z;
            for (int axis = 0; axis < 3; axis++) {
                box[axis] = i == 0 || p[axis] < box[axis] ? p[axis] : box[axis];
                box[axis + 3] = i == 0 || p[axis] > box[axis + 3] ? p[axis] : box[axis + 3];
            }
        }
        b->order[t] = t;
    }
}

/* ---- creation ---------------------------------------------------------------------------------------------------- */

/* Sizes and, with arena->base, places of all arrays; leaves and tree counts are known. */
static sb_surface *sbi_surface_layout(const sb_surface *size, sbi_arena *arena)
{
    size_t nodes = (size_t)size->node_count, triangles = (size_t)size->triangle_count;
    size_t tree = (size_t)size->tree_count, leaves = (size_t)size->leaf_count;
    sb_surface made = *size, *s = (sb_surface *)sbi_arena_take(arena, 1, sizeof *s);
    made.tree = (sbi_surface_node *)sbi_arena_take(arena, tree, sizeof *made.tree);
    made.cluster = (sbi_surface_cluster *)sbi_arena_take(arena, tree, sizeof *made.cluster);
    made.leaf = (sbi_surface_leaf *)sbi_arena_take(arena, leaves, sizeof *made.leaf);
    made.leaf_slot = (int *)sbi_arena_take(arena, leaves, sizeof(int));
    made.nodes = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    made.normal = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    made.pinched = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    made.fan_start = (int *)sbi_arena_take(arena, nodes + 1, sizeof(int));
    made.fan = (int *)sbi_arena_take(arena, triangles, 3 * sizeof(int));
    made.corners = (int(*)[3])sbi_arena_take(arena, triangles, sizeof *made.corners);
    made.mate = (int(*)[3])sbi_arena_take(arena, triangles, sizeof *made.mate);
    made.element = (int *)sbi_arena_take(arena, triangles, sizeof(int));
    made.shape = (unsigned char *)sbi_arena_take(arena, triangles, 1);
    if (s)
        *s = made;
    return s;
}

/* Tree, leaves and clusters as they were built; the refit fills in the numbers. */
static void sbi_surface_adopt_tree(sb_surface *s, const sbi_surface_build *b)
{
    memset(s->cluster, 0, sizeof *s->cluster * (size_t)s->tree_count);
    for (int i = 0; i < s->tree_count; i++) {
        sbi_surface_node *node = s->tree + i;
        memset(node, 0, sizeof *node);
        node->slot = b->slot[i];
        for (int k = 0; k < SBI_SURFACE_WIDTH; k++) {
            int child = b->child[i][k];
            node->child[k] = child == INT_MAX ? 0 : child;
            for (int axis = 0; axis < 3; axis++) {
                node->low[axis][k] = child == INT_MAX ? SBI_SURFACE_NOWHERE : 0.0f;
                node->high[axis][k] = child == INT_MAX ? SBI_SURFACE_NOWHERE : 0.0f;
            }
            if (child < 0)
                s->leaf_slot[~child] = i * SBI_SURFACE_WIDTH + k;
        }
    }
    for (int i = 0; i < s->leaf_count; i++) {
        int begin = b->leaf[i][0], count = b->leaf[i][1] - begin;
        for (int k = 0; k < SBI_SURFACE_WIDTH; k++)
            s->leaf[i].triangle[k] = k < count ? b->order[begin + k] : -1;
    }
}

static int sbi_surface_ascends(const int nodes[3], int edge) { return nodes[edge] < nodes[(edge + 1) % 3]; }

/* Neighbours across edges, and how many edges are out of balance. `edges`: those of triangles with three different
 * nodes; the others have knots all round. */
static void sbi_surface_find_mates(sb_surface *s, const sbi_mesh_keys *edges)
{
    for (int t = 0; t < s->triangle_count; t++)
        for (int i = 0; i < 3; i++)
            s->mate[t][i] = SBI_SURFACE_KNOT;
    s->unbalanced = 0;
    for (int begin = 0, end; begin < edges->sorted; begin = end) {
        int p = edges->order[begin], q, up, balance = 0;
        end = sbi_mesh_run_end(edges, begin);
        for (int i = begin; i < end; i++) {
            up = sbi_surface_ascends(s->corners[edges->order[i] / 3], edges->order[i] % 3);
            balance += up ? 1 : -1;
        }
        s->unbalanced += balance != 0;
        q = edges->order[end - 1];
        if (end == begin + 1)
            s->mate[p / 3][p % 3] = SBI_SURFACE_OPEN;
        if (end == begin + 2 && balance == 0)
            s->mate[p / 3][p % 3] = q / 3, s->mate[q / 3][q % 3] = p / 3;
    }
}

/* Corners of each node. */
static void sbi_surface_find_fans(sb_surface *s)
{
    int total = 3 * s->triangle_count;
    memset(s->fan_start, 0, sizeof(int) * ((size_t)s->node_count + 1));
    for (int i = 0; i < total; i++)
        s->fan_start[s->corners[i / 3][i % 3] + 1]++;
    for (int v = 0; v < s->node_count; v++)
        s->fan_start[v + 1] += s->fan_start[v];
    for (int i = 0; i < total; i++)
        s->fan[s->fan_start[s->corners[i / 3][i % 3]]++] = i;
    memmove(s->fan_start + 1, s->fan_start, sizeof(int) * (size_t)s->node_count); /* filling moved each to its end */
    s->fan_start[0] = 0;
}

/* Corner of triangle `to` that is the same node as `node`. */
static int sbi_surface_corner_at(const sb_surface *s, int to, int node)
{
    return s->corners[to][0] == node ? 0 : s->corners[to][1] == node ? 1 : 2;
}

/* Triangles that can be reached from corner c of triangle t by turning round its node, itself included; at most
 * `limit`. */
static int sbi_surface_turn(const sb_surface *s, int t, int c, int limit)
{
    int node = s->corners[t][c], count = 1;
    for (int way = 0; way < 2; way++) {
        int now = t, corner = c;
        while (count < limit) {
            int next = s->mate[now][way == 0 ? corner : (corner + 2) % 3];
            if (next < 0 || next == t)
                break;
            now = next, corner = sbi_surface_corner_at(s, now, node);
            count++;
        }
        if (count < limit && s->mate[now][way == 0 ? corner : (corner + 2) % 3] == t && now != t)
            break; /* once round */
    }
    return count;
}

/* A node is pinched when its triangles are not one fan, or an edge there is a knot. */
static void sbi_surface_find_pinched(sb_surface *s)
{
    for (int v = 0; v < s->node_count; v++) {
        int begin = s->fan_start[v], count = s->fan_start[v + 1] - begin;
        s->pinched[v] = 0;
        for (int i = begin; i < begin + count && !s->pinched[v]; i++) {
            const int *mate = s->mate[s->fan[i] / 3];
            s->pinched[v] = mate[s->fan[i] % 3] == SBI_SURFACE_KNOT || mate[(s->fan[i] % 3 + 2) % 3] == SBI_SURFACE_KNOT;
        }
        if (count > 0 && !s->pinched[v])
            s->pinched[v] = sbi_surface_turn(s, s->fan[begin] / 3, s->fan[begin] % 3, count) < count;
    }
}

/* Triangles and their elements. `triangles` only lends its pointers: nothing in it is to be released. */
typedef struct sbi_surface_cut {
    sb_mesh triangles;
    int *corners; /* [count][3] */
    int *element; /* [count] */
} sbi_surface_cut;

/* Cuts the faces of a checked mesh; 0 when memory is short. */
static int sbi_surface_cut_faces(const sb_mesh *mesh, const sb_allocator *allocator, int per, sbi_surface_cut *cut)
{
    const signed char(*local)[3] = NULL;
    int count = mesh->element_count * per;
    cut->corners = (int *)sbi_alloc(allocator, (size_t)count, 3 * sizeof(int));
    cut->element = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    if (!cut->corners || !cut->element)
        return 0;
    sbi_mesh_face_triangles(mesh->element_type, &local);
    for (int t = 0; t < count; t++) {
        const int *nodes = mesh->elements + (size_t)(t / per) * (size_t)sb_mesh_element_width(mesh);
        cut->element[t] = t / per;
        for (int i = 0; i < 3; i++)
            cut->corners[3 * (size_t)t + (size_t)i] = nodes[local[t % per][i]];
    }
    memset(&cut->triangles, 0, sizeof cut->triangles);
    cut->triangles.node_count = mesh->node_count;
    cut->triangles.nodes = mesh->nodes;
    cut->triangles.element_type = SB_TRI3;
    cut->triangles.element_count = count;
    cut->triangles.elements = cut->corners;
    return 1;
}

static int sbi_surface_repeats(const int *nodes)
{
    return nodes[0] == nodes[1] || nodes[1] == nodes[2] || nodes[2] == nodes[0];
}

/* The surface of what is known by now; NULL when memory is short. */
static sb_surface *sbi_surface_make(const sbi_surface_cut *cut, const sbi_surface_build *b, const sbi_mesh_keys *edges,
                                    const sb_allocator *allocator)
{
    sb_surface size, *s;
    sbi_arena arena;
    memset(&size, 0, sizeof size);
    if (allocator)
        size.allocator = *allocator;
    size.node_count = cut->triangles.node_count;
    size.triangle_count = cut->triangles.element_count;
    size.tree_count = b->tree_count;
    size.leaf_count = b->leaf_count;
    memset(&arena, 0, sizeof arena);
    sbi_surface_layout(&size, &arena);
    size.bytes = arena.used;
    arena.base = arena.overflow ? NULL : (unsigned char *)sbi_alloc(allocator, arena.used, 1);
    arena.used = 0;
    if (!arena.base)
        return NULL;
    s = sbi_surface_layout(&size, &arena);
    memcpy(s->corners, cut->corners, sizeof *s->corners * (size_t)s->triangle_count);
    memcpy(s->element, cut->element, sizeof(int) * (size_t)s->triangle_count);
    sbi_surface_find_mates(s, edges);
    sbi_surface_find_fans(s);
    sbi_surface_find_pinched(s);
    sbi_surface_adopt_tree(s, b);
    return s;
}

/* Builds from faces already cut; NULL when memory is short. */
static sb_surface *sbi_surface_from_cut(const sbi_surface_cut *cut, const sb_allocator *allocator)
{
    int count = cut->triangles.element_count;
    unsigned char *skip = (unsigned char *)sbi_alloc(allocator, (size_t)count, 1);
    sb_surface *s = NULL;
    sbi_surface_build build;
    sbi_mesh_keys edges;
    memset(&edges, 0, sizeof edges);
    for (int t = 0; skip && t < count; t++)
        skip[t] = (unsigned char)sbi_surface_repeats(cut->corners + 3 * (size_t)t);
    if (sbi_surface_build_allocate(allocator, count, &build) && skip &&
        sbi_mesh_keys_make(&cut->triangles, SBI_MESH_SIDES, skip, allocator, &edges)) {
        sbi_surface_build_boxes(&cut->triangles, &build);
        sbi_surface_build_tree(&build);
        s = sbi_surface_make(cut, &build, &edges, allocator);
    }
    sbi_surface_build_free(allocator, &build);
    sbi_mesh_keys_free(allocator, &edges);
    sbi_free(allocator, skip);
    return s;
}

static sb_result sbi_surface_check_mesh(const sb_mesh *mesh, int *per, sb_error *error)
{
    const signed char(*local)[3] = NULL;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (sb_element_dimension(mesh->element_type) != 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a mesh of %s is not a surface; take its boundary",
                        sb_element_name(mesh->element_type));
    *per = sbi_mesh_face_triangles(mesh->element_type, &local);
    if (mesh->element_count > INT_MAX / 3 / *per)
        return sbi_fail(error, SB_ERROR_MESH, "the surface has too many triangles: %d faces", mesh->element_count);
    return SB_OK;
}

SB_API sb_result sb_surface_create(const sb_mesh *mesh, const sb_allocator *allocator, sb_surface **surface,
                                   sb_error *error)
{
    sbi_surface_cut cut;
    sb_surface *made = NULL;
    int per = 0;
    sb_result result;
    if (!surface)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "surface is NULL");
    result = sbi_surface_check_mesh(mesh, &per, error);
    if (result != SB_OK)
        return result;
    memset(&cut, 0, sizeof cut);
    if (sbi_surface_cut_faces(mesh, allocator, per, &cut))
        made = sbi_surface_from_cut(&cut, allocator);
    sbi_free(allocator, cut.corners);
    sbi_free(allocator, cut.element);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a surface of %d faces", mesh->element_count);
    result = sbi_surface_check_extent(made, mesh->nodes, error);
    if (result != SB_OK) {
        sb_surface_destroy(made);
        return result;
    }
    sbi_surface_refit(made, mesh->nodes, NULL);
    *surface = made;
    return SB_OK;
}

SB_API void sb_surface_destroy(sb_surface *surface)
{
    sb_allocator allocator;
    if (!surface)
        return;
    allocator = surface->allocator;
    sbi_free(&allocator, surface);
}

/* ---- what it is made of ----------------------------------------------------------------------------------------- */

SB_API int sb_surface_node_count(const sb_surface *surface) { return surface ? surface->node_count : 0; }
SB_API int sb_surface_triangle_count(const sb_surface *surface) { return surface ? surface->triangle_count : 0; }
SB_API int sb_surface_is_closed(const sb_surface *surface) { return surface && surface->unbalanced == 0; }
SB_API size_t sb_surface_bytes(const sb_surface *surface) { return surface ? surface->bytes : 0; }

SB_API int sb_surface_triangle(const sb_surface *surface, int triangle, int nodes[3])
{
    if (!surface || triangle < 0 || triangle >= surface->triangle_count)
        return -1;
    if (nodes)
        memcpy(nodes, surface->corners[triangle], 3 * sizeof(int));
    return surface->element[triangle];
}

SB_API void sb_surface_bounds(const sb_surface *surface, sb_vec3 *low, sb_vec3 *high)
{
    if (low)
        *low = surface ? surface->low : sb_v3(0, 0, 0);
    if (high)
        *high = surface ? surface->high : sb_v3(0, 0, 0);
}

/* ---- closest point ----------------------------------------------------------------------------------------------- */

/* The state of a search: everything scaled. */
typedef struct sbi_surface_search {
    sb_vec3 point;
    float p[3];     /* local */
    sb_real slack;  /* how much a leaf's or box's distance may be too large */
    float limit;    /* square of best distance and slack: what is above cannot win */
    int triangle;   /* best so far, or -1 */
    sbi_surface_spot best;
} sbi_surface_search;

static void sbi_surface_set_limit(sbi_surface_search *q)
{
    sb_real reach = sb_sqrt(q->best.square) + q->slack;
    sb_real limit = reach * reach * (sb_real)1.00001;
    q->limit = limit < (sb_real)SBI_SURFACE_NO_LIMIT ? (float)limit : SBI_SURFACE_NO_LIMIT;
}

/* Computes the triangle and keeps it when it is nearer, or as near with a lower number. */
static void sbi_surface_try(const sb_surface *s, sbi_surface_search *q, int triangle)
{
    sbi_surface_spot spot = sbi_surface_spot_on(s, triangle, q->point);
    if (spot.square > q->best.square || !(spot.square >= 0) ||
        (spot.square == q->best.square && q->triangle >= 0 && q->triangle <= triangle))
        return;
    q->best = spot;
    q->triangle = triangle;
    sbi_surface_set_limit(q);
}

/* Squares of the distances to the four boxes of a node. */
static void sbi_surface_box_squares(const sbi_surface_node *node, const float p[3], float square[SBI_SURFACE_WIDTH])
{
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++) {
        float x0 = node->low[0][k] - p[0], x1 = p[0] - node->high[0][k], x = x0 > x1 ? x0 : x1;
        float y0 = node->low[1][k] - p[1], y1 = p[1] - node->high[1][k], y = y0 > y1 ? y0 : y1;
        float z0 = node->low[2][k] - p[2], z1 = p[2] - node->high[2][k], z = z0 > z1 ? z0 : z1;
        x = x > 0.0f ? x : 0.0f;
        y = y > 0.0f ? y : 0.0f;
        z = z > 0.0f ? z : 0.0f;
        square[k] = x * x + y * y + z * z;
    }
}

SBI_FORCE_INLINE float sbi_surface_clamp(float x, float high)
{
    float positive = x > 0.0f ? x : 0.0f;
    return positive < high ? positive : high;
}

/* Squares of the distances to the four triangles of a leaf: in each one's plane the point is inside, where only the
 * height counts, or nearest to one of the edges. */
static void sbi_surface_leaf_squares(const sbi_surface_leaf *leaf, const float p[3], float square[SBI_SURFACE_WIDTH])
{
    const float(*f)[SBI_SURFACE_WIDTH] = leaf->f;
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++) {
        float dx = p[0] - f[0][k], dy = p[1] - f[1][k], dz = p[2] - f[2][k];
        float x = dx * f[3][k] + dy * f[4][k] + dz * f[5][k];
        float y = dx * f[6][k] + dy * f[7][k] + dz * f[8][k];
        float z = dx * f[9][k] + dy * f[10][k] + dz * f[11][k];
        float length = f[SBI_LEAF_AB][k], u = x - length;
        float ac_along = f[13][k] * x + f[14][k] * y, ac_across = f[13][k] * y - f[14][k] * x;
        float bc_along = f[16][k] * u + f[17][k] * y, bc_across = f[16][k] * y - f[17][k] * u;
        float ab_off = x - sbi_surface_clamp(x, length);
        float ac_off = ac_along - sbi_surface_clamp(ac_along, f[15][k]);
        float bc_off = bc_along - sbi_surface_clamp(bc_along, f[18][k]);
        float ab = y * y + ab_off * ab_off, ac = ac_across * ac_across + ac_off * ac_off;
        float bc = bc_across * bc_across + bc_off * bc_off;
        float outside = -y > ac_across ? -y : ac_across, plane = ab < ac ? ab : ac;
        outside = outside > -bc_across ? outside : -bc_across;
        plane = plane < bc ? plane : bc;
        plane = outside > 0.0f ? plane : 0.0f;
        square[k] = z * z + plane;
    }
}

static void sbi_surface_search_leaf(const sb_surface *s, const sbi_surface_leaf *leaf, sbi_surface_search *q)
{
    float square[SBI_SURFACE_WIDTH];
    sbi_surface_leaf_squares(leaf, q->p, square);
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++)
        if (square[k] <= q->limit && leaf->triangle[k] >= 0)
            sbi_surface_try(s, q, leaf->triangle[k]);
}

/* A child to visit: its distance's bits above its number, so that sorting needs no branches. */
static uint64_t sbi_surface_visit(float square, int child)
{
    uint32_t bits;
    memcpy(&bits, &square, sizeof bits);
    return (uint64_t)bits << 32 | (uint32_t)child;
}
static float sbi_surface_visit_square(uint64_t visit)
{
    uint32_t bits = (uint32_t)(visit >> 32);
    float square;
    memcpy(&square, &bits, sizeof square);
    return square;
}
static int sbi_surface_visit_child(uint64_t visit)
{
    uint32_t bits = (uint32_t)visit;
    int child;
    memcpy(&child, &bits, sizeof child);
    return child;
}

SBI_FORCE_INLINE void sbi_surface_order(uint64_t *far, uint64_t *near)
{
    uint64_t a = *far, b = *near;
    *far = a > b ? a : b;
    *near = a > b ? b : a;
}

/* Pushes the children of a node that may win, the nearest last; returns the new top. */
static int sbi_surface_push(const sbi_surface_node *node, const sbi_surface_search *q, uint64_t *stack, int top)
{
    float square[SBI_SURFACE_WIDTH];
    uint64_t visit[SBI_SURFACE_WIDTH];
    sbi_surface_box_squares(node, q->p, square);
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
            top = sbi_surface_push(s->tree + child, q, stack, top);
    }
}

/* Largest distance from the centre along an axis; NaN for a point that is not finite. */
static sb_real sbi_surface_far(const sb_surface *s, sb_vec3 scaled)
{
    sb_real d[3];
    d[0] = scaled.x - s->centre.x, d[1] = scaled.y - s->centre.y, d[2] = scaled.z - s->centre.z;
    return sbi_dense_max_abs(d, 3);
}

/* Farthest point, in local units, that is looked at: its squares are finite. */
static sb_real sbi_surface_horizon(void) { return SB_REAL_IS_FLOAT ? (sb_real)1.0e6 : (sb_real)1.0e15; }

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
    sbi_surface_set_limit(q);
    if (hint >= 0 && hint < s->triangle_count)
        sbi_surface_try(s, q, hint);
    if (far > (sb_real)SBI_SURFACE_FAR) {
        for (int t = 0; t < s->triangle_count; t++)
            sbi_surface_try(s, q, t);
        return;
    }
    sbi_surface_to_local(s, q->point, q->p);
    sbi_surface_search_tree(s, q);
}

static sb_real sbi_surface_infinity(void) { return (sb_real)INFINITY; }

static void sbi_surface_miss(sb_surface_hit *hit)
{
    memset(hit, 0, sizeof *hit);
    hit->triangle = hit->element = -1;
    hit->distance = sbi_surface_infinity();
}

/* Place, point and weights of a spot. */
static void sbi_surface_report(const sb_surface *s, int triangle, const sbi_surface_spot *spot, sb_surface_hit *hit)
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
    max_distance *= surface->scale;
    q.best.square = max_distance * max_distance;
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

/* ---- normals and signs --------------------------------------------------------------------------------------------- */

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
    if (mate == SBI_SURFACE_KNOT || s->shape[triangle] == SBI_SURFACE_FLAT || s->shape[mate] == SBI_SURFACE_FLAT)
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

/* 1 inside, 0 outside, -1: the pseudonormal cannot tell. */
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

/* ---- winding number ------------------------------------------------------------------------------------------------ */

/* A sum of angles as the argument of a product of complex numbers, and whole turns: one arctangent in all. */
typedef struct sbi_surface_angle {
    double re, im;
    int turns;
} sbi_surface_angle;

static void sbi_surface_angle_add(sbi_surface_angle *sum, double re, double im)
{
    double size = (re < 0 ? -re : re) + (im < 0 ? -im : im), x, y;
    if (!(size > 0))
        return; /* the point is a corner, or 0 times infinity */
    re /= size;
    im /= size;
    x = sum->re * re - sum->im * im;
    y = sum->re * im + sum->im * re;
    if (sum->im >= 0 && im >= 0 && y < 0)
        sum->turns++;
    if (sum->im < 0 && im < 0 && y > 0)
        sum->turns--;
    sum->re = x;
    sum->im = y;
    if (x * x + y * y < 1e-100) {
        sum->re *= 1e100;
        sum->im *= 1e100;
    }
}

/* Adds half the solid angle of a triangle (Van Oosterom, Strackee 1983); its corners are relative to the eye. */
static void sbi_surface_angle_of(const sb_surface *s, int triangle, sb_vec3 eye, sbi_surface_angle *sum)
{
    sb_vec3 x[3], a, b, c;
    double la, lb, lc;
    if (s->shape[triangle] == SBI_SURFACE_FLAT)
        return;
    sbi_surface_corners(s, triangle, x);
    a = sb_v3_sub(x[0], eye), b = sb_v3_sub(x[1], eye), c = sb_v3_sub(x[2], eye);
    la = (double)sb_v3_norm(a), lb = (double)sb_v3_norm(b), lc = (double)sb_v3_norm(c);
    sbi_surface_angle_add(sum,
                          la * lb * lc + (double)sb_v3_dot(a, b) * lc + (double)sb_v3_dot(b, c) * la +
                              (double)sb_v3_dot(c, a) * lb,
                          (double)sb_v3_dot(a, sb_v3_cross(b, c)));
}

static double sbi_surface_angle_turns(const sbi_surface_angle *sum)
{
    return (double)sum->turns + sbi_dense_atan2(sum->im, sum->re) / 6.283185307179586;
}

/* Winding numbers of a node's four children as seen from far: dipole and first moment (Barill et al. 2018, eqs. 7 to
 * 9); near[k] > 0 where the child is closer than twice its radius. */
static void sbi_surface_far_fields(const sbi_surface_cluster *cluster, const float p[3], float number[SBI_SURFACE_WIDTH],
                                   float near[SBI_SURFACE_WIDTH])
{
    const float(*f)[SBI_SURFACE_WIDTH] = cluster->f;
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++) {
        float x = f[0][k] - p[0], y = f[1][k] - p[1], z = f[2][k] - p[2], square = x * x + y * y + z * z;
        float inverse = 1.0f / square, cube = inverse * (float)sqrt((double)inverse);
        float dipole = x * f[5][k] + y * f[6][k] + z * f[7][k], trace = f[8][k] + f[9][k] + f[10][k];
        float twist = x * x * f[8][k] + y * y * f[9][k] + z * z * f[10][k] +
                      2.0f * (y * z * f[11][k] + x * z * f[12][k] + x * y * f[13][k]);
        number[k] = (dipole + trace - 3.0f * twist * inverse) * cube * 0.079577472f; /* 1 / (4 pi) */
        near[k] = 4.0f * f[SBI_CLUSTER_RADIUS][k] * f[SBI_CLUSTER_RADIUS][k] - square;
    }
}

static double sbi_surface_winding(const sb_surface *s, sb_vec3 eye)
{
    sbi_surface_angle angle;
    float p[3], number[SBI_SURFACE_WIDTH], near[SBI_SURFACE_WIDTH];
    int stack[SBI_SURFACE_STACK + SBI_SURFACE_WIDTH], top = 0, count;
    double far = 0;
    angle.re = 1, angle.im = 0, angle.turns = 0;
    sbi_surface_to_local(s, eye, p);
    stack[top++] = 0;
    while (top > 0) {
        int child = stack[--top];
        if (child < 0) {
            const int *triangle = s->leaf[~child].triangle;
            for (int k = 0; k < SBI_SURFACE_WIDTH && triangle[k] >= 0; k++)
                sbi_surface_angle_of(s, triangle[k], eye, &angle);
            continue;
        }
        sbi_surface_far_fields(s->cluster + child, p, number, near);
        count = sbi_surface_child_count(s->tree + child);
        for (int k = 0; k < count; k++) {
            if (near[k] < 0)
                far += (double)number[k];
            else
                stack[top++] = s->tree[child].child[k];
        }
    }
    return far + sbi_surface_angle_turns(&angle);
}

/* Scales a point; 0 where a surface has no winding number to speak of. */
static int sbi_surface_eye(const sb_surface *s, sb_vec3 point, sb_vec3 *eye)
{
    if (!s)
        return 0;
    *eye = sb_v3_scale(s->scale, point);
    return sbi_surface_far(s, *eye) <= (sb_real)SBI_SURFACE_FAR;
}

SB_API sb_real sb_surface_winding_number(const sb_surface *surface, sb_vec3 point)
{
    sb_vec3 eye;
    return sbi_surface_eye(surface, point, &eye) ? (sb_real)sbi_surface_winding(surface, eye) : 0;
}

SB_API sb_real sb_surface_winding_number_exact(const sb_surface *surface, sb_vec3 point)
{
    sbi_surface_angle angle;
    sb_vec3 eye;
    if (!sbi_surface_eye(surface, point, &eye))
        return 0;
    angle.re = 1, angle.im = 0, angle.turns = 0;
    for (int t = 0; t < surface->triangle_count; t++)
        sbi_surface_angle_of(surface, t, eye, &angle);
    return (sb_real)sbi_surface_angle_turns(&angle);
}

SB_API int sb_surface_inside(const sb_surface *surface, sb_vec3 point)
{
    return sb_surface_winding_number(surface, point) >= (sb_real)0.5;
}

/* ---- rays ---------------------------------------------------------------------------------------------------------- */

/* A ray in scaled coordinates. The tree is entered at `start` along the ray, near the surface, where float coordinates
 * are good. */
typedef struct sbi_surface_beam {
    sb_vec3 origin, direction; /* unit */
    sb_real best, start;
    int axis[3];               /* axis[2]: where the direction is largest */
    sb_real shear[3];
    float p[3], inverse[3];    /* local start; 1 / direction, or huge */
    float reach;               /* best beyond start, rounded up */
    int triangle;              /* or -1 */
    sb_real weight[2];         /* of corners 1 and 2 */
    sb_surface_hit *hits;      /* all hits, a list of the nearest; NULL: first hit only */
    int count, capacity, all;
} sbi_surface_beam;

static sb_real sbi_surface_component(sb_vec3 v, int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }

static void sbi_surface_beam_reach(sbi_surface_beam *beam)
{
    sb_real reach = (beam->best - beam->start) * (sb_real)1.00001 + (sb_real)SBI_SURFACE_PAD;
    beam->reach = reach < (sb_real)SBI_SURFACE_NO_LIMIT ? (float)reach : SBI_SURFACE_NO_LIMIT;
}

/* Directions are sheared so that the ray runs along axis[2]; edges shared by two triangles then give the same numbers
 * with opposite signs, and no ray passes between them. */
static void sbi_surface_beam_shear(sbi_surface_beam *beam)
{
    sb_vec3 d = beam->direction;
    sb_real x = sb_abs(d.x), y = sb_abs(d.y), z = sb_abs(d.z), largest;
    beam->axis[2] = x > y ? (x > z ? 0 : 2) : (y > z ? 1 : 2);
    beam->axis[0] = (beam->axis[2] + 1) % 3;
    beam->axis[1] = (beam->axis[2] + 2) % 3;
    largest = sbi_surface_component(d, beam->axis[2]);
    beam->shear[0] = sbi_surface_component(d, beam->axis[0]) / largest;
    beam->shear[1] = sbi_surface_component(d, beam->axis[1]) / largest;
    beam->shear[2] = (sb_real)1 / largest;
}

/* 1 / x, with a huge number for what is 0 in float: 0 times it stays 0. */
static float sbi_surface_slope(sb_real x)
{
    float f = (float)x;
    if (f > 1.0e-30f || f < -1.0e-30f)
        return 1.0f / f;
    return 1.0e30f;
}

/* Sets up a ray; 0 when it has no direction or passes the surface by. */
static int sbi_surface_beam_make(const sb_surface *s, sb_vec3 origin, sb_vec3 direction, sb_real max,
                                 sbi_surface_beam *beam)
{
    sb_real d[3], size, along;
    sb_vec3 to_centre, start;
    d[0] = direction.x, d[1] = direction.y, d[2] = direction.z;
    size = sbi_dense_max_abs(d, 3);
    memset(beam, 0, sizeof *beam);
    if (!(max >= 0) || !(size > 0))
        return 0;
    direction = sb_v3(direction.x / size, direction.y / size, direction.z / size);
    beam->direction = sb_v3_scale((sb_real)1 / sb_v3_norm(direction), direction);
    beam->origin = sb_v3_scale(s->scale, origin);
    beam->best = max * s->scale;
    beam->triangle = -1;
    if (!(sbi_surface_far(s, beam->origin) <= sbi_surface_horizon()))
        return 0;
    to_centre = sb_v3_sub(s->centre, beam->origin);
    along = sb_v3_dot(to_centre, beam->direction);
    if (along < -4) /* the surface's radius is below 2 sqrt 3 */
        return 0;
    beam->start = sb_max(along - 4, 0);
    start = sb_v3_madd(beam->origin, beam->start, beam->direction);
    if (!(sbi_surface_far(s, start) <= 16))
        return 0;
    sbi_surface_to_local(s, start, beam->p);
    beam->inverse[0] = sbi_surface_slope(beam->direction.x);
    beam->inverse[1] = sbi_surface_slope(beam->direction.y);
    beam->inverse[2] = sbi_surface_slope(beam->direction.z);
    sbi_surface_beam_shear(beam);
    sbi_surface_beam_reach(beam);
    return 1;
}

/* Where the ray is inside each of a node's boxes: from enter to leave, both relative to start. */
static void sbi_surface_beam_boxes(const sbi_surface_node *node, const sbi_surface_beam *beam,
                                   float enter[SBI_SURFACE_WIDTH], float leave[SBI_SURFACE_WIDTH])
{
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++)
        enter[k] = 0.0f, leave[k] = beam->reach;
    for (int axis = 0; axis < 3; axis++) {
        for (int k = 0; k < SBI_SURFACE_WIDTH; k++) {
            float a = (node->low[axis][k] - beam->p[axis]) * beam->inverse[axis];
            float b = (node->high[axis][k] - beam->p[axis]) * beam->inverse[axis];
            float first = a < b ? a : b, last = a < b ? b : a;
            last += 1.0e-6f * (last < 0.0f ? -last : last); /* both roundings, and that of the direction */
            enter[k] = first > enter[k] ? first : enter[k];
            leave[k] = last < leave[k] ? last : leave[k];
        }
    }
}

/* Coordinates of a corner relative to the ray. */
static void sbi_surface_beam_corner(const sbi_surface_beam *beam, sb_vec3 corner, sb_real x[3])
{
    sb_vec3 d = sb_v3_sub(corner, beam->origin);
    sb_real depth = sbi_surface_component(d, beam->axis[2]);
    x[0] = sbi_surface_component(d, beam->axis[0]) - beam->shear[0] * depth;
    x[1] = sbi_surface_component(d, beam->axis[1]) - beam->shear[1] * depth;
    x[2] = beam->shear[2] * depth;
}

/* 1 when the ray meets the triangle in front of its origin: *t and weights of corners 1 and 2. */
static int sbi_surface_beam_meets(const sb_surface *s, const sbi_surface_beam *beam, int triangle, sb_real *t,
                                  sb_real weight[2])
{
    sb_vec3 x[3];
    sb_real a[3], b[3], c[3], u, v, w, det;
    sbi_surface_corners(s, triangle, x);
    sbi_surface_beam_corner(beam, x[0], a);
    sbi_surface_beam_corner(beam, x[1], b);
    sbi_surface_beam_corner(beam, x[2], c);
    u = c[0] * b[1] - c[1] * b[0];
    v = a[0] * c[1] - a[1] * c[0];
    w = b[0] * a[1] - b[1] * a[0];
    if ((u < 0 || v < 0 || w < 0) && (u > 0 || v > 0 || w > 0))
        return 0;
    det = u + v + w;
    if (det == 0)
        return 0;
    *t = (u * a[2] + v * b[2] + w * c[2]) / det;
    weight[0] = v / det;
    weight[1] = w / det;
    return *t >= 0;
}

static void sbi_surface_beam_report(const sb_surface *s, int triangle, sb_real t, const sb_real weight[2],
                                    sb_surface_hit *hit)
{
    sbi_surface_spot spot = sbi_surface_spot_make(weight[0], weight[1], SB_SURFACE_FACE, 0);
    sbi_surface_report(s, triangle, &spot, hit);
    hit->distance = s->inverse * t;
}

/* Puts a hit where it belongs among the nearest so far. */
static void sbi_surface_beam_insert(const sb_surface *s, sbi_surface_beam *beam, const sb_surface_hit *hit)
{
    int i = sbi_min_int(beam->count, beam->capacity);
    (void)s;
    beam->count++;
    while (i > 0 && (beam->hits[i - 1].distance > hit->distance ||
                     (beam->hits[i - 1].distance == hit->distance && beam->hits[i - 1].triangle > hit->triangle))) {
        if (i < beam->capacity)
            beam->hits[i] = beam->hits[i - 1];
        i--;
    }
    if (i < beam->capacity)
        beam->hits[i] = *hit;
}

static void sbi_surface_beam_try(const sb_surface *s, sbi_surface_beam *beam, int triangle)
{
    sb_real t, weight[2];
    if (!sbi_surface_beam_meets(s, beam, triangle, &t, weight) || t > beam->best)
        return;
    if (beam->all) {
        sb_surface_hit hit;
        sbi_surface_beam_report(s, triangle, t, weight, &hit);
        sbi_surface_beam_insert(s, beam, &hit);
    } else if (beam->triangle < 0 || t < beam->best || triangle < beam->triangle) {
        beam->best = t;
        beam->triangle = triangle;
        beam->weight[0] = weight[0];
        beam->weight[1] = weight[1];
        sbi_surface_beam_reach(beam);
    }
}

/* Pushes the children that the ray goes through, the first last. */
static int sbi_surface_beam_push(const sbi_surface_node *node, const sbi_surface_beam *beam, uint64_t *stack, int top)
{
    float enter[SBI_SURFACE_WIDTH], leave[SBI_SURFACE_WIDTH];
    int bottom = top;
    sbi_surface_beam_boxes(node, beam, enter, leave);
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++) {
        uint64_t visit = sbi_surface_visit(enter[k], node->child[k]);
        int i = top;
        if (!(enter[k] <= leave[k]) || !(node->low[0][k] < SBI_SURFACE_FAR))
            continue;
        for (; i > bottom && stack[i - 1] < visit; i--)
            stack[i] = stack[i - 1];
        stack[i] = visit;
        top++;
    }
    return top;
}

static void sbi_surface_beam_run(const sb_surface *s, sbi_surface_beam *beam)
{
    uint64_t stack[SBI_SURFACE_STACK + SBI_SURFACE_WIDTH];
    int top = 0;
    stack[top++] = sbi_surface_visit(0.0f, 0);
    while (top > 0) {
        uint64_t visit = stack[--top];
        int child = sbi_surface_visit_child(visit);
        if (sbi_surface_visit_square(visit) > beam->reach)
            continue;
        if (child >= 0) {
            top = sbi_surface_beam_push(s->tree + child, beam, stack, top);
            continue;
        }
        for (int k = 0; k < SBI_SURFACE_WIDTH && s->leaf[~child].triangle[k] >= 0; k++)
            sbi_surface_beam_try(s, beam, s->leaf[~child].triangle[k]);
    }
}

SB_API int sb_surface_ray(const sb_surface *surface, sb_vec3 origin, sb_vec3 direction, sb_real max,
                          sb_surface_hit *hit)
{
    sbi_surface_beam beam;
    if (hit)
        sbi_surface_miss(hit);
    if (!surface || !sbi_surface_beam_make(surface, origin, direction, max, &beam))
        return 0;
    sbi_surface_beam_run(surface, &beam);
    if (beam.triangle < 0)
        return 0;
    if (hit)
        sbi_surface_beam_report(surface, beam.triangle, beam.best, beam.weight, hit);
    return 1;
}

SB_API int sb_surface_ray_all(const sb_surface *surface, sb_vec3 origin, sb_vec3 direction, sb_real max,
                              sb_surface_hit *hits, int capacity)
{
    sbi_surface_beam beam;
    if (!surface || !sbi_surface_beam_make(surface, origin, direction, max, &beam))
        return 0;
    beam.all = 1;
    beam.hits = hits;
    beam.capacity = hits ? sbi_max_int(capacity, 0) : 0;
    sbi_surface_beam_run(surface, &beam);
    return beam.count;
}

/* ---- batches ------------------------------------------------------------------------------------------------------- */

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
