"""Effects of where and when the vehicle flies: ground, wind, gusts, vibration."""

from __future__ import annotations

import torch
from torch import Tensor

from rotorid_torch.core.names import INDUCED_SHARE, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.rigid import vec
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Role, Showing, Stage, Values
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.spec import ModelSpec, arm
from rotorid_torch.effects.testable import Needs, channel, without_motors

LOWEST = 0.3
"""Rotor radii: no rotor is nearer to the ground; below it the effect is held."""
NEAREST = 0.5
"""Radius over four heights at which a multirotor's ground effect grows no more."""
HEIGHT_KNOWN, HEADING_KNOWN = 0.3, 0.02
"""m, rad: how well channels tell them where a segment begins; free there, each segment would have its own wind."""


@register
class Ground(Effect):
    """Ground effect: near the ground the rotor's image takes part of the induced velocity away.

    g = (R/(4 z))^2/(1 + (V/vi)^2), z the hub's height above the ground. Where the model has an induced velocity,
    that of momentum theory falls to vi (1 - strength (g(h) - g(h_ref))); elsewhere a rotor of the same power carries
    more, T = T_out (1 + strength (G(h) - G(h_ref))), G = g/(1 - g). Strength is one in theory. The height is a state
    that starts at its channel.

    Source: Cheeseman and Bennett, ARC R&M 3021 (1955).
    """

    id, stage, role = "environment.ground", Stage.FORCES, Role.UNDECLARED
    needs = (channel("height"), lambda spec: None if spec.motors else Needs.ROTOR(spec), Needs.VELOCITIES, Needs.FORCES)
    separated_by = "flights at half a rotor diameter and at several"
    showing = Showing.OTHER_FLIGHTS

    def __init__(
        self, radius: float, hub: float, induced: float, reference: float, speed: float, inflow: bool = False
    ) -> None:
        super().__init__(
            (
                Parameter("strength", 0.0, "1", (0.0, 4.0), doc="share of what theory says of the image", typical=1.0),
                Parameter(
                    "ground", 0.0, "m", (-1e4, 1e4), free=False, doc="height of the ground in the channel's datum"
                ),
            ),
            (State("height", "m", "height of the reference point", "height", HEIGHT_KNOWN),),
        )
        self.radius, self.hub, self.induced = radius, hub, induced
        self.at = reference, speed * speed
        self.inflow = inflow
        if inflow:
            self.stage = Stage.ROTOR

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Effect:
        """From the declared rotor and hub; induced velocity by momentum theory in hover where it is known.

        A multirotor's has its radius and the height of its rotors free.
        """
        if spec.motors:
            return _GroundBelowRotors(arm(spec))
        assert spec.rotor is not None
        hub = 0.0 if spec.hub is None else -spec.hub[2]
        at = spec.reference
        induced = at.get("vi", 0.045 * spec.rotor.speed * spec.rotor.radius)
        speed = (at.get("u", 0.0) ** 2 + at.get("v", 0.0) ** 2) ** 0.5
        return cls(spec.rotor.radius, hub, induced, at["height"], speed, spec.inflow)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Tells what is left of the induced velocity, or adds the thrust gained; the rate of climb."""

        def image(height: Tensor | float, square: Tensor | float) -> Tensor:
            z = (height + self.hub - p["ground"]).clamp(min=LOWEST * self.radius)
            return (0.25 * self.radius / z).square() / (1.0 + square / self.induced**2)

        u, v = frame.signals["u"], frame.signals["v"]
        here, reference = image(x[..., 0], u * u + v * v), image(*self.at)
        climb = _climb(frame).unsqueeze(-1)
        if self.inflow:
            return frame.with_signals(
                **{INDUCED_SHARE: (1.0 - p["strength"] * (here - reference)).clamp(min=0.0)}
            ), climb
        assert frame.force is not None
        more = p["strength"] * (here / (1.0 - here) - reference / (1.0 - reference))
        lift = more * frame.force[..., 2]
        zero = torch.zeros_like(lift)
        return frame.add(force=vec(zero, zero, lift)), climb


class _GroundBelowRotors(Effect):
    """Ground effect of a multirotor: near the ground its rotors thrust more at the same speed.

    T = T_out/(1 - (R/(4 z))^2), z = height + offset of all rotors alike. The images of several rotors act together, so
    that R is the radius of one rotor that does the same, larger than that of each; no more is lost than at z = R/2.

    Source: Cheeseman and Bennett, ARC R&M 3021 (1955); Sanchez-Cuevas, Heredia and Ollero (2017), International Journal
    of Aerospace Engineering, 1823056 (multirotors).
    """

    id, stage, role = Ground.id, Ground.stage, Ground.role
    separated_by, showing = Ground.separated_by, Ground.showing

    def __init__(self, arm: float) -> None:
        one, radii = "of one rotor that does what all do", (arm, 2.0 * arm, 4.0 * arm)
        datum = "rotors above the height's channel, and its datum above the ground"
        super().__init__(
            (
                Parameter("radius", 0.0, "m", (0.0, 10.0 * arm), doc=one, typical=2.0 * arm, tried=radii),
                Parameter("offset", 0.0, "m", (-5.0 * arm, 5.0 * arm), doc=datum, tried=(-arm, 0.5 * arm, arm)),
            ),
            (State("height", "m", "height of the reference point", "height", HEIGHT_KNOWN),),
        )
        self.least = 0.01 * arm

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the thrust gained; the rate of climb."""
        assert frame.force is not None
        share = p["radius"] / (4.0 * (x[..., 0] + p["offset"]).clamp(min=self.least))
        image = share.clamp(max=NEAREST).square()
        lift = image / (1.0 - image) * frame.force[..., 2]
        zero = torch.zeros_like(lift)
        return frame.add(force=vec(zero, zero, lift)), _climb(frame).unsqueeze(-1)


def _climb(frame: Frame) -> Tensor:
    """Rate of climb, m/s [...]."""
    u, v, w = frame.over_ground().unbind(-1)
    phi, theta = frame.signals["phi"], frame.signals["theta"]
    return u * torch.sin(theta) - (v * torch.sin(phi) + w * torch.cos(phi)) * torch.cos(theta)


@register
class Wind(Effect):
    """Steady wind: the air moves, so velocities through it change with the heading.

    (u, v, w)_air = (u, v, w) - W(psi, theta, phi) + W_ref with W the wind in body axes; W_ref, at the reference's
    attitude and mean heading, belongs to the trims. A multirotor's drag is no derivative about a reference: it is all
    that the air does, and grows with the rotors' speed, so that W_ref is zero. `north` and `east` say where the air
    goes. The heading is a state that starts at its channel.

    Source: Etkin, Dynamics of Atmospheric Flight, sec. 5.4 (moving atmosphere).
    """

    id, stage, role = "environment.wind", Stage.ENVIRONMENT, Role.UNDECLARED
    needs = (channel("psi"), Needs.VELOCITIES)
    separated_by = "flights on several headings"
    showing = Showing.OTHER_FLIGHTS
    acts_through = "propulsion.rotor_drag"

    def __init__(self, attitude: tuple[float, float, float] | None) -> None:
        doc, bounds, sizes = "speed of the air to the ", (-30.0, 30.0), {"north": 5.0, "east": 3.0}
        wind = (Parameter(n, 0.0, "m/s", bounds, doc=f"{doc}{n}", typical=t) for n, t in sizes.items())
        super().__init__(tuple(wind), (State("psi", "rad", "heading", "psi", HEADING_KNOWN),))
        self.attitude = attitude

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Wind:
        """About the reference's attitude and heading; of a multirotor as it is."""
        at = spec.reference
        return cls(None if spec.motors else (at.get("phi", 0.0), at.get("theta", 0.0), at["psi"]))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Velocities through the air; the rate of the heading."""
        phi, theta, psi = frame.signals["phi"], frame.signals["theta"], x[..., 0]
        wind = self._in_body(p, phi, theta, psi)
        if self.attitude is not None:
            wind = wind - self._in_body(p, *(torch.as_tensor(a, dtype=x.dtype) for a in self.attitude))
        air = frame.stack(VELOCITIES) - wind
        turn = (frame.signals["q"] * torch.sin(phi) + frame.signals["r"] * torch.cos(phi)) / torch.cos(theta)
        return frame.with_air(*air.unbind(-1)), turn.unsqueeze(-1)

    @staticmethod
    def _in_body(p: Values, phi: Tensor, theta: Tensor, psi: Tensor) -> Tensor:
        """The wind in body axes [..., 3]."""
        ahead = p["north"] * torch.cos(psi) + p["east"] * torch.sin(psi)
        side = p["east"] * torch.cos(psi) - p["north"] * torch.sin(psi)
        down = ahead * torch.sin(theta)
        right, below = down * torch.sin(phi) + side * torch.cos(phi), down * torch.cos(phi) - side * torch.sin(phi)
        return vec(ahead * torch.cos(theta), right, below)


class _Stochastic(Effect):
    """Changes nothing in the mean: its parameters are sizes, found in the innovations, never by trajectories."""

    stage, role, showing = Stage.ENVIRONMENT, Role.UNDECLARED, Showing.INNOVATIONS


@register
class Turbulence(_Stochastic):
    """Turbulence: gusts of this intensity shake the vehicle; nothing changes in the mean.

    A deterministic run cannot know the gusts, so the model's rates stay as they are; intensity and length describe the
    spectrum S(w) = 2 sigma^2 L/(V (1 + (L w/V)^2)) that the innovations of a filter show.

    Source: MIL-HDBK-1797, Dryden form; Tischler and Remple, sec. 11 (process noise and filter error).
    """

    id = "environment.turbulence"
    _sensed = "a controller moves a multirotor from the first sample on, with its sensors' noise as with gusts"
    needs = (without_motors(_sensed), Needs.RATES)

    def __init__(self) -> None:
        super().__init__(
            (
                Parameter("intensity", 0.0, "m/s", (0.0, 20.0), free=False, doc="rms of the gusts", typical=1.0),
                Parameter("length", 50.0, "m", (1.0, 1000.0), free=False, doc="scale of the gusts", typical=50.0),
            )
        )


@register
class Vibration(_Stochastic):
    """Vibration: lines at multiples of the rotor speed in the sensors; nothing changes in the mean.

    A free run cannot know their phase, so the outputs stay as they are; the rms of the lines per group of channels
    describes what the innovations' spectrum shows at 1/rev and at N/rev.

    Source: Johnson, Helicopter Theory, sec. 8-4 (vibratory hub loads); Padfield, Helicopter Flight Dynamics, sec. 8.
    """

    id = "environment.vibration"
    needs = (Needs.ROTOR, Needs.RATES)

    def __init__(self, channels: tuple[str, ...], speed: float, blades: int) -> None:
        groups = (("rates", RATES, "rad/s", 1.0, 0.01), ("accelerations", SPECIFIC_FORCES, "m/s2", 20.0, 0.5))
        super().__init__(
            tuple(
                Parameter(n, 0.0, unit, (0.0, most), free=False, doc=f"rms of the lines in the {n}", typical=t)
                for n, members, unit, most, t in groups
                if set(members) & set(channels)
            )
        )
        self.lines = (speed, blades * speed)

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Vibration:
        """Lines of the declared rotor, rad/s."""
        assert spec.rotor is not None
        return cls(spec.outputs, spec.rotor.speed, spec.rotor.blades)
