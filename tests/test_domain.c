/* Domains of one's own: integration points that do not come from the elements of the mesh. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

static sb_vec3 box_size(void) { return sb_v3(REAL(0.2), REAL(0.06), REAL(0.06)); }

/* Def of a soft beam; the domain's cells are the mesh's elements. */
static sb_body_def soft_def(const sb_mesh *mesh, const sb_domain *domain)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.domain = domain;
    def.material = sb_material_corotated(REAL(5e4), REAL(0.4), REAL(1000));
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    return def;
}

/* Hash of the motion of a clamped beam after some steps; of its state, too. */
static unsigned long long play(const sb_body_def *def)
{
    sb_body *body = scene_body(def);
    unsigned long long hash = 0;
    if (!body)
        return 0;
    scene_fix_plane(body, def->mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < 5; s++)
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK(scene_all_finite(sb_body_displacements(body), def->mesh->node_count));
    hash = scene_hash(sb_body_displacements(body), (size_t)def->mesh->node_count * sizeof(sb_vec3));
    sb_body_destroy(body);
    return hash;
}

static void test_default_domain_same_bits(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX8, SB_HEX20, SB_TET10};
    for (int i = 0; i < 6; i++) {
        sb_mesh mesh = scene_box(types[i], 5, 2, 2, box_size(), 0.1);
        sb_integration integration = i == 3   ? SB_INTEGRATION_BBAR
                                     : i == 5 ? SB_INTEGRATION_CURVED
                                              : SB_INTEGRATION_AUTO;
        sb_domain domain;
        sb_body_def def = soft_def(&mesh, NULL);
        unsigned long long hash;
        CHECK_OK(sb_domain_create(&mesh, integration, i == 1, NULL, &domain, NULL));
        def.integration = integration;
        def.single_rotation = i == 1;
        def.mass = i == 4 ? SB_MASS_CONSISTENT : SB_MASS_LUMPED;
        hash = play(&def);
        def.domain = &domain;
        def.integration = SB_INTEGRATION_AUTO;
        def.single_rotation = 0;
        CHECK(hash != 0 && play(&def) == hash);
        sb_domain_free(&domain);
        sb_mesh_free(&mesh);
    }
}

/* A mesh and a domain in which every element is there `copies` times, with that share of the weight. */
static void split_cells(const sb_mesh *mesh, int copies, sb_mesh *split, sb_domain *domain)
{
    int n = sb_mesh_element_width(mesh), q;
    memset(split, 0, sizeof *split);
    CHECK_OK(sb_mesh_copy(mesh, NULL, split, NULL));
    for (int k = 1; k < copies; k++)
        for (int e = 0; e < mesh->element_count; e++) {
            sb_mesh one = *mesh;
            one.element_count = 1;
            one.elements = mesh->elements + e * n;
            one.regions = NULL;
            CHECK_OK(sb_mesh_append(split, &one, NULL));
        }
    /* appended nodes are not used: take the first copy's */
    for (int e = mesh->element_count; e < split->element_count; e++)
        memcpy(split->elements + e * n, mesh->elements + (e - mesh->element_count) % mesh->element_count * n,
               (size_t)n * sizeof(int));
    split->node_count = mesh->node_count;
    CHECK_OK(sb_domain_create(split, SB_INTEGRATION_AUTO, 0, NULL, domain, NULL));
    q = domain->points_per_cell;
    for (int i = 0; i < domain->cell_count * q; i++)
        domain->weights[i] /= (sb_real)copies;
}

/* cell_mass of every cell: a share of its element's consistent mass, from a body of that one element. */
static void fill_masses(sb_domain *domain, const sb_mesh *mesh, int copies)
{
    int n = domain->nodes_per_cell, pairs = n * (n + 1) / 2;
    domain->cell_mass = (sb_real *)malloc((size_t)(domain->cell_count * pairs) * sizeof(sb_real));
    for (int e = 0; e < domain->cell_count; e++) {
        const int *cell = domain->cells + e * n;
        sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS],
            *mass = domain->cell_mass + e * pairs;
        int q = sb_element_quadrature(domain->element_type, SB_QUADRATURE_MASS, points, weights);
        memset(mass, 0, (size_t)pairs * sizeof *mass);
        for (int p = 0; p < q; p++) {
            sb_real shape[SB_MAX_ELEMENT_NODES], gradient[SB_MAX_ELEMENT_NODES][3];
            sb_vec3 column[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
            sb_real w;
            sb_element_shape(domain->element_type, points[p], shape, gradient);
            for (int a = 0; a < n; a++)
                for (int j = 0; j < 3; j++)
                    column[j] = sb_v3_madd(column[j], gradient[a][j], mesh->nodes[cell[a]]);
            w = weights[p] * sb_v3_dot(column[0], sb_v3_cross(column[1], column[2])) / (sb_real)copies;
            for (int a = 0, at = 0; a < n; a++)
                for (int b = a; b < n; b++, at++)
                    mass[at] += w * shape[a] * shape[b];
        }
    }
}

/* Two cells of half the weight are one of all of it; masses add up for every kind but lumping of unlike shares. */
static void test_split_cells(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_HEX8};
    static const sb_mass_kind kinds[] = {SB_MASS_LUMPED, SB_MASS_CONSISTENT};
    for (int i = 0; i < 4; i++) {
        sb_mesh mesh = scene_box(types[i / 2], 5, 2, 2, box_size(), 0.1), split;
        sb_domain domain;
        sb_body_def def = soft_def(&mesh, NULL), other;
        sb_body *body, *twin;
        sb_energy energy, same;
        sb_check_report report;
        split_cells(&mesh, 2, &split, &domain);
        fill_masses(&domain, &mesh, 2);
        def.mass = kinds[i % 2];
        def.integrator = SB_NEWMARK;
        def.tolerance = REAL(1e-9);
        other = def;
        other.mesh = &split;
        other.domain = &domain;
        body = scene_body(&def);
        twin = scene_body(&other);
        CHECK_NEAR(sb_body_mass(twin), sb_body_mass(body), scene_tolerance(1e-13, 100) * (double)sb_body_mass(body));
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        scene_fix_plane(twin, &mesh, 0, 0, SB_XYZ);
        for (int s = 0; s < 5; s++) {
            CHECK_OK(sb_body_step(body, REAL(0.02), NULL));
            CHECK_OK(sb_body_step(twin, REAL(0.02), NULL));
        }
        CHECK_NEAR(scene_distance(sb_body_displacements(body), sb_body_displacements(twin), mesh.node_count), 0,
                   scene_tolerance(1e-10, 3000) * 0.2);
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_OK(sb_body_energy(twin, &same));
        CHECK_NEAR(same.elastic, energy.elastic, scene_tolerance(1e-8, 20000) * (double)energy.elastic);
        CHECK_OK(sb_body_check(twin, &report));
        CHECK_INT(report.warnings & ~(unsigned)SB_CHECK_LOCKING, 0);
        sb_body_destroy(body);
        sb_body_destroy(twin);
        free(domain.cell_mass);
        domain.cell_mass = NULL;
        sb_domain_free(&domain);
        sb_mesh_free(&mesh);
        sb_mesh_free(&split);
    }
}

/* A cell whose points have no weight, and its mass none: as if it were not there. */
static void test_weightless_cell_is_absent(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 3, 1, 1, sb_v3(3, 1, 1), 0),
            longer = scene_box(SB_HEX8, 4, 1, 1, sb_v3(4, 1, 1), 0);
    sb_domain domain;
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    sb_energy energy;
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)longer.node_count, sizeof(sb_vec3));
    sb_mat3 stress;
    sb_real values[4];
    CHECK_OK(sb_domain_create(&longer, SB_INTEGRATION_AUTO, 0, NULL, &domain, NULL));
    fill_masses(&domain, &longer, 1);
    for (int p = 0; p < 8; p++)
        domain.weights[3 * 8 + p] = 0;
    memset(domain.cell_mass + 3 * 36, 0, 36 * sizeof(sb_real));
    def.mesh = &longer;
    def.domain = &domain;
    def.material = sb_material_neo_hookean(REAL(5000), REAL(0.3), REAL(1000));
    body = scene_body(&def);
    CHECK_NEAR(sb_body_mass(body), 3000, scene_tolerance(1e-9, 100) * 3000);
    for (int i = 0; i < longer.node_count; i++)
        u[i].x = longer.nodes[i].x > REAL(3.5) ? REAL(-2.5) : REAL(0.01) * longer.nodes[i].x; /* the last inside out */
    CHECK_OK(sb_body_set_displacements(body, u));
    CHECK_OK(sb_body_energy(body, &energy));
    CHECK(energy.elastic > 0);
    CHECK_RESULT(sb_body_stress(body, 3, 0, &stress), SB_ERROR_INVERTED);
    sb_body_von_mises(body, values);
    CHECK(values[3] == 0 && values[2] > 0);
    sb_body_reset(body);
    scene_fix_plane(body, &longer, 0, 0, SB_XYZ);
    scene_fix_plane(body, &longer, 0, 4, SB_XYZ); /* nothing else holds what is only the cell's */
    CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, REAL(-1e-3))));
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    {
        sb_body_def shorter = def;
        sb_body *twin;
        double worst = 0;
        shorter.mesh = &mesh;
        shorter.domain = NULL;
        twin = scene_body(&shorter);
        scene_fix_plane(twin, &mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_set_gravity(twin, sb_v3(0, 0, REAL(-1e-3))));
        CHECK_OK(sb_body_solve_static(twin, NULL, NULL));
        for (int i = 0; i < mesh.node_count; i++)
            for (int j = 0; j < longer.node_count; j++)
                if (sb_v3_norm(sb_v3_sub(mesh.nodes[i], longer.nodes[j])) < REAL(1e-3))
                    worst = fmax(worst, (double)sb_v3_norm(
                                            sb_v3_sub(sb_body_displacements(twin)[i], sb_body_displacements(body)[j])));
        CHECK_NEAR(worst, 0,
                   scene_tolerance(1e-6, 1e4) * (double)sb_v3_norm(sb_body_displacements(twin)[mesh.node_count - 1]));
        sb_body_destroy(twin);
    }
    sb_body_destroy(body);
    free(u);
    free(domain.cell_mass);
    domain.cell_mass = NULL;
    sb_domain_free(&domain);
    sb_mesh_free(&mesh);
    sb_mesh_free(&longer);
}

/* What creation says of a def whose domain was spoilt. */
static sb_result refused(const sb_body_def *def, const char *words)
{
    sb_body *body = NULL;
    sb_error error;
    sb_result result = sb_body_create(def, &body, &error);
    CHECK(body == NULL);
    if (!CHECK(result != SB_OK && strstr(error.message, words) != NULL))
        printf("    %s\n", result == SB_OK ? "accepted" : error.message);
    sb_body_destroy(body);
    return result;
}

static void test_errors(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 2, 1, 1, sb_v3(2, 1, 1), 0);
    sb_domain domain, bad;
    sb_body_def def = soft_def(&mesh, &bad);
    sb_real mass[2 * 36] = {0}, kept;
    int node;
    CHECK_OK(sb_domain_create(&mesh, SB_INTEGRATION_AUTO, 0, NULL, &domain, NULL));
    bad = domain;
    def.integration = SB_INTEGRATION_BBAR;
    CHECK_RESULT(refused(&def, "def.domain has its own points"), SB_ERROR_ARGUMENT);
    def.integration = SB_INTEGRATION_AUTO;
    bad.node_count++;
    CHECK_RESULT(refused(&def, "13 nodes and 2 cells of hex8, the mesh 12 nodes"), SB_ERROR_ARGUMENT);
    bad = domain;
    bad.cell_count = 1;
    CHECK_RESULT(refused(&def, "1 cells"), SB_ERROR_ARGUMENT);
    bad = domain;
    bad.element_type = SB_TET4;
    CHECK_RESULT(refused(&def, "cells of tet4"), SB_ERROR_ARGUMENT);
    bad = domain;
    bad.nodes_per_cell = 7;
    CHECK_RESULT(refused(&def, "the domain has"), SB_ERROR_ARGUMENT);
    bad = domain;
    bad.points_per_cell = 7;
    CHECK_RESULT(refused(&def, "7 points per cell"), SB_ERROR_ARGUMENT);
    bad = domain;
    bad.mean_points = 2;
    CHECK_RESULT(refused(&def, "mean_points 2"), SB_ERROR_ARGUMENT);
    bad = domain;
    bad.single_rotation = 1;
    CHECK_RESULT(refused(&def, "single_rotation 1"), SB_ERROR_ARGUMENT);
    bad = domain;
    bad.weights = NULL;
    CHECK_RESULT(refused(&def, "NULL"), SB_ERROR_ARGUMENT);
    bad = domain;
    node = domain.cells[9];
    domain.cells[9] = domain.cells[10];
    CHECK_RESULT(refused(&def, "cell 1 of the domain has other nodes"), SB_ERROR_ARGUMENT);
    domain.cells[9] = node;
    kept = domain.weights[11];
    domain.weights[11] = REAL(-1e-9);
    CHECK_RESULT(refused(&def, "point 3 of cell 1 of the domain has the weight -1e-09"), SB_ERROR_ARGUMENT);
    domain.weights[11] = (sb_real)NAN;
    CHECK_RESULT(refused(&def, "cell 1 of the domain has a number that is not finite"), SB_ERROR_NOT_FINITE);
    domain.weights[11] = kept;
    kept = domain.gradients[5];
    domain.gradients[5] += REAL(0.01);
    CHECK_RESULT(refused(&def, "do not sum to 0"), SB_ERROR_ARGUMENT);
    domain.gradients[5] = (sb_real)INFINITY;
    CHECK_RESULT(refused(&def, "not finite"), SB_ERROR_NOT_FINITE);
    domain.gradients[5] = kept;
    bad.cell_mass = mass;
    mass[36] = REAL(-1);
    CHECK_RESULT(refused(&def, "cell 1 of the domain has a negative mass"), SB_ERROR_ARGUMENT);
    bad.cell_mass = NULL;
    memset(domain.weights, 0, 16 * sizeof(sb_real));
    CHECK_RESULT(refused(&def, "all weights"), SB_ERROR_ARGUMENT);
    sb_domain_free(&domain);
    sb_mesh_free(&mesh);
}

static void test_allocation_failures(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 2, 1, 1, sb_v3(2, 1, 1), 0);
    sb_domain domain;
    scene_memory memory = {0, 0, 0, 0};
    sb_body_def def = soft_def(&mesh, &domain);
    sb_body *body = NULL;
    int failures = 0;
    CHECK_OK(sb_domain_create(&mesh, SB_INTEGRATION_AUTO, 0, NULL, &domain, NULL));
    fill_masses(&domain, &mesh, 1);
    def.allocator = scene_allocator(&memory);
    for (int at = 1; !body && at < 1000; at++) {
        sb_result result;
        memory.calls = 0;
        memory.fail_at = at;
        result = sb_body_create(&def, &body, NULL);
        failures += result != SB_OK;
        CHECK(result == SB_OK || (result == SB_ERROR_MEMORY && memory.live == 0));
    }
    CHECK(failures > 10);
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    free(domain.cell_mass);
    domain.cell_mass = NULL;
    sb_domain_free(&domain);
    sb_mesh_free(&mesh);
}

/* States go to bodies with the same points only. */
static void test_state_of_other_points_is_refused(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 2, 1, 1, sb_v3(2, 1, 1), 0);
    sb_domain domain;
    sb_body_def def = soft_def(&mesh, NULL);
    sb_body *bodies[4] = {NULL, NULL, NULL, NULL};
    sb_error error;
    CHECK_OK(sb_domain_create(&mesh, SB_INTEGRATION_AUTO, 0, NULL, &domain, NULL));
    bodies[0] = scene_body(&def);
    def.domain = &domain;
    bodies[1] = scene_body(&def);
    bodies[2] = scene_body(&def);
    domain.weights[0] *= REAL(0.5);
    bodies[3] = scene_body(&def);
    for (int from = 0; from < 4; from++) {
        size_t bytes = sb_body_state_size(bodies[from]);
        void *image = malloc(bytes);
        CHECK_OK(sb_body_state_save(bodies[from], image, bytes));
        for (int to = 0; to < 4; to++) {
            int same = from == to || (from == 1 && to == 2) || (from == 2 && to == 1);
            CHECK_RESULT(sb_body_state_load(bodies[to], image, bytes, &error), same ? SB_OK : SB_ERROR_STATE);
        }
        free(image);
    }
    for (int i = 0; i < 4; i++)
        sb_body_destroy(bodies[i]);
    sb_domain_free(&domain);
    sb_mesh_free(&mesh);
}

/* Applying and spreading are each other's transpose. */
static void test_mapping_transpose(void)
{
    const int row_start[4] = {0, 1, 3, 6}, nodes[6] = {2, 0, 1, 3, 2, 0};
    const sb_real weights[6] = {1, REAL(0.25), REAL(0.75), REAL(-0.5), REAL(0.5), 1};
    sb_vec3 x[4], f[3], mapped[3], spread[4];
    sb_mapping mapping;
    double left = 0, right = 0;
    unsigned long long seed = 3;
    mapping.row_count = 3;
    mapping.row_start = row_start;
    mapping.nodes = nodes;
    mapping.weights = weights;
    for (int i = 0; i < 4; i++) {
        x[i] = sb_v3(REAL(check_random(&seed)), REAL(check_random(&seed)), REAL(check_random(&seed)));
        spread[i] = sb_v3(0, 0, 0);
    }
    for (int j = 0; j < 3; j++)
        f[j] = sb_v3(REAL(check_random(&seed)), REAL(check_random(&seed)), REAL(check_random(&seed)));
    sb_mapping_apply(&mapping, x, mapped);
    sb_mapping_spread(&mapping, f, spread);
    CHECK_NEAR(mapped[1].y, 0.25 * (double)x[0].y + 0.75 * (double)x[1].y, 4 * (double)SB_EPSILON);
    for (int j = 0; j < 3; j++)
        left += (double)sb_v3_dot(mapped[j], f[j]);
    for (int i = 0; i < 4; i++)
        right += (double)sb_v3_dot(x[i], spread[i]);
    CHECK_NEAR(left, right, 20 * (double)SB_EPSILON);
}

CHECK_SUITE(domain, {"the elements' own domain gives the same bits", test_default_domain_same_bits},
            {"cells split into shares", test_split_cells},
            {"a cell without weight is as good as absent", test_weightless_cell_is_absent},
            {"domains that do not fit", test_errors}, {"allocation failures", test_allocation_failures},
            {"states of bodies with other points", test_state_of_other_points_is_refused},
            {"mappings and their transpose", test_mapping_transpose});
