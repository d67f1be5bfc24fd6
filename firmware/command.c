/* The host's commands: ASCII lines that end in \n (docs/reference/wire.md).

   I identify, R <hz> rate, B <n> samples per frame, M <decoder> decoder (counters start again), S start, X stop.  A
   command that is unknown or cannot be carried out is answered by a NOTICE and changes nothing.

   A byte that cannot be part of a command (a framing error, or no ASCII text) means that the host speaks at another
   rate: the board takes the next one, and then hears nothing until the line has been silent for a while, so that one
   question at the wrong rate moves it on by one rate, not by as many as the question has bytes.  While it samples it takes
   several such bytes to make it stop and listen. */

#include "command.h"

#include <string.h>

#include "board.h"
#include "line.h"
#include "sampler.h"

#define MAX_RATE_HZ 5000
#define LONGEST_BLOCK 16
#define LONGEST_DT 65535UL
#define AT_LATEST 1000 /* ticks by which a sample may be late */
#define BAD_WHILE_RUNNING 4
#define SILENCE (TICKS_PER_S / 50) /* 20 ms */
#define X4_MAX_EDGE_RATE_HZ 160000UL /* measured: exact at 175,000 with edges 20 % off their places */
#define COUNTERS_MAX_EDGE_RATE_HZ 1000000UL

#define BLOCKS 1
#define LEVELS 2
#define ILLEGAL 4

uint8_t running;
uint8_t block = 8;
static uint16_t rate = 1000;

static char text[41];
static uint8_t length;
static uint8_t bad;
static uint8_t deaf; /* the rate has changed, and the line was not silent since */
static uint32_t heard;

void identify(void) {
    uint8_t two = counters_selected();
    frame_begin('I', 40);
    frame_u8(1); /* firmware 1.0.0 */
    frame_u8(0);
    frame_u8(0);
    frame_u8(two ? 4 : 0);
    frame_u16(two ? BLOCKS : BLOCKS | LEVELS | ILLEGAL);
    frame_u8(16);
    frame_u16(500);
    frame_u8(block);
    frame_u32(MAX_RATE_HZ);
    frame_u32(two ? COUNTERS_MAX_EDGE_RATE_HZ : X4_MAX_EDGE_RATE_HZ);
    frame_text(PSTR(BOARD_NAME));
    frame_end();
}

/* Refuse the command in `text`, and say why. */
static void refuse(const char *why) {
    frame_begin('X', 120);
    for (const char *c = text; *c; c++) frame_u8(*c);
    frame_text(why);
    frame_end();
}

/* A whole number from 1 to most, or 0. */
static uint16_t number(const char *digits, uint16_t most) {
    uint32_t value = 0;
    if (!*digits) return 0;
    for (; *digits; digits++) {
        if (*digits < '0' || *digits > '9' || value > most) return 0;
        value = value * 10 + (*digits - '0');
    }
    return value > most ? 0 : value;
}

static void start(void) {
    if (block > 1 && TICKS_PER_S / rate + AT_LATEST > LONGEST_DT) {
        refuse(PSTR(": at this rate two samples of a block are too far apart; send single frames (B 1)"));
        return;
    }
    running = 1;
    sampler_start(rate);
}

static void set(char command, const char *argument) {
    uint16_t value;
    if (command == 'R') {
        value = number(argument, MAX_RATE_HZ);
        if (value)
            rate = value;
        else
            refuse(PSTR(": the rate is a whole number from 1 to 5000 Hz"));
    } else if (command == 'B') {
        value = number(argument, LONGEST_BLOCK);
        if (value)
            block = value;
        else
            refuse(PSTR(": samples per frame are 1 to 16"));
    } else if (!strcmp_P(argument, PSTR("x4"))) {
        counters_select(0);
    } else if (!strcmp_P(argument, PSTR("two-counter"))) {
        counters_select(1);
    } else {
        refuse(PSTR(": no such decoder; known: x4, two-counter"));
    }
}

static void obey(void) {
    char command = text[0];
    uint8_t alone = text[1] == 0;
    if (command == 'I' && alone) {
        identify();
    } else if (command == 'X' && alone) {
        sampler_stop();
        running = 0;
    } else if ((command == 'S' && alone) || ((command == 'R' || command == 'B' || command == 'M') && text[1] == ' ')) {
        if (running)
            refuse(PSTR(": sampling; stop it first with X"));
        else if (command == 'S')
            start();
        else
            set(command, text + 2);
    } else {
        refuse(PSTR(" is no command; known: I, R <hz>, B <n>, M <decoder>, S, X"));
    }
}

/* The host is not at our rate. */
static void search(void) {
    length = 0;
    if (running && ++bad < BAD_WHILE_RUNNING) return;
    bad = 0;
    sampler_stop();
    running = 0;
    queue_tail = queue_head;
    line_next_baud();
    deaf = 1;
}

void command_byte(uint8_t byte) {
    uint32_t now = clock_now();
    if (deaf && now - heard > SILENCE) deaf = 0;
    heard = now;
    if (deaf) return;
    if (byte == BAD_BYTE) {
        search();
    } else if (byte == '\n') {
        while (length && text[length - 1] == ' ') length--;
        text[length] = 0;
        if (length) {
            bad = 0;
            obey();
        }
        length = 0;
    } else if (byte != '\r') {
        if (length < sizeof text - 1) text[length++] = byte;
    }
}
