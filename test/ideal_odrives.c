/* A CAN bus with four ODrives, nodes 1 to 4, that follow at once: in place of the board's can.c where
   there is no CAN controller. Their instructions count as the board's. */
#include <string.h>

#include "../firmware/boards/stm32f405/board.h"
#include "../firmware/drives/can.h"
#include "../firmware/message.h"

#define ROOM 64u

static CanFrame ring[ROOM];
static unsigned in, out, ticks;
static struct {
    uint8_t state;
    uint32_t errors, place;
    unsigned fed;
} drives[5];

static void say(unsigned node, unsigned message, uint32_t first, uint32_t second)
{
    CanFrame *frame = &ring[in++ % ROOM];
    frame->id = (uint16_t)(node << 5 | message);
    frame->size = 8;
    put_u32(put_u32(frame->data, first), second);
}

void can_write(const CanFrame *frame)
{
    unsigned node = frame->id >> 5 & 63, message = frame->id & 0x81F;
    drives[node].fed = ticks;
    if (message == CAN_REMOTE)
        say(node, 0, 2, 0);
    else if (message == (CAN_REMOTE | 0x09))
        say(node, 0x09, drives[node].place, 0);
    else if (message == 0x07)
        drives[node].state = frame->data[0];
    else if (message == 0x0C)
        drives[node].place = get_u32(frame->data);
    else if (message == 0x18)
        drives[node].errors = 0;
}

/* The last reading of each tick finds nothing: a tick has passed. */
bool can_read(CanFrame *frame)
{
    if (in != out) {
        *frame = ring[out++ % ROOM];
        return true;
    }
    ticks++;
    for (unsigned node = 1; node <= 4; node++) {
        if (drives[node].state == 8 && ticks - drives[node].fed > 100) {
            drives[node].state = 1;
            drives[node].errors = 0x01000000;
        }
        if (ticks % 20 == 0)
            say(node, 0x01, drives[node].errors, drives[node].state);
    }
    return false;
}

bool can_off(void) { return false; }

void can_start(void)
{
    for (unsigned node = 1; node <= 4; node++)
        drives[node].state = 1;
}
