/* piece: what of a tet is material, and the points, masses and loads that follow from it. Floor 2, internal.
 *
 * A tet that was cut is one cell for each of its pieces, with the shape functions of the whole tet. What is quadratic
 * at most (the stiffness of tet4 and straight tet10, lumped masses, loads, the mass of tet4) is integrated exactly over
 * any piece from ten numbers: its volume V, its centroid c and its covariance S = 1/V int (x - c)(x - c)^T. Four points
 * of weight V/4 at c + L d_k, L L^T = S, d = (1,1,1) (1,-1,-1) (-1,1,-1) (-1,-1,1), do that. Centroid and covariance
 * are in the tet's own coordinates (sb_element_shape): they stay the same when its corners move. What a piece has of a
 * face is known by int N_a dA over it (N_a of tri3, or tri6), from which a point, or three, follow in the same way. */
#ifndef SB_PIECE_H
#define SB_PIECE_H

#include "../base/dense.h"

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* In the order in which files have it. */
typedef struct sbi_piece {
    sb_real is; /* 1; 0: the cell is not one, and the rest 0 */
    sb_real centroid[3];
    sb_real covariance[6]; /* xx, yy, zz, yz, zx, xy */
    sb_real faces[4][6];   /* int N dA over the piece's part of each face, over the face's area, by its nodes: 3 of
                            * tet4, the rest 0; 6 of tet10 */
} sbi_piece;

/* Nodes of a face of a tet with so many. */
SB_INLINE int sbi_piece_face_nodes(int nodes) { return nodes == 4 ? 3 : 6; }
/* What node a has of a whole face of tri3 or tri6. */
SB_INLINE sb_real sbi_piece_whole_load(int face_nodes, int a) { return face_nodes == 6 && a < 3 ? 0 : (sb_real)1 / 3; }
/* nodes: 4 or 10 of the tet. face_loads: [4][3] or [4][6], or NULL: it has all of each face. */
SBI_API sbi_piece sbi_piece_make(sb_vec3 centroid, const sb_mat3 *covariance, int nodes, const sb_real *face_loads);
/* 0: the centroid is outside the tet, the covariance is that of nothing in it, or a face's part of no part of it. */
SBI_API int sbi_piece_is_sound(const sbi_piece *piece, int nodes);
/* Of a part of a face with these loads [face_nodes]: 1, it is the whole face; its share of the area; and points in the
 * face's parameters with weights that sum to half its share, as those of the whole face sum to the area of the
 * parameters' triangle: 1 of tri3, exact to degree 1, 3 of tri6, to degree 2, 0 where there is nothing. Returns how
 * many. */
SBI_API int sbi_piece_is_whole_face(const sb_real *loads, int face_nodes);
SBI_API sb_real sbi_piece_face_share(const sb_real *loads, int face_nodes);
SBI_API int sbi_piece_face_points(const sb_real *loads, int face_nodes, sb_real points[3][3], sb_real weights[3]);
/* The four points that stand for the piece, in the tet's coordinates. */
SBI_API void sbi_piece_points(const sbi_piece *piece, sb_real points[4][3]);
/* Lumped masses and int N_a dV (m^3) of a tet (nodes: 4 or 10) whose piece has this volume. Those of the pieces of a
 * tet sum to its own: m_a = int w_a with w_a = L_a, of tet10 5/18 L_a^2 at corners and 2 L_p L_q + 13/54 (L_p^2 +
 * L_q^2) on edges, which are 1/36 and 4/27 on the whole tet. Masses are > 0. load may be NULL. */
SBI_API void sbi_piece_lumps(const sbi_piece *piece, int nodes, sb_real volume, sb_real *masses, sb_real *load);
/* Spreads this share of those masses evenly: as in the whole tet, V/4, of tet10 V/36 at corners and 4 V/27 on edges, so
 * that they still sum to its own. No node of a small piece is then light beside the stiffness that it has. */
SBI_API void sbi_piece_level(int nodes, sb_real volume, sb_real share, sb_real *masses);
/* mass[nodes][nodes] (m^3) = int N_a N_b dV: exact of tet4, by the four points of tet10. */
SBI_API void sbi_piece_mass(const sbi_piece *piece, int nodes, sb_real volume, sb_real *mass);
#endif

#endif /* SB_PIECE_H */
