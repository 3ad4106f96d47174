/* Target: saved preconditioners with bytes changed: refused, or they precondition. */
#ifndef TARGET_PRECOND_H
#define TARGET_PRECOND_H

#include "fuzz.h"

/* The tangent of a small body at rest, held at one end. */
static sb_body *fuzz_matrix_of(sb_mesh *mesh)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    FUZZ_REQUIRE(sb_mesh_beam(SB_TET4, 3, 1, 1, sb_v3(3, 1, 1), NULL, mesh, NULL) == SB_OK);
    def.mesh = mesh;
    def.material = sb_material_corotated(1000, (sb_real)0.3, 1000);
    FUZZ_REQUIRE(sb_body_create(&def, &body, NULL) == SB_OK);
    for (int i = 0; i < mesh->node_count; i++)
        if (mesh->nodes[i].x <= 0)
            FUZZ_REQUIRE(sb_body_fix_nodes(body, &i, 1, SB_XYZ) == SB_OK);
    FUZZ_REQUIRE(sb_body_step(body, (sb_real)0.01, NULL) == SB_OK);
    return body;
}

static void fuzz_apply(sb_preconditioner *p, const sb_matrix *matrix, fuzz_bytes *bytes)
{
    size_t count = 3 * (size_t)matrix->row_count;
    sb_real *r = (sb_real *)malloc(2 * count * sizeof *r);
    FUZZ_REQUIRE(r != NULL);
    for (size_t i = 0; i < count; i++)
        r[i] = (sb_real)(fuzz_byte(bytes) - 128);
    sb_preconditioner_apply(p, r, r + count);
    if (sb_preconditioner_warp(p, matrix, NULL, NULL, NULL) == SB_OK)
        sb_preconditioner_apply(p, r, r + count);
    free(r);
}

static void fuzz_precond(const uint8_t *data, size_t size)
{
    fuzz_bytes bytes = {data, size, 0};
    sb_mesh mesh;
    sb_body *body = fuzz_matrix_of(&mesh);
    sb_preconditioner_def def = sb_default_preconditioner_def();
    sb_preconditioner *p = NULL;
    sb_error error;
    size_t length;
    unsigned char *image;
    int kind = fuzz_byte(&bytes);
    def.kind = (sb_precond_kind)(kind % 7);
    def.positions = kind & 8 ? mesh.nodes : NULL;
    def.power = 1 + kind / 16 % 2;
    FUZZ_REQUIRE(sb_preconditioner_create(&def, &body->matrix, NULL, &p, NULL) == SB_OK);
    FUZZ_REQUIRE(sb_preconditioner_update(p, &body->matrix, NULL, NULL) == SB_OK);
    length = sb_preconditioner_saved_size(p);
    image = (unsigned char *)malloc(length);
    FUZZ_REQUIRE(image && sb_preconditioner_save(p, image, length) == SB_OK);
    FUZZ_REQUIRE(sb_preconditioner_load(p, image, length, NULL) == SB_OK);
    fuzz_patch_image(&bytes, image, length);
    if (sb_preconditioner_load(p, image, length, &error) != SB_OK)
        FUZZ_REQUIRE(error.message[0]);
    fuzz_apply(p, &body->matrix, &bytes);
    if (sb_preconditioner_load(p, data, size, &error) != SB_OK)
        FUZZ_REQUIRE(error.message[0]);
    FUZZ_REQUIRE(sb_preconditioner_update(p, &body->matrix, NULL, NULL) == SB_OK);
    fuzz_apply(p, &body->matrix, &bytes);
    free(image);
    sb_preconditioner_free(p);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

#endif /* TARGET_PRECOND_H */
