/* liver.h: the livers of the shared data, for tests of matching: what a registration is given, and the truth, which
 * only the score sees. */
#ifndef LIVER_H
#define LIVER_H

#include "check.h"
#include "scene.h"

/* What a case was given and its truth, which only the score sees. */
typedef struct liver {
    sb_mesh mesh, surface, target, fine;
    sb_vec3 *truth;
    sb_real fixed_below; /* of (x + z) / sqrt 2 (m) */
} liver;

static inline int liver_mesh(const char *name, const char *file, sb_mesh *mesh)
{
    char path[256], full[512];
    memset(mesh, 0, sizeof *mesh);
    snprintf(path, sizeof path, "data/insilico/%s/%s", name, file);
    return check_shared_path(full, sizeof full, path) && CHECK_OK(sb_mesh_load(mesh, full, NULL, NULL));
}

/* The displacements in truth_fine.vtk, and the half space of info.json. */
static inline int liver_numbers(const char *name, liver *made)
{
    char path[256], full[512], line[512];
    FILE *file;
    int count = 0;
    double x, y, z;
    snprintf(path, sizeof path, "data/insilico/%s/truth/truth_fine.vtk", name);
    made->truth = (sb_vec3 *)malloc((size_t)made->fine.node_count * sizeof(sb_vec3));
    file = check_shared_path(full, sizeof full, path) ? fopen(full, "r") : NULL;
    while (file && fgets(line, sizeof line, file) && strncmp(line, "VECTORS", 7) != 0)
        continue;
    while (file && count < made->fine.node_count && fscanf(file, "%lf %lf %lf", &x, &y, &z) == 3)
        made->truth[count++] = sb_v3(REAL(x), REAL(y), REAL(z));
    if (file)
        fclose(file);
    snprintf(path, sizeof path, "data/insilico/%s/info.json", name);
    file = check_shared_path(full, sizeof full, path) ? fopen(full, "r") : NULL;
    made->fixed_below = -SB_REAL_MAX;
    while (file && fgets(line, sizeof line, file))
        if (sscanf(line, " \"offset\": %lf", &x) == 1)
            made->fixed_below = REAL(x);
    if (file)
        fclose(file);
    return CHECK_INT(count, made->fine.node_count) && CHECK(made->fixed_below > -1);
}

static inline int liver_read(const char *name, const char *mesh, const char *target, liver *made)
{
    memset(made, 0, sizeof *made);
    return liver_mesh(name, mesh, &made->mesh) && liver_mesh(name, "undeformed_surface.obj", &made->surface) &&
           liver_mesh(name, target, &made->target) && liver_mesh(name, "truth/truth_fine.vtk", &made->fine) &&
           liver_numbers(name, made);
}

static inline void liver_free(liver *made)
{
    sb_mesh_free(&made->mesh);
    sb_mesh_free(&made->surface);
    sb_mesh_free(&made->target);
    sb_mesh_free(&made->fine);
    free(made->truth);
}

/* Mean and largest error (mm) over the fine nodes of the coarse solution. */
static inline double liver_score(const liver *made, const sb_body *body, double *most)
{
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_vec3 *points = (sb_vec3 *)malloc((size_t)made->fine.node_count * sizeof(sb_vec3));
    double sum = 0;
    def.mesh = &made->mesh;
    def.points = made->fine.nodes;
    def.point_count = made->fine.node_count;
    def.max_distance = SB_REAL_MAX;
    def.kind = SB_EMBED_PLAIN;
    *most = 1e9;
    if (CHECK_OK(sb_embedding_create(&def, &embedding, NULL)) &&
        CHECK_OK(sb_embedding_update(embedding, sb_body_positions(body), points, NULL, NULL))) {
        *most = 0;
        for (int i = 0; i < made->fine.node_count; i++) {
            sb_vec3 u = sb_v3_sub(points[i], made->fine.nodes[i]);
            double error = 1e3 * (double)sb_v3_norm(sb_v3_sub(u, made->truth[i]));
            sum += error;
            *most = fmax(*most, error);
        }
    }
    sb_embedding_destroy(embedding);
    free(points);
    return sum / (double)made->fine.node_count;
}

/* 1 when a node at rest is in the region known not to move. */
static inline int liver_is_fixed(const liver *made, sb_vec3 x)
{
    return (x.x + x.z) * REAL(0.70710678) < made->fixed_below;
}

/* The node of the fine mesh that moves most. */
static inline int liver_farthest(const liver *made)
{
    int best = 0;
    for (int i = 0; i < made->fine.node_count; i++)
        if (sb_v3_norm(made->truth[i]) > sb_v3_norm(made->truth[best]))
            best = i;
    return best;
}

#endif /* LIVER_H */
