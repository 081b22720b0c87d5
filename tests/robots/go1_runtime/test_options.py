"""Numbers of the command line, and limits: what makes no sense is refused in one line before anything moves."""

from __future__ import annotations

import math
import shlex

import pytest

from hts_go1.robot import Go1
from hts_go1_runtime import cli
from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.machine import Limits

RUN, BENCH = ("run", "--link", "udp://127.0.0.1:9870"), ("bench",)


@pytest.mark.parametrize(
    ("command", "option", "text", "expected"),
    [
        (RUN, "--most-current", "nan", "a number from 1 to 100"),
        (RUN, "--most-current", "0", "a number from 1 to 100"),
        (RUN, "--least-torque-share", "1.1", "a number from 0 to 1"),
        (RUN, "--most-temperature", "inf", "a number from 20 to 90"),
        (RUN, "--mass", "-3", "a number from 1 to 100"),
        (RUN, "--mass", "heavy", "a number from 1 to 100"),
        (RUN, "--idle-seconds", "nan", "a number from 0 to 600"),
        (RUN, "--idle-seconds", "inf", "a number from 0 to 600"),
        (RUN, "--warmup", "inf", "a number from 0 to 3600"),
        (RUN, "--warmup", "-1", "a number from 0 to 3600"),
        (RUN, "--priority", "100", "a whole number from 0 to 99"),
        (BENCH, "--seconds", "-1", "a number from 0 to 36000"),
        (BENCH, "--stops", "2.5", "a whole number from 0 to 1000"),
    ],
)
def test_a_number_that_makes_no_sense_is_refused_in_one_line(bundle, capsys, command, option, text, expected):
    with pytest.raises(SystemExit) as ended:
        cli.main([*command, str(bundle), option, text])
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"refused: argument {option}: '{text}', expected {expected}"


def test_numbers_that_make_sense_are_taken(bundle):
    words = [
        "--most-current",
        "25",
        "--mass",
        "12.5",
        "--idle-seconds",
        "0",
        "--warmup",
        "600",
        "--priority",
        "0",
        "--least-torque-share",
        "0",
    ]
    options = cli._parser().parse_args(["run", str(bundle), "--link", "udp://127.0.0.1:9870", *words])
    assert options.least_torque_share == 0.0
    assert (options.most_current, options.mass, options.idle_seconds, options.warmup) == (25.0, 12.5, 0.0, 600.0)


def test_an_option_that_nobody_knows_is_one_line(bundle, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["check", str(bundle), "--gently"])
    assert ended.value.code == 2
    assert capsys.readouterr().err == "refused: unrecognized arguments: --gently\n"


@pytest.mark.parametrize("limit", ["tilt", "current", "voltage", "temperature", "silence", "late"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_limit_that_stops_nobody_is_refused(limit, value):
    with pytest.raises(RuntimeFault, match=rf"limit '{limit}' is {value}, expected a finite number"):
        Limits(**{limit: value})


def test_the_page_of_a_bundle_walks_new_policies_slowly_first():
    typed = [shlex.split(command, comments=True) for command in Go1.bundle_commands]
    given = [cli._parser().parse_args(words[3:]) for words in typed]
    assert [words[:3] for words in typed] == [["python", "-m", "hts_go1_runtime"]] * 3
    assert [one.command for one in given] == ["check", "run", "run"]
    assert [one.first_run for one in given[1:]] == [True, False]
