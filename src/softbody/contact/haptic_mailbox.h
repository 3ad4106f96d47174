/* haptic_mailbox: hands whole records from one thread to another without waiting. Internal.
 *
 * Three slots, of which the caller keeps the records: the writer fills `back`, the reader reads `front`, and the one
 * between them changes hands by one atomic exchange on either side. No loop and no lock, so neither side can make the
 * other late; a writer that stops anywhere leaves the reader its last whole record; records the reader is too slow for
 * are overwritten.
 *
 *     writer: slot[sbi_mailbox_back(&box)] = record; sbi_mailbox_post(&box);
 *     reader: if (sbi_mailbox_take(&box)) use(slot[sbi_mailbox_front(&box)]);
 *
 * A seqlock would need no slots, but its data race is undefined in C.
 *
 * Atomics, the first of these that there is:
 *     SB_ATOMIC_EXCHANGE(p, v), SB_ATOMIC_LOAD(p)  the user's, both defined before the implementation: the first puts
 *                         v into *p and returns what was there, ordering memory both ways (acquire and release); the
 *                         second reads *p in any order. p is a pointer to SB_ATOMIC_TYPE, int unless defined too
 *     gcc, clang          __atomic_exchange_n, also in C99 and C++, for MinGW and wasm
 *     MSVC                _InterlockedExchange, a full barrier
 *     C11                 <stdatomic.h>; with SB_USE_STDATOMIC in place of the two above
 * Without any, or with SB_NO_ATOMICS, SBI_HAS_ATOMICS is 0: all compiles, and what needs a mailbox refuses to start. */
#ifndef SB_HAPTIC_MAILBOX_H
#define SB_HAPTIC_MAILBOX_H

#include "../base/core.h"

#define SBI_HAS_ATOMICS 1
#if defined(SB_NO_ATOMICS)
#undef SBI_HAS_ATOMICS
#define SBI_HAS_ATOMICS 0
#elif defined(SB_ATOMIC_EXCHANGE) && defined(SB_ATOMIC_LOAD)
#if !defined(SB_ATOMIC_TYPE)
#define SB_ATOMIC_TYPE int
#endif
#define SBI_ATOMIC_EXCHANGE(p, v) SB_ATOMIC_EXCHANGE(p, v)
#define SBI_ATOMIC_LOAD(p) SB_ATOMIC_LOAD(p)
typedef SB_ATOMIC_TYPE sbi_atomic;
#elif defined(__GNUC__) && !defined(SB_USE_STDATOMIC) /* clang defines it too */
#define SBI_ATOMIC_EXCHANGE(p, v) __atomic_exchange_n((p), (v), __ATOMIC_ACQ_REL)
#define SBI_ATOMIC_LOAD(p) __atomic_load_n((p), __ATOMIC_RELAXED)
typedef int sbi_atomic;
#elif defined(_MSC_VER) && !defined(SB_USE_STDATOMIC)
/* declared as <intrin.h> does, which brings in every vector type there is */
#if defined(__cplusplus)
extern "C" long _InterlockedExchange(long volatile *, long);
#else
long _InterlockedExchange(long volatile *, long);
#endif
#pragma intrinsic(_InterlockedExchange)
#define SBI_ATOMIC_EXCHANGE(p, v) ((int)_InterlockedExchange((p), (v)))
#define SBI_ATOMIC_LOAD(p) ((int)*(p))
typedef volatile long sbi_atomic;
#elif defined(SB_USE_STDATOMIC) ||                                                                                     \
    (defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L && !defined(__STDC_NO_ATOMICS__))
#include <stdatomic.h>
#define SBI_ATOMIC_EXCHANGE(p, v) atomic_exchange_explicit((p), (v), memory_order_acq_rel)
#define SBI_ATOMIC_LOAD(p) atomic_load_explicit((p), memory_order_relaxed)
typedef atomic_int sbi_atomic;
#else
#undef SBI_HAS_ATOMICS
#define SBI_HAS_ATOMICS 0
#endif

#if !SBI_HAS_ATOMICS
typedef int sbi_atomic;
SB_INLINE int sbi_atomic_exchange(sbi_atomic *p, int v)
{
    int was = *p;
    *p = v;
    return was;
}
#define SBI_ATOMIC_EXCHANGE(p, v) sbi_atomic_exchange(p, v)
#define SBI_ATOMIC_LOAD(p) (*(p))
#endif

enum {
    SBI_MAILBOX_SLOTS = 3,
    SBI_MAILBOX_NEW = 4,   /* beside the index of the slot between: the reader has not seen it */
    SBI_MAILBOX_APART = 64 /* bytes of a cache line: neither side's own index shares one with the word both write */
};

typedef struct sbi_mailbox {
    unsigned char before[SBI_MAILBOX_APART];
    int back; /* the writer's slot */
    unsigned char between[SBI_MAILBOX_APART];
    sbi_atomic middle; /* slot and SBI_MAILBOX_NEW: all that is shared */
    unsigned char beside[SBI_MAILBOX_APART];
    int front; /* the reader's slot */
    unsigned char after[SBI_MAILBOX_APART];
} sbi_mailbox;

/* Empty; before a second thread knows of it. */
SB_INLINE void sbi_mailbox_begin(sbi_mailbox *box)
{
    box->back = 0;
    (void)SBI_ATOMIC_EXCHANGE(&box->middle, 1);
    box->front = 2;
}
/* The slot that the writer fills. */
SB_INLINE int sbi_mailbox_back(const sbi_mailbox *box) { return box->back; }
/* Hands it over: the next one to fill is sbi_mailbox_back's then. */
SB_INLINE void sbi_mailbox_post(sbi_mailbox *box)
{
    box->back = SBI_ATOMIC_EXCHANGE(&box->middle, box->back | SBI_MAILBOX_NEW) & ~SBI_MAILBOX_NEW;
}
/* 1 when a record was posted since the last call: sbi_mailbox_front's is the newest then. */
SB_INLINE int sbi_mailbox_take(sbi_mailbox *box)
{
    if (!(SBI_ATOMIC_LOAD(&box->middle) & SBI_MAILBOX_NEW))
        return 0;
    box->front = SBI_ATOMIC_EXCHANGE(&box->middle, box->front) & ~SBI_MAILBOX_NEW;
    return 1;
}
/* The slot that the reader reads, as long as it likes; no record before the first successful sbi_mailbox_take. */
SB_INLINE int sbi_mailbox_front(const sbi_mailbox *box) { return box->front; }

#endif /* SB_HAPTIC_MAILBOX_H */
