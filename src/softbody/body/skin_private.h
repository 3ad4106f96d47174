/* skin_private: what a skin (skin.h) is to those who act on it. Internal. */
#ifndef SBI_SKIN_PRIVATE_H
#define SBI_SKIN_PRIVATE_H

#include "body.h"
#include "state_part.h"

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

    /* How its points are held, where the body's mesh does not say it alone; NULL, all of them: it does.
     * save: the end of a part of the body's state. check, load, give_up: what sbi_state_part says of them; load may
     * come after the listeners have followed, and returns 1 when the skin is to be brought up to it. */
    void (*save)(const struct sb_skin *skin, sbi_state_out *out);
    sb_result (*check)(struct sb_skin *skin, const sb_body *body, sbi_part_in in, sb_error *error);
    int (*load)(struct sb_skin *skin);
    void (*give_up)(struct sb_skin *skin);
    /* The same in memory[kept_size], for steps that are taken back. 0: no memory, and all is as before. */
    size_t (*kept_size)(const struct sb_skin *skin);
    int (*keep)(const struct sb_skin *skin, void *memory);
    int (*rewind)(struct sb_skin *skin, const void *memory);
};

#endif /* SBI_SKIN_PRIVATE_H */
