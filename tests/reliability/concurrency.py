"""Commands at the same time: two recorders, a reader beside a writer, several writers of one file."""

import signal
import time
from pathlib import Path

import h5py
import numpy as np

import daq
from processing import stage
from stickslip.errors import EXIT_DEVICE, EXIT_DONE, EXIT_INPUT, InputError

from ..boards import FakeFrames, motion
from . import tasks
from .forked import Ended, Fork, Server
from .result import Result, Size

RECORDERS, NOTERS = 3, 4
LINE_S = "2"  # of a recording in real time


def concurrency(size: Size, folder: Path, server: Server, sources: Path) -> list[Result]:
    """Run ``size.amount`` rounds of each kind."""
    trial = Rounds(server, folder, sources, np.random.default_rng(size.seed))
    outputs = [fault for k in range(size.amount) for fault in trial.one_output(k)]
    ports = [fault for k in range(size.amount) for fault in trial.one_port(k)]
    unfinished = trial.unfinished()
    writers = [fault for k in range(size.amount) for fault in trial.writers(k)]
    stages = [fault for k in range(size.amount) for fault in trial.fit_and_smooth(k)]
    return [
        Result(
            "of several recorders on one output or one port, one records everything and the others are refused",
            f"{size.amount} times {RECORDERS} recorders on one output, {size.amount} times 2 on one port",
            f"{trial.refused} recorders refused, no sample lost" if not outputs + ports else "see faults",
            (*outputs, *ports),
        ),
        Result(
            "recover, smooth, fit and note refuse an unfinished run and cost its recording no sample; replay reads it",
            f"{len(UNFINISHED)} commands beside a recording",
            f"{len(UNFINISHED)} as promised, the recording complete" if not unfinished else "see faults",
            tuple(unfinished),
        ),
        Result(
            "commands that change a run wait for each other, and a reader sees the old file or the new one",
            f"{size.amount} times {NOTERS} notes and a smoothing of one run at once, while it is read",
            f"{trial.kept} changes kept of {trial.made}, {trial.read} reads whole",
            tuple(writers),
        ),
        Result(
            "a fit stands beside the smoothed motion that it was made from, or is not stored",
            f"{size.amount} fits during which the run was smoothed anew",
            f"{trial.not_stored} refused, {size.amount - trial.not_stored} done before or removed by the smoothing",
            tuple(stages),
        ),
    ]


# What is run beside a recording of run.h5, and its exit code.
UNFINISHED = {
    ("daq", "recover", "run.h5.part"): EXIT_INPUT,
    ("daq", "record", "-o", "run.h5", "--force"): EXIT_INPUT,
    ("process", "smooth", "run.h5"): EXIT_INPUT,
    ("process", "smooth", "run.h5.part"): EXIT_INPUT,
    ("fit-friction", "run.h5"): EXIT_INPUT,
    ("fit-friction", "run.h5.part"): EXIT_INPUT,
    ("daq", "note", "run.h5", "--title", "x"): EXIT_INPUT,
    ("daq", "note", "run.h5.part", "--title", "x"): EXIT_INPUT,
    ("daq", "list", "."): EXIT_DONE,
    ("daq", "replay", "run.h5.part", "-o", "beside.h5"): EXIT_DONE,
}


class Rounds:
    """The rounds, and what is counted over them."""

    def __init__(self, server: Server, folder: Path, sources: Path, chance: np.random.Generator) -> None:
        self._server, self._folder, self._sources, self._chance = server, folder, sources, chance
        self.refused = self.made = self.kept = self.read = self.not_stored = 0

    def one_output(self, k: int) -> list[str]:
        place = self._place(f"output{k}")
        line = ["daq", "record", "--duration", "2", "-o", "run.h5"]
        ended = self._together([line] * RECORDERS, place)
        codes = sorted(each.code for each in ended)
        self.refused += codes.count(EXIT_INPUT)
        where = f"{RECORDERS} recorders on one output, round {k}"
        left = [path.name for path in place.iterdir()]
        if codes != [EXIT_DONE, *[EXIT_INPUT] * (RECORDERS - 1)] or left != ["run.h5"]:
            return [f"{where}: ended with {codes}, left {left}: {[each.err for each in ended]}"]
        samples = daq.load(place / "run.h5").time.size
        return [] if samples == tasks.SAMPLES else [f"{where}: {samples} samples"]

    def one_port(self, k: int) -> list[str]:
        place = self._place(f"port{k}")
        with FakeFrames(place / "tty", paced=True) as board:
            line = ["daq", "record", "--port", str(board.path), "--duration", LINE_S, "-o"]
            ended = self._together([[*line, "0.h5"], [*line, "1.h5"]], place)
        codes = sorted(each.code for each in ended)
        self.refused += codes.count(EXIT_DEVICE)
        runs = sorted(place.glob("*.h5*"))
        if codes != [EXIT_DONE, EXIT_DEVICE] or len(runs) != 1:
            return [f"2 recorders on one port, round {k}: ended with {codes}: {[each.err for each in ended]}"]
        return [f"2 recorders on one port, round {k}: {what}" for what in _incomplete(runs[0])]

    def unfinished(self) -> list[str]:
        place = self._place("unfinished")
        found = []
        with FakeFrames(place / "tty", paced=True) as board:
            line = ["daq", "record", "--port", str(board.path), "--duration", "1000", "-o", "run.h5"]
            recorder = self._server.start(line, place)
            tasks.wait_for_journal(place / "run.h5.part")
            for beside, code in UNFINISHED.items():
                ended = self._server.run(list(beside), place)
                if ended.code != code or ended.traceback:
                    found.append(f"{' '.join(beside)} beside a recording ended with {ended.code}: {ended.err}")
            recorder.send(signal.SIGINT)
            ended = recorder.wait()
        if ended.code or (place / "run.h5.part").exists():
            found.append(f"the recording ended with {ended.code}: {ended.err}")
        else:
            found += _incomplete(place / "run.h5", None)
        return found

    def writers(self, k: int) -> list[str]:
        place, where = self._place(f"writers{k}"), f"writers of one run, round {k}"
        run = place / "run.h5"
        run.write_bytes((self._sources / "run.h5").read_bytes())
        count = daq.load(run).count
        lines = [["daq", "note", "run.h5", "--tag", f"tag{n}=1"] for n in range(NOTERS)]
        forks = self._started([*lines, ["process", "smooth", "run.h5"]], place)
        found, until = [], time.monotonic() + 0.5
        while time.monotonic() < until:
            self.read += 1
            try:
                if not np.array_equal(daq.load(run).count, count):
                    found.append(f"{where}: a reader saw other counts")
            except InputError as error:
                found.append(f"{where}: a reader saw {error}")
        ended = [fork.wait() for fork in forks]
        codes = [each.code for each in ended]
        if any(codes):
            found.append(f"{where}: ended with {codes}: {[each.err for each in ended]}")
        tags = sum(f"tag{n}" in daq.load(run).tags for n in range(NOTERS))
        with h5py.File(run) as file:
            smoothed = "entry/smooth" in file
        self.made += NOTERS + 1
        self.kept += tags + smoothed
        if (tags, smoothed, len(list(place.iterdir()))) != (NOTERS, True, 1):
            found.append(f"{where}: {tags} of {NOTERS} tags, smoothed: {smoothed}, left {list(place.iterdir())}")
        return found

    def fit_and_smooth(self, k: int) -> list[str]:
        place, where = self._place(f"stages{k}"), f"a fit beside a smoothing, round {k}"
        run = place / "run.h5"
        run.write_bytes((self._sources / "warm.h5").read_bytes())
        fit = self._server.start(["fit-friction", "run.h5", "--laws", "5", "--no-report"], place)
        time.sleep(float(self._chance.uniform(0.0, 1.0)))
        smoothed = self._server.run(["process", "smooth", "run.h5", "--method", "sg"], place)
        fitted = fit.wait()
        found = []
        if smoothed.code or fitted.code not in (EXIT_DONE, EXIT_INPUT) or fitted.traceback:
            found.append(f"{where}: ended with {smoothed.code} and {fitted.code}: {smoothed.err} {fitted.err}")
        self.not_stored += fitted.code == EXIT_INPUT
        with h5py.File(run) as file:
            if "entry/fit" in file:
                made_from = file["entry/fit/parameters/sha256_smooth"].asstr()[()]
                if made_from != stage.digest(file["entry"]):
                    found.append(f"{where}: the fit was made from another smoothed motion")
        return found

    def _place(self, name: str) -> Path:
        place = self._folder / name
        place.mkdir()
        return place

    def _started(self, lines: list[list[str]], place: Path) -> list[Fork]:
        forks = []
        for line in lines:
            forks.append(self._server.start(line, place))
            time.sleep(float(self._chance.choice([0.0, 0.01, 0.05])))
        return forks

    def _together(self, lines: list[list[str]], place: Path) -> list[Ended]:
        return [fork.wait() for fork in self._started(lines, place)]


def _incomplete(path: Path, samples: int | None = 1000 * int(LINE_S)) -> list[str]:
    """Return what is missing in a run of the board: every sample, each with its count."""
    run = daq.load(path)
    k = np.round(run.time * 1000).astype(int)
    whole = np.array_equal(k, np.arange(k.size)) and np.array_equal(run.count - run.count[0], motion(k) - motion(0))
    return [] if whole and samples in (None, k.size) else [f"{path.name} holds {k.size} samples, whole: {whole}"]
