"""Logs of the world `field` that are still being copied, and what else lies beside them."""

from __future__ import annotations

import gzip
import shutil
import subprocess

import pytest
from field_folder import SECONDS, bundle, field, fill_in, write_log

from hts.errors import ConfigError, RecordingError, WaitingForRobot
from hts.recordings import reading
from hts.worlds import field_files
from hts.worlds.base import walking

ASKED = walking(0.5, SECONDS)


@pytest.fixture
def logs(run, policy, robot):
    """The folder of logs of a bundle of one row, with its log."""
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], ASKED)
    fill_in(run)
    logs = bundle(run) / "logs"
    write_log(logs / "00.csv", robot)
    return logs


@pytest.fixture
def slow_copy(logs, monkeypatch):
    """slow_copy(share): begin copying the log anew, wait with the rest until somebody looks again."""
    content = (logs / "00.csv").read_bytes()

    def begin(share: float) -> None:
        (logs / "00.csv").write_bytes(content[: int(len(content) * share)])

        def rest(seconds: float) -> None:
            (logs / "00.csv").write_bytes(content)

        monkeypatch.setattr(field_files.time, "sleep", rest)

    return begin


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.95], ids=lambda share: f"{share:.0%}")
def test_a_log_that_is_still_being_copied_is_waited_for(run, policy, slow_copy, share):
    slow_copy(share)
    with pytest.raises(WaitingForRobot, match=r"00\.csv: is still being written \(\d+ bytes, now .*hts resume"):
        field(run).collect([policy], ASKED)
    assert field(run).collect([policy], ASKED)[0].seconds == pytest.approx(SECONDS)


def test_a_log_that_grows_while_it_is_read_is_waited_for(run, policy, logs, monkeypatch):
    read_log = reading.read_log

    def slowly(registry, files, *rest):
        found = read_log(registry, files, *rest)
        with files[0].open("ab") as file:
            file.write(b"7.0")
        return found

    with monkeypatch.context() as patched:
        patched.setattr(reading, "read_log", slowly)
        with pytest.raises(WaitingForRobot, match="is still being written"):
            field(run).collect([policy], ASKED)
    assert len(field(run).collect([policy], ASKED)) == 1


@pytest.mark.parametrize(
    ("share", "words"), [(0.5, "If not all of it was copied, copy it again"), (0.0, "nothing stands in it")]
)
def test_a_copy_that_ended_early_and_grows_no_more_is_refused_as_it_is(run, policy, logs, monkeypatch, share, words):
    monkeypatch.setattr(field_files.time, "sleep", lambda seconds: None)
    content = (logs / "00.csv").read_bytes()
    (logs / "00.csv").write_bytes(content[: int(len(content) * share)])
    with pytest.raises(RecordingError, match=words):
        field(run).collect([policy], ASKED)


@pytest.mark.parametrize("ending", [".part", ".PART", ".filepart", ".crdownload", ".partial"])
@pytest.mark.parametrize("beside", [True, False], ids=["beside the log", "alone"])
def test_a_file_whose_name_says_that_it_is_being_copied_is_no_log(run, policy, logs, ending, beside):
    if beside:
        (logs / f"00.csv{ending}").write_text("time,")
    else:
        (logs / "00.csv").rename(logs / f"00.csv{ending}")
    with pytest.raises(WaitingForRobot, match=rf"1 of 1 logs .* Still being copied, by its name: 00\.csv{ending}\. "):
        field(run).collect([policy], ASKED)


@pytest.mark.parametrize(
    "name", ["00.csv~", "._00.csv", ".DS_Store", "Thumbs.db", "desktop.ini", ".00.csv.swp", "00.csv:Zone.Identifier"]
)
@pytest.mark.parametrize("inside", [True, False], ids=["folder of the row", "folder of logs"])
def test_what_editors_and_file_managers_leave_beside_a_log_is_none(run, policy, logs, name, inside):
    if inside:
        (logs / "00").mkdir()
        (logs / "00.csv").rename(logs / "00" / "00.csv")
    ((logs / "00" if inside else logs) / name).write_bytes(b"\0\5\x16\7")
    assert len(field(run).collect([policy], ASKED)) == 1


@pytest.mark.parametrize("left", [(), (".DS_Store",)])
def test_an_empty_folder_of_a_row_hides_no_log(run, policy, logs, left):
    (logs / "00").mkdir()
    for name in left:
        (logs / "00" / name).touch()
    assert len(field(run).collect([policy], ASKED)) == 1


@pytest.mark.parametrize("name", ["0.csv", "00 (1).csv", "row-00.csv", "00_second.csv", "000.csv"])
def test_a_log_whose_name_is_almost_a_rows_is_named_with_the_row(run, policy, logs, name):
    (logs / "00.csv").rename(logs / name)
    with pytest.raises(WaitingForRobot) as waiting:
        field(run).collect([policy], ASKED)
    assert f"'{name}' is no row's name: if it is the log of row 00, call it 00.csv. What to record" in str(
        waiting.value
    )


def test_of_a_folder_and_a_file_of_one_row_neither_is_taken_for_the_log(run, policy, logs):
    """Such as the row that was walked again, saved in the other way."""
    (logs / "00").mkdir()
    shutil.copy(logs / "00.csv", logs / "00" / "state.csv")
    with pytest.raises(
        ConfigError, match=r"2 files for one recording: .*logs/00/state\.csv, .*logs/00\.csv\. Take away"
    ):
        field(run).collect([policy], ASKED)
    (logs / "00" / "state.csv").unlink()
    assert len(field(run).collect([policy], ASKED)) == 1


@pytest.mark.parametrize("place", ["logs/logs", "Logs", "."])
def test_logs_that_were_copied_one_folder_too_deep_or_too_high_are_pointed_out(run, policy, logs, place):
    found = logs.parent / place
    found.mkdir(exist_ok=True)
    (logs / "00.csv").rename(found / "00.csv")
    with pytest.raises(WaitingForRobot) as waiting:
        field(run).collect([policy], ASKED)
    assert f"{found / '00.csv'} may be the log of row 00: put what lies there into {logs}. " in str(waiting.value)


def test_of_logs_that_were_copied_into_several_folders_the_first_by_its_name_is_pointed_out(run, policy, logs):
    for place in "hbgdcfea":
        (logs.parent / place).mkdir()
        shutil.copy(logs / "00.csv", logs.parent / place)
    (logs / "00.csv").unlink()
    with pytest.raises(WaitingForRobot) as waiting:
        field(run).collect([policy], ASKED)
    assert f"{logs.parent / 'a' / '00.csv'} may be the log of row 00" in str(waiting.value)


def test_a_bundle_that_was_renamed_is_known_by_its_plan(run, policy, logs):
    old = logs.parent.with_name("first-visit")
    logs.parent.rename(old)
    with pytest.raises(WaitingForRobot) as waiting:
        field(run).collect([policy], ASKED)
    assert f"{old} holds this bundle's logs under another name: put what is in its logs into {logs}" in str(
        waiting.value
    )
    (old / "logs" / "00.csv").rename(logs / "00.csv")
    assert len(field(run).collect([policy], ASKED)) == 1


@pytest.mark.parametrize("name", ["00.CSV", "00.csv.bak"])
def test_a_second_copy_under_a_rows_name_is_for_a_person_to_take_away(run, policy, logs, name):
    shutil.copy(logs / "00.csv", logs / name)
    with pytest.raises(ConfigError, match="2 files for one recording: .* Take away those that are no log of it"):
        field(run).collect([policy], ASKED)


@pytest.mark.parametrize(
    ("written", "name"),
    [
        (lambda plain: plain.decode().encode("utf-16"), "00.csv"),
        (gzip.compress, "00.csv"),
        (gzip.compress, "00.csv.gz"),
        (lambda plain: plain.rstrip()[:-40] + b"\n", "00.csv"),
    ],
    ids=["UTF-16", "packed", "packed, by its name", "last line cut"],
)
def test_the_command_that_mends_a_log_leaves_it_as_the_only_one_of_its_row(run, policy, logs, written, name):
    content = written((logs / "00.csv").read_bytes())
    (logs / "00.csv").unlink()
    (logs / name).write_bytes(content)
    with pytest.raises(RecordingError) as refused:
        field(run).collect([policy], ASKED)
    subprocess.run(["sh", "-c", str(refused.value).split("`")[1]], check=True)
    assert [path.name for path in logs.iterdir()] == ["00.csv"]
    assert field(run).collect([policy], ASKED)[0].seconds == pytest.approx(SECONDS, abs=0.05)


def test_a_gauge_that_nobody_reads_is_to_be_read_and_the_row_walked_again(run, policy, logs):
    head, *rows = (logs / "00.csv").read_text().splitlines()
    assert head.endswith(",battery_current")
    silent = [head, *(f"{row.rpartition(',')[0]},0.0" for row in rows)]
    (logs / "00.csv").write_text("\n".join(silent) + "\n")
    with pytest.raises(RecordingError, match=r"is 0 A in all .* record again \(of a run on a robot, the same row\)\."):
        field(run).collect([policy], ASKED)
