"""Counts out of a logic-analyser capture: a quadrature pair or step and direction lines, decoded as a stream.

Counted are the changes of the sampled levels, every one of them; the capture's first sample only sets the state.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.imports.options import ProbeOptions
from daq.imports.sigrok import Capture
from daq.wire.quadrature import DECODERS, Decoder, PulseDecoder, Steps
from stickslip.errors import InputError, check_known

TWO_COUNTER = "two-counter"


@dataclass(frozen=True)
class Wiring:
    """Which probes carry the pair, and what decodes it."""

    bits: tuple[int, int]  # (int, int) probes of A and B, or of step and direction
    decoder: str  # one of `daq.wire.quadrature.DECODERS`, or "two-counter" for step and direction


@dataclass(frozen=True)
class Totals:
    """What a capture decoded to; ``net`` is up minus down, ``edges`` the changes of level, or the rises of step."""

    up: int
    down: int
    net: int
    illegal: int
    edges: int


def wiring(capture: Capture, options: ProbeOptions) -> Wiring:
    """Return the wiring given by the flags --channels, or --step and --dir.

    Raises InputError: for missing or mixed flags, an unknown decoder, or a probe that the capture does not have.
    """
    channels, step, direction, decoder = options.channels, options.step, options.direction, options.decoder
    pair = "give --channels A=NAME,B=NAME or --step NAME --dir NAME"
    if channels is not None and (step is not None or direction is not None):
        raise InputError("--channels and --step or --dir exclude each other", "command line", pair)
    if channels is not None:
        decoder = "x4" if decoder is None else decoder
        check_known(decoder, DECODERS, "decoder", "--decoder")
        a, b = _pair(channels)
        bits = (capture.bit(a, "--channels"), capture.bit(b, "--channels"))
        if bits[0] == bits[1]:
            raise InputError("A and B are the same probe", "--channels", pair)
        return Wiring(bits, decoder)
    if step is None or direction is None:
        listed = ", ".join(f"{bit} {name}" for bit, name in capture.probes.items())
        raise InputError("which probes? the capture has: " + listed, str(capture.path), pair)
    if decoder is not None:
        raise InputError("step and direction need no decoder", "--decoder", "leave it out, or give --channels")
    bits = (capture.bit(step, "--step"), capture.bit(direction, "--dir"))
    if bits[0] == bits[1]:
        raise InputError("step and direction are the same probe", "--dir", pair)
    return Wiring(bits, TWO_COUNTER)


def walk(capture: Capture, wired: Wiring) -> Iterator[tuple[NDArray[np.uint8], Steps, Totals]]:
    """Yield each chunk's levels (A + 2 B, or step + 2 direction), the steps in it, and the totals after it."""
    quadrature = Decoder(wired.decoder) if wired.decoder != TWO_COUNTER else None
    pulses = PulseDecoder()
    for levels in capture.levels(*wired.bits):
        if quadrature is not None:
            steps = quadrature.feed(levels)
        else:
            steps = pulses.feed(levels & 1, levels >> 1)
        yield levels, steps, _totals(quadrature, pulses)


def decode(capture: Capture, wired: Wiring, progress: Callable[[float], None] = lambda done: None) -> Totals:
    """Decode a whole capture; ``progress`` is called with the number of samples done."""
    quadrature = Decoder(wired.decoder) if wired.decoder != TWO_COUNTER else None
    pulses = PulseDecoder()
    done = 0
    for levels in capture.levels(*wired.bits):
        if quadrature is not None:
            quadrature.count(levels)
        else:
            pulses.feed(levels & 1, levels >> 1)
        done += levels.size
        progress(done)
    return _totals(quadrature, pulses)


def _totals(quadrature: Decoder | None, pulses: PulseDecoder) -> Totals:
    if quadrature is None:
        return Totals(pulses.up, pulses.down, pulses.net, 0, pulses.edges)
    return Totals(quadrature.up, quadrature.down, quadrature.net, quadrature.illegal, quadrature.edges)


def _pair(channels: str) -> tuple[str, str]:
    names = dict(part.split("=", 1) for part in channels.split(",") if "=" in part)
    names = {key.strip().upper(): value.strip() for key, value in names.items()}
    if set(names) != {"A", "B"} or channels.count(",") != 1:
        raise InputError(f"{channels!r} does not name a pair", "--channels", "write A=NAME,B=NAME")
    return names["A"], names["B"]
