"""``ttus-opt warm-up``: compile ahead."""

from __future__ import annotations

from ttus_opt.cli.console import Stages, tell


def warm_up(json: bool = False) -> None:
    """Compile everything ahead, so that nothing compiles when it is needed.

    Example:
        ttus-opt warm-up
    """
    from ttus_opt import compiled
    from ttus_opt import warm_up as ahead

    with Stages(ahead.N_STAGES) as begin:
        seconds = ahead.warm_up(begin)
    told = {"seconds": seconds, "folder": compiled.cache_folder()}
    kept = f"kept in {told['folder']}" if told["folder"] else "not kept"
    tell(told, f"compiled in {seconds:.0f} s, {kept}", json=json)
