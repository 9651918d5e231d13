"""``ttus-opt warm-up``: compile ahead."""

from __future__ import annotations

from ttus_opt.cli.console import Stages, tell


def warm_up(json: bool = False) -> None:
    """Compile everything ahead of its first use.

    Example:
        ttus-opt warm-up
    """
    from ttus_opt.cli import warm_up as ahead
    from ttus_opt.core.cache_folder import cache_folder

    with Stages(ahead.N_STAGES) as begin:
        seconds = ahead.warm_up(begin)
    folder = cache_folder()
    facts = {"seconds": seconds, "folder": None if folder is None else str(folder)}
    kept = "not kept" if folder is None else f"kept in {folder}"
    tell(facts, f"compiled in {seconds:.0f} s, {kept}", json=json)
