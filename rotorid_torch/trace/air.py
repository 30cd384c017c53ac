"""Moving air in what is compared: gusts as inputs of the models, smoothed from each flight, on the data and on draws.

Clean aircraft fly in gusts of the intensity and length that step 3 came to for the data, and their gusts are smoothed
as the data's are: whatever gusts leave over, or a smoother takes away, is in the critical values too.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch

from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.gusts import Weather, histories, in_weather
from rotorid_torch.identification.model_estimation import sensor_noise
from rotorid_torch.identification.model_regression import regress_model
from rotorid_torch.model.gusts import GUSTS, with_gust_inputs
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.fits import Flights


def in_moving_air(
    spec: ModelSpec, values: Mapping[str, float], flights: Flights, weather: Weather
) -> tuple[ModelSpec, Flights]:
    """The spec with gusts among its inputs, and the flights with theirs as channels, by step 2's derivatives.

    values : of the parameters that step 2 does not tell, or doubts.
    """
    dataset, model = flights.dataset, build(spec, values)
    step2 = regress_model(model, dataset, flights.reconstruction)
    model.put(step2.theta)
    model.start_from({n: values[n] for n in step2.doubtful(model.parameter_set.free) if n in values})
    batch = flights.records(model, tuple(dataset.flights))
    gusts = in_weather(model, weather, batch, sensor_noise(model, dataset))
    moving = {}
    for name, (time, velocities) in histories(tuple(dataset.flights), batch, gusts).items():
        flight = dataset.flights[name]
        at = [np.interp(flight.time.numpy(), time.numpy(), v) for v in velocities.numpy().T]
        channels = {**flight.channels, **{g: torch.from_numpy(v) for g, v in zip(GUSTS, at, strict=True)}}
        moving[name] = replace(flight, channels=channels)
    return with_gust_inputs(spec), replace(flights, dataset=dataset.with_flights(moving), weather=weather)
