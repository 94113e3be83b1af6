/* Four voice coils on H-bridges and four position sensors: PWM, force loop, home search, faults. */
#include <math.h>
#include <string.h>

#include "../../hal.h"
#include "../../message.h"
#include "board.h"

#define PERIOD_COUNTS (clock.pwm_hz / PWM_HZ)
#define BDTR_OFF (BDTR_LOCK_1 | BDTR_OSSI | BDTR_BKE)

static const Limits *limits;

/* State of a motor, estimated by an observer from the sensor: travel [m], speed [m/s], acceleration
   [m/s2]. `home` is the sensor's reading at home [m from its middle]. */
typedef struct {
    float position, velocity, acceleration, home;
} Seen;

static Seen seen[MOTORS];
static float supply; /* [V] */
static int supply_bad;    /* consecutive ticks with a wrong supply */
static bool sensors_lost, sensors_met, driving;

/* Home search of each motor: its setpoint [m], and whether its flag's edge was found. */
static struct {
    bool begun, found[MOTORS];
    bool beyond[MOTORS]; /* side of home on which the search began */
    float setpoint[MOTORS];
} search;

/* Convert all sensors to counts: 8 us per tick. Return false if it takes more than SENSOR_POLLS polls. */
static bool convert(uint32_t raw[MOTORS])
{
    ADC1->SR = ~ADC_JEOC;
    ADC1->CR2 |= ADC_JSWSTART;
    /* QEMU's converter never reports completion. */
    for (int polls = 0; !clock.emulated && !(ADC1->SR & ADC_JEOC); polls++)
        if (polls == SENSOR_POLLS)
            return false;
    for (int m = 0; m < MOTORS; m++)
        raw[m] = ADC1->JDR[m];
    return true;
}

static float travel(uint32_t raw) { return ((float)raw - SENSOR_MIDDLE) * SENSOR_M_PER_COUNT; }

/* Second-order fading-memory filter (Brookner 1998, 1.3.2) with three poles at r. Speed and
   acceleration need no differences of raw counts. */
static void observe(Seen *s, float measured)
{
    const float r = SENSOR_MEMORY, left = 1 - r;
    float speed = s->velocity, accel = s->acceleration;
    float ahead = s->position + TICK_PERIOD_S * (speed + TICK_PERIOD_S / 2 * accel);
    float miss = measured - ahead;
    s->position = ahead + (1 - r * r * r) * miss;
    s->velocity = speed + TICK_PERIOD_S * accel + 1.5f * left * left * (1 + r) / TICK_PERIOD_S * miss;
    s->acceleration = accel + left * left * left / (TICK_PERIOD_S * TICK_PERIOD_S) * miss;
}

void motors_measure(void)
{
    uint32_t raw[MOTORS];
    bool whole = convert(raw);
    for (int m = 0; m < MOTORS && whole; m++)
        whole = clock.emulated || (raw[m] >= SENSOR_LEAST && raw[m] <= SENSOR_MOST);
    sensors_lost = !whole;
    for (int m = 0; m < MOTORS && whole; m++) {
        if (sensors_met)
            observe(&seen[m], travel(raw[m]) - seen[m].home);
        else
            seen[m] = (Seen){.position = travel(raw[m])};
    }
    sensors_met = sensors_met || whole;
    supply = (float)ADC1->DR * SUPPLY_V_PER_COUNT;
    bool good = supply >= SUPPLY_LEAST_V && supply <= SUPPLY_MOST_V;
    supply_bad = good || clock.emulated ? 0 : supply_bad + (supply_bad < SUPPLY_TICKS);
}

/* Apply a force [N]: set the voltage that drives its current against resistance and back-EMF. */
static void push(int motor, float force)
{
    float volts = MOTOR_OHM / MOTOR_NEWTON_PER_AMPERE * force +
                  MOTOR_NEWTON_PER_AMPERE * seen[motor].velocity;
    float duty = fabsf(volts) / fmaxf(supply, SUPPLY_LEAST_V);
    unsigned pin = PIN_DIRECTION + (unsigned)motor;
    if (!(duty <= DUTY_MOST)) /* also catches NaN */
        duty = duty > DUTY_MOST ? DUTY_MOST : 0;
    GPIOB->BSRR = BIT(volts < 0 ? pin + 16 : pin);
    TIM8->CCR[motor] = (uint32_t)(duty * (float)PERIOD_COUNTS);
}

static float clamped(float force, float most) { return fmaxf(fminf(force, most), -most); }

/* Move a motor towards its setpoint; `most` is the maximum force [N]. */
static void pull(int m, float position, float velocity, float ahead, float most)
{
    float force = ahead + STIFFNESS_N_PER_M * (position - seen[m].position) +
                  DAMPING_NS_PER_M * (velocity - seen[m].velocity);
    push(m, driving ? clamped(force, most) : 0);
}

static void keep(const float position[MOTORS], const float velocity[MOTORS],
                 const float acceleration[MOTORS])
{
    static float last[MOTORS];
    static uint32_t last_tick;
    const float *all[3] = {position, velocity, acceleration};
    for (int m = 0; m < MOTORS; m++) {
        if (record.ticks - last_tick == 1)
            record.step_m = fmaxf(record.step_m, fabsf(position[m] - last[m]));
        for (int k = 0; k < 3; k++)
            record.most[k] = fmaxf(record.most[k], fabsf(all[k][m]));
        last[m] = position[m];
    }
    last_tick = record.ticks;
    record.setpoints++;
}

void hal_command(const float position[MOTORS], const float velocity[MOTORS],
                 const float acceleration[MOTORS])
{
    for (int m = 0; m < MOTORS; m++) {
        float ahead = 0;
        for (int k = 0; k < MOTORS; k++)
            ahead += limits->load[m][k] * acceleration[k];
        pull(m, position[m], velocity[m], ahead, limits->force);
    }
    keep(position, velocity, acceleration);
}

void hal_measure(float position[MOTORS], float acceleration[MOTORS])
{
    for (int m = 0; m < MOTORS; m++) {
        position[m] = seen[m].position;
        acceleration[m] = seen[m].acceleration;
    }
}

void hal_drive(bool on)
{
    motors_cut();
    driving = search.begun = false;
    for (int m = 0; m < MOTORS; m++)
        TIM8->CCR[m] = 0;
    if (!on)
        return;
    TIM8->SR = ~TIM_BIF;
    TIM8->BDTR = BDTR_OFF | BDTR_MOE; /* this line has no effect while the bridges report a fault */
    GPIOB->BSRR = BIT(PIN_ENABLE);
    driving = true;
}

bool hal_ready(void) { return true; }

/* Bridges report no trouble in detail. */
bool hal_trouble(Trouble *trouble)
{
    (void)trouble;
    return false;
}

/* Whether a motor is beyond home. */
static bool beyond(int motor) { return GPIOC->IDR >> (PIN_HOME + motor) & 1; }

static void search_begin(void)
{
    memset(&search, 0, sizeof search);
    search.begun = true;
    for (int m = 0; m < MOTORS; m++) {
        search.beyond[m] = beyond(m);
        search.setpoint[m] = seen[m].position;
    }
}

/* Each motor creeps to the edge of its home flag and waits there for the others. A motor that finds no
   edge within twice the sensor's reach stops, and the controller's home search times out. */
bool hal_home(void)
{
    bool found = true;
    if (!search.begun)
        search_begin();
    for (int m = 0; m < MOTORS; m++) {
        float way = search.beyond[m] ? -HOMING_M_PER_S : HOMING_M_PER_S;
        search.found[m] = search.found[m] || clock.emulated || beyond(m) != search.beyond[m];
        if (search.found[m])
            way = 0;
        search.setpoint[m] = clamped(search.setpoint[m] + way * TICK_PERIOD_S, 2 * SENSOR_REACH_M);
        pull(m, search.setpoint[m], way, 0, HOMING_N);
        found = found && search.found[m];
    }
    if (!found)
        return false;
    for (int m = 0; m < MOTORS; m++) {
        seen[m].home += seen[m].position;
        seen[m].position = 0;
    }
    search.begun = false;
    return true;
}

void hal_forget(void) {} /* the next enable searches for home */

uint8_t hal_faults(void)
{
    uint8_t faults = supply_bad >= SUPPLY_TICKS ? FAULT_SUPPLY : 0;
    bool bridges = !clock.emulated && !(GPIOA->IDR & BIT(PIN_BRIDGE_FAULT));
    bool broken = driving && !clock.emulated && TIM8->SR & TIM_BIF; /* latched, so also a short fault */
    if (!clock.locked || sensors_lost || bridges || broken || limits->stroke_m > SENSOR_REACH_M)
        faults |= FAULT_HARDWARE;
    return faults;
}

static void bridges_start(void)
{
    RCC_APB2ENR |= APB2_TIM8;
    motors_cut();
    pin_mode(GPIOB, PIN_ENABLE, 1);
    GPIOA->PUPDR |= 2u << 2 * PIN_BRIDGE_FAULT; /* pull-down: a broken wire is a fault */
    pin_function(GPIOA, PIN_BRIDGE_FAULT, 3);
    for (unsigned m = 0; m < MOTORS; m++) {
        pin_mode(GPIOB, PIN_DIRECTION + m, 1);
        pin_function(GPIOC, PIN_PWM + m, 3);
        GPIOC->PUPDR |= 2u << 2 * (PIN_HOME + m);
        TIM8->CCR[m] = 0;
    }
    TIM8->ARR = PERIOD_COUNTS - 1;
    TIM8->CCMR1 = TIM8->CCMR2 = CCMR_PWM_BOTH;
    TIM8->CCER = CCER_ALL;
    TIM8->EGR = TIM_UG;
    TIM8->BDTR = BDTR_OFF;
    TIM8->CR1 = TIM_CEN | TIM_ARPE;
}

static void sensors_start(void)
{
    RCC_APB2ENR |= APB2_ADC1;
    for (unsigned pin = PIN_SENSOR; pin < PIN_SENSOR + MOTORS; pin++)
        pin_mode(GPIOA, pin, 3);
    pin_mode(GPIOA, PIN_SUPPLY, 3);
    ADC_CCR = ADC_CCR_BY_4; /* 21 MHz */
    ADC1->CR1 = ADC_SCAN;
    /* 28 cycles for the sensors, 480 for the supply with its slow divider. */
    ADC1->SMPR2 = 2u | 2u << 3 | 2u << 6 | 2u << 9 | 7u << 3 * PIN_SUPPLY;
    ADC1->JSQR = 3u << 20 | 0u | 1u << 5 | 2u << 10 | 3u << 15; /* four conversions, channels 0 to 3 */
    ADC1->SQR3 = PIN_SUPPLY;
    ADC1->CR2 = ADC_ADON | ADC_CONT;
    for (uint32_t begun = counts(); counts() - begun < 3 * clock.counts_per_us;) { /* wake-up time */
    }
    ADC1->CR2 |= ADC_SWSTART; /* converts the supply continuously; the sensors have priority */
}

void motors_start(const Limits *of)
{
    limits = of;
    bridges_start();
    sensors_start();
}
