#include "motion.h"

#include <math.h>
#include <string.h>

#include "message.h"

#define HOMEWARD_S 0.5 /* for a stroke: 0.04 m/s, 0.25 m/s2 */

static const float ZERO[MOTORS];

void motion_off(Controller *c, uint8_t faults)
{
    hal_drive(false);
    c->state = STATE_OFF;
    c->faults |= faults;
    c->waiting = c->going_home = false;
}

void motion_home(Controller *c, uint8_t state)
{
    c->state = state;
    c->going_home = true;
    c->home_time = 0;
}

void motion_brake(Controller *c, uint8_t faults)
{
    c->faults |= faults;
    c->waiting = false;
    if (c->state == STATE_PLAYING) {
        const Table *table = &c->tables[c->playing];
        double period = table_period(table);
        c->state = STATE_BRAKING;
        c->brake = 0;
        c->brake_s = period < BRAKE_S && !table->streams ? period : BRAKE_S;
    } else if (c->state != STATE_BRAKING) {
        motion_off(c, faults);
    }
}

/* The table that waits begins to play; the buffer of the one before is empty. */
static void take_over(Controller *c)
{
    c->tables[c->playing].id = 0;
    c->playing = !c->playing;
    c->waiting = false;
    c->played = 0;
}

/* Integral of the brake's rate 1 - 3 u^2 + 2 u^3. */
static double brake_path(double u)
{
    return u - u * u * u * (1 - u / 2);
}

/* Whether a stream's last knots are needed for a brake. */
static bool runs_dry(const Controller *c, double dt)
{
    const Table *table = &c->tables[c->playing];
    return c->state == STATE_PLAYING && table->streams && !table_rests(table) &&
           c->time + dt + BRAKE_S / 2 > table_period(table);
}

/* Take over, begin again or end where the table's time is beyond its end. */
static void wrap(Controller *c)
{
    const Table *table = &c->tables[c->playing];
    double period = table_period(table);
    if (table->streams && c->time >= period) { /* it ends at rest */
        c->time = period;
        if (c->state == STATE_PLAYING)
            c->state = STATE_READY;
    }
    while (c->time >= period && !table->streams && c->state != STATE_READY) {
        c->time -= period;
        c->played++;
        if (c->waiting) {
            take_over(c);
            table = &c->tables[c->playing];
            period = table_period(table);
        } else if (c->state == STATE_PLAYING && table->repeats && c->played >= table->repeats) {
            c->state = STATE_READY; /* all tables begin and end at rest, since the first one does */
            c->time = 0;
        }
    }
}

/* Along the table, slower and slower when braking. */
static void play(Controller *c, double dt, Setpoint *at)
{
    double rate = 1, slowing = 0, step = dt;
    if (runs_dry(c, dt))
        motion_brake(c, FAULT_HOST_SILENT);
    if (c->state == STATE_BRAKING) {
        double from = c->brake / c->brake_s, u = fmin(from + dt / c->brake_s, 1);
        c->brake = u * c->brake_s;
        rate = 1 - u * u * (3 - 2 * u);
        slowing = 6 * u * (u - 1) / c->brake_s;
        step = c->brake_s * (brake_path(u) - brake_path(from));
    }
    c->time += step;
    wrap(c);
    table_at(&c->tables[c->playing], c->time, at);
    for (int m = 0; m < MOTORS; m++) {
        float along = c->state == STATE_READY ? 0 : (float)rate;
        at->acceleration[m] *= along * along;
        at->acceleration[m] += (float)slowing * at->velocity[m];
        at->velocity[m] *= along;
    }
    c->from = *at;
    if (c->state == STATE_BRAKING && c->brake >= c->brake_s)
        motion_home(c, STATE_BRAKING);
}

/* From where the plate stands to home, from rest to rest. */
static bool homeward(Controller *c, double dt, Setpoint *at)
{
    c->home_time += dt;
    float u = (float)(c->home_time < HOMEWARD_S ? c->home_time / HOMEWARD_S : 1);
    float left = 1 - u * u * u * (10 - u * (15 - 6 * u));
    float slope = -30 * u * u * (1 - u) * (1 - u) / (float)HOMEWARD_S;
    float bend = -60 * u * (1 - u) * (1 - 2 * u) / (float)(HOMEWARD_S * HOMEWARD_S);
    for (int m = 0; m < MOTORS; m++) {
        at->position[m] = left * c->from.position[m];
        at->velocity[m] = slope * c->from.position[m];
        at->acceleration[m] = bend * c->from.position[m];
    }
    if (u >= 1) {
        c->going_home = false;
        memcpy(c->from.position, ZERO, sizeof ZERO);
        if (c->state == STATE_BRAKING) {
            motion_off(c, 0);
            return false;
        }
        c->state = STATE_READY;
    }
    return true;
}

bool motion_step(Controller *c, double dt, Setpoint *at)
{
    if (c->state == STATE_READY && c->waiting) {
        take_over(c);
        c->state = STATE_PLAYING;
        c->time = -dt; /* it begins now */
    }
    if (c->going_home)
        return homeward(c, dt, at);
    if (c->state == STATE_PLAYING || c->state == STATE_BRAKING) {
        play(c, dt, at);
        return true;
    }
    if (c->state == STATE_READY) {
        memset(at, 0, sizeof *at);
        memcpy(at->position, c->from.position, sizeof at->position);
        return true;
    }
    if (c->state == STATE_HOMING && hal_home()) {
        motion_off(c, 0);
        c->faults &= (uint8_t)~FAULT_NO_HOME;
    }
    return false;
}
