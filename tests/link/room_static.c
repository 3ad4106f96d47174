/* NDL_STATIC and REG_STATIC: one object that exports softbody.h's functions, and keeps the other two headers'
 * private. */
#define NDL_STATIC
#define REG_STATIC
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#define REG_IMPLEMENTATION
#include "needle.h"
#include "register.h"

#include <string.h>

int main(void) { return strcmp(sb_result_string(SB_ERROR_MESH), "SB_ERROR_MESH") != 0 || NDL_STATIC != 1; }
