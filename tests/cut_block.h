/* cut_block.h: a block that tests cut, the cuts, and what holds after each. */
#ifndef CUT_BLOCK_H
#define CUT_BLOCK_H

#ifndef SB_SPLIT_BUILD
#define SB_SPLIT_BUILD
#endif
#include "../src/softbody/cut/cut_private.h"

#include "check.h"
#include "scene.h"

static const int intervals_of[3] = {1, 2, 4};

/* ---- a block that is cut ----------------------------------------------------------------------------------------- */

typedef struct block {
    sb_mesh mesh;
    sb_body *body;
    sb_cut *cut;
} block;

static const sb_vec3 block_size = {REAL(0.06), REAL(0.04), REAL(0.05)};

typedef struct block_options {
    sb_element_type element;
    int nx, ny, nz, lattice, workers;
    double shake;
    sb_integrator integrator;
    double slack;
    sb_cut_front front;
    double toughness;
} block_options;

static inline block_options block_default(int lattice)
{
    block_options options;
    memset(&options, 0, sizeof options);
    options.element = SB_TET4;
    options.nx = 6;
    options.ny = 4;
    options.nz = 5;
    options.lattice = lattice;
    options.shake = 0.2;
    options.integrator = SB_EULER;
    options.slack = 4;
    options.front = SB_CUT_LAG;
    return options;
}

static inline void block_cut_create_tough(block *b, int lattice, sb_cut_front front, double toughness)
{
    sb_cut_def def = sb_default_cut_def();
    sb_error error;
    def.toughness = REAL(toughness);
    def.body = b->body;
    def.lattice = lattice;
    def.front = front;
    def.least_piece = 0;
    if (!CHECK_OK(sb_cut_create(&def, &b->cut, &error)))
        printf("%s\n", error.message);
}

static inline void block_cut_create_with(block *b, int lattice, sb_cut_front front)
{
    block_cut_create_tough(b, lattice, front, 0);
}

static inline void block_cut_create(block *b, int lattice) { block_cut_create_with(b, lattice, SB_CUT_LAG); }

static inline block block_make(const block_options *options)
{
    sb_body_def def = sb_default_body_def();
    block b;
    memset(&b, 0, sizeof b);
    b.mesh = scene_box(options->element, options->nx, options->ny, options->nz, block_size, options->shake);
    def.mesh = &b.mesh;
    def.material = sb_material_corotated(REAL(5000), REAL(0.4), 1000);
    def.slack = REAL(options->slack);
    def.integrator = options->integrator;
    b.body = scene_body(&def);
    block_cut_create_tough(&b, options->lattice, options->front, options->toughness);
    return b;
}

static inline void block_free(block *b)
{
    sb_cut_destroy(b->cut);
    sb_body_destroy(b->body);
    sb_mesh_free(&b->mesh);
}

/* A square of two triangles with this middle and normal. */
static inline void square_make(sb_vec3 middle, sb_vec3 normal, double half, sb_vec3 triangles[6])
{
    sb_vec3 u = sb_v3_perpendicular(normal), v = sb_v3_cross(normal, u), corners[4];
    u = sb_v3_scale(REAL(half) / sb_v3_norm(u), u);
    v = sb_v3_scale(REAL(half) / sb_v3_norm(v), v);
    for (int k = 0; k < 4; k++)
        corners[k] =
            sb_v3_madd(sb_v3_madd(middle, k == 1 || k == 2 ? REAL(1) : REAL(-1), u), k >= 2 ? REAL(1) : REAL(-1), v);
    for (int k = 0; k < 6; k++)
        triangles[k] = corners[k < 3 ? k : k == 3 ? 0 : k - 2];
}

static inline sb_cut_info block_cut(block *b, const sb_vec3 *triangles, int count)
{
    sb_cut_info info;
    sb_error error;
    memset(&info, 0, sizeof info);
    if (!CHECK_OK(sb_cut_triangles(b->cut, triangles, count, &info, &error)))
        printf("%s\n", error.message);
    return info;
}

static inline sb_cut_info block_cut_plane(block *b, sb_vec3 middle, sb_vec3 normal)
{
    sb_vec3 triangles[6];
    square_make(middle, normal, 0.2, triangles);
    return block_cut(b, triangles, 2);
}

static inline void block_step(block *b, int count)
{
    for (int i = 0; i < count; i++)
        CHECK_OK(sb_body_step(b->body, REAL(0.005), NULL));
}

static inline sb_vec3 vector_in(double low, double high, unsigned long long *seed)
{
    double x = check_random_in(seed, low, high), y = check_random_in(seed, low, high);
    return sb_v3(REAL(x), REAL(y), REAL(check_random_in(seed, low, high)));
}

/* Sets it shaking, at up to this speed (m/s). */
static inline void block_shake_at(block *b, double speed)
{
    sb_vec3 *v = (sb_vec3 *)calloc((size_t)sb_body_node_count(b->body), sizeof *v);
    for (int i = 0; i < b->mesh.node_count; i++) {
        sb_vec3 x = b->mesh.nodes[i];
        v[i] = sb_v3(REAL(speed * sin(90 * (double)x.y)), REAL(0.75 * speed * cos(110 * (double)x.z)),
                     REAL(speed * sin(70 * (double)x.x)));
    }
    CHECK_OK(sb_body_set_velocities(b->body, v));
    free(v);
}

static inline void block_shake(block *b) { block_shake_at(b, 2); }

/* ---- what holds after every cut ---------------------------------------------------------------------------------- */

/* Masks and what was taken out divide the lattice, both tets of a face see the same touching pieces as the same nodes,
 * the body's own check, and the numbers of nodes stand for the material at their places. */
static inline void check_pieces(const block *b)
{
    const sb_cut *cut = b->cut;
    sb_error error;
    if (!CHECK_OK(sb_body_live_check(b->body, &error)))
        printf("%s\n", error.message);
    for (int tet = 0; tet < cut->tet_count; tet++) {
        uint64_t all = 0;
        double share = 0;
        int n = cut->nodes_per_tet;
        const int *own = cut->nodes + n * tet;
        sbi_corner_order order = sbi_corner_order_make(cut->tets + 4 * tet);
        for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next) {
            int cell = cut->pieces[piece].cell;
            const int *nodes = sb_body_cell_nodes(b->body, cell);
            CHECK((all & cut->pieces[piece].points) == 0);
            all |= cut->pieces[piece].points;
            share += (double)sb_body_cell_share(b->body, cell);
            CHECK_INT(sb_cut_cell_element(cut, cell), tet);
            for (int a = 0; a < n; a++) {
                CHECK_INT(sb_cut_node_origin(cut, nodes[a]), own[a]);
                CHECK(!(cut->pieces[piece].points >> a & 1) || nodes[a] == own[a]);
            }
            for (int face = 0; face < 4; face++) {
                int other = cut->neighbours.items[4 * tet + face], there = 0;
                sbi_corner_order its;
                if (other < tet)
                    continue;
                while (cut->neighbours.items[4 * other + there] != tet)
                    there++;
                its = sbi_corner_order_make(cut->tets + 4 * other);
                for (int k = sbi_cut_first_piece(cut, other); k >= 0; k = cut->pieces[k].next) {
                    const int *others = sb_body_cell_nodes(b->body, cut->pieces[k].cell);
                    if (!(sbi_lattice_face_marks(&cut->lattice, &order, face, cut->pieces[piece].points) &
                          sbi_lattice_face_marks(&cut->lattice, &its, there, cut->pieces[k].points)))
                        continue;
                    for (int a = 0; a < n; a++)
                        for (int c = 0; c < n; c++)
                            CHECK(own[a] != cut->nodes[n * other + c] || nodes[a] == others[c]);
                }
            }
        }
        CHECK((all & cut->links.lost[tet]) == 0 && (all | cut->links.lost[tet]) == sbi_lattice_all(&cut->lattice));
        if (cut->links.lost[tet] == 0)
            CHECK_NEAR(share, 1, scene_tolerance(1e-13, 64));
        CHECK(share <= 1 + scene_tolerance(1e-13, 64) && (all != 0 || share == 0));
    }
}

/* What a cut may not change; of elastic energy by this share at most. */
typedef struct totals {
    double mass, kinetic, elastic;
    sb_vec3 momentum;
} totals;

static inline totals totals_of(const block *b)
{
    totals t;
    sb_energy energy;
    memset(&energy, 0, sizeof energy);
    CHECK_OK(sb_body_energy(b->body, &energy));
    t.mass = (double)sb_body_mass(b->body);
    t.kinetic = (double)energy.kinetic;
    t.elastic = (double)energy.elastic;
    t.momentum = sb_body_momentum(b->body);
    return t;
}

static inline void check_totals_but(const totals *before, const totals *after, double elastic)
{
    double speed = sqrt(2 * before->kinetic / before->mass);
    CHECK_NEAR(after->mass, before->mass, scene_tolerance(1e-12, 500) * before->mass);
    CHECK_NEAR(sb_v3_norm(sb_v3_sub(after->momentum, before->momentum)), 0,
               scene_tolerance(1e-13, 500) * speed * before->mass);
    CHECK_NEAR(after->kinetic, before->kinetic, scene_tolerance(1e-13, 500) * before->kinetic);
    CHECK_NEAR(after->elastic, before->elastic, elastic * before->elastic);
}

static inline void check_totals(const totals *before, const totals *after)
{
    check_totals_but(before, after, scene_tolerance(1e-12, 1e5));
}

/* Largest difference (Pa) of the stress of any cell with material from a pull along x. */
static inline double block_stress_off(const block *b, double pull)
{
    double most = 0;
    for (int e = 0; e < sb_body_element_count(b->body); e++) {
        sb_mat3 stress;
        if (!sb_body_cell_in_use(b->body, e) || !(sb_body_cell_share(b->body, e) > 0))
            continue;
        CHECK_OK(sb_body_stress(b->body, e, 0, &stress));
        for (int i = 0; i < 9; i++)
            most = fmax(most, fabs((double)stress.m[i / 3][i % 3] - (i ? 0 : pull)));
    }
    return most;
}

/* A blade's way: a strip of quads about a random line. */
static inline int strip_random(sb_vec3 *triangles, unsigned long long *seed)
{
    enum { QUADS = 3 };
    sb_vec3 from = vector_in(-0.01, 0.06, seed), along = vector_in(-0.02, 0.02, seed);
    sb_vec3 edge = vector_in(-0.04, 0.04, seed);
    for (int q = 0; q < QUADS; q++) {
        sb_vec3 turn = sb_v3_add(edge, vector_in(-0.004, 0.004, seed)), to = sb_v3_add(from, along);
        sb_vec3 corners[4];
        corners[0] = from;
        corners[1] = to;
        corners[2] = sb_v3_add(to, turn);
        corners[3] = sb_v3_add(from, edge);
        for (int k = 0; k < 6; k++)
            triangles[6 * q + k] = corners[k < 3 ? k : k == 3 ? 0 : k - 2];
        from = to;
        edge = turn;
    }
    return 2 * QUADS;
}

/* Volumes of the parts, in the order of their first cells; returns how many. */
static inline int part_volumes(const block *b, double *volumes, int capacity)
{
    const sb_body *body = b->body;
    int parts = 0, of[64];
    for (int k = 0; k < 64; k++)
        of[k] = -1;
    for (int e = 0; e < sb_body_element_count(body); e++) {
        int tet = sb_cut_cell_element(b->cut, e), part, at = 0;
        if (!sb_body_cell_in_use(body, e))
            continue;
        part = body->node_component[sb_body_cell_nodes(body, e)[0]];
        while (at < parts && of[at] != part)
            at++;
        if (at == parts && parts < capacity && parts < 64) {
            of[parts] = part;
            volumes[parts++] = 0;
        }
        volumes[at] += (double)sb_body_cell_share(body, e) * (double)sb_mesh_element_volume(&b->mesh, tet);
    }
    return parts;
}

/* Faces of the uncut block, all of its skin or those in the plane x = its length. */
static inline int *skin_faces(const block *b, int end_only, int *count)
{
    const sb_cut *cut = b->cut;
    int *faces = (int *)malloc((size_t)cut->tet_count * 12 * sizeof(int));
    *count = 0;
    for (int tet = 0; tet < cut->tet_count; tet++)
        for (int face = 0; face < 4; face++) {
            int local[SB_MAX_FACE_NODES], at_end = 1;
            sb_element_face(SB_TET4, face, local, NULL);
            for (int k = 0; k < 3; k++) {
                int node = cut->tets[4 * tet + local[k]];
                faces[3 * *count + k] = node;
                at_end &= b->mesh.nodes[node].x > REAL(0.9999) * block_size.x;
            }
            *count += cut->neighbours.items[4 * tet + face] < 0 && (at_end || !end_only);
        }
    return faces;
}

/* A small block whose memory is counted. */
static inline block counted_block_of(scene_memory *memory, sb_element_type element, int nx, double slack,
                                     sb_cut_front front, double toughness)
{
    sb_body_def def = sb_default_body_def();
    sb_cut_def cut = sb_default_cut_def();
    block b;
    memset(&b, 0, sizeof b);
    b.mesh = scene_box(element, nx, 2, 2, block_size, 0);
    def.mesh = &b.mesh;
    def.material = sb_material_corotated(REAL(5000), REAL(0.4), 1000);
    def.slack = REAL(slack);
    def.allocator = scene_allocator(memory);
    b.body = scene_body(&def);
    cut.body = b.body;
    cut.allocator = def.allocator;
    cut.front = front;
    cut.least_piece = 0;
    cut.toughness = REAL(toughness);
    CHECK_OK(sb_cut_create(&cut, &b.cut, NULL));
    return b;
}

static inline block counted_block_tough(scene_memory *memory, int nx, double slack, sb_cut_front front,
                                        double toughness)
{
    return counted_block_of(memory, SB_TET4, nx, slack, front, toughness);
}

static inline block counted_block_with(scene_memory *memory, int nx, double slack, sb_cut_front front)
{
    return counted_block_of(memory, SB_TET4, nx, slack, front, 0);
}

static inline block counted_block(scene_memory *memory, int nx, double slack)
{
    return counted_block_with(memory, nx, slack, SB_CUT_LAG);
}

#endif /* CUT_BLOCK_H */
