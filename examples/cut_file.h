/* cut_file.h: what is drawn of a cut body as a mesh of triangles, to be written with fields. Include softbody.h first.
 *
 *     cut_file file;
 *     if (cut_file_make(&file, &drawing, leave_out))
 *         sb_mesh_save_vtk(path, &file.mesh, fields, 2, &error);
 *     cut_file_free(&file); */
#ifndef CUT_FILE_H
#define CUT_FILE_H

#include <stdlib.h>
#include <string.h>

typedef struct cut_file {
    sb_mesh mesh;          /* tri3, where it is now */
    sb_real *displacement; /* [nodes][3] (m) */
    sb_real *lip;          /* [triangles] 1: a cut laid it open, 2: burnt, 0: skin */
    int *triangles;        /* [triangles] number of each in the drawing */
} cut_file;

static inline void cut_file_free(cut_file *f)
{
    free(f->mesh.nodes);
    free(f->mesh.elements);
    free(f->displacement);
    free(f->lip);
    free(f->triangles);
    memset(f, 0, sizeof *f);
}

/* Adds a triangle; number: [vertices of the drawing] of those in the file, or -1. */
static inline void cut_file_add(cut_file *f, const sb_cut_drawing *d, int triangle, int *number)
{
    int at = f->mesh.element_count++;
    for (int k = 0; k < 3; k++) {
        int vertex = d->triangles[triangle][k], *node = number + vertex;
        if (*node < 0) {
            sb_vec3 u = sb_v3_sub(d->positions[vertex], d->rest[vertex]);
            *node = f->mesh.node_count++;
            f->mesh.nodes[*node] = d->positions[vertex];
            memcpy(f->displacement + 3 * (size_t)*node, &u, sizeof u);
        }
        f->mesh.elements[3 * (size_t)at + (size_t)k] = *node;
    }
    f->lip[at] = (sb_real)d->tags[triangle]; /* SB_CUT_SKIN, SB_CUT_LIP, SB_CUT_CHAR */
    f->triangles[at] = triangle;
}

/* Takes the triangles that are not left out (leave_out [triangles of the drawing] or NULL); 0: no memory. */
static inline int cut_file_make(cut_file *f, const sb_cut_drawing *d, const unsigned char *leave_out)
{
    size_t vertices = (size_t)d->vertex_count + 1, triangles = (size_t)d->triangle_count + 1;
    int *number = (int *)malloc(vertices * sizeof *number), ok;
    memset(f, 0, sizeof *f);
    f->mesh.element_type = SB_TRI3;
    f->mesh.nodes = (sb_vec3 *)malloc(vertices * sizeof(sb_vec3));
    f->mesh.elements = (int *)malloc(3 * triangles * sizeof(int));
    f->displacement = (sb_real *)malloc(3 * vertices * sizeof(sb_real));
    f->lip = (sb_real *)malloc(triangles * sizeof(sb_real));
    f->triangles = (int *)malloc(triangles * sizeof(int));
    ok = number && f->mesh.nodes && f->mesh.elements && f->displacement && f->lip && f->triangles;
    for (int i = 0; ok && i < d->vertex_count; i++)
        number[i] = -1;
    for (int i = 0; ok && i < d->triangle_count; i++)
        if (d->triangles[i][0] != d->triangles[i][1] && !(leave_out && leave_out[i]))
            cut_file_add(f, d, i, number);
    free(number);
    if (!ok)
        cut_file_free(f);
    return ok;
}

#endif /* CUT_FILE_H */
