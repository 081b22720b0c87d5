"""Pairs at equal commands: another comparison than at held speed, with refusals of its own, told of how many runs."""

from __future__ import annotations

import pytest
from batch import blocks
from fake_lines import figures, line

from hts.errors import EvaluationError

BLOCK = "<!-- results: pairs lines=a.jsonl methods=ours,part against=part{kind} --><!-- end -->"


def run(method, reality, held, at_equal_commands):
    """A run that saved `held` at each of three speeds, and at equal commands what is said there (None: refused)."""
    made = line(method, reality, saved=(held, held, held))
    found = dict(zip(("0.5", "0.8", "1.1"), at_equal_commands, strict=True))
    outcome = made.result.objectives["power"].model_copy(
        update={
            "open_loop": {speed: figures(value) for speed, value in found.items() if value is not None},
            "refused_open_loop": {speed: "too fast" for speed, value in found.items() if value is None},
        }
    )
    return made.model_copy(update={"result": made.result.model_copy(update={"objectives": {"power": outcome}})})


def test_pairs_at_equal_commands_count_what_was_saved_and_refused_there(tmp_path):
    lines = [
        run("ours", "dev-00", 0.3, (0.3, None, None)),
        run("ours", "dev-01", 0.3, (0.6, 0.3, None)),
        run("part", "dev-00", 0.2, (0.2, 0.2, 0.2)),
        run("part", "dev-01", 0.2, (0.3, None, None)),
    ]
    (tmp_path / "a.jsonl").write_text("".join(one.model_dump_json() + "\n" for one in lines))
    held = blocks.written(BLOCK.format(kind=""), tmp_path)
    equal = blocks.written(BLOCK.format(kind=" kind=open_loop"), tmp_path)
    assert "| ours | 2 | +10.0 points" in held and "| 2 of 2 | +0 |" in held
    # dev-00: 0.1 - 0.2, dev-01: 0.3 - 0.1; three speeds of six refused, two of six.
    assert "| ours | 2 | +5.0 points" in equal and "| 1 of 2 | +1 |" in equal
    assert "minus part at equal commands, mean" in equal and "equal commands" not in held


def test_another_kind_is_one_line(tmp_path):
    (tmp_path / "a.jsonl").write_text("".join(line(one).model_dump_json() + "\n" for one in ("ours", "part")))
    with pytest.raises(EvaluationError, match="No kind of figures named 'open'. Did you mean"):
        blocks.written(BLOCK.format(kind=" kind=open"), tmp_path)


def test_refusals_of_unequally_many_runs_are_told_of_how_many(tmp_path):
    lines = [run("ours", "dev-00", 0.3, (0.3, None, None)), run("part", "dev-00", 0.2, (0.2, 0.2, None))]
    again = run("part", "dev-00", 0.2, (0.2, 0.2, 0.2)).model_copy(update={"seed": 1, "key": "another"})
    (tmp_path / "a.jsonl").write_text("".join(one.model_dump_json() + "\n" for one in (*lines, again)))
    equal = blocks.written(BLOCK.format(kind=" kind=open_loop"), tmp_path)
    assert "| 2 of 3, part 1 of 6 |" in equal
