/* What the plate does: along tables, braking, on its way home. */
#ifndef PLATE_MOTION_H
#define PLATE_MOTION_H

#include "controller.h"

/* Longest brake [TICK_S]: 0.2 s, short, but gentle against the plate's 10 g. It takes half as long
   of the path. */
#define BRAKE_TICKS 20000000u

/* Current off, for the reasons given: a stop, if current flowed and there are any. */
void motion_off(Controller *c, uint8_t faults);

/* Slow down along the table and its tail and go home; off at once where nothing plays. A stop, unless the plate
   brakes for these reasons already. */
void motion_brake(Controller *c, uint8_t faults);

/* Current on: find home if it is not known, then go there. */
void motion_enable(Controller *c);

/* Whether a table goes on where the one that plays is spliced, and that is still ahead. */
bool motion_joins(const Controller *c, const Table *next);

/* How far into the table that plays it is [TICK_S]. */
uint32_t motion_into(const Controller *c);

/* Let `dt_us`, at most MOST_TICK_US, pass; returns whether there is a setpoint to command. */
bool motion_step(Controller *c, uint32_t dt_us, Setpoint *at);

#endif
