/* The firmware without hardware: commands from stdin, replies to stdout. motors.c simulates motors that
   follow at once, can.c a CAN bus with drives. Both have their own commands.

     rx HEX     receive these bytes
     run US     let this time pass, in ticks of 1 ms
     late US    delay the next tick by this time
     load X     set the longest tick, as a fraction of its period
     reset      restart the board

   Optional arguments replace the rig's values: the time constant of the motors' heating [s], their
   continuous_force and their peak force [N], and the following error that is a fault [m].
   Output: `trigger US HIGH` when the camera's line changes, `tx HEX` for sent bytes, and `state STATE
   FAULTS REFUSED STOP` after each `run`. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "host.h"

#define TICK_US 1000u

static uint64_t now_us;
static uint32_t boot = 0xCAFE;
static uint8_t *input;
static size_t input_size, input_at;
static bool trigger;
static float load;

uint64_t hal_time_us(void) { return now_us; }
uint32_t hal_boot(void) { return boot; }
float hal_load(void) { return load; }
void hal_watchdog(void) {}

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

/* Append received bytes to those that were not read yet. */
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
    static bool trigger_shown;
    now_us += TICK_US;
    motors_begin();
    controller_tick(controller);
    motors_end();
    if (trigger != trigger_shown)
        printf("trigger %llu %d\n", (unsigned long long)now_us, trigger);
    trigger_shown = trigger;
}

int main(int argc, char **argv)
{
    static Controller controller;
    static char line[1 << 20];
    Limits limits = motors_start();
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
        } else if (!strncmp(line, "late ", 5)) {
            now_us += strtoull(line + 5, NULL, 10);
        } else if (!strncmp(line, "load ", 5)) {
            load = strtof(line + 5, NULL);
        } else if (!strcmp(line, "reset")) {
            boot++;
            motors_start();
            controller_start(&controller, limits);
            input_at = input_size;
        } else if (!strncmp(line, "run ", 4)) {
            uint64_t end = now_us + strtoull(line + 4, NULL, 10);
            while (now_us < end)
                tick(&controller);
            printf("state %d %d %u %u\n", controller.state, controller.faults,
                   (unsigned)controller.reader.refused, (unsigned)controller.stops);
            fflush(stdout);
        } else {
            motors_order(line);
        }
    }
    free(input);
    return 0;
}
