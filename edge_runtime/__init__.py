"""What runs on the hand: one sealed model file, one step a sample, one decision.

Loads numpy and onnxruntime, nothing else. Start from `contract`.
"""

from edge_runtime.contract import CLASSES, SITUATIONS, Prediction, Sample
from edge_runtime.errors import HoldfastError
from edge_runtime.monitor import GripMonitor, Model

__all__ = ["CLASSES", "SITUATIONS", "GripMonitor", "HoldfastError", "Model", "Prediction", "Sample"]
