/* The two halves of the firmware on a desk: line and time, motors. */
#ifndef PLATE_HOST_H
#define PLATE_HOST_H

#include "../controller.h"

/* Of motors.c or can.c, which also have the hal's functions of motors. */
Limits motors_start(void);
void motors_begin(void); /* before each tick */
void motors_end(void);   /* after it */
void motors_order(const char *line);

#endif
