/* membrane: thin elastic sheets on faces of a body. */
#include "membrane.h"

#include <string.h>

#include "body_guest.h"
#include "membrane_law.h"

SB_API sb_membrane_def sb_default_membrane_def(void)
{
    sb_membrane_def def;
    memset(&def, 0, sizeof def);
    def.corners = 3;
    def.prestretch = 1;
    def.wrinkles = 1;
    return def;
}

/* ---- making ---- */

/* corners[faces][*count] of all outer faces, to be freed, with *count faces. */
static sb_result sbi_membrane_list_faces(const sb_body *body, int corners, int **faces, int *count, sb_error *error)
{
    sb_mesh mesh;
    sb_boundary boundary;
    int width;
    sb_result result;
    if (body->own_points)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a body without elements has no faces for a membrane");
    result = sbi_body_copy_mesh(body, &body->allocator, &mesh, error);
    if (result != SB_OK)
        return result;
    result = sb_mesh_boundary(&mesh, 0, &body->allocator, &boundary, error);
    sb_mesh_free(&mesh);
    if (result != SB_OK)
        return result;
    *count = boundary.surface.element_count;
    width = sb_element_node_count(boundary.surface.element_type);
    *faces = NULL;
    if (sb_element_corner_count(boundary.surface.element_type) != corners)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "the faces of the body have not %d corners", corners);
    else
        *faces = (int *)sbi_alloc(&body->allocator, (size_t)*count, (size_t)corners * sizeof(int));
    if (result == SB_OK && !*faces)
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d faces", *count);
    for (int k = 0; result == SB_OK && k < *count * corners; k++)
        (*faces)[k] = boundary.surface.elements[(size_t)(k / corners) * (size_t)width + (size_t)(k % corners)];
    sb_boundary_free(&boundary);
    return result;
}

/* As the adder takes it. */
static void sbi_membrane_tell(sb_body *body, sbi_command_code code, int a, const sbi_membrane_law *law,
                              const int *faces, size_t ints)
{
    const sb_real numbers[3] = {law->thickness, law->shear, law->prestretch};
    sbi_body_tell(body, code, a, law->wrinkles, faces, ints, numbers, 3);
}

/* Adds one of listed faces. */
static sb_result sbi_membrane_add(sb_body *body, const sb_membrane_def *def, const int *faces, int count,
                                  const sbi_membrane_law *law, int *load_id, sb_error *error)
{
    sbi_load load;
    sb_result result = sbi_load_make_faces(body, SBI_LOAD_MEMBRANE, faces, count, def->corners, &load, error);
    if (result != SB_OK)
        return result;
    load.membrane = load.balanced_membrane = *law;
    result = sbi_membrane_check_faces(body, &load, error);
    if (result == SB_OK)
        result = sbi_load_reserve(body, error);
    if (result != SB_OK) {
        sbi_load_release(&body->allocator, &load);
        return result;
    }
    sbi_load_append(body, &load, load_id);
    sbi_membrane_tell(body, SBI_COMMAND_ADD_MEMBRANE, def->corners, law, faces, (size_t)count * (size_t)def->corners);
    return SB_OK;
}

static sbi_membrane_law sbi_membrane_make_law(sb_real thickness, sb_real shear, sb_real prestretch, int wrinkles)
{
    sbi_membrane_law law;
    law.thickness = thickness;
    law.shear = shear;
    law.prestretch = prestretch;
    law.wrinkles = wrinkles != 0;
    return law;
}

SB_API sb_result sb_body_add_membrane(sb_body *body, const sb_membrane_def *def, int *load_id, sb_error *error)
{
    int *listed = NULL, count;
    sbi_membrane_law law;
    sb_result result;
    if (!body || !def || def->corners < 3 || def->corners > 4 || (def->faces && def->face_count < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_add_membrane needs a body, and faces of 3 or 4 corners");
    if (body->integrator == SB_CENTRAL_DIFFERENCE && !def->wrinkles)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "central differences take membranes that wrinkle only: others stiffen without bound as they "
                        "are pressed together");
    law = sbi_membrane_make_law(def->thickness, def->shear, def->prestretch, def->wrinkles);
    result = sbi_membrane_check_law(&law, error);
    count = def->face_count;
    if (result == SB_OK && !def->faces)
        result = sbi_membrane_list_faces(body, def->corners, &listed, &count, error);
    if (result == SB_OK)
        result = sbi_membrane_add(body, def, listed ? listed : def->faces, count, &law, load_id, error);
    sbi_free(&body->allocator, listed);
    return result;
}

SB_API sb_result sb_body_set_membrane(sb_body *body, int load_id, sb_real thickness, sb_real shear, sb_real prestretch)
{
    sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_MEMBRANE);
    sbi_membrane_law law;
    sb_result result;
    if (!body)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    law = sbi_membrane_make_law(thickness, shear, prestretch, load->membrane.wrinkles);
    result = sbi_membrane_check_law(&law, NULL);
    if (result != SB_OK)
        return result;
    body->guard.stable_step = 0;
    load->membrane = law;
    sbi_membrane_tell(body, SBI_COMMAND_MEMBRANE, load_id, &law, NULL, 0);
    return SB_OK;
}

/* ---- readings ---- */

SB_API sb_result sb_body_membrane_faces(const sb_body *body, int load_id, int *count, int *corners)
{
    const sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_MEMBRANE);
    if (!body)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    if (count)
        *count = load->row_count;
    for (int j = 0; corners && j < load->row_count; j++)
        for (int k = 0; k < sb_element_corner_count(load->face_types[j]); k++)
            *corners++ = load->nodes[load->row_start[j] + k];
    return SB_OK;
}

SB_API sb_result sb_body_membrane_states(const sb_body *body, int load_id, sb_membrane_state *states)
{
    const sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_MEMBRANE);
    if (!body || !states)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    for (int j = 0; j < load->row_count; j++)
        states[j] = sbi_membrane_state_of(body, load, j);
    return SB_OK;
}
