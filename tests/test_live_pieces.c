/* Pieces of elements: what a cut makes of a body, cell by cell. */
#include "softbody.h"

#include "check.h"
#include "knife.h"
#include "scene.h"

static const sb_real young = REAL(30000);

static sb_material rubber(sb_material_model model)
{
    return model == SB_LINEAR      ? sb_material_linear(young, REAL(0.35), 1000)
           : model == SB_COROTATED ? sb_material_corotated(young, REAL(0.35), 1000)
                                   : sb_material_stable_neo_hookean(young, REAL(0.35), 1000);
}

static sb_body *cutting_body(const sb_mesh *mesh, sb_material material, sb_integrator integrator, sb_mass_kind mass)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = material;
    def.integrator = integrator;
    def.mass = mass;
    def.slack = 1;
    def.preconditioner = SB_PRECOND_IC0;
    def.gravity = sb_v3(0, 0, 0);
    return scene_body(&def);
}

/* A slanted plane through the middle of a mesh of this size, in no way a special one. */
static knife slanted(sb_vec3 size)
{
    sb_vec3 normal = sb_v3(REAL(0.9429902), REAL(0.29232696), REAL(0.16030833));
    return knife_plane(normal, knife_dot(normal, sb_v3_scale(REAL(0.5), size)) + 0.0123 * (double)size.x);
}

static int knife_cuts(sb_body *body, const sb_mesh *mesh, knife blade, knife_cut *cut)
{
    sb_error error;
    if (CHECK_OK(knife_apply(body, mesh, blade, 0, cut, &error)) && CHECK_OK(sb_body_live_check(body, &error)))
        return 1;
    printf("%s\n", error.message);
    return 0;
}

/* ---- against the extended finite element method ---- */

/* A displacement u and an enrichment, at the nodes of the mesh: sum N_a u_a + sum N_J (H - H_J) A_J, H 1 above. */
typedef struct enriched {
    sb_vec3 *u, *a;
} enriched;

static enriched make_enriched(const knife_cut *cut, unsigned long long *seed)
{
    int n = cut->mesh->node_count;
    enriched field;
    field.u = (sb_vec3 *)calloc((size_t)n, sizeof *field.u);
    field.a = (sb_vec3 *)calloc((size_t)n, sizeof *field.a);
    for (int i = 0; i < n; i++)
        field.u[i] = sb_v3(REAL(check_random_in(seed, -1, 1)), REAL(check_random_in(seed, -1, 1)),
                           REAL(check_random_in(seed, -1, 1)));
    for (int i = 0; i < cut->copies; i++)
        field.a[cut->copy_of[i]] = sb_v3(REAL(check_random_in(seed, -1, 1)), REAL(check_random_in(seed, -1, 1)),
                                         REAL(check_random_in(seed, -1, 1)));
    return field;
}

static void free_enriched(enriched *field)
{
    free(field->u);
    free(field->a);
}

/* The same field by the nodes of the cut body. */
static sb_vec3 *virtual_field(const knife_cut *cut, const enriched *field, int count)
{
    int n = cut->mesh->node_count;
    sb_vec3 *v = (sb_vec3 *)calloc((size_t)count, sizeof *v);
    memcpy(v, field->u, (size_t)n * sizeof *v);
    for (int i = 0; i < cut->copies; i++) {
        int j = cut->copy_of[i];
        v[n + i] = sb_v3_madd(field->u[j], knife_above(&cut->blade, cut->mesh->nodes[j]) ? -1 : 1, field->a[j]);
    }
    return v;
}

/* Points that integrate what is of degree 2 over a tet. */
static void quadrature(int p, sb_real bary[4])
{
    const double far_one = 0.58541019662496845446, others = 0.13819660112501051518;
    for (int a = 0; a < 4; a++)
        bary[a] = REAL(a == p ? far_one : others);
}

/* What an integral over the pieces sums. */
typedef struct xfem_sums {
    double energy, masses;
} xfem_sums;

/* Gradient and value of a field at a point of the tet. */
static sb_mat3 gradient_at(const knife_cut *cut, const enriched *field, const knife_piece *piece, const sb_real xi[3],
                           sb_vec3 *value)
{
    const sb_mesh *mesh = cut->mesh;
    int n = mesh->element_type == SB_TET4 ? 4 : 10, side = piece->mask != 15;
    const int *nodes = mesh->elements + piece->tet * n;
    sb_real shape[10], slope[10][3];
    sb_vec3 x[4];
    sb_mat3 inverse, gradient = sb_m3_zero();
    for (int a = 0; a < 4; a++) {
        x[a] = mesh->nodes[nodes[a]];
        if (piece->mask != 15 && (piece->mask >> a & 1))
            side = knife_above(&cut->blade, x[a]);
    }
    inverse = sb_m3_inverse(sb_m3_columns(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0]), sb_v3_sub(x[3], x[0])));
    sb_element_shape(mesh->element_type, xi, shape, slope);
    *value = sb_v3(0, 0, 0);
    for (int a = 0; a < n; a++) {
        int own = knife_above(&cut->blade, mesh->nodes[nodes[a]]);
        sb_real step = piece->mask == 15 ? 0 : REAL(side - own);
        sb_vec3 g = sb_m3_tapply(inverse, sb_v3(slope[a][0], slope[a][1], slope[a][2]));
        sb_vec3 v = sb_v3_madd(field->u[nodes[a]], step, field->a[nodes[a]]);
        gradient = sb_m3_add(gradient, sb_m3_outer(v, g));
        *value = sb_v3_madd(*value, shape[a], v);
    }
    return gradient;
}

/* a^T K b and a^T M b of the extended method, integrated tet by tet of each piece. */
static xfem_sums integrate(const knife_cut *cut, const enriched *a, const enriched *b, sb_material material)
{
    xfem_sums sums = {0, 0};
    int n = cut->mesh->element_type == SB_TET4 ? 4 : 10;
    for (int k = 0; k < cut->count; k++) {
        const knife_piece *piece = cut->pieces + k;
        const int *nodes = cut->mesh->elements + piece->tet * n;
        double volume = (double)sb_mesh_element_volume(cut->mesh, piece->tet);
        (void)nodes;
        for (int t = 0; t < piece->part.count; t++) {
            const sb_vec3 *y = piece->part.tets[t];
            knife_sums part;
            memset(&part, 0, sizeof part);
            knife_add_tet(&part, y[0], y[0], y[1], y[2], y[3]);
            for (int p = 0; p < 4; p++) {
                sb_real bary[4], xi[3];
                sb_vec3 at = sb_v3(0, 0, 0), va, vb;
                sb_mat3 ga, gb;
                double w = 6 * volume * part.volume / 4;
                quadrature(p, bary);
                for (int c = 0; c < 4; c++)
                    at = sb_v3_madd(at, bary[c], y[c]);
                xi[0] = at.x, xi[1] = at.y, xi[2] = at.z;
                ga = gradient_at(cut, a, piece, xi, &va);
                gb = gradient_at(cut, b, piece, xi, &vb);
                ga = sb_m3_scale(REAL(0.5), sb_m3_add(ga, sb_m3_transpose(ga)));
                gb = sb_m3_scale(REAL(0.5), sb_m3_add(gb, sb_m3_transpose(gb)));
                sums.energy += w * ((double)material.lambda * (double)sb_m3_trace(ga) * (double)sb_m3_trace(gb) +
                                    2 * (double)material.mu * (double)sb_m3_ddot(ga, gb));
                sums.masses += w * (double)material.density * knife_dot(va, vb);
            }
        }
    }
    return sums;
}

/* The node of the cut body that a piece has at one of its places is the middle of an edge with these ends. */
static void ends_of(const knife_piece *piece, int local, int ends[2])
{
    int edge[3];
    sb_element_edge(SB_TET10, local - 4, edge);
    ends[0] = piece->nodes[edge[0]];
    ends[1] = piece->nodes[edge[1]];
}

static sb_vec3 bend_of(const sb_vec3 *u, int node, const int ends[2])
{
    return sb_v3_sub(u[node], sb_v3_scale(REAL(0.5), sb_v3_add(u[ends[0]], u[ends[1]])));
}

/* a^T K b of the rows that hold mid nodes of small pieces. */
static double hold_product(const knife_cut *cut, const sb_vec3 *a, const sb_vec3 *b, int count, sb_material material)
{
    double sum = 0, *sums = (double *)calloc((size_t)count, 3 * sizeof *sums); /* cells, volume, material */
    int *is_small = (int *)calloc((size_t)count, sizeof *is_small);
    for (int k = 0; k < cut->count && cut->mesh->element_type == SB_TET10; k++)
        for (int i = 4; i < 10; i++) {
            const knife_piece *piece = cut->pieces + k;
            double volume = (double)sb_mesh_element_volume(cut->mesh, piece->tet), *of = sums + 3 * piece->nodes[i];
            of[0] += 1;
            of[1] += volume;
            of[2] += volume * piece->share;
            is_small[piece->nodes[i]] |= piece->mask != 15;
        }
    for (int k = 0; k < cut->count && cut->mesh->element_type == SB_TET10; k++)
        for (int i = 4; i < 10; i++) {
            int node = cut->pieces[k].nodes[i], ends[2];
            const double *of = sums + 3 * node;
            double phi = of[2] / of[1], modulus = (double)material.lambda + 2 * (double)material.mu;
            if (!is_small[node] || !(phi < 0.3))
                continue;
            is_small[node] = 0;
            ends_of(cut->pieces + k, i, ends);
            sum += 0.4 * (1 - phi / 0.3) * modulus * cbrt(6 * of[1] / of[0]) * phi *
                   knife_dot(bend_of(a, node, ends), bend_of(b, node, ends));
        }
    free(sums);
    free(is_small);
    return sum;
}

static double field_product(const sb_vec3 *a, const sb_vec3 *b, int count)
{
    double sum = 0;
    for (int i = 0; i < count; i++)
        sum += knife_dot(a[i], b[i]);
    return sum;
}

static void check_xfem(sb_element_type type, knife blade)
{
    const double exact = scene_tolerance(1e-12, 1e4);
    sb_mesh mesh = scene_box(type, 3, 2, 2, sb_v3(REAL(0.3), REAL(0.2), REAL(0.2)), 0.2);
    sb_material material = rubber(SB_LINEAR);
    sb_mass_kind kind = type == SB_TET4 ? SB_MASS_CONSISTENT : SB_MASS_LUMPED;
    sb_body *body = cutting_body(&mesh, material, SB_EULER, kind);
    unsigned long long seed = 5;
    knife_cut cut;
    if (knife_cuts(body, &mesh, blade, &cut)) {
        int n = sb_body_node_count(body);
        CHECK_INT(n, mesh.node_count + cut.copies);
        CHECK(cut.copies > 0);
        for (int k = 0; k < 4; k++) {
            enriched a = make_enriched(&cut, &seed), b = make_enriched(&cut, &seed);
            sb_vec3 *va = virtual_field(&cut, &a, n), *vb = virtual_field(&cut, &b, n);
            sb_vec3 *kb = (sb_vec3 *)calloc((size_t)n, sizeof *kb);
            xfem_sums aa = integrate(&cut, &a, &a, material), ab = integrate(&cut, &a, &b, material);
            sb_energy energy;
            CHECK_OK(sb_body_multiply_stiffness(body, vb, kb, NULL));
            ab.energy += hold_product(&cut, va, vb, n, material);
            CHECK_NEAR(field_product(va, kb, n) / aa.energy, ab.energy / aa.energy, exact);
            CHECK_OK(sb_body_set_velocities(body, va));
            CHECK_OK(sb_body_energy(body, &energy));
            if (kind == SB_MASS_CONSISTENT)
                CHECK_NEAR(2 * (double)energy.kinetic / aa.masses, 1, exact);
            free(va);
            free(vb);
            free(kb);
            free_enriched(&a);
            free_enriched(&b);
        }
        knife_free(&cut);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_xfem(void)
{
    sb_vec3 size = sb_v3(REAL(0.3), REAL(0.2), REAL(0.2));
    knife part = slanted(size);
    part.reach = sb_v3(0, 0, 1);
    part.from = 0.05;
    check_xfem(SB_TET4, slanted(size));
    check_xfem(SB_TET4, part);
    check_xfem(SB_TET10, slanted(size));
    check_xfem(SB_TET10, part);
}

/* ---- at the instant of the cut ---- */

/* A shaken, turning body. */
static void set_in_motion(sb_body *body, double scale)
{
    int n = sb_body_node_count(body);
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)n, 2 * sizeof *u), *v = u + n;
    for (int i = 0; i < n; i++) {
        sb_vec3 x = sb_v3_scale(REAL(1 / scale), sb_body_rest_positions(body)[i]);
        u[i] = sb_v3_scale(REAL(scale), sb_v3(REAL(0.2) * x.y * x.z, REAL(-0.1) * x.x * x.x, REAL(0.3) * x.x * x.y));
        v[i] = sb_v3_scale(REAL(scale), sb_v3(REAL(0.3) + 20 * x.y * x.z, -2 * x.x + 10 * x.y * x.y, x.z * x.x * 30));
    }
    CHECK_OK(sb_body_set_displacements(body, u));
    CHECK_OK(sb_body_set_velocities(body, v));
    free(u);
}

static double angular_momentum(const sb_body *body, const sb_real *masses, int axis)
{
    double sum = 0;
    for (int i = 0; i < sb_body_node_count(body); i++)
        sum += (double)masses[i] *
               (double)scene_component(sb_v3_cross(sb_body_positions(body)[i], sb_body_velocities(body)[i]), axis);
    return sum;
}

/* Lumped masses, from the kinetic energy of one node's motion. */
static sb_real *node_masses(sb_body *body)
{
    int n = sb_body_node_count(body);
    sb_real *masses = (sb_real *)calloc((size_t)n, sizeof *masses);
    sb_vec3 *kept = (sb_vec3 *)calloc((size_t)n, 2 * sizeof *kept), *v = kept + n;
    memcpy(kept, sb_body_velocities(body), (size_t)n * sizeof *kept);
    for (int i = 0; i < n; i++) {
        sb_energy energy;
        v[i] = sb_v3(1, 0, 0);
        CHECK_OK(sb_body_set_velocities(body, v));
        CHECK_OK(sb_body_energy(body, &energy));
        masses[i] = 2 * energy.kinetic;
        v[i] = sb_v3(0, 0, 0);
    }
    CHECK_OK(sb_body_set_velocities(body, kept));
    free(kept);
    return masses;
}

static void check_instant(sb_element_type type, sb_material material, sb_mass_kind kind, double scale,
                          double energy_tolerance)
{
    sb_vec3 size = sb_v3(REAL(0.3 * scale), REAL(0.2 * scale), REAL(0.2 * scale));
    sb_mesh mesh = scene_box(type, 4, 3, 3, size, 0.2);
    sb_body *body = cutting_body(&mesh, material, SB_EULER, kind);
    int n = mesh.node_count;
    sb_real *before, *after;
    sb_vec3 *velocities = (sb_vec3 *)calloc((size_t)n, sizeof *velocities), momentum[2];
    sb_energy energy[2];
    double turning[3], held;
    knife_cut cut;
    set_in_motion(body, scale);
    memcpy(velocities, sb_body_velocities(body), (size_t)n * sizeof *velocities);
    before = node_masses(body);
    CHECK_OK(sb_body_energy(body, &energy[0]));
    momentum[0] = sb_body_momentum(body);
    for (int axis = 0; axis < 3; axis++)
        turning[axis] = angular_momentum(body, before, axis);
    if (knife_cuts(body, &mesh, slanted(size), &cut)) {
        double mass = 0;
        CHECK(memcmp(velocities, sb_body_velocities(body), (size_t)n * sizeof *velocities) == 0);
        after = node_masses(body);
        momentum[1] = sb_body_momentum(body);
        CHECK_OK(sb_body_energy(body, &energy[1]));
        CHECK_NEAR((double)sb_v3_norm(sb_v3_sub(momentum[1], momentum[0])) / (double)sb_v3_norm(momentum[0]), 0,
                   scene_tolerance(1e-13, 100));
        for (int axis = 0; axis < 3 && kind == SB_MASS_LUMPED; axis++)
            CHECK_NEAR(angular_momentum(body, after, axis) / turning[axis], 1, scene_tolerance(1e-12, 1000));
        CHECK_NEAR(energy[1].kinetic / energy[0].kinetic, 1, scene_tolerance(1e-13, 100));
        held =
            hold_product(&cut, sb_body_displacements(body), sb_body_displacements(body), n + cut.copies, material) / 2;
        CHECK_NEAR(((double)energy[1].elastic - held) / (double)energy[0].elastic, 1, energy_tolerance);
        CHECK_NEAR(held / (double)energy[0].elastic, 0, 1e-3);
        for (int i = 0; i < n; i++) { /* what the copies have is what their node has lost */
            double sum = (double)after[i];
            for (int k = 0; k < cut.copies; k++)
                sum += cut.copy_of[k] == i ? (double)after[n + k] : 0;
            if (kind == SB_MASS_LUMPED)
                CHECK_NEAR(sum / (double)before[i], 1, scene_tolerance(3e-14, 100));
            mass += sum;
        }
        if (kind == SB_MASS_LUMPED)
            CHECK_NEAR(mass / (double)sb_body_mass(body), 1, scene_tolerance(1e-13, 100));
        for (int i = 0; i < n + cut.copies; i++)
            CHECK(after[i] > 0);
        free(after);
        knife_free(&cut);
    }
    free(before);
    free(velocities);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_instant(void)
{
    const double exact = scene_tolerance(1e-12, 1e4);
    check_instant(SB_TET4, rubber(SB_LINEAR), SB_MASS_LUMPED, 1, exact);
    check_instant(SB_TET4, rubber(SB_COROTATED), SB_MASS_LUMPED, 1, exact);
    check_instant(SB_TET4, rubber(SB_STABLE_NEO_HOOKEAN), SB_MASS_CONSISTENT, 1, exact);
    for (double scale = 1e-3; scale < 2e3; scale *= 1e3)
        check_instant(SB_TET4, rubber(SB_COROTATED), SB_MASS_LUMPED, scale, exact);
    check_instant(SB_TET10, rubber(SB_LINEAR), SB_MASS_LUMPED, 1, exact);
    check_instant(SB_TET10, rubber(SB_COROTATED), SB_MASS_LUMPED, 1, 1e-4);
}

/* ---- a bar in two ---- */

enum { BAR_X = 12, BAR_Y = 3, BAR_Z = 3 };

static sb_vec3 bar_size(double scale) { return sb_v3(REAL(0.4 * scale), REAL(0.1 * scale), REAL(0.1 * scale)); }

/* 1 for nodes of the half with x = 0. */
static unsigned char *near_half(const sb_body *body, const knife_cut *cut)
{
    unsigned char *is_near = (unsigned char *)calloc((size_t)sb_body_node_count(body), 1);
    int n = cut->mesh->element_type == SB_TET4 ? 4 : 10;
    for (int k = 0; k < cut->count; k++) {
        const knife_piece *piece = cut->pieces + k;
        const int *nodes = cut->mesh->elements + piece->tet * n;
        for (int a = 0; a < 4; a++)
            if ((piece->mask >> a & 1) && !knife_above(&cut->blade, cut->mesh->nodes[nodes[a]]))
                for (int b = 0; b < n; b++)
                    is_near[piece->nodes[b]] = 1;
    }
    return is_near;
}

static void check_stretched(sb_element_type type, sb_material_model model, double scale)
{
    const double exact = scene_tolerance(1e-10, 1e5), place = type == SB_TET4 ? exact : 100 * exact;
    sb_mesh mesh = scene_box(type, BAR_X, BAR_Y, BAR_Z, bar_size(scale), 0.1);
    sb_body *body = cutting_body(&mesh, rubber(model), SB_EULER, SB_MASS_LUMPED);
    sb_static_options options = sb_default_static_options();
    knife_cut cut;
    sb_step_info info;
    sb_vec3 way = sb_v3(REAL(0.02 * scale), 0, 0);
    CHECK(scene_fix_plane(body, &mesh, 0, 0, SB_XYZ) > 0);
    options.tolerance = sb_max(REAL(1e-12), 100 * SB_EPSILON);
    if (knife_cuts(body, &mesh, slanted(bar_size(scale)), &cut)) {
        sb_check_report report;
        unsigned char *is_near = near_half(body, &cut);
        CHECK_OK(sb_body_check(body, &report));
        CHECK_INT(report.component_count, 2);
        CHECK_INT(report.duplicate_count, 0);
        CHECK_RESULT(sb_body_solve_static(body, &options, &info), SB_ERROR_UNCONSTRAINED);
        for (int i = 0; i < mesh.node_count; i++)
            if ((double)mesh.nodes[i].x > 0.399 * scale)
                CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &way, 1));
        if (!CHECK_OK(sb_body_solve_static(body, &options, &info)))
            printf("%s\n", info.error.message);
        for (int i = 0; i < sb_body_node_count(body); i++) {
            sb_vec3 expected = is_near[i] ? sb_v3(0, 0, 0) : way;
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_body_displacements(body)[i], expected)) / way.x, 0, place);
            CHECK_NEAR(sb_v3_norm(sb_body_reactions(body)[i]) / (young * way.x * way.x), 0, exact);
        }
        for (int e = 0; e < sb_body_element_count(body); e++) {
            sb_mat3 stress;
            CHECK_OK(sb_body_stress(body, e, 0, &stress));
            CHECK_NEAR(sqrt((double)sb_m3_ddot(stress, stress)) / (double)young, 0, exact);
        }
        free(is_near);
        knife_free(&cut);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_stretched(void)
{
    check_stretched(SB_TET4, SB_LINEAR, 1);
    check_stretched(SB_TET4, SB_COROTATED, 1);
    check_stretched(SB_TET4, SB_COROTATED, 1e-3);
    check_stretched(SB_TET4, SB_COROTATED, 1e3);
    check_stretched(SB_TET10, SB_COROTATED, 1);
}

/* Mean sag of the free end under gravity of what is held at x = 0. */
static double sag_of(sb_body *body, const sb_mesh *mesh, const unsigned char *is_near, double from, sb_vec3 gravity)
{
    sb_static_options options = sb_default_static_options();
    double sum = 0;
    int count = 0;
    options.tolerance = sb_max(REAL(1e-9), 100 * SB_EPSILON);
    CHECK_OK(sb_body_set_gravity(body, gravity));
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int i = 0; i < mesh->node_count; i++)
        if ((!is_near || is_near[i]) && (double)mesh->nodes[i].x > from) {
            sum += (double)sb_v3_dot(sb_body_displacements(body)[i], gravity);
            count++;
        }
    return sum / count;
}

/* The clamped half of a bar cut across at x = c is as soft as a bar of length c. */
static void check_half(sb_element_type type, double tolerance)
{
    const double length = 0.4 * 7.37 / (int)BAR_X;
    sb_mesh mesh = scene_box(type, BAR_X, BAR_Y, BAR_Z, bar_size(1), 0);
    sb_mesh half = scene_box(type, 7, BAR_Y, BAR_Z, sb_v3(REAL(length), REAL(0.1), REAL(0.1)), 0);
    sb_body *body = cutting_body(&mesh, rubber(SB_LINEAR), SB_EULER, SB_MASS_LUMPED);
    sb_body *twin = cutting_body(&half, rubber(SB_LINEAR), SB_EULER, SB_MASS_LUMPED);
    sb_vec3 gravity[2];
    knife_cut cut;
    gravity[0] = sb_v3(1, 0, 0);
    gravity[1] = sb_v3(0, 0, -1);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    scene_fix_plane(body, &mesh, 0, 0.4, SB_XYZ);
    scene_fix_plane(twin, &half, 0, 0, SB_XYZ);
    if (knife_cuts(body, &mesh, knife_plane(sb_v3(1, 0, 0), length), &cut)) {
        unsigned char *is_near = near_half(body, &cut);
        for (int k = 0; k < 2; k++) {
            double from = 0.4 * 6.75 / (int)BAR_X; /* the last whole plane of nodes */
            double wanted = sag_of(twin, &half, NULL, 0.999 * length, gravity[k]);
            double share =
                k == 0 ? 1 - pow(1 - 7 / 7.37, 2) : 7 / 7.37; /* of the end's way; of a bar's far side nearly */
            double got = sag_of(body, &mesh, is_near, from, gravity[k]);
            printf("   half a bar, %s, %s: %.5g of %.5g\n", type == SB_TET4 ? "tet4" : "tet10",
                   k == 0 ? "stretched" : "bent", got, wanted * share);
            CHECK_NEAR(got / (wanted * share), 1, tolerance);
        }
        free(is_near);
        knife_free(&cut);
    }
    sb_body_destroy(body);
    sb_body_destroy(twin);
    sb_mesh_free(&mesh);
    sb_mesh_free(&half);
}

static void test_half(void)
{
    check_half(SB_TET4, 0.01);
    check_half(SB_TET10, 0.01);
}

/* ---- a loose part falls ---- */

static void check_falling(sb_element_type type)
{
    const double dt = 0.01, g = 9.81;
    sb_mesh mesh = scene_box(type, BAR_X, BAR_Y, BAR_Z, bar_size(1), 0.1);
    sb_body *body = cutting_body(&mesh, rubber(SB_COROTATED), SB_EULER, SB_MASS_LUMPED);
    knife_cut cut;
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, REAL(-g))));
    CHECK_OK(sb_body_set_solver(body, sb_max(REAL(1e-13), 10 * SB_EPSILON), 2000));
    if (knife_cuts(body, &mesh, slanted(bar_size(1)), &cut)) {
        unsigned char *is_near = near_half(body, &cut);
        for (int k = 1; k <= 5; k++) {
            double t = k * dt, fall = g * t * (t + dt) / 2;
            CHECK_OK(sb_body_step(body, REAL(dt), NULL));
            for (int i = 0; i < sb_body_node_count(body); i++)
                if (!is_near[i])
                    CHECK_NEAR(sb_v3_norm(sb_v3_add(sb_body_displacements(body)[i], sb_v3(0, 0, REAL(fall)))) /
                                   REAL(fall),
                               0, scene_tolerance(1e-10, 1e5));
        }
        free(is_near);
        knife_free(&cut);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_falling(void)
{
    check_falling(SB_TET4);
    check_falling(SB_TET10);
}

/* ---- turned before or after ---- */

static void turn(sb_body *body)
{
    int n = sb_body_node_count(body);
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)n, sizeof *u);
    for (int i = 0; i < n; i++) {
        sb_vec3 x = sb_body_rest_positions(body)[i];
        u[i] = sb_v3_sub(sb_v3(-x.y, x.x, x.z), x);
    }
    CHECK_OK(sb_body_set_displacements(body, u));
    free(u);
}

static void check_turned(sb_element_type type)
{
    sb_mesh mesh = scene_box(type, 6, 3, 3, bar_size(1), 0.1);
    sb_body *body[2];
    knife_cut cut[2];
    knife blade = slanted(bar_size(1));
    int good = 1;
    blade.reach = sb_v3(0, 0, 1);
    blade.from = 0.045;
    for (int k = 0; k < 2; k++) {
        body[k] = cutting_body(&mesh, rubber(SB_COROTATED), SB_EULER, SB_MASS_LUMPED);
        CHECK_OK(sb_body_set_gravity(body[k], sb_v3(0, 0, REAL(-9.81))));
        CHECK_OK(sb_body_set_solver(body[k], sb_max(REAL(1e-12), 10 * SB_EPSILON), 2000));
        if (k == 0)
            turn(body[k]);
        good &= knife_cuts(body[k], &mesh, blade, &cut[k]);
        if (k == 1)
            turn(body[k]);
        for (int i = 0; i < mesh.node_count; i++)
            if (mesh.nodes[i].x < REAL(1e-6)) {
                int axes = SB_XYZ;
                CHECK_OK(sb_body_hold(body[k], &i, 1, axes, NULL));
            }
        for (int s = 0; s < 10; s++)
            CHECK_OK(sb_body_step(body[k], REAL(0.01), NULL));
    }
    if (good) {
        CHECK_NEAR(scene_distance(sb_body_positions(body[0]), sb_body_positions(body[1]), sb_body_node_count(body[0])) /
                       0.4,
                   0, scene_tolerance(1e-8, 1e5));
        knife_free(&cut[0]);
        knife_free(&cut[1]);
    }
    sb_body_destroy(body[0]);
    sb_body_destroy(body[1]);
    sb_mesh_free(&mesh);
}

static void test_turned(void)
{
    check_turned(SB_TET4);
    check_turned(SB_TET10);
}

/* ---- slivers ---- */

/* Mean iterations of some steps. */
static double iterations_of(sb_body *body, double tolerance)
{
    double sum = 0;
    CHECK_OK(sb_body_set_solver(body, sb_max(REAL(tolerance), 10 * SB_EPSILON), 2000));
    for (int s = 0; s < 10; s++) {
        sb_step_info info;
        CHECK_OK(sb_body_step(body, REAL(0.01), &info));
        sum += info.pcg_iterations;
    }
    return sum / 10;
}

/* A beam cut half through, `share` of an element beyond a plane of nodes; 0: not cut. Iterations, and the tip's sag. */
static double cut_beam(sb_element_type type, sb_precond_kind kind, double share, double *tip)
{
    const int nx = 20, ny = 4, nz = 6;
    sb_mesh mesh = scene_box(type, nx, ny, nz, sb_v3(REAL(0.2), REAL(0.04), REAL(0.06)), 0);
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    double mean;
    knife_cut cut;
    knife blade = knife_plane(sb_v3(1, 0, 0), 0.2 * (nx / 2 + share) / nx);
    memset(&cut, 0, sizeof cut);
    blade.reach = sb_v3(0, 0, 1);
    blade.from = 0.03;
    def.mesh = &mesh;
    def.material = sb_material_corotated(50000, REAL(0.45), 1000);
    def.slack = REAL(0.3);
    def.preconditioner = kind;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    if (share > 0)
        (void)knife_cuts(body, &mesh, blade, &cut);
    mean = iterations_of(body, 1e-5);
    *tip = 0;
    for (int i = 0; i < mesh.node_count; i++)
        *tip = fmin(*tip, (double)sb_body_displacements(body)[i].z);
    knife_free(&cut);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return mean;
}

static void check_slivers(sb_element_type type, sb_precond_kind kind)
{
    static const double shares[] = {0.5, 0.1, 1e-2, 1e-3, 1e-6};
    double tip, before = 0, uncut = cut_beam(type, kind, 0, &tip);
    printf("   %s, %s: uncut %.1f iterations; cut", type == SB_TET4 ? "tet4" : "tet10",
           kind == SB_PRECOND_MULTIGRID ? "multigrid" : "IC(0)", uncut);
    for (int k = 0; k < 5; k++) {
        double mean = cut_beam(type, kind, shares[k], &tip);
        printf(" %g: %.1f", shares[k], mean);
        CHECK(mean <= 1.3 * uncut);
        if (k > 2)
            CHECK_NEAR(tip / before, 1, 0.01);
        before = tip;
    }
    printf("\n");
}

static void test_slivers(void)
{
    check_slivers(SB_TET4, SB_PRECOND_IC0);
    if (!check_quick())
        check_slivers(SB_TET10, SB_PRECOND_IC0);
}

/* ---- pieces without volume ---- */

static void test_empty(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 6, 2, 2, bar_size(1), 0);
    sb_body *body = cutting_body(&mesh, rubber(SB_COROTATED), SB_EULER, SB_MASS_LUMPED);
    sb_real mass = sb_body_mass(body);
    knife_cut cut;
    int empty = 0, held = 0;
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, REAL(-9.81))));
    if (knife_cuts(body, &mesh, knife_plane(sb_v3(1, 0, 0), (double)mesh.nodes[3].x), &cut)) {
        sb_error error;
        for (int k = 0; k < cut.count; k++) {
            empty += cut.pieces[k].share == 0;
            CHECK(sb_body_cell_in_use(body, cut.pieces[k].cell));
            CHECK(sb_body_cell_share(body, cut.pieces[k].cell) == REAL(cut.pieces[k].share));
        }
        CHECK(empty > 0);
        CHECK_NEAR(sb_body_mass(body) / mass, 1, scene_tolerance(1e-13, 100));
        for (int s = 0; s < 5; s++)
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        for (int i = mesh.node_count; i < sb_body_node_count(body); i++)
            held += sb_body_supports(body)[i] == SB_XYZ && sb_body_velocities(body)[i].z == 0;
        CHECK(held > 0);
        CHECK(scene_all_finite(sb_body_positions(body), sb_body_node_count(body)));
        CHECK_OK(sb_body_live_check(body, &error));
        knife_free(&cut);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- supports ---- */

static void test_supports(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 4, 2, 2, bar_size(1), 0);
    for (int k = 0; k < 3; k++) {
        static const int flags[3] = {0, SB_NODE_KEEP_Z, SB_NODE_KEEP_X | SB_NODE_KEEP_Y | SB_NODE_KEEP_Z};
        static const int axes[3] = {0, SB_Z, SB_Y | SB_Z};
        sb_body *body = cutting_body(&mesh, rubber(SB_COROTATED), SB_EULER, SB_MASS_LUMPED);
        knife_cut cut;
        sb_error error;
        int copies = 0;
        scene_fix_plane(body, &mesh, 2, 0, SB_Y | SB_Z);
        CHECK_OK(knife_apply(body, &mesh, slanted(bar_size(1)), flags[k], &cut, &error));
        for (int i = 0; i < cut.copies; i++)
            if (mesh.nodes[cut.copy_of[i]].z == 0) {
                CHECK_INT(sb_body_supports(body)[mesh.node_count + i], axes[k]);
                copies++;
            } else {
                CHECK_INT(sb_body_supports(body)[mesh.node_count + i], 0);
            }
        CHECK(copies > 0);
        CHECK_OK(sb_body_live_check(body, &error));
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        knife_free(&cut);
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
}

/* ---- states and recordings ---- */

static void check_saved(sb_element_type type, int empty)
{
    sb_mesh mesh = scene_box(type, 6, 2, 2, bar_size(1), empty ? 0 : 0.1);
    sb_body *body = cutting_body(&mesh, rubber(SB_COROTATED), SB_EULER, SB_MASS_LUMPED);
    sb_body *twin = cutting_body(&mesh, rubber(SB_COROTATED), SB_EULER, SB_MASS_LUMPED);
    knife blade = empty ? knife_plane(sb_v3(1, 0, 0), (double)mesh.nodes[3].x) : slanted(bar_size(1));
    void *whole, *state;
    size_t whole_size, size;
    knife_cut cut;
    uint64_t uncut;
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, REAL(-9.81))));
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    whole_size = sb_body_state_size(body);
    whole = malloc(whole_size);
    CHECK_OK(sb_body_state_save(body, whole, whole_size));
    uncut = sb_body_state_hash(body);
    if (knife_cuts(body, &mesh, blade, &cut)) {
        sb_error error;
        size = sb_body_state_size(body);
        state = malloc(size);
        CHECK_OK(sb_body_state_save(body, state, size));
        if (!CHECK_OK(sb_body_state_load(twin, state, size, &error)))
            printf("%s\n", error.message);
        CHECK(sb_body_state_hash(body) == sb_body_state_hash(twin));
        CHECK_OK(sb_body_live_check(twin, &error));
        for (int s = 0; s < 5; s++) { /* the twin was made anew, the body changed in place */
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            CHECK_OK(sb_body_step(twin, REAL(0.01), NULL));
            CHECK(sb_body_state_hash(body) == sb_body_state_hash(twin));
        }
        CHECK_OK(sb_body_state_load(body, whole, whole_size, &error));
        CHECK(sb_body_state_hash(body) == uncut);
        for (size_t at = 0; at < size; at += 1 + size / 97) { /* damaged ones are refused or harmless */
            unsigned char *bytes = (unsigned char *)state;
            bytes[at] = (unsigned char)(bytes[at] ^ 0x55);
            CHECK(sb_body_state_load(twin, state, size, &error) != SB_OK);
            bytes[at] = (unsigned char)(bytes[at] ^ 0x55);
        }
        free(state);
        knife_free(&cut);
    }
    free(whole);
    sb_body_destroy(body);
    sb_body_destroy(twin);
    sb_mesh_free(&mesh);
}

static void test_state(void)
{
    check_saved(SB_TET4, 0);
    check_saved(SB_TET4, 1);
    check_saved(SB_TET10, 0);
    check_saved(SB_TET10, 1);
}

static void check_recorded(sb_element_type type)
{
    sb_mesh mesh = scene_box(type, 6, 2, 2, bar_size(1), 0.1);
    sb_body *body = cutting_body(&mesh, rubber(SB_COROTATED), SB_EULER, SB_MASS_LUMPED);
    sb_body *twin = cutting_body(&mesh, rubber(SB_COROTATED), SB_EULER, SB_MASS_LUMPED);
    sb_recording *recording = NULL;
    sb_recording_report report;
    knife_cut cut;
    sb_error error;
    CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, REAL(-9.81))));
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_recording_start(body, 0, NULL, &recording, &error));
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    if (CHECK_OK(knife_apply(body, &mesh, slanted(bar_size(1)), SB_NODE_KEEP_Y, &cut, &error)))
        knife_free(&cut);
    for (int s = 0; s < 4; s++)
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, twin, &report)))
        printf("%s\n", report.error.message);
    CHECK(sb_body_state_hash(body) == sb_body_state_hash(twin));
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    sb_body_destroy(twin);
    sb_mesh_free(&mesh);
}

static void test_recorded(void)
{
    check_recorded(SB_TET4);
    check_recorded(SB_TET10);
}

/* ---- taken back, other materials, explicit steps ---- */

/* Takes a cut back by a change: the cells as they were, and no copies. */
static void join(sb_body *body, const knife_cut *cut)
{
    int n = cut->mesh->element_type == SB_TET4 ? 4 : 10;
    sb_body_change *change;
    sb_real one = 1;
    sb_error error;
    CHECK_OK(sb_body_change_begin(body, &change, &error));
    for (int k = cut->count; k-- > 0;) {
        const knife_piece *piece = cut->pieces + k;
        sb_change_cell cell = sb_default_change_cell();
        cell.nodes = cut->mesh->elements + piece->tet * n;
        cell.parent = piece->cell;
        if (piece->cell != piece->tet)
            CHECK_OK(sb_body_change_remove_cell(change, piece->cell, &error));
        else
            CHECK_OK(sb_body_change_replace_cell(change, piece->cell, &cell, &error));
    }
    for (int i = cut->copies; i-- > 0;) {
        int copy = cut->mesh->node_count + i;
        CHECK_OK(sb_body_change_remove_node(change, copy, cut->copy_of + i, &one, 1, &error));
    }
    if (CHECK_OK(sb_body_change_commit(change, &error)))
        return;
    printf("%s\n", error.message);
    sb_body_change_cancel(change);
}

static void check_joined(sb_element_type type)
{
    sb_mesh mesh = scene_box(type, 4, 2, 2, bar_size(1), 0.1);
    sb_body *body = cutting_body(&mesh, rubber(SB_COROTATED), SB_EULER, SB_MASS_LUMPED);
    uint64_t hash = sb_body_state_hash(body);
    knife_cut cut;
    if (knife_cuts(body, &mesh, slanted(bar_size(1)), &cut)) {
        CHECK(sb_body_state_hash(body) != hash);
        join(body, &cut);
        CHECK_OK(sb_body_live_check(body, NULL));
        CHECK(sb_body_state_hash(body) == hash);
        knife_free(&cut);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_joined(void)
{
    check_joined(SB_TET4);
    check_joined(SB_TET10);
}

/* A material set after the cut is as one set before it. */
static void test_materials(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 4, 2, 2, bar_size(1), 0.1);
    sb_material stiff = sb_material_corotated(3 * young, REAL(0.4), 900);
    sb_body *body[2];
    for (int k = 0; k < 2; k++) {
        knife_cut cut;
        body[k] = cutting_body(&mesh, rubber(SB_COROTATED), SB_EULER, SB_MASS_LUMPED);
        CHECK_OK(sb_body_set_gravity(body[k], sb_v3(0, 0, REAL(-9.81))));
        scene_fix_plane(body[k], &mesh, 0, 0, SB_XYZ);
        if (k == 0)
            CHECK_OK(sb_body_set_material(body[k], &stiff, NULL));
        if (knife_cuts(body[k], &mesh, slanted(bar_size(1)), &cut))
            knife_free(&cut);
        if (k == 1)
            CHECK_OK(sb_body_set_material(body[k], &stiff, NULL));
        for (int s = 0; s < 3; s++)
            CHECK_OK(sb_body_step(body[k], REAL(0.01), NULL));
    }
    CHECK(sb_body_state_hash(body[0]) == sb_body_state_hash(body[1]));
    sb_body_destroy(body[0]);
    sb_body_destroy(body[1]);
    sb_mesh_free(&mesh);
}

/* Explicit steps of a body cut in two: bounded, and momentum is kept. */
static void check_explicit(sb_element_type type)
{
    sb_mesh mesh = scene_box(type, 4, 2, 2, bar_size(1), 0);
    sb_body *body = cutting_body(&mesh, rubber(SB_COROTATED), SB_CENTRAL_DIFFERENCE, SB_MASS_LUMPED);
    sb_real whole, cut_step;
    sb_vec3 before, after;
    knife_cut cut;
    CHECK_OK(sb_body_stable_step(body, &whole, NULL));
    set_in_motion(body, 1);
    before = sb_body_momentum(body);
    if (knife_cuts(body, &mesh, knife_plane(sb_v3(1, 0, 0), 0.4 * 2.4 / 4), &cut)) {
        CHECK_OK(sb_body_stable_step(body, &cut_step, NULL));
        printf("   explicit %s: stable step %.3f of the uncut one\n", type == SB_TET4 ? "tet4" : "tet10",
               (double)(cut_step / whole));
        CHECK(cut_step > REAL(0.3) * whole);
        for (int s = 0; s < 50; s++)
            CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
        after = sb_body_momentum(body);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(after, before)) / sb_v3_norm(before), 0, scene_tolerance(1e-9, 1e4));
        knife_free(&cut);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_explicit(void)
{
    check_explicit(SB_TET4);
    check_explicit(SB_TET10);
}

/* ---- memory ---- */

static void check_memory(sb_element_type type)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_mesh mesh = scene_box(type, 4, 2, 2, bar_size(1), 0.1);
    sb_body_def def = sb_default_body_def();
    sb_body *body, *twin;
    sb_result result = SB_ERROR_MEMORY;
    sb_error error;
    knife_cut cut;
    int failures = 0, live;
    uint64_t hash;
    def.mesh = &mesh;
    def.material = rubber(SB_COROTATED);
    def.slack = 1;
    twin = scene_body(&def);
    def.allocator = scene_allocator(&memory);
    body = scene_body(&def);
    hash = sb_body_state_hash(body);
    live = memory.live;
    for (int n = 1; result != SB_OK && n < 2000; n++) {
        memory.calls = 0;
        memory.fail_at = n;
        result = knife_apply(body, &mesh, slanted(bar_size(1)), 0, &cut, &error);
        memory.fail_at = 0;
        if (result == SB_OK)
            break;
        failures++;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK_INT(memory.live, live);
        CHECK(sb_body_state_hash(body) == hash);
    }
    if (CHECK_OK(result))
        knife_free(&cut);
    CHECK(failures > 0);
    if (CHECK_OK(knife_apply(twin, &mesh, slanted(bar_size(1)), 0, &cut, &error)))
        knife_free(&cut);
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK_OK(sb_body_step(twin, REAL(0.01), NULL));
    CHECK(sb_body_state_hash(body) == sb_body_state_hash(twin));
    sb_body_destroy(body);
    sb_body_destroy(twin);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&mesh);
}

static void test_memory(void)
{
    check_memory(SB_TET4);
    check_memory(SB_TET10);
}

/* ---- refusals ---- */

/* What comes of making cell 0 a piece, with these loads of its faces. */
static sb_result try_faces(sb_element_type type, sb_mass_kind kind, int curved, sb_real share, sb_cell_moments moments,
                           const sb_real *face_loads)
{
    sb_mesh mesh = scene_box(type, 2, 2, 2, bar_size(1), 0);
    sb_body_def def = sb_default_body_def();
    sb_change_cell cell = sb_default_change_cell();
    sb_body_change *change;
    sb_body *body;
    sb_result result;
    uint64_t hash;
    def.mesh = &mesh;
    def.material = rubber(SB_COROTATED);
    def.mass = kind;
    def.slack = 1;
    def.integration = curved ? SB_INTEGRATION_STANDARD : SB_INTEGRATION_AUTO;
    if (curved)
        mesh.nodes[mesh.elements[6]].x += REAL(0.005);
    body = scene_body(&def);
    hash = sb_body_state_hash(body);
    CHECK_OK(sb_body_change_begin(body, &change, NULL));
    cell.nodes = mesh.elements;
    cell.parent = 0;
    cell.share = share;
    cell.moments = &moments;
    cell.face_loads = face_loads;
    result = sb_body_change_replace_cell(change, 0, &cell, NULL);
    if (result == SB_OK)
        result = sb_body_change_commit(change, NULL);
    if (result != SB_OK) {
        CHECK(sb_body_state_hash(body) == hash);
        sb_body_change_cancel(change);
    }
    CHECK_OK(sb_body_live_check(body, NULL));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return result;
}

static sb_result try_piece(sb_element_type type, sb_mass_kind kind, int curved, sb_real share, sb_cell_moments moments)
{
    return try_faces(type, kind, curved, share, moments, NULL);
}

/* Loads of a face whose mean lies far outside of it, as its share is far less than they are. */
static void test_faces(void)
{
    sb_cell_moments good;
    sb_real loads[24];
    memset(&good, 0, sizeof good);
    good.centroid = sb_v3(REAL(0.25), REAL(0.25), REAL(0.25));
    memset(loads, 0, sizeof loads);
    CHECK_OK(try_faces(SB_TET10, SB_MASS_LUMPED, 0, REAL(0.5), good, loads));
    for (int k = 0; k < 24; k++) /* an eighth of each, about the middle of it */
        loads[k] = k % 6 < 3 ? REAL(-1) / 72 : REAL(1) / 18;
    CHECK_OK(try_faces(SB_TET10, SB_MASS_LUMPED, 0, REAL(0.5), good, loads));
    for (int small = 0; small < 3; small++) {
        sb_real size = small == 0 ? REAL(0.1) : SB_EPSILON / (small == 1 ? 1 : 4);
        memset(loads, 0, sizeof loads);
        loads[0] = -size;
        loads[1] = size;
        loads[2] = size * SB_EPSILON * SB_EPSILON;
        CHECK_RESULT(try_faces(SB_TET10, SB_MASS_LUMPED, 0, REAL(0.5), good, loads), SB_ERROR_ARGUMENT);
        CHECK_RESULT(try_faces(SB_TET4, SB_MASS_LUMPED, 0, REAL(0.5), good, loads), SB_ERROR_ARGUMENT);
    }
    loads[0] = 2; /* nothing is read of an element that has no pieces */
    CHECK_RESULT(try_faces(SB_HEX8, SB_MASS_LUMPED, 0, REAL(0.5), good, loads), SB_ERROR_UNSUPPORTED);
}

static void test_refused(void)
{
    sb_cell_moments good, bad;
    memset(&good, 0, sizeof good);
    good.centroid = sb_v3(REAL(0.25), REAL(0.25), REAL(0.25));
    for (int i = 0; i < 9; i++)
        good.covariance.m[i / 3][i % 3] = i % 4 == 0 ? REAL(0.0375) : REAL(-0.0125);
    CHECK_OK(try_piece(SB_TET4, SB_MASS_LUMPED, 0, REAL(0.5), good));
    CHECK_OK(try_piece(SB_TET4, SB_MASS_LUMPED, 0, 0, good));
    CHECK_OK(try_piece(SB_TET4, SB_MASS_CONSISTENT, 0, REAL(0.5), good));
    CHECK_OK(try_piece(SB_TET10, SB_MASS_LUMPED, 0, REAL(0.5), good));
    CHECK_RESULT(try_piece(SB_TET10, SB_MASS_CONSISTENT, 0, REAL(0.5), good), SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(try_piece(SB_TET10, SB_MASS_LUMPED, 1, REAL(0.5), good), SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(try_piece(SB_HEX8, SB_MASS_LUMPED, 0, REAL(0.5), good), SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(try_piece(SB_TET4, SB_MASS_LUMPED, 0, REAL(-0.1), good), SB_ERROR_ARGUMENT);
    CHECK_RESULT(try_piece(SB_TET4, SB_MASS_LUMPED, 0, REAL(1.1), good), SB_ERROR_ARGUMENT);
    bad = good;
    bad.centroid.y = REAL(0.7);
    CHECK_RESULT(try_piece(SB_TET4, SB_MASS_LUMPED, 0, REAL(0.5), bad), SB_ERROR_ARGUMENT);
    bad = good;
    bad.covariance.m[1][1] = REAL(-0.1);
    CHECK_RESULT(try_piece(SB_TET4, SB_MASS_LUMPED, 0, REAL(0.5), bad), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    bad = good;
    bad.covariance.m[2][0] = REAL(NAN);
    CHECK_RESULT(try_piece(SB_TET4, SB_MASS_LUMPED, 0, REAL(0.5), bad), SB_ERROR_NOT_FINITE);
}

CHECK_SUITE(live_pieces, {"extended finite elements", test_xfem}, {"instant of the cut", test_instant},
            {"stretched in two", test_stretched}, {"half a bar", test_half}, {"falling", test_falling},
            {"turned", test_turned}, {"slivers", test_slivers}, {"empty pieces", test_empty},
            {"supports", test_supports}, {"states", test_state}, {"recordings", test_recorded},
            {"taken back", test_joined}, {"other materials", test_materials}, {"explicit steps", test_explicit},
            {"memory", test_memory}, {"loads of faces", test_faces}, {"refusals", test_refused});
