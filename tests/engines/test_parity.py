"""The two engines step the same robot: trained on one, run on the other."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from aicpg_newton.engines import ENGINES, BodyState, Physics, RobotState
from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.robot.humanoid import NUM_JOINTS, motors
from aicpg_newton.robot.kinematics import skeleton

NUM_ENVS = 32
STEPS = 15  # 0.25 s


@pytest.mark.parametrize(
    ("ground", "newtons"),
    [(Ground(), 5.0), (Ground(height_range=0.1, length=10.0, width=8.0), 15.0)],
    ids=["plane", "terrain"],
)
def test_engines_agree_over_a_quarter_second_of_contact(
    ground: Ground, newtons: float, clearance: Callable[..., torch.Tensor]
) -> None:
    """From random poses, with random targets and torques, the median environment ends within 5 mm and 0.02 rad.

    On uneven ground the engines choose other contact points, which shows in the forces most.
    """
    terrain = Terrain.make(ground)
    generator = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    lower, upper = skeleton().ranges.unbind(dim=1)
    pose = (0.1 * normal(NUM_ENVS, NUM_JOINTS)).clamp(lower, upper)
    target = (pose + 0.1 * normal(NUM_ENVS, NUM_JOINTS)).clamp(lower, upper)
    target_velocity, reflex = normal(NUM_ENVS, NUM_JOINTS), 5.0 * normal(NUM_ENVS, NUM_JOINTS)
    upright = torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(NUM_ENVS, 1)
    position = torch.tensor([5.0, 0.0, 0.0]).repeat(NUM_ENVS, 1)
    position[:, :2] += 4.0 * torch.rand(NUM_ENVS, 2, generator=torch.Generator().manual_seed(1)) - 2.0
    level = Terrain(ground, torch.zeros(2, 2)) if terrain is None else terrain
    position[:, 2] = -clearance(level, position, upright, pose).amin(dim=1)  # one foot just touches the ground
    initial = BodyState(
        root_position=position,
        root_rotation=upright,
        root_linear_velocity=0.3 * normal(NUM_ENVS, 3),
        root_angular_velocity=0.3 * normal(NUM_ENVS, 3),
        joint_position=pose,
        joint_velocity=0.3 * normal(NUM_ENVS, NUM_JOINTS),
    )
    ends: dict[str, RobotState] = {}
    loads: dict[str, torch.Tensor] = {}
    for name, load in ENGINES.items():
        engine = load()(NUM_ENVS, torch.device("cpu"), motors(), Physics(), terrain)
        engine.reset(torch.ones(NUM_ENVS, dtype=torch.bool), initial)
        loads[name] = torch.zeros(NUM_ENVS, 2, 6)
        for _ in range(STEPS):
            engine.step(target, target_velocity, reflex)
            loads[name] += torch.cat((engine.state.foot_force, engine.state.foot_moment), dim=-1) / STEPS
        assert engine.overflows() == 0
        ends[name] = engine.state
    newton, mujoco = ends["newton"], ends["mujoco"]
    assert newton.finite().all() and mujoco.finite().all()
    root = (newton.root_position - mujoco.root_position).norm(dim=1)
    joint = (newton.joint_position - mujoco.joint_position).abs().amax(dim=1)
    head = (newton.head_position - mujoco.head_position).norm(dim=1)
    load = (loads["newton"] - loads["mujoco"]).abs().flatten(1)
    for quantity, spread, unit in (
        ("root", root, "m"),
        ("worst joint", joint, "rad"),
        ("head", head, "m"),
        ("mean foot force", load[:, [0, 1, 2, 6, 7, 8]].amax(dim=1), "N"),
        ("mean foot moment", load[:, [3, 4, 5, 9, 10, 11]].amax(dim=1), "N m"),
    ):
        quarter, middle, most, worst = spread.quantile(torch.tensor([0.25, 0.5, 0.9, 1.0])).tolist()
        print(f"{quantity}: 25 % {quarter:.2e}, median {middle:.2e}, 90 % {most:.2e}, worst {worst:.2e} {unit}")
    assert root.median() < 0.005 and joint.median() < 0.02 and head.median() < 0.005
    assert load.amax(dim=1).median() < newtons
    # Standing still would prove little: the robots moved, and stood on the ground while they did.
    assert (newton.joint_position - pose).abs().amax(dim=1).median() > 0.1
    assert (loads["mujoco"][..., 2].sum(dim=1) > 100.0).all()
