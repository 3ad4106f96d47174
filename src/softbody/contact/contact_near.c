/* contact_near: organs, and which of their faces are near faces that they look at.
 *
 * A walk over pairs of the tree's boxes finds faces whose boxes meet. It leaves out what lies in one organ alone, where
 * organs are not to touch themselves, and pairs of boxes all of whose normals point the same way: neighbours on a
 * smooth surface, of which a walk through one organ would otherwise meet nothing but them. */
#include <float.h>
#include <string.h>

#include "../body/body_private.h"
#include "contact_private.h"

/* Faces look at each other when their normals have a product below this. Those of two organs may touch unless they look
 * the same way: an edge that has come into an organ has flanks along its way. */
#define SBI_NEAR_FACING ((sb_real)-0.25)
#define SBI_NEAR_TURNED ((sb_real)0.5)
/* Faces of one organ do not touch when their middles are nearer than this at rest, in lengths of a face. */
#define SBI_NEAR_APART ((sb_real)2)
/* Thickness matters up to so many lengths of the organ's faces. */
#define SBI_NEAR_THICKEST ((sb_real)4)
/* Normals that are part of a smooth surface have at rest a product above this: 60 degrees. */
#define SBI_NEAR_SMOOTH ((sb_real)0.5)
/* In lengths of a face: how high above it samples are paired with it. */
#define SBI_NEAR_HIGH ((sb_real)0.25)
/* Balls are larger than rounding makes them. */
#define SBI_NEAR_LOOSE ((sb_real)1.001)
/* Of the thickness: what lies deeper is taken to be on the other side. */
#define SBI_NEAR_DEEPEST ((sb_real)0.5)
/* Of a face's length, more than rounding makes of heights. */
#define SBI_NEAR_ROUNDED ((sb_real)1e-3)

/* ---- of the mesh at rest ---- */

/* Twice the area of a face, through its corners, and out of the body. */
static sb_vec3 sbi_near_vector(const sbi_contact_faces *faces, int face, const sb_vec3 *x)
{
    const int *n = sbi_contact_face_nodes(faces, face);
    if (faces->kinds[faces->sizes[face]].corners == 4)
        return sb_v3_cross(sb_v3_sub(x[n[2]], x[n[0]]), sb_v3_sub(x[n[3]], x[n[1]]));
    return sb_v3_cross(sb_v3_sub(x[n[1]], x[n[0]]), sb_v3_sub(x[n[2]], x[n[0]]));
}

static sb_vec3 sbi_near_unit(sb_vec3 v)
{
    sb_real size = sb_v3_norm(v);
    return size > 0 ? sb_v3_scale(1 / size, v) : sb_v3(0, 0, 0);
}

/* Connected part of the mesh that a node of faces belongs to; -1: none. */
static int sbi_near_organ(const sb_contact *contact, int node)
{
    sbi_contact_row row;
    if (!contact->skin.source)
        return contact->body->node_component[node];
    row = sbi_contact_skin_row(&contact->skin, node);
    return row.count > 0 ? contact->body->node_component[row.nodes[0]] : -1;
}

static void sbi_near_measure_face(sb_contact *contact, int face, const sb_vec3 *rest)
{
    sbi_pairs *pairs = &contact->pairs;
    const sbi_contact_faces *faces = contact->faces;
    const int *n = sbi_contact_face_nodes(faces, face);
    int corners = faces->kinds[faces->sizes[face]].corners, organ = sbi_near_organ(contact, n[0]);
    sb_vec3 centre = {0, 0, 0};
    for (int a = 0; a < corners; a++)
        centre = sb_v3_madd(centre, 1 / (sb_real)corners, rest[n[a]]);
    pairs->organs[face] = organ;
    pairs->centres[face] = centre;
    pairs->rest_normals[face] = sbi_near_unit(sbi_near_vector(faces, face, rest));
    pairs->slot_of[face] = -1;
    if (organ < 0 || (faces->is_skin && !(faces->areas[face] > 0)))
        return;
    pairs->organ_lengths[organ] += faces->lengths[face];
    pairs->organ_counts[organ]++;
}

/* Which organ each face's nodes go with; a skin's triangle may have nodes in several. */
static void sbi_near_place_nodes(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    const sbi_contact_faces *faces = contact->faces;
    for (int i = 0; i < faces->node_room; i++)
        pairs->node_organs[i] = -1;
    for (int f = 0; f < faces->face_end; f++) {
        const int *nodes = sbi_contact_face_nodes(faces, f), organ = pairs->organs[f];
        const int own = organ < 0 ? pairs->organ_count : organ;
        for (int a = 0; a < faces->sizes[f]; a++) {
            int *place = pairs->node_organs + nodes[a];
            *place = *place < 0 || *place == own ? own : pairs->organ_count;
        }
    }
}

static void sbi_near_measure_organs(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    int nodes = sbi_contact_any_room(contact);
    const sb_vec3 *rest = sbi_contact_points_at_rest(contact);
    memset(pairs->organ_lengths, 0, (size_t)nodes * sizeof(sb_real));
    memset(pairs->organ_counts, 0, (size_t)nodes * sizeof(int));
    pairs->organ_count = 0;
    for (int f = 0; f < contact->faces->face_end; f++) {
        sbi_near_measure_face(contact, f, rest);
        pairs->organ_count = sbi_max_int(pairs->organ_count, pairs->organs[f] + 1);
    }
    sbi_near_place_nodes(contact);
    pairs->longest = 0;
    pairs->shortest = SB_REAL_MAX;
    for (int o = 0; o < nodes; o++)
        if (pairs->organ_counts[o] > 0) {
            pairs->organ_lengths[o] /= (sb_real)pairs->organ_counts[o];
            pairs->longest = sb_max(pairs->longest, pairs->organ_lengths[o]);
            pairs->shortest = sb_min(pairs->shortest, pairs->organ_lengths[o]);
        }
}

/* Faces of each node, ascending. */
static void sbi_near_list_around(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    const sbi_contact_faces *faces = contact->faces;
    int nodes = faces->node_room, *first = pairs->first_face;
    memset(first, 0, ((size_t)nodes + 1) * sizeof(int));
    for (int f = 0; f < faces->face_end; f++)
        for (int a = 0; a < faces->sizes[f]; a++)
            first[sbi_contact_face_nodes(faces, f)[a] + 1]++;
    for (int i = 0; i < nodes; i++)
        first[i + 1] += first[i];
    for (int f = 0; f < faces->face_end; f++)
        for (int a = 0; a < faces->sizes[f]; a++)
            pairs->around[first[sbi_contact_face_nodes(faces, f)[a]]++] = f;
    for (int i = nodes; i > 0; i--)
        first[i] = first[i - 1];
    first[0] = 0;
}

/* Where a line from p along d first leaves the organ through this face (m); SB_REAL_MAX: it does not. */
static sb_real sbi_near_leaves(const sbi_contact_faces *faces, int face, const sb_vec3 *x, sb_vec3 p, sb_vec3 d)
{
    const sbi_contact_kind *kind = &faces->kinds[faces->sizes[face]];
    const int *nodes = sbi_contact_face_nodes(faces, face);
    sb_real least = SB_REAL_MAX;
    for (int part = 0; part < sbi_closest_part_count(kind); part++) {
        sb_vec3 at[3], e1, e2, s, h, q;
        sb_real det, u, v, t;
        for (int k = 0; k < 3; k++)
            at[k] = x[nodes[sbi_closest_part_node(kind, part, k)]];
        e1 = sb_v3_sub(at[1], at[0]), e2 = sb_v3_sub(at[2], at[0]), s = sb_v3_sub(p, at[0]);
        h = sb_v3_cross(d, e2);
        det = sb_v3_dot(e1, h);
        if (!(det < 0)) /* it would come in */
            continue;
        q = sb_v3_cross(s, e1);
        u = sb_v3_dot(s, h) / det, v = sb_v3_dot(d, q) / det, t = sb_v3_dot(e2, q) / det;
        if (u >= 0 && v >= 0 && u + v <= 1 && t > SBI_NEAR_ROUNDED * faces->lengths[face]) /* not a cut's other lip */
            least = sb_min(least, t);
    }
    return least;
}

/* How thick the organ is behind a face; boxes are those of the shape at rest. */
static sb_real sbi_near_thickness(sb_contact *contact, int face, const sb_vec3 *rest)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_real length = pairs->organ_lengths[pairs->organs[face]], most = SBI_NEAR_THICKEST * length, least = most;
    sb_vec3 down = sb_v3_scale(-1, pairs->rest_normals[face]), from = pairs->centres[face];
    for (sb_real way = 0; way < most && least == most; way += length) {
        sb_vec3 a = sb_v3_madd(from, way, down), b = sb_v3_madd(from, way + length, down);
        int count = sbi_contact_faces_query(contact->faces, sb_v3(sb_min(a.x, b.x), sb_min(a.y, b.y), sb_min(a.z, b.z)),
                                            sb_v3(sb_max(a.x, b.x), sb_max(a.y, b.y), sb_max(a.z, b.z)), pairs->found,
                                            contact->faces->face_room);
        for (int i = 0; i < count; i++)
            if (pairs->found[i] != face && pairs->organs[pairs->found[i]] == pairs->organs[face])
                least = sb_min(least, sbi_near_leaves(contact->faces, pairs->found[i], rest, from, down));
    }
    return least;
}

/* How far a sample in front of a face, or hardly behind it, may be that is paired with it (m). */
static sb_real sbi_near_farthest(const sb_contact *contact, int face)
{
    const sb_real length = contact->faces->lengths[face], lean = SBI_PAIR_LEAN;
    sb_real height = sb_max(sbi_pairs_highest_ever(contact, face), SBI_PAIR_DEEP * length);
    return SBI_NEAR_LOOSE * (sb_sqrt(1 + lean * lean) * height + SBI_PAIR_BESIDE * length);
}

/* First and last organ below each box of the tree. */
static void sbi_near_place_organs(sb_contact *contact)
{
    const sbi_face_tree *tree = &contact->faces->tree;
    int *first = contact->pairs.first_organ, *last = contact->pairs.last_organ;
    for (int leaf = 0; leaf < tree->leaf_count; leaf++)
        for (int k = 0; k < SBI_FACE_TREE_LEAF; k++) {
            int organ = contact->pairs.organs[tree->faces[SBI_FACE_TREE_LEAF * leaf + k]];
            first[leaf] = k ? sbi_min_int(first[leaf], organ) : organ;
            last[leaf] = k ? sbi_max_int(last[leaf], organ) : organ;
        }
    for (int level = 1; level < tree->level_count; level++)
        for (int i = 0; i < tree->level_size[level]; i++) {
            int box = tree->level_start[level] + i, a = tree->level_start[level - 1] + 2 * i;
            int b = 2 * i + 1 < tree->level_size[level - 1] ? a + 1 : a;
            first[box] = sbi_min_int(first[a], first[b]);
            last[box] = sbi_max_int(last[a], last[b]);
        }
}

SBI_API void sbi_pairs_measure(sb_contact *contact)
{
    const sb_vec3 *rest = sbi_contact_points_at_rest(contact);
    if (!contact->pairs.kinds)
        return;
    contact->pairs.still.known = 0;
    sbi_near_measure_organs(contact);
    sbi_near_list_around(contact);
    sbi_contact_faces_refit(contact->faces, rest, NULL, 0);
    sbi_pairs_find_lips(contact);
    contact->pairs.farthest = contact->pairs.longest_face = contact->pairs.longest_curved = 0;
    for (int f = 0; f < contact->faces->face_end; f++) {
        contact->pairs.thickness[f] = 0;
        if (contact->faces->is_skin && !(contact->faces->areas[f] > 0)) /* none of it */
            continue;
        contact->pairs.longest_face = sb_max(contact->pairs.longest_face, contact->faces->lengths[f]);
        if (contact->faces->kinds[contact->faces->sizes[f]].corners < contact->faces->sizes[f])
            contact->pairs.longest_curved = sb_max(contact->pairs.longest_curved, contact->faces->lengths[f]);
        contact->pairs.thickness[f] = sbi_near_thickness(contact, f, rest);
        contact->pairs.farthest = sb_max(contact->pairs.farthest, sbi_near_farthest(contact, f));
    }
    sbi_near_place_organs(contact);
    sbi_contact_faces_refit(contact->faces, sbi_contact_points_now(contact), NULL, 0);
}

/* ---- faces that look at each other ---- */

SBI_API int sbi_pairs_may_touch(const sb_contact *contact, int face, int other)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_real least = pairs->organs[face] == pairs->organs[other] ? SBI_NEAR_FACING : SBI_NEAR_TURNED;
    return sb_v3_dot(pairs->plates[face].normal, pairs->plates[other].normal) < least &&
           sbi_pairs_are_apart(contact, face, other);
}

SBI_API int sbi_pairs_face(const sb_contact *contact, int face, int other)
{
    return sb_v3_dot(contact->pairs.plates[face].normal, contact->pairs.plates[other].normal) < SBI_NEAR_FACING;
}

SBI_API int sbi_pairs_are_apart(const sb_contact *contact, int face, int other)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_vec3 apart;
    sb_real least;
    int same = pairs->organs[face] == pairs->organs[other];
    if (!(pairs->kinds & (same ? SB_CONTACT_SELF : SB_CONTACT_ORGANS)))
        return 0;
    if (!same)
        return 1;
    apart = sb_v3_sub(pairs->centres[face], pairs->centres[other]);
    least = SBI_NEAR_APART * sb_max(contact->faces->lengths[face], contact->faces->lengths[other]);
    return sb_v3_dot(apart, apart) > least * least || sbi_pairs_are_lips(contact, face, other);
}

SBI_API sb_vec3 sbi_pairs_face_normal(const sb_contact *contact, int face)
{
    return contact->pairs.plates[face].normal;
}

/* Normal at a corner of a face: of the faces around it that go on smoothly. */
static sb_vec3 sbi_near_make_corner_normal(const sb_contact *contact, int face, int node)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_vec3 sum = {0, 0, 0};
    for (int i = pairs->first_face[node]; i < pairs->first_face[node + 1]; i++)
        if (sb_v3_dot(pairs->rest_normals[pairs->around[i]], pairs->rest_normals[face]) > SBI_NEAR_SMOOTH)
            sum = sb_v3_add(sum, pairs->vectors[pairs->around[i]]);
    return sbi_near_unit(sum);
}

/* The same, made when the first sample needs it. */
static sb_vec3 sbi_near_corner_normal(const sb_contact *contact, int face, int corner)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_vec3 *normal = pairs->corner_normals + SBI_PAIR_CORNERS * (size_t)face + corner;
    if (!(pairs->corners_known[face] >> corner & 1)) {
        *normal = sbi_near_make_corner_normal(contact, face, sbi_contact_face_nodes(contact->faces, face)[corner]);
        pairs->corners_known[face] |= (unsigned char)(1 << corner);
    }
    return *normal;
}

SBI_API sb_vec3 sbi_pairs_normal(const sb_contact *contact, int face, const sb_real *shares)
{
    const sbi_contact_faces *faces = contact->faces;
    const sbi_contact_kind *kind = &faces->kinds[faces->sizes[face]];
    sb_vec3 sum = {0, 0, 0};
    for (int a = 0; a < kind->corners; a++) {
        sb_real share = sbi_contact_corner_share(kind, shares, a);
        sum = sb_v3_madd(sum, share, sbi_near_corner_normal(contact, face, a));
    }
    sum = sbi_near_unit(sum);
    return sb_v3_dot(sum, sum) > 0 ? sum : sbi_pairs_face_normal(contact, face);
}

/* ---- boxes of normals ---- */

static void sbi_near_join(sbi_pair_cone *cone, const sbi_pair_cone *a, const sbi_pair_cone *b)
{
    for (int axis = 0; axis < 3; axis++) {
        cone->low[axis] = a->low[axis] < b->low[axis] ? a->low[axis] : b->low[axis];
        cone->high[axis] = a->high[axis] > b->high[axis] ? a->high[axis] : b->high[axis];
    }
}

static void sbi_near_fit_leaf(const sb_contact *contact, int leaf, sbi_pair_cone *cone)
{
    const sbi_face_tree *tree = &contact->faces->tree;
    for (int k = 0; k < SBI_FACE_TREE_LEAF; k++) {
        sb_vec3 n = sbi_pairs_face_normal(contact, tree->faces[SBI_FACE_TREE_LEAF * leaf + k]);
        sbi_pair_cone own;
        own.low[0] = own.high[0] = (float)n.x;
        own.low[1] = own.high[1] = (float)n.y;
        own.low[2] = own.high[2] = (float)n.z;
        if (k == 0)
            memcpy(cone->low, own.low, sizeof cone->low), memcpy(cone->high, own.high, sizeof cone->high);
        sbi_near_join(cone, cone, &own);
    }
}

/* Control points of a face with nodes x, which it lies between: its corners; of a quadratic one those of its polynomial
 * in Bernstein's form, as in face_tree.c. Returns how many. */
static int sbi_near_controls(int size, const sb_vec3 *x, sb_vec3 *controls)
{
    int corners = size == 3 || size == 6 ? 3 : 4, count = 0;
    sb_vec3 ends = {0, 0, 0}, middles = {0, 0, 0};
    for (int a = 0; a < corners; a++)
        controls[count++] = x[a];
    for (int a = 0; a < corners && size > 4; a++) {
        sb_vec3 sum = sb_v3_add(x[a], x[a + 1 < corners ? a + 1 : 0]);
        controls[count++] = sb_v3_madd(sb_v3_scale(2, x[corners + a]), (sb_real)-0.5, sum);
        ends = sb_v3_add(ends, x[a]);
        middles = sb_v3_add(middles, x[corners + a]);
    }
    if (size == 8)
        controls[count++] = sb_v3_madd(middles, (sb_real)-0.75, ends);
    if (size == 9)
        controls[count++] = sb_v3_sub(sb_v3_madd(sb_v3_scale(4, x[8]), (sb_real)0.25, ends), middles);
    return count;
}

/* A ball around the corners of a triangle. */
static void sbi_near_fit_triangle(sbi_pair_plate *plate, const int *nodes, const sb_vec3 *x)
{
    const sb_vec3 at[3] = {x[nodes[0]], x[nodes[1]], x[nodes[2]]};
    sb_vec3 middle = {0, 0, 0};
    sb_real square = 0;
    for (int a = 0; a < 3; a++)
        middle = sb_v3_madd(middle, 1 / (sb_real)3, at[a]);
    for (int a = 0; a < 3; a++) {
        sb_vec3 way = sb_v3_sub(at[a], middle);
        square = sb_max(square, sb_v3_dot(way, way));
    }
    plate->middle = middle;
    plate->radius = SBI_NEAR_LOOSE * sb_sqrt(square);
    plate->bulge = 0;
}

/* The same around one of another kind, and how thick that has to be along its normal. */
static void sbi_near_fit_ball(sb_contact *contact, int face, const sb_vec3 *x)
{
    const int *nodes = sbi_contact_face_nodes(contact->faces, face);
    int size = contact->faces->sizes[face], corners = contact->faces->kinds[size].corners, count;
    sb_vec3 at[SB_MAX_FACE_NODES], controls[SB_MAX_FACE_NODES], middle = {0, 0, 0};
    sb_real square = 0, bulge = 0;
    for (int a = 0; a < size; a++)
        at[a] = x[nodes[a]];
    for (int a = 0; a < corners; a++)
        middle = sb_v3_madd(middle, 1 / (sb_real)corners, at[a]);
    count = sbi_near_controls(size, at, controls);
    for (int a = 0; a < count; a++) {
        sb_vec3 way = sb_v3_sub(controls[a], middle);
        square = sb_max(square, sb_v3_dot(way, way));
        bulge = sb_max(bulge, sb_abs(sb_v3_dot(way, contact->pairs.plates[face].normal)));
    }
    contact->pairs.plates[face].middle = middle;
    contact->pairs.plates[face].radius = SBI_NEAR_LOOSE * sb_sqrt(square);
    contact->pairs.plates[face].bulge = SBI_NEAR_LOOSE * bulge;
}

SBI_API void sbi_pairs_look(sb_contact *contact, const sb_vec3 *x)
{
    for (int f = 0; f < contact->faces->face_end; f++) {
        contact->pairs.vectors[f] = sbi_near_vector(contact->faces, f, x);
        contact->pairs.plates[f].normal = sbi_near_unit(contact->pairs.vectors[f]);
        if (contact->faces->sizes[f] == 3)
            sbi_near_fit_triangle(contact->pairs.plates + f, sbi_contact_face_nodes(contact->faces, f), x);
        else
            sbi_near_fit_ball(contact, f, x);
        contact->pairs.corners_known[f] = 0;
    }
    contact->pairs.cones_known = 0;
}

static void sbi_near_fit_cones(sb_contact *contact)
{
    const sbi_face_tree *tree = &contact->faces->tree;
    sbi_pair_cone *cones = contact->pairs.cones;
    contact->pairs.cones_known = 1;
    for (int leaf = 0; leaf < tree->leaf_count; leaf++)
        sbi_near_fit_leaf(contact, leaf, cones + leaf);
    for (int level = 1; level < tree->level_count; level++)
        for (int i = 0; i < tree->level_size[level]; i++) {
            const sbi_pair_cone *a = cones + tree->level_start[level - 1] + 2 * i;
            sbi_near_join(cones + tree->level_start[level] + i, a, 2 * i + 1 < tree->level_size[level - 1] ? a + 1 : a);
        }
}

/* Mean way of a face's nodes, which go by dt v, and how far one strays from it at most (m). */
SBI_FORCE_INLINE sb_real sbi_near_take_way(const int *nodes, int count, const sb_vec3 *v, sb_real dt, sb_vec3 *mean)
{
    const sb_real share = dt / (sb_real)count;
    sb_vec3 sum = {0, 0, 0};
    sb_real square = 0;
    for (int a = 0; a < count; a++)
        sum = sb_v3_madd(sum, share, v[nodes[a]]);
    for (int a = 0; a < count; a++) {
        const sb_vec3 way = sb_v3_sub(sb_v3_scale(dt, v[nodes[a]]), sum);
        square = sb_max(square, sb_v3_dot(way, way));
    }
    *mean = sum;
    return sb_sqrt(square);
}

/* Points of curved faces have weights of nodes that sum up to more than 1 in size. */
SBI_API void sbi_pairs_follow(sb_contact *contact, const sb_vec3 *v, sb_real dt)
{
    const sbi_contact_faces *faces = contact->faces;
    for (int f = 0; f < faces->face_end; f++) {
        const int *nodes = sbi_contact_face_nodes(faces, f), count = faces->sizes[f];
        const sbi_contact_kind *kind = &faces->kinds[count];
        sb_vec3 mean = {0, 0, 0};
        sb_real strays = 0;
        if (v)
            strays = count == 3 ? sbi_near_take_way(nodes, 3, v, dt, &mean) /* loops of known length */
                                : sbi_near_take_way(nodes, count, v, dt, &mean);
        contact->pairs.ways[f] = mean;
        contact->pairs.spreads[f] = kind->rules[kind->most].spread * strays;
    }
}

SBI_API sb_real sbi_pairs_closing(const sb_contact *contact, int face, int other)
{
    const sbi_pairs *pairs = &contact->pairs;
    return sb_v3_norm(sb_v3_sub(pairs->ways[face], pairs->ways[other])) + pairs->spreads[face] + pairs->spreads[other];
}

/* 1 when the faces' balls stay farther than `grow` (m) from each other. */
static int sbi_near_is_far(const sb_contact *contact, int face, int other, sb_real grow)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_vec3 way = sb_v3_sub(pairs->plates[face].middle, pairs->plates[other].middle);
    sb_real square = sb_v3_dot(way, way), reach = grow + pairs->plates[face].radius + pairs->plates[other].radius;
    if (square <= reach * reach) /* most are */
        return 0;
    reach += sbi_pairs_closing(contact, face, other);
    return square > reach * reach;
}

SBI_API sb_real sbi_pairs_deepest(const sb_contact *contact, int face)
{
    const sbi_pairs *pairs = &contact->pairs;
    return SBI_NEAR_DEEPEST * sb_min(pairs->thickness[face], 2 * pairs->organ_lengths[pairs->organs[face]]);
}

SBI_API sb_real sbi_pairs_highest_ever(const sb_contact *contact, int other)
{
    return sb_max(contact->pairs.distance, SBI_NEAR_HIGH * contact->faces->lengths[other]);
}

/* No face's is higher (m). */
static sb_real sbi_near_highest_of_all(const sb_contact *contact)
{
    return sb_max(contact->pairs.distance, SBI_NEAR_HIGH * contact->pairs.longest_face);
}

/* How much nearer to a face's plane another one coasts. */
static sb_real sbi_near_coasts(const sbi_pairs *pairs, int face, int other)
{
    sb_vec3 against = sb_v3_sub(pairs->ways[face], pairs->ways[other]);
    sb_real nearer =
        pairs->plates[other].bulge > 0 ? sb_v3_norm(against) : -sb_v3_dot(pairs->plates[other].normal, against);
    return sb_max((sb_real)0, sb_min(nearer + pairs->spreads[face] + pairs->spreads[other], 2 * pairs->still.ahead));
}

SBI_API sb_real sbi_pairs_highest(const sb_contact *contact, int face, int other)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_real most = sbi_pairs_highest_ever(contact, other), near = pairs->distance + pairs->leeway;
    return near < most ? sb_min(most, near + sbi_near_coasts(pairs, face, other)) : most;
}

/* Of a cell's first corner and three beside it: how its edges turn, with nodes at x. */
static sb_real sbi_near_cell_turn(const sb_body *body, const int *cell, const sb_vec3 *x)
{
    const int is_hexahedron = sb_element_corner_count(body->domain.element_type) == 8;
    sb_vec3 a = x[cell[0]], u = sb_v3_sub(x[cell[1]], a), v = sb_v3_sub(x[cell[is_hexahedron ? 3 : 2]], a);
    return sb_v3_dot(sb_v3_cross(u, v), sb_v3_sub(x[cell[is_hexahedron ? 4 : 3]], a));
}

SBI_API int sbi_pairs_is_inside_out(const sb_contact *contact, int face)
{
    const int count = contact->body->domain.nodes_per_cell;
    const int *cell = sbi_contact_cell_nodes(contact->body, contact->faces->elements[face]);
    sb_vec3 middle = {0, 0, 0};
    if (contact->skin.source) /* a triangle may lie anywhere in its cell, or beside it */
        return (sbi_near_cell_turn(contact->body, cell, sb_body_positions(contact->body)) > 0) !=
               (sbi_near_cell_turn(contact->body, cell, sb_body_rest_positions(contact->body)) > 0);
    for (int a = 0; a < count; a++)
        middle = sb_v3_madd(middle, 1 / (sb_real)count, contact->x[cell[a]]);
    return !(sb_v3_dot(contact->pairs.plates[face].normal, sb_v3_sub(contact->pairs.plates[face].middle, middle)) > 0);
}

SBI_API int sbi_pairs_is_above(const sb_contact *contact, int other, sb_vec3 at, sb_real most)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_real height =
        sb_v3_dot(pairs->plates[other].normal, sb_v3_sub(at, pairs->plates[other].middle)) - pairs->plates[other].bulge;
    return height > most + SBI_NEAR_ROUNDED * contact->faces->lengths[other];
}

/* A face's way from x to x + dt v. */
static sbi_pair_box sbi_near_box(const sbi_contact_faces *faces, int face, const sb_vec3 *x, const sb_vec3 *v,
                                 sb_real dt)
{
    const int *nodes = sbi_contact_face_nodes(faces, face);
    /* a curved face stays within half of its length of its corners' box */
    const int is_curved = faces->kinds[faces->sizes[face]].corners < faces->sizes[face];
    const sb_real grow = is_curved ? (sb_real)0.5 * faces->lengths[face] : 0;
    sb_vec3 low = {SB_REAL_MAX, SB_REAL_MAX, SB_REAL_MAX}, high = {-SB_REAL_MAX, -SB_REAL_MAX, -SB_REAL_MAX};
    sbi_pair_box box;
    for (int a = 0; a < faces->sizes[face]; a++) {
        sb_vec3 at = x[nodes[a]], to = v ? sb_v3_madd(at, dt, v[nodes[a]]) : at;
        low = sb_v3(sb_min(low.x, sb_min(at.x, to.x)), sb_min(low.y, sb_min(at.y, to.y)),
                    sb_min(low.z, sb_min(at.z, to.z)));
        high = sb_v3(sb_max(high.x, sb_max(at.x, to.x)), sb_max(high.y, sb_max(at.y, to.y)),
                     sb_max(high.z, sb_max(at.z, to.z)));
    }
    box.low = sb_v3(low.x - grow, low.y - grow, low.z - grow);
    box.high = sb_v3(high.x + grow, high.y + grow, high.z + grow);
    return box;
}

static int sbi_near_meets(const sbi_pair_box *a, const sbi_pair_box *b, sb_real grow)
{
    return a->low.x - b->high.x <= grow && b->low.x - a->high.x <= grow && a->low.y - b->high.y <= grow &&
           b->low.y - a->high.y <= grow && a->low.z - b->high.z <= grow && b->low.z - a->high.z <= grow;
}

SBI_API sbi_pair_box sbi_pairs_way_box(const sb_contact *contact, int face)
{
    const sbi_pairs_still *still = &contact->pairs.still;
    return sbi_near_box(contact->faces, face, contact->x, still->velocity, still->dt);
}

static int sbi_near_is_marked(const uint64_t *marks, int face)
{
    return (int)(marks[face / SBI_FACE_TREE_BITS] >> face % SBI_FACE_TREE_BITS & 1);
}

/* 1 when another face may come within `most` (m) of a face's way, along each axis, and within pairs.reach in all. */
static int sbi_near_comes(const sb_contact *contact, int face, const sbi_pair_box *own, int other, sb_real most)
{
    const sbi_pairs *pairs = &contact->pairs;
    sbi_pair_box box;
    if (sbi_near_is_far(contact, face, other, pairs->reach))
        return 0;
    if (sbi_near_is_marked(pairs->still.boxed, other))
        return sbi_near_meets(own, pairs->still.boxes + other, most);
    box = sbi_pairs_way_box(contact, other);
    return sbi_near_meets(own, &box, most);
}

SBI_API int sbi_pairs_comes(const sb_contact *contact, int face, const sbi_pair_box *own, int other)
{
    return sbi_near_comes(contact, face, own, other, contact->pairs.reach);
}

/* What the points of a face lie between: its corners of a flat one; without a corner a disc around its middle. */
typedef struct sbi_near_shape {
    sbi_pair_plate plate;
    sb_vec3 corners[4];
    int count;
} sbi_near_shape;

static void sbi_near_take_shape(const sb_contact *contact, int face, sbi_near_shape *shape)
{
    const int *nodes = sbi_contact_face_nodes(contact->faces, face), size = contact->faces->sizes[face];
    shape->plate = contact->pairs.plates[face];
    shape->count = size <= 4 ? size : 0;
    for (int a = 0; a < shape->count; a++)
        shape->corners[a] = contact->x[nodes[a]];
}

/* A face as its shape to others side by side (m, m^2). */
typedef struct sbi_near_row {
    sb_real low[SBI_PAIR_SIDE],
        high[SBI_PAIR_SIDE]; /* least and most height above a plane, but for what either bulges */
    sb_real height[SBI_PAIR_SIDE], square[SBI_PAIR_SIDE]; /* of its middle above that, and from middle to middle */
    sb_real turn[SBI_PAIR_SIDE];                          /* of the normals */
    sb_real radius[SBI_PAIR_SIDE], bulge[SBI_PAIR_SIDE];  /* the others' */
    sb_real off[SBI_PAIR_SIDE];                           /* > 0: in no list */
} sbi_near_row;

/* Heights of a shape without corners: of a disc. */
static void sbi_near_lay_disc(const sbi_near_shape *shape, sbi_near_row *row)
{
    SBI_PAIR_EACH_SIDE(l)
    {
        const sb_real turn = row->turn[l];
        const sb_real tall = shape->plate.radius * sb_sqrt(sb_max((sb_real)0, 1 - turn * turn));
        row->low[l] = row->height[l] - tall;
        row->high[l] = row->height[l] + tall;
    }
}

/* count: of the others, <= SBI_PAIR_SIDE; the first one stands where there is none. */
static void sbi_near_take_row(const sbi_near_shape *shape, const sbi_pair_plate *plates, const int *others, int count,
                              sbi_near_row *row)
{
    const sb_vec3 middle = shape->plate.middle, normal = shape->plate.normal;
    sb_real x[SBI_PAIR_SIDE], y[SBI_PAIR_SIDE], z[SBI_PAIR_SIDE];
    sb_real nx[SBI_PAIR_SIDE], ny[SBI_PAIR_SIDE], nz[SBI_PAIR_SIDE];
    SBI_PAIR_EACH_SIDE(l)
    {
        const sbi_pair_plate *other = plates + others[l < count ? l : 0];
        x[l] = other->middle.x, y[l] = other->middle.y, z[l] = other->middle.z;
        nx[l] = other->normal.x, ny[l] = other->normal.y, nz[l] = other->normal.z;
        row->radius[l] = other->radius, row->bulge[l] = other->bulge;
    }
    SBI_PAIR_EACH_SIDE(l)
    {
        const sb_real dx = middle.x - x[l], dy = middle.y - y[l], dz = middle.z - z[l];
        row->height[l] = nx[l] * dx + ny[l] * dy + nz[l] * dz;
        row->square[l] = dx * dx + dy * dy + dz * dz;
        row->turn[l] = nx[l] * normal.x + ny[l] * normal.y + nz[l] * normal.z;
        row->low[l] = SB_REAL_MAX, row->high[l] = -SB_REAL_MAX;
    }
    if (shape->count == 0)
        sbi_near_lay_disc(shape, row);
    for (int a = 0; a < shape->count; a++) {
        const sb_vec3 corner = shape->corners[a];
        SBI_PAIR_EACH_SIDE(l)
        {
            const sb_real height = nx[l] * (corner.x - x[l]) + ny[l] * (corner.y - y[l]) + nz[l] * (corner.z - z[l]);
            row->low[l] = sb_min(row->low[l], height);
            row->high[l] = sb_max(row->high[l], height);
        }
    }
}

/* A face as its shape, against the plane and the ball of another. */
typedef struct sbi_near_disc {
    sb_real turn, low, high;      /* of the normals; m: least and most height above the plane */
    sb_real square, beside, wide; /* m^2: of its middle from the other, across the normal; m: what both reach */
} sbi_near_disc;

/* 1 when a sample of it may be held, no higher than `most`. */
static int sbi_near_may_hold(const sb_contact *contact, int other, const sbi_near_disc *disc, sb_real most)
{
    sb_real lean = SBI_PAIR_LEAN * sb_max((sb_real)0, sb_min(disc->high, most));
    sb_real reach = disc->wide + lean + SBI_PAIR_LEAN_INSIDE * sb_max((sb_real)0, -disc->low);
    return disc->low <= most && disc->beside <= reach * reach && -disc->high <= sbi_pairs_deepest(contact, other);
}

/* 1 when a sample of it may come to the other face on its way. */
static int sbi_near_may_come(const sb_contact *contact, int face, int other, const sbi_near_disc *disc)
{
    sb_real closing = sbi_pairs_closing(contact, face, other), reach = disc->wide + closing;
    return closing > 0 && disc->low <= closing && disc->square <= reach * reach;
}

/* How a face is related to others. Points go no farther than still.ahead, nor do they spread by more than twice that:
 * two come nearer by no more than `near`, six times that. */
typedef struct sbi_near_relation {
    const sb_contact *contact;
    int face;
    const sbi_pair_box *way; /* or NULL */
    sb_real soon, near;      /* m: no sample that is held in this step is higher */
    sbi_near_shape shape;
} sbi_near_relation;

/* One of a row as a disc. most: as high as any sample is that this one holds in this step (m). 0: it is in no list. */
static int sbi_near_take_disc(const sbi_near_relation *relation, const sbi_near_row *row, int l, int other,
                              sb_real most, sbi_near_disc *disc)
{
    const sb_real rounded = 3 * SBI_PAIR_BESIDE * relation->contact->faces->lengths[other];
    const sb_real thick = relation->shape.plate.bulge + row->bulge[l] + rounded;
    sb_real reach;
    disc->low = row->low[l] - thick, disc->high = row->high[l] + thick;
    if (disc->low > sb_max(most, relation->near))
        return 0;
    disc->turn = row->turn[l];
    disc->wide = relation->shape.plate.radius + row->radius[l] + rounded;
    disc->square = row->square[l];
    disc->beside = row->square[l] - row->height[l] * row->height[l];
    reach = disc->wide + sb_max(sb_max(most, relation->near), -SBI_PAIR_SLANTED * disc->low);
    return !(disc->beside > reach * reach);
}

/* No sample that this one holds where the step begins, or that lies straight behind it, is farther from it (m). */
static sb_real sbi_near_farthest_held(const sbi_near_relation *relation, int other, const sbi_near_disc *disc,
                                      sb_real most)
{
    const sb_real over = sb_max((sb_real)0, sb_min(disc->high, most)), under = sb_max((sb_real)0, -disc->low);
    const sb_real lean = SBI_PAIR_LEAN, slant = SBI_PAIR_SLANTED; /* > SBI_PAIR_LEAN_INSIDE */
    const sb_real away = sb_max(sb_sqrt(1 + lean * lean) * over, sb_sqrt(1 + slant * slant) * under);
    return SBI_NEAR_LOOSE * (away + 3 * SBI_PAIR_BESIDE * relation->contact->faces->lengths[other]);
}

/* 1 when a sample may be held, lie behind or come to the other, as far as boxes tell: that of its face's way holds it
 * where the step begins and all along. */
static int sbi_near_may_meet(const sbi_near_relation *relation, int other, const sbi_near_disc *disc, sb_real most)
{
    const sb_real away = sbi_near_farthest_held(relation, other, disc, most);
    return !relation->way || sbi_near_comes(relation->contact, relation->face, relation->way, other,
                                            sb_min(away, relation->contact->pairs.reach));
}

/* The lists that one of a row is in. In that of holders *highest is what sbi_pairs_highest says. */
static int sbi_near_relate(const sbi_near_relation *relation, const sbi_near_row *row, int l, int other,
                           sb_real *highest)
{
    const sb_contact *contact = relation->contact;
    const sb_real most = sb_min(sbi_pairs_highest_ever(contact, other), relation->soon);
    sb_real reach;
    sbi_near_disc disc;
    int lists = 0;
    if (!sbi_near_take_disc(relation, row, l, other, most, &disc) || !sbi_near_may_meet(relation, other, &disc, most))
        return 0;
    if (sbi_near_may_hold(contact, other, &disc, most)) {
        *highest = sbi_pairs_highest(contact, relation->face, other);
        lists |= sbi_near_may_hold(contact, other, &disc, *highest) << SBI_PAIR_HOLDERS;
    }
    reach = disc.wide - SBI_PAIR_SLANTED * disc.low;
    if (disc.low < 0 && disc.beside <= reach * reach)
        lists |= 1 << SBI_PAIR_BACKS;
    if (disc.turn < SBI_NEAR_FACING && disc.low <= relation->near)
        lists |= sbi_near_may_come(contact, relation->face, other, &disc) << SBI_PAIR_COMERS;
    return lists;
}

/* Which of a row may be in a list and touch the face at all: what sbi_near_take_disc, sbi_near_is_far and
 * sbi_pairs_may_touch ask, of bounds that are those of all faces. */
static void sbi_near_ask_row(const sbi_near_relation *relation, sbi_near_row *row)
{
    const sb_contact *contact = relation->contact;
    const sb_real most =
        SBI_NEAR_LOOSE * sb_max(sb_min(sbi_near_highest_of_all(contact), relation->soon), relation->near);
    const sb_real rounded = SBI_NEAR_LOOSE * 3 * SBI_PAIR_BESIDE * contact->pairs.longest_face;
    const sb_real bulge = relation->shape.plate.bulge + rounded, radius = relation->shape.plate.radius + rounded;
    const sb_real far = contact->pairs.reach + relation->near;
    SBI_PAIR_EACH_SIDE(l)
    {
        const sb_real low = row->low[l] - row->bulge[l] - bulge, wide = radius + row->radius[l];
        const sb_real reach = SBI_NEAR_LOOSE * (wide + sb_max(most, -SBI_PAIR_SLANTED * low));
        const sb_real ball_reach = SBI_NEAR_LOOSE * (wide + far);
        const sb_real beside = row->square[l] - row->height[l] * row->height[l];
        const sb_real off = sb_max(low - most, beside - reach * reach);
        row->off[l] = sb_max(sb_max(off, row->square[l] - ball_reach * ball_reach),
                             row->turn[l] - SBI_NEAR_LOOSE * SBI_NEAR_TURNED);
    }
}

SBI_API int sbi_pairs_find_related(sb_contact *contact, int face, const sbi_pair_box *way, const int *others, int count)
{
    sbi_pairs *pairs = &contact->pairs;
    sbi_near_relation relation;
    int found = 0;
    relation.contact = contact;
    relation.face = face;
    relation.way = way;
    relation.soon = pairs->distance + pairs->leeway + 2 * pairs->still.ahead;
    relation.near = 6 * pairs->still.ahead;
    sbi_near_take_shape(contact, face, &relation.shape);
    for (int first = 0; first < count; first += SBI_PAIR_SIDE) {
        const int side = sbi_min_int(SBI_PAIR_SIDE, count - first);
        sbi_near_row row;
        sbi_near_take_row(&relation.shape, pairs->plates, others + first, side, &row);
        sbi_near_ask_row(&relation, &row);
        for (int l = 0; l < side; l++) {
            sbi_pair_related *related = pairs->related + found;
            if (row.off[l] > 0)
                continue;
            related->other = others[first + l];
            related->highest = 0;
            related->lists = sbi_near_relate(&relation, &row, l, others[first + l], &related->highest);
            found += related->lists != 0;
        }
    }
    return found;
}

/* How far a face is from the plane of another at least, on either side. */
static sb_real sbi_near_off_plane(const sbi_pairs *pairs, int face, int other, sb_real lean)
{
    sb_vec3 way = sb_v3_sub(pairs->plates[face].middle, pairs->plates[other].middle);
    sb_real height = sb_abs(sb_v3_dot(pairs->plates[other].normal, way));
    return height - pairs->plates[face].radius * lean - pairs->plates[face].bulge - pairs->plates[other].bulge;
}

SBI_API sb_real sbi_pairs_between(const sb_contact *contact, int face, int other)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_real turn = sb_v3_dot(pairs->plates[face].normal, pairs->plates[other].normal);
    sb_real lean = sb_sqrt(sb_max((sb_real)0, 1 - turn * turn)), most;
    most = sb_v3_norm(sb_v3_sub(pairs->plates[face].middle, pairs->plates[other].middle)) - pairs->plates[face].radius -
           pairs->plates[other].radius;
    most = sb_max(most, sbi_near_off_plane(pairs, face, other, lean));
    return sb_max(most, sbi_near_off_plane(pairs, other, face, lean));
}

SBI_API int sbi_pairs_is_beyond(const sb_contact *contact, int face, sb_vec3 at, sb_real most)
{
    const sbi_pair_plate *plate = contact->pairs.plates + face;
    const sb_vec3 way = sb_v3_sub(at, plate->middle);
    const sb_real square = sb_v3_dot(way, way), height = sb_v3_dot(plate->normal, way);
    const sb_real loose = SBI_NEAR_LOOSE * most, reach = plate->radius + loose;
    sb_real off, beside;
    if (square > reach * reach)
        return 1;
    off = sb_max((sb_real)0, sb_abs(height) - plate->bulge);
    if (off > loose)
        return 1;
    beside = plate->radius + sb_sqrt(loose * loose - off * off);
    return square - height * height > beside * beside;
}

/* 1 when a normal of one may look at one of the other: the least product of numbers in the boxes. */
static int sbi_near_may_face(const sbi_pair_cone *a, const sbi_pair_cone *b, int same)
{
    float sum = 0;
    for (int axis = 0; axis < 3; axis++) {
        float ll = a->low[axis] * b->low[axis], lh = a->low[axis] * b->high[axis];
        float hl = a->high[axis] * b->low[axis], hh = a->high[axis] * b->high[axis];
        float first = ll < lh ? ll : lh, second = hl < hh ? hl : hh;
        sum += first < second ? first : second;
    }
    return sum < (float)(same ? SBI_NEAR_FACING : SBI_NEAR_TURNED) + 16 * FLT_EPSILON;
}

/* ---- the walk ---- */

typedef struct sbi_near_walk {
    sb_contact *contact;
    float grow; /* m */
    sbi_near_kind kind;
} sbi_near_walk;

static int sbi_near_boxes_meet(const sbi_face_box *a, const sbi_face_box *b, float grow)
{
    for (int axis = 0; axis < 3; axis++)
        if (a->corner[axis] + b->corner[4 + axis] > grow || b->corner[axis] + a->corner[4 + axis] > grow)
            return 0;
    return 1;
}

/* 1 when something below one box may touch something below the other. */
static int sbi_near_boxes_touch(const sbi_near_walk *walk, int a, int b)
{
    const sbi_pairs *pairs = &walk->contact->pairs;
    const sbi_face_box *boxes = walk->contact->faces->tree.boxes;
    const int *first = pairs->first_organ, *last = pairs->last_organ;
    int same = first[a] == last[a] && first[a] == first[b] && first[a] == last[b];
    if (!(pairs->kinds & SB_CONTACT_SELF) && same)
        return 0;
    return (walk->kind == SBI_NEAR_ANY || sbi_near_may_face(pairs->cones + a, pairs->cones + b, same)) &&
           (a == b || sbi_near_boxes_meet(boxes + a, boxes + b, walk->grow));
}

static void sbi_near_mark(uint64_t *marks, int face)
{
    marks[face / SBI_FACE_TREE_BITS] |= (uint64_t)1 << face % SBI_FACE_TREE_BITS;
}

/* 1 when a face has to do with another, as far as the walk looks. */
static int sbi_near_counts(const sbi_near_walk *walk, int face, int other)
{
    return walk->kind != SBI_NEAR_PAIRED || sbi_pairs_find_related(walk->contact, face, NULL, &other, 1) > 0;
}

/* Two faces whose boxes meet. */
static void sbi_near_match(const sbi_near_walk *walk, int face, int other)
{
    sb_contact *contact = walk->contact;
    uint64_t *marks = contact->pairs.near;
    int one = sbi_near_is_marked(marks, face), two = sbi_near_is_marked(marks, other);
    if ((one && two) || !(walk->kind == SBI_NEAR_ANY ? sbi_pairs_are_apart(contact, face, other)
                                                     : sbi_pairs_may_touch(contact, face, other)))
        return;
    if (!one && sbi_near_counts(walk, face, other))
        sbi_near_mark(marks, face);
    if (!two && sbi_near_counts(walk, other, face))
        sbi_near_mark(marks, other);
}

static int sbi_near_leaf_is_marked(const sbi_near_walk *walk, int leaf)
{
    const sbi_face_tree *tree = &walk->contact->faces->tree;
    int place = SBI_FACE_TREE_LEAF * leaf, last = sbi_min_int(place + SBI_FACE_TREE_LEAF, tree->count);
    while (place < last && sbi_near_is_marked(walk->contact->pairs.near, tree->faces[place]))
        place++;
    return place == last;
}

/* 1 when two faces' boxes are no farther than `grow` from each other. */
static int sbi_near_places_meet(const sbi_pairs *pairs, int a, int b, sb_real grow)
{
    sb_vec3 l = pairs->box_low[a], h = pairs->box_high[a], low = pairs->box_low[b], high = pairs->box_high[b];
    return !(l.x - high.x > grow || l.y - high.y > grow || l.z - high.z > grow || low.x - h.x > grow ||
             low.y - h.y > grow || low.z - h.z > grow);
}

/* Faces of two leaves, which may be the same. */
static void sbi_near_match_leaves(const sbi_near_walk *walk, int a, int b)
{
    const sbi_face_tree *tree = &walk->contact->faces->tree;
    int first = SBI_FACE_TREE_LEAF * b, last = sbi_min_int(first + SBI_FACE_TREE_LEAF, tree->count);
    for (int i = SBI_FACE_TREE_LEAF * a; i < sbi_min_int(SBI_FACE_TREE_LEAF * (a + 1), tree->count); i++)
        for (int j = a == b ? i + 1 : first; j < last; j++)
            if (sbi_near_places_meet(&walk->contact->pairs, i, j, (sb_real)walk->grow))
                sbi_near_match(walk, tree->faces[i], tree->faces[j]);
}

/* Two boxes of a level, by their numbers in it; a <= b. */
typedef struct sbi_near_pair {
    int level, a, b;
} sbi_near_pair;

enum { SBI_NEAR_STACK = 4 * SBI_FACE_TREE_LEVELS };

SBI_API void sbi_pairs_find_near(sb_contact *contact, sb_real grow, sbi_near_kind kind)
{
    const sbi_face_tree *tree = &contact->faces->tree;
    sbi_near_pair stack[SBI_NEAR_STACK];
    sbi_near_walk walk;
    int top = 0;
    walk.contact = contact;
    walk.kind = kind;
    walk.grow = (float)(grow + 2 * tree->spacing);
    if (kind != SBI_NEAR_ANY && !contact->pairs.cones_known)
        sbi_near_fit_cones(contact);
    for (int place = 0; place < tree->count; place++)
        sbi_face_tree_place_box(tree, place, contact->pairs.box_low + place, contact->pairs.box_high + place);
    memset(contact->pairs.near, 0, (size_t)sbi_face_tree_words(contact->faces->face_room) * sizeof(uint64_t));
    if (tree->count > 0)
        stack[top].level = tree->level_count - 1, stack[top].a = stack[top].b = 0, top++;
    while (top > 0) {
        sbi_near_pair pair = stack[--top], below;
        int start = tree->level_start[pair.level];
        if (!sbi_near_boxes_touch(&walk, start + pair.a, start + pair.b))
            continue;
        if (pair.level == 0) {
            if (!sbi_near_leaf_is_marked(&walk, pair.a) || !sbi_near_leaf_is_marked(&walk, pair.b))
                sbi_near_match_leaves(&walk, pair.a, pair.b);
            continue;
        }
        below.level = pair.level - 1;
        for (int i = 2 * pair.a; i < sbi_min_int(2 * pair.a + 2, tree->level_size[below.level]); i++)
            for (int j = pair.a == pair.b ? i : 2 * pair.b;
                 j < sbi_min_int(2 * pair.b + 2, tree->level_size[below.level]); j++) {
                below.a = i, below.b = j;
                stack[top++] = below;
            }
    }
}

SBI_API int sbi_pairs_next_near(const sb_contact *contact, int face)
{
    for (; face < contact->faces->face_end; face++) {
        uint64_t word = contact->pairs.near[face / SBI_FACE_TREE_BITS] >> face % SBI_FACE_TREE_BITS;
        if (word == 0)
            face |= SBI_FACE_TREE_BITS - 1; /* none up to the end of this word */
        else if (word & 1)
            return face;
    }
    return -1;
}

SBI_API int sbi_pairs_query_but(sb_contact *contact, int organ, sb_vec3 low, sb_vec3 high, int *found)
{
    sbi_contact_faces *faces = contact->faces;
    sbi_face_tree_groups groups;
    groups.first = contact->pairs.first_organ;
    groups.last = contact->pairs.last_organ;
    groups.left_out = organ;
    return sbi_face_tree_query_groups(&faces->tree, low, high, &groups, faces->marks, found, faces->face_room);
}

/* Faces whose boxes meet this one, in pairs.found, but, where organs do not touch themselves, most of the face's own.
 */
static int sbi_near_query(sb_contact *contact, int face, sb_vec3 low, sb_vec3 high)
{
    const int organ = contact->pairs.kinds & SB_CONTACT_SELF ? -1 : contact->pairs.organs[face];
    return sbi_pairs_query_but(contact, organ, low, high, contact->pairs.found);
}

SBI_API int sbi_pairs_find_around(sb_contact *contact, int face, sb_real most)
{
    const sb_vec3 at = contact->pairs.plates[face].middle;
    most += contact->pairs.plates[face].radius;
    return sbi_near_query(contact, face, sb_v3(at.x - most, at.y - most, at.z - most),
                          sb_v3(at.x + most, at.y + most, at.z + most));
}

/* Faces that a box meets which is larger by `grow`, as sbi_near_query. */
static int sbi_near_query_box(sb_contact *contact, int face, const sbi_pair_box *box, sb_real grow)
{
    return sbi_near_query(contact, face, sb_v3(box->low.x - grow, box->low.y - grow, box->low.z - grow),
                          sb_v3(box->high.x + grow, box->high.y + grow, box->high.z + grow));
}

SBI_API int sbi_pairs_find_others(sb_contact *contact, int face, const sb_vec3 *x, const sb_vec3 *v, sb_real dt,
                                  sb_real grow)
{
    sbi_pairs *pairs = &contact->pairs;
    sbi_pair_box box = sbi_near_box(contact->faces, face, x, v, dt);
    int count = sbi_near_query_box(contact, face, &box, grow), kept = 0;
    for (int i = 0; i < count; i++)
        if (pairs->found[i] != face && sbi_pairs_may_touch(contact, face, pairs->found[i]) &&
            !sbi_near_is_far(contact, face, pairs->found[i], grow))
            pairs->found[kept++] = pairs->found[i];
    return kept;
}

SBI_API int sbi_pairs_query(sb_contact *contact, int face, sb_real grow)
{
    sbi_pair_box box = sbi_pairs_way_box(contact, face);
    return sbi_near_query_box(contact, face, &box, grow + (sb_real)0.5 * contact->pairs.longest_curved);
}

SBI_API void sbi_pairs_box_near(sb_contact *contact)
{
    sbi_pairs_still *still = &contact->pairs.still;
    memcpy(still->boxed, contact->pairs.near,
           (size_t)sbi_face_tree_words(contact->faces->face_room) * sizeof(uint64_t));
    for (int face = sbi_pairs_next_near(contact, 0); face >= 0; face = sbi_pairs_next_near(contact, face + 1))
        still->boxes[face] = sbi_pairs_way_box(contact, face);
}

/* Parts a side: for the finest organ that it may touch, but no finer than half of its own, whose samples are there too.
 */
SBI_API int sbi_pairs_parts(const sb_contact *contact, int face, int thin)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_real own = pairs->organ_lengths[pairs->organs[face]];
    sb_real length = sb_max((sb_real)0.5 * own, sb_min(own, pairs->shortest));
    int least = contact->faces->kinds[contact->faces->sizes[face]].least;
    if (contact->skin.source) { /* a cell, which may have many triangles, follows no more than a few samples */
        length = 2 * own;
        least = 1;
        if (contact->faces->lengths[face] <= own)
            return least;
    }
    return sbi_max_int(least, sbi_contact_face_parts(contact->faces, face, length) >> thin);
}
