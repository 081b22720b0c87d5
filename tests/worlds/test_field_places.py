"""The page of a bundle whose run folder was copied or moved names the places of now."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from field_folder import SECONDS, bundle, field, write_log

from hts.errors import WaitingForRobot
from hts.worlds import field_places
from hts.worlds.base import walking


def contents(folder: Path) -> dict[str, bytes]:
    """Every file's path in the folder, and what is in it."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("noted", [False, True], ids=["as it was", "with a note"])
def test_the_bundle_of_a_copied_run_folder_sends_nobody_to_the_old_one(tmp_path, policy, robot, noted):
    old, new = tmp_path / "run", tmp_path / "the lab" / "run"
    old.mkdir()
    (old / "config.yaml").write_text("preset: smoke\n")
    asked = [policy, policy], walking(0.5, SECONDS)
    with pytest.raises(WaitingForRobot):
        field(old).collect(*asked)
    write_log(bundle(old) / "logs" / "00.csv", robot)
    if noted:
        with (bundle(old) / "README.md").open("a") as page:
            page.write("\nBattery 2 was in it: ask Grace.\n")
    shutil.copytree(old, new)
    first = contents(old)
    with pytest.raises(WaitingForRobot):
        field(new).collect(*asked)
    text = (bundle(new) / "README.md").read_text()
    assert f"`{new}/field/mapping.yaml`" in text and f"4. Type: `hts resume '{new}'`" in text
    assert f"{old}/" not in text and f"resume {old}" not in text and text.count("\n2. Write it") == 1
    changed = {f"field/{bundle(old).name}/{name}" for name in ("README.md", *([] if noted else ["SHA256SUMS"]))}
    assert {name for name, content in contents(new).items() if first.get(name) != content} == changed
    if noted:
        assert text.endswith("\nBattery 2 was in it: ask Grace.\n")
    else:
        subprocess.run(["sha256sum", "--quiet", "-c", "SHA256SUMS"], cwd=bundle(new), check=True)
    assert contents(old) == first
    again = {path: path.stat().st_mtime_ns for path in bundle(new).rglob("*")}
    with pytest.raises(WaitingForRobot):
        field(new).collect(*asked)
    assert {path: path.stat().st_mtime_ns for path in bundle(new).rglob("*")} == again


def test_a_page_whose_renewing_was_cut_off_is_renewed_with_its_checksum(tmp_path, run, policy, monkeypatch):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    moved = bundle(run).rename(tmp_path / "moved")
    write = field_places.atomic_write

    def cut_off(path, content):
        if path.name == "README.md":
            raise KeyboardInterrupt
        write(path, content)

    with monkeypatch.context() as patched:
        patched.setattr(field_places, "atomic_write", cut_off)
        with pytest.raises(KeyboardInterrupt):
            field_places.renew(moved, tmp_path / "mapping.yaml", "hts resume here")
    field_places.renew(moved, tmp_path / "mapping.yaml", "hts resume here")
    assert "4. Type: `hts resume here`\n" in (moved / "README.md").read_text()
    subprocess.run(["sha256sum", "--quiet", "-c", "SHA256SUMS"], cwd=moved, check=True)
