"""Make the stored outputs of notebooks small: `make notebooks` calls it after a run.

Pictures get a palette of 128 colours. Times of execution and the version of Python,
which differ from run to run, go.
"""

from __future__ import annotations

import base64
import io
import json
import sys
from pathlib import Path
from typing import Any

from PIL import Image

N_COLOURS = 128  # bars of colour stay smooth; a third of the bytes
MOST_BYTES = 300_000  # of one notebook, so that a web view shows it


def smaller_png(encoded: str) -> str:
    """The same picture with a palette, in base64."""
    picture = Image.open(io.BytesIO(base64.b64decode(encoded))).convert("RGB")
    out = io.BytesIO()
    picture.quantize(N_COLOURS, dither=Image.Dither.NONE).save(
        out, "png", optimize=True
    )
    return base64.b64encode(out.getvalue()).decode()


def shrink(notebook: dict[str, Any]) -> None:
    """Shrink the outputs in place."""
    notebook["metadata"]["language_info"] = {"name": "python"}
    for cell in notebook["cells"]:
        cell["metadata"].pop("execution", None)
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                data["image/png"] = smaller_png("".join(data["image/png"]))


def main(folder: Path) -> int:
    """Shrink every notebook of a folder; exit code 1 where one stays too large."""
    too_large = []
    for path in sorted(folder.glob("*.ipynb")):
        notebook = json.loads(path.read_text(encoding="utf-8"))
        shrink(notebook)
        text = json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
        path.write_text(text, encoding="utf-8")
        n_bytes = len(text.encode())
        print(f"{path.name}: {n_bytes / 1000:.0f} kB")
        if n_bytes > MOST_BYTES:
            too_large.append(path.name)
    if too_large:
        print(f"error: over {MOST_BYTES / 1000:.0f} kB: {', '.join(too_large)}")
    return int(bool(too_large))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
