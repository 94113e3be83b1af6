/* The firmware on a desk: hardware that follows at once, orders from stdin, answers to stdout.

     rx HEX     bytes come
     run US     let time pass, in ticks of 1 ms
     late US    the next tick comes later by so much
     fault N    the board has faults N
     search N   a search for home takes N ticks, 1 at first
     jam N      the motors stand still, whatever is commanded: 1, or 0 again not
     place X    somebody moves the motors to X [m]
     load X     the longest tick, as a share of its period
     reset      the board starts anew

   Arguments, if not those of the default rig: the time constant of the motors' heat [s], their
   continuous_force and their peak force [N], the following error that is a fault [m].
   Printed: `at US q1..q4 v1..v4 a1..a4` of each tick that commands, `drive US ON` when current is
   switched, `trigger US HIGH` when the camera's line changes, `tx HEX`, and after each `run` `state
   STATE FAULTS REFUSED STOP`. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../controller.h"

#define TICK_US 1000u

static uint64_t now_us;
static uint32_t boot = 0xCAFE;
static uint8_t *input;
static size_t input_size, input_at;
static uint8_t faults;
static bool on, jammed, trigger;
static int search = 1, searched;
static float load;
static float position[MOTORS], acceleration[MOTORS];

uint64_t hal_time_us(void) { return now_us; }
uint32_t hal_boot(void) { return boot; }
bool hal_home(void) { return ++searched >= search; }
uint8_t hal_faults(void) { return faults; }
float hal_load(void) { return load; }
void hal_watchdog(void) {}

void hal_drive(bool wanted)
{
    on = wanted;
    searched = 0;
}

void hal_trigger(bool high) { trigger = high; }

bool hal_idle(void) { return true; }

size_t hal_read(uint8_t *data, size_t size)
{
    size_t count = input_size - input_at < size ? input_size - input_at : size;
    if (count)
        memcpy(data, input + input_at, count);
    input_at += count;
    return count;
}

void hal_write(const uint8_t *data, size_t size)
{
    printf("tx ");
    for (size_t i = 0; i < size; i++)
        printf("%02x", data[i]);
    printf("\n");
}

void hal_command(const float p[MOTORS], const float v[MOTORS], const float a[MOTORS])
{
    if (!jammed) {
        memcpy(position, p, sizeof position);
        memcpy(acceleration, a, sizeof acceleration);
    }
    printf("at %llu", (unsigned long long)now_us);
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

/* After those that were not read yet. */
static void receive(const char *hex)
{
    size_t size = strlen(hex) / 2;
    if (input_at)
        memmove(input, input + input_at, input_size - input_at);
    input_size -= input_at;
    input_at = 0;
    uint8_t *all = realloc(input, input_size + size + 1);
    if (!all)
        exit(1);
    input = all;
    for (size_t i = 0; i < size; i++) {
        char pair[3] = {hex[2 * i], hex[2 * i + 1], 0};
        input[input_size++] = (uint8_t)strtoul(pair, NULL, 16);
    }
}

static void tick(Controller *controller)
{
    static bool shown, trigger_shown;
    now_us += TICK_US;
    controller_tick(controller);
    if (on != shown)
        printf("drive %llu %d\n", (unsigned long long)now_us, on);
    if (trigger != trigger_shown)
        printf("trigger %llu %d\n", (unsigned long long)now_us, trigger);
    shown = on;
    trigger_shown = trigger;
}

/* Of config/rig.yaml: load is what plate_sim's device computes from plate and motors. */
static const Limits LIMITS = {
    .stroke_m = 0.010f, .speed = 1.0f, .accel = 100.0f,
    .force = 200.0f, .continuous_force = 100.0f, .heat_s = 60.0f,
    .load = {{0.575f, 0.425f, 0.15f, -0.15f}, {0.425f, 0.575f, -0.15f, 0.15f},
             {0.15f, -0.15f, 0.8f, 0.2f}, {-0.15f, 0.15f, 0.2f, 0.8f}},
    .following_m = 0.003f,
};

int main(int argc, char **argv)
{
    static Controller controller;
    static char line[1 << 20];
    Limits limits = LIMITS;
    if (argc > 1)
        limits.heat_s = strtof(argv[1], NULL);
    if (argc > 2)
        limits.continuous_force = strtof(argv[2], NULL);
    if (argc > 3)
        limits.force = strtof(argv[3], NULL);
    if (argc > 4)
        limits.following_m = strtof(argv[4], NULL);
    controller_start(&controller, limits);
    while (fgets(line, sizeof line, stdin)) {
        line[strcspn(line, "\n")] = 0;
        if (!strncmp(line, "rx ", 3)) {
            receive(line + 3);
        } else if (!strncmp(line, "fault ", 6)) {
            faults = (uint8_t)atoi(line + 6);
        } else if (!strncmp(line, "late ", 5)) {
            now_us += strtoull(line + 5, NULL, 10);
        } else if (!strncmp(line, "search ", 7)) {
            search = atoi(line + 7);
        } else if (!strncmp(line, "jam ", 4)) {
            jammed = atoi(line + 4) != 0;
        } else if (!strncmp(line, "place ", 6)) {
            for (int m = 0; m < MOTORS; m++)
                position[m] = strtof(line + 6, NULL);
        } else if (!strncmp(line, "load ", 5)) {
            load = strtof(line + 5, NULL);
        } else if (!strcmp(line, "reset")) {
            boot++;
            controller_start(&controller, limits);
            input_at = input_size;
        } else if (!strncmp(line, "run ", 4)) {
            uint64_t end = now_us + strtoull(line + 4, NULL, 10);
            while (now_us < end)
                tick(&controller);
            printf("state %d %d %u %u\n", controller.state, controller.faults,
                   (unsigned)controller.reader.refused, (unsigned)controller.stops);
            fflush(stdout);
        }
    }
    free(input);
    return 0;
}
