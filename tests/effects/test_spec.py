"""A spec with more effects, or with fewer: what each control has for itself goes with the effect."""

from tests.known_models import body_spec


def test_an_effect_joins_and_leaves_with_what_it_is_for_each_control():
    spec = body_spec().with_effects("forces.drag")
    richer = spec.with_effects("control.delay", each_control=True).with_effects("control.lag")
    assert richer.effects == ("forces.drag", "control.delay", "control.lag")
    assert richer.each_control == ("control.delay",)
    assert richer.without(["control.delay", "control.lag", "mass.cg"]) == spec
