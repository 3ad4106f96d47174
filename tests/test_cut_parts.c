/* Parts of bodies (sb_body_parts): of meshes that several were joined into, of bodies with free cells, and of cut ones
 * against clipped tets. */
#include "cut_block.h"

/* ---- by other means ---------------------------------------------------------------------------------------------- */

/* Volume (m^3) and first moment (m^4) of a solid. */
typedef struct solid {
    double volume, first[3];
} solid;

static void solid_add_tet(solid *s, const sb_vec3 x[4])
{
    double e[3][3], at[3] = {0, 0, 0}, volume;
    for (int a = 0; a < 4; a++) {
        at[0] += (double)x[a].x / 4, at[1] += (double)x[a].y / 4, at[2] += (double)x[a].z / 4;
        if (a > 0) {
            e[a - 1][0] = (double)x[a].x - (double)x[0].x;
            e[a - 1][1] = (double)x[a].y - (double)x[0].y;
            e[a - 1][2] = (double)x[a].z - (double)x[0].z;
        }
    }
    volume = e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) - e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
             e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0]);
    volume = fabs(volume) / 6;
    s->volume += volume;
    for (int k = 0; k < 3; k++)
        s->first[k] += volume * at[k];
}

/* Where the edge from a to b meets the plane that they are so high over. */
static sb_vec3 meet(sb_vec3 a, sb_vec3 b, double over_a, double over_b)
{
    return sb_v3_madd(a, REAL(over_a / (over_a - over_b)), sb_v3_sub(b, a));
}

/* Adds what of a tet is over a plane (over 0): `over` are its corners' heights. */
static void solid_add_clipped(solid *s, const sb_vec3 corners[4], const double heights[4])
{
    sb_vec3 x[4], y[4];
    double h[4];
    int up = 0, down = 4;
    for (int a = 0; a < 4; a++) {
        int at = heights[a] > 0 ? up++ : --down;
        x[at] = corners[a], h[at] = heights[a];
    }
    if (up == 4)
        solid_add_tet(s, x);
    if (up == 1) {
        y[0] = x[0];
        for (int a = 1; a < 4; a++)
            y[a] = meet(x[0], x[a], h[0], h[a]);
        solid_add_tet(s, y);
    }
    if (up == 2 || up == 3) { /* a prism: the triangles p and q, as three tets */
        sb_vec3 p[3], q[3];
        p[0] = x[0], p[1] = up == 3 ? x[1] : meet(x[0], x[2], h[0], h[2]);
        p[2] = up == 3 ? x[2] : meet(x[0], x[3], h[0], h[3]);
        q[0] = up == 3 ? meet(x[0], x[3], h[0], h[3]) : x[1];
        q[1] = meet(x[1], up == 3 ? x[3] : x[2], h[1], up == 3 ? h[3] : h[2]);
        q[2] = up == 3 ? meet(x[2], x[3], h[2], h[3]) : meet(x[1], x[3], h[1], h[3]);
        for (int k = 0; k < 3; k++) {
            for (int a = 0; a < 3; a++)
                y[a] = a < k ? q[a] : p[a];
            y[3] = q[k];
            solid_add_tet(s, y);
        }
    }
}

/* What of the mesh is over the plane through `middle`, with its nodes at x. */
static solid solid_clipped(const sb_mesh *mesh, const sb_vec3 *x, sb_vec3 middle, sb_vec3 normal)
{
    solid s;
    memset(&s, 0, sizeof s);
    for (int e = 0; e < mesh->element_count; e++) {
        sb_vec3 corners[4];
        double heights[4];
        for (int a = 0; a < 4; a++) {
            corners[a] = x[mesh->elements[4 * e + a]];
            heights[a] = (double)sb_v3_dot(normal, sb_v3_sub(corners[a], middle));
        }
        solid_add_clipped(&s, corners, heights);
    }
    return s;
}

/* ---- what holds of every list ------------------------------------------------------------------------------------ */

enum { MOST = 64 };

/* The list agrees with the cells, whose nodes are of one part, and with the body's sums; returns how many there are. */
static int check_list(sb_body *body, sb_part parts[MOST])
{
    int nodes = sb_body_node_count(body), count = -1, more = -1, counted[MOST] = {0};
    int *numbers = (int *)malloc((size_t)nodes * sizeof *numbers);
    double mass = 0;
    sb_part few[2] = {{-7, -7, 0, 0, {0, 0, 0}}, {-7, -7, 0, 0, {0, 0, 0}}};
    CHECK_OK(sb_body_parts(body, parts, MOST, &count, numbers));
    CHECK_OK(sb_body_parts(body, NULL, 0, &more, NULL));
    CHECK_INT(more, count);
    CHECK_OK(sb_body_parts(body, few, 1, &more, NULL));
    CHECK(memcmp(few, parts, sizeof few[0]) == 0 && few[1].node == -7 && more == count);
    for (int i = 0; i < nodes; i++)
        if (CHECK(numbers[i] >= -1 && numbers[i] < count) && numbers[i] >= 0 && numbers[i] < MOST) {
            CHECK(i >= parts[numbers[i]].node);
            counted[numbers[i]]++;
        }
    for (int k = 0; k < count && k < MOST; k++) {
        CHECK_INT(numbers[parts[k].node], k);
        CHECK_INT(parts[k].node_count, counted[k]);
        CHECK(k == 0 || parts[k].node > parts[k - 1].node);
        CHECK(parts[k].volume > 0 && parts[k].mass > 0 && sb_v3_is_finite(parts[k].centre));
        mass += (double)parts[k].mass;
    }
    if (count <= MOST)
        CHECK_NEAR(mass, sb_body_mass(body), scene_tolerance(1e-12, 1000) * mass);
    for (int e = 0; e < sb_body_element_count(body); e++)
        if (sb_body_cell_in_use(body, e) && sb_body_cell_share(body, e) > 0)
            for (int a = 0; a < 4; a++)
                CHECK_INT(numbers[sb_body_cell_nodes(body, e)[a]], numbers[sb_body_cell_nodes(body, e)[0]]);
    free(numbers);
    return count;
}

/* ---- clipped meshes ---------------------------------------------------------------------------------------------- */

/* An affine motion that turns, stretches and shears the body. */
static void deform(const block *b, unsigned long long *seed)
{
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)sb_body_node_count(b->body), sizeof *u);
    sb_vec3 shift = vector_in(-0.1, 0.1, seed), rows[3];
    for (int k = 0; k < 3; k++)
        rows[k] = vector_in(-0.3, 0.3, seed);
    for (int i = 0; i < b->mesh.node_count; i++) {
        sb_vec3 x = b->mesh.nodes[i];
        u[i] = sb_v3_add(shift, sb_v3(sb_v3_dot(rows[0], x), sb_v3_dot(rows[1], x), sb_v3_dot(rows[2], x)));
    }
    CHECK_OK(sb_body_set_displacements(b->body, u));
    free(u);
}

static void check_side(const sb_part *part, const solid *side, double stretch, double size)
{
    double close = scene_tolerance(1e-6, 400), volume = side->volume / stretch;
    double centre[3] = {(double)part->centre.x, (double)part->centre.y, (double)part->centre.z};
    CHECK_NEAR(part->volume, volume, close * size * size * size);
    CHECK_NEAR(part->mass, 1000 * volume, 1000 * close * size * size * size);
    for (int k = 0; k < 3; k++)
        CHECK_NEAR(centre[k], side->first[k] / side->volume, 20 * close * size);
}

/* One plane through a random mesh that is deformed: both parts are the clipped halves, at rest and now. */
static void check_clipped(int lattice, unsigned long long *seed)
{
    block_options options = block_default(lattice);
    const double size = (double)sb_v3_norm(block_size);
    sb_part parts[MOST];
    solid sides[2];
    sb_vec3 *x, middle = {0, 0, 0}, normal;
    double stretch, volume = 0;
    block b;
    int count;
    options.nx = 2 + (int)check_random_in(seed, 0, 4.999);
    options.ny = 2 + (int)check_random_in(seed, 0, 3.999);
    options.nz = 2 + (int)check_random_in(seed, 0, 3.999);
    b = block_make(&options);
    CHECK_INT(check_list(b.body, parts), 1);
    CHECK_INT(parts[0].node, 0);
    deform(&b, seed);
    x = (sb_vec3 *)malloc((size_t)b.mesh.node_count * sizeof *x);
    memcpy(x, sb_body_positions(b.body), (size_t)b.mesh.node_count * sizeof *x);
    for (int i = 0; i < b.mesh.node_count; i++)
        middle = sb_v3_madd(middle, REAL(1.0 / b.mesh.node_count), x[i]);
    normal = vector_in(-1, 1, seed);
    sides[0] = solid_clipped(&b.mesh, x, middle, normal);
    sides[1] = solid_clipped(&b.mesh, x, middle, sb_v3_scale(-1, normal));
    for (int e = 0; e < b.mesh.element_count; e++)
        volume += (double)sb_mesh_element_volume(&b.mesh, e);
    stretch = (sides[0].volume + sides[1].volume) / volume;
    CHECK_INT(block_cut_plane(&b, middle, normal).parts, 2);
    count = check_list(b.body, parts);
    for (int k = 0; k < count && CHECK_INT(count, 2); k++) {
        int below = sb_v3_dot(normal, sb_v3_sub(parts[k].centre, middle)) < 0;
        check_side(parts + k, sides + below, stretch, size);
    }
    free(x);
    block_free(&b);
}

static void test_planes(void)
{
    unsigned long long seed = 5;
    int rounds = check_quick() ? 2 : check_rounds(15);
    for (int round = 0; round < rounds; round++)
        for (int i = 0; i < 3; i++)
            check_clipped(intervals_of[i], &seed);
}

/* Strips and planes without a plan: crumbs, halves that stay joined, empty pieces. What the cut says is what is
 * listed, and reading changes nothing. */
static void test_random_strips(void)
{
    unsigned long long seed = 11;
    int rounds = check_quick() ? 1 : check_rounds(5);
    for (int round = 0; round < rounds; round++)
        for (int i = 0; i < 3; i++) {
            block_options options = block_default(intervals_of[i]);
            block b = block_make(&options);
            double volume = 0;
            sb_part parts[MOST];
            int count = 0;
            block_shake(&b);
            for (int stroke = 0; stroke < 6; stroke++) {
                sb_vec3 triangles[18];
                int triangle_count = strip_random(triangles, &seed);
                uint64_t hash;
                block_cut(&b, triangles, triangle_count);
                hash = sb_body_state_hash(b.body);
                count = check_list(b.body, parts);
                CHECK(sb_body_state_hash(b.body) == hash);
                block_step(&b, 1);
            }
            for (int k = 0; k < count && k < MOST; k++)
                volume += (double)parts[k].volume;
            if (count <= MOST)
                CHECK_NEAR(volume, block_size.x * block_size.y * block_size.z, scene_tolerance(1e-12, 1000) * volume);
            block_free(&b);
        }
}

/* A plane in the block's own face: what it parts off has no material and is no part. */
static void test_empty_parts(void)
{
    for (int i = 0; i < 3; i++)
        for (int end = 0; end < 2; end++) {
            block_options options = block_default(intervals_of[i]);
            block b;
            sb_part parts[MOST];
            options.shake = 0;
            b = block_make(&options);
            block_cut_plane(&b, sb_v3(end ? block_size.x : 0, REAL(0.02), REAL(0.025)), sb_v3(1, 0, 0));
            CHECK_INT(check_list(b.body, parts), 1);
            CHECK_NEAR(parts[0].centre.x, block_size.x / 2, scene_tolerance(1e-12, 1000) * (double)block_size.x);
            block_free(&b);
        }
}

/* ---- joined meshes ----------------------------------------------------------------------------------------------- */

/* Gives the nodes other numbers, at random. */
static void shuffle(sb_mesh *mesh, unsigned long long *seed)
{
    int n = mesh->node_count, width = sb_mesh_element_width(mesh);
    int *to = (int *)malloc((size_t)n * sizeof *to);
    sb_vec3 *nodes = (sb_vec3 *)malloc((size_t)n * sizeof *nodes);
    for (int i = 0; i < n; i++)
        to[i] = i;
    for (int i = n - 1; i > 0; i--) {
        int k = (int)check_random_in(seed, 0, i + 0.999), was = to[i];
        to[i] = to[k], to[k] = was;
    }
    for (int i = 0; i < n; i++)
        nodes[to[i]] = mesh->nodes[i];
    for (int k = 0; k < mesh->element_count * width; k++)
        mesh->elements[k] = to[mesh->elements[k]];
    memcpy(mesh->nodes, nodes, (size_t)n * sizeof *nodes);
    free(nodes);
    free(to);
}

/* Boxes of one mesh, with nodes in any order, some of a heavier region, of each element: each is found with its
 * volume, mass and centre. */
static void check_boxes(sb_element_type type, sb_mass_kind kind, unsigned long long *seed)
{
    enum { BOXES = 4 };
    sb_region_material heavy;
    sb_body_def def = sb_default_body_def();
    sb_mesh mesh;
    sb_part parts[BOXES];
    int count = 0, found = 0;
    double close = scene_tolerance(1e-12, 2000);
    memset(&mesh, 0, sizeof mesh);
    for (int k = 0; k < BOXES; k++) {
        sb_mesh box = scene_box(type, 1 + k, 2, 1, sb_v3(REAL(0.01 * (k + 1)), REAL(0.02), REAL(0.01)), 0);
        box.regions = (int *)calloc((size_t)box.element_count, sizeof(int));
        for (int e = 0; e < box.element_count; e++)
            box.regions[e] = k % 2;
        for (int i = 0; i < box.node_count; i++)
            box.nodes[i].z += REAL(0.1 * k);
        if (k == 0) {
            mesh = box;
            continue;
        }
        CHECK_OK(sb_mesh_append(&mesh, &box, NULL));
        sb_mesh_free(&box);
    }
    shuffle(&mesh, seed);
    heavy.region = 1;
    heavy.material = sb_material_corotated(REAL(5000), REAL(0.3), 3000);
    def.mesh = &mesh;
    def.mass = kind;
    def.material = sb_material_corotated(REAL(5000), REAL(0.3), 1000);
    def.region_materials = &heavy;
    def.region_material_count = 1;
    {
        sb_body *body = scene_body(&def);
        CHECK_OK(sb_body_parts(body, parts, BOXES, &count, NULL));
        CHECK_INT(count, BOXES);
        for (int k = 0; k < BOXES && k < count; k++) {
            int box = (int)floor(10 * (double)parts[k].centre.z);
            double volume = 0.01 * (box + 1) * 0.02 * 0.01;
            CHECK(k == 0 || parts[k].node > parts[k - 1].node);
            CHECK_INT((int)floor(10 * (double)mesh.nodes[parts[k].node].z + 1e-6), box);
            CHECK_NEAR(parts[k].volume, volume, close * volume);
            CHECK_NEAR(parts[k].mass, volume * (box % 2 ? 3000 : 1000), close * volume * 3000);
            CHECK_NEAR(parts[k].centre.x, 0.005 * (box + 1), close);
            CHECK_NEAR(parts[k].centre.y, 0.01, close);
            CHECK_NEAR(parts[k].centre.z, 0.1 * box + 0.005, close);
            found |= 1 << box;
        }
        CHECK_INT(found, (1 << BOXES) - 1);
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
}

static void test_joined(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    unsigned long long seed = 8;
    for (int i = 0; i < (int)(sizeof types / sizeof types[0]); i++)
        for (int kind = 0; kind < 2; kind++)
            check_boxes(types[i], kind ? SB_MASS_CONSISTENT : SB_MASS_LUMPED, &seed);
}

/* Cells that were removed weigh nothing, and nodes that went with them are of no part. */
static void test_free_cells(void)
{
    block_options options = block_default(1);
    block b = block_make(&options);
    sb_part parts[MOST];
    double volume = 0, sum = 0;
    int count;
    sb_cut_destroy(b.cut);
    b.cut = NULL;
    scene_remove_cells(b.body);
    for (int e = 0; e < b.mesh.element_count; e++)
        if (sb_body_cell_in_use(b.body, e))
            volume += (double)sb_mesh_element_volume(&b.mesh, e);
    count = check_list(b.body, parts);
    for (int k = 0; k < count && k < MOST; k++)
        sum += (double)parts[k].volume;
    CHECK_NEAR(sum, volume, scene_tolerance(1e-12, 1000) * volume);
    block_free(&b);
}

static void test_mistakes(void)
{
    block_options options = block_default(1);
    block b = block_make(&options);
    sb_part part;
    int count = -5;
    CHECK_RESULT(sb_body_parts(NULL, &part, 1, &count, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_parts(b.body, &part, 1, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_parts(b.body, NULL, 1, &count, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_parts(b.body, &part, -1, &count, NULL), SB_ERROR_ARGUMENT);
    CHECK_INT(count, -5);
    block_free(&b);
}

CHECK_SUITE(cut_parts, {"planes through random meshes", test_planes}, {"strips at random", test_random_strips},
            {"empty pieces are no part", test_empty_parts}, {"joined meshes in any order", test_joined},
            {"free cells", test_free_cells}, {"mistakes", test_mistakes});
