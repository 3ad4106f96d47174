/* verification_scene.h: the elements and materials of the verification suites, one row each; meshes as images
 * of a block; tractions that vary over a surface; closed forms of the material models, written down
 * independently. */
#ifndef VERIFICATION_SCENE_H
#define VERIFICATION_SCENE_H

#include "verification.h"

#define VERIFY_PI 3.14159265358979323846

/* ---- elements: a new one is a row here ---- */

typedef struct verify_element {
    const char *name;
    sb_element_type type;
    sb_integration integration;
    int single_rotation;
    int degree; /* the complete polynomials it holds */
} verify_element;

static const verify_element verify_elements[] = {{"tet4", SB_TET4, SB_INTEGRATION_AUTO, 0, 1},
                                                 {"tet10", SB_TET10, SB_INTEGRATION_AUTO, 0, 2},
                                                 {"tet10, single rotation", SB_TET10, SB_INTEGRATION_AUTO, 1, 2},
                                                 {"hex8", SB_HEX8, SB_INTEGRATION_AUTO, 0, 1},
                                                 {"hex8, B-bar", SB_HEX8, SB_INTEGRATION_BBAR, 0, 1},
                                                 {"hex20", SB_HEX20, SB_INTEGRATION_AUTO, 0, 2},
                                                 {"hex27", SB_HEX27, SB_INTEGRATION_AUTO, 0, 2}};
enum { VERIFY_ELEMENTS = (int)(sizeof verify_elements / sizeof verify_elements[0]) };

static inline const verify_element *verify_element_named(const char *name)
{
    for (int i = 0; i < VERIFY_ELEMENTS; i++)
        if (strcmp(verify_elements[i].name, name) == 0)
            return verify_elements + i;
    CHECK(!name);
    return verify_elements;
}

/* 1 when the element can be made of the material: a single rotation is for corotated bodies. */
static inline int verify_suits(const verify_element *element, sb_material_model model)
{
    return !element->single_rotation || model == SB_COROTATED;
}

/* ---- materials: a new one is a row here ---- */

/* Constants from which the closed forms are made. */
typedef struct verify_constants {
    double lambda, mu, bulk;
} verify_constants;

static inline verify_constants verify_constants_of(double young, double poisson)
{
    verify_constants c;
    c.mu = young / (2 * (1 + poisson));
    c.lambda = young * poisson / ((1 + poisson) * (1 - 2 * poisson));
    c.bulk = young / (3 * (1 - 2 * poisson));
    return c;
}

typedef struct verify_material {
    const char *name;
    sb_material (*make)(sb_real young, sb_real poisson, sb_real density);
    /* First Piola-Kirchhoff stress (Pa) and energy (Pa) at principal stretches l. */
    double (*principal)(verify_constants c, const double l[3], double stress[3]);
    /* P_12 and P_22 (Pa) in simple shear F = I + g e1 (x) e2. */
    void (*shear)(verify_constants c, double g, double stress[2]);
} verify_material;

/* Hooke's law in the stretches: linear and corotated, W = mu sum (l_i - 1)^2 + lambda/2 (sum (l_i - 1))^2. */
static inline double verify_hooke(verify_constants c, const double l[3], double stress[3])
{
    double trace = l[0] + l[1] + l[2] - 3, squares = 0;
    for (int i = 0; i < 3; i++) {
        stress[i] = 2 * c.mu * (l[i] - 1) + c.lambda * trace;
        squares += (l[i] - 1) * (l[i] - 1);
    }
    return c.mu * squares + 0.5 * c.lambda * trace * trace;
}

static inline void verify_linear_shear(verify_constants c, double g, double stress[2])
{
    stress[0] = c.mu * g;
    stress[1] = 0;
}

/* R turns by atan(g/2); tr(R^T F) = 1 + sqrt(4 + g^2). */
static inline void verify_corotated_shear(verify_constants c, double g, double stress[2])
{
    double root = sqrt(4 + g * g), cosine = 2 / root, sine = g / root;
    stress[0] = 2 * c.mu * (g - sine) + c.lambda * (root - 2) * sine;
    stress[1] = 2 * c.mu * (1 - cosine) + c.lambda * (root - 2) * cosine;
}

/* E_i = (l_i^2 - 1)/2, W = mu sum E_i^2 + lambda/2 (sum E_i)^2, P_i = l_i S_i. */
static inline double verify_svk(verify_constants c, const double l[3], double stress[3])
{
    double trace = 0, squares = 0;
    for (int i = 0; i < 3; i++) {
        double e = 0.5 * (l[i] * l[i] - 1);
        trace += e;
        squares += e * e;
    }
    for (int i = 0; i < 3; i++)
        stress[i] = l[i] * (c.lambda * trace + c.mu * (l[i] * l[i] - 1));
    return c.mu * squares + 0.5 * c.lambda * trace * trace;
}

static inline void verify_svk_shear(verify_constants c, double g, double stress[2])
{
    stress[1] = 0.5 * c.lambda * g * g + c.mu * g * g;
    stress[0] = c.mu * g + g * stress[1];
}

/* W = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2 */
static inline double verify_neo_hookean(verify_constants c, const double l[3], double stress[3])
{
    double log_volume = log(l[0] * l[1] * l[2]);
    for (int i = 0; i < 3; i++)
        stress[i] = c.mu * (l[i] - 1 / l[i]) + c.lambda * log_volume / l[i];
    return 0.5 * c.mu * (l[0] * l[0] + l[1] * l[1] + l[2] * l[2] - 3) - c.mu * log_volume +
           0.5 * c.lambda * log_volume * log_volume;
}

/* W = mu/2 (I1 - 3) - mu (J - 1) + (lambda + mu)/2 (J - 1)^2 */
static inline double verify_stable(verify_constants c, const double l[3], double stress[3])
{
    double volume = l[0] * l[1] * l[2], grown = volume - 1;
    for (int i = 0; i < 3; i++)
        stress[i] = c.mu * l[i] + ((c.lambda + c.mu) * grown - c.mu) * volume / l[i];
    return 0.5 * c.mu * (l[0] * l[0] + l[1] * l[1] + l[2] * l[2] - 3) - c.mu * grown +
           0.5 * (c.lambda + c.mu) * grown * grown;
}

/* W = mu/2 (J^(-2/3) I1 - 3) + K/2 (J - 1)^2 */
static inline double verify_isochoric(verify_constants c, const double l[3], double stress[3])
{
    double volume = l[0] * l[1] * l[2], scale = pow(volume, -2.0 / 3.0);
    double squares = l[0] * l[0] + l[1] * l[1] + l[2] * l[2];
    for (int i = 0; i < 3; i++)
        stress[i] = c.mu * scale * (l[i] - squares / (3 * l[i])) + c.bulk * (volume - 1) * volume / l[i];
    return 0.5 * c.mu * (scale * squares - 3) + 0.5 * c.bulk * (volume - 1) * (volume - 1);
}

static inline void verify_isochoric_shear(verify_constants c, double g, double stress[2])
{
    stress[0] = c.mu * g;
    stress[1] = -c.mu * g * g / 3;
}

/* c10 = mu/2, d1 = 2/K: Abaqus' constants of the same small-strain limit. */
static inline sb_material verify_make_isochoric(sb_real young, sb_real poisson, sb_real density)
{
    verify_constants c = verify_constants_of((double)young, (double)poisson);
    return sb_material_neo_hookean_isochoric(REAL(c.mu / 2), REAL(2 / c.bulk), density);
}

/* Share of c01 in c10 + c01 = mu/2, and c20, c30 as multiples of mu, of the materials of Mooney and Rivlin
 * and of the reduced polynomials. */
static const double verify_mooney_share = 0.3, verify_c20 = 0.1, verify_c30 = 0.05;

/* W = c10 (J^(-2/3) I1 - 3) + c01 (J^(-4/3) I2 - 3) + K/2 (J - 1)^2, c10 + c01 = mu/2: over the neo-Hookean
 * model of the same mu, the difference of c01's two terms. */
static inline double verify_mooney_rivlin(verify_constants c, const double l[3], double stress[3])
{
    double c01 = verify_mooney_share * c.mu / 2, volume = l[0] * l[1] * l[2], scale = pow(volume, -2.0 / 3.0);
    double first = l[0] * l[0] + l[1] * l[1] + l[2] * l[2];
    double second = l[0] * l[0] * l[1] * l[1] + l[1] * l[1] * l[2] * l[2] + l[2] * l[2] * l[0] * l[0];
    double energy = verify_isochoric(c, l, stress);
    for (int i = 0; i < 3; i++)
        stress[i] += 2 * c01 *
                     (scale * scale * (first * l[i] - pow(l[i], 3) - 2 * second / (3 * l[i])) -
                      scale * (l[i] - first / (3 * l[i])));
    return energy + c01 * (scale * scale * second - scale * first);
}

/* P_12 = 2 (c10 + c01) g, P_22 = -(2 c10 + 4 c01) g^2/3 */
static inline void verify_mooney_shear(verify_constants c, double g, double stress[2])
{
    stress[0] = c.mu * g;
    stress[1] = -(1 + verify_mooney_share) * c.mu * g * g / 3;
}

static inline sb_material verify_make_mooney_rivlin(sb_real young, sb_real poisson, sb_real density)
{
    verify_constants c = verify_constants_of((double)young, (double)poisson);
    return sb_material_mooney_rivlin(REAL((1 - verify_mooney_share) * c.mu / 2), REAL(verify_mooney_share * c.mu / 2),
                                     REAL(2 / c.bulk), density);
}

/* W = sum_i ci0 (J^(-2/3) I1 - 3)^i + K/2 (J - 1)^2, c10 = mu/2: in the stress the factor 2 sum_i i ci0
 * (..)^(i-1) stands for mu. */
static inline double verify_polynomial(verify_constants c, double c30, const double l[3], double stress[3])
{
    double c20 = verify_c20 * c.mu, volume = l[0] * l[1] * l[2], x;
    x = pow(volume, -2.0 / 3.0) * (l[0] * l[0] + l[1] * l[1] + l[2] * l[2]) - 3;
    verify_constants at = c;
    at.mu = c.mu + 4 * c20 * x + 6 * c30 * x * x;
    verify_isochoric(at, l, stress);
    return c.mu / 2 * x + c20 * x * x + c30 * x * x * x + 0.5 * c.bulk * (volume - 1) * (volume - 1);
}

static inline void verify_polynomial_shear(verify_constants c, double c30, double g, double stress[2])
{
    verify_constants at = c;
    at.mu = c.mu + 4 * verify_c20 * c.mu * g * g + 6 * c30 * pow(g, 4);
    verify_isochoric_shear(at, g, stress);
}

static inline double verify_polynomial_2(verify_constants c, const double l[3], double stress[3])
{
    return verify_polynomial(c, 0, l, stress);
}
static inline double verify_polynomial_3(verify_constants c, const double l[3], double stress[3])
{
    return verify_polynomial(c, verify_c30 * c.mu, l, stress);
}
static inline void verify_polynomial_2_shear(verify_constants c, double g, double stress[2])
{
    verify_polynomial_shear(c, 0, g, stress);
}
static inline void verify_polynomial_3_shear(verify_constants c, double g, double stress[2])
{
    verify_polynomial_shear(c, verify_c30 * c.mu, g, stress);
}

static inline sb_material verify_make_polynomial_2(sb_real young, sb_real poisson, sb_real density)
{
    verify_constants c = verify_constants_of((double)young, (double)poisson);
    return sb_material_reduced_polynomial(REAL(c.mu / 2), REAL(verify_c20 * c.mu), 0, REAL(2 / c.bulk), density);
}
static inline sb_material verify_make_polynomial_3(sb_real young, sb_real poisson, sb_real density)
{
    verify_constants c = verify_constants_of((double)young, (double)poisson);
    return sb_material_reduced_polynomial(REAL(c.mu / 2), REAL(verify_c20 * c.mu), REAL(verify_c30 * c.mu),
                                          REAL(2 / c.bulk), density);
}

/* W = mu/(2 b) (exp(b (J^(-2/3) I1 - 3)) - 1) + K/2 (J - 1)^2: exp(..) stands for 1 in the stress. */
static const double verify_fung_exponent = 0.5;

static inline double verify_fung(verify_constants c, const double l[3], double stress[3])
{
    double b = verify_fung_exponent, volume = l[0] * l[1] * l[2], x;
    x = pow(volume, -2.0 / 3.0) * (l[0] * l[0] + l[1] * l[1] + l[2] * l[2]) - 3;
    verify_constants at = c;
    at.mu = c.mu * exp(b * x);
    verify_isochoric(at, l, stress);
    return c.mu / (2 * b) * expm1(b * x) + 0.5 * c.bulk * (volume - 1) * (volume - 1);
}

static inline void verify_fung_shear(verify_constants c, double g, double stress[2])
{
    verify_constants at = c;
    at.mu = c.mu * exp(verify_fung_exponent * g * g);
    verify_isochoric_shear(at, g, stress);
}

static inline sb_material verify_make_fung(sb_real young, sb_real poisson, sb_real density)
{
    verify_constants c = verify_constants_of((double)young, (double)poisson);
    return sb_material_fung(REAL(c.mu / 2), REAL(verify_fung_exponent), REAL(2 / c.bulk), density);
}

/* W = sum mu_i/a_i (J^(-a_i/3) (l_0^a_i + l_1^a_i + l_2^a_i) - 3) + K/2 (J - 1)^2, exponents 3 and -1.5 with
 * mu_i a_i/2 of 0.6 and 0.4 mu. */
static const double verify_ogden_alpha[2] = {3, -1.5}, verify_ogden_share[2] = {0.6, 0.4};

static inline double verify_ogden(verify_constants c, const double l[3], double stress[3])
{
    double volume = l[0] * l[1] * l[2], energy = 0.5 * c.bulk * (volume - 1) * (volume - 1);
    for (int i = 0; i < 3; i++)
        stress[i] = c.bulk * (volume - 1) * volume / l[i];
    for (int t = 0; t < 2; t++) {
        double a = verify_ogden_alpha[t], mu = 2 * verify_ogden_share[t] * c.mu / a, scale = pow(volume, -a / 3);
        double sum = scale * (pow(l[0], a) + pow(l[1], a) + pow(l[2], a));
        energy += mu / a * (sum - 3);
        for (int i = 0; i < 3; i++)
            stress[i] += mu * (scale * pow(l[i], a) - sum / 3) / l[i];
    }
    return energy;
}

/* Stretches l, 1/l, 1 with l - 1/l = g, along v = (g, l^2 - 1) of either and u = F v/l. */
static inline void verify_ogden_shear(verify_constants c, double g, double stress[2])
{
    double first = g / 2 + sqrt(1 + g * g / 4);
    const double l[3] = {first, 1 / first, 1};
    double principal[3];
    verify_ogden(c, l, principal);
    stress[0] = stress[1] = 0;
    for (int k = 0; k < 2 && fabs(g) > 0; k++) {
        double x = g, y = l[k] * l[k] - 1, size = sqrt(x * x + y * y);
        x /= size, y /= size;
        stress[0] += principal[k] * (x + g * y) / l[k] * y;
        stress[1] += principal[k] * y / l[k] * y;
    }
}

static inline sb_material verify_make_ogden(sb_real young, sb_real poisson, sb_real density)
{
    verify_constants c = verify_constants_of((double)young, (double)poisson);
    sb_real mu[2], alpha[2];
    for (int t = 0; t < 2; t++) {
        alpha[t] = REAL(verify_ogden_alpha[t]);
        mu[t] = REAL(2 * verify_ogden_share[t] * c.mu / verify_ogden_alpha[t]);
    }
    return sb_material_ogden(mu, alpha, 2, REAL(2 / c.bulk), density);
}

static const verify_material verify_materials[] = {
    {"linear", sb_material_linear, verify_hooke, verify_linear_shear},
    {"corotated", sb_material_corotated, verify_hooke, verify_corotated_shear},
    {"corotated_invertible", sb_material_corotated_invertible, verify_hooke, verify_corotated_shear},
    {"svk", sb_material_svk, verify_svk, verify_svk_shear},
    {"neo_hookean", sb_material_neo_hookean, verify_neo_hookean, verify_linear_shear},
    {"neo_hookean_isochoric", verify_make_isochoric, verify_isochoric, verify_isochoric_shear},
    {"stable_neo_hookean", sb_material_stable_neo_hookean, verify_stable, verify_linear_shear},
    {"mooney_rivlin", verify_make_mooney_rivlin, verify_mooney_rivlin, verify_mooney_shear},
    {"reduced_polynomial, N = 2", verify_make_polynomial_2, verify_polynomial_2, verify_polynomial_2_shear},
    {"reduced_polynomial, N = 3", verify_make_polynomial_3, verify_polynomial_3, verify_polynomial_3_shear},
    {"ogden, N = 2", verify_make_ogden, verify_ogden, verify_ogden_shear},
    {"fung", verify_make_fung, verify_fung, verify_fung_shear}};
enum { VERIFY_MATERIALS = (int)(sizeof verify_materials / sizeof verify_materials[0]) };

/* ---- meshes: images of the unit cube ---- */

/* Where a point of the unit cube goes. */
typedef sb_vec3 (*verify_map)(const void *user, double x, double y, double z);

static const int verify_kuhn[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};

/* Corner `corner` of part `part` (of 6 tets or 1 hex) of a cell; on the lattice of half cells. */
static inline void verify_corner(int corners, int part, int corner, int at[3])
{
    static const int hex[8][3] = {{0, 0, 0}, {2, 0, 0}, {2, 2, 0}, {0, 2, 0},
                                  {0, 0, 2}, {2, 0, 2}, {2, 2, 2}, {0, 2, 2}};
    at[0] = at[1] = at[2] = 0;
    if (corners == 8) {
        memcpy(at, hex[corner], sizeof hex[corner]);
        return;
    }
    if (part >= 3 && (corner == 1 || corner == 2)) /* odd permutations are mirror images */
        corner = 3 - corner;
    for (int k = 0; k < corner; k++)
        at[verify_kuhn[part][k]] = 2;
}

typedef struct verify_lattice {
    sb_mesh mesh;
    const int *cells; /* [3] */
    int *node_at;     /* [(2 nx + 1) (2 ny + 1) (2 nz + 1)] or -1 */
    verify_map map;
    const void *user;
    int straight;
} verify_lattice;

static inline sb_vec3 verify_mapped(const verify_lattice *l, const int at[3])
{
    return l->map(l->user, at[0] / (2.0 * l->cells[0]), at[1] / (2.0 * l->cells[1]), at[2] / (2.0 * l->cells[2]));
}

/* The node with shape parameters xi of an element with the given corners; made when it is new. */
static inline int verify_node(verify_lattice *l, int (*corner)[3], int corners, const sb_real xi[3])
{
    sb_real shape[SB_MAX_ELEMENT_NODES];
    double exact[3] = {0, 0, 0};
    int at[3], slot;
    sb_vec3 x = sb_v3(0, 0, 0);
    sb_element_shape(corners == 8 ? SB_HEX8 : SB_TET4, xi, shape, NULL);
    for (int c = 0; c < corners; c++) {
        for (int k = 0; k < 3; k++)
            exact[k] += (double)shape[c] * corner[c][k];
        if (l->straight)
            x = sb_v3_add(x, sb_v3_scale(shape[c], verify_mapped(l, corner[c])));
    }
    for (int k = 0; k < 3; k++)
        at[k] = (int)floor(exact[k] + 0.5);
    slot = (at[2] * (2 * l->cells[1] + 1) + at[1]) * (2 * l->cells[0] + 1) + at[0];
    if (l->node_at[slot] < 0) {
        l->node_at[slot] = l->mesh.node_count;
        l->mesh.nodes[l->mesh.node_count++] = l->straight ? x : verify_mapped(l, at);
    }
    return l->node_at[slot];
}

/* n[0] x n[1] x n[2] cells of any volume type; nodes between corners lie on the image (curved sides), or
 * straight between their corners. */
static inline sb_mesh verify_block(sb_element_type type, int nx, int ny, int nz, verify_map map, const void *user,
                                   int straight)
{
    const int n[3] = {nx, ny, nz};
    int corners = sb_element_corner_count(type), nodes = sb_element_node_count(type), parts = corners == 8 ? 1 : 6;
    size_t slots = (size_t)(2 * nx + 1) * (size_t)(2 * ny + 1) * (size_t)(2 * nz + 1);
    verify_lattice l;
    int *element;
    memset(&l, 0, sizeof l);
    l.cells = n;
    l.map = map;
    l.user = user;
    l.straight = straight;
    l.node_at = (int *)malloc(slots * sizeof(int));
    l.mesh.element_type = type;
    l.mesh.element_count = nx * ny * nz * parts;
    l.mesh.nodes = (sb_vec3 *)malloc(slots * sizeof(sb_vec3));
    l.mesh.elements = element = (int *)malloc((size_t)l.mesh.element_count * (size_t)nodes * sizeof(int));
    for (size_t i = 0; i < slots; i++)
        l.node_at[i] = -1;
    for (int cell = 0; cell < nx * ny * nz; cell++)
        for (int part = 0; part < parts; part++) {
            const int origin[3] = {2 * (cell % nx), 2 * (cell / nx % ny), 2 * (cell / (nx * ny))};
            int corner[8][3];
            for (int c = 0; c < corners; c++) {
                verify_corner(corners, part, c, corner[c]);
                for (int k = 0; k < 3; k++)
                    corner[c][k] += origin[k];
            }
            for (int a = 0; a < nodes; a++) {
                sb_real xi[3];
                sb_element_node_point(type, a, xi);
                *element++ = verify_node(&l, corner, corners, xi);
            }
        }
    free(l.node_at);
    return l.mesh;
}

/* A box; user: its sizes [3] (m). */
static inline sb_vec3 verify_map_box(const void *user, double x, double y, double z)
{
    const double *size = (const double *)user;
    return sb_v3(REAL(size[0] * x), REAL(size[1] * y), REAL(size[2] * z));
}

/* The unit cube with its inside distorted; its surface stays. */
static inline sb_vec3 verify_map_distorted(const void *user, double x, double y, double z)
{
    double bump = 64 * x * (1 - x) * y * (1 - y) * z * (1 - z) * *(const double *)user;
    return sb_v3(REAL(x + bump * sin(9 * x + 5 * y + 3 * z)), REAL(y + bump * cos(4 * x + 8 * y - 5 * z)),
                 REAL(z + bump * sin(3 * x - 6 * y + 7 * z + 1)));
}

static inline sb_mesh verify_box(sb_element_type type, int nx, int ny, int nz, double lx, double ly, double lz)
{
    const double size[3] = {lx, ly, lz};
    return verify_block(type, nx, ny, nz, verify_map_box, size, 1);
}

/* A sector of a thick cylinder around z: inner and outer radius, angle (rad), length (m). The cells grow with
 * the radius. */
typedef struct verify_ring {
    double inner, outer, angle, length;
} verify_ring;

static inline sb_vec3 verify_ring_point(const verify_ring *ring, double r, double y, double z)
{
    double a = ring->angle * y;
    return sb_v3(REAL(r * cos(a)), REAL(y == 0 ? 0 : r * sin(a)), REAL(ring->length * z));
}

static inline sb_vec3 verify_map_ring(const void *user, double x, double y, double z)
{
    const verify_ring *ring = (const verify_ring *)user;
    return verify_ring_point(ring, ring->inner * pow(ring->outer / ring->inner, x), y, z);
}

/* The same with cells of one height. */
static inline sb_vec3 verify_map_even_ring(const void *user, double x, double y, double z)
{
    const verify_ring *ring = (const verify_ring *)user;
    return verify_ring_point(ring, ring->inner + (ring->outer - ring->inner) * x, y, z);
}

/* A third of an octant of a thick sphere: the part in which component `axis` of the direction is the
 * largest. */
typedef struct verify_shell {
    double inner, outer;
    int axis;
} verify_shell;

static inline sb_vec3 verify_shell_point(const verify_shell *shell, double r, double y, double z)
{
    double direction[3], b = tan(y * VERIFY_PI / 4), c = tan(z * VERIFY_PI / 4), length = sqrt(1 + b * b + c * c);
    direction[shell->axis] = r / length;
    direction[(shell->axis + 1) % 3] = r * b / length;
    direction[(shell->axis + 2) % 3] = r * c / length;
    return sb_v3(REAL(direction[0]), REAL(direction[1]), REAL(direction[2]));
}

static inline sb_vec3 verify_map_shell(const void *user, double x, double y, double z)
{
    const verify_shell *shell = (const verify_shell *)user;
    return verify_shell_point(shell, shell->inner * pow(shell->outer / shell->inner, x), y, z);
}

/* The same with cells of one height. */
static inline sb_vec3 verify_map_even_shell(const void *user, double x, double y, double z)
{
    const verify_shell *shell = (const verify_shell *)user;
    return verify_shell_point(shell, shell->inner + (shell->outer - shell->inner) * x, y, z);
}

/* Appends a mesh, which is freed, without joining nodes; `whole` starts as zeros. */
static inline void verify_append(sb_mesh *whole, sb_mesh *part)
{
    size_t nodes = (size_t)sb_element_node_count(part->element_type);
    size_t old_nodes = (size_t)whole->node_count, old_elements = (size_t)whole->element_count * nodes;
    size_t new_elements = (size_t)part->element_count * nodes;
    whole->element_type = part->element_type;
    whole->nodes = (sb_vec3 *)realloc(whole->nodes, (old_nodes + (size_t)part->node_count) * sizeof(sb_vec3));
    whole->elements = (int *)realloc(whole->elements, (old_elements + new_elements) * sizeof(int));
    memcpy(whole->nodes + old_nodes, part->nodes, (size_t)part->node_count * sizeof(sb_vec3));
    for (size_t i = 0; i < new_elements; i++)
        whole->elements[old_elements + i] = part->elements[i] + whole->node_count;
    whole->node_count += part->node_count;
    whole->element_count += part->element_count;
    sb_mesh_free(part);
}

/* What the name of a case says of its mesh: graded, or even. */
static const char *const verify_gradings[2] = {"", ", even mesh"};

/* An octant of a thick sphere in three blocks of `around`^2 x `across` cells, which grow with the radius, or are of one
 * height. */
static inline sb_mesh verify_octant(sb_element_type type, double inner, double outer, int across, int around, int even)
{
    sb_mesh whole;
    memset(&whole, 0, sizeof whole);
    for (int axis = 0; axis < 3; axis++) {
        verify_shell shell;
        shell.inner = inner;
        shell.outer = outer;
        shell.axis = axis;
        sb_mesh part =
            verify_block(type, across, around, around, even ? verify_map_even_shell : verify_map_shell, &shell, 0);
        verify_append(&whole, &part);
    }
    CHECK_OK(sb_mesh_merge_nodes(&whole, REAL(-1), NULL, NULL));
    return whole;
}

/* Moves nodes between corners on the surface of a cylinder around axis x out to it, so that its sides are
 * curved: `count` nodes of one element, of which the last lies between the others. */
static inline void verify_round_node(sb_mesh *mesh, const int *element, const int *nodes, int count, double radius)
{
    int surface = 1;
    for (int i = 0; i + 1 < count; i++) {
        sb_vec3 x = mesh->nodes[element[nodes[i]]];
        surface = surface && sqrt((double)(x.y * x.y + x.z * x.z)) > radius * (1 - 1e-6);
    }
    sb_vec3 *x = mesh->nodes + element[nodes[count - 1]];
    double r = sqrt((double)(x->y * x->y + x->z * x->z));
    if (surface && r > radius / 2) {
        x->y *= REAL(radius / r);
        x->z *= REAL(radius / r);
    }
}

static inline void verify_round(sb_mesh *mesh, double radius)
{
    sb_element_type type = mesh->element_type;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *element = mesh->elements + e * sb_element_node_count(type);
        for (int k = 0; k < sb_element_edge_count(type); k++) {
            int edge[3];
            if (sb_element_edge(type, k, edge) == 3)
                verify_round_node(mesh, element, edge, 3, radius);
        }
        for (int f = 0; f < sb_element_face_count(type); f++) {
            int face[SB_MAX_FACE_NODES];
            if (sb_element_face(type, f, face, NULL) == 9) /* edges first: they are on the surface by now */
                verify_round_node(mesh, element, face, 9, radius);
        }
    }
}

/* ---- bodies ---- */

static inline sb_body_def verify_def(const sb_mesh *mesh, const verify_element *element, sb_material material)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = material;
    def.integration = element->integration;
    def.single_rotation = element->single_rotation;
    return def;
}

static inline sb_body *verify_body(const sb_mesh *mesh, const verify_element *element, sb_material material)
{
    sb_body_def def = verify_def(mesh, element, material);
    return scene_body(&def);
}

/* Static equilibrium to rounding. */
static inline int verify_solve(sb_body *body)
{
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-4 : 1e-11);
    options.max_newton = 300;
    int ok = CHECK_OK(sb_body_solve_static(body, &options, &info));
    if (!ok)
        printf("%s (load factor %.3g, residual %.1e)\n", info.error.message, (double)info.load_factor,
               (double)info.residual);
    return ok;
}

static inline void verify_free(sb_body *body, sb_mesh *mesh)
{
    sb_body_destroy(body);
    sb_mesh_free(mesh);
}

/* ---- where: predicates of reference positions ---- */

typedef int (*verify_where)(const void *user, sb_vec3 x);

/* Coordinate `axis` is `value`. */
typedef struct verify_plane {
    int axis;
    double value;
} verify_plane;

static inline int verify_on_plane(const void *user, sb_vec3 x)
{
    const verify_plane *plane = (const verify_plane *)user;
    return fabs((double)scene_component(x, plane->axis) - plane->value) < 1e-5 * (1e-2 + fabs(plane->value));
}

/* user: the radius of a sphere around the origin. */
static inline int verify_on_sphere(const void *user, sb_vec3 x)
{
    double radius = *(const double *)user;
    return fabs((double)sb_v3_norm(x) - radius) < 1e-5 * radius;
}

/* user: the radius of a cylinder around z. */
static inline int verify_on_cylinder(const void *user, sb_vec3 x)
{
    x.z = 0;
    return verify_on_sphere(user, x);
}

/* Sum of the reactions at the nodes there. */
static inline sb_vec3 verify_reaction(const sb_body *body, const sb_mesh *mesh, verify_where where, const void *user)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int i = 0; i < mesh->node_count; i++)
        if (where(user, mesh->nodes[i]))
            sum = sb_v3_add(sum, sb_body_reactions(body)[i]);
    return sum;
}

/* Sum of the torques of these reactions about `centre`, the nodes being at x. */
static inline sb_vec3 verify_torque(const sb_body *body, const sb_mesh *mesh, verify_where where, const void *user,
                                    sb_vec3 centre, const sb_vec3 *x)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int i = 0; i < mesh->node_count; i++)
        if (where(user, mesh->nodes[i]))
            sum = sb_v3_add(sum, sb_v3_cross(sb_v3_sub(x[i], centre), sb_body_reactions(body)[i]));
    return sum;
}

/* Moves the nodes there, along `axes`, by one displacement. */
static inline void verify_move(sb_body *body, const sb_mesh *mesh, verify_where where, const void *user, int axes,
                               sb_vec3 displacement)
{
    for (int i = 0; i < mesh->node_count; i++)
        if (where(user, mesh->nodes[i]))
            CHECK_OK(sb_body_prescribe(body, &i, 1, axes, &displacement, 1));
}

/* Mean displacement of the nodes there. */
static inline sb_vec3 verify_mean(const sb_body *body, const sb_mesh *mesh, verify_where where, const void *user)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    int count = 0;
    for (int i = 0; i < mesh->node_count; i++)
        if (where(user, mesh->nodes[i])) {
            sum = sb_v3_add(sum, sb_body_displacements(body)[i]);
            count++;
        }
    CHECK(count > 0);
    return sb_v3_scale(REAL(1.0 / (count > 0 ? count : 1)), sum);
}

/* ---- loads ---- */

/* Mean outward displacement of the nodes at a radius, from the centre or from axis z. */
static inline double verify_outward(const sb_body *body, const sb_mesh *mesh, verify_where where, double radius)
{
    double sum = 0;
    int count = 0;
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 x = mesh->nodes[i];
        if (!where(&radius, x))
            continue;
        if (where == verify_on_cylinder)
            x.z = 0;
        sum += (double)sb_v3_dot(sb_body_displacements(body)[i], x) / radius;
        count++;
    }
    CHECK(count > 0);
    return sum / count;
}

/* Rollers on the coordinate planes of the first `axes` axes. */
static inline void verify_hold_symmetry(sb_body *body, const sb_mesh *mesh, int axes)
{
    for (int i = 0; i < mesh->node_count; i++)
        for (int axis = 0; axis < axes; axis++)
            if (fabs((double)scene_component(mesh->nodes[i], axis)) < 1e-6)
                CHECK_OK(sb_body_fix_nodes(body, &i, 1, 1 << axis));
}

/* Traction (Pa) at x, on reference area with the outward normal n. */
typedef sb_vec3 (*verify_traction)(const void *user, sb_vec3 x, sb_vec3 n);

static inline void verify_load_face(sb_body *body, const sb_mesh *surface, const int *face, verify_traction traction,
                                    const void *user)
{
    int nodes = sb_element_node_count(surface->element_type);
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    int count = sb_element_quadrature(surface->element_type, SB_QUADRATURE_FACE, points, weights);
    sb_vec3 force[SB_MAX_FACE_NODES];
    memset(force, 0, sizeof force);
    for (int q = 0; q < count; q++) {
        sb_real shape[SB_MAX_FACE_NODES], gradient[SB_MAX_FACE_NODES][3], area;
        sb_vec3 x = sb_v3(0, 0, 0), r = x, s = x, n;
        sb_element_shape(surface->element_type, points[q], shape, gradient);
        for (int a = 0; a < nodes; a++) {
            sb_vec3 at = surface->nodes[face[a]];
            x = sb_v3_add(x, sb_v3_scale(shape[a], at));
            r = sb_v3_add(r, sb_v3_scale(gradient[a][0], at));
            s = sb_v3_add(s, sb_v3_scale(gradient[a][1], at));
        }
        n = sb_v3_cross(r, s);
        area = sb_v3_norm(n);
        n = sb_v3_scale(weights[q] * area, traction(user, x, sb_v3_scale(1 / area, n)));
        for (int a = 0; a < nodes; a++)
            force[a] = sb_v3_add(force[a], sb_v3_scale(shape[a], n));
    }
    CHECK_OK(sb_body_add_forces(body, face, nodes, force, 0));
}

/* Adds the consistent nodal forces of a traction on the boundary faces whose nodes all lie there. */
static inline void verify_load(sb_body *body, const sb_mesh *mesh, verify_where where, const void *where_user,
                               verify_traction traction, const void *user)
{
    sb_boundary boundary;
    int faces = 0, nodes;
    if (!CHECK_OK(sb_mesh_boundary(mesh, 0, NULL, &boundary, NULL)))
        return;
    nodes = sb_element_node_count(boundary.surface.element_type);
    for (int f = 0; f < boundary.surface.element_count; f++) {
        const int *face = boundary.surface.elements + (size_t)f * (size_t)nodes;
        int inside = 1;
        for (int a = 0; a < nodes; a++)
            inside = inside && where(where_user, mesh->nodes[face[a]]);
        if (inside) {
            verify_load_face(body, &boundary.surface, face, traction, user);
            faces++;
        }
    }
    CHECK(faces > 0);
    sb_boundary_free(&boundary);
}

/* user: a traction (sb_vec3), the same everywhere. */
static inline sb_vec3 verify_uniform(const void *user, sb_vec3 x, sb_vec3 n)
{
    (void)x;
    (void)n;
    return *(const sb_vec3 *)user;
}

/* user: a pressure (double, Pa), dead. */
static inline sb_vec3 verify_pressure(const void *user, sb_vec3 x, sb_vec3 n)
{
    (void)x;
    return sb_v3_scale(REAL(-*(const double *)user), n);
}

/* Corner nodes of the boundary faces whose nodes all lie there, into faces[], `corners` at a time; returns
 * how many faces. The caller frees *faces. */
static inline int verify_faces(const sb_mesh *mesh, verify_where where, const void *user, int corners, int **faces)
{
    sb_boundary boundary;
    int count = 0, nodes;
    *faces = NULL;
    if (!CHECK_OK(sb_mesh_boundary(mesh, 0, NULL, &boundary, NULL)))
        return 0;
    nodes = sb_element_node_count(boundary.surface.element_type);
    *faces = (int *)malloc((size_t)boundary.surface.element_count * (size_t)corners * sizeof(int));
    for (int f = 0; f < boundary.surface.element_count; f++) {
        const int *face = boundary.surface.elements + (size_t)f * (size_t)nodes;
        int inside = 1;
        for (int a = 0; a < nodes; a++)
            inside = inside && where(user, mesh->nodes[face[a]]);
        if (inside)
            memcpy(*faces + (size_t)(count++ * corners), face, (size_t)corners * sizeof(int));
    }
    CHECK(count > 0);
    sb_boundary_free(&boundary);
    return count;
}

static inline int verify_face_corners(const sb_mesh *mesh)
{
    return sb_element_corner_count(mesh->element_type) == 8 ? 4 : 3;
}

/* Presses on the boundary faces there with a pressure (Pa) that follows them; returns its id. */
static inline int verify_press(sb_body *body, const sb_mesh *mesh, verify_where where, const void *user,
                               double pressure)
{
    int corners = verify_face_corners(mesh), id = 0, *faces;
    int count = verify_faces(mesh, where, user, corners, &faces);
    CHECK_OK(sb_body_add_pressure(body, faces, count, corners, REAL(pressure), &id, NULL));
    free(faces);
    return id;
}

/* Any position. */
static inline int verify_anywhere(const void *user, sb_vec3 x)
{
    (void)user;
    (void)x;
    return 1;
}

/* ---- roots ---- */

/* Root of f between low and high, where its signs differ: bisection to rounding. */
static inline double verify_root(double (*f)(const void *user, double x), const void *user, double low, double high)
{
    double sign = f(user, low);
    CHECK(sign * f(user, high) <= 0);
    for (int k = 0; k < 200; k++) {
        double middle = 0.5 * (low + high);
        if (sign * f(user, middle) > 0)
            low = middle;
        else
            high = middle;
    }
    return 0.5 * (low + high);
}

/* ---- finite inflation of compressible spheres of radii 1 and 2, by quadrature of its differential equation
 * ---- */

typedef struct verify_inflation {
    const verify_material *material;
    double young, poisson, stretch;
} verify_inflation;

/* P_r, and P_t in *side when it is wanted. */
static inline double verify_radial_stress(const verify_inflation *p, double radial, double hoop, double *side)
{
    double l[3], stress[3];
    l[0] = radial;
    l[1] = l[2] = hoop;
    p->material->principal(verify_constants_of(p->young, p->poisson), l, stress);
    if (side)
        *side = stress[1];
    return stress[0];
}

/* d/dR (R^2 P_r) = 2 R P_t for r(R), l_r = r', l_t = r/R: slope of (r, l_r). */
static inline void verify_radial_slope(const verify_inflation *p, double R, const double state[2], double slope[2])
{
    const double step = 1e-5;
    double radial = state[1], hoop = state[0] / R, side;
    double stress = verify_radial_stress(p, radial, hoop, &side);
    double by_radial =
        (verify_radial_stress(p, radial + step, hoop, NULL) - verify_radial_stress(p, radial - step, hoop, NULL)) /
        (2 * step);
    double by_hoop =
        (verify_radial_stress(p, radial, hoop + step, NULL) - verify_radial_stress(p, radial, hoop - step, NULL)) /
        (2 * step);
    slope[0] = radial;
    slope[1] = (2 * (side - stress) / R - by_hoop * (radial - hoop) / R) / by_radial;
}

/* Stress at the outer radius when the sphere starts from r(1) = stretch with the radial stretch `start`. */
static inline double verify_outer_stress(const void *user, double start)
{
    const int steps = 100;
    const verify_inflation *p = (const verify_inflation *)user;
    double state[2], h = 1.0 / steps;
    state[0] = p->stretch;
    state[1] = start;
    for (int s = 0; s < steps; s++) {
        double k[4][2], at[2], R = 1 + s * h;
        verify_radial_slope(p, R, state, k[0]);
        for (int stage = 1; stage < 4; stage++) {
            double w = stage == 3 ? h : h / 2;
            at[0] = state[0] + w * k[stage - 1][0];
            at[1] = state[1] + w * k[stage - 1][1];
            verify_radial_slope(p, R + w, at, k[stage]);
        }
        for (int i = 0; i < 2; i++)
            state[i] += h / 6 * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]);
    }
    return verify_radial_stress(p, state[1], state[0] / 2, NULL);
}

/* Pressure (Pa on the inflated area) that stretches the inner surface by `stretch`, some 1.1. */
static inline double verify_inflation_pressure(const verify_material *material, double young, double poisson,
                                               double stretch)
{
    verify_inflation p;
    p.material = material;
    p.young = young;
    p.poisson = poisson;
    p.stretch = stretch;
    double start = verify_root(verify_outer_stress, &p, 0.68, 1.05);
    return -verify_radial_stress(&p, start, stretch, NULL) / (stretch * stretch);
}

#endif /* VERIFICATION_SCENE_H */
