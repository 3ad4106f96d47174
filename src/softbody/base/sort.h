/* sort: numbers in an order that the caller says. Internal. Floor 0. */
#ifndef SB_SORT_H
#define SB_SORT_H

#include "core.h"

/* Sorts `order` [count], stably, by before(context, a, b); scratch [count]. Merging, so that no input is
 * slow. */
typedef int (*sbi_before)(const void *context, int a, int b);
SBI_API void sbi_merge_sort(int *order, int *scratch, int count, sbi_before before, const void *context);

#endif /* SB_SORT_H */
