/* Target: an input file of FEBio. What is accepted is solved for a little. Works in build/fuzz_case/. */
#ifndef TARGET_FEB_H
#define TARGET_FEB_H

#include "target_case.h"

#include "examples/case_feb.h"

static void fuzz_feb(const uint8_t *data, size_t size)
{
    case_file c;
    sb_body *body = NULL;
    fuzz_write(FUZZ_CASE_FOLDER "fuzz.feb", size ? (const void *)data : "", size);
    if (!feb_read(&c, FUZZ_CASE_FOLDER "fuzz.feb"))
        FUZZ_REQUIRE(c.message[0] && c.error_line >= 0 && c.faults.count <= INP_MAX_FAULTS);
    else if (!case_create_body(&c, &body))
        FUZZ_REQUIRE(c.message[0]);
    else
        fuzz_solve_case(&c, body);
    sb_body_destroy(body);
    case_free(&c);
}

#endif /* TARGET_FEB_H */
