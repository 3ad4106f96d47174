/* skin_private: what a skin (skin.h) is to those who act on it. Internal. */
#ifndef SBI_SKIN_PRIVATE_H
#define SBI_SKIN_PRIVATE_H

#include "body.h"

/* Where a point is in the body: sum (N_a(xi) + dN_a/dxi . step) x_a over the nodes of a cell. */
typedef struct sbi_skin_point {
    int cell; /* -1: no triangle has it */
    sb_real xi[3], step[3];
} sbi_skin_point;

struct sb_skin {
    void *user;
    /* 1: after a change of the mesh it is known only when the call that made the change has returned, and may then take
     * memory for more points and triangles; 0: their numbers stay, and it has followed before who listens later. */
    int is_late;
    /* Brings it up to the body's mesh; what follows holds until the next time. SB_ERROR_STATE: it is none of this body,
     * or does not follow its changes. SB_ERROR_MEMORY. */
    sb_result (*update)(struct sb_skin *skin, const sb_body *body, sb_error *error);
    int point_count, face_count;
    const int (*triangles)[3]; /* [face_count] points; three times the same: none */
    void (*get_point)(const struct sb_skin *skin, int point, sbi_skin_point *at);
    /* A name of a point, the same wherever the skin is made of the same body, whatever its number; NULL: numbers are.
     */
    uint64_t (*get_name)(const struct sb_skin *skin, int point);
};

#endif /* SBI_SKIN_PRIVATE_H */
