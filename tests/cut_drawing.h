/* cut_drawing.h: what holds of the surface of a body that is cut. */
#ifndef CUT_DRAWING_H
#define CUT_DRAWING_H

#include "cut_block.h"

#include "../src/softbody/cut/cut_surface.h"

/* A side of a triangle, by points. */
typedef struct edge {
    int a, b, turn; /* a < b; turn 1: from b to a */
    int at_a, at_b; /* corners, 3 triangle + k */
} edge;

static inline int edge_order(const void *p, const void *q)
{
    const edge *a = (const edge *)p, *b = (const edge *)q;
    return a->a != b->a ? (a->a > b->a) - (a->a < b->a) : (a->b > b->b) - (a->b < b->b);
}

static inline int is_drawn(const sb_cut_drawing *d, int f) { return d->triangles[f][0] != d->triangles[f][1]; }

/* Edges of all triangles by points, sorted. */
static inline edge *edges_of(const sb_cut_drawing *d, int *count)
{
    edge *edges = (edge *)malloc((size_t)d->triangle_count * 3 * sizeof *edges);
    *count = 0;
    for (int f = 0; f < d->triangle_count; f++)
        for (int k = 0; k < 3 && is_drawn(d, f); k++) {
            int next = (k + 1) % 3, from = d->points[d->triangles[f][k]], to = d->points[d->triangles[f][next]];
            edge *e = edges + (*count)++;
            e->turn = from > to;
            e->a = e->turn ? to : from;
            e->b = e->turn ? from : to;
            e->at_a = 3 * f + (e->turn ? next : k);
            e->at_b = 3 * f + (e->turn ? k : next);
        }
    qsort(edges, (size_t)*count, sizeof *edges, edge_order);
    return edges;
}

static inline int root_of(int *parents, int i)
{
    while (parents[i] != i)
        i = parents[i] = parents[parents[i]];
    return i;
}

static inline void join(int *parents, int i, int j) { parents[root_of(parents, i)] = root_of(parents, j); }

/* Edges that triangles do not go along as often one way as the other; *more: those with more than two, where cuts end
 * in one line. */
static inline int holes_of(const sb_cut_drawing *d, int *more)
{
    int count, holes = 0;
    edge *edges = edges_of(d, &count);
    *more = 0;
    for (int i = 0, end; i < count; i = end) {
        int turns = 0;
        for (end = i; end < count && edge_order(edges + i, edges + end) == 0; end++)
            turns += edges[end].turn ? 1 : -1;
        holes += turns != 0 || edges[i].a == edges[i].b;
        *more += end - i > 2;
    }
    free(edges);
    return holes;
}

/* Every edge has two triangles, one each way. Returns the number of closed surfaces; *euler: the sum of theirs, where a
 * point in which a surface touches itself is one for each fan of triangles around it. */
static inline int check_closed(const sb_cut_drawing *d, int *euler)
{
    int count, open = 0, surfaces = 0, fans = 0, corners = 3 * d->triangle_count;
    edge *edges = edges_of(d, &count);
    int *fan = (int *)malloc((size_t)corners * 2 * sizeof *fan), *surface = fan + corners;
    for (int i = 0; i < corners; i++)
        fan[i] = surface[i] = i;
    for (int i = 0; i < count; i += 2) {
        int pair = i + 1 < count && edge_order(edges + i, edges + i + 1) == 0;
        open += !pair || edges[i].turn == edges[i + 1].turn || edges[i].a == edges[i].b ||
                (i + 2 < count && edge_order(edges + i, edges + i + 2) == 0);
        if (!pair)
            continue;
        join(fan, edges[i].at_a, edges[i + 1].at_a);
        join(fan, edges[i].at_b, edges[i + 1].at_b);
        join(surface, edges[i].at_a / 3, edges[i + 1].at_a / 3);
    }
    for (int i = 0; i < corners; i++)
        fans += is_drawn(d, i / 3) && fan[i] == i;
    for (int f = 0; f < d->triangle_count; f++)
        surfaces += is_drawn(d, f) && surface[f] == f;
    CHECK_INT(open, 0);
    *euler = fans - count / 2 + count / 3;
    free(edges);
    free(fan);
    return surfaces;
}

/* Six times the volume below a triangle. */
static inline double below(const sb_vec3 *x, const int *triangle)
{
    return (double)sb_v3_dot(x[triangle[0]], sb_v3_cross(x[triangle[1]], x[triangle[2]]));
}

/* Volumes within the surfaces of the parts are those of their cells at rest and, shapes 2, now, where these have
 * straight edges; returns how far off they are, of the uncut volume. */
static inline double volumes_error_in(const block *b, const sb_cut_drawing *d, int shapes)
{
    const sb_body *body = b->body;
    double whole = 0, worst = 0;
    int parts = body->component_count;
    double *volumes = (double *)calloc((size_t)parts * 4 + 1, sizeof *volumes);
    for (int f = 0; f < d->triangle_count; f++) {
        int part = -1;
        for (int a = 0; a < 4 && is_drawn(d, f); a++)
            part = part < 0 ? body->node_component[sb_body_cell_nodes(body, d->cells[f])[a]] : part;
        if (part < 0) /* of a piece without volume that is of no part */
            continue;
        volumes[4 * part] += below(d->rest, d->triangles[f]) / 6;
        volumes[4 * part + 1] += below(d->positions, d->triangles[f]) / 6;
    }
    for (int e = 0; e < sb_body_element_count(body); e++) {
        const int *n = sb_body_cell_nodes(body, e);
        if (!sb_body_cell_in_use(body, e) || !(sb_body_cell_share(body, e) > 0))
            continue;
        for (int now = 0; now < 2; now++) {
            const sb_vec3 *x = now ? sb_body_positions(body) : body->reference;
            sb_vec3 a = sb_v3_sub(x[n[1]], x[n[0]]), c = sb_v3_sub(x[n[2]], x[n[0]]), g = sb_v3_sub(x[n[3]], x[n[0]]);
            volumes[4 * body->node_component[n[0]] + 2 + now] +=
                (double)sb_body_cell_share(body, e) * (double)sb_v3_dot(a, sb_v3_cross(c, g)) / 6;
        }
    }
    for (int e = 0; e < b->mesh.element_count; e++)
        whole += (double)sb_mesh_element_volume(&b->mesh, e);
    for (int part = 0; part < parts; part++)
        for (int now = 0; now < shapes; now++)
            worst = fmax(worst, fabs(volumes[4 * part + now] - volumes[4 * part + 2 + now]) / whole);
    free(volumes);
    return worst;
}

static inline double volumes_error(const block *b, const sb_cut_drawing *d) { return volumes_error_in(b, d, 2); }

/* Area at rest of what has a tag. */
static inline double area_of(const sb_cut_drawing *d, int tag)
{
    double area = 0;
    for (int f = 0; f < d->triangle_count; f++) {
        const int *v = d->triangles[f];
        if (d->tags[f] == tag && is_drawn(d, f))
            area += (double)sb_v3_norm(
                        sb_v3_cross(sb_v3_sub(d->rest[v[1]], d->rest[v[0]]), sb_v3_sub(d->rest[v[2]], d->rest[v[0]]))) /
                    2;
    }
    return area;
}

#endif /* CUT_DRAWING_H */
