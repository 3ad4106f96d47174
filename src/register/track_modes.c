/* track_modes: the shapes that tractions of the prior give an organ, most of the motion first. */
#include "track_private.h"

#include <math.h>
#include <string.h>

#include "../softbody/base/eigen.h"
#include "chance.h"

/* ---- loads: vectors of 3 c numbers, drawn from N(0, I) by the prior ---- */

static int regi_track_load_count(const reg_track *t) { return 3 * t->model->prior.control_count; }
static int regi_track_trial_count(const reg_track *t)
{
    return sbi_min_int(t->def.modes + REGI_TRACK_SPARE, regi_track_load_count(t));
}

static double regi_track_dot(const double *a, const double *b, int n)
{
    double sum = 0;
    for (int i = 0; i < n; i++)
        sum += a[i] * b[i];
    return sum;
}

/* Takes out of a what of it is along `count` orthonormal rows (or rows of 0), twice. */
static void regi_track_clear(double *a, const double *rows, int count, int n)
{
    for (int twice = 0; twice < 2; twice++)
        for (int k = 0; k < count; k++) {
            const double *row = rows + (size_t)k * (size_t)n;
            double along = regi_track_dot(a, row, n);
            for (int i = 0; i < n; i++)
                a[i] -= along * row[i];
        }
}

/* Makes rows[count][n] orthonormal; those that are sums of the ones before become 0. */
static void regi_track_orthonormalise(double *rows, int count, int n)
{
    for (int k = 0; k < count; k++) {
        double *row = rows + (size_t)k * (size_t)n, before = sqrt(regi_track_dot(row, row, n)), after;
        regi_track_clear(row, rows, k, n);
        after = sqrt(regi_track_dot(row, row, n));
        for (int i = 0; i < n; i++)
            row[i] = after > 1e-9 * before ? row[i] / after : 0;
    }
}

/* loads: what unit loads do along row[nodes]. */
static void regi_track_collect(reg_track *t, const sb_vec3 *row, double *loads)
{
    int c = t->model->prior.control_count;
    sb_vec3 weight;
    regi_prior_collect(&t->model->prior, row, t->tractions, &weight);
    memset(loads, 0, (size_t)regi_track_load_count(t) * sizeof *loads);
    for (int j = 0; j < c; j++)
        for (int k = 0; k <= j; k++) {
            double root = t->root[(size_t)j * (size_t)c + (size_t)k];
            loads[3 * k] += root * (double)t->tractions[j].x;
            loads[3 * k + 1] += root * (double)t->tractions[j].y;
            loads[3 * k + 2] += root * (double)t->tractions[j].z;
        }
}

/* forces[nodes] of loads. */
static void regi_track_spread_loads(reg_track *t, const double *loads, sb_vec3 *forces)
{
    int c = t->model->prior.control_count;
    for (int j = 0; j < c; j++) {
        double sum[3] = {0, 0, 0};
        for (int k = 0; k <= j; k++)
            for (int axis = 0; axis < 3; axis++)
                sum[axis] += t->root[(size_t)j * (size_t)c + (size_t)k] * loads[3 * k + axis];
        t->tractions[j] = sb_v3((sb_real)sum[0], (sb_real)sum[1], (sb_real)sum[2]);
    }
    regi_prior_forces(&t->model->prior, t->tractions, sb_v3(0, 0, 0), forces);
}

/* Resultants that loads of an organ that nothing holds must not have: forces, and torques about the middle. */
static int regi_track_find_resultants(reg_track *t)
{
    const sb_vec3 *x = sb_body_positions(t->model->body);
    int count = t->model->held ? 0 : REGI_TRACK_POSE, n = regi_track_load_count(t);
    for (int e = 0; e < count; e++) {
        sb_vec3 axis = sb_v3(e % 3 == 0, e % 3 == 1, e % 3 == 2);
        for (int i = 0; i < t->node_count; i++)
            t->moved[i] =
                e < 3 ? axis : sb_v3_scale(1 / t->model->size, sb_v3_cross(axis, sb_v3_sub(x[i], t->response.centre)));
        regi_track_collect(t, t->moved, t->resultants + (size_t)e * (size_t)n);
    }
    regi_track_orthonormalise(t->resultants, count, n);
    return count;
}

/* ---- the search: subspace iteration from random loads ---- */

/* moved: what the loads do. */
static void regi_track_respond(reg_track *t)
{
    int count = regi_track_trial_count(t), n = regi_track_load_count(t);
    for (int k = 0; k < count; k++)
        regi_track_spread_loads(t, t->loads + (size_t)k * (size_t)n, t->moved + (size_t)k * (size_t)t->node_count);
    regi_response_solve(&t->response, t->moved, count);
}

/* loads: balanced, orthonormal, those that move the organ most among those that moved[] stands for. */
static void regi_track_improve(reg_track *t, int resultants)
{
    int count = regi_track_trial_count(t), n = regi_track_load_count(t);
    regi_response_solve(&t->response, t->moved, count);
    for (int k = 0; k < count; k++) {
        double *loads = t->loads + (size_t)k * (size_t)n;
        regi_track_collect(t, t->moved + (size_t)k * (size_t)t->node_count, loads);
        regi_track_clear(loads, t->resultants, resultants, n);
    }
    regi_track_orthonormalise(t->loads, count, n);
}

/* Products of the motions, mean over the nodes, and their eigenvectors. */
static int regi_track_compare(reg_track *t)
{
    int count = regi_track_trial_count(t);
    size_t n = (size_t)t->node_count;
    for (int k = 0; k < count; k++)
        for (int l = 0; l <= k; l++) {
            double sum = 0;
            for (size_t i = 0; i < n; i++)
                sum += (double)sb_v3_dot(t->moved[(size_t)k * n + i], t->moved[(size_t)l * n + i]);
            t->gram[k * count + l] = t->gram[l * count + k] = sum / (double)t->node_count;
        }
    return sbi_symmetric_eigen(t->gram, count, t->values, t->vectors, t->values + count);
}

/* 0: there are none. */
static int regi_track_search(reg_track *t)
{
    regi_chance chance = {(uint64_t)0x9e3779b97f4a7c15u, 0, 0};
    int count = regi_track_trial_count(t), n = regi_track_load_count(t), resultants;
    if (!regi_prior_root(&t->model->prior, REGI_INFER_LENGTH, NULL, t->root))
        return 0;
    resultants = regi_track_find_resultants(t);
    for (int k = 0; k < count * n; k++)
        t->loads[k] = regi_chance_normal(&chance);
    for (int k = 0; k < count; k++)
        regi_track_clear(t->loads + (size_t)k * (size_t)n, t->resultants, resultants, n);
    for (int pass = 0; pass < REGI_TRACK_PASSES; pass++) {
        regi_track_respond(t);
        regi_track_improve(t, resultants);
    }
    regi_track_respond(t);
    return regi_track_compare(t) && t->values[count - 1] > 0;
}

/* ---- what follows from the shapes ---- */

/* modes: of one unit of deviation each, and `motion` in all. */
static void regi_track_keep_modes(reg_track *t)
{
    int count = regi_track_trial_count(t);
    double sum = 0, scale;
    for (int k = 0; k < t->def.modes; k++)
        sum += t->values[count - 1 - k] > 0 ? t->values[count - 1 - k] : 0;
    scale = (double)t->def.motion / sqrt(sum);
    memset(t->modes, 0, (size_t)t->def.modes * (size_t)t->node_count * sizeof *t->modes);
    for (int k = 0; k < t->def.modes; k++) {
        const double *vector = t->vectors + (size_t)(count - 1 - k) * (size_t)count;
        sb_vec3 *mode = t->modes + (size_t)k * (size_t)t->node_count;
        for (int l = 0; l < count; l++)
            for (int i = 0; i < t->node_count; i++)
                mode[i] = sb_v3_madd(mode[i], (sb_real)(scale * vector[l]),
                                     t->moved[(size_t)l * (size_t)t->node_count + (size_t)i]);
    }
}

/* arms[count] and modes[count][3][modes] of the points of a mapping; scratch: [count]. */
static void regi_track_carry(const reg_track *t, const sb_mapping *mapping, int count, sb_vec3 *arms, double *modes,
                             sb_vec3 *scratch)
{
    size_t q = (size_t)t->def.modes;
    sb_mapping_apply(mapping, t->arms, arms);
    for (size_t k = 0; k < q; k++) {
        sb_mapping_apply(mapping, t->modes + k * (size_t)t->node_count, scratch);
        for (int i = 0; i < count; i++) {
            double *to = modes + (size_t)i * 3 * q + k;
            to[0] = (double)scratch[i].x;
            to[q] = (double)scratch[i].y;
            to[2 * q] = (double)scratch[i].z;
        }
    }
}

/* row[unknowns]: what they do to a node along an axis of the organ. */
static void regi_track_node_row(const reg_track *t, int node, int axis, double *row)
{
    sb_vec3 line = sb_v3(axis == 0, axis == 1, axis == 2), turn = sb_v3_cross(t->arms[node], line);
    for (int k = 0; k < t->def.modes; k++)
        row[k] = (double)sb_v3_dot(line, t->modes[(size_t)k * (size_t)t->node_count + (size_t)node]);
    row += t->def.modes;
    row[0] = (double)line.x, row[1] = (double)line.y, row[2] = (double)line.z;
    row[3] = (double)turn.x, row[4] = (double)turn.y, row[5] = (double)turn.z;
}

static void regi_track_find_spread(reg_track *t)
{
    size_t n = (size_t)t->unknowns;
    double share = sqrt(1.0 / t->node_count);
    memset(t->spread, 0, n * n * sizeof *t->spread);
    for (int i = 0; i < t->node_count; i++) {
        for (int axis = 0; axis < 3; axis++) {
            double *row = t->rows + (size_t)axis * n;
            regi_track_node_row(t, i, axis, row);
            for (size_t k = 0; k < n; k++)
                row[k] *= share;
        }
        regi_gauss_add_squares(t->wide, t->spread, t->unknowns, t->rows, 3, n);
    }
    for (size_t k = 0; k < n; k++)
        for (size_t l = 0; l < k; l++)
            t->spread[k * n + l] = t->spread[l * n + k];
}

REGI_API void regi_track_covariance_of(const reg_track *t, int node, double *row, sb_mat3 *covariance)
{
    size_t n = (size_t)t->unknowns;
    sb_mat3 turned = sb_quat_to_mat3(t->known.turned);
    double rows[3][REGI_TRACK_UNKNOWNS];
    for (int axis = 0; axis < 3; axis++)
        regi_track_node_row(t, node, axis, rows[axis]);
    for (int a = 0; a < 3; a++) {
        memset(row, 0, n * sizeof *row);
        for (size_t k = 0; k < n; k++)
            for (size_t l = 0; l < n; l++)
                row[l] += rows[a][k] * t->known.covariance[k * n + l];
        for (int b = 0; b < 3; b++)
            covariance->m[a][b] =
                (sb_real)(REGI_TRACK_ALPHA * REGI_TRACK_ALPHA * regi_track_dot(row, rows[b], t->unknowns));
    }
    *covariance = sb_m3_mul(turned, sb_m3_mul(*covariance, sb_m3_transpose(turned)));
}

REGI_API void regi_track_derive(reg_track *t)
{
    regi_track_carry(t, &t->model->rows.mapping, t->skin_count, t->skin_arms, t->skin_modes, t->skin);
    if (t->marks.count > 0)
        regi_track_carry(t, &t->marks.rows.mapping, t->marks.count, t->mark_arms, t->mark_modes, t->marks.places);
    regi_track_find_spread(t);
}

static void regi_track_begin(reg_track *t, const reg_rigid *pose, const sb_real pose_sd[2])
{
    const sb_vec3 *x = sb_body_positions(t->model->body);
    for (int i = 0; i < t->node_count; i++)
        t->arms[i] = sb_v3_sub(x[i], t->response.centre);
    regi_track_keep_modes(t);
    regi_track_derive(t);
    memset(t->known.mean, 0, (size_t)t->def.modes * sizeof *t->known.mean);
    t->known.place = reg_rigid_apply(pose, t->response.centre);
    t->known.turned = sb_quat_from_mat3(pose->rotation);
    t->known.blind = 0;
    t->known.surprises = 0;
    regi_track_open(t, &t->known, pose_sd);
}

/* Puts the body to displacements[nodes], but without the rigid motion in them, which is told: shapes must not depend on
 * the frame that the organ is seen in. */
static sb_result regi_track_place_body(reg_track *t, const sb_vec3 *displacements, reg_rigid *pose, sb_error *error)
{
    const sb_vec3 *rest = t->model->mesh.nodes;
    sb_vec3 middle = sb_v3(0, 0, 0);
    reg_rigid back;
    sb_result result;
    for (int i = 0; i < t->node_count; i++)
        t->shape[i] = sb_v3_add(rest[i], displacements[i]);
    result = reg_rigid_fit(rest, t->shape, NULL, t->node_count, pose, error);
    if (result != SB_OK)
        return result;
    back = reg_rigid_inverse(pose);
    for (int i = 0; i < t->node_count; i++) {
        sb_vec3 x = reg_rigid_apply(&back, t->shape[i]);
        middle = sb_v3_madd(middle, 1 / (sb_real)(i + 1), sb_v3_sub(x, middle));
        t->shape[i] = sb_v3_sub(x, rest[i]);
    }
    t->response.centre = middle;
    sb_body_reset(t->model->body);
    result = sb_body_set_displacements(t->model->body, t->shape);
    return result == SB_OK ? SB_OK : sbi_fail(error, result, "the organ cannot be placed where it is to begin");
}

REGI_API sb_result regi_track_linearise(reg_track *t, const sb_vec3 *displacements, const sb_real pose_sd[2],
                                        sb_error *error)
{
    reg_rigid pose;
    sb_result result = regi_track_place_body(t, displacements, &pose, error);
    if (result == SB_OK)
        result = regi_response_factor(&t->response, error);
    if (result != SB_OK)
        return result;
    if (!regi_track_search(t))
        return sbi_fail(error, SB_ERROR_INDEFINITE, "no load moves the organ");
    regi_track_begin(t, &pose, pose_sd);
    return SB_OK;
}
