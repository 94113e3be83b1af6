/* Interface of a backend on a CAN bus to the board. */
#ifndef PLATE_CAN_H
#define PLATE_CAN_H

#include <stdbool.h>
#include <stdint.h>

#define CAN_REMOTE 0x800 /* flag of an id: a remote request for this number of bytes, without data */

typedef struct {
    uint16_t id;  /* 11 bits, and CAN_REMOTE */
    uint8_t size; /* size of the data, at most 8 */
    uint8_t data[8];
} CanFrame;

/* Take a received data frame. Return false if there is none. The board must buffer at least 32 frames. */
bool can_read(CanFrame *frame);

/* Send a frame after the previous ones. A frame that does not fit into the board's buffer of at least 32
   frames is dropped. */
void can_write(const CanFrame *frame);

/* Whether the controller went bus off since the last call. It must recover by itself, after 128 times 11
   recessive bits, with an empty send buffer. */
bool can_off(void);

#endif
