"""Kernels for exactly one scene each: the same algorithm as the engine's, holding only the terms that the scene has.

`specialised` writes a kernel down with some terms; those that a scene lacks are constants False here, removed before
compiling, so that the machine code holds nothing of them: no frame, no mirror, no modes that the law does not have, no
sampling, no counting of steps, no counting of references, and what is the same in every phase worked out once.  The
closed form of linear motion, which holds no term of any scene, is the engine's own (`rig_sim.integrate.linear`).

Coordinates are the engine's: p = x - x_slip and w = x' - v, the belt running forwards.  Not here: bounds of any kind.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from hand.polynomial import (
    INVERSE,
    ORDER,
    D,
    P,
    Q,
    U,
    changes,
    deflated,
    first_root,
    polish,
    reach,
    survey,
)
from numba import njit
from numba.extending import register_jitable

from rig_sim.integrate.compiled import JIT_OPTIONS, KERNEL_MODULES, unbox_records
from rig_sim.integrate.linear import FreeMotion, change, fundamental, linear_exit, stick_lateness
from rig_sim.integrate.newton import EPS, newton_step
from rig_sim.integrate.phases import sum_of
from rig_sim.integrate.work import unboxed
from stickslip.compute.compile import register

STICK, NEGATIVE, POSITIVE, RAMP, KICK = 0, 1, 2, 3, 99
LEAST_FACTOR = 0.05
SETTLED = 64.0 * EPS


class Constants(NamedTuple):
    """A scene's numbers; a kernel reads those of its terms."""

    m: float
    k: float
    c: float
    v: float
    Fs: float
    static: float
    G: float
    gamma: float
    d: float
    u0: float
    omega: float
    phase: float
    lag: float
    wear: float
    kick: float
    turn: float


class Terms(NamedTuple):
    """What a scene has."""

    hyperbola: bool = False
    linear: bool = False
    ramp: bool = False
    damper: bool = False
    drive: bool = False
    droop: bool = False
    static: bool = False
    levels: bool = False  # scatter or wear
    joint: bool = False


def specialised(terms: Terms) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the kernel of these terms, interpreted and compiled.

    It is called with (constants, p, w, t_max, factors, out_t, out_x, out_kind, work, spare) and returns the number of
    events; ``spare`` is the engine's record, in which the closed form leaves what it knows at an exit.
    """
    hyperbola, linear, ramp, damper, drive, droop, static, levels, joint = terms
    has_edge = ramp or droop
    series_slip = hyperbola or drive

    @register_jitable
    def pull(con, t):
        return con.u0 * math.cos(con.omega * t + con.phase)

    @register_jitable
    def slowness(con, r):
        linear_part = 1.0 - con.lag - con.gamma * r
        root = math.sqrt(linear_part * linear_part + 4.0 * con.gamma * r)
        return 2.0 * r / (root + linear_part) if linear_part > 0.0 else (root - linear_part) / (2.0 * con.gamma)

    @register_jitable
    def slip_series(con, A, B, sign, p, w, t, work):
        """Fill the series of a slip; return (scaled step, unit of time)."""
        s = max(-sign * w - con.d, 0.0) if has_edge else max(-sign * w, 0.0)
        if droop:
            s = slowness(con, s)
        force = -con.k * p
        if static:
            force += sign * A - B
        elif sign < 0.0:
            force -= A + B
        if linear:
            force += -sign * con.G * s
        if damper:
            force -= con.c * w
        if drive:
            force += pull(con, t)
        q0 = 1.0
        fall = 0.0
        if hyperbola:
            q0 = 1.0 + con.gamma * s
            fall = -sign * A * con.gamma * s / q0
            force += fall
        a = force / con.m
        if s == 0.0:
            a = min(a, 0.0) if sign > 0.0 else max(a, 0.0)
        u = w + con.v
        omega2 = con.k / con.m
        rate = math.sqrt(omega2)
        C = 0.0
        if damper:
            C = con.c
        if linear:
            C -= con.G
        if damper or linear:
            rate += abs(C) / con.m
        if hyperbola:
            slope = A * con.gamma / (q0 * q0 - con.lag) if droop else A * con.gamma / (q0 * q0)
            rate += slope / con.m + (con.gamma * abs(a) + math.sqrt(con.gamma * omega2 * abs(u))) / q0
            if damper and not drive:
                resting = abs(u) <= SETTLED * con.v and con.m * abs(a) <= SETTLED * (B + con.k * abs(p))
                if C >= slope and resting:
                    return math.inf, 1.0
        if drive:
            rate += con.omega
        T = 1.0 / rate
        inertia = T / con.m
        stiffness = con.k * inertia
        damping = C * inertia
        work[0] = w
        work[P] = p
        work[1] = a * T
        work[P + 1] = u * T
        if drive:
            turn = con.omega * T
            work[U] = inertia * pull(con, t)
            work[U + 1] = -inertia * con.u0 * math.sin(con.omega * t + con.phase) * turn
            for j in range(2, ORDER):
                work[U + j] = -turn * turn * work[U + j - 2] * (INVERSE[j] * INVERSE[j - 1])
        if droop and hyperbola:
            bend = -sign * con.gamma / q0
            work[D] = inertia * fall
            level = sign * inertia * A + work[D]
            hold = con.lag / (q0 * sign * inertia * A)
            gain = 1.0 / (1.0 - hold * level)
            for n in range(1, ORDER):
                straight = bend * work[n]
                total = straight * level
                i = D + n - 1
                whole = Q + n - (n - 1) % 4
                for j in range(Q + 1, whole, 4):
                    total += (work[j] * work[i] + work[j + 1] * work[i - 1]) + (
                        work[j + 2] * work[i - 2] + work[j + 3] * work[i - 3]
                    )
                    i -= 4
                for j in range(whole, Q + n):
                    total += work[j] * work[i]
                    i -= 1
                drawn = -total * gain
                work[D + n] = drawn
                work[Q + n] = straight - hold * drawn
                rest = drawn - stiffness * work[P + n]
                if damper:
                    rest -= damping * work[n]
                if drive:
                    rest += work[U + n]
                work[n + 1] = rest * INVERSE[n + 1]
                work[P + n + 1] = T * work[n] * INVERSE[n + 1]
        elif hyperbola:
            bend = -sign * con.gamma / q0
            work[D] = inertia * fall
            level = sign * inertia * A + work[D]
            work[Q + 1] = bend * work[1]
            for n in range(1, ORDER):
                total = 0.0
                i = D + n - 1
                whole = Q + n - (n - 1) % 4
                for j in range(Q + 1, whole, 4):
                    total += (work[j] * work[i] + work[j + 1] * work[i - 1]) + (
                        work[j + 2] * work[i - 2] + work[j + 3] * work[i - 3]
                    )
                    i -= 4
                for j in range(whole, Q + n):
                    total += work[j] * work[i]
                    i -= 1
                drawn = -(total + work[Q + n] * level)
                rest = -stiffness * work[P + n]
                if damper:
                    rest -= damping * work[n]
                if drive:
                    rest += work[U + n]
                following = (rest + drawn) * INVERSE[n + 1]
                work[D + n] = drawn
                work[n + 1] = following
                work[Q + n + 1] = bend * following
                work[P + n + 1] = T * work[n] * INVERSE[n + 1]
        else:
            for n in range(1, ORDER):
                rest = -stiffness * work[P + n]
                if damper or linear:
                    rest -= damping * work[n]
                if drive:
                    rest += work[U + n]
                work[n + 1] = rest * INVERSE[n + 1]
                work[P + n + 1] = T * work[n] * INVERSE[n + 1]
        return reach(work), T

    @register_jitable
    def ramp_series(con, B, p, w, t, work):
        """Fill the series of a driven ramp; return (scaled step, unit of time)."""
        C = B / con.d
        if damper:
            C += con.c
        a = (-C * w - con.k * p - B + pull(con, t)) / con.m
        if w == con.d:
            a = min(a, 0.0)
        elif w == -con.d:
            a = max(a, 0.0)
        T = 1.0 / (math.sqrt(con.k / con.m) + C / con.m + con.omega)
        inertia = T / con.m
        work[0] = w
        work[P] = p
        work[1] = a * T
        work[P + 1] = (w + con.v) * T
        turn = con.omega * T
        work[U] = inertia * pull(con, t)
        work[U + 1] = -inertia * con.u0 * math.sin(con.omega * t + con.phase) * turn
        for j in range(2, ORDER):
            work[U + j] = -turn * turn * work[U + j - 2] * (INVERSE[j] * INVERSE[j - 1])
        for n in range(1, ORDER):
            work[n + 1] = (work[U + n] - C * inertia * work[n] - con.k * inertia * work[P + n]) * INVERSE[n + 1]
            work[P + n + 1] = T * work[n] * INVERSE[n + 1]
        return reach(work), T

    @register_jitable
    def load_root(con, p, theta, level, side, inside, outside):
        """Return where k (p + v tau) - drive crosses ``level`` on a monotone piece."""
        tau = 0.5 * (inside + outside)
        for _i in range(100):
            angle = theta + con.omega * tau
            error = con.k * (p + con.v * tau) - con.u0 * math.cos(angle) - level
            if error == 0.0:
                return tau
            if side * error > 0.0:
                outside = tau
            else:
                inside = tau
            slope = con.k * con.v + con.u0 * con.omega * math.sin(angle)
            tau, settled = newton_step(tau, error, slope, inside, outside)
            if settled:
                return tau
        return tau

    @register_jitable
    def driven_stick(con, B, p, t):
        """Return (side, tau) of a driven stick: closed-form extremes, then one root."""
        theta = con.omega * t + con.phase
        rise = con.k * con.v
        start = con.k * p - con.u0 * math.cos(theta)
        slope = rise + con.u0 * con.omega * math.sin(theta)
        if start < -2.0 * B or (start == -2.0 * B and slope < 0.0):
            return -1, 0.0
        if start > 8.0 * EPS * (B + con.u0) or (start >= 0.0 and slope > 0.0):
            return 1, 0.0
        if con.u0 * con.omega <= rise:
            end = max((con.u0 / con.k - p) / con.v * (1.0 + 4.0 * EPS), 0.0) + 4.0 * EPS * con.u0 / rise
            return 1, load_root(con, p, theta, 0.0, 1, 0.0, end)
        period = 2.0 * math.pi / con.omega
        tilt = math.asin(rise / (con.u0 * con.omega))
        highest = (math.pi + tilt - theta) / con.omega
        highest -= math.floor(highest / period) * period
        lowest = (-tilt - theta) / con.omega
        lowest -= math.floor(lowest / period) * period
        falling = (math.pi - 2.0 * tilt) / con.omega
        top = con.k * (p + con.v * highest) - con.u0 * math.cos(theta + con.omega * highest)
        if highest < lowest and top > 0.0:
            return 1, load_root(con, p, theta, 0.0, 1, 0.0, highest)
        if con.k * (p + con.v * lowest) - con.u0 * math.cos(theta + con.omega * lowest) < -2.0 * B:
            return -1, load_root(con, p, theta, -2.0 * B, -1, max(0.0, lowest - falling), lowest)
        turns = max(0.0, math.ceil(-top / (rise * period)) - 1.0)
        while True:
            peak = highest + turns * period
            if con.k * (p + con.v * peak) - con.u0 * math.cos(theta + con.omega * peak) > 0.0:
                return 1, load_root(con, p, theta, 0.0, 1, max(0.0, peak - (period - falling)), peak)
            turns += 1.0

    @register_jitable
    def solution(zeta, omega2, disc, tau, spare):
        if tau == spare.exit:
            return spare.exit_s, spare.exit_e
        S, E, _ = fundamental(zeta, omega2, disc, tau)
        return S, E

    def kernel(con, p, w, t_max, factors, out_t, out_x, out_kind, work, spare):
        spare = unboxed(spare)
        A = con.Fs
        B = con.static * A if static else A
        slip = (B - con.c * con.v) / con.k if damper else B / con.k
        edge = con.d if has_edge else 0.0
        omega2 = con.k / con.m
        omega0 = math.sqrt(omega2)
        # closed-form constants of the linear phases
        C_slip = con.c if damper else 0.0
        if linear:
            C_slip -= con.G
        zeta_slip = 0.5 * C_slip / con.m
        disc_slip = (zeta_slip - omega0) * (zeta_slip + omega0)
        C_ramp = zeta_ramp = disc_ramp = 0.0
        if has_edge:
            C_ramp = B / con.d + con.c if damper else B / con.d
            zeta_ramp = 0.5 * C_ramp / con.m
            disc_ramp = (zeta_ramp - omega0) * (zeta_ramp + omega0)
        reversal = con.d + A / con.G if linear else math.inf
        t = 0.0
        carry = p_rest = w_rest = 0.0
        count = 0
        drawn = 0
        kicks = 0
        t_end = t_max
        if joint:
            t_end = min(t_max, con.turn)
        if has_edge:
            mode = NEGATIVE if w < -edge else POSITIVE if w > edge else RAMP
        else:
            mode = NEGATIVE if w < 0.0 else POSITIVE if w > 0.0 else STICK
        while True:
            sign = 1.0 if mode == NEGATIVE else -1.0
            rest = (t_end - t) - carry
            side = 0
            late = 0.0
            if mode == STICK:
                if drive:
                    side, tau = driven_stick(con, B, p, t)
                    if tau > rest:
                        side, tau = 0, rest
                    p += con.v * tau
                elif p >= 0.0:
                    side, tau = 1, 0.0
                elif -p <= con.v * rest:
                    side, tau = 1, -p / con.v
                    late = stick_lateness(con, p, p_rest, tau)
                    p = 0.0
                else:
                    tau = rest
                    p += con.v * tau
                w = 0.0
            elif mode == RAMP and not drive:
                a = (-C_ramp * w - con.k * p - B) / con.m
                if w == edge:
                    a = min(a, 0.0)
                elif w == -edge:
                    a = max(a, 0.0)
                u = w + con.v
                spare.late = 0.0
                side, tau = linear_exit(
                    FreeMotion(w, a, u, zeta_ramp, omega2, disc_ramp), -edge, edge, rest, 0.0, spare
                )
                S, E = solution(zeta_ramp, omega2, disc_ramp, tau, spare)
                dp, dw = change(a, u, zeta_ramp, omega2, S, E)
                p, p_rest = sum_of(p, p_rest, dp)
                w, w_rest = sum_of(w, w_rest, dw)
                late = spare.late
                if side != 0:
                    w = edge if side > 0 else -edge
            elif mode == RAMP:
                step, T = ramp_series(con, B, p, w, t, work)
                xi = min(step, rest / T)
                root = first_root(work, edge, 1, xi)
                if root >= 0.0:
                    side, xi = 1, root
                root = first_root(work, -edge, -1, xi)
                if root >= 0.0:
                    side, xi = -1, root
                tau = min(xi * T, rest)
                dp, dw = changes(work, xi)
                p, p_rest = sum_of(p, p_rest, dp)
                w, w_rest = sum_of(w, w_rest, dw)
                if side != 0:
                    w = edge if side > 0 else -edge
            elif series_slip:
                step, T = slip_series(con, A, B, sign, p, w, t, work)
                if math.isinf(step):
                    return count
                xi = min(step, rest / T)
                inner = int(sign)
                root = first_root(work, -sign * edge, inner, xi)
                if root >= 0.0:
                    side, xi = inner, root
                if linear:
                    root = first_root(work, -sign * reversal, -inner, xi)
                    if root >= 0.0:
                        return count
                tau = min(xi * T, rest)
                dp, dw = changes(work, xi)
                p, p_rest = sum_of(p, p_rest, dp)
                w, w_rest = sum_of(w, w_rest, dw)
                if side != 0:
                    w = -sign * edge
            else:
                force = -C_slip * w - con.k * p + (sign * A - B)
                if linear and has_edge:
                    force += sign * con.G * con.d
                a = force / con.m
                if w == -sign * edge:
                    a = min(a, 0.0) if sign > 0.0 else max(a, 0.0)
                u = w + con.v
                lo, hi = (-reversal, -edge) if sign > 0.0 else (edge, reversal)
                touch = 0.0 if has_edge else 4.0 * EPS
                spare.late = 0.0
                side, tau = linear_exit(FreeMotion(w, a, u, zeta_slip, omega2, disc_slip), lo, hi, rest, touch, spare)
                S, E = solution(zeta_slip, omega2, disc_slip, tau, spare)
                dp, dw = change(a, u, zeta_slip, omega2, S, E)
                p, p_rest = sum_of(p, p_rest, dp)
                w, w_rest = sum_of(w, w_rest, dw)
                late = spare.late
                if side != 0:
                    w = hi if side > 0 else lo
                    if (side > 0) != (sign > 0.0):
                        return count
            total = t + tau
            carry += (t - total) + tau if t >= tau else (tau - total) + t
            t = total
            if side == 0:
                if (t_end - t) - carry > 0.0:
                    continue
                if t_end == t_max:
                    return count
                kicks += 1
                w += con.kick
                w_rest = 0.0
                out_t[count] = t
                out_x[count] = slip + p
                out_kind[count] = KICK
                count += 1
                was = mode
                if has_edge:
                    mode = NEGATIVE if w < -edge else POSITIVE if w > edge else RAMP
                elif w != 0.0:
                    mode = NEGATIVE if w < 0.0 else POSITIVE
                else:
                    mode = STICK
                if mode != was:
                    out_t[count] = t
                    out_x[count] = slip + p
                    out_kind[count] = 4 * was + mode
                    count += 1
                t_end = min(t_max, (kicks + 1) * con.turn)
                continue
            carry += late
            w_rest = 0.0
            was = mode
            if mode == STICK or mode == RAMP:
                p_rest = 0.0
            if mode == STICK:
                mode = NEGATIVE if side > 0 else POSITIVE
            elif mode == RAMP:
                mode = POSITIVE if side > 0 else NEGATIVE
            elif has_edge:
                mode = RAMP
            else:
                excess = con.k * p - pull(con, t) if drive else con.k * p
                if mode == NEGATIVE:
                    mode = POSITIVE if excess < -2.0 * B else STICK
                else:
                    mode = NEGATIVE if excess > 0.0 else STICK
            out_t[count] = t + carry
            out_x[count] = slip + p
            out_kind[count] = 4 * was + mode
            count += 1
            if levels and (mode == STICK or mode == RAMP):
                factor = max(LEAST_FACTOR, (1.0 - con.wear * t) * factors[drawn])
                drawn += 1
                A = factor * con.Fs
                B = con.static * A if static else A
                before = slip
                slip = (B - con.c * con.v) / con.k if damper else B / con.k
                p += before - slip
                if has_edge:
                    C_ramp = B / con.d + con.c if damper else B / con.d
                    zeta_ramp = 0.5 * C_ramp / con.m
                    disc_ramp = (zeta_ramp - omega0) * (zeta_ramp + omega0)

    unbox_records()
    for module in KERNEL_MODULES:
        register(module, forceinline=True, **JIT_OPTIONS)
    for function in (reach, changes, deflated, survey, polish, first_root):
        register_jitable(function)
    return kernel, njit(kernel, error_model="numpy", _nrt=False)
