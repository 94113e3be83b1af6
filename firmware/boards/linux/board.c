/* A Linux computer as the board. A kernel timer gives the ticks, SocketCAN is the drives' bus, and stdin
   and stdout are the line to the host. It is built with limits_rig.h, which is made from the rig file.

     plate CAN [TICKS]

   CAN is a file descriptor that carries a struct can_frame in each datagram. TICKS is a file descriptor
   from which the program reads the number of ticks that have passed (eight bytes). Default: a timerfd.
   The program ends when its input has ended and the motors are off, or when the CAN interface is lost
   or down. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

#include "../../controller.h"
#include "../../drives/can.h"
#include "../../drives/drives.h"
#include "../../message.h"
#include "limits_rig.h"

#define TICK_NS 1000000
#define PRIORITY 50       /* real-time priority (SCHED_FIFO), if the system permits it */
#define LAST_TICKS 200u   /* ticks without current after the input has ended: time to stop a drive
                             that keeps its current */
#define OLD_TICKS 250u    /* if a tick is later than this, discard the input that has arrived */

static int can, ticks;
static uint64_t now_us;
static uint32_t boot;
static float late; /* [ticks] */
static bool ended, off, lost, written = true;

uint64_t hal_time_us(void) { return now_us; }
uint32_t hal_boot(void) { return boot; }
bool hal_idle(void) { return written; }
void hal_watchdog(void) {}
void hal_trigger(bool high) { (void)high; } /* this board has no trigger line */

size_t hal_read(uint8_t *data, size_t size)
{
    ssize_t count = read(STDIN_FILENO, data, size);
    ended = ended || count == 0;
    return count > 0 ? (size_t)count : 0;
}

void hal_write(const uint8_t *data, size_t size)
{
    written = write(STDOUT_FILENO, data, size) == (ssize_t)size; /* a frame is sent completely or not at all */
}

/* Maximum delay of a tick since the last call [ticks]. */
float hal_load(void)
{
    float most = late;
    late = 0;
    return most;
}

/* Check the result of reading or writing a frame for a lost interface. Without an interface the process
   ends, so that the host reports this and waits for the interface. */
static void check_interface(ssize_t size)
{
    lost = lost || size == 0 || (size < 0 && errno != EAGAIN && errno != EINTR && errno != ENOBUFS);
}

bool can_read(CanFrame *frame)
{
    struct can_frame received;
    ssize_t size;
    while ((size = read(can, &received, sizeof received)) == sizeof received) {
        if (received.can_id & CAN_ERR_FLAG) {
            off = off || received.can_id & CAN_ERR_BUSOFF;
        } else if (!(received.can_id & (CAN_EFF_FLAG | CAN_RTR_FLAG)) && received.can_dlc <= 8) {
            frame->id = (uint16_t)received.can_id;
            frame->size = received.can_dlc;
            memcpy(frame->data, received.data, sizeof frame->data);
            return true;
        }
    }
    check_interface(size);
    return false;
}

void can_write(const CanFrame *frame)
{
    struct can_frame out = {.can_id = frame->id & CAN_SFF_MASK, .can_dlc = frame->size};
    if (frame->id & CAN_REMOTE)
        out.can_id |= CAN_RTR_FLAG;
    memcpy(out.data, frame->data, sizeof out.data);
    check_interface(write(can, &out, sizeof out)); /* a frame that does not fit into the buffer is dropped */
}

bool can_off(void)
{
    bool was = off;
    off = false;
    return was;
}

/* Wait for the next tick. Return false if there are no more ticks. */
static bool tick_passed(void)
{
    struct itimerspec left = {.it_value = {0, TICK_NS}};
    uint64_t passed;
    if (read(ticks, &passed, sizeof passed) != sizeof passed)
        return false;
    timerfd_gettime(ticks, &left); /* with a timer: time until the next tick */
    float own = (float)passed - (float)left.it_value.tv_nsec / TICK_NS;
    late = own > late ? own : late;
    now_us += passed * (TICK_NS / 1000);
    for (uint8_t old[4096]; passed > OLD_TICKS && read(STDIN_FILENO, old, sizeof old) > 0;) {
    } /* discard old input, because an old Enable would be dangerous */
    return true;
}

int main(int argc, char **argv)
{
    static Controller controller;
    const struct itimerspec each = {{0, TICK_NS}, {0, TICK_NS}};
    const struct sched_param urgent = {.sched_priority = PRIORITY};
    const can_err_mask_t errors = CAN_ERR_BUSOFF;
    unsigned rests = 0;
    if (argc < 2)
        return 2;
    can = atoi(argv[1]);
    setsockopt(can, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors);
    ticks = argc > 2 ? atoi(argv[2]) : timerfd_create(CLOCK_MONOTONIC, 0);
    if (argc < 3 && timerfd_settime(ticks, 0, &each, NULL))
        return 1;
    for (int k = 0; k < 3; k++)
        fcntl((const int[]){STDIN_FILENO, STDOUT_FILENO, can}[k], F_SETFL, O_NONBLOCK);
    for (int k = 0; k < 4; k++) /* only the end of the input ends the program */
        signal((const int[]){SIGPIPE, SIGINT, SIGTERM, SIGHUP}[k], SIG_IGN);
    mlockall(MCL_CURRENT); /* this call and the next call have no effect if the system forbids them */
    sched_setscheduler(0, SCHED_FIFO, &urgent);
    boot = (uint32_t)time(NULL) ^ (uint32_t)getpid() << 16;
    drives_start(DRIVES, &LIMITS);
    controller_start(&controller, LIMITS);
    while (rests < LAST_TICKS && !lost && tick_passed()) {
        drives_begin();
        controller_tick(&controller);
        drives_end();
        rests = ended && controller.state == STATE_OFF ? rests + 1 : 0;
    }
    return rests < LAST_TICKS;
}
