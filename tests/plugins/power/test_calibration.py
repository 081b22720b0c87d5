"""The table of the simulated robot against its anchors, as programs read it."""

import json

import numpy as np
import pytest

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.recordings.recording import Recording, Series
from hts_power.calibration import _walk, json_text, power


def test_what_numpy_computed_is_printed_as_json():
    row = {
        "standing_ok": np.bool_(True),
        "standing_watts": np.float64(58.5),
        "walking": {"0.8": {"falls": np.int64(0)}},
    }
    assert json.loads(json_text(row)) == {"standing_ok": True, "standing_watts": 58.5, "walking": {"0.8": {"falls": 0}}}


def walk(amps: float, torques: tuple[float, float]) -> Recording:
    """8 s at 0.8 m/s and 20 V, 2 A and 15 V idle; in the first two seconds it stands, and draws 50 A."""
    count, start = 400, 100
    current, base = np.full(count, amps), np.zeros((count, 3))
    current[:start], base[start:, 0] = 50.0, 0.8
    values = {
        ("battery_current", "A"): current,
        ("battery_voltage", "V"): np.full(count, 20.0),
        ("base_velocity", "m/s"): base,
        ("joint_torque", "N*m"): np.tile(torques, (count, 1)),
        ("joint_velocity", "rad/s"): np.full((count, 2), -6.0),
    }
    return Recording(
        robot="r",
        world="w",
        policy_hash="p",
        iteration=0,
        joint_names=("a", "b"),
        kp=(1.0, 1.0),
        kd=(1.0, 1.0),
        rate_hz=50.0,
        schedule=ScheduleConfig(commands=(Command(seconds=8.0, vx=0.8),)),
        idle={"battery_current": 2.0, "battery_voltage": 15.0},
        clock="simulated",
        time=np.arange(count) / 50,
        channels={name: Series(Channel(name, unit, found.shape[1:]), found) for (name, unit), found in values.items()},
        mass_kg=10.0,
    )


def test_a_row_is_of_the_steady_walk_net_of_idle_and_held_against_the_anchors():
    watts = {"copper": 56.0, "battery": 120.0, "idle": 30.0}  # 56 W of 90
    recordings = [walk(7.0, (3.0, 4.0)), walk(5.0, (0.0, 0.0))]
    assert [power(one) for one in recordings] == pytest.approx([140.0, 100.0])
    row = _walk(0.8, recordings, watts, mass_kg=10.0)
    assert (row["gross_watts"], row["net_watts"], row["mean_speed"]) == pytest.approx((120.0, 90.0, 0.8))
    assert row["cost_of_transport"] == pytest.approx(90.0 / 78.48)  # 10 kg weigh 98.1 N, at 0.8 m/s
    assert (row["idle_share"], row["idle_share_anchor"], row["idle_share_ok"]) == (pytest.approx(0.25), 0.248, True)
    assert (row["copper_share_of_net"], row["copper_ok"]) == (pytest.approx(56 / 90), True)
    assert row["torque_rms"] == pytest.approx(2.5)  # of 9, 16, 0 and 0: the root of 6.25
    assert row["velocity_rms"] == pytest.approx(6.0) and (row["falls"], row["valid_segments"]) == (0, 1.0)


@pytest.mark.parametrize(("amps", "near"), [(6.0, True), (7.0, True), (7.5, False), (5.0, False)])
def test_an_idle_share_is_near_its_anchor_within_fifteen_per_cent(amps, near):
    # 30 W of 20 V times so many amperes: 0.25, 0.214, 0.2 and 0.3; 0.211 to 0.285 are near 0.248.
    row = _walk(0.8, [walk(amps, (1.0, 1.0))], {"copper": 8.0, "battery": 110.0, "idle": 30.0}, mass_kg=10.0)
    assert row["idle_share_ok"] is near and not row["copper_ok"]  # a tenth of net is too little copper
