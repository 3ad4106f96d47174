/* heat_private: what the files of heat share. Floor 4, internal. */
#ifndef SB_HEAT_PRIVATE_H
#define SB_HEAT_PRIVATE_H

#include "../body/body_private.h"
#include "../body/state_part.h"
#include "heat.h"

typedef enum sbi_heat_kind {
    SBI_HEAT_SOURCE = 1,    /* shares: W at each row per unit of the value */
    SBI_HEAT_CONVECTION = 2 /* shares: int N_row N_column dA (m^2); value: coefficient */
} sbi_heat_kind;

enum { SBI_HEAT_HEAD = 3 };

/* What was added: entries of rows, which of convection couple a row with a column. */
typedef struct sbi_heat_source {
    int id;
    sbi_heat_kind kind;
    int count;
    void *memory;                           /* the one block behind the arrays */
    int *head;                              /* of its command: SBI_HEAT_ADD, kind, count; then at once */
    int *rows, *columns;                    /* [count] each, at once; columns of sources are the rows */
    int *at;                                /* [count] entry of the matrix */
    sb_real *value, *surroundings, *shares; /* one, one, [count], at once */
} sbi_heat_source;

/* Its matrices have the pattern of nodes that share an element, stored whole. */
struct sb_heat {
    sb_body *body;
    sb_heat_def def; /* its arrays are NULL */
    void *memory;    /* the one block behind the arrays */
    int node_count, entry_count;
    int *row_start; /* [node_count + 1] */
    int *columns;   /* [entry_count] ascending in each row */
    int *diagonal;  /* [node_count] entry (i, i) */

    /* what the tissue is: K (W/K), and by node lumped */
    double *conduction; /* [entry_count] */
    double *volume;     /* [node_count] m^3 */
    double *capacity;   /* J/K */
    double *latent;     /* J */
    double *perfusion;  /* W/K, of live tissue */
    double *metabolic;  /* W */
    int has_latent;     /* 1: some tissue has latent heat */

    sbi_heat_source *sources; /* [source_count] by ascending id */
    int source_count, source_capacity, last_id;
    sbi_heat_source *loaded; /* [loaded_count] what a state that was checked has, until it is loaded */
    int loaded_count;

    /* state */
    sb_real *temperature, *damage, *target; /* [node_count]; target of nodes that are held (K) */
    unsigned char *held;                    /* [node_count] 1: held; nodes of no element always */
    sb_real *stiffness;                     /* [cell_count]; NULL: def.stiffening is 0 */
    sb_heat_flows balance;

    /* scratch of a solve, [node_count] but for the first two; product and smooth also by parts */
    double *matrix, *factor; /* [entry_count] A, and L of A ~ L L^T in its lower triangle */
    double *blood;           /* W/K, what perfusion is left of */
    double *rise;            /* T at the end less T before (K) */
    double *residual, *change, *direction, *product, *smooth;
    sb_real *new_damage;
};

/* ---- heat_matrix.c ---- */
/* Lists the nodes that each shares an element with, and itself, ascending: row_start[node_count + 1], and once that is
 * known columns and diagonal (NULL before). mark: scratch [node_count]. Returns the entries, -1: more than an int. */
SBI_API int sbi_heat_pattern(const sb_body *body, int *mark, int *row_start, int *columns, int *diagonal);
/* The entry (i, j), or -1. */
SBI_API int sbi_heat_find(const sb_heat *heat, int i, int j);
/* Fills conduction and lumps from the def, whose arrays are there. */
SBI_API void sbi_heat_integrate(sb_heat *heat, const sb_heat_def *def);
/* volumes[nodes_per_cell] (m^3): what each node of a cell has of it. */
SBI_API void sbi_heat_lumps(const sb_body *body, int e, sb_real *volumes);
/* y = K x */
SBI_API void sbi_heat_conduct(const sb_heat *heat, const double *x, double *y);

/* ---- heat_solve.c ---- */
/* change = A^-1 residual on rows that are not held, 0 on others, to tolerance of |residual|; the sum of what is left
 * over these rows is 0 to rounding. *iterations rises by those it took, *work: change . A change. SB_ERROR_INDEFINITE,
 * SB_ERROR_NOT_CONVERGED, SB_ERROR_DIVERGED. */
SBI_API sb_result sbi_heat_solve(sb_heat *heat, double tolerance, int *iterations, double *work, sb_error *error);
/* Sums over rows that are not held. */
SBI_API double sbi_heat_dot(const sb_heat *heat, const double *a, const double *b);

/* ---- heat_source.c ---- */
SBI_API sbi_heat_source *sbi_heat_find_source(const sb_heat *heat, int id);
/* Takes the memory of a source of so many entries. 0: there is none. */
SBI_API int sbi_heat_make_source(const sb_heat *heat, sbi_heat_kind kind, int count, sbi_heat_source *source);
/* Checks values and finds entries of the matrix. */
SBI_API sb_result sbi_heat_check_source(const sb_heat *heat, sbi_heat_source *source, sb_error *error);
/* Adds one that was made; gives its memory back where that fails. */
SBI_API sb_result sbi_heat_take_source(sb_heat *heat, sbi_heat_source *source, int *id, sb_error *error);
SBI_API void sbi_heat_free_sources(const sb_heat *heat, sbi_heat_source *sources, int count);

/* ---- heat_damage.c ---- */
/* new_damage after dt in which the temperature rose. */
SBI_API void sbi_heat_harm(sb_heat *heat, double dt);
/* Dead share of a node. */
SB_INLINE double sbi_heat_dead(const sb_heat *heat, int node) { return 1 - sbi_dense_exp(-(double)heat->damage[node]); }
/* Stiffness from damage; 1: of some element it has changed. */
SBI_API int sbi_heat_stiffen(sb_heat *heat);

/* ---- heat_tell.c ---- */
#define SBI_HEAT_PART "heat" /* name in the body's state */
typedef enum sbi_heat_command {
    SBI_HEAT_STEP = 1,
    SBI_HEAT_STEADY = 2,
    SBI_HEAT_HOLD = 3,
    SBI_HEAT_RELEASE = 4,
    SBI_HEAT_ADD = 5,
    SBI_HEAT_SET = 6,
    SBI_HEAT_REMOVE = 7,
    SBI_HEAT_BLOOD = 8,
    SBI_HEAT_TEMPERATURES = 9,
    SBI_HEAT_RESET = 10
} sbi_heat_command;
SBI_API void sbi_heat_tell(sb_heat *heat, sbi_heat_command command, int a, const sb_real *reals, size_t real_count);
SBI_API void sbi_heat_tell_source(sb_heat *heat, const sbi_heat_source *source);
SBI_API void sbi_heat_tell_step(sb_heat *heat, sbi_heat_command command, sb_result result, sb_real dt);

/* ---- heat_state.c ---- */
SBI_API sb_result sbi_heat_join(sb_heat *heat, sb_error *error);
SBI_API void sbi_heat_leave(sb_heat *heat);

#endif /* SB_HEAT_PRIVATE_H */
