/* rod_step: minimises a rod's potential over nodes and frames: a time step, a static solve.
 *
 * Positions x' of a step minimise
 *     1/2 inertia |x' - predicted|^2_M + E(x', theta') - loads.(x' - x) - torques.theta' + dissipation
 * with inertia = 1/(beta dt^2) and the dissipation of ndli_rod_set_viscous; without both that is the static
 * potential. */
#include "band.h"
#include "rod_private.h"

typedef struct ndli_rod_problem {
    double inertia; /* 1/s^2: d a'/d x'; 0: statics */
    int max_newton;
    double tolerance;
} ndli_rod_problem;

/* A state of the minimisation. */
typedef struct ndli_rod_progress {
    double potential, noise; /* J */
    double residual, scale;  /* N: largest of what is left, of what is at work */
    double floor;            /* N: what rounding of positions leaves */
} ndli_rod_progress;

/* ---- potential of a step or solve, and its derivatives, in the shape that is tried ---- */

static ndli_v3 ndli_rod_load(const ndl_rod *rod, int i) { return ndli_madd(rod->force[i], rod->mass[i], rod->gravity); }

/* Of rod->shape, made from try_x and try_theta. */
static ndli_rod_progress ndli_rod_potential(ndl_rod *rod, const ndli_rod_problem *problem)
{
    ndli_rod_sums sums = ndli_rod_shape_energy(rod);
    ndli_rod_progress progress = {0, 0, 0, 0, 0};
    double sizes = 0;
    progress.potential = sums.stretch + sums.bend + sums.twist + sums.grip + sums.viscous;
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 gap = ndli_sub(rod->try_x[i], rod->predicted[i]);
        double work = ndli_dot(ndli_rod_load(rod, i), ndli_sub(rod->try_x[i], rod->x[i])), inertia = 0;
        if (!rod->held[i])
            inertia = 0.5 * problem->inertia * rod->mass[i] * ndli_dot(gap, gap);
        progress.potential += inertia - work;
        sizes += inertia + fabs(work);
    }
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        progress.potential -= rod->torque[j] * rod->try_theta[j];
        sizes += fabs(rod->torque[j] * rod->try_theta[j]);
    }
    progress.noise = sums.noise + 4.5e-15 * sizes;
    return progress;
}

/* gradient and turn_gradient of the whole potential, matrix (NULL: not wanted) of its elastic part, and what is out of
 * balance. */
static void ndli_rod_balance(ndl_rod *rod, const ndli_rod_problem *problem, int flags, ndli_rod_matrix *matrix,
                             ndli_rod_progress *progress)
{
    int any_held = ndli_rod_any_turn_held(rod);
    double rounding = 4.5e-16 * rod->stretch * (1 + rod->viscous_stretch) * ndli_rod_reach(rod);
    ndli_rod_derivatives(rod, flags, rod->gradient, rod->turn_gradient, matrix);
    progress->residual = progress->scale = progress->floor = 0;
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 load = ndli_rod_load(rod, i), inertia = ndli_v(0, 0, 0);
        if (!rod->held[i])
            inertia = ndli_scale(problem->inertia * rod->mass[i], ndli_sub(rod->try_x[i], rod->predicted[i]));
        progress->scale = fmax(progress->scale, ndli_norm(load));
        progress->scale = fmax(progress->scale, ndli_norm(inertia));
        progress->scale = fmax(progress->scale, ndli_norm(rod->gradient[i]));
        rod->gradient[i] = ndli_add(rod->gradient[i], ndli_sub(inertia, load));
        if (!rod->held[i])
            progress->residual = fmax(progress->residual, ndli_norm(rod->gradient[i]));
    }
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double per_length = 1 / rod->rest_length[j];
        progress->scale = fmax(progress->scale, fabs(rod->turn_gradient[j]) * per_length);
        progress->scale = fmax(progress->scale, fabs(ndli_rod_grip_moment(rod, j, rod->shape.lag[j])) * per_length);
        rod->turn_gradient[j] -= rod->torque[j];
        if (!ndli_rod_turn_known(rod, j, any_held))
            progress->residual = fmax(progress->residual, fabs(rod->turn_gradient[j]) * per_length);
        progress->floor = fmax(progress->floor, rounding * per_length);
    }
    progress->floor += 4.5e-16 * progress->scale;
}

/* ---- the linear system ---- */

static double *ndli_rod_band_at(ndl_rod *rod, int row, int column)
{
    return rod->band + row * (NDLI_ROD_WIDTH + 1) + NDLI_ROD_WIDTH + column - row;
}

/* unknown -= K moves, for the lower half in rod->matrix and moves step_x. */
static void ndli_rod_subtract_moves(ndl_rod *rod)
{
    for (int i = 0; i < rod->node_count; i++)
        for (int k = 0; k < 3 && k <= i; k++) {
            const ndli_m3 *block = &rod->matrix.node[i][k];
            ndli_v3 down = ndli_m_apply(block, rod->step_x[i - k]), up = ndli_m_tapply(block, rod->step_x[i]);
            for (int c = 0; c < 3; c++) {
                rod->unknown[4 * i + c] -= ndli_component(down, c);
                if (k > 0)
                    rod->unknown[4 * (i - k) + c] -= ndli_component(up, c);
            }
        }
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        for (int k = 0; k < 4; k++)
            if (j - 1 + k >= 0 && j - 1 + k < rod->node_count)
                rod->unknown[4 * j + 3] -= ndli_dot(rod->matrix.cross[j][k], rod->step_x[j - 1 + k]);
}

/* Right-hand side: minus the gradient, less what the moves of held nodes (in step_x) already bring. */
static void ndli_rod_set_right_side(ndl_rod *rod)
{
    for (int i = 0; i < rod->node_count; i++) {
        for (int c = 0; c < 3; c++)
            rod->unknown[4 * i + c] = -ndli_component(rod->gradient[i], c);
        rod->unknown[4 * i + 3] = i < ndli_rod_edges(rod) ? -rod->turn_gradient[i] : 0;
    }
    ndli_rod_subtract_moves(rod);
}

static void ndli_rod_fill_band(ndl_rod *rod)
{
    memset(rod->band, 0, 4 * (size_t)rod->node_count * (NDLI_ROD_WIDTH + 1) * sizeof *rod->band);
    for (int i = 0; i < rod->node_count; i++)
        for (int k = 0; k < 3 && k <= i; k++)
            for (int r = 0; r < 3; r++)
                for (int c = 0; c < (k ? 3 : r + 1); c++)
                    *ndli_rod_band_at(rod, 4 * i + r, 4 * (i - k) + c) = rod->matrix.node[i][k].m[r][c];
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        for (int k = 0; k < 4; k++)
            for (int c = 0; c < 3; c++) {
                int node = 4 * (j - 1 + k) + c, turn = 4 * j + 3;
                if (node >= 0 && node < 4 * rod->node_count)
                    *ndli_rod_band_at(rod, sbi_max_int(node, turn), sbi_min_int(node, turn)) =
                        ndli_component(rod->matrix.cross[j][k], c);
            }
        *ndli_rod_band_at(rod, 4 * j + 3, 4 * j + 3) = rod->matrix.turn[j] + ndli_rod_turn_floor(rod, j);
        if (j > 0)
            *ndli_rod_band_at(rod, 4 * j + 3, 4 * j - 1) = rod->matrix.turn_before[j];
    }
}

/* Rows and columns of what is no unknown become those of the identity; the diagonal grows by the share `shift`. */
static void ndli_rod_pin_band(ndl_rod *rod, double shift)
{
    int n = 4 * rod->node_count, any_held = ndli_rod_any_turn_held(rod);
    for (int row = 0; row < n; row++) {
        int i = row / 4;
        int known = row % 4 < 3 ? rod->held[i] : i == ndli_rod_edges(rod) || ndli_rod_turn_known(rod, i, any_held);
        *ndli_rod_band_at(rod, row, row) *= 1 + shift;
        if (!known)
            continue;
        for (int other = sbi_max_int(0, row - NDLI_ROD_WIDTH); other <= sbi_min_int(n - 1, row + NDLI_ROD_WIDTH);
             other++)
            *ndli_rod_band_at(rod, sbi_max_int(row, other), sbi_min_int(row, other)) = 0;
        *ndli_rod_band_at(rod, row, row) = 1;
        rod->unknown[row] = 0;
    }
}

/* step_x, step_theta = the Newton step, held nodes to their targets. 0: the matrix is not positive definite. */
static int ndli_rod_solve_step(ndl_rod *rod, const ndli_rod_problem *problem, double shift)
{
    for (int i = 0; i < rod->node_count; i++)
        rod->step_x[i] = rod->held[i] ? ndli_sub(rod->predicted[i], rod->try_x[i]) : ndli_v(0, 0, 0);
    ndli_rod_set_right_side(rod);
    for (int i = 0; i < rod->node_count; i++)
        ndli_m_add_identity(&rod->matrix.node[i][0], problem->inertia * rod->mass[i]);
    ndli_rod_fill_band(rod);
    ndli_rod_pin_band(rod, shift);
    if (ndli_band_factor(rod->band, 4 * rod->node_count, NDLI_ROD_WIDTH, 1e-15) >= 0)
        return 0;
    ndli_band_solve(rod->band, 4 * rod->node_count, NDLI_ROD_WIDTH, rod->unknown);
    for (int i = 0; i < rod->node_count; i++) {
        const double *u = rod->unknown + 4 * i;
        if (!rod->held[i])
            rod->step_x[i] = ndli_v(u[0], u[1], u[2]);
        rod->step_theta[i] = u[3];
        if (!ndli_is_finite(ndli_norm(rod->step_x[i])) || !ndli_is_finite(u[3]))
            return 0;
    }
    return 1;
}

/* ---- a Newton step, taken ---- */

/* The edge j after the step of this size: turned by its part across, made longer by its part along. */
static ndli_v3 ndli_rod_turned_edge(const ndl_rod *rod, int j, double size)
{
    ndli_v3 e = ndli_sub(rod->best_x[j + 1], rod->best_x[j]), t, moved;
    ndli_v3 change = ndli_scale(size, ndli_sub(rod->step_x[j + 1], rod->step_x[j]));
    double l = ndli_norm(e), along;
    t = ndli_scale(1 / l, e);
    along = ndli_dot(t, change);
    moved = ndli_madd(ndli_add(e, change), -along, t);
    return ndli_scale((l + along) / ndli_norm(moved), moved);
}

/* Nodes from `first`, which is in place, to `last`: edges turned one after the other; what then is missing at a held
 * last node goes to all in between by their distance. */
static void ndli_rod_lay_edges(ndl_rod *rod, double size, int first, int last, int held)
{
    ndli_v3 end = ndli_madd(rod->best_x[last], size, rod->step_x[last]), missing;
    double whole = 0, passed = 0;
    for (int j = first; j < last; j++) {
        rod->try_x[j + 1] = ndli_add(rod->try_x[j], ndli_rod_turned_edge(rod, j, size));
        whole += rod->rest_length[j];
    }
    if (!held)
        return;
    missing = ndli_sub(end, rod->try_x[last]);
    for (int j = first; j < last; j++) {
        passed += rod->rest_length[j];
        rod->try_x[j + 1] = ndli_madd(rod->try_x[j + 1], passed / whole, missing);
    }
    rod->try_x[last] = end;
}

/* try_x, try_theta = best and `size` steps. A chain turns its edges: along straight lines they would stretch, and a
 * needle's stiffness against that would forbid all but tiny steps. */
static void ndli_rod_take(ndl_rod *rod, const ndli_rod_problem *problem, double size)
{
    int n = rod->node_count, first = 0, at;
    for (int j = 0; j < n - 1; j++)
        rod->try_theta[j] = rod->best_theta[j] + size * rod->step_theta[j];
    for (int i = 0; i < n; i++)
        rod->try_x[i] = ndli_madd(rod->best_x[i], size, rod->step_x[i]);
    if (problem->max_newton == 1)
        return;
    while (first < n && !rod->held[first])
        first++;
    first = first == n ? 0 : first;
    for (int j = first - 1; j >= 0; j--)
        rod->try_x[j] = ndli_sub(rod->try_x[j + 1], ndli_rod_turned_edge(rod, j, size));
    at = first;
    for (int i = first + 1; i < n; i++)
        if (rod->held[i] || i == n - 1) {
            ndli_rod_lay_edges(rod, size, at, i, rod->held[i]);
            at = i;
        }
}

/* The largest part of the step that turns no edge by more than about a radian. */
static double ndli_rod_largest_size(const ndl_rod *rod)
{
    double largest = 1;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double change = ndli_norm(ndli_sub(rod->step_x[j + 1], rod->step_x[j]));
        double length = ndli_norm(ndli_sub(rod->best_x[j + 1], rod->best_x[j]));
        if (change * largest > length)
            largest = length / change;
    }
    return largest;
}

static double ndli_rod_slope(const ndl_rod *rod)
{
    double slope = 0;
    for (int i = 0; i < rod->node_count; i++)
        if (!rod->held[i])
            slope += ndli_dot(rod->gradient[i], rod->step_x[i]);
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        slope += rod->turn_gradient[j] * rod->step_theta[j];
    return slope;
}

/* Whether held nodes still have some way to go; then the potential may rise, by their work. */
static int ndli_rod_supports_move(const ndl_rod *rod)
{
    for (int i = 0; i < rod->node_count; i++)
        if (rod->held[i] && ndli_norm(ndli_sub(rod->predicted[i], rod->try_x[i])) > 0)
            return 1;
    return 0;
}

/* Halves the step until it is possible and the potential falls. try_x, try_theta and rod->shape are there then, and
 * progress has its potential; 0: no such step. */
static int ndli_rod_search(ndl_rod *rod, const ndli_rod_problem *problem, int free_to_rise, double slope,
                           ndli_rod_progress *progress)
{
    double size = problem->max_newton == 1 ? 1 : ndli_rod_largest_size(rod);
    for (int halving = 0; halving < 40; halving++, size *= 0.5) {
        ndli_rod_progress next;
        ndli_rod_take(rod, problem, size);
        if (size == 1)
            for (int i = 0; i < rod->node_count; i++)
                if (rod->held[i])
                    rod->try_x[i] = rod->predicted[i]; /* to the last bit */
        if (ndli_rod_set_shape(rod, rod->try_x, rod->try_theta) >= 0)
            continue;
        next = ndli_rod_potential(rod, problem);
        if (problem->max_newton == 1 || free_to_rise ||
            next.potential <= progress->potential + 1e-4 * size * slope + next.noise) {
            *progress = next;
            return 1;
        }
    }
    return 0;
}

/* From now on frames are carried from rod->shape: an edge may then turn by any angle in the iterations of a step. */
static void ndli_rod_carry_frames(ndl_rod *rod)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        rod->tangent[j] = rod->shape.tangent[j];
        rod->director[j] = ndli_rod_across(rod->shape.director[j], rod->shape.tangent[j]);
    }
}

/* The step of a matrix that is not positive definite, at rest: its diagonal grows by the least share, within a factor
 * of two, that makes it so. Near buckling one eigenvalue is about 0, next to nothing beside the diagonal, which
 * stretching has: with more the rod would creep along that motion. 0: no share does. */
static int ndli_rod_solve_shifted(ndl_rod *rod, const ndli_rod_problem *problem)
{
    const double least = 1e-13, most = 0.1; /* from rounding of the diagonal to what changes all of it */
    double shift = least;
    int solved;
    while (!(solved = ndli_rod_solve_step(rod, problem, shift)) && shift < most)
        shift *= 16;
    for (double factor = 4; solved && factor > 1.5 && shift > least; factor = sqrt(factor))
        if (ndli_rod_solve_step(rod, problem, shift / factor))
            shift /= factor;
        else
            solved = ndli_rod_solve_step(rod, problem, shift);
    return solved;
}

/* The ways to a step, in their order. */
typedef enum ndli_rod_way {
    NDLI_ROD_NEWTON,  /* the exact Hessian */
    NDLI_ROD_SHIFTED, /* the same made positive definite, at rest; in time the inertia does that */
    NDLI_ROD_GAUSS,   /* Gauss-Newton, and with larger diagonals */
    NDLI_ROD_GAUSS_MORE,
    NDLI_ROD_GAUSS_MOST,
    NDLI_ROD_WAYS
} ndli_rod_way;

static int ndli_rod_solve_way(ndl_rod *rod, const ndli_rod_problem *problem, ndli_rod_way way)
{
    static const double shifts[NDLI_ROD_WAYS] = {0, 0, 0, 1e-10, 1e-5};
    ndli_rod_progress again;
    ndli_rod_balance(rod, problem, way <= NDLI_ROD_SHIFTED ? NDLI_ROD_EXACT : 0, &rod->matrix, &again);
    if (way == NDLI_ROD_SHIFTED)
        return ndli_rod_solve_shifted(rod, problem);
    return ndli_rod_solve_step(rod, problem, shifts[way]);
}

/* try_x, try_theta and rod->shape of where the iteration began. */
static void ndli_rod_begin_again(ndl_rod *rod)
{
    memcpy(rod->try_x, rod->best_x, (size_t)rod->node_count * sizeof *rod->best_x);
    memcpy(rod->try_theta, rod->best_theta, (size_t)rod->node_count * sizeof *rod->best_theta);
    ndli_rod_set_shape(rod, rod->try_x, rod->try_theta);
}

/* Goes one way, if its matrix is positive definite and its step leads down; try_x, try_theta, rod->shape and progress
 * are then of where it led. */
static int ndli_rod_go(ndl_rod *rod, const ndli_rod_problem *problem, ndli_rod_way way, ndli_rod_progress *progress)
{
    int moving = ndli_rod_supports_move(rod);
    double slope;
    if (!ndli_rod_solve_way(rod, problem, way))
        return 0;
    slope = ndli_rod_slope(rod);
    return (moving || slope < 0) && ndli_rod_search(rod, problem, moving, slope, progress);
}

/* At rest, where the exact Hessian is not positive definite: the same made so leads along the motion in which the rod
 * buckles, Gauss-Newton to a rod that has buckled far. The one that leads farther down is taken. */
static int ndli_rod_go_lower(ndl_rod *rod, const ndli_rod_problem *problem, ndli_rod_progress *progress)
{
    ndli_rod_progress shifted = *progress, gauss = *progress;
    int first = ndli_rod_go(rod, problem, NDLI_ROD_SHIFTED, &shifted), second;
    ndli_rod_begin_again(rod);
    second = ndli_rod_go(rod, problem, NDLI_ROD_GAUSS, &gauss);
    if (second && !(first && shifted.potential < gauss.potential)) {
        *progress = gauss;
        return 1;
    }
    ndli_rod_begin_again(rod);
    return first && ndli_rod_go(rod, problem, NDLI_ROD_SHIFTED, progress);
}

/* One iteration from try_x, try_theta, which rod->shape is made from, by the first way that leads down. 0: none does;
 * all is as before. */
static int ndli_rod_iterate(ndl_rod *rod, const ndli_rod_problem *problem, ndli_rod_progress *progress)
{
    memcpy(rod->best_x, rod->try_x, (size_t)rod->node_count * sizeof *rod->best_x);
    memcpy(rod->best_theta, rod->try_theta, (size_t)rod->node_count * sizeof *rod->best_theta);
    if (problem->max_newton > 1 && ndli_rod_go(rod, problem, NDLI_ROD_NEWTON, progress))
        return 1;
    if (problem->max_newton > 1)
        ndli_rod_begin_again(rod);
    if (problem->inertia == 0 && ndli_rod_go_lower(rod, problem, progress))
        return 1;
    for (int way = problem->inertia == 0 ? NDLI_ROD_GAUSS_MORE : NDLI_ROD_GAUSS; way < NDLI_ROD_WAYS; way++) {
        if (way > NDLI_ROD_GAUSS)
            ndli_rod_begin_again(rod);
        if (ndli_rod_go(rod, problem, (ndli_rod_way)way, progress))
            return 1;
    }
    ndli_rod_begin_again(rod);
    return 0;
}

/* From try_x and try_theta to where the potential is least; predicted says where held nodes go. SB_OK also when
 * capped. */
static sb_result ndli_rod_minimise(ndl_rod *rod, const ndli_rod_problem *problem, ndl_rod_info *info)
{
    ndli_rod_progress progress;
    if (ndli_rod_set_shape(rod, rod->try_x, rod->try_theta) >= 0)
        return SB_ERROR_DIVERGED;
    progress = ndli_rod_potential(rod, problem);
    info->capped = 0;
    for (int iteration = 0;; iteration++) {
        ndli_rod_progress now;
        int moving = ndli_rod_supports_move(rod);
        ndli_rod_balance(rod, problem, 0, NULL, &now);
        info->residual = (sb_real)(now.scale > 0 ? now.residual / now.scale : 0);
        if (!ndli_is_finite(now.residual))
            return SB_ERROR_DIVERGED;
        if (!moving && now.residual <= problem->tolerance * now.scale + now.floor)
            return SB_OK;
        if (iteration == problem->max_newton) {
            info->capped = 1;
            return moving ? SB_ERROR_DIVERGED : SB_OK;
        }
        if (!ndli_rod_iterate(rod, problem, &progress))
            return now.residual <= 1e3 * now.floor ? SB_OK : SB_ERROR_DIVERGED;
        ndli_rod_carry_frames(rod);
        info->newton_iterations++;
    }
}

/* ---- common to steps and static solves ---- */

static sb_result ndli_rod_fail(ndl_rod_info *info, sb_result result, const char *message)
{
    return sbi_fail(&info->error, result, "%s", message);
}

/* try_theta = theta with `share` of the turns that are due, the base's director for nodes held at `predicted`. */
static void ndli_rod_set_turns(ndl_rod *rod, double share)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        rod->try_theta[j] = rod->theta[j] + share * rod->turn[j];
    if (rod->base_director_set) {
        ndli_v3 e = ndli_sub(rod->target[1], rod->target[0]), t = ndli_scale(1 / ndli_norm(e), e), d, m1, wanted;
        double s, c;
        d = ndli_rod_transport(rod->tangent[0], t, rod->director[0]);
        sbi_dense_sin_cos(rod->theta[0], &s, &c);
        m1 = ndli_madd(ndli_scale(c, d), s, ndli_cross(t, d));
        wanted = rod->base_director;
        rod->try_theta[0] += share * sbi_dense_atan2(ndli_dot(ndli_cross(m1, wanted), t), ndli_dot(m1, wanted));
    }
}

static void ndli_rod_clear_turns(ndl_rod *rod)
{
    memset(rod->turn, 0, (size_t)rod->node_count * sizeof *rod->turn);
    rod->base_director_set = 0;
}

static int ndli_rod_any(const unsigned char *flags, int count)
{
    for (int i = 0; i < count; i++)
        if (flags[i])
            return 1;
    return 0;
}

static int ndli_rod_any_torque(const ndl_rod *rod)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        if (rod->torque[j] != 0)
            return 1;
    return 0;
}

/* What the supports exert, from the state. */
static void ndli_rod_read_reactions(ndl_rod *rod)
{
    ndli_rod_derivatives(rod, 0, rod->gradient, rod->turn_gradient, NULL);
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 force = ndli_sub(rod->gradient[i], ndli_rod_load(rod, i));
        rod->reaction[i] = rod->held[i] ? ndli_madd(force, rod->mass[i], rod->a[i]) : ndli_v(0, 0, 0);
    }
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        rod->reaction_torque[j] = rod->turn_held[j] ? rod->turn_gradient[j] - rod->torque[j] : 0;
}

/* ---- time step ---- */

/* Energy (J) of the state, loads' potential included; *lively: what of it is motion and strain. */
static double ndli_rod_total_energy(ndl_rod *rod, double *lively)
{
    ndli_rod_sums sums;
    double energy;
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    sums = ndli_rod_shape_energy(rod);
    energy = sums.stretch + sums.bend + sums.twist + sums.grip;
    for (int i = 0; i < rod->node_count; i++)
        energy += 0.5 * rod->mass[i] * ndli_dot(rod->v[i], rod->v[i]);
    *lively = energy;
    for (int i = 0; i < rod->node_count; i++)
        energy -= ndli_dot(ndli_rod_load(rod, i), rod->x[i]);
    return energy;
}

/* Takes from the new accelerations of a rod that nothing holds, as a whole, what the loads do not account for: what
 * Newton leaves out of balance would add up over the steps. */
static void ndli_rod_keep_momentum(ndl_rod *rod, const ndli_rod_problem *problem, double gamma_dt)
{
    ndli_v3 defect = ndli_v(0, 0, 0);
    double mass = 0;
    if (ndli_rod_any(rod->held, rod->node_count))
        return;
    for (int i = 0; i < rod->node_count; i++) {
        defect = ndli_add(defect, ndli_madd(ndli_rod_load(rod, i), -rod->mass[i], rod->a[i]));
        mass += rod->mass[i];
    }
    defect = ndli_scale(1 / mass, defect);
    for (int i = 0; i < rod->node_count; i++) {
        rod->a[i] = ndli_add(rod->a[i], defect);
        rod->v[i] = ndli_madd(rod->v[i], gamma_dt, defect);
        rod->x[i] = ndli_madd(rod->x[i], 1 / problem->inertia, defect);
    }
}

/* Newmark with beta = 1/4, gamma = 1/2; or implicit Euler, which is beta = gamma = 1 without the old acceleration. */
static sb_result ndli_rod_try_step(ndl_rod *rod, double dt, int euler, ndl_rod_info *info)
{
    double beta = euler ? 1 : 0.25, gamma = euler ? 1 : 0.5, keep = euler ? 0 : 1;
    ndli_rod_problem problem;
    sb_result result;
    problem.inertia = 1 / (beta * dt * dt);
    problem.max_newton = rod->max_newton;
    problem.tolerance = rod->tolerance;
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 to = ndli_madd(rod->x[i], dt, rod->v[i]), target = rod->target[i];
        rod->predicted[i] = rod->held[i] ? target : ndli_madd(to, keep * dt * dt * (0.5 - beta), rod->a[i]);
        rod->try_x[i] = rod->x[i];
    }
    ndli_rod_set_turns(rod, 1);
    ndli_rod_set_viscous(rod, rod->damping_stretch * gamma / (beta * dt), rod->damping_bending * gamma / (beta * dt),
                         keep * 0.5 * dt);
    result = ndli_rod_minimise(rod, &problem, info);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 v =
            rod->has_velocity[i] ? rod->target_velocity[i] : ndli_scale(1 / dt, ndli_sub(rod->try_x[i], rod->x[i]));
        if (rod->held[i]) {
            rod->a[i] = ndli_scale(1 / dt, ndli_sub(v, rod->v[i]));
        } else {
            v = ndli_madd(rod->v[i], keep * dt * (1 - gamma), rod->a[i]);
            rod->a[i] = ndli_scale(problem.inertia, ndli_sub(rod->try_x[i], rod->predicted[i]));
            v = ndli_madd(v, gamma * dt, rod->a[i]);
        }
        rod->v[i] = v;
        rod->x[i] = rod->try_x[i];
    }
    ndli_rod_keep_momentum(rod, &problem, gamma * dt);
    for (int i = 0; i < rod->node_count; i++) /* in sb_real, too */
        if (!sb_v3_is_finite(ndli_to(rod->x[i])) || !sb_v3_is_finite(ndli_to(rod->v[i])) ||
            !ndli_is_finite(ndli_norm(rod->a[i])))
            return SB_ERROR_DIVERGED;
    memcpy(rod->theta, rod->try_theta, (size_t)ndli_rod_edges(rod) * sizeof *rod->theta);
    return ndli_rod_moved(rod) < 0 ? SB_OK : SB_ERROR_DIVERGED;
}

/* Whether the step has energy that came from nowhere. */
static int ndli_rod_gained(ndl_rod *rod)
{
    double lively, energy = ndli_rod_total_energy(rod, &lively);
    return energy - rod->energy_before > 0.01 * lively;
}

/* Starts or ends the energy monitor; 1 when it may be held against the step. */
static int ndli_rod_monitor_energy(ndl_rod *rod)
{
    double lively;
    int busy = ndli_rod_any_torque(rod) || rod->base_director_set;
    for (int i = 0; i < rod->node_count; i++)
        busy = busy || rod->turn[i] != 0 ||
               (rod->held[i] && (rod->has_velocity[i] || ndli_norm(ndli_sub(rod->target[i], rod->x[i])) > 0));
    if (busy) {
        rod->energy_monitored = 0;
    } else if (!rod->energy_monitored) {
        rod->energy_before = ndli_rod_total_energy(rod, &lively);
        rod->energy_monitored = 1;
    }
    return !busy;
}

NDLI_API int ndli_rod_step_euler(ndl_rod *rod, double dt)
{
    ndl_rod_info info;
    sb_result result;
    memset(&info, 0, sizeof info);
    ndli_rod_save(rod);
    result = ndli_rod_try_step(rod, dt, 1, &info);
    if (result == SB_OK)
        ndli_rod_read_reactions(rod);
    ndli_rod_set_viscous(rod, 0, 0, 0);
    if (result != SB_OK)
        ndli_rod_restore(rod);
    return result == SB_OK;
}

NDL_API sb_result ndl_rod_step(ndl_rod *rod, sb_real dt, ndl_rod_info *info)
{
    ndl_rod_info local;
    sb_result result;
    int watched;
    info = info ? info : &local;
    memset(info, 0, sizeof *info);
    if (!rod || !(dt > 0) || !sb_is_finite(dt))
        return ndli_rod_fail(info, SB_ERROR_ARGUMENT, "rod is NULL, or dt is not above 0");
    if (!ndli_rod_any_turn_held(rod) && ndli_rod_any_torque(rod))
        return ndli_rod_fail(info, SB_ERROR_UNCONSTRAINED, "a torque acts, but no edge is held against turning");
    watched = ndli_rod_monitor_energy(rod);
    ndli_rod_save(rod);
    result = ndli_rod_try_step(rod, (double)dt, 0, info);
    if (watched && (result != SB_OK || ndli_rod_gained(rod))) {
        ndli_rod_restore(rod);
        info->damped = 1;
        result = ndli_rod_try_step(rod, (double)dt, 1, info);
    }
    if (result == SB_OK)
        ndli_rod_read_reactions(rod);
    ndli_rod_set_viscous(rod, 0, 0, 0);
    if (result != SB_OK) {
        ndli_rod_restore(rod);
        return ndli_rod_fail(info, result, "Newton found no step that lowers the potential; the step was undone");
    }
    ndli_rod_clear_turns(rod);
    ndli_rod_publish(rod);
    info->error.element = info->error.node = -1;
    return SB_OK;
}

/* ---- statics ---- */

/* In how many pieces supports and turns go where they must: a quarter of the shortest edge, a radian. */
static int ndli_rod_pieces(const ndl_rod *rod)
{
    double shortest = rod->rest_length[0], farthest = 0, most = 0;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        shortest = fmin(shortest, rod->rest_length[j]);
        most = fmax(most, fabs(rod->turn[j]));
    }
    for (int i = 0; i < rod->node_count; i++)
        if (rod->held[i])
            farthest = fmax(farthest, ndli_norm(ndli_sub(rod->target[i], rod->x[i])));
    return (int)fmin(1000, 1 + floor(fmax(4 * farthest / shortest, most)));
}

/* Moves the supports the share still to go, and finds the equilibrium there. */
static sb_result ndli_rod_solve_piece(ndl_rod *rod, const ndli_rod_problem *problem, double share, ndl_rod_info *info)
{
    sb_result result;
    for (int i = 0; i < rod->node_count; i++) {
        rod->predicted[i] = rod->x[i];
        if (rod->held[i])
            rod->predicted[i] =
                share < 1 ? ndli_madd(rod->x[i], share, ndli_sub(rod->target[i], rod->x[i])) : rod->target[i];
        rod->try_x[i] = rod->x[i];
    }
    ndli_rod_set_turns(rod, share);
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        rod->turn[j] *= 1 - share;
    result = ndli_rod_minimise(rod, problem, info);
    if (result != SB_OK)
        return result;
    memcpy(rod->x, rod->try_x, (size_t)rod->node_count * sizeof *rod->x);
    memcpy(rod->theta, rod->try_theta, (size_t)ndli_rod_edges(rod) * sizeof *rod->theta);
    return ndli_rod_follow(rod) < 0 ? SB_OK : SB_ERROR_DIVERGED;
}

static sb_result ndli_rod_solve_pieces(ndl_rod *rod, const ndl_rod_static_options *options, ndl_rod_info *info)
{
    ndli_rod_problem problem = {0, 20, 0.01};
    int pieces = ndli_rod_pieces(rod), most = options->max_newton;
    sb_result result = SB_OK;
    for (int piece = 0; piece < pieces - 1 && result == SB_OK; piece++)
        result = ndli_rod_solve_piece(rod, &problem, 1.0 / (pieces - piece), info);
    problem.tolerance = (double)options->tolerance;
    for (int done = 0; result == SB_OK && done < most; done += problem.max_newton) {
        /* frames are measured from where the last round ended: none may turn far between two */
        problem.max_newton = sbi_max_int(2, sbi_min_int(10, most - done));
        result = ndli_rod_solve_piece(rod, &problem, 1, info);
        rod->base_director_set = 0;
        if (!info->capped)
            break;
    }
    return result == SB_OK && info->capped ? SB_ERROR_NOT_CONVERGED : result;
}

NDL_API sb_result ndl_rod_solve_static(ndl_rod *rod, const ndl_rod_static_options *options, ndl_rod_info *info)
{
    ndl_rod_static_options defaults = ndl_default_rod_static_options();
    ndl_rod_info local;
    sb_result result;
    size_t n;
    int base_director_set;
    info = info ? info : &local;
    memset(info, 0, sizeof *info);
    options = options ? options : &defaults;
    if (!rod || !ndli_rod_static_options_valid(options))
        return ndli_rod_fail(info, SB_ERROR_ARGUMENT, "rod is NULL, or options are out of range");
    if (!ndli_rod_any(rod->held, rod->node_count))
        return ndli_rod_fail(info, SB_ERROR_UNCONSTRAINED, "no node is held");
    if (!ndli_rod_any_turn_held(rod) && ndli_rod_any_torque(rod))
        return ndli_rod_fail(info, SB_ERROR_UNCONSTRAINED, "a torque acts, but no edge is held against turning");
    n = (size_t)rod->node_count;
    ndli_rod_save(rod);
    base_director_set = rod->base_director_set;
    memcpy(rod->saved_turns, rod->turn, n * sizeof *rod->turn);
    result = ndli_rod_solve_pieces(rod, options, info);
    if (result != SB_OK) {
        ndli_rod_restore(rod);
        memcpy(rod->turn, rod->saved_turns, n * sizeof *rod->turn);
        rod->base_director_set = base_director_set;
        return ndli_rod_fail(info, result,
                             result == SB_ERROR_NOT_CONVERGED
                                 ? "max_newton was reached; the rod is as it was"
                                 : "Newton found no step that lowers the energy; the rod is as it was");
    }
    memset(rod->v, 0, n * sizeof *rod->v);
    memset(rod->a, 0, n * sizeof *rod->a);
    ndli_rod_clear_turns(rod);
    ndli_rod_slip(rod);
    ndli_rod_read_reactions(rod);
    rod->energy_monitored = 0;
    ndli_rod_publish(rod);
    info->error.element = info->error.node = -1;
    return SB_OK;
}
