/* contact_live: contact on a body whose mesh changes: arrays by face and node, and what is remembered of faces. */
#include <string.h>

#include "../body/body_private.h"
#include "contact_private.h"

/* The same of pairs: what is known of faces at rest is made anew when they change. */
static void sbi_contact_lay_out_pairs(sb_contact *c, sbi_arena *arena)
{
    size_t faces = (size_t)c->faces->face_room, nodes = (size_t)c->faces->node_room;
    size_t any = (size_t)sbi_contact_any_room(c), sides = (size_t)sbi_pairs_sides(c->faces->face_room);
    sbi_pairs *p = &c->pairs;
    p->cones = (sbi_pair_cone *)sbi_arena_take(arena, faces + SBI_FACE_TREE_LEVELS, sizeof *p->cones);
    p->first_organ = (int *)sbi_arena_take(arena, faces + SBI_FACE_TREE_LEVELS, sizeof(int));
    p->last_organ = (int *)sbi_arena_take(arena, faces + SBI_FACE_TREE_LEVELS, sizeof(int));
    p->box_low = (sb_vec3 *)sbi_arena_take(arena, faces, sizeof(sb_vec3));
    p->box_high = (sb_vec3 *)sbi_arena_take(arena, faces, sizeof(sb_vec3));
    p->near = (uint64_t *)sbi_arena_take(arena, (size_t)sbi_face_tree_words(c->faces->face_room), sizeof(uint64_t));
    p->still.near =
        (uint64_t *)sbi_arena_take(arena, (size_t)sbi_face_tree_words(c->faces->face_room), sizeof(uint64_t));
    p->still.boxed =
        (uint64_t *)sbi_arena_take(arena, (size_t)sbi_face_tree_words(c->faces->face_room), sizeof(uint64_t));
    p->still.boxes = (sbi_pair_box *)sbi_arena_take(arena, faces, sizeof(sbi_pair_box));
    p->still.until = (sb_real *)sbi_arena_take(arena, faces, sizeof(sb_real));
    p->still.tired = (signed char *)sbi_arena_take(arena, faces, 1);
    p->still.listed = (int *)sbi_arena_take(arena, faces, sizeof(int));
    p->still.listed_count = (int *)sbi_arena_take(arena, faces, sizeof(int));
    p->still.list = (int *)sbi_arena_take(arena, faces, SBI_STILL_LISTED * sizeof(int));
    p->still.seen = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    p->still.closed = (sb_real *)sbi_arena_take(arena, any, sizeof(sb_real));
    p->still.closing = (sb_real *)sbi_arena_take(arena, any + 1, sizeof(sb_real));
    p->still.coasting = (sb_real *)sbi_arena_take(arena, any + 1, sizeof(sb_real));
    p->organs = (int *)sbi_arena_take(arena, faces, sizeof(int));
    p->found = (int *)sbi_arena_take(arena, faces, sizeof(int));
    p->related = (sbi_pair_related *)sbi_arena_take(arena, faces, sizeof *p->related);
    p->balls = (sbi_pair_balls *)sbi_arena_take(arena, sides, sizeof *p->balls);
    p->picks = (sbi_pair_picks *)sbi_arena_take(arena, sides, sizeof *p->picks);
    p->slot_of = (int *)sbi_arena_take(arena, faces, sizeof(int));
    p->around = (int *)sbi_arena_take(arena, faces, (size_t)c->faces->width * sizeof(int));
    p->first_face = (int *)sbi_arena_take(arena, nodes + 1, sizeof(int));
    p->organ_counts = (int *)sbi_arena_take(arena, any, sizeof(int));
    p->organ_lengths = (sb_real *)sbi_arena_take(arena, any, sizeof(sb_real));
    p->node_organs = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    p->thickness = (sb_real *)sbi_arena_take(arena, faces, sizeof(sb_real));
    p->centres = (sb_vec3 *)sbi_arena_take(arena, faces, sizeof(sb_vec3));
    p->rest_normals = (sb_vec3 *)sbi_arena_take(arena, faces, sizeof(sb_vec3));
    p->vectors = (sb_vec3 *)sbi_arena_take(arena, faces, sizeof(sb_vec3));
    p->zones = (int *)sbi_arena_take(arena, any, sizeof(int));
    p->zone_ways = (sb_vec3 *)sbi_arena_take(arena, any, sizeof(sb_vec3));
    p->zone_masses = (sb_vec3 *)sbi_arena_take(arena, any, sizeof(sb_vec3));
    p->zone_held = (sb_vec3 *)sbi_arena_take(arena, any, sizeof(sb_vec3));
    p->node_ways = (sb_vec3 *)sbi_arena_take(arena, any, sizeof(sb_vec3));
    p->link_nodes = (int *)sbi_arena_take(arena, any, sizeof(int));
    p->link_in = (sbi_pair_vector *)sbi_arena_take(arena, any, sizeof *p->link_in);
    p->link_out = (sbi_pair_vector *)sbi_arena_take(arena, any, sizeof *p->link_out);
    if (c->skin.source && (p->kinds & SB_CONTACT_SELF)) {
        p->lips.twins = (int *)sbi_arena_take(arena, faces, sizeof(int));
        p->lips.sheets = (int *)sbi_arena_take(arena, faces, sizeof(int));
        p->lips.cuts = (int *)sbi_arena_take(arena, faces, sizeof(int));
        p->lips.rims = (unsigned char *)sbi_arena_take(arena, faces, 1);
        p->lips.ends = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    }
    p->plates = (sbi_pair_plate *)sbi_arena_take(arena, faces, sizeof *p->plates);
    p->corner_normals = (sb_vec3 *)sbi_arena_take(arena, faces, SBI_PAIR_CORNERS * sizeof(sb_vec3));
    p->corners_known = (unsigned char *)sbi_arena_take(arena, faces, 1);
    p->ways = (sb_vec3 *)sbi_arena_take(arena, faces, sizeof(sb_vec3));
    p->spreads = (sb_real *)sbi_arena_take(arena, faces, sizeof(sb_real));
}

/* Arrays by face and by node: all hold what a step needs only while it lasts. */
static void sbi_contact_lay_out_room(sb_contact *c, sbi_arena *arena)
{
    size_t faces = (size_t)c->faces->face_room, nodes = (size_t)c->faces->node_room, tools = (size_t)c->max_tools;
    size_t body = (size_t)sbi_contact_body_room(c), most = nodes > body ? nodes : body;
    sb_vec3 **vectors[] = {&c->touch.force, &c->touch.du,   &c->touch.linear, &c->touch.left,
                           &c->touch.way,   &c->touch.kept, &c->positions,    &c->places,
                           &c->moved,       &c->hung_in,    &c->hung_out};
    c->near = (int *)sbi_arena_take(arena, tools * faces, sizeof(int));
    c->scratch = (int *)sbi_arena_take(arena, faces, sizeof(int));
    c->node_place = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    c->nodes = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    c->sums = (sbi_contact_sum *)sbi_arena_take(arena, body, sizeof *c->sums);
    c->stiffness_by_node = (sb_real *)sbi_arena_take(arena, nodes, sizeof(sb_real));
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++)
        *vectors[i] = (sb_vec3 *)sbi_arena_take(arena, most, sizeof(sb_vec3));
    if (c->pairs.kinds)
        sbi_contact_lay_out_pairs(c, arena);
    if (c->pairs.kinds || c->skin.source) { /* what there may be links of */
        c->touch.whole = (sb_vec3 *)sbi_arena_take(arena, body, sizeof(sb_vec3));
        c->touch.product = (sb_vec3 *)sbi_arena_take(arena, body, sizeof(sb_vec3));
    }
    if (!c->skin.source)
        return;
    c->skin.node_areas = (sb_real *)sbi_arena_take(arena, body, sizeof(sb_real));
    c->skin.loads = (sb_real *)sbi_arena_take(arena, body, sizeof(sb_real));
    c->skin.place = (int *)sbi_arena_take(arena, body, sizeof(int));
    c->skin.list = (int *)sbi_arena_take(arena, body, sizeof(int));
}

static size_t sbi_contact_room_bytes(sb_contact *contact)
{
    sb_contact measured = *contact;
    sbi_arena arena = {NULL, 0, 0};
    sbi_contact_lay_out_room(&measured, &arena);
    return arena.overflow ? (size_t)-1 : arena.used;
}

/* Hands the arrays out of memory of that size. */
static void sbi_contact_set_room(sb_contact *contact, void *memory)
{
    sbi_arena arena = {NULL, 0, 0};
    arena.base = (unsigned char *)memory;
    contact->room_memory = memory;
    sbi_contact_lay_out_room(contact, &arena);
    for (int i = 0; i < contact->faces->node_room; i++)
        contact->node_place[i] = -1;
    for (int t = 0; t < contact->max_tools; t++)
        contact->tools[t].face_count = 0;
    for (int f = 0; contact->pairs.kinds && f < contact->faces->face_room; f++)
        contact->pairs.slot_of[f] = -1;
    for (int i = 0; contact->skin.source && i < contact->skin.node_room; i++)
        contact->skin.place[i] = -1;
    if (contact->skin.source)
        sbi_contact_skin_measure(contact);
    contact->room_faces = contact->faces->face_room;
    contact->room_body = sbi_contact_body_room(contact);
    contact->room_nodes = contact->faces->node_room;
}

SBI_API int sbi_contact_take_room(sb_contact *contact)
{
    size_t bytes = sbi_contact_room_bytes(contact);
    void *memory = bytes == (size_t)-1 ? NULL : sbi_alloc_zeroed(&contact->allocator, bytes, 1);
    if (!memory)
        return 0;
    sbi_free(&contact->allocator, contact->room_memory);
    sbi_contact_set_room(contact, memory);
    return 1;
}

/* ---- changes of the mesh ---- */

/* Arrays are as large as the faces, which keep what room they were given for a change that was refused. */
static int sbi_contact_has_room(const sb_contact *contact)
{
    return contact->faces->face_room == contact->room_faces && contact->faces->node_room == contact->room_nodes &&
           sbi_contact_body_room(contact) == contact->room_body;
}

/* The arrays that were made for a change take the place of those there were, if there are any. */
static void sbi_contact_take_next_room(sb_contact *contact)
{
    if (!contact->next_room)
        return;
    sbi_free(&contact->allocator, contact->room_memory);
    sbi_contact_set_room(contact, contact->next_room);
    contact->next_room = NULL;
}

static void sbi_contact_give_up(void *user) { sbi_contact_take_next_room((sb_contact *)user); }

static sb_result sbi_contact_reserve(void *user, const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    sb_contact *contact = (sb_contact *)user;
    sb_result result = SB_OK;
    size_t bytes;
    if (contact->skin.source) /* it has had its turn, or will have one */
        contact->skin.node_room = sbi_max_int(contact->skin.node_room, change->node_end);
    else
        result = sbi_contact_faces_reserve(contact->faces, body, change, error);
    if (result != SB_OK)
        return result;
    if (sbi_contact_has_room(contact))
        return SB_OK;
    bytes = sbi_contact_room_bytes(contact);
    contact->next_room = bytes == (size_t)-1 ? NULL : sbi_alloc_zeroed(&contact->allocator, bytes, 1);
    if (!contact->next_room)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for contact on %d faces", contact->faces->face_room);
    return SB_OK;
}

/* Corners remember as long as a face with an entry has them. */
static void sbi_contact_drop_pressures(sb_contact *contact)
{
    const int *place = contact->skin.source ? contact->skin.place : contact->node_place;
    int count = 0;
    for (int set = 1; set >= 0; set--) {
        for (int e = 0; e < contact->entry_count; e++)
            sbi_contact_mark_corners(contact, contact->entries[e].face, set ? 0 : -1);
        for (int i = 0; set && i < contact->pressure_count; i++)
            if (place[contact->pressures[i].node] >= 0)
                contact->pressures[count++] = contact->pressures[i];
    }
    contact->pressure_count = count;
}

SBI_API sb_result sbi_contact_update_faces(sb_contact *contact, sb_error *error)
{
    int changed = 0, count = 0;
    sb_result result = SB_OK;
    if (!contact->faces_old && sbi_contact_has_room(contact))
        return SB_OK;
    if (contact->faces_old && contact->skin.source) {
        contact->skin.node_room = sbi_max_int(contact->skin.node_room, contact->body->node_capacity);
        result = sbi_contact_skin_update(contact, error);
        changed = 1;
    } else if (contact->faces_old) {
        result = sbi_contact_faces_update(contact->faces, contact->body, &changed, error);
    }
    if (result == SB_OK && !sbi_contact_has_room(contact) && !sbi_contact_take_room(contact))
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for contact on %d faces", contact->faces->face_room);
    if (result != SB_OK)
        return result;
    contact->faces_old = 0;
    if (contact->skin.source)
        sbi_contact_skin_measure(contact);
    for (int e = 0; changed && !contact->skin.source && e < contact->entry_count; e++) {
        sbi_contact_entry entry = contact->entries[e];
        entry.face = contact->faces->live.moved[entry.face];
        if (entry.face >= 0)
            contact->entries[count++] = entry;
    }
    for (int t = 0; changed && t < contact->max_tools; t++)
        contact->tools[t].nearest.known = 0;
    if (changed && !contact->skin.source)
        contact->entry_count = count;
    if (changed) {
        sbi_contact_drop_pressures(contact);
        sbi_pairs_follow_faces(contact);
    }
    return SB_OK;
}

static void sbi_contact_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    sb_contact *contact = (sb_contact *)user;
    sbi_contact_take_next_room(contact);
    contact->is_solved = 0; /* its system is of the mesh before */
    if (!contact->skin.source)
        sbi_contact_faces_follow(contact->faces, body, change);
    contact->faces_old = 1;
    if (!sbi_contact_skin_is_late(contact, change == NULL))
        (void)sbi_contact_update_faces(contact, NULL);    /* where it fails the next step says so */
    (void)sbi_body_reserve_substeps(contact->body, NULL); /* or a step that divides itself tries again */
}

/* The body goes first: contact must not be asked about it any more. */
static void sbi_contact_end(void *user) { ((sb_contact *)user)->body = NULL; }

SBI_API sb_result sbi_contact_listen(sb_contact *contact, sb_error *error)
{
    sb_body_listener listener;
    contact->listener = -1;
    if (sbi_body_node_slots(contact->body).room == 0) /* its mesh stays as it is */
        return SB_OK;
    memset(&listener, 0, sizeof listener);
    listener.user = contact;
    listener.reserve = sbi_contact_reserve;
    listener.follow = sbi_contact_follow;
    listener.give_up = sbi_contact_give_up;
    listener.end = sbi_contact_end;
    return sb_body_listen(contact->body, &listener, &contact->listener, error);
}

SBI_API void sbi_contact_unlisten(sb_contact *contact)
{
    if (contact->body && contact->listener >= 0)
        (void)sb_body_unlisten(contact->body, contact->listener);
    sbi_contact_give_up(contact);
}
