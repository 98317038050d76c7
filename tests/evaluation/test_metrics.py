"""Measures against values worked out by hand, and against the imitated gaits, whose clips are known."""

import math

import pytest
import torch

from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.evaluation import metrics
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.playing.rollout import Tally, kinematic_frames
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import JOINT_NAMES, MJCF_PATH, joint_index
from aicpg_newton.robot.kinematics import centre_of_mass, sole_corners, sole_heights
from aicpg_newton.robot.mirror import JOINTS


def everything(time: int, num_envs: int = 1) -> torch.Tensor:
    """All steps count."""
    return torch.ones(time, num_envs, dtype=torch.bool)


def steps(right: str, left: str) -> torch.Tensor:
    """Contacts of one environment, shape [time, 1, 2], from ``#`` on the ground and ``.`` off it."""
    return torch.tensor([[a == "#", b == "#"] for a, b in zip(right, left, strict=True)]).unsqueeze(1)


def landings(contact: torch.Tensor, period: float) -> list[int]:
    """Steps at which the right foot of the only environment lands."""
    return metrics.touch_downs(contact, torch.tensor([period]))[:, 0, 0].nonzero().squeeze(1).tolist()


def share(contact: torch.Tensor) -> torch.Tensor:
    """Contacts as shares of steps: each step is wholly on or off the ground."""
    return contact.float()


def flight(contact: torch.Tensor) -> torch.Tensor:
    """Share of each step in flight, in the same way."""
    return (~contact.any(dim=2)).float()


def test_cost_of_transport():
    """100 then 200 W at 1 then 2 m/s: 300 / (48.9 x 9.81 x 3) = 0.20846; a fallen step with NaN does not count."""
    power, speed = torch.tensor([[100.0], [200.0], [math.nan]]), torch.tensor([[1.0], [2.0], [math.nan]])
    valid = torch.tensor([[True], [True], [False]])
    assert metrics.cost_of_transport(power, speed, valid).item() == pytest.approx(0.208459, abs=1e-5)


@pytest.mark.parametrize("speed", [0.0, 0.05, -1.0])
def test_cost_of_transport_needs_forward_motion(speed: float):
    """Standing still and walking backwards have none."""
    cost = metrics.cost_of_transport(torch.ones(4, 1), torch.full((4, 1), speed), everything(4))
    assert torch.isnan(cost).all()


def test_balance_index():
    """Upright, then tilted by 60 degrees about x: (1 + 0.5) / 2; a turn about the vertical changes nothing."""
    tilt = rotations.about_axis(torch.tensor([1.0, 0.0, 0.0]), torch.tensor(math.pi / 3))
    turn = rotations.about_z(torch.tensor(2.0))
    rotation = torch.stack((turn, rotations.multiply(turn, tilt))).unsqueeze(1)
    assert metrics.balance_index(rotation, everything(2)).item() == pytest.approx(0.75, abs=1e-6)


def test_symmetry_index_by_hand():
    """Right elbow 0.3, left 0.1 in both steps: |0.2| / 0.2 = 1 for one pair; the others are still and equal: 0."""
    angles = torch.zeros(4, 1, 28)
    angles[..., joint_index("right_elbow")] = 0.3
    angles[..., joint_index("left_elbow")] = 0.1
    pairs = sum(name.startswith("right_") for name in JOINT_NAMES)
    value = metrics.symmetry_index(angles, everything(4), torch.zeros(1))
    assert value.item() == pytest.approx(1.0 / pairs, abs=1e-6)


def test_symmetry_index_sums_over_time_and_averages_over_joints():
    """A joint pair with (0.4, 0) then (0, 0): 0.4 / 0.2 = 2; another with (0.1, 0.3) twice: 1; the rest 0."""
    angles = torch.zeros(3, 1, 28)
    angles[0, 0, joint_index("right_knee")] = 0.4
    angles[:, 0, joint_index("right_hip_y")] = 0.1
    angles[:, 0, joint_index("left_hip_y")] = 0.3
    # The last step has no successor to interpolate with and is left out: two steps count.
    value = metrics.symmetry_index(angles, everything(3), torch.zeros(1))
    pairs = sum(name.startswith("right_") for name in JOINT_NAMES)
    assert value.item() == pytest.approx((2.0 + 1.0) / pairs, abs=1e-6)


def test_symmetry_index_of_a_mirrored_pose_is_zero():
    """Hips spread to both sides (opposite signs of x) are symmetric; both turned to one side are not."""
    angles = 0.5 * torch.randn(1, 1, 28, generator=torch.Generator().manual_seed(0))
    spread = (0.5 * (angles + JOINTS(angles))).expand(4, 1, 28)
    assert metrics.symmetry_index(spread, everything(4), torch.zeros(1)).item() == pytest.approx(0.0, abs=1e-6)
    slanted = spread.clone()
    slanted[..., joint_index("left_hip_x")] *= -1.0
    assert metrics.symmetry_index(slanted, everything(4), torch.zeros(1)).item() > 0.1


def test_symmetry_index_does_not_care_which_side_leads():
    """A mirrored gait is as symmetric as the gait itself; so is one with all angles doubled."""
    angles = torch.randn(200, 1, 28, generator=torch.Generator().manual_seed(1))
    lag = torch.zeros(1)
    value = metrics.symmetry_index(angles, everything(200), lag)
    torch.testing.assert_close(metrics.symmetry_index(JOINTS(angles), everything(200), lag), value)
    torch.testing.assert_close(metrics.symmetry_index(2.0 * angles, everything(200), lag), value)
    assert 0.0 < value.item() <= 2.0


def test_symmetry_index_tells_degrees_from_radians():
    """The least denominator is a degree: angles of 0.005 and 0 rad give 0.005 / 0.01745, in degrees they give 2."""
    angles = torch.zeros(3, 1, 28)
    angles[..., joint_index("right_elbow")] = 0.005
    pairs = sum(name.startswith("right_") for name in JOINT_NAMES)
    small = metrics.symmetry_index(angles, everything(3), torch.zeros(1)).item() * pairs
    large = metrics.symmetry_index(angles.rad2deg(), everything(3), torch.zeros(1)).item() * pairs
    assert small == pytest.approx(0.005 / math.radians(1.0), rel=1e-4)
    assert large == pytest.approx(0.005 * 180 / math.pi / (0.5 * 0.005 * 180 / math.pi), rel=1e-4)


def test_a_walk_is_symmetric_half_a_stride_apart(pattern: PatternNetwork):
    """The imitated walk scores near 0 with half a stride of lag and badly at the same instant; a limp is found."""
    frequency = torch.tensor([pattern.gaits[0].frequency])
    frames = kinematic_frames(pattern, frequency, 300, Tally(frequency))
    angles = torch.stack([frame.joint_position for frame in frames])
    half = 30.0 / frequency
    assert metrics.symmetry_index(angles, everything(300), half).item() < 0.03
    assert metrics.symmetry_index(angles, everything(300), torch.zeros(1)).item() > 0.5
    limp = angles.clone()
    limp[..., joint_index("left_knee")] *= 0.5
    assert metrics.symmetry_index(limp, everything(300), half).item() > 0.05
    assert torch.isnan(metrics.symmetry_index(angles, everything(300), torch.tensor([math.nan]))).all()


def test_touch_downs_skip_bounces_and_scuffs():
    """A stance is filled in over bounces of three steps and shorter; contacts shorter than six steps are scuffs."""
    track = steps("##.......##...####....#####..########......#.##....######", "." * 57)
    assert landings(track, math.nan) == [9, 22, 51]
    scuffs = steps("##" + (".......##########....+.+++..........").replace("+", "#") * 3 + "######", "." * 116)
    assert landings(scuffs, math.nan) == [9, 45, 81, 110]


def test_a_foot_that_has_just_landed_does_not_land_again():
    """A toe that drags in every swing, long enough for a stance, makes one stride of 36 steps and not two."""
    dragged = steps("##" + (".......##########.....++.++++..++...").replace("+", "#") * 3, "." * 110)
    assert landings(dragged, math.nan) == [9, 24, 45, 60, 81, 96]
    assert landings(dragged, 36.0) == [9, 45, 81]
    both = torch.cat((dragged, dragged.flip(2)), dim=1)
    assert metrics.touch_downs(both, torch.tensor([36.0, math.nan])).sum(dim=0).tolist() == [[3, 0], [0, 6]]


def gait(period: float, time: int = 400, **shares: float) -> torch.Tensor:
    """Joint angles of one walker with two bends of the knee in a stride, shape [time, 1, 28]."""
    angles = torch.zeros(time, 1, 28)
    for side, shift in (("right", 0.0), ("left", math.pi)):
        phase = 2 * math.pi * torch.arange(float(time)) / period + shift
        angles[:, 0, joint_index(f"{side}_hip_y")] = -0.2 + 0.4 * torch.sin(phase) * shares.get(side, 1.0)
        knee = 0.6 + 0.4 * torch.sin(phase + 1.0) + 0.2 * torch.sin(2 * phase)
        angles[:, 0, joint_index(f"{side}_knee")] = knee * shares.get(side, 1.0)
    return angles


@pytest.mark.parametrize("period", [14.3, 44.0, 66.7, 85.2, 110.0])
def test_stride_period(period: float):
    """Found within half a percent, also in noise, with a limp, and with both legs together."""
    noise = 0.05 * torch.randn(400, 1, 28, generator=torch.Generator().manual_seed(0))
    walks = [gait(period), gait(period) + noise, gait(period, left=0.6), gait(period, left=0.0)]
    for angles in walks:
        assert metrics.stride_period(angles, everything(400)).item() == pytest.approx(period, rel=0.005)


def test_stride_period_needs_a_rhythm_and_a_stride_and_a_half():
    """Standing still and noise have none; of a short stretch nothing is said; other steps are not looked at."""
    noise = torch.randn(400, 1, 28, generator=torch.Generator().manual_seed(0))
    for angles in (torch.zeros(400, 1, 28), torch.full((400, 1, 28), 0.3), noise):
        assert metrics.stride_period(angles, everything(400)).isnan().all()
    stretch = torch.zeros(400, 1, dtype=torch.bool)
    stretch[100:180] = True
    angles = torch.where(stretch.unsqueeze(2), gait(66.7), math.nan)
    assert metrics.stride_period(angles, stretch).isnan().all()
    stretch[180:220] = True
    angles = torch.where(stretch.unsqueeze(2), gait(66.7), math.nan)
    assert metrics.stride_period(angles, stretch).item() == pytest.approx(66.7, rel=0.01)
    assert metrics.stride_period(gait(66.7, time=40), everything(40)).isnan().all()


def test_strides_by_hand():
    """Strides of 20 steps, on the ground for 12 of 20; in the run 4 of 20 steps are flight."""
    period = torch.tensor([20.0])
    walk = steps(".......##" + ("#" * 10 + "." * 8 + "##") * 2 + "####", "#" * 53)
    assert metrics.whole_strides(walk[..., 0], everything(53), period)[1].tolist() == [2]
    both = steps(
        ".......##" + ("#" * 10 + "." * 8 + "##") * 3,
        "#" * 7 + "..........##" + ("#" * 10 + "." * 8 + "##") * 2 + "#" * 10,
    )
    assert metrics.duty_factor(share(both), both, everything(69), period).item() == pytest.approx(0.6)
    assert metrics.flight_ratio(flight(both), both, everything(69), period).item() == 0.0
    right = "." * 7 + ("#" * 8 + "." * 12) * 3 + "####"
    left = "." * 7 + ("." * 10 + "#" * 8 + "..") * 3 + "...."
    run = steps(right, left)
    assert metrics.flight_ratio(flight(run), run, everything(71), period).item() == pytest.approx(4 / 20)
    assert metrics.flight_share_of_strides(flight(run), run, everything(71), period).item() == 1.0
    assert metrics.duty_factor(share(run), run, everything(71), period).item() == pytest.approx(0.4)


def test_parts_of_steps_count():
    """A foot that lands in the middle of a step: flight and stance by the share, strides as before."""
    right = "." * 7 + ("#" * 8 + "." * 12) * 3 + "####"
    left = "." * 7 + ("." * 10 + "#" * 8 + "..") * 3 + "...."
    run, period, valid = steps(right, left), torch.tensor([20.0]), everything(71)
    flying, support = flight(run), share(run)
    for landing in range(7, 60, 20):  # of the right foot: half of the step before it, too
        flying[landing - 1], support[landing - 1, 0, 0] = 0.5, 0.5
    assert metrics.flight_ratio(flying, run, valid, period).item() == pytest.approx(3.5 / 20)
    assert metrics.duty_factor(support, run, valid, period).item() == pytest.approx((8.5 + 8) / 2 / 20)
    assert metrics.flight_share_of_strides(flying, run, valid, period).item() == 1.0
    assert metrics.flight_share_of_strides(0.5 * flying, run, valid, period).item() == 0.0


def test_flight_needs_both_feet_and_its_own_strides():
    """Hopping on the right foot alone: flight while it is up; the left foot's track makes no cycle."""
    hop = steps("." * 7 + ("#" * 10 + "." * 10) * 3 + "###", "." * 70)
    period = torch.tensor([20.0])
    assert metrics.flight_ratio(flight(hop), hop, everything(70), period).item() == pytest.approx(0.5)
    assert torch.isnan(metrics.flight_ratio(flight(hop), hop.flip(2), everything(70), period)).all()
    assert torch.isnan(metrics.duty_factor(share(hop), hop, everything(70), period)).all()


def test_moving_mean_is_centred_and_needs_a_full_window():
    """Of 0, 1, 2, 3, 4 with windows of 2: step t is the mean of t - 1 and t; an invalid step empties its windows."""
    values, valid = torch.arange(5.0).unsqueeze(1), everything(5)
    valid[3] = False
    values[3] = math.nan
    assert metrics.moving_mean(values, everything(5) & valid, 2)[:3, 0].tolist()[1:] == [0.5, 1.5]
    assert torch.isnan(metrics.moving_mean(values, valid, 2)[[0, 3, 4], 0]).all()


def test_falls_per_minute():
    """Two falls in 10 s are 12 a minute."""
    fallen = torch.zeros(600, 2, dtype=torch.bool)
    fallen[[100, 300], 1] = True
    assert metrics.falls_per_minute(fallen).tolist() == [0.0, 12.0]


def test_centre_of_mass_by_hand():
    """Standing straight, the masses of the MJCF times their heights; MuJoCo agrees in a random pose."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(MJCF_PATH))
    data = mujoco.MjData(model)
    angles = 0.4 * torch.randn(28, generator=torch.Generator().manual_seed(2))
    rotation = rotations.from_roll_pitch_yaw(torch.tensor(0.2), torch.tensor(-0.3), torch.tensor(1.0))
    data.qpos[:3] = (1.0, 2.0, 3.0)
    data.qpos[3:7] = rotation[[3, 0, 1, 2]].numpy()
    for index, name in enumerate(JOINT_NAMES):
        data.joint(name).qpos = float(angles[index])
    mujoco.mj_forward(model, data)
    found = centre_of_mass(torch.tensor([1.0, 2.0, 3.0]), rotation, angles)
    torch.testing.assert_close(found, torch.tensor(data.subtree_com[1]).float(), rtol=0.0, atol=1e-5)


def foot(x: float, z: float) -> torch.Tensor:
    """Corners of a level sole of the humanoid's size, its middle at x and height z; shape [4, 3]."""
    return torch.tensor([[x + i * 0.0885, j * 0.045, z] for i in (-1, 1) for j in (-1, 1)])


def test_sole_clearance_sees_a_ridge_under_the_middle_of_the_foot():
    """A ridge 30 mm high and 0.2 m wide under a sole at 20 mm: 10 mm deep, though all corners are in the air."""
    heights = torch.zeros(101, 41)
    heights[50] = 0.03
    terrain = Terrain(Ground(height_range=0.03, cell=0.1, feature=0.1, length=10.0, width=4.0), heights)
    corners = foot(5.0, 0.02)
    assert (terrain.height(corners) < corners[:, 2] - 0.01).all()
    assert metrics.sole_clearance(corners, terrain).item() == pytest.approx(-0.01, abs=1e-5)
    # Wherever on the sole the ridge comes up, it is missed by half the grid's spacing on its slope of 0.3 at most.
    for x in torch.linspace(4.92, 5.08, 33).tolist():
        assert -0.0101 <= metrics.sole_clearance(foot(x, 0.02), terrain).item() <= -0.01 + 0.3 * 0.0074 + 1e-4
    beside = torch.stack((foot(4.0, 0.02), foot(6.0, -0.004)))
    assert metrics.sole_clearance(beside, terrain).tolist() == pytest.approx([0.02, -0.004], abs=1e-6)


def test_sole_clearance_on_a_plane_is_the_height_of_the_lowest_corner(pattern: PatternNetwork):
    """For tilted feet, as kinematics has it."""
    frequency = torch.full((5,), pattern.gaits[0].frequency)
    frame = list(kinematic_frames(pattern, frequency, 20, Tally(frequency)))[-1]
    pose = frame.root_position, frame.root_rotation, frame.joint_position
    found = metrics.sole_clearance(sole_corners(*pose), None)
    torch.testing.assert_close(found, sole_heights(*pose), atol=1e-6, rtol=0.0)


def test_sole_penetration_by_hand():
    """Steps in contact count: 10 mm deep, 4 mm above and 0 in one environment, none in the other."""
    clearance = torch.tensor([[-0.01, math.nan], [math.nan, 0.004], [0.0, -1.0]]).unsqueeze(1).repeat(1, 2, 1)
    contact = torch.tensor([[True, False], [False, True], [True, False]]).unsqueeze(1).repeat(1, 2, 1)
    valid = everything(3, 2)
    valid[:, 1] = False
    depth, hover = metrics.sole_penetration(clearance, contact, valid)
    assert depth[0].item() == pytest.approx(0.01 / 3) and hover[0].item() == pytest.approx(0.004 / 3)
    assert torch.isnan(depth[1]) and torch.isnan(hover[1])


PERIOD = torch.full((7,), 38.0)

MEASURES = {
    "stride_period": lambda _, angles, valid: metrics.stride_period(angles, valid),
    "duty_factor": lambda contact, _, valid: metrics.duty_factor(
        share(contact), contact, valid, PERIOD[: valid.shape[1]]
    ),
    "flight_ratio": lambda contact, _, valid: metrics.flight_ratio(
        flight(contact), contact, valid, PERIOD[: valid.shape[1]]
    ),
    "flight_share": lambda contact, _, valid: metrics.flight_share_of_strides(
        flight(contact), contact, valid, PERIOD[: valid.shape[1]]
    ),
    "symmetry": lambda _, angles, valid: metrics.symmetry_index(angles, valid, torch.full((valid.shape[1],), 7.3)),
    "mean": lambda _, angles, valid: metrics.masked_mean(angles[..., 0], valid),
}


@pytest.mark.parametrize("name", MEASURES)
def test_measures_do_not_depend_on_the_number_of_environments(name: str):
    """Each environment alone gives what it gives among six others."""
    generator = torch.Generator().manual_seed(3)
    noise = torch.randn(400, 7, 2, generator=generator)
    swing = torch.sin(torch.arange(400.0)[:, None, None] / 6 + torch.arange(7.0)[:, None] + torch.tensor([0.0, 3.0]))
    contact = swing + 0.02 * noise > 0.2
    angles = torch.randn(400, 7, 28, generator=generator) + 10.0 * gait(38.0)
    valid = torch.arange(400)[:, None].expand(400, 7) < torch.tensor([400, 300, 250, 200, 150, 100, 0])
    together = MEASURES[name](contact, angles, valid)
    alone = [MEASURES[name](contact[:, [env]], angles[:, [env]], valid[:, [env]]) for env in range(7)]
    torch.testing.assert_close(together, torch.cat(alone), equal_nan=True)
    assert torch.isnan(together[6]) and torch.isfinite(together[0])


@pytest.mark.parametrize("index", [0, 1])
def test_imitated_gaits_played_back(pattern: PatternNetwork, index: int):
    """The walk 35_08 has no flight and stands for over half a stride, the run 35_17 flies in every stride.

    The shipped pattern network holds both clips, so nothing needs to be downloaded. Stride frequencies as measured on
    the clips (harmonic fit of hips and knees).
    """
    gait = pattern.gaits[index]
    frequency = torch.full((2,), gait.frequency)
    frames = list(kinematic_frames(pattern, frequency, 600, Tally(frequency)))
    heights = torch.stack(
        [sole_heights(frame.root_position, frame.root_rotation, frame.joint_position) for frame in frames]
    )
    contact = heights < 0.02  # the clip's soles are not quite flat on the floor [m]
    valid = everything(600, 2)
    measured = {"35_08": 0.903, "35_17": 1.327}[gait.source]
    period = metrics.stride_period(torch.stack([frame.joint_position for frame in frames]), valid)
    flying = metrics.flight_ratio(flight(contact), contact, valid, period)
    duty = metrics.duty_factor(share(contact), contact, valid, period)
    assert (60 / period).tolist() == pytest.approx([measured] * 2, rel=0.003)
    if gait.name == "walk":
        assert flying.tolist() == [0.0, 0.0]
        assert (duty > 0.5).all() and (duty < 0.75).all()
    else:
        assert (metrics.flight_share_of_strides(flight(contact), contact, valid, period) == 1.0).all()
        assert (flying > 0.1).all() and (duty < 0.5).all()
