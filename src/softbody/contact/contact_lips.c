/* contact_lips: the lips of cuts, which touch each other though they lie on each other at rest.
 *
 * Of two faces of one organ that are near each other at rest the distance does not say whether there is tissue between
 * them, as there is between the sides of a thin fold, or a cut. A cut lays open two faces at one place which look at
 * each other. Faces that have such a twin and go on smoothly are a sheet; two sheets with twins in each other are the
 * lips of one cut. Tissue lies behind either of them, and between sheets of two cuts: those are no lips of each other.
 * Where the cut ends in the body its lips share points: two rings of faces about that are left out, since there each
 * face is next to those of the other lip, whichever way they are bent. */
#include <string.h>

#include "contact_private.h"

/* Normals of twins have a product below this, and their middles are nearer than this, in lengths of a face. */
#define SBI_LIPS_OPPOSITE ((sb_real)-0.99)
#define SBI_LIPS_AT ((sb_real)1e-3)
/* Faces that go on smoothly have a product above this. */
#define SBI_LIPS_SMOOTH ((sb_real)0.5)
enum { SBI_LIPS_RINGS = 2 };

static int sbi_lips_root(int *sets, int face)
{
    while (sets[face] != face)
        face = sets[face] = sets[sets[face]];
    return face;
}

static void sbi_lips_join(int *sets, int a, int b)
{
    a = sbi_lips_root(sets, a);
    b = sbi_lips_root(sets, b);
    sets[sbi_max_int(a, b)] = sbi_min_int(a, b);
}

/* The face of the same organ that lies on this one at rest and looks at it; -1: none. Writes pairs.found. */
static int sbi_lips_find_twin(sb_contact *contact, int face)
{
    const sbi_pairs *pairs = &contact->pairs;
    const sb_vec3 at = pairs->centres[face];
    sb_real most = SBI_LIPS_AT * contact->faces->lengths[face];
    int count =
        sbi_contact_faces_query(contact->faces, sb_v3(at.x - most, at.y - most, at.z - most),
                                sb_v3(at.x + most, at.y + most, at.z + most), pairs->found, contact->faces->face_room);
    for (int i = 0; i < count; i++) {
        int other = pairs->found[i];
        if (other != face && pairs->organs[other] == pairs->organs[face] &&
            sb_v3_dot(pairs->rest_normals[face], pairs->rest_normals[other]) < SBI_LIPS_OPPOSITE &&
            sb_v3_norm(sb_v3_sub(at, pairs->centres[other])) <= most)
            return other;
    }
    return -1;
}

/* Lips around a point that go on smoothly are of one sheet. */
static void sbi_lips_join_around(sbi_pairs *pairs, int point)
{
    for (int i = pairs->first_face[point]; i < pairs->first_face[point + 1]; i++)
        for (int j = pairs->first_face[point]; j < i && pairs->lips.sheets[pairs->around[i]] >= 0; j++) {
            int a = pairs->around[i], b = pairs->around[j];
            if (pairs->lips.sheets[b] >= 0 &&
                sb_v3_dot(pairs->rest_normals[a], pairs->rest_normals[b]) > SBI_LIPS_SMOOTH)
                sbi_lips_join(pairs->lips.sheets, a, b);
        }
}

/* 1: both lips of a cut have the point. */
static int sbi_lips_end_at(const sbi_pairs *pairs, int point)
{
    const sbi_pair_lips *lips = &pairs->lips;
    for (int i = pairs->first_face[point]; i < pairs->first_face[point + 1]; i++)
        for (int j = pairs->first_face[point]; j < i && lips->sheets[pairs->around[i]] >= 0; j++) {
            int a = pairs->around[i], b = pairs->around[j];
            if (lips->cuts[a] == lips->cuts[b] && lips->sheets[a] != lips->sheets[b])
                return 1;
        }
    return 0;
}

/* Rings of faces about the ends of cuts. */
static void sbi_lips_find_rims(sb_contact *contact)
{
    const sbi_contact_faces *faces = contact->faces;
    sbi_pair_lips *lips = &contact->pairs.lips;
    for (int p = 0; p < faces->node_room; p++)
        lips->ends[p] = (unsigned char)sbi_lips_end_at(&contact->pairs, p);
    memset(lips->rims, 0, (size_t)faces->face_end);
    for (int ring = 1; ring <= SBI_LIPS_RINGS; ring++) {
        for (int f = 0; f < faces->face_end; f++)
            for (int a = 0; a < faces->sizes[f]; a++) {
                int end = lips->ends[sbi_contact_face_nodes(faces, f)[a]];
                lips->rims[f] |= (unsigned char)(end > 0 && end <= ring);
            }
        for (int f = 0; f < faces->face_end; f++)
            for (int a = 0; lips->rims[f] && a < faces->sizes[f]; a++) {
                unsigned char *end = lips->ends + sbi_contact_face_nodes(faces, f)[a];
                *end = *end > 0 ? *end : (unsigned char)(ring + 1);
            }
    }
}

SBI_API void sbi_pairs_find_lips(sb_contact *contact)
{
    const sbi_contact_faces *faces = contact->faces;
    sbi_pairs *pairs = &contact->pairs;
    sbi_pair_lips *lips = &pairs->lips;
    if (!lips->sheets)
        return;
    for (int f = 0; f < faces->face_end; f++) {
        lips->twins[f] = faces->areas[f] > 0 ? sbi_lips_find_twin(contact, f) : -1;
        lips->sheets[f] = lips->cuts[f] = lips->twins[f] >= 0 ? f : -1;
    }
    for (int p = 0; p < faces->node_room; p++)
        sbi_lips_join_around(pairs, p);
    for (int f = 0; f < faces->face_end; f++) {
        int twin = lips->twins[f];
        if (twin < 0 || lips->sheets[twin] < 0)
            continue;
        lips->sheets[f] = sbi_lips_root(lips->sheets, f);
        sbi_lips_join(lips->cuts, f, lips->sheets[f]);
        sbi_lips_join(lips->cuts, f, twin);
    }
    for (int f = 0; f < faces->face_end; f++)
        if (lips->cuts[f] >= 0)
            lips->cuts[f] = sbi_lips_root(lips->cuts, f);
    sbi_lips_find_rims(contact);
}

SBI_API int sbi_pairs_are_lips(const sb_contact *contact, int face, int other)
{
    const sbi_pair_lips *lips = &contact->pairs.lips;
    return lips->sheets && lips->sheets[face] >= 0 && lips->cuts[face] == lips->cuts[other] &&
           lips->sheets[face] != lips->sheets[other] && !lips->rims[face] && !lips->rims[other];
}
