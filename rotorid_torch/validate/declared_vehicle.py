"""Whether the declared mass, arms and inertia of a multirotor can be, by what its motors do."""

from collections.abc import Iterator

from rotorid_torch.consistency.examination.check import Examined
from rotorid_torch.consistency.examination.finding import Finding, finding
from rotorid_torch.core.names import RATES
from rotorid_torch.identification.mixer import Power, declared_powers
from rotorid_torch.identification.structure import motor_commands, rotor_speeds
from rotorid_torch.model.rotors import BELIEVED


def of_declaration(examined: Examined) -> Iterator[Finding]:
    """Declared mass, places and inertia that cannot be, by what the motors do; none where an error is found.

    Rates that go against the motors, or hardly with them, accuse no size: motors are numbered or placed otherwise.
    """
    flown = examined.flown
    vehicle, powers = flown.vehicle, dict[str, Power]()
    if examined.fit and examined.comparable is not None and flown.kind == "multirotor":
        powers = declared_powers(flown, rotor_speeds(flown) or motor_commands(flown))
    small = {rate: power.low for rate, power in powers.items() if power.low >= BELIEVED[1]}
    large = {rate: power.high for rate, power in powers.items() if power.low > 0.0 and power.high <= BELIEVED[0]}
    for rates, power, words in (
        (large, min(large.values(), default=1.0), ("at least", "large", "small", "less")),
        (small, max(small.values(), default=1.0), ("at most", "small", "large", "more")),
    ):
        if not rates or vehicle.mass is None or vehicle.inertia is None:
            continue
        bound, size, other, beyond = words
        inertia = " and ".join(f"{vehicle.inertia[k][k]:.3g}" for k in map(RATES.index, rates))
        arm = max(abs(m.position[k]) for m in vehicle.motors for k in (0, 1))
        yield finding(
            "warning",
            " ".join(rates),
            f"the declared mass ({vehicle.mass:g} kg), places of the motors ({arm:.3g} m) and inertia ({inertia} kg m²)"
            f" give {bound} {1.0 / power:.2g} times the measured angular acceleration: mass or places are too {size},"
            f" or the inertia too {other}; a mass of {vehicle.mass * power:.2g} kg or {beyond} alone would explain it.",
            "Correct [vehicle]; until then models hold these rates, or are of another vehicle.",
        )
