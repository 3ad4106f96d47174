/* bench_contact: what contact costs beside a step: boxes over the faces of a body fitted anew, boxes asked for, and
 * faces that follow a mesh that changes. Prints for each kind of face: faces, microseconds of a refit with velocities
 * (least and median) and nanoseconds a face, then of queries with boxes of a tenth and of a third of the body:
 * nanoseconds, and faces found. Then of splits of edges among 13,608 tet4: microseconds that the faces take of each,
 * and of the update after it. Asserts nothing. */
#define SB_STATIC
#define SB_IMPLEMENTATION
#include "../../softbody.h"

#include "measure.h"

#include <stdio.h>

#include "../check.h"
#include "../follow_change.h"
#include "../scene.h"

check_state check;

enum { RUNS = 301, QUERIES = 2000 };

static const struct {
    const char *name;
    sb_element_type type;
    int cells; /* along a side of a cube */
} cases[] = {{"contact_refit_5k", SB_TET4, 20},
             {"contact_refit_tri6", SB_TET10, 10},
             {"contact_refit_quad4", SB_HEX8, 20},
             {"contact_refit_quad8", SB_HEX20, 10},
             {"contact_refit_quad9", SB_HEX27, 10}};

static sbi_contact_faces *make_faces(sb_body *body)
{
    sbi_contact_faces *faces;
    if (sbi_contact_faces_create(body, NULL, &faces, NULL) != SB_OK)
        exit(1);
    return faces;
}

static void time_refit(sbi_contact_faces *faces, const sb_body *body, const sb_vec3 *velocities, const char *name)
{
    double times[RUNS];
    for (int i = 0; i < RUNS; i++) {
        times[i] = now();
        sbi_contact_faces_refit(faces, sb_body_positions(body), velocities, REAL(0.01));
        times[i] = now() - times[i];
    }
    median(times, RUNS);
    printf("%-22s %6d faces %8.1f us least %8.1f us median %6.2f ns a face at least\n", name, faces->face_end,
           1e6 * times[0], 1e6 * times[RUNS / 2], 1e9 * times[0] / faces->face_end);
}

/* Boxes with sides of `share` of the body's, at random. */
static void time_queries(sbi_contact_faces *faces, double share)
{
    enum { ROUNDS = 11 };
    unsigned long long seed = 5;
    int *found = (int *)malloc((size_t)faces->face_end * sizeof(int));
    double times[ROUNDS], count = 0;
    sb_vec3 lows[QUERIES];
    for (int i = 0; i < QUERIES; i++) {
        double x = check_random_in(&seed, -share, 1), y = check_random_in(&seed, -share, 1);
        lows[i] = sb_v3(REAL(x), REAL(y), REAL(check_random_in(&seed, -share, 1)));
    }
    for (int r = 0; r < ROUNDS; r++) {
        times[r] = now();
        for (int i = 0; i < QUERIES; i++)
            count += sbi_contact_faces_query(faces, lows[i],
                                             sb_v3_add(lows[i], sb_v3(REAL(share), REAL(share), REAL(share))), found,
                                             faces->face_end);
        times[r] = now() - times[r];
    }
    median(times, ROUNDS);
    printf("    boxes of %.2f of a side: %8.0f ns a query at least, %6.1f faces found\n", share,
           1e9 * times[0] / (double)QUERIES, count / (double)(ROUNDS * QUERIES));
    free(found);
}

/* ---- changes ---- */

typedef struct follower {
    sbi_contact_faces *faces;
    double seconds; /* in the last change */
} follower;

static sb_result follower_reserve(void *user, const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    follower *f = (follower *)user;
    double start = now();
    sb_result result = sbi_contact_faces_reserve(f->faces, body, change, error);
    f->seconds = now() - start;
    return result;
}

static void follower_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    follower *f = (follower *)user;
    double start = now();
    sbi_contact_faces_follow(f->faces, body, change);
    f->seconds += now() - start;
}

static void time_changes(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 18, 18, 7, sb_v3(1, 1, REAL(0.4)), 0.1);
    sb_body_def def = sb_default_body_def();
    double changes[RUNS], updates[RUNS];
    unsigned long long seed = 7;
    sb_body_listener listener;
    follower f;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_corotated(5000, REAL(0.45), 1000);
    def.slack = REAL(0.5);
    body = scene_body(&def);
    f.faces = make_faces(body);
    memset(&listener, 0, sizeof listener);
    listener.user = &f;
    listener.reserve = follower_reserve;
    listener.follow = follower_follow;
    if (sb_body_listen(body, &listener, NULL, NULL) != SB_OK)
        exit(1);
    for (int i = 0; i < RUNS;) {
        follow_op op;
        if (follow_change(body, &op, 0, 4, &seed) != SB_OK)
            continue;
        changes[i] = f.seconds;
        updates[i] = now();
        if (sbi_contact_faces_update(f.faces, body, NULL, NULL) != SB_OK)
            exit(1);
        updates[i] = now() - updates[i];
        i++;
    }
    median(changes, RUNS);
    median(updates, RUNS);
    printf("%-22s %6d faces %8.1f us least %8.1f us median; update %8.1f us least %8.1f us median\n",
           "contact_follow_13k", f.faces->face_end, 1e6 * changes[0], 1e6 * changes[RUNS / 2], 1e6 * updates[0],
           1e6 * updates[RUNS / 2]);
    sbi_contact_faces_destroy(f.faces);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

int main(void)
{
    for (int c = 0; c < (int)(sizeof cases / sizeof cases[0]); c++) {
        sb_mesh mesh = scene_box(cases[c].type, cases[c].cells, cases[c].cells, cases[c].cells, sb_v3(1, 1, 1), 0);
        sb_body_def def = sb_default_body_def();
        sb_vec3 *velocities = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *velocities);
        unsigned long long seed = 3;
        sbi_contact_faces *faces;
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_corotated(5000, REAL(0.45), 1000);
        def.preconditioner = SB_PRECOND_BLOCK_JACOBI;
        body = scene_body(&def);
        for (int i = 0; i < mesh.node_count; i++)
            velocities[i].x = REAL(check_random_in(&seed, -1, 1));
        faces = make_faces(body);
        time_refit(faces, body, velocities, cases[c].name);
        time_queries(faces, 0.1);
        time_queries(faces, 0.33);
        sbi_contact_faces_destroy(faces);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(velocities);
    }
    time_changes();
    return 0;
}
