"""The robot: joint order, gains, torque limits and damping, control rate, and where head, hands and feet are.

Everything else in the package speaks of joints in the order of :data:`JOINT_NAMES` and of links in the order of
:data:`LINK_NAMES`; engines translate from their own layout by name. Geometry, masses and joint ranges stand in
``assets/humanoid.xml``. Frames: x forward, y left, z up; right is -y.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch

from aicpg_newton.errors import UserError
from aicpg_newton.places import ASSETS

MJCF_PATH = ASSETS / "humanoid.xml"

TOTAL_MASS = 48.9
"""Mass of the 13 links [kg] (paper, Sec. II-B)."""

LEG_LENGTH = 0.855
"""Characteristic length of the Froude number [m] (paper, Eq. 11): from the hip to the middle of the foot."""

GRAVITY = 9.81
"""Gravitational acceleration [m/s^2] (paper, Eq. 11-12)."""

BODY_WEIGHT = TOTAL_MASS * GRAVITY
"""Unit of contact forces where they are seen by a network [N]."""

CONTROL_RATE = 60.0
"""Control steps per second [Hz] (paper, Sec. III-B: 60 steps are 1 s)."""

CONTROL_DT = 1.0 / CONTROL_RATE
"""Duration of a control step [s]."""

LINK_NAMES = (
    "pelvis", "torso", "head",
    "right_upper_arm", "right_lower_arm", "left_upper_arm", "left_lower_arm",
    "right_thigh", "right_shin", "right_foot", "left_thigh", "left_shin", "left_foot",
)  # fmt: skip
"""The 13 links; the pelvis is the root."""

FOOT_NAMES = ("right_foot", "left_foot")
"""Order of every per-foot quantity."""

HAND_LINKS = ("right_lower_arm", "left_lower_arm")
"""Links that end in a hand, in the same order."""

HEAD_CENTRE = (0.0, 0.0, 0.175)
"""Centre of the head's sphere in the head link's frame [m]."""

HAND_CENTRE = (0.0, 0.0, -0.259)
"""Centre of the hand's sphere in the lower arm's frame [m]."""

FOOT_LEVER = 0.1
"""From ankle to toe, about [m]; times the body weight, the unit of foot moments where they are seen by a network."""


@dataclass(frozen=True)
class JointGroup:
    """Motor facts shared by a group of joints."""

    position_gain: float
    """Kp [N m/rad] (paper, Sec. II-A: 750 for the torso's three joints, 250 for the rest)."""
    velocity_gain: float
    """Kd [N m s/rad] (paper, Sec. II-A: 1 for all)."""
    torque_limit: float
    """Largest total torque [N m] of CPG and reflex together."""
    gear: float
    """Largest torque of a network's action [N m], and the unit in which it is charged for (R_e, Eq. 6)."""
    damping: float
    """Passive joint damping [N m s/rad]; Kd = 1 alone leaves the joints badly underdamped."""
    armature: float
    """Rotor inertia seen at the joint [kg m^2]."""


# Kp, Kd: the paper. Torque limits: about 2.5 to 4 N m per kg of body mass at abdomen, hip, knee and ankle, as adults
# reach when running; the Isaac Gym humanoid's 125/100/50 were too weak at the ankle to run at 3 m/s in a first trial.
# Gear: the Isaac Gym humanoid's, whose masses, lengths and observations the paper's robot has.
# Damping: stable at 240 Hz in that trial. Armature: the Isaac Gym humanoid's range, .007 to .025.
JOINT_GROUPS = {
    "abdomen": JointGroup(position_gain=750, velocity_gain=1, torque_limit=200, gear=125, damping=8.0, armature=0.025),
    "neck": JointGroup(position_gain=250, velocity_gain=1, torque_limit=50, gear=20, damping=1.5, armature=0.017),
    "shoulder": JointGroup(position_gain=250, velocity_gain=1, torque_limit=70, gear=70, damping=2.0, armature=0.02),
    "elbow": JointGroup(position_gain=250, velocity_gain=1, torque_limit=60, gear=60, damping=1.5, armature=0.015),
    "hip": JointGroup(position_gain=250, velocity_gain=1, torque_limit=200, gear=125, damping=6.0, armature=0.02),
    "knee": JointGroup(position_gain=250, velocity_gain=1, torque_limit=200, gear=100, damping=5.0, armature=0.02),
    "ankle": JointGroup(position_gain=250, velocity_gain=1, torque_limit=120, gear=50, damping=2.0, armature=0.01),
}

TARGET_GAINS = {
    "abdomen": (600.0, 60.0),
    "neck": (50.0, 5.0),
    "shoulder": (200.0, 20.0),
    "elbow": (150.0, 15.0),
    "hip": (300.0, 30.0),
    "knee": (300.0, 30.0),
    "ankle": (200.0, 20.0),
}
"""Kp [N m/rad], Kd [N m s/rad] of drives that follow targets given by a network, as published with AMP for this kind of
humanoid (Isaac Gym examples). With the Kd of :data:`JOINT_GROUPS` a joint rings for longer than a control step, and the
network has to damp it 60 times a second; a CPG's targets come with their rate, a network's do not."""

JOINT_NAMES = (
    "abdomen_x", "abdomen_y", "abdomen_z",
    "neck_x", "neck_y", "neck_z",
    "right_shoulder_x", "right_shoulder_y", "right_shoulder_z", "right_elbow",
    "left_shoulder_x", "left_shoulder_y", "left_shoulder_z", "left_elbow",
    "right_hip_x", "right_hip_y", "right_hip_z", "right_knee",
    "right_ankle_x", "right_ankle_y", "right_ankle_z",
    "left_hip_x", "left_hip_y", "left_hip_z", "left_knee",
    "left_ankle_x", "left_ankle_y", "left_ankle_z",
)  # fmt: skip
"""The 28 hinge joints, in the one order the package uses. The axes of one link are intrinsic x-y-z."""

NUM_JOINTS = len(JOINT_NAMES)


SPINE_JOINTS = tuple(f"{part}_{axis}" for part in ("abdomen", "neck") for axis in "xyz")
"""Those of the trunk, from pelvis to head."""


def joint_index(name: str) -> int:
    """Index of a joint in :data:`JOINT_NAMES`."""
    return JOINT_NAMES.index(name)


def joint_group(name: str) -> str:
    """Group of a joint: ``left_ankle_x`` belongs to ``ankle``."""
    return next(group for group in JOINT_GROUPS if group in name)


@dataclass(frozen=True)
class Motors:
    """Motor facts per joint, shape [28] each, in the order of :data:`JOINT_NAMES`; units as in :class:`JointGroup`."""

    position_gain: torch.Tensor
    velocity_gain: torch.Tensor
    torque_limit: torch.Tensor
    gear: torch.Tensor
    damping: torch.Tensor
    armature: torch.Tensor

    def __post_init__(self) -> None:
        """Refuse what would blow up in the solver without a word.

        Raises:
            UserError: A tensor is not of shape [28], not finite, negative, or (gain, limit, gear) zero.
        """
        for field in fields(self):
            values = getattr(self, field.name)
            if values.shape != (NUM_JOINTS,):
                raise UserError(
                    f"{field.name} has shape {tuple(values.shape)}; the humanoid needs one value for each of its"
                    f" {NUM_JOINTS} joints"
                )
            positive = field.name in ("position_gain", "torque_limit", "gear")
            bad = ~torch.isfinite(values) | (values < 0) | (positive & (values == 0))
            if bad.any():
                joint = JOINT_NAMES[int(bad.nonzero()[0])]
                raise UserError(
                    f"{field.name} of joint {joint} is {values[joint_index(joint)].item()};"
                    f" give a finite {'positive' if positive else 'non-negative'} number"
                )

    def to(self, device: torch.device | str) -> Motors:
        """The same motors on another device."""
        return Motors(**{field.name: getattr(self, field.name).to(device) for field in fields(self)})


def motors(groups: dict[str, JointGroup] | None = None) -> Motors:
    """Motor facts per joint, from a table of joint groups (default: :data:`JOINT_GROUPS`)."""
    table = JOINT_GROUPS if groups is None else groups
    rows = [table[joint_group(name)] for name in JOINT_NAMES]
    return Motors(
        **{field.name: torch.tensor([float(getattr(row, field.name)) for row in rows]) for field in fields(JointGroup)}
    )


def target_motors() -> Motors:
    """Motors of a method that gives target angles alone: see :data:`TARGET_GAINS`."""
    table = {
        name: replace(group, position_gain=TARGET_GAINS[name][0], velocity_gain=TARGET_GAINS[name][1])
        for name, group in JOINT_GROUPS.items()
    }
    return motors(table)


def torque_motors() -> Motors:
    """The same motors as sources of torque: nearly no position gain, no velocity gain.

    Engines give a torque by shifting the position target by torque / Kp, so Kp must not be zero; 0.01 N m/rad adds less
    than 0.03 N m over any joint's range.
    """
    table = {name: replace(group, position_gain=0.01, velocity_gain=0.0) for name, group in JOINT_GROUPS.items()}
    return motors(table)
