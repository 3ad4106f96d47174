/* cut_beam.h: bodies with sharp values for what a cut does to them: the half-cut beam and the edge-cracked plate. */
#ifndef CUT_BEAM_H
#define CUT_BEAM_H

#include "cut_block.h"

/* ---- the half-cut beam of Suwelack (2014), 8.1.4 ----------------------------------------------------------------- */

static const sb_vec3 beam_size = {REAL(0.2), REAL(0.03), REAL(0.06)};

static inline block cantilever(sb_element_type element, const int cells[3], sb_vec3 size, sb_material material,
                               int lattice, sb_cut_front front)
{
    sb_body_def def = sb_default_body_def();
    block b;
    memset(&b, 0, sizeof b);
    b.mesh = scene_box(element, cells[0], cells[1], cells[2], size, 0);
    def.mesh = &b.mesh;
    def.material = material;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.slack = 1;
    b.body = scene_body(&def);
    scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
    block_cut_create_with(&b, lattice, front);
    return b;
}

static inline block beam_of(sb_element_type element, const int cells[3], int lattice, sb_cut_front front)
{
    return cantilever(element, cells, beam_size, sb_material_linear(REAL(300e3), REAL(0.35), 1000), lattice, front);
}

/* A blade across the beam that goes down from above to z, on an arc of radius `bend` (0: straight), in so many frames;
 * `released`: the sum of all frames. A hair off the middles of edges, which rounding would put on either side. */
static inline sb_cut_info beam_cut(block *b, double bend, double to, int frames, double *released)
{
    const double top = 0.06, from = 0.065;
    sb_cut_info info;
    sb_error error;
    int stroke = -1;
    memset(&info, 0, sizeof info);
    *released = 0;
    for (int i = 0; i <= frames; i++) {
        double z = from + (to - from) * i / frames, depth = fmax(top - z, 0);
        double x = 0.10002 + (bend > 0 ? bend - sqrt(bend * bend - depth * depth) : 0);
        sb_vec3 edge[2];
        edge[0] = sb_v3(REAL(x), REAL(-0.01), REAL(z));
        edge[1] = sb_v3(REAL(x), REAL(0.04), REAL(z));
        if (i == 0)
            CHECK_OK(sb_cut_begin(b->cut, edge, 2, &stroke, &error));
        else if (!CHECK_OK(sb_cut_move(b->cut, stroke, edge, &info, &error)))
            printf("%s\n", error.message);
        *released += (double)info.released_area;
    }
    sb_cut_end(b->cut, stroke);
    return info;
}

static inline double beam_sag(block *b, int *iterations)
{
    sb_step_info info;
    double sum = 0;
    int count = 0;
    sb_static_options options = sb_default_static_options();
    options.tolerance = REAL(scene_tolerance(1e-9, 1e4));
    if (!CHECK_OK(sb_body_solve_static(b->body, &options, &info)))
        printf("%s\n", info.error.message);
    *iterations = info.pcg_iterations;
    for (int i = 0; i < b->mesh.node_count; i++)
        if (b->mesh.nodes[i].x > beam_size.x - REAL(1e-6)) {
            sum += (double)sb_body_displacements(b->body)[i].z;
            count++;
        }
    return sum / count;
}

/* Curved strokes open more than those that lag, as far as their blade has come. */
static inline void beam_check_curved(sb_element_type element, int lattice)
{
    static const int cells[3] = {21, 4, 7};
    static const double bends[2] = {0.0331, 0.0302};
    for (int k = 0; k < 2; k++) {
        block lag = beam_of(element, cells, lattice, SB_CUT_LAG), glue = beam_of(element, cells, lattice, SB_CUT_GLUE);
        double released, sag;
        int iterations;
        beam_cut(&lag, bends[k], 0.031, 24, &released);
        beam_cut(&glue, bends[k], 0.031, 24, &released);
        sag = beam_sag(&lag, &iterations);
        CHECK(beam_sag(&glue, &iterations) < 1.003 * sag);
        check_pieces(&glue);
        block_free(&lag);
        block_free(&glue);
    }
}

/* ---- the edge-cracked plate -------------------------------------------------------------------------------------- */

/* Pulls at the faces of the body in the plane y = place by t (N/m^2) along y. */
static inline void pull_faces(block *b, double place, double t)
{
    const sb_mesh *mesh = &b->mesh;
    for (int e = 0; e < mesh->element_count; e++)
        for (int face = 0; face < 4; face++) {
            int local[SB_MAX_FACE_NODES], nodes[3], on = 0;
            sb_element_face(SB_TET4, face, local, NULL);
            for (int k = 0; k < 3; k++) {
                nodes[k] = mesh->elements[sb_element_node_count(mesh->element_type) * e + local[k]];
                on += fabs((double)mesh->nodes[nodes[k]].y - place) < 1e-9;
            }
            if (on == 3)
                CHECK_OK(sb_body_add_traction(b->body, nodes, 1, 3, sb_v3(0, REAL(t), 0), NULL));
        }
}

/* Elastic energy per thickness of a plate 1 x 2 in plane strain, pulled by 1, with a crack of length a. */
static inline double plate_energy(sb_element_type element, int n, double a, sb_cut_front front)
{
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    double depth = 1.0 / n;
    sb_vec3 size = sb_v3(1, 2, REAL(depth)), edge[2];
    sb_energy energy;
    sb_step_info info;
    block b;
    int stroke, corner = -1, other = -1;
    memset(&b, 0, sizeof b);
    memset(&energy, 0, sizeof energy);
    b.mesh = scene_box(element, n, 2 * n + 1, 1, size, 0);
    def.mesh = &b.mesh;
    def.material = sb_material_linear(1, REAL(0.3), 1);
    def.slack = 1;
    b.body = scene_body(&def);
    for (int i = 0; i < b.mesh.node_count; i++) {
        sb_vec3 x = b.mesh.nodes[i];
        CHECK_OK(sb_body_fix_nodes(b.body, &i, 1, SB_Z));
        if (x.z < REAL(1e-9) && x.x > REAL(1 - 1e-9) && x.y < REAL(1e-9))
            corner = i;
        if (x.z < REAL(1e-9) && x.x > REAL(1 - 1e-9) && x.y > REAL(2 - 1e-9))
            other = i;
    }
    CHECK_OK(sb_body_fix_nodes(b.body, &corner, 1, SB_X | SB_Y));
    CHECK_OK(sb_body_fix_nodes(b.body, &other, 1, SB_X));
    block_cut_create_with(&b, 2, front);
    pull_faces(&b, 0, -1);
    pull_faces(&b, 2, 1);
    edge[0] = sb_v3(REAL(-0.1), 1, REAL(-0.1)), edge[1] = sb_v3(REAL(-0.1), 1, REAL(depth + 0.1));
    CHECK_OK(sb_cut_begin(b.cut, edge, 2, &stroke, NULL));
    edge[0].x = edge[1].x = REAL(a);
    CHECK_OK(sb_cut_move(b.cut, stroke, edge, NULL, NULL));
    options.tolerance = REAL(1e-9);
    if (!CHECK_OK(sb_body_solve_static(b.body, &options, &info)))
        printf("%s\n", info.error.message);
    CHECK_OK(sb_body_energy(b.body, &energy));
    block_free(&b);
    return (double)energy.elastic / depth;
}

/* Energy release rate at a crack of length a: K = F sqrt(pi a) (Tada, Paris and Irwin), K^2 (1 - nu^2)/E. */
static inline double plate_rate(double a)
{
    double f = 1.122 - 0.231 * a + 10.55 * a * a - 21.71 * a * a * a + 30.382 * a * a * a * a;
    return f * f * 3.14159265358979 * a * (1 - 0.3 * 0.3);
}

/* Error of the stress intensity from energies at a +- 2 h, beside what they would be. */
static inline double plate_error(sb_element_type element, int n, sb_cut_front front)
{
    double a = 0.5, h = 1.0 / n, exact = 0;
    double rate = (plate_energy(element, n, a + 2 * h, front) - plate_energy(element, n, a - 2 * h, front)) / (4 * h);
    for (int i = 0; i < 100; i++)
        exact += plate_rate(a + (i - 49.5) / 25 * h) / 100;
    return sqrt(rate / exact) - 1;
}

#endif /* CUT_BEAM_H */
