"""Mutants of core modules: which small mistakes would the matching tests notice?

`make mutants` changes one thing in one module at a time (an operator, a number, a
condition: cosmic-ray's operators), runs the tests of the same stem and counts who told.
It works on a copy; the tree is never touched. Compiled functions run as plain Python
where that is fast enough, else each mutant compiles what it reaches and nothing else.

    python tests/mutants.py                     core modules, a sample of each
    python tests/mutants.py metrics scan        some modules, or all that a room tests
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
    def name(self):
        """As it is chosen on the command line."""
        return Path(self.module).stem


#: Modules that are tried without being named, by room
CORE = {
    "cli": "command",
    "comparators": "contact_geometry ellipsoid_torso patch_law patch_model "
    "perceptual_updates proxy_six_dof stiffness_map voxmap_point_shell",
    "contact": "boundary_scale friction point_drag row_kernels rows "
    "shell_blocks slip standing",
    "core": "compiled threads",
    "fitting": "batch verdict",
    "fitting/checks": "sanity",
    "fitting/parameters": "parabola",
    "fitting/path": "weight_grid",
    "fitting/poses": "pose_error_step pose_refinement",
    "fitting/recursion": "dual_recursion low_rank_kernel measured_rows recursive",
    "fitting/uncertainty": "contact_spread posterior skin_uncertainty wrench_noise",
    "fitting/weights": "place_left_out tuning_rows",
    "gaussian": "matern",
    "haptic": "blend kernel_data motion point_drag renderer tables",
    "laplace": "stencil system",
    "probe": "conventions orientation point_shell text_table tracker_noise",
    "problem/terms": "depth_map depth_map_estimate depth_profile distinct_drag "
    "departures drag_estimate penalties wrench",
    "problem/verify": "kkt relative_residuals",
    "report": "metrics",
    "scan": "contour_filter",
    "session": "readings registration",
    "solvers": "conjugate_gradients structured verified",
    "solvers/dual": "active_set field_pair limits linear_parameters optimality "
    "pair_subproblem soft_values solver subproblem touched_limits weight_sweep "
    "working_set",
    "solvers/primal": "elimination",
}

PATCH = ("comparators/test_patch_model.py", "comparators/test_patch_law.py")

#: What else than the tests of their stem is meant to tell
FURTHER = {
    "comparators/patch_law.py": PATCH[:1],
    "comparators/patch_model.py": PATCH[1:],
    "contact/row_kernels.py": (
        "contact/test_rows.py",
        "contact/test_contact_size.py",
        "contact/test_friction.py",
        "voxmap/test_grid.py",
    ),
    "contact/rows.py": ("contact/test_contact_size.py",),
    "contact/slip.py": ("contact/test_point_drag.py",),
    "fitting/batch.py": ("fitting/weights/test_tuning.py",),
    "fitting/recursion/measured_rows.py": ("fitting/recursion/test_dual_recursion.py",),
    "fitting/verdict.py": ("fitting/test_batch.py",),
    "haptic/blend.py": ("haptic/test_surface_swap.py",),
    "haptic/motion.py": ("haptic/test_blend.py",),
    "haptic/kernel_data.py": ("haptic/test_frame.py", "haptic/test_wrench.py"),
    "haptic/point_drag.py": ("haptic/test_drag.py", "haptic/test_wrench.py"),
    "laplace/stencil.py": ("laplace/test_system.py",),
    "laplace/system.py": ("laplace/test_stencil.py",),
    "problem/members.py": ("problem/verify/test_kkt.py",),
    "problem/terms/depth_profile.py": ("problem/terms/test_depth_map_estimate.py",),
    "problem/terms/drag_estimate.py": ("problem/terms/test_distinct_drag.py",),
    "problem/verify/kkt.py": ("problem/verify/test_absorption.py",),
    "problem/verify/relative_residuals.py": ("problem/verify/test_kkt.py",),
    "session/registration.py": ("session/test_readings.py",),
    "solvers/dual/active_set.py": ("solvers/dual/test_primal_dual_active_set.py",),
    "solvers/dual/field_pair.py": ("solvers/dual/test_touched_limits.py",),
    "solvers/dual/optimality.py": ("solvers/dual/test_primal_dual_active_set.py",),
    "solvers/dual/soft_values.py": ("solvers/dual/test_preconditioner.py",),
    "solvers/dual/subproblem.py": (
        "solvers/dual/test_active_set.py",
        "solvers/dual/test_soft_values.py",
    ),
}

#: Compiled functions that run as plain Python, where that is fast enough
PLAIN = ("fitting/recursion/low_rank_kernel.py",)


def targets():
    """Every module that has tests, of its stem or as `FURTHER` says."""
    tests = ROOT / "tests"
    for path in sorted((ROOT / "ttus_opt").rglob("*.py")):
        module = path.relative_to(ROOT / "ttus_opt")
        room, stem = tests / module.parent, module.stem
        own = [room / f"test_{stem}.py", *room.glob(f"test_{stem}_*.py")]
        # test_blend_step.py tests blend, if there is no module blend_step
        named = [
            test.relative_to(tests).as_posix()
            for test in sorted(own)
            if test.is_file()
            and (test is own[0] or not (path.parent / test.name[5:]).is_file())
        ]
        every = (*named, *FURTHER.get(module.as_posix(), ()))
        if every:
            yield Target(module.as_posix(), every, module.as_posix() not in PLAIN)


def chosen(given):
    """Targets by name, path or room; `CORE` if none is given.

    Raises:
        ValueError: No module is called so.
    """
    known, taken = list(targets()), list[Target]()
    for name in given or [f"{room}/{s}" for room in CORE for s in CORE[room].split()]:
        found = [
            t
            for t in known
            if name in (t.name, t.module, t.module.removesuffix(".py"))
            or t.module.startswith(f"{name}/")
        ]
        if not found:
            raise ValueError(f"no module or room {name!r} with tests of its own")
        taken += [t for t in found if t not in taken]
    return taken


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

    def __str__(self):
        return f"{self.module}:{self.line}: {self.before}  →  {self.after}"

    @property
    def key(self):
        """What tells it apart when lines have moved."""
        return self.module, self.before, self.after


#: Lines that hold no expression that is computed
QUIET = ("*,", "if TYPE_CHECKING:")


def silent_lines(code):
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


def operators():
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


def mutants(module, sample, seed):
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


def runs(code):
    """Whether it is Python at all."""
    try:
        ast.parse(code)
    except SyntaxError:
        return False
    return True


def difference(code, changed):
    """Number and text of the first line that differs."""
    pairs = zip(code.splitlines(), changed.splitlines(), strict=False)
    for number, (before, after) in enumerate(pairs, 1):
        if before != after:
            return number, before.strip(), after.strip()
    raise ValueError("the mutant has no line that differs")


def equivalents():
    """Mutants that change nothing, and why: ``module | before | after | reason``."""
    known = {}
    for line in EQUIVALENT.read_text(encoding="utf-8").splitlines():
        if line.strip() and not line.startswith("#"):
            module, before, after, reason = (part.strip() for part in line.split(" | "))
            known[module, before, after] = reason
    return known


def outdated():
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

    def __init__(self, folder):
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

    def told(self, target, limit=None):
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
    def seconds(self):
        """CPU time of the last run that ended by itself [s]."""
        return float((self.root / SECONDS).read_text())

    def tells(self, target, mutant, limit):
        """Whether the tests fail with this change."""
        path = self.root / "ttus_opt" / mutant.module
        original = path.read_text(encoding="utf-8")
        self._write(path, mutant.code)
        try:
            return self.told(target, limit)
        finally:
            self._write(path, original)

    def _write(self, path, code):
        """Write with a time of its own, which tells kept bytecode to be another's."""
        path.write_text(code, encoding="utf-8")
        second = next(self._seconds)
        os.utime(path, (second, second))


#: Processes that begin with `PRELOADED` in memory
FORKS = multiprocessing.get_context("forkserver")


#: Where a run leaves its CPU time, in its checkout
SECONDS = "seconds.txt"


def run_tests(root, tests, environment, output, limit):
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


def run(targets, sample, seed, workers):
    """Try all mutants and print the table; returns the share told."""
    rows, survivors = [], []
    os.environ["OMP_NUM_THREADS"] = "1"
    FORKS.set_forkserver_preload(list(PRELOADED))
    with tempfile.TemporaryDirectory() as place:
        idle: queue.Queue[Copy] = queue.Queue()
        for n in range(workers):
            idle.put(Copy(Path(place) / str(n)))

        def tells(target, mutant, limit):
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


def report(rows, survivors):
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


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("modules", nargs="*", metavar="module", help="name or room")
    parser.add_argument("--sample", type=int, default=20, help="mutants per module")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    given = parser.parse_args()
    try:
        tried = chosen(given.modules)
    except ValueError as error:
        parser.error(str(error))
    for line in outdated():
        print(f"{EQUIVALENT.name} lists a line that is gone: {line}", flush=True)
    share = run(tried, given.sample, given.seed, given.workers)
    if share < LEAST:
        print(f"\n{share:.0%} told, {LEAST:.0%} are asked for")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
