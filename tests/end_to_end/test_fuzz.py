"""Damaged logs, tables, data sets, models and reports: what `tests.fuzzing` demands of every answer.

The examples are always the same few; `--hypothesis-profile many` draws many others;
`experiments/studies/fuzz.py` counts.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from tests.fuzzing import KINDS, LOGS, judged
from tests.helpers import ROOT

MANY = settings.default is not None and settings.default.max_examples > 100
QUICK = {**dict.fromkeys(LOGS, 25), "report": 40, "model": 10, "check": 15}
"""Examples of a run in which nobody asks for many."""


def examples(few: int) -> settings:
    """So many examples, or those of the profile; seeds are not shrunk, a smaller one is no smaller damage."""
    number = settings.default.max_examples if MANY and settings.default else few
    unhurried = [HealthCheck.too_slow, HealthCheck.function_scoped_fixture]
    return settings(max_examples=number, phases=[Phase.generate], suppress_health_check=unhurried)


@pytest.mark.parametrize("kind", [*QUICK, pytest.param("identify", marks=pytest.mark.slow)])
def test_whatever_the_damage(kind: str):
    @examples(QUICK.get(kind, 10))
    @given(seed=st.integers(0, 2**31))
    def every(seed: int) -> None:
        damage, answer = judged(kind, seed)
        assert not answer.fault, f"{damage.what}: {answer.fault}"

    every()


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("check", "identify")])
def test_in_a_process_of_its_own(kind: str):
    """What a reader of another library does to the process is seen only from outside."""
    code = "import sys; from tests.fuzzing import judged\n"
    code += "for seed in range(1000, 1020): assert not judged(sys.argv[1], seed)[1].fault, seed"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code, kind], env=environment, check=True, timeout=300)
