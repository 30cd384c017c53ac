"""What the report says about an identification: one sentence per kind, with what to do next."""

from dataclasses import replace

import msgspec
import numpy as np
import torch

from rotorid_torch.arguments import listed
from rotorid_torch.data import Dataset
from rotorid_torch.identification.estimate.progressive_fit import fit as fit_stages
from rotorid_torch.identification.estimate.segments import records_from
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.model_estimation import ModelEstimate
from rotorid_torch.identification.model_regression import ModelRegression
from rotorid_torch.identification.regress.ftr import regress
from rotorid_torch.report import records, remarks
from rotorid_torch.report.summary import at_an_edge, at_once
from tests.helpers import small_arrays, small_flight
from tests.identification.estimate.output_error_cases import Roll, roll_flight


def test_a_control_at_rest_and_one_that_follows_the_states_are_told_apart():
    still = {name: np.zeros(400) if name == "lon" else values for name, values in small_flight().items()}
    dataset = Dataset.from_arrays({"f": still}, identify=["f"])
    rest, follows = remarks.of_controls(dataset, {"lon": 0.0, "lat": 0.04})
    assert rest.startswith("lon hardly moves in any identify flight")
    assert follows.startswith("little of lat (4%) is its own motion")
    assert [sentence[:3] for sentence in remarks.of_controls(dataset, {"lon": 0.0, "lat": 0.5})] == ["lon"]


def test_late_controls_are_told_with_their_time_and_who_mends_them():
    def recorded(late: float) -> Dataset:
        rng, dt = np.random.default_rng(0), 0.01
        time = dt * np.arange(1500)

        def stick(t: np.ndarray, hertz: np.ndarray, phase: np.ndarray) -> np.ndarray:
            return 0.1 * np.sin(2 * np.pi * hertz * t[:, None] + phase).sum(-1)

        flights = {}
        for name in "abcd":
            waves = rng.uniform(0.2, 1.2, 6), rng.uniform(0.0, 2 * np.pi, 6)
            p = 2.0 * stick(time, *waves) + 0.02 * rng.standard_normal(1500)
            flights[name] = {"time": time, "lat": stick(time - late, *waves), "p": p}
        return Dataset.from_arrays(flights, identify=list(flights), controls={"lat": {"unit": "norm"}})

    (said,) = remarks.of_clocks(recorded(0.06))
    assert said.startswith("controls are recorded at least 60 ± ")
    assert said.endswith("rotorid close-loop takes that time out")
    assert remarks.of_clocks(recorded(0.0)) == ()


def test_what_reading_changed_in_many_flights_is_one_sentence():
    warnings = ("control lat has no table", "flight a: time is not uniform: resampled", "flight b: time is rough")
    dataset = replace(Dataset.from_arrays(small_arrays(), identify=["one"]), warnings=warnings)
    assert list(remarks.of_reading(dataset)) == [
        "control lat has no table",
        "flight a: time is not uniform: resampled (likewise in b)",
    ]


def regressions(**notes: tuple[str, ...]) -> ModelRegression:
    """Regressions of rows with these notes."""
    x = np.random.default_rng(0).standard_normal((400, 1))
    one = regress(x[:, 0], x, 0.02, kind="value")
    return ModelRegression({row: replace(one, notes=said) for row, said in notes.items()}, torch.zeros(0), (), {})


def estimate(converged: bool, message: str = "") -> ModelEstimate:
    """The estimate of a roll axis, whose search ended so."""
    fitted = fit_stages(System(Roll()), records_from([roll_flight(np.random.default_rng(0))])).estimate()
    minimum = replace(fitted.minimum, converged=converged, message=message)
    return ModelEstimate(replace(fitted, minimum=minimum), ())


def test_one_remark_of_several_equations_is_one_sentence():
    noise = "noise fills a combination of the regressors; leave one of them out"
    doubt = "N: does not hold even up to 1 Hz; smallest band"
    both, one = remarks.of_regressions(regressions(L=(noise,), N=(doubt, noise)))
    assert both.startswith("regression, equations of L N: noise fills a combination of the regressors: their sum")
    assert one.startswith("regression, equation of N: does not hold even up to 1 Hz: look for a wrong sign")


def test_a_remark_without_a_meaning_of_its_own_is_told_as_it_is():
    missing = regressions(L=("response: 3 missing samples",))
    assert list(remarks.of_regressions(missing)) == ["regression, equation of L: response: 3 missing samples"]


def test_doubts_about_the_estimate_name_parameters_and_say_what_to_do(fit):
    said = list(remarks.of_estimate(estimate(converged=False, message="stopped after 9"), fit))
    assert [sentence.split(":")[0] for sentence in said[1:]] == [
        "at a bound",
        "not identifiable from these flights, held",
    ]
    assert "did not converge (stopped after 9)" in said[0]
    assert "forces.M.q" in said[1]
    assert "forces.N.u" in said[2]


def test_a_model_worse_than_holding_trim_is_told(fit):
    flights = {"f1": msgspec.structs.replace(fit.flights["f1"], J=40.0)}
    scores = msgspec.structs.replace(fit.scores, identify=40.0)
    bad = msgspec.structs.replace(fit, flights=flights, scores=scores, parameters=())
    (said,) = remarks.of_estimate(estimate(converged=True), bad)
    assert said.startswith("the model is worse than holding trim on the identify (J 40 against 1) flights: do not use")


def test_many_names_end_in_their_number():
    assert listed([f"p{i}" for i in range(9)], remarks.SHOWN) == "p0, p1, p2, p3, p4, p5 and 3 more"


def test_nothing_or_all_of_an_effect_is_no_edge_of_its_range():
    known = {"se": 0.1, "unit": "s", "at_bound": True}
    absent = records.ParameterRecord(name="control.delay.lon", value=0.0, bounds=(0.0, 0.25), **known)
    longest = records.ParameterRecord(name="control.delay.lat", value=0.25, bounds=(0.0, 0.25), **known)
    undamped = records.ParameterRecord(name="forces.L.p", value=0.0, bounds=(-50.0, 0.0), **known)
    swift = records.ParameterRecord(name="inflow.tau", value=0.02, bounds=(0.02, 0.6), **known)
    slow = records.ParameterRecord(name="rotor.speed.tau", value=0.1, bounds=(0.1, 5.0), **known)
    share = {"se": None, "unit": "1", "bounds": (0.0, 1.0), "at_bound": True}
    whole = records.ParameterRecord(name="propulsion.rotor_drag.hubs", value=1.0, **share)
    every = [absent, longest, undamped, swift, slow, whole]
    assert at_an_edge(every) == ["control.delay.lat", "forces.L.p", "rotor.speed.tau"]
    assert at_once(every) == ["inflow.tau"]


def test_what_check_calls_an_error_is_warned_of():
    arrays = small_arrays()
    right = Dataset.from_arrays(arrays, identify=list(arrays))
    turned = Dataset.from_arrays({n: {**a, "az": -a["az"]} for n, a in arrays.items()}, identify=list(arrays))
    assert not any(said.startswith("the data set is not usable") for said in remarks.of_check(right))
    grade, said = remarks.of_check(turned)
    assert grade.startswith("the data set is not usable, because az: reads 9.8")
    assert said.startswith("az: reads 9.8")
    assert "Turn the axis: z points down." in said
