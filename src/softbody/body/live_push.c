/* live_push: forces on nodes in the next time step alone: what a blade does to the tissue that it cuts. Static solves
 * know nothing of them. They stay with their nodes whatever becomes of the mesh, and go with those that go. */
#include "live_private.h"

#include <string.h>

SBI_API int sbi_live_reserve_pushes(sb_body *body, int more)
{
    sbi_live *live = body->live;
    int64_t needed = (int64_t)live->push_count + more, roomy = needed + needed / 2 + 16;
    sbi_push *pushes;
    if (needed <= live->push_capacity)
        return 1;
    pushes = roomy < INT32_MAX ? (sbi_push *)sbi_alloc(&body->allocator, (size_t)roomy, sizeof *pushes) : NULL;
    if (!pushes)
        return 0;
    if (live->push_count)
        memcpy(pushes, live->pushes, (size_t)live->push_count * sizeof *pushes);
    sbi_free(&body->allocator, live->pushes);
    live->pushes = pushes;
    live->push_capacity = (int)roomy;
    return 1;
}

SBI_API void sbi_live_push(sb_body *body, int node, sb_vec3 force)
{
    sbi_push *push = body->live->pushes + body->live->push_count++;
    SB_ASSERT(body->live->push_count <= body->live->push_capacity);
    push->node = node;
    push->force = force;
    body->acceleration_known = 0; /* forces jump */
}

SBI_API void sbi_live_add_pushes(const sb_body *body, sb_vec3 *forces)
{
    const sbi_live *live = body->live;
    for (int i = 0; live && i < live->push_count; i++) {
        int node = live->pushes[i].node;
        if (node < live->nodes.end && live->nodes.used[node])
            forces[node] = sb_v3_add(forces[node], live->pushes[i].force);
    }
}

SBI_API void sbi_live_forget_pushes(sb_body *body)
{
    if (!body->live || !body->live->push_count)
        return;
    body->live->push_count = 0;
    body->acceleration_known = 0;
}
