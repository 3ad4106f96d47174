/* contact_hold: samples of organs that lie deep at the end of a step come no deeper in it.
 *
 * What a pressure of limited stiffness lets through in one step, a hit of fast organs or a load on a corner, is taken
 * out of the motion: of a sample and of the point that it is paired with just so much along the normal that the overlap
 * ends where it began, or at the share of a face's length that is let be. Nodes share it by their masses: momentum
 * stays, and kinetic energy is only lost, as in an impact without rebound. Slaves of constraints hand their share on to
 * their masters, with masses that are lumped: energy is that of these. Samples follow each other, a few times over;
 * what is left is contact_apart.c's to judge. Source: Bridson, Fedkiw, Anderson 2002 (inelastic impulses); Mueller et
 * al. 2007 (positions corrected by masses). */
#include <string.h>

#include "../body/body_private.h"
#include "../body/constraint.h"
#include "contact_private.h"

/* Of what is safe: how deep samples may come before they are held. */
#define SBI_HOLD_FROM ((sb_real)0.6)
/* Of that: what is left of a sample's way too deep. */
#define SBI_HOLD_SLACK ((sb_real)0.02)
/* More than what rounding makes of a way. */
#define SBI_HOLD_ROUNDED ((sb_real)1.001)
enum { SBI_HOLD_ROUNDS = 10 };

enum { SBI_HOLD_NODES = 3 * SB_MAX_ELEMENT_NODES }; /* of the cells of a skin's triangle at most */

/* A side of a pair: nodes of the body and their weights, each once; 1 or -1. */
typedef struct sbi_hold_side {
    const int *nodes;
    const sb_real *weights;
    int count;
    sb_real sign;
    int own_nodes[SBI_HOLD_NODES]; /* of a skin's triangle */
    sb_real own_weights[SBI_HOLD_NODES];
} sbi_hold_side;

/* A triangle's points as their nodes. */
static void sbi_hold_expand(const sb_contact *contact, int face, const sb_real *weights, sbi_hold_side *side)
{
    const int *points = sbi_contact_face_nodes(contact->faces, face);
    side->nodes = side->own_nodes;
    side->weights = side->own_weights;
    side->count = 0;
    for (int a = 0; a < contact->faces->sizes[face]; a++) {
        const sbi_contact_row row = sbi_contact_skin_row(&contact->skin, points[a]);
        for (int i = 0; i < row.count; i++) {
            int at = 0;
            while (at < side->count && side->own_nodes[at] != row.nodes[i])
                at++;
            if (at == side->count)
                side->own_weights[side->count++] = 0;
            side->own_nodes[at] = row.nodes[i];
            side->own_weights[at] += weights[a] * row.weights[i];
        }
    }
}

static void sbi_hold_make_side(const sb_contact *contact, int face, const sb_real *weights, sbi_hold_side *side)
{
    side->nodes = sbi_contact_face_nodes(contact->faces, face);
    side->weights = weights;
    side->count = contact->faces->sizes[face];
    if (contact->skin.source)
        sbi_hold_expand(contact, face, weights, side);
}

static void sbi_hold_sides(const sb_contact *contact, const sbi_pair_sample *s, sbi_hold_side sides[2])
{
    sbi_hold_make_side(contact, s->face, s->weights, sides);
    sbi_hold_make_side(contact, s->other, s->shares, sides + 1);
    sides[0].sign = 1;
    sides[1].sign = -1;
}

/* ---- slaves of constraints: in a field [rows] only their masters are kept up to date, samples read slaves by them */

/* A node's value, of slaves' axes by masters and what contact->moved has beyond them. */
static sb_vec3 sbi_hold_at(const sb_contact *contact, const sb_vec3 *field, int node)
{
    const sb_body *body = contact->body;
    sb_vec3 value = field[node];
    for (int axis = 0; body->elimination && axis < 3; axis++) {
        sb_real sum = sbi_elimination_get(contact->moved, 3 * node + axis);
        sbi_constraint_entry entry;
        if (!(body->elimination->slave[node] >> axis & 1))
            continue;
        for (int k = 0; sbi_constraint_entry_of(body, node, axis, k, &entry); k++)
            sum += entry.weight * sbi_elimination_get(field, entry.dof);
        *sbi_elimination_at(&value, axis) = sum;
    }
    return value;
}

/* contact->moved of slaves = what a field has there beyond masters. */
static void sbi_hold_begin(sb_contact *contact, const sb_vec3 *field)
{
    const sbi_elimination *e = contact->body->elimination;
    if (!e)
        return;
    sbi_constraint_masses(contact->body);
    for (int i = 0; i < contact->body->domain.node_count; i++)
        if (e->slave[i]) {
            contact->moved[i] = sb_v3(0, 0, 0);
            contact->moved[i] = sb_v3_sub(field[i], sbi_hold_at(contact, field, i));
        }
}

/* Slaves follow. */
static void sbi_hold_end(const sb_contact *contact, sb_vec3 *field)
{
    const sbi_elimination *e = contact->body->elimination;
    for (int i = 0; e && i < contact->body->domain.node_count; i++)
        if (e->slave[i])
            field[i] = sbi_hold_at(contact, field, i);
}

/* ---- one sample ---- */

/* What x - y has along the normal of a field v [rows]. */
static sb_real sbi_hold_jump(const sb_contact *contact, const sbi_pair_sample *s, const sbi_hold_side sides[2],
                             const sb_vec3 *v)
{
    sb_real sum = 0;
    for (int k = 0; k < 2; k++)
        for (int a = 0; a < sides[k].count; a++)
            sum +=
                sides[k].sign * sides[k].weights[a] * sb_v3_dot(s->normal, sbi_hold_at(contact, v, sides[k].nodes[a]));
    return sum;
}

/* How far x - y goes along the normal at displacements u [rows], over the whole step (m). is_whole: u has slaves. */
static sb_real sbi_hold_way(const sb_contact *contact, const sbi_pair_sample *s, const sbi_hold_side sides[2],
                            const sb_vec3 *u, int is_whole)
{
    const sb_vec3 *rest = sb_body_rest_positions(contact->body), *x = sb_body_positions(contact->body);
    sb_real sum = 0;
    for (int k = 0; k < 2; k++)
        for (int a = 0; a < sides[k].count; a++) {
            int node = sides[k].nodes[a];
            sb_vec3 way = sb_v3_sub(sb_v3_add(rest[node], is_whole ? u[node] : sbi_hold_at(contact, u, node)), x[node]);
            sum += sides[k].sign * sides[k].weights[a] * sb_v3_dot(s->normal, way);
        }
    return sum / contact->level;
}

/* Least share of what both sides could move if nothing held them: with less, a push goes to what hardly touches. */
#define SBI_HOLD_LOOSE ((sb_real)1e-3)

/* A pass over what a force along the normal at x, against one at y, loads: axes of nodes, of slaves their masters'.
 * Each may come several times; elimination->work has its force. */
typedef enum sbi_hold_stage { SBI_HOLD_CLEAR, SBI_HOLD_LOAD, SBI_HOLD_MEASURE, SBI_HOLD_MOVE } sbi_hold_stage;
typedef struct sbi_hold_pass {
    sbi_hold_stage stage;
    sb_real sum, all; /* (1/kg) of what can move, and of what could without supports */
    int lacks_mass;   /* 1: an axis has none, by weights below 0: no share of it would keep the momentum */
    sb_real share;
    sb_vec3 *v;
} sbi_hold_pass;

static void sbi_hold_pass_axis(const sb_body *body, sbi_hold_pass *pass, int dof, int is_free, sb_real load)
{
    const sbi_elimination *e = body->elimination;
    sb_real *force = sbi_elimination_at(e->work, dof);
    sb_real mass = is_free ? sbi_elimination_get(e->reduced, dof) : body->lumped_mass[dof / 3];
    sb_real motion = mass > 0 ? *force / mass : 0;
    if (pass->stage == SBI_HOLD_CLEAR || pass->stage == SBI_HOLD_MOVE)
        *force = 0; /* what moves does so once */
    if (pass->stage == SBI_HOLD_LOAD)
        *force += load;
    if (pass->stage == SBI_HOLD_MEASURE) {
        pass->all += load * motion;
        pass->sum += is_free ? load * motion : 0;
        pass->lacks_mass |= is_free && load != 0 && !(mass > 0);
    }
    if (pass->stage == SBI_HOLD_MOVE && is_free)
        *sbi_elimination_at(pass->v, dof) += pass->share * motion;
}

static void sbi_hold_pass_node(const sb_body *body, sbi_hold_pass *pass, int node, sb_vec3 force)
{
    for (int axis = 0; axis < 3; axis++) {
        sb_real load = sbi_elimination_get(&force, axis);
        sbi_constraint_entry entry;
        if (!(body->elimination->slave[node] >> axis & 1)) {
            sbi_hold_pass_axis(body, pass, 3 * node + axis, !(body->fixed[node] >> axis & 1), load);
            continue;
        }
        for (int k = 0; sbi_constraint_entry_of(body, node, axis, k, &entry); k++)
            if (entry.weight != 0)
                sbi_hold_pass_axis(body, pass, entry.dof, entry.is_free, entry.weight * load);
    }
}

static void sbi_hold_run_pass(const sb_body *body, sbi_hold_pass *pass, sbi_hold_stage stage, const sbi_pair_sample *s,
                              const sbi_hold_side sides[2])
{
    pass->stage = stage;
    for (int k = 0; k < 2; k++)
        for (int a = 0; a < sides[k].count; a++)
            sbi_hold_pass_node(body, pass, sides[k].nodes[a],
                               sb_v3_scale(sides[k].sign * sides[k].weights[a], s->normal));
}

/* sbi_hold_push of a body with constraints, whose masses are in elimination->reduced; of v without slaves. */
static int sbi_hold_push_tied(const sb_body *body, const sbi_pair_sample *s, const sbi_hold_side sides[2], sb_real way,
                              sb_vec3 *v)
{
    sbi_hold_pass pass;
    memset(&pass, 0, sizeof pass);
    pass.v = v;
    sbi_hold_run_pass(body, &pass, SBI_HOLD_CLEAR, s, sides);
    sbi_hold_run_pass(body, &pass, SBI_HOLD_LOAD, s, sides);
    sbi_hold_run_pass(body, &pass, SBI_HOLD_MEASURE, s, sides);
    if (pass.lacks_mass || !(pass.sum > SBI_HOLD_LOOSE * pass.all))
        return 0;
    pass.share = way / pass.sum;
    sbi_hold_run_pass(body, &pass, SBI_HOLD_MOVE, s, sides);
    return 1;
}

/* v [rows] += what takes x from y by `way` along the normal. 0: next to nothing of both can move. */
static int sbi_hold_push(const sb_contact *contact, const sbi_pair_sample *s, const sbi_hold_side sides[2], sb_real way,
                         sb_vec3 *v)
{
    const sb_body *body = contact->body;
    sb_real sum = 0, all = 0;
    if (body->elimination)
        return sbi_hold_push_tied(body, s, sides, way, v);
    for (int pass = 0; pass < 2; pass++) {
        for (int k = 0; k < 2; k++)
            for (int a = 0; a < sides[k].count; a++) {
                int node = sides[k].nodes[a];
                sb_vec3 n = sbi_body_pick_axes(body->fixed[node], sb_v3(0, 0, 0), s->normal);
                sb_real ease = body->lumped_mass[node] > 0 ? sides[k].weights[a] / body->lumped_mass[node] : 0;
                if (pass == 0) {
                    sum += sides[k].weights[a] * ease * sb_v3_dot(n, n);
                    all += sides[k].weights[a] * ease;
                } else {
                    v[node] = sb_v3_madd(v[node], sides[k].sign * ease * way / sum, n);
                }
            }
        if (!(sum > SBI_HOLD_LOOSE * all))
            return 0;
    }
    return 1;
}

/* How much too deep a sample ends (m). */
static sb_real sbi_hold_excess(sb_contact *contact, const sbi_pair_sample *s, const sbi_hold_side sides[2],
                               const sb_vec3 *u, int is_whole)
{
    sb_real before = -sb_v3_dot(s->normal, s->start);
    sb_real most = sb_max(before, SBI_HOLD_FROM * sbi_pairs_safe_depth(contact, s->other));
    return before - sbi_hold_way(contact, s, sides, u, is_whole) - most;
}

/* Whether two faces overlap is sure of those of two organs only. */
static int sbi_hold_takes(const sb_contact *contact, const sbi_pair_sample *s)
{
    return contact->pairs.organs[s->face] != contact->pairs.organs[s->other];
}

/* Ways (m) of points that weights of nodes make of these, over the whole step, are no longer than the largest of
 * nodes; SB_REAL_MAX: that is not known, since nodes follow others. */
static sb_real sbi_hold_farthest(const sb_contact *contact, const sb_vec3 *u)
{
    const sb_vec3 *rest = sb_body_rest_positions(contact->body), *x = sb_body_positions(contact->body);
    sb_real square = 0;
    if (contact->skin.source || contact->body->elimination)
        return SB_REAL_MAX;
    for (int k = 0; k < contact->node_count; k++) {
        const int node = contact->nodes[k];
        const sb_vec3 way = sb_v3_sub(sb_v3_add(rest[node], u[node]), x[node]);
        square = sb_max(square, sb_v3_dot(way, way));
    }
    return SBI_HOLD_ROUNDED * sb_sqrt(square) / contact->level;
}

/* 1 when no such ways bring a sample too deep. */
static int sbi_hold_is_far(const sb_contact *contact, const sbi_pair_sample *s, sb_real farthest)
{
    const sbi_contact_faces *faces = contact->faces;
    const sbi_contact_kind *one = &faces->kinds[faces->sizes[s->face]], *two = &faces->kinds[faces->sizes[s->other]];
    const sb_real spread = one->rules[one->most].spread + two->rules[two->most].spread;
    return farthest < SB_REAL_MAX &&
           spread * farthest - sb_v3_dot(s->normal, s->start) < SBI_HOLD_FROM * sbi_pairs_safe_depth(contact, s->other);
}

SBI_API int sbi_pairs_hold(sb_contact *contact, sb_vec3 *u)
{
    const sb_real farthest = sbi_hold_farthest(contact, u);
    int changed = 0, again = 1;
    sbi_hold_begin(contact, u);
    for (int round = 0; again && round < SBI_HOLD_ROUNDS; round++) {
        again = 0;
        for (int i = 0; i < contact->pairs.sample_count; i++) {
            const sbi_pair_sample *s = contact->pairs.samples + i;
            sb_real slack = SBI_HOLD_SLACK * sbi_pairs_safe_depth(contact, s->other), excess;
            sbi_hold_side sides[2];
            if (!sbi_hold_takes(contact, s) || (!changed && sbi_hold_is_far(contact, s, farthest)))
                continue;
            sbi_hold_sides(contact, s, sides);
            excess = sbi_hold_excess(contact, s, sides, u, 0);
            if (excess > slack && sbi_hold_push(contact, s, sides, contact->level * excess, u))
                again = changed = 1;
        }
    }
    if (changed)
        sbi_hold_end(contact, u);
    return changed;
}

SBI_API void sbi_pairs_brake_held(sb_contact *contact, const sb_vec3 *u, sb_vec3 *v)
{
    int again = 1, changed = 0;
    sbi_hold_begin(contact, v);
    for (int round = 0; again && round < SBI_HOLD_ROUNDS; round++) {
        again = 0;
        for (int i = 0; i < contact->pairs.sample_count; i++) {
            const sbi_pair_sample *s = contact->pairs.samples + i;
            sb_real slack = SBI_HOLD_SLACK * sbi_pairs_safe_depth(contact, s->other), speed;
            sbi_hold_side sides[2];
            if (!sbi_hold_takes(contact, s))
                continue;
            sbi_hold_sides(contact, s, sides);
            speed = -sbi_hold_jump(contact, s, sides, v);
            if (speed > 0 && sbi_hold_excess(contact, s, sides, u, 1) > -slack &&
                sbi_hold_push(contact, s, sides, speed, v))
                again = changed = 1;
        }
    }
    if (changed)
        sbi_hold_end(contact, v);
}
