"""`holdfast doctor`: what is installed, what is missing and how to get it. It never crashes."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING

from holdfast.cli.command import add_json_option, show_found
from holdfast.cli.settings import DEFAULT, read_settings

if TYPE_CHECKING:
    from holdfast.live.installation import Finding


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Print every finding; always 0, because a missing thing is a result."""
    from holdfast.live.installation import examine

    findings = examine(_data_sets, _settings)
    width = max(len(one.what) for one in findings) + 2
    lines = []
    for one in findings:
        step = f"  -> {one.next_step}" if one.next_step else ""
        lines.append(f"{one.status:<11}{one.what:<{width}}{one.found}{step}")

    show_found(args, "\n".join(lines), {"findings": [asdict(one) for one in findings]})
    return 0


def _data_sets() -> list[Finding]:
    """The public sets, where training is installed: nothing else reads them."""
    from holdfast.live.installation import Finding, missing_of
    from holdfast.training.datasets import PUBLIC_SETS, data_folder

    if missing_of("train"):
        return []

    folder = data_folder()
    there = [name for name in PUBLIC_SETS if (folder / name).is_dir()]
    findings = [Finding(name, "ok", f"in {folder}") for name in there]
    missing = [name for name in PUBLIC_SETS if name not in there]
    if missing:
        found = f"not in {folder}: {', '.join(missing)}"
        step = "only for figures on public recordings: HOLDFAST_DATA names their folder"
        findings.append(Finding("public data sets", "ok", found, step))
    return findings


def _settings() -> list[Finding]:
    """Each value of holdfast.toml here, and where it comes from."""
    from holdfast.core.errors import HoldfastError
    from holdfast.live.installation import Finding

    try:
        settings = read_settings([])
    # A file of settings with a mistake is a finding like any other.
    except HoldfastError as error:
        return [Finding("settings", "broken", str(error), error.next_step)]

    if settings.path is None:
        found = f"no {DEFAULT} here: options come from the command line"
        return [Finding("settings", "ok", found)]

    findings = []
    for name, value in settings.values.items():
        # the model is no option: it stands first, behind the verb
        word = "MODEL on the command line" if name == "model" else f"--{name}"
        found = f"{value} (from {settings.path}; {word} wins)"
        findings.append(Finding(f"setting {name}", "ok", found))

    return findings
