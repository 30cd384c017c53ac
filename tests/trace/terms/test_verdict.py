"""One statement from all findings: what is named, what is a group, what stays without a name."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorid_torch.effects.families.control import RateLimit
from rotorid_torch.trace.terms.finding import EffectFinding, Unknown, Verdict
from rotorid_torch.trace.terms.verdict import statement

DELAY = EffectFinding("control.delay", "undeclared", "accepted", "", values={"control.delay.common": (0.06, 0.004)})
GROUP = EffectFinding(
    "control.delay", "undeclared", "indistinguishable", "", group=("control.lag",), values={"x": (0.1, 0.01)}
)
MEMBER = EffectFinding("control.lag", "undeclared", "indistinguishable", "", group=("control.delay",))
LAG_MODE = EffectFinding("rotor.lead_lag", "structure", "accepted", "")
QUIET = EffectFinding("forces.drag", "undeclared", "below floor", "", smallest_visible=(0.01, "1/m"))
NETWORK = EffectFinding("neural.forces", "learnt", "accepted", "")
MISSING = Unknown("L", (0.2, 2.0), "p", 6.0, "Something is missing in L.")


def test_an_accepted_effect_is_named_with_its_size():
    told = statement([DELAY, QUIET, LAG_MODE], None)
    assert (told.kind, told.effects) == ("undeclared", ("control.delay",))
    assert "0.06 ± 0.004" in told.sentence


def test_of_many_sizes_the_surest_are_told():
    values = {f"control.delay.{c}": (0.005, 0.002) for c in ("lon", "lat", "col")}
    late = EffectFinding(
        "control.delay", "undeclared", "accepted", "", values={**values, "control.delay.ped": (0.06, 0.002)}
    )
    assert "ped 0.06 ± 0.002" in statement([late], None).sentence


@pytest.mark.parametrize("unit", ["rad", "m", "norm"])
def test_a_rate_limit_is_told_as_a_rate(unit: str):
    """The parameter is one over the limit."""
    (declared,) = RateLimit(unit=unit).declared
    name = f"control.rate_limit.{declared.name}"
    limit = EffectFinding(
        "control.rate_limit", "undeclared", "accepted", "", values={name: (4.0, 0.08)}, units={name: declared.unit}
    )
    assert f"1/{declared.name} 0.25 ± 0.005 {unit}/s" in statement([limit], None).sentence


def test_members_of_a_group_are_all_named_and_none_alone():
    told = statement([GROUP, MEMBER, QUIET], None)
    assert told.kind == "group"
    assert set(told.effects) == {"control.delay", "control.lag"}


def test_what_is_missing_gets_no_name():
    told = statement([QUIET, LAG_MODE], MISSING)
    assert (told.kind, told.effects) == ("unknown", ())
    assert told.sentence == MISSING.sentence


def test_what_is_missing_beside_names_and_groups_is_told_with_them():
    for findings in ([DELAY], [GROUP, MEMBER]):
        assert statement(findings, MISSING).sentence.endswith("Something more is missing in L.")


def test_structure_alone_is_nothing_undeclared():
    assert statement([LAG_MODE, QUIET], None).kind == "structure"


def test_what_the_nominal_model_has_from_the_start_joins_nothing():
    inflow = EffectFinding("rotor.inflow", "structure", "accepted", "", part="inflow")
    assert statement([inflow, QUIET], None).kind == "nothing undeclared"
    assert statement([inflow, LAG_MODE], None).effects == ("rotor.lead_lag",)


def test_nothing_points_at_the_list_of_what_could_have_been_seen():
    told = statement([QUIET], None)
    assert told.kind == "nothing undeclared"
    assert told.effects == ()
    assert "1 effects were tested" in told.sentence or "1 effect" in told.sentence


@pytest.mark.parametrize("verdict", get_args(Verdict))
@given(
    chosen=st.lists(st.sampled_from([DELAY, GROUP, MEMBER, LAG_MODE, QUIET, NETWORK]), unique_by=id),
    unknown=st.sampled_from([None, MISSING, replace(MISSING, judged=False)]),
    failing=st.sampled_from(["on the validate flights the model is worse than holding trim", "x", "Üble Flüge"]),
)
def test_a_model_that_fails_is_said_to_fail_first_and_no_clean_bill_follows(
    verdict: Verdict, chosen: list[EffectFinding], unknown: Unknown | None, failing: str
):
    findings = [*chosen, EffectFinding("forces.drag", "undeclared", verdict, "")]
    without, told = statement(findings, unknown), statement(findings, unknown, failing)
    assert (told.kind, told.effects) == (without.kind, without.effects)
    assert told.sentence.startswith(f"{failing[0].upper()}{failing[1:]}. ")
    assert "nothing undeclared" not in told.sentence.lower()
    said = told.sentence.removeprefix(f"{failing[0].upper()}{failing[1:]}. ")
    if without.kind in ("nothing undeclared", "structure"):
        assert "Something is missing" in said
    else:
        assert said == without.sentence
    assert all(effect in said for effect in told.effects)


def test_a_model_of_use_is_not_said_to_lack_anything():
    assert "missing" not in statement([LAG_MODE, QUIET], None).sentence


def test_a_network_that_stays_is_told_and_changes_no_verdict():
    network = EffectFinding("neural.forces", "learnt", "accepted", "")
    told, without = statement([QUIET, network], MISSING), statement([QUIET], MISSING)
    assert (told.kind, told.effects) == (without.kind, without.effects)
    assert told.sentence.startswith(without.sentence)
    assert "network" in told.sentence
    assert statement([QUIET, EffectFinding("neural.forces", "learnt", "rejected", "")], MISSING) == without


def test_what_is_suspected_is_told_and_is_no_name():
    suspected = replace(DELAY, verdict="suspected")
    for unknown in (MISSING, None):
        told = statement([suspected, QUIET], unknown)
        assert (told.kind, told.effects) == ("unknown", ())
        assert "control.delay (common 0.06 ± 0.004)" in told.sentence
        assert told.sentence.startswith("Something is missing")
    assert statement([DELAY, replace(suspected, id="control.lag")], None).effects == ("control.delay",)
