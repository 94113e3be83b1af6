#include "frame.h"

#define WHOLE 0x2144DF1Cu /* CRC-32 of any bytes followed by their own CRC-32 */

/* Table for the CRC-32 of half bytes. It takes 64 bytes, and is four times as fast as single bits. */
static const uint32_t HALVES[16] = {
    0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4, 0x4DB26158, 0x5005713C,
    0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C, 0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C};

uint32_t crc32_of(uint32_t crc, const uint8_t *data, size_t size)
{
    crc = ~crc;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        crc = crc >> 4 ^ HALVES[crc & 15];
        crc = crc >> 4 ^ HALVES[crc & 15];
    }
    return ~crc;
}

size_t frame(const uint8_t *packet, size_t size, uint8_t out[MAX_FRAME])
{
    uint32_t crc = crc32_of(0, packet, size);
    size_t code_at = 0, at = 1;
    for (size_t i = 0; i < size + CRC_BYTES; i++) {
        uint8_t byte = (uint8_t)(i < size ? packet[i] : crc >> (8 * (i - size)));
        if (byte) {
            out[at++] = byte;
        } else {
            out[code_at] = (uint8_t)(at - code_at);
            code_at = at++;
        }
    }
    out[code_at] = (uint8_t)(at - code_at);
    out[at++] = 0;
    return at;
}

static void hold(Reader *reader, uint8_t byte)
{
    reader->held[reader->size++] = byte;
    reader->crc = crc32_of(reader->crc, &byte, 1);
}

/* Decode one more byte of a frame. The first byte of a block is its length plus one. */
static void decode(Reader *reader, uint8_t byte)
{
    if (reader->left > 0) {
        hold(reader, byte);
        reader->left--;
    } else {
        if (reader->count > 0)
            hold(reader, 0); /* the data contain a 0 between two blocks */
        reader->left = (uint8_t)(byte - 1);
    }
    reader->count++;
}

size_t reader_take(Reader *reader, uint8_t byte)
{
    if (byte && reader->lost)
        return 0;
    if (byte && reader->count <= MAX_PACKET) {
        decode(reader, byte);
        return 0;
    }
    if (byte) {
        reader->lost = true;
        reader->refused++;
        return 0;
    }
    size_t size = 0;
    if (reader->count && !reader->lost) {
        if (reader->left == 0 && reader->size > CRC_BYTES && reader->crc == WHOLE)
            size = reader->size - (size_t)CRC_BYTES;
        else
            reader->refused++;
    }
    reader->size = reader->count = reader->left = 0;
    reader->crc = 0;
    reader->lost = false;
    return size;
}
