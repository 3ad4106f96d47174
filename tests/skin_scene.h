/* skin_scene.h: bodies with contact on skins that are embedded in them. */
#ifndef SKIN_SCENE_H
#define SKIN_SCENE_H

#include "contact_scene.h"

/* ---- skins ---- */

/* A sphere of triangles: an octahedron cut `times` into four. */
static inline sb_mesh skin_sphere(sb_vec3 centre, double radius, int times)
{
    const sb_vec3 ends[6] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
    const int faces[8][3] = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4}, {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
    int n = 1 << times, side = (n + 1) * (n + 2) / 2;
    sb_vec3 *nodes = (sb_vec3 *)calloc((size_t)(8 * side), sizeof *nodes);
    int *elements = (int *)calloc((size_t)(8 * n * n * 3), sizeof *elements),
        *number = (int *)calloc((size_t)side, sizeof(int));
    int node_count = 0, count = 0;
    sb_mesh mesh;
    for (int f = 0; f < 8; f++) {
        for (int j = 0, p = 0; j <= n; j++)
            for (int i = 0; i <= n - j; i++, p++) {
                sb_real a = REAL(n - i - j), b = REAL(i), c = REAL(j);
                sb_vec3 x = sb_v3_madd(sb_v3_madd(sb_v3_scale(a, ends[faces[f][0]]), b, ends[faces[f][1]]), c,
                                       ends[faces[f][2]]);
                x = sb_v3_madd(centre, REAL(radius) / sb_v3_norm(x), x);
                for (number[p] = 0; number[p] < node_count; number[p]++)
                    if (sb_v3_norm(sb_v3_sub(nodes[number[p]], x)) < REAL(1e-4 * radius))
                        break;
                if (number[p] == node_count)
                    nodes[node_count++] = x;
            }
        for (int j = 0, row = 0; j < n; row += n - j + 1, j++)
            for (int i = 0; i < n - j; i++) {
                int *t = elements + 3 * count++;
                t[0] = number[row + i], t[1] = number[row + i + 1], t[2] = number[row + n - j + 1 + i];
                if (i + j < n - 1) {
                    t = elements + 3 * count++;
                    t[0] = number[row + i + 1], t[1] = number[row + n - j + 2 + i], t[2] = number[row + n - j + 1 + i];
                }
            }
    }
    memset(&mesh, 0, sizeof mesh);
    mesh.element_type = SB_TRI3;
    mesh.nodes = nodes, mesh.node_count = node_count;
    mesh.elements = elements, mesh.element_count = count;
    free(number);
    return mesh;
}

/* A body with a contact on a skin, and what both are of. */
typedef struct skinned {
    press p;
    sb_mesh surface;
    sb_embedding *embedding;
    sb_skin *skin;
} skinned;

/* The mesh becomes the scene's, and the surface. */
static inline skinned skin_make(sb_mesh mesh, sb_mesh surface, sb_body_def def, sb_contact_def contact)
{
    sb_embedding_def embed = sb_default_embedding_def();
    skinned s;
    sb_error error;
    memset(&s, 0, sizeof s);
    s.p.mesh = mesh;
    s.surface = surface;
    def.mesh = &s.p.mesh;
    s.p.body = scene_body(&def);
    embed.mesh = &s.p.mesh;
    embed.surface = &s.surface;
    CHECK_OK(sb_embedding_create(&embed, &s.embedding, NULL));
    if (def.slack > 0)
        CHECK_OK(sb_embedding_follow(s.embedding, s.p.body, NULL));
    CHECK_OK(sb_skin_create(s.embedding, &s.surface, NULL, &s.skin, NULL));
    contact.body = s.p.body;
    contact.skin = s.skin;
    if (sb_contact_create(&contact, &s.p.contact, &error) != SB_OK) {
        printf("%s\n", error.message);
        CHECK(s.p.contact != NULL);
    }
    return s;
}

static inline void skin_free(skinned *s)
{
    sb_contact_destroy(s->p.contact);
    sb_skin_destroy(s->skin);
    sb_embedding_destroy(s->embedding);
    sb_body_destroy(s->p.body);
    sb_mesh_free(&s->p.mesh);
    sb_mesh_free(&s->surface);
}

static inline sb_body_def skin_tissue(double young, double poisson)
{
    sb_body_def def = sb_default_body_def();
    def.material = sb_material_corotated(REAL(young), REAL(poisson), 1000);
    def.damping_stiffness = REAL(0.01);
    def.tolerance = sb_max(REAL(1e-12), 100 * SB_EPSILON);
    return def;
}

#endif /* SKIN_SCENE_H */
