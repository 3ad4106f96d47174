/* step_guest: guests of a step, see solve/guest.h: what is told to them, and what the iteration hears of them. Their
 * places are kept by conjugate gradients, from which a step of several solves counts on. */
#include <math.h>
#include <string.h>

#include "../solve/sparse_live.h"
#include "rigid_private.h"
#include "step_private.h"

/* ---- begin ---- */

static sbi_guest_space *sbi_step_guest_space(const sbi_step *step) { return sbi_pcg_guests(&step->body->pcg); }

/* Constraints eliminate an equation that a guest would need. */
static sb_result sbi_step_check_slaves(const sb_body *b, const sbi_guests *guests, sb_error *error)
{
    for (int g = 0; b->elimination && g < guests->count; g++)
        for (int k = 0; k < guests->list[g]->node_count; k++) {
            int node = guests->list[g]->nodes[k];
            if (b->elimination->slave[node])
                return sbi_fail_node(error, SB_ERROR_UNSUPPORTED, node,
                                     "node %d follows others by a constraint: a needle (guest %d of the step) cannot "
                                     "act on it",
                                     node, g);
        }
    return SB_OK;
}

/* The error of a node that two guests take, where one of them is a rigid body. */
static void sbi_step_name_hung(const sb_body *b, sb_error *error)
{
    const sbi_rigid *on = error->node >= 0 && b->rigids ? sbi_body_hung_on(b, error->node) : NULL;
    int node = error->node;
    if (on)
        sbi_fail_node(error, SB_ERROR_INDEX, node, "node %d hangs on rigid body %d: a needle cannot hold it, too", node,
                      on->id);
}

SBI_API sb_result sbi_step_take_guests(sbi_step *step, const sbi_guest *const *list, int count)
{
    sb_body *b = step->body;
    sbi_guests guests;
    sb_result result;
    guests.list = list;
    guests.count = count;
    if (count == 0)
        return SB_OK;
    result = sbi_pcg_reserve_guests(&b->pcg, b->elimination ? &b->elimination->matrix : &b->matrix, &guests,
                                    &step->info->error);
    if (result == SB_ERROR_INDEX)
        sbi_step_name_hung(b, &step->info->error);
    if (result == SB_OK)
        result = sbi_step_check_slaves(b, &guests, &step->info->error);
    if (result != SB_OK)
        return result;
    step->guests = guests;
    step->guests_left = 1;
    for (int g = 0; g < count; g++) {
        const sbi_guest_work *work = sbi_step_guest_space(step)->work + g;
        for (int k = 0; k < work->guest->unknown_count; k++)
            work->first[k] = work->guest->unknown[k];
    }
    return SB_OK;
}

/* 1: of a static solve; the search for accelerations has no time step either. */
static int sbi_step_is_static(const sbi_step *step) { return !step->dynamic && !step->starts; }

static sbi_guest_step sbi_step_tell_guests(const sbi_step *step, const sb_matrix *matrix)
{
    const sb_body *b = step->body;
    sbi_guest_step told;
    memset(&told, 0, sizeof told);
    told.matrix = matrix;
    told.displacement = b->start;
    told.velocity = b->velocity;
    told.acceleration = b->acceleration;
    told.velocity0 = b->velocity0;
    told.acceleration0 = b->acceleration0;
    told.present = b->displacement;
    told.iteration = step->iteration;
    told.starts = step->starts;
    told.dt = (double)step->dt;
    told.velocity_factor = (double)step->cv;
    told.acceleration_factor = (double)step->ca;
    for (int k = 0; k < 2; k++) {
        told.known_velocity[k] = (double)step->known_velocity[k];
        told.known_acceleration[k] = (double)step->known_acceleration[k];
    }
    told.level = (double)step->level;
    told.inertia_level = (double)step->inertia_level;
    if (sbi_step_is_static(step) && step->kind != SB_TANGENT_QUASI)
        told.left = b->elimination ? b->elimination->reduced : b->residual;
    told.is_exact = step->kind == SB_TANGENT_EXACT;
    return told;
}

/* Unknowns as an iteration begins with them. */
static void sbi_step_set_unknowns(const sbi_guest_work *work, const double *from)
{
    for (int k = 0; k < work->guest->unknown_count; k++)
        work->guest->unknown[k] = from[k];
}

/* out of a guest = unknowns a share of the way that the last solve found, and where they put its taken nodes. */
static void sbi_step_place_guest(const sbi_guest_work *work, double share)
{
    const sbi_guest *guest = work->guest;
    for (int k = 0; k < guest->unknown_count; k++)
        work->out[k] = work->base[k] + share * (guest->unknown[k] - work->base[k]);
    guest->place(guest->user, work->out, work->out + guest->unknown_count);
}

static sb_vec3 sbi_step_way_of(const sb_body *b, int node, const double way[3])
{
    sb_vec3 start = b->start[node];
    return sb_v3((sb_real)((double)start.x + way[0]), (sb_real)((double)start.y + way[1]),
                 (sb_real)((double)start.z + way[2]));
}

SBI_API void sbi_step_place_nodes(const sbi_step *step, double share, sb_vec3 *displacement)
{
    for (int g = 0; step->guests_begun && g < step->guests.count; g++) {
        const sbi_guest_work *work = sbi_step_guest_space(step)->work + g;
        const double *way = work->out + work->guest->unknown_count;
        if (!work->guest->place)
            continue;
        sbi_step_place_guest(work, share);
        for (int k = 0; k < work->guest->taken_count; k++, way += 3)
            displacement[work->guest->nodes[k]] = sbi_step_way_of(step->body, work->guest->nodes[k], way);
    }
}

/* Increments of nodes begin with what goes to where unknowns put them. */
static void sbi_step_place_increments(const sbi_step *step)
{
    const sb_body *b = step->body;
    for (int g = 0; g < step->guests.count; g++) {
        const sbi_guest_work *work = sbi_step_guest_space(step)->work + g;
        const double *way = work->out + work->guest->unknown_count, *base = work->base + work->guest->unknown_count;
        if (!work->guest->place)
            continue;
        sbi_step_place_guest(work, 1);
        for (int k = 0; k < work->guest->taken_count; k++, way += 3, base += 3)
            b->increment[work->guest->nodes[k]] =
                sb_v3((sb_real)(way[0] - base[0]), (sb_real)(way[1] - base[1]), (sb_real)(way[2] - base[2]));
    }
}

/* The base has moved: nodes have gone to where unknowns put them, and rows follow. */
static void sbi_step_renew_guests(const sbi_step *step)
{
    for (int g = 0; g < step->guests.count; g++) {
        const sbi_guest_work *work = sbi_step_guest_space(step)->work + g;
        const sbi_guest *guest = work->guest;
        if (guest->place)
            guest->place(guest->user, work->base, work->base + guest->unknown_count);
        if (guest->renew && !step->linearised)
            guest->renew(guest->user, work->base);
    }
}

/* The base of an increment is where the guest is: its unknowns count from there, its nodes from the start. */
static void sbi_step_begin_base(const sbi_guest_work *work)
{
    const sbi_guest *guest = work->guest;
    for (int k = 0; k < guest->unknown_count; k++)
        work->base[k] = work->first[k];
    guest->place(guest->user, work->base, work->base + guest->unknown_count);
}

SBI_API sb_result sbi_step_begin_guests(sbi_step *step, sb_matrix *matrix)
{
    sbi_guest_space *space = sbi_step_guest_space(step);
    sbi_guest_step told;
    if (step->guests.count == 0)
        return SB_OK;
    told = sbi_step_tell_guests(step, matrix);
    space->matrix = matrix;
    for (int g = 0; g < step->guests.count; g++) {
        const sbi_guest_work *work = space->work + g;
        sb_error *error = &step->info->error;
        sb_result result;
        sbi_step_set_unknowns(work, step->iteration > 0 ? work->base : work->first);
        step->guests_begun = sbi_max_int(step->guests_begun, g + 1);
        result = work->guest->begin ? work->guest->begin(work->guest->user, &told, error) : SB_OK;
        if (result != SB_OK)
            return error->result == result ? result : sbi_fail(error, result, "guest %d cannot begin a step", g);
        if (sbi_step_is_static(step) && step->iteration == 0 && work->guest->place) /* of any increment */
            sbi_step_begin_base(work);
    }
    sbi_step_place_increments(step);
    return SB_OK;
}

/* ---- residual ---- */

/* The part that a guest counts with: the one of the largest forces among those of its nodes; -1: it has no nodes. */
static int sbi_step_guest_part(const sbi_step *step, const sbi_guest_space *space, const sbi_guest *guest, int parts)
{
    int part = -1;
    if (parts == 1)
        return guest->node_count > 0 ? 0 : -1;
    for (int k = 0; k < guest->node_count; k++) {
        int other = space->part_of[guest->nodes[k]];
        if (part < 0 || step->body->part_scale[other] > step->body->part_scale[part])
            part = other;
    }
    return part;
}

SBI_API void sbi_step_guest_residual(sbi_step *step, const sb_matrix *parts)
{
    const sb_body *b = step->body;
    sbi_guest_space *space = sbi_step_guest_space(step);
    const sb_vec3 *residual = b->elimination ? b->elimination->reduced : b->residual;
    sb_vec3 *rest = (sb_vec3 *)(void *)space->rest;
    const sb_vec3 zero = sb_v3(0, 0, 0);
    for (int i = 0; i < b->domain.node_count; i++)
        rest[i] = sbi_body_pick_axes(sbi_body_held(b, i), zero, sb_v3_scale(-1, residual[i]));
    sbi_matrix_list_parts(parts);
    for (int c = 0; parts->part_count > 1 && c < parts->part_count; c++)
        for (int k = parts->part_start[c]; k < parts->part_start[c + 1]; k++)
            space->part_of[parts->part_rows[k]] = c;
    for (int g = 0; g < space->count; g++) {
        space->work[g].done = 0;
        space->work[g].part = sbi_step_guest_part(step, space, space->work[g].guest, parts->part_count);
    }
    sbi_guest_residual(space, NULL, NULL, space->rest);
    sbi_guest_measure(space);
}

SBI_API double sbi_step_guest_square(const sbi_step *step, int part)
{
    const sbi_guest_space *space = sbi_step_guest_space(step);
    double sum = 0;
    for (int g = 0; g < space->count; g++)
        if (space->work[g].part >= 0 && (part < 0 || space->work[g].part == part))
            sum += space->work[g].sums[0];
    return sum;
}

static int sbi_step_guest_is_in(const sbi_guest_work *work, int part) { return part < 0 || work->part == part; }

SBI_API sb_real sbi_step_guest_load(const sbi_step *step, int part)
{
    const sbi_guest_space *space = sbi_step_guest_space(step);
    double sum = 0;
    for (int g = 0; g < space->count; g++) {
        sbi_guest_work *work = space->work + g;
        if (work->size == 0 || !sbi_step_guest_is_in(work, part))
            continue;
        sbi_guest_force(work);
        work->guest->precondition(work->guest->user, work->out, work->in);
        for (int k = 0; k < work->guest->unknown_count; k++)
            sum += work->out[k] * work->in[k];
    }
    return (sb_real)sqrt(space->scale * sum);
}

SBI_API void sbi_step_precondition_guests(const sbi_step *step, sb_preconditioner *precond, const sb_vec3 *r,
                                          sb_vec3 *out)
{
    sbi_guest_precondition(sbi_step_guest_space(step), precond, &r[0].x, &out[0].x, (double)step->norm);
}

SBI_API double sbi_step_guest_energy(const sbi_step *step, int part)
{
    const sbi_guest_space *space = sbi_step_guest_space(step);
    double sum = 0;
    for (int g = 0; g < space->count; g++) {
        const sbi_guest_work *work = space->work + g;
        for (size_t k = 0; k < work->size && sbi_step_guest_is_in(work, part); k++)
            sum += work->residual[k] * work->correction[k];
    }
    return sum;
}

/* What rows of a guest without nodes are compared with: its loads. */
static double sbi_step_lone_scale(const sbi_guest_space *space, const sbi_guest_work *work)
{
    const sbi_guest *guest = work->guest;
    double sum = 0;
    memset(work->in, 0, work->width * sizeof(double));
    guest->residual(guest->user, work->in, work->out);
    guest->precondition(guest->user, work->out, work->block);
    for (size_t k = 0; k < work->size; k++)
        sum += work->out[k] * work->block[k];
    return sqrt(space->scale * sum);
}

SBI_API int sbi_step_lone_guests_meet(const sbi_step *step, sb_real rounding)
{
    const sbi_guest_space *space = sbi_step_guest_space(step);
    for (int g = 0; g < space->count; g++) {
        const sbi_guest_work *work = space->work + g;
        double norm = sqrt(work->sums[0]);
        if (work->part < 0 && work->size > 0 && !(norm <= (double)rounding) &&
            !(norm <= (double)step->tolerance * sbi_step_lone_scale(space, work)))
            return 0;
    }
    return 1;
}

/* ---- the increment is taken ---- */

SBI_API void sbi_step_move_guests(sbi_step *step, sb_real share, sb_real held)
{
    sbi_guest_space *space = sbi_step_guest_space(step);
    if (step->guests.count == 0)
        return;
    sbi_guest_move_base(space, &step->body->increment[0].x, (double)share, (double)held);
    sbi_step_renew_guests(step);
    step->guests_left = (space->rows_changed ? 1 : step->guests_left) * (1 - (double)share);
    space->rows_changed = 0;
}

/* What the last solve added to a guest's unknowns, and the way of its nodes: in. */
static void sbi_step_guest_way(const sbi_guest_work *work, const sb_vec3 *way)
{
    const sbi_guest *guest = work->guest;
    double *at = work->in + guest->unknown_count;
    for (int k = 0; k < guest->unknown_count; k++)
        work->in[k] = guest->unknown[k] - work->start[k];
    for (int k = 0; k < guest->node_count; k++, at += 3) {
        at[0] = (double)way[guest->nodes[k]].x;
        at[1] = (double)way[guest->nodes[k]].y;
        at[2] = (double)way[guest->nodes[k]].z;
    }
}

SBI_API double sbi_step_guest_rise(const sbi_step *step, const sb_vec3 *way)
{
    double sum = 0;
    for (int g = 0; g < step->guests.count; g++) {
        const sbi_guest_work *work = sbi_step_guest_space(step)->work + g;
        sbi_step_guest_way(work, way);
        work->guest->multiply(work->guest->user, work->in, work->out);
        for (size_t k = 0; k < work->width; k++)
            sum += work->in[k] * work->out[k];
    }
    return sum;
}

SBI_API void sbi_step_shorten_guests(const sbi_step *step, double share)
{
    for (int g = 0; g < step->guests.count; g++) {
        const sbi_guest_work *work = sbi_step_guest_space(step)->work + g;
        for (int k = 0; k < work->guest->unknown_count; k++)
            work->guest->unknown[k] = work->start[k] + share * (work->guest->unknown[k] - work->start[k]);
    }
}

SBI_API void sbi_step_guest_reactions(const sbi_step *step)
{
    sb_body *b = step->body;
    for (int g = 0; g < step->guests.count; g++) {
        sbi_guest_work *work = sbi_step_guest_space(step)->work + g;
        const double *force = work->out + work->guest->unknown_count;
        if (work->guest->is_tangent)
            continue;
        sbi_guest_force(work);
        for (int k = 0; k < work->guest->node_count; k++, force += 3) {
            int node = work->guest->nodes[k];
            sb_vec3 f = sb_v3((sb_real)force[0], (sb_real)force[1], (sb_real)force[2]);
            b->reaction[node] = sbi_body_pick_axes(b->fixed[node], sb_v3_sub(b->reaction[node], f), b->reaction[node]);
        }
    }
}

SBI_API void sbi_step_subtract_guests(const sbi_step *step, sb_vec3 *left)
{
    const sb_body *b = step->body;
    for (int g = 0; g < step->guests.count; g++) {
        sbi_guest_work *work = sbi_step_guest_space(step)->work + g;
        const sbi_guest *guest = work->guest;
        const double *force = work->out + guest->unknown_count;
        double sign = guest->is_tangent ? 1 : -1;
        if (guest->place || (guest->is_tangent && !step->linearised))
            continue;
        if (guest->is_tangent) {
            sbi_step_guest_way(work, b->increment);
            guest->multiply(guest->user, work->in, work->out);
        } else {
            sbi_guest_force(work);
        }
        for (int k = 0; k < guest->node_count; k++, force += 3) {
            sb_vec3 *to = left + guest->nodes[k];
            *to = sb_v3_madd(*to, (sb_real)sign, sb_v3((sb_real)force[0], (sb_real)force[1], (sb_real)force[2]));
        }
    }
}

/* ---- end ---- */

SBI_API void sbi_step_commit_guests(sbi_step *step)
{
    for (int g = 0; g < step->guests.count; g++) {
        const sbi_guest_work *work = sbi_step_guest_space(step)->work + g;
        if (work->guest->commit)
            work->guest->commit(work->guest->user, work->base);
    }
}

SBI_API void sbi_step_undo_guests(sbi_step *step)
{
    for (int g = step->guests_begun; g-- > 0;) {
        const sbi_guest_work *work = sbi_step_guest_space(step)->work + g;
        sbi_step_set_unknowns(work, work->first);
        memset(work->base, 0, work->width * sizeof(double));
        if (work->guest->undo)
            work->guest->undo(work->guest->user);
    }
    step->guests_begun = 0;
}
