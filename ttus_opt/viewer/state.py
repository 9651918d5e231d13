"""What a viewer shows, without a browser: fields, probe, its pose and what is felt.

The hand's pose comes from drags, buttons, a recording's frames, or from outside
(`ViewState.follow`). `ViewState.advance` moves the probe towards it and renders. Any
thread may call any method.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.contact.standing import (
    depth_of,
    places_below,
    skin_frames,
    standing,
    usual_hold,
)
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.haptic.motion import MotionFilter
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.probe.held import hold
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.pose import PoseLike, pose_of
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface
from ttus_opt.viewer.hand_motion import HandMotion
from ttus_opt.viewer.recording import Recording
from ttus_opt.viewer.touch import Touch, touch_at
from ttus_opt.voxmap.field import PotentialField

Source = Literal["hand", "recording", "outside"]

#: Depth of the first pose, and the range of depths that a hand may ask for [m]
FIRST, LEAST, MOST = 0.005, -0.03, 0.04

#: Steps after the last motion over which the renderer's estimate of it dies away [–]
REST = 30

#: Longest step of the clock: after a pause the probe moves on, it does not jump [s]
LONGEST = 0.05


class ViewState:
    """One or two fields, one probe.

    Args:
        fields: One field, or two on the same patient to compare.
        shell: The probe; None to look only.
        trajectory: Recordings to show, in the patient's frame; they tell how the probe
            is held.
        usual: How it is held without (`probe.held.hold`); by default its z axis points
            into the patient, its x axis around the body.

    Raises:
        InputError: No field or more than two, or two of different patients.
    """

    def __init__(
        self,
        fields: Sequence[PotentialField],
        shell: PointShell | None,
        trajectory: Trajectory | None = None,
        usual: Array | None = None,
    ) -> None:
        self.fields, self.shell = list(fields), shell
        self.surface = _one_patient(fields)
        self.lock = threading.RLock()
        self.source: Source = "hand"
        self.touches: tuple[Touch, ...] = ()
        self.recording: Recording | None = None
        self.frame = 0
        self.measured: Array | None = None
        self.hold = hold() if usual is None else usual
        self._clock, self._left = 0.0, 0
        self._renderers: tuple[Renderer, ...] = ()
        if shell is None:
            return
        self._renderers = self.renderers()
        if trajectory is not None:
            self.recording = Recording.of(trajectory, self.renderers())
            self.hold = self._held(trajectory, shell)
        place = self._first_place()
        self._pose = self._standing(*place, FIRST, self.hold)
        self._known = self._pose, place
        self._motion = HandMotion(shell, *self._pose)
        self._render()

    def renderers(self) -> tuple[Renderer, ...]:
        """Renderers of the present fields, for another thread's use."""
        assert self.shell is not None
        return tuple(Renderer(field, self.shell) for field in self.fields)

    @property
    def probe(self) -> PointShell:
        """The probe.

        Raises:
            InputError: There is none.
        """
        if self.shell is None:
            raise InputError("there is no probe to move: give one to view")
        return self.shell

    @property
    def pose(self) -> tuple[Array, Array]:
        """Where the hand is: rotation (3, 3) [–] and position (3,) [m]."""
        assert self.probe is not None
        return self._pose

    @property
    def place(self) -> tuple[float, float]:
        """Angle [rad] and height [m] below the probe's reference point."""
        pose = self.pose
        if self._known[0] is not pose:
            self._known = pose, self._below(*pose)
        theta, z = self._known[1]
        return (theta + 0.5 * TURN) % TURN - 0.5 * TURN, z

    @property
    def depth(self) -> float:
        """Depth of the deepest point at the hand's pose, negative in air [m]."""
        one = self.pose[0][None], self.pose[1][None]
        return float(depth_of(self.surface, self.probe, *one)[0])

    @property
    def outward(self) -> Array:
        """Normal of the skin at the hand's place, shape (3,) [–]."""
        return np.asarray(self._frame(*self.place)[:, 0])

    @property
    def angles(self) -> Array:
        """Turn about the skin's normal, tilts around and along it, (3,) [deg]."""
        relative = self._frame(*self.place).T @ self.pose[0] @ self.hold.T
        turns = Rotation.from_matrix(relative).as_euler("XYZ", degrees=True)
        return np.asarray(turns)

    def slide(self, theta: float, z: float) -> None:
        """Go to a place of the skin, as deep and as tilted as now."""
        with self.lock:
            self._stand(theta, self._on_skin(z), self.depth)

    def move(
        self, around: float = 0.0, along: float = 0.0, deeper: float = 0.0
    ) -> None:
        """Go some way over the skin, and deeper [m]."""
        with self.lock:
            theta, z = self.place
            depth = float(np.clip(self.depth + deeper, LEAST, MOST))
            if around or along:
                radius = float(self.surface.radius_at(np.array(theta), np.array(z)))
                theta, z = theta + around / radius, self._on_skin(z + along)
            self._stand(theta, z, depth)

    def press(self, depth: float) -> None:
        """Go to a depth along the skin's normal [m]."""
        with self.lock:
            self._stand(*self.place, float(np.clip(depth, LEAST, MOST)))

    def tilt(self, angles: Array) -> None:
        """Hold the probe at these angles, see `angles`, as deep as now [deg]."""
        turned = Rotation.from_euler("XYZ", angles, degrees=True).as_matrix()
        with self.lock:
            self._stand(*self.place, self.depth, turned @ self.hold)

    def put(self, rotation: PoseLike, position: Array | None = None) -> None:
        """Go to a pose of the probe frame.

        Raises:
            InputError: Not a pose.
        """
        with self.lock:
            self._hand(pose_of(rotation, position, None))

    def show_frame(self, frame: int) -> None:
        """Be at a frame of the recordings at once, felt as it was moved there.

        Raises:
            InputError: No recordings.
        """
        with self.lock:
            if self.recording is None:
                raise InputError("there is no recording to show: give one to view")
            self.frame = int(np.clip(frame, 0, len(self.recording) - 1))
            shown = self.recording.trajectory
            self._pose = shown.rotation[self.frame], shown.position[self.frame]
            self._motion.put(*self.pose)
            self.source, self._left = "recording", 0
            self.measured = None if shown.force is None else shown.force[self.frame]
            self._render(self.recording.twist[self.frame])

    def follow(
        self,
        rotation: PoseLike,
        position: Array | None = None,
        *,
        time: float | None = None,
        measured: Array | None = None,
    ) -> None:
        """Be at a pose from outside, a tracked or a simulated probe, at once.

        Args:
            rotation: Probe to patient, as for `Renderer.render`.
            position: Its origin, patient frame, shape (3,) [m].
            time: Time of the pose, for friction [s].
            measured: Force measured there, to show beside the rendered one, (3,) [N].

        Raises:
            InputError: Not a pose, or a time before the last one.
        """
        with self.lock:
            self._pose = pose_of(rotation, position, None)
            self._motion.put(*self.pose)
            self.source, self._left, self.measured = "outside", 0, measured
            self._render(None if time is not None else np.zeros(6), time)

    def update(self, field: PotentialField, which: int = 0) -> None:
        """Replace a field; it is felt at once.

        No hand holds the page, so that nothing need blend as `Renderer.update` does: a
        probe at rest would wait for the new field until it moves.

        Raises:
            InputError: A field of another patient.
        """
        fields = [*self.fields]
        fields[which] = field
        _one_patient(fields)
        new = None if self.shell is None else Renderer(field, self.shell)
        with self.lock:
            self.fields = fields
            if new is not None:
                renderers = [*self._renderers]
                renderers[which] = new
                self._renderers, self._left = tuple(renderers), REST

    def advance(self, seconds: float) -> bool:
        """Move the probe on towards the hand and render.

        Args:
            seconds: Time since the last call [s].

        Returns:
            Whether anything changed.
        """
        with self.lock:
            if self.shell is None or self.source != "hand":
                return False
            seconds = min(seconds, LONGEST)
            if self._motion.step(*self.pose, seconds):
                self._left = REST
            if self._left == 0:
                return False
            self._left -= 1
            self._clock += seconds
            self._render(None, self._clock)
            return True

    def _render(self, twist: Array | None = None, time: float | None = None) -> None:
        if twist is None and time is None:
            twist = np.zeros(6)
        pose = self._motion.rotation, self._motion.position
        self.touches = tuple(
            touch_at(renderer, field, self.probe, pose, twist=twist, time=time)
            for renderer, field in zip(self._renderers, self.fields, strict=True)
        )

    def _hand(
        self, pose: tuple[Array, Array], place: tuple[float, float] | None = None
    ) -> None:
        """Be led by hand to a pose, whose place may be known."""
        if place is not None:
            self._known = pose, place
        if self.source != "hand":  # what moved there was no hand
            self._clock += 2.0 * MotionFilter().gap
        self._pose, self.source, self._left = pose, "hand", REST
        self.measured = None

    def _below(self, rotation: Array, position: Array) -> tuple[float, float]:
        """Place on whose normal the probe's reference point lies."""
        reference = position + rotation @ self.probe.reference
        theta, z = places_below(self.surface, reference[None])
        return float(theta[0]), float(z[0])

    def _frame(self, theta: float, z: float) -> Array:
        """The skin's frame at a place, shape (3, 3)."""
        frame = skin_frames(self.surface, np.array([theta]), np.array([z]))
        return np.asarray(frame[0])

    def _on_skin(self, z: float) -> float:
        """A height within the skin's [m]."""
        return float(np.clip(z, self.surface.z[0], self.surface.z[-1]))

    def _standing(
        self, theta: float, z: float, depth: float, hold: Array
    ) -> tuple[Array, Array]:
        """The pose at a place and depth, held so relative to the skin."""
        place = np.array([theta]), np.array([z])
        rotation, position = standing(self.surface, self.probe, hold, *place, depth)
        return rotation[0], position[0]

    def _stand(
        self, theta: float, z: float, depth: float, hold: Array | None = None
    ) -> None:
        """Be led by hand to stand at a place, held relative to the skin as now."""
        if hold is None:
            hold = self._frame(*self.place).T @ self.pose[0]
        self._hand(self._standing(theta, z, depth, hold), (theta, z))

    def _held(self, trajectory: Trajectory, shell: PointShell) -> Array:
        """How the recordings hold the probe in contact."""
        poses = trajectory.rotation, trajectory.position
        touching = depth_of(self.surface, shell, *poses) > 0.0
        if not touching.any():
            return self.hold
        return usual_hold(self.surface, shell, *(one[touching] for one in poses))

    def _first_place(self) -> tuple[float, float]:
        """Angle and height of the first pose: where most was pressed, or in front."""
        if self.recording is not None:
            size = self.recording.sizes[1]
            most, shown = int(size.argmax()), self.recording.trajectory
            return self._below(shown.rotation[most], shown.position[most])
        grid, z = self.fields[0].voxmap.grid, self.surface.z
        angle = 0.5 * np.pi if grid.sector is None else 0.5 * sum(grid.sector)
        return float(angle), 0.5 * float(z[0] + z[-1])


def _one_patient(fields: Sequence[PotentialField]) -> Surface:
    """The surface that all fields share.

    Raises:
        InputError: Another number than one or two, or different surfaces.
    """
    if len(fields) not in (1, 2):
        raise InputError(f"a viewer shows one field or two, got {len(fields)}")
    surface, other = (fields[k].voxmap.surface for k in (0, -1))
    one, another = surface.radius, other.radius
    if one.shape != another.shape:
        differ = "{} × {} nodes and {} × {}".format(*one.shape, *another.shape)
    elif not np.allclose(one, another):
        apart = 1e3 * float(np.abs(one - another).max())
        differ = f"radii that differ by up to {apart:.3g} mm"
    else:
        return surface
    raise InputError(
        "two fields are compared on one patient: the surface of the second is "
        f"another one ({differ})"
    )
