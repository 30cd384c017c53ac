"""Maximum likelihood in stages: short segments first, longer ones as far as the vehicle's stability allows."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import Minimum, Options, Region, minimise
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.identification.estimate.engine import Engine, Part, engine_for
from rotorid_torch.identification.estimate.initial_states import filled, fitted_states, roughness, smallest_noise
from rotorid_torch.identification.estimate.lbfgs import minimise_lbfgs
from rotorid_torch.identification.estimate.likelihood import HELD, Likelihood, Place
from rotorid_torch.identification.estimate.residuals import Noise
from rotorid_torch.identification.estimate.segments import Records, cut
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.estimate.uncertainty import Uncertainty, covariances, errors_of, jackknife

LENGTHS = (2.0, 5.0, 10.0, math.inf)
"""Segment lengths that the stages choose from where nobody says otherwise, s."""
FINE = Options(tolerance=0.0, absolute=1e-4)
"""Options of the last stage: a predicted gain of 1e-4 in the log-likelihood is a hundredth of a standard error."""
ROUGH = Options(max_iterations=8, absolute=0.5, damping=1e-2)
"""Options of all stages but the last."""
GROWTH = 30.0
"""Growth of an error in the initial state that the first segments may show at most."""
LAST_GROWTH = 1e3
"""The same for the last: beyond it a longer record says nothing more of the parameters, only of the initial state."""
TENTATIVE = 15
"""Iterations after which a longer stage is given up."""
SAME_FIT = 0.4
"""Mean logarithm of the residuals' size that counts as the same quality of fit."""
SHORTEST = 8
"""Samples of the shortest segment."""

Monitor = Callable[[int, float, Tensor], None]
Stage = tuple[Likelihood, Minimum[Place]]
"""The likelihood on segments of one length, and its minimum."""

NEARER = (1.0, 0.7, 0.4, 0.2, 0.0)
"""Shares of the way from the prior mean to a start that are tried in turn."""


@dataclass(frozen=True)
class Settings:
    """How a fit is made; what the data and the model do not say."""

    noise: str = "diagonal"  # "diagonal", "full" or "held"
    matrix: Tensor | None = None  # [ny, ny] where noise is held
    sensor_noise: Tensor | None = None  # [ny] standard deviation, below which that of residuals is not believed
    lengths: tuple[float, ...] | None = None  # of the segments, s, stage by stage; None: chosen from the data
    x0: str = "free"  # or "fixed"
    x0_held: Tensor | None = None  # [nx] mask of the initial states that are believed where x0 is "free"
    x0_bounds: tuple[Tensor, Tensor] | None = None  # [nx] of a flight's initial states
    x0_sd: Tensor | None = None  # [nx] prior of the initial states about the states given, none by default
    prior_mean: Tensor | None = None  # [P]
    prior_sd: Tensor | None = None  # [P], infinite for none
    solver: str = "rk4"
    optimiser: str = "gauss-newton"  # or "lbfgs"
    engine: str | None = None  # "native" or "reference"; None: native where that is possible
    options: Options = FINE
    ends: Callable[[Likelihood, Place], bool] | None = None  # asked after the first stage: whether it is the last


@dataclass(frozen=True)
class Start:
    """Where a fit begins.

    theta : [P], the system's own values by default. states : [F, T, nx] from which initial states start, NaN where
    nothing is known; those of the records by default, and where runs from these diverge.
    """

    theta: Tensor | None = None
    states: Tensor | None = None


@dataclass(frozen=True)
class Estimate:
    """What a fit has found, without the flights.

    minimum : of which the point knows parameters, noise and cost. stages : what each did.
    noise : [ny, ny] covariance of the residuals, corrected for the numbers estimated.
    model_error_ratio : [ny] the residuals' standard deviation over that of the sensors' noise: the declared floor, or
        where none is declared the white part of the residual.
    """

    minimum: Minimum[Place]
    uncertainty: Uncertainty
    stages: tuple[str, ...]
    noise: Tensor
    model_error_ratio: Tensor

    @property
    def theta(self) -> Tensor:
        """Parameters [P]."""
        return self.minimum.point.theta

    @property
    def errors(self) -> Tensor:
        """Standard errors [P], infinite where a parameter lies on a bound or cannot be told."""
        return _errors(self)


@dataclass(frozen=True)
class Fit:
    """The end of a fit: likelihood of its last segments, minimum, and the stages' account.

    computed : the covariance, where another process has computed it.
    """

    likelihood: Likelihood
    minimum: Minimum[Place]
    stages: tuple[str, ...]
    sensor_noise: Tensor | None
    computed: Uncertainty | None = None

    @cached_property
    def uncertainty(self) -> Uncertainty:
        """Covariance of the parameters; all ranks ask for it together."""
        if self.computed is not None:
            return self.computed
        problem, minimum = self.likelihood, self.minimum
        return covariances(problem, minimum.point, minimum.linear, minimum.determined, _loss(problem, minimum))

    @property
    def theta(self) -> Tensor:
        """Parameters [P]."""
        return self.minimum.point.theta

    @property
    def errors(self) -> Tensor:
        """Standard errors [P], infinite where a parameter lies on a bound or cannot be told."""
        return _errors(self)

    def errors_of(self, asked: Tensor) -> Tensor:
        """The same of the parameters in a mask [P] alone: of few of them many times cheaper."""
        if self.computed is not None or "uncertainty" in self.__dict__:
            return self.errors[asked]
        minimum = self.minimum
        errors = errors_of(self.likelihood, minimum.point, minimum.linear, minimum.determined, asked)
        return torch.where(_estimated(minimum)[asked], errors, torch.inf)

    @cached_property
    def jackknife(self) -> Tensor:
        """Variances [P] by leaving out one flight in turn, NaN with fewer than three or where nothing was estimated."""
        if self.computed is not None or "uncertainty" in self.__dict__:
            return self.uncertainty.jackknife
        place, problem = self.minimum.point, self.likelihood
        return jackknife(place.blocks, problem.prior_rows(place), self.minimum.determined, problem.ranks)

    def estimate(self) -> Estimate:
        """The fit without its flights."""
        place, none = self.minimum.point, torch.zeros(0, dtype=torch.float64)
        lean = Place(place.theta, none, covariance=place.covariance, moments=place.moments, cost=place.cost)
        minimum = replace(self.minimum, point=lean)
        return Estimate(minimum, self.uncertainty, self.stages, self.noise, self.model_error_ratio)

    @property
    def noise(self) -> Tensor:
        """Covariance of the residuals [ny, ny], corrected for the numbers estimated."""
        loss = 1.0 if self.likelihood.noise.matrix is not None else _loss(self.likelihood, self.minimum)
        return self.minimum.point.covariance * loss

    @property
    def model_error_ratio(self) -> Tensor:
        """[ny] the residuals' standard deviation over that of the sensors' noise.

        The noise is what is declared, or where none is the white part of the residual e, of which
        sd^2 = mean (e(t+1) - e(t))^2 / 2.

        Source: von Neumann, Annals of Mathematical Statistics 12 (1941), 367 (mean square successive difference).
        """
        spacing = self.likelihood.records.spacing()
        steps = self.likelihood.moments(self.minimum.point, lambda part: _changes(part, spacing))
        white = (steps.mean_square / 2.0).sqrt()
        moments = self.minimum.point.moments
        assert moments is not None
        size = moments.mean_square.sqrt()
        declared = white if self.sensor_noise is None else self.sensor_noise
        return size / torch.where(declared > 0, declared, white)


def _changes(part: Part, spacing: Tensor) -> Tensor:
    """Change [S, T - 1, ny] of a part's residuals from one measured sample to the next; NaN in between."""
    changes = torch.full_like(part.residual[:, 1:], math.nan)
    every = spacing[part.segments.flight]
    for step in every.unique().tolist():
        rows = (every == step).nonzero()[:, 0]
        changes[rows, step - 1 :] = part.residual[rows, step:] - part.residual[rows, :-step]
    return changes


def fit(
    system: System,
    records: Records,
    start: Start = Start(),
    settings: Settings | None = None,
    monitor: Monitor | None = None,
    ranks: Ranks = ALONE,
) -> Fit:
    """Maximum-likelihood estimate of a system's free parameters from records, stage by stage.

    Short segments with initial states of their own converge from poor starts and for unstable vehicles; each later
    stage starts from the parameters and states of the one before and is kept where it converges and fits as well.

    monitor : called after each accepted step of every stage with iteration (counted through), cost, theta.
    ranks : among which the flights are spread; `records` are this rank's, the rest is the same at each.
    """
    settings = settings or Settings()
    stages = _Stages(system, records, settings, monitor, ranks)
    theta, states = system.theta if start.theta is None else start.theta, start.states
    best, samples, rough = None, stages.first(theta), False
    if states is None or not math.isfinite(stages.open(theta, states, samples)[1].cost):
        states, theta = records.states, stages.flyable(theta, samples)
    while samples is not None:
        rough = bool(stages.later(samples))
        stage = stages.stage(theta, states, samples, rough, best)
        if stage is None:
            rough = True  # as the stage before it was
            break
        problem, minimum = stage
        if best is None and settings.ends is not None and settings.ends(problem, minimum.point):
            return Fit(problem, minimum, tuple(stages.account), settings.sensor_noise)
        best = stage
        theta, states = minimum.point.theta, problem.states_at(minimum.point, states)
        samples = stages.next(samples, problem, minimum.point)
    assert best is not None
    problem, minimum = stages.finish(*best, rough)
    return Fit(problem, minimum, tuple(stages.account), settings.sensor_noise)


def _estimated(minimum: Minimum[Place]) -> Tensor:
    """Mask [P] of the parameters that were estimated."""
    return minimum.determined & ~minimum.not_identifiable


def _errors(fit: Fit | Estimate) -> Tensor:
    return torch.where(_estimated(fit.minimum), fit.uncertainty.standard_errors, torch.inf)


def _options(last: Options, rough: bool, tentative: bool) -> Options:
    if rough:
        return ROUGH
    return replace(last, max_iterations=min(TENTATIVE, last.max_iterations)) if tentative else last


def _loss(problem: Likelihood, minimum: Minimum[Place]) -> float:
    """Samples over samples minus numbers estimated from them."""
    local = problem.locals_per_segment * problem.pieces
    return problem.samples / max(problem.samples - len(minimum.point.theta) - local, 1)


def _as_good(shorter: Minimum[Place], longer: Minimum[Place], chosen: bool) -> bool:
    """Whether a longer stage is kept; one that the caller has chosen always is, and says itself how it ended."""
    return chosen or (longer.converged and _size(longer.point) < _size(shorter.point) + SAME_FIT)


def _size(place: Place) -> float:
    """Mean over the outputs of the logarithm of the residual's standard deviation."""
    assert place.moments is not None
    size = place.moments.mean_square.sqrt()
    return float(size[size > 0].log().mean())


@dataclass
class _Stages:
    """Opens and solves the stages of one fit."""

    system: System
    records: Records
    settings: Settings
    monitor: Monitor | None
    ranks: Ranks
    iterations: int = 0
    account: list[str] = field(default_factory=list)

    @cached_property
    def engine(self) -> Engine:
        """What simulates and takes derivatives."""
        typical = self.ranks.from_first(self.records.typical())  # all ranks are to build the same
        return engine_for(self.system, typical, self.settings.solver, self.settings.engine)

    @cached_property
    def whole(self) -> int:
        """Samples of the longest flight of all ranks."""
        return int(self.ranks.largest(int(self.records.lengths.max())))

    def stage(self, theta: Tensor, states: Tensor, samples: int, rough: bool, earlier: Stage | None) -> Stage | None:
        """A stage solved; none where it diverges or fits worse than the earlier one, as the account says."""
        problem, start = self.open(theta, states, samples)
        chosen = self.settings.lengths is not None
        if earlier is not None and not math.isfinite(start.cost):
            self.account.append(f"segments of {samples * self.records.dt:.3g} s: diverge, not tried")
            return None
        options = _options(self.settings.options, rough, tentative=earlier is not None and not chosen)
        minimum = self.solve(problem, start, options)
        self.tell(samples, minimum)
        if earlier is not None and not _as_good(earlier[1], minimum, chosen):
            self.account[-1] += ", not kept"
            return None
        return problem, minimum

    def first(self, theta: Tensor) -> int:
        """Samples per segment of the first stage."""
        if self.settings.lengths is not None:
            return self.lengths()[0]
        if self._fits_already(theta):
            return self.whole
        return self._tame(theta, self.lengths()[0])

    def flyable(self, theta: Tensor, samples: int) -> Tensor:
        """The start; one that diverges within a segment is brought nearer to the prior mean until it does not."""
        mean = self.settings.prior_mean
        if mean is None:
            return theta
        for share in NEARER:
            nearer = mean + share * (theta - mean)
            if math.isfinite(self.open(nearer, self.records.states, samples)[1].cost):
                return nearer
        return theta

    def lengths(self) -> list[int]:
        """Samples per segment that stages may take, shortest first."""
        wanted, least = self.settings.lengths, 0
        if wanted is None:
            wanted, least = LENGTHS, SHORTEST * int(self.records.spacing().max())
        samples = (self.whole if math.isinf(s) else max(round(s / self.records.dt), least) for s in wanted)
        return sorted({min(n, self.whole) for n in samples})

    def later(self, samples: int) -> list[int]:
        """Lengths that may come after this one."""
        if self.settings.lengths is not None:
            return [n for n in self.lengths() if n > samples]
        return [n for n in self.lengths() if n >= 1.5 * samples and (n == self.whole or n < 0.7 * self.whole)]

    def next(self, samples: int, problem: Likelihood, place: Place) -> int | None:
        """The length after this one: one step up, and after five seconds as far as the growth of errors allows."""
        later = self.later(samples)
        if self.settings.lengths is not None or not later:
            return later[0] if later else None
        tame = [n for n in later if _growth(problem, place, n) < LAST_GROWTH]
        if not tame:
            return None
        return tame[0] if samples * self.records.dt < 0.9 * LENGTHS[1] else tame[-1]

    def _tame(self, theta: Tensor, samples: int) -> int:
        """Halved until an error in the initial state does not grow much over a segment."""
        while samples >= 2 * SHORTEST * int(self.records.spacing().max()):
            problem, start = self.open(theta, self.records.states, samples)
            if math.isfinite(start.cost):
                problem.linearise(start)
                if _growth(problem, start, samples) < GROWTH:
                    break
            samples //= 2
        return samples

    def _fits_already(self, theta: Tensor) -> bool:
        """Whether whole flights are near the noise from the start, and tame."""
        problem, start = self.open(theta, self.records.states, self.whole)
        if not math.isfinite(start.cost):
            return False
        noise = self.settings.sensor_noise
        noise = roughness(self.records, self.ranks) if noise is None else noise
        if _size(start) >= float(noise.log().mean()) + SAME_FIT:
            return False
        problem.linearise(start)
        return _growth(problem, start, self.whole) < LAST_GROWTH

    def open(self, theta: Tensor, states: Tensor, samples: int, fixed: bool = False) -> tuple[Likelihood, Place]:
        """The likelihood on segments of this length, and the place to start from."""
        s, segments = self.settings, cut(self.records, samples)
        least = smallest_noise(self.records, self.ranks) if s.sensor_noise is None else s.sensor_noise
        nx, count = self.records.states.shape[-1], len(theta)
        x0, measured = segments.first(states), segments.first(self.records.states)
        spread = torch.full((nx,), math.inf, dtype=torch.float64) if s.x0_sd is None else s.x0_sd
        sd = torch.where(measured.isnan(), math.inf, spread)
        begins = segments.place[:, :1] == 0
        if s.x0_held is not None:
            sd = torch.where(begins & s.x0_held, HELD, sd)
        bounds = None if s.x0_bounds is None else _of_beginnings(begins, s.x0_bounds)
        problem = Likelihood(
            system=self.system,
            engine=self.engine,
            records=self.records,
            segments=segments,
            states=states,
            noise=Noise(s.noise, least, s.matrix),
            x0=filled(x0, self.records, segments),
            x0_mean=measured.nan_to_num(0.0),
            x0_sd=None if fixed else sd,
            prior_mean=theta if s.prior_mean is None else s.prior_mean,
            prior_sd=torch.full((count,), math.inf, dtype=torch.float64) if s.prior_sd is None else s.prior_sd,
            ranks=self.ranks,
            x0_bounds=None if fixed else bounds,
        )
        if not fixed and self.ranks.largest(float(x0.isnan().any())) > 0.0:
            problem = replace(problem, x0=torch.where(x0.isnan(), fitted_states(problem, theta), x0))
        return problem, problem.evaluate(theta)

    def tell(self, samples: int, minimum: Minimum[Place]) -> None:
        """A line of the account."""
        ended = f"{minimum.message} ({minimum.iterations} iterations)"
        self.account.append(f"segments of {samples * self.records.dt:.3g} s: {ended}")

    def finish(self, problem: Likelihood, minimum: Minimum[Place], rough: bool) -> tuple[Likelihood, Minimum[Place]]:
        """The last stage kept, brought to the optimum, with initial states held where they are to be believed."""
        start = minimum.point
        if self.settings.x0 == "fixed":
            problem, start = self.open(start.theta, self.records.states, self.whole, fixed=True)
        elif not rough:
            return problem, minimum
        minimum = self.solve(problem, start, self.settings.options)
        self.tell(problem.longest, minimum)
        return problem, minimum

    def solve(self, problem: Likelihood, start: Place, options: Options) -> Minimum[Place]:
        """The minimum from a place."""
        before = self.iterations

        def monitor(iteration: int, cost: float, theta: Tensor) -> None:
            self.iterations = before + iteration
            if self.monitor is not None:
                self.monitor(self.iterations, cost, theta)

        method = minimise_lbfgs if self.settings.optimiser == "lbfgs" else gauss_newton
        return method(problem, start, options, monitor)


def _of_beginnings(begins: Tensor, bounds: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Bounds [nx] for the segments [S, nx] that begin a flight [S, 1], none for the others."""
    low, high = bounds
    return torch.where(begins, low, -math.inf), torch.where(begins, high, math.inf)


def _growth(problem: Likelihood, place: Place, samples: int) -> float:
    """Largest growth of an error in the state over so many samples, states in units of their size."""
    assert place.passage is not None
    size = problem.mean_square_state(place).sqrt().clamp_min(1e-9)
    product = place.passage * size / size[:, None]
    count, largest = max(1, round(samples / problem.longest)), 0.0
    for f in range(len(problem.records.lengths)):
        pieces = product[problem.segments.flight == f]
        for k in range(max(1, len(pieces) - count + 1)):
            window = torch.eye(product.shape[-1], dtype=torch.float64)
            for piece in pieces[k : k + count]:
                window = piece @ window
            largest = max(largest, float(window.abs().amax().nan_to_num(math.inf)))
    return problem.ranks.largest(largest)


def gauss_newton(problem: Likelihood, start: Place, options: Options, monitor: Monitor | None = None) -> Minimum[Place]:
    """The likelihood's minimum by bounded Gauss-Newton."""
    region = Region(problem.system.lower, problem.system.upper)
    return minimise(problem.evaluate, problem.linearise, start, region, options, monitor)
