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

/* Responses of all data, a group at a time, and the gaps that loads and pose have to close in all: those seen, and
 * those that would open if the present loads and pose went. */
static void regi_infer_measure_data(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    size_t n = (size_t)f->node_count;
    for (int first = 0; first < g->count; first += REGI_RESPONSE_GROUP) {
        int count = sbi_min_int(REGI_RESPONSE_GROUP, g->count - first);
        memset(f->row, 0, (size_t)count * n * sizeof *f->row);
        for (int s = 0; s < count; s++) {
            double pose[REGI_INFER_POSE];
            regi_infer_row(f, first + s, f->row + (size_t)s * n, g->gap + first + s, pose);
            for (int k = 0; k < REGI_INFER_POSE; k++) {
                g->pose[(size_t)k * (size_t)g->most + (size_t)(first + s)] = pose[k] * f->pose_sd[k];
                g->gap[first + s] += pose[k] * f->pose[k];
            }
            g->pose[(size_t)REGI_INFER_POSE * (size_t)g->most + (size_t)(first + s)] =
                f->patch_of[first + s] < 0 ? 0 : REGI_INFER_OFFSET * (double)f->model->size;
        }
        regi_response_solve(&f->response, f->row, count);
        for (int s = 0; s < count; s++) {
            const sb_vec3 *row = f->row + (size_t)s * n;
            for (size_t i = 0; i < n; i++)
                g->gap[first + s] += (double)sb_v3_dot(row[i], f->response.residual[i]);
            regi_infer_store(f, first + s, row);
        }
    }
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
