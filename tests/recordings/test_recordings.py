"""The recording store: what it keeps, what it refuses, and how it names things."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from walker_recording import a_recording

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.errors import RecordingError
from hts.recordings import Recording, RecordingStore, Series
from hts.recordings.checks import check
from hts.recordings.header import array_digest
from hts.recordings.recording import robot_samples_of

DATA = Path(__file__).parents[1] / "data"


def with_channel(
    recording: Recording, name: str, unit: str, values: np.ndarray, shape: tuple[int, ...] = ()
) -> Recording:
    return recording.replace(channels={**recording.channels, name: Series(Channel(name, unit, shape), values)})


# ---------------------------------------------------------------------------------------- writing and reading


def test_what_is_read_is_what_was_written(store: RecordingStore) -> None:
    written = a_recording()
    recording_id = store.write(written)
    read = RecordingStore(store.path).read(recording_id)
    for field in (
        "robot",
        "world",
        "policy_hash",
        "iteration",
        "joint_names",
        "kp",
        "kd",
        "rate_hz",
        "schedule",
        "idle",
    ):
        assert getattr(read, field) == getattr(written, field)
    for field in ("clock", "mass_kg", "session", "block", "role", "fell", "notes"):
        assert getattr(read, field) == getattr(written, field)
    assert read.id == recording_id
    assert read.seconds == 1.0
    np.testing.assert_array_equal(read.time, written.time)
    assert set(read.channels) == set(written.channels)
    for name, series in written.channels.items():
        assert read.channels[name].channel == series.channel
        assert read.channels[name].values.dtype == np.float32
        np.testing.assert_array_equal(read.channels[name].values, series.values)


def test_one_channel_can_be_read_alone(store: RecordingStore) -> None:
    recording_id = store.write(a_recording())
    assert list(store.read(recording_id, ["draw"]).channels) == ["draw"]
    with pytest.raises(RecordingError, match="No channel named 'drow'. Did you mean 'draw'"):
        store.read(recording_id, ["drow"])


def test_writing_twice_gives_one_recording_and_one_id(store: RecordingStore) -> None:
    first = store.write(a_recording())
    assert store.write(a_recording()) == first
    assert store.write(store.read(first)) == first
    assert store.ids() == (first,)


def test_any_change_gives_another_id(store: RecordingStore) -> None:
    recording = a_recording()
    nudged = recording.values("draw").copy()
    nudged[7] = np.nextafter(nudged[7], np.float32(9.0))
    changed = [
        recording,
        recording.replace(block=3),
        recording.replace(fell=True),
        recording.replace(mass_kg=None),
        recording.replace(idle={"draw": 1.26}),
        recording.replace(time=recording.time + 0.02),
        with_channel(recording, "draw", "A", nudged),
        with_channel(recording, "draw", "V", recording.values("draw")),
    ]
    assert len({store.write(one) for one in changed}) == len(changed)


def test_the_attributes_say_all_that_is_needed_and_every_array_its_unit_and_rate(store: RecordingStore) -> None:
    recording_id = store.write(a_recording())
    attributes = store.attributes(recording_id)
    assert attributes["schema_version"] == 1
    assert attributes["schedule"] == {"commands": [{"seconds": 1.0, "vx": 0.5, "vy": 0.0, "yaw_rate": 0.0}]}
    assert attributes["idle"] == {"draw": 1.25, "warmth": 25.0}
    for key in ("robot", "joint_names", "kp", "kd", "rate_hz", "policy_hash", "iteration", "world", "clock", "role"):
        assert key in attributes
    group = zarr.open_group(str(store.path), mode="r")[recording_id]
    assert group["joint_torque"].attrs["unit"] == "N*m"
    assert {array.attrs["rate_hz"] for _, array in group.arrays()} == {50.0}
    np.testing.assert_array_equal(group["joint_torque"][:, 1], -np.arange(50) / 8)


@settings(max_examples=20, deadline=None)
@given(
    values=hnp.arrays(
        np.float32, st.tuples(st.integers(2, 40), st.integers(1, 3)), elements=st.floats(-1e6, 1e6, width=32)
    )
)
def test_any_finite_numbers_come_back_unchanged(values: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> None:
    store = RecordingStore(tmp_path_factory.mktemp("any") / "data.zarr", create=True)
    shape = values.shape[1:]
    recording = a_recording(len(values))
    recording = recording.replace(channels={"x": Series(Channel("x", "m", shape), values)}, idle={})
    np.testing.assert_array_equal(store.read(store.write(recording)).values("x"), values)


# --------------------------------------------------------------------------------------------------- refusals


def refusals() -> dict[str, tuple[Recording, str]]:
    good = a_recording()
    late = good.time.copy()
    late[10] = late[9]
    holed = good.values("draw").copy()
    holed[3] = np.nan
    endless = good.values("draw").copy()
    endless[4] = np.inf
    stuck_column = np.stack([np.arange(50.0), np.full(50, 7.0)], axis=1)
    unit = Channel("draw", "A")
    object.__setattr__(unit, "unit", "Amps")
    return {
        "unknown unit": (
            good.replace(channels={**good.channels, "draw": Series(unit, good.values("draw"))}),
            "No unit named 'Amps'",
        ),
        "wrong shape": (with_channel(good, "joint_torque", "N*m", np.ones((50, 3)), (2,)), "'joint_torque' has shape"),
        "scalar": (with_channel(good, "draw", "A", np.float32(1.0)), "'draw' has shape"),
        "time repeats": (good.replace(time=late), "time does not increase at sample 10: 0.180000 s, then 0.180000 s"),
        "time is NaN": (good.replace(time=np.where(np.arange(50) == 5, np.nan, good.time)), "'time' is NaN"),
        "one sample": (a_recording(1), "at least 2 samples"),
        "NaN": (
            with_channel(good, "draw", "A", holed),
            "'draw' is NaN or infinite in 1 of 50 samples, first at sample 3",
        ),
        "infinite": (with_channel(good, "draw", "A", endless), "first at sample 4"),
        "too large": (with_channel(good, "draw", "A", np.linspace(0, 1e300, 50)), "'draw' is NaN or infinite"),
        "constant": (with_channel(good, "draw", "A", np.full(50, 58.0)), "'draw' is 58 A in all 50 samples"),
        "all zero": (with_channel(good, "draw", "A", np.zeros(50)), "--drop draw"),
        "one column": (with_channel(good, "draw", "A", stuck_column, (2,)), "'draw' column 1 is 7 A in all 50 samples"),
        "length": (with_channel(good, "draw", "A", np.arange(49.0)), "'draw' has 49 samples, time has 50"),
        "rate": (good.replace(rate_hz=100.0), "the time stamps make 50 Hz, but rate_hz says 100"),
        "idle name": (good.replace(idle={"drow": 1.0}), "No channel named 'drow'. Did you mean 'draw'"),
        "idle NaN": (good.replace(idle={"draw": float("nan")}), "idle level of 'draw' is nan"),
        "role": (good.replace(role="elite"), "No role named 'elite'"),
        "gains": (good.replace(kp=(20.0,)), "kp has 1 values for 2 joints"),
        "schedule": (
            good.replace(schedule=ScheduleConfig(commands=(Command.model_construct(seconds=1.0, vx=float("inf")),))),
            "cannot be stored",
        ),
    }


@pytest.mark.parametrize("name", list(refusals()))
def test_a_bad_recording_is_refused_in_one_line_and_nothing_is_written(store: RecordingStore, name: str) -> None:
    recording, expected = refusals()[name]
    with pytest.raises(RecordingError) as refused:
        store.write(recording, "walk.csv")
    assert str(refused.value).startswith("walk.csv: ")
    assert expected in str(refused.value)
    assert "\n" not in str(refused.value)
    assert sorted(os.listdir(store.path)) == ["zarr.json"]


def test_simulated_channels_and_honest_constants_may_stand_still() -> None:
    check(with_channel(a_recording(), "joint_torque", "N*m", np.zeros((50, 2)), (2,)))


def test_a_quick_fall_may_be_over_before_a_slow_gauge_moves(store: RecordingStore) -> None:
    still = with_channel(a_recording(), "draw", "A", np.full(50, 58.0))
    with pytest.raises(RecordingError, match=r"and record again .* may go without: hts import --drop"):
        check(still)
    assert store.read(store.write(still.replace(fell=True))).fell


def test_values_that_are_no_numbers_are_refused() -> None:
    with pytest.raises(RecordingError, match="'draw' does not hold an array of numbers"):
        Series(Channel("draw", "A"), np.array(["one", "two"]))


# --------------------------------------------------------------------------------------------- data set hashes


@pytest.mark.parametrize("noted", ["-100", "inf", "-inf", "nan", "1e308", "a while"])
def test_unrecorded_seconds_that_are_no_duration_are_refused_in_one_line(noted: str) -> None:
    recording = a_recording().replace(notes={"unrecorded_seconds": noted})
    for whose, one in (("A recording's", recording), ("abc: its", replace(recording, id="abc"))):
        with pytest.raises(RecordingError) as error:
            _ = one.robot_samples
        said = f"{whose} note unrecorded_seconds is '{noted}', expected a number of seconds from 0 on."
        assert str(error.value) == said


def test_samples_of_the_robot_are_the_recorded_ones_and_those_that_a_note_tells_of() -> None:
    recording = a_recording()
    assert recording.robot_samples == recording.num_samples
    told = recording.replace(notes={"unrecorded_seconds": "9.5"})
    assert told.robot_samples == recording.num_samples + round(9.5 * recording.rate_hz)
    assert robot_samples_of([recording, told]) == 2 * recording.num_samples + round(9.5 * recording.rate_hz)


def test_a_dataset_hash_ignores_order_and_repeats_but_not_content(store: RecordingStore) -> None:
    ids = [store.write(a_recording(iteration=i)) for i in range(3)]
    dataset = store.dataset(ids)
    assert dataset == store.dataset([ids[2], ids[0], ids[1], ids[0]])
    assert dataset.ids == tuple(sorted(ids))
    assert len(dataset.sha256) == 64
    assert dataset.sha256 != store.dataset(ids[:2]).sha256


def test_chunks_and_compression_do_not_change_what_is_read_or_its_hash(store: RecordingStore) -> None:
    recording_id = store.write(a_recording())
    before, torque = store.dataset([recording_id]), store.read(recording_id).values("joint_torque")
    folder = store.path / recording_id / "joint_torque"
    shutil.rmtree(folder)
    again = zarr.create_array(
        str(folder), shape=(50, 2), chunks=(7, 1), dtype="float32", compressors=zarr.codecs.ZstdCodec()
    )
    again[...] = torque
    assert store.validate() == []
    assert store.dataset([recording_id]) == before
    np.testing.assert_array_equal(store.read(recording_id).values("joint_torque"), torque)


def test_a_digest_does_not_depend_on_memory_layout() -> None:
    values = np.arange(12, dtype=np.float32).reshape(4, 3)
    assert array_digest(np.asfortranarray(values)) == array_digest(values) == array_digest(values.astype(">f4"))
    assert array_digest(values.reshape(3, 4)) != array_digest(values)


# ------------------------------------------------------------------------------------------------ stored before


def test_a_store_written_by_the_first_version_still_opens() -> None:
    """If this fails, a stored format has changed: raise SCHEMA_VERSION, keep reading version 1, keep this store."""
    store = RecordingStore(DATA / "recording-v1.zarr")
    (recording_id,) = store.ids()
    assert store.validate() == []
    read = store.read(recording_id)
    expected = a_recording(8)
    for name, series in expected.channels.items():
        np.testing.assert_array_equal(read.values(name), series.values)
    assert (read.robot, read.idle, read.block) == ("walker", {"draw": 1.25, "warmth": 25.0}, 2)
    assert recording_id == "4aef854e20323653"
    assert store.dataset([recording_id]).sha256.startswith("40a8e9731574")


def test_the_same_recording_gets_the_same_id_as_in_the_first_version(store: RecordingStore) -> None:
    assert store.write(a_recording(8)) == "4aef854e20323653"
