"""The page as a person uses it, in headless Chromium.

Needs ``apt install chromium chromium-driver`` and ``pip install viser selenium``.
"""

# pyright: reportMissingImports=false

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]

_PATIENCE = 240.0
"""How long a machine may take to show a second or two [s]."""

_MISSING = [
    *(module for module in ("viser", "selenium") if find_spec(module) is None),
    *(program for program in ("chromium", "chromedriver") if shutil.which(program) is None),
]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(_MISSING), reason=f"not installed: {', '.join(_MISSING)}"),
]


@pytest.fixture
def playing(tmp_path: Path) -> Iterator[tuple[subprocess.Popen, str]]:
    """``play.py`` with two robots, and the address of its page."""
    command = [sys.executable, "-u", "play.py", "--viewer", "viser", "--frequency", "0.9", "1.1", "--device", "cpu"]
    output = tmp_path / "output"
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    with output.open("w") as file:
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            stdout=file,
            stderr=file,
            env=environment,
            # A shell without job control lets its background jobs ignore Ctrl-C.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )
    try:
        address = None
        began = time.monotonic()
        while address is None:
            assert process.poll() is None and time.monotonic() - began < _PATIENCE, output.read_text()
            address = re.search(r"open (http://\S+) in a browser", output.read_text())
            time.sleep(0.2)
        yield process, address[1]
        assert "Traceback" not in ended(process, output)
    finally:
        process.kill()


def ended(process: subprocess.Popen, output: Path) -> str:
    """What it has printed, once Ctrl-C has ended it; again where it had ended before."""
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == 0, output.read_text(encoding="utf-8")
    return output.read_text(encoding="utf-8")


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Any]:
    """A small window: the picture is drawn without a graphics card."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for argument in (
        *("--headless=new", "--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-sync"),
        *("--disable-component-update", "--disable-quic", "--enable-unsafe-swiftshader", "--window-size=900,700"),
        f"--user-data-dir={tmp_path / 'profile'}",
    ):
        options.add_argument(argument)
    driver = webdriver.Chrome(options, Service(shutil.which("chromedriver")))
    yield driver
    driver.quit()


def readings(browser: Any) -> list[list[float]]:
    """Rows of the table: number, f, speed, Froude number, phase and falls of each robot."""
    cells = browser.execute_script(
        "return [...document.querySelectorAll('table tbody tr')]"
        ".map(row => [...row.querySelectorAll('td')].map(cell => cell.textContent))"
    )
    return [[float(cell.rstrip("°")) for cell in row] for row in cells]


def simulated(browser: Any) -> float:
    """Simulated time that the page shows [s]; -1 before it shows any."""
    found = re.search(r"t = ([\d.]+) s", browser.execute_script("return document.body.textContent"))
    return float(found[1]) if found else -1.0


def wait(browser: Any, seconds: float) -> list[list[float]]:
    """Let so many simulated seconds pass; returns the readings then."""
    began, until = time.monotonic(), max(simulated(browser), 0.0) + seconds
    while simulated(browser) < until:
        assert time.monotonic() - began < _PATIENCE, "the page stands still"
        time.sleep(0.1)
    return readings(browser)


def field(browser: Any, label: str) -> Any:
    """The number field beside a slider."""
    return browser.find_element("xpath", f"//*[text()='{label}']/following::input[@inputmode][1]")


def test_turn_and_read(playing, browser, tmp_path: Path):
    """F is turned to 1.3 Hz and the speed follows; a push is told of and stood; a page may be closed meanwhile."""
    from selenium.webdriver.common.keys import Keys

    process, address = playing
    browser.get(address)
    before = wait(browser, 4.0)
    assert [row[1] for row in before] == pytest.approx([0.9, 1.1], abs=0.01)
    assert 1.2 < before[0][2] < 1.8 < before[1][2] < 2.3
    number = field(browser, "f [Hz]")
    number.send_keys(Keys.CONTROL, "a")
    number.send_keys("1.30", Keys.ENTER)
    after = wait(browser, 5.0)
    assert [row[1] for row in after] == pytest.approx([1.3, 1.3], abs=0.01)
    assert all(2.8 < row[2] < 3.8 for row in after)
    began = simulated(browser)
    browser.find_element("xpath", "//button[.//text()='Push']").click()
    fallen = wait(browser, 1.0)[0][5]
    told = re.search(
        r"pushed forwards with 200 N at ([\d.]+) s", browser.execute_script("return document.body.textContent")
    )
    assert told is not None and float(told[1]) >= began and fallen == 0
    browser.get("about:blank")  # the page is closed, and opened again: the robots have gone on
    browser.get(address)
    assert wait(browser, 1.0)[0][1] == pytest.approx(1.3, abs=0.01) and simulated(browser) > float(told[1])
    assert browser.save_screenshot(str(tmp_path / "page.png")) and (tmp_path / "page.png").stat().st_size > 20_000
    assert "turned by hand" in ended(process, tmp_path / "output")


def test_a_second_viewer_beside_the_first(playing):
    """It takes a port of its own and says which; the first goes on, which the fixture sees to."""
    command = [sys.executable, "-u", "play.py", "--viewer", "viser", "--frequency", "1.0", "--duration", "1"]
    second = subprocess.run(
        [*command, "--device", "cpu"], cwd=ROOT, capture_output=True, text=True, check=False, timeout=_PATIENCE
    )
    assert second.returncode == 0 and "Traceback" not in second.stderr
    address = re.search(r"open (http://\S+) in a browser", second.stdout)
    assert address is not None and address[1] != playing[1]
