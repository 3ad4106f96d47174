/* parted: the pieces that cut links leave of a tet, and their shapes. Internal. Floor 4, calls base and mesh only.
 *
 * Each micro-tet with corners in several pieces is divided into its 24 flags: corner v, a point of the link vw, one of
 * the face vwu, and the centre. The link's point is its crossing, or its middle where it is whole; the face's is the
 * mean of the first two crossings, those that parted its corners, or else the centroid; the centre is the mean of the
 * crossings that parted the corners of the micro-tet when they first came apart. So later cuts leave the pieces that
 * they do not cut as they are, and divide others without a rest. A flag belongs to the piece of its corner. Its volume
 * is that of the micro-tet times the weights of w at the link's point, of u at the face's and of the fourth corner at
 * the centre: never negative, and all 24 sum to the micro-tet, whatever was cut. A plane through a micro-tet is
 * represented exactly.
 *
 * The face of a cut (its lips, one for each side) are the triangles (link, face, centre) of links between pieces. What
 * lies on a face of the tet goes by links alone and not by pieces, which may hang together in one of its tets only.
 *
 * Points are barycentrics of the tet; those on a face have the same bits from both tets. */
#ifndef SB_PARTED_H
#define SB_PARTED_H

#include "cut_links.h"

typedef struct sbi_parted {
    const sbi_lattice *lattice;
    sbi_corner_order order;
    unsigned char cut[SBI_LATTICE_LINKS]; /* state of each link */
    sb_real t[SBI_LATTICE_LINKS];         /* crossings of cut ones, 0 at the first end (sbi_lattice_ends) */
    int rank[SBI_LATTICE_LINKS];          /* of cut ones: rises in the order in which they were cut */
    uint64_t lost;                        /* points that were taken out: they are of no piece */
    int piece_count;
    uint64_t pieces[SBI_LATTICE_POINTS];
    unsigned char piece_of[SBI_LATTICE_POINTS]; /* or SBI_PARTED_LOST */
} sbi_parted;

enum { SBI_PARTED_LOST = 255 };

/* Points of a micro-tet that has parted corners. */
enum { SBI_MICRO_LINKS = 0, SBI_MICRO_FACES = 6, SBI_MICRO_CENTRE = 10, SBI_MICRO_POINTS = 11 };

typedef struct sbi_micro_points {
    sb_real micro[SBI_MICRO_POINTS][4]; /* barycentrics in the micro-tet: of the links, of the faces, of the centre */
    sb_real tet[SBI_MICRO_POINTS][4];   /* and in the tet */
} sbi_micro_points;

/* A part of a micro-tet. Places are barycentrics 1, 2, 3 of the tet. */
typedef struct sbi_flag {
    int piece;      /* or SBI_PARTED_LOST */
    sb_real volume; /* of the tet's */
    sb_vec3 corners[4];
} sbi_flag;

/* A triangle between two pieces, seen from `above`, to where its normal points; the same for both. */
typedef struct sbi_lip {
    int below, above; /* pieces */
    int link;
    int place;             /* among all triangles of the micro-tet, [0, SBI_LIPS): the same however often it is cut */
    sb_real corners[3][4]; /* barycentrics */
} sbi_lip;

/* A piece's moments, in barycentrics 1, 2, 3 of its tet. */
typedef struct sbi_part_moments {
    sb_real share;  /* of the tet's volume, >= 0; those of a tet's pieces sum to 1 where nothing was taken out */
    sb_vec3 centre; /* centroid */
    sb_mat3 spread; /* covariance: mean of (xi - centre)(xi - centre)^T */
} sbi_part_moments;

/* What a piece has of a face. */
typedef struct sbi_face_moments {
    sb_real share;    /* of the face's area; those of a tet's pieces sum to 1 where nothing was taken out */
    sb_real loads[4]; /* means over the whole face of the barycentrics where the piece is, else 0: they sum to share */
    sb_real products[6]; /* the same of products of two barycentrics, by the tet's edges (sb_element_edge) */
} sbi_face_moments;

enum { SBI_FLAGS = 24, SBI_LIPS = 12 };

/* The pieces of a tet of the uncut mesh with these corners, as its cut links leave them. */
SBI_API void sbi_parted_make(const sbi_lattice *lattice, const sbi_cut_links *links, const int nodes[4], int tet,
                             sbi_parted *parted);
/* Finds the pieces anew after `cut` has been changed. */
SBI_API void sbi_parted_find(sbi_parted *parted);
/* 1 when the corners of a micro-tet are in several pieces. */
SBI_API int sbi_parted_is_split(const sbi_parted *parted, int micro);
/* least: crossings nearer than this to an end count as that far from it, [0, 1/2). */
SBI_API void sbi_parted_points(const sbi_parted *parted, int micro, sb_real least, sbi_micro_points *points);
/* Parts of a micro-tet: itself, or its flags; returns how many. */
SBI_API int sbi_parted_flags(const sbi_parted *parted, int micro, sb_real least, sbi_flag flags[SBI_FLAGS]);
/* Triangles of a micro-tet between pieces, without those beside what was taken out; returns how many. */
SBI_API int sbi_parted_lips(const sbi_parted *parted, int micro, sbi_lip lips[SBI_LIPS]);
/* The piece that has the material at these barycentrics of the tet, or the nearest one where it was taken out; -1:
 * there is none. */
SBI_API int sbi_parted_piece_at(const sbi_parted *parted, const sb_real at[4]);
/* The same, but SBI_PARTED_LOST where the material was taken out. */
SBI_API int sbi_parted_owner_at(const sbi_parted *parted, const sb_real at[4]);
/* What share of the tet's volume each piece is: shares [piece_count]. */
SBI_API void sbi_parted_shares(const sbi_parted *parted, sb_real least, sb_real *shares);
/* Moments of all pieces: moments [piece_count]. A piece without volume has its lowest point for a centre. */
SBI_API void sbi_parted_moments(const sbi_parted *parted, sb_real least, sbi_part_moments *moments);
/* What each piece has of a face (sb_element_face): moments [piece_count]. */
SBI_API void sbi_parted_face(const sbi_parted *parted, int face, sbi_face_moments *moments);

#endif /* SB_PARTED_H */
