/* cable_law: what one cable does at a shape of the body: length, tension, stiffness. */
#include "cable_law.h"

SBI_API void sbi_cable_layout(sbi_cable_lie *lie, size_t points, size_t entries, sbi_arena *arena)
{
    lie->way = (sb_vec3 *)sbi_arena_take(arena, points, sizeof(sb_vec3));
    lie->slope = (sb_vec3 *)sbi_arena_take(arena, points, sizeof(sb_vec3));
    lie->part = (sb_real *)sbi_arena_take(arena, points, sizeof(sb_real));
    lie->dofs = (int *)sbi_arena_take(arena, entries, 3 * sizeof(int));
    lie->shares = (sb_real *)sbi_arena_take(arena, entries, 3 * sizeof(sb_real));
}

SBI_API sb_result sbi_cable_check_law(const sbi_cable_law *law, int load_id, sb_error *error)
{
    if (!sb_is_finite(law->rest) || !sb_is_finite(law->stiffness) || !sb_is_finite(law->toe))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "rest length, stiffness or toe strain of cable %d is not finite",
                        load_id);
    if (!(law->rest > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cable %d has the rest length %g", load_id, (double)law->rest);
    if (law->stiffness < 0 || law->toe < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cable %d has a stiffness %g or toe strain %g below 0", load_id,
                        (double)law->stiffness, (double)law->toe);
    return SB_OK;
}

SBI_API int sbi_cable_point_is_in_space(const sbi_load *load, int point)
{
    int first = load->row_start[point];
    return load->row_start[point + 1] == first + 1 && load->weights[first] == 0;
}

SBI_API sb_vec3 sbi_cable_point(const sb_body *body, const sbi_load *load, int point, const sb_vec3 *u, sb_real factor)
{
    sb_vec3 from = load->balanced_target[point], to = load->target[point];
    if (!sbi_cable_point_is_in_space(load, point))
        return sb_v3_add(sbi_body_row_value(load, point, body->reference), sbi_body_row_value(load, point, u));
    return factor == 1 || !load->balanced ? to : sb_v3_madd(from, factor, sb_v3_sub(to, from));
}

/* What it is made of on the way from the last static solve to now. */
static sbi_cable_law sbi_cable_law_at(const sbi_load *load, sb_real factor)
{
    sbi_cable_law law = load->cable;
    if (factor == 1)
        return law;
    law.rest = load->balanced_cable.rest + factor * (load->cable.rest - load->balanced_cable.rest);
    law.stiffness = load->balanced_cable.stiffness + factor * (load->cable.stiffness - load->balanced_cable.stiffness);
    return law;
}

/* Tension, its rate and energy of a length. A cable that is just as long as at rest has its stiffness, so that it holds
 * what hangs on it from the first iteration on. */
static void sbi_cable_stretch(const sbi_cable_law *law, sbi_cable_lie *lie)
{
    const sb_real rounding = 16 * SB_EPSILON;
    sb_real strain = (lie->length - law->rest) / law->rest, size = sb_abs(strain), sign = strain < 0 ? -1 : 1;
    double e = (double)size, toe = (double)law->toe, scale = (double)law->stiffness * (double)law->rest;
    lie->tension = lie->rate = 0;
    lie->energy = 0;
    if (strain < -rounding && !law->pushes)
        return;
    if (size < law->toe) {
        lie->tension = sign * law->stiffness * size * size / (2 * law->toe);
        lie->rate = law->stiffness * size / (law->toe * law->rest);
        lie->energy = scale * e * e * e / (6 * toe);
    } else {
        lie->tension = sign * law->stiffness * (size - law->toe / 2);
        lie->rate = law->stiffness / law->rest;
        lie->energy = scale * (e * e / 2 - toe * e / 2 + toe * toe / 6);
    }
    if (strain < 0 && !law->pushes) {
        lie->tension = 0;
        lie->energy = 0;
    }
}

SBI_API void sbi_cable_lay(const sb_body *body, sbi_load *load, const sb_vec3 *u, sb_real factor)
{
    sbi_cable_lie *lie = &load->lie;
    sbi_cable_law law = sbi_cable_law_at(load, factor);
    sb_vec3 at = sbi_cable_point(body, load, 0, u, factor), before = sb_v3(0, 0, 0);
    int last = load->row_count - 1;
    lie->length = 0;
    for (int k = 0; k <= last; k++) {
        sb_vec3 next = k < last ? sbi_cable_point(body, load, k + 1, u, factor) : at, way = sb_v3_sub(next, at);
        lie->part[k] = sb_v3_norm(way);
        lie->way[k] = lie->part[k] > 0 ? sb_v3_scale(1 / lie->part[k], way) : sb_v3(0, 0, 0);
        lie->slope[k] = sb_v3_sub(before, lie->way[k]);
        lie->length += lie->part[k];
        before = lie->way[k];
        at = next;
    }
    sbi_cable_stretch(&law, lie);
}

SBI_API void sbi_cable_list_shares(const sb_body *body, sbi_load *load, const sb_vec3 *u)
{
    sbi_cable_lay(body, load, u, 1);
    for (int j = 0; j < load->row_count; j++)
        for (int k = load->row_start[j]; k < load->row_start[j + 1]; k++) {
            sb_vec3 share = sb_v3_scale(load->weights[k], load->lie.slope[j]);
            for (int axis = 0; axis < 3; axis++)
                load->lie.dofs[3 * k + axis] = 3 * load->nodes[k] + axis;
            load->lie.shares[3 * k] = share.x;
            load->lie.shares[3 * k + 1] = share.y;
            load->lie.shares[3 * k + 2] = share.z;
        }
}

/* out += H f of one point */
static void sbi_cable_spread(const sbi_load *load, int point, sb_vec3 f, sb_vec3 *out)
{
    for (int k = load->row_start[point]; k < load->row_start[point + 1]; k++)
        out[load->nodes[k]] = sb_v3_madd(out[load->nodes[k]], load->weights[k], f);
}

SBI_API void sbi_cable_add_force(const sbi_load *load, sb_vec3 *out)
{
    for (int j = 0; j < load->row_count; j++)
        sbi_cable_spread(load, j, sb_v3_scale(-load->lie.tension, load->lie.slope[j]), out);
}

SBI_API double sbi_cable_square_size(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_real factor)
{
    double reach = 0, rate = (double)load->lie.rate;
    for (int j = 0; j < load->row_count; j++) {
        sb_vec3 at = sbi_cable_point(body, load, j, u, factor);
        reach += (double)sb_v3_dot(at, at);
    }
    return rate * rate * reach;
}

/* ---- stiffness ---- */

/* What its tension adds across its parts: none where a cable is pressed, which it makes softer. */
static sb_real sbi_cable_pull(const sbi_load *load, int exact)
{
    return exact ? load->lie.tension : sb_max(load->lie.tension, 0);
}

/* block += value (I - t t^T) */
static void sbi_cable_across(sb_vec3 way, sb_real value, sb_real *block)
{
    const sb_real t[3] = {way.x, way.y, way.z};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            block[3 * i + j] += value * ((i == j ? 1 : 0) - t[i] * t[j]);
}

/* What a move of point q does to the force on point p, with its sign turned; rate and pull: of sbi_cable_lie. */
static void sbi_cable_pair(const sbi_cable_lie *lie, int p, int q, sb_real rate, sb_real pull, sb_real *block)
{
    const sb_real a[3] = {lie->slope[p].x, lie->slope[p].y, lie->slope[p].z};
    const sb_real b[3] = {lie->slope[q].x, lie->slope[q].y, lie->slope[q].z};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            block[3 * i + j] = rate * a[i] * b[j];
    for (int part = sbi_max_int(p, q) - 1; part <= (p < q ? p : q); part++)
        if (part >= 0 && lie->part[part] > 0)
            sbi_cable_across(lie->way[part], (p == q ? pull : -pull) / lie->part[part], block);
}

/* matrix += the blocks of all pairs of its points. */
static void sbi_cable_add_blocks(const sbi_load *load, sb_real rate, sb_real pull, sb_matrix *matrix)
{
    for (int p = 0; p < load->row_count; p++)
        for (int q = 0; q < load->row_count; q++) {
            sb_real pair[9];
            sbi_cable_pair(&load->lie, p, q, rate, pull, pair);
            for (int a = load->row_start[p]; a < load->row_start[p + 1]; a++)
                for (int b = load->row_start[q]; b < load->row_start[q + 1]; b++) {
                    sb_real weight = load->weights[a] * load->weights[b];
                    int at = weight != 0 ? sb_matrix_find(matrix, load->nodes[a], load->nodes[b]) : -1;
                    for (int c = 0; c < 9 && at >= 0; c++)
                        matrix->blocks[at][c] += weight * pair[c];
                }
        }
}

SBI_API void sbi_cable_add_tangent(sbi_load *load, sb_tangent_kind kind, sb_matrix *matrix)
{
    if (load->lie.rate > 0)
        sbi_cable_add_blocks(load, load->lie.rate, sbi_cable_pull(load, kind == SB_TANGENT_EXACT), matrix);
}

SBI_API void sbi_cable_add_slack(const sbi_load *load, sb_matrix *matrix)
{
    sb_real more = load->cable.stiffness / load->cable.rest - load->lie.rate;
    if (more > 0)
        sbi_cable_add_blocks(load, more, 0, matrix);
}

/* Displacements x, or by how much they are more than others. */
typedef struct sbi_cable_move {
    const sb_vec3 *x, *from; /* from: NULL stands for 0 */
} sbi_cable_move;

static sb_vec3 sbi_cable_motion(const sbi_load *load, int point, sbi_cable_move move)
{
    sb_vec3 x = sbi_body_row_value(load, point, move.x);
    return move.from ? sb_v3_sub(x, sbi_body_row_value(load, point, move.from)) : x;
}

/* What its length changes by. */
static sb_real sbi_cable_lengthen(const sbi_load *load, sbi_cable_move move)
{
    sb_real sum = 0;
    for (int j = 0; j < load->row_count; j++)
        sum += sb_v3_dot(load->lie.slope[j], sbi_cable_motion(load, j, move));
    return sum;
}

/* K x at point p. */
static sb_vec3 sbi_cable_row_product(const sbi_load *load, int p, sb_real longer, sbi_cable_move move)
{
    const sbi_cable_lie *lie = &load->lie;
    sb_vec3 sum = sb_v3_scale(lie->rate * longer, lie->slope[p]), own = sbi_cable_motion(load, p, move);
    for (int part = sbi_max_int(p - 1, 0); part <= p && lie->rate > 0; part++) {
        sb_vec3 turn;
        if (!(lie->part[part] > 0))
            continue;
        turn = sb_v3_sub(own, sbi_cable_motion(load, part == p ? p + 1 : part, move));
        turn = sb_v3_madd(turn, -sb_v3_dot(turn, lie->way[part]), lie->way[part]);
        sum = sb_v3_madd(sum, sbi_cable_pull(load, 0) / lie->part[part], turn);
    }
    return sum;
}

SBI_API void sbi_cable_add_product(const sbi_load *load, const sb_vec3 *x, sb_real factor, sb_vec3 *out)
{
    const sbi_cable_move move = {x, NULL};
    sb_real longer = sbi_cable_lengthen(load, move);
    for (int p = 0; p < load->row_count; p++)
        sbi_cable_spread(load, p, sb_v3_scale(factor, sbi_cable_row_product(load, p, longer, move)), out);
}

SBI_API sb_real sbi_cable_work(const sbi_load *load, const sb_vec3 *du)
{
    const sbi_cable_move move = {du, NULL};
    return -load->lie.tension * sbi_cable_lengthen(load, move);
}

/* ---- solves ---- */

SBI_API void sbi_cable_relax(const sb_body *body, sbi_load *load)
{
    sbi_cable_lay(body, load, body->displacement, 1);
    load->balanced_cable = load->cable;
    if (load->lie.length > load->cable.rest || (load->cable.pushes && load->lie.length > 0))
        load->balanced_cable.rest = load->lie.length;
    for (int j = 0; j < load->row_count; j++)
        load->balanced_target[j] = load->target[j];
}

SBI_API void sbi_cable_settle(sbi_load *load, sb_real factor)
{
    sbi_cable_law law = sbi_cable_law_at(load, factor);
    for (int j = 0; j < load->row_count; j++) {
        sb_vec3 from = load->balanced_target[j], to = load->target[j];
        load->balanced_target[j] = factor == 1 ? to : sb_v3_madd(from, factor, sb_v3_sub(to, from));
    }
    load->balanced_cable = law;
}

SBI_API void sbi_cable_read(const sb_body *body, sbi_load *load, const sb_vec3 *u, const sb_vec3 *linear,
                            sb_real factor)
{
    const sbi_cable_move move = {u, linear};
    sb_real longer;
    sbi_cable_lay(body, load, linear, factor);
    longer = u == linear ? 0 : sbi_cable_lengthen(load, move);
    for (int p = 0; p < load->row_count; p++) {
        sb_vec3 force = sb_v3_scale(-load->lie.tension, load->lie.slope[p]);
        if (u != linear)
            force = sb_v3_sub(force, sbi_cable_row_product(load, p, longer, move));
        load->force[p] = force;
    }
    load->tension = load->lie.tension + load->lie.rate * longer;
    sbi_cable_lay(body, load, body->displacement, factor);
    load->curved_energy = load->lie.energy;
}
