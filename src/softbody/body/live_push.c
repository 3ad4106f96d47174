/* live_push: forces on nodes in the next time step alone: what a blade does to the tissue that it cuts. Static solves
 * know nothing of them. They stay with their nodes whatever becomes of the mesh, and go with those that go.
 *
 * A force F that a way d of the blade past the tissue gives is F (d - w) / |d| where the tissue goes w farther in the
 * step than it would at the speed it has: nothing where it keeps up with the blade. So an implicit step has
 *
 *     f = F - k (u - start - dt v),   k = max(0, |F| / |d| - m / dt^2)
 *
 * at each node of mass m, summed over its forces: heavy tissue, which does not get far in a step, feels F, and light
 * tissue in a long step goes with the blade in place of ahead of it. What the step dissipates by it, f (d - w), is not
 * negative. An explicit step of dt, whatever its substeps, has f = F / (1 + k dt^2 / m), what that comes to where
 * nothing else acts: light tissue gets as fast as the blade, and no faster. */
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

SBI_API void sbi_live_push(sb_body *body, int node, sb_vec3 force, sb_real stiffness)
{
    sbi_push *push = body->live->pushes + body->live->push_count++;
    SB_ASSERT(body->live->push_count <= body->live->push_capacity);
    push->node = node;
    push->force = force;
    push->stiffness = stiffness;
    push->held = 0;
    body->acceleration_known = 0; /* forces jump */
}

/* 1 when a push has its node still. */
static int sbi_live_push_acts(const sbi_live *live, const sbi_push *push)
{
    return push->node < live->nodes.end && live->nodes.used[push->node];
}

SBI_API void sbi_live_add_pushes(const sb_body *body, sb_vec3 *forces)
{
    const sbi_live *live = body->live;
    for (int i = 0; live && i < live->push_count; i++) {
        const sbi_push *push = live->pushes + i;
        if (sbi_live_push_acts(live, push))
            forces[push->node] = sb_v3_add(forces[push->node], push->force);
    }
}

/* work[n].x = sum of the stiffness (N/m) at each node that is pushed. */
static void sbi_live_sum_pushes(sb_body *body)
{
    const sbi_live *live = body->live;
    for (int i = 0; i < live->push_count; i++)
        body->work[live->pushes[i].node] = sb_v3(0, 0, 0);
    for (int i = 0; i < live->push_count; i++)
        body->work[live->pushes[i].node].x += live->pushes[i].stiffness;
}

SBI_API void sbi_live_add_light_pushes(sb_body *body, sb_real dt, sb_vec3 *forces)
{
    const sbi_live *live = body->live;
    if (!live || !live->push_count)
        return;
    sbi_live_sum_pushes(body);
    for (int i = 0; i < live->push_count; i++) {
        const sbi_push *push = live->pushes + i;
        sb_real all = body->work[push->node].x * dt * dt, mass = body->lumped_mass[push->node];
        if (sbi_live_push_acts(live, push))
            forces[push->node] = sb_v3_madd(forces[push->node], all > mass ? mass / all : 1, push->force);
    }
}

SBI_API int sbi_live_hold_pushes(sb_body *body, sb_real dt)
{
    sbi_live *live = body->live;
    int held = 0;
    if (!live || !live->push_count)
        return 0;
    sbi_live_sum_pushes(body);
    for (int i = 0; i < live->push_count; i++) {
        sbi_push *push = live->pushes + i;
        sb_real all = body->work[push->node].x, excess = all - body->lumped_mass[push->node] / (dt * dt);
        push->held = excess > 0 ? push->stiffness * (excess / all) : 0;
        held |= push->held > 0;
    }
    return held;
}

SBI_API void sbi_live_add_push_product(const sb_body *body, sb_real factor, const sb_vec3 *vectors, sb_vec3 *forces)
{
    const sbi_live *live = body->live;
    for (int i = 0; i < live->push_count; i++) {
        const sbi_push *push = live->pushes + i;
        int n = push->node;
        if (sbi_live_push_acts(live, push))
            forces[n] = sb_v3_madd(forces[n], factor * push->held, vectors[n]);
    }
}

SBI_API void sbi_live_add_push_stiffness(sb_body *body, sb_real factor)
{
    const sbi_live *live = body->live;
    for (int i = 0; i < live->push_count; i++) {
        const sbi_push *push = live->pushes + i;
        if (!sbi_live_push_acts(live, push))
            continue;
        for (int c = 0; c < 9; c += 4)
            body->matrix.blocks[body->matrix.diagonal[push->node]][c] += factor * push->held;
    }
}

SBI_API void sbi_live_forget_pushes(sb_body *body)
{
    if (!body->live || !body->live->push_count)
        return;
    body->live->push_count = 0;
    body->acceleration_known = 0;
}
