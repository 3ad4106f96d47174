/* Another library in the same process, with a copy of its own and of another precision. */
#define SB_STATIC
#define SB_REAL float
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "needle.h"

#include <string.h>

int static_second(void);

int static_second(void)
{
    return sizeof(sb_real) != sizeof(float) || strcmp(sb_result_string(SB_ERROR_INDEX), "SB_ERROR_INDEX") != 0;
}
