/* CiA 402 drives on CANopen in cyclic synchronous position mode. This board is their only master.

   Each bus cycle takes two ticks: four RPDOs (controlword, target position) and SYNC, to which the drives
   reply with TPDOs (statusword, actual position). The drives interpolate and reach a target at the next
   SYNC. The ticks between carry heartbeats, NMT and SDO. */
#include <string.h>

#include "axes.h"

#define CYCLE_MS 2
#define MASTER 127          /* node id of this board */
#define HEARTBEAT_TICKS 50
#define HEARTBEAT_MS 50
#define SILENT_MS 150u
#define RESET_CYCLES 10     /* duration of the request to reset a fault */

enum { NMT = 0x000, SYNC = 0x080, EMERGENCY = 0x080, TPDO = 0x180, RPDO = 0x200,
       SDO_ANSWER = 0x580, SDO = 0x600, HEARTBEATS = 0x700 };
enum { NMT_START = 0x01, NMT_RESET = 0x81, NMT_RESET_COMMUNICATION = 0x82 };
enum { BOOT_UP = 0, OPERATIONAL = 5 };
#define REMOTE 0x0200       /* bit of the statusword: the drive obeys controlwords */
enum { DISABLE = 0x00, SHUTDOWN = 0x06, SWITCH_ON = 0x07, OPERATE = 0x0F, FAULT_RESET = 0x80 };

/* Set-up of a node before its start. Its PDOs are not used until the set-up is complete. */
enum { PLUS_NODE = 1, OPTIONAL = 2, READ = 4, SERIAL = 8, OR_NEXT = 16, INSTEAD = 32 };
typedef struct {
    uint16_t object;
    uint8_t sub, bytes, how;
    uint32_t value, mask; /* the mask is for values that are read */
} Step;

#define PDO_OFF 0x80000000u
#define NO_RTR 0x40000000u /* bit of a TPDO; drives without remote requests require it */
static const Step STEPS[] = {
    {0x1000, 0, 4, READ, 402, 0xFFFF},            /* check that it is a CiA 402 drive */
    {0x6040, 0, 2, 0, DISABLE, 0},                /* current off in any state of the drive */
    {0x6502, 0, 4, READ, 1u << 7, 1u << 7},       /* check for cyclic synchronous position */
    {0x1018, 4, 4, READ | SERIAL, 0, 0xFFFFFFFF}, /* check that it is the drive of the rig file */
    {0x1017, 0, 2, 0, HEARTBEAT_MS, 0},
    {0x1016, 1, 4, 0, (uint32_t)MASTER << 16 | SILENT_MS, 0},
    {0x6007, 0, 2, 0, 3, 0},          /* if the bus or this board fails: quick stop */
    {0x605A, 0, 2, OR_NEXT, 2, 0},    /* quick stop: the drive's ramp, then current off */
    {0x6007, 0, 2, INSTEAD, 2, 0},    /* if the drive refuses 605Ah = 2: current off at once */
    {0x60C2, 1, 1, 0, CYCLE_MS, 0},   /* interpolation period: number of units */
    {0x60C2, 2, 1, 0, 0xFD, 0},       /* interpolation period: unit, 10^-3 s */
    {0x6060, 0, 1, 0, 8, 0},          /* cyclic synchronous position */
    {0x1400, 1, 4, PLUS_NODE, PDO_OFF | RPDO, 0},
    {0x1600, 0, 1, 0, 0, 0},
    {0x1600, 1, 4, 0, 0x60400010, 0}, /* controlword */
    {0x1600, 2, 4, 0, 0x607A0020, 0}, /* target position */
    {0x1600, 0, 1, 0, 2, 0},
    {0x1400, 2, 1, 0, 1, 0},          /* transmitted at each SYNC */
    {0x1800, 1, 4, PLUS_NODE, PDO_OFF | NO_RTR | TPDO, 0},
    {0x1A00, 0, 1, 0, 0, 0},
    {0x1A00, 1, 4, 0, 0x60410010, 0}, /* statusword */
    {0x1A00, 2, 4, 0, 0x60640020, 0}, /* actual position */
    {0x1A00, 0, 1, 0, 2, 0},
    {0x1800, 2, 1, 0, 1, 0},
    {0x1401, 1, 4, PLUS_NODE | OPTIONAL, PDO_OFF | 0x300, 0}, /* disable the other PDOs */
    {0x1402, 1, 4, PLUS_NODE | OPTIONAL, PDO_OFF | 0x400, 0},
    {0x1403, 1, 4, PLUS_NODE | OPTIONAL, PDO_OFF | 0x500, 0},
    {0x1801, 1, 4, PLUS_NODE | OPTIONAL, PDO_OFF | NO_RTR | 0x280, 0},
    {0x1802, 1, 4, PLUS_NODE | OPTIONAL, PDO_OFF | NO_RTR | 0x380, 0},
    {0x1803, 1, 4, PLUS_NODE | OPTIONAL, PDO_OFF | NO_RTR | 0x480, 0},
    {0x6061, 0, 1, READ, 8, 0xFF},    /* check that the drive has adopted the mode */
    {0x1400, 1, 4, PLUS_NODE, RPDO, 0},
    {0x1800, 1, 4, PLUS_NODE, NO_RTR | TPDO, 0},
};
#define STEP_COUNT (sizeof STEPS / sizeof *STEPS)

/* Allowed aborts of optional objects. */
#define NO_OBJECT 0x06020000u
#define NO_SUBINDEX 0x06090011u

/* Power state machine, according to the statusword */
bool in_fault(const Axis *axis) { return (axis->status & 0x48) == 0x08; }
bool enabled(const Axis *axis) { return (axis->status & 0x6F) == 0x27; }

static void command(int m, uint8_t order)
{
    const uint8_t data[2] = {order, drives[m].node};
    send(NMT, data, 2);
}

/* A node that is not operational ignores PDOs. A stopped one also ignores SDOs. */
void cut(int m)
{
    const uint8_t disable[8] = {0x2B, 0x40, 0x60, 0, DISABLE};
    send((uint16_t)(SDO + drives[m].node), disable, 8);
    if (axes[m].stage == UP && enabled(&axes[m]))
        command(m, NMT_RESET);
}

void break_off(int m) { command(m, NMT_RESET); }

/* Set-up with SDOs */

static bool skipped(int m, const Step *step)
{
    return step->how & INSTEAD || (step->how & SERIAL && drives[m].serial == 0);
}

static void next_step(int m)
{
    Axis *axis = &axes[m];
    axis->pending = false;
    axis->since = 0;
    do
        axis->step++;
    while (axis->step < STEP_COUNT && skipped(m, &STEPS[axis->step]));
    if (axis->step == STEP_COUNT)
        enter(axis, STARTING);
}

static void send_step(int m)
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
    axis->pending = true;
    axis->since = 0;
}

static void answered(int m, const uint8_t data[8])
{
    Axis *axis = &axes[m];
    if (axis->stage != SETUP || !axis->pending)
        return;
    const Step *step = &STEPS[axis->step];
    uint32_t value = get_u32(data + 4);
    uint32_t right = step->how & SERIAL ? drives[m].serial : step->value;
    if (get_u16(data + 1) != step->object || data[3] != step->sub)
        return;
    if (data[0] == 0x80) {
        if (step->how & OR_NEXT) {
            axis->pending = false;
            axis->step++;
        } else if (step->how & OPTIONAL && (value == NO_OBJECT || value == NO_SUBINDEX))
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

/* Received frames */

static void heartbeat(int m, uint8_t state)
{
    Axis *axis = &axes[m];
    axis->heartbeat_age = 0;
    if (state == BOOT_UP) {
        bool ours = axis->stage == SILENT && axis->step && axis->since <= ANSWER_TICKS;
        if (!ours) /* the boot-up is not a reply to a reset by this board */
            lose_home(m);
        if (axis->stage == UP || axis->stage == STARTING)
            alarm(m, TROUBLE_RESET, 0, 0, FAULT_HARDWARE);
        enter(axis, SETUP);
    } else if (axis->stage == UP && (state & 0x7F) != OPERATIONAL) {
        lose(m, TROUBLE_NOT_OPERATIONAL, 0, state);
    } else if (axis->stage == STARTING && (state & 0x7F) == OPERATIONAL && axis->answers) {
        enter(axis, UP);
        axis->proven = true;
    }
}

/* Fault bits of an emergency: supply voltage, following error, or hardware. */
static uint8_t fault_of(uint16_t code)
{
    return code >> 12 == 3 ? FAULT_SUPPLY : code == 0x8611 ? FAULT_FOLLOWING : FAULT_HARDWARE;
}

static void emergency(int m, const CanFrame *frame)
{
    uint16_t code = get_u16(frame->data);
    if (code != 0 && frame->size >= 2)
        alarm(m, TROUBLE_EMERGENCY, frame->size > 2 ? frame->data[2] : 0, code, fault_of(code));
}

static void positioned(int m, const uint8_t data[6])
{
    Axis *axis = &axes[m];
    /* Until the drive is reset, update its last position. Home is kept if the next one is equal. */
    if (axis->stage == SILENT && axis->step == 0 && axis->reported)
        axis->actual = (int32_t)get_u32(data + 2);
    if (axis->stage != STARTING && axis->stage != UP)
        return;
    axis->status = get_u16(data);
    placed(m, (int32_t)get_u32(data + 2));
    if (in_fault(axis) && !axis->alarm)
        alarm(m, TROUBLE_FAULT, 0, axis->status, FAULT_HARDWARE);
    else if (was_ready && axis->stage == UP && !in_fault(axis) &&
             !(enabled(axis) && axis->status & REMOTE))
        alarm(m, TROUBLE_LEFT, 0, axis->status, FAULT_HARDWARE);
}

void take(const CanFrame *frame)
{
    if (frame->id == SYNC || frame->id == NMT || frame->id == HEARTBEATS + MASTER)
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
        else if (id == RPDO || id == SDO)
            bus_trouble(TROUBLE_OTHER_MASTER);
    }
}

/* Sent frames */

static uint16_t controlword(Axis *axis)
{
    if (axis->stage != UP)
        return DISABLE;
    if (in_fault(axis)) { /* the current stays off until a new Enable */
        axis->resets = axis->resets ? (uint16_t)(axis->resets - 1) : BOOT_TICKS / CYCLE_TICKS;
        return requested || axis->resets >= RESET_CYCLES ? DISABLE : FAULT_RESET;
    }
    axis->resets = BOOT_TICKS / CYCLE_TICKS;
    if (!requested || !all_up() || !(enabled(axis) || stands(axis)))
        return DISABLE;
    if ((axis->status & 0x4F) == 0x40) /* switch on disabled */
        return SHUTDOWN;
    if ((axis->status & 0x6F) == 0x21) /* ready to switch on */
        return SWITCH_ON;
    return (axis->status & 0x6F) == 0x23 || enabled(axis) ? OPERATE : DISABLE; /* switched on */
}

void cycle(void)
{
    for (int m = 0; m < MOTORS; m++) {
        Axis *axis = &axes[m];
        if (!enabled(axis) && stands(axis)) /* the drive must not jump when it gets current */
            axis->target = axis->actual;
        axis->reached = axis->sent;
        axis->sent = axis->target;
        if (!axis->reported)
            continue; /* the drive may still have current from before the board's reset */
        uint8_t data[6];
        put_u32(put_u16(data, controlword(axis)), (uint32_t)axis->target);
        send((uint16_t)(RPDO + drives[m].node), data, 6);
    }
    send(SYNC, NULL, 0);
}

static void keep_house(int m)
{
    Axis *axis = &axes[m];
    if (axis->pending || axis->stage == UP)
        return;
    if (axis->stage == SETUP) {
        send_step(m);
        return;
    }
    if (axis->stage == SILENT)
        cut(m);
    command(m, axis->stage == SILENT ? NMT_RESET_COMMUNICATION : NMT_START);
    axis->pending = true;
    axis->since = 0;
    axis->step++;
}

void between(void)
{
    static uint16_t beat = HEARTBEAT_TICKS;
    beat += CYCLE_TICKS;
    if (beat >= HEARTBEAT_TICKS) {
        const uint8_t state = OPERATIONAL;
        send(HEARTBEATS + MASTER, &state, 1);
        beat = 0;
    }
    for (int m = 0; m < MOTORS; m++)
        keep_house(m);
}
