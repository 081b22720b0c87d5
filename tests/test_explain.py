"""What pydantic found wrong where a value may be one of several types: one fault of the value, in words."""

from __future__ import annotations

from typing import Annotated

import pytest
from pydantic import Field, ValidationError

from hts.config import Config
from hts.errors import ConfigError
from hts.explain import explain
from hts.recordings.mapping import parse_mapping


class Part(Config):
    size: int = 1


class Whole(Config):
    column: str | int = "t"
    columns: str | int | tuple[str | int, ...] = "a"
    share: Annotated[float, Field(gt=0)] | str | None = None
    part: Part | bool = False
    parts: dict[str, Part | float] = Field(default_factory=dict)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"column": 3.5}, "column: expected text or a whole number, found 3.5."),
        ({"columns": 3.5}, "columns: expected text, a whole number or a list, found 3.5."),
        ({"columns": {"a": "b"}}, "columns: expected text, a whole number or a list, found {'a': 'b'}."),
        ({"columns": ["a", 1.5]}, "columns.1: expected text or a whole number, found 1.5."),
        ({"share": -1.0}, "share: expected more than 0 or text, found -1.0."),
        ({"part": {"size": "large"}}, "part.size: expected a whole number, found 'large'."),
        ({"part": {"sise": 2}}, "part.sise: there is no key 'sise' in part. Did you mean 'size'? Known: size."),
        ({"parts": {"a": 1.0, "b": [2]}}, "parts.b: expected keys and values or a number, found [2]."),
        (
            {"column": [1], "share": -1},
            "column: expected text or a whole number, found [1]. Also: share: expected more than 0 or text, found -1.",
        ),
    ],
)
def test_a_value_that_is_of_no_type_that_may_stand_there_is_one_fault(given, said):
    with pytest.raises(ValidationError) as caught:
        Whole.model_validate(given)
    assert explain(caught.value, Whole) == said


def test_so_it_is_with_the_columns_of_a_mapping():
    given = {"time": {"column": "t", "unit": "s"}, "rate_hz": 50, "channels": {"a": {"columns": 3.5, "unit": "A"}}}
    with pytest.raises(ConfigError) as caught:
        parse_mapping(given)
    assert str(caught.value) == ("Mapping: channels.a.columns: expected text, a whole number or a list, found 3.5.")
