/* A motor table: quintics between knots, checked before it may play. */
#ifndef PLATE_TABLE_H
#define PLATE_TABLE_H

#include "hal.h"

#ifndef MAX_KNOTS
#define MAX_KNOTS 512 /* two tables of 52 bytes a knot: 52 kB */
#endif
#define KNOT_BYTES 52

/* A limit may be passed by this share: the host keeps it on the plate's spline, and the motors' own
   splines differ from that by the curvature of the kinematics, up to 1e-3. */
#define LIMIT_SLACK 2e-3f

typedef struct {
    uint32_t ticks; /* [10 ns] since the table's start */
    float position[MOTORS], velocity[MOTORS], acceleration[MOTORS];
} Knot;

typedef struct {
    uint16_t id;      /* 0: none */
    uint16_t count, repeats;
    bool streams;     /* knots are added while it plays; `next` is the number of the one to come, */
    uint16_t next;    /* `told` the time of the last one as the host counts it [10 ns] */
    uint32_t told;
    uint32_t crc;     /* of the knots' bytes */
    Knot knots[MAX_KNOTS];
    uint8_t there[(MAX_KNOTS + 7) / 8];
} Table;

typedef struct {
    float position[MOTORS], velocity[MOTORS], acceleration[MOTORS];
} Setpoint;

/* What each motor may do. */
typedef struct {
    float stroke_m, speed, accel;  /* [m], [m/s], [m/s2] */
    float force;                   /* peak [N] */
    float lasting;                 /* root mean square that it bears for ever [N] */
    float heat_s;                  /* time constant of its heat [s] */
    float load[MOTORS][MOTORS];    /* forces for the accelerations of all motors [kg] */
} Limits;

/* Knot from and to its bytes. */
void knot_read(Knot *knot, const uint8_t bytes[KNOT_BYTES]);
void knot_write(const Knot *knot, uint8_t bytes[KNOT_BYTES]);

/* Status of a whole table: DONE, or why it must not play. */
uint8_t table_check(const Table *table, const Limits *limits);

/* Add a knot to a stream that is `time` [s] into it; what has been played makes room for it, and
   counts no longer. Returns DONE, or why it must not be added. */
uint8_t stream_add(Table *stream, const Knot *knot, double *time, const Limits *limits);

/* Whether a table's last knot is at rest. */
bool table_rests(const Table *table);

/* Force [N] of a motor for the accelerations of all. */
double force_of(const Limits *limits, int motor, const float acceleration[MOTORS]);

double table_period(const Table *table);

/* The setpoint at a time [s] within the period. */
void table_at(const Table *table, double time, Setpoint *out);

#endif
