/* 168 MHz from a crystal. If the crystal or the PLL does not start, the chip runs on its internal 16 MHz
   and reports it. */
#include "board.h"

/* At least 25 ms at 16 MHz. A crystal needs 2 ms, the PLL 0.3 ms. */
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
    /* 1 MHz times 336 is 336 MHz. Divided by 2 it clocks the core, by 7 (48 MHz) the random numbers. */
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
    RCC_CR |= CR_CSSON; /* if the crystal stops later, crash() switches the motors off and resets */
    return true;
}

void clock_start(void)
{
    /* Real chips start with the internal oscillator on and ready. 0 means that no RCC exists: QEMU. */
    clock.emulated = RCC_CR == 0;
    clock.locked = clock.emulated || fast();
    clock.core_hz = clock.locked ? CORE_HZ : OWN_HZ;
    clock.line_hz = clock.locked ? CORE_HZ / 2 : OWN_HZ;
    clock.pwm_hz = clock.core_hz;
    /* QEMU's timers always count nanoseconds. */
    clock.counts_per_us = clock.emulated ? 1000 : clock.locked ? CORE_HZ / 2000000u : OWN_HZ / 1000000u;
    RCC_APB1ENR |= APB1_TIM2;
    TIM2->ARR = 0xFFFFFFFFu;
    TIM2->CR1 = TIM_CEN;
}
