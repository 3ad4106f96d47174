/* phantom.h: a prostate phantom on a table and a flexible needle before it, for needle_prostate and its benchmark.
 * Needs needle.h, libc and libm only.
 *
 *     phantom p;
 *     memset(&p, 0, sizeof p);
 *     result = phantom_make_mesh(&p.mesh, &error);            or sb_mesh_load
 *     result = phantom_survey(&p, &error);                    where its regions are
 *     result = phantom_add_lesion(&p, &error);                if you like
 *     sb_body_def def = phantom_default_body_def();           clock, threads and such; mesh and materials are set by
 *     result = phantom_make_tissue(&p, &def, &error);
 *     result = phantom_make_needle(&p, curvature, aside, &error);
 *     phantom_free(&p);
 *
 * Every mesh of tet4 will do: the region with the highest number is the prostate, all others are tissue about it; the
 * lowest nodes lie on the table. The needle looks along x, at the middle of the prostate. */
#ifndef PHANTOM_H
#define PHANTOM_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "needle.h"

enum { PHANTOM_REGIONS = 64, PHANTOM_MEMBRANES = 2 * PHANTOM_REGIONS };

typedef struct phantom {
    sb_mesh mesh;
    int anatomy;                         /* 1: made by phantom_make_anatomy */
    int region_count;                    /* highest number and 1 */
    int prostate;                        /* its region, or -1: the mesh has only one */
    int meets_prostate[PHANTOM_REGIONS]; /* 1: this region has a face with it, */
    int meets_outside[PHANTOM_REGIONS];  /* or skin */
    sb_vec3 low, high;                   /* box of all nodes (m) */
    sb_vec3 target;                      /* middle of the prostate, or of all (m) */
    sb_body *tissue;
    ndl_needle *needle;
    int has_lesion;      /* 1: by phantom_add_lesion */
    sb_mixture lesion;   /* of the prostate's elements with it */
    ndl_follow follow;   /* of needles to be made; zeros: the mesh follows (NDL_REMESH) */
    sb_real free_length; /* m of the needle before the skin at the start */
} phantom;

/* ---- the mesh ---- */

/* Distances (m, negative inside) of a block of 120 x 100 x 90 mm with edges rounded by 15 mm, and about of an
 * ellipsoid with axes of 45 x 35 x 30 mm in it. */
static inline sb_real phantom_block_distance(void *user, sb_vec3 x)
{
    const double radius = 0.015;
    double q[3], out = 0, in;
    (void)user;
    q[0] = fabs((double)x.x) - (0.060 - radius);
    q[1] = fabs((double)x.y) - (0.050 - radius);
    q[2] = fabs((double)x.z) - (0.045 - radius);
    for (int c = 0; c < 3; c++)
        out += q[c] > 0 ? q[c] * q[c] : 0;
    in = fmax(q[0], fmax(q[1], q[2]));
    return (sb_real)(sqrt(out) + (in < 0 ? in : 0) - radius);
}

static inline sb_real phantom_prostate_distance(void *user, sb_vec3 x)
{
    const double a[3] = {0.0225, 0.0175, 0.015};
    double from[3], square = 0, slope = 0;
    (void)user;
    from[0] = (double)x.x - 0.003, from[1] = (double)x.y + 0.004, from[2] = (double)x.z - 0.002;
    for (int c = 0; c < 3; c++) {
        square += from[c] * from[c] / (a[c] * a[c]);
        slope += from[c] * from[c] / (a[c] * a[c] * a[c] * a[c]);
    }
    return (sb_real)(slope > 0 ? sqrt(square) * (sqrt(square) - 1) / sqrt(slope) : -a[2]);
}

/* Stuffs the block: 13,295 tets and 2,840 nodes, region 1 tissue, 2 prostate. */
static inline sb_result phantom_make_mesh(sb_mesh *mesh, sb_error *error)
{
    sb_stuff_def def = sb_default_stuff_def();
    sb_shape shapes[2];
    memset(shapes, 0, sizeof shapes);
    shapes[0].distance = phantom_block_distance;
    shapes[0].max_slope = 1;
    shapes[0].region = 1;
    shapes[1].distance = phantom_prostate_distance;
    shapes[1].region = 2;
    def.shapes = shapes;
    def.shape_count = 2;
    def.cell = (sb_real)0.0098;
    def.low = sb_v3((sb_real)-0.065, (sb_real)-0.055, (sb_real)-0.050);
    def.high = sb_v3((sb_real)0.065, (sb_real)0.055, (sb_real)0.050);
    return sb_mesh_stuff(&def, mesh, NULL, error);
}

/* ---- with skin and bone ---- */

enum { PHANTOM_SKIN = 1, PHANTOM_TISSUE = 2, PHANTOM_BONE = 3, PHANTOM_PROSTATE = 4 };

/* 6 mm below the skin. */
static inline sb_real phantom_deep_distance(void *user, sb_vec3 x)
{
    return phantom_block_distance(user, x) + (sb_real)0.006;
}

/* A pubic bone: a rod of 16 mm across the needle, above its way and before the prostate. */
static inline sb_real phantom_bone_distance(void *user, sb_vec3 x)
{
    double y = fabs((double)x.y), across = hypot((double)x.x + 0.02, (double)x.z - 0.031);
    (void)user;
    return (sb_real)(hypot(across, y > 0.025 ? y - 0.025 : 0) - 0.008);
}

/* The same block with skin, bone and prostate, in cells of 8.5 mm at all their surfaces that grow inwards. */
static inline sb_result phantom_make_anatomy(phantom *p, sb_error *error)
{
    static const sb_distance distances[4] = {phantom_block_distance, phantom_deep_distance, phantom_bone_distance,
                                             phantom_prostate_distance};
    sb_stuff_def def = sb_default_stuff_def();
    sb_shape shapes[4];
    memset(shapes, 0, sizeof shapes);
    for (int k = 0; k < 4; k++) {
        shapes[k].distance = distances[k];
        shapes[k].region = PHANTOM_SKIN + k;
        shapes[k].max_slope = k < 3;
    }
    def.shapes = shapes;
    def.shape_count = 4;
    def.cell = (sb_real)0.0085;
    def.levels = 2;
    def.low = sb_v3((sb_real)-0.065, (sb_real)-0.055, (sb_real)-0.050);
    def.high = sb_v3((sb_real)0.065, (sb_real)0.055, (sb_real)0.050);
    p->anatomy = 1;
    return sb_mesh_stuff(&def, &p->mesh, NULL, error);
}

/* ---- a lesion ---- */

enum { PHANTOM_LESION = PHANTOM_REGIONS - 1 };

/* A ball of 12 mm in the prostate, beside the needle's way. */
static inline sb_real phantom_lesion_distance(void *user, sb_vec3 x)
{
    (void)user;
    return sb_v3_norm(sb_v3_sub(x, sb_v3((sb_real)0.008, (sb_real)-0.002, (sb_real)0.006))) - (sb_real)0.006;
}

/* The mesh stays as it is, elements that lie in both are mixed: by the geometric mean, which of all is nearest to finer
 * meshes where a needle goes through (tests/test_needle_mixture.c). Such a body's mesh cannot follow a needle. */
static inline sb_result phantom_add_lesion(phantom *p, sb_error *error)
{
    static const sb_real stiffness[2] = {100000, 300000}; /* Pa, of the prostate and of the lesion */
    sb_mixture_def def = sb_default_mixture_def();
    sb_shape shape;
    sb_result result;
    memset(&shape, 0, sizeof shape);
    shape.distance = phantom_lesion_distance;
    shape.max_slope = 1;
    shape.region = PHANTOM_LESION;
    def.mesh = &p->mesh;
    def.shapes = &shape;
    def.shape_count = 1;
    def.mean = SB_MIXTURE_GEOMETRIC;
    def.stiffness = stiffness;
    result = sb_mixture_create(&def, &p->lesion, error);
    p->has_lesion = result == SB_OK;
    if (p->has_lesion)
        p->follow = NDL_EMBED;
    return result;
}

static inline int phantom_region(const sb_mesh *mesh, int element)
{
    return mesh->regions ? mesh->regions[element] : 0;
}

/* Mean of the tets' middles, of the prostate or of all. */
static inline sb_vec3 phantom_middle(const phantom *p)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    int count = 0;
    for (int e = 0; e < p->mesh.element_count; e++) {
        if (p->prostate >= 0 && phantom_region(&p->mesh, e) != p->prostate)
            continue;
        for (int c = 0; c < 4; c++)
            sum = sb_v3_madd(sum, (sb_real)0.25, p->mesh.nodes[p->mesh.elements[4 * e + c]]);
        count++;
    }
    return sb_v3_scale(1 / (sb_real)(count > 0 ? count : 1), sum);
}

static inline sb_result phantom_refuse(sb_result result, const char *message, sb_error *error)
{
    memset(error, 0, sizeof *error);
    error->result = result;
    snprintf(error->message, sizeof error->message, "%s", message);
    return result;
}

/* What touches what, and where things are. The mesh: tet4 that sb_mesh_validate accepts. */
static inline sb_result phantom_survey(phantom *p, sb_error *error)
{
    sb_index_table beside;
    sb_result result;
    int lowest = PHANTOM_REGIONS;
    if (p->mesh.element_type != SB_TET4)
        return phantom_refuse(SB_ERROR_UNSUPPORTED, "the tissue must be a volume of tets with 4 nodes", error);
    for (int e = 0; e < p->mesh.element_count; e++) {
        int region = phantom_region(&p->mesh, e);
        if (region < 0 || region >= PHANTOM_REGIONS)
            return phantom_refuse(SB_ERROR_UNSUPPORTED, "regions must be numbers from 0 to 63", error);
        p->region_count = region >= p->region_count ? region + 1 : p->region_count;
        lowest = region < lowest ? region : lowest;
    }
    p->prostate = p->region_count - 1 > lowest ? p->region_count - 1 : -1;
    sb_mesh_bounds(&p->mesh, &p->low, &p->high);
    p->target = phantom_middle(p);
    result = sb_mesh_neighbours(&p->mesh, NULL, &beside, error);
    if (result != SB_OK)
        return result;
    for (int e = 0; e < beside.rows; e++)
        for (int f = 0; f < 4; f++) {
            int other = beside.items[4 * e + f], region = phantom_region(&p->mesh, e);
            if (other < 0)
                p->meets_outside[region] = 1;
            else if (phantom_region(&p->mesh, other) == p->prostate && region != p->prostate)
                p->meets_prostate[region] = 1;
        }
    sb_index_table_free(&beside);
    return SB_OK;
}

/* ---- tissue and needle ---- */

/* One linear system a step, in which what dt cannot resolve is damped away; room for the mesh to follow the needle. The
 * tolerance is what a hand cannot feel: it leaves the base's force 5e-5 of itself, 0.7 mN at most, and the tip 0.7 um
 * off what 1e-9 gives (bench_needle accuracy). A tenth of it takes 1.6 times the iterations. */
static inline sb_body_def phantom_default_body_def(void)
{
    sb_body_def def = sb_default_body_def();
    def.integrator = SB_GENERALISED_ALPHA;
    def.spectral_radius = 0;
    def.max_newton = 1;
    def.damping_stiffness = (sb_real)0.005;
    def.tolerance = (sb_real)5e-3;
    def.slack = (sb_real)0.2;
    return def;
}

/* fixed: [node_count], room. What lies on the table (the lowest 3 % of the height), and bone; returns how many. */
static inline int phantom_list_fixed(const phantom *p, int *fixed)
{
    sb_real table = p->low.z + (sb_real)0.03 * (p->high.z - p->low.z);
    int count = 0;
    memset(fixed, 0, sizeof *fixed * (size_t)p->mesh.node_count);
    for (int k = 0; k < 4 * p->mesh.element_count; k++) {
        int i = p->mesh.elements[k];
        if (p->mesh.nodes[i].z <= table || (p->anatomy && phantom_region(&p->mesh, k / 4) == PHANTOM_BONE))
            fixed[i] = 1;
    }
    for (int i = 0; i < p->mesh.node_count; i++)
        if (fixed[i])
            fixed[count++] = i;
    return count;
}

/* Tissue of 50 kPa with a prostate of 100 kPa, and skin of 150 kPa and a lesion of 300 kPa where there are any; bone
 * does not move, and what lies on the table sticks to it. */
static inline sb_result phantom_make_tissue(phantom *p, sb_body_def *def, sb_error *error)
{
    sb_region_material materials[3];
    int *fixed = (int *)malloc((size_t)p->mesh.node_count * sizeof *fixed);
    sb_result result;
    if (!fixed)
        return phantom_refuse(SB_ERROR_MEMORY, "not enough memory", error);
    materials[0].region = p->prostate;
    materials[0].material = sb_material_corotated(100000, (sb_real)0.45, 1040);
    materials[2].region = PHANTOM_LESION;
    materials[2].material = sb_material_corotated(300000, (sb_real)0.45, 1060);
    materials[1].region = PHANTOM_SKIN;
    materials[1].material = sb_material_corotated(150000, (sb_real)0.45, 1100);
    def->mesh = &p->mesh;
    def->material = sb_material_corotated(50000, (sb_real)0.45, 1040);
    def->region_materials = materials;
    def->region_material_count = p->prostate < 0 ? 0 : p->anatomy ? 2 : 1;
    if (p->has_lesion) {
        def->mesh = &p->lesion.body_mesh;
        def->domain = &p->lesion.domain;
        def->region_material_count = 3;
        def->slack = 0;
    }
    result = sb_body_create(def, &p->tissue, error);
    if (result == SB_OK)
        result = sb_body_hold(p->tissue, fixed, phantom_list_fixed(p, fixed), SB_XYZ, error);
    def->domain = NULL;
    def->region_materials = NULL; /* it was of this call */
    def->region_material_count = 0;
    free(fixed);
    return result;
}

/* The skin, and a capsule round the prostate, each 1 mm thick. */
static inline int phantom_list_membranes(const phantom *p, ndl_membrane *membranes)
{
    int count = 0;
    for (int r = 0; r < p->region_count; r++) {
        const ndl_membrane skin = {{-1, r}, (sb_real)0.3, (sb_real)0.001};
        const ndl_membrane capsule = {{p->prostate, r}, (sb_real)0.9, (sb_real)0.001};
        if (p->meets_outside[r])
            membranes[count++] = skin;
        if (p->meets_prostate[r])
            membranes[count++] = capsule;
    }
    return count;
}

/* Where a line along x through a point first meets the skin; 0: it misses. */
static inline sb_result phantom_find_entry(const phantom *p, sb_vec3 through, sb_vec3 *entry, sb_error *error)
{
    sb_boundary boundary;
    sb_surface *skin = NULL;
    sb_surface_hit hit;
    sb_vec3 from = through;
    sb_result result = sb_mesh_boundary(&p->mesh, 1, NULL, &boundary, error);
    if (result != SB_OK)
        return result;
    result = sb_surface_create(&boundary.surface, NULL, &skin, error);
    sb_boundary_free(&boundary);
    if (result != SB_OK)
        return result;
    from.x = 2 * p->low.x - p->high.x;
    if (sb_surface_ray(skin, from, sb_v3(1, 0, 0), through.x - from.x, &hit))
        *entry = hit.point;
    else
        result = phantom_refuse(SB_ERROR_MESH, "a needle along x at the target's height would miss the tissue", error);
    sb_surface_destroy(skin);
    return result;
}

/* A nitinol needle of 0.83 mm, 2 mm before the skin, out of a sleeve (a template) that stands 30 mm before it.
 * curvature: 1/m of the path that its bevel cuts in stiff tissue, upwards (0: a symmetric tip). aside: m away from the
 * line through the target. */
static inline sb_result phantom_make_needle(phantom *p, sb_real curvature, sb_vec3 aside, sb_error *error)
{
    ndl_needle_def def = ndl_default_needle_def();
    ndl_friction frictions[PHANTOM_REGIONS];
    ndl_membrane membranes[PHANTOM_MEMBRANES];
    sb_vec3 entry;
    sb_result result = phantom_find_entry(p, sb_v3_add(p->target, aside), &entry, error);
    if (result != SB_OK)
        return result;
    for (int r = 0; r < PHANTOM_REGIONS; r++) {
        const ndl_friction tissue = {20, 40, (sb_real)0.4, 0, 0}, prostate = {35, 70, (sb_real)0.7, 0, 0};
        const ndl_friction lesion = {50, 100, 1, 0, 0};
        frictions[r] = p->has_lesion && r == PHANTOM_LESION ? lesion : r == p->prostate ? prostate : tissue;
    }
    def.body = p->tissue;
    def.follow = p->follow;
    def.base = sb_v3_add(entry, sb_v3((sb_real)-0.030, 0, 0));
    def.direction = sb_v3(1, 0, 0);
    def.director = sb_v3(0, 1, 0); /* then m2 = t x m1 looks up */
    def.length = p->free_length = (sb_real)0.028;
    def.bevel.curvature = curvature;
    def.frictions = frictions;
    def.friction_count = p->has_lesion ? (int)PHANTOM_REGIONS : p->region_count;
    def.membranes = membranes;
    def.membrane_count = phantom_list_membranes(p, membranes);
    ndl_rod_section_preset(NDL_NITINOL_083, &def.section);
    return ndl_needle_create(&def, &p->needle, error);
}

static inline void phantom_free(phantom *p)
{
    ndl_needle_destroy(p->needle);
    sb_body_destroy(p->tissue);
    sb_mixture_free(&p->lesion);
    sb_mesh_free(&p->mesh);
    memset(p, 0, sizeof *p);
}

#endif /* PHANTOM_H */
