/* contact_read: what a contact says of the last step, besides its tools' wrenches. */
#include <string.h>

#include "contact_private.h"

SB_API int sb_contact_points(const sb_contact *contact, sb_contact_point *points, int capacity)
{
    if (!contact)
        return 0;
    for (int e = 0; points && e < contact->entry_count && e < capacity; e++) {
        const sbi_contact_entry *entry = contact->entries + e;
        sb_contact_point *point = points + e;
        memset(point, 0, sizeof *point);
        point->tool = entry->tool;
        point->other_element = point->other_face = -1;
        point->element = contact->faces->elements[entry->face];
        point->face = contact->faces->sides[entry->face];
        point->sticks = entry->sticks;
        point->gap = entry->gap;
        point->area = entry->area;
        point->point = entry->point;
        point->normal = entry->normal;
        point->force = entry->force;
    }
    for (int e = 0; points && e < contact->pairs.entry_count && contact->entry_count + e < capacity; e++)
        sbi_pairs_read_point(contact, e, points + contact->entry_count + e);
    return contact->entry_count + contact->pairs.entry_count;
}

SB_API sb_result sb_contact_pressures(const sb_contact *contact, sb_real *pressures)
{
    const sbi_contact_faces *faces;
    int nodes;
    if (!contact || !pressures)
        return SB_ERROR_ARGUMENT;
    faces = contact->faces;
    nodes = sb_body_node_count(contact->body);
    memset(pressures, 0, (size_t)nodes * sizeof *pressures);
    for (int e = 0; e < contact->entry_count; e++) {
        const sbi_contact_entry *entry = contact->entries + e;
        const int *list = sbi_contact_face_nodes(faces, entry->face);
        const sb_real *weights = sbi_contact_sample_weights(faces, entry->face, entry->parts, entry->sample);
        sb_real push = sb_v3_dot(entry->force, entry->normal);
        for (int a = 0; a < faces->sizes[entry->face]; a++)
            pressures[list[a]] += weights[a] * push;
    }
    sbi_pairs_add_pushes(contact, pressures);
    for (int i = 0; i < nodes; i++) {
        sb_real area = sbi_contact_node_area(faces, i);
        pressures[i] = area > 0 ? pressures[i] / area : 0;
    }
    return SB_OK;
}

SB_API sb_contact_info sb_contact_get_info(const sb_contact *contact)
{
    sb_contact_info none;
    memset(&none, 0, sizeof none);
    return contact ? contact->info : none;
}
