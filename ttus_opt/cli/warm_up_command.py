"""``ttus-opt warm-up``: compile ahead."""

from __future__ import annotations

import typer

from ttus_opt.cli.console import Stages, print_json
from ttus_opt.cli.options import Json


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("warm-up", epilog="Example: ttus-opt warm-up")(warm_up)


def warm_up(json: Json = False) -> None:
    """Compile everything ahead, so that nothing compiles when it is needed."""
    from ttus_opt import compiled
    from ttus_opt import warm_up as ahead

    with Stages(ahead.N_STAGES) as begin:
        seconds = ahead.warm_up(begin)
    told = {"seconds": seconds, "folder": compiled.cache_folder()}
    if json:
        print_json(told)
        return
    kept = f"kept in {told['folder']}" if told["folder"] else "not kept"
    typer.echo(f"compiled in {seconds:.0f} s, {kept}")
