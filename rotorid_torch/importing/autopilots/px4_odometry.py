"""PX4's odometry, which stands for attitude and local position where these were not logged.

Source: PX4 Autopilot, msg/VehicleOdometry.msg: the frames of pose and velocity. Since v1.14 their numbers begin with
one for unknown; before v1.11 the message has none, and all is north-east-down.
"""

from collections.abc import Mapping

import numpy as np

from rotorid_torch.importing.signals.mapping import Entry
from rotorid_torch.importing.signals.plan import QUATERNION, Group
from rotorid_torch.importing.signals.streams import Log

TOPIC = "vehicle_odometry"
NED, LEVEL, BODY = "north-east-down axes", "level axes of any heading", "body axes"
NUMBERS: Mapping[str, Mapping[int, str]] = {
    "pose_frame": {1: NED, 2: LEVEL, 3: BODY},
    "local_frame": {0: NED, 1: LEVEL, 3: BODY},
}
"""Frames by their numbers, by the field that newer and older messages have for that of the pose."""
Q = [f"q[{i}]" for i in range(4)]
PLACES = {"pose_frame": [f"position[{i}]" for i in range(3)], "local_frame": ["x", "y", "z"]}
VELOCITIES = {"pose_frame": [f"velocity[{i}]" for i in range(3)], "local_frame": ["vx", "vy", "vz"]}
FIELDS = [*Q, *NUMBERS, "velocity_frame", *(f for form in (PLACES, VELOCITIES) for some in form.values() for f in some)]


def spare(log: Log, alone: bool) -> tuple[list[Group], list[Group], list[str]]:
    """Groups of attitude, and of velocity and place, that the message's frames allow; sentences on these frames.

    alone : whether the log has no other attitude and place. With those, a heading of any zero does not go together.
    """
    if not log.instances(TOPIC):
        return [], [], []
    columns = log.streams[TOPIC, log.instances(TOPIC)[0]].columns
    form = "pose_frame" if "pose_frame" in columns else "local_frame"
    pose, moving = (_frame(columns.get(field), NUMBERS[form]) for field in (form, "velocity_frame"))
    turned_by = pose if alone else NED
    attitude, motion = dict[str, Entry](), dict[str, Entry]()
    if pose in (NED, LEVEL) and pose == turned_by:
        attitude.update(zip(QUATERNION, map(Entry, Q), strict=True))
    if moving and moving in (BODY, turned_by):
        motion = dict(zip("uvw" if moving == BODY else ("vn", "ve", "vd"), map(Entry, VELOCITIES[form]), strict=True))
    if pose == NED:
        north, east, down = PLACES[form]
        motion |= {"north": Entry(north), "east": Entry(east), "height": Entry(down, sign=-1)}
    said = [f"{TOPIC} is in {LEVEL}: psi does not count from north"] if alone and pose == LEVEL else []
    said += [f"{TOPIC} is left: its frame is unknown, or several in turn"] if alone and not (pose and moving) else []
    attitudes, motions = ([Group(TOPIC, some, spare=True)] if some else [] for some in (attitude, motion))
    return attitudes, motions, said


def _frame(values: np.ndarray | None, words: Mapping[int, str]) -> str:
    """The one frame that a column of numbers names; empty where it names none of these, or several."""
    if values is None:
        return NED
    numbers = [int(number) for number in np.unique(values)]
    return words.get(numbers[0], "") if len(numbers) == 1 else ""
