/* The surface of a body that is cut: closed, with the parts' volumes, and its vertices where their material is. */
#include "cut_drawing.h"
#include "random_case.h"

/* ---- measures ---------------------------------------------------------------------------------------------------- */

/* Volumes of the parts, and lips that are equal and opposite. */
static double check_volumes(const block *b, const sb_cut_drawing *d)
{
    double area = 0, worst = volumes_error(b, d);
    sb_vec3 lips = {0, 0, 0};
    for (int f = 0; f < d->triangle_count; f++)
        if (is_drawn(d, f) && d->tags[f] == SB_CUT_LIP) {
            const sb_vec3 *x = d->rest;
            const int *v = d->triangles[f];
            sb_vec3 normal = sb_v3_cross(sb_v3_sub(x[v[1]], x[v[0]]), sb_v3_sub(x[v[2]], x[v[0]]));
            lips = sb_v3_add(lips, normal);
            area += (double)sb_v3_norm(normal);
        }
    return area > 0 ? fmax(worst, (double)sb_v3_norm(lips) / area) : worst;
}

/* Vertices are where their origins say, with unit normals where they are used. */
static void check_vertices(const block *b, const sb_cut_drawing *d)
{
    sb_vec3 low, high;
    double reach;
    sb_mesh_bounds(&b->mesh, &low, &high);
    reach = fmax((double)sb_v3_norm(low), (double)sb_v3_norm(high));
    for (int i = 0; i < d->vertex_count; i++) {
        sb_vec3 x = {0, 0, 0};
        if (d->origins[i].element < 0)
            continue;
        for (int a = 0; a < 4; a++)
            x = sb_v3_madd(x, d->origins[i].weights[a], b->mesh.nodes[d->origins[i].nodes[a]]);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(x, d->rest[i])), 0, scene_tolerance(1.1e-14, 4) * reach);
        CHECK(sb_v3_norm(d->normals[i]) == 0 || fabs((double)sb_v3_norm(d->normals[i]) - 1) < 1e-4);
        CHECK(d->points[d->points[i]] == d->points[i]);
    }
}

static sb_cut_surface *surface_make(const block *b)
{
    sb_cut_surface *surface = NULL;
    sb_error error;
    if (!CHECK_OK(sb_cut_surface_create(b->cut, NULL, &surface, &error)))
        printf("%s\n", error.message);
    return surface;
}

/* ---- planes ------------------------------------------------------------------------------------------------------ */

static void test_planes(void)
{
    double worst = 0;
    for (int i = 0; i < 3; i++) {
        block_options options = block_default(intervals_of[i]);
        block b = block_make(&options);
        sb_cut_surface *surface = surface_make(&b);
        sb_cut_drawing d = sb_cut_surface_get(surface);
        const double y = (double)block_size.y, z = (double)block_size.z, slope = 0.2;
        double close = scene_tolerance(5e-6, 200), skin = area_of(&d, SB_CUT_SKIN);
        int euler, surfaces = check_closed(&d, &euler);
        CHECK_INT(surfaces, 1);
        CHECK_INT(euler, 2);
        CHECK_NEAR(skin, 2 * (double)(block_size.x * (block_size.y + block_size.z) + block_size.y * block_size.z),
                   scene_tolerance(1e-14, 4));
        block_cut_plane(&b, sb_v3(REAL(0.0277), block_size.y / 2, block_size.z / 2), sb_v3(1, REAL(-slope), 0));
        CHECK_OK(sb_cut_surface_update(surface, NULL));
        d = sb_cut_surface_get(surface);
        surfaces = check_closed(&d, &euler);
        CHECK_INT(surfaces, 2);
        CHECK_INT(euler, 4);
        CHECK_NEAR(area_of(&d, SB_CUT_LIP), 2 * y * z * sqrt(1 + slope * slope), 2 * close * y * z);
        CHECK_NEAR(area_of(&d, SB_CUT_SKIN), skin, scene_tolerance(1e-13, 200) * skin);
        worst = fmax(worst, check_volumes(&b, &d));
        check_vertices(&b, &d);
        block_cut_plane(&b, sb_v3(REAL(0.03), REAL(0.02), REAL(0.02)), sb_v3(0, 1, 0)); /* through nodes */
        block_cut_plane(&b, sb_v3(REAL(0.03), REAL(0.0207), REAL(0.0252)), sb_v3(0, REAL(0.3), 1));
        CHECK_OK(sb_cut_surface_update(surface, NULL));
        d = sb_cut_surface_get(surface);
        surfaces = check_closed(&d, &euler);
        CHECK_INT(surfaces, b.body->component_count);
        CHECK(euler % 2 == 0 && euler >= 2 * surfaces - 2); /* a crumb where planes cross may be a ring */
        worst = fmax(worst, check_volumes(&b, &d));
        check_vertices(&b, &d);
        sb_cut_surface_destroy(surface);
        block_free(&b);
    }
    printf("   parts' volumes and lips off by %.1e\n", worst);
    CHECK_NEAR(worst, 0, scene_tolerance(1e-12, 500));
}

/* ---- at random --------------------------------------------------------------------------------------------------- */

static void test_strokes(void)
{
    unsigned long long seed = 101;
    double worst = 0;
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < (check_quick() ? 1 : 4); round++) {
            block_options options = block_default(intervals_of[i]);
            block b = block_make(&options);
            sb_cut_surface *surface = surface_make(&b);
            block_shake(&b);
            for (int stroke = 0; stroke < 5; stroke++) {
                sb_vec3 triangles[18], *before;
                sb_cut_drawing d = sb_cut_surface_get(surface);
                int count = strip_random(triangles, &seed), old = d.vertex_count, euler;
                before = (sb_vec3 *)malloc((size_t)old * sizeof *before);
                memcpy(before, d.rest, (size_t)old * sizeof *before);
                block_cut(&b, triangles, count);
                block_step(&b, 1);
                CHECK_OK(sb_cut_surface_update(surface, NULL));
                d = sb_cut_surface_get(surface);
                CHECK(d.vertex_count >= old && memcmp(before, d.rest, (size_t)old * sizeof *before) == 0);
                check_closed(&d, &euler);
                CHECK(euler % 2 == 0);
                worst = fmax(worst, check_volumes(&b, &d));
                check_vertices(&b, &d);
                free(before);
            }
            sb_cut_surface_destroy(surface);
            block_free(&b);
        }
    printf("   parts' volumes and lips off by %.1e\n", worst);
    CHECK_NEAR(worst, 0, scene_tolerance(1e-12, 500));
}

/* With glue an edge may have four triangles, two each way: all parts are still closed, with their volumes. */
static void test_glued(void)
{
    unsigned long long seed = 101;
    double worst = 0;
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < (check_quick() ? 1 : 4); round++) {
            block_options options = block_default(intervals_of[i]);
            block b;
            sb_cut_surface *surface;
            options.front = SB_CUT_GLUE;
            b = block_make(&options);
            surface = surface_make(&b);
            block_shake(&b);
            for (int stroke = 0; stroke < 5; stroke++) {
                sb_vec3 triangles[18];
                sb_cut_drawing d;
                edge *edges;
                int count = strip_random(triangles, &seed), open = 0;
                block_cut(&b, triangles, count);
                block_step(&b, 1);
                CHECK_OK(sb_cut_surface_update(surface, NULL));
                d = sb_cut_surface_get(surface);
                edges = edges_of(&d, &count);
                for (int first = 0, end; first < count; first = end) {
                    int turns = 0;
                    for (end = first; end < count && edge_order(edges + first, edges + end) == 0; end++)
                        turns += edges[end].turn ? 1 : -1;
                    open += turns != 0;
                }
                CHECK_INT(open, 0);
                free(edges);
                worst = fmax(worst, check_volumes(&b, &d));
                check_vertices(&b, &d);
            }
            sb_cut_surface_destroy(surface);
            block_free(&b);
        }
    CHECK_NEAR(worst, 0, scene_tolerance(1e-12, 500));
}

/* ---- organs that nobody chose ------------------------------------------------------------------------------------ */

/* A random case of tets as a body that can be cut, with any preconditioner and lattice; 0 when this number has none. */
static int organ_make(block *b, random_case *c, unsigned long long number, double *size)
{
    static const sb_precond_kind kinds[] = {SB_PRECOND_BLOCK_JACOBI, SB_PRECOND_SSOR,     SB_PRECOND_IC0,
                                            SB_PRECOND_FSAI,         SB_PRECOND_CHOLESKY, SB_PRECOND_MULTIGRID};
    sb_body_def def = sb_default_body_def();
    sb_vec3 low, high;
    memset(b, 0, sizeof *b);
    if (!random_case_make(c, number, 0))
        return 0;
    if (c->mesh.element_type != SB_TET4 || c->integrator == SB_CENTRAL_DIFFERENCE) {
        random_case_free(c);
        return 0;
    }
    def.mesh = &c->mesh;
    def.material = c->material;
    def.integrator = c->integrator;
    def.mass = c->mass;
    def.gravity = c->gravity;
    def.damping_stiffness = c->damping;
    def.preconditioner = kinds[number % 6];
    def.slack = 1;
    b->mesh = c->mesh;
    b->body = scene_body(&def);
    CHECK_OK(sb_body_fix_nodes(b->body, c->held, c->held_count, SB_XYZ));
    block_cut_create(b, intervals_of[number % 3]);
    sb_mesh_bounds(&c->mesh, &low, &high);
    *size = (double)sb_v3_norm(sb_v3_sub(high, low));
    return 1;
}

/* Squares about random nodes, some exactly through them, in a body that moves: whatever they part, the surface is
 * closed and holds what the cells do, and nothing is lost. */
static double organ_cut(block *b, const random_case *c, double size, unsigned long long *seed)
{
    double worst = 0;
    sb_cut_surface *surface = surface_make(b);
    for (int i = 0; i < 4; i++) {
        const sb_vec3 *x = sb_body_positions(b->body);
        sb_vec3 triangles[6], middle = x[random_below(seed, c->mesh.node_count)];
        totals before = totals_of(b), after;
        sb_cut_drawing d;
        int euler;
        if (i % 2 == 0)
            middle = sb_v3_madd(middle, REAL(0.05 * size), random_direction(seed));
        square_make(middle, random_direction(seed), size * check_random_in(seed, 0.1, 2), triangles);
        block_cut(b, triangles, 2);
        after = totals_of(b);
        CHECK_NEAR(after.mass, before.mass, scene_tolerance(1e-12, 500) * before.mass);
        check_pieces(b);
        CHECK_OK(sb_body_step(b->body, c->dt, NULL));
        CHECK_OK(sb_cut_surface_update(surface, NULL));
        d = sb_cut_surface_get(surface);
        check_closed(&d, &euler);
        check_vertices(b, &d);
        worst = fmax(worst, check_volumes(b, &d));
    }
    sb_cut_surface_destroy(surface);
    return worst;
}

static void test_organs(void)
{
    double worst = 0;
    int organs = 0;
    for (unsigned long long number = 0; organs < (check_quick() ? 6 : 16); number++) {
        unsigned long long seed = 31 + number;
        random_case c;
        block b;
        double size;
        if (!organ_make(&b, &c, number, &size))
            continue;
        organs++;
        worst = fmax(worst, organ_cut(&b, &c, size, &seed));
        sb_cut_destroy(b.cut);
        sb_body_destroy(b.body);
        random_case_free(&c);
    }
    printf("   %d organs: parts' volumes and lips off by %.1e\n", organs, worst);
    CHECK_NEAR(worst, 0, scene_tolerance(1e-12, 500));
}

/* ---- updates ----------------------------------------------------------------------------------------------------- */

/* What an update says has changed is all that has; without a cut nothing has, and nothing is allocated. */
static void test_ranges(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    block_options options = block_default(2);
    block b = block_make(&options);
    sb_cut_surface *surface = NULL;
    sb_cut_drawing d;
    int calls, first = 0;
    int(*before)[3];
    CHECK_OK(sb_cut_surface_create(b.cut, &allocator, &surface, NULL));
    d = sb_cut_surface_get(surface);
    CHECK_INT(d.first_triangle, 0);
    CHECK_INT(d.triangle_end, d.triangle_count);
    block_cut_plane(&b, sb_v3(REAL(0.0277), REAL(0.0213), REAL(0.0239)), sb_v3(1, REAL(-0.2), REAL(0.15)));
    CHECK_OK(sb_cut_surface_update(surface, NULL));
    calls = memory.calls;
    block_step(&b, 1);
    CHECK_OK(sb_cut_surface_update(surface, NULL));
    d = sb_cut_surface_get(surface);
    CHECK_INT(memory.calls, calls);
    CHECK_INT(d.triangle_end, d.first_triangle);
    CHECK_INT(d.first_vertex, d.vertex_count);
    before = (int(*)[3])malloc((size_t)d.triangle_count * sizeof *before);
    memcpy(before, d.triangles, (size_t)d.triangle_count * sizeof *before);
    block_cut_plane(&b, sb_v3(REAL(0.05), REAL(0.0213), REAL(0.0239)), sb_v3(1, REAL(-0.2), REAL(0.15)));
    CHECK_OK(sb_cut_surface_update(surface, NULL));
    first = d.triangle_count;
    d = sb_cut_surface_get(surface);
    for (int f = 0; f < first; f++)
        if (memcmp(before[f], d.triangles[f], sizeof *before) != 0)
            CHECK(f >= d.first_triangle && f < d.triangle_end);
    CHECK_INT(d.triangle_end, d.triangle_count);
    free(before);
    sb_cut_surface_destroy(surface);
    CHECK_INT(memory.live, 0);
    block_free(&b);
}

/* The same bits in all arrays, and the same said of what has changed. */
static int drawings_agree(const sb_cut_drawing *a, const sb_cut_drawing *b)
{
    size_t vertices = (size_t)a->vertex_count, triangles = (size_t)a->triangle_count;
    int same = a->vertex_count == b->vertex_count && a->triangle_count == b->triangle_count &&
               a->first_triangle == b->first_triangle && a->triangle_end == b->triangle_end &&
               a->first_vertex == b->first_vertex;
    for (size_t i = 0; i < vertices && same; i++)
        same = a->origins[i].element == b->origins[i].element && a->points[i] == b->points[i] &&
               (a->origins[i].element < 0 ||
                (memcmp(a->origins[i].weights, b->origins[i].weights, sizeof a->origins[i].weights) == 0 &&
                 memcmp(a->positions + i, b->positions + i, sizeof(sb_vec3)) == 0 &&
                 memcmp(a->normals + i, b->normals + i, sizeof(sb_vec3)) == 0)) &&
               memcmp(a->rest + i, b->rest + i, sizeof(sb_vec3)) == 0 &&
               memcmp(a->texture + i, b->texture + i, sizeof a->texture[i]) == 0;
    return same && memcmp(a->triangles, b->triangles, triangles * sizeof *a->triangles) == 0 &&
           memcmp(a->tags, b->tags, triangles) == 0 && memcmp(a->cells, b->cells, triangles * sizeof *a->cells) == 0;
}

/* A surface that keeps triangles, and one that draws all anew each time. */
typedef struct two_surfaces {
    sb_cut_surface *keeps, *redraws;
} two_surfaces;

static void two_update(const two_surfaces *two)
{
    sb_cut_drawing a, b;
    sbi_cut_surface_forget(two->redraws);
    CHECK_OK(sb_cut_surface_update(two->keeps, NULL));
    CHECK_OK(sb_cut_surface_update(two->redraws, NULL));
    a = sb_cut_surface_get(two->keeps);
    b = sb_cut_surface_get(two->redraws);
    CHECK(drawings_agree(&a, &b));
}

/* Strokes, burns, a state from before, and strokes again. */
static void keep_and_redraw(const block_options *options, unsigned long long *seed)
{
    enum { STROKES = 6, SAVED = 2, LOADED = 4 };
    block b = block_make(options);
    two_surfaces two = {surface_make(&b), surface_make(&b)};
    void *state = NULL;
    size_t size = 0;
    block_shake(&b);
    for (int stroke = 0; stroke < STROKES; stroke++) {
        sb_vec3 triangles[18];
        int count = strip_random(triangles, seed);
        if (stroke == SAVED) {
            size = sb_body_state_size(b.body);
            state = malloc(size);
            CHECK_OK(sb_body_state_save(b.body, state, size));
        }
        block_cut(&b, triangles, count);
        if (stroke % 2)
            CHECK_OK(sb_cut_ablate(b.cut, triangles[0], REAL(0.004), NULL, NULL));
        two_update(&two);
        if (stroke == LOADED) {
            CHECK_OK(sb_body_state_load(b.body, state, size, NULL));
            two_update(&two);
        }
        block_step(&b, 1);
    }
    two_update(&two);
    free(state);
    sb_cut_surface_destroy(two.keeps);
    sb_cut_surface_destroy(two.redraws);
    block_free(&b);
}

/* What is kept of a drawing is what drawing all anew gives, to the bit. */
static void test_kept(void)
{
    unsigned long long seed = 211;
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < (check_quick() ? 2 : 6); round++) {
            block_options options = block_default(intervals_of[i]);
            options.front = round % 2 ? SB_CUT_LAG : SB_CUT_GLUE;
            options.element = (i + round) % 3 == 2 ? SB_TET10 : SB_TET4;
            keep_and_redraw(&options, &seed);
        }
}

/* Textures of a flat lip are a map of it without stretch. */
static void test_texture(void)
{
    block_options options = block_default(2);
    block b = block_make(&options);
    sb_cut_surface *surface = surface_make(&b);
    sb_cut_drawing d;
    double worst = 0;
    block_cut_plane(&b, sb_v3(REAL(0.0277), REAL(0.0213), REAL(0.0239)), sb_v3(1, REAL(-0.2), REAL(0.15)));
    CHECK_OK(sb_cut_surface_update(surface, NULL));
    d = sb_cut_surface_get(surface);
    for (int f = 0; f < d.triangle_count; f++)
        for (int k = 0; k < 3 && is_drawn(&d, f) && d.tags[f] == SB_CUT_LIP; k++) {
            int v = d.triangles[f][k], w = d.triangles[f][(k + 1) % 3];
            double u = (double)(d.texture[v][0] - d.texture[w][0]), t = (double)(d.texture[v][1] - d.texture[w][1]);
            worst = fmax(worst, fabs(hypot(u, t) - (double)sb_v3_norm(sb_v3_sub(d.rest[v], d.rest[w]))));
        }
    CHECK_NEAR(worst, 0, scene_tolerance(1e-8, 100)); /* crossings are rounded */
    sb_cut_surface_destroy(surface);
    block_free(&b);
}

/* Every allocation fails in turn; the next update makes up for it. */
static void test_no_memory(void)
{
    block_options options = block_default(2);
    int done = 0;
    options.nx = 3, options.ny = options.nz = 2;
    for (int fail = 1; !done && fail < 200; fail++) {
        scene_memory memory = {0, 0, 0, 0};
        sb_allocator allocator = scene_allocator(&memory);
        block b = block_make(&options);
        sb_cut_surface *surface = NULL;
        sb_cut_drawing d;
        int euler;
        memory.fail_at = fail;
        if (sb_cut_surface_create(b.cut, &allocator, &surface, NULL) != SB_OK) {
            CHECK(!surface);
            CHECK_INT(memory.live, 0);
            memory.fail_at = 0;
            CHECK_OK(sb_cut_surface_create(b.cut, &allocator, &surface, NULL));
        }
        block_cut_plane(&b, sb_v3(REAL(0.0277), REAL(0.0213), REAL(0.0239)), sb_v3(1, REAL(-0.2), REAL(0.15)));
        done = sb_cut_surface_update(surface, NULL) == SB_OK && memory.calls < fail;
        memory.fail_at = 0;
        CHECK_OK(sb_cut_surface_update(surface, NULL));
        d = sb_cut_surface_get(surface);
        CHECK_INT(check_closed(&d, &euler), 2);
        sb_cut_surface_destroy(surface);
        CHECK_INT(memory.live, 0);
        block_free(&b);
    }
    CHECK(done);
}

static void test_mistakes(void)
{
    block_options options = block_default(1);
    block b = block_make(&options);
    sb_cut_surface *surface = NULL;
    CHECK_RESULT(sb_cut_surface_create(NULL, NULL, &surface, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_cut_surface_create(b.cut, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_cut_surface_update(NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_INT(sb_cut_surface_get(NULL).triangle_count, 0);
    sb_cut_surface_destroy(NULL);
    surface = surface_make(&b);
    scene_remove_cells(b.body);
    CHECK_RESULT(sb_cut_surface_update(surface, NULL), SB_ERROR_STATE);
    sb_cut_surface_destroy(surface);
    block_free(&b);
}

CHECK_SUITE(cut_surface, {"planes: closed, volumes, areas", test_planes}, {"strokes: closed, volumes", test_strokes},
            {"glued: volumes", test_glued}, {"organs: closed, volumes", test_organs},
            {"what an update changes", test_ranges}, {"what is kept of a drawing", test_kept},
            {"texture of lips", test_texture}, {"every allocation fails in turn", test_no_memory},
            {"mistakes are named", test_mistakes});
