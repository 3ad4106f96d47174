/* heat_tell: commands to heat, as the body's recording has them. */
#include "heat_private.h"

SBI_API void sbi_heat_tell(sb_heat *heat, sbi_heat_command command, int a, const sb_real *reals, size_t real_count)
{
    const int ints[2] = {(int)command, a};
    sbi_body_tell_part(heat->body, SBI_HEAT_PART, ints, 2, reals, real_count);
}

SBI_API void sbi_heat_tell_source(sb_heat *heat, const sbi_heat_source *source)
{
    sbi_body_tell_part(heat->body, SBI_HEAT_PART, source->head, SBI_HEAT_HEAD + 2 * (size_t)source->count,
                       source->value, 2 + (size_t)source->count);
}

SBI_API void sbi_heat_tell_step(sb_heat *heat, sbi_heat_command command, sb_result result, sb_real dt)
{
    const int ints[2] = {(int)command, 0};
    sbi_body_tell_part_step(heat->body, SBI_HEAT_PART, result, ints, 2, &dt, 1);
}
