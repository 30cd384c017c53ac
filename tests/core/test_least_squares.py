"""Least squares against NumPy: any rank, in batches, and where LAPACK gives up."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from rotorid_torch.core.least_squares import least_squares


def problems(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Three of them [3, 12, 5] and [3, 12, 2], one of full rank, one of rank 4, one of nothing."""
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((3, 12, 5)), rng.standard_normal((3, 12, 2))
    A[1, :, 4] = A[1, :, 0] - A[1, :, 1]
    A[2] = 0.0
    return A, B


def by_numpy(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    return np.stack([np.linalg.lstsq(a, b, rcond=None)[0] for a, b in zip(A, B, strict=True)])


@pytest.mark.parametrize("seed", range(3))
def test_the_shortest_solution_of_any_rank(seed: int) -> None:
    A, B = problems(seed)
    np.testing.assert_allclose(least_squares(torch.from_numpy(A), torch.from_numpy(B)), by_numpy(A, B), atol=1e-12)


@pytest.mark.parametrize("lost", [math.nan, math.inf])
@pytest.mark.parametrize("side", [0, 1])
def test_what_is_not_finite_has_no_solution_and_spoils_no_other(lost: float, side: int) -> None:
    A, B = problems(0)
    wanted = by_numpy(A, B)
    (A, B)[side][1, 3, 1] = lost
    found = least_squares(torch.from_numpy(A), torch.from_numpy(B))
    assert bool(found[1].isnan().all())
    np.testing.assert_allclose(found[::2], wanted[::2], atol=1e-12)


def test_singular_values_that_do_not_converge_are_found_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which of them do is the library's; heavy damping makes hundreds that are equal."""
    whole = torch.linalg.lstsq

    def stubborn(A: Tensor, B: Tensor, *, rcond: float | None, driver: str) -> object:
        if driver == "gelsd":
            raise torch.linalg.LinAlgError("error code: 1")  # pyright: ignore[reportPrivateImportUsage]
        return whole(A, B, rcond=rcond, driver=driver)

    A, B = problems(0)
    monkeypatch.setattr(torch.linalg, "lstsq", stubborn)
    np.testing.assert_allclose(least_squares(torch.from_numpy(A), torch.from_numpy(B)), by_numpy(A, B), atol=1e-12)
