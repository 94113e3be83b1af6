/* A motor table: quintic pieces between knots, checked before it plays. */
#ifndef PLATE_TABLE_H
#define PLATE_TABLE_H

#include "piece.h"

#ifndef MAX_KNOTS
#define MAX_KNOTS 512 /* three tables with 52 bytes per knot: 80 kB */
#endif
#define KNOT_BYTES 52

/* Allowed deviation of a table's start and end from rest at home. It allows for the rounding of f32, and
   is too small for a jolt. It does not apply to the start of a table that continues another one at its
   splice, because such a table begins in motion. */
#define REST_M 2e-6f
#define REST_SPEED 2e-3f /* [m/s] */

/* Progress of the check of a table. The pieces are checked in order. A piece is checked when both of its
   knots have arrived. */
typedef struct {
    uint16_t knots;     /* number of checked knots, each with the piece before it */
    uint8_t status;     /* DONE so far, or the reason why the table must not play */
    uint32_t crc;       /* CRC of the checked knots' bytes */
    float heat[MOTORS]; /* integral of the squared force so far [N2 s] */
    PieceCheck piece;
} Check;

typedef struct {
    uint16_t id;    /* 0: none */
    uint16_t count; /* number of knots, also while they are still arriving */
    uint16_t repeats;
    bool streams;   /* stream: knots are added to a ring while it plays */
    uint16_t first; /* stream: index of the oldest knot in `knots` */
    uint16_t next;  /* stream: number of the next knot */
    uint16_t arrived_count; /* table: number of different knots that have arrived */
    uint32_t crc;   /* CRC of the knots' bytes */
    uint32_t splice; /* time at which the next table takes over or the tail begins [TICK_S]; 0: no tail */
    uint16_t splice_knot; /* number of the knot at the splice, valid after its check */
    Knot knots[MAX_KNOTS];
    uint8_t arrived[(MAX_KNOTS + 7) / 8]; /* table: one bit per knot that has arrived */
    Check check;
} Table;

/* Clear a table before it is filled. */
void table_open(Table *table, uint16_t id, uint16_t count, uint32_t crc, uint32_t splice);

/* Store a knot at its place. If a knot is already there, the first one is kept. */
void table_put(Table *table, int number, const uint8_t bytes[KNOT_BYTES]);

/* Continue the check of a table that is being filled while there is `work`. */
void table_check(Table *table, const Limits *limits, int *work);

/* Whether the check is complete or has failed. check.status is then the result. */
bool table_checked(const Table *table);

/* Add a knot to a stream at `time` [TICK_S]. It may replace knots that have been played. Its piece is
   checked while there is `work`. Return false if the work did not suffice: call again with the same
   knot. Otherwise *status is DONE, or the reason why the knot must not be added. */
bool stream_add(Table *stream, const uint8_t bytes[KNOT_BYTES], uint32_t time,
                const Limits *limits, int *work, uint8_t *status);

/* Knot of a table by its number; the oldest one is 0. */
const Knot *table_knot(const Table *table, int number);

/* Whether a knot is at rest at home. */
bool knot_is_home(const Knot *knot);

/* Whether the last knot has no speed and no acceleration. */
bool table_rests(const Table *table);

/* Whether the table begins in the state at another table's splice, bit by bit. */
bool table_follows(const Table *table, const Table *before);

/* Duration from the first to the last knot [TICK_S]. */
uint32_t table_period(const Table *table);

/* Duration of the part that plays at the time *elapsed of a table: its cycle or its tail [TICK_S].
   *elapsed becomes the time within that part. */
uint32_t table_part(const Table *table, uint32_t *elapsed);

/* Setpoint at the time `elapsed` [TICK_S] of the table; at its end, at rest. */
void table_at(const Table *table, uint32_t elapsed, Setpoint *out);

#endif
