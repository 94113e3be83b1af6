/* Drives of CiA 402 on CANopen, in cyclic synchronous position mode: this board is their only master.

   Each bus cycle of two ticks: four RPDOs (controlword, target position) and SYNC, which the drives
   answer by TPDOs (statusword, actual position). A target is to be reached at the next SYNC: drives
   interpolate. The ticks between carry heartbeats, NMT and SDO. */
#include <math.h>
#include <string.h>

#include "../message.h"
#include "can.h"
#include "drives.h"

#define CYCLE_TICKS 2       /* 2 ms: at 1 Mbit/s nine frames fill half of it */
#define CYCLE_MS 2
#define MASTER 127          /* our own node id */
#define HEARTBEAT_TICKS 50
#define HEARTBEAT_MS 50
#define SILENT_TICKS 150    /* without a heartbeat, either way */
#define SILENT_MS 150u
#define MISSED_CYCLES 3     /* on end without, or with twice, a position */
#define ANSWER_TICKS 200    /* for an SDO */
#define BOOT_TICKS 1000     /* for a boot-up; also between two tries, and an alarm's length */
#define START_TICKS 100     /* for an NMT start; also until a node that is up may be enabled */
#define STARTS 10           /* tries */
#define RESET_CYCLES 10     /* for which a fault's reset is asked for */
#define KEEPS_TICKS 100     /* for a drive to take its current away */
#define READ_FRAMES 24      /* in a tick; a bus of 1 Mbit/s carries 21 of the shortest */

enum { NMT = 0x000, SYNC = 0x080, EMERGENCY = 0x080, TPDO = 0x180, RPDO = 0x200,
       SDO_ANSWER = 0x580, SDO = 0x600, HEARTBEATS = 0x700 };
enum { NMT_START = 0x01, NMT_RESET = 0x81, NMT_RESET_COMMUNICATION = 0x82 };
enum { BOOT_UP = 0, OPERATIONAL = 5 };
enum { DISABLE = 0x00, SHUTDOWN = 0x06, SWITCH_ON = 0x07, OPERATE = 0x0F, FAULT_RESET = 0x80 };

/* What is set up before a node is started. Until it is done its PDOs are not used. */
enum { PLUS_NODE = 1, OPTIONAL = 2, READ = 4, SERIAL = 8 };
typedef struct {
    uint16_t object;
    uint8_t sub, bytes, how;
    uint32_t value, mask; /* the mask is for what is read */
} Step;

#define PDO_OFF 0x80000000u
static const Step STEPS[] = {
    {0x1000, 0, 4, READ, 402, 0xFFFF},            /* a drive, */
    {0x6502, 0, 4, READ, 1u << 7, 1u << 7},       /* with cyclic synchronous position, */
    {0x1018, 4, 4, READ | SERIAL, 0, 0xFFFFFFFF}, /* the one that is meant */
    {0x1017, 0, 2, 0, HEARTBEAT_MS, 0},
    {0x1016, 1, 4, 0, (uint32_t)MASTER << 16 | SILENT_MS, 0},
    {0x6007, 0, 2, 0, 3, 0},          /* quick stop where the bus or we are gone, */
    {0x605A, 0, 2, OPTIONAL, 2, 0},   /* by its ramp, then without current */
    {0x60C2, 1, 1, 0, CYCLE_MS, 0},   /* interpolation: this many */
    {0x60C2, 2, 1, 0, 0xFD, 0},       /* times 10^-3 s */
    {0x6060, 0, 1, 0, 8, 0},          /* cyclic synchronous position */
    {0x1400, 1, 4, PLUS_NODE, PDO_OFF | RPDO, 0},
    {0x1600, 0, 1, 0, 0, 0},
    {0x1600, 1, 4, 0, 0x60400010, 0}, /* controlword */
    {0x1600, 2, 4, 0, 0x607A0020, 0}, /* target position */
    {0x1600, 0, 1, 0, 2, 0},
    {0x1400, 2, 1, 0, 1, 0},          /* at each SYNC */
    {0x1800, 1, 4, PLUS_NODE, PDO_OFF | TPDO, 0},
    {0x1A00, 0, 1, 0, 0, 0},
    {0x1A00, 1, 4, 0, 0x60410010, 0}, /* statusword */
    {0x1A00, 2, 4, 0, 0x60640020, 0}, /* actual position */
    {0x1A00, 0, 1, 0, 2, 0},
    {0x1800, 2, 1, 0, 1, 0},
    {0x1401, 1, 4, PLUS_NODE | OPTIONAL, PDO_OFF | 0x300, 0}, /* no others */
    {0x1402, 1, 4, PLUS_NODE | OPTIONAL, PDO_OFF | 0x400, 0},
    {0x1403, 1, 4, PLUS_NODE | OPTIONAL, PDO_OFF | 0x500, 0},
    {0x1801, 1, 4, PLUS_NODE | OPTIONAL, PDO_OFF | 0x280, 0},
    {0x1802, 1, 4, PLUS_NODE | OPTIONAL, PDO_OFF | 0x380, 0},
    {0x1803, 1, 4, PLUS_NODE | OPTIONAL, PDO_OFF | 0x480, 0},
    {0x1400, 1, 4, PLUS_NODE, RPDO, 0},
    {0x1800, 1, 4, PLUS_NODE, TPDO, 0},
};
#define STEP_COUNT (sizeof STEPS / sizeof *STEPS)

/* Aborts that an optional object may answer with. */
#define NO_OBJECT 0x06020000u
#define NO_SUBINDEX 0x06090011u

typedef enum { SILENT, SETUP, STARTING, UP } Stage;

typedef struct {
    Stage stage;
    uint8_t step;      /* of STEPS; in STARTING, tries */
    bool asked;        /* what it was told last is not done yet */
    uint16_t since;    /* ticks since that, or since the stage began */
    uint16_t unheard;  /* ticks since its heartbeat, 0 to SILENT_TICKS + 1 */
    uint8_t answers;   /* positions since the last SYNC */
    uint8_t missed, doubled; /* cycles on end */
    uint16_t status;   /* its statusword */
    int32_t actual, home, target; /* [counts] */
    int32_t sent, reached; /* targets: the last one that was sent, and the one before */
    int32_t error;     /* of actual, when it was taken */
    uint16_t keeps;    /* ticks with current that it was told to take away */
    uint16_t alarm;    /* ticks for which `faults` are told on */
    uint16_t resets;   /* ticks to the next try to reset its fault */
    uint8_t faults;
    bool lost;         /* it was in trouble, and is not up again yet: at power-up nothing is wrong */
} Axis;

static Drive drives[MOTORS];
static Axis axes[MOTORS];
static float commanded[MOTORS]; /* [m] */
static bool wanted, was_ready, follows, hurry, home_known, home_lost;
static uint8_t phase; /* ticks since the last cycle */
static uint16_t beat; /* ticks since our heartbeat */
static uint16_t bus_alarm;
static Trouble trouble;

/* The power state machine, by statusword */
static bool in_fault(const Axis *axis) { return (axis->status & 0x48) == 0x08; }
static bool enabled(const Axis *axis) { return (axis->status & 0x6F) == 0x27; }

/* For long enough that a second drive of its number would have been noticed. */
static bool is_up(const Axis *axis) { return axis->stage == UP && axis->since >= START_TICKS; }

static bool all_up(void)
{
    bool all = true;
    for (int m = 0; m < MOTORS; m++)
        all = all && is_up(&axes[m]);
    return all;
}

/* Whether a trouble lasts: what comes then is taken for its consequence. */
static bool faulty(void)
{
    bool any = bus_alarm > 0;
    for (int m = 0; m < MOTORS; m++)
        any = any || axes[m].lost || axes[m].alarm;
    return any;
}

/* Keep the first trouble, but for an emergency, which tells more than the fault that it explains. */
static void note(uint8_t motor, uint8_t kind, uint16_t object, uint32_t code, bool anew)
{
    bool explains = kind == TROUBLE_EMERGENCY && motor == trouble.motor &&
                    (trouble.kind == TROUBLE_FAULT || trouble.kind == TROUBLE_LEFT);
    if (trouble.kind == TROUBLE_NONE || anew || explains)
        trouble = (Trouble){.motor = motor, .kind = kind, .object = object, .code = code};
}

static void alarm(int m, uint8_t kind, uint16_t object, uint32_t code, uint8_t faults)
{
    bool anew = !faulty();
    axes[m].alarm = BOOT_TICKS;
    axes[m].faults |= faults;
    axes[m].lost = true;
    note((uint8_t)(m + 1), kind, object, code, anew);
}

static void bus_trouble(uint8_t kind)
{
    bool anew = !faulty();
    bus_alarm = BOOT_TICKS;
    note(0, kind, 0, 0, anew);
}

static void send(uint16_t id, const uint8_t *data, uint8_t size)
{
    CanFrame frame = {.id = id, .size = size};
    if (size)
        memcpy(frame.data, data, size);
    can_write(&frame);
}

static void command(int m, uint8_t order)
{
    const uint8_t data[2] = {order, drives[m].node};
    send(NMT, data, 2);
}

static void enter(Axis *axis, Stage stage)
{
    axis->stage = stage;
    axis->since = 0;
    axis->asked = false;
    axis->step = 0;
    axis->unheard = axis->missed = axis->doubled = axis->answers = 0;
    if (stage != UP)
        axis->status = 0;
}

/* It is begun anew, after a while. A node that is not operational obeys no PDO: its current is
   taken away by SDO too. */
static void lose(int m, uint8_t kind, uint16_t object, uint32_t code)
{
    const uint8_t disable[8] = {0x2B, 0x40, 0x60, 0, DISABLE};
    alarm(m, kind, object, code, FAULT_HARDWARE);
    enter(&axes[m], SILENT);
    axes[m].asked = true;
    send((uint16_t)(SDO + drives[m].node), disable, 8);
}

/* Set-up, by SDO */

static bool skipped(int m, const Step *step)
{
    return step->how & SERIAL && drives[m].serial == 0;
}

static void next_step(int m)
{
    Axis *axis = &axes[m];
    axis->asked = false;
    axis->since = 0;
    do
        axis->step++;
    while (axis->step < STEP_COUNT && skipped(m, &STEPS[axis->step]));
    if (axis->step == STEP_COUNT)
        enter(axis, STARTING);
}

static void ask(int m)
{
    Axis *axis = &axes[m];
    const Step *step = &STEPS[axis->step];
    uint32_t value = step->value + (step->how & PLUS_NODE ? drives[m].node : 0u);
    uint8_t data[8] = {0x40};
    if (!(step->how & READ)) {
        data[0] = (uint8_t)(0x23 | (4 - step->bytes) << 2);
        put_u32(data + 4, value);
    }
    put_u16(data + 1, step->object);
    data[3] = step->sub;
    send((uint16_t)(SDO + drives[m].node), data, 8);
    axis->asked = true;
    axis->since = 0;
}

static void answered(int m, const uint8_t data[8])
{
    Axis *axis = &axes[m];
    if (axis->stage != SETUP || !axis->asked)
        return;
    const Step *step = &STEPS[axis->step];
    uint32_t value = get_u32(data + 4);
    uint32_t right = step->how & SERIAL ? drives[m].serial : step->value;
    if (get_u16(data + 1) != step->object || data[3] != step->sub)
        return;
    if (data[0] == 0x80) {
        if (step->how & OPTIONAL && (value == NO_OBJECT || value == NO_SUBINDEX))
            next_step(m);
        else
            lose(m, TROUBLE_REFUSED, step->object, value);
    } else if (step->how & READ) {
        if ((data[0] & 0xE2) == 0x42 && (value & step->mask) == right)
            next_step(m);
        else
            lose(m, TROUBLE_WRONG_DRIVE, step->object, value);
    } else if (data[0] == 0x60) {
        next_step(m);
    }
}

/* What comes */

static void heartbeat(int m, uint8_t state)
{
    Axis *axis = &axes[m];
    axis->unheard = 0;
    if (state == BOOT_UP) {
        home_lost = home_lost || home_known;
        home_known = false;
        if (axis->stage == UP || axis->stage == STARTING)
            alarm(m, TROUBLE_RESET, 0, 0, FAULT_HARDWARE);
        enter(axis, SETUP);
    } else if (axis->stage == UP && (state & 0x7F) != OPERATIONAL) {
        lose(m, TROUBLE_NOT_OPERATIONAL, 0, state);
    } else if (axis->stage == STARTING && (state & 0x7F) == OPERATIONAL && axis->answers) {
        enter(axis, UP);
    }
}

/* A voltage, a position that does not follow, or anything else. */
static uint8_t fault_of(uint16_t code)
{
    return code >> 12 == 3 ? FAULT_SUPPLY : code == 0x8611 ? FAULT_FOLLOWING : FAULT_HARDWARE;
}

static void emergency(int m, const CanFrame *frame)
{
    uint16_t code = get_u16(frame->data);
    if (code != 0 && frame->size >= 3)
        alarm(m, TROUBLE_EMERGENCY, frame->data[2], code, fault_of(code));
}

static void positioned(int m, const uint8_t data[6])
{
    Axis *axis = &axes[m];
    if (axis->stage != STARTING && axis->stage != UP)
        return;
    axis->status = get_u16(data);
    axis->actual = (int32_t)get_u32(data + 2);
    axis->error = (int32_t)((uint32_t)axis->actual - (uint32_t)axis->reached);
    axis->answers = (uint8_t)(axis->answers + (axis->answers < 2));
    if (in_fault(axis) && !axis->alarm)
        alarm(m, TROUBLE_FAULT, 0, axis->status, FAULT_HARDWARE);
    else if (was_ready && axis->stage == UP && !enabled(axis) && !in_fault(axis))
        alarm(m, TROUBLE_LEFT, 0, axis->status, FAULT_HARDWARE);
}

static void take(const CanFrame *frame)
{
    if (frame->id == SYNC || frame->id == NMT)
        bus_trouble(TROUBLE_OTHER_MASTER);
    for (int m = 0; m < MOTORS; m++) {
        uint16_t id = (uint16_t)(frame->id - drives[m].node);
        if (id == HEARTBEATS && frame->size == 1)
            heartbeat(m, frame->data[0]);
        else if (id == TPDO && frame->size == 6)
            positioned(m, frame->data);
        else if (id == SDO_ANSWER && frame->size == 8)
            answered(m, frame->data);
        else if (id == EMERGENCY)
            emergency(m, frame);
        else if (id == RPDO)
            bus_trouble(TROUBLE_OTHER_MASTER);
    }
}

/* What becomes of an axis with time */
static void age(int m)
{
    Axis *axis = &axes[m];
    axis->since = (uint16_t)(axis->since + (axis->since <= BOOT_TICKS));
    axis->unheard = (uint16_t)(axis->unheard + (axis->unheard <= SILENT_TICKS));
    if (axis->alarm && !in_fault(axis) && --axis->alarm == 0)
        axis->faults = 0;
    axis->lost = axis->lost && !is_up(axis);
    if (axis->stage == SILENT && axis->since >= BOOT_TICKS) {
        alarm(m, TROUBLE_SILENT, 0, 0, FAULT_HARDWARE);
        enter(axis, SILENT);
    } else if (axis->stage == SETUP && axis->asked && axis->since > ANSWER_TICKS)
        lose(m, TROUBLE_SILENT, 0, 0);
    else if (axis->stage == STARTING && axis->since > START_TICKS) {
        axis->asked = false;
        if (axis->step == STARTS)
            lose(m, TROUBLE_SILENT, 0, 0);
    } else if (axis->stage == UP && axis->unheard > SILENT_TICKS)
        lose(m, TROUBLE_SILENT, 0, 0);
    axis->keeps = wanted || !enabled(axis) ? 0 : (uint16_t)(axis->keeps + 1);
    if (axis->keeps > KEEPS_TICKS) {
        lose(m, TROUBLE_KEEPS, 0, axis->status);
        axis->keeps = 0;
        command(m, NMT_RESET);
    }
}

void drives_begin(void)
{
    CanFrame frame;
    if (can_off()) {
        bus_trouble(TROUBLE_BUS_OFF);
        for (int m = 0; m < MOTORS; m++) {
            enter(&axes[m], SILENT);
            axes[m].asked = axes[m].lost = true;
        }
    }
    for (int n = 0; n < READ_FRAMES && can_read(&frame); n++)
        take(&frame);
    bus_alarm = (uint16_t)(bus_alarm - (bus_alarm > 0));
    for (int m = 0; m < MOTORS; m++)
        age(m);
}

/* What is sent */

static uint16_t controlword(Axis *axis)
{
    if (axis->stage != UP)
        return DISABLE;
    if (in_fault(axis)) { /* without current; a person's enable is needed all the same */
        axis->resets = axis->resets ? (uint16_t)(axis->resets - 1) : BOOT_TICKS / CYCLE_TICKS;
        return wanted || axis->resets >= RESET_CYCLES ? DISABLE : FAULT_RESET;
    }
    axis->resets = BOOT_TICKS / CYCLE_TICKS;
    if (!wanted || !all_up())
        return DISABLE;
    if ((axis->status & 0x4F) == 0x40) /* switch on disabled */
        return SHUTDOWN;
    if ((axis->status & 0x6F) == 0x21) /* ready to switch on */
        return SWITCH_ON;
    return (axis->status & 0x6F) == 0x23 || enabled(axis) ? OPERATE : DISABLE; /* switched on */
}

/* How regularly the positions came since the last SYNC. */
static void count_answers(int m)
{
    Axis *axis = &axes[m];
    axis->missed = axis->answers == 0 ? (uint8_t)(axis->missed + 1) : 0;
    axis->doubled = axis->answers > 1 ? (uint8_t)(axis->doubled + 1) : 0;
    axis->answers = 0;
    if (axis->missed == MISSED_CYCLES)
        lose(m, TROUBLE_NO_POSITION, 0, 0);
    else if (axis->doubled == MISSED_CYCLES)
        lose(m, TROUBLE_TWICE, 0, 0);
}

static void cycle(void)
{
    for (int m = 0; m < MOTORS; m++) {
        Axis *axis = &axes[m];
        if (axis->stage == UP && !hurry)
            count_answers(m);
        if (!enabled(axis)) /* where it is: no jump once it has current */
            axis->target = axis->actual;
        axis->reached = axis->sent;
        axis->sent = axis->target;
        uint8_t data[6];
        put_u32(put_u16(data, controlword(axis)), (uint32_t)axis->target);
        send((uint16_t)(RPDO + drives[m].node), data, 6);
    }
    send(SYNC, NULL, 0);
}

static void keep_house(int m)
{
    Axis *axis = &axes[m];
    if (axis->asked || axis->stage == UP)
        return;
    if (axis->stage == SETUP) {
        ask(m);
        return;
    }
    command(m, axis->stage == SILENT ? NMT_RESET_COMMUNICATION : NMT_START);
    axis->asked = true;
    axis->since = 0;
    axis->step++;
}

void drives_end(void)
{
    beat++;
    if (++phase >= CYCLE_TICKS || hurry) {
        phase = 0;
        cycle();
        hurry = false;
        return;
    }
    if (beat >= HEARTBEAT_TICKS) {
        const uint8_t state = OPERATIONAL;
        send(HEARTBEATS + MASTER, &state, 1);
        beat = 0;
    }
    for (int m = 0; m < MOTORS; m++)
        keep_house(m);
}

void drives_start(const Drive of[MOTORS])
{
    memcpy(drives, of, sizeof drives);
    memset(axes, 0, sizeof axes);
    memset(&trouble, 0, sizeof trouble);
    wanted = was_ready = follows = hurry = home_known = home_lost = false;
    phase = 0;
    beat = HEARTBEAT_TICKS;
    bus_alarm = 0;
}

/* What the controller asks for */

void hal_drive(bool on)
{
    for (int m = 0; m < MOTORS && wanted && !on && !was_ready; m++)
        if (!enabled(&axes[m]))
            note((uint8_t)(m + 1), TROUBLE_NOT_ENABLED, 0, axes[m].status, false);
    if (on)
        memset(&trouble, 0, sizeof trouble);
    hurry = !on; /* at the end of this tick */
    wanted = on;
    was_ready = follows = false;
}

bool hal_ready(void)
{
    bool all = wanted && all_up();
    for (int m = 0; m < MOTORS; m++)
        all = all && enabled(&axes[m]);
    was_ready = was_ready || all;
    return all;
}

bool hal_home(void)
{
    home_known = true;
    for (int m = 0; m < MOTORS; m++)
        axes[m].home = drives[m].absolute ? 0 : axes[m].actual;
    return true;
}

void hal_command(const float position[MOTORS], const float velocity[MOTORS],
                 const float acceleration[MOTORS])
{
    (void)velocity, (void)acceleration;
    for (int m = 0; m < MOTORS; m++) {
        float counts = position[m] * drives[m].counts_per_m * drives[m].sign;
        axes[m].target = (int32_t)((uint32_t)axes[m].home + (uint32_t)lrintf(counts));
    }
    memcpy(commanded, position, sizeof commanded);
    follows = true;
}

/* A position is as old as the bus: while it is led, what is told is where it would be now, with the
   following error that it had then. The drives tell no acceleration. */
void hal_measure(float position[MOTORS], float acceleration[MOTORS])
{
    for (int m = 0; m < MOTORS; m++) {
        const Axis *axis = &axes[m];
        int32_t place = (int32_t)((uint32_t)axis->actual - (uint32_t)axis->home);
        float counts = (float)(follows ? axis->error : place);
        position[m] = (follows ? commanded[m] : 0) + counts * drives[m].sign / drives[m].counts_per_m;
        acceleration[m] = 0;
    }
}

uint8_t hal_faults(void)
{
    uint8_t faults = home_lost ? FAULT_NO_HOME : 0;
    home_lost = false;
    if (bus_alarm)
        faults |= FAULT_HARDWARE;
    for (int m = 0; m < MOTORS; m++) {
        faults |= axes[m].faults;
        if (axes[m].lost && !is_up(&axes[m]))
            faults |= FAULT_HARDWARE;
    }
    return faults;
}

bool hal_trouble(Trouble *out)
{
    *out = trouble;
    return trouble.kind != TROUBLE_NONE;
}
