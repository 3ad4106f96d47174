/* Target: a case file and one list of nodes or faces beside it, with a form feed between them. What is accepted is
 * solved for a little. Works in files build/fuzz_case/... */
#ifndef TARGET_CASE_H
#define TARGET_CASE_H

#include "fuzz.h"

#include "examples/case_reader.h"

#define FUZZ_CASE_FOLDER "build/fuzz_case/"

static void fuzz_write(const char *path, const void *data, size_t size)
{
    FILE *file = fopen(path, "wb");
    FUZZ_REQUIRE(file != NULL);
    FUZZ_REQUIRE(fwrite(data, 1, size, file) == size && fclose(file) == 0);
}

static void fuzz_write_text(const char *path, const char *text) { fuzz_write(path, text, strlen(text)); }

/* The files that a case may name, besides `list`. */
static void fuzz_write_case_files(void)
{
    sb_mesh cube, tet10;
    memset(&cube, 0, sizeof cube);
    memset(&tet10, 0, sizeof tet10);
    FUZZ_REQUIRE(sb_mesh_beam(SB_HEX8, 1, 1, 1, sb_v3(1, 1, 1), NULL, &cube, NULL) == SB_OK);
    FUZZ_REQUIRE(sb_mesh_beam(SB_TET10, 1, 1, 1, sb_v3(1, 1, 1), NULL, &tet10, NULL) == SB_OK);
    FUZZ_REQUIRE(sb_mesh_save_vtk(FUZZ_CASE_FOLDER "cube.vtk", &cube, NULL, 0, NULL) == SB_OK);
    FUZZ_REQUIRE(sb_mesh_save_vtk(FUZZ_CASE_FOLDER "tet10.vtk", &tet10, NULL, 0, NULL) == SB_OK);
    fuzz_write_text(FUZZ_CASE_FOLDER "z0", "0\n1\n2\n3\n");
    fuzz_write_text(FUZZ_CASE_FOLDER "x0", "0\n2\n4\n6\n");
    sb_mesh_free(&cube);
    sb_mesh_free(&tet10);
}

/* A few modes; the body must stay as it is. */
static void fuzz_find_modes(const case_file *c, sb_body *body)
{
    sb_modes_options options = sb_default_modes_options();
    sb_real frequencies[3];
    int count = c->solve->number[CASE_COUNT] < 3 ? (int)c->solve->number[CASE_COUNT] : 3;
    uint64_t before = sb_body_state_hash(body);
    options.max_iterations = 5;
    options.mass = case_mass(c);
    if (sb_body_modes(body, count, &options, frequencies, NULL, NULL, NULL) == SB_OK)
        for (int i = 0; i < count; i++)
            FUZZ_REQUIRE(sb_is_finite(frequencies[i]) && frequencies[i] >= 0);
    FUZZ_REQUIRE(sb_body_state_hash(body) == before);
}

static void fuzz_solve_case(case_file *c, sb_body *body)
{
    sb_static_options options;
    double dt;
    uint64_t before;
    FUZZ_REQUIRE(sb_body_set_solver(body, (sb_real)1e-3, 50) == SB_OK);
    if (c->solve->form->code == CASE_STATIC) {
        options = case_static_options(c);
        options.load_steps = options.load_steps < 3 ? options.load_steps : 3;
        options.max_newton = 4;
        options.max_iterations = 50;
        fuzz_solve(body, &options);
        return;
    }
    if (c->solve->form->code == CASE_MODES) {
        fuzz_find_modes(c, body);
        return;
    }
    body->max_substeps = 40;
    dt = case_dt(c) > 0 ? case_dt(c) : c->solve->number[CASE_END] / 10; /* auto is bounded by the cap of substeps */
    for (int step = 1; step <= 3 && step <= case_step_count(c, dt); step++) {
        double time = case_step_time(c, dt, step, case_step_count(c, dt));
        before = sb_body_state_hash(body);
        if (case_move_supports(c, body, time) != SB_OK)
            FUZZ_REQUIRE(sb_body_state_hash(body) != 0 || before == 0);
        fuzz_step(body, (sb_real)dt);
    }
}

static void fuzz_case(const uint8_t *data, size_t size)
{
    static int is_ready;
    const uint8_t *cut = size ? (const uint8_t *)memchr(data, '\f', size) : NULL;
    size_t first = cut ? (size_t)(cut - data) : size;
    case_file c;
    sb_body *body = NULL;
    if (!is_ready)
        fuzz_write_case_files();
    is_ready = 1;
    if (first > 0 && memchr(data, '/', first)) /* no other files, and no devices */
        return;
    for (size_t i = 0; i + 5 < first; i++) /* a thousand cells a side are right, and slow; target geometry stuffs */
        if (memcmp(data + i, "stuff", 5) == 0)
            return;
    fuzz_write(FUZZ_CASE_FOLDER "fuzz.case", first ? (const void *)data : "", first);
    fuzz_write(FUZZ_CASE_FOLDER "list", cut ? (const void *)(cut + 1) : "", cut ? size - first - 1 : 0);
    if (!case_read(&c, FUZZ_CASE_FOLDER "fuzz.case")) {
        FUZZ_REQUIRE(c.message[0] && c.error_line >= 0);
    } else if (!case_create_body(&c, &body)) {
        FUZZ_REQUIRE(c.message[0]);
    } else {
        fuzz_solve_case(&c, body);
    }
    sb_body_destroy(body);
    case_free(&c);
}

#endif /* TARGET_CASE_H */
