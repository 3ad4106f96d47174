/* A fine skin of the user's that is cut along with the body: closed by lips and rims, each piece with its material. */
#include "fine_skin.h"

/* The skin of a block of finer cells, `grown` times as large about its middle. */
static sb_mesh skin_of(int nx, int ny, int nz, double grown)
{
    sb_mesh fine = scene_box(SB_TET4, nx, ny, nz, block_size, 0), skin;
    sb_vec3 middle = sb_v3_scale(REAL(0.5), block_size);
    sb_boundary boundary;
    CHECK_OK(sb_mesh_boundary(&fine, 1, NULL, &boundary, NULL));
    CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &skin, NULL));
    for (int i = 0; i < skin.node_count; i++)
        skin.nodes[i] = sb_v3_madd(middle, REAL(grown), sb_v3_sub(skin.nodes[i], middle));
    sb_boundary_free(&boundary);
    sb_mesh_free(&fine);
    return skin;
}

static sb_cut_fine *fine_make(const block *b, const sb_mesh *skin)
{
    sb_cut_fine *fine = NULL;
    sb_error error;
    if (!CHECK_OK(sb_cut_fine_create(b->cut, skin, NULL, &fine, &error)))
        printf("%s\n", error.message);
    return fine;
}

static double area_of_mesh(const sb_mesh *skin)
{
    double area = 0;
    for (int f = 0; f < skin->element_count; f++) {
        const int *v = skin->elements + 3 * (size_t)f;
        area += (double)sb_v3_norm(sb_v3_cross(sb_v3_sub(skin->nodes[v[1]], skin->nodes[v[0]]),
                                               sb_v3_sub(skin->nodes[v[2]], skin->nodes[v[0]]))) /
                2;
    }
    return area;
}

/* The user's vertices are the first, in their order, each is made of the skin's as it says, and areas add up. */
static void check_skin(const sb_mesh *skin, const sb_cut_fine_drawing *d)
{
    double area = area_of_mesh(skin);
    CHECK_NEAR(area_of(&d->drawn, SB_CUT_SKIN), area, scene_tolerance(1e-13, 300) * area);
    CHECK(d->drawn.vertex_count >= skin->node_count);
    for (int i = 0; i < d->drawn.vertex_count; i++) {
        const sb_cut_fine_source *source = d->sources + i;
        sb_vec3 x = {0, 0, 0};
        if (i < skin->node_count)
            CHECK(memcmp(d->drawn.rest + i, skin->nodes + i, sizeof(sb_vec3)) == 0 && source->vertices[0] == i);
        if (source->vertices[0] < 0)
            continue;
        for (int k = 0; k < 3; k++)
            x = sb_v3_madd(x, source->weights[k], skin->nodes[source->vertices[k]]);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(x, d->drawn.rest[i])), 0, scene_tolerance(1e-15, 100));
    }
}

/* ---- planes ------------------------------------------------------------------------------------------------------ */

/* A block falls in two, then in four: so many closed surfaces, with their volumes. A skin on the mesh's boundary, one
 * inside and one outside of it. */
static void test_planes(void)
{
    static const double grown[3] = {1, 0.98, 1.02};
    double worst = 0;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < (check_quick() || i != 1 ? 1 : 3); k++) {
            block_options options = block_default(intervals_of[i]);
            block b = block_make(&options);
            sb_mesh skin = skin_of(19, 13, 16, grown[k]);
            sb_cut_fine *fine = fine_make(&b, &skin);
            sb_cut_fine_drawing d = sb_cut_fine_get(fine);
            const double y = (double)block_size.y, z = (double)block_size.z;
            int euler, surfaces = check_closed(&d.drawn, &euler);
            CHECK(surfaces == 1 && euler == 2 && d.open_edges == 0 && d.drawn.vertex_count == skin.node_count);
            check_skin(&skin, &d);
            block_cut_plane(&b, sb_v3(REAL(0.0277), block_size.y / 2, block_size.z / 2), sb_v3(1, REAL(-0.2), 0));
            CHECK_OK(sb_cut_fine_update(fine, NULL));
            d = sb_cut_fine_get(fine);
            surfaces = check_closed(&d.drawn, &euler);
            CHECK_INT(surfaces, 2);
            CHECK_INT(euler, 4);
            CHECK_INT(d.open_edges, 0);
            CHECK_NEAR(area_of(&d.drawn, SB_CUT_LIP), 2 * y * z * sqrt(1.04), scene_tolerance(5e-5, 200) * y * z);
            check_skin(&skin, &d);
            if (k == 0)
                worst = fmax(worst, volumes_error_in(&b, &d.drawn, 1));
            CHECK(area_of(&d.drawn, SB_CUT_RIM) < 0.2 * area_of(&d.drawn, SB_CUT_LIP));
            block_cut_plane(&b, sb_v3(REAL(0.03), REAL(0.0207), REAL(0.0252)), sb_v3(0, REAL(0.3), 1));
            CHECK_OK(sb_cut_fine_update(fine, NULL));
            d = sb_cut_fine_get(fine);
            surfaces = check_closed(&d.drawn, &euler);
            CHECK(surfaces == 4 && euler == 8 && d.open_edges == 0 && b.body->component_count == 4);
            CHECK(area_of(&d.drawn, SB_CUT_RIM) < 0.2 * area_of(&d.drawn, SB_CUT_LIP));
            check_skin(&skin, &d);
            printf("   m = %d, grown %g: %d parts, %d edges open, rims %g of the lips\n", intervals_of[i], grown[k],
                   b.body->component_count, d.open_edges,
                   area_of(&d.drawn, SB_CUT_RIM) / area_of(&d.drawn, SB_CUT_LIP));
            sb_cut_fine_destroy(fine);
            sb_mesh_free(&skin);
            block_free(&b);
        }
    printf("   parts' volumes off by %.1e of the block\n", worst);
    CHECK_NEAR(worst, 0, 1e-4);
}

/* ---- at random --------------------------------------------------------------------------------------------------- */

/* What was followed through all cuts so far is, to the bit, what a skin is that is made of the body as it is now. */
static void check_made_anew(const block *b, const sb_mesh *skin, const sb_cut_fine *fine)
{
    sb_cut_fine *anew = fine_make(b, skin);
    sb_cut_fine_drawing followed = sb_cut_fine_get(fine), made = sb_cut_fine_get(anew);
    CHECK_INT(followed.drawn.vertex_count, made.drawn.vertex_count);
    CHECK_INT(followed.drawn.triangle_count, made.drawn.triangle_count);
    for (int f = 0; f < made.drawn.triangle_count && made.drawn.tags[f] == SB_CUT_SKIN; f++) {
        const int *v = made.drawn.triangles[f];
        CHECK(followed.drawn.tags[f] == SB_CUT_SKIN && memcmp(followed.drawn.triangles[f], v, 3 * sizeof *v) == 0);
        for (int k = 0; k < 3; k++) {
            CHECK(memcmp(followed.drawn.rest + v[k], made.drawn.rest + v[k], sizeof(sb_vec3)) == 0);
            CHECK(memcmp(followed.drawn.positions + v[k], made.drawn.positions + v[k], sizeof(sb_vec3)) == 0);
        }
    }
    sb_cut_fine_destroy(anew);
}

/* Strokes that end anywhere, with and without glue, and balls that are burnt out: always closed. A state takes all
 * back. */
static void test_strokes(void)
{
    unsigned long long seed = 301;
    fine_rims rims = {0, 0, 0, 0, 0, 0};
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < (check_quick() ? 1 : 2); round++) {
            block_options options = block_default(intervals_of[i]);
            sb_mesh skin = skin_of(19, 13, 16, 0.99 + 0.02 * round);
            sb_cut_fine *fine;
            sb_cut_fine_drawing d;
            size_t size;
            void *image;
            int vertices;
            block b;
            options.front = round % 2 ? SB_CUT_GLUE : SB_CUT_LAG;
            b = block_make(&options);
            fine = fine_make(&b, &skin);
            size = sb_body_state_size(b.body);
            image = malloc(size);
            CHECK_OK(sb_body_state_save(b.body, image, size));
            vertices = sb_cut_fine_get(fine).drawn.vertex_count;
            block_shake(&b);
            for (int stroke = 0; stroke < 5; stroke++) {
                sb_vec3 triangles[18], middle = vector_in(0, 0.05, &seed);
                int count = strip_random(triangles, &seed), holes, more;
                if (stroke == 3)
                    CHECK_OK(sb_cut_ablate(b.cut, middle, REAL(0.008), NULL, NULL));
                else
                    block_cut(&b, triangles, count);
                block_step(&b, 1);
                CHECK_OK(sb_cut_fine_update(fine, NULL));
                d = sb_cut_fine_get(fine);
                holes = holes_of(&d.drawn, &more);
                CHECK(holes == 0 && d.open_edges == 0);
                CHECK(memcmp(d.drawn.rest, skin.nodes, (size_t)skin.node_count * sizeof(sb_vec3)) == 0);
                if (stroke < 3)
                    check_skin(&skin, &d);
                check_made_anew(&b, &skin, fine);
                fine_rims_add(&rims, b.cut, fine);
            }
            CHECK_OK(sb_body_state_load(b.body, image, size, NULL));
            CHECK_OK(sb_cut_fine_update(fine, NULL));
            d = sb_cut_fine_get(fine);
            CHECK(d.drawn.vertex_count == vertices && d.open_edges == 0);
            block_cut_plane(&b, sb_v3(REAL(0.0277), block_size.y / 2, block_size.z / 2), sb_v3(1, REAL(-0.2), 0));
            CHECK_OK(sb_cut_fine_update(fine, NULL));
            check_made_anew(&b, &skin, fine);
            free(image);
            sb_cut_fine_destroy(fine);
            sb_mesh_free(&skin);
            block_free(&b);
        }
    printf("   %d drawings, %d triangles of rims, %.2g of their area across cuts, %.2g between parts\n", rims.drawings,
           rims.triangles, rims.apart / rims.area, rims.between / rims.area);
    CHECK(rims.apart < 0.15 * rims.area); /* ends of cuts, and those that the skin does not see */
    CHECK(rims.between <= scene_tolerance(1e-12, 1e4) * (double)sb_v3_dot(block_size, block_size));
}

/* A skin with a hole of its own, that a cut goes through: only this stays open, as many edges as there are. One with
 * triangles larger than elements, and cuts that it does not see: closed, with a pocket below. */
static void test_other_skins(void)
{
    block_options options = block_default(2);
    sb_mesh skin = skin_of(9, 6, 8, 1), coarse = skin_of(2, 1, 1, 1);
    const sb_vec3 top = sb_v3(REAL(0.031), REAL(0.0205), block_size.z);
    int hole = -1, more, pocket = 0;
    for (int f = 0; f < skin.element_count && hole < 0; f++) {
        sb_vec3 x = skin.nodes[skin.elements[3 * f]], y = skin.nodes[skin.elements[3 * f + 1]];
        hole = x.z > REAL(0.999) * top.z && y.z > REAL(0.999) * top.z && x.x < top.x && y.x > top.x ? f : -1;
    }
    CHECK(hole >= 0);
    for (int k = 0; k < 3; k++)
        skin.elements[3 * hole + k] = skin.elements[3 * (skin.element_count - 1) + k];
    skin.element_count--;
    for (int k = 0; k < 2; k++) {
        block b = block_make(&options);
        sb_cut_fine *fine = fine_make(&b, k ? &coarse : &skin);
        sb_cut_fine_drawing d = sb_cut_fine_get(fine);
        sb_vec3 square[6];
        CHECK_INT(d.open_edges, k ? 0 : 3);
        CHECK_INT(holes_of(&d.drawn, &more), d.open_edges);
        if (k)
            square_make(top, sb_v3(REAL(0.3), 1, REAL(0.1)), 0.011, square);
        else
            square_make(sb_v3(top.x, block_size.y / 2, block_size.z / 2), sb_v3(1, REAL(0.001), 0), 0.2, square);
        block_cut(&b, square, 2);
        CHECK_OK(sb_cut_fine_update(fine, NULL));
        d = sb_cut_fine_get(fine);
        CHECK(k ? d.open_edges == 0 : d.open_edges > 3);
        CHECK_INT(holes_of(&d.drawn, &more), d.open_edges);
        for (int f = 0; f < d.drawn.triangle_count; f++)
            pocket += k && d.drawn.tags[f] == SB_CUT_LIP;
        sb_cut_fine_destroy(fine);
        block_free(&b);
    }
    CHECK(pocket > 0);
    sb_mesh_free(&coarse);
    sb_mesh_free(&skin);
}

/* One half moves away as a rigid body: what is drawn of it goes along, on both sides of the seam. */
static void test_motion(void)
{
    block_options options = block_default(2);
    block b = block_make(&options);
    sb_mesh skin = skin_of(17, 11, 15, 1);
    sb_cut_fine *fine = fine_make(&b, &skin);
    sb_cut_fine_drawing d;
    const sb_vec3 way = sb_v3(REAL(0.01), REAL(0.02), REAL(-0.03));
    const sb_body *body = b.body;
    double worst = 0;
    int moved = 0, part, vertices;
    sb_vec3 *u;
    block_cut_plane(&b, sb_v3(REAL(0.0277), block_size.y / 2, block_size.z / 2), sb_v3(1, REAL(-0.2), REAL(0.1)));
    CHECK_OK(sb_cut_fine_update(fine, NULL));
    vertices = sb_cut_fine_get(fine).drawn.vertex_count;
    u = (sb_vec3 *)calloc((size_t)sb_body_node_count(body), sizeof *u);
    part = body->node_component[0];
    for (int i = 0; i < sb_body_node_count(body); i++)
        u[i] = body->node_component[i] == part ? way : u[i];
    CHECK_OK(sb_body_set_displacements(b.body, u));
    CHECK_OK(sb_cut_fine_update(fine, NULL));
    d = sb_cut_fine_get(fine);
    CHECK_INT(d.drawn.vertex_count, vertices);
    for (int f = 0; f < d.drawn.triangle_count; f++) {
        int is_moved = body->node_component[sb_body_cell_nodes(body, d.drawn.cells[f])[0]] == part;
        moved += is_moved;
        for (int k = 0; k < 3; k++) {
            int v = d.drawn.triangles[f][k];
            sb_vec3 gone = sb_v3_sub(d.drawn.positions[v], d.drawn.rest[v]);
            worst = fmax(worst, (double)sb_v3_norm(is_moved ? sb_v3_sub(gone, way) : gone));
        }
    }
    CHECK(moved > 100 && moved < d.drawn.triangle_count - 100);
    CHECK_NEAR(worst, 0, scene_tolerance(1e-15, 100));
    free(u);
    sb_cut_fine_destroy(fine);
    sb_mesh_free(&skin);
    block_free(&b);
}

/* ---- failures ---------------------------------------------------------------------------------------------------- */

static void test_no_memory(void)
{
    sb_mesh skin = skin_of(8, 4, 4, 1);
    scene_memory memory = {0, 0, 0, 0}, of_fine = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&of_fine);
    block b = counted_block(&memory, 3, 4);
    sb_cut_fine *fine = NULL;
    sb_result result = SB_ERROR_MEMORY;
    int failures = 0;
    for (; result != SB_OK && failures < 300; failures++) {
        of_fine.calls = 0;
        of_fine.fail_at = failures + 1;
        result = sb_cut_fine_create(b.cut, &skin, &allocator, &fine, NULL);
        if (result != SB_OK) {
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK_INT(of_fine.live, 0);
        }
    }
    CHECK(result == SB_OK && failures > 20);
    block_cut_plane(&b, sb_v3(REAL(0.0277), block_size.y / 2, block_size.z / 2), sb_v3(1, REAL(-0.2), 0));
    result = SB_ERROR_MEMORY;
    for (failures = 0; result != SB_OK && failures < 100; failures++) {
        int before = sb_cut_fine_get(fine).drawn.triangle_count;
        of_fine.calls = 0;
        of_fine.fail_at = failures + 1;
        result = sb_cut_fine_update(fine, NULL);
        if (result != SB_OK) {
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK_INT(sb_cut_fine_get(fine).drawn.triangle_count, before);
        }
    }
    CHECK(result == SB_OK && failures > 5 && sb_cut_fine_get(fine).open_edges == 0);
    sb_cut_fine_destroy(fine);
    CHECK_INT(of_fine.live, 0);
    block_free(&b);
    sb_mesh_free(&skin);
}

static void test_mistakes(void)
{
    block_options options = block_default(2);
    block b = block_make(&options);
    sb_mesh skin = skin_of(4, 3, 3, 1), bad;
    sb_cut_fine *fine = NULL;
    CHECK_RESULT(sb_cut_fine_create(NULL, &skin, NULL, &fine, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_cut_fine_create(b.cut, &b.mesh, NULL, &fine, NULL), SB_ERROR_ARGUMENT);
    CHECK_OK(sb_mesh_copy(&skin, NULL, &bad, NULL));
    bad.elements[4] = bad.node_count;
    CHECK_RESULT(sb_cut_fine_create(b.cut, &bad, NULL, &fine, NULL), SB_ERROR_INDEX);
    CHECK_RESULT(sb_cut_fine_update(NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK(fine == NULL && sb_cut_fine_get(NULL).drawn.triangle_count == 0);
    sb_cut_fine_destroy(NULL);
    sb_mesh_free(&bad);
    sb_mesh_free(&skin);
    block_free(&b);
}

CHECK_SUITE(cut_fine, {"planes", test_planes}, {"strokes, balls, states", test_strokes},
            {"open skins, coarse ones", test_other_skins}, {"both sides move with their part", test_motion},
            {"every allocation fails in turn", test_no_memory}, {"mistakes are named", test_mistakes});
