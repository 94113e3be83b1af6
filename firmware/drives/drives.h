/* Drives on a bus instead of the board's bridges. They implement hal_drive, hal_ready, hal_command,
   hal_measure, hal_home, hal_faults and hal_trouble. The board provides the bus. */
#ifndef PLATE_DRIVES_H
#define PLATE_DRIVES_H

#include "../hal.h"
#include "../piece.h"

/* Data of one motor's drive from the rig file, compiled in like the limits. */
typedef struct {
    uint8_t node;
    float counts_per_m; /* position counts per metre */
    float sign;         /* 1, or -1 if the drive counts against the motor's direction */
    bool absolute;      /* home is position 0 of the drive; if false, the position at the first enable */
    uint32_t serial;    /* object 1018h:04; 0: any */
    float weight;       /* weight of the motor: the weighted sum of all travels is 0 for a rigid plate */
} Drive;

/* Start the drives. The memory of `limits` must remain valid. */
void drives_start(const Drive drives[MOTORS], const Limits *limits);
void drives_begin(void); /* call this before each controller_tick: process received frames */
void drives_end(void);   /* call this after controller_tick: send due frames */

#endif
