"""Mutants of core modules: which small mistakes would the matching tests notice?

`make mutants` changes one thing in one module at a time (an operator, a number, a
condition: cosmic-ray's operators), runs the tests of the same stem and counts who told.
It works on a copy; the tree is never touched. Compiled functions run as plain Python
where that is fast enough, else each mutant compiles what it reaches and nothing else.

    python tests/mutants.py                     all modules, a sample of each
    python tests/mutants.py metrics kkt         some modules
    python tests/mutants.py --sample 100 kkt    more of them

Mutants that change nothing anyone could see are listed with their reason in
``tests/mutants_equivalent.txt`` and are not counted.
"""

from __future__ import annotations

import argparse
import ast
import itertools
import multiprocessing
import os
import queue
import random
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
EQUIVALENT = ROOT / "tests" / "mutants_equivalent.txt"
COPIED = ("ttus_opt", "formulations", "tests", "pyproject.toml", "README.md")

#: Share of mutants that has to be told by the tests.
LEAST = 0.85

#: What tests import from elsewhere: loaded once, in a process that all runs fork from
PRELOADED = (
    "cvxpy",
    "matplotlib.figure",
    "numba",
    "pytest",
    "qpsolvers",
    "scipy.spatial.transform",
    "scipy.sparse.linalg",
    "trimesh",
    "typer",
    "xarray",
)

#: A test run that computes so many times as long as without a mutant hangs, with some
#: seconds more: a mutant may compile anew.
PATIENCE, ROOM = 5.0, 120

#: One that waits for what never comes takes so much longer by the clock, which other
#: work on the machine stretches.
WAITS = 6.0


@dataclass(frozen=True)
class Target:
    """A module and the tests that are meant to tell.

    Attributes:
        module: Below ``ttus_opt``.
        tests: Files below ``tests``.
        is_compiled: Compile; else compiled functions run as plain Python.
    """

    module: str
    tests: tuple[str, ...]
    is_compiled: bool = True

    @property
    def name(self) -> str:
        """As it is chosen on the command line."""
        return Path(self.module).stem


TARGETS = (
    Target("report/metrics.py", ("report/test_metrics.py",)),
    Target(
        "problem/verify/kkt.py",
        ("problem/verify/test_kkt.py", "problem/verify/test_absorption.py"),
    ),
    Target(
        "problem/verify/violation.py",
        ("problem/verify/test_violation.py", "problem/verify/test_kkt.py"),
    ),
    Target(
        "fitting/batch.py", ("fitting/test_batch.py", "fitting/weights/test_tuning.py")
    ),
    Target("fitting/verdict.py", ("fitting/test_verdict.py", "fitting/test_batch.py")),
    Target(
        "problem/verify/gradient_blocks.py",
        ("problem/verify/test_gradient_blocks.py", "problem/verify/test_kkt.py"),
    ),
    Target("fitting/recursion/recursive.py", ("fitting/recursion/test_recursive.py",)),
    Target(
        "fitting/recursion/dual_recursion.py",
        ("fitting/recursion/test_dual_recursion.py",),
    ),
    Target(
        "fitting/recursion/field_refinement.py",
        ("fitting/recursion/test_field_refinement.py",),
    ),
    Target(
        "fitting/recursion/low_rank_kernel.py",
        ("fitting/recursion/test_low_rank_kernel.py",),
    ),
    Target(
        "fitting/recursion/pivots.py",
        (
            "fitting/recursion/test_pivots.py",
            "fitting/recursion/test_low_rank_kernel.py",
        ),
    ),
    Target("fitting/parameters/parabola.py", ("fitting/parameters/test_parabola.py",)),
    Target(
        "fitting/recursion/triangular_factor.py",
        ("fitting/recursion/test_triangular_factor.py",),
        is_compiled=False,
    ),
    Target("solvers/verified.py", ("solvers/test_verified.py",)),
    Target(
        "haptic/renderer.py",
        (
            "haptic/test_renderer.py",
            "haptic/test_renderer_motion.py",
            "haptic/test_renderer_poses.py",
            "haptic/test_renderer_threads.py",
        ),
    ),
    Target("haptic/force_uncertainty.py", ("haptic/test_force_uncertainty.py",)),
    Target(
        "haptic/blend.py",
        (
            "haptic/test_blend.py",
            "haptic/test_blend_drag.py",
            "haptic/test_blend_step.py",
        ),
    ),
    Target("contact/friction.py", ("contact/test_friction.py",)),
    Target("scan/contour_filter.py", ("scan/test_contour_filter.py",)),
    Target("contact/rows.py", ("contact/test_rows.py", "contact/test_contact_size.py")),
    Target(
        "contact/row_kernels.py",
        (
            "contact/test_row_kernels.py",
            "contact/test_rows.py",
            "voxmap/test_sector.py",
        ),
    ),
    Target("probe/point_shell.py", ("probe/test_point_shell.py",)),
    Target("probe/orientation.py", ("probe/test_orientation.py",)),
    Target("solvers/structured.py", ("solvers/test_structured.py",)),
    Target(
        "solvers/dual/active_set.py",
        (
            "solvers/dual/test_active_set.py",
            "solvers/dual/test_primal_dual_active_set.py",
        ),
    ),
    Target(
        "solvers/dual/optimality.py",
        (
            "solvers/dual/test_optimality.py",
            "solvers/dual/test_primal_dual_active_set.py",
        ),
    ),
    Target("solvers/dual/solver.py", ("solvers/dual/test_solver.py",)),
    Target("solvers/conjugate_gradients.py", ("solvers/test_conjugate_gradients.py",)),
    Target(
        "solvers/dual/soft_values.py",
        ("solvers/dual/test_soft_values.py", "solvers/dual/test_preconditioner.py"),
    ),
    *(
        Target(f"solvers/dual/{stem}.py", (f"solvers/dual/test_{stem}.py",))
        for stem in (
            "limits",
            "linear_parameters",
            "pair_subproblem",
            "touched_limits",
            "weight_sweep",
            "working_set",
        )
    ),
    Target(
        "solvers/dual/field_pair.py",
        ("solvers/dual/test_field_pair.py", "solvers/dual/test_touched_limits.py"),
    ),
    Target(
        "solvers/dual/subproblem.py",
        (
            "solvers/dual/test_subproblem.py",
            "solvers/dual/test_active_set.py",
            "solvers/dual/test_soft_values.py",
        ),
    ),
    Target("solvers/primal/elimination.py", ("solvers/primal/test_elimination.py",)),
    Target("contact/boundary_scale.py", ("contact/test_boundary_scale.py",)),
    Target("laplace/system.py", ("laplace/test_system.py", "laplace/test_stencil.py")),
    Target("laplace/stencil.py", ("laplace/test_stencil.py", "laplace/test_system.py")),
    Target("gaussian/matern.py", ("gaussian/test_matern.py",)),
    Target(
        "problem/terms/depth_map_estimate.py",
        ("problem/terms/test_depth_map_estimate.py",),
    ),
    Target("problem/terms/distinct_drag.py", ("problem/terms/test_distinct_drag.py",)),
    Target(
        "fitting/uncertainty/wrench_noise.py",
        ("fitting/uncertainty/test_wrench_noise.py",),
    ),
    Target("fitting/checks/sanity.py", ("fitting/checks/test_sanity.py",)),
    Target("fitting/checks/agreement.py", ("fitting/checks/test_agreement.py",)),
    Target(
        "fitting/uncertainty/posterior.py", ("fitting/uncertainty/test_posterior.py",)
    ),
    Target(
        "fitting/uncertainty/posterior_draws.py",
        ("fitting/uncertainty/test_posterior_draws.py",),
    ),
    Target(
        "fitting/weights/place_left_out.py", ("fitting/weights/test_place_left_out.py",)
    ),
    Target("fitting/uncertainty/presses.py", ("fitting/uncertainty/test_presses.py",)),
    Target("fitting/weights/tuning_rows.py", ("fitting/weights/test_tuning_rows.py",)),
    Target(
        "fitting/recursion/measured_rows.py",
        (
            "fitting/recursion/test_measured_rows.py",
            "fitting/recursion/test_dual_recursion.py",
        ),
    ),
    Target("fitting/path/weight_grid.py", ("fitting/path/test_weight_grid.py",)),
    Target("problem/terms/depth_map.py", ("problem/terms/test_depth_map.py",)),
    Target(
        "problem/terms/depth_profile.py",
        (
            "problem/terms/test_depth_profile.py",
            "problem/terms/test_depth_map_estimate.py",
        ),
    ),
    Target(
        "problem/terms/drag_estimate.py",
        ("problem/terms/test_drag_estimate.py", "problem/terms/test_distinct_drag.py"),
    ),
    Target("contact/slip.py", ("contact/test_point_drag.py",)),
    Target("haptic/point_drag.py", ("haptic/test_drag.py", "haptic/test_wrench.py")),
    Target(
        "haptic/kernel_data.py",
        ("haptic/test_kernel_data.py", "haptic/test_frame.py", "haptic/test_wrench.py"),
    ),
    *(
        Target(f"{room}/{stem}.py", (f"{room}/test_{stem}.py",))
        for room, stems in {
            "comparators": (
                *("contact_geometry", "ellipsoid_torso", "patch_grid"),
                *("perceptual_updates", "proxy_six_dof", "stiffness_map"),
                "voxmap_point_shell",
            ),
            "contact": ("point_drag", "pose_rows", "shell_blocks", "standing"),
            "fitting": ("breakdown",),
            "fitting/poses": ("pose_error_step", "pose_refinement"),
            "fitting/uncertainty": ("contact_spread", "skin_uncertainty"),
            "probe": ("tracker_noise",),
            "haptic": ("motion", "tables"),
            "problem/terms": ("torque", "total_variation"),
        }.items()
        for stem in stems
    ),
    *(
        Target(
            f"problem/terms/penalties/{stem}.py",
            ("problem/terms/penalties/test_penalties.py",),
        )
        for stem in ("absolute", "groups", "huber", "linear", "squares")
    ),
    *(
        Target(
            f"comparators/{stem}.py",
            ("comparators/test_patch_model.py", "comparators/test_patch_law.py"),
        )
        for stem in ("hunt_crossley_two_stage", "kelvin_voigt", "patch_model")
    ),
    Target("probe/conventions.py", ("probe/test_conventions.py",)),
    Target("probe/text_table.py", ("probe/test_text_table.py",)),
    Target("session/readings.py", ("session/test_readings.py",)),
    Target(
        "session/registration.py",
        ("session/test_registration.py", "session/test_readings.py"),
    ),
    Target("cli/command.py", ("cli/test_command.py",)),
    Target("core/compiled.py", ("core/test_compiled.py",)),
    Target("core/threads.py", ("core/test_threads.py",)),
)


@dataclass(frozen=True)
class Mutant:
    """One change.

    Attributes:
        module: Below ``ttus_opt``.
        line: Its number.
        before: The line as it is.
        after: The line as it would be.
        code: The whole module with the change.
    """

    module: str
    line: int
    before: str
    after: str
    code: str

    def __str__(self) -> str:
        return f"{self.module}:{self.line}: {self.before}  →  {self.after}"

    @property
    def key(self) -> tuple[str, str, str]:
        """What tells it apart when lines have moved."""
        return self.module, self.before, self.after


#: Lines that hold no expression that is computed
QUIET = ("*,", "if TYPE_CHECKING:")


def silent_lines(code: str) -> set[int]:
    """Lines of annotations, signatures' types and decorators: they do nothing.

    Nor do imports for annotations, and a lone ``*`` among parameters is no product.
    """
    lines = code.splitlines()
    silent = {n for n, line in enumerate(lines, 1) if line.strip() in QUIET}
    for node in ast.walk(ast.parse(code)):
        quiet: list[ast.expr] = []
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            quiet = [*node.decorator_list]
            if isinstance(node, ast.FunctionDef):
                arguments = [*node.args.args, *node.args.kwonlyargs]
                quiet += [a.annotation for a in arguments if a.annotation]
                quiet += [node.returns] if node.returns else []
        elif isinstance(node, ast.AnnAssign):
            quiet = [node.annotation]  # and on its line field(repr=False)
        for part in quiet:
            silent |= set(range(part.lineno, (part.end_lineno or part.lineno) + 1))
    return silent


#: Arithmetic that is mistaken for other arithmetic; bit operators on floats only crash.
ARITHMETIC = {"Add", "Sub", "Mul", "Div", "Pow"}

#: Comparisons; `is` for `==` says the same of small numbers.
COMPARISON = {"Eq", "NotEq", "Lt", "LtE", "Gt", "GtE"}

OTHERS = {
    "AddNot",
    "NumberReplacer",
    "ReplaceAndWithOr",
    "ReplaceOrWithAnd",
    "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue",
    "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak",
    "ReplaceUnaryOperator_USub_UAdd",
    "ReplaceUnaryOperator_Delete_Not",
    "ReplaceUnaryOperator_Delete_USub",
    "ZeroIterationForLoop",
}


def operators() -> Iterator[Any]:
    """The changes tried; not those that no test can tell or that cannot run."""
    from cosmic_ray import plugins

    for name in sorted(plugins.operator_names()):
        kind, _, pair = name.partition("/")[2].partition("_")
        both = set(pair.split("_"))
        if (
            (kind == "ReplaceBinaryOperator" and both <= ARITHMETIC)
            or (kind == "ReplaceComparisonOperator" and both <= COMPARISON)
            or name.partition("/")[2] in OTHERS
        ):
            yield plugins.get_operator(name)()


def mutants(module: str, sample: int, seed: int) -> list[Mutant]:
    """A seeded sample of a module's mutants, spread over the places to change.

    Args:
        module: Below ``ttus_opt``.
        sample: Most of them.
        seed: Which.
    """
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.mutating import mutate_code

    code = (ROOT / "ttus_opt" / module).read_text(encoding="utf-8")
    silent, tree = silent_lines(code), get_ast(code)
    nodes = list(ast_nodes(tree))
    places: dict[tuple[int, int], list[tuple[Any, int]]] = {}
    for operator in operators():
        found = (at for node in nodes for at in operator.mutation_positions(node))
        for occurrence, (start, _) in enumerate(found):
            if start[0] not in silent:
                places.setdefault(start, []).append((operator, occurrence))
    rng = random.Random(f"{seed} {module}")
    known, chosen = equivalents(), []
    for start in rng.sample(sorted(places), len(places)):
        if len(chosen) == sample:
            break
        changed = mutate_code(code, *rng.choice(places[start]))
        if changed is None or changed == code:
            continue
        number, before, after = difference(code, changed)
        mutant = Mutant(module, number, before, after, changed)
        if runs(changed) and mutant.key not in known:
            chosen.append(mutant)
    return chosen


def runs(code: str) -> bool:
    """Whether it is Python at all."""
    try:
        ast.parse(code)
    except SyntaxError:
        return False
    return True


def difference(code: str, changed: str) -> tuple[int, str, str]:
    """Number and text of the first line that differs."""
    pairs = zip(code.splitlines(), changed.splitlines(), strict=False)
    for number, (before, after) in enumerate(pairs, 1):
        if before != after:
            return number, before.strip(), after.strip()
    raise ValueError("the mutant has no line that differs")


def equivalents() -> dict[tuple[str, str, str], str]:
    """Mutants that change nothing, and why: ``module | before | after | reason``."""
    known = {}
    for line in EQUIVALENT.read_text(encoding="utf-8").splitlines():
        if line.strip() and not line.startswith("#"):
            module, before, after, reason = (part.strip() for part in line.split(" | "))
            known[module, before, after] = reason
    return known


def outdated() -> list[str]:
    """Lines listed with a mutant that changes nothing, and gone from their module."""
    gone = []
    for module, before, _ in equivalents():
        path = ROOT / "ttus_opt" / module
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        if before not in (line.strip() for line in lines):
            gone.append(f"{module}: {before}")
    return gone


class Copy:
    """A copy of the tree to run tests in, beside a link to the real data."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "checkout"
        self.root.mkdir(parents=True)
        for name in COPIED:
            source, target = ROOT / name, self.root / name
            if source.is_dir():
                ignored = shutil.ignore_patterns("__pycache__")
                shutil.copytree(source, target, ignore=ignored)
            elif source.exists():
                shutil.copy(source, target)
        if (ROOT.parent / "shared").exists():
            (folder / "shared").symlink_to(ROOT.parent / "shared")
        self._seconds = itertools.count(1_000_000_000)
        # what mutants compile does not fill the user's cache, unless it is chosen
        self._cache = os.environ.get("NUMBA_CACHE_DIR") or folder.parent / "cache"

    def told(self, target: Target, limit: float | None = None) -> bool:
        """Whether the tests fail, crash or hang.

        Args:
            target: Which.
            limit: CPU time after which they hang; none for the first run, which is
                then timed (``seconds``) [s].
        """
        environment = {
            "NUMBA_CACHE_DIR": str(self._cache),
            "NUMBA_DISABLE_JIT": str(int(not target.is_compiled)),
        }
        output = self.root.parent / "output.txt"
        arguments = (self.root, target.tests, environment, output, limit)
        child = FORKS.Process(target=run_tests, args=arguments)
        child.start()
        child.join(None if limit is None else WAITS * limit)
        if child.exitcode is None:
            child.kill()
            child.join()
            return True
        if child.exitcode < 0:  # ended by a signal: out of CPU time, or a crash
            return True
        if child.exitcode not in (0, 1, 2):  # not passed, failed nor not imported
            text = output.read_text(encoding="utf-8", errors="replace")
            raise RuntimeError(f"pytest could not run:\n{text[-2000:]}")
        return child.exitcode != 0

    @property
    def seconds(self) -> float:
        """CPU time of the last run that ended by itself [s]."""
        return float((self.root / SECONDS).read_text())

    def tells(self, target: Target, mutant: Mutant, limit: float) -> bool:
        """Whether the tests fail with this change."""
        path = self.root / "ttus_opt" / mutant.module
        original = path.read_text(encoding="utf-8")
        self._write(path, mutant.code)
        try:
            return self.told(target, limit)
        finally:
            self._write(path, original)

    def _write(self, path: Path, code: str) -> None:
        """Write with a time of its own, which tells kept bytecode to be another's."""
        path.write_text(code, encoding="utf-8")
        second = next(self._seconds)
        os.utime(path, (second, second))


#: Processes that begin with `PRELOADED` in memory
FORKS = multiprocessing.get_context("forkserver")


#: Where a run leaves its CPU time, in its checkout
SECONDS = "seconds.txt"


def run_tests(
    root: Path,
    tests: tuple[str, ...],
    environment: dict[str, str],
    output: Path,
    limit: float | None,
) -> None:
    """Run tests in this process, which ends with pytest's exit code.

    Args:
        root: Checkout.
        tests: Files below ``tests``.
        environment: What numba is told.
        output: Where to write what is printed.
        limit: CPU time after which the system ends it [s].
    """
    if limit is not None:
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit) + 5))
    with output.open("w", encoding="utf-8") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.chdir(root)
    os.environ.update(environment)
    sys.dont_write_bytecode = False  # else each run compiles every module again
    import numba
    import pytest

    numba.config.reload_config()
    files = [f"tests/{name}" for name in tests]
    options = ["-x", "-q", "-m", "not slow", "-p", "no:cacheprovider"]
    code = pytest.main([*options, *files])
    Path(SECONDS).write_text(str(time.process_time()), encoding="utf-8")
    sys.exit(code)


def run(targets: list[Target], sample: int, seed: int, workers: int) -> float:
    """Try all mutants and print the table; returns the share told."""
    rows, survivors = [], []
    os.environ["OMP_NUM_THREADS"] = "1"
    FORKS.set_forkserver_preload(list(PRELOADED))
    with tempfile.TemporaryDirectory() as place:
        idle: queue.Queue[Copy] = queue.Queue()
        for n in range(workers):
            idle.put(Copy(Path(place) / str(n)))

        def tells(target: Target, mutant: Mutant, limit: float) -> bool:
            copy = idle.get()
            try:
                return copy.tells(target, mutant, limit)
            finally:
                idle.put(copy)

        for target in targets:
            copy = idle.get()
            if copy.told(target):
                raise SystemExit(f"error: {target.tests} fail without a mutant")
            limit = PATIENCE * copy.seconds + ROOM
            idle.put(copy)
            tried = mutants(target.module, sample, seed)
            with ThreadPoolExecutor(workers) as pool:
                told = list(pool.map(tells, repeat(target), tried, repeat(limit)))
            rows.append((target.module, sum(told), len(tried)))
            print(f"{target.module}: {sum(told)} of {len(tried)} told", flush=True)
            for mutant, is_told in zip(tried, told, strict=True):
                if not is_told:
                    survivors.append(mutant)
                    print(f"  survived: {mutant}", flush=True)
    return report(rows, survivors)


def report(rows: list[tuple[str, int, int]], survivors: list[Mutant]) -> float:
    """Print the share told by module; returns that of all."""
    rows = [*rows, ("all", sum(r[1] for r in rows), sum(r[2] for r in rows))]
    print("\n| module | mutants | told | share |\n|---|---|---|---|")
    for module, told, count in rows:
        print(f"| {module} | {count} | {told} | {told / max(count, 1):.0%} |")
    if survivors:
        print("\nSurvivors:")
        for mutant in survivors:
            print(f"  {mutant}")
    _, told, count = rows[-1]
    return told / max(count, 1)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    names = [target.name for target in TARGETS]
    parser.add_argument("modules", nargs="*", metavar="module", help=", ".join(names))
    parser.add_argument("--sample", type=int, default=20, help="mutants per module")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    given = parser.parse_args()
    for name in given.modules:
        if name not in names:
            parser.error(f"no module {name!r}; there are {', '.join(names)}")
    targets = [t for t in TARGETS if not given.modules or t.name in given.modules]
    for line in outdated():
        print(f"{EQUIVALENT.name} lists a line that is gone: {line}", flush=True)
    share = run(targets, given.sample, given.seed, given.workers)
    if share < LEAST:
        print(f"\n{share:.0%} told, {LEAST:.0%} are asked for")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
