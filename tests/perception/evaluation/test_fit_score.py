"""`pickproof fit-score`: what it fits, when it does not, and the file it leaves."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickproof.perception.data.scenes import VALIDATION_SEED
from pickproof.perception.estimate import shipped_score_model
from pickproof.perception.evaluation.fit_score import LEAST, Examples, fit
from pickproof.perception.ps6d.weights import file_hash, weights_path
from pickproof.perception.refinement.score_model import FEATURES, SIGNS, ScoreModel, brier_score, reliability
from pickproof.scenarios.commands.cli import main
from tests.perception.small_heaps import bracket, fill_folder


def examples(model: ScoreModel, count: int, seed: int = 0) -> Examples:
    """Poses whose odds of being right are those of `model`; every other one has no better rival."""
    rng = np.random.default_rng(seed)
    features = rng.normal(0, 1, (count, len(FEATURES)))
    return Examples(
        features, rng.random(count) < model.score(features), np.arange(count) % 2 == 0, np.arange(count) // 20
    )


def test_fit_calibrates_where_the_default_is_wrong() -> None:
    found = fit(examples(ScoreModel(tuple(0.5 * s for s in SIGNS), 0.5), 4000))
    assert found.model is not None
    half = found.record["unfitted_half"]
    assert isinstance(half, dict)
    assert half["ece_after"] < 0.06 < half["ece_before"]
    assert half["brier_after"] < half["brier_before"]
    assert half["standing"] == 1000
    other = examples(ScoreModel(tuple(0.5 * s for s in SIGNS), 0.5), 4000, seed=1)
    assert reliability(found.model.score(other.features), other.right)["ece"] == pytest.approx(0, abs=0.05)


def test_a_default_that_is_true_stays() -> None:
    found = fit(examples(ScoreModel(), 600))
    assert found.model is None and "no better" in found.reason


@pytest.mark.parametrize("label", [True, False])
def test_too_few_of_a_kind_keep_the_default(label: bool) -> None:
    many = examples(ScoreModel(tuple(0.5 * s for s in SIGNS), 0.0), 2000)
    found = fit(replace(many, right=np.full(2000, label)))
    assert found.model is None and f"{LEAST} are needed" in found.reason
    assert found.record["right"] == (2000 if label else 0)
    assert fit(many.select(np.zeros(2000, dtype=bool))).model is None
    found = fit(replace(many, right=many.right | many.standing))
    assert found.model is None and "wrong unrivalled" in found.reason


def test_odds_are_those_of_the_standing_poses() -> None:
    model = ScoreModel(tuple(0.5 * s for s in SIGNS), 0.0)
    examined = examples(model, 4000)
    easier = ScoreModel(tuple(0.7 * s for s in SIGNS), 1.5)
    rng = np.random.default_rng(1)
    odds = np.where(examined.standing, easier.score(examined.features), model.score(examined.features))
    found = fit(replace(examined, right=rng.random(4000) < odds)).model
    assert found is not None
    standing = examined.features[examined.standing]
    assert np.abs(found.score(standing) - easier.score(standing)).mean() < 0.04
    assert np.abs(found.score(standing) - model.score(standing)).mean() > 0.08


def test_rescaling_keeps_the_order() -> None:
    many = examples(ScoreModel(tuple(0.5 * s for s in SIGNS), 0.0), 500)
    model = ScoreModel(tuple(0.1 * s for s in SIGNS), 3.0)
    rescaled = model.rescaled(many.features, many.right)
    assert (np.argsort(rescaled.score(many.features)) == np.argsort(model.score(many.features))).all()
    assert rescaled.score(many.features).mean() == pytest.approx(many.right.mean(), abs=0.01)


def test_brier_score_is_least_at_the_true_probability() -> None:
    right = np.arange(10) < 7
    scores = [brier_score(np.full(10, p), right) for p in (0.5, 0.7, 0.9)]
    assert min(scores) == scores[1] == pytest.approx(0.21)
    assert brier_score(right.astype(float), right) == 0


@pytest.fixture
def own_bracket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the bracket's folder that a test may write to, with two small validation heaps at hand."""
    folder = tmp_path / "workpieces" / "bracket"
    shutil.copytree(bracket().folder, folder)
    (folder / "score.json").unlink(missing_ok=True)
    monkeypatch.setenv("PICKPROOF_WORKPIECES", str(folder.parent))
    monkeypatch.chdir(tmp_path)
    fill_folder(tmp_path / "out" / "heaps", VALIDATION_SEED, 2)
    return folder


@pytest.mark.slow
def test_command_writes_a_model_that_perception_loads(
    own_bracket: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (own_bracket / "score.json").write_text("of an older version")
    assert main(["fit-score", "bracket", "--frames", "2"]) == 3
    printed = " ".join(capsys.readouterr().out.split())
    assert f"{LEAST} are needed" in printed and "nothing written" in printed
    assert (own_bracket / "score.json").read_text() == "of an older version"
    monkeypatch.setattr("pickproof.perception.evaluation.fit_score.LEAST", 1)
    monkeypatch.setattr("pickproof.perception.evaluation.fit_score.LEAST_STANDING", 0)
    (own_bracket / "score.json").unlink()
    code = main(["fit-score", "bracket", "--frames", "2"])
    assert "expected calibration error" in " ".join(capsys.readouterr().out.split())
    found = shipped_score_model(replace(bracket(), folder=own_bracket))
    assert (code, found is None) in ((0, False), (3, True))  # whether two heaps beat the default is not for a test


def test_saved_model_keeps_its_record(own_bracket: Path) -> None:
    part = bracket()
    model = ScoreModel(tuple(0.5 * s for s in SIGNS), 0.25)
    model.save(own_bracket / "score.json", {"frames": 3, "weights": file_hash(weights_path(part))})
    assert ScoreModel.load(own_bracket / "score.json") == model
    assert shipped_score_model(replace(part, folder=own_bracket)) == model
    assert json.loads((own_bracket / "score.json").read_text())["record"]["frames"] == 3


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["bracket", "--frames", "1"], ["--frames", "2 to 1000000"]),
        (["bracket", "--workers", "0"], ["--workers", "1 to 256"]),
        (["bracket", "--out", "nowhere/score.json"], ["--out", "nowhere"]),
        (["bracket", "--weights", "none.safetensors"], ["none.safetensors", "pickproof train bracket"]),
        (["brackett"], ["brackett", "bracket"]),
    ],
)
def test_bad_input_is_named(words: list[str], names: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit-score", *words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and all(name in error for name in names)
