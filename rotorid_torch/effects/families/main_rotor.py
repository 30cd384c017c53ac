"""Effects of the main rotor beyond first-order flapping: inflow, lead-lag, wake, stall.

Flapping is beta(psi) = a0 - a1 cos(psi) - b1 sin(psi), psi = 0 aft and along the rotation.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import softplus

from rotorid_torch.core.names import FLAPPING
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.rigid import vec
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.spec import ModelSpec, RotorSpec
from rotorid_torch.effects.testable import Needs, need

USUAL_LOCK = 8.0
"""Lock number of a rotor that does not declare it."""
LIFT_SLOPE = 5.7
"""Of a blade section, 1/rad."""
USUAL_LAG = 0.3
"""Lag frequency over rotor speed where no hinge offset is declared."""
KNOWN = 0.02
"""What a rotor does where a segment begins is known from the motion before: angles to this (rad), their rates to speed
times this, induced velocity to the tip's speed times this, what stands for thrust to this share of it.

Otherwise states that nothing shows yet, an effect being at its null, go anywhere and take the fit with them.
"""
TURNS = (-1.2, -0.4, 0.4, 1.2)
"""rad: all directions of a pull of either sign, to within 0.4."""
FASTEST = 60.0
"""rad/s: states are integrated at 50 Hz; faster modes would be numbers of the integration."""


def inside(value: float, bounds: tuple[float, float]) -> float:
    """A start kept within its bounds."""
    return min(max(value, bounds[0]), bounds[1])


def damping_of(rotor: RotorSpec) -> float:
    """Aerodynamic damping of flapping over its inertia, Lock number times speed over 8, 1/s."""
    return (rotor.lock_number or USUAL_LOCK) * rotor.speed / 8.0


@register
class DynamicInflow(Effect):
    """Dynamic inflow, three states, for a model whose nominal has none: thrust builds it up, and it takes thrust away.

    tau dn/dt = dT - n with dT the thrust beyond trim (m/s2); Z += Z n, N += N n, da0/dt -= a0 n. Where flapping is a
    state, the first harmonics follow the disc: tau_c d(wa, wb)/dt = (a1, b1) - (wa, wb); da1/dt += along wa + across
    wb, db1/dt += along wb - across wa.

    Source: Pitt and Peters, Vertica 5 (1981); Padfield, Helicopter Flight Dynamics, sec. 3.2 (dynamic inflow).
    """

    id, stage, role = "rotor.inflow", Stage.FORCES, Role.STRUCTURE
    needs = (Needs.FORCES, Needs.NOT_MULTIROTOR)

    def __init__(self, thrust: float, flapping: tuple[float, float] | None) -> None:
        times = (0.02, 0.6)
        declared = [
            Parameter("tau", 0.1, "s", times, 0.1, doc="time constant of the uniform inflow", typical=0.1),
            Parameter("Z", 0.0, "1", (0.0, 0.95), doc="share of the thrust that the inflow takes back", typical=0.4),
            Parameter("N", 0.0, "rad/m", (-1.0, 1.0), doc="yaw by the torque of the inflow", typical=0.02),
        ]
        states = [State("uniform", "m/s2", "uniform inflow, as the thrust that keeps it up", spread=KNOWN * thrust)]
        if flapping is not None:
            declared += [
                Parameter("tau_cyclic", 0.15, "s", times, 0.15, doc="time constant of the harmonics", typical=0.15),
                Parameter(
                    "a0", 0.0, "rad s/m", (-5.0, 5.0), doc="coning rate that the inflow takes back", typical=0.05
                ),
                Parameter("along", 0.0, "1/s", (-30.0, 30.0), doc="flapping by its own harmonic", typical=2.0),
                Parameter("across", 0.0, "1/s", (-30.0, 30.0), doc="flapping by the other harmonic", typical=2.0),
            ]
            states += [State(n, "rad", "first harmonic of the inflow, as flapping", spread=KNOWN) for n in ("wa", "wb")]
        super().__init__(tuple(declared), tuple(states))
        self.thrust, self.flapping = thrust, flapping

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> DynamicInflow:
        """With the harmonics where flapping is a state."""
        tilts = (spec.reference.get("a1", 0.0), spec.reference.get("b1", 0.0))
        return cls(spec.lift, tilts if spec.flapping == "first order" else None)

    @classmethod
    def within(cls, spec: ModelSpec) -> str:
        """The nominal model's inflow, where it has one."""
        return "inflow" if spec.inflow else ""

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds what the inflow takes; the rates of the states."""
        assert frame.force is not None
        thrust, n = -frame.force[..., 2] - self.thrust, x[..., 0]
        zero = torch.zeros_like(p["Z"] * n)
        frame = frame.add(vec(zero, zero, p["Z"] * n), vec(zero, zero, p["N"] * n))
        rate = (thrust - n) / p["tau"]
        if self.flapping is None:
            return frame, rate.unsqueeze(-1)
        wa, wb = x[..., 1] - self.flapping[0], x[..., 2] - self.flapping[1]
        frame = frame.with_rates(
            a0=frame.rate("a0") - p["a0"] * n,
            a1=frame.rate("a1") + p["along"] * wa + p["across"] * wb,
            b1=frame.rate("b1") + p["along"] * wb - p["across"] * wa,
        )
        a1, b1 = frame.signals["a1"], frame.signals["b1"]
        return frame, vec(rate, (a1 - x[..., 1]) / p["tau_cyclic"], (b1 - x[..., 2]) / p["tau_cyclic"])


FLAPPING_STATES = need(
    lambda spec: spec.flapping == "first order", "flapping is not measured, or follows its drivers without lag"
)
DRIVERS = need(
    lambda spec: spec.flapping == "first order" or {"lon", "lat"} <= set(spec.controls),
    "neither flapping nor cyclic is recorded",
)


@register
class FlapSecondOrder(Effect):
    """Flapping of second order: its rates are states, with the regressive and the advancing mode.

    With F the rates of first-order flapping, w = (0, q, spin p) those of the hub, v the flapping rates in space:
    d(flapping)/dt = (1 - k) F + k (v - w); dv0/dt = (F0 - v0)/tau; d(va, vb)/dt = C (F + w - v), C = [[1/tau, c],
    [-c, 1/tau]]. tau = 8/(Lock number x speed), half the time constant of the flapping modes, c = 2 speed; slow motion
    keeps first-order flapping exactly, and a hub that turns at once leaves the blades where they are. k is one in the
    physics and zero in the nominal model.

    Source: Chen, NASA TM-81169 (1980), eq. 1; Padfield, Helicopter Flight Dynamics, eq. 3.63 ff.
    """

    id, stage, role = "rotor.flap_second_order", Stage.ROTOR, Role.STRUCTURE
    needs = (FLAPPING_STATES, Needs.ROTOR)
    ordinary = True

    def __init__(self, rotor: RotorSpec) -> None:
        times, couplings = (0.02, 0.2), (0.0, FASTEST)
        tau, coupling = inside(1.0 / damping_of(rotor), times), inside(2.0 * rotor.speed, couplings)
        gyroscopic = coupling, "rad/s", couplings, 0.3 * coupling
        super().__init__(
            (
                Parameter("share", 0.0, "1", (0.0, 1.0), doc="share of second-order flapping", typical=1.0),
                Parameter("tau", tau, "s", times, 0.5 * tau, doc="damping of the flapping rates", typical=tau),
                # the rotor's speed is declared, and a coupling that may drift takes up a delay
                Parameter("coupling", *gyroscopic, free=False, doc="gyroscopic coupling", typical=coupling),
            ),
            tuple(State(f"{n}_rate", "rad/s", f"rate of {n} in space", spread=KNOWN * rotor.speed) for n in FLAPPING),
        )
        self.spin = rotor.spin

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> FlapSecondOrder:
        """From the declared rotor's speed and Lock number."""
        assert spec.rotor is not None
        return cls(spec.rotor)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Replaces the rates of flapping; the flapping accelerations."""
        F = torch.stack(torch.broadcast_tensors(*(frame.rate(n) for n in FLAPPING)), dim=-1)
        q, p_spin = _turning(frame, self.spin)
        turning = vec(torch.zeros_like(q), q, p_spin)
        share = p["share"].unsqueeze(-1)
        mixed = (1.0 - share) * F + share * (x - turning)
        behind, damping = F + turning - x, 1.0 / p["tau"]
        cone, a, b = behind.unbind(-1)
        rates = vec(damping * cone, damping * a + p["coupling"] * b, damping * b - p["coupling"] * a)
        return frame.with_rates(**dict(zip(FLAPPING, mixed.unbind(-1), strict=True))), rates


def _turning(frame: Frame, spin: float) -> tuple[Tensor, Tensor]:
    """What the hub's pitch and roll rates add to the rates of a1 and b1, for those in space."""
    return frame.signals["q"], spin * frame.signals["p"]


@register
class LeadLag(Effect):
    """Lead-lag: the regressing and the advancing lag mode shake the body after each step, the collective mode its yaw.

    Complex lag s = x + i y: s'' = (l1 + l2) s' - l1 l2 s + speed (da1/dt + q + i (db1/dt + spin p)), the Coriolis
    moments of flapping in space, with l = -damping + i frequency of each mode. The hub is pulled by c = e^(i phase) s':
    X += X re c, M += M re c, Y += Y im c, L += L im c. Without flapping states the cyclic controls drive it. The
    frequencies start at speed -+ lag frequency, which is speed sqrt(1.5 e/(R - e)) for hinges at e. All blades together
    lag by z behind the collective, z'' = -2 damping z' + (damping^2 + f^2) (col - z) with f half the difference of the
    two frequencies (half their sum where blades lag faster than they turn): torque reaches the hub late, N += N (z -
    col).

    Source: Johnson, Helicopter Theory, sec. 12-1 (lag dynamics in multiblade coordinates); Bramwell, ch. 9.
    """

    id, stage, role = "rotor.lead_lag", Stage.FORCES, Role.STRUCTURE
    needs = (Needs.ROTOR, Needs.FORCES, DRIVERS)
    ordinary = True

    def __init__(
        self,
        rotor: RotorSpec,
        drivers: tuple[str, str],
        zero: tuple[float, float],
        of_rates: bool,
        collective: float | None,
    ) -> None:
        e = rotor.hinge_offset
        lag = USUAL_LAG if not e else math.sqrt(1.5 * e / (rotor.radius - e))
        slow, fast = (inside(rotor.speed * abs(1.0 + side * lag), (1.0, FASTEST / 1.4)) for side in (-1, 1))
        per = ("m/(s rad)", "1/s") if of_rates else ("m/(s2 rad)", "1/s2")
        late = "N that is late with the collective lag"
        super().__init__(
            (
                _frequency("regressing", slow),
                _frequency("advancing", fast),
                Parameter("damping", 3.0, "1/s", (0.2, 12.0), 1.5, doc="of both modes", typical=3.0),
                # half a turn is the same with all signs changed; a start far off sends fits to a bound, where they stay
                Parameter("phase", 0.0, "rad", (-math.pi, math.pi), doc="turn of the pull", typical=0.3, tried=TURNS),
                *(
                    Parameter(n, 0.0, per[n in "LM"], (-100.0, 100.0), doc=f"{n} by the lag motion", typical=size)
                    for n, size in (("X", 0.3), ("Y", 0.3), ("L", 0.6), ("M", 0.1))
                ),
                Parameter("N", 0.0, "1/s2", (-100.0, 100.0), free=collective is not None, doc=late, typical=5.0),
            ),
            tuple(
                State(n, unit, f"{what}, {axis}", spread=spread)
                for what, unit, spread, names in (
                    ("lag", "rad", KNOWN, ("x", "y", "z")),
                    ("rate of lag", "rad/s", KNOWN * rotor.speed, ("x_rate", "y_rate", "z_rate")),
                )
                for n, axis in zip(names, ("longitudinal", "lateral", "collective"), strict=True)
            ),
        )
        self.speed, self.spin, self.drivers, self.zero, self.of_rates = rotor.speed, rotor.spin, drivers, zero, of_rates
        self.collective, self.regressing = collective, -1.0 if lag < 1.0 else 1.0

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> LeadLag:
        """From the declared rotor; driven by flapping rates where flapping is a state."""
        assert spec.rotor is not None
        of_rates = spec.flapping == "first order"
        drivers = ("a1", "b1") if of_rates else ("lon", "lat")
        zero = (0.0, 0.0) if of_rates else (spec.reference.get("lon", 0.0), spec.reference.get("lat", 0.0))
        collective = spec.reference.get("col", 0.0) if "col" in spec.controls else None
        return cls(spec.rotor, drivers, zero, of_rates, collective)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the pull at the hub; the lag motion's rates."""
        if self.of_rates:
            a, b = (frame.rate(n) + w for n, w in zip(self.drivers, _turning(frame, self.spin), strict=True))
        else:
            a, b = (frame.signals[n] - z for n, z in zip(self.drivers, self.zero, strict=True))
        along, side, late, along_rate, side_rate, late_rate = x.unbind(-1)
        total, twice = p["regressing"] + p["advancing"], 2.0 * p["damping"]
        spring, turned = p["damping"].square() - p["regressing"] * p["advancing"], p["damping"] * total
        zero = torch.zeros_like(late)
        behind = zero if self.collective is None else frame.signals["col"] - self.collective - late
        stiffness = p["damping"].square() + (0.5 * (p["advancing"] + self.regressing * p["regressing"])).square()
        along_turn = self.speed * a - twice * along_rate - total * side_rate - spring * along - turned * side
        side_turn = self.speed * b - twice * side_rate + total * along_rate - spring * side + turned * along
        late_turn = stiffness * behind - twice * late_rate
        rates = vec(along_rate, side_rate, late_rate, along_turn, side_turn, late_turn)
        cos, sin = torch.cos(p["phase"]), torch.sin(p["phase"])
        fore, right = cos * along_rate - sin * side_rate, sin * along_rate + cos * side_rate
        force = vec(p["X"] * fore, p["Y"] * right, zero)
        moment = vec(p["L"] * right, p["M"] * fore, -p["N"] * behind)
        return frame.add(force, moment), rates


def _frequency(name: str, start: float) -> Parameter:
    bounds = (0.6 * start, min(1.4 * start, FASTEST))
    return Parameter(name, start, "rad/s", bounds, 0.1 * start, doc=f"frequency of the {name} mode", typical=start)


REMEMBERED = 0.01
"""rad/s: what a wake remembers where a segment begins is known from the motion before to this."""


@register
class WakeDistortion(Effect):
    """Wake distortion: a disc that pitches and rolls curves its wake, and the inflow gradient turns its tilt.

    The gradients K_R (q + da1/dt)/speed and K_R (p + db1/dt)/speed follow late by tau; in first-order flapping they act
    as d(a1, b1)/dt += g speed/(g^2 + 4 speed^2) [[g, -2 speed], [2 speed, g]] (gradients), g = Lock number x speed/8.
    Without flapping states: L += L late q, M -= M late p.

    Source: Keller, J. American Helicopter Society 41 (1996); Zhao, Prasad and Peters (2004), wake curvature lag
    32/(15 pi lambda0 speed).
    """

    id, stage, role = "rotor.wake_distortion", Stage.ROTOR, Role.UNDECLARED
    needs = (
        Needs.RATES,
        Needs.NOT_MULTIROTOR,
        lambda spec: Needs.ROTOR(spec) if spec.flapping == "first order" else None,
    )

    def __init__(self, tau: float, rotor: RotorSpec | None) -> None:
        times = (0.05, 1.5)
        start = inside(tau, times)
        late = Parameter("tau", start, "s", times, 0.5 * start, doc="time in which the wake curves", typical=start)
        parameters = [Parameter("K_R", 0.0, "1", (0.0, 3.0), doc="curvature of the wake", typical=1.5)]
        if rotor is None:
            roll, pitch = "roll acceleration by the late pitch rate", "less pitch acceleration by the late roll rate"
            rows = ("L", roll, 1.0), ("M", pitch, 0.3)
            parameters = [Parameter(n, 0.0, "1/s", (-10.0, 10.0), doc=d, typical=t) for n, d, t in rows]
        docs = {"q": "pitch rate that the wake knows", "p": "roll rate likewise"}
        states = tuple(State(name, "rad/s", doc, spread=REMEMBERED) for name, doc in docs.items())
        super().__init__((*parameters, late), states)
        self.rotor = rotor
        if rotor is not None:
            g, twice = damping_of(rotor), 2.0 * rotor.speed
            scale = g / (g * g + twice * twice)
            self.direct, self.cross, self.spin = g * scale, twice * scale, rotor.spin

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> WakeDistortion:
        """Time constant from the induced velocity where the nominal model has one; K_R where flapping is a state."""
        vi = spec.reference.get("vi")
        tau = 0.45 if vi is None or spec.rotor is None else 32.0 * spec.rotor.radius / (15.0 * math.pi * vi)
        return cls(tau, spec.rotor if spec.flapping == "first order" else None)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Turns the flapping rates, or adds L and M; the wake's own rates."""
        late_q, late_p = x.unbind(-1)
        q, roll = frame.signals["q"], frame.signals["p"]
        if self.rotor is None:
            zero = torch.zeros_like(p["L"] * late_q)
            moment = vec(p["L"] * late_q, -p["M"] * late_p, zero)
            return frame.add(moment=moment), (vec(q, roll) - x) / p["tau"][..., None]
        c, s = p["K_R"] * late_q, p["K_R"] * self.spin * late_p
        a1 = frame.rate("a1") + self.direct * c - self.cross * s
        b1 = frame.rate("b1") + self.cross * c + self.direct * s
        disc = vec(q + a1, roll + self.spin * b1)
        return frame.with_rates(a1=a1, b1=b1), (disc - x) / p["tau"].unsqueeze(-1)


@register
class Stall(Effect):
    """Retreating-blade stall: lift above a blade loading is lost, smoothly; the limit falls with speed and with rates.

    Z += loss c softplus((T/c + 16 a/(6 Lock number) |p, q|/speed - limit (1 - mu/2))/width) width, with c the thrust at
    blade loading one, rho A_blades (speed R)^2/m, lift slope a = 5.7, advance ratio mu, width 0.005.

    Source: Padfield, Helicopter Flight Dynamics, fig. 3.3 ff.; McHugh (1978), What are the lift and propulsive force
    limits at high speed for the conventional rotor?
    """

    id, stage, role = "rotor.stall", Stage.FORCES, Role.UNDECLARED
    needs = (Needs.ROTOR, Needs.MASS, Needs.FORCES, Needs.VELOCITIES, Needs.RATES)
    separated_by = "flights trimmed at other speeds"
    WIDTH = 0.005

    def __init__(self, rotor: RotorSpec, air_density: float, mass: float) -> None:
        super().__init__(
            (
                Parameter(
                    "loss", 0.0, "1", (0.0, 3.0), doc="share of the lift above the limit that is lost", typical=0.8
                ),
                Parameter("limit", 0.12, "1", (0.04, 0.25), 0.02, doc="blade loading at which it begins", typical=0.12),
            )
        )
        tip = rotor.speed * rotor.radius
        self.tip, self.full = tip, air_density * rotor.blades * rotor.chord * rotor.radius * tip**2 / mass
        self.by_rate = 16.0 * LIFT_SLOPE / (6.0 * (rotor.lock_number or USUAL_LOCK) * rotor.speed)

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Stall:
        """From the declared rotor, mass and air density."""
        assert spec.rotor is not None
        assert spec.mass is not None
        return cls(spec.rotor, spec.air_density, spec.mass)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Takes the lost lift away."""
        assert frame.force is not None
        u, v, roll, pitch = (frame.signals[n] for n in ("u", "v", "p", "q"))
        mu = torch.sqrt(u * u + v * v + 1e-6) / self.tip
        rate = torch.sqrt(roll * roll + pitch * pitch + 1e-12)
        above = -frame.force[..., 2] / self.full + self.by_rate * rate - p["limit"] * (1.0 - 0.5 * mu)
        lost = p["loss"] * self.full * self.WIDTH * softplus(above / self.WIDTH)
        zero = torch.zeros_like(lost)
        return frame.add(vec(zero, zero, lost)), x
