/* cut_fine_private: what is inside an sb_cut_fine. Internal. */
#ifndef SB_CUT_FINE_PRIVATE_H
#define SB_CUT_FINE_PRIVATE_H

#include "cut_fine.h"
#include "cut_private.h"

/* A point of an element of the uncut mesh, on a piece of it. */
typedef struct sbi_fine_place {
    int tet;
    sb_real at[4]; /* barycentrics, < 0 where it is outside of the element */
    int cell;      /* of the body, that it moves with; -1: its material was taken out */
    int lip;       /* vertex of the cut's surface that it is; -1: none */
} sbi_fine_place;

/* What is drawn. */
typedef struct sbi_fine_arrays {
    int vertex_count, triangle_count, vertex_room, triangle_room;
    sbi_fine_place *places;
    sb_vec3 *positions, *normals, *rest;
    sb_real (*texture)[2];
    sb_cut_origin *origins;
    sb_cut_fine_source *sources;
    int *points;
    int (*triangles)[3];
    unsigned char *tags;
    int *cells;
} sbi_fine_arrays;

/* A border edge, from a vertex to the next one. */
typedef struct sbi_fine_border {
    int from, to, cell;
} sbi_fine_border;

/* Where a cut edge is crossed, and a hash of all that this follows from: 0, none. */
typedef struct sbi_fine_crossed {
    uint64_t hash;
    sb_real t;
} sbi_fine_crossed;

struct sb_cut_fine {
    sb_cut *cut;
    sb_cut_surface *surface;
    sb_allocator allocator;
    int version;                              /* of the body's mesh that triangles are of; -1: none */
    int vertex_count, face_count, edge_count; /* of the user's skin */
    int (*faces)[3];                          /* [face_count] */
    int (*sides)[3];                          /* [face_count] edge from corner k to the next one */
    int (*edges)[2];                          /* [edge_count] */
    sbi_fine_place *places;                   /* [vertex_count] at rest */
    sb_vec3 *rest;                            /* [vertex_count] */
    int *parts;                               /* [vertex_count] part of the body; -1: beside a cut, or taken out */
    sbi_fine_crossed *crossed;                /* [edge_count] */
    unsigned char *is_cut;                    /* [edge_count] */
    unsigned char *is_border;                 /* [edge_count] 1: it has one triangle, or three, ... */
    int (*seams)[2];                          /* [edge_count] vertices on the sides of a cut edge's ends; -1: none */
    int open_edges;
    sbi_fine_arrays now, next;

    /* of an update */
    int *lip_vertices; /* [lip_room] vertices of the lips */
    int lip_room;
    sbi_fine_border *seam_edges, *lip_edges; /* [border_room] */
    int seam_edge_count, lip_edge_count, border_room;
    int *scratch; /* [scratch_room] */
    size_t scratch_room;
};

/* A place of the skin's corners with these weights, on the piece of the element that a corner is on; its number. */
SBI_API int sbi_fine_add_vertex(sb_cut_fine *fine, const sbi_fine_place *place, const sb_cut_fine_source *source,
                                sb_vec3 rest);
SBI_API void sbi_fine_add_triangle(sb_cut_fine *fine, int a, int b, int c, int tag, int cell);
/* New arrays of triangles, 0: no memory, and free those there are. */
SBI_API int sbi_fine_take_triangles(const sb_allocator *allocator, sbi_fine_arrays *arrays, size_t count);
SBI_API void sbi_fine_free_triangles(const sb_allocator *allocator, sbi_fine_arrays *arrays);
/* Room for so many triangles more; 0: no memory. */
SBI_API int sbi_fine_reserve_triangles(sb_cut_fine *fine, int more);
/* 1 when two pieces, of elements that meet, do not hang together there: a node that both elements have is not the same
 * for both. */
SBI_API int sbi_fine_are_apart(const sb_cut *cut, const sbi_fine_place *p, const sbi_fine_place *q);
/* Takes over lips and walls, and joins seams to them by rims. There is room for all of it; 0: no memory. */
SBI_API int sbi_fine_close(sb_cut_fine *fine);

#endif /* SB_CUT_FINE_PRIVATE_H */
