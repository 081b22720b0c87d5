"""The instrument `microphone`: what it shows of steps, drives and room."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from hts import plugins
from hts.contracts import PhysicsSample
from hts.worlds.realities.draw import draw
from hts.worlds.realities.ranges import drawn_parameters
from hts.worlds.twin.reality import read
from hts_noise.acoustics import decibels, squared_pressure
from hts_noise.microphone import Microphone
from hts_noise.microphone_parameters import MicrophoneParameters

DT = 0.001
# A meter without errors, steps without scatter.
PLAIN = {
    "reading_noise": 0.0,
    "resolution": 0.0,
    "calibration_error": 0.0,
    "step_scatter": 0.0,
    "contact_scatter": 0.0,
}


@pytest.fixture(scope="module")
def spec():
    return plugins.load().make_robot("go1").spec


def microphone(spec, worlds: int = 1, seed: int = 0, **changes) -> Microphone:
    made = Microphone(MicrophoneParameters(**{**PLAIN, **changes}), spec)
    made.reset(worlds, np.random.default_rng(seed))
    return made


def walk(made: Microphone, speed: np.ndarray, seconds: float = 1.0, every: int = 20, land=(10,), joint_speed=0.0):
    """Levels (frames, W), read every so many ms. speed (W, F): of each foot when it touches down, at the steps of
    `land`, for 5 ms; 0: stays in the air. Effective mass 0.55 kg, torque 0."""
    speed = np.atleast_2d(np.asarray(speed, dtype=float))
    joints = np.full((len(speed), made.spec.num_joints), joint_speed)
    levels = []
    for step in range(round(seconds / DT)):
        down = any(first <= step < first + 5 for first in land)
        force = np.where(down & (speed > 0), 50.0, 0.0)
        made.step(PhysicsSample(0 * joints, joints, force, speed, np.full(speed.shape, 0.55), DT))
        if (step + 1) % every == 0:
            levels.append(made.read()["sound_level"])
    return np.array(levels)


def test_twice_as_far_from_the_drives_is_six_decibels_less(spec):
    still = np.zeros((1, 4))
    near, far = (
        walk(microphone(spec, distance=d, room_level=30.0, drive_level=55.0), still, joint_speed=10.0)[-1]
        for d in (1.0, 2.0)
    )
    drives = [10 ** (level / 10) - 10**3.0 for level in (near, far)]  # without the room's 30 dB
    assert drives[0] / drives[1] == pytest.approx(4.0, rel=0.01)  # a quarter of the squared pressure


def test_the_room_alone_has_the_rooms_level(spec):
    made = microphone(spec)
    assert walk(made, np.zeros((1, 4))) == pytest.approx(38.0)
    assert made.idle() == {"sound_level": 38.0}


def test_a_meter_that_is_off_is_off_idle_too(spec):
    made = microphone(spec, calibration_error=0.3)
    assert walk(made, np.zeros((1, 4))) == pytest.approx(38.3)
    assert made.idle() == {"sound_level": pytest.approx(38.3)}


def test_the_reference_step_peaks_at_its_level(spec):
    # 10 log10(10^6.75 + 10^3.8): the room adds 0.005 dB
    peak = walk(microphone(spec), [0.4, 0, 0, 0], every=1, seconds=0.2).max()
    assert peak == pytest.approx(67.505, abs=0.01)


def test_twice_the_distance_takes_6_decibels_off_the_step_and_nothing_off_the_room(spec):
    far = walk(microphone(spec, distance=2.0, room_level=30.0), [0.4, 0, 0, 0], every=1, seconds=2.0)
    assert far.max() == pytest.approx(67.5 - 6.02, abs=0.02)
    assert far[-1] == pytest.approx(30.0, abs=0.02)


def test_after_a_step_the_meter_falls_by_35_decibels_a_second(spec):
    levels = walk(microphone(spec, room_level=30.0), [1.5, 0, 0, 0], seconds=0.8)
    assert levels[24] - levels[34] == pytest.approx(0.2 * 4.343 / 0.125, abs=0.01)  # 10 log10(e) / tau in 0.2 s


def test_twice_the_touchdown_speed_is_8_decibels_more(spec):
    # beyond 1 / t_c a pulse's spectrum goes with J / t_c^2: v * v^0.4, and 20 log10(2^1.4) = 8.43; the nulls of single
    # modes are filled by the scatter of contact times
    made = microphone(spec)
    stretch = np.exp(0.15 * np.random.default_rng(0).standard_normal(4000))
    energy = [
        (made.strike(np.full(4000, speed), np.full(4000, 0.55), stretch) / (4 * made._decay)).sum(axis=1).mean()
        for speed in (0.5, 1.0)
    ]
    assert decibels(energy[1]) - decibels(energy[0]) == pytest.approx(8.43, abs=0.6)


def test_readings_averaged_as_energy_are_the_sound_that_there_was(spec):
    made = microphone(spec)
    levels = walk(made, [1.0, 0, 0, 0], seconds=2.0, land=(10, 300, 510))
    total = sum(exposure[0] for exposure in made.energy.values())
    assert made.energy["room"][0] == pytest.approx(squared_pressure(38.0) * 2.0)
    assert (squared_pressure(levels).mean() * 2.0) == pytest.approx(total, rel=0.02)  # frames of 20 ms are short
    assert made.steps[0] == 3


def test_a_step_leaves_the_energy_of_its_modes(spec):
    made = microphone(spec)
    walk(made, [1.0, 0, 0, 0])
    modes = made.strike(np.array([1.0]), np.array([0.55]))[0]
    assert made.energy["steps"][0] == pytest.approx((modes / (4 * made._decay)).sum())


def test_two_feet_have_twice_the_energy_of_one(spec):
    one, two = microphone(spec), microphone(spec)
    walk(one, [0.7, 0, 0, 0])
    walk(two, [0.7, 0, 0.7, 0])
    assert two.energy["steps"] == pytest.approx(2 * one.energy["steps"])


@pytest.mark.parametrize("every", [1, 20, 500])
def test_how_often_somebody_looks_changes_nothing(spec, every):
    levels = walk(microphone(spec), [1.2, 0, 0, 0.3], seconds=0.5, every=every, land=(10, 77, 212), joint_speed=4.0)
    expected = walk(microphone(spec), [1.2, 0, 0, 0.3], seconds=0.5, every=50, land=(10, 77, 212), joint_speed=4.0)
    assert levels[-1] == pytest.approx(expected[-1], abs=1e-9)


def test_drives_are_heard(spec):
    levels = walk(microphone(spec, room_level=30.0), np.zeros((1, 4)), seconds=1.5, joint_speed=5.0)
    assert levels[-1] == pytest.approx(10 * np.log10(12 * 10**4.5 + 10**3), abs=0.01)  # twelve drives at 45, room at 30


def test_a_foot_that_stands_or_is_lowered_gently_makes_no_step(spec):
    made = microphone(spec)
    still = np.zeros((1, 4))
    for _ in range(100):  # stands from the start, whatever its sensor says of speed
        made.step(PhysicsSample(np.zeros((1, 12)), np.zeros((1, 12)), still + 30, still + 1.0, still + 0.55, DT))
    assert made.read()["sound_level"] == pytest.approx(38.0)
    walk(made, [0.009, 0, 0, 0])
    assert made.steps[0] == 0


def test_one_robots_steps_are_not_heard_beside_another(spec):
    levels = walk(microphone(spec, worlds=2), [[1.5, 1.5, 0, 0], [0, 0, 0, 0]])
    assert levels[:, 0].max() > 80
    assert levels[:, 1] == pytest.approx(38.0)


def test_a_robots_luck_does_not_depend_on_its_neighbours(spec):
    random = {"step_scatter": 2.5, "contact_scatter": 0.15, "reading_noise": 0.3}
    stamping, still = [1.5, 1.5, 0, 0], [0, 0, 0, 0]
    beside = [
        walk(microphone(spec, worlds=2, seed=3, **random), [neighbour, [0.8, 0, 0.8, 0]])
        for neighbour in (stamping, still)
    ]
    assert np.array_equal(beside[0][:, 1], beside[1][:, 1])


def test_the_seed_decides(spec):
    random = {"step_scatter": 2.5, "contact_scatter": 0.15, "reading_noise": 0.3, "resolution": 0.1}
    first, again, other = (walk(microphone(spec, seed=seed, **random), [0.8, 0, 0.8, 0]) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_levels_of_steps_scatter_as_told(spec):
    made = microphone(spec, worlds=4000, step_scatter=2.5)
    walk(made, np.tile([0.8, 0, 0, 0], (4000, 1)), seconds=0.04)
    levels = decibels(made.energy["steps"])
    assert levels.std() == pytest.approx(2.5, rel=0.05)
    alone = microphone(spec)
    walk(alone, [0.8, 0, 0, 0], seconds=0.04)
    assert np.median(levels) == pytest.approx(decibels(alone.energy["steps"])[0], abs=0.15)


def test_a_meter_shows_tenths_of_a_decibel(spec):
    levels = walk(microphone(spec, resolution=0.1, reading_noise=0.3), [0.8, 0, 0, 0])
    assert levels * 10 == pytest.approx(np.rint(levels * 10), abs=1e-6)


def test_every_number_has_unit_source_and_range():
    for name, field in MicrophoneParameters.model_fields.items():
        extra = field.json_schema_extra
        assert extra["unit"] and extra["source"] and extra["range"][0] < extra["range"][1], name
        values = np.atleast_1d(field.default)
        assert (values >= extra["range"][0]).all() and (values <= extra["range"][1]).all(), name


@pytest.mark.parametrize(
    ("settings", "fault"),
    [
        ({"foot_modulus": 1e6}, "foot_modulus"),
        ({"frequencies": (100.0,) * 8, "dampings": (0.05,) * 7}, "8 frequencies and 7 dampings"),
        ({"dampings": (0.05,) * 7 + (0.5,)}, "0.5 is outside 0.02 to 0.1"),
        ({"loudness": 3}, "loudness"),
    ],
)
def test_a_wrong_number_is_refused_by_name(settings, fault):
    with pytest.raises(ValidationError, match=fault):
        MicrophoneParameters(**settings)


def test_settings_of_a_world_reach_it():
    from hts.worlds.twin.instruments import make_instruments

    registry = plugins.load()
    made = make_instruments(registry, registry.make_robot("go1"), {"noise": {}}, {"microphone": {"room_level": 44.0}})
    assert made["microphone"].describe()["room_level"] == 44.0


def test_the_exact_level_is_the_sound_there_was_since_somebody_last_asked(spec):
    made = microphone(spec, calibration_error=0.7, reading_noise=1.0)
    assert made.exact() == {"sound_level": pytest.approx(38.0)}  # nothing has passed: the room
    walk(made, [0.4, 0, 0, 0], seconds=0.5)
    first = made.exact()["sound_level"]
    exposure = sum(made.energy[name] for name in made.energy)
    assert first == pytest.approx(decibels(exposure / 0.5))
    walk(made, np.zeros((1, 4)), seconds=3.0)
    made.exact()
    walk(made, np.zeros((1, 4)), seconds=1.0)
    assert made.exact()["sound_level"] == pytest.approx(38.0, abs=0.01)
    assert made.exact_idle() == {"sound_level": 38.0}


# ---------------------------------------------------------------------------------------- over a population of them


def drawn_of_it():
    found = [one for one in drawn_parameters(plugins.load()) if one.key.startswith("instruments.microphone.")]
    return {one.key.rpartition(".")[2]: one for one in found}


def test_everything_about_the_sound_is_drawn_but_definitions_and_what_a_person_chooses():
    kept = set(MicrophoneParameters.model_fields) - set(drawn_of_it())
    assert kept == {"contact_newtons", "least_speed", "drive_speed", "distance"}
    assert all(one.source and one.unit and one.low < one.high for one in drawn_of_it().values())


def test_a_drawn_microphone_lies_in_the_ranges_and_can_be_made(spec):
    for index in range(20):
        given = draw(drawn_parameters(plugins.load()), "sound", index).nested()["instruments"]["microphone"]
        p = Microphone(MicrophoneParameters(**given), spec).p
        for name, one in drawn_of_it().items():
            assert (one.low <= np.atleast_1d(getattr(p, name))).all()
            assert (np.atleast_1d(getattr(p, name)) <= one.high).all()


def test_the_development_realities_sound_different():
    pytest.importorskip("hts_go1", reason="the realities come with this robot")
    steps = [read(f"dev-{index:02d}").parameters["instruments"]["microphone"]["step_level"] for index in range(16)]
    assert len(set(steps)) == 16 and max(steps) - min(steps) > 5.0  # dB(A)


def test_steps_that_come_at_once_are_each_taken_once_and_in_their_order(spec):
    """150 of them behind three single ones, with chunks of 64: parts of 61, 64 and 25."""
    rng, worlds, steps = np.random.default_rng(0), 2, 153
    joints, feet = (steps, worlds, spec.num_joints), (steps, worlds, len(spec.foot_sites))
    force = 50.0 * (rng.random(feet) < 0.1)
    samples = PhysicsSample(
        rng.normal(0, 8, joints), rng.normal(0, 5, joints), force, rng.random(feet), rng.uniform(0.4, 0.7, feet), DT
    )
    several, single = microphone(spec, worlds), microphone(spec, worlds)
    for step in range(steps):
        single.step(samples.at(step))
    for step in range(3):
        several.step(samples.at(step))
    rest = (samples.motor_torque, samples.joint_velocity, samples.foot_force, samples.foot_speed, samples.foot_mass)
    several.advance(PhysicsSample(*(values[3:] for values in rest), DT))
    assert several.read()["sound_level"].tolist() == single.read()["sound_level"].tolist()
    assert several.steps.tolist() == single.steps.tolist() and several.steps.min() > 3
    assert several.seconds == pytest.approx(0.153)
