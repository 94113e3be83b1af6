/* Types, values and number formats of docs/protocol.md. */
#ifndef PLATE_MESSAGE_H
#define PLATE_MESSAGE_H

#include <stdint.h>
#include <string.h>

#define VERSION 5
#define HEADER_BYTES 3

enum {
    HELLO = 0x01, HEARTBEAT, ENABLE, STOP, HOME, TRIGGER,
    BEGIN = 0x10, KNOTS, COMMIT,
    CAPABILITIES = 0x81, ACKNOWLEDGEMENT, PULSE, TELEMETRY, DRIVE_TROUBLE
};

enum { STATE_OFF, STATE_HOMING, STATE_READY, STATE_PLAYING, STATE_BRAKING };

enum {
    STATUS_DONE, STATUS_NO_SESSION, STATUS_OLD, STATUS_WRONG_STATE, STATUS_WRONG_TABLE,
    STATUS_INCOMPLETE, STATUS_WRONG_TIMES, STATUS_LIMIT, STATUS_JUMP,
    STATUS_TOO_LONG, STATUS_WRONG_STOP, STATUS_REPEATS
};

enum {
    FAULT_HOST_SILENT = 1, FAULT_STOPPED = 2, FAULT_LIMIT = 4, FAULT_SUPPLY = 8,
    FAULT_HARDWARE = 16, FAULT_HEAT = 32, FAULT_NO_HOME = 64, FAULT_FOLLOWING = 128
};

enum {
    TROUBLE_NONE, TROUBLE_SILENT, TROUBLE_RESET, TROUBLE_NOT_OPERATIONAL, TROUBLE_REFUSED,
    TROUBLE_WRONG_DRIVE, TROUBLE_EMERGENCY, TROUBLE_FAULT, TROUBLE_LEFT, TROUBLE_NOT_ENABLED,
    TROUBLE_KEEPS, TROUBLE_NO_POSITION, TROUBLE_TWICE, TROUBLE_BUS_OFF, TROUBLE_OTHER_MASTER,
    TROUBLE_ERROR, TROUBLE_NO_WATCHDOG, TROUBLE_HOME_LOST, TROUBLE_RANGE,
    TROUBLE_CROOKED, TROUBLE_ASTRAY
};

static inline uint16_t get_u16(const uint8_t *b) { return (uint16_t)(b[0] | b[1] << 8); }

static inline uint32_t get_u32(const uint8_t *b)
{
    return get_u16(b) | (uint32_t)get_u16(b + 2) << 16;
}

static inline float get_f32(const uint8_t *b)
{
    uint32_t bits = get_u32(b);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline uint8_t *put_u16(uint8_t *b, uint16_t value)
{
    b[0] = (uint8_t)value;
    b[1] = (uint8_t)(value >> 8);
    return b + 2;
}

static inline uint8_t *put_u32(uint8_t *b, uint32_t value)
{
    return put_u16(put_u16(b, (uint16_t)value), (uint16_t)(value >> 16));
}

static inline uint8_t *put_u64(uint8_t *b, uint64_t value)
{
    return put_u32(put_u32(b, (uint32_t)value), (uint32_t)(value >> 32));
}

static inline uint8_t *put_f32(uint8_t *b, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return put_u32(b, bits);
}

#endif
