"""The GPU engine on Warp's CPU device: the same physics as the CPU engine, to single precision."""

from __future__ import annotations

import importlib.util
import sys

import mujoco
import pytest
import torch

from hts.config import RandomisationConfig
from hts.errors import ConfigError, SimulationError
from hts.sim import warp_setup
from hts.sim.models import compile_model, variants
from hts.sim.selection import make_engine

pytest.importorskip("hts_go1", reason="the robot of this test is not installed")
# A cold cache of compiled kernels costs about a minute, a warm one a few seconds.
pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1800),
    # Asked without importing it, which takes seconds also for who collects these tests and runs others.
    pytest.mark.skipif(importlib.util.find_spec("mujoco_warp") is None, reason="the extra `gpu` is not installed"),
]

WORLDS = 6
IN_TURN = [0, 1, 2, 0, 1, 2]
MIXED = [2, 2, 1, 0, 0, 1]


@pytest.fixture(scope="module")
def robot():
    from hts_go1.robot import Go1, Go1Settings

    return Go1(Go1Settings())


@pytest.fixture(scope="module")
def pool(robot):
    return variants(robot, RandomisationConfig(models=3), seed=0)


@pytest.fixture(scope="module")
def warp(robot, pool):
    return make_engine("warp", pool, IN_TURN, robot.spec.substeps, device="cpu")


def everywhere() -> torch.Tensor:
    return torch.ones(WORLDS, dtype=torch.bool)


def standing(robot, height: float = 0.3) -> torch.Tensor:
    pose = torch.zeros(WORLDS, 19)
    pose[:, 2], pose[:, 3] = height, 1.0
    pose[:, 7:] = torch.tensor(robot.spec.default_pose)
    return pose


def moves(robot, steps: int, seed: int = 0) -> torch.Tensor:
    """Joint targets near the default pose, (steps, substeps, worlds, 12), fresh in each control step."""
    generator = torch.Generator().manual_seed(seed)
    targets = torch.tensor(robot.spec.default_pose) + 0.15 * torch.randn(steps, 1, WORLDS, 12, generator=generator)
    return targets.expand(steps, robot.spec.substeps, WORLDS, 12).contiguous()


def restart(engine, robot, height: float = 0.3) -> None:
    engine.reset(everywhere(), standing(robot, height), torch.zeros(WORLDS, 18))


@pytest.mark.parametrize("assignment", [IN_TURN, MIXED], ids=["variants in turn", "variants mixed"])
def test_both_engines_agree_over_fifty_control_steps(robot, pool, assignment):
    single = make_engine("warp", pool, assignment, robot.spec.substeps, device="cpu")
    double = make_engine("mujoco", pool, assignment, robot.spec.substeps, threads=1)
    speed = 0.3 * torch.randn(WORLDS, 18, generator=torch.Generator().manual_seed(1))
    for engine in (single, double):
        engine.reset(everywhere(), standing(robot), speed)
    for ctrl in moves(robot, 50):
        single.step(ctrl)
        double.step(ctrl)
        # m and rad; m/s and rad/s. Some twenty times what was seen, and far below what a wrong variant costs.
        torch.testing.assert_close(single.qpos, double.qpos, atol=1e-4, rtol=0)
        torch.testing.assert_close(single.qvel, double.qvel, atol=5e-3, rtol=0)
    # Mixed units; the largest are forces of some 30 N.
    torch.testing.assert_close(single.sensordata, double.sensordata, atol=0.1, rtol=1e-2)
    assert not single.diverged.any()
    single.check()
    double.close()


def test_both_engines_keep_the_same_physics_steps_for_who_asks(robot, pool, warp):
    single = make_engine("warp", pool, IN_TURN, robot.spec.substeps, device="cpu", keep_physics_steps=True)
    double = make_engine("mujoco", pool, IN_TURN, robot.spec.substeps, threads=1)
    for engine in (single, double, warp):
        restart(engine, robot)
    for ctrl in moves(robot, 5):
        for engine in (single, double, warp):
            engine.step(ctrl)
        for found, expected, atol in zip(single.physics_steps(), double.physics_steps(), (5e-3, 0.1), strict=True):
            assert found.shape == (WORLDS, robot.spec.substeps, found.shape[-1])
            torch.testing.assert_close(found, expected, atol=atol, rtol=1e-2)
    assert (
        single.physics_steps()[1][:, 0] - single.sensordata
    ).abs().max() > 1.0  # not the last of them again and again
    torch.testing.assert_close(single.physics_steps()[1][:, -1], single.sensordata)
    torch.testing.assert_close(single.qpos, warp.qpos)  # looking at them moves nothing
    assert warp.physics_steps() is None
    double.close()


def test_a_nudge_moves_both_engines_alike_and_goes_on_in_the_physics(robot, pool):
    engines = [make_engine(name, pool, IN_TURN, robot.spec.substeps, device="cpu") for name in ("mujoco", "warp")]
    steps, nudge = moves(robot, 10), torch.zeros(WORLDS, 2)
    nudge[1] = torch.tensor([0.02, -0.01])
    for engine in engines:
        engine.reset(everywhere(), standing(robot, 1.0), torch.zeros(WORLDS, 18))  # in the air: nothing stops it
        for ctrl in steps:
            engine.step(ctrl)
            engine.nudge(nudge)
    moved = [engine.qpos[:, :2] for engine in engines]
    torch.testing.assert_close(moved[0], moved[1], atol=1e-4, rtol=0)
    others = torch.arange(WORLDS) != 1
    assert moved[0][others].abs().max() < 0.004 < moved[0][1].abs().min()
    torch.testing.assert_close(engines[0].qvel[:, :2], engines[1].qvel[:, :2], atol=1e-3, rtol=0)
    for engine in engines:
        engine.close()


def test_each_world_has_the_numbers_of_its_variant(robot, pool, warp):
    restart(warp, robot)
    for ctrl in moves(robot, 5)[:, :, :1].expand(-1, -1, WORLDS, -1):
        warp.step(ctrl)
    assert torch.equal(warp.qpos[:3], warp.qpos[3:])
    assert (warp.qpos[0] - warp.qpos[1]).abs().max() > 1e-3
    assert (warp.qpos[1] - warp.qpos[2]).abs().max() > 1e-3


def test_reset_touches_only_the_worlds_of_the_mask(robot, warp):
    restart(warp, robot)
    for ctrl in moves(robot, 3):
        warp.step(ctrl)
    before = warp.state_dict()
    mask = torch.tensor([True, False, False, True, False, False])
    target = torch.full((WORLDS, 19), float("nan"))
    target[mask] = standing(robot, 0.4)[mask]
    warp.reset(mask, target, torch.zeros(WORLDS, 18))
    after = warp.state_dict()
    for name in ("qpos", "qvel", "qacc_warmstart", "time"):
        assert torch.equal(before[name][~mask], after[name][~mask]), name
    assert torch.equal(after["qpos"][mask], standing(robot, 0.4)[mask])
    assert before["qacc_warmstart"][mask].abs().max() > 0
    assert not after["qvel"][mask].any() and not after["qacc_warmstart"][mask].any() and not after["time"][mask].any()


def test_a_reset_world_goes_on_like_a_fresh_one(robot, warp):
    restart(warp, robot)
    script = moves(robot, 3)
    for ctrl in script:
        warp.step(ctrl)
    fresh = warp.qpos.clone()
    restart(warp, robot)
    for ctrl in script:
        warp.step(ctrl)
    assert torch.equal(warp.qpos, fresh)


def test_physics_goes_on_exactly_from_a_saved_state(robot, warp):
    restart(warp, robot)
    script = moves(robot, 8)
    for ctrl in script[:4]:
        warp.step(ctrl)
    saved = warp.state_dict()
    for ctrl in script[4:]:
        warp.step(ctrl)
    expected = warp.state_dict()
    restart(warp, robot, height=0.5)
    warp.load_state_dict(saved)
    for ctrl in script[4:]:
        warp.step(ctrl)
    for name, value in warp.state_dict().items():
        assert torch.equal(value, expected[name]), name


def test_a_broken_world_is_marked_until_it_is_reset_and_harms_no_other(robot, warp):
    restart(warp, robot)
    script = moves(robot, 2)
    for ctrl in script:
        warp.step(ctrl)
    healthy = warp.qpos.clone()
    restart(warp, robot)
    warp.qvel[2] = float("nan")
    for ctrl in script:
        warp.step(ctrl)
    alone = torch.arange(WORLDS) == 2
    assert torch.equal(warp.diverged, alone)
    assert torch.equal(warp.qpos[~alone], healthy[~alone])
    warp.reset(alone, standing(robot), torch.zeros(WORLDS, 18))
    assert not warp.diverged.any()
    warp.step(script[0])
    assert not warp.diverged.any() and warp.qpos.isfinite().all() and warp.sensordata.isfinite().all()


def test_tensors_are_the_memory_of_the_physics(robot, warp):
    restart(warp, robot)
    pointers = [tensor.data_ptr() for tensor in (warp.qpos, warp.qvel, warp.sensordata)]
    warp.step(moves(robot, 1)[0])
    assert [tensor.data_ptr() for tensor in (warp.qpos, warp.qvel, warp.sensordata)] == pointers
    warp.qpos[0, 2] = 7.0
    assert warp._data.qpos.numpy()[0, 2] == 7.0


def test_a_standing_robot_presses_its_weight_on_the_floor(robot, pool, warp):
    restart(warp, robot, height=0.27)
    still = torch.tensor(robot.spec.default_pose).expand(robot.spec.substeps, WORLDS, 12)
    for _ in range(50):
        warp.step(still)
    feet = sum(warp.sensordata[:, warp.sensor(f"touch_{leg}")] for leg in ("FR", "FL", "RR", "RL")).squeeze(-1)
    weight = torch.tensor([9.81 * float(pool[index].body_mass.sum()) for index in IN_TURN])
    torch.testing.assert_close(feet, weight.to(feet), rtol=0.02, atol=0)


def test_buffers_hold_the_worst_case_of_the_robot(robot, pool, warp):
    # One contact per foot and knee, four of the trunk's box with the floor; four rows each; 12 joints with
    # friction and limits.
    assert (warp._contacts, warp._constraints) == (12, 12 * 4 + 12 + 12)


@pytest.mark.parametrize(
    ("option", "size"), [("contacts_per_world", 1), ("constraints_per_world", 14)], ids=["contacts", "constraints"]
)
def test_an_overflowing_buffer_is_an_error_that_names_the_setting(robot, pool, option, size):
    from hts.sim.warp_engine import make_warp_engine

    engine = make_warp_engine(pool, IN_TURN, robot.spec.substeps, device="cpu", **{option: size})
    restart(engine, robot, height=0.27)
    engine.check()
    still = torch.tensor(robot.spec.default_pose).expand(robot.spec.substeps, WORLDS, 12)
    for _ in range(5):
        engine.step(still)
    with pytest.raises(SimulationError, match=option):
        engine.check()


def test_a_non_finite_input_is_reported_with_its_world(robot, pool):
    engine = make_engine("warp", pool, IN_TURN, robot.spec.substeps, device="cpu")
    restart(engine, robot)
    ctrl = moves(robot, 1)[0].clone()
    ctrl[0, 4, 3] = float("inf")
    engine.step(ctrl)
    with pytest.raises(SimulationError, match=r"worlds \[4\]"):
        engine.check()


def test_a_checkpoint_of_another_engine_or_size_is_refused(robot, pool, warp):
    with pytest.raises(ConfigError, match="another engine"):
        warp.load_state_dict({"state": torch.zeros(WORLDS, 38), "sensordata": torch.zeros(WORLDS, 1)})
    wrong = warp.state_dict() | {"qpos": torch.zeros(WORLDS + 1, 19)}
    with pytest.raises(SimulationError, match="another number of worlds"):
        warp.load_state_dict(wrong)


def test_variants_must_share_what_the_engine_cannot_vary(robot):
    first, second = compile_model(robot), compile_model(robot)
    second.jnt_limited[1] = 0
    with pytest.raises(ConfigError, match="do not randomise it"):
        make_engine("warp", [first, second], [0, 1], 1, device="cpu")


def test_a_model_that_warp_cannot_simulate_is_refused_in_one_line():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><option solver='PGS'/><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(ConfigError, match="--engine mujoco") as caught:
        make_engine("warp", [model], [0], 1, device="cpu")
    assert "\n" not in str(caught.value)


def test_without_warp_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    with pytest.raises(ConfigError, match=r"hard-to-sim\[gpu\].*--engine mujoco"):
        warp_setup.import_warp()


def test_without_cuda_the_error_names_the_other_engine(monkeypatch):
    monkeypatch.setattr(torch.version, "cuda", None)
    with pytest.raises(ConfigError, match="CPU build.*--engine mujoco"):
        warp_setup.torch_device("auto")


def test_an_old_driver_is_reported_with_its_reason(monkeypatch):
    def init():
        raise RuntimeError(
            "The NVIDIA driver on your system is too old (found version 11040). Please update it.\nMore."
        )

    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "init", init)
    with pytest.raises(ConfigError, match=r"too old \(found version 11040\)\): install or update .* --engine mujoco"):
        warp_setup.torch_device("auto")


def test_too_little_memory_names_the_number_of_worlds():
    error = warp_setup.explained(
        RuntimeError("Failed to allocate 9 bytes on device 'cuda:0'"), 4096, torch.device("cpu")
    )
    assert isinstance(error, SimulationError)
    assert "4096 worlds" in str(error) and "finetune.num_envs" in str(error)


needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")


@needs_cuda
@pytest.mark.filterwarnings("ignore:Synchronization debug mode is a prototype")  # torch says so once, after setting it
@pytest.mark.parametrize("side_stream", [False, True], ids=["default stream", "side stream"])
def test_the_captured_graph_agrees_with_the_cpu_engine_and_never_waits(robot, pool, side_stream):
    captured = make_engine("warp", pool, IN_TURN, robot.spec.substeps)
    double = make_engine("mujoco", pool, IN_TURN, robot.spec.substeps, threads=1)
    script, pose, still = moves(robot, 50), standing(robot), torch.zeros(WORLDS, 18)
    double.reset(everywhere(), pose, still)
    on_device = [tensor.cuda() for tensor in (everywhere(), pose, still, script)]
    torch.cuda.synchronize()
    with torch.cuda.stream(torch.cuda.Stream() if side_stream else torch.cuda.default_stream()):
        try:
            torch.cuda.set_sync_debug_mode("error")
            captured.reset(*on_device[:3])
            for ctrl in on_device[3]:
                captured.step(ctrl)
        finally:
            torch.cuda.set_sync_debug_mode("default")
        torch.cuda.current_stream().synchronize()
    for ctrl in script:
        double.step(ctrl)
    torch.testing.assert_close(captured.qpos.cpu(), double.qpos, atol=1e-3, rtol=0)
    torch.testing.assert_close(captured.qvel.cpu(), double.qvel, atol=5e-2, rtol=0)
    assert not captured.diverged.any()
    captured.check()
    captured.close()
    double.close()


@needs_cuda
def test_the_captured_graph_keeps_the_physics_steps_of_the_cpu_engine(robot, pool):
    captured = make_engine("warp", pool, IN_TURN, robot.spec.substeps, keep_physics_steps=True)
    double = make_engine("mujoco", pool, IN_TURN, robot.spec.substeps, threads=1)
    pose, still = standing(robot), torch.zeros(WORLDS, 18)
    double.reset(everywhere(), pose, still)
    captured.reset(everywhere().cuda(), pose.cuda(), still.cuda())
    for ctrl in moves(robot, 5):
        captured.step(ctrl.cuda())
        double.step(ctrl)
        for found, expected, atol in zip(captured.physics_steps(), double.physics_steps(), (5e-3, 0.1), strict=True):
            torch.testing.assert_close(found.cpu(), expected, atol=atol, rtol=1e-2)
    captured.close()
    double.close()


@needs_cuda
def test_worlds_that_do_not_fit_are_refused_with_what_to_do(robot, pool):
    free, _ = torch.cuda.mem_get_info()
    hog = torch.empty(free - 2**29, dtype=torch.uint8, device="cuda")
    with pytest.raises(SimulationError, match="finetune.num_envs"):
        make_engine("warp", pool, [0, 1, 2] * 30_000, robot.spec.substeps)
    del hog
    torch.cuda.empty_cache()
