/* Simulated motors that follow at once.

     fault N    the board has faults N
     search N   a search for home takes N ticks (1 at the start)
     jam N      1: the motors ignore commands and stand still; 0: they follow again
     place X    an external force moves the motors to X [m]

   Output: `at US q1..q4 v1..v4 a1..a4` in each tick with a setpoint, and `drive US ON` when the current
   is switched. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "host.h"

static uint8_t faults;
static bool on, jammed;
static int search = 1, searched;
static float position[MOTORS], acceleration[MOTORS];

/* Limits of config/rig.yaml. plate_sim's device computes `load` from plate and motors. */
static const Limits LIMITS = {
    .stroke_m = 0.010f, .speed = 1.0f, .accel = 100.0f,
    .force = 200.0f, .continuous_force = 100.0f, .heat_s = 60.0f,
    .load = {{0.575f, 0.425f, 0.15f, -0.15f}, {0.425f, 0.575f, -0.15f, 0.15f},
             {0.15f, -0.15f, 0.8f, 0.2f}, {-0.15f, 0.15f, 0.2f, 0.8f}},
    .following_m = 0.003f,
};

Limits motors_start(void) { return LIMITS; }
void motors_begin(void) {}

void motors_end(void)
{
    static bool shown;
    if (on != shown)
        printf("drive %llu %d\n", (unsigned long long)hal_time_us(), on);
    shown = on;
}

void motors_order(const char *line)
{
    if (!strncmp(line, "fault ", 6)) {
        faults = (uint8_t)atoi(line + 6);
    } else if (!strncmp(line, "search ", 7)) {
        search = atoi(line + 7);
    } else if (!strncmp(line, "jam ", 4)) {
        jammed = atoi(line + 4) != 0;
    } else if (!strncmp(line, "place ", 6)) {
        for (int m = 0; m < MOTORS; m++)
            position[m] = strtof(line + 6, NULL);
    }
}

bool hal_ready(void) { return true; }
bool hal_home(void) { return ++searched >= search; }
void hal_forget(void) {}
uint8_t hal_faults(void) { return faults; }

bool hal_trouble(Trouble *trouble)
{
    (void)trouble;
    return false;
}

void hal_drive(bool wanted)
{
    on = wanted;
    searched = 0;
}

void hal_command(const float p[MOTORS], const float v[MOTORS], const float a[MOTORS])
{
    if (!jammed) {
        memcpy(position, p, sizeof position);
        memcpy(acceleration, a, sizeof acceleration);
    }
    printf("at %llu", (unsigned long long)hal_time_us());
    const float *all[3] = {p, v, a};
    for (int i = 0; i < 3 * MOTORS; i++)
        printf(" %.9g", (double)all[i / MOTORS][i % MOTORS]);
    printf("%s\n", on ? "" : " off");
}

void hal_measure(float p[MOTORS], float a[MOTORS])
{
    memcpy(p, position, sizeof position);
    memcpy(a, acceleration, sizeof acceleration);
}
