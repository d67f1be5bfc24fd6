"""The commands of ``rig-sim`` that control a mass: quench, shaker, lock."""

from typing import Annotated, Literal

from cyclopts import Parameter

from rig_sim.cli.answer import DrivenName, answered, changed
from stickslip.console import application, flags
from stickslip.console.application import Answer, Json, SetChanges
from stickslip.console.flags import Force, Plot, check_plot
from stickslip.errors import InputError


def quench(
    scene: DrivenName,
    /,
    *,
    plot: Plot = None,
    force: Force = False,
    set_: SetChanges = None,
    json: Json = False,
) -> Answer:
    """Find whether a fast drive (dither) quenches stick-slip, and from which amplitude on: by formula and simulation.

    threshold is the amplitude u0 with which the mass alone reaches the belt's speed: v_belt abs(k - m omega^2 + i c
    omega) / omega; threshold_with_slope counts the slope of friction there as damping. simulated_threshold is the
    least u0 with which the simulated motion, from the scene's start, loses its stick-slip; quenched says so for the
    scene's own u0.

    Example: rig-sim quench forced --set drive.omega=20 --set drive.u0=1.75
    """
    import rig_sim

    check_plot(plot, force)
    with application.progress("settling", 2) as show:
        result = rig_sim.quench(changed(scene, set_), progress=show.stage)
    return answered(result, plot, force)


def shaker(
    *,
    m: Annotated[float, flags.quantity("--m", "mass", "Mass, kg or with a unit: '300 g'.")],
    k: Annotated[float, flags.quantity("--k", "stiffness", "Spring, N/m or with a unit.")],
    c: Annotated[float, flags.quantity("--c", "damping", "Damper, N s/m or with a unit.")],
    gamma: Annotated[
        float,
        flags.quantity(
            "--gamma",
            "damping",
            "Slope of friction at the belt's speed, N s/m: above 0 where it falls with the slip speed.",
        ),
    ],
    a: Annotated[float, flags.quantity("--a", "damping", "Amplification, N s/m.")],
    phi: Annotated[
        float,
        flags.quantity("--phi", "angle", "Phase by which the force leads the velocity, rad, or '170 deg'."),
    ],
    band: Annotated[
        str | None,
        Parameter(help="LOW:HIGH, the frequencies that the filter passes, rad/s or '0.8 Hz'; stable needs them."),
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
    import rig_sim

    return answered(rig_sim.shaker(m, k, c, gamma, a, phi, band=band), plot, force)


def lock(
    scene: DrivenName,
    /,
    *,
    period: Annotated[int, Parameter(help="Landings in one turn of the orbit.")],
    budget: Annotated[float, Parameter(help="Largest change of the drive's amplitude, as a fraction of drive.u0.")],
    method: Annotated[
        Literal["ogy", "search"],
        Parameter(
            help="ogy (Ott, Grebogi and Yorke: a change at each landing), or search (the thesis's: raise the amplitude "
            "until the section repeats, then take it back)."
        ),
    ] = "ogy",
    events: Annotated[int, application.Whole, Parameter(help="Landings after which the control gives up.")] = 20_000,
    plot: Plot = None,
    force: Force = False,
    set_: SetChanges = None,
    json: Json = False,
) -> Answer:
    """Find an unstable orbit of a driven mass, and lock the motion onto it by small changes of the drive's amplitude.

    The orbits are found by close returns of the uncontrolled motion; of several, the least unstable one is taken. An
    event is a landing: a passage from slip to stick.

    Example: rig-sim lock forced --period 2 --budget 0.0235
    """
    import rig_sim

    if method == "search" and plot is not None:
        raise InputError("draws --method=ogy alone", "--plot", "drop one of the two")
    check_plot(plot, force)
    with application.progress("following the motion", events) as show:
        result = rig_sim.lock(changed(scene, set_), period, budget, method=method, events=events, progress=show.stage)
    if plot is not None and result.control is None:
        return answered(result, None, False, "nothing drawn: there is no motion under control")
    return answered(result, plot, force)
