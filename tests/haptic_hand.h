/* haptic_hand: a hand on a haptic device, and a tissue that is stepped slower than the device is served.
 *
 *     hand     a mass with damping, drawn by a spring to a goal that wanders, with tremor; the device holds its force
 *              between calls and measures the position in steps of its encoder
 *     tissue   the half space below z = 0: Kelvin-Voigt, stiffening, with friction. It may breathe by itself
 *     steps    begin with the newest pose the hand's side has posted, and their frame arrives when the next one begins:
 *              one step late. Now and then one takes up to 0.3 s
 *
 * For tests and the soak: units that hold the implementation. */
#ifndef HAPTIC_HAND_H
#define HAPTIC_HAND_H

#include "check.h"

/* What a scene is made of; all SI. */
typedef struct hand_case {
    double mass, damping, stiffness; /* of the hand, to its goal */
    double tremor;                   /* m at 9 Hz */
    double wander;                   /* m: how far goals lie apart; 0: it presses to `depth` */
    double depth;                    /* m below the surface, of goals on average */
    double encoder;                  /* m */
    double tissue, stiffening;       /* N/m; m of indentation that doubles its slope over 2 */
    double viscosity;                /* s: damping over stiffness */
    double friction, shear;          /* mu; tangential stiffness over the normal one */
    double breathing;                /* m at 0.25 Hz */
    double period, jitter;           /* s between steps; share of it */
    double stalls;                   /* share of steps that take up to 0.3 s */
    double tick_low, tick_high;      /* s between calls */
    int held;                        /* 1: the force of the last frame instead of its model: what is to be avoided */
} hand_case;

static inline hand_case hand_usual(void)
{
    hand_case c = {0.35, 3, 300, 2e-4, 0.03, 0.004, 5.5e-5, 250, 0.02, 0.01, 0.3, 0.5, 0, 0.01, 0, 0, 1e-3, 1e-3, 0};
    return c;
}

typedef struct hand_scene {
    hand_case is;
    unsigned long long seed;
    sbi_servo servo;
    double time, last_dt;         /* s; s of the last call */
    sbi_d3 x, v, goal, aim;       /* the hand, in the device's space; where it goes, and will go */
    double next_goal;             /* s */
    sb_wrench_d force;            /* on the hand since the last call */
    sbi_d3 measured;              /* x by the encoder */
    double next_step, step_begun; /* s */
    double indentation;           /* m of the tissue's surface */
    sbi_d3 traction, touched;     /* N, m: friction's memory */
    sb_tool_state posted;         /* newest pose for the simulation */
    sbi_haptic_frame computed;    /* by the step that runs */
    int has_computed;
    double bank, beyond; /* J, accounted for here with the true positions; the most below 0 */
    double given, taken; /* J of the device to the hand, of the hand to the device */
    double jump, peak;   /* N: largest change of the force between calls, largest force */
    double low, high;    /* m: where the hand's z has been since hand_watch */
    long calls;
} hand_scene;

static inline double hand_random(hand_scene *s, double low, double high)
{
    return check_random_in(&s->seed, low, high);
}

static inline sb_tool_state hand_state(const hand_scene *s, sbi_d3 measured, sbi_d3 before, double dt)
{
    sb_tool_state state;
    memset(&state, 0, sizeof state);
    sbi_d_put(state.position, measured);
    sbi_d_put(state.velocity, sbi_d_scale(1 / dt, sbi_d_sub(measured, before)));
    state.rotation[0] = state.rotation[4] = state.rotation[8] = 1;
    state.time = s->time;
    return state;
}

static inline int hand_begin(hand_scene *s, const hand_case *is, const sb_haptic_def *def, unsigned long long seed)
{
    memset(s, 0, sizeof *s);
    s->is = *is;
    s->seed = seed * 2654435761u + 88172645463325252ull;
    s->x = s->goal = s->aim = s->measured = sbi_d(0, 0, 0.002);
    s->low = 1, s->high = -1;
    s->posted = hand_state(s, s->x, s->x, 1);
    return CHECK_OK(sbi_servo_begin(&s->servo, def, NULL));
}

/* ---- the simulation ---- */

/* A step of the tissue with the tool at its end at q: forces, and what the law knows of them. */
static inline sbi_haptic_frame hand_tissue_step(hand_scene *s, sbi_d3 q, double dt)
{
    const hand_case *is = &s->is;
    double surface = is->breathing * sin(2 * 3.14159265358979 * 0.25 * s->time), depth = surface - q.z, slope, push,
           size;
    sbi_haptic_frame frame;
    sbi_haptic_cluster *k = frame.clusters;
    double in = depth > 0 ? depth : 0;
    memset(&frame, 0, sizeof frame);
    frame.pose.position = q;
    frame.pose.rotation.w = 1;
    frame.count = 1;
    slope = is->tissue * (1 + 2 * in / is->stiffening) + is->tissue * is->viscosity / dt;
    push = is->tissue * depth * (1 + in / is->stiffening) + is->tissue * is->viscosity * (depth - s->indentation) / dt;
    if (push > 0) {
        s->indentation = depth;
        s->traction =
            sbi_d_madd(s->traction, -is->shear * is->tissue, sbi_d(q.x - s->touched.x, q.y - s->touched.y, 0));
        size = sbi_d_norm(s->traction);
        if (size > is->friction * push)
            s->traction = sbi_d_scale(is->friction * push / size, s->traction);
    } else {
        s->indentation *= is->viscosity / (is->viscosity + dt);
        push = slope * (depth - s->indentation) < 0 ? slope * (depth - s->indentation) : 0;
        s->traction = sbi_d(0, 0, 0);
    }
    s->touched = q;
    k->normal = sbi_d(0, 0, 1);
    k->push = push;
    k->traction = s->traction;
    k->friction = is->friction;
    k->stiffness = is->held ? 0 : slope;
    k->tangential = is->held ? 0 : is->shear * is->tissue;
    return frame;
}

/* The frame that arrives with this call, or NULL. */
static inline const sbi_haptic_frame *hand_simulate(hand_scene *s, sbi_haptic_frame *arrives)
{
    const sbi_haptic_frame *fresh = NULL;
    double length = s->is.period * (1 + hand_random(s, -s->is.jitter, s->is.jitter));
    if (s->time < s->next_step)
        return NULL;
    if (s->has_computed) {
        *arrives = s->computed;
        fresh = arrives;
    }
    s->computed = hand_tissue_step(s, sbi_d_from(s->posted.position), s->is.period);
    s->has_computed = 1;
    if (hand_random(s, 0, 1) < s->is.stalls)
        length = hand_random(s, 0.05, 0.3);
    s->next_step = s->time + length;
    return fresh;
}

/* ---- the hand ---- */

/* Goals come at random; the hand's wish goes there in a few tenths of a second. */
static inline void hand_wish(hand_scene *s, double dt)
{
    const hand_case *is = &s->is;
    double share = dt / 0.15, tremor = is->tremor * sin(2 * 3.14159265358979 * 9 * s->time);
    if (s->time >= s->next_goal) {
        s->next_goal = s->time + hand_random(s, 0.1, 1.5);
        s->aim.x = hand_random(s, -is->wander, is->wander);
        s->aim.y = hand_random(s, -is->wander, is->wander);
        s->aim.z = 0.3 * hand_random(s, -is->wander, is->wander) - is->depth;
    }
    s->goal = sbi_d_add(s->goal, sbi_d_scale(share, sbi_d_sub(s->aim, s->goal)));
    s->goal.z += tremor * dt * 2 * 3.14159265358979 * 9;
}

/* The hand under the force that is held, in parts short against everything in it. */
static inline void hand_move(hand_scene *s, double dt)
{
    enum { PARTS = 4 };
    const hand_case *is = &s->is;
    double part = dt / (double)PARTS;
    sbi_d3 force = sbi_d_from(s->force.force), before = s->x;
    hand_wish(s, dt);
    for (int i = 0; i < PARTS; i++) {
        sbi_d3 sum = sbi_d_madd(force, is->stiffness, sbi_d_sub(s->goal, s->x));
        s->v = sbi_d_scale(1 / (1 + part * is->damping / is->mass), sbi_d_madd(s->v, part / is->mass, sum));
        s->x = sbi_d_madd(s->x, part, s->v);
    }
    before = sbi_d_sub(s->x, before);
    s->bank -= sbi_d_dot(force, before) - 0.5e-3 * s->servo.def.max_stiffness * sbi_d_dot(before, before) / dt;
    s->given += fmax(sbi_d_dot(force, before), 0);
    s->taken += fmax(-sbi_d_dot(force, before), 0);
    s->beyond = fmax(s->beyond, -s->bank);
    s->low = s->x.z < s->low ? s->x.z : s->low;
    s->high = s->x.z > s->high ? s->x.z : s->high;
}

static inline double hand_encode(const hand_scene *s, double x)
{
    return s->is.encoder > 0 ? s->is.encoder * floor(x / s->is.encoder + 0.5) : x;
}

/* The hand moves to the time of the next call; returns what the device says of it then. */
static inline sb_tool_state hand_sense(hand_scene *s)
{
    double dt = hand_random(s, s->is.tick_low, s->is.tick_high);
    sbi_d3 before = s->measured;
    hand_move(s, dt);
    s->time += dt;
    s->last_dt = dt;
    s->measured = sbi_d(hand_encode(s, s->x.x), hand_encode(s, s->x.y), hand_encode(s, s->x.z));
    return hand_state(s, s->measured, before, dt);
}

/* After a call: the bank and the largest forces. `before`: the wrench until then. */
static inline void hand_account(hand_scene *s, const sb_wrench_d *before)
{
    const sb_haptic_def *def = &s->servo.def;
    double change = sbi_d_norm(sbi_d_sub(sbi_d_from(s->force.force), sbi_d_from(before->force)));
    double spare = 0.05 * def->max_force * def->max_force / def->max_stiffness;
    s->bank = fmin(s->bank, s->servo.stored + spare) + def->energy_rate * s->last_dt;
    s->jump = fmax(s->jump, change);
    s->peak = fmax(s->peak, sbi_d_norm(sbi_d_from(s->force.force)));
    s->calls++;
}

/* From one call to the next. Returns what the call did. */
static inline int hand_call(hand_scene *s)
{
    sb_wrench_d before = s->force;
    sb_tool_state state = hand_sense(s);
    sbi_haptic_frame arrives;
    int follows = sbi_servo_call(&s->servo, &state, hand_simulate(s, &arrives), &s->force);
    s->posted = sbi_servo_wanted(&s->servo, 0, &state);
    hand_account(s, &before);
    return follows;
}

/* Begins to watch how far the hand swings. */
static inline void hand_watch(hand_scene *s) { s->low = s->high = s->x.z; }

#endif
