/* Target: a file of MSML, whose mesh can be tet4.vtk, of a beam. What is accepted is solved for a little. Works in
 * build/fuzz_case/. */
#ifndef TARGET_MSML_H
#define TARGET_MSML_H

#include "target_case.h"

#include "examples/case_msml.h"

static void fuzz_write_beam(void)
{
    sb_mesh beam;
    memset(&beam, 0, sizeof beam);
    FUZZ_REQUIRE(sb_mesh_beam(SB_TET4, 2, 1, 1, sb_v3(2, 1, 1), NULL, &beam, NULL) == SB_OK);
    FUZZ_REQUIRE(sb_mesh_save_vtk(FUZZ_CASE_FOLDER "tet4.vtk", &beam, NULL, 0, NULL) == SB_OK);
    sb_mesh_free(&beam);
}

static void fuzz_msml(const uint8_t *data, size_t size)
{
    static const char surface[] = "surfaceMesh";
    static int is_ready;
    case_file c;
    sb_body *body = NULL;
    if (!is_ready)
        fuzz_write_beam();
    is_ready = 1;
    for (size_t i = 0; i + sizeof surface <= size; i++) /* stuffing is slow; target geometry does it */
        if (memcmp(data + i, surface, sizeof surface - 1) == 0)
            return;
    fuzz_write(FUZZ_CASE_FOLDER "fuzz.msml.xml", size ? (const void *)data : "", size);
    if (!msml_read(&c, FUZZ_CASE_FOLDER "fuzz.msml.xml"))
        FUZZ_REQUIRE(c.message[0] && c.error_line >= 0 && c.faults.count <= INP_MAX_FAULTS);
    else if (!case_create_body(&c, &body))
        FUZZ_REQUIRE(c.message[0]);
    else
        fuzz_solve_case(&c, body);
    sb_body_destroy(body);
    case_free(&c);
}

#endif /* TARGET_MSML_H */
