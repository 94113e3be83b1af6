/* A piece of a spline: the quintic between two knots, and whether it keeps the limits. */
#ifndef PLATE_PIECE_H
#define PLATE_PIECE_H

#include "hal.h"

#define TICK_S 1e-8f /* unit of a knot's time [s] */

/* Allowed relative excess over a limit. The host checks the plate's spline. The motors' splines differ
   from it by the curvature of the kinematics, up to 1e-3. */
#define LIMIT_SLACK 2e-3f

/* Maximum bisections per curve. Each one reduces the hull's error by a factor of 4. */
#define HALVINGS 12
#define MAX_HALVINGS 64 /* maximum bisections of all curves of a piece together */

/* Work of checking a piece [units]. Each bisection adds one unit. */
#define PIECE_WORK 8

#define CURVES (4 * MOTORS) /* position, speed, acceleration and force of each motor */

typedef struct {
    uint32_t ticks; /* time since the table's start [TICK_S] */
    float position[MOTORS], velocity[MOTORS], acceleration[MOTORS];
} Knot;

typedef struct {
    float position[MOTORS], velocity[MOTORS], acceleration[MOTORS];
} Setpoint;

/* Limits of each motor. */
typedef struct {
    float stroke_m, speed, accel;  /* [m], [m/s], [m/s2] */
    float force;                   /* peak [N] */
    float continuous_force;        /* continuous, root mean square [N] */
    float heat_s;                  /* thermal time constant [s] */
    float load[MOTORS][MOTORS];    /* matrix from the accelerations of all motors to their forces [kg] */
    float following_m;             /* following error that is a fault [m]; 0: no check */
} Limits;

/* Part of a Bezier curve whose hull exceeds the limit. */
typedef struct {
    float points[6], limit;
    uint8_t count;    /* number of the curve's control points */
    uint8_t halvings; /* remaining bisections */
} Curve;

/* State of the check of a piece, which may take several ticks. */
typedef struct {
    Curve open[CURVES + HALVINGS];
    uint8_t opens, halved;
    bool begun;
} PieceCheck;

/* Setpoint at the time `elapsed` [TICK_S] of a piece. */
void piece_at(const Knot *a, const Knot *b, uint32_t elapsed, Setpoint *out);

/* Start or continue the check of the piece between two knots while there is `work`, which must be above
   0. Return whether the check is complete. *keeps is then whether the piece keeps the limits. Adds the
   integral of each motor's squared force [N2 s] to `heat`. */
bool piece_check(PieceCheck *check, const Knot *a, const Knot *b, const Limits *limits, int *work,
                 float heat[MOTORS], bool *keeps);

/* Force of a motor for the accelerations of all motors [N]. */
float force_of(const Limits *limits, int motor, const float acceleration[MOTORS]);

#endif
