"""Choice of the device and of the number of threads."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from aicpg_newton.device import (
    MadeOnce,
    cpu_cores,
    plain_tensors,
    resolve_device,
    resolve_learner_device,
    torch_threads,
)
from aicpg_newton.errors import UserError


def test_auto_falls_back_to_the_cpu_and_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture):
    """Without CUDA a line tells."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert resolve_device("auto") == torch.device("cpu")
    assert "running on the CPU" in capsys.readouterr().out


def test_auto_takes_the_first_gpu(monkeypatch: pytest.MonkeyPatch):
    """With CUDA it is cuda:0."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    assert resolve_device("auto") == torch.device("cuda:0")


def test_bad_devices(monkeypatch: pytest.MonkeyPatch):
    """A GPU that is not there, a device of another kind, a word."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(UserError, match="'cuda:0' is not there"):
        resolve_device("cuda:0")
    with pytest.raises(UserError, match="not supported"):
        resolve_device("xpu")
    with pytest.raises(UserError, match="unknown device 'gpu'"):
        resolve_device("gpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(UserError, match=r"'cuda:3' is not there \(CUDA devices found: 1\)"):
        resolve_device("cuda:3")


def test_networks_may_be_on_another_device_than_physics_on_the_cpu(monkeypatch: pytest.MonkeyPatch):
    """With mujoco a GPU or a Mac's Metal; nothing given is the device of the physics."""
    cpu, gpu = torch.device("cpu"), torch.device("cuda:0")
    assert resolve_learner_device(None, "mujoco", cpu) == cpu
    assert resolve_learner_device("cpu", "newton", cpu) == cpu
    assert resolve_learner_device(None, "newton", gpu) == gpu
    assert resolve_learner_device("cuda:0", "newton", gpu) == gpu
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert resolve_learner_device("cuda:1", "mujoco", cpu) == torch.device("cuda:1")
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: True)
    assert resolve_learner_device("mps", "mujoco", cpu) == torch.device("mps")


def test_networks_on_a_device_that_cannot_be(monkeypatch: pytest.MonkeyPatch):
    """One sentence each: not there, another engine, no such device."""
    cpu = torch.device("cpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    with pytest.raises(UserError, match="'cuda:0' is not there"):
        resolve_learner_device("cuda:0", "mujoco", cpu)
    with pytest.raises(UserError, match="mps is not there"):
        resolve_learner_device("mps", "mujoco", cpu)
    with pytest.raises(UserError, match="goes with --engine mujoco"):
        resolve_learner_device("cuda:0", "newton", cpu)
    with pytest.raises(UserError, match="--learner-device is auto"):
        resolve_learner_device("auto", "mujoco", cpu)
    with pytest.raises(UserError, match="unknown device 'gpu'"):
        resolve_learner_device("gpu", "mujoco", cpu)


def test_threads_are_given_back():
    """Nested, as a decorator, and when something goes wrong inside."""
    before = torch.get_num_threads()
    with torch_threads(1):
        assert torch.get_num_threads() == 1
        assert torch_threads(3)(torch.get_num_threads)() == 3
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == before
    with pytest.raises(ValueError, match="inside"), torch_threads(before + 1):
        raise ValueError("inside")
    assert torch.get_num_threads() == before


@pytest.mark.parametrize(
    ("given", "wanted"),
    [({}, "1000"), ({"GOMP_SPINCOUNT": "7"}, "7"), ({"OMP_WAIT_POLICY": "ACTIVE"}, "None")],
)
def test_waiting_threads_give_up_early(given: dict[str, str], wanted: str):
    """Said to OpenMP before train.py's imports load torch; what the user has set is obeyed."""
    inherited = {name: value for name, value in os.environ.items() if name not in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")}
    code = (
        "import sys, tyro; assert 'torch' not in sys.modules\n"
        "import aicpg_newton.errors; assert 'torch' not in sys.modules\n"
        "import os; print(os.environ.get('GOMP_SPINCOUNT'))"
    )
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, env={**inherited, **given}, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == wanted


def test_a_thread_that_is_kept_from_its_core_shows_it():
    """Two busy processes on one core: each waits for half of the time. Only Linux tells."""
    if not Path("/proc/self/schedstat").exists():
        pytest.skip("the system does not tell how long threads wait")
    code = (
        "import os, time; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "from aicpg_newton.device import waits_for_cores\n"
        "child = os.fork(); end = time.monotonic() + 1.0\n"
        "while time.monotonic() < end: pass\n"
        "if child: print(max(waits_for_cores().values()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) > 0.2


def test_cores_are_found_where_the_system_does_not_say_which(monkeypatch: pytest.MonkeyPatch):
    """As on macOS: then all there are."""
    assert 1 <= cpu_cores() <= (os.cpu_count() or 1)
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    assert cpu_cores() == (os.cpu_count() or 1)


def test_plain_tensors_whatever_the_mode():
    """What is kept in inference mode could not be changed outside of it; gradients are off all the same."""
    weight = torch.ones(3, requires_grad=True)

    @plain_tensors
    def doubled(factor: float) -> torch.Tensor:
        return factor * weight

    with torch.inference_mode():
        made = doubled(2.0)
        assert torch.ones(1).is_inference()
    assert not made.is_inference() and not made.requires_grad
    assert not doubled(3.0).requires_grad and weight.mul(1.0).requires_grad
    made += 1.0
    assert made.tolist() == [3.0, 3.0, 3.0]


def test_constants_are_made_once_for_each_device():
    """And for each type; what they are called with tells them apart."""
    calls = []

    @MadeOnce
    def constant(device: torch.device, dtype: torch.dtype) -> torch.Tensor:
        """Two."""
        calls.append(dtype)
        return torch.tensor(2.0, device=device, dtype=dtype)

    cpu = torch.device("cpu")
    assert constant(cpu, torch.float32) is constant(cpu, torch.float32)
    assert constant(cpu, torch.float64).dtype == torch.float64
    assert constant(torch.device("meta"), torch.float32).is_meta
    assert calls == [torch.float32, torch.float64, torch.float32] and constant.__doc__ == "Two."
