"""The 192 observations: count, frames, units, mirror image."""

import math

import pytest
import torch

from aicpg_newton.engines import RobotState
from aicpg_newton.env import observations
from aicpg_newton.robot import humanoid, kinematics, rotations


def random_state(num_envs: int, seed: int = 0) -> RobotState:
    """A state with every number drawn at random."""
    generator = torch.Generator().manual_seed(seed)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(num_envs, *shape, generator=generator)

    angles = 0.8 * draw(3)
    return RobotState(
        root_position=draw(3),
        root_rotation=rotations.from_roll_pitch_yaw(angles[:, 0], angles[:, 1], 3 * angles[:, 2]),
        root_linear_velocity=draw(3),
        root_angular_velocity=draw(3),
        joint_position=draw(28),
        joint_velocity=draw(28),
        joint_torque=50 * draw(28),
        head_position=draw(3),
        foot_force=300 * draw(2, 3),
        foot_moment=30 * draw(2, 3),
    )


def observe(state: RobotState, *, target_heading: float = 0.0, seed: int = 5) -> dict[str, torch.Tensor]:
    """Observations by block, with random CPG and reflex quantities."""
    generator = torch.Generator().manual_seed(seed)
    joints = [torch.randn(state.joint_position.shape, generator=generator) for _ in range(3)]
    seen = observations.observe(
        state,
        torque=joints[2],
        control=(joints[0], joints[1]),
        torque_limit=humanoid.motors().torque_limit,
        target_heading=torch.full((state.joint_position.shape[0],), target_heading),
    )
    names, sizes = zip(*observations.BLOCKS, strict=True)
    return dict(zip(names, seen.split(sizes, dim=1), strict=True))


def test_there_are_192():
    """The count of the paper."""
    assert observations.NUM_OBSERVATIONS == 192
    assert sum(block.shape[1] for block in observe(random_state(3)).values()) == 192


def test_vectors_are_in_the_heading_frame():
    """Facing left and moving left is moving forward; the left foot's sideways force is on the left."""
    state = random_state(1)
    quarter = torch.tensor([math.pi / 2])
    state.root_rotation = rotations.about_z(quarter)
    state.root_linear_velocity = torch.tensor([[0.0, 2.0, 0.5]])
    state.root_angular_velocity = torch.tensor([[0.0, 1.0, 3.0]])
    state.foot_force = torch.tensor([[[0.0, 0.0, 479.709], [-479.709, 0.0, 0.0]]])
    state.foot_moment = torch.tensor([[[0.0, 47.9709, 0.0], [0.0, 0.0, 0.0]]])
    seen = observe(state)
    assert seen["linear_velocity"][0].tolist() == pytest.approx([2.0, 0.0, 0.5], abs=1e-6)
    assert seen["angular_velocity"][0].tolist() == pytest.approx([1.0, 0.0, 3.0], abs=1e-6)
    assert seen["foot_force"][0].tolist() == pytest.approx([0.0, 0.0, 1.0, 0.0, 1.0, 0.0], abs=1e-5)
    assert seen["foot_moment"][0].tolist() == pytest.approx([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-5)


def test_orientation_block():
    """Pitch, roll and angle to the target have the signs of the right-hand rule, and the target may lie anywhere."""
    state = random_state(1)
    state.root_rotation = rotations.from_roll_pitch_yaw(*(torch.tensor([angle]) for angle in (0.1, 0.2, 0.3)))
    seen = observe(state, target_heading=1.0)
    assert seen["pitch_roll_target"][0].tolist() == pytest.approx([0.2, 0.1, 0.7], abs=1e-6)
    up = math.cos(0.1) * math.cos(0.2)
    assert seen["up_and_heading"][0].tolist() == pytest.approx([up, math.cos(0.7)], abs=1e-6)
    wrapped = observe(state, target_heading=0.3 + math.pi + 0.1)
    assert wrapped["pitch_roll_target"][0, 2].item() == pytest.approx(0.1 - math.pi, abs=1e-5)


def test_nothing_depends_on_where_the_robot_is_or_faces():
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
    common = {
        "torque": torch.zeros(4, 28),
        "control": (torch.zeros(4, 28), torch.zeros(4, 28)),
        "torque_limit": humanoid.motors().torque_limit,
    }
    before = observations.observe(state, target_heading=torch.zeros(4), **common)
    after = observations.observe(turned, target_heading=angle, **common)
    assert torch.allclose(before, after, atol=1e-4)


def mirrored_state(state: RobotState) -> RobotState:
    """The state seen in a mirror standing in the x-z plane."""
    vector, axial = torch.tensor([1.0, -1.0, 1.0]), torch.tensor([-1.0, 1.0, -1.0])
    return RobotState(
        root_position=state.root_position * vector,
        root_rotation=state.root_rotation * torch.tensor([-1.0, 1.0, -1.0, 1.0]),
        root_linear_velocity=state.root_linear_velocity * vector,
        root_angular_velocity=state.root_angular_velocity * axial,
        joint_position=humanoid.mirror_joints(state.joint_position),
        joint_velocity=humanoid.mirror_joints(state.joint_velocity),
        joint_torque=humanoid.mirror_joints(state.joint_torque),
        head_position=state.head_position * vector,
        foot_force=state.foot_force.flip(1) * vector,
        foot_moment=state.foot_moment.flip(1) * axial,
    )


def test_mirror_image_of_observations_is_the_observation_of_the_mirror_image():
    """Mirroring the world and then looking is looking and then mirroring, for all 192 numbers."""
    state = random_state(6)
    common = {"torque_limit": humanoid.motors().torque_limit}
    torque, target, cpg_torque = torch.randn(3, 6, 28)
    image = humanoid.mirror_joints
    heading = torch.linspace(-1, 1, 6)
    seen = observations.observe(state, target_heading=heading, torque=torque, control=(target, cpg_torque), **common)
    expected = observations.observe(
        mirrored_state(state),
        target_heading=-heading,
        torque=image(torque),
        control=(image(target), image(cpg_torque)),
        **common,
    )
    assert torch.allclose(observations.mirror(seen), expected, atol=1e-5)
    assert not torch.allclose(seen, expected, atol=0.1)


def test_without_a_cpg_the_first_136_remain():
    """The baselines see the same of the body, and the same mirror map holds for it."""
    state = random_state(3)
    common = {"torque_limit": humanoid.motors().torque_limit, "target_heading": torch.zeros(3)}
    torque, target, cpg_torque = torch.randn(3, 3, 28)
    whole = observations.observe(state, torque=torque, control=(target, cpg_torque), **common)
    body = observations.observe(state, torque=torque, control=(), **common)
    assert body.shape == (3, 136)
    assert torch.equal(body, whole[:, :136])
    assert torch.equal(observations.mirror(body), observations.mirror(whole)[:, :136])


def test_height_is_above_the_ground():
    """Standing on a hill is not being taller."""
    state = random_state(2)
    common = {"torque_limit": humanoid.motors().torque_limit, "target_heading": torch.zeros(2)}
    common["torque"] = torch.zeros(2, 28)
    seen = observations.observe(state, ground_height=torch.tensor([0.5, -0.25]), control=(), **common)
    assert torch.allclose(seen[:, 0], state.root_position[:, 2] - torch.tensor([0.5, -0.25]))


def test_mirroring_twice_is_the_identity():
    """For all 192 observations."""
    seen = torch.randn(3, 192)
    assert torch.equal(observations.mirror(observations.mirror(seen)), seen)


def test_torques_are_in_units_of_their_limits():
    """A joint at its limit reads one."""
    state = random_state(1)
    state.joint_torque = humanoid.motors().torque_limit.unsqueeze(0).clone()
    assert observe(state)["joint_torque"].unique().tolist() == [1.0]


def test_kinematic_mirror_of_the_root_matches():
    """The mirrored quaternion of the tests above is the one kinematics needs."""
    state = random_state(3)
    links, _ = kinematics.forward_kinematics(state.root_position, state.root_rotation, state.joint_position)
    image = mirrored_state(state)
    mirrored, _ = kinematics.forward_kinematics(image.root_position, image.root_rotation, image.joint_position)
    swapped = links[:, list(humanoid.LINK_MIRROR_PERMUTATION)] * torch.tensor([1.0, -1.0, 1.0])
    assert torch.allclose(mirrored, swapped, atol=1e-5)
