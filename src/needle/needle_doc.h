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
