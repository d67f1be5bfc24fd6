"""Numbers at the ends of a float64, in scenes and in tables: each ends in a result, or in an error that names it.

To see one end again: run the command that the fault gives.
"""

import shlex
from pathlib import Path

import numpy as np

from rig_sim.scenes import scene
from stickslip.errors import EXIT_DONE

from .forked import Ended, Server
from .result import Result, Size

# Zero, a denormal, the least normal number, and numbers whose squares, products or sums overflow.
VALUES = (
    *("1e300", "nan", "5e-324", "inf", "0", "-1", "1e-300", "-1e300", "2.3e-308", "1.7e308", "-inf", "1e-9", "1e9"),
    "-0.0",
)
NAMED = (0, 2, 3, 4, 5)  # exit codes that say what was wrong, or that nothing was
LONGEST_S = 10.0  # of CPU time
SCENE_S = "0.2"
TABLE = 400  # rows


def numerics(size: Size, folder: Path, server: Server) -> list[Result]:
    """Give ``size.amount`` of the values to every number of a scene, and to a table."""
    values = VALUES[: size.amount]
    work = folder / "work"
    work.mkdir()
    _table(work / "warm.csv", "0.01", 0)
    server.warm(["daq", "record", "--duration", SCENE_S, "-o", "warm.h5"], work)
    server.warm(["daq", "import", "warm.csv", "-o", "warm2.h5", "--mass", "1 kg", "--stiffness", "10 N/m"], work)
    server.warm(["process", "smooth", "warm2.h5"], work)
    scenes, tried = _scenes(server, work, values)
    tables, files = _tables(server, work, values)
    return [
        Result(
            "a scene with numbers at the ends of a float64 is played, or refused with their name",
            f"{', '.join(values)} for each of {tried // len(values)} numbers of a scene",
            f"{tried} recordings, {len(scenes)} without a named outcome",
            tuple(scenes),
        ),
        Result(
            "a table with such numbers is imported and smoothed, or refused with its line",
            "the same as a time and as a position, in the first, a middle and the last row, and in all",
            f"{files} tables, {len(tables)} without a named outcome",
            tuple(tables),
        ),
    ]


def _scenes(server: Server, folder: Path, values: tuple[str, ...]) -> tuple[list[str], int]:
    faults, tried = [], 0
    for name in _numbers(scene.scene("rig").model_dump()):
        for value in values:
            tried += 1
            line = ["daq", "record", "--duration", SCENE_S, "--set", f"{name}={value}", "-o", "scene.h5", "--force"]
            faults += _wrong(server.run(line, folder), line)
            for left in folder.glob("scene.h5*"):
                left.unlink()
    return faults, tried


def _numbers(tree: dict[str, object], prefix: str = "") -> list[str]:
    found = []
    for name, value in tree.items():
        if isinstance(value, dict):
            found += _numbers(value, f"{prefix}{name}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            found.append(prefix + name)
    return found


def _tables(server: Server, folder: Path, values: tuple[str, ...]) -> tuple[list[str], int]:
    faults, tried = [], 0
    places: tuple[slice | int, ...] = (0, TABLE // 2, TABLE - 1, slice(None))
    for column in (0, 1):
        for value in values:
            for place in places:
                tried += 1
                _table(folder / "t.csv", value, column, place)
                line = ["daq", "import", "t.csv", "-o", "t.h5", "--mass", "1 kg", "--stiffness", "10 N/m"]
                done = server.run(line, folder)
                faults += [f"{fault}, {value} in column {column} at {place}" for fault in _wrong(done, line)]
                if done.code == EXIT_DONE:
                    line = ["process", "smooth", "t.h5"]
                    done = server.run(line, folder)
                    faults += [f"{fault}, {value} in column {column} at {place}" for fault in _wrong(done, line)]
                for left in folder.glob("t.*"):
                    left.unlink()
    return faults, tried


def _table(path: Path, value: str, column: int, place: slice | int = 0) -> None:
    cells = np.array([[f"{k / 100!r}", f"{0.01 * np.sin(k / 20):.6f}"] for k in range(TABLE)], dtype=object)
    cells[place, column] = value
    path.write_text("t_s,x_m\n" + "\n".join(",".join(row) for row in cells) + "\n")


def _wrong(done: Ended, line: list[str]) -> list[str]:
    again = shlex.join(line)
    if done.hung or done.cpu_s > LONGEST_S:
        return [f"{done.cpu_s:.0f} s of CPU time: {again}"]
    if done.traceback or done.code not in NAMED:
        return [f"exit {done.code}, {done.err.strip().splitlines()[-1:]}: {again}"]
    return []
