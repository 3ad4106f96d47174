/* infer_round: the organ's response where it is now, the loads and the pose that explain the gaps, and the move there.
 */
#include "infer_private.h"

#include <string.h>

/* Deviation of the offset of all points, as share of the organ's size. */
#define REGI_INFER_OFFSET 1e-3
/* Farthest that a round moves a node, as share of the size: the response is linear no farther. */
#define REGI_INFER_STEP ((sb_real)0.1)

/* ---- responses ---- */

/* What unit tractions and weights do along a row: a datum's response, or a resultant. */
static void regi_infer_store(reg_infer *f, int at, const sb_vec3 *row)
{
    int c = f->model->prior.control_count;
    size_t m = (size_t)f->gauss.most;
    sb_vec3 weight;
    regi_prior_collect(&f->model->prior, row, f->tractions, &weight);
    for (int j = 0; j <= c; j++) {
        sb_vec3 v = j < c ? f->tractions[j] : weight;
        double *to = f->raw + (size_t)(3 * j) * m + (size_t)at;
        to[0] = (double)v.x;
        to[m] = (double)v.y;
        to[2 * m] = (double)v.z;
    }
}

/* What is held does not move but with the pose. */
static void regi_infer_hold(const reg_infer *f, sb_vec3 *row)
{
    const unsigned char *held = sb_body_supports(f->model->body);
    for (int i = 0; i < f->node_count; i++)
        row[i] = sbi_body_pick_axes(held[i], sb_v3(0, 0, 0), row[i]);
}

/* Responses of all data, a group at a time, and the gaps that loads and pose have to close in all: those seen, and
 * those that would open if the present loads and pose went. */
static void regi_infer_respond(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    size_t n = (size_t)f->node_count;
    for (int first = 0; first < g->count; first += SBI_FRONT_GROUP) {
        int count = sbi_min_int(SBI_FRONT_GROUP, g->count - first);
        memset(f->row, 0, (size_t)count * n * sizeof *f->row);
        for (int s = 0; s < count; s++) {
            double pose[REGI_INFER_POSE];
            regi_infer_row(f, first + s, f->row + (size_t)s * n, g->gap + first + s, pose);
            regi_infer_hold(f, f->row + (size_t)s * n);
            for (int k = 0; k < REGI_INFER_POSE; k++) {
                g->pose[(size_t)k * (size_t)g->most + (size_t)(first + s)] = pose[k] * f->pose_sd[k];
                g->gap[first + s] += pose[k] * f->pose[k];
            }
            g->pose[(size_t)REGI_INFER_POSE * (size_t)g->most + (size_t)(first + s)] =
                f->patch_of[first + s] < 0 ? 0 : REGI_INFER_OFFSET * (double)f->model->size;
        }
        (void)sb_direct_solve(f->direct, &f->row[0].x, &f->row[0].x, count);
        for (int s = 0; s < count; s++) {
            const sb_vec3 *row = f->row + (size_t)s * n;
            for (size_t i = 0; i < n; i++)
                g->gap[first + s] += (double)sb_v3_dot(row[i], f->residual[i]);
            regi_infer_store(f, first + s, row);
        }
    }
}

/* Forces and torques about the centre, over the size, of unit loads where the organ is now. */
static void regi_infer_sum_up(reg_infer *f)
{
    const sb_vec3 *x = sb_body_positions(f->model->body);
    for (int e = 0; e < f->gauss.exact; e++) {
        sb_vec3 axis = sb_v3(e % 3 == 0, e % 3 == 1, e % 3 == 2);
        for (int i = 0; i < f->node_count; i++)
            f->row[i] = e < 3 ? axis : sb_v3_scale(1 / f->model->size, sb_v3_cross(axis, sb_v3_sub(x[i], f->centre)));
        regi_infer_store(f, f->gauss.count + e, f->row);
    }
}

/* ---- move ---- */

/* Smallest det F of the points at displacements u[nodes]. */
static sb_real regi_infer_least_volume(const reg_infer *f, const sb_vec3 *u)
{
    const sb_domain *d = &f->model->domain;
    int n = d->nodes_per_cell, q = d->points_per_cell;
    sb_real least = SB_REAL_MAX;
    for (int e = 0; e < d->cell_count; e++)
        for (int p = 0; p < q; p++) {
            const sb_real *g = d->gradients + ((size_t)e * (size_t)q + (size_t)p) * (size_t)n * 3;
            sb_mat3 deformation = sb_m3_identity();
            for (int a = 0; a < n; a++)
                deformation = sb_m3_add(deformation, sb_m3_outer(u[d->cells[(size_t)e * (size_t)n + (size_t)a]],
                                                                 sb_v3(g[3 * a], g[3 * a + 1], g[3 * a + 2])));
            least = sb_min(least, sb_m3_det(deformation));
        }
    return least;
}

/* trial = u and a share of the loads' increment and of what is new of the pose, turned as a whole. */
static void regi_infer_try(reg_infer *f, double share)
{
    const sb_vec3 *x = sb_body_positions(f->model->body);
    sb_real d[REGI_INFER_POSE];
    sb_vec3 way;
    sb_mat3 rotation;
    for (int k = 0; k < REGI_INFER_POSE; k++)
        d[k] = (sb_real)(share * (f->next[k] - f->pose[k]));
    way = sb_v3_add(f->centre, sb_v3(d[0], d[1], d[2]));
    rotation = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(d[3], d[4], d[5])));
    for (int i = 0; i < f->node_count; i++) {
        sb_vec3 moved = sb_v3_sub(sb_v3_madd(x[i], (sb_real)share, f->increment[i]), f->centre);
        f->trial[i] = sb_v3_sub(sb_v3_add(sb_m3_apply(rotation, moved), way), f->model->mesh.nodes[i]);
    }
}

/* Moves there, or as far as no element comes near to turning inside out. */
static sb_result regi_infer_move(reg_infer *f, double share, sb_error *error)
{
    const sb_vec3 *u = sb_body_displacements(f->model->body);
    sb_real least = regi_infer_least_volume(f, u), volume = 0;
    int tries = 0;
    least = sb_min((sb_real)0.02, (sb_real)0.5 * least);
    do {
        sb_real way = 0;
        regi_infer_try(f, share);
        for (int i = 0; i < f->node_count; i++)
            way = sb_max(way, sb_v3_norm(sb_v3_sub(f->trial[i], u[i])));
        volume = way <= REGI_INFER_STEP * f->model->size ? regi_infer_least_volume(f, f->trial) : -1;
        if (volume >= least)
            break;
        share *= 0.5;
    } while (++tries < 40);
    if (!(volume >= least))
        return sbi_fail(error, SB_ERROR_DIVERGED, "the organ cannot be moved without turning an element inside out");
    f->quality.change = 0;
    for (int i = 0; i < f->node_count; i++)
        f->quality.change = sb_max(f->quality.change, sb_v3_norm(sb_v3_sub(f->trial[i], u[i])));
    for (int k = 0; k < REGI_INFER_POSE; k++)
        f->pose[k] += share * (f->next[k] - f->pose[k]);
    return sb_body_set_displacements(f->model->body, f->trial);
}

/* ---- a round ---- */

/* The posterior's mean: forces, and where they take the organ from its present shape. */
static sb_result regi_infer_solve(reg_infer *f, int round, sb_error *error)
{
    sb_vec3 weight;
    int good = round < REGI_INFER_CHOICES ? regi_infer_choose(f)
                                          : regi_infer_set_prior(f, &f->choice) && regi_gauss_solve(&f->gauss);
    if (!good)
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "loads and pose cannot be told from what is seen");
    regi_gauss_explain(&f->gauss, f->gauss.multiplier, f->c, f->next);
    for (int k = 0; k < REGI_INFER_POSE; k++)
        f->next[k] *= f->pose_sd[k];
    regi_infer_unfold(f, f->c, f->tractions, &weight);
    regi_prior_forces(&f->model->prior, f->tractions, weight, f->forces);
    for (int i = 0; i < f->node_count; i++)
        f->increment[i] = sb_v3_sub(f->forces[i], f->residual[i]);
    regi_infer_hold(f, f->increment);
    return sb_direct_solve(f->direct, &f->increment[0].x, &f->increment[0].x, 1);
}

REGI_API sb_result regi_infer_round(reg_infer *f, int round, sb_error *error)
{
    double begun = regi_infer_now(f), responded;
    /* what holds nothing-held organs acts on increments only, and balanced loads do not notice */
    sb_real hold = (sb_real)(f->model->held ? 1e-4 : 1e-2) * REGI_MODEL_YOUNG * f->model->size;
    sb_result result;
    if (regi_infer_look(f, round) == 0)
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "no point of the target is near a place of the organ");
    result = sbi_body_factor(f->model->body, hold, f->residual, f->direct, error);
    if (result != SB_OK)
        return result;
    regi_infer_respond(f);
    regi_infer_sum_up(f);
    responded = regi_infer_now(f);
    f->quality.seconds_response += responded - begun;
    result = regi_infer_solve(f, round, error);
    f->quality.seconds_choice += regi_infer_now(f) - responded;
    if (result == SB_OK)
        result = regi_infer_move(f, round < REGI_INFER_CHOICES ? 1 : 0.7, error);
    f->quality.rounds += result == SB_OK;
    return result;
}
