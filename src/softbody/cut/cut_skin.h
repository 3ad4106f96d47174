/* cut_skin: contact with the surface of a body that is cut, lips and all. Floor 4.
 *
 *     sb_cut_surface_create(cut, NULL, &surface, &error);
 *     contact_def.skin = sb_cut_surface_skin(surface);
 *     sb_contact_create(&contact_def, &contact, &error);
 *     ... cuts, steps ... */
#ifndef SB_CUT_SKIN_H
#define SB_CUT_SKIN_H

#include "../body/skin.h"
#include "cut_surface.h"

/* The surface as a skin, for sb_contact_def.skin: tools touch the skin and the lips of the body where they are, not the
 * whole elements whose pieces move there; and with sb_contact_def.pairs so do parts that were cut off, and the two lips
 * of a cut. It is the surface's, and nothing of its own is to be destroyed; the contact
 * goes first.
 * Contact follows each call that cuts and each state that is loaded in the step that comes next, which may take memory
 * then, and remembers what it did of triangles that are still there; until then it reads as before. It brings the
 * surface up to date for that: arrays of sb_cut_surface_get are to be got again after a step, and the next
 * sb_cut_surface_update still names all that was made since the one before. Where that fails, the step says so. NULL of
 * NULL. */
SB_API sb_skin *sb_cut_surface_skin(sb_cut_surface *surface);

#endif /* SB_CUT_SKIN_H */
