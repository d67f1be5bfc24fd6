; The interrupts: x4 decoder, clock, and the one latch of both counters, levels and time.
;
; Registers r2 to r17 are used by nothing else (-ffixed in the Makefile; a test reads the listing):
;
;   r2       SREG of the interrupt now running with interrupts off
;   r3       levels the decoder last saw, as the table's index wants them
;   r5:r4    Z of the interrupt now running with interrupts off
;   r7:r6    up          r9:r8    down (two-counter mode: r9 = overflows of Timer 0)
;   r11:r10  illegal transitions
;   r14:r13:r12  turns of Timer 2 (256 ticks of 0.5 us); with TCNT2 they are the 32-bit device time
;   r15      0xFF: subtracting it from every byte adds 1
;   r17:r16  low 16 bits of the turn in which the next sample is due
;
; Rules.  One edge moves the levels by one step of 00, 10, 11, 01: up or down.  Two steps at once are illegal: counted in
; r11:r10, and neither counter moves.  The encoder's interrupts come before all others (lowest vectors), and no routine
; here keeps interrupts off for longer than the latch.  Cycles in the margin: Uno, entry (4) and vector (2) not included.

#define __SFR_OFFSET 0
#include "board.h"

        .section .text.latch, "ax", @progbits

; ---- x4: 19 to 21 cycles -------------------------------------------------------------------------------------------

        .global A_VECT
        .global B_VECT
A_VECT:
B_VECT:
        in      r2, SREG                ; 1
        movw    r4, r30                 ; 1
        in      r30, AB_PIN             ; 1     the pins are read 10 cycles after the edge at the earliest
        andi    r30, AB_MASK            ; 1     new levels
        mov     r31, r30                ; 1
        swap    r31                     ; 1
        or      r30, r3                 ; 1     beside the levels before
        mov     r3, r31                 ; 1
        ldi     r31, pm_hi8(steps)      ; 1
        ijmp                            ; 2

; levels = A + 2 B; up is 0 1 3 2 0.  Where the levels stand apart in the index (Uno: old in 7:6, new in 3:2) each pair has
; room for its own code; where they do not (Mega: new in 5:4, old in 1:0) it has room for a jump.  Both take 4 cycles.
#if AB_MASK == 0x30
#define AT(old, new) .org (old + new * 16) * 2
#define DO(what) rjmp what
#else
#define AT(old, new) .org (old * 64 + new * 4) * 2
#define DO(what) what##_here
#endif
        .macro up_here
        sub     r6, r15                 ; 1
        sbc     r7, r15                 ; 1
        rjmp    x4_end                  ; 2
        .endm
        .macro down_here
        sub     r8, r15
        sbc     r9, r15
        rjmp    x4_end
        .endm
        .macro same_here
        rjmp    x4_end                  ;       a pulse shorter than the way here, or an edge seen already
        .endm
        .macro illegal_here
        sub     r10, r15
        sbc     r11, r15
        rjmp    x4_end
        .endm

        .section .text.steps, "ax", @progbits
        .balign 512                     ; the index is the whole low byte of the word address
steps:
#if AB_MASK == 0x30
        AT(0, 0)
        DO(same)
        AT(1, 0)
        DO(down)
        AT(2, 0)
        DO(up)
        AT(3, 0)
        DO(illegal)
        AT(0, 1)
        DO(up)
        AT(1, 1)
        DO(same)
        AT(2, 1)
        DO(illegal)
        AT(3, 1)
        DO(down)
        AT(0, 2)
        DO(down)
        AT(1, 2)
        DO(illegal)
        AT(2, 2)
        DO(same)
        AT(3, 2)
        DO(up)
        AT(0, 3)
        DO(illegal)
        AT(1, 3)
        DO(up)
        AT(2, 3)
        DO(down)
        AT(3, 3)
        DO(same)
        ; each with the end of the routine of its own: 2 cycles of the jump here, none on the way out
up:     sub     r6, r15                 ; 1
        sbc     r7, r15                 ; 1
        movw    r30, r4                 ; 1
        out     SREG, r2                ; 1
        reti                            ; 5
down:   sub     r8, r15
        sbc     r9, r15
        movw    r30, r4
        out     SREG, r2
        reti
illegal:
        sub     r10, r15
        sbc     r11, r15
same:
#else
        AT(0, 0)
        DO(same)
        AT(0, 1)
        DO(up)
        AT(0, 2)
        DO(down)
        AT(0, 3)
        DO(illegal)
        AT(1, 0)
        DO(down)
        AT(1, 1)
        DO(same)
        AT(1, 2)
        DO(illegal)
        AT(1, 3)
        DO(up)
        AT(2, 0)
        DO(up)
        AT(2, 1)
        DO(illegal)
        AT(2, 2)
        DO(same)
        AT(2, 3)
        DO(down)
        AT(3, 0)
        DO(illegal)
        AT(3, 1)
        DO(down)
        AT(3, 2)
        DO(up)
        AT(3, 3)
        DO(same)
#endif

x4_end:
        movw    r30, r4                 ; 1
        out     SREG, r2                ; 1
        reti                            ; 4

        .section .text.latch, "ax", @progbits

; ---- the device time's upper bytes: 9 cycles, every 128 us -------------------------------------------------------------

        .global TIMER2_OVF_vect
TIMER2_OVF_vect:
        in      r2, SREG
        sub     r12, r15
        sbc     r13, r15
        sbc     r14, r15
        out     SREG, r2
        reti

; ---- the down counter's upper byte in two-counter mode: 7 cycles, every 256 pulses -------------------------------------

        .global TIMER0_OVF_vect
TIMER0_OVF_vect:
        in      r2, SREG
        sub     r9, r15
        out     SREG, r2
        reti

; ---- the latch: once every turn of Timer 2, and in the turn that is due it latches ------------------------------------
;
; The instant of a sample is the entry into this routine: from there on nothing counts, so counters and levels are those
; of the entry, and the time is read a fixed number of cycles later.  Interrupts are on again 50 cycles after the entry.

not_due:
        movw    r30, r4
        out     SREG, r2
        reti

        .global TIMER2_COMPA_vect
TIMER2_COMPA_vect:
        in      r2, SREG                ; 1
        movw    r4, r30                 ; 1
        movw    r30, r12                ; 1
        sbis    TIFR2, TOV2             ; 1     an overflow that waits behind us is a turn not yet counted,
        rjmp    1f                      ; 2
        sbic    GPIOR0, EARLY           ;       if it came before the match
        adiw    r30, 1
1:      cp      r30, r16                ; 1
        cpc     r31, r17                ; 1
        brne    not_due                 ; 1
        lds     r30, TCNT2              ; 2
        in      r31, TIFR2              ; 1
        .global latch_taken
latch_taken:
        sts     latch + 0, r30          ; 2
        sts     latch + 1, r12          ; 2
        sts     latch + 2, r13          ; 2
        sts     latch + 3, r14          ; 2
        sts     latch + 4, r31          ; 2
        sbic    GPIOR0, COUNTERS        ; 2
        rjmp    latch_counters
        sts     latch + 5, r6           ; 2
        sts     latch + 6, r7           ; 2
        sts     latch + 7, r8           ; 2
        sts     latch + 8, r9           ; 2
        sts     latch + 9, r3           ; 2
        sts     latch + 10, r10         ; 2
        sts     latch + 11, r11         ; 2
latched:
        movw    r30, r4                 ; 1
        push    r2                      ; 2
        sei                             ; 1     from here on edges are counted again
        push    r0
        push    r1
        push    r18
        push    r19
        push    r20
        push    r21
        push    r22
        push    r23
        push    r24
        push    r25
        push    r26
        push    r27
        push    r30
        push    r31
        clr     r1
        call    sampled
        pop     r31
        pop     r30
        pop     r27
        pop     r26
        pop     r25
        pop     r24
        pop     r23
        pop     r22
        pop     r21
        pop     r20
        pop     r19
        pop     r18
        pop     r1
        pop     r0
        cli
        pop     r2
        out     SREG, r2
        reti

latch_counters:
        lds     r30, UP_TCNTL           ;       the low byte first: it holds the high one still
        lds     r31, UP_TCNTH
        sts     latch + 5, r30
        sts     latch + 6, r31
        in      r30, TCNT0
        in      r31, TIFR0
        sts     latch + 7, r30
        sts     latch + 8, r9
        sts     latch + 9, r31
        rjmp    latched

; ---- for C -------------------------------------------------------------------------------------------------------------

; void latch_start(void): the registers' first values, before interrupts are enabled
        .global latch_start
latch_start:
        clr     r12
        clr     r13
        clr     r14
        clr     r16
        clr     r17
        clr     r15
        dec     r15
        rjmp    latch_clear

; void latch_clear(void): counters anew; an x4 decoder starts its up counter at the phase of its levels
        .global latch_clear
latch_clear:
        in      r18, SREG
        cli
        clr     r7
        clr     r8
        clr     r9
        clr     r10
        clr     r11
        ldi     r19, AB_INTERRUPTS
        out     EIFR, r19               ; edges before this moment are in the levels read next
        in      r19, AB_PIN
        andi    r19, AB_MASK
        swap    r19                     ; to where the table wants the old levels: bits 7:6, on the Mega 1:0
        mov     r3, r19
        clr     r6
        rcall   phase
        sbic    GPIOR0, COUNTERS
        clr     r19
        mov     r6, r19
        out     SREG, r18
        ret

; void latch_align(void): move the up counter on by less than four, to where it agrees with the levels.  It disagrees
; after illegal transitions only: a board that was powered before its encoder has seen one.
        .global latch_align
latch_align:
        in      r18, SREG
        cli
        rcall   phase
        sub     r19, r6
        add     r19, r8
        andi    r19, 3
        clr     r20
        add     r6, r19
        adc     r7, r20
        out     SREG, r18
        ret

; r19 = phase of the levels in r3: levels ^ (levels >> 1), so that 0 1 3 2 is 0 1 2 3
phase:
        mov     r19, r3
#if AB_MASK != 0x30
        swap    r19                     ; 7:6 to 3:2
        lsr     r19
        lsr     r19
#endif
        andi    r19, 3
        mov     r20, r19
        lsr     r20
        eor     r19, r20
        ret

; uint32_t clock_now(void): device time
        .global clock_now
clock_now:
        in      r18, SREG
        cli
        lds     r22, TCNT2
        in      r19, TIFR2
        mov     r23, r12
        mov     r24, r13
        mov     r25, r14
        out     SREG, r18
        sbrs    r19, TOV2
        ret
        sbrc    r22, 7                  ; the overflow came after the reading
        ret
        subi    r23, 0xff
        sbci    r24, 0xff
        sbci    r25, 0xff
        ret

; void clock_arm(uint32_t due): the next sample is due then.  A match of the register's former value that still waits is
; served in a turn that is not due.
        .global clock_arm
clock_arm:
        in      r18, SREG
        cli
        mov     r16, r23
        mov     r17, r24
        sts     OCR2A, r22
        cbi     GPIOR0, EARLY
        sbrs    r22, 7
        sbi     GPIOR0, EARLY
        out     SREG, r18
        ret
