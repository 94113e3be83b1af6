#include "controller.h"

#include <math.h>
#include <string.h>

#include "message.h"
#include "motion.h"

#define WATCHDOG_US 250000u
#define TELEMETRY_US 10000u
#define MAX_UNREPORTED_US 100000u
#define HOLD_MS 10000u      /* maximum time for which a table is repeated */
#define TICKS_PER_MS 100000u
#define WINDOW 8            /* maximum knot messages in flight, which fit into the board's buffer */
#define BRAKE_ROOM 0.1f     /* allowed relative excess of the acceleration while braking */
#define DEVIATING_TICKS 3   /* consecutive ticks with a following error that count as a fault */
#define MAX_HEAT_US 1000000u /* maximum time between two ticks, exact as a float [us] */

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

static void send_capabilities(Controller *c, uint32_t session)
{
    const Limits *limits = &c->limits;
    uint8_t fields[48], *at = fields;
    *at++ = VERSION;
    at = put_u32(put_u32(at, session), hal_boot());
    *at++ = MOTORS;
    at = put_u16(at, MAX_KNOTS);
    *at++ = WINDOW;
    at = put_u16(at, WATCHDOG_US / 1000);
    at = put_f32(put_f32(put_f32(at, limits->stroke_m), limits->speed), limits->accel);
    at = put_f32(put_f32(at, limits->force), limits->continuous_force);
    at = put_f32(at, limits->following_m);
    at = put_u16(at, HOLD_MS);
    send(c, CAPABILITIES, fields, (size_t)(at - fields));
}

static void send_pulse(Controller *c, const uint8_t host_ns[8])
{
    uint8_t fields[16];
    memcpy(fields, host_ns, 8);
    put_u64(fields + 8, c->now_us);
    send(c, PULSE, fields, sizeof fields);
}

/* Square of a motor's continuous force [N2]. */
static float continuous_square(const Controller *c)
{
    return c->limits.continuous_force * c->limits.continuous_force;
}

/* Value for telemetry. The host would refuse the packet if it had a value that is not finite. */
static float finite_or_zero(float value) { return isfinite(value) ? value : 0; }

static void send_state(Controller *c)
{
    uint8_t fields[72], *at = put_u64(fields, c->now_us);
    *at++ = c->state;
    *at++ = c->faults;
    at = put_u16(at, c->stops);
    const Table *table = &c->tables[c->playing];
    bool moving = c->state == STATE_PLAYING || (c->state == STATE_BRAKING && !c->going_home);
    at = put_u16(at, moving ? table->id : 0);
    at = put_u32(at, moving && !table->streams ? motion_elapsed(c) : 0);
    at = put_u16(at, c->waiting ? c->tables[c->next].id : 0);
    at = put_u16(at, c->reader.refused);
    float hottest = c->heat[0];
    for (int m = 1; m < MOTORS; m++)
        hottest = fmaxf(hottest, c->heat[m]);
    for (int m = 0; m < MOTORS; m++)
        at = put_f32(at, finite_or_zero(c->measured[m]));
    for (int m = 0; m < MOTORS; m++)
        at = put_f32(at, finite_or_zero(c->accelerations[m]));
    at = put_f32(at, hottest / continuous_square(c));
    at = put_f32(put_f32(at, finite_or_zero(c->following_m)), hal_load());
    c->following_m = 0;
    send(c, TELEMETRY, fields, (size_t)(at - fields));
}

/* Report of a drive's fault, in addition to telemetry, while there is one. */
static void send_trouble(Controller *c)
{
    Trouble trouble;
    uint8_t fields[8];
    if (!hal_trouble(&trouble))
        return;
    fields[0] = trouble.motor;
    fields[1] = trouble.kind;
    put_u32(put_u16(fields + 2, trouble.object), trouble.code);
    send(c, DRIVE_TROUBLE, fields, sizeof fields);
}

/* Stops */

/* A stop: brake, or switch the current off at once. It is also counted if the current is off. */
static void stop(Controller *c, bool now, uint8_t faults)
{
    uint16_t before = c->stops;
    if (now)
        motion_off(c, faults);
    else
        motion_brake(c, faults);
    if (c->stops == before)
        c->stops++;
}

/* Faults of the board. Each new fault is a stop, also while the motors are off. */
static void watch_board(Controller *c)
{
    uint8_t faults = hal_faults(), appeared = faults & (uint8_t)~c->board;
    c->board = faults;
    if (appeared)
        stop(c, true, appeared);
}

/* Measure the motors, and compare them with the setpoint of the last tick. */
static void measure(Controller *c)
{
    bool deviates = false;
    hal_measure(c->measured, c->accelerations);
    for (int m = 0; m < MOTORS && c->is_commanded; m++) {
        float error = fabsf(c->measured[m] - c->commanded.position[m]);
        c->following_m = fmaxf(c->following_m, error);
        deviates = deviates || !(error <= c->limits.following_m); /* also true if the error is not finite */
    }
    deviates = deviates && c->limits.following_m > 0;
    c->deviating_ticks = deviates ? (uint8_t)(c->deviating_ticks + 1) : 0;
    if (c->deviating_ticks == DEVIATING_TICKS) {
        motion_off(c, FAULT_FOLLOWING);
        c->deviating_ticks = 0;
    }
}

/* Commands */

static uint8_t enable(Controller *c, const uint8_t *fields)
{
    if (get_u16(fields) != c->stops)
        return STATUS_WRONG_STOP;
    if (c->state == STATE_BRAKING || c->board)
        return STATUS_WRONG_STATE;
    if (c->state == STATE_OFF)
        motion_enable(c);
    return STATUS_DONE;
}

static uint8_t home(Controller *c)
{
    if (c->state != STATE_OFF)
        return STATUS_WRONG_STATE;
    hal_forget();
    c->faults |= FAULT_NO_HOME;
    return STATUS_DONE;
}

static uint8_t begin(Controller *c, const uint8_t *fields)
{
    Table *table = &c->tables[c->filling];
    uint16_t id = get_u16(fields), count = get_u16(fields + 2);
    uint32_t splice = get_u32(fields + 8);
    table->id = 0;
    if (id == 0 || count == 1)
        return STATUS_WRONG_TABLE;
    if (count > MAX_KNOTS)
        return STATUS_TOO_LONG;
    if (count == 0 && splice)
        return STATUS_WRONG_TIMES; /* a stream has no tail */
    table_open(table, id, count, get_u32(fields + 4), splice);
    return STATUS_DONE;
}

/* The stream with this number, or NULL if knots cannot be added to it. */
static Table *stream_of(Controller *c, uint16_t id)
{
    const bool open[3] = {c->state == STATE_PLAYING, c->waiting, true};
    Table *each[3] = {&c->tables[c->playing], &c->tables[c->next], &c->tables[c->filling]};
    for (int k = 0; k < 3; k++)
        if (open[k] && id != 0 && each[k]->streams && each[k]->id == id)
            return each[k];
    return NULL;
}

/* Continue to add the knots of the held message while there is work left. No more bytes are read before
   the message is answered. */
static void add_knots(Controller *c, int *work)
{
    const uint8_t *fields = c->reader.held + HEADER_BYTES;
    uint16_t first = get_u16(fields + 2);
    uint8_t status = STATUS_DONE;
    while (status == STATUS_DONE) {
        Table *table = stream_of(c, get_u16(fields));
        if (!table) {
            status = STATUS_WRONG_TABLE;
            break;
        }
        bool plays = table == &c->tables[c->playing];
        uint16_t known = (uint16_t)(table->next - first);
        if (plays && table_rests(table) &&
            c->table_time + BRAKE_TICKS / 2 - table_knot(table, 0)->ticks > table_period(table))
            status = STATUS_WRONG_STATE; /* too late: the plate could no longer brake before the stream's end */
        else if (known >= 0x8000)
            status = STATUS_INCOMPLETE;
        else if (known >= (c->adding - 4) / KNOT_BYTES)
            break;
        else if (*work <= 0 ||
                 !stream_add(table, fields + 4 + known * KNOT_BYTES,
                             plays ? c->table_time : table_knot(table, 0)->ticks, &c->limits, work,
                             &status))
            return;
    }
    c->adding = 0;
    acknowledge(c, get_u16(c->reader.held + 1), status);
}

/* Knots for the open table, or for a stream. */
static void fill(Controller *c, uint16_t sequence, const uint8_t *fields, size_t size, int *work)
{
    Table *table = &c->tables[c->filling];
    int first = get_u16(fields + 2), count = (int)(size - 4) / KNOT_BYTES;
    if (stream_of(c, get_u16(fields))) {
        c->adding = (uint8_t)size;
        add_knots(c, work);
        return;
    }
    if (table->id == 0 || table->id != get_u16(fields) || first + count > table->count) {
        acknowledge(c, sequence, STATUS_WRONG_TABLE);
        return;
    }
    for (int k = 0; k < count; k++)
        table_put(table, first + k, fields + 4 + k * KNOT_BYTES);
    acknowledge(c, sequence, STATUS_DONE);
}

/* The filled table now waits to be played, and replaces a waiting one. */
static void wait_to_play(Controller *c)
{
    int before = c->next;
    c->next = c->filling;
    c->filling = before;
    c->tables[before].id = 0;
    c->waiting = true;
}

/* Whether the filled table or stream is allowed to play. The check of a table may not be complete yet. */
static uint8_t commit(Controller *c, uint16_t sequence, const uint8_t *fields)
{
    Table *table = &c->tables[c->filling];
    uint16_t repeats = get_u16(fields + 2);
    if (c->state != STATE_READY && c->state != STATE_PLAYING)
        return STATUS_WRONG_STATE;
    if (table->id == 0 || table->id != get_u16(fields))
        return STATUS_WRONG_TABLE;
    if (c->state == STATE_PLAYING && (table->streams || c->tables[c->playing].streams))
        return STATUS_WRONG_STATE; /* a stream has no end at which a table could begin */
    if (repeats == 0 || (table->streams && repeats != 1))
        return STATUS_REPEATS;
    for (int m = 0; m < MOTORS && c->state == STATE_READY; m++)
        if (!(fabsf(c->commanded.position[m]) <= REST_M))
            return STATUS_JUMP; /* a stream has ended away from home: stop and enable move the plate home */
    if (table->streams) {
        if (table->count < 2 || table_period(table) < BRAKE_TICKS)
            return STATUS_INCOMPLETE; /* the stream is too short: the plate must be able to brake at any time */
        if (!knot_is_home(table_knot(table, 0)))
            return STATUS_JUMP;
        wait_to_play(c);
        return STATUS_DONE;
    }
    if (table->arrived_count < table->count)
        return STATUS_INCOMPLETE;
    bool closes = !table->splice && knot_is_home(table_knot(table, 0));
    uint64_t held = (uint64_t)repeats * table_period(table);
    if (repeats > 1 && (!closes || held > (uint64_t)HOLD_MS * TICKS_PER_MS))
        return STATUS_REPEATS;
    c->committing = true;
    c->commit_sequence = sequence;
    c->commit_repeats = repeats;
    return STATUS_DONE;
}

static void answer_commit(Controller *c, uint8_t status)
{
    c->committing = false;
    if (c->answered == c->commit_sequence)
        c->answer = status;
    acknowledge(c, c->commit_sequence, status);
}

/* Check the table that is being filled. Answer Commit when the check is complete. */
static void check_tables(Controller *c, int work)
{
    Table *table = &c->tables[c->filling];
    if (table->id != 0 && !table->streams)
        table_check(table, &c->limits, &work);
    if (!c->committing)
        return;
    if (c->state != STATE_READY && c->state != STATE_PLAYING) {
        answer_commit(c, STATUS_WRONG_STATE);
    } else if (table_checked(table)) {
        uint8_t status = table->check.status;
        if (status == STATUS_DONE && !knot_is_home(table_knot(table, 0)) &&
            !motion_can_splice(c, table))
            status = STATUS_JUMP;
        table->repeats = c->commit_repeats;
        if (status == STATUS_DONE)
            wait_to_play(c);
        answer_commit(c, status);
    }
}

static void hello(Controller *c, uint16_t sequence, const uint8_t *fields)
{
    uint32_t session = get_u32(fields + 1);
    if (fields[0] != VERSION) {
        send_capabilities(c, 0);
        return;
    }
    if (!c->session_open || session != c->session) {
        if (c->state != STATE_OFF)
            stop(c, false, FAULT_STOPPED);
        c->tables[c->filling].id = 0;
        c->waiting = c->committing = c->stop_known = false;
        c->trigger = (Trigger){0};
        c->session_open = true;
        c->session = session;
        c->answered = sequence;
        c->answer = STATUS_DONE;
    }
    send_capabilities(c, session);
}

/* Trigger is allowed at any time, because it moves nothing. */
static void set_trigger(Controller *c, uint16_t sequence, const uint8_t *fields)
{
    c->trigger.phase = get_u16(fields);
    c->trigger.pulse_ms = fields[2];
    acknowledge(c, sequence, STATUS_DONE);
}

/* Execute a command in the order of the sequence numbers, and only once. */
static void execute_ordered(Controller *c, uint8_t type, uint16_t sequence, const uint8_t *fields)
{
    uint16_t ahead = (uint16_t)(sequence - c->answered);
    bool later = false;
    if (c->committing && sequence == c->commit_sequence)
        return; /* the command will be answered later */
    if (ahead != 0 && ahead < 0x8000) {
        if (c->committing)
            answer_commit(c, STATUS_OLD);
        c->answered = sequence;
        c->answer = type == ENABLE ? enable(c, fields) : type == HOME ? home(c)
                  : type == BEGIN ? begin(c, fields) : commit(c, sequence, fields);
        later = c->committing;
    }
    if (!later)
        acknowledge(c, sequence, ahead < 0x8000 ? c->answer : (uint8_t)STATUS_OLD);
}

/* A Stop is always executed. A repetition of the last Stop counts as a stop only if something moves. */
static void execute_stop(Controller *c, uint16_t sequence, bool now)
{
    uint16_t ahead = (uint16_t)(sequence - c->answered);
    bool again = c->stop_known && c->stop_sequence == sequence && c->stop_now == now;
    if (!again || (c->state != STATE_OFF && (now || c->state != STATE_BRAKING)))
        stop(c, now, FAULT_STOPPED);
    c->faults |= FAULT_STOPPED;
    c->stop_known = true;
    c->stop_sequence = sequence;
    c->stop_now = now;
    if (ahead != 0 && ahead < 0x8000) {
        c->answered = sequence;
        c->answer = STATUS_DONE;
    }
    acknowledge(c, sequence, STATUS_DONE);
}

/* Whether a packet has the length of its type, and only allowed values. */
static bool packet_valid(uint8_t type, const uint8_t *fields, size_t size)
{
    switch (type) {
    case HELLO: return size == 5;
    case HEARTBEAT: return size == 8;
    case ENABLE: return size == 2;
    case HOME: return size == 0;
    case STOP: return size == 1 && fields[0] <= 1;
    case TRIGGER: return size == 3 && fields[2] <= MAX_PULSE_MS;
    case BEGIN: return size == 12;
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

static void execute_packet(Controller *c, size_t size, int *work)
{
    const uint8_t *packet = c->reader.held, *fields = packet + HEADER_BYTES;
    if (size < HEADER_BYTES || !packet_valid(packet[0], fields, size - HEADER_BYTES))
        return;
    uint8_t type = packet[0];
    uint16_t sequence = get_u16(packet + 1);
    c->received_us = c->now_us;
    if (type == HELLO)
        hello(c, sequence, fields);
    else if (type == STOP)
        execute_stop(c, sequence, fields[0] == 1);
    else if (!c->session_open)
        acknowledge(c, sequence, STATUS_NO_SESSION);
    else if (type == HEARTBEAT)
        send_pulse(c, fields);
    else if (type == TRIGGER)
        set_trigger(c, sequence, fields);
    else if (type == KNOTS)
        fill(c, sequence, fields, size - HEADER_BYTES, work);
    else
        execute_ordered(c, type, sequence, fields);
}

/* Read and execute received packets, up to the limits of a tick. */
static void read_packets(Controller *c, int *work)
{
    size_t bytes = TICK_BYTES;
    int packets = TICK_PACKETS;
    if (c->adding)
        add_knots(c, work);
    while (bytes > 0 && packets > 0 && !c->adding) {
        if (c->input_at == c->input_count) {
            c->input_at = 0;
            c->input_count = (uint8_t)hal_read(c->input, bytes);
            if (c->input_count == 0)
                return;
        }
        size_t size = reader_take(&c->reader, c->input[c->input_at++]);
        bytes--;
        if (size) {
            packets--;
            execute_packet(c, size, work);
        }
    }
}

void controller_start(Controller *c, Limits limits)
{
    memset(c, 0, sizeof *c);
    c->limits = limits;
    c->next = 1;
    c->filling = 2;
    c->faults = FAULT_NO_HOME;
    c->stops = (uint16_t)hal_boot();
    c->now_us = c->received_us = c->telemetry_us = hal_time_us();
    hal_drive(false);
}

/* Whether a setpoint is allowed, `dt` [s] after the last one. A brake of duration Tb from the speed v
   increases the acceleration by at most a tenth. Where one table follows another, the state of both may
   deviate from rest at home by REST_M and REST_SPEED. */
static bool setpoint_allowed(const Controller *c, const Setpoint *at, float dt)
{
    const Limits *limits = &c->limits;
    float speed = limits->speed * (1 + LIMIT_SLACK), accel = limits->accel * (1 + BRAKE_ROOM);
    float stroke = limits->stroke_m * (1 + LIMIT_SLACK);
    float step = speed * dt + REST_M, change = accel * dt + 2 * REST_SPEED;
    bool inside = true;
    for (int m = 0; m < MOTORS; m++) /* also false for values that are not finite */
        inside = inside && fabsf(at->position[m]) <= stroke && fabsf(at->velocity[m]) <= speed &&
                 fabsf(at->acceleration[m]) <= accel &&
                 fabsf(at->position[m] - c->commanded.position[m]) <= step &&
                 fabsf(at->velocity[m] - c->commanded.velocity[m]) <= change;
    return inside;
}

/* Update the motors' heat, a filtered square of their force. Return whether it is within the limit. The
   increment per tick is small compared with the sum, so the sum is compensated (Kahan 1965). */
static bool heat_step(Controller *c, uint32_t dt_us, const Setpoint *at)
{
    float factor = fminf((float)dt_us * 1e-6f / c->limits.heat_s, 1);
    bool within_limit = true;
    for (int m = 0; m < MOTORS; m++) {
        float force = at ? force_of(&c->limits, m, at->acceleration) : 0;
        float increment = factor * (force * force - c->heat[m]) + c->heat_rest[m];
        float sum = c->heat[m] + increment;
        c->heat_rest[m] = increment - (sum - c->heat[m]);
        c->heat[m] = sum;
        within_limit = within_limit && sum <= continuous_square(c);
    }
    return within_limit;
}

void controller_tick(Controller *c)
{
    uint64_t before = c->now_us;
    int work = TICK_WORK;
    c->now_us = hal_time_us();
    uint64_t passed = c->now_us - before;
    uint32_t dt_us = passed < MAX_TICK_US ? (uint32_t)passed : MAX_TICK_US;
    measure(c);
    watch_board(c);
    read_packets(c, &work);
    check_tables(c, work);
    if (c->state != STATE_OFF && c->now_us - c->received_us > WATCHDOG_US)
        motion_brake(c, FAULT_HOST_SILENT);

    Setpoint at;
    bool moves = motion_step(c, dt_us, &at);
    if (moves && !setpoint_allowed(c, &at, (float)dt_us * 1e-6f)) {
        motion_off(c, FAULT_LIMIT);
        moves = false;
    }
    if (moves) {
        hal_command(at.position, at.velocity, at.acceleration);
        c->commanded = at;
    }
    c->is_commanded = moves;
    const Table *table = &c->tables[c->playing];
    bool plays = c->state == STATE_PLAYING && !table->streams;
    uint32_t elapsed = plays ? motion_elapsed(c) : 0, part = plays ? table_part(table, &elapsed) : 0;
    hal_trigger(trigger_step(&c->trigger, c->now_us, elapsed, part));
    uint32_t heat_us = passed < MAX_HEAT_US ? (uint32_t)passed : MAX_HEAT_US;
    if (!heat_step(c, heat_us, moves ? &at : NULL) && c->state != STATE_OFF)
        motion_brake(c, FAULT_HEAT);
    uint64_t silent_us = c->now_us - c->telemetry_us; /* on a slow line, telemetry is sent less often */
    if (silent_us >= TELEMETRY_US && (hal_idle() || silent_us >= MAX_UNREPORTED_US)) {
        c->telemetry_us = c->now_us;
        send_trouble(c); /* send the cause of a fault before the telemetry that reports the fault */
        send_state(c);
    }
    hal_watchdog();
}
