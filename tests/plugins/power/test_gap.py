"""Training simulation, and several twins side by side, as a gauge that shows known watts measures them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hts import plugins
from hts.policies.export import to_onnx
from hts.policies.files import load_policy
from hts_power import calibration
from hts_power.gap import SKIP_SECONDS, train


class Watts:
    """50 W from the battery until it settles, 20 W afterwards, and 5 W idle all the time."""

    def reset(self, num_worlds, rng):
        self.energy = {"battery": np.zeros(num_worlds), "idle": np.zeros(num_worlds)}
        self.seconds, self.watts, self.settled = 0.0, 50.0, []

    def step(self, sample):
        self.seconds += sample.dt
        self.energy["battery"] += self.watts * sample.dt
        self.energy["idle"] += 5.0 * sample.dt

    def settle(self):
        self.watts = 20.0
        self.settled.append(self.seconds)

    def read(self):
        pass


def test_a_walk_in_simulation_is_measured_from_when_it_is_steady_on(tmp_path):
    robot, gauge = plugins.load().make_robot("go1"), Watts()
    policy = to_onnx(load_policy(robot.pretrained_policy()), tmp_path / "policy.onnx")
    found = train(robot, gauge, policy, 0.8, 0.5)
    assert gauge.seconds == pytest.approx(SKIP_SECONDS + 0.5) and gauge.settled == [pytest.approx(SKIP_SECONDS)]
    assert found["net_watts"] == pytest.approx(20.0 - 5.0)
    assert found["mean_speed"] == pytest.approx(0.8, abs=0.2) and found["torque_rms"] > 1.0


def test_each_speed_is_of_its_own_twins(monkeypatch):
    """One stands, then two at each of two speeds: they draw 10, then 1, 2, 3 and 4 W more than before the warm-up."""
    joules = np.array([10.0, 1.0, 2.0, 3.0, 4.0])

    class Batch:
        mass_kg = 12.0

        def __init__(self, robot, settings, instruments, count, seeds):
            (gauge,) = instruments.values()
            gauge.energy, gauge.seconds, self.gauge = {"bus": 100.0 + np.zeros(count)}, 7.0, gauge

        def run(self, sessions, world):
            self.asked = [session.blocks[-1].schedule.commands[0].vx for session in sessions]
            self.gauge.energy["bus"] = self.gauge.energy["bus"] + 2.0 * joules
            self.gauge.seconds += 2.0
            return [[f"{index} at {speed:g}"] for index, speed in enumerate(self.asked)]

        def close(self):
            pass

    monkeypatch.setattr("hts.testing.twin.Batch", Batch)
    monkeypatch.setattr(calibration, "power", lambda recording: 60.0 if recording == "0 at 0" else 0.0)
    monkeypatch.setattr(calibration, "idle_power", lambda recording: 30.0)
    monkeypatch.setattr(calibration, "_walk", lambda *given: given)
    settings = SimpleNamespace(warmup_seconds=10.0)
    gauge = SimpleNamespace(read=lambda: None)
    found = calibration.measure(None, settings, gauge, "policy", [0.5, 0.8], 4.0, 2, 0)
    assert found["walking"] == {
        "0.5": (0.5, ["1 at 0.5", "2 at 0.5"], {"bus": 1.5}, 12.0),
        "0.8": (0.8, ["3 at 0.8", "4 at 0.8"], {"bus": 3.5}, 12.0),
    }
    assert (found["standing_watts"], found["idle_watts"], found["mass_kg"]) == (60.0, 30.0, 12.0)
