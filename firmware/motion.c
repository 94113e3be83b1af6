#include "motion.h"

#include <string.h>

#include "message.h"

#define GO_HOME_US 500000u /* duration of a motion home over one stroke: up to 0.04 m/s, 0.25 m/s2 [us] */
#define GO_HOME_S 0.5f
#define SEARCH_US 5000000u  /* maximum duration of the search for home */
#define TICKS_PER_US 100u   /* number of TICK_S in a microsecond */

void motion_off(Controller *c, uint8_t faults)
{
    hal_drive(false);
    if (faults && c->state != STATE_OFF)
        c->stops++;
    c->state = STATE_OFF;
    c->faults |= faults;
    c->waiting = c->going_home = c->is_commanded = false;
}

/* Start a motion home, from rest at c->commanded. STATE_HOMING ends in READY, STATE_BRAKING in OFF. */
static void go_home(Controller *c)
{
    memcpy(c->home_start, c->commanded.position, sizeof c->home_start);
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
        c->brake_time = 0;
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
static void wait_for_home(Controller *c)
{
    if (hal_ready() && hal_home())
        c->faults &= (uint8_t)~FAULT_NO_HOME;
    else if (c->now_us - c->enabled_us >= SEARCH_US)
        motion_off(c, FAULT_HARDWARE);
}

/* Start the waiting table. The buffer of the previous table becomes free. */
static void start_next_table(Controller *c)
{
    int before = c->playing;
    c->tables[before].id = 0;
    c->playing = c->next;
    c->next = before;
    c->waiting = false;
    c->table_time = table_knot(&c->tables[c->playing], 0)->ticks;
    c->played = 0;
}

uint32_t motion_elapsed(const Controller *c)
{
    return c->table_time - table_knot(&c->tables[c->playing], 0)->ticks;
}

/* Whether the plate must brake now, because the playing stream has just enough knots left for a brake. */
static bool stream_runs_out(const Controller *c, uint32_t dt)
{
    const Table *table = &c->tables[c->playing];
    return c->state == STATE_PLAYING && table->streams && !table_rests(table) &&
           motion_elapsed(c) + dt + BRAKE_TICKS / 2 > table_period(table);
}

bool motion_can_splice(const Controller *c, const Table *next)
{
    const Table *table = &c->tables[c->playing];
    return c->state == STATE_PLAYING && motion_elapsed(c) < table->splice &&
           table_follows(next, table);
}

/* Advance the table's time. At the table's splice or end, start the next table, repeat the table, or come
   to rest. A cycle and a tail are longer than any tick, so this happens at most once per tick. */
static void advance_table(Controller *c, uint32_t step)
{
    const Table *table = &c->tables[c->playing];
    uint32_t elapsed = motion_elapsed(c), remaining = table_period(table) - elapsed;
    if (c->waiting && motion_can_splice(c, &c->tables[c->next]) &&
        step >= table->splice - elapsed) {
        step -= table->splice - elapsed;
        start_next_table(c);
        c->table_time = step;
    } else if (step < remaining) {
        c->table_time += step;
    } else if (c->waiting) {
        start_next_table(c);
        c->table_time = step - remaining;
    } else if (c->state == STATE_PLAYING && !table->streams && ++c->played < table->repeats) {
        c->table_time = step - remaining;
    } else {
        c->table_time += remaining;
        if (c->state == STATE_PLAYING)
            c->state = STATE_READY;
    }
}

/* Speed of the table's time while braking, from 1 to 0, at the fraction u of the brake's duration. */
static float brake_rate(float u)
{
    return 1 - u * u * (3 - 2 * u);
}

/* Advance along the table, with decreasing speed while braking. Let s(t) be the table's time, and p(s) the
   table's position. The setpoint is p(s(t)), with the velocity p' s' and the acceleration p'' s'^2 + p' s''.
   Here, s' is `rate`, and s'' is `slowing`. Without a brake, s' = 1 and s'' = 0. */
static void advance_playing(Controller *c, uint32_t dt, Setpoint *out)
{
    float rate = 1, slowing = 0;
    uint32_t step = dt;
    if (stream_runs_out(c, dt))
        motion_brake(c, FAULT_HOST_SILENT);
    if (c->state == STATE_BRAKING) {
        uint32_t end = c->brake_time + dt < c->brake_length ? c->brake_time + dt : c->brake_length;
        float length = (float)c->brake_length;
        float u = (float)end / length, before = (float)c->brake_time / length;
        /* Simpson's rule is exact for a cubic. */
        float mean = (brake_rate(before) + 4 * brake_rate((before + u) / 2) + brake_rate(u)) / 6;
        step = (uint32_t)((float)(end - c->brake_time) * mean + 0.5f);
        rate = brake_rate(u);
        slowing = 6 * u * (u - 1) / (length * TICK_S);
        c->brake_time = end;
    }
    advance_table(c, step);
    table_at(&c->tables[c->playing], motion_elapsed(c), out);
    for (int m = 0; m < MOTORS; m++) {
        out->acceleration[m] = out->acceleration[m] * (rate * rate) + slowing * out->velocity[m];
        out->velocity[m] *= rate;
    }
}

/* Move home from the position p0 = home_start, from rest to rest. With the fraction u of the duration T:

       p = p0 w(u),    w(u) = 1 - u^3 (10 - 15 u + 6 u^2),    p' = p0 w'(u) / T,    p'' = p0 w''(u) / T^2 */
static bool advance_home(Controller *c, uint32_t dt_us, Setpoint *out)
{
    c->home_us = c->home_us + dt_us < GO_HOME_US ? c->home_us + dt_us : GO_HOME_US;
    float u = (float)c->home_us / (float)GO_HOME_US;
    float weight = 1 - u * u * u * (10 - u * (15 - 6 * u));
    float weight_rate = -30 * u * u * (1 - u) * (1 - u) / GO_HOME_S;
    float weight_accel = -60 * u * (1 - u) * (1 - 2 * u) / (GO_HOME_S * GO_HOME_S);
    for (int m = 0; m < MOTORS; m++) {
        out->position[m] = weight * c->home_start[m];
        out->velocity[m] = weight_rate * c->home_start[m];
        out->acceleration[m] = weight_accel * c->home_start[m];
    }
    if (c->home_us == GO_HOME_US) {
        c->going_home = false;
        if (c->state == STATE_BRAKING) {
            motion_off(c, 0);
            return false;
        }
        c->state = STATE_READY;
    }
    return true;
}

bool motion_step(Controller *c, uint32_t dt_us, Setpoint *out)
{
    uint32_t dt = dt_us * TICKS_PER_US;
    if (c->state == STATE_READY && c->waiting) {
        start_next_table(c);
        c->state = STATE_PLAYING;
        dt = 0; /* the motion begins in this tick */
    }
    if (c->state == STATE_HOMING && !c->going_home && (c->faults & FAULT_NO_HOME || !hal_ready())) {
        wait_for_home(c);
        return false;
    }
    if (c->state == STATE_HOMING && !c->going_home) {
        memset(&c->commanded, 0, sizeof c->commanded);
        memcpy(c->commanded.position, c->measured, sizeof c->measured);
        go_home(c);
    }
    if (c->state == STATE_BRAKING && !c->going_home && c->brake_time == c->brake_length)
        go_home(c);
    if (c->going_home)
        return advance_home(c, dt_us, out);
    if (c->state == STATE_PLAYING || c->state == STATE_BRAKING) {
        advance_playing(c, dt, out);
        return true;
    }
    memset(out, 0, sizeof *out); /* ready: at rest at the last setpoint */
    memcpy(out->position, c->commanded.position, sizeof out->position);
    return c->state == STATE_READY;
}
