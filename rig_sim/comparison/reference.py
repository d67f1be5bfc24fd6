"""Event times to more than 30 digits, by multi-precision arithmetic (mpmath): what the methods are measured against.

Independent of the kernels, with no formula in common: states are (y, w) with y = x - x0 and
w = x' - v_belt, every phase, stick included, is a Taylor series of its own step, and only a steep undriven ramp is
taken as a sum of two exponentials.  On a measured curve a step ends where the slip speed leaves a cubic, whose
coefficients are those of the flow.  A mirrored scene (belt running backwards) is mirrored first.

Not covered: a driven ramp with a fast root (`Uncovered`); slips and touches that begin and end between two of the 32
points at which a step is searched.
"""

import math
from collections.abc import Callable
from typing import Any

import mpmath  # type: ignore[import-untyped]

from rig_sim.flow.flow import Flow
from rig_sim.friction.curve import HYPERBOLIC, LINEAR, MEASURED

DIGITS = 40
ORDER = 44
TOUCH = 1e-26  # distance from an edge within which a value is on it
PLACES = 32
STEEP = 60.0
STEPS_ALLOWED = 200_000

Number = Any  # mpmath.mpf, whose package is not typed
Event = tuple[Number, str, Number]


class Uncovered(Exception):  # noqa: N818  # an answer, not an error
    """The reference does not cover this flow."""


def events(flow: Flow, x: float, v: float, t_max: float) -> list[Event]:
    """Return (time, kind, position) of the events from t = 0 up to t_max, to more than 30 digits of t_max."""
    with mpmath.workdps(DIGITS):
        return _Rig(flow, x, v).run(mpmath.mpf(t_max))


class _Rig:
    """One motion in multi-precision: its constants and its state."""

    def __init__(self, flow: Flow, x: float, v: float) -> None:
        mpf = mpmath.mpf
        self.sign = -1 if flow.v_belt < 0 else 1
        self.m, self.k, self.c, self.V = mpf(flow.m), mpf(flow.k), mpf(flow.c), mpf(abs(flow.v_belt))
        self.A = mpf(flow.Fs) * mpf(flow.factor)
        self.B = self.A * mpf(flow.static)
        self.d = mpf(flow.d) if flow.ramp else mpf(0)
        self.G = mpf(flow.G_slip) * mpf(flow.factor) if flow.curve == LINEAR else mpf(0)
        self.gamma = mpf(flow.gamma) if flow.curve == HYPERBOLIC else mpf(0)
        self.begins: list[Number] = []  # of a measured curve's cubics, and their coefficients
        if flow.curve == MEASURED:
            self.begins = [mpf(s) for s in flow.table[: flow.pieces]]
            powers = [mpf(c) for c in flow.table[flow.pieces : 5 * flow.pieces]]
            self.cubics = [powers[4 * i : 4 * i + 4] for i in range(flow.pieces)]
        self.u0, self.omega, self.phase = self.sign * mpf(flow.u0), mpf(flow.omega), mpf(flow.phase)
        self.t = mpf(0)
        self.x0 = mpf(flow.x0)
        self.y = self.sign * (mpf(x) - self.x0)
        self.w = self.sign * (mpf(v) - mpf(flow.v_belt))
        self.mode = self.first_mode()

    def load(self) -> Number:
        """Return the force that friction must balance in stick, less the break-away level."""
        return self.k * self.y + self.c * self.V - self.u0 * mpmath.cos(self.omega * self.t + self.phase) - self.B

    def first_mode(self) -> str:
        if self.d > 0:
            out = 1 if self.w > 0 else -1
            if abs(self.w) == self.d:  # the ramp's edge: whereto w' points, and w'' where that is 0
                pushed = -out * (self.load() + self.B + self.c * self.w + out * self.B)
                beyond = pushed > 0 or (pushed == 0 and -out * (self.w + self.V) > 0)
            else:
                beyond = abs(self.w) > self.d
            return "R" if not beyond else "N" if out < 0 else "P"
        if self.w != 0:
            return "N" if self.w < 0 else "P"
        return "N" if self.load() > 0 else "P" if self.load() < -2 * self.B else "S"

    def run(self, t_max: Number) -> list[Event]:
        events: list[Event] = []
        first_slip = -1  # the event at which an undriven jump law began to slip from its slip point
        for _i in range(STEPS_ALLOWED):
            if self.t >= t_max:
                return events
            stick_start = self.t
            steep = self.mode == "R" and self.B / self.d / self.m > STEEP
            side = self.cross_ramp() if steep else self.step_series(t_max)
            if side == 0:
                if steep:
                    return events
                continue
            if self.t > t_max:
                return events
            previous, self.mode = self.mode, self.enter(side)
            events.append((self.t, self.letter(previous) + ">" + self.letter(self.mode), self.x0 + self.sign * self.y))
            if self.u0 == 0 and previous == "S" and side > 0 and (self.t > stick_start or abs(self.load()) < TOUCH):
                self.y, self.w = (self.B - self.c * self.V) / self.k, mpmath.mpf(0)
                if first_slip >= 0 and self.t > events[first_slip][0]:
                    return self.repeat(events, first_slip, t_max)
                first_slip = len(events) - 1
        raise Uncovered(f"a run of more than {STEPS_ALLOWED} steps")

    def repeat(self, events: list[Event], first_slip: int, t_max: Number) -> list[Event]:
        """Return the list with its last cycle repeated: every slip of an undriven jump law starts at one point."""
        cycle = events[first_slip + 1 :]
        period = cycle[-1][0] - events[first_slip][0]
        for turn in range(1, int((t_max - events[first_slip][0]) / period) + 1):
            events += [(t + turn * period, kind, x) for t, kind, x in cycle if t + turn * period <= t_max]
        return events

    def letter(self, mode: str) -> str:
        if mode == "R":
            return "S"
        return {"N": "P", "P": "N"}.get(mode, mode) if self.sign < 0 else mode

    def enter(self, side: int) -> str:
        if self.mode in ("R", "S"):
            return "N" if (side < 0) == (self.mode == "R") else "P"
        if self.d > 0:
            return "R"
        load = self.load()
        if self.mode == "N":
            return "P" if load < -2 * self.B - TOUCH else "S"
        return "N" if load > TOUCH else "S"

    def expand(self) -> tuple[list[Number], list[Number], list[Number]]:
        """Return the Taylor coefficients of y, w and of the quantity that the edges bound (w, or in stick the load)."""
        theta = self.omega * self.t + self.phase
        drive = [mpmath.mpf(0)] * (ORDER + 1)
        if self.u0 != 0:
            cosine, sine = mpmath.cos(theta), mpmath.sin(theta)
            size = self.u0
            for n in range(ORDER + 1):
                drive[n] = size * (cosine, -sine, -cosine, sine)[n % 4]
                size *= self.omega / (n + 1)
        y, w = [self.y], [self.w]
        if self.mode == "S":
            zeros = [mpmath.mpf(0)] * (ORDER - 1)
            y, w = [self.y, self.V, *zeros], [mpmath.mpf(0)] * (ORDER + 1)
            load = [self.k * a - b for a, b in zip(y, drive, strict=True)]
            load[0] += self.c * self.V
            return y, w, load
        out = 1 if self.mode == "P" else -1  # s = out w - d
        s, q = [out * self.w - self.d], [1 / (1 + self.gamma * (out * self.w - self.d))]
        if self.begins and self.mode != "R":
            return self.expand_on_cubic(y, w, s, out, drive)
        for n in range(ORDER):
            if self.mode == "R":
                force = -self.B / self.d * w[n]
            elif self.gamma != 0:
                force = -out * self.A * q[n]
            else:
                force = -out * ((self.A if n == 0 else 0) - self.G * s[n])
            belt = self.V if n == 0 else 0
            y.append((w[n] + belt) / (n + 1))
            w.append((-self.c * (w[n] + belt) - self.k * y[n] + force + drive[n]) / self.m / (n + 1))
            s.append(out * w[n + 1])
            if self.gamma != 0:
                q.append(-self.gamma * q[0] * mpmath.fdot(zip(s[1:], reversed(q), strict=True)))
        return y, w, w

    def expand_on_cubic(
        self, y: list[Number], w: list[Number], s: list[Number], out: int, drive: list[Number]
    ) -> tuple[list[Number], list[Number], list[Number]]:
        """Return the same as `expand`, for slip on the measured curve's cubic at, or entered at, the slip speed."""
        for i in range(len(self.begins)):
            if self.begins[i] - TOUCH > s[0]:
                break
            self.cubic = i
        begin = self.begins[self.cubic]
        if self.cubic and abs(s[0] - begin) <= TOUCH:  # on an edge: s' decides, or s'' where that is 0
            value = self.cubics[self.cubic][0]
            rate = (-self.c * (w[0] + self.V) - self.k * y[0] - out * self.A * value + drive[0]) * out
            if rate < -TOUCH or (abs(rate) <= TOUCH and -out * (w[0] + self.V) < 0):
                self.cubic -= 1
                begin = self.begins[self.cubic]
        z, square, cube = [s[0] - begin], [], []
        c0, c1, c2, c3 = self.cubics[self.cubic]
        for n in range(ORDER):
            square.append(mpmath.fdot(zip(z, reversed(z), strict=True)))
            cube.append(mpmath.fdot(zip(square, reversed(z), strict=True)))
            force = -out * self.A * ((c0 if n == 0 else 0) + c1 * z[n] + c2 * square[n] + c3 * cube[n])
            belt = self.V if n == 0 else 0
            y.append((w[n] + belt) / (n + 1))
            w.append((-self.c * (w[n] + belt) - self.k * y[n] + force + drive[n]) / self.m / (n + 1))
            z.append(out * w[n + 1])
        return y, w, w

    def step_series(self, t_max: Number) -> int:
        """Advance one step, or to the edge within it; return the side of the exit, 0 inside."""
        y, w, bounded = self.expand()
        h = t_max - self.t
        size = max(abs(bounded[0]), abs(bounded[1]), abs(y[0]), mpmath.mpf(10) ** -20)
        for c in (w, y, bounded):
            for j in (ORDER - 1, ORDER):
                if c[j] != 0:
                    ratio = (float(mpmath.log(size)) - (DIGITS + 1) * math.log(10) - float(mpmath.log(abs(c[j])))) / j
                    h = min(h, mpmath.exp(ratio))
        lo, hi = {
            "S": (-self.B, self.B), "R": (-self.d, self.d), "N": (-mpmath.inf, -self.d), "P": (self.d, mpmath.inf),
        }[self.mode]  # fmt: skip
        first: tuple[int, Number] = (0, h)
        for side, edge in ((1, hi), (-1, lo)):
            if not mpmath.isinf(edge):
                tau_edge = find_crossing([side * bounded[0] - side * edge, *(side * c for c in bounded[1:])], first[1])
                if tau_edge is not None:
                    first = (side, tau_edge)
        if self.begins and self.mode in ("N", "P"):
            out = 1 if self.mode == "P" else -1
            slip = [out * bounded[0] - self.d, *(out * c for c in bounded[1:])]
            ends = [(-1, self.begins[self.cubic])] if self.cubic else []
            ends += [(1, self.begins[self.cubic + 1])] if self.cubic + 1 < len(self.begins) else []
            for side, edge in ends:
                tau_edge = find_crossing([side * slip[0] - side * edge, *(side * c for c in slip[1:])], first[1])
                if tau_edge is not None and tau_edge > 0:
                    first = (0, tau_edge)
        side, tau = first
        self.y, self.w = horner(y, tau), horner(w, tau)
        self.t += tau
        if side and self.mode != "S":
            self.w = hi if side > 0 else lo
        return side

    def cross_ramp(self) -> int:
        """Advance to the end of an undriven steep ramp; return the side of the exit, 0 without one."""
        if self.u0 != 0:
            raise Uncovered("a driven ramp with a fast root")
        b = (self.c + self.B / self.d) / self.m
        root = mpmath.sqrt(b * b - 4 * self.k / self.m)
        r1, r2 = (-b - root) / 2, -2 * self.k / self.m / (b + root)
        rest = self.B / self.d * self.V / self.k
        P = (self.w + self.V - r2 * (self.y - rest)) / (r1 - r2)
        Q = self.y - rest - P

        def w(tau: Number) -> Number:
            return P * r1 * mpmath.exp(r1 * tau) + Q * r2 * mpmath.exp(r2 * tau) - self.V

        ratio = -Q * r2 * r2 / (P * r1 * r1) if P != 0 else mpmath.mpf(0)
        turn = mpmath.log(ratio) / (r1 - r2) if ratio > 0 else mpmath.mpf(0)
        start = mpmath.mpf(0)
        for end in (turn, 2000 / -r2):
            if end <= start:
                continue
            for side, edge in ((1, self.d), (-1, -self.d)):
                if side * (w(end) - edge) > 0:
                    tau = bisect(lambda tau: side * (w(tau) - edge), start, end)  # noqa: B023
                    self.y, self.w = rest + P * mpmath.exp(r1 * tau) + Q * mpmath.exp(r2 * tau), edge
                    self.t += tau
                    return side
            start = end
        return 0


def bisect(function: Callable[[Number], Number], inside: Number, outside: Number) -> Number:
    """Return where the function, negative inside, turns positive on a monotone piece."""
    for _i in range(400):
        middle = (inside + outside) / 2
        if middle in (inside, outside):
            break
        if function(middle) > 0:
            outside = middle
        else:
            inside = middle
    return outside


def find_crossing(g: list[Number], end: Number) -> Number | None:
    """Return the first tau in [0, end] where the polynomial rises above 0 or touches it; it is <= 0 inside."""
    while abs(g[0]) < TOUCH:  # on the edge: take the next root
        g = g[1:]
        if len(g) < 3:
            return None
        if g[0] > TOUCH:
            return mpmath.mpf(0)
    slope = [j * c for j, c in enumerate(g)][1:]
    scale = float(end)
    rough = [float(c * end**j) for j, c in enumerate(g)]
    rough_slope = [j * c for j, c in enumerate(rough)][1:]
    before, falling = 0.0, horner(rough_slope, 0.0) <= 0.0
    for i in range(1, PLACES + 1):
        xi = i / PLACES
        g_here, slope_here = horner(rough, xi), horner(rough_slope, xi)
        if g_here > 0.0:
            return polish(g, slope, before * scale, xi * scale)
        if not falling and slope_here <= 0.0:  # a maximum between: does it reach the edge?
            curvature = [j * c for j, c in enumerate(slope)][1:]
            top = polish([-c for c in slope], [-c for c in curvature], before * scale, xi * scale)
            height = horner(g, top)
            if abs(height) <= TOUCH:
                return top
            if height > 0:
                return polish(g, slope, before * scale, float(top))
        before, falling = xi, slope_here <= 0.0
    return None


def polish(g: list[Number], slope: list[Number], inside: float, outside: float) -> Number:
    """Return the root between: bisection, then Newton's steps in full precision."""
    low, high = mpmath.mpf(inside), mpmath.mpf(outside)
    for _i in range(24):
        middle = (low + high) / 2
        if horner(g, middle) > 0:
            high = middle
        else:
            low = middle
    tau = (low + high) / 2
    for _i in range(8):
        step = horner(g, tau) / horner(slope, tau)
        tau -= step
        if abs(step) < mpmath.mpf(10) ** -(DIGITS - 4):
            break
    return tau


def horner(c: list[Number], x: Number) -> Number:
    """Return the polynomial with coefficients ``c``, lowest power first, in floats or multi-precision."""
    total = 0 * c[0]
    for number in reversed(c):
        total = total * x + number
    return total
