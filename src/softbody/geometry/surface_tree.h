/* surface_tree: what surface.c builds, surface_query.c searches and surface_check.c looks through. */
#ifndef SBI_SURFACE_TREE_H
#define SBI_SURFACE_TREE_H

#include "../base/four.h"
#include "surface.h"

#include <limits.h>
#include <string.h>

enum {
    SBI_SURFACE_WIDTH = 4,   /* children of a node, triangles of a leaf */
    SBI_SURFACE_BINS = 16,   /* places a range of triangles may be cut at, per axis */
    SBI_SURFACE_LINE = 64,   /* bytes of a cache line */
    SBI_SURFACE_MANY = 1024, /* triangles: larger ranges are cut across their longest side only */
    SBI_SURFACE_DEEP = 48,   /* cuts by cost up to this depth, then into halves */
    SBI_SURFACE_STACK = 288, /* 3 per level, and at most DEEP + 31 levels below the root */
    SBI_SURFACE_BLOCK = 256, /* points, triangles or nodes per task */
    SBI_SURFACE_KEPT = 48,   /* candidates of a search */
    SBI_SURFACE_NO_TRIANGLE = INT_MIN,
    SBI_SURFACE_OPEN = -1,       /* mate of an edge of one triangle */
    SBI_SURFACE_NONMANIFOLD = -2 /* mate of an edge of several triangles, or of two that disagree on its direction */
};

/* What a triangle is good for. */
enum {
    SBI_SURFACE_SOUND = 0,
    SBI_SURFACE_THIN = 1, /* so thin that the usual formulas lose half their digits */
    SBI_SURFACE_FLAT = 2  /* a segment or a point, to rounding: it has no normal */
};

#define SBI_SURFACE_SLIVER (sb_real)0.2 /* height over longest edge; below it float confuses inside and outside */
#define SBI_SURFACE_FAR 1.0e5f          /* local: beyond it all boxes look the same */
#define SBI_SURFACE_NOWHERE 1.0e17f     /* local: where the empty children lie */
#define SBI_SURFACE_NO_LIMIT 1.0e30f    /* between the squares of the two */
#define SBI_SURFACE_PAD 2.0e-6f         /* local: more than the rounding of boxes and of nearby points */
#define SBI_SURFACE_SLACK 4.0e-6f       /* rounding of a distance from a leaf, per unit of |point| + 1 */

/* ---- the tree ------------------------------------------------------------------------------------------------ */

/* A node has its children in boxes and in coins: around the centre of area, flat along the mean normal. Patches of a
 * surface fill coins better than boxes, so that their distances differ where those of boxes do not. */
enum {
    SBI_COIN_CENTRE = 0,
    SBI_COIN_NORMAL = 3,
    SBI_COIN_RADIUS = 6,
    SBI_COIN_THICKNESS = 7, /* half of it */
    SBI_COIN_SIZE = 8
};
/* Children that are not there lie nowhere, so no query gets to them. */
typedef struct sbi_surface_node {
    float low[3][SBI_SURFACE_WIDTH], high[3][SBI_SURFACE_WIDTH];
    float coin[SBI_COIN_SIZE][SBI_SURFACE_WIDTH];
    int child[SBI_SURFACE_WIDTH]; /* node, or ~leaf */
    int slot;                     /* of this node in its parent: 4 parent + child */
    int unused[3];                /* four cache lines in all */
} sbi_surface_node;

/* A triangle ABC, AB its longest edge, in a frame of its own: origin A, axes along AB and to C's side. */
enum {
    SBI_LEAF_ORIGIN = 0,
    SBI_LEAF_ALONG = 3,
    SBI_LEAF_ACROSS = 6,
    SBI_LEAF_AB = 9,  /* length */
    SBI_LEAF_C = 10,  /* coordinates of C */
    SBI_LEAF_AC = 12, /* 1 / length^2, 0 for no length */
    SBI_LEAF_BC = 13,
    SBI_LEAF_SIZE = 14
};
typedef struct sbi_surface_leaf {
    float f[SBI_LEAF_SIZE][SBI_SURFACE_WIDTH];
    int triangle[SBI_SURFACE_WIDTH]; /* number; ~number of a sliver; NO_TRIANGLE: a copy of the first */
    int unused[SBI_SURFACE_WIDTH];   /* four cache lines in all */
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
    void *block; /* what the allocator gave; the surface begins at its first cache line */
    int node_count, triangle_count, tree_count, leaf_count;
    int unbalanced;         /* edges not run through as often one way as the other */
    sb_vec3 *nodes;         /* [node_count] scaled */
    int (*corners)[3];      /* [triangle_count] */
    int (*mate)[3];         /* [triangle_count] triangle across each edge, OPEN or NONMANIFOLD */
    int *element;           /* [triangle_count] */
    unsigned char *shape;   /* [triangle_count] sound, thin or flat */
    unsigned char *pinched; /* [node_count] 1: parts touch in this node */
    int *fan_start;         /* [node_count + 1] */
    int *fan;               /* [3 triangle_count] 3 triangle + corner, by node */
    sb_vec3 *normal;        /* [node_count] sum of angle_i n_i / sum of angle_i; 0: means nothing */
    sbi_surface_node *tree;
    sbi_surface_cluster *cluster; /* [tree_count] */
    sbi_surface_leaf *leaf;
    int *leaf_slot;      /* [leaf_count] 4 parent + child */
    sb_vec3 (*exact)[3]; /* [4 leaf_count] scaled corners again, side by side for the triangles of a leaf */
    sb_vec3 low, high;   /* m */
    sb_vec3 centre;      /* scaled */
    sb_real scale, inverse;
};

/* ---- triangles ----------------------------------------------------------------------------------------------- */

SB_INLINE void sbi_surface_corners(const sb_surface *s, int triangle, sb_vec3 x[3])
{
    for (int i = 0; i < 3; i++)
        x[i] = s->nodes[s->corners[triangle][i]];
}

SB_INLINE int sbi_surface_leaf_triangle(const sbi_surface_leaf *leaf, int k)
{
    return leaf->triangle[k] < 0 ? ~leaf->triangle[k] : leaf->triangle[k];
}

SB_INLINE sb_vec3 sbi_surface_area_vector(const sb_vec3 x[3])
{
    return sb_v3_cross(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0])); /* twice the area */
}

/* Unit normal; 0 for a flat triangle. */
SB_INLINE sb_vec3 sbi_surface_unit_normal(const sb_surface *s, int triangle)
{
    sb_vec3 x[3], n;
    if (s->shape[triangle] == SBI_SURFACE_FLAT)
        return sb_v3(0, 0, 0);
    sbi_surface_corners(s, triangle, x);
    n = sbi_surface_area_vector(x);
    return sb_v3_scale((sb_real)1 / sb_v3_norm(n), n);
}

SB_INLINE void sbi_surface_to_local(const sb_surface *s, sb_vec3 x, float p[3])
{
    p[0] = (float)(x.x - s->centre.x);
    p[1] = (float)(x.y - s->centre.y);
    p[2] = (float)(x.z - s->centre.z);
}

/* Box of the triangle in local coordinates, widened by PAD. */
SB_INLINE void sbi_surface_box_of(const sb_surface *s, const sb_vec3 x[3], float low[3], float high[3])
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

SB_INLINE int sbi_surface_child_count(const sbi_surface_node *node)
{
    int count = 0;
    while (count < SBI_SURFACE_WIDTH && node->low[0][count] < SBI_SURFACE_FAR)
        count++;
    return count;
}

SB_INLINE int sbi_surface_blocks(int count) { return (count - 1) / SBI_SURFACE_BLOCK + 1; }

/* Height over longest edge. */
SB_INLINE sb_real sbi_surface_slimness(const sb_vec3 x[3])
{
    sb_real longest = 0, area = sb_v3_norm(sbi_surface_area_vector(x));
    for (int i = 0; i < 3; i++) {
        sb_vec3 edge = sb_v3_sub(x[(i + 1) % 3], x[i]);
        longest = sb_max(longest, sb_v3_dot(edge, edge));
    }
    return longest > 0 ? area / longest : 0;
}

SB_INLINE unsigned char sbi_surface_shape_of(sb_real slimness)
{
    if (!(slimness > 8 * SB_EPSILON))
        return SBI_SURFACE_FLAT;
    return slimness * slimness < sb_sqrt(SB_EPSILON) ? SBI_SURFACE_THIN : SBI_SURFACE_SOUND;
}

SB_INLINE int sbi_surface_longest_edge(const sb_vec3 x[3])
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

SB_INLINE int sbi_surface_repeats(const int *nodes)
{
    return nodes[0] == nodes[1] || nodes[1] == nodes[2] || nodes[2] == nodes[0];
}

/* A sum of angles as the argument of a product of complex numbers, and whole turns: one arctangent in all. */
typedef struct sbi_surface_angle {
    double re, im;
    int turns;
} sbi_surface_angle;
SB_INLINE sbi_surface_angle sbi_surface_angle_zero(void)
{
    sbi_surface_angle angle;
    angle.re = 1;
    angle.im = 0;
    angle.turns = 0;
    return angle;
}

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* The winding number by the tree, from a scaled point. */
SBI_API double sbi_surface_winding(const sb_surface *s, sb_vec3 eye);
/* Adds half the solid angle under which the eye sees a triangle (both scaled). */
SBI_API void sbi_surface_angle_of(const sb_vec3 x[3], sb_vec3 eye, sbi_surface_angle *sum);
/* The sum over 4 pi. */
SBI_API double sbi_surface_angle_turns(const sbi_surface_angle *sum);
/* Counts pairs of triangles that cross, and triangles whose search was given up; places must be 0 or -1 all over.
 * crossing[triangles] (or NULL) becomes 1 for both. Returns 1 when pairs may be missing, 0 when not, -1: no memory. */
SBI_API int sbi_surface_find_crossings(const sb_surface *s, const sb_allocator *allocator, sb_surface_place *crossings,
                                       sb_surface_place *crowds, unsigned char *crossing);
#endif

/* ---- what closest points and rays share ---------------------------------------------------------------------- */

/* The point of a triangle closest to a given one: its weights for corners 1 and 2, its place, its distance squared. */
typedef struct sbi_surface_spot {
    sb_real square, v, w;
    int feature, index;
} sbi_surface_spot;

SB_INLINE sbi_surface_spot sbi_surface_spot_make(sb_real v, sb_real w, int feature, int index)
{
    sbi_surface_spot spot;
    spot.square = 0;
    spot.v = v;
    spot.w = w;
    spot.feature = feature;
    spot.index = index;
    return spot;
}

/* A child to visit: its distance's bits above its number, so that sorting needs no branches. */
SB_INLINE uint64_t sbi_surface_visit(float square, int child)
{
    uint32_t bits;
    memcpy(&bits, &square, sizeof bits);
    return (uint64_t)bits << 32 | (uint32_t)child;
}
SB_INLINE float sbi_surface_visit_square(uint64_t visit)
{
    uint32_t bits = (uint32_t)(visit >> 32);
    float square;
    memcpy(&square, &bits, sizeof square);
    return square;
}
SB_INLINE int sbi_surface_visit_child(uint64_t visit)
{
    uint32_t bits = (uint32_t)visit;
    int child;
    memcpy(&child, &bits, sizeof child);
    return child;
}

/* Farthest point, in local units, that is looked at: its squares are finite. */
SB_INLINE sb_real sbi_surface_horizon(void) { return SB_REAL_IS_FLOAT ? (sb_real)1.0e6 : (sb_real)1.0e15; }

/* Largest distance from the centre along an axis; NaN for a point that is not finite. */
SB_INLINE sb_real sbi_surface_far(const sb_surface *s, sb_vec3 scaled)
{
    sb_real d[3];
    d[0] = scaled.x - s->centre.x, d[1] = scaled.y - s->centre.y, d[2] = scaled.z - s->centre.z;
    return sbi_dense_max_abs(d, 3);
}

SBI_API void sbi_surface_miss(sb_surface_hit *hit);
/* Place, point and weights of a spot. */
SBI_API void sbi_surface_report(const sb_surface *s, int triangle, const sbi_surface_spot *spot, sb_surface_hit *hit);

#endif /* SBI_SURFACE_TREE_H */
