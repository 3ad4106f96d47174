/* cloud: making, normals, thinning, outliers. Files are in cloud_file.c. */
#include "cloud.h"

#include "../softbody/mesh/meshio_reader.h"
#include "../softbody/geometry/surface.h"

/* ==== making ====================================================================================================== */

REG_API void reg_cloud_free(reg_cloud *cloud)
{
    if (!cloud)
        return;
    sbi_free(&cloud->allocator, cloud->points);
    sbi_free(&cloud->allocator, cloud->normals);
    memset(cloud, 0, sizeof *cloud);
}

REGI_API sb_result regi_cloud_allocate(reg_cloud *cloud, int count, int with_normals, const sb_allocator *allocator,
                                       sb_error *error)
{
    memset(cloud, 0, sizeof *cloud);
    if (allocator)
        cloud->allocator = *allocator;
    cloud->count = count;
    cloud->points = (sb_vec3 *)sbi_alloc(allocator, (size_t)count, sizeof(sb_vec3));
    if (cloud->points && with_normals)
        cloud->normals = (sb_vec3 *)sbi_alloc(allocator, (size_t)count, sizeof(sb_vec3));
    if (cloud->points && (cloud->normals || !with_normals))
        return SB_OK;
    reg_cloud_free(cloud);
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a cloud of %d points", count);
}

/* By its largest entry first, so that squares stay in range. */
REGI_API sb_vec3 regi_cloud_unit(sb_vec3 v)
{
    sb_real size = sb_max(sb_abs(v.x), sb_max(sb_abs(v.y), sb_abs(v.z)));
    if (!(size > 0))
        return sb_v3(0, 0, 0);
    v = sb_v3(v.x / size, v.y / size, v.z / size);
    return sb_v3_scale(1 / sb_v3_norm(v), v);
}

REGI_API sb_result regi_cloud_check(const sb_vec3 *points, const sb_vec3 *normals, int count, sb_error *error)
{
    if (!points || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cloud needs at least one point, not %d", points ? count : 0);
    for (int i = 0; i < count; i++) {
        if (!sb_v3_is_finite(points[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d has a coordinate that is not finite", i);
        if (normals && !sb_v3_is_finite(normals[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "the normal of point %d is not finite", i);
    }
    return SB_OK;
}

REG_API sb_result reg_cloud_from_points(reg_cloud *cloud, const sb_vec3 *points, const sb_vec3 *normals, int count,
                                        const sb_allocator *allocator, sb_error *error)
{
    sb_result result = regi_cloud_check(points, normals, count, error);
    reg_cloud made;
    if (result != SB_OK)
        return result;
    if (!cloud)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "nowhere to put the cloud");
    result = regi_cloud_allocate(&made, count, normals != NULL, allocator, error);
    if (result != SB_OK)
        return result;
    memcpy(made.points, points, (size_t)count * sizeof points[0]);
    for (int i = 0; normals && i < count; i++)
        made.normals[i] = regi_cloud_unit(normals[i]);
    *cloud = made;
    return SB_OK;
}

/* Twice the area vectors of the triangles around, summed. */
REGI_API void regi_cloud_face_normals(const sbi_surface_cut *cut, sb_vec3 *normals)
{
    const sb_vec3 *x = cut->triangles.nodes;
    for (int i = 0; i < cut->triangles.node_count; i++)
        normals[i] = sb_v3(0, 0, 0);
    for (int t = 0; t < cut->triangles.element_count; t++) {
        const int *c = cut->triangles.elements + 3 * (size_t)t;
        sb_vec3 area = sb_v3_cross(sb_v3_sub(x[c[1]], x[c[0]]), sb_v3_sub(x[c[2]], x[c[0]]));
        for (int k = 0; k < 3; k++)
            normals[c[k]] = sb_v3_add(normals[c[k]], area);
    }
    for (int i = 0; i < cut->triangles.node_count; i++)
        normals[i] = regi_cloud_unit(normals[i]);
}

REG_API sb_result reg_cloud_from_mesh(reg_cloud *cloud, const sb_mesh *mesh, const sb_allocator *allocator,
                                      sb_error *error)
{
    sbi_surface_cut cut;
    reg_cloud made;
    sb_result result;
    if (!cloud || !mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", cloud ? "mesh" : "cloud");
    if (sb_element_dimension(mesh->element_type) == 3)
        return reg_cloud_from_points(cloud, mesh->nodes, NULL, mesh->node_count, allocator, error);
    result = sbi_surface_cut_make(mesh, allocator, &cut, error);
    if (result != SB_OK)
        return result;
    result = regi_cloud_allocate(&made, mesh->node_count, 1, allocator, error);
    if (result == SB_OK) {
        memcpy(made.points, mesh->nodes, (size_t)mesh->node_count * sizeof mesh->nodes[0]);
        regi_cloud_face_normals(&cut, made.normals);
        *cloud = made;
    }
    sbi_surface_cut_free(allocator, &cut);
    return result;
}

/* ==== outliers ==================================================================================================== */

/* Puts what belongs at `middle` there, nothing larger before it; the pivot is drawn, so that no order is slow. */
REGI_API sb_real regi_cloud_select(sb_real *v, int count, int middle)
{
    int low = 0, high = count - 1;
    uint32_t draw = 2463534242u;
    while (low < high) {
        int i = low, j = high;
        sb_real pivot;
        draw ^= draw << 13, draw ^= draw >> 17, draw ^= draw << 5;
        pivot = v[low + (int)(draw % (uint32_t)(high - low + 1))];
        while (i <= j) {
            while (v[i] < pivot)
                i++;
            while (pivot < v[j])
                j--;
            if (i <= j) {
                sb_real t = v[i];
                v[i++] = v[j];
                v[j--] = t;
            }
        }
        if (middle <= j)
            high = j;
        else if (middle >= i)
            low = i;
        else
            break;
    }
    return v[middle];
}

/* Running mean and sum of squares (Welford): exact for equal distances, so that the rule keeps them all. */
static sb_real regi_outlier_deviation(const sb_real *d, int count, sb_real parameter)
{
    sb_real mean = 0, squares = 0;
    for (int i = 0; i < count; i++) {
        sb_real step = d[i] - mean;
        mean += step / (sb_real)(i + 1);
        squares += step * (d[i] - mean);
    }
    return mean + parameter * sb_sqrt(sb_max(squares, 0) / (sb_real)count);
}

static sb_real regi_outlier_median(sb_real *d, int count, sb_real parameter)
{
    sb_real median = regi_cloud_select(d, count, (count - 1) / 2);
    for (int i = 0; i < count; i++)
        d[i] = sb_abs(d[i] - median);
    return median + parameter * (sb_real)1.4826 * regi_cloud_select(d, count, (count - 1) / 2);
}

REG_API sb_real reg_outlier_limit(const sb_real *distances, int count, reg_outliers rule, sb_real parameter,
                                  sb_real *scratch)
{
    int n = 0, kept;
    if (rule == REG_OUTLIERS_NONE)
        return SB_REAL_MAX;
    if (!distances || !scratch || !(parameter >= 0) || !sb_is_finite(parameter))
        return -1;
    for (int i = 0; i < count; i++)
        if (sb_is_finite(distances[i]))
            scratch[n++] = distances[i];
    if (n < 1)
        return -1;
    switch (rule) {
    case REG_OUTLIERS_DEVIATION: return regi_outlier_deviation(scratch, n, parameter);
    case REG_OUTLIERS_MEDIAN: return regi_outlier_median(scratch, n, parameter);
    case REG_OUTLIERS_TRIM:
        if (!(parameter > 0) || parameter > 1)
            return -1;
        kept = (int)(parameter * (sb_real)n + (sb_real)0.5);
        return regi_cloud_select(scratch, n, sbi_min_int(sbi_max_int(kept, 1), n) - 1);
    case REG_OUTLIERS_NONE: break;
    }
    return -1;
}

/* Mean distance of every point to its k nearest, itself left out; in the tree's order. */
static sb_result regi_cloud_spacing(const reg_cloud *cloud, const reg_kdtree *tree, int k, sb_real *spacing,
                                    sb_error *error)
{
    const sb_allocator *allocator = &cloud->allocator;
    size_t row = (size_t)k + 1;
    int *order = (int *)sbi_alloc(allocator, (size_t)cloud->count + row, sizeof(int));
    sb_real *squared = (sb_real *)sbi_alloc(allocator, row, sizeof(sb_real));
    sb_result result = order && squared ? SB_OK : sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d neighbours", k);
    if (result == SB_OK) {
        regi_kdtree_order(tree, order);
        for (int i = 0; i < cloud->count; i++) {
            int at = order[i], *nearest = order + cloud->count;
            int found = reg_kdtree_k_nearest(tree, cloud->points[at], k + 1, nearest, squared);
            sb_real sum = 0;
            for (int j = 1; j < found; j++) /* at 0 is the point itself or one in the same place */
                sum += sb_sqrt(squared[j]);
            spacing[at] = found > 1 ? sum / (sb_real)(found - 1) : 0;
        }
    }
    sbi_free(allocator, order);
    sbi_free(allocator, squared);
    return result;
}

/* Keeps the points whose value is at most the limit, in place; returns how many. The arrays keep their size. */
static int regi_cloud_keep(reg_cloud *cloud, const sb_real *value, sb_real limit)
{
    int kept = 0;
    for (int i = 0; i < cloud->count; i++) {
        if (value[i] > limit)
            continue;
        cloud->points[kept] = cloud->points[i];
        if (cloud->normals)
            cloud->normals[kept] = cloud->normals[i];
        kept++;
    }
    return kept;
}

REG_API sb_result reg_cloud_remove_outliers(reg_cloud *cloud, int k, reg_outliers rule, sb_real parameter, int *removed,
                                            sb_error *error)
{
    reg_kdtree *tree = NULL;
    sb_real *spacing, limit = 0;
    sb_result result;
    int kept;
    if (!cloud || k < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s", cloud ? "at least one neighbour is needed" : "cloud is NULL");
    result = reg_kdtree_create(cloud->points, cloud->count, &cloud->allocator, &tree, error);
    if (result != SB_OK)
        return result;
    k = sbi_min_int(k, cloud->count);
    spacing = (sb_real *)sbi_alloc(&cloud->allocator, (size_t)cloud->count, 2 * sizeof(sb_real));
    result = spacing ? regi_cloud_spacing(cloud, tree, k, spacing, error)
                     : sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d distances", cloud->count);
    if (result == SB_OK) {
        limit = reg_outlier_limit(spacing, cloud->count, rule, parameter, spacing + cloud->count);
        if (limit < 0)
            result = sbi_fail(error, SB_ERROR_ARGUMENT, "outlier rule %d with the parameter %g is out of range",
                              (int)rule, (double)parameter);
    }
    if (result == SB_OK) {
        kept = regi_cloud_keep(cloud, spacing, limit);
        if (removed)
            *removed = cloud->count - kept;
        cloud->count = kept;
    }
    sbi_free(&cloud->allocator, spacing);
    reg_kdtree_destroy(tree);
    return result;
}

/* ==== thinning ==================================================================================================== */

/* Cubes met so far, in a table of open addresses. */
typedef struct regi_cloud_cubes {
    double (*key)[3]; /* [count]: which cube; whole numbers */
    int *points;      /* [count]: how many it holds */
    int *slot;        /* [mask + 1]: index of a cube, or -1 */
    size_t mask;
    int count;
} regi_cloud_cubes;

static size_t regi_cloud_hash(const double key[3])
{
    uint64_t hash = 1469598103934665603u;
    for (int a = 0; a < 3; a++) {
        hash = (hash ^ sbi_dense_bits(key[a] + 0.0)) * 0x9E3779B97F4A7C15u; /* + 0.0: no negative zeros */
        hash ^= hash >> 32;
    }
    return (size_t)hash;
}

/* The cube of a point, made when it is new. */
static int regi_cloud_cube(regi_cloud_cubes *cubes, sb_vec3 point, double size)
{
    double key[3];
    size_t at;
    key[0] = floor((double)point.x / size);
    key[1] = floor((double)point.y / size);
    key[2] = floor((double)point.z / size);
    for (at = regi_cloud_hash(key) & cubes->mask; cubes->slot[at] >= 0; at = (at + 1) & cubes->mask) {
        const double *other = cubes->key[cubes->slot[at]];
        if (other[0] <= key[0] && other[0] >= key[0] && other[1] <= key[1] && other[1] >= key[1] &&
            other[2] <= key[2] && other[2] >= key[2])
            return cubes->slot[at];
    }
    memcpy(cubes->key[cubes->count], key, sizeof key);
    cubes->points[cubes->count] = 0;
    return cubes->slot[at] = cubes->count++;
}

/* Means as they grow: near the points, so that nothing is lost far from the origin. */
static void regi_cloud_gather(const reg_cloud *cloud, sb_real size, regi_cloud_cubes *cubes, reg_cloud *thin)
{
    for (int i = 0; i < cloud->count; i++) {
        int c = regi_cloud_cube(cubes, cloud->points[i], (double)size), n = ++cubes->points[c];
        sb_vec3 mean = n > 1 ? thin->points[c] : cloud->points[i];
        thin->points[c] = sb_v3_madd(mean, 1 / (sb_real)n, sb_v3_sub(cloud->points[i], mean));
        if (cloud->normals)
            thin->normals[c] = n > 1 ? sb_v3_add(thin->normals[c], cloud->normals[i]) : cloud->normals[i];
    }
    for (int c = 0; cloud->normals && c < cubes->count; c++)
        thin->normals[c] = regi_cloud_unit(thin->normals[c]);
}

REG_API sb_result reg_cloud_thin(const reg_cloud *cloud, sb_real size, reg_cloud *thin, sb_error *error)
{
    regi_cloud_cubes cubes;
    reg_cloud gathered, made;
    sb_allocator allocator;
    sb_result result;
    if (!cloud || !thin || !(size > 0) || !sb_is_finite(size))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "thinning needs a cloud and a positive size, not %g", (double)size);
    result = regi_cloud_check(cloud->points, cloud->normals, cloud->count, error);
    if (result != SB_OK)
        return result;
    allocator = cloud->allocator;
    memset(&cubes, 0, sizeof cubes);
    memset(&made, 0, sizeof made);
    for (cubes.mask = 7; cubes.mask / 2 < (size_t)cloud->count; cubes.mask = 2 * cubes.mask + 1)
        continue;
    result = regi_cloud_allocate(&gathered, cloud->count, cloud->normals != NULL, &allocator, error);
    if (result != SB_OK)
        return result;
    cubes.key = (double(*)[3])sbi_alloc(&allocator, (size_t)cloud->count, sizeof cubes.key[0]);
    cubes.points = (int *)sbi_alloc(&allocator, (size_t)cloud->count, sizeof(int));
    cubes.slot = (int *)sbi_alloc(&allocator, cubes.mask + 1, sizeof(int));
    if (cubes.key && cubes.points && cubes.slot) {
        memset(cubes.slot, -1, (cubes.mask + 1) * sizeof(int));
        regi_cloud_gather(cloud, size, &cubes, &gathered);
        result = regi_cloud_allocate(&made, cubes.count, cloud->normals != NULL, &allocator, error);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory to thin %d points", cloud->count);
    }
    sbi_free(&allocator, cubes.key);
    sbi_free(&allocator, cubes.points);
    sbi_free(&allocator, cubes.slot);
    if (result == SB_OK) {
        memcpy(made.points, gathered.points, (size_t)made.count * sizeof(sb_vec3));
        if (made.normals)
            memcpy(made.normals, gathered.normals, (size_t)made.count * sizeof(sb_vec3));
        if (thin == cloud)
            reg_cloud_free(thin);
        *thin = made;
    }
    reg_cloud_free(&gathered);
    return result;
}

REG_API int reg_cloud_spread(const sb_vec3 *points, int count, int wanted, int *chosen, sb_real *scratch)
{
    sb_vec3 last = sb_v3(0, 0, 0);
    int n = 0;
    if (!points || !chosen || !scratch || count < 1)
        return 0;
    for (int i = 0; i < count; i++)
        last = sb_v3_madd(last, 1 / (sb_real)(i + 1), sb_v3_sub(points[i], last));
    for (int i = 0; i < count; i++)
        scratch[i] = SB_REAL_MAX;
    while (n < wanted && n < count) {
        sb_real most = -1;
        int best = 0;
        for (int i = 0; i < count; i++) {
            sb_vec3 d = sb_v3_sub(points[i], last);
            sb_real square = sb_min(scratch[i], sb_v3_dot(d, d));
            scratch[i] = square;
            if (square > most) {
                most = square;
                best = i;
            }
        }
        if (n > 0 && !(most > 0))
            break;
        if (n == 0) /* the mean is no point: from now on distances are to chosen ones */
            for (int i = 0; i < count; i++)
                scratch[i] = SB_REAL_MAX;
        chosen[n++] = best;
        last = points[best];
    }
    return n;
}

/* ==== normals ===================================================================================================== */

/* The fits, in blocks of points that are neighbours. */
enum { REGI_CLOUD_BLOCK = 1024 };
typedef struct regi_cloud_fits {
    const sb_vec3 *points;
    const reg_kdtree *tree;
    const int *order;
    int *neighbours;  /* [count][k], in the order of the points; the first is the point itself */
    sb_real *squared; /* [count][k] */
    sb_vec3 *normals;
    int count, k;
} regi_cloud_fits;

/* Across the plane of least squares; 0 where the points spread in fewer than two directions. */
static sb_vec3 regi_cloud_fit(const sb_vec3 *points, const int *neighbours, int count)
{
    sb_vec3 mean = sb_v3(0, 0, 0), values;
    sb_mat3 spread = sb_m3_zero(), vectors;
    for (int i = 0; i < count; i++)
        mean = sb_v3_madd(mean, 1 / (sb_real)(i + 1), sb_v3_sub(points[neighbours[i]], mean));
    for (int i = 0; i < count; i++) {
        sb_vec3 d = sb_v3_sub(points[neighbours[i]], mean);
        spread = sb_m3_add(spread, sb_m3_outer(d, d));
    }
    sb_m3_eigen(spread, &values, &vectors);
    return values.y > 64 * SB_EPSILON * values.x ? sb_m3_column(vectors, 2) : sb_v3(0, 0, 0);
}

static void regi_cloud_fit_block(void *user, int block)
{
    const regi_cloud_fits *fits = (const regi_cloud_fits *)user;
    int end = sbi_min_int(fits->count - block * REGI_CLOUD_BLOCK, REGI_CLOUD_BLOCK);
    for (int i = 0; i < end; i++) {
        int at = fits->order[block * REGI_CLOUD_BLOCK + i];
        size_t row = (size_t)at * (size_t)fits->k;
        reg_kdtree_k_nearest(fits->tree, fits->points[at], fits->k, fits->neighbours + row, fits->squared + row);
        fits->normals[at] = regi_cloud_fit(fits->points, fits->neighbours + row, fits->k);
    }
}

/* A heap of the points next to those whose normals are settled, the most parallel one on top. */
typedef struct regi_cloud_front {
    const regi_cloud_fits *fits;
    sb_real *key;      /* [count]: 1 - |cosine| to the settled neighbour */
    int *from;         /* [count]: that neighbour */
    int *heap, *place; /* [count]: place -1: not met, -2: settled */
    int count;
} regi_cloud_front;

static int regi_cloud_before(const regi_cloud_front *front, int a, int b)
{
    return front->key[a] < front->key[b] || (front->key[a] <= front->key[b] && a < b);
}

static void regi_cloud_put(regi_cloud_front *front, int at, int point)
{
    front->heap[at] = point;
    front->place[point] = at;
}

static void regi_cloud_rise(regi_cloud_front *front, int at)
{
    int point = front->heap[at];
    for (; at > 0 && regi_cloud_before(front, point, front->heap[(at - 1) / 2]); at = (at - 1) / 2)
        regi_cloud_put(front, at, front->heap[(at - 1) / 2]);
    regi_cloud_put(front, at, point);
}

static int regi_cloud_pop(regi_cloud_front *front)
{
    int top = front->heap[0], last = front->heap[--front->count], at = 0;
    for (;;) {
        int child = 2 * at + 1;
        if (child + 1 < front->count && regi_cloud_before(front, front->heap[child + 1], front->heap[child]))
            child++;
        if (child >= front->count || !regi_cloud_before(front, front->heap[child], last))
            break;
        regi_cloud_put(front, at, front->heap[child]);
        at = child;
    }
    if (front->count > 0)
        regi_cloud_put(front, at, last);
    return top;
}

/* Settles a point and offers its neighbours. */
static void regi_cloud_settle(regi_cloud_front *front, int point)
{
    const regi_cloud_fits *fits = front->fits;
    const int *neighbours = fits->neighbours + (size_t)point * (size_t)fits->k;
    front->place[point] = -2;
    for (int i = 0; i < fits->k; i++) {
        int next = neighbours[i];
        sb_real key = 1 - sb_abs(sb_v3_dot(fits->normals[point], fits->normals[next]));
        if (front->place[next] == -2 || (front->place[next] >= 0 && !(key < front->key[next])))
            continue;
        front->key[next] = key;
        front->from[next] = point;
        if (front->place[next] < 0)
            regi_cloud_put(front, front->count++, next);
        regi_cloud_rise(front, front->place[next]);
    }
}

/* A point that nothing led to: it follows a neighbour that is settled, since being a neighbour is not mutual, else it
 * looks up. */
static void regi_cloud_seed(regi_cloud_front *front, int point)
{
    const regi_cloud_fits *fits = front->fits;
    const int *neighbours = fits->neighbours + (size_t)point * (size_t)fits->k;
    sb_vec3 guide = sb_v3(0, 0, 1);
    for (int i = 0; i < fits->k; i++)
        if (front->place[neighbours[i]] == -2) {
            guide = fits->normals[neighbours[i]];
            break;
        }
    if (sb_v3_dot(guide, fits->normals[point]) < 0)
        fits->normals[point] = sb_v3_scale(-1, fits->normals[point]);
    regi_cloud_settle(front, point);
}

static int regi_cloud_higher(const void *context, int a, int b)
{
    const sb_vec3 *points = (const sb_vec3 *)context;
    return points[a].z > points[b].z;
}

static sb_result regi_cloud_agree(const regi_cloud_fits *fits, const sb_allocator *allocator, sb_error *error)
{
    size_t n = (size_t)fits->count;
    int *memory = (int *)sbi_alloc(allocator, n, 5 * sizeof(int));
    regi_cloud_front front;
    front.key = (sb_real *)sbi_alloc(allocator, n, sizeof(sb_real));
    if (memory && front.key) {
        int *seeds = memory, *scratch = memory + n;
        front.fits = fits;
        front.from = memory + 2 * n;
        front.heap = memory + 3 * n;
        front.place = memory + 4 * n;
        front.count = 0;
        for (int i = 0; i < fits->count; i++) {
            seeds[i] = i;
            front.place[i] = -1;
        }
        sbi_merge_sort(seeds, scratch, fits->count, regi_cloud_higher, fits->points);
        for (int i = 0; i < fits->count; i++) {
            if (front.place[seeds[i]] == -2)
                continue;
            regi_cloud_seed(&front, seeds[i]);
            while (front.count > 0) {
                int point = regi_cloud_pop(&front);
                if (sb_v3_dot(fits->normals[point], fits->normals[front.from[point]]) < 0)
                    fits->normals[point] = sb_v3_scale(-1, fits->normals[point]);
                regi_cloud_settle(&front, point);
            }
        }
    }
    sbi_free(allocator, front.key);
    sbi_free(allocator, memory);
    return memory && front.key ? SB_OK : sbi_fail(error, SB_ERROR_MEMORY, "no memory to orient the normals");
}

static void regi_cloud_face(const regi_cloud_fits *fits, sb_vec3 view)
{
    for (int i = 0; i < fits->count; i++)
        if (sb_v3_dot(fits->normals[i], sb_v3_sub(view, fits->points[i])) < 0)
            fits->normals[i] = sb_v3_scale(-1, fits->normals[i]);
}

REG_API sb_result reg_cloud_estimate_normals(reg_cloud *cloud, int k, const sb_vec3 *view, const sb_jobs *jobs,
                                             sb_error *error)
{
    regi_cloud_fits fits;
    const sb_allocator *allocator;
    reg_kdtree *tree = NULL;
    int *order;
    sb_result result;
    if (!cloud || k < 3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "normals need a cloud and at least 3 neighbours, not %d", k);
    if (view && !sb_v3_is_finite(*view))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the view point is not finite");
    allocator = &cloud->allocator;
    result = reg_kdtree_create(cloud->points, cloud->count, allocator, &tree, error);
    if (result != SB_OK)
        return result;
    fits.points = cloud->points;
    fits.tree = tree;
    fits.count = cloud->count;
    fits.k = k < cloud->count ? k + 1 : cloud->count;
    fits.order = order = (int *)sbi_alloc(allocator, (size_t)cloud->count, sizeof(int));
    fits.neighbours = (int *)sbi_alloc(allocator, (size_t)cloud->count, (size_t)fits.k * sizeof(int));
    fits.squared = (sb_real *)sbi_alloc(allocator, (size_t)cloud->count, (size_t)fits.k * sizeof(sb_real));
    fits.normals = (sb_vec3 *)sbi_alloc(allocator, (size_t)cloud->count, sizeof(sb_vec3));
    if (order && fits.neighbours && fits.squared && fits.normals) {
        regi_kdtree_order(tree, order);
        sbi_run(jobs, regi_cloud_fit_block, &fits, (cloud->count - 1) / REGI_CLOUD_BLOCK + 1);
        if (view)
            regi_cloud_face(&fits, *view);
        else
            result = regi_cloud_agree(&fits, allocator, error);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the normals of %d points", cloud->count);
    }
    if (result == SB_OK) {
        sbi_free(allocator, cloud->normals);
        cloud->normals = fits.normals;
        fits.normals = NULL;
    }
    sbi_free(allocator, order);
    sbi_free(allocator, fits.neighbours);
    sbi_free(allocator, fits.squared);
    sbi_free(allocator, fits.normals);
    reg_kdtree_destroy(tree);
    return result;
}
