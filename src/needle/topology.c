/* topology: rings of tets about nodes, cuts and their way back, walks.
 *
 * A ring of corners instead of lists of tets: joining and leaving cost O(1) and no memory, so only the arrays of nodes
 * and tets ever grow. */
#include "topology.h"

#include "../softbody/body/body_guest.h"
#include "image.h"

#include <limits.h>
#include <string.h>

/* ---- memory ---- */

static void ndli_topology_layout(ndli_topology *t, sbi_arena *arena, size_t nodes, size_t tets)
{
    t->X = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    t->X0 = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
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
    t->parents = (int *)sbi_arena_take(arena, tets, sizeof(int));
    t->volumes = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    t->qualities = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    t->tet_mark = (unsigned char *)sbi_arena_take(arena, tets, 1);
    t->touched = (int *)sbi_arena_take(arena, tets, sizeof(int));
    t->affected = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->node_events = (ndli_node_event *)sbi_arena_take(arena, nodes, 2 * sizeof(ndli_node_event));
    t->displaced_before = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->tet_events = (int *)sbi_arena_take(arena, tets, 2 * sizeof(int));
    t->changed = (int *)sbi_arena_take(arena, tets, sizeof(int));
    t->changes = (ndli_node_change *)sbi_arena_take(arena, nodes, sizeof(ndli_node_change));
}

/* Points the arrays into a fresh block of zeros for so many nodes and tets; 0: no memory, *t as it was. */
static int ndli_topology_allocate(ndli_topology *t, int nodes, int tets)
{
    ndli_topology made = *t;
    sbi_arena arena;
    memset(&arena, 0, sizeof arena);
    ndli_topology_layout(&made, &arena, (size_t)nodes, (size_t)tets);
    if (arena.overflow)
        return 0;
    arena.base = (unsigned char *)sbi_alloc_zeroed(&t->allocator, arena.used, 1);
    if (!arena.base)
        return 0;
    arena.used = 0;
    ndli_topology_layout(&made, &arena, (size_t)nodes, (size_t)tets);
    made.block = arena.base;
    made.node_capacity = nodes;
    made.tet_capacity = tets;
    *t = made;
    return 1;
}

static void ndli_topology_copy_nodes(ndli_topology *to, const ndli_topology *from)
{
    size_t n = (size_t)from->node_end;
    memcpy(to->X, from->X, n * sizeof(sb_vec3));
    memcpy(to->X0, from->X0, n * sizeof(sb_vec3));
    memcpy(to->owner, from->owner, n * sizeof(int));
    memcpy(to->node_star, from->node_star, n * sizeof(int));
    memcpy(to->displaced, from->displaced, n * sizeof(int));
    memcpy(to->displaced_at, from->displaced_at, n * sizeof(int));
    memcpy(to->node_flags, from->node_flags, n);
}

static void ndli_topology_copy_tets(ndli_topology *to, const ndli_topology *from)
{
    size_t n = (size_t)from->tet_end;
    memcpy(to->tets, from->tets, 4 * n * sizeof(int));
    memcpy(to->neighbours, from->neighbours, 4 * n * sizeof(int));
    memcpy(to->corner_next, from->corner_next, 4 * n * sizeof(int));
    memcpy(to->corner_prev, from->corner_prev, 4 * n * sizeof(int));
    memcpy(to->regions, from->regions, n * sizeof(int));
    memcpy(to->parents, from->parents, n * sizeof(int));
    memcpy(to->volumes, from->volumes, n * sizeof(sb_real));
    memcpy(to->qualities, from->qualities, n * sizeof(sb_real));
}

/* end + more + half of it; INT_MAX / 8 at most, so that corners and lists of twice as many still fit an int. */
static int ndli_topology_grown(int end, int more)
{
    int64_t need = (int64_t)end + more, roomy = need + need / 2;
    int64_t limit = INT_MAX / 8;
    return need > limit ? -1 : (int)(roomy < limit ? roomy : limit);
}

NDLI_API int ndli_topology_reserve(ndli_topology *mesh, int nodes, int tets)
{
    ndli_topology grown = *mesh;
    int node_capacity = mesh->node_capacity, tet_capacity = mesh->tet_capacity;
    if (nodes <= mesh->node_capacity - mesh->node_count && tets <= mesh->tet_capacity - mesh->tet_count)
        return 1;
    if (nodes > mesh->node_capacity - mesh->node_count)
        node_capacity = ndli_topology_grown(mesh->node_end, nodes);
    if (tets > mesh->tet_capacity - mesh->tet_count)
        tet_capacity = ndli_topology_grown(mesh->tet_end, tets);
    if (node_capacity < 0 || tet_capacity < 0 || !ndli_topology_allocate(&grown, node_capacity, tet_capacity))
        return 0;
    ndli_topology_copy_nodes(&grown, mesh);
    ndli_topology_copy_tets(&grown, mesh);
    sbi_free(&mesh->allocator, mesh->block);
    *mesh = grown;
    return 1;
}

NDLI_API void ndli_topology_free(ndli_topology *mesh)
{
    sb_allocator allocator;
    if (!mesh)
        return;
    allocator = mesh->allocator;
    sbi_free(&allocator, mesh->block);
    memset(mesh, 0, sizeof *mesh);
}

/* ---- geometry ---- */

/* Six times the volume. */
static sb_real ndli_topology_det(sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d)
{
    return sb_v3_dot(sb_v3_sub(b, a), sb_v3_cross(sb_v3_sub(c, a), sb_v3_sub(d, a)));
}

NDLI_API void ndli_tet_weights(sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d, sb_vec3 p, sb_real weights[4])
{
    sb_real det = ndli_topology_det(a, b, c, d);
    weights[0] = ndli_topology_det(p, b, c, d) / det;
    weights[1] = ndli_topology_det(a, p, c, d) / det;
    weights[2] = ndli_topology_det(a, b, p, d) / det;
    weights[3] = ndli_topology_det(a, b, c, p) / det;
}

static void ndli_topology_measure(ndli_topology *t, int tet)
{
    const int *n = t->tets + 4 * (size_t)tet;
    t->volumes[tet] = ndli_topology_det(t->X[n[0]], t->X[n[1]], t->X[n[2]], t->X[n[3]]) / 6;
    t->qualities[tet] = ndli_tet_quality(t->X[n[0]], t->X[n[1]], t->X[n[2]], t->X[n[3]]);
}

/* ---- rings ----
 * Ascending, so that they are a function of the mesh alone: sums over them have the same bits whatever was done and
 * undone. */

static void ndli_topology_join(ndli_topology *t, int corner, int node)
{
    int prev = -1, next = t->node_star[node];
    while (next >= 0 && next < corner) {
        prev = next;
        next = t->corner_next[next];
    }
    t->tets[corner] = node;
    t->corner_next[corner] = next;
    t->corner_prev[corner] = prev;
    if (next >= 0)
        t->corner_prev[next] = corner;
    if (prev >= 0)
        t->corner_next[prev] = corner;
    else
        t->node_star[node] = corner;
}

static void ndli_topology_leave(ndli_topology *t, int corner)
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
static int ndli_topology_holds(const ndli_topology *t, int tet, const int *nodes, int count)
{
    const int *n = t->tets + 4 * (size_t)tet;
    for (int i = 0; i < count; i++)
        if (n[0] != nodes[i] && n[1] != nodes[i] && n[2] != nodes[i] && n[3] != nodes[i])
            return 0;
    return 1;
}

/* The nodes of the face opposite node `face`. */
static void ndli_topology_face(const ndli_topology *t, int tet, int face, int nodes[3])
{
    for (int c = 0, k = 0; c < 4; c++)
        if (c != face)
            nodes[k++] = t->tets[4 * (size_t)tet + (size_t)c];
}

/* Finds the tet behind each face, and tells it. */
static void ndli_topology_link(ndli_topology *t, int tet)
{
    for (int face = 0; face < 4; face++) {
        int nodes[3], other = -1;
        ndli_topology_face(t, tet, face, nodes);
        for (int k = t->node_star[nodes[0]]; k >= 0 && other < 0; k = t->corner_next[k])
            if (k / 4 != tet && ndli_topology_holds(t, k / 4, nodes + 1, 2))
                other = k / 4;
        t->neighbours[4 * (size_t)tet + (size_t)face] = other;
        for (int c = 0; other >= 0 && c < 4; c++) {
            int node = t->tets[4 * (size_t)other + (size_t)c];
            if (node != nodes[0] && node != nodes[1] && node != nodes[2])
                t->neighbours[4 * (size_t)other + (size_t)c] = tet;
        }
    }
}

/* ---- reading a body's mesh ---- */

/* Free slots as lists: the next one to be used first, which is the last of the body's. */
static void ndli_topology_read_free(ndli_topology *t, const sb_body *body)
{
    sbi_body_slots nodes = sbi_body_node_slots(body), cells = sbi_body_cell_slots(body);
    t->free_node = t->free_tet = -1;
    for (int i = 0; i < nodes.free_count; i++) {
        t->node_star[nodes.free[i]] = t->free_node;
        t->free_node = nodes.free[i];
    }
    for (int i = 0; i < cells.free_count; i++) {
        t->neighbours[4 * (size_t)cells.free[i]] = t->free_tet;
        t->free_tet = cells.free[i];
    }
}

static void ndli_topology_read_nodes(ndli_topology *t, const sb_body *body)
{
    const sb_vec3 *X = sb_body_rest_positions(body);
    t->node_end = sbi_body_node_slots(body).end;
    t->displaced_count = 0;
    for (int n = 0; n < t->node_end; n++) {
        t->owner[n] = t->node_star[n] = t->displaced_at[n] = -1;
        t->node_flags[n] = t->node_mark[n] = 0;
        t->X[n] = t->X0[n] = sb_body_node_in_use(body, n) ? X[n] : sb_v3(0, 0, 0);
    }
}

static void ndli_topology_read_tets(ndli_topology *t, const sb_body *body)
{
    t->tet_end = sbi_body_cell_slots(body).end;
    t->tet_count = 0;
    for (int e = t->tet_end - 1; e >= 0; e--) { /* each joins before all that are there */
        const int *nodes = sb_body_cell_nodes(body, e);
        memset(t->tets + 4 * (size_t)e, -1, 4 * sizeof(int));
        t->parents[e] = e;
        t->tet_mark[e] = 0;
        t->regions[e] = sbi_body_cell_region(body, e);
        for (int c = 3; nodes && c >= 0; c--)
            ndli_topology_join(t, 4 * e + c, nodes[c]);
        if (nodes) {
            ndli_topology_measure(t, e);
            t->tet_count++;
        }
    }
}

/* Neighbours, and which nodes are in tets, on the surface and between regions. */
static void ndli_topology_connect(ndli_topology *t)
{
    for (int e = 0; e < t->tet_end; e++)
        if (t->tets[4 * (size_t)e] >= 0)
            ndli_topology_link(t, e);
    for (int e = 0; e < t->tet_end; e++)
        for (int face = 0; face < 4 && t->tets[4 * (size_t)e] >= 0; face++) {
            int nodes[3], other = t->neighbours[4 * (size_t)e + (size_t)face];
            int flag = other < 0 ? NDLI_NODE_BOUNDARY : t->regions[other] != t->regions[e] ? NDLI_NODE_INTERFACE : 0;
            ndli_topology_face(t, e, face, nodes);
            for (int i = 0; i < 3; i++)
                t->node_flags[nodes[i]] = (unsigned char)(t->node_flags[nodes[i]] | flag);
        }
    t->node_count = 0;
    for (int n = 0; n < t->node_end; n++)
        if (t->node_star[n] >= 0) {
            t->node_flags[n] |= NDLI_NODE_ALIVE;
            t->node_count++;
        }
}

NDLI_API int ndli_topology_read(ndli_topology *mesh, const sb_body *body)
{
    sbi_body_slots nodes = sbi_body_node_slots(body), cells = sbi_body_cell_slots(body);
    if (nodes.end > mesh->node_capacity || cells.end > mesh->tet_capacity) {
        ndli_topology larger;
        memset(&larger, 0, sizeof larger);
        larger.allocator = mesh->allocator;
        if (nodes.room > INT_MAX / 8 || cells.room > INT_MAX / 8 ||
            !ndli_topology_allocate(&larger, nodes.room, cells.room))
            return 0;
        sbi_free(&mesh->allocator, mesh->block);
        *mesh = larger;
    }
    ndli_topology_read_nodes(mesh, body);
    ndli_topology_read_tets(mesh, body);
    ndli_topology_connect(mesh);
    ndli_topology_read_free(mesh, body);
    mesh->original_nodes = mesh->node_end;
    mesh->original_tets = mesh->tet_end;
    ndli_topology_look(mesh, body);
    return 1;
}

NDLI_API void ndli_topology_read_again(ndli_topology *mesh, const sb_body *body)
{
    const sb_vec3 *X = sb_body_rest_positions(body);
    int end = sbi_body_node_slots(body).end;
    mesh->node_count = 0;
    for (int n = 0; n < end; n++) {
        mesh->node_star[n] = -1;
        mesh->node_mark[n] = 0;
        mesh->X[n] = sb_body_node_in_use(body, n) ? X[n] : sb_v3(0, 0, 0);
        mesh->node_count += mesh->node_flags[n] != 0;
    }
    mesh->node_end = end;
    ndli_topology_read_tets(mesh, body);
    for (int e = 0; e < mesh->tet_end; e++)
        if (mesh->tets[4 * (size_t)e] >= 0)
            ndli_topology_link(mesh, e);
    ndli_topology_read_free(mesh, body);
    mesh->x = sb_body_positions(body);
}

NDLI_API void ndli_topology_look(ndli_topology *mesh, const sb_body *body)
{
    const unsigned char *supports = sb_body_supports(body);
    mesh->x = sb_body_positions(body);
    for (int n = 0; n < mesh->node_end; n++)
        if (mesh->node_flags[n])
            mesh->node_flags[n] = (unsigned char)(supports[n] ? mesh->node_flags[n] | NDLI_NODE_FIXED
                                                              : mesh->node_flags[n] & ~NDLI_NODE_FIXED);
}

/* ---- walks ---- */

static int ndli_topology_is_tet(const ndli_topology *t, int tet)
{
    return tet >= 0 && tet < t->tet_end && t->tets[4 * (size_t)tet] >= 0;
}

NDLI_API int ndli_topology_find(const ndli_topology *mesh, const sb_vec3 *positions, sb_vec3 point, int start,
                                sb_real weights[4])
{
    sb_real w[4], slack = -64 * SB_EPSILON;
    int tet = start, from = -1;
    if (!mesh || !positions || !ndli_topology_is_tet(mesh, start) || !sb_v3_is_finite(point))
        return -1;
    /* A walk over tets that are not Delaunay, or inverted in space, may circle: it ends after as many steps as a
     * straight line could at most need. */
    for (int step = 0; step < mesh->tet_count; step++) {
        const int *n = mesh->tets + 4 * (size_t)tet;
        int worst = -1, next;
        ndli_tet_weights(positions[n[0]], positions[n[1]], positions[n[2]], positions[n[3]], point, w);
        for (int c = 0; c < 4; c++)
            if (!(w[c] >= slack) && (worst < 0 || w[c] < w[worst]) &&
                (mesh->neighbours[4 * (size_t)tet + (size_t)c] != from || from < 0))
                worst = c;
        if (worst < 0)
            break;
        next = mesh->neighbours[4 * (size_t)tet + (size_t)worst];
        for (int c = 0; next < 0 && c < 4; c++) /* round a dent of the surface, if there is a way */
            if (c != worst && w[c] < slack && mesh->neighbours[4 * (size_t)tet + (size_t)c] != from)
                next = mesh->neighbours[4 * (size_t)tet + (size_t)c];
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

NDLI_API sb_mat3 ndli_topology_gradient(const ndli_topology *mesh, int tet)
{
    const int *n = mesh->tets + 4 * (size_t)tet;
    sb_mat3 material, space;
    for (int c = 0; c < 3; c++) {
        sb_vec3 a = sb_v3_sub(mesh->X[n[c + 1]], mesh->X[n[0]]), b = sb_v3_sub(mesh->x[n[c + 1]], mesh->x[n[0]]);
        material.m[0][c] = a.x, material.m[1][c] = a.y, material.m[2][c] = a.z;
        space.m[0][c] = b.x, space.m[1][c] = b.y, space.m[2][c] = b.z;
    }
    return sb_m3_mul(space, sb_m3_inverse(material));
}

/* How well a tet has kept its shape in space: 1 where it has only been turned, moved or scaled; inverted: <= 0. */
static sb_real ndli_topology_kept(const ndli_topology *t, int tet)
{
    sb_mat3 f = ndli_topology_gradient(t, tet);
    sb_real squares = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            squares += f.m[i][j] * f.m[i][j];
    squares /= 3;
    return squares > 0 ? sb_m3_det(f) / (squares * sb_sqrt(squares)) : 0;
}

static int ndli_topology_holds_point(const ndli_topology *t, int tet, sb_vec3 x)
{
    const int *n = t->tets + 4 * (size_t)tet;
    sb_vec3 a = t->x[n[0]], b = t->x[n[1]], c = t->x[n[2]], d = t->x[n[3]];
    return ndli_topology_det(x, b, c, d) >= 0 && ndli_topology_det(a, x, c, d) >= 0 &&
           ndli_topology_det(a, b, x, d) >= 0 && ndli_topology_det(a, b, c, x) >= 0;
}

NDLI_API int ndli_topology_find_in_space(const ndli_topology *mesh, sb_vec3 x, int start)
{
    int tet = ndli_topology_find(mesh, mesh->x, x, start, NULL);
    sb_real best = 0;
    if (tet >= 0 && ndli_topology_kept(mesh, tet) > 0)
        return tet;
    for (int t = 0; t < mesh->tet_end; t++) {
        sb_real kept =
            ndli_topology_is_tet(mesh, t) && ndli_topology_holds_point(mesh, t, x) ? ndli_topology_kept(mesh, t) : 0;
        if (kept > best) {
            best = kept;
            tet = t;
        }
    }
    return tet;
}

/* Where the segment p + s d crosses the triangle from its front (normal against d): s, or -1. */
static sb_real ndli_topology_cross(sb_vec3 p, sb_vec3 d, sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_real w[3])
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

NDLI_API int ndli_topology_hit(const ndli_topology *mesh, sb_vec3 from, sb_vec3 to, ndl_surface_hit *hit)
{
    sb_vec3 d = sb_v3_sub(to, from);
    int found = 0;
    if (!mesh || !hit || !sb_v3_is_finite(from) || !sb_v3_is_finite(to))
        return 0;
    for (int tet = 0; tet < mesh->tet_end; tet++) {
        const int *n = mesh->tets + 4 * (size_t)tet;
        static const int outward[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
        for (int face = 0; n[0] >= 0 && face < 4; face++) {
            int a = n[outward[face][0]], b = n[outward[face][1]], c = n[outward[face][2]];
            sb_real w[3], along;
            if (mesh->neighbours[4 * (size_t)tet + (size_t)face] >= 0)
                continue;
            along = ndli_topology_cross(from, d, mesh->x[a], mesh->x[b], mesh->x[c], w);
            if (along < 0 || along > 1 || (found && along >= hit->along))
                continue;
            found = 1;
            hit->tet = tet;
            hit->face = face;
            hit->along = along;
            hit->X = sb_v3_madd(sb_v3_madd(sb_v3_scale(w[0], mesh->X[a]), w[1], mesh->X[b]), w[2], mesh->X[c]);
        }
    }
    return found;
}

/* ---- a change ---- */

enum { NDLI_TOUCHED = 1, NDLI_WAS_ALIVE = 2, NDLI_RELINK = 4, NDLI_DROPPED = 8 };

static void ndli_topology_affect(ndli_topology *t, int node, int was_alive)
{
    if (t->node_mark[node])
        return;
    t->node_mark[node] = (unsigned char)(was_alive ? NDLI_TOUCHED | NDLI_WAS_ALIVE : NDLI_TOUCHED);
    t->affected[t->affected_count++] = node;
}

/* To be called before a tet is changed, and after one is made. */
static void ndli_topology_touch(ndli_topology *t, int tet, int made, int relink)
{
    if (!t->tet_mark[tet]) {
        t->tet_mark[tet] = (unsigned char)(made ? NDLI_TOUCHED : NDLI_TOUCHED | NDLI_WAS_ALIVE);
        t->touched[t->touched_count++] = tet;
    }
    if (relink)
        t->tet_mark[tet] |= NDLI_RELINK;
    for (int c = 0; c < 4; c++)
        ndli_topology_affect(t, t->tets[4 * (size_t)tet + (size_t)c], 1);
}

NDLI_API void ndli_topology_begin(ndli_topology *mesh)
{
    mesh->touched_count = mesh->affected_count = mesh->change_count = 0;
    mesh->node_event_count = mesh->tet_event_count = 0;
    mesh->displaced_before_count = mesh->displaced_count;
    if (mesh->displaced_count)
        memcpy(mesh->displaced_before, mesh->displaced, (size_t)mesh->displaced_count * sizeof(int));
}

NDLI_API int ndli_topology_source(const ndli_topology *t, sb_vec3 X, int start, sb_real w[4])
{
    int tet = ndli_topology_find(t, t->X, X, start, w), best = start;
    sb_real most = -SB_REAL_MAX, sum = 0;
    for (int c = 0; tet < 0 && c < 4; c++) { /* a dent may have ended the walk: look about the start */
        for (int k = t->node_star[t->tets[4 * (size_t)start + (size_t)c]]; k >= 0; k = t->corner_next[k]) {
            const int *n = t->tets + 4 * (size_t)(k / 4);
            sb_real least;
            ndli_tet_weights(t->X[n[0]], t->X[n[1]], t->X[n[2]], t->X[n[3]], X, w);
            least = sb_min(sb_min(w[0], w[1]), sb_min(w[2], w[3]));
            if (least > most) {
                most = least;
                best = k / 4;
            }
        }
    }
    if (tet < 0) {
        const int *n = t->tets + 4 * (size_t)best;
        ndli_tet_weights(t->X[n[0]], t->X[n[1]], t->X[n[2]], t->X[n[3]], X, w);
    }
    for (int c = 0; c < 4; c++)
        sum += w[c] = sb_max(w[c], 0);
    for (int c = 0; c < 4; c++)
        w[c] /= sum;
    return tet < 0 ? best : tet;
}

NDLI_API int ndli_topology_plan(ndli_topology *mesh, int node, sb_vec3 X, int start)
{
    ndli_node_change *change = mesh->changes + mesh->change_count;
    int tet = ndli_topology_source(mesh, X, start, change->weights);
    change->node = node;
    change->created = node < 0;
    change->X = X;
    for (int c = 0; c < 4; c++)
        change->sources[c] = mesh->tets[4 * (size_t)tet + (size_t)c];
    return mesh->change_count++;
}

/* A slot comes into use or (made = 0) goes out of it; what it was is kept. */
static void ndli_topology_note_node(ndli_topology *t, int node, int made)
{
    ndli_node_event *event = t->node_events + t->node_event_count++;
    event->node = made ? node : ~node;
    event->owner = t->owner[node];
    event->flags = t->node_flags[node];
    event->X0 = t->X0[node];
}

static int ndli_topology_make_node(ndli_topology *t, sb_vec3 X)
{
    int node = t->free_node;
    if (node >= 0)
        t->free_node = t->node_star[node];
    else
        node = t->node_end++;
    t->node_count++;
    ndli_topology_note_node(t, node, 1);
    t->X[node] = t->X0[node] = X;
    t->owner[node] = t->node_star[node] = t->displaced_at[node] = -1;
    t->node_flags[node] = NDLI_NODE_ALIVE | NDLI_NODE_CREATED;
    ndli_topology_affect(t, node, 0);
    return node;
}

static void ndli_topology_drop_node(ndli_topology *t, int node)
{
    SB_ASSERT(t->node_star[node] < 0);
    ndli_topology_note_node(t, node, 0);
    t->node_flags[node] = 0;
    t->owner[node] = -1;
    t->X[node] = t->X0[node] = sb_v3(0, 0, 0);
    t->node_star[node] = t->free_node;
    t->free_node = node;
    t->node_count--;
}

/* A copy of a tet with another node at one corner. */
static int ndli_topology_make_tet(ndli_topology *t, int pattern, int corner, int node)
{
    int tet = t->free_tet;
    if (tet >= 0)
        t->free_tet = t->neighbours[4 * (size_t)tet];
    else
        tet = t->tet_end++;
    t->tet_count++;
    for (int c = 0; c < 4; c++)
        ndli_topology_join(t, 4 * tet + c, c == corner ? node : t->tets[4 * (size_t)pattern + (size_t)c]);
    t->regions[tet] = t->regions[pattern];
    t->parents[tet] = pattern;
    t->tet_events[t->tet_event_count++] = tet;
    ndli_topology_touch(t, tet, 1, 1);
    return tet;
}

static void ndli_topology_drop_tet(ndli_topology *t, int tet)
{
    ndli_topology_touch(t, tet, 0, 1);
    for (int c = 0; c < 4; c++)
        ndli_topology_leave(t, 4 * tet + c);
    memset(t->tets + 4 * (size_t)tet, -1, 4 * sizeof(int));
    t->neighbours[4 * (size_t)tet] = t->free_tet;
    t->free_tet = tet;
    t->tet_count--;
    t->tet_mark[tet] |= NDLI_DROPPED;
    t->tet_events[t->tet_event_count++] = ~tet;
}

static int ndli_topology_corner(const ndli_topology *t, int tet, int node)
{
    int c = 0;
    while (c < 3 && t->tets[4 * (size_t)tet + (size_t)c] != node)
        c++;
    return c;
}

static void ndli_topology_replace(ndli_topology *t, int tet, int old, int node)
{
    int corner = 4 * tet + ndli_topology_corner(t, tet, old);
    ndli_topology_touch(t, tet, 0, 1);
    ndli_topology_leave(t, corner);
    ndli_topology_join(t, corner, node);
}

NDLI_API int ndli_topology_cut(ndli_topology *mesh, const int *simplex, int size, int plan, int *groups)
{
    int node = ndli_topology_make_node(mesh, mesh->changes[plan].X), count = 0, mixed = 0;
    mesh->changes[plan].node = node;
    for (int k = mesh->node_star[simplex[0]]; k >= 0; k = mesh->corner_next[k])
        if (ndli_topology_holds(mesh, k / 4, simplex, size))
            groups[size * count++] = k / 4;
    for (int g = 0; g < count; g++) {
        int parent = groups[size * g];
        mixed |= mesh->regions[parent] != mesh->regions[groups[0]];
        ndli_topology_touch(mesh, parent, 0, 1);
        for (int j = 1; j < size; j++)
            groups[size * g + j] =
                ndli_topology_make_tet(mesh, parent, ndli_topology_corner(mesh, parent, simplex[j]), node);
        ndli_topology_replace(mesh, parent, simplex[0], node);
    }
    if (mixed)
        mesh->node_flags[node] |= NDLI_NODE_INTERFACE;
    return count;
}

NDLI_API void ndli_topology_mend(ndli_topology *mesh, int node, const int *simplex, int size, const int *groups,
                                 int count)
{
    for (int g = count - 1; g >= 0; g--) {
        for (int j = size - 1; j > 0; j--)
            ndli_topology_drop_tet(mesh, groups[size * g + j]);
        ndli_topology_replace(mesh, groups[size * g], node, simplex[0]);
    }
    ndli_topology_drop_node(mesh, node);
}

/* Keeps the list of nodes that are not at their own place. */
static void ndli_topology_note_displaced(ndli_topology *t, int node)
{
    int is = memcmp(t->X + node, t->X0 + node, sizeof(sb_vec3)) != 0 && !(t->node_flags[node] & NDLI_NODE_CREATED);
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

NDLI_API void ndli_topology_move(ndli_topology *mesh, int plan)
{
    int node = mesh->changes[plan].node;
    for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k])
        ndli_topology_touch(mesh, k / 4, 0, 0);
    mesh->X[node] = mesh->changes[plan].X;
    ndli_topology_note_displaced(mesh, node);
}

static void ndli_topology_report(ndli_topology *t, ndli_topology_change *change)
{
    memset(change, 0, sizeof *change);
    for (int i = 0; i < t->touched_count; i++) {
        int tet = t->touched[i];
        if ((t->tet_mark[tet] & (NDLI_WAS_ALIVE | NDLI_DROPPED)) == NDLI_WAS_ALIVE)
            t->changed[change->changed_count++] = tet;
    }
    change->changed = t->changed;
    change->node_events = t->node_events;
    change->tet_events = t->tet_events;
    change->node_event_count = t->node_event_count;
    change->tet_event_count = t->tet_event_count;
    change->nodes = t->changes;
    change->node_count = t->change_count;
}

NDLI_API void ndli_topology_end(ndli_topology *mesh, ndli_topology_change *change)
{
    for (int i = 0; i < mesh->touched_count; i++)
        if (mesh->tets[4 * (size_t)mesh->touched[i]] >= 0) {
            ndli_topology_measure(mesh, mesh->touched[i]);
            if (mesh->tet_mark[mesh->touched[i]] & NDLI_RELINK)
                ndli_topology_link(mesh, mesh->touched[i]);
        }
    ndli_topology_report(mesh, change);
    for (int i = 0; i < mesh->touched_count; i++)
        mesh->tet_mark[mesh->touched[i]] = 0;
    for (int i = 0; i < mesh->affected_count; i++)
        mesh->node_mark[mesh->affected[i]] = 0;
}

/* The list of displaced nodes as another one says; their places in it with it. */
static void ndli_topology_set_displaced(ndli_topology *t, const int *list, int count)
{
    for (int n = 0; n < t->node_end; n++)
        t->displaced_at[n] = -1;
    for (int i = 0; i < count; i++) {
        t->displaced[i] = list[i];
        t->displaced_at[list[i]] = i;
    }
    t->displaced_count = count;
}

NDLI_API void ndli_topology_take_back(ndli_topology *mesh, const sb_body *body)
{
    for (int i = mesh->node_event_count - 1; i >= 0; i--) {
        const ndli_node_event *event = mesh->node_events + i;
        int node = event->node < 0 ? ~event->node : event->node;
        mesh->owner[node] = event->owner;
        mesh->node_flags[node] = event->flags;
        mesh->X0[node] = event->X0;
    }
    ndli_topology_read_again(mesh, body);
    ndli_topology_set_displaced(mesh, mesh->displaced_before, mesh->displaced_before_count);
}

/* ---- measures and checks ---- */

/* Extreme cosines of a tet's six dihedral angles. */
static void ndli_topology_cosines(const ndli_topology *t, int tet, sb_real *low, sb_real *high)
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

NDLI_API void ndli_topology_quality(const ndli_topology *mesh, sb_real *worst_quality, sb_real *min_dihedral,
                                    sb_real *max_dihedral)
{
    sb_real worst = 1, low = 1, high = -1, degrees = (sb_real)57.295779513082323;
    if (!mesh)
        return;
    for (int t = 0; t < mesh->tet_end; t++) {
        if (mesh->tets[4 * (size_t)t] < 0)
            continue;
        worst = sb_min(worst, mesh->qualities[t]);
        if (min_dihedral || max_dihedral)
            ndli_topology_cosines(mesh, t, &low, &high);
    }
    if (worst_quality)
        *worst_quality = worst;
    if (min_dihedral)
        *min_dihedral = degrees * sb_acos(high);
    if (max_dihedral)
        *max_dihedral = degrees * sb_acos(low);
}

static sb_result ndli_topology_check_tet(const ndli_topology *t, int tet, sb_error *error)
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
        ndli_topology_face(t, tet, c, nodes);
        for (int k = 0; ndli_topology_is_tet(t, other) && k < 4; k++)
            back |= t->neighbours[4 * (size_t)other + (size_t)k] == tet;
        if (!back || !ndli_topology_holds(t, other, nodes, 3))
            return sbi_fail_element(error, SB_ERROR_MESH, tet, "tet %d and its neighbour %d disagree", tet, other);
    }
    if (t->tet_mark[tet] || !(t->qualities[tet] > 0))
        return sbi_fail_element(error, SB_ERROR_MESH, tet, "tet %d is flat, inverted or marked", tet);
    return SB_OK;
}

NDLI_API sb_result ndli_topology_check(const ndli_topology *mesh, sb_error *error)
{
    sb_result result = SB_OK;
    int tets = 0, nodes = 0, corners = 0;
    if (!mesh || !mesh->block)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "no mesh");
    for (int t = 0; result == SB_OK && t < mesh->tet_end; t++)
        if (mesh->tets[4 * (size_t)t] >= 0) {
            tets++;
            result = ndli_topology_check_tet(mesh, t, error);
        }
    for (int n = 0; result == SB_OK && n < mesh->node_end; n++)
        if (mesh->node_flags[n]) {
            nodes++;
            for (int k = mesh->node_star[n]; k >= 0 && corners <= 4 * mesh->tet_count; k = mesh->corner_next[k])
                corners++;
        }
    if (result == SB_OK && (tets != mesh->tet_count || nodes != mesh->node_count || corners != 4 * tets))
        result = sbi_fail(error, SB_ERROR_MESH, "counts disagree: %d tets, %d nodes, %d corners", tets, nodes, corners);
    return result;
}

NDLI_API int ndli_topology_is_original(const ndli_topology *mesh)
{
    if (!mesh || mesh->displaced_count)
        return 0;
    for (int n = 0; n < mesh->node_end; n++)
        if (mesh->node_flags[n] & NDLI_NODE_CREATED)
            return 0;
    return 1;
}

/* ---- undo and state ---- */

NDLI_API void ndli_topology_counts(const ndli_topology *mesh, int *counts)
{
    counts[0] = mesh->node_end;
    while (counts[0] > 0 && !mesh->node_flags[counts[0] - 1])
        counts[0]--;
    counts[1] = mesh->displaced_count;
    counts[2] = mesh->original_nodes, counts[3] = mesh->original_tets;
}

NDLI_API void ndli_topology_walk(ndli_topology *mesh, const int *counts, ndli_image *image)
{
    size_t nodes = (size_t)counts[0];
    ndli_image_part(image, mesh->X0, nodes, sizeof(sb_vec3));
    ndli_image_part(image, mesh->owner, nodes, sizeof(int));
    ndli_image_part(image, mesh->node_flags, nodes, 1);
    ndli_image_part(image, mesh->displaced, (size_t)counts[1], sizeof(int));
}

NDLI_API void ndli_topology_recall(ndli_topology *mesh, const int *counts, const sb_body *body)
{
    int end = sbi_body_node_slots(body).end;
    mesh->original_nodes = counts[2];
    mesh->original_tets = counts[3];
    for (int n = counts[0]; n < end; n++) {
        mesh->node_flags[n] = 0;
        mesh->owner[n] = -1;
        mesh->X0[n] = sb_v3(0, 0, 0);
    }
    ndli_topology_read_again(mesh, body);
    for (int n = 0; n < mesh->node_end; n++)
        mesh->displaced_at[n] = -1;
    mesh->displaced_count = counts[1];
    for (int i = 0; i < counts[1]; i++)
        mesh->displaced_at[mesh->displaced[i]] = i;
}

NDLI_API sb_result ndli_topology_check_memory(const ndli_topology *mesh, const int *counts, const unsigned char *in,
                                              int max_owner, sb_error *error)
{
    enum {
        KNOWN = NDLI_NODE_ALIVE | NDLI_NODE_BOUNDARY | NDLI_NODE_INTERFACE | NDLI_NODE_FIXED | NDLI_NODE_CREATED |
                NDLI_NODE_NEEDLE
    };
    size_t nodes = (size_t)counts[0];
    const unsigned char *owners = in + ndli_image_room(nodes * sizeof(sb_vec3));
    const unsigned char *flags = owners + ndli_image_room(nodes * sizeof(int));
    const unsigned char *list = flags + ndli_image_room(nodes);
    int displaced = 0;
    for (int n = 0; n < counts[0]; n++) {
        int owner = ndli_image_int(owners, (size_t)n), away;
        sb_vec3 X0;
        memcpy(&X0, in + (size_t)n * sizeof X0, sizeof X0);
        away = flags[n] && !(flags[n] & NDLI_NODE_CREATED) && memcmp(&X0, mesh->X + n, sizeof X0) != 0;
        displaced += away;
        if (!sb_v3_is_finite(X0))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, n, "the saved place of node %d is not finite", n);
        if ((flags[n] & ~KNOWN) || (flags[n] != 0) != (mesh->node_star[n] >= 0 && n < mesh->node_end) || owner < -1 ||
            owner >= max_owner || (flags[n] && !(flags[n] & NDLI_NODE_ALIVE)))
            return sbi_fail_node(error, SB_ERROR_FORMAT, n, "the saved remesher is damaged at node %d", n);
    }
    for (int i = 0; i < counts[1]; i++) {
        int n = ndli_image_int(list, (size_t)i);
        sb_vec3 X0;
        if (n < 0 || n >= counts[0])
            return sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher is damaged: it has displaced node %d", n);
        memcpy(&X0, in + (size_t)n * sizeof X0, sizeof X0);
        for (int k = 0; k < i; k++)
            displaced -= ndli_image_int(list, (size_t)k) == n; /* twice: the sum below is wrong then */
        displaced -= flags[n] && !(flags[n] & NDLI_NODE_CREATED) && memcmp(&X0, mesh->X + n, sizeof X0) != 0;
    }
    return displaced == 0 ? SB_OK
                          : sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher's list of displaced nodes is damaged");
}

NDLI_API int ndli_topology_first_tet(const ndli_topology *mesh, int i, int j)
{
    for (int k = mesh->node_star[i]; k >= 0; k = mesh->corner_next[k])
        if (ndli_topology_holds(mesh, k / 4, &j, 1))
            return k / 4;
    return -1;
}
