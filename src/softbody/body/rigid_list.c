/* rigid_list: free rigid bodies in memory, which nodes hang on them, and frames. */
#include <math.h>
#include <string.h>

#include "body_private.h"
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

SBI_API int sbi_rigid_take_lists(const sb_allocator *allocator, sbi_rigid *r, int capacity)
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

SBI_API sb_result sbi_rigid_no_memory(sb_error *error, int nodes)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a rigid body with %d nodes", nodes);
}

/* ---- who hangs on what ---- */

SBI_API int sbi_rigid_place_of(const sbi_rigid *r, int node)
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

SBI_API void sbi_body_reset_rigids(sb_body *body)
{
    for (int k = 0; body->rigids && k < body->rigids->count; k++) {
        sbi_rigid *r = body->rigids->list[k];
        r->now = r->home;
        memset(r->equilibrated, 0, sizeof r->equilibrated);
    }
}

/* ---- masses and frames ---- */

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

SBI_API void sbi_rigid_matrix(const double q[4], double r[9])
{
    double w = q[0], x = q[1], y = q[2], z = q[3];
    r[0] = 1 - 2 * (y * y + z * z), r[1] = 2 * (x * y - w * z), r[2] = 2 * (x * z + w * y);
    r[3] = 2 * (x * y + w * z), r[4] = 1 - 2 * (x * x + z * z), r[5] = 2 * (y * z - w * x);
    r[6] = 2 * (x * z - w * y), r[7] = 2 * (y * z + w * x), r[8] = 1 - 2 * (x * x + y * y);
}

SBI_API void sbi_rigid_get(sb_vec3 v, double out[3])
{
    out[0] = (double)v.x;
    out[1] = (double)v.y;
    out[2] = (double)v.z;
}

SBI_API void sbi_rigid_into_frame(const double turn[4], const double v[3], double out[3])
{
    double r[9];
    sbi_rigid_matrix(turn, r);
    for (int i = 0; i < 3; i++)
        out[i] = r[i] * v[0] + r[3 + i] * v[1] + r[6 + i] * v[2];
}

SBI_API void sbi_rigid_make_arm(const sb_body *body, const sbi_rigid *r, int node, double arm[3])
{
    double x[3], u[3];
    sbi_rigid_get(body->reference[node], x);
    sbi_rigid_get(body->displacement[node], u);
    for (int i = 0; i < 3; i++)
        x[i] += u[i] - r->now.centre[i];
    sbi_rigid_into_frame(r->now.turn, x, arm);
}

SBI_API int sbi_rigid_hang(const sb_body *body, sbi_rigid *r, int node)
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

SBI_API void sbi_rigid_let_go(sbi_rigid *r, int node)
{
    int at = sbi_rigid_place_of(r, node);
    if (at == r->count || r->hung[at] != node)
        return;
    r->count--;
    memmove(r->hung + at, r->hung + at + 1, (size_t)(r->count - at) * sizeof *r->hung);
    memmove(r->arm + at, r->arm + at + 1, (size_t)(r->count - at) * sizeof *r->arm);
}
