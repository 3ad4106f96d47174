/* Cut bodies against sign X-FEM: the same functions, so the same algebra. Unknowns of X-FEM are the displacements u_J
 * of the mesh's nodes and the jumps A_J of enriched ones, u(x) = sum_J N_J u_J + N_J (H(x) - H(x_J)) A_J with H = 1 on
 * one side of the cut and -1 on the other (Suwelack 2014, 8.1.2, shifted). A copy of node J has u_J - 2 H(x_J) A_J: the
 * transformation T of X-FEM's unknowns to the body's, and T^T K T is X-FEM's stiffness. */
#include "cut_block.h"

enum { SELF = 0, JUMP = 1 };

typedef struct enriched {
    const block *b;
    sb_vec3 middle, normal; /* of the cut */
    int *copies;            /* [mesh nodes] -1: not enriched */
    sb_vec3 *u[2];          /* [mesh nodes] unknowns */
    sb_vec3 *force[2];      /* K u, */
    sb_vec3 *momentum[2];   /* M u with the consistent mass, */
    sb_vec3 *lumped[2];     /* and with lumps int w_a dV */
} enriched;

static double side_of(const enriched *x, sb_vec3 at)
{
    return sb_v3_dot(x->normal, sb_v3_sub(at, x->middle)) > 0 ? 1 : -1;
}

static enriched enriched_make(const block *b, sb_vec3 middle, sb_vec3 normal, unsigned long long *seed)
{
    size_t n = (size_t)b->mesh.node_count;
    sb_vec3 *all = (sb_vec3 *)calloc(8 * n, sizeof *all);
    enriched x;
    x.b = b, x.middle = middle, x.normal = normal;
    x.copies = (int *)malloc(n * sizeof *x.copies);
    for (int k = 0; k < 2; k++) {
        x.u[k] = all + (size_t)k * n;
        x.force[k] = all + (size_t)(2 + k) * n;
        x.momentum[k] = all + (size_t)(4 + k) * n;
        x.lumped[k] = all + (size_t)(6 + k) * n;
    }
    for (size_t i = 0; i < n; i++)
        x.copies[i] = -1;
    for (int i = b->mesh.node_count; i < sb_body_node_count(b->body); i++)
        if (CHECK_INT(x.copies[sb_cut_node_origin(b->cut, i)], -1)) /* one plane has two sides */
            x.copies[sb_cut_node_origin(b->cut, i)] = i;
    for (size_t i = 0; i < n; i++) {
        x.u[SELF][i] = vector_in(-1e-3, 1e-3, seed);
        x.u[JUMP][i] = x.copies[i] < 0 ? sb_v3(0, 0, 0) : vector_in(-1e-3, 1e-3, seed);
    }
    return x;
}

static void enriched_free(enriched *x)
{
    free(x->copies);
    free(x->u[0]);
}

/* ---- X-FEM, element by element ----------------------------------------------------------------------------------- */

/* The side that a piece's points are on; of a whole tet ahead of the cut, which is on both and has no jumps, 0. */
static double piece_side(const enriched *x, const sbi_parted *parted, const sb_vec3 *corners, int piece)
{
    double side = 0;
    for (int p = 0; p < parted->lattice->point_count; p++)
        if (parted->pieces[piece] >> p & 1) {
            sb_real at[4];
            double its;
            sbi_lattice_point(parted->lattice, p, at);
            its = side_of(x, sbi_lattice_place(&parted->order, at, corners));
            if (side != 0 && side != its)
                return 0;
            side = its;
        }
    return side;
}

/* Weights whose integrals are lumped masses: of tet10 those of "Integration and mass" in the design of cuts. */
static void lump_weights(int n, const sb_real xi[3], double *w)
{
    const double l[4] = {1 - (double)(xi[0] + xi[1] + xi[2]), (double)xi[0], (double)xi[1], (double)xi[2]};
    for (int a = 0; a < 4; a++)
        w[a] = n == 4 ? l[a] : 5.0 / 18 * l[a] * l[a];
    for (int a = 4; a < n; a++) {
        int ends[3];
        sb_element_edge(SB_TET10, a - 4, ends);
        w[a] = 2 * l[ends[0]] * l[ends[1]] + 13.0 / 54 * (l[ends[0]] * l[ends[0]] + l[ends[1]] * l[ends[1]]);
    }
}

static void add_to(sb_vec3 *const rows[2], int node, double jump, double weight, sb_vec3 value)
{
    rows[SELF][node] = sb_v3_madd(rows[SELF][node], REAL(weight), value);
    rows[JUMP][node] = sb_v3_madd(rows[JUMP][node], REAL(jump * weight), value);
}

/* Adds what a point of the quadrature stands for, `volume` (m^3) of a piece on this side. */
static void add_point(enriched *x, const int *nodes, const sb_vec3 *corners, const sb_real xi[3], double volume,
                      double side)
{
    const sb_mesh *mesh = &x->b->mesh;
    const sb_material *material = x->b->body->materials;
    int n = sb_element_node_count(mesh->element_type);
    sb_real shape[10], local[10][3];
    sb_mat3 edges = sb_m3_columns(sb_v3_sub(corners[1], corners[0]), sb_v3_sub(corners[2], corners[0]),
                                  sb_v3_sub(corners[3], corners[0]));
    sb_mat3 to_space = sb_m3_transpose(sb_m3_inverse(edges)), gradient = sb_m3_zero(), stress;
    sb_vec3 g[10], u[10], value = {0, 0, 0};
    double jump[10], w[10];
    sb_element_shape(mesh->element_type, xi, shape, local);
    lump_weights(n, xi, w);
    for (int a = 0; a < n; a++) {
        jump[a] = side - side_of(x, mesh->nodes[nodes[a]]);
        u[a] = sb_v3_madd(x->u[SELF][nodes[a]], REAL(jump[a]), x->u[JUMP][nodes[a]]);
        g[a] = sb_m3_apply(to_space, sb_v3(local[a][0], local[a][1], local[a][2]));
        gradient = sb_m3_add(gradient, sb_m3_outer(u[a], g[a]));
        value = sb_v3_madd(value, shape[a], u[a]);
    }
    stress = sb_m3_scale(material->mu, sb_m3_add(gradient, sb_m3_transpose(gradient)));
    stress = sb_m3_add(stress, sb_m3_scale(material->lambda * sb_m3_trace(gradient), sb_m3_identity()));
    for (int a = 0; a < n; a++) {
        double mass = volume * (double)material->density;
        add_to(x->force, nodes[a], jump[a], volume, sb_m3_apply(stress, g[a]));
        add_to(x->momentum, nodes[a], jump[a], mass * (double)shape[a], value);
        add_to(x->lumped, nodes[a], jump[a], mass * w[a], u[a]);
    }
}

/* Integrates a tet over the flags of its pieces, by four points each, exact to degree 2. */
static void add_tet(enriched *x, int tet)
{
    static const double far = 0.13819660112501051518, near = 0.58541019662496845446;
    const sb_cut *cut = x->b->cut;
    const int *nodes = cut->nodes + cut->nodes_per_tet * tet;
    double volume = (double)sb_mesh_element_volume(&x->b->mesh, tet);
    sbi_parted parted;
    double sides[SBI_LATTICE_POINTS];
    sb_vec3 corners[4];
    for (int a = 0; a < 4; a++)
        corners[a] = x->b->mesh.nodes[nodes[a]];
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * tet, tet, &parted);
    for (int k = 0; k < parted.piece_count; k++) {
        sides[k] = piece_side(x, &parted, corners, k);
        CHECK(sides[k] != 0 || parted.piece_count == 1);
        for (int a = 0; a < cut->nodes_per_tet && sides[k] == 0; a++)
            CHECK_INT(x->copies[nodes[a]], -1);
    }
    for (int micro = 0; micro < cut->lattice.micro_count; micro++) {
        sbi_flag flags[SBI_FLAGS];
        int count = sbi_parted_flags(&parted, micro, 0, flags);
        for (int k = 0; k < count; k++)
            for (int q = 0; q < 4; q++) {
                sb_vec3 at = {0, 0, 0};
                sb_real xi[3];
                for (int v = 0; v < 4; v++)
                    at = sb_v3_madd(at, REAL(v == q ? near : far), flags[k].corners[v]);
                xi[0] = at.x, xi[1] = at.y, xi[2] = at.z;
                add_point(x, nodes, corners, xi, volume * (double)flags[k].volume / 4, sides[flags[k].piece]);
            }
    }
}

/* ---- the body, by T ---------------------------------------------------------------------------------------------- */

/* The body's displacements T u. */
static void enriched_to_body(const enriched *x, sb_vec3 *u)
{
    for (int i = 0; i < x->b->mesh.node_count; i++) {
        double side = side_of(x, x->b->mesh.nodes[i]);
        u[i] = x->u[SELF][i];
        if (x->copies[i] >= 0)
            u[x->copies[i]] = sb_v3_madd(u[i], REAL(-2 * side), x->u[JUMP][i]);
    }
}

/* Compares T^T of what the body has at its nodes. */
static void compare(const enriched *x, sb_vec3 *const rows[2], const sb_vec3 *of_body, double tolerance)
{
    double size = 0, worst = 0;
    for (int i = 0; i < x->b->mesh.node_count; i++) {
        double side = side_of(x, x->b->mesh.nodes[i]);
        sb_vec3 copy = x->copies[i] < 0 ? sb_v3(0, 0, 0) : of_body[x->copies[i]];
        sb_vec3 off = sb_v3_sub(rows[SELF][i], sb_v3_add(of_body[i], copy));
        size = fmax(size, (double)sb_v3_norm(rows[SELF][i]));
        worst = fmax(worst, (double)sb_v3_norm(off));
        if (x->copies[i] >= 0)
            worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(rows[JUMP][i], sb_v3_scale(REAL(-2 * side), copy))));
    }
    CHECK(size > 0);
    CHECK_NEAR(worst, 0, tolerance * size);
}

static void compare_body(const enriched *x)
{
    sb_body *body = x->b->body;
    size_t n = (size_t)sb_body_node_count(body);
    sb_vec3 *u = (sb_vec3 *)calloc(2 * n, sizeof *u), *f = u + n;
    int linear = x->b->mesh.element_type == SB_TET4;
    double tolerance = scene_tolerance(1e-12, 1e3);
    enriched_to_body(x, u);
    CHECK(sbi_assembly_force(&body->assembly, u, f) < 0);
    for (size_t i = 0; i < n; i++) /* rows that hold middles of small pieces are no X-FEM */
        f[i] = sb_v3_scale(-1, f[i]);
    sbi_rows_add_force(&body->live->slivers, u, f);
    for (size_t i = 0; i < n; i++)
        f[i] = sb_v3_scale(-1, f[i]);
    compare(x, x->force, f, tolerance);
    for (size_t i = 0; i < n; i++)
        f[i] = sb_v3_scale(body->lumped_mass[i], u[i]);
    compare(x, x->lumped, f, tolerance);
    if (linear) { /* of pieces of a tet10 the mass is that of four points */
        const sb_matrix *a = &body->matrix;
        sb_real *mass = (sb_real *)malloc((size_t)a->block_count * sizeof *mass); /* times the identity */
        sbi_body_mass_blocks(body, SB_MASS_CONSISTENT, mass);
        for (size_t i = 0; i < n; i++) {
            f[i] = sb_v3(0, 0, 0);
            for (int q = a->row_start[i]; q < a->row_end[i]; q++)
                f[i] = sb_v3_madd(f[i], mass[q], u[a->columns[q]]);
        }
        free(mass);
        compare(x, x->momentum, f, tolerance);
    }
    free(u);
}

/* Cuts through all of the block and into its middle, at random, with corners of a slice of any size. */
static void test_same_algebra(void)
{
    static const sb_element_type elements[2] = {SB_TET4, SB_TET10};
    unsigned long long seed = 31;
    int ends = 0, rounds = check_quick() ? 2 : 6;
    for (int k = 0; k < 2; k++)
        for (int round = 0; round < rounds; round++) {
            block_options options = block_default(intervals_of[round % 3]);
            sb_material material = sb_material_linear(REAL(5000), REAL(0.4), 1000);
            sb_vec3 middle, normal, triangles[6];
            enriched x;
            block b;
            options.element = elements[k];
            options.nx = 4, options.ny = options.nz = 3;
            b = block_make(&options);
            CHECK_OK(sb_body_set_material(b.body, &material, NULL));
            middle = sb_v3_add(sb_v3_scale(REAL(0.5), block_size), vector_in(-0.01, 0.01, &seed));
            normal = vector_in(-1, 1, &seed);
            square_make(middle, normal, round % 2 ? 0.2 : 0.025, triangles);
            CHECK(block_cut(&b, triangles, 2).nodes > 0);
            x = enriched_make(&b, middle, normal, &seed);
            for (int tet = 0; tet < b.cut->tet_count; tet++)
                add_tet(&x, tet);
            compare_body(&x);
            for (int i = 0; i < b.mesh.node_count; i++)
                ends += round % 2 == 0 && x.copies[i] < 0;
            enriched_free(&x);
            block_free(&b);
        }
    CHECK(ends > 0);
}

CHECK_SUITE(cut_xfem, {"same algebra as with jumps for unknowns", test_same_algebra});
