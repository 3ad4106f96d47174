/* tissue_mesh: rings of tets about nodes, cuts and their way back, walks, and what a change carries over.
 *
 * A ring of corners instead of lists of tets: joining and leaving cost O(1) and no memory, so only the arrays of nodes
 * and tets ever grow. Masses are summed afresh over the rings of a change instead of corrected, so that nothing drifts.
 */
#include "tissue_mesh.h"

#include <limits.h>
#include <string.h>

/* ---- memory ---- */

static void ndli_tissue_layout(ndl_tissue_mesh *t, sbi_arena *arena, size_t nodes, size_t tets)
{
    t->X = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    t->X0 = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    t->x = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    t->v = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    t->a = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    t->mass = (sb_real *)sbi_arena_take(arena, nodes, sizeof(sb_real));
    t->owner = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->node_star = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->displaced = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->displaced_at = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->node_index = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->node_flags = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    t->node_mark = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    t->tets = (int *)sbi_arena_take(arena, tets, 4 * sizeof(int));
    t->neighbours = (int *)sbi_arena_take(arena, tets, 4 * sizeof(int));
    t->corner_next = (int *)sbi_arena_take(arena, tets, 4 * sizeof(int));
    t->corner_prev = (int *)sbi_arena_take(arena, tets, 4 * sizeof(int));
    t->regions = (int *)sbi_arena_take(arena, tets, sizeof(int));
    t->tet_density = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    t->volumes = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    t->qualities = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    t->tet_mark = (unsigned char *)sbi_arena_take(arena, tets, 1);
    t->densities = (sb_real *)sbi_arena_take(arena, (size_t)t->density_count, sizeof(sb_real));
    t->touched = (int *)sbi_arena_take(arena, tets, sizeof(int));
    t->affected = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->report = (int *)sbi_arena_take(arena, 2 * tets + nodes, sizeof(int));
    t->changes = (ndl_node_change *)sbi_arena_take(arena, nodes, sizeof(ndl_node_change));
    t->change_state = (sb_vec3 *)sbi_arena_take(arena, nodes, 3 * sizeof(sb_vec3));
}

/* Points the arrays into a fresh block of zeros for so many nodes and tets; 0: no memory, *t as it was. */
static int ndli_tissue_allocate(ndl_tissue_mesh *t, int nodes, int tets)
{
    ndl_tissue_mesh made = *t;
    sbi_arena arena;
    memset(&arena, 0, sizeof arena);
    ndli_tissue_layout(&made, &arena, (size_t)nodes, (size_t)tets);
    if (arena.overflow)
        return 0;
    arena.base = (unsigned char *)sbi_alloc_zeroed(&t->allocator, arena.used, 1);
    if (!arena.base)
        return 0;
    arena.used = 0;
    ndli_tissue_layout(&made, &arena, (size_t)nodes, (size_t)tets);
    made.block = arena.base;
    made.node_capacity = nodes;
    made.tet_capacity = tets;
    *t = made;
    return 1;
}

static void ndli_tissue_copy_nodes(ndl_tissue_mesh *to, const ndl_tissue_mesh *from)
{
    size_t n = (size_t)from->node_end;
    memcpy(to->X, from->X, n * sizeof(sb_vec3));
    memcpy(to->X0, from->X0, n * sizeof(sb_vec3));
    memcpy(to->x, from->x, n * sizeof(sb_vec3));
    memcpy(to->v, from->v, n * sizeof(sb_vec3));
    memcpy(to->a, from->a, n * sizeof(sb_vec3));
    memcpy(to->mass, from->mass, n * sizeof(sb_real));
    memcpy(to->owner, from->owner, n * sizeof(int));
    memcpy(to->node_star, from->node_star, n * sizeof(int));
    memcpy(to->displaced, from->displaced, n * sizeof(int));
    memcpy(to->displaced_at, from->displaced_at, n * sizeof(int));
    memcpy(to->node_flags, from->node_flags, n);
}

static void ndli_tissue_copy_tets(ndl_tissue_mesh *to, const ndl_tissue_mesh *from)
{
    size_t n = (size_t)from->tet_end;
    memcpy(to->tets, from->tets, 4 * n * sizeof(int));
    memcpy(to->neighbours, from->neighbours, 4 * n * sizeof(int));
    memcpy(to->corner_next, from->corner_next, 4 * n * sizeof(int));
    memcpy(to->corner_prev, from->corner_prev, 4 * n * sizeof(int));
    memcpy(to->regions, from->regions, n * sizeof(int));
    memcpy(to->tet_density, from->tet_density, n * sizeof(sb_real));
    memcpy(to->volumes, from->volumes, n * sizeof(sb_real));
    memcpy(to->qualities, from->qualities, n * sizeof(sb_real));
    memcpy(to->densities, from->densities, (size_t)from->density_count * sizeof(sb_real));
}

/* end + more + half of it; INT_MAX / 8 at most, so that corners and lists of twice as many still fit an int. */
static int ndli_tissue_grown(int end, int more)
{
    int64_t need = (int64_t)end + more, roomy = need + need / 2;
    int64_t limit = INT_MAX / 8;
    return need > limit ? -1 : (int)(roomy < limit ? roomy : limit);
}

NDLI_API int ndli_tissue_reserve(ndl_tissue_mesh *tissue, int nodes, int tets)
{
    ndl_tissue_mesh grown = *tissue;
    int node_capacity = tissue->node_capacity, tet_capacity = tissue->tet_capacity;
    if (nodes <= tissue->node_capacity - tissue->node_count && tets <= tissue->tet_capacity - tissue->tet_count)
        return 1;
    if (nodes > tissue->node_capacity - tissue->node_count)
        node_capacity = ndli_tissue_grown(tissue->node_end, nodes);
    if (tets > tissue->tet_capacity - tissue->tet_count)
        tet_capacity = ndli_tissue_grown(tissue->tet_end, tets);
    if (node_capacity < 0 || tet_capacity < 0 || !ndli_tissue_allocate(&grown, node_capacity, tet_capacity))
        return 0;
    ndli_tissue_copy_nodes(&grown, tissue);
    ndli_tissue_copy_tets(&grown, tissue);
    sbi_free(&tissue->allocator, tissue->block);
    *tissue = grown;
    return 1;
}

NDL_API void ndl_tissue_mesh_free(ndl_tissue_mesh *tissue)
{
    sb_allocator allocator;
    if (!tissue)
        return;
    allocator = tissue->allocator;
    sbi_free(&allocator, tissue->block);
    memset(tissue, 0, sizeof *tissue);
}

/* ---- geometry ---- */

/* Six times the volume. */
static sb_real ndli_tissue_det(sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d)
{
    return sb_v3_dot(sb_v3_sub(b, a), sb_v3_cross(sb_v3_sub(c, a), sb_v3_sub(d, a)));
}

NDLI_API void ndli_tissue_weights(sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d, sb_vec3 p, sb_real weights[4])
{
    sb_real det = ndli_tissue_det(a, b, c, d);
    weights[0] = ndli_tissue_det(p, b, c, d) / det;
    weights[1] = ndli_tissue_det(a, p, c, d) / det;
    weights[2] = ndli_tissue_det(a, b, p, d) / det;
    weights[3] = ndli_tissue_det(a, b, c, p) / det;
}

static void ndli_tissue_measure(ndl_tissue_mesh *t, int tet)
{
    const int *n = t->tets + 4 * (size_t)tet;
    t->volumes[tet] = ndli_tissue_det(t->X[n[0]], t->X[n[1]], t->X[n[2]], t->X[n[3]]) / 6;
    t->qualities[tet] = ndli_tissue_quality(t->X[n[0]], t->X[n[1]], t->X[n[2]], t->X[n[3]]);
}

/* ---- rings ---- */

static void ndli_tissue_join(ndl_tissue_mesh *t, int corner, int node)
{
    int head = t->node_star[node];
    t->tets[corner] = node;
    t->corner_next[corner] = head;
    t->corner_prev[corner] = -1;
    if (head >= 0)
        t->corner_prev[head] = corner;
    t->node_star[node] = corner;
}

static void ndli_tissue_leave(ndl_tissue_mesh *t, int corner)
{
    int next = t->corner_next[corner], prev = t->corner_prev[corner];
    if (prev >= 0)
        t->corner_next[prev] = next;
    else
        t->node_star[t->tets[corner]] = next;
    if (next >= 0)
        t->corner_prev[next] = prev;
}

/* 1 when the tet has all these nodes. */
static int ndli_tissue_holds(const ndl_tissue_mesh *t, int tet, const int *nodes, int count)
{
    const int *n = t->tets + 4 * (size_t)tet;
    for (int i = 0; i < count; i++)
        if (n[0] != nodes[i] && n[1] != nodes[i] && n[2] != nodes[i] && n[3] != nodes[i])
            return 0;
    return 1;
}

/* The nodes of the face opposite node `face`. */
static void ndli_tissue_face(const ndl_tissue_mesh *t, int tet, int face, int nodes[3])
{
    for (int c = 0, k = 0; c < 4; c++)
        if (c != face)
            nodes[k++] = t->tets[4 * (size_t)tet + (size_t)c];
}

/* Finds the tet behind each face, and tells it. */
static void ndli_tissue_link(ndl_tissue_mesh *t, int tet)
{
    for (int face = 0; face < 4; face++) {
        int nodes[3], other = -1;
        ndli_tissue_face(t, tet, face, nodes);
        for (int k = t->node_star[nodes[0]]; k >= 0 && other < 0; k = t->corner_next[k])
            if (k / 4 != tet && ndli_tissue_holds(t, k / 4, nodes + 1, 2))
                other = k / 4;
        t->neighbours[4 * (size_t)tet + (size_t)face] = other;
        for (int c = 0; other >= 0 && c < 4; c++) {
            int node = t->tets[4 * (size_t)other + (size_t)c];
            if (node != nodes[0] && node != nodes[1] && node != nodes[2])
                t->neighbours[4 * (size_t)other + (size_t)c] = tet;
        }
    }
}

/* ---- creation ---- */

static sb_result ndli_tissue_check_input(const sb_mesh *mesh, const sb_real *densities, int density_count,
                                         sb_real slack, sb_error *error)
{
    sb_result result;
    if (!mesh || !densities)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the %s is NULL", mesh ? "array of densities" : "mesh");
    if (mesh->element_type != SB_TET4)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the tissue of a needle is a mesh of tet4");
    if (density_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d densities", density_count);
    for (int i = 0; i < density_count; i++)
        if (!(densities[i] > 0) || !sb_is_finite(densities[i]))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "density %d is not positive and finite", i);
    if (!(slack >= 0) || !(slack <= 1000))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "slack is not in [0, 1000]");
    result = sb_mesh_validate(mesh, error);
    for (int e = 0; result == SB_OK && e < mesh->element_count; e++) {
        int region = mesh->regions ? mesh->regions[e] : 0;
        if (density_count > 1 && (region < 0 || region >= density_count))
            result = sbi_fail_element(error, SB_ERROR_ARGUMENT, e, "element %d: region %d has no density", e, region);
    }
    return result;
}

static void ndli_tissue_fill(ndl_tissue_mesh *t, const sb_mesh *mesh)
{
    t->node_count = t->node_end = t->original_nodes = mesh->node_count;
    t->tet_count = t->tet_end = t->original_tets = mesh->element_count;
    t->free_node = t->free_tet = -1;
    for (int n = 0; n < mesh->node_count; n++) {
        t->X[n] = t->X0[n] = t->x[n] = mesh->nodes[n];
        t->owner[n] = t->node_star[n] = t->displaced_at[n] = -1;
        t->node_flags[n] = NDL_NODE_ALIVE;
    }
    for (int e = mesh->element_count - 1; e >= 0; e--) { /* rings come out ascending */
        for (int c = 3; c >= 0; c--)
            ndli_tissue_join(t, 4 * e + c, mesh->elements[4 * (size_t)e + (size_t)c]);
        t->regions[e] = mesh->regions ? mesh->regions[e] : 0;
        t->tet_density[e] = t->densities[t->density_count == 1 ? 0 : t->regions[e]];
        ndli_tissue_measure(t, e);
    }
}

static void ndli_tissue_weigh(ndl_tissue_mesh *t, int node)
{
    sb_real sum = 0;
    for (int k = t->node_star[node]; k >= 0; k = t->corner_next[k])
        sum += t->tet_density[k / 4] * t->volumes[k / 4];
    t->mass[node] = sum / 4;
}

/* Neighbours, masses, and which nodes lie on the surface and between regions; the first node of no tet, or -1. */
static int ndli_tissue_connect(ndl_tissue_mesh *t)
{
    for (int e = 0; e < t->tet_end; e++)
        ndli_tissue_link(t, e);
    for (int e = 0; e < t->tet_end; e++)
        for (int face = 0; face < 4; face++) {
            int nodes[3], other = t->neighbours[4 * (size_t)e + (size_t)face];
            int flag = other < 0 ? NDL_NODE_BOUNDARY : t->regions[other] != t->regions[e] ? NDL_NODE_INTERFACE : 0;
            ndli_tissue_face(t, e, face, nodes);
            for (int i = 0; i < 3; i++)
                t->node_flags[nodes[i]] = (unsigned char)(t->node_flags[nodes[i]] | flag);
        }
    for (int n = 0; n < t->node_end; n++) {
        ndli_tissue_weigh(t, n);
        if (t->node_star[n] < 0)
            return n;
    }
    return -1;
}

NDL_API sb_result ndl_tissue_mesh_create(const sb_mesh *mesh, const sb_real *densities, int density_count,
                                         sb_real slack, const sb_allocator *allocator,
                                         ndl_tissue_mesh *tissue, sb_error *error)
{
    ndl_tissue_mesh made;
    sb_result result;
    int nodes, tets, lost;
    if (!tissue)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "tissue is NULL");
    result = ndli_tissue_check_input(mesh, densities, density_count, slack, error);
    if (result != SB_OK)
        return result;
    memset(&made, 0, sizeof made);
    if (allocator)
        made.allocator = *allocator;
    made.density_count = density_count;
    nodes = ndli_tissue_grown(mesh->node_count, 0);
    tets = ndli_tissue_grown(mesh->element_count, 0);
    if (nodes < 0 || tets < 0)
        return sbi_fail(error, SB_ERROR_MESH, "too many nodes or tets for a tissue");
    nodes = mesh->node_count +
            (int)sb_min((sb_real)(INT_MAX / 8 - mesh->node_count), slack * (sb_real)mesh->node_count);
    tets = mesh->element_count +
           (int)sb_min((sb_real)(INT_MAX / 8 - mesh->element_count), slack * (sb_real)mesh->element_count);
    if (!ndli_tissue_allocate(&made, nodes, tets))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a tissue of %d nodes", mesh->node_count);
    memcpy(made.densities, densities, (size_t)density_count * sizeof(sb_real));
    ndli_tissue_fill(&made, mesh);
    lost = ndli_tissue_connect(&made);
    if (lost >= 0) {
        ndl_tissue_mesh_free(&made);
        return sbi_fail_node(error, SB_ERROR_MESH, lost, "node %d belongs to no tet", lost);
    }
    *tissue = made;
    return SB_OK;
}

/* ---- walks ---- */

static int ndli_tissue_is_tet(const ndl_tissue_mesh *t, int tet)
{
    return tet >= 0 && tet < t->tet_end && t->tets[4 * (size_t)tet] >= 0;
}

NDL_API int ndl_tissue_mesh_find(const ndl_tissue_mesh *tissue, const sb_vec3 *positions, sb_vec3 point, int start,
                                 sb_real weights[4])
{
    sb_real w[4], slack = -64 * SB_EPSILON;
    int tet = start, from = -1;
    if (!tissue || !positions || !ndli_tissue_is_tet(tissue, start) || !sb_v3_is_finite(point))
        return -1;
    /* A walk over tets that are not Delaunay, or inverted in space, may circle: it ends after as many steps as a
     * straight line could at most need. */
    for (int step = 0; step < tissue->tet_count; step++) {
        const int *n = tissue->tets + 4 * (size_t)tet;
        int worst = -1, next;
        ndli_tissue_weights(positions[n[0]], positions[n[1]], positions[n[2]], positions[n[3]], point, w);
        for (int c = 0; c < 4; c++)
            if (!(w[c] >= slack) && (worst < 0 || w[c] < w[worst]) &&
                (tissue->neighbours[4 * (size_t)tet + (size_t)c] != from || from < 0))
                worst = c;
        if (worst < 0)
            break;
        next = tissue->neighbours[4 * (size_t)tet + (size_t)worst];
        for (int c = 0; next < 0 && c < 4; c++) /* round a dent of the surface, if there is a way */
            if (c != worst && w[c] < slack && tissue->neighbours[4 * (size_t)tet + (size_t)c] != from)
                next = tissue->neighbours[4 * (size_t)tet + (size_t)c];
        if (next < 0)
            break;
        from = tet;
        tet = next;
    }
    if (weights)
        memcpy(weights, w, sizeof w);
    for (int c = 0; c < 4; c++)
        if (!(w[c] >= slack))
            return -1;
    return tet;
}

/* Where the segment p + s d crosses the triangle from its front (normal against d): s, or -1. */
static sb_real ndli_tissue_cross(sb_vec3 p, sb_vec3 d, sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_real w[3])
{
    sb_vec3 ab = sb_v3_sub(b, a), ac = sb_v3_sub(c, a), n = sb_v3_cross(ab, ac), ap = sb_v3_sub(p, a), q;
    sb_real den = -sb_v3_dot(d, n), slack = 64 * SB_EPSILON;
    if (!(den > 0))
        return -1;
    q = sb_v3_cross(ap, d);
    w[1] = sb_v3_dot(ac, q) / den;
    w[2] = -sb_v3_dot(ab, q) / den;
    w[0] = 1 - w[1] - w[2];
    if (w[0] < -slack || w[1] < -slack || w[2] < -slack)
        return -1;
    return sb_v3_dot(ap, n) / den;
}

NDL_API int ndl_tissue_mesh_hit(const ndl_tissue_mesh *tissue, sb_vec3 from, sb_vec3 to, ndl_surface_hit *hit)
{
    sb_vec3 d = sb_v3_sub(to, from);
    int found = 0;
    if (!tissue || !hit || !sb_v3_is_finite(from) || !sb_v3_is_finite(to))
        return 0;
    for (int tet = 0; tet < tissue->tet_end; tet++) {
        const int *n = tissue->tets + 4 * (size_t)tet;
        static const int outward[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
        for (int face = 0; n[0] >= 0 && face < 4; face++) {
            int a = n[outward[face][0]], b = n[outward[face][1]], c = n[outward[face][2]];
            sb_real w[3], along;
            if (tissue->neighbours[4 * (size_t)tet + (size_t)face] >= 0)
                continue;
            along = ndli_tissue_cross(from, d, tissue->x[a], tissue->x[b], tissue->x[c], w);
            if (along < 0 || along > 1 || (found && along >= hit->along))
                continue;
            found = 1;
            hit->tet = tet;
            hit->face = face;
            hit->along = along;
            hit->X = sb_v3_madd(sb_v3_madd(sb_v3_scale(w[0], tissue->X[a]), w[1], tissue->X[b]), w[2], tissue->X[c]);
        }
    }
    return found;
}

/* ---- a change ---- */

enum { NDLI_TOUCHED = 1, NDLI_WAS_ALIVE = 2, NDLI_RELINK = 4 };

static void ndli_tissue_affect(ndl_tissue_mesh *t, int node, int was_alive)
{
    if (t->node_mark[node])
        return;
    t->node_mark[node] = (unsigned char)(was_alive ? NDLI_TOUCHED | NDLI_WAS_ALIVE : NDLI_TOUCHED);
    t->affected[t->affected_count++] = node;
    if (was_alive) {
        t->momentum = sb_v3_madd(t->momentum, t->mass[node], t->v[node]);
        t->net_force = sb_v3_madd(t->net_force, t->mass[node], t->a[node]);
    }
}

/* To be called before a tet is changed, and after one is made. */
static void ndli_tissue_touch(ndl_tissue_mesh *t, int tet, int made, int relink)
{
    if (!t->tet_mark[tet]) {
        t->tet_mark[tet] = (unsigned char)(made ? NDLI_TOUCHED : NDLI_TOUCHED | NDLI_WAS_ALIVE);
        t->touched[t->touched_count++] = tet;
        if (!made)
            t->change_mass += t->tet_density[tet] * t->volumes[tet];
    }
    if (relink)
        t->tet_mark[tet] |= NDLI_RELINK;
    for (int c = 0; c < 4; c++)
        ndli_tissue_affect(t, t->tets[4 * (size_t)tet + (size_t)c], 1);
}

NDLI_API void ndli_tissue_begin(ndl_tissue_mesh *tissue)
{
    tissue->touched_count = tissue->affected_count = tissue->change_count = 0;
    tissue->momentum = tissue->net_force = sb_v3(0, 0, 0);
    tissue->change_mass = 0;
}

NDLI_API int ndli_tissue_source(const ndl_tissue_mesh *t, sb_vec3 X, int start, sb_real w[4])
{
    int tet = ndl_tissue_mesh_find(t, t->X, X, start, w), best = start;
    sb_real most = -SB_REAL_MAX, sum = 0;
    if (tet >= 0)
        return tet;
    for (int c = 0; c < 4; c++) { /* a dent may have ended the walk: look about the start */
        for (int k = t->node_star[t->tets[4 * (size_t)start + (size_t)c]]; k >= 0; k = t->corner_next[k]) {
            const int *n = t->tets + 4 * (size_t)(k / 4);
            sb_real least;
            ndli_tissue_weights(t->X[n[0]], t->X[n[1]], t->X[n[2]], t->X[n[3]], X, w);
            least = sb_min(sb_min(w[0], w[1]), sb_min(w[2], w[3]));
            if (least > most) {
                most = least;
                best = k / 4;
            }
        }
    }
    {
        const int *n = t->tets + 4 * (size_t)best;
        ndli_tissue_weights(t->X[n[0]], t->X[n[1]], t->X[n[2]], t->X[n[3]], X, w);
    }
    for (int c = 0; c < 4; c++)
        sum += w[c] = sb_max(w[c], 0);
    for (int c = 0; c < 4; c++)
        w[c] /= sum;
    return best;
}

NDLI_API int ndli_tissue_plan(ndl_tissue_mesh *tissue, int node, sb_vec3 X, int start)
{
    ndl_node_change *change = tissue->changes + tissue->change_count;
    sb_vec3 *state = tissue->change_state + 3 * (size_t)tissue->change_count;
    int tet = ndli_tissue_source(tissue, X, start, change->weights);
    change->node = node;
    change->created = node < 0;
    change->X = X;
    state[0] = state[1] = state[2] = sb_v3(0, 0, 0);
    for (int c = 0; c < 4; c++) {
        int source = tissue->tets[4 * (size_t)tet + (size_t)c];
        change->sources[c] = source;
        state[0] = sb_v3_madd(state[0], change->weights[c], tissue->x[source]);
        state[1] = sb_v3_madd(state[1], change->weights[c], tissue->v[source]);
        state[2] = sb_v3_madd(state[2], change->weights[c], tissue->a[source]);
    }
    return tissue->change_count++;
}

static int ndli_tissue_make_node(ndl_tissue_mesh *t, sb_vec3 X)
{
    int node = t->free_node;
    if (node >= 0)
        t->free_node = t->node_star[node];
    else
        node = t->node_end++;
    t->node_count++;
    t->X[node] = t->X0[node] = X;
    t->v[node] = sb_v3(0, 0, 0);
    t->owner[node] = t->node_star[node] = t->displaced_at[node] = -1;
    t->node_flags[node] = NDL_NODE_ALIVE | NDL_NODE_CREATED;
    t->mass[node] = 0;
    ndli_tissue_affect(t, node, 0);
    return node;
}

static void ndli_tissue_drop_node(ndl_tissue_mesh *t, int node)
{
    SB_ASSERT(t->node_star[node] < 0);
    t->node_flags[node] = 0;
    t->owner[node] = -1;
    t->mass[node] = 0;
    t->node_star[node] = t->free_node;
    t->free_node = node;
    t->node_count--;
}

/* A copy of a tet with another node at one corner. */
static int ndli_tissue_make_tet(ndl_tissue_mesh *t, int pattern, int corner, int node)
{
    int tet = t->free_tet;
    if (tet >= 0)
        t->free_tet = t->neighbours[4 * (size_t)tet];
    else
        tet = t->tet_end++;
    t->tet_count++;
    for (int c = 0; c < 4; c++)
        ndli_tissue_join(t, 4 * tet + c, c == corner ? node : t->tets[4 * (size_t)pattern + (size_t)c]);
    t->regions[tet] = t->regions[pattern];
    t->tet_density[tet] = t->tet_density[pattern];
    ndli_tissue_touch(t, tet, 1, 1);
    return tet;
}

static void ndli_tissue_drop_tet(ndl_tissue_mesh *t, int tet)
{
    ndli_tissue_touch(t, tet, 0, 1);
    for (int c = 0; c < 4; c++)
        ndli_tissue_leave(t, 4 * tet + c);
    t->tets[4 * (size_t)tet] = -1;
    t->neighbours[4 * (size_t)tet] = t->free_tet;
    t->free_tet = tet;
    t->tet_count--;
}

static int ndli_tissue_corner(const ndl_tissue_mesh *t, int tet, int node)
{
    int c = 0;
    while (c < 3 && t->tets[4 * (size_t)tet + (size_t)c] != node)
        c++;
    return c;
}

static void ndli_tissue_replace(ndl_tissue_mesh *t, int tet, int old, int node)
{
    int corner = 4 * tet + ndli_tissue_corner(t, tet, old);
    ndli_tissue_touch(t, tet, 0, 1);
    ndli_tissue_leave(t, corner);
    ndli_tissue_join(t, corner, node);
}

NDLI_API int ndli_tissue_cut(ndl_tissue_mesh *tissue, const int *simplex, int size, int plan, int *groups)
{
    int node = ndli_tissue_make_node(tissue, tissue->changes[plan].X), count = 0, mixed = 0;
    tissue->changes[plan].node = node;
    for (int k = tissue->node_star[simplex[0]]; k >= 0; k = tissue->corner_next[k])
        if (ndli_tissue_holds(tissue, k / 4, simplex, size))
            groups[size * count++] = k / 4;
    for (int g = 0; g < count; g++) {
        int parent = groups[size * g];
        mixed |= tissue->regions[parent] != tissue->regions[groups[0]];
        ndli_tissue_touch(tissue, parent, 0, 1);
        for (int j = 1; j < size; j++)
            groups[size * g + j] =
                ndli_tissue_make_tet(tissue, parent, ndli_tissue_corner(tissue, parent, simplex[j]), node);
        ndli_tissue_replace(tissue, parent, simplex[0], node);
    }
    if (mixed)
        tissue->node_flags[node] |= NDL_NODE_INTERFACE;
    return count;
}

NDLI_API void ndli_tissue_mend(ndl_tissue_mesh *tissue, int node, const int *simplex, int size, const int *groups,
                               int count)
{
    for (int g = count - 1; g >= 0; g--) {
        for (int j = size - 1; j > 0; j--)
            ndli_tissue_drop_tet(tissue, groups[size * g + j]);
        ndli_tissue_replace(tissue, groups[size * g], node, simplex[0]);
    }
    ndli_tissue_drop_node(tissue, node);
}

/* Keeps the list of nodes that are not at their own place. */
static void ndli_tissue_note_displaced(ndl_tissue_mesh *t, int node)
{
    int is = memcmp(t->X + node, t->X0 + node, sizeof(sb_vec3)) != 0 && !(t->node_flags[node] & NDL_NODE_CREATED);
    int at = t->displaced_at[node];
    if (is && at < 0) {
        t->displaced_at[node] = t->displaced_count;
        t->displaced[t->displaced_count++] = node;
    } else if (!is && at >= 0) {
        int last = t->displaced[--t->displaced_count];
        t->displaced[at] = last;
        t->displaced_at[last] = at;
        t->displaced_at[node] = -1;
    }
}

NDLI_API void ndli_tissue_move(ndl_tissue_mesh *tissue, int plan)
{
    int node = tissue->changes[plan].node;
    for (int k = tissue->node_star[node]; k >= 0; k = tissue->corner_next[k])
        ndli_tissue_touch(tissue, k / 4, 0, 0);
    tissue->X[node] = tissue->changes[plan].X;
    ndli_tissue_note_displaced(tissue, node);
}

/* Where faces between regions were moved, the tets of the change keep the mass they had together. */
static void ndli_tissue_keep_mass(ndl_tissue_mesh *t)
{
    sb_real mass = 0, least = SB_REAL_MAX, most = 0;
    for (int i = 0; i < t->touched_count; i++) {
        int tet = t->touched[i];
        if (t->tets[4 * (size_t)tet] < 0)
            continue;
        mass += t->tet_density[tet] * t->volumes[tet];
        least = sb_min(least, t->tet_density[tet]);
        most = sb_max(most, t->tet_density[tet]);
    }
    if (!(most > least) || !(mass > 0))
        return;
    for (int i = 0; i < t->touched_count; i++)
        if (t->tets[4 * (size_t)t->touched[i]] >= 0)
            t->tet_density[t->touched[i]] *= t->change_mass / mass;
}

NDLI_API void ndli_tissue_reset_densities(ndl_tissue_mesh *tissue)
{
    ndl_mesh_change nothing;
    if (tissue->density_count == 1)
        return;
    for (int t = 0; t < tissue->tet_end; t++)
        if (tissue->tets[4 * (size_t)t] >= 0)
            tissue->tet_density[t] = tissue->densities[tissue->regions[t]];
    for (int n = 0; n < tissue->node_end; n++)
        if (tissue->node_flags[n])
            ndli_tissue_weigh(tissue, n);
    memset(&nothing, 0, sizeof nothing);
    if (tissue->listener)
        tissue->listener(tissue->listener_user, &nothing);
}

/* Spreads over the change's nodes the momentum that interpolation has lost or made, and the same of accelerations,
 * from which a step of Newmark takes half its momentum. */
static void ndli_tissue_balance(ndl_tissue_mesh *t)
{
    sb_vec3 left = t->momentum, force = t->net_force, dv, da;
    sb_real mass = 0;
    for (int i = 0; i < t->affected_count; i++) {
        int n = t->affected[i];
        if (!(t->node_flags[n] & NDL_NODE_ALIVE))
            continue;
        left = sb_v3_madd(left, -t->mass[n], t->v[n]);
        force = sb_v3_madd(force, -t->mass[n], t->a[n]);
        if (!(t->node_flags[n] & NDL_NODE_FIXED))
            mass += t->mass[n];
    }
    if (!(mass > 0))
        return;
    dv = sb_v3_scale(1 / mass, left);
    da = sb_v3_scale(1 / mass, force);
    for (int i = 0; i < t->affected_count; i++) {
        int n = t->affected[i];
        if (t->node_flags[n] && !(t->node_flags[n] & NDL_NODE_FIXED)) {
            t->v[n] = sb_v3_add(t->v[n], dv);
            t->a[n] = sb_v3_add(t->a[n], da);
        }
    }
}

static void ndli_tissue_report(ndl_tissue_mesh *t)
{
    ndl_mesh_change change;
    int *changed = t->report, *other = t->report + t->tet_capacity, *nodes = t->report + 2 * (size_t)t->tet_capacity;
    int removed = 0, created = 0;
    memset(&change, 0, sizeof change);
    for (int i = 0; i < t->touched_count; i++) { /* removed from the front, created from the back: never meet */
        int tet = t->touched[i], was = t->tet_mark[tet] & NDLI_WAS_ALIVE, is = t->tets[4 * (size_t)tet] >= 0;
        if (was && is)
            changed[change.changed_count++] = tet;
        else if (was)
            other[removed++] = tet;
        else if (is)
            other[t->tet_capacity - ++created] = tet;
    }
    for (int i = 0; i < t->affected_count; i++)
        if (!t->node_flags[t->affected[i]] && (t->node_mark[t->affected[i]] & NDLI_WAS_ALIVE))
            nodes[change.removed_node_count++] = t->affected[i];
    change.changed = changed;
    change.removed = other;
    change.created = other + t->tet_capacity - created;
    change.removed_count = removed;
    change.created_count = created;
    change.removed_nodes = nodes;
    change.nodes = t->changes;
    change.node_count = t->change_count;
    t->listener(t->listener_user, &change);
}

NDLI_API void ndli_tissue_end(ndl_tissue_mesh *tissue)
{
    for (int i = 0; i < tissue->change_count; i++) {
        int node = tissue->changes[i].node;
        const sb_vec3 *state = tissue->change_state + 3 * (size_t)i;
        tissue->x[node] = state[0];
        tissue->v[node] = state[1];
        tissue->a[node] = state[2];
    }
    for (int i = 0; i < tissue->touched_count; i++)
        if (tissue->tets[4 * (size_t)tissue->touched[i]] >= 0) {
            ndli_tissue_measure(tissue, tissue->touched[i]);
            if (tissue->tet_mark[tissue->touched[i]] & NDLI_RELINK)
                ndli_tissue_link(tissue, tissue->touched[i]);
        }
    ndli_tissue_keep_mass(tissue);
    for (int i = 0; i < tissue->affected_count; i++)
        if (tissue->node_flags[tissue->affected[i]])
            ndli_tissue_weigh(tissue, tissue->affected[i]);
    ndli_tissue_balance(tissue);
    if (tissue->listener)
        ndli_tissue_report(tissue);
    for (int i = 0; i < tissue->touched_count; i++)
        tissue->tet_mark[tissue->touched[i]] = 0;
    for (int i = 0; i < tissue->affected_count; i++)
        tissue->node_mark[tissue->affected[i]] = 0;
}

/* ---- measures and checks ---- */

/* Extreme cosines of a tet's six dihedral angles. */
static void ndli_tissue_cosines(const ndl_tissue_mesh *t, int tet, sb_real *low, sb_real *high)
{
    const int *n = t->tets + 4 * (size_t)tet;
    sb_vec3 a = t->X[n[0]], b = t->X[n[1]], c = t->X[n[2]], d = t->X[n[3]], normal[4];
    normal[0] = sb_v3_cross(sb_v3_sub(c, b), sb_v3_sub(d, b));
    normal[1] = sb_v3_cross(sb_v3_sub(d, a), sb_v3_sub(c, a));
    normal[2] = sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(d, a));
    normal[3] = sb_v3_cross(sb_v3_sub(c, a), sb_v3_sub(b, a));
    for (int i = 0; i < 4; i++)
        normal[i] = sb_v3_scale(1 / sb_v3_norm(normal[i]), normal[i]);
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < i; j++) {
            sb_real cosine = -sb_v3_dot(normal[i], normal[j]);
            *low = sb_min(*low, cosine);
            *high = sb_max(*high, cosine);
        }
}

NDL_API void ndl_tissue_mesh_quality(const ndl_tissue_mesh *tissue, sb_real *worst_quality, sb_real *min_dihedral,
                                     sb_real *max_dihedral)
{
    sb_real worst = 1, low = 1, high = -1, degrees = (sb_real)57.295779513082323;
    if (!tissue)
        return;
    for (int t = 0; t < tissue->tet_end; t++) {
        if (tissue->tets[4 * (size_t)t] < 0)
            continue;
        worst = sb_min(worst, tissue->qualities[t]);
        if (min_dihedral || max_dihedral)
            ndli_tissue_cosines(tissue, t, &low, &high);
    }
    if (worst_quality)
        *worst_quality = worst;
    if (min_dihedral)
        *min_dihedral = degrees * sb_acos(high);
    if (max_dihedral)
        *max_dihedral = degrees * sb_acos(low);
}

NDL_API sb_real ndl_tissue_mesh_volume(const ndl_tissue_mesh *tissue)
{
    double sum = 0;
    if (!tissue)
        return 0;
    for (int t = 0; t < tissue->tet_end; t++)
        if (tissue->tets[4 * (size_t)t] >= 0)
            sum += (double)tissue->volumes[t];
    return (sb_real)sum;
}

NDL_API sb_real ndl_tissue_mesh_mass(const ndl_tissue_mesh *tissue)
{
    double sum = 0;
    if (!tissue)
        return 0;
    for (int n = 0; n < tissue->node_end; n++)
        if (tissue->node_flags[n])
            sum += (double)tissue->mass[n];
    return (sb_real)sum;
}

static sb_result ndli_tissue_check_tet(const ndl_tissue_mesh *t, int tet, sb_error *error)
{
    for (int c = 0; c < 4; c++) {
        int corner = 4 * tet + c, node = t->tets[corner], other = t->neighbours[corner], nodes[3], back = 0;
        if (node < 0 || node >= t->node_end || !t->node_flags[node])
            return sbi_fail_element(error, SB_ERROR_MESH, tet, "tet %d has a node that is not in use", tet);
        if (t->corner_prev[corner] >= 0 ? t->corner_next[t->corner_prev[corner]] != corner
                                        : t->node_star[node] != corner)
            return sbi_fail_element(error, SB_ERROR_MESH, tet, "tet %d is not in the ring of node %d", tet, node);
        if (other < 0)
            continue;
        ndli_tissue_face(t, tet, c, nodes);
        for (int k = 0; ndli_tissue_is_tet(t, other) && k < 4; k++)
            back |= t->neighbours[4 * (size_t)other + (size_t)k] == tet;
        if (!back || !ndli_tissue_holds(t, other, nodes, 3))
            return sbi_fail_element(error, SB_ERROR_MESH, tet, "tet %d and its neighbour %d disagree", tet, other);
    }
    if (t->tet_mark[tet] || !(t->qualities[tet] > 0))
        return sbi_fail_element(error, SB_ERROR_MESH, tet, "tet %d is flat, inverted or marked", tet);
    return SB_OK;
}

NDL_API sb_result ndl_tissue_mesh_check(const ndl_tissue_mesh *tissue, sb_error *error)
{
    sb_result result = SB_OK;
    int tets = 0, nodes = 0, corners = 0;
    if (!tissue || !tissue->block)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "no tissue");
    for (int t = 0; result == SB_OK && t < tissue->tet_end; t++)
        if (tissue->tets[4 * (size_t)t] >= 0) {
            tets++;
            result = ndli_tissue_check_tet(tissue, t, error);
        }
    for (int n = 0; result == SB_OK && n < tissue->node_end; n++)
        if (tissue->node_flags[n]) {
            nodes++;
            for (int k = tissue->node_star[n]; k >= 0 && corners <= 4 * tissue->tet_count; k = tissue->corner_next[k])
                corners++;
        }
    if (result == SB_OK && (tets != tissue->tet_count || nodes != tissue->node_count || corners != 4 * tets))
        result = sbi_fail(error, SB_ERROR_MESH, "counts disagree: %d tets, %d nodes, %d corners", tets, nodes, corners);
    return result;
}

NDL_API int ndl_tissue_mesh_is_original(const ndl_tissue_mesh *tissue)
{
    if (!tissue)
        return 0;
    if (tissue->node_count != tissue->original_nodes || tissue->tet_count != tissue->original_tets ||
        tissue->displaced_count)
        return 0;
    for (int n = 0; n < tissue->original_nodes; n++)
        if (!tissue->node_flags[n] || memcmp(tissue->X + n, tissue->X0 + n, sizeof(sb_vec3)) != 0)
            return 0;
    for (int t = 0; t < tissue->original_tets; t++)
        if (tissue->tets[4 * (size_t)t] < 0)
            return 0;
    return 1;
}
