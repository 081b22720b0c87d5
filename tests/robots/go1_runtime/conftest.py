"""A small bundle, made once, and copies of it to be broken."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hts import plugins
from hts.contracts import HoldSpeed
from hts.policies.export import to_onnx
from hts.policies.files import Policy, load_policy
from hts.worlds.base import walking
from hts.worlds.field_bundle import CHECKSUMS, Order, checksums, write_bundle
from hts.worlds.field_manifest import Facts
from hts_go1_runtime import cli, operator_key

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)
SECONDS = 1.0


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> Path:
    """The pretrained policy, then the same with noise, held at 0.6 m/s: two rows of a session."""
    place = tmp_path_factory.mktemp("bundle")
    robot = plugins.load().make_robot("go1")
    policy = load_policy(robot.pretrained_policy())
    plain = to_onnx(policy, place / "walk.onnx")
    card = dataclasses.replace(policy.card, exploration_std=(0.05,) * 12, policy_hash="e" * 64)
    noisy = to_onnx(Policy(policy.tensors, card), place / "noisy.onnx")
    orders = [
        Order("00", plain, walking(0.6, SECONDS), "s1", 0, "reference", True),
        Order("01", noisy, walking(0.6, SECONDS), "s1", 1, "policy", True),
    ]
    facts = Facts(robot.spec, "test", HoldSpeed((0.2, 1.5), 2.0), robot.channels(), [])
    write_bundle(place / "bundle", orders, place / "mapping.yaml", "hts resume run", facts)
    return place / "bundle"


@pytest.fixture
def bundle(made, tmp_path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(made, tmp_path / "bundle"))


@pytest.fixture
def change(bundle) -> Callable[[Callable[[dict[str, Any]], None]], Path]:
    """change(edit): the bundle with an edited manifest, and checksums that fit it again."""

    def changed(edit: Callable[[dict[str, Any]], None]) -> Path:
        path = bundle / "manifest.json"
        manifest = json.loads(path.read_text())
        edit(manifest)
        path.write_text(json.dumps(manifest))
        (bundle / CHECKSUMS).unlink()
        (bundle / CHECKSUMS).write_text(checksums(bundle))
        return bundle

    return changed


@pytest.fixture
def visit(bundle, monkeypatch) -> Callable[..., int]:
    """visit(*options, link=a scripted robot): exit code of `run` of the bundle."""

    def run(*options: str, link=None) -> int:
        robot = scripted.ScriptedLink() if link is None else link
        robot.speed = 0.55
        monkeypatch.setattr(cli, "UdpLink", lambda url, lockstep: robot)
        # The input of tests has ended; a thread that comes to reading it late is to say the same of it.
        monkeypatch.setattr(operator_key, "ENDED", 600.0)
        quick = ["--idle-seconds", "0.2", "--warmup", "0", "--lockstep"]
        return cli.main(["run", str(bundle), "--link", "udp://127.0.0.1:9870", *quick, *options])

    return run
