/* picture.h: shaded pictures of surfaces as PNG files, for the examples. Needs softbody.h, libc and libm
 * only.
 *
 *     picture p;
 *     picture_begin(&p, 1280, 960);
 *     picture_add_surface(&p, &surface, nodal_values, 0, 2000);    coloured by value
 *     picture_add_capsule(&p, from, to, radius, grey);             a sphere or a rod
 *     picture_render(&p, 30, 25);                                  seen from azimuth and elevation, z is up
 *     picture_colour_bar(&p, "von Mises stress", "Pa", 0, 2000, highest);
 *     picture_text(&p, ...);
 *     result = picture_save_png(&p, "picture.png");
 *     picture_end(&p);
 *
 * How: triangles are collected; a depth map seen from the light tells what lies in shadow; the camera's
 * map tells which triangle each sample sees (PICTURE_SAMPLES^2 per pixel); each sample is shaded with
 * interpolated normals and values; what is drawn afterwards lies on top. Parallel projection, so that a
 * length bar holds everywhere. A call that runs out of memory marks the picture; later calls then do
 * nothing and picture_save_png says so. */
#ifndef PICTURE_H
#define PICTURE_H

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "softbody.h"

enum { PICTURE_OK = 0, PICTURE_NO_MEMORY = -1, PICTURE_NO_FILE = -2 };
enum { PICTURE_SAMPLES = 2, PICTURE_SHADOW_SIZE = 1024, PICTURE_TAPS = 48 };
typedef enum picture_align { PICTURE_LEFT = 0, PICTURE_CENTRE = 1, PICTURE_RIGHT = 2 } picture_align;

/* Always double: pictures look the same whatever sb_real is. */
typedef struct picture_vec {
    double x, y, z;
} picture_vec;

/* Linear light, 0 to 1. */
typedef struct picture_colour {
    double r, g, b;
} picture_colour;

typedef struct picture_triangle {
    picture_vec corner[3], normal[3];
    double value[3];       /* place on the colour map, may lie outside [0, 1] */
    picture_colour colour; /* used instead when is_plain */
    int is_plain;
} picture_triangle;

/* Parallel projection: pixel (x, y) = origin + scale * (right . p, -up . p), depth = toward . p. */
typedef struct picture_view {
    picture_vec right, up, toward;
    double scale, x, y; /* pixels per metre; pixel of the world's origin */
    int width, height;
} picture_view;

typedef struct picture {
    int width, height;
    float *pixels;                /* [height][width][3] linear light */
    float *shadow;                /* [PICTURE_SHADOW_SIZE squared] depth of what the light sees first */
    double taps[PICTURE_TAPS][2]; /* points spread evenly over the unit disc */
    picture_triangle *triangles;
    int count, capacity;
    picture_view camera, light;
    picture_vec low, high; /* box of the surfaces */
    double ground;         /* height of the ground, a little below the surfaces */
    int out_of_memory;
} picture;

/* ---- vectors and colours ------------------------------------------------------------------------ */

static inline picture_vec picture_v(double x, double y, double z)
{
    picture_vec v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}
static inline picture_vec picture_from(sb_vec3 v) { return picture_v((double)v.x, (double)v.y, (double)v.z); }
/* a + s b */
static inline picture_vec picture_madd(picture_vec a, double s, picture_vec b)
{
    return picture_v(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}
static inline double picture_dot(picture_vec a, picture_vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline picture_vec picture_cross(picture_vec a, picture_vec b)
{
    return picture_v(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
static inline picture_vec picture_unit(picture_vec a)
{
    double length = sqrt(picture_dot(a, a));
    return length > 0 ? picture_madd(picture_v(0, 0, 0), 1 / length, a) : picture_v(0, 0, 1);
}
/* Sum of three vectors with weights w. */
static inline picture_vec picture_mix(const picture_vec v[3], const double w[3])
{
    return picture_madd(picture_madd(picture_madd(picture_v(0, 0, 0), w[0], v[0]), w[1], v[1]), w[2], v[2]);
}
static inline double picture_clamp(double x, double low, double high)
{
    return x > low ? (x < high ? x : high) : low; /* NaN becomes low */
}
static inline picture_colour picture_rgb(double r, double g, double b)
{
    picture_colour c;
    c.r = r;
    c.g = g;
    c.b = b;
    return c;
}
static inline picture_colour picture_blend(picture_colour a, picture_colour b, double t)
{
    return picture_rgb(a.r + t * (b.r - a.r), a.g + t * (b.g - a.g), a.b + t * (b.b - a.b));
}
/* sRGB bytes, as web colours are written, to linear light and back. */
static inline double picture_to_linear(int byte)
{
    double s = byte / 255.0;
    return s <= 0.04045 ? s / 12.92 : pow((s + 0.055) / 1.055, 2.4);
}
static inline picture_colour picture_web(unsigned rgb)
{
    return picture_rgb(picture_to_linear((int)(rgb >> 16 & 255)), picture_to_linear((int)(rgb >> 8 & 255)),
                       picture_to_linear((int)(rgb & 255)));
}
static inline unsigned char picture_to_byte(double linear)
{
    double c = picture_clamp(linear, 0, 1);
    return (unsigned char)(255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * pow(c, 1 / 2.4) - 0.055) + 0.5);
}

/* The colour map: lightness falls evenly from sand to dark violet, so that order is read without the hue
 * too. It stays light over most of its length, since shading darkens it once more. */
static inline picture_colour picture_map(double t)
{
    static const unsigned stops[] = {0xf6ddc0, 0xf5bf8e, 0xf09b67, 0xe27356, 0xc74e57, 0xa03160, 0x701f62, 0x3f1654};
    const int last = (int)(sizeof stops / sizeof *stops) - 1;
    double place = picture_clamp(t, 0, 1) * last;
    int i = place < last ? (int)place : last - 1;
    return picture_blend(picture_web(stops[i]), picture_web(stops[i + 1]), place - i);
}

/* ---- collecting triangles ----------------------------------------------------------------------- */

/* Starts a picture of width x height pixels. */
static inline void picture_begin(picture *p, int width, int height)
{
    size_t values = 3 * (size_t)width * (size_t)height;
    memset(p, 0, sizeof *p);
    p->width = width;
    p->height = height;
    p->low = picture_v(1e300, 1e300, 1e300);
    p->high = picture_v(-1e300, -1e300, -1e300);
    p->pixels = (float *)calloc(values, sizeof(float));
    p->shadow = (float *)calloc((size_t)PICTURE_SHADOW_SIZE * PICTURE_SHADOW_SIZE, sizeof(float));
    p->out_of_memory = !p->pixels || !p->shadow;
}

/* Releases what the picture holds. */
static inline void picture_end(picture *p)
{
    free(p->pixels);
    free(p->shadow);
    free(p->triangles);
    memset(p, 0, sizeof *p);
}

/* A new triangle, or NULL when memory is out. */
static inline picture_triangle *picture_new_triangle(picture *p)
{
    if (p->count == p->capacity && !p->out_of_memory) {
        int capacity = p->capacity < 1 << 28 ? 2 * p->capacity + 1024 : 0;
        void *grown = capacity ? realloc(p->triangles, (size_t)capacity * sizeof *p->triangles) : NULL;
        p->out_of_memory = !grown;
        if (grown) {
            p->triangles = (picture_triangle *)grown;
            p->capacity = capacity;
        }
    }
    return p->out_of_memory ? NULL : &p->triangles[p->count++];
}

static inline void picture_grow_box(picture *p, picture_vec x)
{
    p->low = picture_v(fmin(p->low.x, x.x), fmin(p->low.y, x.y), fmin(p->low.z, x.z));
    p->high = picture_v(fmax(p->high.x, x.x), fmax(p->high.y, x.y), fmax(p->high.z, x.z));
}

/* The flat triangles an element is drawn as, as local node numbers; returns how many. */
static inline int picture_split(sb_element_type type, const int (**triangles)[3])
{
    static const int tri3[1][3] = {{0, 1, 2}}, quad4[2][3] = {{0, 1, 2}, {0, 2, 3}};
    static const int tri6[4][3] = {{0, 3, 5}, {3, 1, 4}, {5, 4, 2}, {3, 4, 5}};
    static const int quad8[6][3] = {{0, 4, 7}, {4, 1, 5}, {5, 2, 6}, {6, 3, 7}, {4, 5, 6}, {4, 6, 7}};
    static const int quad9[8][3] = {{0, 4, 8}, {4, 1, 8}, {1, 5, 8}, {5, 2, 8},
                                    {2, 6, 8}, {6, 3, 8}, {3, 7, 8}, {7, 0, 8}};
    switch (type) {
    case SB_TRI3: *triangles = tri3; return 1;
    case SB_TRI6: *triangles = tri6; return 4;
    case SB_QUAD4: *triangles = quad4; return 2;
    case SB_QUAD8: *triangles = quad8; return 6;
    case SB_QUAD9: *triangles = quad9; return 8;
    default: *triangles = tri3; return 0;
    }
}

/* Normal times twice the area. */
static inline picture_vec picture_face_normal(const picture_vec x[3])
{
    return picture_cross(picture_madd(x[1], -1, x[0]), picture_madd(x[2], -1, x[0]));
}

/* Adds the triangles of a surface without normals; nodes[3] of each go to `corners`. */
static inline void picture_add_faces(picture *p, const sb_mesh *surface, const sb_real *values, double low, double high,
                                     int *corners)
{
    const int(*split)[3];
    int pieces = picture_split(surface->element_type, &split);
    int nodes = sb_element_node_count(surface->element_type);
    for (int i = 0; i < surface->element_count * pieces; i++) {
        const int *element = surface->elements + (size_t)(i / pieces) * (size_t)nodes;
        picture_triangle *t = picture_new_triangle(p);
        if (!t)
            return;
        memset(t, 0, sizeof *t);
        for (int k = 0; k < 3; k++) {
            int node = element[split[i % pieces][k]];
            corners[3 * i + k] = node;
            t->corner[k] = picture_from(surface->nodes[node]);
            t->value[k] = ((double)values[node] - low) / (high > low ? high - low : 1);
            picture_grow_box(p, t->corner[k]);
        }
    }
}

/* Gives the triangles from `first` on the normals of their nodes, but keeps edges sharper than 40 degrees. */
static inline void picture_smooth(picture *p, int first, const int *corners, picture_vec *normals)
{
    for (int i = first; i < p->count; i++)
        for (int k = 0; k < 3; k++) {
            picture_vec *n = &normals[corners[3 * (i - first) + k]];
            *n = picture_madd(*n, 1, picture_face_normal(p->triangles[i].corner));
        }
    for (int i = first; i < p->count; i++) {
        picture_vec face = picture_unit(picture_face_normal(p->triangles[i].corner));
        for (int k = 0; k < 3; k++) {
            picture_vec smooth = picture_unit(normals[corners[3 * (i - first) + k]]);
            p->triangles[i].normal[k] = picture_dot(smooth, face) > 0.766 ? smooth : face;
        }
    }
}

/* Adds a surface (tri3, tri6, quad4, quad8 or quad9) coloured by values[node_count], from low to high along the colour
 * map. */
static inline void picture_add_surface(picture *p, const sb_mesh *surface, const sb_real *values, double low,
                                       double high)
{
    const int(*split)[3];
    int first = p->count;
    size_t triangles = (size_t)picture_split(surface->element_type, &split) * (size_t)surface->element_count;
    int *corners = (int *)calloc(3 * triangles + 1, sizeof *corners);
    picture_vec *normals = (picture_vec *)calloc((size_t)surface->node_count + 1, sizeof *normals);
    if (corners && normals) {
        picture_add_faces(p, surface, values, low, high, corners);
        if (!p->out_of_memory)
            picture_smooth(p, first, corners, normals);
    } else {
        p->out_of_memory = 1;
    }
    free(corners);
    free(normals);
}

/* ---- cutting open -------------------------------------------------------------------------------- */

/* What is kept lies where normal . x >= offset. */
typedef struct picture_plane {
    picture_vec normal; /* unit */
    double offset;      /* m */
} picture_plane;

static inline double picture_above(const picture_plane *plane, picture_vec x)
{
    return picture_dot(plane->normal, x) - plane->offset;
}

/* Corner k of `made`: a part s of the way from corner i of t to corner j. */
static inline void picture_set_between(picture_triangle *made, int k, const picture_triangle *t, int i, int j, double s)
{
    made->corner[k] = picture_madd(t->corner[i], s, picture_madd(t->corner[j], -1, t->corner[i]));
    made->normal[k] = picture_unit(picture_madd(t->normal[i], s, picture_madd(t->normal[j], -1, t->normal[i])));
    made->value[k] = t->value[i] + s * (t->value[j] - t->value[i]);
}

/* Appends what a plane leaves of a triangle: nothing, one triangle or two. */
static inline void picture_add_clipped(picture *p, picture_triangle t, const picture_plane *plane)
{
    picture_triangle corner[2]; /* those of the polygon, the fourth in the second */
    int count = 0;
    corner[0] = corner[1] = t;
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3;
        double a = picture_above(plane, t.corner[i]), b = picture_above(plane, t.corner[j]);
        if (a >= 0) {
            picture_set_between(&corner[count / 3], count % 3, &t, i, j, 0);
            count++;
        }
        if ((a >= 0) != (b >= 0)) {
            picture_set_between(&corner[count / 3], count % 3, &t, i, j, a / (a - b));
            count++;
        }
    }
    if (count == 4) { /* 0 1 2 and 3 0 2 */
        picture_set_between(&corner[1], 1, &corner[0], 0, 0, 0);
        picture_set_between(&corner[1], 2, &corner[0], 2, 2, 0);
    }
    for (int i = 0; i < (count > 0) + (count > 3); i++) {
        picture_triangle *made = picture_new_triangle(p);
        if (made)
            *made = corner[i];
    }
}

/* Takes away what lies before the plane of the triangles from `first` on. The ground stays where it is. */
static inline void picture_clip(picture *p, int first, picture_plane plane)
{
    int count = p->count;
    for (int i = first; i < count && !p->out_of_memory; i++)
        picture_add_clipped(p, p->triangles[i], &plane);
    memmove(p->triangles + first, p->triangles + count, (size_t)(p->count - count) * sizeof *p->triangles);
    p->count -= count - first;
}

/* One triangle of a section through a tet: its corners lie on the edges from kept[k] to gone[k]. */
static inline void picture_add_crossing(picture *p, const sb_mesh *mesh, const sb_real *values, double low, double high,
                                        const picture_plane *plane, const int kept[3], const int gone[3])
{
    picture_triangle *t = picture_new_triangle(p);
    if (!t)
        return;
    memset(t, 0, sizeof *t);
    for (int k = 0; k < 3; k++) {
        picture_vec from = picture_from(mesh->nodes[kept[k]]), to = picture_from(mesh->nodes[gone[k]]);
        double a = picture_above(plane, from), s = a / (a - picture_above(plane, to));
        double value = (double)values[kept[k]] + s * ((double)values[gone[k]] - (double)values[kept[k]]);
        t->corner[k] = picture_madd(from, s, picture_madd(to, -1, from));
        t->normal[k] = picture_madd(picture_v(0, 0, 0), -1, plane->normal);
        t->value[k] = (value - low) / (high > low ? high - low : 1);
        picture_grow_box(p, t->corner[k]);
    }
}

/* Adds the section of a mesh of tet4 by the plane, coloured by values[node_count] as picture_add_surface does: with it
 * a boundary that picture_clip has opened is closed again. */
static inline void picture_add_section(picture *p, const sb_mesh *mesh, const sb_real *values, double low, double high,
                                       picture_plane plane)
{
    for (int e = 0; e < mesh->element_count; e++) {
        const int *tet = mesh->elements + 4 * (size_t)e;
        int kept[4], gone[4], kept_count = 0, gone_count = 0;
        for (int k = 0; k < 4; k++)
            if (picture_above(&plane, picture_from(mesh->nodes[tet[k]])) >= 0)
                kept[kept_count++] = tet[k];
            else
                gone[gone_count++] = tet[k];
        if (kept_count == 0 || gone_count == 0)
            continue;
        for (int k = kept_count; k < 3; k++)
            kept[k] = kept[0];
        for (int k = gone_count; k < 3 && gone_count == 1; k++)
            gone[k] = gone[0];
        if (gone_count == 2) { /* a quadrilateral: edges 0-0, 0-1, 1-1, 1-0 */
            const int a[2][3] = {{kept[0], kept[0], kept[1]}, {kept[0], kept[1], kept[1]}};
            const int b[2][3] = {{gone[0], gone[1], gone[1]}, {gone[0], gone[1], gone[0]}};
            picture_add_crossing(p, mesh, values, low, high, &plane, a[0], b[0]);
            picture_add_crossing(p, mesh, values, low, high, &plane, a[1], b[1]);
        } else {
            picture_add_crossing(p, mesh, values, low, high, &plane, kept, gone);
        }
    }
}

/* ---- rods and blocks ---------------------------------------------------------------------------- */

/* Point and normal of a capsule; ring -RINGS is the pole at `from`, RINGS - 1 that at `to`. */
enum { PICTURE_RINGS = 16, PICTURE_SPOKES = 48 };
static inline picture_vec picture_capsule_normal(picture_vec axis, int ring, int spoke)
{
    const double pi = 3.14159265358979323846;
    picture_vec side = picture_unit(picture_cross(axis, fabs(axis.x) < 0.7 ? picture_v(1, 0, 0) : picture_v(0, 1, 0)));
    picture_vec other = picture_cross(axis, side);
    double latitude = pi / 2 * (ring < 0 ? ring + 1 : ring) / (double)(PICTURE_RINGS - 1);
    double longitude = 2 * pi * spoke / (double)PICTURE_SPOKES;
    picture_vec around = picture_madd(picture_madd(picture_v(0, 0, 0), cos(longitude), side), sin(longitude), other);
    return picture_madd(picture_madd(picture_v(0, 0, 0), sin(latitude), axis), cos(latitude), around);
}

/* Adds a rod with round ends from one point to another (m); a sphere when they are equal. */
static inline void picture_add_capsule(picture *p, sb_vec3 from, sb_vec3 to, double radius, picture_colour colour)
{
    picture_vec ends[2] = {picture_from(from), picture_from(to)};
    picture_vec axis = picture_unit(picture_madd(ends[1], -1, ends[0]));
    for (int cell = 0; cell < 2 * (2 * PICTURE_RINGS - 1) * PICTURE_SPOKES; cell++) {
        int ring = cell / 2 / PICTURE_SPOKES - PICTURE_RINGS, spoke = cell / 2 % PICTURE_SPOKES, upper = cell % 2;
        int rings[3] = {ring, upper ? ring + 1 : ring, ring + 1};
        int spokes[3] = {spoke, spoke + 1, upper ? spoke : spoke + 1};
        picture_triangle *t = picture_new_triangle(p);
        if (!t)
            return;
        memset(t, 0, sizeof *t);
        t->colour = colour;
        t->is_plain = 1;
        for (int k = 0; k < 3; k++) {
            t->normal[k] = picture_capsule_normal(axis, rings[k], spokes[k]);
            t->corner[k] = picture_madd(ends[rings[k] >= 0], radius, t->normal[k]);
        }
    }
}

/* Adds a box by its middle (m), turn and half extents (m). */
static inline void picture_add_block(picture *p, sb_vec3 middle, sb_quat turn, sb_vec3 half, picture_colour colour)
{
    static const int around[2][3] = {{0, 1, 2}, {0, 2, 3}}; /* corners of a face, counted from one to the next */
    for (int i = 0; i < 12; i++) {
        int axis = i / 4, sign = i / 2 % 2 ? 1 : -1;
        picture_triangle *t = picture_new_triangle(p);
        if (!t)
            return;
        memset(t, 0, sizeof *t);
        t->colour = colour;
        t->is_plain = 1;
        for (int k = 0; k < 3; k++) {
            int corner = around[i % 2][k];
            double at[3], normal[3] = {0, 0, 0};
            at[axis] = normal[axis] = sign;
            at[(axis + 1) % 3] = corner == 1 || corner == 2 ? 1 : -1;
            at[(axis + 2) % 3] = corner >= 2 ? 1 : -1;
            t->corner[k] = picture_from(
                sb_v3_add(middle, sb_quat_rotate(turn, sb_v3((sb_real)at[0] * half.x, (sb_real)at[1] * half.y,
                                                             (sb_real)at[2] * half.z))));
            t->normal[k] =
                picture_from(sb_quat_rotate(turn, sb_v3((sb_real)normal[0], (sb_real)normal[1], (sb_real)normal[2])));
        }
    }
}

/* ---- projecting --------------------------------------------------------------------------------- */

/* A view toward the viewer at azimuth (degrees from -y, the front, to +x) and elevation; not yet scaled. */
static inline picture_view picture_make_view(double azimuth, double elevation, int width, int height)
{
    const double degree = 3.14159265358979323846 / 180;
    double a = azimuth * degree, e = elevation * degree;
    picture_view v;
    memset(&v, 0, sizeof v);
    v.toward = picture_v(sin(a) * cos(e), -cos(a) * cos(e), sin(e));
    v.right = picture_v(cos(a), sin(a), 0);
    v.up = picture_cross(v.toward, v.right);
    v.scale = 1;
    v.width = width;
    v.height = height;
    return v;
}

static inline picture_vec picture_project(const picture_view *v, picture_vec x)
{
    return picture_v(v->x + v->scale * picture_dot(v->right, x), v->y - v->scale * picture_dot(v->up, x),
                     picture_dot(v->toward, x));
}

/* Scales and shifts a view so that the triangles fill the box of pixels x0 y0 x1 y1. */
static inline void picture_fit(const picture *p, picture_view *v, const double box[4])
{
    double least[2] = {1e300, 1e300}, most[2] = {-1e300, -1e300}, scale;
    for (int i = 0; i < 3 * p->count; i++) {
        picture_vec x = picture_project(v, p->triangles[i / 3].corner[i % 3]);
        least[0] = fmin(least[0], x.x), most[0] = fmax(most[0], x.x);
        least[1] = fmin(least[1], x.y), most[1] = fmax(most[1], x.y);
    }
    scale = fmin((box[2] - box[0]) / (most[0] - least[0]), (box[3] - box[1]) / (most[1] - least[1]));
    if (!(scale > 0 && scale < 1e300))
        return; /* nothing to see */
    v->scale = scale;
    v->x = 0.5 * (box[0] + box[2]) - 0.5 * scale * (least[0] + most[0]);
    v->y = 0.5 * (box[1] + box[3]) - 0.5 * scale * (least[1] + most[1]);
}

/* Weights of the corners a (projected) at a point of the view's plane. */
static inline void picture_weights(const picture_vec a[3], double x, double y, double w[3])
{
    double area = (a[1].x - a[0].x) * (a[2].y - a[0].y) - (a[2].x - a[0].x) * (a[1].y - a[0].y);
    w[1] = ((x - a[0].x) * (a[2].y - a[0].y) - (a[2].x - a[0].x) * (y - a[0].y)) / area;
    w[2] = ((a[1].x - a[0].x) * (y - a[0].y) - (x - a[0].x) * (a[1].y - a[0].y)) / area;
    w[0] = 1 - w[1] - w[2];
}

static inline int picture_first_pixel(double least) { return least > 0 ? (int)least : 0; }
static inline int picture_last_pixel(double most, int size) { return most < size - 1 ? (int)most : size - 1; }

/* Depth buffer of one triangle; ids (or NULL) receive `id` where it is in front. */
static inline void picture_rasterise(const picture_view *v, const picture_triangle *t, int id, float *depth, int *ids)
{
    picture_vec a[3];
    for (int k = 0; k < 3; k++)
        a[k] = picture_project(v, t->corner[k]);
    int x0 = picture_first_pixel(fmin(a[0].x, fmin(a[1].x, a[2].x)) - 1);
    int x1 = picture_last_pixel(fmax(a[0].x, fmax(a[1].x, a[2].x)), v->width);
    int y0 = picture_first_pixel(fmin(a[0].y, fmin(a[1].y, a[2].y)) - 1);
    int y1 = picture_last_pixel(fmax(a[0].y, fmax(a[1].y, a[2].y)), v->height);
    for (int y = y0; y <= y1; y++)
        for (int x = x0; x <= x1; x++) {
            double w[3], z;
            size_t pixel = (size_t)y * (size_t)v->width + (size_t)x;
            picture_weights(a, x + 0.5, y + 0.5, w);
            z = w[0] * a[0].z + w[1] * a[1].z + w[2] * a[2].z;
            if (!(w[0] >= 0 && w[1] >= 0 && w[2] >= 0) || (double)depth[pixel] >= z)
                continue;
            depth[pixel] = (float)z;
            if (ids)
                ids[pixel] = id;
        }
}

/* ---- light -------------------------------------------------------------------------------------- */

/* Fills a disc evenly: each point turns on by the golden angle, so no two lie on one line with an edge. */
static inline void picture_spread_taps(picture *p)
{
    const double golden_angle = 2.39996322972865332;
    for (int i = 0; i < PICTURE_TAPS; i++) {
        double radius = sqrt((i + 0.5) / (double)PICTURE_TAPS);
        p->taps[i][0] = radius * cos(golden_angle * i);
        p->taps[i][1] = radius * sin(golden_angle * i);
    }
}

/* Share of the light that reaches a point, averaged over a disc of the shadow map (radius in its pixels)
 * for a soft edge. */
static inline double picture_lit(const picture *p, picture_vec x, double radius)
{
    const int size = PICTURE_SHADOW_SIZE;
    picture_vec a = picture_project(&p->light, x);
    double depth = a.z + radius / p->light.scale; /* a slope must not shade itself within the disc */
    int lit = 0;
    for (int i = 0; i < PICTURE_TAPS; i++) {
        double column = a.x + radius * p->taps[i][0], row = a.y + radius * p->taps[i][1];
        int inside = column >= 0 && row >= 0 && column < size && row < size;
        lit += !inside || (double)p->shadow[(int)row * size + (int)column] <= depth;
    }
    return lit / (double)PICTURE_TAPS;
}

/* What the camera sees of triangle t at sample (x, y): soft key light with shadow, light from sky and
 * ground, a highlight as on something moist. */
static inline picture_colour picture_shade(const picture *p, const picture_view *view, const picture_triangle *t,
                                           double x, double y)
{
    picture_vec a[3], n, halfway;
    double w[3], key, sky, gloss, light;
    for (int k = 0; k < 3; k++)
        a[k] = picture_project(view, t->corner[k]);
    picture_weights(a, x, y, w);
    n = picture_unit(picture_mix(t->normal, w));
    if (picture_dot(n, view->toward) < 0)
        n = picture_madd(picture_v(0, 0, 0), -1, n);
    halfway = picture_unit(picture_madd(view->toward, 1, p->light.toward));
    key = picture_clamp((picture_dot(n, p->light.toward) + 0.1) / 1.1, 0, 1);
    if (key > 0)
        key *= picture_lit(p, picture_madd(picture_mix(t->corner, w), 3 / p->light.scale, n), 5);
    sky = 0.5 + 0.5 * n.z;
    gloss = key * 0.1 * pow(picture_clamp(picture_dot(n, halfway), 0, 1), 36);
    light = 0.24 + 0.2 * sky + 0.14 * picture_clamp(picture_dot(n, view->toward), 0, 1) + 0.62 * key;
    picture_colour base =
        t->is_plain ? t->colour : picture_map(w[0] * t->value[0] + w[1] * t->value[1] + w[2] * t->value[2]);
    return picture_rgb(light * base.r + gloss, light * base.g + gloss, light * base.b + gloss);
}

/* What lies behind everything: a light backdrop that fades downward, and the shadow on the ground. */
static inline picture_colour picture_backdrop(const picture *p, double x, double y)
{
    const picture_view *c = &p->camera;
    picture_colour colour = picture_blend(picture_web(0xf7f9fb), picture_web(0xdde4ea), y / p->height);
    picture_vec on_plane =
        picture_madd(picture_madd(picture_v(0, 0, 0), (x - c->x) / c->scale, c->right), (c->y - y) / c->scale, c->up);
    double shade;
    if (c->toward.z < 0.05)
        return colour; /* the ground is seen edge-on */
    shade = 1 - picture_lit(p, picture_madd(on_plane, (p->ground - on_plane.z) / c->toward.z, c->toward), 24);
    return picture_blend(colour, picture_web(0x8e9aa8), 0.75 * shade);
}

/* ---- rendering ---------------------------------------------------------------------------------- */

static inline void picture_clear_depth(float *depth, size_t count)
{
    for (size_t i = 0; i < count; i++)
        depth[i] = -FLT_MAX;
}

/* The light stands to the upper left of the camera; its map covers all triangles. */
static inline void picture_cast_shadows(picture *p, double azimuth)
{
    const double all[4] = {20, 20, PICTURE_SHADOW_SIZE - 20, PICTURE_SHADOW_SIZE - 20};
    picture_spread_taps(p);
    p->light = picture_make_view(azimuth - 35, 58, PICTURE_SHADOW_SIZE, PICTURE_SHADOW_SIZE);
    picture_fit(p, &p->light, all);
    picture_clear_depth(p->shadow, (size_t)PICTURE_SHADOW_SIZE * PICTURE_SHADOW_SIZE);
    for (int i = 0; i < p->count; i++)
        picture_rasterise(&p->light, &p->triangles[i], i, p->shadow, NULL);
}

/* Mean of the samples of a pixel. */
static inline picture_colour picture_resolve(const picture *p, const picture_view *fine, const int *ids, int x, int y)
{
    picture_colour sum = picture_rgb(0, 0, 0), backdrop = sum;
    int empty = 0;
    for (int s = 0; s < PICTURE_SAMPLES * PICTURE_SAMPLES; s++) {
        int column = PICTURE_SAMPLES * x + s % PICTURE_SAMPLES, row = PICTURE_SAMPLES * y + s / PICTURE_SAMPLES;
        int id = ids[(size_t)row * (size_t)fine->width + (size_t)column];
        if (id < 0) {
            empty++;
            continue;
        }
        picture_colour c = picture_shade(p, fine, &p->triangles[id], column + 0.5, row + 0.5);
        sum = picture_rgb(sum.r + c.r, sum.g + c.g, sum.b + c.b);
    }
    if (empty)
        backdrop = picture_backdrop(p, x + 0.5, y + 0.5);
    const double share = 1.0 / (PICTURE_SAMPLES * PICTURE_SAMPLES);
    return picture_rgb(share * (sum.r + empty * backdrop.r), share * (sum.g + empty * backdrop.g),
                       share * (sum.b + empty * backdrop.b));
}

static inline void picture_put(picture *p, int x, int y, picture_colour c)
{
    float *pixel = p->pixels + 3 * ((size_t)y * (size_t)p->width + (size_t)x);
    pixel[0] = (float)c.r;
    pixel[1] = (float)c.g;
    pixel[2] = (float)c.b;
}

/* Draws the triangles seen from azimuth (degrees, 0 is the front -y, 90 is +x) and elevation (0 level, 90
 * above); leaves room for a title above, a colour bar to the right and a length bar below. */
static inline void picture_render(picture *p, double azimuth, double elevation)
{
    const double frame[4] = {0.06 * p->width, 0.16 * p->height, 0.83 * p->width, 0.89 * p->height};
    size_t samples = (size_t)p->width * (size_t)p->height * PICTURE_SAMPLES * PICTURE_SAMPLES;
    float *depth = (float *)malloc(samples * sizeof *depth);
    int *ids = (int *)malloc(samples * sizeof *ids);
    p->out_of_memory |= !depth || !ids;
    if (!p->out_of_memory) {
        picture_view fine;
        p->ground = p->low.z - 0.02 * (p->high.z - p->low.z);
        p->camera = picture_make_view(azimuth, elevation, p->width, p->height);
        picture_fit(p, &p->camera, frame);
        picture_cast_shadows(p, azimuth);
        fine = p->camera;
        fine.width *= PICTURE_SAMPLES, fine.height *= PICTURE_SAMPLES;
        fine.scale *= (double)PICTURE_SAMPLES, fine.x *= (double)PICTURE_SAMPLES, fine.y *= (double)PICTURE_SAMPLES;
        picture_clear_depth(depth, samples);
        memset(ids, -1, samples * sizeof *ids);
        for (int i = 0; i < p->count; i++)
            picture_rasterise(&fine, &p->triangles[i], i, depth, ids);
        for (int y = 0; y < p->height; y++)
            for (int x = 0; x < p->width; x++)
                picture_put(p, x, y, picture_resolve(p, &fine, ids, x, y));
    }
    free(depth);
    free(ids);
}

/* ---- drawing on top ----------------------------------------------------------------------------- */

/* Lays a colour over a pixel with opacity alpha; outside the picture nothing happens. */
static inline void picture_over(picture *p, int x, int y, picture_colour colour, double alpha)
{
    if (p->out_of_memory || x < 0 || y < 0 || x >= p->width || y >= p->height || alpha <= 0)
        return;
    const float *pixel = p->pixels + 3 * ((size_t)y * (size_t)p->width + (size_t)x);
    picture_colour below = picture_rgb((double)pixel[0], (double)pixel[1], (double)pixel[2]);
    picture_put(p, x, y, picture_blend(below, colour, alpha));
}

/* Filled box from corner (x0, y0) to (x1, y1) in pixels; fractions of pixels are blended. */
static inline void picture_box(picture *p, double x0, double y0, double x1, double y1, picture_colour colour)
{
    for (int y = (int)floor(y0); y < y1; y++)
        for (int x = (int)floor(x0); x < x1; x++) {
            double wide = fmin(x1, x + 1) - fmax(x0, x), high = fmin(y1, y + 1) - fmax(y0, y);
            picture_over(p, x, y, colour, wide * high);
        }
}

/* A 5 x 9 font (rows 7 and 8 lie below the line): a column per number, the top row in bit 0, from '!' to
 * '~'. */
static inline const unsigned short *picture_glyph(int character)
{
    static const unsigned short font[94][5] = {
        {0x05f, 0x000, 0x000, 0x000, 0x000}, {0x007, 0x000, 0x007, 0x000, 0x000}, {0x014, 0x07f, 0x014, 0x07f, 0x014},
        {0x024, 0x02a, 0x07f, 0x02a, 0x012}, {0x023, 0x013, 0x008, 0x064, 0x062}, {0x036, 0x049, 0x055, 0x022, 0x050},
        {0x007, 0x000, 0x000, 0x000, 0x000}, {0x01c, 0x022, 0x041, 0x000, 0x000}, {0x041, 0x022, 0x01c, 0x000, 0x000},
        {0x014, 0x008, 0x03e, 0x008, 0x014}, {0x008, 0x008, 0x03e, 0x008, 0x008}, {0x080, 0x060, 0x000, 0x000, 0x000},
        {0x008, 0x008, 0x008, 0x008, 0x000}, {0x040, 0x000, 0x000, 0x000, 0x000}, {0x060, 0x010, 0x008, 0x004, 0x003},
        {0x03e, 0x041, 0x041, 0x03e, 0x000}, {0x044, 0x042, 0x07f, 0x040, 0x040}, {0x042, 0x061, 0x051, 0x049, 0x046},
        {0x022, 0x041, 0x049, 0x049, 0x036}, {0x018, 0x014, 0x012, 0x07f, 0x010}, {0x027, 0x045, 0x045, 0x045, 0x039},
        {0x03c, 0x04a, 0x049, 0x049, 0x030}, {0x001, 0x061, 0x019, 0x005, 0x003}, {0x036, 0x049, 0x049, 0x049, 0x036},
        {0x006, 0x049, 0x049, 0x029, 0x01e}, {0x044, 0x000, 0x000, 0x000, 0x000}, {0x080, 0x064, 0x000, 0x000, 0x000},
        {0x008, 0x014, 0x022, 0x041, 0x000}, {0x014, 0x014, 0x014, 0x014, 0x000}, {0x041, 0x022, 0x014, 0x008, 0x000},
        {0x002, 0x001, 0x051, 0x009, 0x006}, {0x03e, 0x041, 0x05d, 0x055, 0x01e}, {0x07c, 0x012, 0x011, 0x012, 0x07c},
        {0x07f, 0x049, 0x049, 0x049, 0x036}, {0x03e, 0x041, 0x041, 0x041, 0x022}, {0x07f, 0x041, 0x041, 0x041, 0x03e},
        {0x07f, 0x049, 0x049, 0x049, 0x041}, {0x07f, 0x009, 0x009, 0x009, 0x001}, {0x03e, 0x041, 0x041, 0x049, 0x03a},
        {0x07f, 0x008, 0x008, 0x008, 0x07f}, {0x041, 0x07f, 0x041, 0x000, 0x000}, {0x020, 0x040, 0x040, 0x03f, 0x000},
        {0x07f, 0x008, 0x014, 0x022, 0x041}, {0x07f, 0x040, 0x040, 0x040, 0x040}, {0x07f, 0x002, 0x00c, 0x002, 0x07f},
        {0x07f, 0x006, 0x008, 0x030, 0x07f}, {0x03e, 0x041, 0x041, 0x041, 0x03e}, {0x07f, 0x009, 0x009, 0x009, 0x006},
        {0x03e, 0x041, 0x051, 0x021, 0x05e}, {0x07f, 0x009, 0x019, 0x029, 0x046}, {0x046, 0x049, 0x049, 0x049, 0x031},
        {0x001, 0x001, 0x07f, 0x001, 0x001}, {0x03f, 0x040, 0x040, 0x040, 0x03f}, {0x01f, 0x020, 0x040, 0x020, 0x01f},
        {0x03f, 0x040, 0x038, 0x040, 0x03f}, {0x063, 0x014, 0x008, 0x014, 0x063}, {0x003, 0x004, 0x078, 0x004, 0x003},
        {0x061, 0x051, 0x049, 0x045, 0x043}, {0x07f, 0x041, 0x000, 0x000, 0x000}, {0x003, 0x004, 0x008, 0x010, 0x060},
        {0x041, 0x07f, 0x000, 0x000, 0x000}, {0x004, 0x002, 0x001, 0x002, 0x004}, {0x080, 0x080, 0x080, 0x080, 0x080},
        {0x001, 0x002, 0x000, 0x000, 0x000}, {0x020, 0x054, 0x054, 0x054, 0x078}, {0x07f, 0x044, 0x044, 0x044, 0x038},
        {0x038, 0x044, 0x044, 0x044, 0x000}, {0x038, 0x044, 0x044, 0x044, 0x07f}, {0x038, 0x054, 0x054, 0x054, 0x018},
        {0x004, 0x07e, 0x005, 0x005, 0x000}, {0x038, 0x144, 0x144, 0x144, 0x0fc}, {0x07f, 0x004, 0x004, 0x004, 0x078},
        {0x07d, 0x000, 0x000, 0x000, 0x000}, {0x100, 0x0fd, 0x000, 0x000, 0x000}, {0x07f, 0x010, 0x028, 0x044, 0x000},
        {0x03f, 0x040, 0x000, 0x000, 0x000}, {0x07c, 0x004, 0x07c, 0x004, 0x078}, {0x07c, 0x004, 0x004, 0x004, 0x078},
        {0x038, 0x044, 0x044, 0x044, 0x038}, {0x1fc, 0x044, 0x044, 0x044, 0x038}, {0x038, 0x044, 0x044, 0x044, 0x1fc},
        {0x07c, 0x008, 0x004, 0x004, 0x000}, {0x048, 0x054, 0x054, 0x054, 0x024}, {0x004, 0x03f, 0x044, 0x044, 0x000},
        {0x03c, 0x040, 0x040, 0x040, 0x07c}, {0x01c, 0x020, 0x040, 0x020, 0x01c}, {0x03c, 0x040, 0x038, 0x040, 0x03c},
        {0x044, 0x028, 0x010, 0x028, 0x044}, {0x03c, 0x140, 0x140, 0x140, 0x0fc}, {0x044, 0x064, 0x054, 0x04c, 0x044},
        {0x008, 0x036, 0x041, 0x000, 0x000}, {0x07f, 0x000, 0x000, 0x000, 0x000}, {0x041, 0x036, 0x008, 0x000, 0x000},
        {0x008, 0x004, 0x008, 0x008, 0x004}};
    static const unsigned short blank[5] = {0, 0, 0, 0, 0};
    return character > ' ' && character <= '~' ? font[character - '!'] : blank;
}
static inline int picture_glyph_dot(const unsigned short *glyph, int column, int row)
{
    return column >= 0 && column < 5 && row >= 0 && row < 9 && (glyph[column] >> row & 1);
}
/* Columns a character takes, with the gap after it. */
static inline int picture_glyph_width(int character)
{
    const unsigned short *glyph = picture_glyph(character);
    int width = character == ' ' ? 2 : 5;
    while (width > 1 && character != ' ' && !glyph[width - 1])
        width--;
    return width + 2;
}

/* Distance of a point from the strokes between neighbouring dots of a glyph, in dots: dots side by side
 * are joined, diagonal ones where no other dot joins them already. */
static inline double picture_glyph_distance(const unsigned short *glyph, double x, double y)
{
    static const int steps[4][2] = {{1, 0}, {0, 1}, {1, 1}, {-1, 1}};
    double least = 1e9;
    for (int dot = 0; dot < 45; dot++) {
        int column = dot % 5, row = dot / 5;
        if (!picture_glyph_dot(glyph, column, row))
            continue;
        least = fmin(least, hypot(x - column, y - row));
        for (int s = 0; s < 4; s++) {
            int dx = steps[s][0], dy = steps[s][1];
            int joined =
                dx && dy && (picture_glyph_dot(glyph, column + dx, row) || picture_glyph_dot(glyph, column, row + dy));
            if (joined || !picture_glyph_dot(glyph, column + dx, row + dy))
                continue;
            double along = picture_clamp(((x - column) * dx + (y - row) * dy) / (dx * dx + dy * dy), 0, 1);
            least = fmin(least, hypot(x - column - along * dx, y - row - along * dy));
        }
    }
    return least;
}

/* Width of a text in pixels. */
static inline double picture_text_width(const char *text, double height)
{
    int columns = -2;
    for (; *text; text++)
        columns += picture_glyph_width((unsigned char)*text);
    return columns * height / 6;
}

/* Text whose capitals are `height` pixels high, standing on y, aligned at x; what is not ASCII stays
 * blank. */
static inline void picture_text(picture *p, double x, double y, double height, picture_align align,
                                picture_colour colour, const char *text)
{
    double dot = height / 6, stroke = 0.5 * fmax(0.75 * dot, 1.25);
    x -= 0.5 * (double)align * picture_text_width(text, height);
    for (; *text; text++) {
        const unsigned short *glyph = picture_glyph((unsigned char)*text);
        for (int row = (int)(y - 8 * dot); row < y + 4 * dot; row++)
            for (int column = (int)(x - 2 * dot); column < x + 6 * dot; column++) {
                double distance = picture_glyph_distance(glyph, (column + 0.5 - x) / dot, (row + 0.5 - y) / dot + 6);
                picture_over(p, column, row, colour, picture_clamp(0.5 + stroke - dot * distance, 0, 1));
            }
        x += dot * picture_glyph_width((unsigned char)*text);
    }
}

static inline picture_colour picture_ink(void) { return picture_web(0x2c3440); }

/* Largest 1, 2 or 5 times a power of ten that is at most x > 0. */
static inline double picture_round_down(double x)
{
    double power = pow(10, floor(log10(x)));
    return x >= 5 * power ? 5 * power : (x >= 2 * power ? 2 * power : power);
}

/* A bar of the colour map at the right edge with numbers from low to high; `highest` is the largest value
 * there is: when the map ends below it, the bar ends in a tip that says so. */
static inline void picture_colour_bar(picture *p, const char *name, const char *unit, double low, double high,
                                      double highest)
{
    double text = p->height / 64.0, left = floor(0.895 * p->width), right = left + floor(0.02 * p->width);
    double top = floor(0.28 * p->height), bottom = floor(0.8 * p->height);
    double step = high > low ? picture_round_down((high - low) / 3) : 1;
    char label[64];
    for (int y = (int)top; y < bottom; y++)
        picture_box(p, left, fmax(y, top), right, fmin(y + 1, bottom),
                    picture_map((bottom - y - 0.5) / (bottom - top)));
    for (int i = 0; highest > high && i < right - left; i++) /* rows of the tip, narrower upward */
        picture_box(p, left + 0.5 * i, top - i - 1, right - 0.5 * i, top - i, picture_map(1));
    for (double value = low; value <= high + 1e-6 * step; value += step) {
        double y = bottom - (high > low ? (value - low) / (high - low) : 0) * (bottom - top);
        picture_box(p, right, y - 0.75, right + 0.4 * text, y + 0.75, picture_ink());
        snprintf(label, sizeof label, "%.6g", fabs(value) < 1e-9 * step ? 0 : value);
        picture_text(p, right + 0.9 * text, y + 0.5 * text, text, PICTURE_LEFT, picture_ink(), label);
    }
    picture_text(p, 0.97 * p->width, top - 4.5 * text, text, PICTURE_RIGHT, picture_ink(), name);
    snprintf(label, sizeof label, "in %s", unit);
    picture_text(p, 0.97 * p->width, top - 2.5 * text, text, PICTURE_RIGHT, picture_ink(), label);
    snprintf(label, sizeof label, "highest %.3g %s", highest, unit);
    picture_text(p, 0.97 * p->width, bottom + 3 * text, text, PICTURE_RIGHT, picture_ink(), label);
}

/* A bar of a round length at the lower left. */
static inline void picture_length_bar(picture *p)
{
    double text = p->height / 64.0, x = 0.06 * p->width, y = 0.945 * p->height;
    double metres = picture_round_down(0.2 * p->width / p->camera.scale), width = metres * p->camera.scale;
    const char *unit = metres >= 1 ? "m" : (metres >= 1e-3 ? "mm" : "um");
    char label[64];
    snprintf(label, sizeof label, "%.6g %s", metres * (metres >= 1 ? 1 : (metres >= 1e-3 ? 1e3 : 1e6)), unit);
    picture_box(p, x, y - 1, x + width, y + 1, picture_ink());
    picture_box(p, x - 1, y - 0.5 * text, x + 1, y + 0.5 * text, picture_ink());
    picture_box(p, x + width - 1, y - 0.5 * text, x + width + 1, y + 0.5 * text, picture_ink());
    picture_text(p, x + 0.5 * width, y - 0.7 * text, text, PICTURE_CENTRE, picture_ink(), label);
}

/* ---- PNG ---------------------------------------------------------------------------------------- */

/* Bits of a deflate stream (RFC 1951), lowest first, in a buffer that is large enough. */
typedef struct picture_bits {
    unsigned char *out;
    size_t size;
    unsigned buffer;
    int count;
} picture_bits;

static inline void picture_write_bits(picture_bits *b, unsigned value, int count)
{
    b->buffer |= value << b->count;
    for (b->count += count; b->count >= 8; b->count -= 8) {
        b->out[b->size++] = (unsigned char)(b->buffer & 255);
        b->buffer >>= 8;
    }
}
/* Huffman codes are written from their highest bit. */
static inline void picture_write_code(picture_bits *b, unsigned code, int count)
{
    while (count-- > 0)
        picture_write_bits(b, code >> count & 1, 1);
}
/* Literal or length symbol of the fixed code (RFC 1951, 3.2.6). */
static inline void picture_write_symbol(picture_bits *b, unsigned symbol)
{
    if (symbol < 144)
        picture_write_code(b, 0x30 + symbol, 8);
    else if (symbol < 256)
        picture_write_code(b, 0x190 + symbol - 144, 9);
    else if (symbol < 280)
        picture_write_code(b, symbol - 256, 7);
    else
        picture_write_code(b, 0xc0 + symbol - 280, 8);
}
/* Repeat `length` (3 to 258) bytes from `distance` (1 to 32768) back. Symbols double their range every
 * `per` codes. */
static inline void picture_write_match(picture_bits *b, unsigned length, unsigned distance)
{
    unsigned extra = 0, offset = length - 3;
    while (offset >> extra >= 8)
        extra++;
    if (length == 258)
        picture_write_symbol(b, 285);
    else {
        picture_write_symbol(b, 257 + 4 * extra + (offset >> extra));
        picture_write_bits(b, offset & ((1u << extra) - 1), (int)extra);
    }
    extra = 0, offset = distance - 1;
    while (offset >> extra >= 4)
        extra++;
    picture_write_code(b, 2 * extra + (offset >> extra), 5);
    picture_write_bits(b, offset & ((1u << extra) - 1), (int)extra);
}

static inline size_t picture_match_length(const unsigned char *a, const unsigned char *b, size_t most)
{
    size_t n = 0;
    while (n < most && a[n] == b[n])
        n++;
    return n;
}

/* zlib stream (RFC 1950) of data[size]; `out` holds 2 * size + 64 bytes. Returns its size. */
static inline size_t picture_deflate(const unsigned char *data, size_t size, unsigned char *out)
{
    enum { HASH_BITS = 14 };
    static const size_t none = (size_t)-1;
    size_t last[1 << HASH_BITS];
    unsigned s1 = 1, s2 = 0;
    picture_bits b = {out, 0, 0, 0};
    for (size_t i = 0; i < sizeof last / sizeof *last; i++)
        last[i] = none;
    picture_write_bits(&b, 0x0178, 16); /* method 8, window 32 kB, no dictionary: bytes 78 01 */
    picture_write_bits(&b, 3, 3);       /* last block, fixed codes */
    for (size_t i = 0; i < size;) {
        size_t length = 0, before = none;
        if (i + 4 <= size) {
            unsigned key = (unsigned)data[i] | (unsigned)data[i + 1] << 8 | (unsigned)data[i + 2] << 16;
            size_t *slot = &last[(key * 2654435761u & 0xffffffffu) >> (32 - HASH_BITS)];
            before = *slot;
            *slot = i;
            if (before != none && i - before <= 32768)
                length = picture_match_length(data + before, data + i, size - i < 258 ? size - i : 258);
        }
        if (length >= 4)
            picture_write_match(&b, (unsigned)length, (unsigned)(i - before));
        else
            picture_write_symbol(&b, data[i]);
        i += length >= 4 ? length : 1;
    }
    picture_write_symbol(&b, 256);
    picture_write_bits(&b, 0, 7 & -b.count);
    for (size_t i = 0; i < size; i++) { /* Adler-32 */
        s1 = (s1 + data[i]) % 65521;
        s2 = (s2 + s1) % 65521;
    }
    for (int i = 0; i < 4; i++)
        out[b.size++] = (unsigned char)((i < 2 ? s2 : s1) >> (i % 2 ? 0 : 8) & 255);
    return b.size;
}

static inline void picture_put_be32(unsigned char *out, unsigned value)
{
    for (int i = 0; i < 4; i++)
        out[i] = (unsigned char)(value >> (24 - 8 * i) & 255);
}

/* Writes a chunk: length, four letters, data, CRC-32 of letters and data. */
static inline void picture_write_chunk(FILE *file, const char *letters, const unsigned char *data, size_t size)
{
    unsigned char head[8], tail[4];
    unsigned crc = 0xffffffffu;
    picture_put_be32(head, (unsigned)size);
    memcpy(head + 4, letters, 4);
    for (size_t i = 0; i < size + 4; i++) {
        crc ^= i < 4 ? head[4 + i] : data[i - 4];
        for (int bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (0xedb88320u & (0u - (crc & 1)));
    }
    picture_put_be32(tail, crc ^ 0xffffffffu);
    fwrite(head, 1, 8, file);
    fwrite(data, 1, size, file);
    fwrite(tail, 1, 4, file);
}

/* Rows of sRGB bytes, each after its filter byte: differences from the row above compress well here. */
static inline void picture_fill_rows(const picture *p, unsigned char *rows)
{
    size_t row_size = 1 + 3 * (size_t)p->width;
    for (int y = p->height - 1; y >= 0; y--) {
        unsigned char *row = rows + (size_t)y * row_size;
        const float *pixel = p->pixels + (row_size - 1) * (size_t)y;
        row[0] = 2; /* filter "up" */
        for (size_t i = 0; i + 1 < row_size; i++)
            row[1 + i] = picture_to_byte((double)pixel[i]);
    }
    for (int y = p->height - 1; y > 0; y--)
        for (size_t i = 1; i < row_size; i++) {
            unsigned char *byte = rows + (size_t)y * row_size + i;
            *byte = (unsigned char)(*byte - *(byte - row_size));
        }
}

/* Writes the picture as an 8-bit RGB PNG. Returns PICTURE_OK, PICTURE_NO_MEMORY (here or in an earlier
 * call) or PICTURE_NO_FILE; then a file that was there is what it was. */
static inline int picture_save_png(const picture *p, const char *path)
{
    size_t size = (1 + 3 * (size_t)p->width) * (size_t)p->height, packed = 0;
    unsigned char *rows = (unsigned char *)malloc(size), *stream = (unsigned char *)malloc(2 * size + 64);
    unsigned char header[13] = {0, 0, 0, 0, 0, 0, 0, 0, 8, 2, 0, 0, 0}; /* 8 bits per channel, RGB */
    int result = p->out_of_memory || !rows || !stream ? PICTURE_NO_MEMORY : PICTURE_OK;
    if (result == PICTURE_OK) {
        sb_output out;
        picture_put_be32(header, (unsigned)p->width);
        picture_put_be32(header + 4, (unsigned)p->height);
        picture_fill_rows(p, rows);
        packed = picture_deflate(rows, size, stream);
        result = sb_output_open(&out, path, NULL) == SB_OK ? PICTURE_OK : PICTURE_NO_FILE;
        if (result == PICTURE_OK) {
            fwrite("\x89PNG\r\n\x1a\n", 1, 8, out.file);
            picture_write_chunk(out.file, "IHDR", header, sizeof header);
            picture_write_chunk(out.file, "IDAT", stream, packed);
            picture_write_chunk(out.file, "IEND", header, 0);
            result = sb_output_close(&out, NULL) == SB_OK ? PICTURE_OK : PICTURE_NO_FILE;
        }
    }
    free(rows);
    free(stream);
    return result;
}

#endif /* PICTURE_H */
