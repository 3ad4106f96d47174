/* particle_scene.h: clouds of particles in boxes, for tests. */
#ifndef PARTICLE_SCENE_H
#define PARTICLE_SCENE_H

#include "scene.h"

/* A box with its skin, and particles in it: the nodes of nx x ny x nz bricks, moved by up to `shake` spacings (those on
 * the skin along it). */
typedef struct particle_cloud {
    sb_vec3 *points, size;
    int count, cells[3];
    sb_mesh skin; /* tri3 */
    sb_surface *surface;
} particle_cloud;

/* The tri3 surface of a box of bricks. */
static inline sb_mesh box_skin(int nx, int ny, int nz, sb_vec3 size)
{
    sb_mesh bricks, skin;
    sb_boundary boundary;
    memset(&skin, 0, sizeof skin);
    memset(&bricks, 0, sizeof bricks);
    if (CHECK_OK(sb_mesh_beam(SB_HEX8, nx, ny, nz, size, NULL, &bricks, NULL)) &&
        CHECK_OK(sb_mesh_boundary(&bricks, 1, NULL, &boundary, NULL))) {
        CHECK_OK(sb_surface_triangulate(&boundary.surface, NULL, &skin, NULL));
        sb_boundary_free(&boundary);
    }
    sb_mesh_free(&bricks);
    return skin;
}

/* size: of the longest side; bricks are cubes. */
static inline particle_cloud random_cloud(unsigned long long *seed, int nx, int ny, int nz, double size, double shake)
{
    particle_cloud cloud;
    int most = nx > ny ? nx : ny, at = 0;
    double edge = size / (most > nz ? most : nz);
    memset(&cloud, 0, sizeof cloud);
    cloud.cells[0] = nx, cloud.cells[1] = ny, cloud.cells[2] = nz;
    cloud.size = sb_v3(REAL(edge * nx), REAL(edge * ny), REAL(edge * nz));
    cloud.count = (nx + 1) * (ny + 1) * (nz + 1);
    cloud.points = (sb_vec3 *)malloc((size_t)cloud.count * sizeof(sb_vec3));
    cloud.skin = box_skin(nx, ny, nz, cloud.size);
    CHECK_OK(sb_surface_create(&cloud.skin, NULL, &cloud.surface, NULL));
    for (int z = 0; z <= nz; z++)
        for (int y = 0; y <= ny; y++)
            for (int x = 0; x <= nx; x++) {
                double dx = x > 0 && x < nx ? check_random_in(seed, -shake, shake) : 0;
                double dy = y > 0 && y < ny ? check_random_in(seed, -shake, shake) : 0;
                double dz = z > 0 && z < nz ? check_random_in(seed, -shake, shake) : 0;
                cloud.points[at++] = sb_v3(REAL(edge * (x + dx)), REAL(edge * (y + dy)), REAL(edge * (z + dz)));
            }
    return cloud;
}

static inline void cloud_use(const particle_cloud *cloud, sb_particles_def *def)
{
    def->outer.surface = cloud->surface;
    def->points = cloud->points;
    def->point_count = cloud->count;
    for (int k = 0; k < 3; k++)
        def->counts[k] = cloud->cells[k];
}

static inline void cloud_free(particle_cloud *cloud)
{
    sb_surface_destroy(cloud->surface);
    sb_mesh_free(&cloud->skin);
    free(cloud->points);
    memset(cloud, 0, sizeof *cloud);
}

static inline sb_particles make_particles(const sb_particles_def *def)
{
    sb_particles p;
    sb_error error;
    memset(&p, 0, sizeof p);
    if (!CHECK_OK(sb_particles_create(def, &p, &error)))
        printf("    %s\n", error.message);
    return p;
}

static inline sb_body_def cloud_body_def(const sb_particles *p, sb_material material)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = &p->mesh;
    def.domain = &p->domain;
    def.material = material;
    return def;
}

/* Two triangles in the plane x = `at`, over y and z from low to high. */
static inline sb_mesh make_sheet(sb_real at, sb_real low, sb_real high)
{
    static const int corners[6] = {0, 1, 2, 0, 2, 3};
    sb_mesh sheet;
    memset(&sheet, 0, sizeof sheet);
    sheet.element_type = SB_TRI3;
    sheet.node_count = 4;
    sheet.element_count = 2;
    sheet.nodes = (sb_vec3 *)malloc(4 * sizeof(sb_vec3));
    sheet.elements = (int *)malloc(6 * sizeof(int));
    sheet.nodes[0] = sb_v3(at, low, low), sheet.nodes[1] = sb_v3(at, high, low);
    sheet.nodes[2] = sb_v3(at, high, high), sheet.nodes[3] = sb_v3(at, low, high);
    memcpy(sheet.elements, corners, sizeof corners);
    return sheet;
}

/* The tri3 skin of the liver-like organ. */
static inline sb_mesh make_organ_skin(void)
{
    sb_mesh organ, skin;
    sb_boundary boundary;
    memset(&skin, 0, sizeof skin);
    memset(&organ, 0, sizeof organ);
    if (CHECK_OK(sb_mesh_organ(SB_TET4, 10, NULL, &organ, NULL)) &&
        CHECK_OK(sb_mesh_boundary(&organ, 1, NULL, &boundary, NULL))) {
        CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &skin, NULL));
        sb_boundary_free(&boundary);
    }
    sb_mesh_free(&organ);
    return skin;
}

#endif /* PARTICLE_SCENE_H */
