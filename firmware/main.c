/* The board: the interrupts of latch.S count and latch, the main loop speaks the wire of docs/reference/wire.md. */

#include <avr/interrupt.h>
#include <avr/wdt.h>

#include "board.h"
#include "command.h"
#include "line.h"
#include "sampler.h"

/* A watchdog that has bitten is still running: off before anything else. */
void watchdog_off(void) __attribute__((naked, used, section(".init3")));
void watchdog_off(void) {
    MCUSR = 0;
    wdt_disable();
}

/* Send a frame of the samples that wait: a full block; fewer before a gap, and after the stop. */
static void send_samples(void) {
    uint8_t waiting = queue_head - queue_tail;
    if (!waiting) return;
    uint8_t most = waiting < block ? waiting : block;
    const struct sample *first = &queue[queue_tail % QUEUE];
    uint8_t n = 1;
    while (n < most && queue[(queue_tail + n) % QUEUE].seq == (uint16_t)(first->seq + n)) n++;
    if (n < block && n == waiting && running) return;

    frame_begin('S', 9 + 2 + 7 * n);
    frame_u8(n);
    frame_u16(first->seq);
    frame_u32(first->time);
    frame_u16(queue[(queue_tail + n - 1) % QUEUE].illegal);
    uint32_t before = first->time;
    for (uint8_t i = 0; i < n; i++) {
        const struct sample *sample = &queue[(queue_tail + i) % QUEUE];
        frame_u16(sample->time - before);
        before = sample->time;
        frame_u16(sample->up);
        frame_u16(sample->down);
        frame_u8(sample->status);
    }
    frame_end();
    queue_tail += n;
}

int main(void) {
    clock_start();
    counters_select(0);
    line_start();
    wdt_enable(WDTO_1S);
    sei();
    line_delimiter(); /* ends a frame that a reset has cut short */
    identify();
    for (;;) {
        wdt_reset();
        line_poll();
        int16_t byte = line_read();
        if (byte != NO_BYTE) command_byte(byte);
        send_samples();
    }
}
