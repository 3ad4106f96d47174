/* rigid_reserve: what steps with free rigid bodies need is there before them. */
#include "live_private.h"
#include "rigid_private.h"
#include "step_touch.h"

/* For a mesh as large as there is room for. */
static sb_result sbi_rigids_reserve_room(sb_body *body, sb_error *error)
{
    int unknowns = 0, nodes = 0;
    sbi_rigids_count(body, &unknowns, &nodes);
    return sbi_pcg_reserve_guest_room(&body->pcg, &body->matrix, body->live->nodes.capacity, unknowns, nodes, error);
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
        result = sbi_rigids_reserve_room(body, error);
    if (result == SB_OK && body->touch)
        result = sbi_body_reserve_coupling(body, body->touch->coupling.node_count, error);
    return result;
}
