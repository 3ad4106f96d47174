/* material_models: energy, stress and tangent of each model and of fibres at one point. Internal: material.c checks
 * what goes in and comes out.
 *
 * Callers pass an F that is finite; a NaN comes out as NaN. Formula names: f_i is row i of F, I1 = F:F,
 * B = F^-T = cof(F)/J. Tangents are written by 3x3 blocks (i,k) with entries (j,l) = dP_ij/dF_kl. The model is chosen
 * at run time: loops instantiated for one model were no faster, but for the neo-Hookean force, by a tenth. */
#ifndef SBI_MATERIAL_MODELS_H
#define SBI_MATERIAL_MODELS_H

#include "material.h"
#include "material_law.h"

/* Row i of a. */
SBI_FORCE_INLINE sb_vec3 sbi_material_row(const sb_mat3 *a, int i) { return sb_v3(a->m[i][0], a->m[i][1], a->m[i][2]); }

/* 1 when the symmetric a is positive definite (Sylvester's leading minors). */
SBI_FORCE_INLINE int sbi_material_is_positive(sb_mat3 a)
{
    return a.m[0][0] > 0 && a.m[0][0] * a.m[1][1] - a.m[0][1] * a.m[0][1] > 0 && sb_m3_det(a) > 0;
}

/* scale a + shift I */
SBI_FORCE_INLINE sb_mat3 sbi_material_affine(sb_real scale, sb_mat3 a, sb_real shift)
{
    a = sb_m3_scale(scale, a);
    for (int i = 0; i < 3; i++)
        a.m[i][i] += shift;
    return a;
}

/* Writes block (i,k) and its mirror image (k,i); i <= k. */
SBI_FORCE_INLINE void sbi_tangent_put(sb_real *A, int i, int k, sb_mat3 block)
{
    for (int j = 0; j < 3; j++)
        for (int l = 0; l < 3; l++) {
            A[9 * (3 * i + j) + 3 * k + l] = block.m[j][l];
            A[9 * (3 * k + l) + 3 * i + j] = block.m[j][l];
        }
}

/* A += weight d (x) d, exactly symmetric. */
SB_INLINE void sbi_tangent_add_dyad(sb_real *A, sb_real weight, sb_mat3 d)
{
    for (int p = 0; p < 9; p++) {
        sb_real scaled = weight * d.m[p / 3][p % 3];
        for (int q = p; q < 9; q++)
            A[9 * p + q] = A[9 * q + p] = A[9 * p + q] + scaled * d.m[q / 3][q % 3];
    }
}

/* (1 - exp(-x))/x without cancellation: the series where the quotient would lose digits. */
SB_INLINE sb_real sbi_material_mean_decay(sb_real x)
{
    if (sb_abs(x) < (sb_real)0.125) {
        sb_real sum = 1;
        for (int n = 11; n >= 2; n--) /* the next term is below 1e-17 */
            sum = 1 - x / (sb_real)n * sum;
        return sum;
    }
    return (1 - sb_exp(-x)) / x;
}

/* ---- linear ---- */

SBI_FORCE_INLINE sb_mat3 sbi_linear_strain(const sb_mat3 *F)
{
    sb_mat3 e;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            e.m[i][j] = (sb_real)0.5 * (F->m[i][j] + F->m[j][i]) - (sb_real)(i == j);
    return e;
}

/* lambda tr(e) I + 2 mu e */
SBI_FORCE_INLINE sb_mat3 sbi_hooke_stress(const sb_material *m, sb_mat3 e)
{
    sb_mat3 s = sb_m3_scale(2 * m->mu, e);
    sb_real pressure = m->lambda * sb_m3_trace(e);
    for (int i = 0; i < 3; i++)
        s.m[i][i] += pressure;
    return s;
}

/* lambda/2 tr(e)^2 + mu e:e */
SBI_FORCE_INLINE sb_real sbi_hooke_energy(const sb_material *m, sb_mat3 e)
{
    sb_real trace = sb_m3_trace(e);
    return (sb_real)0.5 * m->lambda * trace * trace + m->mu * sb_m3_ddot(e, e);
}

/* ---- corotated ---- */

/* What the corotated models take from F = R S: R; s and V of F = U diag(s) V^T in the signed-SVD variant. */
typedef struct sbi_corotation {
    sb_mat3 r;
    sb_vec3 s;
    sb_mat3 v;
} sbi_corotation;

SBI_FORCE_INLINE sbi_corotation sbi_corotate(int model, const sb_mat3 *F, sb_quat *rotation)
{
    sbi_corotation c;
    if (model == SB_COROTATED_INVERTIBLE) {
        sb_mat3 u;
        sb_m3_svd(*F, &u, &c.s, &c.v);
        c.r = sb_m3_mult(u, c.v);
    } else {
        sb_quat q = sb_m3_polar(*F, rotation ? *rotation : sb_quat_identity());
        c.r = sb_quat_to_mat3(q);
        if (rotation)
            *rotation = q;
        c.s = sb_v3(0, 0, 0); /* found only where it is needed */
        c.v = sb_m3_zero();
    }
    return c;
}

/* 2 mu (F - R) + lambda (tr(R^T F) - 3) R */
SBI_FORCE_INLINE sb_mat3 sbi_corotated_stress(const sb_material *m, const sb_mat3 *F, const sb_mat3 *r)
{
    sb_real pressure = m->lambda * (sb_m3_ddot(*r, *F) - 3);
    return sb_m3_add(sb_m3_scale(2 * m->mu, *F), sb_m3_scale(pressure - 2 * m->mu, *r));
}

SBI_FORCE_INLINE sb_real sbi_corotated_energy(const sb_material *m, const sb_mat3 *F, const sb_mat3 *r)
{
    sb_mat3 d = sb_m3_sub(*F, *r);
    sb_real trace = sb_m3_ddot(*r, *F) - 3;
    return m->mu * sb_m3_ddot(d, d) + (sb_real)0.5 * m->lambda * trace * trace;
}

/* The corotated tangent is Hooke's, rotated, plus the share of the rotation's change,
 *     A = R C R^T + sum_cd Z_cd (R [e_c]x) (x) (R [e_d]x),   Z = mu I + kappa G^-1,
 * with G = tr(S) I - S and kappa = lambda tr(S - I) - 2 mu. Z has the eigenvectors v_k of S and the values
 * mu + kappa/(s_i + s_j) (half of tau_ij), {i,j,k} = {0,1,2}: the twist eigenvalues of A. */

/* Lower bound of s_i + s_j; F is 1 at rest, so the scale of stretches is max(1, their sum). */
SBI_FORCE_INLINE sb_real sbi_spin_least(sb_real trace) { return (sb_real)1e-6 * sb_max(1, trace); }

/* Z from the eigen-decomposition S = V diag(s) V^T. */
SB_INLINE sb_mat3 sbi_spin_from_stretches(sb_real mu, sb_real kappa, sb_vec3 s, sb_mat3 v, sb_tangent_kind kind)
{
    sb_real least = sbi_spin_least(s.x + s.y + s.z), z[3];
    sb_mat3 spin;
    z[0] = mu + kappa / sb_max(s.y + s.z, least);
    z[1] = mu + kappa / sb_max(s.x + s.z, least);
    z[2] = mu + kappa / sb_max(s.x + s.y, least);
    if (kind != SB_TANGENT_EXACT)
        for (int k = 0; k < 3; k++)
            z[k] = sb_max(z[k], 0);
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++)
            spin.m[i][j] = spin.m[j][i] =
                z[0] * v.m[i][0] * v.m[j][0] + z[1] * v.m[i][1] * v.m[j][1] + z[2] * v.m[i][2] * v.m[j][2];
    return spin;
}

/* Z from S itself: without an eigen-decomposition unless values of both signs are to be clamped, or the
 * rotation is nearly not unique. */
SB_INLINE sb_mat3 sbi_spin_from_stretch(sb_real mu, sb_real kappa, sb_mat3 stretch, sb_tangent_kind kind)
{
    sb_real trace = sb_m3_trace(stretch);
    sb_mat3 g = sbi_material_affine(-1, stretch, trace);
    /* The two largest eigenvalues of G multiply to at most trace^2, so the third is >= det/trace^2. */
    if (sbi_material_is_positive(g) && sb_m3_det(g) > sbi_spin_least(trace) * trace * trace) {
        sb_mat3 scaled = sbi_material_affine(mu, g, kappa); /* G Z, of the same signs as Z */
        if (kind == SB_TANGENT_EXACT || kappa >= 0 || sbi_material_is_positive(scaled))
            return sbi_material_affine(kappa, sb_m3_inverse(g), mu);
        if (sbi_material_is_positive(sb_m3_scale(-1, scaled)))
            return sb_m3_zero();
    }
    sb_vec3 s;
    sb_mat3 v;
    sb_m3_eigen(stretch, &s, &v);
    return sbi_spin_from_stretches(mu, kappa, s, v, kind);
}

/* sym(R^T F) */
SBI_FORCE_INLINE sb_mat3 sbi_corotated_stretch(const sb_mat3 *F, const sb_mat3 *r)
{
    sb_mat3 s = sb_m3_tmul(*r, *F);
    for (int i = 0; i < 3; i++)
        for (int j = i + 1; j < 3; j++)
            s.m[i][j] = s.m[j][i] = (sb_real)0.5 * (s.m[i][j] + s.m[j][i]);
    return s;
}

/* [r]x m: column c is r x (column c of m). */
SBI_FORCE_INLINE sb_mat3 sbi_spin_cross(sb_vec3 r, sb_mat3 m)
{
    return sb_m3_columns(sb_v3_cross(r, sb_m3_column(m, 0)), sb_v3_cross(r, sb_m3_column(m, 1)),
                         sb_v3_cross(r, sb_m3_column(m, 2)));
}

/* Block (i,k) = lambda r_i r_k^T + mu r_k r_i^T + delta_ik mu I + [r_i]x Z [r_k]x^T with the rows r of R. */
SBI_FORCE_INLINE void sbi_corotated_assemble(const sb_material *m, sb_mat3 r, const sb_mat3 *spin, sb_real *A)
{
    for (int i = 0; i < 3; i++) {
        sb_vec3 ri = sbi_material_row(&r, i);
        sb_mat3 left = spin ? sb_m3_transpose(sbi_spin_cross(ri, *spin)) : sb_m3_zero();
        for (int k = i; k < 3; k++) {
            sb_vec3 rk = sbi_material_row(&r, k);
            sb_mat3 block =
                sb_m3_add(sb_m3_outer(ri, sb_v3_scale(m->lambda, rk)), sb_m3_outer(sb_v3_scale(m->mu, rk), ri));
            if (i == k)
                block = sbi_material_affine(1, block, m->mu);
            if (spin)
                block = sb_m3_add(block, sb_m3_transpose(sbi_spin_cross(rk, left)));
            sbi_tangent_put(A, i, k, block);
        }
    }
}

SBI_FORCE_INLINE void sbi_corotated_tangent(int model, const sb_material *m, const sb_mat3 *F, sb_quat *rotation,
                                            const sb_tangent_kind kind, sb_real *A)
{
    sbi_corotation c = sbi_corotate(model, F, rotation);
    sb_real kappa;
    sb_mat3 spin;
    if (kind == SB_TANGENT_QUASI) {
        sbi_corotated_assemble(m, c.r, NULL, A);
        return;
    }
    kappa = m->lambda * (sb_m3_ddot(c.r, *F) - 3) - 2 * m->mu;
    if (model == SB_COROTATED_INVERTIBLE)
        spin = sbi_spin_from_stretches(m->mu, kappa, c.s, c.v, kind);
    else
        spin = sbi_spin_from_stretch(m->mu, kappa, sbi_corotated_stretch(F, &c.r), kind);
    sbi_corotated_assemble(m, c.r, &spin, A);
}

/* Hooke's tangent: the rotated one at R = I. */
SBI_FORCE_INLINE void sbi_linear_tangent(const sb_material *m, sb_real *A)
{
    sbi_corotated_assemble(m, sb_m3_identity(), NULL, A);
}

/* ---- St.Venant-Kirchhoff ---- */

/* E = (F^T F - I)/2 */
SBI_FORCE_INLINE sb_mat3 sbi_green_strain(const sb_mat3 *F)
{
    return sbi_material_affine((sb_real)0.5, sb_m3_tmul(*F, *F), -(sb_real)0.5);
}

/* Block (i,k) = lambda f_i f_k^T + mu f_k f_i^T + mu (f_i.f_k) I + delta_ik S */
SBI_FORCE_INLINE void sbi_svk_tangent(const sb_material *m, const sb_mat3 *F, sb_real *A)
{
    sb_mat3 s = sbi_hooke_stress(m, sbi_green_strain(F));
    for (int i = 0; i < 3; i++) {
        sb_vec3 fi = sbi_material_row(F, i);
        for (int k = i; k < 3; k++) {
            sb_vec3 fk = sbi_material_row(F, k);
            sb_mat3 block =
                sb_m3_add(sb_m3_outer(fi, sb_v3_scale(m->lambda, fk)), sb_m3_outer(sb_v3_scale(m->mu, fk), fi));
            block = sbi_material_affine(1, block, m->mu * sb_v3_dot(fi, fk));
            sbi_tangent_put(A, i, k, i == k ? sb_m3_add(block, s) : block);
        }
    }
}

/* ---- models with a volume barrier: neo-Hookean with ln J, and the isochoric family ---- */

/* All have, with N = I1 F - F F^T F = 1/2 dI2/dF,
 *     P = alpha F + second N - epsilon B and
 *     A_ijkl = alpha d_ik d_jl + (L_ij B_kl + B_ij L_kl) + gamma B_ij B_kl + epsilon B_il B_kj + zeta F_ij F_kl
 *              + second (I1 d_ik d_jl - d_ik C_jl - (F F^T)_ik d_jl - F_il F_kj),   L = beta F - 4/3 second N.
 * zeta = 0 for the neo-Hookean models, second = 0 for all but Mooney-Rivlin. */
typedef struct sbi_barrier {
    sb_mat3 b;
    sb_real J, alpha, beta, gamma, epsilon, zeta, second;
} sbi_barrier;

/* psi = c10 i + c20 i^2 + c30 i^3 with i = I1b - 3: the derivative, and the second one in *curvature. */
SBI_FORCE_INLINE sb_real sbi_polynomial_slope(const sb_material *m, sb_real i, sb_real *curvature)
{
    *curvature = 2 * m->c20 + 6 * m->c30 * i;
    return m->c10 + i * (2 * m->c20 + 3 * m->c30 * i);
}

/* psi = c10/b (exp(b i) - 1), the same. */
SBI_FORCE_INLINE sb_real sbi_fung_slope(const sb_material *m, sb_real i, sb_real *curvature)
{
    sb_real slope = m->c10 * sb_exp(m->fung_exponent * i);
    *curvature = m->fung_exponent * slope;
    return slope;
}

/* 1 when psi is no straight line in I1b. */
SBI_FORCE_INLINE int sbi_barrier_is_curved(int model) { return model == SB_REDUCED_POLYNOMIAL || model == SB_FUNG; }

/* The isochoric family's coefficients; cofactor = cof F. */
SBI_FORCE_INLINE void sbi_barrier_isochoric(int model, const sb_material *m, const sb_mat3 *F, const sb_mat3 *cofactor,
                                            sbi_barrier *out)
{
    sb_real J = out->J, root = sb_cbrt(J), I1 = sb_m3_ddot(*F, *F), stiffness = 2 * J / m->d1; /* J U'' */
    sb_real square = root * root, slope = m->c10, curvature = 0;
    if (model == SB_REDUCED_POLYNOMIAL)
        slope = sbi_polynomial_slope(m, I1 / square - 3, &curvature);
    if (model == SB_FUNG)
        slope = sbi_fung_slope(m, I1 / square - 3, &curvature);
    out->alpha = 2 * slope / square;
    out->beta = -(sb_real)2 / 3 * out->alpha;
    out->gamma = (sb_real)2 / 9 * out->alpha * I1 + stiffness * (2 * J - 1);
    out->epsilon = out->alpha * I1 / 3 - stiffness * (J - 1);
    if (sbi_barrier_is_curved(model)) { /* zeta (F - I1/3 B) (x) (F - I1/3 B) */
        out->zeta = 4 * curvature / (square * square);
        out->beta -= out->zeta * I1 / 3;
        out->gamma += out->zeta * I1 * I1 / 9;
    }
    if (model == SB_MOONEY_RIVLIN) {
        sb_real I2 = sb_m3_ddot(*cofactor, *cofactor);
        out->second = 2 * m->c01 / (square * square);
        out->zeta = 2 * out->second;
        out->gamma += (sb_real)8 / 9 * out->second * I2;
        out->epsilon += 2 * out->second * I2 / 3;
    }
}

SBI_FORCE_INLINE int sbi_barrier_at(int model, const sb_material *m, const sb_mat3 *F, sbi_barrier *out)
{
    sb_mat3 cofactor = sb_m3_cofactor(*F);
    sb_real J = sb_v3_dot(sb_m3_column(*F, 0), sb_m3_column(cofactor, 0));
    if (!(J > 0))
        return 0;
    out->J = J;
    out->b = sb_m3_scale(1 / J, cofactor);
    out->zeta = out->second = 0;
    if (model == SB_NEO_HOOKEAN) {
        out->alpha = m->mu;
        out->beta = 0;
        out->gamma = m->lambda;
        out->epsilon = m->mu - m->lambda * sb_log(J);
    } else {
        sbi_barrier_isochoric(model, m, F, &cofactor, out);
    }
    return 1;
}

/* N = F (I1 I - C) */
SBI_FORCE_INLINE sb_mat3 sbi_mooney_normal(const sb_mat3 *F)
{
    sb_mat3 right = sb_m3_tmul(*F, *F);
    return sb_m3_mul(*F, sbi_material_affine(-1, right, sb_m3_trace(right)));
}

SBI_FORCE_INLINE int sbi_barrier_stress(int model, const sb_material *m, const sb_mat3 *F, sb_mat3 *P)
{
    sbi_barrier c;
    if (!sbi_barrier_at(model, m, F, &c))
        return 0;
    *P = sb_m3_scale(c.alpha, *F);
    if (model == SB_MOONEY_RIVLIN)
        *P = sb_m3_add(*P, sb_m3_scale(c.second, sbi_mooney_normal(F)));
    *P = sb_m3_sub(*P, sb_m3_scale(c.epsilon, c.b));
    return 1;
}

SBI_FORCE_INLINE int sbi_barrier_energy(int model, const sb_material *m, const sb_mat3 *F, sb_real *W)
{
    sb_real J = sb_m3_det(*F), I1 = sb_m3_ddot(*F, *F);
    if (!(J > 0))
        return 0;
    if (model == SB_NEO_HOOKEAN) {
        sb_real log_J = sb_log(J);
        *W = (sb_real)0.5 * m->mu * (I1 - 3) + ((sb_real)0.5 * m->lambda * log_J - m->mu) * log_J;
    } else {
        sb_real root = sb_cbrt(J), square = root * root, i = I1 / square - 3, slope = m->c10;
        if (model == SB_REDUCED_POLYNOMIAL)
            slope += i * (m->c20 + m->c30 * i);
        if (model == SB_FUNG) /* (exp(b i) - 1)/(b i) */
            slope *= sbi_material_mean_decay(-m->fung_exponent * i);
        *W = slope * i + (J - 1) * (J - 1) / m->d1;
        if (model == SB_MOONEY_RIVLIN) {
            sb_mat3 cofactor = sb_m3_cofactor(*F);
            *W += m->c01 * (sb_m3_ddot(cofactor, cofactor) / (square * square) - 3);
        }
    }
    return 1;
}

/* Block (i,k) = b_i (gamma b_k + l_k)^T + l_i b_k^T + f_i (zeta f_k)^T + (epsilon b_k) b_i^T - (second f_k) f_i^T
 * - second f_i.f_k I + delta_ik ((alpha + second I1) I - second C). */
SBI_FORCE_INLINE void sbi_mooney_tangent(const sbi_barrier *c, const sb_mat3 *F, sb_real *A)
{
    sb_mat3 right = sb_m3_tmul(*F, *F);
    sb_mat3 own = sbi_material_affine(-c->second, right, c->alpha + c->second * sb_m3_trace(right));
    sb_mat3 mixed = sb_m3_add(sb_m3_scale(c->beta, *F), sb_m3_scale(-(sb_real)4 / 3 * c->second, sbi_mooney_normal(F)));
    for (int i = 0; i < 3; i++) {
        sb_vec3 bi = sbi_material_row(&c->b, i), fi = sbi_material_row(F, i), li = sbi_material_row(&mixed, i);
        for (int k = i; k < 3; k++) {
            sb_vec3 bk = sbi_material_row(&c->b, k), fk = sbi_material_row(F, k);
            sb_mat3 block = sb_m3_outer(bi, sb_v3_madd(sbi_material_row(&mixed, k), c->gamma, bk));
            block = sb_m3_add(block, sb_m3_outer(li, bk));
            block = sb_m3_add(block, sb_m3_outer(fi, sb_v3_scale(c->zeta, fk)));
            block = sb_m3_add(block, sb_m3_outer(sb_v3_scale(c->epsilon, bk), bi));
            block = sb_m3_sub(block, sb_m3_outer(sb_v3_scale(c->second, fk), fi));
            block = sbi_material_affine(1, block, -c->second * sb_v3_dot(fi, fk));
            sbi_tangent_put(A, i, k, i == k ? sb_m3_add(block, own) : block);
        }
    }
}

SBI_FORCE_INLINE int sbi_barrier_tangent(int model, const sb_material *m, const sb_mat3 *F, sb_real *A)
{
    sbi_barrier c;
    if (!sbi_barrier_at(model, m, F, &c))
        return 0;
    if (model == SB_MOONEY_RIVLIN) {
        sbi_mooney_tangent(&c, F, A);
        return 1;
    }
    for (int i = 0; i < 3; i++) {
        sb_vec3 bi = sbi_material_row(&c.b, i);
        sb_vec3 fi = sbi_material_row(F, i);
        for (int k = i; k < 3; k++) {
            sb_vec3 bk = sbi_material_row(&c.b, k), right = sb_v3_scale(c.gamma, bk);
            if (model != SB_NEO_HOOKEAN) /* beta = 0 there */
                right = sb_v3_madd(right, c.beta, sbi_material_row(F, k));
            sb_mat3 block = sb_m3_add(sb_m3_outer(bi, right), sb_m3_outer(sb_v3_scale(c.epsilon, bk), bi));
            if (model != SB_NEO_HOOKEAN) {
                sb_vec3 left = sb_v3_scale(c.beta, bk);
                if (sbi_barrier_is_curved(model))
                    left = sb_v3_madd(left, c.zeta, sbi_material_row(F, k));
                block = sb_m3_add(block, sb_m3_outer(fi, left));
            }
            sbi_tangent_put(A, i, k, i == k ? sbi_material_affine(1, block, c.alpha) : block);
        }
    }
    return 1;
}

/* ---- stable neo-Hookean ---- */

/* mu F + ((lambda + mu)(J - 1) - mu) cof F: polynomial in F, so J <= 0 is nothing special. */
SBI_FORCE_INLINE sb_mat3 sbi_stable_stress(const sb_material *m, const sb_mat3 *F)
{
    sb_mat3 cofactor = sb_m3_cofactor(*F);
    sb_real J = sb_v3_dot(sb_m3_column(*F, 0), sb_m3_column(cofactor, 0));
    return sb_m3_add(sb_m3_scale(m->mu, *F), sb_m3_scale((m->lambda + m->mu) * (J - 1) - m->mu, cofactor));
}

SBI_FORCE_INLINE sb_real sbi_stable_energy(const sb_material *m, const sb_mat3 *F)
{
    sb_real growth = sb_m3_det(*F) - 1;
    return (sb_real)0.5 * m->mu * (sb_m3_ddot(*F, *F) - 3) +
           ((sb_real)0.5 * (m->lambda + m->mu) * growth - m->mu) * growth;
}

/* Block (i,k) = delta_ik mu I + (lambda + mu) c_i c_k^T + q e_ikn [f_n]x^T, c_i the rows of cof F,
 * q = (lambda + mu)(J - 1) - mu; the last part is d cof_ij/dF_kl = e_ikn e_jlp F_np. */
SBI_FORCE_INLINE void sbi_stable_tangent(const sb_material *m, const sb_mat3 *F, sb_real *A)
{
    sb_mat3 c = sb_m3_cofactor(*F);
    sb_real stiffness = m->lambda + m->mu;
    sb_real J = sb_v3_dot(sb_m3_column(*F, 0), sb_m3_column(c, 0)), q = stiffness * (J - 1) - m->mu;
    for (int i = 0; i < 3; i++) {
        sb_vec3 ci = sb_v3_scale(stiffness, sbi_material_row(&c, i));
        for (int k = i; k < 3; k++) {
            sb_mat3 block = sb_m3_outer(ci, sbi_material_row(&c, k));
            if (i == k) {
                block = sbi_material_affine(1, block, m->mu);
            } else {
                int n = 3 - i - k;
                sb_real signed_q = k == i + 1 ? q : -q; /* e_ikn for i < k */
                for (int j = 0; j < 3; j++) {
                    int l = (j + 1) % 3, p = (j + 2) % 3;
                    block.m[j][l] += signed_q * F->m[n][p];
                    block.m[l][j] -= signed_q * F->m[n][p];
                }
            }
            sbi_tangent_put(A, i, k, block);
        }
    }
}

/* ---- positive semidefinite projection of the hyperelastic tangents ---- */

/* 1 when the symmetric 9x9 A is positive semidefinite to rounding (L D L^T with the pivots in order). */
SB_INLINE int sbi_tangent_is_semidefinite(const sb_real *A)
{
    sb_real lower[9][9], largest = 0, tolerance;
    for (int r = 0; r < 9; r++) {
        largest = sb_max(largest, A[10 * r]);
        for (int c = 0; c <= r; c++)
            lower[r][c] = A[9 * r + c];
    }
    tolerance = 32 * SB_EPSILON * largest;
    for (int c = 0; c < 9; c++) {
        sb_real pivot = lower[c][c];
        if (pivot > tolerance) {
            for (int r = c + 1; r < 9; r++) {
                sb_real factor = lower[r][c] / pivot;
                for (int q = c + 1; q <= r; q++)
                    lower[r][q] -= factor * lower[q][c];
            }
            continue;
        }
        /* A zero pivot belongs to a semidefinite matrix only when its whole column is zero. */
        if (!(pivot >= -tolerance))
            return 0;
        for (int r = c + 1; r < 9; r++)
            if (!(sb_abs(lower[r][c]) <= tolerance))
                return 0;
    }
    return 1;
}

/* A between principal directions, F = U diag(s) V^T: in that frame only A_iijj = stretch[i][j] and,
 * with m the third index of the pair (i,j), A_ijij = same[m] and A_ijji = cross[m] are not 0. */
typedef struct sbi_principal {
    sb_mat3 stretch;
    sb_real same[3], cross[3];
} sbi_principal;

SB_INLINE void sbi_principal_svk(const sb_material *m, const sb_real *s, sbi_principal *out)
{
    sb_real squares = s[0] * s[0] + s[1] * s[1] + s[2] * s[2];
    sb_real pressure = (sb_real)0.5 * m->lambda * (squares - 3);
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        out->stretch.m[i][i] = (m->lambda + 3 * m->mu) * s[i] * s[i] + pressure - m->mu;
        out->stretch.m[j][k] = out->stretch.m[k][j] = m->lambda * s[j] * s[k];
        out->same[i] = pressure + m->mu * (s[j] * s[j] + s[k] * s[k] - 1);
        out->cross[i] = m->mu * s[j] * s[k];
    }
}

/* Divides by J, which is known to be positive, where a stretch may have been rounded to 0. */
SB_INLINE void sbi_principal_barrier(const sbi_barrier *c, const sb_real *s, sbi_principal *out)
{
    const sb_real squares[3] = {s[0] * s[0], s[1] * s[1], s[2] * s[2]}, theta = -(sb_real)4 / 3 * c->second;
    sb_real normal[3]; /* N_i = normal_i s_i */
    for (int i = 0; i < 3; i++)
        normal[i] = squares[(i + 1) % 3] + squares[(i + 2) % 3];
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        sb_real inverse = s[j] * s[k] / c->J, product = s[i] / c->J; /* 1/s_i and 1/(s_j s_k) */
        out->stretch.m[i][i] = c->alpha + 2 * c->beta + (c->gamma + c->epsilon) * inverse * inverse +
                               (c->zeta - 2 * c->second) * squares[i] + (2 * theta + c->second) * normal[i];
        out->stretch.m[j][k] = out->stretch.m[k][j] =
            (c->beta * (squares[j] + squares[k]) + theta * (normal[j] * squares[j] + normal[k] * squares[k]) +
             c->gamma) *
                product +
            c->zeta * s[j] * s[k];
        out->same[i] = c->alpha + c->second * squares[i];
        out->cross[i] = c->epsilon * product - c->second * s[j] * s[k];
    }
}

SB_INLINE void sbi_principal_stable(const sb_material *m, const sb_real *s, sbi_principal *out)
{
    sb_real stiffness = m->lambda + m->mu, q = stiffness * (s[0] * s[1] * s[2] - 1) - m->mu;
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        out->stretch.m[i][i] = m->mu + stiffness * s[j] * s[j] * s[k] * s[k];
        out->stretch.m[j][k] = out->stretch.m[k][j] = stiffness * s[i] * s[i] * s[j] * s[k] + q * s[i];
        out->same[i] = m->mu;
        out->cross[i] = -q * s[i];
    }
}

/* A += weight (d (x) e + e (x) d), exactly symmetric. */
SB_INLINE void sbi_tangent_add_pair(sb_real *A, sb_real weight, sb_mat3 d, sb_mat3 e)
{
    for (int p = 0; p < 9; p++)
        for (int q = p; q < 9; q++)
            A[9 * p + q] = A[9 * q + p] =
                A[9 * p + q] + weight * (d.m[p / 3][p % 3] * e.m[q / 3][q % 3] + e.m[p / 3][p % 3] * d.m[q / 3][q % 3]);
}

/* A from its principal form, F = U diag(s) V^T. */
SB_INLINE void sbi_principal_tangent(const sbi_principal *principal, sb_mat3 u, sb_mat3 v, sb_real *A)
{
    for (int i = 0; i < 81; i++)
        A[i] = 0;
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        sb_mat3 own = sb_m3_outer(sb_m3_column(u, k), sb_m3_column(v, k));
        sb_mat3 ii = sb_m3_outer(sb_m3_column(u, i), sb_m3_column(v, i));
        sb_mat3 jj = sb_m3_outer(sb_m3_column(u, j), sb_m3_column(v, j));
        sb_mat3 ij = sb_m3_outer(sb_m3_column(u, i), sb_m3_column(v, j));
        sb_mat3 ji = sb_m3_outer(sb_m3_column(u, j), sb_m3_column(v, i));
        sbi_tangent_add_dyad(A, principal->stretch.m[k][k], own);
        sbi_tangent_add_pair(A, principal->stretch.m[i][j], ii, jj);
        sbi_tangent_add_dyad(A, principal->same[k], ij);
        sbi_tangent_add_dyad(A, principal->same[k], ji);
        sbi_tangent_add_pair(A, principal->cross[k], ij, ji);
    }
}

/* The principal form of a hyperelastic model's tangent; F is admissible. */
SBI_FORCE_INLINE void sbi_principal_at(int model, const sb_material *m, const sb_mat3 *F, const sb_real *s,
                                       sbi_principal *out)
{
    sbi_barrier c;
    if (model == SB_SVK)
        sbi_principal_svk(m, s, out);
    else if (model == SB_STABLE_NEO_HOOKEAN)
        sbi_principal_stable(m, s, out);
    else if (sbi_barrier_at(model, m, F, &c))
        sbi_principal_barrier(&c, s, out);
}

/* Lifts the negative eigenvalues of the scaling modes sum_c e_c u_c v_c^T, e the eigenvectors of stretch. */
SB_INLINE void sbi_tangent_lift_scaling(sb_mat3 stretch, sb_mat3 u, sb_mat3 v, sb_real *A)
{
    sb_vec3 values;
    sb_mat3 modes;
    sb_m3_eigen(stretch, &values, &modes);
    const sb_real scaling[3] = {values.x, values.y, values.z};
    for (int k = 0; k < 3; k++) {
        sb_mat3 scaled = u;
        if (!(scaling[k] < 0))
            continue;
        for (int c = 0; c < 3; c++)
            for (int r = 0; r < 3; r++)
                scaled.m[r][c] *= modes.m[c][k];
        sbi_tangent_add_dyad(A, -scaling[k], sb_m3_mult(scaled, v));
    }
}

/* Lifts the negative eigenvalues of A to 0. A's eigenvectors are the scaling modes above, and for each
 * pair (i,j) u_i v_j^T - u_j v_i^T with same - cross (twist) and u_i v_j^T + u_j v_i^T with same + cross
 * (flip). These equal (g_i +- g_j)/(s_i +- s_j) with the division done by hand, so equal stretches need no
 * care (Smith et al. 2019). */
SB_INLINE void sbi_tangent_lift(const sbi_principal *principal, sb_mat3 u, sb_mat3 v, sb_real *A)
{
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        sb_mat3 ij = sb_m3_outer(sb_m3_column(u, i), sb_m3_column(v, j));
        sb_mat3 ji = sb_m3_outer(sb_m3_column(u, j), sb_m3_column(v, i));
        sb_real twist = principal->same[k] - principal->cross[k];
        sb_real flip = principal->same[k] + principal->cross[k];
        if (twist < 0)
            sbi_tangent_add_dyad(A, -(sb_real)0.5 * twist, sb_m3_sub(ij, ji));
        if (flip < 0)
            sbi_tangent_add_dyad(A, -(sb_real)0.5 * flip, sb_m3_add(ij, ji));
    }
    if (!sbi_material_is_positive(principal->stretch))
        sbi_tangent_lift_scaling(principal->stretch, u, v, A);
}

/* Projects the exact tangent A of a hyperelastic model at F; decomposes F only where A needs it. */
SBI_FORCE_INLINE void sbi_tangent_project(int model, const sb_material *m, const sb_mat3 *F, sb_real *A)
{
    if (sbi_tangent_is_semidefinite(A))
        return;
    sb_mat3 u, v;
    sb_vec3 stretches;
    sbi_principal principal;
    sb_m3_svd(*F, &u, &stretches, &v);
    const sb_real s[3] = {stretches.x, stretches.y, stretches.z};
    sbi_principal_at(model, m, F, s, &principal);
    sbi_tangent_lift(&principal, u, v, A);
}

/* ---- Ogden ---- */

/* With y_k = log s_k and x_k = y_k - log(J)/3: powers p_ik = exp(alpha_i x_k), slopes G_k = dW/dy_k = s_k dW/ds_k. */
typedef struct sbi_ogden {
    sb_mat3 u, v;
    sb_real s[3], x[3], J, slope[3];
    sb_real growth, volume; /* J U' and J U' + J^2 U'' */
} sbi_ogden;

/* (exp(y) - 1)/y */
SBI_FORCE_INLINE sb_real sbi_ogden_mean(sb_real y) { return sbi_material_mean_decay(-y); }

SB_INLINE int sbi_ogden_at(const sb_material *m, const sb_mat3 *F, sbi_ogden *out)
{
    sb_vec3 s;
    sb_real mean;
    out->J = sb_m3_det(*F);
    if (!(out->J > 0))
        return 0;
    sb_m3_svd(*F, &out->u, &s, &out->v);
    if (!(s.z > 0))
        return 0;
    out->s[0] = s.x, out->s[1] = s.y, out->s[2] = s.z;
    for (int k = 0; k < 3; k++)
        out->x[k] = sb_log(out->s[k]);
    mean = (out->x[0] + out->x[1] + out->x[2]) / 3;
    out->growth = 2 * out->J * (out->J - 1) / m->d1;
    out->volume = 2 * out->J * (2 * out->J - 1) / m->d1;
    for (int k = 0; k < 3; k++) {
        out->x[k] -= mean;
        out->slope[k] = 0;
        for (int i = 0; i < SB_MAX_OGDEN_TERMS; i++) { /* mu_i (p_ik - 1) */
            sb_real y = m->ogden_alpha[i] * out->x[k];
            out->slope[k] += m->ogden_mu[i] * y * sbi_ogden_mean(y);
        }
    }
    mean = (out->slope[0] + out->slope[1] + out->slope[2]) / 3;
    for (int k = 0; k < 3; k++)
        out->slope[k] += out->growth - mean;
    return 1;
}

SB_INLINE int sbi_ogden_energy(const sb_material *m, const sb_mat3 *F, sb_real *W)
{
    sbi_ogden o;
    if (!sbi_ogden_at(m, F, &o))
        return 0;
    *W = (o.J - 1) * (o.J - 1) / m->d1;
    for (int i = 0; i < SB_MAX_OGDEN_TERMS; i++)
        for (int k = 0; k < 3; k++)
            *W += m->ogden_mu[i] * o.x[k] * sbi_ogden_mean(m->ogden_alpha[i] * o.x[k]);
    return 1;
}

/* P = U diag(G/s) V^T */
SB_INLINE int sbi_ogden_stress(const sb_material *m, const sb_mat3 *F, sb_mat3 *P)
{
    sbi_ogden o;
    sb_mat3 scaled;
    if (!sbi_ogden_at(m, F, &o))
        return 0;
    scaled = o.u;
    for (int k = 0; k < 3; k++)
        for (int r = 0; r < 3; r++)
            scaled.m[r][k] *= o.slope[k] / o.s[k];
    *P = sb_m3_mult(scaled, o.v);
    return 1;
}

/* d2W/dy_k dy_l = sum mu_i alpha_i (p_ik d_kl - p_ik/3 - p_il/3 + sum_n p_in/9) + J U' + J^2 U'', from which
 *     A_iijj = (that - d_ij G_i)/(s_i s_j),   (g_i - g_j)/(s_i - s_j) = (s_j DG - G_j)/(s_i s_j)   with g = G/s and
 *     DG = (G_i - G_j)/(s_i - s_j) = sum mu_i alpha_i p_ij/s_j m(alpha_i t)/m(t),   t = log(s_i/s_j),   m = (exp - 1)/:
 * no division by what may be 0. */
SB_INLINE void sbi_principal_ogden(const sb_material *m, const sbi_ogden *o, sbi_principal *out)
{
    out->stretch = sb_m3_zero();
    for (int k = 0; k < 3; k++)
        out->same[k] = 0;
    for (int n = 0; n < SB_MAX_OGDEN_TERMS; n++) {
        sb_real p[3], alpha = m->ogden_alpha[n], modulus = m->ogden_mu[n] * alpha, ninth;
        for (int k = 0; k < 3; k++)
            p[k] = sb_exp(alpha * o->x[k]);
        ninth = (p[0] + p[1] + p[2]) / 9;
        for (int i = 0; i < 3; i++) {
            int j = (i + 1) % 3, k = (i + 2) % 3;
            sb_real t = o->x[j] - o->x[k];
            out->stretch.m[i][i] += modulus * (p[i] / 3 + ninth);
            out->stretch.m[j][k] += modulus * (ninth - (p[j] + p[k]) / 3);
            out->same[i] += modulus * p[k] * sbi_ogden_mean(alpha * t) / sbi_ogden_mean(t); /* s_k DG at first */
        }
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        sb_real product = o->s[j] * o->s[k], flip, twist;
        out->stretch.m[i][i] = (out->stretch.m[i][i] + o->volume - o->slope[i]) / (o->s[i] * o->s[i]);
        out->stretch.m[j][k] = out->stretch.m[k][j] = (out->stretch.m[j][k] + o->volume) / product;
        flip = (out->same[i] - o->slope[k]) / product;
        twist = (o->slope[j] / o->s[j] + o->slope[k] / o->s[k]) / (o->s[j] + o->s[k]);
        out->same[i] = (flip + twist) / 2;
        out->cross[i] = (flip - twist) / 2;
    }
}

/* The tangent, exact or without its negative eigenvalues. */
SB_INLINE int sbi_ogden_tangent(const sb_material *m, const sb_mat3 *F, sb_tangent_kind kind, sb_real *A)
{
    sbi_ogden o;
    sbi_principal principal;
    if (!sbi_ogden_at(m, F, &o))
        return 0;
    sbi_principal_ogden(m, &o, &principal);
    sbi_principal_tangent(&principal, o.u, o.v, A);
    if (kind != SB_TANGENT_EXACT)
        sbi_tangent_lift(&principal, o.u, o.v, A);
    return 1;
}

/* ---- fibres: what they add to a hyperelastic model (Holzapfel, Gasser and Ogden 2000) ----
 * W = k1/(2 k2) (exp(k2 e^2) - 1) with e = I4 - 1 > 0, I4 = |F a0|^2, a0 a unit vector; nothing when slack. The workers
 * add to their output, and return 0 with it untouched when the share is not finite. */

/* a = F a0, and the derivatives of W by I4 (0 when slack); 0 when not finite. */
SBI_FORCE_INLINE int sbi_fibre_at(const sb_material *m, const sb_mat3 *F, sb_vec3 a0, sb_vec3 *a, sb_real *first,
                                  sb_real *second)
{
    sb_real e, growth;
    *a = sb_m3_apply(*F, a0);
    e = sb_v3_dot(*a, *a) - 1;
    *first = *second = 0;
    if (!(e > 0) || !(m->fibre_stiffness > 0))
        return sb_is_finite(e);
    growth = m->fibre_stiffness * sb_exp(m->fibre_exponent * e * e);
    *first = growth * e;
    *second = growth * (1 + 2 * m->fibre_exponent * e * e);
    return sb_is_finite(*first) && sb_is_finite(*second);
}

/* The same with dispersion, H = kappa I + (1 - 3 kappa) a0 a0^T and E = F : F H - 1 for e: *pull = F H. */
SB_INLINE int sbi_dispersed_at(const sb_material *m, const sb_mat3 *F, sb_vec3 a0, sb_mat3 *pull, sb_real *e,
                               sb_real *first, sb_real *second)
{
    sb_real kappa = m->fibre_dispersion, growth;
    *pull = sb_m3_add(sb_m3_scale(kappa, *F), sb_m3_outer(sb_v3_scale(1 - 3 * kappa, sb_m3_apply(*F, a0)), a0));
    *e = sb_m3_ddot(*F, *pull) - 1;
    *first = *second = 0;
    if (!(*e > 0) || !(m->fibre_stiffness > 0))
        return sb_is_finite(*e);
    growth = m->fibre_stiffness * sb_exp(m->fibre_exponent * *e * *e);
    *first = growth * *e;
    *second = growth * (1 + 2 * m->fibre_exponent * *e * *e);
    return sb_is_finite(*first) && sb_is_finite(*second);
}

/* Contraction: n = F a0/l, the tension at l with its slope and what it has pulled in by when nothing is left of it, so
 * that no energy is below 0; 0 where l is 0 or not finite. */
SB_INLINE int sbi_active_at(const sb_material *m, const sb_mat3 *F, sb_vec3 a0, sb_vec3 *n, sb_real *stretch,
                            sb_real values[3])
{
    sb_vec3 a = sb_m3_apply(*F, a0);
    sb_real l = sb_v3_norm(a), w = m->fibre_width, T = m->fibre_tension, away;
    if (!(l > 0) || !sb_is_finite(l))
        return 0;
    *n = sb_v3_scale(1 / l, a);
    *stretch = l;
    values[0] = T, values[1] = 0, values[2] = T * l;
    if (!(w > 0))
        return 1;
    away = sb_min(sb_max((l - m->fibre_optimum) / w, -1), 1);
    values[0] = T * (1 - away * away);
    values[1] = away > -1 && away < 1 ? -2 * T * away / w : 0;
    values[2] = T * w * (away - away * away * away / 3 + (sb_real)2 / 3);
    return sb_is_finite(values[2]);
}

/* Fibres that are dispersed or contract. */
SBI_FORCE_INLINE int sbi_fibre_is_more(const sb_material *m)
{
    return m->fibre_dispersion > 0 || m->fibre_tension > 0 || sbi_material_is_prestretched(m);
}
SBI_FORCE_INLINE int sbi_fibre_is_none(sb_vec3 a0) { return a0.x == 0 && a0.y == 0 && a0.z == 0; }

SB_INLINE int sbi_fibre_more_energy(const sb_material *m, const sb_mat3 *F, sb_vec3 a0, sb_real *W)
{
    sb_mat3 pull;
    sb_vec3 n;
    sb_real e, first, second, stretch, values[3], energy = 0;
    if (sbi_fibre_is_none(a0))
        return 1;
    if (!sbi_dispersed_at(m, F, a0, &pull, &e, &first, &second))
        return 0;
    if (first > 0)
        energy = (sb_real)0.5 * m->fibre_stiffness * e * e * sbi_material_mean_decay(-m->fibre_exponent * e * e);
    if (m->fibre_tension > 0) {
        if (!sbi_active_at(m, F, a0, &n, &stretch, values))
            return 0;
        energy += values[2];
    }
    if (!sb_is_finite(energy))
        return 0;
    *W += energy;
    return 1;
}

/* P = 2 W' F H + T f n a0^T */
SB_INLINE int sbi_fibre_more_stress(const sb_material *m, const sb_mat3 *F, sb_vec3 a0, sb_mat3 *P)
{
    sb_mat3 pull;
    sb_vec3 n;
    sb_real e, first, second, stretch, values[3];
    if (sbi_fibre_is_none(a0))
        return 1;
    if (!sbi_dispersed_at(m, F, a0, &pull, &e, &first, &second))
        return 0;
    if (m->fibre_tension > 0) {
        if (!sbi_active_at(m, F, a0, &n, &stretch, values))
            return 0;
        *P = sb_m3_add(*P, sb_m3_outer(sb_v3_scale(values[0], n), a0));
    }
    if (first > 0)
        *P = sb_m3_add(*P, sb_m3_scale(2 * first, pull));
    return 1;
}

/* A_ijkl += block_jl d_ik */
SB_INLINE void sbi_tangent_add_block(sb_real *A, sb_mat3 block)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int l = 0; l < 3; l++)
                A[9 * (3 * i + j) + 3 * i + l] += block.m[j][l];
}

/* A = 4 W'' (F H) (x) (F H) + 2 W' d_ik H_jl, semidefinite since H is, + T [f/l (I - n n^T) + f' n n^T]_ik (a0
 * a0^T)_jl, which is where f' >= 0. */
SB_INLINE int sbi_fibre_more_tangent(const sb_material *m, const sb_mat3 *F, sb_vec3 a0, sb_tangent_kind kind,
                                     sb_real *A)
{
    const sb_real kappa = m->fibre_dispersion;
    const sb_mat3 along = sb_m3_outer(a0, a0); /* exactly symmetric */
    sb_mat3 pull;
    sb_vec3 n;
    sb_real e, first, second, stretch, values[3];
    if (sbi_fibre_is_none(a0))
        return 1;
    if (!sbi_dispersed_at(m, F, a0, &pull, &e, &first, &second))
        return 0;
    if (m->fibre_tension > 0) {
        if (!sbi_active_at(m, F, a0, &n, &stretch, values))
            return 0;
        if (kind != SB_TANGENT_EXACT)
            values[1] = sb_max(values[1], 0);
        sbi_tangent_add_block(A, sb_m3_scale(values[0] / stretch, along));
        sbi_tangent_add_dyad(A, values[1] - values[0] / stretch, sb_m3_outer(n, a0));
    }
    if (second > 0) {
        sbi_tangent_add_dyad(A, 4 * second, pull);
        sbi_tangent_add_block(A, sbi_material_affine(2 * first * (1 - 3 * kappa), along, 2 * first * kappa));
    }
    return 1;
}

/* ---- prestretch: W'(F) = W(F G) / det G ---- */

SB_INLINE sb_mat3 sbi_prestretch_before(const sb_material *m, const sb_mat3 *F) { return sb_m3_mul(*F, m->prestretch); }

/* Of fibres that have the direction a0 at rest of the mesh: theirs where they have no stress; 0 stays. */
SB_INLINE sb_vec3 sbi_prestretch_fibre(const sb_material *m, sb_vec3 a0)
{
    sb_vec3 a = sb_m3_apply(sb_m3_inverse(m->prestretch), a0);
    sb_real length = sb_v3_norm(a);
    return length > 0 ? sb_v3_scale(1 / length, a) : a;
}

/* P G^T / det G */
SB_INLINE sb_mat3 sbi_prestretch_stress(const sb_material *m, sb_mat3 P)
{
    return sb_m3_scale(1 / sb_m3_det(m->prestretch), sb_m3_mult(P, m->prestretch));
}

/* out_ijkl += A_ibkd G_jb G_ld / det G, exactly symmetric where A is. */
SB_INLINE void sbi_prestretch_add_tangent(const sb_material *m, const sb_real *A, sb_real *out)
{
    const sb_real scale = 1 / sb_m3_det(m->prestretch);
    for (int i = 0; i < 3; i++)
        for (int k = i; k < 3; k++) {
            sb_mat3 block;
            for (int b = 0; b < 3; b++)
                for (int d = 0; d < 3; d++)
                    block.m[b][d] = A[9 * (3 * i + b) + 3 * k + d];
            block = sb_m3_scale(scale, sb_m3_mult(sb_m3_mul(m->prestretch, block), m->prestretch));
            for (int j = 0; j < 3; j++)
                for (int l = 0; l < 3; l++) {
                    sb_real value = i == k ? (sb_real)0.5 * (block.m[j][l] + block.m[l][j]) : block.m[j][l];
                    out[9 * (3 * i + j) + 3 * k + l] += value;
                    if (i != k)
                        out[9 * (3 * k + l) + 3 * i + j] += value;
                }
        }
}

SB_INLINE int sbi_fibre_prestretched_energy(const sb_material *m, const sb_mat3 *F, sb_vec3 a0, sb_real *W)
{
    sb_mat3 f = sbi_prestretch_before(m, F);
    sb_real energy = 0;
    if (!sbi_fibre_more_energy(m, &f, sbi_prestretch_fibre(m, a0), &energy))
        return 0;
    *W += energy / sb_m3_det(m->prestretch);
    return 1;
}

SB_INLINE int sbi_fibre_prestretched_stress(const sb_material *m, const sb_mat3 *F, sb_vec3 a0, sb_mat3 *P)
{
    sb_mat3 f = sbi_prestretch_before(m, F), stress = sb_m3_zero();
    if (!sbi_fibre_more_stress(m, &f, sbi_prestretch_fibre(m, a0), &stress))
        return 0;
    *P = sb_m3_add(*P, sbi_prestretch_stress(m, stress));
    return 1;
}

SB_INLINE int sbi_fibre_prestretched_tangent(const sb_material *m, const sb_mat3 *F, sb_vec3 a0, sb_tangent_kind kind,
                                             sb_real *A)
{
    sb_mat3 f = sbi_prestretch_before(m, F);
    sb_real tangent[81] = {0};
    if (!sbi_fibre_more_tangent(m, &f, sbi_prestretch_fibre(m, a0), kind, tangent))
        return 0;
    sbi_prestretch_add_tangent(m, tangent, A);
    return 1;
}

SBI_FORCE_INLINE int sbi_fibre_energy(const sb_material *m, const sb_mat3 *F, sb_vec3 a0, sb_real *W)
{
    sb_vec3 a = sb_m3_apply(*F, a0);
    sb_real e = sb_v3_dot(a, a) - 1, energy;
    if (sbi_fibre_is_more(m))
        return sbi_material_is_prestretched(m) ? sbi_fibre_prestretched_energy(m, F, a0, W)
                                               : sbi_fibre_more_energy(m, F, a0, W);
    if (!(e > 0) || !(m->fibre_stiffness > 0))
        return sb_is_finite(e);
    /* (exp(q) - 1)/q with q = k2 e^2: 1 for k2 = 0 */
    energy = (sb_real)0.5 * m->fibre_stiffness * e * e * sbi_material_mean_decay(-m->fibre_exponent * e * e);
    if (!sb_is_finite(energy))
        return 0;
    *W += energy;
    return 1;
}

/* P = 2 W' a a0^T */
SBI_FORCE_INLINE int sbi_fibre_stress(const sb_material *m, const sb_mat3 *F, sb_vec3 a0, sb_mat3 *P)
{
    sb_vec3 a;
    sb_real first, second;
    if (sbi_fibre_is_more(m))
        return sbi_material_is_prestretched(m) ? sbi_fibre_prestretched_stress(m, F, a0, P)
                                               : sbi_fibre_more_stress(m, F, a0, P);
    if (!sbi_fibre_at(m, F, a0, &a, &first, &second))
        return 0;
    if (first > 0)
        *P = sb_m3_add(*P, sb_m3_outer(sb_v3_scale(2 * first, a), a0));
    return 1;
}

/* A = 4 W'' (a a0^T) (x) (a a0^T) + 2 W' I (.) a0 a0^T: a dyad and a product of semidefinite matrices with W' and W''
 * never below 0, so it is semidefinite as it stands; kind is for what contracts. */
SBI_FORCE_INLINE int sbi_fibre_tangent(const sb_material *m, const sb_mat3 *F, sb_vec3 a0, sb_tangent_kind kind,
                                       sb_real *A)
{
    sb_vec3 a;
    sb_real first, second;
    if (sbi_fibre_is_more(m))
        return sbi_material_is_prestretched(m) ? sbi_fibre_prestretched_tangent(m, F, a0, kind, A)
                                               : sbi_fibre_more_tangent(m, F, a0, kind, A);
    if (!sbi_fibre_at(m, F, a0, &a, &first, &second))
        return 0;
    if (!(second > 0))
        return 1;
    const sb_mat3 tension = sb_m3_scale(2 * first, sb_m3_outer(a0, a0)); /* exactly symmetric in this order */
    sbi_tangent_add_dyad(A, 4 * second, sb_m3_outer(a, a0));
    sbi_tangent_add_block(A, tension);
    return 1;
}

/* ---- by model ---- */

SBI_FORCE_INLINE int sbi_model_energy(int model, const sb_material *m, const sb_mat3 *F, sb_quat *rotation, sb_real *W)
{
    switch (model) {
    case SB_LINEAR: *W = sbi_hooke_energy(m, sbi_linear_strain(F)); return 1;
    case SB_COROTATED:
    case SB_COROTATED_INVERTIBLE: {
        sbi_corotation c = sbi_corotate(model, F, rotation);
        *W = sbi_corotated_energy(m, F, &c.r);
        return 1;
    }
    case SB_SVK: *W = sbi_hooke_energy(m, sbi_green_strain(F)); return 1;
    case SB_NEO_HOOKEAN:
    case SB_NEO_HOOKEAN_ISOCHORIC:
    case SB_MOONEY_RIVLIN:
    case SB_REDUCED_POLYNOMIAL:
    case SB_FUNG: return sbi_barrier_energy(model, m, F, W);
    case SB_STABLE_NEO_HOOKEAN: *W = sbi_stable_energy(m, F); return 1;
    case SB_OGDEN: return sbi_ogden_energy(m, F, W);
    case SB_CUSTOM_LAW: return sbi_law_energy(m, F, W);
    default: return 0;
    }
}

SBI_FORCE_INLINE int sbi_model_stress(int model, const sb_material *m, const sb_mat3 *F, sb_quat *rotation, sb_mat3 *P)
{
    switch (model) {
    case SB_LINEAR: *P = sbi_hooke_stress(m, sbi_linear_strain(F)); return 1;
    case SB_COROTATED:
    case SB_COROTATED_INVERTIBLE: {
        sbi_corotation c = sbi_corotate(model, F, rotation);
        *P = sbi_corotated_stress(m, F, &c.r);
        return 1;
    }
    case SB_SVK: *P = sb_m3_mul(*F, sbi_hooke_stress(m, sbi_green_strain(F))); return 1;
    case SB_NEO_HOOKEAN:
    case SB_NEO_HOOKEAN_ISOCHORIC:
    case SB_MOONEY_RIVLIN:
    case SB_REDUCED_POLYNOMIAL:
    case SB_FUNG: return sbi_barrier_stress(model, m, F, P);
    case SB_STABLE_NEO_HOOKEAN: *P = sbi_stable_stress(m, F); return 1;
    case SB_OGDEN: return sbi_ogden_stress(m, F, P);
    case SB_CUSTOM_LAW: return sbi_law_stress(m, F, P);
    default: return 0;
    }
}

SBI_FORCE_INLINE int sbi_model_tangent(int model, const sb_material *m, const sb_mat3 *F, sb_quat *rotation,
                                       const sb_tangent_kind kind, sb_real *A)
{
    switch (model) {
    case SB_LINEAR: sbi_linear_tangent(m, A); return 1;
    case SB_COROTATED:
    case SB_COROTATED_INVERTIBLE: sbi_corotated_tangent(model, m, F, rotation, kind, A); return 1;
    case SB_SVK: sbi_svk_tangent(m, F, A); break;
    case SB_NEO_HOOKEAN:
    case SB_NEO_HOOKEAN_ISOCHORIC:
    case SB_MOONEY_RIVLIN:
    case SB_REDUCED_POLYNOMIAL:
    case SB_FUNG:
        if (!sbi_barrier_tangent(model, m, F, A))
            return 0;
        break;
    case SB_STABLE_NEO_HOOKEAN: sbi_stable_tangent(m, F, A); break;
    case SB_OGDEN: return sbi_ogden_tangent(m, F, kind, A);
    case SB_CUSTOM_LAW: return sbi_law_tangent(m, F, kind, A);
    default: return 0;
    }
    if (kind != SB_TANGENT_EXACT)
        sbi_tangent_project(model, m, F, A);
    return 1;
}

#endif /* SBI_MATERIAL_MODELS_H */
