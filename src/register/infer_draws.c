/* infer_draws: how sure the answer is: draws of its error, and the report. */
#include "infer_private.h"

#include <math.h>
#include <string.h>

#include "chance.h"
#include "cloud.h"

/* What the predicted deviations are multiplied by, for full views and for parts. With them regions of 95 % hold the
 * truth of 97 % (whole) and 99 % (views) of the nodes of twelve organs like those of the test infer/organs, and errors
 * are 0.95 of those to expect in the geometric mean of 96 cases of insilico (tests/bench/registration.md). Parts
 * had 1.7 while errors that patches have alike counted as independent. */
#define REGI_INFER_ALPHA_FULL 1.3
#define REGI_INFER_ALPHA_VIEW 1.4

/* Views of less of the surface than this are small. */
#define REGI_INFER_SMALL 0.15
/* See regi_infer_sure. With less, whole organs are farther off than their start; with more, good answers lose. */
#define REGI_INFER_DOUBT 0.75
/* See regi_infer_widen. */
#define REGI_INFER_LEAST_MOTION 0.005

/* An error to expect above so many sizes is a view that shows too little. */
#define REGI_INFER_OPEN 0.03

/* What is not known of the material: log of the stiffness of a region (sd), and Poisson's ratio. */
#define REGI_INFER_STIFFNESS_SD 0.5
#define REGI_INFER_POISSON_SD 0.02

/* ---- the material ---- */

/* F of a point of a cell at u[nodes]. */
static sb_mat3 regi_infer_deformation(const sb_domain *d, const sb_vec3 *u, int cell, int point)
{
    const int *nodes = d->cells + (size_t)cell * (size_t)d->nodes_per_cell;
    const sb_real *g =
        d->gradients + ((size_t)cell * (size_t)d->points_per_cell + (size_t)point) * (size_t)d->nodes_per_cell * 3;
    sb_mat3 f = sb_m3_identity();
    for (int a = 0; a < d->nodes_per_cell; a++)
        f = sb_m3_add(f, sb_m3_outer(u[nodes[a]], sb_v3(g[3 * a], g[3 * a + 1], g[3 * a + 2])));
    return f;
}

/* Adds factor times a cell's internal forces for a Poisson's ratio to forces[nodes per cell]. */
static void regi_infer_add_cell(const reg_infer *f, int cell, sb_real poisson, sb_real factor, sb_vec3 *forces)
{
    const sb_domain *d = &f->model->domain;
    sb_material material = sb_material_neo_hookean(REGI_MODEL_YOUNG, poisson, 1000);
    for (int p = 0; p < d->points_per_cell; p++) {
        size_t at = (size_t)cell * (size_t)d->points_per_cell + (size_t)p;
        const sb_real *g = d->gradients + at * (size_t)d->nodes_per_cell * 3;
        sb_mat3 deformation = regi_infer_deformation(d, f->shape, cell, p), stress;
        if (!sb_material_stress(&material, &deformation, NULL, &stress))
            continue;
        for (int a = 0; a < d->nodes_per_cell; a++)
            forces[a] = sb_v3_madd(forces[a], factor * d->weights[at],
                                   sb_m3_apply(stress, sb_v3(g[3 * a], g[3 * a + 1], g[3 * a + 2])));
    }
}

/* Forces of all cells at the shape found, and what Poisson's ratio changes of them. */
static void regi_infer_split_forces(reg_infer *f)
{
    const sb_domain *d = &f->model->domain;
    size_t n = (size_t)d->nodes_per_cell;
    sb_real nu = f->model->poisson, other = sb_min(nu + (sb_real)REGI_INFER_POISSON_SD, (sb_real)0.499);
    sb_real step = (sb_real)REGI_INFER_POISSON_SD / sb_max(other - nu, SB_EPSILON);
    memset(f->cell_force, 0, (size_t)d->cell_count * n * sizeof *f->cell_force);
    memset(f->poisson_force, 0, (size_t)f->node_count * sizeof *f->poisson_force);
    for (int e = 0; e < d->cell_count; e++) {
        sb_vec3 change[SB_MAX_ELEMENT_NODES];
        sb_vec3 *own = f->cell_force + (size_t)e * n;
        memset(change, 0, sizeof change);
        regi_infer_add_cell(f, e, nu, 1, own);
        regi_infer_add_cell(f, e, other, step, change);
        for (size_t a = 0; a < n; a++) {
            sb_vec3 *to = f->poisson_force + d->cells[(size_t)e * n + a];
            *to = sb_v3_add(*to, sb_v3_madd(change[a], -step, own[a]));
        }
    }
}

static sb_vec3 regi_infer_cell_middle(const reg_infer *f, int cell)
{
    const sb_domain *d = &f->model->domain;
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int a = 0; a < d->nodes_per_cell; a++)
        sum = sb_v3_add(sum, f->model->mesh.nodes[d->cells[(size_t)cell * (size_t)d->nodes_per_cell + (size_t)a]]);
    return sb_v3_scale(1 / (sb_real)d->nodes_per_cell, sum);
}

/* Shares of smooth regions in each cell. */
static sb_result regi_infer_find_regions(reg_infer *f, int *regions, sb_error *error)
{
    int cells = f->model->domain.cell_count, chosen[REGI_INFER_REGIONS];
    sb_vec3 *middles = (sb_vec3 *)sbi_alloc(&f->allocator, (size_t)cells, sizeof(sb_vec3));
    sb_real *scratch = (sb_real *)sbi_alloc(&f->allocator, (size_t)cells, sizeof(sb_real));
    sb_real reach;
    if (middles && scratch) {
        for (int e = 0; e < cells; e++)
            middles[e] = regi_infer_cell_middle(f, e);
        *regions = reg_cloud_spread(middles, cells, sbi_min_int(cells, REGI_INFER_REGIONS), chosen, scratch);
        /* of half the volume of a cube around the organ */
        reach = f->model->size * sb_cbrt((sb_real)0.1 / (sb_real)*regions);
        for (int e = 0; e < cells; e++) {
            sb_real *row = f->region + (size_t)e * REGI_INFER_REGIONS, sum = 0;
            for (int k = 0; k < *regions; k++) {
                sb_real z = sb_v3_norm(sb_v3_sub(middles[e], middles[chosen[k]])) / reach;
                row[k] = sb_exp((sb_real)-0.5 * z * z) + SB_EPSILON;
                sum += row[k];
            }
            for (int k = 0; k < *regions; k++)
                row[k] /= sum;
        }
    }
    sbi_free(&f->allocator, scratch);
    if (middles == NULL || scratch == NULL) {
        sbi_free(&f->allocator, middles);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the regions of %d cells", cells);
    }
    sbi_free(&f->allocator, middles);
    return SB_OK;
}

/* forces[nodes] of a draw of what is not known of the material. */
static void regi_infer_draw_material(const reg_infer *f, int regions, regi_chance *chance, sb_vec3 *forces)
{
    const sb_domain *d = &f->model->domain;
    size_t n = (size_t)d->nodes_per_cell;
    double theta[REGI_INFER_REGIONS], poisson = regi_chance_normal(chance);
    for (int k = 0; k < regions; k++)
        theta[k] = REGI_INFER_STIFFNESS_SD * regi_chance_normal(chance);
    for (int i = 0; i < f->node_count; i++)
        forces[i] = sb_v3_scale((sb_real)poisson, f->poisson_force[i]);
    for (int e = 0; e < d->cell_count; e++) {
        const sb_real *share = f->region + (size_t)e * REGI_INFER_REGIONS;
        double log_stiffness = 0;
        for (int k = 0; k < regions; k++)
            log_stiffness += theta[k] * (double)share[k];
        for (size_t a = 0; a < n; a++) {
            sb_vec3 *to = forces + d->cells[(size_t)e * n + a];
            *to = sb_v3_madd(*to, (sb_real)log_stiffness, f->cell_force[(size_t)e * n + a]);
        }
    }
}

/* ---- draws ---- */

/* Standard normal deviates of a draw's loads, pose and noise. */
static double *regi_infer_chances(const reg_infer *f, int draw)
{
    return f->chances + (size_t)draw * (size_t)(f->loads + REGI_GAUSS_POSES + f->gauss.most);
}

/* What the material does in all draws, as forces into row, and the chances of the rest. They come in turns of four
 * draws, in which results are as they always were. */
static void regi_infer_draw_chances(reg_infer *f, int regions)
{
    enum { TURN = 4 };
    const regi_gauss *g = &f->gauss;
    regi_chance chance = {(uint64_t)0x9e3779b97f4a7c15u, 0, 0};
    for (int first = 0; first < REG_INFER_DRAWS; first += TURN) {
        for (int k = first; k < first + TURN; k++)
            regi_infer_draw_material(f, regions, &chance, f->row + (size_t)k * (size_t)f->node_count);
        for (int k = first; k < first + TURN; k++) {
            double *z = regi_infer_chances(f, k);
            for (int i = 0; i < g->loads + g->poses + g->count; i++)
                z[i] = regi_chance_normal(&chance);
        }
    }
}

/* Turns three numbers along the model's axes as the start turns them, so that draws are those of any frame. */
static void regi_infer_turn(const reg_infer *f, double v[3])
{
    sb_vec3 turned = sb_m3_apply(f->def->start.rotation, sb_v3((sb_real)v[0], (sb_real)v[1], (sb_real)v[2]));
    v[0] = (double)turned.x;
    v[1] = (double)turned.y;
    v[2] = (double)turned.z;
}

/* One draw of the error: its forces into `forces`, its pose into pose[7] (m, rad). errors holds what the material does.
 */
static void regi_infer_condition_draw(reg_infer *f, const double *z, const sb_vec3 *errors, sb_vec3 *forces,
                                      double pose[REGI_GAUSS_POSES])
{
    regi_gauss *g = &f->gauss;
    for (int b = 0; b < g->loads; b++)
        f->draw[b] = g->scale * *z++;
    for (int b = 0; b + 3 <= g->loads; b += 3)
        regi_infer_turn(f, f->draw + b);
    regi_gauss_balance(g, f->draw);
    for (int k = 0; k < g->poses; k++)
        pose[k] = *z++;
    regi_infer_turn(f, pose);
    regi_infer_turn(f, pose + 3);
    for (int i = 0; i < g->count; i++)
        f->datum[i] = sqrt(g->variance[i]) * *z++ + regi_infer_measure(f, i, errors);
    regi_gauss_condition(g, f->draw, pose, f->datum);
    for (int k = 0; k < REGI_INFER_POSE; k++)
        pose[k] *= f->pose_sd[k];
    regi_infer_load(f, f->draw, forces);
}

/* errors += what forces and pose of a draw do. */
static void regi_infer_add_draw(const reg_infer *f, const sb_vec3 *moved, const double pose[REGI_GAUSS_POSES],
                                sb_vec3 *errors)
{
    sb_vec3 way = sb_v3((sb_real)pose[0], (sb_real)pose[1], (sb_real)pose[2]);
    sb_vec3 turn = sb_v3((sb_real)pose[3], (sb_real)pose[4], (sb_real)pose[5]);
    for (int i = 0; i < f->node_count; i++) {
        sb_vec3 arm = sb_v3_sub(sb_v3_add(f->model->mesh.nodes[i], f->shape[i]), f->response.centre);
        errors[i] = sb_v3_add(errors[i], sb_v3_add(moved[i], sb_v3_add(way, sb_v3_cross(turn, arm))));
    }
}

static void regi_infer_draw_all(reg_infer *f, int regions)
{
    size_t n = (size_t)f->node_count;
    double pose[REG_INFER_DRAWS][REGI_GAUSS_POSES];
    regi_infer_draw_chances(f, regions);
    regi_response_solve(&f->response, f->row, REG_INFER_DRAWS);
    memcpy(f->errors, f->row, (size_t)REG_INFER_DRAWS * n * sizeof *f->row);
    for (int s = 0; s < REG_INFER_DRAWS; s++)
        regi_infer_condition_draw(f, regi_infer_chances(f, s), f->errors + (size_t)s * n, f->row + (size_t)s * n,
                                  pose[s]);
    regi_response_solve(&f->response, f->row, REG_INFER_DRAWS);
    memset(f->energy, 0, REGI_INFER_POSE * sizeof *f->energy);
    for (int s = 0; s < REG_INFER_DRAWS; s++) {
        regi_infer_add_draw(f, f->row + (size_t)s * n, pose[s], f->errors + (size_t)s * n);
        for (int k = 0; k < REGI_INFER_POSE; k++)
            f->energy[k] += pose[s][k] * pose[s][k] / (double)REG_INFER_DRAWS;
    }
}

/* The factor on predicted deviations. */
static double regi_infer_alpha(sb_real seen)
{
    double part = ((double)seen - 0.6) / 0.2;
    part = part < 0 ? 0 : part > 1 ? 1 : part;
    return REGI_INFER_ALPHA_VIEW + part * (REGI_INFER_ALPHA_FULL - REGI_INFER_ALPHA_VIEW);
}

/* Where loads explain hardly more than a pose does, others are as likely that the view does not show: for what is to be
 * expected they are at least such as move a datum by half a hundredth of the size. */
static int regi_infer_widen(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    double trace = 0, least;
    if ((double)f->quality.prior_margin >= 10)
        return 1;
    for (int i = 0; i < g->count; i++)
        trace += g->gram[(size_t)i * (size_t)g->most + (size_t)i] / g->count;
    least = REGI_INFER_LEAST_MOTION * (double)f->model->size / sqrt(trace > 0 ? trace : 1);
    if (!(trace > 0) || g->scale >= least)
        return 1;
    g->scale = least;
    return regi_gauss_solve(g);
}

/* The share of the way that pays: M^3 / (M^3 + (D E^2)^1.5) for one of M that is unsure by E, root mean squares over
 * the nodes. D grows with what is left over of the data's variance and with how many of them are off alike: data, model
 * and prior are wrong in ways that draws from them do not have. increment: the way. Landmarks and curves speak for the
 * elastic shape. */
static sb_real regi_infer_sure(const reg_infer *f)
{
    double way = 0, doubt = 0, alpha = regi_infer_alpha(f->quality.seen);
    if (f->marks.count > 0)
        return 1;
    for (int i = 0; i < f->node_count; i++)
        way += (double)sb_v3_dot(f->increment[i], f->increment[i]);
    for (size_t k = 0; k < (size_t)REG_INFER_DRAWS * (size_t)f->node_count; k++)
        doubt += (double)sb_v3_dot(f->errors[k], f->errors[k]) / (alpha * alpha * (double)REG_INFER_DRAWS);
    doubt *= REGI_INFER_DOUBT * f->left;
    return way > 0 ? (sb_real)(way * sqrt(way) / (way * sqrt(way) + doubt * sqrt(doubt))) : 1;
}

/* How much of the way from the start to the elastic shape is believed. Small views tell hardly more than a pose: half
 * of it, or nothing where loads explain no more than a pose does. Landmarks and curves speak for the elastic shape. */
static sb_real regi_infer_belief(const reg_infer *f)
{
    if (f->marks.count > 0 || f->quality.seen >= (sb_real)REGI_INFER_SMALL)
        return 1;
    return f->quality.prior_margin < 3 ? 0 : (sb_real)0.5;
}

/* The answer is between the start and the elastic shape; what is not believed of the way is in doubt, either way in
 * turn. */
static void regi_infer_hedge(reg_infer *f)
{
    size_t n = (size_t)f->node_count;
    sb_real belief = regi_infer_belief(f);
    f->quality.belief = belief;
    for (int i = 0; i < f->node_count; i++) {
        sb_vec3 x = f->model->mesh.nodes[i], start = sb_v3_sub(reg_rigid_apply(&f->def->start, x), x);
        f->increment[i] = sb_v3_sub(f->shape[i], start);
    }
    f->quality.sure = regi_infer_sure(f);
    belief *= f->quality.sure;
    for (size_t i = 0; i < n && belief < 1; i++)
        f->shape[i] = sb_v3_madd(f->shape[i], belief - 1, f->increment[i]);
    for (size_t k = 0; k < (size_t)REG_INFER_DRAWS * n && belief < 1; k++)
        f->errors[k] = sb_v3_madd(f->errors[k], k / n % 2 ? 1 - belief : belief - 1, f->increment[k % n]);
}

static sb_result regi_infer_draw_errors(reg_infer *f, sb_error *error)
{
    sb_real alpha = (sb_real)regi_infer_alpha(f->quality.seen);
    int regions = 0;
    sb_result result = regi_infer_find_regions(f, &regions, error);
    if (result != SB_OK)
        return result;
    if (!regi_infer_widen(f))
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "what is to be expected of the errors cannot be told");
    regi_infer_split_forces(f);
    regi_infer_draw_all(f, regions);
    for (size_t k = 0; k < (size_t)REG_INFER_DRAWS * (size_t)f->node_count; k++)
        f->errors[k] = sb_v3_scale(alpha, f->errors[k]);
    for (int k = 0; k < REGI_INFER_POSE; k++)
        f->quality.pose_sd[k / 3] = sb_max(f->quality.pose_sd[k / 3], alpha * sb_sqrt((sb_real)f->energy[k]));
    return SB_OK;
}

/* ---- the report ---- */

/* Share of the skin near places of believed points. */
static sb_result regi_infer_find_seen(reg_infer *f, sb_error *error)
{
    const reg_model *m = f->model;
    sb_vec3 *places = (sb_vec3 *)sbi_alloc(&f->allocator, (size_t)f->look.point_count, sizeof *places);
    reg_kdtree *tree = NULL;
    sb_real reach = f->spacing;
    double seen = 0;
    int count = 0;
    sb_result result = SB_OK;
    if (!places)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the places of %d points", f->look.point_count);
    for (int i = 0; i < f->look.point_count; i++)
        if (f->look.points[i].trust > (sb_real)0.25 * f->look.points[i].weight)
            places[count++] = f->look.points[i].place;
    if (count > 0)
        result = reg_kdtree_create(places, count, &f->allocator, &tree, error);
    for (int i = 0; result == SB_OK && i < m->skin.node_count && count > 0; i++)
        seen += reg_kdtree_nearest(tree, f->skin[i], reach, NULL) >= 0 ? (double)m->vertex_area[i] : 0;
    f->quality.seen = (sb_real)(seen / m->area);
    reg_kdtree_destroy(tree);
    sbi_free(&f->allocator, places);
    return result;
}

static void regi_infer_measure_fit(reg_infer *f)
{
    regi_look_measure(&f->look, &f->quality.used, &f->quality.residual, &f->quality.residual_p95);
    f->quality.noise = f->look.noise;
    f->quality.misfit = (sb_real)f->choice.misfit;
}

static void regi_infer_measure_shape(reg_infer *f)
{
    const sb_domain *d = &f->model->domain;
    double before = 0, after = 0;
    for (int e = 0; e < d->cell_count; e++)
        for (int p = 0; p < d->points_per_cell; p++) {
            sb_mat3 deformation = regi_infer_deformation(d, f->shape, e, p), vectors;
            double w = (double)d->weights[(size_t)e * (size_t)d->points_per_cell + (size_t)p];
            sb_vec3 squares;
            sb_m3_eigen(sb_m3_tmul(deformation, deformation), &squares, &vectors);
            f->quality.largest_strain = sb_max(f->quality.largest_strain, sb_max(sb_sqrt(sb_max(squares.x, 0)) - 1,
                                                                                 1 - sb_sqrt(sb_max(squares.z, 0))));
            before += w;
            after += w * (double)sb_m3_det(deformation);
        }
    f->quality.volume_ratio = (sb_real)(before > 0 ? after / before : 1);
}

static void regi_infer_summarise(reg_infer *f)
{
    reg_quality *q = &f->quality;
    double sum = 0;
    for (int i = 0; i < f->node_count; i++) {
        double square = 0;
        for (int k = 0; k < REG_INFER_DRAWS; k++) {
            sb_vec3 e = f->errors[(size_t)k * (size_t)f->node_count + (size_t)i];
            square += (double)sb_v3_dot(e, e) / (double)REG_INFER_DRAWS;
        }
        f->expected[i] = (sb_real)sqrt(square);
        sum += sqrt(square) / f->node_count;
        q->expected_worst = sb_max(q->expected_worst, f->expected[i]);
    }
    q->expected = (sb_real)sum;
    q->prior = f->quality.prior_margin < 3       ? REG_PRIOR_RIGID
               : f->quality.pressure_margin >= 3 ? REG_PRIOR_PRESSURE
               : f->choice.gravity > 0           ? REG_PRIOR_GRAVITY
               : f->choice.is_local              ? REG_PRIOR_LOCAL
                                                 : REG_PRIOR_SMOOTH;
}

static void regi_infer_warn(reg_infer *f)
{
    reg_quality *q = &f->quality;
    sb_real size = f->model->size;
    if (q->seen < (sb_real)REGI_INFER_SMALL || q->expected > (sb_real)REGI_INFER_OPEN * size)
        q->warnings |= REG_WARN_VIEW_SMALL;
    if (q->used < (sb_real)0.7)
        q->warnings |= REG_WARN_MANY_OUTLIERS;
    if (q->pose_sd[0] > (sb_real)0.02 * size || q->pose_sd[1] > (sb_real)0.087)
        q->warnings |= REG_WARN_LOW_CONTRAST;
    if (q->largest_strain > (sb_real)0.3)
        q->warnings |= REG_WARN_STRAIN;
    if (sb_abs(q->volume_ratio - 1) > (sb_real)0.1)
        q->warnings |= REG_WARN_VOLUME;
    if (q->change > q->expected)
        q->warnings |= REG_WARN_NOT_AT_REST;
}

REGI_API sb_result regi_infer_tell(reg_infer *f, sb_error *error)
{
    double begun = regi_infer_now(f);
    sb_result result;
    memcpy(f->shape, sb_body_displacements(f->model->body), (size_t)f->node_count * sizeof *f->shape);
    result = regi_infer_find_seen(f, error); /* by the last look, which the gauss is about */
    if (result == SB_OK)
        result = regi_infer_draw_errors(f, error);
    if (result != SB_OK)
        return result;
    regi_infer_hedge(f);
    if (f->quality.belief * f->quality.sure < 1)
        result = sb_body_set_displacements(f->model->body, f->shape);
    (void)regi_infer_look(f, f->quality.rounds);
    regi_infer_measure_fit(f);
    regi_infer_measure_shape(f);
    regi_infer_summarise(f);
    regi_infer_warn(f);
    f->quality.seconds_draws = regi_infer_now(f) - begun;
    return SB_OK;
}
