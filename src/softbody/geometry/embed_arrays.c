/* embed_arrays: what updates read: points that share a cell in groups, faces that smooth normals need, and for each
 * node what adds to it. */
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

/* ---- memory ---- */

SBI_API int sbi_embed_grow_array(const sb_allocator *allocator, void **array, size_t used, size_t room, size_t item)
{
    void *grown = sbi_alloc(allocator, room, item);
    if (!grown)
        return 0;
    if (used)
        memcpy(grown, *array, used * item);
    sbi_free(allocator, *array);
    *array = grown;
    return 1;
}

/* Room for so many in all, exactly at first: most meshes never change. 0: there are too many. */
static int sbi_embed_new_room(int used, int more, int room, int most, int *wanted)
{
    if (more > most - used)
        return 0;
    *wanted = room == 0 ? used + more : sbi_min_int(sbi_embed_roomy(used + more), most);
    return 1;
}

static int sbi_embed_reserve_rows(const sb_allocator *allocator, sbi_embed_rows *rows, int more)
{
    int room;
    size_t used = (size_t)rows->end, width = (size_t)rows->width, wanted;
    if (more <= rows->room - rows->used)
        return 1;
    if (!sbi_embed_new_room(rows->used, more, rows->room, INT_MAX / rows->width, &room))
        return 0;
    wanted = (size_t)room;
    if (!sbi_embed_grow_array(allocator, (void **)&rows->order, used, wanted, sizeof(uint64_t)) ||
        !sbi_embed_grow_array(allocator, (void **)&rows->nodes, used * width, wanted * width, sizeof(int)) ||
        !sbi_embed_grow_array(allocator, (void **)&rows->touched, used * width, wanted * width, sizeof(int)) ||
        !sbi_embed_grow_array(allocator, (void **)&rows->next, used * width, wanted * width, sizeof(int)) ||
        !sbi_embed_grow_array(allocator, (void **)&rows->forces, 0, wanted * width, sizeof(sb_vec3)))
        return 0;
    rows->room = room;
    return 1;
}

static int sbi_embed_reserve_groups(const sb_allocator *allocator, sbi_embed_arrays *a, int more)
{
    sbi_embed_rows *rows = &a->rows[SBI_EMBED_OF_GROUPS];
    int before = rows->room;
    size_t used = (size_t)rows->end, room;
    if (!sbi_embed_reserve_rows(allocator, rows, more))
        return 0;
    room = (size_t)rows->room;
    if (rows->room == before ||
        (sbi_embed_grow_array(allocator, (void **)&a->groups, used, room, sizeof(sbi_embed_group)) &&
         sbi_embed_grow_array(allocator, (void **)&a->pulls, 0, room * (size_t)rows->width, sizeof(sb_vec3))))
        return 1;
    rows->room = before; /* what is larger than it says stays so */
    return 0;
}

static int sbi_embed_reserve_faces(const sb_allocator *allocator, sbi_embed_arrays *a, int more)
{
    sbi_embed_rows *rows = &a->rows[SBI_EMBED_OF_FACES];
    int before = rows->room;
    size_t used = (size_t)rows->end * (size_t)rows->width, room;
    if (!sbi_embed_reserve_rows(allocator, rows, more))
        return 0;
    room = (size_t)rows->room * (size_t)rows->width;
    if (rows->room == before ||
        (sbi_embed_grow_array(allocator, (void **)&a->face_weights, used, room, sizeof(sb_real)) &&
         sbi_embed_grow_array(allocator, (void **)&a->face_normals, 0, room, sizeof(sb_vec3))))
        return 1;
    rows->room = before;
    return 0;
}

static int sbi_embed_reserve_blocks(const sb_allocator *allocator, sbi_embed_arrays *a, const sbi_embed_parts *parts,
                                    int more)
{
    int room = a->block_room, grows = more > a->block_room - a->block_used, ok = 1, had_offsets = a->offsets[2] != NULL;
    size_t used = (size_t)a->block_end * SBI_EMBED_LANES, slots;
    if (grows && !sbi_embed_new_room(a->block_used, more, a->block_room, INT_MAX / SBI_EMBED_LANES, &room))
        return 0;
    slots = (size_t)room * SBI_EMBED_LANES;
    if (grows)
        ok =
            sbi_embed_grow_array(allocator, (void **)&a->block_next, (size_t)a->block_end, (size_t)room, sizeof(int)) &&
            sbi_embed_grow_array(allocator, (void **)&a->slot_point, used, slots, sizeof(int));
    for (int k = 0; k < 3; k++) {
        if (grows)
            ok = ok && sbi_embed_grow_array(allocator, (void **)&a->parameters[k], used, slots, sizeof(sb_real));
        if (parts->with_normals && grows)
            ok = ok && sbi_embed_grow_array(allocator, (void **)&a->carried[k], used, slots, sizeof(sb_real));
        if (had_offsets ? grows : parts->with_offsets) /* points that do without never read theirs */
            ok = ok && sbi_embed_grow_array(allocator, (void **)&a->offsets[k], had_offsets ? used : 0, slots,
                                            sizeof(sb_real));
    }
    for (int k = 0; k < 3 && !ok && !had_offsets; k++) { /* all or none: the first says whether they are there */
        sbi_free(allocator, a->offsets[k]);
        a->offsets[k] = NULL;
    }
    if (ok)
        a->block_room = room;
    return ok;
}

static int sbi_embed_reserve_touched(const sb_allocator *allocator, sbi_embed_arrays *a, int more)
{
    int room;
    size_t used = (size_t)a->touched_end, wanted;
    if (more <= a->touched_room - a->touched_used)
        return 1;
    if (!sbi_embed_new_room(a->touched_used, more, a->touched_room, INT_MAX, &room))
        return 0;
    wanted = (size_t)room;
    if (!sbi_embed_grow_array(allocator, (void **)&a->touched, used, wanted, sizeof(sbi_embed_touched)) ||
        !sbi_embed_grow_array(allocator, (void **)&a->normals, 0, wanted, sizeof(sb_vec3)) ||
        !sbi_embed_grow_array(allocator, (void **)&a->lengths, 0, wanted, sizeof(sb_real)) ||
        !sbi_embed_grow_array(allocator, (void **)&a->normal_pulls, 0, wanted, sizeof(sb_vec3)))
        return 0;
    a->touched_room = room;
    return 1;
}

/* Numbers that are -1 until something is there. */
static int sbi_embed_reserve_index(const sb_allocator *allocator, int **index, int *room, int needed)
{
    size_t used = (size_t)*room;
    int wanted = *room == 0 ? needed : sbi_embed_roomy(needed);
    if (needed <= *room)
        return 1;
    if (!sbi_embed_grow_array(allocator, (void **)index, used, (size_t)wanted, sizeof(int)))
        return 0;
    memset(*index + used, 0xff, ((size_t)wanted - used) * sizeof(int));
    *room = wanted;
    return 1;
}

SBI_API int sbi_embed_arrays_reserve(const sb_allocator *allocator, sbi_embed_arrays *a, const sbi_embed_parts *parts,
                                     const sbi_embed_more *more)
{
    return sbi_embed_reserve_groups(allocator, a, more->groups) &&
           sbi_embed_reserve_blocks(allocator, a, parts, more->blocks) &&
           sbi_embed_reserve_faces(allocator, a, more->faces) &&
           sbi_embed_reserve_touched(allocator, a, more->touched) &&
           sbi_embed_reserve_index(allocator, &a->element_groups, &a->element_room, parts->element_count) &&
           sbi_embed_reserve_index(allocator, &a->touched_of, &a->node_room, parts->node_count);
}

static void sbi_embed_rows_free(const sb_allocator *allocator, sbi_embed_rows *rows)
{
    sbi_free(allocator, rows->order);
    sbi_free(allocator, rows->nodes);
    sbi_free(allocator, rows->touched);
    sbi_free(allocator, rows->next);
    sbi_free(allocator, rows->forces);
}

SBI_API void sbi_embed_arrays_free(const sb_allocator *allocator, sbi_embed_arrays *a)
{
    for (int k = 0; k < 3; k++) {
        sbi_free(allocator, a->parameters[k]);
        sbi_free(allocator, a->offsets[k]);
        sbi_free(allocator, a->carried[k]);
    }
    for (int kind = 0; kind < SBI_EMBED_KINDS; kind++)
        sbi_embed_rows_free(allocator, &a->rows[kind]);
    sbi_free(allocator, a->block_next);
    sbi_free(allocator, a->slot_point);
    sbi_free(allocator, a->groups);
    sbi_free(allocator, a->element_groups);
    sbi_free(allocator, a->pulls);
    sbi_free(allocator, a->face_weights);
    sbi_free(allocator, a->face_normals);
    sbi_free(allocator, a->touched);
    sbi_free(allocator, a->normals);
    sbi_free(allocator, a->lengths);
    sbi_free(allocator, a->normal_pulls);
    sbi_free(allocator, a->touched_of);
    memset(a, 0, sizeof *a);
}

/* ---- entries of nodes ---- */

static sbi_embed_touched *sbi_embed_touch(sbi_embed_arrays *a, int node, int *index)
{
    sbi_embed_touched *t;
    *index = a->touched_of[node];
    if (*index >= 0)
        return &a->touched[*index];
    *index = a->touched_free >= 0 ? a->touched_free : a->touched_end++;
    t = &a->touched[*index];
    if (*index == a->touched_free)
        a->touched_free = t->first[0];
    a->touched_used++;
    a->touched_of[node] = *index;
    memset(t, 0, sizeof *t);
    t->node = node;
    for (int kind = 0; kind < SBI_EMBED_KINDS; kind++)
        t->first[kind] = t->last[kind] = -1;
    return t;
}

/* Puts an entry into the list of its node. */
static void sbi_embed_link(sbi_embed_arrays *a, int kind, int entry, int node)
{
    sbi_embed_rows *rows = &a->rows[kind];
    sbi_embed_touched *t = sbi_embed_touch(a, node, &rows->touched[entry]);
    uint64_t order = rows->order[entry / rows->width];
    int last = t->last[kind], *at = &t->first[kind];
    rows->nodes[entry] = node;
    if (last >= 0 && rows->order[last / rows->width] < order)
        at = &rows->next[last];
    while (*at >= 0 && rows->order[*at / rows->width] < order)
        at = &rows->next[*at];
    rows->next[entry] = *at;
    *at = entry;
    if (rows->next[entry] < 0)
        t->last[kind] = entry;
}

static void sbi_embed_unlink(sbi_embed_arrays *a, int kind, int entry)
{
    sbi_embed_rows *rows = &a->rows[kind];
    int index = rows->touched[entry], before = -1;
    sbi_embed_touched *t = &a->touched[index];
    for (int at = t->first[kind]; at != entry; at = rows->next[at])
        before = at;
    *(before < 0 ? &t->first[kind] : &rows->next[before]) = rows->next[entry];
    if (t->last[kind] == entry)
        t->last[kind] = before;
    if (t->first[SBI_EMBED_OF_GROUPS] >= 0 || t->first[SBI_EMBED_OF_FACES] >= 0)
        return;
    a->touched_of[t->node] = -1;
    t->node = -1;
    t->first[0] = a->touched_free;
    a->touched_free = index;
    a->touched_used--;
}

static int sbi_embed_take_row(sbi_embed_rows *rows, uint64_t order)
{
    int row = rows->free_first >= 0 ? rows->free_first : rows->end++;
    if (row == rows->free_first)
        rows->free_first = rows->next[row * rows->width];
    rows->used++;
    rows->order[row] = order;
    return row;
}

static void sbi_embed_give_row(sbi_embed_rows *rows, int row)
{
    rows->nodes[row * rows->width] = -1;
    rows->next[row * rows->width] = rows->free_first;
    rows->free_first = row;
    rows->used--;
}

/* ---- groups ---- */

SBI_API int sbi_embed_cell_nodes(const sbi_embed_parts *parts, sb_embedding_hold hold, int cell,
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

SBI_API int sbi_embed_list_points(const sbi_embed_arrays *a, const sbi_embed_group *group, int *points)
{
    int listed = 0;
    for (int block = group->first_block; block >= 0; block = a->block_next[block])
        for (int l = 0; l < SBI_EMBED_LANES && listed < group->count; l++)
            points[listed++] = a->slot_point[block * SBI_EMBED_LANES + l];
    return listed;
}

static void sbi_embed_fill_slot(sbi_embed_arrays *a, int slot, int point, const sbi_embed_place *place)
{
    a->slot_point[slot] = point;
    for (int k = 0; k < 3; k++) {
        a->parameters[k][slot] = place->parameters[k];
        if (a->offsets[0])
            a->offsets[k][slot] = place->offset[k];
        if (a->carried[0])
            a->carried[k][slot] = place->carried[k];
    }
}

static void sbi_embed_fill_blocks(sbi_embed_arrays *a, const sbi_embed_parts *parts, const int *points,
                                  sbi_embed_group *group)
{
    int *link = &group->first_block;
    for (int first = 0; first < group->count; first += SBI_EMBED_LANES) {
        int block = a->block_free >= 0 ? a->block_free : a->block_end++;
        if (block == a->block_free)
            a->block_free = a->block_next[block];
        a->block_used++;
        for (int l = 0; l < SBI_EMBED_LANES; l++) {
            int point = points[sbi_min_int(first + l, group->count - 1)];
            sbi_embed_fill_slot(a, block * SBI_EMBED_LANES + l, point, &parts->places[point]);
        }
        *link = block;
        link = &a->block_next[block];
    }
    *link = -1;
}

/* How many points from the first on have its hold and cell. */
static int sbi_embed_count_alike(const sbi_embed_parts *parts, const int *points, int count)
{
    const sbi_embed_place *first = &parts->places[points[0]];
    int alike = 1;
    while (alike < count && parts->places[points[alike]].hold == first->hold &&
           parts->places[points[alike]].cell == first->cell)
        alike++;
    return alike;
}

/* chunk: the how many-th group of its hold and cell. */
static void sbi_embed_add_group(sbi_embed_arrays *a, const sbi_embed_parts *parts, const int *points, int count,
                                int chunk)
{
    const sbi_embed_place *place = &parts->places[points[0]];
    sbi_embed_rows *rows = &a->rows[SBI_EMBED_OF_GROUPS];
    uint64_t order = (uint64_t)place->hold << 56 | (uint64_t)place->cell << 24 | (uint64_t)chunk;
    int row = sbi_embed_take_row(rows, order), nodes[SB_MAX_ELEMENT_NODES];
    int *link = &a->element_groups[sbi_embed_is_on_face(place->hold) ? place->cell / parts->faces : place->cell];
    sbi_embed_group *group = &a->groups[row];
    group->hold = place->hold;
    group->cell = place->cell;
    group->count = count;
    group->next = *link;
    *link = row;
    sbi_embed_fill_blocks(a, parts, points, group);
    group->node_count = sbi_embed_cell_nodes(parts, place->hold, place->cell, nodes);
    for (int i = 0; i < group->node_count; i++) {
        int entry = row * rows->width + i;
        sbi_embed_link(a, SBI_EMBED_OF_GROUPS, entry, nodes[i]);
        a->touched[rows->touched[entry]].normal_users += place->hold == SB_EMBEDDED_OFFSET;
    }
}

SBI_API void sbi_embed_add_groups(sbi_embed_arrays *a, const sbi_embed_parts *parts, const int *points, int count)
{
    for (int i = 0; i < count;) {
        int end = i + sbi_embed_count_alike(parts, points + i, count - i);
        for (int chunk = 0; i < end; chunk++) {
            int size = sbi_min_int(end - i, SBI_EMBED_GROUP);
            sbi_embed_add_group(a, parts, points + i, size, chunk);
            i += size;
        }
    }
}

SBI_API void sbi_embed_drop_group(sbi_embed_arrays *a, int *link)
{
    sbi_embed_rows *rows = &a->rows[SBI_EMBED_OF_GROUPS];
    int row = *link;
    sbi_embed_group *group = &a->groups[row];
    for (int i = 0; i < group->node_count; i++) {
        int entry = row * rows->width + i;
        a->touched[rows->touched[entry]].normal_users -= group->hold == SB_EMBEDDED_OFFSET;
        sbi_embed_unlink(a, SBI_EMBED_OF_GROUPS, entry);
    }
    for (int block = group->first_block, next; block >= 0; block = next) {
        next = a->block_next[block];
        a->block_next[block] = a->block_free;
        a->block_free = block;
        a->block_used--;
    }
    *link = group->next;
    group->count = 0;
    sbi_embed_give_row(rows, row);
}

/* ---- faces ---- */

SBI_API void sbi_embed_add_face(sbi_embed_arrays *a, const sbi_embed_parts *parts, int face)
{
    sbi_embed_rows *rows = &a->rows[SBI_EMBED_OF_FACES];
    int nodes[SB_MAX_ELEMENT_NODES], row, wanted = 0;
    size_t width = (size_t)parts->face->nodes;
    if (parts->outer[face] < 0)
        return;
    sbi_embed_cell_nodes(parts, SB_EMBEDDED_OFFSET, face, nodes);
    for (int i = 0; i < rows->width && !wanted; i++)
        wanted = a->touched_of[nodes[i]] >= 0 && a->touched[a->touched_of[nodes[i]]].normal_users > 0;
    if (!wanted)
        return;
    row = sbi_embed_take_row(rows, (uint64_t)face);
    memcpy(a->face_weights + (size_t)row * width, parts->weights + (size_t)parts->outer[face] * width,
           width * sizeof(sb_real));
    for (int i = 0; i < rows->width; i++)
        sbi_embed_link(a, SBI_EMBED_OF_FACES, row * rows->width + i, nodes[i]);
}

SBI_API void sbi_embed_drop_faces(sbi_embed_arrays *a, int node)
{
    sbi_embed_rows *rows = &a->rows[SBI_EMBED_OF_FACES];
    while (node < a->node_room && a->touched_of[node] >= 0) {
        int entry = a->touched[a->touched_of[node]].first[SBI_EMBED_OF_FACES], row = entry / rows->width;
        if (entry < 0)
            return;
        for (int i = 0; i < rows->width; i++)
            sbi_embed_unlink(a, SBI_EMBED_OF_FACES, row * rows->width + i);
        sbi_embed_give_row(rows, row);
    }
}

/* ---- all points ---- */

SBI_API void sbi_embed_fill_local(sb_element_type type, int local[6][SB_MAX_FACE_NODES])
{
    for (int f = 0; f < sb_element_face_count(type); f++)
        sb_element_face(type, f, local[f], NULL);
}

/* Sorts points by hold, then cell, then as in order; items[count] is scratch. */
static int sbi_embed_sort_places(const sb_allocator *allocator, const sbi_embed_parts *parts, const int *order,
                                 int count, int *items, int *sorted)
{
    int hold_starts[5] = {0, 0, 0, 0, 0};
    size_t rows = (size_t)parts->element_count * (size_t)parts->faces;
    int *starts = (int *)sbi_alloc_zeroed(allocator, rows + 1, sizeof(int));
    if (!starts)
        return 0;
    for (int i = 0; i < count; i++) {
        starts[parts->places[i].cell + 1]++;
        hold_starts[(int)parts->places[i].hold + 1]++;
    }
    for (size_t r = 0; r < rows; r++)
        starts[r + 1] += starts[r];
    for (int h = 0; h < 4; h++)
        hold_starts[h + 1] += hold_starts[h];
    for (int i = 0; i < count; i++)
        items[starts[parts->places[order[i]].cell]++] = order[i];
    for (int i = 0; i < count; i++)
        sorted[hold_starts[(int)parts->places[items[i]].hold]++] = items[i];
    sbi_free(allocator, starts);
    return 1;
}

enum { SBI_EMBED_IS_TOUCHED = 1, SBI_EMBED_HAS_NORMAL = 2 };

static void sbi_embed_mark_nodes(const int *nodes, int count, int mark, unsigned char *marks, int *touched)
{
    for (int i = 0; i < count; i++) {
        *touched += !marks[nodes[i]];
        marks[nodes[i]] |= (unsigned char)mark;
    }
}

/* What the sorted points need. 0: too many, or no memory. */
static int sbi_embed_count_all(const sb_allocator *allocator, const sbi_embed_parts *parts, const int *sorted,
                               int count, sbi_embed_more *more)
{
    unsigned char *marks = (unsigned char *)sbi_alloc_zeroed(allocator, (size_t)parts->node_count, 1);
    int nodes[SB_MAX_ELEMENT_NODES], rows = parts->element_count * parts->faces;
    memset(more, 0, sizeof *more);
    if (!marks)
        return 0;
    for (int i = 0, alike; i < count; i += alike) {
        const sbi_embed_place *place = &parts->places[sorted[i]];
        int corners = sbi_embed_cell_nodes(parts, place->hold, place->cell, nodes);
        int mark =
            place->hold == SB_EMBEDDED_OFFSET ? SBI_EMBED_IS_TOUCHED | SBI_EMBED_HAS_NORMAL : SBI_EMBED_IS_TOUCHED;
        alike = sbi_embed_count_alike(parts, sorted + i, count - i);
        more->groups += sbi_embed_tasks(alike, SBI_EMBED_GROUP);
        more->blocks += sbi_embed_tasks(alike, SBI_EMBED_LANES); /* a group is whole blocks */
        sbi_embed_mark_nodes(nodes, corners, mark, marks, &more->touched);
    }
    for (int f = 0; f < rows; f++) {
        int wanted = 0;
        if (parts->outer[f] < 0)
            continue;
        sbi_embed_cell_nodes(parts, SB_EMBEDDED_OFFSET, f, nodes);
        for (int i = 0; i < parts->face->nodes; i++)
            wanted |= marks[nodes[i]] & SBI_EMBED_HAS_NORMAL;
        more->faces += wanted != 0;
        if (wanted)
            sbi_embed_mark_nodes(nodes, parts->face->nodes, SBI_EMBED_IS_TOUCHED, marks, &more->touched);
    }
    sbi_free(allocator, marks);
    return 1;
}

SBI_API int sbi_embed_arrays_fill(const sb_allocator *allocator, sbi_embed_arrays *a, const sbi_embed_parts *parts,
                                  const int *order, int count)
{
    int *sorted = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    int *items = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    sbi_embed_more more;
    int ok = sorted && items && sbi_embed_sort_places(allocator, parts, order, count, items, sorted) &&
             sbi_embed_count_all(allocator, parts, sorted, count, &more);
    a->rows[SBI_EMBED_OF_GROUPS].width = parts->width;
    a->rows[SBI_EMBED_OF_FACES].width = parts->face->nodes;
    a->rows[SBI_EMBED_OF_GROUPS].free_first = a->rows[SBI_EMBED_OF_FACES].free_first = -1;
    a->block_free = a->touched_free = -1;
    ok = ok && sbi_embed_arrays_reserve(allocator, a, parts, &more);
    if (ok) {
        sbi_embed_add_groups(a, parts, sorted, count);
        for (int f = 0; f < parts->element_count * parts->faces && more.faces > 0; f++)
            sbi_embed_add_face(a, parts, f);
    }
    sbi_free(allocator, items);
    sbi_free(allocator, sorted);
    return ok;
}
