"""Textbook systems for the analyses that name no system."""

import math

import numpy as np

from rig_sim.systems.formula import FormulaMap


class Logistic(FormulaMap):
    """x' = (r + u) x (1 - x)."""

    def __init__(self, r):
        super().__init__(1.0, interval=(0.0, 1.0), strength=r)
        self.r = r

    def step(self, x, change=0.0):
        r = self.r + change
        return r * x * (1.0 - x), r * (1.0 - 2.0 * x), 1.0


class OnInterval(FormulaMap):
    """x' = formula(x) on an interval, without its derivative."""

    def __init__(self, formula, lo, hi):
        super().__init__(hi - lo, interval=(lo, hi), start=lo + 0.1 * (hi - lo))
        self.formula = formula

    def step(self, x, change=0.0):
        return self.formula(x), None, 1.0


class Circle(FormulaMap):
    """theta -> theta + turn - (K/2 pi) sin(2 pi theta); its time is the angle."""

    def __init__(self, w, K):
        super().__init__(1.0, turn=1.0, start=0.1)
        self.w, self.K = w, K

    def step(self, theta, change=0.0):
        turned = self.w - self.K / (2.0 * math.pi) * np.sin(2.0 * math.pi * theta)
        return (theta + turned) % 1.0, 1.0 - self.K * np.cos(2.0 * math.pi * theta), float(turned[0])


class BouncingBall(FormulaMap):
    """A ball on a table that moves far less than it flies: phase, v -> phase + v, e v + (A + u) cos(phase + v)."""

    def __init__(self, e, A):
        super().__init__([2.0 * math.pi, 10.0], turn=[2.0 * math.pi, math.inf], strength=abs(A))
        self.e, self.A = e, A

    def step(self, state, change=0.0):
        A = self.A + change
        phase = (state[0] + state[1]) % (2.0 * math.pi)
        kick = -A * math.sin(phase)
        jacobian = [[1.0, 1.0], [kick, self.e + kick]]
        return [phase, self.e * state[1] + A * math.cos(phase)], jacobian, 1.0


class Henon(FormulaMap):
    """x' = a + u - x^2 + b y, y' = x, without its derivative."""

    def __init__(self, a=1.4, b=0.3):
        super().__init__([2.0, 2.0], strength=a, start=[0.1, 0.1])
        self.a, self.b = a, b

    def step(self, state, change=0.0):
        x, y = state
        return [self.a + change - x * x + self.b * y, x], None, 1.0
