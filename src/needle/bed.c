/* bed: see bed.h. */
#include "bed.h"

#include <string.h>

#include "image.h"

/* ---- creation ---- */

static uint64_t ndli_bed_hash(const ndli_bed *bed)
{
    size_t elements = (size_t)bed->mesh.element_count, corners = elements * (size_t)sb_mesh_element_width(&bed->mesh);
    uint64_t hash = ndli_image_hash(elements, bed->cells, elements * sizeof(int));
    hash = ndli_image_hash(hash, bed->mesh.elements, corners * sizeof(int));
    for (size_t i = 0; i < corners; i++)
        hash = ndli_image_hash(hash, bed->mesh.nodes + bed->mesh.elements[i], sizeof(sb_vec3));
    return hash;
}

/* Faces of tets are equilateral triangles where the mesh is even, those of hexes squares. */
static double ndli_bed_edge_of(const ndli_bed *bed, double volume)
{
    return cbrt(bed->volume.is_box ? volume : 6 * sqrt(2.0) * volume);
}

/* The mesh that there is, and which cells its elements are. */
static sb_result ndli_bed_copy_mesh(ndli_bed *bed, const sb_body *mesh_of, sb_error *error)
{
    sb_result result = sbi_body_copy_mesh(mesh_of, &bed->allocator, &bed->mesh, error);
    if (result != SB_OK)
        return result;
    bed->was_cut = sbi_body_has_pieces(mesh_of);
    bed->cells = (int *)sbi_alloc(&bed->allocator, (size_t)bed->mesh.element_count, sizeof(int));
    if (!bed->cells)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a body's needles");
    sbi_body_list_cells(mesh_of, bed->cells);
    return SB_OK;
}

NDLI_API sb_result ndli_bed_create(sb_body *body, const sb_body *mesh_of, int uncut, const sb_allocator *allocator,
                                   ndli_bed *bed, sb_error *error)
{
    sb_result result;
    memset(bed, 0, sizeof *bed);
    bed->body = body;
    bed->allocator = *allocator;
    bed->version = sb_body_mesh_version(mesh_of);
    if (sbi_body_mesh(mesh_of).element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "needles do not go into elements of your own (SB_CUSTOM)");
    result = uncut ? sbi_body_copy_uncut(mesh_of, body, allocator, &bed->mesh, &bed->cells, error)
                   : ndli_bed_copy_mesh(bed, mesh_of, error);
    if (result == SB_OK)
        result = sbi_embed_volume_create(&bed->mesh, SBI_EMBED_SKIN, allocator, &bed->volume, error);
    if (result != SB_OK)
        memset(&bed->volume, 0, sizeof bed->volume); /* it has been freed */
    if (result != SB_OK) {
        ndli_bed_free(bed);
        return result;
    }
    bed->hash = ndli_bed_hash(bed);
    bed->mean_edge = ndli_bed_edge_of(bed, (double)sb_mesh_volume(&bed->mesh) / bed->mesh.element_count);
    return SB_OK;
}

NDLI_API void ndli_bed_free(ndli_bed *bed)
{
    if (bed->volume.mesh)
        sbi_embed_volume_free(&bed->volume);
    if (bed->cells)
        sbi_free(&bed->allocator, bed->cells);
    sb_mesh_free(&bed->mesh);
    memset(bed, 0, sizeof *bed);
}

NDLI_API void ndli_bed_replace(ndli_bed *bed, ndli_bed *next)
{
    ndli_bed_free(bed);
    *bed = *next;
    bed->volume.mesh = &bed->mesh;
    memset(next, 0, sizeof *next);
}

/* ---- places ---- */

/* Lengths below this are rounding (m). */
static double ndli_bed_rounding(const ndli_bed *bed) { return 1e-3 * bed->mean_edge; }

/* The nearest place of the mesh; returns how far off it is (m). */
static double ndli_bed_closest(const ndli_bed *bed, sb_vec3 X, int hint, ndli_place *place)
{
    sbi_embed_hit hit;
    sbi_embed_closest(&bed->volume, X, sbi_min_int(hint, bed->mesh.element_count - 1), &hit);
    place->element = hit.element;
    memcpy(place->xi, hit.xi, sizeof place->xi);
    return hit.distance2 > 0 ? sqrt((double)hit.distance2) : 0;
}

NDLI_API int ndli_bed_locate(const ndli_bed *bed, sb_vec3 X, int hint, ndli_place *place)
{
    return !(ndli_bed_closest(bed, X, hint, place) > 0);
}

/* The cell with its material; -1: it has been taken away. */
static int ndli_bed_holder(const ndli_bed *bed, const ndli_place *place)
{
    int element = place->element;
    return sbi_body_find_holder(bed->body, &bed->mesh, element, bed->cells[element], place->xi);
}

/* 1: the row is of the place's material. A cell whose material was taken away leaves its slot to others. */
static int ndli_bed_is_row_of(const ndli_bed *bed, const ndli_place *place, const ndli_bed_row *row)
{
    const int *nodes = bed->mesh.elements + (size_t)place->element * (size_t)row->count;
    const sb_vec3 *X = sb_body_rest_positions(bed->body);
    ndli_v3 gap = ndli_v(0, 0, 0);
    for (int a = 0; a < row->count; a++)
        gap = ndli_madd(gap, row->weights[a], ndli_from(sb_v3_sub(X[row->nodes[a]], bed->mesh.nodes[nodes[a]])));
    return ndli_norm(gap) < ndli_bed_rounding(bed);
}

NDLI_API int ndli_bed_row_at(const ndli_bed *bed, const ndli_place *place, ndli_bed_row *row)
{
    sb_mesh mesh = sbi_body_mesh(bed->body);
    sb_real shape[SB_MAX_ELEMENT_NODES];
    const int *nodes;
    row->cell = ndli_bed_holder(bed, place);
    row->count = sb_mesh_element_width(&mesh);
    if (row->cell < 0 || !sb_body_cell_in_use(bed->body, row->cell))
        return 0;
    nodes = mesh.elements + (size_t)row->cell * (size_t)row->count;
    sb_element_shape(mesh.element_type, place->xi, shape, NULL);
    for (int a = 0; a < row->count; a++) {
        row->nodes[a] = nodes[a];
        row->weights[a] = (double)shape[a];
    }
    return ndli_bed_is_row_of(bed, place, row);
}

NDLI_API int ndli_bed_find(const ndli_bed *bed, sb_vec3 X, int hint, ndli_place *place, ndli_bed_row *row)
{
    if (!(ndli_bed_closest(bed, X, hint, place) > ndli_bed_rounding(bed)) && ndli_bed_row_at(bed, place, row))
        return 1;
    row->count = 0;
    return 0;
}

NDLI_API ndli_v3 ndli_bed_at(const ndli_bed *bed, const ndli_bed_row *row)
{
    const sb_vec3 *x = sb_body_positions(bed->body);
    ndli_v3 sum = ndli_v(0, 0, 0);
    for (int a = 0; a < row->count; a++)
        sum = ndli_madd(sum, row->weights[a], ndli_from(x[row->nodes[a]]));
    return sum;
}

NDLI_API sb_mat3 ndli_bed_gradient(const ndli_bed *bed, const ndli_place *place, const ndli_bed_row *row)
{
    const sb_vec3 *x = sb_body_positions(bed->body), *X = sb_body_rest_positions(bed->body);
    sb_real gradient[SB_MAX_ELEMENT_NODES][3];
    sb_mat3 now = sb_m3_zero(), rest = sb_m3_zero();
    sb_element_shape(bed->mesh.element_type, place->xi, NULL, gradient);
    for (int a = 0; a < row->count; a++) {
        sb_vec3 g = sb_v3(gradient[a][0], gradient[a][1], gradient[a][2]);
        now = sb_m3_add(now, sb_m3_outer(x[row->nodes[a]], g));
        rest = sb_m3_add(rest, sb_m3_outer(X[row->nodes[a]], g));
    }
    return sb_m3_mul(now, sb_m3_inverse(rest));
}

NDLI_API int ndli_bed_region(const ndli_bed *bed, const ndli_bed_row *row)
{
    return sbi_body_cell_region(bed->body, row->cell);
}

NDLI_API double ndli_bed_edge(const ndli_bed *bed, int element)
{
    return ndli_bed_edge_of(bed, fabs((double)sb_mesh_element_volume(&bed->mesh, element)));
}

/* ---- the skin ---- */

/* Where the segment comes in through a triangle, as a share of it; < 0: not. w: weights of the corners. */
static sb_real ndli_bed_cross(sb_vec3 from, sb_vec3 way, const sb_vec3 x[3], sb_real w[3])
{
    sb_vec3 ab = sb_v3_sub(x[1], x[0]), ac = sb_v3_sub(x[2], x[0]), n = sb_v3_cross(ab, ac);
    sb_vec3 to = sb_v3_sub(from, x[0]), q = sb_v3_cross(to, way);
    sb_real det = -sb_v3_dot(way, n), along;
    if (!(det > 0))
        return -1;
    w[1] = sb_v3_dot(ac, q) / det;
    w[2] = -sb_v3_dot(ab, q) / det;
    w[0] = 1 - w[1] - w[2];
    along = sb_v3_dot(to, n) / det;
    return w[0] >= 0 && w[1] >= 0 && w[2] >= 0 && along >= 0 && along <= 1 ? along : -1;
}

/* A triangle of a boundary face: local nodes of its corners in the face's element. */
typedef struct ndli_bed_triangle {
    int element, corners[3];
} ndli_bed_triangle;

static ndli_bed_triangle ndli_bed_triangle_of(const ndli_bed *bed, int face, int part)
{
    ndli_bed_triangle t;
    int local[SB_MAX_FACE_NODES];
    sb_element_type type;
    t.element = bed->volume.boundary.elements[face];
    sb_element_face(bed->mesh.element_type, bed->volume.boundary.faces[face], local, &type);
    for (int k = 0; k < 3; k++)
        t.corners[k] = local[k == 0 ? 0 : part + k];
    return t;
}

/* Nodes of the body, of a cell, and of an element as it was at first. */
static const int *ndli_bed_nodes_of(const ndli_bed *bed, int cell)
{
    sb_mesh mesh = sbi_body_mesh(bed->body);
    return mesh.elements + (size_t)cell * (size_t)sb_mesh_element_width(&mesh);
}
static const int *ndli_bed_first_nodes(const ndli_bed *bed, int element)
{
    return bed->mesh.elements + (size_t)element * (size_t)sb_mesh_element_width(&bed->mesh);
}

/* Where the segment comes in through the triangle as its element has it with these nodes; the place is straight between
 * the corners. < 0: not. */
static sb_real ndli_bed_cross_nodes(const ndli_bed *bed, const ndli_bed_triangle *t, const int *nodes, sb_vec3 from,
                                    sb_vec3 way, ndli_place *place)
{
    const sb_vec3 *x = sb_body_positions(bed->body);
    const int *rest = ndli_bed_first_nodes(bed, t->element);
    sb_vec3 corners[3], X = {0, 0, 0};
    sb_real w[3], along;
    for (int k = 0; k < 3; k++)
        corners[k] = x[nodes[t->corners[k]]];
    along = ndli_bed_cross(from, way, corners, w);
    if (along < 0)
        return -1;
    for (int k = 0; k < 3; k++)
        X = sb_v3_madd(X, w[k], bed->mesh.nodes[rest[t->corners[k]]]);
    (void)ndli_bed_locate(bed, X, t->element, place);
    return along;
}

/* Of an element that is cut each piece has only that part of the face that has its material. */
static sb_real ndli_bed_cross_kept(const ndli_bed *bed, const ndli_bed_triangle *t, sb_vec3 from, sb_vec3 way,
                                   ndli_place *place)
{
    int cell = bed->cells[t->element], holder;
    sb_real along = ndli_bed_cross_nodes(bed, t, ndli_bed_nodes_of(bed, cell), from, way, place);
    if (along < 0)
        return -1;
    holder = ndli_bed_holder(bed, place);
    if (holder != cell && !bed->was_cut && holder >= 0) { /* one that was cut before has each piece's own triangles */
        along = ndli_bed_cross_nodes(bed, t, ndli_bed_nodes_of(bed, holder), from, way, place);
        cell = holder;
        holder = along < 0 ? -1 : ndli_bed_holder(bed, place);
    }
    return holder == cell && sb_body_cell_in_use(bed->body, cell) ? along : -1;
}

/* Where skin has been taken away, a hole's mouth is. */
static sb_real ndli_bed_cross_skin(const ndli_bed *bed, const ndli_bed_triangle *t, sb_vec3 from, sb_vec3 way,
                                   ndli_place *place)
{
    sb_real along = ndli_bed_cross_kept(bed, t, from, way, place);
    if (along >= 0)
        return along;
    along = ndli_bed_cross_nodes(bed, t, ndli_bed_first_nodes(bed, t->element), from, way, place);
    return along >= 0 && ndli_bed_holder(bed, place) < 0 ? along : -1;
}

NDLI_API int ndli_bed_hit(const ndli_bed *bed, sb_vec3 from, sb_vec3 to, ndli_place *place, sb_vec3 *at)
{
    sb_vec3 way = sb_v3_sub(to, from);
    sb_real nearest = 2;
    for (int f = 0; f < bed->volume.boundary.surface.element_count; f++)
        for (int part = 0; part < bed->volume.face.corners - 2; part++) {
            ndli_bed_triangle t = ndli_bed_triangle_of(bed, f, part);
            ndli_place here;
            sb_real along = ndli_bed_cross_skin(bed, &t, from, way, &here);
            if (along < 0 || !(along < nearest))
                continue;
            nearest = along;
            *place = here;
        }
    *at = sb_v3_madd(from, nearest, way);
    return nearest <= 1;
}

NDLI_API int ndli_bed_holds_in_space(const ndli_bed *bed, sb_vec3 x)
{
    const sb_vec3 *nodes = sb_body_positions(bed->body);
    sb_vec3 far_off;
    sb_real size = (sb_real)bed->mean_edge;
    int layers = 0;
    for (int i = 0; i < sb_body_node_count(bed->body); i++)
        size = sb_max(size, sb_v3_norm(sb_v3_sub(nodes[i], x)));
    far_off = sb_v3_madd(x, 2 * size, sb_v3((sb_real)0.793, (sb_real)0.471, (sb_real)0.387)); /* along no edges */
    for (int f = 0; f < bed->volume.boundary.surface.element_count; f++)
        for (int part = 0; part < bed->volume.face.corners - 2; part++) {
            ndli_bed_triangle t = ndli_bed_triangle_of(bed, f, part);
            ndli_place place;
            layers += ndli_bed_cross_skin(bed, &t, far_off, sb_v3_sub(x, far_off), &place) >= 0;
            layers -= ndli_bed_cross_skin(bed, &t, x, sb_v3_sub(far_off, x), &place) >= 0;
        }
    return layers > 0;
}
