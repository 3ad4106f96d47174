/* cut_tell: calls of a cut in its body's recording. */
#include "cut_private.h"

SBI_API void sbi_cut_tell_tear(const sb_cut *cut, const sb_tear_options *options)
{
    int ints[3];
    ints[0] = SBI_CUT_TEAR;
    ints[1] = options->nucleate;
    ints[2] = options->max_tears;
    sbi_body_tell_part(cut->body, SBI_CUT_PART, ints, 3, NULL, 0);
}

SBI_API void sbi_cut_tell(const sb_cut *cut, int command, int stroke, const sb_vec3 *points, int count)
{
    int ints[2];
    ints[0] = command;
    ints[1] = stroke;
    sbi_body_tell_part(cut->body, SBI_CUT_PART, ints, 2, (const sb_real *)(const void *)points, 3 * (size_t)count);
}
