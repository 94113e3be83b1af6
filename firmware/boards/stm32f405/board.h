/* The board: what is wired where, and what its motors and sensors are. Change it for yours. */
#ifndef PLATE_BOARD_H
#define PLATE_BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "../../table.h"
#include "registers.h"

/* Clock and line. The Makefile's CRYSTAL_MHZ and BAUD. */
#ifndef CRYSTAL_MHZ
#define CRYSTAL_MHZ 8
#endif
#ifndef BAUD
#define BAUD 921600
#endif
#define TICK_HZ 1000u
#define TICK_PERIOD_S 1e-3f

/* Pins, as numbers of their port */
#define PIN_TX 9             /* PA9, USART1 */
#define PIN_RX 10            /* PA10 */
#define PIN_SENSOR 0         /* PA0 to PA3: sensors of motors 1 to 4, ADC1 channels 0 to 3 */
#define PIN_SUPPLY 4         /* PA4: the motors' supply by a divider, channel 4 */
#define PIN_BRIDGE_FAULT 6   /* PA6, TIM8's break: low is a fault; pulled up at the bridges */
#define PIN_ENABLE 10        /* PB10: high lets the bridges drive; pulled down at the bridges */
#define PIN_TRIGGER 1        /* PB1: the camera's trigger line; pulled down at the camera */
#define PIN_CAN_RX 8         /* PB8, PB9: CAN1, where motors have drives; then there are no bridges, */
#define PIN_CAN_TX 9         /* and PB10 is high while the board is sound: for the drives' STO */
#define PIN_DIRECTION 12     /* PB12 to PB15: high is positive force, motors 1 to 4 */
#define PIN_HOME 0           /* PC0 to PC3: high where motor 1 to 4 is beyond home, q > 0 */
#define PIN_PWM 6            /* PC6 to PC9, TIM8 */

/* Motors and bridges: voice coils, PWM sets their voltage */
#define PWM_HZ 20000u
#define DUTY_MOST 0.95f            /* share of the supply: the bridges' bootstraps need the rest */
#define MOTOR_NEWTON_PER_AMPERE 25.0f /* force constant; [V s/m] of the back-EMF, too */
#define MOTOR_OHM 2.0f             /* winding, bridge and leads */
#define SUPPLY_LEAST_V 40.0f       /* less, or more, for SUPPLY_TICKS: fault SUPPLY */
#define SUPPLY_MOST_V 56.0f
#define SUPPLY_TICKS 3
#define SUPPLY_V_PER_COUNT (3.3f / 4096.0f * 21.0f) /* divider 200 kOhm to 10 kOhm */

/* Sensors: 0.3 V to 3.0 V from end to end, so that a broken wire is seen */
#define SENSOR_M_PER_COUNT (0.024f / (2.7f / 3.3f * 4096.0f))
#define SENSOR_MIDDLE 2048.0f      /* counts at home, until home is found */
#define SENSOR_REACH_M 0.012f      /* to either side */
#define SENSOR_LEAST 124u          /* 0.1 V: beyond it a wire is broken */
#define SENSOR_MOST 3972u          /* 3.2 V */
#define SENSOR_POLLS 2000          /* for four conversions of 1.9 us: 20 times what they need */
#define SENSOR_MEMORY 0.7f         /* of the observer's three poles: 57 Hz at 1 kHz */

/* Force loop, of each motor */
#define STIFFNESS_N_PER_M 20000.0f
#define DAMPING_NS_PER_M 150.0f

/* Finding home: no faster and no harder than a hand can hold */
#define HOMING_M_PER_S 0.010f
#define HOMING_N 10.0f

/* Watchdog: counts of the 32 kHz oscillator (17 to 47 kHz) by 4: about 10 ms */
#define WATCHDOG_COUNTS 80u

/* What the clock is */
typedef struct {
    bool emulated; /* there is no clock unit: no pins either, so none reports a fault */
    bool locked;   /* the PLL runs, or this is an emulator; otherwise motors stay off */
    uint32_t core_hz, line_hz, pwm_hz; /* of the core, USART1, TIM8 */
    uint32_t counts_per_us;            /* of TIM2 */
} Clock;

/* What the board has seen since its reset: look at it with a debugger, `print record`. */
#define TICK_BINS 1024
typedef struct {
    uint32_t ticks;
    uint32_t late;                /* ticks that lasted into the next one's time */
    uint32_t longest;             /* tick [counts of TIM2] */
    uint32_t by_us[TICK_BINS];    /* how many ticks took so many us; the last one: or more */
    uint32_t setpoints;
    float step_m;                 /* longest step between two setpoints, a tick apart */
    float most[3];                /* of all motors' setpoints: travel [m], speed, acceleration */
    uint32_t received, overruns;  /* bytes that came; times that the line ran over */
    uint32_t dropped;             /* frames that did not fit into what is to be sent */
} Record;

/* What outlives a reset, and not the supply. */
typedef struct {
    uint32_t boots;
    uint32_t crashes, crash_pc; /* faults that ended in the watchdog, and where the last one was */
} Survivor;

extern Clock clock;
extern Record record;
extern volatile Survivor survivor;

/* Counts of TIM2: wraps, so only differences count. */
static inline uint32_t counts(void) { return TIM2->CNT; }

void pin_mode(Gpio *port, unsigned pin, unsigned mode);
void pin_function(Gpio *port, unsigned pin, unsigned function);

void clock_start(void);
void usart_start(void);
void usart_drain(void); /* what is to be sent, as far as the line takes it; from the main loop */
void motors_start(const Limits *limits); /* bridges: */
void motors_measure(void);               /* at the start of each tick */
void can_start(void);                    /* drives */

/* No current, whatever the processor does next. Needs no memory and no clock but the pins'. */
static inline void motors_cut(void)
{
    GPIOB->BSRR = BIT(PIN_ENABLE + 16);
    TIM8->BDTR = 0; /* locked bits stay as they are; MOE goes */
}

#endif
