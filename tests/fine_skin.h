/* fine_skin.h: skins that are finer than the boundary of a mesh, and not quite where it is; and what holds of one that
 * is cut along. */
#ifndef FINE_SKIN_H
#define FINE_SKIN_H

#include "cut_drawing.h"

#include "../src/softbody/cut/cut_fine.h"
#include "../src/softbody/cut/cut_fine_private.h"

/* Number of the edge between two nodes, of all edges in their order. */
static inline int fine_skin_edge(const sb_index_table *edges, int a, int b)
{
    int low = 0, high = edges->rows, first = a < b ? a : b, last = a < b ? b : a;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        const int *ends = edges->items + 2 * (size_t)middle;
        if (ends[0] < first || (ends[0] == first && ends[1] <= last))
            low = middle;
        else
            high = middle;
    }
    return low;
}

/* Each triangle in four. Nodes on edges are off their middles along them by up to a tenth, and by noise of their
 * lengths anywhere. */
static inline sb_mesh fine_skin_refine(const sb_mesh *coarse, double noise, unsigned long long *seed)
{
    static const int parts[4][3] = {{0, 3, 5}, {3, 1, 4}, {5, 4, 2}, {3, 4, 5}};
    sb_index_table edges;
    sb_mesh lists, fine;
    memset(&lists, 0, sizeof lists);
    CHECK_OK(sb_mesh_edges(coarse, NULL, &edges, NULL));
    lists.element_type = SB_TRI3;
    lists.node_count = coarse->node_count + edges.rows;
    lists.element_count = 4 * coarse->element_count;
    lists.nodes = (sb_vec3 *)malloc((size_t)lists.node_count * sizeof(sb_vec3));
    lists.elements = (int *)malloc((size_t)lists.element_count * 3 * sizeof(int));
    memcpy(lists.nodes, coarse->nodes, (size_t)coarse->node_count * sizeof(sb_vec3));
    for (int e = 0; e < edges.rows; e++) {
        sb_vec3 from = coarse->nodes[edges.items[2 * e]], to = coarse->nodes[edges.items[2 * e + 1]];
        double t = check_random_in(seed, 0.4, 0.6), off = noise * (double)sb_v3_norm(sb_v3_sub(to, from));
        sb_vec3 at = sb_v3_madd(sb_v3_scale(REAL(1 - t), from), REAL(t), to), away;
        away.x = REAL(check_random_in(seed, -off, off));
        away.y = REAL(check_random_in(seed, -off, off));
        away.z = REAL(check_random_in(seed, -off, off));
        lists.nodes[coarse->node_count + e] = sb_v3_add(at, away);
    }
    for (int f = 0; f < coarse->element_count; f++) {
        int v[6];
        memcpy(v, coarse->elements + 3 * (size_t)f, 3 * sizeof(int));
        for (int k = 0; k < 3; k++)
            v[3 + k] = coarse->node_count + fine_skin_edge(&edges, v[k], v[(k + 1) % 3]);
        for (int k = 0; k < 12; k++)
            lists.elements[12 * (size_t)f + (size_t)k] = v[parts[k / 3][k % 3]];
    }
    CHECK_OK(sb_mesh_copy(&lists, NULL, &fine, NULL));
    free(lists.nodes);
    free(lists.elements);
    sb_index_table_free(&edges);
    return fine;
}

/* The boundary of a mesh of linear elements, each triangle in 4^times. */
static inline sb_mesh fine_skin_of(const sb_mesh *mesh, int times, double noise, unsigned long long *seed)
{
    sb_boundary boundary;
    sb_mesh skin;
    CHECK_OK(sb_mesh_boundary(mesh, 1, NULL, &boundary, NULL));
    CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &skin, NULL));
    sb_boundary_free(&boundary);
    for (int i = 0; i < times; i++) {
        sb_mesh finer = fine_skin_refine(&skin, noise, seed);
        sb_mesh_free(&skin);
        skin = finer;
    }
    return skin;
}

/* What rims are like, added up. */
typedef struct fine_rims {
    int drawings, triangles;
    double area, apart,
        between;    /* of all of them; of those with corners on two sides of a cut, and of two parts (m^2) */
    double longest; /* edge (m) */
} fine_rims;

/* The part that a cell belongs to; -1: it is a film, and so is all beside it. */
static inline int fine_part_of(const sb_body *body, int cell)
{
    int part = -1;
    for (int a = 0; a < 4; a++) {
        int of_node = body->node_component[sb_body_cell_nodes(body, cell)[a]]; /* -1: of films alone */
        part = of_node > part ? of_node : part;
    }
    return part;
}

static inline void fine_rims_add(fine_rims *rims, const sb_cut *cut, const sb_cut_fine *fine)
{
    const sb_body *body = cut->body;
    sb_cut_drawing d = sb_cut_fine_get(fine).drawn;
    rims->drawings++;
    for (int f = 0; f < d.triangle_count; f++) {
        const int *v = d.triangles[f];
        sb_vec3 a = sb_v3_sub(d.rest[v[1]], d.rest[v[0]]), b = sb_v3_sub(d.rest[v[2]], d.rest[v[0]]);
        double area = (double)sb_v3_norm(sb_v3_cross(a, b)) / 2;
        int apart = 0, between = 0;
        if (d.tags[f] != SB_CUT_RIM)
            continue;
        for (int k = 0; k < 3; k++) {
            const sbi_fine_place *p = fine->now.places + v[k], *q = fine->now.places + v[(k + 1) % 3];
            apart |= sbi_fine_are_apart(cut, p, q);
            between |= fine_part_of(body, p->cell) >= 0 && fine_part_of(body, q->cell) >= 0 &&
                       fine_part_of(body, p->cell) != fine_part_of(body, q->cell);
            rims->longest = fmax(rims->longest, (double)sb_v3_norm(sb_v3_sub(d.rest[v[k]], d.rest[v[(k + 1) % 3]])));
        }
        rims->triangles++;
        rims->area += area;
        rims->apart += apart ? area : 0;
        rims->between += between ? area : 0;
    }
}

#endif /* FINE_SKIN_H */
