/* infer_prior: which loads explain what is seen: weight, misfit, scale and places, by their evidence. */
#include "infer_private.h"

#include <math.h>
#include <string.h>

enum { REGI_INFER_SIZES = 4, REGI_INFER_MISFITS = 5, REGI_INFER_LOCAL = 4 };

/* How far about a patch others are off alike, in distances of the model's nodes. */
#define REGI_INFER_ALIKE 1.65

/* Places of their own must explain more than loads everywhere by so many nats, tempered. */
static const double regi_infer_earned = 3;

REGI_API void regi_infer_set_misfit(reg_infer *f, double misfit)
{
    for (int i = 0; i < f->gauss.count; i++)
        f->gauss.variance[i] = f->averaged[i] + (f->patch_of[i] < 0 ? 0 : f->alike * misfit * misfit);
}

/* ---- columns ---- */

/* root of tractions with a local scale or alike everywhere, and turned_root: they last while the scale does. 0: there
 * is none. */
static int regi_infer_find_root(reg_infer *f, int is_local)
{
    int c = f->model->prior.control_count;
    if (f->rooted == 1 + is_local)
        return 1;
    f->rooted = 0;
    if (!regi_prior_root(&f->model->prior, REGI_INFER_LENGTH, is_local ? f->local : NULL, f->root))
        return 0;
    f->rooted = 1 + is_local;
    for (int j = 0; j < c; j++)
        for (int k = 0; k < c; k++)
            f->turned_root[(size_t)k * (size_t)c + (size_t)j] = f->root[(size_t)j * (size_t)c + (size_t)k];
    return 1;
}

/* columns of tractions along an axis for data first.. of a tile's width: what they respond to goes into a tile, which
 * stays near while all columns are made of it. */
static void regi_infer_fill_strip(reg_infer *f, int axis, int first, int width)
{
    int c = f->model->prior.control_count;
    size_t m = (size_t)f->gauss.most;
    for (int j = 0; j < c; j++)
        memcpy(f->tile + (size_t)j * REGI_BLOCK_WIDTH, f->raw + (size_t)(3 * j + axis) * m + (size_t)first,
               (size_t)width * sizeof *f->tile);
    for (int k = 0; k < c; k += 2 * REGI_BLOCK_ROWS) {
        int have = sbi_min_int(2 * REGI_BLOCK_ROWS, c - k);
        double *columns = f->gauss.columns + (size_t)(3 * k + axis) * m + (size_t)first;
        regi_block block = {NULL, NULL, REGI_BLOCK_WIDTH, 1, 0, 0, 0};
        block.wide = f->gauss.wide;
        block.left = f->tile + (size_t)k * REGI_BLOCK_WIDTH; /* turned_root is 0 before its diagonal */
        block.right = f->turned_root + (size_t)k * (size_t)c + (size_t)k;
        block.right_stride = (size_t)c;
        block.depth = c - k;
        for (int r = 0; r < have; r++)
            memset(columns + (size_t)r * 3 * m, 0, (size_t)width * sizeof *columns);
        regi_block_add(&block, width, have, 1, columns, 3 * m);
    }
}

/* columns of tractions for the root at hand, with the resultants below the data. */
static void regi_infer_fill_tractions(reg_infer *f)
{
    int rows = f->gauss.count + f->gauss.exact;
    for (int axis = 0; axis < 3; axis++)
        for (int i = 0; i < rows; i += REGI_BLOCK_WIDTH)
            regi_infer_fill_strip(f, axis, i, sbi_min_int(REGI_BLOCK_WIDTH, rows - i));
}

/* Deviation of a load that acts on the organ as a whole, in scales: of the weight (m^2), or of a pressure. */
static double regi_infer_whole_unit(const reg_infer *f, const regi_infer_choice *choice, int load)
{
    int weights = load < 3 * f->model->prior.control_count + REGI_INFER_WEIGHT;
    return weights ? choice->gravity * f->model->prior.area : choice->pressure;
}

/* columns of the weight and of a pressure. */
static void regi_infer_fill_whole(reg_infer *f, const regi_infer_choice *choice)
{
    int rows = f->gauss.count + f->gauss.exact;
    size_t m = (size_t)f->gauss.most;
    for (int load = 3 * f->model->prior.control_count; load < f->loads; load++) {
        double unit = regi_infer_whole_unit(f, choice, load);
        for (int i = 0; i < rows; i++)
            f->gauss.columns[(size_t)load * m + (size_t)i] = unit * f->raw[(size_t)load * m + (size_t)i];
    }
}

/* Columns of tractions are there: the others of a choice, loads without resultants, gram and variances. */
static void regi_infer_bind_prior(reg_infer *f, const regi_infer_choice *choice)
{
    regi_gauss *g = &f->gauss;
    g->loads = f->loads;
    regi_infer_fill_whole(f, choice);
    for (int e = 0; e < g->exact; e++)
        for (int b = 0; b < g->loads; b++)
            g->resultants[(size_t)e * (size_t)g->most_loads + (size_t)b] =
                g->columns[(size_t)b * (size_t)g->most + (size_t)(g->count + e)];
    regi_gauss_bind(g);
    regi_gauss_multiply(g);
    regi_infer_set_misfit(f, choice->misfit);
    g->scale = choice->scale;
}

/* The columns of a choice; loads without resultants. */
REGI_API int regi_infer_set_prior(reg_infer *f, const regi_infer_choice *choice)
{
    if (!regi_infer_find_root(f, choice->is_local))
        return 0;
    regi_infer_fill_tractions(f);
    regi_infer_bind_prior(f, choice);
    return 1;
}

REGI_API void regi_infer_unfold(const reg_infer *f, const double *loads, sb_vec3 *tractions)
{
    int c = f->model->prior.control_count;
    for (int j = 0; j < c; j++) {
        double sum[3] = {0, 0, 0};
        for (int k = 0; k <= j; k++)
            for (int axis = 0; axis < 3; axis++)
                sum[axis] += f->root[(size_t)j * (size_t)c + (size_t)k] * loads[3 * k + axis];
        tractions[j] = sb_v3((sb_real)sum[0], (sb_real)sum[1], (sb_real)sum[2]);
    }
}

REGI_API double regi_infer_pressure(const reg_infer *f, const double *loads)
{
    return f->pressing ? regi_infer_whole_unit(f, &f->choice, f->loads - 1) * loads[f->loads - 1] : 0;
}

REGI_API void regi_infer_load(reg_infer *f, const double *loads, sb_vec3 *forces)
{
    int c = f->model->prior.control_count;
    double unit = regi_infer_whole_unit(f, &f->choice, 3 * c), pressure = regi_infer_pressure(f, loads);
    const double *w = loads + 3 * c;
    regi_infer_unfold(f, loads, f->tractions);
    for (int j = 0; f->pressing && j < c; j++)
        f->tractions[j] = sb_v3_madd(f->tractions[j], (sb_real)pressure, f->pressing[j]);
    regi_prior_forces(&f->model->prior, f->tractions,
                      sb_v3((sb_real)(unit * w[0]), (sb_real)(unit * w[1]), (sb_real)(unit * w[2])), forces);
}

/* ---- evidence on the grid ---- */

/* Columns of tractions that are alike everywhere; extended: their gram, resultants included. */
static int regi_infer_extend(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    int count = g->count, rows = count + g->exact;
    if (!regi_infer_find_root(f, 0))
        return 0;
    regi_infer_fill_tractions(f);
    g->count = rows;
    g->loads = 3 * f->model->prior.control_count;
    regi_gauss_multiply(g);
    g->count = count;
    g->loads = f->loads;
    memcpy(f->extended, g->gram, (size_t)rows * (size_t)g->most * sizeof(double));
    return 1;
}

/* gram: that of `extended`, a weight and a pressure, among loads without resultants: its last rows are eliminated. */
static void regi_infer_weigh_gram(reg_infer *f, const regi_infer_choice *choice)
{
    regi_gauss *g = &f->gauss;
    size_t m = (size_t)g->most;
    int rows = g->count + g->exact;
    regi_infer_fill_whole(f, choice);
    memcpy(g->gram, f->extended, (size_t)rows * m * sizeof(double));
    for (int load = 3 * f->model->prior.control_count; load < f->loads; load++) {
        const double *w = g->columns + (size_t)load * m;
        for (int i = 0; i < rows; i++)
            for (int j = i; j < rows; j++)
                g->gram[(size_t)i * m + (size_t)j] += w[i] * w[j];
    }
    for (int e = rows - 1; e >= g->count; e--) {
        double pivot = g->gram[(size_t)e * m + (size_t)e], *column = g->scratch;
        for (int i = 0; i < e; i++)
            column[i] = g->gram[(size_t)i * m + (size_t)e];
        for (int i = 0; i < e && pivot > 0; i++) {
            double share = column[i] / pivot, *row = g->gram + (size_t)i * m;
            for (int j = i; j < e; j++)
                row[j] -= share * column[j];
        }
    }
}

/* Scale and evidence of the gram at hand for a misfit; 0: there is none. */
static int regi_infer_weigh_misfit(reg_infer *f, regi_infer_choice *choice)
{
    regi_infer_set_misfit(f, choice->misfit);
    if (!regi_gauss_spectrum(&f->gauss))
        return 0;
    choice->scale = regi_gauss_best_scale(&f->gauss, &choice->evidence);
    return 1;
}

/* What the model cannot follow (m), for `spacing` s: a quarter of s^1.5 in sizes, as measured on models of 60 to 1,500
 * nodes; beyond 0.006 nothing is gained. With less, errors of a coarse model look like loads, which bend the organ as a
 * whole: a dent narrower than a cell put it off by up to 2.7 times what the rigid start was. */
REGI_API double regi_infer_least_misfit(const reg_model *model)
{
    double size = (double)model->size, cell = model->spacing / size, share = 0.25 * cell * sqrt(cell);
    return size * (share < 1e-3 ? 1e-3 : share > 6e-3 ? 6e-3 : share);
}

/* The best misfit for the gram at hand, which has been reduced. */
static int regi_infer_search_misfit(reg_infer *f, regi_infer_choice *best)
{
    static const double shares[REGI_INFER_MISFITS] = {1.02, 1.06, 1.23, 1.74, 3.03};
    regi_infer_choice trial = *best;
    for (int k = 0; k < REGI_INFER_MISFITS; k++) {
        trial.misfit = shares[k] * regi_infer_least_misfit(f->model);
        if (!regi_infer_weigh_misfit(f, &trial))
            return 0;
        if (k == 0 || trial.evidence > best->evidence)
            *best = trial;
    }
    return 1;
}

/* The best size of the weight, or of the pressure, at the misfit at hand: `best`, and none, which it has so far. */
static int regi_infer_search_whole(reg_infer *f, int presses, regi_infer_choice *best)
{
    static const double sizes[REGI_INFER_SIZES] = {1, 10, 100, 1000};
    const regi_infer_choice none = *best;
    for (int k = 0; k < (presses ? REGI_INFER_SIZES : REGI_INFER_SIZES - 1); k++) {
        regi_infer_choice trial = none;
        *(presses ? &trial.pressure : &trial.gravity) = sizes[k];
        regi_infer_weigh_gram(f, &trial);
        regi_gauss_reduce(&f->gauss);
        if (!regi_infer_weigh_misfit(f, &trial))
            return 0;
        trial.earned = presses ? trial.evidence - none.evidence : 0;
        if (trial.evidence > best->evidence)
            *best = trial;
    }
    return 1;
}

/* Weight, pressure and misfit: the misfit with neither, then each of them; the misfit is looked for again with them. */
static int regi_infer_search(reg_infer *f, regi_infer_choice *best)
{
    memset(best, 0, sizeof *best);
    if (!regi_infer_extend(f))
        return 0;
    regi_infer_weigh_gram(f, best);
    regi_gauss_reduce(&f->gauss);
    if (!regi_infer_search_misfit(f, best) || (f->def->gravity && !regi_infer_search_whole(f, 0, best)) ||
        (f->pressing && !regi_infer_search_whole(f, 1, best)))
        return 0;
    regi_infer_bind_prior(f, best);
    if (!(best->gravity > 0 || best->pressure > 0))
        return 1;
    regi_gauss_reduce(&f->gauss);
    return regi_infer_search_misfit(f, best);
}

/* ---- local scale ---- */

/* What data leave of the variance of eight control points' tractions along an axis: left[8], in squares of the scale.
 */
static void regi_infer_leave(const reg_infer *f, int first, int axis, double *left)
{
    const regi_gauss *g = &f->gauss;
    int c = f->model->prior.control_count, count = sbi_min_int(REGI_BLOCK_WIDTH, c - first);
    size_t m = (size_t)g->most;
    double *x = f->tile, sum[REGI_BLOCK_WIDTH];
    regi_block block = {NULL, NULL, 0, 1, 0, 0, 0};
    memset(x, 0, (size_t)g->count * REGI_BLOCK_WIDTH * sizeof *x);
    memset(sum, 0, sizeof sum);
    block.wide = g->wide;
    block.left = f->turned_root + first;
    block.left_stride = (size_t)c;
    block.right = g->columns + (size_t)axis * m;
    block.right_step = 3 * m;
    block.right_stride = 1;
    block.depth = first + count;
    regi_block_add(&block, count, g->count, 1, x, REGI_BLOCK_WIDTH);
    regi_gauss_whiten_many(g, x);
    for (int i = 0; i < g->count; i++)
        for (int j = 0; j < REGI_BLOCK_WIDTH; j++)
            sum[j] += x[(size_t)i * REGI_BLOCK_WIDTH + (size_t)j] * x[(size_t)i * REGI_BLOCK_WIDTH + (size_t)j];
    for (int j = 0; j < count; j++)
        left[j] -= g->scale * g->scale * sum[j];
}

/* energy[c]: |tau|^2 to expect, of the mean and of what it leaves open. The gauss is solved. */
static void regi_infer_expect_energy(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    int c = f->model->prior.control_count;
    double square = g->scale * g->scale;
    regi_gauss_explain(g, g->multiplier, f->c, f->next);
    regi_infer_unfold(f, f->c, f->tractions);
    for (int j = 0; j < c; j++) {
        const double *root = f->root + (size_t)j * (size_t)c;
        double left = 0;
        for (int axis = 0; axis < 3; axis++) {
            for (int k = 0; k <= j; k++)
                left += root[k] * root[k];
            for (int e = 0; e < g->exact; e++) {
                const double *row = g->resultants + (size_t)e * (size_t)g->most_loads;
                double along = 0;
                for (int k = 0; k <= j; k++)
                    along += root[k] * row[3 * k + axis];
                left -= along * along;
            }
        }
        f->energy[j] = left;
    }
    for (int j = 0; j < c; j += REGI_BLOCK_WIDTH)
        for (int axis = 0; axis < 3; axis++)
            regi_infer_leave(f, j, axis, f->energy + j);
    for (int j = 0; j < c; j++)
        f->energy[j] =
            (double)sb_v3_dot(f->tractions[j], f->tractions[j]) + square * (f->energy[j] > 0 ? f->energy[j] : 0);
}

/* Loads of some places, while the evidence for them rises. */
static int regi_infer_localise(reg_infer *f)
{
    size_t bytes = (size_t)f->model->prior.control_count * sizeof(double);
    for (int pass = 0; pass < REGI_INFER_LOCAL; pass++) {
        regi_infer_choice before = f->choice, trial = before;
        if (!regi_gauss_solve(&f->gauss))
            return 0;
        regi_infer_expect_energy(f);
        memcpy(f->trial_local, f->local, bytes);
        f->rooted = 0;
        regi_prior_localise(&f->model->prior, REGI_INFER_LENGTH, f->energy, f->local);
        trial.is_local = 1;
        if (!regi_infer_set_prior(f, &trial))
            return 0;
        regi_gauss_reduce(&f->gauss);
        if (!regi_infer_weigh_misfit(f, &trial))
            return 0;
        if (f->temper * (trial.evidence - before.evidence) > (before.is_local ? 0.5 : regi_infer_earned)) {
            f->choice = trial;
            f->gauss.scale = trial.scale;
            continue;
        }
        memcpy(f->local, f->trial_local, bytes);
        f->rooted = 0;
        return regi_infer_set_prior(f, &before);
    }
    return 1;
}

/* ---- the choice ---- */

/* Share of the evidence that counts: neighbouring patches whose residuals are alike are not two data. */
static double regi_infer_find_temper(const reg_infer *f)
{
    const regi_gauss *g = &f->gauss;
    double products = 0, squares = 0, way = 0, length;
    int count = 0;
    for (int i = 0; i < g->count && f->patch_of[i] >= 0; i++, count++) {
        sb_real nearest = SB_REAL_MAX;
        int other = i;
        for (int j = 0; j < g->count && f->patch_of[j] >= 0; j++) {
            sb_vec3 d = sb_v3_sub(f->look.points[f->look.patch_start[f->patch_of[i]]].at,
                                  f->look.points[f->look.patch_start[f->patch_of[j]]].at);
            sb_real square = sb_v3_dot(d, d);
            if (j != i && square < nearest) {
                nearest = square;
                other = j;
            }
        }
        way += other == i ? 0 : (double)sb_sqrt(nearest);
        squares += g->variance[i] * g->variance[i] * g->multiplier[i] * g->multiplier[i];
        products += g->variance[i] * g->multiplier[i] * g->variance[other] * g->multiplier[other];
    }
    if (!(products > 0) || !(squares > 0) || products >= squares || count < 2)
        return 1;
    way /= count;
    length = -way / sbi_dense_log(products / squares);
    return way * way < 3.141592653589793 * length * length ? way * way / (3.141592653589793 * length * length) : 1;
}

/* alike: how many patches are off alike, as those are that one facet, rim or smoothed stretch of noise is under, times
 * the share of their variance that the loads of now leave over, at least 1; left: the same without that bound. Less is
 * left where loads fit what is no motion, more where the motion is longer than one round goes: neither tells of the
 * data, so it has bounds. Taken for as many data errors are loads beyond doubt, which bend the organ as a whole: 1 mm
 * of noise without any motion moved a liver that is seen from above by 2.1 mm on the mean, from a start that was 0.8 mm
 * off. 0: the gauss cannot be solved. */
static int regi_infer_count_alike(reg_infer *f)
{
    const double least = 0.2, most = 0.6;
    const regi_gauss *g = &f->gauss;
    double reach = REGI_INFER_ALIKE * f->model->spacing, gap = (double)f->spacing, sum = 0;
    int count = 0;
    if (!regi_gauss_solve(&f->gauss))
        return 0;
    for (; count < g->count && f->patch_of[count] >= 0; count++)
        sum += g->variance[count] * g->multiplier[count] * g->multiplier[count];
    f->left = sum < least * count ? least : sum > most * count ? most : sum / count;
    f->left *= gap > 0 ? 3.141592653589793 * reach * reach / (gap * gap) : 1;
    f->alike = f->left > 1 ? f->left : 1;
    return 1;
}

/* Misfit and scale again, now that it is known how many patches count as one. */
static int regi_infer_choose_again(reg_infer *f)
{
    regi_gauss_reduce(&f->gauss);
    if (!regi_infer_search_misfit(f, &f->choice))
        return 0;
    regi_infer_set_misfit(f, f->choice.misfit);
    f->gauss.scale = f->choice.scale;
    return regi_gauss_solve(&f->gauss);
}

REGI_API int regi_infer_choose(reg_infer *f)
{
    if (!regi_infer_search(f, &f->choice))
        return 0;
    regi_infer_set_misfit(f, f->choice.misfit);
    f->gauss.scale = f->choice.scale;
    if (!regi_infer_localise(f) || !regi_infer_count_alike(f) || (f->alike > 1 && !regi_infer_choose_again(f)) ||
        !regi_gauss_spectrum(&f->gauss))
        return 0;
    f->temper = regi_infer_find_temper(f);
    f->quality.pressure_margin = (sb_real)(f->temper * f->choice.earned);
    f->quality.prior_margin = (sb_real)(f->temper * (f->choice.evidence - regi_gauss_evidence(&f->gauss, 0)));
    return 1;
}
