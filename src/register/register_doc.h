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
