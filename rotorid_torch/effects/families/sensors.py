"""Errors of the sensors: they act on the model's outputs, never on the measured channels.

Found by kinematics, the sensors against each other, so no parameter is free when trajectories are fitted.
"""

import torch
from torch import Tensor

from rotorid_torch.core.names import ATTITUDES, FLAPPING, RATES, SPECIFIC_FORCES, VELOCITIES, is_control, unit
from rotorid_torch.core.parameters import Parameter, alike
from rotorid_torch.core.rigid import cross, specific_force_at
from rotorid_torch.effects.base import Effect, Frame, Role, Showing, Stage, Values
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.signal_operations import lagged, low_passed, shifted
from rotorid_torch.effects.spec import ModelSpec

UNITS = {
    "velocities": VELOCITIES,
    "attitude": ATTITUDES,
    "rates": RATES,
    "accelerations": SPECIFIC_FORCES,
    "flapping": FLAPPING,
}
"""Sensors by what they measure: one box, one clock, one filter."""
ANGULAR_ACCELERATIONS = ("pdot", "qdot", "rdot")
LARGEST_BIAS = {"m/s": 5.0, "rad/s": 0.1, "rad": 0.1, "m/s2": 2.0, "rad/s2": 0.5}
TYPICAL_BIAS = {"m/s": 0.5, "rad/s": 0.005, "rad": 0.01, "m/s2": 0.2, "rad/s2": 0.02}

FILTER_ENDINGS = PERIOD, DAMPED, SMOOTHED = ("_period", "_damping", "_smoothing")
"""Of a unit's filter: 1/natural frequency in s, damping, and the variance of a symmetric window in s²."""
DAMPING = (0.2, 1.5, 0.7)
"""Least, largest and usual damping of a filter of second order; with more it is two of first order, far apart."""

TINY = 1e-12
"""Angle in rad below which a rotation is none."""


def _unit(channel: str) -> str:
    return unit(channel).replace("²", "2") or "1"


class _Sensor(Effect):
    stage, role, showing = Stage.SENSORS, Role.UNDECLARED, Showing.KINEMATICS
    needs_imu = False

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Effect:
        """Of the outputs."""
        return cls(spec.outputs)  # pyright: ignore[reportArgumentType]

    @classmethod
    def untestable(cls, spec: ModelSpec) -> str | None:
        """Without accelerometers."""
        return None if not cls.needs_imu or set(SPECIFIC_FORCES) <= set(spec.outputs) else "no accelerometers"


@register
class SensorBias(_Sensor):
    """Constant error of a sensor: the channel reads the true value plus its bias.

    Source: Jategaonkar, Flight Vehicle System Identification (2nd ed.), sec. 10.4 (data compatibility check).
    """

    id = "sensors.bias"

    def __init__(self, channels: tuple[str, ...]) -> None:
        declared = []
        for c in channels:
            most = LARGEST_BIAS.get(_unit(c), 1.0)
            typical = TYPICAL_BIAS.get(_unit(c), 0.1)
            declared.append(Parameter(c, 0.0, _unit(c), (-most, most), free=False, doc=f"bias of {c}", typical=typical))
        super().__init__(tuple(declared))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """The outputs with their biases."""
        return frame.with_signals(**{n: frame.signals[n] + p[n] for n in p.names}), x


@register
class SensorScale(_Sensor):
    """Wrong scale of a sensor: the channel reads (1 + s) times the true value.

    Source: Jategaonkar, Flight Vehicle System Identification (2nd ed.), sec. 10.4 (data compatibility check).
    """

    id = "sensors.scale"

    def __init__(self, channels: tuple[str, ...]) -> None:
        doc = "relative error of {}'s scale"
        super().__init__(alike(channels, "1", (-0.3, 0.3), doc, free=False, typical=0.03))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """The outputs in their sensors' scales."""
        return frame.with_signals(**{n: frame.signals[n] * (1.0 + p[n]) for n in p.names}), x


@register
class Misalignment(_Sensor):
    """IMU turned by a rotation vector e (x, y, z) of any size against the body: it reads R(e)' times each vector.

    Source: Titterton and Weston, Strapdown Inertial Navigation Technology (2nd ed.), ch. 8 (installation errors);
    Rodrigues' formula.
    """

    id = "sensors.misalignment"

    def __init__(self, channels: tuple[str, ...]) -> None:
        super().__init__(alike("xyz", "rad", (-3.2, 3.2), "rotation of the IMU about {}", free=False, typical=0.015))
        self.triads = [t for t in (RATES, SPECIFIC_FORCES) if set(t) <= set(channels)]

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Rates and specific forces in the axes of the turned IMU."""
        e = p.stack("x", "y", "z")
        angle = torch.sqrt((e * e).sum(-1, keepdim=True) + TINY**2)
        once, twice = torch.sin(angle) / angle, 0.5 * (torch.sin(0.5 * angle) / (0.5 * angle)) ** 2
        for triad in self.triads:
            true = frame.stack(triad)
            across = cross(e, true)
            read = true - once * across + twice * cross(e, across)
            frame = frame.with_signals(**dict(zip(triad, read.unbind(-1), strict=True)))
        return frame, x


@register
class LeverArm(_Sensor):
    """IMU elsewhere than declared: specific force gains angular acceleration and rotation times the arm beyond.

    a += pdot x d + p x (p x d), d the place beyond the declared one. Stands before misalignment in a list of effects,
    for it takes the true rates.

    Source: Jategaonkar, Flight Vehicle System Identification (2nd ed.), eq. 10.9 ff.
    """

    id, needs_imu = "sensors.lever_arm", True

    def __init__(self, channels: tuple[str, ...] = ()) -> None:
        super().__init__(alike("xyz", "m", (-5.0, 5.0), "place of the IMU along {} beyond", free=False, typical=0.5))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Specific forces where the IMU really is."""
        rates, angular = frame.stack(RATES), frame.stack(ANGULAR_ACCELERATIONS)
        felt = specific_force_at(p.stack("x", "y", "z"), frame.stack(SPECIFIC_FORCES), rates, angular)
        return frame.with_signals(**dict(zip(SPECIFIC_FORCES, felt.unbind(-1), strict=True))), x


def _of_units(channels: tuple[str, ...], low: float, high: float, typical: float, what: str) -> tuple[Parameter, ...]:
    """One time per unit that has channels among the outputs."""
    units = [u for u, members in UNITS.items() if set(members) & set(channels)]
    return alike(units, "s", (low, high), f"{what} of {{}}", free=False, typical=typical)


def per_channel(p: Values, names: tuple[str, ...], ending: str = "") -> Tensor:
    """Each channel's value [..., n] of its unit's parameter with this ending; zero outside the units."""
    zero = torch.zeros_like(p.vector[..., 0])
    owner = {c: f"{u}{ending}" for u, members in UNITS.items() if f"{u}{ending}" in p.names for c in members}
    return torch.stack([p[owner[n]] if n in owner else zero for n in names], dim=-1)


@register
class SensorDelay(_Sensor):
    """Channels of one unit late against the others: y(t) is recorded at t + delay (early where negative).

    `controls` is the same for the record of the controls, the response to which seems to come first: the model then
    looks ahead in that record. Controls that act later than they are recorded are `control.delay`.

    Source: Tischler and Remple, Aircraft and Rotorcraft System Identification, sec. 6.4 (instrumentation delays).
    """

    id = "sensors.delay"

    def __init__(self, channels: tuple[str, ...]) -> None:
        late = "time by which the record of the controls is late"
        common = Parameter("controls", 0.0, "s", (0.0, 0.5), free=False, doc=late, typical=0.05)
        super().__init__((*_of_units(channels, -30.0, 30.0, 0.05, "delay"), common))

    def read(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Controls [..., T, nu] earlier by their delay; the record's end is held."""
        late = torch.stack([p["controls"] if is_control(n) else 0.0 * p["controls"] for n in names], dim=-1)
        return shifted(record, -late, dt)

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Outputs [..., T, ny], each unit's by its delay later."""
        return shifted(record, per_channel(p, names), dt)


@register
class SensorFilter(_Sensor):
    """Channels of one unit behind filters: first order, second order, and a window without phase, null each.

    tau dy/dt = true - y, exact for what is linear in between; then T² y'' + 2 zeta T y' + y = y1, with T one over the
    natural frequency (`_period`) and zeta the damping (`_damping`); then a symmetric window of a variance
    (`_smoothing`), which records that were smoothed after the flight have passed.

    Source: Tischler and Remple, Aircraft and Rotorcraft System Identification, sec. 5.7 (anti-alias filters).
    """

    id = "sensors.filter"

    def __init__(self, channels: tuple[str, ...]) -> None:
        first = _of_units(channels, 0.0, 0.5, 0.05, "time constant")
        super().__init__((*first, *(p for unit in first for p in self._more(unit.name))))

    @staticmethod
    def _more(unit: str) -> tuple[Parameter, ...]:
        period, damping, smoothing = (f"{unit}{ending}" for ending in FILTER_ENDINGS)
        low, high, usual = DAMPING
        return (
            Parameter(period, 0.0, "s", (0.0, 0.3), free=False, doc=f"1/natural frequency of {unit}", typical=0.05),
            Parameter(damping, usual, "1", (low, high), free=False, doc=f"damping of {unit}'s filter", typical=usual),
            Parameter(smoothing, 0.0, "s2", (0.0, 0.1), free=False, doc=f"variance of {unit}'s window", typical=0.003),
        )

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Outputs [..., T, ny], each unit's behind its filters."""
        period, damping, smoothing = (per_channel(p, names, ending) for ending in FILTER_ENDINGS)
        return low_passed(lagged(record, per_channel(p, names), dt), period, damping, smoothing, dt)
