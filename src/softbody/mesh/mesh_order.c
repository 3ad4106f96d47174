/* mesh_order: nodes and elements renumbered for small bandwidth and good cache use. */
#include "mesh_private.h"

/* ---- reverse Cuthill-McKee ----
 * George & Liu: number nodes breadth first from a node at an end of the graph, neighbours by ascending
 * degree, and reverse the order. Two nodes are neighbours when they share an element. */

typedef struct sbi_mesh_graph {
    const sb_mesh *mesh;
    sb_index_lists elements; /* of each node */
    int *degree;             /* [nodes] elements of the node: known without a graph, and ordered much like the number of
                              * neighbours */
    int *mark;               /* [nodes] search that saw the node last */
    int search;
    int *order; /* [nodes] */
} sbi_mesh_graph;

static int sbi_mesh_graph_less(const sbi_mesh_graph *graph, int a, int b)
{
    return graph->degree[a] != graph->degree[b] ? graph->degree[a] < graph->degree[b] : a < b;
}

static void sbi_mesh_sift_down(const sbi_mesh_graph *graph, int *nodes, int root, int count)
{
    for (int child = 2 * root + 1; child < count; root = child, child = 2 * root + 1) {
        if (child + 1 < count && sbi_mesh_graph_less(graph, nodes[child], nodes[child + 1]))
            child++;
        if (!sbi_mesh_graph_less(graph, nodes[root], nodes[child]))
            return;
        sbi_mesh_swap(nodes, root, child);
    }
}

/* Heap sort by degree, then number: no worst case, no recursion. */
static void sbi_mesh_sort_by_degree(const sbi_mesh_graph *graph, int *nodes, int count)
{
    for (int i = count / 2 - 1; i >= 0; i--)
        sbi_mesh_sift_down(graph, nodes, i, count);
    for (int i = count - 1; i > 0; i--) {
        sbi_mesh_swap(nodes, 0, i);
        sbi_mesh_sift_down(graph, nodes, 0, i);
    }
}

/* Appends the unseen neighbours of a node to the order at `end`; returns the new end. */
static int sbi_mesh_graph_visit(sbi_mesh_graph *graph, int node, int end)
{
    int n = sb_mesh_element_width(graph->mesh), begin = end;
    for (int i = graph->elements.offsets[node]; i < graph->elements.offsets[node + 1]; i++) {
        const int *nodes = sbi_mesh_element(graph->mesh, graph->elements.items[i]);
        for (int a = 0; a < n; a++) {
            if (graph->mark[nodes[a]] != graph->search) {
                graph->mark[nodes[a]] = graph->search;
                graph->order[end++] = nodes[a];
            }
        }
    }
    sbi_mesh_sort_by_degree(graph, graph->order + begin, end - begin);
    return end;
}

/* Breadth-first order from `start`, written from position `begin`; *depth: levels; *last: begin of the last
 * level. Returns the end. */
static int sbi_mesh_graph_search(sbi_mesh_graph *graph, int start, int begin, int *depth, int *last)
{
    int end = begin + 1, level = begin;
    graph->search++;
    graph->mark[start] = graph->search;
    graph->order[begin] = start;
    *depth = 0;
    while (level < end) {
        int level_end = end;
        *last = level;
        ++*depth;
        for (; level < level_end; level++)
            end = sbi_mesh_graph_visit(graph, graph->order[level], end);
    }
    return end;
}

/* Numbers the part around `start` from position `begin`: from a far end, found by searching again from the
 * least connected node of the last level as long as that goes deeper (a few times: each search costs the
 * whole part). */
static int sbi_mesh_graph_number(sbi_mesh_graph *graph, int start, int begin)
{
    int depth, last, end = sbi_mesh_graph_search(graph, start, begin, &depth, &last);
    for (int attempt = 0; attempt < 6; attempt++) {
        int candidate = graph->order[last], deeper, before = start;
        for (int i = last + 1; i < end; i++)
            if (sbi_mesh_graph_less(graph, graph->order[i], candidate))
                candidate = graph->order[i];
        start = candidate;
        sbi_mesh_graph_search(graph, start, begin, &deeper, &last);
        if (deeper < depth) {
            sbi_mesh_graph_search(graph, before, begin, &deeper, &last);
            break;
        }
        if (deeper == depth)
            break;
        depth = deeper;
    }
    return end;
}

/* Parts are taken from their least connected node on, by ascending degree. */
static void sbi_mesh_graph_order(sbi_mesh_graph *graph, int *by_degree, int *done)
{
    int count = graph->mesh->node_count, end = 0;
    for (int v = 0; v < count; v++) {
        by_degree[v] = v;
        done[v] = 0;
        graph->mark[v] = 0;
        graph->degree[v] = graph->elements.offsets[v + 1] - graph->elements.offsets[v];
    }
    sbi_mesh_sort_by_degree(graph, by_degree, count);
    for (int i = 0; i < count; i++) {
        int begin = end;
        if (done[by_degree[i]])
            continue;
        end = sbi_mesh_graph_number(graph, by_degree[i], begin);
        for (int k = begin; k < end; k++)
            done[graph->order[k]] = 1;
    }
}

/* Scratch of a reordering. */
typedef struct sbi_mesh_renumbering {
    sbi_mesh_graph graph;
    int *node_map, *element_map, *start; /* [nodes], [elements], [nodes + 1] */
    sb_vec3 *nodes;
    int *elements;
    int *regions;
} sbi_mesh_renumbering;

static void sbi_mesh_renumbering_free(const sb_allocator *allocator, sbi_mesh_renumbering *r)
{
    sb_index_lists_free(&r->graph.elements);
    sbi_free(allocator, r->graph.degree);
    sbi_free(allocator, r->graph.mark);
    sbi_free(allocator, r->graph.order);
    sbi_free(allocator, r->node_map);
    sbi_free(allocator, r->element_map);
    sbi_free(allocator, r->start);
    sbi_free(allocator, r->nodes);
    sbi_free(allocator, r->elements);
    sbi_free(allocator, r->regions);
}

static int sbi_mesh_renumbering_allocate(const sb_mesh *mesh, sbi_mesh_renumbering *r)
{
    const sb_allocator *allocator = &mesh->allocator;
    size_t nodes = (size_t)mesh->node_count, elements = (size_t)mesh->element_count;
    memset(r, 0, sizeof *r);
    r->graph.mesh = mesh;
    r->graph.degree = (int *)sbi_alloc(allocator, nodes, sizeof(int));
    r->graph.mark = (int *)sbi_alloc(allocator, nodes, sizeof(int));
    r->graph.order = (int *)sbi_alloc(allocator, nodes, sizeof(int));
    r->node_map = (int *)sbi_alloc(allocator, nodes, sizeof(int));
    r->element_map = (int *)sbi_alloc(allocator, elements, sizeof(int));
    r->start = (int *)sbi_alloc(allocator, nodes + 1, sizeof(int));
    r->nodes = (sb_vec3 *)sbi_alloc(allocator, nodes, sizeof(sb_vec3));
    r->elements = (int *)sbi_alloc(allocator, elements, sizeof(int) * (size_t)sb_mesh_element_width(mesh));
    if (mesh->regions)
        r->regions = (int *)sbi_alloc(allocator, elements, sizeof(int));
    return r->graph.degree && r->graph.mark && r->graph.order && r->node_map && r->element_map && r->start &&
           r->nodes && r->elements && (r->regions || !mesh->regions) &&
           sbi_mesh_lists_make(mesh, allocator, &r->graph.elements);
}

/* New element numbers by lowest new node, ties by old number: a counting sort. */
static void sbi_mesh_renumber_elements(const sb_mesh *mesh, sbi_mesh_renumbering *r)
{
    int n = sb_mesh_element_width(mesh);
    memset(r->start, 0, sizeof(int) * ((size_t)mesh->node_count + 1));
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        int lowest = r->node_map[nodes[0]];
        for (int a = 1; a < n; a++)
            lowest = r->node_map[nodes[a]] < lowest ? r->node_map[nodes[a]] : lowest;
        r->element_map[e] = lowest;
        r->start[lowest + 1]++;
    }
    for (int v = 0; v < mesh->node_count; v++)
        r->start[v + 1] += r->start[v];
    for (int e = 0; e < mesh->element_count; e++)
        r->element_map[e] = r->start[r->element_map[e]]++;
}

static void sbi_mesh_renumbering_apply(sb_mesh *mesh, sbi_mesh_renumbering *r)
{
    size_t n = (size_t)sb_mesh_element_width(mesh);
    for (int v = 0; v < mesh->node_count; v++)
        r->nodes[r->node_map[v]] = mesh->nodes[v];
    for (int e = 0; e < mesh->element_count; e++) {
        for (size_t a = 0; a < n; a++)
            r->elements[(size_t)r->element_map[e] * n + a] = r->node_map[mesh->elements[(size_t)e * n + a]];
        if (mesh->regions)
            r->regions[r->element_map[e]] = mesh->regions[e];
    }
    memcpy(mesh->nodes, r->nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
    memcpy(mesh->elements, r->elements, sizeof(int) * n * (size_t)mesh->element_count);
    if (mesh->regions)
        memcpy(mesh->regions, r->regions, sizeof(int) * (size_t)mesh->element_count);
}

SB_API sb_result sb_mesh_reorder(sb_mesh *mesh, int *node_map, int *element_map, sb_error *error)
{
    sbi_mesh_renumbering r;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (sbi_mesh_renumbering_allocate(mesh, &r)) {
        sbi_mesh_graph_order(&r.graph, r.node_map, r.start);
        for (int v = 0; v < mesh->node_count; v++)
            r.node_map[r.graph.order[v]] = mesh->node_count - 1 - v;
        sbi_mesh_renumber_elements(mesh, &r);
        sbi_mesh_renumbering_apply(mesh, &r);
        if (node_map)
            memcpy(node_map, r.node_map, sizeof(int) * (size_t)mesh->node_count);
        if (element_map)
            memcpy(element_map, r.element_map, sizeof(int) * (size_t)mesh->element_count);
    } else {
        result = sbi_mesh_no_memory(error);
    }
    sbi_mesh_renumbering_free(&mesh->allocator, &r);
    return result;
}
