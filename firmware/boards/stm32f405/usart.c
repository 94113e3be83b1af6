/* The serial line: USART1, 8 data bits, no parity, one stop bit. Bytes are received by an interrupt with
   higher priority than the tick. They are sent by the main loop, so the tick never waits for them. */
#include "../../hal.h"
#include "board.h"

#define CAPACITY 4096u /* bytes in each direction, a power of two: 44 ms at 921,600 baud */

#define NO_RECEIVE_INTERRUPTS (CR1_UE | CR1_TE | CR1_RE) /* without receive interrupts */

typedef struct {
    volatile uint32_t in, out; /* bytes since the start; the buffer contains bytes `out` to `in` - 1 */
    uint8_t bytes[CAPACITY];
} Ring;

static Ring received, waiting;

void usart(void);

void usart(void)
{
    uint32_t status = USART1->SR;
    if (!(status & (SR_RXNE | SR_ORE)))
        return;
    uint32_t in = received.in;
    received.bytes[in % CAPACITY] = (uint8_t)USART1->DR; /* reading DR clears both flags */
    received.in = in + 1;
    record.received++;
    if (status & SR_ORE)
        record.overruns++;
    /* If the buffer is full, stop receiving until the tick has read. Bytes that arrive in between are
       lost. One place is kept for a byte whose interrupt is already pending at this write. */
    if (in + 1 - received.out >= CAPACITY - 1)
        USART1->CR1 = NO_RECEIVE_INTERRUPTS;
}

size_t hal_read(uint8_t *data, size_t size)
{
    uint32_t out = received.out, held = received.in - out;
    size_t count = held < size ? held : size;
    for (size_t i = 0; i < count; i++)
        data[i] = received.bytes[(out + i) % CAPACITY];
    received.out = out + count;
    if (count > 0 && USART1->CR1 == NO_RECEIVE_INTERRUPTS)
        USART1->CR1 = NO_RECEIVE_INTERRUPTS | CR1_RXNEIE;
    return count;
}

void hal_write(const uint8_t *data, size_t size)
{
    uint32_t in = waiting.in;
    if (CAPACITY - (in - waiting.out) < size) {
        record.dropped++;
        return;
    }
    for (size_t i = 0; i < size; i++)
        waiting.bytes[(in + i) % CAPACITY] = data[i];
    waiting.in = in + size;
}

bool hal_idle(void) { return waiting.in == waiting.out; }

void usart_drain(void)
{
    while (!hal_idle() && USART1->SR & SR_TXE) {
        USART1->DR = waiting.bytes[waiting.out % CAPACITY];
        waiting.out++;
    }
}

void usart_start(void)
{
    RCC_APB2ENR |= APB2_USART1;
    GPIOA->PUPDR |= 1u << 2 * PIN_RX; /* an unconnected line stays idle */
    pin_function(GPIOA, PIN_TX, 7);
    pin_function(GPIOA, PIN_RX, 7);
    USART1->BRR = (clock.line_hz + BAUD / 2) / BAUD;
    USART1->CR1 = NO_RECEIVE_INTERRUPTS | CR1_RXNEIE;
    NVIC_ISER(IRQ_USART1 / 32) = BIT(IRQ_USART1 % 32);
}
