/* elimination: linear equations among the unknowns of a block matrix, each solved for its first unknown. Floor 3,
 * internal.
 *
 * Equation c, sum_k a_k u[dof_k] = value, gives its first unknown, the slave: u_s = (value - sum_{k>0} a_k u_k) / a_0.
 * A master may be the slave of another equation as long as no circle closes, so u = T u' + b with u' the unknowns that
 * are no slaves, and A u = f becomes (T^T A T) u' = T^T (f - A b): exact, symmetric and positive definite when A is.
 * Vectors pass equation by equation, masters first; the matrix takes T's 3x3 blocks with all chains resolved.
 * Condensed vectors and the condensed matrix keep the numbering of the nodes; slaves are 0 there. */
#ifndef SB_ELIMINATION_H
#define SB_ELIMINATION_H

#include "../solve/precond.h"

/* Equations as they were given. An unknown is 3 node + axis. */
typedef struct sbi_equations {
    int count;
    int *id;              /* [count] ascending */
    sb_real *value;       /* [count] (m) */
    int *start;           /* [count + 1] first term of each */
    int *dof;             /* [terms]; the first of each equation is its slave */
    sb_real *coefficient; /* [terms] */
    void *memory;         /* the one block behind the arrays */
    sb_allocator allocator;
} sbi_equations;

typedef struct sbi_elimination {
    sb_allocator allocator;
    sbi_equations equations;
    int node_count;
    int *order;                   /* [count] equations, masters before their slaves */
    unsigned char *slave;         /* [node_count] eliminated axes as bits */
    unsigned char *held;          /* [node_count] mask of the last condensed system */
    sb_real *force, *saved_force; /* [count] multipliers (N per unit coefficient) of the last solve */
    sb_real *start_gap;           /* [count] way of each slave to where it belongs (m), at the start of the step */
    sb_real *gap;                 /* [count] the same at the present displacement and load factor */
    sb_vec3 *reduced;             /* [node_count] condensed residual */
    sb_vec3 *work;                /* [node_count] */

    /* T: the rows of nodes with slaves; of the others it is the identity */
    int *first; /* [node_count + 1] into master and weight */
    int *master;
    sb_real (*weight)[9]; /* row-major: [axis of the node][axis of the master] */
    int *positions;       /* block of `matrix` for each pair of masters of each block of the full matrix */
    sb_matrix matrix;     /* T^T A T */
    sb_preconditioner *precond;
    sbi_precond_memory saved_precond;
    void *memory;
} sbi_elimination;

/* What an elimination is made for; borrowed. */
typedef struct sbi_elimination_setup {
    const sb_matrix *matrix;          /* the full matrix; its pattern is read */
    const sb_vec3 *positions;         /* [node_count] (m), for the coarse space of the preconditioner */
    const sb_preconditioner *precond; /* of the full matrix; that of the condensed one is made like it */
    const sb_allocator *allocator;
} sbi_elimination_setup;

/* Arrays for equations, not filled but for the allocator and count; 0 when memory is short. */
SBI_API int sbi_equations_allocate(const sb_allocator *allocator, int count, size_t terms, sbi_equations *equations);
SBI_API void sbi_equations_free(sbi_equations *equations);
/* Index of the equation with this id, or -1. */
SBI_API int sbi_equations_find(const sbi_equations *equations, int id);

/* Makes all that condensing needs and takes the equations over; on failure they stay the caller's and *out as it is.
 * There are at most 2^31-1 unknowns. SB_ERROR_ARGUMENT names node and axis of a slave that is one already, is among its
 * own masters or in a circle. */
SBI_API sb_result sbi_elimination_create(const sbi_elimination_setup *setup, sbi_equations *equations,
                                         sbi_elimination **out, sb_error *error);
/* The same equations with the same multipliers for another pattern of the full matrix; e stays as it is. */
SBI_API sb_result sbi_elimination_remake(const sbi_elimination *e, const sbi_elimination_setup *setup,
                                         sbi_elimination **out, sb_error *error);
SBI_API void sbi_elimination_free(sbi_elimination *e); /* NULL is fine */

/* e->matrix = T^T A T. A linear pass, always in the same order. */
SBI_API void sbi_elimination_condense(sbi_elimination *e, const sb_matrix *matrix);
/* diagonal = that of T^T diag(diagonal) T, 0 on slaves. */
SBI_API void sbi_elimination_condense_diagonal(const sbi_elimination *e, sb_vec3 *diagonal);
/* out = T^T in, in place or not; multipliers [count] or NULL: in_s / a_0 of each slave once all that follows it has
 * passed its share on. */
SBI_API void sbi_elimination_reduce(const sbi_elimination *e, const sb_vec3 *in, sb_vec3 *out, sb_real *multipliers);
/* Sets the slaves of an increment from its masters, plus e->gap when with_gaps. */
SBI_API void sbi_elimination_expand(const sbi_elimination *e, sb_vec3 *increment, int with_gaps);
/* Zeroes the slaves. */
SBI_API void sbi_elimination_clear_slaves(const sbi_elimination *e, sb_vec3 *vector);

/* What a step starts from: keeps multipliers and what the preconditioner learnt, for sbi_elimination_restore, and
 * start_gap at displacement u. */
SBI_API void sbi_elimination_save(sbi_elimination *e, const sb_vec3 *u);
SBI_API void sbi_elimination_restore(sbi_elimination *e);
/* Fills e->gap: how far each slave is from where it belongs at this share of the way from the start; 1 when any is. */
SBI_API int sbi_elimination_open(sbi_elimination *e, const sb_vec3 *u, sb_real load_factor);
/* Puts the slaves of u where they belong, so that sbi_elimination_open finds nothing to the last bit. */
SBI_API void sbi_elimination_follow(const sbi_elimination *e, sb_vec3 *u, sb_real load_factor);

/* One unknown of a node vector. */
SB_INLINE sb_real *sbi_elimination_at(sb_vec3 *v, int dof)
{
    sb_vec3 *node = v + dof / 3;
    return dof % 3 == 0 ? &node->x : dof % 3 == 1 ? &node->y : &node->z;
}
SB_INLINE sb_real sbi_elimination_get(const sb_vec3 *v, int dof)
{
    const sb_vec3 *node = v + dof / 3;
    return dof % 3 == 0 ? node->x : dof % 3 == 1 ? node->y : node->z;
}

#endif /* SB_ELIMINATION_H */
