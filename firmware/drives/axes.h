/* What the backends on a CAN bus share: four axes, their troubles, and what the controller asks for. */
#ifndef PLATE_AXES_H
#define PLATE_AXES_H

#include "../message.h"
#include "can.h"
#include "drives.h"

#define CYCLE_TICKS 2       /* 2 ms: at 1 Mbit/s four axes fill half of it */
#define SILENT_TICKS 150    /* without a heartbeat */
#define MISSED_CYCLES 3     /* on end without, or with twice, a position */
#define ANSWER_TICKS 200    /* for what was asked in SETUP, and for the boot-up after our reset */
#define BOOT_TICKS 1000     /* for an answer; also between two tries, and an alarm's length */
#define START_TICKS 100     /* for a start; also until a drive that is up may be enabled */
#define STARTS 10           /* tries */
#define KEEPS_TICKS 100     /* for a drive to take its current away */
#define ASTRAY_CYCLES 2     /* on end with a following error */
#define CROOKED_CYCLES 5    /* on end with positions that are not of one rigid plate */
#define STILL_CYCLES 150    /* for which an axis must stand before it gets current, */
#define STILL_M 0.0005f     /* within this [m] */

typedef enum { SILENT, SETUP, STARTING, UP } Stage;

typedef struct {
    Stage stage;
    uint8_t step;      /* of its set-up; in STARTING, tries */
    bool asked;        /* what it was told last is not done yet */
    bool proven;       /* that it may be enabled, as far as its backend tries that */
    uint16_t since;    /* ticks since that, or since the stage began */
    uint16_t unheard;  /* ticks since its heartbeat, 0 to SILENT_TICKS + 1 */
    uint8_t answers;   /* positions since they were asked for last */
    uint8_t missed, doubled, astray; /* cycles on end */
    uint16_t status;   /* its statusword, or state */
    uint32_t errors;   /* its own, as it tells them */
    int32_t actual, home, target; /* [counts] */
    int32_t sent, reached; /* the last target that was sent, and where it should be when it answers */
    int32_t error;     /* of actual, when it was taken */
    int32_t rest;      /* it has stood near here [counts] */
    uint8_t still;     /* cycles since then, 0 to STILL_CYCLES */
    bool leapt;        /* with that its position did what no motor can */
    bool told;         /* where it is, since the board started */
    uint16_t keeps;    /* ticks with current that it was told to take away */
    uint16_t alarm;    /* ticks for which `faults` are told on */
    uint16_t resets;   /* to the next try to reset its fault */
    uint8_t faults;
    bool lost;         /* it was in trouble, and is not up again yet: at power-up nothing is wrong */
} Axis;

extern Drive drives[MOTORS];
extern Axis axes[MOTORS];
extern const Limits *limits;
extern float led[3][MOTORS]; /* what was commanded last [m], [m/s], [m/s2] */
extern bool wanted, was_ready, follows; /* current; and that it came; and that it is led */
extern bool hurry; /* current off, in this tick */

/* Of a backend. */
bool enabled(const Axis *axis);   /* it has current */
bool in_fault(const Axis *axis);
void take(const CanFrame *frame); /* a frame came */
void cycle(void);                 /* send what each bus cycle has, */
void between(void);               /* and what the tick after it has */
void cut(int m);                  /* take its current away, by all means that the bus has */
void break_off(int m);            /* it has kept its current in spite of that */

bool all_up(void);
void placed(int m, int32_t actual); /* it told its position */
bool stands(const Axis *axis);      /* for long enough that its position is believed */
void alarm(int m, uint8_t kind, uint16_t object, uint32_t code, uint8_t faults);
void explain(int m, uint8_t kind, uint32_t code); /* more of the trouble of that kind */
void bus_trouble(uint8_t kind);
void send(uint16_t id, const uint8_t *data, uint8_t size);
void enter(Axis *axis, Stage stage);

/* It is begun anew, after a while. */
void lose(int m, uint8_t kind, uint16_t object, uint32_t code);

void lose_home(int m); /* a drive may count from elsewhere now */

#endif
