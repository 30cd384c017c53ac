"""Vehicle files: scaling, blades in or out of the mass, the other sense of rotation, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from rotorid_torch.errors import InputError
from rotorid_torch.simulation import fly
from rotorid_torch.simulation.flight.trim import find_trim
from rotorid_torch.simulation.vehicles.vehicle import load_aircraft
from tests.helpers import shared

BO105 = """name = "bo105"
[vehicle]
mass = 2096.0
inertia = [[1803.0, 0.0, 0.0], [0.0, 4892.0, 0.0], [0.0, 0.0, 4428.0]]
hub = [0.018, 0.0, -1.48]
[vehicle.rotor]
blades = 4
radius = 4.91
chord = 0.27
speed = 44.4
hinge_offset = 0.7
"""
LIGHT = """name = "light"
[vehicle]
mass = 2000.0
[vehicle.rotor]
blades = 3
radius = 5.3
"""


def saved(tmp_path: Path, text: str) -> Path:
    """A vehicle file."""
    path = tmp_path / "vehicle.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_undeclared_values_scale_from_the_uh60(tmp_path):
    """Blades and tails of a 2-ton aircraft: near the Bo-105's (flap inertia 220 to 232 kg m^2, tail arm 6 m)."""
    aircraft = load_aircraft(saved(tmp_path, BO105))
    assert aircraft.name == "bo105"
    assert aircraft.rotor.flap_inertia == pytest.approx(225.0, rel=0.1)
    assert -aircraft.tail.position[0] == pytest.approx(5.9, rel=0.1)
    assert aircraft.rotor.speed == 44.4


def test_blades_are_taken_out_of_mass_and_inertia(tmp_path):
    """Masses add up, and the centre of gravity of body and blades is the declared one."""
    aircraft = load_aircraft(saved(tmp_path, BO105))
    blades = aircraft.rotor.blades * aircraft.rotor.blade_mass
    assert aircraft.mass + blades == pytest.approx(2096.0)
    shift = np.asarray(aircraft.rotor.hub) - [0.018, 0.0, -1.48]
    np.testing.assert_allclose(aircraft.mass * -shift + blades * np.array([0.018, 0.0, -1.48]), 0.0, atol=1e-9)
    assert aircraft.inertia_matrix[0, 0] < 1803.0
    left_out = load_aircraft(saved(tmp_path, BO105.replace("[vehicle]\n", '[vehicle]\nmass_excludes = ["blades"]\n')))
    assert left_out.mass == 2096.0
    assert left_out.rotor.hub == (0.018, 0.0, -1.48)


def test_hub_stiffness_shows_in_the_bo105(tmp_path):
    """With a larger equivalent hinge offset the Bo-105 trims near its table: collective 14.3, bank -3.0 deg."""
    trim = find_trim(load_aircraft(saved(tmp_path, BO105)), 0.0)
    assert np.rad2deg(trim.controls[2]) == pytest.approx(14.3, abs=3.5)
    assert np.rad2deg(trim.state[6]) == pytest.approx(-3.0, abs=1.5)


def test_other_sense_of_rotation_is_the_mirror_image(tmp_path):
    """A clockwise rotor: the same flight in the mirror."""
    left = fly(None, vehicle=saved(tmp_path, LIGHT), flights=["dbl_col_p"], seconds=1.4)
    right_file = saved(tmp_path, LIGHT.replace("blades = 3", 'blades = 3\ndirection = "cw"'))
    right = fly(None, vehicle=right_file, flights=["dbl_col_p"], seconds=1.4)
    a, b = left.truth["dbl_col_p"], right.truth["dbl_col_p"]
    for name in ("u", "w", "q", "theta", "az", "a0", "a1", "ped", "M"):
        np.testing.assert_allclose(a[name], b[name], atol=1e-9)
    for name in ("v", "p", "r", "phi", "psi", "ay", "Y", "L", "N"):
        np.testing.assert_allclose(a[name], -b[name], atol=1e-9)
    assert right.declaration["vehicle"]["rotor"]["direction"] == "cw"
    assert right.declaration["controls"]["ped"]["positive"] == "nose right"
    assert left.declaration["controls"]["ped"]["positive"] == "nose left"


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("mass = 2000.0", "mass = -2000.0", "mass"),
        ("mass = 2000.0", "mass = 0.0", "mass"),
        ("mass = 2000.0", "mass = nan", "mass"),
        ("mass = 2000.0", 'mass = "2000"', "mass"),
        ("mass = 2000.0", "weight = 2000.0", "weight"),
        ("blades = 3", "blades = 1", "blades"),
        ("blades = 3", "blades = 2.5", "blades"),
        ("radius = 5.3", "radius = -5.3", "radius"),
        ("radius = 5.3", "radius = 5.3\nhinge_offset = 4.0", "hinge_offset"),
        ("radius = 5.3", 'radius = 5.3\ndirection = "up"', "direction"),
        ("mass = 2000.0", "mass = 2000.0\ninertia = [[1.0, 0, 0], [0, 2.0, 0], [0, 0, 9.0]]", "inertia"),
        ("mass = 2000.0", "mass = 2000.0\ninertia = [[900.0, 5.0, 0], [0, 2000.0, 0], [0, 0, 1900.0]]", "inertia"),
        ("[vehicle]", "[controls.lon]\nlimits = [0.2, -0.2]\n[vehicle]", "lon"),
        ("[vehicle]", "[blade]\nfirst_moment = 1e6\n[vehicle]", "first_moment"),
        ("[vehicle]", "[vehicle", "toml"),
    ],
)
def test_impossible_vehicles_are_refused(tmp_path, old, new, key):
    """One line that names the file and the key."""
    assert old in LIGHT
    with pytest.raises(InputError, match=key) as caught:
        load_aircraft(saved(tmp_path, LIGHT.replace(old, new, 1)))
    assert "vehicle.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file_is_refused(tmp_path):
    """A path that does not exist."""
    with pytest.raises(InputError, match=r"nothing\.toml"):
        load_aircraft(tmp_path / "nothing.toml")


def test_a_data_sets_declaration_is_a_vehicle_file():
    """The shared UH-60 set's dataset.toml flies; its rotor and mass are taken as declared."""
    aircraft = load_aircraft(shared("flightdata", "uh60-hover", "dataset.toml"))
    assert aircraft.mass == 6792.22
    assert aircraft.rotor.flap_inertia == pytest.approx(2051.0, rel=0.02)
    assert find_trim(aircraft, 0.0).residual < 1e-8
