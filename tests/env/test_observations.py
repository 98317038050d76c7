"""The 192 observations: count, frames, units, mirror image."""

import math
from collections.abc import Callable

import pytest
import torch

from aicpg_newton.engines import RobotState
from aicpg_newton.env import observations
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.observations import BODY, PATTERN, Block
from aicpg_newton.env.registry import get_task
from aicpg_newton.learning.runner import Runner
from aicpg_newton.robot import humanoid, kinematics, rotations
from aicpg_newton.robot.mirror import JOINTS, LINKS, VECTOR

BLOCKS = (*BODY, *PATTERN)
MIRROR = observations.mirror_of(BLOCKS)


@pytest.fixture
def look(view_of, random_state) -> Callable[..., dict[str, torch.Tensor]]:
    """Observations of a state by block, with random CPG and action torques."""

    def by_block(state: RobotState, **given) -> dict[str, torch.Tensor]:
        drawn = torch.randn(3, len(state.root_position), 28, generator=torch.Generator().manual_seed(5))
        view = view_of(state, **{**dict(zip(("target", "target_velocity", "torque"), drawn, strict=True)), **given})
        sizes = [block.mirror.size for block in BLOCKS]
        parts = observations.observe(BLOCKS, view).split(sizes, dim=1)
        return {block.name: part for block, part in zip(BLOCKS, parts, strict=True)}

    return by_block


def test_there_are_192(look, random_state):
    """The count of the paper; the baselines see the first 136 of them."""
    assert MIRROR.size == 192 and observations.mirror_of(BODY).size == 136
    assert sum(block.shape[1] for block in look(random_state(3)).values()) == 192


def test_each_block_has_the_size_it_declares(view_of):
    """Of all methods; otherwise everything behind it would be somewhere else than its mirror image."""
    for block in BLOCKS:
        assert block.function(view_of(num_envs=3)).shape == (3, block.mirror.size), block.name


def test_vectors_are_in_the_heading_frame(look, random_state):
    """Facing left and moving left is moving forward; the left foot's sideways force is on the left."""
    state = random_state(1)
    quarter = torch.tensor([math.pi / 2])
    state.root_rotation = rotations.about_z(quarter)
    state.root_linear_velocity = torch.tensor([[0.0, 2.0, 0.5]])
    state.root_angular_velocity = torch.tensor([[0.0, 1.0, 3.0]])
    state.foot_force = torch.tensor([[[0.0, 0.0, 479.709], [-479.709, 0.0, 0.0]]])
    state.foot_moment = torch.tensor([[[0.0, 47.9709, 0.0], [0.0, 0.0, 0.0]]])
    seen = look(state)
    assert seen["linear_velocity"][0].tolist() == pytest.approx([2.0, 0.0, 0.5], abs=1e-6)
    assert seen["angular_velocity"][0].tolist() == pytest.approx([1.0, 0.0, 3.0], abs=1e-6)
    assert seen["foot_force"][0].tolist() == pytest.approx([0.0, 0.0, 1.0, 0.0, 1.0, 0.0], abs=1e-5)
    assert seen["foot_moment"][0].tolist() == pytest.approx([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-5)


def test_orientation_blocks(look, random_state):
    """Pitch, roll and angle to the target have the signs of the right-hand rule, and the target may lie anywhere."""
    state = random_state(1)
    state.root_rotation = rotations.from_roll_pitch_yaw(*(torch.tensor([angle]) for angle in (0.1, 0.2, 0.3)))
    seen = look(state, heading=1.0)
    expected = {"pitch": 0.2, "roll": 0.1, "angle_to_target": 0.7}
    expected |= {"up": math.cos(0.1) * math.cos(0.2), "cosine_to_target": math.cos(0.7)}
    assert {name: seen[name].item() for name in expected} == pytest.approx(expected, abs=1e-6)
    wrapped = look(state, heading=0.3 + math.pi + 0.1)
    assert wrapped["angle_to_target"].item() == pytest.approx(0.1 - math.pi, abs=1e-5)


def test_nothing_depends_on_where_the_robot_is_or_faces(view_of, random_state):
    """Moving the robot along the ground and turning world and target together changes no observation."""
    state, turned = random_state(4), random_state(4)
    angle = torch.tensor([0.4, -2.0, 3.0, 1.0])
    q = rotations.about_z(angle)
    feet = q.unsqueeze(1).expand(4, 2, 4)
    turned.root_position = rotations.rotate(q, state.root_position) + torch.tensor([5.0, -3.0, 0.0])
    turned.root_rotation = rotations.multiply(q, state.root_rotation)
    turned.root_linear_velocity = rotations.rotate(q, state.root_linear_velocity)
    turned.root_angular_velocity = rotations.rotate(q, state.root_angular_velocity)
    turned.foot_force = rotations.rotate(feet, state.foot_force)
    turned.foot_moment = rotations.rotate(feet, state.foot_moment)
    before = observations.observe(BLOCKS, view_of(state))
    after = observations.observe(BLOCKS, view_of(turned, heading=angle))
    assert torch.allclose(before, after, atol=1e-4)


def mirrored_state(state: RobotState) -> RobotState:
    """The state seen in a mirror standing in the x-z plane."""
    vector, axial = torch.tensor([1.0, -1.0, 1.0]), torch.tensor([-1.0, 1.0, -1.0])
    return RobotState(
        root_position=state.root_position * vector,
        root_rotation=state.root_rotation * torch.tensor([-1.0, 1.0, -1.0, 1.0]),
        root_linear_velocity=state.root_linear_velocity * vector,
        root_angular_velocity=state.root_angular_velocity * axial,
        joint_position=JOINTS(state.joint_position),
        joint_velocity=JOINTS(state.joint_velocity),
        joint_torque=JOINTS(state.joint_torque),
        head_position=state.head_position * vector,
        foot_force=state.foot_force.flip(1) * vector,
        foot_moment=state.foot_moment.flip(1) * axial,
    )


def test_mirror_image_of_observations_is_the_observation_of_the_mirror_image(view_of, random_state):
    """Mirroring the world and then looking is looking and then mirroring, for all 192 numbers."""
    state = random_state(6)
    torque, target, rate = torch.randn(3, 6, 28)
    heading = torch.linspace(-1, 1, 6)
    seen = observations.observe(
        BLOCKS, view_of(state, heading=heading, torque=torque, target=target, target_velocity=rate)
    )
    image = {"torque": JOINTS(torque), "target": JOINTS(target), "target_velocity": JOINTS(rate)}
    expected = observations.observe(BLOCKS, view_of(mirrored_state(state), heading=-heading, **image))
    assert torch.allclose(MIRROR(seen), expected, atol=1e-5)
    assert not torch.allclose(seen, expected, atol=0.1)
    assert torch.equal(MIRROR(MIRROR(seen)), seen)


def test_height_is_above_the_ground(look, random_state):
    """Standing on a hill is not being taller."""
    state = random_state(2)
    ground = torch.tensor([0.5, -0.25])
    seen = look(state, ground_height=ground)["root_height"].squeeze(1)
    assert torch.allclose(seen, state.root_position[:, 2] - ground)


def test_torques_are_in_units_of_their_limits(look, random_state):
    """A joint at its limit reads one."""
    state = random_state(1)
    state.joint_torque = humanoid.motors().torque_limit.unsqueeze(0).clone()
    assert look(state)["joint_torque"].unique().tolist() == [1.0]


def test_kinematic_mirror_of_the_root_matches(random_state):
    """The mirrored quaternion of the tests above is the one kinematics needs."""
    state = random_state(3)
    links, _ = kinematics.forward_kinematics(state.root_position, state.root_rotation, state.joint_position)
    image = mirrored_state(state)
    mirrored, _ = kinematics.forward_kinematics(image.root_position, image.root_rotation, image.joint_position)
    swapped = links[:, list(LINKS)] * torch.tensor([1.0, -1.0, 1.0])
    assert torch.allclose(mirrored, swapped, atol=1e-5)


def test_a_new_block_is_declared_once(puppet, pattern):
    """Name, mirror and function, in the task: it is seen, and a symmetric network is symmetric in it too."""
    task = get_task("flat")
    task.observations = (Block("gravity", VECTOR, lambda view: view.state.root_position - 9.0),)
    task.learning.hidden_sizes = (16,)
    environment = Environment(task, puppet(3), pattern)
    seen = environment.get_observations()["policy"]
    assert seen.shape == (3, 195) and torch.equal(seen[:, 192:], environment.engine.state.root_position - 9.0)
    actor = Runner(environment, {"seed": 0}).alg.get_policy()
    mirror = observations.mirror_of(environment.blocks)
    seen = torch.randn(5, 195)
    torch.testing.assert_close(actor({"policy": mirror(seen)}), JOINTS(actor({"policy": seen})), atol=1e-5, rtol=0.0)


def test_differences_name_both_layouts():
    """What one has and the other lacks; the order counts."""
    own = observations.layout(BLOCKS)
    assert observations.differences(own, own) == ""
    assert observations.differences([tuple(each) for each in own], own) == ""
    other = [*own[:3], ["slope", 2], *own[4:]]
    assert observations.differences(other, own) == (
        "the checkpoint's 193 numbers with slope (2) against these 192 numbers with pitch (1)"
    )
    assert "another order" in observations.differences(own[::-1], own)
