/* body_support: nodes that are held, faces by their corners, and what holds the parts of a body. */
#include "body.h"
#include "body_private.h"
#include "cable_law.h"
#include "live_private.h"
#include "rigid_private.h"

#include <string.h>

/* ---- faces ---- */

SBI_API int sbi_body_has_corners(const int *list, const int *cell, const int *local, int count)
{
    int found = 0;
    for (int k = 0; k < count; k++)
        for (int i = 0; i < count; i++)
            if (cell[local[k]] == list[i]) {
                found++;
                break;
            }
    return found == count;
}

/* 1 when the corners of b go round the other way than those of a. */
static int sbi_body_is_reversed(const int *a, const int *b, int corners)
{
    for (int i = 0; i < corners; i++)
        if (b[i] == a[0])
            return b[(i + 1) % corners] != a[1];
    return 0;
}

/* 1 when all of these nodes are in the list, which has as many. */
static int sbi_body_are_listed(const int *list, const int *nodes, int count)
{
    int found = 0;
    for (int k = 0; k < count; k++)
        for (int i = 0; i < count && found == k; i++)
            found += nodes[k] == list[i];
    return found == count;
}

/* A face of a cell; inner is not looked at. */
static sbi_body_face sbi_body_face_of(const sb_body *body, int cell, int side)
{
    const int *nodes = body->domain.cells + (size_t)cell * (size_t)body->domain.nodes_per_cell;
    int local[SB_MAX_FACE_NODES];
    sbi_body_face face;
    memset(&face, 0, sizeof face);
    face.count = sbi_element_face(sbi_domain_element(&body->domain), side, local, &face.type);
    for (int k = 0; k < face.count; k++)
        face.nodes[k] = nodes[local[k]];
    return face;
}

/* 1 when another cell has a face with the same corners the other way round. */
static int sbi_body_is_inner(const sb_body *body, const sbi_body_face *face)
{
    const int sides = sbi_element_face_count(sbi_domain_element(&body->domain));
    const int corners = sb_element_corner_count(face->type);
    for (int at = sbi_live_first_cell(body, face->nodes[0]); at >= 0; at = sbi_live_next_cell(body, face->nodes[0], at))
        for (int side = 0; side < sides; side++) {
            sbi_body_face other = sbi_body_face_of(body, sbi_live_cell_of(body, at), side);
            if (sb_element_corner_count(other.type) == corners &&
                sbi_body_are_listed(face->nodes, other.nodes, corners) &&
                sbi_body_is_reversed(face->nodes, other.nodes, corners))
                return 1;
        }
    return 0;
}

/* Finds the element face with these nodes: its corners, or all that it has; 0 when there is none. */
static int sbi_body_find_face(const sb_body *body, const int *list, int count, sbi_body_face *found)
{
    const int sides = sbi_element_face_count(sbi_domain_element(&body->domain));
    for (int at = sbi_live_first_cell(body, list[0]); at >= 0; at = sbi_live_next_cell(body, list[0], at))
        for (int side = 0; side < sides; side++) {
            *found = sbi_body_face_of(body, sbi_live_cell_of(body, at), side);
            if ((count != sb_element_corner_count(found->type) && count != found->count) ||
                !sbi_body_are_listed(list, found->nodes, count))
                continue;
            found->inner = sbi_body_is_inner(body, found);
            return 1;
        }
    memset(found, 0, sizeof *found);
    return 0;
}

SBI_API int sbi_body_twin_faces(const sb_body *body, const sbi_body_face *face, sbi_body_face twins[SBI_BODY_TWINS])
{
    int count = 1, corners = sb_element_corner_count(face->type);
    twins[0] = *face;
    if (face->count == corners || face->inner || !body->live || !body->live->piece_count)
        return 1;
    for (int at = sbi_live_first_cell(body, face->nodes[0]); at >= 0; at = sbi_live_next_cell(body, face->nodes[0], at))
        for (int side = 0; side < 4; side++) {
            sbi_body_face other = sbi_body_face_of(body, sbi_live_cell_of(body, at), side);
            int known = !sbi_body_are_listed(face->nodes, other.nodes, corners);
            for (int k = 0; k < count && !known; k++)
                known = sbi_body_are_listed(twins[k].nodes, other.nodes, other.count);
            if (!known && count < SBI_BODY_TWINS)
                twins[count++] = other;
        }
    return count;
}

SBI_API int sbi_body_outer_face(const sb_body *body, int cell, int side, sbi_body_face *face)
{
    const int sides = sbi_element_face_count(sbi_domain_element(&body->domain));
    sb_real share = 0;
    int corners;
    *face = sbi_body_face_of(body, cell, side);
    corners = sb_element_corner_count(face->type);
    for (int at = sbi_live_first_cell(body, face->nodes[0]); at >= 0; at = sbi_live_next_cell(body, face->nodes[0], at))
        for (int k = 0, e = sbi_live_cell_of(body, at); k < sides; k++) {
            sbi_body_face other = sbi_body_face_of(body, e, k);
            if (sb_element_corner_count(other.type) != corners ||
                !sbi_body_are_listed(face->nodes, other.nodes, corners))
                continue;
            if (e < cell || sbi_body_is_reversed(face->nodes, other.nodes, corners))
                return 0;
            share += sbi_live_is_piece(body, e) ? sbi_piece_face_share(body->live->pieces[e].faces[k], face->count) : 1;
        }
    return share > 0;
}

SBI_API sb_result sbi_body_get_face(const sb_body *body, const int *faces, int f, int count, sbi_body_face *found,
                                    sb_error *error)
{
    const int *face = faces + (size_t)f * (size_t)count;
    found->count = 0;
    for (int k = 0; k < count; k++)
        if (sbi_body_check_nodes(body, face + k, 1, NULL) != SB_OK)
            return sbi_fail_node(error, SB_ERROR_INDEX, face[k], "face %d has node %d, which is outside the mesh", f,
                                 face[k]);
    if (!sbi_body_find_face(body, face, count, found))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, face[0], "face %d (nodes %d %d %d ...) is no face of an element",
                             f, face[0], face[1], face[2]);
    return SB_OK;
}

SBI_API void sbi_body_face_loads(const sb_body *body, const int *nodes, int count, sb_real *loads)
{
    const sb_element_type type = body->domain.element_type;
    const size_t n = (size_t)body->domain.nodes_per_cell;
    for (int i = 0; i < count; i++)
        loads[i] = 0;
    for (int at = sbi_live_first_cell(body, nodes[0]); at >= 0; at = sbi_live_next_cell(body, nodes[0], at)) {
        int e = sbi_live_cell_of(body, at), local[SB_MAX_FACE_NODES];
        const int *cell = body->domain.cells + n * (size_t)e;
        for (int face = 0; face < 4; face++) {
            sb_element_face(type, face, local, NULL);
            if (!sbi_body_has_corners(nodes, cell, local, count)) /* pieces of a tet10 may share corners alone */
                continue;
            for (int i = 0; i < count; i++)
                for (int k = 0; k < count; k++)
                    if (cell[local[k]] == nodes[i])
                        loads[i] += sbi_live_is_piece(body, e) ? body->live->pieces[e].faces[face][k]
                                                               : sbi_piece_whole_load(count, k);
        }
    }
}

/* ---- supports ---- */

SBI_API sb_result sbi_body_check_nodes(const sb_body *body, const int *nodes, int count, sb_error *error)
{
    if (!body || count < 0 || (count > 0 && !nodes))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s",
                        !body       ? "body is NULL"
                        : count < 0 ? "count is negative"
                                    : "nodes is NULL");
    for (int i = 0; i < count; i++)
        if (nodes[i] < 0 || nodes[i] >= body->domain.node_count)
            return sbi_fail_node(error, SB_ERROR_INDEX, nodes[i], "node %d is outside the mesh of %d nodes", nodes[i],
                                 body->domain.node_count);
    return SB_OK;
}

SBI_API sb_result sbi_body_check_vectors(const sb_vec3 *vectors, const int *nodes, int count, int uniform,
                                         const char *what, sb_error *error)
{
    if (count > 0 && !vectors)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", what);
    for (int i = 0; i < (uniform ? sbi_min_int(count, 1) : count); i++)
        if (!sb_v3_is_finite(vectors[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, nodes[i], "entry %d of %s, of node %d, is not finite", i,
                                 what, nodes[i]);
    return SB_OK;
}

static sb_result sbi_body_check_axes(int axes, sb_error *error)
{
    return axes >= 0 && axes <= SB_XYZ
               ? SB_OK
               : sbi_fail(error, SB_ERROR_ARGUMENT, "axes is %d, no sum of SB_X, SB_Y and SB_Z", axes);
}

static int sbi_body_row_length(const sb_body *body, int node)
{
    return body->matrix.row_end[node] - body->matrix.row_start[node];
}

SBI_API sb_result sbi_body_reserve_support_blocks(sb_body *body, int needed)
{
    int most = sbi_matrix_capacity(&body->matrix), capacity;
    void *blocks;
    if (needed <= body->support_capacity)
        return SB_OK;
    capacity = needed > most / 2 ? most : needed + needed / 2;
    blocks = sbi_alloc(&body->allocator, (size_t)capacity, 9 * sizeof(sb_real));
    if (!blocks)
        return SB_ERROR_MEMORY;
    sbi_kept_spoil(body);
    sbi_free(&body->allocator, body->support_blocks);
    body->support_blocks = (sb_real(*)[9])blocks;
    body->support_capacity = capacity;
    return SB_OK;
}

/* Room for the tangent rows of the supports to come: reactions are read from them. The count is an upper bound (a
 * node listed twice counts twice). */
static sb_result sbi_body_reserve_supports(sb_body *body, const int *nodes, int count)
{
    int needed = body->support_used, most = sbi_matrix_capacity(&body->matrix);
    for (int i = 0; i < count; i++)
        if (!body->fixed[nodes[i]])
            needed += sbi_min_int(sbi_body_row_length(body, nodes[i]), most - needed);
    if (body->live && (double)needed * (1 + body->live->slack) < (double)most / 2) /* changes split what is supported */
        needed += (int)((double)needed * body->live->slack);
    return sbi_body_reserve_support_blocks(body, needed);
}

SBI_API sb_vec3 sbi_body_pick_axes(unsigned axes, sb_vec3 value, sb_vec3 otherwise)
{
    return sb_v3(axes & SB_X ? value.x : otherwise.x, axes & SB_Y ? value.y : otherwise.y,
                 axes & SB_Z ? value.z : otherwise.z);
}

/* Where a rigid body has gone: x = position + turn (X - centre). */
typedef struct sbi_support_pose {
    sb_vec3 centre, position; /* m */
    sb_quat given, turn;      /* of any length, and of unit length */
} sbi_support_pose;

/* Where supports are told to go. */
typedef struct sbi_support_targets {
    const sb_vec3 *vectors;       /* NULL: where the nodes are now */
    int uniform;                  /* 1: one for all */
    int positions;                /* 1: positions (m), 0: displacements */
    const sbi_support_pose *pose; /* of all in place of vectors; or NULL */
} sbi_support_targets;

static sb_vec3 sbi_body_pose_target(const sbi_support_pose *pose, sb_vec3 rest)
{
    sb_vec3 arm = sb_v3_sub(rest, pose->centre);
    return sb_v3_add(sb_v3_sub(pose->position, pose->centre), sb_v3_sub(sb_quat_rotate(pose->turn, arm), arm));
}

static sb_vec3 sbi_body_support_target(const sb_body *body, const sbi_support_targets *targets, int node, int i)
{
    sb_vec3 target;
    if (targets->pose)
        return sbi_body_pose_target(targets->pose, body->reference[node]);
    if (!targets->vectors)
        return body->displacement[node];
    target = targets->vectors[targets->uniform ? 0 : i];
    return targets->positions ? sb_v3_sub(target, body->reference[node]) : target;
}

static void sbi_body_tell_supports(sb_body *body, const int *nodes, int count, int axes,
                                   const sbi_support_targets *targets)
{
    const sbi_support_pose *p = targets->pose;
    if (p) {
        const sb_real reals[10] = {p->centre.x,   p->centre.y, p->centre.z, p->position.x, p->position.y,
                                   p->position.z, p->given.w,  p->given.x,  p->given.y,    p->given.z};
        sbi_body_tell(body, SBI_COMMAND_POSE, 0, 0, nodes, (size_t)count, reals, 10);
    } else if (!targets->vectors)
        sbi_body_tell(body, SBI_COMMAND_FIX, axes, 0, nodes, (size_t)count, NULL, 0);
    else if (count > 0)
        sbi_body_tell(body, SBI_COMMAND_PRESCRIBE, axes,
                      (targets->uniform ? SBI_PRESCRIBE_UNIFORM : 0) |
                          (targets->positions ? SBI_PRESCRIBE_POSITIONS : 0),
                      nodes, (size_t)count, &targets->vectors[0].x, targets->uniform ? 3 : 3 * (size_t)count);
}

static sb_result sbi_body_support(sb_body *body, const int *nodes, int count, int axes,
                                  const sbi_support_targets *targets, sb_error *error)
{
    sb_result result = sbi_body_check_nodes(body, nodes, count, error);
    if (result == SB_OK)
        result = sbi_body_check_axes(axes, error);
    if (result != SB_OK || axes == 0)
        return result;
    for (int i = 0; i < count && body->elimination; i++)
        if (body->elimination->slave[nodes[i]] & axes)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, nodes[i],
                                 "node %d is the slave of a constraint on these axes", nodes[i]);
    result = sbi_body_check_not_hung(body, nodes, count, "supported", error);
    if (result != SB_OK)
        return result;
    if (sbi_body_reserve_supports(body, nodes, count) != SB_OK)
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for %d supports", count);
    for (int i = 0; i < count; i++) {
        int node = nodes[i];
        if (!body->fixed[node])
            body->support_used += sbi_body_row_length(body, node);
        if (axes & ~body->fixed[node])
            sbi_kept_forget(body);
        body->fixed[node] |= (unsigned char)axes;
        body->target[node] =
            sbi_body_pick_axes((unsigned)axes, sbi_body_support_target(body, targets, node, i), body->target[node]);
    }
    if (body->elimination) /* masses of slaves go to other nodes now */
        body->guard.stable_step = 0;
    sbi_body_tell_supports(body, nodes, count, axes, targets);
    return SB_OK;
}

static sb_result sbi_body_send(sb_body *body, const int *nodes, int count, int axes, const sbi_support_targets *targets,
                               sb_error *error)
{
    sb_result result = sbi_body_check_nodes(body, nodes, count, error);
    if (result == SB_OK)
        result = sbi_body_check_vectors(targets->vectors, nodes, count, targets->uniform,
                                        targets->positions ? "positions" : "displacements", error);
    return result == SB_OK && count > 0 ? sbi_body_support(body, nodes, count, axes, targets, error) : result;
}

SB_API sb_result sb_body_hold(sb_body *body, const int *nodes, int count, int axes, sb_error *error)
{
    sbi_support_targets now = {NULL, 0, 0, NULL};
    return sbi_body_support(body, nodes, count, axes, &now, error);
}

SB_API sb_result sb_body_place(sb_body *body, const int *nodes, int count, int axes, const sb_vec3 *positions,
                               sb_error *error)
{
    sbi_support_targets targets = {positions, 0, 1, NULL};
    return sbi_body_send(body, nodes, count, axes, &targets, error);
}

SB_API sb_result sb_body_place_rigid(sb_body *body, const int *nodes, int count, sb_vec3 centre, sb_vec3 position,
                                     sb_quat turn, sb_error *error)
{
    sbi_support_pose pose;
    sbi_support_targets targets = {NULL, 0, 0, &pose};
    sb_result result = sbi_body_check_nodes(body, nodes, count, error);
    sb_real square = sb_quat_dot(turn, turn);
    if (result != SB_OK)
        return result;
    if (!sb_v3_is_finite(centre) || !sb_v3_is_finite(position) || !sb_is_finite(square))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the pose of a rigid body is not finite");
    if (!(square > 0) || !sb_is_finite(1 / square))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the turn of a rigid body is a quaternion of length 0");
    pose.centre = centre;
    pose.position = position;
    pose.given = turn;
    pose.turn = sb_quat_normalise(turn);
    for (int i = 0; i < count; i++)
        if (!sb_v3_is_finite(sbi_body_pose_target(&pose, body->reference[nodes[i]])))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, nodes[i], "node %d of a rigid body goes out of all bounds",
                                 nodes[i]);
    return count > 0 ? sbi_body_support(body, nodes, count, SB_XYZ, &targets, error) : SB_OK;
}

/* Adds a force at a place to a sum of forces and torques about a point. */
static void sbi_body_add_wrench(sb_vec3 f, sb_vec3 place, sb_vec3 about, double force[3], double torque[3])
{
    double x = (double)place.x - (double)about.x, y = (double)place.y - (double)about.y;
    double z = (double)place.z - (double)about.z, fx = (double)f.x, fy = (double)f.y, fz = (double)f.z;
    force[0] += fx;
    force[1] += fy;
    force[2] += fz;
    torque[0] += y * fz - z * fy;
    torque[1] += z * fx - x * fz;
    torque[2] += x * fy - y * fx;
}

SB_API sb_result sb_body_wrench(const sb_body *body, const int *nodes, int count, sb_vec3 about, sb_vec3 *force,
                                sb_vec3 *torque, sb_error *error)
{
    double f[3] = {0, 0, 0}, t[3] = {0, 0, 0};
    sb_result result = sbi_body_check_nodes(body, nodes, count, error);
    if (result != SB_OK)
        return result;
    if (!sb_v3_is_finite(about))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the point of a torque is not finite");
    for (int i = 0; i < count; i++)
        sbi_body_add_wrench(body->reaction[nodes[i]], body->position[nodes[i]], about, f, t);
    if (force)
        *force = sb_v3((sb_real)f[0], (sb_real)f[1], (sb_real)f[2]);
    if (torque)
        *torque = sb_v3((sb_real)t[0], (sb_real)t[1], (sb_real)t[2]);
    return SB_OK;
}

SB_API sb_result sb_body_release(sb_body *body, const int *nodes, int count, int axes, sb_error *error)
{
    sb_result result = sbi_body_check_nodes(body, nodes, count, error);
    if (result == SB_OK)
        result = sbi_body_check_axes(axes, error);
    if (result != SB_OK)
        return result;
    if (body->elimination)
        body->guard.stable_step = 0;
    for (int i = 0; i < count; i++)
        if (body->node_component[nodes[i]] >= 0) {
            int held = body->fixed[nodes[i]];
            if (held & axes)
                sbi_kept_forget(body);
            body->fixed[nodes[i]] &= (unsigned char)~axes;
            if (held && !body->fixed[nodes[i]])
                body->support_used -= sbi_body_row_length(body, nodes[i]);
            body->reaction[nodes[i]] = sbi_body_pick_axes((unsigned)axes, sb_v3(0, 0, 0), body->reaction[nodes[i]]);
        }
    sbi_body_tell(body, SBI_COMMAND_RELEASE, axes, 0, nodes, (size_t)count, NULL, 0);
    return SB_OK;
}

SB_API sb_result sb_body_fix_nodes(sb_body *body, const int *nodes, int count, int axes)
{
    return sb_body_hold(body, nodes, count, axes, NULL);
}

SB_API sb_result sb_body_prescribe(sb_body *body, const int *nodes, int count, int axes, const sb_vec3 *displacements,
                                   int uniform)
{
    sbi_support_targets targets = {displacements, uniform, 0, NULL};
    return sbi_body_send(body, nodes, count, axes, &targets, NULL);
}

SB_API sb_result sb_body_release_nodes(sb_body *body, const int *nodes, int count, int axes)
{
    return sb_body_release(body, nodes, count, axes, NULL);
}

SB_API const unsigned char *sb_body_supports(const sb_body *body) { return body ? body->fixed : NULL; }

/* ---- what holds the parts ---- */

/* Arm of a node about the centre of its part, in units of the part's size. */
static void sbi_body_arm(const sb_body *body, int node, double arm[3])
{
    sb_vec3 low = body->component_low[body->node_component[node]];
    sb_vec3 high = body->component_high[body->node_component[node]], x = body->reference[node];
    double size = (double)sb_v3_norm(sb_v3_sub(high, low));
    arm[0] = ((double)x.x - 0.5 * ((double)low.x + (double)high.x)) / size;
    arm[1] = ((double)x.y - 0.5 * ((double)low.y + (double)high.y)) / size;
    arm[2] = ((double)x.z - 0.5 * ((double)low.z + (double)high.z)) / size;
}

SBI_API void sbi_body_add_motion(const sb_body *body, int node, int axis, double weight, double r[6])
{
    double arm[3];
    sbi_body_arm(body, node, arm);
    r[axis] += weight;
    r[3 + (axis + 1) % 3] += weight * arm[(axis + 2) % 3]; /* (omega x arm)_axis */
    r[3 + (axis + 2) % 3] -= weight * arm[(axis + 1) % 3];
}

SBI_API void sbi_body_add_gram(double *gram, size_t stride, int row, int column, const double *r, const double *s)
{
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++)
            gram[(6 * (size_t)row + (size_t)i) * stride + 6 * (size_t)column + (size_t)j] += r[i] * s[j];
}

/* One row along one axis (of rows that are for all three). */
typedef struct sbi_body_row {
    const int *nodes, *dofs; /* one of them */
    const sb_real *weights;
    int count, axis;
    double scale;
} sbi_body_row;

static sbi_body_row sbi_body_make_row(const sbi_body_rows *rows, int index, int axis)
{
    sbi_body_row row;
    int first = rows->start[index];
    row.nodes = rows->nodes ? rows->nodes + first : NULL;
    row.dofs = rows->nodes ? NULL : rows->dofs + first;
    row.weights = rows->weights + first;
    row.count = rows->start[index + 1] - first;
    row.axis = axis;
    row.scale = 0;
    for (int k = 0; k < row.count; k++)
        row.scale += (double)sb_abs(row.weights[k]);
    return row;
}

static int sbi_body_row_part(const sb_body *body, const sbi_body_row *row, int term)
{
    return body->node_component[row->nodes ? row->nodes[term] : row->dofs[term] / 3];
}

/* What all terms of one part do to the row. Weights may cancel, as those of a row do that sees no rigid motion: what is
 * left of them then holds nothing, being rounding. */
static void sbi_body_row_motion(const sb_body *body, const sbi_body_row *row, int part, double r[6])
{
    double size = 0;
    memset(r, 0, 6 * sizeof *r);
    for (int k = 0; k < row->count; k++)
        if (sbi_body_row_part(body, row, k) == part) {
            double weight = (double)row->weights[k] / row->scale;
            size += weight < 0 ? -weight : weight;
            sbi_body_add_motion(body, row->nodes ? row->nodes[k] : row->dofs[k] / 3,
                                row->nodes ? row->axis : row->dofs[k] % 3, weight, r);
        }
    for (int i = 0; i < 6; i++)
        if (r[i] * r[i] < 1e6 * (double)SB_EPSILON * (double)SB_EPSILON * size * size)
            r[i] = 0;
}

/* 1 when the part of a term is that of no term before it: parts of a row are visited once like this. */
static int sbi_body_is_new_part(const sb_body *body, const sbi_body_row *row, int term)
{
    int part = sbi_body_row_part(body, row, term);
    for (int k = 0; k < term; k++)
        if (sbi_body_row_part(body, row, k) == part)
            return 0;
    return part >= 0;
}

/* 1 when a row goes through several parts. */
static int sbi_body_is_tie(const sb_body *body, const sbi_body_row *row)
{
    int parts = 0;
    for (int k = 0; k < row->count && parts < 2; k++)
        parts += sbi_body_is_new_part(body, row, k);
    return parts > 1;
}

/* Adds one row: its sum is held. Ties go to the gram of the tied parts. */
static void sbi_body_hold_row(const sb_body *body, const sbi_body_row *row)
{
    size_t stride = 6 * (size_t)body->tie_count;
    int tied = sbi_body_is_tie(body, row);
    for (int a = 0; a < row->count && row->scale > 0; a++)
        for (int b = 0; b < row->count && sbi_body_is_new_part(body, row, a); b++) {
            int part = sbi_body_row_part(body, row, a), other = sbi_body_row_part(body, row, b);
            double r[6], s[6];
            if ((!tied && b != a) || !sbi_body_is_new_part(body, row, b))
                continue;
            sbi_body_row_motion(body, row, part, r);
            if (tied)
                sbi_body_row_motion(body, row, other, s);
            if (tied)
                sbi_body_add_gram(body->tie_gram, stride, body->tie_of[part], body->tie_of[other], r, s);
            else
                sbi_body_add_gram(body->support_grams[part], 6, 0, 0, r, r);
        }
}

/* Gauss elimination of a gram of 6 size numbers with diagonal pivots: -1 when it has full rank, else one of the rigid
 * motions that are free. Arms are of order 1, so pivots compare with the trace of their part. */
SBI_API int sbi_body_free_motion(double *gram, int parts, double *traces)
{
    int size = 6 * parts;
    size_t n = (size_t)size;
    for (int p = 0; p < parts; p++) {
        traces[p] = 0;
        for (int i = 6 * p; i < 6 * p + 6; i++)
            traces[p] += gram[(size_t)i * (n + 1)];
    }
    for (int step = 0; step < size; step++) {
        int pivot = -1, first = -1;
        for (int i = 0; i < size; i++) {
            double d = gram[(size_t)i * (n + 1)];
            if (d < 0) /* done: marked below */
                continue;
            first = first < 0 ? i : first;
            if (d > 1e-10 * traces[i / 6] && (pivot < 0 || d > gram[(size_t)pivot * (n + 1)]))
                pivot = i;
        }
        if (pivot < 0)
            return first;
        for (int i = 0; i < size; i++) {
            double factor = gram[(size_t)i * n + (size_t)pivot] / gram[(size_t)pivot * (n + 1)];
            if (i == pivot || gram[(size_t)i * (n + 1)] < 0)
                continue;
            for (int j = 0; j < size; j++)
                if (j != pivot)
                    gram[(size_t)i * n + (size_t)j] -= factor * gram[(size_t)pivot * n + (size_t)j];
            if (gram[(size_t)i * (n + 1)] < 0) /* rounding of 0 */
                gram[(size_t)i * (n + 1)] = 0;
        }
        gram[(size_t)pivot * (n + 1)] = -1;
    }
    return -1;
}

/* Numbers the parts that rows tie to each other and that have no number yet, from `count` on; the next number. */
static int sbi_body_number_ties(sb_body *body, const sbi_body_rows *rows, int count)
{
    for (int j = 0; j < rows->count; j++) {
        sbi_body_row row = sbi_body_make_row(rows, j, 0);
        int tied = sbi_body_is_tie(body, &row);
        for (int k = 0; k < row.count && tied; k++) {
            int part = sbi_body_row_part(body, &row, k);
            if (part >= 0 && body->tie_of[part] < 0)
                body->tie_of[part] = count++;
        }
    }
    return count;
}

SBI_API sb_result sbi_body_reserve_ties(sb_body *body, const sbi_body_rows *rows, sb_error *error)
{
    int count = sbi_body_number_ties(body, rows, body->tie_count);
    if (count > body->tie_capacity) {
        size_t n = 6 * (size_t)count; /* a gram of n x n numbers and the traces */
        double *gram = (double *)sbi_alloc(&body->allocator, n + 1, n * sizeof(double));
        for (int c = 0; c < body->component_count && !gram; c++)
            body->tie_of[c] = body->tie_of[c] < body->tie_count ? body->tie_of[c] : -1;
        if (!gram)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory to tie %d parts to each other", count);
        sbi_free(&body->allocator, body->tie_gram);
        body->tie_gram = gram;
        body->tie_capacity = count;
    }
    body->tie_count = count;
    return SB_OK;
}

/* Adds the springs and the rows of a mapping, as far as they have a stiffness. */
static void sbi_body_hold_load(const sb_body *body, const sbi_load *load)
{
    sbi_body_rows rows = {load->row_count, load->row_start, load->nodes, NULL, load->weights};
    for (int j = 0; !sbi_load_has_faces(load) && j < load->row_count; j++)
        for (int axis = 0; axis < 3 && load->stiffness[j] > 0; axis++) {
            sbi_body_row row = sbi_body_make_row(&rows, j, axis);
            sbi_body_hold_row(body, &row);
        }
}

/* A cable holds its length, also while it is slack. */
static void sbi_body_hold_cable(const sb_body *body, sbi_load *load)
{
    const int start[2] = {0, 3 * load->row_start[load->row_count]};
    sbi_body_rows rows = {1, start, NULL, load->lie.dofs, load->lie.shares};
    sbi_body_row row;
    sbi_cable_list_shares(body, load, body->displacement);
    row = sbi_body_make_row(&rows, 0, 0);
    if (load->cable.stiffness > 0)
        sbi_body_hold_row(body, &row);
}

static void sbi_body_hold_equations(const sb_body *body, const sbi_equations *equations)
{
    sbi_body_rows rows = {equations->count, equations->start, NULL, equations->dof, equations->coefficient};
    for (int j = 0; j < rows.count; j++) {
        sbi_body_row row = sbi_body_make_row(&rows, j, 0);
        sbi_body_hold_row(body, &row);
    }
}

static void sbi_body_hold_supports(const sb_body *body)
{
    memset(body->support_grams, 0, (size_t)body->component_count * sizeof body->support_grams[0]);
    for (int i = 0; i < body->domain.node_count; i++)
        for (int axis = 0; axis < 3 && body->node_component[i] >= 0; axis++)
            if (body->fixed[i] >> axis & 1) {
                double r[6] = {0, 0, 0, 0, 0, 0};
                sbi_body_add_motion(body, i, axis, 1, r);
                sbi_body_add_gram(body->support_grams[body->node_component[i]], 6, 0, 0, r, r);
            }
}

/* 1 when supports alone hold every part: a look at thousands of rows can be spared then. Uses up the grams. */
static int sbi_body_is_held_by_supports(const sb_body *body)
{
    double trace;
    sbi_body_hold_supports(body);
    for (int c = 0; c < body->component_count; c++)
        if (sbi_body_free_motion(body->support_grams[c], 1, &trace) >= 0)
            return 0;
    return 1;
}

SBI_API void sbi_body_gather_holds(const sb_body *body)
{
    size_t stride = 6 * (size_t)body->tie_count;
    sbi_body_hold_supports(body);
    if (stride)
        memset(body->tie_gram, 0, stride * stride * sizeof(double));
    for (int l = 0; l < body->load_count; l++)
        if (body->loads[l].kind == SBI_LOAD_CABLE)
            sbi_body_hold_cable(body, body->loads + l);
        else
            sbi_body_hold_load(body, body->loads + l);
    if (body->elimination)
        sbi_body_hold_equations(body, &body->elimination->equations);
    for (int c = 0; c < body->component_count; c++)
        for (int i = 0; i < 6 && body->tie_of[c] >= 0; i++)
            for (int j = 0; j < 6; j++)
                body->tie_gram[(6 * (size_t)body->tie_of[c] + (size_t)i) * stride + 6 * (size_t)body->tie_of[c] +
                               (size_t)j] += body->support_grams[c][6 * i + j];
}

SBI_API int sbi_body_unsupported_node(const sb_body *body)
{
    int loose = -1; /* number of a tied part that is free */
    if (sbi_body_is_held_by_supports(body))
        return -1;
    sbi_body_gather_holds(body);
    if (body->tie_count > 0) {
        size_t n = 6 * (size_t)body->tie_count;
        int motion = sbi_body_free_motion(body->tie_gram, body->tie_count, body->tie_gram + n * n);
        loose = motion < 0 ? -1 : motion / 6;
    }
    for (int c = 0; c < body->component_count; c++) {
        double trace;
        if (body->tie_of[c] >= 0 ? body->tie_of[c] != loose
                                 : sbi_body_free_motion(body->support_grams[c], 1, &trace) < 0)
            continue;
        for (int i = 0; i < body->domain.node_count; i++)
            if (body->node_component[i] == c)
                return i;
    }
    return -1;
}
