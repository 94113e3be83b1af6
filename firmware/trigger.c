#include "trigger.h"

#define REST_US 100000u /* period of the pulses while no table plays [us] */
#define US_PER_MS 1000u

bool trigger_step(Trigger *t, uint64_t now_us, uint32_t elapsed, uint32_t period)
{
    if (t->pulse_ms == 0)
        return false;
    bool rises = false;
    if (period == 0) {
        rises = now_us - t->rose_us >= REST_US;
        t->done = false;
    } else {
        if (elapsed < t->elapsed) {
            /* the next cycle or tail has begun: a pulse was due between the last tick and the end */
            rises = !t->done;
            t->done = false;
        }
        if (!t->done && elapsed >= (uint32_t)((uint64_t)period * t->phase >> 16))
            rises = t->done = true;
    }
    t->elapsed = elapsed;
    if (rises)
        t->rose_us = now_us;
    return now_us - t->rose_us < t->pulse_ms * US_PER_MS;
}
