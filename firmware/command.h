/* What the host says. */

#ifndef COMMAND_H
#define COMMAND_H

#include <stdint.h>

extern uint8_t running;
extern uint8_t block;

void identify(void);
void command_byte(uint8_t byte);

#endif
