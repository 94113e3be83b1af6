/* Drives on a bus in place of own bridges: they implement hal_drive, hal_ready, hal_command,
   hal_measure, hal_home, hal_faults and hal_trouble; the board gives the bus. */
#ifndef PLATE_DRIVES_H
#define PLATE_DRIVES_H

#include "../hal.h"
#include "../piece.h"

/* Of one motor; from the rig file, compiled in like its limits. */
typedef struct {
    uint8_t node;
    float counts_per_m; /* of the drive's position */
    float sign;         /* 1, or -1 where the drive counts against the motor's direction */
    bool absolute;      /* its position is 0 at home; else home is where the plate hangs */
    uint32_t serial;    /* object 1018h:04; 0: any */
    float fit;          /* times its travel, summed over the motors of a rigid plate, is 0 */
} Drive;

/* `limits` must stay. */
void drives_start(const Drive drives[MOTORS], const Limits *limits);
void drives_begin(void); /* before each controller_tick: take what came */
void drives_end(void);   /* after it: send what is due */

#endif
