/* cut: cutting a body while it runs. Floor 4.
 *
 *     def.slack = 0.5;                                   of the body: room for copies of nodes and for cells
 *     sb_cut_def cut_def = sb_default_cut_def();
 *     cut_def.body = body;
 *     sb_cut_create(&cut_def, &cut, &error);
 *     ... steps ...
 *     sb_cut_triangles(cut, triangles, count, &info, &error);     a plane, a closed surface
 *     ... steps ...
 *     sb_cut_begin(cut, edge, 2, &stroke, &error);                a blade
 *     ... sb_cut_move(cut, stroke, edge, &info, &error) and sb_body_step, frame by frame ...
 *     sb_cut_end(cut, stroke);
 *     ... sb_cut_ablate(cut, tip, radius, &info, &error) ...      a cautery or a sucker
 *
 * How it works (virtual nodes: Molino, Bao and Fedkiw 2004). Each element carries a lattice of links, which triangles
 * cut where the body is now; an element that its cut links part becomes one cell for each piece, with the shape
 * functions of the whole element and the mass and stiffness of the piece, and nodes are copied where pieces of the
 * elements around them do not touch. Whether a link is cut is decided in exact integers, the same for all elements
 * around it, so that the triangles of one call leave no thread of tissue over, also where one goes through a node,
 * along an edge or a face. Nothing is remeshed: the matrix stays as large as the mesh and its copies, however fine the
 * cut, and steps take about as long as before.
 *
 * - What an element is not cut through yet holds: a cut opens up to the last element that it parts. With SB_CUT_GLUE
 *   such an element is parted along the blade's plane, and what no blade has come through is tied by a penalty
 *   (Suwelack 2014, 8.3.5): energy k/2 |jump|^2 at each triangle of the lips, k = beta (lambda + 2 mu) A / h (0.4 of
 *   that with tet10). It takes no momentum and no moment, is a part of forces, stiffness and elastic energy, and blades
 *   release it triangle by triangle. A half cut beam's sag is 2 to 5 % nearer to the exact one, the stress intensity of
 *   an edge crack off by 10 in place of 14 % (21 elements; tet10 1 in place of 12 % with 11), and a blade that advances
 *   by a fifth of an element opens something each time; with about as many iterations. Stiff ties make explicit steps
 *   shorter. A blade that turns away leaves what it was expected to cut glued.
 * - A node keeps its number and stands for the material at its place; copies get new numbers
 *   (sb_cut_node_origin). Cells likewise (sb_cut_cell_element).
 * - A link that is cut stays cut. What is cut twice, or along the same way again, is cut once.
 * - Mass, and the motion of all material, are what they were at the instant of a cut, and so is the elastic energy, but
 *   for that of glue that is released (sb_cut_info.released_energy), and with tet10 for what live_mesh.h says of small
 *   pieces: less than 1 % of it as a rule in blocks that were shaken hard, and up to 4 % (0.7 % of that and the kinetic
 *   energy) where elements are half as long as the block.
 * - Points in an element that is cut go with the piece that has their material: of embeddings that follow the body
 *   (sb_embedding_follow), of rows of mappings; sb_body_find_cell says which piece that is.
 * - Parts that nothing holds fly free; a static solve says SB_ERROR_UNCONSTRAINED then. Crumbs are taken out
 *   (sb_cut_def.least_piece).
 * - Material that is taken out, by ablation or as a crumb, goes with its mass and its momentum, and what is left keeps
 *   its velocities, and its numbers: nodes without material stay in use, stand where they were and weigh nothing;
 *   elements without material lose their cells (sb_body_cell_in_use), whose numbers later pieces may get. Pressures and
 *   tractions act on what is left of their faces. A point of an embedding that follows, or of a mapping, in material
 *   that was taken out goes with the nearest piece of its element, and where nothing is left of that: of an embedding,
 *   as points outside of the mesh do; of a mapping, with its nodes, on which it pulls in vain where they have no
 *   material. Where all of a body was taken out, one cell without volume is left, and steps do nothing.
 * - Supports: a copy is held along an axis where its pieces keep some of a boundary face whose nodes are all held along
 *   it. Constraints, regions and forces on nodes follow as live_mesh.h says; a copy has none of its own.
 * - Pressures, tractions and membranes on a face that is cut go to the parts of the face, each with what acts on it:
 *   force and moment are what they were, to rounding, however often it is cut; the moment of a pressure on faces of
 *   tet10 that are bent is, but for 1e-5 of the force times the body's size in blocks that were shaken hard.
 * - A blade's strokes: the strip of each move begins where the edge was in the tissue, which has moved since, to the
 *   last digit: samples stand wherever the edge goes through a face of an element. Near the skin, outside of the
 *   tissue, it moves with the skin, so that tissue that comes upon a blade at rest is cut as well. What rounding leaves
 *   between strips is cut by a rule: a whole link that cut ones surround in all elements around it holds nothing but
 *   itself. Scissors (sb_cut_scissors) are strokes whose edge is both blades, and which cut only as they close.
 * - With def.toughness J_c a blade feels what it frees: J_c times the area (at rest) of the lips that open is the work
 *   that it takes, J_c w / (1 + xi^2) across a stretch w of the edge and xi times as much along it, xi = d_t / d_n of
 *   its way past the tissue (Atkins, Xu and Jeronimidis 2004), so that slicing takes less force than pushing. Each
 *   triangle of lips is paid for evenly while the blade goes past it by half a mean element, or by 4 J_c / (3 mu) where
 *   that is more, 2 elements at most, so that forces stay what they are however short the frames, and sums over a
 *   stroke are exact once it has gone on by that; what is owed at its end (sb_cut_info.owed) is not felt. The tissue
 *   feels the opposite in the next time step: force and moment of what blade and body feel sum to 0, but for light
 *   tissue that would get ahead of the blade, which feels as much less as keeps it from that. A blade that goes on
 *   through tissue that gives way feels J_c w, and up to 1 + 0.8 J_c / (E h) times that where elements of size h are
 *   soft beside their toughness; energy is never made. Triangles (sb_cut_triangles) have no way and no force.
 * - States and recordings of the body hold its cuts: the sb_cut is a part of both, with its strokes. A state that was
 *   saved with one is loaded into a body that has one of the same mesh, lattice, front, glue, toughness and
 *   max_strokes, whatever was cut there meanwhile, and takes cuts back that it does not have. A recording plays on a
 *   body with such an sb_cut, made before it began, and has the calls.
 * - After others changed the mesh, calls say SB_ERROR_STATE; make a new one then, of an uncut body.
 *
 * Limits:
 * - tet4, and tet10 with straight sides, 4 points and lumped masses. Bent ones are refused by name. With tet10 a call
 *   that parts elements costs as much as making the body anew, and allocates. Strokes through elements that are bent by
 *   a blade's way between two moves may leave crumbs of a lattice point or two.
 * - Slices much thinner than a link fall into crumbs.
 * - Needles in hyperelastic tissue that is cut ring under Newmark: cut under SB_EULER or SB_GENERALISED_ALPHA. Where
 *   light pieces of it are crushed steps are divided, and cost as much more; where that does not help they are refused
 *   (SB_ERROR_DIVERGED, SB_ERROR_INVERTED).
 * - A cut exactly along the body's boundary parts the nodes that lie in it from the material, with what holds them: a
 *   body that is held there alone is loose then.
 * - Blades that go exactly through nodes while the tissue moves may leave such a node between both sides; strokes along
 *   the edge of a body may leave crumbs there of a lattice point or two.
 * - Lengths are resolved to 8e-9 of the box around the body; where its parts have gone so far apart that this is more
 *   than 8 times as large as at rest, of the box around each part.
 * - All pieces of an element have the shape of the whole one. Contact on the mesh's boundary touches that shape, up to
 *   an element beyond the cut; on the cut's surface (sb_cut_surface_skin) it touches skin and lips where they are. Lips
 *   do not touch each other.
 * - Where a face with a pressure or a traction is cut, the change of the mesh costs as much as making the body anew.
 * - Ablation is as fine as the lattice: with 1, elements whose corners are all in the ball go whole, and others are
 *   trimmed between their corners; a ball between the points of the lattice takes nothing. Behind a tip that goes on
 *   walls are rough by part of a link.
 * - Needles whose mesh follows (NDL_REMESH) and cuts exclude each other; those that springs hold (NDL_EMBED) stay in
 *   what is cut, and go into it.
 * - Glue is looked at along a line of half an element to either side: another blade that goes by as near releases it,
 *   too. A part that hangs by one or two glued triangles swings on them: static solves may not converge. Where a blade
 *   goes exactly along nodes, it may part a film without volume, whose nodes have no material and stand still: glue to
 *   it holds nothing, nor does glue on both its sides hold what is beyond it. It is drawn with what it lies on; where
 *   that has come apart it is drawn across the gap, and weighs and holds nothing there. With least_piece > 0 films that
 *   are parts of their own are taken out. With parts so far apart that each has a box of its own, glue of pieces
 *   without volume may stay.
 * - Parts of the mesh that hang together at an edge or a node alone come apart there where an element of that node is
 *   cut.
 * - Slivers of mass make explicit steps short: in bodies that step explicitly crossings keep off the points of the
 *   lattice by a sixteenth of an edge, for masses and stiffness, and a part of a piece's mass is spread evenly over its
 *   nodes (5 % with tet4, 20 % with tet10): steps are 0.36 of the uncut ones at least in 360 blocks that random planes
 *   and strips cut, with glue or without. */
#ifndef SB_CUT_H
#define SB_CUT_H

#include "../body/live_mesh.h"

typedef struct sb_cut sb_cut;

/* What an element does that blades have come into but not through. */
typedef enum sb_cut_front {
    SB_CUT_LAG = 0, /* it holds: a cut opens up to the last element that it parts */
    SB_CUT_GLUE = 1 /* it is parted along the plane of the blade, and what has not been swept of that is tied by a
                     * penalty, which blades release as they go on: cuts open with the blade, not by elements */
} sb_cut_front;

typedef struct sb_cut_def {
    sb_body *body; /* borrowed, made with slack > 0, of tet4 or straight tet10; its mesh now is the uncut one */
    int lattice;   /* intervals of the lattice along an element's edge: 1 (cuts go as far as elements have corners on
                    * both sides), 2 (default: slices half an element thick) or 4 (fine trims; slower) */
    sb_cut_front front; /* default SB_CUT_LAG */
    sb_real glue;      /* beta > 0, stiffness of the ties: they hold as beta (lambda + 2 mu) A / h does for an area A of
                        * an element of size h; default 10 */
    sb_real toughness; /* J_c, the work that freeing lips takes (J/m^2 = N/m), >= 0; default 0: blades feel nothing of
                        * it. Porcine liver 76 to 225, aorta 290, chicken skin 2,800 */
    sb_real least_piece; /* parts without supports that are smaller than so many mean elements (volume at rest) are
                          * taken out in the call that cuts them off, but for those that glue ties to others, and so are
                          * parts without volume, with supports or not; >= 0, default 1; 0 keeps them all */
    int max_strokes;     /* that are under way at once, >= 0; default 4 */
    sb_allocator allocator;
    unsigned cookie; /* of sb_default_cut_def */
} sb_cut_def;
SB_API sb_cut_def sb_default_cut_def(void);

/* What a call has done. */
typedef struct sb_cut_info {
    int links;        /* cut by it */
    int ringed;       /* of these, cut because blades had passed all around them */
    int torn;         /* elements torn by it */
    int cells, nodes; /* made by it */
    int parts;        /* that the body is in now, as sb_body_parts has them; what glue ties is in one */
    int glued;        /* triangles of lips that are glued now */
    sb_real glued_area, released_area; /* of lips that are glued now, and that this call has opened: at rest (m^2) */
    sb_real released_energy; /* of the glue that it has released: what the elastic energy has lost by that (J) */
    int crumbs;              /* parts that it took out, see sb_cut_def.least_piece */
    sb_real removed_volume, removed_mass; /* of what it took out, crumbs among it: at rest (m^3), kg */
    sb_vec3 removed_momentum;             /* that went with it (kg m/s) */
    sb_vec3 force, torque; /* that a blade feels of def.toughness (N), about its edge's first corner (N m); of moves */
    sb_real work;          /* of that force against the blade's way (J) */
    sb_real owed; /* by the stroke after the move: for lips that it has freed, and has not felt yet (J). All its
                   * work so far and this sum to J_c times the area that it has freed */
} sb_cut_info;

/* Makes what cuts a body; one at a time for each body, to be destroyed before or after it. SB_ERROR_ARGUMENT,
 * SB_ERROR_UNSUPPORTED (slack 0, other elements), SB_ERROR_STATE (a body that is cut already), SB_ERROR_MEMORY. With
 * multigrid it makes the levels once more (25 ms of 129,600 tets), so that the first cut takes as long as others. */
SB_API sb_result sb_cut_create(const sb_cut_def *def, sb_cut **cut, sb_error *error);
/* The body stays cut, and keeps what tells its pieces apart (sb_body_find_cell), for points and needles that are in
 * them: in its own memory; where there is none left they are held as if nobody knew the pieces. NULL is fine. */
SB_API void sb_cut_destroy(sb_cut *cut);
/* Cuts along triangles: a blade's way, a plane, a closed surface around what is to be taken out.
 * triangles  [count][3] corners where the body is now (m); triangles without area are skipped
 * info       may be NULL
 * On failure body and cut are as they were: SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE, SB_ERROR_STATE (see above), and
 * what sb_body_change_commit says. Between steps only. Allocates nothing while slack and room last. Cells look for
 * triangles near them in a tree, on the body's jobs, and where cells are parted the mesh changes: 13,440 tets, m = 2,
 * one thread: 0.02 ms beside the body, 4 ms for a frame that parts 100 cells, 18 ms for a plane through all. */
SB_API sb_result sb_cut_triangles(sb_cut *cut, const sb_vec3 *triangles, int count, sb_cut_info *info, sb_error *error);
/* Begins a stroke of a blade.
 * edge    [count] corners of the blade's edge, where it is now (m); 2 or more. It cuts nothing yet
 * *stroke is its number
 * SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE, SB_ERROR_STATE (see above, or def.max_strokes are under way),
 * SB_ERROR_MEMORY. Allocates nothing while edges go through some 200 faces of elements at most. */
SB_API sb_result sb_cut_begin(sb_cut *cut, const sb_vec3 *edge, int count, int *stroke, sb_error *error);
/* Moves the blade: what lies between where its edge was in the tissue, which may have moved since, and where it is now
 * is cut. Once a frame, between steps; also where the blade rests and the tissue moves.
 * edge       as many corners as at the beginning, where they are now (m)
 * info       may be NULL
 * On failure body, cut and stroke are as they were, and the next move goes on from the last good one: SB_ERROR_INDEX
 * (no such stroke), and as sb_cut_triangles. */
SB_API sb_result sb_cut_move(sb_cut *cut, int stroke, const sb_vec3 *edge, sb_cut_info *info, sb_error *error);
/* Moves scissors: their stroke is begun with the edge tips[0], hinge, tips[1]. Closing cuts what the blades pass
 * between where they were in the tissue and where they are now, until they meet; open or opening, at rest or shut they
 * cut nothing, wherever they go.
 *
 * hinge  where both blades begin, now (m)
 *
 * tips   [2] their ends
 *
 * info   may be NULL. torque is about the hinge; work over the angle is the moment that closing takes
 *
 * Else as sb_cut_move; SB_ERROR_ARGUMENT also for a stroke that has not 3 corners. */
SB_API sb_result sb_cut_scissors(sb_cut *cut, int stroke, sb_vec3 hinge, const sb_vec3 tips[2], sb_cut_info *info,
                                 sb_error *error);
/* Ends a stroke; one that is not under way is fine. */
SB_API void sb_cut_end(sb_cut *cut, int stroke);
/* Takes out what lies in a ball: as a cautery burns or a sucker draws it.
 * centre, radius  where the body is now (m); radius >= 0
 * info            may be NULL
 * Points of the lattice in the ball go, and links from them to others are cut at the ball's surface, where
 * sb_cut_surface says SB_CUT_CHAR; what comes off thereby is a part of its own. Of a smooth ball of twice an element's
 * size lattice 4 takes the volume to 2 %. Errors as sb_cut_triangles, and SB_ERROR_ARGUMENT: a negative radius. Cost as
 * of a cut of the elements on the ball's surface. */
SB_API sb_result sb_cut_ablate(sb_cut *cut, sb_vec3 centre, sb_real radius, sb_cut_info *info, sb_error *error);
/* How sb_cut_tear goes about it. Start from sb_default_tear_options(). */
typedef struct sb_tear_options {
    int nucleate;  /* 1: tissue may tear anywhere, where no cut or tear goes on; 0 (default): only there */
    int max_tears; /* elements in a call, in [1, 4096]; default 8 */
    unsigned cookie;
} sb_tear_options;
SB_API sb_tear_options sb_default_tear_options(void);
/* Tears what is stretched too far: elements whose largest principal stress (Cauchy) is over sqrt((lambda + 2 mu) J_c /
 * (4 h)), with def.toughness J_c and h their volume over the area of the section torn, come apart across it, the worst
 * first. Those that a cut has come to tear first, on from there; else one in a call begins a new tear. Between steps;
 * stresses are those of the body as it is, so that a tear goes on as steps bring stress to its front. Tears take J_c
 * for their area within 20 %, for tet4 and Poisson's ratios up to 0.3; nearly incompressible tet4 half to twice that.
 * options    NULL: defaults
 * info       may be NULL
 *
 * On failure body and cut are as they were: SB_ERROR_ARGUMENT (toughness 0, too), SB_ERROR_STATE, SB_ERROR_MEMORY, and
 * what sb_body_change_commit says. The first call allocates; each reads the stress of all cells (13,440 tets, one
 * thread: 4 ms). */
SB_API sb_result sb_cut_tear(sb_cut *cut, const sb_tear_options *options, sb_cut_info *info, sb_error *error);
/* Node of the uncut mesh that a node is a copy of, or itself; -1: none. Of elements: the one that a cell is of. */
SB_API int sb_cut_node_origin(const sb_cut *cut, int node);
SB_API int sb_cut_cell_element(const sb_cut *cut, int cell);

#endif /* SB_CUT_H */
