/* What the firmware needs of a board. Implement these; nothing else touches hardware. */
#ifndef PLATE_HAL_H
#define PLATE_HAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define MOTORS 4

/* Bytes that came and are not read yet: the board must hold at least this many, since a tick reads
   128 and obeys four packets, and a host may have 8 messages of 225 bytes on their way. */
#define HAL_INPUT_BYTES 2048

/* Time since start [us]; never runs back. */
uint64_t hal_time_us(void);

/* A number that differs after each reset: a counter in flash, or noise. */
uint32_t hal_boot(void);

/* Bytes that came, at most `size`; returns how many, at once. What is not taken stays. */
size_t hal_read(uint8_t *data, size_t size);

/* Bytes to send; those that do not fit into the board's buffer may be dropped. In a tick at most
   eight frames, of 71 bytes or less. */
void hal_write(const uint8_t *data, size_t size);

/* Whether all that was written is on its way: telemetry waits for that, so that answers need not. */
bool hal_idle(void);

/* Motor current on or off. Must work at any time. */
void hal_drive(bool on);

/* Whether the motors hold where they are, once current was switched on: called in each tick from
   then on until they do. The next hal_measure tells where that is. */
bool hal_ready(void);

/* Where the motors must be now: travel [m], speed [m/s], acceleration [m/s2]. */
void hal_command(const float position[MOTORS], const float velocity[MOTORS],
                 const float acceleration[MOTORS]);

/* Where they are: travel [m], acceleration [m/s2]. Read once, at a tick's beginning. */
void hal_measure(float position[MOTORS], float acceleration[MOTORS]);

/* One tick of finding home, with current on; true when it is found. The next hal_measure tells
   where the motors are from there. */
bool hal_home(void);

/* A person asks to forget where home is; current is off. */
void hal_forget(void);

/* The camera's trigger line, high or low. Called once in a tick, after hal_command. */
void hal_trigger(bool high);

/* Faults of the board, FAULT_SUPPLY, FAULT_HARDWARE or FAULT_FOLLOWING, for as long as they last;
   FAULT_NO_HOME where it has lost home: for a tick, or until hal_forget. Read once in a tick. */
uint8_t hal_faults(void);

/* What is wrong with a drive, in its own words. */
typedef struct {
    uint8_t motor;   /* 1 to 4; 0: the bus */
    uint8_t kind;    /* TROUBLE_ of message.h */
    uint16_t object; /* of its dictionary, or its error register */
    uint32_t code;   /* emergency, abort, statusword or value */
} Trouble;

/* The first trouble since current was switched on last; false: there is none. */
bool hal_trouble(Trouble *trouble);

/* The longest tick since the last call, as a share of a tick's period; 0 if that is not known. */
float hal_load(void);

/* Feed the independent watchdog: called at the end of each whole tick, and nowhere else. */
void hal_watchdog(void);

#endif
