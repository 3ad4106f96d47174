/* crossing: integers of places, signs of determinants, and blades that reach far beyond the tissue. */
#include "crossing.h"

#include <math.h>
#include <string.h>

/* ---- places ---- */

SBI_API void sbi_crossing_frame_make(sb_vec3 low, sb_vec3 high, sbi_crossing_frame *frame)
{
    double sides[3], half = 0;
    int exponent;
    sides[0] = (double)high.x / 2 - (double)low.x / 2;
    sides[1] = (double)high.y / 2 - (double)low.y / 2;
    sides[2] = (double)high.z / 2 - (double)low.z / 2;
    frame->centre[0] = (double)low.x / 2 + (double)high.x / 2;
    frame->centre[1] = (double)low.y / 2 + (double)high.y / 2;
    frame->centre[2] = (double)low.z / 2 + (double)high.z / 2;
    for (int i = 0; i < 3; i++)
        half = sides[i] > half ? sides[i] : half;
    exponent = half > 0 ? 25 - sbi_dense_exponent(half) : 0; /* half the box becomes 2^25 to 2^26 */
    frame->scale = sbi_dense_pow2(sbi_min_int(exponent, 1000));
}

/* Coordinates in the frame, not rounded, and finite however far x is. */
static void sbi_crossing_scale(const sbi_crossing_frame *frame, sb_vec3 x, double y[3])
{
    const double far = 1e290; /* differences and products with what is at most 1 stay finite */
    y[0] = frame->scale * ((double)x.x - frame->centre[0]);
    y[1] = frame->scale * ((double)x.y - frame->centre[1]);
    y[2] = frame->scale * ((double)x.z - frame->centre[2]);
    for (int i = 0; i < 3; i++)
        y[i] = y[i] > far ? far : y[i] < -far ? -far : y[i];
}

static int sbi_crossing_round_one(double y, int limit)
{
    int whole = (int)floor((y > limit ? limit : y < -limit ? -limit : y) + 0.5);
    return whole;
}

static sbi_int3 sbi_crossing_round_all(const double y[3], int limit)
{
    sbi_int3 p;
    p.x = sbi_crossing_round_one(y[0], limit);
    p.y = sbi_crossing_round_one(y[1], limit);
    p.z = sbi_crossing_round_one(y[2], limit);
    return p;
}

SBI_API sbi_int3 sbi_crossing_round(const sbi_crossing_frame *frame, sb_vec3 x)
{
    double y[3];
    sbi_crossing_scale(frame, x, y);
    return sbi_crossing_round_all(y, SBI_CROSSING_TISSUE);
}

/* ---- signs ---- */

static int sbi_crossing_lex(const int64_t v[3])
{
    for (int i = 0; i < 3; i++)
        if (v[i] != 0)
            return v[i] > 0 ? 1 : -1;
    return 0;
}

static void sbi_crossing_difference(sbi_int3 a, sbi_int3 b, int64_t v[3])
{
    v[0] = (int64_t)a.x - b.x;
    v[1] = (int64_t)a.y - b.y;
    v[2] = (int64_t)a.z - b.z;
}

static void sbi_crossing_cross(const int64_t a[3], const int64_t b[3], int64_t v[3])
{
    v[0] = a[1] * b[2] - a[2] * b[1];
    v[1] = a[2] * b[0] - a[0] * b[2];
    v[2] = a[0] * b[1] - a[1] * b[0];
}

/* A sum of 128 bits: high 2^64 + low. */
typedef struct sbi_crossing_sum {
    int64_t high;
    uint64_t low;
} sbi_crossing_sum;

/* Adds a b, |a| and |b| < 2^62. */
static void sbi_crossing_add(sbi_crossing_sum *sum, int64_t a, int64_t b)
{
    const uint64_t half = 0xFFFFFFFFu;
    uint64_t p = (uint64_t)(a < 0 ? -a : a), q = (uint64_t)(b < 0 ? -b : b);
    uint64_t low = (p & half) * (q & half), middle = (p >> 32) * (q & half) + (low >> 32);
    uint64_t other = (p & half) * (q >> 32) + (middle & half), high;
    high = (p >> 32) * (q >> 32) + (middle >> 32) + (other >> 32);
    low = (low & half) | other << 32;
    if ((a < 0) != (b < 0) && (high || low)) {
        high = ~high + (low == 0);
        low = ~low + 1;
    }
    sum->low += low;
    sum->high += (int64_t)high + (sum->low < low);
}

static double sbi_crossing_real(sbi_crossing_sum sum)
{
    const double step = 18446744073709551616.0; /* 2^64 */
    if (sum.high >= 0)
        return (double)sum.high * step + (double)sum.low;
    sum.high = -(sum.high + 1) + (sum.low == 0); /* of the opposite, whose sign no rounding takes */
    sum.low = ~sum.low + 1;
    return -((double)sum.high * step + (double)sum.low);
}

/* a.b, rounded, with its sign exact; a of less than 62 bits, b of less than 31. */
static double sbi_crossing_product(const int64_t a[3], const int64_t b[3])
{
    const double rounding = 1e-15; /* of the terms: eight roundings */
    double sum = 0, size = 0;
    sbi_crossing_sum exact = {0, 0};
    for (int i = 0; i < 3; i++) {
        double term = (double)a[i] * (double)b[i];
        sum += term;
        size += term < 0 ? -term : term;
    }
    if (sum > rounding * size || sum < -rounding * size)
        return sum;
    for (int i = 0; i < 3; i++)
        sbi_crossing_add(&exact, a[i], b[i]);
    return sbi_crossing_real(exact);
}

SBI_API int sbi_blade_make(const sbi_int3 corners[3], sbi_blade *blade)
{
    int64_t e[3], f[3];
    memcpy(blade->corners, corners, sizeof blade->corners);
    blade->low = blade->high = corners[0];
    for (int a = 1; a < 3; a++) {
        blade->low.x = sbi_min_int(blade->low.x, corners[a].x);
        blade->low.y = sbi_min_int(blade->low.y, corners[a].y);
        blade->low.z = sbi_min_int(blade->low.z, corners[a].z);
        blade->high.x = sbi_max_int(blade->high.x, corners[a].x);
        blade->high.y = sbi_max_int(blade->high.y, corners[a].y);
        blade->high.z = sbi_max_int(blade->high.z, corners[a].z);
    }
    sbi_crossing_difference(corners[1], corners[0], e);
    sbi_crossing_difference(corners[2], corners[0], f);
    sbi_crossing_cross(e, f, blade->normal);
    blade->tie = -sbi_crossing_lex(blade->normal);
    return blade->tie != 0;
}

SBI_API double sbi_blade_height(const sbi_blade *blade, sbi_int3 p)
{
    int64_t v[3];
    sbi_crossing_difference(p, blade->corners[0], v);
    return sbi_crossing_product(blade->normal, v);
}

/* On which side the line through p along e passes the edge from a to b; 0: e is parallel to it. */
static int sbi_crossing_edge(sbi_int3 a, sbi_int3 b, sbi_int3 p, const int64_t e[3])
{
    int64_t from[3], to[3], v[3];
    double passing;
    sbi_crossing_difference(a, p, from);
    sbi_crossing_difference(b, p, to);
    sbi_crossing_cross(from, to, v);
    passing = sbi_crossing_product(e, v);
    if (passing != 0)
        return passing > 0 ? 1 : -1;
    sbi_crossing_difference(b, a, from);
    sbi_crossing_cross(from, e, v);
    return sbi_crossing_lex(v);
}

SBI_API int sbi_blade_is_passed(const sbi_blade *blade, sbi_int3 p, sbi_int3 r)
{
    const sbi_int3 *at = blade->corners;
    int64_t e[3];
    int side;
    sbi_crossing_difference(r, p, e);
    side = sbi_crossing_edge(at[0], at[1], p, e);
    return side != 0 && sbi_crossing_edge(at[1], at[2], p, e) == side && sbi_crossing_edge(at[2], at[0], p, e) == side;
}

/* 0: a link lies beside the blade's box on an axis, where no tie is broken either: it does not cross. */
static int sbi_blade_is_near(const sbi_blade *blade, sbi_int3 p, sbi_int3 r)
{
    return (p.x <= blade->high.x || r.x <= blade->high.x) && (p.x >= blade->low.x || r.x >= blade->low.x) &&
           (p.y <= blade->high.y || r.y <= blade->high.y) && (p.y >= blade->low.y || r.y >= blade->low.y) &&
           (p.z <= blade->high.z || r.z <= blade->high.z) && (p.z >= blade->low.z || r.z >= blade->low.z);
}

SBI_API int sbi_blade_crosses(const sbi_blade *blade, sbi_int3 p, sbi_int3 r, sb_real *t)
{
    double from, to;
    if (!sbi_blade_is_near(blade, p, r))
        return 0;
    from = sbi_blade_height(blade, p);
    to = sbi_blade_height(blade, r);
    if (sbi_blade_side(blade, from) == sbi_blade_side(blade, to) || !sbi_blade_is_passed(blade, p, r))
        return 0;
    *t = (sb_real)(from / (from - to)); /* one of them is not 0, and they have other signs */
    return 1;
}

/* ---- blades that reach far ---- */

enum { SBI_CROSSING_CORNERS = 9 }; /* of a triangle cut off by six planes */

static int sbi_crossing_is_before(const double a[3], const double b[3])
{
    for (int i = 0; i < 3; i++)
        if (a[i] != b[i])
            return a[i] < b[i];
    return 0;
}

/* Where the edge between two corners meets coordinate `axis` = limit: the same bits from either end. */
static void sbi_crossing_meet(const double *a, const double *b, int axis, double limit, double at[3])
{
    const double *first = sbi_crossing_is_before(a, b) ? a : b, *last = first == a ? b : a;
    double s = (limit - first[axis]) / (last[axis] - first[axis]);
    for (int i = 0; i < 3; i++)
        at[i] = first[i] + s * (last[i] - first[i]);
    at[axis] = limit;
}

/* Keeps of a polygon what lies at sign * coordinate <= limit; returns how many corners that has (Sutherland and Hodgman
 * 1974). */
static int sbi_crossing_clip(double (*corners)[3], int count, int axis, int sign)
{
    const double limit = (double)SBI_CROSSING_BLADE;
    double kept[SBI_CROSSING_CORNERS][3];
    int kept_count = 0;
    for (int k = 0; k < count; k++) {
        const double *a = corners[k], *b = corners[k + 1 < count ? k + 1 : 0];
        int a_in = sign * a[axis] <= limit, b_in = sign * b[axis] <= limit;
        SB_ASSERT(kept_count + a_in + (a_in != b_in) <=
                  SBI_CROSSING_CORNERS); /* a plane adds one to a convex polygon */
        if (a_in)
            memcpy(kept[kept_count++], a, sizeof *kept);
        if (a_in != b_in)
            sbi_crossing_meet(a, b, axis, sign * limit, kept[kept_count++]);
    }
    memcpy(corners, kept, (size_t)kept_count * sizeof *kept);
    return kept_count;
}

SBI_API int sbi_crossing_blades(const sbi_crossing_frame *frame, const sb_vec3 triangle[3],
                                sbi_blade blades[SBI_CROSSING_PARTS])
{
    double corners[SBI_CROSSING_CORNERS][3];
    int count = 3, made = 0;
    for (int a = 0; a < 3; a++)
        sbi_crossing_scale(frame, triangle[a], corners[a]);
    for (int axis = 0; axis < 3; axis++)
        for (int sign = -1; sign <= 1; sign += 2)
            count = sbi_crossing_clip(corners, count, axis, sign);
    for (int k = 2; k < count; k++) {
        sbi_int3 parts[3];
        parts[0] = sbi_crossing_round_all(corners[0], SBI_CROSSING_BLADE);
        parts[1] = sbi_crossing_round_all(corners[k - 1], SBI_CROSSING_BLADE);
        parts[2] = sbi_crossing_round_all(corners[k], SBI_CROSSING_BLADE);
        made += sbi_blade_make(parts, blades + made);
    }
    return made;
}
