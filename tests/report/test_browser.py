"""The page in a browser: no errors, everything of the first screen on it, on a desk and on a phone, and few sheets."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from rotorid_torch.commands.show import comparison
from rotorid_torch.data import Dataset
from rotorid_torch.report import records
from rotorid_torch.report.overlay import Overlay
from rotorid_torch.report.page.check_page import render_check
from rotorid_torch.report.page.document import Shown, render
from rotorid_torch.report.page.plots import GROUPS
from rotorid_torch.run.check import check
from rotorid_torch.run.output.write import png
from tests.helpers import small_flight
from tests.report.conftest import an_overlay

BROWSER = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), ""
)
pytestmark = pytest.mark.skipif(not BROWSER, reason="no Chromium is installed")
FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=2000", "--enable-logging=stderr")
MEASURE = """<script>addEventListener("load", () => setTimeout(() => {
  const all = query => [...document.querySelectorAll(query)];
  const bottom = query => Math.round(Math.max(0, ...all(query).map(e => e.getBoundingClientRect().bottom)));
  const told = { h1: bottom("h1"), grades: bottom(".grades"), worst: bottom(".worst"),
    picture: bottom(".first svg, .first img"),
    cut: all(".cards").filter(e => e.scrollWidth > e.parentElement.clientWidth).length,
    flight: (all("#flight")[0] || {}).selectedIndex, group: (all("#group")[0] || {}).value,
    steps: bottom(".steps"), wide: document.documentElement.scrollWidth, plots: all("#plots canvas").length };
  parent.postMessage(JSON.stringify(told), "*");
}, 300));</script>"""
FRAME = """<body style="margin:0"><pre id="told"></pre>
<iframe src="{}.html" style="border:0;width:{}px;height:{}px"></iframe>
<script>addEventListener("message", e => document.getElementById("told").textContent = e.data);</script>"""


ACCESS = (Path(__file__).parent / "access.js").read_text(encoding="utf-8")


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
    crowded = render(_crowded(loop), Shown(overlays, overlays))
    (folder / "crowded.html").write_text(crowded.replace("</body>", f"{MEASURE}</body>"), encoding="utf-8")
    (folder / "check.html").write_text(_check().replace("</body>", f"{MEASURE}</body>"), encoding="utf-8")
    runs = comparison({"a": loop, "b": report})
    (folder / "compare.html").write_text(runs.replace("</body>", f"{MEASURE}</body>"), encoding="utf-8")
    for name, text in {"report": page, "check": _check(), "compare": runs}.items():
        looked_at = text.replace("</body>", f"<script>{ACCESS}</script></body>")
        (folder / f"{name}-access.html").write_text(looked_at, encoding="utf-8")
    return folder


def _crowded(loop: records.Report) -> records.Report:
    """A run that names four effects, cannot tell two apart, misses something more and says that the model fails."""
    parameters = [("tau", 0.033, "s"), ("x", 0.45, "1/s"), ("y", 0.42, "1/s")]
    of = {"propulsion.motor_lag": parameters[:1], "propulsion.rotor_drag": parameters[1:]}
    of |= {name: [] for name in ("propulsion.rotor_inertia", "propulsion.axial_inflow", "forces.drag")}
    effects = tuple(
        records.EffectRecord(
            id=name,
            role="undeclared",
            verdict="indistinguishable" if k > 2 else "accepted",
            reason="better",
            parameters=tuple(
                records.ParameterRecord(name=f"{name}.{p}", value=v, se=0.03 * v, unit=u) for p, v, u in sizes
            ),
        )
        for k, (name, sizes) in enumerate(of.items())
    )
    unknown = records.UnknownRecord(where="L", band_hz=(0.025, 0.5), goes_with="v", since_s=None, sentence="Missing.")
    verdict = records.VerdictRecord(kind="group", effects=tuple(of), sentence="Undeclared.")
    assert loop.after is not None
    poor = msgspec.structs.replace(loop.after, scores=records.ScoresRecord(identify=0.1, validate=1.5, acid=1.2))
    return msgspec.structs.replace(loop, effects=effects, verdict=verdict, unknown=unknown, after=poor)


def _check() -> str:
    """The page of a check that has something to mend."""
    flight = small_flight()
    flight["p"][100:140] = np.nan
    dataset = Dataset.from_arrays({"f": flight}, identify=["f"])
    about = records.DatasetRecord(name="small", sha256="0" * 64)
    report = records.Report(
        command="check", dataset=about, seed=0, time_s=records.TimeRecord(), peak_memory_mb=1.0, before=None
    )
    return render_check(check(dataset), report, {"kinematics": png(Figure(figsize=(1, 1)))})


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("page", ["report", "check", "compare"])
def test_pages_are_legible_and_reached_by_keyboard_and_reader(place: Path, page: str, scheme: str):
    """WCAG 2.1 AA: contrast of every text, names, focus that is seen, order of headings, heads, alternatives."""
    chosen = f"--blink-settings=preferredColorScheme={int(scheme == 'light')}"
    done = browse(chosen, "--window-size=1440,900", "--dump-dom", (place / f"{page}-access.html").as_uri())
    written = re.search(r'<pre id="told">(.*?)</pre>', done.stdout, re.S)
    assert written is not None
    told = json.loads(html.unescape(written[1]))
    assert told == {
        "faint": [],
        "nameless": [],
        "dead": [],
        "bare": [],
        "skips": 0,
        "lang": "en",
        "dark": scheme == "dark",
    }


def _measured(place: Path, page: str, width: int, height: int) -> dict[str, int]:
    """What the page's script says of it in a window of this size; nothing is said to the console."""
    frame = place / f"frame-{page}-{width}.html"
    frame.write_text(FRAME.format(page, width, height), encoding="utf-8")
    done = browse(f"--window-size={max(width, 500)},{height + 40}", "--dump-dom", frame.as_uri())
    assert [line for line in done.stderr.splitlines() if "CONSOLE" in line] == []
    found = re.search(r'<pre id="told">(.*?)</pre>', done.stdout)
    assert found is not None
    return json.loads(found[1])


def test_controls_share_an_axis_only_with_those_of_their_unit(report: records.Report, tmp_path: Path):
    stick = torch.linspace(0.0, 0.02, 300)
    controls, units = {"lon": stick, "lat": stick, "col": 5.0 * stick}, {"lon": "m", "lat": "m", "col": "norm"}
    page = render(report, Shown([replace(an_overlay("validate"), controls=controls, units=units)]))
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    shown = browse("--dump-dom", (tmp_path / "page.html").as_uri()).stdout
    titles = re.findall(r"Controls, from their start \((\w+)\):(.*?)</div>", shown)
    assert [(unit, re.findall(r" (lon|lat|col) ", names)) for unit, names in titles] == [
        ("m", ["lon", "lat"]),
        ("norm", ["col"]),
    ]


@pytest.mark.parametrize("page", ["page", "crowded"])
@pytest.mark.parametrize(("width", "height"), [(1440, 900), (390, 844)])
def test_the_first_screen_holds_all_of_it_and_nothing_is_wider(place: Path, page: str, width: int, height: int):
    told = _measured(place, page, width, height)
    assert 0 < told["h1"] < told["grades"] <= height
    assert 0 < told["worst"] <= height
    assert 0 < told["picture"] <= height
    assert told["wide"] <= width
    assert told["plots"] >= 3
    caption = re.search(r"\((\w+)\) on (\w+), a flight", (place / f"{page}.html").read_text(encoding="utf-8"))
    assert caption is not None  # the plots begin with the channel and the flight of the picture
    assert told["flight"] == ["dbl_lon_n", "dbl_lat_n", "sweep"].index(caption[2])
    assert told["group"] == next(g for g, channels in GROUPS.items() if caption[1] in channels)


def test_tables_of_words_do_not_scroll_on_a_phone(place: Path):
    for page in ("page", "crowded", "check", "compare"):
        told = _measured(place, page, 390, 844)
        assert (page, told["cut"], told["wide"] <= 390) == (page, 0, True)
        assert page != "check" or 0 < told["steps"] < told["picture"]  # what to mend stands before pictures


def test_print_has_at_most_twelve_sheets(place: Path):
    sheets = place / "page.pdf"
    browse("--no-pdf-header-footer", f"--print-to-pdf={sheets}", (place / "plain.html").as_uri())
    assert 1 <= len(re.findall(rb"/Type\s*/Page[^s]", sheets.read_bytes())) <= 12


@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="pdftotext is not installed")
def test_a_long_headline_is_printed_above_all_else(place: Path, tmp_path: Path):
    browse("--no-pdf-header-footer", f"--print-to-pdf={tmp_path}/page.pdf", (place / "crowded.html").as_uri())
    text = subprocess.run(
        ["pdftotext", "-layout", "page.pdf", "-"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert re.search(r"^ ?The flights show what is not declared", text.stdout, re.M)


@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="pdftotext is not installed")
def test_a_table_s_heads_stand_on_every_sheet(report: records.Report, tmp_path: Path):
    reason = "; ".join(4 * ["it explains no more than it does where nothing is missing"])
    tested = [
        records.EffectRecord(id=f"my.{k}", role="undeclared", verdict="below floor", reason=reason, gain=0.1, floor=1.0)
        for k in range(30)
    ]
    verdict = records.VerdictRecord(kind="nothing undeclared", effects=(), sentence="Nothing undeclared.")
    loop = msgspec.structs.replace(report, effects=tuple(tested), verdict=verdict)
    (tmp_path / "page.html").write_text(render(loop, Shown([], [])), encoding="utf-8")
    browse("--no-pdf-header-footer", f"--print-to-pdf={tmp_path}/page.pdf", (tmp_path / "page.html").as_uri())
    text = subprocess.run(
        ["pdftotext", "-layout", "page.pdf", "-"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    sheets = [sheet for sheet in text.stdout.split("\f") if "my." in sheet]
    assert len(sheets) > 1
    assert all(re.search(r"effect +verdict", sheet) for sheet in sheets)
