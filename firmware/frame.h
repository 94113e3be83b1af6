/* Frames: COBS, CRC-32, and splitting a byte stream into packets. */
#ifndef PLATE_FRAME_H
#define PLATE_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define MAX_PACKET 253              /* maximum size of a packet with its CRC [bytes] */
#define MAX_FRAME (MAX_PACKET + 2)  /* one byte of overhead, and the end byte */
#define CRC_BYTES 4

/* Decoder of a byte stream. It decodes and updates the CRC with each byte, so that the end of a frame
   takes no longer than any other byte. */
typedef struct {
    uint8_t held[MAX_PACKET]; /* decoded bytes of the current frame */
    uint8_t size;             /* number of decoded bytes */
    uint8_t count;            /* number of received bytes of the frame */
    uint8_t left;             /* remaining bytes of the current COBS block */
    bool lost;                /* too many bytes: skip to the end of the frame */
    uint32_t crc;             /* CRC of the decoded bytes */
    uint16_t refused;         /* number of damaged frames */
} Reader;

/* Continue a CRC-32; start with 0. */
uint32_t crc32_of(uint32_t crc, const uint8_t *data, size_t size);

/* Write the frame of a packet of 1 to MAX_PACKET - CRC_BYTES bytes; return its length. */
size_t frame(const uint8_t *packet, size_t size, uint8_t out[MAX_FRAME]);

/* Decode one byte. Return the length of the packet that it completes, or 0. The packet is at the start
   of reader->held until the next call. */
size_t reader_take(Reader *reader, uint8_t byte);

#endif
