"""What tests share: one thread, the shipped pattern network, and an engine that does as it is told."""

import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aicpg_newton.engines import BodyState, RobotState, StepMeasures
from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning import work
from aicpg_newton.robot.humanoid import MJCF_PATH, NUM_JOINTS
from aicpg_newton.robot.locomotion import feet_on_ground

torch.set_num_threads(1)  # the tensors are small, and threads that wait for one another cost more than they save


class PuppetEngine:
    """An engine without physics: the robot takes the pose of its targets, and a test may overwrite any of its state."""

    name = "puppet"

    def __init__(self, num_envs: int, terrain: Terrain | None = None) -> None:
        self.num_envs = num_envs
        self.terrain = terrain
        self.device = torch.device("cpu")
        self.overflowed = torch.zeros(num_envs, dtype=torch.bool)
        self.overrides: dict[str, torch.Tensor] = {}
        self.calls: list[dict[str, torch.Tensor | None]] = []
        upright = torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(num_envs, 1)
        self.state = RobotState(
            root_position=torch.tensor([0.0, 0.0, 0.88]).repeat(num_envs, 1),
            root_rotation=upright,
            root_linear_velocity=torch.zeros(num_envs, 3),
            root_angular_velocity=torch.zeros(num_envs, 3),
            joint_position=torch.zeros(num_envs, NUM_JOINTS),
            joint_velocity=torch.zeros(num_envs, NUM_JOINTS),
            joint_torque=torch.zeros(num_envs, NUM_JOINTS),
            head_position=torch.tensor([0.0, 0.0, 1.5]).repeat(num_envs, 1),
            foot_force=torch.zeros(num_envs, 2, 3),
            foot_moment=torch.zeros(num_envs, 2, 3),
        )

    def step(self, target, target_velocity, torque, *, push=None) -> None:
        """Take the targets, then the overrides."""
        self.calls.append({"target": target, "torque": torque, "push": push})
        obeyed = {"joint_position": target.clone(), "joint_velocity": target_velocity.clone()}
        self.state = replace(self.state, **{**obeyed, **self.overrides})

    def measures(self) -> StepMeasures:
        """As if the whole step had been as its end is."""
        state = self.state
        power, contact = state.joint_torque * state.joint_velocity, feet_on_ground(state.foot_force)
        flight = ~contact.any(dim=1)
        return StepMeasures(power.clamp_min(0.0), (-power).clamp_min(0.0), contact.float(), flight.float())

    def reset(self, mask: torch.Tensor, start: BodyState) -> None:
        """Take the masked rows."""
        self.last_reset = {"mask": mask.clone(), **vars(start)}
        rows = mask.unsqueeze(1)
        changed = {name: torch.where(rows, value, getattr(self.state, name)) for name, value in vars(start).items()}
        self.state = replace(self.state, **changed)

    def compile(self) -> None:
        """There is nothing to compile."""

    def overflows(self) -> int:
        """Never."""
        return 0

    def snapshot(self) -> dict[str, torch.Tensor]:
        """What a state holds."""
        return dict(vars(self.state))

    def restore(self, snapshot: dict[str, torch.Tensor]) -> None:
        """Take over such a snapshot."""
        self.state = RobotState(**snapshot)


@pytest.fixture(autouse=True)
def nothing_is_demonstrated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trainings of tests show nothing of themselves, which would take longer than they do."""
    monkeypatch.setattr(work, "Demonstration", lambda task, pattern, folder: None)


@pytest.fixture
def puppet():
    """Class of the engine without physics."""
    return PuppetEngine


@pytest.fixture(scope="session")
def pattern() -> PatternNetwork:
    """The shipped pattern network."""
    return PatternNetwork.load()


@pytest.fixture
def permuted_mjcf(tmp_path: Path) -> Path:
    """The humanoid's file with legs before torso and left before right."""
    tree = ElementTree.parse(MJCF_PATH)
    for body in list(tree.getroot().iter("body")):
        children = body.findall("body")
        for child in children:
            body.remove(child)
        body.extend(reversed(children))
    path = tmp_path / "permuted.xml"
    tree.write(path)
    return path
