"""What is judged of one flight at measured states: plain records, in the report as they are."""

from collections.abc import Mapping, Sequence
from typing import Annotated, NamedTuple

import msgspec

from rotorid_torch.core.storage.record import AtMostOne, Number, Record, Size


class Response(Record, frozen=True, kw_only=True):
    """What a model gives at measured states against what was measured, R2 = 1 - sum(error^2)/sum(deviation^2).

    Nothing is integrated. constant : mean of measured minus model over the flight; r2_without_constant : R2 with it
    taken out of the error. moved : whether the flight moves it clearly, without which R2 means nothing; described :
    whether anything of the model moves it. seconds : length of what is compared.
    """

    rmse: Size
    r2: AtMostOne
    unit: str
    constant: Number = None
    r2_without_constant: AtMostOne = None
    moved: bool = True
    described: bool = True
    seconds: Annotated[float, msgspec.Meta(gt=0)] = 1.0


class Prediction(Record, frozen=True, kw_only=True):
    """Mean norm of a quantity's error some seconds after measured states: of the model, and of holding them."""

    quantity: str
    seconds: Annotated[float, msgspec.Meta(gt=0)]
    unit: str
    error: Size
    held: Size


class WindowsRecord(Record, frozen=True, kw_only=True):
    """J over all 8-s windows of a flight: median, 10th and 90th percentile."""

    median: Size
    p10: Size
    p90: Size


class Judgement(NamedTuple):
    """Responses of a flight by name, and its predictions of every quantity and time."""

    responses: Mapping[str, Response]
    predictions: Sequence[Prediction] = ()
