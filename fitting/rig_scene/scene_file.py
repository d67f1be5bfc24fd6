"""The TOML text of a fitted rig's scene (`fitting.rig_scene.fitted_scene`), and its file."""

from pathlib import Path

from daq.base.output import atomic
from fitting.rig_scene.fitted_scene import FittedScene
from fitting.selection.result import Ranking


def text(found: FittedScene, ranking: Ranking, run: Path) -> str:
    """Return the TOML text of a scene."""
    number = dict(zip(found.keys, found.values.tolist(), strict=True))
    assumed = "mass.m" not in number
    mass = number.get("mass.m", 1.0)
    curve = [number[f"friction.curve.{i}"] for i in range(found.points.size)]
    lines = [f"# Fitted rig, written by fit-friction from {_quoted(run.name)}."]
    if assumed:
        lines.append(
            "# No mass or stiffness is known: mass 1 kg is assumed, so that N here are N per kg of the rig's mass."
        )
    kind = f"law {found.law}" if found.law else ranking.best.label if found.formula else "measured curve"
    lines += [f"title = {_quoted(f'fitted to {run.name}: {kind}')}"]
    lines += [
        "",
        "[mass]",
        f"m = {mass!r}",
        "",
        "[spring]",
        f"k = {number['spring.k']!r}",
        f"x0 = {number['spring.x0']!r}",
    ]
    lines += [
        "",
        "[belt]",
        f"speed = {number['belt.speed']!r}",
        "",
        "[damper]",
        f"c = {max(number['damper.c'], 0.0)!r}",
    ]
    lines += ["", "[start]", f"x = {number['spring.x0']!r}", "", "[friction]"]
    lines += [f"formula = {_quoted(found.formula)}" if found.formula else f"law = {found.law}"]
    lines += [f"{key} = {value!r}" for key, value in found.fixed.items()]
    lines += [
        f"{name.removeprefix('friction.')} = {value!r}"
        for name, value in number.items()
        if name.startswith("friction.") and not name.startswith("friction.curve.")
    ]
    if curve:
        lines += ['contact = "ramp"'] if found.ramp else []
        lines += ["# slip speed in m/s, friction in N" + (" per kg" if assumed else ""), "curve = ["]
        lines += [f"    [{s!r}, {F!r}]," for s, F in zip(found.points.tolist(), curve, strict=True)]
        lines += ["]"]
    if "droop.fraction" in number:
        lines += ["", "[droop]", f"fraction = {max(number['droop.fraction'], 0.0)!r}"]
    if found.scatter > 0:
        lines += ["", "[scatter]", f"Fs = {found.scatter!r}"]
    lines += ["", "[fit]", f"verdict = {_quoted(ranking.verdict)}", f"cycles = {found.cycles}"]
    lines += [f"mass_assumed = {str(assumed).lower()}"]
    lines += ["parameters = [" + ", ".join(_quoted(name) for name in found.keys) + "]"]
    lines += [f"values = {found.values.tolist()!r}", "covariance = ["]
    lines += [f"    {row!r}," for row in found.covariance.tolist()]
    return "\n".join([*lines, "]"]) + "\n"


def _quoted(words: str) -> str:
    """Return a TOML basic string."""
    plain = words.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(letter if letter.isprintable() else " " for letter in plain) + '"'


def write(path: Path, content: str) -> None:
    """Write a scene's text, replacing what stands there: see `refuse_existing`."""
    with atomic.replacing(path, force=True) as temporary:
        temporary.write_text(content, encoding="utf-8")


def refuse_existing(path: Path, files: list[Path], *, force: bool) -> None:
    """Raise InputError when a scene cannot go to ``path``: a folder, a run, or a file that exists without ``force``."""
    atomic.refuse_existing(path, force, *files, kind="scene", flag="--save-scene")
