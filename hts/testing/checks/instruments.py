"""Instruments: what they read of several robots at once."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence

import numpy as np

from hts.channels import Channel
from hts.contracts import Instrument, PhysicsSample
from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import after, ensure, listed, same
from hts.testing.checks.facts import facts_can_be_read
from hts.testing.checks.made_up import WORLDS, arrays, physics, rest, sim_channels
from hts.testing.examples.robot.robot import Tiny

STEPS = 60  # of 1 ms: three control steps
AT_ONCE = 20  # of them between two readings
WALKS = ((300, 1.0), (3_000, 3.0), (60_000, 3.0))
"""Physics steps and how strong they are: a slow sensor gets longer to show that something moved."""
LOOKS = (150, 3_000)  # readings at rest, 3 s and a minute: a slow sensor gets longer to come to its idle level
AT_REST = 8  # robots, each with a zero error of its own
FAR_OFF = 10.0  # standard deviations of the readings at rest, over robots and time, that an idle level may be off
SHARE_OFF = 0.05  # of the level, likewise
MEMORY = 500  # readings, 10 s: so long it moves, and then rests, before it is asked what it remembers
VIVID = 3.0  # times what made-up motion does, so that it shows behind a sensor's noise
SEEN = 10.0  # standard deviations of its readings that motion must have changed, to say anything of its memory
NEARER = 0.98  # of its distance from the idle level: a reading that comes so much nearer may still be on its way

Readings = Mapping[str, np.ndarray]


def reads_its_channels(entry: Entry, registry: Registry) -> None:
    """Made without settings, it reads its channels, no sim channel, of all robots at once (one too), as finite
    numbers."""
    instrument = _made(entry)
    ensure("channels" in dir(instrument), "its class sets no channels, a tuple of hts.channels.Channel")
    several = isinstance(instrument.channels, tuple | list)
    ensure(
        several and all(isinstance(one, Channel) for one in instrument.channels),
        f"its channels are a {type(instrument.channels).__name__}, expected a tuple of hts.channels.Channel; of one it "
        "is (channel,)",
    )
    named = {channel.name: channel for channel in instrument.channels}
    for worlds in (WORLDS, 1):
        readings, robots = _used(instrument, worlds=worlds), f"{worlds} robot{'s' if worlds > 1 else ''}"
        ensure(set(readings) == set(named), f"read() gives {listed(readings)}, its channels are {listed(named)}")
        for name, channel in named.items():
            shape, wanted = np.shape(readings[name]), (worlds, *channel.shape)
            ensure(shape == wanted, f"'{name}' has shape {shape} for {robots}, not {wanted}")
            ensure(bool(np.isfinite(readings[name]).all()), f"'{name}' is not finite (NaN or inf)")
    known = set(named) & set(sim_channels(registry))
    ensure(not known, f"{listed(known)} is a sim channel")


def knows_idle(entry: Entry, registry: Registry) -> None:
    """idle() gives a finite level for channels of its own, and for one at least."""
    instrument = _made(entry)
    _used(instrument)
    levels, names = instrument.idle(), {channel.name for channel in instrument.channels}
    ensure(
        isinstance(levels, Mapping), f"idle() gives a {type(levels).__name__}, expected levels by the names of channels"
    )
    ensure(bool(levels) and set(levels) <= names, f"idle() gives {listed(levels)}, its channels are {listed(names)}")
    for name, level in levels.items():
        ensure(np.ndim(level) == 0, f"the idle level of '{name}' is a {type(level).__name__}, expected one number")
        ensure(bool(np.isfinite(level)), f"the idle level of '{name}' is {level}")


@after(knows_idle)
def idles_at_its_level(entry: Entry, registry: Registry) -> None:
    """With motors off and nothing moving it reads what idle() gives, as somebody would read it off: this level is
    subtracted to get from gross to net. Not asked of one that says it does not (`idles_at_rest`)."""
    if not _made(entry).idles_at_rest:
        return
    for looks in LOOKS:
        levels, shown = _at_rest(_made(entry), looks, newtons=0.0)
        loaded = _at_rest(_made(entry), looks, newtons=10.0)[1]
        off = {
            name: level
            for name, level in levels.items()
            # What the ground's force changes is no matter of motion: the robot's weight is not known here.
            if np.isfinite(shown[name]).all() and same(shown[name], loaded[name]) and _all_off(shown[name], level)
        }
        if not off:
            return
    steps = _smallest_steps(entry)
    for name, level in off.items():
        read, scatter = shown[name].mean(), shown[name].std()
        ensure(
            abs(read - level) <= steps[name],
            f"idle() gives {level:g} for '{name}', with motors off and nothing moving it reads {read:.4g} ± "
            f"{scatter:.2g}; if drives that are on draw that much at rest, say idles_at_rest = False",
        )


def _at_rest(
    instrument: Instrument, looks: int, newtons: float
) -> tuple[Mapping[str, float], Mapping[str, np.ndarray]]:
    """Idle levels, and what it reads at each of so many looks, (looks, robots, *shape); newtons: on each foot."""
    instrument.reset(AT_REST, np.random.default_rng(7))
    sample, rows = rest(AT_REST), list[Readings]()
    sample.foot_force = np.full_like(sample.foot_force, newtons)
    for _ in range(looks):
        for _ in range(AT_ONCE):
            instrument.step(sample)
        rows.append(_read(instrument))
    levels = {name: float(level) for name, level in instrument.idle().items()}
    return levels, {name: np.stack([row[name] for row in rows]) for name in levels}


def remembered(instrument: Instrument, name: str) -> float:
    """Which share of what ten seconds of motion changed in a channel, one number a reading, is left after ten seconds
    of rest, means over their last seconds; 0 where motion changed too little to say."""
    instrument.reset(AT_REST, np.random.default_rng(7))
    made_up, block, shown = np.random.default_rng(1), None, list[np.ndarray]()
    for strength in (0.0, VIVID, 0.0):
        rows = []
        for _ in range(MEMORY):
            steps = (
                _weaker(physics(made_up, AT_REST), strength) if strength else rest(AT_REST) for _ in range(AT_ONCE)
            )
            block = _stacked(list(steps), block)
            instrument.advance(block)
            rows.append(_read(instrument)[name])
        shown.append(np.stack(rows[-MEMORY // 10 :]))
    before, moving, after_it = (float(one.mean()) for one in shown)
    change, scatter = moving - before, max(float(shown[0].std()), float(shown[2].std()))
    return (after_it - before) / change if abs(change) > SEEN * scatter else 0.0


def _all_off(shown: np.ndarray, level: float) -> bool:
    """Whether the readings at rest (looks, robots, *shape) of each component are off: the level is one for all."""
    parts = np.moveaxis(shown.reshape(*shown.shape[:2], -1), -1, 0)
    return all(_is_off(part, level) for part in parts)


def _is_off(shown: np.ndarray, level: float) -> bool:
    """Whether readings at rest (looks, robots) are far from the level, from the first to the last, and come no nearer.
    One that begins at it or comes to it has a memory of its own."""
    quarter = len(shown) // 4
    first, last = (abs(part.mean() - level) for part in (shown[:quarter], shown[-quarter:]))
    near = max(FAR_OFF * shown.std(), SHARE_OFF * max(abs(level), abs(shown.mean())))
    return bool(min(abs(shown[0].mean() - level), first, last) > near and last > NEARER * first)


def _smallest_steps(entry: Entry) -> Mapping[str, float]:
    """By how much readings of a moving robot differ at least, channel by channel: that of a rounded display."""
    instrument, made_up, rows = _begun(entry, AT_REST), np.random.default_rng(1), list[Readings]()
    for _ in range(LOOKS[0]):
        for _ in range(AT_ONCE):
            instrument.step(_weaker(physics(made_up, AT_REST), 3.0))
        rows.append(_read(instrument))
    differences = {name: np.diff(np.unique(np.stack([row[name] for row in rows]))) for name in rows[0]}
    return {name: float(steps.min(initial=np.inf)) if len(steps) else 0.0 for name, steps in differences.items()}


def repeats_itself(entry: Entry, registry: Registry) -> None:
    """The same steps from the same random numbers read the same, also after a reset of one that was used."""
    instrument = _made(entry)
    first = _used(instrument)
    for again in (_used(instrument), _used(_made(entry))):
        for name, values in first.items():
            ensure(same(values, again[name]), f"'{name}' differs from one time to the next")


@after(repeats_itself)
def reads_each_robot_alone(entry: Entry, registry: Registry) -> None:
    """What it reads of one robot does not depend on how the others move."""
    first, other = (_used(_made(entry), others=others) for others in (1.0, 0.3))
    for name, values in first.items():
        ensure(same(values[0], other[name][0], 1e-9), f"'{name}' of a robot depends on the robots beside it")


def sees_the_motion(entry: Entry, registry: Registry) -> None:
    """What it reads of robots that move is not what it reads, from the same random numbers, of robots at rest."""
    for count, strength in WALKS:
        moving, still = _begun(entry), _begun(entry)
        made_up, standing = np.random.default_rng(1), rest()
        for _ in range(count):
            moving.step(_weaker(physics(made_up), strength))
            still.step(standing)
        shown, idle = _read(moving), _read(still)
        if any(not same(values, idle[name]) for name, values in shown.items()):
            return
    ensure(False, f"reads of {count / 1000:g} s of motion what it reads of robots at rest: step() changes no reading")


@after(repeats_itself)
def advances_as_it_steps(entry: Entry, registry: Registry) -> None:
    """advance() of the K steps between two readings, (K, W, ...), and step() for each read the same, to the bit."""
    for irregular in (False, True):
        stepped, advanced = _begun(entry), _begun(entry)
        made_up, block = np.random.default_rng(1), None
        for _ in range(STEPS // AT_ONCE):
            samples = [physics(made_up) for _ in range(AT_ONCE)]
            for sample in samples if irregular else ():
                sample.current_torque = 1.1 * sample.motor_torque
            for sample in samples:
                stepped.step(sample)
            block = _stacked(samples, block)
            before = {name: value.copy() for name, value in arrays(block).items()}
            advanced.advance(block)
            changed = [name for name, value in arrays(block).items() if not same(value, before[name])]
            ensure(not changed, f"advance() changes {listed(changed)} in place")
            one, other = _read(stepped), _read(advanced)
            for name, values in one.items():
                off = np.abs(values - other[name]).max() if values.shape == other[name].shape else math.inf
                ensure(
                    same(values, other[name]),
                    f"'{name}' after advance() of {AT_ONCE} steps is off by up to {off:.3g} from {AT_ONCE} times "
                    "step(): leave advance() out, or make it do what step() does",
                )


def leaves_physics_alone(entry: Entry, registry: Registry) -> None:
    """step() only reads the sample: other instruments get the same one."""
    instrument = _made(entry)
    instrument.reset(WORLDS, np.random.default_rng(0))
    sample = physics(np.random.default_rng(1))
    before = {name: value.copy() for name, value in arrays(sample).items()}
    instrument.step(sample)
    changed = [name for name, value in arrays(sample).items() if not same(value, before[name])]
    ensure(not changed, f"step() changes {listed(changed)} in place")


@after(repeats_itself)
def reads_on_after_settling(entry: Entry, registry: Registry) -> None:
    """settle() runs, of one robot too; what is read after it and further steps is finite, and of each robot alone."""
    for worlds in (1, WORLDS):
        first, other = (_used(_made(entry), others, worlds, settles=True) for others in (1.0, 0.3))
        for name, values in first.items():
            wanted = values.shape[:1] == (worlds,)
            ensure(wanted, f"after settle() '{name}' has shape {values.shape} for {worlds} robot(s)")
            ensure(bool(np.isfinite(values).all()), f"after settle() '{name}' is not finite (NaN or inf)")
            alone = same(values[0], other[name][0], 1e-9)
            ensure(alone, f"after settle() '{name}' of a robot depends on the robots beside it")


def describes_itself(entry: Entry, registry: Registry) -> None:
    """describe() gives values that JSON can hold: they go into the twin's hash."""
    instrument = _made(entry)
    _used(instrument)
    json.dumps(instrument.describe(), allow_nan=False)


def tells_of_its_own_channels(entry: Entry, registry: Registry) -> None:
    """truth() tells of channels of its own alone, one finite number of each robot."""
    instrument = _made(entry)
    _used(instrument)
    told, names = instrument.truth(), {channel.name for channel in instrument.channels}
    ensure(set(told) <= names, f"truth() tells of {listed(set(told) - names)}, its channels are {listed(names)}")
    for name, values in told.items():
        ensure(np.shape(values) == (WORLDS,), f"the truth of '{name}' has shape {np.shape(values)}, not {(WORLDS,)}")
        ensure(bool(np.isfinite(values).all()), f"the truth of '{name}' is not finite (NaN or inf)")


def _made(entry: Entry) -> Instrument:
    instrument = entry.factory({}, Tiny())
    ensure(isinstance(instrument, Instrument), f"is a {type(instrument).__name__}, not a hts.contracts.Instrument")
    return instrument


def _begun(entry: Entry, worlds: int = WORLDS) -> Instrument:
    instrument = _made(entry)
    instrument.reset(worlds, np.random.default_rng(7))
    return instrument


def _used(instrument: Instrument, others: float = 1.0, worlds: int = WORLDS, settles: bool = False) -> Readings:
    """What it reads after a reset and STEPS steps, or after settle() and as many steps again; others: factor on what
    all robots but the first do."""
    instrument.reset(worlds, np.random.default_rng(7))
    made_up, factor = np.random.default_rng(1), np.array([1.0] + [others] * (worlds - 1))[:, None]
    for walk in range(1 + settles):
        if walk:
            instrument.settle()
        for _ in range(STEPS):
            instrument.step(_weaker(physics(made_up, worlds), factor))
    return _read(instrument)


def _weaker(sample: PhysicsSample, factor: np.ndarray | float) -> PhysicsSample:
    """The same with all that moves times a factor, in place."""
    for name in ("motor_torque", "joint_velocity", "foot_force", "foot_speed"):
        setattr(sample, name, getattr(sample, name) * factor)
    return sample


def _stacked(samples: Sequence[PhysicsSample], before: PhysicsSample | None) -> PhysicsSample:
    """The steps as one block, written into the arrays of the block before: a twin uses the same ones again."""
    whole = {name: np.stack([arrays(one)[name] for one in samples]) for name in arrays(samples[0])}
    if before is None:
        return PhysicsSample(**whole, dt=samples[0].dt)
    for name, values in whole.items():
        arrays(before)[name][:] = values
    return before


def _read(instrument: Instrument) -> Readings:
    found = instrument.read()
    ensure(
        isinstance(found, Mapping), f"read() gives a {type(found).__name__}, expected readings by the names of channels"
    )
    return {name: np.array(value, dtype=float) for name, value in found.items()}


CHECKS = (
    reads_its_channels,
    knows_idle,
    idles_at_its_level,
    repeats_itself,
    sees_the_motion,
    reads_each_robot_alone,
    advances_as_it_steps,
    reads_on_after_settling,
    leaves_physics_alone,
    describes_itself,
    facts_can_be_read,
    tells_of_its_own_channels,
)
