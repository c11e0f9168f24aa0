"""A calibration of all probings, and the errors of models on probings that they never saw."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict

import numpy as np

from holdfast.calibration.study import PUBLISHED_N, Judged, Study
from holdfast.drivers.calibration import Calibration
from holdfast.drivers.calibration_fit import fit
from holdfast.edge_runtime.contract import FloatArray
from holdfast.edge_runtime.reading import Json

N_TREES = 200


def judge(
    study: Study, source: str, day: str, seed: int, begin: Callable[[str], None] = lambda text: None
) -> tuple[Calibration, list[Judged]]:
    """(calibration of all probings, errors of the linear map and of trees on probings left out).

    begin: called with what begins now.
    """
    begin(f"{study.name}: fitting one matrix")
    fitted = fit(
        study.field_ut,
        study.force_n,
        study.blocks,
        reversed_=study.reversed_,
        source=f"{source}/{study.name}",
        date=day,
        load_unit=study.load_unit,
    )
    plain = fitted.calibration
    calibration = Calibration(plain.matrix, study.rest_ut, plain.reversed, plain.meta)
    begin(f"{study.name}: extra trees on {len(study.probings)} splits, to compare with")
    trees = Judged("extra trees", _trees_rmse_n(study, seed))
    return calibration, [Judged("one matrix", fitted.held_out_n), trees]


def _trees_rmse_n(study: Study, seed: int) -> FloatArray:
    """[G, 3] RMSE of extra trees on each probing, fitted to the others, N."""
    from sklearn.ensemble import ExtraTreesRegressor

    field, force, blocks = study.field_ut, study.force_n, study.blocks
    field = field.reshape(len(blocks), -1)
    axes = np.flatnonzero(np.isfinite(force).all(axis=0))
    rmse = np.full((len(study.probings), 3), np.nan)
    for block in range(len(study.probings)):
        out = blocks == block
        model = ExtraTreesRegressor(N_TREES, min_samples_leaf=3, random_state=seed)
        model.fit(field[~out], force[~out][:, axes].squeeze())
        error = model.predict(field[out]).reshape(-1, len(axes)) - force[out][:, axes]
        rmse[block, axes] = np.sqrt(np.mean(error**2, axis=0))
    return rmse


def in_words(study: Study, judged: Sequence[Judged], calibration: Calibration) -> Iterator[str]:
    """Lines for people: the data, the evidence, the error of each model."""
    rows, n_sensors = calibration.meta.n, len(calibration.matrix)
    yield f"{study.name}: {len(study.probings)} probings, {rows} rows, {n_sensors} sensors"
    yield from (f"  {line}" for line in study.evidence)
    for model in judged:
        for axis, error in model.errors().items():
            each = ", ".join(f"{value:.2f}" for value in error.each_probing_n)
            rmse = f"RMSE {error.rmse_n:.2f} N on probings left out ({each})"
            published = f"eFlesh publishes {PUBLISHED_N[axis]} N"
            yield f"  {model.name}, {axis}: {rmse}; {published}, on later rows of the same probing"


def as_json(study: Study, judged: Sequence[Judged], seed: int) -> Json:
    """The same as a JSON object."""
    return {
        "study": study.name,
        "probings": [one.name for one in study.probings],
        "rows": len(study.blocks),
        "sensors": study.field_ut.shape[1],
        "load_unit": study.load_unit,
        "evidence": list(study.evidence),
        "seed": seed,
        "published_n": PUBLISHED_N,
        "models": {
            model.name: {axis: asdict(error) for axis, error in model.errors().items()}
            for model in judged
        },
    }
