/* Common part of the backends on a CAN bus: four axes, their faults, and the orders of the controller. */
#ifndef PLATE_AXES_H
#define PLATE_AXES_H

#include "../message.h"
#include "can.h"
#include "drives.h"

#define CYCLE_TICKS 2       /* length of a bus cycle, 2 ms; at 1 Mbit/s four axes use half of it */
#define SILENT_TICKS 150    /* maximum time without a heartbeat */
#define MISSED_CYCLES 3     /* consecutive cycles without a position, or with two positions, that are a fault */
#define ANSWER_TICKS 200    /* maximum wait for a reply in SETUP, and for the boot-up after a reset */
#define BOOT_TICKS 1000     /* maximum wait for an answer; also between two tries, and an alarm's duration */
#define START_TICKS 100     /* maximum wait for a start; also the time until a started drive can be enabled */
#define STARTS 10           /* maximum number of tries */
#define KEEPS_TICKS 100     /* maximum time in which a drive must switch its current off */
#define DEVIATING_CYCLES 2  /* consecutive cycles with a too large following error that are a fault */
#define CROOKED_CYCLES 5    /* consecutive cycles with inconsistent positions that are a fault */
#define STILL_CYCLES 150    /* cycles for which an axis must rest before it gets current */
#define STILL_M 0.0005f     /* maximum motion of an axis that counts as resting [m] */

typedef enum { SILENT, SETUP, STARTING, UP } Stage;

typedef struct {
    Stage stage;
    uint8_t step;      /* step of the set-up; in STARTING, number of tries */
    bool pending;      /* the last order has not been executed yet */
    bool proven;       /* the backend's trial before an enable has succeeded */
    uint16_t since;    /* ticks since the last order, or since the start of the stage */
    uint16_t heartbeat_age; /* ticks since the last heartbeat, 0 to SILENT_TICKS + 1 */
    uint8_t answers;   /* number of positions since the last request */
    uint8_t missed, doubled, deviating; /* consecutive cycles */
    uint16_t status;   /* the drive's statusword, or its state */
    uint32_t errors;   /* the drive's own errors, as reported */
    int32_t actual, home, target; /* [counts] */
    int32_t sent, reached; /* the last sent target, and the expected position of the next reply */
    int32_t error;     /* following error when `actual` was received */
    int32_t rest;      /* position near which the axis rests [counts] */
    uint8_t still;     /* number of cycles in which the axis has rested there, 0 to STILL_CYCLES */
    bool leapt;        /* the drive's last position is impossibly far from the position before */
    bool reported;     /* the drive has reported a position since the board started */
    uint16_t keeps;    /* ticks with current after the order to switch it off */
    uint16_t alarm;    /* remaining ticks for which `faults` are reported */
    uint16_t resets;   /* ticks until the next try to reset the drive's fault */
    uint8_t faults;
    bool lost;         /* the drive had a fault and has not started again; false at power-up */
} Axis;

extern Drive drives[MOTORS];
extern Axis axes[MOTORS];
extern const Limits *limits;
extern float last_setpoint[3][MOTORS]; /* last setpoint [m], [m/s], [m/s2] */
extern bool requested, was_ready, follows; /* current is requested; current is on; the axes follow setpoints */
extern bool hurry; /* whether the current must be switched off in this tick */

/* Functions of each backend. */
bool enabled(const Axis *axis);   /* whether the drive has current */
bool in_fault(const Axis *axis);
void take(const CanFrame *frame); /* process a received frame */
void cycle(void);                 /* send the frames of a bus cycle */
void between(void);               /* send the frames of the tick between two bus cycles */
void cut(int m);                  /* switch a drive's current off with all messages that can do this */
void break_off(int m);            /* stop a drive that has kept its current for KEEPS_TICKS */

bool all_up(void);
void placed(int m, int32_t actual); /* process a drive's reported position */
bool stands(const Axis *axis);      /* whether the axis has rested long enough to accept its position */
void alarm(int m, uint8_t kind, uint16_t object, uint32_t code, uint8_t faults);
void explain(int m, uint8_t kind, uint32_t code); /* add a detail to a fault of this kind */
void bus_trouble(uint8_t kind);
void send(uint16_t id, const uint8_t *data, uint8_t size);
void enter(Axis *axis, Stage stage);

/* Restart the axis after a delay. */
void lose(int m, uint8_t kind, uint16_t object, uint32_t code);

void lose_home(int m); /* forget home, because the drive may now count from another origin */

#endif
