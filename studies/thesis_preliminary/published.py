"""What the thesis published of its preliminary study: figures for comparison only.

"Ensuring Safety in Upper-Limb Prostheses: Tactile Sensor and Machine Learning for Risk Prediction",
chapter 4: tables 4.1 (cases 1 to 3) and 4.2 (4 and 5), average accuracy in % over 5 iterations. The
recordings are of an earlier project (its reference 59): 20 Hall sensors on a SoftHand, 17 tasks.
The thesis does not state the number of windows, their split, the number of each class, or the
spread.
"""

from __future__ import annotations

SOURCE = "the thesis, tables 4.1 and 4.2"
LEARNERS = (
    "random forest",
    "k-nearest neighbours",
    "naive Bayes",
    "gradient boosting",
    "neural network",
)
ACCURACY_PERCENT: dict[str, tuple[float | None, ...]] = {
    "1": (86.25, 78.57, 64.64, 82.32, 84.57),
    "2": (48.39, 53.57, 49.11, 50.89, 49.29),
    "3": (45.58, 53.85, 43.27, 46.15, 42.12),
    "4": (84.42, None, None, 83.85, 80.58),
    "5": (73.49, None, None, 71.16, 67.91),
}
"""By case, in the order of LEARNERS; None: not tried there."""
