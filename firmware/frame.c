#include "frame.h"

#include <string.h>

uint32_t crc32_of(uint32_t crc, const uint8_t *data, size_t size)
{
    crc = ~crc;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++)
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
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

/* Decode the held bytes in place; return the length, 0 if they are no COBS. */
static size_t decode(Reader *reader)
{
    size_t in = 0, out = 0;
    while (in < reader->count) {
        size_t after = in + reader->held[in];
        if (after > reader->count)
            return 0;
        size_t length = after - in - 1;
        memmove(reader->held + out, reader->held + in + 1, length);
        out += length;
        in = after;
        if (in < reader->count)
            reader->held[out++] = 0;
    }
    return out;
}

static size_t checked(Reader *reader)
{
    size_t size = decode(reader);
    if (size <= CRC_BYTES)
        return 0;
    size -= CRC_BYTES;
    uint32_t crc = crc32_of(0, reader->held, size);
    for (int i = 0; i < CRC_BYTES; i++)
        if (reader->held[size + (size_t)i] != (uint8_t)(crc >> (8 * i)))
            return 0;
    return size;
}

size_t reader_take(Reader *reader, uint8_t byte)
{
    if (byte) {
        if (reader->count < sizeof reader->held) {
            reader->held[reader->count++] = byte;
        } else if (!reader->lost) {
            reader->lost = true;
            reader->refused++;
        }
        return 0;
    }
    size_t size = 0;
    if (reader->count && !reader->lost) {
        size = checked(reader);
        if (size == 0)
            reader->refused++;
    }
    reader->count = 0;
    reader->lost = false;
    return size;
}
