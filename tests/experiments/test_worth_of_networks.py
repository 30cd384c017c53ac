"""Physics against networks: what the network alone is made of, and the table."""

import json
from importlib import import_module
from pathlib import Path

import pytest

from rotorid_torch.effects.examples import HELICOPTER
from rotorid_torch.model.nominal import build

pytest.importorskip("tyro", reason="experiments need the extra 'experiments'")
pytest.importorskip("torch.utils.tensorboard")


def test_the_network_alone_has_trims_and_weights_and_nothing_else() -> None:
    module = import_module("worth_of_networks")
    free = build(module.alone(HELICOPTER, 0.5)).parameter_set.free
    assert {n for n in free if not n.startswith("neural.alone.")} == {f"forces.{row}.trim" for row in "XYZLMN"}
    weights = 12 * (1 + 6 + len(HELICOPTER.controls)) + 6 * 12
    assert len(free) == 6 + weights


def test_scores_become_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    module = import_module("worth_of_networks")
    scores = {"identify": 0.13, "validate": 0.5, "acid": None}
    line = {"model": "physics", "free": 90, "effects": ["rotor.lead_lag"], "J": scores, "seconds": 61.2}
    result = {"data": "mine", "models": [line | {"noise": {"identify": 0.05, "validate": 0.3, "acid": None}}]}
    (tmp_path / "scores.json").write_text(json.dumps(result))
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- hybrid: begin -->\n<!-- hybrid: end -->\nafter\n")
    module.main(module.Args(report=True, page=page, out=tmp_path))
    assert "| physics | 90 | rotor.lead_lag | 0.130 | 0.120 | 0.500 | 0.400 |  |  | 61 |" in page.read_text()
    assert json.loads(capsys.readouterr().out) == result
