/* A simulated CAN bus with the rig's drives. It is built with limits_rig.h, which is made from the rig
   file.

     can ID HEX   receive a frame, ID in hex
     busoff       lose the bus for a moment

   Output: `can ID HEX` for each frame that is sent. A remote request has 800h in its ID, and no HEX. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../drives/can.h"
#include "../drives/drives.h"
#include "host.h"
#include "limits_rig.h"

#define FRAMES 256

static CanFrame came[FRAMES]; /* a ring */
static unsigned first, count;
static bool off;

bool can_read(CanFrame *frame)
{
    if (count == 0)
        return false;
    *frame = came[first];
    first = (first + 1) % FRAMES;
    count--;
    return true;
}

void can_write(const CanFrame *frame)
{
    printf("can %x ", frame->id);
    for (int i = 0; i < frame->size && !(frame->id & CAN_REMOTE); i++)
        printf("%02x", frame->data[i]);
    printf("\n");
}

bool can_off(void)
{
    bool was = off;
    off = false;
    return was;
}

Limits motors_start(void)
{
    drives_start(DRIVES, &LIMITS);
    return LIMITS;
}

void motors_begin(void) { drives_begin(); }
void motors_end(void) { drives_end(); }

static void receive(const char *words)
{
    char *data;
    CanFrame frame = {.id = (uint16_t)(strtoul(words, &data, 16) & 0x7FF)};
    for (data += *data == ' '; frame.size < 8 && data[0] && data[1]; data += 2) {
        char pair[3] = {data[0], data[1], 0};
        frame.data[frame.size++] = (uint8_t)strtoul(pair, NULL, 16);
    }
    if (count < FRAMES)
        came[(first + count++) % FRAMES] = frame;
}

void motors_order(const char *line)
{
    if (!strncmp(line, "can ", 4))
        receive(line + 4);
    else if (!strcmp(line, "busoff"))
        off = true;
}
