/* The three headers as one shared library, for languages that load one: `make shared`, or the compiler lines of
 * examples/csharp/README.md. Compile with -DSB_SHARED. */
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#define REG_IMPLEMENTATION
#include "needle.h"
#include "register.h"
