"""The bench on a busy computer: what could not be measured is said, the rest is measured."""

from __future__ import annotations

import json

import pytest

from hts_go1_runtime import bench
from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.fake import FAULTS


def lines(capsys) -> dict:
    return {key: one for line in capsys.readouterr().out.splitlines() for key, one in json.loads(line).items()}


def test_every_reason_is_measured_and_the_worst_is_said(bundle, monkeypatch, capsys):
    monkeypatch.setattr(bench, "stopped", lambda policy, fault, at: at / 100)
    assert bench.bench(bundle, 0.0, 3) == 0
    found = lines(capsys)
    assert set(found) == {*FAULTS[1:], bench.LATE, "stops"}
    assert found["tilt"] == {"reason": "tilt", "ms": [5.0, 5.0, 5.1], "worst_ms": 5.1}
    assert found["stale states"]["reason"] == "lost link"
    assert found["stops"] == {"worst_ms": 5.1, "could_not_measure": []}


@pytest.mark.parametrize("error", [bench.Unmeasured("stopped for 'lost link' before"), RuntimeFault("No state came")])
def test_what_a_busy_computer_spoils_is_tried_again_and_then_named(bundle, monkeypatch, capsys, error):
    tries = []

    def stopped(policy, fault, at):
        tries.append(fault)
        if fault == "temperature" or (fault == "tilt" and tries.count("tilt") == 1):
            raise error
        return 0.001

    monkeypatch.setattr(bench, "stopped", stopped)
    assert bench.bench(bundle, 0.0, 2) == 1
    found = lines(capsys)
    assert found["tilt"]["ms"] == [1.0, 1.0]
    assert found["temperature"]["ms"] == []
    assert found["temperature"]["could_not_measure"].startswith(f"0 of 2 measured; {bench.TRIES} tries")
    assert found["late loop"]["worst_ms"] == 1.0
    assert found["stops"] == {"worst_ms": 1.0, "could_not_measure": ["temperature"]}


def test_a_stop_for_another_reason_is_no_measurement(bundle):
    from hts_go1_runtime.bundle import load_bundle

    policy = next(iter(load_bundle(bundle).policies.values()))

    class Hot:
        def __getattr__(self, name):
            return getattr(policy, name)

        def targets(self, state, command):
            return policy.targets(state, command) * float("nan")

    with pytest.raises(bench.Unmeasured, match=r"stopped for '[a-z ]+' before the fault came"):
        bench.stopped(Hot(), "tilt", 0.5)
