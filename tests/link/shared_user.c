/* A caller of all three headers in a shared library: SB_SHARED imports them. */
#define SB_SHARED
#include "needle.h"
#include "register.h"

#include <string.h>

int main(void)
{
    ndl_needle_def needle = ndl_default_needle_def();
    reg_match_def match = reg_default_match_def();
    (void)needle;
    (void)match;
    return strcmp(sb_result_string(SB_ERROR_MESH), "SB_ERROR_MESH") != 0;
}
