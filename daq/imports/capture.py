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


def choose_wiring(capture: Capture, options: ProbeOptions) -> Wiring:
    step, direction, decoder = options.step, options.direction, options.decoder
    pair = "use --channels A=NAME,B=NAME, or --step NAME --dir NAME"
    if options.channels is not None:
        if step is not None or direction is not None:
            raise InputError("--channels cannot be combined with --step or --dir", "command line", pair)
        decoder = "x4" if decoder is None else decoder
        check_known(decoder, DECODERS, "decoder", "--decoder")
        probes, flags, kinds = _split_pair(options.channels), ("--channels", "--channels"), "A and B"
    elif step is None or direction is None:
        raise InputError("which probes are the signals? the capture has: " + capture.listed, str(capture.path), pair)
    elif decoder is not None:
        raise InputError("step and direction need no decoder", "--decoder", "omit it, or use --channels")
    else:
        probes, flags, kinds, decoder = (step, direction), ("--step", "--dir"), "step and direction", TWO_COUNTER
    bits = (capture.bit(probes[0], flags[0]), capture.bit(probes[1], flags[1]))
    if bits[0] == bits[1]:
        raise InputError(f"{kinds} are the same probe", flags[1], pair)
    return Wiring(bits, decoder)


def decode_chunks(capture: Capture, wiring: Wiring) -> Iterator[tuple[NDArray[np.uint8], Steps, Totals]]:
    """Yield the levels of each chunk (A + 2 B, or step + 2 direction), the steps in it, and the totals after it."""
    decoder = _make_decoder(wiring)
    for levels in capture.levels(*wiring.bits):
        yield levels, decoder.feed(levels), _read_totals(decoder)


def decode(capture: Capture, wiring: Wiring, progress: Callable[[float], None] = lambda done: None) -> Totals:
    """Decode a whole capture; ``progress`` is called with the number of samples decoded."""
    decoder = _make_decoder(wiring)
    done = 0
    for levels in capture.levels(*wiring.bits):
        decoder.count(levels)
        done += levels.size
        progress(done)
    return _read_totals(decoder)


def _make_decoder(wiring: Wiring) -> Decoder | PulseDecoder:
    return PulseDecoder() if wiring.decoder == TWO_COUNTER else Decoder(wiring.decoder)


def _read_totals(decoder: Decoder | PulseDecoder) -> Totals:
    return Totals(decoder.up, decoder.down, decoder.net, decoder.illegal, decoder.edges)


def _split_pair(channels: str) -> tuple[str, str]:
    names = dict(part.split("=", 1) for part in channels.split(",") if "=" in part)
    names = {key.strip().upper(): value.strip() for key, value in names.items()}
    if set(names) != {"A", "B"} or channels.count(",") != 1:
        raise InputError(f"{channels!r} does not name two probes", "--channels", "write A=NAME,B=NAME")
    return names["A"], names["B"]
