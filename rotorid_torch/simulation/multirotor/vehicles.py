"""Multirotors by name: the one built in, and others drawn at random, from 27 g to 5 kg, of 4 to 8 rotors.

What a draw does not choose follows from mass and number of rotors, as it does among vehicles on sale.
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.simulation.multirotor.craft import Battery, Drive, Multirotor, Propeller
from rotorid_torch.simulation.multirotor.flight import Hover
from rotorid_torch.simulation.multirotor.rotor import Blades, lift_for
from rotorid_torch.simulation.rigid import Array, three

LIGHTEST, HEAVIEST = 0.027, 5.0
"""kg: of drawn vehicles."""
FRAMES = ("quad-x", "quad-+", "hexa-x", "hexa-+", "octa-x", "octa-+", "coaxial-x", "coaxial-y")
"""Numbers of rotors, and whether the nose points between two arms (x) or along one (+); coaxial pairs: X8 and Y6."""
ENDURANCE = 480.0
"""s of hover that a battery lasts."""
FLAT = 0.88
"""Inertia about the vertical axis over the sum of the others: 1 for a flat body, 0.5 for a ball."""
NOISE = {
    **dict.fromkeys(("u", "v", "w"), 0.02),
    **dict.fromkeys(("p", "q", "r"), 0.005),
    **dict.fromkeys(("phi", "theta", "psi"), 0.002),
    **dict.fromkeys(("north", "east", "height"), 0.005),
    **dict.fromkeys(("ax", "ay", "az"), 0.08),
    "voltage": 0.01,
    "motor": 0.0005,
}
"""Standard deviation of a sample, SI; that of a rotor's speed is 0.002 of its speed in hover."""
UNLIKE = 0.02
"""Standard deviation of the thrusts of rotors of one kind at the same speed, over their mean.

The widest class of ISO 484-2 (ship propellers) lets the mean pitch be 3 % off, of which blade elements make 4 % of
thrust: two standard deviations. Thrusts of four equal rotors differ on load cells: Kuantama et al., Symmetry 10 (2018).
"""
CANT = np.deg2rad(1.0)
"""Largest angle by which a rotor's axis leans, rad: ISO 2768-1, class m, sides up to 10 mm.

Source: ArduPilot, Thrust loss and yaw imbalance (axes that are not vertical are the usual cause of yaw out of balance).
"""
NAME = re.compile(r"multirotor-([0-9]{1,6})")


@dataclass(frozen=True)
class Build:
    """What a maker chooses: mass, kg, frame of `FRAMES`; the other numbers about 1 are over what is usual.

    `thrust` : most thrust over weight. `exponent`, `idle` : of the command, see `craft.Drive`. `rate` : Hz of the
    record. `blades`, `chord` (over the radius), `pitch`, `twist`, rad, `stiffness` : of the propellers, see
    `craft.Propeller`.
    """

    mass: float = 1.2
    frame: str = "quad-x"
    radius: float = 1.0
    arm: float = 1.1
    inertia: tuple[float, float, float] = (1.0, 1.08, 1.0)
    thrust: float = 2.4
    exponent: float = 1.0
    idle: float = 0.12
    rate: int = 100
    blades: int = 2
    chord: float = 0.18
    pitch: float = 0.34
    twist: float = -0.17
    stiffness: float = 0.4
    noise: float = 1.0
    telemetry: bool = False
    tilt: float = 0.0
    offsets: tuple[float, float] = (0.0, 0.0)


QUAD = Build()


def is_multirotor(name: object) -> bool:
    """Whether a vehicle of this name is a multirotor that `multirotor` has."""
    return name == "quad" or (isinstance(name, str) and NAME.fullmatch(name) is not None)


def multirotor(name: str) -> Multirotor:
    """The built-in vehicle, "quad", or one drawn at random by number, "multirotor-N".

    Raises InputError: another name.
    """
    if name == "quad":
        return built("quad", QUAD)
    form = NAME.fullmatch(name)
    if form is None:
        raise InputError(
            "usage", "vehicle", f"there is no multirotor '{name}'", "quad, or multirotor-N with a number N"
        )
    number = int(form[1])
    return with_unlike_rotors(built(name, drawn(number)), np.random.default_rng([number, 0x10F7]))


def with_unlike_rotors(craft: Multirotor, rng: np.random.Generator) -> Multirotor:
    """The vehicle with rotors that differ as those of one kind do: in thrust, and in the lean of their axes."""
    shares = 1.0 + UNLIKE * rng.standard_normal(craft.count)
    lifts = tuple(lift_for(craft.propeller, craft.air_density, float(share)) for share in shares)
    return replace(craft, lifts=lifts, cants=tuple(float(x) for x in rng.uniform(-CANT, CANT, craft.count)))


def drawn(number: int, rng: np.random.Generator | None = None) -> Build:
    """What the maker of the vehicle of this number has chosen; the same each time."""
    rng = rng or np.random.default_rng([number, 0x0517])
    mass = float(np.exp(rng.uniform(np.log(LIGHTEST), np.log(HEAVIEST))))
    frame = str(rng.choice(FRAMES if mass > 0.3 else FRAMES[:3]))
    return Build(
        mass=mass,
        frame=frame,
        radius=float(rng.uniform(0.9, 1.1)),
        arm=float(rng.uniform(1.0, 1.3)),
        inertia=tuple(float(x) for x in rng.uniform((0.85, 0.85, 0.93), (1.15, 1.15, 1.07))),  # pyright: ignore[reportArgumentType]
        thrust=float(rng.uniform(2.0, 3.2)),
        exponent=float(rng.choice([0.5, 0.7, 1.0])),
        idle=float(rng.uniform(0.0, 0.15)),
        rate=int(rng.choice([80, 100, 100, 200])),
        blades=int(rng.choice([2, 2, 3])),
        chord=float(rng.uniform(0.14, 0.22)),
        pitch=float(rng.uniform(0.28, 0.4)),
        twist=float(rng.uniform(-0.22, -0.1)),
        stiffness=float(rng.uniform(0.2, 0.8)),
        noise=float(np.exp(rng.uniform(np.log(0.6), np.log(1.8)))),
        telemetry=bool(rng.uniform() < 0.3),
        tilt=float(rng.uniform(0.0, 0.004)),
        offsets=(float(rng.uniform(0.0, 0.004)), float(rng.uniform(0.0, 0.08))),
    )


def built(name: str, build: Build) -> Multirotor:
    """The vehicle that a maker's choices give."""
    kind, _, form = build.frame.partition("-")
    axes = {"quad": 4, "hexa": 6, "octa": 8, "coaxial": 3 if form == "y" else 4}[kind]
    radius = 0.127 * (build.mass / 1.2) ** 0.42 * (4.0 / axes) ** 0.5 * build.radius
    arm = 1.15 * radius / np.sin(np.pi / max(axes, 4)) * build.arm
    places, spins = _frame(axes, arm, form, 0.35 * radius if kind == "coaxial" else 0.0)
    across = build.mass * (0.5 * arm) ** 2 * np.array(build.inertia[:2])
    inertia = np.diag([*across, FLAT * across.sum() * build.inertia[2]])
    propeller = Propeller(
        radius, build.chord * radius, build.blades, build.pitch, build.twist, stiffness=build.stiffness
    )
    speed = 1.0 + 3.0 * build.mass**0.4
    bare = Multirotor(
        name=name,
        mass=build.mass,
        inertia=_rows(inertia),
        places=places,
        spins=spins,
        lifts=(1.0,) * len(places),
        propeller=propeller,
        drive=Drive(1.0, build.idle, build.exponent),
        battery=Battery(1.0, 0.8, 0.0, 1.0, 1.0),
        speed=float(speed),
        height=float(max(1.2 * speed, 20.0 * arm)),
        rate=build.rate,
        telemetry=build.telemetry,
        tilt=build.tilt,
        offsets=build.offsets,
        noise={channel: value * build.noise for channel, value in NOISE.items()},
        resolution={"voltage": 0.005},
    )
    return _powered(bare, build)


def _powered(bare: Multirotor, build: Build) -> Multirotor:
    """With motors for its thrust over weight, and a battery of as many cells as its size has."""
    hover = Hover.of([bare], Blades.of([bare.propeller], np.array([bare.air_density])))
    power = float((hover.curve * hover.ratio * hover.speed**3).sum())
    cells = 1 if build.mass < 0.1 else 3 if build.mass < 0.8 else 4 if build.mass < 2.5 else 6
    current = power / 0.6 / (3.7 * cells)
    battery = Battery(
        full=4.18 * cells,
        empty=3.5 * cells,
        resistance=0.07 * 3.7 * cells / current,
        capacity=current * ENDURANCE,
        reference=(4.18 - 0.3 * 0.68) * cells - 0.07 * 3.7 * cells,
    )
    # in the thinnest wake a lower rotor gives less, so that a pair needs more speed than its share
    full = float(hover.speed.max()) * np.sqrt(build.thrust)
    noise = {**bare.noise, "omega": 0.002 * float(hover.speed.mean()), "voltage": 0.003 * cells}
    return replace(bare, drive=replace(bare.drive, full_speed=full), battery=battery, noise=noise)


def _frame(axes: int, arm: float, form: str, gap: float) -> tuple[tuple, tuple[int, ...]]:
    """Places of the rotors, m, front right first and clockwise seen from above, and their spins."""
    shift = {"x": 0.5, "+": 0.0, "y": 0.5}[form]
    angles = 2.0 * np.pi * (np.arange(axes) + shift) / axes
    ring = [(arm * np.cos(a), arm * np.sin(a), 0.0) for a in angles]
    if not gap:
        return tuple(three(p) for p in ring), tuple(1 if k % 2 == 0 else -1 for k in range(axes))
    upper = [three((x, y, -gap)) for x, y, _ in ring]
    lower = [three((x, y, gap)) for x, y, _ in ring]
    spins = [1 if k % 2 == 0 or axes % 2 else -1 for k in range(axes)]
    return (*upper, *lower), (*spins, *(-s for s in spins))


def _rows(matrix: Array) -> tuple:
    return tuple(three(row) for row in matrix)
