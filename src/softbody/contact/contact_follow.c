/* contact_follow: faces of a body whose mesh changes.
 *
 * A change says at once which sides of cells came to the surface or left it, in time proportional to what changed. The
 * faces themselves are made anew once a step, from these marks: that costs less than a microsecond for ten faces, and
 * leaves no trace of how the mesh came about. */
#include "contact_faces.h"

#include <string.h>

#include "../body/body_private.h"
#include "../body/live_private.h"

/* ---- memory ---- */

/* Larger rooms; the faces are then those that `outer` says. 0: no memory, and nothing changed. */
static int sbi_contact_grow(sbi_contact_faces *faces, const sb_body *body, int face_room, int node_room, int cell_room)
{
    sbi_contact_faces next = *faces;
    const sbi_contact_live *old = &faces->live;
    next.face_room = face_room;
    next.node_room = node_room;
    next.live.cell_room = cell_room;
    if (!sbi_contact_take_arrays(&next))
        return 0;
    if (!sbi_contact_take_tree(&next, sbi_contact_most_nodes(&next))) {
        sbi_free(&next.allocator, next.memory);
        return 0;
    }
    memcpy(next.live.outer, old->outer, (size_t)old->cell_room * (size_t)faces->side_count);
    memcpy(next.live.gone, old->gone, (size_t)old->cell_room);
    memcpy(next.live.seen, old->seen, (size_t)old->seen_count * sizeof(int));
    sbi_contact_release_arrays(faces);
    *faces = next;
    sbi_contact_put_faces(faces, body, faces->live.outer);
    sbi_contact_build_tree(faces, body, &faces->live.order);
    sbi_contact_faces_refit(faces, body->position, NULL, 0);
    return 1;
}

/* Room for `needed`, and half of it in reserve where it has to grow. */
static int sbi_contact_room(int room, int64_t needed)
{
    int64_t grown = needed + needed / 2;
    return needed <= room ? room : (int)(grown < INT32_MAX ? grown : INT32_MAX);
}

SBI_API sb_result sbi_contact_faces_reserve(sbi_contact_faces *faces, const sb_body *body, const sb_mesh_change *change,
                                            sb_error *error)
{
    const sbi_contact_live *live = &faces->live;
    int64_t cells = (int64_t)change->made_cell_count + change->removed_cell_count;
    int64_t needed = live->outer_count + cells * faces->side_count; /* each side of each cell lays open one */
    int face_room = sbi_contact_room(faces->face_room, needed);
    int node_room = sbi_contact_room(faces->node_room, change->node_end);
    int cell_room = sbi_contact_room(live->cell_room, change->cell_end);
    if (live->news == SBI_CONTACT_STALE ||
        (face_room == faces->face_room && node_room == faces->node_room && cell_room == live->cell_room))
        return SB_OK;
    if (needed > INT32_MAX || cell_room > INT32_MAX / faces->side_count ||
        !sbi_contact_grow(faces, body, face_room, node_room, cell_room))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for contact to follow a mesh of %d cells", change->cell_end);
    return SB_OK;
}

/* ---- what is outside ---- */

/* 1 when no cell lies on the other side of a cell's side, and none before it on this. */
static int sbi_contact_is_outside(const sbi_contact_faces *faces, const sb_body *body, int cell, int number)
{
    const sbi_contact_side *side = &faces->element_sides[number];
    const int *nodes = sbi_contact_cell_nodes(body, cell);
    int corners[SB_MAX_FACE_NODES], ascends = sbi_contact_side_ascends(side, nodes), key;
    for (int a = 0; a < side->corners; a++)
        corners[a] = nodes[side->local[a]];
    key = cell * faces->side_count + number;
    for (int at = sbi_live_first_cell(body, corners[0]); at >= 0; at = sbi_live_next_cell(body, corners[0], at)) {
        int other = sbi_live_cell_of(body, at);
        const int *others = sbi_contact_cell_nodes(body, other);
        for (int k = 0; k < faces->side_count; k++) {
            const sbi_contact_side *same = &faces->element_sides[k];
            int place = other * faces->side_count + k;
            if (place != key && same->corners == side->corners &&
                sbi_body_has_corners(corners, others, same->local, side->corners) &&
                (place < key || sbi_contact_side_ascends(same, others) != ascends))
                return 0;
        }
    }
    return 1;
}

/* 1 when all corners of a side are marked. */
static int sbi_contact_is_near(const unsigned char *near, const sbi_contact_side *side, const int *nodes)
{
    int all = 1;
    for (int a = 0; a < side->corners; a++)
        all &= near[nodes[side->local[a]]] != 0;
    return all;
}

static void sbi_contact_set_outer(sbi_contact_live *live, int key, int outer)
{
    live->outer_count += outer - live->outer[key];
    live->outer[key] = (unsigned char)outer;
}

/* Sides that begin at a node and have marked corners only. */
static void sbi_contact_look_around(sbi_contact_faces *faces, const sb_body *body, int node)
{
    sbi_contact_live *live = &faces->live;
    if (node >= body->domain.node_count) /* a slot at the end that is no more */
        return;
    for (int at = sbi_live_first_cell(body, node); at >= 0; at = sbi_live_next_cell(body, node, at)) {
        int cell = sbi_live_cell_of(body, at);
        const int *nodes = sbi_contact_cell_nodes(body, cell);
        for (int k = 0; k < faces->side_count; k++)
            if (nodes[faces->element_sides[k].local[0]] == node &&
                sbi_contact_is_near(live->near, &faces->element_sides[k], nodes))
                sbi_contact_set_outer(live, cell * faces->side_count + k, sbi_contact_is_outside(faces, body, cell, k));
    }
}

/* near[node] of the nodes becomes `mark`. */
static void sbi_contact_mark_nodes(unsigned char *near, const int *nodes, size_t count, int mark)
{
    for (size_t i = 0; i < count; i++)
        near[nodes[i]] = (unsigned char)mark;
}

/* Looks around nodes of a list that are marked with 1, each once. */
static void sbi_contact_look_around_nodes(sbi_contact_faces *faces, const sb_body *body, const int *nodes, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (faces->live.near[nodes[i]] == 1) {
            faces->live.near[nodes[i]] = 2;
            sbi_contact_look_around(faces, body, nodes[i]);
        }
}

SBI_API void sbi_contact_faces_follow(sbi_contact_faces *faces, const sb_body *body, const sb_mesh_change *change)
{
    sbi_contact_live *live = &faces->live;
    size_t removed, made;
    if (!change)
        live->news = SBI_CONTACT_STALE;
    if (live->news == SBI_CONTACT_STALE)
        return;
    live->news = SBI_CONTACT_CHANGED;
    removed = (size_t)change->removed_cell_count * (size_t)change->nodes_per_cell;
    made = (size_t)change->made_cell_count * (size_t)change->nodes_per_cell;
    for (int i = 0; i < change->removed_cell_count; i++) {
        live->gone[change->removed_cells[i]] = 1;
        for (int k = 0; k < faces->side_count; k++)
            sbi_contact_set_outer(live, change->removed_cells[i] * faces->side_count + k, 0);
    }
    sbi_contact_mark_nodes(live->near, change->removed_cell_nodes, removed, 1);
    sbi_contact_mark_nodes(live->near, change->made_cell_nodes, made, 1);
    sbi_contact_look_around_nodes(faces, body, change->removed_cell_nodes, removed);
    sbi_contact_look_around_nodes(faces, body, change->made_cell_nodes, made);
    sbi_contact_mark_nodes(live->near, change->removed_cell_nodes, removed, 0);
    sbi_contact_mark_nodes(live->near, change->made_cell_nodes, made, 0);
}

/* ---- the faces anew ---- */

/* Faces of a mesh that is another as a whole: none is what it was. */
static sb_result sbi_contact_reload(sbi_contact_faces *faces, const sb_body *body, sb_error *error)
{
    sbi_contact_faces next = *faces;
    sb_result result;
    int before = faces->live.seen_count;
    memset(&next.live, 0, sizeof next.live);
    memset(&next.tree, 0, sizeof next.tree);
    next.memory = NULL;
    result = sbi_contact_fill(&next, body, error);
    if (result == SB_OK && next.face_room < before) { /* `moved` has an entry for each face before */
        next.live.seen_count = 0;
        if (!sbi_contact_grow(&next, body, before, next.node_room, next.live.cell_room))
            result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for contact on %d faces", before);
    }
    if (result != SB_OK) {
        sbi_contact_release_arrays(&next);
        return result;
    }
    next.live.seen_count = before;
    sbi_contact_release_arrays(faces);
    *faces = next;
    memset(faces->live.gone, 1, (size_t)faces->live.cell_room);
    return SB_OK;
}

/* live.moved from the keys of the last time and those of now, which both ascend. */
static void sbi_contact_match(sbi_contact_faces *faces)
{
    sbi_contact_live *live = &faces->live;
    int f = 0;
    for (int i = 0; i < live->seen_count; i++) {
        int key = live->seen[i];
        while (f < faces->face_end && faces->keys[f] < key)
            f++;
        live->moved[i] = f < faces->face_end && faces->keys[f] == key && !live->gone[key / faces->side_count] ? f : -1;
    }
    memcpy(live->seen, faces->keys, (size_t)faces->face_end * sizeof(int));
    live->seen_count = faces->face_end;
    memset(live->gone, 0, (size_t)live->cell_room);
}

SBI_API sb_result sbi_contact_faces_update(sbi_contact_faces *faces, const sb_body *body, int *changed, sb_error *error)
{
    sbi_contact_live *live = &faces->live;
    sbi_contact_news news = live->news; /* faces that are loaded anew have none */
    if (changed)
        *changed = news != SBI_CONTACT_CURRENT;
    if (news == SBI_CONTACT_STALE) {
        sb_result result = sbi_contact_reload(faces, body, error);
        if (result != SB_OK)
            return result;
    } else if (news == SBI_CONTACT_CHANGED) {
        sbi_contact_put_faces(faces, body, live->outer);
        sbi_contact_build_tree(faces, body, &live->order);
    }
    if (news != SBI_CONTACT_CURRENT)
        sbi_contact_match(faces);
    live->news = SBI_CONTACT_CURRENT;
    return SB_OK;
}
