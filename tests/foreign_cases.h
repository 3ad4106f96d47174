/* foreign_cases.h: cases that are written in other solvers' formats and read again: the reference ones, and random
 * ones; and models of those formats in memory. */
#ifndef FOREIGN_CASES_H
#define FOREIGN_CASES_H

#include "softbody.h"

#include "check.h"

#include "../examples/case_reader.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const reference_names[] = {"cylinder_bend_coarse_tet10",
                                              "cylinder_bend_fine_tet10",
                                              "cylinder_stretch3_hex20",
                                              "cylinder_stretch3_tet10",
                                              "dyn_gravity_hex20",
                                              "dyn_gravity_tet10",
                                              "dyn_gravity_tet4",
                                              "lin_cantilever_hex20",
                                              "lin_cantilever_hex8",
                                              "lin_cantilever_tet10",
                                              "lin_cantilever_tet4",
                                              "modal_cantilever_hex20",
                                              "modal_cantilever_hex8",
                                              "modal_cantilever_tet10",
                                              "modal_cantilever_tet4",
                                              "modal_free_hex20",
                                              "modal_free_hex8",
                                              "modal_free_tet10",
                                              "modal_free_tet4",
                                              "mr_shear_hex20",
                                              "mr_shear_tet10",
                                              "mr_stretch60_hex20",
                                              "mr_stretch60_tet10",
                                              "mr_uniaxial_hex8",
                                              "nh_cantilever_hex20",
                                              "nh_cantilever_hex8",
                                              "nh_cantilever_tet10",
                                              "nh_cantilever_tet4",
                                              "nh_uniaxial_tet10",
                                              "phantom_probe_tet10",
                                              "phantom_probe_tet4",
                                              "rp2_compress30_hex20",
                                              "rp2_compress30_tet10",
                                              "rp2_liver_gravity_tet10",
                                              "rp2_stretch50_hex20",
                                              "svk_cantilever_hex20",
                                              "svk_cantilever_tet10",
                                              "svk_cantilever_tet4",
                                              "twist90_hex20",
                                              "twist90_tet10"};
enum { REFERENCE_COUNT = (int)(sizeof reference_names / sizeof reference_names[0]) };

/* The path of a file of a reference case; 0 when it is not there. */
static inline int reference_path(char *path, size_t size, int i, const char *file)
{
    char relative[128];
    snprintf(relative, sizeof relative, "reference/%s/%s", reference_names[i], file);
    return check_shared_path(path, size, relative);
}

/* A list beside a case of this stem, for its statements and for writing. */
static inline FILE *open_random_list(const char *stem, const char *ending)
{
    char path[128];
    snprintf(path, sizeof path, "%s_%s", stem, ending);
    return fopen(path, "w");
}

/* Writes STEM.case, a case of a random beam in random words: two regions or one, one of four laws, which print a
 * modulus, all loads; and its lists. whole_steps: 1 for an end that is a number of time steps. */
static inline void write_random_case(const char *stem, const char *const laws[4], int whole_steps,
                                     unsigned long long *state)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20};
    double size = pow(10, 3 * (int)check_random_in(state, -1, 2));
    int two = check_random(state) < 0.5, dynamic = check_random(state) < 0.5;
    sb_mesh mesh;
    sb_error error;
    const char *name = strrchr(stem, '/') ? strrchr(stem, '/') + 1 : stem;
    char path[128];
    FILE *file, *list;
    snprintf(path, sizeof path, "%s.case", stem);
    file = fopen(path, "w");
    memset(&mesh, 0, sizeof mesh);
    CHECK_OK(sb_mesh_beam(types[(int)check_random_in(state, 0, 4)], 2, 2, 3,
                          sb_v3((sb_real)(size * check_random_in(state, 1, 2)), (sb_real)size, (sb_real)size), NULL,
                          &mesh, &error));
    mesh.regions = (int *)calloc((size_t)mesh.element_count, sizeof(int));
    for (int e = 0; e < mesh.element_count && mesh.regions; e++)
        mesh.regions[e] = two && e % 3 == 0 ? 42 : 7;
    snprintf(path, sizeof path, "%s.vtk", stem);
    CHECK_OK(sb_mesh_save_vtk(path, &mesh, NULL, 0, &error));
    free(mesh.regions);
    mesh.regions = NULL;
    if (!CHECK(file != NULL)) {
        sb_mesh_free(&mesh);
        return;
    }
    fprintf(file, "mesh %s.vtk\n", name);
    for (int k = 0; k <= two; k++) {
        fprintf(file, "material ");
        fprintf(file, laws[(int)check_random_in(state, 0, 4)], check_random_in(state, 100, 1e5));
        fprintf(file, " density=%.17g region=%d\n", check_random_in(state, 900, 1100), k ? 42 : 7);
    }
    fprintf(file, "gravity %.17g 0 %.17g\n", check_random_in(state, -9, 9), check_random_in(state, -9, 9));
    list = open_random_list(stem, "fix");
    for (int i = 0; i < mesh.node_count && list; i++)
        if (mesh.nodes[i].x == 0)
            fprintf(list, "%d\n", i);
    CHECK(list && fclose(list) == 0);
    fprintf(file, "fix %s nodes=%s_fix\n", check_random(state) < 0.5 ? "xyz" : "zx", name);
    list = open_random_list(stem, "move");
    for (int i = 0; i < mesh.node_count && list; i++)
        if (mesh.nodes[i].x > (sb_real)(0.999 * size) && i % 2)
            fprintf(list, "%d %.17g 0 %.17g\n", i, size * check_random_in(state, -.01, .01),
                    size * check_random_in(state, -.01, .01));
    CHECK(list && fclose(list) == 0);
    fprintf(file, "prescribe xyz file=%s_move%s\n", name, dynamic ? " ramp=.3" : "");
    list = open_random_list(stem, "push");
    for (int i = 0; i < mesh.node_count && list; i++)
        if (i % 3 == 0)
            fprintf(list, "%d %.17g %.17g 0\n", i, check_random_in(state, -1e-3, 1e-3), check_random_in(state, -1, 1));
    CHECK(list && fclose(list) == 0);
    fprintf(file, "force file=%s_push\n", name);
    list = open_random_list(stem, "face"); /* sides of the elements, whatever they are */
    for (int e = 0; e < mesh.element_count && list; e++)
        for (int k = 0; k < sb_element_face_count(mesh.element_type); k++) {
            int local[SB_MAX_FACE_NODES], out = 1, corners = sb_element_corner_count(mesh.element_type) == 8 ? 4 : 3;
            const int *cell = mesh.elements + (size_t)e * (size_t)sb_mesh_element_width(&mesh);
            sb_element_face(mesh.element_type, k, local, NULL);
            for (int a = 0; a < corners; a++)
                out &= mesh.nodes[cell[local[a]]].z == 0;
            for (int a = 0; a < corners && out; a++)
                fprintf(list, "%d ", cell[local[a]]);
            fprintf(list, "\n");
        }
    CHECK(list && fclose(list) == 0);
    fprintf(file, "pressure faces=%s_face value=%.17g\n", name, check_random_in(state, -3, 3));
    if (dynamic) {
        double dt = check_random_in(state, .01, .1);
        fprintf(file, "solve newmark dt=%.17g end=%.17g tol=1e-7\noutput probe 5 p\n", dt, whole_steps ? 17 * dt : 1);
    }
    if (!dynamic)
        fprintf(file, "solve static steps=%d tol=1e-8\noutput displacement u\noutput reaction r\n",
                (int)check_random_in(state, 1, 20));
    CHECK(fclose(file) == 0);
    sb_mesh_free(&mesh);
}

/* ---- models in memory -------------------------------------------------------------------------------------- */

typedef int foreign_reader(case_file *c, const char *path);

/* Writes text to a file of the tests and reads it; 1 when it is a case. */
static inline int read_foreign_text(case_file *c, foreign_reader *read, const char *path, const char *text)
{
    FILE *file = fopen(path, "wb");
    int ok = file && fwrite(text, 1, strlen(text), file) == strlen(text);
    if (file)
        ok &= fclose(file) == 0;
    CHECK(ok);
    return read(c, path);
}

/* The displacement of a node by its number when what was read (ok: it is a case) is solved; the case is freed. */
static inline sb_vec3 solve_foreign(case_file *c, int ok, int number)
{
    sb_body *body = NULL;
    sb_vec3 u = sb_v3(0, 0, 0);
    if (!CHECK(ok && case_create_body(c, &body))) {
        printf("%s%s\n", c->faults.text ? c->faults.text : "", c->message);
    } else {
        sb_static_options options = case_static_options(c);
        if (SB_REAL_IS_FLOAT)
            options.tolerance = (sb_real)1e-5;
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
        for (int i = 0; i < c->mesh.node_count; i++)
            if (c->node_numbers[i] == number)
                u = sb_body_displacements(body)[i];
    }
    sb_body_destroy(body);
    case_free(c);
    return u;
}

/* What was read is refused with one fault, in this line, whose words hold `words`; the case is freed. */
static inline void check_foreign_refused(case_file *c, int ok, int line, const char *words)
{
    CHECK(!ok);
    if (!CHECK_INT(c->error_line, line) || !CHECK(strstr(c->message, words) != NULL))
        printf("  expected line %d: %s\n  got  line %d: %s\n", line, words, c->error_line, c->message);
    if (!CHECK(c->faults.count <= 1))
        printf("%s", c->faults.text);
    case_free(c);
}

typedef struct foreign_mistake {
    int line;
    const char *words;
} foreign_mistake;

/* A file with ten mistakes gets a list of ten lines. */
static inline void check_foreign_mistakes(foreign_reader *read, const char *path, const foreign_mistake expected[10])
{
    case_file c;
    const char *at;
    int ok = read(&c, path);
    CHECK(!ok);
    CHECK_INT(c.faults.count, 10);
    at = c.faults.text;
    for (int i = 0; i < 10 && at; i++) {
        char place[64];
        const char *end = strchr(at, '\n');
        snprintf(place, sizeof place, "%s:%d: ", path, expected[i].line);
        ok = strncmp(at, place, strlen(place)) == 0 && strstr(at, expected[i].words) &&
             strstr(at, expected[i].words) < end;
        if (!CHECK(ok))
            printf("  expected %s%s\n  got %.*s\n", place, expected[i].words, (int)(end - at), at);
        at = end + 1;
    }
    CHECK_INT(c.error_line, expected[0].line);
    case_free(&c);
}

#endif /* FOREIGN_CASES_H */
