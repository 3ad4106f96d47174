/* Target: a soup of triangles goes the whole road: checks, repairs, queries, tets, grids, and back as embedded
 * points. */
#ifndef TARGET_GEOMETRY_H
#define TARGET_GEOMETRY_H

#include "fuzz.h"

enum { GEOMETRY_MAX_NODES = 40, GEOMETRY_MAX_FACES = 80 };

typedef struct geometry {
    sb_vec3 nodes[GEOMETRY_MAX_NODES];
    int faces[GEOMETRY_MAX_FACES * 3];
    sb_mesh soup; /* of the arrays above */
} geometry;

/* A closed shape to start from, so that inputs need not find one by chance: an octahedron, pulled about by the
 * bytes. */
static void geometry_make(geometry *g, fuzz_bytes *bytes)
{
    static const int octahedron[24] = {0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4, 2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5};
    static const sb_vec3 corners[6] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
    int whole = fuzz_byte(bytes) % 2, nodes = whole ? 6 : 0, faces = whole ? 8 : 0;
    memset(g, 0, sizeof *g);
    memcpy(g->nodes, corners, sizeof corners);
    memcpy(g->faces, octahedron, sizeof octahedron);
    for (int i = 0; i < nodes; i++)
        g->nodes[i] = sb_v3_madd(g->nodes[i], (sb_real)0.4, fuzz_vector(bytes));
    for (int more = fuzz_byte(bytes) % 30; more > 0; more--)
        g->nodes[nodes++] = fuzz_vector(bytes);
    for (int more = fuzz_byte(bytes) % 60; more > 0; more--, faces++)
        for (int k = 0; k < 3; k++)
            g->faces[3 * faces + k] = fuzz_byte(bytes) % (nodes + 1) - (fuzz_byte(bytes) == 77);
    g->soup.node_count = nodes;
    g->soup.nodes = g->nodes;
    g->soup.element_type = SB_TRI3;
    g->soup.element_count = faces;
    g->soup.elements = g->faces;
}

static void geometry_query(const sb_surface *surface, fuzz_bytes *bytes)
{
    for (int i = 0; i < 8; i++) {
        sb_vec3 p = fuzz_vector(bytes), direction = fuzz_vector(bytes);
        sb_surface_hit near, ray;
        sb_real winding = sb_surface_winding_number(surface, p);
        FUZZ_REQUIRE(winding - winding == 0);
        if (sb_surface_closest(surface, p, SB_REAL_MAX, &near)) {
            FUZZ_REQUIRE(near.triangle >= 0 && near.triangle < sb_surface_triangle_count(surface));
            FUZZ_REQUIRE(near.distance >= 0 && sb_v3_is_finite(near.point));
        }
        if (sb_surface_ray(surface, p, direction, SB_REAL_MAX, &ray))
            FUZZ_REQUIRE(ray.triangle >= 0 && ray.distance >= 0);
        sb_surface_signed_distance(surface, p, &near);
        sb_surface_normal(surface, &near);
    }
}

static void geometry_embed(const sb_mesh *volume, const sb_mesh *surface)
{
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_vec3 out[GEOMETRY_MAX_NODES], normals[GEOMETRY_MAX_NODES];
    def.mesh = volume;
    def.surface = surface;
    if (surface->node_count > GEOMETRY_MAX_NODES || sb_embedding_create(&def, &embedding, NULL) != SB_OK)
        return;
    FUZZ_REQUIRE(sb_embedding_update(embedding, volume->nodes, out, normals, NULL) == SB_OK);
    for (int i = 0; i < surface->node_count; i++)
        FUZZ_REQUIRE(sb_v3_is_finite(out[i]));
    sb_embedding_destroy(embedding);
}

/* Longest side of the triangles over the cells wanted; 0 when that is no sound number. */
static sb_real geometry_cell(const sb_surface *surface, int cells)
{
    sb_vec3 low, high, size;
    sb_real longest;
    sb_surface_bounds(surface, &low, &high);
    size = sb_v3_sub(high, low);
    longest = sb_max(size.x, sb_max(size.y, size.z));
    return sb_is_finite(longest) ? longest / (sb_real)cells : 0;
}

static void geometry_fill(const sb_surface *surface, const sb_mesh *drawn, fuzz_bytes *bytes)
{
    sb_shape shape;
    sb_stuff_def stuff = sb_default_stuff_def();
    sb_stuff_report report;
    sb_grid_def lay = sb_default_grid_def();
    sb_grid grid;
    sb_mesh tets;
    memset(&shape, 0, sizeof shape);
    shape.surface = surface;
    stuff.shapes = &shape;
    stuff.shape_count = 1;
    stuff.cell = geometry_cell(surface, 2 + fuzz_byte(bytes) % 7);
    stuff.levels = fuzz_byte(bytes) % 3;
    if (sb_mesh_stuff(&stuff, &tets, &report, NULL) == SB_OK) {
        FUZZ_REQUIRE(sb_mesh_validate(&tets, NULL) == SB_OK);
        FUZZ_REQUIRE(report.min_dihedral > (sb_real)8.9 && report.max_dihedral < (sb_real)165.7);
        geometry_embed(&tets, drawn);
        sb_mesh_free(&tets);
    }
    lay.outer = shape;
    lay.method = (sb_grid_method)(SB_GRID_SPARSE + fuzz_byte(bytes) % 3);
    lay.level = fuzz_byte(bytes) % 3;
    lay.cell_size = stuff.cell;
    memset(&grid, 0, sizeof grid);
    if (sb_grid_create(&lay, &grid, NULL) == SB_OK) {
        FUZZ_REQUIRE(sb_mesh_validate(&grid.mesh, NULL) == SB_OK && grid.volume > 0);
        geometry_embed(&grid.mesh, drawn);
        sb_grid_free(&grid);
    }
}

static void fuzz_geometry(const uint8_t *data, size_t size)
{
    fuzz_bytes bytes = {data, size, 0};
    sb_surface_report report;
    sb_surface *surface = NULL;
    sb_mesh mesh;
    sb_error error;
    geometry g;
    geometry_make(&g, &bytes);
    if (sb_surface_check(&g.soup, NULL, &report, &error) != SB_OK) {
        FUZZ_REQUIRE(sb_surface_create(&g.soup, NULL, &surface, &error) != SB_OK && error.message[0]);
        return;
    }
    if (sb_mesh_copy(&g.soup, NULL, &mesh, NULL) != SB_OK)
        return;
    if (fuzz_byte(&bytes) % 2) {
        sb_surface_repair_def def = sb_default_surface_repair();
        def.max_hole_edges = fuzz_byte(&bytes) % 20;
        sb_surface_repair(&mesh, &def, NULL, NULL);
    }
    if (sb_surface_create(&mesh, NULL, &surface, NULL) == SB_OK) {
        geometry_query(surface, &bytes);
        geometry_fill(surface, &mesh, &bytes);
        sb_surface_destroy(surface);
    }
    sb_mesh_free(&mesh);
}

#endif /* TARGET_GEOMETRY_H */
