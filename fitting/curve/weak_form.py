"""Starting values of the measured curve by the weak form of the equation of motion: no derivative of a noisy position.

Times a smooth test function phi that vanishes with its derivatives at both ends, and integrated by parts twice,

    integral phi'' x = -K integral phi (x - datum) - (c/m) integral phi v + level sum_j C_j integral phi B_j(v_belt - v)

is linear in K and in the coefficients C_j of the friction curve, and in each cycle's level given these.  Only the
friction and damping terms read the smoothed velocity.

Source: D. Messenger, D. Bortz, Weak SINDy, Multiscale Model. Simul. 19 (2021) 1474; test functions (1 - u^2)^p.
"""

import numpy as np

from daq.base.compute.arrays import Array
from fitting.estimation.covariance import scaled_inverse
from fitting.model.parameters import PER_RUN, Global
from fitting.model.problem import EstimationProblem, Run
from fitting.sensitivity.spline import FrictionSpline

POWER = 4  # of the test function: phi'' is then smooth where it begins
HALF_WIDTH = 0.06  # of the median slip: the half-width of a test function.  0.03 doubles the noise of low speeds,
# 0.12 blurs a Stribeck fall of 0.05 m/s by a tenth; the trajectories decide in any case
FEWEST = 6  # samples in a half-width
SPACING = 3  # test functions in a half-width
CORNER = 0.3  # of the smoothing's half-window, left out at both ends of a slip: there its velocity is blurred
ROUNDS = 6  # of levels against curve
LOWEST_LEVEL = 0.2
SMOOTHNESS = 1e-4  # of the equations' size, on second differences of the coefficients: decides where nothing is seen


def weak_form(problem: EstimationProblem, u: Array, spline: FrictionSpline) -> tuple[float, Array, Array] | None:
    """Return K (1/s^2), the coefficients (m/s^2) and each cycle's level, for a jump contact.

    Parameters
    ----------
    problem : EstimationProblem
    u : (13 runs,) f8
        Where belt speed, datum and damping of each run are taken from.
    spline : FrictionSpline
        Its knots.

    Returns
    -------
    tuple or None
        None where no slip is longer than a test function.
    """
    equations: list[tuple[Array, Array] | None] = []
    for run, own in zip(problem.runs, u.reshape(-1, PER_RUN), strict=True):
        equations += _equations(run, own, spline)
    used = [k for k, rows in enumerate(equations) if rows is not None]
    if not used:
        return None
    rows = [rows for rows in equations if rows is not None]
    count = spline.coefficients.size
    bend = np.diff(np.eye(count), 2, axis=0)
    level = np.ones(len(rows))
    size = np.sqrt(np.mean([np.mean(A[:, 1:] ** 2) for A, _ in rows]))
    penalty = np.zeros((count + 1, count + 1))
    penalty[1:, 1:] = (SMOOTHNESS * size) ** 2 * np.einsum("ki,kj->ij", bend, bend)
    solution = np.zeros(count + 1)
    for _ in range(ROUNDS):
        square, right = penalty.copy(), np.zeros(count + 1)
        for (A, y), factor in zip(rows, level, strict=True):
            scaled = np.concatenate((A[:, :1], factor * A[:, 1:]), axis=1)
            square += np.einsum("ki,kj->ij", scaled, scaled)
            right += np.einsum("ki,k->i", scaled, y)
        scale, inverse = scaled_inverse(square, np.diag(square))
        solution = scale * np.einsum("ij,j->i", inverse, scale * right)
        for k, (A, y) in enumerate(rows):
            friction = np.einsum("ki,i->k", A[:, 1:], solution[1:])
            most = float(np.sum(friction**2))
            level[k] = max(
                float(np.sum(friction * (y - A[:, 0] * solution[0]))) / most if most > 0 else 1, LOWEST_LEVEL
            )
        level /= np.exp(np.mean(np.log(level)))
    found = np.ones(len(equations))
    found[used] = level
    return float(solution[0]), solution[1:], found


def _equations(run: Run, u: Array, spline: FrictionSpline) -> list[tuple[Array, Array] | None]:
    """Return matrix (k, 1 + coefficients) and right side (k,) of each used cycle; None where its slip is too short."""
    motion, cycles = run.motion, run.cut.used
    dt = float(np.median(np.diff(motion.time)))
    median = float(np.median([cycle.landing - cycle.break_away for cycle in cycles]))
    half = max(FEWEST, round(HALF_WIDTH * median / dt))
    place = np.arange(-half, half + 1) / half
    base = 1 - place**2
    phi = base**POWER
    second = (-2 * POWER * base ** (POWER - 1) + 4 * POWER * (POWER - 1) * place**2 * base ** (POWER - 2)) / half**2
    # exact on constants and parabolas, as the integral is
    second -= second.mean()
    second *= phi.sum() / float(np.sum(second * (half * place) ** 2 / 2))
    phi, second = phi * dt, second / dt
    found: list[tuple[Array, Array] | None] = []
    for cycle in cycles:
        corner = CORNER * motion.half_window
        first, end = np.searchsorted(motion.time, (cycle.break_away + corner, cycle.landing - corner))
        middles = np.arange(first + half, end - half, max(1, half // SPACING))
        if middles.size == 0:
            found.append(None)
            continue
        at = middles[:, None] + np.arange(-half, half + 1)
        v = motion.velocity[at]
        speed = np.clip(u[Global.V_DR] - v, 0.0, spline.knots[-1])
        basis = spline.basis(speed.ravel()).reshape(*at.shape, -1)
        x = motion.measured[at]
        A = np.empty((middles.size, 1 + basis.shape[2]))
        A[:, 0] = -np.sum(phi * (x - u[Global.DATUM]), axis=1)
        A[:, 1:] = np.einsum("k,mkj->mj", phi, basis)
        found.append((A, np.sum(second * x, axis=1) + u[Global.DAMPING] * np.sum(phi * v, axis=1)))
    return found
