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

REGI_API void regi_response_solve(regi_response *r, sb_vec3 *row, int count)
{
    for (int s = 0; s < count; s++)
        regi_response_hold(r, row + (size_t)s * (size_t)r->model->mesh.node_count);
    (void)sb_direct_solve(r->direct, &row[0].x, &row[0].x, count);
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
    (void)sb_direct_solve(r->direct, &r->drift[0].x, &r->drift[0].x, REGI_RESPONSE_MODES + 1);
    if (r->model->held)
        return 1;
    for (int k = 0; k < REGI_RESPONSE_MODES; k++)
        for (int l = 0; l < REGI_RESPONSE_MODES; l++) {
            double sum = 0;
            for (size_t i = 0; i < n; i++)
                sum += (double)sb_v3_dot(r->weighted_modes[(size_t)k * n + i], r->drift[(size_t)l * n + i]);
            r->drift_system[k * REGI_RESPONSE_MODES + l] = sum;
        }
    if (!regi_gauss_cholesky(r->drift_system, REGI_RESPONSE_MODES, REGI_RESPONSE_MODES))
        return 0;
    regi_response_stop_drift(r, r->recoil);
    return 1;
}

REGI_API sb_result regi_response_factor(regi_response *r, sb_error *error)
{
    /* what holds nothing-held organs acts on increments only, and balanced loads do not notice */
    sb_real hold = (sb_real)(r->model->held ? 1e-4 : 1e-2) * REGI_MODEL_YOUNG * r->model->size;
    sb_result result = sbi_body_factor(r->model->body, hold, r->residual, r->direct, error);
    if (result == SB_OK && !regi_response_find_drift(r))
        result = sbi_fail(error, SB_ERROR_INDEFINITE, "the organ's stiffness is not positive");
    return result;
}
