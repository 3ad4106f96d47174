/* Forces of cutting: what a blade feels is the work of what it frees, along its way, and the tissue feels the opposite.
 */
#define SB_SPLIT_BUILD
#include "../src/softbody/base/bytes.h"

#include "../src/softbody/body/state_part.h"
#include "../src/softbody/body/step_private.h"
#include "cut_blade.h"

static block tough_block(int lattice, sb_cut_front front, double toughness)
{
    block_options options = block_default(lattice);
    options.front = front;
    options.toughness = toughness;
    return block_make(&options);
}

/* How far a blade goes until all that it has freed is paid for, and a bit. */
static sb_real pay_way(const block *b) { return 2 * b->cut->element_size; }

/* What a stroke has done. */
typedef struct effort {
    double work, along; /* as info says; forces times ways (J) */
    double area;        /* freed (m^2) */
    double most;        /* force (N) */
    double owed;        /* at the end (J) */
} effort;

/* Moves an edge of two corners by `by` and adds up what that did. */
static sb_cut_info move_by(block *b, int stroke, sb_vec3 edge[2], sb_vec3 by, effort *sum)
{
    sb_cut_info info;
    sb_error error;
    memset(&info, 0, sizeof info);
    edge[0] = sb_v3_add(edge[0], by);
    edge[1] = sb_v3_add(edge[1], by);
    if (!CHECK_OK(sb_cut_move(b->cut, stroke, edge, &info, &error)))
        printf("%s\n", error.message);
    sum->work += (double)info.work;
    sum->along -= (double)sb_v3_dot(info.force, by);
    sum->area += (double)info.released_area;
    sum->most = fmax(sum->most, (double)sb_v3_norm(info.force));
    sum->owed = (double)info.owed;
    CHECK_NEAR(sum->work + sum->owed, (double)b->cut->toughness * sum->area, scene_tolerance(1e-11, 1e4) * sum->work);
    return info;
}

/* ---- the work of a stroke ---------------------------------------------------------------------------------------- */

/* Down through a block at rest in so many frames, sideways by `slice` times as much, and on until all is paid. */
static effort through(block *b, int frames, double slice)
{
    sb_vec3 edge[2], by = sb_v3(0, REAL(-0.07 / frames * slice), REAL(-0.07 / frames));
    effort sum = {0, 0, 0, 0, 0};
    int stroke = -1;
    edge[0] = sb_v3(REAL(0.0307), REAL(-0.01), REAL(0.06));
    edge[1] = sb_v3(REAL(0.0301), REAL(0.051 + 0.08 * slice), REAL(0.06));
    CHECK_OK(sb_cut_begin(b->cut, edge, 2, &stroke, NULL));
    for (int i = 0; i < frames; i++)
        move_by(b, stroke, edge, by, &sum);
    CHECK_INT(b->body->component_count, 2);
    move_by(b, stroke, edge, sb_v3(0, 0, -pay_way(b)), &sum);
    CHECK_INT(b->cut->strokes[stroke].debts.count, 0);
    sb_cut_end(b->cut, stroke);
    return sum;
}

/* The sum of forces along ways is J_c times what has been freed, with few frames and with many; with glue that is what
 * the blade has come through: J_c b d. */
static void test_work(void)
{
    static const int frames[3] = {7, 60, 500};
    const double toughness = 130;
    for (int front = 0; front < 2; front++)
        for (int lattice = 1; lattice <= 2; lattice++)
            for (int k = 0; k < (front && lattice == 2 ? 3 : 2); k++) {
                block_options options = block_default(lattice);
                block b;
                effort sum;
                options.nx = options.ny = 6;
                options.nz = 10;
                options.front = (sb_cut_front)front;
                options.toughness = toughness;
                b = block_make(&options);
                sum = through(&b, frames[k], 0);
                CHECK_NEAR(sum.work, toughness * sum.area, scene_tolerance(1e-12, 1e4) * sum.work);
                CHECK_NEAR(sum.along, sum.work, scene_tolerance(1e-12, 1e4) * sum.work);
                CHECK_NEAR(sum.work, toughness * 0.04 * 0.05, 0.02 * sum.work);
                if (front && lattice == 2)
                    printf("   straight cut in %d frames: %.4f J of %.4f J, force %.2f N at most, %.2f N on the mean\n",
                           frames[k], sum.work, toughness * 0.04 * 0.05, sum.most, sum.work / 0.05);
                /* however short the frames */
                CHECK(front == 0 || sum.most < (lattice == 1 ? 5 : 3) * toughness * 0.04);
                block_free(&b);
            }
}

/* A blade that is drawn along itself by xi times as much as it goes on feels J_c w / (1 + xi^2) across itself, and xi
 * times that along itself. */
static void test_slice(void)
{
    static const double slices[4] = {0, 0.5, 1, 3};
    double push = 0;
    for (int k = 0; k < 4; k++) {
        double xi = slices[k];
        block b = tough_block(2, SB_CUT_GLUE, 200);
        sb_vec3 edge[2], by = sb_v3(0, REAL(-0.03 * xi), REAL(-0.03));
        effort sum = {0, 0, 0, 0, 0};
        sb_cut_info info;
        int stroke = -1;
        edge[0] = sb_v3(REAL(0.0307), REAL(-0.01), REAL(0.0501));
        edge[1] = sb_v3(REAL(0.0307), REAL(0.14), REAL(0.0501));
        CHECK_OK(sb_cut_begin(b.cut, edge, 2, &stroke, NULL));
        info = move_by(&b, stroke, edge, by, &sum);
        CHECK_NEAR((double)info.force.x, 0, scene_tolerance(1e-12, 1e4) * (double)sb_v3_norm(info.force));
        CHECK_NEAR((double)info.force.z * 0.03 * (1 + xi * xi), sum.work, scene_tolerance(1e-11, 1e5) * sum.work);
        CHECK_NEAR((double)info.force.y, xi * (double)info.force.z,
                   scene_tolerance(1e-11, 1e5) * (double)sb_v3_norm(info.force));
        CHECK_NEAR(sum.work, 200 * 0.04 * 0.03, 0.08 * sum.work);
        push = k ? push : (double)info.force.z;
        CHECK_NEAR((double)info.force.z, push / (1 + xi * xi), scene_tolerance(1e-9, 1e5) * push);
        block_free(&b);
    }
}

/* A blade that turns about its middle: its work is that of what it frees, also where it hardly moves. */
static void test_turning(void)
{
    block b = tough_block(2, SB_CUT_GLUE, 100);
    double work = 0, area = 0, least = (double)pay_way(&b);
    sb_vec3 edge[2], middle = sb_v3(REAL(0.0303), REAL(0.0201), REAL(0.0257));
    int stroke = -1;
    for (int i = 0; i <= 320; i++) { /* by half a turn, and on */
        double angle = 0.2 + i * 0.05;
        sb_vec3 along = sb_v3(REAL(2e-4 * cos(angle)), REAL(0.06 * cos(angle)), REAL(0.06 * sin(angle)));
        sb_cut_info info;
        edge[0] = sb_v3_sub(middle, along), edge[1] = sb_v3_add(middle, along);
        if (i == 0) {
            CHECK_OK(sb_cut_begin(b.cut, edge, 2, &stroke, NULL));
            continue;
        }
        CHECK_OK(sb_cut_move(b.cut, stroke, edge, &info, NULL));
        work += (double)info.work;
        area += (double)info.released_area;
        CHECK(sb_v3_is_finite(info.force) && sb_v3_is_finite(info.torque));
        /* what hardly moves has freed little: each triangle is paid for over half an element */
        CHECK((double)sb_v3_norm(info.force) < 100 * (2 * area / least));
    }
    CHECK_INT(b.body->component_count, 2);
    CHECK(work > 0.98 * 100 * area); /* but for what is near the middle */
    for (int i = 0; i < b.cut->strokes[stroke].debts.count; i++)
        work += 100 * (double)b.cut->strokes[stroke].debts.items[i].area;
    CHECK_NEAR(work, 100 * area, scene_tolerance(1e-12, 1e4) * work);
    block_free(&b);
}

/* ---- blade and tissue -------------------------------------------------------------------------------------------- */

/* Force and moment about a point of all that waits for the next step. */
static void pushes_of(const block *b, sb_vec3 about, sb_vec3 *force, sb_vec3 *torque)
{
    const sbi_live *live = b->body->live;
    *force = *torque = sb_v3(0, 0, 0);
    for (int i = 0; i < live->push_count; i++) {
        sb_vec3 f = live->pushes[i].force;
        *force = sb_v3_add(*force, f);
        *torque = sb_v3_add(*torque, sb_v3_cross(sb_v3_sub(b->body->position[live->pushes[i].node], about), f));
    }
}

static const sb_integrator integrators[4] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA, SB_CENTRAL_DIFFERENCE};

/* Random strokes through a shaking block: what the tissue is pushed by is what the blade feels, force and moment, and
 * momentum changes by just that in the next step, and by nothing in the one after it. */
static void test_balance(void)
{
    unsigned long long seed = 17;
    for (int round = 0; round < (check_quick() ? 4 : 12); round++) {
        block_options options = block_default(intervals_of[round % 3]);
        blade of = blade_random(&seed);
        double felt = 0;
        block b;
        int stroke;
        options.front = round % 2 ? SB_CUT_LAG : SB_CUT_GLUE;
        options.integrator = integrators[round % 4];
        options.toughness = 20;
        options.slack = 1;
        b = block_make(&options);
        CHECK_OK(sb_body_set_solver(b.body, REAL(scene_tolerance(1e-10, 30)), 2000));
        block_shake_at(&b, 0.05);
        stroke = begin(&b, &of);
        for (int i = 1; i <= 10; i++) {
            sb_vec3 edge[CORNERS], before = sb_body_momentum(b.body), force, torque, change;
            double dt = 0.001, size;
            sb_cut_info info;
            sb_energy energy;
            blade_at(&of, -1 + 0.16 * i, edge);
            edge[2] = sb_v3_add(edge[2], vector_in(-0.004, 0.004, &seed));
            CHECK_OK(sb_cut_move(b.cut, stroke, edge, &info, NULL));
            pushes_of(&b, edge[0], &force, &torque);
            felt += (double)info.work;
            size = (double)sb_v3_norm(force);
            CHECK_NEAR(sb_v3_norm(sb_v3_add(info.force, force)), 0, scene_tolerance(1e-12, 1e3) * size);
            CHECK_NEAR(sb_v3_norm(sb_v3_add(info.torque, torque)), 0, scene_tolerance(1e-12, 1e3) * size);
            CHECK_OK(sb_body_energy(b.body, &energy));
            size = size * dt + sqrt(2 * (double)energy.kinetic * (double)sb_body_mass(b.body));
            for (int k = 0; k < 2; k++) {
                sb_step_info of_step;
                if (!CHECK_OK(sb_body_step(b.body, REAL(dt), &of_step)))
                    printf("round %d, move %d: %s\n", round, i, of_step.error.message);
                change = sb_v3_sub(sb_body_momentum(b.body), before);
                CHECK_NEAR(sb_v3_norm(sb_v3_madd(change, REAL(k ? 0 : -dt), force)), 0,
                           scene_tolerance(1e-8, 300) * size);
                before = sb_body_momentum(b.body);
            }
            CHECK_INT(b.body->live->push_count, 0);
        }
        CHECK(felt > 0);
        check_pieces(&b);
        block_free(&b);
    }
}

/* ---- explicit steps ---- */

/* Random strokes of a blade through tissue that is soft beside its toughness, in explicit steps: what it moves and
 * strains comes from the blade's work alone. Returns the most energy over that work. */
static double check_explicit(int round, unsigned long long *seed)
{
    block_options options = block_default(intervals_of[round % 3]);
    blade of = blade_random(seed);
    double dt = exp(check_random_in(seed, log(2e-4), log(0.02))), work = 0, area = 0, most = 0;
    sb_energy energy;
    int stroke;
    block b;
    options.element = round % 2 ? SB_TET10 : SB_TET4;
    if (options.element == SB_TET10)
        options.nx = 3, options.ny = 2, options.nz = 3;
    options.integrator = SB_CENTRAL_DIFFERENCE;
    options.toughness = exp(check_random_in(seed, log(3.0), log(300.0))); /* of 5 kPa and 6 cm: 0.01 to 1 */
    b = block_make(&options);
    stroke = begin(&b, &of);
    for (int i = 1; i <= 12; i++) {
        sb_cut_info info = move(&b, &of, stroke, -1 + i / 6.0);
        sb_step_info of_step;
        if (!CHECK_OK(sb_body_step(b.body, REAL(dt), &of_step)))
            printf("round %d, move %d: %s\n", round, i, of_step.error.message);
        work += (double)info.work;
        area += (double)info.released_area;
        CHECK_NEAR(work + (double)info.owed, options.toughness * area, scene_tolerance(1e-11, 1e4) * work);
        CHECK_OK(sb_body_energy(b.body, &energy));
        most = fmax(most, work > 0 ? (double)(energy.kinetic + energy.elastic) / work : 0);
    }
    if (!CHECK(most <= 1))
        printf("round %d: J_c %g J/m^2, dt %g s: %.3g times the work of the blade\n", round, options.toughness, dt,
               most);
    block_free(&b);
    return most;
}

static void test_explicit(void)
{
    unsigned long long seed = 71;
    double most = 0;
    int rounds = check_quick() ? 6 : getenv("CHECK_SLOW") ? 300 : 24;
    for (int round = 0; round < rounds; round++)
        most = fmax(most, check_explicit(round, &seed));
    printf("   explicit steps: at most %.3f times the blade's work in the tissue\n", most);
}

/* Tissue that runs into a blade at rest is held up by it. */
static void test_resting(void)
{
    block b = tough_block(2, SB_CUT_LAG, 10);
    sb_vec3 *v = (sb_vec3 *)calloc((size_t)sb_body_node_count(b.body), sizeof *v), edge[2];
    double impulse = 0, area = 0, before, after;
    int stroke;
    for (int n = 0; n < sb_body_node_count(b.body); n++)
        v[n] = sb_v3(0, 0, 1);
    CHECK_OK(sb_body_set_velocities(b.body, v));
    edge[0] = sb_v3(REAL(0.0319), REAL(-0.01), REAL(0.06));
    edge[1] = sb_v3(REAL(0.0287), REAL(0.05), REAL(0.06));
    CHECK_OK(sb_cut_begin(b.cut, edge, 2, &stroke, NULL));
    before = (double)sb_body_momentum(b.body).z;
    for (int i = 0; i < 45; i++) {
        sb_cut_info info;
        CHECK_OK(sb_body_step(b.body, REAL(0.002), NULL));
        CHECK_OK(sb_cut_move(b.cut, stroke, edge, &info, NULL));
        area += (double)info.released_area;
        impulse += 0.002 * (double)info.force.z;
    }
    CHECK_OK(sb_body_step(b.body, REAL(0.002), NULL));
    after = (double)sb_body_momentum(b.body).z;
    CHECK(impulse > 0 && after < 0.9 * before);
    CHECK_NEAR(before - after, impulse, 1e-2 * impulse);
    CHECK_NEAR(area, 0.04 * 0.05, 0.08 * 0.04 * 0.05); /* what lags behind its last face is not freed */
    free(v);
    block_free(&b);
}

/* Without toughness there is no force, and with it the same is cut. */
static void test_none(void)
{
    for (int i = 0; i < 3; i++) {
        unsigned long long seed = 9;
        blade of = blade_random(&seed);
        block soft = tough_block(intervals_of[i], SB_CUT_GLUE, 0),
              tough = tough_block(intervals_of[i], SB_CUT_GLUE, 50);
        int stroke = begin(&soft, &of), other = begin(&tough, &of);
        sb_cut_info cut;
        sb_vec3 triangles[6];
        for (int k = 1; k <= 9; k++) {
            sb_cut_info of_soft = move(&soft, &of, stroke, -1 + 0.15 * k), of_tough;
            of_tough = move(&tough, &of, other, -1 + 0.15 * k);
            CHECK(sb_v3_norm(of_soft.force) == 0 && sb_v3_norm(of_soft.torque) == 0 && of_soft.work == 0);
            CHECK_INT(of_soft.links, of_tough.links);
            CHECK_INT(of_soft.glued, of_tough.glued);
            CHECK(of_soft.released_area == of_tough.released_area);
        }
        CHECK_INT(soft.body->live->push_count, 0);
        CHECK_INT(soft.body->live->push_capacity, 0);
        CHECK(tough.body->live->push_count > 0);
        CHECK(sb_body_state_size(tough.body) > sb_body_state_size(soft.body));
        block_step(&tough, 1);
        square_make(sb_v3(REAL(0.03), REAL(0.0213), REAL(0.025)), sb_v3(0, 1, 0), 0.2, triangles);
        cut = block_cut(&tough, triangles, 2); /* has no way */
        CHECK(cut.released_area > 0 && cut.work == 0 && sb_v3_norm(cut.force) == 0);
        CHECK_INT(tough.body->live->push_count, 0);
        block_free(&soft);
        block_free(&tough);
    }
}

/* ---- tissue that gives way --------------------------------------------------------------------------------------- */

static double energy_of(block *b)
{
    sb_energy energy;
    CHECK_OK(sb_body_energy(b->body, &energy));
    return (double)energy.elastic + (double)energy.kinetic;
}

/* A blade comes down on a block that stands on a table and is stepped after each frame: on the mean of the middle third
 * of its way it feels J_c w, and a little more the farther J_c drags the tissue along, J_c / E, beside the elements'
 * size h. Body and what has been paid for have no more than the work of the hand: forces known before the step, which
 * made tissue chatter about the blade, gave 0.15 to 0.4 of J_c w. */
static void check_giving(double young, double toughness, double speed, double dt, double h)
{
    const double top = 0.05, clear = 0.002, drag = toughness / (young * h);
    block_options options = block_default(2);
    effort sum = {0, 0, 0, 0, 0};
    sb_vec3 edge[2], by = sb_v3(0, 0, REAL(-speed * dt));
    double mean = 0, worst = 0;
    int stroke = -1, frames = (int)((clear + 0.75 * top) / (speed * dt)), counted = 0;
    sb_material material = sb_material_corotated(REAL(young), REAL(0.4), 1000);
    block b;
    options.nx = options.nz = 8;
    options.ny = 5;
    options.slack = 1;
    options.front = SB_CUT_GLUE;
    options.toughness = toughness;
    b = block_make(&options);
    CHECK_OK(sb_body_set_material(b.body, &material, NULL));
    CHECK_OK(sb_body_set_damping(b.body, 0, REAL(0.01)));
    scene_fix_plane(b.body, &b.mesh, 2, 0, SB_XYZ);
    edge[0] = sb_v3(REAL(0.0307), REAL(-0.02), REAL(top + clear));
    edge[1] = sb_v3(REAL(0.0301), REAL(0.061), REAL(top + clear));
    CHECK_OK(sb_cut_begin(b.cut, edge, 2, &stroke, NULL));
    for (int i = 0; i < frames; i++) {
        sb_cut_info info = move_by(&b, stroke, edge, by, &sum);
        CHECK_OK(sb_body_step(b.body, REAL(dt), NULL));
        worst = fmax(worst, energy_of(&b) + sum.work - sum.along);
        if (i >= frames / 2) {
            mean += (double)info.force.z;
            counted++;
        }
    }
    mean /= counted * toughness * 0.04;
    if (!CHECK(mean > 0.9 && mean < 1.03 + 0.8 * drag + (SB_REAL_IS_FLOAT ? 0.05 : 0)) ||
        !CHECK(worst < 0.02 * sum.along) || getenv("CHECK_TELL"))
        printf(
            "   E %.0f Pa, J_c %.0f J/m2, %.1f cm/s, %.1f ms: %.3f of J_c w, J_c/(E h) %.2f, energy %.2g of %.3g J\n",
            young, toughness, 100 * speed, 1e3 * dt, mean, drag, worst, sum.along);
    block_free(&b);
}

static void test_giving(void)
{
    unsigned long long seed = 3;
    for (int k = 0; k < (check_quick() ? 1 : 4); k++) {
        double h = pow(0.06 * 0.04 * 0.05 / (8 * 5 * 8 * 6.0) * 6, 1.0 / 3),
               toughness = check_random_in(&seed, 50, 250);
        double young = toughness / h / pow(10, check_random_in(&seed, -2, -0.2));
        check_giving(young, toughness, check_random_in(&seed, 0.03, 0.15), check_random_in(&seed, 0.003, 0.008), h);
    }
    check_giving(40000, 150, 0.05, 0.005, 0.0066);
}

/* ---- from call to step ------------------------------------------------------------------------------------------- */

/* A block that a stroke has come into, with forces that wait. */
static block pushed_block(sb_cut_front front, int *stroke)
{
    block b = tough_block(2, front, 30);
    unsigned long long seed = 5;
    blade of = blade_random(&seed);
    *stroke = begin(&b, &of);
    for (int k = 1; k <= 8; k++)
        move(&b, &of, *stroke, -1 + 0.13 * k);
    move(&b, &of, *stroke, 0.07);
    CHECK(b.body->live->push_count > 0);
    CHECK(b.cut->strokes[*stroke].debts.count > 0);
    return b;
}

/* A step that is taken back leaves them, and is the same again. */
static void test_taken_back(void)
{
    int stroke;
    block b = pushed_block(SB_CUT_GLUE, &stroke);
    size_t size = sbi_body_snapshot_size(b.body);
    void *kept = malloc(size);
    uint64_t before = sb_body_state_hash(b.body), after = 0;
    sbi_body_snapshot(b.body, kept, NULL);
    for (int k = 0; k < 3; k++) {
        CHECK_OK(sb_body_step(b.body, REAL(0.001), NULL));
        CHECK_INT(b.body->live->push_count, 0);
        after = k ? after : sb_body_state_hash(b.body);
        CHECK(sb_body_state_hash(b.body) == after && after != before);
        CHECK_OK(sbi_body_rewind(b.body, kept, size, NULL));
        CHECK(sb_body_state_hash(b.body) == before);
    }
    free(kept);
    block_free(&b);
}

/* Forces wait for a time step that succeeds, through changes of the mesh; a static solve has none of them. */
static void test_waiting(void)
{
    int stroke, count;
    block b = pushed_block(SB_CUT_GLUE, &stroke);
    sb_vec3 force, torque, now, moved;
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    pushes_of(&b, sb_v3(0, 0, 0), &force, &torque);
    count = b.body->live->push_count;
    check_bad_numbers();
    CHECK_RESULT(sb_body_step(b.body, REAL(NAN), &info), SB_ERROR_ARGUMENT);
    CHECK_INT(b.body->live->push_count, count);
    block_cut_plane(&b, sb_v3(REAL(0.03), REAL(0.0213), REAL(0.025)), sb_v3(0, 1, 0));
    pushes_of(&b, sb_v3(0, 0, 0), &now, &moved);
    CHECK(memcmp(&now, &force, sizeof now) == 0);
    scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
    scene_fix_plane(b.body, &b.mesh, 0, 0.06, SB_XYZ);
    if (sb_body_solve_static(b.body, &options, &info) == SB_OK)
        for (int i = 0; i < sb_body_node_count(b.body); i++)
            CHECK_NEAR(sb_v3_norm(sb_body_displacements(b.body)[i]), 0, 1e-9);
    CHECK_INT(b.body->live->push_count, count);
    CHECK_OK(sbi_step_whole(b.body, REAL(0.001), NULL, 0, REAL(0.5), 0, &info)); /* part of a divided step */
    CHECK_INT(b.body->live->push_count, count);
    block_step(&b, 1);
    CHECK_INT(b.body->live->push_count, 0);
    block_free(&b);
    b = pushed_block(SB_CUT_LAG, &stroke);
    sb_body_reset(b.body);
    CHECK_INT(b.body->live->push_count, 0);
    sb_cut_end(b.cut, stroke);
    CHECK_INT(b.cut->strokes[stroke].debts.count, 0);
    block_free(&b);
}

static void test_states(void)
{
    for (int i = 0; i < 3; i++) {
        unsigned long long seed = 5;
        block b = tough_block(intervals_of[i], SB_CUT_GLUE, 12), other = tough_block(intervals_of[i], SB_CUT_GLUE, 12);
        block softer = tough_block(intervals_of[i], SB_CUT_GLUE, 11),
              soft = tough_block(intervals_of[i], SB_CUT_GLUE, 0);
        blade of = blade_random(&seed);
        size_t first_size, size;
        void *first, *middle;
        uint64_t start, at_middle, end;
        sb_error error;
        int stroke;
        block_shake_at(&b, 0.2);
        block_step(&b, 2);
        first = state_of(&b, &first_size);
        start = sb_body_state_hash(b.body);
        stroke = begin(&b, &of);
        run_frames(&b, &of, stroke, 0, 8);
        move(&b, &of, stroke, 0.06);
        CHECK(b.cut->strokes[stroke].debts.count > 0 && b.body->live->push_count > 0);
        at_middle = sb_body_state_hash(b.body);
        middle = state_of(&b, &size);
        block_step(&b, 1);
        end = run_frames(&b, &of, stroke, 9, 16);
        load(&b, middle, size);
        CHECK(sb_body_state_hash(b.body) == at_middle);
        block_step(&b, 1);
        CHECK(run_frames(&b, &of, stroke, 9, 16) == end);
        load(&b, first, first_size);
        CHECK(sb_body_state_hash(b.body) == start);
        CHECK_INT(b.body->live->push_count, 0);
        load(&other, middle, size);
        CHECK(sb_body_state_hash(other.body) == at_middle);
        block_step(&other, 1);
        CHECK(run_frames(&other, &of, stroke, 9, 16) == end);
        CHECK_RESULT(sb_body_state_load(softer.body, middle, size, &error), SB_ERROR_STATE);
        CHECK_RESULT(sb_body_state_load(soft.body, middle, size, &error), SB_ERROR_STATE);
        free(first);
        free(middle);
        block_free(&b);
        block_free(&other);
        block_free(&softer);
        block_free(&soft);
    }
}

/* States with a byte changed, and sealed again, load or are refused; what loads can be cut and stepped on. */
static void test_bad_states(void)
{
    block_options options = block_default(1);
    unsigned long long seed = 31;
    int rounds = check_rounds(check_quick() ? 300 : 1500), loaded = 0, stroke;
    blade of = blade_make(sb_v3(REAL(0.031), REAL(0.02), REAL(0.025)), sb_v3(1, REAL(0.2), REAL(0.1)), 0.4);
    block b;
    size_t size;
    unsigned char *state, *damaged;
    options.nx = options.ny = options.nz = 2;
    options.front = SB_CUT_GLUE;
    options.toughness = 40;
    b = block_make(&options);
    stroke = begin(&b, &of);
    for (int k = 1; k <= 6; k++)
        move(&b, &of, stroke, -1 + 0.2 * k);
    move(&b, &of, stroke, 0.25);
    CHECK(b.cut->strokes[stroke].debts.count > 0 && b.body->live->push_count > 0);
    state = (unsigned char *)state_of(&b, &size);
    damaged = (unsigned char *)malloc(size);
    check_bad_numbers();
    for (int k = 0; k < rounds; k++) {
        size_t at = size - 8 - (size_t)(check_random(&seed) * 3000); /* what forces have comes last */
        memcpy(damaged, state, size);
        damaged[at] = (unsigned char)(damaged[at] ^ 1 << (int)(check_random(&seed) * 8));
        sbi_image_seal(damaged, size, "SBSTATE\x1a", (uint32_t)sbi_get_bytes(damaged + 8, 4));
        if (sb_body_state_load(b.body, damaged, size, NULL) != SB_OK)
            continue;
        loaded++;
        (void)sb_body_step(b.body, REAL(0.001), NULL);
        if (b.cut->strokes[stroke].edge_count == CORNERS) {
            sb_vec3 edge[CORNERS];
            blade_at(&of, 0.4, edge);
            (void)sb_cut_move(b.cut, stroke, edge, NULL, NULL);
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
    unsigned long long seed = 9;
    blade of = blade_random(&seed);
    sb_recording *recording = NULL;
    sb_recording_report report;
    block b = tough_block(2, SB_CUT_GLUE, 12), again = tough_block(2, SB_CUT_GLUE, 12);
    uint64_t hash;
    int stroke;
    block_shake_at(&b, 0.2);
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
        block_cut_create_tough(&b, 2, SB_CUT_GLUE, 15);
        block_shake_at(&b, 0.3);
        stroke = begin(&b, &of);
        hash = run_frames(&b, &of, stroke, 0, check_quick() ? 3 : 6);
        first = k ? first : hash;
        CHECK(hash == first);
        block_free(&b);
    }
}

/* ---- what fails, and what it costs ------------------------------------------------------------------------------- */

static void test_no_memory(void)
{
    uint64_t expected = 0;
    for (int fail = 0, done = 0; !done && fail < 900; fail++) {
        scene_memory memory = {0, 0, 0, 0};
        block b = counted_block_tough(&memory, 3, 0.01, SB_CUT_GLUE, 15);
        blade of = blade_make(sb_v3(REAL(0.031), REAL(0.02), REAL(0.025)), sb_v3(1, REAL(0.2), REAL(0.1)), 0.4);
        sb_result result = SB_OK;
        int stroke = begin(&b, &of);
        sbi_free(&b.cut->allocator, b.cut->strokes[stroke].debts.items); /* as if there was room for one only */
        b.cut->strokes[stroke].debts.items = NULL;
        b.cut->strokes[stroke].debts.capacity = 0;
        b.body->live->push_capacity = 1;
        b.cut->freed.capacity = 1;
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
                CHECK_OK(sb_cut_move(b.cut, stroke, edge, NULL, NULL));
            }
        }
        done = fail && memory.fail_at > memory.calls;
        memory.fail_at = 0;
        CHECK(b.body->live->push_count > 0);
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
    block b = counted_block_tough(&memory, 6, 20, SB_CUT_GLUE, 15);
    unsigned long long seed = 3;
    int calls;
    scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
    block_step(&b, 1);
    calls = memory.calls;
    for (int k = 0; k < (check_quick() ? 2 : 8); k++) {
        blade of = blade_random(&seed);
        int stroke;
        of.along = sb_v3_scale(REAL(0.2), of.along);
        stroke = begin(&b, &of);
        run_frames(&b, &of, stroke, 0, 15);
        sb_cut_end(b.cut, stroke);
    }
    CHECK_INT(memory.calls, calls);
    block_free(&b);
}

static void test_mistakes(void)
{
    block b = tough_block(1, SB_CUT_LAG, 0);
    sb_cut_def def = sb_default_cut_def();
    sb_cut *cut = NULL;
    sb_cut_destroy(b.cut);
    b.cut = NULL;
    def.body = b.body;
    CHECK(def.toughness == 0);
    def.toughness = -1;
    CHECK_RESULT(sb_cut_create(&def, &cut, NULL), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    def.toughness = REAL(NAN);
    CHECK_RESULT(sb_cut_create(&def, &cut, NULL), SB_ERROR_ARGUMENT);
    def.toughness = REAL(INFINITY);
    CHECK_RESULT(sb_cut_create(&def, &cut, NULL), SB_ERROR_ARGUMENT);
    CHECK(cut == NULL);
    block_free(&b);
}

CHECK_SUITE(cut_force, {"work of a straight cut", test_work}, {"push and slice", test_slice},
            {"a blade that turns", test_turning}, {"blade and tissue balance", test_balance},
            {"tissue against a blade at rest", test_resting}, {"tissue that gives way", test_giving},
            {"explicit steps make no energy", test_explicit}, {"no toughness, no force", test_none},
            {"forces wait for a step", test_waiting}, {"taken back", test_taken_back}, {"states", test_states},
            {"damaged states", test_bad_states}, {"recordings", test_recording}, {"threads", test_threads},
            {"every allocation fails in turn", test_no_memory}, {"no allocation", test_no_allocation},
            {"mistakes are named", test_mistakes});
