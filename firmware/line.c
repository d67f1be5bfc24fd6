/* The serial line and its frames: COBS(payload + CRC) + 0x00, CRC-16/CCITT-FALSE, little endian (docs/reference/wire.md).

   The UART is polled, not interrupt-driven: line_poll() is called after every byte that is framed and in every turn of
   the main loop, which is often enough for 1 Mbaud both ways (a byte each 160 cycles out; two bytes of buffer, 320
   cycles, in).

   The baud rate is found, not set: the board listens at the first rate of the table and takes the next one whenever it
   hears what cannot be a command (see command.c).  U2X first, then UBRR: 16 MHz / 8 / (UBRR + 1). */

#include "line.h"

#include <util/crc16.h>

#include "board.h"

#define VERSION 1

static const uint8_t baud_dividers[] PROGMEM = {16, 1, 3, 7}; /* 115200 (+2.1 %), 1 M, 500 k, 250 k: exact */
static uint8_t baud;

static uint8_t out[256]; /* as long as its 8-bit indices */
static uint8_t out_head, out_tail;
static uint8_t in[64];
static uint8_t in_head, in_tail;

static uint8_t at, code_at, code; /* of the frame being made */
static uint16_t crc;

static void set_baud(void) {
    UCSR0A = (1 << U2X0);
    UBRR0 = pgm_read_byte(&baud_dividers[baud]);
}

void line_start(void) {
    baud = 0;
    set_baud();
    UCSR0C = (1 << UCSZ01) | (1 << UCSZ00);
    UCSR0B = (1 << RXEN0) | (1 << TXEN0);
}

void line_next_baud(void) {
    baud = (baud + 1) % sizeof baud_dividers;
    out_tail = out_head; /* nobody could read it */
    set_baud();
}

void line_poll(void) {
    uint8_t status = UCSR0A;
    if (status & (1 << RXC0)) {
        uint8_t byte = UDR0;
        if ((status & (1 << FE0)) || (byte & 0x80) || (byte < ' ' && byte != '\n' && byte != '\r')) byte = BAD_BYTE;
        if ((uint8_t)(in_head - in_tail) < sizeof in) in[in_head++ % sizeof in] = byte;
    }
    if ((status & (1 << UDRE0)) && out_tail != out_head) UDR0 = out[out_tail++];
}

int16_t line_read(void) {
    if (in_tail == in_head) return NO_BYTE;
    return in[in_tail++ % sizeof in];
}

static void stuff(uint8_t byte) {
    if (byte) {
        out[at++] = byte;
        code++;
    } else {
        out[code_at] = code;
        code_at = at++;
        code = 1;
    }
}

/* Begin a frame of at most `longest` bytes of payload (below 240), once there is room for it. */
void frame_begin(uint8_t kind, uint8_t longest) {
    while (255 - (uint8_t)(out_head - out_tail) < longest + 4) line_poll();
    code_at = out_head;
    at = out_head + 1;
    code = 1;
    crc = 0xffff;
    frame_u8(kind);
    frame_u8(VERSION);
}

void frame_u8(uint8_t value) {
    crc = _crc_xmodem_update(crc, value);
    stuff(value);
    line_poll();
}

void frame_u16(uint16_t value) {
    frame_u8(value);
    frame_u8(value >> 8);
}

void frame_u32(uint32_t value) {
    frame_u16(value);
    frame_u16(value >> 16);
}

void frame_text(const char *flash) {
    char c;
    while ((c = pgm_read_byte(flash++))) frame_u8(c);
}

void frame_end(void) {
    uint16_t check = crc;
    stuff(check);
    stuff(check >> 8);
    out[code_at] = code;
    out[at++] = 0;
    out_head = at; /* only now the line sees it */
}

void line_delimiter(void) { out[out_head++] = 0; }
