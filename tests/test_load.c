/* Loads: pressures, springs and mappings against closed forms, finite differences and balances; failures. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

static const sb_element_type element_types[] = {SB_TET4, SB_TET10, SB_HEX8};
enum { ELEMENT_TYPES = 3 };
/* One for every type of face. */
static const sb_element_type face_elements[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
enum { FACE_ELEMENTS = (int)(sizeof face_elements / sizeof face_elements[0]) };

/* Corners of the boundary faces whose nodes all have coordinate `axis` within rounding of `value` (axis < 0: all
 * faces). The caller frees the list. */
static int *boundary_faces(const sb_mesh *mesh, int axis, double value, int *count, int *corners)
{
    sb_boundary boundary;
    int *faces, nodes;
    *count = 0;
    if (!CHECK_OK(sb_mesh_boundary(mesh, 0, NULL, &boundary, NULL)))
        return NULL;
    *corners = sb_element_corner_count(boundary.surface.element_type);
    nodes = sb_element_node_count(boundary.surface.element_type);
    faces = (int *)malloc((size_t)(boundary.surface.element_count * *corners) * sizeof(int));
    for (int f = 0; f < boundary.surface.element_count; f++) {
        const int *face = boundary.surface.elements + f * nodes;
        int in = 1;
        for (int c = 0; c < nodes && axis >= 0; c++)
            in &= fabs((double)scene_component(mesh->nodes[face[c]], axis) - value) < 1e-6;
        for (int c = 0; c < *corners && in; c++)
            faces[*count * *corners + c] = face[c];
        *count += in;
    }
    sb_boundary_free(&boundary);
    return faces;
}

/* Adds a pressure on such faces; the id. */
static int add_pressure(sb_body *body, const sb_mesh *mesh, int axis, double value, double pressure)
{
    int count, corners, id = 0;
    int *faces = boundary_faces(mesh, axis, value, &count, &corners);
    sb_error error;
    CHECK(count > 0);
    if (!CHECK_OK(sb_body_add_pressure(body, faces, count, corners, REAL(pressure), &id, &error)))
        printf("%s\n", error.message);
    free(faces);
    return id;
}

static int nearest_node(const sb_mesh *mesh, sb_vec3 x)
{
    int best = 0;
    for (int i = 0; i < mesh->node_count; i++)
        if (sb_v3_norm(sb_v3_sub(mesh->nodes[i], x)) < sb_v3_norm(sb_v3_sub(mesh->nodes[best], x)))
            best = i;
    return best;
}

static sb_body *make_body(const sb_mesh *mesh, sb_material material, sb_body_def *def)
{
    *def = sb_default_body_def();
    def->mesh = mesh;
    def->material = material;
    return scene_body(def);
}

/* ---- pressure: force ---- */

/* Volume of the mesh with its nodes at x, integrated exactly. */
static double volume_at(const sb_mesh *mesh, const sb_vec3 *x)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_real gradient[SB_MAX_ELEMENT_NODES][3];
    int n = sb_element_node_count(mesh->element_type);
    int q = sb_element_quadrature(mesh->element_type, SB_QUADRATURE_MASS, points, weights);
    double volume = 0;
    for (int e = 0; e < mesh->element_count; e++)
        for (int p = 0; p < q; p++) {
            double j[3][3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
            sb_element_shape(mesh->element_type, points[p], NULL, gradient);
            for (int a = 0; a < n; a++)
                for (int i = 0; i < 3; i++)
                    for (int k = 0; k < 3; k++)
                        j[i][k] += (double)scene_component(x[mesh->elements[e * n + a]], i) * (double)gradient[a][k];
            volume += (double)weights[p] * (j[0][0] * (j[1][1] * j[2][2] - j[1][2] * j[2][1]) -
                                            j[0][1] * (j[1][0] * j[2][2] - j[1][2] * j[2][0]) +
                                            j[0][2] * (j[1][0] * j[2][1] - j[1][1] * j[2][0]));
        }
    return volume;
}

/* On a closed surface the forces are those of the energy p V: f = -p dV/dx, at any shape. */
static void test_pressure_is_the_volume_gradient(void)
{
    for (int t = 0; t < FACE_ELEMENTS; t++) {
        sb_mesh mesh = scene_box(face_elements[t], 2, 2, 2, sb_v3(1, 1, 1), 0.1);
        sb_body_def def;
        sb_body *body = make_body(&mesh, sb_material_linear(1000, REAL(0.3), 1000), &def);
        sb_vec3 *u = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3)), sum, torque;
        sb_vec3 *x = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
        unsigned long long seed = 5;
        int id = add_pressure(body, &mesh, -1, 0, 3);
        double h = 1e-3;
        for (int i = 0; i < mesh.node_count; i++) {
            u[i] = sb_v3(REAL(check_random_in(&seed, -0.1, 0.1)), REAL(check_random_in(&seed, -0.1, 0.1)),
                         REAL(check_random_in(&seed, -0.1, 0.1)));
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u[i], 1));
        }
        CHECK_OK(sb_body_solve_static(body, NULL, NULL));
        memcpy(x, sb_body_positions(body), (size_t)mesh.node_count * sizeof(sb_vec3));
        for (int i = 0; i < mesh.node_count; i += 3)
            for (int axis = 0; axis < 3; axis++) {
                double up, down;
                sb_vec3 kept = x[i], e = sb_v3(axis == 0, axis == 1, axis == 2);
                x[i] = sb_v3_madd(kept, REAL(h), e);
                up = volume_at(&mesh, x);
                x[i] = sb_v3_madd(kept, REAL(-h), e);
                down = volume_at(&mesh, x);
                x[i] = kept; /* V is linear in each coordinate: the difference is exact but for rounding */
                CHECK_NEAR(scene_component(sb_body_external_forces(body)[i], axis), -3 * (up - down) / (2 * h),
                           scene_tolerance(1e-11, 2e4));
            }
        CHECK_OK(sb_body_load_force(body, id, sb_v3(1, 2, 3), &sum, &torque));
        CHECK_NEAR(sb_v3_norm(sum), 0, scene_tolerance(1e-14, 100)); /* a closed surface: no net force, no torque */
        CHECK_NEAR(sb_v3_norm(torque), 0, scene_tolerance(1e-14, 500));
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(u);
        free(x);
    }
}

/* A face turned with its body: the force turns with it, and grows with its area. */
static void test_pressure_follows(void)
{
    for (int t = 0; t < FACE_ELEMENTS; t++) {
        sb_mesh mesh = scene_box(face_elements[t], 2, 2, 2, sb_v3(1, 1, 1), 0);
        sb_body_def def;
        sb_body *body = make_body(&mesh, sb_material_corotated(1000, REAL(0.3), 1000), &def);
        sb_vec3 force, torque, traction = sb_v3(0, 0, 5);
        int id = add_pressure(body, &mesh, 0, 1, 7), count, corners;
        int *faces = boundary_faces(&mesh, 1, 1, &count, &corners);
        CHECK_OK(sb_body_add_traction(body, faces, count, corners, traction, NULL));
        for (int i = 0; i < mesh.node_count; i++) { /* x -> (-2 y, x, z): a quarter turn about z, y doubled */
            sb_vec3 x = mesh.nodes[i], u = sb_v3(-2 * x.y - x.x, x.x - x.y, 0);
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
        }
        CHECK_OK(sb_body_solve_static(body, NULL, NULL));
        CHECK_OK(sb_body_load_force(body, id, sb_v3(-1, 1, REAL(0.5)), &force, &torque));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(force, sb_v3(0, -14, 0))), 0, scene_tolerance(1e-12, 200));
        CHECK_NEAR(sb_v3_norm(torque), 0, scene_tolerance(1e-12, 500)); /* about the face's centre */
        CHECK_OK(sb_body_load_force(body, id, sb_v3(0, 1, REAL(0.5)), NULL, &torque));
        CHECK_NEAR(torque.z, 14, scene_tolerance(1e-12, 500)); /* arm (-1, 0, 0) x (0, -14, 0) */
        force = scene_sum(sb_body_external_forces(body), mesh.node_count);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(force, sb_v3(0, -14, 5))), 0, scene_tolerance(1e-12, 200));
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(faces);
    }
}

/* ---- pressure: tangent ---- */

/* Newton iterations of a soft cube on a closed surface of pressure, held by springs, to a tolerance. */
static int pressure_iterations(sb_element_type type, int open, unsigned long long seed, double tolerance)
{
    sb_mesh mesh = scene_box(type, 2, 2, 2, sb_v3(1, 1, 1), 0.1);
    sb_body_def def;
    sb_body *body = make_body(&mesh, sb_material_neo_hookean(1000, REAL(0.3), 1000), &def);
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    options.tolerance = REAL(tolerance);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    add_pressure(body, &mesh, open ? 1 : -1, 1, open ? 20 : 300);
    for (int i = 0; i < mesh.node_count; i++) {
        double x = check_random_in(&seed, -5, 5), y = check_random_in(&seed, -5, 5);
        sb_vec3 force = sb_v3(REAL(x), REAL(y), 0);
        CHECK_OK(sb_body_add_forces(body, &i, 1, &force, 1));
    }
    CHECK_OK(sb_body_solve_static(body, &options, &info));
    CHECK_INT(info.load_steps, 1);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return info.newton_iterations;
}

/* With the exact tangent the digits double in each iteration: eight more digits cost two or three; a tangent that
 * lacks a term gains a fixed number of digits each time. An open patch lacks its rim's term and may take more. */
static void test_pressure_tangent(void)
{
    int most = 0, sum = 0, count = 0;
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("float cannot show quadratic convergence");
        return;
    }
    for (int t = 0; t < FACE_ELEMENTS; t++)
        for (unsigned long long seed = 9; seed < (check_quick() ? 11 : 29); seed++) {
            int rough = pressure_iterations(face_elements[t], 0, seed, 1e-4),
                fine = pressure_iterations(face_elements[t], 0, seed, 1e-12);
            CHECK(fine - rough <= 3);
            CHECK(fine <= 9);
            most = fine - rough > most ? fine - rough : most;
            sum += fine - rough;
            count++;
            CHECK(pressure_iterations(face_elements[t], 1, seed, 1e-10) <= 12);
        }
    printf("  pressure: eight digits take %.2f iterations in the mean, %d at most\n", (double)sum / count, most);
    CHECK(sum <= 2.5 * count);
}

/* ---- pressure: closed forms ---- */

/* A quarter of a thick cylinder, radii 1 and 2 m, one layer of 0.25 m: the box mapped to polar coordinates. */
static sb_mesh quarter_tube(sb_element_type type, int cells)
{
    sb_mesh mesh = scene_box(type, cells, 2 * cells, 1, sb_v3(1, 1, REAL(0.25)), 0);
    for (int i = 0; i < mesh.node_count; i++) {
        double r = 1 + (double)mesh.nodes[i].x, angle = 1.57079632679489662 * (double)mesh.nodes[i].y;
        mesh.nodes[i].x = REAL(r * cos(angle));
        mesh.nodes[i].y = REAL(r * sin(angle));
    }
    return mesh;
}

/* Lists the boundary faces with all corners at the given radius and presses on them. */
static int press_on_radius(sb_body *body, const sb_mesh *mesh, double radius, double pressure)
{
    int count, corners, kept = 0, id = 0;
    int *faces = boundary_faces(mesh, -1, 0, &count, &corners);
    for (int f = 0; f < count; f++) {
        int in = 1;
        for (int c = 0; c < corners; c++) {
            sb_vec3 x = mesh->nodes[faces[f * corners + c]];
            double z = mesh->element_count && body ? (double)x.z : 0, flat = (double)(x.x * x.x + x.y * x.y);
            in &= fabs(sqrt(flat) - radius) < 1e-5 || fabs(sqrt(flat + z * z) - radius) < 1e-5;
        }
        if (in)
            memmove(faces + corners * kept++, faces + corners * f, (size_t)corners * sizeof(int));
    }
    CHECK(kept > 0);
    CHECK_OK(sb_body_add_pressure(body, faces, kept, corners, REAL(pressure), &id, NULL));
    free(faces);
    return id;
}

/* Largest relative error of the radial displacement; Lame, plane strain. */
static double tube_error(sb_element_type type, int cells)
{
    sb_mesh mesh = quarter_tube(type, cells);
    double young = 1000, nu = 0.3, p = 1e-6 * young, worst = 0, scale = 0;
    sb_body_def def;
    sb_body *body = make_body(&mesh, sb_material_linear(REAL(young), REAL(nu), 1000), &def);
    sb_static_options options = sb_default_static_options();
    options.tolerance = REAL(1e-9);
    scene_fix_plane(body, &mesh, 0, 0, SB_X);
    scene_fix_plane(body, &mesh, 1, 0, SB_Y);
    scene_fix_plane(body, &mesh, 2, 0, SB_Z);
    scene_fix_plane(body, &mesh, 2, 0.25, SB_Z);
    press_on_radius(body, &mesh, 1, p);
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 x = mesh.nodes[i], u = sb_body_displacements(body)[i];
        double r = sqrt((double)(x.x * x.x + x.y * x.y));
        double exact = (1 + nu) / young * p / (4 - 1) * ((1 - 2 * nu) * r + 4 / r);
        double got = (double)(u.x * x.x + u.y * x.y) / r;
        worst = fmax(worst, fabs(got - exact));
        scale = fmax(scale, exact);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return worst / scale;
}

static void test_thick_tube(void)
{
    double coarse = tube_error(SB_HEX8, 4), fine = tube_error(SB_HEX8, 8);
    CHECK(fine < 5e-3);
    CHECK_NEAR(log(coarse / fine) / log(2.0), 2, 0.3);
    coarse = tube_error(SB_TET10, 2);
    fine = tube_error(SB_TET10, 4);
    CHECK(fine < 2e-3);
    CHECK(log(coarse / fine) / log(2.0) > 2.5);
    CHECK(tube_error(SB_TET4, 6) < tube_error(SB_TET4, 3));
}

/* An eighth of a thick sphere, radii 1 and 1.5 m: the outer lattice of a cube of n cells blown up to a sphere, times
 * `layers`. */
static sb_mesh eighth_shell(int n, int layers)
{
    int side = n + 1, total = side * side * side, count = 0, e = 0;
    int *number = (int *)malloc((size_t)total * sizeof(int));
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    for (int p = 0; p < total; p++) {
        int i = p % side, j = p / side % side, k = p / side / side;
        number[p] = i == n || j == n || k == n ? count++ : -1;
    }
    mesh.element_type = SB_HEX8;
    mesh.node_count = count * (layers + 1);
    mesh.element_count = 3 * n * n * layers;
    mesh.nodes = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
    mesh.elements = (int *)malloc((size_t)mesh.element_count * 8 * sizeof(int));
    for (int p = 0; p < total; p++) {
        double d[3], norm;
        if (number[p] < 0)
            continue;
        for (int k = 0, at = p; k < 3; k++, at /= side)
            d[k] = tan(0.78539816339744831 * (double)(at % side) / n);
        norm = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        for (int l = 0; l <= layers; l++) {
            double r = (1 + 0.5 * l / layers) / norm;
            mesh.nodes[l * count + number[p]] = sb_v3(REAL(r * d[0]), REAL(r * d[1]), REAL(r * d[2]));
        }
    }
    for (int face = 0; face < 3; face++)
        for (int cell = 0; cell < n * n; cell++)
            for (int l = 0; l < layers; l++, e++)
                for (int c = 0; c < 4; c++) {
                    static const int corner[4][2] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
                    int at[3], p;
                    at[face] = n;
                    at[(face + 1) % 3] = cell % n + corner[c][0];
                    at[(face + 2) % 3] = cell / n + corner[c][1];
                    p = at[0] + side * (at[1] + side * at[2]);
                    mesh.elements[8 * e + c] = l * count + number[p];
                    mesh.elements[8 * e + 4 + c] = (l + 1) * count + number[p];
                }
    free(number);
    return mesh;
}

/* Radial and hoop stress P of the neo-Hookean sphere. */
static double radial_stress(double mu, double lambda, double stretch, double hoop)
{
    return mu * (stretch - 1 / stretch) + lambda * log(stretch * hoop * hoop) / stretch;
}

/* Radial stress at the outer radius when the inner one is at `inside` and has the radial stretch s: Runge-Kutta on
 * d(P_r)/dR = -2 (P_r - P_h) / R, dr/dR = stretch. */
static double shoot(double mu, double lambda, double inside, double s)
{
    double y[2] = {inside, radial_stress(mu, lambda, s, inside)}, h = 0.5 / 200;
    for (int step = 0; step < 200; step++) {
        double k[4][2], radius = 1 + h * step;
        for (int stage = 0; stage < 4; stage++) {
            double c = stage == 0 ? 0 : stage == 3 ? 1 : 0.5, at = radius + c * h;
            double r = y[0] + (stage ? c * h * k[stage - 1][0] : 0), p = y[1] + (stage ? c * h * k[stage - 1][1] : 0);
            double hoop = r / at;
            for (int i = 0; i < 30; i++) { /* the stretch that has this stress */
                double slope = mu * (1 + 1 / (s * s)) + lambda * (1 - log(s * hoop * hoop)) / (s * s);
                s -= (radial_stress(mu, lambda, s, hoop) - p) / slope;
            }
            k[stage][0] = s;
            k[stage][1] = -2 / at * (p - (mu * (hoop - 1 / hoop) + lambda * log(s * hoop * hoop) / hoop));
        }
        for (int i = 0; i < 2; i++)
            y[i] += h / 6 * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]);
    }
    return y[1];
}

/* Inflates the shell to the pressure at which its inside should stand at 1.3 m; the error of that radius. */
static double shell_error(int n, int layers, double mu, double lambda, double pressure)
{
    sb_mesh mesh = eighth_shell(n, layers);
    double worst = 0;
    sb_body_def def;
    sb_body *body = make_body(&mesh, sb_material_neo_hookean(1000, REAL(0.3), 1000), &def);
    sb_step_info info;
    CHECK_NEAR(mu + lambda, 1000 / 2.6 + 300 / (1.3 * 0.4), 1e-9);
    for (int axis = 0; axis < 3; axis++)
        scene_fix_plane(body, &mesh, axis, 0, 1 << axis);
    press_on_radius(body, &mesh, 1, pressure);
    if (!CHECK_OK(sb_body_solve_static(body, NULL, &info)))
        printf("%s\n", info.error.message);
    for (int i = 0; i < mesh.node_count; i++)
        if (sb_v3_norm(mesh.nodes[i]) < REAL(1.0001))
            worst = fmax(worst, fabs((double)sb_v3_norm(sb_body_positions(body)[i]) - 1.3));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return worst;
}

static void test_inflated_sphere(void)
{
    double mu = 1000 / 2.6, lambda = 300 / (1.3 * 0.4), low = 0.3, high = 1, coarse, fine, pressure;
    for (int i = 0; i < 60; i++) { /* P_r at the outside grows with the stretch inside */
        double middle = 0.5 * (low + high);
        if (shoot(mu, lambda, 1.3, middle) > 0)
            high = middle;
        else
            low = middle;
    }
    pressure = -radial_stress(mu, lambda, low, 1.3) / (1.3 * 1.3);
    CHECK(pressure > 50 && pressure < 500);
    coarse = shell_error(3, 2, mu, lambda, pressure);
    fine = shell_error(6, 4, mu, lambda, pressure);
    CHECK(fine < 0.01);
    CHECK_NEAR(log(coarse / fine) / log(2.0), 2, 0.5);
}

/* ---- springs ---- */

/* One hex8 cube of 1 m and 1000 kg, each corner on a spring: it moves as one mass. */
static sb_body *cube_on_springs(sb_mesh *mesh, sb_body_def *def, double stiffness, int *id)
{
    int nodes[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    sb_real k = REAL(stiffness);
    sb_body *body;
    *mesh = scene_box(SB_HEX8, 1, 1, 1, sb_v3(1, 1, 1), 0);
    def->mesh = mesh;
    body = scene_body(def);
    CHECK_OK(sb_body_add_springs(body, nodes, 8, &k, 1, mesh->nodes, id, NULL));
    return body;
}

static void test_spring_statics(void)
{
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_mesh mesh;
    int id = 0;
    sb_body *body;
    sb_vec3 forces[8], points[8], force;
    sb_energy energy;
    double drop = 1000 * 9.81 / (8 * 5000.0);
    def.material = sb_material_neo_hookean(100000, REAL(0.3), 1000);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    body = cube_on_springs(&mesh, &def, 5000, &id);
    options.tolerance = REAL(1e-12);
    CHECK_OK(sb_body_solve_static(body, &options, NULL)); /* held by springs alone */
    CHECK_OK(sb_body_spring_forces(body, id, forces));
    for (int i = 0; i < 8; i++) {
        CHECK_NEAR(sb_body_displacements(body)[i].z, -drop, scene_tolerance(1e-9, 100));
        CHECK_NEAR(forces[i].z, 5000 * (double)(mesh.nodes[i].z - sb_body_positions(body)[i].z),
                   scene_tolerance(1e-8, 1e5));
    }
    CHECK_OK(sb_body_load_force(body, id, sb_v3(0, 0, 0), &force, NULL));
    CHECK_NEAR(force.z, 9810, scene_tolerance(1e-6, 1e5));
    CHECK_NEAR(scene_sum(sb_body_external_forces(body), 8).z, 0, scene_tolerance(1e-6, 1e5));
    CHECK_OK(sb_body_energy(body, &energy));
    CHECK_NEAR(energy.springs, 8 * 0.5 * 5000 * drop * drop, scene_tolerance(1e-6, 1e5));
    for (int i = 0; i < 8; i++)
        points[i] = sb_v3_add(mesh.nodes[i], sb_v3(3, 0, REAL(drop)));
    CHECK_OK(sb_body_move_springs(body, id, points)); /* moves along, by its own length and more */
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int i = 0; i < 8; i++)
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_body_displacements(body)[i], sb_v3(3, 0, 0))), 0,
                   scene_tolerance(1e-9, 1000));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* A mass on springs swings with the frequency that average acceleration gives it: tan(w' dt / 2) = w dt / 2. */
static void test_spring_frequency(void)
{
    sb_body_def def = sb_default_body_def();
    sb_mesh mesh;
    sb_vec3 u[8];
    sb_energy energy;
    int id = 0;
    double omega = sqrt(8 * 5000.0 / 1000), dt = 0.02, numeric = 2 / dt * atan(omega * dt / 2);
    sb_body *body;
    def.material = sb_material_linear(100000, REAL(0.3), 1000);
    def.integrator = SB_NEWMARK;
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-6 : 1e-13);
    body = cube_on_springs(&mesh, &def, 5000, &id);
    for (int i = 0; i < 8; i++)
        u[i] = sb_v3(REAL(0.1), REAL(-0.05), 0);
    CHECK_OK(sb_body_set_displacements(body, u));
    for (int s = 1; s <= 200; s++) {
        CHECK_OK(sb_body_step(body, REAL(dt), NULL));
        CHECK_NEAR(sb_body_displacements(body)[3].x, 0.1 * cos(numeric * dt * s), scene_tolerance(1e-9, 1e4));
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_NEAR(energy.elastic + energy.kinetic + energy.springs, 8 * 0.5 * 5000 * 0.0125,
                   scene_tolerance(1e-6, 1e5));
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Each kind of step: momentum changes by what supports and loads exert; damping by K is the body's alone. */
static void test_momentum(void)
{
    for (int kind = 0; kind < 3; kind++) {
        sb_mesh mesh = scene_box(SB_TET4, 4, 2, 2, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0.1);
        sb_body_def def = sb_default_body_def();
        int nodes[2] = {4, 20}, id = 0;
        sb_real k[2] = {50, 5000};
        sb_vec3 points[2];
        sb_body *body;
        def.mesh = &mesh;
        def.material =
            kind == 2 ? sb_material_neo_hookean(5000, REAL(0.4), 1000) : sb_material_corotated(5000, REAL(0.4), 1000);
        def.integrator = SB_EULER;
        def.damping_stiffness = REAL(0.05);
        def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-12);
        def.newton_tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-12);
        def.max_newton = kind == 1 ? 30 : SB_AUTO;
        def.mass = kind == 1 ? SB_MASS_CONSISTENT : SB_MASS_LUMPED;
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        for (int i = 0; i < 2; i++)
            points[i] = sb_v3_add(mesh.nodes[nodes[i]], sb_v3(0, REAL(0.03), REAL(0.02)));
        CHECK_OK(sb_body_add_springs(body, nodes, 2, k, 0, points, &id, NULL));
        add_pressure(body, &mesh, 2, 0.1, 200);
        for (int s = 0; s < 20; s++) {
            sb_vec3 before = sb_body_momentum(body), rate, loads;
            points[1].z += REAL(0.001);
            CHECK_OK(sb_body_move_springs(body, id, points));
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            rate = sb_v3_scale(100, sb_v3_sub(sb_body_momentum(body), before));
            loads = sb_v3_add(scene_sum(sb_body_external_forces(body), mesh.node_count),
                              scene_sum(sb_body_reactions(body), mesh.node_count));
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(rate, loads)), 0, SB_REAL_IS_FLOAT ? 2e-2 : 1e-8);
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* Springs of any stiffness are safe in a linearised step of any length, and draw their nodes to the points. */
static void test_stiff_springs(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 4, 2, 2, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0);
    sb_body_def def = sb_default_body_def();
    int nodes[2], id = 0;
    sb_real k = REAL(1e9);
    sb_vec3 points[2];
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    def.damping_stiffness = REAL(0.01);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    nodes[0] = nearest_node(&mesh, sb_v3(REAL(0.2), 0, 0));
    nodes[1] = nearest_node(&mesh, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)));
    for (int i = 0; i < 2; i++)
        points[i] = mesh.nodes[nodes[i]];
    CHECK_OK(sb_body_add_springs(body, nodes, 2, &k, 1, points, &id, NULL));
    for (int s = 0; s < 100; s++) {
        for (int i = 0; i < 2; i++)
            points[i] = sb_v3_add(mesh.nodes[nodes[i]], sb_v3(0, REAL(0.03 * sin(0.3 * s)), REAL(0.02 * cos(0.5 * s))));
        CHECK_OK(sb_body_move_springs(body, id, points));
        CHECK_OK(sb_body_step(body, s % 2 ? REAL(0.1) : REAL(0.001), NULL));
        CHECK(scene_all_finite(sb_body_displacements(body), mesh.node_count));
        for (int i = 0; i < 2; i++)
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_body_positions(body)[nodes[i]], points[i])), 0, 1e-4);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- mappings ---- */

enum { ROWS = 5 };
typedef struct test_rows {
    sb_mapping mapping;
    int row_start[ROWS + 1], nodes[4 * ROWS];
    sb_real weights[4 * ROWS];
    sb_vec3 targets[ROWS];
} test_rows;

/* Points inside some tets, drawn away by up to `pull`. */
static void make_rows(const sb_mesh *mesh, double pull, test_rows *rows)
{
    unsigned long long seed = 17;
    int n = sb_element_node_count(mesh->element_type);
    for (int j = 0; j < ROWS; j++) {
        const int *cell = mesh->elements + (mesh->element_count / ROWS * j + j) * n;
        sb_real w[4] = {REAL(0.1), REAL(0.2), REAL(0.3), REAL(0.4)};
        sb_vec3 at = sb_v3(0, 0, 0);
        for (int a = 0; a < 4; a++) {
            rows->nodes[4 * j + a] = cell[a];
            rows->weights[4 * j + a] = w[a];
            at = sb_v3_madd(at, w[a], mesh->nodes[cell[a]]);
        }
        rows->row_start[j] = 4 * j;
        rows->targets[j] =
            sb_v3_add(at, sb_v3(REAL(check_random_in(&seed, -pull, pull)), REAL(check_random_in(&seed, -pull, pull)),
                                REAL(check_random_in(&seed, -pull, pull))));
    }
    rows->row_start[ROWS] = 4 * ROWS;
    rows->mapping.row_count = ROWS;
    rows->mapping.row_start = rows->row_start;
    rows->mapping.nodes = rows->nodes;
    rows->mapping.weights = rows->weights;
}

/* Landmarks inside elements reach their targets as the penalty grows, at the rate 1/k; work is the same on both sides
 * of the mapping, and the forces balance. */
static void test_mapping_targets(void)
{
    double errors[2];
    for (int t = 0; t < 2; t++)
        for (int pass = 0; pass < 2; pass++) {
            sb_mesh mesh = scene_box(element_types[t], 4, 2, 2, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0.1);
            sb_body_def def;
            sb_body *body = make_body(&mesh, sb_material_neo_hookean(5000, REAL(0.4), 1000), &def);
            sb_static_options options = sb_default_static_options();
            sb_real k = REAL(pass ? 1e6 : 1e5);
            sb_vec3 points[ROWS], forces[ROWS], sum;
            double left = 0, right = 0, largest = 0;
            unsigned long long seed = 3;
            int id = 0, blocks = sb_body_matrix_blocks(body);
            test_rows rows;
            make_rows(&mesh, 0.004, &rows);
            scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
            CHECK_OK(sb_body_add_mapping(body, &rows.mapping, &k, 1, rows.targets, &id, NULL));
            CHECK_INT(sb_body_matrix_blocks(body), blocks); /* corners of one tet share it */
            options.tolerance = REAL(1e-10);
            CHECK_OK(sb_body_solve_static(body, &options, NULL));
            CHECK_OK(sb_body_mapping_points(body, id, points));
            CHECK_OK(sb_body_mapping_forces(body, id, forces));
            errors[pass] = scene_distance(points, rows.targets, ROWS);
            for (int j = 0; j < ROWS; j++) {
                sb_vec3 pull = sb_v3_scale(k, sb_v3_sub(rows.targets[j], points[j]));
                CHECK_NEAR(sb_v3_norm(sb_v3_sub(forces[j], pull)), 0, (double)k * scene_tolerance(1e-15, 10));
                largest = fmax(largest, (double)sb_v3_norm(forces[j]));
            }
            for (int i = 0; i < mesh.node_count; i++) { /* virtual work along a random motion */
                sb_vec3 d = sb_v3(REAL(check_random(&seed)), REAL(check_random(&seed)), REAL(check_random(&seed)));
                left += (double)sb_v3_dot(sb_body_external_forces(body)[i], d);
                for (int k2 = 0; k2 < 4 * ROWS; k2++)
                    if (rows.nodes[k2] == i)
                        right += (double)(rows.weights[k2] * sb_v3_dot(forces[k2 / 4], d));
            }
            CHECK_NEAR(left, right, largest * scene_tolerance(1e-12, 1e3));
            sum = sb_v3_add(scene_sum(sb_body_external_forces(body), mesh.node_count),
                            scene_sum(sb_body_reactions(body), mesh.node_count));
            CHECK_NEAR(sb_v3_norm(sum), 0, largest * scene_tolerance(1e-8, 1e5));
            sb_body_destroy(body);
            sb_mesh_free(&mesh);
            if (pass == 1 && !SB_REAL_IS_FLOAT) {
                CHECK(errors[1] < 1e-5);
                CHECK_NEAR(errors[0] / errors[1], 10, 0.5);
            }
        }
}

/* A row through both ends of a beam makes the tangent's pattern grow. Everything the body had stays, and the mean of
 * the ends goes where it should; the same again fits and rebuilds nothing. Each kind of inside of a body. */
static void test_mapping_couples_far_nodes(void)
{
    for (int kind = 0; kind < 6; kind++) {
        sb_mesh mesh = scene_box(kind % 3 == 2 ? SB_HEX8 : SB_TET4, 6, 2, 2, sb_v3(REAL(0.3), REAL(0.1), REAL(0.1)), 0);
        sb_body_def def = sb_default_body_def();
        sb_body *body, *twin;
        int nodes[3], row_start[2] = {0, 3}, id = 0, again = 0, blocks, half = mesh.node_count / 2;
        sb_real weights[3] = {REAL(0.25), REAL(0.5), REAL(0.25)}, k = 0;
        sb_mapping mapping;
        sb_vec3 target, point, force, total = sb_v3(0, 0, 0);
        const sb_vec3 *positions;
        def.mesh = &mesh;
        def.material = kind % 3 == 1 ? sb_material_neo_hookean(5000, REAL(0.3), 1000)
                                     : sb_material_corotated(5000, REAL(0.3), 1000);
        def.damping_stiffness = REAL(0.01);
        def.mass = kind < 3 ? SB_MASS_LUMPED : SB_MASS_CONSISTENT;
        def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-11);
        def.newton_tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-11);
        def.gravity = sb_v3(0, 0, -3);
        body = scene_body(&def);
        twin = scene_body(&def);
        positions = sb_body_positions(body);
        for (int b = 0; b < 2; b++) {
            scene_fix_plane(b ? twin : body, &mesh, 0, 0, SB_XYZ);
            CHECK_OK(sb_body_step(b ? twin : body, REAL(0.01), NULL));
        }
        nodes[0] = nearest_node(&mesh, sb_v3(REAL(0.3), 0, 0));
        nodes[1] = nearest_node(&mesh, sb_v3(REAL(0.15), REAL(0.05), REAL(0.05)));
        nodes[2] = nearest_node(&mesh, sb_v3(REAL(0.3), REAL(0.1), REAL(0.1)));
        mapping.row_count = 1;
        mapping.row_start = row_start;
        mapping.nodes = nodes;
        mapping.weights = weights;
        for (int a = 0; a < 3; a++)
            total = sb_v3_madd(total, weights[a], mesh.nodes[nodes[a]]);
        target = sb_v3_add(total, sb_v3(0, 0, REAL(0.02)));
        blocks = sb_body_matrix_blocks(body);
        CHECK_OK(sb_body_add_mapping(body, &mapping, &k, 1, &target, &id, NULL));
        CHECK_INT(sb_body_matrix_blocks(body), blocks + 6); /* three pairs, both sides of the diagonal */
        CHECK_OK(sb_body_add_mapping(body, &mapping, &k, 1, &target, &again, NULL));
        CHECK_INT(sb_body_matrix_blocks(body), blocks + 6);
        CHECK(again > id);
        CHECK(sb_body_positions(body) == positions);
        for (int s = 0; s < 5; s++) { /* of no stiffness: as the body without */
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            CHECK_OK(sb_body_step(twin, REAL(0.01), NULL));
        }
        CHECK_NEAR(scene_distance(sb_body_positions(body), sb_body_positions(twin), mesh.node_count), 0,
                   SB_REAL_IS_FLOAT ? 1e-5 : 1e-11);
        CHECK_NEAR(scene_distance(sb_body_reactions(body), sb_body_reactions(twin), mesh.node_count), 0,
                   SB_REAL_IS_FLOAT ? 1e-2 : 1e-8);
        CHECK_OK(sb_body_fix_nodes(body, &half, 1, SB_X)); /* the support rows have their new length */
        k = REAL(1e5);
        CHECK_OK(sb_body_set_mapping_stiffness(body, id, &k, 1));
        CHECK_OK(sb_body_remove_load(body, again));
        CHECK_OK(sb_body_solve_static(body, NULL, NULL));
        CHECK_OK(sb_body_mapping_points(body, id, &point));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(point, target)), 0, 1e-4);
        for (int s = 0; s < 5; s++)
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK_OK(sb_body_mapping_points(body, id, &point));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(point, target)), 0, 1e-3);
        CHECK_OK(sb_body_mapping_forces(body, id, &force));
        CHECK(force.z > 0);
        sb_body_destroy(body);
        sb_body_destroy(twin);
        sb_mesh_free(&mesh);
    }
}

/* ---- what holds a body ---- */

/* Two cubes side by side that share nothing. */
static sb_mesh two_cubes(void)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    mesh.element_type = SB_HEX8;
    mesh.node_count = 16;
    mesh.element_count = 2;
    mesh.nodes = (sb_vec3 *)malloc(16 * sizeof(sb_vec3));
    mesh.elements = (int *)malloc(16 * sizeof(int));
    for (int i = 0; i < 16; i++) {
        int c = i % 8;
        mesh.nodes[i] = sb_v3(REAL((c == 1 || c == 2 || c == 5 || c == 6) + 2 * (i / 8)),
                              REAL(c == 2 || c == 3 || c == 6 || c == 7), REAL(c >= 4));
        mesh.elements[i] = i;
    }
    return mesh;
}

static void test_springs_as_supports(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0);
    for (int springs = 1; springs <= 3; springs++) {
        sb_body_def def;
        sb_body *body = make_body(&mesh, sb_material_linear(1000, REAL(0.3), 1000), &def);
        int nodes[3] = {0, 1, 2}, id = 0;
        sb_real k = 100, none = 0;
        sb_step_info info;
        sb_check_report report;
        CHECK_OK(sb_body_add_springs(body, nodes, springs, &k, 1, mesh.nodes, &id, NULL));
        CHECK_RESULT(sb_body_solve_static(body, NULL, &info), springs == 3 ? SB_OK : SB_ERROR_UNCONSTRAINED);
        CHECK_OK(sb_body_check(body, &report));
        CHECK_INT(report.unsupported_component_node, springs == 3 ? -1 : 0);
        CHECK_OK(sb_body_set_spring_stiffness(body, id, &none, 1)); /* springs of no stiffness hold nothing */
        CHECK_RESULT(sb_body_solve_static(body, NULL, &info), SB_ERROR_UNCONSTRAINED);
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
}

/* Rows between two parts: the loose one is held as soon as three corners hang on the other. */
static void test_tied_parts(void)
{
    sb_mesh mesh = two_cubes();
    sb_body_def def;
    sb_body *body = make_body(&mesh, sb_material_linear(1000, REAL(0.3), 1), &def);
    int row_start[2] = {0, 2}, id = 0;
    sb_real weights[2] = {1, -1}, k = REAL(1e5);
    sb_vec3 gap = sb_v3(-1, 0, 0), pull = sb_v3(0, 0, 5), force;
    sb_step_info info;
    const int pairs[3][2] = {{1, 8}, {2, 11}, {5, 12}};
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_add_forces(body, &pairs[0][1], 1, &pull, 1));
    for (int p = 0; p < 3; p++) {
        sb_mapping mapping;
        mapping.row_count = 1;
        mapping.row_start = row_start;
        mapping.nodes = pairs[p];
        mapping.weights = weights;
        CHECK_RESULT(sb_body_solve_static(body, NULL, &info), SB_ERROR_UNCONSTRAINED);
        CHECK_INT(info.error.node, 8);
        CHECK_OK(sb_body_add_mapping(body, &mapping, &k, 1, &gap, &id, NULL));
    }
    CHECK_OK(sb_body_solve_static(body, NULL, &info));
    for (int p = 0; p < 3; p++)
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(
                       sb_v3_sub(sb_body_positions(body)[pairs[p][0]], sb_body_positions(body)[pairs[p][1]]), gap)),
                   0, 1e-3);
    force = scene_sum(sb_body_reactions(body), 16);
    CHECK_NEAR(force.z, -5, scene_tolerance(1e-5, 1e4));           /* the pull arrives at the wall */
    CHECK_OK(sb_body_release_nodes(body, mesh.elements, 8, SB_X)); /* now both slide together */
    CHECK_RESULT(sb_body_solve_static(body, NULL, &info), SB_ERROR_UNCONSTRAINED);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- static solves: ramps ---- */

/* Half a turn of a beam's end by springs: too far for one increment, so the points have to go there step by step. */
static void test_springs_are_ramped(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 6, 2, 2, sb_v3(3, 1, 1), 0);
    sb_body_def def;
    sb_body *body = make_body(&mesh, sb_material_neo_hookean(1000, REAL(0.3), 1000), &def);
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    int nodes[9], count = 0, id = 0;
    sb_real k = REAL(1e5);
    sb_vec3 points[9];
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x > REAL(2.99)) {
            nodes[count] = i;
            points[count++] = mesh.nodes[i];
        }
    CHECK_INT(count, 9);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_add_springs(body, nodes, 9, &k, 1, points, &id, NULL));
    CHECK_OK(sb_body_solve_static(body, NULL, &info));
    for (int turn = 1; turn <= 4; turn++) {
        for (int i = 0; i < 9; i++) { /* about the beam's axis */
            double c = cos(0.5 * turn), s = sin(0.5 * turn), y = (double)mesh.nodes[nodes[i]].y - 0.5,
                   z = (double)mesh.nodes[nodes[i]].z - 0.5;
            points[i] = sb_v3(3, REAL(0.5 + c * y - s * z), REAL(0.5 + s * y + c * z));
        }
        CHECK_OK(sb_body_move_springs(body, id, points));
        options.load_steps = turn == 1 ? 4 : 1;
        CHECK_OK(sb_body_solve_static(body, &options, &info));
        CHECK(info.load_steps >= (turn == 1 ? 3 : 1));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_body_positions(body)[nodes[0]], points[0])), 0, 0.02);
    }
    CHECK_OK(sb_body_remove_load(body, id));
    CHECK_OK(sb_body_solve_static(body, NULL, &info));
    CHECK_NEAR(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count), 0, 1e-4);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* A strong pressure comes in increments from 0, stays, and fades after its removal; the way does not matter. */
static void test_pressure_is_ramped(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 3, 2, 2, sb_v3(REAL(1.5), 1, 1), 0);
    sb_body_def def;
    sb_body *body = make_body(&mesh, sb_material_neo_hookean(1000, REAL(0.3), 1000), &def);
    sb_body *other = make_body(&mesh, sb_material_neo_hookean(1000, REAL(0.3), 1000), &def);
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    int id, id2;
    options.tolerance = REAL(1e-8);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    scene_fix_plane(other, &mesh, 0, 0, SB_XYZ);
    id = add_pressure(body, &mesh, 2, 1, 60);
    id2 = add_pressure(other, &mesh, 2, 1, 20);
    options.load_steps = 5;
    CHECK_OK(sb_body_solve_static(body, &options, &info));
    CHECK(info.load_steps > 1);
    options.load_steps = 1;
    CHECK_OK(sb_body_solve_static(other, &options, &info));
    CHECK_OK(sb_body_set_pressure(other, id2, 60));
    CHECK_OK(sb_body_solve_static(other, &options, &info));
    CHECK(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count) > 0.2);
    CHECK_NEAR(scene_distance(sb_body_positions(body), sb_body_positions(other), mesh.node_count), 0,
               SB_REAL_IS_FLOAT ? 1e-3 : 1e-6);
    CHECK_OK(sb_body_remove_load(body, id));
    CHECK_OK(sb_body_solve_static(body, NULL, &info));
    CHECK_NEAR(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count), 0, 1e-3);
    CHECK_NEAR(sb_v3_norm(scene_sum(sb_body_external_forces(body), mesh.node_count)), 0, 1e-3);
    sb_body_destroy(body);
    sb_body_destroy(other);
    sb_mesh_free(&mesh);
}

/* ---- failures ---- */

static void test_bad_arguments(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0);
    sb_body_def def;
    sb_body *body = make_body(&mesh, sb_material_corotated(1000, REAL(0.3), 1000), &def);
    sb_real k = 10, negative = -1, nan = REAL(NAN);
    sb_vec3 point = sb_v3(0, 0, 0), bad_point = sb_v3(0, REAL(INFINITY), 0), out[3];
    int count, corners, id = -7, outside = mesh.node_count, zero = 0, inner[3], bad[6];
    int *faces = boundary_faces(&mesh, -1, 0, &count, &corners);
    int row_start[3] = {0, 2, 3}, row_nodes[3] = {0, 1, 2}, empty[3] = {0, 2, 2}, offset[3] = {1, 2, 3};
    sb_real weights[3] = {1, 1, 1};
    sb_vec3 targets[2];
    sb_mapping mapping;
    sb_error error;
    targets[0] = targets[1] = point;
    mapping.row_count = 2;
    mapping.row_start = row_start;
    mapping.nodes = row_nodes;
    mapping.weights = weights;
    memcpy(bad, faces, 6 * sizeof(int));
    bad[4] = outside;
    CHECK_RESULT(sb_body_add_pressure(body, bad, 2, 3, 1, &id, &error), SB_ERROR_INDEX);
    CHECK(strstr(error.message, "face 1") != NULL);
    bad[4] = bad[3];
    CHECK_RESULT(sb_body_add_pressure(body, bad, 2, 3, 1, &id, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "face 1") != NULL);
    CHECK_INT(error.node, bad[3]);
    for (int c = 0; c < 3; c++) /* the first tet of a cell shares its inner faces with its neighbours */
        inner[c] = -1;
    for (int f = 0; f < 4 && inner[0] < 0; f++) {
        int local[SB_MAX_FACE_NODES], on_surface = 0;
        sb_element_face(SB_TET4, f, local, NULL);
        for (int b = 0; b < count && !on_surface; b++) {
            int same = 0;
            for (int c = 0; c < 9; c++)
                same += faces[3 * b + c / 3] == mesh.elements[local[c % 3]];
            on_surface = same == 3;
        }
        for (int c = 0; c < 3 && !on_surface; c++)
            inner[c] = mesh.elements[local[c]];
    }
    CHECK_RESULT(sb_body_add_pressure(body, inner, 1, 3, 1, &id, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "between two elements") != NULL);
    CHECK_RESULT(sb_body_add_pressure(body, faces, count, 3, nan, &id, &error), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_add_pressure(body, faces, count, 5, 1, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_pressure(body, faces, count, 4, 1, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_pressure(body, NULL, count, 3, 1, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_pressure(NULL, faces, count, 3, 1, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_springs(body, &outside, 1, &k, 1, &point, &id, &error), SB_ERROR_INDEX);
    CHECK_INT(error.node, outside);
    CHECK_RESULT(sb_body_add_springs(body, &zero, 1, &negative, 1, &point, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_springs(body, &zero, 1, &nan, 1, &point, &id, &error), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_add_springs(body, &zero, 1, &k, 1, &bad_point, &id, &error), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_add_springs(body, &zero, 0, &k, 1, &point, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_springs(body, &zero, 1, NULL, 1, &point, &id, &error), SB_ERROR_ARGUMENT);
    row_nodes[2] = outside;
    CHECK_RESULT(sb_body_add_mapping(body, &mapping, &k, 1, targets, &id, &error), SB_ERROR_INDEX);
    CHECK_INT(error.element, 1);
    row_nodes[2] = 2;
    weights[1] = nan;
    CHECK_RESULT(sb_body_add_mapping(body, &mapping, &k, 1, targets, &id, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.element, 0);
    weights[1] = 1;
    mapping.row_start = empty;
    CHECK_RESULT(sb_body_add_mapping(body, &mapping, &k, 1, targets, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(error.element, 1);
    mapping.row_start = offset;
    CHECK_RESULT(sb_body_add_mapping(body, &mapping, &k, 1, targets, &id, &error), SB_ERROR_ARGUMENT);
    mapping.row_start = row_start;
    CHECK_RESULT(sb_body_add_mapping(body, NULL, &k, 1, targets, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_mapping(body, &mapping, &k, 1, NULL, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(id, -7);
    CHECK_OK(sb_body_add_springs(body, &zero, 1, &k, 1, &point, &id, NULL));
    CHECK_RESULT(sb_body_set_pressure(body, id, 1), SB_ERROR_INDEX); /* of another kind */
    CHECK_RESULT(sb_body_set_mapping_targets(body, id, targets), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_mapping_forces(body, id, out), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_move_springs(body, id, &bad_point), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_set_spring_stiffness(body, id, &negative, 1), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_spring_forces(body, id + 1, out), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_load_force(body, 0, point, out, NULL), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_load_force(body, id, bad_point, out, NULL), SB_ERROR_NOT_FINITE);
    CHECK_OK(sb_body_remove_load(body, id));
    CHECK_RESULT(sb_body_remove_load(body, id), SB_ERROR_INDEX);
    CHECK_OK(sb_body_add_springs(body, &zero, 1, &k, 1, &point, &count, NULL));
    CHECK(count > id); /* never used again */
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(faces);
}

/* One attempt at each kind of load; the first result that is not SB_OK. */
static sb_result add_all(sb_body *body, const sb_mesh *mesh, const int *faces, int face_count, int ids[4])
{
    int nodes[2] = {0, 9}, far[2] = {0, 0}, row_start[2] = {0, 2}, near[2];
    sb_real k = 40, weights[2] = {REAL(0.5), REAL(0.5)};
    sb_vec3 points[2], target = sb_v3(REAL(0.1), REAL(0.05), REAL(0.08));
    sb_mapping mapping;
    sb_result result = SB_OK;
    far[1] = mesh->node_count - 1;
    near[0] = mesh->elements[0];
    near[1] = mesh->elements[1];
    points[0] = mesh->nodes[0];
    points[1] = sb_v3_add(mesh->nodes[9], sb_v3(0, REAL(0.01), 0));
    mapping.row_count = 1;
    mapping.row_start = row_start;
    mapping.weights = weights;
    if (!ids[0])
        result = sb_body_add_pressure(body, faces, face_count, 3, 50, &ids[0], NULL);
    if (result == SB_OK && !ids[1])
        result = sb_body_add_springs(body, nodes, 2, &k, 1, points, &ids[1], NULL);
    mapping.nodes = far;
    if (result == SB_OK && !ids[2])
        result = sb_body_add_mapping(body, &mapping, &k, 1, &target, &ids[2], NULL);
    mapping.nodes = near;
    if (result == SB_OK && !ids[3])
        result = sb_body_add_mapping(body, &mapping, &k, 1, &target, &ids[3], NULL);
    return result;
}

static unsigned long long state_hash(const sb_body *body)
{
    size_t bytes = (size_t)sb_body_node_count(body) * sizeof(sb_vec3);
    return scene_hash(sb_body_displacements(body), bytes) ^ 3 * scene_hash(sb_body_velocities(body), bytes) ^
           5 * scene_hash(sb_body_reactions(body), bytes) ^ 7 * scene_hash(sb_body_external_forces(body), bytes);
}

/* Each allocation fails in turn: nothing leaks, the body goes on as one that never saw a failure, to the last bit. */
static void test_memory_failures(void)
{
    for (int kind = 0; kind < 2; kind++) {
        sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0);
        sb_body_def def = sb_default_body_def();
        scene_memory memory = {0, 0, 0, 0};
        sb_body *body, *twin;
        int ids[4] = {0, 0, 0, 0}, twin_ids[4] = {0, 0, 0, 0}, count, corners, failures = 0;
        int *faces = boundary_faces(&mesh, 2, 0.1, &count, &corners);
        sb_result result = SB_ERROR_MEMORY;
        def.mesh = &mesh;
        def.material =
            kind ? sb_material_neo_hookean(5000, REAL(0.4), 1000) : sb_material_corotated(5000, REAL(0.4), 1000);
        def.damping_stiffness = REAL(0.01);
        def.mass = kind ? SB_MASS_CONSISTENT : SB_MASS_LUMPED;
        twin = scene_body(&def);
        def.allocator = scene_allocator(&memory);
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        scene_fix_plane(twin, &mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK_OK(sb_body_step(twin, REAL(0.01), NULL));
        for (int n = 1; result != SB_OK && n < 200; n++) {
            int live = memory.live, before[4];
            memcpy(before, ids, sizeof ids);
            memory.calls = 0;
            memory.fail_at = n;
            result = add_all(body, &mesh, faces, count, ids);
            memory.fail_at = 0;
            CHECK(result == SB_OK || result == SB_ERROR_MEMORY);
            failures += result != SB_OK;
            if (memcmp(before, ids, sizeof ids) == 0 && result != SB_OK)
                CHECK(memory.live <= live + 1); /* a longer list of loads may stay */
            if (memcmp(before, ids, sizeof ids) != 0 && result != SB_OK)
                n = 0; /* begin again with the next load */
        }
        CHECK_OK(result);
        CHECK(failures > 12);
        CHECK_OK(add_all(twin, &mesh, faces, count, twin_ids));
        memory.calls = 0;
        for (int s = 0; s < 5; s++) {
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            CHECK_OK(sb_body_step(twin, REAL(0.01), NULL));
        }
        CHECK_OK(sb_body_solve_static(body, NULL, NULL));
        CHECK_OK(sb_body_solve_static(twin, NULL, NULL));
        CHECK_INT(memory.calls, 0); /* steps and solves allocate nothing */
        CHECK(state_hash(body) == state_hash(twin));
        sb_body_destroy(body);
        sb_body_destroy(twin);
        CHECK_INT(memory.live, 0);
        sb_mesh_free(&mesh);
        free(faces);
    }
}

/* A step and a static solve that fail leave no trace: state, readings, what comes after. */
static void test_undo(void)
{
    check_bad_numbers();
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int kind = 0; kind < 2; kind++) {
            sb_mesh mesh = scene_box(element_types[t], 3, 2, 2, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0);
            sb_body_def def = sb_default_body_def();
            sb_body *bodies[2];
            int ids[2] = {0, 0}, press[2], node = nearest_node(&mesh, sb_v3(REAL(0.15), 0, 0));
            sb_real k = 30, huge = SB_REAL_MAX;
            sb_vec3 point = sb_v3(REAL(0.16), REAL(0.01), 0), was, now;
            unsigned long long hash;
            def.mesh = &mesh;
            def.material =
                kind ? sb_material_neo_hookean(5000, REAL(0.3), 1000) : sb_material_corotated(5000, REAL(0.3), 1000);
            for (int b = 0; b < 2; b++) {
                bodies[b] = scene_body(&def);
                scene_fix_plane(bodies[b], &mesh, 0, 0, SB_XYZ);
                CHECK_OK(sb_body_add_springs(bodies[b], &node, 1, &k, 1, &point, &ids[b], NULL));
                press[b] = add_pressure(bodies[b], &mesh, 2, 0.1, 40);
                CHECK_OK(sb_body_solve_static(bodies[b], NULL, NULL));
                CHECK_OK(sb_body_set_pressure(bodies[b], press[b], 80));
                for (int s = 0; s < 3; s++)
                    CHECK_OK(sb_body_step(bodies[b], REAL(0.01), NULL));
            }
            hash = state_hash(bodies[0]);
            CHECK_OK(sb_body_load_force(bodies[0], ids[0], point, &was, NULL));
            CHECK_OK(sb_body_set_spring_stiffness(bodies[0], ids[0], &huge, 1)); /* beyond what sb_real holds */
            CHECK(sb_body_step(bodies[0], REAL(0.01), NULL) != SB_OK);
            CHECK(sb_body_solve_static(bodies[0], NULL, NULL) != SB_OK);
            CHECK(state_hash(bodies[0]) == hash);
            CHECK_OK(sb_body_load_force(bodies[0], ids[0], point, &now, NULL));
            CHECK(memcmp(&was, &now, sizeof was) == 0);
            CHECK_OK(sb_body_set_spring_stiffness(bodies[0], ids[0], &k, 1));
            for (int b = 0; b < 2; b++) {
                for (int s = 0; s < 3; s++)
                    CHECK_OK(sb_body_step(bodies[b], REAL(0.01), NULL));
                CHECK_OK(sb_body_solve_static(bodies[b], NULL, NULL));
            }
            CHECK(state_hash(bodies[0]) == state_hash(bodies[1]));
            CHECK_NEAR(scene_distance(sb_body_positions(bodies[0]), sb_body_positions(bodies[1]), mesh.node_count), 0,
                       scene_tolerance(1e-9, 1e3));
            sb_body_destroy(bodies[0]);
            sb_body_destroy(bodies[1]);
            sb_mesh_free(&mesh);
        }
}

/* ---- robustness ---- */

/* Dragged about by a spring under a pressure that swells and sucks; then all is put back. */
static void violent(sb_element_type type, sb_material material, double swell, int steps)
{
    sb_mesh mesh = scene_box(type, 4, 2, 2, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    int node = nearest_node(&mesh, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1))), id = 0, press, failed = 0;
    sb_real k = 500;
    sb_vec3 home = mesh.nodes[node];
    def.mesh = &mesh;
    def.material = material;
    def.damping_mass = 5;
    def.damping_stiffness = REAL(0.02);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    press = add_pressure(body, &mesh, -1, 0, 0);
    CHECK_OK(sb_body_add_springs(body, &node, 1, &k, 1, &home, &id, NULL));
    for (int s = 0, end = check_rounds(steps); s < end; s++) {
        sb_vec3 point =
            sb_v3_add(home, sb_v3(REAL(0.3 * sin(0.11 * s)), REAL(0.25 * cos(0.23 * s)), REAL(0.25 * sin(0.31 * s))));
        CHECK_OK(sb_body_move_springs(body, id, &point));
        CHECK_OK(sb_body_set_pressure(body, press, REAL(swell * sin(0.05 * s))));
        failed += sb_body_step(body, REAL(0.01), NULL) != SB_OK;
        if (!CHECK(scene_all_finite(sb_body_displacements(body), mesh.node_count)) ||
            !CHECK(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count) < 2))
            break;
    }
    CHECK_INT(failed, 0);
    CHECK_OK(sb_body_move_springs(body, id, &home));
    CHECK_OK(sb_body_remove_load(body, press));
    for (int s = 0; s < 300; s++)
        CHECK_OK(sb_body_step(body, REAL(0.02), NULL));
    CHECK_NEAR(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count), 0, 1e-3);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_violence(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++)
        violent(element_types[t], sb_material_corotated_invertible(5000, REAL(0.4), 1000), 500, 1000);
    violent(SB_TET4, sb_material_corotated(5000, REAL(0.4), 1000), 500, 1000);
    violent(SB_HEX8, sb_material_stable_neo_hookean(5000, REAL(0.4), 1000), 1500, 100);
}

/* ---- threads ---- */

static unsigned long long loaded_scene(sb_element_type type, sb_jobs jobs)
{
    sb_mesh mesh = scene_box(type, 8, 3, 3, sb_v3(REAL(0.2), REAL(0.06), REAL(0.06)), 0.1);
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    sb_real k = 200;
    sb_vec3 force = sb_v3(0, 0, 0), torque = force;
    unsigned long long hash;
    int id = 0, springs = 0, tip = nearest_node(&mesh, sb_v3(REAL(0.2), 0, 0));
    test_rows rows;
    def.mesh = &mesh;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    def.jobs = jobs;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    make_rows(&mesh, 0.01, &rows);
    rows.nodes[1] = tip; /* couples far nodes */
    CHECK_OK(sb_body_add_mapping(body, &rows.mapping, &k, 1, rows.targets, &id, NULL));
    CHECK_OK(sb_body_add_springs(body, &tip, 1, &k, 1, &mesh.nodes[0], &springs, NULL));
    add_pressure(body, &mesh, 2, 0.06, 300);
    for (int s = 0; s < 10; s++)
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK_OK(sb_body_load_force(body, id, sb_v3(0, 0, 0), &force, &torque));
    hash = state_hash(body) ^ scene_hash(&force, sizeof force) ^ scene_hash(&torque, sizeof torque);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return hash;
}

static void test_threads(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        int workers[3] = {1, 3, 8};
        unsigned long long first = loaded_scene(element_types[t], scene_jobs(&workers[0]));
        CHECK(loaded_scene(element_types[t], scene_jobs(&workers[1])) == first);
        CHECK(loaded_scene(element_types[t], scene_jobs(&workers[2])) == first);
    }
}

/* A first static solve that fails forgets where a new spring would have begun. */
static void test_failed_first_static(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 4, 1, 1, sb_v3(REAL(0.4), REAL(0.1), REAL(0.1)), 0);
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_vec3 far = sb_v3(REAL(-0.6), REAL(0.1), REAL(0.1));
    sb_real k = REAL(1e5);
    sb_body *body;
    int tip = mesh.node_count - 1, id;
    uint64_t before;
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(REAL(1e4), REAL(0.3), REAL(1000));
    body = scene_body(&def);
    for (int i = 0; i < mesh.node_count; i++)
        if ((double)mesh.nodes[i].x < 1e-9)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
    CHECK_OK(sb_body_add_springs(body, &tip, 1, &k, 1, &far, &id, NULL));
    options.max_newton = 2;
    before = sb_body_state_hash(body);
    CHECK(sb_body_solve_static(body, &options, NULL) != SB_OK);
    CHECK(sb_body_state_hash(body) == before);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* A node of no element: what would pull at it is refused, so that no force is lost without a word. */
static void test_node_of_no_element(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 1, 1, sb_v3(REAL(0.1), REAL(0.05), REAL(0.05)), 0);
    sb_vec3 *nodes = (sb_vec3 *)malloc(((size_t)mesh.node_count + 1) * sizeof *nodes);
    sb_vec3 force = sb_v3(0, 0, 1), none = sb_v3(0, 0, 0), both[2];
    int lonely = mesh.node_count, pair[2], id = 77, starts[2] = {0, 2};
    sb_real stiffness = 10, weights[2] = {1, 0};
    sb_mapping mapping;
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    sb_error error;
    uint64_t hash;
    memcpy(nodes, mesh.nodes, (size_t)lonely * sizeof *nodes);
    nodes[lonely] = sb_v3(1, 1, 1);
    free(mesh.nodes);
    mesh.nodes = nodes;
    mesh.node_count++;
    def.mesh = &mesh;
    def.material = sb_material_linear(REAL(5e3), REAL(0.3), REAL(1000));
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    hash = sb_body_state_hash(body);
    pair[0] = lonely - 1;
    pair[1] = lonely;
    both[0] = force;
    both[1] = none;
    mapping.row_count = 1;
    mapping.row_start = starts;
    mapping.nodes = pair;
    mapping.weights = weights;
    CHECK_RESULT(sb_body_add_forces(body, &lonely, 1, &force, 0), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_add_forces(body, pair, 2, &force, 1), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_add_springs(body, pair, 2, &stiffness, 1, both, &id, &error), SB_ERROR_INDEX);
    CHECK_INT(error.node, lonely);
    weights[1] = REAL(0.5);
    CHECK_RESULT(sb_body_add_mapping(body, &mapping, &stiffness, 1, &force, &id, &error), SB_ERROR_INDEX);
    CHECK_INT(error.element, 0);
    CHECK(sb_body_state_hash(body) == hash && id == 77); /* nothing was added */
    weights[1] = 0;
    CHECK_OK(sb_body_add_mapping(body, &mapping, &stiffness, 1, &nodes[lonely - 1], &id, &error));
    CHECK_OK(sb_body_add_forces(body, pair, 2, both, 0)); /* of 0 there is nothing to lose */
    CHECK_OK(sb_body_release_nodes(body, &lonely, 1, SB_XYZ));
    CHECK_OK(sb_body_prescribe(body, &lonely, 1, SB_Z, &force, 1));
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    CHECK_NEAR(sb_body_displacements(body)[lonely].z, 1, 1e-6);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(load, {"nodes of no element", test_node_of_no_element},
            {"a failed first static solve", test_failed_first_static},
            {"pressure is the gradient of the volume", test_pressure_is_the_volume_gradient},
            {"pressure follows the body", test_pressure_follows}, {"pressure: digits double", test_pressure_tangent},
            {"thick tube (Lame)", test_thick_tube}, {"inflated neo-Hookean sphere", test_inflated_sphere},
            {"springs in statics", test_spring_statics},
            {"frequency and energy of a mass on springs", test_spring_frequency}, {"momentum balances", test_momentum},
            {"stiff springs at any dt", test_stiff_springs},
            {"mapped points reach their targets", test_mapping_targets},
            {"rows couple far nodes", test_mapping_couples_far_nodes},
            {"springs are supports", test_springs_as_supports}, {"rows tie parts", test_tied_parts},
            {"static solves ramp springs", test_springs_are_ramped},
            {"static solves ramp pressure", test_pressure_is_ramped}, {"bad arguments", test_bad_arguments},
            {"every allocation fails", test_memory_failures}, {"failures are undone", test_undo},
            {"1,000 violent steps", test_violence}, {"threads", test_threads});
