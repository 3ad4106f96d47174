/* Tests of the pieces that a coarse space of rigid motions is made of. They are internal. */
#define SB_SPLIT_BUILD
#include "../src/softbody/solve/precond_private.h"

#include "check.h"
#include "scene.h"

/* ---- lips of cuts ---- */

/* Doubles the nodes of a mesh in the planes of nodes x = planes[] whose z, of the mesh's height, is above floor[], for
 * the elements beyond; mesh.nodes has room. */
static void cut_between(sb_mesh *mesh, double size, const double *planes, const double *floors, int count)
{
    int *copy = (int *)malloc((size_t)mesh->node_count * sizeof *copy), whole = mesh->node_count;
    for (int c = 0; c < count; c++) {
        for (int i = 0; i < whole; i++) {
            sb_vec3 x = mesh->nodes[i];
            copy[i] = fabs((double)x.x - planes[c]) < 1e-5 * size && (double)x.z > floors[c] ? mesh->node_count : -1;
            if (copy[i] >= 0)
                mesh->nodes[mesh->node_count++] = x;
        }
        for (int e = 0; e < mesh->element_count; e++) {
            int *corner = mesh->elements + 4 * e;
            double middle = 0;
            for (int k = 0; k < 4; k++)
                middle += (double)mesh->nodes[corner[k]].x / 4;
            for (int k = 0; k < 4; k++)
                corner[k] =
                    middle > planes[c] && corner[k] < whole && copy[corner[k]] >= 0 ? copy[corner[k]] : corner[k];
        }
    }
    free(copy);
}

/* Couplings between node `from` and all others of its piece; -1: not to be reached within it. */
static void piece_ways(const sb_matrix *a, const int *piece_of, int from, int *ways, int *queue)
{
    int met = 1;
    for (int i = 0; i < a->row_count; i++)
        ways[i] = -1;
    queue[0] = from;
    ways[from] = 0;
    for (int head = 0; head < met; head++)
        for (int q = a->row_start[queue[head]]; q < a->row_end[queue[head]]; q++) {
            int j = a->columns[q];
            if (ways[j] < 0 && piece_of[j] == piece_of[from]) {
                ways[j] = ways[queue[head]] + 1;
                queue[met++] = j;
            }
        }
}

/* All nodes are in pieces, that hang together each, and nodes in one place but of two lips are in two. Returns pairs of
 * such nodes that one piece holds. */
static int check_lips(const sb_matrix *a, const sb_mesh *mesh, int wanted, int *made)
{
    size_t n = (size_t)mesh->node_count;
    int *nodes = (int *)malloc((12 * n + 1) * sizeof *nodes), *piece_of = nodes + n, *ways = piece_of + n;
    int *queue = ways + n, *scratch = queue + n, held = 0;
    sb_vec3 *centres = (sb_vec3 *)malloc(n * sizeof *centres);
    *made = sbi_precond_make_pieces(a, mesh->nodes, wanted, scratch, centres, nodes, piece_of, NULL);
    for (int k = 0; k < mesh->node_count; k++) {
        int i = nodes[k];
        CHECK(piece_of[i] >= 0 && piece_of[i] < *made);
        if (k > 0 && piece_of[nodes[k - 1]] == piece_of[i])
            continue;
        piece_ways(a, piece_of, i, ways, queue);
        for (int j = 0; j < mesh->node_count; j++)
            CHECK(piece_of[j] != piece_of[i] || ways[j] >= 0);
    }
    for (int i = 0; i < mesh->node_count; i++)
        for (int j = i + 1; j < mesh->node_count; j++) {
            if (piece_of[i] != piece_of[j] || memcmp(mesh->nodes + i, mesh->nodes + j, sizeof(sb_vec3)) != 0)
                continue;
            piece_ways(a, piece_of, i, ways, queue);
            held += ways[j] > 2;
        }
    free(nodes);
    free(centres);
    return held;
}

/* Random cuts between the elements of a block that end in it: pieces do not straddle them. */
static void test_lips(void)
{
    enum { CUTS = 4 };
    unsigned long long seed = 12;
    int most_pieces = 0;
    for (int trial = 0; trial < (check_quick() ? 6 : 30); trial++) {
        const double size = pow(10, trial % 3 * 3 - 3), length = size, depth = 0.3 * size;
        const int wanted = 3 + trial % 20, nx = 8 + trial % 5;
        sb_mesh mesh = scene_box(SB_TET4, nx, 4, 5, sb_v3(REAL(length), REAL(depth), REAL(depth)), 0), cut = mesh;
        double planes[CUTS], floors[CUTS];
        int count = 1 + trial % (int)CUTS, made, whole;
        sb_matrix a;
        CHECK_OK(sb_matrix_create(mesh.node_count, mesh.element_count, 4, NULL, mesh.elements, NULL, &a, NULL));
        CHECK_INT(check_lips(&a, &mesh, wanted, &whole), 0);
        sb_matrix_free(&a);
        for (int c = 0; c < count; c++) { /* in planes of their own */
            planes[c] = length * (1 + c * (nx - 1) / count) / nx;
            floors[c] = check_random_in(&seed, 0.05, 0.7) * depth;
        }
        cut.nodes = (sb_vec3 *)malloc(2 * (size_t)mesh.node_count * sizeof *cut.nodes);
        memcpy(cut.nodes, mesh.nodes, (size_t)mesh.node_count * sizeof *cut.nodes);
        cut_between(&cut, size, planes, floors, count);
        CHECK(cut.node_count > mesh.node_count);
        CHECK_OK(sb_matrix_create(cut.node_count, cut.element_count, 4, NULL, cut.elements, NULL, &a, NULL));
        CHECK(check_lips(&a, &cut, wanted, &made) == 0 || made >= 2 * wanted);
        CHECK(made <= 2 * wanted + 8);
        most_pieces = sbi_max_int(most_pieces, made - whole);
        sb_matrix_free(&a);
        free(cut.nodes);
        sb_mesh_free(&mesh);
    }
    CHECK(most_pieces > 2);
}

CHECK_SUITE(precond_pieces, {"lips", test_lips});
