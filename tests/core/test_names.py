"""The table of channels holds every name of the format, and its families."""

import pytest

from rotorid_torch.core import names
from rotorid_torch.errors import nearest

FORMAT = """time lon lat col ped voltage u v w p q r phi theta psi north east height ax ay az pdot qdot rdot airspeed
alpha beta a0 a1 b1 omega torque motor1 motor4 omega1 omega12""".split()


@pytest.mark.parametrize("name", FORMAT)
def test_every_channel_of_the_format_has_a_unit_and_a_sentence(name):
    known = names.channel(name)
    assert known is not None
    assert known.name == name
    assert known.unit
    assert known.about


@pytest.mark.parametrize("name", ["motor0", "motor", "motorx", "omega01", "U", "phi_cmd", ""])
def test_other_names_are_nobodys(name):
    assert names.channel(name) is None
    assert names.unit(name) == ""
    assert names.default_bias(name) == "none"


def test_controls_come_in_canonical_order():
    given = ["motor10", "ped", "p", "motor2", "lon", "col", "lat"]
    assert names.ordered_controls(given) == ("lon", "lat", "col", "ped", "motor2", "motor10")


def test_gyros_and_accelerometers_have_a_free_bias():
    free = [name for name in names.CHANNELS if names.default_bias(name) == "free"]
    assert free == ["p", "q", "r", "ax", "ay", "az", "pdot", "qdot", "rdot"]


def test_misspelt_names_get_a_hint():
    assert nearest("thetta", names.CHANNELS) == " (did you mean 'theta'?)"
    assert nearest("zzz", names.CHANNELS) == ""
