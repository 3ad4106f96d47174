/* meshgen: blocks of cells for simple solids.
 *
 * Every generator numbers its nodes and lists its cells as hexahedra whose top nodes are numbered after
 * and in the same order as their bottom nodes. A hexahedron is cut into tets so that every one of its
 * quadrilaterals is halved by the diagonal through its lowest-numbered node: two cells then cut a common
 * face alike, however they lie. */
#include "meshgen.h"

#include <limits.h>
#include <string.h>

/* ---- building ---- */

typedef struct sbi_meshgen_builder {
    sb_mesh mesh; /* tet4 or hex8; made quadratic at the end */
    int next;     /* elements written */
} sbi_meshgen_builder;

/* a * b for counts up to 2^31, held below 2^31 + 1 so that products can be chained and then compared. */
static int64_t sbi_meshgen_product(int64_t a, int64_t b)
{
    int64_t limit = (int64_t)INT_MAX + 1;
    return a * b < limit ? a * b : limit;
}

/* Checks the type and the counts, and makes the arrays. */
static sb_result sbi_meshgen_begin(sbi_meshgen_builder *builder, sb_element_type type, int64_t nodes, int64_t cells,
                                   const sb_allocator *allocator, sb_error *error)
{
    sb_element_type straight = sb_element_straight(type);
    int64_t elements = sbi_meshgen_product(cells, straight == SB_HEX8 ? 1 : 6);
    if (nodes > INT_MAX || elements > INT_MAX)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "too many cells: the nodes or elements do not fit an int");
    builder->next = 0;
    if (!sbi_mesh_allocate(&builder->mesh, straight, (int)nodes, (int)elements, 0, allocator))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a mesh of %d nodes", (int)nodes);
    return SB_OK;
}

static sb_result sbi_meshgen_check(sb_element_type type, const sb_mesh *mesh, sb_error *error)
{
    if (!mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh is NULL");
    if (sb_element_straight(type) != SB_TET4 && sb_element_straight(type) != SB_HEX8)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cannot generate elements of type %d", (int)type);
    return SB_OK;
}

static int sbi_meshgen_is_length(sb_real length) { return length > 0 && sb_is_finite(length); }

/* Hands the mesh over, as the quadratic element that was asked for. */
static sb_result sbi_meshgen_finish(sbi_meshgen_builder *builder, sb_element_type type, sb_mesh *mesh, sb_error *error)
{
    sb_result result = SB_OK;
    sb_allocator allocator = builder->mesh.allocator;
    if (type == builder->mesh.element_type) {
        *mesh = builder->mesh;
        return SB_OK;
    }
    if (type == SB_TET10)
        result = sb_mesh_to_tet10(&builder->mesh, &allocator, mesh, error);
    else if (type == SB_HEX20)
        result = sb_mesh_to_hex20(&builder->mesh, &allocator, mesh, error);
    else
        result = sb_mesh_to_hex27(&builder->mesh, &allocator, mesh, error);
    sb_mesh_free(&builder->mesh);
    return result;
}

static void sbi_meshgen_add_tet(sbi_meshgen_builder *builder, int even, int a, int b, int c, int d)
{
    int *nodes = builder->mesh.elements + 4 * (size_t)builder->next++;
    nodes[0] = a;
    nodes[1] = b;
    nodes[2] = even ? c : d;
    nodes[3] = even ? d : c;
}

/* Cuts the prism over triangle low[0..2] (counter-clockwise seen from its top high[0..2]) into 3 tets: with
 * the bottom sorted to p < q < r, the side diagonals run from p to q', p to r' and q to r'. */
static void sbi_meshgen_add_prism(sbi_meshgen_builder *builder, const int low[3], const int high[3])
{
    int p = low[0] < low[1] ? (low[0] < low[2] ? 0 : 2) : (low[1] < low[2] ? 1 : 2);
    int q = (p + 1) % 3, r = (p + 2) % 3, even = low[q] < low[r];
    if (!even)
        q = (p + 2) % 3, r = (p + 1) % 3;
    sbi_meshgen_add_tet(builder, even, low[p], low[q], low[r], high[r]);
    sbi_meshgen_add_tet(builder, even, low[p], low[q], high[r], high[q]);
    sbi_meshgen_add_tet(builder, even, low[p], high[p], high[q], high[r]);
}

/* One cell: bottom 0 to 3 counter-clockwise seen from the top 4 to 7. */
static void sbi_meshgen_add_cell(sbi_meshgen_builder *builder, const int cell[8])
{
    int first = 0;
    if (builder->mesh.element_type == SB_HEX8) {
        memcpy(builder->mesh.elements + 8 * (size_t)builder->next++, cell, 8 * sizeof(int));
        return;
    }
    for (int a = 1; a < 4; a++)
        first = cell[a] < cell[first] ? a : first;
    for (int half = 1; half <= 2; half++) {
        int low[3], high[3], corner[3];
        corner[0] = first;
        corner[1] = (first + half) % 4;
        corner[2] = (first + half + 1) % 4;
        for (int i = 0; i < 3; i++) {
            low[i] = cell[corner[i]];
            high[i] = cell[corner[i] + 4];
        }
        sbi_meshgen_add_prism(builder, low, high);
    }
}

/* The cell at (i, j, k) of a grid of nodes with x fastest, nx and ny nodes per row and column. */
static void sbi_meshgen_grid_cell(int i, int j, int k, int nx, int ny, int cell[8])
{
    int base = i + nx * (j + ny * k);
    cell[0] = base;
    cell[1] = base + 1;
    cell[2] = base + nx + 1;
    cell[3] = base + nx;
    for (int a = 0; a < 4; a++)
        cell[a + 4] = cell[a] + nx * ny;
}

/* ---- beam ---- */

SB_API sb_result sb_mesh_beam(sb_element_type type, int nx, int ny, int nz, sb_vec3 size, const sb_allocator *allocator,
                              sb_mesh *mesh, sb_error *error)
{
    sbi_meshgen_builder builder;
    int cell[8], v = 0;
    sb_result result = sbi_meshgen_check(type, mesh, error);
    if (result != SB_OK)
        return result;
    if (nx < 1 || ny < 1 || nz < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a beam of %d x %d x %d cells", nx, ny, nz);
    if (!sbi_meshgen_is_length(size.x) || !sbi_meshgen_is_length(size.y) || !sbi_meshgen_is_length(size.z))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the sizes of a beam must be positive and finite");
    result = sbi_meshgen_begin(
        &builder, type, sbi_meshgen_product(sbi_meshgen_product((int64_t)nx + 1, (int64_t)ny + 1), (int64_t)nz + 1),
        sbi_meshgen_product(sbi_meshgen_product(nx, ny), nz), allocator, error);
    if (result != SB_OK)
        return result;
    for (int k = 0; k <= nz; k++)
        for (int j = 0; j <= ny; j++)
            for (int i = 0; i <= nx; i++)
                builder.mesh.nodes[v++] =
                    sb_v3(size.x * ((sb_real)i / (sb_real)nx), size.y * ((sb_real)j / (sb_real)ny),
                          size.z * ((sb_real)k / (sb_real)nz));
    for (int k = 0; k < nz; k++)
        for (int j = 0; j < ny; j++)
            for (int i = 0; i < nx; i++) {
                sbi_meshgen_grid_cell(i, j, k, nx + 1, ny + 1, cell);
                sbi_meshgen_add_cell(&builder, cell);
            }
    return sbi_meshgen_finish(&builder, type, mesh, error);
}

/* ---- discs and balls ----
 * A round core of a square or cubic grid, with layers of cells between its surface and the circle or sphere,
 * so that no cell has two sides on the round surface and none gets flat. */

/* Cells over the core and layers around it, so many that all cells are about equally large; core + 2 layers =
 * cells over the diameter. */
typedef struct sbi_meshgen_round {
    int core, layers;
} sbi_meshgen_round;

static sbi_meshgen_round sbi_meshgen_round_of(int cells)
{
    sbi_meshgen_round round;
    round.layers = (cells + 3) / 5;
    round.core = cells - 2 * round.layers;
    return round;
}

/* Maps the cube [-1, 1]^3 to the unit ball, its surface to the sphere; in the plane z = 0 the square to the
 * disc. */
static sb_vec3 sbi_meshgen_to_ball(sb_vec3 u)
{
    const sb_real half = (sb_real)0.5, third = (sb_real)(1.0 / 3);
    sb_real xx = u.x * u.x, yy = u.y * u.y, zz = u.z * u.z;
    return sb_v3(u.x * sb_sqrt(1 - half * (yy + zz) + third * yy * zz),
                 u.y * sb_sqrt(1 - half * (zz + xx) + third * zz * xx),
                 u.z * sb_sqrt(1 - half * (xx + yy) + third * xx * yy));
}

/* Position in the unit ball of core grid point u in [-1, 1]^3 (t = 0), or of the layer point at fraction t on
 * the way from surface point u of the core to the sphere. The core is half as wide as the ball, between a
 * cube and a ball in shape. */
static sb_vec3 sbi_meshgen_round_point(sb_vec3 u, sb_real t)
{
    const sb_real cube = (sb_real)0.24, ball = (sb_real)0.30;
    sb_vec3 on_ball = sbi_meshgen_to_ball(u);
    sb_vec3 core = sb_v3_madd(sb_v3_scale(cube, u), ball, on_ball);
    return sb_v3_madd(sb_v3_scale(1 - t, core), t, on_ball);
}

/* Grid coordinate i of n as a number in [-1, 1]; exactly antisymmetric. */
static sb_real sbi_meshgen_centred(int i, int n) { return (sb_real)(2 * i - n) / (sb_real)n; }

/* Grid point number `step` of [0, 4 core) on the boundary of a core square, counter-clockwise from (0, 0). */
static void sbi_meshgen_loop_point(int step, int core, int *i, int *j)
{
    int side = step / core, along = step % core;
    *i = side == 0 ? along : (side == 1 ? core : (side == 2 ? core - along : 0));
    *j = side == 0 ? 0 : (side == 1 ? along : (side == 2 ? core : core - along));
}

static int sbi_meshgen_disc_nodes(sbi_meshgen_round round)
{
    return (round.core + 1) * (round.core + 1) + 4 * round.core * round.layers;
}

/* Unit disc: node numbers of its quads are those of the core grid, then ring by ring. */
static void sbi_meshgen_disc_points(sbi_meshgen_round round, sb_vec3 *points)
{
    int core = round.core, next = 0, i, j;
    for (j = 0; j <= core; j++)
        for (i = 0; i <= core; i++)
            points[next++] =
                sbi_meshgen_round_point(sb_v3(sbi_meshgen_centred(i, core), sbi_meshgen_centred(j, core), 0), 0);
    for (int ring = 1; ring <= round.layers; ring++) {
        for (int step = 0; step < 4 * core; step++) {
            sbi_meshgen_loop_point(step, core, &i, &j);
            points[next++] =
                sbi_meshgen_round_point(sb_v3(sbi_meshgen_centred(i, core), sbi_meshgen_centred(j, core), 0),
                                        (sb_real)ring / (sb_real)round.layers);
        }
    }
}

/* Node of the disc at step `step` of ring `ring`; ring 0 is the boundary of the core. */
static int sbi_meshgen_ring_node(sbi_meshgen_round round, int ring, int step)
{
    int i, j, core = round.core;
    step %= 4 * core;
    if (ring > 0)
        return (core + 1) * (core + 1) + (ring - 1) * 4 * core + step;
    sbi_meshgen_loop_point(step, core, &i, &j);
    return i + (core + 1) * j;
}

static void sbi_meshgen_add_extruded(sbi_meshgen_builder *builder, const int quad[4], int offset, int layer)
{
    int cell[8];
    for (int a = 0; a < 4; a++) {
        cell[a] = quad[a] + offset * layer;
        cell[a + 4] = cell[a] + offset;
    }
    sbi_meshgen_add_cell(builder, cell);
}

/* The cells of one layer of a cylinder. */
static void sbi_meshgen_disc_cells(sbi_meshgen_builder *builder, sbi_meshgen_round round, int layer)
{
    int core = round.core, nodes = sbi_meshgen_disc_nodes(round), quad[8];
    for (int j = 0; j < core; j++) {
        for (int i = 0; i < core; i++) {
            sbi_meshgen_grid_cell(i, j, 0, core + 1, core + 1, quad);
            sbi_meshgen_add_extruded(builder, quad, nodes, layer);
        }
    }
    for (int ring = 0; ring < round.layers; ring++) {
        for (int step = 0; step < 4 * core; step++) {
            quad[0] = sbi_meshgen_ring_node(round, ring, step);
            quad[1] = sbi_meshgen_ring_node(round, ring + 1, step);
            quad[2] = sbi_meshgen_ring_node(round, ring + 1, step + 1);
            quad[3] = sbi_meshgen_ring_node(round, ring, step + 1);
            sbi_meshgen_add_extruded(builder, quad, nodes, layer);
        }
    }
}

/* (u, v) across and w along coordinate axis `axis`; cyclic, so that orientation is kept. */
static sb_vec3 sbi_meshgen_along_axis(int axis, sb_real u, sb_real v, sb_real w)
{
    return axis == 0 ? sb_v3(w, u, v) : (axis == 1 ? sb_v3(v, w, u) : sb_v3(u, v, w));
}

/* Places the first layer's unit disc (in the node array already), then copies it up. */
static void sbi_meshgen_cylinder_nodes(sb_mesh *mesh, int per_layer, int axis, sb_real radius, sb_real length,
                                       int along)
{
    for (int k = along; k >= 0; k--) { /* from the top down: layer 0 is the source of all */
        sb_real height = length * ((sb_real)k / (sb_real)along);
        for (int v = 0; v < per_layer; v++) {
            sb_vec3 point = mesh->nodes[v];
            mesh->nodes[v + k * per_layer] = sbi_meshgen_along_axis(axis, radius * point.x, radius * point.y, height);
        }
    }
}

SB_API sb_result sb_mesh_cylinder(sb_element_type type, int axis, sb_real radius, sb_real length, int across, int along,
                                  const sb_allocator *allocator, sb_mesh *mesh, sb_error *error)
{
    sbi_meshgen_builder builder;
    sbi_meshgen_round round = sbi_meshgen_round_of(across);
    int64_t quads;
    sb_result result = sbi_meshgen_check(type, mesh, error);
    if (result != SB_OK)
        return result;
    if (axis < 0 || axis > 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "axis %d of a cylinder is none of 0, 1, 2", axis);
    if (across < 4 || across > 20000 || along < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cylinder of %d cells across and %d along", across, along);
    if (!sbi_meshgen_is_length(radius) || !sbi_meshgen_is_length(length))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "radius and length must be positive and finite");
    quads = (int64_t)round.core * round.core + 4 * (int64_t)round.core * round.layers;
    result = sbi_meshgen_begin(&builder, type, sbi_meshgen_product(sbi_meshgen_disc_nodes(round), (int64_t)along + 1),
                               sbi_meshgen_product(quads, along), allocator, error);
    if (result != SB_OK)
        return result;
    sbi_meshgen_disc_points(round, builder.mesh.nodes);
    sbi_meshgen_cylinder_nodes(&builder.mesh, sbi_meshgen_disc_nodes(round), axis, radius, length, along);
    for (int layer = 0; layer < along; layer++)
        sbi_meshgen_disc_cells(&builder, round, layer);
    return sbi_meshgen_finish(&builder, type, mesh, error);
}

/* ---- balls ---- */

/* Number of a core grid point among those on the core's surface, in the order of the grid; -1 inside. */
static int *sbi_meshgen_surface_ranks(int core, const sb_allocator *allocator)
{
    int side = core + 1, next = 0, v = 0;
    int *rank = (int *)sbi_alloc(allocator, (size_t)side * (size_t)side * (size_t)side, sizeof(int));
    for (int k = 0; rank && k < side; k++)
        for (int j = 0; j < side; j++)
            for (int i = 0; i < side; i++, v++)
                rank[v] = i % core == 0 || j % core == 0 || k % core == 0 ? next++ : -1;
    return rank;
}

/* Nodes of the unit ball: the core grid, then layer after layer in the order of the core's surface. */
static void sbi_meshgen_ball_nodes(sbi_meshgen_round round, const int *rank, sb_vec3 *nodes)
{
    int core = round.core, side = core + 1, v = 0, surface = side * side * side - (core - 1) * (core - 1) * (core - 1);
    for (int k = 0; k < side; k++) {
        for (int j = 0; j < side; j++) {
            for (int i = 0; i < side; i++, v++) {
                sb_vec3 u =
                    sb_v3(sbi_meshgen_centred(i, core), sbi_meshgen_centred(j, core), sbi_meshgen_centred(k, core));
                nodes[v] = sbi_meshgen_round_point(u, 0);
                for (int layer = 1; layer <= round.layers && rank[v] >= 0; layer++)
                    nodes[side * side * side + (layer - 1) * surface + rank[v]] =
                        sbi_meshgen_round_point(u, (sb_real)layer / (sb_real)round.layers);
            }
        }
    }
}

/* The cells between a quad on the core's surface (counter-clockwise from outside) and the sphere. */
static void sbi_meshgen_ball_column(sbi_meshgen_builder *builder, sbi_meshgen_round round, const int *rank,
                                    const int quad[4])
{
    int core = round.core, side = core + 1, surface = side * side * side - (core - 1) * (core - 1) * (core - 1);
    int cell[8];
    for (int a = 0; a < 4; a++)
        cell[a + 4] = quad[a];
    for (int layer = 1; layer <= round.layers; layer++) {
        for (int a = 0; a < 4; a++) {
            cell[a] = cell[a + 4];
            cell[a + 4] = side * side * side + (layer - 1) * surface + rank[quad[a]];
        }
        sbi_meshgen_add_cell(builder, cell);
    }
}

static void sbi_meshgen_ball_cells(sbi_meshgen_builder *builder, sbi_meshgen_round round, const int *rank)
{
    int core = round.core, cell[8], local[SB_MAX_FACE_NODES] = {0}, quad[4];
    for (int k = 0; k < core; k++) {
        for (int j = 0; j < core; j++) {
            for (int i = 0; i < core; i++) {
                int last = core - 1, outside[6];
                outside[0] = i == 0, outside[1] = i == last; /* the faces x-, x+, y-, y+, z-, z+ of hex8 */
                outside[2] = j == 0, outside[3] = j == last;
                outside[4] = k == 0, outside[5] = k == last;
                sbi_meshgen_grid_cell(i, j, k, core + 1, core + 1, cell);
                sbi_meshgen_add_cell(builder, cell);
                for (int face = 0; face < 6; face++) {
                    if (!outside[face])
                        continue;
                    sb_element_face(SB_HEX8, face, local, NULL);
                    for (int a = 0; a < 4; a++)
                        quad[a] = cell[local[a]];
                    sbi_meshgen_ball_column(builder, round, rank, quad);
                }
            }
        }
    }
}

/* The unit ball, with its nodes to be moved before it is finished. */
static sb_result sbi_meshgen_ball(sbi_meshgen_builder *builder, sb_element_type type, int cells,
                                  const sb_allocator *allocator, sb_error *error)
{
    sbi_meshgen_round round = sbi_meshgen_round_of(cells);
    int64_t core = round.core, side = core + 1, inner = core - 1;
    int64_t surface = side * side * side - inner * inner * inner;
    int *rank;
    sb_result result = sbi_meshgen_begin(builder, type, side * side * side + round.layers * surface,
                                         core * core * core + 6 * core * core * round.layers, allocator, error);
    if (result != SB_OK)
        return result;
    rank = sbi_meshgen_surface_ranks(round.core, allocator);
    if (!rank) {
        sb_mesh_free(&builder->mesh);
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a mesh of %d cells across", cells);
    }
    sbi_meshgen_ball_nodes(round, rank, builder->mesh.nodes);
    sbi_meshgen_ball_cells(builder, round, rank);
    sbi_free(allocator, rank);
    return SB_OK;
}

SB_API sb_result sb_mesh_ellipsoid(sb_element_type type, sb_vec3 semi_axes, int cells, const sb_allocator *allocator,
                                   sb_mesh *mesh, sb_error *error)
{
    sbi_meshgen_builder builder;
    sb_result result = sbi_meshgen_check(type, mesh, error);
    if (result != SB_OK)
        return result;
    if (cells < 4 || cells > 500)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "an ellipsoid of %d cells across: 4 to 500 are possible", cells);
    if (!sbi_meshgen_is_length(semi_axes.x) || !sbi_meshgen_is_length(semi_axes.y) ||
        !sbi_meshgen_is_length(semi_axes.z))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the semi-axes must be positive and finite");
    result = sbi_meshgen_ball(&builder, type, cells, allocator, error);
    if (result != SB_OK)
        return result;
    for (int v = 0; v < builder.mesh.node_count; v++) {
        sb_vec3 *x = &builder.mesh.nodes[v];
        *x = sb_v3(semi_axes.x * x->x, semi_axes.y * x->y, semi_axes.z * x->z);
    }
    return sbi_meshgen_finish(&builder, type, mesh, error);
}

/* ---- organ ---- */

/* Bends the unit ball to a liver (m). Each line moves points along one axis only, by an amount that grows
 * with that coordinate, so nothing can turn inside out: a dome above and a flat underside; the right lobe
 * (negative x) thick and deep, the left thin; a notch in the front edge (negative y) between them; the whole
 * arched over the hollow below. */
static sb_vec3 sbi_meshgen_liver_point(sb_vec3 u)
{
    sb_real x = (sb_real)0.101 * u.x;
    sb_real thick = (sb_real)0.055 - (sb_real)0.012 * u.x, deep = (sb_real)0.0675 - (sb_real)0.010 * u.x;
    sb_real from_notch = (u.x - (sb_real)0.30) / (sb_real)0.55;
    sb_real in_notch = sb_max(1 - from_notch * from_notch, 0);
    sb_real y = deep * u.y + (sb_real)0.007 * in_notch * in_notch * (1 - u.y);
    sb_real z = thick * (u.z + (sb_real)0.28 * u.z * u.z);
    z -= (sb_real)0.0355 * u.x * u.x + (sb_real)0.010 * u.y * u.y;
    return sb_v3(x, y, z);
}

SB_API sb_result sb_mesh_organ(sb_element_type type, int cells, const sb_allocator *allocator, sb_mesh *mesh,
                               sb_error *error)
{
    sbi_meshgen_builder builder;
    sb_result result = sbi_meshgen_check(type, mesh, error);
    if (result != SB_OK)
        return result;
    if (cells < 4 || cells > 60)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "an organ of %d cells across: 4 to 60 are possible", cells);
    result = sbi_meshgen_ball(&builder, type, cells, allocator, error);
    if (result != SB_OK)
        return result;
    for (int v = 0; v < builder.mesh.node_count; v++)
        builder.mesh.nodes[v] = sbi_meshgen_liver_point(builder.mesh.nodes[v]);
    return sbi_meshgen_finish(&builder, type, mesh, error);
}
