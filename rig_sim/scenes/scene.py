"""Scenes: a TOML file or a built-in name lists what exists on the rig; what is not listed does not exist.

========= ===================================== ========================================================================
section   keys                                  meaning
========= ===================================== ========================================================================
mass      m                                     required
spring    k, x0 = 0                             required; x0: the spring's rest position
belt      speed, start = 0, length, ripple,    at rest before ``start``, then at ``speed``, which swings by ``ripple``;
          ripple_hz, channel                    one turn is ``length``; channel = true: the board sends its counts too
friction  law, Fs, G_slip, gamma, G_stick or d, a law takes the parameters it needs and leaves the others alone
          static = 1
start     x = 0, v = 0                          the mass at t = 0
          x1 = 0, v1 = 0, x2 = 0, v2 = 0,       two masses at t = 0; or both sticking with x2 - x1 = d, at the end of
          d, attractor                          that stick; or there on attractor 1, 2 ... (1 has the largest basin)
coupling  a, b                                  makes it two masses: coupling spring over k, second friction level over
                                                the first
damper    c
drive     u0, omega                             the force u0 cos(omega t)
shaker    a, phi                                a force on the mass: ``a`` times its velocity, ahead of it by ``phi``
wear      rate                                  fraction of Fs lost per second
scatter   Fs                                    standard deviation of Fs from stick to stick, a fraction
joint     kick                                  velocity step of the mass once per ``belt.length``
droop     fraction                              of the belt's speed, lost where the mass loads it with Fs
slip_loss rate, counts, samples = 1             the encoder loses x4 counts: how often per second, how many, over
                                                how many samples
gaps      rate, duration                        stretches of samples never sent: how often per second, s
encoder   lines_per_rev, circumference,         vibration is added to the encoder's position only
          decoder = "x4", vibration,
          vibration_hz = 50
jitter    rms                                   of the sampling instants, s
output    truth                                 the board also sends the exact motion; older name: tell
========= ===================================== ========================================================================

Top-level keys: name, title, seed (default 0).  SI units, or dimensionless throughout.  ``G_stick = -static Fs/d``:
naming one of the two in a change removes the other; so does naming another way to start.
"""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from daq.errors import InputError, nearest
from rig_sim.flow.flow import LARGEST, SMALLEST, Flow, steepest_fall, validate
from rig_sim.flow.two_mass import TwoMassFlow
from rig_sim.friction.law import LAWS
from rig_sim.scenes import sections
from rig_sim.scenes.sections import Section

BUILTIN_FOLDER = Path(__file__).parent / "builtin"
TERMS = ("mass", "spring", "coupling", "belt", "friction", "start", "damper", "drive", "shaker")
TWO_MASS_TERMS = ("mass", "spring", "coupling", "belt", "friction", "start", "damper")  # what two masses may have
EFFECTS = ("wear", "scatter", "joint", "droop", "slip_loss", "gaps", "encoder", "jitter", "output")
STARTS = (("x", "v"), ("x1", "v1", "x2", "v2"), ("d",), ("attractor",))  # ways to begin; a change drops the others
OLD_NAMES = {"tell": "output"}  # of sections, still accepted
SECTIONS = TERMS + EFFECTS
LARGEST_FILE = 1 << 20  # bytes of a scene; what is longer is something else, and may have no end


class Scene(Section):
    """What exists on the rig; an absent section is None and its term does not exist."""

    name: str = ""
    title: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    mass: sections.Mass
    spring: sections.Spring
    belt: sections.Belt | None = None
    friction: sections.Friction | None = None
    start: sections.Start = sections.Start()
    coupling: sections.Coupling | None = None
    damper: sections.Damper | None = None
    drive: sections.Drive | None = None
    shaker: sections.Shaker | None = None
    wear: sections.WearSection | None = None
    scatter: sections.Scatter | None = None
    joint: sections.Joint | None = None
    droop: sections.Droop | None = None
    slip_loss: sections.SlipLoss | None = None
    gaps: sections.Gaps | None = None
    encoder: sections.Encoder | None = None
    jitter: sections.Jitter | None = None
    output: sections.Output | None = None

    def terms(self) -> list[str]:
        """Return the names of the sections the scene has, in the order of the table above."""
        return [name for name in SECTIONS if getattr(self, name) is not None]

    def flow(self, *, belt_running: bool = True, factor: float = 1.0) -> Flow:
        """Return the equation of motion as the integrator takes it.

        A belt that ripples is there as a drive, in coordinates that swing with it: see `rig_sim.effects.ripple`.  A
        shaker is there as another damper, spring and rest position: see `rig_sim.effects.shaker`.

        Parameters
        ----------
        belt_running : bool
            False before ``belt.start``: the belt is there, at rest.
        factor : float
            Wear times scatter: multiplies the whole friction curve, the ramp's width unchanged.

        Raises
        ------
        InputError
            The scene has two masses.
        """
        if self.coupling:
            do = "drop the section coupling, or use events, run, fixed-point, map, sweep, basins or lyapunov"
            raise InputError("has two masses, and this is for one", f"scene {self.name}", do)
        return self._flow_of_one(belt_running=belt_running, factor=factor)

    def two_mass_flow(self) -> TwoMassFlow:
        """Return the equations of motion of two masses.

        Raises
        ------
        InputError
            The scene has one mass.
        """
        if self.coupling is None:
            do = "set coupling.a and coupling.b, or take the scene two-mass"
            raise InputError("has one mass, and this is for two", f"scene {self.name}", do)
        return TwoMassFlow(self._flow_of_one(), float(self.coupling.a), float(self.coupling.b))

    def _flow_of_one(self, *, belt_running: bool = True, factor: float = 1.0) -> Flow:
        """Return the flow of one mass, alone."""
        law = LAWS[self.friction.law if self.friction else 1]
        values = self.friction.parameters() if self.friction else {}
        flow = Flow(
            m=float(self.mass.m),
            k=float(self.spring.k),
            x0=float(self.spring.x0),
            c=float(self.damper.c) if self.damper else 0.0,
            v_belt=float(self.belt.speed) if self.belt and belt_running else 0.0,
            curve=law.curve_code,
            ramp=law.ramp,
            Fs=values.get("Fs", 0.0),
            static=float(self.friction.static) if self.friction else 1.0,
            factor=factor,
            G_slip=values.get("G_slip", 0.0),
            gamma=values.get("gamma", 0.0),
            d=values.get("d", 0.0),
            u0=float(self.drive.u0) if self.drive else 0.0,
            omega=float(self.drive.omega) if self.drive else 0.0,
            phase=0.0,
            droop=self.droop.fraction * abs(self.belt.speed) if self.droop and self.belt and belt_running else 0.0,
        )
        if self.shaker and belt_running:
            from rig_sim.effects.shaker import controlled

            flow = controlled(flow, float(self.shaker.a), float(self.shaker.phi))
        if self.belt and self.belt.ripple and belt_running:
            return self.belt.swing().driven(flow)
        return flow


def builtin_names() -> list[str]:
    """Return the names of the built-in scenes."""
    return sorted(path.stem for path in BUILTIN_FOLDER.glob("*.toml"))


def scene(name_or_path: "str | Path", **changes: object) -> Scene:
    """Return a scene, built in or read from a TOML file, with some keys changed.

    Parameters
    ----------
    name_or_path : str or Path
        A built-in name (`builtin_names`), or the path of a TOML file.
    **changes
        Either dotted keys, ``scene("rig", **{"friction.law": 3})``, or whole or partial sections,
        ``scene("rig", friction={"law": 3}, seed=7)``.  A section that is absent is created; naming ``G_stick`` removes
        ``d`` and the other way round.

    Raises
    ------
    InputError
        No such scene, a file that is no TOML, an unknown section or key (with its nearest neighbour), a value that is
        no finite number or out of its range (of any number: 0, or from `SMALLEST` to `LARGEST` in size): each names the
        file and the key.
    """
    where, content = _read(name_or_path)
    for key, value in changes.items():
        if isinstance(value, Mapping):
            for inner, item in value.items():
                _change(content, f"{key}.{inner}", item, where)
        else:
            _change(content, key, value, where)
    return _checked(content, where)


def parse_changes(settings: Iterable[str] | None) -> dict[str, object]:
    """Return ``["friction.law=3", ...]``, as ``--set`` takes them, as changes for `scene`.

    Values are TOML; a bare word is a string.

    Raises
    ------
    InputError
        A setting without ``=``, or of several lines.
    """
    changes: dict[str, object] = {}
    for setting in settings or ():
        key, equals, value = setting.partition("=")
        if not equals or not key.strip() or not value.strip() or "\n" in value.strip():
            raise InputError(f"{setting!r} is no change of a scene", "--set", "write section.key=value")
        changes[key.strip()] = _value(value.strip())
    return changes


def _value(text: str) -> object:
    import tomllib

    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        pass
    try:
        return float(text)
    except ValueError:
        return {"true": True, "false": False}.get(text.lower(), text)


def _read(name_or_path: "str | Path") -> tuple[str, dict[str, Any]]:
    import tomllib

    name = str(name_or_path)
    path = BUILTIN_FOLDER / f"{name}.toml"
    where = f"scene {name}"
    if name not in builtin_names():
        path, where = Path(name), name
        if path.suffix != ".toml" and not path.exists():
            raise InputError(
                f"no built-in scene {name!r} and no such file",
                "scene",
                f"{nearest(name, builtin_names())}; or give the path of a TOML file",
            )
    try:
        if path.exists() and not path.is_file():
            raise InputError("is a folder or a device, not a file", where, "give the path of a TOML file")
        with path.open("rb") as file:
            held = file.read(LARGEST_FILE + 1)
        if len(held) > LARGEST_FILE:
            raise InputError(f"is larger than any scene: over {LARGEST_FILE} bytes", where, "give a scene's TOML file")
        content = tomllib.loads(held.decode())
    except FileNotFoundError:
        raise InputError("no such file", where, f"check the path, or take a built-in scene: {_listed()}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as text ({error})", where, "give the path of a TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not TOML: {error}", where, "mend that line") from None
    content.setdefault("name", path.stem)
    return where, {OLD_NAMES.get(section, section): keys for section, keys in content.items()}


def _listed() -> str:
    return ", ".join(builtin_names())


def _change(content: dict[str, Any], dotted: str, value: object, where: str) -> None:
    section, dot, key = dotted.partition(".")
    section = OLD_NAMES.get(section, section)
    if not dot:
        content[section] = value
        return
    plain = section in Scene.model_fields and not _keys(section)
    if plain or not isinstance(content.setdefault(section, {}), dict):
        raise InputError(f"{section!r} is a plain value and has no key {key!r}", where, f"set {section} itself")
    content[section][key] = value
    if section == "friction" and key in ("G_stick", "d"):
        content[section].pop("d" if key == "G_stick" else "G_stick", None)
    if section == "start":
        for way in STARTS:
            for other in way if key not in way else ():
                content[section].pop(other, None)


def _checked(content: dict[str, Any], where: str) -> Scene:
    _refuse_unknown(content, where)
    try:
        found = Scene.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        if first["type"] == "missing":
            raise InputError(f"{key} is missing", where, f"give it, or --set {_first_key(key)}=...") from None
        if first["type"] == "model_type":
            do = f"write --set {key}.KEY=VALUE, or a table [{key}]"
            raise InputError(f"{key} is {first['input']!r:.60}, but it is a section", where, do) from None
        reason = (first["msg"][0].lower() + first["msg"][1:]).replace("input should", "it should")
        raise InputError(
            f"{key} is {first['input']!r:.60}", where, reason.replace("input should", "it should")
        ) from None
    _check_magnitudes(found, where)
    _check_together(found, where)
    return found


def _first_key(key: str) -> str:
    return {"mass": "mass.m", "spring": "spring.k"}.get(key, key)


def _refuse_unknown(content: Mapping[str, Any], where: str) -> None:
    for section, keys in content.items():
        if section not in Scene.model_fields:
            what = "section" if isinstance(keys, dict) else "key"
            raise InputError(f"unknown {what} {section!r}", where, nearest(section, list(Scene.model_fields)))
        if not isinstance(keys, dict):
            continue
        known = _keys(section)
        for key in keys:
            if key not in known:
                raise InputError(f"unknown key '{section}.{key}'", where, nearest(key, known))


def _keys(section: str) -> list[str]:
    annotation = Scene.model_fields[section].annotation
    for model in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(model, type) and issubclass(model, Section):
            return list(model.model_fields)
    return []


def _check_magnitudes(found: Scene, where: str) -> None:
    """Refuse numbers whose products and ratios leave the range of floating-point arithmetic."""
    for section, keys in found.model_dump(exclude_none=True).items():
        for key, value in keys.items() if isinstance(keys, dict) else ():
            if isinstance(value, float) and value != 0.0 and not SMALLEST <= abs(value) <= LARGEST:
                what = f"{section}.{key} is {value:g}"
                raise InputError(what, where, f"give 0 or a size from {SMALLEST:g} to {LARGEST:g}: choose other units")


def _check_together(found: Scene, where: str) -> None:
    """Refuse what only two sections together make impossible."""
    _check_masses(found, where)
    friction = found.friction
    if friction is None:
        for effect in ("wear", "scatter"):
            if getattr(found, effect) is not None:
                raise InputError(f"{effect} without friction", where, f"add a friction section or drop {effect}")
    else:
        if friction.G_stick is not None and friction.d is not None:
            raise InputError("friction has both G_stick and d", where, "keep one: G_stick = -static Fs/d")
        for key in LAWS[friction.law].parameters:
            if getattr(friction, key) is None and not (key == "d" and friction.G_stick is not None):
                name = "G_stick or d" if key == "d" else key
                raise InputError(f"friction.{name} is missing, which law {friction.law} needs", where, f"give {name}")
    if found.joint is not None and (found.belt is None or found.belt.length is None):
        raise InputError("joint needs belt.length", where, "give the length of one turn of the belt")
    if found.belt is not None and found.belt.ripple_hz is not None and found.belt.ripple is None:
        raise InputError("belt.ripple_hz without belt.ripple", where, "give the ripple's amplitude, or drop ripple_hz")
    if found.belt is not None and found.belt.ripple:
        if found.belt.ripple_hz is None:
            raise InputError("belt.ripple_hz is missing", where, "give the ripple's frequency in Hz")
        if found.drive is not None:
            raise InputError("belt.ripple beside a drive", where, "drop one: the integrator supports one harmonic")
    if found.droop is not None:
        if found.belt is None or friction is None:
            raise InputError("droop without belt and friction", where, "add them or drop droop")
        _check_droop(found, found.droop.fraction, where)
    if found.shaker is not None:
        try:
            validate(found.flow())
        except (ValueError, OverflowError) as error:
            what = f"shaker.a = {found.shaker.a:g}, shaker.phi = {found.shaker.phi:g}: {error}"
            raise InputError(what, where, "set belt.speed, a smaller shaker.a, or shaker.phi = 3.14159") from None
    for effect in ("slip_loss", "gaps"):
        if getattr(found, effect) is not None and found.encoder is None:
            raise InputError(f"{effect} without an encoder", where, f"add an encoder section or drop {effect}")
    if found.belt is not None and found.belt.channel and found.encoder is None:
        raise InputError("belt.channel without an encoder", where, "add an encoder section or drop belt.channel")
    if not math.isfinite(found.spring.k / found.mass.m):
        raise InputError("spring.k/mass.m is out of the range of numbers", where, "bring k and m closer together")


def _check_masses(found: Scene, where: str) -> None:
    """Refuse a start that belongs to another number of masses, and what two masses do not have."""
    given = sorted(found.start.model_fields_set)
    if found.coupling is None:
        if other := [key for key in given if key not in ("x", "v")]:
            do = "give start.x and start.v, or add coupling.a and coupling.b"
            raise InputError(f"start.{other[0]} without coupling", where, do)
        return
    for section in found.terms():
        if section not in TWO_MASS_TERMS:
            raise InputError(f"{section} beside coupling: not modelled for two masses", where, f"drop {section}")
    for key in ("start", "length", "ripple", "ripple_hz", "channel"):
        if found.belt is not None and getattr(found.belt, key):
            raise InputError(f"belt.{key} beside coupling: not modelled for two masses", where, f"drop belt.{key}")
    if found.friction is not None and LAWS[found.friction.law].contact != "jump":
        what = f"friction.law is {found.friction.law}, a ramp, which is not modelled for two masses"
        raise InputError(what, where, "take law 1, 3 or 5")
    used = [way for way in STARTS if any(key in given for key in way)]
    if STARTS[0] in used:
        raise InputError("start.x or start.v beside coupling", where, "give start.x1, v1, x2, v2, or start.d")
    if len(used) > 1:
        what = f"start has {used[0][0]} and {used[1][0]}"
        raise InputError(what, where, "keep one of: x1, v1, x2, v2; d; attractor")


def _check_droop(found: Scene, fraction: float, where: str) -> None:
    """Refuse a droop that has no single force, in the words of the scene's own keys."""
    flow = found.model_copy(update={"shaker": None}).flow()
    if flow.droop > 0.0 and flow.static != 1.0:
        raise InputError(f"droop beside friction.static = {flow.static:g}", where, "drop one: with droop it must be 1")
    if flow.droop > 0.0 and flow.Fs == 0.0:
        raise InputError("droop with friction.Fs = 0: nothing loads the belt", where, "give Fs, or drop droop")
    fall = steepest_fall(flow)
    if flow.droop * fall >= 1.0:
        most = fraction / (flow.droop * fall)
        what = f"droop.fraction is {fraction:g}: friction would fall faster than the belt gives way"
        do = f"give less than {most:.4g}" + ("" if most >= 1e-3 else ", or drop droop")
        raise InputError(what, where, do + ", or a slower belt, or friction that falls less (gamma, G_slip)")
    try:
        validate(flow)
    except ValueError as error:
        raise InputError(str(error), where, "change that value, or drop droop") from None
