/* lattice: the regular lattice of a tet, by which cuts part it. Internal. Floor 4, calls base and mesh only.
 *
 * What a cut parts is decided by booleans on the links of a lattice, never by geometry: each tet carries the lattice of
 * m = 1, 2 or 4 intervals, whose micro-tets are made by red refinement (Bey 1995), and a link is whole or cut. A piece
 * is a connected component of a tet's points over whole links: a 64-bit mask.
 *
 *     m    points    links    micro-tets
 *     1         4        6             1       the corners: a piece needs one
 *     2        10       25             8       as the nodes of a tet10
 *     4        35      130            64       the points of m = 2 come first
 *
 * Points and links on a face or an edge belong to all tets around it. They agree because everything that is said of
 * them goes by the tets' corners in ascending order of their nodes: names, which end is first, sums of coordinates.
 * The lattice is that of the mesh before any cut; corners are nodes of that mesh. */
#ifndef SB_LATTICE_H
#define SB_LATTICE_H

#include "../base/dense.h"

enum { SBI_LATTICE_POINTS = 35, SBI_LATTICE_LINKS = 130, SBI_LATTICE_MICROS = 64, SBI_LATTICE_FACE_POINTS = 15 };

/* Corners of a tet in ascending order of their nodes. */
typedef struct sbi_corner_order {
    int nodes[4];             /* of the corners */
    unsigned char corners[4]; /* in ascending order */
} sbi_corner_order;

typedef struct sbi_lattice {
    int intervals; /* m */
    int point_count, link_count, micro_count;
    signed char points[SBI_LATTICE_POINTS][4];        /* barycentrics in m-ths; the corners first */
    unsigned char links[SBI_LATTICE_LINKS][2];        /* ends, the lower point first; in ascending order */
    unsigned char micros[SBI_LATTICE_MICROS][4];      /* corners, oriented as the tet */
    unsigned char micro_links[SBI_LATTICE_MICROS][6]; /* in the order of a tet's edges (sb_element_edge) */
    uint64_t face_points[4];                          /* those on each face (sb_element_face) */
    signed char lookup[5][5][5];                      /* point with these barycentrics 1, 2, 3; -1: none */
} sbi_lattice;

/* A link's name, the same from all tets around it. */
typedef struct sbi_link_key {
    int at[4];
} sbi_link_key;

/* intervals: 1, 2 or 4. */
SBI_API void sbi_lattice_make(int intervals, sbi_lattice *lattice);
SBI_API sbi_corner_order sbi_corner_order_make(const int nodes[4]);

/* Name of a link of the tet with this number: the nodes of the edge or face that it lies in, ascending, and where in
 * it; within the tet its number and the link. */
SBI_API sbi_link_key sbi_lattice_key(const sbi_lattice *lattice, const sbi_corner_order *order, int tet, int link);
/* Ends of a link: ends[0] is the first, which its crossing counts from. */
SBI_API void sbi_lattice_ends(const sbi_lattice *lattice, const sbi_corner_order *order, int link, int ends[2]);
/* Where a point with these barycentrics is, of a tet with corners at x: the same bits from all tets around. */
SBI_API sb_vec3 sbi_lattice_place(const sbi_corner_order *order, const sb_real barycentrics[4], const sb_vec3 x[4]);
/* The same of a tet10 with nodes at x. */
SBI_API sb_vec3 sbi_lattice_place_quadratic(const sbi_corner_order *order, const sb_real barycentrics[4],
                                            const sb_vec3 x[10]);
/* Barycentrics of p in a tet with corners at x; returns the least of them, -SB_REAL_MAX where it is flat. */
SBI_API sb_real sbi_lattice_barycentrics(const sb_vec3 x[4], sb_vec3 p, sb_real at[4]);
SBI_API void sbi_lattice_point(const sbi_lattice *lattice, int point, sb_real barycentrics[4]);

/* Corners that a link's ends depend on, as bits: two of a link in an edge, three in a face. */
SBI_API int sbi_lattice_link_corners(const sbi_lattice *lattice, int link);

/* Pieces of a tet, in the order of their lowest points; returns how many (0: no point).
 * cut     [link_count] not 0: cut
 * points  mask of the points that are there */
SBI_API int sbi_lattice_pieces(const sbi_lattice *lattice, const unsigned char *cut, uint64_t points,
                               uint64_t pieces[SBI_LATTICE_POINTS]);
/* All points of the lattice. */
SB_INLINE uint64_t sbi_lattice_all(const sbi_lattice *lattice) { return ((uint64_t)1 << lattice->point_count) - 1; }
/* Points of a piece on a face of the tet, named by their places in the face: pieces of the two tets of a face touch
 * when their marks have one in common. */
SBI_API unsigned sbi_lattice_face_marks(const sbi_lattice *lattice, const sbi_corner_order *order, int face,
                                        uint64_t piece);
/* The places in a face of the points on it: the bits of their marks. Others are left as they are. */
SBI_API void sbi_lattice_face_places(const sbi_lattice *lattice, const sbi_corner_order *order, int face,
                                     signed char places[SBI_LATTICE_POINTS]);
/* ringed[link_count]: 1 where every micro-triangle of this tet around the link has exactly one cut link: of a whole
 * link that is so in all tets around it nothing holds but itself. */
SBI_API void sbi_lattice_find_ringed(const sbi_lattice *lattice, const unsigned char *cut, unsigned char *ringed);

#endif /* SB_LATTICE_H */
