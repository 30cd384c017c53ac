"""The report of a run as typed records: what report.json holds, field by field and in its order.

A number that is not finite has no place in JSON: a record turns it into None when it is made, so that what is written
and what is read back are equal.
"""

import os
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from rotorid_torch.core.names import Kind, Verdict
from rotorid_torch.core.storage.atomic import restore
from rotorid_torch.core.storage.files import read_file
from rotorid_torch.core.storage.paths import nearest_path
from rotorid_torch.core.storage.record import AtMostOne, Number, Record, Share, Size
from rotorid_torch.data.refusal import convert
from rotorid_torch.errors import InputError
from rotorid_torch.validate.judged import Prediction, Response, WindowsRecord
from rotorid_torch.version import __version__

INSIDE = 5
"""Runs in a folder that a message names, at most."""
LARGEST = 64 * 2**20
"""Bytes of a report.json at most."""
Status = Literal["free", "frozen", "nuisance", "not identifiable"]
Role = Literal["undeclared", "structure", "learnt"]
LISTS = ("identify", "validate", "acid")


class ParameterRecord(Record, frozen=True, kw_only=True):
    """PARAMETER: one parameter of a fit, with its standard error and bounds in its unit."""

    name: str
    value: Number
    se: Size
    unit: str
    bounds: tuple[Number, Number] = (None, None)
    at_bound: bool = False
    status: Status = "free"


class ModeRecord(Record, frozen=True, kw_only=True):
    """One mode of the linearised model: eigenvalue (1/s) as real and imaginary part, and the field's name for it."""

    eigenvalue: tuple[Number, Number]
    name: str


class ChannelRecord(Record, frozen=True, kw_only=True):
    """A free run's error in one channel; Theil's parts are bias, variance and covariance."""

    rmse: Size
    r2: AtMostOne
    theil: Share
    theil_parts: tuple[Number, Number, Number]


class FlightRecord(Record, frozen=True, kw_only=True, omit_defaults=True):
    """Scores of one flight's free run; of a multirotor's flight also its responses and predictions.

    J_gust : of what the gusts that were found alone would do, where the air moves. J_fed : with them fed into the run.
    """

    list: Literal["identify", "validate", "acid"]
    J: Size
    J_noise: Size
    J_trim: Size
    windows: WindowsRecord
    channels: dict[str, ChannelRecord]
    responses: dict[str, Response] = msgspec.field(default_factory=dict)
    predictions: tuple[Prediction, ...] = ()
    J_gust: Size = None
    J_fed: Size = None


class ScoresRecord(Record, frozen=True, kw_only=True):
    """Scores of the three lists; None for a list without flights."""

    identify: Size
    validate: Size
    acid: Size


class GustRecord(Record, frozen=True, kw_only=True):
    """Gusts along one body axis, as the filter error method found them: rms, m/s, and scale length, m."""

    axis: Literal["u", "v", "w"]
    intensity: Size
    intensity_se: Size
    length: Size
    length_se: Size


class FitRecord(Record, frozen=True, kw_only=True):
    """FIT: an identified model's parameters, modes and scores.

    method_reason : how the method was chosen. gusts : of the flights, where the method finds them. derivatives : of
    forces and moments by body motion and controls, with the rotor settled; none of a multirotor.
    """

    method: Literal["output-error", "filter-error"] = "output-error"
    method_reason: str = ""
    gusts: tuple[GustRecord, ...] = ()
    parameters: tuple[ParameterRecord, ...]
    derivatives: tuple[ParameterRecord, ...] = ()
    modes: tuple[ModeRecord, ...]
    flights: dict[str, FlightRecord]
    scores: ScoresRecord

    def __repr__(self) -> str:
        sizes = f"{len(self.parameters)} parameters, {len(self.modes)} modes, {len(self.flights)} flights"
        return f"FitRecord by {self.method}: {sizes}; {self.scores}"


class VisibleRecord(Record, frozen=True, kw_only=True):
    """Smallest size of an effect that these data would show."""

    value: Number
    unit: str


class EffectRecord(Record, frozen=True, kw_only=True):
    """What was found about one effect."""

    id: str
    role: Role
    verdict: Verdict
    reason: str
    gain: Number = None
    floor: Number = None
    p: Number = None
    smallest_visible: VisibleRecord | None = None
    group: tuple[str, ...] = ()
    parameters: tuple[ParameterRecord, ...] = ()

    @property
    def ratio(self) -> float:
        """Evidence over its floor; zero where there is none."""
        return (self.gain or 0.0) / self.floor if self.floor else 0.0

    @property
    def shown(self) -> str:
        """The verdict, of what others absorb "absorbed" where no evidence asks for it."""
        return "absorbed" if self.verdict == "indistinguishable" and self.ratio <= 1.0 else self.verdict

    def __repr__(self) -> str:
        return f"EffectRecord({self.id}: {self.verdict}, {len(self.parameters)} parameters)"


class VerdictRecord(Record, frozen=True, kw_only=True):
    """The run's one statement about undeclared effects."""

    kind: Kind
    effects: tuple[str, ...]
    sentence: str


class UnknownRecord(Record, frozen=True, kw_only=True):
    """Something that is missing from the model, localised and not named."""

    where: str
    band_hz: tuple[Size, Size]
    goes_with: str | None
    since_s: Size
    sentence: str


class DatasetRecord(Record, frozen=True, kw_only=True):
    """Which data set was used."""

    name: str
    sha256: str


class TimeRecord(Record, frozen=True, kw_only=True):
    """Seconds spent in each step."""

    reconstruct: Size = 0.0
    ftr: Size = 0.0
    ml: Size = 0.0
    trace: Size = 0.0
    total: Size = 0.0


class Report(Record, frozen=True, kw_only=True):
    """report.json. `before` is None for a command that fits no model; `verdict` is None where nothing was traced."""

    format: Literal[1] = 1
    rotorid: str = __version__
    command: str
    dataset: DatasetRecord
    seed: Annotated[int, msgspec.Meta(ge=0)]
    time_s: TimeRecord
    peak_memory_mb: Size
    before: FitRecord | None
    after: FitRecord | None = None
    verdict: VerdictRecord | None = None
    effects: tuple[EffectRecord, ...] = ()
    unknown: UnknownRecord | None = None
    warnings: tuple[str, ...] = ()

    @property
    def fit(self) -> FitRecord | None:
        """The fit that counts: the one after closing the loop where there is one."""
        return self.after or self.before

    def __repr__(self) -> str:
        said = "" if self.verdict is None else f": {self.verdict.sentence}"
        return f"Report of {self.command} on {self.dataset.name}, {len(self.effects)} effects{said}"

    def method_of(self, fit: FitRecord) -> str:
        """How the method of a fit was chosen; nothing of the fit after where the fit before says the same."""
        said = fit is self.after and self.before is not None and self.before.method_reason == fit.method_reason
        return "" if said else fit.method_reason


def encode_report(report: Report) -> bytes:
    """Return the bytes of report.json."""
    return msgspec.json.format(msgspec.json.encode(report), indent=1) + b"\n"


def read_report(run: str | Path) -> Report:
    """Read RUN/report.json.

    Raises InputError: no such file, or not a report of this format.
    """
    restore(Path(run))
    file = Path(run) / "report.json"
    _refuse_no_run(Path(run))
    content = read_file(file, "a RUN written by rotorid", LARGEST)
    try:
        document = msgspec.json.decode(content)
    except (ValueError, RecursionError) as error:
        raise InputError(file, "", f"is not JSON: {error}", "report.json as rotorid writes it") from None
    report = convert(document, Report, file, "")
    for key, low, high in _pairs(document, ""):
        if low > high:
            raise InputError(file, key, f"is {low:g} to {high:g}", "lower below upper")
    return report


def _refuse_no_run(place: Path) -> None:
    """Say what a place is, where it is no run, and which runs are near."""
    expected = "a RUN: a folder that rotorid identify, close-loop, check or reconstruct wrote"
    if place.is_file():
        around = place.parent if (place.parent / "report.json").is_file() else None
        raise InputError(place, "", "is a file", f"{expected}, as '{around}' is" if around else expected)
    if not place.is_dir():
        raise InputError(place, "", f"there is no such folder{nearest_path(place)}", expected)
    if os.path.lexists(place / "report.json"):  # what is wrong with a link is said where it is read
        return
    if (place / "dataset.toml").exists():
        raise InputError(place, "", "is a data set, not a run", expected)
    runs = sorted(child.parent.name for child in islice(place.glob("*/report.json"), INSIDE))
    hint = f"; inside are {', '.join(runs)}" if runs else ""
    raise InputError(place, "", f"holds no report.json{hint}", expected)


def _pairs(value: Any, key: str) -> Iterator[tuple[str, float, float]]:
    """Ranges in a report, with their keys: bounds, bands, and percentiles about a median."""
    if isinstance(value, list):
        for index, item in enumerate(value):
            yield from _pairs(item, f"{key}[{index}]")
    if not isinstance(value, dict):
        return
    for name, item in value.items():
        yield from _pairs(item, f"{key}.{name}" if key else name)
        if name in ("bounds", "band_hz") and None not in item:
            yield f"{key}.{name}", item[0], item[1]
    if {"p10", "median", "p90"} <= value.keys() and None not in value.values():
        yield f"{key}.p10", value["p10"], value["median"]
        yield f"{key}.p90", value["median"], value["p90"]
