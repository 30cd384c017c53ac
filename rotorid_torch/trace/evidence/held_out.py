"""Evidence for a candidate: how much better it predicts flights that its size was not estimated from.

The fitted model M0 and the model with the candidate, M0 + e, are nested. Both are linear about M0: the whitened
residual of a flight f is r_f - X_f theta - S_f a, with the signatures S_f of the candidate at sizes a. The evidence of
a flight is the difference of log scores per sample, the scale of the flight's residuals in each response r being its
best value,

    d_f = mean over r of log((rms^2 of r_f under M0 + s_r^2) / (rms^2 of r_f under M0 + e + s_r^2))/2,

both estimated without flight f, in closed form from the normal equations of the flights: flights that no fit has seen
are scored with the estimates of all fitted flights, each fitted flight with the estimates of the others. With scales of
their own no flight and no response outweighs the others: without the one flight that moves a control, little is known
of that control, and its residuals are large. What a flight leaves alone counts little where s_r is the usual rms of the
response. `FittedAtStates.log_ratios` of fits in full has the same form, with the rms under M0 + e as s_r.

Source: Beirami et al., NeurIPS 2017; Rad and Maleki, J. R. Statist. Soc. B 82 (2020), approximate leave-one-out;
Vuong, Econometrica 57 (1989), the likelihood ratio of two models flight by flight.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from rotorid_torch.core.least_squares import bounded_least_squares


@dataclass(frozen=True, eq=False)
class FlightEquations:
    """Normal equations of each flight about a fitted model, initial states and biases eliminated.

    fitted : [F, R, n, n] flights of the fit, by response. unseen : [V, R, n, n] flights that no fit has seen, none
    where V = 0; zeros of a response that was not measured, or where the fitted model flies away: no evidence.
    prior : [n, n] of the parameters. count : number P of the model's parameters, which are the first columns; the
    signatures of candidates follow, and the last of the n columns are residuals: that of the data, and of so many of
    the same colour that know nothing of the motion. usual : [F + V, R or 1] squares s_r^2 of so many samples as the
    flight has, where a response that a flight leaves alone shall count little; None where s_r = 0.
    """

    fitted: Tensor
    unseen: Tensor
    prior: Tensor
    count: int
    residuals: int = 1
    usual: Tensor | None = None

    @classmethod
    def of(
        cls, fitted: Tensor, unseen: Tensor, prior: tuple[Tensor, Tensor], residuals: int, usual: Tensor | None = None
    ) -> FlightEquations:
        """With the prior of the parameters as rows [m, P], and what the residual is in these [m]."""
        rows, remainder = prior
        whole = rows.new_zeros(len(rows), fitted.shape[-1])
        whole[:, : rows.shape[1]], whole[:, -residuals] = rows, remainder
        return cls(fitted, unseen, whole.mT @ whole, rows.shape[1], residuals, usual)

    @cached_property
    def _total(self) -> Tensor:
        """Of all fitted flights with the prior [n, n]."""
        return self.fitted.sum((0, 1)) + self.prior

    @cached_property
    def _passed(self) -> Tensor:
        return eliminating(self._total, self.count)

    @cached_property
    def total(self) -> Tensor:
        """Of all fitted flights without the model's parameters [n - P, n - P]."""
        return self._passed.mT @ self._total @ self._passed

    def imitating(self, column: int) -> Tensor:
        """Size of each parameter's part in the imitation of a signature [P]."""
        return -self._passed[: self.count, column] * self._total.diagonal()[: self.count].clamp_min(1e-300).sqrt()

    @cached_property
    def _reduced(self) -> tuple[Tensor, Tensor]:
        """Normal equations without the model's parameters: to estimate from [F + V, m, m], to score [F + V, R, m, m].

        The model's parameters follow the sizes of the signatures, as least squares of the flights that estimate.
        """
        others = self._total - self.fitted.sum(1) if len(self.fitted) > 1 else self.fitted[:0].sum(1)
        passed = eliminating(others, self.count)
        by_all = self.total.expand(len(self.unseen), -1, -1)
        scored = [passed.mT[:, None] @ self.fitted[: len(others)] @ passed[:, None]]
        scored.append(self._passed.mT @ self.unseen @ self._passed)
        return torch.cat([passed.mT @ others @ passed, by_all]), torch.cat(scored)

    def held_out(self, columns: list[int], low: Tensor, high: Tensor, residual: int = 0) -> Tensor:
        """Evidence d_f [F + V] of signatures; F is 0 where a single flight was fitted.

        columns : of the signatures, counted behind the parameters. low, high : [K] bounds of their sizes.
        residual : which of the residuals.
        """
        estimating, scored = self._reduced
        if not columns or not len(scored):
            return torch.zeros(len(scored), dtype=torch.float64)
        last = scored.shape[-1] - self.residuals + residual
        G, d = estimating[:, columns][:, :, columns], estimating[:, columns, last]
        sizes = torch.stack([bounded_least_squares(one, right, low, high) for one, right in zip(G, d, strict=True)])
        curvature = scored[..., columns, :][..., columns]
        fall = 2.0 * torch.einsum("fi,fri->fr", sizes, scored[..., columns, last])
        fall = fall - torch.einsum("fi,frij,fj->fr", sizes, curvature, sizes)
        return -self._mean_log(-fall, scored[..., last, last], self._usual)

    def expected(self, column: int, size: float) -> float:
        """Sum of d_f that a signature of a size gives, its residual standing at right angles to what is left."""
        scored, last = self._reduced[1], -self.residuals
        more, squares = size**2 * scored[..., column, column], scored[..., last, last]
        raised = 1.0 + more / squares.clamp_min(1e-300)  # what is missing raises the usual residuals as well
        return float(self._mean_log(more, squares, self._usual * raised).sum())

    @property
    def _usual(self) -> Tensor:
        """Of the flights that are scored [F + V, R or 1]."""
        return self.unseen.new_zeros(1, 1) if self.usual is None else self.usual[-len(self._reduced[1]) :]

    @staticmethod
    def _mean_log(more: Tensor, squares: Tensor, usual: Tensor) -> Tensor:
        """Mean over the measured responses of log(1 + more / (squares + usual))/2, of squares of residuals [F, R].

        A signature that is not finite is no evidence.
        """
        ratio = more / (squares + usual).clamp_min(1e-300)
        logs = 0.5 * torch.log1p(ratio.clamp_min(-1.0 + 1e-15)).nan_to_num(nan=0.0)
        measured = squares > 0.0
        return (logs * measured).sum(1) / measured.sum(1).clamp_min(1)


def eliminating(total: Tensor, count: int) -> Tensor:
    """Matrices [..., n, n - P] that put in place of the first P columns what least squares leave of the others."""
    scale = total.diagonal(dim1=-2, dim2=-1)[..., :count, None].clamp_min(1e-300).sqrt()
    inverse = torch.linalg.pinv(total[..., :count, :count] / scale.mT / scale, hermitian=True)
    solved = inverse @ (total[..., :count, count:] / scale)
    identity = torch.eye(total.shape[-1] - count, dtype=torch.float64).expand(*total.shape[:-2], -1, -1)
    return torch.cat([-solved / scale, identity], dim=-2)
