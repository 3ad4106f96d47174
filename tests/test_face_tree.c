/* Trees of boxes over faces: against all faces one by one, dense points of curved faces on their way, other orders of
 * the same faces. They are internal. */
#define SB_SPLIT_BUILD
#include <float.h>
#include <limits.h>

#include "../src/softbody/contact/face_tree.h"

#include "check.h"
#include "scene.h"

/* ---- faces at random --------------------------------------------------------------------------------------------- */

enum { CLOUD_WIDTH = 9 };

typedef struct cloud {
    int nodes, faces, width;
    sb_vec3 *x, *v;
    int *corners;         /* [faces][width] */
    unsigned char *sizes; /* [faces] */
    int *order;           /* [faces] */
    sb_real dt;
    double unit, offset; /* m: size, and distance from the origin */
} cloud;

static const int cloud_sizes[5] = {3, 4, 6, 8, 9};

static sb_vec3 cloud_vector(double size, unsigned long long *seed)
{
    double x = check_random_in(seed, -size, size), y = check_random_in(seed, -size, size);
    return sb_v3(REAL(x), REAL(y), REAL(check_random_in(seed, -size, size)));
}

static void cloud_shuffle(cloud *c, unsigned long long *seed)
{
    for (int i = c->faces - 1; i > 0; i--) {
        int j = (int)check_random_in(seed, 0, i + 0.999), swap = c->order[i];
        c->order[i] = c->order[j];
        c->order[j] = swap;
    }
}

/* Faces of one size (0: of any) with nodes near each other, not numbered without gaps; the way may be long. */
static cloud cloud_make(int faces, int size, double unit, double offset, unsigned long long *seed)
{
    cloud c;
    memset(&c, 0, sizeof c);
    c.faces = faces;
    c.nodes = 3 * faces + 9;
    c.width = size ? size : CLOUD_WIDTH;
    c.unit = unit;
    c.offset = offset;
    c.dt = REAL(check_random_in(seed, 0, 0.1));
    c.x = (sb_vec3 *)calloc((size_t)c.nodes, sizeof *c.x);
    c.v = (sb_vec3 *)calloc((size_t)c.nodes, sizeof *c.v);
    c.corners = (int *)calloc((size_t)(faces * c.width) + 1, sizeof(int));
    c.sizes = (unsigned char *)calloc((size_t)faces + 1, 1);
    c.order = (int *)calloc((size_t)faces + 1, sizeof(int));
    for (int i = 0; i < c.nodes; i++) {
        double along = unit * i / c.nodes;
        c.x[i] = sb_v3_add(sb_v3(REAL(along + offset), REAL(offset), 0), cloud_vector(0.05 * unit, seed));
        c.v[i] = cloud_vector(2 * unit, seed);
    }
    for (int f = 0; f < faces; f++) {
        c.sizes[f] = (unsigned char)(size ? size : cloud_sizes[(int)check_random_in(seed, 0, 4.999)]);
        for (int a = 0; a < c.sizes[f]; a++)
            c.corners[f * c.width + a] = 3 * f + a;
        c.order[f] = f;
    }
    return c;
}

static void cloud_free(cloud *c)
{
    free(c->x);
    free(c->v);
    free(c->corners);
    free(c->sizes);
    free(c->order);
}

static void cloud_build(const cloud *c, sbi_face_tree *tree)
{
    sbi_face_tree_source source;
    source.count = c->faces;
    source.faces = c->order;
    source.nodes = c->corners;
    source.sizes = c->sizes;
    sbi_face_tree_build(tree, &source);
}

static sbi_face_tree cloud_tree(const cloud *c)
{
    sbi_face_tree tree;
    sbi_face_tree_room room;
    room.faces = c->faces;
    room.nodes = room.node_end = c->nodes;
    room.width = c->width;
    CHECK(sbi_face_tree_create(&room, NULL, &tree));
    cloud_build(c, &tree);
    return tree;
}

/* A box about a random place of the cloud; now and then one without a bound, or without an inside. */
static void cloud_box(const cloud *c, unsigned long long *seed, sb_vec3 *low, sb_vec3 *high)
{
    sb_vec3 at = c->x[(int)check_random_in(seed, 0, c->nodes - 0.001)], half;
    half = cloud_vector(c->unit * pow(10, check_random_in(seed, -3, 0)), seed);
    half = sb_v3(sb_abs(half.x), sb_abs(half.y), sb_abs(half.z));
    at = sb_v3_add(at, cloud_vector(0.1 * c->unit, seed));
    *low = sb_v3_sub(at, half);
    *high = sb_v3_add(at, half);
    if (check_random(seed) < 0.05)
        low->x = -SB_REAL_MAX;
    if (check_random(seed) < 0.05)
        high->y = SB_REAL_MAX;
}

/* ---- queries ----------------------------------------------------------------------------------------------------- */

static int cloud_meets(sb_vec3 a_low, sb_vec3 a_high, sb_vec3 low, sb_vec3 high, double widen)
{
    sb_real w = REAL(widen);
    return a_low.x <= high.x + w && a_low.y <= high.y + w && a_low.z <= high.z + w && a_high.x >= low.x - w &&
           a_high.y >= low.y - w && a_high.z >= low.z - w;
}

/* All faces whose boxes meet it, one by one; those that do so by rounding only are left to the query. */
static void cloud_check_query(const cloud *c, const sbi_face_tree *tree, sb_vec3 low, sb_vec3 high, uint64_t *marks,
                              int *found)
{
    int count, at = 0, wrong = 0;
    double rounding = 8 * ((double)FLT_EPSILON + (double)SB_EPSILON) * (c->offset + 10 * c->unit);
    unsigned char *is_found = (unsigned char *)calloc((size_t)c->faces + 1, 1);
    memset(found, 0xFF, (size_t)c->faces * sizeof(int));
    count = sbi_face_tree_query(tree, low, high, marks, found, c->faces);
    if (!CHECK(count >= 0 && count <= c->faces))
        count = 0;
    for (int i = 0; i < count; i++) {
        wrong += found[i] < 0 || (i > 0 && found[i] <= found[i - 1]);
        is_found[found[i] < 0 ? 0 : found[i]] = 1;
    }
    CHECK_INT(wrong, 0);
    for (int place = 0; place < c->faces; place++, at++) {
        sb_vec3 box_low, box_high;
        int face = tree->faces[place];
        sbi_face_tree_place_box(tree, place, &box_low, &box_high);
        if (cloud_meets(box_low, box_high, low, high, -rounding))
            wrong += !is_found[face];
        else if (!cloud_meets(box_low, box_high, low, high, 2 * (double)tree->spacing + rounding))
            wrong += is_found[face];
    }
    CHECK_INT(wrong, 0);
    for (int i = 0; i < sbi_face_tree_words(c->faces); i++)
        wrong += marks[i] != 0;
    CHECK_INT(wrong, 0);
    free(is_found);
}

static void test_tree_queries(void)
{
    static const int counts[] = {1, 2, 3, 4, 5, 7, 8, 9, 16, 17, 33, 63, 64, 65, 100, 257};
    unsigned long long seed = 5;
    for (int round = 0; round < (check_quick() ? 12 : 96); round++) {
        int faces = counts[round % 16], kind = round % 6, size = kind == 5 ? 0 : cloud_sizes[kind];
        double unit = pow(10, check_random_in(&seed, -3, 3)), offset = round % 2 ? 0 : 30 * unit;
        cloud c = cloud_make(faces, size, unit, offset, &seed);
        sbi_face_tree tree = cloud_tree(&c), other;
        uint64_t *marks = (uint64_t *)calloc((size_t)sbi_face_tree_words(faces), sizeof *marks);
        int *found = (int *)calloc((size_t)faces, sizeof(int)), *again = (int *)calloc((size_t)faces, sizeof(int));
        cloud_shuffle(&c, &seed);
        other = cloud_tree(&c);
        for (int move = 0; move < 3; move++) { /* refits after large motions */
            sbi_face_tree_refit(&tree, c.x, move == 1 ? NULL : c.v, c.dt);
            sbi_face_tree_refit(&other, c.x, move == 1 ? NULL : c.v, c.dt);
            for (int q = 0; q < 30; q++) {
                sb_vec3 low, high;
                int count, capacity = (int)check_random_in(&seed, 0, faces + 0.999);
                cloud_box(&c, &seed, &low, &high);
                cloud_check_query(&c, &tree, low, high, marks, found);
                /* the same whatever the order, and the first of them when there is no room for all */
                count = sbi_face_tree_query(&tree, low, high, marks, found, faces);
                CHECK_INT(sbi_face_tree_query(&other, low, high, marks, again, capacity), count);
                count = count < capacity ? count : capacity;
                CHECK(!memcmp(found, again, (size_t)count * sizeof(int)));
            }
            for (int i = 0; i < c.nodes; i++)
                c.x[i] = sb_v3_add(sb_v3(c.x[i].y, REAL(1.5) * c.x[i].z, -c.x[i].x), cloud_vector(unit, &seed));
        }
        sbi_face_tree_free(&tree, NULL);
        sbi_face_tree_free(&other, NULL);
        cloud_free(&c);
        free(marks);
        free(found);
        free(again);
    }
}

/* ---- curved faces ------------------------------------------------------------------------------------------------ */

static sb_element_type cloud_type(int size)
{
    return size == 3 ? SB_TRI3 : size == 4 ? SB_QUAD4 : size == 6 ? SB_TRI6 : size == 8 ? SB_QUAD8 : SB_QUAD9;
}

/* A point of a face on its way, edges and corners among them. */
static sb_vec3 cloud_point(const cloud *c, int face, unsigned long long *seed)
{
    int size = c->sizes[face], triangle = size == 3 || size == 6;
    sb_real shape[CLOUD_WIDTH], xi[3] = {0, 0, 0}, way = check_random(seed) < 0.5 ? 1 : REAL(check_random(seed));
    sb_vec3 sum = sb_v3(0, 0, 0);
    double r = check_random(seed) < 0.3 ? 0 : check_random(seed), s = check_random(seed) < 0.3 ? 0 : check_random(seed);
    if (triangle && r + s > 1)
        r = 1 - r, s = 1 - s;
    xi[0] = REAL(triangle ? r : 2 * r - 1);
    xi[1] = REAL(triangle ? s : 2 * s - 1);
    sb_element_shape(cloud_type(size), xi, shape, NULL);
    for (int a = 0; a < size; a++) {
        int node = c->corners[face * c->width + a];
        sum = sb_v3_madd(sum, shape[a], sb_v3_madd(c->x[node], way * c->dt, c->v[node]));
    }
    return sum;
}

static void test_tree_holds_curved_faces(void)
{
    unsigned long long seed = 9;
    for (int round = 0; round < (check_quick() ? 6 : 60); round++) {
        int size = round % 6 == 5 ? 0 : cloud_sizes[round % 6];
        double unit = pow(10, check_random_in(&seed, -3, 3)), offset = round % 2 ? 0 : 30 * unit;
        cloud c = cloud_make(13, size, unit, offset, &seed);
        sbi_face_tree tree = cloud_tree(&c);
        double rounding = 8 * (double)SB_EPSILON * (offset + 10 * unit);
        sbi_face_tree_refit(&tree, c.x, c.v, c.dt);
        for (int place = 0; place < c.faces; place++) {
            sb_vec3 low, high;
            int outside = 0;
            sbi_face_tree_place_box(&tree, place, &low, &high);
            for (int i = 0; i < 1500; i++) {
                sb_vec3 x = cloud_point(&c, tree.faces[place], &seed);
                outside += !cloud_meets(low, high, x, x, rounding);
            }
            CHECK_INT(outside, 0);
        }
        sbi_face_tree_free(&tree, NULL);
        cloud_free(&c);
    }
}

/* quad8 is quad9 with its ninth node where its polynomial says. */
static void test_tree_quad8(void)
{
    unsigned long long seed = 10;
    cloud eight = cloud_make(40, 8, 1, 0, &seed), nine = cloud_make(40, 9, 1, 0, &seed);
    sbi_face_tree a = cloud_tree(&eight), b = cloud_tree(&nine);
    for (int f = 0; f < 40; f++) { /* a face has the numbers from 3 f on: those of other faces, too */
        sb_vec3 centre = sb_v3(0, 0, 0), box[4];
        for (int k = 0; k < 9; k++)
            nine.x[3 * f + k] = k < 8 ? eight.x[3 * f + k] : centre;
        for (int k = 0; k < 8; k++)
            centre = sb_v3_madd(centre, k < 4 ? REAL(-0.25) : REAL(0.5), eight.x[3 * f + k]);
        nine.x[3 * f + 8] = centre;
        sbi_face_tree_refit(&a, eight.x, NULL, 0);
        sbi_face_tree_refit(&b, nine.x, NULL, 0);
        sbi_face_tree_place_box(&a, f, &box[0], &box[1]);
        sbi_face_tree_place_box(&b, f, &box[2], &box[3]);
        CHECK(scene_distance(box, box + 2, 2) <= 4 * (double)sb_max(a.spacing, b.spacing));
    }
    sbi_face_tree_free(&a, NULL);
    sbi_face_tree_free(&b, NULL);
    cloud_free(&eight);
    cloud_free(&nine);
}

/* A face that bulges beyond its nodes: the query finds it there. */
static void test_tree_finds_a_bulge(void)
{
    static const sb_vec3 x[6] = {
        {0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {REAL(0.2), 0, REAL(0.3)}, {REAL(0.5), REAL(0.5), 0}, {0, REAL(0.5), 0}};
    int corners[6] = {0, 1, 2, 3, 4, 5}, order[1] = {0}, found;
    unsigned char sizes[1] = {6};
    sbi_face_tree tree;
    sbi_face_tree_room room = {1, 6, 6, 6};
    sbi_face_tree_source source;
    uint64_t marks = 0;
    source.count = 1, source.faces = order, source.nodes = corners, source.sizes = sizes;
    if (!CHECK(sbi_face_tree_create(&room, NULL, &tree)))
        return;
    sbi_face_tree_build(&tree, &source);
    sbi_face_tree_refit(&tree, x, NULL, 0);
    /* x = r (2 r - 1) + 0.2 4 r (1 - r) of the edge is least at r = 1/12: -1/120, beyond all nodes */
    CHECK_INT(sbi_face_tree_query(&tree, sb_v3(-1, -1, -1), sb_v3(REAL(-0.001), 1, 1), &marks, &found, 1), 1);
    CHECK_INT(sbi_face_tree_query(&tree, sb_v3(-1, -1, -1), sb_v3(REAL(-0.2), 1, 1), &marks, &found, 1), 0);
    sbi_face_tree_free(&tree, NULL);
}

/* ---- memory and emptiness ---------------------------------------------------------------------------------------- */

static void test_tree_without_faces(void)
{
    sbi_face_tree_room room = {0, 0, 0, 3};
    sbi_face_tree_source source = {0, NULL, NULL, NULL};
    sbi_face_tree tree;
    uint64_t marks = 0;
    int found;
    if (!CHECK(sbi_face_tree_create(&room, NULL, &tree)))
        return;
    sbi_face_tree_build(&tree, &source);
    sbi_face_tree_refit(&tree, NULL, NULL, 0);
    CHECK_INT(sbi_face_tree_query(&tree, sb_v3(-1, -1, -1), sb_v3(1, 1, 1), &marks, &found, 1), 0);
    sbi_face_tree_free(&tree, NULL);
}

static void test_tree_memory(void)
{
    scene_memory memory = {0, 0, 1, 0};
    sb_allocator allocator = scene_allocator(&memory);
    sbi_face_tree_room room = {5, 9, 9, 3};
    sbi_face_tree tree;
    CHECK(!sbi_face_tree_create(&room, &allocator, &tree));
    CHECK_INT(memory.live, 0);
    room.faces = INT_MAX; /* more than 2^31-1 places */
    room.nodes = room.node_end = INT_MAX;
    if (sizeof(size_t) == 4)
        CHECK(!sbi_face_tree_create(&room, &allocator, &tree));
}

CHECK_SUITE(face_tree, {"queries find what one by one does", test_tree_queries},
            {"boxes hold curved faces on their way", test_tree_holds_curved_faces},
            {"quad8 has a place in its middle", test_tree_quad8},
            {"finds a face beyond its nodes", test_tree_finds_a_bulge}, {"without faces", test_tree_without_faces},
            {"memory", test_tree_memory});
