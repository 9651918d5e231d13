"""Bias of a force sensor, and mass and centre of mass of the load below it.

With gravity u = R_sᵀ g in sensor axes, a sensor in free air reads

    s f = b_f + m u,        s τ = b_τ + (m c) × u

(docs/method/sensors.md, 19.1), linear in b_f, m, b_τ and m c: least squares over poses
that tilt the sensor. The readings are first checked against the stated mounting: the
best orthogonal map from u to f is the identity where the statements are true, minus the
identity where the sign is wrong, and another reflection where the axes are left-handed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import GeometryError, InputError, warn
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.force_sensor import ForceSensor

#: Standard gravity [m/s²]
GRAVITY = 9.80665

#: Fewest poses in free air
LEAST_POSES = 8

#: Least root-mean-square variation of gravity, as a fraction of it, along two sensor
#: axes; without a third, handedness cannot be determined
LEAST_TILT = 0.1

#: Largest rotation between the readings and the stated axes [rad]
LARGEST_TURN = np.deg2rad(15.0)

#: A load lighter than this many standard errors cannot check axes and sign
TELLING = 5.0

#: Drift is reported above this many standard errors and this rate [–, N/min]
CERTAIN, NOTABLE = 4.0, 0.05


@dataclass(frozen=True)
class ToolLoad:
    """What a sensor reads without contact; sensor axes, sign of forces on the probe.

    Attributes:
        force_bias: b_f, shape (3,) [N].
        torque_bias: b_τ, about the reference point, shape (3,) [N·m].
        mass: m [kg].
        centre: Centre of mass from the reference point, shape (3,) [m].
        mass_std: Standard error of the mass [kg].
        centre_std: Standard error of the centre, shape (3,) [m].
        force_residual: Root-mean-square residual of the force, per axis [N].
        torque_residual: Root-mean-square residual of the torque, per axis [N·m].
        drift: Drift of the force over the free recording, shape (3,) [N/s].
        handedness_told: Whether the tilts could reveal left-handed axes.
    """

    force_bias: Array
    torque_bias: Array
    mass: float
    centre: Array
    mass_std: float
    centre_std: Array = field(repr=False)
    force_residual: float
    torque_residual: float
    drift: Array = field(repr=False)
    handedness_told: bool = field(repr=False)

    def __str__(self) -> str:
        centre = ", ".join(f"{1e3 * v:.1f}" for v in self.centre)
        return (
            f"{self.mass:.4g} ± {self.mass_std:.2g} kg, centre of mass ({centre}) mm "
            f"from the sensor's point, its axes; free air leaves "
            f"{self.force_residual:.2g} N and {1e3 * self.torque_residual:.2g} mN m"
        )

    def facts(self) -> dict[str, Any]:
        """The load by name, with units, as a model's file stores it."""
        return {
            "force_bias_N": self.force_bias.tolist(),
            "torque_bias_Nm": self.torque_bias.tolist(),
            "mass_kg": self.mass,
            "mass_std_kg": self.mass_std,
            "centre_m": self.centre.tolist(),
            "centre_std_m": self.centre_std.tolist(),
            "force_residual_N": self.force_residual,
            "torque_residual_Nm": self.torque_residual,
            "drift_N_per_s": self.drift.tolist(),
            "handedness_told": self.handedness_told,
        }


def checked_down(down: ArrayLike) -> Array:
    """The direction of gravity, normalised, shape (3,) [–].

    Raises:
        InputError: It is zero, or not a vector.
    """
    direction = np.array(down, dtype=np.float64)
    length = float(np.linalg.norm(direction)) if direction.shape == (3,) else 0.0
    if not 1e-6 < length < 1e6:
        raise InputError(
            "down must be a direction x,y,z in the frame of the poses, got "
            f"{direction.tolist()}: 0,0,-1 where z points up"
        )
    return direction / length


def gravity_in_sensor(free: Trajectory, sensor: ForceSensor, down: ArrayLike) -> Array:
    """U = R_sᵀ g for every frame, sensor axes, shape (T, 3) [m/s²]."""
    world = free.rotation @ sensor.axes
    return np.asarray(GRAVITY * np.einsum("tji,j->ti", world, checked_down(down)))


def identify_load(free: Trajectory, sensor: ForceSensor, down: ArrayLike) -> ToolLoad:
    """Bias, weight and centre of mass from poses free in the air.

    Args:
        free: Raw readings at rest or in slow motion, without contact.
        sensor: How the sensor is mounted.
        down: Direction of gravity in the frame of the poses, shape (3,).

    Returns:
        The load, with standard errors. A `TtusWarning` reports drift, and a load too
        light to check the sensor's axes.

    Raises:
        InputError: No readings, too few poses, or readings that contradict the sensor's
            axes or sign.
        GeometryError: The poses hardly tilt the sensor.
    """
    force, torque = sensor.readings(free, "free recording")
    if len(free) < LEAST_POSES:
        raise InputError(
            f"at least {LEAST_POSES} free poses are needed, got {len(free)}: record "
            "more"
        )
    u = gravity_in_sensor(free, sensor, down)
    spread = np.linalg.svd((u - u.mean(axis=0)) / GRAVITY, compute_uv=False)
    spread /= np.sqrt(len(u))
    if spread[1] < LEAST_TILT:
        raise GeometryError(
            f"gravity varies by {spread[0]:.2g} and {spread[1]:.2g} of itself in the "
            f"sensor's axes, {LEAST_TILT:g} is needed along two: hold the probe in "
            "free air tilted by 30° and more about two axes"
        )
    ones = np.broadcast_to(np.eye(3), (len(u), 3, 3))
    by_force = np.concatenate([ones, u[:, :, None]], axis=2).reshape(-1, 4)
    of_force, force_std, rest, force_residual = _least_squares(
        by_force, force.reshape(-1)
    )
    spans_all = bool(spread[2] >= LEAST_TILT)
    _check_axes(force, u, spans_all, sensor)
    crossing = -np.cross(np.eye(3)[None], u[:, None, :])  # h × u = −u × h
    by_torque = np.concatenate([ones, crossing], axis=2).reshape(-1, 6)
    of_torque, torque_std, _, torque_residual = _least_squares(
        by_torque, torque.reshape(-1)
    )
    mass, mass_std = float(of_force[3]), float(force_std[3])
    moment, heavy = of_torque[3:], mass > TELLING * mass_std
    centre = moment / mass if heavy else np.zeros(3)
    centre_std = np.hypot(torque_std[3:], centre * mass_std) / mass
    load = ToolLoad(
        of_force[:3] if heavy else force.mean(axis=0),
        of_torque[:3] if heavy else torque.mean(axis=0),
        mass if heavy else 0.0,
        centre,
        mass_std,
        centre_std if heavy else np.zeros(3),
        force_residual,
        torque_residual,
        _drift(free, rest.reshape(-1, 3)),
        spans_all and heavy,
    )
    if not heavy:
        warn(
            f"the free poses show no weight ({mass:.2g} ± {mass_std:.2g} kg): the "
            "readings may be compensated already; axes and sign are not checked"
        )
    return load


def _least_squares(matrix: Array, target: Array) -> tuple[Array, Array, Array, float]:
    """An answer, its standard errors, and the residuals with their deviation."""
    values, *_ = np.linalg.lstsq(matrix, target, rcond=None)
    rest = target - matrix @ values
    residual = float(np.sqrt(rest @ rest / (len(target) - matrix.shape[1])))
    std = residual * np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
    return np.asarray(values), std, rest, residual


def _check_axes(force: Array, u: Array, spans_all: bool, sensor: ForceSensor) -> None:
    """Check the stated mounting against the readings (docs/method/sensors.md, 19.3).

    Args:
        force: Readings with their stated sign, shape (T, 3) [N].
        u: Gravity in the stated axes, shape (T, 3) [m/s²].
        spans_all: Whether the tilts span all three axes.
        sensor: The stated mounting.
    """
    centred, by = force - force.mean(axis=0), u - u.mean(axis=0)
    # f ≈ m M u with M orthogonal: the Procrustes problem
    left, values, right = np.linalg.svd(centred.T @ by)
    mass = float(values.sum() / (by * by).sum())
    map_ = left @ right
    rest = centred - mass * by @ map_.T
    noise = float(np.sqrt((rest * rest).mean()))
    if mass * np.sqrt((by * by).sum()) < TELLING * noise * np.sqrt(3.0):
        return  # without a weight there is nothing to compare
    if not spans_all and np.linalg.det(map_) < 0:
        # tilts in a plane do not distinguish a reflection across it
        map_ = left @ np.diag([1.0, 1.0, -1.0]) @ right
    other = "by-probe" if sensor.sign == "on-probe" else "on-probe"
    if np.linalg.det(map_) > 0:
        turn = float(np.rad2deg(Rotation.from_matrix(map_).magnitude()))
        if turn < np.rad2deg(LARGEST_TURN):
            return
        # with tilts in a plane, reversed gravity looks like half a turn
        first = f"give sign={other}, or " if not spans_all and turn > 150.0 else ""
        fits = Rotation.from_matrix(sensor.axes @ map_.T).as_quat().round(3) + 0.0
        raise InputError(
            f"the readings lie {turn:.0f}° from the stated axes: {first}give axes="
            f"{','.join(f'{v:g}' for v in fits)} (quaternion x,y,z,w), or check down=…"
        )
    flipped = Rotation.from_matrix(-map_).magnitude()
    if flipped < LARGEST_TURN:
        raise InputError(
            "gravity is reversed in all three axes: the sensor measures the opposite "
            f"force: give sign={other}, or check down=…"
        )
    nearest = int(np.argmin(np.diag(map_)))
    raise InputError(
        "the sensor's axes are left-handed: no rotation fits its readings, the "
        f"{'xyz'[nearest]} axis is reversed: negate its column of forces and of "
        "torques"
    )


def _drift(free: Trajectory, rest: Array) -> Array:
    """Slope of the force's residual over time, shape (3,) [N/s]."""
    time = free.time - free.time.mean()
    square = float(time @ time)
    if square == 0.0:
        return np.zeros(3)
    slope = np.asarray(time @ rest / square)
    left = rest - np.outer(time, slope)
    std = np.sqrt((left * left).sum(axis=0) / (len(time) - 2) / square)
    certain = (np.abs(slope) > CERTAIN * std) & (60.0 * np.abs(slope) > NOTABLE)
    if certain.any():
        worst = float(np.abs(slope[certain]).max())
        warn(
            f"the sensor drifts by {60.0 * worst:.2g} N a minute: let it warm up, or "
            "record free poses right before and after",
            2,
        )
    return slope
