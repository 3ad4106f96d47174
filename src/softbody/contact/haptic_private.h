/* haptic_private: what is inside an sb_haptic. Internal: the files haptic*.c of the simulation's side share it.
 *
 * Each thread has its own part; between them are two mailboxes: frames to the device's, reports to the simulation's. */
#ifndef SB_HAPTIC_PRIVATE_H
#define SB_HAPTIC_PRIVATE_H

#include "contact_private.h"
#include "haptic_mailbox.h"
#include "haptic_servo.h"

/* What a call of the device's thread leaves for the simulation. */
typedef struct sbi_haptic_report {
    sb_tool_state wanted;
    sb_haptic_info info;
} sbi_haptic_report;

/* A cluster of the last frame, and what is known of its stiffness. */
typedef struct sbi_haptic_known {
    sbi_d3 normal;     /* as the cluster's */
    double area;       /* m^2 that touched */
    double stiffness;  /* N/m; 0: not known */
    double tangential; /* over the stiffness */
    int normal_age;    /* steps since each was found */
    int tangent_age;
} sbi_haptic_known;

struct sb_haptic {
    sb_allocator allocator;
    sb_contact *contact;
    int tool;
    int hangs; /* 1: the tool's own spring couples it to the hand */

    sbi_servo servo; /* of the device's thread */
    sbi_mailbox frame_box, report_box;
    sbi_haptic_frame frames[SBI_MAILBOX_SLOTS];
    sbi_haptic_report reports[SBI_MAILBOX_SLOTS];

    /* of the simulation's thread */
    int has_report;
    int known_count;
    sbi_haptic_known known[SBI_HAPTIC_CLUSTERS];
    int *cluster_of; /* [max_contacts] by entry of the tool */
    void *memory;
};

SBI_API sbi_d_pose sbi_haptic_pose(const sb_pose *from);
/* What the tool feels of the last step, with one stiffness found anew. */
SBI_API void sbi_haptic_make_frame(sb_haptic *haptic, sbi_haptic_frame *frame);

#endif /* SB_HAPTIC_PRIVATE_H */
