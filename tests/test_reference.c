/* Reference solutions of an industrial finite element program (CalculiX 2.20), which has the element and
 * material rules of this library: ../shared/reference/README.md. Each test solves a case file and prints how
 * far the answers are apart; the reference has 7 printed digits. What takes long runs with CHECK_SLOW=1. */
#include "softbody.h"

#include "check.h"

#include "../examples/case_reader.h"

#include <time.h>

/* ---- tables of numbers ---- */

typedef struct table {
    int rows, columns;
    double *items; /* [rows][columns] */
} table;

/* Reads a file of the case `name`, with `columns` numbers per line; rows is 0 when there is no such file. */
static table read_table(const char *name, const char *file, int columns)
{
    table t = {0, columns, NULL};
    char path[512], relative[256], *text, *cursor, *line;
    const char *reason;
    int capacity = 0;
    snprintf(relative, sizeof relative, "reference/%s/%s", name, file);
    if (!check_shared_path(path, sizeof path, relative))
        return t;
    text = case_read_text(path, &reason);
    if (!CHECK(text != NULL))
        return t;
    cursor = text;
    while ((line = case_next_line(&cursor)) != NULL) {
        void *items = t.items;
        double *row;
        if (!line[strspn(line, " \t\r")])
            continue;
        if (!CHECK(case_reserve(&items, t.rows, &capacity, (size_t)columns * sizeof(double))))
            break;
        t.items = (double *)items;
        row = t.items + (size_t)t.rows * (size_t)columns;
        for (int k = 0; k < columns; k++) {
            const char *word = case_next_word(&line);
            CHECK(word && case_scan_number(word, row + k));
        }
        t.rows++;
    }
    free(text);
    return t;
}

static const double *table_row(const table *t, int row) { return t->items + (size_t)row * (size_t)t->columns; }

/* Relative L2 difference of the vectors in columns 1 to 3, for the nodes in column 0. */
static double vector_difference(const table *t, const sb_vec3 *values, int count)
{
    double difference = 0, size = 0;
    for (int i = 0; i < t->rows; i++) {
        const double *row = table_row(t, i);
        int node = (int)row[0];
        if (!CHECK(node >= 0 && node < count))
            return 1;
        const double own[3] = {(double)values[node].x, (double)values[node].y, (double)values[node].z};
        for (int k = 0; k < 3; k++) {
            difference += (own[k] - row[1 + k]) * (own[k] - row[1 + k]);
            size += row[1 + k] * row[1 + k];
        }
    }
    return size > 0 ? sqrt(difference / size) : 1;
}

/* Greatest difference of a stress component (Pa) over the greatest stress component. */
static double stress_difference(const table *t, const sb_body *body)
{
    static const int at[6][2] = {{0, 0}, {1, 1}, {2, 2}, {0, 1}, {0, 2}, {1, 2}};
    double difference = 0, size = 0;
    for (int i = 0; i < t->rows; i++) {
        const double *row = table_row(t, i);
        sb_mat3 stress;
        if (!CHECK_OK(sb_body_stress(body, (int)row[0], (int)row[1], &stress)))
            return 1;
        for (int k = 0; k < 6; k++) {
            difference = fmax(difference, fabs((double)stress.m[at[k][0]][at[k][1]] - row[5 + k]));
            size = fmax(size, fabs(row[5 + k]));
        }
    }
    return size > 0 ? difference / size : 0;
}

/* What reactions and loads leave of force, and of torque about the centre of the mesh, over the sum of their
 * magnitudes (and arms). `x` are the positions (m) at which equilibrium holds. */
static double imbalance(const case_file *c, const sb_body *body, const sb_vec3 *x)
{
    const sb_vec3 *reaction = sb_body_reactions(body), *load = sb_body_external_forces(body);
    sb_vec3 force = sb_v3(0, 0, 0), torque = force, low, high, centre;
    double forces = 0, torques = 0;
    sb_mesh_bounds(&c->mesh, &low, &high);
    centre = sb_v3_scale((sb_real)0.5, sb_v3_add(low, high));
    for (int i = 0; i < c->mesh.node_count; i++) {
        sb_vec3 arm = sb_v3_sub(x[i], centre), own = sb_v3_add(reaction[i], load[i]);
        force = sb_v3_add(force, own);
        torque = sb_v3_add(torque, sb_v3_cross(arm, own));
        forces += (double)sb_v3_norm(own);
        torques += (double)sb_v3_norm(own) * (double)sb_v3_norm(arm);
    }
    return fmax((double)sb_v3_norm(force) / forces, (double)sb_v3_norm(torque) / torques);
}

/* ---- cases ---- */

/* Opens a reference case and makes its body; 0 (counted as skip or failure) when that cannot be done. */
static int open_case(const char *name, sb_mass_kind mass, case_file *c, sb_body **body)
{
    char path[512], relative[256];
    snprintf(relative, sizeof relative, "reference/%s/case.case", name);
    if (!check_shared_path(path, sizeof path, relative)) {
        CHECK_SKIP("no ../shared/reference");
        return 0;
    }
    int ok = case_read(c, path);
    c->mass = (int)mass;
    ok = ok && case_create_body(c, body);
    if (!CHECK(ok)) {
        printf("%s:%d: %s\n", c->path, c->error_line, c->message);
        case_free(c);
    }
    return ok;
}

/* Solves a static case, compares displacements, reactions and stresses, and weighs reactions against loads.
 * A float F = I + grad u keeps 1e-7 of strain, a stress of some 1e-7 E: where loads are small against that, a
 * float build balances them to `float_tolerance` only, while its displacements are still right. */
static void compare_static(const char *name, double tolerance, double float_tolerance)
{
    case_file c;
    sb_body *body = NULL;
    sb_step_info info;
    clock_t begin = clock();
    if (!open_case(name, SB_MASS_CONSISTENT, &c, &body))
        return;
    sb_static_options options = case_static_options(&c);
    int linear = sb_material_is_linear(c.material.model);
    options.keep_progress = 0;
    if (SB_REAL_IS_FLOAT)
        options.tolerance = (sb_real)float_tolerance;
    if (CHECK_OK(sb_body_solve_static(body, &options, &info))) {
        table solution = read_table(name, "solution.txt", 4), reaction = read_table(name, "reaction.txt", 4);
        table stress = read_table(name, "stress.txt", 11);
        double displacements = vector_difference(&solution, sb_body_displacements(body), c.mesh.node_count);
        double reactions = vector_difference(&reaction, sb_body_reactions(body), c.mesh.node_count);
        double stresses = stress_difference(&stress, body);
        double balance = imbalance(&c, body, linear ? c.mesh.nodes : sb_body_positions(body));
        CHECK_INT(solution.rows, c.mesh.node_count);
        CHECK(reaction.rows > 0);
        CHECK_NEAR(displacements, 0, SB_REAL_IS_FLOAT ? 2e-3 : tolerance);
        CHECK_NEAR(reactions, 0, SB_REAL_IS_FLOAT ? 2e-3 : 1e-5);
        CHECK_NEAR(stresses, 0, SB_REAL_IS_FLOAT ? 2e-3 : 1e-3);
        CHECK_NEAR(balance, 0, SB_REAL_IS_FLOAT ? 5e-4 : 1e-8);
        printf("  %-26s displacement %.1e reaction %.1e stress %.1e balance %.1e  %2d steps %3d newton %4d "
               "pcg %6.2f s\n",
               name, displacements, reactions, stresses, balance, info.load_steps, info.newton_iterations,
               info.pcg_iterations, (double)(clock() - begin) / (double)CLOCKS_PER_SEC);
        free(solution.items);
        free(reaction.items);
        free(stress.items);
    } else {
        printf("%s: %s\n", name, info.error.message);
    }
    sb_body_destroy(body);
    case_free(&c);
}

/* The largest deviations of a history from tip.txt. */
typedef struct history {
    table tip;        /* t ux uy uz strain_energy kinetic_energy gravity_potential */
    double amplitude; /* of the tip (m) */
    double energy;    /* greatest strain energy (J) */
    double motion_difference, energy_difference, snapshot_difference;
    int newton, pcg;
} history;

static void compare_history(history *h, const char *name, const case_file *c, sb_body *body, int step)
{
    const double *row = table_row(&h->tip, step);
    const case_statement *probe = c->statements;
    char file[64];
    sb_energy energy;
    while (probe->form->kind != CASE_OUTPUT || probe->form->code != CASE_OUTPUT_PROBE)
        probe++;
    sb_vec3 u = sb_body_displacements(body)[probe->node];
    u = sb_v3_sub(u, sb_v3((sb_real)row[1], (sb_real)row[2], (sb_real)row[3]));
    CHECK_OK(sb_body_energy(body, &energy));
    h->motion_difference = fmax(h->motion_difference, (double)sb_v3_norm(u) / h->amplitude);
    h->energy_difference = fmax(h->energy_difference, fabs((double)energy.elastic - row[4]) / h->energy);
    h->energy_difference = fmax(h->energy_difference, fabs((double)energy.kinetic - row[5]) / h->energy);
    snprintf(file, sizeof file, "solution_t%g.txt", row[0]);
    table snapshot = read_table(name, file, 4);
    if (snapshot.rows > 0)
        h->snapshot_difference =
            fmax(h->snapshot_difference, vector_difference(&snapshot, sb_body_displacements(body), c->mesh.node_count));
    free(snapshot.items);
}

static int run_history(history *h, const char *name, const case_file *c, sb_body *body)
{
    double dt = case_dt(c);
    int count = case_step_count(c, dt);
    if (!CHECK_INT(h->tip.rows, count + 1))
        return 0;
    for (int i = 0; i <= count; i++) {
        h->amplitude = fmax(h->amplitude, fabs(table_row(&h->tip, i)[3]));
        h->energy = fmax(h->energy, table_row(&h->tip, i)[4]);
    }
    for (int step = 1; step <= count; step++) {
        double time = case_step_time(c, dt, step, count), last = case_step_time(c, dt, step - 1, count);
        sb_step_info info;
        if (!CHECK_OK(case_move_supports(c, body, time)) ||
            !CHECK_OK(sb_body_step(body, (sb_real)(time - last), &info))) {
            printf("%s, step %d: %s\n", name, step, info.error.message);
            return 0;
        }
        CHECK(!info.capped || SB_REAL_IS_FLOAT);
        h->newton += info.newton_iterations;
        h->pcg += info.pcg_iterations;
        compare_history(h, name, c, body, step);
    }
    return 1;
}

/* Compares a dynamic case. CalculiX integrates the consistent mass with the points of the stiffness, which
 * moves the frequencies of tet4 by 2 % and of tet10 by 0.1 % off those of the exact mass: the test takes
 * SB_MASS_REDUCED, which is the same. */
static void compare_dynamic(const char *name)
{
    case_file c;
    sb_body *body = NULL;
    history h;
    clock_t begin = clock();
    memset(&h, 0, sizeof h);
    if (!open_case(name, SB_MASS_REDUCED, &c, &body))
        return;
    h.tip = read_table(name, "tip.txt", 7);
    if (run_history(&h, name, &c, body)) {
        CHECK_NEAR(h.motion_difference, 0, 1e-4);
        CHECK_NEAR(h.energy_difference, 0, SB_REAL_IS_FLOAT ? 1e-2 : 1e-4);
        CHECK_NEAR(h.snapshot_difference, 0, SB_REAL_IS_FLOAT ? 5e-2 : 1e-3);
        printf("  %-26s tip %.1e energies %.1e snapshots %.1e  %d newton %d pcg %.2f s\n", name, h.motion_difference,
               h.energy_difference, h.snapshot_difference, h.newton, h.pcg,
               (double)(clock() - begin) / (double)CLOCKS_PER_SEC);
    }
    free(h.tip.items);
    sb_body_destroy(body);
    case_free(&c);
}

/* What rounding of the stiffness may make of a rigid motion's frequency (Hz). Squares of frequencies are off by a share
 * of the unit of rounding times the square of the mesh's largest; 0.05 at most was seen in single precision, 0.25 is
 * let pass. */
static double rigid_rounding(sb_body *body)
{
    sb_real step = 1;
    CHECK_OK(sb_body_stable_step(body, &step, NULL));
    return sqrt((double)SB_EPSILON / 4) / (3.14159265 * (double)step);
}

/* Compares the lowest frequencies with column `column` of frequencies.txt, in which 2 is made with the mass that
 * CalculiX integrates with the points of the stiffness, 3 with the exact one. Where those differ, the elastic modes
 * (from `first` on, the others are rigid) differ by formulation: 2 % on tet4, 0.1 % on tet10. */
static double frequency_difference(const table *t, sb_body *body, sb_mass_kind mass, int first, int column,
                                   sb_modes_info *info)
{
    enum { MOST = 32 };
    sb_modes_options options = sb_default_modes_options();
    sb_real frequencies[MOST];
    double difference = 0;
    sb_error error;
    options.mass = mass;
    if (!CHECK(t->rows > first && t->rows <= MOST) ||
        !CHECK_OK(sb_body_modes(body, t->rows, &options, frequencies, NULL, info, &error)))
        return 1;
    for (int i = 0; i < first; i++)
        CHECK_NEAR(frequencies[i], 0, SB_REAL_IS_FLOAT ? rigid_rounding(body) : 1e-5 * table_row(t, first)[column]);
    for (int i = first; i < t->rows; i++) {
        double wanted = table_row(t, i)[column];
        difference = fmax(difference, fabs((double)frequencies[i] - wanted) / wanted);
    }
    return difference;
}

static void compare_modes(const char *name)
{
    case_file c;
    sb_body *body = NULL;
    sb_modes_info info;
    clock_t begin = clock();
    int first = strstr(name, "free") ? 6 : 0;
    if (!open_case(name, SB_MASS_CONSISTENT, &c, &body))
        return;
    table t = read_table(name, "frequencies.txt", 4);
    double exact = frequency_difference(&t, body, SB_MASS_CONSISTENT, first, 3, &info);
    double reduced = 0;
    CHECK_NEAR(exact, 0, SB_REAL_IS_FLOAT ? 2e-3 : 1e-5);
    if (first == 0 && !SB_REAL_IS_FLOAT) { /* a reduced mass on tets is of low rank: supports it must have */
        reduced = frequency_difference(&t, body, SB_MASS_REDUCED, first, 2, &info);
        CHECK_NEAR(reduced, 0, 1e-5);
    }
    printf("  %-26s frequencies: exact mass %.1e, reduced mass %.1e  %d iterations %.2f s\n", name, exact, reduced,
           info.iterations, (double)(clock() - begin) / (double)CLOCKS_PER_SEC);
    free(t.items);
    sb_body_destroy(body);
    case_free(&c);
}

static void test_linear_tet4(void) { compare_static("lin_cantilever_tet4", 1e-5, 0.05); }
static void test_linear_tet10(void) { compare_static("lin_cantilever_tet10", 1e-5, 0.05); }
static void test_linear_hex8(void) { compare_static("lin_cantilever_hex8", 1e-5, 0.05); }
static void test_neo_hookean_tet4(void) { compare_static("nh_cantilever_tet4", 1e-5, 1e-4); }
static void test_neo_hookean_tet10(void) { compare_static("nh_cantilever_tet10", 1e-5, 1e-4); }
static void test_neo_hookean_hex8(void) { compare_static("nh_cantilever_hex8", 1e-5, 1e-4); }
static void test_uniaxial(void) { compare_static("nh_uniaxial_tet10", 1e-5, 1e-4); }
static void test_svk_tet4(void) { compare_static("svk_cantilever_tet4", 1e-5, 1e-4); }
static void test_svk_tet10(void) { compare_static("svk_cantilever_tet10", 1e-5, 1e-4); }
static void test_twist(void) { compare_static("twist90_tet10", 1e-5, 1e-4); }
static void test_bend(void) { compare_static("cylinder_bend_coarse_tet10", 1e-5, 1e-4); }
static void test_stretch(void) { compare_static("cylinder_stretch3_tet10", 1e-5, 1e-4); }
static void test_phantom_tet4(void) { compare_static("phantom_probe_tet4", 1e-5, 1e-4); }
static void test_phantom_tet10(void) { compare_static("phantom_probe_tet10", 1e-5, 0.05); }
static void test_linear_hex20(void) { compare_static("lin_cantilever_hex20", 1e-5, 0.05); }
static void test_neo_hookean_hex20(void) { compare_static("nh_cantilever_hex20", 1e-5, 1e-4); }
static void test_svk_hex20(void) { compare_static("svk_cantilever_hex20", 1e-5, 1e-4); }
static void test_twist_hex20(void) { compare_static("twist90_hex20", 1e-5, 1e-4); }
static void test_stretch_hex20(void) { compare_static("cylinder_stretch3_hex20", 1e-5, 1e-4); }
static void test_mooney_uniaxial(void) { compare_static("mr_uniaxial_hex8", 1e-5, 1e-4); }
static void test_mooney_shear(void)
{
    compare_static("mr_shear_tet10", 1e-5, 1e-4);
    compare_static("mr_shear_hex20", 1e-5, 1e-4);
}
static void test_mooney_stretch(void)
{
    compare_static("mr_stretch60_tet10", 1e-5, 1e-4);
    compare_static("mr_stretch60_hex20", 1e-5, 1e-4);
}
static void test_polynomial_compress(void)
{
    compare_static("rp2_compress30_tet10", 1e-5, 1e-4);
    compare_static("rp2_compress30_hex20", 1e-5, 1e-4);
}
static void test_polynomial_stretch(void) { compare_static("rp2_stretch50_hex20", 1e-5, 1e-4); }
static void test_polynomial_liver(void) { compare_static("rp2_liver_gravity_tet10", 1e-5, 1e-4); }
static void test_modes_cantilever(void)
{
    compare_modes("modal_cantilever_tet4");
    compare_modes("modal_cantilever_tet10");
    compare_modes("modal_cantilever_hex8");
    compare_modes("modal_cantilever_hex20");
}
static void test_modes_free(void)
{
    compare_modes("modal_free_tet4");
    compare_modes("modal_free_tet10");
    compare_modes("modal_free_hex8");
    compare_modes("modal_free_hex20");
}
static void test_release_hex20(void) { compare_dynamic("dyn_gravity_hex20"); }
static void test_release_tet4(void) { compare_dynamic("dyn_gravity_tet4"); }
static void test_release_tet10(void) { compare_dynamic("dyn_gravity_tet10"); }

static void test_bend_fine(void)
{
    if (getenv("CHECK_SLOW"))
        compare_static("cylinder_bend_fine_tet10", 1e-5, 1e-4);
    else
        CHECK_SKIP("takes half a minute; runs with CHECK_SLOW=1");
}

CHECK_SUITE(reference, {"linear cantilever, tet4", test_linear_tet4}, {"linear cantilever, tet10", test_linear_tet10},
            {"linear cantilever, hex8", test_linear_hex8}, {"neo-Hookean cantilever, tet4", test_neo_hookean_tet4},
            {"neo-Hookean cantilever, tet10", test_neo_hookean_tet10},
            {"neo-Hookean cantilever, hex8", test_neo_hookean_hex8}, {"uniaxial stretch", test_uniaxial},
            {"St. Venant-Kirchhoff cantilever, tet4", test_svk_tet4},
            {"St. Venant-Kirchhoff cantilever, tet10", test_svk_tet10}, {"twist by 90 degrees", test_twist},
            {"bent cylinder, coarse", test_bend}, {"bent cylinder, fine", test_bend_fine},
            {"stretched cylinder", test_stretch}, {"phantom with two regions, tet4", test_phantom_tet4},
            {"phantom with two regions, tet10", test_phantom_tet10}, {"released cantilever, tet4", test_release_tet4},
            {"released cantilever, tet10", test_release_tet10}, {"released cantilever, hex20", test_release_hex20},
            {"linear cantilever, hex20", test_linear_hex20}, {"neo-Hookean cantilever, hex20", test_neo_hookean_hex20},
            {"St. Venant-Kirchhoff cantilever, hex20", test_svk_hex20},
            {"twist by 90 degrees, hex20", test_twist_hex20}, {"stretched cylinder, hex20", test_stretch_hex20},
            {"Mooney-Rivlin, uniaxial", test_mooney_uniaxial}, {"Mooney-Rivlin, shear", test_mooney_shear},
            {"Mooney-Rivlin, stretch", test_mooney_stretch},
            {"reduced polynomial, compression", test_polynomial_compress},
            {"reduced polynomial, stretch", test_polynomial_stretch},
            {"reduced polynomial, liver under gravity", test_polynomial_liver},
            {"frequencies of a cantilever", test_modes_cantilever}, {"frequencies of a free beam", test_modes_free});
