/* meshio_gmsh: reads gmsh meshes, versions 2.x and 4.1, ASCII and binary of either byte order.
 * Source of the format: Gmsh Reference Manual, "MSH file format" and "Legacy formats". */
#include "meshio_reader.h"

#include <limits.h>
#include <string.h>

/* The first physical group of a geometric entity (4.1). */
typedef struct sbi_gmsh_entity {
    int64_t dimension, tag;
    int region;
} sbi_gmsh_entity;

typedef struct sbi_gmsh {
    sbi_loader *loader;
    sbi_reader *reader;
    int version;            /* 2 or 4 */
    int binary, size_bytes; /* bytes of a size_t in binary files */
    int has_nodes, has_elements;
    int64_t *tags; /* [nodes] number of each node in the file, any order and gaps */
    size_t tag_capacity;
    int *order; /* [nodes] nodes by ascending tag */
    sbi_gmsh_entity *entities;
    size_t entity_count, entity_capacity;
    int *entity_order; /* [entities] ascending by dimension and tag */
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

/* A size_t of version 4.1: counts and tags of nodes and elements. */
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

/* A count of things that take at least `bytes` bytes in a binary file, and two per number in a text. */
static sb_result sbi_gmsh_count(sbi_gmsh *gmsh, const char *what, size_t bytes, size_t numbers, int *count)
{
    int64_t value = 0;
    sb_result result = sbi_gmsh_size(gmsh, what, &value);
    return result
               ? result
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
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "physical group %lld is too large",
                               (long long)physical);
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
        void *grown =
            sbi_loader_grow(gmsh->loader, gmsh->tags, used, &gmsh->tag_capacity, needed, sizeof(int64_t));
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
                               "element %d refers to node number %lld, which does not exist",
                               gmsh->reader->element, (long long)tag);
    return sbi_loader_cell_node(gmsh->loader, node, 0);
}

/* ---- nodes ---- */

static sb_result sbi_gmsh_node_tag(sbi_gmsh *gmsh, int node)
{
    sb_result result;
    gmsh->reader->node = node;
    result = gmsh->version == 2 ? sbi_gmsh_integer(gmsh, "node number", &gmsh->tags[node])
                                : sbi_gmsh_size(gmsh, "node number", &gmsh->tags[node]);
    if (!result && gmsh->tags[node] < 0)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a negative node number: %lld",
                               (long long)gmsh->tags[node]);
    return result;
}

/* 2.x: count, then per line a number and three coordinates. The count is text also in binary files. */
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
    }
    return result;
}

/* One block of 4.1: dimension, tag, parametric, count; the numbers; the coordinates. */
static sb_result sbi_gmsh_node_block(sbi_gmsh *gmsh)
{
    int64_t header[3] = {0, 0, 0};
    int count = 0, first = (int)gmsh->loader->node_count;
    sb_result result = SB_OK;
    for (int i = 0; i < 3 && !result; i++)
        result = sbi_gmsh_integer(gmsh, "header of a block of nodes", &header[i]);
    if (!result && (header[0] < 0 || header[0] > 3))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "an entity of dimension %lld",
                               (long long)header[0]);
    if (!result)
        result =
            sbi_gmsh_count(gmsh, "the number of nodes of a block", (size_t)gmsh->size_bytes + 24, 4, &count);
    if (!result && count > INT_MAX - first)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 nodes");
    if (!result)
        result = sbi_gmsh_reserve_nodes(gmsh, count);
    for (int i = 0; i < count && !result; i++)
        result = sbi_gmsh_node_tag(gmsh, first + i);
    for (int i = 0; i < count && !result; i++) {
        result = sbi_gmsh_node(gmsh);
        if (!result && header[2])
            result = sbi_gmsh_skip_reals(gmsh, (size_t)header[0]); /* parameters on the entity */
    }
    gmsh->reader->node = -1;
    return result;
}

/* 4.1: numbers of blocks and nodes, lowest and highest tag; blocks. */
static sb_result sbi_gmsh_nodes_4(sbi_gmsh *gmsh)
{
    int blocks = 0, count = 0;
    int64_t unused = 0;
    sb_result result =
        sbi_gmsh_count(gmsh, "the number of blocks of nodes", 12 + (size_t)gmsh->size_bytes, 4, &blocks);
    if (!result)
        result = sbi_gmsh_count(gmsh, "the number of nodes", 24 + (size_t)gmsh->size_bytes, 4, &count);
    for (int i = 0; i < 2 && !result; i++)
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
    result = gmsh->version == 2 ? sbi_gmsh_nodes_2(gmsh) : sbi_gmsh_nodes_4(gmsh);
    if (!result && gmsh->loader->node_count == 0)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_MESH, "the file has no nodes");
    return result ? result : sbi_gmsh_sort_tags(gmsh);
}

/* ---- entities (4.1) ---- */

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

static sb_result sbi_gmsh_add_entity(sbi_gmsh *gmsh, int dimension, int64_t tag, int region)
{
    sbi_gmsh_entity *entity;
    if (gmsh->entity_count == INT_MAX)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 entities");
    if (gmsh->entity_count == gmsh->entity_capacity) {
        void *grown =
            sbi_loader_grow(gmsh->loader, gmsh->entities, gmsh->entity_count, &gmsh->entity_capacity,
                            gmsh->entity_count + 1, sizeof gmsh->entities[0]);
        if (!grown)
            return sbi_loader_no_memory(gmsh->loader);
        gmsh->entities = (sbi_gmsh_entity *)grown;
    }
    entity = &gmsh->entities[gmsh->entity_count++];
    entity->dimension = dimension;
    entity->tag = tag;
    entity->region = region;
    return SB_OK;
}

/* Tag, box (points: place), physical groups, and but for points the entities that bound it. */
static sb_result sbi_gmsh_entity_line(sbi_gmsh *gmsh, int dimension)
{
    int64_t tag = 0, group = 0;
    int groups = 0, bounds = 0, region = 0;
    sb_result result = sbi_gmsh_integer(gmsh, "entity", &tag);
    if (!result)
        result = sbi_gmsh_skip_reals(gmsh, dimension == 0 ? 3 : 6);
    if (!result)
        result = sbi_gmsh_count(gmsh, "the number of physical groups", 4, 1, &groups);
    for (int i = 0; i < groups && !result; i++) {
        result = sbi_gmsh_integer(gmsh, "physical group", &group);
        if (!result && i == 0)
            result = sbi_gmsh_region(gmsh, group, &region);
    }
    if (!result && dimension > 0)
        result = sbi_gmsh_count(gmsh, "the number of bounding entities", 4, 1, &bounds);
    for (int i = 0; i < bounds && !result; i++)
        result = sbi_gmsh_integer(gmsh, "bounding entity", &group);
    return result || groups == 0 ? result : sbi_gmsh_add_entity(gmsh, dimension, tag, region);
}

static sb_result sbi_gmsh_entities(sbi_gmsh *gmsh)
{
    int counts[4] = {0, 0, 0, 0};
    int *scratch;
    sb_result result = SB_OK;
    if (gmsh->entity_order)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a second $Entities section");
    for (int i = 0; i < 4 && !result; i++)
        result = sbi_gmsh_count(gmsh, "the number of entities", 28, 5, &counts[i]);
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
        sbi_merge_sort(gmsh->entity_order, scratch, (int)gmsh->entity_count, sbi_gmsh_entity_before,
                       gmsh->entities);
    } else {
        result = sbi_loader_no_memory(gmsh->loader);
    }
    sbi_free(&gmsh->loader->allocator, scratch);
    return result;
}

/* Region of an entity; 0 when it is in no physical group. */
static int sbi_gmsh_entity_region(const sbi_gmsh *gmsh, int64_t dimension, int64_t tag)
{
    int low = 0, high = (int)gmsh->entity_count;
    while (low < high) {
        int middle = low + (high - low) / 2;
        const sbi_gmsh_entity *entity = &gmsh->entities[gmsh->entity_order[middle]];
        int compared = sbi_gmsh_compare_entities(entity, dimension, tag);
        if (compared == 0)
            return entity->region;
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
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED,
                               "element %d has the unknown gmsh type %lld", gmsh->loader->source_count,
                               (long long)number);
    return SB_OK;
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
    for (int i = 0; i < sbi_cell_kind_at(kind)->nodes && !result; i++) {
        result = sbi_gmsh_integer(gmsh, "node number", &value);
        if (!result)
            result = sbi_gmsh_cell_node(gmsh, value);
    }
    return result ? result
                  : sbi_loader_end_cell(gmsh->loader, kind, sbi_cell_kind_at(kind)->gmsh_order, region);
}

/* A text line: number, type, number of tags, tags, nodes. */
static sb_result sbi_gmsh_text_element(sbi_gmsh *gmsh)
{
    int64_t number = 0, type = 0;
    int tags = 0, kind = 0;
    sb_result result;
    sbi_loader_begin_cell(gmsh->loader);
    result = sbi_reader_integer(gmsh->reader, "element number", &number);
    if (!result)
        result = sbi_reader_integer(gmsh->reader, "element type", &type);
    if (!result)
        result = sbi_gmsh_find_kind(gmsh, type, &kind);
    if (!result)
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
        result =
            sbi_reader_check_count(gmsh->reader, "the number of elements of a block", header[1], 8, count);
    if (!result)
        result = sbi_reader_check_count(gmsh->reader, "the number of tags", header[2], 4, &tags);
    if (!result && (*count > left || *count == 0))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a block of %d elements where %d are left",
                               *count, left);
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
        result = gmsh->binary ? sbi_gmsh_binary_block(gmsh, count - i, &block) : sbi_gmsh_text_element(gmsh);
    return result;
}

/* 4.1: dimension and tag of the entity, type, count; elements with number and nodes. */
static sb_result sbi_gmsh_element_block(sbi_gmsh *gmsh)
{
    int64_t header[3] = {0, 0, 0}, value = 0;
    int count = 0, kind = 0, region, nodes;
    sb_result result = SB_OK;
    for (int i = 0; i < 3 && !result; i++)
        result = sbi_gmsh_integer(gmsh, "header of a block of elements", &header[i]);
    if (!result)
        result = sbi_gmsh_find_kind(gmsh, header[2], &kind);
    if (result)
        return result;
    nodes = sbi_cell_kind_at(kind)->nodes;
    result = sbi_gmsh_count(gmsh, "the number of elements of a block",
                            (size_t)(1 + nodes) * (size_t)gmsh->size_bytes, (size_t)(1 + nodes), &count);
    region = sbi_gmsh_entity_region(gmsh, header[0], header[1]);
    for (int i = 0; i < count && !result; i++) {
        sbi_loader_begin_cell(gmsh->loader);
        result = sbi_gmsh_size(gmsh, "element number", &value);
        for (int k = 0; k < nodes && !result; k++) {
            result = sbi_gmsh_size(gmsh, "node number", &value);
            if (!result)
                result = sbi_gmsh_cell_node(gmsh, value);
        }
        if (!result)
            result = sbi_loader_end_cell(gmsh->loader, kind, sbi_cell_kind_at(kind)->gmsh_order, region);
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
        result = sbi_gmsh_count(gmsh, "the number of elements", 2 * (size_t)gmsh->size_bytes, 2, &count);
    for (int i = 0; i < 2 && !result; i++)
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
    return gmsh->version == 2 ? sbi_gmsh_elements_2(gmsh) : sbi_gmsh_elements_4(gmsh);
}

/* ---- file ---- */

static int sbi_gmsh_same_text(const char *text, sbi_word word)
{
    return memcmp(text, word.text, word.length) == 0;
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
        if (*here == '$' && memcmp(here, "$End", 4) == 0 && sbi_gmsh_same_text(here + 4, name)) {
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
    if (sbi_reader_word(gmsh->reader, &word) && word.length == name.length + 4 &&
        memcmp(word.text, "$End", 4) == 0 && sbi_gmsh_same_text(word.text + 4, name))
        return SB_OK;
    return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "$End%s is missing", sbi_word_print(name, text));
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
    if (sbi_word_is(version, "4.1"))
        gmsh->version = 4;
    else if (version.length >= 1 && version.text[0] == '2' && (version.length == 1 || version.text[1] == '.'))
        gmsh->version = 2;
    else
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED,
                               "gmsh version %s is not supported: 2.x and 4.1 are",
                               sbi_word_print(version, text));
    result = sbi_reader_integer(gmsh->reader, "file type", &binary);
    if (!result)
        result = sbi_reader_integer(gmsh->reader, "data size", &bytes);
    if (result)
        return result;
    if (binary < 0 || binary > 1 || (bytes != 8 && !(bytes == 4 && gmsh->version == 4)))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "file type %lld with data size %lld",
                               (long long)binary, (long long)bytes);
    gmsh->size_bytes = (int)bytes;
    if (!binary)
        return SB_OK;
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

static sb_result sbi_gmsh_section(sbi_gmsh *gmsh, sbi_word keyword)
{
    sbi_word name = keyword;
    char text[32];
    sb_result result;
    int elements = sbi_word_is(keyword, "$Elements"), nodes = sbi_word_is(keyword, "$Nodes");
    int entities = sbi_word_is(keyword, "$Entities"), format = sbi_word_is(keyword, "$MeshFormat");
    if (keyword.length < 2 || keyword.text[0] != '$')
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "'%s' where a section should begin",
                               sbi_word_print(keyword, text));
    name.text++;
    name.length--;
    if (sbi_word_is(keyword, "$NOD"))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "gmsh version 1 is not supported");
    if (sbi_word_is(keyword, "$PartitionedEntities"))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED,
                               "partitioned gmsh meshes are not supported");
    if (!gmsh->version && (elements || nodes || entities))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "$MeshFormat is missing");
    if (!(elements || nodes || format || (entities && gmsh->version == 4)))
        return sbi_gmsh_skip_section(gmsh, name);
    if (gmsh->binary && !(gmsh->version == 2 && (nodes || elements)))
        sbi_reader_next_line(gmsh->reader);
    if (format)
        result = sbi_gmsh_format(gmsh);
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
    return result;
}
