/* The two halves of the firmware without hardware: line and time (host.c), and motors. */
#ifndef PLATE_HOST_H
#define PLATE_HOST_H

#include "../controller.h"

/* Defined in motors.c or can.c, which also implement the hal's functions for motors. */
Limits motors_start(void);
void motors_begin(void); /* call this before each tick */
void motors_end(void);   /* call this after `controller_tick` */
void motors_order(const char *line);

#endif
