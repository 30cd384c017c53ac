"""Signs and axes that no mounting makes: exchanged or reversed body rates, or one angle of the other sign.

To the rates alone both look alike; what velocities and positions say besides tells which it is.
"""

from rotorid_torch.consistency.pairs.alignment import BETTER, alignment
from rotorid_torch.consistency.pairs.odd_flights import disagreement
from rotorid_torch.core import names
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight


@once
def right_signs(dataset: Dataset) -> tuple[Dataset, str]:
    """The data set with signs and axes put right, and the angle whose sign was wrong; itself where nothing is mirrored.

    The angle is empty where it is the rates that are exchanged or reversed.
    """
    mirror = alignment(dataset).mirror
    if not mirror:
        return dataset, ""
    words = zip(names.RATES, mirror.split(), strict=True)
    best = _read(dataset, {word[1]: (rate, -1.0 if word[0] == "-" else 1.0) for rate, word in words})
    least, wrong = BETTER * disagreement(best), ""
    for angle in names.ATTITUDES:
        other = _read(dataset, {angle: (angle, -1.0)})
        if not alignment(other).mirror and (apart := disagreement(other)) < least:
            best, least, wrong = other, apart, angle
    return best, wrong


def _read(dataset: Dataset, places: dict[str, tuple[str, float]]) -> Dataset:
    """The data set with channels that are read from others, times a sign."""

    def of(flight: Flight) -> Flight:
        read = {name: sign * flight.channels[place] for name, (place, sign) in places.items()}
        return Flight(flight.name, flight.dt, {**flight.channels, **read}) if flight.has(*places) else flight

    return dataset.changed(of)
