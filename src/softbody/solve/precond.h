/* precond: preconditioners for block matrices: block Jacobi, SSOR, incomplete Cholesky, factorised sparse approximate
 * inverses, a complete factor; each with a coarse space of rigid motions, and fit to be made once and turned with the
 * body. Floor 1. */
#ifndef SB_PRECOND_H
#define SB_PRECOND_H

#include "../base/dense.h"
#include "multigrid.h"
#include "sparse.h"

/* What smooths: z = M^-1 r of one application. */
typedef enum sb_precond_kind {
    SB_PRECOND_NONE = 0,         /* z = r */
    SB_PRECOND_BLOCK_JACOBI = 1, /* inverse 3x3 diagonal blocks; cheapest set-up, most iterations */
    SB_PRECOND_SSOR = 2,         /* symmetric over-relaxation; nearly no set-up, cannot break down */
    SB_PRECOND_IC0 = 3,          /* block incomplete Cholesky on the matrix's pattern; fewest iterations of
                                  * the smoothers */
    SB_PRECOND_AUTO = 4,         /* the library's choice: sb_solver_auto */
    SB_PRECOND_FSAI = 5,         /* factorised sparse approximate inverse on the pattern of |A|^power: set-up and
                                  * application use all threads. 1.5 to 1.9 times the iterations of IC0, some
                                  * three times its set-up */
    SB_PRECOND_CHOLESKY = 6,     /* the whole factor, of sb_direct: for matrices that keep near the one it was made of,
                                  * as warping makes them */
    SB_PRECOND_MULTIGRID = 7 /* V-cycles; for large meshes: iterations hardly grow with them, and all threads work */
} sb_precond_kind;

enum { SB_PRECOND_PIECES_AUTO = -1, SB_PRECOND_MAX_POWER = 3 };

typedef struct sb_preconditioner_def {
    sb_precond_kind kind;     /* default SB_PRECOND_AUTO */
    const sb_vec3 *positions; /* [row_count] (m), read at creation only; NULL (default): no coarse space */
    int piece_count; /* rigid pieces of the coarse space, >= 0; 0: none; default SB_PRECOND_PIECES_AUTO. Each connected
                      * part of the pattern gets its share of them, one at least, and more where nodes in one place
                      * show that a cut ends in a piece: up to twice as many in all */
    int power;       /* FSAI: 1 to SB_PRECOND_MAX_POWER, default 1. 2 takes 0.6 to 0.7 times the iterations, but four to
                      * seven times the memory and seven (tet4) to fifty times (tet10) the set-up */
    sb_jobs jobs;    /* copied; default inline. IC0 with a coarse space gives two threads something to do from 1,000
                      * nodes on, where their numbering keeps neighbours near (sb_mesh_reorder): its factor is made, and
                      * applied, from both ends of it. Otherwise it shares out its coarse space only, as SSOR and
                      * Cholesky do, which is made while one thread makes the factor */
    sb_real poisson; /* of multigrid: the largest Poisson's ratio of the materials, -1 to 0.5. From 0.48 on its
                      * smoothers take a step more, which saves about a fifth of the iterations. Default 0 */
    const sb_multigrid_level *levels; /* [level_count] of multigrid, from fine to coarse, read at creation only; more
                                       * are made below the last. Default NULL: all are made from positions */
    int level_count;
    const sb_real *moduli; /* [block_count] of multigrid: Young's modulus of the stiffest cell that joins the two
                            * nodes of each block (Pa), >= 0, read at creation only, as sb_preconditioner_moduli
                            * gives. Parts whose moduli differ by more than five then get coarse nodes of their own,
                            * and small ones that are fifty times as stiff as the softest are solved by elimination:
                            * jumps of 1:1000 take up to 1.8 times the iterations in place of ten times as many.
                            * Rows of such small parts are left with next to no residual, so that all of a tolerance
                            * goes to the rest: a tenth of it makes displacements as accurate as without such parts.
                            * Slivers are stiff across their height, too: tets at 1e-3 and 1e-4 of it, under one in a
                            * hundred, cost three and eight times the iterations, told as E over that share 1.25
                            * times. Not with levels. Default NULL: one modulus */
} sb_preconditioner_def;

/* What a preconditioner resolved to and how its last update went. */
typedef struct sb_preconditioner_info {
    sb_precond_kind kind; /* never SB_PRECOND_AUTO */
    int piece_count;      /* rigid pieces in use, 0: no coarse space */
    int attempts;         /* factorisations tried by the last update (IC0); 0 before the first */
    double shift;         /* after an update of IC0: its diagonal was multiplied by 1 + shift, 1/16 or more with
                           * pieces, otherwise only where pivots need it; FSAI: the largest that a row needed */
    int level_count;      /* of multigrid, the matrix included; otherwise 0 */
    size_t bytes;         /* memory held */
} sb_preconditioner_info;

/* The preconditioner of one matrix pattern. The smoother works in single precision: it only has to point the
 * right way, and it is memory that limits its speed.
 *
 * The coarse space. Smoothers are blind to motions that vary slowly over the mesh, and those are what gravity
 * and a tool cause. So the nodes are cut into compact pieces, each free to move rigidly (6 unknowns), and the
 * piece motions Q = Z (Z^T A Z)^-1 Z^T are solved exactly around every smoothing:
 *     z = S r + Q (r - A S r)          [A-DEF2 of Tang, Nabben, Vuik, Erlangga 2009]
 * On a slender beam this divides the iterations by five for the price of a small dense system. PCG's first
 * residual has to satisfy Z^T r = 0, which sb_pcg_solve sees to. */
typedef struct sb_preconditioner sb_preconditioner;

/* What SB_PRECOND_AUTO becomes for matrices of this pattern when positions are given: SB_PRECOND_IC0 with its coarse
 * space up to 140,000 blocks, which are some 10,000 nodes of tet4 and 5,500 of tet10 or hex8, and
 * SB_PRECOND_MULTIGRID above, where it takes less time on one core already (tests/bench/RESULTS.md has the figures).
 * Long steps, nu 0.49 and jumps of the modulus by 1,000 (that the def's moduli tell) take up to twice its iterations.
 * From rest such jumps cost IC0 three times its own, many small stiff inclusions ten times: of tet10 multigrid then
 * takes half the time from some 90,000 blocks on, so name it for bodies that are solved so. Steps of moving ones
 * begin near the answer; of 107,000 to 253,000 blocks they take with IC0 0.4 to 1.6 times the time on two cores. The
 * choice does not depend on the number of threads, so results do not. Without positions it is SB_PRECOND_IC0. NULL:
 * SB_PRECOND_IC0. */
SB_API sb_precond_kind sb_solver_auto(const sb_matrix *pattern);
/* Name of a kind, as "multigrid"; never NULL. */
SB_API const char *sb_precond_string(sb_precond_kind kind);

/* The defaults named at the fields. */
SB_API sb_preconditioner_def sb_default_preconditioner_def(void);

/* moduli[block_count] of a def from those of the cells.
 * pattern         made of the cells, by sb_matrix_create or wider; blocks whose nodes share no cell get 0
 * cells           [cell_count][nodes_per_cell]
 * young           [cell_count] (Pa), >= 0
 * Returns SB_ERROR_ARGUMENT, SB_ERROR_INDEX (error->element: a node outside, or no block for two nodes) or
 * SB_ERROR_NOT_FINITE; what moduli holds is then unspecified. Time as an assembly. */
SB_API sb_result sb_preconditioner_moduli(const sb_matrix *pattern, int cell_count, int nodes_per_cell,
                                          const int *cells, const sb_real *young, sb_real *moduli, sb_error *error);

/* Makes a preconditioner for matrices of this pattern (values are not read) with all memory it ever needs.
 * allocator NULL: malloc. *out is released with sb_preconditioner_free and refers to neither def nor pattern.
 * Returns SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (a position, error->node; a modulus) or SB_ERROR_MEMORY; *out
 * stays. */
SB_API sb_result sb_preconditioner_create(const sb_preconditioner_def *def, const sb_matrix *pattern,
                                          const sb_allocator *allocator, sb_preconditioner **out, sb_error *error);
SB_API void sb_preconditioner_free(sb_preconditioner *preconditioner);

/* Takes over the values of a symmetric matrix of the pattern, without rotations; allocates nothing.
 * positions  [row_count] where the nodes are now, for the rigid motions of the pieces, taken over even when the factor
 *            fails; NULL: as before
 * Returns SB_ERROR_ARGUMENT (another pattern), SB_ERROR_NOT_FINITE, or SB_ERROR_INDEFINITE when a diagonal
 * block is not positive definite or no diagonal shift up to some 65 makes the incomplete factor exist. After an
 * error the preconditioner must be updated again before use.
 * An IC0 that breaks down starts again with a larger diagonal (at most 17 times), keeps that shift for the
 * following updates, and after a run of successful ones tries a smaller one. */
SB_API sb_result sb_preconditioner_update(sb_preconditioner *preconditioner, const sb_matrix *matrix,
                                          const sb_vec3 *positions, sb_error *error);

/* z = M^-1 r; both [row_count][3], not overlapping. Uses the preconditioner's scratch: one call at a time. */
SB_API void sb_preconditioner_apply(sb_preconditioner *preconditioner, const sb_real *r, sb_real *z);

/* Turns the smoother of the last update (or load) with the body instead of making it anew:
 *     M^-1 = R S R^T on the free components, the inverse diagonal on those prescribed now
 * with R of the nodes' rotations since then; the coarse space is that of the matrix. The tangent of a bent body is
 * nearly that of the unbent one turned, so that M made at rest serves through large motions. Positive definite whatever
 * the rotations.
 * matrix     what is to be solved now, of the same pattern
 * rotations  [row_count] unit quaternions, as sb_body_nodal_rotations gives; NULL: none
 * positions  as in sb_preconditioner_update
 * Returns SB_ERROR_ARGUMENT (another pattern, nothing to turn, or error->node's rotation is no unit quaternion),
 * SB_ERROR_UNSUPPORTED (multigrid: update it) or SB_ERROR_NOT_FINITE; the preconditioner is then as it was. Costs a
 * pass over the nodes, and for the coarse space one over the matrix; allocates nothing. */
SB_API sb_result sb_preconditioner_warp(sb_preconditioner *preconditioner, const sb_matrix *matrix,
                                        const sb_quat *rotations, const sb_vec3 *positions, sb_error *error);

/* ---- kept in memory -------------------------------------------------------------------------------------
 * What an update made, to be shipped with an organ: loaded, it needs no factorisation, only a warp. Not of multigrid
 * (SB_ERROR_UNSUPPORTED), whose updates are cheap. The bytes are
 * little-endian everywhere: "SBPRECND", version (4 bytes), bytes of sb_real (4), bytes in all (8), the make, the
 * values, checksum of all bytes before it (8). */

/* Bytes that sb_preconditioner_save writes; 0: more than size_t holds, or multigrid. */
SB_API size_t sb_preconditioner_saved_size(const sb_preconditioner *preconditioner);
/* Writes the smoother of the last update, without rotations and coarse space, to buffer[size]; what is behind
 * sb_preconditioner_saved_size stays. SB_ERROR_ARGUMENT: NULL, too small a buffer (then untouched), or never
 * updated. */
SB_API sb_result sb_preconditioner_save(const sb_preconditioner *preconditioner, void *buffer, size_t size);
/* The smoother becomes what was saved from a preconditioner of the same kind, power and pattern, of IC0 also with a
 * coarse space if this one has one, or without, where that changes the factor's order; it is without until
 * sb_preconditioner_warp. All is checked before anything changes: SB_ERROR_FORMAT (no saved preconditioner, cut
 * short, damaged, a value out of its range), SB_ERROR_UNSUPPORTED (other version or precision), SB_ERROR_STATE
 * (another kind, power or pattern, or a factor in another order), SB_ERROR_NOT_FINITE, SB_ERROR_ARGUMENT. Allocates
 * nothing. */
SB_API sb_result sb_preconditioner_load(sb_preconditioner *preconditioner, const void *buffer, size_t size,
                                        sb_error *error);

SB_API sb_preconditioner_info sb_preconditioner_get_info(const sb_preconditioner *preconditioner);

/* ---- internal ------------------------------------------------------------------------------------------ */

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* As sb_preconditioner_apply when |r| is known (any value of the magnitude of r's entries, not 0): r is
 * brought near 1 before it is rounded to single precision, so that tiny residuals do not vanish. */
SBI_API void sbi_precond_apply(sb_preconditioner *preconditioner, const sb_real *r, sb_real *z, double size);
/* The same for any r: symmetric also where the coarse space's part of r is not 0, at the price of a second visit to the
 * coarse space. spare [row_count][3] is for scratch. */
SBI_API void sbi_precond_apply_symmetric(sb_preconditioner *preconditioner, const sb_real *r, sb_real *z, double size,
                                         sb_real *spare);
/* The two halves of sbi_precond_apply, for whoever has more unknowns than the matrix and a coarse space of its own
 * rows: z = S r, and then z = S r + Q (y - A S r) of the same call, y being what those unknowns have made of r. Both
 * only where there is a coarse space. */
SBI_API int sbi_precond_has_coarse(const sb_preconditioner *preconditioner);
SBI_API void sbi_precond_apply_smoother(sb_preconditioner *preconditioner, const sb_real *r, sb_real *z, double size);
SBI_API void sbi_precond_apply_coarse(sb_preconditioner *preconditioner, const sb_real *y, sb_real *z, double size);
/* z = Q r: the part of the solution that the coarse space sees. Without one: returns 0, z untouched. */
SBI_API int sbi_precond_coarse_solve(sb_preconditioner *preconditioner, const sb_real *r, sb_real *z, double size);
/* After an application that was not positive definite: makes the smoother milder until the next update. 0: there is
 * nothing milder. */
SBI_API int sbi_precond_soften(sb_preconditioner *preconditioner);
/* The multigrid that has the matrix of the last update in fewer bytes, to multiply by; NULL: there is none. */
SBI_API sbi_multigrid *sbi_precond_compact(const sb_preconditioner *preconditioner);
/* Another of the same make (kind, jobs, the user's levels; pieces for its size) for another pattern. moduli: as in
 * sb_preconditioner_def, of another mesh; NULL: those of `like`, whose nodes the pattern has. */
SBI_API sb_result sbi_precond_remake(const sb_preconditioner *like, const sb_matrix *pattern, const sb_vec3 *positions,
                                     const sb_real *moduli, const sb_allocator *allocator, sb_preconditioner **out,
                                     sb_error *error);
/* A preconditioner of a matrix that follows (see sparse_live.h) follows it where its kind can: none, block Jacobi,
 * SSOR, IC(0); others are to be made anew. 0: it would have to have the memory for what sbi_matrix_reserve has planned,
 * and has not. */
SBI_API int sbi_precond_reserve(const sb_preconditioner *preconditioner, const sb_matrix *matrix);
/* 1: it is of such a kind. */
SBI_API int sbi_precond_follows(const sb_preconditioner *preconditioner);
/* The pattern is another one: nothing is known of it until the next update, which lists rows and cuts pieces again,
 * from the matrix and `rest` [row_count] (m, borrowed) alone: the same as of one made anew, whatever the history. */
SBI_API void sbi_precond_follow(sb_preconditioner *preconditioner, const sb_matrix *matrix, const sb_vec3 *rest);
/* Coarse pieces that it was to have; it makes about as many. */
SBI_API int sbi_precond_wanted_pieces(const sb_preconditioner *preconditioner);
/* Does so now, if that is still to be done. 0: it is of a kind that does not follow, and of the pattern of before. */
SBI_API int sbi_precond_settle(sb_preconditioner *preconditioner, const sb_matrix *matrix);
/* Another Poisson's ratio than that of the def, for all updates to come. */
SBI_API void sbi_precond_set_poisson(sb_preconditioner *preconditioner, sb_real poisson);
/* 1: z of one connected part of the pattern depends on r of another, as the user's levels may have it. */
SBI_API int sbi_precond_couples_parts(const sb_preconditioner *preconditioner);
/* Rows of the pattern it was made for. */
SBI_API int sbi_precond_rows(const sb_preconditioner *preconditioner);

/* What updates remember of the ones before: all that is not made anew from the matrix. Of multigrid the first two are
 * its sbi_mg_reach. */
typedef struct sbi_precond_memory {
    double shift;
    int successes, wait;
} sbi_precond_memory;
SBI_API sbi_precond_memory sbi_precond_get_memory(const sb_preconditioner *preconditioner);
/* The memory must be valid. */
SBI_API void sbi_precond_set_memory(sb_preconditioner *preconditioner, sbi_precond_memory memory);
SBI_API int sbi_precond_is_memory(sbi_precond_memory memory);
/* Updates go on as those of a new one. */
SBI_API void sbi_precond_forget(sb_preconditioner *preconditioner);
#endif

#endif /* SB_PRECOND_H */
