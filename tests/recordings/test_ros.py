"""ROS 2 bags and MCAP files without ROS, and without running what stands in them."""

from __future__ import annotations

import importlib.util
import sqlite3

import numpy as np
import pytest

from hts.errors import ConfigError, RecordingError
from hts.recordings import messages as messages_module
from hts.recordings.glance import glance
from hts.recordings.messages import messages, topics
from hts.recordings.ros_reader import load_definitions, make

STEPS = np.arange(40)
needs_ros = pytest.mark.skipif(
    importlib.util.find_spec("mcap_ros2") is None, reason="the extra is not installed: pip install 'hard-to-sim[ros]'"
)


@pytest.fixture
def made():
    import bags  # needs the extra

    return bags


@pytest.fixture
def bag_mapping():
    return {
        "reader": "ros",
        "topic": "/joint_states",
        "time": {"column": "log_time", "unit": "ns"},
        "rate_hz": 50,
        "joints": {"hip": "hip", "knee": "knee"},
        "channels": {
            "joint_torque": {"columns": "effort[{joint}]", "unit": "N*m"},
            "draw": {"columns": "amps", "unit": "A", "sign": -1, "idle": 1.9, "topic": "/gauge"},
        },
    }


@needs_ros
@pytest.mark.parametrize("packing", ["NONE", "LZ4", "ZSTD"])
def test_fields_of_messages_become_channels_joints_by_the_names_in_the_message(
    tmp_path, made, bag_mapping, two_joints, packing
):
    recording = make({}).read([made.mcap(tmp_path / "walk.mcap", compression=packing)], bag_mapping, two_joints)
    # the gauge's first sample is 5 ms after the joints' first, and both are there until 5 ms before its last
    np.testing.assert_allclose(recording.values("joint_torque")[:, 0], (STEPS[:39] + 0.25) / 10, atol=1e-5)
    np.testing.assert_allclose(recording.values("joint_torque")[:, 1], -(STEPS[:39] + 0.25) / 10, atol=1e-5)
    np.testing.assert_allclose(recording.values("draw"), 2 + STEPS[:39] / 100, atol=1e-5)
    assert recording.notes["starts_after_first_stamp"] == "0.005000 s"


@needs_ros
def test_a_stamp_in_the_message_keeps_its_nanoseconds(tmp_path, made, bag_mapping, two_joints):
    bag_mapping["time"]["column"] = "header.stamp"
    del bag_mapping["channels"]["draw"]
    recording = make({}).read([made.mcap(tmp_path / "walk.mcap")], bag_mapping, two_joints)
    np.testing.assert_allclose(recording.values("joint_torque")[:, 0], STEPS / 10, atol=1e-6)


@needs_ros
@pytest.mark.parametrize(("late", "told"), [(0, None), (200_000_000, "/joint_states +0.000 s, /bms +0.205 s after")])
def test_stamps_of_two_clocks_are_told_by_when_they_were_received(tmp_path, made, bag_mapping, two_joints, late, told):
    kind, text, content = made.TOPICS["/joint_states"]
    topics = {"/joint_states": (kind, text, content), "/bms": (kind, text, lambda step: made.joint_state(step, late))}
    bag_mapping["time"]["column"] = "header.stamp"
    draw = {"columns": "effort[hip]", "unit": "A", "offset": 2, "idle": 1.9, "topic": "/bms"}
    torque = {**bag_mapping["channels"]["joint_torque"], "topic": "/joint_states"}
    bag_mapping["channels"] = {"joint_torque": torque, "draw": draw}
    log = made.mcap(tmp_path / "walk.mcap", topics=topics)
    note = make({}).read([log], bag_mapping, two_joints).notes.get("received")
    assert note is None if told is None else note.startswith(told)


@needs_ros
def test_a_bag_in_sqlite_gives_the_same_also_as_a_folder(tmp_path, made, bag_mapping, two_joints):
    bag = tmp_path / "bag"
    bag.mkdir()
    made.sqlite(bag / "bag_0.db3")
    for path in (bag, bag / "bag_0.db3"):
        recording = make({}).read([path], bag_mapping, two_joints)
        np.testing.assert_allclose(recording.values("joint_torque")[:, 1], -STEPS / 10, atol=1e-6)
        np.testing.assert_allclose(recording.values("draw"), 2 + STEPS / 100, atol=1e-6)
    assert topics(bag) == {"/joint_states": "sensor_msgs/msg/JointState", "/gauge": "lab/msg/Gauge"}


@needs_ros
def test_messages_of_a_recorder_whose_clock_was_set_back_are_not_mixed(tmp_path, made, bag_mapping, two_joints):
    path = made.sqlite(tmp_path / "bag.db3")
    base = sqlite3.connect(path)
    base.execute("UPDATE messages SET timestamp = timestamp - 110000000 WHERE (id - 1) % 40 >= 20")  # each topic has 40
    base.commit()
    base.close()
    with pytest.raises(RecordingError, match="time does not increase.*where the clock was set back, cut the log"):
        make({}).read([path], bag_mapping, two_joints)


@needs_ros
def test_definitions_may_come_from_a_file_where_the_bag_has_none(tmp_path, made, bag_mapping, two_joints):
    old = made.sqlite(tmp_path / "old.db3", definitions=False)
    with pytest.raises(RecordingError, match="of type sensor_msgs/msg/JointState, whose definition is not in the file"):
        make({}).read([old], bag_mapping, two_joints)
    line = "=" * 80
    text = f"{line}\nMSG: sensor_msgs/JointState\n{made.JOINT_STATE}\n{line}\nMSG: lab/Gauge\n{made.GAUGE}"
    (tmp_path / "lab.msg").write_text(text)
    bag_mapping["definitions"] = str(tmp_path / "lab.msg")
    assert make({}).read([old], bag_mapping, two_joints).num_samples == 40


@needs_ros
@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"topic": "/joint_state"}, "No topic named '/joint_state'. Did you mean '/joint_states'?"),
        ({"channels": {"draw": {"columns": "amp", "unit": "A", "idle": 1, "topic": "/gauge"}}}, "It has amps, percent"),
        ({"joints": {"hip": "hop", "knee": "knee"}}, "'hop' is not among its names .knee, hip."),
        ({"channels": {"joint_torque": {"columns": "effort[3..4]", "unit": "N*m"}}}, "list index out of range"),
        (
            {"channels": {"joint_torque": {"columns": ["name[0]", "name[1]"], "unit": "N*m"}}},
            "could not convert string",
        ),
        ({"time": {"column": "header.stamps", "unit": "ns"}}, "there is no field 'stamps'"),
        ({"time": {"column": "header.frame_id", "unit": "s"}}, "does not hold numbers .it begins with 'base'"),
    ],
)
def test_a_field_that_is_not_there_is_one_line(tmp_path, made, bag_mapping, two_joints, changes, expected):
    with pytest.raises(RecordingError, match=expected) as refused:
        make({}).read([made.mcap(tmp_path / "walk.mcap")], {**bag_mapping, **changes}, two_joints)
    assert "walk.mcap" in str(refused.value) and "\n" not in str(refused.value)


@needs_ros
def test_a_damaged_file_is_refused_wherever_the_damage_is(tmp_path, made):
    whole = made.mcap(tmp_path / "walk.mcap").read_bytes()
    lost = tmp_path / "lost.mcap"
    for cut in (9, 30, len(whole) // 2, len(whole) - 20):
        lost.write_bytes(whole[:cut])
        with pytest.raises(RecordingError, match="lost.mcap"):
            list(messages(lost, "/gauge", {}))
    for at in range(60, len(whole), len(whole) // 25):
        lost.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        try:
            assert len(list(messages(lost, "/gauge", {}))) in (0, 40)  # damage in what is not read
        except RecordingError as error:
            assert "lost.mcap" in str(error) and "\n" not in str(error)


@needs_ros
def test_a_part_that_unpacks_to_more_than_it_says_is_refused(tmp_path, made, monkeypatch):
    path = made.mcap(tmp_path / "walk.mcap")
    monkeypatch.setattr(messages_module, "MOST_RECORD", 1000)
    with pytest.raises(RecordingError, match=r"walk.mcap: (a part of|not a whole file)"):
        list(messages(path, "/gauge", {}))


@needs_ros
def test_a_database_cannot_run_code_and_is_not_written(tmp_path, made):
    path = made.sqlite(tmp_path / "bag.db3")
    base = sqlite3.connect(path)
    base.executescript(
        "DROP TABLE topics; CREATE VIEW topics AS SELECT load_extension('/tmp/x.so') AS id, 'a' AS name, 'b' AS type;"
    )
    base.close()
    before = path.read_bytes()
    with pytest.raises(RecordingError, match="bag.db3: not a whole file of messages"):
        topics(path)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "nothing stands in it"),
        (b"nothing of the kind", "neither an MCAP file nor a ROS 2 bag"),
        (b"#ROSBAG V2.0\n", "a bag of ROS 1.*rosbags-convert"),
    ],
)
@needs_ros
def test_a_file_that_is_neither_is_refused(tmp_path, content, expected):
    (tmp_path / "a.mcap").write_bytes(content)
    for look in (topics, glance, lambda path: list(messages(path, "/x", {}))):
        if content.startswith(b"#") or look is not glance:  # what begins otherwise may be a table
            with pytest.raises(RecordingError, match=f"a.mcap: {expected}"):
                look(tmp_path / "a.mcap")


@needs_ros
@pytest.mark.parametrize("key", ["    - bag_{}.mcap.zstd", "    - bag/bag_{}.mcap", "    - path: bag_{}.mcap"])
def test_a_bag_of_which_a_part_is_missing_or_packed_is_not_taken_for_the_whole(tmp_path, made, key):
    parts = [made.mcap(tmp_path / f"bag_{number}.mcap", STEPS[20 * number :][:20]) for number in range(2)]
    listed = "\n".join(("    - bag_{}.mcap" if "path" in key else key).format(number) for number in range(2))
    files = "\n".join(key.format(number) for number in range(2)) if "path" in key else ""
    about = tmp_path / "metadata.yaml"
    about.write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:\n{listed}\n  files:\n{files}\n")
    assert len(list(messages(tmp_path, "/gauge", {}))) == 40
    parts[0].rename(tmp_path / "morning_0.mcap")
    assert len(list(messages(tmp_path, "/gauge", {}))) == 40
    (tmp_path / "morning_0.mcap").unlink()
    with pytest.raises(RecordingError, match="metadata.yaml lists bag_0.mcap, which is not in this folder"):
        list(messages(tmp_path, "/gauge", {}))
    for text in ("", "rosbag2_bagfile_information:\n  relative_file_paths: [bag_0.mca", "a: 1"):
        about.write_text(text)
        with pytest.raises(RecordingError, match="metadata.yaml: not what a recorder writes"):
            list(messages(tmp_path, "/gauge", {}))
    about.unlink()
    (tmp_path / "bag_0.mcap.zstd").write_bytes(b"")  # as a recorder leaves them that is killed: the last part is plain
    with pytest.raises(RecordingError, match="part of this bag is packed. Unpack bag_0.mcap.zstd first"):
        list(messages(tmp_path, "/gauge", {}))


@needs_ros
def test_messages_that_are_packed_one_by_one_are_not_decoded_as_other_numbers(tmp_path, made):
    import zstandard

    path = made.sqlite(tmp_path / "bag.db3")
    base = sqlite3.connect(path)
    base.create_function("packed", 1, zstandard.compress)
    base.execute("UPDATE messages SET data = packed(data)")
    base.commit()
    base.close()
    with pytest.raises(RecordingError, match=r"'/gauge': a message is packed by itself \(zstd\).*28 b5 2f fd"):
        list(messages(path, "/gauge", {}))


def test_without_the_extra_it_says_so_in_one_line(tmp_path, bag_mapping, two_joints, monkeypatch):
    monkeypatch.setattr(messages_module, "find_spec", lambda name: None)
    (tmp_path / "a.mcap").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"pip install 'hard-to-sim\[ros\]'"):
        make({}).read([tmp_path / "a.mcap"], bag_mapping, two_joints)


def test_definitions_that_are_none_are_refused(tmp_path):
    (tmp_path / "a.msg").write_text("float32 x\n")
    for name, expected in (
        (str(tmp_path / "a.msg"), "no message definition"),
        (str(tmp_path / "b.msg"), "cannot read these definitions"),
        ("hts:../secret.msg", "is no file, and no PACKAGE:FILE"),
        ("no_such_package:a.msg", "no package 'no_such_package' is installed"),
    ):
        with pytest.raises(ConfigError, match=expected):
            load_definitions(name)


def test_an_empty_folder_says_what_is_missing(tmp_path):
    pytest.importorskip("mcap_ros2", reason="the extra is not installed")
    with pytest.raises(RecordingError, match="no .mcap or .db3 file in this folder"):
        topics(tmp_path)
    (tmp_path / "bag_0.db3.zstd").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"Unpack bag_0.db3.zstd first \(`zstd -d`\)"):
        topics(tmp_path)


@needs_ros
@pytest.mark.parametrize("ending", ["-wal", "-journal"])
def test_a_database_that_its_recorder_left_half_merged_is_named_and_its_end_is_not_lost(tmp_path, made, ending):
    path = made.sqlite(tmp_path / "bag.db3")
    beside = tmp_path / f"bag.db3{ending}"
    beside.write_bytes(b"")
    assert topics(path)  # an empty one holds nothing
    beside.write_bytes(b"messages")
    for read in (topics, lambda path: list(messages(path, "/gauge", {}))):
        with pytest.raises(RecordingError, match=rf"bag.db3{ending}: holds what bag.db3 does not have yet.*sqlite3"):
            read(path)
