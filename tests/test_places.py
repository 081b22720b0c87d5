"""A place that cannot be written is one line before anything is spent, whichever command names it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hts.cli.main import main
from hts.errors import RunError
from hts.places import check_place

LONG = "x" * 300
RUN = ["--objective", "power", "--robot", "go1", "--preset", "smoke"]


@pytest.fixture
def places(tmp_path: Path) -> Path:
    """A folder with a plain file `afile`, a link to nothing `gone` and a folder `there`, and nothing else; alone in the
    one around it, where a test looks too."""
    places = tmp_path / "places"
    places.mkdir()
    (places / "afile").write_text("precious")
    (places / "gone").symlink_to(places / "nowhere")
    (places / "there").mkdir()
    return places


def left(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("afile", "afile: is a file, not a folder"),
        ("afile/x/y", "/afile is a file, not a folder. Choose another place with --out DIR."),
        ("gone/x", "gone is a link to nothing"),
        (f"new/{LONG}", "too long for the file system. Choose a shorter one with --out DIR."),
        (f"{LONG}/x", "too long"),
    ],
)
def test_a_folder_that_cannot_be_made_is_refused_in_one_line(places, name, said):
    before = left(places)
    with pytest.raises(RunError) as caught:
        check_place(places / name, "--out DIR")
    assert said in str(caught.value) and "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{places / name}: ")
    assert left(places) == before


def test_where_the_system_makes_no_folders_the_line_says_so():
    if not Path("/proc/self").is_dir():
        pytest.skip("this system has no /proc, where nobody can make a folder")
    with pytest.raises(RunError, match="Check the path|no permission|not permitted|read-only"):
        check_place(Path("/proc/hts/run"), "--out DIR")


def test_a_place_without_permission_is_refused(places):
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    (places / "there").chmod(0o500)
    with pytest.raises(RunError, match="no permission"):
        check_place(places / "there/run", "--out DIR")
    (places / "there").chmod(0o700)


@pytest.mark.parametrize("name", ["there", "there/x", "new", "new/deep/run", "new/../x", "there/../../other"])
def test_a_place_that_can_be_made_passes_and_nothing_is_left_of_the_trial(places, name):
    before = left(places.parent)
    check_place(places / name, "--out DIR")
    check_place(places / name / "file.onnx", "--to FILE", file=True)
    assert left(places.parent) == before


def test_a_name_is_measured_with_what_it_is_called_while_it_is_written(places):
    check_place(places / ("x" * 255), "--out DIR")
    with pytest.raises(RunError, match="too long"):
        check_place(places / ("x" * 255), "--to FILE", file=True)


@pytest.mark.parametrize(
    "arguments",
    [
        ["pretrain", "--robot", "go1", "--out", "PLACE"],
        ["run", *RUN, "--out", "PLACE"],
        ["run", *RUN, "--dry-run", "--out", "PLACE"],
        ["baseline", *RUN, "--out", "PLACE"],
        ["baseline", *RUN, "--dry-run", "--out", "PLACE"],
        ["oracle", *RUN, "--out", "PLACE"],
        ["oracle", *RUN, "--dry-run", "--out", "PLACE"],
        ["policy", "import", "POLICY", "--robot", "go1", "--to", "PLACE.safetensors"],
        ["export", "--policy", "POLICY", "--to", "PLACE.onnx"],
        ["export", "--measurement-model", "POLICY", "--to", "PLACE.safetensors"],
        ["import", "log.csv", "--robot", "go1", "--mapping", "m.yaml", "--to", "PLACE"],
        ["import", "log.csv", "--robot", "go1", "--mapping", "m.yaml", "--to", "PLACE", "--dry-run"],
    ],
    ids=" ".join,
)
@pytest.mark.parametrize("name", ["afile/x", f"new/{LONG}"])
def test_commands_refuse_such_a_place_before_anything_is_spent(places, monkeypatch, capsys, arguments, name):
    from hts.plugins import load

    def spent(*_: object, **__: object) -> None:
        raise AssertionError("something was spent")

    for work in (
        "hts.training.pretrain.pretrain_policy",
        "hts.run.ready.check_ready",
        "hts.policies.files.load_policy",
    ):
        monkeypatch.setattr(work, spent)
    policy = str(load().make_robot("go1").pretrained_policy())
    before = left(places)
    words = [word.replace("PLACE", str(places / name)).replace("POLICY", policy) for word in arguments]
    assert main(words) == 2
    line = capsys.readouterr().err
    assert line.startswith(f"error: {places / name}") and line.count("\n") == 1, line
    assert "not a folder" in line or "too long" in line, line
    assert ("--to" if "--to" in words else "--out") in line
    assert left(places) == before


def test_a_fit_refuses_its_place_before_it_reads_the_store(places, capsys):
    words = ["fit", "--objective", "power", "--data", str(places / "no.zarr"), "--out", str(places / "afile/fit")]
    assert main(words) == 2
    assert "afile is a file, not a folder" in capsys.readouterr().err


def test_a_name_that_is_no_text_is_refused_before_anything_is_made(tmp_path):
    with pytest.raises(RunError, match=r"no text \(bytes that are not UTF-8\)\. Choose another place with --out DIR"):
        check_place(tmp_path / os.fsdecode(b"b\xffd") / "run", "--out DIR")
    check_place(tmp_path / "Größe λ" / "run", "--out DIR")
    assert list(tmp_path.iterdir()) == []
