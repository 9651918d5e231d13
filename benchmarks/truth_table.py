"""The table and the picture of `truth.py`: where the default wins and loses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

#: Wins and losses are differences of more than this [–]
CLEAR = 1.05

#: Colour and size of a dot, by group
STYLE = {
    "formulation": ("C0", 14),
    "comparator": ("C1", 14),
    "rival": ("C2", 14),
    "default": ("k", 60),
}

Row = dict[str, Any]


def errors(results: Mapping[str, Mapping[str, Row]]) -> dict[str, dict[str, float]]:
    """Error [N] by recording ("case recording") and model."""
    out: dict[str, dict[str, float]] = {}
    for case, rows in results.items():
        for model, row in rows.items():
            for name, score in row["scores"].items():
                out.setdefault(f"{case} {name}", {})[model] = score["error_N"]
    return out


def against(found: Mapping[str, Mapping[str, float]]) -> dict[str, Row]:
    """By rival: mean ratio default / rival, clear wins and losses by recording.

    "best" is the best rival of each recording.
    """
    judged = {name: dict(own) for name, own in found.items() if "default" in own}
    for own in judged.values():
        others = [value for model, value in own.items() if model != "default"]
        own |= {"best": min(others)} if others else {}
    out: dict[str, Row] = {}
    for model in dict.fromkeys(m for own in judged.values() for m in own):
        ratio = {
            n: own["default"] / own[model] for n, own in judged.items() if model in own
        }
        if model != "default":
            out[model] = {
                "mean_ratio": float(np.exp(np.mean(np.log(list(ratio.values()))))),
                "loses": {n: r for n, r in ratio.items() if r > CLEAR},
                "wins": {n: r for n, r in ratio.items() if r < 1.0 / CLEAR},
                "recordings": len(ratio),
            }
    return out


def table(results: Mapping[str, Mapping[str, Row]]) -> str:
    """Markdown: a line per model, and where the default wins and loses clearly."""
    found = errors(results)
    least, summary = {n: min(own.values()) for n, own in found.items()}, against(found)
    head = ["model", "default / it", "loses", "wins"]
    for case, rows in results.items():
        names = max((list(row["scores"]) for row in rows.values()), key=len)
        head.append(case + f": {' / '.join(names)}" * (names != ["tissue"]))
    lines = [head, ["---"] * len(head)]
    for model in dict.fromkeys(model for rows in results.values() for model in rows):
        line = [f"`{model}`", *_beside(summary.get(model))]
        for case, rows in results.items():
            scores = {n: s["error_N"] for n, s in rows[model]["scores"].items()}
            cells = (
                f"**{e:.3f}**" if e == least[f"{case} {n}"] else f"{e:.3f}"
                for n, e in scores.items()
            )
            line.append(" / ".join(cells) or "–")
        lines.append(line)
    text = [f"| {' | '.join(line)} |" for line in lines]
    if "best" in summary:
        text += ["", *_where(results, found, summary["best"])]
    notes = {(m, r["note"]) for own in results.values() for m, r in own.items()}
    told = [f"- `{model}`: {note}" for model, note in sorted(notes) if note]
    return "\n".join([*text, *[""][: len(told)], *told])


def _beside(own: Row | None) -> list[str]:
    """Mean ratio, clear losses and wins; dashes for the default itself."""
    if own is None:
        return ["–"] * 3
    return [f"{own['mean_ratio']:.2f}", str(len(own["loses"])), str(len(own["wins"]))]


def standard_error(one: Row, other: Row) -> float:
    """Of the difference of two models' mean errors, over the stretches of a recording.

    The frames of a stretch count as one sample (W. G. Cochran, Sampling Techniques,
    1977, eq. 6.13, of a ratio).

    Args:
        one: Scores of a model on the recording.
        other: Those of the other.

    Returns:
        [N]; NaN for a single stretch.
    """
    frames = np.array(one["frames_of_stretches"], dtype=float)
    off = np.subtract(one["errors_of_stretches_N"], other["errors_of_stretches_N"])
    left = off - off.sum() / frames.sum() * frames
    k = len(frames)
    if k < 2:
        return float("nan")
    return float(np.sqrt(k / (k - 1) * (left @ left)) / frames.sum())


def _where(
    results: Mapping[str, Mapping[str, Row]],
    found: Mapping[str, Mapping[str, float]],
    best: Row,
) -> list[str]:
    """Recordings on which the default loses to the best rival, or wins."""
    lines = [
        f"Over the best rival of each of {best['recordings']} recordings: "
        f"{best['mean_ratio']:.2f} in the geometric mean."
    ]
    for word in ("loses", "wins"):
        told = []
        for name, ratio in best[word].items():
            rivals = {m: e for m, e in found[name].items() if m != "default"}
            model = min(rivals, key=rivals.__getitem__)
            case, _, recording = name.rpartition(" ")
            scores = (results[case][m]["scores"][recording] for m in ("default", model))
            told.append(
                f"- {name}: {found[name]['default']:.3f} N, `{model}` "
                f"{rivals[model]:.3f} N (× {ratio:.2f}, "
                f"± {standard_error(*scores):.3f} N)"
            )
        head = f"The default {word} by more than 5 % on {len(told)}"
        lines += ["", f"{head} (± the standard error of the difference):", "", *told]
    return lines


def picture(found: Mapping[str, Mapping[str, float]]) -> Any:
    """A row per recording, a dot per model."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 1.0 + 0.24 * len(found)), layout="constrained")
    axes = figure.subplots()
    groups = {"c:": "comparator", "r:": "rival", "": "formulation"}
    dots: dict[str, list[tuple[float, int]]] = {name: [] for name in STYLE}
    for place, own in enumerate(found.values()):
        for model, value in own.items():
            group = next(g for start, g in groups.items() if model.startswith(start))
            dots["default" if model == "default" else group].append((value, place))
    for group, (colour, size) in STYLE.items():
        x, y = np.array(dots[group]).reshape(-1, 2).T
        axes.scatter(x, y, size, colour, alpha=0.7, linewidths=0, label=group)
    axes.set_xscale("log")
    axes.set_xlabel("mean error of the force's magnitude on unseen frames [N]")
    axes.set_yticks(range(len(found)), list(found))
    axes.invert_yaxis()
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    return figure
