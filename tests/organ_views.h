/* organ_views.h: random organs and what is seen of them, for tests of registration. An organ is a bumpy ellipsoid,
 * star-shaped about the origin, whose bumps are random spherical harmonics; it deforms smoothly; a view shows a part of
 * it, with noise, outliers, a neighbour's surface, and in a pose of its own. Model and view have meshes of their own:
 * nothing but the formula is shared. */
#ifndef ORGAN_VIEWS_H
#define ORGAN_VIEWS_H

#include "scene.h"

#include "register.h"

enum { ORGAN_DEGREES = 6, ORGAN_BUMPS = 3 * ORGAN_DEGREES, ORGAN_WAVES = 3 };

typedef struct organ {
    double axes[3];                                 /* m: half, of the ellipsoid */
    double bump[ORGAN_BUMPS], pole[ORGAN_BUMPS][3]; /* share of the radius; zonal harmonic about that pole */
    double odd;                                     /* share of the bumps that half a turn about z does not repeat */
    double wave[ORGAN_WAVES][3], turn[ORGAN_WAVES][3], phase[ORGAN_WAVES]; /* of the deformation: m, 1/m, rad */
} organ;

static inline double organ_gauss(unsigned long long *seed)
{
    double sum = -6;
    for (int i = 0; i < 12; i++)
        sum += check_random_in(seed, 0, 1);
    return sum;
}

static inline void organ_direction(unsigned long long *seed, double d[3])
{
    double length;
    do {
        length = 0;
        for (int i = 0; i < 3; i++) {
            d[i] = organ_gauss(seed);
            length += d[i] * d[i];
        }
    } while (length < 1e-4);
    for (int i = 0; i < 3; i++)
        d[i] /= sqrt(length);
}

/* bumps: their size, a share of the radius, 0.15 is much; odd 1: no symmetry, 0: half a turn about z repeats the organ;
 * deformed: m, about the largest displacement of the view. */
static inline organ organ_make(unsigned long long *seed, double bumps, double odd, double deformed)
{
    organ o;
    o.axes[0] = check_random_in(seed, 0.10, 0.13);
    o.axes[1] = check_random_in(seed, 0.07, 0.09);
    o.axes[2] = check_random_in(seed, 0.045, 0.065);
    o.odd = odd;
    for (int i = 0; i < ORGAN_BUMPS; i++) {
        o.bump[i] = bumps * organ_gauss(seed) / (2 + i / 3);
        organ_direction(seed, o.pole[i]);
    }
    for (int i = 0; i < ORGAN_WAVES; i++) {
        double length = check_random_in(seed, 0.15, 0.3);
        organ_direction(seed, o.wave[i]);
        organ_direction(seed, o.turn[i]);
        o.phase[i] = check_random_in(seed, 0, 6.28);
        for (int k = 0; k < 3; k++) {
            o.wave[i][k] *= deformed / (int)ORGAN_WAVES;
            o.turn[i][k] *= 6.28 / length;
        }
    }
    return o;
}

static inline double organ_bump(const organ *o, double x, double y, double z)
{
    double sum = 0;
    for (int i = 0; i < ORGAN_BUMPS; i++) {
        double c = o->pole[i][0] * x + o->pole[i][1] * y + o->pole[i][2] * z, before = 1, p = c;
        for (int l = 1; l < 1 + i / 3; l++) { /* Legendre's recursion */
            double next = ((2 * l + 1) * c * p - l * before) / (l + 1);
            before = p;
            p = next;
        }
        sum += o->bump[i] * p;
    }
    return sum;
}

/* The surface in a direction (any length). */
static inline sb_vec3 organ_point(const organ *o, sb_vec3 direction)
{
    double x = (double)direction.x, y = (double)direction.y, z = (double)direction.z, r = sqrt(x * x + y * y + z * z);
    double one, half, bump, radius;
    x /= r, y /= r, z /= r;
    one = organ_bump(o, x, y, z);
    half = organ_bump(o, -x, -y, z);
    bump = (one + half) / 2 + o->odd * (one - half) / 2;
    radius = 1 / sqrt(x * x / (o->axes[0] * o->axes[0]) + y * y / (o->axes[1] * o->axes[1]) +
                      z * z / (o->axes[2] * o->axes[2]));
    radius *= bump > -0.6 ? 1 + bump : 0.4;
    return sb_v3(REAL(radius * x), REAL(radius * y), REAL(radius * z));
}

/* Where a point of the organ is after its deformation. */
static inline sb_vec3 organ_deform(const organ *o, sb_vec3 p)
{
    double u[3] = {0, 0, 0};
    for (int i = 0; i < ORGAN_WAVES; i++) {
        double s =
            sin(o->turn[i][0] * (double)p.x + o->turn[i][1] * (double)p.y + o->turn[i][2] * (double)p.z + o->phase[i]);
        for (int k = 0; k < 3; k++)
            u[k] += s * o->wave[i][k];
    }
    return sb_v3_add(p, sb_v3(REAL(u[0]), REAL(u[1]), REAL(u[2])));
}

static inline reg_rigid organ_pose(unsigned long long *seed, double far)
{
    reg_rigid pose;
    sb_real q[4];
    for (int i = 0; i < 4; i++)
        q[i] = REAL(organ_gauss(seed));
    pose.rotation = sb_quat_to_mat3(sb_quat_normalise(sb_quat_make(q[0], q[1], q[2], q[3])));
    pose.translation = sb_v3(REAL(check_random_in(seed, -far, far)), REAL(check_random_in(seed, -far, far)),
                             REAL(check_random_in(seed, -far, far)));
    return pose;
}

/* The closed surface of triangles: a cube's with cells^2 squares a side (6 cells^2 + 2 nodes), blown up to the organ.
 * turned: how the cube stands, so that two meshes of one organ share no node. */
static inline int organ_surface(const organ *o, int cells, const sb_mat3 *turned, int deformed, sb_mesh *surface)
{
    sb_mesh cube = scene_box(SB_HEX8, cells, cells, cells, sb_v3(2, 2, 2), 0);
    sb_boundary skin;
    int made = CHECK_OK(sb_mesh_boundary(&cube, 1, NULL, &skin, NULL));
    memset(surface, 0, sizeof *surface);
    if (made) {
        made = CHECK_OK(sb_surface_triangulate(&skin.surface, NULL, surface, NULL));
        sb_boundary_free(&skin);
    }
    for (int i = 0; i < surface->node_count; i++) {
        sb_vec3 c = sb_v3_sub(surface->nodes[i], sb_v3(1, 1, 1)), p;
        c = sb_v3(REAL(tan(0.7853981 * (double)c.x)), REAL(tan(0.7853981 * (double)c.y)),
                  REAL(tan(0.7853981 * (double)c.z))); /* squares of about one size */
        p = organ_point(o, sb_m3_apply(*turned, c));
        surface->nodes[i] = deformed ? organ_deform(o, p) : p;
    }
    sb_mesh_free(&cube);
    return made;
}

/* ---- views ----------------------------------------------------------------------------------------------------- */

typedef enum organ_normals {
    ORGAN_NORMALS_RIGHT = 0,
    ORGAN_NORMALS_NONE = 1,
    ORGAN_NORMALS_TURNED = 2 /* inwards */
} organ_normals;

/* What a view is to be like. Zeros: all of the surface, clean, in place. */
typedef struct organ_view_def {
    double share;    /* of the area, as far as the camera sees it; 0: all of it */
    double noise;    /* m, standard deviation of each coordinate */
    double outliers; /* share of the points that lie anywhere about */
    double sheet;    /* share of the points that are a neighbour's surface */
    organ_normals normals;
    int cells;    /* of the mesh, see organ_surface; 0: 26 */
    double moved; /* m: largest shift of the pose, which is then any rotation; 0: in place */
} organ_view_def;

/* A view. Release with organ_view_free. */
typedef struct organ_view {
    sb_mesh mesh; /* closed for the whole organ; of a part without outliers and sheet too */
    sb_vec3 *points, *normals,
        *places;           /* [count]; normals NULL: none; places: of the undeformed organ, without noise */
    int count, from_organ; /* the first from_organ points are the organ's */
    sb_vec3 camera;        /* in the view's frame */
    sb_vec3 seen_from;     /* unit, in the model's frame: from the organ to the camera */
    reg_rigid pose;        /* of the model onto the view */
} organ_view;

static inline void organ_view_free(organ_view *view)
{
    sb_mesh_free(&view->mesh);
    free(view->points);
    free(view->normals);
    free(view->places);
    memset(view, 0, sizeof *view);
}

static inline double organ_area(const sb_mesh *mesh, int e, sb_vec3 *normal)
{
    const int *n = mesh->elements + 3 * (size_t)e;
    sb_vec3 area = sb_v3_scale(REAL(0.5), sb_v3_cross(sb_v3_sub(mesh->nodes[n[1]], mesh->nodes[n[0]]),
                                                      sb_v3_sub(mesh->nodes[n[2]], mesh->nodes[n[0]])));
    double length = (double)sb_v3_norm(area);
    *normal = sb_v3_scale(length > 0 ? REAL(1 / length) : 0, area);
    return length;
}

/* Keeps the faces that look at the camera and are nearest to `towards`, up to a share of the area. */
static inline void organ_view_cut(sb_mesh *mesh, sb_vec3 camera, sb_vec3 towards, double share)
{
    double total = 0, reached = 0, low = 0, high = 1;
    int kept = 0;
    for (int pass = 0; pass < 40; pass++) { /* bisection of the radius */
        double radius = pass == 39 ? low : (low + high) / 2;
        total = reached = 0;
        kept = 0;
        for (int e = 0; e < mesh->element_count; e++) {
            const int *n = mesh->elements + 3 * (size_t)e;
            sb_vec3 normal, ray = sb_v3_sub(camera, mesh->nodes[n[0]]);
            double area = organ_area(mesh, e, &normal);
            total += area;
            if ((double)sb_v3_dot(ray, normal) < 0.15 * (double)sb_v3_norm(ray) ||
                (double)sb_v3_norm(sb_v3_sub(mesh->nodes[n[0]], towards)) > radius)
                continue;
            reached += area;
            for (int k = 0; k < 3 && pass == 39; k++)
                mesh->elements[3 * (size_t)kept + (size_t)k] = n[k];
            kept++;
        }
        if (pass < 38) {
            low = reached < share * total ? radius : low;
            high = reached < share * total ? high : radius;
        }
    }
    mesh->element_count = kept;
    CHECK_OK(sb_mesh_remove_unreferenced(mesh, &kept, NULL));
}

/* A neighbour's surface: a curved sheet that touches the organ at the view's rim and goes on from there. */
static inline void organ_view_sheet(unsigned long long *seed, sb_vec3 rim, sb_vec3 outward, sb_vec3 up, int count,
                                    sb_vec3 *points, sb_vec3 *normals)
{
    sb_vec3 side = sb_v3_cross(up, outward);
    for (int i = 0; i < count; i++) {
        double along = check_random_in(seed, 0, 0.08), across = check_random_in(seed, -0.06, 0.06);
        points[i] = sb_v3_madd(sb_v3_madd(rim, REAL(along + 0.005), outward), REAL(across), side);
        points[i] = sb_v3_madd(points[i], REAL(0.01 - 3 * across * across), up);
        normals[i] = sb_v3_madd(up, REAL(6 * across), side);
        normals[i] = sb_v3_scale(1 / sb_v3_norm(normals[i]), normals[i]);
    }
}

static inline void organ_view_add(unsigned long long *seed, const organ_view_def *def, sb_vec3 up, organ_view *view)
{
    int outliers = (int)(def->outliers * view->from_organ), sheet = (int)(def->sheet * view->from_organ), far = 0;
    sb_vec3 middle = sb_v3(0, 0, 0), outward;
    for (int i = 0; i < view->from_organ; i++)
        middle = sb_v3_madd(middle, 1 / REAL(view->from_organ), view->points[i]);
    for (int i = 0; i < view->from_organ; i++)
        if (sb_v3_norm(sb_v3_sub(view->points[i], middle)) > sb_v3_norm(sb_v3_sub(view->points[far], middle)))
            far = i;
    outward = sb_v3_sub(view->points[far], middle);
    outward = sb_v3_madd(outward, -sb_v3_dot(outward, up), up);
    outward = sb_v3_scale(1 / sb_v3_norm(outward), outward);
    organ_view_sheet(seed, view->points[far], outward, up, sheet, view->points + view->count,
                     view->normals + view->count);
    view->count += sheet;
    for (int i = 0; i < outliers; i++, view->count++) {
        double d[3], far_off = check_random_in(seed, 0.02, 0.15);
        organ_direction(seed, d);
        view->points[view->count] =
            sb_v3_add(middle, sb_v3(REAL(far_off * d[0]), REAL(far_off * d[1]), REAL(far_off * d[2])));
        organ_direction(seed, d);
        view->normals[view->count] = sb_v3(REAL(d[0]), REAL(d[1]), REAL(d[2]));
    }
}

static inline void organ_turn_mesh(sb_mesh *mesh)
{
    for (int e = 0; e < mesh->element_count; e++) {
        int *n = mesh->elements + 3 * (size_t)e, first = n[0];
        n[0] = n[1];
        n[1] = first;
    }
}

/* Puts it in its pose and its normals as asked for. */
static inline void organ_view_finish(const organ_view_def *def, organ_view *view)
{
    for (int i = 0; i < view->mesh.node_count; i++)
        view->mesh.nodes[i] = reg_rigid_apply(&view->pose, view->mesh.nodes[i]);
    for (int i = 0; i < view->count; i++) {
        view->points[i] = reg_rigid_apply(&view->pose, view->points[i]);
        view->normals[i] = sb_m3_apply(view->pose.rotation, view->normals[i]);
        if (def->normals == ORGAN_NORMALS_TURNED)
            view->normals[i] = sb_v3_scale(-1, view->normals[i]);
    }
    view->camera = reg_rigid_apply(&view->pose, view->camera);
    if (def->normals == ORGAN_NORMALS_TURNED)
        organ_turn_mesh(&view->mesh);
    if (def->normals == ORGAN_NORMALS_NONE) {
        free(view->normals);
        view->normals = NULL;
    }
}

/* 1 and a view of the organ, deformed. */
static inline int organ_view_make(unsigned long long *seed, const organ *o, const organ_view_def *def, organ_view *view)
{
    reg_rigid turned = organ_pose(seed, 1);
    reg_cloud cloud;
    size_t room;
    double from[3], to[3];
    sb_mesh places;
    memset(view, 0, sizeof *view);
    view->pose = def->moved > 0 ? organ_pose(seed, def->moved) : reg_rigid_identity();
    organ_direction(seed, from);
    organ_direction(seed, to);
    view->seen_from = sb_v3(REAL(from[0]), REAL(from[1]), REAL(from[2]));
    view->camera = sb_v3_scale(REAL(0.35), view->seen_from);
    if (!organ_surface(o, def->cells ? def->cells : 26, &turned.rotation, 0, &view->mesh))
        return 0;
    if (def->share > 0) {
        sb_vec3 aim = sb_v3_add(view->seen_from, sb_v3(REAL(0.4 * to[0]), REAL(0.4 * to[1]), REAL(0.4 * to[2])));
        organ_view_cut(&view->mesh, view->camera, organ_point(o, aim), def->share);
    }
    if (!CHECK_OK(sb_mesh_copy(&view->mesh, NULL, &places, NULL)))
        return 0;
    for (int i = 0; i < view->mesh.node_count; i++)
        view->mesh.nodes[i] = sb_v3_add(organ_deform(o, places.nodes[i]), sb_v3(REAL(def->noise * organ_gauss(seed)),
                                                                                REAL(def->noise * organ_gauss(seed)),
                                                                                REAL(def->noise * organ_gauss(seed))));
    view->count = view->from_organ = view->mesh.node_count;
    room = (size_t)((1 + def->outliers + def->sheet) * view->count) + 1;
    view->points = (sb_vec3 *)malloc(room * sizeof(sb_vec3));
    view->normals = (sb_vec3 *)malloc(room * sizeof(sb_vec3));
    view->places = (sb_vec3 *)malloc(room * sizeof(sb_vec3));
    if (!CHECK(view->points && view->normals && view->places) ||
        !CHECK_OK(reg_cloud_from_mesh(&cloud, &view->mesh, NULL, NULL)))
        return 0;
    memcpy(view->points, cloud.points, (size_t)view->count * sizeof(sb_vec3));
    memcpy(view->normals, cloud.normals, (size_t)view->count * sizeof(sb_vec3));
    memcpy(view->places, places.nodes, (size_t)view->count * sizeof(sb_vec3));
    reg_cloud_free(&cloud);
    sb_mesh_free(&places);
    organ_view_add(seed, def, view->seen_from, view);
    organ_view_finish(def, view);
    return 1;
}

#endif /* ORGAN_VIEWS_H */
