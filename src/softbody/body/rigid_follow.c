/* rigid_follow: free rigid bodies of a body whose mesh changes. */
#include "body_private.h"
#include "live_mesh.h"
#include "rigid_private.h"

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
