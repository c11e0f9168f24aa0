/* The physics of one trial of holdfast/simulation, for the page: an object, the six fingertips that hold it,
   people who hold or pull it, and the hand's drive. The formulas and their sources are in solver.py and
   drive.py there; names and frame are those of body.py: x from the thumb to the fingers, z along the object.
   Left out: boxes, and the effects (rotation, silicone with memory, texture, shakes). */
#ifndef SCENE_H
#define SCENE_H

enum { SCENE_CONTACTS = 6, SCENE_THUMB = 2, SCENE_ELEMENTS = 5 };

/* Constants of a trial, as body.py's Body; brush_n_per_m is the spring of each element of a contact. */
typedef struct {
    double mass_kg, gravity_m_s2[3], curvature_per_m[2], straight_m;
    double at_m[2][SCENE_CONTACTS];
    double stiffness_n_per_m[SCENE_CONTACTS], damping_n_s_per_m[SCENE_CONTACTS], brush_n_per_m[SCENE_CONTACTS];
    double pressure[SCENE_ELEMENTS];
    double static_mu, kinetic_mu, stribeck_m_s, loss_s;
} scene_body;

/* A person, as body.py's Pull: a damped spring to a moving target, who may bear a share of the weight. */
typedef struct {
    double stiffness_n_per_m, damping_n_s_per_m, cap_n, weight_share, target_m[3], target_m_s[3];
} scene_person;

/* Where everything is, as body.py's State. agents_n: force of the people in the last step. */
typedef struct {
    double position_m[3], velocity_m_s[3];
    double stretch_m[2][SCENE_ELEMENTS][SCENE_CONTACTS];
    double rho[SCENE_ELEMENTS][SCENE_CONTACTS], slip_m_s[SCENE_ELEMENTS][SCENE_CONTACTS];
    double depth_m[SCENE_CONTACTS], normal_n[SCENE_CONTACTS], agents_n[3], brush_j;
    double offset_m[2][SCENE_CONTACTS], recess_m[SCENE_CONTACTS];
} scene_state;

/* The hand's drive, as drive.py's Drive and Actuator; all but the first two in N a side. */
typedef struct {
    double lag_s, fastest_n_s, ceiling_n, backlash_n;
    double own_n, motor_n, place_n, speed_n_s;
} scene_drive;

/* Nothing moves, nothing is stretched; closure_m [SCENE_CONTACTS]: how far each finger is closed. */
void scene_rest(const scene_body *body, const double *closure_m, scene_state *state);

/* One step of dt_s; closure_m: at its end. */
void scene_step(const scene_body *body, scene_state *state, const double *closure_m, const scene_person *people,
                int count, double dt_s);

/* Forces [SCENE_CONTACTS][3] on the fingertips: shear x, y, and normal. */
void scene_forces(const scene_body *body, const scene_state *state, double *forces_n);

/* The drive follows the larger of target_n (0 for none) and the wearer's own_n; returns its place_n. */
double scene_drive_step(scene_drive *drive, double target_n, double own_n, double dt_s);

/* 0 below 0, 1 above 1, minimum jerk between. */
double scene_smooth(double u);

#endif
