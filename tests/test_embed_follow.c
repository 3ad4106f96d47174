/* Embeddings follow the changes of a body's mesh: points keep their material, forces their sums, bits what they
 * were. */
#include "softbody.h"

#include "check.h"
#include "follow_change.h"
#include "scene.h"

enum { FOLLOW_POINTS = 400, FOLLOW_OPS = 12 };

/* A body whose mesh may change, and an embedding of points inside and around it that follows. */
typedef struct follow_case {
    sb_mesh mesh;
    sb_body *body;
    sb_embedding *embedding;
    double size; /* m: tolerances go with it */
    sb_vec3 points[FOLLOW_POINTS], normals[FOLLOW_POINTS], out[FOLLOW_POINTS], out_normals[FOLLOW_POINTS];
} follow_case;

static const sb_real follow_size[3] = {REAL(0.2), REAL(0.15), REAL(0.1)};

/* Body and embedding of the case's mesh and points. */
static void follow_embed(follow_case *c, sb_embedding_kind kind, const sb_allocator *allocator, double slack)
{
    sb_body_def def = sb_default_body_def();
    sb_embedding_def points = sb_default_embedding_def();
    sb_error error;
    def.mesh = &c->mesh;
    def.slack = REAL(slack);
    if (allocator)
        def.allocator = points.allocator = *allocator;
    def.material = sb_material_neo_hookean(5000, REAL(0.4), 1000);
    CHECK_OK(sb_body_create(&def, &c->body, &error));
    points.mesh = &c->mesh;
    points.points = c->points;
    points.normals = c->normals;
    points.point_count = FOLLOW_POINTS;
    points.kind = kind;
    CHECK_OK(sb_embedding_create(&points, &c->embedding, &error));
}

static sb_vec3 follow_direction(unsigned long long *seed)
{
    double x = check_random(seed) + 0.1, y = check_random(seed);
    return sb_v3(REAL(x), REAL(y), REAL(check_random(seed)));
}

static void follow_make(follow_case *c, sb_element_type type, sb_embedding_kind kind, const sb_allocator *allocator,
                        double slack, unsigned long long seed)
{
    memset(c, 0, sizeof *c);
    c->size = 1;
    c->mesh = scene_box(type, 4, 3, 2, sb_v3(follow_size[0], follow_size[1], follow_size[2]), 0.1);
    for (int i = 0; i < FOLLOW_POINTS; i++) {
        double margin = i % 2 ? 0.01 : -0.005, x[3];
        for (int k = 0; k < 3; k++)
            x[k] = check_random_in(&seed, -margin, (double)follow_size[k] + margin);
        c->points[i] = sb_v3(REAL(x[0]), REAL(x[1]), REAL(x[2]));
        c->normals[i] = follow_direction(&seed);
    }
    follow_embed(c, kind, allocator, slack);
}

/* A curved organ in other units, stretched; points on its nodes and edges, inside, and off its skin. */
static void follow_make_organ(follow_case *c, sb_embedding_kind kind, int cells, unsigned long long *seed)
{
    double unit = pow(10, check_random_in(seed, -2, 1)), stretch = check_random_in(seed, 0.4, 2);
    sb_vec3 low, high;
    memset(c, 0, sizeof *c);
    if (!CHECK_OK(sb_mesh_organ(SB_TET4, cells, NULL, &c->mesh, NULL)))
        return;
    for (int i = 0; i < c->mesh.node_count; i++) {
        sb_vec3 *x = &c->mesh.nodes[i];
        *x = sb_v3(REAL(unit) * x->x, REAL(unit * stretch) * x->y, REAL(unit) * x->z);
    }
    sb_mesh_bounds(&c->mesh, &low, &high);
    c->size = 1 + 2 * (double)sb_v3_norm(sb_v3_sub(high, low));
    for (int i = 0; i < FOLLOW_POINTS; i++) {
        const int *cell = c->mesh.elements + 4 * (int)(check_random(seed) * c->mesh.element_count);
        double shares[4], sum = 0;
        for (int a = 0; a < 4; a++)
            sum += shares[a] = a < 1 + i % 4 ? check_random_in(seed, 0.1, 1) : 0;
        for (int a = 0; a < 4; a++)
            c->points[i] = sb_v3_madd(c->points[i], REAL(shares[a] / sum), c->mesh.nodes[cell[a]]);
        c->normals[i] = follow_direction(seed);
        if (i % 5 == 0)
            c->points[i] =
                sb_v3_add(c->points[i], sb_v3_scale(REAL(check_random_in(seed, -0.1, 0.1)), sb_v3_sub(high, low)));
    }
    follow_embed(c, kind, NULL, 0.3);
}

static void follow_free(follow_case *c)
{
    sb_embedding_destroy(c->embedding);
    sb_body_destroy(c->body);
    sb_mesh_free(&c->mesh);
}

/* ---- what must hold ---- */

static double follow_off(sb_vec3 a, sb_vec3 b) { return (double)sb_v3_norm(sb_v3_sub(a, b)); }

static sb_vec3 follow_affine(sb_vec3 x, int rigid)
{
    if (rigid)
        return sb_v3(REAL(0.6) * x.x - REAL(0.8) * x.y + 1, REAL(0.8) * x.x + REAL(0.6) * x.y, x.z - REAL(0.5));
    return sb_v3(REAL(1.1) * x.x + REAL(0.2) * x.y, REAL(0.9) * x.y - REAL(0.1) * x.z,
                 x.z + REAL(0.3) * x.x + REAL(0.1));
}

static sb_vec3 follow_bend(sb_vec3 x)
{
    return sb_v3(x.x + 2 * x.y * x.z, x.y + x.x * x.x - x.z * x.z, x.z + 3 * x.x * x.y);
}

/* Points at rest, turned, and stretched; forces keep sum and moment. */
static void follow_check(follow_case *c, sb_embedding_kind kind)
{
    int nodes = sb_body_node_count(c->body);
    const sb_vec3 *rest = sb_body_rest_positions(c->body);
    sb_vec3 *x = (sb_vec3 *)calloc((size_t)nodes, sizeof *x), *f = (sb_vec3 *)calloc((size_t)nodes, sizeof *f);
    double worst = 0, tolerance = c->size * scene_tolerance(1e-15, 20), moment[6] = {0};
    CHECK_INT(sb_embedding_get_report(c->embedding).node_count, nodes);
    for (int way = 0; way < 3; way++) {
        for (int i = 0; i < nodes; i++)
            x[i] = way == 0 ? rest[i] : follow_affine(rest[i], way == 1);
        CHECK_OK(sb_embedding_update(c->embedding, x, c->out, c->out_normals, NULL));
        for (int p = 0; p < FOLLOW_POINTS; p++) {
            sb_vec3 truth = way == 0 ? c->points[p] : follow_affine(c->points[p], way == 1);
            sb_embedded_point place;
            CHECK_OK(sb_embedding_get_point(c->embedding, p, &place));
            if (way < 2 || kind == SB_EMBED_PLAIN || place.hold == SB_EMBEDDED_INSIDE)
                worst = fmax(worst, follow_off(c->out[p], truth));
            if (way == 0)
                worst = fmax(worst, 0.1 * follow_off(c->out_normals[p],
                                                     sb_v3_scale(1 / sb_v3_norm(c->normals[p]), c->normals[p])));
        }
    }
    if (!CHECK(worst < tolerance))
        printf("off by %.3g m\n", worst);
    CHECK_OK(sb_embedding_forces(c->embedding, x, c->normals, f, NULL));
    for (int i = 0; i < nodes + FOLLOW_POINTS; i++) {
        sb_vec3 at = i < nodes ? x[i] : c->out[i - nodes], force = i < nodes ? f[i] : c->normals[i - nodes];
        sb_vec3 turn = sb_v3_cross(at, force);
        double sign = i < nodes ? 1 : -1;
        const double all[6] = {(double)force.x, (double)force.y, (double)force.z,
                               (double)turn.x,  (double)turn.y,  (double)turn.z};
        for (int k = 0; k < 6; k++)
            moment[k] += sign * all[k];
    }
    for (int k = 0; k < 6; k++)
        CHECK(fabs(moment[k]) < c->size * scene_tolerance(1e-12, 10) * (double)FOLLOW_POINTS);
    free(x);
    free(f);
}

/* Largest distance, in a bent shape, of points from those of an embedding made anew on the mesh. */
static double follow_against_fresh(follow_case *c, int *compared)
{
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *fresh = NULL;
    sb_mesh mesh;
    sb_error error;
    int nodes = sb_body_node_count(c->body), *number = (int *)calloc((size_t)nodes, sizeof(int));
    sb_vec3 *x = (sb_vec3 *)calloc((size_t)nodes, sizeof *x), *y = (sb_vec3 *)calloc((size_t)nodes, sizeof *y);
    double worst = 0;
    CHECK_OK(sb_body_get_mesh(c->body, NULL, &mesh, number, NULL, &error));
    def.mesh = &mesh;
    def.points = c->points;
    def.point_count = FOLLOW_POINTS;
    CHECK_OK(sb_embedding_create(&def, &fresh, &error));
    for (int i = 0; i < nodes; i++) {
        x[i] = follow_bend(sb_body_rest_positions(c->body)[i]);
        if (number[i] >= 0)
            y[number[i]] = x[i];
    }
    CHECK_OK(sb_embedding_update(c->embedding, x, c->out, NULL, NULL));
    CHECK_OK(sb_embedding_update(fresh, y, c->out_normals, NULL, NULL));
    *compared = 0;
    for (int p = 0; p < FOLLOW_POINTS; p++) {
        sb_embedded_point a, b;
        CHECK_OK(sb_embedding_get_point(c->embedding, p, &a));
        CHECK_OK(sb_embedding_get_point(fresh, p, &b));
        if (a.hold == SB_EMBEDDED_INSIDE)
            CHECK(b.hold == SB_EMBEDDED_INSIDE);
        if (a.hold == b.hold &&
            a.hold != SB_EMBEDDED_FRAME) { /* of a point closest to an edge, either face may hold the frame */
            worst = fmax(worst, follow_off(c->out[p], c->out_normals[p]));
            ++*compared;
        }
    }
    sb_embedding_destroy(fresh);
    sb_mesh_free(&mesh);
    free(number);
    free(x);
    free(y);
    return worst;
}

/* ---- tests ---- */

static void test_follow_random(void)
{
    for (int round = 0; round < 4; round++) {
        sb_embedding_kind kind = round % 2 ? SB_EMBED_PLAIN : SB_EMBED_SMOOTH;
        unsigned long long seed = 100 + (unsigned long long)round;
        int counts[3] = {0, 0, 0}, compared, lost = 0;
        follow_case c;
        follow_op o;
        follow_make(&c, SB_TET4, kind, NULL, round < 2 ? 1 : 0.05, seed);
        CHECK_OK(sb_embedding_follow(c.embedding, c.body, NULL));
        for (int k = 0; k < 60; k++) {
            int op = k % 5 == 4 ? 2 : k % 2;
            if (follow_change(c.body, &o, op, 4, &seed) != SB_OK)
                continue;
            counts[op]++;
            follow_check(&c, kind);
            if (kind == SB_EMBED_SMOOTH)
                CHECK(follow_against_fresh(&c, &compared) < scene_tolerance(1e-15, 20));
            if (kind == SB_EMBED_SMOOTH)
                CHECK(compared > 9 * FOLLOW_POINTS / 10);
        }
        for (int op = 0; op < 3; op++)
            CHECK(counts[op] > 4);
        for (int p = 0; p < FOLLOW_POINTS; p++) {
            sb_embedded_point place;
            CHECK_OK(sb_embedding_get_point(c.embedding, p, &place));
            lost += place.lost;
        }
        CHECK_INT(sb_embedding_get_report(c.embedding).lost, lost);
        CHECK(lost > 0);
        follow_free(&c);
    }
}

/* Changes near each other, as of a needle or a blade, on organs: the material is kept, and updates have the same bits
 * on any number of threads. */
static void test_follow_organs(void)
{
    for (int round = 0; round < (check_quick() ? 3 : 10); round++) {
        sb_embedding_kind kind = round % 2 ? SB_EMBED_PLAIN : SB_EMBED_SMOOTH;
        unsigned long long seed = 900 + 17 * (unsigned long long)round;
        int done = 0, workers = 2 + round % 4;
        sb_jobs jobs = scene_jobs(&workers);
        follow_case c;
        follow_op o;
        follow_make_organ(&c, kind, 4 + round % 3, &seed);
        CHECK_OK(sb_embedding_follow(c.embedding, c.body, NULL));
        follow_check(&c, kind);
        for (int k = 0; k < 50; k++) {
            unsigned long long near = seed + (unsigned long long)(k / 10);
            done += follow_change(c.body, &o, k % 7 == 6 ? 2 : k % 2, 4, k % 3 ? &seed : &near) == SB_OK;
            if (k % 5 == 4) {
                static sb_vec3 alone[FOLLOW_POINTS];
                follow_check(&c, kind);
                CHECK_OK(sb_embedding_update(c.embedding, sb_body_rest_positions(c.body), alone, NULL, NULL));
                CHECK_OK(sb_embedding_update(c.embedding, sb_body_rest_positions(c.body), c.out, NULL, &jobs));
                CHECK(!memcmp(alone, c.out, sizeof alone));
            }
        }
        CHECK(done > 20);
        follow_free(&c);
    }
}

/* Elements with curved faces and boxes: their cells can be removed and made again. */
static void test_follow_elements(void)
{
    static const sb_element_type types[4] = {SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    for (int t = 0; t < 4; t++) {
        unsigned long long seed = 7;
        int done = 0;
        follow_case c;
        follow_op o;
        follow_make(&c, types[t], SB_EMBED_SMOOTH, NULL, 0.5, seed);
        CHECK_OK(sb_embedding_follow(c.embedding, c.body, NULL));
        for (int k = 0; k < 200 && done < 2; k++)
            if (follow_change(c.body, &o, 2, sb_element_node_count(types[t]), &seed) == SB_OK) {
                follow_check(&c, SB_EMBED_SMOOTH);
                CHECK_OK(follow_undo(c.body, &o));
                CHECK_INT(sb_embedding_get_report(c.embedding).lost, 0);
                follow_check(&c, SB_EMBED_SMOOTH);
                done++;
            }
        CHECK(done > 0 || types[t] == SB_HEX20 || types[t] == SB_HEX27);
        follow_free(&c);
    }
}

/* The inverse order gives back all bits; points far from a change keep theirs. */
static void test_follow_inverse(void)
{
    unsigned long long seed = 21;
    sb_vec3 before[FOLLOW_POINTS], *x;
    follow_case c;
    follow_op *ops = (follow_op *)calloc(FOLLOW_OPS, sizeof *ops);
    int depth = 0;
    follow_make(&c, SB_TET4, SB_EMBED_SMOOTH, NULL, 1, seed);
    x = (sb_vec3 *)calloc((size_t)c.mesh.node_count, sizeof *x);
    for (int i = 0; i < c.mesh.node_count; i++)
        x[i] = follow_bend(c.mesh.nodes[i]);
    CHECK_OK(sb_embedding_update(c.embedding, x, before, NULL, NULL));
    CHECK_OK(sb_embedding_follow(c.embedding, c.body, NULL));
    CHECK_OK(sb_embedding_update(c.embedding, x, c.out, NULL, NULL));
    CHECK(!memcmp(before, c.out, sizeof before));
    for (int k = 0; k < 100 && depth < FOLLOW_OPS; k++)
        depth += follow_change(c.body, ops + depth, depth % 3, 4, &seed) == SB_OK;
    CHECK_INT(depth, FOLLOW_OPS);
    while (depth > 0)
        CHECK_OK(follow_undo(c.body, ops + --depth));
    CHECK_INT(sb_body_node_count(c.body), c.mesh.node_count);
    CHECK_OK(sb_embedding_update(c.embedding, x, c.out, NULL, NULL));
    CHECK(!memcmp(before, c.out, sizeof before));
    free(x);
    free(ops);
    follow_free(&c);
}

/* A refused change, and every allocation that fails, leaves the bits. */
static void test_follow_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    sb_vec3 before[FOLLOW_POINTS];
    sb_result result = SB_ERROR_MEMORY;
    follow_case c;
    int failures = 0;
    for (int round = 0; round < 6; round++) {
        unsigned long long seed = 31 + (unsigned long long)round;
        follow_op o;
        follow_make(&c, SB_TET4, SB_EMBED_SMOOTH, &allocator, 0.5, seed);
        for (int n = 1; n < 10000; n++) {
            memory.calls = 0;
            memory.fail_at = n;
            result = sb_embedding_follow(c.embedding, c.body, NULL);
            memory.fail_at = 0;
            CHECK_OK(sb_embedding_update(c.embedding, sb_body_positions(c.body), before, NULL, NULL));
            if (result == SB_OK)
                break;
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK_RESULT(sb_embedding_unfollow(c.embedding), SB_ERROR_STATE);
        }
        for (int n = 1; n < 10000; n++) {
            unsigned long long same = seed;
            memory.calls = 0;
            memory.fail_at = n;
            result = follow_change(c.body, &o, round % 3, 4, &same);
            memory.fail_at = 0;
            if (result != SB_ERROR_MEMORY)
                break;
            failures++;
            CHECK_OK(sb_embedding_update(c.embedding, sb_body_positions(c.body), c.out, NULL, NULL));
            CHECK(!memcmp(before, c.out, sizeof before));
        }
        follow_check(&c, SB_EMBED_SMOOTH);
        follow_free(&c);
        CHECK_INT(memory.live, 0);
    }
    CHECK(failures > 5);
}

/* An embedding that follows no longer is what it was when it cannot follow again for want of memory. */
static void test_follow_again(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    unsigned long long seed = 81;
    sb_vec3 before[FOLLOW_POINTS], *x;
    sb_result result = SB_ERROR_MEMORY;
    follow_case c;
    follow_op o;
    int failures = 0;
    follow_make(&c, SB_TET4, SB_EMBED_SMOOTH, &allocator, 1, seed);
    CHECK_OK(sb_embedding_follow(c.embedding, c.body, NULL));
    for (int k = 0; k < 9; k++)
        follow_change(c.body, &o, k % 3, 4, &seed);
    CHECK_OK(sb_embedding_unfollow(c.embedding));
    x = (sb_vec3 *)calloc((size_t)sb_body_node_count(c.body), sizeof *x);
    for (int i = 0; i < sb_body_node_count(c.body); i++)
        x[i] = follow_bend(sb_body_rest_positions(c.body)[i]);
    CHECK_OK(sb_embedding_update(c.embedding, x, before, NULL, NULL));
    for (int n = 1; n < 1000 && result == SB_ERROR_MEMORY; n++) {
        memory.calls = 0;
        memory.fail_at = n;
        result = sb_embedding_follow(c.embedding, c.body, NULL);
        memory.fail_at = 0;
        failures += result != SB_OK;
        CHECK_OK(sb_embedding_update(c.embedding, x, c.out, NULL, NULL));
        CHECK(result == SB_OK || !memcmp(before, c.out, sizeof before));
    }
    CHECK_OK(result);
    CHECK(failures > 10);
    follow_check(&c, SB_EMBED_SMOOTH);
    free(x);
    follow_free(&c);
    CHECK_INT(memory.live, 0);
}

/* After a state was loaded without memory for the embedding it says so until there is some, and is right then. */
/* After a change that was refused for want of memory another one, which needs less: points that were all inside, of
 * which the first would lose some. */
static void test_follow_after_refusal(void)
{
    int failures = 0;
    for (int kind = 0; kind < 2; kind++)
        for (int n = 1; n < 1000; n++) {
            scene_memory memory = {0, 0, 0, 0};
            sb_allocator allocator = scene_allocator(&memory);
            unsigned long long seed = 7;
            follow_op o;
            follow_case c;
            sb_result result;
            memset(&c, 0, sizeof c);
            c.size = 1;
            c.mesh = scene_box(SB_TET4, 4, 3, 2, sb_v3(follow_size[0], follow_size[1], follow_size[2]), 0.1);
            for (int i = 0; i < FOLLOW_POINTS; i++) {
                double at[3];
                for (int k = 0; k < 3; k++)
                    at[k] = check_random_in(&seed, 0.05, 0.95) * (double)follow_size[k];
                c.points[i] = sb_v3(REAL(at[0]), REAL(at[1]), REAL(at[2]));
                c.normals[i] = follow_direction(&seed);
            }
            follow_embed(&c, kind ? SB_EMBED_SMOOTH : SB_EMBED_PLAIN, &allocator, 0.5);
            CHECK_INT(sb_embedding_get_report(c.embedding).inside, FOLLOW_POINTS);
            CHECK_OK(sb_embedding_follow(c.embedding, c.body, NULL));
            memory.calls = 0;
            memory.fail_at = n;
            for (int tries = 0; (result = follow_change(c.body, &o, 2, 4, &seed)) == SB_ERROR_MESH && tries < 50;)
                tries++;
            memory.fail_at = 0;
            if (result == SB_ERROR_MEMORY) {
                failures++;
                for (int later = 0; later < 6; later++)
                    follow_change(c.body, &o, later % 2, 4, &seed);
            }
            follow_check(&c, kind ? SB_EMBED_SMOOTH : SB_EMBED_PLAIN);
            follow_free(&c);
            CHECK_INT(memory.live, 0);
            if (result == SB_OK)
                break;
        }
    CHECK(failures > 5);
}

static void test_follow_state_without_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    unsigned long long seed = 83;
    unsigned char *image;
    size_t size;
    follow_case c;
    follow_op o;
    int stale = 0, loaded = 0;
    follow_make(&c, SB_TET4, SB_EMBED_SMOOTH, &allocator, 1, seed);
    size = sb_body_state_size(c.body);
    image = (unsigned char *)malloc(size);
    CHECK_OK(sb_body_state_save(c.body, image, size));
    CHECK_OK(sb_embedding_follow(c.embedding, c.body, NULL));
    for (int n = 1; n < 2000 && loaded < 3; n++) {
        sb_result result;
        while (follow_change(c.body, &o, 0, 4, &seed) != SB_OK)
            continue;
        memory.calls = 0;
        memory.fail_at = n;
        result = sb_body_state_load(c.body, image, size, NULL);
        loaded += result == SB_OK && memory.calls < n;
        memory.fail_at = result == SB_OK ? memory.calls + 1 : 0;
        if (sb_embedding_update(c.embedding, sb_body_positions(c.body), c.out, NULL, NULL) != SB_OK)
            stale++;
        memory.fail_at = 0;
        CHECK_OK(sb_embedding_update(c.embedding, sb_body_positions(c.body), c.out, NULL, NULL));
        follow_check(&c, SB_EMBED_SMOOTH);
        CHECK_OK(sb_body_state_load(c.body, image, size, NULL));
    }
    CHECK_INT(loaded, 3);
    CHECK(stale > 10);
    free(image);
    follow_free(&c);
    CHECK_INT(memory.live, 0);
}

/* Slides and splits that go back and forth allocate once. */
static void test_follow_no_allocations(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    follow_case c;
    follow_op o;
    follow_make(&c, SB_TET4, SB_EMBED_SMOOTH, &allocator, 1, 61);
    CHECK_OK(sb_embedding_follow(c.embedding, c.body, NULL));
    for (int k = 0; k < 40; k++) {
        unsigned long long seed = 71 + (unsigned long long)(k % 4);
        if (k == 8)
            memory.calls = 0;
        if (follow_change(c.body, &o, k % 2, 4, &seed) == SB_OK)
            CHECK_OK(follow_undo(c.body, &o));
        CHECK_OK(sb_embedding_update(c.embedding, sb_body_positions(c.body), c.out, NULL, NULL));
    }
    CHECK_INT(memory.calls, 0);
    follow_free(&c);
    CHECK_INT(memory.live, 0);
}

/* States of other meshes; either may end first. */
static void test_follow_state(void)
{
    unsigned long long seed = 51;
    follow_case c;
    follow_op o;
    unsigned char *image;
    size_t size;
    follow_make(&c, SB_TET4, SB_EMBED_PLAIN, NULL, 1, seed);
    CHECK_OK(sb_embedding_follow(c.embedding, c.body, NULL));
    CHECK_RESULT(sb_embedding_follow(c.embedding, c.body, NULL), SB_ERROR_STATE);
    for (int k = 0; k < 9; k++)
        follow_change(c.body, &o, k % 3, 4, &seed);
    size = sb_body_state_size(c.body);
    image = (unsigned char *)malloc(size);
    CHECK_OK(sb_body_state_save(c.body, image, size));
    for (int k = 0; k < 9; k++)
        follow_change(c.body, &o, k % 3, 4, &seed);
    CHECK_OK(sb_body_state_load(c.body, image, size, NULL));
    follow_check(&c, SB_EMBED_PLAIN);
    for (int k = 0; k < 9; k++)
        follow_change(c.body, &o, k % 3, 4, &seed);
    follow_check(&c, SB_EMBED_PLAIN);
    CHECK_OK(sb_embedding_unfollow(c.embedding));
    CHECK_RESULT(sb_embedding_unfollow(c.embedding), SB_ERROR_STATE);
    follow_check(&c, SB_EMBED_PLAIN);
    CHECK_OK(sb_embedding_follow(c.embedding, c.body, NULL));
    sb_body_destroy(c.body);
    c.body = NULL;
    CHECK_RESULT(sb_embedding_unfollow(c.embedding), SB_ERROR_STATE);
    free(image);
    follow_free(&c);
}

CHECK_SUITE(embed_follow, {"random changes", test_follow_random}, {"organs", test_follow_organs},
            {"other elements", test_follow_elements}, {"the inverse order gives back all bits", test_follow_inverse},
            {"every allocation fails", test_follow_memory}, {"followed again without memory", test_follow_again},
            {"states without memory", test_follow_state_without_memory},
            {"changes after a refusal", test_follow_after_refusal},
            {"changes that allocated once", test_follow_no_allocations}, {"states and ends", test_follow_state});
