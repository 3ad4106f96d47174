/* stuffing_boundary: 6. nodes slide along the surface, and edges are split, until the boundary is near enough. */
#include "stuffing_private.h"

/* ---- 6. the boundary ----
 * Its nodes lie on the surface, but a triangle between them cuts the corner at ridges and thin parts. Where it leaves
 * the surface by more than SBI_STUFF_FAR its nodes slide along the surface towards what it misses, as long as all tets
 * at them keep angles within the bounds and no triangle becomes worse than the worst was; where that is not enough,
 * edges get a node in the middle, under the same condition. */

typedef struct sbi_stuffing_rim {
    const sbi_stuffing *s;
    sb_mesh *mesh;
    sb_boundary boundary;
    sb_index_lists tets, faces; /* of nodes of the mesh; of nodes of the boundary */
    sb_real *worst;             /* [faces] largest distance of a sample */
} sbi_stuffing_rim;

/* Closest point of the first shape; functions: by Newton steps along the gradient, of a cell at most. p itself where
 * they lead nowhere, as for functions that are no distances at all. */
static sb_vec3 sbi_stuffing_closest(const sbi_stuffing *s, sb_vec3 p)
{
    const sb_shape *g = s->def->shapes;
    const sb_real step = (sb_real)0.01 * s->half;
    const sb_vec3 start = p;
    sb_surface_hit hit;
    sb_real first;
    if (g->surface)
        return sb_surface_closest(g->surface, p, SB_REAL_MAX, &hit) ? hit.point : p;
    first = sb_abs(sbi_stuffing_value(s, 0, p));
    for (int i = 0; i < 4; i++) {
        sb_real value = sbi_stuffing_value(s, 0, p), size, length;
        sb_vec3 n;
        n.x = sbi_stuffing_value(s, 0, sb_v3(p.x + step, p.y, p.z));
        n.y = sbi_stuffing_value(s, 0, sb_v3(p.x, p.y + step, p.z));
        n.z = sbi_stuffing_value(s, 0, sb_v3(p.x, p.y, p.z + step));
        n.x -= sbi_stuffing_value(s, 0, sb_v3(p.x - step, p.y, p.z));
        n.y -= sbi_stuffing_value(s, 0, sb_v3(p.x, p.y - step, p.z));
        n.z -= sbi_stuffing_value(s, 0, sb_v3(p.x, p.y, p.z - step));
        size = sb_v3_norm(n);
        if (!(size > 0) || !sb_is_finite(size))
            break;
        length = sb_min(sb_abs(value) * 2 * step / size, s->def->cell);
        p = sb_v3_madd(p, (value > 0 ? -length : length) / size, n);
    }
    return sb_abs(sbi_stuffing_value(s, 0, p)) < (sb_real)0.1 * first ? p : start;
}

/* Sample k of a triangle: corners, middles of edges, centre, quarters of edges, and between. */
static sb_vec3 sbi_stuffing_sample_point(const sb_mesh *surface, int face, int k)
{
    static const signed char twelfths[SBI_STUFF_SAMPLES][3] = {
        {12, 0, 0}, {0, 12, 0}, {0, 0, 12}, {6, 6, 0}, {0, 6, 6}, {6, 0, 6}, {4, 4, 4}, {9, 3, 0},
        {3, 9, 0},  {0, 9, 3},  {0, 3, 9},  {3, 0, 9}, {9, 0, 3}, {6, 3, 3}, {3, 6, 3}, {3, 3, 6}};
    const int *nodes = surface->elements + 3 * (size_t)face;
    sb_vec3 p = sb_v3(0, 0, 0);
    for (int i = 0; i < 3; i++)
        p = sb_v3_madd(p, (sb_real)twelfths[k][i] / 12, surface->nodes[nodes[i]]);
    return p;
}

/* Largest distance of a triangle's samples; *from (or NULL) the worst of them, *away from there to the surface. Gives
 * up beyond `limit`: what is returned is then some distance above it. Triangles close to the surface at their first
 * samples are not far between them. */
static sb_real sbi_stuffing_face_distance(const sbi_stuffing_rim *rim, int face, sb_real limit, sb_vec3 *from,
                                          sb_vec3 *away)
{
    const sb_real doubtful = (sb_real)0.5 * SBI_STUFF_FAR * rim->s->def->cell;
    sb_real worst = 0;
    for (int i = 0; i < SBI_STUFF_SAMPLES && worst <= limit; i++) {
        int k = i < SBI_STUFF_FIRST_SAMPLES ? SBI_STUFF_FIRST_SAMPLES - 1 - i : i;
        sb_vec3 p, d;
        sb_real distance;
        if (i == SBI_STUFF_FIRST_SAMPLES && worst < doubtful)
            break;
        p = sbi_stuffing_sample_point(&rim->boundary.surface, face, k);
        d = sb_v3_sub(sbi_stuffing_closest(rim->s, p), p);
        distance = sb_v3_norm(d);
        if (away && (distance > worst || i == 0)) {
            *from = p;
            *away = d;
        }
        worst = sb_max(worst, distance);
    }
    return worst;
}

static void sbi_stuffing_measure_task(void *user, int index)
{
    sbi_stuffing_rim *rim = (sbi_stuffing_rim *)user;
    int count = rim->boundary.surface.element_count;
    int end = index < (count - 1) / SBI_STUFF_CHUNK ? (index + 1) * SBI_STUFF_CHUNK : count;
    for (int f = index * SBI_STUFF_CHUNK; f < end; f++)
        rim->worst[f] = sbi_stuffing_face_distance(rim, f, SB_REAL_MAX, NULL, NULL);
}

static void sbi_stuffing_set_node(sbi_stuffing_rim *rim, int node, sb_vec3 x)
{
    rim->boundary.surface.nodes[node] = x;
    rim->mesh->nodes[rim->boundary.nodes[node]] = x;
}

/* Whether a tet is positive and well shaped with node `node` at x. */
static int sbi_stuffing_is_sound(const sb_mesh *mesh, int tet, int node, sb_vec3 x)
{
    const int *nodes = mesh->elements + 4 * (size_t)tet;
    sb_vec3 c[4];
    for (int i = 0; i < 4; i++)
        c[i] = nodes[i] == node ? x : mesh->nodes[nodes[i]];
    return sb_v3_dot(sb_v3_cross(sb_v3_sub(c[1], c[0]), sb_v3_sub(c[2], c[0])), sb_v3_sub(c[3], c[0])) > 0 &&
           sbi_stuffing_is_well_shaped(c);
}

static int sbi_stuffing_tets_are_sound(const sbi_stuffing_rim *rim, int node, sb_vec3 x)
{
    int at = rim->boundary.nodes[node];
    for (int k = rim->tets.offsets[at]; k < rim->tets.offsets[at + 1]; k++)
        if (!sbi_stuffing_is_sound(rim->mesh, rim->tets.items[k], at, x))
            return 0;
    return 1;
}

/* Largest distance of the triangles at a node; gives up beyond `limit`. */
static sb_real sbi_stuffing_distance_round(const sbi_stuffing_rim *rim, int node, sb_real limit)
{
    sb_real worst = 0;
    for (int k = rim->faces.offsets[node]; k < rim->faces.offsets[node + 1] && worst <= limit; k++)
        worst = sb_max(worst, sbi_stuffing_face_distance(rim, rim->faces.items[k], limit, NULL, NULL));
    return worst;
}

/* Slides a node by about `by`, or towards the point that lies too far away, where that brings the triangles round it
 * closer to the surface. Returns 1 when it did. */
static int sbi_stuffing_slide(sbi_stuffing_rim *rim, int node, sb_vec3 from, sb_vec3 by)
{
    static const sb_real scales[6][2] = {{1, 0}, {(sb_real)0.5, 0},  {2, 0},
                                         {0, 0}, {0, (sb_real)0.25}, {0, (sb_real)0.5}};
    sb_vec3 start = rim->boundary.surface.nodes[node], best = start;
    sb_real least = 0;
    for (int k = rim->faces.offsets[node]; k < rim->faces.offsets[node + 1]; k++)
        least = sb_max(least, rim->worst[rim->faces.items[k]]);
    least *= (sb_real)0.99; /* gains of less are not worth a round */
    for (int i = 0; i < 6; i++) {
        sb_real distance;
        sb_vec3 step = sb_v3_madd(sb_v3_scale(scales[i][0], by), scales[i][1], sb_v3_sub(from, start));
        sb_vec3 x = sbi_stuffing_closest(rim->s, sb_v3_add(start, step));
        if (!sbi_stuffing_tets_are_sound(rim, node, x))
            continue;
        sbi_stuffing_set_node(rim, node, x);
        distance = sbi_stuffing_distance_round(rim, node, least);
        if (distance < least) {
            least = distance;
            best = rim->boundary.surface.nodes[node];
        }
    }
    sbi_stuffing_set_node(rim, node, best);
    if (sb_v3_norm(sb_v3_sub(best, start)) == 0)
        return 0;
    for (int k = rim->faces.offsets[node]; k < rim->faces.offsets[node + 1]; k++)
        rim->worst[rim->faces.items[k]] = sbi_stuffing_face_distance(rim, rim->faces.items[k], SB_REAL_MAX, NULL, NULL);
    return 1;
}

static sb_result sbi_stuffing_slide_all(sbi_stuffing_rim *rim)
{
    const sb_real enough = SBI_STUFF_FAR * rim->s->def->cell;
    const sb_mesh *surface = &rim->boundary.surface;
    sb_result result;
    int changed = 0;
    for (int f = 0; f < surface->element_count; f++)
        changed |= rim->worst[f] > enough;
    if (!changed)
        return SB_OK;
    result = sb_mesh_node_elements(rim->mesh, &rim->s->def->allocator, &rim->tets, rim->s->error);
    if (result == SB_OK)
        result = sb_mesh_node_elements(surface, &rim->s->def->allocator, &rim->faces, rim->s->error);
    for (int round = 0; round < SBI_STUFF_ROUNDS && changed && result == SB_OK; round++) {
        changed = 0;
        for (int f = 0; f < surface->element_count; f++) {
            for (int i = 0; i < 3 && rim->worst[f] > enough; i++) {
                sb_vec3 from = {0, 0, 0}, away = {0, 0, 0};
                sbi_stuffing_face_distance(rim, f, SB_REAL_MAX, &from, &away);
                changed |= sbi_stuffing_slide(rim, surface->elements[3 * (size_t)f + (size_t)i], from, away);
            }
        }
    }
    return result;
}

/* An edge of the boundary that is to get a node in the middle, at `at` on the surface. */
typedef struct sbi_stuffing_split {
    int a, b; /* nodes of the mesh */
    sb_vec3 at;
} sbi_stuffing_split;

static int sbi_stuffing_tet_has(const sb_mesh *mesh, int tet, int node)
{
    const int *nodes = mesh->elements + 4 * (size_t)tet;
    return nodes[0] == node || nodes[1] == node || nodes[2] == node || nodes[3] == node;
}

/* Whether the tets round an edge stay sound when it is split; taken [tets]: those that other splits change already.
 * Returns how many there are, or 0. */
static int sbi_stuffing_can_split(const sbi_stuffing_rim *rim, const sbi_stuffing_split *split,
                                  const unsigned char *taken)
{
    int count = 0;
    for (int k = rim->tets.offsets[split->a]; k < rim->tets.offsets[split->a + 1]; k++) {
        int tet = rim->tets.items[k];
        if (!sbi_stuffing_tet_has(rim->mesh, tet, split->b))
            continue;
        if (taken[tet] || !sbi_stuffing_is_sound(rim->mesh, tet, split->a, split->at) ||
            !sbi_stuffing_is_sound(rim->mesh, tet, split->b, split->at))
            return 0;
        count++;
    }
    return count;
}

/* Chooses a split for a triangle that is too far from the surface: the edge whose middle is, or its longest one, with
 * the new node where the middle's closest point is or beyond it, towards a ridge; in the last round, if need be, half
 * way to it. Returns how many tets it adds, or 0. */
static int sbi_stuffing_choose_split(const sbi_stuffing_rim *rim, int face, int is_last, const unsigned char *taken,
                                     sbi_stuffing_split *split)
{
    const int *nodes = rim->boundary.surface.elements + 3 * (size_t)face;
    const sb_vec3 *x = rim->boundary.surface.nodes;
    int edge = -1, longest = 0, count = 0, last = is_last ? 1 : 2;
    sb_real farthest = SBI_STUFF_FAR * rim->s->def->cell;
    sb_vec3 middle, away;
    for (int k = 0; k < 3; k++) {
        sb_vec3 p = sbi_stuffing_sample_point(&rim->boundary.surface, face, 3 + k);
        sb_real distance = sb_v3_norm(sb_v3_sub(sbi_stuffing_closest(rim->s, p), p));
        if (distance > farthest) {
            farthest = distance;
            edge = k;
        }
        if (sb_v3_norm(sb_v3_sub(x[nodes[k]], x[nodes[(k + 1) % 3]])) >
            sb_v3_norm(sb_v3_sub(x[nodes[longest]], x[nodes[(longest + 1) % 3]])))
            longest = k;
    }
    edge = edge < 0 ? longest : edge;
    split->a = rim->boundary.nodes[nodes[edge]];
    split->b = rim->boundary.nodes[nodes[(edge + 1) % 3]];
    middle = sbi_stuffing_sample_point(&rim->boundary.surface, face, 3 + edge);
    away = sb_v3_sub(sbi_stuffing_closest(rim->s, middle), middle);
    for (int k = 4; k >= last && count == 0; k--) {
        sb_vec3 at = sb_v3_madd(middle, (sb_real)0.5 * (sb_real)k, away);
        split->at = k > 1 ? sbi_stuffing_closest(rim->s, at) : at;
        count = sbi_stuffing_can_split(rim, split, taken);
    }
    return count;
}

/* The mesh with edges split; no tet has two of them. */
static sb_result sbi_stuffing_apply_splits(const sbi_stuffing_rim *rim, const sbi_stuffing_split *splits, int count,
                                           int added, sb_mesh *result)
{
    const sb_mesh *mesh = rim->mesh;
    int next = mesh->element_count;
    if (mesh->element_count > rim->s->def->max_elements - added)
        return sbi_stuffing_too_many(rim->s);
    if (!sbi_mesh_allocate(result, SB_TET4, mesh->node_count + count, mesh->element_count + added, 1,
                           &rim->s->def->allocator))
        return sbi_fail(rim->s->error, SB_ERROR_MEMORY, "out of memory for a mesh of %d nodes",
                        mesh->node_count + count);
    memcpy(result->nodes, mesh->nodes, (size_t)mesh->node_count * sizeof(sb_vec3));
    memcpy(result->elements, mesh->elements, (size_t)mesh->element_count * 4 * sizeof(int));
    memcpy(result->regions, mesh->regions, (size_t)mesh->element_count * sizeof(int));
    for (int i = 0; i < count; i++) {
        const sbi_stuffing_split *split = splits + i;
        result->nodes[mesh->node_count + i] = split->at;
        for (int k = rim->tets.offsets[split->a]; k < rim->tets.offsets[split->a + 1]; k++) {
            int tet = rim->tets.items[k], *old = result->elements + 4 * (size_t)tet;
            int *half = result->elements + 4 * (size_t)next;
            if (!sbi_stuffing_tet_has(mesh, tet, split->b))
                continue;
            for (int j = 0; j < 4; j++) {
                half[j] = old[j] == split->b ? mesh->node_count + i : old[j];
                old[j] = old[j] == split->a ? mesh->node_count + i : old[j];
            }
            result->regions[next++] = result->regions[tet];
        }
    }
    return SB_OK;
}

/* Splits edges where the boundary is still too far from the surface; *count: how many. */
static sb_result sbi_stuffing_split_all(sbi_stuffing_rim *rim, int is_last, int *count)
{
    const sb_allocator *allocator = &rim->s->def->allocator;
    const sb_real limit = SBI_STUFF_FAR * rim->s->def->cell;
    int faces = rim->boundary.surface.element_count, far = 0, added = 0;
    sbi_stuffing_split *splits;
    unsigned char *taken;
    sb_result result = SB_OK;
    *count = 0;
    for (int f = 0; f < faces; f++)
        far += rim->worst[f] > limit;
    if (far == 0)
        return SB_OK;
    splits = (sbi_stuffing_split *)sbi_alloc(allocator, (size_t)far, sizeof *splits);
    taken = (unsigned char *)sbi_alloc_zeroed(allocator, (size_t)rim->mesh->element_count, 1);
    if (!splits || !taken)
        result = sbi_stuffing_no_memory(rim->s);
    for (int f = 0; f < faces && result == SB_OK; f++) {
        sbi_stuffing_split *split = splits + *count;
        int more = rim->worst[f] > limit ? sbi_stuffing_choose_split(rim, f, is_last, taken, split) : 0;
        if (more == 0)
            continue;
        for (int k = rim->tets.offsets[split->a]; k < rim->tets.offsets[split->a + 1]; k++)
            if (sbi_stuffing_tet_has(rim->mesh, rim->tets.items[k], split->b))
                taken[rim->tets.items[k]] = 1;
        added += more;
        ++*count;
    }
    if (result == SB_OK && *count > 0) {
        sb_mesh split;
        result = sbi_stuffing_apply_splits(rim, splits, *count, added, &split);
        if (result == SB_OK) {
            sb_mesh_free(rim->mesh);
            *rim->mesh = split;
        }
    }
    sbi_free(allocator, splits);
    sbi_free(allocator, taken);
    return result;
}

/* Round 0, 1, ... of sliding and splitting: *again: whether edges were split; then *distance is of before. */
static sb_result sbi_stuffing_refine_boundary(const sbi_stuffing *s, sb_mesh *mesh, int round, int *again,
                                              sb_real *distance)
{
    sbi_stuffing_rim rim;
    sb_result result;
    memset(&rim, 0, sizeof rim);
    rim.s = s;
    rim.mesh = mesh;
    *again = 0;
    *distance = 0;
    result = sb_mesh_boundary(mesh, 1, &s->def->allocator, &rim.boundary, s->error);
    if (result == SB_OK) {
        int count = rim.boundary.surface.element_count;
        rim.worst = (sb_real *)sbi_alloc(&s->def->allocator, (size_t)count, sizeof(sb_real));
        if (rim.worst) {
            sbi_run(&s->def->jobs, sbi_stuffing_measure_task, &rim, (count - 1) / SBI_STUFF_CHUNK + 1);
            result = sbi_stuffing_slide_all(&rim);
        } else {
            result = sbi_fail(s->error, SB_ERROR_MEMORY, "out of memory for a boundary of %d triangles", count);
        }
        for (int f = 0; f < count && result == SB_OK; f++)
            *distance = sb_max(*distance, rim.worst[f]);
        if (result == SB_OK && round < SBI_STUFF_SPLITS)
            result = sbi_stuffing_split_all(&rim, round == SBI_STUFF_SPLITS - 1, again);
    }
    sb_boundary_free(&rim.boundary);
    sb_index_lists_free(&rim.tets);
    sb_index_lists_free(&rim.faces);
    sbi_free(&s->def->allocator, rim.worst);
    return result;
}

SBI_API sb_result sbi_stuffing_finish_boundary(const sbi_stuffing *s, sb_mesh *mesh, sb_real *distance)
{
    sb_result result = SB_OK;
    int again = 1;
    for (int round = 0; round <= SBI_STUFF_SPLITS && again && result == SB_OK; round++)
        result = sbi_stuffing_refine_boundary(s, mesh, round, &again, distance);
    return result;
}

SBI_API void sbi_stuffing_fill_report(const sb_mesh *mesh, sb_real distance, const int cells[3],
                                      sb_stuff_report *report)
{
    memcpy(report->cells, cells, sizeof report->cells);
    report->node_count = mesh->node_count;
    report->element_count = mesh->element_count;
    report->distance = distance;
    report->volume = sb_mesh_volume(mesh);
    sb_mesh_dihedral_range(mesh, &report->min_dihedral, &report->max_dihedral);
}
