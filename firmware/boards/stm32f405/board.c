/* The controller on an STM32F405: a tick every ms, the serial line between ticks, and a watchdog that
   monitors both. */
#include "../../controller.h"

#include "../../drives/drives.h"
#include "board.h"
#include "limits_rig.h"

#if defined CIA402 != defined HAS_CIA402 || defined ODRIVE != defined HAS_ODRIVE
#error "DRIVES of make and `drive` of the rig file differ"
#endif

Record record;

static Controller controller;
static uint32_t boot, tick_began, longest; /* [counts]; longest tick since hal_load was called */

void tick(void);
void idle(void);

void pin_mode(Gpio *port, unsigned pin, unsigned mode)
{
    port->MODER = (port->MODER & ~(3u << 2 * pin)) | mode << 2 * pin;
}

void pin_function(Gpio *port, unsigned pin, unsigned function)
{
    volatile uint32_t *half = &port->AFR[pin / 8];
    unsigned shift = 4 * (pin % 8);
    *half = (*half & ~(15u << shift)) | function << shift;
    pin_mode(port, pin, 2);
}

/* Called only in the tick, and more often than TIM2 wraps (every 51 s, every 4 s in QEMU). */
uint64_t hal_time_us(void)
{
    static uint64_t us;
    static uint32_t counted;
    uint32_t passed = (counts() - counted) / clock.counts_per_us;
    counted += passed * clock.counts_per_us;
    us += passed;
    return us;
}

uint32_t hal_boot(void) { return boot; }

/* Hash of `value` (the finaliser of MurmurHash3). It is bijective: different values give different
   numbers. */
static uint32_t mixed(uint32_t value)
{
    value = (value ^ value >> 16) * 0x85EBCA6Bu;
    value = (value ^ value >> 13) * 0xC2B2AE35u;
    return value ^ value >> 16;
}

/* The boot count survives a reset. After a power failure the memory is undefined, so the chip's
   unique id and random noise are mixed in. */
static uint32_t boot_number(void)
{
    uint32_t own = 0;
    if (!clock.emulated) {
        own = mixed(UNIQUE_ID(0)) ^ mixed(UNIQUE_ID(1) + 1) ^ mixed(UNIQUE_ID(2) + 2);
        RCC_AHB2ENR |= AHB2_RNG;
        RNG_CR = RNG_ENABLE;
        for (int polls = 0; polls < 1000 && !(RNG_SR & RNG_READY); polls++) {
        }
        own ^= mixed(RNG_DR);
    }
    survivor.boots++;
    return mixed(survivor.boots ^ own);
}

static void watchdog_start(void)
{
    IWDG_KR = IWDG_START;
    IWDG_KR = IWDG_UNLOCK;
    IWDG_PR = 0;
    IWDG_RLR = WATCHDOG_COUNTS;
    for (int polls = 0; polls < 100000 && IWDG_SR; polls++) { /* takes 5 counts of its oscillator */
    }
    IWDG_KR = IWDG_FEED;
}

void hal_trigger(bool high) { GPIOB->BSRR = BIT(high ? PIN_TRIGGER : PIN_TRIGGER + 16); }

void hal_watchdog(void)
{
    if (!(SCB_ICSR & ICSR_PENDSTSET)) /* this tick is on time: the next one is not due yet */
        IWDG_KR = IWDG_FEED;
}

float hal_load(void)
{
    float load = (float)longest / (float)(clock.counts_per_us * (1000000u / TICK_HZ));
    longest = 0;
    return load;
}

static void keep(uint32_t lasted)
{
    uint32_t us = lasted / clock.counts_per_us;
    record.ticks++;
    record.by_us[us < TICK_BINS ? us : TICK_BINS - 1]++;
    if (SCB_ICSR & ICSR_PENDSTSET)
        record.late++;
    if (lasted > record.longest)
        record.longest = lasted;
    if (lasted > longest)
        longest = lasted;
}

void tick(void)
{
    tick_began = counts();
#ifdef HAS_DRIVES
    drives_begin();
    controller_tick(&controller);
    drives_end();
#else
    motors_measure();
    controller_tick(&controller);
#endif
    keep(counts() - tick_began);
}

/* If the chip's supply falls below 2.9 V, an interrupt switches the motors off and ends in a reset. */
static void brown_out_start(void)
{
    RCC_APB1ENR |= APB1_PWR;
    PWR_CR |= PWR_PLS_2V9 | PWR_PVDE;
    EXTI_RTSR |= EXTI_PVD;
    EXTI_IMR |= EXTI_PVD;
    NVIC_ISER(0) = BIT(IRQ_PVD);
}

static volatile uint32_t waits[2];

/* Wait for an interrupt. A masked interrupt also ends the wait. A debugger with a breakpoint here stops
   between ticks. With a watchpoint on one of `waits` it stops after every second tick. */
__attribute__((noinline)) void idle(void)
{
    waits[record.ticks % 2]++;
    __asm__ volatile("dsb\nwfi");
}

int main(void)
{
    RCC_AHB1ENR |= AHB1_GPIOA | AHB1_GPIOB | AHB1_GPIOC;
    pin_mode(GPIOB, PIN_TRIGGER, 1);
    clock_start();
#ifdef HAS_DRIVES
    drives_start(DRIVES, &LIMITS);
    can_start();
#else
    motors_start(&LIMITS);
#endif
    boot = boot_number();
    usart_start();
    controller_start(&controller, LIMITS);
    brown_out_start();
    /* Priorities: faults first, then received bytes, then the tick, then the main loop. */
    NVIC_IPR(IRQ_USART1) = 0x40;
    SCB_SHPR3 = 0xC0u << 24;
    SYSTICK_RVR = clock.core_hz / TICK_HZ - 1;
    SYSTICK_CVR = 0;
    SYSTICK_CSR = 7; /* core clock, interrupt, enabled */
    watchdog_start();
    for (;;) {
        usart_drain();
        __asm__ volatile("cpsid i" ::: "memory");
        if (hal_idle())
            idle();
        __asm__ volatile("cpsie i" ::: "memory");
    }
}
