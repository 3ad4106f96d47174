/* haptic_model: what tissue does to a tool until the next step has been computed. Internal.
 *
 * A frame is what one step knows: where the tool was, and its contacts gathered into at most eight planes (clusters)
 * with stiffness and friction. The wrench is then a function of the tool's pose, and of where it was a step ago, at no
 * cost:
 *
 *     gap change     d = n.(pose(r) - pose0(r))         n unit, the way the tissue pushes the tool
 *     push           f = max(0, f0 - kn d + fr)         f0 < 0: no contact yet, the gap is -f0/kn
 *     friction       t = -kt (what the point moved across n from its anchor), |t| <= mu f; the anchor is drawn along
 *     torque         r x (f n + t) + m0 f/f0
 *
 * kn is the step's: as stiff as tissue is against a change of the tool's speed, by its damping and mass. While a tool
 * goes on at the same speed these add nothing, and of the push of a way only the elastic share stays a step later. With
 * the share s that relaxes, and ways a step ago, z(t) = pose(t - dt),
 *
 *     relaxed        fr = s kn n.(z(now) - z(frame))    exactly what Kelvin-Voigt tissue does in implicit Euler steps
 *
 * s is learned from frames that follow each other.
 *
 * A force that is held between steps instead makes a hand with little damping swing: the delay of a step makes it
 * active. Source: contact-haptics sheet 9.2, 9.4; Barbic and James 2007; Zilles and Salisbury 1995 (anchors). */
#ifndef SB_HAPTIC_MODEL_H
#define SB_HAPTIC_MODEL_H

#include "haptic_math.h"

enum { SBI_HAPTIC_CLUSTERS = 8 };

typedef struct sbi_haptic_cluster {
    sbi_d3 point;      /* m, in the tool's frame */
    sbi_d3 normal;     /* unit, in space: out of the tissue */
    double push;       /* N along the normal, on the tool */
    sbi_d3 traction;   /* N across the normal, on the tool */
    sbi_d3 torque;     /* N m that push and traction at the point lack */
    double friction;   /* Coulomb's mu, >= 0 */
    double stiffness;  /* N/m along the normal, >= 0 */
    double tangential; /* N/m across it, >= 0; 0: no friction */
} sbi_haptic_cluster;

typedef struct sbi_haptic_frame {
    sbi_d_pose pose; /* of the tool at the end of the step */
    int count;       /* clusters, 0 .. SBI_HAPTIC_CLUSTERS */
    sbi_haptic_cluster clusters[SBI_HAPTIC_CLUSTERS];
} sbi_haptic_frame;

/* Tangent of tissue and coupling, eliminated: it serves for calls until it has changed too much. */
typedef struct sbi_haptic_factor {
    int size;    /* 3 or 6 unknowns; 0: there is none */
    int rows[6]; /* which row was taken for each unknown */
    double h[6][6], inverse[6];
} sbi_haptic_factor;

/* The frame that is in force, and what friction remembers. */
typedef struct sbi_haptic_model {
    sbi_haptic_frame frame;
    sbi_d3 places[SBI_HAPTIC_CLUSTERS];  /* m, pose0(r) */
    sbi_d3 anchors[SBI_HAPTIC_CLUSTERS]; /* m, where friction would vanish */
    sbi_d3 levers[SBI_HAPTIC_CLUSTERS];  /* m, torque over push */
    double gives[SBI_HAPTIC_CLUSTERS];   /* m/N, 1 over stiffness, 0 of none; along the normal and across it */
    double gives_across[SBI_HAPTIC_CLUSTERS];
    sbi_haptic_factor factor;
    sbi_d3 came;                         /* m: the tool's way in the frame's step; 0 where nothing touched before it */
    double relaxed[SBI_HAPTIC_CLUSTERS]; /* N that the push is more since, by relaxing: less where the tool goes in */
    double share;                        /* of the stiffness that relaxes within a step, learned from frames */
    double fit[2];                       /* N^2: sums that it is learned from */
} sbi_haptic_model;

/* What holds the tool to the hand. A translation of 0 is rigid, in rotation too; a rotation of 0 is rigid by itself. */
typedef struct sbi_haptic_coupling {
    double translation, rotation; /* N/m, N m/rad */
    double most;                  /* N: it pulls with no more; 0: no bound */
} sbi_haptic_coupling;

/* 1 when everything in the frame is finite, of a size that can be computed with, and within its range. */
SBI_API int sbi_haptic_frame_is_sound(const sbi_haptic_frame *frame);
/* Puts a sound frame in force. *model is zeros before the first. */
SBI_API void sbi_haptic_model_set(sbi_haptic_model *model, const sbi_haptic_frame *frame);
/* way (m): of the tool from the frame's pose to where it was one step before now. */
SBI_API void sbi_haptic_model_relax(sbi_haptic_model *model, sbi_d3 way);

/* Where the tool is that hangs on a hand at `hand`, what the hand feels, and the energy in planes and coupling (J).
 * Anchors follow. *tool in: the last such pose, where the search starts.
 *
 * The tool is where tissue and coupling balance, K_vc (x - q) + F(q) = 0. For a tangent K of the tissue that is
 *     q = (K_vc I - K)^-1 (K_vc x + F(q0) - K q0),
 * and the hand feels K_vc (q - x), with the tangent K_vc (K_vc I - K)^-1 K: two springs in series. */
SBI_API sbi_d_wrench sbi_haptic_model_feel(sbi_haptic_model *model, const sbi_haptic_coupling *coupling,
                                           const sbi_d_pose *hand, sbi_d_pose *tool, double *stored);

#endif /* SB_HAPTIC_MODEL_H */
