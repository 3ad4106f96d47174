/* Cuts that end within elements: parted along the blade's plane, and glued where it has not come through yet. */
#define SB_SPLIT_BUILD
#include "../src/softbody/base/bytes.h"

#include "cut_beam.h"
#include "cut_blade.h"

/* ---- the half-cut beam ------------------------------------------------------------------------------------------- */

/* Rows "tet4" of the design's table, whose glue has three points for each triangle. */
static void test_half(void)
{
    static const int cells[3][3] = {{11, 2, 3}, {21, 4, 7}, {41, 6, 13}};
    static const double lag[3] = {-1.741e-2, -2.555e-2, -2.972e-2}, glue[3] = {-1.832e-2, -2.659e-2, -3.062e-2};
    for (int k = 0; k < (check_quick() ? 2 : 3); k++)
        for (int m = 1; m <= 2; m++) {
            block whole = beam_of(SB_TET4, cells[k], m, SB_CUT_LAG), one = beam_of(SB_TET4, cells[k], m, SB_CUT_LAG);
            block two = beam_of(SB_TET4, cells[k], m, SB_CUT_GLUE), many = beam_of(SB_TET4, cells[k], m, SB_CUT_GLUE);
            int uncut, of_lag, of_glue, of_many;
            double released, all, sag, other;
            sb_cut_info info;
            beam_sag(&whole, &uncut);
            beam_cut(&one, 0, 0.02998, 1, &released);
            CHECK_NEAR(released, 9e-4, 0.05 * 9e-4); /* by elements, at least some of the last one is missing */
            CHECK_NEAR(beam_sag(&one, &of_lag), lag[k], scene_tolerance(1e-3, 4e4) * fabs(lag[k]));
            info = beam_cut(&two, 0, 0.02998, 1, &released);
            CHECK(info.glued > 0 && info.glued_area > 0);
            CHECK_INT(info.parts, 1);
            CHECK_NEAR(released, 9e-4, (m == 1 ? 1e-3 : scene_tolerance(1e-5, 1e3)) * 9e-4); /* so far it came */
            beam_cut(&many, 0, 0.02998, 36, &all);
            CHECK_NEAR(all, released, scene_tolerance(1e-12, 1e3) * released);
            sag = beam_sag(&two, &of_glue);
            other = beam_sag(&many, &of_many);
            CHECK_NEAR(sag, glue[k], scene_tolerance(3e-3, 5e4) * fabs(glue[k]));
            CHECK_NEAR(other, sag, scene_tolerance(1e-6, 1e5) * fabs(sag));
            CHECK(of_glue <= 1.15 * of_lag);
            check_pieces(&two);
            if (m == 2)
                printf("   half-cut beam, %d cells: sag %.4e, iterations uncut %d, lag %d, glue %d\n", cells[k][0], sag,
                       uncut, of_lag, of_glue);
            block_free(&whole);
            block_free(&one);
            block_free(&two);
            block_free(&many);
        }
}

/* ---- iterations -------------------------------------------------------------------------------------------------- */

/* Doubles the nodes of a beam that lie in its middle above z, for the elements beyond it. */
static sb_mesh beam_cut_by_hand(const sb_mesh *whole, double z)
{
    size_t nodes = (size_t)whole->node_count, corners = 4 * (size_t)whole->element_count;
    int *copies = (int *)calloc(nodes, sizeof *copies);
    sb_mesh lists = *whole, cut;
    lists.nodes = (sb_vec3 *)malloc(2 * nodes * sizeof *lists.nodes);
    lists.elements = (int *)malloc(corners * sizeof *lists.elements);
    memcpy(lists.nodes, whole->nodes, nodes * sizeof *lists.nodes);
    memcpy(lists.elements, whole->elements, corners * sizeof *lists.elements);
    for (int i = 0; i < whole->node_count; i++)
        if (fabs((double)whole->nodes[i].x - 0.1) < 1e-6 && (double)whole->nodes[i].z > z + 1e-6) {
            copies[i] = lists.node_count;
            lists.nodes[lists.node_count++] = whole->nodes[i];
        }
    for (int e = 0; e < whole->element_count; e++) {
        int *corner = lists.elements + 4 * e;
        double middle = 0;
        for (int a = 0; a < 4; a++)
            middle += (double)lists.nodes[corner[a]].x / 4;
        for (int a = 0; a < 4 && middle > 0.1; a++)
            corner[a] = copies[corner[a]] ? copies[corner[a]] : corner[a];
    }
    CHECK_OK(sb_mesh_copy(&lists, NULL, &cut, NULL));
    free(copies);
    free(lists.nodes);
    free(lists.elements);
    return cut;
}

/* Iterations of a step of a beam that is held at both ends: at rest under its weight, and once that has turned aside.
 */
static void beam_iterations(block *b, double means[2])
{
    enum { CALMING = 15, SETTLING = 40, STEPS = 10 };
    for (int i = 0; i < SETTLING + 2 * STEPS; i++) {
        sb_step_info info;
        if (i == SETTLING + STEPS)
            CHECK_OK(sb_body_set_gravity(b->body, sb_v3(0, REAL(9.81), 0)));
        CHECK_OK(sb_body_step(b->body, REAL(i < CALMING ? 0.1 : 0.01), &info));
        if (i >= SETTLING)
            means[i >= SETTLING + STEPS] += (double)info.pcg_iterations / (int)STEPS;
    }
}

/* A beam that is held at both ends; takes the mesh. */
static block beam_held(sb_mesh mesh, sb_cut_front front)
{
    sb_body_def def = sb_default_body_def();
    block b;
    memset(&b, 0, sizeof b);
    b.mesh = mesh;
    def.mesh = &b.mesh;
    def.material = sb_material_corotated(REAL(300e3), REAL(0.45), 1000);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.slack = 1;
    b.body = scene_body(&def);
    scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
    scene_fix_plane(b.body, &b.mesh, 0, (double)beam_size.x, SB_XYZ);
    block_cut_create_with(&b, 2, front);
    return b;
}

/* A cut through elements costs steps no more iterations than one between them, in a mesh that was made for it: half a
 * beam deep that is 1.1 times those of a whole beam at rest, and 1.2 times while it swings, as its lips move apart in
 * the coarse space, too. */
static void test_iterations(void)
{
    enum { WHOLE = 0, BY_HAND = 1, LAG = 2, GLUE = 3, KINDS = 4 };
    static const int cells[3] = {20, 4, 8};
    double means[KINDS][2] = {{0, 0}, {0, 0}, {0, 0}, {0, 0}};
    for (int kind = 0; kind < KINDS; kind++) {
        sb_mesh mesh = scene_box(SB_TET4, cells[0], cells[1], cells[2], beam_size, 0);
        double released;
        block b;
        if (kind == BY_HAND) {
            sb_mesh whole = mesh;
            mesh = beam_cut_by_hand(&whole, 0.03);
            sb_mesh_free(&whole);
        }
        b = beam_held(mesh, kind == GLUE ? SB_CUT_GLUE : SB_CUT_LAG);
        if (kind >= LAG)
            beam_cut(&b, 0, 0.03, 5, &released);
        beam_iterations(&b, means[kind]);
        block_free(&b);
    }
    printf("   at rest %.1f; %.1f by hand, %.1f lag, %.1f glue; swinging %.1f; %.1f, %.1f, %.1f\n", means[WHOLE][0],
           means[BY_HAND][0], means[LAG][0], means[GLUE][0], means[WHOLE][1], means[BY_HAND][1], means[LAG][1],
           means[GLUE][1]);
    for (int kind = LAG; kind <= GLUE; kind++) {
        for (int moving = 0; moving < 2; moving++) {
            CHECK(means[kind][moving] <= 1.3 * means[WHOLE][moving]);
            CHECK(means[kind][moving] <= 1.05 * means[BY_HAND][moving] + 0.5);
        }
    }
}

/* Nor does a cut that leaves slivers, by shares of an element beyond a plane of nodes. */
static void test_slivers(void)
{
    static const int cells[3] = {20, 4, 8};
    static const double shares[7] = {-1, 0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4}; /* -1: whole */
    double whole[2] = {0, 0};
    for (int k = 0; k < 7; k++) {
        block b = beam_held(scene_box(SB_TET4, cells[0], cells[1], cells[2], beam_size, 0), SB_CUT_LAG);
        double means[2] = {0, 0};
        sb_vec3 triangles[6];
        square_make(sb_v3(REAL(0.1 + 0.01 * shares[k]), REAL(0.015), REAL(0.0599)), sb_v3(1, 0, 0), 0.03, triangles);
        if (k > 0)
            CHECK_INT(block_cut(&b, triangles, 2).parts, 1);
        beam_iterations(&b, means);
        for (int moving = 0; moving < 2; moving++) {
            whole[moving] = k == 0 ? means[moving] : whole[moving];
            CHECK(means[moving] <= 1.3 * whole[moving]);
        }
        printf("   %g of an element beyond its nodes: at rest %.1f, swinging %.1f iterations\n", shares[k], means[0],
               means[1]);
        block_free(&b);
    }
}

static void test_curved(void) { beam_check_curved(SB_TET4, 2); }

/* The blade goes on by a fifth of an element: with glue each advance lets the beam sag some more, and frees no more
 * than a fraction of all; elements that hold until they are cut through give way all at once. */
static void test_popping(void)
{
    static const int cells[3] = {21, 4, 7};
    double most[2] = {0, 0}, whole[2] = {0, 0};
    int still[2] = {0, 0}, iterations;
    for (int front = 0; front < 2; front++) {
        block b = beam_of(SB_TET4, cells, 2, (sb_cut_front)front);
        sb_vec3 edge[2];
        double last = beam_sag(&b, &iterations), first = last;
        int stroke;
        for (int i = 0; i <= 15; i++) {
            double z = 0.045 - i * 0.06 / 7 / 5, sag;
            edge[0] = sb_v3(REAL(0.1), REAL(-0.01), REAL(i ? z : 0.065));
            edge[1] = sb_v3(REAL(0.1), REAL(0.04), REAL(i ? z : 0.065));
            if (i == 0) {
                CHECK_OK(sb_cut_begin(b.cut, edge, 2, &stroke, NULL));
                continue;
            }
            CHECK_OK(sb_cut_move(b.cut, stroke, edge, NULL, NULL));
            sag = beam_sag(&b, &iterations);
            CHECK(sag <= last + 1e-6 * fabs(last));
            still[front] += i > 1 && !(sag < last - 1e-5 * fabs(last));
            if (i > 1)
                most[front] = fmax(most[front], last - sag);
            last = sag;
        }
        whole[front] = first - last;
        block_free(&b);
    }
    printf("   advances by h/5: lag stands still in %d of 14, and opens %.0f %% of all at most; glue %d, %.0f %%\n",
           still[0], 100 * most[0] / whole[0], still[1], 100 * most[1] / whole[1]);
    CHECK(still[1] < still[0]);
    CHECK(most[1] / whole[1] < most[0] / whole[0]);
}

/* ---- the edge-cracked plate -------------------------------------------------------------------------------------- */

static void test_crack(void)
{
    double coarse, fine, lag;
    if (sizeof(sb_real) < 8)
        return; /* differences of energies */
    coarse = plate_error(SB_TET4, 11, SB_CUT_GLUE);
    fine = plate_error(SB_TET4, 21, SB_CUT_GLUE);
    lag = plate_error(SB_TET4, 21, SB_CUT_LAG);
    printf("   stress intensity off by %.1f and %.1f %% with glue, by %.1f %% without\n", 100 * coarse, 100 * fine,
           100 * lag);
    CHECK(fabs(coarse) < 0.25);
    CHECK(fabs(fine) < 0.129);
    CHECK(fabs(lag) > fabs(fine) + 0.03);
}

/* ---- a plane that is glued altogether ---------------------------------------------------------------------------- */

/* As if all that has been cut was predicted only: glue on all lips. */
static void glue_all(block *b)
{
    sb_cut *cut = b->cut;
    sb_body_change *change = NULL;
    for (int l = 0; l < cut->links.count; l++)
        cut->links.items[l].state = SBI_LINK_PREDICTED;
    cut->next_glue_count = 0;
    for (int tet = 0; tet < cut->tet_count; tet++) {
        sbi_parted parted;
        sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * tet, tet, &parted);
        for (int place = 0; place < SBI_LIPS * cut->lattice.micro_count; place++) {
            sbi_lip lips[SBI_LIPS];
            int count = sbi_parted_lips(&parted, place / SBI_LIPS, lips);
            CHECK(sbi_cut_reserve_glue(cut, cut->next_glue_count + 1));
            for (int k = 0; k < count; k++)
                if (lips[k].place == place % SBI_LIPS) {
                    cut->next_glue[cut->next_glue_count].tet = tet;
                    cut->next_glue[cut->next_glue_count++].place = place;
                }
        }
    }
    CHECK(sbi_cut_make_ties(cut));
    sbi_cut_take_next_glue(cut);
    CHECK_OK(sb_body_change_begin(b->body, &change, NULL));
    sbi_change_set_glue(change, cut->ties, cut->tie_count);
    cut->changing = 1;
    CHECK_OK(sb_body_change_commit(change, NULL));
    cut->changing = 0;
    check_pieces(b);
}

/* Takes so many triangles of the glue away, at random places. */
static void release_some(block *b, int count, unsigned long long *seed)
{
    sb_cut *cut = b->cut;
    sb_error error;
    CHECK(sbi_cut_reserve_glue(cut, cut->glue_count));
    cut->next_glue_count = cut->glue_count;
    memcpy(cut->next_glue, cut->glue, (size_t)cut->glue_count * sizeof *cut->glue);
    for (; count > 0 && cut->next_glue_count > 0; count--) {
        int at = (int)(check_random(seed) * cut->next_glue_count);
        for (int k = at; k + 1 < cut->next_glue_count; k++)
            cut->next_glue[k] = cut->next_glue[k + 1];
        cut->next_glue_count--;
    }
    if (!CHECK_OK(sbi_cut_part(cut, &error)))
        printf("%s\n", error.message);
}

static block bar_of(sb_material material, double beta)
{
    static const int cells[3] = {5, 3, 4};
    block b = cantilever(SB_TET4, cells, block_size, material, 2, SB_CUT_GLUE);
    b.cut->beta = REAL(beta);
    sb_body_set_gravity(b.body, sb_v3(0, 0, 0));
    return b;
}

/* Draws the far end by dx along x, the bar being clamped at the other. */
static void draw(block *b, double dx)
{
    for (int i = 0; i < b->mesh.node_count; i++) {
        sb_vec3 by = sb_v3(REAL(dx), 0, 0);
        if (b->mesh.nodes[i].x > block_size.x - REAL(1e-6))
            CHECK_OK(sb_body_prescribe(b->body, &i, 1, SB_XYZ, &by, 1));
    }
}

static void solve(block *b, double tolerance)
{
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    options.tolerance = REAL(scene_tolerance(tolerance, 1e4));
    if (!CHECK_OK(sb_body_solve_static(b->body, &options, &info)))
        printf("%s\n", info.error.message);
}

static double elastic_energy(const block *b)
{
    sb_energy energy;
    memset(&energy, 0, sizeof energy);
    CHECK_OK(sb_body_energy(b->body, &energy));
    return (double)energy.elastic;
}

/* A constant strain passes through a glued plane but for the jump of the glue, which falls as 1/beta. */
static void test_patch(void)
{
    const double pull = 5000 * 0.001 / (double)block_size.x; /* Pa */
    static const double betas[4] = {10, 1e3, 1e5, 1e6};
    double whole = 0, errors[4];
    for (int k = -1; k < (sizeof(sb_real) < 8 ? 2 : 4); k++) {
        block b = bar_of(sb_material_linear(REAL(5000), 0, 1000), k < 0 ? 10 : betas[k]);
        draw(&b, 0.001);
        if (k >= 0) {
            block_cut_plane(&b, sb_v3(REAL(0.0313), REAL(0.02), REAL(0.025)), sb_v3(1, 0, 0));
            glue_all(&b);
            CHECK_INT(b.body->component_count, 1);
        }
        solve(&b, 1e-9);
        if (k < 0)
            whole = elastic_energy(&b);
        else /* of two in a row half the work is done where one holds it: energy goes with stress */
            errors[k] = 1 - elastic_energy(&b) / whole;
        if (k == 3)
            CHECK_NEAR(block_stress_off(&b, pull), 0, 1e-6 * pull);
        block_free(&b);
    }
    CHECK(errors[0] > 1e-3 && errors[0] < 0.05);
    CHECK_NEAR(errors[1] * 1e2 / errors[0], 1, 0.05);
    if (sizeof(sb_real) < 8)
        return;
    CHECK_NEAR(errors[2] * 1e4 / errors[0], 1, 0.05);
    CHECK_NEAR(errors[3], 0, 1e-6);
}

/* Released piece by piece in any order, a bar that is drawn gives way all the time, and ends as the bar that was cut.
 */
static void test_release(void)
{
    static const sb_vec3 middle = {REAL(0.0313), REAL(0.02), REAL(0.025)}, normal = {1, REAL(0.2), REAL(0.1)};
    for (int order = 0; order < 2; order++) {
        unsigned long long seed = 3 + (unsigned long long)order;
        block cut = bar_of(sb_material_corotated(REAL(5000), REAL(0.4), 1000), 10);
        block b = bar_of(sb_material_corotated(REAL(5000), REAL(0.4), 1000), 10);
        double last, first;
        block_cut_plane(&cut, middle, normal);
        block_cut_plane(&b, middle, normal);
        CHECK_INT(b.body->component_count, 2);
        glue_all(&b);
        CHECK_INT(b.body->component_count, 1);
        draw(&b, 0.002);
        draw(&cut, 0.002);
        solve(&b, 1e-11);
        solve(&cut, 1e-11);
        first = last = elastic_energy(&b);
        CHECK(first > 0);
        while (b.cut->glue_count) {
            double energy;
            release_some(&b, 1 + b.cut->glue_count / 3, &seed);
            check_pieces(&b);
            solve(&b, 1e-11);
            energy = elastic_energy(&b);
            CHECK(energy <= last * (1 + scene_tolerance(1e-9, 1e4)));
            last = energy;
        }
        CHECK_INT(b.body->component_count, 2);
        CHECK_INT(b.body->live->glue.count, 0);
        CHECK_NEAR(last, 0, scene_tolerance(1e-12, 1e5) * first);
        for (int i = 0; i < sb_body_node_count(b.body); i++)
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_body_positions(b.body)[i], sb_body_positions(cut.body)[i])), 0,
                       scene_tolerance(1e-8, 1e3) * 0.06);
        block_free(&cut);
        block_free(&b);
    }
}

/* A block half cut, with glue ahead of the blade. */
static block half_cut(const block_options *options, unsigned long long seed)
{
    block b = block_make(options);
    blade of = blade_random(&seed);
    int stroke = begin(&b, &of);
    move(&b, &of, stroke, 0.1);
    CHECK(b.cut->glue_count > 0);
    return b;
}

/* Forces are the derivative of the energy and the stiffness that of the forces; motions of all together cost nothing,
 * and turn what there is. */
static sb_vec3 quarter_turn(sb_vec3 x, int turns) { return turns ? sb_v3(-x.y, x.x, x.z) : x; }

/* Turns a body at rest, and what holds it, by 90 degrees about z. */
static void turn_block(block *b)
{
    int n = sb_body_node_count(b->body);
    const sb_vec3 *x = sb_body_rest_positions(b->body);
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)n, sizeof *u);
    for (int i = 0; i < n; i++)
        u[i] = sb_v3_sub(quarter_turn(x[i], 1), x[i]);
    CHECK_OK(sb_body_set_displacements(b->body, u));
    for (int i = 0; i < n; i++)
        if (x[i].x < REAL(1e-9))
            CHECK_OK(sb_body_prescribe(b->body, &i, 1, SB_XYZ, u + i, 1));
    free(u);
}

/* A block that is clamped at one end, cut in part across and under its weight; turned 1: before the cut, 2: after it.
 */
static block turned_block(sb_element_type element, int turned)
{
    block_options options = block_default(2);
    sb_static_options solve = sb_default_static_options();
    sb_step_info info;
    sb_vec3 edge[2];
    block b;
    int stroke = -1;
    options.element = element;
    options.shake = element == SB_TET4 ? 0.2 : 0;
    options.front = SB_CUT_GLUE;
    b = block_make(&options);
    scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
    if (turned == 1)
        turn_block(&b);
    for (int k = 0; k < 2; k++) { /* slanted; off all nodes, whose side would hang on axes and rounding */
        double z = k ? 0.0217 : 0.06;
        edge[0] = quarter_turn(sb_v3(REAL(0.03083 + 0.1 * z), REAL(-0.01), REAL(z)), turned == 1);
        edge[1] = quarter_turn(sb_v3(REAL(0.03023 + 0.1 * z), REAL(0.05), REAL(z)), turned == 1);
        if (k == 0)
            CHECK_OK(sb_cut_begin(b.cut, edge, 2, &stroke, NULL));
        else
            CHECK_OK(sb_cut_move(b.cut, stroke, edge, NULL, NULL));
    }
    if (turned == 2)
        turn_block(&b);
    CHECK_OK(sb_body_set_gravity(b.body, quarter_turn(sb_v3(0, REAL(-0.1), REAL(-0.2)), turned != 0)));
    solve.tolerance = REAL(scene_tolerance(1e-11, 1e6));
    if (!CHECK_OK(sb_body_solve_static(b.body, &solve, &info)))
        printf("%s\n", info.error.message);
    return b;
}

/* What a slanted stroke of ten frames opens of a beam, over the blade's area inside of it: error. */
static double opened_error(int lattice, double depth, double slant, double tilt)
{
    enum { FRAMES = 10 };
    const int cells[3] = {24, 4, 8};
    block b = beam_of(SB_TET4, cells, lattice, SB_CUT_GLUE);
    double y[2] = {-0.01, 0.04}, opened = 0, inside;
    sb_cut_info info;
    int stroke = -1;
    memset(&info, 0, sizeof info);
    for (int frame = 0; frame <= FRAMES; frame++) { /* one end of the edge goes deeper, in one plane */
        sb_vec3 edge[2];
        for (int k = 0; k < 2; k++) {
            double down = 0.005 + depth + tilt * (y[k] - 0.015), z = 0.065 - down * frame / (int)FRAMES;
            edge[k] = sb_v3(REAL(0.1001371 + slant * (z - 0.05) + 0.19 * y[k]), REAL(y[k]), REAL(z));
        }
        if (frame == 0)
            CHECK_OK(sb_cut_begin(b.cut, edge, 2, &stroke, NULL));
        else
            CHECK_OK(sb_cut_move(b.cut, stroke, edge, &info, NULL));
        opened += (double)info.released_area;
    }
    inside = 0.03 * depth * sqrt(1 + slant * slant + 0.19 * 0.19);
    block_free(&b);
    return opened / inside - 1;
}

/* What is opened converges to what the blade has been through: the finer the lattice, the smaller its triangles. */
static void test_opened(void)
{
    static const double most[3] = {0.03, 0.01, 0.003};
    double mean[3] = {0, 0, 0};
    unsigned long long seed = 12;
    int rounds = check_quick() ? 2 : 6;
    for (int round = 0; round < rounds; round++) {
        double depth = check_random_in(&seed, 0.02, 0.045), slant = check_random_in(&seed, -0.6, 0.6);
        double tilt = check_random_in(&seed, -0.2, 0.2);
        for (int i = 0; i < 3; i++) {
            double error = opened_error(intervals_of[i], depth, slant, tilt);
            CHECK_NEAR(error, 0, most[i]);
            mean[i] += fabs(error) / rounds;
        }
    }
    printf("  opened by slanted strokes: off by %.3f, %.3f, %.3f %% with lattices of 1, 2, 4\n", 100 * mean[0],
           100 * mean[1], 100 * mean[2]);
    CHECK(mean[2] < 0.001);
}

/* Corotated tissue that is turned before or after it is cut does what it does where it is. */
static void test_turned(void)
{
    static const sb_element_type elements[2] = {SB_TET4, SB_TET10};
    for (int k = 0; k < 2; k++) {
        block still = turned_block(elements[k], 0);
        double sag = 0;
        CHECK(still.body->live->glue.count > 0);
        for (int turned = 1; turned < 3; turned++) {
            block b = turned_block(elements[k], turned);
            double worst = 0;
            CHECK_INT(sb_body_node_count(b.body), sb_body_node_count(still.body));
            CHECK_INT(b.body->live->glue.count, still.body->live->glue.count);
            for (int i = 0; i < sb_body_node_count(b.body); i++) {
                sb_vec3 there = quarter_turn(still.body->position[i], 1);
                sag = fmax(sag, (double)sb_v3_norm(sb_body_displacements(still.body)[i]));
                worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(b.body->position[i], there)));
            }
            CHECK(sag > 1e-4);
            CHECK_NEAR(worst, 0, scene_tolerance(1e-8, 1e4) * sag);
            block_free(&b);
        }
        block_free(&still);
    }
}

static void test_objective(void)
{
    block_options options = block_default(2);
    unsigned long long seed = 8;
    block b;
    sb_vec3 *u, *du, *f, *g, *h;
    sb_quat turn = sb_quat_from_rotation_vector(sb_v3(REAL(0.4), REAL(0.6), REAL(1.1)));
    sb_vec3 force = {0, 0, 0}, torque = {0, 0, 0};
    const sbi_glue *glue;
    double energy, size = 0, work = 0, turned = 0;
    int n;
    options.front = SB_CUT_GLUE;
    b = half_cut(&options, 5);
    n = sb_body_node_count(b.body);
    glue = &b.body->live->glue;
    u = (sb_vec3 *)calloc((size_t)n * 5, sizeof *u), du = u + n, f = du + n, g = f + n, h = g + n;
    for (int i = 0; i < n; i++) {
        sb_vec3 x = b.body->reference[i];
        u[i] = sb_v3_sub(sb_quat_rotate(turn, x), x);
    }
    energy = (double)sbi_glue_energy(glue, u);
    CHECK_NEAR(energy, 0, scene_tolerance(1e-25, 1e9));
    sbi_glue_add_force(glue, u, f);
    for (int i = 0; i < n; i++)
        size = fmax(size, (double)sb_v3_norm(f[i]));
    CHECK_NEAR(size, 0, scene_tolerance(1e-10, 1e4));
    CHECK(sbi_assembly_force(&b.body->assembly, u, f) < 0); /* of all elements as well */
    for (int i = 0; i < n; i++)
        size = fmax(size, (double)sb_v3_norm(f[i]));
    CHECK_NEAR(size, 0, scene_tolerance(1e-10, 1e4) * 5000 * 1e-4);
    size = 0;
    for (int i = 0; i < n; i++) {
        u[i] = vector_in(-0.001, 0.001, &seed);
        du[i] = vector_in(-1, 1, &seed);
        f[i] = g[i] = sb_v3(0, 0, 0);
    }
    energy = (double)sbi_glue_energy(glue, u);
    sbi_glue_add_force(glue, u, f);
    for (int i = 0; i < n; i++) {
        work += (double)sb_v3_dot(f[i], du[i]);
        h[i] = sb_v3_madd(u[i], REAL(1e-4), du[i]);
        force = sb_v3_add(force, f[i]);
        torque = sb_v3_add(torque, sb_v3_cross(sb_v3_add(b.body->reference[i], u[i]), f[i]));
        size = fmax(size, (double)sb_v3_norm(f[i]));
    }
    CHECK_NEAR(sb_v3_norm(force), 0, scene_tolerance(1e-13, 1e3) * size);
    CHECK_NEAR(sb_v3_norm(torque), 0, scene_tolerance(1e-13, 1e3) * size);
    turned = (double)sbi_glue_energy(glue, h);
    for (int i = 0; i < n; i++)
        h[i] = sb_v3_madd(u[i], REAL(-1e-4), du[i]);
    CHECK_NEAR((turned - (double)sbi_glue_energy(glue, h)) / 2e-4, work, scene_tolerance(1e-9, 1e6) * fabs(work));
    for (int i = 0; i < n; i++) { /* of what is there the jumps turn */
        sb_vec3 x = b.body->reference[i];
        h[i] = sb_v3_sub(sb_quat_rotate(turn, sb_v3_add(x, u[i])), x);
    }
    CHECK_NEAR(sbi_glue_energy(glue, h), energy, scene_tolerance(1e-11, 1e4) * energy);
    memset(b.body->matrix.blocks, 0, (size_t)b.body->matrix.block_count * sizeof *b.body->matrix.blocks);
    sbi_glue_add_tangent(glue, 1, &b.body->matrix);
    sb_matrix_multiply(&b.body->matrix, &u[0].x, &g[0].x, NULL);
    for (int i = 0; i < n; i++)
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(g[i], f[i])), 0, scene_tolerance(1e-12, 1e3) * size);
    CHECK_NEAR(sb_matrix_asymmetry(&b.body->matrix), 0, 0);
    free(u);
    block_free(&b);
}

/* A tied node that others move in the material takes its ties along: what stays costs nothing when all turns. */
static void test_moved(void)
{
    block_options options = block_default(2);
    sb_quat turn = sb_quat_from_rotation_vector(sb_v3(REAL(0.4), REAL(0.6), REAL(1.1)));
    block b;
    const sbi_glue *glue;
    const sbi_glue_tie *tie;
    sb_body_change *change = NULL;
    sb_error error;
    sb_vec3 *u;
    int n, count, corner = 0;
    options.front = SB_CUT_GLUE;
    b = half_cut(&options, 5);
    glue = &b.body->live->glue;
    tie = glue->ties;
    count = glue->count;
    while (tie->nodes[0][corner] == tie->nodes[1][corner])
        corner++;
    CHECK_OK(sb_body_change_begin(b.body, &change, NULL));
    CHECK_OK(sb_body_change_move_node(
        change, tie->nodes[0][corner],
        sb_v3_add(b.body->reference[tie->nodes[0][corner]], sb_v3(REAL(2e-4), REAL(1e-4), REAL(-1e-4))), NULL, NULL, 0,
        NULL));
    if (!CHECK_OK(sb_body_change_commit(change, &error)))
        printf("%s\n", error.message);
    CHECK(glue->count > 0 && glue->count < count);
    n = sb_body_node_count(b.body);
    u = (sb_vec3 *)calloc((size_t)n, sizeof *u);
    for (int i = 0; i < n; i++)
        u[i] = sb_v3_sub(sb_quat_rotate(turn, b.body->reference[i]), b.body->reference[i]);
    CHECK_NEAR(sbi_glue_energy(glue, u), 0, scene_tolerance(1e-25, 1e9));
    CHECK_OK(sb_body_step(b.body, REAL(0.001), NULL));
    free(u);
    block_free(&b);
}

/* ---- frame by frame ---------------------------------------------------------------------------------------------- */

/* Shaking blocks part in two as they do without glue, and nothing stays glued between the two. */
static void test_shaking(void)
{
    static const double speeds[3] = {0.02, 0.04, 0.2};
    int rounds = check_quick() ? 6 : 45;
    for (int round = 0; round < rounds; round++) {
        double volumes[64], element = (double)(block_size.x * block_size.y * block_size.z) / 720;
        block_options options = block_default(round % 3 < 2 ? 1 : 2);
        unsigned long long seed = 100 + (unsigned long long)round;
        blade of;
        block b;
        int stroke, parts, large = 0;
        options.front = SB_CUT_GLUE;
        b = block_make(&options);
        of = blade_random(&seed);
        block_shake_at(&b, speeds[round / 3 % 3]);
        block_step(&b, 2);
        stroke = begin(&b, &of);
        sweep(&b, &of, stroke, -1, 1, 24);
        check_pieces(&b);
        parts = part_volumes(&b, volumes, 64);
        for (int k = 0; k < parts; k++)
            large += volumes[k] > element;
        if (!CHECK_INT(large, 2))
            printf("round %d\n", round);
        block_free(&b);
    }
}

/* Area of all lips at rest. */
static double lip_area(const block *b)
{
    double area = 0;
    for (int tet = 0; tet < b->cut->tet_count; tet++) {
        sbi_parted parted;
        sb_vec3 x[4];
        sbi_parted_make(&b->cut->lattice, &b->cut->links, b->cut->tets + 4 * tet, tet, &parted);
        for (int a = 0; a < 4; a++)
            x[a] = b->mesh.nodes[b->cut->tets[4 * tet + a]];
        for (int micro = 0; micro < b->cut->lattice.micro_count; micro++) {
            sbi_lip lips[SBI_LIPS];
            int count = sbi_parted_lips(&parted, micro, lips);
            for (int k = 0; k < count; k++) {
                sb_vec3 at[3];
                for (int c = 0; c < 3; c++)
                    at[c] = sbi_lattice_place(&parted.order, lips[k].corners[c], x);
                area += (double)sb_v3_norm(sb_v3_cross(sb_v3_sub(at[1], at[0]), sb_v3_sub(at[2], at[0]))) / 2;
            }
        }
    }
    return area;
}

/* Random cuts of a moving block: what glue gives up is all that the elastic energy loses, mass, momentum and kinetic
 * energy stay; what is released and what is glued are all lips. */
static void test_totals(void)
{
    unsigned long long seed = 21;
    double freed = 0;
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < (check_quick() ? 1 : 4); round++) {
            block_options options = block_default(intervals_of[i]);
            double released = 0;
            block b;
            options.front = SB_CUT_GLUE;
            b = block_make(&options);
            block_shake(&b);
            for (int k = 0; k < 4; k++) {
                sb_vec3 triangles[18];
                int count = strip_random(triangles, &seed);
                totals before, after;
                sb_cut_info info;
                block_step(&b, 2);
                before = totals_of(&b);
                info = block_cut(&b, triangles, count);
                after = totals_of(&b);
                after.elastic += (double)info.released_energy;
                check_totals(&before, &after);
                check_pieces(&b);
                released += (double)info.released_area;
                freed += (double)info.released_energy;
                CHECK(info.released_energy >= 0);
                CHECK_INT(info.glued, b.cut->glue_count);
                CHECK_NEAR(released + (double)info.glued_area, lip_area(&b), scene_tolerance(1e-11, 1e3) * released);
            }
            block_step(&b, 10);
            block_free(&b);
        }
    CHECK(freed > 0);
}

/* Steps of all kinds keep the momentum of a block that is glued, and those that are to have it, its energy. */
static void test_steps(void)
{
    for (int kind = 0; kind < 4; kind++) {
        block_options options = block_default(2);
        totals before, after;
        sb_material material = sb_material_stable_neo_hookean(REAL(5000), REAL(0.4), 1000);
        block b;
        options.front = SB_CUT_GLUE;
        options.slack = 1;
        options.integrator = kind == 3 ? SB_CENTRAL_DIFFERENCE : kind == 2 ? SB_NEWMARK : SB_EULER;
        b = half_cut(&options, 5);
        if (kind > 0)
            CHECK_OK(sb_body_set_material(b.body, &material, NULL));
        block_shake_at(&b, 0.2);
        before = totals_of(&b);
        for (int i = 0; i < 10; i++)
            CHECK_OK(sb_body_step(b.body, REAL(0.002), NULL));
        after = totals_of(&b);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(after.momentum, before.momentum)), 0,
                   scene_tolerance(kind == 0 ? 1e-5 : 1e-6, 1e2) * sqrt(2 * before.kinetic * before.mass));
        CHECK(after.kinetic + after.elastic < 1.01 * before.kinetic);
        if (kind == 3)
            CHECK_NEAR(after.kinetic + after.elastic, before.kinetic, 0.02 * before.kinetic);
        CHECK(sbi_glue_energy(&b.body->live->glue, b.body->displacement) > 0);
        block_free(&b);
    }
}

/* Light pieces at the end of glue stay calm under generalised alpha with stiffness damping: accelerations that forces
 * give there have no bound. */
static void test_calm(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 8, 7, 6, sb_v3(REAL(0.06), REAL(0.055), REAL(0.05)), 0);
    sb_body_def def = sb_default_body_def();
    double fastest = 0;
    int stroke = -1;
    block b;
    memset(&b, 0, sizeof b);
    b.mesh = mesh;
    def.mesh = &b.mesh;
    def.material = sb_material_corotated(REAL(10000), REAL(0.45), 1050);
    def.slack = REAL(1.5);
    def.integrator = SB_GENERALISED_ALPHA;
    def.spectral_radius = 0;
    def.max_newton = 1;
    def.gravity = sb_v3(0, REAL(1.5), -3);
    def.damping_stiffness = REAL(0.005);
    b.body = scene_body(&def);
    block_cut_create_with(&b, 2, SB_CUT_GLUE);
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].z < REAL(1e-6))
            CHECK_OK(sb_body_hold(b.body, &i, 1, SB_XYZ, NULL));
    for (int i = 0; i < 36; i++) {
        sb_real y = REAL(-0.004 + 0.1 * 0.02 * (i - 10));
        sb_vec3 edge[2] = {{REAL(0.044), y, REAL(0.03)}, {REAL(0.0441), y, REAL(0.066)}};
        if (i == 10)
            CHECK_OK(sb_cut_begin(b.cut, edge, 2, &stroke, NULL));
        if (i > 10)
            CHECK_OK(sb_cut_move(b.cut, stroke, edge, NULL, NULL));
        CHECK_OK(sb_body_step(b.body, REAL(0.02), NULL));
        for (int k = 0; k < sb_body_node_count(b.body); k++)
            fastest = fmax(fastest, (double)sb_v3_norm(sb_body_velocities(b.body)[k]));
    }
    CHECK(fastest < 0.2); /* it began with 0.04 m/s, and was 5e11 m/s fast in the end */
    block_free(&b);
}

/* Ties that a change leaves alone are not coupled anew. */
static void test_left_alone(void)
{
    block_options options = block_default(1);
    block b;
    sb_body_change *change = NULL;
    options.front = SB_CUT_GLUE;
    b = half_cut(&options, 5);
    if (CHECK_OK(sb_body_change_begin(b.body, &change, NULL))) {
        sbi_mesh_change out;
        sbi_matrix_couplings couplings;
        memset(&out, 0, sizeof out);
        CHECK_OK(sbi_live_make_next_glue(change, NULL));
        CHECK_INT(b.body->live->next_glue.count, b.body->live->glue.count);
        couplings = sbi_live_glue_couplings(b.body, &out);
        CHECK_INT(couplings.gone_count, 0);
        CHECK_INT(couplings.made_count, 0);
        b.body->live->next_glue.count--; /* one goes */
        couplings = sbi_live_glue_couplings(b.body, &out);
        CHECK(couplings.gone_count > couplings.made_count && couplings.made_count > 0);
        sb_body_change_cancel(change);
    }
    block_free(&b);
}

/* ---- the same again ---------------------------------------------------------------------------------------------- */

/* A stroke goes on from a state, in this body and in another, and what it has glued is taken back with it. */
static void test_states(void)
{
    for (int i = 0; i < 3; i++) {
        block_options options = block_default(intervals_of[i]);
        unsigned long long seed = 5;
        size_t first_size, size;
        void *first, *middle;
        uint64_t start, at_middle, end;
        block b, other, lagging;
        blade of = blade_random(&seed);
        sb_error error;
        int stroke;
        lagging = block_make(&options);
        options.front = SB_CUT_GLUE;
        b = block_make(&options), other = block_make(&options);
        block_shake(&b);
        block_step(&b, 2);
        first = state_of(&b, &first_size);
        start = sb_body_state_hash(b.body);
        stroke = begin(&b, &of);
        at_middle = run_frames(&b, &of, stroke, 0, 8);
        CHECK(b.cut->glue_count > 0);
        middle = state_of(&b, &size);
        end = run_frames(&b, &of, stroke, 8, 16);
        load(&b, middle, size);
        CHECK(sb_body_state_hash(b.body) == at_middle);
        check_pieces(&b);
        CHECK(run_frames(&b, &of, stroke, 8, 16) == end);
        load(&b, first, first_size);
        CHECK(sb_body_state_hash(b.body) == start);
        CHECK_INT(b.cut->glue_count, 0);
        CHECK_INT(b.body->live->glue.count, 0);
        CHECK_INT(begin(&b, &of), stroke);
        CHECK(run_frames(&b, &of, stroke, 0, 16) == end);
        load(&other, middle, size);
        check_pieces(&other);
        CHECK(run_frames(&other, &of, stroke, 8, 16) == end);
        CHECK_RESULT(sb_body_state_load(lagging.body, middle, size, &error), SB_ERROR_STATE);
        free(first);
        free(middle);
        block_free(&b);
        block_free(&other);
        block_free(&lagging);
    }
}

/* Where a number of a state's ties is; 0: nowhere. */
static size_t find_real(const unsigned char *state, size_t size, const sb_real *reals, size_t count)
{
    size_t bytes = count * sizeof *reals, at = 0;
    while (at + bytes <= size && memcmp(state + at, reals, bytes) != 0)
        at++;
    return at + bytes <= size ? at : 0;
}

/* Ties that no cut makes are refused by name, and what was there goes on. */
static void test_absurd_ties(void)
{
    static const struct {
        int entry, other; /* of G: of the largest diagonal's row */
        double value;     /* times that diagonal */
    } absurd[] = {{0, 0, -1}, {0, 0, 1e30}, {0, 1, 3}, {1, 1, -0.5}};
    for (int i = 0; i < 3; i++) {
        block_options options = block_default(intervals_of[i]);
        block b;
        size_t size, at;
        unsigned char *state, *damaged;
        const sbi_glue_tie *tie;
        int n, most = 0;
        options.front = SB_CUT_GLUE;
        b = half_cut(&options, 5);
        state = (unsigned char *)state_of(&b, &size);
        damaged = (unsigned char *)malloc(size);
        tie = b.body->live->glue.ties;
        n = b.body->live->glue.nodes;
        for (int k = 0; k < n; k++)
            most = tie->gram[sbi_glue_at(n, k, k)] > tie->gram[sbi_glue_at(n, most, most)] ? k : most;
        at = find_real(state, size, tie->gram, (size_t)sbi_glue_gram(n));
        CHECK(at > 0);
        for (size_t k = 0; k < sizeof absurd / sizeof *absurd && at > 0; k++) {
            int row = (most + absurd[k].entry) % n, column = (most + absurd[k].other) % n;
            sb_real value = REAL(absurd[k].value) * tie->gram[sbi_glue_at(n, most, most)];
            sb_error error;
            memset(&error, 0, sizeof error);
            memcpy(damaged, state, size);
            memcpy(damaged + at + (size_t)sbi_glue_at(n, row, column) * sizeof value, &value, sizeof value);
            sbi_image_seal(damaged, size, "SBSTATE\x1a", (uint32_t)sbi_get_bytes(damaged + 8, 4));
            CHECK_RESULT(sb_body_state_load(b.body, damaged, size, &error), SB_ERROR_FORMAT);
            CHECK(strstr(error.message, "tie 0") != NULL);
        }
        /* the first tie's second cell becomes that of another element */
        for (int k = 1; k < b.body->live->glue.count && at > 0; k++) {
            int cell = tie[k].cells[1];
            sb_vec3 here = sb_body_rest_positions(b.body)[tie->nodes[0][0]];
            sb_vec3 there = sb_body_rest_positions(b.body)[tie[k].nodes[1][0]];
            sb_error error;
            if (sb_v3_norm(sb_v3_sub(here, there)) == 0)
                continue;
            memcpy(damaged, state, size);
            sbi_put_bytes(damaged + at - 4, (uint64_t)cell, 4);
            sbi_image_seal(damaged, size, "SBSTATE\x1a", (uint32_t)sbi_get_bytes(damaged + 8, 4));
            CHECK_RESULT(sb_body_state_load(b.body, damaged, size, &error), SB_ERROR_FORMAT);
            CHECK(strstr(error.message, "tie 0") != NULL);
            break;
        }
        load(&b, state, size);
        check_pieces(&b);
        free(state);
        free(damaged);
        block_free(&b);
    }
}

/* States with a byte changed, and sealed again, load or are refused; what loads can be cut and stepped on. */
static void test_bad_states(void)
{
    block_options options = block_default(1);
    unsigned long long seed = 31;
    int rounds = check_rounds(check_quick() ? 300 : 1500), loaded = 0;
    block b;
    size_t size;
    unsigned char *state, *damaged;
    options.nx = options.ny = options.nz = 2;
    options.front = SB_CUT_GLUE;
    b = half_cut(&options, 5);
    state = (unsigned char *)state_of(&b, &size);
    damaged = (unsigned char *)malloc(size);
    check_bad_numbers();
    for (int k = 0; k < rounds; k++) {
        size_t at = 16 + (size_t)(check_random(&seed) * (double)(size - 32));
        memcpy(damaged, state, size);
        damaged[at] = (unsigned char)(damaged[at] ^ 1 << (int)(check_random(&seed) * 8));
        sbi_image_seal(damaged, size, "SBSTATE\x1a", (uint32_t)sbi_get_bytes(damaged + 8, 4));
        if (sb_body_state_load(b.body, damaged, size, NULL) != SB_OK)
            continue;
        loaded++;
        (void)sb_body_step(b.body, REAL(0.001), NULL);
        if (loaded % 16 == 0) {
            sb_vec3 triangles[6];
            square_make(sb_v3(REAL(0.03), REAL(0.02), REAL(0.025)), vector_in(-1, 1, &seed), 0.03, triangles);
            (void)sb_cut_triangles(b.cut, triangles, 2, NULL, NULL);
        }
    }
    CHECK(loaded > 0 && loaded < rounds);
    load(&b, state, size);
    check_pieces(&b);
    free(state);
    free(damaged);
    block_free(&b);
}

static void test_recording(void)
{
    block_options options = block_default(2);
    unsigned long long seed = 9;
    blade of = blade_random(&seed);
    sb_recording *recording = NULL;
    sb_recording_report report;
    block b, again;
    uint64_t hash;
    int stroke;
    options.front = SB_CUT_GLUE;
    b = block_make(&options), again = block_make(&options);
    block_shake(&b);
    CHECK_OK(sb_recording_start(b.body, 0, NULL, &recording, NULL));
    stroke = begin(&b, &of);
    hash = run_frames(&b, &of, stroke, 0, 10);
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, again.body, &report)))
        printf("%s, step %d\n", report.error.message, report.step);
    CHECK(sb_body_state_hash(again.body) == hash);
    CHECK(run_frames(&again, &of, stroke, 10, 16) == run_frames(&b, &of, stroke, 10, 16));
    sb_recording_destroy(recording);
    block_free(&b);
    block_free(&again);
}

static void test_threads(void)
{
    static const int workers_of[4] = {1, 2, 3, 16};
    uint64_t first = 0;
    for (int k = 0; k < 4; k++) {
        int workers = workers_of[k], stroke;
        sb_body_def def = sb_default_body_def();
        unsigned long long seed = 5;
        blade of = blade_random(&seed);
        block b;
        uint64_t hash;
        memset(&b, 0, sizeof b);
        b.mesh = scene_box(SB_TET4, 10, 6, 8, block_size, 0.2);
        def.mesh = &b.mesh;
        def.material = sb_material_corotated(REAL(5000), REAL(0.4), 1000);
        def.slack = 1;
        def.jobs = scene_jobs(&workers);
        b.body = scene_body(&def);
        block_cut_create_with(&b, 2, SB_CUT_GLUE);
        block_shake_at(&b, 0.3);
        stroke = begin(&b, &of);
        hash = run_frames(&b, &of, stroke, 0, check_quick() ? 3 : 8);
        first = k ? first : hash;
        CHECK(hash == first);
        block_free(&b);
    }
}

/* A mapping over nodes that glue couples has the body made anew with each change, and keeps its blocks where glue goes.
 */
static void test_others(void)
{
    block_options options = block_default(2);
    unsigned long long seed = 5;
    blade of = blade_random(&seed);
    block b[2];
    int stroke = 0;
    options.front = SB_CUT_GLUE;
    for (int k = 0; k < 2; k++) {
        int row_start[2] = {0, 4}, load_id, nodes[4] = {0, 1, 2, 3};
        sb_real weights[4] = {REAL(0.25), REAL(0.25), REAL(0.25), REAL(0.25)}, stiffness = REAL(0.1);
        sb_vec3 target = {0, 0, 0};
        sb_mapping mapping;
        b[k] = block_make(&options);
        stroke = begin(b + k, &of);
        for (int i = 1; i <= 4; i++)
            move(b + k, &of, stroke, -1 + 0.25 * i);
        CHECK(b[k].body->live->glue.count > 0);
        memset(&mapping, 0, sizeof mapping);
        for (int a = 0; a < 4; a++) { /* of both sides of a tie */
            const sbi_glue_tie *tie = b[k].body->live->glue.ties;
            nodes[a] = tie->nodes[a & 1][a];
            target = sb_v3_madd(target, weights[a], b[k].body->position[nodes[a]]);
        }
        mapping.row_count = 1;
        mapping.row_start = row_start;
        mapping.nodes = nodes;
        mapping.weights = weights;
        if (k == 0)
            CHECK_OK(sb_body_add_mapping(b[k].body, &mapping, &stiffness, 1, &target, &load_id, NULL));
        for (int i = 5; i <= 8; i++) {
            move(b + k, &of, stroke, -1 + 0.25 * i);
            check_pieces(b + k);
            block_step(b + k, 1);
        }
    }
    CHECK_INT(b[1].body->component_count, 2);
    CHECK(b[0].body->live->rebuilds > b[1].body->live->rebuilds);
    for (int k = 0; k < 2; k++)
        block_free(b + k);
}

/* ---- what fails, and what it costs ------------------------------------------------------------------------------- */

/* Every allocation of two calls of a stroke, which glue and release, fails in turn. */
static void test_no_memory(void)
{
    uint64_t expected = 0;
    for (int fail = 0, done = 0; !done && fail < 900; fail++) {
        scene_memory memory = {0, 0, 0, 0};
        block b = counted_block_with(&memory, 3, 0.01, SB_CUT_GLUE);
        blade of = blade_make(sb_v3(REAL(0.031), REAL(0.02), REAL(0.025)), sb_v3(1, REAL(0.2), REAL(0.1)), 0.4);
        sb_result result = SB_OK;
        int stroke = begin(&b, &of);
        memory.fail_at = fail ? memory.calls + fail : 0;
        for (int k = 0; k < 3; k++) {
            uint64_t before = sb_body_state_hash(b.body);
            sb_vec3 edge[CORNERS];
            blade_at(&of, -0.2 + 0.22 * k, edge);
            result = sb_cut_move(b.cut, stroke, edge, NULL, NULL);
            if (result != SB_OK) {
                memory.fail_at = 0;
                CHECK_RESULT(result, SB_ERROR_MEMORY);
                CHECK(sb_body_state_hash(b.body) == before);
                check_pieces(&b);
                CHECK_OK(sb_cut_move(b.cut, stroke, edge, NULL, NULL));
            }
        }
        done = fail && memory.fail_at > memory.calls;
        memory.fail_at = 0;
        CHECK(b.cut->glue_count > 0);
        check_pieces(&b);
        expected = fail ? expected : sb_body_state_hash(b.body);
        CHECK(sb_body_state_hash(b.body) == expected);
        block_free(&b);
        CHECK_INT(memory.live, 0);
        CHECK(done || fail < 899);
    }
}

static void test_no_allocation(void)
{
    scene_memory memory = {0, 0, 0, 0};
    block b = counted_block_with(&memory, 6, 20, SB_CUT_GLUE);
    unsigned long long seed = 3;
    int strokes = check_quick() ? 2 : 12, calls, rebuilds = b.body->live->rebuilds;
    scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
    block_step(&b, 1);
    calls = memory.calls;
    for (int k = 0; k < strokes; k++) {
        blade of = blade_random(&seed);
        int stroke;
        of.along = sb_v3_scale(REAL(0.2), of.along);
        stroke = begin(&b, &of);
        run_frames(&b, &of, stroke, 0, 15);
        sb_cut_end(b.cut, stroke);
    }
    CHECK_INT(b.body->live->rebuilds, rebuilds);
    CHECK_INT(memory.calls, calls);
    check_pieces(&b);
    block_free(&b);
}

static void test_mistakes(void)
{
    block_options options = block_default(1);
    block b = block_make(&options);
    sb_cut_def def = sb_default_cut_def();
    sb_cut *cut = NULL;
    sb_cut_destroy(b.cut);
    b.cut = NULL;
    def.body = b.body;
    CHECK_INT(def.front, SB_CUT_LAG);
    CHECK_NEAR(def.glue, 10, 0);
    def.front = (sb_cut_front)2;
    CHECK_RESULT(sb_cut_create(&def, &cut, NULL), SB_ERROR_ARGUMENT);
    def.front = SB_CUT_GLUE;
    def.glue = 0;
    CHECK_RESULT(sb_cut_create(&def, &cut, NULL), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    def.glue = REAL(NAN);
    CHECK_RESULT(sb_cut_create(&def, &cut, NULL), SB_ERROR_ARGUMENT);
    CHECK(cut == NULL);
    block_free(&b);
}

CHECK_SUITE(cut_glue, {"half-cut beam", test_half}, {"curved strokes", test_curved},
            {"iterations of steps", test_iterations}, {"slivers", test_slivers}, {"opened area", test_opened},
            {"popping", test_popping}, {"edge-cracked plate", test_crack}, {"constant strain passes", test_patch},
            {"released in any order", test_release}, {"forces, stiffness, turns", test_objective},
            {"turned before or after the cut", test_turned}, {"a moved node", test_moved},
            {"shaking blocks part in two", test_shaking}, {"totals", test_totals}, {"steps of all kinds", test_steps},
            {"calm", test_calm}, {"states", test_states}, {"damaged states", test_bad_states},
            {"absurd ties", test_absurd_ties}, {"recordings", test_recording}, {"threads", test_threads},
            {"loads across the glue", test_others}, {"left alone", test_left_alone},
            {"every allocation fails in turn", test_no_memory}, {"no allocation", test_no_allocation},
            {"mistakes are named", test_mistakes});
