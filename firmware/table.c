#include "table.h"

#include <math.h>
#include <string.h>

#include "frame.h"
#include "message.h"

#define TICK_S 1e-8

/* Halvings of a piece until its hull tells whether a limit is kept: it closes in by 4 each time. */
#define HALVINGS 12

/* Longest piece of a stream [10 ns]: 50 ms, so that times never wrap. */
#define LONGEST_PIECE 5000000u

#define CLOSES_M 2e-6f     /* how far a table's end may be from its start [m] */
#define CLOSES_SPEED 2e-3f /* [m/s] */

static void floats_read(float *out, const uint8_t *bytes)
{
    for (int i = 0; i < MOTORS; i++)
        out[i] = get_f32(bytes + 4 * i);
}

void knot_read(Knot *knot, const uint8_t bytes[KNOT_BYTES])
{
    knot->ticks = get_u32(bytes);
    floats_read(knot->position, bytes + 4);
    floats_read(knot->velocity, bytes + 20);
    floats_read(knot->acceleration, bytes + 36);
}

void knot_write(const Knot *knot, uint8_t bytes[KNOT_BYTES])
{
    uint8_t *at = put_u32(bytes, knot->ticks);
    const float *states[3] = {knot->position, knot->velocity, knot->acceleration};
    for (int s = 0; s < 3; s++)
        for (int i = 0; i < MOTORS; i++)
            at = put_f32(at, states[s][i]);
}

double table_period(const Table *table)
{
    return table->knots[table->count - 1].ticks * TICK_S;
}

/* Whether a Bezier curve of `n` points passes a limit anywhere. */
static bool exceeds(const float *points, int n, float limit, int halvings)
{
    bool inside = true;
    for (int i = 0; i < n; i++)
        inside = inside && fabsf(points[i]) <= limit; /* false for what is not finite, too */
    if (inside)
        return false;
    if (halvings == 0 || !(fabsf(points[0]) <= limit) || !(fabsf(points[n - 1]) <= limit))
        return true;
    float left[6], right[6], rest[6];
    memcpy(rest, points, (size_t)n * sizeof *points);
    for (int k = 0; k < n; k++) { /* de Casteljau's halving */
        left[k] = rest[0];
        right[n - 1 - k] = rest[n - 1 - k];
        for (int i = 0; i + 1 < n - k; i++)
            rest[i] = 0.5f * (rest[i] + rest[i + 1]);
    }
    return exceeds(left, n, limit, halvings - 1) || exceeds(right, n, limit, halvings - 1);
}

double force_of(const Limits *limits, int motor, const float acceleration[MOTORS])
{
    double force = 0;
    for (int i = 0; i < MOTORS; i++)
        force += (double)limits->load[motor][i] * (double)acceleration[i];
    return force;
}

/* Integral of the square of a cubic over [0, 1], from its Bezier points (Farouki 2012, 4.2). */
static double mean_square(const float points[4])
{
    static const double PRODUCTS[4][4] = {
        {20, 10, 4, 1}, {10, 12, 9, 4}, {4, 9, 12, 10}, {1, 4, 10, 20}};
    double sum = 0;
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++)
            sum += PRODUCTS[i][j] * (double)points[i] * (double)points[j];
    return sum / 140;
}

/* Bezier points of position, speed and acceleration of one motor between two knots. */
typedef struct {
    float position[6], speed[5], accel[4];
} Hull;

/* From differences of positions, without the cancellation of near-equal points. */
static Hull hull(const Knot *a, const Knot *b, int motor)
{
    float h = (float)((b->ticks - a->ticks) * TICK_S);
    float va = h * a->velocity[motor] / 5, vb = h * b->velocity[motor] / 5;
    float aa = h * h * a->acceleration[motor] / 20, ab = h * h * b->acceleration[motor] / 20;
    float pa = a->position[motor], pb = b->position[motor], step = pb - pa;
    return (Hull){
        {pa, pa + va, pa + 2 * va + aa, pb - 2 * vb + ab, pb - vb, pb},
        {a->velocity[motor], 5 * (va + aa) / h, 5 * (step - 2 * (va + vb) + (ab - aa)) / h,
         5 * (vb - ab) / h, b->velocity[motor]},
        {a->acceleration[motor], 20 * (step - 2 * vb + ab - 3 * va - 2 * aa) / (h * h),
         20 * (3 * vb - 2 * ab + 2 * va + aa - step) / (h * h), b->acceleration[motor]},
    };
}

/* Whether a piece keeps the limits of motion and force; adds its integral of force squared. */
static bool piece_keeps(const Knot *a, const Knot *b, const Limits *limits, double heat[MOTORS])
{
    const float slack = 1 + LIMIT_SLACK;
    Hull hulls[MOTORS];
    for (int m = 0; m < MOTORS; m++) {
        hulls[m] = hull(a, b, m);
        if (exceeds(hulls[m].position, 6, limits->stroke_m * slack, HALVINGS) ||
            exceeds(hulls[m].speed, 5, limits->speed * slack, HALVINGS) ||
            exceeds(hulls[m].accel, 4, limits->accel * slack, HALVINGS))
            return false;
    }
    for (int m = 0; m < MOTORS; m++) {
        float force[4], accel[MOTORS];
        for (int i = 0; i < 4; i++) {
            for (int k = 0; k < MOTORS; k++)
                accel[k] = hulls[k].accel[i];
            force[i] = (float)force_of(limits, m, accel);
        }
        if (exceeds(force, 4, limits->force * slack, HALVINGS))
            return false;
        heat[m] += mean_square(force) * ((b->ticks - a->ticks) * TICK_S);
    }
    return true;
}

static uint8_t check_whole(const Table *table)
{
    uint32_t crc = 0;
    for (int k = 0; k < table->count; k++) {
        uint8_t bytes[KNOT_BYTES];
        if (!(table->there[k / 8] & (1u << (k % 8))))
            return STATUS_INCOMPLETE;
        knot_write(&table->knots[k], bytes);
        crc = crc32_of(crc, bytes, sizeof bytes);
    }
    if (crc != table->crc)
        return STATUS_INCOMPLETE;
    if (table->knots[0].ticks != 0)
        return STATUS_WRONG_TIMES;
    for (int k = 1; k < table->count; k++)
        if (table->knots[k].ticks <= table->knots[k - 1].ticks)
            return STATUS_WRONG_TIMES;
    return STATUS_DONE;
}

uint8_t table_check(const Table *table, const Limits *limits)
{
    double heat[MOTORS] = {0};
    uint8_t status = check_whole(table);
    if (status != STATUS_DONE)
        return status;
    for (int k = 0; k + 1 < table->count; k++)
        if (!piece_keeps(&table->knots[k], &table->knots[k + 1], limits, heat))
            return STATUS_LIMIT;
    double bearable = (double)limits->lasting * (double)limits->lasting * table_period(table);
    const Knot *first = &table->knots[0], *last = &table->knots[table->count - 1];
    for (int m = 0; m < MOTORS; m++) {
        if (!(heat[m] <= bearable))
            return STATUS_LIMIT;
        if (!(fabsf(first->position[m] - last->position[m]) <= CLOSES_M) ||
            !(fabsf(first->velocity[m] - last->velocity[m]) <= CLOSES_SPEED))
            return STATUS_JUMP;
    }
    return STATUS_DONE;
}

bool table_rests(const Table *table)
{
    const Knot *last = &table->knots[table->count - 1];
    bool rests = true;
    for (int m = 0; m < MOTORS; m++)
        rests = rests && last->velocity[m] == 0 && last->acceleration[m] == 0;
    return rests;
}

/* Number of the piece that is played at a time [s]. */
static int piece_at(const Table *table, double time)
{
    int low = 0, high = table->count - 1;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (table->knots[middle].ticks * TICK_S <= time)
            low = middle;
        else
            high = middle;
    }
    return low;
}

uint8_t stream_add(Table *stream, const Knot *knot, double *time, const Limits *limits)
{
    Knot added = *knot;
    added.ticks = 0;
    if (stream->count > 0) {
        const Knot *last = &stream->knots[stream->count - 1];
        double heat[MOTORS] = {0}; /* is followed as it plays */
        uint32_t step = knot->ticks - stream->told;
        if (step == 0 || step > LONGEST_PIECE)
            return STATUS_WRONG_TIMES;
        added.ticks = last->ticks + step;
        if (!piece_keeps(last, &added, limits, heat))
            return STATUS_LIMIT;
    }
    if (stream->count == MAX_KNOTS) {
        int gone = piece_at(stream, *time);
        uint32_t begin = stream->knots[gone].ticks;
        if (gone == 0)
            return STATUS_TOO_LONG;
        stream->count = (uint16_t)(stream->count - gone);
        memmove(stream->knots, stream->knots + gone, stream->count * sizeof *stream->knots);
        for (int k = 0; k < stream->count; k++)
            stream->knots[k].ticks -= begin;
        added.ticks -= begin;
        *time -= begin * TICK_S;
    }
    stream->knots[stream->count++] = added;
    stream->told = knot->ticks;
    stream->next++;
    return STATUS_DONE;
}

void table_at(const Table *table, double time, Setpoint *out)
{
    const Knot *a = &table->knots[piece_at(table, time)], *b = a + 1;
    float h = (float)((b->ticks - a->ticks) * TICK_S);
    float s = (float)(time - a->ticks * TICK_S) / h;
    for (int m = 0; m < MOTORS; m++) {
        /* The quintic in s = t/h; c3 to c5 from what a's Taylor polynomial misses at b. */
        float c1 = h * a->velocity[m], c2 = 0.5f * h * h * a->acceleration[m];
        float dp = b->position[m] - a->position[m] - c1 - c2;
        float dv = h * b->velocity[m] - c1 - 2 * c2;
        float da = h * h * b->acceleration[m] - 2 * c2;
        float c3 = 10 * dp - 4 * dv + 0.5f * da;
        float c4 = -15 * dp + 7 * dv - da;
        float c5 = 6 * dp - 3 * dv + 0.5f * da;
        out->position[m] = a->position[m] + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5))));
        out->velocity[m] = (c1 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / h;
        out->acceleration[m] = (2 * c2 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))) / (h * h);
    }
}
