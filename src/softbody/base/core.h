/* core: configuration, results, errors, allocator, jobs. Floor 0: calls nothing but libc. */
#ifndef SB_CORE_H
#define SB_CORE_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "../names.h"

#define SB_VERSION_MAJOR 0
#define SB_VERSION_MINOR 5
#define SB_VERSION_PATCH 0
#define SB_VERSION_STRING "0.5.0"

#if defined(__FAST_MATH__) && !defined(SB_ALLOW_FAST_MATH)
#error "softbody.h: -ffast-math breaks determinism and NaN checks; define SB_ALLOW_FAST_MATH to insist"
#endif

/* ---- scalar type ------------------------------------------------------------------------------------
 * SB_REAL is double unless the user defines it as float before including. The public functions of a float
 * build carry the suffix _f32 (see names.h), so a float caller and a double object fail at link time. */
#ifndef SB_REAL
#define SB_REAL double
#endif
#define SBI_PASTE_(a, b) a##b
#define SBI_PASTE(a, b) SBI_PASTE_(a, b)
#define SBI_REAL_CODE_double 1
#define SBI_REAL_CODE_float 2
#if SBI_PASTE(SBI_REAL_CODE_, SB_REAL) == 1
#define SB_REAL_IS_FLOAT 0
#elif SBI_PASTE(SBI_REAL_CODE_, SB_REAL) == 2
#define SB_REAL_IS_FLOAT 1
#else
#error "softbody.h: SB_REAL must be double or float"
#endif
typedef SB_REAL sb_real;

#if SB_REAL_IS_FLOAT
#define SB_EPSILON 1.1920929e-7f /* distance from 1 to the next sb_real */
#define SB_REAL_MAX 3.4028234e38f
#else
#define SB_EPSILON 2.220446049250313e-16
#define SB_REAL_MAX 1.7976931348623157e308
#endif

/* ---- linkage ----------------------------------------------------------------------------------------
 * SB_API: what stands before the declaration of each public function. Define it before including to have your own, in
 * C++ with extern "C". Else SB_STATIC makes public functions static, so that two libraries in one process never clash,
 * and SB_SHARED makes them those of a shared library: exported by the file that defines SB_IMPLEMENTATION (before its
 * first inclusion), also under -fvisibility=hidden, and imported by all others.
 * SBI_API: internal functions; static in the shipped header, extern when the rooms are compiled apart. */
#if defined(__GNUC__)
#define SBI_UNUSED __attribute__((unused))
#else
#define SBI_UNUSED
#endif
#if defined(__cplusplus)
#define SBI_EXTERN extern "C"
#else
#define SBI_EXTERN extern
#endif
#if defined(_WIN32) || defined(__CYGWIN__)
#define SBI_EXPORT SBI_EXTERN __declspec(dllexport)
#define SBI_IMPORT SBI_EXTERN __declspec(dllimport)
#elif defined(__GNUC__)
#define SBI_EXPORT SBI_EXTERN __attribute__((visibility("default")))
#define SBI_IMPORT SBI_EXPORT
#else
#define SBI_EXPORT SBI_EXTERN
#define SBI_IMPORT SBI_EXTERN
#endif
#if defined(SB_API)
#define SBI_API_IS_GIVEN 1
#elif defined(SB_STATIC)
#define SB_API static SBI_UNUSED
#elif defined(SB_SHARED) && defined(SB_IMPLEMENTATION)
#define SB_API SBI_EXPORT
#elif defined(SB_SHARED)
#define SB_API SBI_IMPORT
#else
#define SB_API SBI_EXTERN
#endif
#if defined(SB_SPLIT_BUILD)
#define SBI_API extern
#else
#define SBI_API static SBI_UNUSED
#endif

/* SB_INLINE: small public functions defined in the header itself. SBI_NOINLINE: what set-up calls at hundreds of
 * places, where copies only take time to compile. */
#if defined(__GNUC__)
#define SB_INLINE static inline SBI_UNUSED
#define SBI_FORCE_INLINE static inline __attribute__((always_inline, unused))
#define SBI_NOINLINE __attribute__((noinline))
#else
#define SB_INLINE static inline
#define SBI_FORCE_INLINE static inline
#define SBI_NOINLINE
#endif

/* Asks for the cache line `bytes` past a pointer, which need not be one of the array's. Processors predict one stream;
 * loops over matrices read several. */
#if defined(__GNUC__)
#define SBI_PREFETCH(pointer, bytes) __builtin_prefetch((const void *)((uintptr_t)(pointer) + (bytes)))
#else
#define SBI_PREFETCH(pointer, bytes) ((void)(pointer), (void)(bytes))
#endif

/* SB_RESTRICT: the pointer's target is reached through no other pointer of the function. */
#if defined(__GNUC__) || defined(_MSC_VER) /* in every language mode; cl knows C99's word from /std:c11 on only */
#define SB_RESTRICT __restrict
#elif defined(__cplusplus)
#define SB_RESTRICT
#else
#define SB_RESTRICT restrict
#endif

/* SB_ASSERT: our own invariants only; bad input never reaches one. Replace it or leave it off (default). */
#ifndef SB_ASSERT
#define SB_ASSERT(condition) ((void)0)
#endif

/* ---- results and errors ------------------------------------------------------------------------------
 * Every call that can fail returns an sb_result and leaves its outputs untouched on failure. Calls that return
 * something else give 0, NULL or a struct of zeros for an object that is NULL and for an index that is not there; those
 * that return nothing do nothing. Only the inline kernels of vectors and small matrices take their arguments as
 * given. */
typedef enum sb_result {
    SB_OK = 0,
    SB_ERROR_MEMORY = -1,         /* the allocator returned NULL, or a size does not fit size_t */
    SB_ERROR_ARGUMENT = -2,       /* null pointer, count, enum or parameter outside its documented range */
    SB_ERROR_NOT_FINITE = -3,     /* NaN or infinity in an input */
    SB_ERROR_INDEX = -4,          /* node, element or region index out of range */
    SB_ERROR_FILE = -5,           /* a file cannot be opened, read or written */
    SB_ERROR_FORMAT = -6,         /* a file breaks the rules of its format */
    SB_ERROR_UNSUPPORTED = -7,    /* valid, but outside what this library reads or solves */
    SB_ERROR_MESH = -8,           /* inverted, flat or degenerate element, repeated node, empty mesh */
    SB_ERROR_MATERIAL = -9,       /* material parameters outside their range */
    SB_ERROR_UNCONSTRAINED = -10, /* a static problem whose supports leave a rigid motion free */
    SB_ERROR_INVERTED = -11,      /* an element turned inside out where the material does not allow it */
    SB_ERROR_DIVERGED = -12,      /* a solve found no acceptable step, or NaN appeared; the state was restored */
    SB_ERROR_NOT_CONVERGED = -13, /* an iteration limit was reached before the tolerance */
    SB_ERROR_INDEFINITE = -14,    /* a matrix that must be positive definite is not */
    SB_ERROR_STATE = -15,         /* a saved state or a recording of another body, or a replay that went another way */
    SB_ERROR_CANCELLED = -16      /* a progress callback asked to stop */
} sb_result;

/* Where and why a call failed. Fields that do not apply are -1 (line: 0) or empty. Plain data; zero-initialise
 * or leave uninitialised, a failing call writes every field. */
typedef struct sb_error {
    sb_result result;
    int line;          /* line in `file`, from 1; 0 when there is none */
    int element;       /* element index, or -1 */
    int node;          /* node index, or -1 */
    char file[256];    /* path as given, cut at the front when longer */
    char message[256]; /* one sentence, e.g. "node 12 has a coordinate that is not finite" */
} sb_error;

/* Name of a result, e.g. "SB_ERROR_MEMORY"; never NULL. Thread-safe, static storage. */
SB_API const char *sb_result_string(sb_result result);

/* ---- memory -------------------------------------------------------------------------------------------
 * alloc returns at least `bytes` bytes aligned for any scalar type, or NULL; release accepts NULL. An
 * allocator of zeros ({0}), or without one of the two functions, means malloc and free. */
typedef struct sb_allocator {
    void *(*alloc)(void *user, size_t bytes);
    void (*release)(void *user, void *pointer);
    void *user;
} sb_allocator;

/* ---- threads ------------------------------------------------------------------------------------------
 * run must call task(task_user, i) once for every i in [0, count), in any order and on any threads, and return
 * when all calls have returned. A jobs of zeros ({0}) does the work inline. The result does not depend on how
 * the calls are spread: every task owns its outputs. The time does: give each thread the same stretch of [0, count) in
 * every run, so that it finds in its cache what it wrote in the last one, and let threads that are done help the
 * others; this saves a tenth of a step. A step has a hundred runs and more, many of a few microseconds: let the caller
 * work too, wait only for tasks that a thread has begun, and never spin for long for a thread that another process may
 * keep off its processor. */
typedef void (*sb_task)(void *task_user, int index);
typedef struct sb_jobs {
    void (*run)(void *user, sb_task task, void *task_user, int count);
    void *user;
} sb_jobs;

#if defined(SB_USE_OPENMP)
/* Jobs on OpenMP's threads (compile the implementation with -fopenmp). An OpenMP loop waits for each of its threads,
 * ten milliseconds and more for one that another process keeps off its processor. Each calling thread therefore notes
 * what its loops lose by that; where they lose more than they gain it works alone, ten times as long as the loss or
 * longer, and then tries the threads again. Beside busy processes steps then take about as long as with one thread;
 * results are the same bits in any case. What is noted is a threadprivate record of 32 bytes, the library's only memory
 * outside of objects.
 *
 * Variables of the environment that matter, read when the program starts:
 *   OMP_NUM_THREADS          threads, at most 64 are used. Default: all processors. Fewer where other work runs beside.
 *   OMP_PROC_BIND=true       binds threads to processors. Set it where nothing else computes: without it two threads
 *   may
 *                            share a processor for a whole run, which then takes twice as long. Leave it out where
 *                            other programs compute: bound threads cannot step aside.
 *   OMP_WAIT_POLICY=passive  threads sleep between loops instead of spinning (gcc: GOMP_SPINCOUNT=N turns first, clang:
 *                            KMP_BLOCKTIME=N milliseconds first). Leaves processors to others, makes short loops
 *                            slower. Default: a few milliseconds of spinning, then sleep. OMP_WAIT_POLICY=active never
 *                            sleeps: only for a machine that does nothing else. */
SB_API sb_jobs sb_jobs_openmp(void);
#endif

/* ---- time ---------------------------------------------------------------------------------------------
 * A clock the host may lend for per-phase times: seconds since any fixed moment. NULL: times read 0. */
typedef double (*sb_clock)(void);

/* ---- internal: checked sizes, errors, allocation --------------------------------------------------------- */

/* One block shared by many arrays. Walk the same list of sbi_arena_take calls twice: with base NULL to measure
 * (`used` grows, `overflow` is set when a size does not fit), then with base set to hand the pieces out, each
 * aligned to a cache line (64 bytes) when base is. */
typedef struct sbi_arena {
    unsigned char *base;
    size_t used;
    int overflow;
} sbi_arena;

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* *total += count * size; 0 when the sum does not fit size_t (then *total is unchanged), else 1. */
SBI_API SBI_NOINLINE int sbi_size_add(size_t *total, size_t count, size_t size);
/* Memory for count items of `size` bytes, or NULL (also when count * size overflows). Never asks for 0 bytes. */
SBI_API SBI_NOINLINE void *sbi_alloc(const sb_allocator *allocator, size_t count, size_t size);
SBI_API SBI_NOINLINE void *sbi_alloc_zeroed(const sb_allocator *allocator, size_t count, size_t size);
SBI_API SBI_NOINLINE void sbi_free(const sb_allocator *allocator, void *pointer);
SBI_API SBI_NOINLINE void *sbi_arena_take(sbi_arena *arena, size_t count, size_t size);
/* Runs the task over [0, count) on jobs, inline when jobs is NULL or empty. */
SBI_API SBI_NOINLINE void sbi_run(const sb_jobs *jobs, sb_task task, void *task_user, int count);
/* Fills error (may be NULL) and returns result. The format is printf's. */
SBI_API sb_result sbi_fail(sb_error *error, sb_result result, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;
SBI_API sb_result sbi_fail_element(sb_error *error, sb_result result, int element, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 4, 5)))
#endif
    ;
SBI_API sb_result sbi_fail_node(sb_error *error, sb_result result, int node, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 4, 5)))
#endif
    ;
/* Copies a path into the error, cut at the front when it is too long. */
SBI_API SBI_NOINLINE void sbi_error_set_file(sb_error *error, const char *name);
/* A failure of a whole file. */
SBI_API sb_result sbi_fail_file(sb_error *error, sb_result result, const char *path, const char *why);
#endif

SB_INLINE int sbi_min_int(int a, int b) { return a < b ? a : b; }
SB_INLINE int sbi_max_int(int a, int b) { return a > b ? a : b; }
/* 1 when x is neither NaN nor infinite. Raises no floating-point exception. */
SB_INLINE int sb_is_finite(sb_real x) { return isfinite(x) != 0; }

#endif /* SB_CORE_H */
