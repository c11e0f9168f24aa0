"""`holdfast completion SHELL`: prints what makes a shell complete commands, options and files.

holdfast completion bash > ~/.local/share/bash-completion/completions/holdfast
holdfast completion zsh > "${fpath[1]}/_holdfast"
holdfast completion fish > ~/.config/fish/completions/holdfast.fish
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from importlib import import_module

from holdfast.cli.command import WITH_SETTINGS, path_argument
from holdfast.cli.settings import add_config_option
from holdfast.core.errors import UsageError

SHELLS = ("bash", "zsh", "fish")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument(
        "shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS)
    )


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from holdfast.cli.main import VERBS

    try:
        import shtab
    except ImportError as error:
        raise UsageError(
            f"completion needs the package {error.name}",
            cause="only the extra `completion` installs it",
            next_step="pip install 'holdfast[completion]'",
        ) from None

    print(shtab.complete(whole_parser(VERBS, shtab.FILE), args.shell))
    return 0


def whole_parser(
    verbs: Mapping[str, tuple[str, str]], files: object
) -> argparse.ArgumentParser:
    """All commands in one parser. files: how shtab completes names of files."""
    whole = argparse.ArgumentParser(prog="holdfast")
    commands = whole.add_subparsers()
    for verb, (module, about) in verbs.items():
        parser = commands.add_parser(verb, help=about)
        import_module(module).add_arguments(parser)
        if verb in WITH_SETTINGS:
            add_config_option(parser)
        for action in parser._actions:
            if isinstance(action.choices, dict):  # which shtab takes for commands
                action.choices = list(action.choices)
            if action.type is path_argument or action.dest == "model":
                action.complete = files  # type: ignore[attr-defined]  # the way of shtab

    return whole
