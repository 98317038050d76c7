"""What actions do, for each way to control the humanoid."""

import math
from dataclasses import fields, replace
from typing import Literal

import pytest
import torch

from aicpg_newton.engines import make_engine
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.methods import METHODS
from aicpg_newton.env.registry import TASKS, get_task
from aicpg_newton.env.task import ImitationTask, Reflex, Task
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.robot import humanoid, mirror
from aicpg_newton.robot.humanoid import JOINT_NAMES, NUM_JOINTS, joint_index
from aicpg_newton.robot.kinematics import skeleton, sole_heights


@pytest.fixture
def make(puppet, pattern: PatternNetwork):
    """An environment of a method on an engine that obeys."""

    def environment(method: str, num_envs: int = 4, **settings) -> Environment:
        task = replace(get_task("flat", method), **settings)
        return Environment(task, puppet(num_envs), pattern, seed=3)

    return environment


@pytest.mark.parametrize(("method", "size"), [("ai-cpg", 192), ("ppo", 136), ("amp", 136)])
def test_only_ai_cpg_sees_the_cpg(make, method: str, size: int):
    """And only AMP has a state for the discriminator."""
    seen = make(method).get_observations()
    assert seen["policy"].shape == (4, size)
    assert ("style" in seen) == (method == "amp")


@pytest.mark.parametrize("engine", ["mujoco", "newton"])
def test_without_a_pd_law_the_joints_get_the_networks_torques_alone(engine: str):
    """Whatever the joint angles; and no more than the limit."""
    limit = humanoid.motors().torque_limit
    motors = get_task("flat", "ppo").motors()
    assert torch.equal(motors.torque_limit, limit)
    robots = make_engine(engine, 2, "cpu", motors, get_task("flat").physics)
    torque = 0.3 * limit * torch.linspace(-1, 1, NUM_JOINTS).repeat(2, 1)
    torque[1] = 3.0 * limit
    still = torch.zeros(2, NUM_JOINTS)
    for _ in range(3):
        robots.step(still, still, torque)
    assert robots.state.joint_position.abs().max() > 0.1
    assert torch.allclose(robots.state.joint_torque[0], torque[0], atol=0.05)
    assert torch.allclose(robots.state.joint_torque[1], limit, atol=0.05)


@pytest.mark.parametrize("unit", ["gear", "limit"])
@pytest.mark.parametrize("method", ["ai-cpg", "ppo"])
def test_actions_are_torques_up_to_the_unit(make, method: str, unit: Literal["gear", "limit"]):
    """An action of 2.5 is the joint's gear or limit and no action exceeds it; PPO has no target to hold the joints.

    The network sees the torque in that unit, and is charged for it in that unit.
    """
    environment = make(method, reflex=Reflex(unit=unit))
    motors = humanoid.motors()
    largest = (motors.gear if unit == "gear" else motors.torque_limit).expand(4, -1)
    assert motors.gear[joint_index("left_knee")] == 100.0 and motors.torque_limit[joint_index("left_knee")] == 200.0
    names = [block.name for block in environment.blocks]
    start = sum(block.mirror.size for block in environment.blocks[: names.index("action_torque")])
    for action, share in ((1.25, 0.5), (2.5, 1.0), (-9.0, -1.0)):
        seen = environment.step(torch.full((4, NUM_JOINTS), action))[0]["policy"]
        call = environment.engine.calls[-1]
        assert torch.allclose(call["torque"], share * largest)
        assert method == "ai-cpg" or not call["target"].any()
        torch.testing.assert_close(seen[:, start : start + NUM_JOINTS], torch.full((4, NUM_JOINTS), share))


def test_ppo_starts_standing_still(make):
    """Feet on the ground, every joint a little off and within its range, no motion capture."""
    start = make("ppo", 64).engine.last_reset
    soles = sole_heights(start["root_position"], start["root_rotation"], start["joint_position"]).amin(dim=1)
    assert torch.allclose(soles, torch.zeros(64), atol=1e-5)
    angles = start["joint_position"]
    assert 0.05 < angles.abs().max() <= 0.1
    assert (angles.std(dim=0) > 0.01).all()
    assert (angles >= skeleton().ranges[:, 0] - 1e-6).all()
    assert (angles <= skeleton().ranges[:, 1] + 1e-6).all()
    for name in ("root_linear_velocity", "root_angular_velocity", "joint_velocity"):
        assert not start[name].any()


@pytest.mark.parametrize(("speed", "reward"), [(0.0, 0.0), (1.0, 0.5), (2.0, 1.0), (3.0, 0.5), (5.0, 0.0), (-1.0, 0.0)])
def test_ppo_is_paid_for_its_target_speed(make, speed: float, reward: float):
    """R_t in place of R_g, with the same weight and scale."""
    environment = make("ppo", target_speed=2.0)
    environment.engine.overrides = {"root_linear_velocity": torch.tensor([[speed, 0.7, 0.0]]).repeat(4, 1)}
    environment.step(torch.zeros(4, NUM_JOINTS))
    terms = environment.outcome.reward_terms
    assert terms["target_speed"][0].item() == pytest.approx(0.01 * 5.0 * reward, abs=1e-7)
    assert "pattern_tracking" not in terms


def test_amp_actions_are_target_angles(make):
    """0 is the middle of a joint's range, 1 lies 0.7 of the range above it, and no torque comes on top."""
    environment = make("amp")
    environment.step(torch.zeros(4, NUM_JOINTS))
    call = environment.engine.calls[-1]
    low, high = skeleton().ranges.unbind(dim=1)
    assert torch.allclose(call["target"], (0.5 * (low + high)).expand(4, -1))
    assert not call["torque"].any()
    environment.step(torch.full((4, NUM_JOINTS), 0.5))
    knee = joint_index("left_knee")
    expected = math.radians(0.5 * 160 + 0.5 * 0.7 * 160)
    assert environment.engine.calls[-1]["target"][0, knee].item() == pytest.approx(expected, abs=1e-5)


def test_amp_remembers_the_torque_it_asked_for(make):
    """The PD law's before the step, limited, as the network sees it in the next one."""
    environment = make("amp")
    position, velocity = environment.engine.state.joint_position, environment.engine.state.joint_velocity
    actions = 0.1 * torch.randn(4, NUM_JOINTS)
    environment.step(actions)
    motors = environment.task.motors()
    target = environment.engine.calls[-1]["target"]
    asked = motors.position_gain * (target - position) - motors.velocity_gain * velocity
    assert torch.allclose(
        environment.actuation.torque, asked.clamp(-motors.torque_limit, motors.torque_limit), atol=1e-3
    )


@pytest.mark.parametrize("reference", ["walk", "run"])
def test_amp_starts_in_the_imitated_gait(make, pattern: PatternNetwork, reference: str):
    """At the gait's own speed, whatever the environment's frequency."""
    start = make("amp", 256, reference=reference).engine.last_reset
    gait = next(each for each in pattern.gaits if each.name == reference)
    assert start["root_linear_velocity"][:, 0].mean().item() == pytest.approx(gait.speed, rel=0.05)
    # A phase drawn evenly from a stride: the hip moves as far as in the gait at its own frequency.
    phase = torch.linspace(0, 2 * math.pi, 200)
    hip = joint_index("right_hip_y")
    swing = pattern.target(phase, torch.full_like(phase, gait.frequency))[0][:, hip]
    drawn = start["joint_position"][:, hip]
    assert (drawn.min().item(), drawn.max().item()) == pytest.approx((swing.min().item(), swing.max().item()), abs=0.02)


def test_all_methods_mirror_alike():
    """A mirrored action is the mirrored motion: middle and reach of AMP's targets are mirror images of themselves."""
    low, high = skeleton().ranges.unbind(dim=1)
    middle, reach = 0.5 * (low + high), high - low
    assert torch.allclose(mirror.JOINTS(middle), middle, atol=1e-6)
    assert torch.allclose(reach[list(mirror.JOINTS.permutation)], reach, atol=1e-6)
    assert len(JOINT_NAMES) == len(middle)


def test_settings_that_differ_between_methods():
    """The one table: all else of the task is the same."""
    plain = TASKS["flat"]()
    common = {each.name for each in fields(Task)} - {"method", "rewards", "learning"}
    own = {"ai-cpg": {"pattern_tracking"}, "ppo": {"target_speed"}, "amp": set()}
    for name in METHODS:
        task = get_task("flat", name)
        assert task.method == name
        assert all(getattr(task, each) == getattr(plain, each) for each in common)
        assert set(task.rewards) - set(plain.rewards) == own[name]
        assert all(task.rewards[each] == term for each, term in plain.rewards.items())
    assert get_task("flat", "ppo").learning == get_task("flat").learning == plain.learning
    assert get_task("flat", "amp").learning == replace(plain.learning, initial_std=0.1)


def test_motors_that_differ_between_methods():
    """The paper's with a CPG; torques alone; targets alone, well damped, or as with a CPG where that is asked for."""
    paper, torques, targets = (get_task("flat", name).motors() for name in METHODS)
    assert paper.velocity_gain.tolist() == [1.0] * NUM_JOINTS and torques.velocity_gain.tolist() == [0.0] * NUM_JOINTS
    torch.testing.assert_close(targets.velocity_gain, 0.1 * targets.position_gain)
    knee = joint_index("left_knee")
    assert (targets.position_gain[knee], targets.torque_limit[knee]) == (300.0, paper.torque_limit[knee])
    for name in ("torque_limit", "damping", "armature"):
        assert torch.equal(getattr(paper, name), getattr(targets, name))
        assert torch.equal(getattr(paper, name), getattr(torques, name))
    task = get_task("flat", "amp")
    assert isinstance(task, ImitationTask)
    task.drives = "pattern"
    assert torch.equal(task.motors().position_gain, paper.position_gain)
