"""Red-black ordering: where the nodes of a level are stored.

Nodes are coloured red and black over (θ, z) so that the four neighbours of a radial
line have the other colour: all lines of one colour can be solved at once. An array in
red-black order has shape (2, n_r, width), red before black. In the plane, node (j, k)
has the number m = (j + 1)·pitch + k with an odd pitch: its colour is m % 2, its place
in that colour's row m // 2, and its neighbours lie at constant distances, so that loops
run over whole rows.

Rows j = -1 and j = n_theta are ghost rows, periodic copies of the last and the first
spoke. For even n_z the last slice (always Dirichlet) shares its place with slice 0 of
the next row. With an odd number of spokes two nodes of one colour meet at θ = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Single = NDArray[np.float32]

#: The two colours
RED, BLACK = 0, 1

#: Values per row are rounded up to whole vector registers.
LANES = 16


@dataclass(frozen=True)
class Layout:
    """Where the nodes of a level are stored.

    Attributes:
        shape: Nodes (n_r, n_theta, n_z) [–].
        pitch: Distance between rows in the plane's numbering, odd [–].
        width: Places per layer and colour [–].
    """

    shape: tuple[int, int, int]
    pitch: int
    width: int

    @classmethod
    def of(cls, shape: tuple[int, int, int]) -> Layout:
        """Layout of a box of nodes."""
        n_r, n_theta, n_z = (int(n) for n in shape)
        pitch = n_z if n_z % 2 else n_z - 1
        places = ((n_theta + 2) * pitch + 2) // 2
        return cls((n_r, n_theta, n_z), pitch, -(-places // LANES) * LANES)

    @property
    def stored_shape(self) -> tuple[int, int, int]:
        """Shape of an array in red-black order."""
        return 2, self.shape[0], self.width

    @cached_property
    def colour_size(self) -> int:
        """Values of one colour [–]."""
        return self.shape[0] * self.width

    def split(self, values: NDArray[np.float32]) -> Single:
        """Values (n_r, n_theta, n_z) in red-black order, (2, n_r, width)."""
        n_r, n_theta, n_z = self.shape
        kept = min(n_z, self.pitch)
        plane = np.zeros((n_r, 2 * self.width), dtype=values.dtype)
        rows = plane[:, : (n_theta + 2) * self.pitch]
        rows = rows.reshape(n_r, n_theta + 2, self.pitch)
        rows[:, 1:-1, :kept] = values[:, :, :kept]
        rows[:, 0], rows[:, -1] = rows[:, -2], rows[:, 1]
        return np.ascontiguousarray(
            plane.reshape(n_r, self.width, 2).transpose(2, 0, 1)
        )

    def places(self, nodes: tuple[NDArray[np.int64], ...]) -> NDArray[np.int64]:
        """Flat places of nodes (i, j, k) in an array (2, n_r, width)."""
        i, j, k = nodes
        m = (j + 1) * self.pitch + k
        return ((m % 2) * self.shape[0] + i) * self.width + m // 2
