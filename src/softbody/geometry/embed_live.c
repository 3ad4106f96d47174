/* embed_live: cells around nodes and outer faces of a mesh in slots, as it changes. */
#include "embed_live.h"

/* ---- memory ---- */

static int sbi_embed_live_node_room(const sb_embedding *e, sbi_embed_follower *f, int needed)
{
    size_t used = (size_t)f->node_room, room = (size_t)sbi_embed_roomy(needed);
    if (needed <= f->node_room)
        return 1;
    if (!sbi_embed_grow_array(&e->allocator, (void **)&f->nodes, used, room, sizeof(sb_vec3)) ||
        !sbi_embed_grow_array(&e->allocator, (void **)&f->first, used, room, sizeof(int)) ||
        !sbi_embed_grow_array(&e->allocator, (void **)&f->node_marks, used, room, 1) ||
        !sbi_embed_grow_array(&e->allocator, (void **)&f->changed_nodes, used, room, sizeof(int)) ||
        !sbi_embed_grow_array(&e->allocator, (void **)&f->part_nodes, used, room, sizeof(int)) ||
        !sbi_embed_grow_array(&e->allocator, (void **)&f->number, used, room, sizeof(int)))
        return 0;
    memset(f->nodes + used, 0, (room - used) * sizeof(sb_vec3));
    memset(f->first + used, 0xff, (room - used) * sizeof(int));
    memset(f->node_marks + used, 0, room - used);
    memset(f->number + used, 0xff, (room - used) * sizeof(int));
    f->node_room = (int)room;
    return 1;
}

static int sbi_embed_live_cell_room(const sb_embedding *e, sbi_embed_follower *f, int needed)
{
    size_t used = (size_t)f->cell_room, room, width = (size_t)f->width, faces = (size_t)f->faces;
    if (needed <= f->cell_room)
        return 1;
    if (needed > INT_MAX / f->width)
        return 0;
    room = (size_t)sbi_min_int(sbi_embed_roomy(needed), INT_MAX / f->width);
    if (!sbi_embed_grow_array(&e->allocator, (void **)&f->cells, used * width, room * width, sizeof(int)) ||
        !sbi_embed_grow_array(&e->allocator, (void **)&f->next, used * width, room * width, sizeof(int)) ||
        !sbi_embed_grow_array(&e->allocator, (void **)&f->outer, used * faces, room * faces, sizeof(int)) ||
        !sbi_embed_grow_array(&e->allocator, (void **)&f->cell_marks, used, room, 1) ||
        !sbi_embed_grow_array(&e->allocator, (void **)&f->part_cells, 0, 2 * room, sizeof(int)))
        return 0;
    memset(f->cells + used * width, 0xff, (room - used) * width * sizeof(int));
    memset(f->outer + used * faces, 0xff, (room - used) * faces * sizeof(int));
    memset(f->cell_marks + used, 0, room - used);
    f->cell_room = (int)room;
    return 1;
}

SBI_API int sbi_embed_live_room(const sb_embedding *e, sbi_embed_follower *f, int nodes, int cells, int rows)
{
    size_t used = (size_t)f->row_room, room = (size_t)sbi_embed_roomy(rows), width = (size_t)f->face_nodes;
    if (!sbi_embed_live_node_room(e, f, nodes) || !sbi_embed_live_cell_room(e, f, cells))
        return 0;
    if (rows <= f->row_room)
        return 1;
    if (!sbi_embed_grow_array(&e->allocator, (void **)&f->weights, used * width, room * width, sizeof(sb_real)) ||
        !sbi_embed_grow_array(&e->allocator, (void **)&f->free_rows, used, room, sizeof(int)))
        return 0;
    f->row_room = (int)room;
    return 1;
}

/* ---- cells ---- */

static void sbi_embed_live_set_cell(sbi_embed_follower *f, int cell, const int *nodes)
{
    for (int a = 0; a < f->width; a++) {
        int corner = cell * f->width + a;
        f->cells[corner] = nodes[a];
        f->next[corner] = f->first[nodes[a]];
        f->first[nodes[a]] = corner;
    }
}

static void sbi_embed_live_drop_row(sbi_embed_follower *f, int key)
{
    if (f->outer[key] >= 0)
        f->free_rows[f->free_count++] = f->outer[key];
    f->outer[key] = -1;
}

static void sbi_embed_live_clear_cell(sbi_embed_follower *f, int cell)
{
    for (int a = 0; a < f->width; a++) {
        int corner = cell * f->width + a, *at = &f->first[f->cells[corner]];
        while (*at != corner)
            at = &f->next[*at];
        *at = f->next[corner];
    }
    for (int k = 0; k < f->faces; k++)
        sbi_embed_live_drop_row(f, cell * f->faces + k);
    f->cells[cell * f->width] = -1;
}

/* ---- outer faces ---- */

/* 1 when a cell has a node; the four of a tet4 without branches, which would be guessed wrong. */
static int sbi_embed_live_has(const sbi_embed_follower *f, const int *cell, int node)
{
    int found = (cell[0] == node) | (cell[1] == node) | (cell[2] == node) | (cell[3] == node);
    for (int a = 4; a < f->width; a++)
        found |= cell[a] == node;
    return found;
}

/* 1 when no other cell has the corners of this face. */
static int sbi_embed_live_is_outer(const sbi_embed_follower *f, int cell, const int *local)
{
    const int *nodes = f->cells + cell * f->width;
    for (int at = f->first[nodes[local[0]]]; at >= 0; at = f->next[at]) {
        const int *other = f->cells + sbi_embed_cell_of(f, at) * f->width;
        int shared = other != nodes;
        for (int c = 1; c < f->face_corners && shared; c++)
            shared = sbi_embed_live_has(f, other, nodes[local[c]]);
        if (shared)
            return 0;
    }
    return 1;
}

/* Whether a face is an outer one, and its weights. */
static void sbi_embed_live_update_face(sbi_embed_follower *f, const sbi_embed_face *face, int cell, int k)
{
    int key = cell * f->faces + k, *row = &f->outer[key];
    const int *local = f->local[k], *nodes = f->cells + cell * f->width;
    sb_vec3 x[SB_MAX_FACE_NODES];
    if (!sbi_embed_live_is_outer(f, cell, local)) {
        sbi_embed_live_drop_row(f, key);
        return;
    }
    if (*row < 0)
        *row = f->free_count ? f->free_rows[--f->free_count] : f->row_fresh++;
    for (int a = 0; a < f->face_nodes; a++)
        x[a] = f->nodes[nodes[local[a]]];
    for (int a = 0; a < f->face_nodes; a++)
        f->weights[(size_t)*row * (size_t)f->face_nodes + (size_t)a] = sbi_embed_face_angle(face, x, a);
}

/* 1 when all nodes of a face are marked. */
static int sbi_embed_live_is_marked(const sbi_embed_follower *f, const int *nodes, const int *local)
{
    int all = 1;
    for (int a = 0; a < f->face_nodes && all; a++)
        all = f->node_marks[nodes[local[a]]] != 0;
    return all;
}

/* The faces all of whose nodes are marked: others have the neighbours and the shape that they had. */
static void sbi_embed_live_update_faces(sbi_embed_follower *f, const sbi_embed_face *face)
{
    for (int i = 0; i < f->changed_count; i++)
        for (int at = f->first[f->changed_nodes[i]]; at >= 0; at = f->next[at]) {
            int cell = sbi_embed_cell_of(f, at), corner = at - cell * f->width;
            const int *nodes = f->cells + cell * f->width;
            for (int k = 0; k < f->faces; k++)
                if (f->local[k][0] == corner && sbi_embed_live_is_marked(f, nodes, f->local[k]))
                    sbi_embed_live_update_face(f, face, cell, k);
        }
}

static int sbi_embed_live_count_outer(const sbi_embed_follower *f)
{
    int count = 0;
    for (int c = 0; c < f->cell_end; c++)
        for (int k = 0; k < f->faces && f->cells[c * f->width] >= 0; k++)
            count += sbi_embed_live_is_outer(f, c, f->local[k]);
    return count;
}

SBI_API int sbi_embed_live_fill(const sb_embedding *e, sbi_embed_follower *f, const sbi_embed_slots *mesh)
{
    memset(f->first, 0xff, (size_t)f->node_room * sizeof(int));
    memset(f->cells, 0xff, (size_t)f->cell_room * (size_t)f->width * sizeof(int));
    memset(f->outer, 0xff, (size_t)f->cell_room * (size_t)f->faces * sizeof(int));
    f->free_count = f->row_fresh = 0;
    f->node_end = mesh->node_end;
    f->cell_end = mesh->cell_end;
    memcpy(f->nodes, mesh->nodes, (size_t)mesh->node_end * sizeof(sb_vec3));
    for (int c = mesh->cell_end - 1; c >= 0; c--)
        if (mesh->used[c])
            sbi_embed_live_set_cell(f, c, mesh->cells + (size_t)c * (size_t)f->width);
    if (!sbi_embed_live_room(e, f, f->node_end, f->cell_end, sbi_embed_live_count_outer(f)))
        return 0;
    for (int c = 0; c < mesh->cell_end; c++)
        for (int k = 0; k < f->faces && mesh->used[c]; k++)
            sbi_embed_live_update_face(f, &e->face, c, k);
    return 1;
}

/* ---- changes ---- */

SBI_API void sbi_embed_live_mark(sbi_embed_follower *f, const int *nodes, int count)
{
    for (int a = 0; a < count; a++)
        if (!f->node_marks[nodes[a]]) {
            f->node_marks[nodes[a]] = 1;
            f->changed_nodes[f->changed_count++] = nodes[a];
        }
}

static void sbi_embed_live_mark_change(sbi_embed_follower *f)
{
    const sb_mesh_change *c = f->change;
    size_t n = (size_t)f->width;
    for (int i = 0; i < c->removed_cell_count; i++) {
        f->cell_marks[c->removed_cells[i]] = 1;
        sbi_embed_live_mark(f, c->removed_cell_nodes + (size_t)i * n, f->width);
    }
    for (int i = 0; i < c->made_cell_count; i++) {
        f->cell_marks[c->made_cells[i]] = 1;
        sbi_embed_live_mark(f, c->made_cell_nodes + (size_t)i * n, f->width);
    }
    for (int i = 0; i < c->reshaped_cell_count; i++) {
        f->cell_marks[c->reshaped_cells[i]] = 1;
        sbi_embed_live_mark(f, f->cells + (size_t)c->reshaped_cells[i] * n, f->width);
    }
}

SBI_API void sbi_embed_live_clear_marks(sbi_embed_follower *f)
{
    const sb_mesh_change *c = f->change;
    for (int i = 0; i < c->removed_cell_count; i++)
        f->cell_marks[c->removed_cells[i]] = 0;
    for (int i = 0; i < c->made_cell_count; i++)
        f->cell_marks[c->made_cells[i]] = 0;
    for (int i = 0; i < c->reshaped_cell_count; i++)
        f->cell_marks[c->reshaped_cells[i]] = 0;
    for (int i = 0; i < f->changed_count; i++)
        f->node_marks[f->changed_nodes[i]] = 0;
    f->changed_count = 0;
}

static void sbi_embed_live_forward(sbi_embed_follower *f)
{
    const sb_mesh_change *c = f->change;
    for (int i = 0; i < c->removed_cell_count; i++)
        sbi_embed_live_clear_cell(f, c->removed_cells[i]);
    f->old_node_end = f->node_end;
    f->old_cell_end = f->cell_end;
    f->node_end = c->node_end;
    f->cell_end = c->cell_end;
    for (int i = 0; i < c->made_node_count; i++) {
        f->old_nodes[i] = f->nodes[c->made_nodes[i]];
        f->nodes[c->made_nodes[i]] = c->made_positions[i];
    }
    for (int i = 0; i < c->moved_node_count; i++)
        f->nodes[c->moved_nodes[i]] = c->moved_to[i];
    for (int i = 0; i < c->made_cell_count; i++)
        sbi_embed_live_set_cell(f, c->made_cells[i], c->made_cell_nodes + (size_t)i * (size_t)f->width);
}

static void sbi_embed_live_back(sbi_embed_follower *f)
{
    const sb_mesh_change *c = f->change;
    for (int i = 0; i < c->made_cell_count; i++)
        sbi_embed_live_clear_cell(f, c->made_cells[i]);
    for (int i = 0; i < c->moved_node_count; i++)
        f->nodes[c->moved_nodes[i]] = c->moved_from[i];
    for (int i = c->made_node_count - 1; i >= 0; i--)
        f->nodes[c->made_nodes[i]] = f->old_nodes[i];
    f->node_end = f->old_node_end;
    f->cell_end = f->old_cell_end;
    for (int i = 0; i < c->removed_cell_count; i++)
        sbi_embed_live_set_cell(f, c->removed_cells[i], c->removed_cell_nodes + (size_t)i * (size_t)f->width);
}

SBI_API void sbi_embed_live_apply(sbi_embed_follower *f, const sbi_embed_face *face, int back)
{
    sbi_embed_live_mark_change(f);
    if (back)
        sbi_embed_live_back(f);
    else
        sbi_embed_live_forward(f);
    sbi_embed_live_update_faces(f, face);
}
