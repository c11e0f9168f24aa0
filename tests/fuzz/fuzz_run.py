"""Coverage-guided fuzzing: `python tests/fuzz/fuzz_run.py --seconds 60 TARGET ..`, or `make fuzz`
for all targets.

Begins with a target's seeds and its files in tests/fuzz/corpus; what breaks it is left in
build/fuzz/TARGET, from where it goes into the corpus, whose files an ordinary test replays. A line
a target on stdout; ends with 1 where something broke. Every target runs in a process of its own,
made after the instrumented imports, which take seconds.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
CORPUS = HERE / "corpus"
sys.path.insert(0, str(HERE.parent / "support"))
LONGEST_S, MOST_MB, LONGEST_BYTES = 120, 1500, 4096
"""Seconds, MiB and bytes of one input. Beside other work a first input took ten seconds."""
ROOMS = ["edge_runtime", "drivers", "simulation", "holdfast", "training"]


def main() -> int:
    """Fuzz every target until its runs or seconds are over."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("targets", nargs="*")
    parser.add_argument(
        "--seconds",
        type=int,
        default=0,
        help="for each target; without it each has its bounded runs",
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "build" / "fuzz")
    args = parser.parse_args()
    args.out = args.out.resolve()

    import atheris

    with atheris.instrument_imports(include=ROOMS, enable_loader_override=False):
        from fuzz_targets import TARGETS
    broken = 0
    for name in args.targets or TARGETS:
        sys.stdout.flush()
        child = os.fork()
        if not child:
            _fuzz(atheris, name, args)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        broken += code != 0
        sys.stdout.write(
            f"{name}: {'holds' if code == 0 else f'broken, exit code {code}'}\n"
        )
    return int(broken > 0)


def _fuzz(atheris: Any, name: str, args: argparse.Namespace) -> None:
    """Never returns: libFuzzer ends the process."""
    from fuzz_targets import TARGETS, folder, refused

    warnings.simplefilter("error")
    seeds, found = folder() / "seeds", args.out / name
    for place in (seeds, found):
        place.mkdir(parents=True, exist_ok=True)
    for k, seed in enumerate(TARGETS[name].seeds):
        (seeds / f"seed-{k}").write_bytes(seed)
    os.chdir(folder())
    known = [str(CORPUS / name)] if (CORPUS / name).is_dir() else []
    runs = -1 if args.seconds else TARGETS[name].runs
    options = [
        f"-runs={runs}",
        f"-max_total_time={args.seconds}",
        f"-seed={args.seed}",
        f"-timeout={LONGEST_S}",
        f"-rss_limit_mb={MOST_MB}",
        f"-max_len={LONGEST_BYTES}",
        f"-artifact_prefix={found}/",
        "-print_final_stats=1",
    ]

    def feed(data: bytes) -> None:
        refused(TARGETS[name], data)

    atheris.Setup([sys.argv[0], *options, str(seeds), *known], feed)
    atheris.Fuzz()


if __name__ == "__main__":
    sys.exit(main())
