/* contact_tell: calls to tools, told to the recorder of their body. contact_state.c plays them again. */
#include "contact_private.h"

SBI_API void sbi_contact_tell(const sb_contact *contact, sbi_contact_command command, int tool, const sb_real *reals,
                              int count)
{
    int ints[2];
    ints[0] = (int)command, ints[1] = tool;
    sbi_body_tell_part(contact->body, SBI_CONTACT_PART, ints, 2, reals, (size_t)count);
}

SBI_API void sbi_contact_tell_pose(const sb_contact *contact, sbi_contact_command command, int tool,
                                   const sb_pose *pose)
{
    sb_real reals[SBI_CONTACT_POSE_REALS];
    sbi_contact_pack_pose(pose, reals);
    sbi_contact_tell(contact, command, tool, reals, SBI_CONTACT_POSE_REALS);
}
