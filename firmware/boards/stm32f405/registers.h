/* Registers of the STM32F405 that this board uses: addresses and bits as its reference manual
   (RM0090) and the ARMv7-M manual name them. */
#ifndef PLATE_REGISTERS_H
#define PLATE_REGISTERS_H

#include <stdint.h>

#define BIT(n) (1u << (n))
#define REGISTER(address) (*(volatile uint32_t *)(uintptr_t)(address))

/* Core: system control, interrupts, system timer */
#define SCB_ICSR REGISTER(0xE000ED04u)
#define SCB_SHPR3 REGISTER(0xE000ED20u)
#define SCB_CPACR REGISTER(0xE000ED88u)
#define ICSR_PENDSTSET BIT(26) /* the next tick is already due */
#define NVIC_ISER(n) REGISTER(0xE000E100u + 4u * (n))
#define NVIC_IPR(irq) (*(volatile uint8_t *)(uintptr_t)(0xE000E400u + (irq)))
#define SYSTICK_CSR REGISTER(0xE000E010u)
#define SYSTICK_RVR REGISTER(0xE000E014u)
#define SYSTICK_CVR REGISTER(0xE000E018u)

#define NVIC_ISPR(n) REGISTER(0xE000E200u + 4u * (n))

enum { IRQ_PVD = 1, IRQ_CAN1_TX = 19, IRQ_CAN1_RX0 = 20, IRQ_USART1 = 37, IRQS = 82 };

/* Clocks */
#define RCC_CR REGISTER(0x40023800u)
#define RCC_PLLCFGR REGISTER(0x40023804u)
#define RCC_CFGR REGISTER(0x40023808u)
#define RCC_AHB1ENR REGISTER(0x40023830u)
#define RCC_AHB2ENR REGISTER(0x40023834u)
#define RCC_APB1ENR REGISTER(0x40023840u)
#define RCC_APB2ENR REGISTER(0x40023844u)
#define RCC_CSR REGISTER(0x40023874u)
#define CR_HSEON BIT(16)
#define CR_HSERDY BIT(17)
#define CR_CSSON BIT(19)
#define CR_PLLON BIT(24)
#define CR_PLLRDY BIT(25)
#define PLLCFGR_HSE BIT(22)
#define CFGR_SW_PLL 2u
#define CFGR_SWS(cfgr) ((cfgr) >> 2 & 3u)
#define CFGR_APB1_BY_4 (5u << 10)
#define CFGR_APB2_BY_2 (4u << 13)
#define CSR_RMVF BIT(24)
#define AHB1_GPIOA BIT(0)
#define AHB1_GPIOB BIT(1)
#define AHB1_GPIOC BIT(2)
#define AHB2_RNG BIT(6)
#define APB1_TIM2 BIT(0)
#define APB1_CAN1 BIT(25)
#define APB1_PWR BIT(28)
#define APB2_TIM8 BIT(1)
#define APB2_USART1 BIT(4)
#define APB2_ADC1 BIT(8)

/* Supply of the chip, flash, external interrupts */
#define PWR_CR REGISTER(0x40007000u)
#define PWR_PVDE BIT(4)
#define PWR_PLS_2V9 (7u << 5)
#define PWR_VOS BIT(14)
#define FLASH_ACR REGISTER(0x40023C00u)
#define ACR_5_WAITS_AND_CACHES (5u | BIT(8) | BIT(9) | BIT(10))
#define EXTI_IMR REGISTER(0x40013C00u)
#define EXTI_RTSR REGISTER(0x40013C08u)
#define EXTI_PVD BIT(16)

/* Pins */
typedef struct {
    volatile uint32_t MODER, OTYPER, OSPEEDR, PUPDR, IDR, ODR, BSRR, LCKR, AFR[2];
} Gpio;
#define GPIOA ((Gpio *)0x40020000u)
#define GPIOB ((Gpio *)0x40020400u)
#define GPIOC ((Gpio *)0x40020800u)

/* Serial port */
typedef struct {
    volatile uint32_t SR, DR, BRR, CR1, CR2, CR3;
} Usart;
#define USART1 ((Usart *)0x40011000u)
#define SR_ORE BIT(3)
#define SR_RXNE BIT(5)
#define SR_TXE BIT(7)
#define CR1_RE BIT(2)
#define CR1_TE BIT(3)
#define CR1_RXNEIE BIT(5)
#define CR1_UE BIT(13)

/* CAN bus: three mailboxes for sending, two queues of three received frames */
typedef struct {
    volatile uint32_t IR, DTR, DLR, DHR;
} CanBox;
typedef struct {
    volatile uint32_t MCR, MSR, TSR, RFR[2], IER, ESR, BTR, gap[88];
    CanBox TX[3], RX[2];
    volatile uint32_t gap_2[12], FMR, FM1R, gap_3, FS1R, gap_4, FFA1R, gap_5, FA1R, gap_6[8], FR[2];
} Can;
#define CAN1 ((Can *)0x40006400u)
#define MCR_INRQ BIT(0)
#define MCR_TXFP BIT(2) /* transmit in the order of the requests */
#define MCR_ABOM BIT(6) /* return to the bus automatically */
#define MSR_INAK BIT(0)
#define TSR_RQCP (BIT(0) | BIT(8) | BIT(16))
#define TSR_TME(box) BIT(26 + (box))
#define TSR_ABRQ (BIT(7) | BIT(15) | BIT(23))
#define RFR_FMP 3u
#define RFR_RFOM BIT(5)
#define IER_TMEIE BIT(0)
#define IER_FMPIE0 BIT(1)
#define ESR_BOFF BIT(2)
#define FMR_FINIT BIT(0)
#define IR_TXRQ BIT(0)
#define IR_RTR 2u
#define IR_RTR_OR_IDE 6u

/* Timers: TIM2 counts time, TIM8 makes the bridges' PWM */
typedef struct {
    volatile uint32_t CR1, CR2, SMCR, DIER, SR, EGR, CCMR1, CCMR2, CCER, CNT, PSC, ARR, RCR,
        CCR[4], BDTR;
} Timer;
#define TIM2 ((Timer *)0x40000000u)
#define TIM8 ((Timer *)0x40010400u)
#define TIM_CEN BIT(0)
#define TIM_ARPE BIT(7)
#define TIM_UG BIT(0)
#define TIM_BIF BIT(7)
#define CCMR_PWM_BOTH (0x6868u) /* PWM mode 1 with preload, both channels of the register */
#define CCER_ALL (BIT(0) | BIT(4) | BIT(8) | BIT(12))
#define BDTR_LOCK_1 BIT(8)      /* the break's settings stay until the next reset */
#define BDTR_OSSI BIT(10)       /* off is low, not floating */
#define BDTR_BKE BIT(12)        /* break input on, low is a fault (BKP 0) */
#define BDTR_MOE BIT(15)        /* outputs on; a break clears it, only software sets it (AOE 0) */

/* Analogue inputs */
typedef struct {
    volatile uint32_t SR, CR1, CR2, SMPR1, SMPR2, JOFR[4], HTR, LTR, SQR1, SQR2, SQR3, JSQR,
        JDR[4], DR;
} Adc;
#define ADC1 ((Adc *)0x40012000u)
#define ADC_CCR REGISTER(0x40012304u)
#define ADC_CCR_BY_4 BIT(16)
#define ADC_JEOC BIT(2)
#define ADC_SCAN BIT(8)
#define ADC_ADON BIT(0)
#define ADC_CONT BIT(1)
#define ADC_JSWSTART BIT(22)
#define ADC_SWSTART BIT(30)

/* Independent watchdog, random numbers, the chip's own number */
#define IWDG_KR REGISTER(0x40003000u)
#define IWDG_PR REGISTER(0x40003004u)
#define IWDG_RLR REGISTER(0x40003008u)
#define IWDG_SR REGISTER(0x4000300Cu)
#define IWDG_START 0xCCCCu
#define IWDG_UNLOCK 0x5555u
#define IWDG_FEED 0xAAAAu
#define RNG_CR REGISTER(0x50060800u)
#define RNG_SR REGISTER(0x50060804u)
#define RNG_DR REGISTER(0x50060808u)
#define RNG_ENABLE BIT(2)
#define RNG_READY BIT(0)
#define UNIQUE_ID(n) REGISTER(0x1FFF7A10u + 4u * (n))

#endif
