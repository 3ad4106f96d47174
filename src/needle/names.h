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
