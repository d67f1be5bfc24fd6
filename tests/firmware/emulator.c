/* A board in an emulator: the shipped .hex on simavr, edges on its pins at exact cycles, its UART as a pty.

   usage: emulator --mcu M --hex FILE [--edges FILE] [--pins D2,D3] [--watch ADDRESS] [--log FILE] [--speed X]
                   [--latency 4] [--hang SECONDS] [--late 1]

   Says "pty NAME" on stdout and runs until its stdin is closed; then says what it saw, one JSON object.

   edges    records of (uint64 cycle, uint64 levels): the pins' levels (bit n for the nth of --pins) from that cycle on,
            counted from the moment at which the board received the command S.  The first record's levels stand from
            power-up on; with --late 1 the pins float, pulled up by the board, until the first command.
   watch    program address (bytes) inside an interrupt routine; each time it is reached, (uint64 cycle of that
            interrupt's entry less the S cycle, uint64 edges played until then) is appended to the log.
   hang     so long after S the main loop hangs, in an endless loop with interrupts on.
   speed    emulated seconds per second at most; 0: as fast as it can.

   simavr is GPLv3, so a program made of this file is, too: it stays among the tests and out of the wheel.

   What simavr 1.6 lacks and is added here: the cycles of an interrupt's entry; a serial line whose ends may disagree on
   the baud rate (bits are sampled as a receiver does, so that the wrong rate gives the wrong bytes and framing errors);
   a sender of 10 bits a byte with a byte of buffer before it (simavr counts 11 bits and knows no buffer).

   Longer than 400 lines because it is one program that one compiler command makes. */

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_hex.h>
#include <simavr/sim_interrupts.h>

#define F_CPU 16000000
#define SLICE 16000 /* cycles between looks at the outside world: 1 ms */
#define UCSR0A 0xC0
#define UCSR0B 0xC1
#define RXEN0 4
#define UBRR0L 0xC4
#define UBRR0H 0xC5
#define U2X0 1

struct edge {
    uint64_t cycle, levels;
};

static avr_t *avr;
static int latency = 4;
static int master;

/* ---- interrupts: entry cycles, and how long they stay off ---- */

static uint64_t entry_cycle, entry_edges, off_since, longest_off[64];
static int off_vector, entered; /* vector 0 stands for cli in the program */
static const struct edge *edges;
static size_t edge_count, edge_next;

static void on_interrupt(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq;
    (void)param;
    if (value && !avr->sreg[S_I]) { /* an entry; at a return interrupts are on again */
        entry_cycle = avr->cycle;
        entry_edges = edge_next;
        off_since = avr->cycle;
        off_vector = value;
        entered = 1;
        avr->cycle += latency;
    }
}

/* ---- pins ---- */

static avr_irq_t *pin[4];
static int pins;
static uint64_t levels = 3, start_cycle; /* the pull-ups' */
static int started;

static char port_of[4];
static int bit_of[4];

/* Levels that are there before the board is: simavr lifts a pin whenever its pull-up is set, driven or not, unless it is
   told what pulls from outside. */
static void hold(uint64_t to) {
    for (int n = 0; n < pins; n++) {
        avr_ioport_external_t outside = {.name = port_of[n]};
        for (int m = 0; m < pins; m++)
            if (port_of[m] == port_of[n]) {
                outside.mask |= 1 << bit_of[m];
                outside.value |= (to >> m & 1) << bit_of[m];
            }
        avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(port_of[n]), &outside);
        avr_raise_irq(pin[n], to >> n & 1);
    }
    levels = to;
}

static void drive(uint64_t to) {
    for (int n = 0; n < pins; n++)
        if ((levels ^ to) >> n & 1) avr_raise_irq(pin[n], to >> n & 1);
    levels = to;
}

static avr_cycle_count_t on_edge(avr_t *a, avr_cycle_count_t when, void *param) {
    (void)a;
    (void)param;
    drive(edges[edge_next++].levels);
    if (edge_next == edge_count) return 0;
    uint64_t next = start_cycle + edges[edge_next].cycle;
    return next > when ? next : when + 1;
}

static void start_edges(void) {
    if (started++) return;
    start_cycle = avr->cycle;
    memset(longest_off, 0, sizeof longest_off);
    if (edge_count) avr_cycle_timer_register(avr, 1 + edges[0].cycle, on_edge, NULL);
}

/* ---- the serial line ---- */

static avr_uart_t *uart;

static void find_uart(void) {
    for (avr_io_t *io = avr->io_port; io; io = io->next)
        if (!strcmp(io->kind, "uart") && ((avr_uart_t *)io)->name == '0') uart = (avr_uart_t *)io;
}

static double board_bit(void) {
    double divider = (avr->data[UBRR0L] | avr->data[UBRR0H] << 8) + 1;
    return divider * (avr->data[UCSR0A] >> U2X0 & 1 ? 8 : 16);
}

static double host_bit(void) {
    static const struct {
        speed_t code;
        double baud;
    } known[] = {{B9600, 9600},     {B19200, 19200},   {B38400, 38400},   {B57600, 57600},    {B115200, 115200},
                 {B230400, 230400}, {B460800, 460800}, {B500000, 500000}, {B1000000, 1000000}};
    struct termios settings;
    if (tcgetattr(master, &settings) == 0)
        for (size_t i = 0; i < sizeof known / sizeof *known; i++)
            if (known[i].code == cfgetospeed(&settings)) return F_CPU / known[i].baud;
    return F_CPU / 250000.0; /* set through termios2, which this reads as another code: the only rate left */
}

/* Host to board: bytes as a waveform, sampled in the middle of each bit of the board's. */
#define QUEUE 4096
static struct {
    double start, bit;
    uint8_t byte;
} sent[QUEUE];
static size_t sent_head, sent_tail;
static double line_free;
static double receiver_from; /* not before this the board looks for a start bit */

static int line_level(double t) {
    for (size_t i = sent_tail; i != sent_head; i++) {
        double in = (t - sent[i % QUEUE].start) / sent[i % QUEUE].bit;
        if (in < 0) return 1;
        if (in < 1) return 0;
        if (in < 9) return sent[i % QUEUE].byte >> (int)(in - 1) & 1;
        if (in < 10) return 1;
    }
    return 1;
}

/* The next instant from t on at which the line is low after it was high; infinite when there is none. */
static double falling_edge(double t) {
    for (size_t i = sent_tail; i != sent_head; i++)
        for (int k = 0; k < 9; k++) {
            double at = sent[i % QUEUE].start + k * sent[i % QUEUE].bit;
            if (at >= t && !line_level(at + 1e-6) && (k == 0 || (k > 1 ? sent[i % QUEUE].byte >> (k - 2) & 1 : 0)))
                return at;
        }
    return 1e300;
}

static avr_irq_t *uart_in;
static uint64_t framing_errors;
static char command[64];
static size_t command_length;

static void received(uint8_t byte, int framing_error) {
    framing_errors += framing_error;
    uart->cycles_per_byte = 2; /* it is here in full: simavr would wait for a byte's length again */
    avr_raise_irq(uart_in, byte | (framing_error ? UART_INPUT_FE : 0));
    if (framing_error) return;
    if (byte == '\n') {
        if (command_length == 1 && command[0] == 'S') start_edges();
        command_length = 0;
    } else if (command_length < sizeof command)
        command[command_length++] = byte;
}

static avr_cycle_count_t receive(avr_t *a, avr_cycle_count_t when, void *param) {
    (void)param;
    double bit = board_bit();
    double edge = falling_edge(receiver_from);
    if (edge > 1e299) {
        while (sent_tail != sent_head && sent[sent_tail % QUEUE].start + 10 * sent[sent_tail % QUEUE].bit < when) sent_tail++;
        return 0;
    }
    if (when < edge + 9.5 * bit) return (avr_cycle_count_t)(edge + 9.5 * bit) + 1;
    unsigned byte = 0;
    for (int k = 0; k < 8; k++) byte |= line_level(edge + (1.5 + k) * bit) << k;
    int stop = line_level(edge + 9.5 * bit);
    receiver_from = edge + 9.5 * bit;
    received(byte, !stop);
    return a->cycle + 1;
}

static void host_says(const uint8_t *bytes, size_t n) {
    double bit = host_bit();
    if (!(avr->data[UCSR0B] >> RXEN0 & 1)) return; /* still booting: nobody hears it */
    if (line_free < avr->cycle) line_free = avr->cycle;
    for (size_t i = 0; i < n && sent_head - sent_tail < QUEUE; i++) {
        sent[sent_head % QUEUE].start = line_free;
        sent[sent_head % QUEUE].bit = bit;
        sent[sent_head++ % QUEUE].byte = bytes[i];
        line_free += 10 * bit;
    }
    if (!avr_cycle_timer_status(avr, receive, NULL)) avr_cycle_timer_register(avr, 1, receive, NULL);
}

/* Board to host; at the wrong rate a byte is what a receiver makes of it, standing alone. */
static uint8_t out[1 << 16];
static size_t out_length;
static uint64_t bytes_out, bytes_dropped;
static double sender_free;

static void board_says(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq;
    (void)param;
    /* The buffer is free again once this byte is in the shift register: that is when simavr says so, after what it takes
       for a byte's length. */
    double wait = sender_free > avr->cycle ? sender_free - avr->cycle : 0;
    sender_free = avr->cycle + wait + 10 * board_bit();
    uart->cycles_per_byte = 2 + (uint64_t)wait;
    double ratio = board_bit() / host_bit();
    uint8_t byte = value;
    if (ratio < 0.96 || ratio > 1.04) {
        unsigned heard = 0;
        for (int k = 0; k < 8; k++) {
            double in = (1.5 + k) / ratio;
            heard |= (in < 1 ? 0 : in < 9 ? value >> (int)(in - 1) & 1 : 1) << k;
        }
        byte = heard;
    }
    bytes_out++;
    if (out_length < sizeof out)
        out[out_length++] = byte;
    else
        bytes_dropped++;
}

static void give(void) {
    size_t done = 0;
    for (int tries = 0; done < out_length && tries < 200;) {
        ssize_t n = write(master, out + done, out_length - done);
        if (n > 0)
            done += n;
        else {
            struct pollfd p = {.fd = master, .events = POLLOUT};
            poll(&p, 1, 10);
            tries++;
        }
    }
    bytes_dropped += out_length - done; /* nobody reads */
    out_length = 0;
}

/* ---- the outside ---- */

static volatile sig_atomic_t ended;
static void on_signal(int number) {
    (void)number;
    ended = 1;
}

static double seconds(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static void fail(const char *what) {
    fprintf(stderr, "emulator: %s\n", what);
    exit(1);
}

static void quiet(avr_t *a, const int level, const char *format, va_list args) {
    (void)a;
    if (level == LOG_ERROR) vfprintf(stderr, format, args);
}

int main(int argc, char **argv) {
    const char *mcu = NULL, *hex = NULL, *edge_file = NULL, *pin_names = "", *log_file = NULL;
    uint64_t watch = UINT64_MAX;
    double speed = 1, hang = 0;
    int late = 0;
    for (int i = 1; i + 1 < argc; i += 2) {
        const char *value = argv[i + 1];
        if (!strcmp(argv[i], "--mcu")) mcu = value;
        else if (!strcmp(argv[i], "--hex")) hex = value;
        else if (!strcmp(argv[i], "--edges")) edge_file = value;
        else if (!strcmp(argv[i], "--pins")) pin_names = value;
        else if (!strcmp(argv[i], "--log")) log_file = value;
        else if (!strcmp(argv[i], "--watch")) watch = strtoull(value, NULL, 0);
        else if (!strcmp(argv[i], "--speed")) speed = atof(value);
        else if (!strcmp(argv[i], "--latency")) latency = atoi(value);
        else if (!strcmp(argv[i], "--hang")) hang = atof(value);
        else if (!strcmp(argv[i], "--late")) late = atoi(value);
        else fail("unknown flag");
    }
    if (!mcu || !hex) fail("need --mcu and --hex");
    avr_global_logger_set(quiet);
    avr = avr_make_mcu_by_name(mcu);
    if (!avr) fail("no such MCU");
    avr_init(avr);
    avr->frequency = F_CPU;
    avr->run_cycle_limit = 1; /* one instruction at a time */
    uint32_t size, base;
    uint8_t *code = read_ihex_file(hex, &size, &base);
    if (!code) fail("cannot read the .hex");
    avr_loadcode(avr, code, size, base);
    avr->codeend = avr->flashend;

    if (edge_file) {
        int fd = open(edge_file, O_RDONLY);
        struct stat status;
        if (fd < 0 || fstat(fd, &status)) fail("cannot read the edges");
        edge_count = status.st_size / sizeof *edges;
        edges = mmap(NULL, status.st_size, PROT_READ, MAP_PRIVATE, fd, 0);
        if (edges == MAP_FAILED) fail("cannot map the edges");
    }
    for (const char *name = pin_names; *name; pins++) {
        pin[pins] = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(name[0]), name[1] - '0');
        if (!pin[pins]) fail("no such pin");
        port_of[pins] = name[0];
        bit_of[pins] = name[1] - '0';
        name += name[2] == ',' ? 3 : 2;
    }
    if (edge_count && !late) hold(edges[0].levels);
    FILE *log = log_file ? fopen(log_file, "wb") : NULL;

    avr_irq_register_notify(avr_get_interrupt_irq(avr, AVR_INT_ANY) + AVR_INT_IRQ_RUNNING, on_interrupt, NULL);
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    find_uart();
    if (!uart) fail("no UART");
    uart_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), board_says, NULL);

    int slave;
    char name[64];
    struct termios raw;
    if (openpty(&master, &slave, name, NULL, NULL)) fail("cannot open a pty");
    tcgetattr(slave, &raw);
    cfmakeraw(&raw);
    cfsetspeed(&raw, B115200);
    tcsetattr(slave, TCSANOW, &raw);
    fcntl(master, F_SETFL, O_NONBLOCK);
    fcntl(STDIN_FILENO, F_SETFL, O_NONBLOCK);
    signal(SIGTERM, on_signal);
    signal(SIGPIPE, SIG_IGN);
    printf("pty %s\n", name);
    fflush(stdout);

    double began = seconds();
    uint64_t look = 0, hang_cycle = hang > 0 ? hang * F_CPU : UINT64_MAX, resets = 0, was_pc = 0;
    int was_on = 0;
    while (!ended) {
        if (avr->cycle >= look) {
            look = avr->cycle + SLICE;
            uint8_t bytes[256];
            ssize_t n = read(master, bytes, sizeof bytes);
            if (n > 0) {
                host_says(bytes, n);
                if (late && line_free > avr->cycle) { /* the board listens: it is up */
                    drive(edges[0].levels);
                    late = 0;
                }
            }
            char c;
            if (read(STDIN_FILENO, &c, 1) == 0) break;
            give();
            double ahead = speed > 0 ? avr->cycle / (speed * F_CPU) - (seconds() - began) : 0;
            if (ahead > 0.001) usleep(ahead * 1e6);
        }
        if (started && avr->cycle - start_cycle >= hang_cycle) { /* the main loop hangs; interrupts go on */
            hang_cycle = UINT64_MAX;
            avr->flash[avr->flashend - 1] = 0xff; /* rjmp . */
            avr->flash[avr->flashend] = 0xcf;
            avr->pc = avr->flashend - 1;
        }
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) fail("the board crashed");
        if (avr->pc == 0 && was_pc != 0) resets++;
        was_pc = avr->pc;
        if (avr->pc == watch && log && started) {
            uint64_t record[2] = {entry_cycle - start_cycle, entry_edges};
            fwrite(record, sizeof record, 1, log);
        }
        int on = avr->sreg[S_I];
        if (on && !was_on) {
            uint64_t off = avr->cycle - off_since;
            if (off > longest_off[off_vector]) longest_off[off_vector] = off;
        } else if (!on && was_on && !entered) { /* cli in the program */
            off_since = avr->cycle;
            off_vector = 0;
        }
        entered = 0;
        was_on = on;
    }
    give();
    if (log) fclose(log);
    double wall = seconds() - began;
    printf("{\"cycles\": %llu, \"wall_s\": %.3f, \"edges\": %zu, \"bytes_out\": %llu, \"bytes_dropped\": %llu, "
           "\"framing_errors\": %llu, \"resets\": %llu, \"baud\": %.0f, \"longest_off\": {",
           (unsigned long long)avr->cycle, wall, edge_next, (unsigned long long)bytes_out,
           (unsigned long long)bytes_dropped, (unsigned long long)framing_errors, (unsigned long long)resets,
           F_CPU / board_bit());
    int first = 1;
    for (int v = 0; v < 64; v++)
        if (longest_off[v]) {
            printf("%s\"%d\": %llu", first ? "" : ", ", v, (unsigned long long)longest_off[v]);
            first = 0;
        }
    printf("}}\n");
    return 0;
}
