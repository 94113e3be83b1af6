/* 168 MHz from a crystal. Where it does not come the chip goes on with its own 16 MHz, and says so. */
#include "board.h"

/* 25 ms and more at 16 MHz; a crystal needs 2 ms, the PLL 0.3 ms. */
#define POLLS 100000u

#define CORE_HZ 168000000u
#define OWN_HZ 16000000u

_Static_assert(CRYSTAL_MHZ == 8 || CRYSTAL_MHZ == 25, "CRYSTAL_MHZ is 8 or 25");

Clock clock;

static bool comes(volatile uint32_t *where, uint32_t mask, uint32_t value)
{
    for (uint32_t polls = 0; polls < POLLS; polls++)
        if ((*where & mask) == value)
            return true;
    return false;
}

static bool fast(void)
{
    RCC_APB1ENR |= APB1_PWR;
    PWR_CR |= PWR_VOS;
    RCC_CR |= CR_HSEON;
    if (!comes(&RCC_CR, CR_HSERDY, CR_HSERDY))
        return false;
    FLASH_ACR = ACR_5_WAITS_AND_CACHES;
    /* 1 MHz by 336 is 336 MHz, by 2 the core's and by 7 the random numbers' 48 MHz. */
    RCC_PLLCFGR = CRYSTAL_MHZ | 336u << 6 | 0u << 16 | PLLCFGR_HSE | 7u << 24;
    RCC_CR |= CR_PLLON;
    if (!comes(&RCC_CR, CR_PLLRDY, CR_PLLRDY))
        return false;
    RCC_CFGR = CFGR_APB1_BY_4 | CFGR_APB2_BY_2;
    RCC_CFGR |= CFGR_SW_PLL;
    if (!comes(&RCC_CFGR, 3u << 2, CFGR_SW_PLL << 2)) {
        RCC_CFGR = 0;
        return false;
    }
    RCC_CR |= CR_CSSON; /* a crystal that stops later ends in a crash: motors off, reset */
    return true;
}

void clock_start(void)
{
    /* Real chips begin with their own oscillator on and ready: 0 is nobody there. */
    clock.emulated = RCC_CR == 0;
    clock.locked = clock.emulated || fast();
    clock.core_hz = clock.locked ? CORE_HZ : OWN_HZ;
    clock.line_hz = clock.locked ? CORE_HZ / 2 : OWN_HZ;
    clock.pwm_hz = clock.core_hz;
    /* QEMU's timers count nanoseconds, whatever the clock. */
    clock.counts_per_us = clock.emulated ? 1000 : clock.locked ? CORE_HZ / 2000000u : OWN_HZ / 1000000u;
    RCC_APB1ENR |= APB1_TIM2;
    TIM2->ARR = 0xFFFFFFFFu;
    TIM2->CR1 = TIM_CEN;
}
