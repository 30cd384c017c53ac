"""The report of a run as typed records: what report.json holds, field by field and in its order.

A number that is not finite has no place in JSON: a record turns it into None when it is made, so that what is written
and what is read back are equal.
"""

from __future__ import annotations

import math
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal

import msgspec

from rotorid_torch.errors import InputError

Number = float | None
Status = Literal["free", "frozen", "nuisance", "not identifiable"]
Role = Literal["undeclared", "structure", "learnt"]
VerdictKind = Literal["nothing undeclared", "undeclared", "group", "unknown", "structure"]
EffectVerdict = Literal["accepted", "rejected", "below floor", "indistinguishable", "not testable"]
LISTS = ("identify", "validate", "acid")


def package_version() -> str:
    """Version of rotorid-torch as installed; "0" where it is run without being installed."""
    try:
        return version("rotorid-torch")
    except PackageNotFoundError:
        return "0"


def _finite(value: object) -> object:
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None  # a plain number, whatever library it comes from
    if isinstance(value, tuple):
        return tuple(_finite(item) for item in value)
    return value


class Record(msgspec.Struct, frozen=True, kw_only=True):
    """A part of the report; numbers that are not finite become None."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            msgspec.structs.force_setattr(self, name, _finite(getattr(self, name)))


class ParameterRecord(Record, frozen=True, kw_only=True):
    """PARAMETER: one parameter of a fit, with its standard error and bounds in its unit."""

    name: str
    value: Number
    se: Number
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

    rmse: Number
    r2: Number
    theil: Number
    theil_parts: tuple[Number, Number, Number]


class WindowsRecord(Record, frozen=True, kw_only=True):
    """J over all 8-s windows of a flight: median, 10th and 90th percentile."""

    median: Number
    p10: Number
    p90: Number


class ResponseRecord(Record, frozen=True, kw_only=True):
    """What a model gives at measured states against what was measured: nothing is integrated."""

    rmse: Number
    r2: Number
    unit: str


class PredictionRecord(Record, frozen=True, kw_only=True):
    """Mean norm of a quantity's error some seconds after measured states: of the model, and of holding them."""

    quantity: str
    seconds: float
    unit: str
    error: Number
    held: Number


class FlightRecord(Record, frozen=True, kw_only=True, omit_defaults=True):
    """Scores of one flight's free run; of a multirotor's flight also its responses and predictions."""

    list: Literal["identify", "validate", "acid"]
    J: Number
    J_noise: Number
    J_trim: Number
    windows: WindowsRecord
    channels: dict[str, ChannelRecord]
    responses: dict[str, ResponseRecord] = {}
    predictions: tuple[PredictionRecord, ...] = ()


class ScoresRecord(Record, frozen=True, kw_only=True):
    """Scores of the three lists; None for a list without flights."""

    identify: Number
    validate: Number
    acid: Number


class FitRecord(Record, frozen=True, kw_only=True):
    """FIT: an identified model's parameters, modes and scores."""

    parameters: tuple[ParameterRecord, ...]
    modes: tuple[ModeRecord, ...]
    flights: dict[str, FlightRecord]
    scores: ScoresRecord


class VisibleRecord(Record, frozen=True, kw_only=True):
    """Smallest size of an effect that these data would show."""

    value: Number
    unit: str


class EffectRecord(Record, frozen=True, kw_only=True):
    """What was found about one effect."""

    id: str
    role: Role
    verdict: EffectVerdict
    reason: str
    gain: Number = None
    floor: Number = None
    smallest_visible: VisibleRecord | None = None
    group: tuple[str, ...] = ()
    parameters: tuple[ParameterRecord, ...] = ()


class VerdictRecord(Record, frozen=True, kw_only=True):
    """The run's one statement about undeclared effects."""

    kind: VerdictKind
    effects: tuple[str, ...]
    sentence: str


class UnknownRecord(Record, frozen=True, kw_only=True):
    """Something that is missing from the model, localised and not named."""

    where: str
    band_hz: tuple[Number, Number]
    goes_with: str | None
    since_s: Number
    sentence: str


class DatasetRecord(Record, frozen=True, kw_only=True):
    """Which data set was used."""

    name: str
    sha256: str


class TimeRecord(Record, frozen=True, kw_only=True):
    """Seconds spent in each step."""

    reconstruct: Number = 0.0
    ftr: Number = 0.0
    ml: Number = 0.0
    trace: Number = 0.0
    total: Number = 0.0


class Report(Record, frozen=True, kw_only=True):
    """report.json. `before` is None for a command that fits no model; `verdict` is None where nothing was traced."""

    format: Literal[1] = 1
    rotorid: str = msgspec.field(default_factory=package_version)
    command: str
    dataset: DatasetRecord
    seed: int
    time_s: TimeRecord
    peak_memory_mb: Number
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


def encode_report(report: Report) -> bytes:
    """Return the bytes of report.json."""
    return msgspec.json.format(msgspec.json.encode(report), indent=1) + b"\n"


def read_report(run: str | Path) -> Report:
    """Read RUN/report.json.

    Raises
    ------
    InputError : no such file, or not a report of this format.
    """
    file = Path(run) / "report.json"
    try:
        return msgspec.json.decode(file.read_bytes(), type=Report)
    except OSError as error:
        raise InputError(file, "", error.strerror or "cannot be read", "a RUN written by rotorid") from error
    except msgspec.DecodeError as error:
        raise InputError(file, "", f"not a report: {error}", "report.json of format 1, as rotorid writes it") from error
