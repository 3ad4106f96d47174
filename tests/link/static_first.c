/* A library with its own private copy of the header. */
#define SB_STATIC
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "needle.h"

#include <string.h>

int static_second(void);

int main(void) { return static_second() || strcmp(sb_result_string(SB_ERROR_FILE), "SB_ERROR_FILE") != 0; }
