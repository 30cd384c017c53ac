"""Estimators against data and answers that others have published: certified regressions, kinetics, a river, a fall.

NIST Statistical Reference Datasets (itl.nist.gov/div898/strd) certify eleven digits of nonlinear least squares; here
each model is a differential equation or an output. Residuals weigh alike, so the noise is held at the unit matrix.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import rotorid_torch as rotorid


class Law(nn.Module):
    """dx/dt = rate(x, b), y = output(x, u, b) with parameters b[i]."""

    def __init__(self, start: Sequence[float], rate: Callable[..., Tensor], output: Callable[..., Tensor]) -> None:
        super().__init__()
        self.b = nn.Parameter(torch.tensor(start, dtype=torch.float64))
        self._rate, self._output = rate, output

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return self._rate(x, self.b)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return self._output(x, u, self.b)


def state(x: Tensor, u: Tensor, b: Tensor) -> Tensor:
    return x


def still(x: Tensor, b: Tensor) -> Tensor:
    return 0.0 * x * b[..., :1]


def saturating(x: Tensor, b: Tensor) -> Tensor:
    """y = b0 (1 - exp(-b1 t)), from y = 0."""
    return b[..., 1:2] * (b[..., 0:1] - x)


def observed(time: Sequence[float], outputs: Any, step: float, x0: Sequence[float]) -> dict[str, Any]:
    """A record on an even grid from 0 on, with observations at some of its times."""
    outputs = np.asarray(outputs, float).reshape(len(time), -1)
    grid = np.full((round(max(time) / step) + 1, outputs.shape[1]), np.nan)
    grid[np.rint(np.asarray(time) / step).astype(int)] = outputs
    return {"time": step * np.arange(len(grid)), "controls": np.zeros((len(grid), 0)), "outputs": grid, "x0": x0}


def close(parameter: Any, certified: float) -> bool:
    """Whether an estimate is within a hundredth of its standard error, where the search ends, of a certified value."""
    return abs(parameter.value - certified) < 0.01 * parameter.se_white


def static(inputs: Sequence[float], outputs: Sequence[float]) -> dict[str, Any]:
    """A record of observations whose inputs are a control, one a second."""
    return observed(range(len(outputs)), outputs, 1.0, [0.0]) | {"controls": np.array(inputs)[:, None]}


def fitted(law: Law, flights: Sequence[dict[str, Any]], outputs: int = 1, x0: str = "fixed") -> tuple[Any, float]:
    """Estimate with equal weights over whole flights, and the sum of squares of its residuals."""
    found = rotorid.output_error(
        law, flights, x0=x0, noise="diagonal" if outputs == 1 else torch.eye(outputs), segment_lengths=[math.inf]
    )
    return found, sum(float(r.nan_to_num().square().sum()) for r in found.residuals)


def test_rat42_growth_of_pasture_with_its_first_weight_free():
    """NIST Rat42, y = b1 / (1 + exp(b2 - b3 t)): a logistic equation, whose b2 is the state at 0."""
    time = (9, 14, 21, 28, 42, 57, 63, 70, 79)
    weights = (8.930, 10.800, 18.590, 22.330, 39.350, 56.110, 61.730, 64.620, 67.080)
    law = Law([100.0, 0.05], lambda x, b: b[..., 1:2] * x * (1.0 - x / b[..., 0:1]), state)
    found, squares = fitted(law, [observed(time, weights, 1.0, [5.0])], x0="free")
    assert close(found["b[0]"], 72.462237576)
    assert close(found["b[1]"], 0.067359200066)
    at_zero = math.log(found["b[0]"].value / float(found.initial_states[0, 0]) - 1.0)
    assert at_zero == pytest.approx(2.6180768402, abs=0.01 * 0.088295217536)
    assert squares == pytest.approx(8.0565229338, rel=1e-4)
    assert found["b[0]"].se_white == pytest.approx(1.7340283401, rel=0.01)
    assert found["b[1]"].se_white == pytest.approx(0.0034465663377, rel=0.01)


def test_boxbod_oxygen_demand():
    """NIST BoxBOD, y = b1 (1 - exp(-b2 t)), from its nearer start."""
    law = Law([100.0, 0.75], saturating, state)
    found, squares = fitted(law, [observed((1, 2, 3, 5, 7, 10), (109, 149, 149, 191, 213, 224), 0.25, [0.0])])
    assert close(found["b[0]"], 213.80940889)
    assert close(found["b[1]"], 0.54723748542)
    assert squares == pytest.approx(1168.0088766, rel=1e-4)
    assert found["b[0]"].se_white == pytest.approx(12.354515176, rel=0.01)
    assert found["b[1]"].se_white == pytest.approx(0.10455993237, rel=0.01)


def test_misra1a_adsorption_by_an_output_alone():
    """NIST Misra1a, y = b1 (1 - exp(-b2 x)), with the pressure x as a control."""
    pressures = (77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0)
    volumes = (10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78)
    law = Law([250.0, 5e-4], still, lambda x, u, b: b[..., 0:1] * (1.0 - torch.exp(-b[..., 1:2] * u)) + 0.0 * x)
    found, squares = fitted(law, [static(pressures, volumes)])
    assert close(found["b[0]"], 238.94212918)
    assert close(found["b[1]"], 5.5015643181e-4)
    assert squares == pytest.approx(0.12455138894, rel=1e-4)
    assert found["b[0]"].se_white == pytest.approx(2.7070075241, rel=0.01)
    assert found["b[1]"].se_white == pytest.approx(7.2668688436e-06, rel=0.01)


def test_danwood_radiated_energy_by_an_output_alone():
    """NIST DanWood, y = b1 x^b2, with x as a control."""
    temperatures, energies = (1.309, 1.471, 1.490, 1.565, 1.611, 1.680), (2.138, 3.421, 3.597, 4.340, 4.882, 5.660)
    law = Law([1.0, 5.0], still, lambda x, u, b: b[..., 0:1] * u ** b[..., 1:2] + 0.0 * x)
    found, squares = fitted(law, [static(temperatures, energies)])
    assert close(found["b[0]"], 0.76886226176)
    assert close(found["b[1]"], 3.8604055871)
    assert squares == pytest.approx(4.3173084083e-03, rel=1e-4)


def test_isomerisation_of_pinene():
    """Box, Hunter, MacGregor and Erjavec, Technometrics 15 (1973): five rates; 19.872 by the COPS benchmark."""
    time = (1230, 3060, 4920, 7800, 10680, 15030, 22620, 36420)  # minutes
    shares = (
        (88.35, 76.4, 65.1, 50.4, 37.5, 25.9, 14.0, 4.5),
        (7.3, 15.6, 23.1, 32.9, 42.7, 49.1, 57.4, 63.1),
        (2.3, 4.5, 5.3, 6.0, 6.0, 5.9, 5.1, 3.8),
        (0.4, 0.7, 1.1, 1.5, 1.9, 2.2, 2.6, 2.9),
        (1.75, 2.8, 5.8, 9.3, 12.0, 17.0, 21.0, 25.7),
    )

    def rate(x: Tensor, b: Tensor) -> Tensor:
        pinene, _, third, _, dimer = x.unbind(-1)
        first, second, fourth, fifth, back = b.unbind(-1)  # 1e-5 per minute, times 30 minutes
        ends = [-(first + second) * pinene, first * pinene, second * pinene - (fourth + fifth) * third + back * dimer]
        return 3e-4 * torch.stack([*ends, fourth * third, fifth * third - back * dimer], dim=-1)

    flight = observed([t / 30.0 for t in time], np.array(shares).T, 1.0, [100.0, 0.0, 0.0, 0.0, 0.0])
    found, squares = fitted(Law([5.0, 2.0, 2.0, 20.0, 3.0], rate, state), [flight], outputs=5)
    assert squares == pytest.approx(19.872, abs=5e-4)
    published = (5.9256, 2.9634, 2.0450, 27.473, 4.0073)
    errors = np.array([p.se_white for p in found.parameters]) * math.sqrt(squares / (40 - 5))
    assert np.all(np.abs(found.model.b.detach().numpy() - published) < 0.05 * errors)


NILE = np.array(
    """
    1120 1160 963 1210 1160 1160 813 1230 1370 1140 995 935 1110 994 1020 960 1180 799 958 1140
    1100 1210 1150 1250 1260 1220 1030 1100 774 840 874 694 940 833 701 916 692 1020 1050 969
    831 726 456 824 702 1120 1100 832 764 821 768 845 864 862 698 845 744 796 1040 759
    781 865 845 944 984 897 822 1010 771 676 649 846 812 742 801 1040 860 874 848 890
    744 749 838 1050 918 986 797 923 975 815 1020 906 901 1170 912 746 919 718 714 740
    """.split(),
    dtype=float,
)[:, None]
"""Volume at Aswan by year, 1871 to 1970 (Cobb 1978); the local level model of Durbin and Koopman, Time Series Analysis
by State Space Methods, ch. 2: variances 15099 of the observation and 1469.1 of the level a year."""


def test_nile_level_by_the_unscented_filter():
    """Log likelihood -641.5856 with a first variance of 1e7, as Durbin and Koopman begin."""
    found = rotorid.unscented_filter(
        lambda x, u: 0.0 * x, lambda x, u: x, [0.0], [[1e7]], [[1469.1]], [[15099.0]], np.zeros((100, 0)), NILE, 1.0
    )
    assert float(found.log_likelihood) == pytest.approx(-641.5856, abs=1e-4)
    assert float(found.means[-1, 0]) == pytest.approx(798.370, abs=1e-3)


def test_nile_variances_by_filter_error():
    law = Law([1.0], still, state)
    flight = {"time": np.arange(100.0), "controls": np.zeros((100, 0)), "outputs": NILE, "x0": [1120.0]}
    found = rotorid.filter_error(law, [flight])
    assert found.process_noise[0].value == pytest.approx(math.sqrt(1469.1), abs=0.05 * found.process_noise[0].se)
    assert float(found.noise) == pytest.approx(15099.0, rel=0.03)  # by 100 - 2 years


def test_a_body_that_falls_through_the_air_by_the_unscented_filter():
    """Athans, Wishner and Bertolini (1968); Julier and Uhlmann (2004): height, speed, ballistic coefficient by range.

    Feet and seconds; the radar sees once a second. The squared errors over their covariance must be those of a filter
    that is right: their mean over 40 falls has a chi-square distribution.
    """
    step, falls, seconds = 0.125, 40, 40
    rng = np.random.default_rng(5)

    def fall(x: Any, u: Any, lib: Any = torch) -> Any:
        height, speed, drag = x[..., 0], x[..., 1], x[..., 2]
        rates = [-speed, -lib.exp(-5e-5 * height) * speed**2 * drag, 0.0 * drag]
        return torch.stack(rates, dim=-1) if lib is torch else np.stack(rates, axis=-1)

    spread = np.array([1e3, 2e3, 1e-2]) * np.array([0.3, 0.3, 0.01])
    truth = np.empty((falls, int(seconds / step) + 1, 3))
    truth[:, 0] = np.array([3e5, 2e4, 1e-3]) + spread * rng.standard_normal((falls, 3))
    for k in range(truth.shape[1] - 1):
        x, fine = truth[:, k], step / 8
        for _ in range(8):
            a = fall(x, None, np)
            b = fall(x + fine / 2 * a, None, np)
            c = fall(x + fine / 2 * b, None, np)
            x = x + fine / 6 * (a + 2 * b + 2 * c + fall(x + fine * c, None, np))
        truth[:, k + 1] = x
    ranges = np.hypot(1e5, truth[..., :1] - 1e5) + 100.0 * rng.standard_normal((*truth.shape[:2], 1))
    ranges[:, np.arange(ranges.shape[1]) % 8 != 0] = np.nan
    found = rotorid.unscented_filter(
        fall,
        lambda x, u: torch.sqrt(1e10 + (x[..., :1] - 1e5) ** 2),
        [3e5, 2e4, 1e-3],
        np.diag(spread**2),
        np.zeros((3, 3)),
        [[1e4]],
        np.zeros((falls, ranges.shape[1], 0)),
        ranges,
        step,
        smooth=False,
    )
    error = torch.as_tensor(truth[:, -1]) - found.means[:, -1]
    nees = torch.einsum("fi,fij,fj->f", error, torch.linalg.inv(found.covariances[:, -1]), error)
    assert 0.699 < float(nees.mean()) / 3 < 1.364  # chi-square of 120, 99 of 100 times
