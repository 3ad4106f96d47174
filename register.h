/* register.h 0.3.0: matching an organ model to what the surgeon sees
 * MIT or public domain, as you like; the texts are at the end of this file.
 * Generated from src/register/: edit there, then run `make headers`. */
#include "softbody.h"

/* ==== src/register/register_doc.h ==== */
/*
 * register.h - matching an organ model to what the surgeon sees, in one header on top of softbody.h.
 *
 * HOW TO INCLUDE
 *
 * In one C or C++ file, which is the one that holds softbody.h's implementation:
 *
 *     #define SB_IMPLEMENTATION
 *     #define REG_IMPLEMENTATION
 *     #include "register.h"
 *
 * and in all others only the last line; it includes softbody.h. Both headers come from one release and lie in one
 * folder. Link with -lm, optimise (-O2 or -O3).
 *
 * OPTIONS are softbody.h's. SB_REAL: exported names of a float build end in _f32. SB_STATIC makes this header static,
 * too; REG_STATIC makes only this one so.
 *
 * LICENCE
 *
 * MIT or public domain, as you like; the texts are at the end of this file.
 */

/* ==== src/register/../softbody/begin.h ==== */
/* begin: compiler settings for the library's own code; end.h gives the caller's back.
 *
 * A product and a sum may not be contracted into one rounding (fused multiply-add), or results would depend on the
 * compiler and the processor. Compilers differ in how a header can say so:
 * - clang: by the standard pragma; -ffp-contract=fast overrules it.
 * - gcc knows the standard pragma in no release yet, and contracts unless told -std=c99 or -ffp-contract=off. Its
 *   own pragma stops that, but code under it is not inlined into code outside, so it stands only where the target
 *   has fused instructions and the language mode lets gcc use them. The system headers come first: their inline
 *   functions are the caller's business.
 * - MSVC: by its own pragma, in the file that holds the implementation. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#if !defined(__STRICT_ANSI__) && (defined(__FP_FAST_FMA) || defined(__FP_FAST_FMAF))
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#if defined(SB_IMPLEMENTATION)
#include <errno.h>
#include <float.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#endif
#pragma GCC push_options
#pragma GCC optimize("fp-contract=off")
#endif
#elif defined(_MSC_VER) && defined(SB_IMPLEMENTATION)
#pragma fp_contract(off)
#endif

#ifndef REGISTER_H
#define REGISTER_H

/* ==== src/register/names.h ==== */
/* names: the exported names of a float build end in _f32, so that a float caller and a double object do
 * not link. Written by src/amalgamate.c from the declarations: do not edit. */
#ifndef REGI_NAMES_H
#define REGI_NAMES_H

#if defined(SB_REAL)
#define REGI_NAMES_PASTE_(a, b) a##b
#define REGI_NAMES_PASTE(a, b) REGI_NAMES_PASTE_(a, b)
#define REGI_NAMES_OF_double 0
#define REGI_NAMES_OF_float 1
#if REGI_NAMES_PASTE(REGI_NAMES_OF_, SB_REAL)
#define reg_rigid_identity reg_rigid_identity_f32
#define reg_rigid_apply reg_rigid_apply_f32
#define reg_rigid_compose reg_rigid_compose_f32
#define reg_rigid_inverse reg_rigid_inverse_f32
#define reg_rigid_angle reg_rigid_angle_f32
#define reg_rigid_fit reg_rigid_fit_f32
#endif
#endif

#endif /* REGI_NAMES_H */

/* ==== src/register/api.h ==== */
/* api: version and linkage of register.h. Results, errors, allocator, vectors and the scalar type are softbody.h's. */
#ifndef REG_API_H
#define REG_API_H


#define REG_VERSION_MAJOR 0
#define REG_VERSION_MINOR 3
#define REG_VERSION_PATCH 0
#define REG_VERSION_STRING "0.3.0"

#if REG_VERSION_MAJOR != SB_VERSION_MAJOR || REG_VERSION_MINOR != SB_VERSION_MINOR || \
    REG_VERSION_PATCH != SB_VERSION_PATCH
#error "register.h and softbody.h are of different versions: take both from one release"
#endif
#if defined(REG_IMPLEMENTATION) && !defined(SB_IMPLEMENTATION)
#error "register.h: define REG_IMPLEMENTATION in the file that defines SB_IMPLEMENTATION"
#endif

/* REG_API: public functions; static under SB_STATIC or REG_STATIC. REGI_API: internal functions; static in the shipped
 * header, extern when the rooms are compiled apart. */
#if defined(SB_STATIC) || defined(REG_STATIC)
#define REG_API static SBI_UNUSED
#elif defined(__cplusplus)
#define REG_API extern "C"
#else
#define REG_API extern
#endif
#if defined(SB_SPLIT_BUILD)
#define REGI_API extern
#else
#define REGI_API static SBI_UNUSED
#endif

#endif /* REG_API_H */

/* ==== src/register/rigid.h ==== */
/* rigid: rigid motions, and the one that brings points nearest to their partners. Floor 1. */
#ifndef REG_RIGID_H
#define REG_RIGID_H


/* x -> rotation x + translation. */
typedef struct reg_rigid {
    sb_mat3 rotation;    /* orthonormal, determinant 1 */
    sb_vec3 translation; /* m */
} reg_rigid;

REG_API reg_rigid reg_rigid_identity(void);
REG_API sb_vec3 reg_rigid_apply(const reg_rigid *motion, sb_vec3 point);
/* First `first`, then `then`. */
REG_API reg_rigid reg_rigid_compose(const reg_rigid *then, const reg_rigid *first);
REG_API reg_rigid reg_rigid_inverse(const reg_rigid *motion);
/* Angle (rad, in [0, pi]) of the rotation. */
REG_API sb_real reg_rigid_angle(const reg_rigid *motion);

/* The motion that minimises sum w |motion(from) - to|^2 (Kabsch 1976, never a reflection).
 * from, to: [count] partners (m); weights: [count] >= 0, not all 0, or NULL: all 1; count >= 1. Where the points leave
 * the rotation open (all in one line or one point) it is one of the best. SB_ERROR_ARGUMENT, _NOT_FINITE (index named)
 * leave *motion untouched. No allocation. */
REG_API sb_result reg_rigid_fit(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                reg_rigid *motion, sb_error *error);

#endif /* REG_RIGID_H */

#endif /* REGISTER_H */

#if defined(REG_IMPLEMENTATION) && !defined(REG_IMPLEMENTATION_DONE)
#define REG_IMPLEMENTATION_DONE

/* ==== src/register/rigid.c ==== */
/* rigid: motions and Kabsch's fit. */

REG_API reg_rigid reg_rigid_identity(void)
{
    reg_rigid motion;
    motion.rotation = sb_m3_identity();
    motion.translation = sb_v3(0, 0, 0);
    return motion;
}

REG_API sb_vec3 reg_rigid_apply(const reg_rigid *motion, sb_vec3 point)
{
    return sb_v3_add(sb_m3_apply(motion->rotation, point), motion->translation);
}

REG_API reg_rigid reg_rigid_compose(const reg_rigid *then, const reg_rigid *first)
{
    reg_rigid motion;
    motion.rotation = sb_m3_mul(then->rotation, first->rotation);
    motion.translation = reg_rigid_apply(then, first->translation);
    return motion;
}

REG_API reg_rigid reg_rigid_inverse(const reg_rigid *motion)
{
    reg_rigid inverse;
    inverse.rotation = sb_m3_transpose(motion->rotation);
    inverse.translation = sb_v3_scale(-1, sb_m3_apply(inverse.rotation, motion->translation));
    return inverse;
}

/* The axis times 2 sin, and 1 + 2 cos: together they tell small angles and such near pi alike. */
REG_API sb_real reg_rigid_angle(const reg_rigid *motion)
{
    const sb_mat3 *r = &motion->rotation;
    sb_vec3 axis = sb_v3(r->m[2][1] - r->m[1][2], r->m[0][2] - r->m[2][0], r->m[1][0] - r->m[0][1]);
    return (sb_real)atan2((double)sb_v3_norm(axis), (double)(r->m[0][0] + r->m[1][1] + r->m[2][2] - 1));
}

static sb_result regi_rigid_check(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                  sb_error *error)
{
    sb_real largest = 0;
    if (!from || !to || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a fit needs at least one pair of points, not %d", count);
    for (int i = 0; i < count; i++) {
        sb_real w = weights ? weights[i] : 1;
        if (!sb_v3_is_finite(from[i]) || !sb_v3_is_finite(to[i]) || !sb_is_finite(w))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "pair %d is not finite", i);
        if (w < 0)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the weight of pair %d is %g, not 0 or more", i, (double)w);
        largest = w > largest ? w : largest;
    }
    if (!(largest > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "all weights are 0");
    return SB_OK;
}

REG_API sb_result reg_rigid_fit(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                reg_rigid *motion, sb_error *error)
{
    sb_result result = regi_rigid_check(from, to, weights, count, error);
    sb_vec3 mean_from = sb_v3(0, 0, 0), mean_to = mean_from, stretches;
    sb_mat3 spread = sb_m3_zero(), u, v;
    sb_real total = 0;
    if (result != SB_OK)
        return result;
    for (int i = 0; i < count; i++) {
        sb_real w = weights ? weights[i] : 1;
        if (!(w > 0))
            continue;
        total += w;
        mean_from = sb_v3_madd(mean_from, w / total, sb_v3_sub(from[i], mean_from));
        mean_to = sb_v3_madd(mean_to, w / total, sb_v3_sub(to[i], mean_to));
    }
    for (int i = 0; i < count; i++) {
        sb_vec3 a = sb_v3_scale((weights ? weights[i] : 1) / total, sb_v3_sub(to[i], mean_to));
        spread = sb_m3_add(spread, sb_m3_outer(a, sb_v3_sub(from[i], mean_from)));
    }
    /* u and v of this factorisation are rotations, the sign of the determinant is in the last stretch: u v^T is the
     * nearest rotation. */
    sb_m3_svd(spread, &u, &stretches, &v);
    motion->rotation = sb_m3_mul(u, sb_m3_transpose(v));
    motion->translation = sb_v3_sub(mean_to, sb_m3_apply(motion->rotation, mean_from));
    return SB_OK;
}

#endif /* REG_IMPLEMENTATION */

/* ==== src/register/../softbody/end.h ==== */
/* end: gives back the settings that begin.h changed. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT DEFAULT
#elif defined(__GNUC__)
#if !defined(__STRICT_ANSI__) && (defined(__FP_FAST_FMA) || defined(__FP_FAST_FMAF))
#pragma GCC pop_options
#endif
#endif

/*
softbody is available under two licences; choose the one you like.

------------------------------------------------------------------------------
ALTERNATIVE A - MIT License

Copyright (c) 2025 the softbody authors

Permission is hereby granted, free of charge, to any person obtaining a copy of
this software and associated documentation files (the "Software"), to deal in
the Software without restriction, including without limitation the rights to
use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies
of the Software, and to permit persons to whom the Software is furnished to do
so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all
copies or substantial portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER
LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM,
OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
SOFTWARE.

------------------------------------------------------------------------------
ALTERNATIVE B - Public Domain (www.unlicense.org)

This is free and unencumbered software released into the public domain.

Anyone is free to copy, modify, publish, use, compile, sell, or distribute this
software, either in source code form or as a compiled binary, for any purpose,
commercial or non-commercial, and by any means.

In jurisdictions that recognize copyright laws, the author or authors of this
software dedicate any and all copyright interest in the software to the public
domain. We make this dedication for the benefit of the public at large and to
the detriment of our heirs and successors. We intend this dedication to be an
overt act of relinquishment in perpetuity of all present and future rights to
this software under copyright law.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN
ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION
WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
*/
