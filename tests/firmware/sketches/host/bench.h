// What a model of a counter gets from the bench, and what the bench gets from the models.
#pragma once

#include <stdint.h>

namespace bench {
extern void (*edge)();         // called after a pin has changed
extern void (*sample)(void *); // the sketch's timer
extern unsigned period_us;
} // namespace bench
