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

/* ---- room: a snapshot, and behind it the targets of supports ---- */

static size_t sbi_substeps_aligned(size_t bytes) { return (bytes + 15) / 16 * 16; }

/* 0: more than there can be. */
static size_t sbi_substeps_size(const sb_body *b)
{
    size_t snapshot = sbi_body_snapshot_size(b), size = sbi_substeps_aligned(snapshot);
    return snapshot && sbi_size_add(&size, (size_t)b->domain.node_count, sizeof(sb_vec3)) ? size : 0;
}

SBI_API sb_result sbi_body_reserve_substeps(sb_body *b, sb_error *error)
{
    size_t needed = sbi_substeps_size(b);
    unsigned char *room;
    if (needed && needed <= b->substep_room_size)
        return SB_OK;
    if (b->substep_room && needed <= (size_t)-1 / 2) /* of a mesh that has grown: it may again */
        needed += needed / 2;
    room = needed ? (unsigned char *)sbi_alloc(&b->allocator, needed, 1) : NULL;
    if (!room)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for what a divided step gives back");
    sbi_free(&b->allocator, b->substep_room);
    b->substep_room = room;
    b->substep_room_size = needed;
    return SB_OK;
}

/* ---- a divided step ---- */

static void sbi_substeps_keep(sb_body *b, size_t snapshot)
{
    sbi_body_snapshot(b, b->substep_room);
    memcpy(b->substep_room + sbi_substeps_aligned(snapshot), b->target,
           (size_t)b->domain.node_count * sizeof *b->target);
    b->touch->keep(b->touch->user);
}

static void sbi_substeps_rewind(sb_body *b, size_t snapshot)
{
    (void)sbi_body_rewind(b, b->substep_room, snapshot, NULL); /* a step changes nothing that would need memory */
    b->touch->rewind(b->touch->user);
}

/* Supports go this share of what is left of their ways. */
static void sbi_substeps_aim(sb_body *b, const unsigned char *kept, sb_real part)
{
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 goal;
        memcpy(&goal, kept + (size_t)i * sizeof goal, sizeof goal);
        b->target[i] = part < 1 ? sb_v3_madd(b->displacement[i], part, sb_v3_sub(goal, b->displacement[i])) : goal;
    }
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
static sb_result sbi_substeps_run(sb_body *b, sb_real dt, size_t snapshot, sb_step_info *sum)
{
    const unsigned char *kept = b->substep_room + sbi_substeps_aligned(snapshot);
    int length = sbi_substeps_shorten(b, SBI_SUBSTEPS_MOST), parts = 0;
    for (int left = SBI_SUBSTEPS_MOST; left > 0;) { /* in the shortest parts, as length */
        sb_real part = (sb_real)length / (sb_real)left, share = (sb_real)length / (sb_real)SBI_SUBSTEPS_MOST;
        sb_step_info info;
        sb_result result;
        b->touch->share = share;
        b->touch->is_last = length == 1;
        sbi_substeps_aim(b, kept, part);
        result = sbi_step_whole(b, dt * share, NULL, 0, part, &info);
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
    sbi_substeps_keep(b, snapshot);
    if (sbi_substeps_run(b, dt, snapshot, &sum) == SB_OK) {
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

SBI_API sb_result sbi_body_step_with(sb_body *body, sb_real dt, const sbi_guest *const *guests, int guest_count,
                                     sb_step_info *info)
{
    sb_step_info own;
    sb_result result;
    double begun;
    if (!body || !body->touch || !sbi_body_is_implicit(body) || guest_count > 0 || !(dt > 0) || !sb_is_finite(dt))
        return sbi_step_whole(body, dt, guests, guest_count, 1, info);
    info = info ? info : &own;
    begun = sbi_body_now(body);
    body->touch->refused = body->touch->is_last = body->touch->mended = 0;
    sbi_body_mute(body);
    result = sbi_step_whole(body, dt, NULL, 0, 1, info);
    if (result == SB_ERROR_DIVERGED && body->touch->refused)
        result = sbi_substeps_divide(body, dt, result, info);
    sbi_body_unmute(body);
    body->touch->share = 1;
    body->touch->is_last = 1;
    info->seconds_total = sbi_body_now(body) - begun;
    sbi_body_tell(body, SBI_COMMAND_STEP, (int)result, 0, NULL, 0, &dt, 1);
    return result;
}

SB_API sb_result sb_body_step(sb_body *body, sb_real dt, sb_step_info *info)
{
    return sbi_body_step_with(body, dt, NULL, 0, info);
}
