/* labels: the surface round labels of an image, and the labels of a mesh's elements. */
#include "labels.h"

#include <limits.h>
#include <math.h>
#include <string.h>

enum { SBI_LABEL_COOKIE = 0x6c61626c };

SB_API sb_label_def sb_default_label_def(void)
{
    sb_label_def def;
    memset(&def, 0, sizeof def);
    def.smoothing = 2;
    def.cookie = SBI_LABEL_COOKIE;
    return def;
}

/* ==== the field =======================================================================================
 * A box of values round the labels, with a rim so wide that the filter ends inside it: above 0 inside. */

typedef struct sbi_field_box {
    const sb_label_def *def;
    int low[3];    /* voxel of the image that value (0, 0, 0) belongs to */
    int counts[3]; /* of values along each axis */
    size_t strides[3];
    float *filtered; /* [counts[2]][counts[1]][counts[0]] */
    float *values;   /* of the same size: what is marched, each on its side */
    int voxels;      /* inside */
    int held;
} sbi_field_box;

static int sbi_label_is_chosen(const sb_label_def *def, int label)
{
    if (def->label_count == 0)
        return label != 0;
    for (int i = 0; i < def->label_count; i++)
        if (def->labels[i] == label)
            return 1;
    return 0;
}

/* 1 when the voxel that value (i, j, k) belongs to is inside. */
static int sbi_field_inside(const sbi_field_box *box, int i, int j, int k)
{
    const sb_image *image = box->def->image;
    int at[3];
    at[0] = box->low[0] + i, at[1] = box->low[1] + j, at[2] = box->low[2] + k;
    for (int axis = 0; axis < 3; axis++)
        if (at[axis] < 0 || at[axis] >= image->counts[axis])
            return 0;
    return sbi_label_is_chosen(
        box->def, image->labels[((size_t)at[2] * (size_t)image->counts[1] + (size_t)at[1]) * (size_t)image->counts[0] +
                                (size_t)at[0]]);
}

/* The box of the chosen voxels and how many there are. */
static sb_result sbi_field_measure(sbi_field_box *box, sb_error *error)
{
    const sb_image *image = box->def->image;
    const int *label = image->labels;
    int low[3] = {INT_MAX, INT_MAX, INT_MAX}, high[3] = {-1, -1, -1}, rim = box->def->smoothing + 1;
    size_t stride = 1;
    for (int k = 0; k < image->counts[2]; k++)
        for (int j = 0; j < image->counts[1]; j++)
            for (int i = 0; i < image->counts[0]; i++, label++) {
                int at[3];
                if (!sbi_label_is_chosen(box->def, *label))
                    continue;
                box->voxels++;
                at[0] = i, at[1] = j, at[2] = k;
                for (int axis = 0; axis < 3; axis++) {
                    low[axis] = sbi_min_int(low[axis], at[axis]);
                    high[axis] = sbi_max_int(high[axis], at[axis]);
                }
            }
    if (box->voxels == 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "labels: no voxel of the image has %s",
                        box->def->label_count ? "one of them" : "a label other than 0");
    for (int axis = 0; axis < 3; axis++) {
        size_t next = 0;
        box->low[axis] = low[axis] - rim;
        if (high[axis] - low[axis] > INT_MAX - 2 * rim - 1)
            return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the labels reach over too many voxels");
        box->counts[axis] = high[axis] - low[axis] + 1 + 2 * rim;
        box->strides[axis] = stride;
        if (!sbi_size_add(&next, stride, (size_t)box->counts[axis]))
            return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the image's surface");
        stride = next;
    }
    return SB_OK;
}

static size_t sbi_field_size(const sbi_field_box *box) { return box->strides[2] * (size_t)box->counts[2]; }

/* (1 2 1) / 4 along an axis, in place; beyond the box is 0. */
static void sbi_field_filter_axis(const sbi_field_box *box, float *values, int axis)
{
    int a = axis == 0 ? 1 : 0, b = axis == 2 ? 1 : 2, count = box->counts[axis];
    size_t step = box->strides[axis];
    for (int k = 0; k < box->counts[b]; k++)
        for (int j = 0; j < box->counts[a]; j++) {
            float *line = values + (size_t)k * box->strides[b] + (size_t)j * box->strides[a];
            float before = 0;
            for (int i = 0; i < count; i++, line += step) {
                float own = *line, after = i + 1 < count ? line[step] : 0.0f;
                *line = 0.25f * (before + after) + 0.5f * own;
                before = own;
            }
        }
}

static void sbi_field_filter(const sbi_field_box *box, float *values)
{
    for (int n = 0; n < box->def->smoothing; n++)
        for (int axis = 0; axis < 3; axis++)
            sbi_field_filter_axis(box, values, axis);
}

/* Mean of |value - level| over the neighbours across a face that belong to the other side; `own` where there are
 * none. */
static float sbi_field_opposite(const sbi_field_box *box, const int at[3], int inside, float level, float own)
{
    const float *value =
        box->filtered + (size_t)at[0] + (size_t)at[1] * box->strides[1] + (size_t)at[2] * box->strides[2];
    float sum = 0;
    int count = 0;
    for (int axis = 0; axis < 3; axis++)
        for (int side = -1; side <= 1; side += 2) {
            int next[3];
            memcpy(next, at, sizeof next);
            next[axis] += side;
            if (next[axis] < 0 || next[axis] >= box->counts[axis] ||
                sbi_field_inside(box, next[0], next[1], next[2]) == inside)
                continue;
            sum += fabsf((side < 0 ? *(value - box->strides[axis]) : value[box->strides[axis]]) - level);
            count++;
        }
    return count ? sum / (float)count : own;
}

/* Fills in the values, 0 where what was filtered has the level; puts every voxel on its side, and not quite on the
 * surface: a triangle needs some size. */
static void sbi_field_hold(sbi_field_box *box, float level)
{
    const float least = 0.01f;
    size_t n = 0;
    int at[3];
    box->held = 0;
    for (at[2] = 0; at[2] < box->counts[2]; at[2]++)
        for (at[1] = 0; at[1] < box->counts[1]; at[1]++)
            for (at[0] = 0; at[0] < box->counts[0]; at[0]++, n++) {
                float value = box->filtered[n] - level, size = fabsf(value);
                int inside = sbi_field_inside(box, at[0], at[1], at[2]);
                if (inside != (value > 0)) {
                    size = sbi_field_opposite(box, at, inside, level, size);
                    box->held++;
                }
                size = size > least ? size : least;
                box->values[n] = inside ? size : -size;
            }
}

/* Filters the inside. Where a surface is round, G moves its value at the surface by an amount that grows with the
 * filter's width, which GG has sqrt(2) times: with these weights the two cancel. */
static void sbi_field_make(sbi_field_box *box)
{
    const float once = 3.41421356f, twice = 2.41421356f; /* 2 + sqrt(2), 1 + sqrt(2) */
    size_t n = 0, size = sbi_field_size(box);
    for (int k = 0; k < box->counts[2]; k++)
        for (int j = 0; j < box->counts[1]; j++)
            for (int i = 0; i < box->counts[0]; i++)
                box->filtered[n++] = (float)sbi_field_inside(box, i, j, k);
    sbi_field_filter(box, box->filtered);
    memcpy(box->values, box->filtered, size * sizeof *box->values);
    sbi_field_filter(box, box->values);
    for (n = 0; n < size; n++)
        box->filtered[n] = once * box->filtered[n] - twice * box->values[n] - 0.5f;
}

/* ==== marching cubes ==================================================================================
 * Corner c of a cube has the bits x, y, z: 1, 2, 4. Edge 4 axis + t goes along the axis; t has the bits of the other
 * two axes, the next one first (x: y z, y: z x, z: x y). */

enum { SBI_CUBE_EDGES = 12, SBI_CUBE_FACES = 6 };

/* The corners of each face, round it as seen from outside the cube, and the edges between them. */
typedef struct sbi_cube_face {
    unsigned char corners[4], edges[4]; /* edge i joins corners i and i + 1 */
} sbi_cube_face;

static const sbi_cube_face sbi_cube_faces[SBI_CUBE_FACES] = {{{0, 4, 6, 2}, {8, 5, 10, 4}},  /* x low */
                                                             {{1, 3, 7, 5}, {6, 11, 7, 9}},  /* x high */
                                                             {{0, 1, 5, 4}, {0, 9, 2, 8}},   /* y low */
                                                             {{2, 6, 7, 3}, {10, 3, 11, 1}}, /* y high */
                                                             {{0, 2, 3, 1}, {4, 1, 6, 0}},   /* z low */
                                                             {{4, 5, 7, 6}, {2, 7, 3, 5}}};  /* z high */

/* Lower corner and axis of an edge. */
static int sbi_cube_edge_axis(int edge) { return edge / 4; }
static int sbi_cube_edge_corner(int edge)
{
    int axis = edge / 4, first = (axis + 1) % 3, second = (axis + 2) % 3;
    return (edge & 1) << first | (edge >> 1 & 1) << second;
}

typedef struct sbi_march {
    sbi_field_box *box;
    sbi_image_frame frame;
    int mirrored;    /* the axes are left-handed: triangles turn round */
    int *rows[3][2]; /* [axis][k even or odd] node on the edge along the axis at (i, j), of this layer and the next */
    sb_vec3 *nodes;  /* NULL while they are counted */
    int *triangles;
    int64_t node_count, triangle_count;
} sbi_march;

/* The value's place in space, moved by a share along an axis. */
static sb_vec3 sbi_march_point(const sbi_march *march, const int at[3], int axis, sb_real share)
{
    sb_real x[3];
    for (int k = 0; k < 3; k++)
        x[k] = (sb_real)(march->box->low[k] + at[k]) + (k == axis ? share : 0);
    return sb_v3_add(march->frame.origin, sb_m3_apply(march->frame.axes, sb_v3(x[0], x[1], x[2])));
}

static void sbi_march_node(sbi_march *march, sb_vec3 point)
{
    if (march->nodes)
        march->nodes[march->node_count] = point;
    march->node_count++;
}

/* Nodes on the edges from value (i, j, k) on: where the value is 0, but not at an end. */
static void sbi_march_edges(sbi_march *march, const int at[3])
{
    const sbi_field_box *box = march->box;
    const sb_real rim = (sb_real)0.02; /* what is nearer to an end makes triangles too small to be of use */
    size_t place = (size_t)at[0] + (size_t)at[1] * box->strides[1] + (size_t)at[2] * box->strides[2];
    size_t row = (size_t)at[0] + (size_t)at[1] * box->strides[1];
    float own = box->values[place];
    for (int axis = 0; axis < 3; axis++) {
        int *node = &march->rows[axis][at[2] & 1][row];
        float other;
        sb_real share;
        *node = -1;
        if (at[axis] + 1 >= box->counts[axis])
            continue;
        other = box->values[place + box->strides[axis]];
        if ((own > 0) == (other > 0))
            continue;
        share = (sb_real)own / ((sb_real)own - (sb_real)other);
        share = share < rim ? rim : share > 1 - rim ? 1 - rim : share;
        *node = (int)(march->node_count < INT_MAX ? march->node_count : 0);
        sbi_march_node(march, sbi_march_point(march, at, axis, share));
    }
}

static void sbi_march_triangle(sbi_march *march, int a, int b, int c)
{
    if (march->triangles) {
        int *triangle = march->triangles + 3 * march->triangle_count;
        triangle[0] = a;
        triangle[1] = march->mirrored ? b : c;
        triangle[2] = march->mirrored ? c : b;
    }
    march->triangle_count++;
}

/* Follows on each face from where the surface enters it: next[edge] is the edge where it leaves. On a face whose
 * corners alternate each corner inside is cut off by itself. */
static void sbi_cube_link(int inside, signed char next[SBI_CUBE_EDGES])
{
    memset(next, -1, SBI_CUBE_EDGES);
    for (int f = 0; f < SBI_CUBE_FACES; f++) {
        const sbi_cube_face *face = &sbi_cube_faces[f];
        for (int i = 0; i < 4; i++) {
            int end = i;
            /* from the edge where the way round the face leaves the inside, back to where it entered */
            if (!(inside >> face->corners[i] & 1) || (inside >> face->corners[(i + 1) % 4] & 1))
                continue;
            while (inside >> face->corners[(end + 3) % 4] & 1)
                end = (end + 3) % 4;
            next[face->edges[i]] = (signed char)face->edges[(end + 3) % 4];
        }
    }
}

/* 1 when two edges of the cube lie on one face. */
static int sbi_cube_share_face(int a, int b)
{
    for (int f = 0; f < SBI_CUBE_FACES; f++) {
        int found = 0;
        for (int i = 0; i < 4; i++)
            found += sbi_cube_faces[f].edges[i] == a || sbi_cube_faces[f].edges[i] == b;
        if (found == 2)
            return 1;
    }
    return 0;
}

/* Node on an edge of the cube at (i, j, k). */
static int sbi_march_edge_node(const sbi_march *march, const int at[3], int edge)
{
    int corner = sbi_cube_edge_corner(edge);
    size_t row = (size_t)(at[0] + (corner & 1)) + (size_t)(at[1] + (corner >> 1 & 1)) * march->box->strides[1];
    return march->rows[sbi_cube_edge_axis(edge)][(at[2] + (corner >> 2)) & 1][row];
}

/* Fills a loop with triangles. */
static void sbi_march_loop(sbi_march *march, const int *edges, const int *loop, int count)
{
    int centre = (int)(march->node_count < INT_MAX ? march->node_count : 0);
    sb_vec3 middle = sb_v3(0, 0, 0);
    if (count == 3) {
        sbi_march_triangle(march, loop[0], loop[1], loop[2]);
        return;
    }
    for (int start = 0; count == 4 && start < 2; start++)
        if (!sbi_cube_share_face(edges[start], edges[start + 2])) {
            sbi_march_triangle(march, loop[start], loop[start + 1], loop[start + 2]);
            sbi_march_triangle(march, loop[start + 2], loop[(start + 3) % 4], loop[start]);
            return;
        }
    for (int i = 0; i < count; i++) {
        if (march->nodes)
            middle = sb_v3_add(middle, march->nodes[loop[i]]);
        sbi_march_triangle(march, loop[i], loop[(i + 1) % count], centre);
    }
    sbi_march_node(march, sb_v3_scale((sb_real)1 / (sb_real)count, middle));
}

static void sbi_march_cube(sbi_march *march, const int at[3])
{
    const sbi_field_box *box = march->box;
    const float *values =
        box->values + (size_t)at[0] + (size_t)at[1] * box->strides[1] + (size_t)at[2] * box->strides[2];
    signed char next[SBI_CUBE_EDGES];
    int inside = 0;
    for (int c = 0; c < 8; c++)
        inside |=
            (values[(size_t)(c & 1) + (size_t)(c >> 1 & 1) * box->strides[1] + (size_t)(c >> 2) * box->strides[2]] > 0)
            << c;
    if (inside == 0 || inside == 255)
        return;
    sbi_cube_link(inside, next);
    for (int first = 0; first < SBI_CUBE_EDGES; first++) {
        int edges[SBI_CUBE_EDGES], loop[SBI_CUBE_EDGES], count = 0;
        for (int edge = first; next[edge] >= 0;) {
            int follows = next[edge];
            next[edge] = -1;
            edges[count] = edge;
            loop[count++] = sbi_march_edge_node(march, at, edge);
            edge = follows;
        }
        if (count)
            sbi_march_loop(march, edges, loop, count);
    }
}

/* One pass: counts nodes and triangles, or writes them. */
static void sbi_march_run(sbi_march *march)
{
    const int *counts = march->box->counts;
    int at[3];
    march->node_count = march->triangle_count = 0;
    for (int layer = 0; layer < counts[2]; layer++) {
        at[2] = layer;
        for (at[1] = 0; at[1] < counts[1]; at[1]++)
            for (at[0] = 0; at[0] < counts[0]; at[0]++)
                sbi_march_edges(march, at);
        at[2] = layer - 1;
        for (at[1] = 0; at[1] + 1 < counts[1] && layer > 0; at[1]++)
            for (at[0] = 0; at[0] + 1 < counts[0]; at[0]++)
                sbi_march_cube(march, at);
    }
}

/* ==== the surface ===================================================================================== */

static sb_result sbi_label_check(const sb_label_def *def, sb_error *error)
{
    if (def->cookie != SBI_LABEL_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def does not come from sb_default_label_def()");
    if (def->label_count < 0 || (def->label_count > 0 && !def->labels))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "labels: %d of them, at %s", def->label_count,
                        def->labels ? "an array" : "NULL");
    if (def->smoothing < 0 || def->smoothing > SB_LABEL_MAX_SMOOTHING)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "smoothing is %d: it must be in [0, %d]", def->smoothing,
                        SB_LABEL_MAX_SMOOTHING);
    return sb_image_check(def->image, error);
}

/* m^3 that the triangles enclose, measured from their first node: far from 0 digits would be lost. */
static sb_real sbi_label_volume(const sb_mesh *mesh)
{
    double sum = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *c = mesh->elements + 3 * (size_t)e;
        sb_vec3 a = sb_v3_sub(mesh->nodes[c[0]], mesh->nodes[0]), b = sb_v3_sub(mesh->nodes[c[1]], mesh->nodes[0]);
        sum += (double)sb_v3_dot(a, sb_v3_cross(b, sb_v3_sub(mesh->nodes[c[2]], mesh->nodes[0])));
    }
    return (sb_real)(sum / 6);
}

static sb_real sbi_label_voxel_volume(const sb_image *image, int voxels)
{
    sb_vec3 s = image->spacing;
    return (sb_real)voxels * s.x * s.y * s.z * (sb_real)fabs((double)sb_m3_det(image->direction));
}

static sb_result sbi_label_no_memory(sb_error *error)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the image's surface");
}

/* Counts what is marched and takes memory for it. */
static sb_result sbi_label_reserve(sbi_march *march, const sb_allocator *allocator, sb_mesh *mesh, sb_error *error)
{
    sbi_march_run(march);
    if (march->node_count > INT_MAX || march->triangle_count > INT_MAX / 3)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the surface has %lld nodes and %lld triangles: too many",
                        (long long)march->node_count, (long long)march->triangle_count);
    memset(mesh, 0, sizeof *mesh);
    mesh->allocator = *allocator;
    mesh->element_type = SB_TRI3;
    mesh->node_count = (int)march->node_count;
    mesh->element_count = (int)march->triangle_count;
    mesh->nodes = (sb_vec3 *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(sb_vec3));
    mesh->elements = (int *)sbi_alloc(allocator, (size_t)mesh->element_count, 3 * sizeof(int));
    if (!mesh->nodes || !mesh->elements) {
        sb_mesh_free(mesh);
        return sbi_label_no_memory(error);
    }
    march->nodes = mesh->nodes;
    march->triangles = mesh->elements;
    return SB_OK;
}

/* m^3 inside the surface of the level, which is written to the mesh. Which nodes and triangles there are depends on the
 * labels only. */
static sb_real sbi_label_set_level(sbi_march *march, float level, const sb_mesh *mesh)
{
    sbi_field_hold(march->box, level);
    sbi_march_run(march);
    return sbi_label_volume(mesh);
}

/* Finds the level at which the volume is that of the voxels, by false position (Illinois). Where none within the bounds
 * will do, the nearer bound is taken: beyond them the surface would leave the shape's own place for the volume's
 * sake. */
static void sbi_label_fit_volume(sbi_march *march, sb_real wanted, const sb_mesh *mesh)
{
    const float bound = 0.125f;
    const sb_real close = (sb_real)1e-4 * wanted;
    float a = 0, b, level = 0;
    sb_real error_a = sbi_label_set_level(march, a, mesh) - wanted, error_b, found = error_a;
    if ((sb_real)fabs((double)error_a) <= close)
        return;
    b = error_a < 0 ? -bound : bound;
    error_b = sbi_label_set_level(march, b, mesh) - wanted;
    if ((error_a < 0) == (error_b < 0)) {
        if (fabs((double)error_b) > fabs((double)error_a))
            sbi_label_set_level(march, a, mesh);
        return;
    }
    for (int i = 0; i < 8 && (sb_real)fabs((double)found) > close; i++) {
        level = (float)(((sb_real)a * error_b - (sb_real)b * error_a) / (error_b - error_a));
        found = sbi_label_set_level(march, level, mesh) - wanted;
        if ((found < 0) == (error_b < 0)) {
            b = level;
            error_b = found;
            error_a /= 2;
        } else {
            a = b;
            error_a = error_b;
            b = level;
            error_b = found;
        }
    }
}

/* The mesh from the box, for which there is memory but for the two layers of edges. */
static sb_result sbi_label_surface(sbi_field_box *box, sb_real volume, sb_mesh *mesh, sb_error *error)
{
    const sb_allocator *allocator = &box->def->allocator;
    size_t layer = box->strides[2];
    sbi_march march;
    int *rows;
    sb_result result;
    memset(&march, 0, sizeof march);
    march.box = box;
    march.frame = sbi_image_get_frame(box->def->image);
    march.mirrored = sb_m3_det(box->def->image->direction) < 0;
    rows = (int *)sbi_alloc(allocator, layer, 6 * sizeof *rows);
    if (!rows)
        return sbi_label_no_memory(error);
    for (size_t i = 0; i < 6; i++)
        march.rows[i / 2][i % 2] = rows + i * layer;
    sbi_field_make(box);
    sbi_field_hold(box, 0);
    result = sbi_label_reserve(&march, allocator, mesh, error);
    if (!result)
        sbi_label_fit_volume(&march, volume, mesh);
    sbi_free(allocator, rows);
    return result;
}

SB_API sb_result sb_image_surface(const sb_label_def *def, sb_mesh *mesh, sb_label_report *report, sb_error *error)
{
    sbi_field_box box;
    sb_mesh made;
    sb_real volume;
    sb_result result;
    if (!def || !mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", def ? "mesh" : "def");
    result = sbi_label_check(def, error);
    memset(&box, 0, sizeof box);
    box.def = def;
    if (!result)
        result = sbi_field_measure(&box, error);
    if (result)
        return result;
    volume = sbi_label_voxel_volume(def->image, box.voxels);
    box.filtered = (float *)sbi_alloc(&def->allocator, sbi_field_size(&box), sizeof *box.filtered);
    box.values = (float *)sbi_alloc(&def->allocator, sbi_field_size(&box), sizeof *box.values);
    result = box.filtered && box.values ? sbi_label_surface(&box, volume, &made, error) : sbi_label_no_memory(error);
    sbi_free(&def->allocator, box.filtered);
    sbi_free(&def->allocator, box.values);
    if (result)
        return result;
    if (report) {
        report->voxels = box.voxels;
        report->voxel_volume = volume;
        report->volume = sbi_label_volume(&made);
        report->held_voxels = box.held;
    }
    *mesh = made;
    return SB_OK;
}

/* ==== regions ========================================================================================= */

/* Label of the nearest voxel that has one, of those up to two away from the point's own along each axis; 0: none
 * has. */
static int sbi_label_near(const sb_image *image, const sbi_image_frame *frame, sb_vec3 point)
{
    sb_real nearest = SB_REAL_MAX;
    int found = 0;
    for (int n = 0; n < 125; n++) {
        sb_vec3 step =
            sb_m3_apply(frame->axes, sb_v3((sb_real)(n % 5 - 2), (sb_real)(n / 5 % 5 - 2), (sb_real)(n / 25 - 2)));
        int label = sbi_image_lookup(image, frame, sb_v3_add(point, step));
        sb_real distance = sb_v3_norm(step);
        if (label != 0 && distance < nearest) {
            found = label;
            nearest = distance;
        }
    }
    return found;
}

/* Label of an element: of most points of the sample; the first of those that are met equally often. */
static int sbi_label_of_element(const sb_image *image, const sbi_image_frame *frame, const sb_mesh *mesh, int element)
{
    enum { MAX_SAMPLE = 64 };
    int width = sb_mesh_element_width(mesh), found[MAX_SAMPLE], count = 0, best = 0, best_votes = 0;
    const int *nodes = mesh->elements + (size_t)element * (size_t)width;
    sb_vec3 centre = sb_v3(0, 0, 0);
    for (int i = 0; i < width; i++)
        centre = sb_v3_add(centre, sb_v3_scale((sb_real)1 / (sb_real)width, mesh->nodes[nodes[i]]));
    for (int i = -1; i < width && count < MAX_SAMPLE; i++) {
        sb_vec3 to = i < 0 ? centre : mesh->nodes[nodes[i]];
        int label = sbi_image_lookup(image, frame, sb_v3_scale((sb_real)0.5, sb_v3_add(centre, to)));
        if (label != 0)
            found[count++] = label;
    }
    for (int i = 0; i < count; i++) {
        int votes = 0;
        for (int k = 0; k < count; k++)
            votes += found[k] == found[i];
        if (votes > best_votes) {
            best = found[i];
            best_votes = votes;
        }
    }
    return count ? best : sbi_label_near(image, frame, centre);
}

SB_API sb_result sb_image_set_regions(const sb_image *image, sb_mesh *mesh, sb_error *error)
{
    sbi_image_frame frame;
    sb_result result;
    if (!image || !mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", image ? "mesh" : "image");
    result = sb_image_check(image, error);
    if (!result)
        result = sbi_mesh_check_arrays(mesh, error);
    if (result)
        return result;
    if (!mesh->regions) {
        mesh->regions = (int *)sbi_alloc(&mesh->allocator, (size_t)mesh->element_count, sizeof(int));
        if (!mesh->regions)
            return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the regions of %d elements",
                            mesh->element_count);
    }
    frame = sbi_image_get_frame(image);
    for (int e = 0; e < mesh->element_count; e++)
        mesh->regions[e] = sbi_label_of_element(image, &frame, mesh, e);
    return SB_OK;
}
