"""The feedforward controller (paper, Sec. II-A.1): rhythm generator G, pattern network S and the PD law.

Phase convention: at phase 0 the fundamental of right-minus-left hip flexion crosses zero upwards, in every gait, so the
same phase means the same event whether the humanoid walks or runs. One stride is one turn of 2 pi.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn

from aicpg_newton.device import MadeOnce
from aicpg_newton.errors import UserError
from aicpg_newton.places import ASSETS
from aicpg_newton.robot.humanoid import CONTROL_DT, CONTROL_RATE, JOINT_NAMES, NUM_JOINTS
from aicpg_newton.tensor_files import read_tensors, write_tensors

WINDOW = 50
"""Number of phase oscillators, i in Eq. 2; a control step apart."""

DEFAULT_PATTERN = ASSETS / "pattern_network.pt"
"""Weights fitted on CMU clips 35_08 (walk) and 35_17 (run)."""

_FORMAT = 1
_KEYS = {"format", "joint_names", "control_rate", "gaits", "weights"}


def rhythm_window(phase: torch.Tensor, frequency: torch.Tensor) -> torch.Tensor:
    """Fundamental timing signal w of the rhythm generator (Eq. 1-2).

    The oscillators sample the coming 0.83 s at the present frequency: the window holds phase and frequency both, which
    is what lets S tell walking from running.

    Args:
        phase: Phase of the current control step [rad], shape [...].
        frequency: Stride frequency f [Hz], shape [...].

    Returns:
        sin(phase + 2 pi f i dt) for i = 0 ... 49, shape [..., 50].
    """
    steps = torch.arange(WINDOW, dtype=phase.dtype, device=phase.device)
    return torch.sin(phase.unsqueeze(-1) + (2 * math.pi * CONTROL_DT) * frequency.unsqueeze(-1) * steps)


def advance_phase(phase: torch.Tensor, frequency: torch.Tensor) -> torch.Tensor:
    """Phase [rad] after one control step, wrapped to [0, 2 pi), shape [...].

    Phase is accumulated: sin(2 pi f t) with a changing f would jump.
    """
    return torch.remainder(phase + (2 * math.pi * CONTROL_DT) * frequency, 2 * math.pi)


def fourier_basis(phase: torch.Tensor, harmonics: int) -> torch.Tensor:
    """The waves 1, cos p, sin p, cos 2p, sin 2p, ... of a stride, shape [...] to [..., 2 harmonics + 1]."""
    orders = torch.arange(1, harmonics + 1, dtype=phase.dtype, device=phase.device) * phase.unsqueeze(-1)
    waves = torch.stack((torch.cos(orders), torch.sin(orders)), dim=-1).flatten(-2)
    return torch.cat((torch.ones_like(phase).unsqueeze(-1), waves), dim=-1)


def pd_torque(
    target: torch.Tensor,
    target_velocity: torch.Tensor,
    position: torch.Tensor,
    velocity: torch.Tensor,
    *,
    position_gain: torch.Tensor,
    velocity_gain: torch.Tensor,
) -> torch.Tensor:
    """CPG torque tau_g = Kp e + Kd de/dt with e = target - position (Eq. 3-4).

    Args:
        target: Target angles theta_t [rad], shape [..., 28].
        target_velocity: Their rate [rad/s], shape [..., 28].
        position: Joint angles theta [rad], shape [..., 28].
        velocity: Joint velocities [rad/s], shape [..., 28].
        position_gain: Kp [N m/rad], shape [28].
        velocity_gain: Kd [N m s/rad], shape [28].

    Returns:
        Torque [N m], shape [..., 28], before any limit.
    """
    return position_gain * (target - position) + velocity_gain * (target_velocity - velocity)


@dataclass(frozen=True)
class Gait:
    """What is kept of a motion capture clip beside the angles that S reproduces."""

    name: str
    """``walk`` or ``run``."""
    source: str
    """Clip, as ``35_08``."""
    frequency: float
    """Stride frequency [Hz]."""
    speed: float
    """Mean forward speed [m/s], scaled by leg length to the humanoid."""
    root_harmonics: tuple[tuple[float, ...], ...]
    """Pelvis motion over a stride as a Fourier series: rows 1, cos p, sin p, cos 2p, sin 2p, ...; columns x, y, z [m]
    (x: deviation from steady progress; z: height above the floor) and roll, pitch, yaw [rad]."""
    fit_error: float = math.nan
    """RMS of S's angles against the clip's cycle, over a stride and all joints [rad]."""
    worst_fit_error: float = math.nan
    """The same RMS for the joint with the largest one [rad]."""


@MadeOnce
def _table(gaits: tuple[Gait, ...], name: str, device: torch.device, dtype: torch.dtype) -> torch.Tensor:
    """A field of all gaits as a tensor, shape [gaits, ...], made once for a device."""
    return torch.tensor([getattr(gait, name) for gait in gaits], device=device, dtype=dtype)


class PatternNetwork(nn.Module):
    """Pattern formation layer S: an MLP 50-128-128-28 with ReLU from timing signal to target joint angles."""

    def __init__(self, gaits: tuple[Gait, ...] = ()) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(WINDOW, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, NUM_JOINTS)
        )
        self.gaits = gaits

    def forward(self, window: torch.Tensor) -> torch.Tensor:
        """Target joint angles theta_t = S(w) [rad], shape [..., 50] to [..., 28]."""
        return self.layers(window)

    def gait(self, name: str) -> Gait:
        """The gait of that name, ``walk`` or ``run``.

        Raises:
            UserError: The network was fitted on no such gait.
        """
        known = {gait.name: gait for gait in self.gaits}
        if name not in known:
            raise UserError(f"the pattern network has no gait {name!r}; give one of {', '.join(known)}")
        return known[name]

    def target(self, phase: torch.Tensor, frequency: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Target angles now and their rate over the coming control step.

        Args:
            phase: Phase [rad], shape [...].
            frequency: Stride frequency [Hz], shape [...].

        Returns:
            theta_t [rad] and its rate [rad/s], each of shape [..., 28].
        """
        phases = torch.stack((phase, advance_phase(phase, frequency)))
        now, soon = self(rhythm_window(phases, frequency.expand_as(phases))).unbind(0)
        return now, (soon - now) / CONTROL_DT

    def nominal_speed(self, frequency: torch.Tensor) -> torch.Tensor:
        """Forward speed [m/s] that goes with a stride frequency [Hz], shape [...].

        On the line through the gaits' speeds from the slowest on; below, at the slowest one's length of stride, as the
        angles that S gives there swing nearly as far: the line would come to a standstill at 0.64 Hz.
        """
        slowest = self.gaits[0]
        line = self._between_gaits(frequency, _table(self.gaits, "speed", frequency.device, frequency.dtype))
        return torch.where(frequency < slowest.frequency, frequency * (slowest.speed / slowest.frequency), line)

    def root_motion(self, phase: torch.Tensor, frequency: torch.Tensor) -> torch.Tensor:
        """Pelvis motion over a stride at any frequency, from the gaits' Fourier series.

        Args:
            phase: Phase [rad], shape [...].
            frequency: Stride frequency [Hz], shape [...]; outside the gaits' range the nearer gait's series holds.

        Returns:
            x deviation, y, z [m] and roll, pitch, yaw [rad], shape [..., 6].
        """
        frequencies = [gait.frequency for gait in self.gaits]
        inside = frequency.clamp(min(frequencies), max(frequencies))
        series = _table(self.gaits, "root_harmonics", frequency.device, frequency.dtype)
        coefficients = self._between_gaits(inside, series)
        basis = fourier_basis(phase, (series.shape[1] - 1) // 2)
        return (basis.unsqueeze(-1) * coefficients).sum(dim=-2)

    def _between_gaits(self, frequency: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Values at the first and last gait, shape [2, ...], on a straight line over frequency."""
        low, high = self.gaits[0].frequency, self.gaits[-1].frequency
        share = ((frequency - low) / (high - low)).reshape((*frequency.shape, *(1,) * (values.ndim - 1)))
        return values[0] + share * (values[-1] - values[0])

    def content(self) -> dict[str, Any]:
        """Everything needed to rebuild the network, as plain data and tensors; see :meth:`from_content`."""
        return {
            "format": _FORMAT,
            "joint_names": list(JOINT_NAMES),
            "control_rate": CONTROL_RATE,
            "gaits": [asdict(gait) for gait in self.gaits],
            "weights": {name: value.detach().cpu() for name, value in self.state_dict().items()},
        }

    @classmethod
    def from_content(cls, content: Any, source: str) -> PatternNetwork:
        """Rebuild a network from :meth:`content`.

        Args:
            content: What :meth:`content` returned.
            source: Where it comes from, for messages.

        Raises:
            UserError: The content is of another kind or format, for other joints, or holds non-finite weights.
        """
        if not isinstance(content, dict) or content.get("format") != _FORMAT or set(content) != _KEYS:
            raise UserError(f"{source} is not a pattern network of this version; fit one with aicpg_newton.motion")
        names, rate = content["joint_names"], content["control_rate"]
        if not isinstance(names, list) or tuple(names) != JOINT_NAMES or rate != CONTROL_RATE:
            count = len(names) if isinstance(names, list) else "no"
            raise UserError(
                f"{source} was fitted for {count} joints at {rate} Hz that are not this humanoid's {NUM_JOINTS} at"
                f" {CONTROL_RATE} Hz; fit it again with aicpg_newton.motion"
            )
        network = cls(_gaits(content["gaits"], source))
        try:
            network.load_state_dict(content["weights"])
        except (RuntimeError, TypeError, AttributeError) as error:
            raise UserError(
                f"{source} does not hold a {WINDOW}-128-128-{NUM_JOINTS} pattern network; fit it again with"
                " aicpg_newton.motion"
            ) from error
        if not all(bool(torch.isfinite(value).all()) for value in network.state_dict().values()):
            raise UserError(f"{source} holds weights that are not finite; fit it again with aicpg_newton.motion")
        return network.requires_grad_(False).eval()

    def save(self, path: Path) -> None:
        """Write the network and its gaits to a file."""
        write_tensors(self.content(), path)

    @classmethod
    def load(cls, path: Path = DEFAULT_PATTERN) -> PatternNetwork:
        """Read a network written by :meth:`save`.

        Raises:
            UserError: The file is missing, torn or not a pattern network for this humanoid.
        """
        if not path.is_file():
            raise UserError(f"no pattern network at {path}; fit one with python -m aicpg_newton.motion")
        return cls.from_content(read_tensors(path, "a pattern network", "fetch it again"), str(path))


def _gaits(content: Any, source: str) -> tuple[Gait, ...]:
    """The gaits of :meth:`PatternNetwork.content`.

    Raises:
        UserError: They are not a slower and a faster gait of finite numbers.
    """
    try:
        gaits = tuple(Gait(**each) for each in content)
        facts = torch.tensor([[gait.frequency, gait.speed] for gait in gaits], dtype=torch.float64)
        series = torch.tensor([gait.root_harmonics for gait in gaits], dtype=torch.float64)
        named = all(isinstance(gait.name, str) and isinstance(gait.source, str) for gait in gaits)
        rising = len(gaits) >= 2 and bool((facts.diff(dim=0) > 0).all()) and bool((facts > 0).all())
        whole = series.ndim == 3 and series.shape[1] % 2 == 1 and series.shape[2] == 6
        finite = bool(torch.isfinite(facts).all() and torch.isfinite(series).all())
    except (TypeError, ValueError, RuntimeError, OverflowError) as error:
        raise UserError(f"{source} holds no gaits of this version; fit it again with aicpg_newton.motion") from error
    if not (named and rising and whole and finite):
        raise UserError(
            f"{source} holds no slower and faster gait of finite numbers; fit it again with aicpg_newton.motion"
        )
    return gaits
