"""The documentation builds, its links lead somewhere, its code runs, its sentences are short, its figures hold."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import rotorid_torch as rotorid
from rotorid_torch import cli
from rotorid_torch.data.declare import declare
from rotorid_torch.effects import registry
from rotorid_torch.effects.registry import ENTRY_POINTS, registered
from rotorid_torch.importing.signals.mapping import read_map
from tests.docs.logs import write_logs
from tests.docs.validated import ROOT, ROWS, Row, table
from tests.helpers import shared
from tests.known_models import flown, manoeuvres, rate_vehicle, written

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
BLOCK = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.M | re.S)
LONGEST, MEAN, FORMULAS = 40, 15, 60
QUICK = {"check", "doctor", "effects", "export", "import", "show", "simulate"}
"""Commands that the pages' examples are run with; the others are parsed."""
RUN_ELSEWHERE = {"own-network.md": "tests/model/training/test_page.py"}
"""Pages whose Python needs another vehicle, and the test that runs it."""


def identifier(page: Path) -> str:
    return str(page.relative_to(ROOT))


def blocks(page: Path, language: str) -> list[str]:
    return [text for kind, text in BLOCK.findall(page.read_text(encoding="utf-8")) if kind == language]


def commands(page: Path) -> list[list[str]]:
    """Every rotorid command of a page's sh blocks, as words; under torchrun too."""
    lines = [line for text in blocks(page, "sh") for line in text.splitlines()]
    lines = [re.sub(r"^torchrun .* -m rotorid_torch ", "rotorid ", line) for line in lines]
    return [shlex.split(line, comments=True) for line in lines if line.startswith("rotorid ")]


WITH_PYTHON = [p for p in (ROOT / "README.md", *PAGES) if blocks(p, "python") and p.name not in RUN_ELSEWHERE]
WITH_COMMANDS = [p for p in (ROOT / "README.md", *PAGES) if commands(p)]


@pytest.fixture(scope="session")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as the pages have it: the data set `flights`, its `run`, and two logs of a drone."""
    place = tmp_path_factory.mktemp("docs")
    write_logs(place)
    lists = {"identify": ["f_lon", "f_lat", "f_col"], "validate": ["f_ped"], "acid": ["sweep_col"]}
    controls = manoeuvres(9.0, 0.04)
    data = flown(rate_vehicle(), controls | {"sweep_col": -controls["f_col"]}, 0.04, noise=0.02, lists=lists)
    flights = written(data, place / "flights")
    toml = flights / "dataset.toml"
    toml.write_text(re.sub(r'^name = ".*"', 'name = "flights"', toml.read_text(), flags=re.M))
    rotorid.identify(rotorid.load(flights), out=place / "run")
    for name in ("run-loop", "drone-run"):
        shutil.copytree(place / "run", place / name)
    rotorid.export(place / "run", fmu=place / "model.fmu", onnx=place / "model.onnx", statespace=place / "model.json")
    return place


def test_the_site_builds_and_every_link_leads_somewhere(tmp_path: Path):
    pytest.importorskip("mkdocs")
    words = [
        sys.executable,
        "-W",
        "ignore",
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "-d",
        str(tmp_path / "site"),
    ]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "rotorid.identify" in (tmp_path / "site" / "reference" / "api" / "index.html").read_text()
    assert "--statespace" in (tmp_path / "site" / "reference" / "commands" / "index.html").read_text()


@pytest.mark.parametrize("page", WITH_PYTHON, ids=identifier)
@pytest.mark.filterwarnings("ignore")
def test_python_of_a_page_runs(page: Path, workplace: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(workplace)
    monkeypatch.setattr(registry, "EFFECTS", dict(registry.EFFECTS))
    variables: dict[str, object] = {"__name__": "docs"}
    for text in blocks(page, "python"):
        with contextlib.redirect_stdout(io.StringIO()):
            exec(compile(text, identifier(page), "exec"), variables)


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=identifier)
def test_commands_of_a_page_run(page: Path, workplace: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(workplace)
    for words in commands(page):
        cli.parser().parse_args(words[1:])
        if words[1] in QUICK:
            assert cli.main([*words[1:], "--quiet"]) == 0, shlex.join(words)


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_COMMANDS, ids=identifier)
def test_long_commands_of_a_page_run(page: Path, workplace: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(workplace)
    for words in commands(page):
        flown_already = words[1] == "fly" and Path(words[words.index("--out") + 1]).exists()
        if words[1] not in {"effects", "show"} and not flown_already:
            assert cli.main([*words[1:], "--quiet"]) == 0, shlex.join(words)


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "toml")], ids=identifier)
def test_declarations_of_a_page_are_read(page: Path):
    least = {"format": 1, "name": "any", "kind": "multirotor", "flights": {"identify": ["f"]}}
    for text in blocks(page, "toml"):
        document = tomllib.loads(text)
        if "project" in document:
            assert list(document["project"]["entry-points"]) == [ENTRY_POINTS]
        elif "time" in document:
            read_map(document)
        else:
            assert declare(least | document, page).warnings == ()


def test_what_is_said_of_a_log_is_what_the_commands_print(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    log = shared("flightdata", "logs", "px4-quad-sdlog2.px4log")
    (text,) = [text for text in blocks(DOCS / "import.md", "text") if text.startswith("$ ")]
    monkeypatch.chdir(tmp_path)
    shutil.copy(log, tmp_path)
    for said in text.split("$ rotorid ")[1:]:
        words, _, expected = said.partition("\n")
        assert cli.main(shlex.split(words)) in (0, 3)  # 3: `check` says that it is not usable
        printed = capsys.readouterr()
        assert {*expected.splitlines()} <= {*printed.out.splitlines(), *printed.err.splitlines()}


def test_pages_that_run_elsewhere_do():
    for page, test in RUN_ELSEWHERE.items():
        assert page in (ROOT / test).read_text(encoding="utf-8")


def test_c_of_the_export_page_compiles(workplace: Path, tmp_path: Path):
    folder = rotorid.export(workplace / "run", c=tmp_path / "c")["c"]
    (text,) = blocks(DOCS / "guide" / "export.md", "c")
    (folder / "use.c").write_text(text)
    subprocess.run(["gcc", "-std=c99", "-Wall", "-Werror", "-c", "use.c", "flights.c"], cwd=folder, check=True)


def sentences(page: Path) -> list[int]:
    """Words of each sentence, without code and tables."""
    text = re.sub(
        r"```.*?```|^\|[^\n]*$|<!--.*?-->|\$\$.*?\$\$", "", page.read_text(encoding="utf-8"), flags=re.S | re.M
    )
    parts = re.split(r"(?<=[.!?])\s+|\n\s*\n|\n[-#*] |\n\d+\. ", text)
    return [len(part.split()) for part in parts if len(part.split()) > 3]


@pytest.mark.parametrize("page", PAGES, ids=identifier)
def test_sentences_are_short(page: Path):
    assert max(sentences(page), default=0) <= LONGEST


def test_sentences_are_short_in_the_mean_and_models_have_equations():
    words = [n for page in PAGES for n in sentences(page)]
    assert sum(words) / len(words) <= MEAN
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert text.count("$$") // 2 + len(re.findall(r"(?<!\$)\$[^$\n]+\$", text)) >= FORMULAS


def test_every_effect_has_its_equation():
    text = (DOCS / "theory" / "effects.md").read_text(encoding="utf-8")
    assert [name for name in registered() if f"`{name}`" not in text] == []


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_a_claim_is_a_test_with_its_numbers(row: Row):
    numbers = re.findall(r"\d[\d.]*(?:e-?\d+)?", row.within)
    assert [number for number in numbers if number not in row.source] == []


def test_the_table_of_claims_stands_in_the_docs_and_in_short_in_the_readme():
    assert table(ROWS) in (DOCS / "validated.md").read_text(encoding="utf-8")
    assert table([row for row in ROWS if row.short]) in (ROOT / "README.md").read_text(encoding="utf-8")
