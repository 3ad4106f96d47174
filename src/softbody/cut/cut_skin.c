/* cut_skin: hands out the skin that is in a cut's surface. */
#include "cut_skin.h"

#include "cut_private.h"

SB_API sb_skin *sb_cut_surface_skin(sb_cut_surface *surface)
{
    return surface ? sbi_cut_surface_get_skin(surface) : NULL;
}
