/* rigid_static: free rigid bodies in static solves: where they and what hangs on them are in balance, without inertia.
 *
 * The rows are those of a step of infinite length (see rigid_step.c). Each load increment counts their turns from where
 * the one before has left them, so that all of them together may turn by more than the half a turn of one. */
#include <math.h>
#include <string.h>

#include "body_private.h"
#include "rigid_private.h"
#include "step_private.h"

SBI_API sb_result sbi_rigids_begin_static(sbi_step *step)
{
    const sbi_guest *const *guests = NULL;
    int count = 0;
    sb_result result = sbi_rigids_join(step, &guests, &count);
    if (result == SB_OK)
        result = sbi_step_take_guests(step, guests, count);
    step->given = step->guests;
    return result;
}

/* Load and weight at a load factor, as nodes have theirs: from what the last static solve ended with. */
static void sbi_rigid_load_at(const sb_body *body, const sbi_rigid *r, double factor, double load[6])
{
    double gravity[3];
    sbi_rigid_get(body->gravity, gravity);
    for (int k = 0; k < 6; k++) {
        double full = r->load[k] + (k < 3 ? r->mass * gravity[k] : 0);
        load[k] = factor == 1 ? full : r->equilibrated[k] + factor * (full - r->equilibrated[k]);
    }
}

SBI_API void sbi_rigids_begin_increment(sbi_step *step)
{
    const sb_body *b = step->body;
    for (int k = 0; b->rigids && k < b->rigids->count; k++) {
        sbi_rigid *r = b->rigids->list[k];
        memset(r->unknown, 0, sizeof r->unknown);
        memset(r->step.gravity, 0, sizeof r->step.gravity);
        sbi_rigid_load_at(b, r, (double)step->load_factor, r->step.load);
    }
    step->guests_begun = 0;
}

SBI_API void sbi_rigids_end_increment(sbi_step *step)
{
    const sbi_guest_space *space = sbi_pcg_guests(&step->body->pcg);
    for (int g = 0; g < step->given.count; g++) {
        sbi_rigid *r = (sbi_rigid *)step->given.list[g]->user;
        const double *x = space->work[g].base;
        for (int k = 0; k < 3; k++)
            r->now.centre[k] += x[k];
        sbi_rigid_turn_by(x + 3, r->now.turn);
    }
}

/* The angle (rad) of the turn from one to the other. */
static double sbi_rigid_angle(const double from[4], const double to[4])
{
    double real = 0, imaginary = 0;
    for (int k = 0; k < 4; k++)
        real += from[k] * to[k];
    for (int k = 0; k < 4; k++)
        imaginary += (to[k] - real * from[k]) * (to[k] - real * from[k]);
    return 2 * sbi_dense_atan2(sqrt(imaginary), fabs(real));
}

SBI_API double sbi_rigids_work(const sbi_step *step, int part)
{
    const sbi_guest_space *space = sbi_pcg_guests(&step->body->pcg);
    double work = 0;
    for (int g = 0; g < step->given.count; g++) {
        const sbi_rigid *r = (const sbi_rigid *)step->given.list[g]->user;
        const double *x = space->work[g].base, *load = r->step.load;
        double turn[4];
        if (part >= 0 && space->work[g].part != part)
            continue;
        memcpy(turn, r->now.turn, sizeof turn);
        sbi_rigid_turn_by(x + 3, turn);
        for (int k = 0; k < 3; k++)
            work += fabs(load[k] * (r->now.centre[k] + x[k] - r->saved.centre[k]));
        work += sqrt(load[3] * load[3] + load[4] * load[4] + load[5] * load[5]) * sbi_rigid_angle(r->saved.turn, turn);
    }
    return work;
}

SBI_API void sbi_rigids_end_static(sbi_step *step)
{
    sb_body *b = step->body;
    for (int k = 0; b->rigids && k < b->rigids->count; k++) {
        sbi_rigid *r = b->rigids->list[k];
        double turn[9];
        memset(r->now.velocity, 0, sizeof r->now.velocity);
        memset(r->now.acceleration, 0, sizeof r->now.acceleration);
        memset(r->now.spin, 0, sizeof r->now.spin);
        memset(r->now.spin_rate, 0, sizeof r->now.spin_rate);
        sbi_rigid_load_at(b, r, (double)step->info->load_factor, r->equilibrated);
        sbi_rigid_matrix(r->now.turn, turn); /* an increment that failed may have left other arms */
        for (int i = 0; i < r->guest.node_count; i++)
            for (int c = 0; c < 3; c++)
                r->y[i][c] =
                    turn[3 * c] * r->lever[i][0] + turn[3 * c + 1] * r->lever[i][1] + turn[3 * c + 2] * r->lever[i][2];
        sbi_rigid_read_wrench(r, b->work);
    }
}
