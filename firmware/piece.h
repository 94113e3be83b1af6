/* A piece of a spline: the quintic between two knots, and whether it keeps the limits. */
#ifndef PLATE_PIECE_H
#define PLATE_PIECE_H

#include "hal.h"

#define TICK_S 1e-8f /* unit of a knot's time [s] */

/* A limit may be passed by this share: the host keeps it on the plate's spline, and the motors' own
   splines differ from that by the curvature of the kinematics, up to 1e-3. */
#define LIMIT_SLACK 2e-3f

/* Halvings of a curve until its hull tells whether a limit is kept: it closes in by 4 each time. */
#define HALVINGS 12
#define MOST_HALVINGS 64 /* of all curves of a piece */

/* Work of looking: a halving is 1, the rest of a piece this much. */
#define PIECE_WORK 8

#define CURVES (4 * MOTORS) /* position, speed, acceleration and force of each motor */

typedef struct {
    uint32_t ticks; /* [TICK_S] since the table's start */
    float position[MOTORS], velocity[MOTORS], acceleration[MOTORS];
} Knot;

typedef struct {
    float position[MOTORS], velocity[MOTORS], acceleration[MOTORS];
} Setpoint;

/* What each motor may do. */
typedef struct {
    float stroke_m, speed, accel;  /* [m], [m/s], [m/s2] */
    float force;                   /* peak [N] */
    float continuous_force;        /* root mean square, continuous [N] */
    float heat_s;                  /* time constant of its heat [s] */
    float load[MOTORS][MOTORS];    /* forces for the accelerations of all motors [kg] */
    float following_m;             /* following error that is a fault [m]; 0: not watched */
} Limits;

/* A part of a Bezier curve that its hull does not show to be within its limit. */
typedef struct {
    float points[6], limit;
    uint8_t count;    /* of its points */
    uint8_t halvings; /* that are left to it */
} Curve;

/* Looking at a piece, which may take several ticks. */
typedef struct {
    Curve open[CURVES + HALVINGS];
    uint8_t opens, halved;
    bool begun;
} Look;

/* The setpoint `into` [TICK_S] a piece. */
void piece_at(const Knot *a, const Knot *b, uint32_t into, Setpoint *out);

/* Look, or go on looking, at the piece between two knots, for as long as there is `work`; some must
   be there. Returns whether that was all; *keeps tells then whether the piece keeps the limits.
   Adds the integral of each motor's force squared [N2 s] to `heat`. */
bool piece_look(Look *look, const Knot *a, const Knot *b, const Limits *limits, int *work,
                float heat[MOTORS], bool *keeps);

/* Force [N] of a motor for the accelerations of all. */
float force_of(const Limits *limits, int motor, const float acceleration[MOTORS]);

#endif
