/* rigid_hold: whether the parts of a body and its free rigid bodies are held: by supports, and by each other. */
#include <math.h>
#include <string.h>

#include "body_private.h"
#include "rigid_private.h"

/* Parts that are tied or have nodes that hang, then rigid bodies: one gram of all. */
typedef struct sbi_hold {
    const sb_body *body;
    int parts, all;          /* of the gram: parts of the mesh; these and rigid bodies */
    int *index_of;           /* [component_count] place in the gram, or -1 */
    double *gram, *traces;   /* [6 all][6 all], [all] */
    double centre[3], scale; /* of the rigid body at work, as it hangs at rest: m, 1/m */
} sbi_hold;

static int sbi_hold_is_active(const sb_body *body, int node)
{
    return body->node_component[node] >= 0 && !body->fixed[node];
}

/* Of a part that none of them concerns, -1. */
static void sbi_hold_number(sbi_hold *h)
{
    const sb_body *b = h->body;
    h->parts = 0;
    for (int c = 0; c < b->component_count; c++)
        h->index_of[c] = b->tie_of[c] >= 0 ? h->parts++ : -1;
    for (int k = 0; k < b->rigids->count; k++)
        for (int i = 0; i < b->rigids->list[k]->count; i++) {
            int node = b->rigids->list[k]->hung[i];
            if (sbi_hold_is_active(b, node) && h->index_of[b->node_component[node]] < 0)
                h->index_of[b->node_component[node]] = h->parts++;
        }
    h->all = h->parts + b->rigids->count;
}

static int sbi_hold_take_memory(sbi_hold *h)
{
    const sb_body *b = h->body;
    size_t n;
    h->index_of = (int *)sbi_alloc(&b->allocator, (size_t)b->component_count + 1, sizeof(int));
    if (!h->index_of)
        return 0;
    sbi_hold_number(h);
    n = 6 * (size_t)h->all;
    h->gram = (double *)sbi_alloc_zeroed(&b->allocator, n + 1, n * sizeof(double));
    h->traces = h->gram ? h->gram + n * n : NULL;
    return h->gram != NULL;
}

/* What supports, springs, mappings and constraints hold. */
static void sbi_hold_copy(sbi_hold *h)
{
    const sb_body *b = h->body;
    size_t n = 6 * (size_t)h->all, stride = 6 * (size_t)b->tie_count;
    for (int c = 0; c < b->component_count; c++)
        for (int d = 0; d < b->component_count && h->index_of[c] >= 0; d++) {
            int tied = b->tie_of[c] >= 0 && b->tie_of[d] >= 0;
            if (!tied && d != c)
                continue;
            for (size_t i = 0; i < 6; i++)
                for (size_t j = 0; j < 6; j++)
                    h->gram[(6 * (size_t)h->index_of[c] + i) * n + 6 * (size_t)h->index_of[d] + j] =
                        tied ? b->tie_gram[(6 * (size_t)b->tie_of[c] + i) * stride + 6 * (size_t)b->tie_of[d] + j]
                             : b->support_grams[c][6 * i + j];
        }
}

/* The middle and the size of what hangs on it, at rest. */
static void sbi_hold_measure(sbi_hold *h, const sbi_rigid *r)
{
    const sb_body *b = h->body;
    double x[3], size = 0;
    int count = 0;
    memset(h->centre, 0, sizeof h->centre);
    for (int i = 0; i < r->count; i++)
        if (sbi_hold_is_active(b, r->hung[i])) {
            sbi_rigid_get(b->reference[r->hung[i]], x);
            count++;
            for (int k = 0; k < 3; k++)
                h->centre[k] += (x[k] - h->centre[k]) / count;
        }
    for (int i = 0; i < r->count; i++) {
        sbi_rigid_get(b->reference[r->hung[i]], x);
        for (int k = 0; k < 3; k++)
            size = fmax(size, fabs(x[k] - h->centre[k]));
    }
    h->scale = size > 0 ? 1 / size : 0;
}

/* s = what the six motions of the rigid body do to one axis of a node. */
static void sbi_hold_motion(const sbi_hold *h, int node, int axis, double s[6])
{
    double x[3];
    sbi_rigid_get(h->body->reference[node], x);
    memset(s, 0, 6 * sizeof *s);
    s[axis] = 1;
    s[3 + (axis + 1) % 3] = (x[(axis + 2) % 3] - h->centre[(axis + 2) % 3]) * h->scale;
    s[3 + (axis + 2) % 3] = -(x[(axis + 1) % 3] - h->centre[(axis + 1) % 3]) * h->scale;
}

/* The nodes go with it: rows r - s. */
static void sbi_hold_hang(sbi_hold *h, const sbi_rigid *rigid, int at)
{
    const sb_body *b = h->body;
    size_t n = 6 * (size_t)h->all;
    sbi_hold_measure(h, rigid);
    for (int i = 0; i < rigid->count; i++)
        for (int axis = 0; axis < 3 && sbi_hold_is_active(b, rigid->hung[i]); axis++) {
            double r[6] = {0, 0, 0, 0, 0, 0}, s[6];
            int part = h->index_of[b->node_component[rigid->hung[i]]];
            sbi_body_add_motion(b, rigid->hung[i], axis, -1, r);
            sbi_hold_motion(h, rigid->hung[i], axis, s);
            sbi_body_add_gram(h->gram, n, part, part, r, r);
            sbi_body_add_gram(h->gram, n, part, at, r, s);
            sbi_body_add_gram(h->gram, n, at, part, s, r);
            sbi_body_add_gram(h->gram, n, at, at, s, s);
        }
}

static int sbi_hold_first_node(const sb_body *body, int part)
{
    int node = 0;
    while (body->node_component[node] != part)
        node++;
    return node;
}

/* A part that the gram does not have. */
static void sbi_hold_look_at_rest(const sbi_hold *h, sbi_loose *loose)
{
    const sb_body *b = h->body;
    double trace;
    for (int c = 0; c < b->component_count; c++)
        if (h->index_of[c] < 0 && sbi_body_free_motion(b->support_grams[c], 1, &trace) >= 0) {
            loose->node = sbi_hold_first_node(b, c);
            return;
        }
}

static void sbi_hold_look(sbi_hold *h, sbi_loose *loose)
{
    const sb_body *b = h->body;
    int motion;
    sbi_body_gather_holds(b);
    sbi_hold_copy(h);
    for (int k = 0; k < b->rigids->count; k++)
        sbi_hold_hang(h, b->rigids->list[k], h->parts + k);
    motion = sbi_body_free_motion(h->gram, h->all, h->traces);
    if (motion < 0) {
        sbi_hold_look_at_rest(h, loose);
        return;
    }
    for (int c = 0; c < b->component_count; c++)
        if (h->index_of[c] == motion / 6)
            loose->node = sbi_hold_first_node(b, c);
    if (motion / 6 >= h->parts) {
        const sbi_rigid *r = b->rigids->list[motion / 6 - h->parts];
        loose->rigid = r->id;
        loose->node = r->count > 0 ? r->hung[0] : -1;
    }
}

SBI_API sb_result sbi_body_find_loose(const sb_body *body, sbi_loose *loose, sb_error *error)
{
    sbi_hold h;
    sb_result result = SB_OK;
    loose->node = -1;
    loose->rigid = 0;
    if (!body->rigids || body->rigids->count == 0) {
        loose->node = sbi_body_unsupported_node(body);
        return SB_OK;
    }
    memset(&h, 0, sizeof h);
    h.body = body;
    if (sbi_hold_take_memory(&h))
        sbi_hold_look(&h, loose);
    else
        result = sbi_rigid_no_memory(error, 0);
    sbi_free(&body->allocator, h.gram);
    sbi_free(&body->allocator, h.index_of);
    return result;
}

SBI_API sb_result sbi_body_check_held(const sb_body *body, sb_error *error)
{
    sbi_loose loose;
    sb_result result = sbi_body_find_loose(body, &loose, error);
    if (result == SB_OK && loose.rigid > 0)
        return sbi_fail_node(error, SB_ERROR_UNCONSTRAINED, loose.node,
                             "rigid body %d can move freely: let more nodes hang on it, or support what does",
                             loose.rigid);
    if (result == SB_OK && loose.node >= 0)
        return sbi_fail_node(error, SB_ERROR_UNCONSTRAINED, loose.node,
                             "the part of the mesh with node %d can move freely: support it", loose.node);
    return result;
}
