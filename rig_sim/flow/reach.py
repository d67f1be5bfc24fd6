"""The largest slip speed that a mass on a belt can reach, by energy.

Friction opposes the slip, so it does work on the mass only while the mass moves with the belt, more slowly than it:
0 < v < v_belt.  There F <= F_max, and

    m v^2/2 + k (y - F_max/k)^2/2     does not grow,     y = x - x0,

while everywhere else m v^2/2 + k y^2/2 does not.  With f = F_max/k and u = v_belt sqrt(m/k), motion that does not reach
the belt's speed has amplitudes up to f + u; slip from a stick begins at k y = F_max - c v_belt, and swings to at most
f + sqrt(u^2 + (c v_belt/k)^2); and a start at energy above that passes the belt's speed at k y = -k b,
(b + f)^2 = (a + f)^2 - u^2, and comes back to it at no more than y = b.
"""

import math


def largest_slip_speed(
    m: float, k: float, c: float, v_belt: float, friction: float, y: float, v: float, push: float = 0.0
) -> float:
    """Return the largest slip speed abs(x' - v_belt), m/s, of a mass that starts at ``y`` and ``v``.

    ``v_belt`` is the largest speed of the belt (m/s, either sign), ``friction`` the largest friction up to the slip
    speed ``v_belt``, break-away level included (N); ``y`` is the distance from the spring's rest (m).  ``push``, the
    amplitude of a drive (N), counts as a steady force.

    Not covered: resonance with a drive, forces that feed energy in, and kicks.
    """
    speed = abs(v_belt)
    rate = math.sqrt(k / m)
    f = (friction + push) / k
    u = speed / rate
    start = math.hypot(y, v / rate)
    b = math.sqrt(max(0.0, (start + f - u) * (start + f + u)))
    swing = f + math.hypot(max(0.0, b - 2.0 * f), u, c * speed / k)
    return speed + rate * max(start, swing)
