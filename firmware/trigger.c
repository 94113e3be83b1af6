#include "trigger.h"

#define REST_US 100000u /* period of the pulses while no table plays [us] */
#define US_PER_MS 1000u

bool trigger_step(Trigger *t, uint64_t now_us, uint32_t into, uint32_t period)
{
    if (t->pulse_ms == 0)
        return false;
    bool rises = false;
    if (period == 0) {
        rises = now_us - t->rose_us >= REST_US;
        t->done = false;
    } else {
        if (into < t->into) { /* the next cycle or tail: a pulse was due between the last tick and its end */
            rises = !t->done;
            t->done = false;
        }
        if (!t->done && into >= (uint32_t)((uint64_t)period * t->phase >> 16))
            rises = t->done = true;
    }
    t->into = into;
    if (rises)
        t->rose_us = now_us;
    return now_us - t->rose_us < t->pulse_ms * US_PER_MS;
}
