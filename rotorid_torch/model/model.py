"""The identification model: body equations and an ordered chain of effects, with one flat parameter vector."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Self

import torch
from torch import Tensor, nn

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core.names import ATTITUDES, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.core.parameters import ParameterSet
from rotorid_torch.core.rigid import euler_rates, gyroscopic, join, specific_force_at, vec, velocity_rates
from rotorid_torch.core.state import State, StateLayout
from rotorid_torch.data.flight import Flight
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.errors import InputError, nearest
from rotorid_torch.model.training.free_run import FreeRun, free_run
from rotorid_torch.model.training.measured_motion import DrivenEffect
from rotorid_torch.model.training.named_parameters import NamedParameters, NamedPart
from rotorid_torch.model.training.trajectories import Trajectories

ATTITUDE = ATTITUDES[:2]
ANGULAR_ACCELERATIONS = ("pdot", "qdot", "rdot")
BODY_UNITS = dict.fromkeys(VELOCITIES, "m/s") | dict.fromkeys(RATES, "rad/s") | dict.fromkeys(ATTITUDE, "rad")


@dataclass(frozen=True)
class Body:
    """What the body equations need: states, gravity, inertia (None: no gyroscopic terms), place of the IMU."""

    states: tuple[str, ...]
    controls: tuple[str, ...]
    outputs: tuple[str, ...]
    gravity: float = 9.80665
    inertia: tuple[tuple[float, ...], ...] | None = None
    imu: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Model(nn.Module):
    """Body states and the effects' states in one flat vector; rates, outputs and the control record through the chain.

    `forward(t, x, u)` gives dx/dt [..., nx] and `output(x, u)` the channels `outputs` [..., ny]; leading dimensions
    broadcast, also against a theta [..., P] handed to `rates` and `outputs_at`.
    """

    def __init__(self, body: Body, effects: Sequence[Effect], reference: Mapping[str, float]) -> None:
        super().__init__()
        self.body, self.reference = body, dict(reference)
        self.effects = nn.ModuleList(sorted(effects, key=lambda e: (e.stage, e.order)))
        ids = [e.id for e in self.chain]
        if len(set(ids)) < len(ids):
            raise ValueError(f"effects of one id: {sorted({i for i in ids if ids.count(i) > 1})}")
        declared = [p.renamed(f"{e.id}.{p.name}") for e in self.chain for p in e.declared]
        self.parameter_set = ParameterSet(tuple(declared))
        self.theta = nn.Parameter(self.parameter_set.values)
        effect_states = [replace(s, name=_state_name(e, s)) for e in self.chain for s in e.states]
        self.layout = StateLayout(tuple([State(n, BODY_UNITS[n]) for n in body.states] + effect_states))
        inertia = torch.eye(3).tolist() if body.inertia is None else body.inertia
        self.register_buffer("inertia", torch.tensor(inertia, dtype=torch.float64))
        self.register_buffer("imu", torch.tensor(body.imu, dtype=torch.float64))
        self._slices, self._local = self._places(), [tuple(p.name for p in e.declared) for e in self.chain]
        self._named: NamedParameters | None = None
        self._runs: tuple[Any, Tensor, Tensor, Trajectories] | None = None
        self._driven: dict[int, DrivenEffect] = {}

    inertia: Tensor
    imu: Tensor

    @property
    def chain(self) -> list[Effect]:
        """The effects in the order of their stages."""
        return [e for e in self.effects if isinstance(e, Effect)]

    @property
    def own_states(self) -> tuple[State, ...]:
        """The effects' own states, in the order of the flat state behind the body's."""
        return self.layout.states[len(self.body.states) :]

    @property
    def named_values(self) -> dict[str, float]:
        """Every parameter's value by its full name."""
        return dict(zip(self.parameter_set.names, self.theta.detach().tolist(), strict=True))

    def named_parameters(
        self, prefix: str = "", recurse: bool = True, remove_duplicate: bool = True
    ) -> Iterator[tuple[str, nn.Parameter]]:
        """Every parameter by its full name, those of a module's weights as one tensor; all share theta's numbers.

        For optimisers of torch: groups by name, or some held by `requires_grad_(False)`. `theta` is one vector of them
        all; after a step that does not know the bounds, `start_from({})` puts it inside.
        """
        if self._named is None or not self._named.belong_to(self.theta):
            self._named = NamedParameters(self.theta, list(self._pieces()))
        yield from ((f"{prefix}.{name}" if prefix else name, leaf) for name, leaf in self._named)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """Moved to a device or a type, as torch does it in place; the named parameters follow."""
        super()._apply(fn, recurse)
        if self._named is not None:
            self._named.follow()
        return self

    def _pieces(self) -> Iterator[NamedPart]:
        first = 0
        for e in self.chain:
            weights = e.network_weights
            for p in e.declared[: len(e.declared) - sum(w.count for w in weights)]:
                yield NamedPart(f"{e.id}.{p.name}", first, (), 1)
                first += 1
            for w in weights:
                yield NamedPart(f"{e.id}.{w.name}", first, w.shape, w.count)
                first += w.count

    def zero_grad(self, set_to_none: bool = True) -> None:
        """Let go of all gradients."""
        super().zero_grad(set_to_none)
        self.theta.grad = None

    @torch.no_grad()
    def start_from(self, values: Mapping[str, float]) -> None:
        """Set some parameters by their full names, inside their bounds; the others stay.

        Raises InputError: a name that no parameter has, or a value that is no finite number.
        """
        arguments.instance(Argument("start_from", "values"), values, Mapping, 'a dict of numbers: {"forces.L.p": -3.0}')
        numbers, names = self.theta.tolist(), self.parameter_set.names
        for name, value in values.items():
            argument = Argument("start_from", str(name))
            if name not in self.parameter_set:
                wrong = f"there is no such parameter{nearest(str(name), names)}"
                raise argument.wrong(wrong, f"one of {arguments.listed(names)}")
            numbers[self.parameter_set.index(name)] = arguments.number(argument, value)
        self.theta.copy_(self.parameter_set.clamp(self.theta.new_tensor(numbers)))

    @torch.no_grad()
    def put(self, theta: Tensor) -> None:
        """Set all parameters, as they are."""
        self.theta.copy_(theta)

    @contextmanager
    def restored(self) -> Iterator[None]:
        """Put theta back at the end of the block, also where the block fails."""
        before = self.theta.detach().clone()
        try:
            yield
        finally:
            self.put(before)

    def effect(self, name: str) -> Effect | None:
        """The effect of this id, or None."""
        return next((e for e in self.chain if e.id == name), None)

    def _places(self) -> list[tuple[slice, slice]]:
        parameter, state, places = 0, len(self.body.states), []
        for e in self.chain:
            places.append((slice(parameter, parameter + len(e.declared)), slice(state, state + len(e.states))))
            parameter, state = parameter + len(e.declared), state + len(e.states)
        return places

    def state_names(self, k: int) -> tuple[str, ...]:
        """Names in the flat state of the k-th effect's own states."""
        return self.layout.names[self._slices[k][1]]

    def values(self, theta: Tensor, k: int) -> Values:
        """Slice of theta that belongs to the k-th effect of the chain."""
        return Values(theta[..., self._slices[k][0]], self._local[k])

    def frame(self, theta: Tensor, x: Tensor, u: Tensor, dt: float | None = None) -> tuple[Frame, Tensor]:
        """The frame after all stages, and the rates of the effects' own states [..., nx - nbody].

        dt : s between samples of a record x [..., T, nx]. The own states of effects with parameters follow that motion
        from rest then, but for what a channel tells.
        """
        n = len(self.body.states)
        signals = dict(zip(self.body.states, x[..., :n].unbind(-1), strict=True))
        signals.update(zip(self.layout.names[n:], x[..., n:].unbind(-1), strict=True))
        signals.update(zip(self.body.controls, u.unbind(-1), strict=True))
        frame = Frame(signals)
        for k, effect in enumerate(self.chain):
            if effect.stage in (Stage.CONTROL, Stage.SENSORS):
                continue
            mine = x[..., self._slices[k][1]]
            if dt is not None and self.follows(effect):
                measured = torch.tensor([state.channel is not None for state in effect.states], device=x.device)
                driven = self._driven_effect(k, frame, theta).states(frame, self.values(theta, k), dt)
                mine = torch.where(measured, mine, driven)
                frame = frame.with_signals(**dict(zip(self.state_names(k), mine.unbind(-1), strict=True)))
            frame, effect_rates = effect(frame, mine, self.values(theta, k))
            if effect.states:
                frame = frame.with_rates(**dict(zip(self.state_names(k), effect_rates.unbind(-1), strict=True)))
        names = self.layout.names[n:]
        return frame, vec(*(frame.rates[name] for name in names)) if names else x[..., :0]

    @staticmethod
    def follows(effect: Effect) -> bool:
        """Whether own states of an effect follow the motion where that is a record: those that no channel tells."""
        return bool(effect.declared) and any(state.channel is None for state in effect.states)

    def _driven_effect(self, k: int, frame: Frame, theta: Tensor) -> DrivenEffect:
        """The k-th effect as frames drive its own states; made once."""
        if k not in self._driven:
            self._driven[k] = DrivenEffect.of(self.chain[k], frame, self.values(theta, k))
        return self._driven[k]

    def rates(self, theta: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """dx/dt [..., nx] at parameters theta [..., P], states x [..., nx], controls u [..., nu]."""
        return self._rates(x, *self.frame(theta, x, u))

    def _rates(self, x: Tensor, frame: Frame, effect_rates: Tensor) -> Tensor:
        return join(*self._body_rates(frame, x), effect_rates)

    def _angular(self, frame: Frame, rates: Tensor) -> Tensor:
        assert frame.moment is not None
        return frame.moment if self.body.inertia is None else frame.moment + gyroscopic(rates, self.inertia)

    def _body_rates(self, frame: Frame, x: Tensor) -> list[Tensor]:
        has, pick = self.layout.has, self.layout.pick
        rates, parts = frame.stack(RATES), []
        if has(*VELOCITIES):
            assert frame.force is not None
            velocity, attitude = pick(x, *VELOCITIES), pick(x, *ATTITUDE)
            parts.append(velocity_rates(velocity, rates, attitude, frame.force, self.body.gravity))
        parts.append(self._angular(frame, rates))
        if has(*ATTITUDE):
            parts.append(euler_rates(rates, pick(x, *ATTITUDE))[..., :2])
        return parts

    def outputs_at(self, theta: Tensor, x: Tensor, u: Tensor, dt: float | None = None) -> Tensor:
        """Channels `body.outputs` [..., ny] at parameters theta [..., P]; `dt` as in `frame`."""
        return self._outputs(theta, x, self.frame(theta, x, u, dt)[0])

    def motion(self, theta: Tensor, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """`rates` and `outputs_at` of one frame."""
        frame, effect_rates = self.frame(theta, x, u)
        return self._rates(x, frame, effect_rates), self._outputs(theta, x, frame)

    def _outputs(self, theta: Tensor, x: Tensor, frame: Frame) -> Tensor:
        signals, rates = dict(frame.signals), frame.stack(RATES)
        angular = self._angular(frame, rates)
        signals.update(zip(ANGULAR_ACCELERATIONS, angular.unbind(-1), strict=True))
        if frame.force is not None:
            imu = self.imu if frame.centre is None else self.imu - frame.centre  # as declared; else `LeverArm`
            force = specific_force_at(imu, frame.force, rates, angular)
            signals.update(zip(SPECIFIC_FORCES, force.unbind(-1), strict=True))
        if self.layout.has(*VELOCITIES):  # over ground, whatever the air does
            signals.update(zip(VELOCITIES, self.layout.pick(x, *VELOCITIES).unbind(-1), strict=True))
        frame = replace(frame, signals=signals)
        for k, effect in enumerate(self.chain):
            if effect.stage is Stage.SENSORS:
                frame, _ = effect(frame, x[..., :0], self.values(theta, k))
        return frame.stack(self.body.outputs)

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """dx/dt [..., nx] with the model's own theta."""
        return self.rates(self.theta, x, u)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        """Channels `body.outputs` [..., ny] with the model's own theta."""
        return self.outputs_at(self.theta, x, u)

    def trajectories(self, x0: Tensor, controls: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """States [B, T, nx] and outputs [B, T, ny] from x0 [B, nx] under controls [B, T, nu] behind the control path.

        Torch differentiates them by theta, x0 and controls. Native code does it where the model can be compiled and
        lies on the processor in float64; torch does it elsewhere.
        """
        return self._compiled()(self.theta, x0, controls, dt)

    def _compiled(self) -> Trajectories:
        """Made anew where a buffer has changed, or the model says something else at the place where it was compiled."""
        state = (self.theta.device, self.theta.dtype, *((id(b), b._version) for b in self.buffers()))
        if self._runs is not None and self._runs[0] == state:
            _, theta, said, trajectories = self._runs
            if said.equal(self._beside(theta)):
                return trajectories
        self.refuse_untrained()
        theta = self.theta.detach().clone()
        trajectories = Trajectories.of(self.motion, self.theta, *self.reference_point)
        self._runs = state, theta, self._beside(theta), trajectories
        return trajectories

    @torch.no_grad()
    def _beside(self, theta: Tensor) -> Tensor:
        """Rates and outputs beside theta and the reference, where no parameter hides others at its null."""
        places = (theta, *self.reference_point)
        theta, x, u = (a + 0.1 * (1.0 + a.abs()) * (2.0 + torch.arange(len(a)).to(a).cos()) for a in places)
        within = self.parameter_set.clamp(theta.to(self.parameter_set.lower)).to(theta)
        return torch.cat(self.motion(within, x, u)).nan_to_num()

    @property
    def reference_point(self) -> tuple[Tensor, Tensor]:
        """States [nx] and controls [nu] at the reference; what it does not know is zero.

        A state that a channel measures (height, heading) is at the channel's reference.
        """
        states = (state.channel or state.name for state in self.layout.states)
        x, u = ([self.reference.get(n, 0.0) for n in names] for names in (states, self.body.controls))
        return self.theta.new_tensor(x), self.theta.new_tensor(u)

    def refuse_untrained(self) -> None:
        """Refuse tensors that wait for gradients and are no parameter: whoever made them expects them to be trained.

        Raises
        ------
        InputError : there is one.
        """
        with torch.enable_grad():
            results = self.motion(self.theta.detach(), *self.reference_point)
        if any(r.requires_grad for r in results):
            wrong = (
                "computes with a tensor that requires gradients and is no parameter, so that it would not be trained"
            )
            raise InputError("model", "forward", wrong, "modules and nn.Parameters as attributes of an effect")

    def __getstate__(self) -> dict[str, Any]:
        """Copies and pickles hold nothing that is compiled."""
        return {**self.__dict__, "_runs": None, "_named": None, "_driven": {}}

    def free_run(
        self,
        flight: Flight | Sequence[Flight],
        start: float | Sequence[float] | Tensor = 0.0,
        seconds: float = 8.0,
        x0: Tensor | None = None,
    ) -> FreeRun:
        """Free runs with gradients by theta and x0: controls measured, nothing measured after the start.

        Parameters
        ----------
        flight : a flight, or one for each start; all of one sample interval.
        start : where each run begins, s; several run side by side.
        seconds : length of the runs, s.
        x0 : states at the start [..., nx], or those of the body alone [..., n], with which the effects' own states rest
            or start at their channel. By default those where lines through the first quarter second begin.

        Returns
        -------
        States [..., T, nx], outputs [..., T, ny] and what was measured; without `...` for a single start of a flight.

        Raises
        ------
        InputError : a control is missing, start and seconds leave a flight, or numbers are of half precision.
        """
        return free_run(self, flight, start, seconds, x0)

    def tape(self, controls: Tensor, dt: float) -> Tensor:
        """The control record [..., T, nu] as it reaches the rotor, once over the whole record.

        What sensors did to the record is undone first; then the effects of the control path act.
        """
        for k, effect in enumerate(self.chain):
            if effect.stage is Stage.SENSORS:
                with effect.lent(self.values(self.theta, k)) as p:
                    controls = effect.read(controls, self.body.controls, dt, p)
        return self._taped(Stage.CONTROL, controls, self.body.controls, dt)

    def recorded(self, outputs: Tensor, dt: float) -> Tensor:
        """The record of outputs [..., T, ny] as sensors with memory pass it on."""
        return self._taped(Stage.SENSORS, outputs, self.body.outputs, dt)

    def _taped(self, stage: Stage, record: Tensor, names: tuple[str, ...], dt: float) -> Tensor:
        for k, effect in enumerate(self.chain):
            if effect.stage is stage:
                with effect.lent(self.values(self.theta, k)) as p:
                    record = effect.tape(record, names, dt, p)
        return record


def _state_name(effect: Effect, state: State) -> str:
    """The nominal model's states are signals of their own name (a0, vi); other effects' carry the effect's id."""
    return state.name if effect.role is Role.NOMINAL else f"{effect.id}.{state.name}"
