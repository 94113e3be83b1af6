/* The camera's trigger line. */
#ifndef PLATE_TRIGGER_H
#define PLATE_TRIGGER_H

#include <stdbool.h>
#include <stdint.h>

#define MAX_PULSE_MS 8 /* shorter than the shortest table, so that the line falls before the next pulse */

typedef struct {
    uint16_t phase;   /* fraction of a cycle or tail at which a pulse begins [1/65536] */
    uint8_t pulse_ms; /* 0: no trigger */
    bool done;        /* whether the pulse of this cycle or tail has begun */
    uint32_t elapsed; /* time within the cycle or tail in the last tick [TICK_S] */
    uint64_t rose_us; /* time at which the last pulse began [us] */
} Trigger;

/* Whether the line is high in this tick, at the time `elapsed` of a cycle or tail of `period` [TICK_S]. Both are
   0 if none plays. */
bool trigger_step(Trigger *trigger, uint64_t now_us, uint32_t elapsed, uint32_t period);

#endif
