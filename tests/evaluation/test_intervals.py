"""Head-to-heads and their intervals, on worlds with known answers."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hts.config import EvaluationConfig
from hts.config_loading import dump_config, load_config
from hts.contracts import Comparison, World
from hts.errors import EvaluationError, PolicyError
from hts.evaluation.evaluate import evaluate_run, policy_file
from hts.evaluation.final import candidate_result, entry_of, head_to_heads, segment_scores
from hts.evaluation.head_to_head import TooFewSegments, compare
from hts.evaluation.intervals import _batch, _degrees, interval, lag_one_correlation, variance_of_mean
from hts.plugins import Entry, Registry
from hts.recordings.store import RecordingStore
from hts.testing.examples.robot.robot import Tiny
from hts.testing.made_up_recordings import CostObjective, known_head_to_head, known_recording

OBJECTIVE = CostObjective()
QUICK = EvaluationConfig(bootstrap=200)


def saving(policy: np.ndarray, reference: np.ndarray) -> float:
    return float(1 - policy[0] / reference[0])


def coverage(worlds: int, truth: float = 0.2, **world) -> float:
    """Share of simulated head-to-heads of an 8 against a 10 whose interval holds the true saving."""
    hits = 0
    for seed in range(worlds):
        costs = [
            recording.channels["cost"].values[20::10] for recording in known_head_to_head(8.0, 10.0, seed=seed, **world)
        ]
        blocks = [cost[:, None].astype(float) for cost in costs]  # after two seconds of settling, one number a second
        low, high = interval(saving, [blocks[0], blocks[3]], [blocks[1], blocks[2]], resamples=400, seed=seed)
        hits += low <= truth <= high
    return hits / worlds


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


@pytest.mark.parametrize(
    ("block_seconds", "correlation"), [(20, 0.0), (20, 0.5), (40, 0.6), (80, 0.0), (80, 0.5), (80, 0.8)]
)
def test_the_interval_holds_the_truth_about_nineteen_times_in_twenty(block_seconds, correlation):
    # 300 worlds: the standard deviation of this share is 1.3 %
    share = coverage(300, block_seconds=block_seconds, correlation=correlation, scatter=0.08)
    assert 0.90 <= share <= 0.99


def test_a_drift_does_not_make_the_interval_overconfident():
    # a rise by 1 in all adds 0.5 to both means: 8.5 against 10.5
    share = coverage(200, truth=1 - 8.5 / 10.5, block_seconds=40, correlation=0.5, scatter=0.05, drift=1.0)
    assert share >= 0.90


def test_resampling_single_segments_would_be_overconfident():
    # what the batches are for: were the correlation taken as zero, the interval would hold the truth far too rarely
    hits = 0
    for seed in range(200):
        costs = [
            r.channels["cost"].values[20::10]
            for r in known_head_to_head(8.0, 10.0, seed=seed, scatter=0.08, correlation=0.8)
        ]
        shuffled = [np.random.default_rng(seed).permutation(cost)[:, None].astype(float) for cost in costs]
        low, high = interval(saving, [shuffled[0], shuffled[3]], [shuffled[1], shuffled[2]], resamples=200, seed=seed)
        hits += low <= 0.2 <= high
    assert hits / 200 < 0.75


def test_more_alike_neighbours_give_a_wider_interval():
    widths = []
    for correlation in (0.0, 0.8):
        low, high = compare(
            OBJECTIVE, known_head_to_head(8.0, 10.0, scatter=0.05, correlation=correlation), QUICK
        ).improvement_ci95
        widths.append(high - low)
    assert widths[1] > 1.5 * widths[0]


def test_the_same_seed_gives_the_same_interval_and_another_one_another():
    recordings = known_head_to_head(8.0, 10.0, scatter=0.05)
    first, again, other = (compare(OBJECTIVE, recordings, QUICK, seed).improvement_ci95 for seed in (1, 1, 2))
    assert first == again != other


def test_the_order_in_which_recordings_come_does_not_matter():
    recordings = known_head_to_head(8.0, 10.0, scatter=0.05)
    assert compare(OBJECTIVE, recordings, QUICK).entry() == compare(OBJECTIVE, recordings[::-1], QUICK).entry()


def test_the_variance_of_a_mean_of_neighbours_is_as_on_paper():
    assert variance_of_mean(4, 0.0) == pytest.approx(1 / 4)
    # two neighbours with correlation 1/2: (1 + 1 + 2·1/2) / 4
    assert variance_of_mean(2, 0.5) == pytest.approx(3 / 4)
    # three: (3 + 2·(1/2 + 1/2 + 1/4)) / 9
    assert variance_of_mean(3, 0.5) == pytest.approx(5.5 / 9)


def test_the_lag_one_correlation_of_a_known_series_is_found():
    costs = [
        r.channels["cost"].values[::10]
        for r in known_head_to_head(1.0, 1.0, block_seconds=500, scatter=0.1, correlation=0.6)
    ]
    assert lag_one_correlation(costs) == pytest.approx(0.6, abs=0.05)
    assert lag_one_correlation([np.ones(20)]) == 0.0


def test_one_segment_each_leaves_no_interval():
    one = [np.array([[1.0]])]
    assert interval(saving, one, one) is None


def test_single_segments_of_several_blocks_still_give_one():
    low, high = interval(
        saving, [np.array([[8.0]]), np.array([[8.4]])], [np.array([[10.0]]), np.array([[10.2]])], seed=1
    )
    assert low < 1 - 8.2 / 10.1 < high


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
    config = load_config(preset="quick", objectives=["cost"], robot="example", world="known", overrides=plain)
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
        robots={"example": Entry("example", lambda settings: Tiny(), "tests")},
        worlds={"known": Entry("known", lambda settings, context: world, "tests")},
    )


def test_hts_evaluate_writes_what_the_world_gave(run_folder):
    result = evaluate_run(run_folder, speeds=[0.5, 0.8], registry=registry())
    assert json.loads((run_folder / "evaluation.json").read_text()) == result
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


@pytest.mark.parametrize("left", [2, 3, 5, 13])
@pytest.mark.parametrize("correlation", [0.0, 0.3])
def test_a_block_with_few_segments_left_counts_as_much_and_makes_it_wide_enough(left, correlation):
    """Two equal policies of 38 and `left` segments, and of 38 and 38; 400 of them: 1.1 % of standard deviation."""
    rng, hits = np.random.default_rng(left), 0
    for seed in range(400):
        policy, reference = ([walk(rng, count, correlation) for count in counts] for counts in ((38, left), (38, 38)))
        low, high = interval(lambda one, other: float(1 - one[0] / other[0]), policy, reference, 200, seed)
        hits += low <= 0 <= high
    assert hits / 400 > 0.91


def walk(rng, count, correlation):
    """An AR(1) series about 1, (count, 1)."""
    found = [rng.standard_normal()]
    for shock in rng.standard_normal(count - 1):
        found.append(correlation * found[-1] + np.sqrt(1 - correlation**2) * shock)
    return 1 + 0.1 * np.array(found)[:, None]


def test_degrees_of_freedom_are_batches_less_blocks_where_all_are_of_one_length():
    blocks = [[_batch(np.random.default_rng(0).random((40, 1)), 0.0)] * 2] * 2
    assert _degrees(blocks, 0.0) == pytest.approx(4 * (len(blocks[0][0][1]) - 1))


def test_what_cannot_be_compared_in_some_draw_has_no_interval():
    few = [np.array([[1.0], [1.0], [1.0], [-2.9], [1.0]])]

    def log_of(policy, reference):
        return float(np.log(policy[0])) if policy[0] > 0 else float("nan")

    assert interval(log_of, few, few, 200) is None
