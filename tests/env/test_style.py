"""The style state: count, frames, invariances, mirror image; the reference made of the imitated gaits."""

import math
import xml.etree.ElementTree as ElementTree

import pytest
import torch

from aicpg_newton.engines import BodyState
from aicpg_newton.env import style
from aicpg_newton.env.observations import mirror_of
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.robot import humanoid, rotations
from aicpg_newton.robot.humanoid import CONTROL_DT
from aicpg_newton.robot.kinematics import forward_kinematics
from aicpg_newton.robot.mirror import JOINTS

MIRROR = mirror_of(style.BLOCKS)


def random_motion(seed: int = 0, *shape: int) -> dict[str, torch.Tensor]:
    """A body state and its ground height drawn at random, batch of the given shape, else 3."""
    generator = torch.Generator().manual_seed(seed)
    shape = shape or (3,)

    def draw(*tail: int) -> torch.Tensor:
        return torch.randn(*shape, *tail, generator=generator)

    angles = 0.6 * draw(3)
    return {
        "root_position": draw(3),
        "root_rotation": rotations.from_roll_pitch_yaw(angles[..., 0], angles[..., 1], 3 * angles[..., 2]),
        "root_linear_velocity": draw(3),
        "root_angular_velocity": draw(3),
        "joint_position": draw(28),
        "joint_velocity": draw(28),
        "ground_height": draw(),
    }


def look(motion: dict[str, torch.Tensor]) -> torch.Tensor:
    """The style state of such a motion."""
    rest = dict(motion)
    ground_height = rest.pop("ground_height")
    return style.style_state(BodyState(**rest), ground_height)


def by_block(state: torch.Tensor) -> dict[str, torch.Tensor]:
    """A style state's blocks by name."""
    parts = state.split([block.mirror.size for block in style.BLOCKS], dim=-1)
    return {block.name: part for block, part in zip(style.BLOCKS, parts, strict=True)}


def test_size_and_batch():
    """81 numbers, for a batch of any shape."""
    assert MIRROR.size == 81
    motion = random_motion(0, 4, 2)
    state = look(motion)
    assert state.shape == (4, 2, 81)
    rows = {name: value.flatten(0, 1) for name, value in motion.items()}
    assert torch.allclose(look(rows), state.flatten(0, 1), atol=1e-6)


def test_position_and_yaw_in_the_world_do_not_matter():
    """Nor does the height, as long as the ground comes along."""
    motion = random_motion()
    turn = rotations.about_z(torch.tensor([0.4, -2.0, 3.0]))
    moved = dict(motion)
    for name in ("root_position", "root_linear_velocity", "root_angular_velocity"):
        moved[name] = rotations.rotate(turn, motion[name])
    moved["root_position"] = moved["root_position"] + torch.tensor([5.0, -3.0, 0.7])
    moved["root_rotation"] = rotations.multiply(turn, motion["root_rotation"])
    moved["ground_height"] = motion["ground_height"] + 0.7
    assert torch.allclose(look(moved), look(motion), atol=1e-5)


def test_everything_else_matters():
    """Height, ground, roll, pitch, each component of each velocity and each joint change the state."""
    motion = random_motion(1, 1)
    before = look(motion)
    changed = [
        {**motion, "root_position": motion["root_position"] + torch.tensor([0.0, 0.0, 0.01])},
        {**motion, "ground_height": motion["ground_height"] + 0.01},
    ]
    for axis in torch.eye(3)[:2]:
        turn = rotations.about_axis(axis.unsqueeze(0), torch.tensor([0.01]))
        changed.append({**motion, "root_rotation": rotations.multiply(motion["root_rotation"], turn)})
    for name in ("root_linear_velocity", "root_angular_velocity", "joint_position", "joint_velocity"):
        changed += [{**motion, name: motion[name] + step} for step in 0.01 * torch.eye(motion[name].shape[-1])]
    assert len(changed) == 2 + 2 + 3 + 3 + 28 + 28
    for other in changed:
        assert (look(other) - before).abs().max() > 5e-3


def test_frames_of_the_blocks():
    """Facing and moving left is moving forward; leaning forward tips the x axis down and the z axis forward."""
    motion = random_motion(2, 1)
    quarter, lean = torch.tensor([math.pi / 2]), torch.tensor([0.3])
    motion["root_rotation"] = rotations.from_roll_pitch_yaw(torch.zeros(1), lean, quarter)
    motion["root_position"] = torch.tensor([[9.0, 9.0, 1.2]])
    motion["ground_height"] = torch.tensor([0.3])
    motion["root_linear_velocity"] = torch.tensor([[0.0, 2.0, 0.5]])
    motion["root_angular_velocity"] = torch.tensor([[-1.0, 0.0, 3.0]])
    seen = {name: block[0].tolist() for name, block in by_block(look(motion)).items()}
    assert seen["root_height"] == pytest.approx([0.9])
    sine, cosine = math.sin(0.3), math.cos(0.3)
    assert seen["root_forward"] == pytest.approx([cosine, 0.0, -sine], abs=1e-6)
    assert seen["root_up"] == pytest.approx([sine, 0.0, cosine], abs=1e-6)
    assert seen["linear_velocity"] == pytest.approx([2.0, 0.0, 0.5], abs=1e-6)
    assert seen["angular_velocity"] == pytest.approx([0.0, 1.0, 3.0], abs=1e-6)
    assert seen["joint_position"] == motion["joint_position"][0].tolist()
    assert seen["joint_velocity"] == motion["joint_velocity"][0].tolist()


def test_hands_and_feet():
    """Positions relative to the pelvis as forward kinematics in the world has them; the hand is the file's sphere."""
    motion = random_motion(3, 1)
    motion["root_rotation"] = rotations.from_roll_pitch_yaw(*torch.tensor([[0.2], [-0.1], [0.0]]))
    links = ("right_lower_arm", "left_lower_arm", "right_foot", "left_foot")
    origin, turned = forward_kinematics(
        motion["root_position"], motion["root_rotation"], motion["joint_position"], links
    )
    tree = ElementTree.parse(humanoid.MJCF_PATH)
    for side, name in enumerate(("right_hand", "left_hand")):
        sphere = tree.find(f".//geom[@name='{name}']")
        assert sphere is not None
        centre = torch.tensor([[float(word) for word in sphere.attrib["pos"].split()]])
        origin[:, side] += rotations.rotate(turned[:, side], centre)
    relative = (origin - motion["root_position"].unsqueeze(1)).flatten()
    seen = by_block(look(motion))
    assert torch.allclose(torch.cat((seen["hand_position"][0], seen["foot_position"][0])), relative, atol=1e-5)


def test_mirror_image_of_the_state_is_the_state_of_the_mirror_image():
    """Mirroring the world and then looking is looking and then mirroring; twice is the identity."""
    motion = random_motion(4)
    vector, axial = torch.tensor([1.0, -1.0, 1.0]), torch.tensor([-1.0, 1.0, -1.0])
    image = {
        "root_position": motion["root_position"] * vector,
        "root_rotation": motion["root_rotation"] * torch.tensor([-1.0, 1.0, -1.0, 1.0]),
        "root_linear_velocity": motion["root_linear_velocity"] * vector,
        "root_angular_velocity": motion["root_angular_velocity"] * axial,
        "joint_position": JOINTS(motion["joint_position"]),
        "joint_velocity": JOINTS(motion["joint_velocity"]),
        "ground_height": motion["ground_height"],
    }
    state = look(motion)
    assert torch.allclose(MIRROR(state), look(image), atol=1e-5)
    assert not torch.allclose(MIRROR(state), state, atol=0.1)
    assert torch.equal(MIRROR(MIRROR(state)), state)


@pytest.mark.parametrize(("gait", "speed"), [("walk", 1.149), ("run", 3.019)])
def test_reference_motion(pattern: PatternNetwork, gait: str, speed: float):
    """One stride: the gait's speed, level on average, and velocities that are the rates of the positions."""
    frequency = next(each.frequency for each in pattern.gaits if each.name == gait)
    reference = style.reference_motion(pattern, gait, phases=256)
    assert reference.shape == (256, 2, 81)
    assert torch.isfinite(reference).all()
    seen = by_block(reference)
    assert seen["linear_velocity"][:, 0].mean(0).tolist() == pytest.approx([speed, 0.0, 0.0], abs=0.01)
    assert seen["angular_velocity"][:, 0].mean(0).tolist() == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)
    for position, velocity in (
        (seen["joint_position"], seen["joint_velocity"]),
        (seen["root_height"], seen["linear_velocity"][..., 2:]),
    ):
        rate, change = velocity.mean(dim=1), (position[:, 1] - position[:, 0]) / CONTROL_DT
        assert (change - rate).square().mean() < 0.1**2 * rate.square().mean()
    steps_per_stride = 256 * CONTROL_DT * frequency  # the second state is the first one of a later phase
    later = reference[:, 0].roll(-round(steps_per_stride), dims=0)
    assert (reference[:, 1] - later).abs().mean() < 0.05 * reference[:, 0].std(dim=0).mean()


def test_reference_motion_is_symmetric(pattern: PatternNetwork):
    """Half a stride later it is its own mirror image."""
    reference = style.reference_motion(pattern, "run", phases=64)
    assert torch.allclose(MIRROR(reference), reference.roll(32, dims=0), atol=1e-3)


def test_unknown_gait(pattern: PatternNetwork):
    """The message lists what there is."""
    with pytest.raises(UserError, match=r"no gait 'hop'; give one of walk, run"):
        style.reference_motion(pattern, "hop")
