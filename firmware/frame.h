/* Frames: COBS, CRC-32, and cutting a stream of bytes into packets. */
#ifndef PLATE_FRAME_H
#define PLATE_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define MAX_PACKET 253              /* bytes of a packet with its CRC */
#define MAX_FRAME (MAX_PACKET + 2)  /* one byte of overhead, and the end */
#define CRC_BYTES 4

/* A frame is decoded, and its CRC counted, as its bytes come: so its end costs no more than any
   other byte. */
typedef struct {
    uint8_t held[MAX_PACKET]; /* what is decoded of the frame that is coming */
    uint8_t size;             /* how much that is */
    uint8_t count;            /* bytes of the frame so far */
    uint8_t left;             /* bytes to come of its COBS block */
    bool lost;                /* too many bytes: skip to the frame's end */
    uint32_t crc;             /* of what is held */
    uint16_t refused;         /* damaged frames */
} Reader;

/* Continue a CRC-32; start with 0. */
uint32_t crc32_of(uint32_t crc, const uint8_t *data, size_t size);

/* Write the frame of a packet of 1 to MAX_PACKET - CRC_BYTES bytes; return its length. */
size_t frame(const uint8_t *packet, size_t size, uint8_t out[MAX_FRAME]);

/* Take one byte; return the length of the packet that it ended, 0 if none. The packet then stands
   at the start of reader->held until the next call. */
size_t reader_take(Reader *reader, uint8_t byte);

#endif
