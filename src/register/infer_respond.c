/* infer_respond: what loads and pose do to the data where the organ is now. */
#include "infer_private.h"

#include <string.h>

/* Deviation of the offset of all points, as share of the organ's size: so small that an organ that has lost volume is
 * rather pressed than seen through a scan that is off everywhere. */
#define REGI_INFER_OFFSET 3e-4

/* ---- responses ---- */

/* Of a load along the axes, to[3][most]: what it does to a datum or resultant. */
static void regi_infer_put(const reg_infer *f, double *to, int at, sb_vec3 v)
{
    size_t m = (size_t)f->gauss.most;
    to += at;
    to[0] = (double)v.x;
    to[m] = (double)v.y;
    to[2 * m] = (double)v.z;
}

/* What unit tractions and weights do along a row, for a resultant. */
static void regi_infer_store(reg_infer *f, int at, const sb_vec3 *row)
{
    int c = f->model->prior.control_count;
    sb_vec3 weight;
    regi_prior_collect(&f->model->prior, row, f->tractions, &weight);
    for (int j = 0; j <= c; j++)
        regi_infer_put(f, f->raw + 3 * (size_t)j * (size_t)f->gauss.most, at, j < c ? f->tractions[j] : weight);
}

/* Adds a datum's force at a node to the lefts, and what the modes, as forces, and the residual do to it. */
static void regi_infer_add_force(reg_infer *f, int datum, int node, sb_vec3 force)
{
    size_t m = (size_t)f->gauss.most, n = (size_t)f->node_count;
    sbi_between_add(f->between, datum, node, regi_response_to_factor(&f->response, force));
    for (size_t k = 0; k < REGI_RESPONSE_MODES; k++)
        f->drift[k * m + (size_t)datum] += (double)sb_v3_dot(force, f->response.drift[k * n + (size_t)node]);
    f->gauss.gap[datum] += (double)sb_v3_dot(force, f->response.recoil[node]);
}

/* Moves what the row has at the nodes of a mapping's point to a left. What is held takes no forces. */
static void regi_infer_move_point(reg_infer *f, int datum, const sb_mapping *mapping, int point)
{
    const unsigned char *held = sb_body_supports(f->model->body);
    for (int k = mapping->row_start[point]; k < mapping->row_start[point + 1]; k++) {
        int node = mapping->nodes[k];
        sb_vec3 force = sbi_body_pick_axes(held[node], sb_v3(0, 0, 0), f->row[node]);
        f->row[node] = sb_v3(0, 0, 0);
        if (force.x != 0 || force.y != 0 || force.z != 0)
            regi_infer_add_force(f, datum, node, force);
    }
}

/* Moves a datum's row to the lefts; row[nodes] is 0 again. */
static void regi_infer_move_row(reg_infer *f, int datum)
{
    int patch = f->patch_of[datum];
    if (patch < 0) {
        for (int k = 0; k < 2; k++)
            regi_infer_move_point(f, datum, &f->marks.rows.mapping, f->marks.lines[-1 - patch].points[k]);
        return;
    }
    for (int i = f->look.patch_start[patch]; i < f->look.patch_start[patch + 1]; i++)
        for (int k = 0; k < 3 && f->look.points[i].triangle >= 0; k++)
            regi_infer_move_point(f, datum, &f->model->rows.mapping,
                                  f->model->skin.elements[3 * (size_t)f->look.points[i].triangle + (size_t)k]);
}

/* The lefts: the data's rows. Gaps that loads and pose have to close in all: those seen, and those that would open if
 * the present loads and pose went; what the pose does to them. */
static void regi_infer_add_data(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    memset(f->drift, 0, REGI_RESPONSE_MODES * (size_t)g->most * sizeof *f->drift);
    memset(f->row, 0, (size_t)f->node_count * sizeof *f->row);
    for (int s = 0; s < g->count; s++) {
        double pose[REGI_INFER_POSE];
        regi_infer_row(f, s, f->row, g->gap + s, pose);
        for (int k = 0; k < REGI_INFER_POSE; k++) {
            g->pose[(size_t)k * (size_t)g->most + (size_t)s] = pose[k] * f->pose_sd[k];
            g->gap[s] += pose[k] * f->pose[k];
        }
        g->pose[(size_t)REGI_INFER_POSE * (size_t)g->most + (size_t)s] =
            f->patch_of[s] < 0 ? 0 : REGI_INFER_OFFSET * (double)f->model->size;
        regi_infer_move_row(f, s);
    }
}

/* Of nothing-held organs: takes the motion as a whole out of the responses of the data to all loads, by forces on the
 * modes. */
static void regi_infer_stop_drift(reg_infer *f)
{
    size_t m = (size_t)f->gauss.most, n = (size_t)f->node_count;
    for (int s = 0; s < f->gauss.count; s++) {
        double forces[REGI_RESPONSE_MODES];
        for (int k = 0; k < REGI_RESPONSE_MODES; k++)
            forces[k] = f->drift[(size_t)k * m + (size_t)s];
        regi_gauss_substitute(f->response.drift_system, REGI_RESPONSE_MODES, REGI_RESPONSE_MODES, forces);
        for (int k = 0; k < REGI_RESPONSE_MODES; k++)
            f->drift[(size_t)k * m + (size_t)s] = forces[k];
    }
    for (int k = 0; k < REGI_RESPONSE_MODES; k++) {
        sb_vec3 weight;
        regi_prior_collect(&f->model->prior, f->response.drift + (size_t)k * n, f->tractions, &weight);
        for (int j = 0; j <= f->model->prior.control_count; j++) {
            sb_vec3 along = j < f->model->prior.control_count ? f->tractions[j] : weight;
            const sb_real of[3] = {along.x, along.y, along.z};
            for (size_t axis = 0; axis < 3; axis++) {
                double *to = f->raw + (3 * (size_t)j + axis) * m;
                for (int s = 0; s < f->gauss.count; s++)
                    to[s] -= (double)of[axis] * f->drift[(size_t)k * m + (size_t)s];
            }
        }
    }
}

/* Responses of all data. */
static void regi_infer_measure_data(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    size_t m = (size_t)g->most;
    const regi_prior *p = &f->model->prior;
    const sbi_between_rights tractions = {p->start, p->controls, p->shares}; /* unit ones of the control points */
    sbi_between_clear(f->between);
    regi_infer_add_data(f);
    (void)sbi_between_run(f->between, &tractions); /* the factor is there */
    for (int j = 0; j < p->control_count; j++)
        for (int s = 0; s < g->count; s++)
            regi_infer_put(f, f->raw + 3 * (size_t)j * m, s,
                           regi_response_from_factor(&f->response, sbi_between_get(f->between, s, j)));
    for (size_t axis = 0; axis < REGI_INFER_WEIGHT; axis++) /* the first modes are the weight */
        memcpy(f->raw + (3 * (size_t)p->control_count + axis) * m, f->drift + axis * m,
               (size_t)g->count * sizeof *f->raw);
    if (!f->model->held)
        regi_infer_stop_drift(f);
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

/* areas[nodes]: those of the boundary's facets at each node, twice and more than once (m^2), outward, where the organ
 * is at x. */
static void regi_infer_sum_areas(const reg_infer *f, const sb_vec3 *x, sb_vec3 *areas)
{
    const sb_mesh *surface = &f->model->boundary.surface;
    const int *node = f->model->boundary.nodes;
    int width = sb_mesh_element_width(surface);
    int is_quad = sb_element_straight(surface->element_type) == SB_QUAD4;
    memset(areas, 0, (size_t)f->node_count * sizeof *areas);
    for (int e = 0; e < surface->element_count; e++) {
        const int *facet = surface->elements + (size_t)e * (size_t)width;
        sb_vec3 first = sb_v3_sub(x[node[facet[is_quad ? 2 : 1]]], x[node[facet[0]]]); /* a diagonal, or a side */
        sb_vec3 second = sb_v3_sub(x[node[facet[is_quad ? 3 : 2]]], x[node[facet[is_quad ? 1 : 0]]]);
        for (int a = 0; a < width; a++)
            areas[node[facet[a]]] = sb_v3_add(areas[node[facet[a]]], sb_v3_cross(first, second));
    }
}

/* tractions[nodes], per area at rest, of the unit pressure on the boundary where the organ is now. */
static void regi_infer_find_push(const reg_infer *f, sb_vec3 *tractions)
{
    sb_vec3 *rest = tractions + f->node_count;
    regi_infer_sum_areas(f, sb_body_positions(f->model->body), tractions);
    regi_infer_sum_areas(f, f->model->mesh.nodes, rest);
    for (int i = 0; i < f->node_count; i++) {
        sb_real area = sb_v3_norm(rest[i]);
        tractions[i] = sb_v3_scale(area > 0 ? -f->def->pressed[i] / area : 0, tractions[i]);
    }
}

/* The unit pressure where the organ is now as tractions of the control points, and what data and resultants do under
 * it, which is then known without another solve. */
static void regi_infer_press(reg_infer *f)
{
    const regi_prior *p = &f->model->prior;
    size_t m = (size_t)f->gauss.most;
    int rows = f->gauss.count + f->gauss.exact;
    double *to = f->raw + (size_t)(f->loads - 1) * m;
    sb_vec3 whole;
    regi_infer_find_push(f, f->row);
    regi_prior_collect(p, f->row, f->pressing, &whole);
    memset(to, 0, (size_t)rows * sizeof *to);
    for (int j = 0; j < p->control_count; j++) {
        const double *from = f->raw + 3 * (size_t)j * m;
        f->pressing[j] = sb_v3_scale(p->areas[j] > 0 ? (sb_real)(1 / p->areas[j]) : 0, f->pressing[j]);
        for (int s = 0; s < rows; s++)
            to[s] += (double)f->pressing[j].x * from[s] + (double)f->pressing[j].y * from[m + (size_t)s] +
                     (double)f->pressing[j].z * from[2 * m + (size_t)s];
    }
}

REGI_API void regi_infer_respond(reg_infer *f)
{
    regi_infer_measure_data(f);
    regi_infer_sum_up(f);
    if (f->pressing)
        regi_infer_press(f);
}
