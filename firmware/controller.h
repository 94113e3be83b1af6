/* The controller: sessions, stops, three tables, change of tables, watchdog, brake. */
#ifndef PLATE_CONTROLLER_H
#define PLATE_CONTROLLER_H

#include "frame.h"
#include "table.h"
#include "trigger.h"

/* Maximum work per tick, whatever the host sends. The rest waits. */
#define TICK_BYTES 128 /* bytes read */
#define TICK_PACKETS 4 /* packets executed */
#define TICK_WORK 24   /* units for checking tables: three pieces, or 24 bisections */

#define MAX_TICK_US 2000u /* maximum step of the plate's time per tick; a later tick advances only by this */

typedef struct {
    Limits limits;
    Reader reader;
    uint8_t input[TICK_BYTES]; /* bytes that were read but not decoded yet */
    uint8_t input_count, input_at;
    uint16_t sent; /* sequence number of the next packet */
    bool session_open;
    uint32_t session;
    uint16_t answered; /* sequence number of the newest ordered command */
    uint8_t answer;
    bool committing;   /* a Commit is answered after its table has been checked */
    uint16_t commit_sequence, commit_repeats;
    uint8_t adding;    /* size of the message in reader.held that is being added to a stream, or 0 */
    uint8_t state, faults;
    uint8_t board;     /* faults of the board in this tick */
    uint16_t stops;    /* number of the current or last stop */
    bool stop_known;   /* whether this session has received a Stop; the next fields describe the Stop */
    uint16_t stop_sequence;
    bool stop_now;
    uint64_t now_us, received_us, telemetry_us, enabled_us;
    Trigger trigger;
    Table tables[3];
    int playing, next, filling; /* indices in tables: a permutation of 0, 1 and 2 */
    bool waiting;      /* whether the next table waits to be played */
    uint32_t table_time;          /* time in the playing table [TICK_S] */
    uint32_t played;   /* number of completed plays of the table */
    uint32_t brake_time, brake_length; /* time since the start of the brake, and its duration [TICK_S] */
    bool going_home;
    uint32_t home_us;  /* time since the motion home began [us] */
    float home_start[MOTORS];     /* start of the motion home [m] */
    Setpoint commanded;           /* last setpoint; at rest, the position at the enable */
    bool is_commanded;            /* whether `commanded` was sent to the motors in the last tick */
    float measured[MOTORS], accelerations[MOTORS];
    uint8_t deviating_ticks;      /* consecutive ticks with an excessive following error */
    float following_m;            /* maximum following error since the last telemetry [m] */
    float heat[MOTORS];           /* filtered mean square of each motor's force [N2] */
    float heat_rest[MOTORS];      /* rounding error of `heat` (compensated summation) */
} Controller;

void controller_start(Controller *c, Limits limits);

/* Call this once per control tick, at regular intervals: 1 kHz or more. */
void controller_tick(Controller *c);

#endif
