"""Kernel: straight lines through a stretch of samples, around every one of them, in one pass.

Runs as written or compiled (`daq.compute.compile`).
"""

from daq.compute.arrays import Array


def lines(time: Array, position: Array, first: int, last: int, window: int, variance: float, motion: Array) -> float:
    """Fit samples first..last-1; write x v a and their variances into ``motion`` (6, n).

    The window is centred, or up against an end of the stretch.  The acceleration is 0; its error is the slope's over
    the length of the window.

    Returns
    -------
    float
        Mean square by which the slopes of neighbouring windows without a common sample differ, over what
        ``variance`` (of a reading, m^2) makes them differ: 1 for a straight line; 0 where there is one window only.
    """
    n = last - first
    size = min(window, n)
    t0, x0 = time[first], position[first]
    differing, pairs, slope_before, variance_before = 0.0, 0, 0.0, 0.0
    begin = -1
    st = sx = stt = stx = 0.0
    for i in range(n):
        low = min(max(i - size // 2, 0), n - size)
        if begin < 0 or low % 64 == 0:
            # Afresh now and then: the sums forget their rounding.
            if low != begin:
                begin = low
                st = sx = stt = stx = 0.0
                for k in range(low, low + size):
                    t, x = time[first + k] - t0, position[first + k] - x0
                    st += t
                    sx += x
                    stt += t * t
                    stx += t * x
        while begin < low:
            t, x = time[first + begin] - t0, position[first + begin] - x0
            st -= t
            sx -= x
            stt -= t * t
            stx -= t * x
            t, x = time[first + begin + size] - t0, position[first + begin + size] - x0
            st += t
            sx += x
            stt += t * t
            stx += t * x
            begin += 1
        middle = st / size
        spread = stt - st * middle
        slope = (stx - middle * sx) / spread
        away = time[first + i] - t0 - middle
        at = first + i
        motion[0, at] = x0 + sx / size + slope * away
        motion[1, at] = slope
        motion[2, at] = 0.0
        motion[3, at] = variance * (1.0 / size + away * away / spread)
        motion[4, at] = variance / spread
        motion[5, at] = variance / spread * size / spread
        if i % size == size // 2 and i + size - size // 2 <= n:
            if variance_before > 0.0:
                differing += (slope - slope_before) ** 2 / (variance_before + variance / spread)
                pairs += 1
            slope_before, variance_before = slope, variance / spread
    return differing / pairs if pairs else 0.0
