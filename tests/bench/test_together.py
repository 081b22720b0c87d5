"""Batches of two versions, looked at together."""

from __future__ import annotations

import pytest
from batch.groups import groups_of
from batch.together import together
from fake_lines import line

from hts.errors import EvaluationError


def batch(commit: str, realities: range, gain: float, **changes):
    """`ours` saves 20 % in the mean over speeds, `other` so much more."""
    lines = []
    for index in realities:
        name = f"dev-{index:02d}"
        lines.append(line("ours", name, saved=(0.1, 0.2, 0.3), commit=commit * 40, **changes))
        saved = (0.1 + gain, 0.2 + gain, 0.3 + gain)
        lines.append(line("other", name, saved=saved, commit=commit * 40, **changes))
    return lines


def rows(lines, against="ours"):
    text = together(groups_of(lines), against)
    return [[cell.strip() for cell in row.split("|")[1:-1]] for row in text.split("\n")[2:]]


def test_each_machine_is_compared_within_its_version_and_all_machines_count_the_same():
    found = rows([*batch("1", range(3), -0.02), *batch("2", range(3, 4), 0.06)])
    assert [row[:2] for row in found] == [["other, 1111111", "3"], ["other, 2222222", "1"], ["other, all", "4"]]
    assert found[0][2].startswith("−2.0 points") and found[1][2] == "+6.0 points (one reality)"
    assert found[2][2].removeprefix("+").removeprefix("−").startswith("0.0 points (")
    assert [row[4] for row in found] == ["0 of 3", "1 of 1", "1 of 4"]


def test_a_version_that_one_of_both_lacks_is_left_out():
    lines = [*batch("1", range(2), 0.02), line("other", "dev-09", commit="3" * 40)]
    assert [row[0] for row in rows(lines)] == ["other, 1111111", "other, all"]


def test_versions_that_share_nothing_are_refused_and_one_of_them_does_not_end_the_others():
    lines = [
        *batch("1", range(2), 0.02),
        line("ours", "dev-08", commit="2" * 40),
        line("other", "dev-09", commit="2" * 40),
    ]
    assert [row[0] for row in rows(lines)] == ["other, 1111111", "other, all"]
    with pytest.raises(EvaluationError, match="No method has been on a reality of 'ours' in the same version"):
        rows(lines[4:])


def test_what_would_count_twice_or_is_not_there_is_refused():
    with pytest.raises(EvaluationError, match="'other' have been on dev-01"):
        rows([*batch("1", range(2), 0.02), *batch("2", range(1, 3), 0.02)])
    with pytest.raises(EvaluationError, match="Two sets of options are 'ours' at 1111111"):
        rows([*batch("1", range(1), 0.0), *batch("1", range(1, 2), 0.0, method_hash="n" * 64)])
    with pytest.raises(EvaluationError, match="Did you mean 'ours'"):
        rows(batch("1", range(1), 0.0), "our")
