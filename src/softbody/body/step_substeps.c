/* step_substeps: a step that contact refuses is divided: tissue that flies past a tool in a step, or organs that fly
 * through each other, are seen on their way in shorter ones.
 *
 * A part that is refused is tried half as long, or as short as contact asked for, and what follows is no longer; none
 * is shorter than 1/SBI_SUBSTEPS_MOST of the step. So its work is bounded: that many parts, and the few that were
 * refused. Supports and tools go evenly over the step. Where the shortest part fails, too, all is as before the call,
 * and the error is that of the whole step. The recorder hears of one step: played again it divides itself as it did. */
#include "step_touch.h"

#include <string.h>

#include "state_part.h"
#include "step_private.h"

enum { SBI_SUBSTEPS_MOST = 16 };

/* ---- room for a snapshot ---- */

/* Of a body whose mesh takes all the slots that there are by now, and half as much again once it has grown. */
static size_t sbi_substeps_roomy(const sb_body *b, size_t needed)
{
    size_t nodes = (size_t)sbi_max_int(1, b->domain.node_count), slots = (size_t)b->node_capacity;
    size_t most = needed <= (size_t)-1 / (2 * slots) ? needed * slots / nodes : needed;
    size_t grown = b->substep_room && needed <= (size_t)-1 / 2 ? needed + needed / 2 : needed;
    return most > grown ? most : grown;
}

SBI_API sb_result sbi_body_reserve_substeps(sb_body *b, sb_error *error)
{
    size_t needed = sbi_body_snapshot_size(b);
    unsigned char *room;
    if (needed && needed <= b->substep_room_size)
        return SB_OK;
    if (b->live) /* its mesh may grow */
        needed = sbi_substeps_roomy(b, needed);
    room = needed ? (unsigned char *)sbi_alloc(&b->allocator, needed, 1) : NULL;
    if (!room)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for what a divided step gives back");
    sbi_free(&b->allocator, b->substep_room);
    b->substep_room = room;
    b->substep_room_size = needed;
    return SB_OK;
}

/* ---- a divided step ---- */

static void sbi_substeps_keep(sb_body *b)
{
    sbi_body_snapshot(b, b->substep_room, NULL);
    (void)b->touch->keep(b->touch->user, NULL); /* the step that was refused has followed the mesh */
}

static void sbi_substeps_rewind(sb_body *b, size_t snapshot)
{
    (void)sbi_body_rewind(b, b->substep_room, snapshot, NULL); /* a step changes nothing that would need memory */
    (void)b->touch->rewind(b->touch->user, NULL);              /* nor the mesh */
}

/* What all attempts together took. */
static void sbi_substeps_count(sb_step_info *sum, const sb_step_info *part)
{
    sum->newton_iterations += part->newton_iterations;
    sum->pcg_iterations += part->pcg_iterations;
    sum->seconds_force += part->seconds_force;
    sum->seconds_tangent += part->seconds_tangent;
    sum->seconds_precond += part->seconds_precond;
    sum->seconds_solve += part->seconds_solve;
}

/* Shorter than a part that was refused: half as long, or as short as contact asked for. */
static int sbi_substeps_shorten(const sb_body *b, int length)
{
    int wanted = length / sbi_max_int(2, b->touch->parts);
    do
        length /= 2;
    while (length > sbi_max_int(1, wanted));
    return length;
}

/* After the whole step was refused. sum: counts up; the rest is of the last part. */
static sb_result sbi_substeps_run(sb_body *b, sb_real dt, sb_step_info *sum)
{
    int length = sbi_substeps_shorten(b, SBI_SUBSTEPS_MOST), parts = 0;
    for (int left = SBI_SUBSTEPS_MOST; left > 0;) { /* in the shortest parts, as length */
        sb_real part = (sb_real)length / (sb_real)left, share = (sb_real)length / (sb_real)SBI_SUBSTEPS_MOST;
        sb_step_info info;
        sb_result result;
        b->touch->share = share;
        b->touch->is_last = length == 1;
        result = sbi_step_whole(b, dt * share, NULL, 0, part, 0, &info);
        sbi_substeps_count(&info, sum);
        *sum = info;
        sum->substeps = result == SB_OK ? ++parts : parts;
        if (result != SB_OK && length == 1)
            return result;
        if (result == SB_OK)
            left -= length;
        else
            length = sbi_substeps_shorten(b, length);
    }
    return SB_OK;
}

/* A step failed that may succeed in parts. *info: of the whole step. */
static sb_result sbi_substeps_divide(sb_body *b, sb_real dt, sb_result result, sb_step_info *info)
{
    size_t snapshot = sbi_body_snapshot_size(b);
    sb_step_info sum = *info;
    if (sbi_body_reserve_substeps(b, NULL) != SB_OK)
        return result;
    sbi_substeps_keep(b);
    if (sbi_substeps_run(b, dt, &sum) == SB_OK) {
        *info = sum;
        return SB_OK;
    }
    sbi_substeps_rewind(b, snapshot);
    sum.error = info->error;
    sum.load_factor = info->load_factor;
    sum.substeps = 0;
    *info = sum;
    return result;
}

/* ---- a step ---- */

SBI_API sb_result sbi_body_step_part(sb_body *b, sb_real dt, const sbi_guest *const *guests, int guest_count,
                                     const sbi_step_part *part, sb_step_info *info)
{
    sb_real begin = part->begin, end = part->end, left = end < 1 ? (end - begin) / (1 - begin) : 1;
    sbi_touch *touch = b ? b->touch : NULL;
    sb_result result;
    if (!touch)
        return sbi_step_whole(b, dt, guests, guest_count, left, part->patience, info);
    touch->mended = begin > 0 && touch->mended;
    touch->share = end - begin;
    touch->steady = begin > 0 || end < 1;
    result = sbi_step_whole(b, dt, guests, guest_count, left, part->patience, info);
    touch->share = 1;
    touch->steady = 0;
    return result;
}

static sb_result sbi_substeps_step(sb_body *body, sb_real dt, sb_step_info *info)
{
    double begun = sbi_body_now(body);
    sb_result result;
    body->touch->refused = body->touch->is_last = body->touch->mended = 0;
    sbi_body_mute(body);
    result = sbi_step_whole(body, dt, NULL, 0, 1, 0, info);
    if (result == SB_ERROR_DIVERGED && body->touch->refused)
        result = sbi_substeps_divide(body, dt, result, info);
    sbi_body_unmute(body);
    body->touch->share = 1;
    body->touch->is_last = 1;
    info->seconds_total = sbi_body_now(body) - begun;
    sbi_body_tell(body, SBI_COMMAND_STEP, (int)result, 0, NULL, 0, &dt, 1);
    return result;
}

SBI_API sb_result sbi_body_step_with(sb_body *body, sb_real dt, const sbi_guest *const *guests, int guest_count,
                                     sb_step_info *info)
{
    static const sbi_step_part whole = {0, 1, 0};
    sb_step_info own;
    if (!body || !body->touch || !sbi_body_is_implicit(body) || guest_count > 0 || !(dt > 0) || !sb_is_finite(dt))
        return sbi_body_step_part(body, dt, guests, guest_count, &whole, info);
    return sbi_substeps_step(body, dt, info ? info : &own);
}

SB_API sb_result sb_body_step(sb_body *body, sb_real dt, sb_step_info *info)
{
    return sbi_body_step_with(body, dt, NULL, 0, info);
}
