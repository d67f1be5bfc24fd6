/* The two boards: which pins, interrupts and counters.  Read by C and by the assembler.

   Encoder A and B are on D2 and D3 of both; the two counters count rising edges.  Registers r2 to r17 belong to
   latch.S (-ffixed in the Makefile), so that the decoder's state needs no memory access. */

#ifndef BOARD_H
#define BOARD_H

#include <avr/io.h>

#if F_CPU != 16000000
#error "the clock's arithmetic is for 16 MHz"
#endif

#if defined(__AVR_ATmega328P__) /* Uno, Nano */
#define BOARD_NAME "stickslip uno"
#define AB_PIN PIND
#define AB_PORT PORTD
#define AB_MASK 0x0c /* D2, D3 = PD2, PD3: A is the lower bit */
#define A_VECT INT0_vect
#define B_VECT INT1_vect
#define AB_INTERRUPTS 0x03
#define AB_SENSE EICRA
#define AB_ANY_CHANGE 0x05
#define UP_TCNTL TCNT1L /* up pulses on D5 */
#define UP_TCNTH TCNT1H
#define UP_TCNT TCNT1
#define UP_TCCRA TCCR1A
#define UP_TCCRB TCCR1B
#define UP_PORT PORTD
#define UP_BIT 5
#define DOWN_PORT PORTD /* down pulses on D4 */
#define DOWN_BIT 4

#elif defined(__AVR_ATmega2560__) /* Mega */
#define BOARD_NAME "stickslip mega"
#define AB_PIN PINE
#define AB_PORT PORTE
#define AB_MASK 0x30 /* D2, D3 = PE4, PE5: A is the lower bit */
#define A_VECT INT4_vect
#define B_VECT INT5_vect
#define AB_INTERRUPTS 0x30
#define AB_SENSE EICRB
#define AB_ANY_CHANGE 0x05
#define UP_TCNTL TCNT5L /* up pulses on D47 */
#define UP_TCNTH TCNT5H
#define UP_TCNT TCNT5
#define UP_TCCRA TCCR5A
#define UP_TCCRB TCCR5B
#define UP_PORT PORTL
#define UP_BIT 2
#define DOWN_PORT PORTD /* down pulses on D38 */
#define DOWN_BIT 7

#else
#error "no such board"
#endif

/* Bits of GPIOR0. */
#define EARLY 0    /* the next sample is due in the first half of a turn of Timer 2 */
#define COUNTERS 1 /* two-counter mode */

#define RISING_EDGES_OF_PIN 0x07 /* clock select of Timers 0, 1 and 5 */

#endif
