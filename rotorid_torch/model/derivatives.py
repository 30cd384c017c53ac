"""Forces and moments on the body: derivatives about the reference, and declared physics beyond the tangent.

Forces are specific (m/s2, force over mass), moments are angular accelerations (rad/s2, inertia^-1 times moment), so
that the derivatives exist without mass and inertia and have the textbook units.
"""

import math

import torch
from torch import Tensor

from rotorid_torch.core.names import FORCES
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.rigid import cross, vec
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.model.linear_equations import LinearBlock, LinearEffect

TAIL_UNITS = {
    "Y": {"pedal_speed": "1/(s rad)", "speed_speed": "1/m", "pedal_pedal": "m/(s2 rad2)"},
    "L": {"pedal_speed": "1/(m s)", "speed_speed": "rad/m2", "pedal_pedal": "1/(s2 rad)"},
    "N": {"pedal_speed": "1/(m s)", "speed_speed": "rad/m2", "pedal_pedal": "1/(s2 rad)"},
}
TAIL_LAG, TAIL_LAGS = 0.04, (0.02, 0.3)
"""s: apparent mass of the air that a tail rotor of a fifth of the main rotor's size moves, over the flow through it."""
FOLLOWED, FELT = "pedal_late", "pedal_felt"
LATE = 0.2
"""What the motion before does not tell of a followed pedal where a segment begins, over the pedal's rms excursion."""


class LinearForces(LinearEffect):
    """Stability and control derivatives: rows X Y Z (m/s2) and L M N (rad/s2), about the reference.

    Source: Etkin and Reid, Dynamics of Flight (3rd ed.), sec. 4.
    """

    id, stage, role = "forces", Stage.FORCES, Role.NOMINAL

    def __init__(self, block: LinearBlock, reference: Tensor) -> None:
        super().__init__(block, reference)
        self.forces = [i for i, r in enumerate(block.rows) if r in FORCES]

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the linear forces and moments."""
        felt = frame.with_signals(ped=frame.signals[FELT]) if FELT in frame.signals else frame
        rows = self.values(felt, p)
        n = len(self.forces)
        return frame.add(rows[..., :n] if n else None, rows[..., n:] if n < rows.shape[-1] else None), x


class ThrustTilt(Effect):
    """Actual thrust, not trim thrust, tilts with the disc: beyond the tangent, (T - T0) times the tilt, at the hub.

    Specific: X -= x (T - T0)/m (a1 - a1ref), Y += y s (T - T0)/m (b1 - b1ref), s = +1 for a rotor that turns
    counter-clockwise seen from above; moments by the hub's arm, gains l and m. Gains are 1 in the physics.

    Source: Padfield, Helicopter Flight Dynamics, sec. 3.2 (hub forces and moments, disc-plane thrust).
    """

    id, stage, role = "rotor.tilt", Stage.FORCES, Role.NOMINAL
    arm: Tensor
    inverse: Tensor

    def __init__(
        self, hub: Tensor, mass: float, inertia: Tensor, spin: float, reference: dict[str, float], thrust: float
    ) -> None:
        doc = "share of the physical term"
        super().__init__(tuple(Parameter(n, 1.0, "1", (-3.0, 5.0), 0.5, doc=doc) for n in ("X", "Y", "L", "M")))
        self.spin, self.thrust = spin, thrust
        self.a1, self.b1 = reference["a1"], reference["b1"]
        self.register_buffer("arm", mass * hub)
        self.register_buffer("inverse", torch.linalg.inv(inertia))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds what the thrust beyond trim does by its tilt."""
        assert frame.force is not None
        more = -frame.force[..., 2] - self.thrust
        forward = -more * (frame.signals["a1"] - self.a1)
        side = self.spin * more * (frame.signals["b1"] - self.b1)
        zero = torch.zeros_like(forward)
        moment = cross(self.arm, vec(p["M"] * forward, p["L"] * side, zero)) @ self.inverse.mT
        return frame.add(vec(p["X"] * forward, p["Y"] * side, zero), moment), x


class TailRotor(Effect):
    """Tail rotor beyond the tangent: pitch times side speed, side speed times its size, pitch squared; in Y, L, N.

    Side speed at the tail: v - arm r.

    Source: Padfield, Helicopter Flight Dynamics, sec. 3.2 (tail rotor thrust by blade element and momentum theory).
    """

    id, stage, role = "tail", Stage.FORCES, Role.NOMINAL

    def __init__(self, arm: float, reference: dict[str, float], sizes: dict[str, float]) -> None:
        pedal, speed = sizes.get("ped", 1.0), math.hypot(sizes.get("v", 1.0), arm * sizes.get("r", 1.0))
        terms = {"pedal_speed": pedal * speed, "speed_speed": speed * speed, "pedal_pedal": pedal * pedal}
        rows = {row: sizes.get(f"row.{row}", 1.0) for row in TAIL_UNITS}
        sd = {f"{row}.{t}": rms / max(size, 1e-12) for row, rms in rows.items() for t, size in terms.items()}
        units = {f"{row}.{term}": unit for row, by_term in TAIL_UNITS.items() for term, unit in by_term.items()}
        super().__init__(tuple(Parameter(name, 0.0, units[name], prior_sd=sd[name]) for name in sd))
        self.arm, self.ped, self.v, self.r = arm, reference["ped"], reference["v"], reference["r"]

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds side force, roll and yaw of the tail rotor's quadratic terms."""
        pedal = frame.signals["ped"] - self.ped
        speed = frame.signals["v"] - self.v - self.arm * (frame.signals["r"] - self.r)
        terms = vec(pedal * speed, speed * speed.abs(), pedal * pedal)
        rows = p.vector.unflatten(-1, (3, 3))
        y, roll, yaw = (terms.unsqueeze(-2) * rows).sum(-1).unbind(-1)
        zero = torch.zeros_like(y)
        return frame.add(vec(zero, y, zero), vec(roll, zero, yaw)), x


class TailInflow(Effect):
    """The tail rotor's inflow, which follows its pitch: until it has built up, a pedal does more than it does later.

    tau dx/dt = (ped - ped0) - x; the linear forces and moments feel ped + overshoot (ped - ped0 - x) in place of
    ped, so that derivatives by the pedal stay those of slow motion. By momentum theory the overshoot in hover is
    solidity times lift slope over 16 times the inflow ratio, near 0.8; in forward flight it is less. The time constant,
    apparent mass over thrust by inflow, is near 0.04 s; it is held, for flights tell little more than both together.

    Source: Carpenter and Fridovich, NACA TN 3044 (1953), thrust after a sudden pitch; Padfield, Helicopter Flight
    Dynamics, sec. 3.2 (tail rotor inflow).
    """

    id, stage, role = "tail_inflow", Stage.ROTOR, Role.NOMINAL

    def __init__(self, reference: dict[str, float], sizes: dict[str, float], unit: str) -> None:
        spread, lag = LATE * max(sizes.get("ped", 1.0), 1e-12), "time constant of the tail rotor's inflow"
        super().__init__(
            (
                Parameter("tau", TAIL_LAG, "s", TAIL_LAGS, TAIL_LAG, free=False, doc=lag),
                Parameter("overshoot", 0.0, "1", (0.0, 3.0), 1.0, doc="what a pedal does more at once than later"),
            ),
            (State(FOLLOWED, unit, "pedal that the tail rotor's inflow has followed", spread=spread),),
        )
        self.ped = reference["ped"]

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """The pedal as forces and moments feel it; the rate of the state."""
        pedal = frame.signals["ped"]
        ahead = pedal - self.ped - x[..., 0]
        return frame.with_signals(**{FELT: pedal + p["overshoot"] * ahead}), (ahead / p["tau"]).unsqueeze(-1)


class Tailplane(Effect):
    """Tailplane beyond the tangent: lift and pitching moment grow with the square of the flow where it stands.

    With perturbations du, dv_t = dv - arm dr, dw_t = dw + arm dq of the flow at the tail: M += uu du^2 + uw du dw_t +
    ww dw_t^2 + vv dv_t^2 (dynamic pressure, incidence, and the main rotor's wake that sideslip shifts over the tail);
    Z += uw du dw_t.

    Source: Padfield, Helicopter Flight Dynamics, sec. 3.2 (empennage, fuselage and rotor wake on it).
    """

    id, stage, role = "tailplane", Stage.FORCES, Role.NOMINAL
    terms = (("Z", "uw"), ("M", "uu"), ("M", "uw"), ("M", "ww"), ("M", "vv"))

    def __init__(self, arm: float, reference: dict[str, float], sizes: dict[str, float]) -> None:
        flow = {
            "u": sizes.get("u", 1.0),
            "v": math.hypot(sizes.get("v", 1.0), arm * sizes.get("r", 1.0)),
            "w": math.hypot(sizes.get("w", 1.0), arm * sizes.get("q", 1.0)),
        }
        units = {"Z": "1/m", "M": "rad/m2"}
        declared = []
        for row, term in self.terms:
            sd = sizes.get(f"row.{row}", 1.0) / max(flow[term[0]] * flow[term[1]], 1e-12)
            declared.append(Parameter(f"{row}.{term}", 0.0, units[row], prior_sd=sd))
        super().__init__(tuple(declared))
        self.arm, self.at = arm, {n: reference[n] for n in ("u", "v", "w", "q", "r")}

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds lift and pitching moment of the tailplane's quadratic terms."""
        du, dv, dw, dq, dr = (frame.signals[n] - self.at[n] for n in ("u", "v", "w", "q", "r"))
        w, v = dw + self.arm * dq, dv - self.arm * dr
        pitch = du * (p["M.uu"] * du + p["M.uw"] * w) + p["M.ww"] * w * w + p["M.vv"] * v * v
        zero = torch.zeros_like(pitch)
        return frame.add(vec(zero, zero, p["Z.uw"] * du * w), vec(zero, pitch, zero)), x
