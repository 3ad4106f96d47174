/* response: see response.h. */
#include "response.h"

#include <string.h>

#include "gauss.h"

REGI_API void regi_response_layout(regi_response *r, int node_count, sbi_arena *arena)
{
    size_t n = (size_t)node_count;
    r->residual = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    r->weighted_modes = (sb_vec3 *)sbi_arena_take(arena, n, REGI_RESPONSE_MODES * sizeof(sb_vec3));
    r->drift = (sb_vec3 *)sbi_arena_take(arena, n, (REGI_RESPONSE_MODES + 1) * sizeof(sb_vec3));
    r->recoil = r->drift ? r->drift + REGI_RESPONSE_MODES * n : NULL; /* solved for along with it */
}

/* What is held does not move but with the pose. */
static void regi_response_hold(const regi_response *r, sb_vec3 *row)
{
    const unsigned char *held = sb_body_supports(r->model->body);
    for (int i = 0; i < r->model->mesh.node_count; i++)
        row[i] = sbi_body_pick_axes(held[i], sb_v3(0, 0, 0), row[i]);
}

/* Takes the motion as a whole, by shares of the mass, out of u[nodes], by forces on the modes. */
static void regi_response_stop_drift(const regi_response *r, sb_vec3 *u)
{
    size_t n = (size_t)r->model->mesh.node_count;
    double c[REGI_RESPONSE_MODES];
    for (int k = 0; k < REGI_RESPONSE_MODES; k++) {
        c[k] = 0;
        for (size_t i = 0; i < n; i++)
            c[k] += (double)sb_v3_dot(r->weighted_modes[(size_t)k * n + i], u[i]);
    }
    regi_gauss_substitute(r->drift_system, REGI_RESPONSE_MODES, REGI_RESPONSE_MODES, c);
    for (int k = 0; k < REGI_RESPONSE_MODES; k++)
        for (size_t i = 0; i < n; i++)
            u[i] = sb_v3_madd(u[i], (sb_real)-c[k], r->drift[(size_t)k * n + i]);
}

REGI_API sb_vec3 regi_response_to_factor(const regi_response *r, sb_vec3 v)
{
    return r->turned ? sb_m3_tapply(r->frame, v) : v;
}

REGI_API sb_vec3 regi_response_from_factor(const regi_response *r, sb_vec3 v)
{
    return r->turned ? sb_m3_apply(r->frame, v) : v;
}

/* Rows by the factor's inverse, in place. */
static void regi_response_divide(regi_response *r, sb_vec3 *row, int count)
{
    size_t all = (size_t)count * (size_t)r->model->mesh.node_count;
    for (size_t k = 0; k < all && r->turned; k++)
        row[k] = sb_m3_tapply(r->frame, row[k]);
    (void)sb_direct_solve(r->direct, &row[0].x, &row[0].x, count);
    for (size_t k = 0; k < all && r->turned; k++)
        row[k] = sb_m3_apply(r->frame, row[k]);
}

REGI_API void regi_response_solve(regi_response *r, sb_vec3 *row, int count)
{
    for (int s = 0; s < count; s++)
        regi_response_hold(r, row + (size_t)s * (size_t)r->model->mesh.node_count);
    regi_response_divide(r, row, count);
    for (int s = 0; s < count && !r->model->held; s++)
        regi_response_stop_drift(r, row + (size_t)s * (size_t)r->model->mesh.node_count);
}

REGI_API void regi_response_mode(const regi_response *r, int mode, sb_vec3 *forces)
{
    const sb_vec3 *x = sb_body_positions(r->model->body);
    sb_vec3 axis = sb_v3(mode % 3 == 0, mode % 3 == 1, mode % 3 == 2);
    for (int i = 0; i < r->model->mesh.node_count; i++) {
        sb_vec3 turned = sb_v3_scale(1 / r->model->size, sb_v3_cross(axis, sb_v3_sub(x[i], r->centre)));
        forces[i] = sb_v3_scale(r->model->prior.weight[i], mode < 3 ? axis : turned);
    }
}

/* What modes and residual do where the organ is. 0: the modes' system is not positive. */
static int regi_response_find_drift(regi_response *r)
{
    size_t n = (size_t)r->model->mesh.node_count;
    for (int k = 0; k < REGI_RESPONSE_MODES; k++) {
        regi_response_mode(r, k, r->weighted_modes + (size_t)k * n);
        regi_response_hold(r, r->weighted_modes + (size_t)k * n);
    }
    memcpy(r->drift, r->weighted_modes, REGI_RESPONSE_MODES * n * sizeof *r->drift);
    memcpy(r->recoil, r->residual, n * sizeof *r->recoil);
    regi_response_hold(r, r->recoil);
    regi_response_divide(r, r->drift, REGI_RESPONSE_MODES + 1);
    if (r->model->held)
        return 1;
    for (int k = 0; k < REGI_RESPONSE_MODES; k++)
        for (int l = 0; l < REGI_RESPONSE_MODES; l++) {
            double sum = 0;
            for (size_t i = 0; i < n; i++)
                sum += (double)sb_v3_dot(r->weighted_modes[(size_t)k * n + i], r->drift[(size_t)l * n + i]);
            r->drift_system[k * REGI_RESPONSE_MODES + l] = sum;
        }
    if (!regi_gauss_cholesky(0, r->drift_system, REGI_RESPONSE_MODES, REGI_RESPONSE_MODES))
        return 0;
    regi_response_stop_drift(r, r->recoil);
    return 1;
}

/* The factor of the body's shape. */
static sb_result regi_response_renew(regi_response *r, sb_error *error)
{
    /* what holds nothing-held organs acts on increments only, and balanced loads do not notice */
    sb_real hold = (sb_real)(r->model->held ? 1e-4 : 1e-2) * REGI_MODEL_YOUNG * r->model->size;
    if (r->direct == r->model->direct)
        r->model->direct_at_rest = 0;
    return sbi_body_factor(r->model->body, hold, r->residual, r->direct, error);
}

static sb_result regi_response_end_factor(regi_response *r, sb_error *error)
{
    if (regi_response_find_drift(r))
        return SB_OK;
    return sbi_fail(error, SB_ERROR_INDEFINITE, "the organ's stiffness is not positive");
}

REGI_API sb_result regi_response_factor(regi_response *r, sb_error *error)
{
    sb_result result = regi_response_renew(r, error);
    r->turned = 0;
    return result == SB_OK ? regi_response_end_factor(r, error) : result;
}

/* The factor of the model at rest, wherever its body is. The residual is scratch. */
static sb_result regi_response_renew_at_rest(regi_response *r, sb_error *error)
{
    size_t bytes = (size_t)r->model->mesh.node_count * sizeof(sb_vec3);
    sb_vec3 *kept = r->drift; /* found anew afterwards */
    sb_result result;
    memcpy(kept, sb_body_displacements(r->model->body), bytes);
    memset(r->residual, 0, bytes);
    result = sb_body_set_displacements(r->model->body, r->residual);
    if (result == SB_OK)
        result = regi_response_renew(r, error);
    r->model->direct_at_rest = result == SB_OK;
    return result == SB_OK ? sb_body_set_displacements(r->model->body, kept) : result;
}

REGI_API sb_result regi_response_factor_turned(regi_response *r, sb_mat3 rotation, sb_error *error)
{
    sb_result result = r->model->direct_at_rest ? SB_OK : regi_response_renew_at_rest(r, error);
    r->turned = 1;
    r->frame = rotation;
    memset(r->residual, 0, (size_t)r->model->mesh.node_count * sizeof *r->residual); /* nothing strains it */
    return result == SB_OK ? regi_response_end_factor(r, error) : result;
}
