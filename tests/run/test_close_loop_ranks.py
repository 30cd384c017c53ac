"""The closed loop by several processes: the report of one, a lost one told, the clean aircraft shared."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from rotorid_torch.core.processes.ranks import Ranks
from rotorid_torch.data import load
from rotorid_torch.errors import InputError
from rotorid_torch.report.records import Report, read_report
from rotorid_torch.run.close_loop import close_loop
from rotorid_torch.trace import loop
from rotorid_torch.trace.terms.settings import SETTINGS
from tests.helpers import ROOT
from tests.known_models import flown, manoeuvres, rate_vehicle, with_values, written
from tests.processes import ended, of_ranks, wait_until, write_earlier

DT = 0.04
CANDIDATES = ["control.delay", "control.lag"]
FEW_CANDIDATES = """
import sys
from rotorid_torch import cli
from rotorid_torch.trace import loop
from rotorid_torch.trace.terms.settings import SETTINGS
loop.candidates = lambda spec: (sys.argv[1].split(), [])
sys.exit(cli.main(sys.argv[2:]))
"""
PROGRAM = [sys.executable, "-m", "rotorid_torch", "close-loop"]
DRAWS = """
import json, os, sys
from pathlib import Path
from types import SimpleNamespace
from rotorid_torch.core.storage.cache import cache_folder
from rotorid_torch.core.processes.ranks import ranks_of_torchrun
from rotorid_torch.simulation.drawn import data_sets
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.data import load
from rotorid_torch.trace import clean_aircraft
from rotorid_torch.trace.evidence.critical_values import Null
dataset, worker, seen, told = load(sys.argv[1]), sys.argv[2], float(sys.argv[3]), []
data_sets.undrawable = lambda dataset: None
observed = SimpleNamespace(contest={"control.delay": seen}, least={})
null = Null(propose(dataset, reconstruct(dataset), ()), {})
sys.executable = worker
with ranks_of_torchrun() as ranks:
    request = clean_aircraft.Request(dataset, null, ["control.delay"], say=told.append, ranks=ranks)
    found = clean_aircraft.clean_draws(request, observed)
    statistics = found.statistics["control.delay"].tolist()
files = sorted(int(f.stem) for f in cache_folder().glob("draws/*/[0-9]*.json"))
print(json.dumps({"statistics": statistics, "files": files, "note": found.note, "told": told}))
"""
WORKER = """#!{python}
import json, sys
from pathlib import Path
request = json.loads(Path(sys.argv[3]).read_text())
assert Path(request["dataset"], "dataset.toml").exists()
for n in request["numbers"]:
    found = {{"statistics": {{"control.delay": n / 7.0}}, "alike": n != 5, "effects": ["control.delay"], "sizes": {{}}}}
    part = Path(request["folder"], f"{{n}}.part")
    part.write_text(json.dumps(found))
    part.rename(part.with_suffix(".json"))
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    truth = with_values(rate_vehicle(effects=("control.delay",)), {"control.delay.common": 0.08})
    moves = manoeuvres(6.0, DT)
    both = {**moves, **{f"{name}_again": -0.8 * move for name, move in moves.items()}}
    lists = {"identify": list(moves), "validate": [f"{name}_again" for name in moves]}
    made = flown(truth, both, DT, noise=0.02, seed=3, lists=lists)
    return written(made, tmp_path_factory.mktemp("sets") / "late")


@pytest.fixture(scope="module")
def straight(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Report:
    out = tmp_path_factory.mktemp("straight") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "candidates", lambda spec: (CANDIDATES, []))
        close_loop(load(data), out=out)
    return read_report(out)


def leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Everything in a report but what no two runs share, by its place."""
    if isinstance(value, dict | list | tuple):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            if key not in ("time_s", "peak_memory_mb"):
                yield from leaves(item, f"{place}/{key}")
    else:
        yield place, value


def test_two_ranks_write_the_report_of_one(data: Path, straight: Report, tmp_path: Path):
    program = [sys.executable, "-c", FEW_CANDIDATES, " ".join(CANDIDATES), "close-loop"]
    codes, told, errors = ended(of_ranks(2, [*program, str(data), "--out", str(tmp_path / "run")]))
    assert codes == [0, 0], errors
    assert errors == ["", ""]
    assert "report:" in told[0]
    assert told[1] == ""
    got, wanted = (dict(leaves(msgspec.to_builtins(r))) for r in (read_report(tmp_path / "run"), straight))
    assert got.keys() == wanted.keys()
    for place, value in wanted.items():
        if isinstance(value, float) and isinstance(got[place], float):
            assert math.isclose(got[place], value, rel_tol=1e-9, abs_tol=1e-12), place
        else:
            assert got[place] == value, place
    assert straight.verdict is not None
    assert straight.verdict.effects == ("control.delay",)
    log = (tmp_path / "run" / "log.txt").read_text(encoding="utf-8")
    assert all(
        f"{candidate}: log-likelihood gain" in log for candidate in CANDIDATES
    )  # two full fits, one at each rank
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize("lost", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_a_lost_rank_ends_the_loop_with_one_line(data: Path, tmp_path: Path, lost: int):
    out = tmp_path / "run"
    write_earlier(out)
    before = (out / "report.json").read_bytes()
    processes = of_ranks(2, [*PROGRAM, str(data), "--out", str(out), "--quiet"])
    wait_until(lambda: any("reconstruct:" in log.read_text() for log in tmp_path.glob(".run.*.partial/log.txt")))
    processes[lost].kill()
    codes, _, errors = ended(processes)
    assert codes[1 - lost] == 1
    assert errors[1 - lost].count("\n") == 1
    assert "a process of this run is lost" in errors[1 - lost]
    assert (out / "report.json").read_bytes() == before


@pytest.mark.slow
def test_what_all_ranks_refuse_is_told_once(tmp_path: Path):
    codes, _, errors = ended(of_ranks(2, [*PROGRAM, str(tmp_path / "none"), "--out", str(tmp_path / "run")]))
    assert codes == [2, 2]
    assert "".join(errors).count("\n") == 1
    assert "there is no such folder" in "".join(errors)
    assert not list(tmp_path.iterdir())


def test_more_ranks_than_flights_are_refused(data: Path):
    with pytest.raises(InputError, match="started 5 processes; expected 4 at most for 4 flights"):
        close_loop(load(data), ranks=Ranks(0, 5))


def test_ranks_without_a_common_disk_share_the_draws_and_find_the_same(data: Path, tmp_path: Path):
    worker = tmp_path / "worker"
    worker.write_text(WORKER.format(python=sys.executable))
    worker.chmod(0o755)
    command = [sys.executable, "-c", DRAWS, str(data), str(worker), "1e3"]
    caches = [tmp_path / "first", tmp_path / "second"]
    found = together(command, caches)
    wanted = [n / 7.0 for n in range(SETTINGS.draws)]
    assert [f["statistics"] for f in found] == [wanted, wanted]
    assert f"{SETTINGS.draws} clean aircraft" in found[0]["note"]
    assert f"of which {SETTINGS.draws - 1} resemble it" in found[0]["note"]
    assert set(found[0]["files"]) >= set(range(SETTINGS.draws))  # the first keeps what all have found
    assert found[1]["files"] == []
    again = together(command, caches)
    assert [f["told"] for f in again] == [[], []]  # nobody flies anything: what the first has kept counts for all
    assert [f["statistics"] for f in again] == [wanted, wanted]
    fewer = together([*command[:-1], "0.0"], caches)  # draws that are clear count as if no others had been kept
    assert [f["statistics"] for f in fewer] == [wanted[: SETTINGS.earliest]] * 2


def together(command: list[str], caches: list[Path]) -> list[dict[str, Any]]:
    """What two processes with these caches print."""
    place = {"PYTHONPATH": str(ROOT), "ROTORID_THREADS": "1"}
    codes, told, errors = ended(of_ranks(2, command, *[{**place, "ROTORID_CACHE": str(c)} for c in caches]))
    assert codes == [0, 0], errors
    return [json.loads(said) for said in told]
