"""What the sections of a scene make impossible together, each refused with its key and what to do."""

import math

from rig_sim.flow.flow import LARGEST, SMALLEST, steepest_fall, validate
from rig_sim.friction.spline import find_problem
from rig_sim.scenes.model import STARTS, Scene
from rig_sim.scenes.sections import Friction
from stickslip.errors import InputError, nearest
from stickslip.units import si_unit

MOST_POINTS = 1000  # points of a measured curve: a fit gives about 16
OWN_KEYS = {  # of the section friction, reserved: no parameter of a formula has such a name (Fs, G_slip and gamma may)
    "law": "the law's number",
    "curve": "measured points",
    "formula": "the formula itself",
    "contact": "jump or ramp",
    "static": "break-away level over the friction at rest",
    "d": "half-width of the ramp",
    "G_stick": "slope of the ramp",
}
TWO_MASS_TERMS = ("mass", "spring", "coupling", "belt", "friction", "start", "damper")  # allowed for two masses


def check_magnitudes(scene: Scene, where: str) -> None:
    """Refuse numbers whose products and ratios leave the range of floating-point arithmetic."""
    for section, keys in scene.model_dump(exclude_none=True).items():
        for key, value in keys.items() if isinstance(keys, dict) else ():
            if isinstance(value, float) and value != 0.0 and not SMALLEST <= abs(value) <= LARGEST:
                problem = f"{section}.{key} is {value:g}"
                raise InputError(
                    problem, where, f"use 0 or a size from {SMALLEST:g} to {LARGEST:g}, if necessary in other units"
                )


def check_together(scene: Scene, where: str) -> None:
    """Refuse combinations of sections that are impossible."""
    _check_masses(scene, where)
    friction = scene.friction
    if friction is None:
        for effect in ("wear", "scatter"):
            if getattr(scene, effect) is not None:
                raise InputError(f"{effect} without friction", where, f"add a friction section or remove {effect}")
    else:
        if friction.G_stick is not None and friction.d is not None:
            raise InputError("friction has both G_stick and d", where, "keep only one of them (G_stick = -static Fs/d)")
        if friction.formula is not None:
            _check_formula(friction, where)
        elif friction.memory_law() is not None:
            _check_memory(scene, friction, where)
        elif friction.law is None:
            do = "set it with --set friction.law=..., or set friction.formula"
            python = "write rig_sim.scene(..., **{'friction.law': 5}), or set friction.formula"
            raise InputError("friction.law is missing", where, do, python=python)
        else:
            _check_curve(friction, where)
        is_speed_law = friction.formula is None and friction.memory_law() is None
        for key in friction.law_record().parameters if is_speed_law else ():
            if getattr(friction, key) is None and not (key == "d" and friction.G_stick is not None):
                name = "G_stick or d" if key == "d" else key
                raise InputError(f"law {friction.law} requires friction.{name}", where, f"set {name}")
    _check_formula_values(scene, where)
    if scene.joint is not None and (scene.belt is None or scene.belt.length is None):
        raise InputError("the section joint requires belt.length", where, "set the length of one turn of the belt")
    if scene.belt is not None and scene.belt.ripple_hz is not None and scene.belt.ripple is None:
        raise InputError(
            "belt.ripple_hz requires belt.ripple", where, "set the amplitude of the ripple, or remove ripple_hz"
        )
    if scene.belt is not None and scene.belt.ripple:
        if scene.belt.ripple_hz is None:
            raise InputError("belt.ripple_hz is missing", where, "set the frequency of the ripple in Hz")
        if scene.drive is not None:
            raise InputError(
                "belt.ripple cannot be combined with a drive",
                where,
                "remove one of them, because the integrator supports only one harmonic",
            )
    if scene.droop is not None:
        if friction is not None and not friction.law:
            key = "friction.law = 0" if friction.formula is None else "friction.formula"
            raise InputError(f"droop with {key} is not modelled", where, "remove droop, or use law 1 to 6")
        if scene.belt is None or friction is None:
            raise InputError("droop requires the sections belt and friction", where, "add them or remove droop")
        _check_droop(scene, scene.droop.fraction, where)
    if scene.shaker is not None:
        try:
            validate(scene.flow())
        except (ValueError, OverflowError) as error:
            problem = f"shaker.a = {scene.shaker.a:g}, shaker.phi = {scene.shaker.phi:g}: {error}"
            raise InputError(problem, where, "set belt.speed, a smaller shaker.a, or shaker.phi = 3.14159") from None
    for effect in ("slip_loss", "gaps"):
        if getattr(scene, effect) is not None and scene.encoder is None:
            raise InputError(f"{effect} requires an encoder", where, f"add an encoder section or remove {effect}")
    if scene.belt is not None and scene.belt.channel and scene.encoder is None:
        raise InputError("belt.channel requires an encoder", where, "add an encoder section or remove belt.channel")
    if not math.isfinite(scene.spring.k / scene.mass.m):
        raise InputError(
            "spring.k/mass.m is outside the range of floating-point numbers",
            where,
            "use values of k and m that differ less",
        )


def _check_curve(friction: Friction, where: str) -> None:
    if friction.law != 0:
        if friction.contact is not None:
            problem_text = f"friction.contact cannot be combined with law {friction.law}, which defines its contact"
            raise InputError(problem_text, where, "remove it, or use law 0")
        return
    do = "set friction.curve = [[0, F], [s, F], ...]: slip speed in m/s from 0, friction in N"
    if friction.curve is None:
        raise InputError("law 0 requires friction.curve", where, do)
    if len(friction.curve) > MOST_POINTS:
        raise InputError(f"friction.curve has {len(friction.curve)} points", where, f"use {MOST_POINTS} or fewer")
    if problem := find_problem(friction.curve):
        raise InputError(f"friction.curve: {problem}", where, do)
    for number in (number for point in friction.curve for number in point):
        if number != 0.0 and not SMALLEST <= abs(number) <= LARGEST:
            raise InputError(f"friction.curve contains {number:g}", where, "choose other units")
    if friction.contact == "ramp" and friction.d is None and friction.G_stick is None:
        raise InputError("a ramp requires friction.d", where, "set friction.d, or remove friction.contact")


def _check_memory(scene: Scene, friction: Friction, where: str) -> None:
    """Refuse a law with memory without its parameters, or together with what is not modelled for it."""
    law = friction.memory_law()
    if law is None:
        raise ValueError("friction has no memory")
    parameters = friction.memory_parameters()
    if missing := [name for name, value in parameters.items() if value is None]:
        units = ", ".join(f"{name} in {si_unit(law.parameters[name].dimension)}" for name in missing)
        raise InputError(f"law {friction.law} requires friction.{missing[0]}", where, f"set {units}")
    for name, value in parameters.items():
        parameter = law.parameters[name]
        if value is None or not math.isfinite(value) or value < 0.0 or (value == 0.0 and not parameter.may_be_zero):
            at_least = "0 or more" if parameter.may_be_zero else "above 0"
            raise InputError(f"friction.{name} is {value:g}", where, f"use a number {at_least}")
    if scene.belt is None or scene.belt.speed == 0.0:
        raise InputError(f"friction.law {friction.law} requires a moving belt", where, "set belt.speed")
    for section in ("coupling", "shaker", "droop"):
        if getattr(scene, section) is not None:
            raise InputError(f"{section} is not modelled with law {friction.law}", where, f"remove {section}")
    for key in ("contact", "curve"):
        if getattr(friction, key) is not None:
            raise InputError(
                f"friction.{key} cannot be combined with law {friction.law}", where, f"remove {key}, or use law 0"
            )
    if friction.static != 1.0:
        problem = (
            f"friction.static cannot be combined with law {friction.law}, whose break-away follows from its memory"
        )
        raise InputError(problem, where, "drop static")


def _check_formula(friction: Friction, where: str) -> None:
    for key in ("law", "curve"):
        if getattr(friction, key) is not None:
            raise InputError(f"friction has both {key} and formula", where, "keep one")
    formula = friction.parse_formula()
    names = formula.parameters if formula is not None else ()
    for name in names:
        if name in OWN_KEYS:
            problem = f"friction.formula has a parameter {name}, which is a key of the section: {OWN_KEYS[name]}"
            raise InputError(problem, where, "give the parameter another name")
        if name not in friction.formula_values():
            others = [key for key in friction.model_fields_set if key not in {*OWN_KEYS, *names}]
            close = nearest(name, others) if others else ""
            do = f"set {name}" + (f"; {close}" if close.startswith("did") else "")
            raise InputError(f"the formula requires friction.{name}", where, do)
    if friction.contact == "ramp" and friction.d is None and friction.G_stick is None:
        raise InputError("a ramp requires friction.d", where, "set friction.d, or remove friction.contact")


def _check_formula_values(scene: Scene, where: str) -> None:
    """Refuse a formula that is not a friction curve at the slip speeds which the scene can reach."""
    if scene.friction is None or scene.friction.formula is None:
        return
    try:
        scene.model_copy(update={"shaker": None}).flow()
    except InputError as error:
        raise InputError(f"friction.formula: {error.what}", where, error.do) from None


def _check_masses(scene: Scene, where: str) -> None:
    """Refuse a start for another number of masses, and sections that are not modelled for two masses."""
    start_keys = sorted(scene.start.model_fields_set)
    if scene.coupling is None:
        if other := [key for key in start_keys if key not in ("x", "v")]:
            do = "set start.x and start.v, or add coupling.a and coupling.b"
            raise InputError(f"start.{other[0]} requires the section coupling", where, do)
        return
    for section in scene.terms():
        if section not in TWO_MASS_TERMS:
            raise InputError(f"{section} is not modelled for two masses (section coupling)", where, f"remove {section}")
    for key in ("start", "length", "ripple", "ripple_hz", "channel"):
        if scene.belt is not None and getattr(scene.belt, key):
            raise InputError(
                f"belt.{key} is not modelled for two masses (section coupling)", where, f"remove belt.{key}"
            )
    if scene.friction is not None and scene.friction.law_record().contact != "jump":
        problem = f"friction.law is {scene.friction.law}, a ramp, which is not modelled for two masses"
        raise InputError(problem, where, "use law 1, 3 or 5")
    if scene.friction is not None and not scene.friction.law:
        key = "friction.law is 0" if scene.friction.formula is None else "friction.formula is given"
        raise InputError(f"{key}, which is not modelled for two masses", where, "use law 1, 3 or 5")
    start_forms = [form for form in STARTS if any(key in start_keys for key in form)]
    if STARTS[0] in start_forms:
        raise InputError(
            "start.x and start.v cannot be combined with the section coupling",
            where,
            "set start.x1, v1, x2, v2, or start.d",
        )
    if len(start_forms) > 1:
        problem = f"start has {start_forms[0][0]} and {start_forms[1][0]}"
        raise InputError(problem, where, "keep either x1, v1, x2, v2 or d or attractor")


def _check_droop(scene: Scene, fraction: float, where: str) -> None:
    """Refuse a droop that leaves the force undetermined, in terms of the scene's own keys."""
    flow = scene.model_copy(update={"shaker": None}).flow()
    if flow.droop > 0.0 and flow.static != 1.0:
        raise InputError(
            f"droop with friction.static = {flow.static:g}",
            where,
            "remove one of them, because droop requires a static of 1",
        )
    if flow.droop > 0.0 and flow.Fs == 0.0:
        raise InputError(
            "droop requires friction.Fs above 0, because no other force loads the belt",
            where,
            "set Fs, or remove droop",
        )
    fall = steepest_fall(flow)
    if flow.droop * fall >= 1.0:
        largest = fraction / (flow.droop * fall)
        problem = f"droop.fraction is {fraction:g}, so friction would fall faster than the belt slows"
        do = f"use less than {largest:.4g}" + ("" if largest >= 1e-3 else ", or remove droop")
        raise InputError(problem, where, do + ", or a slower belt, or friction that falls less (gamma, G_slip)")
    try:
        validate(flow)
    except ValueError as error:
        raise InputError(str(error), where, "change that value, or remove droop") from None
