"""Options about probe and recordings, one list for fit, evaluate and render."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ttus_opt.cli.options import numbers
from ttus_opt.core.errors import InputError, TtusError

if TYPE_CHECKING:
    from ttus_opt.probe.conventions import Conventions
    from ttus_opt.probe.point_shell import PointShell
    from ttus_opt.probe.trajectory import Trajectory
    from ttus_opt.scan.surface import Surface


@dataclass(frozen=True)
class ProbeOptions:
    """The probe, as typed.

    Attributes:
        probe: ellipsoid:a,b,c (semi-axes), sphere:r, box:a,b,c (edges) in metres, or a
            mesh file (STL, PLY, OBJ).
        points: Number of points of the probe's shell.
        probe_unit: Unit of a mesh file: m, cm, mm, in.
        probe_surface: Which part of a mesh to keep: outer, all, hull.
    """

    probe: str
    points: int = 1500
    probe_unit: str = "mm"
    probe_surface: str = "outer"

    @property
    def name(self) -> str:
        """As a field file names it: the description, or the file's name."""
        return self.probe if ":" in self.probe else Path(self.probe).name

    def read(self) -> PointShell:
        """The point shell.

        Raises:
            TtusError: Whatever is wrong with it.
        """
        from ttus_opt.probe.point_shell import PointShell

        return PointShell.from_spec(
            self.probe,
            n_points=self.points,
            unit=self.probe_unit,
            surface=self.probe_surface,  # type: ignore[arg-type]  # checked there
        )


@dataclass(frozen=True)
class RecordingOptions:
    """Recordings and how they are written, as typed.

    Attributes:
        trajectory: Recording with poses and wrenches, a CSV or any other known file;
            may be repeated.
        stream: Name of the topic, transform, tool or body, if a file has several.
        columns: Column names of the file, for instance px=tip_x[mm],t=sec+nanosec, or a
            YAML file of them. ROS's names are recognised.
        quaternion: Order in the columns qw,qx,qy,qz: wxyz as named, or xyzw.
        frame: Frame of the poses: patient (of the surface file), scan (of the cloud it
            was extracted from) or base (of the robot or tracker). By default patient,
            or base with --base-to-scan.
        wrench_frame: Axes of the measured wrenches: patient, scan, base or tool. By
            default those of the poses' frame.
        flip_wrench: The wrenches are those that the probe exerts on the skin.
        torque_unit: Unit of measured torques: Nm or Nmm.
        torque_about: Reference point of the torques: centroid (of the probe's area),
            origin (of the pose, as CAD and ROS have it) or x,y,z in the probe's frame
            [m].
        wrench_delay: Delay of the wrenches behind the poses [s].
    """

    trajectory: Annotated[list[Path], typer.Option(metavar="PATH")]
    stream: str | None = None
    columns: Annotated[str, typer.Option(metavar="NAME=COLUMN,…|FILE")] = ""
    repair: bool = False
    quaternion: str = "wxyz"
    frame: str = ""
    base_to_scan: Annotated[str, typer.Option(metavar="FILE|x,y,z,qx,qy,qz,qw")] = ""
    wrench_frame: str = ""
    flip_wrench: bool = False
    torque_unit: str = "Nm"
    torque_about: str = "centroid"
    wrench_delay: float = 0.0

    @property
    def names(self) -> list[str]:
        """Names of the files."""
        return [path.name for path in self.trajectory]

    @cached_property
    def conventions(self) -> Conventions:
        """How recordings are written.

        Raises:
            InputError: In the words of the command line.
        """
        from ttus_opt.probe.conventions import Conventions
        from ttus_opt.probe.rigid_motion import as_rows, read_rigid_motion

        about: Any = self.torque_about
        if "," in self.torque_about:
            about = numbers(self.torque_about, 3, "--torque-about")
        motion = None
        if self.base_to_scan:
            try:
                motion = as_rows(read_rigid_motion(self.base_to_scan))
            except TtusError as error:
                raise InputError(f"--base-to-scan: {error}") from error
        given = {each.name: getattr(self, each.name) for each in fields(Conventions)}
        frame = self.frame or ("patient" if motion is None else "base")
        given |= {"frame": frame, "base_to_scan": motion, "torque_about": about}
        try:
            return Conventions(**given)
        except InputError as error:
            name, _, rest = str(error).partition(" ")
            raise InputError(f"--{name.replace('_', '-')} {rest}") from error

    def as_written(self) -> Trajectory:
        """All recordings as one, with the files' numbers taken at their word.

        Raises:
            FileError: A file is not a usable trajectory.
            InputError: Only some of them have wrenches, or columns that are not pairs.
        """
        from ttus_opt.probe.trajectory import Trajectory
        from ttus_opt.sensors.column_map import read_column_map
        from ttus_opt.sensors.stream_files import read_recording

        told, repair = read_column_map(self.columns), self.repair
        parts = [
            read_recording(f, self.stream, told, repair=repair) for f in self.trajectory
        ]
        for what in ("force", "torque"):
            having = [getattr(part, what) is not None for part in parts]
            if any(having) and not all(having):
                raise InputError(
                    f"{self.trajectory[having.index(False)]} has no {what}s, and "
                    f"{self.trajectory[having.index(True)]} has: give those of one kind"
                )
        return Trajectory.concatenate(parts)

    def require_forces(self, recorded: Trajectory, formulation: str = "") -> None:
        """Check that forces were measured, where a formulation needs any.

        Raises:
            InputError: None were; for ``laplace_only`` and a file of the user's own
                that is not checked.
        """
        unneeded = formulation == "laplace_only" or formulation.endswith(".py")
        if not (recorded.has_wrench or unneeded):
            names = ", ".join(self.names)
            raise InputError(f"{names}: no measured forces: add the columns fx, fy, fz")

    def read(
        self, as_written: Trajectory, shell: PointShell, patient: Surface
    ) -> Trajectory:
        """The recordings as the package has them, in the patient's frame.

        A `TtusWarning` tells when they lie on the skin in another frame only.

        Args:
            as_written: As in the method of that name.
            shell: The probe.
            patient: Whose frame it is.
        """
        from ttus_opt.fitting.checks.frame_check import (
            warn_of_another_frame,
            warn_of_jumps,
        )

        warn_of_jumps(as_written)
        read = self.conventions.read(
            as_written, shell.reference, patient.axis.scan_to_patient
        )
        warn_of_another_frame(as_written, read, shell, patient, self.conventions)
        return read
