"""The table of ranges: every channel and declared quantity has one, real vehicles and sensors fit, the page agrees."""

from collections.abc import Iterator

import msgspec
import pytest

from rotorid_torch.core import names
from rotorid_torch.core.ranges import CHANNELS, DECLARED, DERIVED, OTHER, of_channel
from rotorid_torch.data.schema import Motor, Rotor, Vehicle
from rotorid_torch.importing.signals.mapping import DERIVED as FROM_LOGS
from tests.helpers import ROOT

UNITS = {name: ("rad", "m", "norm") for name in names.STICKS}
"""Channels in one of several units."""


@pytest.mark.parametrize("name", [*names.CHANNELS, "motor1", "motor12", "omega3", *FROM_LOGS])
def test_every_channel_has_a_range_in_its_unit(name):
    for unit in UNITS.get(name, (names.unit(name) or FROM_LOGS.get(name),)):
        row = of_channel(name, unit)
        assert row is not OTHER
        assert row.samples.unit == unit
        assert row.samples.low < row.samples.high
        assert row.noise is None or row.noise.high < row.samples.high
    assert of_channel(name) in CHANNELS


@pytest.mark.parametrize("name", ["motor0", "motorN", "somebody", "P", ""])
def test_other_names_have_the_range_of_others(name):
    assert of_channel(name) is OTHER or name == "motorN"


def leaves(kind, key):
    """Keys of the numbers of a struct, nested ones too."""
    for field in msgspec.structs.fields(kind):
        path = f"{key}.{field.encode_name}"
        if field.name in ("rotor", "motors"):
            yield from leaves({"rotor": Rotor, "motors": Motor}[field.name], path)
        elif field.name not in ("mass_excludes", "direction", "spin", "frame"):
            yield path


def test_every_declared_number_has_a_range_and_no_other_has():
    assert set(DECLARED) == set(leaves(Vehicle, "vehicle"))


REAL = {
    "vehicle.mass": (0.018, 0.027, 7257.0, 56_000.0, 105_000.0),
    "vehicle.inertia": (1e-5, 2e-5, 52_200.0, 2e6),
    "vehicle.gravity": (9.7639, 9.80665, 9.8337),
    "vehicle.air_density": (0.3, 1.225, 1.5),
    "vehicle.rotor.blades": (2, 8),
    "vehicle.rotor.radius": (0.023, 0.7, 8.18, 17.5),
    "vehicle.rotor.chord": (0.004, 0.53, 1.5),
    "vehicle.rotor.speed": (9.2, 27.0, 300.0, 5000.0),
    "vehicle.rotor.lock_number": (0.5, 8.1, 15.0),
    "vehicle.motors.torque_ratio": (0.0, 0.005964, 0.1),
}
"""Drones of 18 to 31 g, UH-60, Mi-26 and V-12; poles, equator and -40 degrees."""
SENSORS = {
    "ax": (16 * 9.80665, 30 * 9.80665),
    "p": (34.9, 69.8),
    "omega1": (5000.0, -5000.0),
    "airspeed": (150.0, -0.5),
    "height": (-430.0, 12_442.0),
    "north": (9_999_999.0, 5_500_000.0),
    "east": (834_000.0, 32_500_000.0),
    "voltage": (3.7, 800.0),
    "torque": (1e-3, 1.2e6),
    "psi": (-400.0, 6.3),
    "motor1": (0.0, 1.0),
}
"""Full scale of sensors on the market, and places on Earth in grid coordinates."""


@pytest.mark.parametrize("key", REAL)
def test_real_vehicles_fit(key):
    assert all(map(DECLARED[key].holds, REAL[key]))


@pytest.mark.parametrize("name", SENSORS)
def test_real_sensors_fit(name):
    assert all(map(of_channel(name).samples.holds, SENSORS[name]))


@pytest.mark.parametrize("allowed", [*DECLARED.values(), *DERIVED.values(), *(row.samples for row in CHANNELS)])
def test_a_range_holds_its_ends_and_nothing_beyond(allowed):
    assert allowed.holds(allowed.low)
    assert allowed.holds(allowed.high)
    beyond = (allowed.low - 1e-9 * abs(allowed.low) - 1e-12, 1.000001 * allowed.high, float("nan"), 1e300, -1e300)
    assert not any(map(allowed.holds, beyond))


@pytest.mark.parametrize(
    ("key", "value"),
    [("gravity", 3.71), ("gravity", 1.62), ("gravity", 32.174), ("air_density", 0.0), ("air_density", 0.02)],
)
def test_other_planets_and_units_do_not_fit(key, value):
    assert not DECLARED[f"vehicle.{key}"].holds(value)


def page() -> str:
    """The table as Markdown: channels with samples and noise, then what is declared and what follows from it."""
    return "\n".join((*_channels_page(), "", *_declared_page()))


def _channels_page() -> Iterator[str]:
    yield "| channel | samples | noise | what bounds the samples |"
    yield "|---|---|---|---|"
    for row in CHANNELS:
        noise = str(row.noise) if row.noise else "-"
        yield f"| {' '.join(f'`{name}`' for name in row.names)} | {row.samples} | {noise} | {row.samples.bound} |"
    yield f"| another name | {OTHER.samples} | {OTHER.noise} | {OTHER.samples.bound} |"


def _declared_page() -> Iterator[str]:
    yield "| declared | range | what bounds it |"
    yield "|---|---|---|"
    for key, allowed in DECLARED.items():
        yield f"| `{key}` | {allowed} | {allowed.bound} |"
    for what, allowed in DERIVED.items():
        yield f"| {what} | {allowed} | {allowed.bound} |"


def test_the_page_prints_the_table():
    assert page() in (ROOT / "docs" / "data-set.md").read_text(encoding="utf-8")
