"""A plain function as a command: options by its signature, words by its docstring.

A parameter is the option of its name, and a truth value a flag, unless an `Annotated`
with typer's own words says otherwise. What an option does stands under ``Args:``, how
the command is called under ``Example:``. A parameter that is a group, a frozen
dataclass, has the group's options in its place, described under ``Attributes:``.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import inspect
import os
import re
import textwrap
import typing
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from ttus_opt.cli.console import know_options, speaking
from ttus_opt.cli.standard_streams import standard_streams
from ttus_opt.cli.time_limit import interrupts_unwrapped, time_limited
from ttus_opt.core import io
from ttus_opt.core.errors import FileError, InputError, MistakeWarning

#: Options that say the same in every command
COMMON = {
    "force": "Allow an output to replace one of the inputs.",
    "json": "Print JSON on stdout, for other programs.",
    "verbose": "Say on stderr what is read, chosen and solved; -vv says more.",
    "quiet": "Show no bars; warnings and errors remain.",
    "time_limit": "Time limit of the command [s]; what is complete by then is kept.",
    "repair": "Drop missing and repeated rows, sort, split at gaps and jumps, and say "
    "so.",
    "together": "Both recordings began at about the same time.",
    "largest_offset": "Largest offset to search [s].",
    "base_to_scan": "Rigid motion from base to scan [m]: a 4x4 matrix in a text, CSV, "
    "JSON or NPY file, or seven numbers.",
    "surface": "Surface file (.nc).",
    "field": "Field file (.nc).",
    "prior": "Factor by which the first model is too stiff.",
    "seconds": "Length of the session [s].",
    "port": "Where to serve on this machine; the next free one if it is taken.",
    "no_browser": "Print the link only.",
    "strict": "End with an error where a mistake in what was given is likely, instead "
    "of a warning.",
}


KEYWORD = inspect.Parameter.KEYWORD_ONLY

#: Options that every command has, with their defaults
EVERYWHERE: dict[str, tuple[Any, Any]] = {
    "json": (bool, False),
    "verbose": (
        Annotated[int, typer.Option("-v", "--verbose", count=True, show_default=False)],
        0,
    ),
    "quiet": (Annotated[bool, typer.Option("-q", "--quiet")], False),
}


class _Command(TyperCommand):
    """A command that names all that is missing, and heeds options given before it."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse, after a look at what is missing."""
        long = {p.name: [o for o in p.opts if o[:2] == "--"] for p in self.params}
        know_options({name: opts[0] for name, opts in long.items() if name and opts})
        if not ctx.resilient_parsing and not {*args} & {*ctx.help_option_names}:
            given = self.make_parser(ctx).parse_args(args=list(args))[0]
            needed = (p for p in self.get_params(ctx) if p.required)
            missing = [p for p in needed if given.get(p.name) in (None, (), [])]
            if missing:
                names = ", ".join("/".join(p.opts) for p in missing)
                raise InputError(f"missing: {names}: see {ctx.command_path} --help")
        rest = list(super().parse_args(ctx, args))
        before = ctx.find_root().params  # ttus-opt -v surface, too
        for name in ("verbose", "quiet"):
            if name in ctx.params and name in before:
                ctx.params[name] += before[name]
        return rest


def add_command(
    app: typer.Typer,
    function: Callable[..., None],
    *,
    judges: bool = False,
    time_limit: float | None = None,
    folder: bool = False,
    written: Sequence[str] = (),
) -> None:
    """Make a function a command of its name.

    That each output can be written, and replaces no input, is checked before it runs:
    of --output, of pictures, and of ``written``. With an input there is --force.

    Args:
        app: Gets the command.
        function: What it does. Its parameters are options and groups of options.
        judges: Whether it warns of likely mistakes; it then has the option --strict.
        time_limit: Default of its option --time-limit [s]; None for no limit.
        folder: Whether its output is a folder.
        written: Options of files that it writes beside --output and pictures.
    """
    signature = inspect.signature(function, eval_str=True)
    about, words, example = _words(function)
    groups: dict[str, Any] = {}
    parameters: list[inspect.Parameter] = []
    for name, parameter in signature.parameters.items():
        if dataclasses.is_dataclass(parameter.annotation):
            groups[name] = parameter.annotation
            parameters += _of_group(groups[name])
        else:
            parameters.append(_option(name, parameter.annotation, parameter, words))
    outputs = [
        name
        for name in (p.name for p in parameters)
        if "picture" in name or name in ("output", *written)
    ]
    if folder:
        outputs.clear()
    reads = (p for p in parameters if p.name not in outputs and _paths(p.annotation))
    forced = bool(outputs) and any(reads) and "force" not in signature.parameters
    own_limit = "time_limit" in signature.parameters
    limited_here = time_limit is not None and not own_limit
    added: dict[str, tuple[Any, Any]] = {
        **({"force": (bool, False)} if forced else {}),
        **({"strict": (bool, False)} if judges else {}),
        **({"time_limit": (float, time_limit)} if limited_here else {}),
        **EVERYWHERE,
    }
    for name, (kind, default) in added.items():
        parameter = inspect.Parameter(name, KEYWORD, default=default)
        parameters.append(_option(name, kind, parameter, words))

    @functools.wraps(function)
    def run(**given: Any) -> None:
        json, verbose, quiet = (given.pop(name) for name in EVERYWHERE)
        with (
            speaking(verbose, quiet=quiet, json=json),
            standard_streams(given, folder=folder, written=written, json=json),
        ):
            _check_outputs(
                given, outputs, force=given.pop("force") if forced else False
            )
            _grouped(given, groups)
            limit = None
            if time_limit is not None:
                limit = given["time_limit"] if own_limit else given.pop("time_limit")
            with (
                warnings.catch_warnings(),
                time_limited(limit),
                interrupts_unwrapped(),
            ):
                if judges and given.pop("strict"):
                    warnings.simplefilter("error", MistakeWarning)
                function(**given)

    own = signature.replace(parameters=parameters)
    run.__signature__ = own  # type: ignore[attr-defined]  # typer's way
    name = function.__name__.replace("_", "-")
    epilog = f"Example: {example}"
    app.command(name, cls=_Command, help=about, epilog=epilog)(run)


def _paths(annotation: Any) -> bool:
    """Whether an option is a file or several."""
    return annotation is Path or any(map(_paths, typing.get_args(annotation)))


def _check_outputs(
    given: Mapping[str, Any], names: Sequence[str], *, force: bool
) -> None:
    """Check every output before work begins.

    Args:
        given: All options by name.
        names: Those of files that will be written, or pictures.
        force: Allow an output to replace an input.
    """
    outputs = {name: given[name] for name in names if given[name] is not None}
    for name, file in outputs.items():
        if "picture" in name:
            from ttus_opt.report.plots.canvas import require_picture_suffix

            require_picture_suffix(file)
    inputs = [
        value
        for name, values in given.items()
        if name not in names
        for value in (values if isinstance(values, list) else [values])
        if isinstance(value, str | Path) and os.path.isfile(value)
    ]
    files = list(outputs.values())
    for file in files:
        io.check_output(file, inputs=inputs, force=force)
    if len(set(map(os.path.realpath, files))) < len(files):
        raise FileError(f"{files[0]} is given for two outputs: give two names")


def _grouped(given: dict[str, Any], groups: dict[str, Any]) -> None:
    """Put options that belong to a group into one, in place."""
    for name, group in groups.items():
        own = {f.name: given.pop(f.name) for f in dataclasses.fields(group)}
        given[name] = group(**own)


def _of_group(group: Any) -> list[inspect.Parameter]:
    """A group's fields as parameters of a command."""
    hints = typing.get_type_hints(group, include_extras=True)
    words: dict[str, str] = {}
    for kind in reversed(group.__mro__[:-1]):
        words |= _words(kind)[1]
    return [
        _option(name, hints[name], parameter, words)
        for name, parameter in inspect.signature(group).parameters.items()
    ]


def _option(
    name: str, annotation: Any, parameter: inspect.Parameter, words: dict[str, str]
) -> inspect.Parameter:
    """A parameter as typer takes it."""
    if annotation is not typer.Context:
        kind, option = annotation, typer.Option()
        if typing.get_origin(annotation) is Annotated:
            kind, option = typing.get_args(annotation)
        elif kind is bool:
            option = typer.Option(f"--{name.replace('_', '-')}")  # and no --no-…
        elif name == "output":
            option = typer.Option("-o", "--output")
        option = copy.copy(option)
        option.help = words.get(name)
        annotation = Annotated[kind, option]
    return parameter.replace(kind=KEYWORD, annotation=annotation)


def _words(documented: object) -> tuple[str, dict[str, str], str]:
    """Description, descriptions of the parameters by name, and an example call."""
    about, *rest = re.split(
        r"\n\n(?=(?:Args|Attributes|Example):\n)", inspect.getdoc(documented) or ""
    )
    sections = {}
    for section in rest:
        title, _, text = section.partition(":\n")
        sections[title] = textwrap.dedent(text)
    listed = sections.get("Args", "") + sections.get("Attributes", "")
    entries = (entry.partition(":") for entry in re.split(r"\n(?=\S)", listed))
    words = {name: " ".join(text.split()) for name, _, text in entries}
    return about, COMMON | words, " ".join(sections.get("Example", "").split())
