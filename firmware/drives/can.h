/* What a backend on a CAN bus needs of a board. */
#ifndef PLATE_CAN_H
#define PLATE_CAN_H

#include <stdbool.h>
#include <stdint.h>

#define CAN_REMOTE 0x800 /* with an id: not data, but a request for so much */

typedef struct {
    uint16_t id;  /* 11 bits, and CAN_REMOTE */
    uint8_t size; /* of its data, 8 at most */
    uint8_t data[8];
} CanFrame;

/* Take a data frame that came; false: there is none. The board must hold at least 32. */
bool can_read(CanFrame *frame);

/* Send a frame, after those before; one that does not fit into the board's buffer, of at least 32,
   is dropped. */
void can_write(const CanFrame *frame);

/* Whether the controller has left the bus since the last call. It must come back by itself, after
   128 times 11 recessive bits, with nothing left to send. */
bool can_off(void);

#endif
