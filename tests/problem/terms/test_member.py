"""A copy with changes keeps what the changes leave as it was, and nothing else."""

from dataclasses import dataclass
from functools import cached_property

from ttus_opt.problem.terms.member import replaced


@dataclass(frozen=True)
class Square:
    side: float
    name: str = ""

    @cached_property
    def area(self):
        return [self.side**2]

    @cached_property
    def title(self):
        return f"a {self.name}"


def test_only_what_is_named_is_handed_on():
    first = Square(2.0, "tile")
    area, title = first.area, first.title
    other = replaced(first, "area", name="stone")
    assert other.area is area
    assert (other.title, title) == ("a stone", "a tile")
    assert first.name == "tile"


def test_what_was_not_computed_is_computed_when_asked_for():
    other = replaced(Square(2.0), "area", side=3.0)
    assert "area" not in vars(other)
    assert other.area == [9.0]
