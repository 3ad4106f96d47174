/* sort: merging. */
#include "sort.h"

#include <string.h>

/* Merges [first, middle) and [middle, end) of `from` into `to`. */
static void sbi_merge_runs(const int *from, int *to, int first, int middle, int end, sbi_before before,
                           const void *context)
{
    int left = first, right = middle;
    for (int i = first; i < end; i++) {
        int take_right = left >= middle || (right < end && before(context, from[right], from[left]));
        to[i] = take_right ? from[right++] : from[left++];
    }
}

SBI_API void sbi_merge_sort(int *order, int *scratch, int count, sbi_before before, const void *context)
{
    int *from = order, *to = scratch;
    for (int64_t width = 1; width < count; width *= 2) {
        int *swap = from;
        for (int64_t first = 0; first < count; first += 2 * width) {
            int64_t middle = first + width < count ? first + width : count;
            int64_t end = middle + width < count ? middle + width : count;
            sbi_merge_runs(from, to, (int)first, (int)middle, (int)end, before, context);
        }
        from = to;
        to = swap;
    }
    if (from != order)
        memcpy(order, from, (size_t)count * sizeof order[0]);
}
