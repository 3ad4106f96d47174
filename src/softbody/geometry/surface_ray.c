/* surface_ray: triangles that a ray meets. */
#include "surface_tree.h"

/* ---- rays ---------------------------------------------------------------------------------------------------- */

/* A ray in scaled coordinates. The tree is entered at `start` along the ray, near the surface, where float coordinates
 * are good. */
typedef struct sbi_surface_beam {
    sb_vec3 origin, direction; /* unit */
    sb_real best, start;
    int axis[3]; /* axis[2]: where the direction is largest */
    sb_real shear[3];
    float p[3], inverse[3]; /* local start; 1 / direction, or huge */
    float reach;            /* best beyond start, rounded up */
    int triangle;           /* or -1 */
    sb_real weight[2];      /* of corners 1 and 2 */
    sb_surface_hit *hits;   /* all hits, a list of the nearest; NULL: first hit only */
    int count, capacity, all;
} sbi_surface_beam;

static sb_real sbi_surface_component(sb_vec3 v, int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }

static void sbi_surface_beam_reach(sbi_surface_beam *beam)
{
    sb_real way = sb_min(beam->best - beam->start, (sb_real)SBI_SURFACE_NO_LIMIT);
    sb_real reach = way * (sb_real)1.00001 + (sb_real)SBI_SURFACE_PAD;
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
    if (f > 1.0e-20f || f < -1.0e-20f)
        return 1.0f / f;
    return 1.0e20f; /* times SBI_SURFACE_NOWHERE it is still a float */
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
    beam->best = sbi_capped_product(max, s->scale);
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
static int sbi_surface_beam_meets(const sbi_surface_beam *beam, const sb_vec3 x[3], sb_real *t, sb_real weight[2])
{
    sb_real a[3], b[3], c[3], u, v, w, det;
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
static void sbi_surface_beam_insert(sbi_surface_beam *beam, const sb_surface_hit *hit)
{
    int i = sbi_min_int(beam->count, beam->capacity);
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

static void sbi_surface_beam_try(const sb_surface *s, sbi_surface_beam *beam, int triangle, const sb_vec3 x[3])
{
    sb_real t, weight[2];
    if (!sbi_surface_beam_meets(beam, x, &t, weight) || t > beam->best)
        return;
    if (beam->all) {
        sb_surface_hit hit;
        sbi_surface_beam_report(s, triangle, t, weight, &hit);
        sbi_surface_beam_insert(beam, &hit);
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
        for (int k = 0; k < SBI_SURFACE_WIDTH && s->leaf[~child].triangle[k] != SBI_SURFACE_NO_TRIANGLE; k++)
            sbi_surface_beam_try(s, beam, sbi_surface_leaf_triangle(s->leaf + ~child, k),
                                 s->exact[SBI_SURFACE_WIDTH * ~child + k]);
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
