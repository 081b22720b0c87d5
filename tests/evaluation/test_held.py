"""Head-to-heads at held speed: what is refused, what is reported, and several speeds as one number."""

from __future__ import annotations

import numpy as np
import pytest

from hts.channels import Channel
from hts.config import Command, CommandConfig, EvaluationConfig, ScheduleConfig
from hts.config_loading import load_config
from hts.contracts import VELOCITY, Comparison, HoldSpeed, Robot
from hts.errors import ConfigError, EvaluationError, PluginError
from hts.evaluation.across_speeds import mean_comparison
from hts.evaluation.final import candidate_result, entry_both_ways, speeds_missed, walked_speeds
from hts.evaluation.halves import halves
from hts.evaluation.head_to_head import compare, judged
from hts.evaluation.held import SpeedNotHeld, ask_to_hold, check_hold, hold_of, not_held_in_training, not_tried
from hts.plugins import load
from hts.recordings.recording import Recording, Series
from hts.testing.made_up_recordings import CostObjective

CONFIG = EvaluationConfig(bootstrap=200)
ORDER = ("reference", "policy", "policy", "reference")


def block(
    role: str,
    number: int,
    asked: float,
    walked: float,
    cost: float,
    notes: dict[str, str],
    seconds: int = 22,
    noise: float = 0.004,
) -> Recording:
    """A block whose 1 s mean speeds scatter by `noise`, m/s, about `walked`; segments begin after 2 s."""
    rng, count = np.random.default_rng([number, round(1000 * walked)]), seconds * 50
    shocks = rng.standard_normal(seconds)
    shocks[2:] = (shocks[2:] - shocks[2:].mean()) / shocks[2:].std()  # exactly `walked` on average
    velocity = np.zeros((count, 3))
    velocity[:, 0] = np.repeat(walked + noise * shocks, 50)
    series = {
        "base_velocity": Series(Channel("base_velocity", "m/s", (3,)), velocity),
        CostObjective.target.name: Series(CostObjective.target, cost + 0.01 * np.sin(np.arange(count) / 37.0)),
    }
    return Recording(
        robot="r",
        world="w",
        policy_hash=role,
        iteration=0,
        joint_names=(),
        kp=(),
        kd=(),
        rate_hz=50.0,
        schedule=ScheduleConfig(commands=(Command(seconds=seconds, vx=asked),)),
        idle={CostObjective.target.name: 0.0},
        clock="simulated",
        time=np.arange(count) / 50,
        channels=series,
        mass_kg=10.0,
        session=f"s{asked}",
        block=number,
        role=role,
        notes=notes,
    )


def held(command: float, saturated: bool = False) -> dict[str, str]:
    return {"held_command": repr(command), "held_saturated": str(saturated).lower()}


def session(asked: float, policy: float, reference: float, cost: float = 8.0, **given) -> list[Recording]:
    """Reference, policy, policy, reference at mean speeds, both held by other commands."""
    notes = {"policy": held(asked + 0.03), "reference": held(asked + 0.01)} | given.pop("notes", {})
    speeds, costs = {"policy": policy, "reference": reference}, {"policy": cost, "reference": 10.0}
    return [block(role, n, asked, speeds[role], costs[role], notes[role], **given) for n, role in enumerate(ORDER)]


def test_the_entry_says_that_the_speed_was_held_and_by_which_commands():
    entry = compare(CostObjective(), session(0.8, 0.803, 0.798), CONFIG).entry()
    sent = (entry["commanded"], entry["reference"]["commanded"])
    assert entry["held"] is True and sent == pytest.approx((0.83, 0.81))
    assert entry["improvement"] == pytest.approx(0.2, abs=0.01)


def test_at_equal_commands_the_asked_speed_is_what_was_sent():
    entry = compare(CostObjective(), session(0.8, 0.75, 0.8, notes={"policy": {}, "reference": {}}), CONFIG).entry()
    assert (entry["held"], entry["commanded"], entry["reference"]["commanded"]) == (False, 0.8, 0.8)


@pytest.mark.parametrize("role", ["policy", "reference"])
def test_a_command_that_reached_the_end_of_its_range_is_refused(role):
    recordings = session(0.8, 0.8, 0.8, notes={role: held(1.2, saturated=True)})
    with pytest.raises(
        SpeedNotHeld, match=r"reached the end of the range \(1.20 m/s, at which it went 0.80\)"
    ) as error:
        compare(CostObjective(), recordings, CONFIG)
    assert error.value.role == role and "\n" not in str(error.value)


def test_mean_speeds_that_are_more_than_one_per_cent_apart_are_refused():
    compare(CostObjective(), session(0.8, 0.800, 0.793), CONFIG)  # 0.9 %
    with pytest.raises(
        SpeedNotHeld, match=r"1\.1% apart \(policy 0.791 m/s at command 0.830, reference 0.800 at 0.810\)"
    ):
        compare(CostObjective(), session(0.8, 0.791, 0.800), CONFIG)


def test_a_difference_that_chance_explains_is_not_refused():
    # 2 x 4 segments whose speeds scatter by 1.5 %: their means are known to 0.5 %, the difference to 0.75 %
    short = {"seconds": 6, "noise": 0.012}
    few = CONFIG.model_copy(update={"min_segments": 4})
    compare(CostObjective(), session(0.8, 0.790, 0.800, **short), few)  # 1.25 %
    with pytest.raises(SpeedNotHeld):
        compare(CostObjective(), session(0.8, 0.760, 0.800, **short), few)  # 5 %


@pytest.mark.parametrize("role", ["policy", "reference"])
def test_a_speed_is_walked_again_where_the_command_was_wrong_and_not_where_the_policy_wanders(role):
    def missed(**given) -> list[float]:
        speeds = {"policy": 0.8, "reference": 0.8} | {role: given.pop("mean", 0.8)}
        return speeds_missed(CostObjective(), session(0.8, **speeds, **given), CONFIG)

    assert missed() == []
    assert missed(mean=0.9) == [0.8]  # steadily 12 % too fast: no second counts
    assert missed(mean=0.81) == [0.8]  # each second counts, the means are apart
    assert missed(noise=0.4) == []  # right on average, in few of its seconds
    saturated = {role: held(1.2, saturated=True)}
    assert missed(mean=0.7, notes=saturated) == []  # trimming longer does not help


@pytest.mark.parametrize(("mean", "missed"), [(0.837, []), (0.763, []), (0.843, [0.8]), (0.757, [0.8])])
def test_who_wanders_about_a_mean_is_off_from_half_of_what_a_second_may_be(mean, missed):
    # A second may be 10 % off; 0.037 m/s of 0.8 are 4.6 %, 0.043 are 5.4 %.
    assert speeds_missed(CostObjective(), session(0.8, mean, 0.8, noise=0.4), CONFIG) == missed


def test_whether_a_speed_was_missed_is_told_without_drawing_an_interval():
    class Counted(CostObjective):
        asked = 0

        def compare(self, policy, reference):
            self.asked += 1
            return super().compare(policy, reference)

    objective = Counted()
    assert speeds_missed(objective, session(0.5, 0.5, 0.5) + session(0.8, 0.8, 0.8), CONFIG) == []
    assert objective.asked == 2  # once at each speed


@pytest.mark.parametrize(
    "recordings",
    [
        session(0.8, 0.8, 0.8),
        session(0.8, 0.81, 0.8),
        session(0.8, 0.9, 0.8),
        session(0.8, 0.7, 0.8, notes={"policy": held(1.2, saturated=True)}),
        session(0.8, 0.8, 0.8, seconds=4),
    ],
    ids=["good", "apart", "too fast", "at the limit", "too few"],
)
def test_what_is_judged_without_intervals_is_what_is_compared_with_them(recordings):
    def found(ask):
        try:
            return ask(CostObjective(), recordings, CONFIG)
        except EvaluationError as error:
            return type(error), str(error)

    with_intervals = found(compare)
    assert found(judged) == (with_intervals if isinstance(with_intervals, tuple) else with_intervals.comparison)


def test_a_speed_at_which_the_policy_fell_is_not_walked_again():
    fallen = {"policy": held(0.83) | {"falls": "1"}}
    assert speeds_missed(CostObjective(), session(0.8, 0.81, 0.8), CONFIG) == [0.8]
    assert speeds_missed(CostObjective(), session(0.8, 0.81, 0.8, notes=fallen), CONFIG) == []


def test_falls_of_a_refused_candidate_are_kept_at_every_speed():
    fallen = {"policy": held(0.83) | {"falls": "1"}}
    recordings = session(0.5, 0.55, 0.5) + session(0.8, 0.8, 0.8, notes=fallen)  # the slower one is what refuses it
    found = candidate_result("c", {"cost": CostObjective()}, recordings, CONFIG)
    assert found.refusal["speed"] == 0.5 and found.refused_falls == {"0.8": 2}


def test_a_candidate_is_not_blamed_for_its_reference():
    limit = {"reference": held(1.2, saturated=True) | {"falls": "1"}}
    found = candidate_result("c", {"cost": CostObjective()}, session(0.8, 0.8, 0.8, notes=limit), CONFIG)
    assert "the reference policy cannot be held" in found.refused
    assert found.refusal is None and not found.refused_falls


def test_falls_at_speeds_that_the_reference_cannot_keep_are_the_policys_own():
    notes = {"policy": held(0.83) | {"falls": "1"}, "reference": held(1.2, saturated=True) | {"falls": "3"}}
    recordings = session(0.5, 0.5, 0.5) + session(0.8, 0.8, 0.8, notes=notes)
    plain = {"notes": {"policy": {}, "reference": {}}}
    entry, *_ = entry_both_ways(CostObjective(), recordings, session(0.5, 0.5, 0.5, **plain), CONFIG)
    assert entry["refused_falls"] == {"0.8": 2}  # one in each of its two blocks


def test_blocks_that_held_the_speed_do_not_mix_with_others():
    with pytest.raises(EvaluationError, match="2 of 4 blocks held the speed"):
        compare(CostObjective(), session(0.8, 0.8, 0.8, notes={"reference": {}}), CONFIG)


# ---------------------------------------------------------------------------------------- both ways, several speeds


def test_the_final_entry_has_held_figures_and_those_at_equal_commands_beside():
    plain = {"notes": {"policy": {}, "reference": {}}}
    held_ones = session(0.5, 0.5, 0.5) + session(0.8, 0.8, 0.8)
    open_loop = session(0.5, 0.42, 0.5, cost=6.0, **plain) + session(0.8, 0.78, 0.8, cost=7.0, **plain)
    entry, segments, why = entry_both_ways(CostObjective(), held_ones, open_loop, CONFIG)
    assert {key: round(one["improvement"], 2) for key, one in entry["speeds"].items()} == {"0.5": 0.2, "0.8": 0.2}
    assert list(entry["open_loop"]["speeds"]) == ["0.8"] and "refused" not in entry and not why
    assert entry["open_loop"]["speeds"]["0.8"]["improvement"] == pytest.approx(0.3, abs=0.01)
    assert "0 of 40 segments of the policy are valid" in entry["open_loop"]["refused"]["0.5"]
    assert list(segments) == ["0.5", "0.8"]


def test_a_reference_that_cannot_be_held_at_one_speed_ends_nothing():
    limit = {"notes": {"reference": held(1.2, saturated=True)}}
    recordings = session(0.8, 0.8, 0.8) + session(1.1, 1.1, 1.0, **limit)
    plain = {"notes": {"policy": {}, "reference": {}}}
    entry, *_ = entry_both_ways(CostObjective(), recordings, session(0.8, 0.8, 0.8, **plain), CONFIG)
    assert list(entry["speeds"]) == ["0.8"] and "the reference policy cannot be held" in entry["refused"]["1.1"]


def test_with_nothing_to_report_in_either_way_there_is_no_result():
    plain = {"notes": {"policy": {}, "reference": {}}}
    with pytest.raises(SpeedNotHeld):
        entry_both_ways(CostObjective(), session(0.8, 0.85, 0.8), session(0.8, 0.5, 0.8, **plain), CONFIG)
    with pytest.raises(EvaluationError):
        walked_speeds(CostObjective(), session(0.8, 0.5, 0.8, **plain), CONFIG)


def test_a_candidate_counts_by_its_mean_over_the_speeds():
    recordings = session(0.5, 0.5, 0.5, cost=9.0) + session(0.8, 0.8, 0.8, cost=6.0)
    found = candidate_result("c", {"cost": CostObjective()}, recordings, CONFIG)
    assert list(found.entry["cost"]) == ["0.5", "0.8"]
    assert found.tested.comparisons["cost"].selection_score == pytest.approx((0.1 + 0.4) / 2, abs=0.01)


def test_a_candidate_that_is_refused_at_one_speed_is_refused():
    recordings = session(0.5, 0.5, 0.5) + session(0.8, 0.85, 0.8)
    found = candidate_result("c", {"cost": CostObjective()}, recordings, CONFIG)
    assert found.tested is None and found.refused.startswith("c: Head-to-head at 0.8 m/s: the speeds are 6")
    assert found.refusal["speed"] == 0.8


def test_halves_are_in_the_order_of_time_in_whatever_order_their_blocks_come():
    costs = (10.0, 8.0, 6.0, 10.0)  # the policy saves 0.2 and then 0.4
    blocks = [
        block(role, n, 0.8, 0.8, cost, held(0.8)) for n, (role, cost) in enumerate(zip(ORDER, costs, strict=True))
    ]
    for order in ((0, 1, 2, 3), (3, 2, 1, 0), (2, 0, 3, 1)):
        found = halves({"cost": CostObjective()}, [blocks[n] for n in order], CONFIG)
        assert [half["cost"].improvement for half in found] == pytest.approx([0.2, 0.4], abs=0.005)


def test_halves_of_a_round_at_two_speeds_are_means_over_the_speeds():
    first, second = session(0.5, 0.5, 0.5, cost=9.0), session(0.8, 0.8, 0.8, cost=6.0)
    found = halves({"cost": CostObjective()}, first + second, CONFIG)
    assert [half["cost"].improvement for half in found] == pytest.approx([0.25, 0.25], abs=0.01)
    gone = [block("policy", 1, 0.8, 0.5, 6.0, held(0.8)) if r is second[1] else r for r in second]
    assert halves({"cost": CostObjective()}, first + gone, CONFIG)[0] is None


def test_a_round_with_another_number_of_blocks_of_one_role_is_the_worlds_mistake():
    first, second = session(0.5, 0.5, 0.5, cost=9.0), session(0.8, 0.8, 0.8, cost=6.0)
    with pytest.raises(PluginError, match=r"2 and 1 at 0.5 m/s. Expected as many of both.*head_to_head_round"):
        halves({"cost": CostObjective()}, first[:3], CONFIG)
    shorter = second[:2]
    with pytest.raises(PluginError, match="2 and 2 at 0.5 m/s, 1 and 1 at 0.8 m/s"):
        halves({"cost": CostObjective()}, first + shorter, CONFIG)


def test_the_mean_leaves_out_what_not_every_speed_has():
    rows = [Comparison(0.1, 0.05, {"a": 1.0, "b": 2.0}), Comparison(0.3, 0.15, {"a": 3.0})]
    mean = mean_comparison(rows)
    assert (mean.improvement, mean.selection_score) == (pytest.approx(0.2), pytest.approx(0.1))
    assert mean.metrics == {"a": 2.0}


# -------------------------------------------------------------------------------------------------------- asking


def run_config(*overrides: str):
    return load_config(preset="smoke", objectives=["fake"], robot="fake", overrides=list(overrides))


def test_a_run_holds_within_the_commands_that_it_trains():
    assert hold_of(run_config()) is None
    low, high = CommandConfig().vx
    assert hold_of(run_config("evaluation.hold_speed=true")) == HoldSpeed((low, high), 12.0, 0.01)


@pytest.mark.parametrize("where", ["evaluation.speeds=[1.3]", "selection.speeds=[0.8, 1.3]"])
def test_a_speed_outside_the_trained_commands_is_refused_before_anything_is_spent(where):
    config = run_config("evaluation.hold_speed=true", "finetune.env.commands.vx=[0.4, 1.2]", where)
    with pytest.raises(ConfigError, match=r"1.3 m/s cannot be held with commands from 0.4 to 1.2 m/s"):
        check_hold(config)


def test_a_world_that_cannot_hold_a_speed_is_named():
    from hts.contracts import World

    class Plain(World):
        name = "plain"
        idle = collect = head_to_head = lambda *given: None

    ask_to_hold(Plain(), None)
    with pytest.raises(ConfigError, match="World 'plain' cannot hold a speed"):
        ask_to_hold(Plain(), HoldSpeed((0.4, 1.2)))


@pytest.mark.parametrize("speeds", ["[0.5, 0.5]", "[.nan]"])
def test_speeds_of_selection_are_finite_and_differ(speeds):
    with pytest.raises(ConfigError, match="speeds"):
        run_config(f"selection.speeds={speeds}")


def test_speeds_of_selection_are_above_zero():
    with pytest.raises(ConfigError, match=r"selection.speeds: expected a number greater than 0, found 0\."):
        VELOCITY.check(run_config("selection.speeds=[0.0]").selection.tested_speeds, "selection.speeds")


def test_speeds_that_training_does_not_hold_are_told_with_the_key_that_holds_them():
    go1, nothing_held = load().make_robot("go1"), load().make_robot("go1")
    nothing_held.held_at_zero = {}

    def told(*settings: str, robot: Robot = go1) -> str | None:
        speeds = ("evaluation.speeds=[0.2, 0.5]", "selection.speeds=[0.25, 0.8]")
        config = load_config(preset="quick", objectives=["power"], robot="go1", overrides=[*speeds, *settings])
        return not_held_in_training(config, robot)

    assert "0.2, 0.25 m/s" in told() and "held_from=0.2 or less" in told()
    assert "stand_below" not in told() and "stand_below=0.1 or less" in told("evaluation.speeds=[0.1]")
    assert "0.25" not in told("selection.speeds=[0.8]")
    assert told("finetune.env.commands.held_from=0.2") is None
    assert told("finetune.hold=false") is None
    assert told("evaluation.speeds=[0.5]", "selection.speeds=[0.5]") is None
    assert told(robot=nothing_held) is None


def test_speeds_that_the_final_alone_is_at_are_told_with_the_keys_that_try_them():
    def told(*settings: str) -> str | None:
        config = load_config(preset="quick", objectives=["power"], robot="go1", overrides=list(settings))
        return not_tried(config, load().make_robot("go1"))

    assert told() is None
    said = told("evaluation.speeds=[0.6, 0.8]")
    assert said.startswith("0.6 m/s: only the final") and "selection.speeds=[0.6, 0.8]" in said
    assert told("evaluation.speeds=[0.6, 0.8]", "selection.speeds=[0.6, 0.8]") is None


@pytest.mark.parametrize("preset", ["smoke", "quick", "paper", "paper-exact"])
@pytest.mark.parametrize("baseline", [False, True])
def test_presets_try_what_they_report_and_hold_it(preset, baseline):
    config = load_config(preset=preset, objectives=["power"], robot="go1", baseline=baseline)
    go1 = load().make_robot("go1")
    assert not_tried(config, go1) is None and not_held_in_training(config, go1) is None
