/* contact_law: pressure and friction at one sample, and their stiffness. Internal, pure functions.
 *
 *     p = max(0, l - k g)                                       n out of the tool, g the gap (m, negative: overlap)
 *     tau = P t' - kt s,  t = tau if |tau| <= B, else B tau/|tau|
 *     K = k n n^T + kt (I - n n^T)                              sticks
 *     K = k n n^T + kt B/|tau| (I - n n^T - d d^T), d = tau/|tau|     slips
 *
 * l, t' are remembered pressure and traction of the step before, P turns the latter into the tangent plane, s is the
 * slip, B = mu p the bound of friction of the last renewal. Without the curvature of the tool and dB/dp, K is symmetric
 * and positive semidefinite.
 * Source: Wriggers, Computational Contact Mechanics, ch. 5 and 6. */
#ifndef SB_CONTACT_LAW_H
#define SB_CONTACT_LAW_H

#include "../base/dense.h"

/* Tangential over normal stiffness while it sticks. */
#define SBI_CONTACT_TANGENTIAL ((sb_real)0.5)

typedef enum sbi_contact_state { SBI_CONTACT_OFF = 0, SBI_CONTACT_STICKS = 1, SBI_CONTACT_SLIPS = 2 } sbi_contact_state;

typedef struct sbi_contact_answer {
    sbi_contact_state state;
    sb_real pressure;        /* Pa */
    sb_vec3 traction;        /* Pa, tangential, on the body */
    sb_vec3 direction;       /* d of a sample that slips, or 0 */
    sb_real normal, tangent; /* Pa/m: K = normal n n^T + tangent (I - n n^T - d d^T) */
} sbi_contact_answer;

/* v without its part along the unit vector n. */
SB_INLINE sb_vec3 sbi_contact_tangential(sb_vec3 v, sb_vec3 n) { return sb_v3_madd(v, -sb_v3_dot(v, n), n); }

/* v turned into the plane across n: its projection with the length of v. */
SB_INLINE sb_vec3 sbi_contact_carry(sb_vec3 v, sb_vec3 n)
{
    sb_vec3 flat = sbi_contact_tangential(v, n);
    sb_real length = sb_v3_norm(v), now = sb_v3_norm(flat);
    return now > 0 ? sb_v3_scale(length / now, flat) : sb_v3(0, 0, 0);
}

/* memory: l (Pa); remembered: t' (Pa); slip: any part along n is left out; bound: B (Pa), of a tool without friction 0.
 */
SB_INLINE sbi_contact_answer sbi_contact_law(sb_real k, sb_real gap, sb_real memory, sb_vec3 n, sb_vec3 slip,
                                             sb_vec3 remembered, sb_real bound)
{
    sbi_contact_answer a;
    sb_real kt = SBI_CONTACT_TANGENTIAL * k, size;
    sb_vec3 tau;
    a.state = SBI_CONTACT_OFF;
    a.pressure = memory - k * gap;
    a.traction = a.direction = sb_v3(0, 0, 0);
    a.normal = a.tangent = 0;
    if (!(a.pressure > 0)) {
        a.pressure = 0; /* friction of a bound that is still to be renewed stays: forces do not jump on a line */
    } else {
        a.state = SBI_CONTACT_SLIPS;
        a.normal = k;
    }
    if (!(bound > 0))
        return a;
    tau = sb_v3_madd(sbi_contact_carry(remembered, n), -kt, sbi_contact_tangential(slip, n));
    size = sb_v3_norm(tau);
    if (size <= bound) {
        a.state = SBI_CONTACT_STICKS;
        a.traction = tau;
        a.tangent = kt;
        return a;
    }
    a.direction = sb_v3_scale(1 / size, tau);
    a.traction = sb_v3_scale(bound, a.direction);
    a.tangent = kt * bound / size;
    return a;
}

/* factor times K, row-major. */
SB_INLINE void sbi_contact_stiffness(const sbi_contact_answer *a, sb_vec3 n, sb_real factor, sb_real out[9])
{
    sb_real normal = factor * (a->normal - a->tangent), tangent = factor * a->tangent;
    const sb_real u[3] = {n.x, n.y, n.z}, d[3] = {a->direction.x, a->direction.y, a->direction.z};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = normal * u[i] * u[j] + (i == j ? tangent : 0) - tangent * d[i] * d[j];
}

#endif /* SB_CONTACT_LAW_H */
