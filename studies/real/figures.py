"""Figures of `make real`; `RealStudy.to_json` gives metrics.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from holdfast.core.contract import Json
from holdfast.data.metrics import HeadFigures, PredictionFigures
from holdfast.evaluation.formats import Host
from holdfast.evaluation.model_outputs import WindowFigures
from holdfast.export.verify import ExportReport


@dataclass(frozen=True)
class StreamedFold:
    """One fold's file on its held-out people. label_mismatches: windows unlike the table's."""

    verification: ExportReport
    windows: WindowFigures
    rows: int
    label_mismatches: int

    def to_json(self) -> Json:
        """As it stands in metrics.json."""
        counts = {"rows": self.rows, "label_mismatches": self.label_mismatches}
        verified = {"verification": asdict(self.verification)}
        return self.windows.to_json() | counts | verified


@dataclass(frozen=True)
class FinalModel:
    """The file from all people. path: below the study's folder. bytes: its size."""

    path: str
    bytes: int
    verification: ExportReport


@dataclass(frozen=True)
class RealStudy:
    """Everything that metrics.json holds. heads: the headline, people held out.

    rows: by stored name of the method. seconds: wall time of the whole command.
    """

    heads: HeadFigures
    data: str
    kind: str
    channels: int
    clock_free: str
    caveat: str
    streamed_fold: StreamedFold
    rows: dict[str, HeadFigures]
    model: FinalModel
    seed: int
    host: Host
    versions: dict[str, str]
    seconds: float

    def to_json(self) -> Json:
        """metrics.json; the headline's figures stand on top."""
        fields = asdict(self)
        del fields["heads"]
        fields["streamed_fold"] = self.streamed_fold.to_json()
        fields["rows"] = {name: _row_json(row) for name, row in self.rows.items()}
        return self.heads.to_json() | fields


def prediction_of(row: HeadFigures) -> PredictionFigures:
    """The figures of the 0.25 s prediction; each None where the method has no such head."""
    return row.predict_250ms or PredictionFigures()


def _row_json(row: HeadFigures) -> Json:
    """A row of the table as it stands in metrics.json."""
    figures = row.to_json()
    return {task: figures[task] for task in ("situations", "predict_250ms")}
