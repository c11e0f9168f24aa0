"""Models that are installed with Holdfast; each is named by its file's name without the ending."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent
# in the package of a wheel, beside the package in a checkout
MODELS = next(
    (
        folder
        for folder in (_PACKAGE / "models", _PACKAGE.parent / "models")
        if folder.is_dir()
    ),
    _PACKAGE / "models",
)


def shipped() -> list[str]:
    """Names of the shipped models, sorted: "holdfast-150hz" is the default."""
    return sorted(path.stem for path in MODELS.glob("*.onnx"))


def model_path(word: str | Path) -> Path:
    """The file that a word names: a path, or the name of a shipped model.

    >>> model_path("mine/holdfast.onnx").as_posix()
    'mine/holdfast.onnx'
    >>> model_path("holdfast-150hz").name
    'holdfast-150hz.onnx'
    """
    path = Path(word)
    inside = MODELS / f"{path.name}.onnx"
    return (
        inside
        if path == Path(path.name) and not path.exists() and inside.is_file()
        else path
    )
