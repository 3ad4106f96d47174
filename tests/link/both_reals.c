/* A program that uses both precisions: this unit is in double, both_reals_float.c in float. */
#include "needle.h"

#include <string.h>

const char *float_result_string(int result);

int main(void) { return strcmp(sb_result_string(SB_ERROR_MESH), float_result_string(SB_ERROR_MESH)) != 0; }
