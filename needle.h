/* needle.h 0.2.0: flexible needles in soft tissue
 * MIT or public domain, as you like; the texts are at the end of this file.
 * Generated from src/needle/: edit there, then run `make headers`. */
#include "softbody.h"

/* ==== src/needle/needle_doc.h ==== */
/*
 * needle.h - flexible needles in soft tissue, in one header on top of softbody.h.
 *
 * HOW TO INCLUDE
 *
 * In one C or C++ file, which is the one that holds softbody.h's implementation:
 *
 *     #define SB_IMPLEMENTATION
 *     #define NDL_IMPLEMENTATION
 *     #include "needle.h"
 *
 * and in all others only the last line; it includes softbody.h. Both headers come from one release and lie in one
 * folder. Link with -lm, optimise (-O2 or -O3).
 *
 * OPTIONS are softbody.h's. SB_REAL: exported names of a float build end in _f32. SB_STATIC makes this header static,
 * too; NDL_STATIC makes only this one so.
 *
 * A FIRST PROGRAM
 *
 *     ```c
 *     #define SB_IMPLEMENTATION
 *     #define NDL_IMPLEMENTATION
 *     #include "needle.h"
 *     #include <stdio.h>
 *
 *     int main(void)
 *     {
 *         printf("needle.h %s\n", NDL_VERSION_STRING);
 *         return 0;
 *     }
 *     ```
 *
 * LICENCE
 *
 * MIT or public domain, as you like; the texts are at the end of this file.
 */

/* ==== src/needle/../softbody/begin.h ==== */
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

#ifndef NEEDLE_H
#define NEEDLE_H

/* ==== src/needle/names.h ==== */
/* names: the exported names of a float build end in _f32, so that a float caller and a double object do
 * not link. Written by src/amalgamate.c from the declarations: do not edit. */
#ifndef NDLI_NAMES_H
#define NDLI_NAMES_H

#if defined(SB_REAL)
#define NDLI_NAMES_PASTE_(a, b) a##b
#define NDLI_NAMES_PASTE(a, b) NDLI_NAMES_PASTE_(a, b)
#define NDLI_NAMES_OF_double 0
#define NDLI_NAMES_OF_float 1
#if NDLI_NAMES_PASTE(NDLI_NAMES_OF_, SB_REAL)
#endif
#endif

#endif /* NDLI_NAMES_H */

/* ==== src/needle/api.h ==== */
/* api: version and linkage of needle.h. Results, errors, allocator, vectors and the scalar type are softbody.h's. */
#ifndef NDL_API_H
#define NDL_API_H


#define NDL_VERSION_MAJOR 0
#define NDL_VERSION_MINOR 2
#define NDL_VERSION_PATCH 0
#define NDL_VERSION_STRING "0.2.0"

#if NDL_VERSION_MAJOR != SB_VERSION_MAJOR || NDL_VERSION_MINOR != SB_VERSION_MINOR || \
    NDL_VERSION_PATCH != SB_VERSION_PATCH
#error "needle.h and softbody.h are of different versions: take both from one release"
#endif
#if defined(NDL_IMPLEMENTATION) && !defined(SB_IMPLEMENTATION)
#error "needle.h: define NDL_IMPLEMENTATION in the file that defines SB_IMPLEMENTATION"
#endif

/* NDL_API: public functions; static under SB_STATIC or NDL_STATIC. NDLI_API: internal functions; static in the shipped
 * header, extern when the rooms are compiled apart. */
#if defined(SB_STATIC) || defined(NDL_STATIC)
#define NDL_API static SBI_UNUSED
#elif defined(__cplusplus)
#define NDL_API extern "C"
#else
#define NDL_API extern
#endif
#if defined(SB_SPLIT_BUILD)
#define NDLI_API extern
#else
#define NDLI_API static SBI_UNUSED
#endif

#endif /* NDL_API_H */

#endif /* NEEDLE_H */

#if defined(NDL_IMPLEMENTATION) && !defined(NDL_IMPLEMENTATION_DONE)
#define NDL_IMPLEMENTATION_DONE

#endif /* NDL_IMPLEMENTATION */

/* ==== src/needle/../softbody/end.h ==== */
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
