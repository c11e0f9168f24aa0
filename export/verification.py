"""What a verification compared, as counts; `dataclasses.asdict` gives its JSON."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PredictDisagreement:
    """How often scikit-learn's predict gives another class. share_off_ties: 0 to 1."""

    share_off_ties: float
    ties: int
    differs_on_ties: int


@dataclass(frozen=True)
class HeadVerification:
    """One head of a file beside the reference. rows: given rows, thresholds and edges together.

    predict_disagreement: None but for a forest alone. nodes: of its trees, and weights of its
    network, each compared.
    """

    rows: int
    label_mismatches: int
    vote_mismatches: int
    predict_disagreement: PredictDisagreement | None
    nodes: int


@dataclass(frozen=True)
class Verification:
    """A whole file beside the reference. given_rows: feature rows of windows.

    single_rows: rows computed alone and in a batch. stream_samples: samples of all streams.
    """

    given_rows: int
    heads: dict[str, HeadVerification]
    ties_checked: int
    single_rows: int
    stream_samples: int


@dataclass(frozen=True)
class ExportReport(Verification):
    """A verified file that was written. bytes: its size."""

    bytes: int

    @staticmethod
    def of(verification: Verification, n_bytes: int) -> ExportReport:
        """The report of a written file."""
        return ExportReport(**vars(verification), bytes=n_bytes)
