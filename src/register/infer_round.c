/* infer_round: the loads and the pose that explain the gaps, and the move there. */
#include "infer_private.h"

#include <math.h>
#include <string.h>

/* Farthest that a round moves a node, as share of the size: the response is linear no farther. */
#define REGI_INFER_STEP ((sb_real)0.1)

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
    way = sb_v3_add(f->response.centre, sb_v3(d[0], d[1], d[2]));
    rotation = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(d[3], d[4], d[5])));
    for (int i = 0; i < f->node_count; i++) {
        sb_vec3 moved = sb_v3_sub(sb_v3_madd(x[i], (sb_real)share, f->increment[i]), f->response.centre);
        f->trial[i] = sb_v3_sub(sb_v3_add(sb_m3_apply(rotation, moved), way), f->model->mesh.nodes[i]);
    }
}

/* Least det F that a move may leave. */
static sb_real regi_infer_least_allowed(const reg_infer *f)
{
    sb_real now = regi_infer_least_volume(f, sb_body_displacements(f->model->body));
    return sb_min((sb_real)0.02, (sb_real)0.5 * now);
}

/* Moves there, or as far as no element comes near to turning inside out. f->before: where the organ was. */
static sb_result regi_infer_move(reg_infer *f, sb_error *error)
{
    double share = 1;
    const sb_vec3 *u = sb_body_displacements(f->model->body);
    sb_real least = regi_infer_least_allowed(f), volume = 0;
    int tries = 0;
    memcpy(f->before, sb_body_positions(f->model->body), (size_t)f->node_count * sizeof *f->before);
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

/* ---- the posterior ---- */

/* The posterior's mean: forces, and where they take the organ from its present shape. */
static sb_result regi_infer_solve(reg_infer *f, int round, sb_error *error)
{
    int good = round == 0 ? regi_infer_choose(f) : regi_infer_set_prior(f, &f->choice) && regi_gauss_solve(&f->gauss);
    if (!good)
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "loads and pose cannot be told from what is seen");
    regi_gauss_explain(&f->gauss, f->gauss.multiplier, f->c, f->next);
    for (int k = 0; k < REGI_INFER_POSE; k++)
        f->next[k] *= f->pose_sd[k];
    f->quality.pressure = (sb_real)regi_infer_pressure(f, f->c);
    regi_infer_load(f, f->c, f->forces);
    for (int i = 0; i < f->node_count; i++)
        f->increment[i] = sb_v3_sub(f->forces[i], f->response.residual[i]);
    regi_response_solve(&f->response, f->increment, 1);
    return SB_OK;
}

/* ---- exact landmarks ---- */

/* Gaps of what is to be met exactly where the organ is now; of other data none. Returns the largest (m). */
static double regi_infer_find_misses(reg_infer *f)
{
    const regi_gauss *g = &f->gauss;
    double most = 0;
    memset(f->row, 0, (size_t)f->node_count * sizeof *f->row);
    for (int i = 0; i < g->count; i++) {
        double pose[REGI_INFER_POSE];
        f->datum[i] = 0;
        if (g->variance[i] > 0)
            continue;
        regi_infer_row(f, i, f->row, f->datum + i, pose);
        most = fabs(f->datum[i]) > most ? fabs(f->datum[i]) : most;
    }
    return most;
}

/* Loads and a motion of the whole that close the gaps in `datum` and no other, about where the organ was before the
 * last round: trial. */
static void regi_infer_try_to_meet(reg_infer *f)
{
    const sb_vec3 *u = sb_body_displacements(f->model->body);
    double pose[REGI_GAUSS_POSES];
    sb_real d[REGI_INFER_POSE];
    regi_gauss_apply_inverse(&f->gauss, f->datum);
    regi_gauss_explain(&f->gauss, f->datum, f->draw, pose);
    for (int k = 0; k < REGI_INFER_POSE; k++)
        d[k] = (sb_real)(pose[k] * f->pose_sd[k]);
    regi_infer_load(f, f->draw, f->increment);
    regi_response_solve(&f->response, f->increment, 1);
    for (int i = 0; i < f->node_count; i++) {
        sb_vec3 arm = sb_v3_sub(f->before[i], f->response.centre);
        sb_vec3 whole = sb_v3_add(sb_v3(d[0], d[1], d[2]), sb_v3_cross(sb_v3(d[3], d[4], d[5]), arm));
        f->trial[i] = sb_v3_add(u[i], sb_v3_add(f->increment[i], whole));
    }
}

/* The last round's finite turn and what it left of its way leave exact landmarks by a thousandth of the size: what is
 * linear about it closes that, once for the gap and once more for the rounding of a large one. Where elements would
 * turn inside out it stays. */
REGI_API sb_result regi_infer_meet(reg_infer *f)
{
    enum { TIMES = 3 };
    sb_result result = SB_OK;
    sb_real least = regi_infer_least_allowed(f);
    for (int k = 0; result == SB_OK && k < TIMES && regi_infer_find_misses(f) > 0; k++) {
        regi_infer_try_to_meet(f);
        if (!(regi_infer_least_volume(f, f->trial) >= least))
            break;
        result = sb_body_set_displacements(f->model->body, f->trial);
    }
    return result;
}

/* ---- a round ---- */

REGI_API sb_result regi_infer_round(reg_infer *f, int round, sb_error *error)
{
    double begun = regi_infer_now(f), responded;
    sb_result result;
    if (regi_infer_look(f, round) == 0)
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "no point of the target is near a place of the organ");
    result = round == 0 ? regi_response_factor_turned(&f->response, f->def->start.rotation, error)
                        : regi_response_factor(&f->response, error);
    if (result != SB_OK)
        return result;
    regi_infer_respond(f);
    responded = regi_infer_now(f);
    f->quality.seconds_response += responded - begun;
    result = regi_infer_solve(f, round, error);
    f->quality.seconds_choice += regi_infer_now(f) - responded;
    if (result == SB_OK)
        result = regi_infer_move(f, error);
    f->quality.rounds += result == SB_OK;
    return result;
}
