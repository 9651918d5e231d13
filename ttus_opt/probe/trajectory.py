"""Probe poses over time, with measured wrenches or without.

Pose: probe-to-patient rotation and position. Wrench: force ON the probe and torque
about the point shell's reference point, both in patient axes. The file is a CSV
with the header ``t,px,py,pz,qw,qx,qy,qz,fx,fy,fz,tx,ty,tz``. `Trajectory.transformed`
maps a recording from another frame to the patient's.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ttus_opt.core.arguments import expect_shape, numbers
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import FileError, InputError, counted, located
from ttus_opt.core.html_card import card, curve_svg
from ttus_opt.probe.pose import (
    PoseLike,
    QuaternionOrder,
    from_quaternions,
    poses_of,
    rotations,
    to_quaternions,
)
from ttus_opt.probe.raw_recording import RawRecording, parts, steps_within
from ttus_opt.probe.recording_faults import checked
from ttus_opt.probe.repair import repaired_aloud
from ttus_opt.probe.rigid_motion import composed
from ttus_opt.probe.trajectory_csv import raw_trajectory

#: Largest rate that `thinned` accepts [Hz]
HIGHEST = 1e9

#: Least size of a number in no plausible unit, not in nanoseconds since 1970; beyond
#: it, squares of squares overflow
IMPLAUSIBLE = 1e20


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses and wrenches at T times.

    Attributes:
        time: Increasing within a segment, shape (T,) [s].
        position: Position of the probe frame in the patient frame, shape (T, 3) [m].
        rotation: Probe to patient, shape (T, 3, 3) [–]; rounding of up to 1e-5 is
            corrected (`ttus_opt.probe.pose`).
        force: On the probe, patient axes, shape (T, 3) [N]; None when not measured.
        torque: About the shell's reference, patient axes, shape (T, 3) [N·m]; None
            when not measured, as by a sensor of forces alone.
        segment: Number of the recording each frame is from, shape (T,) [–]; frames of
            a recording are contiguous, and no derivative is taken across recordings.
            One recording by default.
    """

    time: Array
    position: Array = field(repr=False)
    rotation: Array = field(repr=False)
    force: Array | None = field(default=None, repr=False)
    torque: Array | None = field(default=None, repr=False)
    segment: IntArray = field(
        default_factory=lambda: np.zeros(0, dtype=np.int64), repr=False
    )

    def __post_init__(self) -> None:
        """Validate the trajectory.

        Raises:
            InputError: No frames, shapes that disagree, values that are not finite or
                in no plausible unit, times that do not increase, matrices that are not
                rotations, or torques without forces.
        """
        n = len(self.time)
        if n == 0:
            raise InputError("a trajectory needs at least one frame, got none")
        if len(self.segment) == 0:
            object.__setattr__(self, "segment", np.zeros(n, dtype=np.int64))
        if self.force is None and self.torque is not None:
            raise InputError(
                "a wrench needs force (T, 3) [N], got only torque: give the force too"
            )
        self._require_shapes(n)
        object.__setattr__(self, "rotation", rotations(self.rotation))
        late = np.flatnonzero(steps_within(self.time, self.segment) <= 0)
        if len(late):
            i = int(late[0])
            raise InputError(
                f"time must increase within a segment [s], got {self.time[i - 1]:.6g} "
                f"then {self.time[i]:.6g} at frame {i}: sort by time and drop "
                "duplicates"
            )
        runs = 1 + np.count_nonzero(np.diff(self.segment))
        if runs != len(np.unique(self.segment)):
            raise InputError(
                "frames of a segment must be contiguous: sort the frames by segment, "
                "then by time"
            )

    def _require_shapes(self, n: int) -> None:
        others = {"time": (n,), "segment": (n,), "rotation": (n, 3, 3)}
        hint = ": Trajectory.from_arrays takes lists"
        for name, value in self._arrays().items():
            shape = others.get(name, (n, 3))
            real = numbers(value, f"trajectory {name}", hint)
            if name != "segment":
                object.__setattr__(self, name, real)
            expect_shape(value, shape, f"trajectory {name}")
            size = np.abs(value).reshape(n, -1).max(axis=1)
            bad = ~(size < IMPLAUSIBLE)
            if bad.any():
                first = int(bad.argmax())
                raise InputError(
                    f"trajectory {name} is {size[first]:.3g} in frame {first}: not "
                    f"finite or in no plausible unit in {bad.sum()} of {n} frames, "
                    "drop those"
                )

    def __len__(self) -> int:
        """Number of frames T [–]."""
        return len(self.time)

    def __repr__(self) -> str:
        return f"Trajectory({', '.join(self._facts().values())})"

    def _repr_html_(self) -> str:
        own = self.parts[0]  # times of others may begin anew
        shown = slice(own.start, own.stop, max(1, (own.stop - own.start) // 200))
        moved = self.position - self.position[own.start]
        values = moved if self.force is None else self.force
        picture = curve_svg(self.time[shown], np.linalg.norm(values[shown], axis=1))
        about = "distance from the start" if self.force is None else "force"
        most = f"{np.linalg.norm(values, axis=1).max():.3g}"
        unit = "m" if self.force is None else "N"
        drawn = {"drawn": f"{about} over time, at most {most} {unit}"}
        return card("Trajectory", self._facts() | drawn, picture)

    def _facts(self) -> dict[str, str]:
        """A short description, by name."""
        n = len(self.parts)
        recordings = f" in {n} recordings" if n > 1 else ""
        measured = "with wrenches" if self.has_torque else "with forces"
        wrench = measured if self.has_wrench else "without wrenches"
        spans = [self.time[p.stop - 1] - self.time[p.start] for p in self.parts]
        seconds = float(np.sum(spans))
        return {
            "frames": f"{counted(len(self), 'frame')}{recordings}",
            "duration": f"{seconds:.4g} s",
            "wrenches": wrench,
        }

    @classmethod
    def from_arrays(
        cls,
        positions: ArrayLike | None,
        orientations: PoseLike,
        forces: ArrayLike | None = None,
        torques: ArrayLike | None = None,
        times: ArrayLike | None = None,
        *,
        order: QuaternionOrder | None = None,
    ) -> Trajectory:
        """A trajectory from arrays in any common form.

        Args:
            positions: Origins of the probe frame, shape (T, 3) [m]; None with poses.
            orientations: Probe to patient: matrices (T, 3, 3), SciPy `Rotation`,
                quaternions (T, 4); or whole poses as matrices (T, 4, 4) or SciPy
                `RigidTransform`.
            forces: On the probe, patient axes, shape (T, 3) [N].
            torques: About the shell's reference, patient axes, shape (T, 3) [N·m].
            times: Shape (T,) [s]; by default one frame per second: give them where
                friction matters.
            order: Order of quaternions, never guessed: ``wxyz``, or ``xyzw`` as in ROS
                and SciPy.

        Raises:
            InputError: Forms or shapes that do not match, as in `Trajectory`.

        Examples:
            >>> t = Trajectory.from_arrays([[0, 0, 1]], [[0, 0, 0, 1]], order="xyzw")
            >>> len(t), t.has_wrench
            (1, False)
        """
        rotation, position = poses_of(positions, orientations, order)
        every = np.arange(len(position)) if times is None else times
        force, torque = (
            None if given is None else np.array(given, dtype=np.float64)
            for given in (forces, torques)
        )
        return cls(
            np.array(every, dtype=np.float64),
            position.copy(),
            rotation.copy(),
            force,
            torque,
        )

    def transformed(self, *motions: PoseLike) -> Trajectory:
        """The same trajectory in another frame, poses and wrenches.

        Wrenches are rotated only: the reference point of torques moves with the probe.

        Args:
            motions: Applied in order, each a matrix (4, 4) or a SciPy `RigidTransform`
                that maps coordinates of one frame to the next:
                ``transformed(base_to_scan, axis.scan_to_patient)``.

        Raises:
            InputError: One is not a rigid motion.
        """
        matrix = composed(motions)
        turn = matrix[:3, :3]
        return replace(
            self,
            position=self.position @ turn.T + matrix[:3, 3],
            rotation=turn @ self.rotation,
            force=None if self.force is None else self.force @ turn.T,
            torque=None if self.torque is None else self.torque @ turn.T,
        )

    @property
    def has_wrench(self) -> bool:
        """Whether forces were measured; see ``has_torque``."""
        return self.force is not None

    @property
    def has_torque(self) -> bool:
        """Whether torques were measured beside the forces."""
        return self.torque is not None

    @property
    def quat_wxyz(self) -> Array:
        """Unit quaternions w, x, y, z with w ≥ 0, shape (T, 4) [–]."""
        return to_quaternions(self.rotation)

    def velocity(self) -> Array:
        """Differences of the probe frame's origin, patient axes, (T, 3) [m/s].

        Central differences in time, weighted for uneven steps, one-sided at the ends
        of a segment; zero in a segment of one frame, whose motion is not known.
        """
        out = np.zeros_like(self.position)
        for part in self.parts:
            if part.stop - part.start > 1:
                out[part] = np.gradient(self.position[part], self.time[part], axis=0)
        return out

    def angular_velocity(self) -> Array:
        """Differences of the probe's rotation, patient axes, shape (T, 3) [rad/s].

        The constant rotation rate from the frame before to the frame after, one-sided
        at the ends of a segment; zero in a segment of one frame.
        """
        from scipy.spatial.transform import Rotation

        out = np.zeros_like(self.position)
        for part in self.parts:
            n = part.stop - part.start
            if n < 2:
                continue
            before = part.start + np.maximum(np.arange(n) - 1, 0)
            after = part.start + np.minimum(np.arange(n) + 1, n - 1)
            turn = self.rotation[after] @ self.rotation[before].transpose(0, 2, 1)
            span = self.time[after] - self.time[before]
            out[part] = Rotation.from_matrix(turn).as_rotvec() / span[:, None]
        return out

    def twist(self) -> Array:
        """Velocity, then angular velocity, as `Renderer.render` takes it, (T, 6).

        Without the noise of the poses, as `ttus_opt.probe.smooth_motion` estimates it
        from all frames of a segment; of a short segment that of `velocity` and
        `angular_velocity`.

        Computed once: make a new trajectory rather than edit the arrays of one.
        """
        return self._twist.copy()

    @cached_property
    def _twist(self) -> Array:
        from ttus_opt.probe.smooth_motion import smooth_twist

        out = np.concatenate([self.velocity(), self.angular_velocity()], axis=1)
        for part in self.parts:
            poses = self.rotation[part], self.position[part]
            out[part] = smooth_twist(*poses, self.time[part], out[part])
        return out

    def _arrays(self) -> dict[str, Any]:
        """The arrays that are not None, by name."""
        found = {own.name: getattr(self, own.name) for own in fields(self)}
        return {name: values for name, values in found.items() if values is not None}

    @property
    def parts(self) -> list[slice]:
        """Frames of every recording, in the order in which they stand."""
        return parts(self.segment)

    @property
    def recordings(self) -> list[Trajectory]:
        """Every recording by itself."""
        return [self.select(part) for part in self.parts]

    def select(self, frames: slice | NDArray[np.bool_] | IntArray) -> Trajectory:
        """Some of the frames, in order; velocities follow from these frames alone.

        Args:
            frames: A slice, a mask (T,) or increasing indices.

        Raises:
            InputError: No frame is selected, or a mask of another length.
        """
        if isinstance(frames, np.ndarray) and frames.dtype == np.bool_:
            expect_shape(frames, (len(self),), "a mask of frames")
            if not frames.any():
                raise InputError("the mask leaves no frame: select at least one")
        return Trajectory(**{name: a[frames] for name, a in self._arrays().items()})

    @classmethod
    def concatenate(cls, parts: Sequence[Trajectory]) -> Trajectory:
        """Several recordings as one; segments stay apart and are numbered from 0.

        Raises:
            InputError: Nothing given, or forces or torques in some recordings only.
        """
        if not parts:
            raise InputError("concatenate needs at least one trajectory, got none")
        without = [str(i) for i, p in enumerate(parts, 1) if not p.has_wrench]
        if 0 < len(without) < len(parts):
            raise InputError(
                f"of {len(parts)} trajectories number {', '.join(without)} have no "
                "wrenches: leave out those without"
            )
        if len({p.has_torque for p in parts}) > 1:
            raise InputError(
                "some of the trajectories have torques and others only forces: join "
                "one kind only"
            )
        numbers, first = [], 0
        for part in parts:
            _, own = np.unique(part.segment, return_inverse=True)
            numbers.append(own.reshape(-1).astype(np.int64) + first)
            first += int(own.max()) + 1
        joined = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in parts[0]._arrays()
        }
        return cls(**joined | {"segment": np.concatenate(numbers)})

    def save(self, path: str | os.PathLike[str], *, digits: int = 17) -> None:
        """Write the CSV, replacing ``path`` only on success.

        A column ``segment`` is added when there are several recordings.

        Args:
            path: The file.
            digits: Significant digits; by default all, so that reading restores every
                number exactly.

        Raises:
            FileError: The folder cannot be written to.
        """
        self.raw("").save(path, digits=digits)

    def raw(self, source: str) -> RawRecording:
        """As a file would hold it; errors name the source."""
        values = self.time, self.position, self.quat_wxyz, self.force, self.torque
        return RawRecording(source, *values, self.segment)


def read_trajectory(
    path: str | os.PathLike[str],
    *,
    columns: Mapping[str, str] | None = None,
    repair: bool = False,
) -> Trajectory:
    """Read a trajectory.

    The header names the columns, in any order: ``t`` [s], ``px,py,pz`` [m],
    ``qw,qx,qy,qz``, ``fx,fy,fz`` [N] and, beside forces, ``tx,ty,tz`` [N·m]. An
    integer column ``segment`` keeps several recordings apart; other columns are
    ignored. Quaternions within 1 % of unit length are normalised.

    Names are accepted in any case and as other programs write them
    (``pose.position.x``, ``Fx [N]``, `ttus_opt.probe.column_names`), cells separated by
    commas, semicolons, tabs or blanks, comment lines before the header.

    Args:
        path: The CSV file.
        columns: Other names of columns, by the names above: ``{"px": "tip_x"}``, with
            units (``"tip_x[mm]"``), and two to be added (``"sec+nanosec"``).
        repair: Drop rows without numbers and repeated rows, sort, and split at gaps and
            jumps, with a warning of what was done (`ttus_opt.probe.repair`).

    Raises:
        FileError: Missing, empty or truncated file, a missing column, a cell that is
            not a finite number, times that do not increase, quaternions that are not
            unit, or values in another unit. The message names the line.
    """
    raw = raw_trajectory(path, columns)
    return trajectory_of(repaired_aloud(raw) if repair else raw)


def trajectory_of(raw: RawRecording) -> Trajectory:
    """A recording of poses, checked.

    Raises:
        FileError: Anything is wrong with it, or it has no poses.
    """
    if raw.position is None or raw.quaternion is None:
        raise FileError(f"{raw.title} has no poses: position and rotation are needed")
    read = checked(raw)
    assert read.position is not None and read.quaternion is not None
    with located(read.title, FileError):
        return Trajectory(
            read.time,
            read.position,
            from_quaternions(read.quaternion, "wxyz"),
            read.force,
            read.torque,
            read.segment,
        )


def interpolated(at: Array, time: Array, values: Array) -> Array:
    """Values (T, k) interpolated linearly from ``time`` to ``at`` [s]."""
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)


def thinned(
    trajectory: Trajectory, *, every: int = 1, rate: float | None = None
) -> Trajectory:
    """Some of the frames of every recording, including its first; none is averaged.

    Args:
        trajectory: One recording or several.
        every: Keep every n-th frame [–].
        rate: Most frames per second of the recording, applied before ``every``; None
            for all [Hz].

    Raises:
        InputError: ``every`` is not a positive whole number, or ``rate`` is not
            positive or beyond `HIGHEST`.

    >>> from ttus_opt import example
    >>> press = read_trajectory(example.path("press_fit.csv"))  # 20 s at 20 Hz
    >>> len(thinned(press, every=3)), len(thinned(press, rate=5.0))
    (134, 100)
    """
    if not (isinstance(every, int) and every >= 1):
        raise InputError(f"every must be a whole number of at least 1, got {every!r}")
    if rate is not None and not 0.0 < rate <= HIGHEST:
        raise InputError(
            f"rate must be positive and at most {HIGHEST:g} Hz, got {rate}"
        )
    kept = []
    for part in trajectory.parts:
        frames = np.arange(part.start, part.stop)
        if rate is not None:
            passed = trajectory.time[frames] - trajectory.time[frames[0]]
            # rounding of the times must not move a frame to the previous interval
            interval = np.floor(passed * rate + 1e-6)
            frames = frames[np.diff(interval, prepend=-1.0) > 0.0]
        kept.append(frames[::every])
    return trajectory.select(np.concatenate(kept))
