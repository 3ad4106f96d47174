/* body_tell: the observer of a body hears of the calls that change it. */
#include <string.h>

#include "body_private.h"
#include "state_part.h"

SBI_API int sbi_body_is_heard(const sb_body *body) { return body->observe && !(body->parts && body->parts->muted > 0); }

SBI_API void sbi_body_tell(sb_body *body, sbi_command_code code, int a, int b, const int *ints, size_t int_count,
                           const sb_real *reals, size_t real_count)
{
    sbi_command command;
    if (!sbi_body_is_heard(body))
        return;
    memset(&command, 0, sizeof command);
    command.code = code;
    command.a = a;
    command.b = b;
    command.ints = ints;
    command.int_count = int_count;
    command.reals = reals;
    command.real_count = real_count;
    body->observe(body->observer, &command);
}

SBI_API void sbi_body_tell_command(sb_body *body, const sbi_command *command)
{
    if (sbi_body_is_heard(body))
        body->observe(body->observer, command);
}
