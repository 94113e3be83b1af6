/* The camera's trigger line. */
#ifndef PLATE_TRIGGER_H
#define PLATE_TRIGGER_H

#include <stdbool.h>
#include <stdint.h>

#define LONGEST_PULSE_MS 8 /* less than the shortest table: the line falls before it rises again */

typedef struct {
    uint16_t phase;   /* of a cycle or a tail at which a pulse begins [1/65536 of its length] */
    uint8_t pulse_ms; /* 0: none */
    bool done;        /* this cycle or tail has had its pulse */
    uint32_t into;    /* it, in the tick before [TICK_S] */
    uint64_t rose_us; /* when the last pulse began */
} Trigger;

/* Whether the line is high in this tick, `into` a cycle or tail of `period` [TICK_S]; both 0: none plays. */
bool trigger_step(Trigger *trigger, uint64_t now_us, uint32_t into, uint32_t period);

#endif
