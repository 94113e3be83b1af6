/* Interface to the board. The rest of the firmware does not access hardware. */
#ifndef PLATE_HAL_H
#define PLATE_HAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define MOTORS 4

/* Minimum size of the board's buffer for received bytes. A tick reads 128 bytes and executes four
   packets, and a host may send 8 messages of 225 bytes in advance. */
#define HAL_INPUT_BYTES 2048

/* Time since start [us]; it never decreases. */
uint64_t hal_time_us(void);

/* A number that is different after each reset, such as a counter in flash or noise. */
uint32_t hal_boot(void);

/* Copy up to `size` received bytes without waiting. Return their number. Other bytes stay. */
size_t hal_read(uint8_t *data, size_t size);

/* Send bytes. Bytes that do not fit into the board's buffer may be dropped. One tick sends at most eight
   frames of up to 71 bytes. */
void hal_write(const uint8_t *data, size_t size);

/* Whether all written bytes have been sent. Telemetry waits for this, so that replies need not wait. */
bool hal_idle(void);

/* Switch the motor current on or off. This must work at any time. */
void hal_drive(bool on);

/* Whether the motors hold their position after current was switched on. Called in each tick until it is
   true. The next hal_measure returns this position. */
bool hal_ready(void);

/* Setpoint of the motors: travel [m], speed [m/s], acceleration [m/s2]. */
void hal_command(const float position[MOTORS], const float velocity[MOTORS],
                 const float acceleration[MOTORS]);

/* Measured travel [m] and acceleration [m/s2]. Called once, at the start of a tick. */
void hal_measure(float position[MOTORS], float acceleration[MOTORS]);

/* One tick of the search for home, with current on. True when home is found; the next hal_measure is
   then relative to home. */
bool hal_home(void);

/* Forget the home position, on a user's request. The current is off. */
void hal_forget(void);

/* Set the camera's trigger line. Called once per tick, after hal_command. */
void hal_trigger(bool high);

/* Present faults of the board: FAULT_SUPPLY, FAULT_HARDWARE or FAULT_FOLLOWING while they last.
   FAULT_NO_HOME if it has lost home, for one tick or until hal_forget. Called once per tick. */
uint8_t hal_faults(void);

/* Fault of a drive, with the drive's own codes. */
typedef struct {
    uint8_t motor;   /* 1 to 4; 0: the bus */
    uint8_t kind;    /* TROUBLE_ of message.h */
    uint16_t object; /* object of the drive's dictionary, or the drive's error register */
    uint32_t code;   /* code of emergency or abort, statusword, or value */
} Trouble;

/* First fault of a drive since the current was last switched on. Return false if there is none. */
bool hal_trouble(Trouble *trouble);

/* Maximum duration of a tick since the last call, as a fraction of its period. 0 if unknown. */
float hal_load(void);

/* Feed the independent watchdog. Called only at the end of each complete tick. */
void hal_watchdog(void);

#endif
