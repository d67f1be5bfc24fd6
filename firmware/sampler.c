/* The sample clock: sample i is due at start + floor(i * 2,000,000 / rate) ticks of 0.5 us.

   Rates that divide 2,000,000 are exact; with any other the instants stay within one tick of the ideal grid for ever,
   because the remainder is carried on, not dropped.  Each sample carries the time at which it was really taken. */

#include "sampler.h"

#include <avr/interrupt.h>

#include "board.h"

#define LATE 16       /* ticks (8 us): longer than any interrupt, so the board has missed its pace */
#define SOONEST 16    /* ticks ahead that can still be armed */
#define AT_START 1000 /* ticks from the command to the first sample */

/* What the interrupt latched, in the order in which latch.S stores it. */
struct latch {
    uint8_t time, turns[3], flags2;
    uint8_t up[2], down[2];
    uint8_t levels; /* two-counter mode: TIFR0 */
    uint8_t illegal[2];
};

volatile struct latch latch;
struct sample queue[QUEUE];
volatile uint8_t queue_head, queue_tail;

static uint32_t due, period;
static uint16_t rate, remainder, carried;
static uint16_t seq;
static uint8_t missed; /* OVERRUN when samples were lost since the one before */

void latch_start(void);
void latch_clear(void);
void latch_align(void);
void clock_arm(uint32_t);

/* Timer 2 runs at 2 MHz from power-up on, and its overflows are counted: device time. */
void clock_start(void) {
    latch_start();
    TCCR2A = 0;
    TCCR2B = (1 << CS21);
    TIMSK2 = (1 << TOIE2);
}

void sampler_start(uint16_t rate_hz) {
    rate = rate_hz;
    period = TICKS_PER_S / rate_hz;
    remainder = TICKS_PER_S % rate_hz;
    carried = 0;
    seq = 0;
    missed = 0;
    queue_tail = queue_head;
    if (!counters_selected()) latch_align();
    due = clock_now() + AT_START;
    clock_arm(due);
    TIMSK2 = (1 << TOIE2) | (1 << OCIE2A);
}

void sampler_stop(void) { TIMSK2 = (1 << TOIE2); }

static void next(void) {
    due += period;
    carried += remainder;
    if (carried >= rate) {
        carried -= rate;
        due++;
    }
    seq++;
}

static uint8_t levels_of(uint8_t index) {
#if AB_MASK == 0x30
    return index & 3;
#else
    return index >> 6;
#endif
}

/* Called by the latch with interrupts on: the next latch is a sample period away. */
void sampled(void) {
    uint32_t turns = latch.turns[0] | (uint16_t)latch.turns[1] << 8 | (uint32_t)latch.turns[2] << 16;
    if ((latch.flags2 & (1 << TOV2)) && latch.time < 128) turns++;
    uint32_t time = turns << 8 | latch.time;
    if (time - due > LATE) missed = OVERRUN;
    if ((uint8_t)(queue_head - queue_tail) < QUEUE) {
        struct sample *to = &queue[queue_head % QUEUE];
        to->time = time;
        to->seq = seq;
        to->up = latch.up[0] | latch.up[1] << 8;
        to->status = missed;
        if (counters_selected()) {
            uint8_t high = latch.down[1];
            if ((latch.levels & (1 << TOV0)) && latch.down[0] < 128) high++;
            to->down = latch.down[0] | high << 8;
            to->illegal = 0;
        } else {
            to->down = latch.down[0] | latch.down[1] << 8;
            to->illegal = latch.illegal[0] | latch.illegal[1] << 8;
            to->status |= levels_of(latch.levels);
        }
        missed = 0;
        queue_head++;
    } else {
        missed = OVERRUN; /* the line is too slow: this sample is lost, and its number with it */
    }
    next();
    while ((int32_t)(due - clock_now()) < SOONEST) {
        missed = OVERRUN;
        next();
    }
    clock_arm(due);
}

uint8_t counters_selected(void) { return GPIOR0 & (1 << COUNTERS); }

/* Select who counts: the x4 decoder on A and B, or the two hardware counters; both start anew. */
void counters_select(uint8_t two_counters) {
    EIMSK &= ~AB_INTERRUPTS;
    UP_TCCRA = 0;
    UP_TCCRB = 0;
    TCCR0A = 0;
    TCCR0B = 0;
    TIMSK0 = 0;
    if (two_counters) {
        GPIOR0 |= (1 << COUNTERS);
        UP_PORT |= (1 << UP_BIT); /* pull-ups: a box that is not there yet counts nothing */
        DOWN_PORT |= (1 << DOWN_BIT);
        UP_TCNT = 0;
        TCNT0 = 0;
        TIFR0 = (1 << TOV0);
        latch_clear();
        TIMSK0 = (1 << TOIE0);
        UP_TCCRB = RISING_EDGES_OF_PIN;
        TCCR0B = RISING_EDGES_OF_PIN;
    } else {
        GPIOR0 &= ~(1 << COUNTERS);
        AB_PORT |= AB_MASK;
        AB_SENSE = (AB_SENSE & 0xf0) | AB_ANY_CHANGE;
        latch_clear();
        EIMSK |= AB_INTERRUPTS;
    }
}
