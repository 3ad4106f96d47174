/* The declarations have come in, perhaps through another header, before the implementation is asked for; a further
 * inclusion changes nothing. */
#include "needle.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#define NDL_IMPLEMENTATION
#include "needle.h"

#include "needle.h"
#include "softbody.h"
