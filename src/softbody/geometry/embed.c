/* embed: creation: where each point is, groups of points that share a cell, normals, rings; readings. */
#include "embed_private.h"

#define SBI_EMBED_COOKIE 0x73626d31u

/* ---- creation: where each point is ---- */

/* A point's place while the embedding is made. */
typedef struct sbi_embed_place {
    sb_embedding_hold hold;
    int cell; /* element, or boundary face */
    sb_real parameters[3], offset[3], carried[3];
    sb_real gap; /* distance to the mesh (m) */
} sbi_embed_place;

/* A creation under way. */
typedef struct sbi_embed_build {
    const sb_embedding_def *def;
    const sb_vec3 *rest; /* the points */
    int count;
    sbi_embed_volume volume;
    int *order;        /* points along Morton's curve; later by hold and cell */
    uint32_t *scratch; /* [3 count] */
    int *hints;        /* element to start from for each task */
    sbi_embed_place *places;
    sb_embedding *e;
} sbi_embed_build;

/* The offset of a point from x(xi) in the parameters of the element, corrected once for rounding. */
static void sbi_embed_find_step(const sbi_embed_volume *volume, sb_vec3 point, sb_embedded_point *info)
{
    sb_mat3 jacobian, inverse;
    sb_vec3 offset = sb_v3_sub(point, sbi_embed_map(volume->mesh, info->element, info->xi, &jacobian)), step;
    inverse = sb_m3_inverse(jacobian);
    step = sb_m3_apply(inverse, offset);
    step = sb_v3_add(step, sb_m3_apply(inverse, sb_v3_sub(offset, sb_m3_apply(jacobian, step))));
    info->step[0] = step.x, info->step[1] = step.y, info->step[2] = step.z;
    info->distance = sb_v3_norm(offset);
}

static void sbi_embed_place_foot(const sbi_embed_volume *volume, const sbi_embed_foot *foot, sbi_embed_place *place,
                                 sb_embedded_point *info)
{
    place->cell = foot->face;
    place->parameters[0] = foot->r;
    place->parameters[1] = foot->s;
    place->parameters[2] = foot->distance;
    info->element = sbi_embed_foot_element(volume, foot, info->xi);
}

/* How a point outside is held. */
static void sbi_embed_place_outside(const sbi_embed_volume *volume, sb_embedding_kind kind, sb_vec3 point,
                                    const sbi_embed_hit *hit, sbi_embed_place *place, sb_embedded_point *info)
{
    sbi_embed_foot foot;
    if (kind == SB_EMBED_SMOOTH && sbi_embed_find_foot(volume, point, hit, &foot)) {
        place->hold = SB_EMBEDDED_OFFSET;
        sbi_embed_place_foot(volume, &foot, place, info);
        return;
    }
    foot = sbi_embed_hit_foot(volume, hit);
    if (kind == SB_EMBED_SMOOTH && foot.face >= 0) {
        sb_vec3 tangent[2], offset = sb_v3_sub(point, sbi_embed_foot_tangents(volume, &foot, tangent));
        offset = sb_m3_tapply(sbi_embed_face_frame(tangent[0], tangent[1]), offset);
        place->hold = SB_EMBEDDED_FRAME;
        sbi_embed_place_foot(volume, &foot, place, info);
        place->offset[0] = offset.x, place->offset[1] = offset.y, place->offset[2] = offset.z;
        return;
    }
    place->hold = SB_EMBEDDED_EXTRAPOLATED;
}

/* Coordinates of a rest normal N that make the carried one: J^T N / det J with the columns J of the map at rest, for
 * cof(F) N = cof(J') J^T N / det J; in the frame of a face E^T N. */
static void sbi_embed_place_normal(const sbi_embed_volume *volume, sb_vec3 normal, const sb_embedded_point *info,
                                   sbi_embed_place *place)
{
    sbi_embed_foot foot;
    sb_mat3 jacobian;
    sb_vec3 at, tangent[2], carried;
    foot.face = place->cell;
    foot.r = place->parameters[0], foot.s = place->parameters[1], foot.distance = place->parameters[2];
    normal = sbi_embed_unit(normal);
    if (place->hold == SB_EMBEDDED_FRAME) {
        sbi_embed_foot_tangents(volume, &foot, tangent);
        carried = sb_m3_tapply(sbi_embed_face_frame(tangent[0], tangent[1]), normal);
    } else {
        if (place->hold == SB_EMBEDDED_OFFSET)
            sbi_embed_foot_map(volume, &foot, &at, &jacobian);
        else
            sbi_embed_map(volume->mesh, info->element, info->xi, &jacobian);
        carried = sb_v3_scale(1 / sb_m3_det(jacobian), sb_m3_tapply(jacobian, normal));
    }
    place->carried[0] = carried.x, place->carried[1] = carried.y, place->carried[2] = carried.z;
}

/* Places one point; *hint is an element nearby, and then the point's own. */
static void sbi_embed_place_point(sbi_embed_build *build, int index, int *hint)
{
    const sbi_embed_volume *volume = &build->volume;
    sbi_embed_place *place = &build->places[index];
    sb_embedded_point *info = &build->e->points[index];
    sb_vec3 point = build->rest[index];
    sbi_embed_hit hit;
    memset(place, 0, sizeof *place);
    memset(info, 0, sizeof *info);
    sbi_embed_closest(volume, point, *hint, &hit);
    *hint = hit.element;
    place->cell = info->element = hit.element;
    place->gap = sb_sqrt(hit.distance2);
    for (int k = 0; k < 3; k++)
        place->parameters[k] = info->xi[k] = hit.xi[k];
    if (hit.distance2 > 0) {
        sbi_embed_place_outside(volume, build->def->kind, point, &hit, place, info);
        sbi_embed_find_step(volume, point, info);
        for (int k = 0; place->hold == SB_EMBEDDED_EXTRAPOLATED && k < 3; k++)
            place->offset[k] = info->step[k];
    }
    info->hold = place->hold;
    if (build->def->normals)
        sbi_embed_place_normal(volume, build->def->normals[index], info, place);
}

static void sbi_embed_task_place(void *user, int task)
{
    sbi_embed_build *build = (sbi_embed_build *)user;
    int end = sbi_min_int((task + 1) * SBI_EMBED_TASK_BUILD, build->count), hint = build->volume.order[0];
    for (int i = task * SBI_EMBED_TASK_BUILD; i < end; i++)
        sbi_embed_place_point(build, build->order[i], &hint);
}

/* Places all points and fills the report. */
static sb_result sbi_embed_place_all(sbi_embed_build *build, sb_error *error)
{
    sb_embedding_report *report = &build->e->report;
    report->point_count = build->count;
    report->node_count = build->def->mesh->node_count;
    report->farthest_point = -1;
    sbi_embed_sort(build->rest, build->count, build->order, build->scratch);
    sbi_run(&build->def->jobs, sbi_embed_task_place, build, sbi_embed_tasks(build->count, SBI_EMBED_TASK_BUILD));
    for (int i = 0; i < build->count; i++) {
        const sbi_embed_place *place = &build->places[i];
        if (!(place->gap <= build->def->max_distance) || !(place->gap < (sb_real)0.5 * sb_sqrt(SB_REAL_MAX)))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "point %d lies %g m outside the mesh", i,
                                 (double)place->gap);
        report->inside += place->hold == SB_EMBEDDED_INSIDE;
        report->offset += place->hold == SB_EMBEDDED_OFFSET;
        report->frame += place->hold == SB_EMBEDDED_FRAME;
        report->extrapolated += place->hold == SB_EMBEDDED_EXTRAPOLATED;
        if (place->gap > report->max_distance) {
            report->max_distance = place->gap;
            report->farthest_point = i;
        }
    }
    return SB_OK;
}

/* ---- creation: arrays ---- */

/* Allocates for the embedding; NULL (and *ok = 0) when memory is short. */
static void *sbi_embed_take(const sb_embedding *e, int *ok, size_t count, size_t size)
{
    void *pointer = *ok ? sbi_alloc(&e->allocator, count, size) : NULL;
    if (!pointer)
        *ok = 0;
    return pointer;
}

/* Rows of the indices i with keys[i] = row; keys < 0 belong to none. */
static int sbi_embed_lists_make(const sb_embedding *e, const int *keys, int count, int rows, sbi_embed_lists *lists)
{
    int ok = 1;
    lists->rows = rows;
    lists->starts = (int *)sbi_embed_take(e, &ok, (size_t)rows + 2, sizeof(int));
    lists->items = (int *)sbi_embed_take(e, &ok, (size_t)count, sizeof(int));
    if (!ok)
        return 0;
    memset(lists->starts, 0, ((size_t)rows + 2) * sizeof(int));
    for (int i = 0; i < count; i++)
        if (keys[i] >= 0)
            lists->starts[keys[i] + 2]++;
    for (int r = 0; r < rows; r++)
        lists->starts[r + 2] += lists->starts[r + 1];
    for (int i = 0; i < count; i++) /* starts[r + 1] runs from the start of row r to its end */
        if (keys[i] >= 0)
            lists->items[lists->starts[keys[i] + 1]++] = i;
    return 1;
}

static void sbi_embed_lists_free(const sb_embedding *e, sbi_embed_lists *lists)
{
    sbi_free(&e->allocator, lists->starts);
    sbi_free(&e->allocator, lists->items);
    memset(lists, 0, sizeof *lists);
}

SB_API void sb_embedding_destroy(sb_embedding *embedding)
{
    sb_allocator allocator;
    if (!embedding)
        return;
    allocator = embedding->allocator;
    for (int k = 0; k < 3; k++) {
        sbi_free(&allocator, embedding->parameters[k]);
        sbi_free(&allocator, embedding->offsets[k]);
        sbi_free(&allocator, embedding->carried[k]);
    }
    sbi_embed_lists_free(embedding, &embedding->normal_faces);
    sbi_embed_lists_free(embedding, &embedding->normal_groups);
    sbi_embed_lists_free(embedding, &embedding->touched);
    sbi_embed_lists_free(embedding, &embedding->rings);
    sbi_free(&allocator, embedding->points);
    sbi_free(&allocator, embedding->elements);
    sbi_free(&allocator, embedding->groups);
    sbi_free(&allocator, embedding->tasks);
    sbi_free(&allocator, embedding->slot_point);
    sbi_free(&allocator, embedding->nodes);
    sbi_free(&allocator, embedding->normal_of);
    sbi_free(&allocator, embedding->weights);
    sbi_free(&allocator, embedding->touched_nodes);
    sbi_free(&allocator, embedding->face_normals);
    sbi_free(&allocator, embedding->normals);
    sbi_free(&allocator, embedding->lengths);
    sbi_free(&allocator, embedding->entry_forces);
    sbi_free(&allocator, embedding->entry_pulls);
    sbi_free(&allocator, embedding->normal_pulls);
    sbi_free(&allocator, embedding);
}

static sb_result sbi_embed_no_memory(sb_error *error, int count)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory to embed %d points", count);
}

/* build->order = points by hold, then cell, then as before. */
static int sbi_embed_sort_places(sbi_embed_build *build)
{
    int *scratch = (int *)build->scratch,
        rows = sbi_max_int(build->volume.mesh->element_count, build->volume.boundary.surface.element_count);
    int hold_starts[5] = {0, 0, 0, 0, 0}, ok = 1;
    int *starts = (int *)sbi_embed_take(build->e, &ok, (size_t)rows + 1, sizeof(int));
    if (!ok)
        return 0;
    memset(starts, 0, ((size_t)rows + 1) * sizeof(int));
    for (int i = 0; i < build->count; i++) {
        starts[build->places[i].cell + 1]++;
        hold_starts[(int)build->places[i].hold + 1]++;
    }
    for (int r = 0; r < rows; r++)
        starts[r + 1] += starts[r];
    for (int h = 0; h < 4; h++)
        hold_starts[h + 1] += hold_starts[h];
    for (int i = 0; i < build->count; i++)
        scratch[starts[build->places[build->order[i]].cell]++] = build->order[i];
    for (int i = 0; i < build->count; i++)
        build->order[hold_starts[(int)build->places[scratch[i]].hold]++] = scratch[i];
    sbi_free(&build->e->allocator, starts);
    return 1;
}

/* One more group from place i of the order on; returns where the next one starts. */
static int sbi_embed_next_group(const sbi_embed_build *build, int i, sbi_embed_group *group)
{
    const sbi_embed_place *first = &build->places[build->order[i]];
    int end = i + 1;
    while (end < build->count && end - i < SBI_EMBED_GROUP && build->places[build->order[end]].hold == first->hold &&
           build->places[build->order[end]].cell == first->cell)
        end++;
    group->hold = first->hold;
    group->count = end - i;
    group->node_count = sbi_embed_is_on_face(first->hold) ? build->e->face.nodes : build->volume.width;
    return end;
}

static const int *sbi_embed_cell_nodes(const sbi_embed_build *build, sb_embedding_hold hold, int cell)
{
    const int *all = sbi_embed_is_on_face(hold) ? build->volume.boundary.surface.elements : build->def->mesh->elements;
    return all + (size_t)cell * (size_t)(sbi_embed_is_on_face(hold) ? build->e->face.nodes : build->volume.width);
}

/* Counts groups, slots and node entries; 0 when they do not fit an int. */
static int sbi_embed_count_groups(sbi_embed_build *build)
{
    sb_embedding *e = build->e;
    long long slots = 0, entries = 0;
    for (int i = 0; i < build->count;) {
        sbi_embed_group group;
        i = sbi_embed_next_group(build, i, &group);
        e->group_count++;
        slots += (long long)sbi_embed_tasks(group.count, SBI_EMBED_LANES) * SBI_EMBED_LANES;
        entries += group.node_count;
    }
    if (slots > INT_MAX || entries > INT_MAX / 2)
        return 0;
    e->slot_count = (int)slots;
    e->group_entries = (int)entries;
    e->task_count = sbi_embed_tasks(e->slot_count, SBI_EMBED_TASK_SLOTS);
    return 1;
}

/* Slots of a group, with their numbers. from: its first place in the order. */
static void sbi_embed_fill_slots(const sbi_embed_build *build, const sbi_embed_group *group, int from)
{
    sb_embedding *e = build->e;
    int padded = sbi_embed_tasks(group->count, SBI_EMBED_LANES) * SBI_EMBED_LANES;
    for (int s = 0; s < padded; s++) {
        int point = build->order[from + sbi_min_int(s, group->count - 1)], slot = group->first + s;
        e->slot_point[slot] = point;
        for (int k = 0; k < 3; k++) {
            e->parameters[k][slot] = build->places[point].parameters[k];
            if (e->offsets[0])
                e->offsets[k][slot] = build->places[point].offset[k];
            if (e->carried[0])
                e->carried[k][slot] = build->places[point].carried[k];
        }
    }
}

static int sbi_embed_allocate_groups(sbi_embed_build *build)
{
    sb_embedding *e = build->e;
    size_t slots = (size_t)e->slot_count;
    int ok = 1, with_offsets = e->report.frame + e->report.extrapolated > 0;
    e->groups = (sbi_embed_group *)sbi_embed_take(e, &ok, (size_t)e->group_count, sizeof(sbi_embed_group));
    e->tasks = (int *)sbi_embed_take(e, &ok, (size_t)e->task_count + 1, sizeof(int));
    e->slot_point = (int *)sbi_embed_take(e, &ok, slots, sizeof(int));
    for (int k = 0; k < 3; k++) {
        e->parameters[k] = (sb_real *)sbi_embed_take(e, &ok, slots, sizeof(sb_real));
        if (with_offsets)
            e->offsets[k] = (sb_real *)sbi_embed_take(e, &ok, slots, sizeof(sb_real));
        if (build->def->normals)
            e->carried[k] = (sb_real *)sbi_embed_take(e, &ok, slots, sizeof(sb_real));
    }
    return ok;
}

/* groups, slots and tasks, from the order by hold and cell. */
static int sbi_embed_make_groups(sbi_embed_build *build)
{
    sb_embedding *e = build->e;
    int slot = 0, entry = 0, task = 0;
    if (!sbi_embed_sort_places(build) || !sbi_embed_count_groups(build) || !sbi_embed_allocate_groups(build))
        return 0;
    for (int g = 0, i = 0; g < e->group_count; g++) {
        sbi_embed_group *group = &e->groups[g];
        int from = i;
        i = sbi_embed_next_group(build, i, group);
        group->first = slot;
        group->node_first = entry;
        if (slot >= task * SBI_EMBED_TASK_SLOTS && task < e->task_count)
            e->tasks[task++] = g;
        sbi_embed_fill_slots(build, group, from);
        slot += sbi_embed_tasks(group->count, SBI_EMBED_LANES) * SBI_EMBED_LANES;
        entry += group->node_count;
    }
    e->task_count = task;
    e->tasks[task] = e->group_count;
    return 1;
}

/* ---- creation: smooth normals and node entries ---- */

/* Numbers the nodes that need smooth normals (ids: -1 or the number, by mesh node) and lists the boundary faces around
 * them in faces. */
static void sbi_embed_pick_normals(sbi_embed_build *build, int *ids, int *faces)
{
    sb_embedding *e = build->e;
    int width = e->face.nodes;
    memset(ids, 0xff, (size_t)build->def->mesh->node_count * sizeof(int));
    for (int i = 0; i < build->count; i++) {
        const int *nodes = sbi_embed_cell_nodes(build, build->places[i].hold, build->places[i].cell);
        for (int a = 0; a < width && build->places[i].hold == SB_EMBEDDED_OFFSET; a++)
            if (ids[nodes[a]] < 0)
                ids[nodes[a]] = e->normal_count++;
    }
    for (int f = 0; f < build->volume.boundary.surface.element_count; f++) {
        const int *nodes = sbi_embed_cell_nodes(build, SB_EMBEDDED_OFFSET, f);
        int wanted = 0;
        for (int a = 0; a < width; a++)
            wanted |= ids[nodes[a]] >= 0;
        if (wanted)
            faces[e->face_count++] = f;
    }
}

/* Fills nodes and normal_of of all entries, and the weights of the faces. */
static void sbi_embed_fill_entries(sbi_embed_build *build, const int *ids, const int *faces)
{
    sb_embedding *e = build->e;
    int width = e->face.nodes;
    for (int g = 0; g < e->group_count; g++) {
        const sbi_embed_group *group = &e->groups[g];
        int cell = build->places[e->slot_point[group->first]].cell;
        const int *nodes = sbi_embed_cell_nodes(build, group->hold, cell);
        for (int a = 0; a < group->node_count; a++) {
            e->nodes[group->node_first + a] = nodes[a];
            e->normal_of[group->node_first + a] = group->hold == SB_EMBEDDED_OFFSET ? ids[nodes[a]] : -1;
        }
    }
    for (int f = 0; f < e->face_count; f++) {
        const int *nodes = sbi_embed_cell_nodes(build, SB_EMBEDDED_OFFSET, faces[f]);
        size_t first = (size_t)f * (size_t)width;
        memcpy(e->weights + first, build->volume.weights + (size_t)faces[f] * (size_t)width,
               sizeof(sb_real) * (size_t)width);
        for (int a = 0; a < width; a++) {
            e->nodes[(size_t)e->group_entries + first + (size_t)a] = nodes[a];
            e->normal_of[(size_t)e->group_entries + first + (size_t)a] = ids[nodes[a]];
        }
    }
}

/* touched and touched_nodes; rows[entry_count] is scratch. */
static int sbi_embed_make_touched(sb_embedding *e, int node_count, int *rows)
{
    int ok = 1, *row_of = (int *)sbi_embed_take(e, &ok, (size_t)node_count, sizeof(int));
    if (!ok)
        return 0;
    memset(row_of, 0xff, (size_t)node_count * sizeof(int));
    for (int i = 0; i < e->entry_count; i++) {
        if (row_of[e->nodes[i]] < 0)
            row_of[e->nodes[i]] = e->touched_count++;
        rows[i] = row_of[e->nodes[i]];
    }
    e->touched_nodes = (int *)sbi_embed_take(e, &ok, (size_t)e->touched_count, sizeof(int));
    for (int i = 0; ok && i < e->entry_count; i++)
        e->touched_nodes[rows[i]] = e->nodes[i];
    sbi_free(&e->allocator, row_of);
    return ok && sbi_embed_lists_make(e, rows, e->entry_count, e->touched_count, &e->touched);
}

static int sbi_embed_allocate_entries(sb_embedding *e)
{
    size_t entries = (size_t)e->entry_count, faces = (size_t)e->face_count, width = (size_t)e->face.nodes;
    int ok = 1;
    e->nodes = (int *)sbi_embed_take(e, &ok, entries, sizeof(int));
    e->normal_of = (int *)sbi_embed_take(e, &ok, entries, sizeof(int));
    e->weights = (sb_real *)sbi_embed_take(e, &ok, faces * width, sizeof(sb_real));
    e->face_normals = (sb_vec3 *)sbi_embed_take(e, &ok, faces * width, sizeof(sb_vec3));
    e->normals = (sb_vec3 *)sbi_embed_take(e, &ok, (size_t)e->normal_count, sizeof(sb_vec3));
    e->lengths = (sb_real *)sbi_embed_take(e, &ok, (size_t)e->normal_count, sizeof(sb_real));
    e->normal_pulls = (sb_vec3 *)sbi_embed_take(e, &ok, (size_t)e->normal_count, sizeof(sb_vec3));
    e->entry_forces = (sb_vec3 *)sbi_embed_take(e, &ok, entries, sizeof(sb_vec3));
    e->entry_pulls = (sb_vec3 *)sbi_embed_take(e, &ok, (size_t)e->group_entries, sizeof(sb_vec3));
    return ok;
}

static int sbi_embed_make_entries(sbi_embed_build *build)
{
    sb_embedding *e = build->e;
    int ok = 1, node_count = build->def->mesh->node_count, *rows = NULL;
    int *ids = (int *)sbi_embed_take(e, &ok, (size_t)node_count, sizeof(int));
    int *faces = (int *)sbi_embed_take(e, &ok, (size_t)build->volume.boundary.surface.element_count, sizeof(int));
    if (ok) {
        long long entries;
        sbi_embed_pick_normals(build, ids, faces);
        entries = (long long)e->group_entries + (long long)e->face_count * e->face.nodes;
        ok = entries <= INT_MAX;
        e->entry_count = ok ? (int)entries : 0;
    }
    ok = ok && sbi_embed_allocate_entries(e);
    rows = (int *)sbi_embed_take(e, &ok, (size_t)e->entry_count, sizeof(int));
    if (ok) {
        sbi_embed_fill_entries(build, ids, faces);
        ok = sbi_embed_make_touched(e, node_count, rows) &&
             sbi_embed_lists_make(e, e->normal_of + e->group_entries, e->entry_count - e->group_entries,
                                  e->normal_count, &e->normal_faces) &&
             sbi_embed_lists_make(e, e->normal_of, e->group_entries, e->normal_count, &e->normal_groups);
    }
    sbi_free(&e->allocator, rows);
    sbi_free(&e->allocator, faces);
    sbi_free(&e->allocator, ids);
    return ok;
}

/* ---- creation: rings ---- */

/* Appends the ring of one point to items and returns how many. pairs[count][2]: the neighbours of the point in each of
 * its triangles, in their orientation. A pair that begins where the one before ended continues its run. */
static int sbi_embed_make_ring(int (*pairs)[2], int count, int *items)
{
    int used = 0;
    for (int i = 0; i < count; i++) {
        int continues = i > 0 && pairs[i][0] == pairs[i - 1][1];
        for (int j = i; i > 0 && !continues && count <= SBI_EMBED_RING && j < count; j++)
            if (pairs[j][0] == pairs[i - 1][1]) {
                int a = pairs[j][0], b = pairs[j][1];
                pairs[j][0] = pairs[i][0], pairs[j][1] = pairs[i][1];
                pairs[i][0] = a, pairs[i][1] = b;
                continues = 1;
            }
        if (!continues)
            items[used++] = ~pairs[i][0];
        items[used++] = pairs[i][1];
    }
    return used;
}

/* An open fan must start at its rim to be one run: moves the pair that no other leads to to the front. */
static void sbi_embed_start_ring(int (*pairs)[2], int count)
{
    for (int i = 0; count <= SBI_EMBED_RING && i < count; i++) {
        int led_to = 0;
        for (int j = 0; j < count; j++)
            led_to |= pairs[j][1] == pairs[i][0];
        if (!led_to) {
            int a = pairs[i][0], b = pairs[i][1];
            pairs[i][0] = pairs[0][0], pairs[i][1] = pairs[0][1];
            pairs[0][0] = a, pairs[0][1] = b;
            return;
        }
    }
}

/* Writes the rings of all points; pairs: memory for one point's. */
static void sbi_embed_fill_rings(const sb_mesh *surface, const sbi_embed_lists *corners, int (*pairs)[2],
                                 sbi_embed_lists *rings)
{
    int width = sb_element_node_count(surface->element_type);
    rings->rows = corners->rows;
    rings->starts[0] = 0;
    for (int p = 0; p < corners->rows; p++) {
        int count = corners->starts[p + 1] - corners->starts[p];
        for (int i = 0; i < count; i++) {
            int entry = corners->items[corners->starts[p] + i], local = entry % width;
            const int *nodes = surface->elements + (entry - local);
            pairs[i][0] = nodes[(local + 1) % width];
            pairs[i][1] = nodes[(local + width - 1) % width];
        }
        sbi_embed_start_ring(pairs, count);
        rings->starts[p + 1] = rings->starts[p] + sbi_embed_make_ring(pairs, count, rings->items + rings->starts[p]);
    }
}

static int sbi_embed_make_rings(sbi_embed_build *build)
{
    sb_embedding *e = build->e;
    const sb_mesh *surface = build->def->surface;
    int entries, most = 0, ok = 1, (*pairs)[2], *items;
    sbi_embed_lists corners;
    memset(&corners, 0, sizeof corners);
    if (!surface || build->def->normals)
        return 1;
    entries = surface->element_count * sb_element_node_count(surface->element_type);
    ok = sbi_embed_lists_make(e, surface->elements, entries, build->count, &corners);
    for (int p = 0; ok && p < build->count; p++)
        most = sbi_max_int(most, corners.starts[p + 1] - corners.starts[p]);
    pairs = (int(*)[2])sbi_embed_take(e, &ok, (size_t)most, sizeof(int[2]));
    e->rings.starts = (int *)sbi_embed_take(e, &ok, (size_t)build->count + 1, sizeof(int));
    e->rings.items = (int *)sbi_embed_take(e, &ok, (size_t)entries, 2 * sizeof(int));
    if (ok)
        sbi_embed_fill_rings(surface, &corners, pairs, &e->rings);
    sbi_free(&e->allocator, pairs);
    sbi_embed_lists_free(e, &corners);
    if (!ok) /* a surface without rings would look like no surface */
        return 0;
    items = (int *)sbi_embed_take(e, &ok, (size_t)e->rings.starts[build->count], sizeof(int));
    if (!ok)
        return 0;
    memcpy(items, e->rings.items, (size_t)e->rings.starts[build->count] * sizeof(int));
    sbi_free(&e->allocator, e->rings.items);
    e->rings.items = items;
    return 1;
}

/* ---- creation ---- */

SB_API sb_embedding_def sb_default_embedding_def(void)
{
    sb_embedding_def def;
    memset(&def, 0, sizeof def);
    def.kind = SB_EMBED_SMOOTH;
    def.max_distance = SB_REAL_MAX;
    def.cookie = SBI_EMBED_COOKIE;
    return def;
}

static sb_result sbi_embed_check_surface(const sb_embedding_def *def, sb_error *error)
{
    const sb_mesh *surface = def->surface;
    sb_result result = sbi_mesh_check_arrays(surface, error);
    if (result != SB_OK)
        return result;
    if (surface->element_type != SB_TRI3 && surface->element_type != SB_QUAD4)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.surface has %s elements; it takes tri3 or quad4",
                        sb_element_name(surface->element_type));
    if (def->points && def->point_count != surface->node_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.point_count is %d, but def.surface has %d nodes",
                        def->point_count, surface->node_count);
    if (surface->element_count > INT_MAX / 8)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.surface has more than %d elements", INT_MAX / 8);
    return SB_OK;
}

static sb_result sbi_embed_check_points(const sbi_embed_build *build, sb_error *error)
{
    for (int i = 0; i < build->count; i++)
        if (!sb_v3_is_finite(build->rest[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d has a coordinate that is not finite", i);
    for (int i = 0; build->def->normals && i < build->count; i++)
        if (!sb_v3_is_finite(build->def->normals[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "normal %d has a coordinate that is not finite", i);
    return SB_OK;
}

static sb_result sbi_embed_check_def(const sb_embedding_def *def, sbi_embed_build *build, sb_error *error)
{
    sb_result result;
    if (!def || def->cookie != SBI_EMBED_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_embedding_def");
    if (!def->mesh || (!def->points && !def->surface))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.mesh is NULL, or both def.points and def.surface");
    if (def->kind != SB_EMBED_SMOOTH && def->kind != SB_EMBED_PLAIN)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.kind is %d", (int)def->kind);
    if (!(def->max_distance >= 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_distance is %g", (double)def->max_distance);
    if (def->mesh->element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "points cannot be embedded in custom elements");
    if (def->surface && (result = sbi_embed_check_surface(def, error)) != SB_OK)
        return result;
    build->def = def;
    build->rest = def->points ? def->points : def->surface->nodes;
    build->count = def->points ? def->point_count : def->surface->node_count;
    if (build->count < 1 || build->count > INT_MAX / 16)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.point_count is %d; it takes 1 to %d", build->count,
                        INT_MAX / 16);
    result = sbi_embed_check_points(build, error);
    if (result == SB_OK)
        result = sb_mesh_validate(def->mesh, error);
    if (result == SB_OK && sb_element_dimension(def->mesh->element_type) != 3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "points are embedded in volumes, not in %s",
                        sb_element_name(def->mesh->element_type));
    return result;
}

/* Everything after the checks and the volume. */
static sb_result sbi_embed_build_all(sbi_embed_build *build, sb_error *error)
{
    sb_embedding *e = build->e;
    size_t count = (size_t)build->count;
    size_t entries = (size_t)build->def->mesh->element_count * (size_t)build->volume.width;
    int ok = 1;
    sb_result result;
    e->face = build->volume.face;
    e->elements = (int *)sbi_embed_take(e, &ok, entries, sizeof(int));
    e->points = (sb_embedded_point *)sbi_embed_take(e, &ok, count, sizeof(sb_embedded_point));
    build->order = (int *)sbi_embed_take(e, &ok, count, sizeof(int));
    build->scratch = (uint32_t *)sbi_embed_take(e, &ok, count, 3 * sizeof(uint32_t));
    build->places = (sbi_embed_place *)sbi_embed_take(e, &ok, count, sizeof(sbi_embed_place));
    if (!ok)
        return sbi_embed_no_memory(error, build->count);
    memcpy(e->elements, build->def->mesh->elements, entries * sizeof(int));
    result = sbi_embed_place_all(build, error);
    if (result == SB_OK &&
        (!sbi_embed_make_groups(build) || !sbi_embed_make_entries(build) || !sbi_embed_make_rings(build)))
        result = sbi_embed_no_memory(error, build->count);
    return result;
}

SB_API sb_result sb_embedding_create(const sb_embedding_def *def, sb_embedding **embedding, sb_error *error)
{
    sbi_embed_build build;
    sb_result result;
    memset(&build, 0, sizeof build);
    if (!embedding)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "embedding is NULL");
    result = sbi_embed_check_def(def, &build, error);
    if (result != SB_OK)
        return result;
    result = sbi_embed_volume_create(def->mesh, &def->allocator, &build.volume, error);
    if (result != SB_OK)
        return result;
    build.e = (sb_embedding *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *build.e);
    if (build.e) {
        build.e->allocator = def->allocator;
        build.e->type = def->mesh->element_type;
        result = sbi_embed_build_all(&build, error);
    } else {
        result = sbi_embed_no_memory(error, build.count);
    }
    sbi_free(&def->allocator, build.order);
    sbi_free(&def->allocator, build.scratch);
    sbi_free(&def->allocator, build.places);
    sbi_embed_volume_free(&build.volume);
    if (result == SB_OK)
        *embedding = build.e;
    else
        sb_embedding_destroy(build.e);
    return result;
}

/* ---- readings ---- */

SB_API sb_embedding_report sb_embedding_get_report(const sb_embedding *embedding)
{
    sb_embedding_report none;
    memset(&none, 0, sizeof none);
    none.farthest_point = -1;
    return embedding ? embedding->report : none;
}

SB_API sb_result sb_embedding_get_point(const sb_embedding *embedding, int index, sb_embedded_point *point)
{
    if (!embedding || !point)
        return SB_ERROR_ARGUMENT;
    if (index < 0 || index >= embedding->report.point_count)
        return SB_ERROR_INDEX;
    *point = embedding->points[index];
    return SB_OK;
}

/* Nodes and weights of one point: N_a(xi) + dN_a/dxi . step. */
static void sbi_embed_fill_row(const sb_embedding *e, const sb_embedded_point *point, int *nodes, sb_real *weights)
{
    int width = sb_element_node_count(e->type);
    sb_real shape[SB_MAX_ELEMENT_NODES], slope[SB_MAX_ELEMENT_NODES][3];
    sb_element_shape(e->type, point->xi, shape, slope);
    for (int a = 0; a < width; a++) {
        nodes[a] = e->elements[(size_t)point->element * (size_t)width + (size_t)a];
        weights[a] = shape[a] + slope[a][0] * point->step[0] + slope[a][1] * point->step[1] +
                     slope[a][2] * point->step[2];
    }
}

SB_API sb_result sb_embedding_mapping(const sb_embedding *embedding, const sb_allocator *allocator,
                                      sb_embedding_rows *rows, sb_error *error)
{
    int width, count, *starts, *nodes;
    sb_real *weights;
    size_t entries;
    if (!embedding || !rows)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the embedding or rows is NULL");
    width = sb_element_node_count(embedding->type);
    count = embedding->report.point_count;
    if (count > INT_MAX / width)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d rows of %d nodes are more than a mapping can number", count,
                        width);
    entries = (size_t)count * (size_t)width;
    starts = (int *)sbi_alloc(allocator, (size_t)count + 1, sizeof(int));
    nodes = (int *)sbi_alloc(allocator, entries, sizeof(int));
    weights = (sb_real *)sbi_alloc(allocator, entries, sizeof(sb_real));
    if (!starts || !nodes || !weights) {
        sbi_free(allocator, starts);
        sbi_free(allocator, nodes);
        sbi_free(allocator, weights);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d rows", count);
    }
    for (int i = 0; i <= count; i++)
        starts[i] = i * width;
    for (int i = 0; i < count; i++)
        sbi_embed_fill_row(embedding, &embedding->points[i], nodes + starts[i], weights + starts[i]);
    memset(rows, 0, sizeof *rows);
    if (allocator)
        rows->allocator = *allocator;
    rows->mapping.row_count = count;
    rows->mapping.row_start = rows->row_start = starts;
    rows->mapping.nodes = rows->nodes = nodes;
    rows->mapping.weights = rows->weights = weights;
    return SB_OK;
}

SB_API void sb_embedding_rows_free(sb_embedding_rows *rows)
{
    sb_allocator allocator;
    if (!rows)
        return;
    allocator = rows->allocator;
    sbi_free(&allocator, rows->row_start);
    sbi_free(&allocator, rows->nodes);
    sbi_free(&allocator, rows->weights);
    memset(rows, 0, sizeof *rows);
}
