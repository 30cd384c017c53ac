"""The page in a browser: no errors, everything of the first screen on it, on a desk and on a phone, and few sheets."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import msgspec
import pytest

from rotorid_torch.report import records
from rotorid_torch.report.figures import Overlay
from rotorid_torch.report.page.document import Shown, render

BROWSER = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), ""
)
pytestmark = pytest.mark.skipif(not BROWSER, reason="no Chromium is installed")
FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=2000", "--enable-logging=stderr")
MEASURE = """<script>addEventListener("load", () => setTimeout(() => {
  const all = query => [...document.querySelectorAll(query)];
  const bottom = query => Math.round(Math.max(0, ...all(query).map(e => e.getBoundingClientRect().bottom)));
  const told = { h1: bottom("h1"), grades: bottom(".grades"), worst: bottom(".worst"), picture: bottom(".first svg"),
    steps: bottom(".steps"), wide: document.documentElement.scrollWidth, plots: all("#plots canvas").length };
  parent.postMessage(JSON.stringify(told), "*");
}, 300));</script>"""
FRAME = """<body style="margin:0"><pre id="told"></pre>
<iframe src="page.html" style="border:0;width:{}px;height:{}px"></iframe>
<script>addEventListener("message", e => document.getElementById("told").textContent = e.data);</script>"""


def browse(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [BROWSER, *FLAGS, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, report: records.Report, overlays: list[Overlay]) -> Path:
    """A page of a closed loop, with a script that measures it."""
    folder = tmp_path_factory.mktemp("page")
    size = records.ParameterRecord(name="control.delay.common", value=0.057, se=0.006, unit="s")
    effect = records.EffectRecord(
        id="control.delay",
        role="undeclared",
        verdict="accepted",
        reason="better",
        gain=2.0,
        floor=0.5,
        parameters=(size,),
    )
    verdict = records.VerdictRecord(kind="undeclared", effects=("control.delay",), sentence="Undeclared.")
    loop = msgspec.structs.replace(report, after=report.before, effects=(effect,), verdict=verdict)
    page = render(loop, Shown(overlays, overlays))
    (folder / "page.html").write_text(page.replace("</body>", f"{MEASURE}</body>"), encoding="utf-8")
    (folder / "plain.html").write_text(page, encoding="utf-8")
    return folder


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (390, 844)])
def test_the_first_screen_holds_all_of_it_and_nothing_is_wider(place: Path, width: int, height: int):
    frame = place / f"frame-{width}.html"
    frame.write_text(FRAME.format(width, height), encoding="utf-8")
    done = browse(f"--window-size={max(width, 500)},{height + 40}", "--dump-dom", frame.as_uri())
    assert [line for line in done.stderr.splitlines() if "CONSOLE" in line] == []
    found = re.search(r'<pre id="told">(.*?)</pre>', done.stdout)
    assert found is not None
    told = json.loads(found[1])
    assert 0 < told["h1"] < told["grades"] <= height
    assert 0 < told["worst"] <= height
    assert 0 < told["picture"] <= height
    assert told["wide"] <= width
    assert told["plots"] >= 3


def test_print_has_at_most_twelve_sheets(place: Path):
    sheets = place / "page.pdf"
    browse("--no-pdf-header-footer", f"--print-to-pdf={sheets}", (place / "plain.html").as_uri())
    assert 1 <= len(re.findall(rb"/Type\s*/Page[^s]", sheets.read_bytes())) <= 12
