"""The load that a board and its line can carry, checked before a recording starts.

Line: 8N1, so 10 bits a byte.  A frame of n samples is 15 + 7 n bytes on the line, 2 n more for each optional column.
"""

from daq.protocols.session import Plan
from daq.runfile.rig import Rig
from daq.wire import frames
from daq.wire.counters import longest_gap_s
from daq.wire.quadrature import EDGES_PER_COUNT
from stickslip.errors import InputError

BITS_PER_BYTE = 10
TIGHT = 0.95  # load of the line or the decoder, relative to its limit, from which there is a warning
SLIP_OVER_BELT = 4.0  # top speed of a slipping mass over the belt's, at most (3.6 on the thesis's rig)
LONGEST_BLOCK_S = 0.05  # longest delay of a sample in its frame, so that a live view stays live


def choose_block_size(ident: frames.Ident, rate_hz: float) -> int:
    """Return how many samples to put into a frame: blocks unless they cause a delay, single frames below 40 Hz."""
    if frames.Capability.BLOCKS not in ident.capabilities:
        return 1
    return max(1, min(8, int(rate_hz * LONGEST_BLOCK_S)))


def compute_load(ident: frames.Ident, rate_hz: float, block: int) -> float:
    """Return the load on the line, bytes/s."""
    optional = (frames.Capability.BELT in ident.capabilities) + (frames.Capability.EDGE_TIME in ident.capabilities)
    payload = frames.SAMPLES_HEADER + block * (7 + 2 * optional) + 2
    return rate_hz / block * (payload + 1 + payload // 254 + 1)


def check(ident: frames.Ident, rig: Rig, plan: Plan, baud: int | None) -> list[str]:
    """Return warnings about a recording that this board, its decoder and its line can just carry.

    ``baud`` is bits per second of the line; None if it has no such limit (USB, a socket, the simulated rig).  Raises
    InputError, with a possible value, if the recording cannot work.
    """
    rate_hz = plan.rate_hz
    if rate_hz > ident.max_rate_hz:
        what = f"{rate_hz:g} Hz exceeds the board's maximum, {ident.max_rate_hz} Hz"
        most = ident.max_rate_hz
        raise InputError(what, "--rate", f"use --rate {most} or less", python=f"use rate_hz={most} or less")
    _check_roll_over(ident, rig, rate_hz)
    warnings = _check_edges(ident, rig)
    if baud is not None:
        load = plan.bytes_per_s
        room = baud / BITS_PER_BYTE
        most = int(rate_hz * room / load)
        load_text = (
            f"{rate_hz:g} Hz in frames of {plan.block} is {load:.0f} bytes/s; {baud} baud can transfer {room:.0f}"
        )
        if load > room and plan.comes_already:
            return warnings  # more than a serial line carries: its baud rate is only a name, as with native USB
        if load > room:
            do = "use {} or less, or a faster line"
            raise InputError(load_text, "--rate", do.format(f"--rate {most}"), python=do.format(f"rate_hz={most}"))
        if load > TIGHT * room:
            warnings.append(f"{load_text}. There is no reserve; at {int(TIGHT * most)} Hz there would be one")
    return warnings


def belt_edge_rate_hz(rig: Rig) -> float:
    """Return the edges per second at the belt's speed, which the mass has in every stick; 0 if unknown."""
    if rig.belt_speed is None or rig.metres_per_count is None:
        return 0.0
    return abs(rig.belt_speed.value / rig.metres_per_count.value) * EDGES_PER_COUNT.get(rig.decoder, 1)


def peak_edge_rate_hz(ident: frames.Ident | None, rig: Rig, seen_hz: float) -> float:
    """Return a bound on the edge rate that a gap may have hidden: infinite if nothing bounds it.

    Twice the fastest observed rate or `SLIP_OVER_BELT` belt speeds, whichever is more, and at most what the decoder
    follows.
    """
    declared = ident.max_edge_rate_hz if ident is not None and ident.max_edge_rate_hz else float("inf")
    motion = max(2 * seen_hz, SLIP_OVER_BELT * belt_edge_rate_hz(rig))
    return min(declared, motion) if motion > 0 else declared


def _check_roll_over(ident: frames.Ident, rig: Rig, rate_hz: float) -> None:
    belt = belt_edge_rate_hz(rig)
    if belt == 0:
        return
    safe = longest_gap_s(peak_edge_rate_hz(ident, rig, 0.0), EDGES_PER_COUNT.get(rig.decoder, 1), ident.counter_bits)
    if frames.Capability.BELT in ident.capabilities and rig.belt_speed and rig.belt_metres_per_count:
        counts_per_s = abs(rig.belt_speed.value / rig.belt_metres_per_count.value)
        safe = min(safe, longest_gap_s(2 * counts_per_s, 1, ident.counter_bits - 1))
    if 1 / rate_hz >= safe:
        what = f"{rate_hz:g} Hz is too slow: the {ident.counter_bits}-bit counters may roll over in {safe:.3g} s"
        least = int(1 / safe) + 1
        raise InputError(what, "--rate", f"use --rate {least} or more", python=f"use rate_hz={least} or more")


def _check_edges(ident: frames.Ident, rig: Rig) -> list[str]:
    """Return a warning if a slip would exceed the decoder; no error, since the speed is known only after the run."""
    peak = SLIP_OVER_BELT * belt_edge_rate_hz(rig)
    if peak <= ident.max_edge_rate_hz or ident.max_edge_rate_hz == 0:
        return []
    return [
        f"a slip may reach {peak:.0f} edges/s ({SLIP_OVER_BELT:g} belt speeds), but this board can follow "
        f"only {ident.max_edge_rate_hz}. Counts may be lost. Check the illegal count, or use an encoder with "
        "fewer lines"
    ]
