/* Ablation: what lies in a ball is taken out of a body, with its mass and momentum; and crumbs that cuts leave. */
#include "cut_drawing.h"
#include "random_case.h"

/* ---- helpers ----------------------------------------------------------------------------------------------------- */

static const double pi = 3.14159265358979323846;

static sb_cut_info block_ablate(block *b, sb_vec3 centre, double radius)
{
    sb_cut_info info;
    sb_error error;
    memset(&info, 0, sizeof info);
    if (!CHECK_OK(sb_cut_ablate(b->cut, centre, REAL(radius), &info, &error)))
        printf("%s\n", error.message);
    return info;
}

static double volume_of(const block *b)
{
    double volume = 0;
    for (int e = 0; e < sb_body_element_count(b->body); e++)
        if (sb_body_cell_in_use(b->body, e))
            volume += (double)sb_body_cell_share(b->body, e) *
                      (double)sb_mesh_element_volume(&b->mesh, sb_cut_cell_element(b->cut, e));
    return volume;
}

/* A block that keeps crumbs smaller than so many elements, or takes them out. */
static block crumbling_block(const block_options *options, double least)
{
    block b = block_make(options);
    sb_cut_def def = sb_default_cut_def();
    sb_cut_destroy(b.cut);
    b.cut = NULL;
    def.body = b.body;
    def.lattice = options->lattice;
    def.front = options->front;
    def.least_piece = REAL(least);
    CHECK_OK(sb_cut_create(&def, &b.cut, NULL));
    return b;
}

/* What was, less what a call took out, is what is left; all of it that stays moves as before. */
static void check_removed(const block *b, const totals *before, double volume, const sb_cut_info *info)
{
    totals after = totals_of(b);
    double speed = sqrt(2 * before->kinetic / before->mass) + 1e-300, close = scene_tolerance(1e-12, 2000);
    sb_vec3 momentum = sb_v3_add(after.momentum, info->removed_momentum);
    CHECK_NEAR(after.mass + (double)info->removed_mass, before->mass, close * before->mass);
    CHECK_NEAR(volume_of(b) + (double)info->removed_volume, volume, close * volume);
    CHECK_NEAR(sb_v3_norm(sb_v3_sub(momentum, before->momentum)), 0, close * speed * before->mass);
    CHECK(after.kinetic <= before->kinetic * (1 + close));
    CHECK(after.elastic <= before->elastic + 1000 * close * (before->elastic + before->kinetic));
}

/* ---- measures of holes ------------------------------------------------------------------------------------------- */

/* A ball out of the middle of a block, of twice an element's size. */
static void test_ball(void)
{
    static const double close[3] = {0.2, 0.06, 0.02};
    for (int i = 0; i < 3; i++) {
        block_options options = block_default(intervals_of[i]);
        sb_vec3 middle = sb_v3(block_size.x / 2, block_size.y / 2, block_size.z / 2);
        double radius = 0.02, ball = 4 * pi / 3 * radius * radius * radius, volume, area = 0;
        sb_cut_surface *surface = NULL;
        sb_cut_drawing d;
        sb_cut_info info;
        totals before;
        block b;
        int euler;
        options.shake = 0;
        options.nx = 6, options.ny = 4, options.nz = 5; /* h = 0.01 */
        b = block_make(&options);
        block_shake(&b);
        before = totals_of(&b);
        volume = volume_of(&b);
        info = block_ablate(&b, sb_v3_add(middle, sb_v3(REAL(1e-4), REAL(-2e-4), REAL(3e-4))), radius - 1e-3);
        ball *= pow((radius - 1e-3) / radius, 3);
        check_pieces(&b);
        check_removed(&b, &before, volume, &info);
        printf("   m = %d: hole of %.4f of the ball\n", options.lattice, (double)info.removed_volume / ball);
        CHECK_NEAR(info.removed_volume, ball, close[i] * ball);
        CHECK_NEAR(info.removed_mass, 1000 * (double)info.removed_volume, scene_tolerance(1e-12, 200));
        CHECK_INT(info.parts, 1);
        CHECK_INT(info.crumbs, 0);
        CHECK_OK(sb_cut_surface_create(b.cut, NULL, &surface, NULL));
        d = sb_cut_surface_get(surface);
        CHECK_INT(check_closed(&d, &euler), 2); /* the outer one, and the hole's wall */
        CHECK_INT(euler, 4);
        CHECK_NEAR(volumes_error(&b, &d), 0, scene_tolerance(1e-12, 500));
        CHECK_INT(area_of(&d, SB_CUT_LIP) > 0, 0);
        area = area_of(&d, SB_CUT_CHAR);
        CHECK_NEAR(area, 4 * pi * pow(radius - 1e-3, 2), 2 * close[i] * area);
        block_step(&b, 3);
        CHECK(scene_all_finite(sb_body_positions(b.body), sb_body_node_count(b.body)));
        sb_cut_surface_destroy(surface);
        block_free(&b);
    }
}

/* A tip that goes on in small steps leaves a smooth way, not what links were first cut to. */
static void test_way(void)
{
    enum { STEPS = 40 };
    block_options options = block_default(4);
    block b;
    sb_cut_surface *surface = NULL;
    sb_cut_drawing d;
    double radius = 0.011, length = 0.024, volume = pi * radius * radius * (length + 4 * radius / 3), taken = 0, whole;
    int euler;
    options.shake = 0;
    b = block_make(&options);
    whole = volume_of(&b);
    for (int k = 0; k <= STEPS; k++) {
        sb_vec3 at = sb_v3(REAL(0.0183 + length * k / (int)STEPS), block_size.y / 2, block_size.z / 2);
        taken += (double)block_ablate(&b, at, radius).removed_volume;
    }
    check_pieces(&b);
    printf("   a way of %.4f of its volume\n", taken / volume);
    CHECK_NEAR(taken, volume, 0.03 * volume);
    CHECK_NEAR(volume_of(&b) + taken, whole, scene_tolerance(1e-12, 500) * whole);
    CHECK_OK(sb_cut_surface_create(b.cut, NULL, &surface, NULL));
    d = sb_cut_surface_get(surface);
    CHECK_INT(check_closed(&d, &euler), 2);
    CHECK_NEAR(volumes_error(&b, &d), 0, scene_tolerance(1e-12, 500));
    sb_cut_surface_destroy(surface);
    block_free(&b);
}

/* With lattice 1 elements with all corners in the ball go, those with none stay, and one corner's share is the product
 * of where the ball cuts its edges. */
static void test_elements(void)
{
    block_options options = block_default(1);
    block b = block_make(&options);
    sb_vec3 centre = sb_v3(REAL(0.031), REAL(0.018), REAL(0.027));
    double radius = 0.0164;
    int whole = 0, corner = 0;
    block_ablate(&b, centre, radius);
    for (int e = 0; e < b.mesh.element_count; e++) {
        const int *nodes = b.mesh.elements + 4 * e;
        double share = 0, expected = -1;
        int in[4], count = 0;
        for (int a = 0; a < 4; a++) {
            in[a] = (double)sb_v3_norm(sb_v3_sub(b.mesh.nodes[nodes[a]], centre)) <= radius;
            count += in[a];
        }
        for (int c = 0; c < sb_body_element_count(b.body); c++)
            if (sb_cut_cell_element(b.cut, c) == e)
                share += (double)sb_body_cell_share(b.body, c);
        expected = count == 4 ? 0 : count == 0 ? 1 : -1;
        if (count == 1 || count == 3) {
            int alone = 0;
            double product = 1;
            while (in[alone] != (count == 1))
                alone++;
            for (int a = 0; a < 4; a++) {
                double low = 0, high = 1; /* by bisection */
                for (int k = 0; k < 60 && a != alone; k++) {
                    double t = (low + high) / 2;
                    sb_vec3 x = sb_v3_madd(b.mesh.nodes[nodes[alone]], REAL(t),
                                           sb_v3_sub(b.mesh.nodes[nodes[a]], b.mesh.nodes[nodes[alone]]));
                    if (((double)sb_v3_norm(sb_v3_sub(x, centre)) <= radius) == (count == 1))
                        low = t;
                    else
                        high = t;
                }
                product *= a == alone ? 1 : low;
            }
            expected = count == 1 ? 1 - product : product;
            corner++;
        }
        whole += count == 4;
        CHECK(count != 2 || (share > 0 && share < 1));
        if (expected >= 0)
            CHECK_NEAR(share, expected, scene_tolerance(1e-10, 500));
    }
    CHECK(whole > 5 && corner > 20);
    check_pieces(&b);
    block_free(&b);
}

/* ---- nothing left ------------------------------------------------------------------------------------------------ */

static int count_drawn(const sb_cut_drawing *d)
{
    int drawn = 0;
    for (int f = 0; f < d->triangle_count; f++)
        drawn += is_drawn(d, f);
    return drawn;
}

static void test_everything(void)
{
    for (int i = 0; i < 3; i++) {
        block_options options = block_default(intervals_of[i]);
        block b = block_make(&options);
        size_t size = sb_body_state_size(b.body), left;
        void *state = malloc(size), *empty;
        uint64_t whole = sb_body_state_hash(b.body), hash;
        double volume = volume_of(&b);
        totals before;
        sb_cut_surface *surface = NULL, *late = NULL;
        sb_cut_drawing d;
        sb_cut_info info;
        sb_part parts[2];
        int count = -1;
        CHECK_OK(sb_body_state_save(b.body, state, size));
        scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
        block_shake(&b);
        block_cut_plane(&b, sb_v3(REAL(0.03), REAL(0.02), REAL(0.025)), sb_v3(1, REAL(0.2), REAL(0.1)));
        before = totals_of(&b);
        CHECK_OK(sb_cut_surface_create(b.cut, NULL, &surface, NULL));
        info = block_ablate(&b, sb_v3(REAL(0.03), REAL(0.02), REAL(0.025)), i == 2 ? (double)SB_REAL_MAX / 8 : 1);
        check_pieces(&b);
        check_removed(&b, &before, volume, &info);
        CHECK_NEAR(info.removed_volume, volume, scene_tolerance(1e-12, 500) * volume);
        CHECK_NEAR(sb_body_mass(b.body), 0, 1e-14);
        block_step(&b, 3);
        CHECK(scene_all_finite(sb_body_positions(b.body), sb_body_node_count(b.body)));
        CHECK_OK(sb_body_parts(b.body, parts, 2, &count, NULL));
        CHECK_INT(count, 0);
        CHECK_OK(sb_cut_surface_update(surface, NULL));
        d = sb_cut_surface_get(surface);
        CHECK_INT(count_drawn(&d), 0);
        CHECK_OK(sb_cut_surface_create(b.cut, NULL, &late, NULL));
        CHECK_INT(sb_cut_surface_get(late).triangle_count, 0);
        (void)sb_body_solve_static(b.body, NULL, NULL);
        info = block_ablate(&b, sb_v3(REAL(0.03), REAL(0.02), REAL(0.025)), 1); /* there is nothing more */
        CHECK_INT(info.removed_volume > 0, 0);
        block_cut_plane(&b, sb_v3(REAL(0.02), REAL(0.02), REAL(0.025)), sb_v3(1, REAL(0.2), REAL(0.1)));
        hash = sb_body_state_hash(b.body);
        empty = malloc(sb_body_state_size(b.body));
        CHECK_OK(sb_body_state_save(b.body, empty, sb_body_state_size(b.body)));
        left = sb_body_state_size(b.body);
        CHECK_OK(sb_body_state_load(b.body, state, size, NULL));
        CHECK(sb_body_state_hash(b.body) == whole);
        check_pieces(&b);
        CHECK_OK(sb_cut_surface_update(late, NULL));
        d = sb_cut_surface_get(late);
        CHECK(count_drawn(&d) > 0 && volumes_error(&b, &d) < scene_tolerance(1e-12, 100));
        CHECK_OK(sb_body_state_load(b.body, empty, left, NULL));
        CHECK(sb_body_state_hash(b.body) == hash);
        check_pieces(&b);
        block_step(&b, 2);
        CHECK_OK(sb_cut_surface_update(late, NULL));
        d = sb_cut_surface_get(late);
        CHECK_INT(count_drawn(&d), 0);
        sb_cut_surface_destroy(late);
        sb_cut_surface_destroy(surface);
        free(state);
        free(empty);
        block_free(&b);
    }
}

/* ---- bodies that nobody chose ------------------------------------------------------------------------------------ */

/* A random case of tets as a body that can be cut, with any lattice, preconditioner and front; 0: this number has none.
 */
static int organ_make(block *b, random_case *c, unsigned long long number, double *size)
{
    static const sb_precond_kind kinds[] = {SB_PRECOND_BLOCK_JACOBI, SB_PRECOND_SSOR,     SB_PRECOND_IC0,
                                            SB_PRECOND_FSAI,         SB_PRECOND_CHOLESKY, SB_PRECOND_MULTIGRID};
    sb_body_def def = sb_default_body_def();
    sb_cut_def cut = sb_default_cut_def();
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
    if (number % 4)
        CHECK_OK(sb_body_fix_nodes(b->body, c->held, c->held_count, SB_XYZ));
    cut.body = b->body;
    cut.lattice = intervals_of[number % 3];
    cut.front = number % 5 < 2 ? SB_CUT_GLUE : SB_CUT_LAG;
    cut.least_piece = REAL(number % 7 % 3);
    CHECK_OK(sb_cut_create(&cut, &b->cut, NULL));
    CHECK_OK(sb_body_set_velocities(b->body, c->kick));
    sb_mesh_bounds(&c->mesh, &low, &high);
    *size = (double)sb_v3_norm(sb_v3_sub(high, low));
    return 1;
}

static void organ_free(block *b, random_case *c)
{
    sb_cut_destroy(b->cut);
    sb_body_destroy(b->body);
    random_case_free(c);
}

/* A ball about a random node, often exactly through one, or a square. */
static sb_cut_info organ_change(block *b, const random_case *c, double size, int ball, unsigned long long *seed)
{
    const sb_vec3 *x = sb_body_positions(b->body);
    sb_vec3 triangles[6], middle = x[random_below(seed, c->mesh.node_count)];
    if (check_random(seed) < 0.5)
        middle = sb_v3_madd(middle, REAL(0.05 * size), random_direction(seed));
    if (!ball) {
        square_make(middle, random_direction(seed), size * check_random_in(seed, 0.1, 2), triangles);
        return block_cut(b, triangles, 2);
    }
    if (check_random(seed) < 0.3)
        return block_ablate(b, middle,
                            (double)sb_v3_norm(sb_v3_sub(middle, x[random_below(seed, c->mesh.node_count)])) / 2);
    return block_ablate(b, middle, size * check_random_in(seed, 0, 0.25));
}

static double organ_burn(block *b, const random_case *c, double size, unsigned long long *seed, int *taken)
{
    double worst = 0;
    sb_cut_surface *surface = NULL;
    CHECK_OK(sb_cut_surface_create(b->cut, NULL, &surface, NULL));
    for (int i = 0; i < 8; i++) {
        totals before = totals_of(b);
        double volume = volume_of(b);
        sb_cut_info info = organ_change(b, c, size, i % 3 != 1, seed);
        sb_cut_drawing d;
        sb_error error;
        int euler;
        *taken += info.removed_volume > 0;
        if (before.kinetic > 0)
            check_removed(b, &before, volume, &info);
        check_pieces(b);
        if (!CHECK_OK(sb_body_step(b->body, c->dt, NULL)))
            break;
        if (!CHECK_OK(sb_cut_surface_update(surface, &error)))
            printf("%s\n", error.message);
        d = sb_cut_surface_get(surface);
        check_closed(&d, &euler);
        worst = fmax(worst, volumes_error(b, &d));
    }
    sb_cut_surface_destroy(surface);
    return worst;
}

static void test_organs(void)
{
    double worst = 0;
    int organs = 0, taken = 0;
    for (unsigned long long number = 0; organs < (check_quick() ? 6 : 16); number++) {
        unsigned long long seed = 71 + number;
        random_case c;
        block b;
        double size;
        int failed = check.failures;
        if (!organ_make(&b, &c, number, &size))
            continue;
        organs++;
        worst = fmax(worst, organ_burn(&b, &c, size, &seed, &taken));
        if (check.failures > failed)
            printf("in %s\n", c.name);
        organ_free(&b, &c);
    }
    printf("   %d organs, %d calls that took something: parts' volumes off by %.1e\n", organs, taken, worst);
    CHECK(taken > 2 * organs);
    CHECK_NEAR(worst, 0, scene_tolerance(1e-12, 500));
}

/* ---- crumbs ------------------------------------------------------------------------------------------------------ */

/* Cuts a corner of the block off, this long along its edges. */
static sb_cut_info cut_corner(block *b, double length)
{
    double third = length / 3;
    return block_cut_plane(b, sb_v3(REAL(third), REAL(third), REAL(third)), sb_v3(1, 1, 1));
}

/* A corner that is smaller than a mean element goes with its mass and its momentum, but not where it is held, or is to
 * be kept, or is larger. */
static void test_crumbs(void)
{
    for (int i = 0; i < 12; i++) {
        int held = i / 3 % 2, kept = i / 6;
        block_options options = block_default(intervals_of[i % 3]);
        double element, length, volume;
        sb_cut_info info;
        totals before, after;
        block b;
        options.front = i % 2 ? SB_CUT_GLUE : SB_CUT_LAG;
        options.shake = 0;
        b = crumbling_block(&options, kept ? 0 : 1);
        element = volume_of(&b) / b.mesh.element_count;
        if (held)
            scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
        block_shake_at(&b, 0.02);
        block_step(&b, 2);
        before = totals_of(&b);
        volume = volume_of(&b);
        length = 0.9 * cbrt(6 * element);
        info = cut_corner(&b, length);
        check_pieces(&b);
        if (held || kept) {
            CHECK_INT(info.crumbs, 0);
            CHECK_INT(info.parts, 2);
            CHECK(info.removed_volume == 0 && info.removed_mass == 0);
            after = totals_of(&b);
            check_totals(&before, &after);
        } else {
            CHECK_INT(info.crumbs, 1);
            CHECK_INT(info.parts, 1);
            CHECK_NEAR(info.removed_volume, length * length * length / 6, 0.3 * (double)info.removed_volume);
            check_removed(&b, &before, volume, &info);
        }
        block_step(&b, 2);
        block_free(&b);
    }
}

/* Scissors and strips at random leave no part smaller than a mean element, with glue or without: pieces of elements
 * whose other pieces are glued to each other are no exception. */
static void test_no_crumbs(void)
{
    unsigned long long seed = 77;
    int rounds = check_quick() ? 4 : 24, crumbs = 0;
    for (int round = 0; round < rounds; round++) {
        block_options options = block_default(intervals_of[round % 3]);
        block b;
        options.element = round % 4 == 3 ? SB_TET10 : SB_TET4;
        if (options.element == SB_TET10)
            options.nx = options.ny = options.nz = 3;
        options.front = round % 2 ? SB_CUT_GLUE : SB_CUT_LAG;
        b = crumbling_block(&options, 1);
        block_shake_at(&b, 0.05);
        for (int stroke = 0; stroke < 8; stroke++) {
            sb_vec3 triangles[18];
            int count = strip_random(triangles, &seed), small = 0, parts = 0;
            sb_cut_info info = block_cut(&b, triangles, count);
            sb_part list[64];
            crumbs += info.crumbs;
            CHECK_OK(sb_body_parts(b.body, list, 64, &parts, NULL));
            for (int k = 0; k < parts && k < 64; k++)
                small += list[k].volume < b.cut->least_volume;
            if (!CHECK_INT(small, 0))
                printf("round %d, stroke %d\n", round, stroke);
            check_pieces(&b);
            block_step(&b, 1);
        }
        block_free(&b);
    }
    printf("   %d crumbs taken out\n", crumbs);
    CHECK(crumbs > 0);
}

/* Slabs of a slice thinner than a link fall into crumbs, which are all taken out; larger parts stay. */
static void test_slices(void)
{
    for (int i = 0; i < 3; i++) {
        block_options options = block_default(intervals_of[i]);
        block b = crumbling_block(&options, 1);
        double volume = volume_of(&b), thin = 0.1 * 0.01 / options.lattice, taken = 0;
        int crumbs = 0, small = 0, count = 0;
        sb_part parts[64];
        for (int k = 0; k < 5; k++) {
            sb_cut_info info =
                block_cut_plane(&b, sb_v3(REAL(0.0277 + k * thin), REAL(0.02), REAL(0.025)), sb_v3(1, REAL(0.3), 0));
            crumbs += info.crumbs;
            taken += (double)info.removed_volume;
            check_pieces(&b);
        }
        CHECK_NEAR(volume_of(&b) + taken, volume, scene_tolerance(1e-12, 500) * volume);
        CHECK_OK(sb_body_parts(b.body, parts, 64, &count, NULL));
        for (int k = 0; k < count && k < 64; k++)
            small += (double)parts[k].volume < volume / b.mesh.element_count;
        CHECK_INT(small, 0);
        CHECK(taken < 0.2 * volume && (crumbs > 0 || i > 0));
        block_step(&b, 2);
        block_free(&b);
    }
}

/* Parts larger than so many mean elements. */
static int large_parts(const block *b, double elements)
{
    double volumes[64], least = elements * volume_of(b) / b->mesh.element_count;
    int large = 0, parts = part_volumes(b, volumes, 64);
    for (int k = 0; k < parts && k < 64; k++)
        large += volumes[k] > least;
    return large;
}

/* Two planes that cross leave four parts, three leave eight: crumbs on the lines where they cross are taken out, but
 * with lattice 1, where one has half of all elements about a node and may be as large as nine. */
static void test_crossing(void)
{
    unsigned long long seed = 41;
    int rounds = check_quick() ? 2 : 13, crumbs = 0;
    for (int round = 0; round < 3 * rounds; round++) {
        block_options options = block_default(intervals_of[round % 3]);
        sb_vec3 middle = sb_v3_add(sb_v3_scale(REAL(0.5), block_size), vector_in(-0.004, 0.004, &seed));
        block b;
        options.front = round % 2 ? SB_CUT_GLUE : SB_CUT_LAG;
        b = crumbling_block(&options, 1);
        for (int axis = 0; axis < 3; axis++) {
            sb_vec3 normal =
                sb_v3_add(sb_v3(REAL(axis == 0), REAL(axis == 1), REAL(axis == 2)), vector_in(-0.2, 0.2, &seed));
            sb_cut_info info = block_cut_plane(&b, middle, normal);
            crumbs += info.crumbs;
            CHECK_INT(options.lattice > 1 ? info.parts : large_parts(&b, 9), 2 << axis);
            check_pieces(&b);
        }
        block_free(&b);
    }
    printf("   three planes that cross, %d times: %d crumbs\n", 3 * rounds, crumbs);
}

/* ---- the same again ---------------------------------------------------------------------------------------------- */

static uint64_t run_burns(block *b, int frames)
{
    unsigned long long seed = 19;
    for (int i = 0; i < frames; i++) {
        sb_vec3 triangles[18], at = vector_in(0, 0.05, &seed);
        int count = strip_random(triangles, &seed);
        double radius = check_random_in(&seed, 0, 0.012);
        if (i % 4 == 0)
            block_cut(b, triangles, count);
        if (i % 3 == 1)
            block_ablate(b, at, radius);
        block_step(b, 1);
    }
    return sb_body_state_hash(b->body);
}

/* States saved, in the middle too, and recordings give the same bits. */
static void test_same_bits(void)
{
    for (int i = 0; i < 2; i++) {
        block_options options = block_default(i ? 4 : 2);
        block b, again;
        size_t size, late_size;
        void *state, *late;
        sb_recording *recording = NULL;
        sb_recording_report report;
        sb_error error;
        uint64_t hash, middle;
        int frames = check_quick() ? 9 : 30;
        options.front = i ? SB_CUT_LAG : SB_CUT_GLUE;
        b = crumbling_block(&options, 1);
        again = crumbling_block(&options, 1);
        size = sb_body_state_size(b.body);
        state = malloc(size);
        scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
        block_shake(&b);
        CHECK_OK(sb_body_state_save(b.body, state, size));
        CHECK_OK(sb_recording_start(b.body, 0, NULL, &recording, NULL));
        middle = run_burns(&b, frames);
        late_size = sb_body_state_size(b.body);
        late = malloc(late_size);
        CHECK_OK(sb_body_state_save(b.body, late, late_size));
        block_ablate(&b, sb_v3(REAL(0.03), REAL(0.02), REAL(0.02)), 0.01);
        block_cut_plane(&b, sb_v3(REAL(0.04), REAL(0.02), REAL(0.025)), sb_v3(1, 0, REAL(0.2)));
        block_step(&b, 2);
        hash = sb_body_state_hash(b.body);
        CHECK(hash != middle);
        sb_recording_stop(recording);
        if (!CHECK_OK(sb_recording_replay(recording, again.body, &report)))
            printf("%s, step %d\n", report.error.message, report.step);
        CHECK(sb_body_state_hash(again.body) == hash);
        CHECK_OK(sb_body_state_load(b.body, state, size, NULL));
        check_pieces(&b);
        CHECK(run_burns(&b, frames) == middle);
        if (!CHECK_OK(sb_body_state_load(again.body, late, late_size, &error)))
            printf("%s\n", error.message);
        check_pieces(&again);
        CHECK(sb_body_state_hash(again.body) == middle);
        block_ablate(&again, sb_v3(REAL(0.03), REAL(0.02), REAL(0.02)), 0.01);
        block_cut_plane(&again, sb_v3(REAL(0.04), REAL(0.02), REAL(0.025)), sb_v3(1, 0, REAL(0.2)));
        block_step(&again, 2);
        CHECK(sb_body_state_hash(again.body) == hash);
        sb_recording_destroy(recording);
        free(state);
        free(late);
        block_free(&b);
        block_free(&again);
    }
}

/* ---- what fails -------------------------------------------------------------------------------------------------- */

/* Every allocation of a call fails in turn: nothing has happened then, and the same call does it later. */
static void test_no_memory(void)
{
    uint64_t expected = 0;
    for (int fail = 0, done = 0; !done && fail < 400; fail++) {
        scene_memory memory = {0, 0, 0, 0};
        block b = counted_block_with(&memory, 3, 0.01, SB_CUT_GLUE);
        sb_vec3 middle = sb_v3(REAL(0.03), REAL(0.02), REAL(0.025));
        uint64_t before;
        sb_result result;
        block_cut_plane(&b, middle, sb_v3(1, REAL(0.2), 0));
        before = sb_body_state_hash(b.body);
        memory.fail_at = fail ? memory.calls + fail : 0;
        result = sb_cut_ablate(b.cut, middle, REAL(0.017), NULL, NULL);
        memory.fail_at = 0;
        done = fail && result == SB_OK;
        if (result != SB_OK) {
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK(sb_body_state_hash(b.body) == before);
            check_pieces(&b);
            CHECK_OK(sb_cut_ablate(b.cut, middle, REAL(0.017), NULL, NULL));
        }
        expected = fail ? expected : sb_body_state_hash(b.body);
        CHECK(sb_body_state_hash(b.body) == expected);
        check_pieces(&b);
        block_step(&b, 1);
        block_free(&b);
        CHECK_INT(memory.live, 0);
        CHECK(done || fail < 399);
    }
}

static void test_mistakes(void)
{
    block_options options = block_default(2);
    block b = block_make(&options);
    sb_vec3 middle = sb_v3(REAL(0.03), REAL(0.02), REAL(0.025)), bad = middle;
    sb_cut_def def = sb_default_cut_def();
    sb_cut *other = NULL;
    uint64_t hash = sb_body_state_hash(b.body);
    sb_cut_info info;
    CHECK_RESULT(sb_cut_ablate(NULL, middle, REAL(0.01), NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_cut_ablate(b.cut, middle, REAL(-0.01), &info, NULL), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    bad.y = REAL(NAN);
    CHECK_RESULT(sb_cut_ablate(b.cut, bad, REAL(0.01), &info, NULL), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_cut_ablate(b.cut, middle, REAL(INFINITY), &info, NULL), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_cut_ablate(b.cut, middle, REAL(NAN), &info, NULL), SB_ERROR_NOT_FINITE);
    info = block_ablate(&b, sb_v3(1000, 1000, 1000), 1);
    CHECK_INT(info.links, 0);
    info = block_ablate(&b, middle, 0);
    CHECK_INT(info.removed_volume > 0, 0);
    CHECK(sb_body_state_hash(b.body) == hash);
    def.body = b.body;
    def.least_piece = -1;
    CHECK_RESULT(sb_cut_create(&def, &other, NULL), SB_ERROR_ARGUMENT);
    block_ablate(&b, b.mesh.nodes[3], 0); /* just a node */
    check_pieces(&b);
    scene_remove_cells(b.body); /* somebody else */
    CHECK_RESULT(sb_cut_ablate(b.cut, middle, REAL(0.01), &info, NULL), SB_ERROR_STATE);
    block_free(&b);
}

/* ---- what sits on the body --------------------------------------------------------------------------------------- */

/* A ball out of a held, loaded face, again and again: loads act on what is left, and nothing is in the way. */
static void test_loads(void)
{
    for (int i = 0; i < 3; i++) {
        block_options options = block_default(intervals_of[i]);
        block b = crumbling_block(&options, i);
        int faces = 0, *list = skin_faces(&b, 1, &faces), pressure, springs, node = list[0];
        double area = (double)block_size.y * (double)block_size.z, left = area;
        sb_vec3 stress = sb_v3(0, 0, 40), goal = b.mesh.nodes[list[0]];
        sb_real stiffness = 100;
        scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_add_pressure(b.body, list, faces, 3, REAL(100), &pressure, NULL));
        CHECK_OK(sb_body_add_traction(b.body, list, faces, 3, stress, NULL));
        CHECK_OK(sb_body_add_springs(b.body, &node, 1, &stiffness, 1, &goal, &springs, NULL));
        for (int k = 0; k < 6; k++) {
            static const double places[6][2] = {{0.5, 0.5}, {0.2, 0.2}, {0.8, 0.2}, {0.2, 0.8}, {0.8, 0.8}, {0.5, 0.5}};
            sb_cut_surface *surface = NULL;
            sb_cut_drawing d;
            double now = 0;
            sb_vec3 force = {0, 0, 0};
            block_ablate(&b, sb_v3(block_size.x, REAL(places[k][0]) * block_size.y, REAL(places[k][1]) * block_size.z),
                         k == 5 ? 0.05 : 0.011);
            check_pieces(&b);
            CHECK_OK(sb_cut_surface_create(b.cut, NULL, &surface, NULL));
            d = sb_cut_surface_get(surface);
            for (int f = 0; f < d.triangle_count; f++)
                if (is_drawn(&d, f) && d.tags[f] == SB_CUT_SKIN &&
                    d.rest[d.triangles[f][0]].x + d.rest[d.triangles[f][1]].x + d.rest[d.triangles[f][2]].x >
                        REAL(2.9999) * block_size.x)
                    now += (double)sb_v3_norm(
                               sb_v3_cross(sb_v3_sub(d.rest[d.triangles[f][1]], d.rest[d.triangles[f][0]]),
                                           sb_v3_sub(d.rest[d.triangles[f][2]], d.rest[d.triangles[f][0]]))) /
                           2;
            sb_cut_surface_destroy(surface);
            for (int n = 0; n < sb_body_node_count(b.body); n++)
                force = sb_v3_add(force, b.body->dead_load[n]);
            CHECK(now < left || k == 5);
            CHECK_NEAR(force.z, 40 * now, scene_tolerance(1e-10, 2000) * 40 * area);
            CHECK_NEAR(force.x, 0, scene_tolerance(1e-10, 2000) * 40 * area);
            left = now;
            block_step(&b, 1);
        }
        CHECK_NEAR(left, 0, 1e-12);
        CHECK_OK(sb_body_set_pressure(b.body, pressure, REAL(200)));
        block_ablate(&b, sb_v3(0, block_size.y / 2, block_size.z / 2), 0.1); /* the held face */
        block_step(&b, 2);
        check_pieces(&b);
        free(list);
        block_free(&b);
    }
}

/* Points of embeddings, lost ones too, stay at finite places near the body, and those far from holes do not jump. */
static void test_points(void)
{
    for (int i = 0; i < 6; i++) {
        enum { POINTS = 300 };
        unsigned long long seed = 5 + (unsigned)i;
        block_options options = block_default(intervals_of[i % 3]);
        block b = crumbling_block(&options, 1);
        sb_embedding_def def = sb_default_embedding_def();
        sb_embedding *embedding = NULL;
        sb_vec3 points[POINTS], before[POINTS], after[POINTS], centre = {REAL(0.03), REAL(0.02), REAL(0.025)};
        for (int k = 0; k < POINTS; k++) {
            sb_vec3 x = vector_in(0, 1, &seed);
            points[k] = sb_v3(x.x * block_size.x, x.y * block_size.y, x.z * block_size.z);
        }
        def.mesh = &b.mesh;
        def.points = points;
        def.point_count = POINTS;
        def.kind = i < 3 ? SB_EMBED_SMOOTH : SB_EMBED_PLAIN;
        CHECK_OK(sb_embedding_create(&def, &embedding, NULL));
        CHECK_OK(sb_embedding_follow(embedding, b.body, NULL));
        block_shake_at(&b, 0.1);
        for (int k = 0; k < 4; k++) {
            double radius = k < 3 ? 0.008 + 0.004 * k : 1;
            block_step(&b, 2);
            CHECK_OK(sb_embedding_update(embedding, sb_body_positions(b.body), before, NULL, NULL));
            block_ablate(&b, centre, radius);
            CHECK_OK(sb_embedding_update(embedding, sb_body_positions(b.body), after, NULL, NULL));
            CHECK(scene_all_finite(after, POINTS));
            for (int p = 0; p < POINTS; p++) {
                double from = (double)sb_v3_norm(sb_v3_sub(before[p], centre));
                double jump = (double)sb_v3_norm(sb_v3_sub(after[p], before[p]));
                CHECK(jump < 0.02);
                if (from > radius + 0.02 && i >= 3)
                    CHECK_NEAR(jump, 0, 1e-12 + 100 * (double)SB_EPSILON);
            }
        }
        sb_embedding_destroy(embedding);
        block_free(&b);
    }
}

CHECK_SUITE(cut_ablate, {"organs: balls and squares", test_organs}, {"a ball out of a block", test_ball},
            {"the way of a tip", test_way}, {"lattice 1 takes elements out", test_elements},
            {"everything is taken out", test_everything}, {"crumbs are taken out", test_crumbs},
            {"no crumbs are left", test_no_crumbs}, {"thin slices crumble", test_slices},
            {"crossing planes", test_crossing}, {"states and recordings", test_same_bits},
            {"every allocation fails in turn", test_no_memory}, {"mistakes are named", test_mistakes},
            {"loads on what is left", test_loads}, {"points of embeddings", test_points});
