#define SB_REAL float
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "needle.h"

const char *float_result_string(int result);

const char *float_result_string(int result) { return sb_result_string((sb_result)result); }
