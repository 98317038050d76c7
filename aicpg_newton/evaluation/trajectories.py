"""What is kept of a roll-out to take measures from."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.evaluation import metrics
from aicpg_newton.evaluation.protocols import Protocol
from aicpg_newton.learning.policy import Agent
from aicpg_newton.playing.rollout import Tally, physical_frames, share_out
from aicpg_newton.robot.humanoid import CONTROL_DT, CONTROL_RATE, NUM_JOINTS
from aicpg_newton.robot.kinematics import centre_of_mass, sole_corners
from aicpg_newton.robot.locomotion import feet_on_ground

if TYPE_CHECKING:
    from aicpg_newton.env.environment import Environment

WARM_UP = round(1.0 * CONTROL_RATE)
"""Steps after every start that no measure counts: the first second, in which the start state dies away."""

SHORTEST = round(1.0 * CONTROL_RATE)
"""Fewest counted steps that an environment's measures are taken from: a second, about one stride."""

_CHUNK = 128  # steps of forward kinematics at a time, to bound memory
_SOLE_CHUNK = 16  # the same where each foot has a grid of points


@dataclass
class Trajectories:
    """Trajectories of a protocol, each tensor of shape [time, num_envs, ...]; states before any reset.

    A fall, turning away (facing more than the task's angle away from the target without having fallen) and coming to
    the edge of the terrain end an episode. Power, support and flight are integrated over the physics steps.
    """

    group: torch.Tensor
    """Index of the group each environment is in, shape [num_envs]."""
    terrain: Terrain | None
    """The ground; None for the plane at height 0."""
    frequency: torch.Tensor
    """Stride frequency f [Hz]."""
    root_position: torch.Tensor
    """World position of the pelvis [m], [..., 3]."""
    ground_height: torch.Tensor
    """World height of the ground below the pelvis [m]."""
    root_rotation: torch.Tensor
    """Pelvis rotation (x, y, z, w), [..., 4]."""
    joint_position: torch.Tensor
    """Joint angles [rad], [..., 28]."""
    power: torch.Tensor
    """Mechanical power of all motors, driving and braking both positive [W]."""
    contact: torch.Tensor
    """Whether each foot is on the ground (right, left) on the mean of the step, bool, [..., 2]."""
    support: torch.Tensor
    """Share of the step that each foot is on the ground, [..., 2]."""
    flight: torch.Tensor
    """Share of the step that neither foot is."""
    fallen: torch.Tensor
    """Whether the episode ended in this step with a fall, bool."""
    turned: torch.Tensor
    """Whether it ended in this step as the robot had turned away, bool."""
    ended: torch.Tensor
    """Whether it ended in this step, with a fall, by turning away or at the edge of the terrain, bool."""
    age: torch.Tensor
    """Steps since the episode began, from 0."""
    speed: torch.Tensor
    """Velocity of the centre of mass in the target direction, +x [m/s]; NaN in the first step of an episode."""

    @property
    def standing(self) -> torch.Tensor:
        """Steps before the end of the environment's first episode, bool, shape [time, num_envs]."""
        return self.ended.cumsum(dim=0) == 0

    @property
    def failed(self) -> torch.Tensor:
        """Whether the episode ended in this step with a fall or by turning away, bool, shape [time, num_envs]."""
        return self.fallen | self.turned

    @property
    def settled(self) -> torch.Tensor:
        """Steps that measures of steady locomotion count: of the first episode, after its first second."""
        return self.standing & (self.age >= WARM_UP)

    def among(self, environments: torch.Tensor) -> Trajectories:
        """The trajectories of some environments, given as a bool tensor of shape [num_envs]."""
        rows = {name: value[:, environments] for name, value in vars(self).items() if name not in ("group", "terrain")}
        return Trajectories(group=self.group[environments], terrain=self.terrain, **rows)


def record(
    protocol: Protocol,
    frequencies: torch.Tensor,
    environment: Environment,
    agent: Agent,
    progress: Callable[[int], None] = lambda step: None,
) -> Trajectories:
    """Run a protocol: the one loop for all of them.

    Args:
        protocol: What is done; its pushes are already part of the environment's task.
        frequencies: Stride frequency at the start of each group [Hz], shape [groups].
        environment: Environments whose episodes do not time out before the protocol is over.
        agent: What controls them.
        progress: Called with the number of steps done.
    """
    steps, n, device = protocol.steps, environment.num_envs, environment.device
    group = share_out(n, len(frequencies)).to(device)
    start = frequencies.to(device)[group]
    environment.restart(start)

    def empty(*shape: int, dtype: torch.dtype = torch.float) -> torch.Tensor:
        return torch.zeros(steps, n, *shape, dtype=dtype, device=device)

    kept = Trajectories(
        group=group,
        terrain=environment.engine.terrain,
        frequency=empty(),
        root_position=empty(3),
        ground_height=empty(),
        root_rotation=empty(4),
        joint_position=empty(NUM_JOINTS),
        power=empty(),
        contact=empty(2, dtype=torch.bool),
        support=empty(2),
        flight=empty(),
        fallen=empty(dtype=torch.bool),
        turned=empty(dtype=torch.bool),
        ended=empty(dtype=torch.bool),
        age=empty(dtype=torch.long),
        speed=empty(),
    )
    age = torch.zeros(n, dtype=torch.long, device=device)

    def ramp(step: int) -> torch.Tensor:
        return start + protocol.ramp * CONTROL_DT * (min(step, steps - step) if protocol.turns_back else step)

    environment.command(frequency=ramp(1))  # a command is obeyed when the step after it is over
    for step, frame in enumerate(physical_frames(environment, agent, steps, Tally(start))):
        outcome = environment.outcome
        kept.frequency[step] = frame.frequency
        kept.root_position[step] = frame.root_position
        kept.root_rotation[step] = frame.root_rotation
        kept.joint_position[step] = frame.joint_position
        measures = environment.engine.measures()
        kept.power[step] = (measures.driving_power + measures.braking_power).sum(dim=1)
        kept.support[step] = measures.contact
        kept.flight[step] = measures.flight
        kept.contact[step] = feet_on_ground(outcome.state.foot_force)
        kept.ground_height[step] = outcome.ground_height
        kept.turned[step] = outcome.off_course
        kept.fallen[step] = outcome.fallen
        kept.ended[step] = outcome.fallen | outcome.off_course | outcome.timed_out
        kept.age[step] = age
        age = torch.where(kept.ended[step], 0, age + 1)
        environment.command(frequency=ramp(step + 2))
        progress(step + 1)
    kept.speed = forward_speed(kept)
    return kept


def forward_speed(trajectories: Trajectories) -> torch.Tensor:
    """Velocity of the centre of mass along x [m/s] from its way in each step, shape [time, num_envs]; NaN at starts."""
    x = torch.cat([centre_of_mass(*chunk)[..., 0] for chunk in _poses(trajectories, _CHUNK)])
    speed = torch.full_like(x, math.nan)
    speed[1:] = (x[1:] - x[:-1]) / CONTROL_DT
    return torch.where(trajectories.age > 0, speed, math.nan)


def sole_clearance(trajectories: Trajectories) -> torch.Tensor:
    """Height of each sole's lowest point above the ground [m], [time, num_envs, 2]; NaN where a foot has no contact."""
    parts = []
    for contact, pose in zip(trajectories.contact.split(_SOLE_CHUNK), _poses(trajectories, _SOLE_CHUNK), strict=True):
        clearance = torch.full(contact.shape, math.nan, device=contact.device)
        clearance[contact] = metrics.sole_clearance(sole_corners(*pose)[contact], trajectories.terrain)
        parts.append(clearance)
    return torch.cat(parts)


def _poses(trajectories: Trajectories, steps: int) -> Iterator[tuple[torch.Tensor, ...]]:
    """Pelvis position and rotation and joint angles, so many steps at a time."""
    poses = (trajectories.root_position, trajectories.root_rotation, trajectories.joint_position)
    return zip(*(each.split(steps) for each in poses), strict=True)
