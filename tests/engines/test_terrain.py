"""Uneven ground without physics: what its settings promise, and one surface behind heights, vertices and triangles."""

import numpy as np
import pytest
import torch

from aicpg_newton.engines.terrain import EDGE, SHAPES, Ground, Terrain
from aicpg_newton.errors import UserError

GROUND = Ground(height_range=0.1, length=10.0, width=9.0)


def make(ground: Ground) -> Terrain:
    """The terrain of settings that are not those of a plane."""
    terrain = Terrain.make(ground)
    assert terrain is not None
    return terrain


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    """Rough ground with a length, a width and a number of cells that cannot be taken for one another."""
    return make(GROUND)


def test_no_height_is_a_plane() -> None:
    """The default ground is none."""
    assert Terrain.make(Ground()) is None


@pytest.mark.parametrize("height_range", [0.02, 0.1, 0.5])
def test_the_range_is_that_asked_for(height_range: float) -> None:
    """From the lowest to the highest point, with zero in the middle."""
    heights = make(Ground(height_range=height_range, length=10.0, width=9.0)).heights
    assert heights.amax().item() == pytest.approx(0.5 * height_range, rel=1e-6)
    assert heights.amin().item() == pytest.approx(-0.5 * height_range, rel=1e-6)


def test_size_and_position(terrain: Terrain) -> None:
    """40 by 36 cells of 0.25 m, x from zero, y on both sides of it."""
    assert terrain.heights.shape == (41, 37) and terrain.extent == (10.0, 9.0)
    vertices = terrain.vertices()
    assert vertices.shape == (41 * 37, 3)
    np.testing.assert_allclose(vertices.min(axis=0)[:2], [0.0, -4.5])
    np.testing.assert_allclose(vertices.max(axis=0)[:2], [10.0, 4.5])


def test_seeds() -> None:
    """A seed gives the same heights each time, another seed others."""
    again, other = make(GROUND), make(Ground(height_range=0.1, length=10.0, width=9.0, seed=1))
    assert torch.equal(make(GROUND).heights, again.heights)
    assert (again.heights - other.heights).abs().mean() > 0.01


def test_lines_between_features_are_straight() -> None:
    """Random heights stand every 0.5 m; the vertex between two of them is half way."""
    heights = make(GROUND).heights
    torch.testing.assert_close(heights[1::2], 0.5 * (heights[:-1:2] + heights[2::2]), rtol=0.0, atol=1e-6)
    torch.testing.assert_close(heights[:, 1::2], 0.5 * (heights[:, :-1:2] + heights[:, 2::2]), rtol=0.0, atol=1e-6)
    assert (heights[::2][1:] - heights[::2][:-1]).abs().mean() > 0.02


def test_height_is_that_of_the_triangles(terrain: Terrain) -> None:
    """At the vertices and at random points of all triangles, which cover the mesh and face up."""
    vertices, triangles = terrain.vertices(), terrain.triangles()
    assert triangles.shape == (2 * 40 * 36, 3)
    found = terrain.height(torch.tensor(vertices[:, :2]))
    np.testing.assert_allclose(found, vertices[:, 2], atol=1e-6)

    weights = np.random.default_rng(0).dirichlet((1.0, 1.0, 1.0), len(triangles))
    points = (weights[:, :, None] * vertices[triangles]).sum(axis=1)
    found = terrain.height(torch.tensor(points))
    np.testing.assert_allclose(found, points[:, 2], atol=1e-6)
    # Cut along the other diagonal, cells would differ by millimetres.
    corners = terrain.heights
    twist = corners[:-1, :-1] + corners[1:, 1:] - corners[1:, :-1] - corners[:-1, 1:]
    assert twist.abs().median() > 1e-3

    first, second, third = (vertices[triangles[:, corner]] for corner in range(3))
    area = 0.5 * np.cross(second - first, third - first)[:, 2]
    assert (area > 0.0).all(), "clockwise"
    assert area.sum() == pytest.approx(10.0 * 9.0)


def test_height_anywhere_is_finite(terrain: Terrain) -> None:
    """Beyond the mesh and for robots whose state is not finite."""
    points = torch.tensor([[-1.0, 0.0], [20.0, -30.0], [torch.nan, 1.0], [1.0, torch.nan]])
    assert torch.isfinite(terrain.height(points)).all()


def test_height_takes_any_shape(terrain: Terrain) -> None:
    """Leading dimensions are kept, what follows x and y is ignored."""
    points = 4.0 * torch.rand(3, 5, 3, generator=torch.Generator().manual_seed(0))
    heights = terrain.height(points)
    assert heights.shape == (3, 5)
    assert torch.equal(heights[1, 2], terrain.height(points[1, 2, :2]))


def test_levels_rise_strip_by_strip() -> None:
    """Each strip has its share of the range, from right to left."""
    ground = Ground(height_range=0.4, length=60.0, width=32.0, levels=4)
    heights = make(ground).heights
    strips = [heights[:, 32 * level : 32 * (level + 1)] for level in range(4)]
    spans = torch.stack([strip.amax() - strip.amin() for strip in strips])
    share = 0.1 * torch.arange(1.0, 5.0)
    assert (spans <= share + 1e-6).all() and (spans > 0.95 * share).all(), spans


def test_the_first_strip_may_be_level() -> None:
    """The others have equal steps from nothing to all of the range."""
    heights = make(Ground(height_range=0.3, length=60.0, width=32.0, levels=4, level_strip=True)).heights
    strips = [heights[:, 32 * level : 32 * (level + 1)] for level in range(4)]
    spans = [float(strip.amax() - strip.amin()) for strip in strips]
    assert spans == pytest.approx([0.0, 0.1, 0.2, 0.3], abs=0.015)


@pytest.mark.parametrize("levels", [1, 3])
def test_robots_start_in_their_strip(levels: int) -> None:
    """Away from the border, in the first half, and wherever they may go on."""
    terrain = make(Ground(height_range=0.1, length=30.0, width=27.0, levels=levels))
    level = torch.arange(levels).repeat_interleave(200)
    share = torch.rand(len(level), 2, generator=torch.Generator().manual_seed(0))
    start = terrain.starts(level, share)
    assert terrain.inside(start).all()
    assert (start[:, 0] >= EDGE).all() and (start[:, 0] <= 15.0).all()
    width = 27.0 / levels
    right = -13.5 + width * level
    assert (start[:, 1] >= right + EDGE).all() and (start[:, 1] <= right + width - EDGE).all()
    # All of the area is used.
    assert start[:, 0].amax() - start[:, 0].amin() > 12.0
    assert (start[:, 1] - right).amax() - (start[:, 1] - right).amin() > 0.9 * (width - 2 * EDGE)


def test_robots_start_within_forty_metres() -> None:
    """Behind them is the way they have to walk."""
    terrain = make(Ground(height_range=0.1, length=100.0, width=8.0))
    start = terrain.starts(torch.zeros(2), torch.tensor([[0.0, 0.5], [1.0, 0.5]]))
    torch.testing.assert_close(start, torch.tensor([[EDGE, 0.0], [40.0, 0.0]]))


def test_inside_ends_before_the_mesh(terrain: Terrain) -> None:
    """Half of the border on each side is out of bounds."""
    points = {
        (5.0, 0.0): True,
        (1.1, 0.0): True,
        (0.9, 0.0): False,
        (8.9, 0.0): True,
        (9.1, 0.0): False,
        (5.0, 3.4): True,
        (5.0, 3.6): False,
        (5.0, -3.4): True,
        (5.0, -3.6): False,
        (float("nan"), 0.0): False,
    }
    assert terrain.inside(torch.tensor(list(points))).tolist() == list(points.values())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"height_range": -0.1}, "ground.height_range is -0.1"),
        ({"height_range": float("inf")}, "ground.height_range is inf"),
        ({"cell": 0.0}, "ground.cell is 0.0"),
        ({"cell": 1.0}, "a feature no smaller than the cell"),
        ({"cell": 10.0, "feature": 10.0}, "ground.cell is 10.0; give a positive number of at most 8"),
        ({"levels": 0}, "ground.levels is 0"),
        ({"seed": -1}, "ground.seed is -1"),
        ({"length": 7.0}, "ground.length is 7.0"),
        ({"levels": 2}, "give 8.0 m for each level"),
        ({"width": float("nan")}, "ground.width is nan"),
    ],
)
def test_bad_settings(change: dict[str, float], message: str) -> None:
    """Ground that cannot be built is refused, with the setting's name."""
    settings = {"height_range": 0.1, "length": 10.0, "width": 9.0, **change}
    with pytest.raises(UserError, match=message):
        Terrain.make(Ground(**settings))  # type: ignore[arg-type]


def test_unseen_ground_has_other_heights_of_the_full_range() -> None:
    """Whatever the curriculum: all else stays."""
    ground = Ground(height_range=0.1, length=24.0, width=16.0, levels=2, seed=3)
    assert ground.unseen(1001) == Ground(height_range=0.1, length=24.0, width=16.0, levels=1, seed=1001)


def test_a_new_kind_of_ground_is_a_function(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the table under its name; range, levels and everything that asks for heights come with it."""
    monkeypatch.setitem(SHAPES, "waves", lambda ground, x, y: np.sin(x)[:, None] + 0.0 * y)
    waves = make(Ground(height_range=0.3, shape="waves", length=20.0, width=9.0))
    x = torch.tensor([[0.5 * np.pi, 0.0], [1.5 * np.pi, 2.0]])
    assert waves.height(x).tolist() == pytest.approx([0.15, -0.15], abs=3e-3)
    with pytest.raises(UserError, match=r"ground\.shape is 'dunes'; choose one of: random, waves"):
        Ground(shape="dunes").validate()
