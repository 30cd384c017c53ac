"""What a report says first: plain sentences with units that follow from its records."""

from __future__ import annotations

import re

import msgspec
import pytest

from rotorid_torch.core import names
from rotorid_torch.core.names import is_motor
from rotorid_torch.effects.examples import HELICOPTER, MULTIROTOR
from rotorid_torch.effects.families.sensors import UNITS
from rotorid_torch.effects.registry import registered
from rotorid_torch.printable import percent
from rotorid_torch.report import records
from rotorid_torch.report.page.tables import evidence_rows
from rotorid_torch.report.summary import _steps_of_parameters
from rotorid_torch.report.words.effects import EFFECTS, words_of
from rotorid_torch.report.words.sizes import roughly, sentence_of, size, sizes_of, smallest_size
from rotorid_torch.report.words.verdict import CLOSE_LOOP, consequence, grades, opening, steps, worst_of
from rotorid_torch.trace.evidence.family import TURNED
from rotorid_torch.trace.measured.measured_family import SHUFFLED


def an_effect(name: str, verdict: str = "accepted", **sizes: tuple[float, float, str]) -> records.EffectRecord:
    parameters = tuple(
        records.ParameterRecord(name=f"{name}.{n}", value=v, se=e, unit=u) for n, (v, e, u) in sizes.items()
    )
    whole = {
        "id": name,
        "role": "undeclared",
        "verdict": verdict,
        "reason": "x; fast flights would tell",
        "parameters": parameters,
    }
    return msgspec.convert(whole, records.EffectRecord, from_attributes=True)


def closed(report: records.Report, kind: str, *effects: records.EffectRecord, after: bool = True) -> records.Report:
    fit = report.before
    assert fit is not None
    verdict = msgspec.convert(
        {"kind": kind, "effects": [e.id for e in effects], "sentence": f"{kind}."}, records.VerdictRecord
    )
    better = msgspec.structs.replace(fit, scores=records.ScoresRecord(identify=0.07, validate=0.12, acid=0.13))
    return msgspec.structs.replace(report, after=better if after else None, effects=effects, verdict=verdict)


@pytest.mark.parametrize(
    ("value", "error", "unit", "words"),
    [
        (0.0571, 0.0062, "s", "57 ± 6 ms"),
        (2.31, 0.12, "s", "2.3 ± 0.1 s"),
        (0.0857, 0.006, "1", "8.6 ± 0.6 %"),
        (-0.0262, 0.0005, "rad", "-1.50 ± 0.03°"),
        (744.2, 31.0, "kg", "744 ± 31 kg"),
        (0.00765, 0.0003, "m", "7.6 ± 0.3 mm"),
        (0.382, 0.006, "m", "0.382 ± 0.006 m"),
        (-0.0123, 0.002, "kg", "-12 ± 2 g"),
        (9.81, None, "m/s2", "9.81 m/s²"),
    ],
)
def test_a_size_in_units_that_people_use(value: float, error: float | None, unit: str, words: str):
    assert size(value, error, unit) == words


def test_a_delay_is_said_in_milliseconds_and_zero_sizes_are_left_out():
    delay = an_effect("control.delay", common=(0.0571, 0.0062, "s"), lon=(0.001, 0.002, "s"))
    assert sentence_of(delay) == "The controls reach the rotor later than recorded: 57 ± 6 ms."


def test_a_filter_is_said_by_its_natural_frequency_and_damping():
    low_pass = an_effect("sensors.filter", rates_period=(0.0503, 0.0011, "s"), rates_damping=(0.69, 0.02, "1"))
    said = "rates, natural frequency 19.9 ± 0.4 rad/s, rates, damping 69 ± 2 % of critical"
    assert sentence_of(low_pass) == f"Sensors of one unit stand behind a filter: {said}."


def test_a_rate_limit_is_said_as_a_rate():
    """The parameter is one over the limit: 1/16.7 rad/s, with an error of 1/16.7^2."""
    limit = an_effect("control.rate_limit", inverse=(16.7, 1.0, "s/rad"))
    assert sentence_of(limit) == "The actuators move no faster than a limit: 0.060 ± 0.004 rad/s."
    assert smallest_size(2.0, "s/rad") == "≤ 0.5 rad/s"
    normalised = an_effect("control.rate_limit", inverse=(0.5, 0.01, "s/norm"))
    assert sentence_of(normalised) == "The actuators move no faster than a limit: 2.00 ± 0.04 norm/s."
    assert smallest_size(0.01, "s") == "10 ms"
    assert smallest_size(0.0004, "s²") == "20 ms"
    assert smallest_size(3350.0, "kg") == "3350 kg"
    assert smallest_size(1.98, "1") == "198 %"


def test_the_table_of_effects_begins_with_what_evidence_names_and_sizes_nothing_that_is_rejected():
    nominal = an_effect("rotor.inflow", tau=(0.1, 0.01, "s"))
    late = msgspec.structs.replace(an_effect("control.delay", "indistinguishable"), gain=17.0, floor=1.0)
    lagging = an_effect("rotor.lead_lag", "rejected", regressing=(22.0, 0.3, "rad/s"))
    taken_up = msgspec.structs.replace(an_effect("forces.drag", "indistinguishable"), gain=0.1, floor=1.0)
    rows = evidence_rows([taken_up, nominal, lagging, late])
    assert [row.effect.id for row in rows] == ["control.delay", "rotor.inflow", "rotor.lead_lag", "forces.drag"]
    assert rows[2].size == ""
    assert [row.sign for row in rows if row.effect.verdict == "indistinguishable"] == [
        "≈ cannot be told apart",
        "□ absorbed by others",
    ]


@pytest.mark.parametrize("effect", sorted({*EFFECTS, *registered()}))
def test_every_effect_has_a_sentence_with_and_without_sizes(effect: str):
    bare = sentence_of(an_effect(effect))
    whole = sentence_of(an_effect(effect, anything=(2.0, 0.1, "m")))
    assert bare.endswith(".")
    assert "{}" not in bare + whole
    assert words_of(effect).noun


@pytest.mark.parametrize("effect", sorted(({*EFFECTS} & {*registered()}) - {"neural.forces"}))
def test_every_parameter_of_an_effect_is_said_in_words_or_by_the_name_of_a_channel(effect: str):
    """A name of the code in a sentence, as hubs, says nothing to an engineer."""
    kind = registered()[effect]
    vehicles = [spec for spec in (HELICOPTER, MULTIROTOR) if kind.untestable(spec) is None]
    declared = [p for spec in vehicles for p in kind.from_spec(spec).declared]
    sizes = {p.name: ((abs(p.typical) or 0.3), 0.01, p.unit) for p in declared if not p.nuisance}
    people_say = {*UNITS, "controls", "damping", "governor", "hook", "Ixx", "Iyy", "Izz", "Ixz"}
    for name, one in sizes.items():
        said = sentence_of(an_effect(effect, **{name: one}))
        assert "{" not in said
        if not (names.channel(name) or is_motor(name) or name in people_say):
            assert not re.search(rf"\b{re.escape(name)}\b [-\d]", said), said


def test_a_size_that_no_sentence_says_stands_in_the_table_and_says_whether_it_is_sure():
    for error, said in ((0.3, "N 2.6 ± 0.3 rad/s"), (1.4, "N 3 ± 1 rad/s, not sure")):
        inertia = an_effect("propulsion.rotor_inertia", N=(2.6, error, "rad/s"))
        assert sentence_of(inertia) == "Rotors that speed up turn the body about the yaw axis."
        assert (sizes_of(inertia), roughly(inertia)) == ("", said)


def test_an_effect_of_somebody_else_is_said_by_its_description():
    assert "acts on this vehicle" in sentence_of(an_effect("mine.unheard_of"))


def test_the_first_screen_says_how_much_better_unseen_flights_are_and_where_acid_flights_are_worse(
    report: records.Report,
):
    loop = closed(report, "undeclared", an_effect("control.delay", common=(0.0571, 0.0062, "s")))
    assert opening(loop) == "The controls reach the rotor later than recorded: 57 ± 6 ms."
    said = consequence(loop)
    assert "unseen flights are described 20 % better (J 0.150 to 0.120)" in said
    assert "the acid flights are described 8 % worse (J 0.120 to 0.130)" in said
    assert [grade.title for grade in grades(loop)] == ["before", "after"]
    assert steps(loop)[0].startswith("Look for the delay between the recorded controls and the actuators")


def test_members_of_a_group_are_named_as_things_and_what_would_tell_them_apart(report: records.Report):
    members = [an_effect(name, "indistinguishable") for name in ("control.delay", "control.lag")]
    loop = closed(report, "group", *members)
    assert "a delay in the control path or a lag of the actuators. These flights cannot tell which." in opening(loop)
    assert "Fast flights would tell a lag of the actuators from what takes its place." in steps(loop)
    bare = [msgspec.structs.replace(one, reason="these flights cannot tell it from the other") for one in members]
    assert steps(closed(report, "group", *bare))[1].startswith(
        "If a lag of the actuators is the cause: record the actuators'"
    )
    sized = an_effect("control.delay", "indistinguishable", common=(0.0571, 0.0062, "s"))
    assert "a delay in the control path (57 ± 6 ms) or a lag" in opening(closed(report, "group", sized, members[1]))


def test_several_effects_are_one_sentence_with_their_sizes(report: records.Report):
    delay = an_effect("control.delay", common=(0.0571, 0.0062, "s"))
    lag = an_effect("propulsion.motor_lag", tau=(0.063, 0.007, "s"))
    both = "a delay in the control path (57 ± 6 ms)", "a lag of the motors (time constant 63 ± 7 ms)"
    assert opening(closed(report, "undeclared", delay, lag)) == (
        f"The flights show what is not declared: {both[0]} and {both[1]}."
    )
    members = [an_effect(name, "indistinguishable") for name in ("forces.drag", "propulsion.axial_inflow")]
    loop = closed(report, "group", delay, lag, *members)
    loop = msgspec.structs.replace(
        loop,
        unknown=records.UnknownRecord(where="L", band_hz=(0.2, 2.0), goes_with="v", since_s=None, sentence="Missing."),
    )
    assert opening(loop) == (
        f"The flights show what is not declared: {both[0]}, {both[1]},"
        " either drag of the fuselage or thrust by flow through the rotors (these flights cannot tell which)"
        " and something without a name in the rolling moment, which goes with the sideward velocity over ground (v)."
    )


def test_nothing_undeclared_comes_with_how_good_the_model_is(report: records.Report):
    sentence = "Nothing undeclared was found (3 effects)."
    verdict = records.VerdictRecord(kind="nothing undeclared", effects=(), sentence=sentence)
    loop = msgspec.structs.replace(closed(report, "nothing undeclared", after=False), verdict=verdict)
    assert opening(loop) == "These flights show nothing that is not declared."
    assert "On the validate flights" in consequence(loop)
    assert "would have shown" not in consequence(loop)


@pytest.mark.parametrize("kind", ["nothing undeclared", "structure"])
def test_silence_comes_with_what_would_have_been_seen(report: records.Report, kind: str):
    visible = {"control.delay": (0.0087, "s"), "environment.wind": (0.85, "m/s"), "control.lag": (0.01, "s")}
    below = [
        msgspec.structs.replace(an_effect(n, "below floor"), smallest_visible=records.VisibleRecord(value=v, unit=u))
        for n, (v, u) in visible.items()
    ]
    said = consequence(msgspec.structs.replace(closed(report, kind), effects=tuple(below)))
    assert said.endswith(
        "The flights would have shown a delay in the control path of 8.7 ms or steady wind of 0.85 m/s"
        " in four cases of five."
    )


def test_what_has_no_name_is_said_of_an_axis_in_words(report: records.Report):
    sentence = (
        "Something is missing in M: 0.9 rad/s2 rms at 0.2 to 2 Hz go with p; no effect of the library explains it."
    )
    unknown = records.UnknownRecord(where="M", band_hz=(0.2, 2.0), goes_with="p", since_s=None, sentence=sentence)
    verdict = records.VerdictRecord(kind="unknown", effects=(), sentence=sentence)
    loop = msgspec.structs.replace(closed(report, "unknown", after=False), verdict=verdict, unknown=unknown)
    failing = msgspec.structs.replace(verdict, sentence=f"On the validate flights the model is poor. {sentence}")
    suspect = an_effect("control.backlash", "suspected", width=(0.0028, 0.0005, "rad"))
    loop = msgspec.structs.replace(loop, verdict=failing, effects=(suspect,))
    assert opening(loop) == (
        "Something is missing in the pitching moment (M): 0.9 rad/s² rms at 0.2 to 2 Hz go with the roll rate (p);"
        " no effect of the library explains it."
    )
    assert steps(loop)[1].startswith("Suspected, for it explains a part: play in the control linkage (0.16 ± 0.03°")
    alone = msgspec.structs.replace(loop, unknown=None)
    assert "Suspected: play in the control linkage (0.16 ± 0.03°" in opening(alone)
    assert "control.backlash" not in opening(alone)


def test_beside_what_has_no_name_the_physics_that_joined_is_named(report: records.Report):
    """The second model is not better by what nobody has put into it."""
    lag = an_effect("rotor.lead_lag")
    unknown = records.UnknownRecord(where="M", band_hz=(0.2, 2.0), goes_with="p", since_s=None, sentence="It is so.")
    loop = msgspec.structs.replace(closed(report, "unknown", lag), unknown=unknown)
    assert consequence(loop).startswith("With lead-lag of the blades in the model, unseen flights are described")
    assert consequence(closed(report, "undeclared", lag)).startswith("With that in the model,")


def test_all_that_has_no_name_is_said(report: records.Report):
    """Of several equations none is left out, beside named effects and alone."""
    sentence = (
        "Something is missing in L: it goes with v, to 3 mm; N: it goes with w; no effect of the library explains it."
    )
    unknown = records.UnknownRecord(
        where="LN", band_hz=(0.1, 0.5), goes_with="v and w", since_s=None, sentence=sentence
    )
    lag = an_effect("propulsion.motor_lag", tau=(0.063, 0.007, "s"))
    both = msgspec.structs.replace(closed(report, "undeclared", lag), unknown=unknown)
    assert opening(both).endswith(
        "something without a name in the rolling moment and the yawing moment,"
        " which goes with the sideward velocity over ground (v) and the downward velocity over ground (w)."
    )
    product = msgspec.structs.replace(unknown, goes_with="the velocity north and q and motor3 motor4")
    assert opening(msgspec.structs.replace(both, unknown=product)).endswith(
        "which goes with the velocity north, the pitch rate (q)"
        " and the product of the motor command (motor3) and the motor command (motor4)."
    )
    assert any(step.startswith("Take what is named with care") for step in steps(both))
    assert any("acts on the rolling moment and the yawing moment between" in step for step in steps(both))
    verdict = records.VerdictRecord(kind="unknown", effects=(), sentence=sentence)
    alone = msgspec.structs.replace(closed(report, "unknown", after=False), verdict=verdict, unknown=unknown)
    assert "in the rolling moment (L): it goes" in opening(alone)
    assert "; the yawing moment (N): it goes" in opening(alone)


def test_a_model_that_fails_on_data_of_no_use_says_so_first(report: records.Report):
    """That no effect explains what is missing is no discovery where the data are at fault."""
    loop = closed(report, "nothing undeclared", after=False)
    assert loop.fit is not None
    poor = msgspec.structs.replace(loop.fit, scores=records.ScoresRecord(identify=0.1, validate=1.5, acid=1.2))
    of_no_use = ("the data set is not usable, because r is dead",)
    loop = msgspec.structs.replace(loop, before=poor, warnings=of_no_use)
    assert opening(loop) == "The data set is not usable, because r is dead."
    assert "Take care: on the validate flights" in consequence(loop)


def test_few_parameters_that_could_be_zero_are_named_and_many_counted():
    one = records.ParameterRecord(name="L.p", value=0.1, se=1.0, unit="1")
    many = tuple(msgspec.structs.replace(one, name=f"L.{k}") for k in range(6))
    sure = msgspec.structs.replace(one, name="M.q", value=9.0)
    assert next(_steps_of_parameters((one, sure))).startswith("Do not read anything into L.p: ")
    assert next(_steps_of_parameters((*many, sure))).startswith("6 of 7 estimated parameters could as well be zero")


@pytest.mark.parametrize(
    ("share", "digits", "words"),
    [
        (0.982, 0, "98 %"),
        (0.996, 0, "99.6 %"),
        (0.9999, 1, "99.9 %"),
        (1.0, 0, "100 %"),
        (None, 0, "–"),
        (1.2, 0, "120 %"),
    ],
)
def test_only_all_is_a_hundred_per_cent(share: float | None, digits: int, words: str):
    assert percent(share, digits) == words


@pytest.mark.parametrize(("J", "asked"), [(0.1, True), (0.8, True), (1.5, False)])
def test_a_poor_model_asks_what_it_lacks_unless_its_data_are_in_doubt(J: float, asked: bool, report: records.Report):
    """A model that explains little lacks something; one that is worse than holding trim may rest on wrong signs."""
    assert report.before is not None
    flights = {
        name: msgspec.structs.replace(flight, list="validate", J=J, J_noise=0.05, J_trim=1.0)
        for name, flight in report.before.flights.items()
    }
    scores = records.ScoresRecord(identify=None, validate=J, acid=None)
    fit = msgspec.structs.replace(report.before, flights=flights, scores=scores)
    said = steps(msgspec.structs.replace(report, command="identify", before=fit))
    assert (said[0] == CLOSE_LOOP) == asked
    assert (CLOSE_LOOP in said) == asked


@pytest.mark.parametrize("kind", ["nothing undeclared", "structure"])
def test_a_model_of_use_is_used_first(kind: str, report: records.Report):
    effects = (an_effect("rotor.lead_lag"),) if kind == "structure" else ()
    first, *others = steps(closed(report, kind, *effects))
    assert first.startswith("Use the model within the range of motion that the flights covered; rotorid export")
    assert not any("Nothing stands out" in step for step in others)


def test_data_are_mended_first_where_they_are_of_no_use_and_else_after_what_was_found(report: records.Report):
    loop = closed(report, "nothing undeclared")
    poor, limited = (
        steps(msgspec.structs.replace(loop, warnings=(f"the data set is {grade}",)))
        for grade in ("not usable, because r is dead", "limited to roll (yaw limited)")
    )
    assert poor[0] == "Mend the data first. rotorid check says: not usable, because r is dead."
    assert limited[0].startswith("Use the model")
    assert limited[2] == "Better data would tell more. rotorid check says: limited to roll (yaw limited)."


@pytest.mark.parametrize("effect", sorted(EFFECTS))
def test_what_to_do_names_its_thing(effect: str):
    """Steps stand in a list, each by itself: "it" would be anything."""
    assert not re.search(r"\bit\b", words_of(effect).then)


def test_an_unknown_says_where_to_look(report: records.Report):
    unknown = records.UnknownRecord(
        where="L", band_hz=(0.2, 2.0), goes_with="p", since_s=None, sentence="Something is missing from L."
    )
    named = opening(msgspec.structs.replace(closed(report, "undeclared", after=False), unknown=unknown))
    assert named == (
        "The flights show what is not declared: something without a name in the rolling moment,"
        " which goes with the roll rate (p)."
    )
    loop = msgspec.structs.replace(closed(report, "unknown", after=False), unknown=unknown)
    assert steps(loop)[0].startswith(
        "What is missing acts on the rolling moment between 0.2 and 2 Hz, in step with the roll rate (p)"
    )


def test_a_model_that_fails_is_said_to_beside_what_it_names(report: records.Report):
    loop = closed(report, "undeclared", an_effect("control.delay"))
    assert loop.after is not None
    poor = msgspec.structs.replace(loop.after, scores=records.ScoresRecord(identify=0.1, validate=1.5, acid=1.2))
    assert "Take care: on the validate flights the model is worse" in consequence(
        msgspec.structs.replace(loop, after=poor)
    )


def test_a_failure_that_opens_the_report_is_not_said_again(report: records.Report):
    loop = closed(report, "unknown", after=False)
    assert loop.verdict is not None
    assert loop.fit is not None
    poor = msgspec.structs.replace(loop.fit, scores=records.ScoresRecord(identify=0.1, validate=1.5, acid=1.2))
    sentence = "On the validate flights the model is worse than holding trim. Something is missing in L."
    verdict = msgspec.structs.replace(loop.verdict, sentence=sentence)
    loop = msgspec.structs.replace(loop, verdict=verdict, before=poor)
    assert opening(loop) == sentence
    assert "Take care" not in consequence(loop)


def test_the_worst_channel_comes_with_its_unit_and_the_kind_of_error(fit: records.FitRecord):
    assert "rad/s rms" in worst_of(fit) or "m/s rms" in worst_of(fit) or "° rms" in worst_of(fit)
    assert worst_of(fit).endswith("mostly a wrong shape")


def test_of_a_model_that_flies_away_no_digits_are_said(report: records.Report):
    """A million times the usual motion is no number that anybody can use."""
    loop = closed(report, "undeclared", an_effect("control.rate_limit"))
    assert loop.before is not None
    useless = records.ScoresRecord(identify=2e7, validate=1.8e7, acid=2e6)
    flown = {
        name: msgspec.structs.replace(
            f, channels={c: msgspec.structs.replace(one, rmse=1e6, r2=-1e12) for c, one in f.channels.items()}
        )
        for name, f in loop.before.flights.items()
    }
    away = msgspec.structs.replace(loop.before, scores=useless, flights=flown)
    said = consequence(msgspec.structs.replace(loop, before=away))
    assert "unseen flights are described better than by held trim (J 0.120 of 1.000), without it worse" in said
    assert "0000" not in said
    assert worst_of(away).endswith("off by more than 10 times its usual motion: the model flies away")


@pytest.mark.parametrize("own", [TURNED, SHUFFLED])
def test_names_without_clean_aircraft_are_taken_with_care(report: records.Report, own: str):
    named = closed(report, "undeclared", an_effect("control.delay", common=(0.06, 0.006, "s")))
    assert not any("clean aircraft" in step for step in steps(named))
    weak = msgspec.structs.replace(named, warnings=(f"{own}: the mass is not declared",))
    assert steps(weak)[0].startswith("Take names with care")
    assert steps(weak)[0].endswith("for the mass is not declared.")
    silent = msgspec.structs.replace(closed(report, "nothing undeclared"), warnings=weak.warnings)
    assert not any("clean aircraft" in step for step in steps(silent))
