/* Points in elements that are cut stay with their material: embeddings, rows of mappings, sb_body_find_cell. */
#include "cut_block.h"

enum { POINTS = 1000 };
static const double skin = 0.03; /* of the block: how far points are outside */

typedef struct planes {
    int count;
    sb_vec3 middle[3], normal[3];
} planes;

static planes planes_make(int count)
{
    planes p;
    p.count = count;
    for (int k = 0; k < 3; k++)
        p.middle[k] = sb_v3(REAL(0.0277), REAL(0.0213), REAL(0.0239));
    p.normal[0] = sb_v3(1, REAL(-0.2), REAL(0.15));
    p.normal[1] = sb_v3(REAL(0.1), 1, REAL(0.25));
    p.normal[2] = sb_v3(REAL(-0.2), REAL(0.1), 1);
    return p;
}

/* Sides of a place as bits; -1: nearer to a plane than `near`, or to several than `link` (m), where they part what
 * the lattice can resolve. */
static int sides_of(const planes *p, sb_vec3 x, double near, double link)
{
    int sides = 0, close = 0;
    for (int k = 0; k < p->count; k++) {
        sb_vec3 n = p->normal[k];
        double height = (double)sb_v3_dot(n, sb_v3_sub(x, p->middle[k])) / (double)sb_v3_norm(n);
        if (fabs(height) < near)
            return -1;
        close += fabs(height) < link;
        sides |= (height > 0) << k;
    }
    return close > 1 ? -1 : sides;
}

/* Longest link of a block (m). */
static double link_of(const block *b) { return 0.024 / b->cut->lattice.intervals; }

static int is_outside(sb_vec3 x)
{
    return x.x < 0 || x.y < 0 || x.z < 0 || x.x > block_size.x || x.y > block_size.y || x.z > block_size.z;
}

/* Points in and a little outside the block. */
static void points_make(sb_vec3 *points, int outside, unsigned long long *seed)
{
    for (int i = 0; i < POINTS; i++) {
        sb_vec3 x = vector_in(outside ? -skin : 0, outside ? 1 + skin : 1, seed);
        points[i] = sb_v3(x.x * block_size.x, x.y * block_size.y, x.z * block_size.z);
    }
}

static sb_embedding *points_embed(const block *b, const sb_vec3 *points, sb_embedding_kind kind)
{
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_error error;
    def.mesh = &b->mesh;
    def.points = points;
    def.point_count = POINTS;
    def.kind = kind;
    CHECK_OK(sb_embedding_create(&def, &embedding, &error));
    if (!CHECK_OK(sb_embedding_follow(embedding, b->body, &error)))
        printf("%s\n", error.message);
    return embedding;
}

static void cut_all(block *b, const planes *p)
{
    int parts = 1;
    for (int k = 0; k < p->count; k++)
        parts = block_cut_plane(b, p->middle[k], p->normal[k]).parts;
    CHECK_INT(parts, 1 << p->count);
}

/* The rigid motion of what is on these sides. */
static sb_vec3 moved(int sides, sb_vec3 x)
{
    sb_vec3 axis = sb_v3(1, REAL(0.5), REAL(-0.3)), turn = sb_v3_scale(REAL(0.4) * (sb_real)sides, axis);
    sb_quat rotation = sb_quat_from_rotation_vector(turn);
    return sb_v3_add(sb_quat_rotate(rotation, x), sb_v3(REAL(0.02) * (sb_real)sides, REAL(0.01), 0));
}

/* Moves each part as a rigid body, another way each. */
static void parts_move(block *b, const planes *p)
{
    int nodes = sb_body_node_count(b->body), part_sides[8];
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)nodes, sizeof *u);
    for (int n = 0; n < b->mesh.node_count; n++) { /* a node's number stands for the material at its place */
        int sides = sides_of(p, b->mesh.nodes[n], 1e-6, link_of(b));
        if (sides >= 0 && b->body->node_component[n] >= 0)
            part_sides[b->body->node_component[n]] = sides;
    }
    for (int n = 0; n < nodes; n++)
        if (b->body->node_component[n] >= 0)
            u[n] =
                sb_v3_sub(moved(part_sides[b->body->node_component[n]], b->body->reference[n]), b->body->reference[n]);
    CHECK_OK(sb_body_set_displacements(b->body, u));
    free(u);
}

/* ---- embeddings -------------------------------------------------------------------------------------------------- */

/* How far points are from where their material went (m); *count: those looked at. */
static double points_fault(const block *b, sb_embedding *embedding, const planes *p, const sb_vec3 *rest, int *count)
{
    sb_vec3 *points = (sb_vec3 *)malloc(POINTS * sizeof *points);
    double worst = 0;
    *count = 0;
    CHECK_OK(sb_embedding_update(embedding, sb_body_positions(b->body), points, NULL, NULL));
    for (int i = 0; i < POINTS; i++) {
        int sides = sides_of(p, rest[i], is_outside(rest[i]) ? 0.003 : 1e-6, link_of(b)); /* feet are elsewhere */
        if (sides < 0)
            continue;
        worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(points[i], moved(sides, rest[i]))));
        ++*count;
    }
    free(points);
    return worst;
}

static void test_points(void)
{
    unsigned long long seed = 83;
    double worst = 0;
    for (int i = 0; i < 3; i++)
        for (int kind = 0; kind < 2; kind++) {
            block_options options = block_default(intervals_of[i]);
            planes p = planes_make(kind ? 2 : 1);
            block b = block_make(&options);
            sb_vec3 *rest = (sb_vec3 *)malloc(POINTS * sizeof *rest);
            sb_embedding *embedding;
            int count;
            points_make(rest, 1, &seed);
            embedding = points_embed(&b, rest, kind ? SB_EMBED_PLAIN : SB_EMBED_SMOOTH);
            cut_all(&b, &p);
            CHECK_INT(sb_embedding_get_report(embedding).lost, 0);
            parts_move(&b, &p);
            worst = fmax(worst, points_fault(&b, embedding, &p, rest, &count));
            CHECK(count > (kind ? POINTS / 5 : 8 * POINTS / 10));
            free(rest);
            sb_embedding_destroy(embedding);
            block_free(&b);
        }
    printf("   points go with their parts to %.1e m\n", worst);
    CHECK_NEAR(worst, 0, scene_tolerance(1e-12 * (double)block_size.x, 200));
}

/* Points of a body in motion are where they were, when it is cut. */
static void test_instant(void)
{
    unsigned long long seed = 87;
    double worst = 0;
    for (int i = 0; i < 3; i++) {
        block_options options = block_default(intervals_of[i]);
        block b = block_make(&options);
        sb_vec3 *rest = (sb_vec3 *)malloc(3 * POINTS * sizeof *rest), *before = rest + POINTS, *after = before + POINTS;
        sb_embedding *embedding;
        points_make(rest, 0, &seed);
        embedding = points_embed(&b, rest, SB_EMBED_SMOOTH);
        block_shake(&b);
        for (int stroke = 0; stroke < (check_quick() ? 3 : 10); stroke++) {
            sb_vec3 triangles[18];
            int count = strip_random(triangles, &seed);
            block_step(&b, 1);
            CHECK_OK(sb_embedding_update(embedding, sb_body_positions(b.body), before, NULL, NULL));
            block_cut(&b, triangles, count);
            CHECK_OK(sb_embedding_update(embedding, sb_body_positions(b.body), after, NULL, NULL));
            for (int k = 0; k < POINTS; k++)
                worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(after[k], before[k])));
        }
        CHECK_INT(sb_embedding_get_report(embedding).lost, 0);
        free(rest);
        sb_embedding_destroy(embedding);
        block_free(&b);
    }
    printf("   points jump by %.1e m at a cut\n", worst);
    CHECK_NEAR(worst, 0, scene_tolerance(1e-13 * (double)block_size.x, 100));
}

/* How far points are from their places at rest (m), which they have in any mesh of the body. */
static double points_offset(const block *b, sb_embedding *embedding, const sb_vec3 *rest)
{
    sb_vec3 *points = (sb_vec3 *)malloc(POINTS * sizeof *points);
    double worst = 0;
    CHECK_OK(sb_embedding_update(embedding, b->body->reference, points, NULL, NULL));
    for (int i = 0; i < POINTS; i++)
        worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(points[i], rest[i])));
    free(points);
    return worst;
}

/* States of other cuts are loaded under points that follow since before there was a cut, or since after. */
static void test_loaded(void)
{
    const sb_vec3 middle = {REAL(0.0277), REAL(0.0213), REAL(0.0239)};
    unsigned long long seed = 93;
    for (int first = 0; first < 2; first++) {
        block_options options = block_default(2);
        block b = block_make(&options);
        planes p = planes_make(1);
        sb_vec3 *rest = (sb_vec3 *)malloc(POINTS * sizeof *rest);
        sb_embedding *embedding;
        void *states[2];
        size_t sizes[2];
        int count;
        points_make(rest, 0, &seed);
        if (first)
            sb_cut_destroy(b.cut);
        embedding = points_embed(&b, rest, SB_EMBED_PLAIN);
        if (first)
            block_cut_create(&b, 2);
        for (int k = 0; k < 2; k++) {
            sizes[k] = sb_body_state_size(b.body);
            states[k] = malloc(sizes[k]);
            CHECK_OK(sb_body_state_save(b.body, states[k], sizes[k]));
            if (k == 0)
                cut_all(&b, &p);
        }
        CHECK_OK(sb_body_state_load(b.body, states[0], sizes[0], NULL));
        CHECK_NEAR(points_offset(&b, embedding, rest), 0, scene_tolerance(1e-14, 200));
        block_cut_plane(&b, middle, sb_v3(REAL(0.1), REAL(0.1), 1));
        CHECK_OK(sb_body_state_load(b.body, states[1], sizes[1], NULL));
        CHECK_NEAR(points_offset(&b, embedding, rest), 0, scene_tolerance(1e-14, 200));
        parts_move(&b, &p);
        CHECK_NEAR(points_fault(&b, embedding, &p, rest, &count), 0,
                   scene_tolerance(1e-12 * (double)block_size.x, 200));
        CHECK(count > 8 * POINTS / 10);
        for (int k = 0; k < 2; k++)
            free(states[k]);
        free(rest);
        sb_embedding_destroy(embedding);
        block_free(&b);
    }
}

/* Others give the number of a piece to a cell elsewhere, which the cut does not know. */
static void test_changed_by_others(void)
{
    unsigned long long seed = 97;
    block_options options = block_default(2);
    planes p = planes_make(1);
    block b = block_make(&options);
    sb_vec3 *rest = (sb_vec3 *)malloc(POINTS * sizeof *rest);
    sb_change_cell cell = sb_default_change_cell();
    sb_embedding *embedding;
    sb_body_change *change;
    int piece = -1, whole = -1, nodes[4];
    sb_error error;
    points_make(rest, 0, &seed);
    embedding = points_embed(&b, rest, SB_EMBED_PLAIN);
    cut_all(&b, &p);
    for (int i = 0; i < sb_body_element_count(b.body); i++)
        if (sb_body_cell_share(b.body, i) < 1)
            piece = i;
        else if (whole < 0)
            whole = i;
    memcpy(nodes, sb_body_cell_nodes(b.body, whole), sizeof nodes);
    cell.nodes = nodes;
    cell.parent = whole;
    CHECK_OK(sb_body_change_begin(b.body, &change, &error));
    CHECK_OK(sb_body_change_remove_cell(change, whole, &error));
    CHECK_OK(sb_body_change_replace_cell(change, piece, &cell, &error));
    CHECK_OK(sb_body_change_commit(change, &error));
    CHECK_NEAR(points_offset(&b, embedding, rest), 0, scene_tolerance(1e-14, 200));
    free(rest);
    sb_embedding_destroy(embedding);
    block_free(&b);
}

/* ---- rows of mappings -------------------------------------------------------------------------------------------- */

/* Adds soft rows at the points. */
static int rows_add(block *b, const sb_vec3 *points)
{
    sb_embedding *embedding = points_embed(b, points, SB_EMBED_PLAIN);
    sb_embedding_rows rows;
    sb_real soft = REAL(0.01);
    int id = 0;
    sb_error error;
    CHECK_OK(sb_embedding_mapping(embedding, NULL, &rows, NULL));
    if (!CHECK_OK(sb_body_add_mapping(b->body, &rows.mapping, &soft, 1, points, &id, &error)))
        printf("%s\n", error.message);
    sb_embedding_rows_free(&rows);
    sb_embedding_destroy(embedding);
    return id;
}

static void test_rows(void)
{
    unsigned long long seed = 91;
    for (int i = 0; i < 3; i++) {
        block_options options = block_default(intervals_of[i]);
        planes p = planes_make(2);
        block b = block_make(&options), again = block_make(&options);
        sb_vec3 *rest = (sb_vec3 *)malloc(2 * POINTS * sizeof *rest), *points = rest + POINTS;
        sb_recording *recording = NULL;
        sb_recording_report report;
        double worst = 0;
        int id;
        points_make(rest, 0, &seed);
        id = rows_add(&b, rest);
        CHECK_INT(rows_add(&again, rest), id);
        CHECK_OK(sb_recording_start(b.body, 0, NULL, &recording, NULL));
        cut_all(&b, &p);
        block_step(&b, 2);
        sb_recording_stop(recording);
        if (!CHECK_OK(sb_recording_replay(recording, again.body, &report)))
            printf("%s, step %d\n", report.error.message, report.step);
        CHECK(sb_body_state_hash(again.body) == sb_body_state_hash(b.body));
        parts_move(&b, &p);
        CHECK_OK(sb_body_mapping_points(b.body, id, points));
        for (int k = 0; k < POINTS; k++) {
            int sides = sides_of(&p, rest[k], 1e-6, link_of(&b));
            if (sides >= 0)
                worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(points[k], moved(sides, rest[k]))));
        }
        CHECK_NEAR(worst, 0, scene_tolerance(1e-12 * (double)block_size.x, 200));
        sb_recording_destroy(recording);
        free(rest);
        block_free(&b);
        block_free(&again);
    }
}

/* ---- cables ---- */

enum { CABLES = 20, CABLE_POINTS = 6 }; /* the last point of each is in space */

/* Cables of no stiffness through points inside elements. */
static void cables_add(block *b, const sb_vec3 *points, int *ids)
{
    sb_embedding *embedding = points_embed(b, points, SB_EMBED_PLAIN);
    sb_embedding_rows rows;
    CHECK_OK(sb_embedding_mapping(embedding, NULL, &rows, NULL));
    for (int c = 0; c < CABLES; c++) {
        const int first = c * CABLE_POINTS, *start = rows.mapping.row_start + first;
        int starts[CABLE_POINTS + 1];
        sb_mapping own = {CABLE_POINTS, starts, rows.mapping.nodes + start[0], rows.mapping.weights + start[0]};
        sb_cable_def def = sb_default_cable_def();
        sb_error error;
        for (int k = 0; k <= CABLE_POINTS; k++)
            starts[k] = start[k < CABLE_POINTS ? k : CABLE_POINTS - 1] - start[0];
        def.count = CABLE_POINTS, def.rows = &own, def.places = points + first;
        if (!CHECK_OK(sb_body_add_cable(b->body, &def, ids + c, &error)))
            printf("%s\n", error.message);
    }
    sb_embedding_rows_free(&rows);
    sb_embedding_destroy(embedding);
}

/* Points of cables go with their material where it is cut, places stay; recordings replay to the last bit. */
static void test_cables(void)
{
    unsigned long long seed = 92;
    for (int i = 0; i < 3; i++) {
        block_options options = block_default(intervals_of[i]);
        planes p = planes_make(2);
        block b = block_make(&options), again = block_make(&options);
        sb_vec3 *rest = (sb_vec3 *)malloc(POINTS * sizeof *rest), points[CABLE_POINTS];
        sb_recording *recording = NULL;
        sb_recording_report report;
        double worst = 0;
        int ids[CABLES], told = 0;
        points_make(rest, 0, &seed);
        CHECK_OK(sb_recording_start(b.body, 0, NULL, &recording, NULL));
        cables_add(&b, rest, ids);
        cut_all(&b, &p);
        block_step(&b, 2);
        sb_recording_stop(recording);
        if (!CHECK_OK(sb_recording_replay(recording, again.body, &report)))
            printf("%s, step %d\n", report.error.message, report.step);
        CHECK(sb_body_state_hash(again.body) == sb_body_state_hash(b.body));
        parts_move(&b, &p);
        for (int c = 0; c < CABLES; c++) {
            CHECK_OK(sb_body_cable_points(b.body, ids[c], points));
            for (int k = 0; k < CABLE_POINTS; k++) {
                sb_vec3 x = rest[c * CABLE_POINTS + k];
                int sides = sides_of(&p, x, 1e-6, link_of(&b));
                if (k == CABLE_POINTS - 1)
                    CHECK(scene_distance(points + k, &x, 1) == 0);
                else if (sides >= 0)
                    worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(points[k], moved(sides, x)))), told++;
            }
        }
        CHECK(told > CABLES);
        CHECK_NEAR(worst, 0, scene_tolerance(1e-12 * (double)block_size.x, 200));
        sb_recording_destroy(recording);
        free(rest);
        block_free(&b);
        block_free(&again);
    }
}

/* ---- the cell of a point ----------------------------------------------------------------------------------------- */

static void test_find(void)
{
    const sb_real middle[3] = {REAL(0.25), REAL(0.25), REAL(0.25)};
    block_options options = block_default(2);
    block b = block_make(&options);
    int corners = 0;
    CHECK_INT(sb_body_find_cell(NULL, 0, middle), -1);
    CHECK_INT(sb_body_find_cell(b.body, 0, NULL), -1);
    CHECK_INT(sb_body_find_cell(b.body, -1, middle), -1);
    CHECK_INT(sb_body_find_cell(b.body, sb_body_element_count(b.body), middle), -1);
    CHECK_INT(sb_body_find_cell(b.body, 3, middle), 3);
    block_cut_plane(&b, sb_v3(REAL(0.031), REAL(0.0207), REAL(0.0252)), sb_v3(1, REAL(0.4), REAL(0.2)));
    for (int cell = 0; cell < sb_body_element_count(b.body); cell++) /* corners are where their nodes' material is */
        for (int a = 0; a < 4 && sb_body_cell_in_use(b.body, cell); a++) {
            sb_real xi[3] = {a == 1 ? REAL(1) : 0, a == 2 ? REAL(1) : 0, a == 3 ? REAL(1) : 0};
            int found = sb_body_find_cell(b.body, cell, xi);
            CHECK_INT(sb_cut_cell_element(b.cut, found), sb_cut_cell_element(b.cut, cell));
            CHECK_INT(sb_body_cell_nodes(b.body, found)[a], b.cut->tets[4 * sb_cut_cell_element(b.cut, cell) + a]);
            corners += found != cell;
        }
    CHECK(corners > 10);
    scene_remove_cells(b.body); /* what others change the cut does not know */
    CHECK_INT(sb_body_find_cell(b.body, 5, middle), 5);
    sb_cut_destroy(b.cut);
    b.cut = NULL;
    CHECK_INT(sb_body_find_cell(b.body, 5, middle), 5);
    block_free(&b);
}

CHECK_SUITE(cut_follow, {"points go with their parts", test_points}, {"points stay when a cut is made", test_instant},
            {"states of other cuts", test_loaded}, {"changed by others", test_changed_by_others},
            {"rows of mappings go with their parts", test_rows}, {"cables", test_cables},
            {"the cell of a point", test_find});
