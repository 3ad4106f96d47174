/* embed_follow: points of an embedding in a mesh that changes: which ones, their new places, and the arrays of
 * updates. */
#include "embed_follow.h"

#include "../base/sort.h"
#include "embed_live.h"

/* ---- memory ---- */

enum { SBI_EMBED_ALIGN = 64 };

static void *sbi_embed_pool_take(void *user, size_t bytes)
{
    sbi_embed_pool *pool = (sbi_embed_pool *)user;
    size_t rounded = bytes + (SBI_EMBED_ALIGN - 1);
    void *start = pool->base + pool->used;
    if (rounded < bytes || (rounded &= ~(size_t)(SBI_EMBED_ALIGN - 1)) > (size_t)-1 / 2 - pool->used)
        return NULL;
    if (rounded > pool->size - pool->used) {
        pool->wanted = pool->used + rounded;
        return NULL;
    }
    pool->used += rounded;
    return start;
}

static void sbi_embed_pool_give(void *user, void *pointer)
{
    (void)user;
    (void)pointer;
}

static sb_allocator sbi_embed_pool_begin(sbi_embed_pool *pool)
{
    sb_allocator allocator;
    allocator.alloc = sbi_embed_pool_take;
    allocator.release = sbi_embed_pool_give;
    allocator.user = pool;
    pool->used = pool->wanted = 0;
    return allocator;
}

/* After a call failed for memory: 1 when it is worth trying again, in twice what it wanted. */
static int sbi_embed_pool_grow(const sb_embedding *e, sbi_embed_pool *pool)
{
    unsigned char *base;
    if (pool->wanted <= pool->size)
        return 0;
    base = (unsigned char *)sbi_alloc(&e->allocator, pool->wanted, 2);
    if (!base)
        return 0;
    sbi_free(&e->allocator, pool->base);
    pool->base = base;
    pool->size = 2 * pool->wanted;
    return 1;
}

SBI_API sb_result sbi_embed_follow_no_memory(const sb_embedding *e, sb_error *error)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for an embedding of %d points to follow its mesh",
                    e->report.point_count);
}

static int sbi_embed_reserve_swaps(const sb_embedding *e, sbi_embed_follower *f, int count)
{
    sbi_embed_swap *swaps;
    int room = count < INT_MAX / 2 ? count + count / 2 : count;
    if (count <= f->swap_room)
        return 1;
    room = sbi_max_int(count, sbi_min_int(room, e->report.point_count));
    swaps = (sbi_embed_swap *)sbi_alloc(&e->allocator, (size_t)room, sizeof *swaps);
    if (!swaps)
        return 0;
    sbi_free(&e->allocator, f->swaps);
    f->swaps = swaps;
    f->swap_room = room;
    return 1;
}

/* Room for the faces of a cell more; 0: no memory. */
static int sbi_embed_more_near_faces(const sb_embedding *e, sbi_embed_follower *f)
{
    int room = sbi_embed_roomy(f->near_count + f->faces);
    if (!sbi_embed_grow_array(&e->allocator, (void **)&f->near_faces, (size_t)f->near_count, (size_t)room, sizeof(int)))
        return 0;
    f->near_room = room;
    return 1;
}

/* ---- a part of the mesh to search ---- */

/* What is searched, in the order in which it is. */
typedef enum sbi_embed_part {
    SBI_EMBED_CHANGED = 0, /* cells made and reshaped */
    SBI_EMBED_AROUND = 1,  /* cells around them, and the cells around these */
    SBI_EMBED_ALL = 2
} sbi_embed_part;

enum { SBI_EMBED_CHANGES = 1, SBI_EMBED_LISTED = 2 }; /* marks of cells */
enum { SBI_EMBED_NEAR = 2 };                          /* of nodes; 1: of a cell that changes */

static int sbi_embed_ascends(const void *unused, int a, int b)
{
    (void)unused;
    return a < b;
}

/* Lists a cell once; 0: it is listed. */
static int sbi_embed_list_cell(sbi_embed_follower *f, int cell)
{
    if (f->cell_marks[cell] & SBI_EMBED_LISTED)
        return 0;
    f->cell_marks[cell] |= SBI_EMBED_LISTED;
    f->part_cells[f->part_count++] = cell;
    return 1;
}

static void sbi_embed_list_around(sbi_embed_follower *f, int node)
{
    for (int at = f->first[node]; at >= 0; at = f->next[at])
        sbi_embed_list_cell(f, sbi_embed_cell_of(f, at));
}

/* Lists the cells of a part, ascending. */
static void sbi_embed_list_part(sbi_embed_follower *f, sbi_embed_part part)
{
    const sb_mesh_change *c = f->change;
    for (int i = 0; part == SBI_EMBED_ALL && i < f->cell_end; i++)
        if (f->cells[i * f->width] >= 0)
            sbi_embed_list_cell(f, i);
    for (int i = 0; part == SBI_EMBED_CHANGED && i < c->made_cell_count; i++)
        sbi_embed_list_cell(f, c->made_cells[i]);
    for (int i = 0; part == SBI_EMBED_CHANGED && i < c->reshaped_cell_count; i++)
        sbi_embed_list_cell(f, c->reshaped_cells[i]);
    for (int i = 0; part == SBI_EMBED_AROUND && i < f->changed_count; i++)
        for (int at = f->first[f->changed_nodes[i]]; at >= 0; at = f->next[at])
            for (int a = 0; a < f->width; a++) {
                int node = f->cells[sbi_embed_cell_of(f, at) * f->width + a];
                if (!(f->node_marks[node] & SBI_EMBED_NEAR)) {
                    f->node_marks[node] |= SBI_EMBED_NEAR;
                    f->part_nodes[f->part_node_count++] = node;
                    sbi_embed_list_around(f, node);
                }
            }
    for (int i = 0; i < f->part_node_count; i++)
        f->node_marks[f->part_nodes[i]] &= (unsigned char)~SBI_EMBED_NEAR;
    f->part_node_count = 0;
    if (part != SBI_EMBED_ALL)
        sbi_merge_sort(f->part_cells, f->part_cells + f->cell_room, f->part_count, sbi_embed_ascends, NULL);
}

static void sbi_embed_clear_part(sbi_embed_follower *f)
{
    for (int i = 0; i < f->part_count; i++)
        f->cell_marks[f->part_cells[i]] &= (unsigned char)~SBI_EMBED_LISTED;
    f->part_count = 0;
}

/* The listed cells as a mesh. 0: no memory. */
static int sbi_embed_make_part(const sb_embedding *e, sbi_embed_follower *f, const sb_allocator *allocator,
                               sb_mesh *mesh)
{
    size_t corners = (size_t)f->part_count * (size_t)f->width;
    memset(mesh, 0, sizeof *mesh);
    mesh->allocator = *allocator;
    mesh->element_type = e->type;
    mesh->element_count = f->part_count;
    mesh->elements = (int *)sbi_alloc(allocator, corners, sizeof(int));
    if (!mesh->elements)
        return 0;
    for (size_t i = 0; i < corners; i++) {
        int node = f->cells[f->part_cells[i / (size_t)f->width] * f->width + (int)(i % (size_t)f->width)];
        if (f->number[node] < 0) {
            f->number[node] = mesh->node_count++;
            f->part_nodes[f->number[node]] = node;
        }
        mesh->elements[i] = f->number[node];
    }
    mesh->nodes = (sb_vec3 *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(sb_vec3));
    for (int i = 0; i < mesh->node_count; i++) {
        if (mesh->nodes)
            mesh->nodes[i] = f->nodes[f->part_nodes[i]];
        f->number[f->part_nodes[i]] = -1;
    }
    return mesh->nodes != NULL;
}

/* Faces where the part ends but the mesh goes on hold no points. Without a skin it matters only which faces are outer
 * ones. */
static void sbi_embed_hide_cuts(const sbi_embed_follower *f, sbi_embed_skin skin, sbi_embed_volume *volume)
{
    for (int i = 0; i < f->part_count; i++)
        for (int k = 0; k < f->faces; k++) {
            int outer = f->outer[f->part_cells[i] * f->faces + k];
            if (skin != SBI_EMBED_SKIN || outer < 0)
                volume->boundary_face[i * f->faces + k] = outer;
        }
}

/* 1 when all cells of a node are searched: its normal is that of the whole mesh. */
static int sbi_embed_is_whole(const sbi_embed_follower *f, int node)
{
    for (int at = f->first[node]; at >= 0; at = f->next[at])
        if (!(f->cell_marks[sbi_embed_cell_of(f, at)] & SBI_EMBED_LISTED))
            return 0;
    return 1;
}

/* Whether a place found in a part is one in the mesh. */
static int sbi_embed_accepts(const sbi_embed_follower *f, sbi_embed_part part, const sbi_embed_place *place)
{
    int on_face = sbi_embed_is_on_face(place->hold), whole = 1;
    int cell = on_face ? place->cell / f->faces : place->cell;
    if (place->hold == SB_EMBEDDED_INSIDE || part == SBI_EMBED_ALL)
        return 1;
    if (part == SBI_EMBED_CHANGED || (on_face && f->outer[place->cell] < 0))
        return 0;
    for (int a = 0; a < (on_face ? f->face_nodes : f->width) && whole; a++)
        whole = sbi_embed_is_whole(f, f->cells[cell * f->width + (on_face ? f->local[place->cell % f->faces][a] : a)]);
    return whole;
}

/* Holds a point by the frame of the face that its foot is on, as it would be without smooth normals. */
static void sbi_embed_hold_by_frame(const sb_embedding *e, const sbi_embed_follower *f, int point,
                                    sbi_embed_place *place, sb_embedded_point *info)
{
    const int *nodes = f->cells + place->cell / f->faces * f->width, *local = f->local[place->cell % f->faces];
    sb_real shape[SB_MAX_FACE_NODES], slope[SB_MAX_FACE_NODES][3];
    sb_vec3 at = sb_v3(0, 0, 0), r = at, s = at, offset;
    sb_mat3 frame;
    sb_element_shape(e->face.type, place->parameters, shape, slope);
    for (int a = 0; a < f->face_nodes; a++) {
        sb_vec3 x = f->nodes[nodes[local[a]]];
        at = sb_v3_madd(at, shape[a], x);
        r = sb_v3_madd(r, slope[a][0], x);
        s = sb_v3_madd(s, slope[a][1], x);
    }
    frame = sbi_embed_face_frame(r, s);
    offset = sb_m3_tapply(frame, sb_v3_sub(e->rest[point], at));
    place->hold = info->hold = SB_EMBEDDED_FRAME;
    place->offset[0] = offset.x, place->offset[1] = offset.y, place->offset[2] = offset.z;
    if (e->rest_normals) {
        offset = sb_m3_tapply(frame, sbi_embed_unit(e->rest_normals[point]));
        place->carried[0] = offset.x, place->carried[1] = offset.y, place->carried[2] = offset.z;
    }
}

/* A place in an element that is cut goes over to the piece that has it: outside by the frame of its face, as the nodes
 * of another piece have other smooth normals. */
static void sbi_embed_find_piece(const sb_embedding *e, const sbi_embed_follower *f, int point, sbi_embed_place *place,
                                 sb_embedded_point *info)
{
    int on_face = sbi_embed_is_on_face(place->hold), cell, face;
    if (!f->find_cell)
        return;
    cell = f->find_cell(f->find_user, info->element, info->xi);
    face = cell * f->faces + place->cell % f->faces;
    if (cell < 0 || cell >= f->cell_end || cell == info->element || f->cells[cell * f->width] < 0 ||
        (on_face && f->outer[face] < 0))
        return;
    info->element = cell;
    place->cell = on_face ? face : cell;
    if (place->hold == SB_EMBEDDED_OFFSET)
        sbi_embed_hold_by_frame(e, f, point, place, info);
}

/* Places what has no place yet; returns how many are left. */
static int sbi_embed_place_swaps(const sb_embedding *e, sbi_embed_follower *f, sbi_embed_part part,
                                 const sbi_embed_volume *volume)
{
    sb_embedding_kind kind = part == SBI_EMBED_CHANGED ? SB_EMBED_PLAIN : e->kind; /* only inside counts there */
    int left = 0, hint = volume->order[0];
    for (int i = 0; i < f->swap_count; i++) {
        sbi_embed_swap *swap = &f->swaps[i];
        const sb_vec3 *normal = e->rest_normals ? e->rest_normals + swap->point : NULL;
        if (i % SBI_EMBED_TASK_BUILD == 0) /* as at creation */
            hint = volume->order[0];
        if (swap->done)
            continue;
        sbi_embed_place_point(volume, kind, e->rest[swap->point], normal, &hint, &swap->place, &swap->info);
        swap->info.element = f->part_cells[swap->info.element];
        if (sbi_embed_is_on_face(swap->place.hold))
            swap->place.cell = f->part_cells[swap->place.cell / f->faces] * f->faces + swap->place.cell % f->faces;
        else
            swap->place.cell = swap->info.element;
        sbi_embed_find_piece(e, f, swap->point, &swap->place, &swap->info);
        swap->done = sbi_embed_accepts(f, part, &swap->place);
        left += !swap->done;
    }
    return left;
}

/* Searches the listed cells, with memory from allocator. */
static sb_result sbi_embed_search_part(const sb_embedding *e, sbi_embed_follower *f, sbi_embed_part part,
                                       const sb_allocator *allocator, int *left, sb_error *error)
{
    sbi_embed_skin skin = part == SBI_EMBED_CHANGED ? SBI_EMBED_BARE : SBI_EMBED_SKIN;
    sbi_embed_volume volume;
    sb_mesh mesh;
    sb_result result = SB_ERROR_MEMORY;
    if (sbi_embed_make_part(e, f, allocator, &mesh))
        result = sbi_embed_volume_create(&mesh, skin, allocator, &volume, error);
    if (result == SB_OK) {
        volume.scale = e->scale;
        sbi_embed_hide_cuts(f, skin, &volume);
        *left = sbi_embed_place_swaps(e, f, part, &volume);
        sbi_embed_volume_free(&volume);
    }
    sb_mesh_free(&mesh);
    return result == SB_ERROR_MEMORY ? sbi_embed_follow_no_memory(e, error) : result;
}

/* Places all swaps, from one part of the mesh on. */
static sb_result sbi_embed_search(const sb_embedding *e, sbi_embed_follower *f, sbi_embed_part from, sb_error *error)
{
    sb_result result = SB_OK;
    int left = f->swap_count;
    for (int part = (int)from; part <= (int)SBI_EMBED_ALL && left > 0 && result == SB_OK; part++) {
        sbi_embed_list_part(f, (sbi_embed_part)part);
        for (int again = f->part_count > 0; again;) {
            sb_allocator allocator = sbi_embed_pool_begin(&f->scratch);
            int whole = part == (int)SBI_EMBED_ALL; /* needed once in a while: its memory is given back */
            result =
                sbi_embed_search_part(e, f, (sbi_embed_part)part, whole ? &e->allocator : &allocator, &left, error);
            again = result == SB_ERROR_MEMORY && !whole && sbi_embed_pool_grow(e, &f->scratch);
        }
        sbi_embed_clear_part(f);
    }
    return result;
}

/* ---- which points ---- */

/* Lists the points of a cell, or those outside that it holds. */
static void sbi_embed_list_held(const sb_embedding *e, sbi_embed_follower *f, int cell, int outside, int *count)
{
    const sbi_embed_arrays *a = &e->arrays;
    if (cell >= a->element_room || !sbi_embed_list_cell(f, cell))
        return;
    for (int g = a->element_groups[cell]; g >= 0; g = a->groups[g].next)
        if (!outside || a->groups[g].hold != SB_EMBEDDED_INSIDE)
            *count += sbi_embed_list_points(a, &a->groups[g], f->sorted + *count);
}

/* Points of cells that change, and those outside that a cell with a node of theirs holds. */
static int sbi_embed_list_changed(const sb_embedding *e, sbi_embed_follower *f)
{
    const sb_mesh_change *c = f->change;
    int count = 0;
    for (int i = 0; i < c->removed_cell_count; i++)
        sbi_embed_list_held(e, f, c->removed_cells[i], 0, &count);
    for (int i = 0; i < c->made_cell_count; i++)
        sbi_embed_list_held(e, f, c->made_cells[i], 0, &count);
    for (int i = 0; i < c->reshaped_cell_count; i++)
        sbi_embed_list_held(e, f, c->reshaped_cells[i], 0, &count);
    for (int i = 0; i < f->changed_count && e->report.inside < e->report.point_count; i++)
        for (int at = f->first[f->changed_nodes[i]]; at >= 0; at = f->next[at])
            sbi_embed_list_held(e, f, sbi_embed_cell_of(f, at), 1, &count);
    sbi_embed_clear_part(f);
    if (!sbi_embed_reserve_swaps(e, f, count))
        return 0;
    sbi_merge_sort(f->sorted, f->sorted + e->report.point_count, count, sbi_embed_ascends, NULL);
    f->swap_count = count;
    for (int i = 0; i < count; i++) {
        f->swaps[i].done = 0;
        f->swaps[i].point = f->sorted[i];
    }
    return 1;
}

static void sbi_embed_swap_places(sb_embedding *e, sbi_embed_follower *f)
{
    for (int i = 0; i < f->swap_count; i++) {
        sbi_embed_swap *swap = &f->swaps[i], before = *swap;
        swap->place = f->places[swap->point];
        swap->info = e->points[swap->point];
        f->places[swap->point] = before.place;
        e->points[swap->point] = before.info;
    }
}

SBI_API void sbi_embed_fill_report(const sb_embedding *e, const sbi_embed_follower *f, sb_embedding_report *report)
{
    memset(report, 0, sizeof *report);
    report->point_count = e->report.point_count;
    report->node_count = f->node_end;
    report->farthest_point = -1;
    for (int p = 0; p < report->point_count; p++) {
        sbi_embed_report_add(report, &f->places[p], p);
        report->lost += e->inside[p] && f->places[p].hold != SB_EMBEDDED_INSIDE;
    }
}

/* The report after the places have been swapped. */
static void sbi_embed_next_report(const sb_embedding *e, const sbi_embed_follower *f, sb_embedding_report *report)
{
    *report = e->report;
    report->node_count = f->node_end;
    for (int i = 0; i < f->swap_count; i++) {
        const sbi_embed_swap *before = &f->swaps[i];
        const sbi_embed_place *place = &f->places[before->point];
        if (before->point == e->report.farthest_point) { /* another one may be the farthest now */
            sbi_embed_fill_report(e, f, report);
            return;
        }
        --*sbi_embed_report_count(report, before->place.hold);
        sbi_embed_report_add(report, place, before->point);
        report->lost -= e->inside[before->point] && before->place.hold != SB_EMBEDDED_INSIDE;
        report->lost += e->inside[before->point] && place->hold != SB_EMBEDDED_INSIDE;
    }
}

/* ---- the arrays of updates ---- */

SBI_API void sbi_embed_fill_parts(const sb_embedding *e, const sbi_embed_follower *f, sbi_embed_parts *parts)
{
    memset(parts, 0, sizeof *parts);
    parts->places = f->places;
    parts->with_normals = e->rest_normals != NULL;
    parts->with_offsets = f->report.frame + f->report.extrapolated > 0;
    parts->node_count = f->node_end;
    parts->element_count = f->cell_end;
    parts->width = f->width;
    parts->faces = f->faces;
    parts->elements = f->cells;
    parts->outer = f->outer;
    parts->weights = f->weights;
    parts->face = &e->face;
    memcpy(parts->local, f->local, sizeof parts->local);
}

/* First group of the element of a place. */
static int *sbi_embed_groups_at(const sb_embedding *e, const sbi_embed_follower *f, const sbi_embed_place *place)
{
    return &e->arrays.element_groups[sbi_embed_is_on_face(place->hold) ? place->cell / f->faces : place->cell];
}

/* The nodes whose smooth normals a place needs count as changed. */
static void sbi_embed_mark_place(sbi_embed_follower *f, const sbi_embed_parts *parts, const sbi_embed_place *place)
{
    int nodes[SB_MAX_ELEMENT_NODES];
    if (place->hold == SB_EMBEDDED_OFFSET)
        sbi_embed_live_mark(f, nodes, sbi_embed_cell_nodes(parts, place->hold, place->cell, nodes));
}

/* The same of a place before the change, whose groups know its nodes. */
static void sbi_embed_mark_old_place(const sb_embedding *e, sbi_embed_follower *f, const sbi_embed_place *place)
{
    const sbi_embed_arrays *a = &e->arrays;
    const sbi_embed_rows *rows = &a->rows[SBI_EMBED_OF_GROUPS];
    for (int g = *sbi_embed_groups_at(e, f, place); g >= 0 && place->hold == SB_EMBEDDED_OFFSET; g = a->groups[g].next)
        if (a->groups[g].hold == place->hold && a->groups[g].cell == place->cell)
            sbi_embed_live_mark(f, rows->nodes + (size_t)g * (size_t)rows->width, a->groups[g].node_count);
}

/* Corner of a cell's face that is the first of its nodes to have changed, or -1. */
static int sbi_embed_first_changed(const sbi_embed_follower *f, const int *nodes, const int *local)
{
    for (int a = 0; a < f->face_nodes; a++)
        if (f->node_marks[nodes[local[a]]])
            return local[a];
    return -1;
}

/* Lists the outer faces around nodes that changed, each once; where no point needs a normal, none. 0: no memory. */
static int sbi_embed_list_faces(const sb_embedding *e, sbi_embed_follower *f)
{
    f->near_count = 0;
    for (int i = 0; i < f->changed_count && f->report.offset > 0; i++)
        for (int at = f->first[f->changed_nodes[i]]; at >= 0; at = f->next[at]) {
            int cell = sbi_embed_cell_of(f, at), corner = at - cell * f->width;
            const int *outer = f->outer + cell * f->faces, *nodes = f->cells + cell * f->width;
            if (f->faces > f->near_room - f->near_count && !sbi_embed_more_near_faces(e, f))
                return 0;
            for (int k = 0; k < f->faces; k++)
                if (outer[k] >= 0 && sbi_embed_first_changed(f, nodes, f->local[k]) == corner)
                    f->near_faces[f->near_count++] = cell * f->faces + k;
        }
    return 1;
}

/* Room for the arrays after the change. */
static int sbi_embed_reserve_arrays(sb_embedding *e, sbi_embed_follower *f)
{
    sbi_embed_arrays *a = &e->arrays;
    sbi_embed_parts parts;
    sbi_embed_more more;
    int64_t touched;
    sbi_embed_fill_parts(e, f, &parts);
    for (int i = 0; i < f->swap_count; i++) {
        sbi_embed_mark_old_place(e, f, &f->swaps[i].place);
        sbi_embed_mark_place(f, &parts, &f->places[f->swaps[i].point]);
    }
    more.groups = more.blocks = f->swap_count; /* a point more makes one more at most */
    if (!sbi_embed_list_faces(e, f))
        return 0;
    more.faces = f->near_count;
    touched = (int64_t)f->swap_count * f->width + (int64_t)more.faces * f->face_nodes;
    more.touched = (int)(touched < f->node_end ? touched : f->node_end);
    return sbi_embed_arrays_reserve(&e->allocator, a, &parts, &more);
}

/* Takes the groups of a hold and cell out, and lists their points. */
static void sbi_embed_take_out(sb_embedding *e, sbi_embed_follower *f, const sbi_embed_place *place, int *count)
{
    sbi_embed_arrays *a = &e->arrays;
    for (int *link = sbi_embed_groups_at(e, f, place); *link >= 0;) {
        sbi_embed_group *group = &a->groups[*link];
        if (group->hold == place->hold && group->cell == place->cell) {
            *count += sbi_embed_list_points(a, group, f->sorted + *count);
            sbi_embed_drop_group(a, link);
        } else {
            link = &group->next;
        }
    }
}

static int sbi_embed_place_before(const void *context, int p, int q)
{
    const sbi_embed_follower *f = (const sbi_embed_follower *)context;
    const sbi_embed_place *a = &f->places[p], *b = &f->places[q];
    if (a->hold != b->hold)
        return a->hold < b->hold;
    return a->cell != b->cell ? a->cell < b->cell : f->rank[p] < f->rank[q];
}

/* Makes anew what the swapped points and the changed nodes are part of. */
static void sbi_embed_change_arrays(sb_embedding *e, sbi_embed_follower *f)
{
    sbi_embed_parts parts;
    int count = 0;
    sbi_embed_fill_parts(e, f, &parts);
    for (int i = 0; i < f->swap_count; i++)
        sbi_embed_take_out(e, f, &f->swaps[i].place, &count);
    for (int i = 0; i < f->swap_count; i++)
        sbi_embed_take_out(e, f, &f->places[f->swaps[i].point], &count);
    for (int i = 0; i < f->changed_count; i++)
        sbi_embed_drop_faces(&e->arrays, f->changed_nodes[i]);
    sbi_merge_sort(f->sorted, f->sorted + e->report.point_count, count, sbi_embed_place_before, f);
    sbi_embed_add_groups(&e->arrays, &parts, f->sorted, count);
    for (int i = 0; i < f->near_count; i++)
        sbi_embed_add_face(&e->arrays, &parts, f->near_faces[i]);
}

/* ---- a whole mesh ---- */

SBI_API void sbi_embed_drop_prepared(const sb_embedding *e, sbi_embed_follower *f)
{
    struct sbi_embed_prepared *next = f->prepared;
    f->prepared = NULL;
    if (!next)
        return;
    sbi_embed_arrays_free(&e->allocator, &next->arrays);
    sbi_embed_follower_free(e, next->follower);
    sbi_free(&e->allocator, next->points);
    sbi_free(&e->allocator, next);
}

SBI_API void sbi_embed_follower_free(const sb_embedding *e, sbi_embed_follower *f)
{
    const sb_allocator *allocator = &e->allocator;
    if (!f)
        return;
    sbi_embed_drop_prepared(e, f);
    sbi_free(allocator, f->nodes);
    sbi_free(allocator, f->cells);
    sbi_free(allocator, f->first);
    sbi_free(allocator, f->next);
    sbi_free(allocator, f->outer);
    sbi_free(allocator, f->weights);
    sbi_free(allocator, f->free_rows);
    sbi_free(allocator, f->node_marks);
    sbi_free(allocator, f->cell_marks);
    sbi_free(allocator, f->changed_nodes);
    sbi_free(allocator, f->part_cells);
    sbi_free(allocator, f->part_nodes);
    sbi_free(allocator, f->number);
    sbi_free(allocator, f->near_faces);
    sbi_free(allocator, f->places);
    sbi_free(allocator, f->rank);
    sbi_free(allocator, f->sorted);
    sbi_free(allocator, f->swaps);
    sbi_free(allocator, f->scratch.base);
    sbi_free(allocator, f->old_nodes);
    sbi_free(allocator, f);
}

SBI_API void sbi_embed_follower_destroy(sb_embedding *e)
{
    if (e->follower->owner.body)
        e->follower->owner.leave(e);
    sbi_embed_follower_free(e, e->follower);
    e->follower = NULL;
}

SBI_API sbi_embed_follower *sbi_embed_follower_make(const sb_embedding *e)
{
    sbi_embed_follower *f = (sbi_embed_follower *)sbi_alloc_zeroed(&e->allocator, 1, sizeof *f);
    size_t points = (size_t)e->report.point_count;
    if (!f)
        return NULL;
    f->width = sb_element_node_count(e->type);
    f->faces = sb_element_face_count(e->type);
    f->face_nodes = e->face.nodes;
    f->face_corners = e->face.corners;
    sbi_embed_fill_local(e->type, f->local);
    f->places = (sbi_embed_place *)sbi_alloc_zeroed(&e->allocator, points, sizeof *f->places);
    f->rank = (int *)sbi_alloc(&e->allocator, points, sizeof(int));
    f->sorted = (int *)sbi_alloc(&e->allocator, points, 2 * sizeof(int));
    for (size_t i = 0; f->rank && i < points; i++)
        f->rank[e->order[i]] = (int)i;
    if (f->places && f->rank && f->sorted)
        return f;
    sbi_embed_follower_free(e, f);
    return NULL;
}

/* Places all points in a mesh and makes the arrays. */
static sb_result sbi_embed_take_mesh(sb_embedding *e, sbi_embed_follower *f, const sbi_embed_slots *mesh,
                                     sbi_embed_arrays *arrays, sb_error *error)
{
    sbi_embed_parts parts;
    sb_result result;
    f->find_cell = mesh->find_cell;
    f->find_user = mesh->find_user;
    if (!sbi_embed_live_room(e, f, mesh->node_end, mesh->cell_end, 0) || !sbi_embed_live_fill(e, f, mesh) ||
        !sbi_embed_reserve_swaps(e, f, e->report.point_count))
        return sbi_embed_follow_no_memory(e, error);
    f->swap_count = e->report.point_count;
    for (int i = 0; i < f->swap_count; i++) {
        f->swaps[i].point = e->order[i];
        f->swaps[i].done = 0;
    }
    result = sbi_embed_search(e, f, SBI_EMBED_ALL, error);
    if (result != SB_OK)
        return result;
    sbi_embed_swap_places(e, f);
    sbi_embed_fill_report(e, f, &f->report);
    sbi_embed_fill_parts(e, f, &parts);
    if (sbi_embed_arrays_fill(&e->allocator, arrays, &parts, e->order, e->report.point_count))
        return SB_OK;
    sbi_embed_swap_places(e, f);
    return sbi_embed_follow_no_memory(e, error);
}

SBI_API sb_result sbi_embed_follower_load(sb_embedding *e, const sbi_embed_slots *mesh, sb_error *error)
{
    sbi_embed_follower *old = e->follower, *f = sbi_embed_follower_make(e);
    sbi_embed_arrays arrays;
    sb_result result;
    memset(&arrays, 0, sizeof arrays);
    result = f ? sbi_embed_take_mesh(e, f, mesh, &arrays, error) : sbi_embed_follow_no_memory(e, error);
    if (result != SB_OK) {
        sbi_embed_arrays_free(&e->allocator, &arrays);
        sbi_embed_follower_free(e, f);
        if (old && old->owner.body)
            old->stale = 1;
        return result;
    }
    sbi_embed_arrays_free(&e->allocator, &e->arrays);
    e->arrays = arrays;
    e->report = f->report;
    if (old)
        f->owner = old->owner;
    else
        sbi_free(&e->allocator, e->elements);
    e->elements = f->cells;
    e->follower = f;
    f->swap_count = 0;
    sbi_embed_follower_free(e, old);
    return SB_OK;
}

/* ---- changes ---- */

static int sbi_embed_reserve_mesh(const sb_embedding *e, sbi_embed_follower *f)
{
    const sb_mesh_change *c = f->change;
    int64_t rows = (int64_t)f->row_fresh + (int64_t)f->faces * ((int64_t)c->made_cell_count + c->removed_cell_count);
    if (rows > INT_MAX || !sbi_embed_live_room(e, f, sbi_max_int(f->node_end, c->node_end),
                                               sbi_max_int(f->cell_end, c->cell_end), (int)rows))
        return 0;
    if (c->made_node_count > f->old_room) {
        int room = c->made_node_count < INT_MAX / 2 ? 2 * c->made_node_count : c->made_node_count;
        sb_vec3 *old_nodes = (sb_vec3 *)sbi_alloc(&e->allocator, (size_t)room, sizeof(sb_vec3));
        if (!old_nodes)
            return 0;
        sbi_free(&e->allocator, f->old_nodes);
        f->old_nodes = old_nodes;
        f->old_room = room;
    }
    return 1;
}

SBI_API sb_result sbi_embed_follower_reserve(sb_embedding *e, const sb_mesh_change *change, sb_error *error)
{
    sb_result result = e->follower->stale ? e->follower->owner.refresh(e, error) : SB_OK;
    sbi_embed_follower *f = e->follower; /* another one after a refresh */
    int known;
    if (result != SB_OK)
        return result;
    f->change = change;
    f->find_cell = change->find_cell;
    f->find_user = change->find_user;
    known = sbi_embed_reserve_mesh(e, f);
    e->elements = f->cells; /* they may have moved */
    if (!known)
        return sbi_embed_follow_no_memory(e, error);
    sbi_embed_live_apply(f, &e->face, 0);
    result = sbi_embed_list_changed(e, f) ? sbi_embed_search(e, f, SBI_EMBED_CHANGED, error)
                                          : sbi_embed_follow_no_memory(e, error);
    if (result != SB_OK)
        f->swap_count = 0;
    sbi_embed_swap_places(e, f);
    sbi_embed_next_report(e, f, &f->report);
    if (result == SB_OK && f->swap_count && !sbi_embed_reserve_arrays(e, f))
        result = sbi_embed_follow_no_memory(e, error);
    if (result != SB_OK)
        sbi_embed_follower_give_up(e);
    return result;
}

SBI_API void sbi_embed_follower_follow(sb_embedding *e)
{
    sbi_embed_follower *f = e->follower;
    if (f->swap_count)
        sbi_embed_change_arrays(e, f);
    e->report = f->report;
    f->swap_count = 0;
    sbi_embed_live_clear_marks(f);
}

SBI_API void sbi_embed_follower_give_up(sb_embedding *e)
{
    sbi_embed_follower *f = e->follower;
    sbi_embed_swap_places(e, f);
    f->swap_count = 0;
    sbi_embed_live_apply(f, &e->face, 1);
    sbi_embed_live_clear_marks(f);
}
