"""Groups of options that several commands share, declared once.

A group is a frozen dataclass whose fields are annotated as a command's parameters are.
A command that takes a group as a parameter has the group's options in its place.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import typing
from collections.abc import Callable
from typing import Any


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose parameters that are dataclasses become their fields' options.

    Args:
        command: A function as typer takes it, but for such parameters.

    Returns:
        The function that typer takes; it puts groups together and calls ``command``.
    """
    signature = inspect.signature(command, eval_str=True)
    groups: dict[str, Any] = {
        name: parameter.annotation
        for name, parameter in signature.parameters.items()
        if dataclasses.is_dataclass(parameter.annotation)
    }
    parameters: list[inspect.Parameter] = []
    for name, parameter in signature.parameters.items():
        if name in groups:
            parameters += _options(groups[name])
        else:
            parameters.append(parameter.replace(kind=parameter.KEYWORD_ONLY))

    @functools.wraps(command)
    def run(**given: Any) -> None:
        for name, group in groups.items():
            own = {f.name: given.pop(f.name) for f in dataclasses.fields(group)}
            given[name] = group(**own)
        command(**given)

    run.__signature__ = signature.replace(  # type: ignore[attr-defined]  # typer's way
        parameters=parameters
    )
    return run


def _options(group: Any) -> list[inspect.Parameter]:
    """A group's fields as a command's parameters."""
    hints = typing.get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            annotation=hints[field.name],
            default=(
                inspect.Parameter.empty
                if field.default is dataclasses.MISSING
                else field.default
            ),
        )
        for field in dataclasses.fields(group)
    ]
