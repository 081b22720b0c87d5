"""What the robot's task is judged by is asked of recordings as they arrive: before they are judged, or kept."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from hts.channels import Channel
from hts.errors import RecordingError
from hts.evaluation.evaluate import evaluate_run
from hts.plugins import load
from hts.recordings.needs import check_judged_by
from hts.recordings.recording import Recording, Series
from hts.testing.known_world import KnownWorld
from hts.testing.made_up_recordings import known_recording
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run

SAID = (
    "World 'known', policy .{8}: the robot's task is judged by 'base_velocity' in m/s, recorded is km/h. Record or "
    "import it in m/s."
)


def in_kmh(recording: Recording) -> Recording:
    velocity = Series(Channel("base_velocity", "km/h", (3,)), 3.6 * recording.values("base_velocity"))
    return recording.replace(channels={**recording.channels, "base_velocity": velocity})


def without(recording: Recording) -> Recording:
    return recording.replace(
        channels={name: one for name, one in recording.channels.items() if name != "base_velocity"}
    )


@pytest.fixture
def robot():
    with kit_installed():
        yield load().make_robot("tiny")


def test_channels_of_the_task_are_asked_for_presence_unit_and_shape(robot):
    good = known_recording([1.0] * 4)
    check_judged_by([good], robot)
    spelt = replace(good.channels["base_velocity"].channel, unit="meter/second")
    again = Series(spelt, good.values("base_velocity"))
    check_judged_by([good.replace(channels={**good.channels, "base_velocity": again})], robot)
    with pytest.raises(RecordingError, match=f"^{SAID}$"):
        check_judged_by([good, in_kmh(good)], robot)
    with pytest.raises(RecordingError, match=r"judged by 'base_velocity', which was not recorded\. No channel of"):
        check_judged_by([without(good)], robot)
    forward = Series(Channel("base_velocity", "m/s"), np.ones(good.num_samples))
    with pytest.raises(RecordingError, match=r"'base_velocity' with shape \(3,\), recorded is \(\)\. Record or"):
        check_judged_by([good.replace(channels={**good.channels, "base_velocity": forward})], robot)
    heat = Series(Channel("base_velocity", "K", (3,)), good.values("base_velocity"))
    with pytest.raises(RecordingError, match="in m/s, recorded is K. Record or import it in m/s"):
        check_judged_by([good.replace(channels={**good.channels, "base_velocity": heat})], robot)


def test_first_data_need_not_have_them_and_in_another_unit_they_are_refused_too(robot):
    first = known_recording([1.0] * 4, role="collection")
    check_judged_by([without(first)], robot)
    with pytest.raises(RecordingError, match=SAID):
        check_judged_by([in_kmh(first)], robot)


def changed(plain, change):
    """A call of a world whose recordings are changed."""

    def walk(found):
        return change(found) if isinstance(found, Recording) else [walk(one) for one in found]

    return lambda self, *given: walk(plain(self, *given))


@pytest.mark.parametrize(
    ("call", "unfinished", "settings"),
    [
        ("collect", "collect", {}),
        ("head_to_heads_in_session", "iterations/00/test", {"selection.block_seconds": 10.0}),
        ("head_to_head", "iterations/00/best", {"selection.block_seconds": 10.0, "evaluation.each_iteration": True}),
    ],
)
def test_a_run_judges_nothing_of_a_world_that_tells_speeds_in_another_unit(
    tmp_path, monkeypatch, call, unfinished, settings
):
    monkeypatch.setattr(KnownWorld, call, changed(getattr(KnownWorld, call), in_kmh))
    with kit_installed(), pytest.raises(RecordingError, match=SAID):
        tiny_run(tmp_path / "run", settings=settings)
    assert not (tmp_path / "run" / f"{unfinished}.json").exists()


def test_an_evaluation_judges_nothing_of_such_a_world_either(finished, tmp_path, monkeypatch):
    folder = shutil.copytree(finished.folder, tmp_path / "run")
    with kit_installed():
        monkeypatch.setattr(KnownWorld, "head_to_head", changed(KnownWorld.head_to_head, in_kmh))
        with pytest.raises(RecordingError, match=SAID):
            evaluate_run(folder)
    assert not (tmp_path / "run" / "evaluation.json").exists()
