/* The controller: sessions, two tables, takeover, watchdog, brake. */
#ifndef PLATE_CONTROLLER_H
#define PLATE_CONTROLLER_H

#include "frame.h"
#include "table.h"

typedef struct {
    Limits limits;
    Reader reader;
    uint16_t sent; /* sequence number of the next packet */
    bool session_open;
    uint32_t session;
    uint16_t answered; /* newest ordered command */
    uint8_t answer;
    uint8_t state, faults;
    uint64_t now_us, heard_us, told_us;
    Table tables[2];
    int playing;     /* index of the buffer that plays; the other one is the second buffer */
    bool waiting;    /* the second buffer is to be taken over */
    double time;     /* into the table [s] */
    uint32_t played; /* times the table has been played */
    double brake, brake_s; /* time since the brake began, and its length [s] */
    bool going_home;
    double home_time;
    Setpoint from;   /* where the way home begins */
    double heat[MOTORS]; /* mean square of each motor's force, of late [N2] */
} Controller;

void controller_start(Controller *c, Limits limits);

/* Once per control tick, as regularly as the board can: 1 kHz or more. */
void controller_tick(Controller *c);

#endif
