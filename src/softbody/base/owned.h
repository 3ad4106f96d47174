/* owned: arrays that one object takes one by one and gives back together. Internal. Floor 0. */
#ifndef SB_OWNED_H
#define SB_OWNED_H

#include "core.h"

/* All zeros is empty, with malloc. */
typedef struct sbi_owned {
    sb_allocator allocator;
    void *last;   /* the array taken last; each knows the one before */
    size_t bytes; /* of all of them */
} sbi_owned;

/* count items of `size` bytes that begin on a cache line and may be read a cache line past their end; NULL when there
 * is no memory or the size does not fit. */
SBI_API SBI_NOINLINE void *sbi_owned_take(sbi_owned *owned, size_t count, size_t size);
SBI_API SBI_NOINLINE int *sbi_owned_take_ints(sbi_owned *owned, size_t count);
/* count * width floats, zeroed, so that what is read a cache line before and past them is a number. */
SBI_API float *sbi_owned_take_floats(sbi_owned *owned, size_t count, size_t width);
/* The same of floats that are all written before they are read: only those before and past them are zeroed. */
SBI_API float *sbi_owned_take_unset_floats(sbi_owned *owned, size_t count, size_t width);
/* Gives all of them back. */
SBI_API void sbi_owned_free(sbi_owned *owned);

#endif /* SB_OWNED_H */
