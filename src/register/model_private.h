/* model_private: what is inside a reg_model. Floor 6, internal. */
#ifndef REG_MODEL_PRIVATE_H
#define REG_MODEL_PRIVATE_H

#include "../softbody/body/body_guest.h"
#include "../softbody/geometry/embed.h"
#include "../softbody/geometry/surface.h"
#include "../softbody/solve/direct.h"
#include "model.h"
#include "prior.h"

/* Young's modulus that models have (Pa): loads are in shares of it. */
#define REGI_MODEL_YOUNG ((sb_real)1000)

struct reg_model {
    sb_allocator allocator;
    sb_jobs jobs;
    sb_body *body;        /* neo-Hookean, whatever an application's body is: its tangent is right at strains of a
                           * tenth, where that of corotated bodies bends what is found of the loads */
    sb_direct *direct;    /* the body's factor: one inference at a time */
    int direct_at_rest;   /* 1: it is that of the organ at rest */
    sb_mesh mesh;         /* at rest */
    sb_boundary boundary; /* of mesh, compact */
    regi_prior prior;
    sb_domain domain;       /* the body's points: for forces of elements */
    sb_mesh skin;           /* triangles that are seen, at rest */
    sb_surface *tree;       /* of skin where the organ is now */
    sb_embedding_rows rows; /* of skin's nodes in mesh's */
    sb_real *vertex_area;   /* [skin nodes] m^2 at rest */
    double area;            /* m^2 of the skin */
    sb_real size;           /* m: diagonal of the mesh's box */
    double spacing;         /* m: cube root of the volume that a node has, about its distance from the next */
    sb_real poisson;
    int held; /* 1: there are fixed nodes */
};

/* ---- model_calm ---- */
/* Makes `direct`, and the prior's calm, of the body at rest. The factor's errors, SB_ERROR_MEMORY. */
REGI_API sb_result regi_model_find_calm(reg_model *model, sb_error *error);

#endif /* REG_MODEL_PRIVATE_H */
