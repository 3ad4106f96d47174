/* contact: making a contact, its tools. */
#include "contact.h"

#include <string.h>

#include "../body/body_private.h"
#include "../geometry/surface.h"
#include "contact_private.h"

#define SBI_CONTACT_COOKIE 0xc0117ac7u
enum { SBI_CONTACT_LEAST_SAMPLES = 3 };                             /* of any face */
enum { SBI_CONTACT_SKIN_POINTS = 3, SBI_CONTACT_SKIN_BLOCKS = 64 }; /* of a face; most of a face on the average */
/* Squares of the highest frequency of a mesh over those of its nodes held alone, tr K_aa / 3 m_a: some 2 to 4. */
#define SBI_CONTACT_SHARE ((sb_real)3)

SB_API sb_contact_def sb_default_contact_def(void)
{
    sb_contact_def def;
    memset(&def, 0, sizeof def);
    def.stiffness = 10;
    def.max_iterations = 4;
    def.max_contacts = 8192;
    def.max_tools = 8;
    def.pairs = 0;
    def.pair_friction = def.pair_distance = 0;
    def.cookie = SBI_CONTACT_COOKIE;
    return def;
}

/* ---- creation ---- */

static sb_result sbi_contact_check_def(const sb_contact_def *def, sb_error *error)
{
    if (!def || def->cookie != SBI_CONTACT_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_contact_def");
    if (!def->body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.body is NULL: a contact needs a body");
    if (!(def->stiffness >= 3) || !sb_is_finite(def->stiffness))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.stiffness is %g, it must be at least 3", (double)def->stiffness);
    if (def->max_iterations < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_iterations is %d, it must be at least 1",
                        def->max_iterations);
    if (def->max_contacts < 64 || def->max_contacts > 1 << 20)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_contacts is %d, it must be in [64, 2^20]",
                        def->max_contacts);
    if (def->max_tools < 1 || def->max_tools > 64)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_tools is %d, it must be in [1, 64]", def->max_tools);
    if (def->pairs & ~(SB_CONTACT_SELF | SB_CONTACT_ORGANS))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.pairs is %d, it must be of SB_CONTACT_SELF | SB_CONTACT_ORGANS",
                        def->pairs);
    if (!(def->pair_friction >= 0) || !sb_is_finite(def->pair_friction))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.pair_friction is %g, it must be at least 0",
                        (double)def->pair_friction);
    if (!(def->pair_distance >= 0) || !sb_is_finite(def->pair_distance))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.pair_distance is %g m, it must be at least 0",
                        (double)def->pair_distance);
    if (def->skin && def->body->domain.element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "bodies of custom elements have no skins (def.skin)");
    if (sbi_body_get_touch(def->body))
        return sbi_fail(error, SB_ERROR_STATE, "the body has a contact already: one serves all its tools");
    if (!sbi_body_is_implicit(def->body) && def->pairs)
        return sbi_fail(
            error, SB_ERROR_UNSUPPORTED,
            "the body's steps are explicit (SB_CENTRAL_DIFFERENCE): tools touch it, but not its organs each "
            "other (def.pairs)");
    return SB_OK;
}

/* Arrays of pairs that do not depend on the mesh. */
static void sbi_contact_lay_out_lists(sb_contact *c, sbi_arena *arena)
{
    size_t samples = (size_t)c->max_contacts, regions = (size_t)c->region_room, corners;
    size_t width = (size_t)c->faces->width, blocks = (size_t)c->pairs.slot_room * width * width;
    sbi_pairs *p = &c->pairs;
    corners = (size_t)c->corner_room * samples;
    p->patches = (sbi_pair_patch *)sbi_arena_take(arena, (size_t)p->patch_room, sizeof *p->patches);
    p->samples = (sbi_pair_sample *)sbi_arena_take(arena, samples, sizeof *p->samples);
    p->links = (sbi_pair_link *)sbi_arena_take(arena, samples, sizeof *p->links);
    p->active = (int *)sbi_arena_take(arena, samples, sizeof(int));
    p->slots = (int *)sbi_arena_take(arena, (size_t)p->slot_room, sizeof(int));
    p->slot_used = (unsigned char *)sbi_arena_take(arena, (size_t)p->slot_room, 1);
    p->blocks = (sb_real(*)[9])sbi_arena_take(arena, blocks, sizeof *p->blocks);
    p->saved = (sbi_contact_saved *)sbi_arena_take(arena, blocks, sizeof *p->saved);
    p->region_sum = (sb_real *)sbi_arena_take(arena, regions, sizeof(sb_real));
    p->region_count = (int *)sbi_arena_take(arena, regions, sizeof(int));
    p->entries = (sbi_pair_entry *)sbi_arena_take(arena, samples, sizeof *p->entries);
    p->spare = (sbi_pair_entry *)sbi_arena_take(arena, samples, sizeof *p->spare);
    p->pressures = (sbi_pair_pressure *)sbi_arena_take(arena, corners, sizeof *p->pressures);
    p->spare_pressures = (sbi_pair_pressure *)sbi_arena_take(arena, corners, sizeof *p->spare_pressures);
}

/* Arrays that do not depend on the mesh. */
static void sbi_contact_lay_out(sb_contact *c, sbi_arena *arena)
{
    size_t tools = (size_t)c->max_tools, samples = (size_t)c->max_contacts, patches = (size_t)c->patch_room;
    sbi_contact_skin *skin = &c->skin;
    size_t corners = (size_t)c->corner_room * samples;
    size_t pairs = patches * (size_t)c->faces->width * (size_t)c->faces->width, regions = (size_t)c->region_room;
    size_t refs = c->pairs.kinds ? 3 * samples : samples;
    c->tools = (sbi_contact_tool *)sbi_arena_take(arena, tools, sizeof *c->tools);
    c->patches = (sbi_contact_patch *)sbi_arena_take(arena, patches, sizeof *c->patches);
    c->samples = (sbi_contact_sample *)sbi_arena_take(arena, samples, sizeof *c->samples);
    c->region_sum = (sb_real *)sbi_arena_take(arena, tools * regions, sizeof(sb_real));
    c->region_count = (int *)sbi_arena_take(arena, tools * regions, sizeof(int));
    c->blocks = (sb_real(*)[9])sbi_arena_take(arena, pairs, sizeof *c->blocks);
    c->saved =
        (sbi_contact_saved *)sbi_arena_take(arena, skin->source ? (size_t)skin->most_saved : pairs, sizeof *c->saved);
    c->entries = (sbi_contact_entry *)sbi_arena_take(arena, samples, sizeof *c->entries);
    c->spare = (sbi_contact_entry *)sbi_arena_take(arena, samples, sizeof *c->spare);
    c->pressures = (sbi_contact_pressure *)sbi_arena_take(arena, corners, sizeof *c->pressures);
    c->spare_pressures = (sbi_contact_pressure *)sbi_arena_take(arena, corners, sizeof *c->spare_pressures);
    if (c->pairs.kinds)
        sbi_contact_lay_out_lists(c, arena);
    if (!skin->source)
        return;
    skin->found = (int *)sbi_arena_take(arena, refs, sizeof(int));
    skin->next = (int *)sbi_arena_take(arena, refs, sizeof(int));
    skin->cross = (sbi_contact_cross *)sbi_arena_take(arena, patches + (size_t)c->pairs.slot_room, sizeof *skin->cross);
}

static int sbi_contact_take_memory(sb_contact *c)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_contact_lay_out(c, &arena);
    if (arena.overflow)
        return 0;
    c->memory = sbi_alloc_zeroed(&c->allocator, arena.used, 1);
    if (!c->memory)
        return 0;
    arena.base = (unsigned char *)c->memory;
    arena.used = 0;
    sbi_contact_lay_out(c, &arena);
    return 1;
}

/* Blocks of a face in one cell, or of its three points, for each patch; of large elements for some of them: what there
 * is no room for is multiplied beside the matrix. */
static int sbi_contact_most_saved(const sb_contact *c)
{
    int64_t each = sbi_min_int(SBI_CONTACT_SKIN_POINTS * c->skin.width * c->skin.width, SBI_CONTACT_SKIN_BLOCKS);
    return (int)((int64_t)c->patch_room * each * (c->pairs.kinds ? 2 : 1)); /* below 2^19 times 2^7 */
}

/* Faces of a skin. */
static sb_result sbi_contact_skin_create(sb_contact *c, const sb_contact_def *def, sb_error *error)
{
    c->skin.source = def->skin;
    c->skin.width = c->body->domain.nodes_per_cell;
    c->skin.corners = sb_element_corner_count(c->body->domain.element_type);
    c->skin.node_room = c->body->node_capacity;
    return sbi_contact_skin_update(c, error);
}

/* Inside and outside of organs tell whether they touch: a skin of the user's own has both. (Those of cuts have by how
 * they are made, and change.) */
static sb_result sbi_contact_require_closed(const sb_contact *c, sb_error *error)
{
    const sb_skin *skin = c->skin.source;
    sb_mesh surface;
    if (!skin || skin->is_late)
        return SB_OK;
    memset(&surface, 0, sizeof surface);
    surface.element_type = SB_TRI3;
    surface.node_count = skin->point_count;
    surface.nodes = c->skin.rest;
    surface.element_count = skin->face_count;
    surface.elements = c->faces->nodes; /* three each */
    return sb_surface_require(&surface, SB_SURFACE_OPEN_EDGES | SB_SURFACE_FLIPPED | SB_SURFACE_INSIDE_OUT,
                              &c->allocator, NULL, error);
}

static sb_result sbi_contact_fill_in(sb_contact *c, const sb_contact_def *def, sb_error *error)
{
    sb_result result = def->skin ? sbi_contact_skin_create(c, def, error)
                                 : sbi_contact_faces_create(c->body, &c->allocator, &c->faces, error);
    if (result != SB_OK)
        return result;
    if (def->pairs) {
        result = sbi_contact_require_closed(c, error);
        if (result != SB_OK)
            return result;
    }
    c->patch_room = c->max_contacts / SBI_CONTACT_LEAST_SAMPLES;
    c->corner_room = c->skin.source ? SBI_CONTACT_SKIN_POINTS * c->skin.corners : SBI_CONTACT_MOST_CORNERS;
    c->region_room = c->faces->region_count;
    c->touch.max_iterations = def->max_iterations;
    c->touch.stiffening = def->stiffness / SBI_CONTACT_SHARE;
    c->pairs.kinds = def->pairs;
    c->pairs.friction = def->pair_friction;
    c->pairs.distance = def->pair_distance;
    c->pairs.patch_room = def->skin ? c->max_contacts : c->patch_room; /* a skin's faces may have one sample each */
    if (def->pairs)                                                    /* and may be more later */
        c->pairs.slot_room = def->skin ? c->max_contacts : sbi_min_int(c->patch_room, c->faces->face_room);
    c->skin.most_saved = sbi_contact_most_saved(c);
    if (!sbi_contact_take_memory(c) || !sbi_contact_take_room(c) || !sbi_contact_reserve_kept(c))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a contact of %d samples", c->max_contacts);
    if (c->skin.source)
        sbi_contact_faces_refit(c->faces, sbi_contact_points_now(c), NULL, 0);
    sbi_pairs_measure(c);
    return SB_OK;
}

static void sbi_contact_release(sb_contact *contact)
{
    sb_allocator allocator = contact->allocator;
    for (int t = 0; contact->tools && t < contact->max_tools; t++)
        sbi_contact_free_tool(contact, t);
    sbi_contact_faces_destroy(contact->faces);
    sbi_contact_skin_free(contact);
    sbi_free(&allocator, contact->room_memory);
    sbi_free(&allocator, contact->own_block);
    sbi_free(&allocator, contact->memory);
    sbi_free(&allocator, contact);
}

SB_API sb_result sb_contact_create(const sb_contact_def *def, sb_contact **contact, sb_error *error)
{
    sb_contact *made;
    sb_result result = sbi_contact_check_def(def, error);
    if (result == SB_OK && !contact)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "there is no place for the contact");
    if (result != SB_OK)
        return result;
    made = (sb_contact *)sbi_alloc_zeroed(def->allocator ? def->allocator : sbi_body_allocator(def->body), 1,
                                          sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a contact");
    made->allocator = def->allocator ? *def->allocator : *sbi_body_allocator(def->body);
    made->body = def->body;
    made->listener = -1;
    made->stiffness = def->stiffness;
    made->max_tools = def->max_tools;
    made->max_contacts = def->max_contacts;
    result = sbi_contact_fill_in(made, def, error);
    if (result != SB_OK) {
        sbi_contact_release(made);
        return result;
    }
    result = sbi_contact_join_state(made, error);
    if (result == SB_OK)
        result = sbi_pairs_join_state(made, error);
    if (result == SB_OK)
        result = sbi_contact_listen(made, error);
    if (result == SB_OK)
        result = sbi_body_reserve_substeps(made->body, error);
    if (result != SB_OK) {
        sbi_contact_leave_state(made);
        sbi_contact_unlisten(made);
        sbi_contact_release(made);
        return result;
    }
    sbi_contact_join(made);
    if (!sbi_body_reserve_touch_kept(made->body)) {
        sb_contact_destroy(made);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for needles to keep a contact of %d samples",
                        def->max_contacts);
    }
    *contact = made;
    return SB_OK;
}

SB_API void sb_contact_destroy(sb_contact *contact)
{
    if (!contact)
        return;
    if (contact->body) { /* NULL: it went first */
        sbi_body_set_touch(contact->body, NULL);
        sbi_contact_leave_state(contact);
    }
    sbi_contact_unlisten(contact);
    sbi_contact_release(contact);
}
