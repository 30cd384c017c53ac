"""Whether each control acts on what its name, or its declared place, says; flapping likewise."""

import re
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from rotorid_torch.consistency.examination.controls import FEEDBACK, SURE
from rotorid_torch.consistency.examination.finding import Finding, finding
from rotorid_torch.consistency.pairs.odd_flights import with_only
from rotorid_torch.consistency.records.answers import (
    FLIGHTS,
    Answers,
    Places,
    answers,
    astray_in_flights,
    turned_in_flights,
)
from rotorid_torch.consistency.records.excitation import STILL, TURNS, power_in_band, turned_by_places
from rotorid_torch.consistency.smoothing import EVERY_S
from rotorid_torch.core import names
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.schema import Motor

ACTS_ON = {"lat": "p", "lon": "q", "ped": "r", "col": "az"}
"""What each control of a helicopter acts on most."""
EXCHANGED = 2.0
"""Natural logarithm of the factor by which another pairing of controls and responses explains more."""
ALIKE, UNLIKE = 0.85, 0.6
"""Mean cosine between what motors do and what their places say, from and up to which these are theirs or others'."""
SMALL = 0.1
"""Effect over the response's size that a motor has at least, to be reversed."""
STRONG = 0.01
"""Power of a combination of motors over that of the strongest, from which on it tells of a motor that is reversed."""
OPPOSITE = -0.7
"""The same of one response, up to which it goes the other way."""
OTHER_WAY = {
    "p": "left and right of their places are exchanged",
    "q": "front and rear of their places are exchanged",
    "r": "their spins are the other way round",
}


def acting(dataset: Dataset) -> Iterator[Finding]:
    """Whether each control acts on what its name, or its declared place, says; flapping likewise."""
    dt = dataset.facts[dataset.identify[0]].dt
    recorded = [r for r in ACTS_ON.values() if r in dataset.scales()]
    still = {r for r in recorded if power_in_band(dataset.records(r), dt)[1] < STILL[r]}
    if still.issuperset(names.RATES):
        return  # what stands on a bench answers nothing
    effects = answers(dataset, dataset.controls)
    if effects is not None:
        act = _motors_act if all(map(names.is_motor, dataset.controls)) else _sticks_act
        acted = [*act(dataset, effects.without(still))]
        yield from acted
        yield from _astray(dataset, {one.flight for one in acted})
    if all(facts.has("a1", "b1") for facts in dataset.facts.values()):
        yield from _flapping_acts(dataset)


def _astray(dataset: Dataset, others: Collection[str]) -> Iterator[Finding]:
    """Controls of single flights, but for these, that the other flights' effects contradict."""
    for one in astray_in_flights(dataset):
        if one.flight in others:
            continue
        sentence = f"by what the controls do in the other flights they leave {one.left:.0%} of the accelerations, and"
        if one.seconds:
            word = "late" if one.seconds > 0.0 else "early"
            cause = f"{one.left_so:.0%} taken as {abs(one.seconds):.2f} s {word} (± {EVERY_S:.2f}). Shift them."
        elif one.factor != 1.0:
            cause = f"{one.left_so:.0%} as {one.factor:.3g} times what they should be: correct their unit or sign."
        else:
            cause = "at no other time less: they are another flight's, or another control acts. Leave the flight out."
        yield finding("error", " ".join(dataset.controls), sentence, cause, flight=one.flight)


def _sticks_act(dataset: Dataset, effects: Answers) -> Iterator[Finding]:
    for one in turned_in_flights(dataset, ACTS_ON):
        sentence = f"acts on {ACTS_ON[one.control]} the other way than in the other flights: by these it leaves"
        shares = f"{one.left:.0%} of that as recorded, {one.left_turned:.0%} turned. Turn its sign there."
        yield finding("error", one.control, sentence, shares, flight=one.flight)
    controls = [c for c in dataset.controls if effects.shown([ACTS_ON.get(c, "")])]
    responses = [ACTS_ON[c] for c in controls]
    more, order = effects.pairing(responses, [dataset.controls.index(c) for c in controls])
    if more > EXCHANGED:
        moved = [(c, controls[k]) for c, k in zip(controls, order, strict=True) if c != controls[k]]
        said = ", ".join(f"{ACTS_ON[c]} answers {other}, not {c}" for c, other in moved)
        advice = "The controls are exchanged, or named otherwise: correct their names."
        yield finding("error", " ".join(c for c, _ in moved), f"{said} (by the angular accelerations).", advice)
    elif "col" in controls and not re.search("down|sink|descen|less", dataset.control_specs["col"].positive):
        column = dataset.controls.index("col")
        effect, error = effects.of("az")[column], effects.errors[effects.responses.index("az")][column]
        if effect > SURE * error and effect > np.sqrt(FEEDBACK):
            sentence = "thrust falls as col rises (az goes with it): its sign is turned."
            yield finding("warning", "col", sentence, "Turn it, or say in [controls.col] that positive is down.")


def _flapping_acts(dataset: Dataset) -> Iterator[Finding]:
    """Moments follow the disc: it tilts back by a1 and the nose rises; by b1 to the right, where a rotor turns ccw."""
    effects = answers(dataset, ("b1", "a1"), motion=False)
    if effects is None or effects.shown(("p", "q")) != ["p", "q"]:
        return
    more, _ = effects.pairing(("p", "q"), (0, 1))
    rotor = dataset.vehicle.rotor
    turned = ["a1"] if effects.of("q")[1] < 0.0 else []
    turned += ["b1"] if rotor and rotor.direction == "ccw" and effects.of("p")[0] < 0.0 else []
    form = "beta = a0 - a1 cos psi - b1 sin psi, psi = 0 aft."
    if more > EXCHANGED:
        yield finding("error", "a1 b1", f"a1 and b1 are exchanged: roll follows a1, pitch follows b1; {form}")
    elif turned:
        said = " and ".join(turned) + (" have" if len(turned) > 1 else " has")
        sentence = f"{said} the wrong sign: the moments go against the tilt of the disc; {form}"
        yield finding("error", " ".join(turned), sentence)


def _motors_act(dataset: Dataset, effects: Answers) -> Iterator[Finding]:
    reversed_ones = _reversed(dataset, effects)
    if len(reversed_ones) == len(dataset.controls):
        sentence = "thrust falls as the commands rise (az goes with them): the commands are reversed."
        yield finding("error", " ".join(reversed_ones), sentence, "Take one minus each.")
    elif reversed_ones:
        sentence = "acts the other way than the other motors: the command is reversed."
        yield finding("error", " ".join(reversed_ones), sentence, "Take one minus it.")
    responses, motors = effects.shown(names.RATES), dataset.vehicle.motors or ()
    if reversed_ones or not {"p", "q"} <= {*responses}:
        return
    yield from _moved_in_flights(dataset, effects, responses)
    if len(motors) != len(dataset.controls):
        return
    placed = effects.places(_declared(motors, responses), responses)
    if moved := _moved(dataset.controls, placed):
        pairs = ", ".join(f"{c} acts from where {other} is declared" for c, other in moved)
        sentence = f"{pairs} (agreement {placed.best:.2f}, as declared {placed.by_motor.mean():.2f})."
        yield finding("error", " ".join(c for c, _ in moved), sentence, "Number commands and [[vehicle.motors]] alike.")
    elif wrong := [r for r, cosine in zip(responses, placed.along, strict=True) if cosine < OPPOSITE]:
        said = " and ".join(OTHER_WAY[r] for r in wrong)
        sentence = f"the body answers the motors the other way than [[vehicle.motors]] says: {said}."
        advice = "Correct positions (x forward, y right) or spin (seen from above)."
        yield finding("error", " ".join(dataset.controls), sentence, advice)


def _moved(controls: Sequence[str], placed: Places) -> list[tuple[str, str]]:
    """Motors that clearly act from where others should, each with that one; empty where none does."""
    if placed.best <= ALIKE or placed.by_motor.mean() >= UNLIKE:
        return []
    return [(c, controls[k]) for c, k in zip(controls, placed.order, strict=True) if c != controls[k]]


def _moved_in_flights(dataset: Dataset, effects: Answers, responses: Sequence[str]) -> Iterator[Finding]:
    """Motors that act in one flight as others do in all flights together."""
    usual = np.stack([effects.weights(r) for r in responses])
    for name in [*dataset.flights][:FLIGHTS]:
        one = answers(with_only(dataset, (name,)), dataset.controls)
        if one is None or one.shown(responses) != list(responses):
            continue
        if moved := _moved(dataset.controls, one.places(usual, responses)):
            pairs = ", ".join(f"{c} acts as {other} does in the other flights" for c, other in moved)
            yield finding(
                "error", " ".join(c for c, _ in moved), f"{pairs}:", "their columns are exchanged.", flight=name
            )


def _declared(motors: Sequence[Motor], responses: Sequence[str]) -> np.ndarray:
    turned = {TURNS[axis]: weights for axis, weights in turned_by_places(motors).items()}
    return np.stack([turned[r] for r in responses])


def _reversed(dataset: Dataset, effects: Answers) -> list[str]:
    """Motors that take thrust away as their commands rise, and turn the body against their places.

    Moments alone tell it where thrust does not show, thrust alone where places are not declared. Beside places az is no
    witness by itself: in turbulence the commands answer the thrust.
    """
    motors, controls, responses = dataset.vehicle.motors or (), dataset.controls, effects.shown(names.RATES)
    strong = answers(dataset, controls, least=STRONG) if effects.shown(("az",)) else None
    thrust, down = strong is not None and bool(strong.shown(("az",))), list[str]()
    if strong is not None and thrust:
        weights, errors = strong.of("az"), strong.errors[strong.responses.index("az")]
        if (strong.weights("az")).sum() > SURE * float(np.linalg.norm(errors / strong.sizes)):
            return list(controls)
        down = [c for c, w, se in zip(controls, weights, errors, strict=True) if w > max(SURE * se, SMALL)]
    if len(motors) == len(controls) and {"p", "q"} <= {*responses}:
        placed = effects.places(_declared(motors, responses), responses)
        against = dict(zip(controls, placed.by_motor, strict=True))
        if thrust:
            down = [c for c in down if against[c] < 0.0]
        elif placed.best <= ALIKE:  # motors of opposite places that are exchanged look reversed one by one
            down = [c for c, cosine in against.items() if cosine < -ALIKE]
    return down if len(down) < 0.5 * len(controls) else []
