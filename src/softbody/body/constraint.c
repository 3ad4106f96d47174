/* constraint: equations of a body, ties, forces, and what steps ask of them. */
#include "constraint.h"

#include <limits.h>
#include <string.h>

#include "body_private.h"
#include "rigid_private.h"

/* ---- the set of equations ---- */

/* Puts a condensed system for these equations in place of the old one, taking them over; all or nothing. */
static sb_result sbi_constraint_install(sb_body *b, sbi_equations *equations, sb_error *error)
{
    sbi_elimination_setup setup = sbi_body_elimination_setup(b, &b->matrix);
    sbi_body_rows rows;
    sbi_elimination *made = NULL, *old = b->elimination;
    sb_result result = SB_OK;
    rows.count = equations->count;
    rows.start = equations->start;
    rows.nodes = NULL;
    rows.dofs = equations->dof;
    rows.weights = equations->coefficient;
    if (equations->count > 0)
        result = sbi_elimination_create(&setup, equations, &made, error);
    if (result == SB_OK && made)
        result = sbi_body_reserve_ties(b, &rows, error);
    if (result == SB_OK)
        result = sbi_body_reserve_rigids(b, b->rigids, made ? &made->matrix : &b->matrix, error);
    if (result != SB_OK) {
        sbi_elimination_free(made);
        sbi_equations_free(equations);
        return result;
    }
    for (int c = 0; made && old && c < made->equations.count; c++) { /* those that stay keep their force */
        int before = sbi_equations_find(&old->equations, made->equations.id[c]);
        made->force[c] = before < 0 ? 0 : old->force[before];
    }
    sbi_equations_free(equations);
    sbi_elimination_free(old);
    b->elimination = made;
    return SB_OK;
}

/* Copies equation `c` of `from` to the end of `to`, whose arrays are large enough. */
static void sbi_constraint_append(sbi_equations *to, int at, const sbi_equations *from, int c)
{
    int terms = from->start[c + 1] - from->start[c], first = to->start[at];
    to->id[at] = from->id[c];
    to->value[at] = from->value[c];
    memcpy(to->dof + first, from->dof + from->start[c], (size_t)terms * sizeof(int));
    memcpy(to->coefficient + first, from->coefficient + from->start[c], (size_t)terms * sizeof(sb_real));
    to->start[at + 1] = first + terms;
}

static sb_result sbi_constraint_no_memory(sb_error *error, int count)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d constraints", count);
}

/* The body's equations but those with first <= id < first + count, with room for more. */
static sb_result sbi_constraint_copy(const sb_body *b, int first, int count, int more, size_t more_terms,
                                     sbi_equations *equations, sb_error *error)
{
    const sbi_equations *old = b->elimination ? &b->elimination->equations : NULL;
    int old_count = old ? old->count : 0, kept = 0;
    size_t terms = more_terms;
    for (int c = 0; c < old_count; c++)
        if (old->id[c] < first || old->id[c] - first >= count) {
            terms += (size_t)(old->start[c + 1] - old->start[c]);
            kept++;
        }
    if (more > INT_MAX - kept || !sbi_equations_allocate(&b->allocator, kept + more, terms, equations))
        return sbi_constraint_no_memory(error, more);
    kept = 0;
    for (int c = 0; c < old_count; c++)
        if (old->id[c] < first || old->id[c] - first >= count)
            sbi_constraint_append(equations, kept++, old, c);
    equations->count = kept + more;
    return SB_OK;
}

/* ---- adding and removing ---- */

static char sbi_constraint_axis(int axis) { return (char)('x' + axis); }

static sb_result sbi_constraint_check_terms(const sb_body *b, const sb_constraint_term *terms, int count,
                                            sb_error *error)
{
    int node = terms[0].node, axis = terms[0].axis;
    for (int k = 0; k < count; k++) {
        if (terms[k].node < 0 || terms[k].node >= b->domain.node_count)
            return sbi_fail_node(error, SB_ERROR_INDEX, terms[k].node, "a constraint names node %d of %d",
                                 terms[k].node, b->domain.node_count);
        if (terms[k].axis < 0 || terms[k].axis > 2)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, terms[k].node,
                                 "a constraint names axis %d of node %d: it must be 0, 1 or 2", terms[k].axis,
                                 terms[k].node);
        if (!sb_is_finite(terms[k].coefficient))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, terms[k].node,
                                 "the coefficient of node %d along %c is not finite", terms[k].node,
                                 sbi_constraint_axis(terms[k].axis));
    }
    for (int k = 0; k < count; k++)
        if (terms[0].coefficient == 0 || !sb_is_finite(terms[k].coefficient / terms[0].coefficient))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, node,
                                 "the coefficient %g of the slave, node %d along %c, is too small",
                                 (double)terms[0].coefficient, node, sbi_constraint_axis(axis));
    if (b->fixed[node] >> axis & 1)
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, node, "the slave, node %d along %c, is supported", node,
                             sbi_constraint_axis(axis));
    return sbi_body_check_not_hung(b, &node, 1, "a slave", error);
}

/* All arguments of an addition; *total: terms of all constraints. */
static sb_result sbi_constraint_check(const sb_body *b, const sb_constraint_term *terms, const int *term_counts,
                                      const sb_real *values, int count, size_t *total, sb_error *error)
{
    *total = 0;
    if (!b || count < 0 || (count > 0 && (!terms || !term_counts)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "constraints need a body, terms and their counts");
    for (int c = 0; c < count; c++) {
        sb_result result;
        if (term_counts[c] < 1)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "constraint %d has %d terms", c, term_counts[c]);
        if (values && !sb_is_finite(values[c]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, terms[*total].node,
                                 "the value of constraint %d, of node %d, is not finite", c, terms[*total].node);
        result = sbi_constraint_check_terms(b, terms + *total, term_counts[c], error);
        if (result != SB_OK)
            return result;
        *total += (size_t)term_counts[c];
    }
    if (count > INT_MAX - b->next_constraint || b->domain.node_count > INT_MAX / 3)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "constraints and their unknowns are numbered up to %d", INT_MAX);
    return SB_OK;
}

/* Tells of the last `count` equations. */
static void sbi_constraint_tell(sb_body *body, int count)
{
    const sbi_equations *q = &body->elimination->equations;
    int first = q->count - count, term = q->start[first];
    sbi_command command;
    memset(&command, 0, sizeof command);
    command.code = SBI_COMMAND_ADD_CONSTRAINTS;
    command.a = count;
    command.ints = q->start + first;
    command.int_count = (size_t)count + 1;
    command.more_ints = q->dof + term;
    command.more_int_count = (size_t)(q->start[q->count] - term);
    command.reals = q->value + first;
    command.real_count = (size_t)count;
    command.more_reals[0] = q->coefficient + term;
    command.more_real_counts[0] = command.more_int_count;
    sbi_body_tell_command(body, &command);
}

SB_API sb_result sb_body_add_constraints(sb_body *body, const sb_constraint_term *terms, const int *term_counts,
                                         const sb_real *values, int count, int *first_id, sb_error *error)
{
    sbi_equations equations;
    size_t total;
    int old;
    sb_result result = sbi_constraint_check(body, terms, term_counts, values, count, &total, error);
    if (result != SB_OK)
        return result;
    if (count > 0) {
        result = sbi_constraint_copy(body, 0, 0, count, total, &equations, error);
        if (result != SB_OK)
            return result;
        old = equations.count - count;
        for (int c = 0; c < count; c++) {
            int at = equations.start[old + c];
            equations.id[old + c] = body->next_constraint + c;
            equations.value[old + c] = values ? values[c] : (sb_real)0;
            for (int k = 0; k < term_counts[c]; k++, terms++, at++) {
                equations.dof[at] = 3 * terms->node + terms->axis;
                equations.coefficient[at] = terms->coefficient;
            }
            equations.start[old + c + 1] = at;
        }
        result = sbi_constraint_install(body, &equations, error);
        if (result != SB_OK)
            return result;
        body->acceleration_known = 0;
    }
    if (first_id)
        *first_id = body->next_constraint;
    body->next_constraint += count;
    if (count > 0)
        sbi_constraint_tell(body, count);
    return SB_OK;
}

SB_API sb_result sb_body_add_constraint(sb_body *body, const sb_constraint_term *terms, int count, sb_real value,
                                        int *id, sb_error *error)
{
    return sb_body_add_constraints(body, terms, &count, &value, 1, id, error);
}

static int sbi_constraint_find(const sb_body *b, int id)
{
    return b->elimination ? sbi_equations_find(&b->elimination->equations, id) : -1;
}

SB_API sb_result sb_body_set_constraint_value(sb_body *body, int id, sb_real value)
{
    int c = body ? sbi_constraint_find(body, id) : -1;
    if (!body)
        return SB_ERROR_ARGUMENT;
    if (c < 0)
        return SB_ERROR_INDEX;
    if (!sb_is_finite(value))
        return SB_ERROR_NOT_FINITE;
    body->elimination->equations.value[c] = value;
    sbi_body_tell(body, SBI_COMMAND_CONSTRAINT_VALUE, id, 0, NULL, 0, &value, 1);
    return SB_OK;
}

SB_API sb_result sb_body_remove_constraints(sb_body *body, int first_id, int count, sb_error *error)
{
    sbi_equations equations;
    sb_result result;
    if (!body || count < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "removing constraints needs a body and a count >= 0");
    if (count == 0)
        return SB_OK;
    if (first_id < 0 || count > INT_MAX - first_id)
        return sbi_fail(error, SB_ERROR_INDEX, "the body has no constraint %d", first_id);
    for (int id = first_id; id < first_id + count; id++)
        if (sbi_constraint_find(body, id) < 0)
            return sbi_fail(error, SB_ERROR_INDEX, "the body has no constraint %d", id);
    result = sbi_constraint_copy(body, first_id, count, 0, 0, &equations, error);
    if (result == SB_OK)
        result = sbi_constraint_install(body, &equations, error);
    if (result != SB_OK)
        return result;
    body->acceleration_known = 0;
    sbi_body_tell(body, SBI_COMMAND_REMOVE_CONSTRAINTS, first_id, count, NULL, 0, NULL, 0);
    return SB_OK;
}

SB_API sb_result sb_body_remove_constraint(sb_body *body, int id, sb_error *error)
{
    return sb_body_remove_constraints(body, id, 1, error);
}

SB_API void sb_body_clear_constraints(sb_body *body)
{
    if (!body)
        return;
    if (!body->elimination)
        return;
    sbi_elimination_free(body->elimination);
    body->elimination = NULL;
    body->acceleration_known = 0;
    sbi_body_tell(body, SBI_COMMAND_CLEAR_CONSTRAINTS, 0, 0, NULL, 0, NULL, 0);
}

SB_API int sb_body_constraint_count(const sb_body *body)
{
    if (!body)
        return 0;
    return body->elimination ? body->elimination->equations.count : 0;
}

SB_API sb_result sb_body_constraint_force(const sb_body *body, int id, sb_real *force)
{
    int c = body ? sbi_constraint_find(body, id) : -1;
    if (!body || !force)
        return SB_ERROR_ARGUMENT;
    if (c < 0)
        return SB_ERROR_INDEX;
    *force = body->elimination->force[c];
    return SB_OK;
}

/* ---- ties: the closest point of a face ---- */

/* A master face in its present shape. */
typedef struct sbi_tie_face {
    sb_element_type type;
    int count;
    int nodes[SB_MAX_FACE_NODES];
    sb_vec3 centre; /* mean of the nodes (m) */
    sb_real radius; /* largest distance of a node from it (m) */
} sbi_tie_face;

/* Where a slave node meets the faces. */
typedef struct sbi_tie_point {
    int face;         /* -1: none yet */
    sb_real distance; /* m */
    sb_real xi[3];
} sbi_tie_point;

/* Barycentric coordinates of the point of triangle x closest to p: after Ericson, Real-Time Collision Detection
 * (2005), 5.1.5, by the Voronoi regions of corners, edges and inside. */
static void sbi_tie_triangle(const sb_vec3 x[3], sb_vec3 p, sb_real bary[3])
{
    sb_vec3 ab = sb_v3_sub(x[1], x[0]), ac = sb_v3_sub(x[2], x[0]), ap = sb_v3_sub(p, x[0]);
    sb_vec3 bp = sb_v3_sub(p, x[1]), cp = sb_v3_sub(p, x[2]);
    sb_real d1 = sb_v3_dot(ab, ap), d2 = sb_v3_dot(ac, ap), d3 = sb_v3_dot(ab, bp), d4 = sb_v3_dot(ac, bp);
    sb_real d5 = sb_v3_dot(ab, cp), d6 = sb_v3_dot(ac, cp);
    sb_real va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2, sum = va + vb + vc;
    sb_real v = 0, w = 0;
    if (d1 <= 0 && d2 <= 0) {
        v = w = 0;
    } else if (d3 >= 0 && d4 <= d3) {
        v = 1;
    } else if (d6 >= 0 && d5 <= d6) {
        w = 1;
    } else if (vc <= 0 && d1 >= 0 && d3 <= 0) {
        v = d1 / (d1 - d3);
    } else if (vb <= 0 && d2 >= 0 && d6 <= 0) {
        w = d2 / (d2 - d6);
    } else if (va <= 0 && d4 >= d3 && d5 >= d6) {
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        v = 1 - w;
    } else {
        v = vb / sum;
        w = vc / sum;
    }
    bary[0] = 1 - v - w;
    bary[1] = v;
    bary[2] = w;
}

/* Point of the face at xi; slopes dx/dr, dx/ds when wanted. */
static sb_vec3 sbi_tie_evaluate(const sb_body *b, const sbi_tie_face *face, const sb_real xi[3], sb_vec3 slope[2])
{
    sb_real shape[SB_MAX_ELEMENT_NODES], gradient[SB_MAX_ELEMENT_NODES][3];
    sb_vec3 x = sb_v3(0, 0, 0), r = x, s = x;
    sb_element_shape(face->type, xi, shape, gradient);
    for (int a = 0; a < face->count; a++) {
        sb_vec3 node = b->position[face->nodes[a]];
        x = sb_v3_madd(x, shape[a], node);
        r = sb_v3_madd(r, gradient[a][0], node);
        s = sb_v3_madd(s, gradient[a][1], node);
    }
    if (slope) {
        slope[0] = r;
        slope[1] = s;
    }
    return x;
}

/* Closest point on one triangle of parameters with corners at x, if it beats *best. */
static void sbi_tie_try_piece(const sb_real (*corners)[3], const sb_vec3 *x, sb_vec3 p, sb_real *best, sb_real xi[3])
{
    sb_real bary[3], distance;
    sb_vec3 at;
    sbi_tie_triangle(x, p, bary);
    at = sb_v3_madd(sb_v3_madd(sb_v3_scale(bary[0], x[0]), bary[1], x[1]), bary[2], x[2]);
    distance = sb_v3_norm(sb_v3_sub(p, at));
    if (!(distance < *best))
        return;
    *best = distance;
    for (int k = 0; k < 2; k++)
        xi[k] = bary[0] * corners[0][k] + bary[1] * corners[1][k] + bary[2] * corners[2][k];
}

enum { SBI_TIE_CUTS = 4 }; /* pieces per side of a curved face, to start from */

/* The parameter domain cut into flat pieces, [cuts]^2 triangles or pairs of them; the start of the search. */
static void sbi_tie_start(const sb_body *b, const sbi_tie_face *face, sb_vec3 p, int cuts, sb_real xi[3])
{
    int box = sb_element_corner_count(face->type) == 4;
    sb_real best = SB_REAL_MAX, low = box ? (sb_real)-1 : (sb_real)0;
    sb_real side = (box ? (sb_real)2 : (sb_real)1) / (sb_real)cuts;
    for (int i = 0; i < cuts; i++)
        for (int j = 0; j < (box ? cuts : cuts - i); j++)
            for (int half = 0; half < (box || i + j < cuts - 1 ? 2 : 1); half++) {
                sb_real corners[3][3];
                sb_vec3 x[3];
                for (int k = 0; k < 3; k++) { /* lower half: (0,0) (1,0) (0,1); upper: (1,1) (0,1) (1,0) */
                    corners[k][0] = low + side * (sb_real)(i + (half ? k != 1 : k == 1));
                    corners[k][1] = low + side * (sb_real)(j + (half ? k != 2 : k == 2));
                    corners[k][2] = 0;
                    x[k] = sbi_tie_evaluate(b, face, corners[k], NULL);
                }
                sbi_tie_try_piece((const sb_real(*)[3])corners, x, p, &best, xi);
            }
}

/* One Gauss-Newton step: the closest point of the face's linearisation at xi over the whole parameter domain, which
 * keeps to its edges by itself. */
static void sbi_tie_linearised(const sb_body *b, const sbi_tie_face *face, sb_vec3 p, const sb_real xi[3],
                               sb_real next[3])
{
    int corner_count = sb_element_corner_count(face->type);
    sb_vec3 slope[2], x = sbi_tie_evaluate(b, face, xi, slope), at[3];
    sb_real best = SB_REAL_MAX, corners[3][3];
    next[0] = xi[0];
    next[1] = xi[1];
    next[2] = 0;
    for (int piece = 0; piece + 2 < corner_count; piece++) {
        for (int k = 0; k < 3; k++) {
            sb_element_node_point(face->type, k == 0 ? 0 : piece + k, corners[k]);
            at[k] = sb_v3_madd(x, corners[k][0] - xi[0], slope[0]);
            at[k] = sb_v3_madd(at[k], corners[k][1] - xi[1], slope[1]);
        }
        sbi_tie_try_piece((const sb_real(*)[3])corners, at, p, &best, next);
    }
}

/* Closest point of a face: flat pieces to start from, then Gauss-Newton as long as the distance falls. */
static sb_real sbi_tie_project(const sb_body *b, const sbi_tie_face *face, sb_vec3 p, sb_real xi[3])
{
    sb_real distance;
    xi[0] = xi[1] = xi[2] = 0;
    sbi_tie_start(b, face, p, face->type == SB_TRI3 ? 1 : SBI_TIE_CUTS, xi);
    distance = sb_v3_norm(sb_v3_sub(p, sbi_tie_evaluate(b, face, xi, NULL)));
    for (int iteration = 0; iteration < 50 && face->type != SB_TRI3; iteration++) {
        sb_real goal[3], next[3] = {0, 0, 0}, fell = distance, t;
        sbi_tie_linearised(b, face, p, xi, goal);
        for (t = 1; t > (sb_real)1e-3; t *= (sb_real)0.5) {
            next[0] = xi[0] + t * (goal[0] - xi[0]);
            next[1] = xi[1] + t * (goal[1] - xi[1]);
            fell = sb_v3_norm(sb_v3_sub(p, sbi_tie_evaluate(b, face, next, NULL)));
            if (fell < distance)
                break;
        }
        if (!(fell < distance))
            break;
        distance = fell;
        xi[0] = next[0];
        xi[1] = next[1];
    }
    return distance;
}

/* ---- ties: faces and nodes ---- */

typedef struct sbi_tie {
    sb_body *body;
    sbi_tie_face *faces; /* [face_count] */
    int face_count;
    const int *slaves;
    int slave_count;
    sb_real max_distance;
    int options;
    unsigned char *marks; /* [node_count] 1: on a face, 2: a slave */
    sb_constraint_term *terms;
    int *term_counts; /* [3 slave_count] */
    sb_real *values;  /* [3 slave_count] */
    size_t term_count;
    sb_tie_report report;
} sbi_tie;

/* Finds the faces on the elements and their bounding spheres. */
static sb_result sbi_tie_find_faces(sbi_tie *tie, const int *corners, int corner_count, sb_error *error)
{
    const sb_body *b = tie->body;
    for (int f = 0; f < tie->face_count; f++) {
        sbi_tie_face *face = tie->faces + f;
        sbi_body_face found;
        sb_result result = sbi_body_get_face(b, corners, f, corner_count, &found, error);
        if (result != SB_OK)
            return result;
        face->type = found.type;
        face->count = found.count;
        memcpy(face->nodes, found.nodes, sizeof face->nodes);
        face->centre = sb_v3(0, 0, 0);
        face->radius = 0;
        for (int a = 0; a < face->count; a++) {
            tie->marks[face->nodes[a]] |= 1;
            face->centre = sb_v3_madd(face->centre, (sb_real)1 / (sb_real)face->count, b->position[face->nodes[a]]);
        }
        for (int a = 0; a < face->count; a++)
            face->radius = sb_max(face->radius, sb_v3_norm(sb_v3_sub(b->position[face->nodes[a]], face->centre)));
    }
    return SB_OK;
}

static sb_result sbi_tie_check_slaves(sbi_tie *tie, sb_error *error)
{
    const sb_body *b = tie->body;
    for (int k = 0; k < tie->slave_count; k++) {
        int node = tie->slaves[k];
        if (node < 0 || node >= b->domain.node_count)
            return sbi_fail_node(error, SB_ERROR_INDEX, node, "slave %d is node %d of %d", k, node,
                                 b->domain.node_count);
        if (tie->marks[node] & 1)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, node, "slave node %d is on the master faces", node);
        if (tie->marks[node] & 2)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, node, "slave node %d is listed twice", node);
        tie->marks[node] |= 2;
    }
    return SB_OK;
}

/* How far the face can reach from its centre: corners bound a flat face, sum |N_a| <= 3 a curved one. */
static sb_real sbi_tie_reach(const sbi_tie_face *face)
{
    return face->count > sb_element_corner_count(face->type) ? 3 * face->radius : face->radius;
}

static sbi_tie_point sbi_tie_closest(const sbi_tie *tie, sb_vec3 p)
{
    sbi_tie_point best;
    best.face = -1;
    best.distance = SB_REAL_MAX;
    best.xi[0] = best.xi[1] = best.xi[2] = 0;
    for (int f = 0; f < tie->face_count; f++) {
        const sbi_tie_face *face = tie->faces + f;
        sb_real xi[3], distance, away = sb_v3_norm(sb_v3_sub(p, face->centre));
        if (away - sbi_tie_reach(face) > best.distance)
            continue;
        distance = sbi_tie_project(tie->body, face, p, xi);
        if (distance < best.distance) {
            best.face = f;
            best.distance = distance;
            memcpy(best.xi, xi, sizeof xi);
        }
    }
    return best;
}

/* Shape functions at the point, those that are rounding of the coordinates set to 0, with sum 1. */
static void sbi_tie_weights(const sbi_tie *tie, const sbi_tie_point *point, sb_real *weights)
{
    const sbi_tie_face *face = tie->faces + point->face;
    sb_real size = sb_max(sb_max(sb_abs(face->centre.x), sb_abs(face->centre.y)), sb_abs(face->centre.z));
    sb_real least = 64 * SB_EPSILON * (1 + size / face->radius), sum = 0;
    int largest = 0;
    sb_element_shape(face->type, point->xi, weights, NULL);
    for (int a = 0; a < face->count; a++) {
        if (sb_abs(weights[a]) < least)
            weights[a] = 0;
        if (weights[a] > weights[largest])
            largest = a;
    }
    for (int a = 0; a < face->count; a++)
        sum += a == largest ? (sb_real)0 : weights[a];
    weights[largest] = 1 - sum;
}

/* The constraints of one slave node. */
static void sbi_tie_node(sbi_tie *tie, int node, const sbi_tie_point *point)
{
    const sb_body *b = tie->body;
    const sbi_tie_face *face = tie->faces + point->face;
    const sb_vec3 *held = tie->options & SB_TIE_CLOSE_GAPS ? b->reference : b->displacement;
    sb_real weights[SB_MAX_ELEMENT_NODES], sign = tie->options & SB_TIE_CLOSE_GAPS ? (sb_real)-1 : (sb_real)1;
    sb_vec3 offset = held[node];
    sbi_tie_weights(tie, point, weights);
    for (int a = 0; a < face->count; a++)
        offset = sb_v3_madd(offset, -weights[a], held[face->nodes[a]]);
    for (int axis = 0; axis < 3; axis++) {
        int first = (int)tie->term_count;
        if (b->fixed[node] >> axis & 1)
            continue;
        for (int a = -1; a < face->count; a++) {
            sb_constraint_term *term = tie->terms + tie->term_count;
            if (a >= 0 && weights[a] == 0)
                continue;
            term->node = a < 0 ? node : face->nodes[a];
            term->axis = axis;
            term->coefficient = a < 0 ? (sb_real)1 : -weights[a];
            tie->term_count++;
        }
        tie->values[tie->report.constraint_count] = sign * sbi_elimination_get(&offset, axis);
        tie->term_counts[tie->report.constraint_count++] = (int)tie->term_count - first;
    }
}

static sb_result sbi_tie_nodes(sbi_tie *tie, sb_error *error)
{
    sb_tie_report *report = &tie->report;
    sb_real farthest = -1;
    for (int k = 0; k < tie->slave_count; k++) {
        int node = tie->slaves[k];
        sbi_tie_point point = sbi_tie_closest(tie, tie->body->position[node]);
        sb_real allowed = tie->max_distance;
        if (allowed < 0)
            allowed = point.face < 0 ? (sb_real)0 : (sb_real)0.2 * tie->faces[point.face].radius;
        if (point.face < 0 || point.distance > allowed) {
            if (tie->options & SB_TIE_ALL)
                return sbi_fail_node(error, SB_ERROR_ARGUMENT, node,
                                     "slave node %d is %g m from the nearest master face, more than %g", node,
                                     (double)point.distance, (double)allowed);
            if (point.distance > farthest)
                report->farthest_node = node;
            farthest = sb_max(farthest, point.distance);
            report->free_count++;
            continue;
        }
        report->tied_count++;
        report->supported_count += tie->body->fixed[node] != 0;
        report->largest_gap = sb_max(report->largest_gap, point.distance);
        sbi_tie_node(tie, node, &point);
    }
    return SB_OK;
}

/* Everything of the call in one block. */
static void sbi_tie_layout(sbi_tie *tie, sbi_arena *arena)
{
    size_t slaves = (size_t)tie->slave_count, faces = (size_t)tie->face_count;
    tie->faces = (sbi_tie_face *)sbi_arena_take(arena, faces, sizeof(sbi_tie_face));
    tie->marks = (unsigned char *)sbi_arena_take(arena, (size_t)tie->body->domain.node_count, 1);
    tie->terms =
        (sb_constraint_term *)sbi_arena_take(arena, slaves, 3 * (1 + SB_MAX_FACE_NODES) * sizeof(sb_constraint_term));
    tie->term_counts = (int *)sbi_arena_take(arena, slaves, 3 * sizeof(int));
    tie->values = (sb_real *)sbi_arena_take(arena, slaves, 3 * sizeof(sb_real));
}

static sb_result sbi_tie_run(sbi_tie *tie, const int *faces, int corners, sb_error *error)
{
    sb_result result = sbi_tie_find_faces(tie, faces, corners, error);
    if (result == SB_OK)
        result = sbi_tie_check_slaves(tie, error);
    if (result == SB_OK)
        result = sbi_tie_nodes(tie, error);
    if (result == SB_OK)
        result = sb_body_add_constraints(tie->body, tie->terms, tie->term_counts, tie->values,
                                         tie->report.constraint_count, &tie->report.first_constraint, error);
    return result;
}

SB_API sb_result sb_body_tie_faces(sb_body *body, const int *faces, int face_count, int corners, const int *slave_nodes,
                                   int slave_count, sb_real max_distance, int options, sb_tie_report *report,
                                   sb_error *error)
{
    sbi_tie tie;
    sbi_arena arena = {NULL, 0, 0};
    sb_result result;
    void *memory = NULL;
    if (!body || face_count < 0 || corners < 3 || corners > 4 || slave_count < 0 || (face_count > 0 && !faces) ||
        (slave_count > 0 && !slave_nodes))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a tie needs faces of 3 or 4 corners and slave nodes");
    if (!sb_is_finite(max_distance) || options < 0 || options > (SB_TIE_CLOSE_GAPS | SB_TIE_ALL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_distance %g of a tie is not finite, or its options %d unknown",
                        (double)max_distance, options);
    memset(&tie, 0, sizeof tie);
    tie.body = body;
    tie.face_count = face_count;
    tie.slaves = slave_nodes;
    tie.slave_count = slave_count;
    tie.max_distance = max_distance;
    tie.options = options;
    tie.report.farthest_node = -1;
    sbi_tie_layout(&tie, &arena);
    if (!arena.overflow && slave_count <= INT_MAX / (3 * (1 + SB_MAX_FACE_NODES)))
        memory = sbi_alloc_zeroed(&body->allocator, arena.used, 1);
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to tie %d nodes", slave_count);
    arena.base = (unsigned char *)memory;
    arena.used = 0;
    sbi_tie_layout(&tie, &arena);
    result = sbi_tie_run(&tie, faces, corners, error);
    sbi_free(&body->allocator, memory);
    if (result == SB_OK && report)
        *report = tie.report;
    return result;
}

/* ---- for steps ---- */

static uint64_t sbi_constraint_hash(uint64_t hash, const void *data, size_t bytes)
{
    const unsigned char *p = (const unsigned char *)data;
    for (size_t i = 0; i < bytes; i++) /* FNV-1a */
        hash = (hash ^ p[i]) * UINT64_C(1099511628211);
    return hash;
}

SBI_API uint64_t sbi_constraint_signature(const sb_body *body)
{
    const sbi_equations *q = body->elimination ? &body->elimination->equations : NULL;
    uint64_t hash = UINT64_C(14695981039346656037);
    size_t terms;
    if (!q)
        return 0;
    terms = (size_t)q->start[q->count];
    hash = sbi_constraint_hash(hash, q->id, (size_t)q->count * sizeof(int));
    hash = sbi_constraint_hash(hash, q->start, ((size_t)q->count + 1) * sizeof(int));
    hash = sbi_constraint_hash(hash, q->dof, terms * sizeof(int));
    return sbi_constraint_hash(hash, q->coefficient, terms * sizeof(sb_real));
}

/* sum over the masters of equation c of -a_k / a_0 times v_k */
static sb_real sbi_constraint_follow_rate(const sbi_equations *q, int c, const sb_vec3 *v)
{
    double sum = 0;
    for (int t = q->start[c] + 1; t < q->start[c + 1]; t++)
        sum -= (double)q->coefficient[t] * (double)sbi_elimination_get(v, q->dof[t]);
    return (sb_real)(sum / (double)q->coefficient[q->start[c]]);
}

/* As a moving support's, the gap's rate is constant over the step: way / dt, whatever it was before. */
SBI_API void sbi_constraint_scheme(sb_body *body, sb_real cv, sb_real ca, sb_real dt, sb_real level, sb_real inertia)
{
    const sbi_elimination *e = body->elimination;
    const sbi_equations *q = &e->equations;
    for (int k = 0; k < q->count; k++) {
        int c = e->order[k], slave = q->dof[q->start[c]];
        sb_real way = e->start_gap[c], rate = way / dt;
        sb_real before = sbi_elimination_get(body->velocity, slave) - sbi_constraint_follow_rate(q, c, body->velocity);
        sb_real change = (rate - before) / dt;
        if (level < 1)
            rate = (1 - level) * before + level * rate;
        if (inertia != 1)
            change = inertia * change + (1 - inertia) * (sbi_elimination_get(body->acceleration, slave) -
                                                         sbi_constraint_follow_rate(q, c, body->acceleration));
        way *= level;
        *sbi_elimination_at(body->velocity0, slave) =
            sbi_constraint_follow_rate(q, c, body->velocity0) + (rate - cv * way);
        *sbi_elimination_at(body->acceleration0, slave) =
            sbi_constraint_follow_rate(q, c, body->acceleration0) + (change - ca * way);
    }
}

SBI_API void sbi_constraint_gap_rates(sb_body *body, sb_real dt)
{
    sbi_elimination *e = body->elimination;
    const sbi_equations *q = &e->equations;
    for (int c = 0; c < q->count; c++) {
        sb_real before =
            sbi_elimination_get(body->velocity, q->dof[q->start[c]]) - sbi_constraint_follow_rate(q, c, body->velocity);
        e->gap[c] = (e->start_gap[c] / dt - before) / dt;
    }
}

SBI_API void sbi_constraint_follow(const sb_body *body, sb_vec3 *v, sb_real share)
{
    const sbi_elimination *e = body->elimination;
    const sbi_equations *q = &e->equations;
    for (int k = 0; k < q->count; k++) {
        int c = e->order[k];
        *sbi_elimination_at(v, q->dof[q->start[c]]) = sbi_constraint_follow_rate(q, c, v) + e->start_gap[c] * share;
    }
}

SBI_API void sbi_constraint_reactions(sb_body *body, sb_vec3 *out_of_balance)
{
    sbi_elimination *e = body->elimination;
    for (int i = 0; i < body->domain.node_count; i++)
        if (body->node_component[i] < 0) /* nodes of no element feel constraints only */
            out_of_balance[i] = sb_v3(0, 0, 0);
    sbi_elimination_reduce(e, out_of_balance, out_of_balance, e->force);
    for (int i = 0; i < body->domain.node_count; i++)
        body->reaction[i] = sbi_body_pick_axes(body->fixed[i], out_of_balance[i], sb_v3(0, 0, 0));
}

/* ---- lumped masses ---- */

SBI_API int sbi_constraint_entry_of(const sb_body *b, int node, int axis, int k, sbi_constraint_entry *entry)
{
    const sbi_elimination *e = b->elimination;
    int block = e->first[node] + k / 3;
    if (block >= e->first[node + 1])
        return 0;
    entry->dof = 3 * e->master[block] + k % 3;
    entry->weight = e->weight[block][3 * axis + k % 3];
    entry->is_free = entry->weight != 0 && !(b->fixed[e->master[block]] >> k % 3 & 1);
    return 1;
}

SBI_API sb_result sbi_constraint_explicit_check(const sb_body *body, sb_error *error)
{
    const sbi_elimination *e = body->elimination;
    for (int i = 0; e && i < body->domain.node_count; i++)
        for (int axis = 0; axis < 3; axis++) {
            sbi_constraint_entry entry;
            int masters = 0, negative = 0;
            for (int k = 0; e->slave[i] >> axis & 1 && sbi_constraint_entry_of(body, i, axis, k, &entry); k++) {
                masters += entry.is_free;
                negative += entry.is_free && entry.weight < 0;
            }
            if (masters > 1 && negative > 0)
                return sbi_fail_node(error, SB_ERROR_UNSUPPORTED, i,
                                     "the mass of slave node %d along %c cannot be lumped: a weight is negative", i,
                                     sbi_constraint_axis(axis));
        }
    return SB_OK;
}

/* Hands the force of one slave axis to its free masters, or (force NULL) its mass. `known` is what the slave's
 * acceleration has from supports and gaps. */
static void sbi_constraint_lump(sb_body *b, int node, int axis, sb_vec3 *force, sb_real known)
{
    sbi_constraint_entry entry;
    sb_real sum = 0, m = b->lumped_mass[node];
    for (int k = 0; sbi_constraint_entry_of(b, node, axis, k, &entry); k++)
        sum += entry.is_free ? entry.weight : (sb_real)0;
    for (int k = 0; sbi_constraint_entry_of(b, node, axis, k, &entry); k++) {
        if (!entry.is_free)
            continue;
        if (force)
            *sbi_elimination_at(force, entry.dof) +=
                entry.weight * (sbi_elimination_get(force, 3 * node + axis) - m * known);
        else
            *sbi_elimination_at(b->elimination->reduced, entry.dof) += entry.weight * m * sum;
    }
}

SBI_API void sbi_constraint_masses(sb_body *body)
{
    sbi_elimination *e = body->elimination;
    const sb_vec3 zero = sb_v3(0, 0, 0);
    for (int i = 0; i < body->domain.node_count; i++) {
        sb_real m = body->lumped_mass[i];
        e->reduced[i] = sbi_body_pick_axes(sbi_body_held(body, i), zero, sb_v3(m, m, m));
    }
    for (int i = 0; i < body->domain.node_count; i++)
        for (int axis = 0; axis < 3; axis++)
            if (e->slave[i] >> axis & 1)
                sbi_constraint_lump(body, i, axis, NULL, 0);
}

SBI_API void sbi_constraint_explicit(sb_body *body, const sb_vec3 *force, sb_vec3 *acceleration, int with_gaps)
{
    sbi_elimination *e = body->elimination;
    int n = body->domain.node_count;
    memcpy(e->work, force, (size_t)n * sizeof(sb_vec3));
    sbi_constraint_masses(body);
    for (int i = 0; i < n; i++)
        acceleration[i] = sbi_body_pick_axes(body->fixed[i], acceleration[i], sb_v3(0, 0, 0));
    sbi_elimination_expand(e, acceleration, with_gaps);
    for (int i = 0; i < n; i++)
        for (int axis = 0; axis < 3; axis++)
            if (e->slave[i] >> axis & 1)
                sbi_constraint_lump(body, i, axis, e->work, sbi_elimination_get(acceleration, 3 * i + axis));
    for (int i = 0; i < n; i++)
        for (int axis = 0; axis < 3; axis++)
            if (!(sbi_body_held(body, i) >> axis & 1))
                *sbi_elimination_at(acceleration, 3 * i + axis) =
                    sbi_elimination_get(e->work, 3 * i + axis) / sbi_elimination_get(e->reduced, 3 * i + axis);
    sbi_elimination_expand(e, acceleration, with_gaps);
}

/* m/2 (S sum w v^2 - (sum w v)^2) over the free masters of each slave axis, S the sum of their weights. */
SBI_API double sbi_constraint_lumped_energy(const sb_body *body, const sb_vec3 *v)
{
    double energy = 0;
    for (int i = 0; i < body->domain.node_count; i++)
        for (int axis = 0; axis < 3; axis++) {
            sbi_constraint_entry entry;
            double weights = 0, mean = 0, square = 0;
            for (int k = 0;
                 body->elimination->slave[i] >> axis & 1 && sbi_constraint_entry_of(body, i, axis, k, &entry); k++) {
                double rate = (double)sbi_elimination_get(v, entry.dof);
                if (!entry.is_free)
                    continue;
                weights += (double)entry.weight;
                mean += (double)entry.weight * rate;
                square += (double)entry.weight * rate * rate;
            }
            energy += 0.5 * (double)body->lumped_mass[i] * (weights * square - mean * mean);
        }
    return energy;
}
