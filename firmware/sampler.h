/* Samples at the commanded rate, queued for the frames. */

#ifndef SAMPLER_H
#define SAMPLER_H

#include <stdint.h>

#define TICKS_PER_S 2000000UL /* 0.5 us */
#define QUEUE 32              /* samples; a power of two */
#define OVERRUN 4

struct sample {
    uint32_t time;
    uint16_t seq, up, down, illegal;
    uint8_t status;
};

extern struct sample queue[QUEUE];
extern volatile uint8_t queue_head; /* written by the interrupt only */
extern volatile uint8_t queue_tail; /* written by the main loop only */

void clock_start(void);
uint32_t clock_now(void);
void sampler_start(uint16_t rate_hz);
void sampler_stop(void);
void counters_select(uint8_t two_counters);
uint8_t counters_selected(void);

#endif
