/* The firmware on a desk: hardware that follows at once, orders from stdin, answers to stdout.

     rx HEX     bytes come
     run US     let time pass, in ticks of 1 ms
     fault N    the board has faults N

   Arguments, if not those of the default rig: the time constant of the motors' heat [s], their
   lasting and their peak force [N].
   Printed: `at US ON q1..q4 v1..v4 a1..a4` of each tick while current is on, and `tx HEX`. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../controller.h"

#define TICK_US 1000u

static uint64_t now_us;
static uint8_t *input;
static size_t input_size, input_at;
static uint8_t faults;
static bool on;
static float position[MOTORS], acceleration[MOTORS];

uint64_t hal_time_us(void) { return now_us; }
uint32_t hal_boot(void) { return 0xCAFE; }
void hal_drive(bool wanted) { on = wanted; }
bool hal_home(void) { return true; }
uint8_t hal_faults(void) { return faults; }

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
    memcpy(position, p, sizeof position);
    memcpy(acceleration, a, sizeof acceleration);
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

static void receive(const char *hex)
{
    size_t size = strlen(hex) / 2;
    uint8_t *all = realloc(input, size + 1);
    if (!all)
        exit(1);
    input = all;
    for (size_t i = 0; i < size; i++) {
        char pair[3] = {hex[2 * i], hex[2 * i + 1], 0};
        input[i] = (uint8_t)strtoul(pair, NULL, 16);
    }
    input_size = size;
    input_at = 0;
}

/* Of config/rig.yaml: load is what plate_sim's device computes from plate and motors. */
static const Limits LIMITS = {
    .stroke_m = 0.010f, .speed = 1.0f, .accel = 100.0f,
    .force = 200.0f, .lasting = 100.0f, .heat_s = 60.0f,
    .load = {{0.575f, 0.425f, 0.15f, -0.15f}, {0.425f, 0.575f, -0.15f, 0.15f},
             {0.15f, -0.15f, 0.8f, 0.2f}, {-0.15f, 0.15f, 0.2f, 0.8f}},
};

int main(int argc, char **argv)
{
    static Controller controller;
    static char line[1 << 20];
    Limits limits = LIMITS;
    if (argc > 1)
        limits.heat_s = strtof(argv[1], NULL);
    if (argc > 2)
        limits.lasting = strtof(argv[2], NULL);
    if (argc > 3)
        limits.force = strtof(argv[3], NULL);
    controller_start(&controller, limits);
    while (fgets(line, sizeof line, stdin)) {
        line[strcspn(line, "\n")] = 0;
        if (!strncmp(line, "rx ", 3)) {
            receive(line + 3);
        } else if (!strncmp(line, "fault ", 6)) {
            faults = (uint8_t)atoi(line + 6);
        } else if (!strncmp(line, "run ", 4)) {
            uint64_t end = now_us + strtoull(line + 4, NULL, 10);
            while (now_us < end) {
                now_us += TICK_US;
                controller_tick(&controller);
            }
            printf("state %d %d %u\n", controller.state, controller.faults,
                   (unsigned)controller.reader.refused);
            fflush(stdout);
        }
    }
    free(input);
    return 0;
}
