/* contact_skin: rows of a skin's points, places and motions of these, and how they follow the body's mesh. */
#include <string.h>

#include "../base/bytes.h"
#include "../body/body_private.h"
#include "../body/live_private.h"
#include "contact_private.h"

enum { SBI_CONTACT_POINT_CHUNK = 512 }; /* points that one thread takes at a time */

/* ---- fields ---- */

typedef struct sbi_skin_field {
    const sbi_contact_skin *skin;
    const sb_vec3 *field;
    sb_vec3 *out;
} sbi_skin_field;

static void sbi_skin_map_chunk(void *user, int chunk)
{
    const sbi_skin_field *map = (const sbi_skin_field *)user;
    int last = sbi_min_int((chunk + 1) * SBI_CONTACT_POINT_CHUNK, map->skin->point_count);
    for (int p = chunk * SBI_CONTACT_POINT_CHUNK; p < last; p++) {
        const sbi_contact_row row = sbi_contact_skin_row(map->skin, p);
        map->out[p] = sbi_contact_mean(row.weights, row.nodes, row.count, map->field);
    }
}

SBI_API const sb_vec3 *sbi_contact_at_points(const sb_contact *contact, const sb_vec3 *field, sb_vec3 *room)
{
    int count = sbi_contact_point_count(contact);
    sbi_skin_field map;
    if (!contact->skin.source)
        return field;
    map.skin = &contact->skin;
    map.field = field;
    map.out = room;
    sbi_run(sbi_body_jobs(contact->body), sbi_skin_map_chunk, &map,
            count / SBI_CONTACT_POINT_CHUNK + (count % SBI_CONTACT_POINT_CHUNK != 0));
    return room;
}

SBI_API const sb_vec3 *sbi_contact_points_now(const sb_contact *contact)
{
    return sbi_contact_at_points(contact, sb_body_positions(contact->body), contact->skin.at);
}

SBI_API const sb_vec3 *sbi_contact_points_at_rest(const sb_contact *contact)
{
    return contact->skin.source ? contact->skin.rest : sb_body_rest_positions(contact->body);
}

SBI_API int sbi_contact_point_count(const sb_contact *contact)
{
    return contact->skin.source ? contact->skin.point_count : sb_body_node_count(contact->body);
}

/* ---- nodes in touch ---- */

static void sbi_skin_list_node(sbi_contact_skin *skin, int node)
{
    if (skin->place[node] >= 0)
        return;
    skin->place[node] = skin->list_count;
    skin->list[skin->list_count++] = node;
}

SBI_API void sbi_contact_skin_place(sb_contact *contact, int point)
{
    sbi_contact_skin *skin = &contact->skin;
    const sbi_contact_row row = sbi_contact_skin_row(skin, point);
    for (int i = 0; i < row.count; i++)
        sbi_skin_list_node(skin, row.nodes[i]);
    for (int c = point * skin->corners; c < (point + 1) * skin->corners; c++)
        if (skin->shares[c] > 0)
            sbi_skin_list_node(skin, skin->corner_nodes[c]);
}

SBI_API void sbi_contact_skin_forget(sb_contact *contact)
{
    sbi_contact_skin *skin = &contact->skin;
    for (int k = 0; k < skin->list_count; k++)
        skin->place[skin->list[k]] = -1;
    skin->list_count = 0;
}

SBI_API void sbi_contact_skin_take(const sb_contact *contact, const unsigned char *masked, const sb_vec3 *of_nodes,
                                   sb_vec3 *of_points)
{
    const sbi_contact_skin *skin = &contact->skin;
    for (int k = 0; k < contact->node_count; k++) {
        const sbi_contact_row row = sbi_contact_skin_row(skin, contact->nodes[k]);
        sb_vec3 sum = {0, 0, 0};
        for (int i = 0; i < row.count; i++)
            sum = sb_v3_madd(
                sum, row.weights[i],
                sbi_contact_unmasked(masked ? masked[row.nodes[i]] : 0u, of_nodes[skin->place[row.nodes[i]]]));
        of_points[k] = sum;
    }
}

SBI_API void sbi_contact_skin_give(const sb_contact *contact, const unsigned char *masked, const sb_vec3 *of_points,
                                   sb_vec3 *of_nodes)
{
    const sbi_contact_skin *skin = &contact->skin;
    memset(of_nodes, 0, (size_t)skin->list_count * sizeof *of_nodes);
    for (int k = 0; k < contact->node_count; k++) {
        const sbi_contact_row row = sbi_contact_skin_row(skin, contact->nodes[k]);
        for (int i = 0; i < row.count; i++) {
            sb_vec3 *sum = of_nodes + skin->place[row.nodes[i]];
            *sum = sb_v3_madd(*sum, row.weights[i], of_points[k]);
        }
    }
    for (int k = 0; masked && k < skin->list_count; k++)
        of_nodes[k] = sbi_contact_unmasked(masked[skin->list[k]], of_nodes[k]);
}

/* ---- rows ---- */

/* Nodes and weights of a point. A weight that is rounding is none: a point on a face of the mesh has that face's nodes
 * only, whose pairs lie in both of its cells. */
static void sbi_skin_fill_row(sbi_contact_skin *skin, const sb_body *body, int point, const sbi_skin_point *at)
{
    const int *nodes = sbi_contact_cell_nodes(body, at->cell);
    size_t first = (size_t)point * (size_t)skin->width;
    sb_element_type type = body->domain.element_type;
    sb_real shape[SB_MAX_ELEMENT_NODES], slope[SB_MAX_ELEMENT_NODES][3], kept = 0, all = 0;
    int count = 0;
    sb_element_shape(type, at->xi, shape, slope);
    for (int a = 0; a < skin->width; a++) {
        shape[a] += slope[a][0] * at->step[0] + slope[a][1] * at->step[1] + slope[a][2] * at->step[2];
        all += shape[a];
    }
    for (int a = 0; a < skin->width; a++) {
        if (sb_abs(shape[a]) <= 64 * SB_EPSILON)
            continue;
        skin->nodes[first + (size_t)count] = nodes[a];
        skin->weights[first + (size_t)count++] = shape[a];
        kept += shape[a];
    }
    for (int i = 0; i < count; i++)
        skin->weights[first + (size_t)i] *= all / kept;
    skin->counts[point] = (unsigned char)count;
}

/* Linear weights of the corners of the cell, of its place in it: what lies outside has those of its foot. */
static void sbi_skin_fill_shares(sbi_contact_skin *skin, const sb_body *body, int point, const sbi_skin_point *at)
{
    static const sb_element_type linear[2] = {SB_TET4, SB_HEX8};
    const int *nodes = sbi_contact_cell_nodes(body, at->cell);
    sb_real shape[SB_MAX_ELEMENT_NODES], slope[SB_MAX_ELEMENT_NODES][3], sum = 0;
    sb_element_shape(linear[skin->corners == 8], at->xi, shape, slope);
    for (int c = 0; c < skin->corners; c++) {
        shape[c] = shape[c] > 64 * SB_EPSILON ? shape[c] : 0;
        sum += shape[c];
    }
    for (int c = 0; c < skin->corners; c++) {
        size_t place = (size_t)point * (size_t)skin->corners + (size_t)c;
        skin->corner_nodes[place] = nodes[c];
        skin->shares[place] = shape[c] / sum;
    }
}

static void sbi_skin_fill_points(sb_contact *contact)
{
    sbi_contact_skin *skin = &contact->skin;
    const sb_body *body = contact->body;
    const sb_vec3 none = {0, 0, 0};
    for (int p = 0; p < skin->point_count; p++) {
        sbi_skin_point at;
        sbi_contact_row row;
        skin->source->get_point(skin->source, p, &at);
        skin->cells[p] = at.cell;
        skin->rest[p] = none;
        skin->counts[p] = 0;
        if (at.cell < 0)
            continue;
        sbi_skin_fill_row(skin, body, p, &at);
        sbi_skin_fill_shares(skin, body, p, &at);
        row = sbi_contact_skin_row(skin, p);
        skin->rest[p] = sbi_contact_mean(row.weights, row.nodes, row.count, sb_body_rest_positions(body));
    }
}

SBI_API void sbi_contact_skin_measure(sb_contact *contact)
{
    sbi_contact_skin *skin = &contact->skin;
    memset(skin->node_areas, 0, (size_t)skin->node_room * sizeof *skin->node_areas);
    for (int k = 0; k < 3 * contact->faces->face_end; k++) { /* by faces: points may have other numbers after a load */
        const sbi_contact_row row = sbi_contact_skin_row(skin, sbi_contact_face_nodes(contact->faces, k / 3)[k % 3]);
        for (int i = 0; i < row.count; i++)
            skin->node_areas[row.nodes[i]] += sb_abs(row.weights[i]) * contact->faces->areas[k / 3] / 3;
    }
}

/* ---- memory ---- */

static void sbi_skin_layout(sbi_contact_skin *skin, sbi_arena *arena)
{
    size_t points = (size_t)skin->point_room, width = (size_t)skin->width, corners = (size_t)skin->corners;
    sb_vec3 **vectors[] = {&skin->rest, &skin->at, &skin->velocity, &skin->moved, &skin->du, &skin->force};
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++)
        *vectors[i] = (sb_vec3 *)sbi_arena_take(arena, points, sizeof(sb_vec3));
    skin->weights = (sb_real *)sbi_arena_take(arena, points, width * sizeof(sb_real));
    skin->shares = (sb_real *)sbi_arena_take(arena, points, corners * sizeof(sb_real));
    skin->nodes = (int *)sbi_arena_take(arena, points, width * sizeof(int));
    skin->corner_nodes = (int *)sbi_arena_take(arena, points, corners * sizeof(int));
    skin->cells = (int *)sbi_arena_take(arena, points, sizeof(int));
    skin->counts = (unsigned char *)sbi_arena_take(arena, points, 1);
}

/* 0: no memory. */
static int sbi_skin_take_arrays(const sb_contact *contact, sbi_contact_skin *skin)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_skin_layout(skin, &arena);
    skin->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&contact->allocator, arena.used, 1);
    if (!skin->memory)
        return 0;
    arena.base = (unsigned char *)skin->memory;
    arena.used = 0;
    sbi_skin_layout(skin, &arena);
    return 1;
}

SBI_API void sbi_contact_skin_free(sb_contact *contact)
{
    sbi_free(&contact->allocator, contact->skin.memory);
    contact->skin.memory = NULL;
}

/* So many, and half of it in reserve where they grow. */
static int sbi_skin_room(int room, int needed, int grows)
{
    if (needed <= room)
        return room;
    return grows && needed < INT32_MAX / 2 ? needed + needed / 2 : needed;
}

/* Larger arrays and faces; what was in the faces stays, and points are to be filled. */
static sb_result sbi_skin_grow(sb_contact *contact, sbi_contact_faces **old, sb_error *error)
{
    sbi_contact_skin *skin = &contact->skin, next = *skin;
    const sb_skin *source = skin->source;
    int faces = contact->faces ? contact->faces->face_room : 0;
    sb_result result;
    next.point_room = sbi_skin_room(skin->point_room, source->point_count, source->is_late);
    faces = sbi_skin_room(faces, source->face_count, source->is_late);
    *old = NULL;
    if (contact->faces && next.point_room == skin->point_room && faces == contact->faces->face_room)
        return SB_OK;
    if (!sbi_skin_take_arrays(contact, &next))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for contact on a skin of %d points", source->point_count);
    *old = contact->faces;
    result = sbi_contact_faces_create_skin(contact->body, &contact->allocator, faces, next.point_room, &contact->faces,
                                           error);
    if (result != SB_OK) {
        sbi_free(&contact->allocator, next.memory);
        *old = NULL;
        return result;
    }
    sbi_contact_skin_free(contact);
    *skin = next;
    return SB_OK;
}

/* ---- following the mesh ---- */

static int sbi_skin_has_corners(const int *one, const int *two)
{
    return one[0] == two[0] && one[1] == two[1] && one[2] == two[2];
}

/* Faces that entries have, of tools and then of pairs, which have two each: how many, and a face of them. */
static int sbi_skin_ref_count(const sb_contact *contact)
{
    return contact->entry_count + 2 * contact->pairs.entry_count;
}

static int sbi_skin_ref(const sb_contact *contact, int ref)
{
    const int pair = ref - contact->entry_count;
    if (pair < 0)
        return contact->entries[ref].face;
    return pair % 2 ? contact->pairs.entries[pair / 2].other : contact->pairs.entries[pair / 2].face;
}

/* found: for each of these the triangle that there is now, one between the same points, or none. first
 * [contact->room_nodes] is -1, and is so again: fewer than points where there was no memory for more, but then no entry
 * has one beyond. */
static void sbi_skin_match_entries(sb_contact *contact, const sbi_contact_faces *old, int *first)
{
    const sb_skin *source = contact->skin.source;
    int *next = contact->skin.next, room = sbi_min_int(old->node_room, contact->room_nodes);
    int count = sbi_skin_ref_count(contact);
    for (int r = 0; r < count; r++) {
        int corner = sbi_contact_face_nodes(old, sbi_skin_ref(contact, r))[0];
        next[r] = first[corner];
        first[corner] = r;
        contact->skin.found[r] = -1;
    }
    for (int f = 0; f < source->face_count; f++) {
        const int *corners = source->triangles[f];
        for (int r = corners[0] < room ? first[corners[0]] : -1; r >= 0; r = next[r])
            if (sbi_skin_has_corners(corners, sbi_contact_face_nodes(old, sbi_skin_ref(contact, r))))
                contact->skin.found[r] = f;
    }
    for (int r = 0; r < count; r++)
        first[sbi_contact_face_nodes(old, sbi_skin_ref(contact, r))[0]] = -1;
}

SBI_API uint64_t sbi_contact_skin_name(const sb_contact *contact, int face, const int *corners)
{
    const sb_skin *source = contact->skin.source;
    uint64_t name = 0;
    if (!source->get_name)
        return (uint64_t)face;
    for (int k = 0; k < 3; k++)
        name = sbi_hash_word(name, source->get_name(source, corners[k]));
    return name;
}

static uint64_t sbi_skin_name_face(const sb_contact *contact, int face)
{
    return sbi_contact_skin_name(contact, face, sbi_contact_face_nodes(contact->faces, face));
}

SBI_API void sbi_contact_skin_name_entries(sb_contact *contact)
{
    if (!contact->skin.source)
        return;
    for (int e = 0; e < contact->entry_count; e++)
        contact->entries[e].name = sbi_skin_name_face(contact, contact->entries[e].face);
    for (int e = 0; e < contact->pairs.entry_count; e++) {
        sbi_pair_entry *entry = contact->pairs.entries + e;
        entry->names[0] = sbi_skin_name_face(contact, entry->face);
        entry->names[1] = sbi_skin_name_face(contact, entry->other);
    }
}

/* Drops entries of triangles that were not found, or have no such sample; the others go where their order wants them.
 * What waits has been counted as entries. */
static void sbi_skin_keep_entries(sb_contact *contact)
{
    const sbi_contact_faces *faces = contact->faces;
    sbi_pairs *pairs = &contact->pairs;
    const int *found = contact->skin.found;
    int all = contact->entry_count, two = pairs->entry_count;
    contact->entry_count = pairs->entry_count = 0;
    for (int e = 0; e < all; e++) {
        sbi_contact_entry entry = contact->entries[e];
        entry.face = found[e];
        if (entry.face >= 0 && entry.sample < sbi_contact_face_rule(faces, entry.face, entry.parts)->count)
            sbi_contact_insert_entry(contact, &entry);
    }
    for (int e = 0; e < two; e++) {
        sbi_pair_entry entry = pairs->entries[e];
        entry.face = found[all + 2 * e];
        entry.other = found[all + 2 * e + 1];
        if (entry.face >= 0 && entry.other >= 0 &&
            entry.sample < sbi_contact_face_rule(faces, entry.face, entry.parts)->count)
            sbi_pairs_insert_entry(pairs, &entry);
    }
}

/* The name that entry or pair has for a face, as sbi_skin_ref. */
static uint64_t sbi_skin_ref_name(const sb_contact *contact, int ref)
{
    const int pair = ref - contact->entry_count;
    return pair < 0 ? contact->entries[ref].name : contact->pairs.entries[pair / 2].names[pair % 2];
}

SBI_API void sbi_contact_skin_take_waiting(sb_contact *contact)
{
    const sbi_contact_faces *faces = contact->faces;
    sbi_contact_skin *skin = &contact->skin;
    const int tools = skin->waiting, pairs = contact->pairs.waiting;
    int first, end;
    if (tools + pairs == 0)
        return;
    contact->entry_count = tools > 0 ? tools : contact->entry_count;
    contact->pairs.entry_count = pairs > 0 ? pairs : contact->pairs.entry_count;
    skin->waiting = contact->pairs.waiting = 0;
    first = tools > 0 ? 0 : contact->entry_count; /* from here to the end are those that wait */
    end = pairs > 0 ? sbi_skin_ref_count(contact) : contact->entry_count;
    for (int r = 0; r < sbi_skin_ref_count(contact); r++)
        skin->found[r] = r >= first && r < end ? -1 : sbi_skin_ref(contact, r);
    for (int f = 0; f < faces->face_end; f++) {
        uint64_t name = faces->areas[f] > 0 ? sbi_contact_skin_name(contact, f, skin->source->triangles[f]) : 0;
        for (int r = first; r < end && faces->areas[f] > 0; r++)
            if (sbi_skin_ref_name(contact, r) == name)
                skin->found[r] = f;
    }
    sbi_skin_keep_entries(contact);
}

SBI_API sb_result sbi_contact_skin_update(sb_contact *contact, sb_error *error)
{
    sbi_contact_skin *skin = &contact->skin;
    sbi_contact_faces *old = NULL;
    int kept;
    sb_result result = skin->source->update(skin->source, contact->body, error);
    if (result == SB_OK)
        result = sbi_skin_grow(contact, &old, error);
    if (result != SB_OK)
        return result;
    kept = sbi_skin_ref_count(contact) > 0;
    if (kept)
        sbi_skin_match_entries(contact, old ? old : contact->faces, contact->node_place);
    sbi_contact_faces_destroy(old);
    skin->point_count = skin->source->point_count;
    sbi_skin_fill_points(contact);
    result = sbi_contact_faces_fill_skin(contact->faces, contact->body, skin->source->triangles,
                                         skin->source->face_count, skin->cells, skin->rest, error);
    if (kept)
        sbi_skin_keep_entries(contact);
    if (result == SB_OK)
        sbi_contact_skin_take_waiting(contact);
    return result;
}

SBI_API int sbi_contact_skin_is_late(const sb_contact *contact, int is_load)
{
    const sb_body *body = contact->body;
    return contact->skin.source && (contact->skin.source->is_late || (is_load && body->live && body->live->find));
}
