/* contact_skin_blocks: the stiffness of faces of a skin in the body's matrix, and beside it. */
#include <string.h>

#include "../body/body_private.h"
#include "contact_private.h"

/* Distinct nodes of a face's points, with the weights of each point. */
typedef struct sbi_skin_union {
    int count; /* 0: more than a cell has */
    int nodes[SB_MAX_ELEMENT_NODES];
    sb_real weights[3][SB_MAX_ELEMENT_NODES];
} sbi_skin_union;

static void sbi_skin_unite(const sb_contact *contact, int face, sbi_skin_union *all)
{
    const sbi_contact_skin *skin = &contact->skin;
    const int *points = sbi_contact_face_nodes(contact->faces, face);
    memset(all, 0, sizeof *all);
    for (int p = 0; p < 3; p++) {
        const sbi_contact_row row = sbi_contact_skin_row(skin, points[p]);
        for (int i = 0; i < row.count; i++) {
            int at = 0;
            while (at < all->count && all->nodes[at] != row.nodes[i])
                at++;
            if (at == skin->width) {
                all->count = 0;
                return;
            }
            all->count += at == all->count;
            all->nodes[at] = row.nodes[i];
            all->weights[p][at] = row.weights[i];
        }
    }
}

/* 1 when all pairs of nodes have blocks. */
static int sbi_skin_is_whole(const sb_contact *contact, const sbi_skin_union *all)
{
    const sb_matrix *matrix = &contact->body->matrix;
    for (int a = 0; a < all->count; a++)
        for (int b = 0; b < a; b++)
            if (sb_matrix_find(matrix, all->nodes[a], all->nodes[b]) < 0)
                return 0;
    return all->count > 0;
}

/* The same, kept by face: in the first of its numbers of blocks. */
static int sbi_skin_face_is_whole(sb_contact *contact, int face, const sbi_skin_union *all)
{
    sbi_contact_faces *faces = contact->faces;
    int *kept = faces->blocks + (size_t)face * (size_t)(faces->width * faces->width);
    if (faces->versions[face] != contact->body->pattern_version)
        *kept = sbi_skin_is_whole(contact, all);
    faces->versions[face] = contact->body->pattern_version;
    return *kept;
}

/* matrix += a block between two nodes, which is kept as it was. */
static void sbi_skin_add_block(sb_contact *contact, const unsigned char *masked, sb_matrix *matrix, int row, int column,
                               const sb_real *block)
{
    int place = sb_matrix_find(matrix, row, column);
    sbi_contact_saved *saved = contact->saved + contact->saved_count++;
    saved->block = place;
    memcpy(saved->values, matrix->blocks[place], sizeof saved->values);
    sbi_contact_add_block(matrix->blocks[place], block, masked ? masked[row] : 0u, masked ? masked[column] : 0u);
}

/* W^T K W of a face in one cell. */
static void sbi_skin_add_whole(sb_contact *contact, const unsigned char *masked, sb_matrix *matrix,
                               const sbi_skin_union *all, const sb_real (*k)[9])
{
    for (int i = 0; i < all->count; i++)
        for (int j = 0; j < all->count; j++) {
            sb_real block[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
            for (int ab = 0; ab < 9; ab++) {
                sb_real w = all->weights[ab / 3][i] * all->weights[ab % 3][j];
                for (int c = 0; c < 9 && w != 0; c++)
                    block[c] += w * k[ab][c];
            }
            sbi_skin_add_block(contact, masked, matrix, all->nodes[i], all->nodes[j], block);
        }
}

/* W^T B W of a face between cells, and B taken off K. */
static void sbi_skin_add_lumped(sb_contact *contact, const unsigned char *masked, sb_matrix *matrix, int face,
                                sb_real (*k)[9])
{
    const int *points = sbi_contact_face_nodes(contact->faces, face);
    for (int p = 0; p < 3; p++) {
        const sbi_contact_row row = sbi_contact_skin_row(&contact->skin, points[p]);
        sb_real b[9], block[9];
        for (int c = 0; c < 9; c++)
            b[c] = k[3 * p][c] + k[3 * p + 1][c] + k[3 * p + 2][c];
        for (int i = 0; i < row.count * row.count; i++) {
            for (int c = 0; c < 9; c++)
                block[c] = row.weights[i / row.count] * row.weights[i % row.count] * b[c];
            sbi_skin_add_block(contact, masked, matrix, row.nodes[i / row.count], row.nodes[i % row.count], block);
        }
        for (int c = 0; c < 9; c++)
            k[4 * p][c] -= b[c];
    }
}

/* 1 when all blocks of a face between cells can still be saved. */
static int sbi_skin_has_room(const sb_contact *contact, int face)
{
    const int *points = sbi_contact_face_nodes(contact->faces, face);
    int needed = 0;
    for (int p = 0; p < 3; p++)
        needed += contact->skin.counts[points[p]] * contact->skin.counts[points[p]];
    return needed <= contact->skin.most_saved - contact->saved_count;
}

SBI_API void sbi_contact_skin_add_face(sb_contact *contact, const unsigned char *masked, sb_matrix *matrix, int face,
                                       const sb_real (*k)[9])
{
    sbi_contact_skin *skin = &contact->skin;
    sbi_contact_cross *cross = skin->cross + skin->cross_count;
    sbi_skin_union all;
    sbi_skin_unite(contact, face, &all);
    if (sbi_skin_face_is_whole(contact, face, &all) &&
        all.count * all.count <= skin->most_saved - contact->saved_count) {
        sbi_skin_add_whole(contact, masked, matrix, &all, k);
        return;
    }
    skin->cross_count++;
    cross->face = face;
    memcpy(cross->blocks, k, sizeof cross->blocks);
    if (sbi_skin_has_room(contact, face)) /* else all of it is beside the matrix: more iterations */
        sbi_skin_add_lumped(contact, masked, matrix, face, cross->blocks);
}

static sb_vec3 sbi_skin_times(const sb_real *m, sb_vec3 v)
{
    return sb_v3(m[0] * v.x + m[1] * v.y + m[2] * v.z, m[3] * v.x + m[4] * v.y + m[5] * v.z,
                 m[6] * v.x + m[7] * v.y + m[8] * v.z);
}

SBI_API double sbi_contact_skin_multiply_links(const sb_contact *contact, const unsigned char *masked, const sb_vec3 *x,
                                               sb_vec3 *out)
{
    const sbi_contact_skin *skin = &contact->skin;
    double sum = 0;
    for (int i = 0; i < skin->cross_count; i++) {
        const sbi_contact_cross *cross = skin->cross + i;
        const int *points = sbi_contact_face_nodes(contact->faces, cross->face);
        sb_vec3 at[3];
        for (int p = 0; p < 3; p++) {
            const sbi_contact_row row = sbi_contact_skin_row(skin, points[p]);
            at[p] = sb_v3(0, 0, 0);
            for (int a = 0; a < row.count; a++)
                at[p] = sb_v3_madd(at[p], row.weights[a],
                                   sbi_contact_unmasked(masked ? masked[row.nodes[a]] : 0u, x[row.nodes[a]]));
        }
        for (int p = 0; p < 3; p++) {
            const sbi_contact_row row = sbi_contact_skin_row(skin, points[p]);
            sb_vec3 f = sb_v3(0, 0, 0);
            for (int q = 0; q < 3; q++)
                f = sb_v3_add(f, sbi_skin_times(cross->blocks[3 * p + q], at[q]));
            for (int a = 0; a < row.count; a++)
                out[row.nodes[a]] = sb_v3_madd(out[row.nodes[a]], row.weights[a],
                                               sbi_contact_unmasked(masked ? masked[row.nodes[a]] : 0u, f));
            sum += (double)sb_v3_dot(at[p], f);
        }
    }
    return sum;
}
