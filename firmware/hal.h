/* What the firmware needs of a board. Implement these; nothing else touches hardware. */
#ifndef PLATE_HAL_H
#define PLATE_HAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define MOTORS 4

/* Time since start [us]; never runs back. */
uint64_t hal_time_us(void);

/* A number that differs after each reset: a counter in flash, or noise. */
uint32_t hal_boot(void);

/* Bytes that came, at most `size`; returns how many, at once. */
size_t hal_read(uint8_t *data, size_t size);

/* Bytes to send; those that do not fit into the board's buffer may be dropped. */
void hal_write(const uint8_t *data, size_t size);

/* Motor current on or off. Must work at any time. */
void hal_drive(bool on);

/* Where the motors must be now: travel [m], speed [m/s], acceleration [m/s2]. */
void hal_command(const float position[MOTORS], const float velocity[MOTORS],
                 const float acceleration[MOTORS]);

/* Where they are: travel [m], acceleration [m/s2]. */
void hal_measure(float position[MOTORS], float acceleration[MOTORS]);

/* One tick of finding home; true when it is found. */
bool hal_home(void);

/* FAULT_SUPPLY, FAULT_HARDWARE or 0. */
uint8_t hal_faults(void);

#endif
