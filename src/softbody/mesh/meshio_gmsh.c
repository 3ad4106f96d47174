/* meshio_gmsh: reads gmsh meshes, versions 1, 2.x, 3, 4.0 and 4.1, ASCII and binary of either byte order.
 * Source of the format: Gmsh Reference Manual, "MSH file format" and "Legacy formats"; version 3, which the manual does
 * not have, as gmsh 4.8 writes it.
 *
 * | version | an element's line                                             | physical groups                  |
 * |---------|---------------------------------------------------------------|----------------------------------|
 * | 1       | number, type, physical, elementary, count, nodes              | of the element; no names         |
 * | 2       | number, type, count of tags, physical, elementary ..., nodes  | of the element                   |
 * | 3       | number, type, entity, count, nodes and other data             | of the entity                    |
 * | 4       | blocks of one entity and type: number, nodes                  | of the entity                    | */
#include "meshio_reader.h"

#include <limits.h>
#include <string.h>

/* The physical groups of a geometric entity (3 and 4). */
typedef struct sbi_gmsh_entity {
    int64_t dimension, tag;
    int region; /* the first group */
    int groups; /* list of all, see sbi_loader_add_groups */
} sbi_gmsh_entity;

typedef struct sbi_gmsh {
    sbi_loader *loader;
    sbi_reader *reader;
    int version;            /* 10, 20, 30, 40 or 41; 0: not known yet */
    int binary, size_bytes; /* bytes of a size_t in binary files */
    int has_nodes, has_elements;
    int64_t *tags; /* [nodes] number of each node in the file, any order and gaps */
    size_t tag_capacity;
    int *order; /* [nodes] nodes by ascending tag */
    sbi_gmsh_entity *entities;
    size_t entity_count, entity_capacity;
    int *entity_order; /* [entities] ascending by dimension and tag */
    int *numbers;      /* groups of the entity being read */
    size_t number_capacity;
} sbi_gmsh;

/* ---- values: the same code reads text and binary ---- */

static sb_result sbi_gmsh_integer(sbi_gmsh *gmsh, const char *what, int64_t *value)
{
    const unsigned char *bytes;
    if (!gmsh->binary)
        return sbi_reader_integer(gmsh->reader, what, value);
    bytes = sbi_reader_bytes(gmsh->reader, 1, 4, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    *value = sbi_decode_signed(gmsh->reader, bytes, 4);
    return SB_OK;
}

/* A count of version 4, or the tag of a node or element in 4.1. */
static sb_result sbi_gmsh_size(sbi_gmsh *gmsh, const char *what, int64_t *value)
{
    const unsigned char *bytes;
    uint64_t bits;
    if (!gmsh->binary)
        return sbi_reader_integer(gmsh->reader, what, value);
    bytes = sbi_reader_bytes(gmsh->reader, 1, (size_t)gmsh->size_bytes, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    bits = sbi_decode_bits(gmsh->reader, bytes, gmsh->size_bytes);
    if (bits > (uint64_t)INT64_MAX)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "%s is too large", what);
    *value = (int64_t)bits;
    return SB_OK;
}

/* The tag of a node or element: a size_t in 4.1, an int before. */
static sb_result sbi_gmsh_tag(sbi_gmsh *gmsh, const char *what, int64_t *value)
{
    return gmsh->version == 41 ? sbi_gmsh_size(gmsh, what, value) : sbi_gmsh_integer(gmsh, what, value);
}

static int sbi_gmsh_tag_bytes(const sbi_gmsh *gmsh) { return gmsh->version == 41 ? gmsh->size_bytes : 4; }

/* A count of things that take at least `bytes` bytes in a binary file, and two per number in a text. */
static sb_result sbi_gmsh_count(sbi_gmsh *gmsh, const char *what, size_t bytes, size_t numbers, int *count)
{
    int64_t value = 0;
    sb_result result = sbi_gmsh_size(gmsh, what, &value);
    return result ? result
                  : sbi_reader_check_count(gmsh->reader, what, value, gmsh->binary ? bytes : 2 * numbers, count);
}

static sb_result sbi_gmsh_skip_reals(sbi_gmsh *gmsh, size_t count)
{
    if (!gmsh->binary)
        return sbi_reader_skip_words(gmsh->reader, count, "coordinates");
    return sbi_reader_bytes(gmsh->reader, count, 8, "coordinates") ? SB_OK : SB_ERROR_FORMAT;
}

static sb_result sbi_gmsh_node(sbi_gmsh *gmsh)
{
    const unsigned char *bytes;
    double x[3];
    if (!gmsh->binary)
        return sbi_loader_read_node(gmsh->loader);
    gmsh->reader->node = (int)gmsh->loader->node_count;
    bytes = sbi_reader_bytes(gmsh->reader, 3, 8, "coordinates");
    if (!bytes)
        return SB_ERROR_FORMAT;
    for (int i = 0; i < 3; i++)
        x[i] = sbi_decode_float(gmsh->reader, bytes + 8 * i, 8);
    return sbi_loader_add_node(gmsh->loader, x);
}

/* Physical groups become regions; gmsh gives a minus sign to groups of reversed orientation. */
static sb_result sbi_gmsh_region(const sbi_gmsh *gmsh, int64_t physical, int *region)
{
    if (physical > INT_MAX || physical < -INT_MAX)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "physical group %lld is too large", (long long)physical);
    *region = (int)(physical < 0 ? -physical : physical);
    return SB_OK;
}

/* ---- node numbers ---- */

static int sbi_gmsh_tag_before(const void *context, int a, int b)
{
    const int64_t *tags = (const int64_t *)context;
    return tags[a] < tags[b];
}

/* Room for the tags of `count` more nodes and for their coordinates. */
static sb_result sbi_gmsh_reserve_nodes(sbi_gmsh *gmsh, int count)
{
    size_t used = gmsh->loader->node_count, needed = used + (size_t)count;
    if (needed > gmsh->tag_capacity) {
        void *grown = sbi_loader_grow(gmsh->loader, gmsh->tags, used, &gmsh->tag_capacity, needed, sizeof(int64_t));
        if (!grown)
            return sbi_loader_no_memory(gmsh->loader);
        gmsh->tags = (int64_t *)grown;
    }
    return sbi_loader_reserve_nodes(gmsh->loader, count);
}

/* Sorts the tags for sbi_gmsh_find_node; two equal ones are an error. */
static sb_result sbi_gmsh_sort_tags(sbi_gmsh *gmsh)
{
    int count = (int)gmsh->loader->node_count;
    const sb_allocator *allocator = &gmsh->loader->allocator;
    int *scratch = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    gmsh->order = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    if (!scratch || !gmsh->order) {
        sbi_free(allocator, scratch);
        return sbi_loader_no_memory(gmsh->loader);
    }
    for (int i = 0; i < count; i++)
        gmsh->order[i] = i;
    sbi_merge_sort(gmsh->order, scratch, count, sbi_gmsh_tag_before, gmsh->tags);
    sbi_free(allocator, scratch);
    for (int i = 1; i < count; i++) {
        if (gmsh->tags[gmsh->order[i]] != gmsh->tags[gmsh->order[i - 1]])
            continue;
        gmsh->reader->node = gmsh->order[i];
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "two nodes have the number %lld",
                               (long long)gmsh->tags[gmsh->order[i]]);
    }
    return SB_OK;
}

/* Node with the tag, or -1. */
static int sbi_gmsh_find_node(const sbi_gmsh *gmsh, int64_t tag)
{
    int low = 0, high = (int)gmsh->loader->node_count - 1;
    int64_t first = gmsh->tags[gmsh->order[0]], last = gmsh->tags[gmsh->order[high]];
    if (tag < first || tag > last)
        return -1;
    if (last - first == high) /* no gaps */
        return gmsh->order[tag - first];
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (gmsh->tags[gmsh->order[middle]] < tag)
            low = middle + 1;
        else
            high = middle;
    }
    return gmsh->tags[gmsh->order[low]] == tag ? gmsh->order[low] : -1;
}

static sb_result sbi_gmsh_cell_node(sbi_gmsh *gmsh, int64_t tag)
{
    int node = sbi_gmsh_find_node(gmsh, tag);
    if (node < 0)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_INDEX,
                               "element %d refers to node number %lld, which does not exist", gmsh->reader->element,
                               (long long)tag);
    return sbi_loader_cell_node(gmsh->loader, node, 0);
}

/* ---- nodes ---- */

static sb_result sbi_gmsh_node_tag(sbi_gmsh *gmsh, int node)
{
    sb_result result;
    gmsh->reader->node = node;
    result = sbi_gmsh_tag(gmsh, "node number", &gmsh->tags[node]);
    if (!result && gmsh->tags[node] < 0)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a negative node number: %lld",
                               (long long)gmsh->tags[node]);
    return result;
}

/* 3: the entity of a node, and where that is not 0 its dimension and as many parameters. */
static sb_result sbi_gmsh_skip_parameters(sbi_gmsh *gmsh)
{
    int64_t entity = 0, dimension = 0;
    sb_result result = sbi_gmsh_integer(gmsh, "entity", &entity);
    if (result || entity == 0)
        return result;
    result = sbi_gmsh_integer(gmsh, "dimension", &dimension);
    if (!result && (dimension < 0 || dimension > 3))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "an entity of dimension %lld", (long long)dimension);
    return result ? result : sbi_gmsh_skip_reals(gmsh, (size_t)dimension);
}

/* 1 to 3: count, then per line a number and three coordinates. The count is text also in binary files. */
static sb_result sbi_gmsh_nodes_2(sbi_gmsh *gmsh)
{
    int count = 0;
    sb_result result = sbi_reader_count(gmsh->reader, "the number of nodes", gmsh->binary ? 28 : 8, &count);
    if (!result)
        result = sbi_gmsh_reserve_nodes(gmsh, count);
    if (!result && gmsh->binary)
        sbi_reader_next_line(gmsh->reader);
    for (int i = 0; i < count && !result; i++) {
        result = sbi_gmsh_node_tag(gmsh, i);
        if (!result)
            result = sbi_gmsh_node(gmsh);
        if (!result && gmsh->version == 30)
            result = sbi_gmsh_skip_parameters(gmsh);
    }
    return result;
}

/* One block: dimension and tag (4.0: tag and dimension), parametric, count; 4.1: all numbers, then all coordinates;
 * 4.0: number and coordinates of each node. */
static sb_result sbi_gmsh_node_block(sbi_gmsh *gmsh)
{
    int64_t header[3] = {0, 0, 0}, dimension;
    int count = 0, first = (int)gmsh->loader->node_count, apart = gmsh->version == 41;
    sb_result result = SB_OK;
    for (int i = 0; i < 3 && !result; i++)
        result = sbi_gmsh_integer(gmsh, "header of a block of nodes", &header[i]);
    dimension = gmsh->version == 41 ? header[0] : header[1];
    if (!result && (dimension < 0 || dimension > 3))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "an entity of dimension %lld", (long long)dimension);
    if (!result)
        result =
            sbi_gmsh_count(gmsh, "the number of nodes of a block", (size_t)sbi_gmsh_tag_bytes(gmsh) + 24, 4, &count);
    if (!result && count > INT_MAX - first)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 nodes");
    if (!result)
        result = sbi_gmsh_reserve_nodes(gmsh, count);
    for (int i = 0; i < count && apart && !result; i++)
        result = sbi_gmsh_node_tag(gmsh, first + i);
    for (int i = 0; i < count && !result; i++) {
        result = apart ? SB_OK : sbi_gmsh_node_tag(gmsh, first + i);
        if (!result)
            result = sbi_gmsh_node(gmsh);
        if (!result && header[2])
            result = sbi_gmsh_skip_reals(gmsh, (size_t)dimension); /* parameters on the entity */
    }
    gmsh->reader->node = -1;
    return result;
}

/* 4: numbers of blocks and nodes; 4.1: lowest and highest tag; blocks. */
static sb_result sbi_gmsh_nodes_4(sbi_gmsh *gmsh)
{
    int blocks = 0, count = 0;
    int64_t unused = 0;
    sb_result result = sbi_gmsh_count(gmsh, "the number of blocks of nodes", 12 + (size_t)gmsh->size_bytes, 4, &blocks);
    if (!result)
        result = sbi_gmsh_count(gmsh, "the number of nodes", 24 + (size_t)sbi_gmsh_tag_bytes(gmsh), 4, &count);
    for (int i = 0; i < 2 && gmsh->version == 41 && !result; i++)
        result = sbi_gmsh_size(gmsh, "node number", &unused);
    if (!result)
        result = sbi_gmsh_reserve_nodes(gmsh, count);
    for (int i = 0; i < blocks && !result; i++)
        result = sbi_gmsh_node_block(gmsh);
    if (!result && (size_t)count != gmsh->loader->node_count)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "%llu nodes, but %d are announced",
                               (unsigned long long)gmsh->loader->node_count, count);
    return result;
}

static sb_result sbi_gmsh_nodes(sbi_gmsh *gmsh)
{
    sb_result result;
    if (gmsh->has_nodes)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a second $Nodes section");
    gmsh->has_nodes = 1;
    result = gmsh->version < 40 ? sbi_gmsh_nodes_2(gmsh) : sbi_gmsh_nodes_4(gmsh);
    if (!result && gmsh->loader->node_count == 0)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_MESH, "the file has no nodes");
    return result ? result : sbi_gmsh_sort_tags(gmsh);
}

/* ---- entities (3 and 4) ---- */

static int sbi_gmsh_compare_entities(const sbi_gmsh_entity *a, int64_t dimension, int64_t tag)
{
    if (a->dimension != dimension)
        return a->dimension < dimension ? -1 : 1;
    return a->tag == tag ? 0 : a->tag < tag ? -1 : 1;
}

static int sbi_gmsh_entity_before(const void *context, int a, int b)
{
    const sbi_gmsh_entity *entities = (const sbi_gmsh_entity *)context;
    return sbi_gmsh_compare_entities(&entities[a], entities[b].dimension, entities[b].tag) < 0;
}

static sb_result sbi_gmsh_add_entity(sbi_gmsh *gmsh, int dimension, int64_t tag, int groups)
{
    sbi_gmsh_entity *entity;
    sb_result result;
    if (gmsh->entity_count == INT_MAX)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 entities");
    if (gmsh->entity_count == gmsh->entity_capacity) {
        void *grown = sbi_loader_grow(gmsh->loader, gmsh->entities, gmsh->entity_count, &gmsh->entity_capacity,
                                      gmsh->entity_count + 1, sizeof gmsh->entities[0]);
        if (!grown)
            return sbi_loader_no_memory(gmsh->loader);
        gmsh->entities = (sbi_gmsh_entity *)grown;
    }
    entity = &gmsh->entities[gmsh->entity_count++];
    entity->dimension = dimension;
    entity->tag = tag;
    entity->region = gmsh->numbers[0];
    result = sbi_loader_add_groups(gmsh->loader, gmsh->numbers, groups, &entity->groups);
    gmsh->loader->cell_groups = 0;
    return result;
}

/* Numbers of an entity line: text in version 3 also in binary files. */
static sb_result sbi_gmsh_entity_integer(sbi_gmsh *gmsh, const char *what, int64_t *value)
{
    return gmsh->version == 30 ? sbi_reader_integer(gmsh->reader, what, value) : sbi_gmsh_integer(gmsh, what, value);
}

static sb_result sbi_gmsh_entity_count(sbi_gmsh *gmsh, const char *what, size_t bytes, size_t numbers, int *count)
{
    return gmsh->version == 30 ? sbi_reader_count(gmsh->reader, what, 2 * numbers, count)
                               : sbi_gmsh_count(gmsh, what, bytes, numbers, count);
}

/* The count and numbers of the entity's physical groups. */
static sb_result sbi_gmsh_entity_groups(sbi_gmsh *gmsh, int *groups)
{
    int64_t group = 0;
    sb_result result = sbi_gmsh_entity_count(gmsh, "the number of physical groups", 4, 1, groups);
    if (!result && (size_t)*groups > gmsh->number_capacity) {
        void *grown =
            sbi_loader_grow(gmsh->loader, gmsh->numbers, 0, &gmsh->number_capacity, (size_t)*groups, sizeof(int));
        if (!grown)
            return sbi_loader_no_memory(gmsh->loader);
        gmsh->numbers = (int *)grown;
    }
    for (int i = 0; i < *groups && !result; i++) {
        result = sbi_gmsh_entity_integer(gmsh, "physical group", &group);
        if (!result)
            result = sbi_gmsh_region(gmsh, group, &gmsh->numbers[i]);
    }
    return result;
}

/* The entities that bound it. */
static sb_result sbi_gmsh_entity_bounds(sbi_gmsh *gmsh)
{
    int bounds = 0;
    int64_t bound = 0;
    sb_result result = sbi_gmsh_entity_count(gmsh, "the number of bounding entities", 4, 1, &bounds);
    for (int i = 0; i < bounds && !result; i++)
        result = sbi_gmsh_entity_integer(gmsh, "bounding entity", &bound);
    return result;
}

/* Tag, box (points of 4.1: place), physical groups, and but for points the entities that bound it. Version 3 has no
 * box, and the groups come last. */
static sb_result sbi_gmsh_entity_line(sbi_gmsh *gmsh, int dimension)
{
    int64_t tag = 0;
    int groups = 0;
    sb_result result = sbi_gmsh_entity_integer(gmsh, "entity", &tag);
    if (!result && gmsh->version != 30)
        result = sbi_gmsh_skip_reals(gmsh, dimension == 0 && gmsh->version == 41 ? 3 : 6);
    if (!result && gmsh->version == 30 && dimension > 0)
        result = sbi_gmsh_entity_bounds(gmsh);
    if (!result)
        result = sbi_gmsh_entity_groups(gmsh, &groups);
    if (!result && gmsh->version != 30 && dimension > 0)
        result = sbi_gmsh_entity_bounds(gmsh);
    return result || groups == 0 ? result : sbi_gmsh_add_entity(gmsh, dimension, tag, groups);
}

static sb_result sbi_gmsh_entities(sbi_gmsh *gmsh)
{
    int counts[4] = {0, 0, 0, 0};
    int *scratch;
    sb_result result = SB_OK;
    if (gmsh->entity_order)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a second $Entities section");
    for (int i = 0; i < 4 && !result; i++)
        result = sbi_gmsh_entity_count(gmsh, "the number of entities", 28, 2, &counts[i]);
    for (int dimension = 0; dimension < 4; dimension++)
        for (int i = 0; i < counts[dimension] && !result; i++)
            result = sbi_gmsh_entity_line(gmsh, dimension);
    if (result)
        return result;
    scratch = (int *)sbi_alloc(&gmsh->loader->allocator, gmsh->entity_count, sizeof(int));
    gmsh->entity_order = (int *)sbi_alloc(&gmsh->loader->allocator, gmsh->entity_count, sizeof(int));
    if (scratch && gmsh->entity_order) {
        for (size_t i = 0; i < gmsh->entity_count; i++)
            gmsh->entity_order[i] = (int)i;
        sbi_merge_sort(gmsh->entity_order, scratch, (int)gmsh->entity_count, sbi_gmsh_entity_before, gmsh->entities);
    } else {
        result = sbi_loader_no_memory(gmsh->loader);
    }
    sbi_free(&gmsh->loader->allocator, scratch);
    return result;
}

/* Makes the entity's groups those of the next cells, and returns its region; 0 when it is in no physical group. */
static int sbi_gmsh_enter_entity(sbi_gmsh *gmsh, int64_t dimension, int64_t tag)
{
    int low = 0, high = (int)gmsh->entity_count;
    gmsh->loader->cell_groups = 0;
    while (low < high) {
        int middle = low + (high - low) / 2;
        const sbi_gmsh_entity *entity = &gmsh->entities[gmsh->entity_order[middle]];
        int compared = sbi_gmsh_compare_entities(entity, dimension, tag);
        if (compared == 0) {
            gmsh->loader->cell_groups = entity->groups;
            return entity->region;
        }
        if (compared < 0)
            low = middle + 1;
        else
            high = middle;
    }
    return 0;
}

/* ---- elements ---- */

static sb_result sbi_gmsh_find_kind(const sbi_gmsh *gmsh, int64_t number, int *kind)
{
    *kind = sbi_cell_kind_of_gmsh(number);
    if (*kind < 0)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "element %d has the unknown gmsh type %lld",
                               gmsh->loader->source_count, (long long)number);
    return SB_OK;
}

/* The nodes of an element and its end. */
static sb_result sbi_gmsh_element_nodes(sbi_gmsh *gmsh, int kind, int region)
{
    const sbi_cell_kind *about = sbi_cell_kind_at(kind);
    int64_t value = 0;
    sb_result result = SB_OK;
    for (int i = 0; i < about->nodes && !result; i++) {
        result = sbi_gmsh_tag(gmsh, "node number", &value);
        if (!result)
            result = sbi_gmsh_cell_node(gmsh, value);
    }
    return result ? result : sbi_loader_end_cell(gmsh->loader, kind, about->gmsh_order, region);
}

/* 2.x after the type is known: tags (the first is the physical group), then nodes. */
static sb_result sbi_gmsh_element_2(sbi_gmsh *gmsh, int kind, int tags)
{
    int64_t value = 0;
    int region = 0;
    sb_result result = SB_OK;
    for (int i = 0; i < tags && !result; i++) {
        result = sbi_gmsh_integer(gmsh, "element tag", &value);
        if (!result && i == 0)
            result = sbi_gmsh_region(gmsh, value, &region);
    }
    if (!result)
        result = sbi_loader_add_groups(gmsh->loader, &region, region != 0, &gmsh->loader->cell_groups);
    return result ? result : sbi_gmsh_element_nodes(gmsh, kind, region);
}

/* 1 after the type is known: physical group, entity, count of nodes, nodes. */
static sb_result sbi_gmsh_element_1(sbi_gmsh *gmsh, int kind)
{
    int64_t header[3] = {0, 0, 0};
    int region = 0;
    sb_result result = SB_OK;
    for (int i = 0; i < 3 && !result; i++)
        result = sbi_gmsh_integer(gmsh, "element tag", &header[i]);
    if (!result && header[2] != sbi_cell_kind_at(kind)->nodes)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "element %d has %lld nodes, but a %s has %d",
                               gmsh->loader->source_count, (long long)header[2], sbi_cell_kind_at(kind)->name,
                               sbi_cell_kind_at(kind)->nodes);
    if (!result)
        result = sbi_gmsh_region(gmsh, header[0], &region);
    if (!result)
        result = sbi_loader_add_groups(gmsh->loader, &region, region != 0, &gmsh->loader->cell_groups);
    return result ? result : sbi_gmsh_element_nodes(gmsh, kind, region);
}

/* 3 after the type is known: entity, count of data, the nodes, other data (parent, partition). */
static sb_result sbi_gmsh_element_3(sbi_gmsh *gmsh, int kind)
{
    const sbi_cell_kind *about = sbi_cell_kind_at(kind);
    int64_t entity = 0, data = 0, unused = 0;
    sb_result result = sbi_gmsh_integer(gmsh, "entity", &entity);
    if (!result)
        result = sbi_gmsh_integer(gmsh, "the number of data", &data);
    if (!result && data < about->nodes)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "element %d has %lld nodes, but a %s has %d",
                               gmsh->loader->source_count, (long long)data, about->name, about->nodes);
    if (!result)
        result = sbi_gmsh_element_nodes(gmsh, kind, sbi_gmsh_enter_entity(gmsh, about->dimension, entity));
    for (int64_t i = about->nodes; i < data && !result; i++)
        result = sbi_gmsh_integer(gmsh, "element data", &unused);
    return result;
}

/* A line of a text, or of a binary file of version 3: number, type, and what its version has next. */
static sb_result sbi_gmsh_element_line(sbi_gmsh *gmsh)
{
    int64_t number = 0, type = 0;
    int tags = 0, kind = 0;
    sb_result result;
    sbi_loader_begin_cell(gmsh->loader);
    result = sbi_gmsh_integer(gmsh, "element number", &number);
    if (!result)
        result = sbi_gmsh_integer(gmsh, "element type", &type);
    if (!result)
        result = sbi_gmsh_find_kind(gmsh, type, &kind);
    if (result)
        return result;
    if (gmsh->version == 10)
        return sbi_gmsh_element_1(gmsh, kind);
    if (gmsh->version == 30)
        return sbi_gmsh_element_3(gmsh, kind);
    result = sbi_reader_count(gmsh->reader, "the number of tags", 2, &tags);
    return result ? result : sbi_gmsh_element_2(gmsh, kind, tags);
}

/* A binary block of 2.x: type, count, number of tags; elements with number, tags, nodes. At most `left`
 * elements. */
static sb_result sbi_gmsh_binary_block(sbi_gmsh *gmsh, int left, int *count)
{
    int64_t header[3] = {0, 0, 0};
    int tags = 0, kind = 0;
    sb_result result = SB_OK;
    for (int i = 0; i < 3 && !result; i++)
        result = sbi_gmsh_integer(gmsh, "header of a block of elements", &header[i]);
    if (!result)
        result = sbi_gmsh_find_kind(gmsh, header[0], &kind);
    if (!result)
        result = sbi_reader_check_count(gmsh->reader, "the number of elements of a block", header[1], 8, count);
    if (!result)
        result = sbi_reader_check_count(gmsh->reader, "the number of tags", header[2], 4, &tags);
    if (!result && (*count > left || *count == 0))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a block of %d elements where %d are left", *count, left);
    for (int i = 0; i < *count && !result; i++) {
        sbi_loader_begin_cell(gmsh->loader);
        result = sbi_gmsh_integer(gmsh, "element number", &header[0]);
        if (!result)
            result = sbi_gmsh_element_2(gmsh, kind, tags);
    }
    return result;
}

static sb_result sbi_gmsh_elements_2(sbi_gmsh *gmsh)
{
    int count = 0, block = 1;
    sb_result result = sbi_reader_count(gmsh->reader, "the number of elements", 8, &count);
    if (!result && gmsh->binary)
        sbi_reader_next_line(gmsh->reader);
    for (int i = 0; i < count && !result; i += block)
        result = gmsh->binary && gmsh->version == 20 ? sbi_gmsh_binary_block(gmsh, count - i, &block)
                                                     : sbi_gmsh_element_line(gmsh);
    return result;
}

/* 4: dimension and tag of the entity (4.0: tag and dimension), type, count; elements with number and nodes. */
static sb_result sbi_gmsh_element_block(sbi_gmsh *gmsh)
{
    int64_t header[3] = {0, 0, 0}, value = 0;
    int count = 0, kind = 0, region, first = gmsh->version == 41 ? 0 : 1;
    size_t numbers;
    sb_result result = SB_OK;
    for (int i = 0; i < 3 && !result; i++)
        result = sbi_gmsh_integer(gmsh, "header of a block of elements", &header[i]);
    if (!result)
        result = sbi_gmsh_find_kind(gmsh, header[2], &kind);
    if (result)
        return result;
    numbers = 1 + (size_t)sbi_cell_kind_at(kind)->nodes;
    result = sbi_gmsh_count(gmsh, "the number of elements of a block", numbers * (size_t)sbi_gmsh_tag_bytes(gmsh),
                            numbers, &count);
    region = sbi_gmsh_enter_entity(gmsh, header[first], header[1 - first]);
    for (int i = 0; i < count && !result; i++) {
        sbi_loader_begin_cell(gmsh->loader);
        result = sbi_gmsh_tag(gmsh, "element number", &value);
        if (!result)
            result = sbi_gmsh_element_nodes(gmsh, kind, region);
    }
    return result;
}

static sb_result sbi_gmsh_elements_4(sbi_gmsh *gmsh)
{
    int blocks = 0, count = 0;
    int64_t unused = 0;
    sb_result result =
        sbi_gmsh_count(gmsh, "the number of blocks of elements", 12 + (size_t)gmsh->size_bytes, 4, &blocks);
    if (!result)
        result = sbi_gmsh_count(gmsh, "the number of elements", 2 * (size_t)sbi_gmsh_tag_bytes(gmsh), 2, &count);
    for (int i = 0; i < 2 && gmsh->version == 41 && !result; i++)
        result = sbi_gmsh_size(gmsh, "element number", &unused);
    for (int i = 0; i < blocks && !result; i++)
        result = sbi_gmsh_element_block(gmsh);
    if (!result && count != gmsh->loader->source_count)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "%d elements, but %d are announced",
                               gmsh->loader->source_count, count);
    return result;
}

static sb_result sbi_gmsh_elements(sbi_gmsh *gmsh)
{
    if (!gmsh->has_nodes)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "$Elements before $Nodes");
    if (gmsh->has_elements)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a second $Elements section");
    gmsh->has_elements = 1;
    return gmsh->version < 40 ? sbi_gmsh_elements_2(gmsh) : sbi_gmsh_elements_4(gmsh);
}

/* ---- sections ---- */

/* 1 when the word is the end of the section: "$End" and its name, in capitals in version 1. */
static int sbi_gmsh_is_end(sbi_word word, sbi_word name)
{
    sbi_word start = word, rest = word;
    char text[32];
    if (word.length != name.length + 4 || name.length >= sizeof text)
        return 0;
    start.length = 4;
    rest.text += 4;
    rest.length -= 4;
    memcpy(text, name.text, name.length);
    text[name.length] = 0;
    return sbi_word_is(start, "$End") && sbi_word_is(rest, text);
}

/* Steps behind "$End" + name of the section, wherever it is: for sections whose content is of no interest. */
static sb_result sbi_gmsh_skip_section(sbi_gmsh *gmsh, sbi_word name)
{
    sbi_reader *reader = gmsh->reader;
    char text[32];
    for (; sbi_reader_left(reader) >= name.length + 4; reader->at++) {
        const char *here = reader->data + reader->at;
        if (*here == '\n' && reader->line < INT_MAX)
            reader->line++;
        if (*here == '$' && memcmp(here, "$End", 4) == 0 && memcmp(here + 4, name.text, name.length) == 0) {
            reader->at += name.length + 4;
            return SB_OK;
        }
    }
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "$End%s is missing", sbi_word_print(name, text));
}

static sb_result sbi_gmsh_expect_end(sbi_gmsh *gmsh, sbi_word name)
{
    sbi_word word;
    char text[32];
    if (sbi_reader_word(gmsh->reader, &word) && sbi_gmsh_is_end(word, name))
        return SB_OK;
    return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "$End%s is missing", sbi_word_print(name, text));
}

/* ---- names ---- */

/* The rest of the line between quotation marks; 0: there are none. */
static int sbi_gmsh_quoted(sbi_reader *reader, sbi_word *text)
{
    size_t end;
    if (sbi_reader_at_line_end(reader) || reader->data[reader->at] != '"')
        return 0;
    end = ++reader->at;
    while (end < reader->size && reader->data[end] != '"' && reader->data[end] != '\n' && reader->data[end] != '\r')
        end++;
    if (end >= reader->size || reader->data[end] != '"')
        return 0;
    text->text = reader->data + reader->at;
    text->length = end - reader->at;
    reader->at = end + 1;
    return 1;
}

/* $PhysicalNames, text in binary files too: count; dimension (not in 2.0), number, "name". */
static sb_result sbi_gmsh_names(sbi_gmsh *gmsh)
{
    sbi_reader *reader = gmsh->reader;
    int count = 0;
    sb_result result = sbi_reader_count(reader, "the number of physical names", 4, &count);
    for (int i = 0; i < count && !result; i++) {
        int64_t first = 0, number = 0;
        sbi_word text;
        int with_dimension;
        result = sbi_reader_integer(reader, "dimension", &first);
        if (result)
            return result;
        with_dimension = !sbi_reader_at_line_end(reader) && reader->data[reader->at] != '"';
        if (with_dimension)
            result = sbi_reader_integer(reader, "physical group", &number);
        else
            number = first;
        if (result)
            return result;
        if (number < -INT_MAX || number > INT_MAX || (with_dimension && (first < 0 || first > 3)))
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "physical group %lld of dimension %lld", (long long)number,
                                   (long long)first);
        if (!sbi_gmsh_quoted(reader, &text))
            return sbi_reader_fail(reader, SB_ERROR_FORMAT,
                                   "the name of physical group %lld is not between quotation "
                                   "marks",
                                   (long long)number);
        result = sbi_loader_add_name(gmsh->loader, with_dimension ? (int)first : -1, (int)number, text);
    }
    return result;
}

/* ---- file ---- */

/* 2, 2.x, 3, 3.x, 4, 4.0 or 4.1; 0: none of them. */
static int sbi_gmsh_version(sbi_word text)
{
    int major = text.length > 0 ? text.text[0] - '0' : 0;
    if (sbi_word_is(text, "4.1"))
        return 41;
    if (sbi_word_is(text, "4") || sbi_word_is(text, "4.0"))
        return 40;
    return (major == 2 || major == 3) && (text.length == 1 || text.text[1] == '.') ? 10 * major : 0;
}

/* $MeshFormat: version, 0 text or 1 binary, bytes of a number; in binary files the integer 1, telling byte
 * order. */
static sb_result sbi_gmsh_format(sbi_gmsh *gmsh)
{
    sbi_word version;
    int64_t binary = 0, bytes = 0;
    char text[32];
    const unsigned char *one;
    sb_result result;
    if (gmsh->version)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a second $MeshFormat section");
    if (!sbi_reader_word(gmsh->reader, &version))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "the version number is missing");
    gmsh->version = sbi_gmsh_version(version);
    if (!gmsh->version)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED,
                               "gmsh version %s is not supported: 1, 2.x, 3, 4.0 and 4.1 are",
                               sbi_word_print(version, text));
    result = sbi_reader_integer(gmsh->reader, "file type", &binary);
    if (!result)
        result = sbi_reader_integer(gmsh->reader, "data size", &bytes);
    if (result)
        return result;
    if (binary < 0 || binary > 1 || (bytes != 8 && !(bytes == 4 && gmsh->version >= 40)))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "file type %lld with data size %lld",
                               (long long)binary, (long long)bytes);
    gmsh->size_bytes = (int)bytes;
    if (!binary)
        return sbi_reader_check_text(gmsh->reader);
    sbi_reader_next_line(gmsh->reader);
    gmsh->binary = gmsh->reader->binary = 1;
    one = sbi_reader_bytes(gmsh->reader, 1, 4, "$MeshFormat");
    if (!one)
        return SB_ERROR_FORMAT;
    gmsh->reader->big_endian = one[3] == 1;
    if (sbi_decode_bits(gmsh->reader, one, 4) != 1)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "the mark of the byte order is not 1");
    return SB_OK;
}

/* A section that the mesh does not need; those with results and the like are noted. */
static sb_result sbi_gmsh_other_section(sbi_gmsh *gmsh, sbi_word keyword, sbi_word name)
{
    static const char *const quiet[] = {"$Comments", "$Comment", "$Entities"};
    int noted = 1;
    for (size_t i = 0; i < sizeof quiet / sizeof quiet[0]; i++)
        noted &= !sbi_word_is(keyword, quiet[i]);
    if (noted)
        sbi_loader_ignore(gmsh->loader, keyword);
    return sbi_gmsh_skip_section(gmsh, name);
}

static sb_result sbi_gmsh_section(sbi_gmsh *gmsh, sbi_word keyword)
{
    sbi_word name = keyword;
    char text[32];
    sb_result result;
    int old_nodes = sbi_word_is(keyword, "$NOD"), old_elements = sbi_word_is(keyword, "$ELM");
    int elements = old_elements || sbi_word_is(keyword, "$Elements"),
        nodes = old_nodes || sbi_word_is(keyword, "$Nodes");
    int entities = sbi_word_is(keyword, "$Entities"), format = sbi_word_is(keyword, "$MeshFormat");
    int names = sbi_word_is(keyword, "$PhysicalNames");
    if (keyword.length < 2 || keyword.text[0] != '$')
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "'%s' where a section should begin",
                               sbi_word_print(keyword, text));
    name.text++;
    name.length--;
    if (sbi_word_is(keyword, "$PartitionedEntities"))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "partitioned gmsh meshes are not supported");
    if (!gmsh->version && (old_nodes || old_elements))
        gmsh->version = 10; /* the only one without $MeshFormat */
    if (gmsh->version != 10 && (old_nodes || old_elements))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "$%s of version 1 in a file of another version",
                               sbi_word_print(name, text));
    if (!gmsh->version && (elements || nodes || entities))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "$MeshFormat is missing");
    if (!(elements || nodes || format || names || (entities && gmsh->version >= 30)))
        return sbi_gmsh_other_section(gmsh, keyword, name);
    if (gmsh->binary && gmsh->version >= 40 && !names)
        sbi_reader_next_line(gmsh->reader);
    if (format)
        result = sbi_gmsh_format(gmsh);
    else if (names)
        result = sbi_gmsh_names(gmsh);
    else if (entities)
        result = sbi_gmsh_entities(gmsh);
    else
        result = nodes ? sbi_gmsh_nodes(gmsh) : sbi_gmsh_elements(gmsh);
    return result ? result : sbi_gmsh_expect_end(gmsh, name);
}

SBI_API sb_result sbi_gmsh_read(sbi_loader *loader)
{
    sbi_gmsh gmsh;
    sbi_word keyword;
    sb_result result = SB_OK;
    memset(&gmsh, 0, sizeof gmsh);
    gmsh.loader = loader;
    gmsh.reader = &loader->reader;
    while (!result && sbi_reader_word(gmsh.reader, &keyword))
        result = sbi_gmsh_section(&gmsh, keyword);
    if (!result && !gmsh.version)
        result = sbi_reader_fail(gmsh.reader, SB_ERROR_FORMAT, "the file has no $MeshFormat");
    if (!result && !gmsh.has_elements)
        result = sbi_reader_fail(gmsh.reader, SB_ERROR_FORMAT, "the file ends without %s",
                                 gmsh.has_nodes ? "$Elements" : "$Nodes");
    sbi_free(&loader->allocator, gmsh.tags);
    sbi_free(&loader->allocator, gmsh.order);
    sbi_free(&loader->allocator, gmsh.entities);
    sbi_free(&loader->allocator, gmsh.entity_order);
    sbi_free(&loader->allocator, gmsh.numbers);
    return result;
}
