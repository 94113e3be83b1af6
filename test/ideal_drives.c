/* A CAN bus with four drives of CiA 402, nodes 1 to 4, that follow at once: in place of the board's
   can.c where there is no CAN controller. Their instructions count as the board's. */
#include <string.h>

#include "../firmware/boards/stm32f405/board.h"
#include "../firmware/drives/can.h"
#include "../firmware/message.h"

#define ROOM 32u
#define BEAT_SYNCS 25

static CanFrame ring[ROOM];
static unsigned in, out, syncs;
static struct {
    bool operational;
    uint16_t status, word;
    uint32_t target, reached;
} drives[5];

static void say(unsigned id, const uint8_t *data, uint8_t size)
{
    CanFrame *frame = &ring[in++ % ROOM];
    frame->id = (uint16_t)id;
    frame->size = size;
    memcpy(frame->data, data, size);
}

static void answer(unsigned node, const uint8_t request[8])
{
    uint8_t data[8];
    memcpy(data, request, 8);
    if (request[0] == 0x40) {
        uint16_t object = get_u16(request + 1);
        data[0] = 0x43;
        put_u32(data + 4, object == 0x1000 ? 402 : object == 0x6061 ? 8 : 0x80);
    } else {
        data[0] = 0x60;
    }
    say(0x580 + node, data, 8);
}

static uint16_t next(uint16_t status, uint16_t word)
{
    return !(word & 2) ? 0x250 : status == 0x250 && word == 6 ? 0x231
         : status == 0x231 && word == 7 ? 0x233 : status == 0x233 && word == 15 ? 0x237 : status;
}

static void synchronise(void)
{
    syncs++;
    for (unsigned node = 1; node <= 4; node++) {
        uint8_t data[6], state = drives[node].operational ? 5 : 127;
        if (syncs % BEAT_SYNCS == 0)
            say(0x700 + node, &state, 1);
        if (!drives[node].operational)
            continue;
        put_u32(put_u16(data, drives[node].status), drives[node].reached);
        say(0x180 + node, data, 6);
        drives[node].status = next(drives[node].status, drives[node].word);
        drives[node].reached = drives[node].target;
    }
}

void can_write(const CanFrame *frame)
{
    unsigned node = frame->id & 0x7F, kind = frame->id & 0x780;
    if (frame->id == 0x80)
        synchronise();
    else if (frame->id == 0 && frame->data[0] == 1)
        drives[frame->data[1]].operational = true;
    else if (frame->id == 0)
        say(0x700u + frame->data[1], (const uint8_t[]){0}, 1);
    else if (kind == 0x600)
        answer(node, frame->data);
    else if (kind == 0x200) {
        drives[node].word = get_u16(frame->data);
        drives[node].target = get_u32(frame->data + 2);
    }
}

bool can_read(CanFrame *frame)
{
    if (in == out)
        return false;
    *frame = ring[out++ % ROOM];
    return true;
}

bool can_off(void) { return false; }

void can_start(void)
{
    for (unsigned node = 1; node <= 4; node++)
        drives[node].status = 0x250;
}
