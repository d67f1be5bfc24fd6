/* The serial line: polled, so that it never keeps an edge waiting; and the frames on it. */

#ifndef LINE_H
#define LINE_H

#include <avr/pgmspace.h>
#include <stdint.h>

#define NO_BYTE -1
#define BAD_BYTE 0x80 /* what a framing error or a byte that is no text reads as */

void line_start(void);
void line_next_baud(void);
void line_poll(void);
int16_t line_read(void);

void frame_begin(uint8_t kind, uint8_t longest);
void frame_u8(uint8_t value);
void frame_u16(uint16_t value);
void frame_u32(uint32_t value);
void frame_text(const char *flash);
void frame_end(void);
void line_delimiter(void);

#endif
