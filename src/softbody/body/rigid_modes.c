/* rigid_modes: free rigid bodies in vectors of small motions: those of nodes that hang are 0, and behind the nodes two
 * vectors for each rigid body, the way of its centre (m) and its turn (rad). */
#include <math.h>
#include <string.h>

#include "body_private.h"
#include "rigid_private.h"
#include "step_private.h"

static int sbi_rigid_count(const sb_body *body) { return body->rigids ? body->rigids->count : 0; }

SBI_API sb_result sbi_rigids_begin_small(sb_body *body, const sb_matrix *matrix, sbi_rigids_small *small,
                                         sb_error *error)
{
    sb_result result = SB_OK;
    small->count = sbi_rigid_count(body);
    for (int k = 0; k < small->count && result == SB_OK; k++) {
        sbi_rigid *r = body->rigids->list[k];
        result = sbi_rigid_activate(body, r, error);
        memset(r->step.load, 0, sizeof r->step.load);
        memset(r->step.gravity, 0, sizeof r->step.gravity);
        small->list[k] = &r->guest;
    }
    small->guests.list = small->list;
    small->guests.count = small->count;
    if (small->count > 0 && result == SB_OK)
        result = sbi_pcg_reserve_guests(&body->pcg, matrix, &small->guests, error);
    return result;
}

SBI_API void sbi_rigids_turn_small(sb_body *body, int at_present, const sb_vec3 *left)
{
    for (int k = 0; k < sbi_rigid_count(body); k++) {
        sbi_rigid *r = body->rigids->list[k];
        sbi_rigid_set_small(r, at_present ? r->now.turn : r->home.turn, left);
    }
}

SBI_API sb_result sbi_rigids_factor_small(sb_body *body, const sb_matrix *matrix, double shift, sb_error *error)
{
    for (int k = 0; k < sbi_rigid_count(body); k++)
        if (!sbi_rigid_factor_small(body->rigids->list[k], matrix, shift))
            return sbi_fail(error, SB_ERROR_INDEFINITE, "the stiffness of rigid body %d is not positive definite",
                            body->rigids->list[k]->id);
    return SB_OK;
}

/* x of rigid body k of a vector that has them behind its nodes. */
static sb_vec3 *sbi_rigid_small(const sb_body *body, sb_vec3 *x, int k) { return x + body->domain.node_count + 2 * k; }

static sb_vec3 sbi_rigid_arm_of(const sbi_rigid *r, int i)
{
    return sb_v3((sb_real)r->y[i][0], (sb_real)r->y[i][1], (sb_real)r->y[i][2]);
}

SBI_API void sbi_rigids_spread(const sb_body *body, const sb_vec3 *x, sb_vec3 *nodes)
{
    for (int k = 0; k < sbi_rigid_count(body); k++) {
        const sbi_rigid *r = body->rigids->list[k];
        const sb_vec3 *own = x + body->domain.node_count + 2 * k;
        for (int i = 0; i < r->guest.node_count; i++)
            nodes[r->active[i]] = sb_v3_add(own[0], sb_v3_cross(own[1], sbi_rigid_arm_of(r, i)));
    }
}

SBI_API void sbi_rigids_gather(const sb_body *body, sb_vec3 *f)
{
    for (int k = 0; k < sbi_rigid_count(body); k++) {
        const sbi_rigid *r = body->rigids->list[k];
        sb_vec3 *own = sbi_rigid_small(body, f, k);
        own[0] = own[1] = sb_v3(0, 0, 0);
        for (int i = 0; i < r->guest.node_count; i++) {
            sb_vec3 *at = f + r->active[i];
            own[0] = sb_v3_add(own[0], *at);
            own[1] = sb_v3_add(own[1], sb_v3_cross(sbi_rigid_arm_of(r, i), *at));
            *at = sb_v3(0, 0, 0);
        }
    }
}

/* out += m v */
static void sbi_rigid_add_product(const double m[9], sb_vec3 v, sb_vec3 *out)
{
    double x[3], y[3];
    sbi_rigid_get(v, x);
    for (int i = 0; i < 3; i++)
        y[i] = m[3 * i] * x[0] + m[3 * i + 1] * x[1] + m[3 * i + 2] * x[2];
    *out = sb_v3_add(*out, sb_v3((sb_real)y[0], (sb_real)y[1], (sb_real)y[2]));
}

SBI_API void sbi_rigids_add_mass(const sb_body *body, const sb_vec3 *x, double share, double turning, sb_vec3 *out)
{
    for (int k = 0; k < sbi_rigid_count(body); k++) {
        const sbi_rigid *r = body->rigids->list[k];
        const sb_vec3 *own = x + body->domain.node_count + 2 * k;
        sb_vec3 *to = sbi_rigid_small(body, out, k);
        double m[9];
        to[0] = sb_v3_madd(to[0], (sb_real)(share * r->mass), own[0]);
        for (int c = 0; c < 9; c++)
            m[c] = share * r->step.inertia[c] + turning * r->step.turning[c];
        sbi_rigid_add_product(m, own[1], to + 1);
    }
}

SBI_API void sbi_rigids_weigh(const sb_body *body, sb_vec3 *weight)
{
    for (int k = 0; k < sbi_rigid_count(body); k++) {
        const sbi_rigid *r = body->rigids->list[k];
        const double *j = r->step.inertia;
        sb_vec3 *own = sbi_rigid_small(body, weight, k),
                whole = sb_v3((sb_real)r->mass, (sb_real)r->mass, (sb_real)r->mass);
        sb_vec3 turn = sb_v3((sb_real)j[0], (sb_real)j[4], (sb_real)j[8]);
        for (int i = 0; i < r->guest.node_count; i++) {
            sb_vec3 *at = weight + r->active[i], y = sbi_rigid_arm_of(r, i);
            whole = sb_v3_add(whole, *at);
            turn.x += at->y * y.z * y.z + at->z * y.y * y.y;
            turn.y += at->z * y.x * y.x + at->x * y.z * y.z;
            turn.z += at->x * y.y * y.y + at->y * y.x * y.x;
            *at = sb_v3(0, 0, 0);
        }
        own[0] = whole;
        own[1] = turn;
    }
}

SBI_API void sbi_rigids_take_load(const sb_body *body, const sb_vec3 *rhs)
{
    for (int k = 0; k < sbi_rigid_count(body); k++) {
        sbi_rigid *r = body->rigids->list[k];
        const sb_vec3 *own = rhs + body->domain.node_count + 2 * k;
        sbi_rigid_get(own[0], r->step.left);
        sbi_rigid_get(own[1], r->step.left + 3);
        memset(r->unknown, 0, sizeof r->unknown);
    }
}

SBI_API void sbi_rigids_give_way(const sb_body *body, sb_vec3 *x)
{
    for (int k = 0; k < sbi_rigid_count(body); k++) {
        const sbi_rigid *r = body->rigids->list[k];
        sb_vec3 *own = sbi_rigid_small(body, x, k);
        for (int i = 0; i < r->guest.node_count; i++)
            x[r->active[i]] = sb_v3(0, 0, 0);
        for (int c = 0; c < 2; c++)
            own[c] = sb_v3((sb_real)r->unknown[3 * c], (sb_real)r->unknown[3 * c + 1], (sb_real)r->unknown[3 * c + 2]);
    }
}

SBI_API void sbi_rigids_fill_motion(const sb_body *body, int at_present, sb_vec3 way, sb_vec3 turn, sb_vec3 about,
                                    sb_vec3 *x)
{
    for (int k = 0; k < sbi_rigid_count(body); k++) {
        const sbi_rigid *r = body->rigids->list[k];
        const double *c = at_present ? r->now.centre : r->home.centre;
        sb_vec3 *own = sbi_rigid_small(body, x, k), centre = sb_v3((sb_real)c[0], (sb_real)c[1], (sb_real)c[2]);
        own[0] = sb_v3_add(way, sb_v3_cross(turn, sb_v3_sub(centre, about)));
        own[1] = turn;
        for (int i = 0; i < r->guest.node_count; i++)
            x[r->active[i]] = sb_v3(0, 0, 0);
    }
}

SBI_API int sbi_rigids_count_freedom(const sb_body *body)
{
    int freedom = 0;
    for (int k = 0; k < sbi_rigid_count(body); k++) {
        const sbi_rigid *r = body->rigids->list[k];
        freedom += 6;
        for (int i = 0; i < r->count; i++)
            freedom -= body->node_component[r->hung[i]] >= 0 && !body->fixed[r->hung[i]] ? 3 : 0;
    }
    return freedom;
}
