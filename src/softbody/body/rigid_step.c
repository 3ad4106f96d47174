/* rigid_step: free rigid bodies in a step: guests that take the nodes that hang on them.
 *
 * A rigid body's unknowns are the way d of its centre and the rotation vector th from its turn at the start, so that
 *     x_i = c + d + E R X_i,  E = exp(th),  and  dx_i = dd + (H dth) x y_i,  y_i = E R X_i,
 * H the left Jacobian of exp. Where increments of nodes are T_i of those of the unknowns, as `place` makes the start of
 * each solve and M^-1 = N K^-1 N^T, N = (1, T), keeps it, conjugate gradients see the equations with T eliminated; of
 * residuals and products they get N^T, in which the forces that hold the nodes to each other are not. A line search
 * tries shapes in which the nodes are where their rigid body has them, whatever the share.
 *
 * With w and w' in the frame at the start (R W, R W', W in the body's own) the schemes' rules for d hold for th (Bruels
 * and Cardona 2010), and torques balance as E (J w' + w x J w) = t. Implicit Euler has (E J w - J w_n) / dt = t
 * instead, which is the same to first order and keeps the angular momentum. */
#include <math.h>
#include <string.h>

#include "rigid_private.h"

#include "step_private.h"

enum { SBI_RIGID_ROUNDS = 12, SBI_RIGID_GUESSES = 30 };

/* ---- 3-vectors and 3x3 matrices, row-major ---- */

static void sbi_rigid_cross(const double a[3], const double b[3], double out[3])
{
    double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2], z = a[0] * b[1] - a[1] * b[0];
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

static double sbi_rigid_norm(const double a[3]) { return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); }

static void sbi_rigid_apply(const double m[9], const double v[3], double out[3])
{
    double x = m[0] * v[0] + m[1] * v[1] + m[2] * v[2], y = m[3] * v[0] + m[4] * v[1] + m[5] * v[2];
    double z = m[6] * v[0] + m[7] * v[1] + m[8] * v[2];
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

/* out = m^T v */
static void sbi_rigid_tapply(const double m[9], const double v[3], double out[3])
{
    double x = m[0] * v[0] + m[3] * v[1] + m[6] * v[2], y = m[1] * v[0] + m[4] * v[1] + m[7] * v[2];
    double z = m[2] * v[0] + m[5] * v[1] + m[8] * v[2];
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

/* out = a b a^T */
static void sbi_rigid_turn_matrix(const double a[9], const double b[9], double out[9])
{
    double c[9];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = c[3 * i] * a[3 * j] + c[3 * i + 1] * a[3 * j + 1] + c[3 * i + 2] * a[3 * j + 2];
}

/* m = s [v]x + m */
static void sbi_rigid_add_skew(double s, const double v[3], double m[9])
{
    m[1] -= s * v[2];
    m[2] += s * v[1];
    m[3] += s * v[2];
    m[5] -= s * v[0];
    m[6] -= s * v[1];
    m[7] += s * v[0];
}

static const double sbi_rigid_unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};

static void sbi_rigid_exp(const double th[3], double q[4])
{
    double angle = sbi_rigid_norm(th), s, c, factor;
    sbi_dense_sin_cos(angle / 2, &s, &c);
    factor = angle > 0 ? s / angle : 0.5;
    q[0] = c;
    for (int k = 0; k < 3; k++)
        q[1 + k] = factor * th[k];
}

static void sbi_rigid_exp_matrix(const double th[3], double e[9])
{
    double q[4];
    sbi_rigid_exp(th, q);
    sbi_rigid_matrix(q, e);
}

/* H = 1 + (1 - cos a) / a^2 [th]x + (a - sin a) / a^3 [th]x^2, a = |th|; of small angles by series. */
static void sbi_rigid_jacobian(const double th[3], double h[9])
{
    double a = sbi_rigid_norm(th), a2 = a * a, first = 0.5 - a2 / 24, second = 1.0 / 6 - a2 / 120, s, c;
    if (a > 1e-3) { /* where the series' next terms, a^4 / 720, are below rounding */
        sbi_dense_sin_cos(a / 2, &s, &c);
        first = 2 * s * s / a2;
        second = (a - 2 * s * c) / (a2 * a);
    }
    memcpy(h, sbi_rigid_unit, sizeof sbi_rigid_unit);
    sbi_rigid_add_skew(first, th, h);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            h[3 * i + j] += second * (th[i] * th[j] - (i == j ? a2 : 0));
}

/* v = m^-1 v, with m scaled by its largest entry; 0: it has no inverse. */
static int sbi_rigid_solve3(const double m[9], double v[3])
{
    double a[3] = {m[0], m[3], m[6]}, b[3] = {m[1], m[4], m[7]}, c[3] = {m[2], m[5], m[8]};
    double bc[3], ca[3], ab[3], det, x[3];
    sbi_rigid_cross(b, c, bc);
    sbi_rigid_cross(c, a, ca);
    sbi_rigid_cross(a, b, ab);
    det = a[0] * bc[0] + a[1] * bc[1] + a[2] * bc[2];
    if (!(det != 0) || det - det != 0)
        return 0;
    x[0] = (bc[0] * v[0] + bc[1] * v[1] + bc[2] * v[2]) / det;
    x[1] = (ca[0] * v[0] + ca[1] * v[1] + ca[2] * v[2]) / det;
    x[2] = (ab[0] * v[0] + ab[1] * v[1] + ab[2] * v[2]) / det;
    memcpy(v, x, sizeof x);
    return 1;
}

/* ---- inertia ---- */

/* What the rigid body's own motion needs of torque, turned back by E; size: sum of the magnitudes in it. */
static void sbi_rigid_inertia_torque(const sbi_rigid_step *s, const double e[9], const double th[3], double torque[3],
                                     double *size)
{
    double w[3], rate[3], momentum[3], other[3];
    for (int k = 0; k < 3; k++) {
        w[k] = s->cv * th[k] + s->spin0[k];
        rate[k] = s->ca * th[k] + s->spin_rate0[k];
    }
    if (s->keeps_momentum) {
        for (int k = 0; k < 3; k++)
            rate[k] = s->ca * th[k];
        sbi_rigid_apply(s->inertia, rate, torque);
        sbi_rigid_apply(s->inertia, s->spin, momentum);
        sbi_rigid_tapply(e, momentum, other);
        for (int k = 0; k < 3; k++)
            other[k] *= -s->cv;
    } else {
        sbi_rigid_apply(s->inertia, rate, torque);
        sbi_rigid_apply(s->inertia, w, momentum);
        sbi_rigid_cross(w, momentum, other);
    }
    *size = sbi_rigid_norm(torque) + sbi_rigid_norm(other);
    for (int k = 0; k < 3; k++)
        torque[k] += other[k];
}

/* d torque / d th of that, nearly. */
static void sbi_rigid_inertia_slope(const sbi_rigid_step *s, const double e[9], const double th[3], double slope[9])
{
    double w[3], momentum[3], turned[3], column[9];
    for (int k = 0; k < 9; k++)
        slope[k] = s->ca * s->inertia[k];
    if (s->keeps_momentum) {
        sbi_rigid_apply(s->inertia, s->spin, momentum);
        sbi_rigid_tapply(e, momentum, turned);
        sbi_rigid_add_skew(-s->cv, turned, slope);
        return;
    }
    for (int k = 0; k < 3; k++)
        w[k] = s->cv * th[k] + s->spin0[k];
    sbi_rigid_apply(s->inertia, w, momentum);
    sbi_rigid_add_skew(-s->cv, momentum, slope);
    for (int j = 0; j < 3; j++) {
        double unit[3] = {s->inertia[j], s->inertia[3 + j], s->inertia[6 + j]}, out[3];
        sbi_rigid_cross(w, unit, out);
        for (int i = 0; i < 3; i++)
            column[3 * i + j] = out[i];
    }
    for (int k = 0; k < 9; k++)
        slope[k] += s->cv * column[k];
}

/* The first guess: as if nothing acted on it. Where that is not found (it turns too far) it stays at the start's rate,
 * which the step's own iterations improve or refuse. */
static void sbi_rigid_guess(sbi_rigid *r)
{
    sbi_rigid_step *s = &r->step;
    double *th = r->unknown + 3, first[3], e[9], torque[3], slope[9], size, level = s->level * s->dt;
    for (int k = 0; k < 3; k++) {
        r->unknown[k] = level * r->now.velocity[k];
        first[k] = th[k] = level * s->spin[k];
    }
    for (int i = 0; i < SBI_RIGID_GUESSES; i++) {
        double before = sbi_rigid_norm(th);
        sbi_rigid_exp_matrix(th, e);
        sbi_rigid_inertia_torque(s, e, th, torque, &size);
        sbi_rigid_inertia_slope(s, e, th, slope);
        if (!sbi_rigid_solve3(slope, torque))
            break;
        for (int k = 0; k < 3; k++)
            th[k] -= torque[k];
        if (sbi_rigid_norm(torque) <= 4e-16 * before)
            return;
    }
    sbi_rigid_exp_matrix(th, e);
    sbi_rigid_inertia_torque(s, e, th, torque, &size);
    if (!(sbi_rigid_norm(torque) <= 1e-9 * size))
        memcpy(th, first, sizeof first);
}

/* ---- the guest ---- */

/* Force and torque that are out of balance without the tissue, the torque for dth where H is that of `at`. */
static void sbi_rigid_balance(const sbi_rigid *r, const double x[6], double left[6], double *size)
{
    const sbi_rigid_step *s = &r->step;
    double e[9], torque[3];
    memcpy(e, sbi_rigid_unit, sizeof e);
    if (!s->starts)
        sbi_rigid_exp_matrix(x + 3, e);
    sbi_rigid_inertia_torque(s, e, x + 3, torque, size);
    sbi_rigid_apply(e, torque, torque);
    for (int k = 0; k < 3; k++) {
        left[k] = s->load[k] + r->mass * (s->gravity[k] - s->ca * x[k] - s->acceleration0[k]);
        torque[k] = s->load[3 + k] - torque[k];
    }
    *size += sbi_rigid_norm(s->load + 3);
    sbi_rigid_tapply(s->slope, torque, left + 3);
}

static void sbi_rigid_known(const double k0, const double a[3], const double k1, const double b[3], double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = k0 * a[k] + k1 * b[k];
}

static void sbi_rigid_take_step(sbi_rigid *r, const sbi_guest_step *told)
{
    sbi_rigid_step *s = &r->step;
    const double *kv = told->known_velocity, *ka = told->known_acceleration;
    double rate[3];
    s->starts = told->starts;
    s->dt = told->dt;
    s->level = told->level;
    s->cv = told->velocity_factor;
    s->ca = told->acceleration_factor;
    s->keeps_momentum = !told->starts && kv[0] == 0 && kv[1] == 0 && ka[1] == 0;
    s->rounds = 0;
    memset(s->found, 0, sizeof s->found);
    sbi_rigid_matrix(r->now.turn, s->frame);
    sbi_rigid_turn_matrix(s->frame, r->inertia, s->inertia);
    sbi_rigid_apply(s->frame, r->now.spin, s->spin);
    sbi_rigid_apply(s->frame, r->now.spin_rate, rate);
    sbi_rigid_known(kv[0], r->now.velocity, kv[1], r->now.acceleration, s->velocity0);
    sbi_rigid_known(ka[0], r->now.velocity, ka[1], r->now.acceleration, s->acceleration0);
    sbi_rigid_known(kv[0], s->spin, kv[1], rate, s->spin0);
    sbi_rigid_known(ka[0], s->spin, ka[1], rate, s->spin_rate0);
    if (!s->starts && s->dt > 0)
        sbi_rigid_guess(r);
}

/* rows += A_ij T_j of a node, T_j = [1, -[y_j]x], row-major [3][6] */
static void sbi_rigid_add_row(const sb_real block[9], const double y[3], double rows[18])
{
    for (int i = 0; i < 3; i++) {
        double a = (double)block[3 * i], b = (double)block[3 * i + 1], c = (double)block[3 * i + 2];
        double *row = rows + 6 * i;
        row[0] += a;
        row[1] += b;
        row[2] += c;
        row[3] += c * y[1] - b * y[2];
        row[4] += a * y[2] - c * y[0];
        row[5] += b * y[0] - a * y[1];
    }
}

/* Index of a node among those that are active, or -1. */
static int sbi_rigid_index_of(const sbi_rigid *r, int node)
{
    int low = 0, high = r->guest.node_count;
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (r->active[middle] < node)
            low = middle + 1;
        else
            high = middle;
    }
    return low < r->guest.node_count && r->active[low] == node ? low : -1;
}

/* block += sum T_i^T A_ij T_j over the nodes that hang, with turns for the last three unknowns */
static void sbi_rigid_add_nodes(const sbi_rigid *r, const sb_matrix *a, double block[36])
{
    for (int k = 0; k < r->guest.node_count; k++) {
        const double *y = r->y[k];
        double rows[18] = {0};
        for (int e = a->row_start[r->active[k]]; e < a->row_end[r->active[k]]; e++) {
            int j = sbi_rigid_index_of(r, a->columns[e]);
            if (j >= 0)
                sbi_rigid_add_row(a->blocks[e], r->y[j], rows);
        }
        for (int j = 0; j < 6; j++) {
            block[j] += rows[j];
            block[6 + j] += rows[6 + j];
            block[12 + j] += rows[12 + j];
            block[18 + j] += y[1] * rows[12 + j] - y[2] * rows[6 + j];
            block[24 + j] += y[2] * rows[j] - y[0] * rows[12 + j];
            block[30 + j] += y[0] * rows[6 + j] - y[1] * rows[j];
        }
    }
}

/* block = D^T block D, D = (1, H) */
static void sbi_rigid_slope_block(const double h[9], double block[36])
{
    for (int i = 0; i < 6; i++) {
        double row[3] = {block[6 * i + 3], block[6 * i + 4], block[6 * i + 5]};
        sbi_rigid_tapply(h, row, block + 6 * i + 3);
    }
    for (int j = 0; j < 6; j++) {
        double column[3] = {block[18 + j], block[24 + j], block[30 + j]};
        sbi_rigid_tapply(h, column, column);
        block[18 + j] = column[0];
        block[24 + j] = column[1];
        block[30 + j] = column[2];
    }
}

/* Cholesky factor of the block with a diagonal of ones; 0: it is not positive definite, and that of before stays. */
static int sbi_rigid_factor(sbi_rigid_step *s, double block[36])
{
    double l[36], scale[6];
    memset(l, 0, sizeof l);
    for (int i = 0; i < 6; i++) {
        if (!(block[7 * i] > 0) || block[7 * i] - block[7 * i] != 0)
            return 0;
        scale[i] = 1 / sqrt(block[7 * i]);
    }
    for (int i = 0; i < 6; i++)
        for (int j = 0; j <= i; j++) {
            double sum = (block[6 * i + j] + block[6 * j + i]) / 2 * scale[i] * scale[j];
            for (int k = 0; k < j; k++)
                sum -= l[6 * i + k] * l[6 * j + k];
            if (i == j && !(sum > 0))
                return 0;
            l[6 * i + j] = i == j ? sqrt(sum) : sum / l[7 * j];
        }
    memcpy(s->factor, l, sizeof l);
    memcpy(s->scale, scale, sizeof scale);
    return 1;
}

static void sbi_rigid_solve_block(const sbi_rigid_step *s, double x[6])
{
    const double *l = s->factor;
    for (int i = 0; i < 6; i++) {
        x[i] *= s->scale[i];
        for (int k = 0; k < i; k++)
            x[i] -= l[6 * i + k] * x[k];
        x[i] /= l[7 * i];
    }
    for (int i = 6; i-- > 0;) {
        for (int k = i + 1; k < 6; k++)
            x[i] -= l[6 * k + i] * x[k];
        x[i] /= l[7 * i];
    }
    for (int i = 0; i < 6; i++)
        x[i] *= s->scale[i];
}

/* 1: the turn is one that a step may have. */
static int sbi_rigid_turns_little(const double th[3]) { return sbi_rigid_norm(th) <= 3.1; }

static sb_result sbi_rigid_refuse_turn(const sbi_rigid *r, sb_error *error)
{
    if (!(r->step.dt > 0))
        return sbi_fail(error, SB_ERROR_DIVERGED,
                        "rigid body %d turns by half a turn in an increment: take more load_steps", r->id);
    return sbi_fail(error, SB_ERROR_DIVERGED,
                    "rigid body %d turns by half a turn in a step of %g s: take a shorter one", r->id, r->step.dt);
}

/* Rows at x. */
static void sbi_rigid_renew(void *user, const double *x)
{
    sbi_rigid *r = (sbi_rigid *)user;
    sbi_rigid_step *s = &r->step;
    double e[9], size;
    memcpy(e, sbi_rigid_unit, sizeof e);
    memcpy(s->slope, sbi_rigid_unit, sizeof s->slope);
    if (!s->starts) {
        sbi_rigid_exp_matrix(x + 3, e);
        sbi_rigid_jacobian(x + 3, s->slope);
    }
    for (int k = 0; k < r->guest.node_count; k++) {
        double arm[3];
        sbi_rigid_apply(s->frame, r->lever[k], arm);
        sbi_rigid_apply(e, arm, r->y[k]);
    }
    memset(&s->skew, 0, sizeof s->skew);
    memcpy(s->at, x, sizeof s->at);
    sbi_rigid_balance(r, s->at, s->left, &size);
    /* H^T E J E^T H = H J H^T */
    sbi_rigid_turn_matrix(s->slope, s->inertia, s->mass_slope);
    for (int k = 0; k < 9; k++)
        s->mass_slope[k] *= s->ca;
}

/* Factor of the block of its rows; 0: it is not positive definite. */
static int sbi_rigid_make_block(sbi_rigid *r)
{
    const sbi_rigid_step *s = &r->step;
    double block[36];
    memset(block, 0, sizeof block);
    sbi_rigid_add_nodes(r, s->matrix, block);
    sbi_rigid_slope_block(s->slope, block);
    for (int i = 0; i < 3; i++) {
        block[7 * i] += s->ca * r->mass;
        for (int j = 0; j < 3; j++)
            block[6 * (3 + i) + 3 + j] += s->mass_slope[3 * i + j];
    }
    return sbi_rigid_factor(&r->step, block);
}

/* m without its negative eigenvalues; symmetric. */
static void sbi_rigid_clamp(double m[9])
{
    sb_mat3 a, v;
    sb_vec3 d;
    double values[3];
    for (int k = 0; k < 9; k++)
        a.m[k / 3][k % 3] = (sb_real)m[k];
    sb_m3_eigen(a, &d, &v);
    values[0] = (double)d.x, values[1] = (double)d.y, values[2] = (double)d.z;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            m[3 * i + j] = 0;
            for (int k = 0; k < 3; k++)
                m[3 * i + j] += fmax(values[k], 0) * (double)v.m[i][k] * (double)v.m[j][k];
        }
}

/* What forces left over at the nodes that hang, f, change the torque by when their arms turn:
 *     dth.G dth = sum f.(dth x (dth x y)), G = sum (f y^T + y f^T) / 2 - (f.y) 1,
 * to the stiffness. What the torque of these forces and the load's leave out of balance plays no part in it: it is none
 * at the end. */
static void sbi_rigid_add_turning(sbi_rigid *r, const sb_vec3 *left, int is_exact)
{
    double turning[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0}, transposed[9], out[9];
    for (int k = 0; k < r->guest.node_count; k++) {
        const double *y = r->y[k];
        double f[3], along;
        sbi_rigid_get(left[r->active[k]], f);
        along = f[0] * y[0] + f[1] * y[1] + f[2] * y[2];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                turning[3 * i + j] += (f[i] * y[j] + y[i] * f[j]) / 2 - (i == j ? along : 0);
    }
    if (!is_exact)
        sbi_rigid_clamp(turning);
    for (int k = 0; k < 9; k++)
        transposed[k] = r->step.slope[3 * (k % 3) + k / 3];
    sbi_rigid_turn_matrix(transposed, turning, out);
    memcpy(r->step.turning, out, sizeof out);
    for (int k = 0; k < 9; k++)
        r->step.mass_slope[k] += out[k];
}

SBI_API void sbi_rigid_set_small(sbi_rigid *r, const double turn[4], const sb_vec3 *left)
{
    const double none[6] = {0, 0, 0, 0, 0, 0};
    sbi_rigid_matrix(turn, r->step.frame);
    sbi_rigid_turn_matrix(r->step.frame, r->inertia, r->step.inertia);
    sbi_rigid_renew(r, none);
    memset(r->step.turning, 0, sizeof r->step.turning);
    if (left)
        sbi_rigid_add_turning(r, left, 1);
}

SBI_API int sbi_rigid_factor_small(sbi_rigid *r, const sb_matrix *matrix, double shift)
{
    sbi_rigid_step *s = &r->step;
    s->matrix = matrix;
    s->ca = shift;
    for (int k = 0; k < 9; k++)
        s->mass_slope[k] = shift * s->inertia[k] + s->turning[k];
    return sbi_rigid_make_block(r);
}

static sb_result sbi_rigid_begin(void *user, const sbi_guest_step *told, sb_error *error)
{
    sbi_rigid *r = (sbi_rigid *)user;
    if (told->iteration == 0)
        sbi_rigid_take_step(r, told);
    if (!sbi_rigid_turns_little(r->unknown + 3))
        return sbi_rigid_refuse_turn(r, error);
    r->step.matrix = told->matrix;
    r->step.rounds = 0;
    sbi_rigid_renew(r, r->unknown);
    if (told->left)
        sbi_rigid_add_turning(r, told->left, told->is_exact);
    return sbi_rigid_make_block(r) ? SB_OK : SB_ERROR_INDEFINITE;
}

/* y = S x of the unknowns */
static void sbi_rigid_stiffness(const sbi_rigid *r, const double x[6], double y[6])
{
    for (int k = 0; k < 3; k++)
        y[k] = r->step.ca * r->mass * x[k];
    sbi_rigid_apply(r->step.mass_slope, x + 3, y + 3);
}

static void sbi_rigid_predict(const sbi_rigid *r, const double x[6], double left[6])
{
    double way[6], y[6];
    for (int k = 0; k < 6; k++)
        way[k] = x[k] - r->step.at[k];
    sbi_rigid_stiffness(r, way, y);
    for (int k = 0; k < 6; k++)
        left[k] = r->step.left[k] - y[k];
    for (int k = 0; k < 3; k++)
        left[3 + k] += r->step.skew.torque[k];
}

static void sbi_rigid_residual(void *user, const double *x, double *y)
{
    const sbi_rigid *r = (const sbi_rigid *)user;
    memset(y + 6, 0, 3 * (size_t)r->guest.node_count * sizeof *y);
    sbi_rigid_predict(r, x, y);
}

static void sbi_rigid_multiply(void *user, const double *x, double *y)
{
    const sbi_rigid *r = (const sbi_rigid *)user;
    memset(y + 6, 0, 3 * (size_t)r->guest.node_count * sizeof *y);
    sbi_rigid_stiffness(r, x, y);
}

/* Forces and moments of the nodes go to the unknowns. */
static void sbi_rigid_condense(void *user, double *rows)
{
    const sbi_rigid *r = (const sbi_rigid *)user;
    double sum[3] = {0, 0, 0}, moment[3] = {0, 0, 0}, one[3];
    for (int k = 0; k < r->guest.node_count; k++) {
        double *f = rows + 6 + 3 * (size_t)k;
        sbi_rigid_cross(r->y[k], f, one);
        for (int i = 0; i < 3; i++) {
            sum[i] += f[i];
            moment[i] += one[i];
            f[i] = 0;
        }
    }
    sbi_rigid_tapply(r->step.slope, moment, moment);
    for (int i = 0; i < 3; i++) {
        rows[i] += sum[i];
        rows[3 + i] += moment[i];
    }
}

/* Of condensed rows. */
static void sbi_rigid_precondition(void *user, const double *in, double *out)
{
    const sbi_rigid *r = (const sbi_rigid *)user;
    const sbi_rigid_step *s = &r->step;
    double turn[3];
    memcpy(out, in, 6 * sizeof *out);
    sbi_rigid_solve_block(s, out);
    sbi_rigid_apply(s->slope, out + 3, turn);
    for (int k = 0; k < r->guest.node_count; k++) {
        double *z = out + 6 + 3 * (size_t)k;
        sbi_rigid_cross(turn, r->y[k], z);
        for (int i = 0; i < 3; i++)
            z[i] += out[i];
    }
}

/* way = that of an arm by a turn, (E - 1) arm, without the rounding of places. */
static void sbi_rigid_turn_way(const double th[3], const double arm[3], double way[3])
{
    double q[4], first[3], second[3];
    sbi_rigid_exp(th, q);
    sbi_rigid_cross(q + 1, arm, first);
    sbi_rigid_cross(q + 1, first, second);
    for (int i = 0; i < 3; i++)
        way[i] = 2 * (q[0] * first[i] + second[i]);
}

/* Way of active node k over the step. */
static void sbi_rigid_way(const sbi_rigid *r, int k, const double x[6], double way[3])
{
    double arm[3];
    sbi_rigid_apply(r->step.frame, r->lever[k], arm);
    sbi_rigid_turn_way(x + 3, arm, way);
    for (int i = 0; i < 3; i++) /* the last is where it hangs already, but for rounding */
        way[i] = x[i] + way[i] + (arm[i] - r->from[k][i] + r->now.centre[i]);
}

/* How far nodes x are from where the unknowns put them, over their largest way. */
static double sbi_rigid_gap(const sbi_rigid *r, const double *x)
{
    double gap = 0, most = 0;
    const double *at = x + 6;
    for (int k = 0; k < r->guest.node_count; k++, at += 3) {
        double way[3];
        sbi_rigid_way(r, k, x, way);
        for (int i = 0; i < 3; i++) {
            gap = fmax(gap, fabs(way[i] - at[i]));
            most = fmax(most, fabs(at[i]));
        }
    }
    return most > 0 ? gap / most : 0;
}

static void sbi_rigid_subtract(const double a[3], const double b[3], double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = a[k] - b[k];
}

static double sbi_rigid_dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* The torque by which the rounds so far tell that nothing is left: of those differences that are no multiples of the
 * last (least squares; Anderson 1965). */
static void sbi_rigid_guess_skew(sbi_rigid_skew *w)
{
    double share[SBI_RIGID_SECANTS] = {0, 0}, a, b, c, f, g, det;
    a = w->known > 0 ? sbi_rigid_dot(w->lefts[0], w->lefts[0]) : 0;
    f = w->known > 0 ? sbi_rigid_dot(w->lefts[0], w->left) : 0;
    share[0] = a > 0 ? f / a : 0;
    if (w->known > 1) {
        b = sbi_rigid_dot(w->lefts[0], w->lefts[1]);
        c = sbi_rigid_dot(w->lefts[1], w->lefts[1]);
        g = sbi_rigid_dot(w->lefts[1], w->left);
        det = a * c - b * b;
        if (det > 1e-6 * a * c) {
            share[0] = (c * f - b * g) / det;
            share[1] = (a * g - b * f) / det;
        }
    }
    memcpy(w->before, w->torque, sizeof w->before);
    for (int k = 0; k < 3; k++) {
        w->torque[k] += w->left[k];
        for (int i = 0; i < w->known; i++)
            w->torque[k] -= share[i] * (w->torques[i][k] + w->lefts[i][k]);
    }
}

/* Notes what is missing to `wanted`, and how it has changed with the rows. */
static void sbi_rigid_note_skew(sbi_rigid_skew *w, const double wanted[3], int again)
{
    double left[3];
    sbi_rigid_subtract(wanted, w->torque, left);
    if (again) {
        memmove(w->torques + 1, w->torques, sizeof w->torques - sizeof w->torques[0]);
        memmove(w->lefts + 1, w->lefts, sizeof w->lefts - sizeof w->lefts[0]);
        sbi_rigid_subtract(w->torque, w->before, w->torques[0]);
        sbi_rigid_subtract(left, w->left, w->lefts[0]);
        w->known = sbi_min_int(w->known + 1, SBI_RIGID_SECANTS);
    }
    memcpy(w->left, left, sizeof left);
}

/* 2: the solve goes on with another torque in the rows, whose turns are where they belong. */
static int sbi_rigid_settle_skew(sbi_rigid *r, const double *x)
{
    const double enough = 0.02; /* of what it could be, which is a share of what an iteration of Newton leaves */
    sbi_rigid_step *s = &r->step;
    double turn[3], wanted[3], most;
    if (s->rounds == SBI_RIGID_ROUNDS || sbi_rigid_norm(s->load + 3) == 0)
        return 0;
    sbi_rigid_subtract(x + 3, s->at + 3, turn);
    sbi_rigid_apply(s->slope, turn, turn);
    most = sbi_rigid_norm(s->load + 3) * sbi_rigid_norm(turn) / 2;
    sbi_rigid_cross(s->load + 3, turn, wanted);
    for (int k = 0; k < 3; k++)
        wanted[k] /= 2;
    sbi_rigid_tapply(s->slope, wanted, wanted);
    sbi_rigid_note_skew(&s->skew, wanted, s->rounds > 0);
    if (!(sbi_rigid_norm(s->skew.left) > enough * most))
        return 0;
    sbi_rigid_guess_skew(&s->skew);
    s->rounds++;
    return 2;
}

/* Where the turn has left what its rows were made of, the solve goes on with rows of there: nodes are where it has
 * them then, also when they have moved in one solve by a finite turn, and its own inertia balances. */
static int sbi_rigid_settle(void *user, const double *x)
{
    sbi_rigid *r = (sbi_rigid *)user;
    sbi_rigid_step *s = &r->step;
    const double close = fmax(1e-10, 64 * (double)SB_EPSILON);
    double left[6], guess[6], size, change = 0;
    if (s->starts) {
        for (int k = 0; k < 6; k++)
            s->found[k] = s->ca * x[k];
        return 0;
    }
    if (!(s->dt > 0))
        return sbi_rigid_settle_skew(r, x);
    if (s->rounds == SBI_RIGID_ROUNDS || !sbi_rigid_turns_little(x + 3))
        return 0;
    sbi_rigid_balance(r, x, left, &size);
    sbi_rigid_predict(r, x, guess);
    for (int k = 3; k < 6; k++)
        change += (left[k] - guess[k]) * (left[k] - guess[k]);
    if (!(sqrt(change) > close * size) && !(sbi_rigid_gap(r, x) > close))
        return 0;
    sbi_rigid_renew(r, x);
    if (!sbi_rigid_make_block(r)) /* that of before serves, too: it is one of preconditioning */
        s->rounds = SBI_RIGID_ROUNDS - 1;
    s->rounds++;
    return 1;
}

static void sbi_rigid_place(void *user, const double *unknown, double *way)
{
    const sbi_rigid *r = (const sbi_rigid *)user;
    const sbi_rigid_step *s = &r->step;
    for (int k = 0; k < r->guest.node_count; k++, way += 3) {
        double arm[3], other[3];
        if (!s->starts) {
            sbi_rigid_way(r, k, unknown, way);
            continue;
        }
        sbi_rigid_apply(s->frame, r->lever[k], arm); /* accelerations, w x (w x y) among them */
        sbi_rigid_cross(s->spin, arm, other);
        sbi_rigid_cross(s->spin, other, other);
        sbi_rigid_cross(unknown + 3, arm, arm);
        for (int i = 0; i < 3; i++)
            way[i] = unknown[i] + arm[i] + other[i] / s->ca;
    }
}

/* Of the search for accelerations, which no commit follows, they stay. */
static void sbi_rigid_undo(void *user)
{
    sbi_rigid *r = (sbi_rigid *)user;
    if (!r->step.starts)
        return;
    memcpy(r->now.acceleration, r->step.found, 3 * sizeof(double));
    sbi_rigid_tapply(r->step.frame, r->step.found + 3, r->now.spin_rate);
    r->step.starts = 0;
}

SBI_API void sbi_rigid_make_guest(sbi_rigid *r, const int *nodes, int count)
{
    sbi_guest *guest = &r->guest;
    memset(guest, 0, sizeof *guest);
    guest->user = r;
    guest->unknown_count = SBI_RIGID_UNKNOWNS;
    guest->unknown = r->unknown;
    guest->node_count = guest->taken_count = count;
    guest->nodes = nodes;
    guest->moves_taken = 1;
    guest->residual = sbi_rigid_residual;
    guest->multiply = sbi_rigid_multiply;
    guest->precondition = sbi_rigid_precondition;
    guest->begin = sbi_rigid_begin;
    guest->settle = sbi_rigid_settle;
    guest->undo = sbi_rigid_undo;
    guest->place = sbi_rigid_place;
    guest->renew = sbi_rigid_renew;
    guest->condense = sbi_rigid_condense;
}

/* ---- a step begins ---- */

SBI_API sb_result sbi_rigid_activate(const sb_body *body, sbi_rigid *r, sb_error *error)
{
    int count = 0;
    for (int k = 0; k < r->count; k++) {
        int node = r->hung[k];
        sb_vec3 x, u;
        if (body->node_component[node] < 0 || body->fixed[node] == SB_XYZ) /* its material is gone */
            continue;
        if (body->fixed[node])
            return sbi_fail_node(error, SB_ERROR_UNSUPPORTED, node, "node %d hangs on rigid body %d and is supported",
                                 node, r->id);
        x = body->reference[node];
        u = body->displacement[node];
        r->active[count] = node;
        memcpy(r->lever[count], r->arm[k], sizeof *r->lever);
        r->from[count][0] = (double)x.x + (double)u.x;
        r->from[count][1] = (double)x.y + (double)u.y;
        r->from[count][2] = (double)x.z + (double)u.z;
        count++;
    }
    sbi_rigid_make_guest(r, r->active, count);
    memset(r->unknown, 0, sizeof r->unknown);
    memset(&r->step, 0, sizeof r->step);
    memcpy(r->step.load, r->load, sizeof r->load);
    r->step.gravity[0] = (double)body->gravity.x;
    r->step.gravity[1] = (double)body->gravity.y;
    r->step.gravity[2] = (double)body->gravity.z;
    return SB_OK;
}

SBI_API sb_result sbi_rigids_join(sbi_step *step, const sbi_guest *const **guests, int *count)
{
    sb_body *b = step->body;
    int all = *count, rigid_count = b->rigids ? b->rigids->count : 0;
    if (rigid_count == 0)
        return SB_OK;
    if (all > SBI_STEP_MOST_GUESTS - 1 - rigid_count)
        return sbi_fail(&step->info->error, SB_ERROR_UNSUPPORTED,
                        "a step with %d free rigid bodies has at most %d needles", rigid_count,
                        SBI_STEP_MOST_GUESTS - 1 - rigid_count);
    for (int g = 0; g < all; g++)
        b->step_guests[g] = (*guests)[g];
    for (int k = 0; k < rigid_count; k++) {
        sb_result result = sbi_rigid_activate(b, b->rigids->list[k], &step->info->error);
        if (result != SB_OK)
            return result;
        b->step_guests[all++] = &b->rigids->list[k]->guest;
    }
    *guests = b->step_guests;
    *count = all;
    return SB_OK;
}

/* ---- a step ends ---- */

/* work = what forces but those of rigid bodies leave over at nodes that hang. */
static void sbi_rigids_find_left(const sbi_step *step)
{
    sb_body *b = step->body;
    const sb_matrix *matrix = b->elimination ? &b->elimination->matrix : &b->matrix;
    const sb_vec3 *left = b->elimination ? b->elimination->reduced : b->residual;
    size_t size = (size_t)b->domain.node_count * sizeof(sb_vec3);
    if (!step->linearised) {
        memcpy(b->work, left, size);
        sbi_step_subtract_guests(step, b->work);
        return;
    }
    memset(b->work, 0, size); /* A x - rhs: supports' own motion is in that */
    if (sbi_body_has_links(b))
        (void)sbi_body_multiply_links(b, &b->increment[0].x, &b->work[0].x);
    sbi_step_subtract_guests(step, b->work);
    for (int k = 0; k < b->rigids->count; k++)
        for (int i = 0; i < b->rigids->list[k]->guest.node_count; i++) {
            int node = b->rigids->list[k]->active[i];
            sb_vec3 sum = sb_v3_sub(b->work[node], b->rhs[node]);
            for (int e = matrix->row_start[node]; e < matrix->row_end[node]; e++)
                sum = sb_v3_add(sum, sbi_step_block_product(matrix->blocks[e], b->increment[matrix->columns[e]]));
            b->work[node] = sum;
        }
}

SBI_API void sbi_rigid_read_wrench(sbi_rigid *r, const sb_vec3 *left)
{
    double *wrench = r->now.wrench;
    memset(wrench, 0, sizeof r->now.wrench);
    for (int i = 0; i < r->guest.node_count; i++) {
        sb_vec3 v = left[r->active[i]];
        double f[3] = {(double)v.x, (double)v.y, (double)v.z}, moment[3];
        sbi_rigid_cross(r->y[i], f, moment);
        for (int c = 0; c < 3; c++) {
            wrench[c] -= f[c];
            wrench[3 + c] -= moment[c];
        }
    }
}

SBI_API void sbi_rigids_read(const sbi_step *step)
{
    sb_body *b = step->body;
    if (!b->rigids || b->rigids->count == 0)
        return;
    sbi_rigids_find_left(step);
    for (int k = 0; k < b->rigids->count; k++)
        sbi_rigid_read_wrench(b->rigids->list[k], b->work);
}

SBI_API void sbi_rigid_turn_by(const double th[3], double turn[4])
{
    double q[4], before[4], length = 0;
    memcpy(before, turn, sizeof before);
    sbi_rigid_exp(th, q);
    turn[0] = q[0] * before[0] - q[1] * before[1] - q[2] * before[2] - q[3] * before[3];
    turn[1] = q[0] * before[1] + q[1] * before[0] + q[2] * before[3] - q[3] * before[2];
    turn[2] = q[0] * before[2] + q[2] * before[0] + q[3] * before[1] - q[1] * before[3];
    turn[3] = q[0] * before[3] + q[3] * before[0] + q[1] * before[2] - q[2] * before[1];
    for (int k = 0; k < 4; k++)
        length += turn[k] * turn[k];
    length = sqrt(length);
    for (int k = 0; k < 4; k++)
        turn[k] /= length;
}

/* Motion of one at the end of the step, of its unknowns where forces balance. */
static sb_result sbi_rigid_finish(sbi_step *step, sbi_rigid *r, const double x[6])
{
    const sbi_rigid_step *s = &r->step;
    const sbi_rigid_state before = r->now;
    sbi_rigid_state *now = &r->now;
    double level = (double)step->level, inertia_level = (double)step->inertia_level;
    double end[3], v[3], w[3], rate[3];
    for (int k = 0; k < 3; k++) {
        end[k] = x[3 + k] / level;
        now->centre[k] += x[k] / level;
        now->velocity[k] += (s->cv * x[k] + s->velocity0[k] - now->velocity[k]) / level;
        v[k] = s->spin[k] + (s->cv * x[3 + k] + s->spin0[k] - s->spin[k]) / level;
    }
    if (!sbi_rigid_turns_little(end))
        return sbi_rigid_refuse_turn(r, &step->info->error);
    sbi_rigid_tapply(s->frame, v, now->spin);
    if (!step->keeps_acceleration) {
        sbi_rigid_apply(s->frame, before.spin_rate, w);
        for (int k = 0; k < 3; k++) {
            double a = s->ca * x[k] + s->acceleration0[k];
            now->acceleration[k] += (a - now->acceleration[k]) / inertia_level;
            rate[k] = w[k] + (s->ca * x[3 + k] + s->spin_rate0[k] - w[k]) / inertia_level;
        }
        sbi_rigid_tapply(s->frame, rate, now->spin_rate);
    }
    sbi_rigid_turn_by(end, now->turn);
    for (int k = 0; k < 3; k++)
        if (now->velocity[k] - now->velocity[k] != 0 || now->spin[k] - now->spin[k] != 0 ||
            now->acceleration[k] - now->acceleration[k] != 0 || now->spin_rate[k] - now->spin_rate[k] != 0)
            return sbi_fail(&step->info->error, SB_ERROR_DIVERGED, "the motion of rigid body %d is not finite", r->id);
    return SB_OK;
}

SBI_API sb_result sbi_rigids_finish(sbi_step *step)
{
    const sbi_guest_space *space = sbi_pcg_guests(&step->body->pcg);
    sb_result result = SB_OK;
    for (int g = 0; g < step->guests.count && result == SB_OK; g++)
        if (step->guests.list[g]->place)
            result = sbi_rigid_finish(step, (sbi_rigid *)step->guests.list[g]->user, space->work[g].base);
    return result;
}

SBI_API void sbi_rigids_place(const sb_body *body, sb_vec3 *displacement)
{
    for (int k = 0; body->rigids && k < body->rigids->count; k++) {
        const sbi_rigid *r = body->rigids->list[k];
        double turn[9], arm[3];
        sbi_rigid_matrix(r->now.turn, turn);
        for (int i = 0; i < r->guest.node_count; i++) {
            int node = r->active[i];
            sb_vec3 x = body->reference[node];
            sbi_rigid_apply(turn, r->lever[i], arm);
            displacement[node] = sb_v3((sb_real)(arm[0] + (r->now.centre[0] - (double)x.x)),
                                       (sb_real)(arm[1] + (r->now.centre[1] - (double)x.y)),
                                       (sb_real)(arm[2] + (r->now.centre[2] - (double)x.z)));
        }
    }
}

SBI_API void sbi_rigids_save(sb_body *body)
{
    for (int k = 0; body->rigids && k < body->rigids->count; k++)
        body->rigids->list[k]->saved = body->rigids->list[k]->now;
}

SBI_API void sbi_rigids_restore(sb_body *body)
{
    for (int k = 0; body->rigids && k < body->rigids->count; k++)
        body->rigids->list[k]->now = body->rigids->list[k]->saved;
}
