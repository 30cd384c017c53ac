"""Two declared vehicles as specs, for the table of effects: each effect is shown with the numbers of one of them."""

from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS, RATES, SPECIFIC_FORCES, STICKS, VELOCITIES
from rotorid_torch.effects.base import Effect
from rotorid_torch.effects.spec import ModelSpec, MotorSpec, RotorSpec

BODY = (*VELOCITIES, *RATES, "phi", "theta")
MOTORS = tuple(f"motor{k}" for k in range(1, 5))
ARM = 0.028
"""m: of the quadrotor's motors, forward and to the side."""
CHANNELS = (*SPECIFIC_FORCES, "pdot", "qdot", "rdot")
SIZES = {"u": 1.5, "v": 1.5, "w": 0.7, "p": 0.1, "q": 0.07, "r": 0.07, "phi": 0.1, "theta": 0.08}
ROWS = {f"row.{row}": size for row, size in zip((*FORCES, *MOMENTS), (0.5, 0.5, 1.0, 0.5, 0.3, 0.2), strict=True)}
TRIM = {"X.trim": 0.0, "Y.trim": 0.0, "Z.trim": -9.80665}

HELICOPTER = ModelSpec(
    states=BODY,
    controls=STICKS,
    outputs=(*BODY, *CHANNELS, *FLAPPING),
    reference=dict.fromkeys((*BODY, *STICKS, *FLAPPING, "psi"), 0.0) | TRIM | {"height": 12.0, "omega": 27.0},
    sizes=SIZES | ROWS | dict.fromkeys(STICKS, 0.02) | dict.fromkeys(FLAPPING, 0.02),
    ranges={},
    patterns=dict.fromkeys((*FORCES, *MOMENTS, *FLAPPING), (*VELOCITIES, *RATES, *FLAPPING, *STICKS)),
    control_units=dict.fromkeys(STICKS, "rad"),
    flapping="first order",
    mass=7440.0,
    inertia=((7630.0, 0.0, -2260.0), (0.0, 54200.0, 0.0), (-2260.0, 0.0, 50400.0)),
    hub=(0.4, 0.0, -1.7),
    imu=(0.8, -0.3, 0.5),
    rotor=RotorSpec(blades=4, radius=8.18, chord=0.53, speed=27.0, hinge_offset=0.381, lock_number=8.2),
)
"""A UH-60 in hover with measured flapping and without inflow in its nominal model."""

MULTIROTOR = ModelSpec(
    states=BODY,
    controls=MOTORS,
    outputs=(*BODY, *CHANNELS),
    inputs=("voltage",),
    reference=dict.fromkeys((*BODY, "psi"), 0.0) | dict.fromkeys(MOTORS, 0.6) | TRIM | {"height": 1.0, "voltage": 3.9},
    sizes=SIZES | ROWS | dict.fromkeys(MOTORS, 0.05),
    ranges={},
    patterns=dict.fromkeys((*FORCES, *MOMENTS), ()),
    control_units=dict.fromkeys(MOTORS, "norm"),
    mass=0.03,
    inertia=((1.66e-5, 0.0, 0.0), (0.0, 1.67e-5, 0.0), (0.0, 0.0, 2.93e-5)),
    motors=tuple(
        MotorSpec(position=(x * ARM, y * ARM, 0.0), spin=x * y) for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ),
    spins=(1.0, -1.0, 1.0, -1.0),
)
"""A small quadrotor in hover."""


def example(effect: type[Effect]) -> ModelSpec:
    """The vehicle that can test an effect, the helicopter where both or neither can."""
    return next((spec for spec in (HELICOPTER, MULTIROTOR) if effect.untestable(spec) is None), HELICOPTER)
