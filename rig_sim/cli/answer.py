"""What all commands of ``rig-sim`` share: the scene as typed, and a result as text, JSON and picture."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from stickslip.console.application import Answer

if TYPE_CHECKING:
    from rig_sim.results.result import Result
    from rig_sim.scenes.model import Scene


def load_changed(name: str, changes: list[str] | None) -> "Scene":
    from rig_sim.scenes.scene import parse_changes, scene

    return scene(name, **parse_changes(changes))


def make_answer(result: "Result", plot: Path | None = None, force: bool = False) -> Answer:
    """Return a result as the command's answer; ``plot``: drawn into this file, which the answer names."""
    data: dict[str, Any] = result.as_json()
    lines = result.lines()
    if plot is not None and (nothing := result.undrawn()):
        lines = [*lines, f"nothing drawn: {nothing}"]
    elif plot is not None:
        from stickslip.output.plot import save

        save(result.plot(), plot, force=force)
        data["file"] = plot
        lines = [*lines, str(plot)]
    return Answer(data, "\n".join(lines))
