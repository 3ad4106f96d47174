/* meshio_sets: the groups of a file's cells as sets of elements, faces and nodes of the mesh. */
#include "meshio_reader.h"

#include <limits.h>
#include <string.h>

SB_API void sb_mesh_sets_free(sb_mesh_sets *sets)
{
    if (!sets)
        return;
    for (int i = 0; i < sets->count; i++) {
        sbi_free(&sets->allocator, sets->sets[i].elements);
        sbi_free(&sets->allocator, sets->sets[i].faces);
        sbi_free(&sets->allocator, sets->sets[i].nodes);
    }
    sbi_free(&sets->allocator, sets->sets);
    memset(sets, 0, sizeof *sets);
}

SB_API const sb_mesh_set *sb_mesh_sets_find(const sb_mesh_sets *sets, const char *name, int dimension)
{
    for (int i = 0; sets && name && i < sets->count; i++)
        if ((dimension < 0 || sets->sets[i].dimension == dimension) && strcmp(sets->sets[i].name, name) == 0)
            return &sets->sets[i];
    return NULL;
}

/* A cell in a group, or (cell -1) the name of a group. */
typedef struct sbi_set_member {
    int dimension, number;
    int cell;
    int element; /* the first that the cell became */
    size_t at;   /* its nodes in loader->indices; a name: its place in loader->names */
} sbi_set_member;

typedef struct sbi_set_maker {
    const sbi_loader *loader;
    const sb_mesh *mesh;
    int dimension;    /* of the mesh */
    int face_corners; /* of a volume mesh */
    sbi_set_member *members;
    size_t count, capacity;
    int *order; /* members by dimension and number, names first, then cells as in the file */
    int *stamp; /* [nodes] last set that took the node */
    sb_mesh_sets *sets;
} sbi_set_maker;

static sb_result sbi_sets_add(sbi_set_maker *maker, const sbi_set_member *member)
{
    if (maker->count >= maker->capacity) {
        void *grown = sbi_loader_grow(maker->loader, maker->members, maker->count, &maker->capacity, maker->count + 1,
                                      sizeof maker->members[0]);
        if (!grown)
            return sbi_loader_no_memory(maker->loader);
        maker->members = (sbi_set_member *)grown;
    }
    maker->members[maker->count++] = *member;
    return SB_OK;
}

static sb_result sbi_sets_add_cell(sbi_set_maker *maker, sbi_set_member *member)
{
    const sbi_loader *loader = maker->loader;
    const sbi_cell *cell = &loader->cells[member->cell];
    const int *groups = cell->groups ? loader->groups + cell->groups : NULL;
    sb_result result = SB_OK;
    member->dimension = sbi_cell_kind_at(cell->kind)->dimension;
    for (int i = 0; groups && i < groups[0] && !result; i++) {
        member->number = groups[1 + i];
        result = sbi_sets_add(maker, member);
    }
    member->number = groups ? 0 : sbi_cell_region(loader, cell);
    return result || member->number == 0 ? result : sbi_sets_add(maker, member);
}

/* Names first: a name without a dimension counts for the mesh's. */
static sb_result sbi_sets_gather(sbi_set_maker *maker)
{
    const sbi_loader *loader = maker->loader;
    sbi_set_member member = {0, 0, -1, 0, 0};
    sb_result result = SB_OK;
    for (size_t i = 0; i < loader->name_count && !result; i++) {
        member.dimension = loader->names[i].dimension < 0 ? maker->dimension : loader->names[i].dimension;
        member.number = loader->names[i].number;
        member.at = i;
        result = sbi_sets_add(maker, &member);
    }
    member.at = 0;
    for (size_t i = 0; i < loader->cell_count && !result; i++) {
        const sbi_cell_kind *about = sbi_cell_kind_at(loader->cells[i].kind);
        member.cell = (int)i;
        result = sbi_sets_add_cell(maker, &member);
        if (about->dimension == maker->dimension)
            member.element += sbi_cell_elements(&loader->cells[i], maker->mesh->element_type);
        member.at += (size_t)about->nodes;
    }
    return result;
}

static int sbi_sets_before(const void *context, int a, int b)
{
    const sbi_set_member *m = (const sbi_set_member *)context;
    return m[a].dimension != m[b].dimension ? m[a].dimension < m[b].dimension : m[a].number < m[b].number;
}

static sb_result sbi_sets_sort(sbi_set_maker *maker)
{
    const sb_allocator *allocator = &maker->loader->allocator;
    int *scratch;
    if (maker->count > INT_MAX)
        return sbi_reader_fail(&maker->loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 cells in groups");
    scratch = (int *)sbi_alloc(allocator, maker->count, sizeof(int));
    maker->order = (int *)sbi_alloc(allocator, maker->count, sizeof(int));
    if (!scratch || !maker->order) {
        sbi_free(allocator, scratch);
        return sbi_loader_no_memory(maker->loader);
    }
    for (size_t i = 0; i < maker->count; i++)
        maker->order[i] = (int)i;
    sbi_merge_sort(maker->order, scratch, (int)maker->count, sbi_sets_before, maker->members);
    sbi_free(allocator, scratch);
    return SB_OK;
}

/* ---- one set ---- */

/* Elements that a member became; 0: it is of a lower dimension. */
static int sbi_sets_elements_of(const sbi_set_maker *maker, const sbi_set_member *member)
{
    if (member->dimension != maker->dimension)
        return 0;
    return sbi_cell_elements(&maker->loader->cells[member->cell], maker->mesh->element_type);
}

/* Triangles of the cell's corners as faces of the mesh, or 1 quadrilateral; 0: the mesh has no such faces. */
static int sbi_sets_faces_of(const sbi_set_maker *maker, const sbi_set_member *member, int corners)
{
    sb_element_type type = sbi_cell_kind_at(maker->loader->cells[member->cell].kind)->type;
    int own = sb_element_corner_count(type);
    if (member->dimension != 2 || maker->dimension != 3)
        return 0;
    if (own == corners)
        return 1;
    return own == 4 && maker->loader->split_cells ? 2 : 0;
}

static void sbi_sets_put_faces(const sbi_set_maker *maker, const sbi_set_member *member, sb_mesh_set *set)
{
    const int *nodes = maker->loader->indices + member->at;
    int parts = sbi_sets_faces_of(maker, member, set->face_corners);
    int first = parts == 2 ? sbi_split_first_corner(nodes, 4) : 0;
    for (int part = 0; part < parts; part++) {
        int *to = set->faces + (size_t)set->face_count++ * (size_t)set->face_corners;
        for (int k = 0; k < set->face_corners; k++)
            to[k] = parts == 1 ? nodes[k] : nodes[(first + (k == 0 ? 0 : part + k)) % 4];
    }
}

static int sbi_sets_node_before(const void *context, int a, int b)
{
    const int *nodes = (const int *)context;
    return nodes[a] < nodes[b];
}

/* The set's nodes, so far as they were met, ascending. */
static sb_result sbi_sets_sort_nodes(const sbi_set_maker *maker, sb_mesh_set *set)
{
    const sb_allocator *allocator = &maker->loader->allocator;
    size_t count = (size_t)set->node_count;
    int *order = (int *)sbi_alloc(allocator, count, sizeof(int)),
        *scratch = (int *)sbi_alloc(allocator, count, sizeof(int));
    sb_result result = order && scratch ? SB_OK : sbi_loader_no_memory(maker->loader);
    if (!result) {
        for (int i = 0; i < set->node_count; i++)
            order[i] = i;
        sbi_merge_sort(order, scratch, set->node_count, sbi_sets_node_before, set->nodes);
        for (size_t i = 0; i < count; i++)
            scratch[i] = set->nodes[order[i]];
        memcpy(set->nodes, scratch, count * sizeof(int));
    }
    sbi_free(allocator, order);
    sbi_free(allocator, scratch);
    return result;
}

/* Room for what the members [begin, end) of the order hold; nodes as often as cells have them, at most all. */
static sb_result sbi_sets_count(const sbi_set_maker *maker, int begin, int end, sb_mesh_set *set)
{
    int64_t nodes = 0, elements = 0, faces = 0;
    for (int i = begin; i < end; i++) {
        const sbi_set_member *member = &maker->members[maker->order[i]];
        int parts, width;
        if (member->cell < 0)
            continue;
        parts = sbi_sets_elements_of(maker, member);
        width = sbi_cell_kind_at(maker->loader->cells[member->cell].kind)->nodes + 1; /* 1: on its diagonal */
        nodes += parts ? parts * sb_element_node_count(maker->mesh->element_type) : width;
        elements += parts;
        faces += sbi_sets_faces_of(maker, member, set->face_corners);
    }
    if (elements > INT_MAX || faces > INT_MAX)
        return sbi_reader_fail(&maker->loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 faces in a group");
    set->node_count = nodes < maker->mesh->node_count ? (int)nodes : maker->mesh->node_count;
    set->element_count = (int)elements;
    set->face_count = (int)faces;
    return SB_OK;
}

static int sbi_sets_allocate(const sbi_set_maker *maker, sb_mesh_set *set)
{
    const sb_allocator *allocator = &maker->loader->allocator;
    size_t corners = (size_t)set->face_corners;
    if (set->node_count)
        set->nodes = (int *)sbi_alloc(allocator, (size_t)set->node_count, sizeof(int));
    if (set->element_count)
        set->elements = (int *)sbi_alloc(allocator, (size_t)set->element_count, sizeof(int));
    if (set->face_count)
        set->faces = (int *)sbi_alloc(allocator, (size_t)set->face_count, corners * sizeof(int));
    return (set->nodes || !set->node_count) && (set->elements || !set->element_count) &&
           (set->faces || !set->face_count);
}

static void sbi_sets_put_nodes(sbi_set_maker *maker, const int *nodes, int count, sb_mesh_set *set)
{
    int mark = maker->sets->count + 1;
    for (int k = 0; k < count; k++)
        if (maker->stamp[nodes[k]] != mark) {
            maker->stamp[nodes[k]] = mark;
            set->nodes[set->node_count++] = nodes[k];
        }
}

/* Nodes of the elements that a cell became, or of a cell of lower dimension with that on the diagonal where it was cut:
 * who holds a set shall hold every node of its elements and faces. */
static void sbi_sets_put_cell(sbi_set_maker *maker, const sbi_set_member *member, sb_mesh_set *set)
{
    const sbi_cell_kind *about = sbi_cell_kind_at(maker->loader->cells[member->cell].kind);
    const int *nodes = maker->loader->indices + member->at;
    int parts = sbi_sets_elements_of(maker, member), width = sb_element_node_count(maker->mesh->element_type);
    for (int part = 0; part < parts; part++) {
        int element = member->element + part;
        set->elements[set->element_count++] = element;
        sbi_sets_put_nodes(maker, maker->mesh->elements + (size_t)element * (size_t)width, width, set);
    }
    if (parts)
        return;
    sbi_sets_put_nodes(maker, nodes, about->nodes, set);
    if (about->type == SB_QUAD8 || about->type == SB_QUAD9) {
        int first = sbi_split_first_corner(nodes, 4);
        int middle = sbi_split_diagonal_node(maker->loader, nodes[first], nodes[(first + 2) % 4]);
        if (middle >= 0)
            sbi_sets_put_nodes(maker, &middle, 1, set);
    }
    sbi_sets_put_faces(maker, member, set);
}

/* The set of the members [begin, end) of the order; maker->sets->count counts it once its arrays may be freed. */
static sb_result sbi_sets_fill(sbi_set_maker *maker, int begin, int end)
{
    sb_mesh_set *set = &maker->sets->sets[maker->sets->count];
    const sbi_set_member *first = &maker->members[maker->order[begin]];
    sb_result result;
    set->dimension = first->dimension;
    set->number = first->number;
    if (first->cell < 0)
        memcpy(set->name, maker->loader->names[first->at].text, sizeof set->name);
    set->face_corners = first->dimension == 2 && maker->dimension == 3 ? maker->face_corners : 0;
    result = sbi_sets_count(maker, begin, end, set);
    if (!result && !sbi_sets_allocate(maker, set))
        result = sbi_loader_no_memory(maker->loader);
    set->node_count = set->element_count = set->face_count = 0;
    for (int i = begin, before = -1; i < end && !result; i++) {
        const sbi_set_member *member = &maker->members[maker->order[i]];
        if (member->cell > before) /* a cell may be in a group twice */
            sbi_sets_put_cell(maker, member, set);
        before = member->cell > before ? member->cell : before;
    }
    if (!result && set->node_count)
        result = sbi_sets_sort_nodes(maker, set);
    maker->sets->count++;
    return result;
}

/* ---- all sets ---- */

static sb_result sbi_sets_fill_all(sbi_set_maker *maker)
{
    const sb_allocator *allocator = &maker->loader->allocator;
    int count = (int)maker->count, runs = 0;
    sb_result result = SB_OK;
    for (int i = 0; i < count; i++)
        runs += i == 0 || sbi_sets_before(maker->members, maker->order[i - 1], maker->order[i]);
    maker->stamp = (int *)sbi_alloc_zeroed(allocator, (size_t)maker->mesh->node_count, sizeof(int));
    maker->sets->sets = (sb_mesh_set *)sbi_alloc_zeroed(allocator, (size_t)runs, sizeof(sb_mesh_set));
    if (!maker->stamp || !maker->sets->sets)
        return sbi_loader_no_memory(maker->loader);
    for (int begin = 0, end; begin < count && !result; begin = end) {
        end = begin + 1;
        while (end < count && !sbi_sets_before(maker->members, maker->order[begin], maker->order[end]))
            end++;
        result = sbi_sets_fill(maker, begin, end);
    }
    return result;
}

SBI_API sb_result sbi_sets_make(const sbi_loader *loader, const sb_mesh *mesh, sb_mesh_sets *sets)
{
    sbi_set_maker maker;
    sb_result result;
    memset(&maker, 0, sizeof maker);
    memset(sets, 0, sizeof *sets);
    sets->allocator = loader->allocator;
    maker.loader = loader;
    maker.mesh = mesh;
    maker.dimension = sb_element_dimension(mesh->element_type);
    maker.face_corners = sb_element_straight(mesh->element_type) == SB_TET4 ? 3 : 4;
    maker.sets = sets;
    result = sbi_sets_gather(&maker);
    if (!result && maker.count)
        result = sbi_sets_sort(&maker);
    if (!result && maker.count)
        result = sbi_sets_fill_all(&maker);
    sbi_free(&loader->allocator, maker.members);
    sbi_free(&loader->allocator, maker.order);
    sbi_free(&loader->allocator, maker.stamp);
    return result;
}
