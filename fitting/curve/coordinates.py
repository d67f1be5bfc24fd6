"""Coordinates of the curve's coefficients in which their prior is independent: second differences and the two ends.

The prior says that a second difference of neighbouring coefficients is of the order of half the friction; it decides
only where the record shows nothing.  In these coordinates Levenberg-Marquardt needs no other form of a prior.
"""

from dataclasses import dataclass

import numpy as np

from daq.compute.arrays import Array

# Of the middle coefficient: standard deviation of a second difference.  Twice or half of it moves curves of the rig
# scene by less than a tenth of their band.
BEND_SD = 0.5


@dataclass(frozen=True, eq=False)
class CurveCoordinates:
    """How coefficients follow from n - 2 second differences and the two end coefficients, each over its size.

    Attributes
    ----------
    matrix : (n, n) f8
        Coefficients (m/s^2) by coordinates.
    inverse : (n, n) f8
        Coordinates by coefficients.
    precision : (n,) f8
        Of the coordinates' priors: 1, and 0 for the ends.
    """

    matrix: Array
    inverse: Array
    precision: Array

    @classmethod
    def around(cls, coefficients: Array) -> "CurveCoordinates":
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
        return cls(matrix, inverse, np.concatenate((np.ones(n - 2), np.zeros(2))))

    def coefficients(self, coordinates: Array) -> Array:
        """Return coefficients (n,), m/s^2."""
        return np.asarray(np.einsum("ij,j->i", self.matrix, coordinates))

    def coordinates(self, coefficients: Array) -> Array:
        """Return coordinates (n,)."""
        return np.asarray(np.einsum("ij,j->i", self.inverse, coefficients))
