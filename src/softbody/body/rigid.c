/* rigid: free rigid bodies are added, loaded, read and removed. */
#include "rigid.h"

#include <limits.h>
#include <math.h>
#include <string.h>

#include "body_private.h"
#include "live_mesh.h"
#include "rigid_private.h"

/* ---- adding ---- */

SB_API sb_rigid_def sb_default_rigid_def(void)
{
    sb_rigid_def def;
    memset(&def, 0, sizeof def);
    def.turn = sb_quat_identity();
    return def;
}

static sb_result sbi_rigid_check_nodes(const sb_body *body, const sb_rigid_def *def, sb_error *error)
{
    sb_result result = sbi_body_check_nodes(body, def->nodes, def->node_count, error);
    if (result == SB_OK)
        result = sbi_body_check_not_hung(body, def->nodes, def->node_count, "on another one", error);
    for (int i = 0; i < def->node_count && result == SB_OK; i++) {
        int node = def->nodes[i];
        if (body->fixed[node])
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, node, "node %d is %s: it cannot hang on a rigid body", node,
                                 body->node_component[node] < 0 ? "in no element" : "supported");
        if (body->elimination && body->elimination->slave[node])
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, node,
                                 "node %d follows others by a constraint: it cannot hang on a rigid body", node);
    }
    return result;
}

/* The numbers of a def as recordings have them. */
enum { SBI_RIGID_REALS = 23 };

static void sbi_rigid_pack(const sb_rigid_def *def, sb_real reals[SBI_RIGID_REALS])
{
    const sb_real turn[4] = {def->turn.w, def->turn.x, def->turn.y, def->turn.z};
    reals[0] = def->mass;
    memcpy(reals + 1, def->inertia.m, 9 * sizeof(sb_real));
    memcpy(reals + 10, &def->centre.x, 3 * sizeof(sb_real));
    memcpy(reals + 13, turn, sizeof turn);
    memcpy(reals + 17, &def->velocity.x, 3 * sizeof(sb_real));
    memcpy(reals + 20, &def->spin.x, 3 * sizeof(sb_real));
}

static sb_result sbi_rigid_check_def(const sb_body *body, const sb_rigid_def *def, sb_error *error)
{
    sb_real reals[SBI_RIGID_REALS];
    double inertia[9];
    sb_real square;
    if (!body || !def)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_add_rigid needs a body and a def");
    sbi_rigid_pack(def, reals);
    for (int k = 0; k < SBI_RIGID_REALS; k++)
        if (!sb_is_finite(reals[k]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "a number of a rigid body is not finite");
    for (int k = 0; k < 9; k++)
        inertia[k] = (double)reals[1 + k];
    if (!sbi_rigid_has_inertia((double)def->mass, inertia))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "the mass %g of a rigid body is not positive, or its inertia not symmetric and positive "
                        "definite",
                        (double)def->mass);
    square = sb_quat_dot(def->turn, def->turn);
    if (!(square > 0) || !sb_is_finite(square) || !sb_is_finite(1 / square))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the turn of a rigid body is a quaternion of length 0");
    if (body->integrator == SB_CENTRAL_DIFFERENCE)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "explicit steps know no free rigid bodies");
    if (body->rigids && (body->rigids->count == SB_MAX_RIGID || body->rigids->last_id == INT_MAX))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a body has at most %d free rigid bodies", SB_MAX_RIGID);
    return sbi_rigid_check_nodes(body, def, error);
}

static void sbi_rigid_fill(const sb_rigid_def *def, sbi_rigid *r)
{
    sb_quat q = sb_quat_normalise(def->turn);
    double spin[3], length;
    r->mass = (double)def->mass;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r->inertia[3 * i + j] = ((double)def->inertia.m[i][j] + (double)def->inertia.m[j][i]) / 2;
    r->now.turn[0] = (double)q.w;
    r->now.turn[1] = (double)q.x;
    r->now.turn[2] = (double)q.y;
    r->now.turn[3] = (double)q.z;
    length = sqrt(r->now.turn[0] * r->now.turn[0] + r->now.turn[1] * r->now.turn[1] + r->now.turn[2] * r->now.turn[2] +
                  r->now.turn[3] * r->now.turn[3]);
    for (int k = 0; k < 4; k++)
        r->now.turn[k] /= length;
    sbi_rigid_get(def->centre, r->now.centre);
    r->home = r->now;
    sbi_rigid_get(def->velocity, r->now.velocity);
    sbi_rigid_get(def->spin, spin);
    sbi_rigid_into_frame(r->now.turn, spin, r->now.spin);
    r->saved = r->now;
}

/* Nodes that hang get its velocity. */
static void sbi_rigid_push_nodes(sb_body *body, const sb_rigid_def *def)
{
    for (int i = 0; i < def->node_count; i++) {
        int node = def->nodes[i];
        sb_vec3 arm = sb_v3_sub(body->position[node], def->centre);
        body->velocity[node] = sb_v3_add(def->velocity, sb_v3_cross(def->spin, arm));
    }
}

/* The last of the list is new and filled; on failure it is gone. */
static sb_result sbi_rigid_install(sb_body *body, sbi_rigid *r, const sb_rigid_def *def, sb_error *error)
{
    const sb_matrix *matrix = body->elimination ? &body->elimination->matrix : &body->matrix;
    sb_result result = SB_OK;
    for (int i = 0; i < def->node_count && result == SB_OK; i++)
        if (!sbi_rigid_hang(body, r, def->nodes[i]))
            result = sbi_fail_node(error, SB_ERROR_ARGUMENT, def->nodes[i], "node %d hangs twice on a rigid body",
                                   def->nodes[i]);
    body->rigids->list[body->rigids->count++] = r;
    if (result == SB_OK)
        result = sbi_body_reserve_rigids(body, body->rigids, matrix, error);
    if (result == SB_OK && body->touch) /* whose steps may be divided */
        result = sbi_body_reserve_substeps(body, error);
    if (result != SB_OK) {
        body->rigids->count--;
        sbi_rigid_free(&body->allocator, r);
    }
    return result;
}

SB_API sb_result sb_body_add_rigid(sb_body *body, const sb_rigid_def *def, int *id, sb_error *error)
{
    sb_real reals[SBI_RIGID_REALS];
    sbi_rigid *r;
    sb_result result = sbi_rigid_check_def(body, def, error);
    if (result != SB_OK)
        return result;
    if (!body->rigids)
        body->rigids = (sbi_rigids *)sbi_alloc_zeroed(&body->allocator, 1, sizeof *body->rigids);
    r = body->rigids ? sbi_rigid_make(&body->allocator, def->node_count) : NULL;
    if (!r)
        return sbi_rigid_no_memory(error, def->node_count);
    sbi_rigid_fill(def, r);
    r->id = body->rigids->last_id + 1;
    result = sbi_rigid_install(body, r, def, error);
    if (result != SB_OK)
        return result;
    body->rigids->last_id = r->id;
    sbi_rigid_push_nodes(body, def);
    body->acceleration_known = 0;
    sbi_kept_forget(body);
    sbi_rigid_pack(def, reals);
    sbi_body_tell(body, SBI_COMMAND_ADD_RIGID, 0, 0, def->nodes, (size_t)def->node_count, reals, SBI_RIGID_REALS);
    if (id)
        *id = r->id;
    return SB_OK;
}

/* ---- loads, readings, removal ---- */

/* Index in the list, or -1. */
static int sbi_rigid_find(const sb_body *body, int id)
{
    for (int k = 0; body->rigids && k < body->rigids->count; k++)
        if (body->rigids->list[k]->id == id)
            return k;
    return -1;
}

SB_API sb_result sb_body_set_rigid_load(sb_body *body, int id, sb_vec3 force, sb_vec3 torque)
{
    const sb_real reals[6] = {force.x, force.y, force.z, torque.x, torque.y, torque.z};
    int at;
    if (!body)
        return SB_ERROR_ARGUMENT;
    at = sbi_rigid_find(body, id);
    if (at < 0)
        return SB_ERROR_INDEX;
    if (!sb_v3_is_finite(force) || !sb_v3_is_finite(torque))
        return SB_ERROR_NOT_FINITE;
    for (int k = 0; k < 6; k++)
        body->rigids->list[at]->load[k] = (double)reals[k];
    sbi_body_tell(body, SBI_COMMAND_RIGID_LOAD, id, 0, NULL, 0, reals, 6);
    return SB_OK;
}

static sb_vec3 sbi_rigid_vector(const double v[3]) { return sb_v3((sb_real)v[0], (sb_real)v[1], (sb_real)v[2]); }

SB_API sb_result sb_body_rigid_motion(const sb_body *body, int id, sb_rigid_motion *motion)
{
    const sbi_rigid_state *now;
    double r[9], spin[3];
    int at;
    if (!body || !motion)
        return SB_ERROR_ARGUMENT;
    at = sbi_rigid_find(body, id);
    if (at < 0)
        return SB_ERROR_INDEX;
    now = &body->rigids->list[at]->now;
    sbi_rigid_matrix(now->turn, r);
    for (int i = 0; i < 3; i++)
        spin[i] = r[3 * i] * now->spin[0] + r[3 * i + 1] * now->spin[1] + r[3 * i + 2] * now->spin[2];
    motion->centre = sbi_rigid_vector(now->centre);
    motion->turn =
        sb_quat_make((sb_real)now->turn[0], (sb_real)now->turn[1], (sb_real)now->turn[2], (sb_real)now->turn[3]);
    motion->velocity = sbi_rigid_vector(now->velocity);
    motion->spin = sbi_rigid_vector(spin);
    motion->force = sbi_rigid_vector(now->wrench);
    motion->torque = sbi_rigid_vector(now->wrench + 3);
    return SB_OK;
}

SB_API sb_result sb_body_remove_rigid(sb_body *body, int id)
{
    sbi_rigids *rigids;
    int at;
    if (!body)
        return SB_ERROR_ARGUMENT;
    at = sbi_rigid_find(body, id);
    if (at < 0)
        return SB_ERROR_INDEX;
    rigids = body->rigids;
    sbi_rigid_free(&body->allocator, rigids->list[at]);
    rigids->count--;
    memmove(rigids->list + at, rigids->list + at + 1, (size_t)(rigids->count - at) * sizeof *rigids->list);
    body->acceleration_known = 0;
    sbi_body_tell(body, SBI_COMMAND_REMOVE_RIGID, id, 0, NULL, 0, NULL, 0);
    return SB_OK;
}

SB_API int sb_body_rigid_count(const sb_body *body) { return body && body->rigids ? body->rigids->count : 0; }
