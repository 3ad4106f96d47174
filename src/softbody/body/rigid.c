/* rigid: free rigid bodies are added, loaded, read and removed, and follow changes of the mesh. */
#include "rigid.h"

#include <limits.h>
#include <math.h>
#include <string.h>

#include "body_private.h"
#include "live_mesh.h"
#include "rigid_private.h"

/* ---- memory ---- */

static void sbi_rigid_layout(sbi_rigid *r, int capacity, sbi_arena *arena)
{
    size_t n = (size_t)capacity;
    r->hung = (int *)sbi_arena_take(arena, n, sizeof(int));
    r->active = (int *)sbi_arena_take(arena, n, sizeof(int));
    r->arm = (double(*)[3])sbi_arena_take(arena, n, sizeof *r->arm);
    r->lever = (double(*)[3])sbi_arena_take(arena, n, sizeof *r->lever);
    r->from = (double(*)[3])sbi_arena_take(arena, n, sizeof *r->from);
    r->y = (double(*)[3])sbi_arena_take(arena, n, sizeof *r->y);
}

/* Lists with room for so many nodes; 0: no memory. Those that there are stay. */
static int sbi_rigid_take_lists(const sb_allocator *allocator, sbi_rigid *r, int capacity)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_rigid old = *r;
    void *memory;
    sbi_rigid_layout(r, capacity, &arena);
    memory = arena.overflow ? NULL : sbi_alloc_zeroed(allocator, arena.used + 1, 1);
    if (!memory) {
        *r = old;
        return 0;
    }
    arena.base = (unsigned char *)memory;
    arena.used = 0;
    sbi_rigid_layout(r, capacity, &arena);
    r->memory = memory;
    r->capacity = capacity;
    if (old.count > 0) {
        memcpy(r->hung, old.hung, (size_t)old.count * sizeof *r->hung);
        memcpy(r->arm, old.arm, (size_t)old.count * sizeof *r->arm);
    }
    sbi_free(allocator, old.memory);
    return 1;
}

SBI_API sbi_rigid *sbi_rigid_make(const sb_allocator *allocator, int capacity)
{
    sbi_rigid *r = (sbi_rigid *)sbi_alloc_zeroed(allocator, 1, sizeof *r);
    if (r && !sbi_rigid_take_lists(allocator, r, capacity)) {
        sbi_free(allocator, r);
        r = NULL;
    }
    return r;
}

SBI_API void sbi_rigid_free(const sb_allocator *allocator, sbi_rigid *rigid)
{
    if (rigid)
        sbi_free(allocator, rigid->memory);
    sbi_free(allocator, rigid);
}

SBI_API void sbi_rigids_free(const sb_allocator *allocator, sbi_rigids *rigids)
{
    for (int k = 0; rigids && k < rigids->count; k++)
        sbi_rigid_free(allocator, rigids->list[k]);
    if (rigids)
        sbi_free(allocator, rigids->made_on);
    sbi_free(allocator, rigids);
}

/* ---- who hangs on what ---- */

/* Place of a node in the ascending list, or where it would stand. */
static int sbi_rigid_place_of(const sbi_rigid *r, int node)
{
    int low = 0, high = r->count;
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (r->hung[middle] < node)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

SBI_API const sbi_rigid *sbi_body_hung_on(const sb_body *body, int node)
{
    for (int k = 0; body->rigids && k < body->rigids->count; k++) {
        const sbi_rigid *r = body->rigids->list[k];
        int at = sbi_rigid_place_of(r, node);
        if (at < r->count && r->hung[at] == node)
            return r;
    }
    return NULL;
}

SBI_API int sbi_body_held_axes(const sb_body *body, int node)
{
    return body->rigids && sbi_body_hung_on(body, node) ? (int)SB_XYZ : body->fixed[node];
}

SBI_API sb_result sbi_body_check_not_hung(const sb_body *body, const int *nodes, int count, const char *what,
                                          sb_error *error)
{
    for (int i = 0; body->rigids && i < count; i++) {
        const sbi_rigid *r = sbi_body_hung_on(body, nodes[i]);
        if (r)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, nodes[i], "node %d hangs on rigid body %d: it cannot be %s",
                                 nodes[i], r->id, what);
    }
    return SB_OK;
}

SBI_API sb_result sbi_body_refuse_rigids(const sb_body *body, const char *what, sb_error *error)
{
    if (!body || !body->rigids || body->rigids->count == 0)
        return SB_OK;
    return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                    "%s know no free rigid bodies (number %d is one): take long implicit steps, or remove it", what,
                    body->rigids->list[0]->id);
}

SBI_API void sbi_rigids_count(const sb_body *body, int *unknowns, int *nodes)
{
    const int each = 32; /* nodes whose room has that of a guest's lists */
    for (int k = 0; body->rigids && k < body->rigids->count; k++) {
        *unknowns += SBI_RIGID_UNKNOWNS;
        *nodes += body->rigids->list[k]->count + each;
    }
}

SBI_API sb_result sbi_body_reserve_rigids(sb_body *body, sbi_rigids *rigids, const sb_matrix *matrix, sb_error *error)
{
    const sbi_guest *list[SB_MAX_RIGID];
    sbi_guests guests;
    sb_result result;
    guests.count = rigids ? rigids->count : 0;
    guests.list = list;
    for (int k = 0; k < guests.count; k++) {
        sbi_rigid *r = rigids->list[k];
        sbi_rigid_make_guest(r, r->hung, r->count);
        list[k] = &r->guest;
    }
    if (guests.count == 0)
        return SB_OK;
    result = sbi_pcg_reserve_guests(&body->pcg, matrix, &guests, error);
    if (result == SB_OK && body->live) /* whose mesh may grow */
        result = sbi_body_reserve_guest(body, 0, 0, error);
    if (result == SB_OK && body->touch)
        result = sbi_body_reserve_coupling(body, body->touch->coupling.node_count, error);
    return result;
}

/* ---- adding ---- */

SB_API sb_rigid_def sb_default_rigid_def(void)
{
    sb_rigid_def def;
    memset(&def, 0, sizeof def);
    def.turn = sb_quat_identity();
    return def;
}

SBI_API int sbi_rigid_has_inertia(double mass, const double inertia[9])
{
    const double close = 16 * (double)SB_EPSILON;
    double l[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    if (!(mass > 0))
        return 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j <= i; j++) {
            double sum = inertia[3 * i + j], other = inertia[3 * j + i];
            if (!(fabs(sum - other) <= close * (fabs(inertia[4 * i]) + fabs(inertia[4 * j]))))
                return 0;
            for (int k = 0; k < j; k++)
                sum -= l[3 * i + k] * l[3 * j + k];
            if (i == j && !(sum > close * inertia[4 * i]))
                return 0;
            l[3 * i + j] = i == j ? sqrt(sum) : sum / l[4 * j];
        }
    return 1;
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

static void sbi_rigid_get(sb_vec3 v, double out[3])
{
    out[0] = (double)v.x;
    out[1] = (double)v.y;
    out[2] = (double)v.z;
}

/* out = R^T v */
static void sbi_rigid_into_frame(const double turn[4], const double v[3], double out[3])
{
    double r[9];
    sbi_rigid_matrix(turn, r);
    for (int i = 0; i < 3; i++)
        out[i] = r[i] * v[0] + r[3 + i] * v[1] + r[6 + i] * v[2];
}

/* Arm of a node as it is now. */
static void sbi_rigid_make_arm(const sb_body *body, const sbi_rigid *r, int node, double arm[3])
{
    double x[3], u[3];
    sbi_rigid_get(body->reference[node], x);
    sbi_rigid_get(body->displacement[node], u);
    for (int i = 0; i < 3; i++)
        x[i] += u[i] - r->now.centre[i];
    sbi_rigid_into_frame(r->now.turn, x, arm);
}

/* A node comes to those that hang. 0: it does already, or there is no room. */
static int sbi_rigid_hang(const sb_body *body, sbi_rigid *r, int node)
{
    int at = sbi_rigid_place_of(r, node);
    if (r->count == r->capacity || (at < r->count && r->hung[at] == node))
        return 0;
    memmove(r->hung + at + 1, r->hung + at, (size_t)(r->count - at) * sizeof *r->hung);
    memmove(r->arm + at + 1, r->arm + at, (size_t)(r->count - at) * sizeof *r->arm);
    r->hung[at] = node;
    sbi_rigid_make_arm(body, r, node, r->arm[at]);
    r->count++;
    return 1;
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

static sb_result sbi_rigid_no_memory(sb_error *error, int nodes)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a rigid body with %d nodes", nodes);
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

SBI_API void sbi_body_reset_rigids(sb_body *body)
{
    for (int k = 0; body->rigids && k < body->rigids->count; k++)
        body->rigids->list[k]->now = body->rigids->list[k]->home;
}

/* ---- changes of the mesh ---- */

/* Index of the rigid body that all sources of a node made hang on, where it is to hang too; or -1. */
static int sbi_rigid_of_made(const sb_body *body, const sb_mesh_change *change, int index)
{
    const int keeps = SB_NODE_KEEP_X | SB_NODE_KEEP_Y | SB_NODE_KEEP_Z;
    int flags = change->made_copies ? change->made_copies[index] : 0, at = 0;
    const sbi_rigid *on = NULL;
    if ((flags & SB_NODE_COPY) && (flags & keeps) != keeps)
        return -1;
    for (int k = change->source_start[index]; k < change->source_start[index + 1]; k++) {
        const sbi_rigid *r = sbi_body_hung_on(body, change->sources[k]);
        if (!r || (on && r != on))
            return -1;
        on = r;
    }
    while (at < body->rigids->count && body->rigids->list[at] != on)
        at++;
    return on ? at : -1;
}

static sb_result sbi_rigids_check_removed(const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    for (int i = 0; i < change->removed_node_count; i++) {
        const sbi_rigid *r = sbi_body_hung_on(body, change->removed_nodes[i]);
        if (r && change->heir_start[i] == change->heir_start[i + 1])
            return sbi_fail_node(
                error, SB_ERROR_ARGUMENT, change->removed_nodes[i],
                "node %d hangs on rigid body %d and has no heir: take the rigid body away before it is "
                "removed",
                change->removed_nodes[i], r->id);
    }
    return SB_OK;
}

SBI_API sb_result sbi_rigids_reserve(const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    sbi_rigids *rigids = body->rigids;
    sb_result result;
    if (!rigids || rigids->count == 0)
        return SB_OK;
    result = sbi_rigids_check_removed(body, change, error);
    if (result == SB_OK && change->made_node_count > rigids->made_capacity) {
        int *made_on = (int *)sbi_alloc(&body->allocator, (size_t)change->made_node_count, sizeof(int));
        if (!made_on)
            return sbi_rigid_no_memory(error, change->made_node_count);
        sbi_free(&body->allocator, rigids->made_on);
        rigids->made_on = made_on;
        rigids->made_capacity = change->made_node_count;
    }
    for (int k = 0; k < rigids->count && result == SB_OK; k++) {
        sbi_rigid *r = rigids->list[k];
        int count = r->count;
        for (int i = 0; i < change->made_node_count; i++)
            count += sbi_rigid_of_made(body, change, i) == k;
        if (count > r->capacity && !sbi_rigid_take_lists(&body->allocator, r, count + count / 2))
            result = sbi_rigid_no_memory(error, count);
    }
    return result;
}

/* A node hangs no longer. */
static void sbi_rigid_let_go(sbi_rigid *r, int node)
{
    int at = sbi_rigid_place_of(r, node);
    if (at == r->count || r->hung[at] != node)
        return;
    r->count--;
    memmove(r->hung + at, r->hung + at + 1, (size_t)(r->count - at) * sizeof *r->hung);
    memmove(r->arm + at, r->arm + at + 1, (size_t)(r->count - at) * sizeof *r->arm);
}

SBI_API void sbi_rigids_follow(sb_body *body, const sb_mesh_change *change)
{
    sbi_rigids *rigids = body->rigids;
    if (!rigids || rigids->count == 0)
        return;
    for (int i = 0; i < change->made_node_count; i++) /* sources are those of before */
        rigids->made_on[i] = sbi_rigid_of_made(body, change, i);
    for (int k = 0; k < rigids->count; k++) {
        sbi_rigid *r = rigids->list[k];
        for (int i = 0; i < change->removed_node_count; i++)
            sbi_rigid_let_go(r, change->removed_nodes[i]);
        for (int i = 0; i < change->moved_node_count; i++) {
            int at = sbi_rigid_place_of(r, change->moved_nodes[i]);
            if (at < r->count && r->hung[at] == change->moved_nodes[i])
                sbi_rigid_make_arm(body, r, r->hung[at], r->arm[at]);
        }
        for (int i = 0; i < change->made_node_count; i++)
            if (rigids->made_on[i] == k)
                (void)sbi_rigid_hang(body, r, change->made_nodes[i]);
    }
}
