"""Kinematics linearised: several sets of errors at once, points that are kept, vectors that are turned."""

import numpy as np
from scipy.spatial.transform import Rotation

from rotorid_torch.consistency.equations import rotated
from rotorid_torch.consistency.sensor_errors.normal_equations import Search
from rotorid_torch.consistency.sensor_errors.pieces import pieces
from rotorid_torch.consistency.sensor_errors.weighted_fit import Setting, residual, rows
from tests.consistency.sensor_errors.kinematic_cases import data

SIZES = {
    "delay.rates": 0.013,
    "filter.velocities": 0.02,
    "scale.q": 0.05,
    "bias.p": 0.01,
    "misalignment.y": 0.03,
    "lever_arm.x": 0.4,
    "scale.ax": 0.1,
}
SETTING = Setting(9.81, np.array([0.1, 0.0, -0.2]))


def test_residuals_of_several_sets_are_those_of_each():
    (piece,) = pieces(data({}, 1, flights=1))
    names, frequencies = [*SIZES], np.arange(1, 40) / 15.0
    sets = {name: np.where(np.eye(len(SIZES) + 1)[i], SIZES[name], 0.0) for i, name in enumerate(names)}
    together = residual(piece, SETTING, sets, frequencies)
    alone = [residual(piece, SETTING, {name: SIZES[name]}, frequencies) for name in names]
    alone.append(residual(piece, SETTING, {}, frequencies))
    np.testing.assert_allclose(together, np.stack(alone), rtol=1e-11, atol=1e-11)


def test_rows_by_several_errors_are_those_by_each():
    search = Search(pieces(data({}, 1, flights=1)), SETTING)
    search.at({}, ())
    (piece,), (held,) = search.pieces, search.constants
    together = rows(piece, SETTING, {"delay.rates": 0.01}, [*SIZES], {}, held)
    count = len(held[0])
    for i, name in enumerate(SIZES):
        alone = rows(piece, SETTING, {"delay.rates": 0.01}, [name], {}, held)
        np.testing.assert_allclose(together.matrix[:, count + i], alone.matrix[:, count], rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(together.towards[count + i], alone.towards[count], rtol=1e-8)
        np.testing.assert_allclose(together.residual, alone.residual, rtol=1e-12, atol=1e-12)


def test_a_point_that_is_kept_is_the_one_for_fewer_names():
    cut, errors = pieces(data({}, 1, flights=2)), {"delay.rates": 0.01, "scale.q": 0.0}
    kept = Search(cut, SETTING)
    kept.at(errors, [*SIZES])
    found, fresh = kept.at({"delay.rates": 0.01}, ["scale.q"]), Search(cut, SETTING)
    fresh.at({}, ())
    fresh.constants = kept.constants
    wanted = fresh.at({"delay.rates": 0.01}, ["scale.q"])
    assert (found.errors, found.names) == (wanted.errors, wanted.names)
    np.testing.assert_allclose(found.matrix, wanted.matrix, rtol=1e-9)
    np.testing.assert_allclose(found.gradient, wanted.gradient, rtol=1e-7)
    assert found.joining("scale.q", ()) == (
        np.float64(-found.gradient[0] / found.matrix[0, 0]),
        found.matrix[0, 0],
    )


def test_a_vector_is_turned_as_by_a_matrix():
    values = np.random.default_rng(1).normal(size=(3, 5))
    for turn in ([0.3, -0.2, 0.9], [0.0, 0.0, 0.0], [1e-9, 0.0, 0.0]):
        np.testing.assert_allclose(np.stack(rotated([*values], turn)), Rotation.from_rotvec(turn).apply(values.T).T)
