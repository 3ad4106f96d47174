/* Needles without what reads and writes files. */
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "needle.h"

int main(void)
{
    ndl_needle_def def = ndl_default_needle_def();
    return !(def.cookie && sb_result_string(SB_OK));
}
