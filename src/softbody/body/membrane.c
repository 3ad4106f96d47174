/* membrane: thin elastic sheets on faces of a body. */
#include "membrane.h"

#include <limits.h>
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

/* Counts the outer faces, and copies their corners unless faces is NULL; -1: one of them has another number of corners.
 */
static int64_t sbi_membrane_copy_faces(const sb_body *body, int corners, int *faces)
{
    const int sides = sbi_element_face_count(sbi_domain_element(&body->domain));
    int64_t count = 0;
    sbi_body_face face;
    for (int e = 0; e < body->domain.cell_count; e++)
        for (int side = 0; side < sides && sb_body_cell_in_use(body, e); side++) {
            if (!sbi_body_outer_face(body, e, side, &face))
                continue;
            if (sb_element_corner_count(face.type) != corners)
                return -1;
            if (faces)
                memcpy(faces + (size_t)count * (size_t)corners, face.nodes, (size_t)corners * sizeof *faces);
            count++;
        }
    return count;
}

/* *faces = faces[*count][corners] of all outer faces, to be freed. */
static sb_result sbi_membrane_list_faces(const sb_body *body, int corners, int **faces, int *count, sb_error *error)
{
    int64_t found;
    if (body->own_points)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a body without elements has no faces for a membrane");
    found = sbi_membrane_copy_faces(body, corners, NULL);
    if (found < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the faces of the body have not %d corners", corners);
    if (found > INT_MAX)
        return sbi_fail(error, SB_ERROR_MEMORY, "the body has too many faces");
    *count = (int)found;
    *faces = (int *)sbi_alloc(&body->allocator, (size_t)found, (size_t)corners * sizeof **faces);
    if (!*faces)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d faces", *count);
    sbi_membrane_copy_faces(body, corners, *faces);
    return SB_OK;
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
