/* Common part of the backends on a CAN bus. */
#include "axes.h"

#include <math.h>
#include <string.h>

#define READ_FRAMES 24 /* per tick; a bus with 1 Mbit/s carries 21 frames of minimum length */

Drive drives[MOTORS];
Axis axes[MOTORS];
float last_setpoint[3][MOTORS];
bool requested, was_ready, follows, hurry;
static bool home_known, home_lost;
const Limits *limits;
static uint8_t crooked; /* consecutive cycles with crooked positions */
static uint8_t phase; /* ticks since the last cycle */
static uint16_t bus_alarm;
static Trouble trouble;

/* Whether an axis has been up long enough for the detection of a second drive with its node number. */
static bool is_up(const Axis *axis) { return axis->stage == UP && axis->since >= START_TICKS; }

bool all_up(void)
{
    bool all = true;
    for (int m = 0; m < MOTORS; m++)
        all = all && is_up(&axes[m]);
    return all;
}

/* Whether a fault of the bus or a drive lasts. If so, later faults count as its consequences. */
static bool faulty(void)
{
    bool any = bus_alarm > 0;
    for (int m = 0; m < MOTORS; m++)
        any = any || axes[m].lost || axes[m].alarm;
    return any;
}

/* Keep the first fault of all drives. `is_first` is false if an earlier fault lasts, which has probably
   caused this one. An emergency replaces the fault that it explains, because it has more detail. */
static void note(uint8_t motor, uint8_t kind, uint16_t object, uint32_t code, bool is_first)
{
    bool explains = kind == TROUBLE_EMERGENCY && motor == trouble.motor &&
                    (trouble.kind == TROUBLE_FAULT || trouble.kind == TROUBLE_LEFT);
    if (trouble.kind == TROUBLE_NONE || is_first || explains)
        trouble = (Trouble){.motor = motor, .kind = kind, .object = object, .code = code};
}

void alarm(int m, uint8_t kind, uint16_t object, uint32_t code, uint8_t faults)
{
    bool is_first = !faulty();
    axes[m].alarm = BOOT_TICKS;
    axes[m].faults |= faults;
    axes[m].lost = true;
    note((uint8_t)(m + 1), kind, object, code, is_first);
}

void explain(int m, uint8_t kind, uint32_t code)
{
    if (trouble.motor == m + 1 && trouble.kind == kind)
        trouble.code = code;
}

void bus_trouble(uint8_t kind)
{
    bool is_first = !faulty();
    bus_alarm = BOOT_TICKS;
    note(0, kind, 0, 0, is_first);
}

void send(uint16_t id, const uint8_t *data, uint8_t size)
{
    CanFrame frame = {.id = id, .size = size};
    if (size)
        memcpy(frame.data, data, size);
    can_write(&frame);
}

void enter(Axis *axis, Stage stage)
{
    axis->stage = stage;
    axis->since = 0;
    axis->pending = false;
    axis->step = 0;
    axis->heartbeat_age = axis->missed = axis->doubled = axis->deviating = axis->answers = 0;
    if (stage != UP)
        axis->status = axis->still = 0;
}

/* Distance between two positions of a drive [m]. Counts are compared modulo 2^32. */
static float apart_m(int m, int32_t a, int32_t b)
{
    return fabsf((float)(int32_t)((uint32_t)a - (uint32_t)b)) / drives[m].counts_per_m;
}

/* Check that a drive with current is at its target, also before it follows setpoints. If its position leaps
   farther than a motor can move, the drive counts from another origin. */
static void watch(int m, bool leaps)
{
    Axis *axis = &axes[m];
    float off_m = apart_m(m, axis->actual, axis->reached);
    bool deviates = requested && enabled(axis) && limits->following_m > 0 && off_m > limits->following_m;
    axis->deviating = deviates ? (uint8_t)(axis->deviating + 1) : 0;
    axis->leapt = deviates && (leaps || axis->leapt);
    if (axis->deviating != DEVIATING_CYCLES)
        return;
    alarm(m, TROUBLE_ASTRAY, 0, (uint32_t)lrintf(1e6f * off_m), FAULT_FOLLOWING);
    if (axis->leapt)
        lose_home(m);
}

bool stands(const Axis *axis) { return axis->still == STILL_CYCLES; }

void placed(int m, int32_t actual)
{
    Axis *axis = &axes[m];
    if (axis->stage == STARTING && axis->answers == 0 && apart_m(m, actual, axis->actual) > STILL_M)
        lose_home(m);
    bool leaps = apart_m(m, actual, axis->actual) > limits->following_m;
    axis->actual = actual;
    axis->error = (int32_t)((uint32_t)actual - (uint32_t)axis->reached);
    watch(m, leaps);
    axis->answers = (uint8_t)(axis->answers + (axis->answers < 2));
    if (!axis->reported || apart_m(m, actual, axis->rest) > STILL_M) {
        axis->rest = actual;
        axis->still = 0;
    }
    axis->still = (uint8_t)(axis->still + (axis->still < STILL_CYCLES));
    if (!axis->reported)
        axis->target = actual;
    axis->reported = true;
}

void lose(int m, uint8_t kind, uint16_t object, uint32_t code)
{
    cut(m);
    alarm(m, kind, object, code, FAULT_HARDWARE);
    enter(&axes[m], SILENT);
    axes[m].pending = true;
}

void lose_home(int m)
{
    if (drives[m].absolute || !home_known)
        return;
    home_lost = true;
    home_known = false;
}

/* Check the number of positions that a drive has sent since the last request. */
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

/* Distance of a motor from its setpoint or, without setpoints, from home [m]. If the motor
   only holds its position, it is assumed to be at its target. */
static float off_m(int m)
{
    const Axis *axis = &axes[m];
    int32_t held = enabled(axis) ? axis->target : axis->actual;
    int32_t place = (int32_t)((uint32_t)held - (uint32_t)axis->home);
    return (float)(follows ? axis->error : place) * drives[m].sign / drives[m].counts_per_m;
}

/* Whether the reported positions do not fit a rigid plate. Then one drive has lost counts, or two drives
   are swapped. */
static bool is_crooked(void)
{
    float sum = 0;
    for (int m = 0; m < MOTORS; m++)
        sum += drives[m].weight * off_m(m);
    return limits->following_m > 0 && fabsf(sum) > limits->following_m;
}

static void compare(void)
{
    crooked = home_known && all_up() && is_crooked() ? (uint8_t)(crooked + 1) : 0;
    if (crooked < CROOKED_CYCLES)
        return;
    crooked = 0;
    bus_trouble(TROUBLE_CROOKED);
    for (int m = 0; m < MOTORS; m++)
        lose_home(m);
}

/* Stages of an axis */
static void age(int m)
{
    Axis *axis = &axes[m];
    axis->since = (uint16_t)(axis->since + (axis->since <= BOOT_TICKS));
    axis->heartbeat_age = (uint16_t)(axis->heartbeat_age + (axis->heartbeat_age <= SILENT_TICKS));
    if (axis->alarm && !in_fault(axis) && --axis->alarm == 0)
        axis->faults = 0;
    axis->lost = axis->lost && !is_up(axis);
    if (axis->stage == SILENT && axis->since >= BOOT_TICKS) {
        if (axis->step) /* the drive has not replied, so it may have no power */
            lose_home(m);
        alarm(m, TROUBLE_SILENT, 0, 0, FAULT_HARDWARE);
        enter(axis, SILENT);
    } else if (axis->stage == SETUP && axis->pending && axis->since > ANSWER_TICKS)
        lose(m, TROUBLE_SILENT, 0, 0);
    else if (axis->stage == STARTING && axis->since > START_TICKS) {
        axis->pending = false;
        if (axis->step == STARTS)
            lose(m, TROUBLE_SILENT, 0, 0);
    } else if (axis->stage == UP && axis->heartbeat_age > SILENT_TICKS)
        lose(m, TROUBLE_SILENT, 0, 0);
    axis->keeps = requested || !enabled(axis) ? 0 : (uint16_t)(axis->keeps + 1);
    if (axis->keeps > KEEPS_TICKS) {
        lose(m, TROUBLE_KEEPS, 0, axis->status);
        axis->keeps = 0;
        break_off(m);
    }
}

void drives_begin(void)
{
    CanFrame frame;
    if (can_off()) {
        bus_trouble(TROUBLE_BUS_OFF);
        for (int m = 0; m < MOTORS; m++) {
            enter(&axes[m], SILENT);
            axes[m].pending = axes[m].lost = true;
        }
    }
    for (int n = 0; n < READ_FRAMES && can_read(&frame); n++)
        take(&frame);
    bus_alarm = (uint16_t)(bus_alarm - (bus_alarm > 0));
    for (int m = 0; m < MOTORS; m++)
        age(m);
}

void drives_end(void)
{
    if (++phase < CYCLE_TICKS && !hurry) {
        between();
        return;
    }
    phase = 0;
    for (int m = 0; m < MOTORS; m++)
        if (axes[m].stage == UP && !hurry)
            count_answers(m);
    compare();
    cycle();
    if (hurry) /* the next tick may also run a cycle, so send the other frames now */
        between();
    hurry = false;
}

void drives_start(const Drive of[MOTORS], const Limits *its_limits)
{
    memcpy(drives, of, sizeof drives);
    memset(axes, 0, sizeof axes);
    memset(&trouble, 0, sizeof trouble);
    limits = its_limits;
    requested = was_ready = follows = hurry = home_known = home_lost = false;
    phase = crooked = 0;
    bus_alarm = 0;
}

/* Orders of the controller */

void hal_drive(bool on)
{
    for (int m = 0; m < MOTORS && requested && !on && !was_ready; m++)
        if (!enabled(&axes[m]))
            note((uint8_t)(m + 1), TROUBLE_NOT_ENABLED, 0, axes[m].status, false);
    if (on)
        memset(&trouble, 0, sizeof trouble);
    hurry = !on; /* the frames are sent at the end of this tick */
    requested = on;
    was_ready = follows = false;
}

bool hal_ready(void)
{
    bool all = requested && all_up();
    for (int m = 0; m < MOTORS; m++)
        all = all && enabled(&axes[m]) && axes[m].proven;
    was_ready = was_ready || all;
    return all;
}

bool hal_home(void)
{
    for (int m = 0; m < MOTORS; m++) {
        int32_t home = drives[m].absolute ? 0 : axes[m].target;
        float most = fabsf((float)home) + 1.01f * limits->stroke_m * drives[m].counts_per_m;
        if (most > 0x1p31f - 512) { /* margin for rounding */
            alarm(m, TROUBLE_RANGE, 0, (uint32_t)home, FAULT_HARDWARE);
            return false;
        }
        axes[m].home = home;
    }
    home_known = !is_crooked();
    if (!home_known)
        bus_trouble(TROUBLE_CROOKED);
    return home_known;
}

void hal_forget(void) { home_known = home_lost = false; }

void hal_command(const float position[MOTORS], const float velocity[MOTORS],
                 const float acceleration[MOTORS])
{
    for (int m = 0; m < MOTORS; m++) {
        float counts = position[m] * drives[m].counts_per_m * drives[m].sign;
        axes[m].target = (int32_t)((uint32_t)axes[m].home + (uint32_t)lrintf(counts));
    }
    memcpy(last_setpoint[0], position, sizeof last_setpoint[0]);
    memcpy(last_setpoint[1], velocity, sizeof last_setpoint[1]);
    memcpy(last_setpoint[2], acceleration, sizeof last_setpoint[2]);
    follows = true;
}

/* Positions arrive with the bus's delay. While a motor follows setpoints, return its current setpoint
   plus the following error of its last position. The drives report no acceleration. */
void hal_measure(float position[MOTORS], float acceleration[MOTORS])
{
    for (int m = 0; m < MOTORS; m++) {
        position[m] = (follows ? last_setpoint[0][m] : 0) + off_m(m);
        acceleration[m] = 0;
    }
}

uint8_t hal_faults(void)
{
    uint8_t faults = home_lost ? FAULT_NO_HOME : 0;
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
    if (home_lost && !faulty())
        *out = (Trouble){.kind = TROUBLE_HOME_LOST};
    return out->kind != TROUBLE_NONE;
}
