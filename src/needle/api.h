/* api: version and linkage of needle.h. Results, errors, allocator, vectors and the scalar type are softbody.h's. */
#ifndef NDL_API_H
#define NDL_API_H

#include "../softbody/base/core.h"
#include "../softbody/base/dense.h"
#include "names.h"

#define NDL_VERSION_MAJOR 0
#define NDL_VERSION_MINOR 5
#define NDL_VERSION_PATCH 0
#define NDL_VERSION_STRING "0.5.0"

#if NDL_VERSION_MAJOR != SB_VERSION_MAJOR || NDL_VERSION_MINOR != SB_VERSION_MINOR ||                                  \
    NDL_VERSION_PATCH != SB_VERSION_PATCH
#error "needle.h and softbody.h are of different versions: take both from one release"
#endif
#if defined(SB_NO_GEOMETRY)
#error "needle.h needs the surfaces of softbody.h: leave SB_NO_GEOMETRY undefined"
#endif
#if defined(NDL_IMPLEMENTATION) && !defined(SB_IMPLEMENTATION)
#error "needle.h: define NDL_IMPLEMENTATION in the file that defines SB_IMPLEMENTATION"
#endif

/* NDL_API: what stands before each public function: static under SB_STATIC or NDL_STATIC; exported or imported under
 * SB_SHARED, as NDL_IMPLEMENTATION says; your own where you define it, or SB_API, before including. NDLI_API: internal
 * functions; static in the shipped header, extern when the rooms are compiled apart. */
#if defined(NDL_API)
/* the caller's */
#elif defined(SB_STATIC) || defined(NDL_STATIC)
#define NDL_API static SBI_UNUSED
#elif defined(SBI_API_IS_GIVEN)
#define NDL_API SB_API
#elif defined(SB_SHARED) && defined(NDL_IMPLEMENTATION)
#define NDL_API SBI_EXPORT
#elif defined(SB_SHARED)
#define NDL_API SBI_IMPORT
#else
#define NDL_API SBI_EXTERN
#endif
#undef NDL_STATIC /* a state of the coupling has this name */
#if defined(SB_SPLIT_BUILD)
#define NDLI_API extern
#else
#define NDLI_API static SBI_UNUSED
#endif

#endif /* NDL_API_H */
