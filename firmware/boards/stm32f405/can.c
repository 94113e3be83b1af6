/* CAN bus (CAN1) at 1 Mbit/s, for drives instead of bridges. Frames are received and sent by interrupts
   with higher priority than the tick. */
#include "../../drives/can.h"
#include "board.h"

#define CAPACITY 64u    /* frames in each direction, a power of two */
#define POLLS 100000u   /* 11 recessive bits last 11 us */
#define BIT_TIMING (2u | 9u << 16 | 2u << 20) /* 42 MHz / 3, 14 quanta: 1 + 10 + 3, sampled at 79 % */

typedef struct {
    volatile uint32_t in, out; /* number of frames since the start */
    CanFrame frames[CAPACITY];
} Ring;

static Ring received, waiting;
static bool was_off;

void can_sent(void);
void can_came(void);

/* Interrupt: a mailbox is free, or a new frame waits. */
void can_sent(void)
{
    CAN1->TSR = TSR_RQCP;
    for (unsigned box = 0; box < 3 && waiting.in != waiting.out; box++) {
        if (!(CAN1->TSR & TSR_TME(box)))
            continue;
        const CanFrame *frame = &waiting.frames[waiting.out % CAPACITY];
        const uint8_t *d = frame->data;
        CAN1->TX[box].DTR = frame->size;
        CAN1->TX[box].DLR = d[0] | (uint32_t)d[1] << 8 | (uint32_t)d[2] << 16 | (uint32_t)d[3] << 24;
        CAN1->TX[box].DHR = d[4] | (uint32_t)d[5] << 8 | (uint32_t)d[6] << 16 | (uint32_t)d[7] << 24;
        CAN1->TX[box].IR = (uint32_t)frame->id << 21 | IR_TXRQ | (frame->id & CAN_REMOTE ? IR_RTR : 0u);
        waiting.out++;
    }
}

void can_came(void)
{
    while (CAN1->RFR[0] & RFR_FMP) {
        const CanBox *box = &CAN1->RX[0];
        uint32_t identifier = box->IR, low = box->DLR, high = box->DHR;
        uint8_t size = box->DTR & 15u;
        CAN1->RFR[0] = RFR_RFOM;
        if (identifier & IR_RTR_OR_IDE || received.in - received.out == CAPACITY)
            continue; /* the queue is full, so the received frame is lost */
        CanFrame *frame = &received.frames[received.in % CAPACITY];
        frame->id = (uint16_t)(identifier >> 21);
        frame->size = size < 8 ? size : 8;
        for (unsigned k = 0; k < 4; k++) {
            frame->data[k] = (uint8_t)(low >> 8 * k);
            frame->data[4 + k] = (uint8_t)(high >> 8 * k);
        }
        received.in++;
    }
}

bool can_read(CanFrame *frame)
{
    if (received.in == received.out)
        return false;
    *frame = received.frames[received.out % CAPACITY];
    received.out++;
    return true;
}

void can_write(const CanFrame *frame)
{
    if (waiting.in - waiting.out == CAPACITY) {
        record.dropped++;
        return;
    }
    waiting.frames[waiting.in % CAPACITY] = *frame;
    waiting.in++;
    NVIC_ISPR(IRQ_CAN1_TX / 32) = BIT(IRQ_CAN1_TX % 32);
}

bool can_off(void)
{
    bool off = CAN1->ESR & ESR_BOFF, left = off && !was_off;
    was_off = off;
    if (left) { /* old setpoints must not be sent when the bus returns */
        waiting.out = waiting.in; /* before the abort, because a free mailbox takes the next frame */
        CAN1->TSR = TSR_ABRQ;
    }
    return left;
}

/* Without the crystal the bit rate would be wrong, so CAN1 stays off and the drives get no frames. */
void can_start(void)
{
    pin_mode(GPIOB, PIN_ENABLE, 1);
    if (!clock.locked)
        return;
    GPIOB->BSRR = BIT(PIN_ENABLE);
    pin_function(GPIOB, PIN_CAN_RX, 9);
    pin_function(GPIOB, PIN_CAN_TX, 9);
    RCC_APB1ENR |= APB1_CAN1;
    CAN1->MCR = MCR_INRQ;
    for (uint32_t polls = 0; polls < POLLS && !(CAN1->MSR & MSR_INAK); polls++) {
    }
    CAN1->BTR = BIT_TIMING;
    CAN1->FMR |= FMR_FINIT; /* filter 0 accepts all frames into the first queue */
    CAN1->FS1R = 1;
    CAN1->FR[0] = CAN1->FR[1] = 0;
    CAN1->FA1R = 1;
    CAN1->FMR &= ~FMR_FINIT;
    CAN1->IER = IER_TMEIE | IER_FMPIE0;
    CAN1->MCR = MCR_TXFP | MCR_ABOM; /* the controller joins the bus after 11 idle bits */
    NVIC_IPR(IRQ_CAN1_TX) = NVIC_IPR(IRQ_CAN1_RX0) = 0x40;
    NVIC_ISER(IRQ_CAN1_TX / 32) = BIT(IRQ_CAN1_TX % 32) | BIT(IRQ_CAN1_RX0 % 32);
}
