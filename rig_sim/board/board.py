"""The board: samples the encoder's counters at the commanded rate and speaks the wire of `daq.wire.frames`.

Rules.  Time 0 is the first sample, where the device clock (1 us ticks) reads 0.  Sample i is taken at i/rate plus
jitter, and the recorded time is that true instant, rounded down to its tick: jitter is recorded, not hidden.  The
motion stands still while no samples are asked for.  Counters are 16 bits wide and wrap.  The simulated decoder follows
any edge rate, so its illegal count stays 0; the simulated line carries any frame rate.

``I`` identify, ``R <hz>`` rate, ``B <n>`` samples per frame, ``M <decoder>`` decoder (counters start again), ``S``
start, ``X`` stop (flushes the partial block); a command that is unknown or impossible is answered by a NOTICE and
changes nothing.  CONFIG holds the rig's constants as a laboratory would have measured them: each is drawn about
the true value with the standard deviation stated beside it.

Lost counts (`slip_loss`), samples that are not sent (`gaps`) and the belt's counts (`belt_encoder`) exist when the
scene names them.

Not modelled: baud rate, a board that resets, drift of the device clock.
"""

import random
from itertools import groupby, pairwise

import numpy as np
from numpy.typing import NDArray

from daq.wire import frames as wire
from daq.wire.quadrature import EDGES_PER_COUNT
from rig_sim.board.belt_encoder import BeltEncoder
from rig_sim.board.disturbances import JitteringClock, LosingCog, SilentStretches
from rig_sim.board.encoder import QuadratureEncoder
from rig_sim.motion.play import ScenePlayer
from rig_sim.motion.trajectory import Trajectory
from rig_sim.scenes.model import Scene
from rig_sim.scenes.sections import Encoder
from stickslip.errors import InputError

FIRMWARE = (0, 1, 0)
COUNTER_BITS = 16
TICK_NS = 1000
MAX_RATE_HZ = 100_000
MAX_EDGE_RATE_HZ = 1_000_000_000  # the simulated decoder misses nothing
LONGEST_DT = 0xFFFF  # ticks between two samples of one frame

# Relative standard deviations of the lab's measurements; the datum's is a fraction of the cog's circumference (0.5 mm
# on `rig`), the damping's a fraction of critical damping, as from a ring-down.
CONFIG_SD = {"metres_per_count": 2e-4, "mass": 1e-3, "datum": 0.004, "damping": 1e-3, "belt_speed": 0.01}
BELT_PITCH_SD = 2e-4  # relative, of the metres per belt count


class SimulatedBoard:
    """A board that samples a simulated scene, which must have an encoder."""

    def __init__(self, scene: Scene) -> None:
        if scene.encoder is None:
            raise InputError(
                "the scene has no encoder, so there is nothing to count",
                f"scene {scene.name}",
                "set encoder.lines_per_rev and encoder.circumference, or use the scene rig",
            )
        self.scene = scene
        self.rate_hz = 1000
        self.block = 8
        self.running = False
        self._section: Encoder = scene.encoder
        self._motion = ScenePlayer(scene)
        self._encoder = QuadratureEncoder(scene.encoder, scene.start.x)
        loss, gaps, jitter, seed = scene.slip_loss, scene.gaps, scene.jitter, scene.seed
        self._cog = None if loss is None else LosingCog(loss, seed, scene.encoder.metres_per_count)
        self._silence = None if gaps is None else SilentStretches(gaps, seed)
        self._jitter = None if jitter is None else JitteringClock(jitter, seed)
        self._belt = BeltEncoder(scene) if scene.belt is not None and scene.belt.channel else None
        self._sample = 0  # samples since S
        self._started = 0.0  # time of the sample 0 of this S
        self._queued = 0  # samples up to and with the last one that waits for its frame
        self._clock: float | None = None  # true instant of the last sample, s
        self._pending: list[tuple[int, ...]] = []
        self._truth: list[tuple[float, float, float, float]] = []
        self._line = b""

    def power_up(self) -> bytes:
        return wire.encode_ident(self._ident())

    def write(self, data: bytes) -> bytes:
        """Take bytes of commands as they come and return the answers."""
        *lines, self._line = (self._line + data).split(b"\n")
        return b"".join(self._command(line.decode("ascii", "replace").strip()) for line in lines)

    def samples(self, count: int) -> bytes:
        """Take the next ``count`` samples and return the frames they fill; none unless started.

        A motion that cannot continue (friction that changes its sign, say) stops the sampling with a NOTICE of the
        reason.
        """
        if not self.running or count <= 0:
            return b""
        instants = self._next_instants(count)
        path = self._motion.follow(instants, forces=self._sends_truth)
        nodes = path.nodes if self._cog is None else self._cog.apply_losses(path.nodes, path.samples, 1 / self.rate_hz)
        counts = self._encoder.read(nodes, path.samples)
        reached = len(path.samples)
        ticks = round_to_ticks(instants[:reached])
        status = counts.levels
        columns = [ticks, counts.up & 0xFFFF, counts.down & 0xFFFF, status]
        if self._belt is not None:
            columns.append(self._belt.read(path) & 0xFFFF)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        truth = read_truth(path) if self._sends_truth else []
        self._sample -= count - reached
        frames = self._frame_samples(list(rows), truth, instants[:reached].tolist())
        if reached == count:
            return b"".join(frames)
        self.running = False
        outcome = self._motion.outcome
        notice = f"the motion ended at {self._motion.t:.6g} s: {outcome.name}; {outcome.advice}"
        return b"".join(frames + self._take_frames(flush=True)) + wire.encode_notice(notice)

    @property
    def _sends_truth(self) -> bool:
        return self.scene.output is not None and self.scene.output.truth

    def _command(self, line: str) -> bytes:
        word, _, argument = line.partition(" ")
        if word == "I":
            return wire.encode_ident(self._ident()) + wire.encode_config(format_calibration(self.scene, self._encoder))
        if word == "X":
            self.running = False
            return b"".join(self._take_frames(flush=True))
        if word in ("R", "B", "M", "S") and self.running:
            return wire.encode_notice(f"{line}: sampling; stop it first with X")
        if word == "R":
            return self._set_rate(argument)
        if word == "B":
            return self._set_block(argument)
        if word == "M":
            return self._set_decoder(argument)
        if word == "S":
            return self._start()
        return (
            wire.encode_notice(f"{line[:40]!r} is no command; known: I, R <hz>, B <n>, M <decoder>, S, X")
            if line
            else b""
        )

    def _set_rate(self, argument: str) -> bytes:
        rate = parse_whole(argument)
        if rate is None or not 1 <= rate <= MAX_RATE_HZ:
            return wire.encode_notice(f"R {argument}: the rate is a whole number from 1 to {MAX_RATE_HZ} Hz")
        self.rate_hz = rate
        return b""

    def _set_block(self, argument: str) -> bytes:
        block = parse_whole(argument)
        if block is None or not 1 <= block <= 255:
            return wire.encode_notice(f"B {argument}: samples per frame are 1 to 255")
        self.block = block
        return b""

    def _set_decoder(self, argument: str) -> bytes:
        if argument not in EDGES_PER_COUNT:
            return wire.encode_notice(f"M {argument}: no such decoder; known: {', '.join(EDGES_PER_COUNT)}")
        self._encoder = QuadratureEncoder(self._section, self._motion.x, self._motion.t, argument)
        if self._belt is not None:
            self._belt.restart()
        return b""

    def _start(self) -> bytes:
        longest = 2_000_000 // self.rate_hz  # two periods, so that jitter fits too
        if self.block > 1 and longest > LONGEST_DT:
            return wire.encode_notice(
                f"S: at {self.rate_hz} Hz two samples of a block are too far apart for its 16-bit time difference; "
                "send single frames (B 1)"
            )
        self._started = 0.0 if self._clock is None else self._clock + 1 / self.rate_hz
        self._sample = 0
        self.running = True
        return b""

    def _next_instants(self, count: int) -> NDArray[np.float64]:
        """Return the true times (s) of the next samples: the grid plus jitter."""
        instants = self._started + (self._sample + np.arange(count)) / self.rate_hz
        if self._jitter is not None:
            instants += self._jitter.draw_offsets(count, 1 / self.rate_hz, first=self._clock is None)
        self._sample += count
        self._clock = float(instants[-1])
        return instants

    def _frame_samples(
        self, rows: list[tuple[int, ...]], truth: list[tuple[float, float, float, float]], instants: list[float]
    ) -> list[bytes]:
        """Queue the samples outside all gaps and return the frames they fill; a gap ends its block."""
        frames: list[bytes] = []
        first = 0
        sequence = self._sample - len(rows)
        gaps = self._silence
        is_sent = [True] * len(rows) if gaps is None else gaps.mark_sent(instants)
        for sent, same in groupby(is_sent):
            last = first + len(list(same))
            if sent:
                self._pending += rows[first:last]
                self._truth += truth[first:last]
                self._queued = sequence + last
            frames += self._take_frames(flush=not sent)
            first = last
        return frames

    def _take_frames(self, flush: bool = False) -> list[bytes]:
        """Return the frames of the waiting samples; ``flush`` also sends a last block that is not full."""
        frames: list[bytes] = []
        waiting = len(self._pending)
        sent = 0
        while waiting - sent >= self.block or (flush and waiting > sent):
            rows = self._pending[sent : sent + self.block]
            seq = self._queued - waiting + sent & 0xFFFF
            ticks, up, down, status, *more = zip(*rows, strict=True)
            dt = [0, *(later - earlier for earlier, later in pairwise(ticks))]
            belt = more[0] if more else None
            block = wire.SampleBlock(seq, ticks[0] & 0xFFFFFFFF, 0, dt, up, down, status, belt)
            frames.append(wire.encode_samples(block))
            if self._sends_truth:
                frames.append(wire.encode_truth(wire.TruthFrame(seq, self._truth[sent : sent + self.block])))
            sent += len(rows)
        del self._pending[:sent]
        del self._truth[:sent]
        return frames

    def _ident(self) -> wire.Ident:
        has = wire.Capability
        capabilities = has.BLOCKS | has.LEVELS | has.ILLEGAL | has.CONFIG
        if self._belt is not None:
            capabilities |= has.BELT
        return wire.Ident(
            firmware=FIRMWARE,
            decoder=self._encoder.decoder,
            capabilities=capabilities | has.TRUTH if self._sends_truth else capabilities,
            counter_bits=COUNTER_BITS,
            tick_ns=TICK_NS,
            block_size=self.block,
            max_rate_hz=MAX_RATE_HZ,
            max_edge_rate_hz=MAX_EDGE_RATE_HZ,
            name=f"simulated rig, scene {self.scene.name}{self._jitter_note()}",
        )

    def _jitter_note(self) -> str:
        """Return a note for the board's name where jitter is clipped to keep the samples in order, else nothing."""
        if self._jitter is None or not self._jitter.is_clipped(1 / self.rate_hz):
            return ""
        return f" (jitter cut off at {self._jitter.limit(1 / self.rate_hz):.2g} s)"


def format_calibration(scene: Scene, encoder: QuadratureEncoder) -> str:
    """Return the CONFIG text: the rig's constants with measurement errors, drawn once per seed about the true values.

    Position of the mass from the spring's rest = (up - down) * metres_per_count + datum, the middle of the count.
    """
    draw = random.Random(f"{scene.seed}/calibration")
    pitch = encoder.delta * EDGES_PER_COUNT[encoder.decoder]
    critical = 2 * (scene.spring.k * scene.mass.m) ** 0.5
    size = {
        "metres_per_count": pitch,
        "mass": scene.mass.m,
        "datum": encoder.section.circumference,
        "damping": critical,
        "belt_speed": abs(scene.belt.speed) if scene.belt else 0.0,
    }
    sd = {key: CONFIG_SD[key] * size[key] for key in size}
    error = {key: draw.gauss(0.0, sd[key]) for key in size}  # always all five: a seed means the same rig
    damping = max(0.0, (scene.damper.c if scene.damper else 0.0) + error["damping"])
    lines = [
        "[rig]",
        f'name = "simulated rig, scene {scene.name}"',
        *format_measurement("mass", scene.mass.m + error["mass"], sd["mass"]),
        *format_measurement("damping", damping, sd["damping"]),
    ]
    if scene.belt:
        lines += format_measurement("belt_speed", scene.belt.speed + error["belt_speed"], sd["belt_speed"])
    lines += [
        "[encoder]",
        f'decoder = "{encoder.decoder}"',
        *format_measurement("metres_per_count", pitch + error["metres_per_count"], sd["metres_per_count"]),
        f"counts_per_revolution = {encoder.section.lines_per_rev * 4 // EDGES_PER_COUNT[encoder.decoder]}",
        f"counter_bits = {COUNTER_BITS}",
        *format_measurement("datum", encoder.origin - scene.spring.x0 + error["datum"], sd["datum"]),
    ]
    if scene.belt and scene.belt.channel:
        belt_sd = BELT_PITCH_SD * encoder.delta  # drawn last: the other five are the same without a channel
        lines += format_measurement("belt_metres_per_count", encoder.delta + draw.gauss(0.0, belt_sd), belt_sd)
    return "\n".join(lines) + "\n"


def format_measurement(key: str, value: float, sd: float) -> list[str]:
    return [f"{key} = {float(value)!r}", f"{key}_sd = {float(sd)!r}"]


def read_truth(path: Trajectory) -> list[tuple[float, float, float, float]]:
    samples = path.samples
    columns = (path.nodes.t[samples], path.nodes.x[samples], path.nodes.v[samples], path.F)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def round_to_ticks(instants: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the device times in ticks, rounded down; a time of a whole number of ticks keeps that number."""
    return np.floor(instants * (1e9 / TICK_NS) + 1e-6).astype(np.int64)


def parse_whole(text: str) -> int | None:
    return int(text) if text.isdecimal() else None
