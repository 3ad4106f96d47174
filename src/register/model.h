/* model: an organ as an inference knows it: mesh, what holds it, the surface that is seen, and what may act on it.
 * Floor 6. */
#ifndef REG_MODEL_H
#define REG_MODEL_H

#include "../softbody/mesh/mesh.h"
#include "api.h"

/* What a model is made from. Start from reg_default_model_def(), set mesh. */
typedef struct reg_model_def {
    const sb_mesh *mesh;    /* of volumes, at rest (m); read during the call only, as all here. Some 6,000 unknowns are
                             * enough: errors of a registration are rarely those of its mesh */
    const sb_mesh *surface; /* the organ's surface at rest, tri or quad, outward, finer than the mesh's; or NULL
                             * (default): the boundary of the mesh */
    sb_real poisson;        /* Poisson's ratio, (-1, 0.5); default 0.45. Young's modulus does not matter: loads scale
                             * with it. Tet4 lock beyond 0.45 */
    const int *fixed;       /* [fixed_count] nodes that move with the organ's pose only, or NULL: loads hold it */
    int fixed_count;
    sb_allocator allocator; /* default malloc; also of what is made with the model */
    sb_jobs jobs;           /* threads; default inline */
    unsigned cookie;        /* set by reg_default_model_def */
} reg_model_def;
REG_API reg_model_def reg_default_model_def(void);

typedef struct reg_model reg_model;

/* Makes a model; everything is copied. SB_ERROR_ARGUMENT (a field, named), SB_ERROR_INDEX (a fixed node),
 * SB_ERROR_UNSUPPORTED (custom elements), what sb_body_create says of the mesh, sb_surface_create and
 * sb_embedding_create of the surface; SB_ERROR_MEMORY. *model is then untouched. One inference at a time may use a
 * model, and the model must outlive it. */
REG_API sb_result reg_model_create(const reg_model_def *def, reg_model **model, sb_error *error);
REG_API void reg_model_destroy(reg_model *model);         /* NULL is fine */
REG_API int reg_model_node_count(const reg_model *model); /* 0 for NULL */

#endif /* REG_MODEL_H */
