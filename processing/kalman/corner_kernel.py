"""Kernels: corners of a motion of white snap: the labels they give the samples, their times, what they gain.

Every function runs as written or compiled (`daq.compute.compile`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from daq.compute.arrays import Array
from processing.kalman.snap_kernel import (
    CUT,
    LAND,
    LANDING,
    LEAVING,
    MEET,
    MET,
    NEAR_LANDING,
    NEAR_ONSET,
    ONSET,
    REST,
    RIDE,
    SLIP,
    STICK,
    STOP,
    line_predict,
    line_update,
    predict,
    turn,
    unpacked,
    update,
)

Labels = NDArray[np.uint8]


def label_samples(time: Array, at: Array, kind: Labels, first: int, unit: float, label: Labels) -> None:
    """Name the part of the motion every sample lies in (the interval that ends there), for `forward`.

    ``first`` is the label before the first corner: SLIP, STICK, RIDE or REST; the parts of a slip near its ends, and
    of a ride, are told by their time from the corner in fractions of ``unit`` (s), the length of a slip.
    """
    c = 0
    state = first
    # Where a slip is cut off a landing may lie within the last samples, unseen: as rough as there.
    ended = time[time.size - 1]
    behind, before = -math.inf, math.inf
    for i in range(time.size):
        while c < at.size and at[c] <= time[i]:
            behind = at[c]
            k = kind[c]
            state = STICK if k == LAND else RIDE if k == MEET else REST if k == STOP else SLIP
            c += 1
        before = at[c] if c < at.size else ended
        label[i] = state
        since, left = (time[i] - behind) / unit, (before - time[i]) / unit
        if state == SLIP:
            for part in range(4):
                if left < NEAR_LANDING[part]:
                    label[i] = (LANDING if c < at.size else CUT) + part
                    break
                if since < NEAR_ONSET[part]:
                    label[i] = ONSET + part
                    break
        elif state == RIDE:
            if since < NEAR_ONSET[0]:
                label[i] = MET
            elif left < NEAR_ONSET[0]:
                label[i] = LEAVING


def place(
    time: Array,
    position: Array,
    stored: Array,
    at: Array,
    pick: NDArray[np.int64],
    what: int,
    low: Array,
    high: Array,
    half: float,
    finest: float,
    back: float,
    on: float,
    edges: Array,
    parts: Labels,
    corner: int,
    q: Array,
    u: Array,
    r: Array,
    jump: Array,
    found: Array,
) -> None:
    """Move corners to where they are most likely; ``found`` (c, 2) gets mean and standard deviation of each time.

    Only the corners ``pick``, all of kind ``what``, each within ``low`` and ``high``; looked for within ``half`` (s)
    of where it stands, on the samples from ``back`` before to ``on`` behind it.  ``parts`` are the labels around the
    corner by the time from it, cut at ``edges`` (s), of which number ``corner`` is the corner itself (0).  The grid
    of times is refined until the likelihood is wider than its step, or the step below ``finest`` (s).
    """
    n = 4
    gain, tried = np.empty(2 * n + 1), np.empty(2 * n + 1)
    for k in range(pick.size):
        middle, step = at[pick[k]], half / n
        least, most = low[k], high[k]
        begin = np.searchsorted(time, max(middle - half - back, least))
        end = np.searchsorted(time, min(middle + half + on, most))
        found[k, 0], found[k, 1] = middle, half
        if end - begin < 8:
            continue
        least, most = max(least, time[begin]), min(most, time[end - 1])
        for _ in range(12):
            for i in range(2 * n + 1):
                tried[i] = min(max(middle + (i - n) * step, least), most)
            try_corner(
                time[begin:end],
                position[begin:end],
                tried,
                what,
                edges,
                parts,
                corner,
                q,
                u,
                r,
                jump,
                stored[begin],
                gain,
            )
            best = np.argmax(gain)
            weight, mean, square = 0.0, 0.0, 0.0
            for i in range(2 * n + 1):
                w = math.exp(gain[i] - gain[best])
                weight += w
                mean += w * (tried[i] - middle)
                square += w * (tried[i] - middle) ** 2
            mean /= weight
            spread = math.sqrt(max(square / weight - mean * mean, 0.0))
            found[k, 0], found[k, 1] = middle + mean, max(spread, 0.3 * step)
            if spread > 1.2 * step or step < finest:
                break
            middle = tried[best]
            if 0 < best < 2 * n:
                step /= 3


def try_corner(
    time: Array,
    position: Array,
    tried: Array,
    what: int,
    edges: Array,
    parts: Labels,
    corner: int,
    q: Array,
    u: Array,
    r: Array,
    jump: Array,
    stored: Array,
    gain: Array,
) -> None:
    """Put one corner at each of the times tried, and write the log likelihoods, up to a constant, into ``gain``.

    ``stored`` is what the filter expected of the first sample; the rest as for `place`.
    """
    for k in range(tried.size):
        S = unpacked(stored)
        last = time[0]
        total, product = 0.0, 1.0
        ahead = True
        part = 0
        for i in range(time.size):
            if ahead and tried[k] <= time[i]:
                part = max(part, corner)
                b = parts[part]
                S = predict(tried[k] - last, q[b], u[b], S)
                S = turn(what, jump, S)
                last = tried[k]
                ahead = False
            while part < edges.size and time[i] - tried[k] >= edges[part]:
                part += 1
            b = parts[part]
            still = b == STICK or b == REST
            S = line_predict(time[i] - last, S) if still else predict(time[i] - last, q[b], u[b], S)
            last = time[i]
            s = 1.0 / (S[4] + r[b])
            e = position[i] - S[0]
            total -= e * e * s
            product *= s
            if product > 1e200 or product < 1e-200:
                total += math.log(product)
                product = 1.0
            S = line_update(e, s, r[b], S) if still else update(e, s, r[b], S)
        gain[k] = 0.5 * (total + math.log(product))


def gains(stored: Array, surprise: int, spans: NDArray[np.int64], gain: Array) -> None:
    """Sum the log likelihoods of the samples in each span, up to a constant, into ``gain``.

    ``stored`` is what a filter wrote down, here or in `processing.kalman.jerk_kernel`; its column ``surprise`` holds
    1/s, the next one e/s.
    """
    for k in range(spans.shape[0]):
        total, product = 0.0, 1.0
        for i in range(spans[k, 0], spans[k, 1]):
            s = stored[i, surprise]
            total -= stored[i, surprise + 1] ** 2 / s
            product *= s
            if product > 1e200 or product < 1e-200:
                total += math.log(product)
                product = 1.0
        gain[k] = 0.5 * (total + math.log(product))
