/* A motor table: quintics between knots, checked before it may play. */
#ifndef PLATE_TABLE_H
#define PLATE_TABLE_H

#include "piece.h"

#ifndef MAX_KNOTS
#define MAX_KNOTS 512 /* three tables of 52 bytes a knot: 80 kB */
#endif
#define KNOT_BYTES 52

/* How far from rest at home a table may begin and end: f32 rounding, and no jolt. (One that follows
   upon a splice begins in motion.) */
#define REST_M 2e-6f
#define REST_SPEED 2e-3f /* [m/s] */

/* How far the looking at a table has come: a piece as soon as both its ends are there, in order. */
typedef struct {
    uint16_t knots;     /* that have been looked at, each with the piece before it */
    uint8_t status;     /* DONE so far, or why the table must not play */
    uint32_t crc;       /* of their bytes */
    float heat[MOTORS]; /* integral of force squared so far [N2 s] */
    Look look;
} Check;

typedef struct {
    uint16_t id;    /* 0: none */
    uint16_t count; /* knots that it has, or, while it is being filled, is to have */
    uint16_t repeats;
    bool streams;   /* knots are added while it plays, in a ring: */
    uint16_t first; /* where the oldest is in `knots`, */
    uint16_t next;  /* and the number of the one to come */
    uint16_t have;  /* different knots that have come, if it does not stream */
    uint32_t crc;   /* of the knots' bytes */
    uint32_t splice; /* when the next table may take over, and else the tail begins [TICK_S]; 0: no tail */
    uint16_t splice_knot; /* number of the knot there, once that has been looked at */
    Knot knots[MAX_KNOTS];
    uint8_t there[(MAX_KNOTS + 7) / 8];
    Check check;
} Table;

/* Make a table empty, to be filled. */
void table_open(Table *table, uint16_t id, uint16_t count, uint32_t crc, uint32_t splice);

/* Put a knot into its place; one that is there stays as it came first. */
void table_put(Table *table, int number, const uint8_t bytes[KNOT_BYTES]);

/* Go on looking at a table that is being filled, for as long as there is `work`. */
void table_look(Table *table, const Limits *limits, int *work);

/* Whether all has been looked at, or enough to refuse it: then check.status is the answer. */
bool table_looked_at(const Table *table);

/* Add a knot to a stream that is at `time` [TICK_S]; what has been played makes room for it. The
   piece is looked at while there is `work`. Returns false if that did not suffice: call again, with
   the same knot. *status is then DONE, or why it must not be added. */
bool stream_add(Table *stream, const uint8_t bytes[KNOT_BYTES], uint32_t time,
                const Limits *limits, int *work, uint8_t *status);

/* A table's knot by its number, the oldest being 0. */
const Knot *table_knot(const Table *table, int number);

/* Whether a knot is at rest at home. */
bool knot_is_home(const Knot *knot);

/* Whether the last knot has no speed and no acceleration. */
bool table_rests(const Table *table);

/* Whether it begins in the very state, bit by bit, in which another table is spliced. */
bool table_follows(const Table *table, const Table *before);

/* From the first to the last knot [TICK_S]. */
uint32_t table_period(const Table *table);

/* Length of the part that is played `into` a table, its cycle or its tail [TICK_S]; *into becomes
   the time into that part. */
uint32_t table_part(const Table *table, uint32_t *into);

/* The setpoint `into` [TICK_S] the table; at its end, rest. */
void table_at(const Table *table, uint32_t into, Setpoint *out);

#endif
