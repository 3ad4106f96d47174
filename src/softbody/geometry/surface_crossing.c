/* surface_crossing: pairs of triangles that pass through each other or overlap in a plane.
 *
 * Each triangle looks for partners in the tree of boxes; what its plane, or the coin round a branch, keeps apart is
 * left out. Three kinds of surface would still make that quadratic, and each has its own answer:
 *
 *   fans       hundreds of triangles round one node: all boxes meet there. Two triangles that share that node only
 *              cross where their arcs do, seen from the node: a tree over the arcs finds the pairs
 *   wide ones  a triangle with hundreds of small ones on it: put off, then the small ones look for the few wide ones
 *   crowds     hundreds on hundreds, coincident or stacked closer than float boxes can tell apart: when they cross,
 *              counting ends after SBI_CROSSING_PAIRS for each triangle; when they do not, the search gives up and
 *              says so (SB_SURFACE_CROWDED) */
#include "surface_tree.h"

/* ---- triangles that cross ------------------------------------------------------------------------------------ */

/* A triangle against the plane of another: signed distances of its corners times the plane's normal's length, 0 where
 * they are rounding or the corner is one of the other's. */
typedef struct sbi_crossing_side {
    sb_vec3 x[3], normal;
    sb_real height[3];
    int below, above; /* corners on either side */
} sbi_crossing_side;

static sb_real sbi_crossing_size(const sbi_crossing_side *side)
{
    sb_real longest = 0;
    for (int i = 0; i < 3; i++)
        longest = sb_max(longest, sb_v3_norm(sb_v3_sub(side->x[(i + 1) % 3], side->x[i])));
    return longest;
}

/* Heights of the corners of `of` over the plane of `plane`. */
static void sbi_crossing_heights(const sb_surface *s, int plane_triangle, const sbi_crossing_side *plane, int triangle,
                                 sbi_crossing_side *of, sb_real size)
{
    sb_real rounding = 32 * SB_EPSILON * size * sb_v3_norm(plane->normal);
    const int *nodes = s->corners[triangle], *others = s->corners[plane_triangle];
    of->below = of->above = 0;
    for (int i = 0; i < 3; i++) {
        sb_real height = sb_v3_dot(plane->normal, sb_v3_sub(of->x[i], plane->x[0]));
        int shared = nodes[i] == others[0] || nodes[i] == others[1] || nodes[i] == others[2];
        if (shared || sb_abs(height) <= rounding)
            height = 0;
        of->height[i] = height;
        of->below += height < 0;
        of->above += height > 0;
    }
}

/* The piece of the common line of both planes that is inside the triangle, along `axis`. */
static void sbi_crossing_interval(const sbi_crossing_side *side, int axis, sb_real *low, sb_real *high)
{
    int count = 0;
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3;
        sb_real a = side->height[i], b = side->height[j], at;
        sb_real x = axis == 0 ? side->x[i].x : axis == 1 ? side->x[i].y : side->x[i].z;
        sb_real y = axis == 0 ? side->x[j].x : axis == 1 ? side->x[j].y : side->x[j].z;
        if (a == 0)
            at = x;
        else if ((a < 0 && b > 0) || (a > 0 && b < 0))
            at = x + (y - x) * (a / (a - b));
        else
            continue;
        *low = count == 0 ? at : sb_min(*low, at);
        *high = count == 0 ? at : sb_max(*high, at);
        count++;
    }
}

static int sbi_crossing_largest(sb_vec3 v)
{
    sb_real x = sb_abs(v.x), y = sb_abs(v.y), z = sb_abs(v.z);
    return x > y ? (x > z ? 0 : 2) : (y > z ? 1 : 2);
}

/* 1 when no corner of `b` is beyond edge i of `a` on the inner side, in the plane of `normal` (that of a). */
static int sbi_crossing_edge_separates(const sbi_crossing_side *a, const sbi_crossing_side *b, sb_vec3 normal,
                                       sb_real tolerance)
{
    for (int i = 0; i < 3; i++) {
        sb_vec3 edge = sb_v3_sub(a->x[(i + 1) % 3], a->x[i]), inward = sb_v3_cross(normal, edge);
        sb_real least = tolerance * sb_v3_norm(inward);
        int inside = 0;
        for (int k = 0; k < 3; k++)
            inside += sb_v3_dot(inward, sb_v3_sub(b->x[k], a->x[i])) > least;
        if (inside == 0)
            return 1;
    }
    return 0;
}

/* Moeller 1997: two triangles cross when each has corners strictly on both sides of the other's plane and their pieces
 * of the common line overlap; in one plane they overlap when no edge separates them. Overlaps within rounding count as
 * touching. */
static int sbi_crossing_test(const sb_surface *s, int t, int u)
{
    sbi_crossing_side a, b;
    sb_real size, tolerance, low[2] = {0, 0}, high[2] = {0, 0};
    int axis;
    if (s->shape[t] == SBI_SURFACE_FLAT || s->shape[u] == SBI_SURFACE_FLAT)
        return 0;
    sbi_surface_corners(s, t, a.x);
    sbi_surface_corners(s, u, b.x);
    a.normal = sbi_surface_area_vector(a.x);
    b.normal = sbi_surface_area_vector(b.x);
    size = sb_max(sbi_crossing_size(&a), sbi_crossing_size(&b));
    tolerance = sb_sqrt(SB_EPSILON) * size;
    sbi_crossing_heights(s, t, &a, u, &b, size);
    if (b.below + b.above == 0)
        return !sbi_crossing_edge_separates(&a, &b, a.normal, tolerance) &&
               !sbi_crossing_edge_separates(&b, &a, b.normal, tolerance);
    sbi_crossing_heights(s, u, &b, t, &a, size);
    if (!a.below || !a.above || !b.below || !b.above)
        return 0;
    axis = sbi_crossing_largest(sb_v3_cross(a.normal, b.normal));
    sbi_crossing_interval(&a, axis, low, high);
    sbi_crossing_interval(&b, axis, low + 1, high + 1);
    return sb_min(high[0], high[1]) - sb_max(low[0], low[1]) > tolerance;
}

static int sbi_crossing_same_corners(const sb_surface *s, int t, int u)
{
    int shared = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            shared += s->corners[t][i] == s->corners[u][j];
    return shared >= 3;
}

/* ---- the search ---------------------------------------------------------------------------------------------- */

enum {
    SBI_CROSSING_STEPS = 256, /* boxes and pairs looked at from one triangle before it is put off; usual are 30 */
    SBI_CROSSING_FAN = 64,    /* triangles round a node that make it a hub */
    SBI_CROSSING_PAIRS = 16,  /* pairs for each triangle that are counted, */
    SBI_CROSSING_MORE = 1024  /* and so many more */
};

/* What lasts over a search. */
typedef struct sbi_crossing {
    const sb_surface *s;
    const sb_allocator *allocator;
    unsigned char *crossing; /* [triangles] 1: crosses another; or NULL */
    sb_surface_place *crossings, *crowds;
    int *hub;    /* [triangles] the corner with most triangles round it, if these are many, or -1 */
    int most;    /* pairs after which counting ends */
    int partial; /* 1: pairs may be missing */
} sbi_crossing;

/* A tree to look in, of the surface, of the arcs round a hub, or of wide triangles of these. */
typedef struct sbi_crossing_tree {
    const sb_surface *tree;
    const int *names;                     /* [tree triangles] number in the surface, ascending; NULL: the same */
    int (*branch_hub)[SBI_SURFACE_WIDTH]; /* [tree nodes] hub of all triangles below, or -1; NULL: unknown */
    int skips_fans;                       /* 1: pairs of one hub are found elsewhere */
} sbi_crossing_tree;

/* One triangle that looks for partners, in local coordinates of the tree. */
typedef struct sbi_crossing_seeker {
    int name;     /* in the surface */
    int is_after; /* looks for partners with lower numbers; else for those with higher ones */
    int hub;      /* whose triangles are left out; -1: none */
    int steps;
    float corner[3][3], low[3], high[3], normal[3], offset;
} sbi_crossing_seeker;

static int sbi_crossing_name(const sbi_crossing_tree *in, int triangle)
{
    return in->names ? in->names[triangle] : triangle;
}

static float sbi_crossing_dot(const float a[3], const float b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* x: corners in the units that the tree was made in. A triangle without a plane has the normal 0. */
static void sbi_crossing_seek_from(const sb_surface *tree, const sb_vec3 corners[3], sbi_crossing_seeker *seeker)
{
    sb_vec3 x[3], normal;
    sb_real length;
    for (int i = 0; i < 3; i++) {
        x[i] = sb_v3_scale(tree->scale, corners[i]);
        sbi_surface_to_local(tree, x[i], seeker->corner[i]);
    }
    sbi_surface_box_of(tree, x, seeker->low, seeker->high);
    normal = sbi_surface_area_vector(x);
    length = sbi_surface_slimness(x) > sb_sqrt(SB_EPSILON) ? sb_v3_norm(normal) : 0;
    normal = length > 0 ? sb_v3_scale((sb_real)1 / length, normal) : sb_v3(0, 0, 0);
    seeker->normal[0] = (float)normal.x;
    seeker->normal[1] = (float)normal.y;
    seeker->normal[2] = (float)normal.z;
    seeker->offset = sbi_crossing_dot(seeker->normal, seeker->corner[0]);
}

/* Whether the seeker's plane passes child k of a node by. */
static int sbi_crossing_plane_misses(const sbi_surface_node *node, int k, const sbi_crossing_seeker *seeker)
{
    float height = -seeker->offset, reach = SBI_SURFACE_SLACK;
    for (int axis = 0; axis < 3; axis++) {
        float n = seeker->normal[axis], half = 0.5f * (node->high[axis][k] - node->low[axis][k]);
        height += n * 0.5f * (node->high[axis][k] + node->low[axis][k]);
        reach += (n < 0 ? -n : n) * half;
    }
    return height > reach || height < -reach;
}

/* Whether the coin of child k lies on one side of the seeker. */
static int sbi_crossing_coin_misses(const sbi_surface_node *node, int k, const sbi_crossing_seeker *seeker)
{
    float thickness = node->coin[SBI_COIN_THICKNESS][k] + SBI_SURFACE_SLACK;
    int below = 0, above = 0;
    for (int i = 0; i < 3; i++) {
        float height = 0;
        for (int axis = 0; axis < 3; axis++)
            height += node->coin[SBI_COIN_NORMAL + axis][k] *
                      (seeker->corner[i][axis] - node->coin[SBI_COIN_CENTRE + axis][k]);
        below += height < -thickness;
        above += height > thickness;
    }
    return below == 3 || above == 3;
}

static int sbi_crossing_boxes_meet(const sbi_surface_node *node, int k, const sbi_crossing_seeker *seeker)
{
    for (int axis = 0; axis < 3; axis++)
        if (node->low[axis][k] > seeker->high[axis] || node->high[axis][k] < seeker->low[axis])
            return 0;
    return !sbi_crossing_plane_misses(node, k, seeker) && !sbi_crossing_coin_misses(node, k, seeker);
}

static void sbi_crossing_leaf(const sbi_crossing *c, const sbi_crossing_tree *in, int leaf_number,
                              sbi_crossing_seeker *seeker)
{
    const sb_surface *s = c->s;
    const sbi_surface_leaf *leaf = in->tree->leaf + leaf_number;
    for (int k = 0; k < SBI_SURFACE_WIDTH && leaf->triangle[k] != SBI_SURFACE_NO_TRIANGLE; k++) {
        int other = sbi_crossing_name(in, sbi_surface_leaf_triangle(leaf, k)), t = seeker->name;
        if (other == t || (other < t) != seeker->is_after || s->element[other] == s->element[t] ||
            (seeker->hub >= 0 && c->hub[other] == seeker->hub))
            continue;
        seeker->steps++;
        if (sbi_crossing_same_corners(s, t, other) || !sbi_crossing_test(s, t, other))
            continue;
        if (c->crossing)
            c->crossing[t] = c->crossing[other] = 1;
        if (c->crossings->count++ == 0) {
            c->crossings->element = s->element[sbi_min_int(t, other)];
            c->crossings->other_element = s->element[sbi_max_int(t, other)];
        }
    }
}

/* Looks for all partners; 0 when it gave up. */
static int sbi_crossing_seek(const sbi_crossing *c, const sbi_crossing_tree *in, sbi_crossing_seeker *seeker)
{
    int stack[SBI_SURFACE_STACK + SBI_SURFACE_WIDTH], top = 0;
    seeker->steps = 0;
    stack[top++] = 0;
    while (top > 0) {
        int child = stack[--top];
        if (++seeker->steps > SBI_CROSSING_STEPS)
            return 0;
        if (child < 0) {
            sbi_crossing_leaf(c, in, ~child, seeker);
            continue;
        }
        for (int k = 0; k < SBI_SURFACE_WIDTH; k++)
            if ((seeker->hub < 0 || !in->branch_hub || in->branch_hub[child][k] != seeker->hub) &&
                sbi_crossing_boxes_meet(in->tree->tree + child, k, seeker))
                stack[top++] = in->tree->tree[child].child[k];
    }
    return 1;
}

/* A surface of some triangles of another: wide[count] are their numbers there. In the units of its nodes as it holds
 * them. NULL: no memory. */
static sb_surface *sbi_crossing_subset(const sbi_crossing *c, const sb_surface *of, const int *wide, int count)
{
    sb_mesh mesh;
    sb_surface *made = NULL;
    memset(&mesh, 0, sizeof mesh);
    mesh.element_type = SB_TRI3;
    mesh.nodes = of->nodes;
    mesh.node_count = of->node_count;
    mesh.element_count = count;
    mesh.elements = (int *)sbi_alloc(c->allocator, (size_t)count, 3 * sizeof(int));
    for (int i = 0; mesh.elements && i < count; i++)
        memcpy(mesh.elements + 3 * (size_t)i, of->corners[wide[i]], 3 * sizeof(int));
    if (mesh.elements && sb_surface_create(&mesh, c->allocator, &made, NULL) != SB_OK)
        made = NULL;
    sbi_free(c->allocator, mesh.elements);
    return made;
}

static int sbi_crossing_is_full(const sbi_crossing *c) { return c->crossings->count >= c->most; }

/* All triangles of a tree look among the wide ones, which come before them. */
static int sbi_crossing_among_wide(sbi_crossing *c, const sbi_crossing_tree *in, int *wide, int count)
{
    sb_surface *subset = sbi_crossing_subset(c, in->tree, wide, count);
    sbi_crossing_tree among;
    int before;
    if (!subset)
        return 0;
    for (int i = 0; i < count; i++)
        wide[i] = sbi_crossing_name(in, wide[i]);
    among.tree = subset;
    among.names = wide;
    among.branch_hub = NULL;
    among.skips_fans = in->skips_fans;
    for (int i = 0; i < in->tree->triangle_count && !sbi_crossing_is_full(c); i++) {
        sbi_crossing_seeker seeker;
        sb_vec3 x[3];
        sbi_surface_corners(in->tree, i, x);
        sbi_crossing_seek_from(subset, x, &seeker);
        seeker.name = sbi_crossing_name(in, i);
        seeker.is_after = 1;
        seeker.hub = in->skips_fans ? c->hub[seeker.name] : -1;
        before = c->crossings->count;
        if (c->s->shape[seeker.name] == SBI_SURFACE_FLAT || sbi_crossing_seek(c, &among, &seeker))
            continue;
        c->partial = 1;
        if (c->crossings->count == before && c->crowds->count++ == 0)
            c->crowds->element = c->s->element[seeker.name];
    }
    sb_surface_destroy(subset);
    return 1;
}

/* Finds all pairs in a tree. 0: no memory. */
static int sbi_crossing_all(sbi_crossing *c, const sbi_crossing_tree *in)
{
    const sb_surface *tree = in->tree;
    int *wide = (int *)sbi_alloc(c->allocator, (size_t)tree->triangle_count, sizeof(int));
    int count = 0, made = wide != NULL;
    for (int i = 0; wide && i < tree->triangle_count && !sbi_crossing_is_full(c); i++) {
        sb_surface_place before = *c->crossings;
        sbi_crossing_seeker seeker;
        sb_vec3 x[3];
        sbi_surface_corners(tree, i, x);
        for (int k = 0; k < 3; k++)
            x[k] = sb_v3_scale(tree->inverse, x[k]);
        sbi_crossing_seek_from(tree, x, &seeker);
        seeker.name = sbi_crossing_name(in, i);
        seeker.is_after = 0;
        seeker.hub = in->skips_fans ? c->hub[seeker.name] : -1;
        if (c->s->shape[seeker.name] == SBI_SURFACE_FLAT || sbi_crossing_seek(c, in, &seeker))
            continue;
        if (c->crossings->count - before.count >= SBI_CROSSING_PAIRS) {
            c->partial = 1; /* enough is known of this one */
            continue;
        }
        *c->crossings = before; /* its pairs are found again from the other side */
        wide[count++] = i;
    }
    if (count > 0 && !sbi_crossing_is_full(c))
        made = sbi_crossing_among_wide(c, in, wide, count);
    sbi_free(c->allocator, wide);
    return made;
}

/* ---- fans ---------------------------------------------------------------------------------------------------- */

/* Labels triangles with their hubs. */
static void sbi_crossing_find_hubs(const sb_surface *s, int *hub)
{
    for (int t = 0; t < s->triangle_count; t++) {
        int most = SBI_CROSSING_FAN;
        hub[t] = -1;
        for (int i = 0; i < 3; i++) {
            int v = s->corners[t][i], count = s->fan_start[v + 1] - s->fan_start[v];
            if (count > most)
                most = count, hub[t] = v;
        }
    }
}

static int sbi_crossing_leaf_hub(const sb_surface *s, const int *hub, int leaf_number)
{
    const sbi_surface_leaf *leaf = s->leaf + leaf_number;
    int common = hub[sbi_surface_leaf_triangle(leaf, 0)];
    for (int k = 1; k < SBI_SURFACE_WIDTH && leaf->triangle[k] != SBI_SURFACE_NO_TRIANGLE; k++)
        common = hub[sbi_surface_leaf_triangle(leaf, k)] == common ? common : -1;
    return common;
}

static void sbi_crossing_label_branches(const sb_surface *s, const int *hub, int (*branch_hub)[SBI_SURFACE_WIDTH])
{
    for (int i = s->tree_count - 1; i >= 0; i--) { /* children come after their parents */
        for (int k = 0; k < SBI_SURFACE_WIDTH; k++) {
            int child = s->tree[i].child[k], count = sbi_surface_child_count(s->tree + i), common;
            branch_hub[i][k] = -1;
            if (k >= count)
                continue;
            common = child < 0 ? sbi_crossing_leaf_hub(s, hub, ~child) : branch_hub[child][0];
            for (int j = 1; child >= 0 && j < sbi_surface_child_count(s->tree + child); j++)
                common = branch_hub[child][j] == common ? common : -1;
            branch_hub[i][k] = common;
        }
    }
}

/* A triangle round the arc that a triangle covers on the unit sphere round one of its corners, in the plane of both:
 * the ends of the arc and where the tangents there meet. Arcs near a half circle get one round the whole sphere. */
static void sbi_crossing_arc(const sb_surface *s, int triangle, int hub, sb_vec3 arc[3])
{
    sb_vec3 x[3], end[2], middle;
    sb_real length;
    int corner = s->corners[triangle][0] == hub ? 0 : s->corners[triangle][1] == hub ? 1 : 2;
    sbi_surface_corners(s, triangle, x);
    for (int i = 0; i < 2; i++) {
        end[i] = sb_v3_sub(x[(corner + 1 + i) % 3], x[corner]);
        length = sb_v3_norm(end[i]);
        end[i] = length > 0 ? sb_v3_scale((sb_real)1 / length, end[i]) : sb_v3(0, 0, 0);
    }
    middle = sb_v3_scale((sb_real)0.5, sb_v3_add(end[0], end[1]));
    length = sb_v3_dot(middle, middle); /* squared cosine of half the angle */
    arc[0] = end[0], arc[1] = end[1];
    arc[2] = length > 0 ? sb_v3_scale((sb_real)1 / length, middle) : middle;
    if (length < (sb_real)0.05)
        arc[0] = sb_v3(-1, -1, -1), arc[1] = sb_v3(1, 1, -1), arc[2] = sb_v3(1, -1, 1);
}

/* Finds the pairs among fan[count], the triangles of one hub. 0: no memory. */
static int sbi_crossing_fan(sbi_crossing *c, int hub, const int *fan, int count)
{
    sb_surface *arcs = NULL;
    sb_mesh mesh;
    int made = 0;
    memset(&mesh, 0, sizeof mesh);
    mesh.element_type = SB_TRI3;
    mesh.element_count = count;
    mesh.node_count = 3 * count;
    mesh.nodes = (sb_vec3 *)sbi_alloc(c->allocator, (size_t)mesh.node_count, sizeof(sb_vec3));
    mesh.elements = (int *)sbi_alloc(c->allocator, (size_t)mesh.node_count, sizeof(int));
    if (mesh.nodes && mesh.elements) {
        for (int i = 0; i < count; i++)
            sbi_crossing_arc(c->s, fan[i], hub, mesh.nodes + 3 * (size_t)i);
        for (int i = 0; i < mesh.node_count; i++)
            mesh.elements[i] = i;
        if (sb_surface_create(&mesh, c->allocator, &arcs, NULL) == SB_OK) {
            sbi_crossing_tree in = {NULL, NULL, NULL, 0};
            in.tree = arcs;
            in.names = fan;
            made = sbi_crossing_all(c, &in);
            sb_surface_destroy(arcs);
        }
    }
    sbi_free(c->allocator, mesh.nodes);
    sbi_free(c->allocator, mesh.elements);
    return made;
}

static int sbi_crossing_fans(sbi_crossing *c, int *fan)
{
    const sb_surface *s = c->s;
    for (int v = 0; v < s->node_count && !sbi_crossing_is_full(c); v++) {
        int count = 0;
        if (s->fan_start[v + 1] - s->fan_start[v] <= SBI_CROSSING_FAN)
            continue;
        for (int i = s->fan_start[v]; i < s->fan_start[v + 1]; i++) {
            int t = s->fan[i] / 3;
            if (c->hub[t] == v && s->shape[t] != SBI_SURFACE_FLAT && (count == 0 || fan[count - 1] != t))
                fan[count++] = t;
        }
        if (count > 1 && !sbi_crossing_fan(c, v, fan, count))
            return 0;
    }
    return 1;
}

/* ---- results ------------------------------------------------------------------------------------------------- */

SBI_API int sbi_surface_find_crossings(const sb_surface *s, const sb_allocator *allocator, sb_surface_place *crossings,
                                       sb_surface_place *crowds, unsigned char *crossing)
{
    size_t triangles = (size_t)s->triangle_count;
    int *fan = (int *)sbi_alloc(allocator, triangles, sizeof(int)), made = 0;
    sbi_crossing_tree in;
    sbi_crossing c;
    memset(&c, 0, sizeof c);
    memset(&in, 0, sizeof in);
    c.s = in.tree = s;
    c.allocator = allocator;
    c.crossing = crossing;
    c.crossings = crossings;
    c.crowds = crowds;
    c.most = s->triangle_count < (INT_MAX - SBI_CROSSING_MORE) / SBI_CROSSING_PAIRS
                 ? SBI_CROSSING_PAIRS * s->triangle_count + SBI_CROSSING_MORE
                 : INT_MAX;
    c.hub = (int *)sbi_alloc(allocator, triangles, sizeof(int));
    in.branch_hub = (int(*)[SBI_SURFACE_WIDTH])sbi_alloc(allocator, (size_t)s->tree_count, sizeof *in.branch_hub);
    in.skips_fans = 1;
    if (fan && c.hub && in.branch_hub) {
        sbi_crossing_find_hubs(s, c.hub);
        sbi_crossing_label_branches(s, c.hub, in.branch_hub);
        made = sbi_crossing_all(&c, &in) && sbi_crossing_fans(&c, fan);
    }
    sbi_free(allocator, fan);
    sbi_free(allocator, c.hub);
    sbi_free(allocator, in.branch_hub);
    return !made ? -1 : sbi_crossing_is_full(&c) || c.partial;
}

/* Whether the winding number just off the middle of a triangle, on both sides, contradicts its orientation. */
static int sbi_crossing_is_hidden(const sb_surface *s, int triangle)
{
    sb_vec3 x[3], middle, normal;
    sb_real length;
    sbi_surface_corners(s, triangle, x);
    normal = sb_v3_cross(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0]));
    length = sb_v3_norm(normal);
    if (!(length > 0))
        return 1;
    normal = sb_v3_scale((sb_real)1e-3 / sb_sqrt(length), normal); /* a thousandth of the triangle's size */
    middle = sb_v3_scale((sb_real)(1.0 / 3), sb_v3_add(x[0], sb_v3_add(x[1], x[2])));
    return sbi_surface_winding(s, sb_v3_add(middle, normal)) >= 0.5 ||
           sbi_surface_winding(s, sb_v3_sub(middle, normal)) < 0.5;
}

SBI_API int sbi_surface_find_doubtful(const sb_surface *surface, unsigned char *doubtful)
{
    sb_surface_place crossings, crowds;
    int partial;
    memset(&crossings, 0, sizeof crossings);
    memset(&crowds, 0, sizeof crowds);
    memset(doubtful, 0, (size_t)surface->triangle_count);
    partial = sbi_surface_find_crossings(surface, &surface->allocator, &crossings, &crowds, doubtful);
    if (partial < 0)
        return -1;
    if (partial) /* any triangle may cross what was not looked at */
        memset(doubtful, 1, (size_t)surface->triangle_count);
    for (int t = 0; t < surface->triangle_count && !partial && crossings.count > 0; t++)
        doubtful[t] = doubtful[t] || sbi_crossing_is_hidden(surface, t);
    return partial || crossings.count > 0;
}

/* ---- inside out ---------------------------------------------------------------------------------------------- */

/* Whether the winding number just off the middle of a triangle is negative on the side that its normal points to, and
 * nothing is inside on the other side. */
static int sbi_inside_out_looks_inward(const sb_surface *s, int triangle)
{
    sb_vec3 x[3], middle, off;
    sb_real size;
    if (s->shape[triangle] == SBI_SURFACE_FLAT)
        return 0;
    sbi_surface_corners(s, triangle, x);
    size = sb_sqrt(sb_v3_norm(sbi_surface_area_vector(x)));
    middle = sb_v3_scale((sb_real)(1.0 / 3), sb_v3_add(x[0], sb_v3_add(x[1], x[2])));
    off = sb_v3_scale(sb_sqrt(SB_EPSILON) * size, sbi_surface_unit_normal(s, triangle));
    return sbi_surface_winding(s, sb_v3_add(middle, off)) < -0.6 &&
           sbi_surface_winding(s, sb_v3_sub(middle, off)) < 0.4;
}

/* Lists the triangles that share nodes with list[0], each marked; returns how many. */
static int sbi_inside_out_part(const sb_surface *s, int *list, unsigned char *mark)
{
    int count = 1;
    mark[list[0]] = 1;
    for (int k = 0; k < count; k++)
        for (int i = 0; i < 3; i++) {
            int v = s->corners[list[k]][i], begin = s->fan_start[v], end = s->fan_start[v + 1];
            if (mark[s->fan[begin] / 3] && mark[s->fan[end - 1] / 3])
                continue; /* a fan is taken as a whole */
            for (int j = begin; j < end; j++) {
                int t = s->fan[j] / 3;
                if (!mark[t])
                    mark[t] = 1, list[count++] = t;
            }
        }
    return count;
}

/* Outside a solid the winding number is 0, in front of the wall of a cavity too. -1 there means that the part looks
 * inward; open sheets stay above. */
SBI_API int sbi_surface_find_inside_out(const sb_surface *s, const sb_allocator *allocator, int *triangle)
{
    enum { ASKED = 9 };
    int *list = (int *)sbi_alloc(allocator, (size_t)s->triangle_count, sizeof(int));
    unsigned char *mark = (unsigned char *)sbi_alloc_zeroed(allocator, (size_t)s->triangle_count, 1);
    *triangle = -1;
    for (int t = 0; list && mark && t < s->triangle_count && *triangle < 0; t++) {
        int count, asked, inward = 0;
        if (mark[t])
            continue;
        list[0] = t;
        count = sbi_inside_out_part(s, list, mark);
        asked = sbi_min_int(count, ASKED);
        for (int k = 0; k < asked; k++)
            inward += sbi_inside_out_looks_inward(s, list[(size_t)k * (size_t)count / (size_t)asked]);
        if (2 * inward > asked)
            *triangle = t;
    }
    sbi_free(allocator, list);
    sbi_free(allocator, mark);
    return list && mark;
}
