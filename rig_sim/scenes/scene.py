"""Scenes: a TOML file or a built-in name lists what exists on the rig; what is not listed does not exist.

========= ===================================== ========================================================================
section   keys                                  meaning
========= ===================================== ========================================================================
mass      m                                     required
spring    k, x0 = 0                             required; x0: the spring's rest position
belt      speed, start = 0, length, ripple,    at rest before ``start``, then at ``speed``, which swings by ``ripple``;
          ripple_hz, channel                    one turn is ``length``; channel = true: the board sends its counts too
friction  law, Fs, G_slip, gamma, G_stick or d, a law takes the parameters it needs and leaves the others alone
          static = 1                            ("lugre", "dahl", "ageing", "slip": `rig_sim.friction.memory`)
          curve, contact = "jump"               of law 0: [[slip speed, friction], ...] from speed 0; or "ramp", with d
          formula, and its parameters           instead of law: "Fc + (Fs - Fc)*exp(-s/v_s)", s the slip speed; with d
                                                or G_stick behind a ramp, unless contact = "jump"
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
fit       parameters, values, covariance,       what a fit knows of the keys above: `rig_sim.scenes.draws` draws from it
          cycles, verdict, mass_assumed
output    truth                                 the board also sends the exact motion; older name: tell
========= ===================================== ========================================================================

Naming a law in a change removes the formula with its parameters; naming a formula removes law, curve, contact, G_stick
and d.

Top-level keys: name, title, seed (default 0).  SI units, or dimensionless throughout.  ``G_stick = -static Fs/d``:
naming one of the two in a change removes the other; so does naming another way to start.
"""

from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from rig_sim.friction.formula import Formula
from rig_sim.friction.memory import MEMORY_LAWS
from rig_sim.scenes.checks import check_magnitudes, check_together
from rig_sim.scenes.model import STARTS, Scene
from rig_sim.scenes.sections import Section
from stickslip import units
from stickslip.errors import InputError, nearest

BUILTIN_FOLDER = Path(__file__).parent / "builtin"
FRICTION_IS = ("friction.law", "friction.formula")
MEMORY_PARAMETERS = {name: item for law in MEMORY_LAWS.values() for name, item in law.parameters.items()}
OLD_NAMES = {"tell": "output"}  # old names of sections, still accepted
FORM = "write section.key=value"
IN_PYTHON = "write rig_sim.scene('rig', **{'section.key': value})"
LARGEST_FILE = 1 << 20  # bytes of a scene file; a longer file is not a scene, and may be endless


def builtin_names() -> list[str]:
    return sorted(path.stem for path in BUILTIN_FOLDER.glob("*.toml"))


def scene(source: "str | Path | Scene", **changes: object) -> Scene:
    """Return a scene, built in or read from a TOML file, with some keys changed.

    Parameters
    ----------
    source : str, Path or Scene
        A built-in name (`builtin_names`), the path of a TOML file, or a scene to change, which stays as it is.
    **changes
        Either dotted keys, ``scene("rig", **{"friction.law": 3})``, or whole or partial sections,
        ``scene("rig", friction={"law": 3}, seed=7)``.  A section that is absent is created; naming ``G_stick`` removes
        ``d`` and the other way round.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        No such scene, a file that is not TOML, an unknown section or key (with its nearest neighbour), a value that is
        no finite number or out of its range (of any number: 0, or from 1e-100 to 1e100 in size): each names the
        file and the key.

    Examples
    --------
    >>> import rig_sim
    >>> mine = rig_sim.scene("rig", **{"friction.law": 3, "belt.speed": 0.1}, seed=7)
    >>> mine.friction.law, mine.belt.speed, mine.terms()[:3]
    (3, 0.1, ['mass', 'spring', 'belt'])
    """
    if isinstance(source, Scene):
        where, content = f"scene {source.name}", source.model_dump(exclude_unset=True)
    else:
        where, content = read_source(source)
    flat: dict[str, object] = {}
    for key, value in changes.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}.{inner}": item for inner, item in value.items()}
        else:
            flat[key] = value
    # the law or formula comes first: it drops the parameters of the previous one, not those that come with it
    for key in sorted(flat, key=lambda name: name not in FRICTION_IS):
        apply_change(content, key, flat[key], where)
    return validate_content(content, where)


def change_in_python(name: str, key: str, value: str) -> str:
    """Return the Python call that changes a key of a scene, for messages; ``name`` need not be a built-in one."""
    source = repr(name) if name in builtin_names() else "scene"
    return f"rig_sim.scene({source}, **{{{key!r}: {value}}})"


def parse_changes(settings: Iterable[str] | None) -> dict[str, object]:
    """Return settings such as ``friction.law=3`` (of ``--set``) as changes for `scene`: TOML or bare words."""
    changes: dict[str, object] = {}
    for setting in settings or ():
        key, equals, value = setting.partition("=")
        if not equals or not key.strip() or not value.strip() or "\n" in value.strip():
            raise InputError(f"{setting!r} does not change a scene", "--set", FORM, python=IN_PYTHON)
        changes[key.strip()] = parse_value(value.strip())
    return changes


def parse_value(text: str) -> object:
    import tomllib

    from stickslip import toml

    try:
        value = tomllib.loads(f"value = {text}")["value"]
        return float(text) if toml.has_wide_number(value) else value
    except RecursionError:
        raise InputError(f"{text[:20]}... is nested too deeply", "--set", FORM, python=IN_PYTHON) from None
    except ValueError:  # not TOML, or a number of thousands of digits
        pass
    try:
        return float(text)
    except ValueError:
        return {"true": True, "false": False}.get(text.lower(), text)


def read_source(name_or_path: "str | Path") -> tuple[str, dict[str, Any]]:
    name = str(name_or_path)
    path = BUILTIN_FOLDER / f"{name}.toml"
    where = f"scene {name}"
    if name not in builtin_names():
        path, where = Path(name), name
        if path.suffix != ".toml" and not path.exists():
            raise InputError(
                f"there is no built-in scene {name!r} and no such file",
                "scene",
                f"{nearest(name, builtin_names())}; or use the path of a TOML file",
            )
    try:
        if path.exists() and not path.is_file():
            raise InputError("is a folder or a device, not a file", where, "use the path of a TOML file")
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
        if len(data) > LARGEST_FILE:
            raise InputError(
                f"is too large for a scene: over {LARGEST_FILE} bytes", where, "use the TOML file of a scene"
            )
        content = {
            name: dict(keys) if isinstance(keys, dict) else keys for name, keys in parse_toml(data, where).items()
        }
    except FileNotFoundError:
        do = f"check the path, or use a built-in scene: {', '.join(builtin_names())}"
        raise InputError("no such file", where, do) from None
    except UnicodeDecodeError:
        do = "use the TOML file of a scene; for a run, fit-friction RUN.h5 --save-scene FILE.toml writes one"
        raise InputError("is not a text file", where, do) from None
    except OSError as error:
        raise InputError(f"cannot be read ({error})", where, "use the path of a TOML file") from None
    content.setdefault("name", path.stem)
    return where, {OLD_NAMES.get(section, section): keys for section, keys in content.items()}


@lru_cache(maxsize=4)  # an analysis reads a scene again for each value of a parameter, and each draw
def parse_toml(data: bytes, where: str) -> dict[str, Any]:
    from stickslip import toml

    return toml.parse(data.decode(), where)


def apply_change(content: dict[str, Any], dotted: str, value: object, where: str) -> None:
    section, dot, key = dotted.partition(".")
    section = OLD_NAMES.get(section, section)
    if not dot:
        content[section] = value
        return
    is_value = section in Scene.model_fields and not list_keys(section)
    if is_value or not isinstance(content.setdefault(section, {}), dict):
        raise InputError(f"{section!r} is a plain value and has no key {key!r}", where, f"set {section} itself")
    content[section][key] = value
    if section == "friction" and key in ("G_stick", "d"):
        content[section].pop("d" if key == "G_stick" else "G_stick", None)
    if dotted in FRICTION_IS:
        _replace_law(content[section], key)
    if section == "start":
        for form in STARTS:
            for other in form if key not in form else ():
                content[section].pop(other, None)


def _replace_law(friction: dict[str, Any], key: str) -> None:
    """Drop the parameters of the previous law or formula: those of a formula or a memory are its own."""
    are_others = has_memory(friction) if key == "formula" else "formula" in friction or not has_memory(friction)
    for other in ("law", "curve", "contact", "G_stick", "d") if key == "formula" else ("formula",):
        friction.pop(other, None)
    for other in [name for name in friction if name not in list_keys("friction")] if are_others else ():
        del friction[other]


def has_memory(friction: Mapping[str, Any]) -> bool:
    return str(friction.get("law")) in MEMORY_LAWS


def validate_content(content: dict[str, Any], where: str) -> Scene:
    _refuse_unknown(content, where)
    _convert_quantities(content, where)
    name = str(content.get("name", ""))
    try:
        validated = Scene.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        if first["type"] == "missing":
            do, python = (
                f"set it in the file, or with --set {example_key(key)}=...",
                change_in_python(name, example_key(key), "VALUE"),
            )
            raise InputError(f"{key} is missing", where, do, python=f"write {python}") from None
        if first["type"] == "model_type":
            do = f"write --set {key}.KEY=VALUE, or a table [{key}]"
            python = change_in_python(name, f"{key}.KEY", "VALUE")
            problem = f"{key} is {first['input']!r:.60}, but it is a section"
            raise InputError(problem, where, do, python=f"write {python}") from None
        reason = (first["msg"][0].lower() + first["msg"][1:]).replace("input should", "it should")
        raise InputError(
            f"{key} is {first['input']!r:.60}", where, reason.replace("input should", "it should")
        ) from None
    check_magnitudes(validated, where)
    check_together(validated, where)
    return validated


def example_key(key: str) -> str:
    return {"mass": "mass.m", "spring": "spring.k"}.get(key, key)


def _refuse_unknown(content: Mapping[str, Any], where: str) -> None:
    for section, keys in content.items():
        if section not in Scene.model_fields:
            kind = "section" if isinstance(keys, dict) else "key"
            raise InputError(f"unknown {kind} {section!r}", where, nearest(section, list(Scene.model_fields)))
        if not isinstance(keys, dict):
            continue
        known_keys = list_keys(section)
        if section == "friction":
            others = _formula_parameters(text, where) if isinstance(text := keys.get("formula"), str) else ()
            known_keys = list(dict.fromkeys([*others, *known_keys, *(MEMORY_PARAMETERS if has_memory(keys) else ())]))
        for key in keys:
            if key not in known_keys:
                raise InputError(f"unknown key '{section}.{key}'", where, nearest(key, known_keys))


def _convert_quantities(content: dict[str, Any], where: str) -> None:
    """Convert parameters of a law with memory that are text with a unit, such as '20 um', to numbers in SI."""
    friction = content.get("friction")
    if not isinstance(friction, dict) or not has_memory(friction):
        return
    for name, parameter in MEMORY_PARAMETERS.items():
        if isinstance(friction.get(name), str):
            friction[name] = units.quantity(friction[name], parameter.dimension, f"{where}: friction.{name}")


def _formula_parameters(text: str, where: str) -> tuple[str, ...]:
    try:
        return Formula.parse(text).parameters
    except InputError as error:
        raise InputError(f"friction.formula: {error.what}", where, error.do) from None


def list_keys(section: str) -> list[str]:
    annotation = Scene.model_fields[section].annotation
    for model in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(model, type) and issubclass(model, Section):
            return list(model.model_fields)
    return []
