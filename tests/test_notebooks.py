"""The notebooks' form; `make notebooks` runs them."""

import ast
import json
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
EXPECTED = [
    "01_scan_to_field_to_force",
    "02_regularisers",
    "03_solvers",
    "04_friction",
    "05_own_term_and_formulation",
    "06_from_sensors",
    "07_live",
]

#: A path of one machine: /home/…, C:\…, file://…
ABSOLUTE = re.compile(r"(?<![\w.)/])/(?:[\w.-]+/)+[\w.-]*|\b[A-Z]:\\\\|file://")

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def cells(path, kind):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    return [cell for cell in notebook["cells"] if cell["cell_type"] == kind]


def source(cell):
    return "".join(cell["source"])


def outputs(notebook_cells):
    """What the cells show, by media type."""
    shown = (output for cell in notebook_cells for output in cell.get("outputs", []))
    return [output["data"] for output in shown if "data" in output]


def python(cell):
    """The cell without the notebook's own % lines."""
    lines = source(cell).splitlines()
    return ast.parse("\n".join(line for line in lines if not line.startswith("%")))


def numbers(tree):
    values = (n.value for n in ast.walk(tree) if isinstance(n, ast.Constant))
    return [v for v in values if isinstance(v, (int, float))]


def test_all_are_there():
    assert [path.stem for path in NOTEBOOKS] == EXPECTED


@every_notebook
def test_outputs_are_of_one_run_from_the_top(path):
    code = cells(path, "code")
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    assert any("image/png" in data for data in outputs(code))


@every_notebook
def test_a_web_view_shows_it(path):
    assert path.stat().st_size <= 300_000  # [B]


@every_notebook
def test_outputs_say_nothing_of_the_run(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert notebook["metadata"]["language_info"] == {"name": "python"}
    assert all("execution" not in cell["metadata"] for cell in notebook["cells"])


@every_notebook
def test_no_path_of_a_machine_is_stored(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    for data in outputs(notebook["cells"]):
        data.pop("image/png", None)  # base64 has slashes
    assert ABSOLUTE.findall(json.dumps(notebook, ensure_ascii=False)) == []


@pytest.mark.parametrize(
    "text", ["'/home/me/scan.ply'", '"C:\\\\scan.ply"', "file://x"]
)
def test_such_a_path_would_be_seen(text):
    assert ABSOLUTE.search(text)


@every_notebook
def test_it_begins_with_a_title(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    first = notebook["cells"][0]
    assert first["cell_type"] == "markdown"
    assert source(first).startswith("# ")


@every_notebook
def test_the_first_code_cell_only_imports(path):
    body = python(cells(path, "code")[0]).body
    assert body
    assert all(isinstance(node, (ast.Import, ast.ImportFrom)) for node in body)


@every_notebook
def test_every_name_imported_from_the_package_exists(path):
    for node in python(cells(path, "code")[0]).body:
        if isinstance(node, ast.ImportFrom) and node.module.startswith("ttus_opt"):
            exec(ast.unparse(node), {})  # an ImportError names what went


@every_notebook
def test_nothing_is_imported_later(path):
    for cell in cells(path, "code")[1:]:
        nodes = ast.walk(python(cell))
        assert not [n for n in nodes if isinstance(n, (ast.Import, ast.ImportFrom))]


@every_notebook
def test_it_ends_by_checking_a_number(path):
    last = python(cells(path, "code")[-1]).body[-1]
    assert isinstance(last, ast.Assert)
    assert any(isinstance(node, ast.Compare) for node in ast.walk(last.test))
    assert numbers(last.test)
