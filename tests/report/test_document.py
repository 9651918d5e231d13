import base64

import matplotlib.image
import pytest
from markdown_it import MarkdownIt

from ttus_opt.report.document import (
    Heading,
    Items,
    Picture,
    Table,
    Text,
    text,
    write_report,
)
from ttus_opt.report.plots.canvas import new_figure


def test_both_forms_hold_the_same_and_the_page_its_pictures(tmp_path):
    (tmp_path / "figures").mkdir()
    data = b"\x89PNG not really"
    (tmp_path / "figures" / "a.png").write_bytes(data)
    blocks = [
        Heading("Errors & aims", 1),
        Text("A **bold** word, *this* and `code` < 3: [see](a.csv)"),
        Items(["one", "two **b**"]),
        Table(["", "N"], [["press", "**0.3**"]]),
        Picture("figures/a.png", "a caption"),
    ]
    assert write_report(tmp_path, blocks) == tmp_path / "report.md"
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    plain = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert plain.startswith("# Errors & aims\n\nA **bold**")
    assert "![a caption](figures/a.png)" in plain
    assert "| press | **0.3** |" in plain
    assert "<h1>Errors &amp; aims</h1>" in page
    assert (
        "A <strong>bold</strong> word, <em>this</em> and <code>code</code> &lt; 3"
        in page
    )
    assert '<a href="a.csv">see</a>' in page and "<title>Errors &amp; aims<" in page
    assert "<td><strong>0.3</strong></td>" in page
    assert "<li>two <strong>b</strong></li>" in page
    assert base64.b64encode(data).decode() in page
    assert "figures/a.png" not in page  # self-contained


def test_names_of_files_change_no_structure_and_load_nothing(tmp_path):
    """A cell stays what it is whatever it is called, as HTML a line, a heading too."""
    odd = ["a|b", "# c", "- d", "1. e", "f\ng", "<script>h", "![i](http://j/k.png)"]
    blocks = [Heading("1. e", 1), Items(odd), Table(odd, [odd]), *map(Text, odd)]
    write_report(tmp_path, blocks)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for tag, count in {"h1": 1, "li": 7, "th": 7, "td": 7, "p": 7, "ul": 1}.items():
        assert page.count(f"<{tag}>") == page.count(f"</{tag}>") == count, tag
    assert "<script" not in page and "<img" not in page and "<ol>" not in page
    page = MarkdownIt("commonmark").enable("table").render(str(blocks[2]))
    assert page.count("<th>") == page.count("<td>") == 7
    assert "<td>a|b</td>" in page and "<td>f g</td>" in page


def test_markdown_of_a_list():
    assert str(Items(["a", "b"])) == "- a\n- b"


@pytest.mark.parametrize("width", [24, 20, 17])
def test_a_table_of_many_columns_fits_where_its_words_do(width):
    """Two blanks between columns, one, and short cells broken."""
    told = Table(["a", "b", "c"], [["0, 0, 0", "seven 7", "eight 8"]]).fitted(width)
    assert max(map(len, told.splitlines())) <= width
    assert told.count("0") == 3 and told.count("eight") == 1


def test_columns_without_room_follow_below():
    """Each once, after the first column, and all that is in it."""
    names = [f"measure{k:02d}" for k in range(14)]
    rows = [[f"recording{i}", *(f"{i}.{k:02d}" for k in range(14))] for i in range(2)]
    told = Table(["of", *names], rows).fitted(80)
    assert max(map(len, told.splitlines())) <= 80
    assert all(told.count(name) == 1 for name in names)
    assert all(told.count(cell) == 1 for row in rows for cell in row[1:])
    assert told.count("recording1") == told.count("\n\n") + 1 == 2


def test_a_terminal_gets_what_fits():
    words = " ".join(["word"] * 30)
    blocks = [Heading("Long"), Text(words), Items([words]), Table(["a"], [[words]])]
    narrow = text(blocks, 40)
    assert max(map(len, narrow.splitlines())) <= 40
    assert narrow.count("word") == text(blocks).count("word") == 90
    assert f"- {words}" in text(blocks)


def test_a_figure_is_written_beside_the_report(tmp_path):
    figure = new_figure(2.0, 1.0)
    figure.subplots().plot([0.0, 1.0], [0.0, 1.0])
    picture = Picture("figures/line.png", "a line", figure)
    write_report(tmp_path / "new", [Heading("Lines", 1), picture])
    shown = matplotlib.image.imread(tmp_path / "new" / "figures" / "line.png")
    assert shown.std() > 0.0
    page = (tmp_path / "new" / "report.html").read_text(encoding="utf-8")
    data = (tmp_path / "new" / "figures" / "line.png").read_bytes()
    assert base64.b64encode(data).decode() in page
