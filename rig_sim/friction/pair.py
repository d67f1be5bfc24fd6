"""Kernels of a friction law with memory given by two formulas: friction f(s, z), and the rate z' = g(s, z) of a state.

A law is an array of numbers, made by `encode`: how many steps the formulas have, how many parameters, the speed below
which slip is a stick, a value from which the steady state is sought; then the steps, the variables s, z and the
parameters, the results of f and g, and a stack.  A result, as every place on the stack, is a value and its derivatives
by s, by z and by the parameters.

Where there are no formulas, None is in place of the array, and compiled code has nothing of what follows.

Operations outside their range give nan, which ends a motion: as interpreted code, machine code raises no error.
"""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rig_sim.friction.formula import Formula
    from stickslip.compute.arrays import Array

STATE = "z"
OPERATIONS = ("number", "name", "negative", "exp", "log", "sqrt", "tanh", "abs", "+", "-", "*", "/", "**", "min", "max")
NUMBER, NAME, NEGATIVE, EXP, LOG, SQRT, TANH, ABS, PLUS, MINUS, TIMES, OVER, POWER, MIN, MAX = range(15)
STEPS, RATE_STEPS, PARAMETERS, STICK_SPEED, SEED, FIRST = range(6)  # places in the array
LARGEST_POWER = 709.0  # of exp
MOST_ITERATIONS, CONVERGED = 100, 1e-13  # of a steady state, and the last change over its size


def encode(friction: "Formula", rate: "Formula", names: tuple[str, ...], stick_speed: float, seed: float) -> "Array":
    """Return the array of a law; ``names`` are those of its parameters, in the order of `set_parameters`."""
    import numpy as np

    variables = ("s", STATE, *names)
    programs: list[list[float]] = []
    deepest = 0
    for formula in (friction, rate):
        program: list[float] = []
        depth = 0
        for step in formula.steps:
            operand = step.number if step.do == "number" else variables.index(step.name) if step.do == "name" else 0.0
            times = max(1, step.takes - 1)  # of min and max
            program += [OPERATIONS.index(step.do), operand] * times
            depth += 1 - step.takes
            deepest = max(deepest, depth)
        programs.append(program)
    count = 3 + len(names)
    head = [len(programs[0]) / 2, len(programs[1]) / 2, len(names), stick_speed, seed]
    return np.array([*head, *programs[0], *programs[1], *[0.0] * (len(variables) + (2 + deepest) * count)])


def first_variable(law: "Array") -> int:
    return FIRST + 2 * int(law[STEPS] + law[RATE_STEPS])


def set_parameters(law: "Array | None", p: "Array", begin: int) -> None:
    """Set the parameters to those at and behind ``begin`` in p."""
    if law is None:
        return
    first = first_variable(law) + 2
    for j in range(int(law[PARAMETERS])):
        law[first + j] = p[begin + j]


def at(law: "Array | None", place: int) -> float:
    return 0.0 if law is None else law[place]


def evaluate(law: "Array | None", rate: bool, s: float, z: float, width: int) -> int:
    """Evaluate f, or g where ``rate``; return the place of the result, of which ``width`` numbers are set."""
    if law is None:
        return 0
    count, variables = 3 + int(law[PARAMETERS]), first_variable(law)
    law[variables], law[variables + 1] = s, z
    begin, steps = FIRST, int(law[STEPS])
    result = variables + count - 1
    if rate:
        begin, steps, result = begin + 2 * steps, int(law[RATE_STEPS]), result + count
    stack = variables + count - 1 + 2 * count
    top = stack - count
    for i in range(steps):
        do = int(law[begin + 2 * i])
        if do <= NAME:
            top += count
            for j in range(width):
                law[top + j] = 0.0
            if do == NUMBER:
                law[top] = law[begin + 2 * i + 1]
            else:
                which = int(law[begin + 2 * i + 1])
                law[top] = law[variables + which]
                if 1 + which < width:
                    law[top + 1 + which] = 1.0
        elif do <= ABS:
            law[top], slope = one_operand(do, law[top])
            for j in range(1, width):
                if law[top + j] != 0.0:
                    law[top + j] *= slope
        else:
            other = top
            top -= count
            law[top], by_first, by_second = two_operands(do, law[top], law[other])
            for j in range(1, width):
                change = by_first * law[top + j] if law[top + j] != 0.0 else 0.0
                law[top + j] = change + (by_second * law[other + j] if law[other + j] != 0.0 else 0.0)
    for j in range(width):
        law[result + j] = law[top + j]
    return result


def one_operand(do: int, a: float) -> tuple[float, float]:
    """Return the value of an operation and its derivative."""
    if do == NEGATIVE:
        return -a, -1.0
    if do == EXP:
        value = math.exp(a) if a < LARGEST_POWER else math.inf
        return value, value
    if do == LOG:
        return (math.log(a), 1.0 / a) if a > 0.0 else (math.nan, math.nan)
    if do == SQRT:
        return (math.sqrt(a), 0.5 / math.sqrt(a)) if a > 0.0 else (0.0 if a == 0.0 else math.nan, math.inf)
    if do == TANH:
        value = math.tanh(a)
        return value, (1.0 - value) * (1.0 + value)
    return abs(a), 1.0 if a >= 0.0 else -1.0


def two_operands(do: int, a: float, b: float) -> tuple[float, float, float]:
    """Return the value of an operation and its derivatives by both operands."""
    if do == PLUS:
        return a + b, 1.0, 1.0
    if do == MINUS:
        return a - b, 1.0, -1.0
    if do == TIMES:
        return a * b, b, a
    if do == OVER:
        return (a / b, 1.0 / b, -a / b / b) if b != 0.0 else (math.nan, math.nan, math.nan)
    if do == POWER:
        value = power(a, b)
        return value, b * power(a, b - 1.0) if b != 0.0 else 0.0, value * math.log(a) if a > 0.0 else 0.0
    first = (a <= b) == (do == MIN)
    return a if first else b, 1.0 if first else 0.0, 0.0 if first else 1.0


def power(a: float, b: float) -> float:
    whole = b == math.floor(b)
    if b == 0.0:
        return 1.0
    if a == 0.0:
        return 0.0 if b > 0.0 else math.inf
    if a < 0.0 and not whole:
        return math.nan
    exponent = b * math.log(abs(a))
    size = math.exp(exponent) if exponent < LARGEST_POWER else math.inf
    return -size if a < 0.0 and 0.5 * b != math.floor(0.5 * b) else size


def steady_state(law: "Array | None", s: float) -> float:
    """Return z of steady slip at a speed (m/s), where g = 0; nan if it is not found.

    The state is followed by implicit Euler steps, each four times as long as the one before.
    """
    z, share = at(law, SEED), 1.0
    for _i in range(MOST_ITERATIONS):
        place = evaluate(law, True, s, z, 3)
        value, slope = at(law, place), at(law, place + 2)
        change = value / (share * abs(slope) - slope)
        z += change
        if abs(change) <= CONVERGED * abs(z) < math.inf:
            return z
        share *= 0.25
    return math.nan


def steady_friction(law: "Array", p: "Array", speed: "Array", friction: "Array") -> None:
    """Set the friction (n,) of steady slip at speeds (n,), m/s, with parameters p."""
    set_parameters(law, p, 0)
    for i in range(speed.size):
        friction[i] = law[evaluate(law, False, speed[i], steady_state(law, speed[i]), 1)]


def friction_along(law: "Array", p: "Array", time: "Array", speed: "Array", friction: "Array", by_p: "Array") -> None:
    """Set the friction (n,) along slip speeds (n,) at times (n,), s, and its derivatives (n, P) where z is held.

    The state begins as that of steady slip; it is followed by implicit Euler steps.
    """
    set_parameters(law, p, 0)
    z = steady_state(law, speed[0])
    for i in range(speed.size):
        if i > 0:
            h, before = time[i] - time[i - 1], z
            for _i in range(MOST_ITERATIONS):
                place = evaluate(law, True, speed[i], z, 3)
                change = (before + h * law[place] - z) / (1.0 - h * law[place + 2])
                z += change
                if not abs(change) > CONVERGED * abs(z):
                    break
        place = evaluate(law, False, speed[i], z, 3 + p.size)
        friction[i] = law[place]
        for j in range(p.size):
            by_p[i, j] = law[place + 3 + j]
