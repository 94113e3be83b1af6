/* Motion of the plate: along tables, while braking, and home. */
#ifndef PLATE_MOTION_H
#define PLATE_MOTION_H

#include "controller.h"

/* Maximum duration of a brake [TICK_S], 0.2 s. During a brake, the table's time advances by half of the
   brake's duration. */
#define BRAKE_TICKS 20000000u

/* Switch the current off. This counts as a stop if the current was on and `faults` is not 0. */
void motion_off(Controller *c, uint8_t faults);

/* Slow down along the table and its tail, then move home. Without a playing table, switch off at once.
   This counts as a stop, unless the plate already brakes for these reasons. */
void motion_brake(Controller *c, uint8_t faults);

/* Switch the current on, search for home if it is unknown, and move there. */
void motion_enable(Controller *c);

/* Whether a table continues the playing table at its splice, which has not been reached yet. */
bool motion_can_splice(const Controller *c, const Table *next);

/* Time since the start of the playing table [TICK_S]. */
uint32_t motion_elapsed(const Controller *c);

/* Advance by `dt_us`, at most MAX_TICK_US. Return whether there is a setpoint to command. */
bool motion_step(Controller *c, uint32_t dt_us, Setpoint *out);

#endif
