/* Startup from reset to main, vector table, and fault handling. */
#include "board.h"

extern uint32_t stack_top, data_start, data_end, data_load, bss_start, bss_end;

int main(void);
void reset(void);
void crash(void);
void tick(void);
void usart(void);
void can_sent(void) __attribute__((weak, alias("crash"))); /* a board with bridges has no CAN bus */
void can_came(void) __attribute__((weak, alias("crash")));

volatile Survivor survivor __attribute__((section(".noinit")));

/* Memory and clocks cannot be trusted here. First cut the motors' current. The watchdog is no longer
   fed, so it then resets the chip. */
__attribute__((noreturn, used)) static void end(const uint32_t *stacked)
{
    motors_cut();
    uint32_t at = (uint32_t)(uintptr_t)stacked;
    survivor.crashes++;
    survivor.crash_pc = at >= 0x20000000u && at < 0x20000000u + 128 * 1024 - 32 ? stacked[6] : 0;
    for (;;)
        motors_cut();
}

/* Handler of every fault and every unexpected interrupt. It starts a fresh stack, because the old one
   may be the cause. */
__attribute__((naked)) void crash(void)
{
    __asm__ volatile("mov r0, sp\n"
                     "ldr r1, =stack_top\n"
                     "mov sp, r1\n"
                     "b %0\n"
                     :
                     : "i"(end));
}

void reset(void)
{
    SCB_CPACR |= 0xFu << 20; /* enable the floating-point unit before its first use */
    __asm__ volatile("dsb\nisb" ::: "memory");
    const uint32_t *from = &data_load;
    for (uint32_t *to = &data_start; to < &data_end;)
        *to++ = *from++;
    for (uint32_t *to = &bss_start; to < &bss_end;)
        *to++ = 0;
    main();
    crash();
}

typedef void (*Handler)(void);

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    Handler core[15];
    Handler irq[IRQS];
} VECTORS = {
    .stack = &stack_top,
    .core = {
        reset, crash /* NMI: the crystal has stopped */, crash /* hard fault */, crash, crash, crash,
        crash, crash, crash, crash, crash /* SVC */, crash, crash, crash, tick,
    },
    .irq = {
        [0] = crash,
        [IRQ_PVD] = crash, /* the chip's supply falls: switch the motors off while the chip still runs */
        [2 ... IRQ_CAN1_TX - 1] = crash,
        [IRQ_CAN1_TX] = can_sent,
        [IRQ_CAN1_RX0] = can_came,
        [IRQ_CAN1_RX0 + 1 ... IRQ_USART1 - 1] = crash,
        [IRQ_USART1] = usart,
        [IRQ_USART1 + 1 ... IRQS - 1] = crash,
    },
};
