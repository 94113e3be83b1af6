/* What the plate does: along tables, braking, on its way home. */
#ifndef PLATE_MOTION_H
#define PLATE_MOTION_H

#include "controller.h"

/* Longest brake [s]: short, but gentle against the plate's 10 g. It takes half as long of the path. */
#define BRAKE_S 0.2

/* Current off, for the reasons given. */
void motion_off(Controller *c, uint8_t faults);

/* Slow down along the table and go home; off at once where nothing plays. */
void motion_brake(Controller *c, uint8_t faults);

/* From c->from, at rest, to home; STATE_HOMING ends in READY, STATE_BRAKING in OFF. */
void motion_home(Controller *c, uint8_t state);

/* Let `dt` [s] pass; returns whether there is a setpoint to command. */
bool motion_step(Controller *c, double dt, Setpoint *at);

#endif
