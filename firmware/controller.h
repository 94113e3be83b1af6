/* The controller: sessions, stops, three tables, takeover, watchdog, brake. */
#ifndef PLATE_CONTROLLER_H
#define PLATE_CONTROLLER_H

#include "frame.h"
#include "table.h"
#include "trigger.h"

/* What a tick does at most, whatever the host sends; the rest waits. */
#define TICK_BYTES 128 /* that are read */
#define TICK_PACKETS 4 /* that are obeyed */
#define TICK_WORK 24   /* of looking at tables: three pieces, or halvings */

#define MOST_TICK_US 2000u /* a tick that comes later moves the plate on by this much */

typedef struct {
    Limits limits;
    Reader reader;
    uint8_t input[TICK_BYTES]; /* bytes that were read and not yet taken */
    uint8_t input_count, input_at;
    uint16_t sent; /* sequence number of the next packet */
    bool session_open;
    uint32_t session;
    uint16_t answered; /* newest ordered command */
    uint8_t answer;
    bool committing;   /* a Commit waits for its answer until its table has been looked at */
    uint16_t commit_sequence, commit_repeats;
    uint8_t adding;    /* bytes of the message in reader.held that is being added to a stream, or 0 */
    uint8_t state, faults;
    uint8_t board;     /* faults of the board, as of this tick */
    uint16_t stops;    /* number of the present stop, or of the last one */
    bool stop_known;   /* there was a Stop in this session: this one */
    uint16_t stop_sequence;
    bool stop_now;
    uint64_t now_us, heard_us, told_us, enabled_us;
    Trigger trigger;
    Table tables[3];
    int playing, next, filling; /* which is which: 0, 1 and 2 in some order */
    bool waiting;      /* the next one is to be taken over */
    uint32_t time;     /* in the table [TICK_S], on the clock of its knots */
    uint32_t played;   /* times the table has been played */
    uint32_t brake, brake_length; /* time since the brake began, and its length [TICK_S] */
    bool going_home;
    uint32_t home_us;  /* time since the way home began */
    float from[MOTORS];           /* where the way home begins [m] */
    Setpoint commanded;           /* last; of rest, where the motors were when they were enabled */
    bool follows;                 /* the motors were told to be there in the tick before */
    float measured[MOTORS], accelerations[MOTORS];
    uint8_t astray;               /* ticks on end with a following error that is a fault */
    float following_m;            /* largest following error since the last telemetry */
    float heat[MOTORS];           /* mean square of each motor's force, of late [N2], */
    float heat_rest[MOTORS];      /* and what rounding has left out of it */
} Controller;

void controller_start(Controller *c, Limits limits);

/* Once per control tick, as regularly as the board can: 1 kHz or more. */
void controller_tick(Controller *c);

#endif
