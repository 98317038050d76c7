"""Choice of the device and of the number of threads."""

import pytest
import torch

from aicpg_newton.device import resolve_device, torch_threads
from aicpg_newton.errors import UserError


def test_auto_falls_back_to_the_cpu_and_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture):
    """Without CUDA a line tells."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert resolve_device("auto") == torch.device("cpu")
    assert "running on the CPU" in capsys.readouterr().out


def test_auto_takes_the_first_gpu(monkeypatch: pytest.MonkeyPatch):
    """With CUDA it is cuda:0."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
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
