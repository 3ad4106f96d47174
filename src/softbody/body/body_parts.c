/* body_parts: the connected parts of a body, their boxes, and what they weigh. */
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

/* ---- readings ---- */

/* Sums over a part, in its row of support_grams. */
enum { SBI_PART_NUMBER = 0, SBI_PART_NODES = 1, SBI_PART_VOLUME = 2, SBI_PART_MASS = 3, SBI_PART_FIRST = 4 };

/* Numbers the parts by their lowest nodes, which go into the list; returns how many there are. */
static int sbi_body_number_parts(sb_body *body, sb_part *parts, int capacity)
{
    int count = 0;
    memset(body->support_grams, 0, (size_t)body->component_count * sizeof body->support_grams[0]);
    for (int i = 0; i < body->domain.node_count; i++) {
        double *sum = body->node_component[i] < 0 ? NULL : body->support_grams[body->node_component[i]];
        if (!sum)
            continue;
        if (sum[SBI_PART_NODES] == 0) {
            if (count < capacity)
                parts[count].node = i;
            sum[SBI_PART_NUMBER] = count++;
        }
        sum[SBI_PART_NODES] += 1;
    }
    return count;
}

/* Loads on pieces of bodies that step explicitly have the centre of the masses, not that of the material: adds to a
 * part's first moment what lies between them. */
static void sbi_body_add_piece_moment(const sb_body *body, int cell, double *first)
{
    int n = body->domain.nodes_per_cell;
    const int *nodes = body->domain.cells + (size_t)cell * (size_t)n;
    sb_real lumps[10], exact[10], mass[100], load[10];
    sb_vec3 x[10];
    if (body->integrator != SB_CENTRAL_DIFFERENCE || !sbi_live_is_piece(body, cell))
        return;
    memset(x, 0, sizeof x); /* compilers do not know n */
    for (int a = 0; a < n; a++)
        x[a] = body->reference[nodes[a]];
    sbi_piece_lumps(body->live->pieces + cell, n, sbi_domain_tet_volume(x), lumps, exact);
    sbi_body_cell_mass(body, cell, SB_MASS_LUMPED, x, mass, load);
    for (int a = 0; a < n; a++) {
        double m = (double)(sbi_live_density(body, cell) * (exact[a] - load[a]));
        first[0] += m * (double)body->position[nodes[a]].x;
        first[1] += m * (double)body->position[nodes[a]].y;
        first[2] += m * (double)body->position[nodes[a]].z;
    }
}

/* Masses from int rho N dV, so that the first moment is that of the material wherever the nodes are: places within an
 * element are sums of N x. */
static void sbi_body_sum_parts(sb_body *body)
{
    const sb_domain *domain = &body->domain;
    for (int i = 0; i < domain->node_count; i++)
        if (body->node_component[i] >= 0) {
            double *sum = body->support_grams[body->node_component[i]], m = (double)body->load_mass[i];
            sum[SBI_PART_MASS] += m;
            sum[SBI_PART_FIRST] += m * (double)body->position[i].x;
            sum[SBI_PART_FIRST + 1] += m * (double)body->position[i].y;
            sum[SBI_PART_FIRST + 2] += m * (double)body->position[i].z;
        }
    for (int e = 0; e < domain->cell_count; e++) {
        int part = body->node_component[domain->cells[(size_t)e * (size_t)domain->nodes_per_cell]];
        if (part < 0 || !sbi_live_has_cell(body, e))
            continue;
        body->support_grams[part][SBI_PART_VOLUME] += (double)sbi_body_element_volume(body, e);
        sbi_body_add_piece_moment(body, e, body->support_grams[part] + SBI_PART_FIRST);
    }
}

static void sbi_body_fill_part(const sb_body *body, const double *sum, sb_part *part)
{
    double m = sum[SBI_PART_MASS];
    part->node_count = (int)sum[SBI_PART_NODES];
    part->volume = (sb_real)sum[SBI_PART_VOLUME];
    part->mass = (sb_real)m;
    part->centre = body->position[part->node];
    if (m > 0) /* and not too little for sb_real */
        part->centre = sb_v3((sb_real)(sum[SBI_PART_FIRST] / m), (sb_real)(sum[SBI_PART_FIRST + 1] / m),
                             (sb_real)(sum[SBI_PART_FIRST + 2] / m));
}

SB_API sb_result sb_body_parts(sb_body *body, sb_part *parts, int capacity, int *count, int *numbers)
{
    if (!body || !count || capacity < 0 || (capacity > 0 && !parts))
        return SB_ERROR_ARGUMENT;
    *count = sbi_body_number_parts(body, parts, capacity);
    if (capacity > 0)
        sbi_body_sum_parts(body);
    for (int c = 0; c < body->component_count; c++) {
        const double *sum = body->support_grams[c];
        if (sum[SBI_PART_NODES] > 0 && (int)sum[SBI_PART_NUMBER] < capacity)
            sbi_body_fill_part(body, sum, parts + (int)sum[SBI_PART_NUMBER]);
    }
    for (int i = 0; numbers && i < body->domain.node_count; i++)
        numbers[i] =
            body->node_component[i] < 0 ? -1 : (int)body->support_grams[body->node_component[i]][SBI_PART_NUMBER];
    return SB_OK;
}
