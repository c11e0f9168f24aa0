"""docs/step.svg, one sample through the model file, drawn from its graph: `make docs`."""

from __future__ import annotations

from collections.abc import Iterable

import onnx

TREES = "TreeEnsembleRegressor"
LEARNED = "learned_votes"
ANSWERS = ("p_class", "p_situation", "situation", "weight")
PLACES = {
    "guard": (20, 62, 500),
    "bank": (60, 150, 130),
    "detectors": (20, 238, 120),
    "contact": (150, 238, 110),
    "features": (220, 150, 300),
    "trees": (270, 238, 120),
    "networks": (400, 238, 120),
    "answer": (150, 326, 370),
}
"""Left edge, top edge and width of each stage's box."""
EDGE_X = {
    ("guard", "bank"): 125,
    ("guard", "detectors"): 40,
    ("guard", "contact"): 205,
    ("guard", "features"): 395,
    ("bank", "detectors"): 100,
    ("bank", "contact"): 170,
    ("features", "trees"): 330,
    ("features", "networks"): 460,
    ("contact", "answer"): 205,
    ("trees", "answer"): 330,
    ("networks", "answer"): 460,
}
"""Where an arrow between two stages is drawn; it goes straight down."""
TALL = 56
STYLE = """text{font-family:system-ui,sans-serif;fill:#1f2933;text-anchor:middle}
.n{font-size:18px;font-weight:600}.s{font-size:15px}.p{fill:#fff}
.g{fill:#eef4f8;stroke:#7b8794;stroke-dasharray:5 4}
.b{fill:#fff;stroke:#0b69a3;stroke-width:1.5}.m{fill:#52606d}
.a{stroke:#52606d;stroke-width:1.5;fill:none;marker-end:url(#m)}
@media(prefers-color-scheme:dark){text{fill:#e4e7eb}.p,.b{fill:#1e2129}.g{fill:#262c36}.b{stroke:#5fb0e5}
.a{stroke:#b8c2cc}.m{fill:#b8c2cc}}"""


def stages(graph: onnx.GraphProto) -> dict[str, list[onnx.NodeProto]]:
    """Every node of a model's graph in one stage, in the order in which they are computed.

    guard: what the filter bank and the features both need, and the flags. state: what only the next
    sample needs.
    """
    by_output = {name: node for node in graph.node for name in node.output}
    bank = _before(["part_bands"], by_output)
    features = _before(["features"], by_output)
    flags = _before(["settled", "unknown", "usable_sensors"], by_output)
    # The sum of all votes belongs to the answer, and so does what contact makes of it.
    votes = _before([LEARNED], by_output) - {id(by_output[LEARNED])}
    trees = {id(node) for node in graph.node if node.op_type == TREES}
    wanted = {
        "guard": (bank & features) | flags,
        "bank": bank,
        "features": features,
        "detectors": _before(["detectors"], by_output),
        "contact": _before(["empty"], by_output),
        "trees": trees,
        "networks": votes,
        "answer": _before(ANSWERS, by_output),
        "state": {id(node) for node in graph.node},
    }
    found: dict[str, list[onnx.NodeProto]] = {}
    taken: set[int] = set()
    for name, nodes in wanted.items():
        found[name] = [n for n in graph.node if id(n) in nodes - taken]
        taken |= nodes
    return found


def _before(names: Iterable[str], by_output: dict[str, onnx.NodeProto]) -> set[int]:
    """The nodes that a tensor needs, by identity."""
    waiting = list(names)
    found = set()
    while waiting:
        node = by_output.get(waiting.pop())
        if node is not None and id(node) not in found:
            found.add(id(node))
            waiting += node.input
    return found


def edges(found: dict[str, list[onnx.NodeProto]]) -> set[tuple[str, str]]:
    """Pairs of drawn stages of which the second reads what the first computes."""
    maker = {
        out: name for name in PLACES for node in found[name] for out in node.output
    }
    return {
        (maker[tensor], name)
        for name in PLACES
        for node in found[name]
        for tensor in node.input
        if tensor in maker and maker[tensor] != name
    }


def picture(graph: onnx.GraphProto) -> str:
    """The graph's stages as SVG. Raises KeyError for an edge that the picture has no place for."""
    found = stages(graph)
    sizes = {value.name: _size(value) for value in (*graph.input, *graph.output)}
    nodes = len(graph.node)
    stateful = sizes["state"]
    words = {
        "guard": ("guard", "what is lost, not a number or out of range stops here"),
        "bank": ("filter bank", "vibration"),
        "detectors": ("detectors", "vibration, cone"),
        "contact": ("contact", "force decides"),
        "features": (f"{sizes['features']} features", "of the last half second"),
        "trees": ("trees", "whole votes"),
        "networks": ("networks", "whole votes"),
        "answer": (
            "answer",
            f"{sizes['p_class']} classes, {sizes['p_situation']} situations",
        ),
    }
    boxes = [_box(*PLACES[name], *words[name]) for name in PLACES if found[name]]
    arrows = [_arrow(EDGE_X[edge], *edge) for edge in sorted(edges(found))]
    label = (
        f"One sample of {sizes['sample']} numbers through one ONNX file of {nodes} nodes: guard, "
        "then filter bank and detectors, contact, and features, trees and networks; contact and "
        "votes give the answer. The decision acts on it"
    )
    body = [
        '<rect class="p" width="540" height="508"/>',
        _line(270, 26, "n", f"six fingertips: {sizes['sample']} numbers a sample"),
        '<rect class="g" x="8" y="48" width="524" height="372" rx="10"/>',
        *boxes,
        *arrows,
        _down(270, 32, 60),
        _line(
            270,
            404,
            "s",
            f"holdfast.onnx: {nodes} nodes; {stateful:,} numbers go to the next sample",
        ),
        _down(270, 420, 440),
        _box(20, 442, 500, "decision", "arm, act, hold; the wearer overrides"),
    ]
    return _document(label, body)


def _document(label: str, body: list[str]) -> str:
    head = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="540" height="508" viewBox="0 0 540 508" '
        f'role="img" aria-label="{label}"><title>{label}</title>'
    )
    marker = (
        '<defs><marker id="m" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto"><path class="m" d="M0 0 8 4 0 8z"/></marker></defs>'
    )
    return "\n".join([head, f"<style>{STYLE}</style>", marker, *body, "</svg>"]) + "\n"


def _size(value: onnx.ValueInfoProto) -> int:
    """Numbers in a tensor of one hand."""
    size = 1
    for axis in value.type.tensor_type.shape.dim[1:]:
        size *= axis.dim_value
    return size


def _box(left: int, top: int, width: int, name: str, about: str) -> str:
    middle = left + width // 2
    frame = (
        f'<rect class="b" x="{left}" y="{top}" width="{width}" height="{TALL}" rx="6"/>'
    )
    return (
        frame + _line(middle, top + 23, "n", name) + _line(middle, top + 44, "s", about)
    )


def _line(x: int, y: int, kind: str, text: str) -> str:
    return f'<text class="{kind}" x="{x}" y="{y}">{text}</text>'


def _arrow(x: int, source: str, target: str) -> str:
    return _down(x, PLACES[source][1] + TALL, PLACES[target][1] - 2)


def _down(x: int, top: int, bottom: int) -> str:
    return f'<path class="a" d="M{x} {top}V{bottom}"/>'
