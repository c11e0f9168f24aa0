"""The report of simulated scenes: scores, baselines, what is unseen, and whole trials.

`write_scene_report` shows what the figures hold, so `demo_report` makes the same page from one
small set. The page itself is studies/templates/scenes.html.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from holdfast.evaluation import stream_pictures as draw
from holdfast.evaluation.stream_pictures import StreamPicture
from holdfast.evaluation.window_scores import confusion, scores
from holdfast.export.spec import window_samples
from holdfast.training.crossval import HeldOut
from holdfast.training.recording import DataSet
from studies.real.pictures import confusion as four_by_four
from studies.report import write_report
from studies.row_names import LINE, OURS, RAW, shown
from studies.scenes import pictures
from studies.scenes.figures import (
    MadeBy,
    RateFigures,
    ScenesFigures,
    ShearRateFigures,
    scores_of,
)
from studies.scenes.study import CAVEAT, retraining


@dataclass(frozen=True)
class SceneEvidence:
    """Everything the report shows. data, held_out, streams: of the headline's rate.

    closed_loop: HTML of a further section; the demo shows its closed loop there.
    """

    figures: ScenesFigures
    made: MadeBy
    data: DataSet
    held_out: HeldOut
    streams: list[StreamPicture]
    closed_loop: str = ""


def write_scene_report(path: Path, evidence: SceneEvidence) -> Path:
    """Write the report; OutputError where that cannot be done."""
    figures = evidence.figures
    kind = evidence.figures.kind
    rate = figures.rates[figures.headline_hz]
    threshold = rate.rows.get(LINE)
    objects_picture = rates_picture = ""
    if rate.objects:
        objects_picture = pictures.objects_left_out(rate.objects, kind)
    if len(figures.rates) > 1:
        rates_picture = pictures.rates(figures.rates, kind)
    return write_report(
        path,
        "scenes.html",
        figures=figures,
        kind=kind,
        rate=rate,
        best=scores_of(rate.rows, OURS),
        ours=OURS,
        raw=RAW,
        leak_checks={
            hz: one.leak for hz, one in figures.rates.items() if one.leak is not None
        },
        threshold=threshold if isinstance(threshold, ShearRateFigures) else None,
        bars=pictures.level_bars(rate.rows, kind),
        confusion=pictures.confusion_spread(rate.retrainings[OURS].confusion, kind),
        four_by_four=four_by_four(evidence.data.with_situations(), evidence.held_out),
        objects_picture=objects_picture,
        curve_heads=_curve_heads(rate),
        rates_picture=rates_picture,
        trials=[
            (one.recording.trial_id, draw.stream(one, kind)) for one in evidence.streams
        ],
        closed_loop=evidence.closed_loop,
        made=evidence.made,
    )


def _curve_heads(rate: RateFigures) -> list[str]:
    """Columns of the learning curve: four situations and eight classes of each method."""
    if not rate.learning_curve:
        return []
    heads = []
    for name in rate.learning_curve[0].rows:
        heads += [f"4, F1, {shown(name)}", f"8, F1, {shown(name)}"]
    return heads


def demo_report(
    path: Path,
    data: DataSet,
    held_out: HeldOut,
    made: MadeBy,
    streams: list[StreamPicture],
    closed_loop: str = "",
) -> Path:
    """The same page from one set, with our forest alone and without objects and rates.

    data, held_out: with the task "classes". streams: of `held_out_streams`. closed_loop: HTML.
    Raises OutputError.
    """
    votes = held_out.votes["classes"]
    matrix = confusion(data.tasks["classes"].label, votes)
    rate = RateFigures(
        rate_hz=data.rate_hz,
        window_samples=window_samples(data.rate_hz),
        data={"name": data.name, "kind": data.kind, "n_trials": len(data.recordings)},
        rows={OURS: scores(data, votes, seed=made.seed)},
        retrainings={OURS: retraining([made.seed], [matrix])},
    )
    figures = ScenesFigures(data.kind, CAVEAT, {f"{data.rate_hz:g}": rate})
    evidence = SceneEvidence(figures, made, data, held_out, streams, closed_loop)
    return write_scene_report(path, evidence)
