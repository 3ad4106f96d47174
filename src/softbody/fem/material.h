/* material: constitutive models at one point: energy, stress and tangent of a deformation gradient. Floor 2.
 *
 * Every model is isotropic and elastic: W(F) [J/m^3 of reference volume], P = dW/dF [Pa] (the first
 * Piola-Kirchhoff stress) and A = dP/dF [Pa], with F = dx/dX dimensionless and J = det F. Fibres add to a
 * hyperelastic model in a direction that the caller gives with each F; Prony terms let it relax in time. No
 * function allocates or keeps state; all are thread-safe. */
#ifndef SB_MATERIAL_H
#define SB_MATERIAL_H

#include "../base/core.h"
#include "../base/dense.h"

typedef enum sb_material_model {
    /* Small strain e = sym(F) - I: lambda/2 tr(e)^2 + mu e:e; a rotation strains it. */
    SB_LINEAR = 1,
    /* F = R S: mu |F - R|^2 + lambda/2 tr(S - I)^2, R warm-started. */
    SB_COROTATED = 2,
    /* The same energy with R from the signed SVD at each call: no history (Irving et al. 2004). */
    SB_COROTATED_INVERTIBLE = 3,
    /* St.Venant-Kirchhoff, E = (F^T F - I)/2: lambda/2 tr(E)^2 + mu E:E. */
    SB_SVK = 4,
    /* mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2, I1 = F:F; needs J > 0. */
    SB_NEO_HOOKEAN = 5,
    /* C10 (J^(-2/3) I1 - 3) + (J - 1)^2/D1; needs J > 0. */
    SB_NEO_HOOKEAN_ISOCHORIC = 6,
    /* mu/2 (I1 - 3) - mu (J - 1) + (lambda + mu)/2 (J - 1)^2 (after Smith et al. 2018). */
    SB_STABLE_NEO_HOOKEAN = 7,
    /* C10 (I1b - 3) + C01 (I2b - 3) + (J - 1)^2/D1, I1b = J^(-2/3) I1, I2b = J^(-4/3) I2; needs J > 0. */
    SB_MOONEY_RIVLIN = 8,
    /* sum over i = 1..3 of Ci0 (I1b - 3)^i, + (J - 1)^2/D1; needs J > 0. */
    SB_REDUCED_POLYNOMIAL = 9,
    /* sum of mu_i/alpha_i (l_0^alpha_i + l_1^alpha_i + l_2^alpha_i - 3), + (J - 1)^2/D1, with l_k = J^(-1/3) s_k of the
     * principal stretches s_k (Ogden 1972); needs J > 0. */
    SB_OGDEN = 10,
    /* C10/b (exp(b (I1b - 3)) - 1) + (J - 1)^2/D1: Fung's exponential for tissue without directions (Demiray 1972);
     * needs J > 0. */
    SB_FUNG = 11,
    /* law_scale times a law of the caller's own, see sb_material_law, + (J - 1)^2/D1. */
    SB_CUSTOM_LAW = 12
} sb_material_model;

/* A material law of the caller's own: W(F) [J/m^3], P = dW/dF [Pa] and A = dP/dF [Pa], A[9*(3*i+j) + (3*k+l)] =
 * dP_ij/dF_kl, of F at any J. Each call writes its last argument and returns 1, or 0 where F is not admissible: a step
 * backs off then as from an inverted element. They are made from the threads of sb_jobs at the same time, must not
 * keep anything from one call to the next, and must give the same bits for the same F. tangent may be NULL: central
 * differences of the stress then (18 calls of it, right to some 1e-9, in float 1e-4). The struct and what user points
 * to are lent: they stay where they are and as they are for as long as any body lives that was given them.
 *
 * sb_material_check, and so every call that takes a material, tries a law at some ten F with stretches between 0.5 and
 * 1.5 (some 800 calls) and refuses one by its name whose stress is not the difference quotient of its energy, whose
 * tangent is not that of its stress, that depends on the observer (P(QF) is not Q P(F)), whose energy or stress at
 * F = I is not 0, or that resists no change of volume. A law that has no value later on is SB_ERROR_INVERTED of the
 * step, which is undone.
 *
 * States and recordings do not hold functions. They hold the law's name: where they are loaded or replayed, a material
 * that the body was given before must have had a law of that name in its field law, whatever its model
 * (SB_ERROR_MATERIAL otherwise). A recording that brings a law in later on is thus replayed on a body made with
 * sb_material.law set beforehand. The name has to tell laws apart, parameters included: a body refuses two of one name.
 *
 * ```c
 * #include "softbody.h"
 * #include <stdio.h>
 *
 * typedef struct my_gent { sb_real mu, limit; } my_gent; // Pa; of I1b - 3, without unit
 *
 * static int share(const my_gent *g, const sb_mat3 *F, sb_real *J, sb_real *x)
 * {
 *     *J = sb_m3_det(*F);
 *     if (!(*J > 0))
 *         return 0;
 *     *x = sb_m3_ddot(*F, *F) / (sb_cbrt(*J) * sb_cbrt(*J)) - 3; // I1b - 3
 *     return *x < g->limit;
 * }
 * static int energy(void *user, const sb_mat3 *F, sb_real *W)
 * {
 *     const my_gent *g = user;
 *     sb_real J, x;
 *     if (!share(g, F, &J, &x))
 *         return 0; // not admissible
 *     *W = -g->mu * g->limit / 2 * sb_log(1 - x / g->limit);
 *     return 1;
 * }
 * static int stress(void *user, const sb_mat3 *F, sb_mat3 *P)
 * {
 *     const my_gent *g = user;
 *     sb_real J, x, slope;
 *     if (!share(g, F, &J, &x))
 *         return 0;
 *     slope = g->mu / (1 - x / g->limit) / (sb_cbrt(J) * sb_cbrt(J));
 *     *P = sb_m3_scale(slope, sb_m3_sub(*F, sb_m3_scale(sb_m3_ddot(*F, *F) / (3 * J), sb_m3_cofactor(*F))));
 *     return 1;
 * }
 *
 * int main(void)
 * {
 *     my_gent tissue = {2000, 1};
 *     sb_material_law law = {"tissue of mine, 2 kPa, 1", &tissue, energy, stress, NULL};
 *     sb_material material = sb_material_custom(&law, (sb_real)5e4, 1060); // its bulk modulus is the library's
 *     sb_error error;
 *     if (sb_material_check(&material, &error) != SB_OK) {
 *         printf("%s\n", error.message);
 *         return 1;
 *     }
 *     return 0;
 * }
 * ```
 */
typedef struct sb_material_law {
    const char *name; /* at least one character */
    void *user;       /* handed to the calls: the law's parameters */
    int (*energy)(void *user, const sb_mat3 *F, sb_real *W);
    int (*stress)(void *user, const sb_mat3 *F, sb_mat3 *P);
    int (*tangent)(void *user, const sb_mat3 *F, sb_real *A); /* 81 values, or NULL */
} sb_material_law;

enum { SB_MAX_PRONY_TERMS = 8, SB_MAX_OGDEN_TERMS = 4 };

/* A material: plain data, filled by a constructor below or by hand (then see sb_material_check). The
 * constructors set every field for every model: all models have Hooke's tangent with lambda, mu at F = I,
 * and c10 + c01 = mu/2, d1 = 2/bulk. Only the isochoric models (SB_NEO_HOOKEAN_ISOCHORIC and those from
 * SB_MOONEY_RIVLIN on) evaluate the c's, SB_OGDEN its terms and SB_CUSTOM_LAW its law in their place, and d1; the
 * others evaluate lambda and mu.
 */
typedef struct sb_material {
    sb_material_model model;
    sb_real density;                         /* mass per reference volume [kg/m^3], > 0; soft tissue: 900 to 1100 */
    sb_real lambda;                          /* first Lame constant [Pa]; lambda + 2 mu/3 > 0 */
    sb_real mu;                              /* shear modulus [Pa], > 0 */
    sb_real c10;                             /* [Pa], > 0; Mooney-Rivlin: c10 + c01 > 0 */
    sb_real d1;                              /* [1/Pa], > 0; in Abaqus' convention, bulk = 2/d1 */
    sb_real c01;                             /* [Pa], any sign; Mooney-Rivlin, else 0 */
    sb_real c20, c30;                        /* [Pa], any sign; reduced polynomial, else 0 */
    sb_real fung_exponent;                   /* b, >= 0; Fung, else 0 */
    sb_real ogden_mu[SB_MAX_OGDEN_TERMS];    /* [Pa], any sign; Ogden, else 0. 0: no term */
    sb_real ogden_alpha[SB_MAX_OGDEN_TERMS]; /* any sign, not 0 where mu is not; sum of mu_i alpha_i > 0 */
    sb_real fibre_stiffness;                 /* k1 [Pa], >= 0; 0: no fibres */
    sb_real fibre_exponent;                  /* k2, >= 0 */
    sb_real fibre_dispersion;                /* kappa, [0, 1/3]: 0 all along one direction, 1/3 along all alike */
    sb_real fibre_tension;                   /* T [Pa], >= 0: active contraction; 0: none */
    sb_real fibre_optimum;                   /* stretch at which it is strongest, > 0 where there is a width */
    sb_real fibre_width;                     /* > 0: no tension so far from the optimum; 0: the same at any stretch */
    sb_mat3 prestretch;                      /* G, det G > 0; zeros: none */
    int prony_count;                         /* terms of g(t) = 1 - sum g_i (1 - exp(-t/tau_i)); 0: elastic */
    sb_real prony_g[SB_MAX_PRONY_TERMS];     /* each in (0, 1), their sum below 1 */
    sb_real prony_tau[SB_MAX_PRONY_TERMS];   /* [s], > 0 */
    const sb_material_law *law;              /* custom law, not copied; other models only keep it for later */
    sb_real law_scale;                       /* > 0, the law's energy is multiplied by it; custom law, else 0 */
} sb_material;

/* Which derivative of P a solver gets. */
typedef enum sb_tangent_kind {
    SB_TANGENT_EXACT = 0, /* dP/dF: quadratic Newton, may be indefinite under compression */
    SB_TANGENT_SPD = 1,   /* nearest positive semidefinite matrix: negative eigenvalues replaced by 0 */
    SB_TANGENT_QUASI = 2  /* corotated models: rotated Hooke tangent (dR ignored), semidefinite and cheapest;
                             other models: as SB_TANGENT_SPD */
} sb_tangent_kind;

/* ---- constructors ------------------------------------------------------------------------------------
 * young [Pa] > 0, poisson in (-1, 0.5), density [kg/m^3] > 0. Nothing is checked here: parameters out
 * of range give a material that sb_material_check refuses. */
SB_API sb_material sb_material_linear(sb_real young, sb_real poisson, sb_real density);
SB_API sb_material sb_material_corotated(sb_real young, sb_real poisson, sb_real density);
SB_API sb_material sb_material_corotated_invertible(sb_real young, sb_real poisson, sb_real density);
SB_API sb_material sb_material_svk(sb_real young, sb_real poisson, sb_real density);
SB_API sb_material sb_material_neo_hookean(sb_real young, sb_real poisson, sb_real density);
SB_API sb_material sb_material_stable_neo_hookean(sb_real young, sb_real poisson, sb_real density);
/* c10 [Pa] > 0, d1 [1/Pa] > 0: Abaqus' and CalculiX' constants, mu = 2 c10 and bulk = 2/d1. */
SB_API sb_material sb_material_neo_hookean_isochoric(sb_real c10, sb_real d1, sb_real density);
/* The same convention with mu = 2 (c10 + c01) > 0; c10 or c01 [Pa] may be 0 or negative, at the price of a
 * material that softens or turns unstable under large strain. */
SB_API sb_material sb_material_mooney_rivlin(sb_real c10, sb_real c01, sb_real d1, sb_real density);
/* Reduced polynomial of order 3 (Yeoh 1993); c30 = 0: order 2. c10 [Pa] > 0, mu = 2 c10; c20 and c30 [Pa] of
 * any sign: a negative one that is not outweighed makes the material unstable under large strain. */
SB_API sb_material sb_material_reduced_polynomial(sb_real c10, sb_real c20, sb_real c30, sb_real d1, sb_real density);
/* Ogden's material with 1 to SB_MAX_OGDEN_TERMS terms mu[terms] [Pa] and alpha[terms], of any sign; its shear modulus
 * is sum of mu_i alpha_i/2 > 0. (Abaqus' mu_i is alpha_i/2 times this one.) One term with alpha 2 is neo-Hookean, two
 * with 2 and -2 are Mooney-Rivlin. Another number of terms gives a material that sb_material_check refuses. */
SB_API sb_material sb_material_ogden(const sb_real *mu, const sb_real *alpha, int terms, sb_real d1, sb_real density);
/* Fung's exponential: c10 [Pa] > 0 as above, exponent b >= 0 (0: neo-Hookean): stiffness grows with exp(b (I1b - 3)).
 * Directions: sb_material_with_fibres. */
SB_API sb_material sb_material_fung(sb_real c10, sb_real exponent, sb_real d1, sb_real density);
/* A law of the caller's own, lent, see sb_material_law, and bulk [Pa] >= 0 that the library adds as (J - 1)^2/d1,
 * d1 = 2/bulk. A law of F J^(-1/3) alone with its bulk modulus here is what elements that do not lock (B-bar) need:
 * they evaluate the law at each point and the bulk term in the mean. A law that has its own volume term goes with bulk
 * 0, and locks as any fully integrated element. Prony terms relax the law and leave the bulk term. lambda and mu are
 * those of the law's tangent at F = I, averaged over directions; they scale tolerances and steps. NULL, a call that is
 * missing or a law without a tangent at F = I give a material that sb_material_check refuses. */
SB_API sb_material sb_material_custom(const sb_material_law *law, sb_real bulk, sb_real density);
/* The hyperelastic material, reinforced by one family of fibres (Holzapfel, Gasser and Ogden 2000):
 *     W += k1/(2 k2) (exp(k2 (I4 - 1)^2) - 1) for I4 > 1, I4 = |F a0|^2, a0 the unit direction at rest,
 * and k1/2 (I4 - 1)^2 for k2 = 0; slack fibres (I4 <= 1) do nothing. k1 [Pa] >= 0, k2 >= 0. The moduli lambda, mu
 * stay those of the matrix. */
SB_API sb_material sb_material_with_fibres(sb_material material, sb_real k1, sb_real k2);
/* Fibres that point not all alike (Gasser, Ogden and Holzapfel 2006): the strain I4 - 1 above becomes
 *     E = kappa I1 + (1 - 3 kappa) I4 - 1,
 * kappa in [0, 1/3]. I1 and I4 are those of F, as above, so that a growing volume stretches fibres; at constant volume
 * this is the published model. Slack: E <= 0. A body may have a second family of them, see sb_body_def.second_fibres.
 */
SB_API sb_material sb_material_with_dispersion(sb_material material, sb_real kappa);
/* The hyperelastic material, contracting along its fibres with a tension [Pa] >= 0 per area at rest, at stretch l = |F
 * a0| P += T f(l) (F a0) (x) a0/l,   f = max(0, 1 - ((l - optimum)/width)^2), or 1 for width 0, along each family
 * alike, dispersion left out, not relaxing. With or without passive fibres (k1 = 0). Drive the tension in time by
 * sb_body_set_tension. Beyond the optimum the tangent is not positive definite. */
SB_API sb_material sb_material_with_contraction(sb_material material, sb_real tension, sb_real optimum, sb_real width);
/* The hyperelastic material, strained where the mesh is at rest: G takes each piece of it from where it had no stress
 * to its shape in the mesh, det G > 0, so that
 *     W'(F) = W(F G) / det G,   P = P(F G) G^T / det G
 * per volume of the mesh, fibres included, whose directions are those in the mesh at rest. Stress that an organ has
 * where it was imaged, by region: arteries that draw together when cut, tendons under tension, swelling (G = s I, s <
 * 1). The mesh's own shape is then balanced only where supports hold it, or the regions' stresses each other: statics
 * find the balance, and a body of one G that nothing holds goes to F = G^-1, where it has no stress. Moduli, density
 * and tolerances stay those of the material and the mesh. Prony terms let this stress relax as any other, from when the
 * body first moves. G = I takes it away. Source: Hoger 1986; Gee, Foerster and Wall 2010. */
SB_API sb_material sb_material_with_prestretch(sb_material material, sb_mat3 G);
/* The hyperelastic material, relaxing by g(t) = 1 - sum g_i (1 - exp(-t/tau_i)): what it has of stress at constant
 * bulk modulus (isochoric models: psi's share) and of fibre stress fades, its moduli being the instantaneous ones.
 * g[count] each in (0, 1) with a sum below 1, tau[count] [s] > 0, count <= SB_MAX_PRONY_TERMS; 0 terms make it
 * elastic again. */
SB_API sb_material sb_material_with_prony(sb_material material, const sb_real *g, const sb_real *tau, int count);

/* ---- presets: liver, as published ----
 * Constants from tables 4.1 to 4.3 of S. Suwelack, Real-Time Biomechanics of Soft Tissue, KIT 2014. */
typedef enum sb_preset {
    /* Reduced polynomial C10 79.2 Pa, C20 257 Pa, D1 4.38e-4 1/Pa; g 0.832, tau 0.15 s (Jordan et al. 2009). */
    SB_LIVER_JORDAN = 1,
    /* Reduced polynomial C10 397.7 Pa, C20 208.6 Pa, D1 8.38e-4 1/Pa; g 0.503, 0.185, 0.142, tau 2.1, 47.1,
     * 380 s (Raghunathan et al. 2010). */
    SB_LIVER_RAGHUNATHAN = 2,
    /* Mooney-Rivlin C10 322.96 Pa, C01 161.47 Pa; g 0.2866, 0.2022, tau 1.537, 6.09 s (Kim and Srinivasan 2005).
     * D1 is published as "below 1e-5 1/Pa"; here it is 1e-5, the softest of these (Poisson's ratio 0.4976). */
    SB_LIVER_KIM = 3,
    /* Simplified: isochoric neo-Hookean C10 365 Pa, D1 8.38e-4 1/Pa (Young's modulus 1987 Pa, Poisson's ratio
     * 0.36). Goes with a body's damping_stiffness of 0.21 s in place of Prony terms. */
    SB_LIVER_NEO_HOOKEAN = 4,
    /* Linear, Young's modulus 1987 Pa, Poisson's ratio 0.36; goes with a damping_stiffness of 0.21 s. */
    SB_LIVER_LINEAR = 5
} sb_preset;
/* A material by name; liver has a density of about 1060 kg/m^3. An unknown preset gives a material that
 * sb_material_check refuses. */
SB_API sb_material sb_material_preset(sb_preset preset, sb_real density);

/* Constants of the small-strain limit: Young's modulus [Pa], Poisson's ratio, bulk modulus [Pa]. */
SB_API sb_real sb_material_young(const sb_material *material);
SB_API sb_real sb_material_poisson(const sb_material *material);
SB_API sb_real sb_material_bulk(const sb_material *material);

/* Checks model, finiteness and ranges of a material (mu > 0, bulk > 0, density > 0, Poisson's ratio in
 * (-1, 0.5); isochoric: c10 + c01 > 0, d1 > 0 and in agreement with lambda, mu; fibres, prestretch and Prony terms as
 * their constructors say, and on hyperelastic models only). Returns SB_OK, or SB_ERROR_ARGUMENT (NULL, unknown
 * model, count of Prony terms), SB_ERROR_NOT_FINITE or SB_ERROR_MATERIAL with the offending value in error (may
 * be NULL). It does not decide whether a material stays stable under large strain: see sb_material_fit. */
SB_API sb_result sb_material_check(const sb_material *material, sb_error *error);

/* 1 when the model has a finite energy for J <= 0; 0 when it needs J > 0 (or is unknown, or a law that decides itself).
 * SB_SVK has one, but does not oppose inversion: it has the same value for F and its mirror image, so an inverted
 * element may come to rest. */
SB_API int sb_material_allows_inversion(sb_material_model model);
/* 1 when the tangent does not depend on F. */
SB_API int sb_material_is_linear(sb_material_model model);
/* 1 for the models that take fibres and Prony terms: all but the linear and corotated ones. */
SB_API int sb_material_is_hyperelastic(sb_material_model model);

/* ---- evaluation at one point -------------------------------------------------------------------------
 * F: deformation gradient. rotation: SB_COROTATED's warm start, a unit quaternion read and overwritten with
 * the rotation of F (from a near-by F it saves most of the work); NULL starts cold. Other models leave it
 * alone. All return 1, or 0 with every output untouched when F is not admissible: J <= 0 where the model
 * needs J > 0, F not finite, a result that overflows, an unknown model or a NULL pointer. */

/* *W = elastic energy per reference volume [J/m^3]. */
SB_API int sb_material_energy(const sb_material *material, const sb_mat3 *F, sb_quat *rotation, sb_real *W);
/* *P = dW/dF, first Piola-Kirchhoff stress [Pa]: force per reference area, P N = traction. */
SB_API int sb_material_stress(const sb_material *material, const sb_mat3 *F, sb_quat *rotation, sb_mat3 *P);
/* A[9*(3*i+j) + (3*k+l)] = dP_ij/dF_kl [Pa], 81 values, exactly symmetric.
 *
 * The corotated models' energy has a kink where the rotation is not unique, at s_2 + s_3 = 0 for principal
 * stretches s_1 >= s_2 >= |s_3|: there the exact tangent is infinite. A divides by s_i + s_j, but never by
 * less than 1e-6 max(1, s_1 + s_2 + s_3), so it stays finite; SB_TANGENT_SPD likewise. SB_TANGENT_QUASI does
 * not divide by it. */
SB_API int sb_material_tangent(const sb_material *material, const sb_mat3 *F, sb_quat *rotation, sb_tangent_kind kind,
                               sb_real A[81]);

/* ---- fibres ----
 * The fibres' share at F, ADDED to the output; the calls above are the matrix alone. direction: of the fibres at
 * rest, of any length but 0. All return 1, or 0 with the output untouched when F or the direction is not finite,
 * the direction is 0, the result overflows or a pointer is NULL. A material without fibres adds nothing. What is
 * passive of the tangent is positive semidefinite as it stands; contraction included, it is exact. */
SB_API int sb_fibre_energy(const sb_material *material, const sb_mat3 *F, sb_vec3 direction, sb_real *W);
SB_API int sb_fibre_stress(const sb_material *material, const sb_mat3 *F, sb_vec3 direction, sb_mat3 *P);
SB_API int sb_fibre_tangent(const sb_material *material, const sb_mat3 *F, sb_vec3 direction, sb_real A[81]);

/* ---- relaxation in time ---- */

/* g(t): the share of a relaxing stress that is left a time t [s] after a sudden strain; 1 for t <= 0. */
SB_API sb_real sb_material_relaxation(const sb_material *material, sb_real time);

/* Storage and loss modulus [Pa] of small shear that oscillates with omega [rad/s] >= 0:
 *     G' = mu (1 - sum g_i/(1 + x_i^2)),   G'' = mu sum g_i x_i/(1 + x_i^2),   x_i = omega tau_i;
 * mu and 0 without Prony terms, zeros for NULL. storage and loss may be NULL. Fit: sb_material_fit_moduli. */
SB_API void sb_material_shear_moduli(const sb_material *material, sb_real omega, sb_real *storage, sb_real *loss);

/* What a point of a material with Prony terms remembers. All zero: at rest for ever. Plain data. */
typedef struct sb_material_history {
    /* Instantaneous relaxing second Piola-Kirchhoff stress S0 at the last F [Pa], in the
     * order 00 11 22 01 12 02. */
    sb_real stress[6];
    sb_real memory[SB_MAX_PRONY_TERMS][6]; /* h_i [Pa], the same */
} sb_material_history;

/* Moves one point by dt [s] >= 0 (0: a jump; infinite: fully relaxed) to F and gives its stress there, fibres
 * included: the formula that bodies step by, to draw relaxation curves and to fit them. Exact where S0 changes
 * evenly within each step, of second order otherwise. fibre: direction of the fibres at rest, NULL for none.
 * *P [Pa]: first Piola-Kirchhoff stress. Returns 1, or 0 with history and P untouched when F is not admissible
 * (see above; also J = 0), dt is negative or NaN, Prony terms are out of number or on a model that is not
 * hyperelastic, or a pointer but fibre is NULL. */
SB_API int sb_material_history_stress(const sb_material *material, sb_material_history *history, const sb_mat3 *F,
                                      sb_real dt, const sb_vec3 *fibre, sb_mat3 *P);

/* Cauchy stress P F^T/J [Pa]: force per current area. Not finite when J = 0. */
SB_API sb_mat3 sb_cauchy_stress(sb_mat3 F, sb_mat3 P);
/* The same for a material's P; P itself for SB_LINEAR: small strain does not distinguish the stresses. */
SB_API sb_mat3 sb_material_cauchy_stress(const sb_material *material, sb_mat3 F, sb_mat3 P);
/* Von Mises equivalent sqrt(3/2 s:s) [Pa], s the deviator of a symmetric stress. */
SB_API sb_real sb_von_mises(sb_mat3 sigma);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Whether a material does anything along fibres. */
SB_INLINE int sbi_material_has_fibres(const sb_material *m) { return m->fibre_stiffness > 0 || m->fibre_tension > 0; }
/* Whether it is strained where the mesh is at rest. */
SB_INLINE int sbi_material_is_prestretched(const sb_material *m)
{
    return m->prestretch.m[0][0] != 0 || m->prestretch.m[0][1] != 0 || m->prestretch.m[0][2] != 0;
}
/* SB_ERROR_NOT_FINITE, or SB_ERROR_MATERIAL: its determinant is not above 0, or its model (unless any_model) takes
 * none. */
SBI_API sb_result sbi_material_check_prestretch(const sb_material *material, int any_model, sb_error *error);
/* The last of the models. */
enum { SBI_LAST_MODEL = SB_CUSTOM_LAW };
/* ==== internal: shares of a material =====================================================================
 * Every hyperelastic energy here is linear in its moduli (a law: in its scale), so that a share of a material is a
 * material. */

/* The share of a material that a B-bar element evaluates at each of its points, and the one at its mean point:
 * W = W_shear + W_volume, with mu (and fibres) in the first, lambda in the second; isochoric models: psi and U. */
typedef enum sbi_material_share { SBI_SHARE_WHOLE, SBI_SHARE_SHEAR, SBI_SHARE_VOLUME } sbi_material_share;
SBI_API sb_material sbi_material_share_of(const sb_material *material, sbi_material_share share);

/* The material with all of its moduli times a factor > 0: Poisson's ratio and exponents stay. */
SBI_API sb_material sbi_material_scaled(const sb_material *material, sb_real factor);

/* What Prony terms relax: everything in proportion to the shear modulus at a constant bulk modulus (isochoric
 * models: psi), fibres included. Only its stress means anything: its lambda is -2 mu/3. */
SBI_API sb_material sbi_material_relaxing(const sb_material *material);
/* The material with its relaxing share times a: bulk modulus as before. */
SBI_API sb_material sbi_material_relaxed(const sb_material *material, sb_real a);
/* a(dt) = g_inf + sum g_i gamma_i, gamma_i = (1 - exp(-x_i))/x_i, x_i = dt/tau_i: the share of a new stress that is
 * left at the end of the step of dt (s) in which it comes about evenly. 1 for dt = 0, g_inf for dt infinite. */
SBI_API sb_real sbi_prony_factor(const sb_material *material, sb_real dt);
/* gamma_i, and exp(-x_i) in *decay. */
SBI_API sb_real sbi_prony_term(const sb_material *material, int term, sb_real dt, sb_real *decay);

/* One point's memory h[prony_count][6] of its relaxing second Piola-Kirchhoff stress S0 (Pa, order 00 11 22 01 12 02)
 * over a step of dt, exact when S0 changes evenly in it: with gamma_i and x_i from above
 *     advance:   h_i <- exp(-x_i) h_i + g_i gamma_i (s0_new - s0_old)
 *     prestress: H = sum_i (exp(-x_i) h_i - g_i gamma_i s0_old), before advance,
 * so that S = S_volume + a(dt) S0_new + H at the end of the step, and S = S_volume + g_inf S0_new + sum h_i after
 * advance. A point at rest has h = 0, S0 = 0. (Thesis 3, 4.90; Simo and Hughes 1998, ch. 10.) */
SBI_API void sbi_prony_advance(const sb_material *material, sb_real dt, const sb_real s0_old[6],
                               const sb_real s0_new[6], sb_real (*h)[6]);
SBI_API void sbi_prony_prestress(const sb_material *material, sb_real dt, const sb_real s0_old[6],
                                 const sb_real (*h)[6], sb_real H[6]);
/* S0 at F of the share that sbi_material_relaxing gives, fibres (unit direction; NULL: none) included; 0 with s0
 * untouched when F is not admissible, or J = 0. */
SBI_API int sbi_prony_instant(const sb_material *relaxing, const sb_mat3 *F, const sb_vec3 *fibre, sb_real s0[6]);
#endif

#endif /* SB_MATERIAL_H */
