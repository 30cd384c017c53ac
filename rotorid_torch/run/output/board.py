"""The record of a run for TensorBoard, written event by event: what cannot be written is an error here and now."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tensorboard.compat.proto.event_pb2 import Event  # pyright: ignore[reportAttributeAccessIssue]
from tensorboard.compat.proto.summary_pb2 import Summary, SummaryMetadata  # pyright: ignore[reportAttributeAccessIssue]
from tensorboard.compat.proto.tensor_pb2 import TensorProto  # pyright: ignore[reportAttributeAccessIssue]
from tensorboard.compat.proto.types_pb2 import DT_STRING  # pyright: ignore[reportAttributeAccessIssue]
from tensorboard.summary.writer.record_writer import RecordWriter
from torch.utils.tensorboard.summary import hparams


class Board:
    """Scalars and pictures of a run.

    folder : where TensorBoard looks; made if it is missing.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._records = RecordWriter((folder / f"events.out.tfevents.{time.time():.0f}.rotorid").open("wb"))
        self._write(file_version="brain.Event:2")

    def scalars(self, values: Mapping[str, float], iteration: int) -> None:
        """Record numbers of one iteration, by name."""
        summary = Summary(value=[Summary.Value(tag=name, simple_value=value) for name, value in values.items()])
        if values:
            self._write(summary=summary, step=iteration)

    def picture(self, name: str, png: bytes, iteration: int) -> None:
        """Record a picture as it is."""
        width, height = (int.from_bytes(png[k : k + 4], "big") for k in (16, 20))  # PNG's header
        image = Summary.Image(width=width, height=height, colorspace=4, encoded_image_string=png)
        self._write(summary=Summary(value=[Summary.Value(tag=name, image=image)]), step=iteration)

    def text(self, name: str, words: str) -> None:
        """Record words, in Markdown."""
        plugin = SummaryMetadata(plugin_data=SummaryMetadata.PluginData(plugin_name="text"))
        tensor = TensorProto(dtype=DT_STRING, string_val=[words.encode()])
        self._write(summary=Summary(value=[Summary.Value(tag=name, metadata=plugin, tensor=tensor)]), step=0)

    def settings(self, values: Mapping[str, str | float], results: Sequence[str]) -> None:
        """Record what a run was made with, and which of its numbers are results, for the table of runs."""
        for part in hparams(dict(values), dict.fromkeys(results, 0.0)):
            self._write(summary=part, step=0)

    def close(self) -> None:
        """Close the file."""
        self._records.close()

    def _write(self, **event: Any) -> None:
        self._records.write(Event(wall_time=time.time(), **event).SerializeToString())
        self._records.flush()
