/* The board: wiring, motors and sensors. Adapt it to your board. */
#ifndef PLATE_BOARD_H
#define PLATE_BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "../../table.h"
#include "registers.h"

/* Clock and serial line. The Makefile sets CRYSTAL_MHZ and BAUD. */
#ifndef CRYSTAL_MHZ
#define CRYSTAL_MHZ 8
#endif
#ifndef BAUD
#define BAUD 921600
#endif
#define TICK_HZ 1000u
#define TICK_PERIOD_S 1e-3f

/* Pin numbers in their port */
#define PIN_TX 9             /* PA9, USART1 */
#define PIN_RX 10            /* PA10 */
#define PIN_SENSOR 0         /* PA0 to PA3: sensors of motors 1 to 4, ADC1 channels 0 to 3 */
#define PIN_SUPPLY 4         /* PA4: the motors' supply through a divider, channel 4 */
#define PIN_BRIDGE_FAULT 6   /* PA6, TIM8's break: low is a fault; pulled up at the bridges */
#define PIN_ENABLE 10        /* PB10: high lets the bridges drive; pulled down at the bridges */
#define PIN_TRIGGER 1        /* PB1: the camera's trigger line; pulled down at the camera */
#define PIN_CAN_RX 8         /* PB8, PB9: CAN1, if the motors have drives. Then there are no bridges, */
#define PIN_CAN_TX 9         /* and PB10 is high while the board has no fault, for the drives' STO. */
#define PIN_DIRECTION 12     /* PB12 to PB15: high is positive force, motors 1 to 4 */
#define PIN_HOME 0           /* PC0 to PC3: high where motor 1 to 4 is beyond home, q > 0 */
#define PIN_PWM 6            /* PC6 to PC9, TIM8 */

/* Motors and bridges: voice coils; PWM sets their voltage */
#define PWM_HZ 20000u
#define DUTY_MOST 0.95f            /* maximum; the bridges' bootstraps need the rest of the supply */
#define MOTOR_NEWTON_PER_AMPERE 25.0f /* force constant, and back-EMF [V s/m] */
#define MOTOR_OHM 2.0f             /* resistance of winding, bridge and leads */
#define SUPPLY_LEAST_V 40.0f       /* supply outside this range for SUPPLY_TICKS: fault SUPPLY */
#define SUPPLY_MOST_V 56.0f
#define SUPPLY_TICKS 3
#define SUPPLY_V_PER_COUNT (3.3f / 4096.0f * 21.0f) /* divider 200 kOhm to 10 kOhm */

/* Sensors: 0.3 V to 3.0 V from end to end, so that a broken wire is detected */
#define SENSOR_M_PER_COUNT (0.024f / (2.7f / 3.3f * 4096.0f))
#define SENSOR_MIDDLE 2048.0f      /* counts assumed at home until home is found */
#define SENSOR_REACH_M 0.012f      /* in each direction */
#define SENSOR_LEAST 124u          /* 0.1 V; a reading outside these limits means a broken wire */
#define SENSOR_MOST 3972u          /* 3.2 V */
#define SENSOR_POLLS 2000          /* maximum polls for four conversions of 1.9 us: 20 times the usual number */
#define SENSOR_MEMORY 0.7f         /* the observer's three poles: 57 Hz at 1 kHz */

/* Force loop, of each motor */
#define STIFFNESS_N_PER_M 20000.0f
#define DAMPING_NS_PER_M 150.0f

/* Finding home: a hand can hold this speed and force */
#define HOMING_M_PER_S 0.010f
#define HOMING_N 10.0f

/* Watchdog: counts of the 32 kHz oscillator (17 to 47 kHz) divided by 4: about 10 ms */
#define WATCHDOG_COUNTS 80u

/* State and frequencies of the clock */
typedef struct {
    bool emulated; /* an emulator without clock unit and pins: pins report no faults */
    bool locked;   /* the PLL runs, or this is an emulator. Otherwise the motors stay off */
    uint32_t core_hz, line_hz, pwm_hz; /* of the core, USART1, TIM8 */
    uint32_t counts_per_us;            /* of TIM2 */
} Clock;

/* Statistics since the reset. Read them in a debugger: `print record`. */
#define TICK_BINS 1024
typedef struct {
    uint32_t ticks;
    uint32_t late;                /* number of ticks that ended after the next tick was due */
    uint32_t longest;             /* longest tick [counts of TIM2] */
    uint32_t by_us[TICK_BINS];    /* number of ticks for each duration [us]; the last bin: or longer */
    uint32_t setpoints;
    float step_m;                 /* largest step between the setpoints of two consecutive ticks */
    float most[3];                /* maxima over all motors' setpoints: travel [m], speed, acceleration */
    uint32_t received, overruns;  /* bytes received; overruns of the line */
    uint32_t dropped;             /* number of frames that did not fit into the send buffer */
} Record;

/* Memory that survives a reset, but not a power failure. */
typedef struct {
    uint32_t boots;
    uint32_t crashes, crash_pc; /* faults that ended in a watchdog reset; where the last was */
} Survivor;

extern Clock clock;
extern Record record;
extern volatile Survivor survivor;

/* Counts of TIM2. The counter wraps, so use only differences. */
static inline uint32_t counts(void) { return TIM2->CNT; }

void pin_mode(Gpio *port, unsigned pin, unsigned mode);
void pin_function(Gpio *port, unsigned pin, unsigned function);

void clock_start(void);
void usart_start(void);
void usart_drain(void); /* send waiting bytes while the line accepts them; called in the main loop */
void motors_start(const Limits *limits); /* with bridges only */
void motors_measure(void);               /* with bridges only, at the start of each tick */
void can_start(void);                    /* with drives only */

/* Cut the motors' current, whatever the processor does next. Needs no memory, and no clock except that
   of the pins. */
static inline void motors_cut(void)
{
    GPIOB->BSRR = BIT(PIN_ENABLE + 16);
    TIM8->BDTR = 0; /* clears the bit MOE; locked bits do not change */
}

#endif
