/* A caller's unit: the declarations only. */
#include "needle.h"

#include <string.h>

int main(void) { return strcmp(sb_result_string(SB_ERROR_MESH), "SB_ERROR_MESH") != 0; }
