"""The commands of ``rig-sim`` that control a mass: shaker, lock."""

import math
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from daq.console.application import Answer, Json
from daq.errors import InputError
from rig_sim.flow.flow import LARGEST, SMALLEST

Plot = Annotated[Path | None, Parameter(help="Draw the result into this file (.png, .svg, .pdf).")]
Force = Annotated[bool, Parameter(negative=(), help="Replace the file if it exists.")]


def shaker(
    *,
    m: Annotated[float, Parameter(help="Mass, kg.")],
    k: Annotated[float, Parameter(help="Spring, N/m.")],
    c: Annotated[float, Parameter(help="Damper, N s/m.", allow_leading_hyphen=True)],
    gamma: Annotated[
        float,
        Parameter(
            help="Slope of friction at the belt's speed, N s/m: above 0 where it falls with the slip speed.",
            allow_leading_hyphen=True,
        ),
    ],
    a: Annotated[float, Parameter(help="Amplification, N s/m.")],
    phi: Annotated[
        float, Parameter(help="Phase by which the force leads the velocity, rad.", allow_leading_hyphen=True)
    ],
    band: Annotated[
        str | None, Parameter(help="LOW:HIGH, the frequencies that the filter passes, rad/s; stable needs them.")
    ] = None,
    plot: Plot = None,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Find frequency and growth rate of the small oscillation under a shaker that feeds the velocity back.

    The shaker's force is the velocity times a, ahead of it by phi; phi = 3.14159265 is a damper. The picture shows the
    curves of constant growth rate and frequency over phase and amplification, and shades where the oscillation decays.

    Example: rig-sim shaker --m 1 --k 1 --c 0 --gamma 0.3 --a 0.5 --phi 3 --band 0.9:1.1
    """
    from rig_sim.dynamics.control.phasor import phasor_roots
    from rig_sim.dynamics.control.stability import ShakerPlane

    for name, value in (("m", m), ("k", k), ("c", c), ("gamma", gamma), ("a", a), ("phi", phi)):
        _check(name, value, positive=name in ("m", "k"), negative=name in ("c", "gamma", "phi"))
    plane = ShakerPlane(m, k, gamma - c, None if band is None else _band(band))
    roots = phasor_roots(m, k, plane.S, a, phi)
    data: dict[str, Any] = {
        "omega": roots[0].real,
        "delta": roots[0].imag,
        "stable": plane.stable(a, phi),
        "roots": roots,
        "band": plane.band,
        "in_band": plane.passes(roots[0].real),
        "stable_phases": plane.stable_phases(a),
        "stable_amplifications": plane.stable_amplifications(phi),
    }
    kind = "decays" if data["delta"] < 0.0 else "grows" if data["delta"] > 0.0 else "neither grows nor decays"
    outside = "" if data["in_band"] else ", but its frequency lies outside the filter's band"
    lines = [
        f"omega  {data['omega']:.15g} rad/s",
        f"delta  {data['delta']:.15g} 1/s: the oscillation {kind}{outside}",
        f"stable {data['stable']}",
        f"stable phases at a = {a:g}: {_intervals(data['stable_phases'])}",
        f"stable amplifications at phi = {phi:g}: {_intervals(data['stable_amplifications'])}",
    ]
    if plot is not None:
        from rig_sim.dynamics.control.shaker_plot import shaker_figure
        from rig_sim.dynamics.maps.plot import save

        save(shaker_figure(plane, a, phi), plot, force=force)
        data["file"] = plot
        lines.append(str(plot))
    return Answer(data, "\n".join(lines))


def _check(name: str, value: float, *, positive: bool = False, negative: bool = False) -> None:
    """Refuse a number that is not finite, too large or too small, or of the wrong sign.

    Raises
    ------
    InputError
        Naming the flag.
    """
    if not math.isfinite(value) or abs(value) > LARGEST or 0.0 < abs(value) < SMALLEST:
        raise InputError(f"is {value:g}", f"--{name}", f"give 0 or a size from {SMALLEST:g} to {LARGEST:g}")
    if (positive and value <= 0.0) or (not negative and value < 0.0):
        raise InputError(f"is {value:g}", f"--{name}", "give a number above 0" if positive else "give 0 or more")


def _band(text: str) -> tuple[float, float]:
    """Return the two frequencies of ``--band LOW:HIGH``.

    Raises
    ------
    InputError
        Another form, or not 0 <= LOW < HIGH.
    """
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise InputError(f"{text!r} is no band", "--band", "write LOW:HIGH in rad/s, as in 0.9:1.1") from None
    if not 0.0 <= low < high < math.inf:
        raise InputError(f"{text!r} is no band", "--band", "give 0 <= LOW < HIGH, in rad/s")
    return low, high


def _intervals(found: list[tuple[float, float]]) -> str:
    return ", ".join(f"{low:.6g} to {high:.6g}" for low, high in found) or "none"
