"""Every kind of malformed log through `hts import`, damaged real logs, and whatever hypothesis thinks of."""

from __future__ import annotations

import copy
import importlib.util
import os
import random
from pathlib import Path

import fuzz
import malformed as table
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hts.errors import HtsError
from hts.recordings import RecordingStore
from hts.recordings.csv_reader import make
from hts.recordings.glance import glance
from hts.recordings.mapping import load_mapping, parse_mapping
from hts.recordings.suggest import suggested_mapping

LOGS = Path(os.environ.get("HTS_REAL_LOGS", Path(__file__).parents[3] / "shared" / "real-logs"))
EXTRA = importlib.util.find_spec("mcap_ros2") is not None


KINDS = [(e, n) for e, group in (("bad", table.BAD), ("either", table.EITHER), ("good", table.GOOD)) for n in group]


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """A store that holds one recording already."""
    folder = tmp_path_factory.mktemp("store")
    made = table.case(folder, 10**6)
    table.GOOD["as_it_is"](made)
    assert fuzz.run(made, folder / "data.zarr")[0] == 0
    return folder / "data.zarr"


def spoiled(folder, expected, name, seed):
    made = table.case(folder, seed)
    {"bad": table.BAD, "either": table.EITHER, "good": table.GOOD}[expected][name](made)
    return made


def test_there_are_forty_kinds_and_more_than_one_format():
    assert len(table.BAD) + len(table.EITHER) >= 40
    assert len(table.GOOD) >= 10
    assert not EXTRA or any(name.startswith("mcap") for name in table.BAD)


@pytest.mark.parametrize(("expected", "name"), KINDS, ids=[name for _, name in KINDS])
def test_every_kind_ends_as_it_should(tmp_path, store, expected, name):
    """One clear line, an exit code, the store as it was; or stored as it is."""
    assert fuzz.faults(spoiled(tmp_path, expected, name, seed=3), expected, store) == []


def test_a_case_that_ends_otherwise_is_noticed(tmp_path, store):
    """The test above can fail: a good log called bad, a bad one called good, and a file that ran."""
    whole = spoiled(tmp_path, "good", "as_it_is", seed=4)
    assert any("was stored" in fault for fault in fuzz.faults(whole, "bad", store))
    (tmp_path / "ran").touch()
    broken = spoiled(tmp_path, "bad", "ragged_row", seed=5)
    found = fuzz.faults(broken, "good", store)
    assert any("was refused" in fault for fault in found) and "ran what a file holds" in found
    assert RecordingStore(store).validate() == []


@pytest.mark.slow
def test_every_kind_twice_more_into_one_store(capsys):
    """What the script does; called by hand it makes as many cases as one likes."""
    assert fuzz.main(["--count", "2", "--seed", "50"]) == 0, capsys.readouterr().out
    assert int(capsys.readouterr().out.splitlines()[-2].split()[0]) == 2 * (len(table.BAD) + len(table.EITHER))


# ------------------------------------------------------------------------------------------------ damaged real logs


REAL = {
    "go2_walk/walking5.csv": (
        "timestamp",
        "s",
        "{joint}_tau",
        [f"{a}_{b}" for a in ("FR", "FL") for b in ("hip", "calf")],
    ),
    "go2_idle/nob_idle_holdout.csv": ("timestamp_ms", "ms", "tau_{joint}", ["fr_hip", "fr_calf", "fl_hip", "fl_calf"]),
    "ur3e/fig9.csv": ("timestamp", "s", "target_moment_{joint}", ["0", "1"]),
}


def damage(text, chance):
    """One of the things that happen to text on its way."""
    lines = text.splitlines()
    at = chance.randrange(1, len(lines) - 1)
    cells = lines[at].split(",")
    which = chance.randrange(9)
    if which == 0:
        return text[: chance.randrange(len(text))]
    if which == 1:
        lines[at], lines[at + 1] = lines[at + 1], lines[at]
    elif which == 2:
        lines.insert(at, lines[0])
    elif which == 3:
        del lines[at : at + chance.randrange(1, 100)]
    elif which == 4:
        cells[chance.randrange(len(cells))] = chance.choice(["", "x", "inf", "1e300", "-", "\0", "\x1b[2J", '"'])
    elif which == 5:
        cells = cells[: chance.randrange(len(cells))]
    elif which == 6:
        lines[0] = lines[0].replace(chance.choice("aeiourt_"), "", 1)
    elif which == 7:
        return text.replace(",", chance.choice([";", " ", ",,"]))
    else:
        return text.replace("\n", chance.choice(["\r", "\n\n", ""]), chance.randrange(1, 50))
    if which in (4, 5):
        lines[at] = ",".join(cells)
    return "\n".join(lines)


@pytest.mark.skipif(not LOGS.is_dir(), reason="real logs are not here; HTS_REAL_LOGS names their folder")
@pytest.mark.parametrize("name", list(REAL))
def test_a_damaged_real_log_is_refused_in_one_line_or_read(tmp_path, name):
    from hts.channels import Channel
    from hts.contracts import LogOnlyRobot, RobotSpec

    time, unit, columns, joints = REAL[name]
    count = len(joints)
    limits = {"torque_limit": [56.0] * count, "velocity_limit": [30.0] * count, "position_limit": [(-7.0, 7.0)] * count}
    robot = LogOnlyRobot(
        RobotSpec.log_only("real", joints, **limits, rate_hz=25), [Channel("joint_torque", "N*m", (count,))]
    )
    mapping = {
        "time": {"column": time, "unit": unit},
        "rate_hz": 25,
        "max_gap_seconds": 0.2,
        "joints": {joint: joint for joint in joints},
        "channels": {"joint_torque": {"columns": columns, "unit": "N*m"}},
    }
    whole = "\n".join((LOGS / name).read_text().splitlines()[:250])
    chance, outcomes, log = random.Random(name), [], tmp_path / "log.csv"
    for _ in range(60):
        log.write_text(damage(whole, chance))
        try:
            outcomes.append(make({}).read([log], mapping, robot).num_samples)
        except HtsError as error:
            assert "\n" not in str(error) and "log.csv" in str(error), error
            outcomes.append(0)
    assert 10 < sum(outcome == 0 for outcome in outcomes) < 60


# --------------------------------------------------------------------------------------------------- anything at all

ANYTHING = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


@ANYTHING
@given(text=st.one_of(st.binary(max_size=400), st.text(alphabet='t,H_K0123456789.-eE"\n\r ;naif', max_size=400)))
def test_any_bytes_are_a_log_or_one_line(tmp_path, two_joints, mapping, text):
    log = tmp_path / "log.csv"
    log.write_bytes(text if isinstance(text, bytes) else text.encode())
    for look in (
        lambda: make({}).read([log], mapping, two_joints),
        lambda: glance(log),
        lambda: yaml.safe_load(suggested_mapping(log, two_joints)),
    ):
        try:
            look()
        except HtsError as error:
            assert "\n" not in str(error)


VALUES = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8)),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=8), inner, max_size=3)),
    max_leaves=6,
)
KEYS = [
    "time",
    "rate_hz",
    "channels",
    "cut",
    "runs",
    "labels",
    "files",
    "join",
    "joints",
    "joint_order",
    "recording",
    "reader",
]


@ANYTHING
@given(key=st.sampled_from(KEYS), value=VALUES, inside=st.booleans())
def test_any_value_in_a_mapping_is_read_or_one_line(tmp_path, two_joints, mapping, key, value, inside):
    log = table.case(tmp_path, 1)
    path, mapping = log.write(), copy.deepcopy(mapping)  # one fixture for all examples
    if inside:
        mapping["channels"]["draw"][key if key in ("file", "limits") else "columns"] = value
    else:
        mapping[key] = value
    try:
        make({}).read([path], mapping, two_joints)
    except HtsError as error:
        assert "\n" not in str(error)


@ANYTHING
@given(text=st.one_of(st.text(max_size=200), st.text(alphabet="a:-[]{}&*!|>#'\" \n0", max_size=200)))
def test_any_text_is_a_mapping_or_one_line(tmp_path, text):
    file = tmp_path / "m.yaml"
    file.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        parse_mapping(load_mapping(file))
    except HtsError as error:
        assert "\n" not in str(error)
