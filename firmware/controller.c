#include "controller.h"

#include <math.h>
#include <string.h>

#include "message.h"
#include "motion.h"

#define WATCHDOG_US 250000u
#define TELEMETRY_US 10000u
#define WINDOW 8        /* knot messages that may be on their way: what hal_read's buffer holds */
#define JUMP_M 2e-6f    /* how far a table may begin from where the plate is [m]: f32 rounding */
#define JUMP_SPEED 2e-3f /* [m/s] */
#define BRAKE_ROOM 0.1f  /* acceleration beyond the limit while braking [share] */

static void send(Controller *c, uint8_t type, const uint8_t *fields, size_t size)
{
    uint8_t packet[MAX_PACKET], bytes[MAX_FRAME];
    packet[0] = type;
    put_u16(packet + 1, c->sent++);
    memcpy(packet + HEADER_BYTES, fields, size);
    hal_write(bytes, frame(packet, HEADER_BYTES + size, bytes));
}

static void acknowledge(Controller *c, uint16_t sequence, uint8_t status)
{
    uint8_t fields[3];
    *put_u16(fields, sequence) = status;
    send(c, ACKNOWLEDGEMENT, fields, sizeof fields);
}

static void tell_capabilities(Controller *c, uint32_t session)
{
    uint8_t fields[48], *at = fields;
    *at++ = VERSION;
    at = put_u32(put_u32(at, session), hal_boot());
    *at++ = MOTORS;
    at = put_u16(at, MAX_KNOTS);
    *at++ = WINDOW;
    at = put_u16(at, WATCHDOG_US / 1000);
    at = put_f32(put_f32(put_f32(at, c->limits.stroke_m), c->limits.speed), c->limits.accel);
    at = put_f32(put_f32(at, c->limits.force), c->limits.lasting);
    send(c, CAPABILITIES, fields, (size_t)(at - fields));
}

static void tell_pulse(Controller *c, const uint8_t host_ns[8])
{
    uint8_t fields[16];
    memcpy(fields, host_ns, 8);
    put_u64(fields + 8, c->now_us);
    send(c, PULSE, fields, sizeof fields);
}

/* Mean square of a motor's force that it bears for ever [N2]. */
static double bearable(const Controller *c)
{
    return (double)c->limits.lasting * (double)c->limits.lasting;
}

static void tell_state(Controller *c)
{
    uint8_t fields[64], *at = put_u64(fields, c->now_us);
    float values[2][MOTORS];
    *at++ = c->state;
    *at++ = c->faults;
    bool moving = c->state == STATE_PLAYING || (c->state == STATE_BRAKING && !c->going_home);
    at = put_u16(at, moving ? c->tables[c->playing].id : 0);
    at = put_u16(at, c->waiting ? c->tables[!c->playing].id : 0);
    at = put_u16(at, c->reader.refused);
    hal_measure(values[0], values[1]);
    for (int i = 0; i < 2 * MOTORS; i++)
        at = put_f32(at, values[i / MOTORS][i % MOTORS]);
    double hottest = fmax(fmax(c->heat[0], c->heat[1]), fmax(c->heat[2], c->heat[3]));
    at = put_f32(at, (float)(hottest / bearable(c)));
    send(c, TELEMETRY, fields, (size_t)(at - fields));
}

/* Commands */

static uint8_t enable(Controller *c)
{
    float measured[MOTORS];
    if (c->state == STATE_READY || c->state == STATE_PLAYING)
        return STATUS_DONE;
    if (c->state != STATE_OFF || hal_faults() || c->faults & FAULT_NO_HOME)
        return STATUS_WRONG_STATE;
    c->faults = 0;
    memset(&c->from, 0, sizeof c->from);
    hal_measure(c->from.position, measured);
    motion_home(c, STATE_HOMING);
    hal_drive(true);
    return STATUS_DONE;
}

static uint8_t home(Controller *c)
{
    if (c->state != STATE_OFF)
        return STATUS_WRONG_STATE;
    c->state = STATE_HOMING;
    return STATUS_DONE;
}

static uint8_t begin(Controller *c, const uint8_t *fields)
{
    Table *table = &c->tables[!c->playing];
    uint16_t id = get_u16(fields), count = get_u16(fields + 2);
    c->waiting = false;
    table->id = 0;
    if (id == 0 || count == 1)
        return STATUS_WRONG_TABLE;
    if (count > MAX_KNOTS)
        return STATUS_TOO_LONG;
    memset(table->there, 0, sizeof table->there);
    table->id = id;
    table->count = count;
    table->crc = get_u32(fields + 4);
    table->streams = count == 0;
    table->next = 0;
    return STATUS_DONE;
}

/* Add knots from number `first` on to a stream. */
static uint8_t stream(Controller *c, Table *table, const uint8_t *fields, uint32_t count)
{
    double begin = 0, *time = table == &c->tables[c->playing] ? &c->time : &begin;
    uint16_t known = (uint16_t)(table->next - get_u16(fields + 2));
    uint8_t status = known < 0x8000 ? STATUS_DONE : STATUS_INCOMPLETE;
    if (time == &c->time && table_rests(table) && c->time + BRAKE_S / 2 > table_period(table))
        return STATUS_WRONG_STATE; /* it is at its end: too late to go on, since a brake must fit */
    for (uint32_t k = known; k < count && status == STATUS_DONE; k++) {
        Knot knot;
        knot_read(&knot, fields + 4 + k * KNOT_BYTES);
        status = stream_add(table, &knot, time, &c->limits);
    }
    return status;
}

static uint8_t fill(Controller *c, const uint8_t *fields, size_t size)
{
    Table *table = &c->tables[!c->playing], *now = &c->tables[c->playing];
    uint32_t first = get_u16(fields + 2), count = (uint32_t)(size - 4) / KNOT_BYTES;
    if (c->state == STATE_PLAYING && now->streams && now->id == get_u16(fields))
        return stream(c, now, fields, count);
    if (table->id != 0 && table->streams && table->id == get_u16(fields))
        return stream(c, table, fields, count);
    if (table->id == 0 || table->id != get_u16(fields) || first + count > table->count)
        return STATUS_WRONG_TABLE;
    if (c->waiting)
        return STATUS_DONE; /* a repetition: the table has been looked at, and stays as it is */
    for (uint32_t k = 0; k < count; k++) {
        knot_read(&table->knots[first + k], fields + 4 + k * KNOT_BYTES);
        table->there[(first + k) / 8] |= (uint8_t)(1u << ((first + k) % 8));
    }
    return STATUS_DONE;
}

static uint8_t commit(Controller *c, const uint8_t *fields)
{
    Table *table = &c->tables[!c->playing];
    if (c->state != STATE_READY && c->state != STATE_PLAYING)
        return STATUS_WRONG_STATE;
    if (table->id == 0 || table->id != get_u16(fields))
        return STATUS_WRONG_TABLE;
    const Table *now = &c->tables[c->playing];
    if (c->state == STATE_PLAYING && (table->streams || now->streams))
        return STATUS_WRONG_STATE; /* a stream has no end to begin at */
    uint8_t status = STATUS_DONE;
    if (!table->streams)
        status = table_check(table, &c->limits);
    else if (table->count < 2 || table_period(table) < BRAKE_S)
        status = STATUS_INCOMPLETE; /* it must always be able to brake */
    if (status != STATUS_DONE)
        return status;
    const Knot *end = c->state == STATE_PLAYING ? &now->knots[now->count - 1] : NULL;
    for (int m = 0; m < MOTORS; m++) {
        float position = end ? end->position[m] : c->from.position[m];
        float velocity = end ? end->velocity[m] : 0;
        if (fabsf(table->knots[0].position[m] - position) > JUMP_M ||
            fabsf(table->knots[0].velocity[m] - velocity) > JUMP_SPEED)
            return STATUS_JUMP;
    }
    table->repeats = get_u16(fields + 2);
    c->waiting = true;
    return STATUS_DONE;
}

static void hello(Controller *c, uint16_t sequence, const uint8_t *fields)
{
    uint32_t session = get_u32(fields + 1);
    if (fields[0] != VERSION) {
        tell_capabilities(c, 0);
        return;
    }
    if (!c->session_open || session != c->session) {
        if (c->state != STATE_OFF)
            motion_brake(c, FAULT_STOPPED);
        c->tables[!c->playing].id = 0;
        c->session_open = true;
        c->session = session;
        c->answered = sequence;
        c->answer = STATUS_DONE;
    }
    tell_capabilities(c, session);
}

/* Done in order, and once. */
static void ordered(Controller *c, uint8_t type, uint16_t sequence, const uint8_t *fields)
{
    uint16_t ahead = (uint16_t)(sequence - c->answered);
    if (ahead != 0 && ahead < 0x8000) {
        c->answered = sequence;
        c->answer = type == ENABLE ? enable(c) : type == HOME ? home(c)
                  : type == BEGIN ? begin(c, fields) : commit(c, fields);
    }
    acknowledge(c, sequence, ahead < 0x8000 ? c->answer : (uint8_t)STATUS_OLD);
}

static void stop(Controller *c, uint16_t sequence, bool now)
{
    uint16_t ahead = (uint16_t)(sequence - c->answered);
    if (now)
        motion_off(c, FAULT_STOPPED);
    else if (c->state != STATE_OFF)
        motion_brake(c, FAULT_STOPPED);
    if (ahead != 0 && ahead < 0x8000) {
        c->answered = sequence;
        c->answer = STATUS_DONE;
    }
    acknowledge(c, sequence, STATUS_DONE);
}

/* Whether a packet has its type's length, and no value that is not allowed. */
static bool sound(uint8_t type, const uint8_t *fields, size_t size)
{
    switch (type) {
    case HELLO: return size == 5;
    case HEARTBEAT: return size == 8;
    case ENABLE: case HOME: return size == 0;
    case STOP: return size == 1 && fields[0] <= 1;
    case BEGIN: return size == 8;
    case COMMIT: return size == 4;
    case KNOTS: break;
    default: return false;
    }
    if (size < 4 + KNOT_BYTES || (size - 4) % KNOT_BYTES != 0)
        return false;
    for (size_t at = 4; at < size; at += 4)
        if ((at - 4) % KNOT_BYTES != 0 && !isfinite(get_f32(fields + at)))
            return false;
    return true;
}

static void obey(Controller *c, const uint8_t *packet, size_t size)
{
    if (size < HEADER_BYTES)
        return;
    uint8_t type = packet[0];
    uint16_t sequence = get_u16(packet + 1);
    const uint8_t *fields = packet + HEADER_BYTES;
    if (!sound(type, fields, size - HEADER_BYTES))
        return;
    c->heard_us = c->now_us;
    if (type == HELLO)
        hello(c, sequence, fields);
    else if (type == STOP)
        stop(c, sequence, fields[0] == 1);
    else if (!c->session_open)
        acknowledge(c, sequence, STATUS_NO_SESSION);
    else if (type == HEARTBEAT)
        tell_pulse(c, fields);
    else if (type == KNOTS)
        acknowledge(c, sequence, fill(c, fields, size - HEADER_BYTES));
    else
        ordered(c, type, sequence, fields);
}

void controller_start(Controller *c, Limits limits)
{
    memset(c, 0, sizeof *c);
    c->limits = limits;
    c->faults = FAULT_NO_HOME;
    c->now_us = c->heard_us = c->told_us = hal_time_us();
    hal_drive(false);
}

/* What may be commanded; a brake adds at most 1.5 (v / Tb)^2 / accel, a tenth, to the table's. */
static bool sane(const Controller *c, const Setpoint *at)
{
    bool inside = true;
    for (int m = 0; m < MOTORS; m++) /* false for what is not finite, too */
        inside = inside && fabsf(at->position[m]) <= c->limits.stroke_m * (1 + LIMIT_SLACK) &&
                 fabsf(at->velocity[m]) <= c->limits.speed * (1 + LIMIT_SLACK) &&
                 fabsf(at->acceleration[m]) <= c->limits.accel * (1 + BRAKE_ROOM);
    return inside;
}

/* Heat of the motors follows the square of their force; returns whether they bear it. */
static bool heat_step(Controller *c, double dt, const Setpoint *at)
{
    double share = fmin(dt / (double)c->limits.heat_s, 1);
    bool bears = true;
    for (int m = 0; m < MOTORS; m++) {
        double force = at ? force_of(&c->limits, m, at->acceleration) : 0;
        c->heat[m] += share * (force * force - c->heat[m]);
        bears = bears && c->heat[m] <= bearable(c);
    }
    return bears;
}

void controller_tick(Controller *c)
{
    uint64_t before = c->now_us;
    uint8_t bytes[64];
    size_t count;
    c->now_us = hal_time_us();
    while ((count = hal_read(bytes, sizeof bytes)) > 0)
        for (size_t i = 0; i < count; i++) {
            size_t size = reader_take(&c->reader, bytes[i]);
            if (size)
                obey(c, c->reader.held, size);
        }
    uint8_t faults = hal_faults();
    if (faults)
        motion_off(c, faults);
    if (c->state != STATE_OFF && c->now_us - c->heard_us > WATCHDOG_US)
        motion_brake(c, FAULT_HOST_SILENT);

    Setpoint at;
    double dt = (double)(c->now_us - before) * 1e-6;
    bool moves = motion_step(c, dt, &at);
    if (moves && !sane(c, &at)) {
        motion_off(c, FAULT_LIMIT);
        moves = false;
    }
    if (moves)
        hal_command(at.position, at.velocity, at.acceleration);
    if (!heat_step(c, dt, moves ? &at : NULL) && c->state != STATE_OFF)
        motion_brake(c, FAULT_HEAT);
    if (c->now_us - c->told_us >= TELEMETRY_US) {
        c->told_us = c->now_us;
        tell_state(c);
    }
}
