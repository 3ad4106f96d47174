/* The one unit of the tests that holds the libraries' code. */
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#define REG_IMPLEMENTATION
#include "needle.h"
#include "register.h"
