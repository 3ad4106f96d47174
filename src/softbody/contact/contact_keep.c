/* contact_keep: what steps change of contact, kept in a block and given back: tools, and what is remembered of samples.
 * A block has room for as much as there may ever be, so that its size changes with the tools only. */
#include <string.h>

#include "../body/live_mesh.h"
#include "contact_private.h"

/* What a block begins with. */
typedef struct sbi_contact_kept {
    sb_contact_info info;
    int mesh_version;
    int entry_count, waiting, pressure_count, pair_count, pairs_waiting, pair_pressure_count;
    sb_real strayed;
} sbi_contact_kept;

typedef struct sbi_contact_block {
    sbi_contact_kept *head;
    sbi_contact_tool *tools;         /* [max_tools] */
    sb_vec3 *chains;                 /* chain_reached of all tools, one after the other */
    sbi_contact_entry *entries;      /* [max_contacts] */
    sbi_contact_pressure *pressures; /* [corner_room max_contacts] */
    sbi_pair_entry *pairs;           /* likewise, where there are pairs */
    sbi_pair_pressure *pair_pressures;
    unsigned char *held; /* how the points of a skin are held */
} sbi_contact_block;

static size_t sbi_contact_chain_points(const sb_contact *contact)
{
    size_t count = 0;
    for (int t = 0; t < contact->max_tools; t++)
        count += contact->tools[t].shape ? (size_t)sbi_tool_point_count(contact->tools[t].shape) : 0;
    return count;
}

/* Where all is in a block; returns its bytes, or -1 where these are too many. */
static size_t sbi_contact_lay_out_block(const sb_contact *contact, void *memory, sbi_contact_block *block)
{
    sbi_arena arena = {NULL, 0, 0};
    size_t samples = (size_t)contact->max_contacts, corners = (size_t)contact->corner_room * samples;
    int pairs = contact->pairs.kinds != 0;
    arena.base = (unsigned char *)memory;
    block->head = (sbi_contact_kept *)sbi_arena_take(&arena, 1, sizeof *block->head);
    block->tools = (sbi_contact_tool *)sbi_arena_take(&arena, (size_t)contact->max_tools, sizeof *block->tools);
    block->chains = (sb_vec3 *)sbi_arena_take(&arena, sbi_contact_chain_points(contact), sizeof *block->chains);
    block->entries = (sbi_contact_entry *)sbi_arena_take(&arena, samples, sizeof *block->entries);
    block->pressures = (sbi_contact_pressure *)sbi_arena_take(&arena, corners, sizeof *block->pressures);
    block->pairs = (sbi_pair_entry *)sbi_arena_take(&arena, pairs ? samples : 0, sizeof *block->pairs);
    block->pair_pressures =
        (sbi_pair_pressure *)sbi_arena_take(&arena, pairs ? corners : 0, sizeof *block->pair_pressures);
    block->held = (unsigned char *)sbi_arena_take(
        &arena,
        contact->skin.source && contact->skin.source->keep ? contact->skin.source->kept_size(contact->skin.source) : 0,
        1);
    return arena.overflow ? (size_t)-1 : arena.used;
}

SBI_API size_t sbi_contact_kept_size(const void *user)
{
    sbi_contact_block block;
    return sbi_contact_lay_out_block((const sb_contact *)user, NULL, &block);
}

SBI_API int sbi_contact_reserve_kept(sb_contact *contact)
{
    size_t needed = sbi_contact_kept_size(contact);
    unsigned char *grown;
    if (needed <= contact->own_room)
        return 1;
    grown = (unsigned char *)sbi_alloc(&contact->allocator, needed, 1);
    if (!grown)
        return 0;
    sbi_free(&contact->allocator, contact->own_block);
    contact->own_block = grown;
    contact->own_room = needed;
    return 1;
}

/* Copies items to the block, or back from it. */
static void sbi_contact_copy(void *kept, void *own, int count, size_t size, int back)
{
    if (count > 0)
        memcpy(back ? own : kept, back ? kept : own, (size_t)count * size);
}

static void sbi_contact_copy_block(sb_contact *contact, const sbi_contact_block *block, int back)
{
    const sbi_contact_kept *head = block->head;
    sbi_pairs *pairs = &contact->pairs;
    sb_vec3 *chain = block->chains;
    sbi_contact_copy(block->tools, contact->tools, contact->max_tools, sizeof *contact->tools, back);
    for (int t = 0; t < contact->max_tools; t++) {
        int points = contact->tools[t].shape ? sbi_tool_point_count(contact->tools[t].shape) : 0;
        sbi_contact_copy(chain, contact->tools[t].chain_reached, points, sizeof *chain, back);
        chain += points;
    }
    sbi_contact_copy(block->entries, contact->entries, head->entry_count + head->waiting, sizeof *block->entries, back);
    sbi_contact_copy(block->pressures, contact->pressures, head->pressure_count, sizeof *block->pressures, back);
    sbi_contact_copy(block->pairs, pairs->entries, head->pair_count + head->pairs_waiting, sizeof *block->pairs, back);
    sbi_contact_copy(block->pair_pressures, pairs->pressures, head->pair_pressure_count, sizeof *block->pair_pressures,
                     back);
}

SBI_API int sbi_contact_keep(void *user, void *memory)
{
    sb_contact *contact = (sb_contact *)user;
    const sb_skin *source = contact->skin.source;
    sbi_contact_block block;
    if (sbi_contact_update_faces(contact, NULL) != SB_OK)
        return 0;
    (void)sbi_contact_lay_out_block(contact, memory ? memory : contact->own_block, &block);
    if (source && source->keep && !source->keep(source, block.held))
        return 0;
    block.head->info = contact->info;
    block.head->mesh_version = sb_body_mesh_version(contact->body);
    block.head->entry_count = contact->entry_count;
    block.head->waiting = contact->skin.waiting;
    block.head->pressure_count = contact->pressure_count;
    block.head->pair_count = contact->pairs.entry_count;
    block.head->pairs_waiting = contact->pairs.waiting;
    block.head->pair_pressure_count = contact->pairs.pressure_count;
    block.head->strayed = contact->pairs.strayed;
    sbi_contact_skin_name_entries(contact);
    sbi_contact_copy_block(contact, &block, 0);
    return 1;
}

/* Triangles of a skin may have other numbers in a mesh that has changed and changed back; those of the boundary have
 * the same. */
SBI_API int sbi_contact_rewind(void *user, const void *memory)
{
    sb_contact *contact = (sb_contact *)user;
    sbi_contact_block block;
    const sbi_contact_kept *head;
    int renamed;
    (void)sbi_contact_lay_out_block(contact, memory ? (void *)(size_t)memory : contact->own_block, &block);
    head = block.head;
    renamed = contact->skin.source && head->mesh_version != sb_body_mesh_version(contact->body);
    if (renamed && contact->skin.source->rewind) {
        contact->faces_old = 1;
        if (!contact->skin.source->rewind(contact->skin.source, block.held))
            return 0;
    }
    if (sbi_contact_update_faces(contact, NULL) != SB_OK)
        return 0;
    sbi_contact_copy_block(contact, &block, 1);
    contact->info = head->info;
    contact->entry_count = renamed ? 0 : head->entry_count;
    contact->skin.waiting = renamed ? head->entry_count + head->waiting : head->waiting;
    contact->pressure_count = head->pressure_count;
    contact->pairs.entry_count = renamed ? 0 : head->pair_count;
    contact->pairs.waiting = renamed ? head->pair_count + head->pairs_waiting : head->pairs_waiting;
    contact->pairs.pressure_count = head->pair_pressure_count;
    contact->pairs.strayed = head->strayed;
    contact->is_solved = contact->touch.links = 0; /* the body's system is of the step that is taken back */
    if (contact->skin.source)
        sbi_contact_skin_take_waiting(contact);
    return 1;
}
