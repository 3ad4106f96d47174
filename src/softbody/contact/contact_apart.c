/* contact_apart: whether organs have passed into or through each other in a step, and a last resort against it.
 *
 * All samples are followed on their straight ways against the faces that go theirs: one that came in by a face may not
 * end deeper behind it than it can be pushed back from, nor leave on the other side; one that was in already, where its
 * pair knows, may not be deeper than that unless it was so before. A step that fails this is divided.
 *
 * Where it is not divided any further the motion of the two faces is made one: their nodes move together, as far as
 * they would have gone on the mean, so that nothing between them can change and their momentum stays. Zones that share
 * nodes become one, and grow until nothing is left to mend, at worst over whole organs. It is a perfectly inelastic
 * impact of what moves together: kinetic energy is only lost.
 * Source: Provot 1997; Bridson, Fedkiw, Anderson 2002 (rigid impact zones). */
#include <string.h>

#include "../body/body_private.h"
#include "../body/constraint.h"
#include "contact_private.h"

/* Of the thickness or a face's length, whichever is less: how deep samples may end. */
#define SBI_APART_DEEPEST ((sb_real)0.4)
/* Of that: by how much what was deeper may become yet deeper, before its pressure holds it. */
#define SBI_APART_SINKS ((sb_real)0.1)
/* Of its depth: where another face is nearer than that, a point has not come in by this one. */
#define SBI_APART_SIDE ((sb_real)0.5)
/* Normals with a product below this are those of opposite sides. */
#define SBI_APART_OPPOSITE ((sb_real)-0.25)
/* Shares of safe depth and of a face's radius that are surely less than a way of what strays, see sbi_apart_least_way;
 * more than edges are stretched by on the way, and rounding. */
#define SBI_APART_GOES ((sb_real)0.9)
#define SBI_APART_PASSES ((sb_real)0.04)
/* Rounds in which zones grow face by face. */
enum { SBI_APART_ROUNDS = 8 };

SBI_API sb_real sbi_pairs_safe_depth(const sb_contact *contact, int face)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_real length = contact->faces->lengths[face];
    if (contact->skin.source) /* its triangles may be slivers, of what the cells behind them do not follow */
        length = sb_max(length, pairs->organ_lengths[sbi_max_int(pairs->organs[face], 0)]);
    return SBI_APART_DEEPEST * sb_min(pairs->thickness[face], length);
}

/* ---- one sample ---- */

static sb_vec3 sbi_apart_at(const sb_vec3 *x, const sb_vec3 *way, int node)
{
    return way ? sb_v3_add(x[node], way[node]) : x[node];
}

SBI_API int sbi_pairs_is_inside(sb_contact *contact, int face, int other, sb_vec3 at, sb_real most, const sb_vec3 *x,
                                const sb_vec3 *way)
{
    const sbi_contact_faces *faces = contact->faces;
    int count =
        sbi_contact_faces_query(contact->faces, sb_v3(at.x - most, at.y - most, at.z - most),
                                sb_v3(at.x + most, at.y + most, at.z + most), contact->scratch, faces->face_room);
    for (int i = 0; i < count; i++) {
        int side = contact->scratch[i];
        const int *nodes = sbi_contact_face_nodes(faces, side);
        sb_vec3 places[SB_MAX_FACE_NODES];
        sbi_closest closest;
        if (side == face || contact->pairs.organs[side] != contact->pairs.organs[other] ||
            !sbi_pairs_are_apart(contact, face, side))
            continue;
        for (int a = 0; a < faces->sizes[side]; a++)
            places[a] = sbi_apart_at(x, way, nodes[a]);
        sbi_closest_on_face(&faces->kinds[faces->sizes[side]], places, at, &closest);
        if (sb_v3_norm(sb_v3_sub(at, closest.point)) < most)
            return 0;
    }
    return 1;
}

/* A sample on its way. */
typedef struct sbi_apart_sample {
    int face;
    sb_vec3 at, way;
} sbi_apart_sample;

/* 1 when it cannot come to a face. */
static int sbi_apart_stays_off(const sb_contact *contact, int other, const sbi_apart_sample *s)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_vec3 off = sb_v3_sub(s->at, pairs->plates[other].middle);
    sb_real reach =
        sb_v3_norm(sb_v3_sub(s->way, pairs->ways[other])) + pairs->spreads[other] + pairs->plates[other].radius;
    return sb_v3_dot(off, off) > reach * reach;
}

/* When it comes through a face from its front (out: from its back), < 0: it does not; *depth behind it at the end. */
static sb_real sbi_apart_meets(const sb_contact *contact, int other, const sbi_apart_sample *s, int out, sb_real *depth)
{
    const sbi_contact_kind *kind = &contact->faces->kinds[contact->faces->sizes[other]];
    const int *nodes = sbi_contact_face_nodes(contact->faces, other);
    const sb_vec3 *x = contact->x;
    for (int part = 0; part < sbi_closest_part_count(kind); part++) {
        sb_vec3 corners[3], ways[3];
        sb_real share;
        for (int k = 0; k < 3; k++) {
            int node = nodes[sbi_closest_part_node(kind, part, out ? 2 - k : k)];
            corners[k] = x[node];
            ways[k] = contact->moved[node];
        }
        share = sbi_closest_meeting(corners, ways, s->at, s->way, depth);
        if (share >= 0)
            return share;
    }
    return -1;
}

/* 1 when a sample that came in by a face has left its organ by the opposite side. */
static int sbi_apart_passes(sb_contact *contact, int other, const sbi_apart_sample *s)
{
    sb_vec3 end = sb_v3_add(s->at, s->way), n = sbi_pairs_face_normal(contact, other);
    int count = sbi_contact_faces_query(contact->faces,
                                        sb_v3(sb_min(s->at.x, end.x), sb_min(s->at.y, end.y), sb_min(s->at.z, end.z)),
                                        sb_v3(sb_max(s->at.x, end.x), sb_max(s->at.y, end.y), sb_max(s->at.z, end.z)),
                                        contact->scratch, contact->faces->face_room);
    for (int i = 0; i < count; i++) {
        int side = contact->scratch[i];
        sb_real depth;
        if (contact->pairs.organs[side] == contact->pairs.organs[other] &&
            sb_v3_dot(sbi_pairs_face_normal(contact, side), n) < SBI_APART_OPPOSITE &&
            sbi_pairs_are_apart(contact, s->face, side) && sbi_apart_meets(contact, side, s, 1, &depth) >= 0)
            return 1;
    }
    return 0;
}

/* 1 when the sample on its way comes from the front of a face to farther behind it than what is pushed back. */
static int sbi_apart_strays(sb_contact *contact, int other, const sbi_apart_sample *s)
{
    sb_real depth;
    if (sbi_apart_meets(contact, other, s, 0, &depth) < 0 || !(depth > sbi_pairs_safe_depth(contact, other)))
        return 0;
    return sbi_pairs_is_inside(contact, s->face, other, sb_v3_add(s->at, s->way), SBI_APART_SIDE * depth, contact->x,
                               contact->moved) ||
           sbi_apart_passes(contact, other, s);
}

/* 1 when a pair has become deeper than is safe. */
static int sbi_apart_sinks(sb_contact *contact, const sbi_pair_sample *s)
{
    const sbi_contact_faces *faces = contact->faces;
    const sb_vec3 *x = contact->x;
    const int *nodes = sbi_contact_face_nodes(faces, s->face), *others = sbi_contact_face_nodes(faces, s->other);
    sb_vec3 way = sbi_contact_mean(s->weights, nodes, faces->sizes[s->face], contact->moved), motion, at;
    sb_real before = -sb_v3_dot(s->normal, s->start), depth, safe = sbi_pairs_safe_depth(contact, s->other);
    motion = sb_v3_sub(way, sbi_contact_mean(s->shares, others, faces->sizes[s->other], contact->moved));
    depth = before - sb_v3_dot(s->normal, motion);
    if (!(depth > sb_max(safe, before + SBI_APART_SINKS * safe)))
        return 0;
    at = sb_v3_add(sbi_contact_mean(s->weights, nodes, faces->sizes[s->face], x), way);
    return sbi_pairs_is_inside(contact, s->face, s->other, at, SBI_APART_SIDE * depth, x, contact->moved);
}

/* ---- zones ---- */

/* A look at the end of a step. joins: faces that are in each other's way become one zone, or their organs do, and the
 * look goes on. */
typedef struct sbi_apart_look {
    sb_contact *contact;
    int joins, whole, found, joined;
} sbi_apart_look;

static int sbi_apart_root(int *zones, int k)
{
    while (zones[k] != k)
        k = zones[k] = zones[zones[k]];
    return k;
}

static void sbi_apart_join(sbi_apart_look *look, int a, int b)
{
    int *zones = look->contact->pairs.zones;
    look->joined |= zones[a] < 0 || zones[b] < 0;
    if (zones[a] < 0)
        zones[a] = a;
    if (zones[b] < 0)
        zones[b] = b;
    a = sbi_apart_root(zones, a);
    b = sbi_apart_root(zones, b);
    look->joined |= a != b;
    zones[sbi_max_int(a, b)] = sbi_min_int(a, b);
}

/* Joins the body's nodes that a face depends on to one of them, and to `first`, unless that is -1. Returns which. */
static int sbi_apart_join_face(sbi_apart_look *look, int first, int face)
{
    const sb_contact *contact = look->contact;
    const int *nodes = sbi_contact_face_nodes(contact->faces, face);
    for (int a = 0; a < contact->faces->sizes[face]; a++) {
        sbi_contact_row row = {1, nodes + a, NULL};
        if (contact->skin.source)
            row = sbi_contact_skin_row(&contact->skin, nodes[a]);
        for (int i = 0; i < row.count; i++) {
            first = first < 0 ? row.nodes[i] : first;
            sbi_apart_join(look, first, row.nodes[i]);
        }
    }
    return first;
}

/* Returns 1 to go on looking. */
static int sbi_apart_find(sbi_apart_look *look, int face, int other)
{
    const sb_contact *contact = look->contact;
    const int both[2] = {face, other};
    int first = -1;
    look->found = 1;
    if (!look->joins)
        return 0;
    if (look->whole) {
        sbi_apart_join(look, contact->pairs.organs[face], contact->pairs.organs[other]);
        return 1;
    }
    for (int k = 0; k < 2; k++)
        first = sbi_apart_join_face(look, first, both[k]);
    return 1;
}

/* How far samples have to come nearer to a face than they were before one may stray through it (m): what comes to it
 * passes within a share of its edge, see sbi_closest_meeting, and goes on to a depth that is not safe. */
static sb_real sbi_apart_least_way(const sb_contact *contact, int other)
{
    return SBI_APART_GOES * sbi_pairs_safe_depth(contact, other) -
           SBI_APART_PASSES * contact->pairs.plates[other].radius;
}

/* 1 when no face moves so fast that a sample may stray. */
static int sbi_apart_is_slow(const sb_contact *contact)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_real fastest = 0, least = SB_REAL_MAX;
    for (int f = 0; f < contact->faces->face_end; f++) {
        if (contact->skin.source && !(contact->faces->areas[f] > 0))
            continue;
        fastest = sb_max(fastest, sb_v3_norm(pairs->ways[f]) + pairs->spreads[f]);
        least = sb_min(least, sbi_apart_least_way(contact, f));
    }
    return 2 * fastest < least;
}

static int sbi_apart_look_at(sbi_apart_look *look, int face)
{
    sb_contact *contact = look->contact;
    const sbi_contact_faces *faces = contact->faces;
    const sb_vec3 *x = contact->x;
    const int *nodes = sbi_contact_face_nodes(faces, face);
    const sbi_contact_rule *rule = sbi_contact_face_rule(faces, face, sbi_pairs_parts(contact, face, 0));
    int count = faces->sizes[face], others = sbi_pairs_find_others(contact, face, x, contact->moved, 1, 0), fast = 0;
    for (int k = 0; k < others; k++) {
        int other = contact->pairs.found[k];
        if (!(sbi_pairs_closing(contact, face, other) < sbi_apart_least_way(contact, other)))
            contact->pairs.found[fast++] = other;
    }
    others = fast;
    for (int i = 0; others > 0 && i < rule->count; i++) {
        const sb_real *weights = rule->weights + (size_t)i * (size_t)count;
        sbi_apart_sample s;
        s.face = face;
        s.at = sbi_contact_mean(weights, nodes, count, x);
        s.way = sbi_contact_mean(weights, nodes, count, contact->moved);
        for (int k = 0; k < others; k++)
            if (!sbi_apart_stays_off(contact, contact->pairs.found[k], &s) &&
                sbi_apart_strays(contact, contact->pairs.found[k], &s) &&
                !sbi_apart_find(look, face, contact->pairs.found[k]))
                return 0;
    }
    return 1;
}

/* The whole look; boxes of faces are those of their ways. Returns 1 when nothing was found. */
static int sbi_apart_look_around(sbi_apart_look *look)
{
    sb_contact *contact = look->contact;
    look->found = look->joined = 0;
    for (int i = 0; i < contact->pairs.sample_count; i++) {
        const sbi_pair_sample *s = contact->pairs.samples + i;
        int is_known = !look->joins && contact->level == 1; /* its gap is that of the end */
        if (is_known && !(-(s->gap + contact->pairs.distance) > sbi_pairs_safe_depth(contact, s->other)))
            continue;
        if (sbi_apart_sinks(contact, s) && !sbi_apart_find(look, s->face, s->other))
            return 0;
    }
    if (sbi_apart_is_slow(contact))
        return !look->found;
    sbi_pairs_find_near(contact, 0, SBI_NEAR_LOOKING);
    for (int face = sbi_pairs_next_near(contact, 0); face >= 0; face = sbi_pairs_next_near(contact, face + 1))
        if (!sbi_apart_look_at(look, face))
            return 0;
    return !look->found;
}

/* How far a node goes in the step whose balance is at u. */
static sb_vec3 sbi_apart_way(const sb_contact *contact, const sb_vec3 *u, int node)
{
    sb_vec3 rest = sb_body_rest_positions(contact->body)[node], x = sb_body_positions(contact->body)[node];
    return sb_v3_scale(1 / contact->level, sb_v3_sub(sb_v3_add(rest, u[node]), x));
}

/* contact->moved and the faces' boxes become those of the body's nodes' ways, which are known. */
static void sbi_apart_take_ways(sb_contact *contact)
{
    const sb_vec3 *ways = sbi_contact_at_points(contact, contact->pairs.node_ways, contact->moved);
    if (ways != contact->moved)
        memcpy(contact->moved, ways, (size_t)sb_body_node_count(contact->body) * sizeof *ways);
    sbi_contact_faces_refit(contact->faces, contact->x, contact->moved, 1);
    sbi_pairs_follow(contact, contact->moved, 1);
}

static void sbi_apart_set_ways(sb_contact *contact, const sb_vec3 *u)
{
    for (int i = 0; i < sb_body_node_count(contact->body); i++)
        contact->pairs.node_ways[i] = sbi_apart_way(contact, u, i);
    sbi_apart_take_ways(contact);
}

SBI_API void sbi_pairs_set_ways(sb_contact *contact, const sb_vec3 *u)
{
    if (!contact->pairs.kinds)
        return;
    if (contact->level < 1) /* what balances within the step goes on to its end */
        sbi_apart_set_ways(contact, u);
    else
        sbi_pairs_follow(contact, contact->moved, 1);
}

SBI_API int sbi_pairs_are_safe(sb_contact *contact)
{
    sbi_apart_look look;
    if (!contact->pairs.kinds)
        return 1;
    memset(&look, 0, sizeof look);
    look.contact = contact;
    return sbi_apart_look_around(&look);
}

/* ---- mending ---- */

/* Adds an axis of a node's way to its zone's: what supports hold there counts alone. */
static void sbi_apart_add(int is_held, sb_real mass, sb_real way, sb_real *ways, sb_real *masses, sb_real *held)
{
    if (!is_held && *held > 0)
        return;
    if (is_held && !(*held > 0))
        *ways = *masses = 0;
    *held += (sb_real)is_held;
    *masses += is_held ? 1 : mass;
    *ways += is_held ? way : mass * way;
}

static sb_real sbi_apart_mean(int is_held, sb_real way, sb_real ways, sb_real masses)
{
    return is_held || !(masses > 0) ? way : ways / masses;
}

/* Of each axis (kg), with what slaves of constraints hand on. */
static sb_vec3 sbi_apart_mass(const sb_body *body, int node)
{
    sb_real m = body->lumped_mass[node];
    return body->elimination ? body->elimination->reduced[node] : sb_v3(m, m, m);
}

/* 1: a slave axis of which supports hold all masters, so that they hold it. */
static int sbi_apart_is_led(const sb_body *body, int node, int axis)
{
    sbi_constraint_entry entry;
    for (int k = 0; sbi_constraint_entry_of(body, node, axis, k, &entry); k++)
        if (entry.is_free)
            return 0;
    return 1;
}

/* 1: an axis has no mass with what slaves hand on by weights below 0. Then nodes' ways have no mean, but organs' do. */
static int sbi_apart_lacks_mass(sb_body *body)
{
    const sbi_elimination *e = body->elimination;
    if (!e)
        return 0;
    sbi_constraint_masses(body);
    for (int i = 0; i < body->domain.node_count; i++)
        for (int axis = 0; axis < 3; axis++)
            if (!(sbi_body_held(body, i) >> axis & 1) && body->lumped_mass[i] > 0 &&
                !(sbi_elimination_get(e->reduced, 3 * i + axis) > 0))
                return 1;
    return 0;
}

/* Slaves of constraints go along with their masters, from the ways that elimination->work has. */
static void sbi_apart_follow(const sb_body *body, sb_vec3 *ways)
{
    sbi_elimination *e = body->elimination;
    for (int i = 0; i < body->domain.node_count; i++)
        e->work[i] = sb_v3_sub(ways[i], e->work[i]);
    sbi_elimination_expand(e, e->work, 0);
    for (int i = 0; i < body->domain.node_count; i++)
        ways[i] = sb_v3_add(ways[i], sbi_body_pick_axes(e->slave[i], e->work[i], sb_v3(0, 0, 0)));
}

/* Nodes of a zone go the way [nodes] that they all do on the mean; what slaves of constraints weigh counts with their
 * masters. whole: zones are of organs. */
static void sbi_apart_even_out(sb_contact *contact, int whole, sb_vec3 *ways)
{
    const sb_body *body = contact->body;
    const sbi_elimination *e = body->elimination;
    sbi_pairs *pairs = &contact->pairs;
    int count = sb_body_node_count(body);
    if (e) {
        sbi_constraint_masses(contact->body);
        memcpy(e->work, ways, (size_t)count * sizeof *ways);
    }
    memset(pairs->zone_ways, 0, (size_t)count * sizeof *pairs->zone_ways);
    memset(pairs->zone_masses, 0, (size_t)count * sizeof *pairs->zone_masses);
    memset(pairs->zone_held, 0, (size_t)count * sizeof *pairs->zone_held);
    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i < count; i++) {
            int key = whole ? body->node_component[i] : i;
            unsigned held = body->fixed[i], slave = e ? e->slave[i] : 0u;
            sb_vec3 mass = sbi_apart_mass(body, i), *way = ways + i, *w, *m, *h;
            if (key < 0 || pairs->zones[key] < 0)
                continue;
            key = sbi_apart_root(pairs->zones, key);
            w = pairs->zone_ways + key, m = pairs->zone_masses + key, h = pairs->zone_held + key;
            for (int axis = 0; axis < 3; axis++) {
                int is_slave = slave >> axis & 1;
                int is_held = (held >> axis & 1) || (is_slave && sbi_apart_is_led(body, i, axis));
                if (is_slave && !is_held)
                    continue;
                if (pass == 0)
                    sbi_apart_add(is_held, sbi_elimination_get(&mass, axis), sbi_elimination_get(way, axis),
                                  sbi_elimination_at(w, axis), sbi_elimination_at(m, axis),
                                  sbi_elimination_at(h, axis));
                else
                    *sbi_elimination_at(way, axis) =
                        sbi_apart_mean(is_held, sbi_elimination_get(way, axis), sbi_elimination_get(w, axis),
                                       sbi_elimination_get(m, axis));
            }
        }
    if (e)
        sbi_apart_follow(body, ways);
}

/* What a slave axis of a node follows becomes a part of its zone, but for what supports hold. */
static void sbi_apart_join_axis(sbi_apart_look *look, int node, int axis)
{
    const sb_body *body = look->contact->body;
    sbi_constraint_entry entry;
    for (int k = 0; sbi_constraint_entry_of(body, node, axis, k, &entry); k++)
        if (entry.is_free)
            sbi_apart_join(look, look->whole ? body->node_component[node] : node,
                           look->whole ? body->node_component[entry.dof / 3] : entry.dof / 3);
}

static void sbi_apart_join_masters(sbi_apart_look *look)
{
    const sb_body *body = look->contact->body;
    const sbi_elimination *e = body->elimination;
    do {
        look->joined = 0;
        for (int i = 0; e && i < body->domain.node_count; i++) {
            int key = look->whole ? body->node_component[i] : i;
            for (int axis = 0; key >= 0 && look->contact->pairs.zones[key] >= 0 && axis < 3; axis++)
                if (e->slave[i] >> axis & 1)
                    sbi_apart_join_axis(look, i, axis);
        }
    } while (look->joined);
}

static void sbi_apart_move(sbi_apart_look *look)
{
    sb_contact *contact = look->contact;
    sbi_apart_join_masters(look);
    sbi_apart_even_out(contact, look->whole, contact->pairs.node_ways);
    sbi_apart_take_ways(contact);
}

static void sbi_apart_forget_zones(const sb_contact *contact)
{
    for (int i = 0; i < sbi_contact_any_room(contact); i++)
        contact->pairs.zones[i] = -1;
}

SBI_API int sbi_pairs_mend(sb_contact *contact, sb_vec3 *u, int whole)
{
    sbi_apart_look look;
    int changed = 0;
    memset(&look, 0, sizeof look);
    look.contact = contact;
    look.joins = 1;
    look.whole = whole || sbi_apart_lacks_mass(contact->body);
    sbi_apart_set_ways(contact, u);
    sbi_apart_forget_zones(contact);
    for (int round = 0; !sbi_apart_look_around(&look); round++) {
        if (!look.whole && (round == SBI_APART_ROUNDS || !look.joined)) {
            look.whole = 1;
            sbi_apart_forget_zones(contact);
            (void)sbi_apart_look_around(&look);
        }
        if (!look.joined) /* rounding: they go together already */
            break;
        sbi_apart_move(&look);
    }
    contact->pairs.zones_made = look.whole ? SBI_ZONES_ORGANS : SBI_ZONES_NODES;
    for (int i = 0; i < sb_body_node_count(contact->body); i++) {
        sb_vec3 more = sb_v3_sub(contact->pairs.node_ways[i], sbi_apart_way(contact, u, i));
        if (sb_v3_dot(more, more) > 0) {
            u[i] = sb_v3_madd(u[i], contact->level, more);
            changed = 1;
        }
    }
    return changed;
}

SBI_API void sbi_pairs_brake_mended(sb_contact *contact, sb_vec3 *v)
{
    if (contact->pairs.zones_made != SBI_ZONES_NONE)
        sbi_apart_even_out(contact, contact->pairs.zones_made == SBI_ZONES_ORGANS, v);
}
