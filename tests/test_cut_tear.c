/* Tissue that tears: where it is stretched most, on from where it has been cut, and for the energy that it takes. */
#include "cut_blade.h"

/* A strip that is pulled apart across a notch in its middle plane, from x = 0. */
static const sb_vec3 strip_size = {REAL(0.06), REAL(0.006), REAL(0.03)};
static const double notch = 0.021, toughness = 0.5, young = 1e5;

static block strip_make(int cells, double shake, sb_cut_front front)
{
    sb_body_def def = sb_default_body_def();
    block b;
    memset(&b, 0, sizeof b);
    b.mesh = scene_box(SB_TET4, 2 * cells, shake > 0 ? 2 : 1, cells, strip_size, shake);
    def.mesh = &b.mesh;
    def.material = sb_material_linear(REAL(young), REAL(0.3), 1000);
    def.slack = 3;
    b.body = scene_body(&def);
    block_cut_create_tough(&b, 2, front, toughness);
    return b;
}

static void notch_it(block *b)
{
    sb_vec3 edge[2] = {{-1, -1, REAL(0.015)}, {-1, 1, REAL(0.015)}};
    int stroke = -1;
    CHECK_OK(sb_cut_begin(b->cut, edge, 2, &stroke, NULL));
    edge[0].x = edge[1].x = REAL(notch);
    CHECK_OK(sb_cut_move(b->cut, stroke, edge, NULL, NULL));
    sb_cut_end(b->cut, stroke);
    CHECK_INT(b->body->component_count, 1);
}

static void pull(block *b, double open)
{
    for (int i = 0; i < b->mesh.node_count; i++) {
        double z = (double)b->mesh.nodes[i].z;
        sb_vec3 by = sb_v3(0, 0, REAL(z < 0.015 ? -open / 2 : open / 2));
        if (z < 1e-6 || z > (double)strip_size.z - 1e-6)
            CHECK_OK(sb_body_prescribe(b->body, &i, 1, SB_XYZ, &by, 1));
    }
}

/* Solves, and holds crumbs that have come loose. */
static double settle(block *b)
{
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    sb_energy energy = {0, 0, 0};
    sb_result result;
    options.tolerance = REAL(scene_tolerance(1e-7, 1e3));
    for (int k = 0; k < 50; k++) {
        result = sb_body_solve_static(b->body, &options, &info);
        if (result != SB_ERROR_UNCONSTRAINED)
            break;
        for (int i = 0; i < sb_body_node_count(b->body); i++)
            if (b->body->node_component[i] == b->body->node_component[info.error.node])
                CHECK_OK(sb_body_hold(b->body, &i, 1, SB_XYZ, NULL));
    }
    if (!CHECK_OK(result))
        printf("%s\n", info.error.message);
    CHECK_OK(sb_body_energy(b->body, &energy));
    return (double)energy.elastic;
}

static sb_cut_info tear(block *b, int nucleate, int max_tears)
{
    sb_tear_options options = sb_default_tear_options();
    sb_cut_info info;
    sb_error error;
    options.nucleate = nucleate;
    options.max_tears = max_tears;
    memset(&info, 0, sizeof info);
    if (!CHECK_OK(sb_cut_tear(b->cut, &options, &info, &error)))
        printf("%s\n", error.message);
    return info;
}

/* ---- a strip with a notch ---------------------------------------------------------------------------------------- */

/* Pulls a notched strip until its crack runs; returns the energy that it takes for its area (J/m^2). */
static double strip_energy(int cells, double shake, sb_cut_front front, int max_tears)
{
    block b = strip_make(cells, shake, front);
    double area = 0, energy = 0, farthest = notch;
    int tears = 0;
    notch_it(&b);
    for (int k = 1; k <= 200 && area < 0.5 * 0.006 * (0.06 - notch); k++) {
        double before;
        pull(&b, 1e-5 * k);
        before = settle(&b);
        for (int again = 0; again < 200; again++) {
            sb_cut_info info = tear(&b, 0, max_tears);
            double after;
            if (!info.torn)
                break;
            CHECK(info.torn <= max_tears && info.links > 0);
            after = settle(&b);
            CHECK(after < before * (1 + 1e-6));
            energy += before - after;
            area += (double)info.released_area;
            tears += info.torn;
            before = after;
        }
    }
    check_pieces(&b);
    for (int i = b.mesh.node_count; i < sb_body_node_count(b.body); i++)
        farthest = fmax(farthest, (double)sb_body_rest_positions(b.body)[i].x);
    CHECK(farthest > notch + 0.01); /* it went on from the notch */
    CHECK(tears > 0);
    block_free(&b);
    return energy / area;
}

static void test_energy(void)
{
    double coarse, fine;
    if (sizeof(sb_real) < 8)
        return; /* differences of energies */
    coarse = strip_energy(5, 0, SB_CUT_LAG, 1);
    fine = strip_energy(11, 0, SB_CUT_LAG, 4);
    printf("   tears take %.2f and %.2f of the toughness, in elements half as large\n", coarse / toughness,
           fine / toughness);
    CHECK_NEAR(coarse, toughness, 0.2 * toughness);
    CHECK_NEAR(fine, toughness, 0.2 * toughness);
    CHECK_NEAR(strip_energy(5, 0, SB_CUT_GLUE, 1), toughness, 0.2 * toughness);
    CHECK_NEAR(strip_energy(5, 0.15, SB_CUT_LAG, 1), toughness, 0.2 * toughness);
}

/* A long bar that tears anywhere tears at its notch, if it has one, and does not before it is stretched enough. */
static void test_notch(void)
{
    static const sb_vec3 size = {REAL(0.03), REAL(0.01), REAL(0.12)};
    for (int notched = 0; notched < 2; notched++) {
        sb_body_def def = sb_default_body_def();
        sb_vec3 triangle[3] = {{REAL(0.012), -1, REAL(0.0603)}, {REAL(0.012), 1, REAL(0.0603)}, {-9, 0, REAL(0.0603)}};
        sb_cut_info info;
        block b;
        memset(&b, 0, sizeof b);
        b.mesh = scene_box(SB_TET4, 6, 2, 24, size, 0);
        def.mesh = &b.mesh;
        def.material = sb_material_corotated(REAL(young), REAL(0.3), 1000);
        def.slack = 2;
        b.body = scene_body(&def);
        block_cut_create_tough(&b, 2, SB_CUT_LAG, toughness);
        if (notched)
            block_cut(&b, triangle, 1);
        memset(&info, 0, sizeof info);
        for (int k = 0; k < 60 && !info.torn; k++) {
            for (int i = 0; i < b.mesh.node_count; i++) {
                sb_vec3 x = b.mesh.nodes[i], by = sb_v3(0, 0, REAL(1e-4 * k) * x.z / size.z);
                if (x.z < REAL(1e-6) || x.z > size.z - REAL(1e-6))
                    CHECK_OK(sb_body_prescribe(b.body, &i, 1, SB_Z, &by, 1));
                if (x.y < REAL(1e-6) && x.x < REAL(1e-6) && by.z == 0 && x.z < REAL(1e-6))
                    CHECK_OK(sb_body_prescribe(b.body, &i, 1, SB_XYZ, &by, 1));
                if (x.y < REAL(1e-6) && x.x > size.x - REAL(1e-6) && x.z < REAL(1e-6))
                    CHECK_OK(sb_body_prescribe(b.body, &i, 1, SB_Y | SB_Z, &by, 1));
            }
            settle(&b);
            info = tear(&b, 1, 100);
            CHECK(k > 5 || !info.torn);
        }
        CHECK(info.torn >= 1);
        for (int l = b.cut->links.count - info.links; l < b.cut->links.count; l++) {
            const int *at = b.cut->links.items[l].key.at;
            sb_vec3 x = b.mesh.nodes[at[1] < 0 ? b.cut->tets[4 * at[0]] : at[0]];
            if (notched)
                CHECK(fabs((double)x.z - 0.06) < 0.0101 && (double)x.x > 0.0049 && (double)x.x < 0.0201);
        }
        if (!notched)
            CHECK_INT(info.torn, 1); /* one begins at a time */
        check_pieces(&b);
        block_free(&b);
    }
}

/* ---- blocks that are torn to pieces ------------------------------------------------------------------------------ */

/* A block that its ends are drawn apart from, fast. */
static block torn_block(int lattice, sb_cut_front front, const sb_jobs *jobs)
{
    sb_body_def def = sb_default_body_def();
    block b;
    memset(&b, 0, sizeof b);
    b.mesh = scene_box(SB_TET4, 6, 4, 5, block_size, 0.2);
    def.mesh = &b.mesh;
    def.material = sb_material_corotated(REAL(5000), REAL(0.4), 1000);
    def.slack = 4;
    if (jobs)
        def.jobs = *jobs;
    b.body = scene_body(&def);
    block_cut_create_tough(&b, lattice, front, 0.2);
    scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
    return b;
}

static int tear_frames(block *b, int first, int end)
{
    int tears = 0;
    for (int k = first; k < end; k++) {
        for (int i = 0; i < b->mesh.node_count; i++) {
            sb_vec3 by = sb_v3(REAL(0.002 * (k + 1)), 0, 0);
            if (b->mesh.nodes[i].x > block_size.x - REAL(1e-6))
                CHECK_OK(sb_body_prescribe(b->body, &i, 1, SB_XYZ, &by, 1));
        }
        block_step(b, 1);
        tears += tear(b, 1, 20).torn;
    }
    return tears;
}

/* Mass, momentum and energy stay what they are, and the mesh right, until the block has come apart and after that. */
static void test_apart(void)
{
    for (int i = 0; i < 3; i++)
        for (int front = 0; front < 2; front++) {
            block b = torn_block(intervals_of[i], (sb_cut_front)front, NULL);
            sb_vec3 triangles[6];
            int tears = 0;
            square_make(sb_v3(REAL(0.0307), 0, 0), sb_v3(1, REAL(0.1), 0), 0.015, triangles);
            block_cut(&b, triangles, 2);
            for (int k = 0; k < 30; k++) {
                totals before, after;
                sb_cut_info info;
                tears += tear_frames(&b, k, k + 1);
                before = totals_of(&b);
                info = tear(&b, 1, 3);
                after = totals_of(&b);
                after.elastic += (double)info.released_energy;
                check_totals(&before, &after);
                CHECK(info.torn <= 3 && (info.torn > 0) == (info.links > 0));
                CHECK(info.torn == 0 || info.glued > 0 || info.released_area > 0);
            }
            check_pieces(&b);
            CHECK(tears > 20);
            CHECK(b.body->component_count > 1);
            block_free(&b);
        }
}

static void test_again(void)
{
    block b = torn_block(2, SB_CUT_LAG, NULL), again = torn_block(2, SB_CUT_LAG, NULL);
    sb_recording *recording = NULL;
    sb_recording_report report;
    size_t first_size, size;
    void *first, *middle;
    uint64_t start, end;
    first = state_of(&b, &first_size);
    start = sb_body_state_hash(b.body);
    CHECK_OK(sb_recording_start(b.body, 0, NULL, &recording, NULL));
    CHECK(tear_frames(&b, 0, 9) > 0);
    middle = state_of(&b, &size);
    tear_frames(&b, 9, 18);
    end = sb_body_state_hash(b.body);
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, again.body, &report)))
        printf("%s, step %d\n", report.error.message, report.step);
    CHECK(sb_body_state_hash(again.body) == end);
    load(&b, middle, size);
    tear_frames(&b, 9, 18);
    CHECK(sb_body_state_hash(b.body) == end);
    load(&b, first, first_size);
    CHECK(sb_body_state_hash(b.body) == start);
    CHECK_INT(b.cut->links.count, 0);
    sb_recording_destroy(recording);
    free(first);
    free(middle);
    block_free(&b);
    block_free(&again);
}

static void test_threads(void)
{
    static const int workers_of[4] = {1, 2, 3, 16};
    uint64_t first = 0;
    for (int k = 0; k < 4; k++) {
        int workers = workers_of[k];
        sb_jobs jobs = scene_jobs(&workers);
        block b = torn_block(2, SB_CUT_GLUE, &jobs);
        CHECK(tear_frames(&b, 0, 12) > 0);
        first = k ? first : sb_body_state_hash(b.body);
        CHECK(sb_body_state_hash(b.body) == first);
        block_free(&b);
    }
}

/* ---- what fails -------------------------------------------------------------------------------------------------- */

static block counted_stretched(scene_memory *memory)
{
    block b = counted_block_tough(memory, 3, 0.01, SB_CUT_GLUE, 0.05);
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)b.mesh.node_count, sizeof *u);
    for (int i = 0; i < b.mesh.node_count; i++)
        u[i].x = REAL(0.5) * b.mesh.nodes[i].x * (1 + 5 * b.mesh.nodes[i].y);
    CHECK_OK(sb_body_set_displacements(b.body, u));
    free(u);
    return b;
}

static void test_no_memory(void)
{
    uint64_t expected = 0;
    for (int fail = 0, done = 0; !done && fail < 600; fail++) {
        scene_memory memory = {0, 0, 0, 0};
        block b = counted_stretched(&memory);
        sb_tear_options options = sb_default_tear_options();
        sb_cut_info info;
        sb_result result = SB_OK;
        options.nucleate = 1;
        memset(&info, 0, sizeof info);
        memory.fail_at = fail ? memory.calls + fail : 0;
        for (int k = 0; k < 3; k++) {
            uint64_t before = sb_body_state_hash(b.body);
            result = sb_cut_tear(b.cut, &options, &info, NULL);
            if (result != SB_OK) {
                memory.fail_at = 0;
                CHECK_RESULT(result, SB_ERROR_MEMORY);
                CHECK(sb_body_state_hash(b.body) == before);
                check_pieces(&b);
                CHECK_OK(sb_cut_tear(b.cut, &options, &info, NULL));
            }
            CHECK(info.torn > 0);
        }
        done = fail && memory.fail_at > memory.calls;
        memory.fail_at = 0;
        expected = fail ? expected : sb_body_state_hash(b.body);
        CHECK(sb_body_state_hash(b.body) == expected);
        block_free(&b);
        CHECK_INT(memory.live, 0);
        CHECK(done || fail < 599);
    }
}

static void test_mistakes(void)
{
    block_options of = block_default(1);
    block b, soft = block_make(&of);
    sb_tear_options options = sb_default_tear_options();
    sb_cut_info info;
    sb_error error;
    of.toughness = 1;
    b = block_make(&of);
    CHECK_INT(options.nucleate, 0);
    CHECK_INT(options.max_tears, 8);
    CHECK_OK(sb_cut_tear(b.cut, NULL, NULL, NULL));
    CHECK_OK(sb_cut_tear(b.cut, NULL, &info, &error));
    CHECK_INT(info.torn, 0); /* at rest */
    CHECK_INT(info.links, 0);
    CHECK_INT(info.parts, 1);
    CHECK_RESULT(sb_cut_tear(NULL, &options, &info, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_cut_tear(soft.cut, &options, &info, &error), SB_ERROR_ARGUMENT);
    options.max_tears = 0;
    CHECK_RESULT(sb_cut_tear(b.cut, &options, &info, &error), SB_ERROR_ARGUMENT);
    options.max_tears = 5000;
    CHECK_RESULT(sb_cut_tear(b.cut, &options, &info, &error), SB_ERROR_ARGUMENT);
    options.max_tears = 1;
    options.cookie++;
    CHECK_RESULT(sb_cut_tear(b.cut, &options, &info, &error), SB_ERROR_ARGUMENT);
    scene_remove_cells(b.body); /* somebody else */
    CHECK_RESULT(sb_cut_tear(b.cut, NULL, &info, &error), SB_ERROR_STATE);
    block_free(&b);
    block_free(&soft);
}

CHECK_SUITE(cut_tear, {"energy of a crack", test_energy}, {"a bar with a notch tears there", test_notch},
            {"blocks torn apart", test_apart}, {"again", test_again}, {"threads", test_threads},
            {"every allocation fails in turn", test_no_memory}, {"mistakes are named", test_mistakes});
