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
enum { SBI_HOLD_ROUNDS = 10 };

/* A side of a pair: nodes of its face and their weights; 1 or -1. */
typedef struct sbi_hold_side {
    const int *nodes;
    const sb_real *weights;
    int count;
    sb_real sign;
} sbi_hold_side;

static void sbi_hold_sides(const sb_contact *contact, const sbi_pair_sample *s, sbi_hold_side sides[2])
{
    sides[0].nodes = sbi_contact_face_nodes(contact->faces, s->face);
    sides[0].weights = s->weights;
    sides[0].count = contact->faces->sizes[s->face];
    sides[0].sign = 1;
    sides[1].nodes = sbi_contact_face_nodes(contact->faces, s->other);
    sides[1].weights = s->shares;
    sides[1].count = contact->faces->sizes[s->other];
    sides[1].sign = -1;
}

/* What x - y has along the normal of a field v [rows]. */
static sb_real sbi_hold_jump(const sbi_pair_sample *s, const sbi_hold_side sides[2], const sb_vec3 *v)
{
    sb_real sum = 0;
    for (int k = 0; k < 2; k++)
        for (int a = 0; a < sides[k].count; a++)
            sum += sides[k].sign * sides[k].weights[a] * sb_v3_dot(s->normal, v[sides[k].nodes[a]]);
    return sum;
}

/* How far x - y goes along the normal at displacements u [rows], over the whole step (m). */
static sb_real sbi_hold_way(const sb_contact *contact, const sbi_pair_sample *s, const sbi_hold_side sides[2],
                            const sb_vec3 *u)
{
    const sb_vec3 *rest = sb_body_rest_positions(contact->body), *x = sb_body_positions(contact->body);
    sb_real sum = 0;
    for (int k = 0; k < 2; k++)
        for (int a = 0; a < sides[k].count; a++) {
            int node = sides[k].nodes[a];
            sb_vec3 way = sb_v3_sub(sb_v3_add(rest[node], u[node]), x[node]);
            sum += sides[k].sign * sides[k].weights[a] * sb_v3_dot(s->normal, way);
        }
    return sum / contact->level;
}

/* Least share of what both sides could move if nothing held them: with less, a push goes to what hardly touches. */
#define SBI_HOLD_LOOSE ((sb_real)1e-3)

/* push [rows] = what a force along the normal at x, against one at y, is to the masters of constraints. */
static void sbi_hold_load(const sb_body *body, const sbi_pair_sample *s, const sbi_hold_side sides[2], sb_vec3 *push)
{
    memset(push, 0, (size_t)body->domain.node_count * sizeof *push);
    for (int k = 0; k < 2; k++)
        for (int a = 0; a < sides[k].count; a++) {
            sb_vec3 *at = push + sides[k].nodes[a];
            *at = sb_v3_madd(*at, sides[k].sign * sides[k].weights[a], s->normal);
        }
    sbi_elimination_reduce(body->elimination, push, push, NULL);
}

/* Replaces a force on a node by the motion that it makes of the mass of each axis, 0 where supports hold it. Adds their
 * product to *sum, and to *all what it were without supports. */
static void sbi_hold_give_way(const sb_body *body, int node, sb_vec3 *push, sb_real *sum, sb_real *all)
{
    for (int axis = 0; axis < 3; axis++) {
        int is_fixed = body->fixed[node] >> axis & 1;
        sb_real *at = sbi_elimination_at(push, 3 * node + axis), force = *at;
        sb_real mass =
            is_fixed ? body->lumped_mass[node] : sbi_elimination_get(body->elimination->reduced, 3 * node + axis);
        sb_real motion = force != 0 && mass > 0 ? force / mass : 0;
        *all += force * motion;
        *sum += is_fixed ? 0 : force * motion;
        *at = is_fixed ? 0 : motion;
    }
}

/* sbi_hold_push of a body with constraints, whose masses are in elimination->reduced. */
static int sbi_hold_push_tied(const sb_body *body, const sbi_pair_sample *s, const sbi_hold_side sides[2], sb_real way,
                              sb_vec3 *v)
{
    sb_vec3 *push = body->elimination->work;
    sb_real sum = 0, all = 0;
    sbi_hold_load(body, s, sides, push);
    for (int i = 0; i < body->domain.node_count; i++)
        sbi_hold_give_way(body, i, push, &sum, &all);
    if (!(sum > SBI_HOLD_LOOSE * all))
        return 0;
    sbi_elimination_expand(body->elimination, push, 0);
    for (int i = 0; i < body->domain.node_count; i++)
        v[i] = sb_v3_madd(v[i], way / sum, push[i]);
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
                               const sb_vec3 *u)
{
    sb_real before = -sb_v3_dot(s->normal, s->start);
    sb_real most = sb_max(before, SBI_HOLD_FROM * sbi_pairs_safe_depth(contact, s->other));
    return before - sbi_hold_way(contact, s, sides, u) - most;
}

/* Whether two faces overlap is sure of those of two organs only. */
static int sbi_hold_takes(const sb_contact *contact, const sbi_pair_sample *s)
{
    return contact->pairs.organs[s->face] != contact->pairs.organs[s->other];
}

SBI_API int sbi_pairs_hold(sb_contact *contact, sb_vec3 *u)
{
    int changed = 0, again = 1;
    if (contact->body->elimination)
        sbi_constraint_masses(contact->body);
    for (int round = 0; again && round < SBI_HOLD_ROUNDS; round++) {
        again = 0;
        for (int i = 0; i < contact->pairs.sample_count; i++) {
            const sbi_pair_sample *s = contact->pairs.samples + i;
            sb_real slack = SBI_HOLD_SLACK * sbi_pairs_safe_depth(contact, s->other), excess;
            sbi_hold_side sides[2];
            if (!sbi_hold_takes(contact, s))
                continue;
            sbi_hold_sides(contact, s, sides);
            excess = sbi_hold_excess(contact, s, sides, u);
            if (excess > slack && sbi_hold_push(contact, s, sides, contact->level * excess, u))
                again = changed = 1;
        }
    }
    return changed;
}

SBI_API void sbi_pairs_brake_held(sb_contact *contact, const sb_vec3 *u, sb_vec3 *v)
{
    int again = 1;
    if (contact->body->elimination)
        sbi_constraint_masses(contact->body);
    for (int round = 0; again && round < SBI_HOLD_ROUNDS; round++) {
        again = 0;
        for (int i = 0; i < contact->pairs.sample_count; i++) {
            const sbi_pair_sample *s = contact->pairs.samples + i;
            sb_real slack = SBI_HOLD_SLACK * sbi_pairs_safe_depth(contact, s->other), speed;
            sbi_hold_side sides[2];
            if (!sbi_hold_takes(contact, s))
                continue;
            sbi_hold_sides(contact, s, sides);
            speed = -sbi_hold_jump(s, sides, v);
            if (speed > 0 && sbi_hold_excess(contact, s, sides, u) > -slack &&
                sbi_hold_push(contact, s, sides, speed, v))
                again = 1;
        }
    }
}
