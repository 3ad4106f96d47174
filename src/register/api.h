/* api: version and linkage of register.h. Results, errors, allocator, vectors and the scalar type are softbody.h's. */
#ifndef REG_API_H
#define REG_API_H

#include "../softbody/base/core.h"
#include "../softbody/base/dense.h"
#include "names.h"

#define REG_VERSION_MAJOR 0
#define REG_VERSION_MINOR 5
#define REG_VERSION_PATCH 0
#define REG_VERSION_STRING "0.5.0"

#if REG_VERSION_MAJOR != SB_VERSION_MAJOR || REG_VERSION_MINOR != SB_VERSION_MINOR ||                                  \
    REG_VERSION_PATCH != SB_VERSION_PATCH
#error "register.h and softbody.h are of different versions: take both from one release"
#endif
#if defined(SB_NO_GEOMETRY) || defined(SB_NO_FILES)
#error "register.h needs the surfaces and file readers of softbody.h: leave SB_NO_GEOMETRY and SB_NO_FILES undefined"
#endif
#if defined(REG_IMPLEMENTATION) && !defined(SB_IMPLEMENTATION)
#error "register.h: define REG_IMPLEMENTATION in the file that defines SB_IMPLEMENTATION"
#endif

/* REG_API: what stands before each public function: static under SB_STATIC or REG_STATIC; exported or imported under
 * SB_SHARED, as REG_IMPLEMENTATION says; your own where you define it, or SB_API, before including. REGI_API: internal
 * functions; static in the shipped header, extern when the rooms are compiled apart. */
#if defined(REG_API)
/* the caller's */
#elif defined(SB_STATIC) || defined(REG_STATIC)
#define REG_API static SBI_UNUSED
#elif defined(SBI_API_IS_GIVEN)
#define REG_API SB_API
#elif defined(SB_SHARED) && defined(REG_IMPLEMENTATION)
#define REG_API SBI_EXPORT
#elif defined(SB_SHARED)
#define REG_API SBI_IMPORT
#else
#define REG_API SBI_EXTERN
#endif
#if defined(SB_SPLIT_BUILD)
#define REGI_API extern
#else
#define REGI_API static SBI_UNUSED
#endif

#endif /* REG_API_H */
