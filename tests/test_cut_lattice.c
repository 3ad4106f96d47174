/* Lattices that cuts part tets by: their tables, exact crossings, and the shapes of pieces, against planes,
 * polynomials, long double and random blades. They are internal. */
#define SB_SPLIT_BUILD
#include <float.h>
#include <limits.h>

#include "../src/softbody/cut/crossing.h"
#include "../src/softbody/cut/parted.h"
#include "../src/softbody/fem/piece.h"

#include "check.h"
#include "scene.h"

static const int intervals_of[3] = {1, 2, 4};

/* ---- a mesh that is cut at rest ---------------------------------------------------------------------------------- */

typedef struct cut_world {
    sb_mesh mesh;
    sbi_lattice lattice;
    sbi_crossing_frame frame;
    sbi_cut_links links;
    sb_index_table neighbours;
    int parts;
    int *part_of;        /* [tets][35] part of each tet's piece */
    sbi_parted *parted;  /* [tets] */
    double volumes[256]; /* of the parts */
} cut_world;

static void world_reserve(cut_world *w, int more)
{
    sbi_cut_links *links = &w->links;
    sbi_cut_link *items = links->items;
    int *table = links->table, capacity = 2 * (links->count + more);
    if (links->count + more <= links->capacity)
        return;
    sbi_cut_links_move(links, (sbi_cut_link *)calloc((size_t)capacity, sizeof *items),
                       (int *)calloc((size_t)sbi_cut_links_table(capacity), sizeof(int)), capacity);
    free(items);
    free(table);
}

static cut_world world_of(sb_mesh mesh, int intervals)
{
    cut_world w;
    sb_vec3 low, high;
    memset(&w, 0, sizeof w);
    w.mesh = mesh;
    sbi_lattice_make(intervals, &w.lattice);
    sb_mesh_bounds(&mesh, &low, &high);
    sbi_crossing_frame_make(low, high, &w.frame);
    CHECK_OK(sb_mesh_neighbours(&mesh, NULL, &w.neighbours, NULL));
    w.part_of = (int *)calloc((size_t)mesh.element_count * SBI_LATTICE_POINTS, sizeof(int));
    w.parted = (sbi_parted *)calloc((size_t)mesh.element_count, sizeof(sbi_parted));
    world_reserve(&w, 64);
    return w;
}

static void world_free(cut_world *w)
{
    free(w->links.items);
    free(w->links.table);
    free(w->part_of);
    free(w->parted);
    sb_index_table_free(&w->neighbours);
    sb_mesh_free(&w->mesh);
}

static void world_corners(const cut_world *w, int e, sb_vec3 x[4])
{
    for (int a = 0; a < 4; a++)
        x[a] = w->mesh.nodes[w->mesh.elements[4 * e + a]];
}

/* The box of places. */
static void box_of(const sbi_int3 *points, int count, sbi_int3 *low, sbi_int3 *high)
{
    *low = *high = points[0];
    for (int p = 1; p < count; p++) {
        low->x = sbi_min_int(low->x, points[p].x);
        low->y = sbi_min_int(low->y, points[p].y);
        low->z = sbi_min_int(low->z, points[p].z);
        high->x = sbi_max_int(high->x, points[p].x);
        high->y = sbi_max_int(high->y, points[p].y);
        high->z = sbi_max_int(high->z, points[p].z);
    }
}

/* Cuts the links of a tet with points at these places that a blade crosses. */
static void world_cut_links(cut_world *w, int e, const sbi_corner_order *order, const sbi_int3 *points,
                            const sbi_blade *blade)
{
    const sbi_lattice *lattice = &w->lattice;
    for (int l = 0; l < lattice->link_count; l++) {
        sbi_link_key key;
        int ends[2];
        sb_real t;
        sbi_lattice_ends(lattice, order, l, ends);
        if (!sbi_blade_crosses(blade, points[ends[0]], points[ends[1]], &t))
            continue;
        key = sbi_lattice_key(lattice, order, e, l);
        world_reserve(w, 1);
        if (sbi_cut_links_find(&w->links, &key) < 0)
            sbi_cut_links_add(&w->links, &key, t, SBI_LINK_CUT);
    }
}

static void world_cut(cut_world *w, const sb_vec3 (*triangles)[3], int count)
{
    const sbi_lattice *lattice = &w->lattice;
    sbi_blade *blades = (sbi_blade *)malloc((size_t)count * SBI_CROSSING_PARTS * sizeof *blades);
    int made = 0;
    for (int k = 0; k < count; k++)
        made += sbi_crossing_blades(&w->frame, triangles[k], blades + made);
    for (int e = 0; e < w->mesh.element_count; e++) {
        sbi_corner_order order = sbi_corner_order_make(w->mesh.elements + 4 * e);
        sbi_int3 points[SBI_LATTICE_POINTS], low, high;
        sb_vec3 x[4];
        world_corners(w, e, x);
        for (int p = 0; p < lattice->point_count; p++) {
            sb_real barycentrics[4];
            sbi_lattice_point(lattice, p, barycentrics);
            points[p] = sbi_crossing_round(&w->frame, sbi_lattice_place(&order, barycentrics, x));
        }
        box_of(points, lattice->point_count, &low, &high);
        for (int k = 0; k < made; k++)
            if (low.x <= blades[k].high.x && low.y <= blades[k].high.y && low.z <= blades[k].high.z &&
                high.x >= blades[k].low.x && high.y >= blades[k].low.y && high.z >= blades[k].low.z)
                world_cut_links(w, e, &order, points, blades + k);
    }
    free(blades);
}

static int world_root(int *parent, int i)
{
    while (parent[i] != i)
        i = parent[i] = parent[parent[i]];
    return i;
}

/* Joins pieces that touch over faces; the two tets of a face agree about its links. */
static void world_join(cut_world *w, int e, int face, int *parent)
{
    int other = w->neighbours.items[4 * e + face], there = 0;
    const sbi_parted *mine = w->parted + e, *its;
    if (other < e)
        return;
    while (w->neighbours.items[4 * other + there] != e)
        there++;
    its = w->parted + other;
    for (int a = 0; a < mine->piece_count; a++)
        for (int b = 0; b < its->piece_count; b++)
            if (sbi_lattice_face_marks(&w->lattice, &mine->order, face, mine->pieces[a]) &
                sbi_lattice_face_marks(&w->lattice, &its->order, there, its->pieces[b])) {
                int i = world_root(parent, SBI_LATTICE_POINTS * e + a),
                    j = world_root(parent, SBI_LATTICE_POINTS * other + b);
                parent[i > j ? i : j] = i > j ? j : i;
            }
}

/* Parts of the body and their volumes. */
static void world_find_parts(cut_world *w)
{
    int count = w->mesh.element_count * SBI_LATTICE_POINTS, *parent = (int *)malloc((size_t)count * sizeof(int));
    for (int i = 0; i < count; i++)
        parent[i] = i;
    for (int e = 0; e < w->mesh.element_count; e++)
        sbi_parted_make(&w->lattice, &w->links, w->mesh.elements + 4 * e, e, w->parted + e);
    for (int e = 0; e < w->mesh.element_count; e++)
        for (int face = 0; face < 4; face++)
            world_join(w, e, face, parent);
    w->parts = 0;
    memset(w->volumes, 0, sizeof w->volumes);
    for (int e = 0; e < w->mesh.element_count; e++) {
        sbi_part_moments moments[SBI_LATTICE_POINTS];
        sbi_parted_moments(w->parted + e, 0, moments);
        for (int k = 0; k < w->parted[e].piece_count; k++) {
            int i = SBI_LATTICE_POINTS * e + k, root = world_root(parent, i);
            w->part_of[i] = root == i ? w->parts++ : w->part_of[root];
            if (w->part_of[i] < 256)
                w->volumes[w->part_of[i]] += (double)sb_mesh_element_volume(&w->mesh, e) * (double)moments[k].share;
        }
    }
    free(parent);
}

/* ---- meshes and blades ------------------------------------------------------------------------------------------- */

static sb_vec3 vector_in(double low, double high, unsigned long long *seed)
{
    double x = check_random_in(seed, low, high), y = check_random_in(seed, low, high);
    return sb_v3(REAL(x), REAL(y), REAL(check_random_in(seed, low, high)));
}

/* A box with its inner nodes shaken, other numbers for its nodes and other first corners for its tets. */
static sb_mesh box_shuffled(int nx, int ny, int nz, double unit, double offset, unsigned long long *seed)
{
    static const signed char turns[3][4] = {{1, 2, 0, 3}, {3, 2, 1, 0}, {1, 0, 3, 2}}; /* even */
    sb_mesh mesh = scene_box(SB_TET4, nx, ny, nz, sb_v3(REAL(nx * unit), REAL(ny * unit), REAL(nz * unit)), 0.2);
    int *number = (int *)malloc((size_t)mesh.node_count * sizeof(int));
    sb_vec3 *nodes = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
    for (int i = 0; i < mesh.node_count; i++) {
        int j = (int)check_random_in(seed, 0, i + 0.999);
        number[i] = i;
        if (j < i) {
            number[i] = number[j];
            number[j] = i;
        }
    }
    for (int i = 0; i < mesh.node_count; i++)
        nodes[number[i]] = sb_v3_add(mesh.nodes[i], sb_v3(REAL(offset), REAL(-offset), REAL(0.5 * offset)));
    memcpy(mesh.nodes, nodes, (size_t)mesh.node_count * sizeof(sb_vec3));
    for (int e = 0; e < mesh.element_count; e++) {
        int corners[4], *to = mesh.elements + 4 * e, turn = (int)check_random_in(seed, 0, 2.999);
        for (int a = 0; a < 4; a++)
            corners[a] = number[to[(int)turns[turn][a]]];
        memcpy(to, corners, sizeof corners);
    }
    free(number);
    free(nodes);
    return mesh;
}

/* A square with this middle and normal, of n x n x 2 triangles; returns how many. */
static int plane_make(sb_vec3 middle, sb_vec3 normal, double half, int n, sb_vec3 (*triangles)[3])
{
    sb_vec3 u = sb_v3_perpendicular(normal), v = sb_v3_cross(normal, u);
    int count = 0;
    u = sb_v3_scale(REAL(half) / sb_v3_norm(u), u);
    v = sb_v3_scale(REAL(half) / sb_v3_norm(v), v);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            sb_vec3 corners[4];
            for (int k = 0; k < 4; k++) {
                double s = 2.0 * (i + (k == 1 || k == 2)) / n - 1, t = 2.0 * (j + (k >= 2)) / n - 1;
                corners[k] = sb_v3_madd(sb_v3_madd(middle, REAL(s), u), REAL(t), v);
            }
            for (int k = 0; k < 2; k++, count++) {
                triangles[count][0] = corners[0];
                triangles[count][1] = corners[k + 1];
                triangles[count][2] = corners[k + 2];
            }
        }
    return count;
}

/* A random triangle of a size about `half`. */
static void blade_random(sb_vec3 middle, double half, unsigned long long *seed, sb_vec3 triangle[3])
{
    for (int a = 0; a < 3; a++)
        triangle[a] = sb_v3_add(middle, vector_in(-half, half, seed));
}

/* ---- tables ------------------------------------------------------------------------------------------------------ */

static void test_counts(void)
{
    static const int points[3] = {4, 10, 35}, links[3] = {6, 25, 130}, micros[3] = {1, 8, 64};
    for (int i = 0; i < 3; i++) {
        sbi_lattice lattice;
        int m = intervals_of[i], on_faces = 0;
        sbi_lattice_make(m, &lattice);
        CHECK_INT(lattice.point_count, points[i]);
        CHECK_INT(lattice.link_count, links[i]);
        CHECK_INT(lattice.micro_count, micros[i]);
        for (int p = 0; p < lattice.point_count; p++) {
            const signed char *at = lattice.points[p];
            CHECK_INT(at[0] + at[1] + at[2] + at[3], m);
            for (int face = 0; face < 4; face++)
                on_faces += (int)(lattice.face_points[face] >> p & 1);
        }
        CHECK_INT(on_faces, 4 * (m + 1) * (m + 2) / 2);
        for (int e = 0; e < 6 && m == 2; e++) { /* as the nodes of a tet10 */
            int nodes[3];
            sb_element_edge(SB_TET10, e, nodes);
            CHECK_INT(lattice.points[nodes[2]][nodes[0]], 1);
            CHECK_INT(lattice.points[nodes[2]][nodes[1]], 1);
        }
        for (int l = 0; l < lattice.link_count; l++)
            CHECK(lattice.links[l][0] < lattice.links[l][1]);
    }
}

/* Micro-tets fill the tet, all of a volume, and are oriented as it is. */
static void test_micros(void)
{
    for (int i = 0; i < 3; i++) {
        sbi_lattice lattice;
        int m = intervals_of[i];
        sbi_lattice_make(m, &lattice);
        for (int k = 0; k < lattice.micro_count; k++) {
            sb_mat3 edges;
            for (int a = 1; a < 4; a++)
                for (int row = 0; row < 3; row++)
                    edges.m[row][a - 1] = (sb_real)(lattice.points[lattice.micros[k][a]][row + 1] -
                                                    lattice.points[lattice.micros[k][0]][row + 1]);
            CHECK_NEAR(sb_m3_det(edges), 1, 0);
            for (int e = 0; e < 6; e++) {
                int ends[3], a, b;
                const unsigned char *link = lattice.links[lattice.micro_links[k][e]];
                sb_element_edge(SB_TET4, e, ends);
                a = lattice.micros[k][ends[0]];
                b = lattice.micros[k][ends[1]];
                CHECK(link[0] == (a < b ? a : b) && link[1] == (a < b ? b : a));
            }
        }
    }
}

/* Each link has one name, which no other has; the points of its ends are the same from all tets around. */
static void test_names(void)
{
    unsigned long long seed = 3;
    for (int i = 0; i < 3; i++) {
        cut_world w = world_of(box_shuffled(2, 2, 2, 1, 0, &seed), intervals_of[i]);
        int m = intervals_of[i], tets = w.mesh.element_count, faces = 0, edges;
        sb_index_table table;
        sb_vec3 *at;
        CHECK_OK(sb_mesh_edges(&w.mesh, NULL, &table, NULL));
        edges = table.rows;
        sb_index_table_free(&table);
        for (int k = 0; k < 4 * tets; k++)
            faces += w.neighbours.items[k] < 0 || w.neighbours.items[k] > k / 4;
        at = (sb_vec3 *)calloc((size_t)(tets * w.lattice.link_count), 2 * sizeof *at);
        for (int e = 0; e < tets; e++) {
            sbi_corner_order order = sbi_corner_order_make(w.mesh.elements + 4 * e);
            sb_vec3 x[4];
            world_corners(&w, e, x);
            for (int l = 0; l < w.lattice.link_count; l++) {
                sbi_link_key key = sbi_lattice_key(&w.lattice, &order, e, l);
                int item = sbi_cut_links_find(&w.links, &key), ends[2];
                sbi_lattice_ends(&w.lattice, &order, l, ends);
                for (int k = 0; k < 2; k++) {
                    sb_real barycentrics[4];
                    sb_vec3 place;
                    sbi_lattice_point(&w.lattice, ends[k], barycentrics);
                    place = sbi_lattice_place(&order, barycentrics, x);
                    if (item < 0)
                        at[2 * w.links.count + k] = place;
                    else
                        CHECK(memcmp(at + 2 * item + k, &place, sizeof place) == 0);
                }
                world_reserve(&w, 1);
                if (item < 0)
                    sbi_cut_links_add(&w.links, &key, 0, SBI_LINK_CUT);
            }
        }
        /* of an edge m, of a face 3 m (m - 1) / 2, the rest inside */
        CHECK_INT(w.links.count, edges * m + faces * 3 * m * (m - 1) / 2 +
                                     tets * (w.lattice.link_count - 6 * m - 4 * 3 * m * (m - 1) / 2));
        free(at);
        world_free(&w);
    }
}

/* Links taken back are whole again, and those before them are still there. */
static void test_table(void)
{
    enum { LINKS = 3000 };
    cut_world w;
    memset(&w, 0, sizeof w);
    for (int i = 0; i < LINKS; i++) {
        sbi_link_key key = {{i % 7, i, -1, i % 5}};
        CHECK_INT(sbi_cut_links_find(&w.links, &key), -1);
        world_reserve(&w, 1);
        sbi_cut_links_add(&w.links, &key, REAL(i), SBI_LINK_CUT);
    }
    sbi_cut_links_truncate(&w.links, LINKS / 3);
    for (int i = 0; i < LINKS; i++) {
        sbi_link_key key = {{i % 7, i, -1, i % 5}};
        CHECK_INT(sbi_cut_links_find(&w.links, &key), i < LINKS / 3 ? i : -1);
    }
    free(w.links.items);
    free(w.links.table);
}

/* ---- signs ------------------------------------------------------------------------------------------------------- */

static sbi_int3 point_random(int limit, unsigned long long *seed)
{
    sbi_int3 p;
    p.x = (int)check_random_in(seed, -limit, limit + 0.999);
    p.y = (int)check_random_in(seed, -limit, limit + 0.999);
    p.z = (int)check_random_in(seed, -limit, limit + 0.999);
    return p;
}

static sbi_int3 point_moved(sbi_int3 p, int scale, sbi_int3 by)
{
    p.x = scale * p.x + by.x, p.y = scale * p.y + by.y, p.z = scale * p.z + by.z;
    return p;
}

/* The same question in long double, with the blade really moved by (e, e^2, e^3): exact where e and the coordinates are
 * numbers of few bits. -1: a tie. */
static int crosses_long(const sbi_int3 corners[3], sbi_int3 p, sbi_int3 r, long double e)
{
    const long double moves[3] = {e, e * e, e * e * e};
    long double a[3][3], q[2][3], signs[5];
    for (int k = 0; k < 3; k++) {
        a[k][0] = (long double)corners[k].x + moves[0];
        a[k][1] = (long double)corners[k].y + moves[1];
        a[k][2] = (long double)corners[k].z + moves[2];
    }
    for (int k = 0; k < 2; k++) {
        q[k][0] = (long double)(k ? r.x : p.x);
        q[k][1] = (long double)(k ? r.y : p.y);
        q[k][2] = (long double)(k ? r.z : p.z);
    }
    for (int k = 0; k < 5; k++) { /* sides of both ends, then the edges */
        long double u[3], v[3], d[3];
        for (int i = 0; i < 3; i++) {
            u[i] = k < 2 ? a[1][i] - a[0][i] : a[k - 2][i] - q[0][i];
            v[i] = k < 2 ? a[2][i] - a[0][i] : a[(k - 1) % 3][i] - q[0][i];
            d[i] = k < 2 ? q[k][i] - a[0][i] : q[1][i] - q[0][i];
        }
        signs[k] = d[0] * (u[1] * v[2] - u[2] * v[1]) + d[1] * (u[2] * v[0] - u[0] * v[2]) +
                   d[2] * (u[0] * v[1] - u[1] * v[0]);
        if (signs[k] == 0)
            return k < 2 ? -1 : 0; /* moved, edges are not met but by parallel links */
    }
    return (signs[0] > 0) != (signs[1] > 0) && (signs[2] > 0) == (signs[3] > 0) && (signs[3] > 0) == (signs[4] > 0);
}

/* Either end first, and corners in any order, it is the same crossing; and that of exact numbers with the blade moved.
 */
static void test_signs(void)
{
    const long double e = 1.0L / 512; /* small enough for coordinates up to 2 */
    unsigned long long seed = 5;
    int rounds = check_quick() ? 20000 : check_rounds(1000000), crossings = 0, different = 0, unlike = 0;
    for (int i = 0; i < rounds; i++) {
        int limit = i % 2 ? 1 << 17 : 2; /* as large as long double can do; small ones: full of ties */
        sbi_int3 corners[3], turned[3], large[3], by = point_random(SBI_CROSSING_TISSUE / 2, &seed),
                                                  p = point_random(limit, &seed), r = point_random(limit, &seed);
        sbi_blade blade, back;
        sb_real t = -1, s = -1;
        int crosses, expected;
        for (int a = 0; a < 3; a++)
            corners[a] = point_random(i % 2 ? 1 << 19 : limit, &seed);
        turned[0] = corners[2];
        turned[1] = corners[1];
        turned[2] = corners[0];
        if (!sbi_blade_make(corners, &blade) || (p.x == r.x && p.y == r.y && p.z == r.z))
            continue;
        CHECK(sbi_blade_make(turned, &back));
        crosses = sbi_blade_crosses(&blade, p, r, &t);
        expected = crosses_long(corners, p, r, i % 2 ? 0 : e);
        different += sbi_blade_crosses(&back, r, p, &s) != crosses;
        unlike += crosses != expected && (i % 2 == 0 || expected >= 0) && LDBL_MANT_DIG >= 64;
        for (int a = 0; a < 3; a++)
            large[a] = point_moved(corners[a], i % 2 ? 1 << 8 : 1 << 24, by);
        CHECK(sbi_blade_make(large, &back)); /* as large as it gets */
        different += sbi_blade_crosses(&back, point_moved(p, i % 2 ? 1 << 8 : 1 << 24, by),
                                       point_moved(r, i % 2 ? 1 << 8 : 1 << 24, by), &s) != crosses;
        s = crosses ? 1 - s : s;
        if (crosses)
            CHECK(t >= 0 && t <= 1 && sb_abs(s - (1 - t)) <= 4 * SB_EPSILON);
        crossings += crosses;
    }
    CHECK_INT(different, 0);
    CHECK_INT(unlike, 0);
    CHECK(crossings > rounds / 1000);
}

static int64_t turn_of(sbi_int3 d, sbi_int3 a, sbi_int3 b, sbi_int3 c)
{
    int64_t u[3] = {b.x - a.x, b.y - a.y, b.z - a.z}, v[3] = {c.x - a.x, c.y - a.y, c.z - a.z};
    return d.x * (u[1] * v[2] - u[2] * v[1]) + d.y * (u[2] * v[0] - u[0] * v[2]) + d.z * (u[0] * v[1] - u[1] * v[0]);
}

/* A link right through the edge that two triangles share, which lie on either side of it as the link sees them, crosses
 * exactly one of them. */
static void test_shared_edge(void)
{
    unsigned long long seed = 11;
    int rounds = check_quick() ? 20000 : check_rounds(400000), tested = 0, wrong = 0;
    for (int i = 0; i < rounds; i++) {
        int limit = i % 2 ? 4 : 10000;
        sbi_int3 d = point_random(limit, &seed), middle = point_random(limit, &seed), a = point_random(limit, &seed);
        sbi_int3 c = point_random(limit, &seed), o = point_random(limit, &seed), b, p, r, one[3], two[3];
        sbi_blade blades[2];
        sb_real t;
        int64_t left, right;
        b.x = 2 * middle.x - a.x, b.y = 2 * middle.y - a.y, b.z = 2 * middle.z - a.z;
        p.x = middle.x - d.x, p.y = middle.y - d.y, p.z = middle.z - d.z;
        r.x = middle.x + d.x, r.y = middle.y + d.y, r.z = middle.z + d.z;
        left = turn_of(d, a, b, c);
        right = turn_of(d, a, b, o);
        if (left == 0 || right == 0 || (left > 0) == (right > 0))
            continue;
        one[0] = a, one[1] = b, one[2] = c;
        two[0] = b, two[1] = a, two[2] = o;
        CHECK(sbi_blade_make(one, blades) && sbi_blade_make(two, blades + 1));
        wrong += sbi_blade_crosses(blades, p, r, &t) + sbi_blade_crosses(blades + 1, p, r, &t) != 1;
        tested++;
    }
    CHECK_INT(wrong, 0);
    CHECK(tested > rounds / 10);
}

/* A closed way crosses a closed surface an even number of times, also where it meets edges and corners. */
static void test_closed_surface(void)
{
    static const signed char faces[4][3] = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}};
    unsigned long long seed = 17;
    int rounds = check_quick() ? 5000 : check_rounds(100000), odd = 0, crossed = 0;
    for (int i = 0; i < rounds; i++) {
        int limit = i % 4 ? 3 : 5000, sum = 0, flat = 0;
        sbi_int3 corners[4], way[4], triangle[3];
        for (int k = 0; k < 4; k++) {
            corners[k] = point_random(limit, &seed);
            way[k] = point_random(limit, &seed);
        }
        way[3] = way[0];
        for (int f = 0; f < 4; f++) {
            sbi_blade blade;
            sb_real t;
            for (int a = 0; a < 3; a++)
                triangle[a] = corners[(int)faces[f][a]];
            flat |= !sbi_blade_make(triangle, &blade);
            for (int k = 0; k < 3 && !flat; k++)
                sum += sbi_blade_crosses(&blade, way[k], way[k + 1], &t);
        }
        odd += !flat && sum % 2;
        crossed += !flat && sum > 0;
    }
    CHECK_INT(odd, 0);
    CHECK(crossed > rounds / 10);
}

/* Triangles that reach far beyond the tissue are cut off along the same points from both sides of an edge: the sides of
 * a pyramid with its tip in the tissue and its base far away are crossed an even number of times by a closed way. */
static void test_far_blades(void)
{
    unsigned long long seed = 13;
    int rounds = check_quick() ? 2000 : check_rounds(20000), odd = 0, crossed = 0;
    for (int i = 0; i < rounds; i++) {
        double reach = pow(10, check_random_in(&seed, 0.5, SB_REAL_IS_FLOAT ? 30 : 200));
        sbi_crossing_frame frame;
        sb_vec3 tip = vector_in(-1, 1, &seed), base[3];
        sbi_int3 way[4];
        int sum = 0;
        sbi_crossing_frame_make(sb_v3(-1, -1, -1), sb_v3(1, 1, 1), &frame);
        CHECK_NEAR(frame.scale, 33554432, 0);
        for (int k = 0; k < 3; k++) {
            base[k] = vector_in(-reach, reach, &seed);
            base[k].z = REAL(3 * reach); /* the base misses the tissue */
            way[k] = sbi_crossing_round(&frame, vector_in(-1, 1, &seed));
        }
        way[3] = way[0];
        for (int k = 0; k < 3; k++) {
            sbi_blade blades[SBI_CROSSING_PARTS];
            sb_vec3 triangle[3];
            int made;
            triangle[0] = tip;
            triangle[1] = base[k];
            triangle[2] = base[(k + 1) % 3];
            made = sbi_crossing_blades(&frame, (const sb_vec3 *)triangle, blades);
            CHECK(made <= SBI_CROSSING_PARTS);
            for (int j = 0; j < made; j++)
                for (int l = 0; l < 3; l++) {
                    sb_real t;
                    sum += sbi_blade_crosses(blades + j, way[l], way[l + 1], &t);
                }
        }
        odd += sum % 2;
        crossed += sum > 0;
    }
    CHECK_INT(odd, 0);
    CHECK(crossed > rounds / 20);
}

/* A plane of triangles many times the tissue's size cuts where it is, and far away nothing. */
static void test_large_blades(void)
{
    for (int i = 0; i < 6; i++) {
        double half = pow(10, i);
        cut_world w = world_of(scene_box(SB_TET4, 3, 3, 3, sb_v3(3, 3, 3), 0), 1);
        sb_vec3 triangles[2][3], middle = sb_v3(1, REAL(1.25), 2);
        int count = plane_make(middle, sb_v3(0, 1, 0), 4 * half, 1, triangles);
        world_cut(&w, (const sb_vec3(*)[3])triangles, count);
        world_find_parts(&w);
        CHECK_INT(w.parts, 2);
        CHECK_NEAR(w.volumes[0], 9 * 1.25, 27 * 1e-5);
        world_free(&w);
        w = world_of(scene_box(SB_TET4, 3, 3, 3, sb_v3(3, 3, 3), 0), 1);
        middle.y = REAL(1e6);
        count = plane_make(middle, sb_v3(0, 1, 0), 4 * half, 1, triangles);
        world_cut(&w, (const sb_vec3(*)[3])triangles, count);
        CHECK_INT(w.links.count, 0);
        world_free(&w);
    }
}

/* ---- cuts through nodes, along edges and faces ------------------------------------------------------------------- */

enum { SIDE = 6, SQUARE = 12 };

/* A family of planes normal . x = level, spanned by u and v; all are whole numbers. */
typedef struct plane_family {
    sb_vec3 normal, u, v;
} plane_family;

static const plane_family plane_families[6] = {
    {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}},  {{0, 1, 0}, {1, 0, 0}, {0, 0, 1}},  {{0, 0, 1}, {1, 0, 0}, {0, 1, 0}},
    {{0, 1, -1}, {1, 0, 0}, {0, 1, 1}}, {{0, 1, 1}, {1, 0, 0}, {0, 1, -1}}, {{1, 1, 1}, {1, -1, 0}, {0, 1, -1}},
};

static cut_world unit_cubes(int intervals)
{
    return world_of(scene_box(SB_TET4, SIDE, SIDE, SIDE, sb_v3(SIDE, SIDE, SIDE), 0), intervals);
}

/* Cuts along a plane by SQUARE x SQUARE squares of two triangles each, with corners at whole numbers where the level
 * is one. */
static void cut_plane(cut_world *w, const plane_family *plane, double level)
{
    static sb_vec3 triangles[2 * SQUARE * SQUARE][3];
    sb_vec3 middle = sb_v3(3, 3, 3), n = plane->normal;
    sb_real off = REAL(level) - sb_v3_dot(n, middle);
    int count = 0;
    if (n.x != 0)
        middle.x += off;
    else if (n.y != 0)
        middle.y += off;
    else
        middle.z += off;
    for (int i = 0; i < SQUARE; i++)
        for (int j = 0; j < SQUARE; j++)
            for (int k = 0; k < 2; k++, count++)
                for (int a = 0; a < 3; a++) {
                    int s = i + (k == 0 ? a >= 1 : a == 1), t = j + (k == 0 ? a == 2 : a >= 1);
                    triangles[count][a] =
                        sb_v3_madd(sb_v3_madd(middle, REAL(2 * s - SQUARE), plane->u), REAL(2 * t - SQUARE), plane->v);
                }
    world_cut(w, (const sb_vec3(*)[3])triangles, count);
}

/* Volume of what of [0, 6]^3 lies below a plane. */
static double below(int family, double level)
{
    const double side = (double)SIDE, s = level / side, cube = side * side * side;
    if (family < 3)
        return s * cube;
    if (family == 3) /* y - z < level */
        return s >= 0 ? cube * (1 - 0.5 * (1 - s) * (1 - s)) : cube * 0.5 * (1 + s) * (1 + s);
    if (family == 4)
        return s <= 1 ? cube * 0.5 * s * s : cube * (1 - 0.5 * (2 - s) * (2 - s));
    return cube * (s * s * s - (s > 1 ? 3 * pow(s - 1, 3) : 0) + (s > 2 ? 3 * pow(s - 2, 3) : 0)) / 6;
}

/* Two parts, of the volumes that the plane leaves. */
static void check_plane(int intervals, int family, double level)
{
    cut_world w = unit_cubes(intervals);
    double expected = below(family, level), first;
    cut_plane(&w, plane_families + family, level);
    world_find_parts(&w);
    first = w.volumes[0];
    if (fabs(first - expected) > fabs(216 - first - expected))
        expected = 216 - expected;
    if (!CHECK_INT(w.parts, 2) || !CHECK_NEAR(first, expected, scene_tolerance(1e-9 * 216, 20 * 216)) ||
        !CHECK_NEAR(first + w.volumes[1], 216, scene_tolerance(1e-9 * 216, 20 * 216)))
        printf("plane %d at %g, m = %d\n", family, level, intervals);
    world_free(&w);
}

static void test_degenerate_planes(void)
{
    int cuts = 0;
    for (int i = 0; i < 3; i++)
        for (int family = 0; family < 6; family++) {
            double low = family == 3 ? -SIDE : 0, high = family < 4 ? SIDE : family == 4 ? 2 * SIDE : 3 * SIDE;
            double step = check_quick() ? 2 : 0.5;
            for (double level = low + step; level < high; level += step, cuts++)
                check_plane(intervals_of[i], family, level);
        }
    CHECK(check_quick() || cuts > 288);
}

/* The surface of a cube with edges along those of the tets, or half way. */
static void test_degenerate_cube(void)
{
    for (int i = 0; i < 3; i++)
        for (int shift = 0; shift < 2; shift++) {
            double low = 1 + 0.5 * shift, high = 5 - 0.5 * shift, size = high - low;
            cut_world w = unit_cubes(intervals_of[i]);
            sb_vec3 triangles[12][3];
            int count = 0;
            for (int axis = 0; axis < 3; axis++)
                for (int end = 0; end < 2; end++)
                    for (int k = 0; k < 2; k++, count++)
                        for (int a = 0; a < 3; a++) {
                            double at[3];
                            at[axis] = end ? high : low;
                            at[(axis + 1) % 3] = (k == 0 ? a >= 1 : a == 1) ? high : low;
                            at[(axis + 2) % 3] = (k == 0 ? a == 2 : a >= 1) ? high : low;
                            triangles[count][a] = sb_v3(REAL(at[0]), REAL(at[1]), REAL(at[2]));
                        }
            world_cut(&w, (const sb_vec3(*)[3])triangles, count);
            world_find_parts(&w);
            CHECK_INT(w.parts, 2);
            /* edges of the cube are rounded off within a link, unless they run along links */
            CHECK_NEAR(w.volumes[0] + w.volumes[1], 216, scene_tolerance(1e-9 * 216, 20 * 216));
            CHECK_NEAR(w.volumes[1], size * size * size,
                       shift && intervals_of[i] == 1 ? 6 * size : scene_tolerance(1e-9 * 216, 20 * 216));
            world_free(&w);
        }
}

static void test_degenerate_crossing(void)
{
    for (int i = 0; i < 3; i++) {
        cut_world w = unit_cubes(intervals_of[i]);
        for (int axis = 0; axis < 3; axis++)
            cut_plane(&w, plane_families + axis, 3);
        world_find_parts(&w);
        CHECK_INT(w.parts, 8);
        for (int k = 0; k < 8; k++)
            CHECK_NEAR(w.volumes[k], 27, scene_tolerance(1e-9 * 216, 20 * 216));
        world_free(&w);
    }
}

/* ---- planes anywhere --------------------------------------------------------------------------------------------- */

/* Random planes part unstructured meshes of any size, anywhere, in two, whose volumes are those of clipped tets to what
 * rounding to integers takes. */
static void test_random_planes(void)
{
    unsigned long long seed = 19;
    int rounds = check_quick() ? 4 : check_rounds(40);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < rounds; k++) {
            double unit = pow(10, check_random_in(&seed, -3, 3));
            double offset = unit * check_random_in(&seed, -1, 1) * (SB_REAL_IS_FLOAT ? 20 : 1e6);
            cut_world w = world_of(box_shuffled(3, 2, 3, unit, offset, &seed), intervals_of[i]);
            sb_vec3 n = vector_in(-1, 1, &seed), low, high, middle, triangles[8][3];
            double whole = (double)sb_mesh_volume(&w.mesh);
            double rounding = 1e-4; /* of a place, of the unit */
            int count;
            sb_mesh_bounds(&w.mesh, &low, &high);
            middle = sb_v3_scale(REAL(0.5), sb_v3_add(low, high));
            middle = sb_v3_add(middle, vector_in(-0.6 * unit, 0.6 * unit, &seed));
            count = plane_make(middle, n, 8 * unit, 2, triangles);
            world_cut(&w, (const sb_vec3(*)[3])triangles, count);
            world_find_parts(&w);
            CHECK_INT(w.parts, 2);
            CHECK_NEAR(w.volumes[0] + w.volumes[1], whole, scene_tolerance(1e-12, 400) * whole);
            rounding += 100 * (double)SB_EPSILON * (1 + fabs(offset) / unit);
            n = sb_v3_scale(1 / sb_v3_norm(n), n);
            for (int e = 0, sides[2] = {0, 0}; e < w.mesh.element_count; e++) { /* every piece is on its part's side */
                const sbi_parted *parted = w.parted + e;
                sb_vec3 x[4];
                sb_real at[4];
                world_corners(&w, e, x);
                for (int p = 0; p < w.lattice.point_count; p++) {
                    int part = w.part_of[SBI_LATTICE_POINTS * e + parted->piece_of[p]], side;
                    double height;
                    sbi_lattice_point(&w.lattice, p, at);
                    height = (double)sb_v3_dot(n, sb_v3_sub(sbi_lattice_place(&parted->order, at, x), middle));
                    side = height > 0 ? 1 : -1;
                    if (fabs(height) < rounding * unit)
                        continue;
                    CHECK(sides[part] == 0 || sides[part] == side);
                    sides[part] = side;
                }
            }
            world_free(&w);
        }
}

/* ---- shapes of pieces -------------------------------------------------------------------------------------------- */

/* A tet with every link cut or not by chance, somewhere along it. */
static sbi_parted parted_random(const sbi_lattice *lattice, double share, unsigned long long *seed)
{
    static const int nodes[4] = {7, 3, 12, 5};
    sbi_parted parted;
    parted.lattice = lattice;
    parted.lost = 0;
    parted.order = sbi_corner_order_make(nodes);
    for (int l = 0; l < lattice->link_count; l++) {
        double t = check_random_in(seed, -0.2, 1.2); /* often at an end */
        parted.cut[l] = (unsigned char)(check_random(seed) < share);
        parted.rank[l] = (l * 37 + 11) % 131; /* none twice */
        parted.t[l] = REAL(t < 0 ? 0 : t > 1 ? 1 : t);
    }
    sbi_parted_find(&parted);
    return parted;
}

/* int of xi^i eta^j zeta^k over the piece, from its flags: degree up to 2. */
static double flag_integral(const sbi_flag *flag, const int power[3])
{
    static const double a = 0.58541019662496845446, b = 0.13819660112501051518; /* four points, degree 2 */
    double sum = 0;
    for (int q = 0; q < 4; q++) {
        double x[3] = {0, 0, 0}, value = 1;
        for (int v = 0; v < 4; v++) {
            x[0] += (v == q ? a : b) * (double)flag->corners[v].x;
            x[1] += (v == q ? a : b) * (double)flag->corners[v].y;
            x[2] += (v == q ? a : b) * (double)flag->corners[v].z;
        }
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < power[i]; k++)
                value *= x[i];
        sum += value / 4;
    }
    return sum * (double)flag->volume;
}

/* Volumes of flags are >= 0 and those of their corners, and sum to the tet; moments integrate what is quadratic. */
static void test_flags(void)
{
    unsigned long long seed = 23;
    int rounds = check_quick() ? 50 : check_rounds(1000);
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < rounds; round++) {
            static sbi_lattice lattice;
            static const int powers[10][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {2, 0, 0},
                                              {0, 2, 0}, {0, 0, 2}, {1, 1, 0}, {0, 1, 1}, {1, 0, 1}};
            sbi_parted parted;
            sbi_part_moments moments[SBI_LATTICE_POINTS];
            double sums[SBI_LATTICE_POINTS][10] = {{0}}, volume = 0;
            sbi_lattice_make(intervals_of[i], &lattice);
            parted = parted_random(&lattice, check_random_in(&seed, 0.3, 1), &seed);
            for (int micro = 0; micro < lattice.micro_count; micro++) {
                sbi_flag flags[SBI_FLAGS];
                int count = sbi_parted_flags(&parted, micro, 0, flags);
                for (int k = 0; k < count; k++) {
                    sb_mat3 edges = sb_m3_columns(sb_v3_sub(flags[k].corners[1], flags[k].corners[0]),
                                                  sb_v3_sub(flags[k].corners[2], flags[k].corners[0]),
                                                  sb_v3_sub(flags[k].corners[3], flags[k].corners[0]));
                    CHECK(flags[k].volume >= 0);
                    CHECK_NEAR(flags[k].volume, fabs((double)sb_m3_det(edges)), scene_tolerance(1e-14, 16));
                    volume += (double)flags[k].volume;
                    for (int d = 0; d < 10; d++)
                        sums[flags[k].piece][d] += flag_integral(flags + k, powers[d]);
                }
            }
            CHECK_NEAR(volume, 1, scene_tolerance(1e-14, 16));
            sbi_parted_moments(&parted, 0, moments);
            for (int k = 0; k < parted.piece_count; k++)
                for (int d = 0; d < 10; d++) { /* of the mean and the spread */
                    const sb_real centre[3] = {moments[k].centre.x, moments[k].centre.y, moments[k].centre.z};
                    double value = 1, tolerance = scene_tolerance(1e-11, 32) * (double)moments[k].share;
                    int axes[2], count = 0;
                    for (int axis = 0; axis < 3; axis++)
                        for (int n = 0; n < powers[d][axis]; n++) {
                            axes[count++] = axis;
                            value *= (double)centre[axis];
                        }
                    if (count == 2)
                        value += (double)moments[k].spread.m[axes[0]][axes[1]];
                    CHECK_NEAR(value * (double)moments[k].share, sums[k][d],
                               tolerance + 4 * (double)SB_EPSILON * volume);
                }
        }
}

/* The four points of a piece are exact for what is quadratic. */
static void check_points(const sbi_part_moments *moments, const sbi_piece *piece)
{
    const sb_real centre[3] = {moments->centre.x, moments->centre.y, moments->centre.z};
    double tolerance = scene_tolerance(1e-11, 64);
    sb_real points[4][3];
    CHECK(sbi_piece_is_sound(piece, 4));
    sbi_piece_points(piece, points);
    for (int a = 0; a < 3; a++)
        for (int c = 0; c < 3; c++) {
            double mean = 0, square = 0;
            for (int q = 0; q < 4; q++) {
                mean += (double)points[q][a] / 4;
                square += (double)(points[q][a] * points[q][c]) / 4;
            }
            CHECK_NEAR(mean, (double)centre[a], tolerance);
            CHECK_NEAR(square, (double)(moments->spread.m[a][c] + centre[a] * centre[c]), tolerance);
        }
}

/* Moments of two pieces together, about their common centre. */
static sbi_part_moments moments_of_both(const sbi_part_moments *one, const sbi_part_moments *other)
{
    sbi_part_moments both = *one;
    sb_real way[3], share = one->share + other->share, part = share > 0 ? other->share / share : REAL(0.5);
    sb_vec3 to = sb_v3_sub(other->centre, one->centre);
    both.share = share;
    both.centre = sb_v3_madd(one->centre, part, to);
    way[0] = to.x, way[1] = to.y, way[2] = to.z;
    for (int a = 0; a < 3; a++)
        for (int c = 0; c < 3; c++)
            both.spread.m[a][c] =
                (1 - part) * one->spread.m[a][c] + part * other->spread.m[a][c] + part * (1 - part) * way[a] * way[c];
    return both;
}

/* Four points stand for pieces and for several of them together, which may lie apart, up to degree 2; lumped masses of
 * pieces are positive and sum to those of the tet. */
static void test_four_points(void)
{
    static const double whole[2][2] = {{0.25, 0.25}, {1.0 / 36, 4.0 / 27}}; /* at corners, on edges */
    unsigned long long seed = 47;
    int rounds = check_quick() ? 20 : check_rounds(300);
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < rounds; round++) {
            sbi_lattice lattice;
            sbi_parted parted;
            sbi_part_moments moments[SBI_LATTICE_POINTS], together;
            double sums[2][10] = {{0}};
            sbi_lattice_make(intervals_of[i], &lattice);
            parted = parted_random(&lattice, check_random_in(&seed, 0.3, 1), &seed);
            sbi_parted_moments(&parted, 0, moments);
            together = moments[0];
            for (int k = 0; k < parted.piece_count; k++) {
                sbi_piece piece = sbi_piece_make(moments[k].centre, &moments[k].spread, 4, NULL);
                sb_real masses[10];
                check_points(moments + k, &piece);
                if (k > 0) { /* with one or all before it */
                    const sbi_part_moments both = moments_of_both(round % 2 ? moments : &together, moments + k);
                    const sbi_piece of_both = sbi_piece_make(both.centre, &both.spread, 4, NULL);
                    check_points(&both, &of_both);
                    together = moments_of_both(&together, moments + k);
                }
                for (int quadratic = 0; quadratic < 2; quadratic++) {
                    sbi_piece_lumps(&piece, quadratic ? 10 : 4, moments[k].share, masses, NULL);
                    for (int a = 0; a < (quadratic ? 10 : 4); a++) {
                        CHECK(masses[a] > 0 || moments[k].share == 0);
                        sums[quadratic][a] += (double)masses[a];
                    }
                }
            }
            for (int quadratic = 0; quadratic < 2; quadratic++)
                for (int a = 0; a < (quadratic ? 10 : 4); a++)
                    CHECK_NEAR(sums[quadratic][a], whole[quadratic][a >= 4], scene_tolerance(1e-13, 64));
        }
}

/* Cuts one after the other: pieces that a later one does not cut keep their moments, and those that it does sum to what
 * they were. */
static void test_later_cuts(void)
{
    unsigned long long seed = 43;
    int refined = 0;
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < 200; round++) {
            sbi_lattice lattice;
            sbi_parted now, before;
            sbi_lattice_make(intervals_of[i], &lattice);
            before = now = parted_random(&lattice, 0, &seed);
            for (int turn = 0; turn < lattice.link_count; turn++) {
                sbi_part_moments old_moments[SBI_LATTICE_POINTS], moments[SBI_LATTICE_POINTS];
                int link = (int)check_random_in(&seed, 0, lattice.link_count - 0.001);
                double sums[SBI_LATTICE_POINTS][2] = {{0}};
                now.cut[link] = 1;
                if (!before.cut[link])
                    now.rank[link] = turn;
                sbi_parted_find(&now);
                if (now.piece_count > before.piece_count) {
                    refined += before.piece_count > 1;
                    sbi_parted_moments(&before, 0, old_moments);
                    sbi_parted_moments(&now, 0, moments);
                    for (int k = 0; k < now.piece_count; k++)
                        for (int j = 0; j < before.piece_count; j++)
                            if (now.pieces[k] & before.pieces[j]) {
                                sums[j][0] += (double)moments[k].share;
                                sums[j][1] += (double)(moments[k].share * moments[k].centre.x);
                            }
                    for (int j = 0; j < before.piece_count; j++) {
                        CHECK_NEAR(sums[j][0], (double)old_moments[j].share, scene_tolerance(1e-14, 16));
                        CHECK_NEAR(sums[j][1], (double)(old_moments[j].share * old_moments[j].centre.x),
                                   scene_tolerance(1e-14, 16));
                    }
                }
                before = now;
            }
        }
    CHECK(refined > 100);
}

/* Crossings kept off the ends leave no piece without volume, and all of it is still there. */
static void test_least(void)
{
    unsigned long long seed = 29;
    sbi_lattice lattice;
    sbi_lattice_make(2, &lattice);
    for (int round = 0; round < 200; round++) {
        sbi_parted parted = parted_random(&lattice, 0.9, &seed);
        sbi_part_moments moments[SBI_LATTICE_POINTS];
        double sum = 0;
        sbi_parted_moments(&parted, REAL(0.05), moments);
        for (int k = 0; k < parted.piece_count; k++) {
            CHECK(moments[k].share > REAL(0.05 * 0.05 * 0.05 / 8));
            sum += (double)moments[k].share;
        }
        CHECK_NEAR(sum, 1, scene_tolerance(1e-14, 16));
    }
}

/* What pieces have of a face is all of it. */
static void check_face_area(const cut_world *w, int e, int face)
{
    const sbi_parted *parted = w->parted + e;
    sbi_face_moments moments[SBI_LATTICE_POINTS];
    double area = 0;
    sbi_parted_face(parted, face, moments);
    for (int k = 0; k < parted->piece_count; k++) {
        unsigned marks = sbi_lattice_face_marks(&w->lattice, &parted->order, face, parted->pieces[k]);
        double sum = 0;
        area += (double)moments[k].share;
        CHECK(moments[k].share >= 0 && (marks || moments[k].share == 0));
        for (int a = 0; a < 4; a++)
            sum += (double)moments[k].loads[a];
        CHECK_NEAR(sum, (double)moments[k].share, scene_tolerance(1e-14, 16));
    }
    CHECK_NEAR(area, 1, scene_tolerance(1e-14, 16));
}

/* Where the point of a micro-tet's face is; 0: the micro-tet is whole and has none. */
static int face_point(const cut_world *w, int e, int micro, int face, sb_vec3 *place)
{
    const sbi_parted *parted = w->parted + e;
    sbi_micro_points points;
    sb_vec3 x[4];
    if (!sbi_parted_is_split(parted, micro))
        return 0;
    world_corners(w, e, x);
    sbi_parted_points(parted, micro, 0, &points);
    *place = sbi_lattice_place(&parted->order, points.tet[SBI_MICRO_FACES + face], x);
    return 1;
}

/* Marks of the corners of a micro-tet's face in the tet's face, or 0: it lies elsewhere. */
static unsigned micro_marks(const cut_world *w, int e, int tet_face, int micro, int face)
{
    static const signed char missing[4] = {3, 2, 0, 1};
    uint64_t corners = 0;
    int on = 0;
    for (int v = 0; v < 4; v++) {
        int point = w->lattice.micros[micro][v];
        if (v == missing[face] || !(w->lattice.face_points[tet_face] >> point & 1))
            continue;
        corners |= (uint64_t)1 << point;
        on++;
    }
    return on == 3 ? sbi_lattice_face_marks(&w->lattice, &w->parted[e].order, tet_face, corners) : 0;
}

/* Both tets of a face have the same points on it, to the bit, whatever cut them. */
static void check_face(const cut_world *w, int e, int face)
{
    int other = w->neighbours.items[4 * e + face], there = 0, found = 0, parts = 4 * w->lattice.micro_count;
    check_face_area(w, e, face);
    if (other < e)
        return;
    while (w->neighbours.items[4 * other + there] != e)
        there++;
    for (int k = 0; k < parts; k++) {
        unsigned marks = micro_marks(w, e, face, k / 4, k % 4);
        for (int j = 0; j < parts && marks; j++) {
            sb_vec3 mine, its;
            if (micro_marks(w, other, there, j / 4, j % 4) != marks)
                continue;
            found++;
            if (face_point(w, e, k / 4, k % 4, &mine) && face_point(w, other, j / 4, j % 4, &its))
                CHECK(memcmp(&mine, &its, sizeof mine) == 0);
        }
    }
    CHECK_INT(found, w->lattice.intervals * w->lattice.intervals);
}

/* Random blades through unstructured meshes: volumes, lips and faces of every tet. */
static void test_random_blades(void)
{
    unsigned long long seed = 31;
    int rounds = check_quick() ? 2 : check_rounds(12), split = 0;
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < rounds; round++) {
            double unit = pow(10, check_random_in(&seed, -3, 3));
            double offset = unit * check_random_in(&seed, -1, 1) * (SB_REAL_IS_FLOAT ? 20 : 1e6);
            cut_world w = world_of(box_shuffled(2, 2, 2, unit, offset, &seed), intervals_of[i]);
            sb_vec3 triangles[6][3], low, high;
            double sum = 0;
            sb_mesh_bounds(&w.mesh, &low, &high);
            for (int k = 0; k < 6; k++)
                blade_random(sb_v3_scale(REAL(0.5), sb_v3_add(low, high)), 2 * unit, &seed, triangles[k]);
            world_cut(&w, (const sb_vec3(*)[3])triangles, 6);
            world_find_parts(&w);
            for (int k = 0; k < w.parts && k < 256; k++)
                sum += w.volumes[k];
            CHECK_NEAR(sum, (double)sb_mesh_volume(&w.mesh), scene_tolerance(1e-12, 400) * sum);
            for (int e = 0; e < w.mesh.element_count; e++) {
                split += w.parted[e].piece_count > 1;
                for (int face = 0; face < 4; face++)
                    check_face(&w, e, face);
            }
            world_free(&w);
        }
    CHECK(split > 20);
}

/* Area vector of a lip in the tet with corners at unit places: half the cross product of its edges. */
static sb_vec3 lip_area(const sbi_lip *lip)
{
    sb_vec3 at[3];
    for (int k = 0; k < 3; k++)
        at[k] = sb_v3(lip->corners[k][1], lip->corners[k][2], lip->corners[k][3]);
    return sb_v3_scale(REAL(0.5), sb_v3_cross(sb_v3_sub(at[1], at[0]), sb_v3_sub(at[2], at[0])));
}

/* A plane through a tet: the lips are the clipped polygon, and they look from below to above. */
static void test_lips(void)
{
    unsigned long long seed = 37;
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < 200; round++) {
            static const int nodes[4] = {4, 9, 2, 7};
            sbi_lattice lattice;
            sbi_parted parted;
            sb_vec3 n = vector_in(-1, 1, &seed), sum = {0, 0, 0};
            sb_real level = REAL(check_random_in(&seed, -0.1, 0.3)), area = 0, size;
            double below_volume = 0, above_volume = 0, flux = 0;
            sbi_part_moments moments[SBI_LATTICE_POINTS];
            sbi_lattice_make(intervals_of[i], &lattice);
            parted.lattice = &lattice;
            parted.lost = 0;
            parted.order = sbi_corner_order_make(nodes);
            for (int l = 0; l < lattice.link_count; l++) {
                sb_real at[4], heights[2];
                int ends[2];
                sbi_lattice_ends(&lattice, &parted.order, l, ends);
                for (int k = 0; k < 2; k++) {
                    sbi_lattice_point(&lattice, ends[k], at);
                    heights[k] = n.x * at[1] + n.y * at[2] + n.z * at[3] - level;
                }
                parted.cut[l] = (unsigned char)((heights[0] > 0) != (heights[1] > 0));
                parted.rank[l] = l;
                parted.t[l] = parted.cut[l] ? heights[0] / (heights[0] - heights[1]) : REAL(0.5);
            }
            sbi_parted_find(&parted);
            CHECK(parted.piece_count <= 2);
            sbi_parted_moments(&parted, 0, moments);
            for (int micro = 0; micro < lattice.micro_count; micro++) {
                sbi_lip lips[SBI_LIPS];
                int count = sbi_parted_lips(&parted, micro, lips);
                for (int k = 0; k < count; k++) {
                    sb_vec3 a = lip_area(lips + k);
                    int up = sbi_parted_is_split(&parted, micro) && lips[k].above == parted.piece_of[0];
                    sum = sb_v3_madd(sum, up ? REAL(1) : REAL(-1), a);
                    area += sb_v3_norm(a);
                    for (int c = 0; c < 3; c++)
                        flux += (double)(n.x * lips[k].corners[c][1] + n.y * lips[k].corners[c][2] +
                                         n.z * lips[k].corners[c][3] - level);
                }
            }
            size = sb_v3_norm(sum);
            CHECK_NEAR(size, area, scene_tolerance(1e-13, 64)); /* flat, and all look to the same side */
            CHECK_NEAR(flux, 0, scene_tolerance(1e-12, 2000));
            if (parted.piece_count == 2 && size > REAL(1e-6)) { /* towards the corner at the origin */
                sb_vec3 towards = sb_v3_scale(level > 0 ? REAL(-1) : REAL(1), n);
                CHECK(sb_v3_dot(sum, towards) > 0);
                below_volume = (double)moments[0].share;
                above_volume = (double)moments[1].share;
                CHECK_NEAR(below_volume + above_volume, 1, scene_tolerance(1e-14, 16));
            }
        }
}

/* ---- the ring rule ----------------------------------------------------------------------------------------------- */

/* One link that holds two parts of a tet is found, of each of its links; none of a tet that is cut through or not. */
static void test_ring(void)
{
    for (int i = 0; i < 3; i++) {
        sbi_lattice lattice;
        unsigned char cut[SBI_LATTICE_LINKS], ringed[SBI_LATTICE_LINKS];
        uint64_t pieces[SBI_LATTICE_POINTS];
        sbi_lattice_make(intervals_of[i], &lattice);
        for (int l = 0; l < lattice.link_count; l++) { /* all links about the ends of this one and between them */
            int a = lattice.links[l][0];
            memset(cut, 0, sizeof cut);
            sbi_lattice_find_ringed(&lattice, cut, ringed);
            CHECK(!ringed[l]);
            for (int k = 0; k < lattice.link_count; k++)
                cut[k] = (unsigned char)((lattice.links[k][0] == a || lattice.links[k][1] == a) && k != l);
            sbi_lattice_find_ringed(&lattice, cut, ringed);
            CHECK(ringed[l]);
            CHECK_INT(sbi_lattice_pieces(&lattice, cut, sbi_lattice_all(&lattice), pieces), 1);
            cut[l] = 1;
            sbi_lattice_find_ringed(&lattice, cut, ringed);
            CHECK(!ringed[l]);
            CHECK_INT(sbi_lattice_pieces(&lattice, cut, sbi_lattice_all(&lattice), pieces), 2);
            CHECK(pieces[0] == (uint64_t)1 << a || pieces[1] == (uint64_t)1 << a);
        }
    }
}

CHECK_SUITE(cut_lattice, {"points, links and micro-tets are as many as they should be", test_counts},
            {"micro-tets fill the tet", test_micros}, {"links have one name from all tets around", test_names},
            {"links taken back are whole", test_table}, {"signs are those of exact numbers", test_signs},
            {"a shared edge is crossed once", test_shared_edge},
            {"closed ways cross closed surfaces evenly", test_closed_surface},
            {"far blades are cut off evenly", test_far_blades}, {"large blades cut where they are", test_large_blades},
            {"planes through nodes, edges and faces part in two", test_degenerate_planes},
            {"a cube is cut out", test_degenerate_cube}, {"three planes cross", test_degenerate_crossing},
            {"random planes part in two", test_random_planes}, {"flags fill the tet", test_flags},
            {"four points and lumped masses of pieces", test_four_points},
            {"later cuts leave other pieces as they are", test_later_cuts},
            {"no piece is empty where crossings keep off", test_least},
            {"faces agree after random blades", test_random_blades}, {"lips are the clipped plane", test_lips},
            {"a link in a ring of cuts is found", test_ring});
