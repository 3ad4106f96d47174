/* The one unit of the tests that holds the library's code. */
#define SB_IMPLEMENTATION
#include "softbody.h"
