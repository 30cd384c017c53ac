"""What cannot be told is named: missing channels, sticks, wind, control powers that no inertia explains."""

import msgspec
import numpy as np
import pytest

from rotorid_torch.data import Dataset
from rotorid_torch.effects.examples import HELICOPTER, MULTIROTOR
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.report import limits
from rotorid_torch.report.records import FitRecord, ParameterRecord, ScoresRecord

TIME = 0.02 * np.arange(200)


def data(*channels: str, kind: str = "helicopter", unit: str = "rad") -> Dataset:
    controls = ("motor1",) if kind == "multirotor" else ("lat",)
    flight = {"time": TIME, **{c: np.sin(TIME * (k + 1)) for k, c in enumerate((*controls, *channels))}}
    return Dataset.from_arrays({"f": flight}, identify=["f"], kind=kind, controls={c: {"unit": unit} for c in controls})


def spec(**changes: object) -> ModelSpec:

    return msgspec.structs.replace(HELICOPTER, flapping="none", control_units={"lat": "norm"}, **changes)


def test_missing_velocities_and_what_is_left_of_them():
    told = list(
        limits.of_channels(data("p", "q", "r", "u", unit="norm"), spec(states=("p", "q", "r"), outputs=("p", "q", "r")))
    )
    assert told[0].startswith("v, w, phi, theta not measured in every identify flight: u v w are no states")
    assert any(t.startswith("phi and theta are not measured") for t in told)
    assert any(t.startswith("u measured, but not all") and "not scored" in t for t in told)
    assert any(t.startswith("lat: sticks in units of full travel") for t in told)


def test_a_flight_that_lacks_channels_of_the_others_is_named():
    full = {"time": TIME, **{c: np.sin(TIME * (k + 1)) for k, c in enumerate(("lat", "p", "q", "r", "ax", "az"))}}
    bare = {name: values for name, values in full.items() if name not in ("ax", "az")}
    flights = {"a": full, "b": bare, "c": bare, "d": bare}
    several = Dataset.from_arrays(flights, identify=["a", "b", "c"], validate=["d"], controls={"lat": {}})
    told = list(limits.of_channels(several, spec()))
    assert told[0].startswith("b, c: no ax az, which other identify flights have")


def test_a_model_of_sticks_alone_says_what_it_leaves_out():
    sticks = data("u", "v", "w", "p", "q", "r", "phi", "theta", unit="norm")
    bare = spec(mass=None, inertia=None, rotor=None)
    (told,) = (t for t in limits.of_channels(sticks, bare) if t.startswith("lat: sticks"))
    assert "moments have derivatives by their own rate and the sticks alone, X and Y by their own velocity" in told
    assert not any("by their own rate" in t for t in limits.of_channels(sticks, spec()))


def test_wind_is_told_unless_airspeed_is_measured():
    body = ("u", "v", "w", "p", "q", "r", "phi", "theta")
    told = list(limits.of_channels(data(*body), spec()))
    assert any("a wind is part of what goes with them" in t for t in told)
    assert any(t.startswith("no flapping measured") for t in told)
    assert not any("wind" in t for t in limits.of_channels(data(*body, "airspeed"), spec()))


def test_where_motors_stand_is_told_as_far_as_flights_say_it():
    said = lambda found: list(  # noqa: E731
        limits.of_channels(
            data("p", "q", "r", "az", kind="multirotor"), msgspec.structs.replace(MULTIROTOR, found_places=found)
        )
    )
    (told,) = (t for t in said({"L": 0.9, "M": 0.8}) if "places are not declared" in t)
    assert "motor1 ahead right, motor2 behind right, motor3 behind left, motor4 ahead left" in told
    assert "N not testable" in told
    assert any("L M N not testable" in t for t in said({}))
    assert not any("places are not declared" in t for t in said(None))


def fit_with(*parameters: ParameterRecord) -> FitRecord:
    none = ScoresRecord(identify=None, validate=None, acid=None)
    return FitRecord(parameters=parameters, modes=(), flights={}, scores=none)


def powers(**values: float | None) -> FitRecord:
    """A fit with these control powers; None: held at zero."""
    names = {row: f"rotors.power.{row}" for row in values}
    return fit_with(
        *(
            ParameterRecord(name=names[r], value=v or 0.0, se=0.01, unit="1", status="frozen" if v is None else "free")
            for r, v in values.items()
        )
    )


def test_control_powers_are_told_as_inertia_as_far_as_that_is_credible():
    said = list(limits.of_rotors(MULTIROTOR, powers(L=0.625, M=0.1, N=3.0)))
    assert "an inertia about x of 2.66e-05 kg m² (+60 %)" in said[0]
    assert said[1].startswith("control power of M is 0.1 of what places, thrust and declared inertia give: no inertia")
    assert len(said) == 2  # of yaw nothing: the torque ratio is not declared
    assert list(limits.of_rotors(MULTIROTOR, powers(L=1.0, M=0.95, N=1.0))) == []


def test_moments_that_commands_do_not_explain_are_not_testable():
    (said,) = limits.of_rotors(MULTIROTOR, powers(L=None, M=None, N=None))
    assert said.startswith("L M N not testable")
    unknown = msgspec.structs.replace(MULTIROTOR, found_places={"L": 0.9, "M": 0.9})
    (said,) = limits.of_rotors(unknown, powers(L=5e4, M=5e4, N=None))
    assert said.startswith("N not testable")


def test_a_tail_sitter_without_its_elevons_says_what_is_missing():
    pair = tuple(
        msgspec.structs.replace(m, position=(0.0, y, 0.0))
        for m, y in zip(MULTIROTOR.motors[:2], (0.1, -0.1), strict=True)
    )
    spec = msgspec.structs.replace(MULTIROTOR, controls=("motor1", "motor2"), motors=pair)
    silent, missing = limits.of_rotors(spec, powers(L=1.0, M=None, N=1.0))  # pyright: ignore[reportArgumentType]
    assert silent.startswith("M not testable")
    assert missing.startswith("no motor turns the vehicle in M where it stands")


@pytest.mark.parametrize(
    ("cone", "tilt", "doubt", "told"),
    [
        (100.0, 12.0, 1.0, True),  # coning at once, tilt late
        (100.0, 12.0, 8.0, False),  # perhaps not late
        (34.0, 11.6, 0.5, False),  # a UH-60's blades, J-GenHel
        (140.0, 140.0, 2.0, False),  # both at once, helisim
        (100.0, -0.5, 0.1, False),  # no lag at all
    ],
)
def test_a_disc_that_cones_at_once_and_tilts_late_is_remarked_upon(cone: float, tilt: float, doubt: float, told: bool):
    poles = {"rotor.a0.a0": (-cone, 5.0), "rotor.a1.a1": (-tilt, doubt), "rotor.b1.b1": (-cone, 3.0)}
    fit = fit_with(*(ParameterRecord(name=n, value=v, se=e, unit="1/s") for n, (v, e) in poles.items()))
    found = list(limits.of_flapping(fit))
    assert len(found) == told
    if told:
        assert found[0].startswith("a1 follows lon within 0.083 s, the coning follows col within 0.01 s")


def test_a_rotor_without_flapping_states_is_not_remarked_upon():
    fit = fit_with(ParameterRecord(name="forces.L.p", value=-1.0, se=None, unit="1/s"))
    assert list(limits.of_flapping(fit)) == []
