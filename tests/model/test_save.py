"""model.pt: what is written comes back; what is broken is told in one line that names the file."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.errors import InputError
from rotorid_torch.model.nominal import build
from rotorid_torch.model.save import load, save
from tests.known_models import body_spec, helicopter_spec, points, scattered


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "model.pt"
    spec = body_spec(effects=("control.delay",))
    save(scattered(build(spec)), spec, path)
    return path


@pytest.mark.parametrize("flapping", ["first order", "algebraic", "none"])
def test_a_model_comes_back_as_it_was(flapping: Any, tmp_path: Path):
    spec = helicopter_spec(flapping, effects=("control.delay",))
    model = scattered(build(spec))
    save(model, spec, tmp_path / "model.pt")
    loaded, read = load(tmp_path / "model.pt")
    assert read == spec
    assert torch.equal(loaded.theta, model.theta)
    assert loaded.theta.dtype == torch.float64
    x, u = points(model, 3)
    assert torch.equal(loaded(torch.tensor(0.0), x, u), model(torch.tensor(0.0), x, u))
    assert torch.equal(loaded.output(x, u), model.output(x, u))
    assert torch.load(tmp_path / "model.pt", weights_only=True)["format"] == 1


@given(st.sampled_from(["first order", "algebraic", "none"]), st.floats(100.0, 1e5), st.floats(-1.0, 1.0))
def test_a_spec_goes_round_through_plain_data(flapping: Any, mass: float, phi: float):
    spec = helicopter_spec(flapping, mass=mass, reference={"phi": phi})
    assert ModelSpec.from_plain(spec.plain()) == spec


def test_the_model_of_an_earlier_version_is_to_be_identified_again(written: Path, tmp_path: Path):
    held = torch.load(written, weights_only=True)
    held["state"]["theta"] = held["state"]["theta"][:-1]
    torch.save(held, tmp_path / "model.pt")
    text = str(refused(tmp_path / "model.pt"))
    assert "an earlier version wrote the file" in text
    assert "identify again" in text


def refused(path: Path) -> InputError:
    with pytest.raises(InputError) as refusal:
        load(path)
    assert "\n" not in str(refusal.value)
    assert str(refusal.value).startswith(str(path))
    return refusal.value


def test_no_file_and_a_folder(tmp_path: Path):
    assert "no such file" in str(refused(tmp_path / "model.pt"))
    refused(tmp_path)


@settings(max_examples=12)
@given(share=st.floats(0.0, 0.999))
def test_a_truncated_file(share: float, written: Path, tmp_path_factory: pytest.TempPathFactory):
    whole = written.read_bytes()
    path = tmp_path_factory.mktemp("cut") / "model.pt"
    path.write_bytes(whole[: int(share * len(whole))])
    refused(path)


@settings(max_examples=60)
@given(content=st.binary(max_size=40))
def test_any_bytes(content: bytes, tmp_path_factory: pytest.TempPathFactory):
    path = tmp_path_factory.mktemp("bytes") / "model.pt"
    path.write_bytes(content)
    refused(path)


def test_a_pickle_that_runs_code(tmp_path: Path):
    path = tmp_path / "model.pt"
    path.write_bytes(pickle.dumps(Path("x")))
    refused(path)
    torch.save({"format": 1, "spec": Path("x"), "state": {}}, path)
    refused(path)


def changed(written: Path, path: Path, **changes: Any) -> Path:
    torch.save(torch.load(written, weights_only=True) | changes, path)
    return path


def foreign(written: Path) -> list[dict[str, Any]]:
    held = torch.load(written, weights_only=True)
    spec, state = held["spec"], held["state"]
    return [
        {"format": 2},
        {"spec": None},
        {"spec": {}},
        {"spec": spec | {"controls": 3}},
        {"spec": spec | {"controls": ["lon"]}},
        {"spec": spec | {"states": ["u", "x"]}},
        {"spec": spec | {"patterns": {}}},
        {"spec": spec | {"inertia": [[1.0, 0.0], [0.0, 1.0]]}},
        {"spec": spec | {"effects": ["somebody.else"]}},
        {"spec": spec | {"reference": spec["reference"] | {"L.trim": float("nan")}}},
        {"state": None},
        {"state": {}},
        {"state": state | {"theta": torch.zeros(3)}},
        {"state": state | {"theta": torch.full_like(state["theta"], torch.nan)}},
        {"state": state | {"theta": state["theta"] - 1.0}},  # the delay leaves its bounds
        {"state": state | {"more": torch.zeros(3)}},
    ]


@pytest.mark.parametrize("case", range(16))
def test_a_file_that_is_no_model_of_ours(case: int, written: Path, tmp_path: Path):
    refused(changed(written, tmp_path / "model.pt", **foreign(written)[case]))


def test_other_things_that_torch_saves(tmp_path: Path):
    for k, thing in enumerate((torch.zeros(3), [1, 2], {"state_dict": {}}, torch.nn.Linear(2, 2).state_dict())):
        torch.save(thing, tmp_path / f"{k}.pt")
        refused(tmp_path / f"{k}.pt")
    np.savez(tmp_path / "arrays.npz", a=np.zeros(3))
    refused(tmp_path / "arrays.npz")


def test_an_effect_that_is_not_there_is_named(written: Path, tmp_path: Path):
    path = changed(written, tmp_path / "model.pt", **foreign(written)[8])
    assert "somebody.else" in str(refused(path))
