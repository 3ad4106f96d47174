/* Tet4 with the volume held over patches: the patches themselves, on meshes that nobody chose; energies, forces,
 * tangents and products of every model; regions, threads, states, domains; pressures without checkerboards. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

enum { MODELS = 11 };

static sb_material model_of(int model, double poisson)
{
    const sb_real young = REAL(5e3), nu = REAL(poisson), density = REAL(1000);
    const sb_real mu[2] = {REAL(1000), REAL(-200)}, alpha[2] = {REAL(2.5), REAL(-2)};
    sb_material m = sb_material_linear(young, nu, density);
    switch (model) {
    case 0: return m;
    case 1: return sb_material_corotated(young, nu, density);
    case 2: return sb_material_corotated_invertible(young, nu, density);
    case 3: return sb_material_svk(young, nu, density);
    case 4: return sb_material_neo_hookean(young, nu, density);
    case 5: return sb_material_neo_hookean_isochoric(m.c10, m.d1, density);
    case 6: return sb_material_stable_neo_hookean(young, nu, density);
    case 7: return sb_material_mooney_rivlin(REAL(0.7) * m.c10, REAL(0.3) * m.c10, m.d1, density);
    case 8: return sb_material_reduced_polynomial(m.c10, REAL(0.1) * m.c10, REAL(0.02) * m.c10, m.d1, density);
    case 9: return sb_material_ogden(mu, alpha, 2, m.d1, density);
    default: return sb_material_fung(m.c10, REAL(0.5), m.d1, density);
    }
}

static sb_body *patched(const sb_mesh *mesh, sb_material material, int has_patches)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = material;
    def.integration = has_patches ? SB_INTEGRATION_PATCH : SB_INTEGRATION_AUTO;
    return scene_body(&def);
}

/* A box whose tets are in no order and of two regions, unless whole. */
static sb_mesh mixed_box(int nx, int ny, int nz, double shake, int whole)
{
    sb_mesh mesh = scene_box(SB_TET4, nx, ny, nz, sb_v3(REAL(0.4), REAL(0.3), REAL(0.2)), shake);
    unsigned long long seed = 99;
    for (int e = mesh.element_count - 1; e > 0; e--) {
        int other = (int)(check_random(&seed) * (e + 1));
        for (int a = 0; a < 4; a++) {
            int node = mesh.elements[4 * e + a];
            mesh.elements[4 * e + a] = mesh.elements[4 * other + a];
            mesh.elements[4 * other + a] = node;
        }
    }
    if (!whole) {
        mesh.regions = (int *)malloc((size_t)mesh.element_count * sizeof(int));
        for (int e = 0; e < mesh.element_count; e++) {
            double x = 0;
            for (int a = 0; a < 4; a++)
                x += 0.25 * (double)mesh.nodes[mesh.elements[4 * e + a]].x;
            mesh.regions[e] = x > 0.25 ? 7 : 3;
        }
    }
    return mesh;
}

static void free_mixed(sb_mesh *mesh)
{
    free(mesh->regions);
    mesh->regions = NULL;
    sb_mesh_free(mesh);
}

/* Displacements at random up to `amount`. */
static sb_vec3 *wobble(int count, double amount, unsigned long long seed)
{
    sb_vec3 *u = (sb_vec3 *)malloc((size_t)count * sizeof(sb_vec3));
    for (int i = 0; i < count; i++)
        u[i] = sb_v3(REAL(check_random_in(&seed, -amount, amount)), REAL(check_random_in(&seed, -amount, amount)),
                     REAL(check_random_in(&seed, -amount, amount)));
    return u;
}

static double energy_at(sb_body *body, const sb_vec3 *u)
{
    sb_energy energy = {0, 0, 0};
    CHECK_OK(sb_body_set_displacements(body, u));
    CHECK_OK(sb_body_energy(body, &energy));
    return (double)energy.elastic;
}

/* Internal forces (N) at u: what holds all nodes there, the other way round. */
static void forces_at(sb_body *body, const sb_vec3 *u, sb_vec3 *force)
{
    for (int i = 0; i < sb_body_node_count(body); i++)
        CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u[i], 1));
    CHECK_OK(sb_body_set_displacements(body, u));
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    memcpy(force, sb_body_reactions(body), (size_t)sb_body_node_count(body) * sizeof(sb_vec3));
}

/* ---- patches ---- */

typedef struct census {
    int patches, least, most, odd; /* odd: fewer than 5 or more than 10 tets */
} census;

/* Tets of each patch are of one region and connected by faces; all are in one. */
static census count_patches(const char *name, const sb_mesh *mesh)
{
    census c = {0, 1 << 30, 0, 0};
    sb_index_table neighbours;
    sb_domain domain;
    int *size, *seen, *stack, reached = 0;
    CHECK_OK(sb_domain_create(mesh, SB_INTEGRATION_PATCH, 0, NULL, &domain, NULL));
    CHECK_OK(sb_mesh_neighbours(mesh, NULL, &neighbours, NULL));
    c.patches = domain.patch_count;
    size = (int *)calloc((size_t)mesh->element_count, sizeof(int));
    seen = (int *)calloc((size_t)mesh->element_count, sizeof(int));
    stack = (int *)malloc((size_t)mesh->element_count * sizeof(int));
    for (int e = 0; e < mesh->element_count; e++)
        if (CHECK(domain.cell_patch[e] >= 0 && domain.cell_patch[e] < c.patches))
            size[domain.cell_patch[e]]++;
    for (int k = 0, next = 0; k < c.patches; k++, next = 0) { /* numbered by their first tets */
        int first = 0, top = 0, count = 0;
        while (domain.cell_patch[first] != k)
            first++;
        for (int e = 0; e < first; e++)
            next = domain.cell_patch[e] > next ? domain.cell_patch[e] : next;
        CHECK(k == 0 || next == k - 1);
        stack[top++] = first;
        seen[first] = 1;
        while (top > 0) {
            int e = stack[--top];
            count++;
            CHECK(!mesh->regions || mesh->regions[e] == mesh->regions[first]);
            for (int f = 0; f < 4; f++) {
                int other = neighbours.items[4 * e + f];
                if (other < 0 || seen[other] || domain.cell_patch[other] != k)
                    continue;
                seen[other] = 1;
                stack[top++] = other;
            }
        }
        CHECK_INT(count, size[k]);
        reached += count;
        c.least = size[k] < c.least ? size[k] : c.least;
        c.most = size[k] > c.most ? size[k] : c.most;
        c.odd += size[k] < 5 || size[k] > 10;
    }
    CHECK_INT(reached, mesh->element_count);
    CHECK(c.patches <= mesh->node_count); /* one equation for three unknowns */
    printf("  %s: %d tets, %d nodes, %d patches of %d to %d tets (mean %.1f), %d odd\n", name, mesh->element_count,
           mesh->node_count, c.patches, c.least, c.most, (double)mesh->element_count / c.patches, c.odd);
    free(size);
    free(seen);
    free(stack);
    sb_index_table_free(&neighbours);
    sb_domain_free(&domain);
    return c;
}

static void test_patches(void)
{
    static const char *const organs[] = {"liver1/coarse_tet4.vtk", "liver2/coarse_tet4.vtk"};
    sb_mesh mesh = scene_box(SB_TET4, 5, 4, 3, sb_v3(1, 1, 1), 0.2);
    census c = count_patches("cells of six", &mesh);
    CHECK(c.least == 6 && c.most == 6);
    sb_mesh_free(&mesh);
    for (int n = 1; n <= 6; n++)
        for (int whole = 0; whole < 2; whole++) {
            char name[80];
            mesh = mixed_box(n + 1, n, n > 2 ? n - 1 : 1, 0.25, whole);
            snprintf(name, sizeof name, "shuffled box %d, %s", n, whole ? "one region" : "two regions");
            c = count_patches(name, &mesh);
            CHECK(c.odd == 0 || (n == 1 && !whole && c.odd == 1)); /* a region of four tets is a patch of four */
            free_mixed(&mesh);
        }
    mesh = mixed_box(30, 20, 1, 0.2, 1); /* a sheet, and a rod */
    CHECK_INT(count_patches("sheet", &mesh).odd, 0);
    free_mixed(&mesh);
    mesh = mixed_box(60, 1, 1, 0.2, 1);
    CHECK_INT(count_patches("rod", &mesh).odd, 0);
    free_mixed(&mesh);
    for (int k = 0; k < 2; k++) {
        char path[512], file[200];
        snprintf(file, sizeof file, "data/insilico/%s", organs[k]);
        if (!check_shared_path(path, sizeof path, file))
            continue;
        CHECK_OK(sb_mesh_load(&mesh, path, NULL, NULL));
        CHECK_INT(count_patches(organs[k], &mesh).odd, 0);
        sb_mesh_free(&mesh);
    }
}

/* A tet alone, and two that share a node: patches of one. */
static void test_small_meshes(void)
{
    static sb_vec3 nodes[7] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {-1, 0, 0}, {0, -1, 0}, {0, 0, -1}};
    static int elements[8] = {0, 1, 2, 3, 0, 5, 4, 6};
    for (int count = 1; count <= 2; count++) {
        sb_mesh mesh;
        sb_body *body;
        memset(&mesh, 0, sizeof mesh);
        mesh.element_type = SB_TET4;
        mesh.nodes = nodes;
        mesh.node_count = 1 + 3 * count;
        mesh.elements = elements;
        mesh.element_count = count;
        CHECK_INT(count_patches("small", &mesh).patches, count);
        body = patched(&mesh, model_of(1, 0.4), 1);
        CHECK_INT(sb_body_patch_count(body), count);
        CHECK_INT(sb_body_patch(body, 0), 0);
        CHECK_INT(sb_body_patch(body, count), -1);
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        sb_body_destroy(body);
    }
    CHECK_INT(sb_body_patch_count(NULL), 0);
    CHECK_INT(sb_body_patch(NULL, 0), -1);
}

/* ---- energies and their derivatives ---- */

static sb_vec3 affine(sb_vec3 x, double growth)
{
    sb_mat3 r = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(REAL(0.2), REAL(-0.1), REAL(0.15))));
    sb_vec3 to = sb_v3(REAL(1 + growth) * x.x + REAL(0.04) * x.y, REAL(0.97) * x.y, x.z);
    return sb_v3_sub(sb_m3_apply(r, to), x);
}

/* In a homogeneous state patches are no different, of any model, strained at rest or relaxing: J = 1.01 and others. */
static void test_homogeneous(void)
{
    for (int whole = 0; whole < 2; whole++)
        for (int m = 0; m < MODELS; m++)
            for (int kind = 0; kind < 3; kind++) {
                const sb_real g[2] = {REAL(0.3), REAL(0.2)}, tau[2] = {REAL(0.02), REAL(0.4)};
                sb_mesh mesh = mixed_box(3, 2, 2, 0.2, whole);
                sb_vec3 *u = wobble(mesh.node_count, 0, 1);
                sb_material material = model_of(m, 0.45);
                sb_body *bodies[2];
                double energies[2];
                sb_mat3 stresses[2], swollen = sb_m3_scale(REAL(1.02), sb_m3_identity());
                if (kind == 1)
                    material = sb_material_with_prestretch(material, swollen);
                if (kind == 2)
                    material = sb_material_with_prony(material, g, tau, 2);
                if (kind && !sb_material_is_hyperelastic(material.model)) {
                    free(u);
                    free_mixed(&mesh);
                    continue;
                }
                for (int i = 0; i < mesh.node_count; i++)
                    u[i] = affine(mesh.nodes[i], 0.01 / 0.97 + 1 / 0.97 - 1);
                for (int k = 0; k < 2; k++) {
                    bodies[k] = patched(&mesh, material, k);
                    for (int i = 0; kind == 2 && i < mesh.node_count; i++)
                        CHECK_OK(sb_body_prescribe(bodies[k], &i, 1, SB_XYZ, &u[i], 1));
                    for (int s = 0; kind == 2 && s < 3; s++)
                        CHECK_OK(sb_body_step(bodies[k], REAL(0.05), NULL));
                    energies[k] = energy_at(bodies[k], u);
                    CHECK_OK(sb_body_stress(bodies[k], 1, 0, &stresses[k]));
                }
                if (!CHECK_NEAR(energies[1] / energies[0], 1, scene_tolerance(1e-10, 1e5)))
                    printf("  model %d, kind %d\n", m, kind);
                CHECK_NEAR(sb_von_mises(sb_m3_sub(stresses[0], stresses[1])) / sb_von_mises(stresses[0]), 0,
                           scene_tolerance(1e-10, 1e5));
                for (int k = 0; k < 2; k++)
                    sb_body_destroy(bodies[k]);
                free(u);
                free_mixed(&mesh);
            }
}

/* Forces are the energy's slope, exact tangents the forces'; the elements' energies sum to the body's. */
static void derivative(int m, int prestretched)
{
    const double h = SB_REAL_IS_FLOAT ? 4e-3 : 1e-5;
    sb_mesh mesh = mixed_box(3, 2, 2, 0.2, 0);
    int n = mesh.node_count;
    sb_vec3 *u = wobble(n, 0.006, 3), *way = wobble(n, 0.1, 5), *at = wobble(n, 0, 1), *force = wobble(n, 0, 1);
    sb_vec3 *sides[2], *product = wobble(n, 0, 1);
    sb_real *densities = (sb_real *)malloc((size_t)mesh.element_count * sizeof(sb_real));
    sb_material material = model_of(m, 0.45);
    double slope, work = 0, most = 0, off = 0, sum = 0, energy;
    sb_body *body;
    if (prestretched)
        material = sb_material_with_prestretch(
            material, sb_m3_columns(sb_v3(REAL(1.05), REAL(0.02), 0), sb_v3(0, REAL(0.97), 0), sb_v3(0, 0, 1)));
    body = patched(&mesh, material, 1);
    for (int k = 0; k < 2; k++) {
        sides[k] = wobble(n, 0, 1);
        for (int i = 0; i < n; i++)
            at[i] = sb_v3_madd(u[i], REAL(k ? h : -h), way[i]);
        forces_at(body, at, sides[k]);
    }
    slope = energy_at(body, at);
    for (int i = 0; i < n; i++)
        at[i] = sb_v3_madd(u[i], REAL(-h), way[i]);
    slope = (slope - energy_at(body, at)) / (2 * h);
    forces_at(body, u, force);
    CHECK_OK(sb_body_multiply_tangent(body, SB_TANGENT_EXACT, way, product, NULL));
    for (int i = 0; i < n; i++) {
        sb_vec3 d = sb_v3_sub(sb_v3_scale(REAL(1 / (2 * h)), sb_v3_sub(sides[1][i], sides[0][i])), product[i]);
        work += (double)sb_v3_dot(force[i], way[i]);
        most = fmax(most, (double)sb_v3_norm(product[i]));
        off = fmax(off, (double)sb_v3_norm(d));
    }
    CHECK_NEAR(slope / work, 1, SB_REAL_IS_FLOAT ? 2e-2 : 1e-6);
    CHECK_NEAR(off / most, 0, SB_REAL_IS_FLOAT ? 2e-2 : 1e-6);
    energy = energy_at(body, u);
    CHECK_OK(sb_body_energy_densities(body, densities, NULL));
    for (int e = 0; e < mesh.element_count; e++)
        sum += (double)(densities[e] * sb_mesh_element_volume(&mesh, e));
    CHECK_NEAR(sum / energy, 1, scene_tolerance(1e-10, 1e4));
    /* the semidefinite one is, and products without a matrix are those with one */
    for (int kind = SB_TANGENT_SPD; kind <= SB_TANGENT_QUASI; kind++) {
        const sb_matrix *matrix;
        double quadratic = 0;
        CHECK_OK(sb_body_multiply_tangent(body, (sb_tangent_kind)kind, way, product, NULL));
        CHECK_OK(sb_body_stiffness_matrix(body, (sb_tangent_kind)kind, &matrix, NULL));
        sb_matrix_multiply(matrix, &way[0].x, &at[0].x, NULL);
        most = off = 0;
        for (int i = 0; i < n; i++) {
            quadratic += (double)sb_v3_dot(way[i], product[i]);
            most = fmax(most, (double)sb_v3_norm(product[i]));
            off = fmax(off, (double)sb_v3_norm(sb_v3_sub(product[i], at[i])));
        }
        CHECK(quadratic > 0);
        CHECK_NEAR(off / most, 0, scene_tolerance(1e-12, 1e3));
    }
    sb_body_destroy(body);
    free(sides[0]);
    free(sides[1]);
    free(u);
    free(way);
    free(at);
    free(force);
    free(product);
    free(densities);
    free_mixed(&mesh);
}

static void test_derivatives(void)
{
    for (int m = 0; m < MODELS; m++) {
        derivative(m, 0);
        if (sb_material_is_hyperelastic(model_of(m, 0.3).model))
            derivative(m, 1);
    }
}

/* ---- what a body does ---- */

/* A cantilever of two regions, one nearly incompressible, that swings; with another material for a region on the way,
 * kept tangents and a state taken and given back. */
static unsigned long long play(int workers, int model, double angle, int reload)
{
    sb_mesh mesh = mixed_box(8, 4, 3, 0.2, 0);
    sb_body_def def = sb_default_body_def();
    sb_material soft = model_of(model, 0.49), other = model_of(model, 0.4);
    unsigned long long hash;
    sb_body *body;
    def.mesh = &mesh;
    def.material = soft;
    def.integration = SB_INTEGRATION_PATCH;
    def.gravity = sb_v3(0, 0, REAL(-3));
    def.damping_stiffness = REAL(0.01);
    def.jobs = scene_jobs(&workers);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    if (angle > 0)
        CHECK_OK(sb_body_keep_tangent(body, REAL(angle), NULL));
    for (int s = 0; s < 12; s++) {
        if (s == 5)
            CHECK_OK(sb_body_set_region_material(body, 7, &other, NULL));
        if (s == 8 && reload) {
            size_t size = sb_body_state_size(body);
            void *state = malloc(size);
            CHECK_OK(sb_body_state_save(body, state, size));
            for (int k = 0; k < 3; k++)
                CHECK_OK(sb_body_step(body, REAL(0.02), NULL));
            CHECK_OK(sb_body_state_load(body, state, size, NULL));
            free(state);
        }
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    }
    CHECK(scene_all_finite(sb_body_positions(body), mesh.node_count));
    hash = scene_hash(sb_body_displacements(body), (size_t)mesh.node_count * sizeof(sb_vec3));
    sb_body_destroy(body);
    free_mixed(&mesh);
    return hash;
}

static void test_same_bits(void)
{
    static const int models[3] = {1, 4, 6};
    for (int k = 0; k < 3; k++)
        for (int keeps = 0; keeps < (k == 0 ? 2 : 1); keeps++) {
            unsigned long long expected = play(1, models[k], 0.1 * keeps, 0);
            CHECK(play(2, models[k], 0.1 * keeps, 0) == expected);
            CHECK(play(5, models[k], 0.1 * keeps, 0) == expected);
            CHECK(play(1, models[k], 0.1 * keeps, 1) == expected);
        }
}

/* A state says what it is of. */
static void test_states_are_told_apart(void)
{
    sb_mesh mesh = mixed_box(3, 2, 2, 0.2, 1);
    sb_body *plain = patched(&mesh, model_of(1, 0.4), 0), *other = patched(&mesh, model_of(1, 0.4), 1);
    size_t size = sb_body_state_size(other);
    void *state = malloc(size);
    sb_error error;
    CHECK_OK(sb_body_state_save(other, state, size));
    CHECK_OK(sb_body_state_load(other, state, size, NULL));
    CHECK_RESULT(sb_body_state_load(plain, state, size, &error), SB_ERROR_STATE);
    free(state);
    sb_body_destroy(plain);
    sb_body_destroy(other);
    free_mixed(&mesh);
}

/* A domain made first gives the same body; others are refused. */
static void test_domains(void)
{
    sb_mesh mesh = mixed_box(3, 2, 2, 0.2, 0), hex = scene_box(SB_HEX8, 2, 1, 1, sb_v3(1, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    sb_vec3 *u = wobble(mesh.node_count, 0.005, 3);
    sb_domain domain;
    sb_body *body = patched(&mesh, model_of(4, 0.45), 1), *same = NULL;
    sb_error error;
    double energy = energy_at(body, u);
    int kept;
    CHECK_OK(sb_domain_create(&mesh, SB_INTEGRATION_PATCH, 0, NULL, &domain, NULL));
    def.mesh = &mesh;
    def.material = model_of(4, 0.45);
    def.domain = &domain;
    same = scene_body(&def);
    CHECK(energy_at(same, u) == energy);
    sb_body_destroy(same);
    same = NULL;
    kept = domain.cell_patch[5];
    domain.cell_patch[5] = domain.patch_count;
    CHECK_RESULT(sb_body_create(&def, &same, &error), SB_ERROR_INDEX);
    CHECK_INT(error.element, 5);
    domain.cell_patch[5] = kept;
    for (int e = 0; e < mesh.element_count; e++)
        if (mesh.regions[e] != mesh.regions[5])
            domain.cell_patch[e] = kept;
    CHECK_RESULT(sb_body_create(&def, &same, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "another region") != NULL);
    domain.patch_count = 0;
    CHECK_RESULT(sb_body_create(&def, &same, &error), SB_ERROR_ARGUMENT);
    sb_domain_free(&domain);
    CHECK_RESULT(sb_domain_create(&hex, SB_INTEGRATION_PATCH, 0, NULL, &domain, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "is for tet4") != NULL);
    sb_body_destroy(body);
    free(u);
    sb_mesh_free(&hex);
    free_mixed(&mesh);
}

/* ---- a mesh that changes ---- */

static int shared_nodes(const int *a, const int *b)
{
    int shared = 0;
    for (int i = 0; i < 16; i++)
        shared += a[i / 4] == b[i % 4];
    return shared;
}

/* Cells in use are in patches that are connected by faces, others in none; how many patches have less than 5. */
static int check_live_patches(const sb_body *body)
{
    int cells = sb_body_element_count(body), patches = sb_body_patch_count(body), small = 0;
    int *stack = (int *)malloc((size_t)cells * sizeof(int)), *seen = (int *)calloc((size_t)cells, sizeof(int));
    for (int e = 0; e < cells; e++)
        CHECK((sb_body_patch(body, e) >= 0) == sb_body_cell_in_use(body, e));
    for (int k = 0; k < patches; k++) {
        int size = 0, top = 0, reached = 0;
        for (int e = 0; e < cells; e++) {
            if (sb_body_patch(body, e) != k)
                continue;
            if (size++ == 0) {
                stack[top++] = e;
                seen[e] = 1;
            }
        }
        while (top > 0) {
            int e = stack[--top];
            reached++;
            for (int other = 0; other < cells; other++)
                if (!seen[other] && sb_body_patch(body, other) == k &&
                    shared_nodes(sb_body_cell_nodes(body, e), sb_body_cell_nodes(body, other)) == 3) {
                    seen[other] = 1;
                    stack[top++] = other;
                }
        }
        CHECK(size > 0);
        CHECK_INT(reached, size);
        small += size < 5;
    }
    free(stack);
    free(seen);
    return small;
}

static unsigned long long steps(sb_body *body, int count)
{
    for (int s = 0; s < count; s++)
        if (!CHECK_OK(sb_body_step(body, REAL(0.01), NULL)))
            break;
    CHECK(scene_all_finite(sb_body_positions(body), sb_body_node_count(body)));
    return scene_hash(sb_body_displacements(body), (size_t)sb_body_node_count(body) * sizeof(sb_vec3));
}

/* A beam of two regions, cut half through by a blade in frames while it swings: patches end at the cut, those far from
 * it stay, a state from amid the cut gives the same bits, also in a body that was never cut. */
static void cut_and_swing(int model, int lattice)
{
    sb_mesh mesh = mixed_box(8, 4, 4, 0.2, 0);
    sb_body_def def = sb_default_body_def();
    sb_cut_def cut_def = sb_default_cut_def();
    sb_body *body, *other;
    sb_cut *cut, *other_cut;
    sb_vec3 edge[2];
    void *state;
    size_t size;
    unsigned long long expected;
    int stroke = -1, before, small;
    sb_error error;
    def.mesh = &mesh;
    def.material = model_of(model, 0.49);
    def.integration = SB_INTEGRATION_PATCH;
    def.gravity = sb_v3(0, 0, REAL(-3));
    def.damping_stiffness = REAL(0.01);
    def.slack = 2;
    body = scene_body(&def);
    other = scene_body(&def);
    before = sb_body_patch_count(body);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    scene_fix_plane(other, &mesh, 0, 0, SB_XYZ);
    cut_def.body = body;
    cut_def.lattice = lattice;
    CHECK_OK(sb_cut_create(&cut_def, &cut, &error));
    cut_def.body = other;
    CHECK_OK(sb_cut_create(&cut_def, &other_cut, &error));
    for (int i = 0; i < 6; i++) {
        double z = 0.21 - 0.025 * i;
        edge[0] = sb_v3(REAL(0.1871), REAL(-0.05), REAL(z));
        edge[1] = sb_v3(REAL(0.2013), REAL(0.35), REAL(z));
        if (i == 0)
            CHECK_OK(sb_cut_begin(cut, edge, 2, &stroke, &error));
        else if (!CHECK_OK(sb_cut_move(cut, stroke, edge, NULL, &error)))
            printf("%s\n", error.message);
        steps(body, 2);
    }
    sb_cut_end(cut, stroke);
    small = check_live_patches(body);
    printf("  cut, model %d, lattice %d: %d patches became %d, %d of them with less than 5 tets\n", model, lattice,
           before, sb_body_patch_count(body), small);
    CHECK(sb_body_patch_count(body) > before);
    CHECK(small <= 8);
    size = sb_body_state_size(body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(body, state, size));
    expected = steps(body, 4);
    CHECK_OK(sb_body_state_load(body, state, size, &error));
    CHECK(steps(body, 4) == expected);
    if (!CHECK_OK(sb_body_state_load(other, state, size, &error)))
        printf("%s\n", error.message);
    CHECK_INT(check_live_patches(other), small);
    CHECK(steps(other, 4) == expected);
    free(state);
    sb_cut_destroy(cut);
    sb_cut_destroy(other_cut);
    sb_body_destroy(body);
    sb_body_destroy(other);
    free_mixed(&mesh);
}

static void test_cut(void)
{
    cut_and_swing(1, 2);
    cut_and_swing(1, 1);
    cut_and_swing(6, 2);
}

/* Cells are taken out and made again, at random, to the last but a few. */
static void test_changes(void)
{
    sb_mesh mesh = mixed_box(4, 3, 3, 0.2, 0);
    sb_body_def def = sb_default_body_def();
    unsigned long long seed = 41;
    sb_body *body;
    def.mesh = &mesh;
    def.material = model_of(1, 0.49);
    def.integration = SB_INTEGRATION_PATCH;
    def.gravity = sb_v3(0, 0, REAL(-3));
    def.slack = 1;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int round = 0; round < 12; round++) {
        sb_body_change *change;
        sb_error error;
        int removed = 0, result;
        CHECK_OK(sb_body_change_begin(body, &change, &error));
        for (int e = 0; e < sb_body_element_count(body); e++)
            if (sb_body_cell_in_use(body, e) && check_random(&seed) < 0.04 && removed++ < 12)
                CHECK_OK(sb_body_change_remove_cell(change, e, &error));
        result = sb_body_change_commit(change, &error);
        if (result != SB_OK) { /* it would leave a node alone */
            sb_body_change_cancel(change);
            continue;
        }
        check_live_patches(body);
        steps(body, 1);
    }
    sb_body_destroy(body);
    free_mixed(&mesh);
}

/* Each allocation fails in turn. */
static void test_memory(void)
{
    sb_mesh mesh = mixed_box(2, 2, 1, 0.2, 0);
    sb_body_def def = sb_default_body_def();
    scene_memory memory;
    sb_result result = SB_ERROR_MEMORY;
    def.mesh = &mesh;
    def.material = model_of(1, 0.45);
    def.integration = SB_INTEGRATION_PATCH;
    memset(&memory, 0, sizeof memory);
    for (int k = 1; k < 200 && result == SB_ERROR_MEMORY; k++) {
        sb_body *body = NULL;
        memset(&memory, 0, sizeof memory);
        memory.fail_at = k;
        def.allocator = scene_allocator(&memory);
        result = sb_body_create(&def, &body, NULL);
        sb_body_destroy(body);
        CHECK_INT(memory.live, 0);
    }
    CHECK_OK(result);
    free_mixed(&mesh);
}

CHECK_SUITE(patch, {"patches", test_patches}, {"small meshes", test_small_meshes}, {"homogeneous", test_homogeneous},
            {"derivatives", test_derivatives}, {"same bits", test_same_bits},
            {"states are told apart", test_states_are_told_apart}, {"domains", test_domains}, {"memory", test_memory},
            {"cut", test_cut}, {"changes", test_changes});
