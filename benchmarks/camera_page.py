"""docs/camera.md, from what `holdfast bench onset` measured, and docs/tags.svg, the tags to print:
`make docs`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.page import markdown
from simulation.camera.apriltag import CODES, SIDE_CELLS, cells

TAG_MM, MARGIN_MM, RULER_MM = 10.0, 10.0, 100
COUNTS = ("fps", "mm_per_s2", "n", "found", "hidden")
INTRO = """# A camera beside the hand

A bench instrument, not a part of the hand: it says when the object began to move in the hand, without any tactile
sample having a say, so that lead times are measured against something else. `pip install 'holdfast[camera]'` brings
depthai 3.12 (350 MB; no 32-bit Raspberry Pi); tracks are read, and onsets found, with numpy alone. Nothing is sent:
depthai's usage data and crash dumps are switched off before it is loaded, unless you have set `DEPTHAI_TELEMETRY`
yourself. Written by `make docs`.

```sh
holdfast watch --camera oak --tag-mm 9.96 --seconds 15 --out trials/7      # lossless video and tag tracks
holdfast onset trials/7 --action pull --no-slip trials/1 trials/2          # a label in trials/7/events.jsonl
holdfast onset scenes/soft-ball/pull/trial_1.csv                           # frames of a scene: trial_1.onset.json
holdfast watch --camera trials/7 --out again                               # the tags anew, from a recorded video
```

## Tags

- Print [tags.svg](tags.svg) at 100 %: AprilTags of the family 36h11, 0 for the object, 1 for the hand. Keep the
  white margin, matt paper. Check the ruler, then measure a tag's black square with a calliper: that is `--tag-mm`.
  Printers scale both tags alike, which no picture can show; `--apart-mm`, the distance between the tags' centres at
  the start, measured, finds it. Two tags that differ by more than 5 %, or are no squares, are refused.
- Glue them flat, side by side, in one plane that faces the camera, where no finger covers them. 20 to 60 px a side is
  enough. What moves towards the camera is not seen.
- A global-shutter mono camera (OV9282), exposure 2 ms or less and strong light: a tag that moves by two of its eight
  cells while the shutter is open is lost (10 mm and 2 ms: 1.2 m/s; one cell does no harm). 640 x 400 at 60 frames a
  second is what one core can write without loss.
- Rights on Linux, into /etc/udev/rules.d/80-oak.rules:
  `SUBSYSTEM=="usb", ATTRS{idVendor}=="03e7", MODE="0660", GROUP="plugdev", TAG+="uaccess"`

## What it measures

The object's centre in the hand tag's own axes, mm: a hand that moves, turns or comes nearer moves nothing. Three
times:

| time | what it is |
| --- | --- |
| `t0_s` | start: where a quadratic through the first moving frames leaves the rest, with its standard deviation |
| `seen_s` | first of three frames beyond max(5 sigma, 0.15 px) |
| `gross_s` | a fixed distance: 2 mm, or 1.5 times the largest motion of `--no-slip` trials, loaded and held |

A motion that does not reach the gross distance is no slip: soft pads give. A hidden tag is a gap, and what began in
it has no time. Times count from the trial's first tactile sample (`host_ns` in tactile.csv, the same monotonic
clock), else from the first frame; they are those of the middle of the exposure. Labels have the provenance `camera`;
labels of others are left alone. A void trial (camera lost, disk full, killed) keeps what it has and gets no label.

A folder: `camera.mkv` (FFV1, lossless), `camera.mcap` (stamps), `tags.csv` (sequence, t_s, tag, corners in px),
`camera.json` (lens, counts, gaps, why it is void). Frames of your own go in as .npz: `frames` [K, H, W] uint8, H
and W even, `time_s` [K] (ends of exposure), `fps`, `exposure_ms`, `tag_mm`.

"""
LIMITS = """## Limits, to be stated with every lead time

1. **A threshold sees late**: sqrt(2 x threshold / acceleration) after the start, 5 to 100 ms below, which makes lead
   times look longer. Give the lead to the fitted start and to the gross distance, with the frame period and the
   fit's spread.
2. **Elastic shear**: the object moves before anything slips. Between load and first sliding the start is of that
   motion; at 120 frames a second more of it is seen, and the start comes earlier than the sliding.
3. **Incipient slip** (parts of the contact) cannot be seen from outside.
4. **One clock**: both streams on one computer. On two, only a tap seen by both tells.
5. **Simulated**: no perspective, tilt, finger before a tag, defocus, uneven light or rolling shutter in the figures.
   They are a lower bound. No camera has been before this code: what opens one is checked by the library's names only.

"""
FIGURES = """## Figures (simulated)

`holdfast bench onset`: drawn tags (40 px, blur 0.7 px, 2 ms, noise 2 of 255) through depthai's own graph. Errors in ms,
5th, 50th and 95th percentile; "hidden": the object was gone or blurred before three frames had seen it leave. What is
neither found nor hidden moved along the camera's line of sight.

"""
RAMPS = """A constant acceleration from rest, start to start:

"""
PULLS = """Author pulls of the simulator, start to the first element that slides, gross to 2 mm of travel:

"""
HELD = """Holds that are loaded and do not slip:

"""


def page(figures: dict[str, Any]) -> str:
    """The whole page."""
    ramps, pulls = ([_row(row) for row in figures[name]] for name in ("ramps", "pulls"))
    tables = (
        RAMPS
        + markdown(ramps)
        + "\n\n"
        + PULLS
        + markdown(pulls)
        + "\n\n"
        + HELD
        + markdown(figures["held"])
    )
    return INTRO + LIMITS + FIGURES + tables + "\n"


def _row(row: dict[str, Any]) -> dict[str, Any]:
    told: dict[str, Any] = {name: row[name] for name in COUNTS if name in row}
    for name in ("start", "seen", "gross"):
        told[name] = " / ".join(f"{row[f'{name}_p{q}_ms']:.1f}" for q in (5, 50, 95))
    return told | {
        "worst start": f"{row['start_worst_ms']:.1f}",
        "within 10 ms": row["within_10_ms"],
    }


def sheet() -> str:
    """Both tags at their size with a ruler, as SVG in mm."""
    cell_mm = TAG_MM / SIDE_CELLS
    shapes = []
    for tag in range(len(CODES)):
        left_mm = MARGIN_MM + tag * (TAG_MM + 4.0 * MARGIN_MM)
        for row, column in np.argwhere(cells(tag) == 0.0).tolist():
            at = f'x="{left_mm + cell_mm * column:g}" y="{MARGIN_MM + cell_mm * row:g}"'
            shapes.append(f'<rect {at} width="{cell_mm:g}" height="{cell_mm:g}"/>')
        name = ("object", "hand")[tag]
        shapes.append(
            f'<text x="{left_mm:g}" y="30" font-size="3" font-family="sans-serif">{tag}: {name}</text>'
        )
    ruler = "".join(
        f"M{MARGIN_MM + k:g} 40v{-3 if k % 10 == 0 else -1.5:g}" for k in range(RULER_MM + 1)
    )
    shapes.append(
        f'<path d="M{MARGIN_MM:g} 40h{RULER_MM}{ruler}" stroke="black" stroke-width="0.2" fill="none"/>'
    )
    shapes.append('<text x="10" y="45" font-size="3" font-family="sans-serif">100 mm</text>')
    size = 'width="120mm" height="50mm" viewBox="0 0 120 50" shape-rendering="crispEdges"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size}>'
    return (
        "\n".join([head, '<rect width="120" height="50" fill="white"/>', *shapes, "</svg>"]) + "\n"
    )


if __name__ == "__main__":
    if sys.argv[1] == "--tags":
        sys.stdout.write(sheet())
    else:
        sys.stdout.write(page(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))))
