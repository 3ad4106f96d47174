/* cut_tell: calls of a cut in its body's recording. */
#include "cut_private.h"

SBI_API void sbi_cut_tell(const sb_cut *cut, int command, int stroke, const sb_vec3 *points, int count)
{
    int ints[2];
    ints[0] = command;
    ints[1] = stroke;
    sbi_body_tell_part(cut->body, SBI_CUT_PART, ints, 2, (const sb_real *)(const void *)points, 3 * (size_t)count);
}
