"""Coordinates of the curve's coefficients in which their prior is independent: second differences and the two ends.

The prior says that a second difference of neighbouring coefficients is of the order of half the friction; it decides
only where the data do not.  In these coordinates Levenberg-Marquardt needs no other form of a prior.

The data determine K datum + friction only.  So the coordinates are those of a curve that follows the datum: a datum's
remaining effect is then a small number, not the difference of two large ones, and an unknown datum keeps its whole
interval.
"""

from dataclasses import dataclass

import numpy as np

from stickslip.compute.arrays import Array

# Standard deviation of a second difference, over the middle coefficient.  Twice or half of it moves curves of the rig
# scene by less than a tenth of their band.
BEND_SD = 0.5


@dataclass(frozen=True, eq=False)
class CurveCoordinates:
    """The map from n - 2 second differences and two end coefficients, each over its size, to coefficients."""

    matrix: Array  # (n, n) coefficients (m/s^2) by coordinates
    inverse: Array  # (n, n) coordinates by coefficients
    precision: Array  # (n,) of the coordinates' priors: 1, and 0 for the ends
    offset: Array  # (p,) how the whole curve moves with each of the unknowns beside it, and where these are at offset 0
    start: Array

    @classmethod
    def around(cls, coefficients: Array, offset: Array, start: Array) -> "CurveCoordinates":
        """Scale the coordinates by the middle of these coefficients (n,)."""
        n, size = coefficients.size, abs(float(np.median(coefficients)))
        if not size > 0:
            raise ValueError(f"middle coefficient is {size}; friction must not vanish")
        sd = BEND_SD * size
        inverse = np.zeros((n, n))
        inverse[: n - 2] = np.diff(np.eye(n), 2, axis=0) / sd
        inverse[n - 2, 0] = inverse[n - 1, n - 1] = 1 / size
        # C_j = C_0 + j g + sum_{i < j} (j - 1 - i) delta_i, with g from the last coefficient
        steps = np.array([[max(j - 1 - i, 0) for i in range(n - 2)] for j in range(n)], float)
        along = np.arange(n) / (n - 1)
        matrix = np.zeros((n, n))
        matrix[:, : n - 2] = sd * (steps - along[:, None] * steps[-1])
        matrix[:, n - 2], matrix[:, n - 1] = size * (1 - along), size * along
        return cls(matrix, inverse, np.concatenate((np.ones(n - 2), np.zeros(2))), offset, start)

    @property
    def slopes(self) -> Array:
        """Derivatives (n, p + n) of the coefficients by the unknowns: those outside the curve, then its coordinates."""
        return np.hstack([np.broadcast_to(self.offset, (self.precision.size, self.offset.size)), self.matrix])

    @property
    def inverse_slopes(self) -> Array:
        """Derivatives (n, p + n) of the coordinates by the unknowns outside the curve and by its coefficients."""
        whole = self.inverse.sum(axis=1)
        return np.hstack([-whole[:, None] * self.offset, self.inverse])

    def coefficients(self, unknowns: Array) -> Array:
        p = self.offset.size
        moved = float(np.sum(self.offset * (unknowns[:p] - self.start)))
        return np.asarray(np.einsum("ij,j->i", self.matrix, unknowns[p:]) + moved)

    def unknowns(self, beside: Array, coefficients: Array) -> Array:
        """Return all unknowns (p + n,) from those outside the curve (p,) and its coefficients (n,)."""
        moved = float(np.sum(self.offset * (beside - self.start)))
        return np.concatenate((beside, np.einsum("ij,j->i", self.inverse, coefficients - moved)))
