"""The search goes on with fits while they gain what matters."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from rotorid_torch.trace.fits import CAREFUL, refit
from rotorid_torch.trace.floor import Floors
from rotorid_torch.trace.search import Search
from tests.trace.hidden_flights import flights, started


def test_fits_go_on_while_they_gain_what_matters_to_each(monkeypatch: pytest.MonkeyPatch):
    known, null = started(flights())
    rough = refit(null.spec, known, {}, options=replace(CAREFUL, max_iterations=1))
    monkeypatch.setattr("rotorid_torch.trace.search.CAREFUL", replace(CAREFUL, max_iterations=1))
    monkeypatch.setattr("rotorid_torch.trace.search.LONGEST", 30)
    search = Search(known, (), Floors({}, ""), lambda line: None, 0)
    on = search.gone_on({"careful": rough, "easy": rough}, {"careful": 0.0, "easy": math.inf})
    assert on["careful"].cost == pytest.approx(null.cost, abs=1.0)
    assert on["careful"].cost + 10.0 < on["easy"].cost < rough.cost
