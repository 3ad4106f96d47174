/* embed_foot: feet of points outside: x(r, s) + d n(r, s) of a boundary face and its smooth normal. */
#include "embed_search.h"

#include <string.h>

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

SBI_API sb_vec3 sbi_embed_foot_tangents(const sbi_embed_volume *volume, const sbi_embed_foot *foot, sb_vec3 tangents[2])
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
        sb_real corner[3] = {0, 0, 0};
        sb_element_node_point(volume->mesh->element_type, nodes[c], corner);
        for (int k = 0; k < 3; k++)
            xi[k] += shape[c] * corner[k];
    }
    return element;
}
