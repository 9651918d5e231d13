"""``ttus-opt example``: files to try every other command on."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ttus_opt.cli.console import Stages, tell


def example(
    folder: Annotated[Path, typer.Argument()],
    force: bool = False,
) -> None:
    """Write scan, probe, recordings and sensor files of a simulated patient to try.

    The commands of the README and of the how-to pages run on these files as they are
    printed; commands.sh has the README's.

    Args:
        folder: Where to write, made when missing.
        force: Replace files of an example that is there already.

    Example:
        ttus-opt example try
    """
    from ttus_opt.session.example_folder import FILES, write_folder

    with Stages(1) as begin:
        begin("making the files")
        write_folder(folder, force=force)
    width = max(map(len, FILES))
    lines = [f"{name:{width}}  {about}" for name, about in FILES.items()]
    last = f"\ncd {folder}, then sh commands.sh, or one command after the other"
    tell({"folder": str(folder), "files": FILES}, *lines, last)
