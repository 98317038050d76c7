"""Shipping a checkpoint."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
import yaml

from aicpg_newton import places
from aicpg_newton import publish as publishing
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.stored import to_dict
from aicpg_newton.env.task import Learning
from aicpg_newton.errors import UserError
from aicpg_newton.evaluation.protocols import SWEEP
from aicpg_newton.learning import checkpoint
from aicpg_newton.publish import PublishOptions, publish, without_machine
from aicpg_newton.robot.fingerprint import fingerprint


def test_published_checkpoints_play_but_have_no_optimiser(tmp_path: Path):
    """Networks stay bit for bit, the optimiser goes, and the configuration says how long it was trained."""
    run = tmp_path / "run"
    run.mkdir()
    networks = {"actor_state_dict": {"w": torch.rand(5)}, "critic_state_dict": {"w": torch.rand(5)}}
    for iteration in (2, 9):
        checkpoint.write(
            run / f"model_{iteration}.pt",
            task=to_dict(replace(get_task("flat"), learning=Learning(hidden_sizes=(8, 4)))),
            pattern={"format": 1},
            observations=[],
            run={"seed": 0},
            iteration=iteration,
            samples=100 * iteration,
            algorithm={**networks, "optimizer_state_dict": {"state": torch.rand(1000)}, "replay": torch.rand(1000)},
        )
    target = publish(PublishOptions(checkpoint=run, out=tmp_path / "policies"))
    content = checkpoint.read(target)
    assert target.name == "flat.pt"
    assert content["iteration"] == 9
    assert content["algorithm"].keys() == networks.keys()
    assert torch.equal(content["algorithm"]["actor_state_dict"]["w"], networks["actor_state_dict"]["w"])
    config = yaml.safe_load(target.with_suffix(".yaml").read_text())
    assert config["task"].pop("learning")["hidden_sizes"] == [8, 4]
    assert config["task"].pop("name") == "flat"
    del config["task"]
    assert config == {
        "run": {"seed": 0},
        "humanoid": fingerprint(),
        "trained": {"iterations": 9, "samples": 900},
    }


@pytest.mark.parametrize(
    ("choice", "name"), [("ai-cpg", "uneven.pt"), ("ppo:3.0", "uneven_ppo_3.0.pt"), ("amp:run", "uneven_amp_run.pt")]
)
def test_baselines_go_by_method_and_condition(tmp_path: Path, choice: str, name: str):
    """So that none takes the place of another."""
    checkpoint.write(
        tmp_path / "model_0.pt",
        task=to_dict(get_task("uneven", choice)),
        pattern={},
        observations=[],
        run={},
        iteration=1,
        samples=1,
        algorithm={"actor_state_dict": {}, "critic_state_dict": {}},
    )
    target = publish(PublishOptions(checkpoint=tmp_path, out=tmp_path / "policies"))
    assert target.name == name
    assert target.with_name(name.removesuffix(".pt") + ".yaml").is_file()


def test_no_policy_for_an_unknown_task():
    """The message says what to do."""
    with pytest.raises(UserError, match="no trained policy ships for task 'moon'"):
        checkpoint.shipped("moon")


def written(folder: Path, run: dict | None = None, iteration: int = 1) -> Path:
    """A checkpoint of nothing much."""
    path = folder / f"model_{iteration}.pt"
    checkpoint.write(
        path,
        task=to_dict(get_task("uneven")),
        pattern={},
        observations=[],
        run=run or {},
        iteration=iteration,
        samples=1,
        algorithm={"actor_state_dict": {}, "critic_state_dict": {}},
    )
    return path


def test_what_ships_is_replaced_only_when_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    """Old and new are shown either way."""
    monkeypatch.setattr(publishing, "side_by_side", lambda old, new, _: f"{old.name} beside {new['iteration']}")
    out = tmp_path / "policies"
    target = publish(PublishOptions(checkpoint=written(tmp_path), out=out))
    assert "beside" not in capsys.readouterr().out
    before = {path: path.read_bytes() for path in out.iterdir()}
    newer = written(tmp_path, iteration=7)
    with pytest.raises(UserError, match=r"uneven.pt ships already and stays as it is; give --replace"):
        publish(PublishOptions(checkpoint=newer, out=out))
    assert "uneven.pt beside 7" in capsys.readouterr().out
    assert {path: path.read_bytes() for path in out.iterdir()} == before
    publish(PublishOptions(checkpoint=newer, out=out, replace=True))
    assert "uneven.pt beside 7" in capsys.readouterr().out
    assert checkpoint.read(target)["iteration"] == 7


def test_the_mean_of_a_runs_last_checkpoints(tmp_path: Path):
    """It says of which, and is trained as long as the last of them."""
    run = tmp_path / "run"
    run.mkdir()
    for iteration in (1, 3, 10, 20):
        content = checkpoint.read(written(run, {"seed": 0}, iteration))
        content["algorithm"] = {name: {"w": torch.tensor([float(iteration)])} for name in content["algorithm"]}
        checkpoint.save(content, run / f"model_{iteration}.pt")
    options = PublishOptions(checkpoint=run / "model_10.pt", average=2, out=tmp_path / "out")
    content = checkpoint.read(publish(options))
    assert content["algorithm"]["actor_state_dict"]["w"].item() == 6.5
    assert content["iteration"] == 10 and content["run"] == {"seed": 0, "average_of": [3, 10]}
    with pytest.raises(UserError, match=r"holds 4 checkpoints up to model_20.pt; average no more"):
        publish(replace(options, checkpoint=run, average=5))
    for name, message in (("model_15.pt", "no checkpoint at .*model_15.pt"), ("best.pt", "best.pt is not named as")):
        with pytest.raises(UserError, match=message):
            publish(replace(options, checkpoint=run / name))


def test_a_configuration_alone_is_kept_too(tmp_path: Path):
    """Somebody may have written it by hand."""
    (tmp_path / "uneven.yaml").write_text("mine", encoding="utf-8")
    with pytest.raises(UserError, match=r"uneven.yaml ships already"):
        publish(PublishOptions(checkpoint=written(tmp_path), out=tmp_path))
    assert (tmp_path / "uneven.yaml").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("told", "kept"),
    [
        ("/home/me/runs/flat/2026-01-02 (5 samples)", "2026-01-02 (5 samples)"),
        ("/home/me/runs/flat.pt", "flat.pt"),
        ("~/runs/flat/ (5 samples), begun with /tmp/x.pt", "flat (5 samples), begun with x.pt"),
        (r"C:\\Users\\me\\flat.pt (5 samples)", "flat.pt (5 samples)"),
        ("assets/policies/flat.pt (5 samples)", "assets/policies/flat.pt (5 samples)"),
        ("robust, walk/run at 1.1 m/s", "robust, walk/run at 1.1 m/s"),
    ],
)
def test_no_folder_of_a_machine_is_published(told: str, kept: str, tmp_path: Path):
    """Neither in the checkpoint nor beside it."""
    assert without_machine({"start_from": told, "deep": [told, 3]}) == {"start_from": kept, "deep": [kept, 3]}
    target = publish(PublishOptions(checkpoint=written(tmp_path, {"start_from": told}), out=tmp_path / "out"))
    assert checkpoint.read(target)["run"] == {"start_from": kept}
    assert yaml.safe_load(target.with_suffix(".yaml").read_text(encoding="utf-8"))["run"] == {"start_from": kept}


def test_origins_are_told_without_the_machine(tmp_path: Path):
    """Within the checkout by their place, elsewhere by their name."""
    assert places.portable(places.ASSETS / "policies" / "flat.pt") == "assets/policies/flat.pt"
    assert places.portable(tmp_path / "run" / "model_9.pt") == "model_9.pt"


@pytest.mark.slow
def test_both_are_tested(monkeypatch: pytest.MonkeyPatch):
    """With the sweep, cut short."""
    brief = replace(SWEEP, duration=2.5, frequencies=(0.9, 1.2))
    monkeypatch.setattr(publishing, "SWEEP", brief)
    shipped = checkpoint.shipped("robust")
    options = PublishOptions(checkpoint=shipped, num_envs=2, device="cpu")
    table = publishing.side_by_side(shipped, checkpoint.read(shipped), options)
    lines = table.splitlines()
    assert lines[0].split()[:4] == ["f", "[Hz]", "never", "fell"]
    for line in lines[2:]:
        numbers = line.split()[1:]
        assert numbers[::2] == numbers[1::2] and len(numbers) == 10
    assert len(lines) == 4
