/* A half-cut beam, glued ahead of the blade, against meshes whose faces lie along the cut. */
#include "cut_figures.h"

#include "verification.h"

typedef struct beam_figures {
    double sag, opening, pull; /* m, m, N */
} beam_figures;

static const double CUT = 0.1, FRONT = 0.03; /* m: where the cut is, and how far down it goes */

/* Gives the nodes of the cut, but for those of its front, a second copy each, which the elements beyond it get: room in
 * nodes[] for all of them. Returns how many nodes there are. */
static int part_mesh(sb_mesh *mesh, sb_vec3 *nodes)
{
    int all = mesh->node_count, *copies = (int *)malloc((size_t)all * sizeof(int));
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 x = nodes[i] = mesh->nodes[i];
        copies[i] = fabs((double)x.x - CUT) < 1e-7 && (double)x.z > FRONT + 1e-7 ? all++ : i;
        nodes[copies[i]] = x;
    }
    for (int e = 0; e < mesh->element_count; e++) {
        int *of = mesh->elements + 10 * e;
        double x = 0;
        for (int a = 0; a < 4; a++)
            x += (double)mesh->nodes[of[a]].x / 4;
        for (int a = 0; a < 10 && x > CUT; a++)
            of[a] = copies[of[a]];
    }
    free(copies);
    return all;
}

/* How far the copies of the nodes of the top edge are from these (m). */
static double edge_opening(const block *b, int first_copy)
{
    double sums[2] = {0, 0};
    int count = 0;
    for (int i = 0; i < b->mesh.node_count; i++) {
        sb_vec3 x = b->mesh.nodes[i];
        if (fabs((double)x.x - CUT) > 1e-7 || x.z < beam_size.z - REAL(1e-6))
            continue;
        sums[i >= first_copy] += (double)sb_body_displacements(b->body)[i].x;
        count += i >= first_copy;
    }
    return (sums[1] - sums[0]) / count;
}

/* A beam of 10 x 2 x 4 cells, each divided so many times, that is cut by its mesh. */
static beam_figures conforming_beam(int divided)
{
    sb_mesh mesh = scene_box(SB_TET10, 10 * divided, 2 * divided, 4 * divided, beam_size, 0);
    sb_vec3 *nodes = (sb_vec3 *)malloc(2 * (size_t)mesh.node_count * sizeof(sb_vec3));
    sb_body_def def = sb_default_body_def();
    beam_figures found;
    int iterations;
    block b;
    memset(&b, 0, sizeof b);
    b.mesh = mesh;
    b.mesh.node_count = part_mesh(&mesh, nodes);
    b.mesh.nodes = nodes;
    def.mesh = &b.mesh;
    def.material = sb_material_linear(REAL(300e3), REAL(0.35), 1000);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    b.body = scene_body(&def);
    scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
    found.sag = beam_sag(&b, &iterations);
    found.opening = edge_opening(&b, mesh.node_count);
    found.pull = beam_pull(&b);
    sb_body_destroy(b.body);
    sb_mesh_free(&mesh);
    free(nodes);
    return found;
}

static beam_figures glued_beam(const int cells[3])
{
    block b = beam_of(SB_TET10, cells, 1, SB_CUT_GLUE);
    beam_figures found;
    double released;
    int iterations;
    beam_cut(&b, 0, 0.02998, 1, &released);
    found.sag = beam_sag(&b, &iterations);
    found.opening = beam_opening(&b);
    found.pull = beam_pull(&b);
    block_free(&b);
    return found;
}

/* Errors of bodies with a crack are of the first order: what two meshes go to, one with half the edges. */
static double limit_of(double coarse, double fine) { return 2 * fine - coarse; }

static void test_half_cut(void)
{
    static const int cells[3][3] = {{11, 2, 3}, {21, 4, 7}, {31, 5, 9}};
    static const double bounds[3][3] = {{0.08, 0.15, 0.03}, {0.025, 0.04, 0.012}, {0.015, 0.03, 0.006}};
    beam_figures coarse = conforming_beam(1), fine = conforming_beam(2);
    double sag = limit_of(coarse.sag, fine.sag), opening = limit_of(coarse.opening, fine.opening);
    double pull = limit_of(coarse.pull, fine.pull);
    verify("half-cut beam, conforming 20 x 4 x 8", "tet10", "10 x 2 x 4 and 20 x 4 x 8, extrapolated",
           "sag of the end (m)", sag, fine.sag, 0.05);
    verify("half-cut beam, conforming 20 x 4 x 8", "tet10", "10 x 2 x 4 and 20 x 4 x 8, extrapolated",
           "force for 2 mm (N)", pull, fine.pull, 0.04);
    for (int k = 0; k < 3; k++) {
        beam_figures found = glued_beam(cells[k]);
        char name[80];
        snprintf(name, sizeof name, "half-cut beam, glue, %d x %d x %d", cells[k][0], cells[k][1], cells[k][2]);
        verify(name, "tet10", "conforming meshes, extrapolated", "sag of the end (m)", sag, found.sag, bounds[k][0]);
        verify(name, "tet10", "conforming meshes, extrapolated", "opening at the top (m)", opening, found.opening,
               bounds[k][1]);
        verify(name, "tet10", "conforming meshes, extrapolated", "force for 2 mm (N)", pull, found.pull, bounds[k][2]);
    }
}

static void test_table(void) { verify_table("verification_cut"); }

CHECK_SUITE(verification_cut, {"half-cut beam", test_half_cut}, {"table", test_table});
