/* The declarations have come in, perhaps through another header, before the implementation is asked for; a further
 * inclusion changes nothing. */
#include "softbody.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "softbody.h"
