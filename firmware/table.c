#include "table.h"

#include <math.h>
#include <string.h>

#include "frame.h"
#include "message.h"

/* Minimum duration of a table, and of its parts before and after its splice [TICK_S]: 10 ms. */
#define MIN_TABLE 1000000u

/* Maximum duration of a stream's piece [TICK_S]: 50 ms, so that times do not wrap. */
#define MAX_PIECE 5000000u

static void floats_read(float *out, const uint8_t *bytes)
{
    for (int i = 0; i < MOTORS; i++)
        out[i] = get_f32(bytes + 4 * i);
}

static void knot_read(Knot *knot, const uint8_t bytes[KNOT_BYTES])
{
    knot->ticks = get_u32(bytes);
    floats_read(knot->position, bytes + 4);
    floats_read(knot->velocity, bytes + 20);
    floats_read(knot->acceleration, bytes + 36);
}

static uint32_t knot_crc(uint32_t crc, const Knot *knot)
{
    uint8_t bytes[KNOT_BYTES], *at = put_u32(bytes, knot->ticks);
    const float *states[3] = {knot->position, knot->velocity, knot->acceleration};
    for (int s = 0; s < 3; s++)
        for (int i = 0; i < MOTORS; i++)
            at = put_f32(at, states[s][i]);
    return crc32_of(crc, bytes, sizeof bytes);
}

bool knot_is_home(const Knot *knot)
{
    bool home = true;
    for (int m = 0; m < MOTORS; m++)
        home = home && fabsf(knot->position[m]) <= REST_M &&
               fabsf(knot->velocity[m]) <= REST_SPEED;
    return home;
}

const Knot *table_knot(const Table *table, int number)
{
    int at = table->first + number;
    return &table->knots[at < MAX_KNOTS ? at : at - MAX_KNOTS];
}

uint32_t table_period(const Table *table)
{
    return table_knot(table, table->count - 1)->ticks - table_knot(table, 0)->ticks;
}

bool table_rests(const Table *table)
{
    const Knot *last = table_knot(table, table->count - 1);
    bool rests = true;
    for (int m = 0; m < MOTORS; m++)
        rests = rests && last->velocity[m] == 0 && last->acceleration[m] == 0;
    return rests;
}

bool table_follows(const Table *table, const Table *before)
{
    const Knot *first = table_knot(table, 0), *splice = &before->knots[before->splice_knot];
    return before->splice && !memcmp(first->position, splice->position, sizeof first->position) &&
           !memcmp(first->velocity, splice->velocity, sizeof first->velocity) &&
           !memcmp(first->acceleration, splice->acceleration, sizeof first->acceleration);
}

uint32_t table_part(const Table *table, uint32_t *elapsed)
{
    if (*elapsed < table->splice)
        return table->splice;
    *elapsed -= table->splice;
    return table_period(table) - table->splice;
}

/* Number of the playing piece. */
static int piece_number(const Table *table, uint32_t elapsed)
{
    uint32_t begin = table_knot(table, 0)->ticks;
    int low = 0, high = table->count - 1;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (table_knot(table, middle)->ticks - begin <= elapsed)
            low = middle;
        else
            high = middle;
    }
    return low;
}

void table_at(const Table *table, uint32_t elapsed, Setpoint *out)
{
    if (elapsed == table_period(table)) {
        *out = (Setpoint){0};
        for (int m = 0; m < MOTORS; m++) /* avoid negative zero */
            out->position[m] = table_knot(table, table->count - 1)->position[m] + 0.0f;
        return;
    }
    int number = piece_number(table, elapsed);
    const Knot *a = table_knot(table, number);
    elapsed -= a->ticks - table_knot(table, 0)->ticks;
    piece_at(a, table_knot(table, number + 1), elapsed, out);
}

void table_open(Table *table, uint16_t id, uint16_t count, uint32_t crc, uint32_t splice)
{
    memset(table->arrived, 0, sizeof table->arrived);
    memset(&table->check, 0, sizeof table->check);
    table->id = id;
    table->count = count;
    table->crc = crc;
    table->splice = splice;
    table->splice_knot = 0;
    table->streams = count == 0;
    table->first = table->next = table->arrived_count = 0;
}

static bool has_arrived(const Table *table, int number)
{
    return table->arrived[number / 8] & (1u << (number % 8));
}

void table_put(Table *table, int number, const uint8_t bytes[KNOT_BYTES])
{
    if (has_arrived(table, number))
        return;
    knot_read(&table->knots[number], bytes);
    table->arrived[number / 8] |= (uint8_t)(1u << (number % 8));
    table->arrived_count++;
}

/* Whether a knot is allowed to follow the one before. If there is a splice, the last knot must be at rest. */
static uint8_t check_order(const Table *table, int number)
{
    const Knot *knot = &table->knots[number];
    uint32_t splice = table->splice;
    if (number == 0 ? knot->ticks != 0 : knot->ticks <= knot[-1].ticks)
        return STATUS_WRONG_TIMES;
    if (number < table->count - 1)
        return STATUS_DONE;
    if (table->knots[table->splice_knot].ticks != splice || (splice && splice < MIN_TABLE) ||
        knot->ticks - splice < MIN_TABLE)
        return STATUS_WRONG_TIMES;
    return knot_is_home(knot) ? STATUS_DONE : STATUS_JUMP;
}

/* Whether the checked part, of this duration [TICK_S], keeps the motors' heat limit. */
static bool heat_within_limit(const Check *check, const Limits *limits, uint32_t ticks)
{
    float square = limits->continuous_force * limits->continuous_force;
    float limit = square * ((float)ticks * TICK_S);
    bool within_limit = true;
    for (int m = 0; m < MOTORS; m++)
        within_limit = within_limit && check->heat[m] <= limit;
    return within_limit;
}

/* Checks that need the whole table. */
static uint8_t check_whole(const Table *table, const Limits *limits)
{
    if (table->check.crc != table->crc)
        return STATUS_INCOMPLETE;
    return heat_within_limit(&table->check, limits, table_period(table)) ? STATUS_DONE
                                                                         : STATUS_LIMIT;
}

bool table_checked(const Table *table)
{
    return table->check.status != STATUS_DONE || table->check.knots == table->count;
}

void table_check(Table *table, const Limits *limits, int *work)
{
    Check *check = &table->check;
    while (*work > 0 && !table_checked(table) && has_arrived(table, check->knots)) {
        const Knot *knot = &table->knots[check->knots];
        bool keeps = true;
        if (!check->piece.begun) {
            check->crc = knot_crc(check->crc, knot);
            check->status = check_order(table, check->knots);
            if (check->status != STATUS_DONE)
                return;
            if (knot->ticks == table->splice)
                table->splice_knot = check->knots;
        }
        if (check->knots == 0)
            *work -= PIECE_WORK;
        else if (!piece_check(&check->piece, knot - 1, knot, limits, work, check->heat, &keeps))
            return;
        if (knot->ticks == table->splice)
            keeps = keeps && heat_within_limit(check, limits, knot->ticks);
        check->status = keeps ? STATUS_DONE : STATUS_LIMIT;
        check->knots++;
        if (keeps && check->knots == table->count)
            check->status = check_whole(table, limits);
    }
}

bool stream_add(Table *stream, const uint8_t bytes[KNOT_BYTES], uint32_t time,
                const Limits *limits, int *work, uint8_t *status)
{
    Knot added;
    int played = 0;
    knot_read(&added, bytes);
    *status = STATUS_DONE;
    if (stream->count > 0) {
        const Knot *last = table_knot(stream, stream->count - 1);
        uint32_t step = added.ticks - last->ticks;
        float heat[MOTORS] = {0}; /* the heat of a stream is checked while it plays */
        bool keeps;
        if (stream->count == MAX_KNOTS)
            played = piece_number(stream, time - table_knot(stream, 0)->ticks);
        if (step == 0 || step > MAX_PIECE)
            *status = STATUS_WRONG_TIMES;
        else if (stream->count - played == MAX_KNOTS)
            *status = STATUS_TOO_LONG;
        if (*status != STATUS_DONE) {
            stream->check.piece.begun = false;
            return true;
        }
        if (!piece_check(&stream->check.piece, last, &added, limits, work, heat, &keeps))
            return false;
        if (!keeps) {
            *status = STATUS_LIMIT;
            return true;
        }
    }
    stream->count = (uint16_t)(stream->count - played);
    stream->first = (uint16_t)((stream->first + played) % MAX_KNOTS);
    int at = (stream->first + stream->count) % MAX_KNOTS;
    stream->knots[at] = added;
    stream->count++;
    stream->next++;
    return true;
}
