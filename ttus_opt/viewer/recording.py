"""Recordings beside what a field renders along them: felt against measured."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.probe.trajectory import Trajectory

#: Force from which a frame counts as contact [N]
CONTACT = 0.2

#: Most places shown on the skin [–]
PLACES = 60


@dataclass(frozen=True)
class Recording:
    """Recordings, one after the other, and the wrenches rendered along them.

    Attributes:
        trajectory: Poses, and wrenches where they were measured.
        twist: Their motion, shape (T, 6) [m/s, rad/s].
        rendered: Force of every field along them, shape (T, 3) each [N].
    """

    trajectory: Trajectory
    twist: Array = field(repr=False)
    rendered: tuple[Array, ...] = field(repr=False)

    @classmethod
    def of(cls, trajectory: Trajectory, renderers: tuple[Renderer, ...]) -> Recording:
        """Render every frame, friction included, as ``ttus-opt render`` does.

        Args:
            trajectory: The poses.
            renderers: One a field, which no other thread uses.
        """
        twist = trajectory.twist()
        frames = list(zip(trajectory.rotation, trajectory.position, twist, strict=True))
        rendered = [
            np.array([one.render(*frame).force for frame in frames])
            for one in renderers
        ]
        return cls(trajectory, twist, tuple(rendered))

    def __len__(self) -> int:
        """Number of frames T [–]."""
        return len(self.trajectory)

    @property
    def clock(self) -> Array:
        """Time since the first frame, without the gaps between recordings, (T,) [s]."""
        time, segment = self.trajectory.time, self.trajectory.segment
        steps = np.diff(time)
        cut = np.diff(segment) != 0
        usual = float(np.median(steps[~cut])) if (~cut).any() else 1.0
        return np.concatenate([[0.0], np.cumsum(np.where(cut, usual, steps))])

    @property
    def sizes(self) -> tuple[Array, ...]:
        """Force measured, NaN where none was, and of every field, (T,) each [N]."""
        force = self.trajectory.force
        measured = np.full(len(self), np.nan)
        if force is not None:
            measured = np.linalg.norm(force, axis=1)
        return measured, *(np.linalg.norm(one, axis=1) for one in self.rendered)

    @property
    def places(self) -> IntArray:
        """Frames in contact, thinned evenly to `PLACES`, shape (k,)."""
        measured, *rendered = self.sizes
        size = measured if np.isfinite(measured).all() else rendered[0]
        touching = np.flatnonzero(size > CONTACT)
        count = min(len(touching), PLACES)
        at = np.linspace(0, len(touching) - 1, count).round().astype(np.int64)
        return np.asarray(touching[at]) if count else touching
