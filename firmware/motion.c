#include "motion.h"

#include <string.h>

#include "message.h"

#define HOMEWARD_US 500000u /* duration of a motion home over one stroke: up to 0.04 m/s, 0.25 m/s2 [us] */
#define HOMEWARD_S 0.5f
#define SEARCH_US 5000000u  /* maximum duration of the search for home */
#define TICKS_PER_US 100u   /* number of TICK_S in a microsecond */

void motion_off(Controller *c, uint8_t faults)
{
    hal_drive(false);
    if (faults && c->state != STATE_OFF)
        c->stops++;
    c->state = STATE_OFF;
    c->faults |= faults;
    c->waiting = c->going_home = c->follows = false;
}

/* Start a motion home, from rest at c->commanded. STATE_HOMING ends in READY, STATE_BRAKING in OFF. */
static void go_home(Controller *c)
{
    memcpy(c->from, c->commanded.position, sizeof c->from);
    c->going_home = true;
    c->home_us = 0;
}

void motion_brake(Controller *c, uint8_t faults)
{
    if (c->state == STATE_PLAYING) {
        const Table *table = &c->tables[c->playing];
        uint32_t period = table_period(table);
        bool from_home = !table->streams && knot_is_home(table_knot(table, 0));
        c->state = STATE_BRAKING;
        c->brake = 0;
        c->brake_length = from_home && period < BRAKE_TICKS ? period : BRAKE_TICKS;
        c->waiting = false;
        c->stops++;
        c->faults |= faults;
    } else if (c->state != STATE_BRAKING) {
        motion_off(c, faults);
    } else if (faults & ~c->faults) {
        c->stops++;
        c->faults |= faults;
    }
}

void motion_enable(Controller *c)
{
    c->faults &= FAULT_NO_HOME;
    c->state = STATE_HOMING;
    c->enabled_us = c->now_us;
    hal_drive(true);
}

/* Wait for the motors and search for home. The motion home begins in the next tick, at the position
   measured then. */
static void search(Controller *c)
{
    if (hal_ready() && hal_home())
        c->faults &= (uint8_t)~FAULT_NO_HOME;
    else if (c->now_us - c->enabled_us >= SEARCH_US)
        motion_off(c, FAULT_HARDWARE);
}

/* The waiting table begins to play, and the buffer of the last one becomes free. */
static void take_over(Controller *c)
{
    int before = c->playing;
    c->tables[before].id = 0;
    c->playing = c->next;
    c->next = before;
    c->waiting = false;
    c->time = table_knot(&c->tables[c->playing], 0)->ticks;
    c->played = 0;
}

uint32_t motion_into(const Controller *c)
{
    return c->time - table_knot(&c->tables[c->playing], 0)->ticks;
}

/* Whether the plate must brake now, because the playing stream has just enough knots left for a brake. */
static bool runs_dry(const Controller *c, uint32_t dt)
{
    const Table *table = &c->tables[c->playing];
    return c->state == STATE_PLAYING && table->streams && !table_rests(table) &&
           motion_into(c) + dt + BRAKE_TICKS / 2 > table_period(table);
}

bool motion_joins(const Controller *c, const Table *next)
{
    const Table *table = &c->tables[c->playing];
    return c->state == STATE_PLAYING && motion_into(c) < table->splice &&
           table_follows(next, table);
}

/* Advance the table's time. At the table's splice or end, start the next table, repeat the table, or come
   to rest. A cycle and a tail are longer than any tick, so this happens at most once per tick. */
static void pass(Controller *c, uint32_t step)
{
    const Table *table = &c->tables[c->playing];
    uint32_t into = motion_into(c), left = table_period(table) - into;
    if (c->waiting && motion_joins(c, &c->tables[c->next]) && step >= table->splice - into) {
        step -= table->splice - into;
        take_over(c);
        c->time = step;
    } else if (step < left) {
        c->time += step;
    } else if (c->waiting) {
        take_over(c);
        c->time = step - left;
    } else if (c->state == STATE_PLAYING && !table->streams && ++c->played < table->repeats) {
        c->time = step - left;
    } else {
        c->time += left;
        if (c->state == STATE_PLAYING)
            c->state = STATE_READY;
    }
}

/* Speed of the table's time while braking, from 1 to 0. */
static float brake_rate(float u)
{
    return 1 - u * u * (3 - 2 * u);
}

/* Advance along the table, with decreasing speed while braking. */
static void play(Controller *c, uint32_t dt, Setpoint *at)
{
    float rate = 1, slowing = 0;
    uint32_t step = dt;
    if (runs_dry(c, dt))
        motion_brake(c, FAULT_HOST_SILENT);
    if (c->state == STATE_BRAKING) {
        uint32_t end = c->brake + dt < c->brake_length ? c->brake + dt : c->brake_length;
        float length = (float)c->brake_length;
        float u = (float)end / length, before = (float)c->brake / length;
        /* Simpson's rule is exact for a cubic. */
        float mean = (brake_rate(before) + 4 * brake_rate((before + u) / 2) + brake_rate(u)) / 6;
        step = (uint32_t)((float)(end - c->brake) * mean + 0.5f);
        rate = brake_rate(u);
        slowing = 6 * u * (u - 1) / (length * TICK_S);
        c->brake = end;
    }
    pass(c, step);
    table_at(&c->tables[c->playing], motion_into(c), at);
    for (int m = 0; m < MOTORS; m++) {
        at->acceleration[m] = at->acceleration[m] * (rate * rate) + slowing * at->velocity[m];
        at->velocity[m] *= rate;
    }
}

/* Move home from the current position, from rest to rest. */
static bool homeward(Controller *c, uint32_t dt_us, Setpoint *at)
{
    c->home_us = c->home_us + dt_us < HOMEWARD_US ? c->home_us + dt_us : HOMEWARD_US;
    float u = (float)c->home_us / (float)HOMEWARD_US;
    float left = 1 - u * u * u * (10 - u * (15 - 6 * u));
    float slope = -30 * u * u * (1 - u) * (1 - u) / HOMEWARD_S;
    float bend = -60 * u * (1 - u) * (1 - 2 * u) / (HOMEWARD_S * HOMEWARD_S);
    for (int m = 0; m < MOTORS; m++) {
        at->position[m] = left * c->from[m];
        at->velocity[m] = slope * c->from[m];
        at->acceleration[m] = bend * c->from[m];
    }
    if (c->home_us == HOMEWARD_US) {
        c->going_home = false;
        if (c->state == STATE_BRAKING) {
            motion_off(c, 0);
            return false;
        }
        c->state = STATE_READY;
    }
    return true;
}

bool motion_step(Controller *c, uint32_t dt_us, Setpoint *at)
{
    uint32_t dt = dt_us * TICKS_PER_US;
    if (c->state == STATE_READY && c->waiting) {
        take_over(c);
        c->state = STATE_PLAYING;
        dt = 0; /* the motion begins in this tick */
    }
    if (c->state == STATE_HOMING && !c->going_home && (c->faults & FAULT_NO_HOME || !hal_ready())) {
        search(c);
        return false;
    }
    if (c->state == STATE_HOMING && !c->going_home) {
        memset(&c->commanded, 0, sizeof c->commanded);
        memcpy(c->commanded.position, c->measured, sizeof c->measured);
        go_home(c);
    }
    if (c->state == STATE_BRAKING && !c->going_home && c->brake == c->brake_length)
        go_home(c);
    if (c->going_home)
        return homeward(c, dt_us, at);
    if (c->state == STATE_PLAYING || c->state == STATE_BRAKING) {
        play(c, dt, at);
        return true;
    }
    memset(at, 0, sizeof *at); /* ready: at rest at the last setpoint */
    memcpy(at->position, c->commanded.position, sizeof at->position);
    return c->state == STATE_READY;
}
