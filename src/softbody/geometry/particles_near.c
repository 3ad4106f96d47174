/* particles_near: the particles nearest to a point, by boxes; of equally far ones mirror images together. */
#include "particles_private.h"

/* ---- boxes ---- */

static int sbi_near_place(const sbi_near *near, double x, int axis)
{
    double box = floor((x - near->low[axis]) / near->edge);
    return box > 0 ? (box < near->dims[axis] ? (int)box : near->dims[axis] - 1) : 0;
}

static int sbi_near_box_at(const sbi_near *near, sb_vec3 at)
{
    int x = sbi_near_place(near, (double)at.x, 0), y = sbi_near_place(near, (double)at.y, 1);
    return (sbi_near_place(near, (double)at.z, 2) * near->dims[1] + y) * near->dims[0] + x;
}

/* Boxes of about one particle each, no more than twice as many as there are particles. */
static void sbi_near_lay_out(sbi_near *near, double edge)
{
    double low[3] = {0, 0, 0}, high[3] = {0, 0, 0}, size = 0, boxes;
    for (int i = 0; i < near->count; i++) {
        const double x[3] = {(double)near->points[i].x, (double)near->points[i].y, (double)near->points[i].z};
        for (int k = 0; k < 3; k++) {
            low[k] = i == 0 || x[k] < low[k] ? x[k] : low[k];
            high[k] = i == 0 || x[k] > high[k] ? x[k] : high[k];
            size = fabs(x[k]) > size ? fabs(x[k]) : size;
        }
    }
    near->rounding = 4 * (double)SB_EPSILON * size;
    near->edge = edge > 0 ? edge : 1;
    do {
        boxes = 1;
        for (int k = 0; k < 3; k++)
            boxes *= floor((high[k] - low[k]) / near->edge) + 1;
        if (boxes > 2.0 * near->count + 1000)
            near->edge *= 1.3;
    } while (boxes > 2.0 * near->count + 1000);
    for (int k = 0; k < 3; k++) {
        near->low[k] = low[k];
        near->dims[k] = (int)floor((high[k] - low[k]) / near->edge) + 1;
    }
}

SBI_API sb_result sbi_near_create(const sb_vec3 *points, int count, sb_real spacing, const sb_allocator *allocator,
                                  sbi_near *near, sb_error *error)
{
    size_t boxes, bytes = 0;
    memset(near, 0, sizeof *near);
    near->points = points;
    near->count = count;
    sbi_near_lay_out(near, (double)spacing);
    boxes = (size_t)near->dims[0] * (size_t)near->dims[1] * (size_t)near->dims[2];
    if (sbi_size_add(&bytes, boxes + 1, sizeof(int)) && sbi_size_add(&bytes, (size_t)count, sizeof(int)))
        near->memory = sbi_alloc_zeroed(allocator, bytes, 1);
    if (!near->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for boxes of %d particles", count);
    near->start = (int *)near->memory;
    near->items = near->start + boxes + 1;
    for (int i = 0; i < count; i++)
        near->start[sbi_near_box_at(near, points[i]) + 1]++;
    for (size_t b = 0; b < boxes; b++)
        near->start[b + 1] += near->start[b];
    for (int i = count; i-- > 0;) /* moves each end to its beginning ... */
        near->items[--near->start[sbi_near_box_at(near, points[i]) + 1]] = i;
    memmove(near->start, near->start + 1, boxes * sizeof(int));
    near->start[boxes] = count; /* ... and the list with it */
    return SB_OK;
}

SBI_API void sbi_near_free(sbi_near *near, const sb_allocator *allocator)
{
    sbi_free(allocator, near->memory);
    memset(near, 0, sizeof *near);
}

/* ---- candidates ---- */

enum { SBI_NEAR_MOST = 512 };

/* key: distance, then |dz|, |dy|, |dx|, which a mirror leaves. */
typedef struct sbi_near_one {
    double key[4], offset[3];
    int node;
    int first; /* 1: begins a mirror group */
} sbi_near_one;

typedef struct sbi_near_list {
    const sbi_near *near;
    sb_vec3 at;
    int exclude;
    int count;
    double limit; /* (m) farther ones are not listed */
    sbi_near_one one[SBI_NEAR_MOST];
} sbi_near_list;

SBI_API int sbi_near_is_cut(const sbi_near *near, sb_vec3 from, sb_vec3 to)
{
    sb_vec3 way = sb_v3_sub(to, from);
    for (int c = 0; c < near->cut_count; c++) {
        sb_vec3 low, high;
        sb_surface_bounds(near->cuts[c], &low, &high);
        if (sb_max(from.x, to.x) < low.x || sb_min(from.x, to.x) > high.x || sb_max(from.y, to.y) < low.y ||
            sb_min(from.y, to.y) > high.y || sb_max(from.z, to.z) < low.z || sb_min(from.z, to.z) > high.z)
            continue;
        if (sb_surface_ray(near->cuts[c], from, way, sb_v3_norm(way), NULL))
            return 1;
    }
    return 0;
}

static void sbi_near_sort(sbi_near_one *one, int count, int key, double rounding)
{
    for (int i = 1; i < count; i++) {
        sbi_near_one moved = one[i];
        int j = i;
        for (; j > 0 && (one[j - 1].key[key] > moved.key[key] ||
                         (one[j - 1].key[key] == moved.key[key] && one[j - 1].node > moved.node));
             j--)
            one[j] = one[j - 1];
        one[j] = moved;
    }
    for (int begin = 0, end; begin < count; begin = end) {
        double same = 1e-6 * one[begin].key[0] + rounding;
        for (end = begin + 1; end < count && one[end].key[key] - one[end - 1].key[key] <= same; end++)
            one[end].first = 0;
        one[begin].first = 1;
        if (end > begin + 1 && key < 3)
            sbi_near_sort(one + begin, end - begin, key + 1, rounding);
    }
}

static void sbi_near_add(sbi_near_list *list, int node)
{
    sbi_near_one *one = list->one + list->count;
    sb_vec3 x = list->near->points[node];
    double square = 0;
    one->offset[0] = (double)x.x - (double)list->at.x;
    one->offset[1] = (double)x.y - (double)list->at.y;
    one->offset[2] = (double)x.z - (double)list->at.z;
    for (int k = 0; k < 3; k++) {
        square += one->offset[k] * one->offset[k];
        one->key[3 - k] = fabs(one->offset[k]);
    }
    one->key[0] = sqrt(square);
    one->node = node;
    one->first = 1;
    if (one->key[0] > list->limit || (list->near->cut_count && sbi_near_is_cut(list->near, list->at, x)))
        return;
    if (++list->count == SBI_NEAR_MOST) { /* a crowd: the farther half is not needed */
        sbi_near_sort(list->one, list->count, 0, list->near->rounding);
        list->count /= 2;
        list->limit = list->one[list->count - 1].key[0];
    }
}

/* Adds what is in the boxes `ring` away from the own one; *known: the distance (m) within which all is listed. Returns
 * 1 after the last ring. */
static int sbi_near_add_ring(sbi_near_list *list, int ring, double *known)
{
    const sbi_near *near = list->near;
    const double at[3] = {(double)list->at.x, (double)list->at.y, (double)list->at.z};
    int own[3], first[3], last[3];
    double reach = HUGE_VAL;
    for (int k = 0; k < 3; k++) {
        own[k] = sbi_near_place(near, at[k], k);
        first[k] = sbi_max_int(own[k] - ring, 0);
        last[k] = sbi_min_int(own[k] + ring, near->dims[k] - 1);
        if (own[k] - ring > 0)
            reach = fmin(reach, at[k] - (near->low[k] + (own[k] - ring) * near->edge));
        if (own[k] + ring < near->dims[k] - 1)
            reach = fmin(reach, near->low[k] + (own[k] + ring + 1) * near->edge - at[k]);
    }
    for (int z = first[2]; z <= last[2]; z++)
        for (int y = first[1]; y <= last[1]; y++) {
            int whole = z == own[2] - ring || z == own[2] + ring || y == own[1] - ring || y == own[1] + ring;
            for (int x = whole ? first[0] : own[0] - ring; x <= last[0]; x += whole || ring == 0 ? 1 : 2 * ring) {
                int box = (z * near->dims[1] + y) * near->dims[0] + x;
                for (int i = x < 0 ? 0 : near->start[box]; x >= 0 && i < near->start[box + 1]; i++)
                    if (near->items[i] != list->exclude)
                        sbi_near_add(list, near->items[i]);
            }
        }
    *known = fmin(reach, list->limit) * (1 - 4e-6) - near->rounding;
    return !(reach < HUGE_VAL);
}

static int sbi_near_take(const sbi_near_list *list, int want, int least, double radius, sbi_neighbours *out)
{
    int most = list->exclude < 0 ? SBI_PARTICLE_NODES : SBI_PARTICLE_NODES - 1, count = 0, end;
    for (int i = 0; i < list->count; i = end) {
        int within = list->one[i].key[0] <= radius;
        for (end = i + 1; end < list->count && !list->one[end].first;)
            end++;
        if (!within && count + end - i > want && count >= least)
            break;
        if (count + end - i > most)
            return 0;
        for (int k = i; k < end; k++, count++) {
            out->nodes[count] = list->one[k].node;
            out->distance[count] = list->one[k].key[0];
            memcpy(out->offset[count], list->one[k].offset, sizeof out->offset[0]);
        }
    }
    out->count = count;
    return 1;
}

SBI_API int sbi_near_find(const sbi_near *near, sb_vec3 at, int exclude, int want, int least, double radius,
                          sbi_neighbours *out)
{
    sbi_near_list list;
    list.near = near;
    list.at = at;
    list.exclude = exclude;
    list.count = 0;
    list.limit = HUGE_VAL;
    for (int ring = 0;; ring++) {
        double known = 0;
        int safe = 0, all = sbi_near_add_ring(&list, ring, &known);
        for (int i = 0; i < list.count; i++)
            safe += list.one[i].key[0] <= known;
        /* the shell after the last one taken must be whole, for a group is taken or left as a whole */
        if (all || ((safe > SBI_PARTICLE_NODES || (safe > want && safe > least)) && known > radius)) {
            int kept = 0;
            for (int i = 0; i < list.count; i++)
                if (list.one[i].key[0] <= known)
                    list.one[kept++] = list.one[i];
            list.count = kept;
            sbi_near_sort(list.one, kept, 0, near->rounding);
            return sbi_near_take(&list, want, least, radius, out);
        }
    }
}

/* h by the rule. */
static double sbi_near_radius(const sb_particles_def *def, const sbi_neighbours *near)
{
    double farthest = 0, sum = 0;
    for (int j = 0; j < near->count; j++) {
        farthest = fmax(farthest, near->distance[j]);
        sum += near->distance[j];
    }
    if (def->radius_rule == SB_RADIUS_MEAN && near->count > 0)
        farthest = sum / near->count;
    return (double)def->dilatation * farthest;
}

SBI_API int sbi_near_gather(const sbi_near *near, const sb_particles_def *def, sb_vec3 at, int exclude, int growth,
                            sbi_neighbours *out, double *h)
{
    double factor = growth == 0 ? 1 : growth == 1 ? 1.2 : growth == 2 ? 1.44 : 1.728;
    int least = def->method == SB_PARTICLES_GRID ? 2 * def->basis : 4;
    sbi_neighbours more;
    if (def->radius_rule == SB_RADIUS_FIXED) {
        *h = (double)def->radius * factor;
        return sbi_near_find(near, at, exclude, 0, 0, *h * (1 - 1e-9), out);
    }
    if (!sbi_near_find(near, at, exclude, def->neighbours, least, 0, out))
        return 0;
    *h = sbi_near_radius(def, out) * factor;
    if (growth == 0 || out->count == 0)
        return 1;
    /* where there are more than fit the radius grows alone */
    if (sbi_near_find(near, at, exclude, def->neighbours, least, out->distance[out->count - 1] * factor, &more)) {
        *out = more;
        *h = fmax(*h, sbi_near_radius(def, out));
    }
    return 1;
}
