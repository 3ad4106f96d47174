/* The one unit of the tests that holds the libraries' code. */
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "needle.h"
