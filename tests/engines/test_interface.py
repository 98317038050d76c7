"""What every engine promises, on both engines: forces, momentum, frames, resets, limits and the order of the joints."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from pathlib import Path

import mujoco
import pytest
import torch

from aicpg_newton.engines import ENGINES, BodyState, Engine, Physics, RobotState
from aicpg_newton.engines.mujoco import MujocoEngine
from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.gait.cpg import pd_torque
from aicpg_newton.robot import humanoid, rotations
from aicpg_newton.robot.humanoid import (
    CONTROL_DT,
    GRAVITY,
    LINK_NAMES,
    MJCF_PATH,
    NUM_JOINTS,
    TOTAL_MASS,
    joint_index,
    motors,
)
from aicpg_newton.robot.kinematics import forward_kinematics, skeleton

NUM_ENVS = 4
STANDING_HEIGHT = 0.8815
ANKLE_HEIGHT = 0.05
BALANCE = -0.01
"""Ankle angle [rad] that keeps the humanoid upright for a while."""


@pytest.fixture(scope="module", params=["newton", "mujoco"])
def engine(request: pytest.FixtureRequest) -> Engine:
    """Each engine once, on the CPU, on a plane or on a terrain that is level."""
    name, _, level = request.param.partition(" on a ")
    ground = Ground(length=10.0, width=8.0)
    terrain = Terrain(ground, torch.zeros(41, 33)) if level else None
    return ENGINES[name]()(NUM_ENVS, torch.device("cpu"), motors(), Physics(), terrain)


on_every_ground = pytest.mark.parametrize(
    "engine", ["newton", "mujoco", "newton on a terrain", "mujoco on a terrain"], indirect=True, scope="module"
)
"""For what contacts with the ground have a part in."""


def start(num_envs: int = NUM_ENVS, height: float = STANDING_HEIGHT) -> dict[str, torch.Tensor]:
    """Upright at rest, joints at zero."""
    zeros = torch.zeros(num_envs, NUM_JOINTS)
    return {
        "root_position": torch.tensor([5.0, 0.0, height]).repeat(num_envs, 1),
        "root_rotation": torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(num_envs, 1),
        "root_linear_velocity": torch.zeros(num_envs, 3),
        "root_angular_velocity": torch.zeros(num_envs, 3),
        "joint_position": zeros,
        "joint_velocity": zeros.clone(),
    }


def reset_all(engine: Engine, values: dict[str, torch.Tensor]) -> None:
    """Put every environment into the given state."""
    engine.reset(torch.ones(engine.num_envs, dtype=torch.bool), BodyState(**values))


def centre_of_mass(state: RobotState) -> torch.Tensor:
    """Whole-body centre of mass [m] from the state alone, shape [num_envs, 3]."""
    model = mujoco.MjModel.from_xml_path(str(MJCF_PATH))  # type: ignore[attr-defined]
    bodies = [model.body(name).id for name in LINK_NAMES]
    masses, local = torch.tensor(model.body_mass[bodies]), torch.tensor(model.body_ipos[bodies])
    positions, orientations = forward_kinematics(
        state.root_position.double(), state.root_rotation.double(), state.joint_position.double()
    )
    world = positions + rotations.rotate(orientations, local.expand_as(positions))
    return (masses[:, None] * world).sum(dim=1) / masses.sum()


def random_targets(seed: int, num_envs: int = NUM_ENVS, scale: float = 0.2) -> torch.Tensor:
    """Target angles that differ between left and right [rad]."""
    return scale * torch.randn(num_envs, NUM_JOINTS, generator=torch.Generator().manual_seed(seed))


@on_every_ground
def test_standing_feet_carry_the_weight_below_the_centre_of_mass(engine: Engine) -> None:
    """At rest the feet carry the weight, each within its sole, and together right below the centre of mass."""
    values = start()
    # Two facings: a moment given in the foot's instead of the world's axes would show in the second.
    values["root_rotation"][2:] = torch.tensor([0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4)])
    reset_all(engine, values)
    target, zeros = torch.zeros(NUM_ENVS, NUM_JOINTS), torch.zeros(NUM_ENVS, NUM_JOINTS)
    # Without balance the ankles are too soft to stand for ever: leaning forward by half a degree they do for seconds.
    target[:, [joint_index("right_ankle_y"), joint_index("left_ankle_y")]] = BALANCE
    forces, moments = [], []
    for step in range(90):
        engine.step(target, zeros, zeros)
        if step >= 60:
            forces.append(engine.state.foot_force)
            moments.append(engine.state.foot_moment)
    force, moment = torch.stack(forces).mean(dim=0), torch.stack(moments).mean(dim=0)
    weight = TOTAL_MASS * GRAVITY
    torch.testing.assert_close(force.sum(dim=1)[:, 2], torch.full((NUM_ENVS,), weight), rtol=0.02, atol=0.0)
    assert (force.sum(dim=1)[:, :2].abs() < 0.02 * weight).all()

    # m = r x f with r at sole height: solve for the horizontal part of r.
    x = (-ANKLE_HEIGHT * force[..., 0] - moment[..., 1]) / force[..., 2]
    y = (moment[..., 0] - ANKLE_HEIGHT * force[..., 1]) / force[..., 2]
    forward = torch.cat((x[:2], y[2:]))
    sideways = torch.cat((y[:2], -x[2:]))
    corners = skeleton().sole_corners
    assert (forward > corners[..., 0].min()).all() and (forward < corners[..., 0].max()).all(), forward
    assert (sideways > corners[..., 1].min()).all() and (sideways < corners[..., 1].max()).all(), sideways

    state = engine.state
    positions, _ = forward_kinematics(state.root_position, state.root_rotation, state.joint_position)
    feet = positions[:, [LINK_NAMES.index("right_foot"), LINK_NAMES.index("left_foot")]]
    pressure = feet[..., :2] + torch.stack((x, y), dim=-1)
    share = force[..., 2:] / force[..., 2:].sum(dim=1, keepdim=True)
    offset = (share * pressure).sum(dim=1) - centre_of_mass(state)[:, :2].float()
    assert (offset.norm(dim=1) < 0.01).all(), offset


@on_every_ground
def test_pressing_with_the_toes_moves_the_pressure_forward(engine: Engine) -> None:
    """A foot turned toes-down meets the ground with a moment that turns it back; the other foot's stays."""
    reset_all(engine, start())
    targets = torch.zeros(NUM_ENVS, NUM_JOINTS)
    targets[1, joint_index("right_ankle_y")] = 0.06
    targets[2, joint_index("right_ankle_y")] = -0.06
    moment = torch.zeros(NUM_ENVS, 2)
    for _ in range(8):
        engine.step(targets, torch.zeros_like(targets), torch.zeros_like(targets))
        moment += engine.state.foot_moment[..., 1] / 8
    right, left = moment.unbind(dim=1)
    assert right[1] < right[0] - 2.0 and right[2] > right[0] + 2.0, right
    assert (left[1:3] - left[0]).abs().max() < 0.5 * (right[1:3] - right[0]).abs().min(), left


def test_free_fall(engine: Engine) -> None:
    """Far above the ground the centre of mass accelerates at g and the feet feel nothing."""
    reset_all(engine, start(height=5.0))
    targets = random_targets(1)
    heights = [centre_of_mass(engine.state)]
    for _ in range(3):
        for _ in range(8):
            engine.step(targets, torch.zeros_like(targets), torch.zeros_like(targets))
        heights.append(centre_of_mass(engine.state))
    for early, middle, late in zip(heights[:-2], heights[1:-1], heights[2:], strict=True):
        acceleration = (late - 2 * middle + early) / (8 * CONTROL_DT) ** 2
        expected = torch.tensor([0.0, 0.0, -GRAVITY]).double().expand_as(acceleration)
        torch.testing.assert_close(acceleration, expected, rtol=0.0, atol=0.05)
    assert (engine.state.foot_force == 0.0).all() and (engine.state.foot_moment == 0.0).all()


def test_push_changes_the_momentum(engine: Engine) -> None:
    """100 N for 0.1 s give the flying robot 10 N s along the push and nothing across it."""
    reset_all(engine, start(height=5.0))
    zeros = torch.zeros(NUM_ENVS, NUM_JOINTS)
    push = torch.zeros(NUM_ENVS, 3)
    push[1:] = 100.0 * torch.eye(3)
    for _ in range(6):
        engine.step(zeros, zeros, zeros, push=push)
    before = centre_of_mass(engine.state)
    for _ in range(6):
        engine.step(zeros, zeros, zeros)
    momentum = TOTAL_MASS * (centre_of_mass(engine.state) - before) / (6 * CONTROL_DT)
    gained = momentum[1:] - momentum[0]  # the first environment only falls
    torch.testing.assert_close(gained, 10.0 * torch.eye(3).double(), rtol=0.0, atol=0.15)


def test_reset_touches_only_the_mask(engine: Engine) -> None:
    """Masked environments read back what they were given; the others keep every number, whatever their rows hold."""
    reset_all(engine, start())
    targets = random_targets(2)
    for _ in range(10):
        engine.step(targets, torch.zeros_like(targets), torch.zeros_like(targets))
    before = engine.state
    kept = {name: value.clone() for name, value in vars(before).items()}
    mask = torch.tensor([False, True, False, True])
    generator = torch.Generator().manual_seed(3)
    values = {name: torch.randn(value.shape, generator=generator) for name, value in start().items()}
    values["root_rotation"] /= values["root_rotation"].norm(dim=1, keepdim=True)
    for value in values.values():
        value[~mask] = math.nan
    engine.reset(mask, BodyState(**values))
    after = engine.state
    for name, value in vars(after).items():
        assert torch.equal(value[~mask], kept[name][~mask]), name
        assert torch.equal(vars(before)[name], kept[name]), f"the old {name} was overwritten"
    for name in values:
        torch.testing.assert_close(vars(after)[name][mask], values[name][mask], rtol=0.0, atol=2e-6, msg=name)
    assert (after.foot_force[mask] == 0.0).all() and (after.joint_torque[mask] == 0.0).all()
    positions, orientations = forward_kinematics(after.root_position, after.root_rotation, after.joint_position)
    head = LINK_NAMES.index("head")
    centre = torch.tensor([0.0, 0.0, 0.175]).expand(NUM_ENVS, 3)
    expected = positions[:, head] + rotations.rotate(orientations[:, head], centre)
    torch.testing.assert_close(after.head_position, expected, rtol=0.0, atol=1e-5)


@on_every_ground
def test_reset_leaves_no_memory(engine: Engine) -> None:
    """An environment that was reset moves like one that never moved before."""
    targets = random_targets(4)[:1].repeat(NUM_ENVS, 1)
    zeros = torch.zeros_like(targets)
    reset_all(engine, start())
    engine.step(targets + torch.tensor([0.0, 0.5, 0.0, 0.0])[:, None], zeros, zeros)
    reset_all(engine, start())
    for _ in range(15):
        engine.step(targets, zeros, zeros)
    torch.testing.assert_close(engine.state.joint_position[1], engine.state.joint_position[0], rtol=0.0, atol=1e-5)


def test_root_velocities_are_those_of_the_pelvis_frame_in_the_world(engine: Engine) -> None:
    """Finite differences of the pelvis frame's pose agree with both velocities while the robot tumbles."""
    values = start(height=5.0)
    values["root_rotation"] = rotations.from_euler_xyz(torch.tensor([[0.5, -0.4, 1.2]]).repeat(NUM_ENVS, 1))
    values["root_linear_velocity"][:] = torch.tensor([1.0, -2.0, 0.5])
    values["root_angular_velocity"][:] = torch.tensor([1.5, -1.0, 2.0])
    reset_all(engine, values)
    zeros = torch.zeros(NUM_ENVS, NUM_JOINTS)
    states = [engine.state]
    for _ in range(2):
        engine.step(zeros, zeros, zeros)
        states.append(engine.state)
    linear = (states[2].root_position - states[0].root_position) / (2 * CONTROL_DT)
    # The mean velocity over two steps is that in the middle; the integrator is half a physics step ahead in z.
    torch.testing.assert_close(states[1].root_linear_velocity, linear, rtol=0.0, atol=0.05)
    turned = rotations.multiply(states[2].root_rotation, rotations.conjugate(states[0].root_rotation))
    axis = turned[:, :3] / turned[:, :3].norm(dim=1, keepdim=True)
    angular = 2 * torch.atan2(turned[:, :3].norm(dim=1, keepdim=True), turned[:, 3:]) * axis / (2 * CONTROL_DT)
    torch.testing.assert_close(states[1].root_angular_velocity, angular, rtol=0.0, atol=0.05)


@on_every_ground
@pytest.mark.parametrize("bad", ["target", "torque", "push"])
def test_not_finite_stays_in_one_environment(engine: Engine, bad: str) -> None:
    """A NaN among one environment's inputs shows up there, leaves the others as they would be, and a reset cures it."""
    targets, zeros = random_targets(5), torch.zeros(NUM_ENVS, NUM_JOINTS)
    ends = []
    for poisoned in (False, True):
        reset_all(engine, start())
        for step in range(6):
            inputs = {"target": targets.clone(), "torque": zeros.clone(), "push": torch.zeros(NUM_ENVS, 3)}
            if poisoned and step == 2:
                inputs[bad][1, 0] = math.nan
            engine.step(inputs["target"], zeros, inputs["torque"], push=inputs["push"])
        ends.append(engine.state)
    clean, poisoned_end = ends
    others = torch.tensor([True, False, True, True])
    assert clean.finite().all()
    assert poisoned_end.finite()[others].all()
    assert not torch.equal(poisoned_end.joint_velocity[1], clean.joint_velocity[1])
    if bad == "push" or engine.name == "mujoco":  # MuJoCo-Warp's actuators turn a NaN into a number
        assert not poisoned_end.finite()[1]
    for name, value in vars(poisoned_end).items():
        assert torch.equal(value[others], vars(clean)[name][others]), name
    engine.reset(~others, BodyState(**start()))
    for _ in range(6):
        engine.step(targets, zeros, zeros)
    assert engine.state.finite().all()


@pytest.mark.parametrize("name", ["newton", "mujoco"])
@pytest.mark.parametrize("substeps", [4, 16])
def test_power_is_what_motors_do_to_the_energy(name: str, substeps: int) -> None:
    """In flight without damping, motors' work is the change of kinetic and potential energy, as MuJoCo counts it.

    The first robot's motors are off: it loses what the integrator loses in falling, as all do. Torque times velocity at
    the end of each step would be 17 % too much. Torques against the motion brake.
    """
    facts = replace(humanoid.torque_motors(), damping=torch.zeros(NUM_JOINTS))
    physics = Physics(substeps=substeps)
    engine = ENGINES[name]()(NUM_ENVS, torch.device("cpu"), facts, physics)
    judge = MujocoEngine(1, torch.device("cpu"), facts, physics)
    data = mujoco.MjData(judge.model)  # type: ignore[attr-defined]

    def energy() -> torch.Tensor:
        values = []
        own = BodyState(*(getattr(engine.state, each.name) for each in fields(BodyState)))
        for qpos, qvel in zip(*judge.coordinates(own), strict=True):
            data.qpos[:], data.qvel[:] = qpos, qvel
            mujoco.mj_forward(judge.model, data)  # type: ignore[attr-defined]
            mujoco.mj_energyPos(judge.model, data)  # type: ignore[attr-defined]
            mujoco.mj_energyVel(judge.model, data)  # type: ignore[attr-defined]
            values.append(float(data.energy.sum()))
        return torch.tensor(values)

    values, zeros = start(height=5.0), torch.zeros(NUM_ENVS, NUM_JOINTS)
    lower, upper = skeleton().ranges.unbind(dim=1)
    values["joint_position"] = (0.5 * (lower + upper)).repeat(NUM_ENVS, 1)  # away from the stops
    reset_all(engine, values)
    torque = random_targets(12, scale=0.5)
    torque[0] = 0.0
    worked, before = torch.zeros(NUM_ENVS), energy()
    for _ in range(6):
        engine.step(zeros, zeros, torque)
        measures = engine.measures()
        assert (measures.driving_power >= 0.0).all() and (measures.braking_power >= 0.0).all()
        worked += CONTROL_DT * (measures.driving_power - measures.braking_power).sum(dim=1)
        assert measures.flight.tolist() == [1.0] * NUM_ENVS and not measures.contact.any()
    gained = energy() - before
    assert (worked[1:] > 0.6).all() and worked[0].abs() < 1e-2
    torch.testing.assert_close(gained - gained[0], worked - worked[0], rtol=0.02, atol=0.0)
    speed = engine.state.joint_velocity
    engine.step(zeros, zeros, -0.1 * torque.abs() * speed.sign())
    measures, fast = engine.measures(), speed.abs() > 2.0
    assert fast.sum() >= 10
    assert (measures.braking_power[fast] > 0.0).all() and (measures.driving_power[fast] == 0.0).all()


@on_every_ground
def test_feet_that_stand_are_in_contact_all_the_time(engine: Engine) -> None:
    """And a reset leaves the measures of the step before as they are."""
    reset_all(engine, start())
    zeros = torch.zeros(NUM_ENVS, NUM_JOINTS)
    for _ in range(20):
        engine.step(zeros, zeros, zeros)
    measures = engine.measures()
    reset_all(engine, start(height=5.0))
    assert torch.equal(engine.measures().contact, measures.contact)
    torch.testing.assert_close(measures.contact, torch.ones(NUM_ENVS, 2))
    torch.testing.assert_close(measures.flight, torch.zeros(NUM_ENVS))
    engine.step(zeros, zeros, zeros)
    assert not engine.measures().contact.any() and torch.equal(measures.contact, torch.ones(NUM_ENVS, 2))


def test_torque_is_limited(engine: Engine) -> None:
    """However large the reflex torque, the motors give no more than their limit."""
    reset_all(engine, start(height=5.0))
    zeros = torch.zeros(NUM_ENVS, NUM_JOINTS)
    huge = 1e4 * random_targets(6, scale=1.0).sign()
    engine.step(zeros, zeros, huge)
    limit = motors().torque_limit.expand_as(huge)
    torch.testing.assert_close(engine.state.joint_torque, limit * huge.sign(), rtol=1e-5, atol=0.0)


def test_torque_is_the_sum_of_cpg_and_reflex(engine: Engine) -> None:
    """Within its limit the motor torque of the last physics step is tau_g of Eq. 4 plus tau_r."""
    reset_all(engine, start(height=5.0))
    target, reflex = random_targets(7, scale=0.05), 10.0 * random_targets(8, scale=1.0)
    target_velocity = 3.0 * random_targets(9, scale=1.0)
    facts = motors()
    # Away from the joint limits at zero, where the knees and elbows would be pushed against their stops.
    for joint, angle in (("knee", 0.6), ("elbow", -0.6)):
        for side in ("right", "left"):
            target[:, joint_index(f"{side}_{joint}")] += angle
    values = start(height=5.0)
    values["joint_position"] = target.clone()
    reset_all(engine, values)
    for _ in range(6):
        engine.step(target, target_velocity, reflex)
    state = engine.state
    # The integrator moves the joints with the velocity it ends with; so the last step began here.
    began = state.joint_position - Physics().timestep * state.joint_velocity
    expected = reflex + pd_torque(
        target,
        target_velocity,
        began,
        state.joint_velocity,
        position_gain=facts.position_gain,
        velocity_gain=facts.velocity_gain,
    )
    torch.testing.assert_close(state.joint_torque, expected, rtol=0.0, atol=0.5)
    # The check would be empty if neither term mattered.
    assert (target_velocity.abs() > 1.5).sum() > 20 and (reflex.abs() > 5.0).sum() > 20


@on_every_ground
def test_order_of_the_file_does_not_matter(engine: Engine, permuted_mjcf: Path) -> None:
    """A robot whose file lists legs before torso and left before right moves and feels the same."""
    again = type(engine)
    permuted = again(NUM_ENVS, torch.device("cpu"), motors(), Physics(), engine.terrain, permuted_mjcf)  # type: ignore[call-arg]
    targets, reflex, zeros = random_targets(10), random_targets(11, scale=5.0), torch.zeros(NUM_ENVS, NUM_JOINTS)
    push = torch.tensor([50.0, 30.0, 0.0]).repeat(NUM_ENVS, 1)
    for each in (engine, permuted):
        reset_all(each, start())
        for _ in range(12):
            each.step(targets, zeros, reflex, push=push)
    for name, value in vars(engine.state).items():
        scale = max(1.0, value.abs().max().item())
        torch.testing.assert_close(vars(permuted.state)[name], value, rtol=0.0, atol=1e-3 * scale, msg=name)
    assert (engine.state.foot_force[:, 0] - engine.state.foot_force[:, 1]).abs().max() > 20.0
