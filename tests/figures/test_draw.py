"""Figures from result files alone."""

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from aicpg_newton.errors import UserError
from aicpg_newton.evaluation import results
from aicpg_newton.evaluation.protocols import GAITS, PROTOCOLS, SWEEP
from aicpg_newton.figures.draw import draw_all, human_walking_cost
from aicpg_newton.figures.plotting import methods, of_how_many, over_seeds
from aicpg_newton.figures.terrain import nearest_to_the_paper, walking_and_running_figure
from aicpg_newton.figures.transition import transition_figure

DIAGRAM = {"stride_frequency_hz": 0.75, "duty_factor": 0.6, "flight_ratio": 0.0, "reason": ""}


def terrain_rows(head: dict, speed: float) -> list[results.Row]:
    """A gait on two terrains."""
    numbers = {"speed_mps": speed, "symmetry_index": 0.3, "balance_index": 0.98, "cost_of_transport": 0.7}
    numbers |= {"flight_ratio": 0.1, "survived": 0.75, "falls_per_minute": 0.5}
    numbers |= {"sole_penetration_m": 0.002, "sole_hover_m": 0.001}
    return [{**head, "terrain_seed": seed, **numbers, "speed_mps": speed + 0.1 * seed} for seed in (1, 2)]


def training_rows(head: dict, speed: float) -> list[results.Row]:
    """Three checkpoints: the first falls, the others go ever straighter and faster."""
    rows = []
    for iteration in (1, 50, 100):
        for environment in range(3):
            vx, vy = speed * iteration / 100, (environment - 1) * (1 - iteration / 120)
            for i in range(1, 2 if iteration == 1 else 21):
                t = 0.5 * i
                way = {"time_s": t, "x_m": vx * t, "y_m": vy * t, "vx_mps": vx, "vy_mps": vy}
                rows.append({**head, "iteration": iteration, "environment": environment, **way})
    return rows


def baseline(folder: Path, method: str, conditions: dict[str, str], seeds: tuple[int, ...] = (0, 1, 2)) -> Path:
    """Made-up results of controllers trained for a condition each, given with its gait."""
    tables: dict[str, list[results.Row]] = {name: [] for name in ("sweep", "disturbance", "terrain", "training")}
    for seed in seeds:
        for i, (condition, gait) in enumerate(conditions.items()):
            v = 1.5 + 0.6 * i + 0.1 * seed
            head = {"method": method, "condition": condition, "frequency_hz": math.nan, "seed": seed}
            numbers = {"speed_mps": v, "cost_of_transport": 0.8 + 0.05 * seed, "symmetry_index": 0.6 + 0.1 * seed}
            numbers |= {"balance_index": 0.97, "froude": v * v / 8.4, "flight_ratio": 0.1, "survived": 1.0}
            tables["sweep"].append({**head, **numbers, "falls_per_minute": 0.0})
            tables["disturbance"].append({**head, "iteration": 9, "speed_mps": v, "falls_per_minute": 20.0 - seed})
            tables["terrain"] += terrain_rows({**head, "gait": gait}, v)
            tables["training"] += training_rows({**head, "gait": gait}, v)
    folder.mkdir()
    for name, rows in tables.items():
        results.write(folder, name, [{**row, "reason": ""} for row in rows], {"controllers": [], "results": []})
    return folder


def made_up(folder: Path, method: str, seeds: tuple[int, ...], fallen: bool = False) -> Path:
    """Made-up results of all protocols; with ``fallen`` every number is missing."""
    tables: dict[str, list[results.Row]] = {name: [] for name in PROTOCOLS}
    found = []
    for seed in seeds:
        for i, f in enumerate(SWEEP.frequencies):
            v = 1.0 + 0.2 * i + 0.05 * seed
            numbers = {"speed_mps": v, "cost_of_transport": 0.6 + 0.2 * (v - 1.8) ** 2, "symmetry_index": 0.3}
            numbers |= {"balance_index": 0.98, "froude": v * v / 8.4, "flight_ratio": max(0.0, 0.1 * (v - 2.2))}
            more = {"survived": 1.0, "falls_per_minute": 0.0}
            head = {"method": method, "condition": "", "frequency_hz": f, "seed": seed}
            tables["sweep"].append({**head, **numbers, **more})
            for iteration in (80, 100):
                falls = {"iteration": iteration, "speed_mps": v, "falls_per_minute": 15 - i + iteration / 10}
                tables["disturbance"].append({**head, **falls})
            tables["speed"].append(
                {**head, "commanded_mps": v, "speed_mps": v + 0.1, "error_mps": 0.1, "survived": 1.0}
            )
        for gait, f in GAITS.items():
            head = {"method": method, "condition": "", "gait": gait, "frequency_hz": f, "seed": seed}
            tables["terrain"] += terrain_rows(head, 1.5 * f)
            tables["training"] += training_rows(head, 1.5 * f)
        for step in range(0, 1800, 6):
            t = (step + 1) / 60
            v = 0.8 + 0.09 * t
            numbers = {"time_s": t, "frequency_hz": 0.7 + 0.023 * t, "speed_mps": v, "speed_std_mps": 0.1}
            numbers |= {"froude": v * v / 8.4, "flight_ratio": max(0.0, 0.02 * (t - 15)), "flight_ratio_std": 0.02}
            feet = {"right_contact": float(t % 1 < 0.4), "left_contact": float(0.5 < t % 1 < 0.9)}
            tables["transition"].append({"method": method, "seed": seed, **numbers, "standing": 1.0, **feet})
        for step in range(0, 3600, 6):
            t = (step + 1) / 60
            f = 0.7 + 0.7 / 30 * min(t, 60 - t)
            numbers = {"time_s": t, "frequency_hz": f, "speed_mps": 3 * f, "speed_std_mps": 0.1, "froude": f}
            numbers |= {"flight_ratio": max(0.0, f - (1.0 if t < 30 else 0.9)), "flight_ratio_std": 0.02}
            feet = {"right_contact": 1.0, "left_contact": 0.0}
            tables["up_and_down"].append({"method": method, "seed": seed, **numbers, "standing": 1.0, **feet})
        pose = {"height_m": 0.88, "root_rotation": [0.0, 0.0, 0.0, 1.0], "joint_position": [0.0] * 28}
        changes = {name: {"mean": f} for name, f in (("transition_frequency_hz", 1.0), ("flight_begins_hz", 1.05))}
        found.append(
            {
                **{"method": method, "seed": seed, **changes, "flight_is_steady_hz": {"mean": None}},
                **{way: {"transition_frequency_hz": {"mean": f}} for way, f in (("up", 1.0), ("down", 0.95))},
                "gait_diagrams": {
                    "walking": {"from_s": 2.0, "to_s": 5.0, **DIAGRAM},
                    "running": {"from_s": 27.0, "to_s": 30.0, **DIAGRAM},
                },
                "poses": [{"time_s": t, "frequency_hz": 1.0, **pose} for t in np.linspace(1, 30, 11).tolist()],
            }
        )
    kept = ("method", "condition", "gait", "seed", "terrain_seed", "frequency_hz", "time_s", "iteration", "environment")
    for rows in tables.values():
        for row in rows:
            row["reason"] = "everything fell" if fallen else ""
            row.update({key: math.nan for key in row if fallen and key not in (*kept, "reason")})
    if fallen:
        for each in found:
            each["poses"] = []
            each.update({name: {"mean": None} for name in each if name.endswith("_hz")})
            each["up"] = each["down"] = {"transition_frequency_hz": {"mean": None}}
            each["gait_diagrams"]["walking"]["reason"] = each["gait_diagrams"]["running"]["reason"] = "fell"
    folder.mkdir()
    for name, rows in tables.items():
        results.write(folder, name, rows, {"controllers": [], "results": found})
    return folder


FIGURES = ["figure_3.png", "figure_5a.png", "figure_5b.png", "figure_6.png", "speed.png", "up_and_down.png"]


def test_methods_and_seeds_share_the_panels(tmp_path: Path):
    """Two folders with two methods give one set of figures, in colours and in the same places in grey."""
    folders = [made_up(tmp_path / "a", "AI-CPG", (0, 1)), made_up(tmp_path / "b", "CPG alone", (0,))]
    paths = draw_all(folders, tmp_path)
    assert sorted(path.name for path in paths) == [
        *FIGURES[:1],
        "figure_4_ai_cpg.png",
        "figure_4_cpg_alone.png",
        *FIGURES[1:],
    ]
    for path in paths:
        image = np.asarray(Image.open(path).convert("L"))
        assert image.shape[1] >= 1000 and image.std() > 10
    alone = draw_all(folders[:1], folders[0])
    assert not np.array_equal(np.asarray(Image.open(alone[0])), np.asarray(Image.open(paths[0])))


def test_results_without_a_number_give_figures_that_say_so(tmp_path: Path):
    """Everything fell: no crash, all figures."""
    paths = draw_all([made_up(tmp_path / "a", "AI-CPG", (0,), fallen=True)], tmp_path)
    assert sorted(path.name for path in paths) == [*FIGURES[:1], "figure_4_ai_cpg.png", *FIGURES[1:]]


def test_the_papers_change_of_gait_is_where_its_ramp_passes_it(tmp_path: Path):
    """f(t) = 0.7 + 0.023 t passes 0.93 Hz at 10 s and 1.14 Hz at 19.1 s."""
    folder = made_up(tmp_path / "a", "AI-CPG", (0,))
    rows = results.read_table(folder, "transition")
    figure = transition_figure("AI-CPG", rows, results.read_description(folder, "transition")["results"])
    panels = [(axes, patch) for axes in figure.axes for patch in axes.patches]
    ((axes, band),) = [(axes, patch) for axes, patch in panels if "the paper's" in str(patch.get_label())]
    ends = band.get_extents().transformed(axes.transData.inverted())
    assert (ends.x0, ends.x1) == pytest.approx((10.0, 19.13), abs=0.06)


def test_baselines_join_the_panels(tmp_path: Path):
    """Controllers of one speed each: dots in Fig. 3, bars and panels in Fig. 5, nothing in the others."""
    ppo = baseline(tmp_path / "ppo", "PPO", {"1.5": "walking", "2.0": "walking", "3.0": "running"})
    amp = baseline(tmp_path / "amp", "AMP", {"walk": "walking"}, (0,))
    alone = draw_all([ppo], ppo)
    assert [path.name for path in alone] == FIGURES[:3]
    paths = draw_all([made_up(tmp_path / "cpg", "AI-CPG", (0, 1)), ppo, amp], tmp_path)
    assert {path.name for path in paths} == {*FIGURES, "figure_4_ai_cpg.png"}
    # A row of panels for each method.
    heights = [np.asarray(Image.open(folder / "figure_5a.png")).shape[0] for folder in (ppo, tmp_path)]
    assert heights[1] > 2 * heights[0]
    more = baseline(tmp_path / "more", "PPO", {"4.0": "running"})
    draw_all([ppo, more], more)
    with pytest.raises(UserError, match=r"sweep results of PPO 1\.5, seed 0"):
        draw_all([ppo, baseline(tmp_path / "twice", "PPO", {"1.5": "walking"})], tmp_path)


def test_dots_are_means_over_the_seeds_of_a_condition():
    """Two speeds of two seeds each: two points with deviations in x and y, and no curve; of one seed its interval."""
    rows = [
        {
            "method": "PPO",
            "condition": condition,
            "seed": seed,
            "frequency_hz": math.nan,
            "speed_mps": v,
            "falls": 10 * v,
        }
        for condition, seed, v in (("1.5", 0, 1.4), ("1.5", 1, 1.6), ("3.0", 0, 2.5), ("3.0", 1, 3.1))
    ]
    points = over_seeds(rows, "PPO", "speed_mps", "falls")
    assert points.x.tolist() == pytest.approx([1.5, 2.8]) and points.x_spread.tolist() == pytest.approx([0.1, 0.3])
    assert points.y_spread.tolist() == pytest.approx([1.0, 3.0]) and points.seeds == "2 seeds" and not points.curve
    one = [{**row, "speed_mps_ci95": 0.05} for row in rows if row["seed"] == 0]
    points = over_seeds(one, "PPO", "speed_mps", "falls")
    assert points.x_spread.tolist() == [0.05, 0.05] and points.y_spread.tolist() == [0.0, 0.0]
    assert points.seeds == "1 seed"
    points = over_seeds([*rows[:2], *one[1:]], "PPO", "speed_mps", "falls")
    assert points.x_spread.tolist() == pytest.approx([0.1, 0.05]) and points.seeds == "1 to 2 seeds"


def test_fig_5_takes_the_condition_trained_for_the_papers_speed():
    """1.5 and 3.0 m/s; conditions without a speed, and stride frequencies, as they are."""
    speeds = [{"condition": condition} for condition in ("2.0", "1.5", "2.5", "4.0", "1.5")]
    assert nearest_to_the_paper(speeds, "walking") == [{"condition": "1.5"}] * 2
    assert nearest_to_the_paper(speeds, "running") == [{"condition": "2.5"}]
    for condition in ("", "run"):
        assert nearest_to_the_paper([{"condition": condition}] * 2, "running") == [{"condition": condition}] * 2
    assert nearest_to_the_paper([], "running") == []


def test_what_cannot_be_drawn(tmp_path: Path):
    """No results, or the same method and seed twice."""
    with pytest.raises(UserError, match="no results in"):
        draw_all([tmp_path], tmp_path)
    twice = [made_up(tmp_path / name, "AI-CPG", (2,)) for name in "ab"]
    with pytest.raises(UserError, match="AI-CPG, seed 2"):
        draw_all(twice, tmp_path)


def test_means_over_seeds_weigh_every_seed_alike():
    """Seed 1 with falls 1 and 3 (two checkpoints) and seed 2 with 6: mean 4, deviation 2; empty cells are left out."""
    rows = [
        {"method": "A", "condition": "", "seed": seed, "frequency_hz": 1.0, "speed_mps": 2.0, "falls_per_minute": falls}
        for seed, falls in ((1, 1.0), (1, 3.0), (2, 6.0), (3, math.nan))
    ]
    points = over_seeds(rows, "A", "speed_mps", "falls_per_minute")
    assert (points.x.tolist(), points.y.tolist(), points.y_spread.tolist(), points.seeds) == (
        [2.0],
        [4.0],
        [2.0],
        "2 seeds, 1 more without a value",
    )


def test_methods_differ_without_colour():
    """Marker, line style and hatching of each are its own."""
    looks = list(methods([{"method": name} for name in ("A", "PPO", "B", "AMP", "AI-CPG", "B")]).values())
    assert len(looks) == 5
    assert len({look.marker for look in looks}) == len({look.line for look in looks}) == 5
    assert methods([{"method": "PPO"}])["PPO"] == looks[1]  # a method looks the same in every figure


def test_human_walking_costs_least_at_the_speed_people_choose():
    """Ralston's curve: 0.334 at 1.23 m/s."""
    speed = np.linspace(0.6, 2.0, 1401)
    cost = human_walking_cost(speed)
    assert speed[cost.argmin()] == pytest.approx(1.233, abs=2e-3) and cost.min() == pytest.approx(0.334, abs=1e-3)


def test_figures_say_how_many_seeds_have_no_value(tmp_path: Path):
    """One of three trainings fell everywhere: the means are over the others, and the labels say so."""
    folders = [made_up(tmp_path / "a", "AI-CPG", (0, 1)), made_up(tmp_path / "b", "AI-CPG", (2,), fallen=True)]
    rows = results.read_together(folders, "sweep")
    points = over_seeds(rows, "AI-CPG", "speed_mps", "cost_of_transport")
    assert points.seeds == "2 seeds, 1 more without a value" and np.isfinite(points.y).all()
    assert of_how_many([1.0, math.nan, 2.0]) == "(2 of 3 seeds)" and of_how_many([1.0]) == ""
    figure = walking_and_running_figure(results.read_together(folders, "terrain"))
    assert any("(2 of 3 seeds)" in text.get_text() for axes in figure.axes for text in axes.texts)
    draw_all(folders, tmp_path)
