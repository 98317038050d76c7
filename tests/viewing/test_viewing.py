"""The stage, recordings and filmstrips, on CPU without a display."""

import math
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
import torch
from PIL import Image

from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.errors import UserError
from aicpg_newton.robot import rotations
from aicpg_newton.robot.humanoid import NUM_JOINTS, joint_index
from aicpg_newton.robot.kinematics import sole_corners
from aicpg_newton.viewing.camera import Photographer, Studio, facing, parallel_rays
from aicpg_newton.viewing.filmstrip import LABEL_WIDTH, TILE_HEIGHT, TILE_WIDTH, FilmstripRow, save_filmstrip
from aicpg_newton.viewing.stage import LANE_WIDTH, Floor, Stage, Tracker
from aicpg_newton.viewing.video import VideoWriter

STANDING = 0.8815
"""Height of the pelvis frame when all joint angles are zero [m]."""


def pose(robots=1, x=0.0, **angles):
    """Root position, root rotation and joint angles of robots that stand at x, with the named joint angles [rad]."""
    position = torch.tensor([[x, 0.0, STANDING]]).repeat(robots, 1)
    rotation = torch.tensor([[0.0, 0.0, 0.0, 1.0]]).repeat(robots, 1)
    joints = torch.zeros(robots, NUM_JOINTS)
    for name, angle in angles.items():
        joints[:, joint_index(name)] = angle
    return position, rotation, joints


def terrain_of(height_range=1.0, feature=3.0, **sizes) -> Terrain:
    """A small terrain; as a rule one of gentle hills."""
    sizes = {"length": 24.0, "width": 16.0, "seed": 3, **sizes}
    terrain = Terrain.make(Ground(height_range=height_range, feature=feature, **sizes))
    assert terrain is not None
    return terrain


def on(terrain: Terrain, robot_pose, x: float | torch.Tensor = 12.0, y: float = 0.0):
    """A pose moved to a place on a terrain, its lowest sole on the surface."""
    position, rotation, joints = robot_pose
    position = position.clone()
    position[:, 0], position[:, 1] = x, y
    soles = sole_corners(position, rotation, joints).flatten(1, 2)
    position[:, 2] += (terrain.height(soles) - soles[..., 2]).amax(dim=1)
    return position, rotation, joints


def frames_of(path: Path) -> tuple[dict, np.ndarray]:
    """Metadata and frames of a video, shape [frames, height, width, 3]."""
    reader = imageio_ffmpeg.read_frames(str(path))
    facts = next(reader)
    assert isinstance(facts, dict)
    width, height = facts["size"]
    return facts, np.stack([np.frombuffer(frame, dtype=np.uint8).reshape(height, width, 3) for frame in reader])


def right_pixels(picture: np.ndarray) -> np.ndarray:
    """Pixels of right limbs, which are red."""
    colour = picture.astype(int)
    return (colour[..., 0] > 1.6 * colour[..., 1]) & (colour[..., 0] > 1.6 * colour[..., 2])


def left_pixels(picture: np.ndarray) -> np.ndarray:
    """Pixels of left limbs, which are blue."""
    colour = picture.astype(int)
    return (colour[..., 2] > 1.3 * colour[..., 1]) & (colour[..., 2] > 1.6 * colour[..., 0])


def columns(pixels: np.ndarray) -> np.ndarray:
    """Picture columns of pixels, shape [number]; there must be enough of them to be a limb."""
    found = np.nonzero(pixels)[1]
    assert len(found) > 20
    return found


def studio_picture(robot_pose, *, terrain=None, whole=False, width=320, height=180, away=4.5):
    """A picture of one pose from the robot's right side, slightly from the front and above."""
    stage = Stage(len(robot_pose[0]), terrain=terrain, device="cpu")
    stage.pose(*robot_pose)
    rotation = facing(math.radians(22), math.radians(11))
    studio = Studio(stage, width, height, math.radians(30), rotation)
    position = stage.pelvis.mean(dim=0) + away * rotations.rotate(rotation, torch.tensor([0.0, 0.0, 1.0]))
    return studio.photograph(position, whole=whole)


def test_recording_can_be_played(tmp_path):
    """60 control steps become 30 frames of one second at 30 Hz, in the size asked for, and no other file is left."""
    path = tmp_path / "walk.mp4"
    with VideoWriter(path, width=320, height=180) as video:
        for step in range(60):
            video.add(*pose(x=step / 60))
        assert not path.exists()
    facts, frames = frames_of(path)
    assert facts["size"] == (320, 180) and facts["fps"] == 30.0 and facts["codec"] == "h264"
    assert facts["pix_fmt"].startswith("yuv420p")
    assert len(frames) == 30
    assert [file.name for file in tmp_path.iterdir()] == ["walk.mp4"]


def test_camera_follows_the_robot_over_the_floor(tmp_path):
    """A robot at 3 m/s stays in the middle of the picture while the floor moves on."""
    path = tmp_path / "run.mp4"
    with VideoWriter(path, width=320, height=180) as video:
        for step in range(90):
            video.add(*pose(x=3.0 * step / 60))
    _, frames = frames_of(path)
    for frame in frames:
        robot = right_pixels(frame) | left_pixels(frame)
        assert abs(columns(robot).mean() - 160) < 32
        rows = np.nonzero(robot)[0]
        assert rows.min() > 20 and rows.max() < 175
    floor = frames[:, 150:, :80].astype(int)
    assert np.abs(floor[-1] - floor[-4]).max() > 20


def test_reset_cuts_instead_of_panning(tmp_path):
    """A robot that is put back to the start is in the middle of the very next frame."""
    path = tmp_path / "reset.mp4"
    with VideoWriter(path, width=320, height=180) as video:
        for step in range(20):
            video.add(*pose(x=20.0 if step < 10 else 0.0))
    _, frames = frames_of(path)
    for frame in frames:
        assert abs(columns(right_pixels(frame)).mean() - 160) < 32


def test_whole_robot_is_large_in_the_picture(tmp_path):
    """Head and feet are inside the picture, and the robot fills more than half of its height."""
    path = tmp_path / "stand.mp4"
    with VideoWriter(path, width=320, height=180) as video:
        video.add(*pose())
    _, frames = frames_of(path)
    changed = np.abs(frames[0].astype(int) - frames[0][:, :1].astype(int)).max(axis=2)[:, 140:180] > 25
    above_floor = np.nonzero(changed[:60])[0]
    feet = np.nonzero(right_pixels(frames[0]))[0].max()
    assert 5 < above_floor.min() < 45
    assert 130 < feet < 172


def test_only_part_of_the_picture_needs_ray_tracing():
    """Tracing only around the robots and their shadows gives the very picture that tracing everything gives."""
    for angles in ({}, {"right_hip_y": -1.5, "left_shoulder_x": 1.5, "right_shoulder_x": -1.5}, {"left_hip_x": 0.9}):
        for robots, away in ((1, 4.5), (2, 7.0), (1, 1.0)):
            robot_pose = pose(robots, x=7.3, **angles)
            robot_pose[0][0, 2] += 0.7
            part = studio_picture(robot_pose, away=away)
            assert np.array_equal(part, studio_picture(robot_pose, away=away, whole=True))
            assert part.std() > 5


def test_floor_cells_are_one_metre():
    """The floor looks the same two metres on, and its colours are exchanged one metre on."""
    here, one, two = (studio_picture(pose(x=x))[100:, :40].astype(int) for x in (0.0, 1.0, 2.0))
    assert np.abs(here - two).max() <= 2
    contrast = here.max() - here.min()
    assert contrast > 25
    assert np.abs(here - one).max() > 0.9 * contrast


def test_forward_is_right_and_limbs_have_their_colours():
    """A right leg swung forward is right of the left one, in red, and the other way round in blue."""
    right_forward = studio_picture(pose(right_hip_y=-0.7, left_hip_y=0.5))[100:]
    assert columns(right_pixels(right_forward)).max() > columns(left_pixels(right_forward)).max() + 15
    left_forward = studio_picture(pose(right_hip_y=0.5, left_hip_y=-0.7))[100:]
    assert columns(left_pixels(left_forward)).max() > columns(right_pixels(left_forward)).max() + 15


def test_shadow_lies_on_the_floor():
    """Grey pixels beside a standing robot's feet are darker than any cell of the floor elsewhere."""
    floor = studio_picture(pose())[130:].astype(int)
    grey = floor.max(axis=2) - floor.min(axis=2) < 15
    darkest_cell = floor[:, :40].min()
    assert 40 < (grey & (floor.max(axis=2) < 0.9 * darkest_cell)).sum() < 2000


def test_pose_that_is_not_finite_holds_the_last_one():
    """A robot whose simulation blew up keeps its last finite pose; its neighbour moves on."""
    stage = Stage(2, device="cpu")
    stage.pose(*pose(2, x=1.0))
    for bad in (math.nan, math.inf, 1.0e30):
        position, rotation, joints = pose(2, x=2.0)
        position[0, 1] = bad
        stage.pose(position, rotation, joints)
        assert stage.pelvis[:, 0].tolist() == [1.0, 2.0]
    position, rotation, joints = pose(2, x=3.0)
    rotation[0], joints[1, 5] = 0.0, math.nan
    stage.pose(position, rotation, joints)
    assert stage.pelvis[:, 0].tolist() == [1.0, 2.0]
    assert bool(torch.isfinite(stage.links).all())


def test_recording_survives_a_blow_up(tmp_path):
    """Not-finite poses from the first step on leave a recording with the robot in it."""
    path = tmp_path / "nan.mp4"
    with VideoWriter(path, width=320, height=180) as video:
        for _ in range(4):
            position, rotation, joints = pose()
            video.add(position * math.nan, rotation, joints * math.nan)
    _, frames = frames_of(path)
    assert len(frames) == 2
    assert abs(columns(right_pixels(frames[1])).mean() - 160) < 32


def test_robots_stand_in_lanes():
    """Robots that share one position are drawn a lane apart, robot 0 at the left."""
    stage = Stage(3, device="cpu")
    stage.pose(*pose(5))
    assert stage.pelvis[:, 1].tolist() == pytest.approx([LANE_WIDTH, 0.0, -LANE_WIDTH])


def test_treadmill_keeps_robots_in_place():
    """Robot 0 at 3 m/s stays near the origin, a faster one within 3 m of it, and the lines slide back below them."""
    stage = Stage(2, floor=Floor.TREADMILL, device="cpu")
    slides = []
    for step in range(240):
        position, rotation, joints = pose(2, x=3.0 * step / 60)
        position[1, 0] *= 1.7
        stage.pose(position, rotation, joints)
        assert stage.state.body_q is not None
        slides.append(float(stage.state.body_q.numpy()[-1, 0]))
        assert abs(float(stage.links[0, 0, 0])) < 1.0
        assert abs(float(stage.links[1, 0, 0])) < 3.1
    assert abs(float(stage.links[0, 0, 0])) < 0.1
    assert min(slides) < -0.9 and max(slides) <= 0.0
    steps = np.diff(slides[-40:])
    assert np.median(steps) == pytest.approx(-3.0 / 60, rel=0.05)


@pytest.mark.parametrize("floor", [Floor.FIXED, Floor.TREADMILL])
def test_drawn_ground_is_the_terrain(floor):
    """Seen from above, every pixel of the ground is as far below robot 0 as the terrain says, sliding or not."""
    terrain = terrain_of(feature=0.5)
    stage = Stage(2, floor=floor, terrain=terrain, device="cpu")
    for x in (5.0, 5.6, 6.13):
        position, rotation, joints = pose(2, x=x)
        position[:, 1] = torch.tensor([1.3, -2.0])
        stage.pose(position, rotation, joints)
    shown = stage.links[0, 0]  # robot 0's pelvis
    rays = parallel_rays(60, 40, 0.1, 20.0, 0.0, "cpu")[:, :, :1]
    shot = Photographer(stage).shoot(rays, shown + torch.tensor([0.0, 0.0, 5.0]), torch.tensor([0.0, 0.0, 0.0, 1.0]))
    ground = shot.shapes == stage.shape_names.index("ground")
    across, along = np.meshgrid((np.arange(60) - 29.5) * 0.1, (19.5 - np.arange(40)) * 0.1)
    there = position[0, :2] + torch.from_numpy(np.stack((across, along), axis=-1))
    below = float(position[0, 2]) - terrain.height(there).numpy()
    assert ground.sum() > 2000
    assert np.abs(shot.depth - 5.0 - below)[ground].max() < 1e-3
    # Nobody stands in a lane: the other robot is where it is.
    assert (stage.links[1, 0] - shown)[:2].tolist() == pytest.approx([0.0, -3.3], abs=1e-5)


def test_treadmill_of_terrain_keeps_robot_0_at_the_camera():
    """Running up and down hills, robot 0 stays near the origin, as high above it as above the ground."""
    terrain = terrain_of()
    stage = Stage(1, floor=Floor.TREADMILL, terrain=terrain, device="cpu")
    for step in range(240):
        robot_pose = on(terrain, pose(), x=2.0 + 5.0 * step / 60)
        stage.pose(*robot_pose)
        assert stage.links[0, 0].abs().tolist() == pytest.approx([0.0, 0.0, STANDING], abs=0.4)
    assert float(stage.links[0, 0, :2].norm()) < 0.02


def test_flattest_terrain_looks_like_the_plane():
    """A terrain without heights to speak of gives the plane's picture: same cells, shades, shadow and feet."""
    robot_pose = pose(x=12.3, right_hip_y=-0.7, left_hip_y=0.5)
    plane = studio_picture(robot_pose).astype(int)
    terrain = studio_picture(robot_pose, terrain=terrain_of(1.0e-5, length=60.0, width=60.0)).astype(int)
    # Single rays make the edges of cells and shadows a little different.
    assert (np.abs(plane - terrain).max(axis=2) > 4).mean() < 0.01


def test_slopes_can_be_seen():
    """In the distance, where no shadow falls, a cell's brightness differs with its slope, by more than on a plane."""
    spread = []
    for height_range in (1.0e-5, 0.1):
        terrain = terrain_of(height_range, feature=0.5)
        picture = studio_picture(on(terrain, pose()), terrain=terrain).astype(float)
        spread.append(np.unique(picture[150:, :90].mean(axis=2).round()).size)
    assert spread[1] > spread[0] + 15


def test_camera_follows_the_robot_over_hills(tmp_path):
    """A robot that runs over hills of two metres stays in the middle of the picture, on its feet."""
    terrain = terrain_of(2.0, feature=6.0)
    path = tmp_path / "hills.mp4"
    heights = []
    with VideoWriter(path, terrain=terrain, width=320, height=180) as video:
        for step in range(60):
            robot_pose = on(terrain, pose(), x=11.0 + 7.0 * step / 60)
            heights.append(float(robot_pose[0][0, 2]))
            video.add(*robot_pose)
    assert max(heights) - min(heights) > 0.5
    _, frames = frames_of(path)
    for frame in frames:
        robot = np.nonzero(right_pixels(frame) | left_pixels(frame))
        assert abs(robot[1].mean() - 160) < 32
        assert robot[0].min() > 20 and robot[0].max() < 175
    # No leg is below ground, as it would be on the plane.
    shown = [(right_pixels(frame) | left_pixels(frame)).sum() for frame in frames]
    assert min(shown) > 0.8 * max(shown)


def test_tracker_has_no_lag_at_constant_speed():
    """The smoothed position catches up with steady motion and follows a jump at once."""
    tracker = Tracker(gain=0.12)
    for step in range(120):
        tracker.follow(torch.tensor([max(0.0, 0.1 * (step - 10)), 0.0, 0.9]))
    position = torch.tensor([0.1 * 110, 0.0, 0.9])
    assert float((tracker.follow(position) - position).norm()) < 0.01
    assert tracker.follow(torch.zeros(3)).tolist() == [0.0, 0.0, 0.0]


def test_aborted_recording_leaves_no_file(tmp_path):
    """A recording left by an exception does not look complete, and does not replace an older one."""
    path = tmp_path / "walk.mp4"
    path.write_bytes(b"older")
    with pytest.raises(KeyError), VideoWriter(path, width=64, height=64) as video:
        video.add(*pose())
        raise KeyError
    assert path.read_bytes() == b"older"
    assert [file.name for file in tmp_path.iterdir()] == ["walk.mp4"]


def test_caption_is_in_the_picture(tmp_path):
    """A caption darkens pixels at the top left and nothing else."""
    pictures = []
    for name, caption in (("with", "f = 0.90 Hz   1.35 m/s   t = 3.2 s"), ("without", "")):
        path = tmp_path / f"{name}.mp4"
        with VideoWriter(path) as video:
            video.add(*pose(), caption=caption)
        pictures.append(frames_of(path)[1][0].astype(int))
    darker = (pictures[1] - pictures[0]).max(axis=2) > 60
    assert darker[:40, :320].sum() > 200
    assert darker[60:].sum() == 0


@pytest.mark.parametrize("name", ["missing/walk.mp4", "walk.avi", "folder.mp4"])
def test_bad_recording_path(tmp_path, name):
    """A path that cannot be written is refused before any work."""
    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(UserError, match="cannot write"):
        VideoWriter(tmp_path / name)


def test_bad_recording_settings(tmp_path):
    """Odd sizes, no robots and empty recordings are refused."""
    with pytest.raises(UserError, match="even"):
        VideoWriter(tmp_path / "a.mp4", width=641)
    with pytest.raises(UserError, match="robots"):
        VideoWriter(tmp_path / "a.mp4", num_robots=0)
    with pytest.raises(UserError, match="nothing was added"), VideoWriter(tmp_path / "a.mp4"):
        pass
    assert not list(tmp_path.iterdir())


def stride(label: str) -> FilmstripRow:
    """Eight poses of a made-up stride that moves 1 m forward between poses; the right leg begins in front."""
    phase = torch.arange(8) * (2 * math.pi / 8)
    position, rotation, joints = pose(8)
    position[:, 0] = torch.arange(8.0)
    for side, sign in (("right", -1.0), ("left", 1.0)):
        joints[:, joint_index(f"{side}_hip_y")] = sign * 0.5 * torch.cos(phase)
    return FilmstripRow(label, position, rotation, joints)


def test_filmstrip(tmp_path):
    """Every tile holds a robot that does not touch its edges, on a floor line, and the labels are written."""
    path = tmp_path / "strip.png"
    save_filmstrip(path, [stride("0.9 Hz\n1.2 m/s"), stride("1.3 Hz\n2.9 m/s")])
    strip = np.asarray(Image.open(path))
    assert strip.shape == (2 * TILE_HEIGHT, LABEL_WIDTH + 8 * TILE_WIDTH, 3)
    for row in range(2):
        band = strip[row * TILE_HEIGHT : (row + 1) * TILE_HEIGHT].astype(int)
        assert (band[:, :LABEL_WIDTH].max(axis=2) < 120).sum() > 100
        for column in range(8):
            tile = band[:, LABEL_WIDTH + column * TILE_WIDTH :][:, :TILE_WIDTH]
            robot = right_pixels(tile) | left_pixels(tile)
            assert robot.sum() > 1500
            assert abs(columns(robot).mean() - TILE_WIDTH / 2) < 25
            assert not robot[:, :3].any() and not robot[:, -3:].any() and not robot[:5].any()
            line = np.nonzero(tile[:, 0].max(axis=1) < 150)[0]
            assert len(line) == 2
    first, middle = (strip[:TILE_HEIGHT, LABEL_WIDTH + tile * TILE_WIDTH :][:, :TILE_WIDTH] for tile in (0, 4))
    assert columns(right_pixels(first[150:])).mean() > columns(left_pixels(first[150:])).mean() + 20
    assert columns(left_pixels(middle[150:])).mean() > columns(right_pixels(middle[150:])).mean() + 20


def test_filmstrip_feet_stand_on_the_line(tmp_path):
    """The soles of a standing robot touch the floor line."""
    path = tmp_path / "strip.png"
    position, rotation, joints = pose(8)
    save_filmstrip(path, [FilmstripRow("standing", position, rotation, joints)])
    tile = np.asarray(Image.open(path))[:, LABEL_WIDTH : LABEL_WIDTH + TILE_WIDTH]
    line = np.nonzero(tile[:, 0].max(axis=1) < 150)[0][0]
    assert abs(np.nonzero(right_pixels(tile))[0].max() + 1 - line) <= 1


def test_filmstrip_on_terrain(tmp_path):
    """Each pose stands on the ground of its own place, at the same row; one that floats or sinks shows it."""
    terrain = terrain_of(0.3)
    position, rotation, joints = on(terrain, pose(8), x=torch.linspace(3.0, 20.0, 8), y=1.0)
    position[3, 2] += 0.2
    position[5, 2] -= 0.2
    path = tmp_path / "strip.png"
    save_filmstrip(path, [FilmstripRow("standing", position, rotation, joints)], terrain)
    strip = np.asarray(Image.open(path))[:, LABEL_WIDTH:]
    red = [right_pixels(strip[:, tile * TILE_WIDTH :][:, :TILE_WIDTH]) for tile in range(8)]
    pixels_per_metre = TILE_HEIGHT / 1.9 * math.cos(math.radians(12))
    shoulder = np.array([np.nonzero(tile)[0].min() for tile in red])
    above = (position[:, 2] - terrain.height(position)).numpy() * pixels_per_metre
    assert np.ptp(shoulder + above) < 3
    shown = np.array([tile.sum() for tile in red])
    assert shown[5] < 0.9 * np.delete(shown, 5).min()
    assert shown[3] == pytest.approx(np.delete(shown, (3, 5)).mean(), rel=0.03)


def test_bad_filmstrip(tmp_path):
    """Bad paths, no rows, a wrong number of poses and poses that are not finite are refused."""
    row = stride("0.9 Hz")
    with pytest.raises(UserError, match=r"end in \.png"):
        save_filmstrip(tmp_path / "strip.jpg", [row])
    with pytest.raises(UserError, match="no folder"):
        save_filmstrip(tmp_path / "missing" / "strip.png", [row])
    with pytest.raises(UserError, match="at least one row"):
        save_filmstrip(tmp_path / "strip.png", [])
    with pytest.raises(UserError, match="give 8"):
        save_filmstrip(
            tmp_path / "strip.png",
            [FilmstripRow("short", row.root_position[:5], row.root_rotation[:5], row.joint_position[:5])],
        )
    with pytest.raises(UserError, match="not finite"):
        save_filmstrip(
            tmp_path / "strip.png",
            [FilmstripRow("nan", row.root_position * math.nan, row.root_rotation, row.joint_position)],
        )
