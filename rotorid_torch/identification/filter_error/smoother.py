"""What the whole flight says of each state: the smoother behind the extended Kalman filter."""

import torch
from torch import Tensor

from rotorid_torch.core.integrate import step
from rotorid_torch.identification.estimate.sensitivity import controls_at, sample_times, step_ends, step_transitions
from rotorid_torch.identification.estimate.system import by_inputs
from rotorid_torch.identification.filter_error.extended_kalman import FilterProblem, KalmanRun


@torch.no_grad()
def smoothed_states(problem: FilterProblem, psi: Tensor, x0: Tensor, run: KalmanRun) -> tuple[Tensor, Tensor]:
    """States [F, T, nx] and their covariances [F, T, nx, nx] by all samples of a flight, parameters and x0 believed.

    Backwards in the adjoint of the state, so that no covariance is inverted: states without noise have singular ones.

    Source: Bryson and Frazier (1963); Bierman (1973), Automatica 9 (the modified form).
    """
    system, segments = problem.system, problem.segments
    theta, _, R = problem.split(psi)
    u = controls_at(system, theta, problem.records, segments).transpose(0, 1)
    x, P = (segments.take(history).transpose(0, 1) for history in (run.states, run.covariances))  # the last one held
    t, ends = sample_times(segments)[:-1], step_ends(u, problem.records.hold)
    after = step(lambda t, x, u: system.rates(theta, t, x, u), t, x[:-1], *ends, segments.dt)
    before = torch.cat([x0[None], after])
    A = step_transitions(system, theta, t, x[:-1], ends, segments.dt)
    flat = before.flatten(0, 1), u.flatten(0, 1)
    H = by_inputs(lambda x, u: system.output(theta, x, u), *flat)[0].unflatten(0, before.shape[:2])
    present = ~run.innovations.transpose(0, 1).isnan()
    H = torch.where(present.unsqueeze(-1), H, 0.0)
    S = torch.where(segments.inside.mT[..., None, None], run.spreads.transpose(0, 1), torch.eye(H.shape[-2]).to(x))
    R = torch.where(present.unsqueeze(-1) & present.unsqueeze(-2), R, 0.0) + torch.diag_embed((~present).to(x))
    weighed = torch.linalg.solve(S, H)  # S^-1 H
    gain_complement = torch.eye(x.shape[-1]).to(x) - P @ H.mT @ torch.linalg.solve(R, H)  # I - K H
    e = run.innovations.transpose(0, 1).nan_to_num(0.0).unsqueeze(-1)
    adjoint, information = torch.zeros_like(x[0]).unsqueeze(-1), torch.zeros_like(P[0])
    states, covariances = x.clone(), P.clone()
    for k in range(len(x) - 1, -1, -1):
        states[k] = x[k] + (P[k] @ adjoint).squeeze(-1)
        covariances[k] = P[k] - P[k] @ information @ P[k]
        if k == 0:
            break
        adjoint = weighed[k].mT @ e[k] + gain_complement[k].mT @ adjoint
        information = H[k].mT @ weighed[k] + gain_complement[k].mT @ information @ gain_complement[k]
        adjoint, information = A[k - 1].mT @ adjoint, A[k - 1].mT @ information @ A[k - 1]
    return states.transpose(0, 1), covariances.transpose(0, 1)
