"""What is told of an effect in a sentence and in tables is the same: the values of the fit after."""

from __future__ import annotations

from rotorid_torch.effects.examples import HELICOPTER
from rotorid_torch.model.nominal import build
from rotorid_torch.report.records import FitRecord, ParameterRecord, ScoresRecord
from rotorid_torch.run.loop_record import as_fitted, effect_record
from rotorid_torch.trace.terms.finding import EffectFinding
from rotorid_torch.trace.terms.verdict import statement

NAME = "control.delay.common"
TRACED = EffectFinding("control.delay", "undeclared", "accepted", "why", values={NAME: (0.018, 0.005)})


def fit(*parameters: ParameterRecord) -> FitRecord:
    none = ScoresRecord(identify=None, validate=None, acid=None)
    return FitRecord(parameters=parameters, modes=(), flights={}, scores=none)


def test_sentence_and_table_tell_the_values_of_the_fit_after():
    after = fit(ParameterRecord(name=NAME, value=0.0386, se=0.006, unit="s", status="free"))
    assert "common 0.0386 ± 0.006" in statement([as_fitted(TRACED, after)], None).sentence
    assert effect_record(TRACED, build(HELICOPTER), after).parameters[0].value == 0.0386


def test_what_no_fit_after_estimated_keeps_the_values_that_were_traced():
    held = fit(ParameterRecord(name=NAME, value=0.02, se=0.0, unit="s", status="frozen"))
    assert as_fitted(TRACED, held) == as_fitted(TRACED, fit()) == TRACED


def test_what_the_model_has_from_the_start_is_told_with_its_sizes():
    inflow = EffectFinding("rotor.inflow", "structure", "accepted", "from the start", part="inflow")
    tau = ParameterRecord(name="inflow.tau", value=0.12, se=0.01, unit="s", status="free")
    assert effect_record(inflow, build(HELICOPTER), fit(tau)).parameters == (tau,)


def test_where_a_play_stands_at_first_is_no_size_to_be_told():
    play = EffectFinding("control.backlash", "undeclared", "accepted", "why")
    after = fit(
        ParameterRecord(name="control.backlash.width", value=0.02, se=0.001, unit="rad"),
        ParameterRecord(name="control.backlash.place.lon", value=-1.0, se=0.01, unit="1", status="nuisance"),
    )
    assert list(as_fitted(play, after).values) == ["control.backlash.width"]
