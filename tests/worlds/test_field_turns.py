"""A row that was walked to and fro: its turns are left out, and it counts if it still has its seconds."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from hts.errors import RecordingError, WaitingForRobot
from hts.worlds.base import walking

SPEC = importlib.util.spec_from_file_location("field_folder", Path(__file__).with_name("field_folder.py"))
folder = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(folder)
SECONDS, TURN = folder.SECONDS, 2.0


@pytest.fixture
def turned(run, policy, robot):
    """turned(seconds): what the world reads of a log of 1 s, a turn of TURN, and the rest of so many s."""

    def read(seconds: float):
        with pytest.raises(WaitingForRobot):
            folder.field(run).collect([policy], walking(0.5, SECONDS))
        mapping = run / "field" / "mapping.yaml"
        folder.fill_in(run)
        mapping.write_text(mapping.read_text() + "only: {column: phase}\n")
        log = folder.bundle(run) / "logs" / "00.csv"
        folder.write_log(log, robot, seconds + TURN)
        header, *lines = log.read_text().splitlines()
        phases = [int(50 <= number < 50 * (1 + TURN)) for number in range(len(lines))]
        rows = [f"{line},{phase}" for line, phase in zip(lines, phases, strict=True)]
        log.write_text("\n".join([f"{header},phase", *rows]) + "\n")
        return folder.field(run).collect([policy], walking(0.5, SECONDS))[0]

    return read


def test_a_row_of_another_runner_has_its_seconds_without_its_turns(turned):
    recording = turned(SECONDS)
    assert recording.seconds == pytest.approx(SECONDS, abs=0.03)
    assert recording.schedule.seconds == SECONDS
    assert recording.notes["rows_left_out"] == f"100 of {round(50 * (SECONDS + TURN))} ('phase' is not 0)"


def test_one_that_has_not_is_refused_by_its_length(turned):
    with pytest.raises(RecordingError, match=r"00.csv: 2.0 s long, but 3 s were to be recorded"):
        turned(SECONDS - 1.0)
