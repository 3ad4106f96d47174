/* embed_volume: what queries of a volume mesh read: smooth normals, Morton order, a tree of boxes. */
#include "embed_search.h"

#include <string.h>

/* ---- faces and their normals ---- */

SBI_API void sbi_embed_face_make(sb_element_type type, sbi_embed_face *face)
{
    memset(face, 0, sizeof *face);
    face->type = type;
    face->nodes = sb_element_node_count(type);
    face->corners = sb_element_corner_count(type);
    face->lanes = (face->nodes + 3) / 4 * 4;
    for (int i = 0; i < face->nodes; i++) {
        sb_real xi[3], gradient[SB_MAX_FACE_NODES][3];
        sb_element_node_point(type, i, xi);
        sb_element_shape(type, xi, NULL, gradient);
        for (int j = 0; j < face->nodes; j++) {
            face->slope[0][j][i] = gradient[j][0];
            face->slope[1][j][i] = gradient[j][1];
        }
    }
}

SBI_API void sbi_embed_face_normals(const sbi_embed_face *face, const sb_vec3 *x, const sb_real *weight, sb_vec3 *out)
{
    sb_real t[2][3][SBI_EMBED_FACE_LANES];
    for (int k = 0; k < 2; k++) {
        for (int i = 0; i < face->lanes; i++)
            t[k][0][i] = t[k][1][i] = t[k][2][i] = 0;
        for (int j = 0; j < face->nodes; j++) {
            const sb_real *slope = face->slope[k][j];
            for (int i = 0; i < face->lanes; i++) {
                t[k][0][i] += slope[i] * x[j].x;
                t[k][1][i] += slope[i] * x[j].y;
                t[k][2][i] += slope[i] * x[j].z;
            }
        }
    }
    for (int i = 0; i < face->nodes; i++) {
        sb_vec3 a = sb_v3(t[0][0][i], t[0][1][i], t[0][2][i]), b = sb_v3(t[1][0][i], t[1][1][i], t[1][2][i]);
        out[i] = sb_v3_scale(weight[i], sbi_embed_unit(sb_v3_cross(a, b)));
    }
}

SBI_API sb_real sbi_embed_face_angle(const sbi_embed_face *face, const sb_vec3 *x, int i)
{
    const sb_real half_turn = (sb_real)3.14159265358979323846;
    sb_real gradient[SB_MAX_FACE_NODES][3], at[3], ends[2][3];
    sb_vec3 t[2];
    if (i >= face->corners)
        return i < 2 * face->corners ? half_turn : 2 * half_turn;
    sb_element_node_point(face->type, i, at);
    sb_element_node_point(face->type, (i + 1) % face->corners, ends[0]);
    sb_element_node_point(face->type, (i + face->corners - 1) % face->corners, ends[1]);
    sb_element_shape(face->type, at, NULL, gradient);
    for (int k = 0; k < 2; k++) {
        t[k] = sb_v3(0, 0, 0);
        for (int j = 0; j < face->nodes; j++)
            t[k] =
                sb_v3_madd(t[k], gradient[j][0] * (ends[k][0] - at[0]) + gradient[j][1] * (ends[k][1] - at[1]), x[j]);
    }
    return sb_atan2(sb_v3_norm(sb_v3_cross(t[0], t[1])), sb_v3_dot(t[0], t[1]));
}

SBI_API const int *sbi_embed_face_row(const sbi_embed_volume *volume, int face)
{
    return volume->boundary.surface.elements + (size_t)face * (size_t)volume->face.nodes;
}

SBI_API void sbi_embed_gather(const sb_vec3 *from, const int *nodes, int count, sb_vec3 *to)
{
    for (int a = 0; a < count; a++)
        to[a] = from[nodes[a]];
}

/* weights and normals of the volume at rest. */
static void sbi_embed_fill_normals(sbi_embed_volume *volume)
{
    int count = volume->face.nodes;
    for (int f = 0; f < volume->boundary.surface.element_count; f++) {
        const int *nodes = sbi_embed_face_row(volume, f);
        sb_real *weight = volume->weights + (size_t)f * (size_t)count;
        sb_vec3 x[SB_MAX_FACE_NODES], n[SB_MAX_FACE_NODES];
        sbi_embed_gather(volume->mesh->nodes, nodes, count, x);
        for (int i = 0; i < count; i++)
            weight[i] = sbi_embed_face_angle(&volume->face, x, i);
        sbi_embed_face_normals(&volume->face, x, weight, n);
        for (int i = 0; i < count; i++)
            volume->normals[nodes[i]] = sb_v3_add(volume->normals[nodes[i]], n[i]);
    }
    for (int i = 0; i < volume->mesh->node_count; i++)
        volume->normals[i] = sbi_embed_unit(volume->normals[i]);
}

/* ---- Morton order ---- */

/* The ten bits of x spread to every third bit. */
static uint32_t sbi_embed_spread(uint32_t x)
{
    x = (x | (x << 16)) & 0x030000FFu;
    x = (x | (x << 8)) & 0x0300F00Fu;
    x = (x | (x << 4)) & 0x030C30C3u;
    return (x | (x << 2)) & 0x09249249u;
}

static uint32_t sbi_embed_morton_cell(sb_real x, sb_real low, sb_real inverse)
{
    sb_real cell = (x - low) * inverse;
    return cell > 0 ? (cell < 1023 ? (uint32_t)cell : 1023u) : 0u;
}

static void sbi_embed_grow(sbi_embed_box *box, sb_vec3 low, sb_vec3 high)
{
    box->low = sb_v3(sb_min(box->low.x, low.x), sb_min(box->low.y, low.y), sb_min(box->low.z, low.z));
    box->high = sb_v3(sb_max(box->high.x, high.x), sb_max(box->high.y, high.y), sb_max(box->high.z, high.z));
}

static sbi_embed_box sbi_embed_empty_box(void)
{
    sbi_embed_box box;
    box.low = sb_v3((sb_real)INFINITY, (sb_real)INFINITY, (sb_real)INFINITY);
    box.high = sb_v3(-(sb_real)INFINITY, -(sb_real)INFINITY, -(sb_real)INFINITY);
    return box;
}

/* Few by insertion: passes over digits cost thousands of steps whatever their number. Both are stable. */
static void sbi_embed_insert_sort(const uint32_t *key, int count, int *order)
{
    for (int i = 0; i < count; i++) {
        int at = i;
        for (; at > 0 && key[order[at - 1]] > key[i]; at--)
            order[at] = order[at - 1];
        order[at] = i;
    }
}

SBI_API void sbi_embed_sort(const sb_vec3 *points, int count, int *order, uint32_t *scratch)
{
    enum { FEW = 64 };
    uint32_t *key = scratch, *from = scratch + count, *to = from + count;
    sbi_embed_box box = sbi_embed_empty_box();
    sb_real side, inverse;
    for (int i = 0; i < count; i++)
        sbi_embed_grow(&box, points[i], points[i]);
    side = sb_max(sb_max(box.high.x - box.low.x, box.high.y - box.low.y), box.high.z - box.low.z);
    inverse = side > 0 ? 1024 / side : (sb_real)0;
    for (int i = 0; i < count; i++) {
        key[i] = sbi_embed_spread(sbi_embed_morton_cell(points[i].x, box.low.x, inverse)) |
                 sbi_embed_spread(sbi_embed_morton_cell(points[i].y, box.low.y, inverse)) << 1 |
                 sbi_embed_spread(sbi_embed_morton_cell(points[i].z, box.low.z, inverse)) << 2;
        from[i] = (uint32_t)i;
    }
    if (count <= FEW) {
        sbi_embed_insert_sort(key, count, order);
        return;
    }
    for (int shift = 0; shift < 30; shift += 10) { /* three stable passes by ten bits */
        int start[1025];
        uint32_t *swap = from;
        memset(start, 0, sizeof start);
        for (int i = 0; i < count; i++)
            start[(key[i] >> shift & 1023u) + 1]++;
        for (int d = 0; d < 1024; d++)
            start[d + 1] += start[d];
        for (int i = 0; i < count; i++)
            to[start[key[from[i]] >> shift & 1023u]++] = from[i];
        from = to;
        to = swap;
    }
    for (int i = 0; i < count; i++)
        order[i] = (int)from[i];
}

/* ---- preparation ---- */

SBI_API void sbi_embed_volume_free(sbi_embed_volume *volume)
{
    const sb_allocator *allocator = &volume->allocator;
    sb_boundary_free(&volume->boundary);
    sb_index_table_free(&volume->neighbours);
    sb_index_table_free(&volume->face_neighbours);
    sbi_free(allocator, volume->boundary_face);
    sbi_free(allocator, volume->planes);
    sbi_free(allocator, volume->bulge);
    sbi_free(allocator, volume->order);
    sbi_free(allocator, volume->boxes);
    sbi_free(allocator, volume->weights);
    sbi_free(allocator, volume->normals);
}

/* Largest distance of an element from the straight one of its corners: that of its nodes, times what their shape
 * functions can sum up to (mid-edge nodes of a tet 3/2; of a hex 3, hex27 less). */
static sb_real sbi_embed_bulge(const sbi_embed_volume *volume, const sb_vec3 *x)
{
    sb_element_type type = volume->mesh->element_type, straight = sb_element_straight(type);
    sb_real largest = 0;
    for (int a = volume->corners; a < volume->width; a++) {
        sb_real xi[3], shape[SB_MAX_ELEMENT_NODES];
        sb_vec3 at = sb_v3(0, 0, 0);
        sb_element_node_point(type, a, xi);
        sb_element_shape(straight, xi, shape, NULL);
        for (int c = 0; c < volume->corners; c++)
            at = sb_v3_madd(at, shape[c], x[c]);
        largest = sb_max(largest, sb_v3_norm(sb_v3_sub(x[a], at)));
    }
    return largest * (volume->is_box ? (sb_real)3 : (sb_real)1.5);
}

/* L_a as linear functions of the position, for the straight tet of four corners. */
static void sbi_embed_fill_planes(const sb_vec3 *x, sb_real (*planes)[4])
{
    sb_mat3 inverse = sb_m3_inverse(sb_m3_columns(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0]), sb_v3_sub(x[3], x[0])));
    for (int k = 0; k < 4; k++)
        planes[0][k] = 0;
    for (int a = 1; a < 4; a++) {
        const sb_real *row = inverse.m[a - 1];
        for (int k = 0; k < 3; k++) {
            planes[a][k] = row[k];
            planes[0][k] -= row[k];
        }
        planes[a][3] = -sb_v3_dot(sb_v3(row[0], row[1], row[2]), x[0]);
        planes[0][3] -= planes[a][3];
    }
    planes[0][3] += 1;
}

/* Boxes of the leaves, then of their parents. */
static void sbi_embed_fill_tree(sbi_embed_volume *volume, const sbi_embed_box *element_boxes)
{
    int elements = volume->mesh->element_count, leaves = volume->leaf_first + 1;
    for (int i = 0; i < leaves; i++) {
        sbi_embed_box *box = &volume->boxes[volume->leaf_first + i];
        *box = sbi_embed_empty_box();
        for (int k = 0; k < SBI_EMBED_LEAF; k++) {
            long long at = (long long)i * SBI_EMBED_LEAF + k;
            if (at < elements)
                sbi_embed_grow(box, element_boxes[volume->order[at]].low, element_boxes[volume->order[at]].high);
        }
    }
    for (int i = volume->leaf_first - 1; i >= 0; i--) {
        volume->boxes[i] = volume->boxes[2 * i + 1];
        sbi_embed_grow(&volume->boxes[i], volume->boxes[2 * i + 2].low, volume->boxes[2 * i + 2].high);
    }
}

/* bulge, planes, order and boxes; scratch for each element: a box, a centre and three numbers. */
static void sbi_embed_fill_elements(sbi_embed_volume *volume, sbi_embed_box *boxes, sb_vec3 *centres, uint32_t *scratch)
{
    const sb_mesh *mesh = volume->mesh;
    for (int e = 0; e < mesh->element_count; e++) {
        sb_vec3 x[SB_MAX_ELEMENT_NODES], margin;
        sb_real bulge;
        sbi_embed_gather(mesh->nodes, mesh->elements + (size_t)e * (size_t)volume->width, volume->width, x);
        bulge = volume->bulge[e] = sbi_embed_bulge(volume, x);
        if (volume->planes)
            sbi_embed_fill_planes(x, volume->planes[e]);
        boxes[e] = sbi_embed_empty_box();
        for (int c = 0; c < volume->corners; c++)
            sbi_embed_grow(&boxes[e], x[c], x[c]);
        margin = sb_v3(bulge, bulge, bulge);
        boxes[e].low = sb_v3_sub(boxes[e].low, margin);
        boxes[e].high = sb_v3_add(boxes[e].high, margin);
        centres[e] = sb_v3_scale((sb_real)0.5, sb_v3_add(boxes[e].low, boxes[e].high));
    }
    sbi_embed_sort(centres, mesh->element_count, volume->order, scratch);
    sbi_embed_fill_tree(volume, boxes);
}

static sb_result sbi_embed_prepare_topology(sbi_embed_volume *volume, sbi_embed_skin skin, sb_error *error)
{
    const sb_allocator *allocator = &volume->allocator;
    size_t entries = (size_t)volume->mesh->element_count * (size_t)volume->faces;
    sb_result result = SB_OK;
    if (skin != SBI_EMBED_BARE)
        result = sb_mesh_neighbours(volume->mesh, allocator, &volume->neighbours, error);
    if (result == SB_OK && skin == SBI_EMBED_SKIN)
        result = sb_mesh_boundary(volume->mesh, 0, allocator, &volume->boundary, error);
    if (result == SB_OK && skin == SBI_EMBED_SKIN)
        result = sb_mesh_neighbours(&volume->boundary.surface, allocator, &volume->face_neighbours, error);
    if (result != SB_OK)
        return result;
    volume->boundary_face = (int *)sbi_alloc(allocator, entries, sizeof(int));
    if (!volume->boundary_face)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the faces of %d elements", volume->mesh->element_count);
    memset(volume->boundary_face, 0xff, entries * sizeof(int));
    for (int f = 0; f < volume->boundary.surface.element_count; f++)
        volume->boundary_face[(size_t)volume->boundary.elements[f] * (size_t)volume->faces +
                              (size_t)volume->boundary.faces[f]] = f;
    return SB_OK;
}

static sb_result sbi_embed_prepare_geometry(sbi_embed_volume *volume, sbi_embed_skin skin, sb_error *error)
{
    const sb_allocator *allocator = &volume->allocator;
    size_t elements = (size_t)volume->mesh->element_count, leaves = 1;
    size_t nodes = skin == SBI_EMBED_SKIN ? (size_t)volume->mesh->node_count : 0;
    size_t entries = (size_t)volume->boundary.surface.element_count * (size_t)volume->face.nodes;
    sbi_embed_box *boxes = (sbi_embed_box *)sbi_alloc(allocator, elements, sizeof(sbi_embed_box));
    sb_vec3 *centres = (sb_vec3 *)sbi_alloc(allocator, elements, sizeof(sb_vec3));
    uint32_t *scratch = (uint32_t *)sbi_alloc(allocator, elements, 3 * sizeof(uint32_t));
    sb_result result = SB_OK;
    while (leaves * SBI_EMBED_LEAF < elements)
        leaves *= 2;
    volume->leaf_first = (int)(leaves - 1);
    volume->boxes = (sbi_embed_box *)sbi_alloc(allocator, 2 * leaves - 1, sizeof(sbi_embed_box));
    volume->order = (int *)sbi_alloc(allocator, elements, sizeof(int));
    volume->bulge = (sb_real *)sbi_alloc(allocator, elements, sizeof(sb_real));
    volume->weights = (sb_real *)sbi_alloc(allocator, entries, sizeof(sb_real));
    volume->normals = (sb_vec3 *)sbi_alloc_zeroed(allocator, nodes, sizeof(sb_vec3));
    if (!volume->is_box)
        volume->planes = (sb_real(*)[4][4])sbi_alloc(allocator, elements, sizeof(sb_real[4][4]));
    if (boxes && centres && scratch && volume->boxes && volume->order && volume->bulge && volume->weights &&
        volume->normals && (volume->is_box || volume->planes)) {
        sbi_embed_fill_elements(volume, boxes, centres, scratch);
        if (skin == SBI_EMBED_SKIN)
            sbi_embed_fill_normals(volume);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory to search %d elements", volume->mesh->element_count);
    }
    sbi_free(allocator, boxes);
    sbi_free(allocator, centres);
    sbi_free(allocator, scratch);
    return result;
}

SBI_API sb_result sbi_embed_volume_create(const sb_mesh *mesh, sbi_embed_skin skin, const sb_allocator *allocator,
                                          sbi_embed_volume *volume, sb_error *error)
{
    sb_result result;
    sb_vec3 low, high;
    memset(volume, 0, sizeof *volume);
    if (allocator)
        volume->allocator = *allocator;
    volume->mesh = mesh;
    volume->width = sb_element_node_count(mesh->element_type);
    volume->corners = sb_element_corner_count(mesh->element_type);
    volume->faces = sb_element_face_count(mesh->element_type);
    volume->is_box = sb_element_straight(mesh->element_type) == SB_HEX8;
    sb_mesh_bounds(mesh, &low, &high);
    volume->scale = sb_max(sb_max(sb_max(sb_abs(low.x), sb_abs(high.x)), sb_max(sb_abs(low.y), sb_abs(high.y))),
                           sb_max(sb_abs(low.z), sb_abs(high.z)));
    result = sbi_embed_prepare_topology(volume, skin, error);
    if (result == SB_OK && skin == SBI_EMBED_SKIN)
        sbi_embed_face_make(volume->boundary.surface.element_type, &volume->face);
    if (result == SB_OK)
        result = sbi_embed_prepare_geometry(volume, skin, error);
    if (result != SB_OK)
        sbi_embed_volume_free(volume);
    return result;
}
