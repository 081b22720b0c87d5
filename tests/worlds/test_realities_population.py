"""The sampler of draws like a lab's robot, on a machine whose figures are formulas: quick, and its answer is known."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from scipy.special import ndtri

from hts import plugins
from hts.errors import RunError
from hts.worlds.realities import posterior_like, sampler
from hts.worlds.realities.batch import exported_policy
from hts.worlds.realities.like import Figure, Likeness
from hts.worlds.realities.misfit import in_tolerances
from hts.worlds.realities.population import KEPT, Asked, done, draw_like, weights_of
from hts.worlds.realities.ranges import drawn_parameters
from hts.worlds.realities.sampler import Found, Particle
from hts.worlds.realities.space import Space
from hts.worlds.twin.reality import read

RESISTANCE, IDLE = "instruments.battery_gauge.phase_resistance", "instruments.battery_gauge.idle_power"
MASS, PAYLOAD = "dynamics.trunk_mass_scale", "dynamics.structure.payload_mass"


def figure(name, value, share=0.05, speed=0.5):
    low, high = value * (1 - share), value * (1 + share)
    about = {"instrument": "battery_gauge", "reading": name, "speed": speed, "asked": speed, "unit": "W"}
    return Figure(name=name, value=value, low=low, high=high, stretches=4, **about)


FIGURES = (figure("idle", 26.0, speed=0.0), figure("standing", 55.0, speed=0.0), figure("walking", 108.0, 0.04))


@pytest.fixture(scope="module")
def parameters():
    return drawn_parameters(plugins.load())


class Formulas:
    """Instead of twins: idle, standing and walking power of a draw; heavy robots fall."""

    def __init__(self, parameters):
        self.space, self.simulated = Space(parameters), 0

    def shown(self, point):
        values = self.space.draw(point).values
        load = 10.5 * values[MASS] + values.get(PAYLOAD, 0.0)
        standing = values[IDLE] + 2.0 * values[RESISTANCE] * load**2
        return {"idle": values[IDLE], "standing": standing, "walking": standing + 3.0 * load + 200 * values[RESISTANCE]}

    def free(self, point):
        return in_tolerances(FIGURES[0], self.shown(point)["idle"])

    def simulate(self, point, bound):
        self.simulated += 1
        if self.space.draw(point).values[MASS] > 1.28:
            return Found(math.inf, {}, "fell at 0.5 m/s")
        shown = self.shown(point)
        distance = max(in_tolerances(one, shown[one.name]) for one in FIGURES)
        return Found(distance if distance <= bound else math.inf, shown, "")

    def work(self, asked, tasks, processes, within):
        for task in tasks:
            yield done(asked, task, within, self)


@pytest.fixture
def asked():
    like = Likeness(figures=FIGURES, schedule=None)
    return Asked(6, "s", "go1", "like", "", like, size=40, steps=3)


def test_every_point_is_a_draw_inside_the_ranges_and_the_prior_is_that_of_draws(parameters):
    space, rng = Space(parameters), np.random.default_rng(1)
    draws = [space.draw(space.prior(rng)) for _ in range(300)]
    for one in parameters:
        values = [value for draw in draws if one.key in draw.values for value in np.ravel(draw.values[one.key])]
        assert all(one.boolean or one.low <= value <= one.high for value in values)
    on = [len(draw.switches) for draw in draws]
    assert np.mean(on) == pytest.approx(len(space.switches) / 2, abs=0.5)
    for one in (one for one in parameters if one.counts):
        assert {len(draw.values[one.key]) for draw in draws} == set(range(one.counts[0], one.counts[1] + 1))


@pytest.mark.parametrize("step", [0.2, 1.0])
def test_moves_leave_the_prior_as_it_is(parameters, step):
    space, rng = Space(parameters), np.random.default_rng(2)
    points = np.array([space.prior(rng) for _ in range(400)])
    for _ in range(10):
        points = np.array([space.moved(point, step, rng) for point in points])
    # mean and variance of a uniform number: 1/2 and 1/12, in 400 samples to 0.014 and 0.004 each
    assert np.abs(points.mean(axis=0) - 0.5).max() < 0.07
    assert np.abs(points.var(axis=0) - 1 / 12).max() < 0.02


def test_a_move_is_as_likely_back_as_forth(parameters):
    """Of two halves of one coordinate under the prior, as many moves go from the first to the second as back."""
    space, rng = Space(parameters[:3]), np.random.default_rng(3)
    before = np.array([space.prior(rng) for _ in range(4000)])
    after = np.array([space.moved(point, 0.7, rng) for point in before])
    low, high = before[:, 0] < 0.3, after[:, 0] < 0.3
    forth, back = (low & ~high).sum(), (~low & high).sum()
    assert forth > 100 and abs(forth - back) < 4 * math.sqrt(forth + back)


def test_what_is_kept_reproduces_the_figures_and_is_the_posterior_of_plain_rejection(tmp_path, asked, parameters):
    machine = Formulas(parameters)
    size = 100
    large = dataclasses.replace(asked, size=size, count=size)
    files = draw_like(large, tmp_path / "draws", work=machine.work)
    weights = weights_of(tmp_path / "draws")
    assert sum(weights.values()) == pytest.approx(1) and set(weights) == {path.stem for path in files}
    for path in files:
        found = read(str(path))
        assert {one.name for one in found.facts} == {"idle", "standing", "walking"}
        assert all(one.low <= one.value <= one.high for one in found.facts)
    plain = rejected(parameters, np.random.default_rng(4), 400_000)
    rows = [json.loads(text) for text in (tmp_path / "draws/draws.jsonl").read_text().splitlines()[-size:]]
    assert all(row["distance"] <= 1 for row in rows)
    ours = ndtri(np.array([row["point"] for row in rows]))
    assert len(plain[IDLE]) > 1000
    for key, values in plain.items():
        there = ours[:, machine.space.at[key]]
        assert abs(there.mean() - values.mean()) < 0.5 * values.std(), key
        assert there.std() == pytest.approx(values.std(), rel=0.4), key


def rejected(parameters, rng, count):
    """What plain rejection keeps, of the same formulas at once: coordinate -> normal scores."""
    by_key = {one.key: one for one in parameters}
    shares = {key: rng.random(count) for key in (IDLE, RESISTANCE, MASS, PAYLOAD, "switch payload")}

    def value(key):
        one, share = by_key[key], shares[key]
        return one.low * (one.high / one.low) ** share if one.logarithmic else one.low + (one.high - one.low) * share

    load = 10.5 * value(MASS) + np.where(shares["switch payload"] < 0.5, value(PAYLOAD), 0.0)
    standing = value(IDLE) + 2.0 * value(RESISTANCE) * load**2
    shown = {"idle": value(IDLE), "standing": standing, "walking": standing + 3.0 * load + 200 * value(RESISTANCE)}
    kept = value(MASS) <= 1.28
    for one in FIGURES:
        kept &= np.abs(shown[one.name] - one.value) <= (one.high - one.low) / 2
    return {key: ndtri(share[kept]) for key, share in shares.items()}


def test_it_goes_on_where_it_was_stopped_and_ends_the_same(tmp_path, asked, parameters):
    whole = draw_like(asked, tmp_path / "whole", work=Formulas(parameters).work)
    broken, told = tmp_path / "broken", []

    def torn(*given):
        for number, particle in enumerate(Formulas(parameters).work(*given)):
            if number == 13:
                raise KeyboardInterrupt
            yield particle

    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            draw_like(asked, broken, work=torn, tell=told.append)
    lines = broken / "draws.jsonl"
    lines.write_text(lines.read_text() + '{"generation": 1, "pla')  # killed in the midst of a line
    again = draw_like(asked, broken, work=Formulas(parameters).work, tell=told.append)
    assert [path.name for path in again] == [path.name for path in whole]
    assert lines.read_text() == (tmp_path / "whole/draws.jsonl").read_text()
    assert (broken / KEPT).read_text() == (tmp_path / "whole" / KEPT).read_text()
    assert "generation 0, 1 of 40: " in told[0] and "1 simulations" in told[0]
    last = Formulas(parameters)
    assert draw_like(asked, broken, work=last.work) == again and last.simulated == 0


def test_a_budget_ends_it_with_what_it_reached_and_more_goes_on(tmp_path, asked, parameters):
    machine = Formulas(parameters)
    with pytest.raises(RunError, match=r"200 simulations are spent; all draws are within [\d.]+ tolerances.*--budget"):
        draw_like(asked, tmp_path, budget=200, work=machine.work)
    spent = machine.simulated
    assert 200 <= spent < 200 + 1 + asked.steps and not (tmp_path / KEPT).exists()
    with pytest.raises(RunError, match="200 simulations are spent"):
        draw_like(asked, tmp_path, budget=200, work=machine.work)
    assert machine.simulated == spent
    assert draw_like(asked, tmp_path, budget=5000, work=machine.work) and (tmp_path / KEPT).exists()


def test_a_folder_is_gone_on_with_only_by_the_figures_it_was_begun_with(tmp_path, asked, parameters):
    draw_like(asked, tmp_path, work=Formulas(parameters).work)
    other = Likeness(figures=FIGURES[:2], schedule=None)
    with pytest.raises(RunError, match="was begun with other figures of a robot"):
        draw_like(dataclasses.replace(asked, like=other), tmp_path)
    with pytest.raises(RunError, match="was begun with another size"):
        draw_like(dataclasses.replace(asked, size=9), tmp_path)


def test_what_it_took_and_what_moved_is_shown(tmp_path, asked, parameters):
    draw_like(asked, tmp_path, work=Formulas(parameters).work)
    assert posterior_like.is_population(tmp_path)
    said = posterior_like.accepted(tmp_path)
    assert said.startswith("kept 6 realities within 1.00 tolerances") and "of the moves accepted" in said
    text = posterior_like.text(parameters, tmp_path)
    assert "| generation | within | simulations | moves accepted |" in text and "| 0 | prior | 40 |" in text
    rows = [line.split("|")[1].strip() for line in text.splitlines() if line.startswith("| `")]
    assert f"`{IDLE}`" in rows[:4] and f"`{RESISTANCE}`" in rows[:4]  # those that the formulas hang on
    assert "| idle, W | 26 | ± 1.3 |" in text and "| `payload` | 50 % |" in text and "| like-00 | 0." in text


def test_idle_levels_outside_of_all_ranges_are_one_line(parameters):
    space = Space(parameters)
    with pytest.raises(RunError, match="has the idle levels of these recordings.*hts realities ranges"):
        sampler.first(space, lambda point: 9.0, 1.0, lambda point, bound: Found(0.0), np.random.default_rng(0))


def test_who_falls_or_is_beyond_gives_its_place_to_who_agrees():
    distances = [0.5, math.inf, 2.0, 4.0, 9.0, 0.9]
    bound = sampler.next_bound(distances, 1.0)
    assert bound == 2.0  # the third of six
    begins = sampler.ancestors(distances, bound, np.random.default_rng(0))
    assert [begins[at] for at in (0, 2, 5)] == [0, 2, 5] and sorted(begins[at] for at in (1, 3, 4)) == [0, 2, 5]
    assert sampler.next_bound([0.1, 0.2, 0.3], 1.0) == 1.0
    with pytest.raises(RunError, match="1 of 3 draws walked at all"):
        sampler.next_bound([math.inf, 3.0, math.inf], 1.0)


def test_weights_are_copies_and_few_are_taken_in_their_proportion():
    def at(value):
        return Particle(np.array([value]), Found(0.1), 1, 1)

    weights = sampler.copies([at(1.0), at(2.0), at(1.0), at(1.0)])
    assert weights == {0: 0.75, 1: 0.25}
    assert sampler.chosen(weights, 4, np.random.default_rng(0)) == weights
    many = {index: 0.5 if index == 0 else 0.5 / 50 for index in range(51)}
    taken = sampler.chosen(many, 10, np.random.default_rng(0))
    assert taken[0] == pytest.approx(0.5, abs=0.11) and sum(taken.values()) == pytest.approx(1)


def test_steps_grow_where_most_is_accepted_and_shrink_where_little_is():
    def moved(accepted):
        return [Particle(np.zeros(1), Found(0.1), 10, accepted)]

    assert sampler.next_step(0.4, moved(8)) > 0.4 > sampler.next_step(0.4, moved(1)) > 0
    assert sampler.next_step(0.4, [Particle(np.zeros(1), Found(0.1), 0, 0)]) == 0.4


@pytest.mark.slow
def test_draws_of_twins_are_the_same_from_one_process_and_two(tmp_path, parameters):
    """Real ones, with tolerances so wide that two generations do."""
    policy = exported_policy("go1", tmp_path)
    known = [("idle power", 0.0, 33.0, True), ("gross power", 0.5, 120.0, False)]
    figures = tuple(
        figure(name, value, share=0.6, speed=speed).model_copy(update={"idle": idle})
        for name, speed, value, idle in known
    )
    asked = Asked(2, "s", "go1", "like", str(policy), Likeness(figures=figures, schedule=None), size=3, steps=1)
    files = [draw_like(asked, tmp_path / str(number), within=1.0, processes=number) for number in (1, 2)]
    assert files[0] and [path.read_text() for path in files[0]] == [path.read_text() for path in files[1]]
    found = read(str(files[0][0]))
    assert [one.name for one in found.facts] == ["idle power", "gross power"]
    assert all(one.low <= one.value <= one.high for one in found.facts)
