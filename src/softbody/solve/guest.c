/* guest: see guest.h. */
#include "guest.h"

#include <string.h>

/* ---- check and memory ---------------------------------------------------------------------------------- */

SBI_API int sbi_guests_have_sizes(const sbi_guests *guests, int rows)
{
    if (guests->count < 0 || (guests->count > 0 && !guests->list))
        return 0;
    for (int g = 0; g < guests->count; g++) {
        const sbi_guest *guest = guests->list[g];
        if (!guest || guest->unknown_count < 0 || guest->node_count < 0 || guest->node_count > rows ||
            guest->taken_count < 0 || guest->taken_count > guest->node_count)
            return 0;
    }
    return 1;
}

/* Marks of a node: 2 (index + 1) of the last guest that names it, and 1 once it is taken. */
static sb_result sbi_guest_check(const sbi_guest *guest, int index, int rows, int *marks, sb_error *error)
{
    int own = guest->unknown_count > 0 || guest->taken_count > 0;
    if ((!guest->residual && !guest->is_tangent) || (guest->is_tangent && own) || !guest->multiply ||
        (own && !guest->precondition) || (guest->unknown_count > 0 && !guest->unknown) ||
        (guest->node_count > 0 && !guest->nodes))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "guest %d lacks a call or an array", index);
    for (int k = 0; k < guest->node_count; k++) {
        int node = guest->nodes[k], taken = k < guest->taken_count;
        if (node < 0 || node >= rows)
            return sbi_fail_node(error, SB_ERROR_INDEX, node, "guest %d names node %d of %d", index, node, rows);
        if (marks[node] / 2 == index + 1)
            return sbi_fail_node(error, SB_ERROR_INDEX, node, "guest %d names node %d twice", index, node);
        if (taken && marks[node] % 2 == 1)
            return sbi_fail_node(error, SB_ERROR_INDEX, node, "guest %d takes node %d, which another one has", index,
                                 node);
        marks[node] = 2 * (index + 1) + (taken || marks[node] % 2 == 1);
    }
    return SB_OK;
}

SBI_API sb_result sbi_guests_check(const sbi_guests *guests, int rows, int *marks, sb_error *error)
{
    sb_result result = SB_OK;
    memset(marks, 0, (size_t)rows * sizeof(int));
    for (int g = 0; g < guests->count && result == SB_OK; g++)
        result = sbi_guest_check(guests->list[g], g, rows, marks, error);
    return result;
}

SBI_API void sbi_guest_space_layout(sbi_guest_space *space, const sbi_guests *guests, const sb_matrix *matrix,
                                    sbi_arena *arena)
{
    size_t rows = (size_t)matrix->row_count, taken = 0;
    sbi_guest_work *list = (sbi_guest_work *)sbi_arena_take(arena, (size_t)guests->count, sizeof *list);
    space->count = guests->count;
    space->work = list;
    space->rest = (sb_real *)sbi_arena_take(arena, 3 * rows, sizeof(sb_real));
    space->spare = (sb_real *)sbi_arena_take(arena, 3 * rows, sizeof(sb_real));
    for (int g = 0; g < guests->count; g++) {
        sbi_guest_work work;
        size_t unknowns = (size_t)guests->list[g]->unknown_count;
        double **sized[] = {&work.residual, &work.block, &work.correction, &work.product};
        memset(&work, 0, sizeof work);
        work.guest = guests->list[g];
        work.size = unknowns + 3 * (size_t)work.guest->taken_count;
        work.width = unknowns + 3 * (size_t)work.guest->node_count;
        for (size_t k = 0; k < sizeof sized / sizeof *sized; k++)
            *sized[k] = (double *)sbi_arena_take(arena, work.size, sizeof(double));
        work.search = (double *)sbi_arena_take(arena, unknowns, sizeof(double));
        work.start = (double *)sbi_arena_take(arena, unknowns, sizeof(double));
        work.in = (double *)sbi_arena_take(arena, work.width, sizeof(double));
        work.out = (double *)sbi_arena_take(arena, work.width, sizeof(double));
        work.base = (double *)sbi_arena_take(arena, work.width, sizeof(double));
        work.first = (double *)sbi_arena_take(arena, unknowns, sizeof(double));
        if (arena->base) {
            list[g] = work;
            memset(work.base, 0, work.width * sizeof(double));
        }
        taken += (size_t)work.guest->taken_count;
    }
    space->kept_room = sbi_guests_taken_blocks(guests, matrix);
    space->kept = (sb_real(*)[9])sbi_arena_take(arena, space->kept_room, sizeof *space->kept);
    space->kept_fixed = (unsigned char *)sbi_arena_take(arena, taken, 1);
}

/* ---- compact vectors ----------------------------------------------------------------------------------- */

static int sbi_guest_is_held(const sbi_guest_space *space, int node, int axis)
{
    return space->matrix->fixed[node] >> axis & 1;
}

/* in = own (NULL: 0), and of x (NULL: 0) the components of its nodes; prescribed ones are those of `held`, or 0. */
static void sbi_guest_gather(const sbi_guest_space *space, sbi_guest_work *work, const double *own, const sb_real *x,
                             const sb_real *held)
{
    const sbi_guest *guest = work->guest;
    double *in = work->in;
    for (int k = 0; k < guest->unknown_count; k++)
        *in++ = own ? own[k] : 0;
    for (int k = 0; k < guest->node_count; k++)
        for (int axis = 0; axis < 3; axis++) {
            const sb_real *from = sbi_guest_is_held(space, guest->nodes[k], axis) ? held : x;
            *in++ = from ? (double)from[3 * (size_t)guest->nodes[k] + (size_t)axis] : 0;
        }
}

/* in = the guest's place: unknowns `own`, nodes x further than the base. */
static void sbi_guest_gather_place(const sbi_guest_space *space, sbi_guest_work *work, const double *own,
                                   const sb_real *x, const sb_real *held)
{
    sbi_guest_gather(space, work, own, x, held);
    for (size_t k = (size_t)work->guest->unknown_count; k < work->width; k++)
        work->in[k] += work->base[k];
}

/* y += sign out on its nodes, but for prescribed components. */
static void sbi_guest_scatter(const sbi_guest_space *space, const sbi_guest_work *work, double sign, sb_real *y)
{
    const sbi_guest *guest = work->guest;
    const double *out = work->out + guest->unknown_count;
    for (int k = 0; k < guest->node_count; k++)
        for (int axis = 0; axis < 3; axis++, out++)
            if (!sbi_guest_is_held(space, guest->nodes[k], axis))
                y[3 * (size_t)guest->nodes[k] + (size_t)axis] += (sb_real)(sign * *out);
}

/* to[taken] (+)= y there, which becomes 0. */
static void sbi_guest_take(const sbi_guest_work *work, sb_real *y, double *to, int add)
{
    to += work->guest->unknown_count;
    for (int k = 0; k < work->guest->taken_count; k++)
        for (size_t axis = 0; axis < 3; axis++, to++) {
            sb_real *from = y + 3 * (size_t)work->guest->nodes[k] + axis;
            *to = (add ? *to : 0) + (double)*from;
            *from = 0;
        }
}

/* The same of rows that are complete then. */
static void sbi_guest_take_rows(const sbi_guest_work *work, sb_real *y, double *to, int add)
{
    sbi_guest_take(work, y, to, add);
    if (work->guest->condense)
        work->guest->condense(work->guest->user, to);
}

/* y[taken] = from there. */
static void sbi_guest_put(const sbi_guest_work *work, const double *from, sb_real *y)
{
    from += work->guest->unknown_count;
    for (int k = 0; k < work->guest->taken_count; k++)
        for (size_t axis = 0; axis < 3; axis++)
            y[3 * (size_t)work->guest->nodes[k] + axis] = (sb_real)*from++;
}

static void sbi_guest_copy(double *to, const double *from, int count)
{
    for (int k = 0; k < count; k++)
        to[k] = from[k];
}

static double sbi_guest_dot(const double *a, const double *b, size_t count)
{
    double sum = 0;
    for (size_t k = 0; k < count; k++)
        sum += a[k] * b[k];
    return sum;
}

/* ---- parts of the solve -------------------------------------------------------------------------------- */

SBI_API void sbi_guest_hold(sbi_guest_space *space, const sb_real *rhs, sb_real *x)
{
    const sb_matrix *a = space->matrix;
    for (int g = 0; g < space->count; g++)
        for (int k = 0; k < space->work[g].guest->node_count; k++) {
            int node = space->work[g].guest->nodes[k];
            for (int axis = 0; axis < 3; axis++) {
                size_t at = 3 * (size_t)node + (size_t)axis;
                if (sbi_guest_is_held(space, node, axis))
                    x[at] = rhs[at] / a->blocks[a->diagonal[node]][4 * axis];
            }
        }
}

/* r -= G x of a guest that is a tangent alone. Prescribed motion is in the forces already. */
static void sbi_guest_tangent_residual(const sbi_guest_space *space, sbi_guest_work *work, const sb_real *x, sb_real *r)
{
    if (!x)
        return;
    sbi_guest_gather(space, work, NULL, x, NULL);
    work->guest->multiply(work->guest->user, work->in, work->out);
    sbi_guest_scatter(space, work, -1, r);
}

SBI_API void sbi_guest_residual(sbi_guest_space *space, const sb_real *x, const sb_real *held, sb_real *r)
{
    for (int g = 0; g < space->count; g++) {
        sbi_guest_work *work = space->work + g;
        const sbi_guest *guest = work->guest;
        if (guest->is_tangent) {
            sbi_guest_tangent_residual(space, work, x, r);
            continue;
        }
        sbi_guest_gather_place(space, work, x ? guest->unknown : work->base, x, held);
        guest->residual(guest->user, work->in, work->out);
        sbi_guest_copy(work->residual, work->out, guest->unknown_count);
        for (int k = 0; k < guest->node_count; k++)
            for (int axis = 0; axis < 3; axis++)
                if (sbi_guest_is_held(space, guest->nodes[k], axis)) /* but for rounding it is 0 */
                    r[3 * (size_t)guest->nodes[k] + (size_t)axis] = 0;
        sbi_guest_scatter(space, work, 1, r);
    }
    for (int g = 0; g < space->count; g++)
        sbi_guest_take_rows(space->work + g, r, space->work[g].residual, 0);
}

SBI_API void sbi_guest_multiply(sbi_guest_space *space, const sb_real *p, sb_real *q)
{
    for (int g = 0; g < space->count; g++) {
        sbi_guest_work *work = space->work + g;
        const sbi_guest *guest = work->guest;
        work->sums[0] = 0;
        if (work->done)
            continue;
        sbi_guest_gather(space, work, work->search, p, NULL);
        guest->multiply(guest->user, work->in, work->out);
        sbi_guest_copy(work->product, work->out, guest->unknown_count);
        work->sums[0] = sbi_guest_dot(work->in, work->out, work->width);
        sbi_guest_scatter(space, work, 1, q);
    }
    for (int g = 0; g < space->count; g++)
        if (!space->work[g].done)
            sbi_guest_take_rows(space->work + g, q, space->work[g].product, 0);
}

/* z = the block's solution for r; prescribed components of taken nodes are 0 in both. */
static void sbi_guest_solve_block(const sbi_guest_space *space, const sbi_guest_work *work, const double *r, double *z)
{
    const sbi_guest *guest = work->guest;
    if (work->size == 0)
        return;
    guest->precondition(guest->user, r, z);
    for (int k = 0; k < 3 * guest->taken_count; k++)
        if (sbi_guest_is_held(space, guest->nodes[k / 3], k % 3))
            z[guest->unknown_count + k] = 0;
}

SBI_API void sbi_guest_measure(sbi_guest_space *space)
{
    for (int g = 0; g < space->count; g++) {
        sbi_guest_work *work = space->work + g;
        if (work->done)
            continue;
        sbi_guest_solve_block(space, work, work->residual, work->block);
        work->sums[0] = space->scale * sbi_guest_dot(work->residual, work->block, work->size);
    }
}

/* y -= A v, v [size] on taken nodes and 0 elsewhere; A is symmetric. */
static void sbi_guest_subtract_columns(const sbi_guest_space *space, const sbi_guest_work *work, const double *v,
                                       sb_real *y)
{
    const sb_matrix *a = space->matrix;
    v += work->guest->unknown_count;
    for (int k = 0; k < work->guest->taken_count; k++, v += 3) {
        int node = work->guest->nodes[k];
        sb_real x = (sb_real)v[0], y0 = (sb_real)v[1], z = (sb_real)v[2];
        for (int e = a->row_start[node]; e < a->row_end[node]; e++) {
            const sb_real *block = a->blocks[e];
            sb_real *to = y + 3 * (size_t)a->columns[e];
            for (int c = 0; c < 3; c++)
                to[c] -= block[c] * x + block[3 + c] * y0 + block[6 + c] * z;
        }
    }
}

/* v = block on taken nodes, 0 on the other nodes of guests; y -= (A + G) (v, block), unknowns' rows in out. Or (others)
 * only rows of nodes that are not taken. */
static void sbi_guest_subtract_block(sbi_guest_space *space, sb_real *v, sb_real *y, int others)
{
    for (int g = 0; g < space->count; g++)
        for (int k = 0; k < space->work[g].guest->node_count; k++)
            memset(v + 3 * (size_t)space->work[g].guest->nodes[k], 0, 3 * sizeof(sb_real));
    for (int g = 0; g < space->count; g++)
        if (!space->work[g].done)
            sbi_guest_put(space->work + g, space->work[g].block, v);
    for (int g = 0; g < space->count; g++) {
        sbi_guest_work *work = space->work + g;
        if (work->done || work->size == 0)
            continue;
        sbi_guest_subtract_columns(space, work, work->block, y);
    }
    for (int g = 0; g < space->count; g++) {
        sbi_guest_work *work = space->work + g;
        if (work->done || (others && work->guest->node_count == work->guest->taken_count))
            continue;
        sbi_guest_gather(space, work, work->block, v, NULL);
        work->guest->multiply(work->guest->user, work->in, work->out);
        sbi_guest_scatter(space, work, -1, y);
    }
}

SBI_API void sbi_guest_guess(sbi_guest_space *space, sb_real *x, sb_real *r, sb_real *v)
{
    sbi_guest_subtract_block(space, v, r, 0);
    for (int g = 0; g < space->count; g++) {
        sbi_guest_work *work = space->work + g;
        const sbi_guest *guest = work->guest;
        for (int k = 0; k < guest->unknown_count; k++) {
            work->residual[k] -= work->out[k];
            if (x)
                guest->unknown[k] += work->block[k];
        }
        for (int k = 0; x && k < 3 * guest->taken_count; k++)
            x[3 * (size_t)guest->nodes[k / 3] + (size_t)(k % 3)] += (sb_real)work->block[guest->unknown_count + k];
        sbi_guest_take_rows(work, r, work->residual, 1);
    }
}

SBI_API void sbi_guest_keep_start(sbi_guest_work *work)
{
    for (int k = 0; k < work->guest->unknown_count; k++)
        work->start[k] = work->guest->unknown[k];
}

SBI_API void sbi_guest_go_back(sbi_guest_work *work)
{
    for (int k = 0; k < work->guest->unknown_count; k++)
        work->guest->unknown[k] = work->start[k];
}

SBI_API void sbi_guest_advance(sbi_guest_work *work, double factor)
{
    for (int k = 0; k < work->guest->unknown_count; k++)
        work->guest->unknown[k] += factor * work->search[k];
    for (size_t k = 0; k < work->size; k++)
        work->residual[k] -= factor * work->product[k];
}

SBI_API void sbi_guest_direct(sbi_guest_work *work, double factor, int fresh)
{
    for (int k = 0; k < work->guest->unknown_count; k++)
        work->search[k] = work->correction[k] + (fresh ? 0 : factor * work->search[k]);
}

SBI_API void sbi_guest_dots(sbi_guest_work *work, int fresh)
{
    work->sums[0] = sbi_guest_dot(work->residual, work->correction, work->size);
    work->sums[1] = fresh ? 0 : sbi_guest_dot(work->product, work->correction, work->size);
}

SBI_API void sbi_guest_add_taken(const sbi_guest_work *work, double sum[3])
{
    for (int k = 0; k < 3 * work->guest->taken_count; k++)
        sum[k % 3] += work->residual[work->guest->unknown_count + k];
    for (int k = 0; work->guest->moves_taken && k < 3; k++)
        sum[k] += work->residual[k];
}

/* Taken nodes of x go where unknowns put them. */
static void sbi_guest_place_taken(const sbi_guest_space *space, const sbi_guest_work *work, sb_real *x)
{
    const sbi_guest *guest = work->guest;
    double *way = work->out + guest->unknown_count, *base = work->base + guest->unknown_count;
    guest->place(guest->user, guest->unknown, way);
    for (int k = 0; k < 3 * guest->taken_count; k++)
        if (!sbi_guest_is_held(space, guest->nodes[k / 3], k % 3))
            x[3 * (size_t)guest->nodes[k / 3] + (size_t)(k % 3)] = (sb_real)(way[k] - base[k]);
}

SBI_API int sbi_guest_settle(sbi_guest_space *space, sb_real *x)
{
    int changed = 0;
    for (int g = 0; g < space->count; g++) {
        sbi_guest_work *work = space->work + g;
        int own;
        if (!work->guest->settle)
            continue;
        sbi_guest_gather_place(space, work, work->guest->unknown, x, x);
        own = work->guest->settle(work->guest->user, work->in);
        if (own == 1 && work->guest->place)
            sbi_guest_place_taken(space, work, x);
        changed |= own != 0;
    }
    space->rows_changed |= changed;
    return changed;
}

/* ---- steps of several solves ---------------------------------------------------------------------------- */

SBI_API void sbi_guest_move_base(sbi_guest_space *space, const sb_real *x, double share, double held)
{
    for (int g = 0; g < space->count; g++) {
        const sbi_guest_work *work = space->work + g;
        const sbi_guest *guest = work->guest;
        double *base = work->base;
        for (int k = 0; k < guest->unknown_count; k++, base++) {
            *base = share == 1 ? guest->unknown[k] : *base + share * (guest->unknown[k] - *base);
            guest->unknown[k] = *base;
        }
        for (int k = 0; k < guest->node_count; k++)
            for (int axis = 0; axis < 3; axis++, base++)
                *base += (sbi_guest_is_held(space, guest->nodes[k], axis) ? held : share) *
                         (double)x[3 * (size_t)guest->nodes[k] + (size_t)axis];
    }
}

SBI_API void sbi_guest_force(sbi_guest_work *work) { work->guest->residual(work->guest->user, work->base, work->out); }

SBI_API void sbi_guest_line(sbi_guest_space *space, const sb_real *x, double *linear, double *quadratic)
{
    *linear = *quadratic = 0;
    for (int g = 0; g < space->count; g++) {
        sbi_guest_work *work = space->work + g;
        const sbi_guest *guest = work->guest;
        if (guest->is_tangent) /* the line is that of the forces it stands for */
            continue;
        sbi_guest_force(work);
        sbi_guest_gather(space, work, guest->unknown, x, NULL);
        for (int k = 0; k < guest->unknown_count; k++)
            work->in[k] -= work->base[k];
        *linear -= sbi_guest_dot(work->in, work->out, work->width);
        guest->multiply(guest->user, work->in, work->out);
        *quadratic += sbi_guest_dot(work->in, work->out, work->width) / 2;
    }
}

/* ---- the preconditioner --------------------------------------------------------------------------------- */

/* z = B r of the nodes; without a preconditioner r over the mean diagonal. */
static void sbi_guest_apply(sbi_guest_space *space, sb_preconditioner *preconditioner, const sb_real *r, sb_real *z,
                            double size)
{
    if (preconditioner)
        sbi_precond_apply_symmetric(preconditioner, r, z, size, space->spare);
    else
        for (size_t k = 0; k < 3 * (size_t)space->matrix->row_count; k++)
            z[k] = r[k] / (sb_real)space->scale;
}

/* y = 0 on taken nodes. */
static void sbi_guest_clear_taken(const sbi_guest_space *space, sb_real *y)
{
    for (int g = 0; g < space->count; g++)
        for (int k = 0; k < space->work[g].guest->taken_count; k++)
            memset(y + 3 * (size_t)space->work[g].guest->nodes[k], 0, 3 * sizeof(sb_real));
}

/* The guests' rows of (A + G) z, z being 0 on taken nodes: of unknowns in out, of taken nodes in y, whose other rows
 * are scratch. */
static void sbi_guest_multiply_rows(sbi_guest_space *space, const sb_real *z, sb_real *y)
{
    for (int g = 0; g < space->count; g++)
        for (int k = 0; k < space->work[g].guest->taken_count; k++) {
            int node = space->work[g].guest->nodes[k];
            sbi_matrix_multiply_rows(space->matrix, z, y, node, node + 1);
        }
    for (int g = 0; g < space->count; g++) {
        sbi_guest_work *work = space->work + g;
        if (work->done)
            continue;
        sbi_guest_gather(space, work, NULL, z, NULL);
        work->guest->multiply(work->guest->user, work->in, work->out);
        sbi_guest_scatter(space, work, 1, y);
    }
}

/* correction = D^-1 (residual - T z), z being 0 on taken nodes; y: scratch */
static void sbi_guest_correct(sbi_guest_space *space, const sb_real *z, sb_real *y)
{
    sbi_guest_multiply_rows(space, z, y);
    for (int g = 0; g < space->count; g++) {
        sbi_guest_work *work = space->work + g;
        if (work->done || work->size == 0)
            continue;
        sbi_guest_copy(work->in, work->out, work->guest->unknown_count);
        sbi_guest_take_rows(work, y, work->in, 0);
        sbi_guest_solve_block(space, work, work->in, work->out);
        for (size_t k = 0; k < work->size; k++)
            work->correction[k] = work->block[k] - work->out[k];
    }
}

/* z += Q (r - T (z, correction)) where z = S of something was the preconditioner's last result; y: scratch */
static void sbi_guest_correct_coarsely(sbi_guest_space *space, sb_preconditioner *preconditioner, const sb_real *r,
                                       sb_real *z, double size, sb_real *y)
{
    memcpy(y, r, 3 * (size_t)space->matrix->row_count * sizeof(sb_real));
    for (int g = 0; g < space->count; g++)
        if (!space->work[g].done && space->work[g].size > 0)
            sbi_guest_subtract_columns(space, space->work + g, space->work[g].correction, y);
    sbi_guest_clear_taken(space, y);
    sbi_precond_apply_coarse(preconditioner, y, z, size);
}

SBI_API int sbi_guest_is_deflated(const sbi_guest_space *space, const sb_preconditioner *preconditioner)
{
    for (int g = 0; g < space->count; g++)
        if (space->work[g].guest->taken_count < space->work[g].guest->node_count)
            return 0;
    return preconditioner && sbi_precond_has_coarse(preconditioner);
}

/* 1: a guest has unknowns or has taken nodes. */
static int sbi_guest_have_rows(const sbi_guest_space *space)
{
    for (int g = 0; g < space->count; g++)
        if (space->work[g].size > 0)
            return 1;
    return 0;
}

/* With D the guests' own blocks, B the preconditioner on all other rows and T = A + G:
 *     M^-1 = D^-1 + (I - D^-1 T) B (I - T D^-1)
 * which is symmetric and positive definite whatever D and B are, as long as each is. Where D is exact the search stays
 * in what the blocks leave. Measured with a rod a million times stiffer than the tissue, 2,783 nodes to 1e-4, IC0 with
 * a coarse space, B made with taken nodes held: 13 or 14 iterations for 18 without the rod; with D^-1 + B alone 12 on
 * nodes of the mesh, but 21 through weights; with B made of A as it is 35 to 38, and 35 to 51.
 *
 * Where residuals are deflated, B is the smoother S alone, and the coarse space is visited once, last and for all
 * equations: z = M^-1 r + Q (r - T M^-1 r), A-DEF2 of M and T. Q moves no taken nodes, so that the matrix's own Z^T A Z
 * and A Z serve. As many iterations as with B = S and Q symmetric, a tenth less time each. */
SBI_API void sbi_guest_precondition(sbi_guest_space *space, sb_preconditioner *preconditioner, const sb_real *r,
                                    sb_real *z, double size)
{
    int deflated = sbi_guest_is_deflated(space, preconditioner);
    if (!sbi_guest_have_rows(space)) {
        sbi_guest_apply(space, preconditioner, r, z, size);
        return;
    }
    memcpy(space->rest, r, 3 * (size_t)space->matrix->row_count * sizeof(sb_real));
    sbi_guest_subtract_block(space, z, space->rest, 1);
    sbi_guest_clear_taken(space, space->rest);
    if (deflated)
        sbi_precond_apply_smoother(preconditioner, space->rest, z, size);
    else
        sbi_guest_apply(space, preconditioner, space->rest, z, size);
    sbi_guest_clear_taken(space, z);
    sbi_guest_correct(space, z, space->rest);
    if (deflated)
        sbi_guest_correct_coarsely(space, preconditioner, r, z, size, space->rest);
    for (int g = 0; g < space->count; g++)
        if (!space->work[g].done && space->work[g].size > 0)
            sbi_guest_put(space->work + g, space->work[g].correction, z);
}

/* ---- taken nodes out of the preconditioner --------------------------------------------------------------- */

SBI_API size_t sbi_guests_taken_blocks(const sbi_guests *guests, const sb_matrix *matrix)
{
    size_t blocks = 0;
    for (int g = 0; g < guests->count; g++)
        for (int k = 0; k < guests->list[g]->taken_count; k++) {
            int node = guests->list[g]->nodes[k];
            if (node >= 0 && node < matrix->row_count)
                blocks += 2 * (size_t)(matrix->row_end[node] - matrix->row_start[node]);
        }
    return blocks;
}

SBI_API void sbi_guest_remove_taken(sbi_guest_space *space, sb_matrix *matrix)
{
    const sb_real scale = sbi_matrix_diagonal_scale(matrix, matrix->fixed, NULL);
    size_t at = 0, nodes = 0;
    for (int g = 0; g < space->count; g++)
        for (int k = 0; k < space->work[g].guest->taken_count; k++) {
            int node = space->work[g].guest->nodes[k];
            space->kept_fixed[nodes++] = matrix->fixed[node];
            matrix->fixed[node] = SB_XYZ;
            for (int q = matrix->row_start[node]; q < matrix->row_end[node]; q++) {
                memcpy(space->kept[at++], matrix->blocks[q], sizeof *matrix->blocks);
                memcpy(space->kept[at++], matrix->blocks[matrix->transpose[q]], sizeof *matrix->blocks);
                memset(matrix->blocks[matrix->transpose[q]], 0, sizeof *matrix->blocks);
                memset(matrix->blocks[q], 0, sizeof *matrix->blocks);
            }
            for (int axis = 0; axis < 3; axis++)
                matrix->blocks[matrix->diagonal[node]][4 * axis] = scale;
        }
    space->kept_count = at;
}

/* From the last to the first: blocks between two taken nodes were kept twice. */
SBI_API void sbi_guest_restore_taken(sbi_guest_space *space, sb_matrix *matrix)
{
    size_t at = space->kept_count, nodes = 0;
    for (int g = 0; g < space->count; g++)
        nodes += (size_t)space->work[g].guest->taken_count;
    for (int g = space->count; g-- > 0;)
        for (int k = space->work[g].guest->taken_count; k-- > 0;) {
            int node = space->work[g].guest->nodes[k];
            matrix->fixed[node] = space->kept_fixed[--nodes];
            for (int q = matrix->row_end[node]; q-- > matrix->row_start[node];) {
                memcpy(matrix->blocks[matrix->transpose[q]], space->kept[--at], sizeof *matrix->blocks);
                memcpy(matrix->blocks[q], space->kept[--at], sizeof *matrix->blocks);
            }
        }
}
