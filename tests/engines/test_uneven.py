"""Uneven ground, on both engines: it is where the terrain says, feels like ground, and holds fallen robots too."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
import warp as wp

from aicpg_newton.engines import ENGINES, BodyState, Engine, Physics, kernels
from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import CONTROL_DT, FOOT_NAMES, GRAVITY, NUM_JOINTS, TOTAL_MASS, joint_index, motors
from aicpg_newton.robot.kinematics import forward_kinematics, skeleton, sole_heights

NUM_ENVS = 32
STANDING_HEIGHT = 0.8815
RIM, BOTTOM = 0.05, -0.5
HEAD_RADIUS = 0.095
NEAR = 0.004
"""Clearance [m] that a control step's fall of 1.7 mm does not close, and penetration that it does not open."""


def landscape() -> Terrain:
    """Rough up to x = 7 m, where no cell is flat, then level, with a pit 4 m wide around x = 12 m."""
    ground = Ground(length=16.0, width=8.0)
    heights = 0.1 * torch.rand(65, 33, generator=torch.Generator().manual_seed(0))
    heights[28:] = RIM
    heights[40:57, 8:25] = BOTTOM
    return Terrain(ground, heights)


@pytest.fixture(scope="module", params=["newton", "mujoco"])
def engine(request: pytest.FixtureRequest) -> Engine:
    """Each engine once, on the CPU."""
    return ENGINES[request.param]()(NUM_ENVS, torch.device("cpu"), motors(), Physics(), landscape())


def put(
    engine: Engine,
    root_position: torch.Tensor,
    root_rotation: torch.Tensor,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    """Put the robots there, all with this velocity of their roots, joints at zero."""
    zeros = torch.zeros(engine.num_envs, NUM_JOINTS)
    start = BodyState(
        root_position=root_position,
        root_rotation=root_rotation,
        root_linear_velocity=torch.tensor(velocity).repeat(engine.num_envs, 1),
        root_angular_velocity=torch.zeros(engine.num_envs, 3),
        joint_position=zeros,
        joint_velocity=zeros,
    )
    engine.reset(torch.ones(engine.num_envs, dtype=torch.bool), start)


def drive(engine: Engine, steps: int, target: torch.Tensor | None = None) -> None:
    """Step with these target angles, zero by default."""
    zeros = torch.zeros(engine.num_envs, NUM_JOINTS)
    for _ in range(steps):
        engine.step(zeros if target is None else target, zeros, zeros)


def somewhere_rough(generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Root positions 1 m high in the rough part, and rotations that face anywhere."""
    share = torch.rand(NUM_ENVS, 3, generator=generator)
    position = torch.tensor([1.5, -2.5, 1.0]) + share * torch.tensor([5.0, 5.0, 0.0])
    return position, rotations.about_z(2 * math.pi * share[:, 2])


def test_the_terrain_is_on_the_engine(engine: Engine) -> None:
    """Others ask the engine for the ground's height."""
    assert engine.terrain is not None
    assert torch.equal(engine.terrain.heights, landscape().heights)


def test_feet_meet_the_surface_where_the_terrain_says(engine: Engine, clearance: Callable[..., torch.Tensor]) -> None:
    """4 mm above the surface neither foot feels anything, 4 mm below it one does, at 32 places and facings."""
    assert engine.terrain is not None
    position, rotation = somewhere_rough(torch.Generator().manual_seed(1))
    gap = clearance(engine.terrain, position, rotation, torch.zeros(NUM_ENVS, NUM_JOINTS)).amin(dim=1)
    for height, touching in ((NEAR, False), (-NEAR, True)):
        position[:, 2] += height - gap
        gap = torch.full_like(gap, height)
        put(engine, position, rotation)
        drive(engine, 1)
        felt = engine.state.foot_force.norm(dim=2).amax(dim=1) > 0.0
        assert (felt == touching).all(), (height, felt)


def test_heads_meet_the_surface_where_the_terrain_says(engine: Engine) -> None:
    """The same for a ball: upside down, the head stops the fall 4 mm below the surface and not 4 mm above it."""
    assert engine.terrain is not None
    position, facing = somewhere_rough(torch.Generator().manual_seed(2))
    rotation = rotations.multiply(facing, torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(NUM_ENVS, 4))
    put(engine, position, rotation)
    offset = torch.linspace(-0.1, 0.1, 51)
    around = torch.stack(torch.meshgrid(offset, offset, indexing="ij"), dim=-1).reshape(-1, 2)
    points = engine.state.head_position[:, None, :2] + around
    aside = HEAD_RADIUS**2 - around.square().sum(dim=1)
    # The lowest centre at which no point of the surface is inside of the ball.
    lowest = (engine.terrain.height(points) + aside.clamp_min(0.0).sqrt()).where(aside >= 0.0, -1.0).amax(dim=1)
    head = engine.state.head_position[:, 2]
    for height, touching in ((NEAR, False), (-NEAR, True)):
        placed = position.clone()
        placed[:, 2] += lowest + height - head
        put(engine, placed, rotation)
        drive(engine, 1)
        stopped = engine.state.root_linear_velocity[:, 2] > -GRAVITY * CONTROL_DT + 1e-3
        assert (stopped == touching).all(), (height, stopped)


def test_a_robot_over_a_pit_falls_to_its_bottom(engine: Engine) -> None:
    """A pit is no part of the ground's convex hull: who is left at the rim's height falls, who stands on it stands."""
    position = torch.tensor([12.0, 0.0, STANDING_HEIGHT]).repeat(NUM_ENVS, 1)
    position[:, 1] += torch.linspace(-1.0, 1.0, NUM_ENVS)
    standing = torch.arange(NUM_ENVS) % 2 == 0
    position[:, 2] += torch.where(standing, BOTTOM, RIM)
    put(engine, position, torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(NUM_ENVS, 1))
    balance = torch.zeros(NUM_ENVS, NUM_JOINTS)
    balance[:, [joint_index("right_ankle_y"), joint_index("left_ankle_y")]] = -0.01
    drive(engine, 15, balance)
    assert (engine.state.foot_force[~standing] == 0.0).all()
    drive(engine, 15, balance)
    state = engine.state
    soles = sole_heights(state.root_position, state.root_rotation, state.joint_position).amin(dim=1) - BOTTOM
    assert (soles[standing].abs() < 0.002).all(), soles
    assert (soles[~standing] > -0.02).all() and (soles[~standing] < 0.1).all(), soles
    weight = state.foot_force[standing].sum(dim=1)
    torch.testing.assert_close(
        weight, torch.tensor([0.0, 0.0, TOTAL_MASS * GRAVITY]).expand_as(weight), rtol=0.0, atol=25.0
    )


def test_fallen_robots_lie_on_the_ground(engine: Engine) -> None:
    """All links collide: robots dropped in any pose and attitude end with no joint and no head in the ground."""
    assert engine.terrain is not None
    generator = torch.Generator().manual_seed(3)
    position, _ = somewhere_rough(generator)
    rotation = rotations.from_euler_xyz(2 * math.pi * torch.rand(NUM_ENVS, 3, generator=generator))
    lower, upper = skeleton().ranges.unbind(dim=1)
    pose = 0.5 * (lower + (upper - lower) * torch.rand(NUM_ENVS, NUM_JOINTS, generator=generator))
    put(engine, position, rotation)
    drive(engine, 60, pose)
    state = engine.state
    assert state.finite().all()
    links, _ = forward_kinematics(state.root_position, state.root_rotation, state.joint_position)
    depth = engine.terrain.height(links) - links[..., 2]
    head = state.head_position[:, 2] - engine.terrain.height(state.head_position)
    assert depth.amax() < 0.02 and head.amin() > HEAD_RADIUS - 0.02, (depth.amax(dim=1), head)
    assert (depth[:, 0] > -0.6).all(), "they have not fallen"
    assert engine.overflows() == 0


@pytest.mark.parametrize("name", ["newton", "mujoco"])
def test_no_walls_between_triangles(name: str) -> None:
    """On slippery level ground soles slide over the edges of many triangles and feel the friction alone."""
    terrain = Terrain(Ground(length=16.0, width=8.0), torch.zeros(65, 33))
    slippery = Physics(friction=0.02, iterations=100, ls_iterations=50)
    engine = ENGINES[name]()(NUM_ENVS, torch.device("cpu"), motors(), slippery, terrain)
    position, rotation = somewhere_rough(torch.Generator().manual_seed(4))
    position[:, 2] = STANDING_HEIGHT + 0.01 * torch.linspace(0.0, 1.0, NUM_ENVS)
    put(engine, position, rotation, velocity=(2.0, 1.0, -1.0))
    along, up = torch.zeros(NUM_ENVS), torch.zeros(NUM_ENVS)
    for _ in range(20):
        drive(engine, 1)
        force = engine.state.foot_force
        along += force[..., :2].norm(dim=2).sum(dim=1)
        up += force[..., 2].sum(dim=1)
    assert (up > 10 * TOTAL_MASS * GRAVITY).all()
    assert (along < 0.025 * up).all(), along / up


def test_contacts_beyond_the_buffer_are_counted() -> None:
    """Too small a buffer shows up as overflow, with the number that would have fitted."""
    physics = Physics(max_contacts=1)
    engine = ENGINES["newton"]()(2, torch.device("cpu"), motors(), physics, landscape())
    position = torch.tensor([9.0, 0.0, RIM + STANDING_HEIGHT]).repeat(2, 1)
    put(engine, position, torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(2, 1))
    drive(engine, 1)
    assert engine.overflows() == 2
    assert engine.high_water()["contacts"] >= 4 * len(FOOT_NAMES)  # type: ignore[attr-defined]
    assert engine.overflowed.all()  # they share the buffer
    put(engine, position + torch.tensor([0.0, 0.0, 5.0]), torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(2, 1))
    drive(engine, 1)
    assert not engine.overflowed.any() and engine.overflows() == 2


def test_constraints_beyond_the_buffer_are_each_worlds_own() -> None:
    """Bits of buffers are kept over the physics steps of a control step, those of iterations are not."""
    overflow, ever, most = (wp.zeros(number, dtype=wp.int32, device="cpu") for number in (3, 3, 2))
    rows = wp.zeros((3, 100), dtype=wp.float32, device="cpu")
    hinges = wp.array(np.arange(NUM_JOINTS), dtype=wp.int32, device="cpu")
    wrench = wp.zeros((3, 2), dtype=wp.spatial_vectorf, device="cpu")
    for bits in ([0, 1, 8], [0, 0, 8]):
        given = wp.array(bits, dtype=wp.int32, device="cpu")
        inputs = [
            *(rows, rows, hinges, rows, 0.25, wrench),
            given,
            7,
            wp.array([4, 5, 6], dtype=wp.int32, device="cpu"),
            wp.array([9], dtype=wp.int32, device="cpu"),
        ]
        outputs = [wrench, rows, overflow, ever, most]
        wp.launch(kernels.measure_step, dim=(3, NUM_JOINTS), inputs=inputs, outputs=outputs, device="cpu")
    assert overflow.numpy().tolist() == ever.numpy().tolist() == [0, 1, 0] and most.numpy().tolist() == [6, 9]


@pytest.mark.parametrize(("triangles", "unbuffered", "unreduced"), [(5, 0, 0), (4, 1, 0), (4, 0, 1), (4, 0, 0)])
def test_lost_triangles_mark_every_world(triangles: int, unbuffered: int, unreduced: int) -> None:
    """Whichever buffer of the collision detection is full, no world can be sure of its contacts."""
    overflow = wp.zeros(3, dtype=wp.int32, device="cpu")
    counts = [wp.array([count], dtype=wp.int32, device="cpu") for count in (triangles, unbuffered, unreduced)]
    inputs = [counts[0], 4, counts[1], counts[2]]
    wp.launch(kernels.note_lost_contacts, dim=3, inputs=inputs, outputs=[overflow], device="cpu")
    assert (overflow.numpy() != 0).all() == ((triangles, unbuffered, unreduced) != (4, 0, 0))
