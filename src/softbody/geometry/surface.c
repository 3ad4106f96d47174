/* surface: a tree of boxes over triangles, and what is asked of it.
 *
 * Nodes of the tree have four children; a leaf holds up to four triangles. Both are kept as float, four side by side
 * for vector instructions, and only ever say "too far": they work in local coordinates (centred, scaled by a power of
 * two so that half the surface's size is in [1, 2)), and a slack covers their rounding. What is left, a few triangles
 * per query, is computed in sb_real from the corners. So the answer is the smallest of all triangles' own distances
 * whatever the tree looks like, and its bits depend on nothing else.
 *
 * sb_real positions are scaled by the same power of two (which is exact): no square under- or overflows at any size. */
#include "surface_tree.h"

/* ---- refitting ----------------------------------------------------------------------------------------------- */

static void sbi_surface_put(float (*f)[SBI_SURFACE_WIDTH], int lane, sb_vec3 v)
{
    f[0][lane] = (float)v.x;
    f[1][lane] = (float)v.y;
    f[2][lane] = (float)v.z;
}

static float sbi_surface_inverse_square(sb_real x, sb_real y)
{
    float square = (float)(x * x + y * y);
    return square > 1.0e-35f ? 1.0f / square : 0.0f;
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
    leaf->f[SBI_LEAF_AB][lane] = (float)length;
    leaf->f[SBI_LEAF_C][lane] = (float)along;
    leaf->f[SBI_LEAF_C + 1][lane] = (float)height;
    leaf->f[SBI_LEAF_AC][lane] = sbi_surface_inverse_square(along, height);
    leaf->f[SBI_LEAF_BC][lane] = sbi_surface_inverse_square(along - length, height);
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
    for (int i = 0; i < 3; i++) {
        sb_vec3 d = sb_v3_sub(x[i], field->centre);
        field->radius = sb_max(field->radius, sb_v3_dot(d, d));
    }
    field->radius = sb_sqrt(field->radius);
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

/* A coin in the making, in local coordinates. */
typedef struct sbi_surface_coin {
    sb_vec3 centre, normal;
    sb_real radius, thickness;
} sbi_surface_coin;

static sb_vec3 sbi_surface_rounded(sb_vec3 v)
{
    return sb_v3((sb_real)(float)v.x, (sb_real)(float)v.y, (sb_real)(float)v.z);
}

/* An empty coin in the middle of a far field, as float holds it. */
static void sbi_surface_coin_begin(const sbi_surface_field *field, sbi_surface_coin *coin)
{
    sb_real length = sb_v3_norm(field->dipole);
    coin->centre = sbi_surface_rounded(field->centre);
    coin->normal = length > SB_EPSILON * field->area && length > 0 ? sb_v3_scale((sb_real)1 / length, field->dipole)
                                                                   : sb_v3(0, 0, 1);
    coin->normal = sbi_surface_rounded(coin->normal);
    coin->radius = coin->thickness = 0;
}

/* Widens the coin by another. */
static void sbi_surface_coin_add(sbi_surface_coin *coin, const sbi_surface_coin *other)
{
    sb_vec3 d = sb_v3_sub(other->centre, coin->centre);
    sb_real height = sb_v3_dot(d, coin->normal), tilt = sb_abs(sb_v3_dot(coin->normal, other->normal));
    sb_real sine = sb_v3_norm(sb_v3_cross(coin->normal, other->normal));
    sb_real aside = sb_v3_norm(sb_v3_madd(d, -height, coin->normal));
    height = sb_abs(height) + tilt * other->thickness + sine * other->radius;
    coin->radius = sb_max(coin->radius, aside + other->radius + sine * other->thickness);
    coin->thickness = sb_max(coin->thickness, height);
}

static void sbi_surface_coin_store(const sbi_surface_coin *coin, sbi_surface_node *node, int lane)
{
    sbi_surface_put(node->coin + SBI_COIN_CENTRE, lane, coin->centre);
    sbi_surface_put(node->coin + SBI_COIN_NORMAL, lane, coin->normal);
    node->coin[SBI_COIN_RADIUS][lane] = (float)coin->radius + SBI_SURFACE_PAD;
    node->coin[SBI_COIN_THICKNESS][lane] = (float)coin->thickness + SBI_SURFACE_PAD;
}

static void sbi_surface_coin_load(const sbi_surface_node *node, int lane, sbi_surface_coin *coin)
{
    const float(*f)[SBI_SURFACE_WIDTH] = node->coin;
    coin->centre = sb_v3((sb_real)f[0][lane], (sb_real)f[1][lane], (sb_real)f[2][lane]);
    coin->normal = sb_v3((sb_real)f[3][lane], (sb_real)f[4][lane], (sb_real)f[5][lane]);
    coin->radius = (sb_real)f[SBI_COIN_RADIUS][lane];
    coin->thickness = (sb_real)f[SBI_COIN_THICKNESS][lane];
}

static void sbi_surface_set_child_box(sbi_surface_node *node, int lane, const float low[3], const float high[3])
{
    for (int axis = 0; axis < 3; axis++) {
        node->low[axis][lane] = low[axis];
        node->high[axis][lane] = high[axis];
    }
}

/* The coin around the triangles of a leaf: around points. */
static void sbi_surface_coin_of_leaf(const sb_surface *s, int index, const sbi_surface_field *field,
                                     sbi_surface_coin *coin)
{
    sb_real square = 0;
    sbi_surface_coin_begin(field, coin);
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++) { /* places without a triangle hold copies */
        for (int i = 0; i < 3; i++) {
            sb_vec3 point = sb_v3_sub(s->exact[SBI_SURFACE_WIDTH * index + k][i], s->centre);
            sb_vec3 d = sb_v3_sub(point, coin->centre), aside;
            sb_real height = sb_v3_dot(d, coin->normal);
            aside = sb_v3_madd(d, -height, coin->normal);
            square = sb_max(square, sb_v3_dot(aside, aside));
            coin->thickness = sb_max(coin->thickness, sb_abs(height));
        }
    }
    coin->radius = sb_sqrt(square);
}

/* Recomputes a leaf from the nodes, and its box, coin and far field in its parent. */
static void sbi_surface_refit_leaf(sb_surface *s, int index)
{
    sbi_surface_leaf *leaf = s->leaf + index;
    sbi_surface_field part[SBI_SURFACE_WIDTH], field;
    sbi_surface_coin coin;
    float low[3], high[3], box_low[3], box_high[3];
    int parent = s->leaf_slot[index] / SBI_SURFACE_WIDTH, lane = s->leaf_slot[index] % SBI_SURFACE_WIDTH, count = 0;
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++) {
        int triangle = sbi_surface_leaf_triangle(leaf, leaf->triangle[k] == SBI_SURFACE_NO_TRIANGLE ? 0 : k);
        sb_vec3 x[3];
        sb_real slimness;
        sbi_surface_corners(s, triangle, x);
        sbi_surface_leaf_set(s, leaf, k, x);
        memcpy(s->exact[SBI_SURFACE_WIDTH * index + k], x, sizeof x);
        if (leaf->triangle[k] == SBI_SURFACE_NO_TRIANGLE)
            continue;
        slimness = sbi_surface_slimness(x);
        leaf->triangle[k] = slimness < SBI_SURFACE_SLIVER ? ~triangle : triangle;
        s->shape[triangle] = sbi_surface_shape_of(slimness);
        sbi_surface_box_of(s, x, low, high);
        if (count == 0)
            memcpy(box_low, low, sizeof low), memcpy(box_high, high, sizeof high);
        sbi_surface_box_add(box_low, box_high, low, high);
        sbi_surface_field_of(s, triangle, x, part + count++);
    }
    sbi_surface_set_child_box(s->tree + parent, lane, box_low, box_high);
    sbi_surface_field_join(part, count, &field);
    sbi_surface_field_store(&field, s->cluster + parent, lane);
    sbi_surface_coin_of_leaf(s, index, &field, &coin);
    sbi_surface_coin_store(&coin, s->tree + parent, lane);
}

/* Passes the boxes, coins and far fields of a node's children on to its own parent. */
static void sbi_surface_refit_node(sb_surface *s, int index)
{
    const sbi_surface_node *node = s->tree + index;
    sbi_surface_field part[SBI_SURFACE_WIDTH], field;
    sbi_surface_coin coin, other;
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
    sbi_surface_coin_begin(&field, &coin);
    for (int k = 0; k < count; k++) {
        sbi_surface_coin_load(node, k, &other);
        sbi_surface_coin_add(&coin, &other);
    }
    sbi_surface_coin_store(&coin, s->tree + parent, lane);
}

/* Angle-weighted normal of a node (Baerentzen, Aanaes 2005), over the sum of the angles, so that its length says how
 * much the faces agree. 0 where it means nothing: flat triangles, non-manifold edges and pinched nodes. */
static void sbi_surface_refit_normal(sb_surface *s, int node)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    sb_real angles = 0;
    int sound = !s->pinched[node];
    for (int i = s->fan_start[node]; sound && i < s->fan_start[node + 1]; i++) {
        int triangle = s->fan[i] / 3, corner = s->fan[i] % 3;
        const int *nodes = s->corners[triangle];
        sb_vec3 x = s->nodes[node], n;
        sb_vec3 a = sb_v3_sub(s->nodes[nodes[(corner + 1) % 3]], x);
        sb_vec3 b = sb_v3_sub(s->nodes[nodes[(corner + 2) % 3]], x);
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
    size = size > 0 ? sb_max(size, SB_EPSILON * coordinate) : coordinate;
    s->scale = s->inverse = 1;
    if (size > 0)
        sbi_dense_scale(size, &s->scale, &s->inverse);
    s->low = low;
    s->high = high;
    low = sb_v3_scale(s->scale, low);
    high = sb_v3_scale(s->scale, high);
    s->centre = sb_v3_madd(low, (sb_real)0.5, sb_v3_sub(high, low));
}

static sb_result sbi_surface_fail_extent(sb_error *error)
{
    return sbi_fail(error, SB_ERROR_NOT_FINITE, "the surface is too large: its size is not finite");
}

static sb_result sbi_surface_check_extent(const sb_surface *s, const sb_vec3 *nodes, sb_error *error)
{
    sb_vec3 low, high;
    for (int v = 0; v < s->node_count; v++)
        if (!sb_v3_is_finite(nodes[v]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, v, "node %d has a coordinate that is not finite", v);
    sbi_surface_measure(s, nodes, &low, &high);
    if (!sb_v3_is_finite(sb_v3_sub(high, low)))
        return sbi_surface_fail_extent(error);
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

/* ---- the shape of the tree ----------------------------------------------------------------------------------- */

/* Scratch of building: triangles in an order that puts those of a leaf side by side. */
typedef struct sbi_surface_build {
    int count;
    float (*box)[8];                 /* [count] low and high, four each for the width of a load, in any units */
    int *order;                      /* [count] */
    int (*child)[SBI_SURFACE_WIDTH]; /* [count] nodes: child node, ~leaf or INT_MAX: none */
    int *slot;                       /* [count] of each node in its parent */
    int (*leaf)[2];                  /* [count] places in the order: from, to */
    int tree_count, leaf_count;
} sbi_surface_build;

typedef struct sbi_surface_bins {
    float low[SBI_SURFACE_BINS][4], high[SBI_SURFACE_BINS][4];
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
    return b->box[triangle][axis] + b->box[triangle][axis + 4];
}

/* Box of the middles of a range. */
static void sbi_surface_middles(const sbi_surface_build *b, int begin, int end, float low[4], float high[4])
{
    sbi_four least = sbi_four_of(SBI_SURFACE_NOWHERE), most = sbi_four_of(-SBI_SURFACE_NOWHERE);
    for (int i = begin; i < end; i++) {
        const float *box = b->box[b->order[i]];
        sbi_four middle = sbi_four_sub(sbi_four_load(box), sbi_four_sub(sbi_four_of(0.0f), sbi_four_load(box + 4)));
        least = sbi_four_min(least, middle);
        most = sbi_four_max(most, middle);
    }
    sbi_four_store(low, least);
    sbi_four_store(high, most);
}

/* Widens a box of four-wide corners by another. */
SBI_FORCE_INLINE void sbi_surface_box_join(float low[4], float high[4], const float other_low[4],
                                           const float other_high[4])
{
    sbi_four_store(low, sbi_four_min(sbi_four_load(low), sbi_four_load(other_low)));
    sbi_four_store(high, sbi_four_max(sbi_four_load(high), sbi_four_load(other_high)));
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
        for (int i = 0; i < 4; i++) {
            bins->low[k][i] = SBI_SURFACE_NOWHERE;
            bins->high[k][i] = -SBI_SURFACE_NOWHERE;
        }
    }
    for (int i = begin; i < end; i++) {
        const float *box = b->box[b->order[i]];
        int k = sbi_surface_bin(box[axis] + box[axis + 4], low, per_unit);
        bins->count[k]++;
        sbi_surface_box_join(bins->low[k], bins->high[k], box, box + 4);
    }
}

/* Leaves that `count` triangles need. */
static float sbi_surface_leaves(int count) { return (float)((count + SBI_SURFACE_WIDTH - 1) / SBI_SURFACE_WIDTH); }

/* Surface area heuristic over the cuts after each bin: returns the cost of the best one and its bin, or a negative
 * number when the bins cannot be cut. */
static float sbi_surface_best_cut(const sbi_surface_bins *bins, int count, int *cut)
{
    float right[SBI_SURFACE_BINS], low[4], high[4], best = -1.0f;
    int left = 0;
    memcpy(low, bins->low[SBI_SURFACE_BINS - 1], sizeof low);
    memcpy(high, bins->high[SBI_SURFACE_BINS - 1], sizeof high);
    for (int k = SBI_SURFACE_BINS - 1; k > 0; k--) {
        sbi_surface_box_join(low, high, bins->low[k], bins->high[k]);
        right[k] = sbi_surface_half_area(low, high);
    }
    memcpy(low, bins->low[0], sizeof low);
    memcpy(high, bins->high[0], sizeof high);
    for (int k = 0; k + 1 < SBI_SURFACE_BINS; k++) {
        float cost;
        left += bins->count[k];
        sbi_surface_box_join(low, high, bins->low[k], bins->high[k]);
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
    float low[4], high[4], best = -1.0f, best_per_unit = 0.0f, longest = 0.0f;
    int best_axis = 0, best_cut = 0;
    sbi_surface_bins bins;
    if (depth > SBI_SURFACE_DEEP)
        return begin + (end - begin) / 2;
    sbi_surface_middles(b, begin, end, low, high);
    for (int axis = 0; axis < 3; axis++)
        longest = high[axis] - low[axis] > longest ? high[axis] - low[axis] : longest;
    for (int axis = 0; axis < 3; axis++) {
        float size = high[axis] - low[axis], per_unit, cost;
        int cut = 0;
        if (!(size * SBI_SURFACE_NO_LIMIT > (float)SBI_SURFACE_BINS))
            continue; /* flat */
        per_unit = (float)SBI_SURFACE_BINS / size;
        if (end - begin > SBI_SURFACE_MANY && size < longest)
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
    b->box = (float(*)[8])sbi_alloc(allocator, n, sizeof *b->box);
    b->order = (int *)sbi_alloc(allocator, n, sizeof(int));
    b->child = (int(*)[SBI_SURFACE_WIDTH])sbi_alloc(allocator, n, sizeof *b->child);
    b->slot = (int *)sbi_alloc(allocator, n, sizeof(int));
    b->leaf = (int(*)[2])sbi_alloc(allocator, n, sizeof *b->leaf);
    return b->box && b->order && b->child && b->slot && b->leaf;
}

/* Box around the triangles; 0 when its size is not finite. */
static int sbi_surface_extent(const sb_mesh *triangles, sb_vec3 *low, sb_vec3 *high)
{
    *low = *high = triangles->nodes[triangles->elements[0]];
    for (size_t i = 0; i < 3 * (size_t)triangles->element_count; i++) {
        sb_vec3 x = triangles->nodes[triangles->elements[i]];
        *low = sb_v3(sb_min(low->x, x.x), sb_min(low->y, x.y), sb_min(low->z, x.z));
        *high = sb_v3(sb_max(high->x, x.x), sb_max(high->y, x.y), sb_max(high->z, x.z));
    }
    return sb_v3_is_finite(sb_v3_sub(*high, *low));
}

/* Boxes in units of about the surface's size, which float can hold. */
static void sbi_surface_build_boxes(const sb_mesh *triangles, sbi_surface_build *b)
{
    sb_vec3 low, high;
    sb_real side[3], scale = 1, inverse = 1, size;
    sbi_surface_extent(triangles, &low, &high);
    side[0] = high.x - low.x, side[1] = high.y - low.y, side[2] = high.z - low.z;
    size = sbi_dense_max_abs(side, 3);
    if (size > 0)
        sbi_dense_scale(size, &scale, &inverse);
    for (int t = 0; t < b->count; t++) {
        const int *nodes = triangles->elements + 3 * (size_t)t;
        float *box = b->box[t];
        box[3] = box[7] = 0.0f;
        for (int i = 0; i < 3; i++) {
            sb_vec3 x = sb_v3_scale(scale, sb_v3_sub(triangles->nodes[nodes[i]], low));
            float p[3];
            p[0] = (float)x.x, p[1] = (float)x.y, p[2] = (float)x.z;
            for (int axis = 0; axis < 3; axis++) {
                box[axis] = i == 0 || p[axis] < box[axis] ? p[axis] : box[axis];
                box[axis + 4] = i == 0 || p[axis] > box[axis + 4] ? p[axis] : box[axis + 4];
            }
        }
        b->order[t] = t;
    }
}

/* ---- creation ------------------------------------------------------------------------------------------------ */

/* Sizes and, with arena->base, places of all arrays; leaves and tree counts are known. */
static sb_surface *sbi_surface_layout(const sb_surface *size, sbi_arena *arena)
{
    size_t nodes = (size_t)size->node_count, triangles = (size_t)size->triangle_count;
    size_t tree = (size_t)size->tree_count, leaves = (size_t)size->leaf_count;
    sb_surface made = *size, *s = (sb_surface *)sbi_arena_take(arena, 1, sizeof *s);
    made.tree = (sbi_surface_node *)sbi_arena_take(arena, tree, sizeof *made.tree);
    made.cluster = (sbi_surface_cluster *)sbi_arena_take(arena, tree, sizeof *made.cluster);
    made.leaf = (sbi_surface_leaf *)sbi_arena_take(arena, leaves, sizeof *made.leaf);
    made.exact = (sb_vec3(*)[3])sbi_arena_take(arena, SBI_SURFACE_WIDTH * leaves, sizeof *made.exact);
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
            s->leaf[i].triangle[k] = k < count ? b->order[begin + k] : SBI_SURFACE_NO_TRIANGLE;
    }
}

static int sbi_surface_ascends(const int nodes[3], int edge) { return nodes[edge] < nodes[(edge + 1) % 3]; }

/* Neighbours across edges, and how many edges are out of balance. `edges`: those of triangles with three different
 * nodes; the others have non-manifold edges all round. */
static void sbi_surface_find_mates(sb_surface *s, const sbi_mesh_keys *edges)
{
    for (int t = 0; t < s->triangle_count; t++)
        for (int i = 0; i < 3; i++)
            s->mate[t][i] = SBI_SURFACE_NONMANIFOLD;
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

/* A node is pinched when its triangles are not one fan, or an edge there is non-manifold. */
static void sbi_surface_find_pinched(sb_surface *s)
{
    for (int v = 0; v < s->node_count; v++) {
        int begin = s->fan_start[v], count = s->fan_start[v + 1] - begin;
        s->pinched[v] = 0;
        for (int i = begin; i < begin + count && !s->pinched[v]; i++) {
            const int *mate = s->mate[s->fan[i] / 3];
            s->pinched[v] = mate[s->fan[i] % 3] == SBI_SURFACE_NONMANIFOLD ||
                            mate[(s->fan[i] % 3 + 2) % 3] == SBI_SURFACE_NONMANIFOLD;
        }
        if (count > 0 && !s->pinched[v])
            s->pinched[v] = sbi_surface_turn(s, s->fan[begin] / 3, s->fan[begin] % 3, count) < count;
    }
}

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
    size.bytes = arena.used + SBI_SURFACE_LINE;
    size.block = arena.overflow ? NULL : sbi_alloc(allocator, size.bytes, 1);
    if (!size.block)
        return NULL;
    arena.base = (unsigned char *)size.block + (SBI_SURFACE_LINE - (uintptr_t)size.block % SBI_SURFACE_LINE);
    arena.used = 0;
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

SBI_API void sbi_surface_cut_free(const sb_allocator *allocator, sbi_surface_cut *cut)
{
    sbi_free(allocator, cut->corners);
    sbi_free(allocator, cut->element);
}

SBI_API sb_result sbi_surface_cut_make(const sb_mesh *mesh, const sb_allocator *allocator, sbi_surface_cut *cut,
                                       sb_error *error)
{
    sb_vec3 low, high;
    int per = 0;
    sb_result result = sbi_surface_check_mesh(mesh, &per, error);
    memset(cut, 0, sizeof *cut);
    if (result != SB_OK)
        return result;
    if (!sbi_surface_cut_faces(mesh, allocator, per, cut))
        result = sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a surface of %d faces", mesh->element_count);
    else if (!sbi_surface_extent(&cut->triangles, &low, &high))
        result = sbi_surface_fail_extent(error);
    if (result != SB_OK)
        sbi_surface_cut_free(allocator, cut);
    return result;
}

SB_API sb_result sb_surface_create(const sb_mesh *mesh, const sb_allocator *allocator, sb_surface **surface,
                                   sb_error *error)
{
    sbi_surface_cut cut;
    sb_surface *made;
    sb_result result;
    if (!surface)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "surface is NULL");
    result = sbi_surface_cut_make(mesh, allocator, &cut, error);
    if (result != SB_OK)
        return result;
    made = sbi_surface_from_cut(&cut, allocator);
    sbi_surface_cut_free(allocator, &cut);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a surface of %d faces", mesh->element_count);
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
    sbi_free(&allocator, surface->block);
}

/* ---- what it is made of -------------------------------------------------------------------------------------- */

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
