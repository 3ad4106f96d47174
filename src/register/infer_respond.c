/* infer_respond: what loads and pose do to the data where the organ is now. */
#include "infer_private.h"

#include <string.h>

/* Deviation of the offset of all points, as share of the organ's size: so small that an organ that has lost volume is
 * rather pressed than seen through a scan that is off everywhere. */
#define REGI_INFER_OFFSET 3e-4

/* ---- responses ---- */

/* What unit tractions and weights do along a row: a datum's response, or a resultant. */
static void regi_infer_store(reg_infer *f, int at, const sb_vec3 *row)
{
    int c = f->model->prior.control_count;
    size_t m = (size_t)f->gauss.most;
    sb_vec3 weight;
    regi_prior_collect(&f->model->prior, row, f->tractions, &weight);
    for (int j = 0; j <= c; j++) {
        sb_vec3 v = j < c ? f->tractions[j] : weight;
        double *to = f->raw + (size_t)(3 * j) * m + (size_t)at;
        to[0] = (double)v.x;
        to[m] = (double)v.y;
        to[2 * m] = (double)v.z;
    }
}

/* Adds a vector of forces to those that the inverse of the stiffness goes between. What is held takes none. */
static void regi_infer_add_vector(reg_infer *f, int column, const sb_vec3 *forces)
{
    const unsigned char *held = sb_body_supports(f->model->body);
    for (int i = 0; i < f->node_count; i++) {
        sb_vec3 v = sbi_body_pick_axes(held[i], sb_v3(0, 0, 0), forces[i]);
        if (v.x != 0 || v.y != 0 || v.z != 0)
            sbi_between_add(f->between, column, i, v);
    }
}

/* The rights: unit tractions of the control points, the weight's, which are the first modes, the other modes, the
 * residual. */
static void regi_infer_add_loads(reg_infer *f)
{
    const regi_prior *p = &f->model->prior;
    int first = f->gauss.most + (int)REGI_RESPONSE_MODES, modes = first + 3 * p->control_count;
    for (int i = 0; i < f->node_count; i++)
        for (int k = p->start[i]; k < p->start[i + 1]; k++)
            for (int axis = 0; axis < 3; axis++)
                sbi_between_add(f->between, first + 3 * p->controls[k] + axis, i,
                                sb_v3_scale(p->shares[k], sb_v3(axis == 0, axis == 1, axis == 2)));
    for (int k = 0; k < (f->model->held ? 3 : (int)REGI_RESPONSE_MODES); k++) {
        regi_response_mode(&f->response, k, f->row);
        regi_infer_add_vector(f, modes + k, f->row);
        if (!f->model->held)
            regi_infer_add_vector(f, f->gauss.most + k, f->row);
    }
    regi_infer_add_vector(f, modes + REGI_RESPONSE_MODES, f->response.residual);
}

/* The lefts: the data's rows; their gaps and what the pose does to them. */
static void regi_infer_add_data(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    for (int s = 0; s < g->count; s++) {
        double pose[REGI_INFER_POSE];
        memset(f->row, 0, (size_t)f->node_count * sizeof *f->row);
        regi_infer_row(f, s, f->row, g->gap + s, pose);
        for (int k = 0; k < REGI_INFER_POSE; k++) {
            g->pose[(size_t)k * (size_t)g->most + (size_t)s] = pose[k] * f->pose_sd[k];
            g->gap[s] += pose[k] * f->pose[k];
        }
        g->pose[(size_t)REGI_INFER_POSE * (size_t)g->most + (size_t)s] =
            f->patch_of[s] < 0 ? 0 : REGI_INFER_OFFSET * (double)f->model->size;
        regi_infer_add_vector(f, s, f->row);
    }
}

/* What a right does to all data, the motion as a whole taken out by forces on the modes: out[count]. drift: [count]
 * [MODES] such forces for each datum. */
static void regi_infer_answer(const reg_infer *f, int right, const double *drift, double *out)
{
    double along[REGI_RESPONSE_MODES];
    for (int k = 0; k < REGI_RESPONSE_MODES; k++)
        along[k] = f->model->held ? 0 : (double)sbi_between_get(f->between, f->gauss.most + k, right);
    for (int s = 0; s < f->gauss.count; s++) {
        out[s] = (double)sbi_between_get(f->between, s, right);
        for (int k = 0; k < REGI_RESPONSE_MODES && !f->model->held; k++)
            out[s] -= along[k] * drift[s * REGI_RESPONSE_MODES + k];
    }
}

/* Responses of all data, and the gaps that loads and pose have to close in all: those seen, and those that would open
 * if the present loads and pose went. */
static void regi_infer_measure_data(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    int modes = 3 * f->model->prior.control_count;
    sbi_between_clear(f->between);
    regi_infer_add_data(f);
    regi_infer_add_loads(f);
    (void)sbi_between_run(f->between); /* the factor is there */
    for (int s = 0; s < g->count && !f->model->held; s++) {
        double *drift = f->drift + (size_t)s * REGI_RESPONSE_MODES;
        for (int k = 0; k < REGI_RESPONSE_MODES; k++)
            drift[k] = (double)sbi_between_get(f->between, s, modes + k);
        regi_gauss_substitute(f->response.drift_system, REGI_RESPONSE_MODES, REGI_RESPONSE_MODES, drift);
    }
    for (int b = 0; b < f->loads; b++)
        regi_infer_answer(f, b, f->drift, f->raw + (size_t)b * (size_t)g->most);
    regi_infer_answer(f, modes + REGI_RESPONSE_MODES, f->drift, f->datum);
    for (int s = 0; s < g->count; s++)
        g->gap[s] += f->datum[s];
}

/* Forces and torques about the centre, over the size, of unit loads where the organ is now. */
static void regi_infer_sum_up(reg_infer *f)
{
    const sb_vec3 *x = sb_body_positions(f->model->body);
    for (int e = 0; e < f->gauss.exact; e++) {
        sb_vec3 axis = sb_v3(e % 3 == 0, e % 3 == 1, e % 3 == 2);
        for (int i = 0; i < f->node_count; i++)
            f->row[i] =
                e < 3 ? axis : sb_v3_scale(1 / f->model->size, sb_v3_cross(axis, sb_v3_sub(x[i], f->response.centre)));
        regi_infer_store(f, f->gauss.count + e, f->row);
    }
}

REGI_API void regi_infer_respond(reg_infer *f)
{
    regi_infer_measure_data(f);
    regi_infer_sum_up(f);
}
