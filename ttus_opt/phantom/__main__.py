"""Generate the bundled example: ``python -m ttus_opt.phantom``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from tqdm import tqdm

from ttus_opt.core.errors import TtusError
from ttus_opt.phantom.elasticity import SkinPatch, skin_compliance
from ttus_opt.phantom.example_data import (
    RECORDINGS,
    TORSO,
    poses,
    write_example,
    write_skin,
)
from ttus_opt.phantom.torso import torso_body

FOLDER = Path(__file__).parents[1] / "example"


def main(
    folder: Annotated[
        Path,
        typer.Option(help="Where to write the files.", show_default="ttus_opt/example"),
    ] = FOLDER,
    compliance: Annotated[
        Path | None,
        typer.Option(help="Store the skin's compliance here (.npz), or reuse it."),
    ] = None,
) -> None:
    """Simulate the torso, press the probe into it and write the example's files.

    Example: python -m ttus_opt.phantom --folder example --compliance skin.npz
    """
    try:
        patch = _patch(compliance)
        n_poses = sum(len(poses(name)) for name in RECORDINGS)
        with tqdm(total=n_poses, desc="poses", unit="pose") as bar:

            def pressed() -> None:
                bar.update()

            write_example(folder, patch, pressed)
        write_skin(folder / "skin.npz")
    except TtusError as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(2) from error
    typer.echo(f"example written to {folder}")


def _patch(stored: Path | None) -> SkinPatch:
    """The skin's compliance, read from the file if it exists, else computed."""
    if stored is not None and stored.exists():
        return SkinPatch.load(stored)
    body = torso_body(TORSO)
    with tqdm(total=len(body.patch), desc="compliance", unit="node") as bar:

        def solved(done: int, _: int) -> None:
            bar.update(done - bar.n)

        patch = skin_compliance(body, solved)
    if stored is not None:
        patch.save(stored)
    return patch


if __name__ == "__main__":
    typer.run(main)
