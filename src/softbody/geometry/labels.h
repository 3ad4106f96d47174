/* labels: from a label image to what is simulated: a closed surface round labels, and regions of a mesh. Floor 2.
 *
 *     sb_label_def def = sb_default_label_def();
 *     def.image = &image;                                        all labels but 0: the organ with its tumour
 *     sb_image_surface(&def, &mesh, &report, &error);            then sb_surface_create, sb_mesh_stuff or a grid
 *     sb_image_set_regions(&image, &tets, &error);               each element's region is its label
 *
 * Where the tumour's boundary matters, mesh it: the surface of its label as a second shape of sb_stuff_def. */
#ifndef SB_LABELS_H
#define SB_LABELS_H

#include "../mesh/image.h"

enum { SB_LABEL_MAX_SMOOTHING = 8 };

/* Which voxels are inside, and how their surface is made. Start from sb_default_label_def(). */
typedef struct sb_label_def {
    const sb_image *image; /* borrowed */
    const int *labels;     /* [label_count] what is inside; NULL with 0 (default): everything but label 0 */
    int label_count;
    int smoothing;          /* in [0, SB_LABEL_MAX_SMOOTHING]; default 2. 0: faces half-way between voxels, with their
                             * steps. n: steps of up to about 2 n voxels length become slopes */
    sb_allocator allocator; /* of the mesh and of all scratch; default malloc */
    unsigned cookie;        /* set by sb_default_label_def; a def made without it is refused */
} sb_label_def;

typedef struct sb_label_report {
    int voxels;           /* that are inside */
    sb_real voxel_volume; /* m^3 of them */
    sb_real volume;       /* m^3 that the surface encloses */
    int held_voxels;      /* on which smoothing would have put the wrong side: parts one voxel thick, mostly */
} sb_label_report;

SB_API sb_label_def sb_default_label_def(void);

/* The boundary of labels as a mesh of tri3, oriented outward (cavities inward), closed and manifold whatever the
 * voxels: no edge of more or fewer than two triangles, no node where parts touch, no two triangles that cross. It
 * passes between the centres of voxels inside and outside, all of which stay on their side, so nothing is lost and
 * nothing joins: also what is one voxel thick. Voxels that touch along an edge or in a corner only are parts of their
 * own. Beyond the image is outside.
 *
 * The inside (1) and the outside (0) are filtered along each axis of the image by (1 2 1) / 4, `smoothing` times: G.
 * What that takes from round parts comes back in (2 + sqrt 2) G - (1 + sqrt 2) G G, and the level near 1/2 (by up to
 * 1/8) is taken at which the surface encloses the voxels' volume. Voxels that end up on the wrong side get a value that
 * puts the surface half-way to their neighbours. Measured: the volume is that of the voxels to 1e-4 for balls of radius
 * 2 to 22 voxels, a torus, and plates 1, 2 and 3 voxels thick; single voxels and the smallest parts lose up to 5/6 of
 * theirs. Look at report->volume where parts are that small.
 *
 * mesh: overwritten, not freed. report: or NULL. Failures leave both untouched: SB_ERROR_ARGUMENT (a field, named; no
 * voxel has the labels), _NOT_FINITE (of the image), _UNSUPPORTED (more nodes or triangles than an int counts),
 * _MEMORY. Two triangles for each face between voxels, and more where the surface is rough. Scratch: 8 bytes for each
 * voxel of the box round the labels. O(voxels). The same bits each time.
 *
 * Source: marching cubes (Lorensen, Cline 1987) with loops traced face by face instead of a table: on a face whose
 * corners alternate, voxels inside stay apart, so that both its cubes agree. Loops of five and more nodes, and those of
 * four that meet one face twice, are filled round a centre, which no other triangle can touch. */
SB_API sb_result sb_image_surface(const sb_label_def *def, sb_mesh *mesh, sb_label_report *report, sb_error *error);

/* Makes the regions of a mesh's elements their labels: that of most of a sample of points (the centre, and the points
 * half-way from there to each node). Background (0) does not count, since the skin of a mesh cuts through voxels; where
 * all points lie in it the nearest label is taken, up to two voxels away, and 0 if there is none. mesh->regions is made
 * with mesh->allocator where it is NULL. SB_ERROR_ARGUMENT, _NOT_FINITE, _INDEX, _MESH (of the mesh's arrays), _MEMORY:
 * the mesh is as it was. O(elements). */
SB_API sb_result sb_image_set_regions(const sb_image *image, sb_mesh *mesh, sb_error *error);

#endif /* SB_LABELS_H */
