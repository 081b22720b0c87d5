"""Recordings of another rate than the policies' are refused before they are stored."""

from __future__ import annotations

import pytest

from hts.errors import RecordingError
from hts.recordings.needs import check_rate
from hts.testing.examples.robot.robot import Tiny
from hts.testing.known_world import KnownWorld
from hts.testing.made_up_recordings import known_recording
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run

SPEC = Tiny().spec


@pytest.mark.parametrize("factor", [0.2, 0.98, 4.0])
def test_another_rate_is_refused(factor):
    recording = known_recording([1.0, 2.0], rate_hz=SPEC.control_rate_hz).replace(rate_hz=factor * SPEC.control_rate_hz)
    with pytest.raises(RecordingError, match=r"recorded at .* Hz, robot 'tiny' acts at 50 Hz. Read the log at that"):
        check_rate([recording], SPEC)
    check_rate([recording.replace(rate_hz=1.001 * SPEC.control_rate_hz)], SPEC)


def test_nothing_of_it_is_stored(tmp_path, monkeypatch):
    real = KnownWorld.collect
    monkeypatch.setattr(KnownWorld, "collect", lambda *given: [one.replace(rate_hz=49.0) for one in real(*given)])
    with kit_installed(), pytest.raises(RecordingError, match="recorded at 49 Hz"):
        tiny_run(tmp_path / "run")
    assert not (tmp_path / "run" / "collect.json").exists()
