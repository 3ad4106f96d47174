/* embed_search: closest points in curved elements, search tree, smooth normals, feet of points outside. */
#include "embed_search.h"

#include <string.h>

/* Elements of a leaf of the tree; deepest path through it. */
enum { SBI_EMBED_LEAF = 1, SBI_EMBED_DEPTH = 64 };

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

/* Angle of a face at its node i: between its edges at a corner, pi on an edge, the whole turn inside. */
static sb_real sbi_embed_face_angle(const sbi_embed_face *face, const sb_vec3 *x, int i)
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
            t[k] = sb_v3_madd(
                t[k], gradient[j][0] * (ends[k][0] - at[0]) + gradient[j][1] * (ends[k][1] - at[1]), x[j]);
    }
    return sb_atan2(sb_v3_norm(sb_v3_cross(t[0], t[1])), sb_v3_dot(t[0], t[1]));
}

static const int *sbi_embed_face_row(const sbi_embed_volume *volume, int face)
{
    return volume->boundary.surface.elements + (size_t)face * (size_t)volume->face.nodes;
}

static void sbi_embed_gather(const sb_vec3 *from, const int *nodes, int count, sb_vec3 *to)
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

SBI_API void sbi_embed_sort(const sb_vec3 *points, int count, int *order, uint32_t *scratch)
{
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
    sb_mat3 inverse =
        sb_m3_inverse(sb_m3_columns(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0]), sb_v3_sub(x[3], x[0])));
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

static sb_result sbi_embed_prepare_topology(sbi_embed_volume *volume, sb_error *error)
{
    const sb_allocator *allocator = &volume->allocator;
    sb_result result = sb_mesh_boundary(volume->mesh, 0, allocator, &volume->boundary, error);
    size_t entries = (size_t)volume->mesh->element_count * (size_t)volume->faces;
    if (result == SB_OK)
        result = sb_mesh_neighbours(volume->mesh, allocator, &volume->neighbours, error);
    if (result == SB_OK)
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

static sb_result sbi_embed_prepare_geometry(sbi_embed_volume *volume, sb_error *error)
{
    const sb_allocator *allocator = &volume->allocator;
    size_t elements = (size_t)volume->mesh->element_count, nodes = (size_t)volume->mesh->node_count, leaves = 1;
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
        sbi_embed_fill_normals(volume);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory to search %d elements", volume->mesh->element_count);
    }
    sbi_free(allocator, boxes);
    sbi_free(allocator, centres);
    sbi_free(allocator, scratch);
    return result;
}

SBI_API sb_result sbi_embed_volume_create(const sb_mesh *mesh, const sb_allocator *allocator,
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
    result = sbi_embed_prepare_topology(volume, error);
    if (result == SB_OK) {
        sbi_embed_face_make(volume->boundary.surface.element_type, &volume->face);
        result = sbi_embed_prepare_geometry(volume, error);
    }
    if (result != SB_OK)
        sbi_embed_volume_free(volume);
    return result;
}

/* ---- closest point in one element: min |x(xi) - v|^2 with xi in the element ----
 * Levenberg-Marquardt: each trial solves the quadratic model within the element's faces exactly, by the primal
 * active-set method in the free directions (of a tet: from one free corner to the others; of a hex: free axes). For a
 * straight tet the model is exact and the first trial is the answer. */

/* xi and, for tets, all four barycentric coordinates, so that those on a face are exactly 0. active: tets bit a for
 * L_a = 0; hexes bits 2 k and 2 k + 1 for xi_k = -1 and 1. */
typedef struct sbi_embed_state {
    sb_real at[4]; /* tets L_0 .. L_3, hexes xi */
    unsigned active;
} sbi_embed_state;

static void sbi_embed_state_xi(const sbi_embed_state *state, int is_box, sb_real xi[3])
{
    for (int k = 0; k < 3; k++)
        xi[k] = state->at[is_box ? k : k + 1];
}

/* Solves the leading count x count system (count <= 3) of a positive definite matrix; 0 when it is singular. */
static int sbi_embed_solve(sb_real *a, int count, sb_real *b)
{
    if (sb_cholesky_factor(a, count))
        return 0;
    sb_cholesky_solve(a, count, b);
    return 1;
}

/* Free corners (tets) or axes (hexes). */
static int sbi_embed_free_directions(unsigned active, int is_box, int free[4])
{
    int count = 0;
    for (int a = 0; a < (is_box ? 3 : 4); a++)
        if (is_box ? !(active >> (2 * a) & 3u) : !(active >> a & 1u))
            free[count++] = a;
    return count;
}

/* Minimiser of 1/2 p.A p + h.p over the free directions; change[4] in the terms of state->at. */
static int sbi_embed_free_step(const sb_mat3 *a, const sb_real *h, unsigned active, int is_box, sb_real change[4])
{
    sb_real m[9], b[3];
    int free[4], count = sbi_embed_free_directions(active, is_box, free), n = is_box ? count : count - 1;
    change[0] = change[1] = change[2] = change[3] = 0;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            if (is_box) {
                m[i * n + j] = a->m[free[i]][free[j]];
            } else { /* corner 0 is the origin of xi: its row is zero */
                int p = free[i + 1] - 1, q = free[j + 1] - 1, o = free[0] - 1;
                m[i * n + j] = a->m[p][q] - (o < 0 ? (sb_real)0 : a->m[p][o] + a->m[o][q] - a->m[o][o]);
            }
        }
        b[i] = is_box ? -h[free[i]] : (free[0] > 0 ? h[free[0] - 1] : (sb_real)0) - h[free[i + 1] - 1];
    }
    if (n > 0 && !sbi_embed_solve(m, n, b))
        return 0;
    for (int i = 0; i < n; i++) {
        change[free[is_box ? i : i + 1]] += b[i];
        if (!is_box)
            change[free[0]] -= b[i];
    }
    return 1;
}

/* How far along change the element reaches, at most 1; *blocking: the constraint met, or -1. */
static sb_real sbi_embed_reach(const sbi_embed_state *state, const sb_real change[4], int is_box, int *blocking)
{
    sb_real t = 1;
    *blocking = -1;
    for (int a = 0; a < (is_box ? 3 : 4); a++) {
        sb_real room = is_box ? (change[a] > 0 ? 1 - state->at[a] : 1 + state->at[a]) : state->at[a];
        sb_real speed = is_box ? sb_abs(change[a]) : -change[a];
        if (speed > 0 && room < t * speed) {
            t = sb_max(room, 0) / speed;
            *blocking = is_box ? 2 * a + (change[a] > 0) : a;
        }
    }
    return t;
}

/* The active constraint whose release descends most steeply, or -1. h: gradient in xi. */
static int sbi_embed_release(const sb_real *h, unsigned active, int is_box, sb_real tolerance)
{
    int best = -1, base = 0;
    sb_real steepest = -tolerance;
    while (!is_box && base < 3 && active >> base & 1u)
        base++;
    for (int c = 0; c < (is_box ? 6 : 4); c++) {
        sb_real slope;
        if (!(active >> c & 1u))
            continue;
        if (is_box)
            slope = c & 1 ? -h[c / 2] : h[c / 2];
        else
            slope = (c > 0 ? h[c - 1] : (sb_real)0) - (base > 0 ? h[base - 1] : (sb_real)0);
        if (slope < steepest) {
            steepest = slope;
            best = c;
        }
    }
    return best;
}

/* The quadratic model 1/2 p.A p + g.p of half the squared distance around xi = start, p = xi - start. */
typedef struct sbi_embed_model {
    sb_mat3 a;
    sb_real g[3], start[3];
} sbi_embed_model;

static void sbi_embed_model_gradient(const sbi_embed_model *model, const sbi_embed_state *state, int is_box,
                                     sb_real h[3])
{
    sb_real p[3];
    sbi_embed_state_xi(state, is_box, p);
    for (int k = 0; k < 3; k++)
        p[k] -= model->start[k];
    for (int k = 0; k < 3; k++)
        h[k] = model->g[k] + model->a.m[k][0] * p[0] + model->a.m[k][1] * p[1] + model->a.m[k][2] * p[2];
}

/* To the minimum of the model on the active faces, or onto one more of them: 1 in the second case. */
static int sbi_embed_descend(const sbi_embed_model *model, const sb_real h[3], int is_box, sbi_embed_state *state)
{
    sb_real change[4], t;
    int blocking;
    if (!sbi_embed_free_step(&model->a, h, state->active, is_box, change))
        return 0;
    t = sbi_embed_reach(state, change, is_box, &blocking);
    for (int k = 0; k < 4; k++)
        state->at[k] += t * change[k];
    if (blocking < 0)
        return 0;
    state->active |= 1u << blocking;
    if (is_box)
        state->at[blocking / 2] = blocking & 1 ? (sb_real)1 : -(sb_real)1;
    else
        state->at[blocking] = 0;
    return 1;
}

/* Moves state to the minimum of the model within the element. The rounds are bounded only for the sake of rounding:
 * every release is followed by a descent. */
static void sbi_embed_minimise(const sbi_embed_model *model, int is_box, sbi_embed_state *state)
{
    sb_real h[3], tolerance = 64 * SB_EPSILON * (sb_m3_trace(model->a) + sb_abs(model->g[0]) + sb_abs(model->g[1]) +
                                                 sb_abs(model->g[2]));
    for (int round = 0; round < 24; round++) {
        int released;
        sbi_embed_model_gradient(model, state, is_box, h);
        if (sbi_embed_descend(model, h, is_box, state))
            continue;
        sbi_embed_model_gradient(model, state, is_box, h);
        released = sbi_embed_release(h, state->active, is_box, tolerance);
        if (released < 0)
            return;
        state->active &= ~(1u << released);
    }
}

/* x(xi), and its Jacobian's columns if wanted, of an element with nodes at x. */
static sb_vec3 sbi_embed_evaluate(sb_element_type type, const sb_vec3 *x, const sb_real xi[3], sb_mat3 *jacobian)
{
    sb_real shape[SB_MAX_ELEMENT_NODES], gradient[SB_MAX_ELEMENT_NODES][3];
    int count = sb_element_node_count(type);
    sb_vec3 at = sb_v3(0, 0, 0);
    sb_element_shape(type, xi, shape, jacobian ? gradient : NULL);
    for (int a = 0; a < count; a++)
        at = sb_v3_madd(at, shape[a], x[a]);
    if (jacobian) {
        sb_vec3 column[3];
        for (int k = 0; k < 3; k++) {
            column[k] = sb_v3(0, 0, 0);
            for (int a = 0; a < count; a++)
                column[k] = sb_v3_madd(column[k], gradient[a][k], x[a]);
        }
        *jacobian = sb_m3_columns(column[0], column[1], column[2]);
    }
    return at;
}

SBI_API sb_vec3 sbi_embed_map(const sb_mesh *mesh, int element, const sb_real xi[3], sb_mat3 *jacobian)
{
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    int width = sb_element_node_count(mesh->element_type);
    sbi_embed_gather(mesh->nodes, mesh->elements + (size_t)element * (size_t)width, width, x);
    return sbi_embed_evaluate(mesh->element_type, x, xi, jacobian);
}

/* Where to start: the guess in state, or in a curved element a corner or the centre that is nearer. */
static void sbi_embed_start(sb_element_type type, const sb_vec3 *x, sb_vec3 point, int is_box, sbi_embed_state *state)
{
    sb_real nearest = SB_REAL_MAX, xi[3];
    int corners = sb_element_corner_count(type), best = -2;
    sbi_embed_state centre = *state;
    for (int k = 0; k < 4; k++)
        centre.at[k] = is_box ? (sb_real)0 : (sb_real)0.25;
    for (int c = -2; c < corners; c++) { /* guess, centre, corners */
        sb_vec3 offset;
        sb_real d;
        sbi_embed_state_xi(c == -2 ? state : &centre, is_box, xi);
        offset = sb_v3_sub(c >= 0 ? x[c] : sbi_embed_evaluate(type, x, xi, NULL), point);
        d = sb_v3_dot(offset, offset);
        if (d < nearest) {
            nearest = d;
            best = c;
        }
    }
    if (best >= -1)
        *state = centre;
    for (int k = 0; best >= 0 && k < 4; k++)
        state->at[k] = !is_box && k == best ? (sb_real)1 : (sb_real)0;
    if (best >= 0 && is_box)
        sb_element_node_point(type, best, state->at);
}

/* Largest change of parameters between two states. */
static sb_real sbi_embed_state_change(const sbi_embed_state *a, const sbi_embed_state *b)
{
    sb_real largest = 0;
    for (int k = 0; k < 4; k++)
        largest = sb_max(largest, sb_abs(a->at[k] - b->at[k]));
    return largest;
}

/* Levenberg-Marquardt from state; returns the squared distance. flat: the map is linear, one step is exact. */
static sb_real sbi_embed_descend_element(sb_element_type type, const sb_vec3 *x, sb_vec3 point, int flat, int is_box,
                                         sbi_embed_state *state)
{
    const sb_real still = SB_REAL_IS_FLOAT ? (sb_real)1e-4 : (sb_real)1e-7; /* the distance is off by its square */
    sb_real damping = 0, distance2;
    sb_mat3 jacobian;
    sbi_embed_model model;
    sb_vec3 r;
    sbi_embed_state_xi(state, is_box, model.start);
    r = sb_v3_sub(sbi_embed_evaluate(type, x, model.start, &jacobian), point);
    distance2 = sb_v3_dot(r, r);
    for (int step = 0; step < 60 && distance2 > 0; step++) {
        sb_vec3 g = sb_m3_tapply(jacobian, r), trial_r;
        sb_real trial2, trial_xi[3], ridge, change;
        sb_mat3 trial_jacobian;
        sbi_embed_state trial = *state;
        model.a = sb_m3_tmul(jacobian, jacobian);
        ridge = damping * sb_m3_trace(model.a);
        for (int k = 0; k < 3; k++)
            model.a.m[k][k] += ridge;
        model.g[0] = g.x, model.g[1] = g.y, model.g[2] = g.z;
        sbi_embed_state_xi(state, is_box, model.start);
        sbi_embed_minimise(&model, is_box, &trial);
        sbi_embed_state_xi(&trial, is_box, trial_xi);
        trial_r = sb_v3_sub(sbi_embed_evaluate(type, x, trial_xi, &trial_jacobian), point);
        trial2 = sb_v3_dot(trial_r, trial_r);
        change = sbi_embed_state_change(&trial, state);
        if (trial2 < distance2 || (trial2 <= distance2 && trial.active != state->active)) {
            *state = trial;
            distance2 = trial2;
            jacobian = trial_jacobian;
            r = trial_r;
            damping = damping > (sb_real)1e-4 ? damping / 10 : (sb_real)0;
        } else {
            damping = sb_max(10 * damping, (sb_real)1e-4);
        }
        if (flat || change < still)
            break;
    }
    return distance2;
}

/* ---- closest element ---- */

/* A search under way. */
typedef struct sbi_embed_query {
    const sbi_embed_volume *volume;
    sb_vec3 point;
    sb_real enough; /* squared distance that counts as inside */
    sbi_embed_hit best;
} sbi_embed_query;

/* The face of a tet opposite each corner. */
static const unsigned char sbi_embed_opposite[4] = {1, 2, 0, 3};

/* 1 for a tet that is straight but for the rounding of its nodes, as of those read from a file. */
static int sbi_embed_is_flat(const sbi_embed_volume *volume, int element)
{
    const int *nodes = volume->mesh->elements + (size_t)element * (size_t)volume->width;
    sb_vec3 edge = sb_v3_sub(volume->mesh->nodes[nodes[1]], volume->mesh->nodes[nodes[0]]);
    return !volume->is_box && volume->bulge[element] <= (sb_real)1e-5 * sb_v3_norm(edge);
}

/* Faces of active constraints: tet face of L_a = 0, hex faces in the order of the bits. */
static unsigned sbi_embed_active_faces(unsigned active, int is_box)
{
    unsigned faces = 0;
    if (is_box)
        return active;
    for (int a = 0; a < 4; a++)
        if (active >> a & 1u)
            faces |= 1u << sbi_embed_opposite[a];
    return faces;
}

/* Barycentric coordinates in the straight tet; returns a lower bound of the distance to the element (m). */
static sb_real sbi_embed_planes(const sbi_embed_volume *volume, int element, sb_vec3 point, sb_real bary[4])
{
    sb_real bound = 0;
    for (int a = 0; a < 4; a++) {
        const sb_real *p = volume->planes[element][a];
        bary[a] = p[0] * point.x + p[1] * point.y + p[2] * point.z + p[3];
        if (bary[a] < 0)
            bound = sb_max(bound, -bary[a] / sb_sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]));
    }
    return bound - volume->bulge[element];
}

/* Takes the element's closest point when it beats the best so far. */
static void sbi_embed_try(sbi_embed_query *query, int element)
{
    const sbi_embed_volume *volume = query->volume;
    const sb_mesh *mesh = volume->mesh;
    sb_element_type type = mesh->element_type;
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    sbi_embed_state state;
    sb_real distance2;
    int flat = sbi_embed_is_flat(volume, element);
    memset(&state, 0, sizeof state);
    if (!volume->is_box) {
        sb_real bound = sbi_embed_planes(volume, element, query->point, state.at), sum = 0;
        if (bound > 0 && bound * bound >= query->best.distance2)
            return;
        for (int a = 0; a < 4; a++) {
            state.at[a] = sb_max(state.at[a], 0);
            sum += state.at[a];
        }
        for (int a = 0; a < 4; a++)
            state.at[a] /= sum;
    }
    sbi_embed_gather(mesh->nodes, mesh->elements + (size_t)element * (size_t)volume->width, volume->width, x);
    if (flat)
        type = SB_TET4;
    else
        sbi_embed_start(type, x, query->point, volume->is_box, &state);
    distance2 = sbi_embed_descend_element(type, x, query->point, flat, volume->is_box, &state);
    if (distance2 < query->best.distance2) {
        query->best.element = element;
        query->best.distance2 = distance2;
        query->best.active = sbi_embed_active_faces(state.active, volume->is_box);
        sbi_embed_state_xi(&state, volume->is_box, query->best.xi);
    }
}

/* Walks through straight tets across the face that the point lies farthest beyond, towards a good start. */
static int sbi_embed_walk(const sbi_embed_query *query, int element)
{
    const sbi_embed_volume *volume = query->volume;
    int before = -1;
    for (int step = 0; step < 1000 && !volume->is_box; step++) {
        sb_real bary[4], lowest = 0;
        int next = -1;
        sbi_embed_planes(volume, element, query->point, bary);
        for (int a = 0; a < 4; a++) {
            int other = volume->neighbours.items[4 * (size_t)element + sbi_embed_opposite[a]];
            if (bary[a] < lowest && other >= 0 && other != before) {
                lowest = bary[a];
                next = other;
            }
        }
        if (next < 0)
            break;
        before = element;
        element = next;
    }
    return element;
}

static sb_real sbi_embed_box_distance2(const sbi_embed_box *box, sb_vec3 p)
{
    sb_real x = sb_max(sb_max(box->low.x - p.x, p.x - box->high.x), 0);
    sb_real y = sb_max(sb_max(box->low.y - p.y, p.y - box->high.y), 0);
    sb_real z = sb_max(sb_max(box->low.z - p.z, p.z - box->high.z), 0);
    return x * x + y * y + z * z;
}

/* Branch and bound: every element whose box is nearer than the best so far, nearer boxes first. */
static void sbi_embed_search_tree(sbi_embed_query *query)
{
    const sbi_embed_volume *volume = query->volume;
    int stack[SBI_EMBED_DEPTH], depth = 0;
    stack[depth++] = 0;
    while (depth > 0 && query->best.distance2 > query->enough) {
        int box = stack[--depth];
        if (sbi_embed_box_distance2(&volume->boxes[box], query->point) >= query->best.distance2)
            continue;
        if (box < volume->leaf_first) {
            int left = 2 * box + 1, right = left + 1;
            int left_first = sbi_embed_box_distance2(&volume->boxes[left], query->point) <=
                             sbi_embed_box_distance2(&volume->boxes[right], query->point);
            stack[depth++] = left_first ? right : left;
            stack[depth++] = left_first ? left : right;
        } else {
            for (int k = 0; k < SBI_EMBED_LEAF; k++) {
                long long at = (long long)(box - volume->leaf_first) * SBI_EMBED_LEAF + k;
                if (at < volume->mesh->element_count)
                    sbi_embed_try(query, volume->order[at]);
            }
        }
    }
}

/* Newton for x(xi) = point without bounds: a point inside solves it to rounding. */
static void sbi_embed_polish(const sbi_embed_volume *volume, sb_vec3 point, sbi_embed_hit *hit)
{
    for (int step = 0; step < 3; step++) {
        sb_mat3 jacobian;
        sb_vec3 r = sb_v3_sub(point, sbi_embed_map(volume->mesh, hit->element, hit->xi, &jacobian));
        sb_vec3 change;
        if (!(sb_m3_det(jacobian) > 0))
            return;
        change = sb_m3_apply(sb_m3_inverse(jacobian), r);
        hit->xi[0] += change.x;
        hit->xi[1] += change.y;
        hit->xi[2] += change.z;
        if (sb_abs(change.x) + sb_abs(change.y) + sb_abs(change.z) < 4 * SB_EPSILON)
            return;
    }
}

/* 1 when the hit lies on a face of its element that is a boundary face. */
static int sbi_embed_hit_is_outer(const sbi_embed_volume *volume, const sbi_embed_hit *hit)
{
    const int *outer = volume->boundary_face + (size_t)hit->element * (size_t)volume->faces;
    for (int f = 0; f < volume->faces; f++)
        if (hit->active >> f & 1u && outer[f] >= 0)
            return 1;
    return 0;
}

/* A closest point on an edge or corner may have been found in an element without a boundary face there: goes on through
 * the faces that it lies on to one that has. Leaves the hit as it is when there is none among the nearest. */
static void sbi_embed_reach_boundary(const sbi_embed_query *query, sbi_embed_hit *hit)
{
    enum { MOST = 64 };
    const sbi_embed_volume *volume = query->volume;
    sbi_embed_hit queue[MOST];
    int count = 1;
    queue[0] = *hit;
    for (int i = 0; i < count; i++) {
        if (sbi_embed_hit_is_outer(volume, &queue[i])) {
            *hit = queue[i];
            return;
        }
        for (int f = 0; f < volume->faces; f++) {
            int next = volume->neighbours.items[(size_t)queue[i].element * (size_t)volume->faces + (size_t)f];
            int known = next < 0 || count == MOST || !(queue[i].active >> f & 1u);
            sbi_embed_query there = *query;
            for (int k = 0; k < count && !known; k++)
                known = queue[k].element == next;
            if (known)
                continue;
            there.best.distance2 = hit->distance2 * ((sb_real)1 + 100 * sb_sqrt(SB_EPSILON));
            there.best.element = -1;
            sbi_embed_try(&there, next);
            if (there.best.element >= 0)
                queue[count++] = there.best;
        }
    }
}

SBI_API void sbi_embed_closest(const sbi_embed_volume *volume, sb_vec3 point, int hint, sbi_embed_hit *hit)
{
    sbi_embed_query query;
    sb_real slack = 64 * SB_EPSILON * volume->scale;
    query.volume = volume;
    query.point = point;
    query.best.element = hint;
    query.best.xi[0] = query.best.xi[1] = query.best.xi[2] = 0;
    query.best.active = 0;
    query.best.distance2 = SB_REAL_MAX;
    query.enough = slack * slack;
    sbi_embed_try(&query, sbi_embed_walk(&query, hint));
    sbi_embed_search_tree(&query);
    if (sbi_embed_is_flat(volume, query.best.element)) /* the straight tet that stood in for it is off by as much */
        slack += volume->bulge[query.best.element];
    if (query.best.distance2 <= slack * slack) {
        query.best.distance2 = 0;
        sbi_embed_polish(volume, point, &query.best);
    } else {
        sbi_embed_reach_boundary(&query, &query.best);
    }
    *hit = query.best;
}

/* ---- feet: x(r, s) + d n(r, s) = point ---- */

/* How far (r, s) lies outside a face, and the edge it lies beyond. */
static sb_real sbi_embed_face_excess(const sbi_embed_face *face, const sbi_embed_foot *foot, int *edge)
{
    sb_real excess[4], largest;
    if (face->corners == 3) {
        excess[0] = -foot->s;
        excess[1] = foot->r + foot->s - 1;
        excess[2] = -foot->r;
    } else {
        excess[0] = -1 - foot->s;
        excess[1] = foot->r - 1;
        excess[2] = foot->s - 1;
        excess[3] = -1 - foot->r;
    }
    *edge = 0;
    largest = excess[0];
    for (int e = 1; e < face->corners; e++)
        if (excess[e] > largest) {
            largest = excess[e];
            *edge = e;
        }
    return largest;
}

/* Moves foot to the same place on the edge of the neighbouring face; 0 when there is none. */
static int sbi_embed_cross_edge(const sbi_embed_volume *volume, int edge, sbi_embed_foot *foot)
{
    const sbi_embed_face *face = &volume->face;
    int next = volume->face_neighbours.items[(size_t)foot->face * (size_t)face->corners + (size_t)edge];
    const int *here = sbi_embed_face_row(volume, foot->face), *there;
    sb_real a[3], b[3], along, length2;
    int ends[2] = {here[edge], here[(edge + 1) % face->corners]}, local[2] = {-1, -1};
    if (next < 0)
        return 0;
    sb_element_node_point(face->type, edge, a);
    sb_element_node_point(face->type, (edge + 1) % face->corners, b);
    length2 = (b[0] - a[0]) * (b[0] - a[0]) + (b[1] - a[1]) * (b[1] - a[1]);
    along = ((foot->r - a[0]) * (b[0] - a[0]) + (foot->s - a[1]) * (b[1] - a[1])) / length2;
    along = sb_min(sb_max(along, 0), 1);
    there = sbi_embed_face_row(volume, next);
    for (int c = 0; c < face->corners; c++)
        for (int k = 0; k < 2; k++)
            if (there[c] == ends[k])
                local[k] = c;
    if (local[0] < 0 || local[1] < 0)
        return 0;
    sb_element_node_point(face->type, local[0], a);
    sb_element_node_point(face->type, local[1], b);
    foot->face = next;
    foot->r = a[0] + along * (b[0] - a[0]);
    foot->s = a[1] + along * (b[1] - a[1]);
    return 1;
}

SBI_API sb_vec3 sbi_embed_foot_tangents(const sbi_embed_volume *volume, const sbi_embed_foot *foot,
                                        sb_vec3 tangents[2])
{
    const int *nodes = sbi_embed_face_row(volume, foot->face);
    sb_real shape[SB_MAX_FACE_NODES], gradient[SB_MAX_FACE_NODES][3], xi[3];
    sb_vec3 x = sb_v3(0, 0, 0);
    xi[0] = foot->r, xi[1] = foot->s, xi[2] = 0;
    tangents[0] = tangents[1] = x;
    sb_element_shape(volume->face.type, xi, shape, gradient);
    for (int i = 0; i < volume->face.nodes; i++) {
        sb_vec3 node = volume->mesh->nodes[nodes[i]];
        x = sb_v3_madd(x, shape[i], node);
        for (int k = 0; k < 2; k++)
            tangents[k] = sb_v3_madd(tangents[k], gradient[i][k], node);
    }
    return x;
}

SBI_API int sbi_embed_foot_map(const sbi_embed_volume *volume, const sbi_embed_foot *foot, sb_vec3 *at,
                               sb_mat3 *jacobian)
{
    const int *nodes = sbi_embed_face_row(volume, foot->face);
    sb_real shape[SB_MAX_FACE_NODES], gradient[SB_MAX_FACE_NODES][3], xi[3], length, inverse, flat_det;
    sb_vec3 x = sb_v3(0, 0, 0), m = x, dx[2], dm[2], n;
    dx[0] = dx[1] = dm[0] = dm[1] = x;
    xi[0] = foot->r, xi[1] = foot->s, xi[2] = 0;
    sb_element_shape(volume->face.type, xi, shape, gradient);
    for (int i = 0; i < volume->face.nodes; i++) {
        sb_vec3 node = volume->mesh->nodes[nodes[i]], normal = volume->normals[nodes[i]];
        x = sb_v3_madd(x, shape[i], node);
        m = sb_v3_madd(m, shape[i], normal);
        for (int k = 0; k < 2; k++) {
            dx[k] = sb_v3_madd(dx[k], gradient[i][k], node);
            dm[k] = sb_v3_madd(dm[k], gradient[i][k], normal);
        }
    }
    length = sb_v3_norm(m);
    if (!(length > (sb_real)0.1))
        return 0;
    inverse = 1 / length;
    n = sb_v3_scale(inverse, m);
    *at = sb_v3_madd(x, foot->distance, n);
    flat_det = sb_v3_dot(sb_v3_cross(dx[0], dx[1]), n);
    for (int k = 0; k < 2; k++) /* n_,k = (I - n n^T) m_,k / |m| */
        dx[k] = sb_v3_madd(dx[k], foot->distance * inverse, sb_v3_madd(dm[k], -sb_v3_dot(n, dm[k]), n));
    *jacobian = sb_m3_columns(dx[0], dx[1], n);
    /* close to a centre of curvature, where neighbouring normals meet, small strains would move the point far */
    return flat_det > 0 && sb_m3_det(*jacobian) > (sb_real)0.1 * flat_det;
}

/* Newton on one face and its continuation. 1: solved (perhaps outside the face), 0: gave up there. */
static int sbi_embed_foot_newton(const sbi_embed_volume *volume, sb_vec3 point, sbi_embed_foot *foot)
{
    sb_real tolerance = 16 * SB_EPSILON * (volume->scale + sb_v3_norm(point));
    for (int step = 0; step < 12; step++) {
        sb_mat3 jacobian;
        sb_vec3 at, r;
        int edge;
        if (!sbi_embed_foot_map(volume, foot, &at, &jacobian))
            return 0;
        r = sb_v3_sub(point, at);
        if (sb_v3_norm(r) <= tolerance)
            return 1;
        r = sb_m3_apply(sb_m3_inverse(jacobian), r);
        foot->r += r.x;
        foot->s += r.y;
        foot->distance += r.z;
        if (!(sbi_embed_face_excess(&volume->face, foot, &edge) < (sb_real)0.5))
            return 1; /* leave the face rather than trust its continuation */
    }
    return 0;
}

/* From one face over edges until the foot lies on the face it was solved for. */
static int sbi_embed_follow_foot(const sbi_embed_volume *volume, sb_vec3 point, sb_real farthest, sbi_embed_foot *foot)
{
    const sb_real inside = 10000 * SB_EPSILON; /* (r, s) this far beyond an edge still belong to the face */
    for (int visit = 0; visit < 16; visit++) {
        int edge;
        sbi_embed_foot before = *foot;
        if (!sbi_embed_foot_newton(volume, point, foot) || !sb_is_finite(foot->r + foot->s + foot->distance))
            return 0;
        if (sbi_embed_face_excess(&volume->face, foot, &edge) <= inside)
            return foot->distance > 0 && foot->distance <= farthest;
        foot->distance = before.distance;
        if (!sbi_embed_cross_edge(volume, edge, foot))
            return 0;
    }
    return 0;
}

/* (r, s) on boundary face f of a point xi of its element. */
static sbi_embed_foot sbi_embed_face_foot(const sbi_embed_volume *volume, int face, const sb_real xi[3])
{
    sbi_embed_foot foot;
    int nodes[SB_MAX_FACE_NODES], corner = volume->is_box ? 3 : 2;
    sb_real p[3][3], rs[2];
    sb_element_face(volume->mesh->element_type, volume->boundary.faces[face], nodes, NULL);
    sb_element_node_point(volume->mesh->element_type, nodes[0], p[0]);
    sb_element_node_point(volume->mesh->element_type, nodes[1], p[1]);
    sb_element_node_point(volume->mesh->element_type, nodes[corner], p[2]);
    foot.face = face;
    foot.distance = 0;
    if (volume->is_box) { /* the edges from corner 0 have length 2 along an axis */
        for (int i = 0; i < 2; i++) {
            rs[i] = -1;
            for (int k = 0; k < 3; k++)
                rs[i] += (xi[k] - p[0][k]) * (p[i + 1][k] - p[0][k]) / 2;
        }
    } else { /* L of the face's second and third corner */
        for (int i = 0; i < 2; i++)
            rs[i] = nodes[i + 1] > 0 ? xi[nodes[i + 1] - 1] : 1 - xi[0] - xi[1] - xi[2];
    }
    foot.r = rs[0];
    foot.s = rs[1];
    return foot;
}

SBI_API int sbi_embed_find_foot(const sbi_embed_volume *volume, sb_vec3 point, const sbi_embed_hit *hit,
                                sbi_embed_foot *foot)
{
    sb_real distance = sb_sqrt(hit->distance2);
    for (int f = 0; f < volume->faces; f++) {
        int face = volume->boundary_face[(size_t)hit->element * (size_t)volume->faces + (size_t)f];
        sbi_embed_foot trial;
        if (!(hit->active >> f & 1u) || face < 0)
            continue;
        trial = sbi_embed_face_foot(volume, face, hit->xi);
        trial.distance = distance;
        if (sbi_embed_follow_foot(volume, point, 3 * distance, &trial)) {
            *foot = trial;
            return 1;
        }
    }
    return 0;
}

SBI_API sbi_embed_foot sbi_embed_hit_foot(const sbi_embed_volume *volume, const sbi_embed_hit *hit)
{
    sbi_embed_foot foot;
    memset(&foot, 0, sizeof foot);
    foot.face = -1;
    for (int f = 0; f < volume->faces && foot.face < 0; f++) {
        int face = volume->boundary_face[(size_t)hit->element * (size_t)volume->faces + (size_t)f];
        if (hit->active >> f & 1u && face >= 0)
            foot = sbi_embed_face_foot(volume, face, hit->xi);
    }
    return foot;
}

SBI_API int sbi_embed_foot_element(const sbi_embed_volume *volume, const sbi_embed_foot *foot, sb_real xi[3])
{
    int nodes[SB_MAX_FACE_NODES], element = volume->boundary.elements[foot->face];
    sb_real at[3], shape[SB_MAX_FACE_NODES];
    at[0] = foot->r, at[1] = foot->s, at[2] = 0;
    sb_element_shape(sb_element_straight(volume->face.type), at, shape, NULL);
    sb_element_face(volume->mesh->element_type, volume->boundary.faces[foot->face], nodes, NULL);
    xi[0] = xi[1] = xi[2] = 0;
    for (int c = 0; c < volume->face.corners; c++) {
        sb_real corner[3];
        sb_element_node_point(volume->mesh->element_type, nodes[c], corner);
        for (int k = 0; k < 3; k++)
            xi[k] += shape[c] * corner[k];
    }
    return element;
}
