"""A multirotor's scores in few words: what the model gives at measured states, and how far it predicts."""

from collections.abc import Mapping, Sequence

from rotorid_torch.arguments import enumerated
from rotorid_torch.printable import percent
from rotorid_torch.report.records import LISTS, FitRecord
from rotorid_torch.validate.judged import Judgement
from rotorid_torch.validate.lists import Ahead, ShortHorizon

NAMES = {"pdot": "roll acceleration", "qdot": "pitch acceleration", "rdot": "yaw acceleration"}
NAMES |= {"ax": "forward force", "ay": "side force", "az": "vertical force"}
"""Responses of a multirotor in plain words; forces are those over mass, as accelerometers feel them."""

BRACKETS = (
    "R² at measured states with one constant per flight taken out, in brackets as measured, of flights that move it;"
    " mean errors of predictions, in brackets of holding what was measured"
)


def short_horizon(fit: FitRecord) -> list[ShortHorizon]:
    """One for each list whose flights have responses; none for a vehicle that a free run tells of."""
    judged = [(f.list, Judgement(f.responses, f.predictions)) for f in fit.flights.values() if f.responses]
    lists = {name: [one for of, one in judged if of == name] for name in LISTS}
    return [ShortHorizon.of(name, flights) for name, flights in lists.items() if flights]


def responses_of(lists: Sequence[ShortHorizon]) -> tuple[str, ...]:
    """Responses that any of the lists has."""
    return tuple(dict.fromkeys(name for one in lists for name in one.responses))


def predictions_of(lists: Sequence[ShortHorizon]) -> list[tuple[str, list[Ahead | None]]]:
    """Quantity, seconds and unit of every prediction in words, with that of each list; None where a list has none."""
    each = [{f"{p.quantity} after {p.seconds:g} s, {p.unit}": p for p in one.predictions} for one in lists]
    order = sorted((p.quantity, p.seconds, title) for of in each for title, p in of.items())
    quantities = dict.fromkeys(p.quantity for of in each for p in of.values())
    titles = dict.fromkeys(title for quantity in quantities for of, _, title in order if of == quantity)
    return [(title, [of.get(title) for of in each]) for title in titles]


def cell(horizon: ShortHorizon, name: str) -> str:
    """R2 of a response on a list of flights, without constants (as measured); in words where it does not count."""
    if name not in horizon.responses:
        return "-"
    if name in horizon.still:
        return "left alone"
    if name in horizon.silent:
        return "not in the model"
    return f"{horizon.responses[name]:z.3f} ({horizon.measured[name]:z.3f})"


def explained(horizon: ShortHorizon) -> str:
    """What the model explains on a list of flights, as a sentence; first what it predicts worse than holding does."""
    unseen = "" if horizon.name == "identify" else ", which no fit has seen"
    first = f"predicts {too_far_ahead(horizon)} worse than holding what was measured; it " if horizon.worse else ""
    parts = [f"{percent(max(r2, 0.0))} of {name}" for name, r2 in _named(horizon.counted).items()]
    shares = enumerated(parts or ["no acceleration"])
    return f"On the {horizon.name} flights{unseen}, the model {first}explains {shares}."


def predicted(horizon: ShortHorizon) -> str:
    """How far off the latest predictions are, and which responses do not count, in sentences; empty for neither."""
    latest = [p for p in horizon.predictions if p.seconds == horizon.predictions[-1].seconds]
    ahead = [f"{p.quantity} by {p.error:.3g} {p.unit} ({p.held:.3g} if what was measured is held)" for p in latest]
    errors = f"After {latest[0].seconds:g} s the model is off in {enumerated(ahead)}." if ahead else ""
    return f"{errors}{left_out(horizon)}".strip()


def weakest_response(fit: FitRecord) -> tuple[str, str, float] | None:
    """Flight, response and R² of what is explained worst on the last list: on the flight of it with most motion."""
    last = short_horizon(fit)[-1]
    if not last.counted:
        return None
    name, share = min(last.counted.items(), key=lambda one: one[1])
    flights = [flight for flight, of in fit.flights.items() if of.list == last.name and name in of.responses]
    return max(flights, key=lambda flight: fit.flights[flight].responses[name].rmse or 0.0), name, share


def too_far_ahead(horizon: ShortHorizon) -> str:
    """What is predicted worse than holding it, and from when on."""
    after = horizon.worse.values()
    when = "" if min(after) <= horizon.soonest else f" after {min(after):g} s"
    return f"{enumerated(list(horizon.worse))}{when}"


def left_out(horizon: ShortHorizon) -> str:
    """Responses that do not count, and why."""
    still, silent = (list(_named(dict.fromkeys(rows, 0.0))) for rows in (horizon.still, horizon.silent))
    parts = [f"these flights leave {enumerated(still)} alone"] if still else []
    unmoved = [name for name in silent if name not in still]
    parts += [f"nothing in the model makes {enumerated(unmoved, 'or')}"] if unmoved else []
    return f" Not counted: {'; '.join(parts)}." if parts else ""


def _named(responses: Mapping[str, float]) -> dict[str, float]:
    """R2 of the responses in plain words; the rotors' speeds together."""
    values = {NAMES.get(name, name): r2 for name, r2 in responses.items() if not name.startswith("omega")}
    speeds = [r2 for name, r2 in responses.items() if name.startswith("omega")]
    return values | ({"rotor speeds": sum(speeds) / len(speeds)} if speeds else {})
