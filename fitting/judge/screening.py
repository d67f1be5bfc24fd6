"""Records that are rejected: lost frames with even time stamps, too few samples in a slip, no belt stick-slip.

Frames.  A lost (or doubled) frame moves all later positions by v dt.  The residual of a window is then noise plus a
random walk, whose variance grows by p (v dt)^2 a sample when a share p of the frames is missing.  The residual is
divided into pieces.  A cubic and the mean over the cycles are subtracted from each, which removes the misfit of a wrong
law, a ripple or wear.  The squared modes of the walk are regressed on the variances of noise and walk in each mode.
Noise may be correlated over three samples; where rounding dominates it, nothing is tested.

Stick-slip.  A record without cycles, or that no law fits roughly, is rejected; properties of the motion explain why.
One property is decisive, since fits to such records are costly: a spring accelerates the mass between its sticks.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from daq.runfile.rest_position import explain_impossible
from fitting import noise_levels
from fitting.judge.evidence import constant_friction_limit
from fitting.laws import SIX, Law
from fitting.least_squares.elimination import least_squares
from fitting.model.predict import law_task
from fitting.model.problem import Run
from fitting.record.cycles import SUSTAINED_SHARE, Cycle, CycleSegmentation
from fitting.record.motion import REST_SPEED, SLIP_SPEED, MeasuredMotion
from fitting.search.fit import Fit
from fitting.search.passes import first_pass, start_from_regression
from processing.record.kinematics import Kinematics
from processing.record.motion import Finding
from processing.record.noise import DITHERED
from stickslip.compute.arrays import Array, Integers
from stickslip.errors import DataError, InputError
from stickslip.units import Measured

PIECE_SAMPLES = (16, 32, 64, 128, 192, 256)  # of a piece: the shortest that gives `SHARE_ERROR`, or the last
TREND_DEGREE = 3  # degree of the polynomial taken off each piece
NOISE_LAGS = 3  # samples over which noise may be correlated
SHARE_ERROR = 0.005  # standard error of the share without lost frames: 5 % lost are ten errors
# Share of lost frames, in standard errors, above which losses are possible, and certain; between, longer pieces decide.
POSSIBLE_ERRORS, SURE_ERRORS = 3.0, 6.0
LEAST_SHARE_LOST = 0.01  # smallest reported share: it changes parameters by less than 1 %
ERRORS_BETWEEN_CYCLES = 2.5  # the same by the errors from the scatter between cycles, which the walk enlarges
FEWEST_PIECES = 8
REWEIGHTINGS = 4  # fits, each with the weights of the last


@dataclass(frozen=True, eq=False)
class PieceModes:
    """Modes of a random walk in a piece of n samples, without its cubic."""

    vectors: Array
    noise: Array  # variance of each mode under noise of unit autocovariance at each lag
    walk: Array  # the same of a random walk of unit steps


@lru_cache(maxsize=len(PIECE_SAMPLES))
def piece_modes(n: int) -> PieceModes:
    smooth = np.linalg.qr(np.vander(np.linspace(-1, 1, n), TREND_DEGREE + 1))[0]
    projection = np.eye(n) - smooth @ smooth.T
    steps = projection @ np.tril(np.ones((n, n)))
    size, vectors = np.linalg.eigh(steps @ steps.T)
    size, vectors = size[TREND_DEGREE + 1 :], vectors[:, TREND_DEGREE + 1 :]  # the smallest belong to the cubic
    lags = [np.eye(n, k=lag) + (lag > 0) * np.eye(n, k=-lag) for lag in range(NOISE_LAGS + 1)]
    return PieceModes(vectors, np.array([np.sum(vectors * (lag @ vectors), axis=0) for lag in lags]), size)


def missing_share(fit: Fit, record: Kinematics, run: int = 0) -> Measured | None:
    """Return the share of lost (or doubled) frames of a run, 0 to 1, from the best law; None if none is detected."""
    motion = fit.problem.motions[run]
    if record.recording.raw is not None or not record.even_times or motion.resolution < DITHERED * motion.step:
        return None
    fit_of_run = fit.for_run(run)
    interval = float(np.median(np.diff(record.time)))
    for n in PIECE_SAMPLES:
        squares, speeds, cycle = _pieces(fit_of_run, n, interval)
        if len(cycle) < FEWEST_PIECES or np.unique(cycle).size < noise_levels.FEWEST:
            return None
        certain = SHARE_ERROR if n < PIECE_SAMPLES[-1] else math.inf
        regression = _regress_share(squares, speeds, cycle, piece_modes(n), certain)
        if regression is not None:
            share, null = regression
            if share.value > max(LEAST_SHARE_LOST, SURE_ERRORS * null, ERRORS_BETWEEN_CYCLES * share.sd):
                return share
            if share.value < POSSIBLE_ERRORS * null:
                return None
    return None


def _pieces(fit: Fit, n: int, interval: float) -> tuple[Array, Array, Integers]:
    """Return squared modes (k, m), m^2, less the cycles' mean, mean square step (k,), m^2, and cycle of each piece."""
    modes, steps, cycles, places = [], [], [], []
    windows = fit.windows
    model, vectors = fit.residual + windows.position, piece_modes(n).vectors
    for cycle, stick, first, size, *_ in windows.table:
        if not fit.inlier_cycles[cycle]:
            continue
        for number in range(size // n):
            piece = slice(first + number * n, first + (number + 1) * n)
            time = windows.time[piece]
            if time[-1] - time[0] > (n - 0.5) * interval:  # samples are left out of it
                continue
            modes.append(np.einsum("ij,i->j", vectors, fit.residual[piece]))
            steps.append(float(np.mean(np.gradient(model[piece]) ** 2)))
            cycles.append(int(cycle))
            places.append(2 * number + int(stick))
    place_of_piece = np.array(places, np.int64)
    squares = np.array(modes).reshape(place_of_piece.size, vectors.shape[1])
    judged = np.zeros(place_of_piece.size, np.bool_)
    for place in np.unique(place_of_piece):
        in_place = place_of_piece == place
        count = int(in_place.sum())
        if count >= noise_levels.FEWEST:
            squares[in_place] = (squares[in_place] - squares[in_place].mean(axis=0)) ** 2 * (count / (count - 1))
            judged |= in_place
    return squares[judged], np.array(steps)[judged], np.array(cycles, np.int64)[judged]


def _regress_share(
    squares: Array, steps: Array, cycle: Integers, modes: PieceModes, certain: float
) -> tuple[Measured, float] | None:
    """Return the share, and its error without lost frames; None where the latter is above ``certain``."""
    noise = np.broadcast_to(modes.noise[:, None, :], (NOISE_LAGS + 1, *squares.shape))
    columns = np.concatenate((noise, (steps[:, None] * modes.walk)[None]))
    level = float(np.mean(squares[:, : squares.shape[1] // 2]))  # of the modes that the walk hardly has
    scale = np.append(np.full(NOISE_LAGS + 1, level), 1.0)
    variance = np.full(squares.shape, level)
    null = 0.0
    for round_ in range(REWEIGHTINGS):
        weight = variance**-2
        curvature = np.einsum("akm,bkm,km->ab", columns, columns, weight) * np.outer(scale, scale)
        inverse = np.linalg.inv(curvature) * np.outer(scale, scale)
        if round_ == 0:
            null = float(np.sqrt(2 * inverse[-1, -1]))
            if null > certain:
                return None
        coefficients = inverse @ np.einsum("akm,km->a", columns, weight * squares)
        expected = np.einsum("a,akm->km", coefficients, columns)
        variance = np.maximum(expected, 0.1 * level)
    pull = np.einsum("akm,km->ka", columns, weight * (squares - expected)) @ inverse[-1]
    by_cycle = np.array([pull[cycle == number].sum() for number in np.unique(cycle)])
    spread = float(np.sqrt(np.sum(by_cycle**2) * by_cycle.size / (by_cycle.size - 1)))
    return Measured(float(coefficients[-1]), spread), null


ONE_SPEED = 0.2  # difference over the median stick's speed; on a wide ramp scatter causes 0.1
FEWEST_STICKS = 2  # sticks to distinguish one speed from several
FEWEST_SAMPLES = 8  # samples in the median slip, chosen: with 4, wrong laws win
ENOUGH_SAMPLES = 20  # samples in the median slip, chosen: with fewer, a rejection advises a higher rate
BEYOND_NOISE = 20.0  # travel in standard deviations of a position, below which the mass does not move
FEW = 8  # sticks needed to recognise stick-slip
EVEN_SLIP = 0.1  # change of velocity in the middle half of a slip, over its speed; a spring causes 0.3 or more
DIES_AWAY = 0.7  # largest speed in the last third over that in the first, of a motion that dies away
WORST_ERROR = 0.02  # error over a slip's length: laws fit stick-slip to 0.004 or less, also in a rough fit
LEAST_FRICTION = 1e-3  # friction over the spring's force in a slip, below which the mass does not stick
SCREENED_CYCLES = 8  # cycles of the record, evenly spread
SCREENING_ORDER = (3, 5, 1, 4, 6, 2)  # cheap ones first
WRONG_TIMES = {"dropped-frames": "lost", "doubled-frames": "doubled"}  # findings after which times are unreliable
NONE_NEAR = "no law fits even roughly"
NOT_DESCRIBED = "no law describes it"  # though one comes near
SINE_ALONE = "a sine without a start-up; constant friction is possible"
AGAIN = "look at it with 'process inspect', and record several cycles with the belt running"
RETURNS = (0.5, 2.0)  # median travel back in a slip over that of a stick: paper on paper has 0.83 and 1.01, steps 0.04


def refusal(
    why: str, contradicted: Sequence[Sequence[Finding]], runs: Sequence[Run], records: Sequence[Kinematics]
) -> DataError:
    """Return the error for records whose laws cannot be ranked; ``contradicted`` are the calibrations of each run."""
    sources = ", ".join(record.recording.where for record in records)
    findings = [finding for findings_of_run in contradicted for finding in findings_of_run]
    if findings:
        error = DataError(findings[0].text, sources, "check its value and its sign, or omit it")
        error.add_result({"findings": [vars(finding) for finding in findings]}, [])
        return error
    return DataError(*_no_stick_slip(why, runs, records, sources))


def _no_stick_slip(why: str, runs: Sequence[Run], records: Sequence[Kinematics], sources: str) -> tuple[str, str, str]:
    if why == SINE_ALONE:
        do = "start recording before the belt starts: the first drag distinguishes law 1 from law 2"
        return f"no stick-slip was detected: {why}", sources, do
    if why in (NONE_NEAR, NOT_DESCRIBED):
        share = 100 * records[0].plateau_fraction
        why += (
            f", and the mass sticks for {share:.2g} % of the time"
            if records[0].sticks
            else ", and the mass never sticks"
        )
        samples, slip_s = min(_slip_sampling(run.motion, record) for run, record in zip(runs, records, strict=True))
        if samples < ENOUGH_SAMPLES:
            why += f" ({round(samples)} samples per slip)"
            rate = f"{_round_up(ENOUGH_SAMPLES / slip_s):g} Hz or more ({ENOUGH_SAMPLES} samples per slip)"
            do = f"look at the record with 'process inspect'; if the mass sticks and slips, record at {rate}"
            return f"no stick-slip was detected: {why}", sources, do
    return f"no stick-slip was detected: {why}", sources, AGAIN


def refuse_wrong_times(record: Kinematics) -> None:
    """Raise DataError for lost or doubled frames with even time stamps: it is unknown which frames they are."""
    for finding in record.findings:
        if finding.code in WRONG_TIMES:
            raise _wrong_times(f"{100 * finding.value:.2g}", WRONG_TIMES[finding.code], record)


def refuse_few_samples(motion: MeasuredMotion, record: Kinematics) -> None:
    samples_per_slip, slip_s = _slip_sampling(motion, record)
    samples = round(samples_per_slip)
    if samples >= FEWEST_SAMPLES:
        return
    message = f"the record has {samples} samples per slip, but a verdict needs {FEWEST_SAMPLES}"
    lasts = f"{slip_s:.3g} s" if slip_s >= 0.1 else f"{1e3 * slip_s:.2g} ms"
    # one sample more than needed: the number in a slip is accurate to one sample (`fitting.record.motion`)
    do = f"record at {_round_up((FEWEST_SAMPLES + 1) / slip_s):g} Hz or more, because a slip lasts about {lasts}"
    error = DataError(message, record.recording.where, do)
    finding = Finding("samples-per-slip", f"{message}: {do}", float(samples), float(FEWEST_SAMPLES))
    error.add_result({"findings": [vars(finding)]}, [])
    raise error


def _slip_sampling(motion: MeasuredMotion, record: Kinematics) -> tuple[float, float]:
    return motion.samples_per_slip, motion.samples_per_slip * float(np.median(np.diff(record.time)))


def _round_up(rate: float) -> float:
    step = 10.0 ** (math.floor(math.log10(rate)) - 1)
    return step * math.ceil(rate / step)


def refuse_impossible_rest(motion: MeasuredMotion, record: Kinematics) -> None:
    if motion.datum_prior is None:
        return
    rest = replace(motion.datum_prior, value=motion.sign * motion.datum_prior.value)
    low, high = sorted((motion.sign * float(motion.position.min()), motion.sign * float(motion.position.max())))
    wrong = explain_impossible(rest, low, high, motion.sign)
    if wrong:
        do = 'check its sign: x0 is the reading with the spring relaxed, as in --x0 "60 mm +- 1 mm"'
        raise InputError(wrong, record.recording.where, do)


def refuse_missing_frames(fits: Sequence[Fit], records: Sequence[Kinematics]) -> None:
    best = min((fit for fit in fits if fit.finished), key=lambda fit: fit.geometric_mean_rms, default=None)
    for run, record in enumerate(records):
        share = None if best is None else missing_share(best, record, run)
        if share is not None:
            raise _wrong_times(f"{100 * share.value:.2g} +- {100 * share.sd:.1g}", "lost or doubled", record)


def _wrong_times(percent: str, kind: str, record: Kinematics) -> DataError:
    return DataError(
        f"about {percent} % of the frames are {kind} although the time stamps are evenly spaced, so all times "
        "and fitted parameters would be wrong",
        record.recording.where,
        "import the track with the camera's own time stamps ('daq import --time NAME'), or record again and keep them",
        python="load the track with the camera's own time stamps: daq.load(path, time='NAME')",
    )


def is_stick_slip(record: Kinematics) -> bool:
    """Return whether sticks of one speed alternate with slips back, of equal length and at a changing speed."""
    sticks = record.sticks
    if len(sticks) < FEW or record.plateau_fraction < SUSTAINED_SHARE:
        return False
    x, v = record.steady_position, record.velocity
    speed = np.array([np.median(v[stick.first : stick.last + 1]) for stick in sticks])
    if float(np.quantile(np.abs(speed / np.median(speed) - 1), 0.8)) > ONE_SPEED:
        return False
    slips = [(before.last, after.first) for before, after in pairwise(sticks)]
    advance = float(np.median([x[stick.last] - x[stick.first] for stick in sticks]))
    ratio = float(np.median([x[i] - x[j] for i, j in slips])) / advance
    middles = [v[i + (j - i) // 4 : j - (j - i) // 4 + 1] for i, j in slips]
    changes = [np.ptp(speeds) / max(abs(float(np.mean(speeds))), 1e-9) for speeds in middles]
    return RETURNS[0] < ratio < RETURNS[1] and float(np.median(changes)) > EVEN_SLIP


def reject_by_cycles(motion: MeasuredMotion, cut: CycleSegmentation) -> str:
    """Return why no law could be fitted to the cycles of a record, or ""."""
    # Cycles with rests are not fitted, but show as well as any other what drives the mass.
    cycles = [cycle for cycle in cut.cycles if cycle.flag in ("", "rest")]
    if not cycles:
        flags = ", ".join(dict.fromkeys(cycle.flag for cycle in cut.cycles))
        return f"all cycles are excluded ({flags})" if flags else _reject_by_motion(motion)
    begin = np.searchsorted(motion.time, [cycle.break_away for cycle in cycles])
    end = np.minimum(np.searchsorted(motion.time, [cycle.landing for cycle in cycles]), motion.time.size - 1)
    turned = _reversal(motion, begin, end)
    if turned is not None:
        return (
            f"the belt reverses at about {turned:.4g} s; fit the two parts separately, with --to {turned:.4g} and with "
            f"--from {turned:.4g}"
        )
    if float(np.median(_speed_changes(motion, begin, end))) < EVEN_SLIP:
        return "the mass moves at a constant speed between sticks, whereas a spring would accelerate it"
    rested = len(cycles) - len(cut.used)
    return (
        f"the mass is at rest in {rested} of the {len(cycles)} intervals between sticks"
        if 2 * rested >= len(cycles)
        else ""
    )


def reject_by_coarse_fits(laws: Sequence[Law], runs: Sequence[Run], *, sustained: bool) -> str:
    """Return why no law can describe the runs, from rough fits of a few cycles; "" if a law fits."""
    if not sustained and all(not run.cut.starts_at_rest and _is_sine(run.motion) for run in runs):
        return SINE_ALONE
    screened_runs = [replace(run, cut=replace(run.cut, cycles=_select_cycles(run.cut.used))) for run in runs]
    longest = max(_slip_length(run.motion, run.cut) for run in screened_runs)
    for law in map(SIX.__getitem__, SCREENING_ORDER):
        if law in laws or (law.kind.curve == "constant" and not sustained):
            task = law_task(law, screened_runs)
            fit = first_pass(task, start_from_regression(task))
            if fit is not None and fit.misfit < WORST_ERROR * longest:
                return ""
    return NONE_NEAR


def _select_cycles(cycles: Sequence[Cycle]) -> tuple[Cycle, ...]:
    indices = np.unique(np.linspace(0, len(cycles) - 1, SCREENED_CYCLES).round().astype(int))
    return tuple(cycles[index] for index in indices)


def list_near(fits: Sequence[Fit], runs: Sequence[Run]) -> list[Fit]:
    longest = max(_slip_length(run.motion, run.cut) for run in runs)
    return [fit for fit in fits if fit.misfit < WORST_ERROR * longest]


def reject_by_misfit(fits: Sequence[Fit], runs: Sequence[Run], *, sustained: bool) -> str:
    longest = max(_slip_length(run.motion, run.cut) for run in runs)
    best = min(list_near(fits, runs), key=lambda fit: fit.geometric_mean_rms, default=None)
    if best is None:
        return NONE_NEAR
    if best.law.ramp and best.values.d > best.values.v_dr:
        return f"the best fit (law {best.law.name}) has a ramp wider than the belt speed"
    if sustained and best.values.F < LEAST_FRICTION * best.values.K * longest:
        return (
            f"the friction of the best fit (law {best.law.name}) is less than {LEAST_FRICTION:g} of the "
            "spring force in a slip"
        )
    return ""


def _reject_by_motion(motion: MeasuredMotion) -> str:
    v = motion.velocity
    if motion.travel < BEYOND_NOISE * motion.resolution or motion.travel == 0:
        return "the mass moves less than the noise" if motion.travel else "the mass does not move"
    if v.min() >= SLIP_SPEED * motion.belt_speed:
        return f"the mass moves at {motion.sign * np.median(v):.3g} m/s and never slips"
    if _is_sine(motion):
        return SINE_ALONE
    if v.max() < SLIP_SPEED * motion.belt_speed:
        return f"the mass never moves with the belt (nominal speed {motion.sign * motion.belt_speed:.3g} m/s)"
    return "there is no slip between two sticks"


def _reversal(motion: MeasuredMotion, begin: Integers, end: Integers) -> float | None:
    """Return the time, s, at which the belt reverses: sticks on it then have the belt's constant speed."""
    middle = [motion.velocity[i + (j - i) // 4 : j - (j - i) // 4 + 1] for i, j in zip(begin, end, strict=True)]
    speed = np.array([float(np.median(v)) for v in middle]) / motion.belt_speed
    even = (np.abs(speed + 1) < ONE_SPEED) & (_speed_changes(motion, begin, end) < EVEN_SLIP)
    first = int(np.argmax(even))
    last = even.size - int(np.argmax(even[::-1]))
    if np.count_nonzero(even) < FEWEST_STICKS or even.all() or not even[first:last].all():
        return None
    if first > 0 and last < even.size:
        return None
    turned = first if first > 0 else last + int(np.argmax(np.abs(speed[last:]) > REST_SPEED))
    return motion.begin + float(motion.time[begin[turned]])


def _speed_changes(motion: MeasuredMotion, begin: Integers, end: Integers) -> Array:
    """Return the change of velocity in the middle half of each slip, over the mean slip speed there."""
    quarter = (end - begin) // 4
    middles = [motion.velocity[i : j + 1] for i, j in zip(begin + quarter, end - quarter, strict=True)]
    return np.array([np.ptp(v) / max(abs(float(np.mean(v)) - motion.belt_speed), 1e-9) for v in middles])


def _is_sine(motion: MeasuredMotion) -> bool:
    return _sine_residual(motion) < constant_friction_limit(motion)


def _sine_residual(motion: MeasuredMotion) -> float:
    """Return the rms residual of the best sine of two periods or more, m; inf with fewer."""
    x = motion.position - 0.5 * (motion.position.max() + motion.position.min())
    up = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    if up.size < 3:
        return math.inf
    crossings = motion.time[up] - x[up] * np.diff(motion.time)[up] / (x[up + 1] - x[up])
    turns = 2 * np.pi * (up.size - 1) / (crossings[-1] - crossings[0]) * motion.time
    shapes = np.stack([np.sin(turns), np.cos(turns), np.ones(turns.size)], axis=1)
    _, residual = least_squares(shapes, x)
    return float(np.std(residual))


def dies_away(velocity: Array) -> bool:
    first, _, last = (float(np.max(np.abs(third))) for third in np.array_split(velocity, 3))
    return last < DIES_AWAY * first


def _slip_length(motion: MeasuredMotion, cut: CycleSegmentation) -> float:
    return float(np.median([np.ptp(motion.position[slice(*cycle.slip)]) for cycle in cut.used]))
