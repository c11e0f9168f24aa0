"""Pictures of pages at three widths, light and dark: `make screenshots`. Needs chromium.

Without names it takes the pages of build/docs-site that a reader meets first, and the reports
below build. It also names what is cut off: wider than the window, and in no box that scrolls; and
a page that looks the same to a reader who prefers dark.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from headless_browser import CHROMIUM, Tab, browser

WIDTHS_PX = (390, 1366, 1920)
"""A phone, a small and a large screen."""
HEIGHT_PX = 900
SITE = Path("build/docs-site")
FIRST_PAGES = (
    "index.html",
    "for-clinicians.html",
    "for-students.html",
    "for-boards.html",
    "cheat-sheet.html",
    "how-it-works.html",
    "shared-control.html",
    "what-accuracy-costs.html",
    "your-data.html",
)
CUT = """[...document.querySelectorAll("table,img,svg[role=img],pre,math")].filter(one => {
  if (one.parentElement.closest("svg") || !one.getClientRects().length) return false;
  const seen = one.getBoundingClientRect(), wide = document.documentElement.clientWidth;
  if (!seen.width || seen.left >= wide) return false;
  for (let box = one.parentElement; box; box = box.parentElement) {
    const how = getComputedStyle(box).overflowX, edge = box.getBoundingClientRect();
    if (how == "auto" || how == "scroll") return false;
    if (how == "hidden" && seen.right > edge.right + 1) return true; }
  return seen.right > wide + 1;
}).map(one => one.tagName.toLowerCase() + " "
  + (one.getAttribute("src") || one.textContent).trim().slice(0, 40))"""
"""Names of elements that are cut off. Of the drawer of a menu, which is outside, nothing counts."""


def pages_of(names: Sequence[Path]) -> list[Path]:
    """The pages that were named, else those of the site and every report below build."""
    if names:
        return list(names)
    first = [SITE / name for name in FIRST_PAGES]
    reports = sorted(Path("build").glob("*/report.html"))
    return [page for page in (*first, *reports) if page.is_file()]


def take(tab: Tab, page: Path, out: Path) -> Iterator[str]:
    """Write the pictures of a page; yields what is cut off, and where dark is as light."""
    for width in WIDTHS_PX:
        taken = []
        for dark in (False, True):
            tab.open(page.resolve().as_uri(), width, HEIGHT_PX, dark=dark)
            tab.wait_until(
                f"location.pathname.endsWith('/{page.name}') && document.readyState == 'complete'"
            )
            name = f"{page.parent.name}-{page.stem}-{width}"
            taken.append(out / f"{name}{'-dark' if dark else ''}.png")
            tab.screenshot(taken[-1])
        if taken[0].read_bytes() == taken[1].read_bytes():
            yield f"{page} at {width} px: no other in the dark"
        for one in tab.value(CUT):
            yield f"{page} at {width} px: cut off: {one}"


def main(words: Sequence[str] | None = None) -> int:
    """Take them all; 1 where something is wrong, 2 without chromium or a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pages", nargs="*", type=Path, help="HTML files")
    parser.add_argument("--out", type=Path, default=Path("build/screenshots"))
    args = parser.parse_args(words)
    pages = pages_of(args.pages)
    if CHROMIUM is None:
        print("chromium is not installed: sudo apt install chromium", file=sys.stderr)
        return 2
    absent = [str(page) for page in pages if not page.is_file()]
    if absent or not pages:
        what = ", ".join(absent) or "no page"
        print(f"{what}: make docs-site first, or name HTML files", file=sys.stderr)
        return 2

    args.out.mkdir(parents=True, exist_ok=True)
    cut: list[str] = []
    with tempfile.TemporaryDirectory() as profile, browser(Path(profile)) as tab:
        for page in pages:
            cut += take(tab, page, args.out)
    print("\n".join([*cut, f"{6 * len(pages)} pictures in {args.out}"]))
    return 1 if cut else 0


if __name__ == "__main__":
    sys.exit(main())
