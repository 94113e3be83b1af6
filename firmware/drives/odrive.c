/* ODrives on CAN (CANSimple) in position control. This board is their only master.

   Each bus cycle takes two ticks: four Set_Input_Pos and four requests for Get_Encoder_Estimates, to
   which the drives reply. The drives do not interpolate; the feed-forward moves them between setpoints. */
#include "axes.h"

#include <math.h>
#include <string.h>

#define COUNTS 1048576.0f  /* counts of this firmware per turn of the drive */
#define TURNS 2000.0f      /* maximum magnitude of an accepted position */
#define PROTOCOL 2         /* version in Get_Version of firmware 0.6 */
#define AGAIN_CYCLES 50    /* cycles between two tries to start operation */
#define CLEAR_CYCLES 500   /* cycles between two tries to clear a drive's errors */
#define DOG_TICKS 250      /* maximum time until a drive's watchdog expires and the drive reports this */
#define FRESH_CYCLES 3     /* cycles until a new position after a renewed request */

enum { GET_VERSION = 0x00, HEARTBEAT_OF = 0x01, ESTOP = 0x02, GET_ERROR = 0x03, SET_STATE = 0x07,
       GET_ESTIMATES = 0x09, SET_MODE = 0x0B, SET_POSITION = 0x0C, CLEAR_ERRORS = 0x18 };
#define OF_MASTER (1u << ESTOP | 1u << SET_STATE | 1u << SET_MODE | 7u << SET_POSITION | 1u << CLEAR_ERRORS)
enum { IDLE = 1, CLOSED_LOOP = 8 };
enum { POSITION_CONTROL = 3, PASSTHROUGH = 1 };
#define INITIALIZING 1u
#define OF_SUPPLY 0xF00u
#define DOG 0x01000000u

bool in_fault(const Axis *axis) { return axis->errors != 0; }
bool enabled(const Axis *axis) { return axis->status == CLOSED_LOOP; }

/* CANSimple cannot read the watchdog's setting. After each start, the watchdog is tested once before the
   first setpoint: the board sends nothing while the drive holds the plate. */
static bool tried(const Axis *axis) { return requested && !axis->proven && enabled(axis); }

static uint8_t fault_of(uint32_t errors)
{
    return errors & OF_SUPPLY ? FAULT_SUPPLY : FAULT_HARDWARE;
}

static void send_message(int m, uint8_t message, uint32_t first, uint32_t second)
{
    uint8_t data[8];
    put_u32(put_u32(data, first), second);
    send((uint16_t)(drives[m].node << 5 | message), data, 8);
}

static void request(int m, uint8_t message)
{
    const CanFrame frame = {.id = (uint16_t)(drives[m].node << 5 | message | CAN_REMOTE), .size = 8};
    can_write(&frame);
}

void cut(int m) { send_message(m, SET_STATE, IDLE, 0); }
void break_off(int m) { send((uint16_t)(drives[m].node << 5 | ESTOP), NULL, 0); }

/* Received frames */

static void heartbeat(int m, uint32_t errors, uint8_t state)
{
    Axis *axis = &axes[m];
    bool was_tried = tried(axis), bitten = was_tried && errors & DOG;
    axis->heartbeat_age = 0;
    axis->errors = errors;
    axis->status = state;
    if (axis->stage == SILENT && !axis->lost && axis->since > START_TICKS)
        axis->pending = false; /* the drive has power again */
    if (axis->stage == UP && tried(axis) && !was_tried)
        axis->since = START_TICKS;
    if (axis->stage == STARTING && axis->answers && !(errors & INITIALIZING)) {
        enter(axis, UP);
        axis->proven = false;
        lose_home(m); /* the drive may have been reset */
    } else if (axis->stage == UP && bitten) {
        axis->proven = true;
        axis->pending = false;
        axis->step = FRESH_CYCLES;
    } else if (axis->stage == UP && !axis->alarm &&
               ((errors & ~DOG) || (was_ready && !enabled(axis)))) {
        alarm(m, TROUBLE_ERROR, 0, errors, fault_of(errors));
        request(m, GET_ERROR);
    }
}

static void positioned(int m, float turns)
{
    if (axes[m].stage >= STARTING && fabsf(turns) < TURNS)
        placed(m, (int32_t)lrintf(turns * COUNTS));
}

static void answered(int m, const CanFrame *frame)
{
    Axis *axis = &axes[m];
    const uint8_t *data = frame->data;
    uint8_t message = frame->id & 31;
    if (1u << message & OF_MASTER)
        bus_trouble(TROUBLE_OTHER_MASTER);
    if (frame->size != 8)
        return;
    if (message == HEARTBEAT_OF)
        heartbeat(m, get_u32(data), data[4]);
    else if (message == GET_ESTIMATES)
        positioned(m, get_f32(data));
    else if (message == GET_ERROR && get_u32(data + 4))
        explain(m, TROUBLE_ERROR, get_u32(data) | get_u32(data + 4));
    else if (message == GET_VERSION && axis->stage == SILENT && axis->pending && data[0] == PROTOCOL)
        enter(axis, STARTING);
    else if (message == GET_VERSION && axis->stage == SILENT && axis->pending)
        lose(m, TROUBLE_WRONG_DRIVE, GET_VERSION, data[0]);
}

void take(const CanFrame *frame)
{
    for (int m = 0; m < MOTORS; m++)
        if (frame->id >> 5 == drives[m].node)
            answered(m, frame);
}

/* Sent frames */

static int16_t thousandths(float value)
{
    return (int16_t)lrintf(fmaxf(-32767, fminf(1e3f * value, 32767)));
}

static void set_position(int m)
{
    const Axis *axis = &axes[m];
    float turns_per_m = drives[m].sign * drives[m].counts_per_m / COUNTS;
    float force = force_of(limits, m, last_setpoint[2]);
    uint8_t data[8];
    put_f32(data, (float)axis->target / COUNTS);
    put_u16(data + 4, follows ? (uint16_t)thousandths(last_setpoint[1][m] * turns_per_m) : 0);
    put_u16(data + 6, follows ? (uint16_t)thousandths(force / (6.2831853f * turns_per_m)) : 0);
    send((uint16_t)(drives[m].node << 5 | SET_POSITION), data, 8);
}

/* Switch the current on for all four drives or for none. */
static void order(int m)
{
    Axis *axis = &axes[m];
    if (!requested || !all_up()) {
        axis->pending = axis->pending && axis->stage != UP;
        if (hurry || axis->status != IDLE)
            send_message(m, SET_STATE, IDLE, 0);
        axis->resets = axis->resets ? (uint16_t)(axis->resets - 1) : CLEAR_CYCLES;
        if (axis->stage == UP && in_fault(axis) && axis->resets == 0)
            send_message(m, CLEAR_ERRORS, 0, 0);
        axis->step = axis->stage == UP ? 0 : axis->step;
    } else if (!enabled(axis) && stands(axis) && axis->step-- == 0) {
        send_message(m, CLEAR_ERRORS, 0, 0);
        send_message(m, SET_MODE, POSITION_CONTROL, PASSTHROUGH);
        send_message(m, SET_STATE, CLOSED_LOOP, 0);
        axis->pending = true;
        axis->step = AGAIN_CYCLES;
    }
}

void cycle(void)
{
    for (int m = 0; m < MOTORS; m++) {
        Axis *axis = &axes[m];
        bool polled = axis->stage >= STARTING && !hurry && !tried(axis);
        /* the axis must not jump when it gets current */
        if (!enabled(axis) && stands(axis) && !(axis->pending && axis->step))
            axis->target = axis->actual;
        uint32_t step = (uint32_t)axis->target - (uint32_t)axis->sent;
        axis->reached = (int32_t)((uint32_t)axis->sent + (uint32_t)((int32_t)step / 2));
        axis->sent = axis->target;
        if (polled && axis->stage == UP)
            set_position(m);
        order(m);
        if (polled)
            request(m, GET_ESTIMATES);
        else
            axis->answers = 1; /* set to 1, so that no position counts as missed */
    }
}

void between(void)
{
    for (int m = 0; m < MOTORS; m++) {
        Axis *axis = &axes[m];
        if (axis->stage == UP) {
            if (tried(axis) && axis->since > START_TICKS + DOG_TICKS)
                lose(m, TROUBLE_NO_WATCHDOG, 0, 0);
        } else if (!axis->pending) {
            if (axis->stage == SILENT)
                request(m, GET_VERSION);
            axis->pending = true;
            axis->since = 0;
            axis->step++;
        }
    }
}
