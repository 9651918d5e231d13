"""Deeper than the model: the last force is felt, never less.

Near the axis the normals of a probe cancel and a field's force falls to zero, and
beyond it points the other way. A pose whose reference point is nearer to the axis than
the model reaches is therefore rendered at the least radius, on the side on which it
left the model: it may go round by up to 63°, but not through the axis. The force then
stays as it was until the probe comes back out.
"""

from __future__ import annotations

import math

from ttus_opt.core.arrays import Array

#: Least way outwards of what is rendered, over the radius [–]
LEAST = 0.45


class DepthStop:
    """Keeps poses within the depth of a model.

    Attributes:
        radius: Least distance of the reference point from the axis [m].
        acts: Whether the last pose was moved.
    """

    def __init__(self, radius: float) -> None:
        self.radius, self.acts = radius, False
        self._outward = (1.0, 0.0)

    def __call__(self, position: Array) -> Array:
        """The position to render, shape (3,) [m]; the same one within the model."""
        x, y = float(position[0]), float(position[1])
        radius, (u, v) = math.hypot(x, y), self._outward
        if not self.acts:
            if radius >= self.radius:
                return position
            u, v = (x / radius, y / radius) if radius > 0.0 else (1.0, 0.0)
            self._outward, self.acts = (u, v), True
        along, beside = u * x + v * y, u * y - v * x
        if radius >= self.radius and along >= LEAST * self.radius:
            self.acts = False
            return position
        along = max(along, LEAST * self.radius)
        scale = self.radius / math.hypot(along, beside)
        along, beside = scale * along, scale * beside
        moved = position.copy()
        moved[:2] = along * u - beside * v, along * v + beside * u
        return moved
