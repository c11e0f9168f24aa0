"""`holdfast doctor [MODEL]`: what is installed here, or whether a model file answers as it must.

With --completion SHELL it prints what makes a shell complete commands, options and files:

holdfast doctor --completion bash > ~/.local/share/bash-completion/completions/holdfast
holdfast doctor --completion zsh > "${fpath[1]}/_holdfast"
holdfast doctor --completion fish > ~/.config/fish/completions/holdfast.fish
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    STDOUT,
    WITH_SETTINGS,
    add_json_option,
    path_argument,
    show,
    write_found,
)
from holdfast.core.errors import needs_extra

if TYPE_CHECKING:
    from holdfast.live.doctor import Finding


def add_doctor_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument(
        "model",
        nargs="?",
        metavar="MODEL",
        help="check this model file on this machine, in seconds (default: the machine)",
    )
    parser.add_argument(
        "--completion",
        choices=("bash", "zsh", "fish"),
        help="print what makes a shell complete commands, and stop",
    )
    add_json_option(parser)


def run_doctor(args: argparse.Namespace) -> int:
    """Print every finding when it is there; 1 where a check of the model failed."""
    if args.completion is not None:
        return _complete(args.completion)
    if args.model is None:
        from holdfast.live.doctor import examine

        findings = examine(_settings)
    else:
        from holdfast.live.model_checks import model_checks

        findings = model_checks(args.model)

    found = []
    failed = False
    for one in findings:
        found.append(asdict(one))
        # a missing thing on a machine is a result, and no failure
        failed = failed or (args.model is not None and one.status != "ok")
        if args.json != STDOUT:
            # at once and not at the end: a check that hangs is then the next one
            step = f"  -> {one.next_step}" if one.next_step else ""
            show(f"{one.status:<9}{one.what:<30}{one.found}{step}")
            sys.stdout.flush()
    write_found(args, {"ok": not failed, "findings": found})
    return int(failed)


def _complete(shell: str) -> int:
    """Print the script that a shell reads."""
    with needs_extra("completion"):
        import shtab

    print(shtab.complete(whole_parser(shtab.FILE), shell))
    return 0


def whole_parser(files: object) -> argparse.ArgumentParser:
    """All commands in one parser. files: how shtab completes names of files."""
    # here: the rest of the doctor runs where no package is installed
    from holdfast.cli.main import VERBS, functions_of
    from holdfast.cli.options import add_config_option

    whole = argparse.ArgumentParser(prog="holdfast")
    commands = whole.add_subparsers()
    for verb, (_, about) in VERBS.items():
        parser = commands.add_parser(verb, help=about)
        functions_of(verb)[0](parser)
        if verb in WITH_SETTINGS:
            add_config_option(parser)
        for action in parser._actions:
            if isinstance(action.choices, dict):  # which shtab takes for commands
                action.choices = list(action.choices)
            if action.type is path_argument or action.dest == "model":
                action.complete = files  # type: ignore[attr-defined]  # the way of shtab

    return whole


def _settings() -> list[Finding]:
    """Each value of holdfast.toml here, and where it comes from."""
    from holdfast.cli.options import DEFAULT, read_settings, settings_file
    from holdfast.live.doctor import Finding

    path = settings_file([])
    if path is None:
        found = f"no {DEFAULT} here: options come from the command line"
        return [Finding("settings", "ok", found)]
    return [
        Finding(f"setting {name}", "ok", f"{value} (from {path})")
        for name, value in read_settings(path).items()
    ]
