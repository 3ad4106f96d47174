/* mesh_keys: what is the same: parts of elements with the same corners, elements that hang together, nodes in one
 * place.
 *
 * Faces, edges and whole elements are compared through their corner nodes sorted ascending ("keys"). Sorting
 * the keys column by column with counting sort takes linear time whatever the numbering, needs no hashing,
 * and leaves equal keys side by side in the order of the elements, so every result is unique. */
#include "mesh_private.h"

/* ---- keys: faces, edges and elements by their sorted corners ---- */

SBI_API void sbi_mesh_keys_free(const sb_allocator *allocator, sbi_mesh_keys *keys)
{
    sbi_free(allocator, keys->keys);
    sbi_free(allocator, keys->order);
    memset(keys, 0, sizeof *keys);
}

/* Local corner numbers of a part of an element; returns how many. */
static int sbi_mesh_part_corners(sbi_element element, sbi_mesh_part part, int index, int corners[SB_MAX_ELEMENT_NODES])
{
    sb_element_type face_type = SB_NO_ELEMENT;
    if (part == SBI_MESH_WHOLE) {
        int count = sbi_element_corner_count(element);
        for (int a = 0; a < count; a++)
            corners[a] = a;
        return count;
    }
    if (part == SBI_MESH_EDGES || sb_element_dimension(element.type) == 2) {
        sbi_element_edge(element, index, corners);
        return 2;
    }
    sbi_element_face(element, index, corners, &face_type);
    return sb_element_corner_count(face_type);
}

static int sbi_mesh_parts_per_element(sbi_element element, sbi_mesh_part part)
{
    if (part == SBI_MESH_WHOLE)
        return 1;
    return part == SBI_MESH_EDGES || sb_element_dimension(element.type) == 2 ? sbi_element_edge_count(element)
                                                                             : sbi_element_face_count(element);
}

static void sbi_mesh_insertion_sort(int *values, int count)
{
    for (int i = 1; i < count; i++) {
        int value = values[i], j = i;
        for (; j > 0 && values[j - 1] > value; j--)
            values[j] = values[j - 1];
        values[j] = value;
    }
}

static void sbi_mesh_keys_fill(const sb_mesh *mesh, sbi_mesh_part part, const unsigned char *skip, sbi_mesh_keys *keys)
{
    int corners[SB_MAX_ELEMENT_EDGES][SB_MAX_ELEMENT_NODES], count[SB_MAX_ELEMENT_EDGES];
    for (int i = 0; i < keys->per_element; i++)
        count[i] = sbi_mesh_part_corners(sbi_mesh_element_kind(mesh), part, i, corners[i]);
    keys->sorted = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        for (int i = 0; i < keys->per_element && !(skip && skip[e]); i++) {
            int p = e * keys->per_element + i;
            int *key = keys->keys + (size_t)p * (size_t)keys->width;
            for (int k = 0; k < count[i]; k++)
                key[k] = nodes[corners[i][k]];
            sbi_mesh_insertion_sort(key, count[i]);
            for (int k = count[i]; k < keys->width; k++)
                key[k] = key[k - 1];
            keys->order[keys->sorted++] = p;
        }
    }
}

/* One stable counting sort of the order by a column of the keys; start has node_count + 1 entries. */
static void sbi_mesh_sort_column(const sbi_mesh_keys *keys, int column, int node_count, const int *from, int *to,
                                 int *start)
{
    const int *value = keys->keys + column;
    memset(start, 0, sizeof(int) * ((size_t)node_count + 1));
    for (int i = 0; i < keys->sorted; i++)
        start[value[(size_t)from[i] * (size_t)keys->width] + 1]++;
    for (int v = 0; v < node_count; v++)
        start[v + 1] += start[v];
    for (int i = 0; i < keys->sorted; i++)
        to[start[value[(size_t)from[i] * (size_t)keys->width]]++] = from[i];
}

static int sbi_mesh_keys_sort(const sb_allocator *allocator, sbi_mesh_keys *keys, int node_count)
{
    int *other = (int *)sbi_alloc(allocator, (size_t)keys->sorted, sizeof(int));
    int *start = (int *)sbi_alloc(allocator, (size_t)node_count + 1, sizeof(int));
    int ok = other && start;
    for (int column = keys->width - 1; ok && column >= 0; column--) {
        int *swap = keys->order;
        sbi_mesh_sort_column(keys, column, node_count, keys->order, other, start);
        keys->order = other;
        other = swap;
    }
    sbi_free(allocator, other);
    sbi_free(allocator, start);
    return ok;
}

SBI_API int sbi_mesh_keys_make(const sb_mesh *mesh, sbi_mesh_part part, const unsigned char *skip,
                               const sb_allocator *allocator, sbi_mesh_keys *keys)
{
    int corners[SB_MAX_ELEMENT_NODES];
    sbi_element element = sbi_mesh_element_kind(mesh);
    memset(keys, 0, sizeof *keys);
    keys->per_element = sbi_mesh_parts_per_element(element, part);
    for (int i = 0; i < keys->per_element; i++)
        keys->width = sbi_max_int(keys->width, sbi_mesh_part_corners(element, part, i, corners));
    if (mesh->element_count > INT_MAX / keys->per_element)
        return 0;
    keys->count = mesh->element_count * keys->per_element;
    keys->keys = (int *)sbi_alloc(allocator, (size_t)keys->count, sizeof(int) * (size_t)keys->width);
    keys->order = (int *)sbi_alloc(allocator, (size_t)keys->count, sizeof(int));
    if (keys->keys && keys->order) {
        sbi_mesh_keys_fill(mesh, part, skip, keys);
        if (sbi_mesh_keys_sort(allocator, keys, mesh->node_count))
            return 1;
    }
    sbi_mesh_keys_free(allocator, keys);
    return 0;
}

SBI_API int sbi_mesh_run_end(const sbi_mesh_keys *keys, int begin)
{
    size_t width = (size_t)keys->width;
    const int *key = keys->keys + (size_t)keys->order[begin] * width;
    int end = begin + 1;
    while (end < keys->sorted && memcmp(key, keys->keys + (size_t)keys->order[end] * width, sizeof(int) * width) == 0)
        end++;
    return end;
}

SBI_API int *sbi_mesh_mates(const sbi_mesh_keys *keys, const sb_allocator *allocator)
{
    int *mate = (int *)sbi_alloc(allocator, (size_t)keys->count, sizeof(int));
    for (int p = 0; mate && p < keys->count; p++)
        mate[p] = SBI_MESH_CROWDED;
    for (int begin = 0, end; mate && begin < keys->sorted; begin = end) {
        end = sbi_mesh_run_end(keys, begin);
        if (end == begin + 1)
            mate[keys->order[begin]] = SBI_MESH_ALONE;
        if (end == begin + 2) {
            mate[keys->order[begin]] = keys->order[begin + 1];
            mate[keys->order[begin + 1]] = keys->order[begin];
        }
    }
    return mate;
}

/* ---- disjoint sets ---- */

static int sbi_mesh_find(int *parent, int i)
{
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}

SBI_API void sbi_mesh_unite(int *parent, int a, int b)
{
    int root_a = sbi_mesh_find(parent, a), root_b = sbi_mesh_find(parent, b);
    if (root_a < root_b)
        parent[root_b] = root_a;
    else
        parent[root_a] = root_b;
}

SBI_API int sbi_mesh_label_components(const sb_mesh *mesh, const unsigned char *skip, int *label, int *scratch)
{
    int n = sb_mesh_element_width(mesh), count = 0;
    for (int v = 0; v < mesh->node_count; v++)
        scratch[v] = -1;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        label[e] = e;
        for (int a = 0; a < n && !(skip && skip[e]); a++) {
            if (scratch[nodes[a]] < 0)
                scratch[nodes[a]] = e;
            else
                sbi_mesh_unite(label, e, scratch[nodes[a]]);
        }
    }
    /* Roots precede their members: flatten in order, numbering roots as -2 - number until all are reached. */
    for (int e = 0; e < mesh->element_count; e++)
        label[e] = sbi_mesh_find(label, e);
    for (int e = 0; e < mesh->element_count; e++) {
        if (skip && skip[e])
            label[e] = -1;
        else
            label[e] = label[e] == e ? -2 - count++ : label[label[e]];
    }
    for (int e = 0; e < mesh->element_count; e++)
        label[e] = label[e] == -1 ? -1 : -2 - label[e];
    return count;
}

/* ---- nodes that coincide ---- */

typedef struct sbi_mesh_grid {
    sb_vec3 low;
    sb_real cell, tolerance; /* m */
    uint64_t mask;           /* buckets - 1 */
    int *head;               /* [buckets] last node of each bucket, or -1 */
    int *next;               /* [nodes] */
} sbi_mesh_grid;

static int64_t sbi_mesh_grid_cell(sb_real position)
{
    int64_t cell = (int64_t)position;
    return (sb_real)cell > position ? cell - 1 : cell;
}

static size_t sbi_mesh_grid_bucket(const sbi_mesh_grid *grid, int64_t i, int64_t j, int64_t k)
{
    uint64_t hash = (uint64_t)i * 0x9E3779B97F4A7C15u;
    hash = (hash ^ (hash >> 29) ^ (uint64_t)j) * 0xBF58476D1CE4E5B9u;
    hash = (hash ^ (hash >> 32) ^ (uint64_t)k) * 0x94D049BB133111EBu;
    return (size_t)((hash ^ (hash >> 31)) & grid->mask);
}

static int sbi_mesh_is_near(sb_vec3 a, sb_vec3 b, sb_real tolerance)
{
    sb_vec3 d = sb_v3_sub(a, b);
    if (tolerance <= 0)
        return d.x == 0 && d.y == 0 && d.z == 0;
    d = sb_v3(d.x / tolerance, d.y / tolerance, d.z / tolerance);
    return sb_v3_dot(d, d) <= 1;
}

/* Smallest node of the grid within tolerance of node `node`, or -1. */
static int sbi_mesh_grid_find(const sbi_mesh_grid *grid, const sb_vec3 *nodes, int node)
{
    const sb_real reach = grid->tolerance;
    sb_vec3 d = sb_v3_sub(nodes[node], grid->low);
    int64_t i1 = sbi_mesh_grid_cell((d.x + reach) / grid->cell), j1 = sbi_mesh_grid_cell((d.y + reach) / grid->cell),
            k1 = sbi_mesh_grid_cell((d.z + reach) / grid->cell);
    int best = -1;
    for (int64_t i = sbi_mesh_grid_cell((d.x - reach) / grid->cell); i <= i1; i++)
        for (int64_t j = sbi_mesh_grid_cell((d.y - reach) / grid->cell); j <= j1; j++)
            for (int64_t k = sbi_mesh_grid_cell((d.z - reach) / grid->cell); k <= k1; k++)
                for (int v = grid->head[sbi_mesh_grid_bucket(grid, i, j, k)]; v >= 0; v = grid->next[v])
                    if ((best < 0 || v < best) && sbi_mesh_is_near(nodes[v], nodes[node], reach))
                        best = v;
    return best;
}

static void sbi_mesh_grid_add(const sbi_mesh_grid *grid, const sb_vec3 *nodes, int node)
{
    sb_vec3 d = sb_v3_sub(nodes[node], grid->low);
    size_t bucket = sbi_mesh_grid_bucket(grid, sbi_mesh_grid_cell(d.x / grid->cell),
                                         sbi_mesh_grid_cell(d.y / grid->cell), sbi_mesh_grid_cell(d.z / grid->cell));
    grid->next[node] = grid->head[bucket];
    grid->head[bucket] = node;
}

/* Cells of four tolerances keep the nodes per cell few and mostly spare a look at the neighbours; never below
 * the spacing of numbers, so that cell indices fit. 0: the box is too large for its size to be a number. */
static int sbi_mesh_grid_setup(const sb_mesh *mesh, sb_real tolerance, sbi_mesh_grid *grid)
{
    sb_vec3 high = sb_v3(0, 0, 0);
    sb_real extent;
    grid->low = high;
    sbi_mesh_finite_bounds(mesh, &grid->low, &high);
    extent = sbi_mesh_max_abs(sb_v3_sub(high, grid->low));
    if (!sb_is_finite(2 * extent))
        return 0;
    grid->tolerance = tolerance < 0 ? (sb_real)1e-6 * extent : sb_min(tolerance, 2 * extent);
    grid->cell = sb_max(4 * (grid->tolerance < extent ? grid->tolerance : extent), 4 * SB_EPSILON * extent);
    if (!(grid->cell > 0))
        grid->cell = 1; /* all nodes in one point */
    return 1;
}

SBI_API int sbi_mesh_find_duplicates(const sb_mesh *mesh, sb_real tolerance, const sb_allocator *allocator,
                                     int *representative)
{
    sbi_mesh_grid grid;
    size_t buckets = 1;
    int removed = 0;
    for (int v = 0; v < mesh->node_count; v++)
        representative[v] = v;
    if (!sbi_mesh_grid_setup(mesh, tolerance, &grid))
        return 0;
    while (buckets < (size_t)mesh->node_count)
        buckets *= 2;
    grid.mask = buckets - 1;
    grid.head = (int *)sbi_alloc(allocator, buckets, sizeof(int));
    grid.next = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    for (size_t i = 0; grid.head && i < buckets; i++)
        grid.head[i] = -1;
    for (int v = 0; grid.head && grid.next && v < mesh->node_count; v++) {
        int near = sb_v3_is_finite(mesh->nodes[v]) ? sbi_mesh_grid_find(&grid, mesh->nodes, v) : v;
        if (near < 0)
            sbi_mesh_grid_add(&grid, mesh->nodes, v);
        else if (near != v)
            representative[v] = near, removed++;
    }
    if (!grid.head || !grid.next)
        removed = -1;
    sbi_free(allocator, grid.head);
    sbi_free(allocator, grid.next);
    return removed;
}

SBI_API int sbi_mesh_edge_ascends(const sb_mesh *mesh, int element, int side)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int ends[3] = {0, 0, 0};
    sb_element_edge(mesh->element_type, side, ends); /* of a surface: never custom */
    return nodes[ends[0]] < nodes[ends[1]];
}

SBI_API int sbi_mesh_count_runs(const sbi_mesh_keys *keys)
{
    int runs = 0;
    for (int begin = 0; begin < keys->sorted; begin = sbi_mesh_run_end(keys, begin))
        runs++;
    return runs;
}
