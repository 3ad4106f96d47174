/* embed_arrays: what updates read: points that share a cell in groups, smooth normals, nodes and who adds to them. */
#include "embed_private.h"

SBI_API void *sbi_embed_take(const sb_embedding *e, int *ok, size_t count, size_t size)
{
    void *pointer = *ok ? sbi_alloc(&e->allocator, count, size) : NULL;
    if (!pointer)
        *ok = 0;
    return pointer;
}

SBI_API int sbi_embed_lists_make(const sb_embedding *e, const int *keys, int count, int rows, sbi_embed_lists *lists)
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

SBI_API void sbi_embed_lists_free(const sb_embedding *e, sbi_embed_lists *lists)
{
    sbi_free(&e->allocator, lists->starts);
    sbi_free(&e->allocator, lists->items);
    memset(lists, 0, sizeof *lists);
}
/* An update's arrays under way. */
typedef struct sbi_embed_filling {
    sb_embedding *e;
    const sbi_embed_parts *parts;
    int *sorted; /* [parts->count] points by hold, then cell, then as in parts->order */
} sbi_embed_filling;

/* Fills sorted; items[parts->count] is scratch. */
static int sbi_embed_sort_places(const sbi_embed_filling *build, int *items)
{
    const sbi_embed_parts *parts = build->parts;
    int hold_starts[5] = {0, 0, 0, 0, 0}, ok = 1;
    size_t rows = (size_t)parts->element_count * (size_t)parts->faces;
    int *starts = (int *)sbi_embed_take(build->e, &ok, rows + 1, sizeof(int));
    if (!ok)
        return 0;
    memset(starts, 0, (rows + 1) * sizeof(int));
    for (int i = 0; i < parts->count; i++) {
        starts[parts->places[i].cell + 1]++;
        hold_starts[(int)parts->places[i].hold + 1]++;
    }
    for (size_t r = 0; r < rows; r++)
        starts[r + 1] += starts[r];
    for (int h = 0; h < 4; h++)
        hold_starts[h + 1] += hold_starts[h];
    for (int i = 0; i < parts->count; i++)
        items[starts[parts->places[parts->order[i]].cell]++] = parts->order[i];
    for (int i = 0; i < parts->count; i++)
        build->sorted[hold_starts[(int)parts->places[items[i]].hold]++] = items[i];
    sbi_free(&build->e->allocator, starts);
    return 1;
}

/* One more group from place i of the order on; returns where the next one starts. */
static int sbi_embed_next_group(const sbi_embed_filling *build, int i, sbi_embed_group *group)
{
    const sbi_embed_place *first = &build->parts->places[build->sorted[i]];
    int end = i + 1;
    while (end < build->parts->count && end - i < SBI_EMBED_GROUP &&
           build->parts->places[build->sorted[end]].hold == first->hold &&
           build->parts->places[build->sorted[end]].cell == first->cell)
        end++;
    group->hold = first->hold;
    group->count = end - i;
    group->node_count = sbi_embed_is_on_face(first->hold) ? build->e->face.nodes : build->parts->width;
    return end;
}

/* Nodes of a place's element or face; returns how many. */
static int sbi_embed_cell_nodes(const sbi_embed_parts *parts, sb_embedding_hold hold, int cell,
                                int nodes[SB_MAX_ELEMENT_NODES])
{
    int on_face = sbi_embed_is_on_face(hold), element = on_face ? cell / parts->faces : cell;
    int count = on_face ? parts->face->nodes : parts->width;
    const int *row = parts->elements + (size_t)element * (size_t)parts->width;
    const int *local = parts->local[on_face ? cell % parts->faces : 0];
    for (int a = 0; a < count; a++)
        nodes[a] = row[on_face ? local[a] : a];
    return count;
}

/* Counts groups, slots and node entries; 0 when they do not fit an int. */
static int sbi_embed_count_groups(const sbi_embed_filling *build)
{
    sb_embedding *e = build->e;
    long long slots = 0, entries = 0;
    for (int i = 0; i < build->parts->count;) {
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
static void sbi_embed_fill_slots(const sbi_embed_filling *build, const sbi_embed_group *group, int from)
{
    sb_embedding *e = build->e;
    int padded = sbi_embed_tasks(group->count, SBI_EMBED_LANES) * SBI_EMBED_LANES;
    for (int s = 0; s < padded; s++) {
        int point = build->sorted[from + sbi_min_int(s, group->count - 1)], slot = group->first + s;
        e->slot_point[slot] = point;
        for (int k = 0; k < 3; k++) {
            e->parameters[k][slot] = build->parts->places[point].parameters[k];
            if (e->offsets[0])
                e->offsets[k][slot] = build->parts->places[point].offset[k];
            if (e->carried[0])
                e->carried[k][slot] = build->parts->places[point].carried[k];
        }
    }
}

static int sbi_embed_allocate_groups(const sbi_embed_filling *build)
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
        if (build->parts->with_normals)
            e->carried[k] = (sb_real *)sbi_embed_take(e, &ok, slots, sizeof(sb_real));
    }
    return ok;
}

/* groups, slots and tasks, from the order by hold and cell. */
static int sbi_embed_make_groups(const sbi_embed_filling *build)
{
    sb_embedding *e = build->e;
    int slot = 0, entry = 0, task = 0;
    if (!sbi_embed_count_groups(build) || !sbi_embed_allocate_groups(build))
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

/* ---- smooth normals and node entries ---- */

/* Numbers the nodes that need smooth normals (ids: -1 or the number, by mesh node) and lists the boundary faces around
 * them in faces, as element * faces + local face. */
static void sbi_embed_pick_normals(const sbi_embed_filling *build, int *ids, int *faces)
{
    const sbi_embed_parts *parts = build->parts;
    sb_embedding *e = build->e;
    int nodes[SB_MAX_ELEMENT_NODES], rows = parts->element_count * parts->faces;
    memset(ids, 0xff, (size_t)parts->node_count * sizeof(int));
    for (int i = 0; i < parts->count; i++) {
        if (parts->places[i].hold != SB_EMBEDDED_OFFSET)
            continue;
        sbi_embed_cell_nodes(parts, SB_EMBEDDED_OFFSET, parts->places[i].cell, nodes);
        for (int a = 0; a < parts->face->nodes; a++)
            if (ids[nodes[a]] < 0)
                ids[nodes[a]] = e->normal_count++;
    }
    for (int f = 0; f < rows && e->normal_count > 0; f++) {
        int wanted = 0;
        if (parts->outer[f] < 0)
            continue;
        sbi_embed_cell_nodes(parts, SB_EMBEDDED_OFFSET, f, nodes);
        for (int a = 0; a < parts->face->nodes; a++)
            wanted |= ids[nodes[a]] >= 0;
        if (wanted)
            faces[e->face_count++] = f;
    }
}

/* Fills nodes and normal_of of all entries, and the weights of the faces. */
static void sbi_embed_fill_entries(const sbi_embed_filling *build, const int *ids, const int *faces)
{
    const sbi_embed_parts *parts = build->parts;
    sb_embedding *e = build->e;
    int nodes[SB_MAX_ELEMENT_NODES];
    size_t width = (size_t)parts->face->nodes;
    for (int g = 0; g < e->group_count; g++) {
        const sbi_embed_group *group = &e->groups[g];
        sbi_embed_cell_nodes(parts, group->hold, parts->places[e->slot_point[group->first]].cell, nodes);
        for (int a = 0; a < group->node_count; a++) {
            e->nodes[group->node_first + a] = nodes[a];
            e->normal_of[group->node_first + a] = group->hold == SB_EMBEDDED_OFFSET ? ids[nodes[a]] : -1;
        }
    }
    for (int f = 0; f < e->face_count; f++) {
        size_t first = (size_t)f * width, entry = (size_t)e->group_entries + first;
        sbi_embed_cell_nodes(parts, SB_EMBEDDED_OFFSET, faces[f], nodes);
        memcpy(e->weights + first, parts->weights + (size_t)parts->outer[faces[f]] * width, sizeof(sb_real) * width);
        for (size_t a = 0; a < width; a++) {
            e->nodes[entry + a] = nodes[a];
            e->normal_of[entry + a] = ids[nodes[a]];
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

static int sbi_embed_make_entries(const sbi_embed_filling *build)
{
    sb_embedding *e = build->e;
    int ok = 1, node_count = build->parts->node_count, *rows = NULL;
    int *ids = (int *)sbi_embed_take(e, &ok, (size_t)node_count, sizeof(int));
    int *faces = (int *)sbi_embed_take(e, &ok, (size_t)build->parts->outer_count, sizeof(int));
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

SBI_API void sbi_embed_fill_local(sb_element_type type, int local[6][SB_MAX_FACE_NODES])
{
    for (int f = 0; f < sb_element_face_count(type); f++)
        sb_element_face(type, f, local[f], NULL);
}

SBI_API int sbi_embed_make_arrays(sb_embedding *e, const sbi_embed_parts *parts)
{
    sbi_embed_filling build;
    int ok = 1, *items;
    build.e = e;
    build.parts = parts;
    build.sorted = (int *)sbi_embed_take(e, &ok, (size_t)parts->count, sizeof(int));
    items = (int *)sbi_embed_take(e, &ok, (size_t)parts->count, sizeof(int));
    ok = ok && sbi_embed_sort_places(&build, items) && sbi_embed_make_groups(&build) && sbi_embed_make_entries(&build);
    sbi_free(&e->allocator, items);
    sbi_free(&e->allocator, build.sorted);
    return ok;
}

SBI_API void sbi_embed_free_arrays(sb_embedding *e)
{
    const sb_allocator allocator = e->allocator;
    for (int k = 0; k < 3; k++) {
        sbi_free(&allocator, e->parameters[k]);
        sbi_free(&allocator, e->offsets[k]);
        sbi_free(&allocator, e->carried[k]);
    }
    sbi_embed_lists_free(e, &e->normal_faces);
    sbi_embed_lists_free(e, &e->normal_groups);
    sbi_embed_lists_free(e, &e->touched);
    sbi_free(&allocator, e->groups);
    sbi_free(&allocator, e->tasks);
    sbi_free(&allocator, e->slot_point);
    sbi_free(&allocator, e->nodes);
    sbi_free(&allocator, e->normal_of);
    sbi_free(&allocator, e->weights);
    sbi_free(&allocator, e->touched_nodes);
    sbi_free(&allocator, e->face_normals);
    sbi_free(&allocator, e->normals);
    sbi_free(&allocator, e->lengths);
    sbi_free(&allocator, e->entry_forces);
    sbi_free(&allocator, e->entry_pulls);
    sbi_free(&allocator, e->normal_pulls);
}
