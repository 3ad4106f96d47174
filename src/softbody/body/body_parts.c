/* body_parts: the connected parts of a body and their boxes. */
#include "body_private.h"
#include "live_private.h"

#include <string.h>

/* One side of a box, at `side` times `face`: a node at side times x joins the nodes that lie in it. */
static void sbi_body_enter_face(sb_real *face, int *nodes, sb_real x, sb_real side)
{
    if (side * x > side * *face) {
        *face = x + 0; /* no -0: the order of the nodes is not to show */
        *nodes = 0;
    }
    *nodes += x == *face;
}

SBI_API void sbi_body_enter_box(sb_body *body, int component, sb_vec3 x)
{
    sb_vec3 *low = body->component_low + component, *high = body->component_high + component;
    int *nodes = body->component_faces[component];
    sbi_body_enter_face(&low->x, nodes, x.x, -1);
    sbi_body_enter_face(&low->y, nodes + 1, x.y, -1);
    sbi_body_enter_face(&low->z, nodes + 2, x.z, -1);
    sbi_body_enter_face(&high->x, nodes + 3, x.x, 1);
    sbi_body_enter_face(&high->y, nodes + 4, x.y, 1);
    sbi_body_enter_face(&high->z, nodes + 5, x.z, 1);
}

SBI_API void sbi_body_leave_box(sb_body *body, int component, sb_vec3 x)
{
    sb_vec3 low = body->component_low[component], high = body->component_high[component];
    int *nodes = body->component_faces[component];
    nodes[0] -= x.x == low.x;
    nodes[1] -= x.y == low.y;
    nodes[2] -= x.z == low.z;
    nodes[3] -= x.x == high.x;
    nodes[4] -= x.y == high.y;
    nodes[5] -= x.z == high.z;
}

SBI_API int sbi_body_box_is_right(const sb_body *body, int component)
{
    const int *nodes = body->component_faces[component];
    return nodes[0] > 0 && nodes[1] > 0 && nodes[2] > 0 && nodes[3] > 0 && nodes[4] > 0 && nodes[5] > 0;
}

SBI_API void sbi_body_make_boxes(sb_body *body)
{
    for (int c = 0; c < body->component_count; c++) {
        body->component_low[c] = sb_v3(SB_REAL_MAX, SB_REAL_MAX, SB_REAL_MAX);
        body->component_high[c] = sb_v3(-SB_REAL_MAX, -SB_REAL_MAX, -SB_REAL_MAX);
        memset(body->component_faces[c], 0, sizeof body->component_faces[c]);
    }
    for (int i = 0; i < body->domain.node_count; i++)
        if (body->node_component[i] >= 0)
            sbi_body_enter_box(body, body->node_component[i], body->reference[i]);
}

static void sbi_body_label_by_elements(sb_body *body)
{
    const sb_index_lists *lists = &body->node_elements;
    for (int i = 0; i < body->domain.node_count; i++) {
        body->node_component[i] =
            sbi_live_has_material(body, i) ? body->element_component.items[lists->items[lists->offsets[i]]] : -1;
    }
}

SBI_API void sbi_body_label_nodes(sb_body *body)
{
    if (sbi_live_follows(body))
        sbi_live_label_nodes(body);
    else
        sbi_body_label_by_elements(body);
    for (int c = 0; c < body->component_count; c++)
        body->tie_of[c] = -1;
    for (int i = 0; i < body->domain.node_count; i++)
        if (body->node_component[i] < 0) /* it would make every system singular */
            body->fixed[i] = SB_XYZ;
    sbi_body_make_boxes(body);
}
