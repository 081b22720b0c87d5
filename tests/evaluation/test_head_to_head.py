"""Head-to-heads and `hts evaluate`, on worlds with known answers."""

from __future__ import annotations

import json

import pytest

from hts.config import EvaluationConfig
from hts.config_loading import dump_config, load_config
from hts.contracts import Comparison, World
from hts.errors import EvaluationError, PolicyError
from hts.evaluation.evaluate import evaluate_run, policy_file
from hts.evaluation.final import candidate_result, entry_of, head_to_heads, segment_scores
from hts.evaluation.head_to_head import TooFewSegments, compare
from hts.plugins import Entry, Registry
from hts.recordings.store import RecordingStore
from hts.testing.examples.robot.robot import Tiny
from hts.testing.made_up_recordings import CostObjective, known_head_to_head, known_recording

OBJECTIVE = CostObjective()
QUICK = EvaluationConfig(bootstrap=200)


def test_an_eight_against_a_ten_is_a_saving_of_twenty_percent():
    result = compare(OBJECTIVE, known_head_to_head(8.0, 10.0), QUICK)
    assert result.improvement == pytest.approx(0.2)
    assert result.improvement_ci95 == pytest.approx((0.2, 0.2), abs=1e-6)
    assert (len(result.policy_segments), result.falls, result.valid) == (76, 0, 1.0)
    assert result.mean_speed == pytest.approx(0.8)


def test_idle_is_subtracted_from_net_but_not_from_gross():
    result = compare(OBJECTIVE, known_head_to_head(8.0, 10.0, idle=5.0), QUICK)
    assert result.improvement == pytest.approx(0.2)
    assert result.comparison.metrics["gross_reduction"] == pytest.approx(1 - 13 / 15)


def test_a_steady_drift_cancels_in_abba_but_not_in_abab():
    # all rises by 4 over four blocks of 40 s; in A-B-A-B the policy's blocks come 40 s earlier, which is worth 1
    abba = compare(OBJECTIVE, known_head_to_head(10.0, 10.0, drift=4.0), QUICK)
    abab = compare(OBJECTIVE, known_head_to_head(10.0, 10.0, drift=4.0, order="ABAB"), QUICK)
    assert abba.improvement == pytest.approx(0.0, abs=1e-6)
    reference = abab.reference_scores["net_cost"].mean()
    assert abab.improvement == pytest.approx(1.0 / reference, rel=1e-4)


def test_too_few_valid_segments_are_refused_in_one_line():
    recordings = known_head_to_head(8.0, 10.0)
    slow = [r if r.role == "reference" else known_recording([8.0] * 40, speed=0.6, block=r.block) for r in recordings]
    with pytest.raises(
        EvaluationError, match=r"^Head-to-head at 0.8 m/s: 0 of 76 segments of the policy are valid"
    ) as error:
        compare(OBJECTIVE, slow, QUICK)
    assert "\n" not in str(error.value)


def test_a_short_head_to_head_is_refused_even_if_all_of_it_is_valid():
    with pytest.raises(TooFewSegments, match="6 of 6 segments"):
        compare(OBJECTIVE, known_head_to_head(8.0, 10.0, block_seconds=5), QUICK)


def test_a_head_to_head_without_reference_is_refused():
    with pytest.raises(EvaluationError, match="no recording has the role 'reference'"):
        compare(OBJECTIVE, [known_recording([1.0] * 40)], QUICK)


def test_two_commanded_speeds_at_once_are_refused():
    recordings = known_head_to_head(8.0, 10.0) + known_head_to_head(8.0, 10.0, vx=0.5)
    with pytest.raises(EvaluationError, match="command 0.5, 0.8 m/s"):
        compare(OBJECTIVE, recordings, QUICK)


def test_a_reference_that_costs_nothing_is_refused():
    with pytest.raises(EvaluationError, match="cannot compare .* division by zero"):
        compare(OBJECTIVE, known_head_to_head(8.0, 0.0), QUICK)


def test_an_improvement_that_is_not_a_number_is_refused_and_named():
    class Undefined(CostObjective):
        def compare(self, policy, reference):
            return Comparison(float("nan"), 0.0)

    with pytest.raises(EvaluationError, match="'improvement' of the comparison is nan"):
        compare(Undefined(), known_head_to_head(8.0, 10.0), QUICK)


def test_falls_of_the_policy_are_counted_apart_from_the_reference_s():
    recordings = known_head_to_head(8.0, 10.0)
    recordings[0] = known_recording([8.0] * 40, block=0, fell_at=30.0)
    entry = compare(OBJECTIVE, recordings, QUICK).entry()
    assert (entry["falls"], entry["reference"]["falls"]) == (1, 0)
    assert entry["segments"] == 38 + 27


def test_seconds_that_the_speed_rule_leaves_out_are_in_every_second():
    """A quarter of the policy's seconds run at 1.0 m/s instead of 0.8 and cost 14 instead of 8."""
    recordings = known_head_to_head(8.0, 10.0)
    fast, speed = [8.0] * 40, [0.8] * 40
    fast[30:], speed[30:] = [14.0] * 10, [1.0] * 10
    recordings[0] = known_recording(fast, speed=speed, block=0)
    recordings[3] = known_recording(fast, speed=speed, block=3, start=120.0)
    entry = compare(OBJECTIVE, recordings, QUICK).entry()
    assert entry["improvement"] == pytest.approx(0.2) and entry["segments"] == 56
    every = entry["every_second"]
    assert every["improvement"] == pytest.approx(1 - (56 * 8 + 20 * 14) / 76 / 10)
    assert every["improvement_ci95"][0] < every["improvement"] < every["improvement_ci95"][1]
    assert every["mean_speed"] == pytest.approx((56 * 0.8 + 20 * 1.0) / 76)
    assert every["reference_mean_speed"] == pytest.approx(0.8)


def test_where_all_seconds_count_every_second_says_the_same():
    entry = compare(OBJECTIVE, known_head_to_head(8.0, 10.0, scatter=0.05), QUICK).entry()
    assert entry["valid"] == entry["reference"]["valid"] == 1.0
    assert {key: entry["every_second"][key] for key in ("improvement", "improvement_ci95")} == {
        key: entry[key] for key in ("improvement", "improvement_ci95")
    }


def test_an_objective_that_has_no_number_of_seconds_at_other_speeds_keeps_its_result():
    class Picky(CostObjective):
        def score(self, segments):
            if segments.speed.max() > 0.9:
                raise EvaluationError("too fast for this objective")
            return super().score(segments)

    recordings = known_head_to_head(8.0, 10.0)
    recordings[0] = known_recording([8.0] * 40, speed=[0.8] * 30 + [1.0] * 10, block=0)
    entry = compare(Picky(), recordings, QUICK).entry()
    assert entry["improvement"] == pytest.approx(0.2) and entry["every_second"] is None


def test_the_final_entry_has_the_keys_of_the_summary():
    entry = entry_of(OBJECTIVE, {0.8: compare(OBJECTIVE, known_head_to_head(8.0, 10.0), QUICK)})
    assert entry["unit"] == "1"
    speed = entry["speeds"]["0.8"]
    assert {"improvement", "improvement_ci95", "segments", "falls", "mean_speed", "metrics"} <= set(speed)
    assert len(speed["improvement_ci95"]) == 2
    assert set(speed["metrics_ci95"]) == set(speed["metrics"])


def test_several_speeds_are_compared_each_for_itself():
    recordings = known_head_to_head(8.0, 10.0, vx=0.5) + known_head_to_head(9.0, 10.0, vx=1.0)
    results = head_to_heads(OBJECTIVE, recordings, QUICK)
    assert {speed: round(result.improvement, 6) for speed, result in results.items()} == {0.5: 0.2, 1.0: 0.1}
    scores = segment_scores(results)
    assert scores["1.0"]["policy"]["net_cost"] == pytest.approx([9.0] * 76)


def test_a_candidate_gets_its_entry_and_its_comparison():
    result = candidate_result("c1", {"cost": OBJECTIVE}, known_head_to_head(8.0, 10.0), QUICK)
    assert result.entry["cost"]["0.8"]["improvement"] == pytest.approx(0.2)
    assert result.tested.comparisons["cost"].selection_score == pytest.approx(0.2)
    assert (result.tested.fell, result.refused) == (False, None)


def test_a_candidate_that_does_not_walk_is_a_result_and_not_an_error():
    recordings = known_head_to_head(8.0, 10.0)
    recordings = [
        r if r.role == "reference" else known_recording([8.0] * 40, speed=0.0, block=r.block) for r in recordings
    ]
    result = candidate_result("c1", {"cost": OBJECTIVE}, recordings, QUICK)
    assert result.entry is None and result.tested is None
    assert result.refused.startswith("c1: Head-to-head at 0.8 m/s: 0 of 76")


def half_of_the_time(role: str):
    """Recordings of a head-to-head in which one of the two stands in one of its two blocks."""
    recordings = known_head_to_head(8.0, 10.0)
    block = next(r.block for r in recordings if r.role == role)
    standing = known_recording([8.0] * 40, speed=0.0, block=block, role=role)
    return [standing if r.block == block else r for r in recordings]


def test_a_trial_may_ask_for_more_valid_segments_than_the_final():
    recordings = half_of_the_time("policy")
    assert candidate_result("c1", {"cost": OBJECTIVE}, recordings, QUICK, min_valid=0.5).refused is None
    result = candidate_result("c1", {"cost": OBJECTIVE}, recordings, QUICK, min_valid=0.6)
    assert result.tested is None and result.refusal["valid"] == 0.5
    assert result.refused.startswith("c1: Head-to-head at 0.8 m/s: 38 of 76 segments of the policy are valid")
    assert "60% of them (selection.min_valid)" in result.refused


def test_a_trial_asks_no_more_of_the_reference():
    recordings = half_of_the_time("reference")
    assert candidate_result("c1", {"cost": OBJECTIVE}, recordings, QUICK, min_valid=0.9).refused is None


def test_a_reference_that_does_not_walk_is_why_nothing_can_be_said():
    recordings = known_head_to_head(8.0, 10.0)
    recordings = [
        r if r.role == "policy" else known_recording([8.0] * 40, speed=0.0, block=r.block, role="reference")
        for r in recordings
    ]
    result = candidate_result("c1", {"cost": OBJECTIVE}, recordings, QUICK)
    assert result.tested is None and result.refusal is None  # it says nothing about the candidate
    assert isinstance(result.reference, TooFewSegments) and "of the reference policy are valid" in result.refused
    assert "evaluation.hold_speed" not in result.refused  # no command makes somebody walk who stands


def test_where_neither_walks_the_refusal_says_so_of_the_reference_too():
    recordings = [
        known_recording([8.0] * 40, speed=0.2 if r.role == "policy" else 0.3, block=r.block, role=r.role)
        for r in known_head_to_head(8.0, 10.0)
    ]
    result = candidate_result("c1", {"cost": OBJECTIVE}, recordings, QUICK)
    assert "segments of the policy are valid" in result.refused
    assert result.refused.endswith("The reference policy has too few as well.")
    assert result.refusal["walked"] == pytest.approx(0.2) and result.refusal["reference_walked"] == pytest.approx(0.3)


@pytest.mark.parametrize(("held", "advised"), [(False, True), (True, False)])
def test_a_reference_that_goes_another_speed_may_be_trimmed(held, advised):
    recordings = [
        r if r.role == "policy" else known_recording([8.0] * 40, speed=0.7, block=r.block, role="reference")
        for r in known_head_to_head(8.0, 10.0)
    ]
    config = QUICK.model_copy(update={"hold_speed": held})
    with pytest.raises(TooFewSegments, match="it went 0.70 m/s on average") as found:
        head_to_heads(OBJECTIVE, recordings, config)
    assert ("have commands trimmed: evaluation.hold_speed" in str(found.value)) is advised


# ------------------------------------------------------------------------------------------ hts evaluate


class KnownWorld(World):
    """Saves 20 % at every speed, or falls at once."""

    name = "known"
    walks = True

    def idle(self):
        return {"cost": 0.0}

    def collect(self, policies, schedule):
        return []

    def head_to_head(self, policy, reference, speeds):
        assert (policy.name, reference.name) == ("best.onnx", "pretrained.onnx")
        seconds = 40 if self.walks else 3
        return [
            r for speed in speeds for r in known_head_to_head(8.0, 10.0, vx=speed, block_seconds=seconds, scatter=1e-4)
        ]


@pytest.fixture
def run_folder(tmp_path):
    plain = ["evaluation.hold_speed=false"]
    config = load_config(preset="quick", objectives=["cost"], robot="tiny", world="known", overrides=plain)
    (tmp_path / "config.yaml").write_text(dump_config(config))
    (tmp_path / "policies").mkdir()
    for name in ("best", "pretrained"):
        (tmp_path / "policies" / f"{name}.onnx").write_bytes(b"")
    return tmp_path


def registry(walks: bool = True) -> Registry:
    world = KnownWorld()
    world.walks = walks
    return Registry(
        objectives={"cost": Entry("cost", lambda settings: CostObjective(), "tests")},
        robots={"tiny": Entry("tiny", lambda settings: Tiny(), "tests")},
        worlds={"known": Entry("known", lambda settings, context: world, "tests")},
    )


def test_hts_evaluate_writes_what_the_world_gave(run_folder):
    result = evaluate_run(run_folder, speeds=[0.5, 0.8], registry=registry())
    assert json.loads((run_folder / "evaluation.json").read_text()) == result
    assert result["policy"] == "best"  # whose the numbers are, where none was named
    speeds = result["objectives"]["cost"]["speeds"]
    assert [speeds[key]["improvement"] for key in ("0.5", "0.8")] == pytest.approx([0.2, 0.2], abs=1e-3)
    assert len(RecordingStore(run_folder / "evaluation" / "data.zarr").ids()) == 8


def test_hts_evaluate_writes_no_result_when_it_refuses_to_report(run_folder):
    with pytest.raises(TooFewSegments):
        evaluate_run(run_folder, speeds=[0.8], registry=registry(walks=False))
    assert not (run_folder / "evaluation.json").exists()


def test_a_policy_that_is_not_there_is_refused(run_folder):
    with pytest.raises(PolicyError, match="No policy named 'bets'"):
        policy_file(run_folder, "bets")


def test_a_policy_file_of_another_kind_is_refused(run_folder):
    with pytest.raises(PolicyError, match="ending in .onnx or .safetensors"):
        policy_file(run_folder, "somewhere/policy.pt")


def test_hts_evaluate_twice_with_one_seed_gives_the_same_result(run_folder):
    first = evaluate_run(run_folder, speeds=[0.8], registry=registry())
    assert evaluate_run(run_folder, speeds=[0.8], registry=registry()) == first


@pytest.mark.parametrize("simulated", [False, True])
def test_hts_evaluate_says_where_a_robots_logs_are_those_of_an_earlier_evaluation(run_folder, simulated):
    said: list[str] = []
    known = registry()
    known.make_world("known", {}, None).simulated = simulated  # the registry has one world
    (run_folder / "policies" / "best.onnx").write_bytes(b"another")
    for speeds in ([0.8], [0.5, 0.8]):
        evaluate_run(run_folder, speeds=speeds, registry=known, say=said.append)
    assert said == []
    evaluate_run(run_folder, speeds=[0.8], registry=known, say=said.append)
    assert [str(run_folder / "evaluation") in line for line in said] == ([] if simulated else [True])
