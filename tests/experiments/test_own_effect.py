"""A user's own effect, as the experiment shows it, is found with its parameters and halves the error."""

from pathlib import Path

import pytest

from tests.experiments.test_experiments import quick

pytest.importorskip("tyro", reason="experiments need the extra 'experiments'")


@pytest.mark.slow
def test_a_fin_that_stalls_is_found_and_helps(tmp_path: Path) -> None:
    result = quick("own_effect", tmp_path)
    assert result["validate"]["with"] < 0.7 * result["validate"]["without"]
    assert set(result["earned"]) == {"my.fin"}
    for name, (value, _) in result["found"].items():
        assert abs(value / result["true"][name] - 1.0) < 0.15
